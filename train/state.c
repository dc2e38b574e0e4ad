/* What a run writes down: the state to go on from, and the result of each level.
 *
 * The state is the Gaussians, both Adam moments and the densification statistics in the device's
 * layout, and three numbers: level, step, Gaussians at the level's start. Everything else (order of
 * photographs, schedules, random numbers) is a function of these, the configuration and the cell,
 * which are stored and compared: a run can only go on with the options and the plan it began with.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <jansson.h>

#include "cells/cell.h"
#include "codec/ckpt.h"
#include "loss/mip.h"
#include "render/permute.h"
#include "train/appearance_train.h"
#include "train/budget.h"
#include "train/config.h"
#include "train/evaluate.h"
#include "train/level.h"
#include "train/regularizer.h"
#include "train/schedule.h"
#include "train/state.h"

#define STATE_SAME_M 1e-6 /* lengths of a plan go through text */
enum { STATE_STATS = 5, STATE_LIGHTS = 2, STATE_SLICE = 65536 };
static const char *const state_stat_names[STATE_STATS] = {"stat_grad", "stat_absg", "stat_count",
                                                          "stat_radius", "stat_opacity"};

/* Options that do not change the trajectory. */
static const char *const state_free_options[] = {
    "output",     "cell",      "device",          "jobs",
    "threads",    "list",      "resume",          "checkpoint_interval",
    "stop_after", "cache_mib", "appearance_only", NULL,
};

static bool state_is_free(const char *key)
{
    for (const char *const *k = state_free_options; *k; k++)
        if (!strcmp(key, *k))
            return true;
    return false;
}

static void state_stat_buffers(const struct level *l, cl_mem out[STATE_STATS])
{
    out[0] = l->stats.grad;
    out[1] = l->stats.absg;
    out[2] = l->stats.count;
    out[3] = l->stats.radius;
    out[4] = l->stats.opacity; /* NULL without appearance */
}

/* Head of every checkpoint; NULL when out of memory. */
static json_t *state_meta(const struct level *l, const char *kind, struct err *e)
{
    json_t *config = NULL;
    if (options_to_json(train_options(), l->cfg, &config, e))
        return NULL;
    /* What cannot change the result must not change its bytes either. */
    for (const char *const *k = state_free_options; *k; k++)
        json_object_del(config, *k);
    const struct schedule *s = &l->schedule[l->at < l->n_levels ? l->at : l->n_levels - 1];
    json_t *o = json_pack(
        "{s:s, s:s, s:s, s:i, s:i, s:i, s:i, s:I, s:I, s:I, s:f, s:f, s:f, s:[f,f,f,f], s:o}",
        "kind", kind, "version", CITYSPLAT_VERSION, "cell", l->cell.id, "level", (int)s->level,
        "levels", (int)l->n_levels, "step", (int)l->step, "steps", (int)s->steps, "start",
        (json_int_t)l->start, "gaussians", (json_int_t)l->model.n, "photographs",
        (json_int_t)l->n_images, "downsample", s->downsample, "edge_m", l->cell.edge_m, "extent_m",
        l->cell.extent_m, "box_m", l->cell.min_enu_m[0], l->cell.min_enu_m[1], l->cell.max_enu_m[0],
        l->cell.max_enu_m[1], "config", config);
    if (o && json_object_set_new(o, "pruned", json_boolean(l->pruned))) {
        json_decref(o);
        o = NULL;
    }
    const struct budget_point *b = &l->budget.at;
    if (o && l->budget.n_held &&
        json_object_set_new(o, "budget",
                            json_pack("{s:I, s:f, s:f, s:b}", "budget", (json_int_t)s->budget,
                                      "gaussians", b->n, "psnr_db", b->psnr_db, "stopped",
                                      (int)b->stopped))) {
        json_decref(o);
        o = NULL;
    }
    if (!o)
        err_set(e, ERR_MEM, "out of memory for a checkpoint's head");
    return o;
}

/* ---- writing ---- */

/* Buffers of the device that the host looks at while a file is written: on CPU devices nothing is
 * copied, however large the level. */
