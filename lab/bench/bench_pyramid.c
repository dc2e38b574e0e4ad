/* Compares ways to make the coarse levels of a pyramid: the trainer's own levels, or the finest
 * level reduced to as many Gaussians.
 *
 * For every level but the finest of a trained scene (--scene, --trained) the finest level is
 * reduced by:
 * - merging pairs (lod/make/simplify.c)
 * - keeping the Gaussians of largest coverage (opacity times projected area)
 * - keeping those that contribute most to the training photographs (sum of alpha T)
 * - a systematic sample, grown until the coverage is as before (Cook 2007, Stochastic
 *   Simplification of Aggregate Detail)
 * - every n-th Gaussian, unchanged
 *
 * Test photographs are drawn at three sizes: that of the level's training; the size at which the
 * median sigma of the trained level is one pixel, where clients change to it from the finer level;
 * and half of that. psnr_db is against the photographs, finest_db against pictures of the finest
 * level at that size. A photograph of half the size stands for one from twice the distance, apart
 * from perspective.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include <jansson.h>

#include "codec/container/ckpt.h"
#include "codec/scene/scene.h"
#include "core/layout.h"
#include "core/math/sort.h"
#include "lab/bench/bench.h"
#include "lab/bench/test_views.h"
#include "lod/make/simplify.h"
#include "scene/cells/cell_plan.h"
#include "scene/cells/partition.h"
#include "train/base/config.h"
#include "train/photographs/photo_loader.h"
#include "train/train.h"
#include "train/train_scene.h"

enum { NAME_MAX_BYTES = 64, SIZES = 3, EDGE_MIN_PX = 16 };

struct pyr_level {
    struct gauss g;
    double downsample, max_edge_px, near_m, grey;
    enum render_aa aa;
};
struct pyr {
    struct bench *b;
    struct scene scene;
    struct partition plan;
    uint32_t *images, *train; /* test and training photographs */
    size_t n_images, n_train;
    struct render *render;
    struct pyr_level level[TRAIN_LEVELS_MAX + 1]; /* [1..n_levels] */
    unsigned n_levels;
    float *cover, *given; /* [n] of the finest level: opacity x area; contribution */
};

/* ---- the trained levels ---- */

static enum err_code pyramid_settings(const struct ckpt *c, struct pyr_level *out, struct err *e)
{
    const json_t *config = json_object_get(c->meta, "config");
    const char *aa = NULL;
    enum err_code rc = jsonc_num(c->meta, "downsample", &out->downsample, e);
    if (!rc)
        rc = jsonc_num(config, "max_edge_px", &out->max_edge_px, e);
    if (!rc)
        rc = jsonc_num(config, "background", &out->grey, e);
    if (!rc)
        rc = jsonc_num(config, "near_m", &out->near_m, e);
    if (!rc)
        rc = jsonc_text(config, "aa", &aa, e);
    if (!rc)
        out->aa = !strcmp(aa, "none")  ? RENDER_AA_NONE
                  : !strcmp(aa, "mip") ? RENDER_AA_MIP
                                       : RENDER_AA_2D;
    return rc;
}

/* The rows of a cell's checkpoint on its own ground. */
static enum err_code pyramid_append(const struct pyr *p, size_t cell, const struct gauss *g,
                                    struct gauss *out, struct err *e)
{
    size_t n = 0;
    enum err_code rc = ERR_OK;
    uint32_t *rows = mem_array(g->n, sizeof *rows);
    if (!rows)
        return err_set(e, ERR_MEM, "out of memory for %zu Gaussians", g->n);
    for (size_t i = 0; i < g->n; i++)
        if (p->plan.n_cells < 2 ||
            partition_owner(&p->plan, g->origin_enu_m[0] + (double)g->mean_m[3 * i],
                            g->origin_enu_m[1] + (double)g->mean_m[3 * i + 1]) == cell)
            rows[n++] = (uint32_t)i;
    if (!out->block) {
        rc = gauss_alloc(out, n, g->sh_degree, g->embed_len, e);
        memcpy(out->origin_enu_m, g->origin_enu_m, sizeof g->origin_enu_m);
        out->antialiased = g->antialiased;
    }
    if (!rc)
        rc = gauss_append(out, g, rows, n, e);
    mem_free(rows);
    return rc;
}

