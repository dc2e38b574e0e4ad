/* Stability of the regularizers: sizes and needles (F4), floaters (F5), statistics without depth
 * (F16), depth maps that are wrong or have another scale (F21), resuming with all of them (F30).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/ckpt.h"
#include "codec/npy.h"
#include "codec/scene.h"
#include "core/layout.h"
#include "loss/depth.h"
#include "loss/depth_map.h"
#include "tests/stability/toy.h"
#include "train/config.h"
#include "train/level.h"
#include "train/train.h"
#include "train/train_scene.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <zlib.h>

static char scene_dir[FILE_PATH_MAX];

/* ---- a scene whose depth is known ---- */

/* Flat, opaque, overlapping blobs on a ground with relief: inverse depth is that of a surface. */
static struct toy ground_spec(void)
{
    struct toy t = toy_spec();
    t.n = 650;
    t.half_m[0] = t.half_m[1] = 9.0; /* all that the cameras see */
    t.sigma_min_m = 0.5;
    t.sigma_max_m = 0.8;
    return t;
}

static void ground_gauss(const struct toy *t, struct gauss *g)
{
    static const float level[4] = {1.0f, 0.0f, 0.0f, 0.0f};
    toy_gauss(t, g);
    for (size_t i = 0; i < g->n; i++) {
        float *at = g->mean_m + 3 * i;
        at[2] = 0.6f * sinf(0.7f * at[0]) * cosf(0.7f * at[1]);
        g->scale_log[3 * i + 2] = logf(0.05f);
        memcpy(g->quat_wxyz + 4 * i, level, sizeof level);
        g->opacity_logit[i] = 4.0f;
    }
}

/* Observations: every point in every photograph that shows it. The toy writes none. */
static void ground_add_tracks(const char *dir)
{
    struct scene s;
    struct err e = {0};
    kit_ok(scene_read(dir, &s, &e), e);
    s.tracks = mem_array(s.n_images * s.n_points, sizeof *s.tracks);
    assert_non_null(s.tracks);
    s.n_tracks = 0;
    for (uint32_t i = 0; i < s.n_images; i++)
        for (uint32_t p = i % 3; p < s.n_points; p += 3) { /* each photograph has a third of them */
            const struct camera *c = &s.images[i].cam;
            double at[3];
            for (int k = 0; k < 3; k++)
                at[k] = c->rot[3 * k] * s.points[p].enu_m[0] +
                        c->rot[3 * k + 1] * s.points[p].enu_m[1] +
                        c->rot[3 * k + 2] * s.points[p].enu_m[2] + c->trans[k];
            double x = c->fx_px * at[0] / at[2] + c->cx_px, y = c->fy_px * at[1] / at[2] + c->cy_px;
            if (at[2] > 0.0 && x >= 0.0 && y >= 0.0 && x < c->width_px && y < c->height_px)
                s.tracks[s.n_tracks++] = (struct scene_track){
                    .point = p, .image = i, .x_px = (float)x, .y_px = (float)y};
        }
    assert_true(s.n_tracks > 100);
    struct scene_track *tracks = s.tracks;
    kit_ok(scene_write(dir, &s, &e), e);
    scene_free(&s);
    mem_free(tracks);
}

static int ground_setup(void **state)
{
    struct toy t = ground_spec();
    struct gauss g = {0};
    (void)toy_open_device(state);
    kit_tmpdir(scene_dir);
    ground_gauss(&t, &g);
    toy_write(scene_dir, &t, &g);
    ground_add_tracks(scene_dir);
    gauss_free(&g);
    return 0;
}

static int ground_teardown(void **state)
{
    kit_rmdir(scene_dir);
    return toy_close_device(state);
}

/* One level of so many steps in which Gaussians are neither added nor removed: what is left is what
 * the losses did. */
static struct train_config plain_config(struct arena *a, int64_t steps)
{
    struct train_config c = toy_config(a, NULL);
    c.level_count = 1;
    c.iterations.one = steps;
    c.budget.v[2] = 5000;
    c.densify_from = 1000000000;
    c.reset_interval = 1000000000;
    c.scale_weight = 0.0;
    /* they fade floaters as well */
    c.solid_spread = c.solid_bend = c.solid_light = c.solid_flat = c.solid_rim = 0.0;
    return c;
}

static void run_gauss(struct toy_run *r, struct gauss *g)
{
    struct err e = {0};
    kit_ok(model_gauss(&r->level.model, g, &e), e);
}

/* ---- F4: sizes and needles ---- */

