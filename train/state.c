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

#include "train/level.h"

#define STATE_SAME_M 1e-6 /* lengths of a plan go through text */
enum { STATE_STATS = 5, STATE_LIGHTS = 2 };
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

/* ---- writing
 * --------------------------------------------------------------------------------------- */

/* Results carry the 3-D filter in their sizes and opacities: whoever draws them needs to know
 * nothing of it. */
static enum err_code state_fold(struct level *l, struct gauss *g, struct err *e)
{
    if (l->cfg->aa != RENDER_AA_MIP)
        return ERR_OK;
    enum err_code rc = regular_filter(l, e);
    float *filter = mem_array(g->n, sizeof(*filter));
    if (!rc && !filter)
        rc = err_set(e, ERR_MEM, "checkpoint: out of memory for %zu Gaussians", g->n);
    if (!rc)
        rc = dev_read(l->dev, l->model.filter, 0, g->n * sizeof(*filter), filter, e);
    if (!rc)
        mip_fold(g, filter);
    mem_free(filter);
    return rc;
}

enum err_code state_save_level(struct level *l, const char *path,
                               const struct evaluate_score *score, struct err *e)
{
    struct gauss g = {0};
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
    if (!rc)
        rc = level_gauss(l, &g, e);
    struct buf look = {0};
    struct ckpt_blob blob = {.name = LIGHT_BLOB};
    bool with = light_is_on(&l->light);
    if (!rc && with)
        rc = appearance_write(&l->light.model, &look, e);
    blob.data = look.data;
    blob.size_bytes = look.size;
    if (!rc)
        rc = state_fold(l, &g, e);
    if (!rc)
        rc = ckpt_write(path, meta, &g, &blob, with, e);
    buf_free(&look);
    gauss_free(&g);
    json_decref(meta);
    return rc;
}

static enum err_code state_blob(struct level *l, const char *name, cl_mem from, size_t bytes,
                                struct ckpt_blob *b, struct err *e)
{
    void *host = mem_array(bytes, 1);
    if (!host)
        return err_set(e, ERR_MEM, "checkpoint: out of memory for %zu bytes", bytes);
    memcpy(b->name, name, strlen(name) + 1);
    b->data = host;
    b->size_bytes = bytes;
    return dev_read(l->dev, from, 0, bytes, host, e);
}

/* The appearance model, and the moments of its optimiser. */
static enum err_code state_light_blobs(const struct level *l, struct ckpt_blob out[STATE_LIGHTS],
                                       struct err *e)
{
    struct buf b[STATE_LIGHTS] = {{0}};
    enum err_code rc = appearance_write(&l->light.model, &b[0], e);
    if (!rc)
        rc = light_write_state(&l->light, &b[1], e);
    memcpy(out[0].name, LIGHT_BLOB, sizeof(LIGHT_BLOB));
    memcpy(out[1].name, LIGHT_BLOB_STATE, sizeof(LIGHT_BLOB_STATE));
    for (size_t i = 0; i < STATE_LIGHTS; i++) { /* freed with the other blobs */
        out[i].data = b[i].data;
        out[i].size_bytes = b[i].size;
    }
    return rc;
}

static void state_free_blobs(struct ckpt_blob *b, size_t n)
{
    for (size_t i = 0; i < n; i++)
        mem_free((void *)(uintptr_t)b[i].data);
}

