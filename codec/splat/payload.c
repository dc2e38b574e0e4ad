/* The payload of a tile. The store keeps it, and all formats are made from it.
 *
 *     0  "CSPT"    4 u16 version 1   6 u8 flags  7 u8 SH degree
 *     8  u32 count  12 u32 embedding length  16 f64 origin e, n, u
 *     40 u64 plain bytes  48 zstd frame, nothing behind it
 *     plain: planes mean | scale | rotation | opacity | sh | embed
 *
 * Means are float32 about the origin. All else is float16, with harmonics rounded to multiples of
 * 2^-9. With the flag LOSSLESS all else is float32, so that import and export give every value
 * back. A plane is stored component by component, and a component byte by byte. Each byte is the
 * difference from the row before. Rows that are close on the curve share their high bytes, so zstd
 * compresses them well.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/payload.h"
#include "codec/limits.h"
#include "core/layout.h"
#include "core/math/simd.h"

#include <assert.h>
#include <math.h>
#include <string.h>
#include <zstd.h>

enum {
    VERSION = 1,
    HEAD_BYTES = 48,
    FLAG_LOSSLESS = 1,
    FLAG_ANTIALIASED = 2,
    ZSTD_BLOCK_LEAST = 4096, /* below, a table of its own costs more than it saves */
    ZSTD_GROWTH_MAX = 32768, /* 128 KiB out of a block of 4 bytes */
    BLOCK_ROWS = 128,
    WIDTH_MAX = GAUSS_EMBED_MAX, /* of a plane; SH has 48 */
};

#define UNIT_TOLERANCE 1e-3f /* four halves of 2^-12 are within 0.5e-3 */
/* Of a coefficient of harmonics: rms 0.16 of 255 in the colour of a Gaussian, a quarter of the step
 * of the finest integers that are served. What lies below is noise of training, two fifths of a
 * store. */
#define SH_STEP 0x1p-9f

enum { MEAN, SCALE, QUAT, OPACITY, SH, EMBED, N_PLANES };

struct plane {
    float *data; /* [n][width] */
    size_t width, value_bytes;
    bool sh; /* harmonics */
};

static void payload_planes_of(const struct gauss *g, bool lossless, struct plane out[N_PLANES])
{
    size_t rest = lossless ? 4 : 2;
    out[MEAN] = (struct plane){g->mean_m, 3, 4, false};
    out[SCALE] = (struct plane){g->scale_log, 3, rest, false};
    out[QUAT] = (struct plane){g->quat_wxyz, 4, rest, false};
    out[OPACITY] = (struct plane){g->opacity_logit, 1, rest, false};
    out[SH] = (struct plane){g->sh, 3 * gauss_sh_count(g->sh_degree), rest, true};
    out[EMBED] = (struct plane){g->embed, g->embed_len, rest, false};
}

static size_t payload_plain_bytes(const struct gauss *g, bool lossless)
{
    struct plane p[N_PLANES];
    size_t row = 0;
    payload_planes_of(g, lossless, p);
    for (int i = 0; i < N_PLANES; i++)
        row += p[i].width * p[i].value_bytes;
    return g->n * row;
}

SIMD_INLINE uint32_t bits_of(float v)
{
    uint32_t u;
    memcpy(&u, &v, 4);
    return u;
}

SIMD_INLINE float float_of(uint32_t u)
{
    float v;
    memcpy(&v, &u, 4);
    return v;
}

/* IEEE binary16, round to nearest even; finite values beyond its range become the largest. No
 * branches, so that a compiler makes vectors of it. */
SIMD_INLINE uint32_t float16_from_float(float v)
{
    uint32_t u = bits_of(v), sign = u >> 16 & 0x8000, a = u & 0x7fffffff;
    a = a < 0x477fe000 ? a : 0x477fe000; /* 65504 */
    uint32_t normal = (a + 0xfff + (a >> 13 & 1) - 0x38000000) >> 13;
    /* Below 2^-14 a multiple of 2^-24, which is the last place of 0.5: the sum rounds. */
    uint32_t tiny = bits_of(float_of(a) + 0.5f) - 0x3f000000;
    return sign | (a < 0x38800000 ? tiny : normal);
}

