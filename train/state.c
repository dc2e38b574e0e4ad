/* The files of a run: the state to resume from, and the result of each level.
 *
 * A state has the Gaussians, the moments of Adam and the densification statistics in the device's
 * layout, the last step that each group of Gaussians has made, and three numbers: level, step, and
 * Gaussians at the level's start. Everything else (order of photographs, schedules, random numbers)
 * follows from these, the options and the cell.
 * Options and cell are stored and compared: a run can be continued only with the options and the
 * plan that it began with.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/state.h"

#include <math.h>
#include <string.h>

#include <jansson.h>

#include "codec/container/ckpt.h"
#include "core/geo/geo.h"
#include "core/layout.h"
#include "train/base/config.h"
#include "train/base/fixed.h"
#include "train/model/appearance_train.h"
#include "train/model/model.h"
#include "train/photographs/evaluate.h"
#include "train/photographs/inputs.h"

enum { STATE_STATS = 5, STATE_APPEARANCE = 2, STATE_SLICE = 65536 };
#define STATE_MOMENTS "adam" /* uint32_t: both moments of each parameter, see render.h */
#define STATE_OWED "settled" /* uint32_t [groups]: see render/defer.h */
static const char *const state_stat_names[STATE_STATS] = {"stat_grad", "stat_absg", "stat_count",
                                                          "stat_radius", "stat_opacity"};

static void state_stat_buffers(const struct model *m, cl_mem out[STATE_STATS])
{
    out[0] = m->stats.grad;
    out[1] = m->stats.absg;
    out[2] = m->stats.count;
    out[3] = m->stats.radius;
    out[4] = m->stats.opacity; /* NULL without appearance */
}

