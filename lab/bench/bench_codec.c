/* Codecs: Gaussians a second through every format on one core, bytes a Gaussian, a tile from the
 * store to bytes, and pictures.
 *
 * The rows are a trained store's finest tiles (--tiles), or the procedural city in Morton order.
 * Encoding is from floats and decoding to floats: quantising is part of both. Checked before
 * timing (CPU time of the one thread): each file decodes to the integers (or floats) it was made
 * from. Ratios are to raw float32 rows (236 bytes with SH of degree 3).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/image.h"
#include "codec/splat/axes.h"
#include "codec/splat/draco.h"
#include "codec/splat/glb.h"
#include "codec/splat/payload.h"
#include "codec/splat/ply.h"
#include "codec/splat/quant.h"
#include "codec/splat/sog.h"
#include "codec/splat/spz.h"
#include "lab/bench/bench.h"
#include "lab/bench/city.h"
#include "lod/store/store.h"
#include "lod/store/tree.h"
#include "server/data/encode.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { ROWS = 200000, TILE_ROWS = 100000 };

enum codec_kind {
    CODEC_SPZ3,
    CODEC_SPZ4,
    CODEC_DRC,
    CODEC_GLB,
    CODEC_PLY,
    CODEC_PAYLOAD,
    CODEC_SOG
};
struct codec_case {
    const char *name;
    enum codec_kind kind;
    enum quant_preset preset;
    bool lossless;
    const struct gauss *g; /* borrowed */
    struct buf file;
};

static bool codec_is_quantised(const struct codec_case *c)
{
    return c->kind <= CODEC_DRC;
}

static enum err_code codec_encode(void *user, struct err *e)
{
    struct codec_case *c = user;
    struct quant q = {0};
    enum err_code rc = ERR_OK;
    c->file.size = 0;
    if (codec_is_quantised(c))
        rc = quant_from_gauss(c->g, c->g->sh_degree, quant_preset_grid(c->preset), &q, e);
    if (!rc)
        switch (c->kind) {
        case CODEC_SPZ3:
        case CODEC_SPZ4:
            rc = spz_encode(&q, c->kind == CODEC_SPZ3 ? 3 : 4, &c->file, e);
            break;
        case CODEC_DRC:
            rc = draco_encode(&q, "bench", &c->file, e);
            break;
        case CODEC_GLB:
            rc = glb_encode_plain(c->g, NULL, &c->file, e);
            break;
        case CODEC_PLY:
            rc = ply_encode(c->g, NULL, &c->file, e);
            break;
        case CODEC_SOG:
            rc = sog_encode(c->g, c->g->sh_degree, &c->file, e);
            break;
        case CODEC_PAYLOAD:
            rc = payload_encode(c->g, c->lossless, &c->file, e);
        }
    quant_free(&q);
    return rc;
}

static enum err_code codec_read(const struct codec_case *c, struct quant *q, struct gauss *g,
                                struct err *e)
{
    const void *p = c->file.data;
    size_t n = c->file.size;
    enum err_code rc = c->kind == CODEC_GLB       ? glb_decode(p, n, NULL, g, e)
                       : c->kind == CODEC_PLY     ? ply_decode(p, n, NULL, g, NULL, e)
                       : c->kind == CODEC_SOG     ? sog_decode(p, n, NULL, g, e)
                       : c->kind == CODEC_PAYLOAD ? payload_decode(p, n, NULL, g, e)
                       : c->kind == CODEC_DRC     ? draco_decode(p, n, NULL, q, e)
                                                  : spz_decode(p, n, NULL, q, e);
    return !rc && codec_is_quantised(c) ? quant_to_gauss(q, g, e) : rc;
}

static enum err_code codec_decode(void *user, struct err *e)
{
    struct quant q = {0};
    struct gauss g = {0};
    enum err_code rc = codec_read(user, &q, &g, e);
    quant_free(&q);
    gauss_free(&g);
    return rc;
}

/* .sog has 65536 steps of ln(1 + |p|) an axis, at most 2 ln(1 + 2048 m) long. */
static bool codec_means_agree(const struct codec_case *c, const struct gauss *g)
{
    if (c->kind != CODEC_SOG)
        return !memcmp(g->mean_m, c->g->mean_m, 12 * g->n);
    for (size_t i = 0; i < 3 * g->n; i++)
        if (!(fabsf(g->mean_m[i] - c->g->mean_m[i]) <= 2.4e-4f * (1 + fabsf(c->g->mean_m[i]))))
            return false;
    return true;
}

