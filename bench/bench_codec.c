/* Codecs: Gaussians a second through every format on one core, bytes a Gaussian, and pictures.
 *
 * The rows are the procedural city in Morton order, moved about its tile's middle, as tiles are.
 * Checked before timing: each file decodes to the integers (or floats) it was made from. Ratios are
 * to raw float32 rows (236 bytes with SH of degree 3).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "bench/bench.h"

#include <stdio.h>
#include <string.h>

#include "bench/city.h"
#include "codec/codec.h"

struct codec_case {
    const char *name;
    enum err_code (*encode)(const struct codec_case *c, struct buf *out, struct err *e);
    enum err_code (*decode)(const struct codec_case *c, struct quant *q, struct gauss *g,
                            struct err *e);
    const struct gauss *g; /* borrowed */
    const struct quant *q; /* borrowed */
    struct buf file;
};

static enum err_code encode_quant(const struct codec_case *c, struct buf *out, struct err *e)
{
    struct quant q;
    enum err_code rc = quant_from_gauss(c->g, c->g->sh_degree, &q, e);
    quant_free(&q);
    (void)out;
    return rc;
}

static enum err_code encode_spz3(const struct codec_case *c, struct buf *out, struct err *e)
{
    return spz_encode(c->q, 3, out, e);
}

static enum err_code encode_spz4(const struct codec_case *c, struct buf *out, struct err *e)
{
    return spz_encode(c->q, 4, out, e);
}

static enum err_code encode_drc(const struct codec_case *c, struct buf *out, struct err *e)
{
    return draco_encode(c->q, "bench", out, e);
}

static enum err_code encode_glb(const struct codec_case *c, struct buf *out, struct err *e)
{
    return glb_encode_plain(c->g, NULL, out, e);
}

static enum err_code encode_ply(const struct codec_case *c, struct buf *out, struct err *e)
{
    return ply_encode(c->g, NULL, out, e);
}

static enum err_code encode_payload(const struct codec_case *c, struct buf *out, struct err *e)
{
    return payload_encode(c->g, false, out, e);
}

static enum err_code encode_lossless(const struct codec_case *c, struct buf *out, struct err *e)
{
    return payload_encode(c->g, true, out, e);
}

static enum err_code decode_spz(const struct codec_case *c, struct quant *q, struct gauss *g,
                                struct err *e)
{
    (void)g;
    return spz_decode(c->file.data, c->file.size, NULL, q, e);
}

static enum err_code decode_drc(const struct codec_case *c, struct quant *q, struct gauss *g,
                                struct err *e)
{
    (void)g;
    return draco_decode(c->file.data, c->file.size, NULL, q, e);
}

static enum err_code decode_glb(const struct codec_case *c, struct quant *q, struct gauss *g,
                                struct err *e)
{
    (void)q;
    return glb_decode(c->file.data, c->file.size, NULL, g, e);
}

static enum err_code decode_ply(const struct codec_case *c, struct quant *q, struct gauss *g,
                                struct err *e)
{
    (void)q;
    return ply_decode(c->file.data, c->file.size, NULL, g, NULL, e);
}

static enum err_code decode_payload(const struct codec_case *c, struct quant *q, struct gauss *g,
                                    struct err *e)
{
    (void)q;
    return payload_decode(c->file.data, c->file.size, NULL, g, e);
}

static enum err_code codec_encode(void *user, struct err *e)
{
    struct codec_case *c = user;
    c->file.size = 0;
    return c->encode(c, &c->file, e);
}

static enum err_code codec_decode(void *user, struct err *e)
{
    struct codec_case *c = user;
    struct quant q = {0};
    struct gauss g = {0};
    enum err_code rc = c->decode(c, &q, &g, e);
    quant_free(&q);
    gauss_free(&g);
    return rc;
}

/* Integers equal, or means equal: enough to know that the whole file was read. */
static enum err_code codec_check(struct codec_case *c, struct err *e)
{
    struct quant q = {0};
    struct gauss g = {0};
    enum err_code rc = codec_encode(c, e);
    if (rc == ERR_OK)
        rc = c->decode(c, &q, &g, e);
    if (rc == ERR_OK && q.block &&
        (q.n != c->q->n || memcmp(q.position, c->q->position, 12 * q.n) ||
         memcmp(q.sh, c->q->sh, 3 * (gauss_sh_count(q.sh_degree) - 1) * q.n)))
        rc = err_set(e, ERR_INTERNAL, "bench_codec: %s : integers differ", c->name);
    if (rc == ERR_OK && !q.block && (g.n != c->g->n || memcmp(g.mean_m, c->g->mean_m, 12 * g.n)))
        rc = err_set(e, ERR_INTERNAL, "bench_codec: %s : means differ", c->name);
    quant_free(&q);
    gauss_free(&g);
    return rc;
}

