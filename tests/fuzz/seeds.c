/* Small valid files of every format, made by the writers themselves.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/archive.h"
#include "codec/container/seen.h"
#include "codec/image/exif.h"
#include "codec/image/image.h"
#include "codec/splat/draco.h"
#include "codec/splat/glb.h"
#include "codec/splat/payload.h"
#include "codec/splat/ply.h"
#include "codec/splat/quant.h"
#include "codec/splat/sog.h"
#include "codec/splat/spz.h"
#include "core/splat/appearance.h"
#include "tests/fuzz/fuzz.h"

#include <assert.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void sample(size_t i, struct gauss *g)
{
    const size_t n = 3 + 5 * i;
    enum err_code rc = gauss_alloc(g, n, (uint32_t)i, i == 1 ? 2 : 0, NULL);
    assert(!rc);
    g->n = n;
    g->antialiased = i == 1;
    const size_t k = 3 * gauss_sh_count(g->sh_degree);
    for (size_t r = 0; r < n; r++) {
        for (size_t c = 0; c < 3; c++) {
            g->mean_m[3 * r + c] = (float)(200 * rng_unit(i, c, r) - 100);
            g->scale_log[3 * r + c] = (float)(-3 + rng_unit(i, 3 + c, r));
        }
        for (size_t c = 0; c < 4; c++)
            g->quat_wxyz[4 * r + c] = (float)rng_normal(i, 6 + c, r);
        g->opacity_logit[r] = (float)rng_normal(i, 10, r);
        for (size_t c = 0; c < k; c++)
            g->sh[k * r + c] = (float)(0.2 * rng_normal(i, 11 + c, r));
        for (size_t c = 0; c < g->embed_len; c++)
            g->embed[g->embed_len * r + c] = (float)rng_normal(i, 70 + c, r);
    }
}

static enum err_code npy_seed(size_t i, struct buf *out)
{
    buf_add(out, "\x93NUMPY\x01\x00\x76\x00", 10);
    buf_printf(out, "%-117s\n",
               i ? "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }"
                 : "{'descr': '<f4', 'fortran_order': False, 'shape': (6,), }");
    for (int k = 0; k < 6; k++)
        buf_f32(out, (float)k);
    return buf_check(out, NULL);
}

static enum err_code seen_seed(size_t i, struct buf *out)
{
    uint8_t views[6] = {0, 1, 2, 3, 5, 8};
    const struct seen_grid s = {{-10, 5}, 1.5, i ? 3 : 1, 2, views};
    return seen_encode(&s, out, NULL);
}

static enum err_code tensors_seed(size_t i, struct buf *out)
{
    static const char *const heads[] = {
        "{\"a\":{\"dtype\":\"F32\",\"shape\":[2,3],\"data_offsets\":[0,24]}}",
        "{\"__metadata__\":{\"format\":\"pt\"},\"a\":{\"dtype\":\"F32\",\"shape\":[],\"data_"
        "offsets\":[20,"
        "24]},\"b\":{\"dtype\":\"F16\",\"shape\":[10],\"data_offsets\":[0,20]}}",
        "{\"a\":{\"dtype\":\"F32\",\"shape\":[1,0,4,4],\"data_offsets\":[0,0]},\"c\":{\"dtype\":"
        "\"F32\","
        "\"shape\":[1,1,1,1,6],\"data_offsets\":[0,24]}}  "};
    buf_u64(out, strlen(heads[i]));
    buf_add(out, heads[i], strlen(heads[i]));
    for (int k = 0; k < 6; k++)
        buf_f32(out, (float)k);
    return buf_check(out, NULL);
}

static enum err_code exif_seed(size_t i, struct buf *out)
{
    static const char *const formats[] = {"jpg", "png", "webp"};
    static const struct image_gps gps = {true,  true, -12.5, 7.25,  90,    "2026:05:17 10:20:30",
                                         0.01,  100,  8,     false, false, false,
                                         false, false};
    struct image img;
    enum err_code rc = image_alloc(4, 4, 3, &img, NULL);
    if (!rc)
        rc = image_encode(&img, formats[i], 90, out, NULL);
    if (!rc)
        rc = exif_insert(out, &gps, NULL);
    image_free(&img);
    return rc;
}

static enum err_code text_ply(struct buf *out)
{
    static const char *const names[] = {"x",      "y",       "z",       "f_dc_0",  "f_dc_1",
                                        "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
                                        "rot_0",  "rot_1",   "rot_2",   "rot_3"};
    buf_printf(out, "ply\nformat ascii 1.0\ncomment axes ENU\nelement vertex 2\n");
    for (int i = 0; i < 14; i++)
        buf_printf(out, "property float %s\n", names[i]);
    buf_printf(
        out,
        "end_header\n1 2 3 .1 .2 .3 0 -1 -2 -3 1 0 0 0\n-1 -2e1 3 0 0 0 inf -1 -2 -3 1 .5 .5 .5\n");
    return buf_check(out, NULL);
}

static enum err_code gauss_seed(const char *target, size_t i, struct buf *out)
{
    struct gauss g;
    struct quant q;
    sample(i, &g);
    enum err_code rc = quant_from_gauss(&g, g.sh_degree, NULL, &q, NULL);
    if (rc)
        goto out;
    if (!strcmp(target, "ply"))
        rc = i == 0   ? text_ply(out)
             : i == 1 ? ply_encode(&g, NULL, out, NULL)
                      : ply_packed_encode(&g, g.sh_degree, NULL, out, NULL);
    else if (!strcmp(target, "spz"))
        rc = spz_encode(&q, i == 2 ? 4 : 3, out, NULL);
    else if (!strcmp(target, "drc"))
        rc = draco_encode(&q, "1/2/3", out, NULL);
    else if (!strcmp(target, "glb"))
        rc = i == 2 ? glb_encode_spz(&q, "c", out, NULL) : glb_encode_plain(&g, NULL, out, NULL);
    else if (!strcmp(target, "sog"))
        rc = sog_encode(&g, g.sh_degree, out, NULL);
    else if (!strcmp(target, "ckpt"))
        rc = fuzz_seed_ckpt(&g, out) ? ERR_OK : ERR_IO;
    else if (!strcmp(target, "payload"))
        rc = payload_encode(&g, i == 0, out, NULL);
    else
        rc = ERR_NOENT;
out:
    quant_free(&q);
    gauss_free(&g);
    return rc;
}

static enum err_code appearance_seed(size_t i, struct buf *out)
{
    struct appearance a;
    enum err_code rc = appearance_alloc(&a, 1 + 3 * (uint32_t)i, 2, 3, 2 * i, NULL);
    assert(!rc);
    appearance_init(&a, i);
    for (size_t k = 0; k < a.n_images; k++)
        memset(a.names[k], 'a', 1 + k);
    rc = appearance_write(&a, out, NULL);
    appearance_free(&a);
    return rc;
}

bool fuzz_seed(const char *target, size_t i, struct buf *out)
{
    if (!strcmp(target, "appearance"))
        return appearance_seed(i, out) == ERR_OK;
    if (!strcmp(target, "colmap"))
        return fuzz_seed_colmap(i, out);
    if (!strcmp(target, "odm"))
        return fuzz_seed_odm(i, out);
    if (!strcmp(target, "geojson"))
        return fuzz_seed_geojson(i, out);
    if (!strcmp(target, "tensors"))
        return tensors_seed(i, out) == ERR_OK;
    if (!strcmp(target, "seen"))
        return seen_seed(i, out) == ERR_OK;
    if (!strcmp(target, "npy"))
        return npy_seed(i, out) == ERR_OK;
    if (!strcmp(target, "exif"))
        return exif_seed(i, out) == ERR_OK;
    if (!strcmp(target, "splat")) {
        for (uint64_t k = 0; k < 32 * (i + 1); k++)
            buf_u8(out, k % 4 == 3 && k % 32 < 24 ? 0x3f : (unsigned)rng_u64(9, i, k) & 127);
        return !out->failed;
    }
    if (fuzz_seed_serve(target, i, out))
        return true;
    return gauss_seed(target, i, out) == ERR_OK;
}

static unsigned corpus_digit(uint8_t c)
{
    return c <= '9' ? c - (unsigned)'0' : c - (unsigned)'a' + 10;
}

size_t fuzz_corpus_line(const struct buf *corpus, size_t at, struct buf *out)
{
    const uint8_t *p = corpus->data;
    out->size = 0;
    for (; at < corpus->size && p[at] != '\n'; at++)
        if (p[at] == '\\' && at + 3 < corpus->size) {
            buf_u8(out, 16 * corpus_digit(p[at + 2]) + corpus_digit(p[at + 3]));
            at += 3;
        } else {
            buf_u8(out, p[at]);
        }
    return at + 1;
}
