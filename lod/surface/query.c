/* Questions about the surface of a store as JSON: see query.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/surface/query.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "lod/choose/view.h"

_Static_assert((int)QUERY_PLACES_MAX == (int)MEASURE_CORNERS_MAX,
               "a line or polygon of any question fits");

/* ---- reading ---- */

static bool query_number(const json_t *v, double lo, double hi, double *out)
{
    *out = json_number_value(v);
    return json_is_number(v) && *out >= lo && *out <= hi;
}

/* [[lon, lat], ...]; further numbers of a place are left out. */
static enum err_code query_places(const json_t *list, const char *what, size_t least,
                                  struct query *out, struct err *e)
{
    size_t n = json_array_size(list);
    if (!json_is_array(list) || n < least || n > QUERY_PLACES_MAX)
        return err_set(e, ERR_DATA, "%s must be a list of %zu to %d places [longitude, latitude]",
                       what, least, QUERY_PLACES_MAX);
    for (size_t i = 0; i < n; i++) {
        const json_t *at = json_array_get(list, i);
        if (!query_number(json_array_get(at, 0), -180, 180, &out->place[i][0]) ||
            !query_number(json_array_get(at, 1), -85, 85, &out->place[i][1]))
            return err_set(e, ERR_DATA,
                           "%s: place %zu must be [longitude, latitude] in degrees, -180 to 180 "
                           "and -85 to 85",
                           what, i + 1);
    }
    out->n = (uint32_t)n;
    return ERR_OK;
}

static enum err_code query_optional(const json_t *o, const char *key, double lo, double hi,
                                    double *out, struct err *e)
{
    const json_t *v = json_object_get(o, key);
    if (v && !query_number(v, lo, hi, out))
        return err_set(e, ERR_DATA, "%s must be a number, %g to %g", key, lo, hi);
    return ERR_OK;
}

static enum err_code query_read_pose(const json_t *o, const struct geo_origin *origin,
                                     struct query *out, struct err *e)
{
    static const char *const known[] = {"lon", "lat", "height", "heading", "pitch", "fov", NULL};
    const json_t *pose = json_object_get(o, "pose");
    struct view_pose p = {.fov_y_deg = 60};
    double width, height;
    if (!query_number(json_object_get(o, "width"), 1, 16384, &width) ||
        !query_number(json_object_get(o, "height"), 1, 16384, &height))
        return err_set(e, ERR_DATA, "a pose needs width and height, 1 to 16384 pixels");
    const struct {
        const char *key;
        double limit, *at;
    } keys[] = {{"lon", 180, &p.lon_deg},    {"lat", 90, &p.lat_deg},
                {"height", 2e6, &p.h_m},     {"heading", 360, &p.heading_deg},
                {"pitch", 90, &p.pitch_deg}, {"fov", 150, &p.fov_y_deg}};
    for (size_t i = 0; i < sizeof keys / sizeof *keys; i++) {
        const json_t *v = json_object_get(pose, keys[i].key);
        if (!v && !strcmp(keys[i].key, "fov"))
            continue;
        if (!query_number(v, -keys[i].limit, keys[i].limit, keys[i].at))
            return err_set(e, ERR_DATA, "pose.%s must be a number, at most %g either way",
                           keys[i].key, keys[i].limit);
    }
    if (!(p.fov_y_deg >= 1))
        return err_set(e, ERR_DATA, "pose.fov must be 1 to 150 degrees");
    if (jsonc_known(pose, known, "pose", e))
        return ERR_DATA;
    return view_camera(origin, &p, (uint32_t)width, (uint32_t)height, &out->cam, e) ? ERR_DATA
                                                                                    : ERR_OK;
}

