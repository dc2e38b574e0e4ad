/* Polygons of a GeoJSON file (RFC 7946): see geojson.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/geojson.h"

#include <jansson.h>
#include <math.h>
#include <string.h>

#include "core/base.h"
#include "core/geo/outline.h"

static enum err_code geojson_read_ring(const json_t *ring, size_t n, const char *path,
                                       double (*at)[2], struct err *e)
{
    for (size_t i = 0; i < n; i++) {
        const json_t *p = json_array_get(ring, i), *lon = json_array_get(p, 0),
                     *lat = json_array_get(p, 1);
        at[i][0] = json_number_value(lon);
        at[i][1] = json_number_value(lat);
        if (!json_is_number(lon) || !json_is_number(lat) || !(fabs(at[i][0]) <= 180) ||
            !(fabs(at[i][1]) <= 90))
            return err_set(e, ERR_FORMAT,
                           "%s: position %zu (%g, %g) is no longitude and latitude; of a "
                           "projection make them with ogr2ogr -t_srs EPSG:4326 -f GeoJSON",
                           path, i + 1, at[i][0], at[i][1]);
    }
    if (memcmp(at[0], at[n - 1], sizeof *at) != 0)
        return err_set(e, ERR_FORMAT, "%s: a ring is not closed: repeat its first position", path);
    if (outline_check((const double(*)[2])at, n - 1, e)) {
        err_add(e, "%s", path);
        return ERR_DATA;
    }
    return ERR_OK;
}

/* Edges of a ring of n positions, the last being the first. */
static enum err_code geojson_add_edges(struct geojson_area *a, const double (*at)[2], size_t n,
                                       const char *path, struct err *e)
{
    if (a->n + n > a->cap) {
        size_t cap = 2 * a->cap + n;
        struct geojson_edge *p = mem_resize(a->edges, a->cap, cap, sizeof *p);
        if (!p)
            return err_set(e, ERR_MEM, "%s: out of memory", path);
        a->edges = p;
        a->cap = cap;
    }
    for (size_t i = 0; i + 1 < n; i++)
        a->edges[a->n++] = (struct geojson_edge){
            {at[i][0], at[i][1]}, {at[i + 1][0], at[i + 1][1]}, a->n_polygons, a->n_rings};
    a->n_rings++;
    return ERR_OK;
}

static enum err_code geojson_add_ring(struct geojson_area *a, const json_t *ring, const char *path,
                                      struct err *e)
{
    size_t n = json_array_size(ring);
    if (n < 4 || n > GEOJSON_CORNERS_MAX + 1)
        return err_set(e, ERR_FORMAT,
                       "%s: a ring of %zu positions: four to %d, the last the same as the first",
                       path, n, GEOJSON_CORNERS_MAX + 1);
    double(*at)[2] = mem_array(n, sizeof *at);
    if (!at)
        return err_set(e, ERR_MEM, "%s: out of memory", path);
    enum err_code rc = geojson_read_ring(ring, n, path, at, e);
    if (!rc)
        rc = geojson_add_edges(a, (const double(*)[2])at, n, path, e);
    mem_free(at);
    return rc;
}

static enum err_code geojson_add_polygon(struct geojson_area *a, const json_t *rings,
                                         const char *path, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < json_array_size(rings); i++)
        rc = geojson_add_ring(a, json_array_get(rings, i), path, e);
    a->n_polygons++;
    return rc;
}

static enum err_code geojson_add_shape(struct geojson_area *a, const json_t *o, const char *path,
                                       int depth, struct err *e)
{
    const char *type = json_string_value(json_object_get(o, "type"));
    const json_t *at = json_object_get(o, "coordinates");
    const char *lists[] = {"features", "geometries"};
    enum err_code rc = ERR_OK;
    if (!type || depth > 4)
        return err_set(e, ERR_FORMAT,
                       "%s: a GeoJSON Polygon, MultiPolygon, Feature or FeatureCollection is "
                       "expected",
                       path);
    if (!strcmp(type, "Polygon"))
        return geojson_add_polygon(a, at, path, e);
    if (!strcmp(type, "Feature") && json_is_null(json_object_get(o, "geometry")))
        return ERR_OK; /* a feature of no place, RFC 7946 3.2 */
    if (!strcmp(type, "Feature"))
        return geojson_add_shape(a, json_object_get(o, "geometry"), path, depth + 1, e);
    for (size_t i = 0; !rc && !strcmp(type, "MultiPolygon") && i < json_array_size(at); i++)
        rc = geojson_add_polygon(a, json_array_get(at, i), path, e);
    for (size_t k = 0; k < 2; k++) {
        const json_t *list = json_object_get(o, lists[k]);
        for (size_t i = 0; !rc && i < json_array_size(list); i++)
            rc = geojson_add_shape(a, json_array_get(list, i), path, depth + 1, e);
    }
    return rc;
}

enum err_code geojson_of_ring(const double (*at)[2], size_t n, struct geojson_area *out,
                              struct err *e)
{
    *out = (struct geojson_area){0};
    enum err_code rc = outline_check(at, n, e);
    if (rc)
        return rc;
    out->edges = mem_array(n, sizeof *out->edges);
    if (!out->edges)
        return err_set(e, ERR_MEM, "out of memory for a polygon of %zu corners", n);
    for (size_t i = 0; i < n; i++)
        out->edges[i] = (struct geojson_edge){
            {at[i][0], at[i][1]}, {at[(i + 1) % n][0], at[(i + 1) % n][1]}, 0, 0};
    out->n = out->cap = n;
    out->n_polygons = out->n_rings = 1;
    return ERR_OK;
}

/* GeoJSON of before 2016 may name another coordinate system. */
static enum err_code geojson_check_crs(const json_t *root, const char *path, struct err *e)
{
    const char *name = json_string_value(
        json_object_get(json_object_get(json_object_get(root, "crs"), "properties"), "name"));
    if (!name || strstr(name, "CRS84") || strstr(name, "4326"))
        return ERR_OK;
    return err_set(e, ERR_FORMAT,
                   "%s: is in %.80s; make longitude and latitude of it with ogr2ogr -t_srs "
                   "EPSG:4326 -f GeoJSON",
                   path, name);
}

enum err_code geojson_read(const char *path, struct geojson_area *out, struct err *e)
{
    json_t *root = NULL;
    *out = (struct geojson_area){0};
    enum err_code rc = jsonc_read(path, &root, e);
    if (!rc)
        rc = geojson_check_crs(root, path, e);
    if (!rc)
        rc = geojson_add_shape(out, root, path, 0, e);
    if (!rc && !out->n)
        rc = err_set(e, ERR_FORMAT, "%s: there is no polygon in it (%.40s)", path,
                     json_string_value(json_object_get(root, "type")));
    json_decref(root);
    if (rc)
        geojson_free(out);
    return rc;
}

void geojson_free(struct geojson_area *a)
{
    mem_free(a->edges);
    *a = (struct geojson_area){0};
}

bool geojson_holds(const struct geojson_edge *edges, size_t n, double x, double y)
{
    bool in = false;
    for (size_t i = 0; i < n; i++) {
        const double *p = edges[i].from, *q = edges[i].to;
        if (in && edges[i].polygon != edges[i - 1].polygon)
            return true;
        if ((p[1] > y) != (q[1] > y) && x < p[0] + (y - p[1]) / (q[1] - p[1]) * (q[0] - p[0]))
            in = !in;
    }
    return in;
}
