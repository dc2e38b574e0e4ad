/* See fuzz.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/npy.h"
#include "codec/container/seen.h"
#include "codec/image/exif.h"
#include "codec/image/image.h"
#include "codec/image/xmp.h"
#include "codec/limits.h"
#include "codec/splat/draco.h"
#include "codec/splat/draco_layout.h"
#include "codec/splat/glb.h"
#include "codec/splat/payload.h"
#include "codec/splat/ply.h"
#include "codec/splat/quant.h"
#include "codec/splat/sog.h"
#include "codec/splat/splat.h"
#include "codec/splat/spz.h"
#include "core/layout.h"
#include "core/splat/appearance.h"
#include "lab/eval/tensors.h"
#include "tests/fuzz/fuzz.h"

#include <assert.h>
#include <math.h>
#include <string.h>

static const struct codec_limits limits = {.max_gaussians = 1 << 16, .max_bytes = 1 << 24};

static void check_quant(const struct quant *a)
{
    struct quant b;
    struct buf file = {0};
    struct gauss g;
    if (a->n) { /* the same integers again */
        enum err_code rc = spz_encode(a, 3, &file, NULL);
        assert(!rc);
        rc = spz_decode(file.data, file.size, NULL, &b, NULL);
        assert(!rc && a->n == b.n && !memcmp(a->position, b.position, 12 * a->n) &&
               !memcmp(a->rotation, b.rotation, 4 * a->n));
        quant_free(&b);
        buf_free(&file);
    }
    enum err_code rc = quant_to_gauss(a, &g, NULL);
    assert(!rc && !gauss_count_bad(&g, NULL));
    gauss_free(&g);
}

static void check_gauss(const struct gauss *a)
{
    struct buf file = {0};
    struct gauss b;
    enum err_code rc = payload_encode(a, true, &file, NULL);
    assert(!rc);
    rc = payload_decode(file.data, file.size, NULL, &b, NULL);
    assert(!rc && a->n == b.n && !memcmp(a->mean_m, b.mean_m, 12 * a->n));
    gauss_free(&b);
    buf_free(&file);
}

void fuzz_ply(const uint8_t *bytes, size_t n)
{
    struct gauss g;
    if (ply_decode(bytes, n, &limits, &g, NULL, NULL) == ERR_OK)
        check_gauss(&g);
    gauss_free(&g);
}

void fuzz_splat(const uint8_t *bytes, size_t n)
{
    struct gauss g;
    if (splat_decode(bytes, n, &limits, &g, NULL) == ERR_OK)
        check_gauss(&g);
    gauss_free(&g);
}

void fuzz_spz(const uint8_t *bytes, size_t n)
{
    struct quant q;
    if (spz_decode(bytes, n, &limits, &q, NULL) == ERR_OK)
        check_quant(&q);
    quant_free(&q);
}

/* The check value is made right, or nothing would get past it into libdraco. */
void fuzz_drc(const uint8_t *bytes, size_t n)
{
    struct quant q;
    uint8_t *copy = mem_array(n, 1);
    assert(copy);
    if (n)
        memcpy(copy, bytes, n);
    if (n >= DRACO_CRC_BYTES) {
        uint32_t crc = draco_crc(copy, n - DRACO_CRC_BYTES);
        memcpy(copy + n - DRACO_CRC_BYTES, &crc, DRACO_CRC_BYTES);
    }
    if (draco_decode(copy, n, &limits, &q, NULL) == ERR_OK)
        check_quant(&q);
    quant_free(&q);
    mem_free(copy);
}

void fuzz_glb(const uint8_t *bytes, size_t n)
{
    struct gauss g;
    if (glb_decode(bytes, n, &limits, &g, NULL) == ERR_OK)
        check_gauss(&g);
    gauss_free(&g);
}

void fuzz_sog(const uint8_t *bytes, size_t n)
{
    struct gauss g;
    if (sog_decode(bytes, n, &limits, &g, NULL) == ERR_OK)
        check_gauss(&g);
    gauss_free(&g);
}