enum err_code state_save(struct level *l, const char *path, struct err *e)
{
    struct gauss g = {0};
    struct ckpt_blob blobs[3 + STATE_STATS + STATE_LIGHTS] = {0};
    size_t n = 0, moments = densify_floats(l->model.n, l->model.planes) * sizeof(float);
    json_t *meta = state_meta(l, "resume", e);
    if (!meta)
        return ERR_MEM;
    cl_mem stats[STATE_STATS];
    state_stat_buffers(l, stats);
    enum err_code rc = level_gauss(l, &g, e);
    if (!rc)
        rc = state_blob(l, "adam_m1", l->adam.m1, moments, &blobs[n++], e);
    if (!rc)
        rc = state_blob(l, "adam_m2", l->adam.m2, moments, &blobs[n++], e);
    for (size_t i = 0; !rc && i < STATE_STATS && stats[i]; i++)
        rc = state_blob(l, state_stat_names[i], stats[i], l->model.n * sizeof(float), &blobs[n++],
                        e);
    if (!rc && l->model.filter && l->filter_is_current)
        rc = state_blob(l, "filter", l->model.filter, l->model.n * sizeof(float), &blobs[n++], e);
    if (!rc && light_is_on(&l->light)) {
        rc = state_light_blobs(l, blobs + n, e);
        n += STATE_LIGHTS;
    }
    if (!rc)
        rc = ckpt_write(path, meta, &g, blobs, n, e);
    state_free_blobs(blobs, n);
    gauss_free(&g);
    json_decref(meta);
    return rc;
}

/* ---- reading
 * ------------------------------------------------------------------------------------------ */

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
    const struct train_cell *c = &l->cell;
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

static enum err_code state_integer(const struct ckpt *c, const char *path, const char *key,
                                   double lo, double hi, double *out, struct err *e)
{
    enum err_code rc = jsonc_num(c->meta, key, out, e);
    if (rc)
        return err_add(e, "%s", path);
    if (!(*out >= lo && *out <= hi))
        return err_set(e, ERR_FORMAT, "%s: \"%s\" is %g, expected %g to %g", path, key, *out, lo,
                       hi);
    return ERR_OK;
}

static const void *state_find(const struct ckpt *c, const char *path, const char *name,
                              size_t bytes, struct err *e)
{
    const struct ckpt_blob *b = ckpt_find(c, name);
    if (b && b->size_bytes == bytes)
        return b->data;
    err_set(e, ERR_FORMAT, "%s: '%s' does not hold %zu bytes", path, name, bytes);
    return NULL;
}

static enum err_code state_upload(struct level *l, const struct ckpt *c, const char *path,
                                  struct err *e)
{
    size_t moments = densify_floats(c->g.n, l->model.planes) * sizeof(float);
    struct {
        const char *name;
        cl_mem to;
        size_t bytes;
    } part[2 + STATE_STATS] = {{"adam_m1", l->adam.m1, moments}, {"adam_m2", l->adam.m2, moments}};
    cl_mem stats[STATE_STATS];
    state_stat_buffers(l, stats);
    for (size_t i = 0; i < STATE_STATS; i++) {
        part[2 + i].name = state_stat_names[i];
        part[2 + i].to = stats[i];
        part[2 + i].bytes = c->g.n * sizeof(float);
    }
    if (light_is_on(&l->light)) {
        const struct ckpt_blob *model = ckpt_find(c, LIGHT_BLOB);
        const struct ckpt_blob *adam = ckpt_find(c, LIGHT_BLOB_STATE);
        if (!model || !adam)
            return err_set(e, ERR_FORMAT, "%s: holds no appearance model", path);
        enum err_code rc = light_read_state(&l->light, model->data, model->size_bytes, adam->data,
                                            adam->size_bytes, e);
        if (rc)
            return err_add(e, "%s", path);
    }
    for (size_t i = 0; i < 2 + STATE_STATS && part[i].to; i++) {
        const void *data = state_find(c, path, part[i].name, part[i].bytes, e);
        if (!data)
            return ERR_FORMAT;
        enum err_code rc = dev_write(l->dev, part[i].to, 0, part[i].bytes, data, e);
        if (rc)
            return rc;
    }
    return ERR_OK;
}

/* The filter of Mip-Splatting is as old as its last computation: without it the next one would come
 * too early and the run would take another way. */