static enum err_code codec_time(struct bench *b, struct codec_case *c, struct err *e)
{
    char name[64];
    double ms = 0, n = (double)c->g->n;
    const double raw = 4.0 * (11 + 3 * (double)gauss_sh_count(c->g->sh_degree));
    enum err_code rc = c->decode ? codec_check(c, e) : ERR_OK;
    if (rc == ERR_OK)
        rc = bench_time(b, codec_encode, c, &ms, NULL, e);
    if (rc == ERR_OK) {
        snprintf(name, sizeof name, "%s encode", c->name);
        bench_report(b, name, n / ms / 1e3, "M Gaussians/s", 0, NULL);
    }
    if (rc == ERR_OK && c->decode)
        rc = bench_time(b, codec_decode, c, &ms, NULL, e);
    if (rc == ERR_OK && c->decode) {
        snprintf(name, sizeof name, "%s decode", c->name);
        bench_report(b, name, n / ms / 1e3, "M Gaussians/s", 0, NULL);
        snprintf(name, sizeof name, "%s size", c->name);
        bench_report(b, name, (double)c->file.size / n, "bytes", (double)c->file.size / n / raw,
                     "float32 rows");
    }
    buf_free(&c->file);
    return rc;
}

struct picture_case {
    struct image in, out;
    struct buf file;
};

static enum err_code picture_resize(void *user, struct err *e)
{
    struct picture_case *c = user;
    image_free(&c->out);
    return image_resize(&c->in, c->in.width_px * 2 / 5, c->in.height_px * 2 / 5, &c->out, e);
}

static enum err_code picture_encode(void *user, struct err *e)
{
    struct picture_case *c = user;
    c->file.size = 0;
    return image_encode(&c->in, "jpg", 90, &c->file, e);
}

static enum err_code pictures(struct bench *b, struct err *e)
{
    struct picture_case c = {0};
    double ms = 0;
    uint32_t w = b->quick ? 400 : 4000, h = w / 4 * 3;
    enum err_code rc = image_alloc(w, h, 3, &c.in, e);
    for (size_t i = 0; rc == ERR_OK && i < (size_t)w * h * 3; i++)
        c.in.px[i] = (uint8_t)(i / 3 % w / 8 + i / 3 / w / 6 + rng_u64(1, 2, i) % 8);
    double mpx = (double)w * h / 1e6;
    if (rc == ERR_OK)
        rc = bench_time(b, picture_resize, &c, &ms, NULL, e);
    if (rc == ERR_OK) {
        bench_report(b, "Lanczos3 to 2/5", mpx / ms * 1e3, "Mpx/s", 0, NULL);
        rc = bench_time(b, picture_encode, &c, &ms, NULL, e);
    }
    if (rc == ERR_OK)
        bench_report(b, "JPEG 90 encode", mpx / ms * 1e3, "Mpx/s", 0, NULL);
    image_free(&c.in);
    image_free(&c.out);
    buf_free(&c.file);
    return rc;
}

enum err_code bench_codec(struct bench *b, struct err *e)
{
    struct gauss g = {0};
    struct quant q = {0};
    enum err_code rc = city_sorted(b->quick ? 2000 : 200000, &g, e);
    if (rc == ERR_OK)
        rc = quant_from_gauss(&g, g.sh_degree, &q, e);
    struct codec_case cases[] = {
        {"quantise", encode_quant, NULL, &g, &q, {0}},
        {"spz v3", encode_spz3, decode_spz, &g, &q, {0}},
        {"spz v4", encode_spz4, decode_spz, &g, &q, {0}},
        {"drc", encode_drc, decode_drc, &g, &q, {0}},
        {"glb plain", encode_glb, decode_glb, &g, &q, {0}},
        {"ply", encode_ply, decode_ply, &g, &q, {0}},
        {"payload", encode_payload, decode_payload, &g, &q, {0}},
        {"payload lossless", encode_lossless, decode_payload, &g, &q, {0}},
    };
    for (size_t i = 0; rc == ERR_OK && i < sizeof cases / sizeof *cases; i++)
        rc = codec_time(b, &cases[i], e);
    if (rc == ERR_OK)
        rc = pictures(b, e);
    quant_free(&q);
    gauss_free(&g);
    return rc;
}
