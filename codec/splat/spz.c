/* .spz: Gaussians as byte streams, compressed by gzip (versions 1 to 3) or zstd (version 4).
 *
 *     v1 - v3  gzip( head of 16 bytes | streams back to back )
 *     v4       head of 32 bytes | (packed, plain) size of each stream | a zstd frame each
 *     head     magic, version, count, SH degree, fraction bits, flags, 0 or number of streams;
 *              v4: where the sizes are, 12 * 0
 *     streams  position 9n (v1: 6n), alpha n, color 3n, scale 3n, rotation 4n (v1, v2: 3n),
 *              sh 3n(K-1)
 *
 * gzip is libdeflate's, which is twice as fast as zlib. Sizes are bounded by the file's size before
 * anything is allocated: DEFLATE cannot expand data more than 1032 times, and zstd not more than
 * 128 KiB a block of 4 bytes. Extensions (flag 2), type, length and payload each, stand between the
 * head and the sizes, or behind the streams. Of those of others one is read: SPZ_ADOBE_coordinate_
 * system, the axes. Version 1 has positions of 16-bit floats. Source: github.com/nianticlabs/spz.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/spz.h"
#include "codec/limits.h"
#include "codec/splat/quant.h"

#include <libdeflate.h>
#include <math.h>
#include <string.h>
#include <zstd.h>

enum {
    MAGIC = 0x5053474e, /* "NGSP" */
    HEAD_BYTES = 16,
    HEAD4_BYTES = 32,
    N_STREAMS = 6,
    FRACTION_BITS_MAX = 23,
    FLAG_ANTIALIASED = 1,
    FLAG_EXTENSIONS = 2,
    GZIP_LEVEL = 3, /* 1 to 3 % larger than 6, three times as fast */
    ZSTD_LEVEL = 6, /* 3 % larger than 12, four times as fast */
    DEFLATE_GROWTH_MAX = 1032,
    ZSTD_GROWTH_MAX = 32768,
    POSITION_LIMIT = 1 << 23,
    AXES_TYPE = (int)0xadbe0003,
};

struct spz_head {
    uint32_t version, n, sh_degree, fraction_bits, flags, n_streams, toc;
    uint32_t axes; /* of the record of axes: SPZ_RUB and others; 0: none */
};

static size_t spz_stream_bytes(const struct spz_head *h, int stream)
{
    const size_t row[N_STREAMS] = {h->version == 1 ? 6 : 9,
                                   1,
                                   3,
                                   3,
                                   h->version <= 2 ? 3 : 4,
                                   3 * (gauss_sh_count(h->sh_degree) - 1)};
    return h->n * row[stream];
}

static void spz_put_i24(uint8_t *p, int32_t v)
{
    p[0] = (uint8_t)v;
    p[1] = (uint8_t)((uint32_t)v >> 8);
    p[2] = (uint8_t)((uint32_t)v >> 16);
}

static int32_t spz_get_i24(const uint8_t *p)
{
    uint32_t v = p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16;
    return (int32_t)(v ^ 0x800000) - 0x800000;
}

/* ---- encode ---- */

static void spz_streams_write(const struct quant *q, uint8_t *p)
{
    for (size_t i = 0; i < 3 * q->n; i++, p += 3)
        spz_put_i24(p, q->position[i]);
    memcpy(p, q->alpha, q->n);
    memcpy(p += q->n, q->color, 3 * q->n);
    memcpy(p += 3 * q->n, q->scale, 3 * q->n);
    p += 3 * q->n;
    for (size_t i = 0; i < q->n; i++, p += 4)
        for (int b = 0; b < 4; b++)
            p[b] = (uint8_t)(q->rotation[i] >> 8 * b);
    memcpy(p, q->sh, 3 * (gauss_sh_count(q->sh_degree) - 1) * q->n);
}

static void spz_head_write(struct buf *b, const struct quant *q, int version, unsigned flags,
                           unsigned last)
{
    buf_u32(b, MAGIC);
    buf_u32(b, (uint32_t)version);
    buf_u32(b, (uint32_t)q->n);
    buf_u8(b, q->sh_degree);
    buf_u8(b, q->frac_bits);
    buf_u8(b, flags | (q->antialiased ? FLAG_ANTIALIASED : 0));
    buf_u8(b, last);
}

