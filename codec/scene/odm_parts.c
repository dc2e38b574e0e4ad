/* Names, lenses and poses of OpenSfM's files: see odm_parts.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/scene/odm_parts.h"

#include <jansson.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { ODM_EDGE_MAX_PX = 1 << 20, ODM_NAME_MAX = 1024 };
static const double odm_focal_max = 100;   /* larger sides of a picture */
static const double odm_turn_max_rad = 64; /* an angle beyond is no angle */

static enum err_code odm_no_memory(struct err *e)
{
    return err_set(e, ERR_MEM, "out of memory");
}

/* ---- names ---- */

static int odm_key_compare(const void *a, const void *b)
{
    const struct odm_key *p = a, *q = b;
    return strcmp(p->name, q->name);
}

void odm_keys_sort(struct odm_keys *k)
{
    qsort(k->list, k->n, sizeof *k->list, odm_key_compare);
}

uint32_t odm_keys_find(const struct odm_keys *k, const char *name)
{
    const struct odm_key want = {name, 0};
    const struct odm_key *at =
        k->n ? bsearch(&want, k->list, k->n, sizeof *k->list, odm_key_compare) : NULL;
    return at ? at->index : UINT32_MAX;
}

enum err_code odm_keys_of(const json_t *object, struct arena *a, struct odm_keys *out,
                          struct err *e)
{
    const char *name;
    json_t *value;
    size_t n = 0;
    out->n = json_object_size(object);
    if (out->n >= UINT32_MAX)
        return err_set(e, ERR_LIMIT, "%zu members are too many", out->n);
    out->list = arena_get(a, out->n, sizeof *out->list);
    if (!out->list)
        return odm_no_memory(e);
    json_object_foreach((json_t *)(uintptr_t)object, name, value) out->list[n++].name = name;
    odm_keys_sort(out);
    for (size_t i = 0; i < n; i++)
        out->list[i].index = (uint32_t)i;
    return ERR_OK;
}

/* ---- cameras ---- */

/* A number that may be left out, then 0. */
static enum err_code odm_number(const json_t *o, const char *key, double *out, struct err *e)
{
    *out = 0;
    enum err_code rc = json_object_get(o, key) ? jsonc_num(o, key, out, e) : ERR_OK;
    return rc || fabs(*out) <= odm_far
               ? rc
               : err_set(e, ERR_FORMAT, "\"%s\": %g is too large", key, *out);
}

static enum err_code odm_edge(const json_t *o, const char *key, uint32_t *out, struct err *e)
{
    double v;
    enum err_code rc = jsonc_num(o, key, &v, e);
    if (rc)
        return rc;
    if (!(v >= 1 && v <= ODM_EDGE_MAX_PX && floor(v) == v))
        return err_set(e, ERR_FORMAT, "\"%s\": %g is no number of pixels", key, v);
    *out = (uint32_t)v;
    return ERR_OK;
}

/* Focal lengths in larger sides: one, or one for each axis. */
static enum err_code odm_focals(const json_t *o, bool two, double f[2], struct err *e)
{
    enum err_code rc = jsonc_num(o, two ? "focal_x" : "focal", &f[0], e);
    f[1] = f[0];
    if (!rc && two)
        rc = jsonc_num(o, "focal_y", &f[1], e);
    if (!rc && !(f[0] > 0 && f[0] < odm_focal_max && f[1] > 0 && f[1] < odm_focal_max))
        rc = err_set(e, ERR_FORMAT, "a focal length of %g x %g larger sides of the picture", f[0],
                     f[1]);
    return rc;
}

/* OpenSfM's models, COLMAP's with the same formula, and the coefficients in COLMAP's order. */
static const struct odm_model {
    const char *name;
    enum lens_model lens;
    bool two; /* focal lengths, and a principal point */
    const char *terms[8];
} odm_models[] = {
    {"perspective", LENS_RADIAL, false, {"k1", "k2"}},
    {"simple_radial", LENS_OPENCV, true, {"k1", "", "", ""}},
    {"radial", LENS_OPENCV, true, {"k1", "k2", "", ""}},
    {"brown", LENS_FULL_OPENCV, true, {"k1", "k2", "p1", "p2", "k3", "", "", ""}},
    {"fisheye", LENS_RADIAL_FISHEYE, false, {"k1", "k2"}},
    {"fisheye_opencv", LENS_OPENCV_FISHEYE, true, {"k1", "k2", "k3", "k4"}},
};