static enum err_code pyramid_read_level(struct pyr *p, unsigned level, struct err *e)
{
    char path[FILE_PATH_MAX + 64];
    size_t n = p->plan.n_cells ? p->plan.n_cells : 1;
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < n; i++) {
        struct ckpt c = {0};
        snprintf(path, sizeof path, "%s/cells/%s/level%u.ckpt", p->b->trained,
                 p->plan.n_cells ? p->plan.cells[i].id : "all", level);
        if ((p->plan.n_cells && p->plan.cells[i].parent >= 0) || !file_exists(path))
            continue;
        rc = ckpt_read(path, &c, e);
        if (!rc)
            rc = pyramid_settings(&c, &p->level[level], e);
        if (!rc)
            rc = pyramid_append(p, i, &c.g, &p->level[level].g, e);
        ckpt_free(&c);
    }
    if (!rc && p->level[level].g.n)
        p->n_levels = level;
    return rc;
}

static enum err_code pyramid_open(struct pyr *p, struct err *e)
{
    char path[FILE_PATH_MAX];
    enum err_code rc = scene_read(p->b->scene, &p->scene, e);
    if (!rc)
        rc = train_scene_images(&p->scene, SCENE_TEST, true, &p->images, &p->n_images, e);
    if (!rc)
        rc = train_scene_images(&p->scene, SCENE_TRAIN, true, &p->train, &p->n_train, e);
    if (!rc && (!p->n_images || !p->n_train))
        rc = err_set(e, ERR_DATA, "%s: keeps no test photographs", p->b->scene);
    if (!rc)
        rc = file_join(path, p->b->scene, "plan.json", e);
    if (!rc && file_exists(path))
        rc = cell_plan_read(path, &p->scene, &p->plan, e);
    for (unsigned l = 1; !rc && l <= TRAIN_LEVELS_MAX; l++)
        rc = pyramid_read_level(p, l, e);
    if (!rc && p->n_levels < 2)
        rc = err_set(e, ERR_NOENT, "%s: no two trained levels in cells/", p->b->trained);
    return rc ? rc : render_open(p->b->dev, &p->render, e);
}

static struct render_options pyramid_render_options(const struct pyr_level *l)
{
    const float grey = (float)l->grey;
    return (struct render_options){
        .aa = l->aa, .background = {grey, grey, grey}, .near_m = l->near_m, .sh_degree = -1};
}

/* ---- what the finest Gaussians are worth ---- */

static double pyramid_sigma(const struct gauss *g, size_t i)
{
    const float *s = g->scale_log + 3 * i;
    return exp((double)fmaxf(s[0], fmaxf(s[1], s[2])));
}

static double pyramid_cover(const struct gauss *g, size_t i)
{
    const float *s = g->scale_log + 3 * i;
    const double sigma[3] = {exp((double)s[0]), exp((double)s[1]), exp((double)s[2])};
    return simplify_area(sigma) / (1 + exp(-(double)g->opacity_logit[i]));
}

