/* See eval_city.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/train/eval_city.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

#include "cli/base/results.h"
#include "codec/container/ckpt.h"
#include "core/splat/exposure.h"
#include "lod/choose/view.h"
#include "lod/store/store.h"
#include "scene/cells/cell_plan.h"
#include "train/base/config.h"
#include "train/coarse.h"
#include "train/train_scene.h"

static double eval_city_bytes(const char *path)
{
    struct stat st;
    return stat(path, &st) ? 0.0 : (double)st.st_size;
}

/* ---- appearance ---- */

static void eval_city_clear(struct eval_city *c)
{
    appearance_view_close(&c->view);
    appearance_free(&c->model);
    c->view = (struct appearance_view){0};
    c->model = (struct appearance){0};
}

static struct appearance_view *eval_city_appearance(struct eval_city *c)
{
    return c->model.block ? &c->view : NULL;
}

/* Takes the appearance model of a checkpoint, if it has one. Those of all cells are the same. */
static enum err_code eval_city_take(struct eval_city *c, bool first, const struct ckpt *k,
                                    const char *path, struct err *e)
{
    struct appearance a;
    enum err_code rc = coarse_read_appearance(k, path, &a, e);
    if (rc)
        return rc;
    if (first) {
        c->model = a;
        return a.block ? appearance_view_open(&c->view, &c->model, &c->scene, e) : ERR_OK;
    }
    if (!a.block != !c->model.block || (a.block && !appearance_train_same(&a, &c->model)))
        rc = err_set(e, ERR_DATA,
                     "%s: its appearance model is not that of the cells before: train them with "
                     "--appearance-shared, which makes one for all",
                     path);
    appearance_free(&a);
    return rc;
}

static enum err_code eval_city_take_store(struct eval_city *c, const struct appearance *a,
                                          struct err *e)
{
    if (!a)
        return ERR_OK;
    enum err_code rc =
        appearance_alloc(&c->model, a->len_gauss, a->len_image, a->hidden, a->n_images, e);
    if (rc)
        return rc;
    memcpy(c->model.w1, a->w1, appearance_weights(a) * sizeof(float));
    memcpy(c->model.images, a->images, a->n_images * a->len_image * sizeof(float));
    memcpy(c->model.names, a->names, a->n_images * sizeof *a->names);
    return appearance_view_open(&c->view, &c->model, &c->scene, e);
}

/* ---- trained levels ---- */

/* What a level was trained with and must be drawn with. */
struct eval_city_settings {
    double max_edge_px, downsample, background, near_m;
    double steps; /* of training, over all cells */
    enum render_aa aa;
    bool exposure; /* photographs were brought to the mean one */
    bool all;      /* the finest level trained on with the test photographs too */
};

static enum err_code eval_city_read_settings(const struct ckpt *c, const char *path,
                                             struct eval_city_settings *out, struct err *e)
{
    const json_t *config = json_object_get(c->meta, "config");
    const char *aa = NULL;
    double edge_m = 0.0, steps = 0.0;
    enum err_code rc = jsonc_num(c->meta, "downsample", &out->downsample, e);
    if (!rc)
        rc = jsonc_num(c->meta, "steps", &steps, e);
    if (!rc)
        rc = jsonc_num(c->meta, "edge_m", &edge_m, e);
    if (!rc)
        rc = jsonc_num(config, "max_edge_px", &out->max_edge_px, e);
    if (!rc)
        rc = jsonc_num(config, "background", &out->background, e);
    if (!rc)
        rc = jsonc_num(config, "near_m", &out->near_m, e);
    if (!rc)
        rc = jsonc_text(config, "aa", &aa, e);
    if (rc)
        return err_add(e, "%s", path);
    if (!(out->downsample >= 1.0) || !(out->max_edge_px >= 0.0 && out->max_edge_px <= 65535.0))
        return err_set(e, ERR_FORMAT, "%s: impossible picture size", path);
    out->exposure = json_is_true(json_object_get(config, "exposure"));
    out->aa = !strcmp(aa, "none")  ? RENDER_AA_NONE
              : !strcmp(aa, "mip") ? RENDER_AA_MIP
                                   : RENDER_AA_2D;
    if (!(out->near_m > 0.0))
        out->near_m = fmax(RENDER_NEAR_M, edge_m / 1000.0);
    out->all = json_is_true(json_object_get(config, "final_all")) &&
               json_equal(json_object_get(c->meta, "level"), json_object_get(c->meta, "levels"));
    out->steps += fmin(fmax(steps, 0.0), 1e9);
    return ERR_OK;
}