static enum err_code state_upload_filter(struct level *l, const struct ckpt *c, const char *path,
                                         struct err *e)
{
    size_t bytes = c->g.n * sizeof(float);
    if (l->cfg->aa != RENDER_AA_MIP || !ckpt_find(c, "filter"))
        return ERR_OK;
    const void *data = state_find(c, path, "filter", bytes, e);
    if (!data)
        return ERR_FORMAT;
    enum err_code rc = dev_buffer(l->dev, l->model.cap * sizeof(float), NULL, &l->model.filter, e);
    if (!rc)
        rc = dev_write(l->dev, l->model.filter, 0, bytes, data, e);
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

static enum err_code state_apply(struct level *l, const struct ckpt *c, const char *path,
                                 struct err *e)
{
    const char *kind;
    double level, step, start;
    enum err_code rc = jsonc_text(c->meta, "kind", &kind, e);
    if (!rc && strcmp(kind, "resume"))
        rc = err_set(e, ERR_FORMAT, "is the result of a level, not a state to go on from");
    if (rc)
        return err_add(e, "%s", path);
    rc = state_check_config(l, path, json_object_get(c->meta, "config"), e);
    if (!rc)
        rc = state_check_cell(l, path, c->meta, e);
    if (!rc)
        rc = state_integer(c, path, "level", 1, l->n_levels, &level, e);
    if (!rc)
        rc = state_integer(c, path, "step", 0, l->schedule[(int)level - 1].steps, &step, e);
    if (!rc)
        rc = state_integer(c, path, "start", 0, 4e9, &start, e);
    if (!rc && c->g.sh_degree != (uint32_t)l->cfg->sh_degree)
        rc = err_set(e, ERR_FORMAT, "%s: harmonics of degree %u", path, c->g.sh_degree);
    if (!rc && c->g.embed_len != l->light.model.len_gauss)
        rc = err_set(e, ERR_FORMAT, "%s: embeddings of length %u", path, c->g.embed_len);
    if (rc)
        return rc;
    l->at = (uint32_t)level - 1;
    l->step = (uint32_t)step;
    l->pruned = json_is_true(json_object_get(c->meta, "pruned"));
    rc = state_budget(l, c->meta, e);
    if (rc)
        return err_add(e, "%s", path);
    rc = level_open(l, &c->g, e);
    l->start = (size_t)start;
    if (!rc)
        rc = state_upload(l, c, path, e);
    return rc ? rc : state_upload_filter(l, c, path, e);
}

enum err_code state_load(struct level *l, const char *path, struct err *e)
{
    struct ckpt c;
    enum err_code rc = ckpt_read(path, &c, e);
    if (rc)
        return rc;
    rc = state_apply(l, &c, path, e);
    ckpt_free(&c);
    return rc;
}

/* A cell that was trained with an older shared appearance model does not fit its neighbours. */
static bool state_has_light(const struct level *l, const struct ckpt *c)
{
    struct appearance a = {0};
    struct err why = {0};
    const struct ckpt_blob *b = ckpt_find(c, LIGHT_BLOB);
    if (!light_is_on(&l->light) || !l->light.shared)
        return (b != NULL) == light_is_on(&l->light);
    bool same =
        b && !appearance_read(b->data, b->size_bytes, &a, &why) && light_same(&a, &l->light.model);
    appearance_free(&a);
    return same;
}

enum err_code state_is_result_of(const struct level *l, const char *path, bool *yes, struct err *e)
{
    struct ckpt c;
    struct err why = {0};
    const char *kind = NULL;
    double level = 0.0;
    enum err_code rc = ckpt_read(path, &c, e);
    if (rc)
        return rc;
    *yes = !jsonc_text(c.meta, "kind", &kind, &why) && !strcmp(kind, "level") &&
           !jsonc_num(c.meta, "level", &level, &why) && level == (double)l->n_levels &&
           !state_check_config(l, path, json_object_get(c.meta, "config"), &why) &&
           !state_check_cell(l, path, c.meta, &why) && state_has_light(l, &c);
    ckpt_free(&c);
    return ERR_OK;
}