SIMD_INLINE float float16_to_float(uint32_t h)
{
    /* A product moves the exponent's bias, which makes subnormals right as well. Infinities are
     * never written; damaged bytes that hold one read as 65536 or more. */
    float v = float_of((h & 0x7fff) << 13) * 0x1p112f;
    return float_of(bits_of(v) | (h & 0x8000) << 16);
}

/* The nearest multiple of SH_STEP, of two the even one: the sum has no place for what is finer. */
SIMD_INLINE float sh_rounded(float v)
{
    const float far = 0x1.8p23f * SH_STEP;
    return (v + far) - far;
}

/* Rows are taken in blocks that stay in the nearest cache while all components pass over them: a
 * component of SH by itself would touch a cache line a row. */
SIMD_INLINE bool plane_write_of(const struct plane *p, size_t n, uint8_t *out,
                                const size_t value_bytes)
{
    uint32_t before[WIDTH_MAX] = {0}, value[BLOCK_ROWS + 1], most = 0;
    const size_t width = p->width;
    for (size_t at = 0; at < n; at += BLOCK_ROWS) {
        const size_t rows = n - at < BLOCK_ROWS ? n - at : BLOCK_ROWS;
        for (size_t k = 0; at + 2 * BLOCK_ROWS <= n && k < BLOCK_ROWS * width; k += 16)
            SIMD_SOON(p->data + (at + BLOCK_ROWS) * width + k);
        for (size_t c = 0; c < width; c++) {
            const float *in = p->data + at * width + c;
            uint8_t *bytes = out + c * value_bytes * n + at;
            float v[BLOCK_ROWS];
            for (size_t i = 0; i < rows; i++)
                v[i] = in[i * width];
            for (size_t i = 0; i < rows; i++) {
                uint32_t a = bits_of(v[i]) & 0x7fffffff;
                most = a > most ? a : most;
            }
            for (size_t i = 0; value_bytes == 2 && p->sh && i < rows; i++)
                v[i] = sh_rounded(v[i]);
            value[0] = before[c];
            for (size_t i = 0; i < rows; i++)
                value[i + 1] = value_bytes == 4 ? bits_of(v[i]) : float16_from_float(v[i]);
            for (size_t b = 0; b < value_bytes; b++, bytes += n)
                for (size_t i = 0; i < rows; i++)
                    bytes[i] = (uint8_t)((value[i + 1] >> 8 * b) - (value[i] >> 8 * b));
            before[c] = value[rows];
        }
    }
    return most < 0x7f800000;
}

SIMD_WIDE static bool payload_plane_write4(const struct plane *p, size_t n, uint8_t *out)
{
    return plane_write_of(p, n, out, 4);
}

SIMD_WIDE static bool payload_plane_write2(const struct plane *p, size_t n, uint8_t *out)
{
    return plane_write_of(p, n, out, 2);
}

/* False when a value is not finite; what is written then is of no use. */
static bool payload_plane_write(const struct plane *p, size_t n, uint8_t *out)
{
    return (p->value_bytes == 4 ? payload_plane_write4 : payload_plane_write2)(p, n, out);
}

typedef uint8_t bytes16 __attribute__((vector_size(16)));
/* The bytes of x moved up by `by` places, below them those of a vector of zeros. */
#define BYTES_UP(x, by)                                                                            \
    __builtin_shufflevector((bytes16){0}, x, 16 - (by), 17 - (by), 18 - (by), 19 - (by),           \
                            20 - (by), 21 - (by), 22 - (by), 23 - (by), 24 - (by), 25 - (by),      \
                            26 - (by), 27 - (by), 28 - (by), 29 - (by), 30 - (by), 31 - (by))

