/* Projects of OpenDroneMap and OpenSfM: which files, and what of them. See odm.h.
 *
 * OpenDroneMap rewrites reconstruction.json into metres of UTM by a linear map, and keeps OpenSfM's
 * as reconstruction.topocentric.json. That one is read where it is there: its frame is
 * east-north-up about reference_lla, and its rotations are those of the adjustment.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <math.h>
#include <string.h>

#include "codec/scene/odm_parts.h"
#include "core/geo/geo.h"

void odm_free(struct odm_project *p)
{
    colmap_free(&p->model);
    *p = (struct odm_project){0};
}

static enum err_code odm_read_no_memory(struct err *e)
{
    return err_set(e, ERR_MEM, "out of memory");
}

/* ---- reconstruction.json ---- */

struct odm_parse {
    struct odm_project *out;
    const json_t *cameras, *shots, *points;
    struct odm_keys lens_names, names, point_names;
    uint32_t *lens_of; /* [lens_names.n] index of a camera that is used; UINT32_MAX: not yet */
};

static enum err_code odm_parse_camera(struct odm_parse *p, const json_t *shot, size_t *out,
                                      struct err *e)
{
    struct colmap_model *m = &p->out->model;
    const char *id;
    enum err_code rc = jsonc_text(shot, "camera", &id, e);
    if (rc)
        return rc;
    uint32_t k = odm_keys_find(&p->lens_names, id);
    if (k == UINT32_MAX)
        return err_set(e, ERR_FORMAT, "its camera '%.100s' is not among the cameras", id);
    if (p->lens_of[k] == UINT32_MAX) {
        struct colmap_camera *c = &m->cameras[m->n_cameras];
        rc = odm_lens(id, json_object_get(p->cameras, id), &c->lens, e);
        if (rc)
            return rc;
        c->id = (uint32_t)(m->n_cameras + 1);
        p->lens_of[k] = (uint32_t)m->n_cameras++;
    }
    *out = p->lens_of[k];
    return ERR_OK;
}

static enum err_code odm_parse_shots(struct odm_parse *p, struct err *e)
{
    struct colmap_model *m = &p->out->model;
    enum err_code rc = odm_keys_of(p->cameras, &m->arena, &p->lens_names, e);
    if (!rc)
        rc = odm_keys_of(p->shots, &m->arena, &p->names, e);
    if (rc)
        return rc;
    m->cameras = arena_get(&m->arena, p->lens_names.n, sizeof *m->cameras);
    p->lens_of = arena_get(&m->arena, p->lens_names.n, sizeof *p->lens_of);
    m->images = arena_get(&m->arena, p->names.n, sizeof *m->images);
    p->out->places = arena_get(&m->arena, p->names.n, sizeof *p->out->places);
    if (!m->cameras || !p->lens_of || !m->images || !p->out->places)
        return odm_read_no_memory(e);
    memset(p->lens_of, 0xff, p->lens_names.n * sizeof *p->lens_of);
    m->n_images = p->names.n;
    for (size_t i = 0; !rc && i < m->n_images; i++) {
        const char *name = p->names.list[i].name;
        const json_t *shot = json_object_get(p->shots, name);
        rc = odm_image_set(m, i, name, shot, e);
        if (!rc && (rc = odm_parse_camera(p, shot, &m->images[i].camera, e)))
            err_add(e, "photograph '%.200s'", name);
    }
    return rc;
}

static uint8_t odm_byte(double v)
{
    return (uint8_t)(v > 0 ? v < 255 ? v + 0.5 : 255 : 0);
}

static enum err_code odm_parse_points(struct odm_parse *p, struct err *e)
{
    struct colmap_model *m = &p->out->model;
    enum err_code rc = odm_keys_of(p->points, &m->arena, &p->point_names, e);
    m->points = rc ? NULL : arena_get(&m->arena, p->point_names.n, sizeof *m->points);
    if (!m->points)
        return rc ? rc : odm_read_no_memory(e);
    m->n_points = p->point_names.n;
    for (size_t i = 0; i < m->n_points; i++) {
        const json_t *o = json_object_get(p->points, p->point_names.list[i].name);
        struct colmap_point *pt = &m->points[i];
        double rgb[3] = {128, 128, 128};
        rc = jsonc_nums(o, "coordinates", 3, pt->xyz, e);
        if (!rc && json_object_get(o, "color"))
            rc = jsonc_nums(o, "color", 3, rgb, e);
        for (int k = 0; !rc && k < 3; k++)
            if (!(fabs(pt->xyz[k]) <= odm_far))
                rc = err_set(e, ERR_FORMAT, "coordinates are out of range");
        if (rc) {
            err_add(e, "point '%.60s'", p->point_names.list[i].name);
            return rc;
        }
        pt->id = i + 1;
        for (int k = 0; k < 3; k++)
            pt->rgb[k] = odm_byte(rgb[k]);
    }
    return ERR_OK;
}

