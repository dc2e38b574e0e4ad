/* Checks which run a checkpoint belongs to: its options, its cell and its photographs.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/state_check.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <jansson.h>

#include "codec/container/ckpt.h"
#include "scene/cells/cell.h"
#include "train/base/config.h"
#include "train/model/appearance_train.h"
#include "train/photographs/inputs.h"

#define STATE_CHECK_SAME_M 1e-6 /* lengths of a plan go through text */

/* Options that do not change the trajectory. */
static const char *const state_check_free[] = {
    "output",     "cell",      "device",
    "jobs",       "threads",   "list",
    "resume",     "overwrite", "checkpoint_interval",
    "stop_after", "cache_mib", "coarse_only",
    "trace",      "memory",    NULL,
};

void state_check_drop_free(json_t *config)
{
    for (const char *const *k = state_check_free; *k; k++)
        json_object_del(config, *k);
}

static bool state_check_is_free(const char *key)
{
    for (const char *const *k = state_check_free; *k; k++)
        if (!strcmp(key, *k))
            return true;
    return false;
}

enum err_code state_check_config(const struct train_config *cfg, const char *path,
                                 const json_t *saved, struct err *e)
{
    json_t *now = NULL;
    const char *key;
    json_t *value;
    enum err_code rc = options_to_json(train_options(), cfg, &now, e);
    if (rc)
        return rc;
    json_object_foreach(now, key, value)
    {
        if (rc || state_check_is_free(key) || json_equal(value, json_object_get(saved, key)))
            continue;
        char *was = json_dumps(json_object_get(saved, key), JSON_ENCODE_ANY | JSON_COMPACT);
        char *is = json_dumps(value, JSON_ENCODE_ANY | JSON_COMPACT);
        rc = err_set(e, ERR_ARG, "%s: the run had %s = %s, now it is %s", path, key,
                     was ? was : "nothing", is ? is : "nothing");
        free(was); /* jansson's, made with malloc */
        free(is);
    }
    json_decref(now);
    return rc;
}

/* A plan that was made anew gives other cells the same names. */
enum err_code state_check_cell(const struct state_run *run, const char *path, const json_t *meta,
                               struct err *e)
{
    double lengths[2], box[4], photos, grid[3] = {0.0, 0.0, 0.0};
    const struct cell *c = run->cell;
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
    if (photos != (double)run->n_images)
        return err_set(e, ERR_DATA, "%s: the run had %.0f photographs, the scene has %zu now", path,
                       photos, run->n_images);
    /* Without a plan the box follows from the poses, so they are told of first. */
    if (run->inputs && c->whole)
        rc = inputs_check(run->inputs, path, meta, e);
    if (rc)
        return rc;
    const double turned[3] = {c->grid.yaw_rad, c->grid.origin_m[0], c->grid.origin_m[1]};
    bool same = c->grid.turned == (json_object_get(meta, "grid") != NULL);
    if (c->grid.turned && same && jsonc_nums(meta, "grid", 3, grid, e))
        return err_add(e, "%s", path);
    for (size_t i = 0; i < 3; i++)
        same = same && fabs(grid[i] - (c->grid.turned ? turned[i] : 0.0)) <= STATE_CHECK_SAME_M;
    for (size_t i = 0; i < 6; i++)
        if (!same || !(fabs((i < 2 ? lengths[i] : box[i - 2]) - want[i]) <= STATE_CHECK_SAME_M))
            return err_set(e, ERR_DATA,
                           "%s: the run's cell %s was another one, of another plan.json", path,
                           c->id);
    return run->inputs && !c->whole ? inputs_check(run->inputs, path, meta, e) : ERR_OK;
}

/* A cell that was trained with an older shared appearance model does not fit its neighbours. */
static bool state_check_appearance(const struct appearance_train *own, const struct ckpt_rows *c)
{
    struct appearance a = {0};
    struct buf b = {0};
    struct err why = {0};
    if (!appearance_train_is_on(own) || !own->shared)
        return ckpt_rows_has(c, APPEARANCE_TRAIN_BLOB) == appearance_train_is_on(own);
    bool same = !ckpt_rows_blob(c, APPEARANCE_TRAIN_BLOB, &b, &why) && b.data &&
                !appearance_read(b.data, b.size, &a, &why) &&
                appearance_train_same(&a, &own->model);
    appearance_free(&a);
    buf_free(&b);
    return same;
}

enum err_code state_check_result(const struct state_run *run, const struct appearance_train *a,
                                 const char *path, struct err *e)
{
    struct ckpt_rows *c = NULL;
    json_t *meta = NULL;
    const char *kind = NULL;
    enum err_code rc = ckpt_rows_open(path, &c, e);
    if (!rc)
        rc = ckpt_rows_meta(c, &meta, e);
    if (!rc)
        rc = jsonc_text(meta, "kind", &kind, e);
    if (!rc && strcmp(kind, "level"))
        rc = err_set(e, ERR_FORMAT, "%s: is not the result of a level", path);
    if (!rc)
        rc = state_check_config(run->cfg, path, json_object_get(meta, "config"), e);
    if (!rc)
        rc = state_check_cell(run, path, meta, e);
    if (!rc && !state_check_appearance(a, c))
        rc = err_set(e, ERR_DATA, "%s: the run used another shared appearance model", path);
    json_decref(meta);
    ckpt_rows_close(&c);
    return rc;
}