/* Sums of all bytes before and of each, sixteen at a time. */
SIMD_INLINE void sum_bytes(const uint8_t *in, size_t n, uint8_t *last, uint8_t *out)
{
    bytes16 before = (bytes16){0} + *last;
    size_t i = 0;
    for (; i + 16 <= n; i += 16) {
        bytes16 x;
        memcpy(&x, in + i, sizeof x);
        x += BYTES_UP(x, 1);
        x += BYTES_UP(x, 2);
        x += BYTES_UP(x, 4);
        x += BYTES_UP(x, 8);
        x += before;
        memcpy(out + i, &x, sizeof x);
        before = __builtin_shufflevector(x, x, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15,
                                         15, 15, 15);
    }
    uint8_t v = before[0];
    for (; i < n; i++)
        out[i] = v = (uint8_t)(v + in[i]);
    *last = v;
}

/* Bytes of some rows of a component, whose bytes of all `n` rows follow each other. last: the bytes
 * of the row before, then of the last one. */
SIMD_INLINE void component_sum(const uint8_t *bytes, size_t n, size_t rows, uint8_t last[4],
                               const size_t value_bytes, uint8_t byte[4][BLOCK_ROWS])
{
    for (size_t b = 0; b < value_bytes; b++, bytes += n) {
        /* More streams of bytes than the hardware follows. Beyond the last it does no harm. */
        for (size_t k = 0; k < BLOCK_ROWS; k += 64)
            SIMD_SOON(bytes + 2 * BLOCK_ROWS - 1 - k);
        sum_bytes(bytes, rows, &last[b], byte[b]);
    }
}

SIMD_INLINE void component_read(const uint8_t *bytes, size_t n, size_t rows, uint8_t last[4],
                                const size_t value_bytes, float v[BLOCK_ROWS])
{
    uint8_t byte[4][BLOCK_ROWS];
    component_sum(bytes, n, rows, last, value_bytes, byte);
    if (value_bytes == 4)
        for (size_t i = 0; i < rows; i++)
            v[i] = float_of(byte[0][i] | (uint32_t)byte[1][i] << 8 | (uint32_t)byte[2][i] << 16 |
                            (uint32_t)byte[3][i] << 24);
    else
        for (size_t i = 0; i < rows; i++)
            v[i] = float16_to_float(byte[0][i] | (uint32_t)byte[1][i] << 8);
}

/* The same as halves. *most: see struct placing. */
SIMD_INLINE void component_read_halves(const uint8_t *bytes, size_t n, size_t rows, uint8_t last[4],
                                       const size_t value_bytes, uint16_t v[BLOCK_ROWS],
                                       uint32_t *most)
{
    uint8_t byte[4][BLOCK_ROWS];
    component_sum(bytes, n, rows, last, value_bytes, byte);
    if (value_bytes == 4)
        for (size_t i = 0; i < rows; i++) {
            uint32_t u = byte[0][i] | (uint32_t)byte[1][i] << 8 | (uint32_t)byte[2][i] << 16 |
                         (uint32_t)byte[3][i] << 24;
            *most = (u & 0x7fffffff) > *most ? u & 0x7fffffff : *most;
            v[i] = (uint16_t)float16_from_float(float_of(u));
        }
    else
        for (size_t i = 0; i < rows; i++)
            v[i] = (uint16_t)(byte[0][i] | byte[1][i] << 8);
}

SIMD_INLINE void plane_read_of(const struct plane *p, size_t n, const uint8_t *in,
                               const size_t value_bytes)
{
    uint8_t last[WIDTH_MAX][4] = {{0}};
    const size_t width = p->width;
    for (size_t at = 0; at < n; at += BLOCK_ROWS) {
        const size_t rows = n - at < BLOCK_ROWS ? n - at : BLOCK_ROWS;
        for (size_t c = 0; c < width; c++) {
            float *out = p->data + at * width + c, v[BLOCK_ROWS];
            component_read(in + c * value_bytes * n + at, n, rows, last[c], value_bytes, v);
            for (size_t i = 0; i < rows; i++)
                out[i * width] = v[i];
        }
    }
}

SIMD_WIDE static void payload_plane_read4(const struct plane *p, size_t n, const uint8_t *in)
{
    plane_read_of(p, n, in, 4);
}

SIMD_WIDE static void payload_plane_read2(const struct plane *p, size_t n, const uint8_t *in)
{
    plane_read_of(p, n, in, 2);
}

