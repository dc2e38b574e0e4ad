/* OpenDroneMap's report of its photographs, odm_report/shots.geojson, with cameras.json: what is
 * left of a project when its folder opensfm/ was removed.
 *
 * Translations are the cameras' places in UTM, and rotations turn UTM's axes into the camera's. The
 * model's frame is UTM less the whole metres of the first place, so that its numbers keep their
 * precision. There are no points.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/scene/odm_parts.h"

/* A feature's photograph and its place on Earth. */
static enum err_code odm_shot_place(const json_t *feature, const char **name, struct odm_place *out,
                                    struct err *e)
{
    double at[3];
    enum err_code rc = jsonc_text(json_object_get(feature, "properties"), "filename", name, e);
    if (!rc)
        rc = jsonc_nums(json_object_get(feature, "geometry"), "coordinates", 3, at, e);
    if (!rc && !(fabs(at[0]) <= 180 && fabs(at[1]) <= 90 && fabs(at[2]) < 1e5))
        rc = err_set(e, ERR_FORMAT, "%g, %g, %g is no longitude, latitude and height", at[0], at[1],
                     at[2]);
    if (!rc)
        *out = (struct odm_place){true, at[0], at[1], at[2]};
    return rc;
}

static enum err_code odm_shots_open(const char *path, json_t **root, const json_t **features,
                                    struct err *e)
{
    enum err_code rc = jsonc_read(path, root, e);
    if (rc)
        return rc;
    *features = json_object_get(*root, "features");
    return json_is_array(*features)
               ? ERR_OK
               : err_set(e, ERR_FORMAT, "%s: an array of \"features\" is expected", path);
}

enum err_code odm_shots_places(const char *path, const struct odm_keys *names,
                               struct odm_project *out, struct err *e)
{
    json_t *root = NULL;
    const json_t *features;
    enum err_code rc = odm_shots_open(path, &root, &features, e);
    for (size_t i = 0; !rc && i < json_array_size(features); i++) {
        const char *name;
        struct odm_place at;
        rc = odm_shot_place(json_array_get(features, i), &name, &at, e);
        if (rc) {
            err_add(e, "%s: feature %zu", path, i + 1);
            break;
        }
        uint32_t k = odm_keys_find(names, name);
        if (k == UINT32_MAX)
            continue;
        out->n_places += !out->places[k].known;
        out->places[k] = at;
    }
    json_decref(root);
    return rc;
}

/* ---- as poses ---- */

struct odm_shots {
    struct odm_project *out;
    const json_t **of; /* [n] features, by name of their photographs */
    struct odm_keys names;
    json_t *cameras; /* cameras.json; NULL: none */
    double shift[3];
};

/* The one camera of cameras.json with the size and focal length of a photograph; NULL: none. */
static enum err_code odm_shot_camera(const struct odm_shots *s, const json_t *properties,
                                     const char **id, const json_t **out, struct err *e)
{
    const char *name;
    json_t *camera;
    double want[3], have[3];
    size_t n = 0;
    enum err_code rc = jsonc_num(properties, "width", &want[0], e);
    if (!rc)
        rc = jsonc_num(properties, "height", &want[1], e);
    if (!rc)
        rc = jsonc_num(properties, "focal", &want[2], e);
    if (rc)
        return rc;
    json_object_foreach(s->cameras, name, camera)
    {
        bool one = json_object_get(camera, "focal") != NULL;
        have[0] = json_number_value(json_object_get(camera, "width"));
        have[1] = json_number_value(json_object_get(camera, "height"));
        have[2] = json_number_value(json_object_get(camera, one ? "focal" : "focal_x"));
        if (have[0] != want[0] || have[1] != want[1] || !(fabs(have[2] - want[2]) < 1e-6))
            continue;
        *id = name;
        *out = camera;
        n++;
    }
    return n == 1 ? ERR_OK
                  : err_set(e, ERR_DATA,
                            "%zu cameras of cameras.json have its size %g x %g and focal length "
                            "%.9g; shots.geojson does not say more",
                            n, want[0], want[1], want[2]);
}

static enum err_code odm_shot_lens(const struct odm_shots *s, const json_t *properties, size_t *k,
                                   struct err *e)
{
    struct colmap_model *m = &s->out->model;
    struct lens lens;
    const char *id = "";
    const json_t *camera = NULL;
    enum err_code rc = odm_shot_camera(s, properties, &id, &camera, e);
    if (!rc)
        rc = odm_lens(id, camera, &lens, e);
    if (rc)
        return rc;
    for (*k = 0; *k < m->n_cameras; ++*k)
        if (!memcmp(&m->cameras[*k].lens, &lens, sizeof lens))
            return ERR_OK;
    m->cameras[*k] = (struct colmap_camera){.id = (uint32_t)(*k + 1), .lens = lens};
    m->n_cameras++;
    return ERR_OK;
}