/* The reconstruction with the most photographs. */
static enum err_code odm_parse_largest(const json_t *root, struct odm_parse *p, const json_t **out,
                                       struct err *e)
{
    size_t n = json_is_array(root) ? json_array_size(root) : 1, most = 0, all = 0;
    *out = NULL;
    for (size_t i = 0; i < n; i++) {
        const json_t *one = json_is_array(root) ? json_array_get(root, i) : root;
        const json_t *shots = json_object_get(one, "shots");
        if (!json_is_object(shots) || !json_is_object(json_object_get(one, "cameras")))
            return err_set(e, ERR_FORMAT,
                           "reconstruction %zu of %zu has no objects \"cameras\" and \"shots\": "
                           "is it OpenSfM's?",
                           i + 1, n);
        size_t size = json_object_size(shots);
        all += size;
        if (size > most) {
            most = size;
            *out = one;
        }
    }
    if (!*out)
        return err_set(e, ERR_DATA, "no photograph was placed");
    p->out->n_others = all - most;
    p->cameras = json_object_get(*out, "cameras");
    p->shots = json_object_get(*out, "shots");
    p->points = json_object_get(*out, "points");
    if (p->points && !json_is_object(p->points))
        return err_set(e, ERR_FORMAT, "\"points\" is no object");
    return ERR_OK;
}

/* ---- where it is on Earth ---- */

static enum err_code odm_reference_read(const json_t *o, struct geo_origin *out, struct err *e)
{
    enum err_code rc = jsonc_num(o, "latitude", &out->lat_deg, e);
    if (!rc)
        rc = jsonc_num(o, "longitude", &out->lon_deg, e);
    if (!rc)
        rc = jsonc_num(o, "altitude", &out->h_m, e);
    if (!rc && !(fabs(out->lat_deg) <= 90 && fabs(out->lon_deg) <= 180 && fabs(out->h_m) < 1e5))
        rc = err_set(e, ERR_FORMAT, "%g, %g, %g is no latitude, longitude and altitude",
                     out->lat_deg, out->lon_deg, out->h_m);
    if (rc)
        err_add(e, "reference_lla");
    return rc;
}

static enum err_code odm_places_of(struct odm_project *out, const struct geo_origin *o,
                                   struct err *e)
{
    for (size_t i = 0; i < out->model.n_images; i++) {
        const struct colmap_image *im = &out->model.images[i];
        struct odm_place *at = &out->places[i];
        struct camera c = {0};
        double center[3];
        camera_quat_to_rot(im->quat_wxyz, c.rot);
        memcpy(c.trans, im->trans, sizeof c.trans);
        camera_center(&c, center);
        enum err_code rc = geo_from_enu(o, center, &at->lon_deg, &at->lat_deg, &at->h_m, e);
        if (rc) {
            err_add(e, "photograph '%.200s'", im->name);
            return ERR_DATA;
        }
        at->known = true;
    }
    out->n_places = out->model.n_images;
    return ERR_OK;
}

/* ---- files ---- */

struct odm_files { /* FILE_PATH_MAX each; "": there is none */
    char project[FILE_PATH_MAX], poses[FILE_PATH_MAX], tracks[FILE_PATH_MAX],
        reference[FILE_PATH_MAX], shots[FILE_PATH_MAX], coords[FILE_PATH_MAX];
    bool is_shots, is_topocentric;
};

/* DIR/NAME into out where there is such a file; else "". */
static bool odm_find(const char *dir, const char *name, char out[FILE_PATH_MAX])
{
    if (file_join(out, dir, name, NULL) || !file_exists(out) || file_is_dir(out))
        *out = '\0';
    return *out;
}

static bool odm_ends(const char *text, const char *end)
{
    size_t n = strlen(text), k = strlen(end);
    return n >= k && !strcmp(text + n - k, end);
}

/* The folder of a path, "." where it has none. */
static enum err_code odm_folder_of(const char *path, char out[FILE_PATH_MAX], struct err *e)
{
    const char *slash = strrchr(path, '/');
    size_t n = slash ? (size_t)(slash - path) : 0;
    if (n >= FILE_PATH_MAX)
        return err_set(e, ERR_LIMIT, "%.100s...: the path is too long", path);
    memcpy(out, slash ? path : ".", slash ? n : 1);
    out[slash ? n : 1] = '\0';
    if (slash == path)
        memcpy(out, "/", 2);
    return ERR_OK;
}