static void payload_plane_read(const struct plane *p, size_t n, const uint8_t *in)
{
    (p->value_bytes == 4 ? payload_plane_read4 : payload_plane_read2)(p, n, in);
}

SIMD_WIDE void payload_to_float16(const float *in, size_t n, uint16_t *out)
{
    for (size_t i = 0; i < n; i++)
        out[i] = (uint16_t)float16_from_float(in[i]);
}

SIMD_WIDE void payload_round_sh(float *sh, size_t n)
{
    for (size_t i = 0; i < n; i++)
        sh[i] = sh_rounded(sh[i]);
}

SIMD_WIDE void payload_from_float16(const uint16_t *in, size_t n, float *out)
{
    for (size_t i = 0; i < n; i++)
        out[i] = float16_to_float(in[i]);
}

/* Of unit length, because half floats would lose those far from it. Those that are half floats
 * already, of unit length but for their rounding, stay as they are: the rows of a payload give the
 * same payload again. */
void payload_unit_quat(const float r[4], float out[4])
{
    float a = fabsf(r[0]), b = fabsf(r[1]), c = fabsf(r[2]), d = fabsf(r[3]);
    float ab = a > b ? a : b, cd = c > d ? c : d, big = ab > cd ? ab : cd;
    float s[4] = {r[0] / big, r[1] / big, r[2] / big, r[3] / big};
    float norm = sqrtf(s[0] * s[0] + s[1] * s[1] + s[2] * s[2] + s[3] * s[3]);
    uint32_t low = (bits_of(r[0]) | bits_of(r[1]) | bits_of(r[2]) | bits_of(r[3])) & 0x1fff;
    bool keep = low == 0 && fabsf(norm * big - 1) < UNIT_TOLERANCE; /* 10 bits of mantissa */
    for (int k = 0; k < 4; k++)
        out[k] = keep ? r[k] : s[k] / norm;
}

/* mem_free it. */
static float *payload_unit_quats(const struct gauss *g)
{
    float *q = mem_uninit(4 * g->n, sizeof *q);
    for (size_t i = 0; q && i < g->n; i++)
        payload_unit_quat(g->quat_wxyz + 4 * i, q + 4 * i);
    return q;
}

static size_t payload_pack_bound(size_t n)
{
    return ZSTD_compressBound(n) + n / ZSTD_BLOCK_LEAST * 16 + 64; /* heads of blocks */
}

/* One zstd frame, a block ending where a plane of `rows` bytes does. Matches are few, so they are
 * looked for in a table that fits the nearest cache. *room: of out, then what is used. */
static enum err_code payload_pack(const uint8_t *plain, size_t n, size_t rows, uint8_t *out,
                                  size_t *room, struct err *e)
{
    static const struct {
        ZSTD_cParameter name;
        int value;
    } set[] = {{ZSTD_c_compressionLevel, 1},
               {ZSTD_c_strategy, ZSTD_fast},
               {ZSTD_c_windowLog, 17},
               {ZSTD_c_hashLog, 8},
               {ZSTD_c_minMatch, 7}};
    ZSTD_CCtx *c = ZSTD_createCCtx();
    ZSTD_outBuffer to = {out, *room, 0};
    size_t bad = c ? ZSTD_CCtx_setPledgedSrcSize(c, n) : 0;
    for (size_t i = 0; c && !ZSTD_isError(bad) && i < sizeof set / sizeof *set; i++)
        bad = ZSTD_CCtx_setParameter(c, set[i].name, set[i].value);
    for (size_t at = 0, next = 0; c && !ZSTD_isError(bad) && at < n; at = next) {
        while (next < n && next - at < ZSTD_BLOCK_LEAST)
            next += rows;
        ZSTD_inBuffer from = {plain + at, next - at, 0};
        bad = ZSTD_compressStream2(c, &to, &from, next < n ? ZSTD_e_flush : ZSTD_e_end);
    }
    if (c && !n && !ZSTD_isError(bad)) {
        ZSTD_inBuffer none = {plain, 0, 0};
        bad = ZSTD_compressStream2(c, &to, &none, ZSTD_e_end);
    }
    ZSTD_freeCCtx(c);
    *room = to.pos;
    /* There is room for the bound of all blocks, so one call finishes each. */
    return c && bad == 0 ? ERR_OK
                         : err_set(e, ERR_MEM, "payload: zstd: %s",
                                   c ? ZSTD_getErrorName(bad) : "out of memory");
}