static enum err_code query_read_pick(const json_t *o, const struct geo_origin *origin,
                                     struct query *out, struct err *e)
{
    const json_t *camera = json_object_get(o, "camera");
    enum err_code rc = ERR_OK;
    if (!camera == !json_object_get(o, "pose"))
        return err_set(e, ERR_DATA, "give a camera or a pose, one of the two, and x and y");
    if (!camera)
        rc = query_read_pose(o, origin, out, e);
    else if (camera_from_json(camera, &out->cam, e))
        rc = err_set(e, ERR_DATA,
                     "camera must give width, height, fx, fy, cx, cy in pixels and "
                     "world_to_camera, 16 numbers");
    if (!rc && (!query_number(json_object_get(o, "x"), 0, out->cam.width_px, &out->pixel[0]) ||
                !query_number(json_object_get(o, "y"), 0, out->cam.height_px, &out->pixel[1])))
        rc = err_set(e, ERR_DATA, "x and y must lie in the picture: 0 to %u and 0 to %u pixels",
                     out->cam.width_px, out->cam.height_px);
    return rc;
}

static enum err_code query_read_visible(const json_t *o, struct query *out, struct err *e)
{
    static const char *const ends[2] = {"from", "to"};
    static const char *const known[] = {"lon", "lat", "height", "above", NULL};
    for (size_t i = 0; i < 2; i++) {
        const json_t *p = json_object_get(o, ends[i]), *h = json_object_get(p, "height"),
                     *above = json_object_get(p, "above");
        if (!query_number(json_object_get(p, "lon"), -180, 180, &out->place[i][0]) ||
            !query_number(json_object_get(p, "lat"), -85, 85, &out->place[i][1]) || !h == !above ||
            !query_number(h ? h : above, -2e4, 2e6, &out->height_m[i]))
            return err_set(e, ERR_DATA,
                           "%s must be {\"lon\", \"lat\", \"height\"} with metres as the "
                           "store counts them, or \"above\" with metres above the surface there",
                           ends[i]);
        if (jsonc_known(p, known, ends[i], e))
            return ERR_DATA;
        out->above |= (uint32_t)(above != NULL) << i;
    }
    out->n = 2;
    return ERR_OK;
}

static enum err_code query_read_measure(const json_t *o, struct query *out, struct err *e)
{
    const json_t *polygon = json_object_get(o, "polygon"), *base = json_object_get(o, "base");
    const char *text = json_string_value(base);
    out->ring = polygon != NULL;
    out->base_m = (double)NAN;
    if (!polygon == !json_object_get(o, "line"))
        return err_set(e, ERR_DATA, "give a line or a polygon, one of the two");
    if (base && !(text && !strcmp(text, "rim")) && !query_number(base, -2e4, 2e6, &out->base_m))
        return err_set(e, ERR_DATA,
                       "base must be \"rim\", the plane through the surface along the polygon, or "
                       "a height in metres as the store counts them");
    enum err_code rc = polygon ? query_places(polygon, "polygon", 3, out, e)
                               : query_places(json_object_get(o, "line"), "line", 2, out, e);
    /* GeoJSON repeats the first corner. */
    if (!rc && out->ring && out->n > 3 &&
        !memcmp(out->place[0], out->place[out->n - 1], sizeof out->place[0]))
        out->n--;
    return rc;
}

/* A key that is misspelt would leave its default in force without a word. */
static const char *const query_keys[][8] = {
    [QUERY_HEIGHT] = {"places", "gsd_m"},
    [QUERY_PICK] = {"camera", "pose", "width", "height", "x", "y"},
    [QUERY_PROFILE] = {"line", "gsd_m", "step_m"},
    [QUERY_MEASURE] = {"line", "polygon", "base", "gsd_m"},
    [QUERY_VISIBLE] = {"from", "to", "gsd_m"},
};

bool query_takes(enum query_kind kind, const char *name, size_t n)
{
    for (const char *const *key = query_keys[kind]; *key; key++)
        if (strlen(*key) == n && !memcmp(*key, name, n))
            return true;
    return false;
}