enum { F4_STEPS = 500 };
#define F4_S_MAX_M 1.0
#define F4_SIZE_LIMIT 1.2 /* of s_max */
#define F4_RATIO_LIMIT 12.0
#define F4_PRUNE_M 1.5
#define F4_COST_DB 0.5  /* of loss and removal, against neither */
#define F4_EXTENT_M 6.9 /* of the toy, roughly */

static int f4_compare(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return x < y ? -1 : x > y;
}

/* Largest axis in s_max, and the 99th percentile of largest over middle axis. */
static void f4_measure(const struct gauss *g, double *size, double *ratio)
{
    double *r = mem_array(g->n, sizeof *r);
    assert_non_null(r);
    *size = 0.0;
    for (size_t i = 0; i < g->n; i++) {
        double s[3];
        for (size_t k = 0; k < 3; k++)
            s[k] = exp((double)g->scale_log[3 * i + k]);
        qsort(s, 3, sizeof *s, f4_compare);
        *size = fmax(*size, s[2] / F4_S_MAX_M);
        r[i] = s[2] / s[1];
    }
    qsort(r, g->n, sizeof *r, f4_compare);
    *ratio = r[(size_t)(0.99 * (double)(g->n - 1))];
    mem_free(r);
}

static void f4_train(const struct train_config *c, const struct gauss *first, double *size,
                     double *ratio, double *psnr)
{
    struct toy_run r;
    struct gauss g = {0};
    toy_run_open_from(&r, scene_dir, c, first);
    toy_run_steps(&r, F4_STEPS);
    run_gauss(&r, &g);
    assert_true(toy_finite(&g));
    f4_measure(&g, size, ratio);
    *psnr = toy_run_score(&r, 1.0).psnr_db;
    gauss_free(&g);
    toy_run_close(&r);
}

/* 1 % of the Gaussians begin 50 times too large, 5 % as needles of 100 to 1. */
static void giants_and_needles_shrink(void **state)
{
    (void)state;
    struct arena a = {0};
    struct gauss first = {0};
    struct toy t = ground_spec();
    double size[4], ratio[4], psnr[4];
    struct train_config c = plain_config(&a, F4_STEPS);
    c.scale_max_m = F4_S_MAX_M;
    c.scale_from = 0;
    c.percent_dense = 1e-3; /* splitting must not want Gaussians larger than s_max */
    ground_gauss(&t, &first);
    for (size_t i = 0; i < first.n; i++)
        for (size_t k = 0; k < 3; k++) {
            if (i % 100 == 0)
                first.scale_log[3 * i + k] = (float)log(50.0 * F4_S_MAX_M);
            else if (i % 20 == 0)
                first.scale_log[3 * i + k] = (float)log(k == i / 20 % 3 ? 0.5 : 0.005);
        }
    f4_measure(&first, &size[0], &ratio[0]);
    f4_train(&c, &first, &size[1], &ratio[1], &psnr[1]);
    c.scale_weight = 0.05;
    f4_train(&c, &first, &size[2], &ratio[2], &psnr[2]);
    c.densify_from = 0; /* as it is used: with removal by size, which begins after a reset */
    c.reset_interval = 150;
    c.prune_size = F4_PRUNE_M / F4_EXTENT_M;
    c.budget.v[2] =
        (int64_t)first.n; /* removal alone: more Gaussians would learn 9 photographs by heart */
    f4_train(&c, &first, &size[3], &ratio[3], &psnr[3]);
    toy_figure("F4",
               "size_before=%.1f size_none=%.2f size_loss=%.2f size_loss_prune=%.2f limit=%.1f "
               "ratio_before=%.0f ratio_none=%.1f ratio_loss=%.1f ratio_loss_prune=%.1f limit=%.0f "
               "psnr_none_db=%.2f psnr_loss_db=%.2f psnr_loss_prune_db=%.2f",
               size[0], size[1], size[2], size[3], F4_SIZE_LIMIT, ratio[0], ratio[1], ratio[2],
               ratio[3], F4_RATIO_LIMIT, psnr[1], psnr[2], psnr[3]);
    assert_true(size[3] < F4_SIZE_LIMIT);
    assert_true(ratio[2] < F4_RATIO_LIMIT && ratio[3] < F4_RATIO_LIMIT);
    assert_true(size[2] < 0.8 * size[1]); /* it is the loss's doing */
    assert_true(psnr[2] >= psnr[1] - F4_COST_DB && psnr[3] >= psnr[1] - F4_COST_DB);
    assert_true(size[1] > F4_SIZE_LIMIT && ratio[1] > F4_RATIO_LIMIT);
    gauss_free(&first);
    arena_free(&a);
}

/* ---- depth maps on disk ---- */