/* Add the rows that cell `index` of the plan owns (without a plan: all of them). */
static enum err_code eval_city_append(const struct eval_city *c, size_t index,
                                      const struct gauss *g, struct gauss *out, struct err *e)
{
    size_t n = 0;
    if (!out->block) {
        enum err_code rc = gauss_alloc(out, g->n, g->sh_degree, g->embed_len, e);
        if (rc)
            return rc;
        memcpy(out->origin_enu_m, g->origin_enu_m, sizeof g->origin_enu_m);
    }
    if (c->plan.n_cells < 2)
        return gauss_append(out, g, NULL, g->n, e);
    uint32_t *rows = mem_array(g->n, sizeof *rows);
    if (!rows)
        return err_set(e, ERR_MEM, "eval: out of memory for %zu Gaussians", g->n);
    for (size_t i = 0; i < g->n; i++)
        if (partition_owner(&c->plan, g->origin_enu_m[0] + (double)g->mean_m[3 * i],
                            g->origin_enu_m[1] + (double)g->mean_m[3 * i + 1]) == index)
            rows[n++] = (uint32_t)i;
    enum err_code rc = gauss_append(out, g, rows, n, e);
    mem_free(rows);
    return rc;
}

/* A level of all cells put together. *found: how many cells have it. */
static enum err_code eval_city_load_level(struct eval_city *c, const char *dir, unsigned level,
                                          struct gauss *g, struct eval_city_settings *s,
                                          size_t *found, double *bytes, struct err *e)
{
    char path[FILE_PATH_MAX + 64];
    size_t n = c->plan.n_cells ? c->plan.n_cells : 1;
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < n; i++) {
        struct ckpt k = {0};
        if (c->plan.n_cells && c->plan.cells[i].parent >= 0)
            continue;
        snprintf(path, sizeof path, "%s/cells/%s/level%u.ckpt", dir,
                 c->plan.n_cells ? c->plan.cells[i].id : "all", level);
        if (!file_exists(path))
            continue;
        rc = ckpt_read(path, &k, e);
        if (!rc)
            rc = results_check_origin(&c->scene, path, k.meta, e);
        if (!rc)
            rc = eval_city_read_settings(&k, path, s, e);
        if (!rc)
            rc = eval_city_take(c, *found == 0, &k, path, e);
        if (!rc)
            rc = eval_city_append(c, i, &k.g, g, e);
        (*found)++;
        if (!rc)
            *bytes += eval_city_bytes(path);
        ckpt_free(&k);
    }
    return rc;
}

static enum err_code eval_city_prepare_model(void *user, const struct camera *cam,
                                             const struct render_model **model,
                                             struct render_options *ro, struct err *e)
{
    const struct evaluate_model *m = user;
    (void)cam;
    (void)e;
    *model = m->model;
    *ro = m->options;
    return ERR_OK;
}

/* An opacity below 0.5 has a logit below 0. */
static double eval_city_faint(const struct gauss *g)
{
    size_t faint = 0;
    for (size_t i = 0; i < g->n; i++)
        faint += g->opacity_logit[i] < 0.0f;
    return (double)faint / (double)g->n;
}