/* Integers equal, or means equal: enough to know that the whole file was read. */
static enum err_code codec_check(struct codec_case *c, struct err *e)
{
    struct quant q = {0}, want = {0};
    struct gauss g = {0};
    enum err_code rc = codec_encode(c, e);
    if (!rc)
        rc = codec_read(c, &q, &g, e);
    if (!rc && codec_is_quantised(c))
        rc = quant_from_gauss(c->g, c->g->sh_degree, quant_preset_grid(c->preset), &want, e);
    if (!rc && want.block &&
        (q.n != want.n || memcmp(q.position, want.position, 12 * q.n) ||
         memcmp(q.sh, want.sh, 3 * (gauss_sh_count(q.sh_degree) - 1) * q.n)))
        rc = err_set(e, ERR_INTERNAL, "bench_codec: %s: integers differ", c->name);
    if (!rc && !want.block && (g.n != c->g->n || !codec_means_agree(c, &g)))
        rc = err_set(e, ERR_INTERNAL, "bench_codec: %s: means differ", c->name);
    quant_free(&q);
    quant_free(&want);
    gauss_free(&g);
    return rc;
}

static enum err_code codec_time(struct bench *b, struct codec_case *c, struct err *e)
{
    char name[64];
    double ms = 0, n = (double)c->g->n;
    const double raw = 4.0 * (11 + 3 * (double)gauss_sh_count(c->g->sh_degree) + c->g->embed_len);
    enum err_code rc = codec_check(c, e);
    if (!rc)
        rc = bench_cpu_time(b, codec_encode, c, &ms, NULL, e);
    if (!rc) {
        snprintf(name, sizeof name, "%s encode", c->name);
        bench_report(b, name, n / ms / 1e3, "M Gaussians/s", 0, NULL);
        rc = bench_cpu_time(b, codec_decode, c, &ms, NULL, e);
    }
    if (!rc) {
        snprintf(name, sizeof name, "%s decode", c->name);
        bench_report(b, name, n / ms / 1e3, "M Gaussians/s", 0, NULL);
        snprintf(name, sizeof name, "%s size", c->name);
        bench_report(b, name, (double)c->file.size / n, "bytes", (double)c->file.size / n / raw,
                     "float32 rows");
    }
    buf_free(&c->file);
    return rc;
}

static enum err_code codec_quantise(void *user, struct err *e)
{
    const struct gauss *g = user;
    struct quant q;
    enum err_code rc = quant_from_gauss(g, g->sh_degree, quant_preset_grid(QUANT_BALANCED), &q, e);
    quant_free(&q);
    return rc;
}

/* ---- a tile of 100,000 Gaussians from the store to bytes ---- */

struct tile_request {
    struct store *store;
    struct key key;
    struct form form;
    struct buf out;
};

static enum err_code codec_tile_make(void *user, struct err *e)
{
    struct tile_request *t = user;
    t->out.size = 0;
    return encode_tile(t->store, t->key, t->form, NULL, NULL, &t->out, e);
}

static enum err_code codec_tile_requests(struct bench *b, const struct gauss *g, struct err *e)
{
    const struct store_meta meta = {
        .name = "bench", .origin = {8.6, 50.1, 160}, .sh_degree = g->sh_degree};
    struct tile_request t = {.key = key_at(8.6, 50.1, 16)};
    struct store_entry entry = {.tile = {.key = t.key, .level = 1}};
    struct gauss part = {0};
    char path[FILE_PATH_MAX], name[64];
    double ms = 0;
    size_t n = g->n < TILE_ROWS ? g->n : TILE_ROWS;
    enum err_code rc = file_join(path, bench_tmpdir(b), "codec.tiles", e);
    if (!rc)
        rc = gauss_alloc(&part, n, g->sh_degree, g->embed_len, e);
    if (!rc)
        rc = gauss_append(&part, g, NULL, n, e);
    if (!rc)
        rc = store_create(path, &meta, &t.store, e);
    if (!rc)
        rc = store_put(t.store, &entry, &part, e);
    if (!rc)
        rc = store_commit(&t.store, e);
    if (!rc)
        rc = store_open(path, &t.store, e);
    for (int f = FORMAT_GLB; !rc && f <= FORMAT_SOG; f++) {
        t.form = (struct form){(enum format)f, QUANT_BALANCED, (uint8_t)g->sh_degree, 0, false};
        rc = bench_cpu_time(b, codec_tile_make, &t, &ms, NULL, e);
        snprintf(name, sizeof name, "tile of %zu k from store to .%s", n / 1000,
                 format_ext(t.form.format));
        if (!rc)
            bench_report(b, name, ms, "ms", 0, NULL);
    }
    store_close(&t.store);
    gauss_free(&part);
    buf_free(&t.out);
    return rc;
}

struct picture_case {
    struct image in, out;
    struct buf file;
};