/* Inverse depth of g as photograph i sees it, in 1 / m. */
static void depth_of(const struct gauss *g, size_t i, double *depth)
{
    struct toy t = ground_spec();
    struct camera cam = toy_camera(&t, i);
    struct err e = {0};
    double loss;
    float *none = mem_array((size_t)t.width_px * t.height_px, sizeof *none);
    assert_non_null(none);
    struct depth_input in = {.cam = &cam,
                             .options = {.aa = RENDER_AA_2D},
                             .target = none,
                             .unit_m = 1.0,
                             .n_known = 1,
                             .weight = 1.0};
    kit_ok(depth_ref_loss(g, &in, depth, &loss, &e), e);
    mem_free(none);
}

static void truth_depth(size_t i, double *depth)
{
    struct toy t = ground_spec();
    struct gauss g = {0};
    ground_gauss(&t, &g);
    depth_of(&g, i, depth);
    gauss_free(&g);
}

static void png_chunk(struct buf *b, const char *type, const void *data, size_t n)
{
    const uint8_t length[4] = {(uint8_t)(n >> 24), (uint8_t)(n >> 16), (uint8_t)(n >> 8),
                               (uint8_t)n};
    buf_add(b, length, 4);
    size_t from = b->size;
    buf_add(b, type, 4);
    buf_add(b, data, n);
    unsigned long crc = crc32(0, b->data + from, (unsigned)(n + 4));
    const uint8_t sum[4] = {(uint8_t)(crc >> 24), (uint8_t)(crc >> 16), (uint8_t)(crc >> 8),
                            (uint8_t)crc};
    buf_add(b, sum, 4);
}

/* 16-bit grey, the way depth networks' tools write them. Values 0..1. */
static void png16_write(const char *path, const float *v, uint32_t w, uint32_t h)
{
    struct buf b = {0}, raw = {0};
    struct err e = {0};
    uint8_t head[13] = {0, 0, 0, (uint8_t)w, 0, 0, 0, (uint8_t)h, 16, 0, 0, 0, 0};
    for (uint32_t y = 0; y < h; y++) {
        buf_u8(&raw, 0);
        for (uint32_t x = 0; x < w; x++) {
            unsigned q = (unsigned)(fminf(fmaxf(v[y * w + x], 0.0f), 1.0f) * 65535.0f + 0.5f);
            buf_u8(&raw, q >> 8);
            buf_u8(&raw, q & 255);
        }
    }
    unsigned long n = compressBound(raw.size);
    uint8_t *packed = mem_array(n, 1);
    assert_non_null(packed);
    assert_int_equal(compress(packed, &n, raw.data, raw.size), Z_OK);
    buf_add(&b, "\x89PNG\r\n\x1a\n", 8);
    png_chunk(&b, "IHDR", head, sizeof head);
    png_chunk(&b, "IDAT", packed, n);
    png_chunk(&b, "IEND", NULL, 0);
    kit_ok(file_write(path, b.data, b.size, &e), e);
    buf_free(&b);
    buf_free(&raw);
    mem_free(packed);
}

/* Maps of all photographs: relative inverse depth 4 t + 0.1, .npy for even ones, 16-bit .png for
 * others, named with and without the photograph's own ending. */
static void maps_write(const char *dir)
{
    struct toy t = ground_spec();
    size_t pixels = (size_t)t.width_px * t.height_px, shape[2] = {t.height_px, t.width_px};
    double *depth = mem_array(pixels, sizeof *depth);
    float *map = mem_array(pixels, sizeof *map);
    assert_true(depth && map);
    for (size_t i = 0; i < t.photos; i++) {
        char path[FILE_PATH_MAX + 32];
        struct err e = {0};
        truth_depth(i, depth);
        for (size_t k = 0; k < pixels; k++)
            map[k] = (float)(4.0 * depth[k] + 0.1);
        snprintf(path, sizeof path, i % 2 ? "%s/p%02zu.png" : "%s/p%02zu.png.npy", dir, i);
        if (i % 2)
            png16_write(path, map, t.width_px, t.height_px);
        else
            kit_ok(npy_write(path, map, 2, shape, &e), e);
    }
    mem_free(depth);
    mem_free(map);
}

/* ---- F5: floaters ---- */

enum { F5_STEPS = 800, F5_RESET = 300, F5_EVERY = 50, F5_RUNS = 3 };
#define F5_FAINT 0.02
#define F5_GONE 0.95
#define F5_COST_DB 3.0      /* of the depth loss at most, against the same run without it */
#define F5_DEPTH_OFF 0.1    /* relative: what lies in the air is nearer by more */
#define F5_GROUND 0.07      /* 1 / m; where the truth has less the ground ends */
enum { F5_COMPONENT = 25 }; /* pixels: a floater covers 28 */