static enum err_code eval_city_level(struct eval_city *c, const char *dir, unsigned level,
                                     eval_city_fn *fn, void *user, size_t *found, struct err *e)
{
    struct gauss g = {0};
    struct render_model model = {0};
    struct eval_city_settings s = {0};
    char what[32];
    size_t n = 0;
    double bytes = 0.0;
    snprintf(what, sizeof what, "level %u", level);
    enum err_code rc = eval_city_load_level(c, dir, level, &g, &s, &n, &bytes, e);
    if (!rc && n)
        rc = render_model_upload(c->render, &g, &model, e);
    if (!rc && n) {
        float grey = (float)s.background;
        struct evaluate_model own = {
            c->render,
            &model,
            {.aa = s.aa, .background = {grey, grey, grey}, .near_m = s.near_m, .sh_degree = -1},
            eval_city_appearance(c)};
        struct evaluate_model fine = own, above = own;
        fine.options.supersample = c->supersample;
        above.options.orthographic = true;
        const struct eval_drawing d = {.what = what,
                                       .src = {.draw = evaluate_draw_model,
                                               .user = &fine,
                                               .bytes = bytes,
                                               .render = c->render},
                                       .own_size = c->supersample > 1 ? &own : NULL,
                                       .above = &above,
                                       .prepare = eval_city_prepare_model,
                                       .prepare_user = &own,
                                       .appearance = own.appearance,
                                       .exposure = c->exposed && s.exposure,
                                       .max_edge_px = c->o.max_edge_px ? (uint32_t)c->o.max_edge_px
                                                                       : (uint32_t)s.max_edge_px,
                                       .downsample = c->full_size ? 1.0 : s.downsample,
                                       .all_photographs = s.all,
                                       .trained_steps = s.steps,
                                       .gaussians = (double)g.n,
                                       .faint = eval_city_faint(&g)};
        rc = fn(user, &d, e);
    }
    eval_city_clear(c);
    render_model_free(&model);
    gauss_free(&g);
    *found += n;
    return rc;
}

/* Cells that are there and not trained to their end. */
static void eval_city_warn(const struct eval_city *c, const char *dir)
{
    char path[FILE_PATH_MAX + 64];
    for (size_t i = 0; i < (c->plan.n_cells ? c->plan.n_cells : 1); i++) {
        const char *id = c->plan.n_cells ? c->plan.cells[i].id : "all";
        snprintf(path, sizeof path, "%s/cells/%s", dir, id);
        if (file_is_dir(path))
            results_warn_unfinished("eval", &c->scene, dir, id);
    }
}

static enum err_code eval_city_levels(struct eval_city *c, bool finest, eval_city_fn *fn,
                                      void *user, struct err *e)
{
    const char *dir = c->o.results ? c->o.results : c->scene.dir;
    char path[FILE_PATH_MAX];
    size_t found = 0;
    enum err_code rc = file_join(path, c->scene.dir, "plan.json", e);
    if (!rc && file_exists(path))
        rc = cell_plan_read(path, &c->scene, &c->plan, e);
    if (!rc)
        eval_city_warn(c, dir);
    if (finest)
        for (unsigned level = TRAIN_LEVELS_MAX; !rc && level && !found; level--)
            rc = eval_city_level(c, dir, level, fn, user, &found, e);
    for (unsigned level = 1; !rc && !finest && level <= TRAIN_LEVELS_MAX; level++)
        rc = eval_city_level(c, dir, level, fn, user, &found, e);
    if (!rc && !found)
        rc = err_set(e, ERR_NOENT, "%s: no level1.ckpt in cells/; `citysplat train` makes it", dir);
    return rc;
}

/* ---- a tile store ---- */

struct eval_city_view {
    struct view *view;
    struct render_options ro;
    struct pick_options po;
    uint32_t supersample;
    struct appearance_view *appearance; /* NULL: without appearance */
};

static enum err_code eval_city_prepare_view(void *user, const struct camera *cam,
                                            const struct render_model **model,
                                            struct render_options *ro, struct err *e)
{
    struct eval_city_view *w = user;
    struct view_stats stats;
    *ro = w->ro;
    return view_model(w->view, cam, &w->po, model, &stats, e);
}

static enum err_code eval_city_draw_view(void *user, const struct camera *cam, float *rgb,
                                         double *gaussians, struct err *e)
{
    struct eval_city_view *w = user;
    struct view_stats stats = {0};
    struct render_options ro = w->ro;
    ro.supersample = w->supersample;
    if (w->appearance) {
        ro.appearance_frame = appearance_view_frame(w->appearance, cam);
        ro.appearance_hidden = w->appearance->model->hidden;
    }
    enum err_code rc = view_render(w->view, cam, &ro, &w->po, rgb, &stats, e);
    *gaussians = (double)stats.n_gaussians;
    return rc;
}