struct state_view {
    struct level *l;
    struct gauss like;
    cl_mem mem[4 + STATE_STATS];
    void *at[4 + STATE_STATS]; /* [0]: the parameters */
    size_t n;
    float *filter; /* [n] to fold in, or NULL */
};

static enum err_code state_look(struct state_view *v, cl_mem mem, size_t bytes, struct err *e)
{
    enum err_code rc = dev_map(v->l->dev, mem, CL_MAP_READ, bytes, &v->at[v->n], e);
    if (!rc)
        v->mem[v->n++] = mem;
    return rc;
}

static enum err_code state_view_open(struct level *l, struct state_view *v, struct err *e)
{
    const struct render_model *m = &l->model;
    *v = (struct state_view){.l = l,
                             .like = {.n = m->n,
                                      .sh_degree = m->sh_degree,
                                      .embed_len = m->embed_len,
                                      .antialiased = l->cfg->aa != RENDER_AA_NONE}};
    memcpy(v->like.origin_enu_m, m->origin_enu_m, sizeof(v->like.origin_enu_m));
    return state_look(v, m->params, permute_floats(m->n, m->planes) * sizeof(float), e);
}

/* Give the buffers back; rc is what came before. */
static enum err_code state_view_close(struct state_view *v, enum err_code rc, struct err *e)
{
    struct err why = {0};
    for (size_t i = 0; i < v->n; i++) {
        enum err_code done = dev_unmap(v->l->dev, v->mem[i], &v->at[i], &why);
        if (!rc && done)
            rc = err_set(e, done, "%s", why.msg);
    }
    mem_free(v->filter);
    return rc;
}

/* Results carry the 3-D filter in their sizes and opacities: whoever draws them needs to know
 * nothing of it. */
static void state_fold(const struct state_view *v, enum ckpt_field field, size_t row, float *out)
{
    const float *p = (const float *)v->at[0] + permute_at(row, v->l->model.planes);
    float scale[3], opacity = p[RENDER_PLANE_OPACITY * LAYOUT_LANES];
    struct gauss one = {.n = 1, .scale_log = scale, .opacity_logit = &opacity};
    for (size_t k = 0; k < 3; k++)
        scale[k] = p[(RENDER_PLANE_SCALE + k) * LAYOUT_LANES];
    mip_fold(&one, v->filter + row);
    memcpy(out, field == CKPT_SCALE ? scale : &opacity,
           (field == CKPT_SCALE ? 3 : 1) * sizeof(*out));
}

/* Rows of one array of the Gaussians, for ckpt_write_from. */
static enum err_code state_rows(void *user, enum ckpt_field field, size_t first, size_t n,
                                float *out, struct err *e)
{
    (void)e;
    const struct state_view *v = user;
    const struct render_model *m = &v->l->model;
    const uint32_t plane[] = {
        RENDER_PLANE_MEAN, RENDER_PLANE_SCALE,          RENDER_PLANE_QUAT, RENDER_PLANE_OPACITY,
        RENDER_PLANE_SH,   render_planes(m->sh_degree), m->planes};
    size_t count = plane[field + 1] - plane[field];
    bool fold = v->filter && (field == CKPT_SCALE || field == CKPT_OPACITY);
    for (size_t i = 0; i < n; i++) {
        const float *p = (const float *)v->at[0] + permute_at(first + i, m->planes) +
                         (size_t)plane[field] * LAYOUT_LANES;
        if (fold)
            state_fold(v, field, first + i, out + i * count);
        for (size_t k = 0; !fold && k < count; k++)
            out[i * count + k] = p[k * LAYOUT_LANES];
    }
    return ERR_OK;
}

static enum err_code state_view_filter(struct state_view *v, struct err *e)
{
    struct level *l = v->l;
    if (l->cfg->aa != RENDER_AA_MIP)
        return ERR_OK;
    enum err_code rc = regularizer_filter(l, e);
    v->filter = mem_array(l->model.n, sizeof(*v->filter));
    if (!rc && !v->filter)
        rc = err_set(e, ERR_MEM, "checkpoint: out of memory for %u Gaussians", l->model.n);
    return rc ? rc
              : dev_read(l->dev, l->model.filter, 0, l->model.n * sizeof(*v->filter), v->filter, e);
}

