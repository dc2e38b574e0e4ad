/* Tiles: cutting a city into a store, reading it back, selecting levels, and the cost and gain of
 * levels of detail.
 *
 * Checked before timing: every Gaussian is in one tile of the finest level, and every tile can be
 * read back. Pictures with levels are compared with pictures of the finest tiles from the same
 * place by PSNR, Gaussians drawn, and time. The simple alternative is a picture with every n-th
 * Gaussian, as many as the levels have.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/bench.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "lab/bench/city.h"
#include "lod/choose/pick.h"
#include "lod/choose/view.h"
#include "lod/make/pyramid.h"
#include "lod/make/simplify.h"
#include "lod/store/store.h"
#include "lod/store/tree.h"
#include "render/render.h"

enum { PICTURE_SIDE_MAX = 2048, MANY = 20000 };

#define PICTURE_FOCAL_PX 720.0

static const struct geo_origin origin = {8.6821, 50.1109, 160};

struct tile_case {
    const struct gauss *g;
    char path[FILE_PATH_MAX];
    struct pyramid_report report;
    struct store *store;
    size_t n_read;
    struct gauss less;
    size_t target;
};

static enum err_code tile_locate(void *user, struct err *e)
{
    const struct tile_case *c = user;
    enum err_code rc = ERR_OK;
    uint32_t mix = 0;
    for (size_t i = 0; !rc && i < c->g->n; i++) {
        double enu[3], lon, lat, h;
        for (size_t k = 0; k < 3; k++)
            enu[k] = (double)c->g->mean_m[3 * i + k] + c->g->origin_enu_m[k];
        rc = geo_from_enu(&origin, enu, &lon, &lat, &h, e);
        mix ^= key_at(lon, lat, KEY_ZOOM_MAX).x;
    }
    return rc || mix != UINT32_MAX ? rc : err_set(e, ERR_INTERNAL, "no tile has this number");
}

static enum err_code tile_build(void *user, struct err *e)
{
    struct tile_case *c = user;
    const struct pyramid_config cfg = {.name = "bench", .tile_edge_m = 60};
    const struct pyramid_level level = {.g = c->g, .level = 3};
    return pyramid_build(&origin, &level, 1, &cfg, NULL, 0, c->path, &c->report, e);
}

static enum err_code tile_simplify(void *user, struct err *e)
{
    struct tile_case *c = user;
    gauss_free(&c->less);
    return simplify_gauss(c->g, c->target, &c->less, e);
}

static enum err_code tile_read(void *user, struct err *e)
{
    struct tile_case *c = user;
    size_t n;
    const struct store_tile *t = store_tiles(c->store, &n);
    enum err_code rc = ERR_OK;
    c->n_read = 0;
    for (size_t i = 0; !rc && i < n; i++) {
        struct gauss g;
        rc = store_read_gauss(c->store, t[i].key, &g, e);
        c->n_read += g.n;
        gauss_free(&g);
    }
    return rc;
}

static enum err_code tile_check(struct tile_case *c, struct err *e)
{
    size_t n, bad, total = 0;
    const struct store_tile *t = store_tiles(c->store, &n);
    for (size_t i = 0; i < n; i++)
        total += t[i].level == 3 ? t[i].count : 0;
    if (total != c->g->n)
        return err_set(e, ERR_INTERNAL, "%zu of %zu Gaussians are in the finest tiles", total,
                       c->g->n);
    return store_verify(c->store, &bad, e);
}

/* ---- a city that does not fit into memory ---- */

enum { LARGE_COPIES = 25, LARGE_ROWS = 100000 };

struct large_case {
    const struct gauss *g;
    size_t parts_a_copy;
};

/* A slice of the city, moved to its place among the copies, as a checkpoint would be read. */
static enum err_code tile_large_load(void *user, size_t part, struct gauss *out, struct err *e)
{
    const struct large_case *c = user;
    size_t copy = part / c->parts_a_copy, from = part % c->parts_a_copy * LARGE_ROWS;
    size_t n = c->g->n - from < LARGE_ROWS ? c->g->n - from : LARGE_ROWS;
    struct gauss view = *c->g;
    view.mean_m += 3 * from;
    view.scale_log += 3 * from;
    view.quat_wxyz += 4 * from;
    view.opacity_logit += from;
    view.sh += 3 * gauss_sh_count(view.sh_degree) * from;
    view.n = n;
    enum err_code rc = gauss_uninit(out, n, view.sh_degree, 0, e);
    if (!rc)
        rc = gauss_append(out, &view, NULL, n, e);
    out->origin_enu_m[0] = CITY_M * ((double)(copy % 5) - 2);
    out->origin_enu_m[1] = CITY_M * ((double)(copy / 5) - 2);
    return rc;
}