/* Head of every checkpoint; NULL when out of memory. */
static json_t *state_meta(const struct model *m, const struct state *st, const char *kind,
                          struct err *e)
{
    json_t *config = NULL;
    if (options_to_json(train_options(), st->run.cfg, &config, e))
        return NULL;
    state_check_drop_free(config);
    const struct stage *at = &st->at;
    const struct schedule *s = stage_schedule(at);
    const struct cell *c = st->run.cell;
    json_t *o = json_pack(
        "{s:s, s:s, s:s, s:i, s:i, s:i, s:i, s:I, s:I, s:I, s:f, s:f, s:f, s:[f,f,f,f], s:o}",
        "kind", kind, "version", CITYSPLAT_VERSION, "cell", c->id, "level", (int)s->level, "levels",
        (int)at->n_levels, "step", (int)at->step, "steps", (int)s->steps, "start",
        (json_int_t)at->start, "gaussians", (json_int_t)m->gauss.n, "photographs",
        (json_int_t)st->run.n_images, "downsample", s->downsample, "edge_m", c->edge_m, "extent_m",
        c->extent_m, "box_m", c->min_enu_m[0], c->min_enu_m[1], c->max_enu_m[0], c->max_enu_m[1],
        "config", config);
    const struct cell_grid *g = &c->grid;
    if (o && g->turned && /* along ENU there is no such member */
        json_object_set_new(o, "grid",
                            json_pack("[f,f,f]", g->yaw_rad, g->origin_m[0], g->origin_m[1]))) {
        json_decref(o);
        o = NULL;
    }
    const struct geo_origin *from = st->run.origin;
    if (o && from &&
        json_object_set_new(o, "origin",
                            json_pack("[f,f,f]", from->lon_deg, from->lat_deg, from->h_m))) {
        json_decref(o);
        o = NULL;
    }
    if (o && at->again && at->turned && json_object_set_new(o, "again", json_true())) {
        json_decref(o);
        o = NULL;
    }
    if (o && json_object_set_new(o, "pruned", json_boolean(at->pruned))) {
        json_decref(o);
        o = NULL;
    }
    if (o && st->run.inputs && json_object_set_new(o, "inputs", inputs_to_json(st->run.inputs))) {
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
    struct model *m;
    struct gauss like;
    cl_mem mem[4 + STATE_STATS];
    void *at[4 + STATE_STATS]; /* [0]: the parameters */
    size_t n;
};

static enum err_code state_view_map(struct state_view *v, cl_mem mem, size_t bytes, struct err *e)
{
    enum err_code rc = dev_map(v->m->dev, mem, CL_MAP_READ, bytes, &v->at[v->n], e);
    if (!rc)
        v->mem[v->n++] = mem;
    return rc;
}

static enum err_code state_view_open(struct model *m, bool antialiased, struct state_view *v,
                                     struct err *e)
{
    const struct render_model *g = &m->gauss;
    *v = (struct state_view){.m = m,
                             .like = {.n = g->n,
                                      .sh_degree = g->sh_degree,
                                      .embed_len = g->embed_len,
                                      .antialiased = antialiased}};
    memcpy(v->like.origin_enu_m, g->origin_enu_m, sizeof v->like.origin_enu_m);
    return state_view_map(v, g->params, model_bytes(m), e);
}

/* Give the buffers back; rc is what came before. */
static enum err_code state_view_close(struct state_view *v, enum err_code rc, struct err *e)
{
    struct err why = {0};
    for (size_t i = 0; i < v->n; i++) {
        enum err_code done = dev_unmap(v->m->dev, v->mem[i], &v->at[i], &why);
        if (!rc && done)
            rc = err_set(e, done, "%s", why.msg);
    }
    return rc;
}

/* Rows of one array of the Gaussians, for ckpt_write_from. */
static enum err_code state_rows(void *user, enum ckpt_field field, size_t first, size_t n,
                                float *out, struct err *e)
{
    (void)e;
    const struct state_view *v = user;
    const struct render_model *m = &v->m->gauss;
    const uint32_t plane[] = {LAYOUT_PLANE_MEAN, LAYOUT_PLANE_SCALE,
                              LAYOUT_PLANE_QUAT, LAYOUT_PLANE_OPACITY,
                              LAYOUT_PLANE_SH,   layout_planes(m->sh_degree, 0),
                              m->planes};
    size_t count = plane[field + 1] - plane[field];
    for (size_t i = 0; i < n; i++) {
        const float *p = (const float *)v->at[0] + layout_at(first + i, m->planes) +
                         (size_t)plane[field] * LAYOUT_LANES;
        for (size_t k = 0; k < count; k++)
            out[i * count + k] = p[k * LAYOUT_LANES];
    }
    return ERR_OK;
}

enum err_code state_save_level(struct model *m, const struct state *s, const char *path,
                               const struct evaluate_score *score, struct err *e)
{
    struct state_view v = {0};
    json_t *meta = state_meta(m, s, "level", e);
    if (!meta)
        return ERR_MEM;
    enum err_code rc = ERR_OK;
    if (json_object_set_new(meta, "pixel_m", json_real(s->pixel_m)))
        rc = err_set(e, ERR_MEM, "%s: out of memory", path);
    if (!rc && score) {
        json_t *test =
            json_pack("{s:I, s:o, s:o}", "photographs", (json_int_t)score->n_photos, "psnr_db",
                      jsonc_real(score->psnr_db), "ssim", jsonc_real(score->ssim));
        if (!test || json_object_set_new(meta, "test", test))
            rc = err_set(e, ERR_MEM, "%s: out of memory", path);
    }
    struct buf appearance = {0};
    struct ckpt_blob blob = {.name = APPEARANCE_TRAIN_BLOB};
    bool with = appearance_train_is_on(s->appearance);
    if (!rc && with)
        rc = appearance_write(&s->appearance->model, &appearance, e);
    blob.data = appearance.data;
    blob.size_bytes = appearance.size;
    if (!rc) {
        rc = state_view_open(m, s->run.cfg->aa != RENDER_AA_NONE, &v, e);
        const struct ckpt_source from = {.like = &v.like, .rows = state_rows, .user = &v};
        if (!rc)
            rc = ckpt_write_from(path, meta, &from, &blob, with, e);
        rc = state_view_close(&v, rc, e);
    }
    buf_free(&appearance);
    json_decref(meta);
    return rc;
}

/* A buffer of the device as a blob. */
static enum err_code state_blob(struct state_view *v, const char *name, cl_mem from, size_t bytes,
                                struct ckpt_blob *b, struct err *e)
{
    enum err_code rc = state_view_map(v, from, bytes, e);
    memcpy(b->name, name, strlen(name) + 1);
    b->data = rc ? NULL : v->at[v->n - 1];
    b->size_bytes = bytes;
    return rc;
}

/* The appearance model, and the moments of its optimiser. */
static enum err_code state_appearance_blobs(const struct appearance_train *a,
                                            struct ckpt_blob out[STATE_APPEARANCE], struct err *e)
{
    struct buf b[STATE_APPEARANCE] = {{0}};
    enum err_code rc = appearance_write(&a->model, &b[0], e);
    if (!rc)
        rc = appearance_train_write_state(a, &b[1], e);
    memcpy(out[0].name, APPEARANCE_TRAIN_BLOB, sizeof(APPEARANCE_TRAIN_BLOB));
    memcpy(out[1].name, APPEARANCE_TRAIN_BLOB_STATE, sizeof(APPEARANCE_TRAIN_BLOB_STATE));
    for (size_t i = 0; i < STATE_APPEARANCE; i++) { /* the caller frees them */
        out[i].data = b[i].data;
        out[i].size_bytes = b[i].size;
    }
    return rc;
}

enum err_code state_save(struct model *m, const struct state *s, const char *path, struct err *e)
{
    struct state_view v = {0};
    struct ckpt_blob blobs[2 + STATE_STATS + STATE_APPEARANCE] = {0};
    cl_mem owed = NULL;
    const struct render_model *g = &m->gauss;
    size_t n = 0, moments = model_bytes(m), n_appearance = 0;
    json_t *meta = state_meta(m, s, "resume", e);
    if (meta && json_object_set_new(meta, "seconds", json_real(s->seconds))) {
        json_decref(meta);
        return err_set(e, ERR_MEM, "%s: out of memory", path);
    }
    if (!meta)
        return ERR_MEM;
    cl_mem stats[STATE_STATS];
    state_stat_buffers(m, stats);
    enum err_code rc = model_owed(m, &owed, e);
    if (!rc)
        rc = state_view_open(m, s->run.cfg->aa != RENDER_AA_NONE, &v, e);
    if (!rc)
        rc = state_blob(&v, STATE_MOMENTS, m->adam.moments, moments, &blobs[n++], e);
    for (size_t i = 0; !rc && i < STATE_STATS && stats[i]; i++)
        rc = state_blob(&v, state_stat_names[i], stats[i], g->n * sizeof(float), &blobs[n++], e);
    if (!rc && owed)
        rc = state_blob(&v, STATE_OWED, owed, g->groups * sizeof(uint32_t), &blobs[n++], e);
    if (!rc && appearance_train_is_on(s->appearance)) {
        rc = state_appearance_blobs(s->appearance, blobs + n, e);
        n_appearance = STATE_APPEARANCE;
    }
    const struct ckpt_source from = {.like = &v.like, .rows = state_rows, .user = &v};
    if (!rc)
        rc = ckpt_write_from(path, meta, &from, blobs, n + n_appearance, e);
    for (size_t i = 0; i < n_appearance; i++)
        mem_free((void *)(uintptr_t)blobs[n + i].data);
    json_decref(meta);
    return state_view_close(&v, rc, e);
}

/* ---- reading ---- */

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
static enum err_code state_fill(struct model *m, const struct ckpt_rows *c, const char *name,
                                cl_mem to, size_t bytes, struct err *e)
{
    void *at = NULL;
    struct err why = {0};
    enum err_code rc = dev_map(m->dev, to, CL_MAP_WRITE, bytes, &at, e);
    if (!rc)
        rc = ckpt_rows_blob_to(c, name, at, bytes, e);
    enum err_code done = dev_unmap(m->dev, to, &at, &why);
    return !rc && done ? err_set(e, done, "%s", why.msg) : rc;
}

static enum err_code state_fill_appearance(struct appearance_train *a, const struct ckpt_rows *c,
                                           const char *path, struct err *e)
{
    struct buf model = {0}, adam = {0};
    if (!appearance_train_is_on(a))
        return ERR_OK;
    enum err_code rc = ckpt_rows_blob(c, APPEARANCE_TRAIN_BLOB, &model, e);
    if (!rc)
        rc = ckpt_rows_blob(c, APPEARANCE_TRAIN_BLOB_STATE, &adam, e);
    if (!rc && (!model.data || !adam.data))
        rc = err_set(e, ERR_FORMAT, "%s: holds no appearance model", path);
    else if (!rc && appearance_train_read_state(a, model.data, model.size, adam.data, adam.size, e))
        rc = err_add(e, "%s", path);
    buf_free(&model);
    buf_free(&adam);
    return rc;
}

enum err_code state_fill_rows(struct model *m, const struct ckpt_rows *c, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < m->gauss.n; i += STATE_SLICE) {
        struct gauss g = {0};
        rc = ckpt_rows_read(c, i, m->gauss.n - i < STATE_SLICE ? m->gauss.n - i : STATE_SLICE, &g,
                            e);
        if (!rc)
            rc = render_model_write(m->render, &m->gauss, i, &g, e);
        gauss_free(&g);
    }
    return rc;
}