enum err_code payload_encode(const struct gauss *g, bool lossless, struct buf *out, struct err *e)
{
    struct buf plain = {0};
    struct plane planes[N_PLANES];
    float *quats = NULL;
    size_t bad = 0, start = out->size, bytes = payload_plain_bytes(g, lossless);
    bool good = true;
    if (g->n > UINT32_MAX)
        return err_set(e, ERR_LIMIT, "payload: %zu Gaussians in one tile", g->n);
    buf_add(out, "CSPT", 4);
    buf_u16(out, VERSION);
    buf_u8(out, (lossless ? FLAG_LOSSLESS : 0u) | (g->antialiased ? FLAG_ANTIALIASED : 0u));
    buf_u8(out, g->sh_degree);
    buf_u32(out, (uint32_t)g->n);
    buf_u32(out, g->embed_len);
    for (int c = 0; c < 3; c++)
        buf_f64(out, g->origin_enu_m[c]);
    buf_u64(out, bytes);
    uint8_t *p = buf_grow(&plain, bytes);
    size_t bound = payload_pack_bound(bytes), at = out->size;
    uint8_t *packed = buf_grow(out, bound);
    enum err_code rc = buf_check(&plain, e);
    if (!rc)
        rc = buf_check(out, e);
    if (!rc && !lossless && !(quats = payload_unit_quats(g)))
        rc = err_set(e, ERR_MEM, "payload: %zu Gaussians: out of memory", g->n);
    if (!rc) {
        payload_planes_of(g, lossless, planes);
        if (quats)
            planes[QUAT].data = quats;
        for (int i = 0; i < N_PLANES; i++) {
            good = payload_plane_write(&planes[i], g->n, p) && good;
            p += g->n * planes[i].width * planes[i].value_bytes;
        }
        /* A rotation of 0 has become NaN, but not where it is kept as it is. */
        if ((!good || lossless) && gauss_count_bad(g, &bad))
            rc = err_set(e, ERR_DATA, "payload: row %zu: not finite, or no rotation", bad);
    }
    if (!rc) {
        rc = payload_pack(plain.data, bytes, g->n, packed, &bound, e);
        out->size = at + bound;
    }
    if (rc)
        out->size = start;
    mem_free(quats);
    buf_free(&plain);
    return rc;
}

/* Head of a payload into g (n, degree, embedding, flags, origin; no arrays) and its plain size,
 * checked against the limits and against what n bytes of zstd can hold. */
static enum err_code payload_head_read(struct cursor *c, const struct codec_limits *lim,
                                       struct gauss *g, bool *lossless, size_t *plain,
                                       struct err *e)
{
    const uint8_t *magic = cursor_take(c, 4);
    unsigned version = cursor_u16(c), flags = cursor_u8(c);
    g->sh_degree = cursor_u8(c);
    g->n = cursor_u32(c);
    g->embed_len = cursor_u32(c);
    for (int i = 0; i < 3; i++)
        g->origin_enu_m[i] = cursor_f64(c);
    uint64_t bytes = cursor_u64(c);
    if (c->bad || memcmp(magic, "CSPT", 4))
        return err_set(e, ERR_FORMAT, "payload: not a tile payload, or truncated in its head");
    if (version != VERSION)
        return err_set(e, ERR_FORMAT, "payload: version %u: this program reads %d", version,
                       VERSION);
    if (g->sh_degree > GAUSS_SH_DEGREE_MAX || g->embed_len > GAUSS_EMBED_MAX ||
        flags & ~(unsigned)(FLAG_LOSSLESS | FLAG_ANTIALIASED) || !isfinite(g->origin_enu_m[0]) ||
        !isfinite(g->origin_enu_m[1]) || !isfinite(g->origin_enu_m[2]))
        return err_set(e, ERR_FORMAT, "payload: head is damaged");
    *lossless = flags & FLAG_LOSSLESS;
    g->antialiased = flags & FLAG_ANTIALIASED;
    *plain = payload_plain_bytes(g, *lossless);
    size_t most = lim && lim->max_gaussians ? lim->max_gaussians : CODEC_MAX_GAUSSIANS;
    size_t most_bytes = lim && lim->max_bytes ? lim->max_bytes : CODEC_MAX_BYTES;
    if (g->n > most || *plain > most_bytes)
        return err_set(e, ERR_LIMIT,
                       "payload: %zu Gaussians, %zu bytes: the limits are %zu and %zu", g->n,
                       *plain, most, most_bytes);
    if (bytes != *plain || *plain / ZSTD_GROWTH_MAX > cursor_left(c))
        return err_set(e, ERR_FORMAT, "payload: %zu Gaussians do not fit its %zu bytes", g->n,
                       cursor_left(c));
    return ERR_OK;
}