/* Straight into drawn rows, in their order. It is decoded if and only if payload_decode can. */
static bool payload_is_placed(const uint8_t *bytes, size_t n, bool halves)
{
    struct payload p = {0};
    bool good = payload_open(&p, bytes, n, &limits, NULL) == ERR_OK;
    if (good) {
        const size_t groups = (p.n + LAYOUT_LANES - 1) / LAYOUT_LANES;
        const uint32_t planes =
            (halves ? layout_planes_halves : layout_planes)(p.sh_degree, p.embed_len);
        float *rows = mem_array(groups * LAYOUT_LANES + 1, planes * sizeof *rows);
        float **block = mem_array(groups + 1, sizeof *block), *size_log = mem_array(p.n, 4);
        uint32_t *place = mem_array(p.n + 1, sizeof *place);
        const struct payload_target to = {.block = block,
                                          .place = place,
                                          .block_rows = LAYOUT_LANES,
                                          .sh_halves = halves,
                                          .embed_len = p.embed_len};
        assert(rows && block && place && size_log);
        for (size_t i = 0; i < groups; i++)
            block[i] = rows + i * LAYOUT_LANES * planes;
        for (size_t i = 0; i < p.n; i++)
            place[i] = (uint32_t)i;
        payload_sizes(&p, size_log);
        good = payload_place(&p, &to, NULL) == ERR_OK;
        mem_free(rows);
        mem_free(block);
        mem_free(place);
        mem_free(size_log);
    }
    payload_free(&p);
    return good;
}

void fuzz_payload(const uint8_t *bytes, size_t n)
{
    struct gauss g;
    const bool good = payload_decode(bytes, n, &limits, &g, NULL) == ERR_OK;
    if (good)
        check_gauss(&g);
    gauss_free(&g);
    for (int halves = 0; halves < 2; halves++)
        assert(payload_is_placed(bytes, n, halves) == good);
}

void fuzz_npy(const uint8_t *bytes, size_t n)
{
    for (size_t ndim = 1; ndim <= 3; ndim++) {
        size_t shape[3], count = 1;
        float *data = NULL;
        if (npy_decode(bytes, n, ndim, shape, &data, NULL) == ERR_OK) {
            for (size_t i = 0; i < ndim; i++)
                count *= shape[i];
            assert(count <= n / sizeof *data);
        }
        mem_free(data);
    }
}

void fuzz_seen(const uint8_t *bytes, size_t n)
{
    struct seen_grid s;
    if (seen_decode(bytes, n, &s, NULL) == ERR_OK) {
        double at = seen_at(&s, s.corner_m[0] + 0.3 * s.nx * s.cell_m, s.corner_m[1]);
        assert(at >= 0.0 && at <= SEEN_VIEWS_MAX);
    }
    seen_free(&s);
}

void fuzz_tensors(const uint8_t *bytes, size_t n)
{
    struct tensors t;
    float sum = 0;
    if (tensors_decode(bytes, n, &t, NULL) == ERR_OK)
        for (size_t i = 0; i < t.n; i++) {
            size_t count = 1;
            assert(t.list[i].ndim <= TENSORS_DIMS_MAX && t.list[i].count <= n / sizeof(float));
            for (size_t k = 0; k < t.list[i].ndim; k++)
                count *= t.list[i].shape[k];
            assert(count == t.list[i].count && tensors_find(&t, t.list[i].name));
            for (size_t k = 0; k < count; k++)
                sum += t.list[i].data[k]; /* all of it is there */
        }
    static volatile float read_all;
    read_all = sum;
    (void)read_all;
    tensors_free(&t);
}

void fuzz_exif(const uint8_t *bytes, size_t n)
{
    struct image_gps gps;
    struct xmp xmp = {0};
    exif_parse(bytes, n, &gps, &xmp);
    assert(xmp.n <= XMP_VALUES);
    for (size_t i = 0; i < xmp.n; i++)
        assert(memchr(xmp.value[i].name, 0, XMP_NAME) && memchr(xmp.value[i].text, 0, XMP_TEXT));
    assert(!gps.has_position || (fabs(gps.lat_deg) <= 90 && fabs(gps.lon_deg) <= 180));
    assert(memchr(gps.time, 0, sizeof gps.time));
}

/* The checksum is made right, or nothing behind it would ever be reached. */
void fuzz_appearance(const uint8_t *bytes, size_t n)
{
    struct appearance a;
    struct buf b = {0}, again = {0};
    size_t hashed = n < 16 ? 0 : n - 16;
    buf_add(&b, bytes, hashed);
    struct hash128 h = hash_bytes(bytes, hashed);
    buf_u64(&b, h.lo);
    buf_u64(&b, h.hi);
    if (appearance_read(b.data, b.size, &a, NULL) == ERR_OK) {
        enum err_code rc = appearance_write(&a, &again, NULL);
        assert(!rc && again.size == b.size && !memcmp(again.data, b.data, b.size));
    }
    appearance_free(&a);
    buf_free(&again);
    buf_free(&b);
}