/* 25 cities side by side, streamed: the speed and memory of `citysplat tile` without the disk that
 * checkpoints come from. Once, because it takes long. */
static enum err_code tile_large_time(struct bench *b, const struct gauss *g, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct large_case c = {.g = g, .parts_a_copy = (g->n + LARGE_ROWS - 1) / LARGE_ROWS};
    const struct pyramid_config cfg = {.name = "large"};
    const struct pyramid_level level = {
        .level = 3, .load = tile_large_load, .user = &c, .n_parts = LARGE_COPIES * c.parts_a_copy};
    struct pyramid_report report;
    enum err_code rc = file_join(path, bench_tmpdir(b), "large.tiles", e);
    bool own_peak = mem_peak_reset();
    size_t before =
        own_peak ? mem_peak_bytes() : 0; /* the city itself, and what cases before left */
    double wall = clock_s(), cpu = clock_cpu_s(), n = (double)(LARGE_COPIES * g->n);
    if (!rc)
        rc = pyramid_build(&origin, &level, 1, &cfg, NULL, 0, path, &report, e);
    wall = clock_s() - wall;
    cpu = clock_cpu_s() - cpu;
    if (!rc) {
        bench_report(b, "streamed build: Gaussians", n, "", 0, NULL);
        bench_report(b, "streamed build", n / wall / 1e6, "M Gaussians/s", 0, NULL);
        bench_report(b, "streamed build, a core's time", n / cpu / 1e6, "M Gaussians/s", 0, NULL);
        bench_report(b,
                     own_peak ? "streamed build: memory that it added at most"
                              : "streamed build: peak memory of the process so far",
                     (double)(mem_peak_bytes() - before) / 1048576.0, "MiB", 0, NULL);
        bench_report(b, "streamed build: tiles", (double)report.n_tiles, "", 0, NULL);
    }
    return rc;
}

/* ---- selection over many tiles ---- */

struct pick_case {
    struct index index;
    size_t n_out;
    struct tree tree;
    uint32_t *out;
    struct camera cam;
    struct pick_options o;
};

static enum err_code tile_pick_once(void *user, struct err *e)
{
    struct pick_case *c = user;
    return pick_select(&c->tree, &c->cam, &c->o, c->out, &c->n_out, e);
}

/* A thousand tiles in view and more, with everything on: a cut before, and limits that bind. */
static enum err_code tile_pick_thousand(struct bench *b, struct pick_case *c, struct err *e)
{
    double ms = 0.0;
    uint32_t *before = mem_array(c->index.n, sizeof *before);
    enum err_code rc = before ? ERR_OK : err_set(e, ERR_MEM, "out of memory");
    for (c->o.error_px = 1.0; !rc && (c->n_out < 1100 && c->o.error_px > 1e-3);
         c->o.error_px *= 0.9)
        rc = tile_pick_once(c, e);
    if (!rc) {
        memcpy(before, c->out, c->n_out * sizeof *before);
        c->o.before = before;
        c->o.n_before = c->n_out;
        c->o.hysteresis = PICK_HYSTERESIS;
        c->o.max_gaussians = (uint64_t)c->n_out * 49000;
        c->o.max_bytes = (uint64_t)c->n_out * 1000000;
        rc = bench_time(b, tile_pick_once, c, &ms, NULL, e);
    }
    if (!rc) {
        bench_report(b, "pick, limits and hysteresis", ms, "ms", 0, NULL);
        bench_report(b, "pick, limits and hysteresis: tiles picked", (double)c->n_out, "", 0, NULL);
    }
    mem_free(before);
    return rc;
}