/* Companions of the file with the poses. */
static enum err_code odm_files_beside(struct odm_files *f, struct err *e)
{
    char folder[FILE_PATH_MAX];
    f->is_shots = odm_ends(f->poses, ".geojson");
    f->is_topocentric = odm_ends(f->poses, ".topocentric.json");
    enum err_code rc = odm_folder_of(f->poses, folder, e);
    if (rc)
        return rc;
    odm_find(folder, "tracks.csv", f->tracks);
    odm_find(folder, "reference_lla.json", f->reference);
    if (odm_ends(folder, "opensfm") || odm_ends(folder, "odm_report")) {
        rc = odm_folder_of(folder, f->project, e);
        if (rc)
            return rc;
    } else {
        memcpy(f->project, folder, strlen(folder) + 1);
    }
    odm_find(f->project, "odm_report/shots.geojson", f->shots);
    odm_find(f->project, "odm_georeferencing/coords.txt", f->coords);
    return ERR_OK;
}

static enum err_code odm_files_find(const char *path, struct odm_files *f, struct err *e)
{
    static const char *const names[] = {"opensfm/reconstruction.topocentric.json",
                                        "opensfm/reconstruction.json",
                                        "reconstruction.topocentric.json",
                                        "reconstruction.json",
                                        "odm_report/shots.geojson",
                                        "shots.geojson"};
    if (!file_exists(path))
        return err_set(e, ERR_NOENT, "%s: no such project", path);
    if (!file_is_dir(path)) {
        if (strlen(path) >= sizeof f->poses)
            return err_set(e, ERR_LIMIT, "%.100s...: the path is too long", path);
        memcpy(f->poses, path, strlen(path) + 1);
        return odm_files_beside(f, e);
    }
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        if (odm_find(path, names[i], f->poses))
            return odm_files_beside(f, e);
    return err_set(e, ERR_NOENT,
                   "%s: no project of OpenDroneMap or OpenSfM: looked for reconstruction.json "
                   "there and in opensfm/, and for odm_report/shots.geojson",
                   path);
}

/* Its frame is known if it is topocentric, or if OpenDroneMap has not made UTM of it. */
static enum err_code odm_place(const struct odm_files *f, const json_t *one, struct odm_parse *p,
                               struct err *e)
{
    struct geo_origin origin;
    const json_t *reference = json_object_get(one, "reference_lla");
    json_t *file = NULL;
    enum err_code rc = ERR_OK;
    if (!f->is_topocentric && *f->coords)
        return *f->shots ? odm_shots_places(f->shots, &p->names, p->out, e) : ERR_OK;
    if (!reference && *f->reference)
        rc = jsonc_read(f->reference, &file, e);
    if (!rc && (reference || file)) {
        rc = odm_reference_read(reference ? reference : file, &origin, e);
        if (rc && file)
            err_add(e, "%s", f->reference);
        if (!rc)
            rc = odm_places_of(p->out, &origin, e);
    }
    json_decref(file);
    return rc;
}

static enum err_code odm_reconstruction(const struct odm_files *f, struct odm_project *out,
                                        struct err *e)
{
    struct odm_parse p = {.out = out};
    const json_t *one = NULL;
    json_t *root = NULL;
    enum err_code rc = jsonc_read(f->poses, &root, e);
    if (rc)
        return rc;
    rc = odm_parse_largest(root, &p, &one, e);
    if (!rc)
        rc = odm_parse_shots(&p, e);
    if (!rc && p.points)
        rc = odm_parse_points(&p, e);
    if (rc)
        err_add(e, "%s", f->poses);
    if (!rc)
        rc = odm_place(f, one, &p, e);
    if (!rc)
        rc = odm_tracks_link(*f->tracks ? f->tracks : NULL, &p.names, &p.point_names, out, e);
    json_decref(root);
    return rc;
}

enum err_code odm_read(const char *path, struct odm_project *out, struct err *e)
{
    struct odm_files *f = mem_array(1, sizeof *f);
    *out = (struct odm_project){0};
    if (!f)
        return odm_read_no_memory(e);
    enum err_code rc = odm_files_find(path, f, e);
    if (!rc)
        rc = f->is_shots ? odm_shots_read(f->poses, f->project, out, e)
                         : odm_reconstruction(f, out, e);
    memcpy(out->from, f->poses, sizeof out->from);
    memcpy(out->project, f->project, sizeof out->project);
    if (rc)
        odm_free(out);
    mem_free(f);
    return rc;
}
