/* The parser of posted cameras: see posted_view.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answers/posted_view.h"

#include <jansson.h>
#include <math.h>
#include <string.h>

#include "core/geo/geo.h"
#include "lod/choose/view.h"
#include "render/supersample.h"
#include "server/drawing/composite.h"
#include "server/route/param.h"

/* An optional whole number in [lo, hi]; `what` was *out already. */
static enum err_code posted_view_read_int(const json_t *o, const char *key, json_int_t lo,
                                          json_int_t hi, json_int_t *out, struct err *e)
{
    const json_t *v = json_object_get(o, key);
    if (!v)
        return ERR_OK;
    if (!json_is_integer(v) || json_integer_value(v) < lo || json_integer_value(v) > hi)
        return err_set(e, ERR_DATA, "%s must be a whole number, %lld to %lld", key, (long long)lo,
                       (long long)hi);
    *out = json_integer_value(v);
    return ERR_OK;
}

static enum err_code posted_view_read_pose(const json_t *o, struct view_pose *out, double *roll_deg,
                                           struct err *e)
{
    static const char *const keys[] = {"lon",   "lat", "height", "heading",
                                       "pitch", "fov", "roll",   NULL};
    double *const fields[] = {&out->lon_deg,   &out->lat_deg,   &out->h_m, &out->heading_deg,
                              &out->pitch_deg, &out->fov_y_deg, roll_deg};
    static const double limit[] = {180, 90, 2e6, 360, 90, 150, 360};
    out->fov_y_deg = 60;
    if (!json_is_object(o))
        return err_set(e, ERR_DATA, "pose must be an object with lon, lat, height, heading, pitch");
    enum err_code rc = jsonc_known(o, keys, "pose", e);
    for (int i = 0; i < 7 && !rc; i++) {
        const json_t *v = json_object_get(o, keys[i]);
        if (!v && i >= 5)
            continue;
        if (!json_is_number(v) || !(fabs(json_number_value(v)) <= limit[i]))
            return err_set(e, ERR_DATA, "pose.%s must be a number, at most %g either way", keys[i],
                           limit[i]);
        *fields[i] = json_number_value(v);
    }
    if (!rc && out->fov_y_deg < 1)
        return err_set(e, ERR_DATA, "pose.fov must be 1 to 150 degrees");
    return rc;
}

static enum err_code posted_view_read_format(const json_t *o, enum format *out, struct err *e)
{
    const json_t *v = json_object_get(o, "format");
    *out = FORMAT_JPG;
    for (int f = FORMAT_JPG; v && f <= FORMAT_NPY; f++)
        if (json_is_string(v) && !strcmp(json_string_value(v), format_ext((enum format)f))) {
            *out = (enum format)f;
            return ERR_OK;
        }
    return v ? err_set(e, ERR_DATA, "format must be jpg, png, webp or npy") : ERR_OK;
}

/* Numbers that are finite, and yet no camera: focal lengths beyond 0.06 to 180 degrees, a principal
 * point far outside the picture, a place further away than the Moon. */
static enum err_code posted_view_check_camera(const struct camera *c, struct err *e)
{
    const double size[2] = {c->width_px, c->height_px}, f[2] = {c->fx_px, c->fy_px},
                 at[2] = {c->cx_px, c->cy_px};
    for (int i = 0; i < 2; i++) {
        if (!(f[i] >= 1e-2 * size[i] && f[i] <= 1e3 * size[i]))
            return err_set(e, ERR_DATA, "camera.%s must be 0.01 to 1000 times the %s",
                           i ? "fy" : "fx", i ? "height" : "width");
        if (!(at[i] >= -10 * size[i] && at[i] <= 11 * size[i]))
            return err_set(e, ERR_DATA, "camera.%s lies far outside the picture", i ? "cy" : "cx");
    }
    for (int i = 0; i < 3; i++)
        if (!(fabs(c->trans[i]) <= 4e8))
            return err_set(e, ERR_DATA,
                           "camera.world_to_camera: the camera is further away than 4e8 m");
    return ERR_OK;
}

static enum err_code posted_view_read_camera(const struct server_config *cfg,
                                             const struct geo_origin *origin, const json_t *o,
                                             struct camera *out, struct err *e)
{
    const json_t *camera = json_object_get(o, "camera"), *pose = json_object_get(o, "pose");
    json_int_t width = 0, height = 0;
    if (!camera == !pose)
        return err_set(e, ERR_DATA, "give a camera or a pose, one of the two");
    if (camera && !json_is_object(camera))
        return err_set(e, ERR_DATA, "camera must be an object");
    if (camera && !camera_from_json(camera, out, e))
        return posted_view_check_camera(out, e);
    if (camera)
        return err_add(e, "camera"), ERR_DATA;
    struct view_pose at = {0};
    double roll_deg = 0;
    enum err_code rc = posted_view_read_int(o, "width", 1, cfg->max_view_px, &width, e);
    if (!rc)
        rc = posted_view_read_int(o, "height", 1, cfg->max_view_px, &height, e);
    if (!rc && (!width || !height))
        rc = err_set(e, ERR_DATA, "a pose needs width and height, in pixels");
    if (!rc)
        rc = posted_view_read_pose(pose, &at, &roll_deg, e);
    if (rc)
        return rc;
    if (view_camera(origin, &at, (uint32_t)width, (uint32_t)height, out, e))
        return ERR_DATA;
    composite_roll(out, roll_deg);
    return ERR_OK;
}

