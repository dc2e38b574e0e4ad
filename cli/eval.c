/* citysplat eval: how close pictures of a trained scene, or of its tile store, come to photographs.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

#include <jansson.h>

#include "cells/cell_plan.h"
#include "cells/footprint.h"
#include "cells/partition.h"
#include "cli/cli.h"
#include "cli/eval_flight.h"
#include "cli/eval_half_image.h"
#include "cli/eval_surface.h"
#include "cli/eval_views.h"
#include "cli/output.h"
#include "codec/ckpt.h"
#include "codec/scene.h"
#include "core/exposure.h"
#include "lod/pick.h"
#include "lod/view.h"
#include "loss/lpips.h"
#include "train/appearance_train.h"
#include "train/config.h"
#include "train/evaluate.h"
#include "train/photo_loader.h"
#include "train/residual.h"
#include "train/train.h"
#include "train/train_scene.h"

struct eval_options {
#define OPT(type, tier, key, def, lo, hi, unit, help) OPTIONS_C_##type key;
#include "cli/eval.def"
#undef OPT
};

static const struct options_def eval_defs[] = {
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(type, tier, key, def, lo, hi, unit, help)                                              \
    OPTIONS_ROW(struct eval_options, type, tier, key, def, lo, hi, unit, help)
#include "cli/eval.def"
#undef OPT
};

struct eval {
    struct eval_options o;
    struct scene scene;
    uint32_t *images;
    size_t n_images;
    struct partition plan; /* n_cells 0: the scene is one cell */
    struct dev dev;
    bool dev_is_open;
    struct render *render;
    struct eval_half_image half_image; /* of what is being scored */
    bool exposed;                      /* the scene tells exposures */
    bool exposure;                     /* and what is being scored was trained at the mean one */
    double trained_steps;              /* of the level that was scored last; 0: none was */
    double gaussians, faint;           /* of it; share of those of low opacity; NAN: not known */
    struct lpips *lpips;               /* NULL: no weights */
    struct footprint ground;           /* what training photographs show */
    struct residual_list residuals;    /* of the last row that was scored */
    char residuals_of[64];             /* what that row is called */
    json_t *rows;
};

enum { EVAL_SUSPICIOUS_MAX = 20 }; /* rows printed; the file has all */

static void eval_print_head(void)
{
    printf("%-14s %6s %9s %9s %9s %8s %10s %8s %12s %12s %9s %9s\n", "what", "photos", "edge px",
           "PSNR dB", "seen dB", "SSIM", "SSIM valid", "GMSD", "Gaussians", "in view", "ms/frame",
           "MB");
}

static enum err_code eval_row(struct eval *v, const char *what, uint32_t edge_px,
                              const struct evaluate_score *s, struct err *e)
{
    char visible[32] = "", seen[32] = "";
    if (s->n_seen)
        snprintf(seen, sizeof seen, "%.3f", s->seen_psnr_db);
    if (s->visible > 0.0)
        snprintf(visible, sizeof visible, "%.0f", s->visible);
    printf("%-14s %6zu %9u %9.3f %9s %8.4f %10.4f %8.5f %12.0f %12s %9.2f %9.2f\n", what,
           s->n_photos, edge_px, s->psnr_db, seen, s->ssim, s->ssim_valid, s->gmsd, s->gaussians,
           visible, s->ms_frame, s->bytes / 1e6);
    bool lpips = v->lpips && s->lpips > 0.0; /* rows of half images have none */
    if (lpips)
        printf("%-14s %s %.4f\n", "", lpips_key(v->lpips), s->lpips);
    fflush(stdout);
    json_t *row = json_pack("{s:s, s:I, s:i, s:o, s:o, s:o, s:f, s:f, s:f, s:f, s:f}", "what", what,
                            "photographs", (json_int_t)s->n_photos, "edge_px", (int)edge_px,
                            "psnr_db", jsonc_real(s->psnr_db), "ssim", jsonc_real(s->ssim),
                            "ssim_valid", jsonc_real(s->ssim_valid), "l1", s->l1, "gmsd", s->gmsd,
                            "gaussians", s->gaussians, "ms_frame", s->ms_frame, "bytes", s->bytes);
    if (row && lpips && json_object_set_new(row, lpips_key(v->lpips), json_real(s->lpips))) {
        json_decref(row);
        row = NULL;
    }
    if (row && s->n_seen && json_object_set_new(row, "seen_psnr_db", jsonc_real(s->seen_psnr_db))) {
        json_decref(row);
        row = NULL;
    }
    if (row && s->visible > 0.0 && json_object_set_new(row, "visible", json_real(s->visible))) {
        json_decref(row);
        row = NULL;
    }
    if (!row || json_array_append_new(v->rows, row))
        return err_set(e, ERR_MEM, "eval: out of memory");
    return ERR_OK;
}