/* A full pyramid over 16 km: zooms 10 to 17. */
static enum err_code tile_pick_time(struct bench *b, struct err *e)
{
    struct pick_case c = {.out = mem_array(2 * MANY, sizeof *c.out)};
    double ms = 0.0;
    enum err_code rc = c.out ? ERR_OK : err_set(e, ERR_MEM, "out of memory");
    for (uint8_t z = 0; !rc && z < (b->quick ? 5 : 8); z++)
        for (uint32_t y = 0; y < 1u << z; y++)
            for (uint32_t x = 0; x < 1u << z; x++) {
                double edge = ldexp(16000, -z);
                const struct store_entry t = {
                    .tile = {.key = {(uint8_t)(10 + z), x, y}, .count = 50000, .bytes = 1000000},
                    .shape = {.sigma_max_m = edge / 50,
                              .geometric_error_m = edge / 10,
                              .min_enu_m = {x * edge - 8000, 8000 - (y + 1) * edge, 0},
                              .max_enu_m = {(x + 1) * edge - 8000, 8000 - y * edge, 60}}};
                if (!rc)
                    rc = index_add(&c.index, &t, 2 * MANY, e);
            }
    const double eye[3] = {100, -300, 150};
    c.cam = camera_heading(eye, 20, -25, 0.9, 1280, 720);
    if (!rc)
        rc = tree_build(&c.index, &c.tree, e);
    if (!rc)
        rc = bench_time(b, tile_pick_once, &c, &ms, NULL, e);
    if (!rc) {
        bench_report(b, "pick", ms, "ms", 0, NULL);
        bench_report(b, "pick, tiles in the index", (double)c.index.n, "", 0, NULL);
        bench_report(b, "pick, tiles picked", (double)c.n_out, "", 0, NULL);
        rc = tile_pick_thousand(b, &c, e);
    }
    tree_free(&c.tree);
    index_free(&c.index);
    mem_free(c.out);
    return rc;
}

/* ---- pictures ---- */

struct picture {
    struct view *view;
    struct camera cam;
    struct render_options ro;
    struct pick_options po;
    struct view_stats stats;
    float *rgb;
};

static enum err_code tile_picture_draw(void *user, struct err *e)
{
    struct picture *p = user;
    return view_render(p->view, &p->cam, &p->ro, &p->po, p->rgb, &p->stats, e);
}

static double tile_picture_psnr(const float *a, const float *b, size_t n)
{
    double sum = 0.0;
    for (size_t i = 0; i < n; i++) {
        double d = (double)fminf(a[i], 1.0f) - (double)fminf(b[i], 1.0f);
        sum += d * d;
    }
    return -10.0 * log10(sum / (double)n + 1e-12);
}

/* The same view of every n-th Gaussian. */
static enum err_code tile_picture_thinned(struct render *r, const struct gauss *g,
                                          const struct picture *p, float *rgb, struct err *e)
{
    struct gauss some = {0};
    struct render_model m = {0};
    size_t step = p->stats.n_gaussians ? g->n / p->stats.n_gaussians : 1;
    enum err_code rc = gauss_alloc(&some, g->n, g->sh_degree, 0, e);
    for (uint32_t i = 0; !rc && i < g->n; i += (uint32_t)(step ? step : 1))
        rc = gauss_append(&some, g, &i, 1, e);
    if (!rc)
        rc = render_model_upload(r, &some, &m, e);
    if (!rc) {
        rc = render_forward(r, &m, &p->cam, &p->ro, rgb, NULL, e);
        render_model_free(&m);
    }
    gauss_free(&some);
    return rc;
}

static enum err_code tile_picture_from(struct bench *b, struct render *r, const struct tile_case *c,
                                       struct picture *p, double distance_m, struct err *e)
{
    char name[96];
    double fine_ms = 0.0, ms = 0.0;
    /* Looking down by 45 degrees at the middle, just as wide as the city. */
    const double eye[3] = {0, -distance_m / sqrt(2.0), distance_m / sqrt(2.0)};
    uint32_t side = (uint32_t)fmin(1.2 * CITY_M * PICTURE_FOCAL_PX / distance_m, PICTURE_SIDE_MAX);
    side = side < 16 ? 16 : side;
    size_t n = (size_t)side * side * 3;
    float *fine = mem_array(n, sizeof *fine), *thin = mem_array(n, sizeof *thin);
    p->cam = camera_heading(eye, 0, -45, 2.0 * atan(side / 2.0 / PICTURE_FOCAL_PX), side, side);
    enum err_code rc = fine && thin ? ERR_OK : err_set(e, ERR_MEM, "out of memory");
    p->po.no_lod = true;
    if (!rc)
        rc = bench_time(b, tile_picture_draw, p, &fine_ms, NULL, e);
    uint64_t all = p->stats.n_gaussians;
    if (!rc)
        memcpy(fine, p->rgb, n * sizeof *fine);
    p->po.no_lod = false;
    if (!rc)
        rc = bench_time(b, tile_picture_draw, p, &ms, NULL, e);
    if (!rc)
        rc = tile_picture_thinned(r, c->g, p, thin, e);
    if (!rc) {
        snprintf(name, sizeof name, "from %.0f m: frame", distance_m);
        bench_report(b, name, ms, "ms", ms / fine_ms, "finest tiles");
        snprintf(name, sizeof name, "from %.0f m: Gaussians", distance_m);
        bench_report(b, name, (double)p->stats.n_gaussians, "",
                     (double)p->stats.n_gaussians / (double)all, "finest tiles");
        snprintf(name, sizeof name, "from %.0f m: PSNR to the finest", distance_m);
        double db = tile_picture_psnr(fine, p->rgb, n), thin_db = tile_picture_psnr(fine, thin, n);
        bench_report(b, name, db, "dB", db / thin_db, "leaving Gaussians out");
    }
    mem_free(fine);
    mem_free(thin);
    return rc;
}