enum err_code eval_city_store(struct eval_city *c, struct view **out, struct render_options *ro,
                              struct pick_options *po, struct err *e)
{
    *ro = (struct render_options){.sh_degree = -1};
    *po = (struct pick_options){.metric = c->metric,
                                .error_px = c->o.error_px,
                                .distance_m = {c->distance_m[0], c->distance_m[1]}};
    enum err_code rc = view_open(c->o.tiles, c->render, c->cache_bytes, out, e);
    if (!rc)
        rc = results_check_frame(&c->scene, c->o.tiles, &store_info(view_store(*out))->origin, e);
    if (!rc) /* as the Gaussians were trained */
        ro->aa = store_info(view_store(*out))->antialiased ? RENDER_AA_2D : RENDER_AA_NONE;
    return rc;
}

static enum err_code eval_city_tiles(struct eval_city *c, bool with_levels, eval_city_fn *fn,
                                     void *user, struct err *e)
{
    struct eval_city_view w = {.supersample = c->supersample};
    enum err_code rc = eval_city_store(c, &w.view, &w.ro, &w.po, e);
    if (!rc)
        rc = eval_city_take_store(c, view_appearance(w.view), e);
    w.appearance = rc ? NULL : eval_city_appearance(c);
    struct eval_city_view own = w, above = w;
    own.supersample = above.supersample = 1;
    above.ro.orthographic = above.po.no_lod = true;
    struct eval_drawing d = {.what = "tiles, LOD",
                             .src = {.draw = eval_city_draw_view,
                                     .user = &w,
                                     .bytes = eval_city_bytes(c->o.tiles),
                                     .render = c->render},
                             .own_size = c->supersample > 1 ? &own : NULL,
                             .above = &above,
                             .prepare = eval_city_prepare_view,
                             .prepare_user = &w,
                             .appearance = w.appearance,
                             .exposure = c->exposed,
                             .max_edge_px = (uint32_t)c->o.max_edge_px,
                             .downsample = 1.0,
                             .gaussians = (double)NAN,
                             .faint = (double)NAN};
    if (!rc && with_levels)
        rc = fn(user, &d, e);
    w.po.no_lod = own.po.no_lod = true;
    d.what = "tiles, no LOD";
    if (!rc)
        rc = fn(user, &d, e);
    eval_city_clear(c);
    view_close(&w.view);
    return rc;
}

/* ---- all of it ---- */

void eval_city_defaults(struct eval_city *c)
{
    c->supersample = 1;
    c->metric = PICK_SCREEN;
    c->cache_bytes = (size_t)2048 << 20;
}

enum err_code eval_city_open(struct eval_city *c, const char *scene_dir, enum scene_split split,
                             struct err *e)
{
    enum err_code rc = scene_read(scene_dir, &c->scene, e);
    if (!rc)
        rc = train_scene_images(&c->scene, split, true, &c->images, &c->n_images, e);
    for (size_t i = 0; !rc && i < c->scene.n_images; i++)
        c->exposed |= !exposure_is_mean(c->scene.images[i].exposure_ev);
    if (!rc && !c->n_images)
        rc = err_set(e, ERR_DATA, "%s: the scene keeps no %s photographs", scene_dir,
                     split == SCENE_TRAIN ? "training" : "test");
    if (!rc)
        rc = dev_open(c->o.device, &c->dev, e);
    c->dev_is_open = !rc;
    if (!rc)
        rc = render_open(&c->dev, &c->render, e);
    return rc;
}

void eval_city_close(struct eval_city *c)
{
    eval_city_clear(c);
    render_close(&c->render);
    if (c->dev_is_open)
        dev_close(&c->dev);
    partition_free(&c->plan);
    scene_free(&c->scene);
}

enum err_code eval_city_each(struct eval_city *c, enum eval_city_which which, eval_city_fn *fn,
                             void *user, struct err *e)
{
    return c->o.tiles ? eval_city_tiles(c, which != EVAL_CITY_ONE, fn, user, e)
                      : eval_city_levels(c, which != EVAL_CITY_ALL, fn, user, e);
}