enum { EVAL_HALF_IMAGE_AUTO, EVAL_HALF_IMAGE_ON, EVAL_HALF_IMAGE_OFF };

static enum err_code eval_half(struct eval *v, const char *what, uint32_t edge_px,
                               struct photo_loader *photos, const struct half_image_source *src,
                               double bytes, struct err *e)
{
    struct evaluate_score score;
    char name[64];
    if (v->o.half_image == EVAL_HALF_IMAGE_OFF ||
        (v->o.half_image == EVAL_HALF_IMAGE_AUTO && !eval_half_image_appearance(&v->half_image) &&
         !v->exposure))
        return ERR_OK;
    uint32_t steps = (uint32_t)v->o.half_image_steps;
    if (!steps)
        steps = half_image_steps(v->trained_steps, v->n_images);
    if (eval_half_image_appearance(&v->half_image) && !v->o.half_image_steps)
        log_info("eval",
                 "%s: embeddings of %zu photographs learn for %u steps a half%s; "
                 "--half-image-steps N changes it",
                 what, v->n_images, steps,
                 steps < HALF_IMAGE_STEPS ? ", as long as the level was trained" : "");
    snprintf(name, sizeof name, "%s, half image", what);
    enum err_code rc =
        eval_half_image_run(&v->half_image, &v->dev, v->render, steps, v->o.half_image_random,
                            v->exposure, photos, v->n_images, src, &score, e);
    score.bytes = bytes;
    return rc ? rc : eval_row(v, name, edge_px, &score, e);
}

/* Where the pictures of a row go: *out is NULL when none are wanted. */
static enum err_code eval_pictures(const struct eval *v, const char *what, char *path,
                                   const char **out, struct err *e)
{
    char folder[64];
    *out = NULL;
    if (!v->o.pictures)
        return ERR_OK;
    snprintf(folder, sizeof folder, "%s", what);
    for (char *c = folder; *c; c++)
        *c = *c == ' ' || *c == ',' ? '_' : *c;
    *out = path;
    return file_join(path, v->o.pictures, folder, e);
}

/* A row of map views instead of photographs. */
static enum err_code eval_views(struct eval *v, const char *what, const struct evaluate_source *src,
                                struct err *e)
{
    char path[FILE_PATH_MAX];
    struct eval_views_request q = {.dir = v->o.views,
                                   .scene = &v->scene,
                                   .appearance = eval_half_image_appearance(&v->half_image),
                                   .exposure = v->exposure,
                                   .rows = v->rows};
    enum err_code rc = eval_pictures(v, what, path, &q.pictures, e);
    return rc ? rc : eval_views_run(&q, what, v->render, src, e);
}

