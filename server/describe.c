/* The JSON documents that describe the service: landing page, conformance, OpenAPI (made from the
 * route list, so it cannot drift from it), and the posted camera in the other direction.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/describe.h"

#include <jansson.h>
#include <math.h>
#include <string.h>

#include "core/geo.h"
#include "lod/view.h"
#include "server/document.h"

enum err_code describe_landing(struct body **out, struct err *e)
{
    json_t *o = json_pack(
        "{s:s,s:s,s:[o,o,o,o]}", "title", "citysplat", "description",
        "Cities of 3D Gaussians, in tiles and in pictures", "links",
        document_link("self", "application/json", "./", "This document"),
        document_link("service-desc", "application/vnd.oai.openapi+json;version=3.0", "api",
                      "OpenAPI description"),
        document_link("conformance", "application/json", "conformance", "Conformance classes"),
        document_link("data", "application/json", "collections", "Datasets"));
    return document_make(o, out, e);
}

enum err_code describe_conformance(struct body **out, struct err *e)
{
    static const char *const classes[] = {
        "http://www.opengis.net/spec/ogcapi-common-1/1.0/conf/core",
        "http://www.opengis.net/spec/ogcapi-common-1/1.0/conf/landing-page",
        "http://www.opengis.net/spec/ogcapi-common-1/1.0/conf/json",
        "http://www.opengis.net/spec/ogcapi-common-1/1.0/conf/oas30",
        "http://www.opengis.net/spec/ogcapi-common-2/1.0/conf/collections",
        "http://www.opengis.net/spec/ogcapi-common-2/1.0/conf/json",
        "https://www.opengis.net/spec/ogcapi-geovolumes-1/1.0/conf/core",
        "https://www.opengis.net/spec/ogcapi-geovolumes-1/1.0/conf/3d-tiles",
    };
    json_t *list = json_array();
    for (size_t i = 0; i < sizeof classes / sizeof *classes; i++)
        json_array_append_new(list, json_string(classes[i]));
    return document_make(json_pack("{s:o}", "conformsTo", list), out, e);
}

/* ---- OpenAPI ---- */

/* The {names} of a path template as required string parameters. */
static json_t *describe_path_parameters(const char *path)
{
    json_t *list = json_array();
    for (const char *p = strchr(path, '{'); p; p = strchr(p + 1, '{')) {
        size_t n = strcspn(p + 1, "}");
        json_array_append_new(list, json_pack("{s:s%,s:s,s:b,s:{s:s}}", "name", p + 1, n, "in",
                                              "path", "required", 1, "schema", "type", "string"));
    }
    return list;
}

static json_t *describe_query_parameter(const char *name, const char *about)
{
    return json_pack("{s:s,s:s,s:s,s:{s:s}}", "name", name, "in", "query", "description", about,
                     "schema", "type", "string");
}

static json_t *describe_render_body(void)
{
    return json_pack(
        "{s:b,s:{s:{s:{s:s,s:{s:{s:s,s:s},s:{s:s,s:s},s:{s:s},s:{s:s},s:{s:s},s:{s:s},s:{s:s},s:{s:"
        "s}}}}}}",
        "required", 1, "content", "application/json", "schema", "type", "object", "properties",
        "camera", "type", "object", "description",
        "width, height, fx, fy, cx, cy in pixels and world_to_camera, 16 numbers row-major, "
        "from east-north-up metres about the dataset's origin to x right, y down, z forward",
        "pose", "type", "object", "description",
        "instead of camera: lon, lat, height (ellipsoidal metres), heading, pitch, fov (degrees)",
        "width", "type", "integer", "height", "type", "integer", "format", "type", "string",
        "quality", "type", "integer", "deadline_ms", "type", "integer", "appearance", "type",
        "string");
}

/* What is posted to a question: the members, in words. */
static json_t *describe_query_body(enum route r)
{
    static const struct {
        enum route route;
        const char *about;
    } bodies[] = {
        {ROUTE_HEIGHT, "places: up to 256 [longitude, latitude]; gsd_m"},
        {ROUTE_PICK, "camera, or pose with width and height, as of /render; x, y in pixels"},
        {ROUTE_PROFILE, "line: 2 to 256 [longitude, latitude]; step_m"},
        {ROUTE_MEASURE, "line, or polygon with base (rim, or a height in metres) and gsd_m"},
        {ROUTE_VISIBLE, "from, to: lon, lat, and height (ellipsoidal) or above (the surface)"}};
    const char *about = "";
    for (size_t i = 0; i < sizeof bodies / sizeof *bodies; i++)
        if (bodies[i].route == r)
            about = bodies[i].about;
    return json_pack("{s:b,s:{s:{s:{s:s,s:s}}}}", "required", 1, "content", "application/json",
                     "schema", "type", "object", "description", about);
}