enum err_code query_read(enum query_kind kind, const json_t *o, const struct geo_origin *origin,
                         struct query *out, struct err *e)
{
    memset(out, 0, sizeof *out);
    out->kind = kind;
    if (!json_is_object(o))
        return err_set(e, ERR_DATA, "a JSON object is expected");
    enum err_code rc = jsonc_known(o, query_keys[kind], "the question", e);
    if (!rc)
        rc = query_optional(o, "gsd_m", QUERY_LEAST_M, QUERY_GSD_MOST_M, &out->gsd_m, e);
    if (!rc)
        rc = query_optional(o, "step_m", QUERY_LEAST_M, QUERY_STEP_MOST_M, &out->step_m, e);
    if (rc)
        return rc;
    switch (kind) {
    case QUERY_HEIGHT:
        return query_places(json_object_get(o, "places"), "places", 1, out, e);
    case QUERY_PROFILE:
        return query_places(json_object_get(o, "line"), "line", 2, out, e);
    case QUERY_MEASURE:
        return query_read_measure(o, out, e);
    case QUERY_PICK:
        return query_read_pick(o, origin, out, e);
    default:
        return query_read_visible(o, out, e);
    }
}

/* ---- answering ---- */

struct query_work {
    struct nadir *nadir;
    const struct geoid *geoid;
    const struct query *q;
    json_t *out;
};

static double query_round(double v, double unit)
{
    return isfinite(v) ? floor(v / unit + 0.5) * unit : v;
}

/* A number of metres, to the millimetre. */
static void query_m(json_t *o, const char *key, double v)
{
    json_object_set_new(o, key, jsonc_real(query_round(v, 0.001)));
}

static void query_lonlat(json_t *o, const double at[2])
{
    json_object_set_new(o, "lon", json_real(query_round(at[0], 1e-9)));
    json_object_set_new(o, "lat", json_real(query_round(at[1], 1e-9)));
}

/* A height, and the same above sea level. */
static void query_h(const struct query_work *w, json_t *o, const double at[2], double h)
{
    query_m(o, "height_m", h);
    if (w->geoid)
        query_m(o, "sea_level_height_m", h - geoid_above(w->geoid, at[0], at[1]));
}

static json_t *query_probe(const struct query_work *w, const double at[2], const struct probe *p)
{
    char tile[48];
    json_t *o = json_object();
    query_lonlat(o, at);
    json_object_set_new(o, "surveyed", json_boolean(p->surveyed));
    query_h(w, o, at, p->height_m);
    query_m(o, "sigma_m", p->sigma_m);
    query_m(o, "height_min_m", p->height_min_m);
    query_m(o, "height_max_m", p->height_max_m);
    if (p->surveyed) {
        snprintf(tile, sizeof tile, "%u/%u/%u", p->tile.z, p->tile.x, p->tile.y);
        json_object_set_new(o, "tile", json_string(tile));
        json_object_set_new(o, "level", json_integer(p->level));
    }
    if (p->found)
        json_object_set_new(o, "rgb",
                            json_pack("[i,i,i]", (int)lroundf(p->rgb[0] * 255),
                                      (int)lroundf(p->rgb[1] * 255),
                                      (int)lroundf(p->rgb[2] * 255)));
    return o;
}

static enum err_code query_height(const struct query_work *w, struct err *e)
{
    const struct query *q = w->q;
    struct probe *p = mem_array(q->n, sizeof *p);
    json_t *list = json_array();
    enum err_code rc = p ? probe_many(w->nadir, q->place, q->n, q->gsd_m, p, e)
                         : err_set(e, ERR_MEM, "out of memory for %u places", q->n);
    for (size_t i = 0; !rc && i < q->n; i++)
        json_array_append_new(list, query_probe(w, q->place[i], &p[i]));
    mem_free(p);
    json_object_set_new(w->out, "places", list);
    return rc;
}

static enum err_code query_pick(const struct query_work *w, struct err *e)
{
    const struct camera *c = &w->q->cam;
    struct nadir_ray ray;
    double enu[3], at[3];
    enum err_code rc = nadir_look(w->nadir, c, w->q->pixel[0], w->q->pixel[1], 0, &ray, e);
    if (rc)
        return rc;
    json_object_set_new(w->out, "found", json_boolean(ray.found));
    if (!ray.found)
        return ERR_OK;
    const double dir[3] = {(w->q->pixel[0] - c->cx_px) / c->fx_px,
                           (w->q->pixel[1] - c->cy_px) / c->fy_px, 1};
    for (size_t k = 0; k < 3; k++) {
        enu[k] = 0;
        for (size_t r = 0; r < 3; r++)
            enu[k] += c->rot[3 * r + k] * (dir[r] * ray.depth_m - c->trans[r]);
    }
    rc = geo_from_enu(&store_info(nadir_store(w->nadir))->origin, enu, &at[0], &at[1], &at[2], e);
    if (rc)
        return rc;
    query_lonlat(w->out, at);
    query_h(w, w->out, at, at[2]);
    query_m(w->out, "distance_m",
            ray.depth_m * sqrt(dir[0] * dir[0] + dir[1] * dir[1] + dir[2] * dir[2]));
    return ERR_OK;
}