static enum err_code payload_unpack(struct payload *p, const struct cursor *c, size_t n_plain,
                                    struct err *e)
{
    p->plain.size = 0;
    uint8_t *to = buf_grow(&p->plain, n_plain);
    enum err_code rc = buf_check(&p->plain, e);
    if (!rc && !p->zstd && !(p->zstd = ZSTD_createDCtx()))
        rc = err_set(e, ERR_MEM, "payload: zstd: out of memory");
    if (rc)
        return rc;
    size_t got = ZSTD_decompressDCtx(p->zstd, to, n_plain, c->p, cursor_left(c));
    if (ZSTD_isError(got) || got != n_plain)
        rc = err_set(e, ERR_FORMAT, "payload: zstd: %s",
                     ZSTD_isError(got) ? ZSTD_getErrorName(got) : "too short");
    return rc;
}

enum err_code payload_open(struct payload *p, const void *bytes, size_t n,
                           const struct codec_limits *lim, struct err *e)
{
    struct gauss head = {0};
    size_t n_plain = 0;
    struct cursor c = cursor_over(bytes, n);
    p->n = 0;
    enum err_code rc = payload_head_read(&c, lim, &head, &p->lossless, &n_plain, e);
    if (!rc)
        rc = payload_unpack(p, &c, n_plain, e);
    if (rc)
        return rc;
    p->n = head.n;
    p->sh_degree = head.sh_degree;
    p->embed_len = head.embed_len;
    p->antialiased = head.antialiased;
    memcpy(p->origin_enu_m, head.origin_enu_m, sizeof p->origin_enu_m);
    return ERR_OK;
}

void payload_free(struct payload *p)
{
    buf_free(&p->plain);
    ZSTD_freeDCtx(p->zstd);
    *p = (struct payload){0};
}

enum err_code payload_gauss(const struct payload *p, struct gauss *out, struct err *e)
{
    struct plane planes[N_PLANES];
    const uint8_t *from = p->plain.data;
    size_t bad = 0;
    enum err_code rc = gauss_uninit(out, p->n, p->sh_degree, p->embed_len, e);
    if (rc)
        return rc;
    out->n = p->n;
    out->antialiased = p->antialiased;
    memcpy(out->origin_enu_m, p->origin_enu_m, sizeof out->origin_enu_m);
    payload_planes_of(out, p->lossless, planes);
    for (int i = 0; i < N_PLANES; i++) {
        payload_plane_read(&planes[i], out->n, from);
        from += out->n * planes[i].width * planes[i].value_bytes;
    }
    if (gauss_count_bad(out, &bad)) {
        rc = err_set(e, ERR_FORMAT, "payload: row %zu: not finite, or no rotation", bad);
        gauss_free(out);
    }
    return rc;
}

enum err_code payload_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                             struct gauss *out, struct err *e)
{
    struct payload p = {0};
    *out = (struct gauss){0};
    enum err_code rc = payload_open(&p, bytes, n, lim, e);
    if (!rc)
        rc = payload_gauss(&p, out, e);
    payload_free(&p);
    return rc;
}

/* ---- straight into drawn rows ---- */