static enum err_code codec_picture_resize(void *user, struct err *e)
{
    struct picture_case *c = user;
    image_free(&c->out);
    return image_resize(&c->in, c->in.width_px * 2 / 5, c->in.height_px * 2 / 5, &c->out, e);
}

static enum err_code codec_picture_encode(void *user, struct err *e)
{
    struct picture_case *c = user;
    c->file.size = 0;
    return image_encode(&c->in, "jpg", 90, &c->file, e);
}

static enum err_code codec_pictures(struct bench *b, struct err *e)
{
    struct picture_case c = {0};
    double ms = 0;
    uint32_t w = b->quick ? 400 : 4000, h = w / 4 * 3;
    enum err_code rc = image_alloc(w, h, 3, &c.in, e);
    for (size_t i = 0; !rc && i < (size_t)w * h * 3; i++)
        c.in.px[i] = (uint8_t)(i / 3 % w / 8 + i / 3 / w / 6 + rng_u64(1, 2, i) % 8);
    double mpx = (double)w * h / 1e6;
    if (!rc)
        rc = bench_time(b, codec_picture_resize, &c, &ms, NULL, e);
    if (!rc) {
        bench_report(b, "Lanczos3 to 2/5", mpx / ms * 1e3, "Mpx/s", 0, NULL);
        rc = bench_time(b, codec_picture_encode, &c, &ms, NULL, e);
    }
    if (!rc)
        bench_report(b, "JPEG 90 encode", mpx / ms * 1e3, "Mpx/s", 0, NULL);
    image_free(&c.in);
    image_free(&c.out);
    buf_free(&c.file);
    return rc;
}

/* The finest tiles of a store in glTF axes, each about its own middle, up to `most` rows. */
static enum err_code codec_trained_rows(const char *path, size_t most, struct gauss *out,
                                        struct err *e)
{
    struct store *s = NULL;
    size_t n = 0;
    enum err_code rc = store_open(path, &s, e);
    const struct store_tile *t = rc ? NULL : store_tiles(s, &n);
    if (!rc)
        rc = gauss_alloc(out, most, store_info(s)->sh_degree, store_info(s)->embed_len, e);
    for (size_t i = 0; !rc && i < n && out->n < most; i++) {
        struct gauss g = {0};
        if (!tree_leaf(store_tree(s), i))
            continue;
        rc = store_read_gauss(s, t[i].key, &g, e);
        memset(g.origin_enu_m, 0, sizeof g.origin_enu_m);
        if (!rc)
            rc = gauss_append(out, &g, NULL, g.n < most - out->n ? g.n : most - out->n, e);
        gauss_free(&g);
    }
    store_close(&s);
    axes_enu_to_gltf(out);
    return rc;
}

enum err_code bench_codec(struct bench *b, struct err *e)
{
    struct gauss g = {0};
    double ms = 0;
    size_t n = b->quick ? 2000 : ROWS;
    enum err_code rc = b->tiles ? codec_trained_rows(b->tiles, n, &g, e) : city_sorted(n, &g, e);
    struct codec_case cases[] = {
        {.name = "spz 3, spz", .kind = CODEC_SPZ3, .preset = QUANT_SPZ},
        {.name = "spz 3, balanced", .kind = CODEC_SPZ3, .preset = QUANT_BALANCED},
        {.name = "spz 4, balanced", .kind = CODEC_SPZ4, .preset = QUANT_BALANCED},
        {.name = "drc, spz", .kind = CODEC_DRC, .preset = QUANT_SPZ},
        {.name = "drc, preview", .kind = CODEC_DRC, .preset = QUANT_PREVIEW},
        {.name = "drc, balanced", .kind = CODEC_DRC, .preset = QUANT_BALANCED},
        {.name = "drc, near-lossless", .kind = CODEC_DRC, .preset = QUANT_NEAR_LOSSLESS},
        {.name = "glb plain", .kind = CODEC_GLB},
        {.name = "ply", .kind = CODEC_PLY},
        {.name = "sog", .kind = CODEC_SOG},
        {.name = "payload", .kind = CODEC_PAYLOAD},
        {.name = "payload lossless", .kind = CODEC_PAYLOAD, .lossless = true},
    };
    if (!rc)
        rc = bench_cpu_time(b, codec_quantise, &g, &ms, NULL, e);
    if (!rc)
        bench_report(b, "quantise", (double)g.n / ms / 1e3, "M Gaussians/s", 0, NULL);
    for (size_t i = 0; !rc && i < sizeof cases / sizeof *cases; i++) {
        cases[i].g = &g;
        rc = codec_time(b, &cases[i], e);
    }
    if (!rc)
        rc = codec_tile_requests(b, &g, e);
    if (!rc)
        rc = codec_pictures(b, e);
    gauss_free(&g);
    return rc;
}