static enum err_code spz_gzip_write(const struct buf *plain, struct buf *out, struct err *e)
{
    struct libdeflate_compressor *c = libdeflate_alloc_compressor(GZIP_LEVEL);
    size_t start = out->size;
    size_t bound = c ? libdeflate_gzip_compress_bound(c, plain->size) : 0;
    uint8_t *p = c ? buf_grow(out, bound) : NULL;
    size_t n = p ? libdeflate_gzip_compress(c, plain->data, plain->size, p, bound) : 0;
    libdeflate_free_compressor(c);
    if (!n)
        return err_set(e, ERR_MEM, "spz: out of memory");
    out->size = start + n;
    return ERR_OK;
}

static enum err_code spz_zstd_write(const struct quant *q, const struct spz_head *h,
                                    const uint8_t *plain, struct buf *out, struct err *e)
{
    const int n_streams = q->sh_degree ? N_STREAMS : N_STREAMS - 1;
    spz_head_write(out, q, 4, 0, (unsigned)n_streams);
    buf_u32(out, HEAD4_BYTES);
    buf_add(out, (const uint8_t[12]){0}, 12);
    size_t toc = out->size, written[N_STREAMS] = {0};
    buf_grow(out, (size_t)n_streams * 16);
    for (int s = 0; s < n_streams; s++) {
        size_t n = spz_stream_bytes(h, s), at = out->size, bound = ZSTD_compressBound(n);
        uint8_t *p = buf_grow(out, bound);
        if (!p)
            return buf_check(out, e);
        written[s] = ZSTD_compress(p, bound, plain, n, ZSTD_LEVEL);
        if (ZSTD_isError(written[s]))
            return err_set(e, ERR_MEM, "spz: zstd: %s", ZSTD_getErrorName(written[s]));
        out->size = at + written[s];
        plain += n;
    }
    for (int s = 0; s < n_streams; s++)
        for (int b = 0; b < 8; b++) {
            out->data[toc + 16 * (size_t)s + b] = (uint8_t)((uint64_t)written[s] >> 8 * b);
            out->data[toc + 16 * (size_t)s + 8 + b] =
                (uint8_t)((uint64_t)spz_stream_bytes(h, s) >> 8 * b);
        }
    return ERR_OK;
}

enum err_code spz_encode(const struct quant *q, int version, struct buf *out, struct err *e)
{
    struct buf plain = {0};
    if (version != 3 && version != 4)
        return err_set(e, ERR_ARG, "spz: version %d: 3 and 4 are written", version);
    if (q->n > INT32_MAX || (version == 4 && !q->n))
        return err_set(e, ERR_LIMIT, "spz: %zu Gaussians: a file holds 1 to 2^31-1", q->n);
    struct spz_head h = {
        .version = (uint32_t)version, .n = (uint32_t)q->n, .sh_degree = q->sh_degree};
    size_t bytes = 0, start = out->size;
    for (int s = 0; s < N_STREAMS; s++)
        bytes += spz_stream_bytes(&h, s);
    if (version == 3)
        spz_head_write(&plain, q, 3, 0, 0);
    uint8_t *p = buf_grow(&plain, bytes);
    enum err_code rc = buf_check(&plain, e);
    if (!rc) {
        spz_streams_write(q, p);
        rc = version == 3 ? spz_gzip_write(&plain, out, e)
                          : spz_zstd_write(q, &h, plain.data, out, e);
    }
    if (rc)
        out->size = start;
    buf_free(&plain);
    return rc;
}

/* ---- decode ---- */

static enum err_code spz_head_read(struct cursor *c, const struct codec_limits *lim,
                                   struct spz_head *h, struct err *e)
{
    uint32_t magic = cursor_u32(c);
    h->version = cursor_u32(c);
    h->n = cursor_u32(c);
    h->sh_degree = cursor_u8(c);
    h->fraction_bits = cursor_u8(c);
    h->flags = cursor_u8(c);
    h->n_streams = cursor_u8(c);
    if (c->bad || magic != MAGIC)
        return err_set(e, ERR_FORMAT, "spz: not an SPZ file, or truncated in its header");
    if (h->version < 1 || h->version > 4)
        return err_set(e, ERR_FORMAT, "spz: version %u: 1 to 4 are read", h->version);
    if (h->sh_degree > (h->version == 4 ? 4u : 3u) || h->fraction_bits > FRACTION_BITS_MAX)
        return err_set(e, ERR_FORMAT, "spz: SH degree %u, %u fraction bits: out of range",
                       h->sh_degree, h->fraction_bits);
    size_t most = lim && lim->max_gaussians ? lim->max_gaussians : CODEC_MAX_GAUSSIANS;
    if (h->n > most)
        return err_set(e, ERR_LIMIT, "spz: %u Gaussians: the limit is %zu", h->n, most);
    return ERR_OK;
}