static enum err_code state_fill_all(struct model *m, struct state *s, const struct ckpt_rows *c,
                                    const char *path, struct err *e)
{
    size_t moments = model_bytes(m);
    cl_mem stats[STATE_STATS];
    state_stat_buffers(m, stats);
    enum err_code rc = state_fill_rows(m, c, e);
    if (!rc)
        rc = state_fill_appearance(s->appearance, c, path, e);
    if (!rc)
        rc = state_fill(m, c, STATE_MOMENTS, m->adam.moments, moments, e);
    for (size_t i = 0; !rc && i < STATE_STATS && stats[i]; i++)
        rc = state_fill(m, c, state_stat_names[i], stats[i], m->gauss.n * sizeof(float), e);
    return rc;
}

/* Steps that groups of Gaussians were owed. */
static enum err_code state_fill_owed(struct model *m, struct state *s, const struct ckpt_rows *c,
                                     const char *path, struct err *e)
{
    size_t groups = m->gauss.groups;
    s->owes = ckpt_rows_has(c, STATE_OWED) && groups;
    if (!s->owes)
        return ERR_OK;
    uint32_t *settled = mem_array(groups, sizeof *settled);
    if (!settled)
        return err_set(e, ERR_MEM, "%s: out of memory for %zu groups", path, groups);
    enum err_code rc = ckpt_rows_blob_to(c, STATE_OWED, settled, groups * sizeof *settled, e);
    for (size_t i = 0; !rc && i < groups; i++)
        if (settled[i] > s->at.step)
            rc = err_set(e, ERR_FORMAT, "%s: group %zu has made step %u of %u", path, i, settled[i],
                         s->at.step);
    if (!rc)
        rc = model_owe(m, settled, &s->owes_from, e);
    mem_free(settled);
    return rc;
}