/* The truth with a floater for every 50 Gaussians in the air between ground and cameras. */
static void floaters_add(struct gauss *g, size_t *first)
{
    struct err e = {0};
    size_t n = g->n;
    *first = n;
    kit_ok(gauss_reserve(g, n + n / F5_EVERY, &e), e);
    for (size_t i = 0; i < n / F5_EVERY; i++) {
        gauss_copy_row(g, n + i, g, F5_EVERY * i);
        g->mean_m[3 * (n + i)] = (float)(8.0 * rng_unit(81, 1, i) - 4.0);
        g->mean_m[3 * (n + i) + 1] = (float)(8.0 * rng_unit(81, 2, i) - 4.0);
        g->mean_m[3 * (n + i) + 2] = (float)(3.0 + 5.0 * rng_unit(81, 3, i));
        for (size_t k = 0; k < 3; k++)
            g->scale_log[3 * (n + i) + k] = (float)log(0.15);
        g->opacity_logit[n + i] = 0.0f;
        for (size_t k = 0; k < 3; k++) /* the colour of what lies below: hard to tell by colour */
            g->sh[3 * gauss_sh_count(g->sh_degree) * (n + i) + k] = 0.0f;
    }
    g->n = n + n / F5_EVERY;
}

/* Pixels of the part of `off` that `at` belongs to, taken out of it. */
static size_t component(bool *off, size_t w, size_t h, size_t at)
{
    static size_t stack[4096];
    size_t n = 1, size = 0;
    stack[0] = at;
    off[at] = false;
    while (n) {
        size_t p = stack[--n], x = p % w, y = p / w;
        const size_t next[4] = {x ? p - 1 : p, x + 1 < w ? p + 1 : p, y ? p - w : p,
                                y + 1 < h ? p + w : p};
        size++;
        for (int k = 0; k < 4; k++)
            if (off[next[k]]) {
                off[next[k]] = false;
                stack[n++] = next[k];
            }
    }
    return size;
}

/* The largest connected part of any test photograph in which depth is off. */
static size_t largest_component(const struct gauss *g)
{
    struct toy t = ground_spec();
    size_t pixels = (size_t)t.width_px * t.height_px, worst = 0;
    double *truth = mem_array(pixels, sizeof *truth), *is = mem_array(pixels, sizeof *is);
    bool *off = mem_array(pixels, sizeof *off);
    assert_true(truth && is && off && pixels <= 4096);
    for (size_t i = 0; i < t.photos; i += t.test_every) {
        truth_depth(i, truth);
        depth_of(g, i, is);
        for (size_t p = 0; p < pixels; p++)
            off[p] = truth[p] > F5_GROUND && fabs(is[p] / truth[p] - 1.0) > F5_DEPTH_OFF;
        for (size_t p = 0; p < pixels; p++)
            if (off[p]) {
                size_t size = component(off, t.width_px, t.height_px, p);
                worst = size > worst ? size : worst;
            }
    }
    mem_free(truth);
    mem_free(is);
    mem_free(off);
    return worst;
}

/* Share of the floaters that are faint, mean opacity of all of them, and PSNR. */
static double floaters_train(const struct train_config *c, const struct gauss *g, size_t first,
                             double *mean_opacity, double *psnr, size_t *off_px)
{
    struct toy_run r;
    struct gauss after = {0};
    size_t faint = 0;
    toy_run_open_from(&r, scene_dir, c, g);
    (void)toy_run_level(&r);
    run_gauss(&r, &after);
    assert_int_equal(after.n, g->n);
    size_t n = after.n - first;
    *mean_opacity = 0.0;
    for (size_t i = first; i < after.n; i++) {
        double o = 1.0 / (1.0 + exp(-(double)after.opacity_logit[i]));
        *mean_opacity += o / (double)n;
        /* come down to the ground it is no floater any more */
        faint += o < F5_FAINT || after.mean_m[3 * i + 2] < 1.0f;
    }
    *psnr = toy_run_score(&r, 1.0).psnr_db;
    *off_px = largest_component(&after);
    gauss_free(&after);
    toy_run_close(&r);
    return (double)faint / (double)n;
}