SIMD_INLINE void sizes_of(const uint8_t *in, size_t n, float *out, const size_t value_bytes)
{
    uint8_t last[3][4] = {{0}};
    for (size_t at = 0; at < n; at += BLOCK_ROWS) {
        const size_t rows = n - at < BLOCK_ROWS ? n - at : BLOCK_ROWS;
        float v[3][BLOCK_ROWS];
        for (size_t c = 0; c < 3; c++)
            component_read(in + c * value_bytes * n + at, n, rows, last[c], value_bytes, v[c]);
        for (size_t i = 0; i < rows; i++) {
            float big = v[0][i] > v[1][i] ? v[0][i] : v[1][i];
            out[at + i] = big > v[2][i] ? big : v[2][i];
        }
    }
}

SIMD_WIDE static void payload_sizes4(const uint8_t *in, size_t n, float *out)
{
    sizes_of(in, n, out, 4);
}

SIMD_WIDE static void payload_sizes2(const uint8_t *in, size_t n, float *out)
{
    sizes_of(in, n, out, 2);
}

void payload_sizes(const struct payload *p, float *out)
{
    const size_t means = p->n * 3 * sizeof(float);
    (p->lossless ? payload_sizes4 : payload_sizes2)(p->plain.data + means, p->n, out);
}

/* Some rows on their way: those from `at` on. */
struct placing {
    size_t n, at, rows;
    float *to[BLOCK_ROWS];       /* plane 0 of each */
    uint8_t *halves[BLOCK_ROWS]; /* the first of its halves, if there are any */
    float norm2[BLOCK_ROWS];
    uint32_t most; /* of the bits of float32, without sign */
};

SIMD_INLINE void placing_rows(struct placing *s, const struct payload_target *t, uint32_t planes)
{
    const unsigned shift = (unsigned)__builtin_ctzll(t->block_rows);
    for (size_t i = 0; i < s->rows; i++) {
        size_t k = t->place[s->at + i], in_block = k & (t->block_rows - 1);
        s->to[i] = t->block[k >> shift] + layout_at(in_block, planes);
        s->halves[i] = (uint8_t *)(s->to[i] + LAYOUT_PLANE_SH * LAYOUT_LANES) -
                       in_block % LAYOUT_LANES * sizeof(uint16_t);
    }
}

SIMD_INLINE void placing_store(const struct placing *s, size_t plane, const float *v)
{
    for (size_t i = 0; i < s->rows; i++)
        s->to[i][plane * LAYOUT_LANES] = v[i];
}

SIMD_INLINE void placing_look(struct placing *s, const float *v)
{
    for (size_t i = 0; i < s->rows; i++) {
        uint32_t a = bits_of(v[i]) & 0x7fffffff;
        s->most = a > s->most ? a : s->most;
    }
}

/* Harmonics as halves: `width` components of them. */
SIMD_INLINE void placing_halves(struct placing *s, const uint8_t *in, size_t width,
                                uint8_t (*last)[4], const size_t value_bytes)
{
    uint16_t v[BLOCK_ROWS];
    for (size_t c = 0; c < width; c++, in += value_bytes * s->n) {
        component_read_halves(in + s->at, s->n, s->rows, last[c], value_bytes, v, &s->most);
        for (size_t i = 0; i < s->rows; i++)
            memcpy(s->halves[i] + c * LAYOUT_LANES * sizeof *v, &v[i], sizeof *v);
    }
}

/* `width` components of other planes, from `plane` on. value_bytes: of each of their values. */
SIMD_INLINE void placing_words(struct placing *s, const uint8_t *in, size_t plane, size_t width,
                               uint8_t (*last)[4], const size_t value_bytes)
{
    float v[BLOCK_ROWS];
    for (size_t c = 0; c < width; c++, plane++, in += value_bytes * s->n) {
        component_read(in + s->at, s->n, s->rows, last[c], value_bytes, v);
        if (value_bytes == 4)
            placing_look(s, v);
        if (plane >= LAYOUT_PLANE_QUAT && plane < LAYOUT_PLANE_OPACITY)
            for (size_t i = 0; i < s->rows; i++)
                s->norm2[i] += v[i] * v[i];
        placing_store(s, plane, v);
    }
}