enum err_code state_save_level(struct level *l, const char *path,
                               const struct evaluate_score *score, struct err *e)
{
    struct state_view v = {0};
    json_t *meta = state_meta(l, "level", e);
    if (!meta)
        return ERR_MEM;
    enum err_code rc = ERR_OK;
    if (score) {
        json_t *test =
            json_pack("{s:I, s:o, s:o}", "photographs", (json_int_t)score->n_photos, "psnr_db",
                      jsonc_real(score->psnr_db), "ssim", jsonc_real(score->ssim));
        if (!test || json_object_set_new(meta, "test", test))
            rc = err_set(e, ERR_MEM, "%s: out of memory", path);
    }
    struct buf look = {0};
    struct ckpt_blob blob = {.name = APPEARANCE_TRAIN_BLOB};
    bool with = appearance_train_is_on(&l->light);
    if (!rc && with)
        rc = appearance_write(&l->light.model, &look, e);
    blob.data = look.data;
    blob.size_bytes = look.size;
    if (!rc) {
        rc = state_view_open(l, &v, e);
        if (!rc)
            rc = state_view_filter(&v, e);
        const struct ckpt_source from = {&v.like, state_rows, &v};
        if (!rc)
            rc = ckpt_write_from(path, meta, &from, &blob, with, e);
        rc = state_view_close(&v, rc, e);
    }
    buf_free(&look);
    json_decref(meta);
    return rc;
}

/* A buffer of the device as a blob. */
static enum err_code state_blob(struct state_view *v, const char *name, cl_mem from, size_t bytes,
                                struct ckpt_blob *b, struct err *e)
{
    enum err_code rc = state_look(v, from, bytes, e);
    memcpy(b->name, name, strlen(name) + 1);
    b->data = rc ? NULL : v->at[v->n - 1];
    b->size_bytes = bytes;
    return rc;
}

/* The appearance model, and the moments of its optimiser. */
static enum err_code state_light_blobs(const struct level *l, struct ckpt_blob out[STATE_LIGHTS],
                                       struct err *e)
{
    struct buf b[STATE_LIGHTS] = {{0}};
    enum err_code rc = appearance_write(&l->light.model, &b[0], e);
    if (!rc)
        rc = appearance_train_write_state(&l->light, &b[1], e);
    memcpy(out[0].name, APPEARANCE_TRAIN_BLOB, sizeof(APPEARANCE_TRAIN_BLOB));
    memcpy(out[1].name, APPEARANCE_TRAIN_BLOB_STATE, sizeof(APPEARANCE_TRAIN_BLOB_STATE));
    for (size_t i = 0; i < STATE_LIGHTS; i++) { /* the caller frees them */
        out[i].data = b[i].data;
        out[i].size_bytes = b[i].size;
    }
    return rc;
}

enum err_code state_save(struct level *l, const char *path, struct err *e)
{
    struct state_view v = {0};
    struct ckpt_blob blobs[3 + STATE_STATS + STATE_LIGHTS] = {0};
    const struct render_model *m = &l->model;
    size_t n = 0, moments = permute_floats(m->n, m->planes) * sizeof(float), lights = 0;
    json_t *meta = state_meta(l, "resume", e);
    if (!meta)
        return ERR_MEM;
    cl_mem stats[STATE_STATS];
    state_stat_buffers(l, stats);
    enum err_code rc = state_view_open(l, &v, e);
    if (!rc)
        rc = state_blob(&v, "adam_m1", l->adam.m1, moments, &blobs[n++], e);
    if (!rc)
        rc = state_blob(&v, "adam_m2", l->adam.m2, moments, &blobs[n++], e);
    for (size_t i = 0; !rc && i < STATE_STATS && stats[i]; i++)
        rc = state_blob(&v, state_stat_names[i], stats[i], m->n * sizeof(float), &blobs[n++], e);
    if (!rc && m->filter && l->filter_is_current)
        rc = state_blob(&v, "filter", m->filter, m->n * sizeof(float), &blobs[n++], e);
    if (!rc && appearance_train_is_on(&l->light)) {
        rc = state_light_blobs(l, blobs + n, e);
        lights = STATE_LIGHTS;
    }
    const struct ckpt_source from = {&v.like, state_rows, &v};
    if (!rc)
        rc = ckpt_write_from(path, meta, &from, blobs, n + lights, e);
    for (size_t i = 0; i < lights; i++)
        mem_free((void *)(uintptr_t)blobs[n + i].data);
    json_decref(meta);
    return state_view_close(&v, rc, e);
}