/* Sum of alpha T over the pixels of all training photographs of the finest level's size. */
static enum err_code pyramid_contribution(struct pyr *p, struct err *e)
{
    const struct pyr_level *l = &p->level[p->n_levels];
    const struct render_options ro = pyramid_render_options(l);
    struct render_model m = {0};
    struct render_importance *score = NULL;
    cl_mem weight = NULL;
    const float *sums = NULL;
    enum err_code rc = render_importance_open(p->render, &score, e);
    if (!rc)
        rc = render_model_upload(p->render, &l->g, &m, e);
    for (size_t v = 0; !rc && v < p->n_train; v++) {
        const struct camera cam = photo_loader_camera(&p->scene.images[p->train[v]].cam,
                                                      (uint32_t)l->max_edge_px, l->downsample);
        size_t bytes = (size_t)cam.width_px * cam.height_px * sizeof(float);
        dev_release(&weight); /* only alpha T is asked for, which takes no weights */
        rc = dev_buffer(p->b->dev, bytes, NULL, &weight, e);
        if (!rc)
            rc = dev_zero(p->b->dev, weight, 0, bytes, e);
        if (!rc)
            rc = render_forward(p->render, &m, &cam, &ro, NULL, NULL, e);
        if (!rc)
            rc = render_importance_run(score, &m, weight, &sums, e);
        for (size_t i = 0; !rc && i < l->g.n; i++)
            p->given[i] += sums[LAYOUT_IMPORTANCE_SUMS * i + LAYOUT_IMPORTANCE_SHARE];
    }
    dev_release(&weight);
    render_importance_close(&score);
    render_model_free(&m);
    return rc;
}

static enum err_code pyramid_weigh(struct pyr *p, struct err *e)
{
    const struct gauss *g = &p->level[p->n_levels].g;
    p->cover = mem_array(g->n, sizeof *p->cover);
    p->given = mem_array(g->n, sizeof *p->given);
    if (!p->cover || !p->given)
        return err_set(e, ERR_MEM, "out of memory for %zu Gaussians", g->n);
    for (size_t i = 0; i < g->n; i++)
        p->cover[i] = (float)pyramid_cover(g, i);
    return pyramid_contribution(p, e);
}

/* ---- ways to fewer ---- */

enum pyr_way {
    WAY_TRAINED,
    WAY_MERGED,
    WAY_COVERAGE,
    WAY_CONTRIBUTION,
    WAY_SAMPLED,
    WAY_NTH,
    WAYS
};
static const char *const way_names[WAYS] = {
    "trained",           "merged pairs", "most coverage, grown", "most contribution, grown",
    "every n-th, grown", "every n-th"};

/* The n rows of largest score, in their order. */
static enum err_code pyramid_largest(const float *score, size_t n_all, size_t n, uint32_t *rows,
                                     struct err *e)
{
    struct sort_item *item = mem_array(n_all, sizeof *item),
                     *spare = mem_array(n_all, sizeof *item);
    bool *keep = mem_array(n_all, sizeof *keep);
    enum err_code rc =
        item && spare && keep ? ERR_OK : err_set(e, ERR_MEM, "out of memory for %zu rows", n_all);
    for (size_t i = 0; !rc && i < n_all; i++)
        item[i] = (struct sort_item){sort_key_float(-score[i]), (uint32_t)i};
    if (!rc)
        sort_items(item, spare, n_all);
    for (size_t i = 0; !rc && i < n; i++)
        keep[item[i].row] = true;
    for (size_t i = 0, to = 0; !rc && i < n_all; i++)
        if (keep[i])
            rows[to++] = (uint32_t)i;
    mem_free(item);
    mem_free(spare);
    mem_free(keep);
    return rc;
}

/* As many as `n` of the finest level by the given way. */
static enum err_code pyramid_make(const struct pyr *p, enum pyr_way way, size_t n,
                                  struct gauss *out, struct err *e)
{
    const struct gauss *g = &p->level[p->n_levels].g;
    if (way == WAY_MERGED)
        return simplify_gauss(g, n, out, e);
    uint32_t *rows = mem_array(n, sizeof *rows);
    enum err_code rc = rows ? gauss_alloc(out, n, g->sh_degree, g->embed_len, e)
                            : err_set(e, ERR_MEM, "out of memory for %zu rows", n);
    if (!rc && (way == WAY_COVERAGE || way == WAY_CONTRIBUTION))
        rc = pyramid_largest(way == WAY_COVERAGE ? p->cover : p->given, g->n, n, rows, e);
    else if (!rc) /* levels lie along a Morton curve: a systematic sample is an even one */
        for (size_t i = 0; i < n; i++)
            rows[i] = (uint32_t)(i * g->n / n);
    memcpy(out->origin_enu_m, g->origin_enu_m, sizeof g->origin_enu_m);
    out->antialiased = g->antialiased;
    if (!rc)
        rc = gauss_append(out, g, rows, n, e);
    double all = 0, kept = 0;
    for (size_t i = 0; i < g->n; i++)
        all += (double)p->cover[i];
    for (size_t i = 0; !rc && i < n; i++)
        kept += (double)p->cover[rows[i]];
    for (size_t i = 0; !rc && way != WAY_NTH && i < 3 * n; i++)
        out->scale_log[i] += (float)(0.5 * log(all / kept)); /* areas, so half of it */
    mem_free(rows);
    return rc;
}