/* Is this a state of the same run? Then take over where it stood. */
static enum err_code state_apply(struct state *s, const json_t *meta, const struct gauss *like,
                                 const char *path, struct err *e)
{
    const struct train_config *cfg = s->run.cfg;
    struct stage *at = &s->at;
    const char *kind;
    double level, step, start;
    enum err_code rc = jsonc_text(meta, "kind", &kind, e);
    if (!rc && strcmp(kind, "resume"))
        rc = err_set(e, ERR_FORMAT, "is the result of a level, not a state to go on from");
    if (rc)
        return err_add(e, "%s", path);
    struct err why = {0};
    rc = state_check_config(cfg, path, json_object_get(meta, "config"), &why);
    if (!rc)
        rc = state_check_cell(&s->run, path, meta, &why);
    if (rc)
        return err_set(e, rc, "%s: go back to that, or begin anew with --overwrite", why.msg);
    if (!rc)
        rc = state_integer(meta, path, "level", 1, at->n_levels, &level, e);
    if (!rc && at->again && !at->turned && json_is_true(json_object_get(meta, "again")))
        stage_turn(at, cfg);
    if (!rc)
        rc = state_integer(meta, path, "step", 0, at->levels[(int)level - 1].steps, &step, e);
    if (!rc)
        rc = state_integer(meta, path, "start", 0, 4e9, &start, e);
    if (!rc && like->sh_degree != (uint32_t)cfg->sh_degree)
        rc = err_set(e, ERR_FORMAT, "%s: harmonics of degree %u", path, like->sh_degree);
    if (!rc && like->embed_len != s->appearance->model.len_gauss)
        rc = err_set(e, ERR_FORMAT, "%s: embeddings of length %u", path, like->embed_len);
    if (rc)
        return rc;
    at->at = (uint32_t)level - 1;
    at->step = (uint32_t)step;
    at->start = (size_t)start;
    at->pruned = json_is_true(json_object_get(meta, "pruned"));
    double seconds = json_number_value(json_object_get(meta, "seconds")); /* older ones have none */
    s->seconds = seconds > 0.0 ? seconds : 0.0;
    return ERR_OK;
}