/* ---- reading ---- */

static enum err_code state_check_config(const struct level *l, const char *path,
                                        const json_t *saved, struct err *e)
{
    json_t *now = NULL;
    const char *key;
    json_t *value;
    enum err_code rc = options_to_json(train_options(), l->cfg, &now, e);
    if (rc)
        return rc;
    json_object_foreach(now, key, value)
    {
        if (rc || state_is_free(key) || json_equal(value, json_object_get(saved, key)))
            continue;
        char *was = json_dumps(json_object_get(saved, key), JSON_ENCODE_ANY | JSON_COMPACT);
        char *is = json_dumps(value, JSON_ENCODE_ANY | JSON_COMPACT);
        rc = err_set(
            e, ERR_ARG,
            "%s: the run was begun with %s = %s, now it is %s: use the same options to go on, "
            "or leave out --resume to start anew",
            path, key, was ? was : "nothing", is ? is : "nothing");
        free(was); /* jansson's, made with malloc */
        free(is);
    }
    json_decref(now);
    return rc;
}

/* A plan that was made anew gives other cells the same names. */
static enum err_code state_check_cell(const struct level *l, const char *path, const json_t *meta,
                                      struct err *e)
{
    double lengths[2], box[4], photos;
    const struct cell *c = &l->cell;
    const double want[6] = {c->edge_m,       c->extent_m,     c->min_enu_m[0],
                            c->min_enu_m[1], c->max_enu_m[0], c->max_enu_m[1]};
    enum err_code rc = jsonc_num(meta, "edge_m", &lengths[0], e);
    if (!rc)
        rc = jsonc_num(meta, "extent_m", &lengths[1], e);
    if (!rc)
        rc = jsonc_nums(meta, "box_m", 4, box, e);
    if (!rc)
        rc = jsonc_num(meta, "photographs", &photos, e);
    if (rc)
        return err_add(e, "%s", path);
    if (photos != (double)l->n_images)
        return err_set(e, ERR_DATA,
                       "%s: the run was begun with %.0f photographs, the scene has %zu now", path,
                       photos, l->n_images);
    for (size_t i = 0; i < 6; i++)
        if (!(fabs((i < 2 ? lengths[i] : box[i - 2]) - want[i]) <= STATE_SAME_M))
            return err_set(e, ERR_DATA,
                           "%s: cell %s was another one when the run was begun: go back to that "
                           "plan, or leave "
                           "out --resume to start anew",
                           path, c->id);
    return ERR_OK;
}

static enum err_code state_integer(const json_t *meta, const char *path, const char *key, double lo,
                                   double hi, double *out, struct err *e)
{
    enum err_code rc = jsonc_num(meta, key, out, e);
    if (rc)
        return err_add(e, "%s", path);
    if (!(*out >= lo && *out <= hi))
        return err_set(e, ERR_FORMAT, "%s: \"%s\" is %g, expected %g to %g", path, key, *out, lo,
                       hi);
    return ERR_OK;
}

/* A blob straight into a buffer of the device. */
static enum err_code state_fill(const struct level *l, const struct ckpt_rows *c, const char *name,
                                cl_mem to, size_t bytes, struct err *e)
{
    void *at = NULL;
    struct err why = {0};
    enum err_code rc = dev_map(l->dev, to, CL_MAP_WRITE, bytes, &at, e);
    if (!rc)
        rc = ckpt_rows_blob_to(c, name, at, bytes, e);
    enum err_code done = dev_unmap(l->dev, to, &at, &why);
    return !rc && done ? err_set(e, done, "%s", why.msg) : rc;
}