static enum err_code odm_lens_fill(const struct odm_model *model, const json_t *o, struct lens *out,
                                   struct err *e)
{
    double f[2], c[2] = {0, 0}, *p = out->params;
    out->model = model->lens;
    enum err_code rc = odm_edge(o, "width", &out->width_px, e);
    if (!rc)
        rc = odm_edge(o, "height", &out->height_px, e);
    if (!rc)
        rc = odm_focals(o, model->two, f, e);
    if (!rc && model->two)
        rc = odm_number(o, "c_x", &c[0], e);
    if (!rc && model->two)
        rc = odm_number(o, "c_y", &c[1], e);
    if (rc)
        return rc;
    double side = out->width_px > out->height_px ? out->width_px : out->height_px;
    *p++ = side * f[0];
    if (model->two)
        *p++ = side * f[1];
    *p++ = 0.5 * out->width_px + side * c[0];
    *p++ = 0.5 * out->height_px + side * c[1];
    for (size_t i = 0; !rc && i < 8 && model->terms[i]; i++, p++)
        if (*model->terms[i])
            rc = odm_number(o, model->terms[i], p, e);
    return rc;
}

enum err_code odm_lens(const char *id, const json_t *camera, struct lens *out, struct err *e)
{
    const json_t *type = json_object_get(camera, "projection_type");
    const char *name = type ? json_string_value(type) : "perspective";
    *out = (struct lens){0};
    if (!json_is_object(camera) || !name)
        return err_set(e, ERR_FORMAT, "camera '%.100s': an object with projection_type is expected",
                       id);
    for (size_t i = 0; i < sizeof odm_models / sizeof *odm_models; i++) {
        if (strcmp(name, odm_models[i].name) != 0)
            continue;
        enum err_code rc = odm_lens_fill(&odm_models[i], camera, out, e);
        if (rc)
            err_add(e, "camera '%.100s'", id);
        return rc;
    }
    return err_set(e, ERR_DATA,
                   "camera '%.100s' is of the type %.40s, for which COLMAP has no model: of "
                   "OpenSfM's types perspective, simple_radial, radial, brown, fisheye and "
                   "fisheye_opencv can be taken",
                   id, name);
}

/* ---- poses ---- */

static void odm_turn(const double axis_rad[3], double quat_wxyz[4])
{
    double angle =
        sqrt(axis_rad[0] * axis_rad[0] + axis_rad[1] * axis_rad[1] + axis_rad[2] * axis_rad[2]);
    /* sin(angle / 2) / angle, also where that is 0 / 0 */
    double s = angle > 1e-6 ? sin(0.5 * angle) / angle : 0.5 - angle * angle / 48;
    quat_wxyz[0] = cos(0.5 * angle);
    for (int i = 0; i < 3; i++)
        quat_wxyz[1 + i] = s * axis_rad[i];
}

/* Positions are written as lines of fields with tabs between. */
static bool odm_name_is_plain(const char *name)
{
    size_t n = strlen(name);
    for (const char *p = name; *p; p++)
        if ((unsigned char)*p < ' ' || *p == 0x7f)
            return false;
    return n && n < ODM_NAME_MAX;
}

enum err_code odm_image_set(struct colmap_model *m, size_t i, const char *name, const json_t *pose,
                            struct err *e)
{
    struct colmap_image *im = &m->images[i];
    double turn[3];
    if (!odm_name_is_plain(name))
        return err_set(e, ERR_FORMAT,
                       "photograph %zu has no name, one of over %d bytes, or one with control "
                       "characters",
                       i + 1, ODM_NAME_MAX - 1);
    enum err_code rc = jsonc_nums(pose, "rotation", 3, turn, e);
    if (!rc)
        rc = jsonc_nums(pose, "translation", 3, im->trans, e);
    for (int k = 0; !rc && k < 3; k++)
        if (!(fabs(turn[k]) <= odm_turn_max_rad) || !(fabs(im->trans[k]) <= odm_far))
            rc = err_set(e, ERR_FORMAT,
                         "rotation or translation is out of range: expected are radians and "
                         "metres");
    if (rc) {
        err_add(e, "photograph '%.200s'", name);
        return rc;
    }
    odm_turn(turn, im->quat_wxyz);
    im->id = (uint32_t)(i + 1);
    im->name = arena_text(&m->arena, name);
    return im->name ? ERR_OK : odm_no_memory(e);
}