/* Older states have moments of twice the size. To round them would not be the run that it was. */
static enum err_code state_check_moments(const struct ckpt_rows *c, const char *path, struct err *e)
{
    return ckpt_rows_has(c, STATE_MOMENTS)
               ? ERR_OK
               : err_set(e, ERR_FORMAT,
                         "%s: is of a version that stored moments of Adam in 32 bits: finish the "
                         "run with that version, or begin anew with --overwrite",
                         path);
}

enum err_code state_load(struct model *m, const struct engine *with, struct state *s,
                         const char *path, struct err *e)
{
    struct ckpt_rows *c = NULL;
    json_t *meta = NULL;
    enum err_code rc = ckpt_rows_open(path, &c, e);
    if (!rc)
        rc = ckpt_rows_meta(c, &meta, e);
    if (!rc)
        rc = state_apply(s, meta, ckpt_rows_like(c), path, e);
    if (!rc)
        rc = state_check_moments(c, path, e);
    if (!rc)
        rc = model_open(m, with->dev, with->render, ckpt_rows_like(c),
                        schedule_most(stage_schedule(&s->at), s->run.cell), e);
    if (!rc)
        rc = state_fill_all(m, s, c, path, e);
    if (!rc)
        rc = state_fill_owed(m, s, c, path, e);
    json_decref(meta);
    ckpt_rows_close(&c);
    return rc;
}

static double state_score(const json_t *test, const char *key)
{
    const json_t *v = json_object_get(test, key);
    return json_is_number(v) ? json_number_value(v) : (double)NAN;
}

enum err_code state_read_level(const char *path, size_t *n, double *psnr_db, double *ssim,
                               struct err *e)
{
    struct ckpt_rows *c = NULL;
    json_t *meta = NULL;
    enum err_code rc = ckpt_rows_open(path, &c, e);
    if (!rc)
        rc = ckpt_rows_meta(c, &meta, e);
    if (!rc) {
        const json_t *test = json_object_get(meta, "test");
        *n = ckpt_rows_count(c);
        *psnr_db = state_score(test, "psnr_db");
        *ssim = state_score(test, "ssim");
    }
    json_decref(meta);
    ckpt_rows_close(&c);
    return rc;
}