static enum err_code query_profile(const struct query_work *w, struct err *e)
{
    const struct query *q = w->q;
    struct measure_sample *s;
    size_t n = 0, known = 0;
    double length, climb = 0, fall = 0, along = 0, lowest = HUGE_VAL, highest = -HUGE_VAL;
    enum err_code rc =
        measure_profile(w->nadir, q->place, q->n, q->step_m, q->gsd_m, &s, &n, &length, e);
    if (rc)
        return rc;
    json_t *list = json_array();
    for (size_t i = 0; i < n; i++) {
        const double at[2] = {s[i].lon_deg, s[i].lat_deg};
        double h = s[i].probe.height_m, before = i ? s[i - 1].probe.height_m : (double)NAN;
        json_t *o = json_object();
        query_m(o, "distance_m", s[i].distance_m);
        query_lonlat(o, at);
        query_h(w, o, at, h);
        query_m(o, "sigma_m", s[i].probe.sigma_m);
        json_array_append_new(list, o);
        known += isfinite(h);
        lowest = fmin(lowest, h); /* fmin and fmax take no notice of NAN */
        highest = fmax(highest, h);
        if (!isfinite(h) || !isfinite(before))
            continue;
        along += hypot(s[i].distance_m - s[i - 1].distance_m, h - before);
    }
    measure_climb(s, n, &climb, &fall);
    mem_free(s);
    query_m(w->out, "length_m", length);
    query_m(w->out, "surface_length_m", along);
    query_m(w->out, "climb_m", climb);
    query_m(w->out, "fall_m", fall);
    query_m(w->out, "lowest_m", known ? lowest : (double)NAN);
    query_m(w->out, "highest_m", known ? highest : (double)NAN);
    json_object_set_new(w->out, "known", json_real(query_round((double)known / (double)n, 1e-4)));
    json_object_set_new(w->out, "samples", list);
    return ERR_OK;
}

/* From place to place as the surface has them: straight lines in space. */
static enum err_code query_line(const struct query_work *w, struct err *e)
{
    const struct query *q = w->q;
    struct probe *p = mem_array(q->n, sizeof *p);
    double plan = 0, space = 0, before[3] = {0}, at[QUERY_PLACES_MAX][2];
    json_t *list = json_array();
    struct geo_origin frame;
    enum err_code rc = p ? measure_plan(w->nadir, q->place, q->n, &frame, at, e)
                         : err_set(e, ERR_MEM, "out of memory for %u places", q->n);
    if (!rc)
        rc = probe_many(w->nadir, q->place, q->n, q->gsd_m, p, e);
    for (size_t i = 0; !rc && i < q->n; i++) {
        const double enu[3] = {at[i][0], at[i][1], p[i].height_m};
        double d = hypot(enu[0] - before[0], enu[1] - before[1]);
        plan += i ? d : 0;
        space += i ? hypot(d, enu[2] - before[2]) : 0;
        memcpy(before, enu, sizeof before);
        json_array_append_new(list, query_probe(w, q->place[i], &p[i]));
    }
    query_m(w->out, "length_m", plan);
    query_m(w->out, "space_length_m", space);
    if (!rc)
        query_m(w->out, "rise_m", p[q->n - 1].height_m - p[0].height_m);
    json_object_set_new(w->out, "places", list);
    mem_free(p);
    return rc;
}

