/* Where the photographs, the model and the ground control of a scene are, for `citysplat mark`:
 * report.json of ingest says it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>

#include "cli/scene/mark_work.h"

/* A path of the report, as seen from the scene, that is still there; NULL: it is not said, or not
 * there. Older reports have absolute ones. */
static const char *mark_scene_path(const json_t *report, const char *scene, const char *key,
                                   struct arena *a)
{
    char path[FILE_PATH_MAX];
    struct err ignored;
    const json_t *v = json_object_get(json_object_get(report, "source"), key);
    const char *said = json_string_value(v);
    if (!said || file_join(path, *said == '/' ? "" : scene, said, &ignored))
        return NULL;
    return file_exists(path) || file_is_dir(path) ? arena_text(a, path) : NULL;
}

static double mark_scene_number(const json_t *report, const char *key, double standard)
{
    const json_t *v = json_object_get(json_object_get(report, "config"), key);
    return json_is_number(v) ? json_number_value(v) : standard;
}

static enum err_code mark_scene_read(const char *scene, struct mark_source *out, struct arena *a,
                                     struct err *e)
{
    char path[FILE_PATH_MAX];
    json_t *report = NULL;
    enum err_code rc = file_join(path, scene, "scene.json", e);
    if (!rc && !file_exists(path))
        rc = err_set(e, ERR_NOENT,
                     "%s: no scene; give one, or a folder of photographs and its COLMAP model",
                     scene);
    if (!rc)
        rc = file_join(path, scene, "report.json", e);
    if (!rc)
        rc = jsonc_read(path, &report, e);
    if (rc)
        return rc;
    *out = (struct mark_source){.scene = scene,
                                .photographs = mark_scene_path(report, scene, "photographs", a),
                                .model = mark_scene_path(report, scene, "model", a),
                                .gcp = mark_scene_path(report, scene, "ground_control", a),
                                .gcp_epsg = (int)mark_scene_number(report, "gcp_epsg", 0),
                                .gcp_scale = mark_scene_number(report, "gcp_scale", 1),
                                .max_reprojection_px =
                                    mark_scene_number(report, "max_reprojection_px", 8)};
    json_decref(report);
    if (out->photographs && out->model)
        return ERR_OK;
    return err_set(
        e, ERR_NOENT,
        "%s: does not say where the %s of this scene is, or it is gone from there; say it: "
        "citysplat mark PHOTOGRAPHS MODEL --scene %s",
        path, out->photographs ? "model" : "folder of photographs", scene);
}

enum err_code mark_scene_find(const struct options_args *args, struct mark_source *out,
                              struct arena *a, struct err *e)
{
    if (args->n == 1)
        return mark_scene_read(args->arg[0], out, a, e);
    *out = (struct mark_source){.photographs = args->arg[0], .model = args->arg[1], .gcp_scale = 1};
    return ERR_OK;
}