static json_t *describe_operation(enum route r, unsigned allow, const char *name,
                                  const char *summary)
{
    json_t *o = json_pack("{s:s,s:s,s:o,s:{s:{s:s},s:{s:s}}}", "operationId", name, "summary",
                          summary, "parameters", describe_path_parameters(target_path(r)),
                          "responses", "200", "description", "The resource", "default",
                          "description", "A problem document, RFC 9457");
    json_t *parameters = json_object_get(o, "parameters");
    if (r == ROUTE_SEED) {
        json_array_append_new(parameters,
                              describe_query_parameter("bbox", "west,south,east,north in degrees"));
        json_array_append_new(parameters,
                              describe_query_parameter("z", "a zoom, or two as in 12-16"));
        json_array_append_new(parameters, describe_query_parameter(
                                              "f", "tile format: glb, spz, drc, ply, plain.glb"));
    }
    if (r == ROUTE_SEED || r == ROUTE_TILE || r == ROUTE_TILE_MOVING || r == ROUTE_TILESET ||
        r == ROUTE_TILESET_MOVING) {
        json_array_append_new(parameters, describe_query_parameter(
                                              "preset", "of glb, spz, drc: " QUANT_PRESET_NAMES));
        json_array_append_new(parameters,
                              describe_query_parameter("sh", "degree of harmonics, 0 to 3"));
    }
    static const enum route with_appearance[] = {
        ROUTE_SEED,    ROUTE_TILE,        ROUTE_TILE_MOVING, ROUTE_TILESET, ROUTE_TILESET_MOVING,
        ROUTE_VIEW,    ROUTE_VIEW_MOVING, ROUTE_APPEARANCE,  ROUTE_MAP,     ROUTE_MAP_MOVING,
        ROUTE_MAPJSON, ROUTE_WMTS};
    for (size_t i = 0; i < sizeof with_appearance / sizeof *with_appearance; i++)
        if (r == with_appearance[i])
            json_array_append_new(
                parameters, describe_query_parameter(
                                "appearance", "a photograph, NAME:WEIGHT,NAME:WEIGHT, or =BASE64 "
                                              "of an embedding"));
    if (r == ROUTE_TERRAIN || r == ROUTE_TERRAIN_MOVING || r == ROUTE_TERRAINJSON)
        json_array_append_new(parameters,
                              describe_query_parameter("encoding", "mapbox or terrarium"));
    if (r == ROUTE_HEIGHT && allow == ALLOW_READ) {
        json_array_append_new(parameters, describe_query_parameter("lon", "longitude, degrees"));
        json_array_append_new(parameters, describe_query_parameter("lat", "latitude, degrees"));
    } else if (r >= ROUTE_HEIGHT && r <= ROUTE_VISIBLE) {
        json_object_set_new(o, "requestBody", describe_query_body(r));
        if (r == ROUTE_HEIGHT) /* operations have names of their own */
            json_object_set_new(o, "operationId", json_string("HEIGHT_POST"));
    }
    if (r == ROUTE_RENDER)
        json_object_set_new(o, "requestBody", describe_render_body());
    return o;
}

enum err_code describe_api(struct body **out, struct err *e)
{
    static const struct {
        const char *name, *summary;
    } names[] = {
#define ROUTE_NAME(id, allow, path, summary) {#id, summary},
        ROUTE_LIST(ROUTE_NAME)
#undef ROUTE_NAME
    };
    json_t *paths = json_object();
    for (int r = 0; r < ROUTE_NONE; r++) {
        if (r == ROUTE_STATIC)
            continue;
        json_t *verbs = json_object();
        static const struct {
            unsigned allow;
            const char *name;
        } known[] = {{ALLOW_READ, "get"}, {ALLOW_POST, "post"}};
        for (size_t k = 0; k < sizeof known / sizeof *known; k++)
            if (target_allow((enum route)r) & known[k].allow)
                json_object_set_new(verbs, known[k].name,
                                    describe_operation((enum route)r, known[k].allow, names[r].name,
                                                       names[r].summary));
        json_object_set_new(paths, target_path((enum route)r), verbs);
    }
    json_t *o = json_pack("{s:s,s:{s:s,s:s,s:s},s:o}", "openapi", "3.0.3", "info", "title",
                          "citysplat", "version", CITYSPLAT_VERSION, "description",
                          "Tiles and pictures of cities of 3D Gaussians", "paths", paths);
    return document_make(o, out, e);
}

/* ---- the posted camera ---- */