/* ---- scores ---- */

/* Median over a level of each Gaussian's largest sigma, and over the Gaussians that test
 * photographs see of their depth. */
static enum err_code pyramid_measure(const struct pyr *p, const struct gauss *g, double *sigma_m,
                                     double *depth_m, struct err *e)
{
    enum { SAMPLE = 4096 };
    size_t n = 0, step = g->n / SAMPLE + 1;
    float *v = mem_array(g->n + SAMPLE * p->n_images, sizeof *v);
    if (!v)
        return err_set(e, ERR_MEM, "out of memory for %zu Gaussians", g->n);
    for (size_t i = 0; i < g->n; i++)
        v[i] = (float)pyramid_sigma(g, i);
    *sigma_m = (double)sort_select(v, g->n, g->n / 2);
    for (size_t c = 0; c < p->n_images; c++) {
        const struct camera *cam = &p->scene.images[p->images[c]].cam;
        for (size_t i = 0; i < g->n; i += step) {
            double at[3] = {cam->trans[0], cam->trans[1], cam->trans[2]};
            for (size_t k = 0; k < 9; k++)
                at[k / 3] +=
                    cam->rot[k] * ((double)g->mean_m[3 * i + k % 3] + g->origin_enu_m[k % 3]);
            double u = cam->fx_px * at[0] / at[2] + cam->cx_px,
                   v_px = cam->fy_px * at[1] / at[2] + cam->cy_px;
            if (at[2] > RENDER_NEAR_M && u >= 0 && v_px >= 0 && u < cam->width_px &&
                v_px < cam->height_px)
                v[n++] = (float)at[2];
        }
    }
    *depth_m = n ? (double)sort_select(v, n, n / 2) : 1;
    mem_free(v);
    return ERR_OK;
}

struct pyr_size {
    const char *name;
    double downsample;
    struct test_views shots;
};

static enum err_code pyramid_row(struct pyr *p, unsigned level, enum pyr_way way,
                                 const struct gauss *g, struct pyr_size *size, struct err *e)
{
    const struct render_options ro = pyramid_render_options(&p->level[level]);
    struct test_views_score s;
    char what[NAME_MAX_BYTES], name[2 * NAME_MAX_BYTES];
    enum err_code rc = test_views_score(&size->shots, g, &ro, false, &s, e);
    if (rc)
        return rc;
    snprintf(what, sizeof what, "level %u, %s", level, size->name);
    snprintf(name, sizeof name, "%s, %s", what, way_names[way]);
    bench_report(p->b, name, s.psnr_db, "dB", s.self_db, "the finest, dB");
    return bench_record(p->b, way_names[way], what,
                        json_pack("{s:i, s:i, s:f, s:f, s:f, s:I, s:i}", "level", (int)level,
                                  "edge_px", (int)size->shots.edge_px, "psnr_db", s.psnr_db, "ssim",
                                  s.ssim, "finest_db", s.self_db, "gaussians", (json_int_t)g->n,
                                  "photographs", (int)p->n_images),
                        e);
}

