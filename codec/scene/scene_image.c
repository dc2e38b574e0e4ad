/* Readers and writers of a photograph's fields; see scene_image.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/scene/scene_image.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/splat/exposure.h"

/* How a type of field is read into a member and written from it. A writer returns NULL for what
 * JSON cannot hold. An optional field is left out of the file while `absent` holds. */
struct scene_image_type {
    enum err_code (*read)(const json_t *o, const char *key, void *member, struct arena *a,
                          struct err *e);
    json_t *(*write)(const void *member);
    bool (*absent)(const void *member);
};

json_t *scene_image_numbers(const double *v, size_t n)
{
    json_t *a = json_array();
    for (size_t i = 0; a && i < n; i++)
        if (json_array_append_new(a, json_real(v[i]))) {
            json_decref(a);
            a = NULL;
        }
    return a;
}

/* ---- names, splits, counts ---- */

/* A plain file name: what is joined to images/ must stay in there. */
static bool scene_image_name_is_plain(const char *s)
{
    return s[0] && !strchr(s, '/') && strcmp(s, ".") && strcmp(s, "..");
}

static enum err_code scene_image_read_name(const json_t *o, const char *key, void *member,
                                           struct arena *a, struct err *e)
{
    char **out = member;
    const char *name;
    enum err_code rc = jsonc_text(o, key, &name, e);
    if (!rc && !scene_image_name_is_plain(name))
        rc = err_set(e, ERR_FORMAT, "%s '%.100s' is not a plain file name", key, name);
    if (!rc && !(*out = arena_text(a, name)))
        rc = err_set(e, ERR_MEM, "out of memory");
    return rc;
}

static json_t *scene_image_write_name(const void *member)
{
    char *const *name = member;
    return json_string(*name);
}

static enum err_code scene_image_read_split(const json_t *o, const char *key, void *member,
                                            struct arena *a, struct err *e)
{
    enum scene_split *out = member;
    const char *split;
    (void)a;
    enum err_code rc = jsonc_text(o, key, &split, e);
    if (!rc && strcmp(split, "train") && strcmp(split, "test"))
        rc = err_set(e, ERR_FORMAT, "%s: expected train or test", key);
    if (!rc)
        *out = strcmp(split, "test") ? SCENE_TRAIN : SCENE_TEST;
    return rc;
}

static json_t *scene_image_write_split(const void *member)
{
    const enum scene_split *split = member;
    return json_string(*split == SCENE_TEST ? "test" : "train");
}

static enum err_code scene_image_read_count(const json_t *o, const char *key, void *member,
                                            struct arena *a, struct err *e)
{
    uint32_t *out = member;
    double v;
    (void)a;
    enum err_code rc = jsonc_num(o, key, &v, e);
    if (!rc && !(v >= 0 && v <= UINT32_MAX && v == floor(v)))
        rc = err_set(e, ERR_FORMAT, "%s: expected a whole number", key);
    if (!rc)
        *out = (uint32_t)v;
    return rc;
}

static json_t *scene_image_write_count(const void *member)
{
    const uint32_t *v = member;
    return json_integer((json_int_t)*v);
}

/* ---- cameras ---- */

static enum err_code scene_image_read_camera(const json_t *o, const char *key, void *member,
                                             struct arena *a, struct err *e)
{
    (void)a;
    return camera_from_json(json_object_get(o, key), member, e);
}

static json_t *scene_image_write_camera(const void *member)
{
    const struct camera *c = member;
    double m[16] = {0};
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++)
            m[4 * i + j] = c->rot[3 * i + j];
        m[4 * i + 3] = c->trans[i];
    }
    m[15] = 1;
    return json_pack("{s:I, s:I, s:f, s:f, s:f, s:f, s:o}", "width", (json_int_t)c->width_px,
                     "height", (json_int_t)c->height_px, "fx", c->fx_px, "fy", c->fy_px, "cx",
                     c->cx_px, "cy", c->cy_px, "world_to_camera", scene_image_numbers(m, 16));
}

/* ---- numbers, which are null where they are not known ---- */

static enum err_code scene_image_read_place(const json_t *o, const char *key, void *member,
                                            struct arena *a, struct err *e)
{
    double *out = member;
    const json_t *v = json_object_get(o, key);
    (void)a;
    if (v && !json_is_null(v))
        return jsonc_nums(o, key, 3, out, e);
    out[0] = out[1] = out[2] = (double)NAN;
    return ERR_OK;
}

static json_t *scene_image_write_place(const void *member)
{
    const double *v = member;
    return isfinite(v[0]) ? scene_image_numbers(v, 3) : json_null();
}

static enum err_code scene_image_read_number(const json_t *o, const char *key, void *member,
                                             struct arena *a, struct err *e)
{
    double *out = member;
    const json_t *v = json_object_get(o, key);
    (void)a;
    if (v && !json_is_null(v))
        return jsonc_num(o, key, out, e);
    *out = (double)NAN;
    return ERR_OK;
}

static json_t *scene_image_write_number(const void *member)
{
    return jsonc_real(*(const double *)member);
}

/* ---- what is left out where it is not known ---- */