/* An optional whole number in [lo, hi]; `what` was *out already. */
static enum err_code describe_read_int(const json_t *o, const char *key, json_int_t lo,
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

static enum err_code describe_check_keys(const json_t *o, const char *const *known,
                                         const char *where, struct err *e)
{
    const char *key;
    json_t *v;
    json_object_foreach((json_t *)(uintptr_t)o, key, v)
    {
        size_t i = 0;
        while (known[i] && strcmp(known[i], key) != 0)
            i++;
        if (!known[i])
            return err_set(e, ERR_DATA, "%s has a key it does not know; it takes %s, %s ...", where,
                           known[0], known[1]);
    }
    return ERR_OK;
}

static enum err_code describe_read_pose(const json_t *o, struct view_pose *out, struct err *e)
{
    static const char *const keys[] = {"lon", "lat", "height", "heading", "pitch", "fov", NULL};
    double *const fields[] = {&out->lon_deg,     &out->lat_deg,   &out->h_m,
                              &out->heading_deg, &out->pitch_deg, &out->fov_y_deg};
    static const double limit[] = {180, 90, 2e6, 360, 90, 150};
    out->fov_y_deg = 60;
    if (!json_is_object(o))
        return err_set(e, ERR_DATA, "pose must be an object with lon, lat, height, heading, pitch");
    enum err_code rc = describe_check_keys(o, keys, "pose", e);
    for (int i = 0; i < 6 && !rc; i++) {
        const json_t *v = json_object_get(o, keys[i]);
        if (!v && i == 5)
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

static enum err_code describe_read_format(const json_t *o, enum format *out, struct err *e)
{
    const json_t *v = json_object_get(o, "format");
    *out = FORMAT_JPG;
    for (int f = FORMAT_JPG; v && f <= FORMAT_WEBP; f++)
        if (json_is_string(v) && !strcmp(json_string_value(v), target_ext((enum format)f))) {
            *out = (enum format)f;
            return ERR_OK;
        }
    return v ? err_set(e, ERR_DATA, "format must be jpg, png or webp") : ERR_OK;
}

/* Numbers that are finite, and yet no camera: focal lengths beyond 0.06 to 180 degrees, a principal
 * point far outside the picture, a place further away than the Moon. */
static enum err_code describe_check_camera(const struct camera *c, struct err *e)
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

static enum err_code describe_read_camera(const struct server_config *cfg,
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
        return describe_check_camera(out, e);
    if (camera)
        return err_add(e, "camera"), ERR_DATA;
    struct view_pose at = {0};
    enum err_code rc = describe_read_int(o, "width", 1, cfg->max_view_px, &width, e);
    if (!rc)
        rc = describe_read_int(o, "height", 1, cfg->max_view_px, &height, e);
    if (!rc && (!width || !height))
        rc = err_set(e, ERR_DATA, "a pose needs width and height, in pixels");
    if (!rc)
        rc = describe_read_pose(pose, &at, e);
    if (rc)
        return rc;
    return view_camera(origin, &at, (uint32_t)width, (uint32_t)height, out, e) == ERR_OK ? ERR_OK
                                                                                         : ERR_DATA;
}

static enum err_code describe_read_appearance(const json_t *o, char out[TARGET_APPEARANCE_MAX],
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

enum err_code describe_read_render(const struct server_config *cfg, const struct geo_origin *origin,
                                   const void *text, size_t n, struct describe_render *out,
                                   struct err *e)
{
    static const char *const keys[] = {"camera",  "pose",        "width",      "height", "format",
                                       "quality", "deadline_ms", "appearance", NULL};
    json_t *o = NULL;
    json_int_t quality = cfg->quality, deadline_ms = (json_int_t)(cfg->deadline_s * 1000);
    memset(out, 0, sizeof *out);
    enum err_code rc =
        n ? jsonc_parse(text, n, "body", &o, e)
          : err_set(e, ERR_FORMAT, "the body must be a JSON object with a camera or a pose");
    if (!rc && !json_is_object(o))
        rc = err_set(e, ERR_FORMAT, "the body must be a JSON object with a camera or a pose");
    if (!rc)
        rc = describe_check_keys(o, keys, "the body", e);
    if (!rc)
        rc = describe_read_camera(cfg, origin, o, &out->cam, e);
    if (!rc)
        rc = describe_read_format(o, &out->format, e);
    if (!rc)
        rc = describe_read_int(o, "quality", 1, 100, &quality, e);
    if (!rc)
        rc = describe_read_int(o, "deadline_ms", 50, 30000, &deadline_ms, e);
    if (!rc)
        rc = describe_read_appearance(o, out->appearance, e);
    out->quality = (int)quality;
    out->timeout_s = (double)deadline_ms / 1000;
    json_decref(o);
    return rc;
}