static void floaters_fade(void **state)
{
    (void)state;
    static const struct {
        const char *name;
        bool maps, reset;
        int pass; /* of depth_pass: alternate|soft|hard */
    } runs[F5_RUNS] = {{"none+reset", false, true, 0},
                       {"hard+reset", true, true, 2},
                       {"alternate+reset", true, true, 0}};
    struct arena a = {0};
    struct toy t = ground_spec();
    struct gauss g = {0};
    char maps[FILE_PATH_MAX];
    size_t first;
    double share[F5_RUNS], mean[F5_RUNS], psnr[F5_RUNS];
    size_t off_px[F5_RUNS], off_before;
    kit_tmpdir(maps);
    maps_write(maps);
    ground_gauss(&t, &g);
    floaters_add(&g, &first);
    off_before = largest_component(&g);
    for (int i = 0; i < F5_RUNS; i++) {
        struct train_config c = plain_config(&a, F5_STEPS);
        c.lr_short = 1; /* the rates that the table in docs/training.md was measured at */
        c.lr_mean *= 2;
        c.lr_scale *= 2;
        c.lr_quat *= 2;
        c.depth_dir = runs[i].maps ? maps : NULL;
        c.depth_pass = runs[i].pass;
        c.reset_interval = runs[i].reset ? F5_RESET : c.reset_interval;
        c.densify_until.v[2] = 1.0; /* resets end an interval before */
        share[i] = floaters_train(&c, &g, first, &mean[i], &psnr[i], &off_px[i]);
        toy_figure("F5",
                   "depth=%s faint=%.2f limit=%.2f mean_opacity=%.4f psnr_db=%.2f "
                   "largest_part_off_px=%zu limit=%d before_px=%zu",
                   runs[i].name, share[i], F5_GONE, mean[i], psnr[i], off_px[i], F5_COMPONENT,
                   off_before);
    }
    assert_true(share[1] >= F5_GONE && share[2] >= F5_GONE);
    assert_true(share[0] < F5_GONE); /* it is the depth that does it */
    assert_true(off_px[2] <= F5_COMPONENT && off_px[2] < off_px[0] && off_before > F5_COMPONENT);
    assert_true(psnr[2] >= psnr[0] - F5_COST_DB);
    gauss_free(&g);
    kit_rmdir(maps);
    arena_free(&a);
}

/* ---- F16: statistics of densification ---- */

enum { F16_STEPS = 20, F16_STATS = 4 };

/* Statistics after some steps, and the parameters: [F16_STATS][n] and the model's floats. */
static float *f16_train(const struct train_config *c, uint32_t steps, size_t *floats)
{
    struct toy_run r;
    struct err e = {0};
    toy_run_open(&r, scene_dir, c);
    (void)toy_run_steps(&r, steps);
    const struct render_model *m = &r.level.model.gauss;
    size_t n = m->n, params = layout_floats(n, m->planes);
    float *out = mem_array(F16_STATS * n + params, sizeof *out);
    assert_non_null(out);
    cl_mem stats[F16_STATS] = {r.level.model.stats.grad, r.level.model.stats.absg,
                               r.level.model.stats.count, r.level.model.stats.radius};
    for (size_t i = 0; i < F16_STATS; i++)
        kit_ok(dev_read(&toy_dev, stats[i], 0, n * sizeof *out, out + i * n, &e), e);
    kit_ok(dev_read(&toy_dev, m->params, 0, params * sizeof *out, out + F16_STATS * n, &e), e);
    *floats = F16_STATS * n + params;
    toy_run_close(&r);
    return out;
}

static size_t f16_differing(const float *a, const float *b, size_t n)
{
    size_t bits = 0;
    for (size_t i = 0; i < n; i++)
        bits += memcmp(a + i, b + i, sizeof *a) != 0;
    return bits;
}

static void statistics_do_not_see_depth(void **state)
{
    (void)state;
    struct arena a = {0};
    struct train_config c = plain_config(&a, F16_STEPS + 30);
    size_t n, k, stats;
    c.absgrad_from = 1;
    float *plain = f16_train(&c, F16_STEPS, &n);
    c.depth_sparse = true;
    c.depth_pass = 2;
    c.depth_weight = c.depth_weight_final = 1e-300; /* drawn, differentiated, and 0 as a float */
    float *forced = f16_train(&c, F16_STEPS, &k);
    assert_int_equal(n, k);
    size_t weightless = f16_differing(plain, forced, n);
    mem_free(plain);
    mem_free(forced);
    /* With a weight parameters part ways after the first step: until then statistics are equal. */
    c.depth_weight = c.depth_weight_final = 0.5;
    forced = f16_train(&c, 1, &k);
    c.depth_sparse = false;
    plain = f16_train(&c, 1, &k);
    struct toy t = ground_spec();
    stats = F16_STATS * t.n;
    size_t weighted = f16_differing(plain, forced, stats);
    size_t moved = f16_differing(plain + stats, forced + stats, k - stats);
    toy_figure("F16", "differing_weight0=%zu differing_stats=%zu limit=0 params_moved=%zu",
               weightless, weighted, moved);
    assert_int_equal(weightless, 0);
    assert_int_equal(weighted, 0);
    assert_true(moved > t.n); /* the loss did act */
    mem_free(plain);
    mem_free(forced);
    arena_free(&a);
}