/* The planes behind the means. */
SIMD_INLINE void placing_rest(struct placing *s, const uint8_t *in, const struct payload *p,
                              const struct payload_target *t, uint8_t (*last)[4],
                              const size_t value_bytes, const bool halves)
{
    const size_t shape = LAYOUT_PLANE_SH - LAYOUT_PLANE_SCALE,
                 sh = 3 * gauss_sh_count(p->sh_degree), row = value_bytes * s->n;
    for (size_t i = 0; i < s->rows; i++)
        s->norm2[i] = 0.0f;
    if (halves) {
        placing_words(s, in, LAYOUT_PLANE_SCALE, shape, last, value_bytes);
        placing_halves(s, in + shape * row, sh, last + shape, value_bytes);
        placing_words(s, in + (shape + sh) * row, layout_planes_halves(p->sh_degree, 0),
                      t->embed_len, last + shape + sh, value_bytes);
    } else {
        placing_words(s, in, LAYOUT_PLANE_SCALE, shape + sh + t->embed_len, last, value_bytes);
    }
}

/* False if a value is not finite or a rotation is 0. */
SIMD_INLINE bool place_of(const struct payload *p, const struct payload_target *t,
                          const size_t value_bytes, const bool halves)
{
    enum { REST_MAX = LAYOUT_PLANE_SH - LAYOUT_PLANE_SCALE + 3 * LAYOUT_SH_MAX + GAUSS_EMBED_MAX };
    const uint32_t planes =
        (halves ? layout_planes_halves : layout_planes)(p->sh_degree, t->embed_len);
    const uint8_t *in = p->plain.data;
    uint8_t last_mean[3][4] = {{0}}, last[REST_MAX][4] = {{0}};
    float v[BLOCK_ROWS], least = INFINITY;
    struct placing s = {.n = p->n};
    for (; s.at < s.n; s.at += BLOCK_ROWS) {
        s.rows = s.n - s.at < BLOCK_ROWS ? s.n - s.at : BLOCK_ROWS;
        placing_rows(&s, t, planes);
        for (size_t k = 0; k < 3; k++) {
            const double shift = p->origin_enu_m[k] - t->origin_enu_m[k];
            component_read(in + k * 4 * s.n + s.at, s.n, s.rows, last_mean[k], 4, v);
            placing_look(&s, v);
            for (size_t i = 0; i < s.rows; i++)
                v[i] = (float)((double)v[i] + shift);
            placing_store(&s, LAYOUT_PLANE_MEAN + k, v);
        }
        placing_rest(&s, in + 3 * 4 * s.n, p, t, last, value_bytes, halves);
        for (size_t i = 0; i < s.rows; i++)
            least = s.norm2[i] < least ? s.norm2[i] : least;
    }
    return s.most < 0x7f800000 && (least > 0.0f || s.n == 0);
}

SIMD_WIDE static bool payload_place4(const struct payload *p, const struct payload_target *t)
{
    return place_of(p, t, 4, false);
}

SIMD_WIDE static bool payload_place2(const struct payload *p, const struct payload_target *t)
{
    return place_of(p, t, 2, false);
}

SIMD_WIDE static bool payload_place_halves4(const struct payload *p, const struct payload_target *t)
{
    return place_of(p, t, 4, true);
}

SIMD_WIDE static bool payload_place_halves2(const struct payload *p, const struct payload_target *t)
{
    return place_of(p, t, 2, true);
}

enum err_code payload_place(const struct payload *p, const struct payload_target *to, struct err *e)
{
    static bool (*const place[2][2])(const struct payload *, const struct payload_target *) = {
        {payload_place2, payload_place_halves2}, {payload_place4, payload_place_halves4}};
    struct gauss rows;
    assert(!to->embed_len || to->embed_len == p->embed_len);
    assert(to->block_rows % LAYOUT_LANES == 0 && !(to->block_rows & (to->block_rows - 1)));
    if (place[p->lossless][to->sh_halves](p, to))
        return ERR_OK;
    enum err_code rc = payload_gauss(p, &rows, e); /* says which row */
    gauss_free(&rows);
    return rc ? rc : err_set(e, ERR_FORMAT, "payload: not finite, or no rotation");
}