static enum err_code state_fill_light(struct level *l, const struct ckpt_rows *c, const char *path,
                                      struct err *e)
{
    struct buf model = {0}, adam = {0};
    if (!appearance_train_is_on(&l->light))
        return ERR_OK;
    enum err_code rc = ckpt_rows_blob(c, APPEARANCE_TRAIN_BLOB, &model, e);
    if (!rc)
        rc = ckpt_rows_blob(c, APPEARANCE_TRAIN_BLOB_STATE, &adam, e);
    if (!rc && (!model.data || !adam.data))
        rc = err_set(e, ERR_FORMAT, "%s: holds no appearance model", path);
    else if (!rc && appearance_train_read_state(&l->light, model.data, model.size, adam.data,
                                                adam.size, e))
        rc = err_add(e, "%s", path);
    buf_free(&model);
    buf_free(&adam);
    return rc;
}

/* The Gaussians, by the slice. */
static enum err_code state_fill_rows(struct level *l, const struct ckpt_rows *c, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < l->model.n; i += STATE_SLICE) {
        struct gauss g = {0};
        rc = ckpt_rows_read(c, i, l->model.n - i < STATE_SLICE ? l->model.n - i : STATE_SLICE, &g,
                            e);
        if (!rc)
            rc = render_model_write(l->render, &l->model, i, &g, e);
        gauss_free(&g);
    }
    return rc;
}

static enum err_code state_fill_all(struct level *l, const struct ckpt_rows *c, const char *path,
                                    struct err *e)
{
    size_t moments = permute_floats(l->model.n, l->model.planes) * sizeof(float);
    cl_mem stats[STATE_STATS];
    state_stat_buffers(l, stats);
    enum err_code rc = state_fill_rows(l, c, e);
    if (!rc)
        rc = state_fill_light(l, c, path, e);
    if (!rc)
        rc = state_fill(l, c, "adam_m1", l->adam.m1, moments, e);
    if (!rc)
        rc = state_fill(l, c, "adam_m2", l->adam.m2, moments, e);
    for (size_t i = 0; !rc && i < STATE_STATS && stats[i]; i++)
        rc = state_fill(l, c, state_stat_names[i], stats[i], l->model.n * sizeof(float), e);
    return rc;
}

/* The filter of Mip-Splatting is as old as its last computation: without it the next one would come
 * too early and the run would take another way. */
static enum err_code state_fill_filter(struct level *l, const struct ckpt_rows *c, struct err *e)
{
    if (l->cfg->aa != RENDER_AA_MIP || !ckpt_rows_has(c, "filter"))
        return ERR_OK;
    enum err_code rc = dev_buffer(l->dev, l->model.cap * sizeof(float), NULL, &l->model.filter, e);
    if (!rc)
        rc = state_fill(l, c, "filter", l->model.filter, l->model.n * sizeof(float), e);
    l->filter_is_current = !rc;
    return rc;
}

/* What --budget auto has decided at this level. */
static enum err_code state_budget(struct level *l, const json_t *meta, struct err *e)
{
    double budget;
    struct budget_point *b = &l->budget.at;
    const json_t *o = json_object_get(meta, "budget");
    if (!l->budget.n_held)
        return ERR_OK;
    enum err_code rc = jsonc_num(o, "budget", &budget, e);
    if (!rc)
        rc = jsonc_num(o, "gaussians", &b->n, e);
    if (!rc)
        rc = jsonc_num(o, "psnr_db", &b->psnr_db, e);
    if (!rc && !(budget >= 1.0 && budget <= 1e9))
        rc = err_set(e, ERR_FORMAT, "a budget of %g", budget);
    if (rc)
        return rc;
    b->stopped = json_is_true(json_object_get(o, "stopped"));
    l->schedule[l->at].budget = (size_t)budget;
    return ERR_OK;
}