/* A number of 16 bits: sign, 5 bits of exponent, 10 of fraction (IEEE 754). */
static double spz_half(const uint8_t *p)
{
    const unsigned v = p[0] | (unsigned)p[1] << 8, exponent = v >> 10 & 31, fraction = v & 1023;
    const double x = !exponent       ? ldexp(fraction, -24)
                     : exponent < 31 ? ldexp(1024 + fraction, (int)exponent - 25)
                                     : HUGE_VAL;
    return v >> 15 ? -x : x;
}

/* Version 1 has floats: as integers of as many bits as they fit. */
static enum err_code spz_positions_read_1(const uint8_t *p, struct quant *q, struct err *e)
{
    double most = 0;
    for (size_t i = 0; i < 3 * q->n; i++) {
        const double v = fabs(spz_half(p + 2 * i));
        if (!isfinite(v))
            return err_set(e, ERR_FORMAT, "spz: row %zu: its position is not finite", i / 3);
        most = fmax(most, v);
    }
    q->frac_bits = QUANT_FRAC_BITS;
    while (most * (1u << q->frac_bits) >= POSITION_LIMIT - 1)
        q->frac_bits--;
    for (size_t i = 0; i < 3 * q->n; i++)
        q->position[i] = (int32_t)lround(spz_half(p + 2 * i) * (1u << q->frac_bits));
    return ERR_OK;
}

static enum err_code spz_positions_read(const struct spz_head *h, const uint8_t *p, struct quant *q,
                                        struct err *e)
{
    if (h->version == 1)
        return spz_positions_read_1(p, q, e);
    q->frac_bits = h->fraction_bits;
    for (size_t i = 0; i < 3 * q->n; i++, p += 3) {
        const int32_t v = spz_get_i24(p);
        /* the mirror image of -2^23 has no place in 24 bits: it moves by a step */
        q->position[i] = v == -POSITION_LIMIT ? 1 - POSITION_LIMIT : v;
    }
    return ERR_OK;
}

static uint32_t spz_rotation_v2(const uint8_t *p)
{
    float q[4] = {0}, sum = 0;
    for (int c = 0; c < 3; c++) {
        q[c + 1] = (float)p[c] / 127.5f - 1;
        sum += q[c + 1] * q[c + 1];
    }
    q[0] = sqrtf(sum < 1 ? 1 - sum : 0);
    return quant_pack_rotation(q);
}

/* Fields of foreign writers may hold -0, which is 0 here (quant.c). */
static uint32_t spz_rotation_v3(const uint8_t *p)
{
    uint32_t r = p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
    for (int f = 0; f < 3; f++)
        if (!(r >> 10 * f & 511))
            r &= ~(512u << 10 * f);
    return r;
}

/* ---- axes ---- */

/* Which way x, y and z go, by the record of axes: 1 LDB, 2 RDB, 3 LUB, 4 RUB ... 8 RUF (left or
 * right, down or up, back or front). */
static bool spz_signs(uint32_t axes, float sign[3])
{
    if (axes < 1 || axes > 8)
        return false;
    sign[0] = (axes - 1) & 1 ? 1.0f : -1.0f;
    sign[1] = (axes - 1) & 2 ? 1.0f : -1.0f;
    sign[2] = (axes - 1) & 4 ? -1.0f : 1.0f;
    return true;
}

/* Into glTF's axes, RUB. A mirrored axis turns rotations about the other two the other way. */
static void spz_turn(uint32_t axes, struct quant *q)
{
    float s[3];
    if (!axes)
        return;
    if (!spz_signs(axes, s)) {
        log_warn("spz", "axes of kind %u are not known: they are taken as those of glTF", axes);
        return;
    }
    const float x = s[0], y = s[1], z = s[2], quat[4] = {1, y * z, x * z, x * y};
    const float sh[15] = {y, z, x, x * y, y * z, 1, x * z, 1, y, x * y * z, y, z, x, z, x};
    const size_t k = gauss_sh_count(q->sh_degree) - 1;
    for (size_t i = 0; i < q->n; i++) {
        float r[4];
        for (size_t c = 0; c < 3; c++)
            q->position[3 * i + c] = s[c] < 0 ? -q->position[3 * i + c] : q->position[3 * i + c];
        quant_unpack_rotation(q->rotation[i], r);
        for (size_t c = 0; c < 4; c++)
            r[c] *= quat[c];
        q->rotation[i] = quant_pack_rotation(r);
        for (size_t c = 0; c < 3 * k; c++) {
            uint8_t *v = &q->sh[3 * k * i + c]; /* 128 is 0 */
            *v = (uint8_t)(sh[c / 3] > 0 ? *v : *v ? 256 - *v : 255);
        }
    }
}