/* ---- F21: maps that are wrong, scenes of another scale ---- */

enum { F21_POINTS = 200 };
#define F21_SCALE 10.0
#define F21_CHANGE 0.01
#define F21_MAP_ERROR 0.06 /* points are the centres of blobs, maps what is seen of them */

static double f21_loss(double scale)
{
    struct toy t = ground_spec();
    struct gauss g = {0};
    struct scene s;
    struct depth_map *maps = NULL;
    struct depth_target target;
    struct err e = {0};
    const uint32_t image = 1;
    double loss, *depth = mem_array((size_t)t.width_px * t.height_px, sizeof *depth);
    assert_non_null(depth);
    ground_gauss(&t, &g);
    kit_ok(scene_read(scene_dir, &s, &e), e);
    for (size_t i = 0; i < g.n; i++)
        for (size_t k = 0; k < 3; k++) {
            g.mean_m[3 * i + k] *= (float)scale;
            g.scale_log[3 * i + k] += (float)log(scale);
            s.points[i].enu_m[k] *= 1.1 * scale; /* so that there is a difference to measure */
        }
    for (size_t i = 0; i < s.n_images; i++)
        for (size_t k = 0; k < 3; k++)
            s.images[i].cam.trans[k] *= scale;
    struct depth_map_config cfg = {.scene = &s, .images = &image, .n_images = 1, .sparse = true};
    kit_ok(depth_map_open(&cfg, &maps, &e), e);
    kit_ok(depth_map_target(maps, image, &s.images[image].cam, NULL, &target, &e), e);
    assert_true(target.n_known > 50);
    struct depth_input in = {.cam = &s.images[image].cam,
                             .options = {.aa = RENDER_AA_2D},
                             .target = target.t,
                             .unit_m = target.unit_m,
                             .n_known = target.n_known,
                             .weight = 0.5};
    kit_ok(depth_ref_loss(&g, &in, depth, &loss, &e), e);
    depth_map_close(&maps);
    scene_free(&s);
    gauss_free(&g);
    mem_free(depth);
    return loss;
}

static void depth_loss_does_not_depend_on_the_scale(void **state)
{
    (void)state;
    double here = f21_loss(1.0), large = f21_loss(F21_SCALE);
    double change = fabs(large / here - 1.0);
    toy_figure("F21", "loss=%.5f loss_x10=%.5f change=%.5f limit=%.2f", here, large, change,
               F21_CHANGE);
    assert_true(here > 1e-3);
    assert_true(change < F21_CHANGE);
}

static void maps_that_do_not_fit_are_told_apart(void **state)
{
    (void)state;
    double x[F21_POINTS], y[F21_POINTS], a, b;
    for (size_t i = 0; i < F21_POINTS; i++) {
        double z = 60.0 + 80.0 * rng_unit(91, 1, i);
        x[i] = 1.0 / z;
        y[i] = (x[i] - 0.002) / 0.05;
    }
    assert_int_equal(depth_align(x, y, F21_POINTS, &a, &b), DEPTH_MAP_OK);
    assert_true(fabs(a - 0.05) < 1e-9 && fabs(b - 0.002) < 1e-9);
    for (size_t i = 0; i < F21_POINTS; i += 10) /* a tenth of the points are wrong */
        y[i] = 0.05 + 0.2 * rng_unit(91, 2, i);
    assert_int_equal(depth_align(x, y, F21_POINTS, &a, &b), DEPTH_MAP_OK);
    assert_true(fabs(a / 0.05 - 1.0) < 0.25);
    assert_int_equal(depth_align(x, y, 10, &a, &b), DEPTH_MAP_FEW);
    for (size_t i = 0; i < F21_POINTS; i++)
        y[i] = 1.0 / x[i]; /* depth, not inverse depth */
    assert_int_equal(depth_align(x, y, F21_POINTS, &a, &b), DEPTH_MAP_MISFIT);
    for (size_t i = 0; i < F21_POINTS; i++)
        y[i] = 0.5;
    assert_int_equal(depth_align(x, y, F21_POINTS, &a, &b), DEPTH_MAP_FLAT);
    for (size_t i = 0; i < F21_POINTS; i++) /* a flight 300 m above flat ground: range 4 % */
        x[i] = 1.0 / (300.0 + 12.0 * rng_unit(91, 3, i));
    assert_int_equal(depth_align(x, y, F21_POINTS, &a, &b), DEPTH_MAP_FLAT);
    for (size_t i = 0; i < F21_POINTS; i++) { /* range 5 times, heavy tails: aligned, and far off */
        x[i] = i % 2 ? 0.01 : 0.05 * (1.0 + rng_unit(91, 4, i));
        y[i] = i % 2 ? rng_unit(91, 5, i) : 0.4 + rng_unit(91, 5, i);
    }
    assert_int_equal(depth_align(x, y, F21_POINTS, &a, &b), DEPTH_MAP_MISFIT);
}