static enum err_code pyramid_open_sizes(struct pyr *p, unsigned level, struct pyr_size size[SIZES],
                                        struct err *e)
{
    const struct pyr_level *l = &p->level[level], *finest = &p->level[p->n_levels];
    double sigma_m = 1, depth_m = 1;
    enum err_code rc = pyramid_measure(p, &l->g, &sigma_m, &depth_m, e);
    if (rc)
        return rc;
    const struct camera cam =
        photo_loader_camera(&p->scene.images[p->images[0]].cam, (uint32_t)l->max_edge_px, 1);
    double most = fmax(cam.width_px, cam.height_px) / EDGE_MIN_PX;
    double used = fmin(fmax(cam.fx_px * sigma_m / depth_m, 1), most);
    size[0] = (struct pyr_size){.name = "own size", .downsample = l->downsample};
    size[1] = (struct pyr_size){.name = "sigma 1 px", .downsample = used};
    size[2] = (struct pyr_size){.name = "sigma 1/2 px", .downsample = fmin(2 * used, most)};
    log_info("bench", "level %u: median sigma %.3g m, median depth %.3g m", level, sigma_m,
             depth_m);
    for (size_t i = 0; !rc && i < SIZES; i++) {
        const struct render_options ro = pyramid_render_options(finest);
        struct test_views_score own;
        rc = test_views_open(p->render, &p->scene, p->images, p->n_images, (uint32_t)l->max_edge_px,
                             size[i].downsample, &size[i].shots, e);
        if (!rc)
            rc = test_views_score(&size[i].shots, &finest->g, &ro, true, &own, e);
        char what[NAME_MAX_BYTES];
        snprintf(what, sizeof what, "level %u, %s", level, size[i].name);
        if (!rc)
            rc = bench_record(p->b, "finest level", what,
                              json_pack("{s:i, s:i, s:f, s:f, s:I, s:i}", "level", (int)level,
                                        "edge_px", (int)size[i].shots.edge_px, "psnr_db",
                                        own.psnr_db, "ssim", own.ssim, "gaussians",
                                        (json_int_t)finest->g.n, "photographs", (int)p->n_images),
                              e);
        bench_report(p->b, what, own.psnr_db, "dB", 0, NULL);
    }
    return rc;
}

static enum err_code pyramid_level_run(struct pyr *p, unsigned level, struct err *e)
{
    struct pyr_size size[SIZES] = {0};
    const struct gauss *trained = &p->level[level].g, *finest = &p->level[p->n_levels].g;
    size_t n = trained->n < finest->n ? trained->n : finest->n;
    enum err_code rc = pyramid_open_sizes(p, level, size, e);
    for (int way = 0; !rc && way < WAYS; way++) {
        struct gauss made = {0};
        if (way != WAY_TRAINED)
            rc = pyramid_make(p, (enum pyr_way)way, n, &made, e);
        for (size_t i = 0; !rc && i < SIZES; i++)
            rc = pyramid_row(p, level, (enum pyr_way)way, way == WAY_TRAINED ? trained : &made,
                             &size[i], e);
        gauss_free(&made);
        if (!rc && signals_stopping())
            rc = err_set(e, ERR_CANCEL, "stopped");
    }
    for (size_t i = 0; i < SIZES; i++)
        test_views_close(&size[i].shots);
    return rc;
}

enum err_code bench_pyramid(struct bench *b, struct err *e)
{
    struct pyr p = {.b = b};
    if (!b->scene) {
        log_info("bench", "pyramid skipped: it takes --scene DIR, and --trained DIR if its cells "
                          "are elsewhere");
        return ERR_OK;
    }
    enum err_code rc = pyramid_open(&p, e);
    if (!rc)
        rc = pyramid_weigh(&p, e);
    for (unsigned l = p.n_levels; !rc && l-- > 1;)
        rc = pyramid_level_run(&p, l, e);
    if (!rc)
        rc = bench_record_write(b, e);
    for (unsigned l = 0; l <= TRAIN_LEVELS_MAX; l++)
        gauss_free(&p.level[l].g);
    mem_free(p.cover);
    mem_free(p.given);
    render_close(&p.render);
    partition_free(&p.plan);
    scene_free(&p.scene);
    return rc;
}