/* Records: type, length, payload. */
static uint32_t spz_axes(struct cursor c)
{
    while (cursor_left(&c) >= 8) {
        const uint32_t type = cursor_u32(&c), n = cursor_u32(&c);
        struct cursor payload = c;
        if (!cursor_take(&c, n))
            break;
        if (type == (uint32_t)AXES_TYPE && n >= 4)
            return cursor_u32(&payload);
    }
    return 0;
}

static enum err_code spz_streams_read(const struct spz_head *h,
                                      const uint8_t *const stream[N_STREAMS], struct quant *q,
                                      struct err *e)
{
    uint32_t degree = h->sh_degree < GAUSS_SH_DEGREE_MAX ? h->sh_degree : GAUSS_SH_DEGREE_MAX;
    size_t sh_in = 3 * (gauss_sh_count(h->sh_degree) - 1),
           sh_out = 3 * (gauss_sh_count(degree) - 1);
    enum err_code rc = quant_alloc(q, h->n, degree, 0, e);
    if (!rc)
        rc = spz_positions_read(h, stream[0], q, e);
    if (rc) {
        quant_free(q);
        return rc;
    }
    q->antialiased = h->flags & FLAG_ANTIALIASED;
    memcpy(q->alpha, stream[1], q->n);
    memcpy(q->color, stream[2], 3 * q->n);
    memcpy(q->scale, stream[3], 3 * q->n);
    for (size_t i = 0; i < q->n; i++)
        q->rotation[i] = h->version <= 2 ? spz_rotation_v2(stream[4] + 3 * i)
                                         : spz_rotation_v3(stream[4] + 4 * i);
    for (size_t i = 0; i < q->n && sh_out; i++)
        memcpy(q->sh + i * sh_out, stream[5] + i * sh_in, sh_out);
    if (degree < h->sh_degree)
        log_warn("spz", "harmonics of degree %u: those above %u are left out", h->sh_degree,
                 degree);
    spz_turn(h->axes, q);
    return ERR_OK;
}

static enum err_code spz_gzip_read(const uint8_t *bytes, size_t n, const struct codec_limits *lim,
                                   struct buf *out, struct err *e)
{
    const uint8_t *tail = bytes + n - 4; /* n >= 18 checked by the caller */
    size_t plain = tail[0] | (size_t)tail[1] << 8 | (size_t)tail[2] << 16 | (size_t)tail[3] << 24;
    size_t most = lim && lim->max_bytes ? lim->max_bytes : CODEC_MAX_BYTES;
    if (plain > most)
        return err_set(e, ERR_LIMIT, "spz: %zu bytes unpacked: the limit is %zu", plain, most);
    if (plain / DEFLATE_GROWTH_MAX > n || plain < HEAD_BYTES)
        return err_set(e, ERR_FORMAT, "spz: truncated or not one gzip member");
    struct libdeflate_decompressor *d = libdeflate_alloc_decompressor();
    uint8_t *p = d ? buf_grow(out, plain) : NULL;
    size_t got = 0, used = 0;
    enum libdeflate_result r =
        p ? libdeflate_gzip_decompress_ex(d, bytes, n, p, plain, &used, &got) : LIBDEFLATE_SUCCESS;
    libdeflate_free_decompressor(d);
    if (!p)
        return err_set(e, ERR_MEM, "spz: out of memory");
    if (r != LIBDEFLATE_SUCCESS || got != plain || used != n)
        return err_set(e, ERR_FORMAT, "spz: gzip data is damaged or truncated");
    return ERR_OK;
}