static enum err_code eval_source(struct eval *v, const char *what, uint32_t max_edge_px,
                                 double downsample, struct evaluate_source src,
                                 const struct half_image_source *half, struct err *e)
{
    char pictures[FILE_PATH_MAX];
    struct photo_loader *photos = NULL;
    struct evaluate_score score;
    struct photo_loader_config f = {.scene = &v->scene,
                                    .images = v->images,
                                    .n_images = v->n_images,
                                    .max_edge_px = max_edge_px,
                                    .downsample = downsample,
                                    .cache_bytes = (size_t)64 << 20,
                                    .exposure =
                                        v->exposure ? PHOTO_LOADER_TOLD : PHOTO_LOADER_AS_TAKEN};
    if (v->o.surface) {
        const struct eval_surface_request q = {.city = v->o.surface,
                                               .views = v->o.views,
                                               .scene = &v->scene,
                                               .gaussians = v->gaussians,
                                               .faint = v->faint,
                                               .rows = v->rows};
        return strcmp(v->o.surface, EVAL_SURFACE_POINTS) != 0
                   ? eval_surface_run(&q, what, v->render, &src, e)
                   : eval_points_run(&q, what, v->render, &src, e);
    }
    if (v->o.views)
        return eval_views(v, what, &src, e);
    src.ground = v->ground.nx ? &v->ground : NULL;
    src.lpips = v->lpips;
    src.residuals = &v->residuals;
    residual_clear(&v->residuals);
    snprintf(v->residuals_of, sizeof v->residuals_of, "%s", what);
    enum err_code rc = eval_pictures(v, what, pictures, &src.pictures, e);
    if (!rc)
        rc = photo_loader_open(&f, &photos, e);
    if (!rc)
        rc = evaluate_run(photos, v->n_images, &src, &score, e);
    struct camera cam =
        photo_loader_camera(&v->scene.images[v->images[0]].cam, max_edge_px, downsample);
    uint32_t edge = cam.width_px > cam.height_px ? cam.width_px : cam.height_px;
    if (!rc)
        rc = eval_row(v, what, edge, &score, e);
    if (!rc)
        rc = eval_half(v, what, edge, photos, half, src.bytes, e);
    photo_loader_close(&photos);
    return rc;
}

/* ---- trained levels ---- */

/* What a level was trained with and must be drawn with. */
struct eval_settings {
    double max_edge_px, downsample, background, near_m;
    double steps; /* of training, over all cells */
    enum render_aa aa;
    bool exposure; /* photographs were brought to the mean one */
    bool all;      /* the finest level trained on with the test photographs too */
};

static enum err_code eval_read_settings(const struct ckpt *c, const char *path,
                                        struct eval_settings *out, struct err *e)
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
static enum err_code eval_append(const struct eval *v, size_t index, const struct gauss *g,
                                 struct gauss *out, struct err *e)
{
    size_t n = 0;
    if (!out->block) {
        enum err_code rc = gauss_alloc(out, g->n, g->sh_degree, g->embed_len, e);
        if (rc)
            return rc;
        memcpy(out->origin_enu_m, g->origin_enu_m, sizeof g->origin_enu_m);
    }
    if (v->plan.n_cells < 2)
        return gauss_append(out, g, NULL, g->n, e);
    uint32_t *rows = mem_array(g->n, sizeof *rows);
    if (!rows)
        return err_set(e, ERR_MEM, "eval: out of memory for %zu Gaussians", g->n);
    for (size_t i = 0; i < g->n; i++)
        if (partition_owner(&v->plan, g->origin_enu_m[0] + (double)g->mean_m[3 * i],
                            g->origin_enu_m[1] + (double)g->mean_m[3 * i + 1]) == index)
            rows[n++] = (uint32_t)i;
    enum err_code rc = gauss_append(out, g, rows, n, e);
    mem_free(rows);
    return rc;
}

static double eval_bytes(const char *path)
{
    struct stat st;
    return stat(path, &st) ? 0.0 : (double)st.st_size;
}

/* A level of all cells put together. *found: how many cells have it. */
static enum err_code eval_load_level(struct eval *v, const char *dir, unsigned level,
                                     struct gauss *g, struct eval_settings *s, size_t *found,
                                     double *bytes, struct err *e)
{
    char path[FILE_PATH_MAX + 64];
    size_t n = v->plan.n_cells ? v->plan.n_cells : 1;
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < n; i++) {
        struct ckpt c = {0};
        if (v->plan.n_cells && v->plan.cells[i].parent >= 0)
            continue;
        snprintf(path, sizeof path, "%s/cells/%s/level%u.ckpt", dir,
                 v->plan.n_cells ? v->plan.cells[i].id : "all", level);
        if (!file_exists(path))
            continue;
        rc = ckpt_read(path, &c, e);
        if (!rc)
            rc = eval_read_settings(&c, path, s, e);
        if (!rc)
            rc = eval_half_image_take(&v->half_image, *found == 0, &c, path, &v->scene, e);
        if (!rc)
            rc = eval_append(v, i, &c.g, g, e);
        (*found)++;
        if (!rc)
            *bytes += eval_bytes(path);
        ckpt_free(&c);
    }
    return rc;
}