static enum err_code query_measure(const struct query_work *w, struct err *e)
{
    const struct query *q = w->q;
    struct measure_area a;
    if (!q->ring)
        return query_line(w, e);
    enum err_code rc = measure_polygon(w->nadir, q->place, q->n, q->base_m, q->gsd_m, &a, e);
    if (rc)
        return rc;
    query_m(w->out, "area_m2", a.area_m2);
    query_m(w->out, "perimeter_m", a.perimeter_m);
    query_m(w->out, "known_area_m2", a.known_m2);
    query_m(w->out, "surface_area_m2", a.surface_m2);
    json_object_set_new(w->out, "base", json_string(isfinite(q->base_m) ? "level" : "rim"));
    query_m(w->out, "base_m", a.base_m);
    query_m(w->out, "volume_above_m3", a.above_m3);
    query_m(w->out, "volume_below_m3", a.below_m3);
    query_m(w->out, "volume_error_m3", a.error_m3);
    query_m(w->out, "mean_m", a.mean_m);
    query_m(w->out, "lowest_m", a.lowest_m);
    query_m(w->out, "highest_m", a.highest_m);
    query_m(w->out, "pixel_m", a.pixel_m);
    return ERR_OK;
}

static enum err_code query_visible(const struct query_work *w, struct err *e)
{
    const struct query *q = w->q;
    struct probe p[2];
    struct measure_sight s;
    double end[2][3];
    enum err_code rc = probe_many(w->nadir, q->place, 2, q->gsd_m, p, e);
    for (size_t i = 0; !rc && i < 2; i++) {
        bool above = q->above >> i & 1;
        if (above && !p[i].found)
            rc = err_set(e, ERR_DATA,
                         "%s: there is no surface; give \"height\" instead of "
                         "\"above\"",
                         i ? "to" : "from");
        end[i][0] = q->place[i][0];
        end[i][1] = q->place[i][1];
        end[i][2] = q->height_m[i] + (above ? p[i].height_m : 0);
    }
    if (!rc)
        rc = measure_sight(w->nadir, end[0], end[1], &s, e);
    if (rc)
        return rc;
    json_object_set_new(w->out, "visible", json_boolean(s.visible));
    json_object_set_new(w->out, "light", json_real(query_round(s.light, 1e-4)));
    query_m(w->out, "distance_m", s.distance_m);
    for (size_t i = 0; i < 2; i++) {
        json_t *o = json_object();
        query_lonlat(o, end[i]);
        query_h(w, o, end[i], end[i][2]);
        json_object_set_new(w->out, i ? "to" : "from", o);
    }
    json_t *o = isfinite(s.blocked_m) ? json_object() : json_null();
    if (isfinite(s.blocked_m)) {
        query_lonlat(o, s.blocked);
        query_h(w, o, s.blocked, s.blocked[2]);
        query_m(o, "distance_m", s.blocked_m);
    }
    json_object_set_new(w->out, "blocked_at", o);
    return ERR_OK;
}

enum err_code query_answer(struct nadir *n, const struct geoid *geoid, const struct query *q,
                           json_t **out, struct err *e)
{
    static enum err_code (*const answer[])(const struct query_work *w,
                                           struct err *e) = {[QUERY_HEIGHT] = query_height,
                                                             [QUERY_PICK] = query_pick,
                                                             [QUERY_PROFILE] = query_profile,
                                                             [QUERY_MEASURE] = query_measure,
                                                             [QUERY_VISIBLE] = query_visible};
    const char *heights = store_info(nadir_store(n))->heights;
    /* No geoid is taken off heights that count from the sea already. */
    struct query_work w = {n, heights_ellipsoidal(heights) ? geoid : NULL, q, json_object()};
    char datum[HEIGHTS_WORDS_MAX];
    *out = NULL;
    if (!w.out)
        return err_set(e, ERR_MEM, "out of memory for an answer");
    heights_datum(heights, datum);
    json_object_set_new(w.out, "vertical_datum", json_string(datum));
    json_object_set_new(w.out, "units", json_string("m"));
    if (w.geoid)
        json_object_set_new(w.out, "sea_level", json_string(geoid_name(geoid)));
    enum err_code rc = answer[q->kind](&w, e);
    if (rc)
        json_decref(w.out);
    else
        *out = w.out;
    return rc;
}
