/* See results.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/base/results.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/scene/scene.h"
#include "core/base.h"
#include "core/geo/geo.h"
#include "lod/store/area.h"

#define RESULTS_SAME_M 1.0

static bool results_has(const char *cell, const char *name)
{
    char path[FILE_PATH_MAX];
    return !file_join(path, cell, name, NULL) && file_exists(path);
}

/* ", without level 3 of 3", by the options that the run has left; empty where they do not tell. */
static void results_missing(const char *cell, char out[64])
{
    char path[FILE_PATH_MAX], name[32];
    json_t *config = NULL;
    double levels = 0.0;
    out[0] = '\0';
    if (!file_join(path, cell, "config.jsonc", NULL) && file_exists(path) &&
        !jsonc_read(path, &config, NULL))
        levels = json_number_value(json_object_get(config, "level_count"));
    json_decref(config);
    for (unsigned l = 1; l <= levels && l < 100; l++) {
        snprintf(name, sizeof name, "level%u.ckpt", l);
        if (results_has(cell, name))
            continue;
        snprintf(out, 64, ", without level %u of %.0f", l, levels);
        return;
    }
}

void results_warn_unfinished(const char *module, const struct scene *s, const char *dir,
                             const char *id)
{
    char cell[FILE_PATH_MAX], missing[64];
    const bool own = !strcmp(dir, s->dir);
    if (snprintf(cell, sizeof cell, "%s/cells/%s", dir, id) >= (int)sizeof cell)
        return;
    const bool stopped = results_has(cell, "resume.ckpt");
    if (!stopped && results_has(cell, "done.json"))
        return;
    results_missing(cell, missing);
    log_warn(module,
             "cell %s: %s%s; what is there is taken, and `citysplat train %s%s%s --resume` goes on",
             id, stopped ? "its training is not finished" : "no done.json says that it is finished",
             missing, s->dir, own ? "" : " --output ", own ? "" : dir);
}

static enum err_code results_far(const struct scene *s, const struct geo_origin *at, double *far_m,
                                 struct err *e)
{
    double enu[3];
    enum err_code rc = geo_to_enu(&s->origin, at->lon_deg, at->lat_deg, at->h_m, enu, e);
    *far_m = rc ? 0.0 : hypot(hypot(enu[0], enu[1]), enu[2]);
    return rc;
}

enum err_code results_check_origin(const struct scene *s, const char *path, const json_t *meta,
                                   struct err *e)
{
    double at[3], far_m = 0.0;
    if (!json_object_get(meta, "origin"))
        return ERR_OK;
    enum err_code rc = jsonc_nums(meta, "origin", 3, at, e);
    if (!rc)
        rc = results_far(s, &(struct geo_origin){at[0], at[1], at[2]}, &far_m, e);
    if (rc)
        return err_add(e, "%s", path);
    return far_m <= RESULTS_SAME_M
               ? ERR_OK
               : err_set(e, ERR_DATA,
                         "%s: was trained of another scene, whose origin lies %.0f m from that of "
                         "%s: give the scene that it was trained of, or train this one",
                         path, far_m, s->dir);
}

enum err_code results_check_frame(const struct scene *s, const char *path,
                                  const struct geo_origin *origin, struct err *e)
{
    double far_m = 0.0;
    enum err_code rc = results_far(s, origin, &far_m, e);
    return rc || far_m <= RESULTS_SAME_M
               ? rc
               : err_set(e, ERR_DATA,
                         "%s: its origin lies %.0f m from that of %s, so cameras of the scene do "
                         "not fit it: give a store that `citysplat tile %s` made",
                         path, far_m, s->dir, s->dir);
}

/* west, south, east, north of the box around cameras and points. */
static enum err_code results_box(const struct scene *s, double box[4], struct err *e)
{
    double lo[2] = {HUGE_VAL, HUGE_VAL}, hi[2] = {-HUGE_VAL, -HUGE_VAL};
    for (size_t i = 0; i < s->n_images + s->n_points; i++) {
        double at[3];
        if (i < s->n_images)
            camera_center(&s->images[i].cam, at);
        for (size_t k = 0; k < 2; k++) {
            const double v = i < s->n_images ? at[k] : s->points[i - s->n_images].enu_m[k];
            lo[k] = fmin(lo[k], v);
            hi[k] = fmax(hi[k], v);
        }
    }
    enum err_code rc = ERR_OK;
    box[0] = box[1] = HUGE_VAL;
    box[2] = box[3] = -HUGE_VAL;
    for (size_t i = 0; !rc && i < 4; i++) {
        const double enu[3] = {i & 1 ? hi[0] : lo[0], i & 2 ? hi[1] : lo[1], 0.0};
        double lon, lat, h;
        rc = geo_from_enu(&s->origin, enu, &lon, &lat, &h, e);
        box[0] = fmin(box[0], lon);
        box[1] = fmin(box[1], lat);
        box[2] = fmax(box[2], lon);
        box[3] = fmax(box[3], lat);
    }
    return rc;
}

enum err_code results_check_store(const struct scene *s, const char *path, const struct area *a,
                                  struct err *e)
{
    double box[4];
    if (!s->n_images)
        return ERR_OK;
    enum err_code rc = results_box(s, box, e);
    if (rc)
        return rc;
    return a->west_deg <= box[2] && box[0] <= a->east_deg && a->south_deg <= box[3] &&
                   box[1] <= a->north_deg
               ? ERR_OK
               : err_set(e, ERR_DATA,
                         "%s lies near longitude %.6f, latitude %.6f, and %s near %.6f, %.6f: they "
                         "have no ground in common; give a store of this scene",
                         path, 0.5 * (a->west_deg + a->east_deg),
                         0.5 * (a->south_deg + a->north_deg), s->dir, s->origin.lon_deg,
                         s->origin.lat_deg);
}