/* Pose of the frame: world -> camera, with the camera's place instead of its translation. */
static enum err_code odm_shot_pose(struct odm_shots *s, size_t i, struct err *e)
{
    struct colmap_model *m = &s->out->model;
    struct colmap_image *im = &m->images[i];
    const json_t *properties = json_object_get(s->of[s->names.list[i].index], "properties");
    double rot[9], at[3];
    enum err_code rc = odm_image_set(m, i, s->names.list[i].name, properties, e);
    if (rc)
        return rc;
    camera_quat_to_rot(im->quat_wxyz, rot);
    for (int k = 0; k < 3; k++) {
        if (!i)
            s->shift[k] = floor(im->trans[k]);
        at[k] = im->trans[k] - s->shift[k];
    }
    for (int k = 0; k < 3; k++)
        im->trans[k] = -(rot[3 * k] * at[0] + rot[3 * k + 1] * at[1] + rot[3 * k + 2] * at[2]);
    rc = odm_shot_lens(s, properties, &im->camera, e);
    if (rc)
        err_add(e, "photograph '%.200s'", im->name);
    return rc;
}

static enum err_code odm_shots_list(struct odm_shots *s, const json_t *features, struct err *e)
{
    struct arena *a = &s->out->model.arena;
    size_t n = json_array_size(features);
    struct odm_place at;
    s->names.n = n;
    s->names.list = arena_get(a, n, sizeof *s->names.list);
    s->of = arena_get(a, n, sizeof *s->of);
    if (!s->names.list || !s->of)
        return err_set(e, ERR_MEM, "out of memory for %zu photographs", n);
    if (!n)
        return err_set(e, ERR_DATA, "no photograph was placed");
    for (size_t i = 0; i < n; i++) {
        s->of[i] = json_array_get(features, i);
        s->names.list[i].index = (uint32_t)i;
        enum err_code rc = odm_shot_place(s->of[i], &s->names.list[i].name, &at, e);
        if (rc) {
            err_add(e, "feature %zu", i + 1);
            return rc;
        }
    }
    odm_keys_sort(&s->names);
    for (size_t i = 1; i < n; i++)
        if (!strcmp(s->names.list[i].name, s->names.list[i - 1].name))
            return err_set(e, ERR_FORMAT, "photograph '%.200s' appears twice",
                           s->names.list[i].name);
    return ERR_OK;
}

static enum err_code odm_shots_poses(struct odm_shots *s, const json_t *features, struct err *e)
{
    struct odm_project *out = s->out;
    struct colmap_model *m = &out->model;
    enum err_code rc = odm_shots_list(s, features, e);
    if (rc)
        return rc;
    m->images = arena_get(&m->arena, s->names.n, sizeof *m->images);
    m->cameras = arena_get(&m->arena, s->names.n, sizeof *m->cameras);
    out->places = arena_get(&m->arena, s->names.n, sizeof *out->places);
    if (!m->images || !m->cameras || !out->places)
        return err_set(e, ERR_MEM, "out of memory for %zu photographs", s->names.n);
    m->n_images = out->n_places = s->names.n;
    out->links = ODM_LINKS_NONE;
    for (size_t i = 0; !rc && i < m->n_images; i++) {
        const char *name;
        rc = odm_shot_pose(s, i, e);
        if (!rc)
            rc = odm_shot_place(s->of[s->names.list[i].index], &name, &out->places[i], e);
    }
    return rc;
}

enum err_code odm_shots_read(const char *path, const char *project, struct odm_project *out,
                             struct err *e)
{
    struct odm_shots s = {.out = out};
    json_t *root = NULL;
    const json_t *features;
    char cameras[FILE_PATH_MAX];
    enum err_code rc = odm_shots_open(path, &root, &features, e);
    if (!rc)
        rc = file_join(cameras, project, "cameras.json", e);
    if (!rc) {
        rc = jsonc_read(cameras, &s.cameras, e);
        if (rc)
            err_add(e, "%s has no lenses, which are read from cameras.json", path);
    }
    if (!rc && (rc = odm_shots_poses(&s, features, e)))
        err_add(e, "%s", path);
    json_decref(s.cameras);
    json_decref(root);
    return rc;
}