/* From files: .npy and 16-bit .png, both ways of naming; one that is wrong, one that is missing. */
static void maps_are_read_aligned_and_left_out(void **state)
{
    (void)state;
    struct toy t = ground_spec();
    struct scene s;
    struct depth_map *maps = NULL;
    struct depth_target target;
    struct err e = {0};
    struct buf junk = {0};
    uint32_t *images;
    size_t n, pixels = (size_t)t.width_px * t.height_px, shape[2] = {t.height_px, t.width_px};
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX + 32];
    double *truth = mem_array(pixels, sizeof *truth), error = 0.0;
    size_t compared = 0;
    float *map = mem_array(pixels, sizeof *map);
    assert_true(truth && map);
    kit_tmpdir(dir);
    maps_write(dir);
    kit_ok(scene_read(scene_dir, &s, &e), e);
    kit_ok(train_scene_images(&s, SCENE_TRAIN, true, &images, &n, &e), e);
    struct depth_map_config cfg = {.scene = &s, .images = images, .n_images = n, .dir = dir};
    truth_depth(images[0], truth);
    for (size_t i = 0; i < pixels; i++)
        map[i] = (float)(1.0 / truth[i]);
    snprintf(path, sizeof path, "%s/%s.npy", dir, s.images[images[0]].name);
    kit_ok(npy_write(path, map, 2, shape, &e), e); /* depth where inverse depth is asked for */
    snprintf(path, sizeof path, "%s/p%02u.png%s", dir, images[1], images[1] % 2 ? "" : ".npy");
    assert_int_equal(remove(path), 0);
    kit_ok(depth_map_open(&cfg, &maps, &e), e);
    assert_int_equal(depth_map_count(maps, DEPTH_MAP_OK), n - 2);
    assert_int_equal(depth_map_count(maps, DEPTH_MAP_MISSING), 1);
    assert_int_equal(depth_map_count(maps, DEPTH_MAP_MISFIT), 1);
    for (size_t i = 0; i < n; i++) {
        kit_ok(depth_map_target(maps, images[i], &s.images[images[i]].cam, NULL, &target, &e), e);
        if (i < 2) {
            assert_int_equal(target.n_known, 0);
            continue;
        }
        assert_int_equal(target.n_known, pixels);
        truth_depth(images[i], truth);
        for (size_t p = 0; p < pixels; p++)
            if (truth[p] > 0.04) { /* elsewhere there is no ground: cameras are 10 m high */
                error += fabs((double)target.t[p] / target.unit_m / truth[p] - 1.0);
                compared++;
            }
    }
    error /= (double)compared;
    /* A part of a photograph has the same part of its map. */
    const struct camera *full = &s.images[images[n - 1]].cam;
    const struct camera_window window = {0.21, 0.4, 0.83, 0.9};
    const struct camera part = camera_crop(full, &window);
    uint32_t at[4];
    camera_window_px(full, &window, at);
    struct depth_target whole;
    kit_ok(depth_map_target(maps, images[n - 1], full, NULL, &whole, &e), e);
    for (size_t p = 0; p < pixels; p++)
        truth[p] = (double)whole.t[p] / whole.unit_m;
    kit_ok(depth_map_target(maps, images[n - 1], &part, NULL, &target, &e), e);
    assert_int_equal(target.n_known, at[2] * at[3]);
    for (uint32_t y = 0; y < at[3]; y++)
        for (uint32_t x = 0; x < at[2]; x++) {
            double is = (double)target.t[y * at[2] + x] / target.unit_m,
                   was = truth[(at[1] + y) * full->width_px + at[0] + x];
            assert_true(fabs(is / was - 1.0) < 1e-5);
        }
    uint8_t *mask = mem_array(pixels, 1); /* all but a corner is a car */
    assert_non_null(mask);
    memset(mask, 255, 40);
    kit_ok(depth_map_target(maps, images[n - 1], &s.images[images[n - 1]].cam, mask, &target, &e),
           e);
    assert_int_equal(target.n_known, 40);
    assert_true(target.t[39] >= 0.0f && target.t[40] < 0.0f);
    mem_free(mask);
    toy_figure("F21", "maps=%zu rejected=1 missing=1 mean_relative_error=%.4f limit=%.2f", n, error,
               F21_MAP_ERROR);
    assert_true(compared > 1000 && error < F21_MAP_ERROR);
    depth_map_close(&maps);
    snprintf(path, sizeof path, "%s/%s.npy", dir, s.images[images[0]].name);
    kit_ok(file_read(path, 0, &junk, &e), e);
    kit_ok(file_write(path, junk.data, junk.size / 2, &e), e);
    kit_fails(depth_map_open(&cfg, &maps, &e), ERR_FORMAT, e, "truncated");
    cfg.dir = scene_dir; /* no maps at all */
    kit_fails(depth_map_open(&cfg, &maps, &e), ERR_DATA, e, "no depth map can be used");
    buf_free(&junk);
    scene_free(&s);
    mem_free(truth);
    mem_free(map);
    kit_rmdir(dir);
}