static enum err_code posted_view_read_paint(const json_t *o, enum format f, struct composite *out,
                                            struct err *e)
{
    const json_t *background = json_object_get(o, "background"),
                 *depth = json_object_get(o, "depth");
    if (background &&
        !(json_is_string(background) && param_read_background(json_string_value(background),
                                                              json_string_length(background), out)))
        return err_set(e, ERR_DATA, "background must be RRGGBB, sky or transparent");
    if (depth && !(json_is_string(depth) &&
                   composite_read_depth(json_string_value(depth), json_string_length(depth), out)))
        return err_set(e, ERR_DATA, "depth must be mm, cm, dm or m: the unit");
    return composite_check(out, f, e);
}

static enum err_code posted_view_read_appearance(const json_t *o, char out[TARGET_APPEARANCE_MAX],
                                                 struct err *e)
{
    const json_t *v = json_object_get(o, "appearance");
    if (!v)
        return ERR_OK;
    if (!json_is_string(v) || json_string_length(v) >= TARGET_APPEARANCE_MAX)
        return err_set(e, ERR_DATA, "appearance must be a string of at most %d bytes",
                       TARGET_APPEARANCE_MAX - 1);
    strcpy(out, json_string_value(v));
    return ERR_OK;
}

static enum err_code posted_view_stream_keys(const json_t *o, struct posted_view *out,
                                             struct err *e)
{
    const json_t *still = json_object_get(o, "still"), *key = json_object_get(o, "key");
    json_int_t number = 0;
    if ((still && !json_is_boolean(still)) || (key && !json_is_boolean(key)))
        return err_set(e, ERR_DATA, "still and key must be true or false");
    enum err_code rc = posted_view_read_int(o, "number", 0, INT32_MAX, &number, e);
    out->number = number;
    out->still = json_is_true(still);
    out->key = json_is_true(key);
    return rc;
}

/* The keys of a stream are known where it is one. */
static enum err_code posted_view_read_wish(const struct server_config *cfg,
                                           const struct geo_origin *origin, const void *text,
                                           size_t n, bool stream, struct posted_view *out,
                                           struct err *e)
{
    static const char *const keys[] = {"camera",      "pose",       "width",       "height",
                                       "format",      "quality",    "background",  "depth",
                                       "deadline_ms", "appearance", "supersample", NULL};
    static const char *const stream_keys[] = {"camera",      "pose",        "width",      "height",
                                              "format",      "quality",     "background", "depth",
                                              "deadline_ms", "appearance",  "number",     "still",
                                              "key",         "supersample", NULL};
    json_t *o = NULL;
    json_int_t quality = cfg->quality, deadline_ms = (json_int_t)(cfg->deadline_s * 1000);
    json_int_t supersample = 0;
    memset(out, 0, sizeof *out);
    enum err_code rc =
        n ? jsonc_parse(text, n, "body", &o, e)
          : err_set(e, ERR_FORMAT, "the body must be a JSON object with a camera or a pose");
    if (!rc && !json_is_object(o))
        rc = err_set(e, ERR_FORMAT, "the body must be a JSON object with a camera or a pose");
    if (!rc)
        rc = jsonc_known(o, stream ? stream_keys : keys, "the body", e);
    if (!rc && stream)
        rc = posted_view_stream_keys(o, out, e);
    if (!rc)
        rc = posted_view_read_camera(cfg, origin, o, &out->cam, e);
    if (!rc)
        rc = posted_view_read_format(o, &out->format, e);
    if (!rc)
        rc = posted_view_read_int(o, "quality", 1, 100, &quality, e);
    if (!rc)
        rc = posted_view_read_int(o, "deadline_ms", 50, deadline_ms, &deadline_ms, e);
    if (!rc)
        rc = posted_view_read_appearance(o, out->appearance, e);
    if (!rc)
        rc = posted_view_read_int(o, "supersample", 1, SUPERSAMPLE_MOST, &supersample, e);
    if (!rc)
        rc = posted_view_read_paint(o, out->format, &out->composite, e);
    out->composite.supersample = (uint32_t)supersample;
    out->quality = (int)quality;
    out->timeout_s = (double)deadline_ms / 1000;
    json_decref(o);
    return rc;
}

enum err_code posted_view_read(const struct server_config *cfg, const struct geo_origin *origin,
                               const void *text, size_t n, struct posted_view *out, struct err *e)
{
    return posted_view_read_wish(cfg, origin, text, n, false, out, e);
}

enum err_code posted_view_read_stream(const struct server_config *cfg,
                                      const struct geo_origin *origin, const void *text, size_t n,
                                      struct posted_view *out, struct err *e)
{
    return posted_view_read_wish(cfg, origin, text, n, true, out, e);
}