/* Distance beyond which a typical tile above the finest ones suffices. */
static double tile_picture_switch_m(const struct store *s)
{
    size_t n, found = 0;
    double sum = 0.0;
    const struct store_tile *t = store_tiles(s, &n);
    for (size_t i = 0; i < n; i++)
        if (t[i].key.z + 1 == store_info(s)->zoom_max) {
            sum += store_shape(s, &t[i]).geometric_error_m;
            found++;
        }
    return found ? sum / (double)found * PICTURE_FOCAL_PX / STORE_PX_PER_SIGMA : 100.0;
}

static enum err_code tile_pictures(struct bench *b, const struct tile_case *c, struct err *e)
{
    struct render *r = NULL;
    struct picture p = {
        .ro = {.aa = RENDER_AA_2D, .sh_degree = -1, .background = {0.6f, 0.8f, 1.0f}}};
    p.rgb = mem_array((size_t)PICTURE_SIDE_MAX * PICTURE_SIDE_MAX, 3 * sizeof *p.rgb);
    enum err_code rc = p.rgb ? render_open(b->dev, &r, e) : err_set(e, ERR_MEM, "out of memory");
    if (!rc)
        rc = view_open(c->path, r, 0, &p.view, e);
    for (size_t i = 0; !rc && i < (b->quick ? 1 : 3); i++)
        rc = tile_picture_from(b, r, c, &p,
                               1.2 * tile_picture_switch_m(c->store) * (double)(1u << i), e);
    view_close(&p.view);
    render_close(&r);
    mem_free(p.rgb);
    return rc;
}

static enum err_code tile_times(struct bench *b, struct tile_case *c, struct err *e)
{
    double ms = 0.0, n = (double)c->g->n;
    enum err_code rc = bench_time(b, tile_locate, c, &ms, NULL, e);
    double locate = n / ms / 1e3;
    if (!rc) {
        bench_report(b, "locate (GeographicLib, one core)", locate, "M Gaussians/s", 0, NULL);
        rc = bench_time(b, tile_build, c, &ms, NULL, e);
    }
    if (!rc) {
        bench_report(b, "build with two coarser levels", n / ms / 1e3, "M Gaussians/s",
                     n / ms / 1e3 / locate, "locate");
        rc = store_open(c->path, &c->store, e);
    }
    if (!rc)
        rc = tile_check(c, e);
    if (!rc)
        rc = bench_time(b, tile_read, c, &ms, NULL, e);
    if (!rc) {
        size_t tiles;
        const struct store_tile *t = store_tiles(c->store, &tiles);
        uint64_t bytes = 0;
        for (size_t i = 0; i < tiles; i++)
            bytes += t[i].bytes;
        bench_report(b, "read and decode tiles (one core)", (double)c->n_read / ms / 1e3,
                     "M Gaussians/s", 0, NULL);
        bench_report(b, "payload", (double)bytes / (double)c->n_read, "bytes/Gaussian",
                     (double)bytes / (double)c->n_read / 236.0, "float32 rows");
        c->target = c->g->n / 4;
        rc = bench_time(b, tile_simplify, c, &ms, NULL, e);
    }
    if (!rc)
        bench_report(b, "simplify to a quarter", n / ms / 1e3, "M Gaussians/s", 0, NULL);
    return rc;
}

enum err_code bench_tile(struct bench *b, struct err *e)
{
    struct gauss g = {0};
    struct tile_case c = {.g = &g};
    enum err_code rc = file_join(c.path, bench_tmpdir(b), "bench.tiles", e);
    if (!rc)
        rc = city_make(b->quick ? 5000 : 400000, &g, e);
    if (!rc)
        rc = tile_large_time(b, &g, e);
    if (!rc)
        rc = tile_times(b, &c, e);
    if (!rc)
        rc = tile_pick_time(b, e);
    if (!rc && b->dev)
        rc = tile_pictures(b, &c, e);
    store_close(&c.store);
    gauss_free(&c.less);
    gauss_free(&g);
    return rc;
}