static enum err_code spz_decode_gzip(const uint8_t *bytes, size_t n, const struct codec_limits *lim,
                                     struct quant *out, struct err *e)
{
    struct buf plain = {0};
    struct spz_head h = {0};
    const uint8_t *stream[N_STREAMS];
    enum err_code rc = spz_gzip_read(bytes, n, lim, &plain, e);
    struct cursor c = cursor_over(plain.data, plain.size);
    if (!rc)
        rc = spz_head_read(&c, lim, &h, e);
    if (!rc && h.version == 4)
        rc = err_set(e, ERR_FORMAT, "spz: version 4 inside gzip");
    for (int s = 0; !rc && s < N_STREAMS; s++)
        if (!(stream[s] = cursor_take(&c, spz_stream_bytes(&h, s))))
            rc = err_set(e, ERR_FORMAT, "spz: %u Gaussians announced, stream %d is cut short", h.n,
                         s);
    if (!rc && cursor_left(&c) && !(h.flags & FLAG_EXTENSIONS))
        rc = err_set(e, ERR_FORMAT, "spz: %zu bytes after the last stream", cursor_left(&c));
    if (!rc && h.flags & FLAG_EXTENSIONS)
        h.axes = spz_axes(c);
    if (!rc)
        rc = spz_streams_read(&h, stream, out, e);
    buf_free(&plain);
    return rc;
}

static enum err_code spz_toc_read(struct cursor toc, const struct spz_head *h, size_t n_data,
                                  size_t packed[N_STREAMS], struct err *e)
{
    size_t left = n_data;
    for (uint32_t s = 0; s < h->n_streams; s++) {
        uint64_t in = cursor_u64(&toc), plain = cursor_u64(&toc);
        if (toc.bad || in > left || plain != spz_stream_bytes(h, (int)s) ||
            plain / ZSTD_GROWTH_MAX > in)
            return err_set(e, ERR_FORMAT, "spz: stream %u of %u: sizes do not fit the file", s,
                           h->n_streams);
        packed[s] = (size_t)in;
        left -= packed[s];
    }
    if (left)
        return err_set(e, ERR_FORMAT, "spz: %zu bytes after the last stream", left);
    return ERR_OK;
}

static enum err_code spz_decode_zstd(const uint8_t *bytes, size_t n, const struct codec_limits *lim,
                                     struct quant *out, struct err *e)
{
    struct spz_head h = {0};
    struct cursor c = cursor_over(bytes, n);
    size_t packed[N_STREAMS] = {0}, bytes_plain = 0;
    const uint8_t *stream[N_STREAMS] = {0};
    struct buf plain = {0};
    enum err_code rc = spz_head_read(&c, lim, &h, e);
    if (rc)
        return rc;
    h.toc = cursor_u32(&c);
    uint32_t want = h.sh_degree ? N_STREAMS : N_STREAMS - 1;
    size_t toc_bytes = (size_t)h.n_streams * 16;
    if (c.bad || h.version != 4 || !h.n || h.n_streams != want || h.toc < HEAD4_BYTES ||
        h.toc > n || n - h.toc < toc_bytes)
        return err_set(e, ERR_FORMAT, "spz: version %u, %u streams: header is damaged or truncated",
                       h.version, h.n_streams);
    const uint8_t *data = bytes + h.toc + toc_bytes;
    if (h.flags & FLAG_EXTENSIONS)
        h.axes = spz_axes(cursor_over(bytes + HEAD4_BYTES, h.toc - HEAD4_BYTES));
    rc = spz_toc_read(cursor_over(bytes + h.toc, toc_bytes), &h, n - h.toc - toc_bytes, packed, e);
    for (int s = 0; s < N_STREAMS; s++)
        bytes_plain += spz_stream_bytes(&h, s);
    size_t most = lim && lim->max_bytes ? lim->max_bytes : CODEC_MAX_BYTES;
    if (!rc && bytes_plain > most)
        rc = err_set(e, ERR_LIMIT, "spz: %zu bytes unpacked: the limit is %zu", bytes_plain, most);
    uint8_t *p = !rc ? buf_grow(&plain, bytes_plain) : NULL;
    if (!rc)
        rc = buf_check(&plain, e);
    for (uint32_t s = 0; !rc && s < h.n_streams; s++) {
        size_t size = spz_stream_bytes(&h, (int)s);
        size_t got = ZSTD_decompress(p, size, data, packed[s]);
        if (ZSTD_isError(got) || got != size)
            rc = err_set(e, ERR_FORMAT, "spz: stream %u: %s", s,
                         ZSTD_isError(got) ? ZSTD_getErrorName(got) : "too short");
        stream[s] = p;
        p += size;
        data += packed[s];
    }
    if (!rc)
        rc = spz_streams_read(&h, stream, out, e);
    buf_free(&plain);
    return rc;
}

enum err_code spz_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                         struct quant *out, struct err *e)
{
    const uint8_t *p = bytes;
    *out = (struct quant){0};
    if (n >= 18 && p[0] == 0x1f && p[1] == 0x8b)
        return spz_decode_gzip(p, n, lim, out, e);
    return spz_decode_zstd(p, n, lim, out, e);
}