/* ---- F30 with everything on ---- */

static void resume_train(const char *out, const int64_t *pieces, size_t n_pieces)
{
    struct arena a = {0};
    struct err e = {0};
    struct train_result r = {0};
    struct train_config c = toy_config(&a, out);
    c.iterations.one = 330;
    c.aa = RENDER_AA_MIP;
    c.depth_sparse = true;
    c.depth_interval = 2;
    c.scale_from = 0;
    c.scale_max_m = 0.5;
    c.budget.v[0] = 660;
    c.budget.v[1] = 700;
    c.budget.v[2] = 800;
    for (size_t i = 0; i < n_pieces; i++) {
        c.stop_after = pieces[i];
        c.resume = i > 0;
        kit_fails(train_run(scene_dir, &c, &r, &e), ERR_CANCEL, e, "--resume goes on");
        train_result_free(&r);
    }
    c.stop_after = 0;
    c.resume = n_pieces > 0;
    kit_ok(train_run(scene_dir, &c, &r, &e), e);
    train_result_free(&r);
    arena_free(&a);
}

static void resumed_runs_with_filter_and_depth_are_the_same(void **state)
{
    (void)state;
    /* in the middle of levels, around densifications and the filter's 100 steps */
    static const int64_t pieces[] = {37, 30, 45, 103};
    char *out[2];
    for (int i = 0; i < 2; i++) {
        out[i] = mem_array(FILE_PATH_MAX, 1);
        assert_non_null(out[i]);
        kit_tmpdir(out[i]);
        resume_train(out[i], pieces, i ? sizeof pieces / sizeof pieces[0] : 0);
    }
    for (int level = 1; level <= 3; level++) {
        struct ckpt c[2];
        struct err e = {0};
        for (int i = 0; i < 2; i++) {
            char path[FILE_PATH_MAX], name[64];
            snprintf(name, sizeof name, "cells/all/level%d.ckpt", level);
            kit_ok(file_join(path, out[i], name, &e), e);
            kit_ok(ckpt_read(path, &c[i], &e), e);
        }
        assert_int_equal(c[0].g.n, c[1].g.n);
        assert_memory_equal(c[0].g.mean_m, c[1].g.mean_m, c[0].g.n * 12);
        assert_memory_equal(c[0].g.scale_log, c[1].g.scale_log, c[0].g.n * 12);
        assert_memory_equal(c[0].g.opacity_logit, c[1].g.opacity_logit, c[0].g.n * 4);
        for (int i = 0; i < 2; i++)
            ckpt_free(&c[i]);
    }
    for (int i = 0; i < 2; i++) {
        kit_rmdir(out[i]);
        mem_free(out[i]);
    }
}

int main(int argc, char **argv)
{
    if (argc > 1)
        cmocka_set_test_filter(argv[1]);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(giants_and_needles_shrink),
        cmocka_unit_test(floaters_fade),
        cmocka_unit_test(statistics_do_not_see_depth),
        cmocka_unit_test(depth_loss_does_not_depend_on_the_scale),
        cmocka_unit_test(maps_that_do_not_fit_are_told_apart),
        cmocka_unit_test(maps_are_read_aligned_and_left_out),
        cmocka_unit_test(resumed_runs_with_filter_and_depth_are_the_same),
    };
    return cmocka_run_group_tests(tests, ground_setup, ground_teardown);
}