static enum err_code eval_prepare_model(void *user, const struct camera *cam,
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

/* A faint Gaussian has a logit below that of EVAL_SURFACE_FAINT, which is 0. */
static void eval_count(struct eval *v, const struct gauss *g)
{
    size_t faint = 0;
    for (size_t i = 0; i < g->n; i++)
        faint += g->opacity_logit[i] < 0.0f;
    v->gaussians = (double)g->n;
    v->faint = (double)faint / (double)g->n;
}

static enum err_code eval_level(struct eval *v, const char *dir, unsigned level, size_t *found,
                                struct err *e)
{
    struct gauss g = {0};
    struct render_model model = {0};
    struct eval_settings s = {0};
    char what[32];
    size_t n = 0;
    double bytes = 0.0;
    snprintf(what, sizeof what, "level %u", level);
    enum err_code rc = eval_load_level(v, dir, level, &g, &s, &n, &bytes, e);
    if (!rc && n)
        rc = render_model_upload(v->render, &g, &model, e);
    if (!rc && n) {
        float grey = (float)s.background;
        struct evaluate_model m = {
            v->render,
            &model,
            {.aa = s.aa, .background = {grey, grey, grey}, .near_m = s.near_m, .sh_degree = -1},
            eval_half_image_appearance(&v->half_image)};
        struct evaluate_model fine = m;
        fine.options.supersample = (uint32_t)v->o.supersample;
        struct evaluate_model above = m;
        above.options.orthographic = true;
        const struct half_image_source half = {eval_prepare_model, &m};
        struct evaluate_source src = {.draw = evaluate_draw_model,
                                      .user = &fine,
                                      .own_size = v->o.supersample > 1 ? &m : NULL,
                                      .above = &above,
                                      .bytes = bytes,
                                      .render = v->render};
        uint32_t edge = v->o.max_edge_px ? (uint32_t)v->o.max_edge_px : (uint32_t)s.max_edge_px;
        if (s.all && !v->o.views)
            log_warn("eval",
                     "%s trained on with the photographs that score it (--final-all): the "
                     "scores that `train` printed are of before",
                     what);
        v->trained_steps = s.steps;
        eval_count(v, &g);
        v->exposure = v->exposed && s.exposure;
        rc = eval_source(v, what, edge, v->o.full_size ? 1.0 : s.downsample, src, &half, e);
    }
    eval_half_image_clear(&v->half_image);
    render_model_free(&model);
    gauss_free(&g);
    *found += n;
    return rc;
}

static enum err_code eval_levels(struct eval *v, const char *scene_dir, struct err *e)
{
    const char *dir = v->o.results ? v->o.results : scene_dir;
    char path[FILE_PATH_MAX];
    size_t found = 0;
    enum err_code rc = file_join(path, scene_dir, "plan.json", e);
    if (!rc && file_exists(path))
        rc = cell_plan_read(path, &v->scene, &v->plan, e);
    bool finest = v->o.views || v->o.surface; /* the others are for distances of their own */
    if (finest)
        for (unsigned level = TRAIN_LEVELS_MAX; !rc && level && !found; level--)
            rc = eval_level(v, dir, level, &found, e);
    for (unsigned level = 1; !rc && !finest && level <= TRAIN_LEVELS_MAX; level++)
        rc = eval_level(v, dir, level, &found, e);
    if (!rc && !found)
        rc = err_set(e, ERR_NOENT, "%s: no level1.ckpt in cells/; `citysplat train` makes it", dir);
    return rc;
}

/* ---- a tile store ---- */

struct eval_view {
    struct view *view;
    struct render_options ro;
    struct pick_options po;
    uint32_t supersample;
    struct appearance_view *appearance; /* NULL: without appearance */
};

static enum err_code eval_prepare_view(void *user, const struct camera *cam,
                                       const struct render_model **model, struct render_options *ro,
                                       struct err *e)
{
    struct eval_view *w = user;
    struct view_stats stats;
    *ro = w->ro;
    return view_model(w->view, cam, &w->po, model, &stats, e);
}

static enum err_code eval_draw_view(void *user, const struct camera *cam, float *rgb,
                                    double *gaussians, struct err *e)
{
    struct eval_view *w = user;
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

static enum err_code eval_tiles(struct eval *v, struct err *e)
{
    float grey = (float)v->o.background;
    struct eval_view w = {
        .ro = {.aa = (enum render_aa)v->o.aa, .background = {grey, grey, grey}, .sh_degree = -1},
        .po = {.metric = (enum pick_metric)v->o.metric, .error_px = v->o.error_px},
        .supersample = (uint32_t)v->o.supersample,
    };
    struct eval_view own, above;
    const struct options_nums *d = &v->o.distance_m;
    w.po.distance_m[0] = d->n == 1 ? d->one : d->v[0];
    w.po.distance_m[1] = d->n == 1 ? 2.0 * d->one : d->v[1];
    v->exposure = v->exposed && v->o.exposure;
    struct evaluate_source src = {.draw = eval_draw_view,
                                  .user = &w,
                                  .own_size = w.supersample > 1 ? &own : NULL,
                                  .above = &above,
                                  .bytes = eval_bytes(v->o.tiles),
                                  .render = v->render};
    const struct half_image_source half = {eval_prepare_view, &w};
    enum err_code rc = view_open(v->o.tiles, v->render, (size_t)v->o.cache_mib << 20, &w.view, e);
    if (!rc)
        rc = eval_half_image_take_store(&v->half_image, view_appearance(w.view), &v->scene, e);
    w.appearance = rc ? NULL : eval_half_image_appearance(&v->half_image);
    if (v->o.flight) {
        const struct eval_flight_request q = {.scene = &v->scene,
                                              .frames = (size_t)v->o.flight,
                                              .fade = (size_t)v->o.fade,
                                              .max_edge_px = (uint32_t)v->o.max_edge_px,
                                              .rows = v->rows};
        if (!rc)
            rc = eval_flight_run(&q, w.view, &w.ro, &w.po, e);
        goto out;
    }
    own = w;
    own.supersample = 1;
    v->gaussians = v->faint = (double)NAN;
    above = own;
    above.ro.orthographic = above.po.no_lod = true;
    if (!rc && !v->o.surface)
        rc = eval_source(v, "tiles, LOD", (uint32_t)v->o.max_edge_px, 1.0, src, &half, e);
    w.po.no_lod = own.po.no_lod = true;
    if (!rc)
        rc = eval_source(v, "tiles, no LOD", (uint32_t)v->o.max_edge_px, 1.0, src, &half, e);
out:
    eval_half_image_clear(&v->half_image);
    view_close(&w.view);
    return rc;
}

/* ---- the command ---- */

static enum err_code eval_open(struct eval *v, const char *scene_dir, struct err *e)
{
    enum err_code rc = scene_read(scene_dir, &v->scene, e);
    if (!rc)
        rc = train_scene_images(&v->scene, v->o.split ? SCENE_TRAIN : SCENE_TEST, true, &v->images,
                                &v->n_images, e);
    for (size_t i = 0; !rc && i < v->scene.n_images; i++)
        v->exposed |= !exposure_is_mean(v->scene.images[i].exposure_ev);
    if (!rc && !v->n_images)
        rc = err_set(e, ERR_DATA, "%s: the scene keeps no %s photographs", scene_dir,
                     v->o.split ? "training" : "test");
    if (!rc)
        rc = dev_open(v->o.device, &v->dev, e);
    v->dev_is_open = !rc;
    if (!rc)
        rc = render_open(&v->dev, &v->render, e);
    if (!rc && v->o.lpips)
        rc = lpips_open(&v->dev, v->o.lpips, (enum lpips_range)v->o.lpips_range, &v->lpips, e);
    v->rows = json_array();
    return rc;
}

static enum err_code eval_write(const struct eval *v, const char *scene_dir, struct err *e)
{
    json_t *o = json_pack("{s:s, s:s, s:s, s:O}", "scene", scene_dir, "device", v->dev.name,
                          "version", CITYSPLAT_VERSION, "scores", v->rows);
    if (!o)
        return err_set(e, ERR_MEM, "eval: out of memory");
    enum err_code rc = jsonc_write(v->o.output, o, e);
    json_decref(o);
    return rc;
}

/* The photographs that fit worst, on paper and on the screen. */
static enum err_code eval_residuals(struct eval *v, const char *scene_dir, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct residual_list *l = &v->residuals;
    if (!v->o.residuals && !v->o.split)
        return ERR_OK;
    enum err_code rc = residual_rank(l, e);
    const char *to = v->o.residuals ? v->o.residuals : path;
    if (!rc && !v->o.residuals)
        rc = file_join(path, v->o.results ? v->o.results : scene_dir, "residuals.json", e);
    if (!rc)
        rc = residual_write(l, to, v->residuals_of, e);
    if (rc || !l->n)
        return rc;
    if (!l->n_suspicious) {
        printf("No photograph stands out: the worst of %zu, %s, has a robust z-score of %.1f "
               "(limit %.0f).\n",
               l->n, l->rows[0].name, l->rows[0].z, RESIDUAL_LIMIT);
        return ERR_OK;
    }
    printf("%zu of %zu photographs fit much worse than the others (wrong pose? another light?); "
           "all of them are in %s\n%-32s %9s %8s %8s %8s\n",
           l->n_suspicious, l->n, to, "photograph", "PSNR dB", "SSIM", "z MSE", "z SSIM");
    for (size_t i = 0; i < l->n_suspicious && i < EVAL_SUSPICIOUS_MAX; i++)
        printf("%-32s %9.3f %8.4f %8.1f %8.1f\n", l->rows[i].name, -10.0 * log10(l->rows[i].mse),
               l->rows[i].ssim, l->rows[i].z_mse, l->rows[i].z_ssim);
    return ERR_OK;
}

enum err_code cli_eval(int argc, char **argv, struct err *e)
{
    const struct options_spec spec = {
        .command = "eval",
        .usage = "citysplat eval SCENE [options]",
        .about = "Draws the scene's test photographs from the trained Gaussians, or from a tile "
                 "store with and without level of detail. Prints PSNR, SSIM (zero padded as in "
                 "training, and inner windows only), GMSD (perceptual, lower is better), Gaussians "
                 "and time a frame. If appearance was trained, a photograph is drawn in the "
                 "appearance of the nearest training photographs. Rows \"half image\" learn the "
                 "photograph's appearance from one half of it and score the other half. With "
                 "--views, map views with ground truth are scored instead.",
        .example =
            "citysplat eval scene\ncitysplat eval scene --tiles city.tiles --max-edge-px 800",
        .defs = eval_defs,
        .n_defs = sizeof eval_defs / sizeof eval_defs[0],
        .min_args = 1,
        .max_args = 1};
    struct eval v = {0};
    struct options_args args;
    struct arena arena = {0};
    enum err_code rc = options_parse(&spec, argc, argv, &v.o, &args, &arena, e);
    if (rc || args.done)
        goto out;
    signals_catch();
    rc = output_check(v.o.output, v.o.overwrite, e);
    if (!rc)
        rc = eval_open(&v, args.arg[0], e);
    if (!rc && !v.o.views && !v.o.surface && !v.o.flight)
        rc = footprint_of(&v.scene, &v.ground, e);
    if (rc)
        goto out;
    if (v.o.flight && !v.o.tiles) {
        rc = err_set(e, ERR_ARG, "--flight: levels change in tile stores: give one with --tiles");
        goto out;
    }
    if (v.o.fade && !v.o.flight) {
        rc = err_set(e, ERR_ARG, "--fade: levels change in flight: give --flight");
        goto out;
    }
    if (v.o.views && !v.o.surface)
        eval_views_print_head();
    else if (!v.o.flight && !v.o.surface)
        eval_print_head();
    rc = v.o.tiles ? eval_tiles(&v, e) : eval_levels(&v, args.arg[0], e);
    if (!rc && !v.lpips && !v.o.views && !v.o.surface && !v.o.flight)
        printf("LPIPS is not scored: --lpips FILE supplies its weights (lab/EVALUATION.md).\n");
    if (!rc && !v.o.views && !v.o.surface && !v.o.flight)
        rc = eval_residuals(&v, args.arg[0], e);
    if (!rc && v.o.output)
        rc = eval_write(&v, args.arg[0], e);
out:
    json_decref(v.rows);
    footprint_free(&v.ground);
    residual_free(&v.residuals);
    eval_half_image_clear(&v.half_image);
    lpips_close(&v.lpips);
    render_close(&v.render);
    if (v.dev_is_open)
        dev_close(&v.dev);
    partition_free(&v.plan);
    scene_free(&v.scene);
    arena_free(&arena);
    return rc;
}