static enum err_code scene_image_read_stops(const json_t *o, const char *key, void *member,
                                            struct arena *a, struct err *e)
{
    float *out = member;
    double ev[3] = {0.0};
    (void)a;
    if (!json_object_get(o, key))
        return ERR_OK;
    enum err_code rc = jsonc_nums(o, key, 3, ev, e);
    for (size_t k = 0; !rc && k < 3; k++) {
        if (!(fabs(ev[k]) <= (double)EXPOSURE_EV_MAX))
            rc = err_set(e, ERR_FORMAT, "%s: %g stops, expected -%g to %g", key, ev[k],
                         (double)EXPOSURE_EV_MAX, (double)EXPOSURE_EV_MAX);
        out[k] = (float)ev[k];
    }
    return rc;
}

static json_t *scene_image_write_stops(const void *member)
{
    const float *v = member;
    const double ev[3] = {(double)v[0], (double)v[1], (double)v[2]};
    return scene_image_numbers(ev, 3);
}

static bool scene_image_no_stops(const void *member)
{
    return exposure_is_mean(member);
}

/* The digits of a text where a pattern has 0, its other characters as they are; from the pattern's
 * point of view a bad text ends it. */
static bool scene_image_time_like(const char *text, const char *pattern)
{
    for (; *pattern; text++, pattern++)
        if (*pattern == '0' ? *text < '0' || *text > '9' : *text != *pattern)
            return false;
    return !*text;
}

void scene_time(const char *exif, char out[SCENE_TIME_MAX])
{
    out[0] = '\0';
    if (!scene_image_time_like(exif, "0000:00:00 00:00:00") || !strncmp(exif, "0000", 4))
        return;
    snprintf(out, SCENE_TIME_MAX, "%.4s-%.2s-%.2sT%.8s", exif, exif + 5, exif + 8, exif + 11);
}

static enum err_code scene_image_read_time(const json_t *o, const char *key, void *member,
                                           struct arena *a, struct err *e)
{
    const char *time = json_string_value(json_object_get(o, key));
    (void)a;
    if (time && scene_image_time_like(time, "0000-00-00T00:00:00"))
        memcpy(member, time, SCENE_TIME_MAX);
    else if (json_object_get(o, key))
        return err_set(e, ERR_FORMAT, "%s: expected YYYY-MM-DDThh:mm:ss", key);
    return ERR_OK;
}

static json_t *scene_image_write_time(const void *member)
{
    return json_string(member);
}

static bool scene_image_no_time(const void *member)
{
    const char *time = member;
    return !time[0];
}

/* ---- all fields ---- */

enum {
    SCENE_IMAGE_NAME,
    SCENE_IMAGE_SPLIT,
    SCENE_IMAGE_COUNT,
    SCENE_IMAGE_CAMERA,
    SCENE_IMAGE_PLACE,
    SCENE_IMAGE_NUMBER,
    SCENE_IMAGE_STOPS,
    SCENE_IMAGE_TIME
};
static const struct scene_image_type scene_image_types[] = {
    [SCENE_IMAGE_NAME] = {scene_image_read_name, scene_image_write_name, NULL},
    [SCENE_IMAGE_SPLIT] = {scene_image_read_split, scene_image_write_split, NULL},
    [SCENE_IMAGE_COUNT] = {scene_image_read_count, scene_image_write_count, NULL},
    [SCENE_IMAGE_CAMERA] = {scene_image_read_camera, scene_image_write_camera, NULL},
    [SCENE_IMAGE_PLACE] = {scene_image_read_place, scene_image_write_place, NULL},
    [SCENE_IMAGE_NUMBER] = {scene_image_read_number, scene_image_write_number, NULL},
    [SCENE_IMAGE_STOPS] = {scene_image_read_stops, scene_image_write_stops, scene_image_no_stops},
    [SCENE_IMAGE_TIME] = {scene_image_read_time, scene_image_write_time, scene_image_no_time},
};
static const struct scene_image_field {
    const char *key;
    size_t offset;
    const struct scene_image_type *type;
} scene_image_fields[] = {
#define FIELD(type, member, key, unit, what)                                                       \
    {key, offsetof(struct scene_image, member), &scene_image_types[SCENE_IMAGE_##type]},
#include "codec/scene/scene_image.def"
#undef FIELD
};
enum { SCENE_IMAGE_FIELDS = sizeof scene_image_fields / sizeof *scene_image_fields };

json_t *scene_image_to_json(const struct scene_image *im)
{
    json_t *o = json_object();
    for (size_t i = 0; o && i < SCENE_IMAGE_FIELDS; i++) {
        const struct scene_image_field *f = &scene_image_fields[i];
        const void *member = (const char *)im + f->offset;
        if (f->type->absent && f->type->absent(member))
            continue;
        if (json_object_set_new(o, f->key, f->type->write(member))) {
            json_decref(o);
            o = NULL;
        }
    }
    return o;
}

enum err_code scene_image_from_json(const json_t *o, struct scene_image *im, struct arena *a,
                                    struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < SCENE_IMAGE_FIELDS; i++) {
        const struct scene_image_field *f = &scene_image_fields[i];
        rc = f->type->read(o, f->key, (char *)im + f->offset, a, e);
    }
    return rc;
}