/* Is this a state of l's run? Then take over where it stood. */
static enum err_code state_apply(struct level *l, const json_t *meta, const struct gauss *like,
                                 const char *path, struct err *e)
{
    const char *kind;
    double level, step, start;
    enum err_code rc = jsonc_text(meta, "kind", &kind, e);
    if (!rc && strcmp(kind, "resume"))
        rc = err_set(e, ERR_FORMAT, "is the result of a level, not a state to go on from");
    if (rc)
        return err_add(e, "%s", path);
    rc = state_check_config(l, path, json_object_get(meta, "config"), e);
    if (!rc)
        rc = state_check_cell(l, path, meta, e);
    if (!rc)
        rc = state_integer(meta, path, "level", 1, l->n_levels, &level, e);
    if (!rc)
        rc = state_integer(meta, path, "step", 0, l->schedule[(int)level - 1].steps, &step, e);
    if (!rc)
        rc = state_integer(meta, path, "start", 0, 4e9, &start, e);
    if (!rc && like->sh_degree != (uint32_t)l->cfg->sh_degree)
        rc = err_set(e, ERR_FORMAT, "%s: harmonics of degree %u", path, like->sh_degree);
    if (!rc && like->embed_len != l->light.model.len_gauss)
        rc = err_set(e, ERR_FORMAT, "%s: embeddings of length %u", path, like->embed_len);
    if (rc)
        return rc;
    l->at = (uint32_t)level - 1;
    l->step = (uint32_t)step;
    l->start = (size_t)start;
    l->pruned = json_is_true(json_object_get(meta, "pruned"));
    rc = state_budget(l, meta, e);
    return rc ? err_add(e, "%s", path) : ERR_OK;
}

enum err_code state_load(struct level *l, const char *path, struct err *e)
{
    struct ckpt_rows *c = NULL;
    json_t *meta = NULL;
    enum err_code rc = ckpt_rows_open(path, &c, e);
    if (!rc)
        rc = ckpt_rows_meta(c, &meta, e);
    if (!rc)
        rc = state_apply(l, meta, ckpt_rows_like(c), path, e);
    if (!rc)
        rc = level_reserve(l, ckpt_rows_like(c), e);
    if (!rc)
        rc = state_fill_all(l, c, path, e);
    if (!rc)
        rc = state_fill_filter(l, c, e);
    json_decref(meta);
    ckpt_rows_close(&c);
    return rc;
}

/* A cell that was trained with an older shared appearance model does not fit its neighbours. */
static bool state_has_light(const struct level *l, const struct ckpt_rows *c)
{
    struct appearance a = {0};
    struct buf b = {0};
    struct err why = {0};
    if (!appearance_train_is_on(&l->light) || !l->light.shared)
        return ckpt_rows_has(c, APPEARANCE_TRAIN_BLOB) == appearance_train_is_on(&l->light);
    bool same = !ckpt_rows_blob(c, APPEARANCE_TRAIN_BLOB, &b, &why) && b.data &&
                !appearance_read(b.data, b.size, &a, &why) &&
                appearance_train_same(&a, &l->light.model);
    appearance_free(&a);
    buf_free(&b);
    return same;
}

enum err_code state_is_result_of(const struct level *l, const char *path, bool *yes, struct err *e)
{
    struct ckpt_rows *c = NULL;
    json_t *meta = NULL;
    struct err why = {0};
    const char *kind = NULL;
    double level = 0.0;
    enum err_code rc = ckpt_rows_open(path, &c, e);
    if (!rc)
        rc = ckpt_rows_meta(c, &meta, e);
    *yes = !rc && !jsonc_text(meta, "kind", &kind, &why) && !strcmp(kind, "level") &&
           !jsonc_num(meta, "level", &level, &why) && level == (double)l->n_levels &&
           !state_check_config(l, path, json_object_get(meta, "config"), &why) &&
           !state_check_cell(l, path, meta, &why) && state_has_light(l, c);
    json_decref(meta);
    ckpt_rows_close(&c);
    return rc;
}
