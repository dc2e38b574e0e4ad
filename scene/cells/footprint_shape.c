/* The footprint as polygons, and polygons back onto the grid.
 *
 * Borders are contours of the distance to the border, by marching squares. Inside is on the left,
 * so outer rings run counter-clockwise and holes clockwise (RFC 7946). They are simplified to a
 * fraction of a cell. GeoJSON polygons are put onto the grid one after the other, each by the
 * even-odd rule of its rings.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/container/geojson.h"
#include "core/base.h"
#include "core/geo/geo.h"
#include "core/geo/outline.h"
#include "scene/cells/footprint.h"
#include "scene/cells/footprint_internal.h"

enum {
    SHAPE_SIDE = 256 /* cells along the longer side where no grid is given */
};
#define SHAPE_TOLERANCE 0.25 /* cells */
#define SHAPE_HIGH_M 1e9f
#define SHAPE_NONE SIZE_MAX

struct shape_ring {
    double (*at)[2]; /* ENU metres; the first corner is not repeated */
    size_t n;
    double area_m2; /* negative: a hole */
    size_t polygon; /* of a file: its rings follow each other */
};
struct shape { /* {0} is empty; shape_free */
    struct shape_ring *rings;
    size_t n, cap;
};

static void shape_free(struct shape *s)
{
    for (size_t i = 0; i < s->n; i++)
        mem_free(s->rings[i].at);
    mem_free(s->rings);
    *s = (struct shape){0};
}

static enum err_code shape_no_memory(struct err *e)
{
    return err_set(e, ERR_MEM, "footprint: out of memory for its polygons");
}

/* A copy of the corners becomes a ring. */
static enum err_code shape_add(struct shape *s, size_t polygon, const double (*at)[2], size_t n,
                               struct err *e)
{
    struct shape_ring *p = mem_room(s->rings, s->n, &s->cap, 8, sizeof *p);
    if (!p)
        return shape_no_memory(e);
    s->rings = p;
    struct shape_ring r = {.at = mem_array(n, sizeof *r.at), .n = n, .polygon = polygon};
    if (!r.at)
        return shape_no_memory(e);
    memcpy(r.at, at, n * sizeof *at);
    for (size_t i = 0; i < n; i++) {
        const double *a = at[i], *b = at[(i + 1) % n];
        r.area_m2 += 0.5 * (a[0] * b[1] - b[0] * a[1]);
    }
    s->rings[s->n++] = r;
    return ERR_OK;
}

/* ---- contours ---- */

/* Where the border crosses lattice edge `id`: those along x first, then those along y. */
static void shape_crossing(const struct footprint *f, size_t id, double out[2])
{
    size_t n = f->nx * f->ny, i = id % n, up = id / n;
    double a = (double)f->edge_m[i], b = (double)f->edge_m[up ? i + f->nx : i + 1];
    double t = a / (a - b), x = (double)(i % f->nx) + 0.5, y = (double)(i / f->nx) + 0.5;
    out[0] = f->corner_m[0] + (x + (up ? 0.0 : t)) * f->cell_m;
    out[1] = f->corner_m[1] + (y + (up ? t : 0.0)) * f->cell_m;
}

/* The pieces of border in the square whose south-west node is i. */
static void shape_square(const struct footprint *f, size_t i, size_t *next)
{
    const size_t n = f->nx * f->ny, node[4] = {i, i + 1, i + 1 + f->nx, i + f->nx},
                 edge[4] = {i, n + i + 1, i + f->nx, n + i};
    for (int k = 0; k < 4; k++) {
        if (!(f->edge_m[node[k]] < 0.0f) || f->edge_m[node[(k + 1) % 4]] < 0.0f)
            continue;
        int m = (k + 1) % 4; /* to where it comes in again, counter-clockwise */
        while (f->edge_m[node[m]] < 0.0f || !(f->edge_m[node[(m + 1) % 4]] < 0.0f))
            m = (m + 1) % 4;
        next[edge[k]] = edge[m];
    }
}

/* Corners that lie on a straight line between others go. */
static size_t shape_thin(double (*at)[2], size_t n, double tolerance_m)
{
    size_t kept = 1, from = 0;
    for (size_t to = 2; to <= n; to++) {
        const double *a = at[kept - 1], *b = at[to % n];
        double d[2] = {b[0] - a[0], b[1] - a[1]}, len = hypot(d[0], d[1]);
        bool straight = true;
        for (size_t k = from + 1; straight && k < to; k++) {
            double e[2] = {at[k][0] - a[0], at[k][1] - a[1]};
            straight = fabs(len > 0.0 ? (d[0] * e[1] - d[1] * e[0]) / len : hypot(e[0], e[1])) <=
                       tolerance_m;
        }
        if (straight)
            continue;
        from = to - 1;
        memmove(at[kept++], at[from], sizeof *at); /* kept <= from */
    }
    return kept;
}

static enum err_code shape_contours(const struct footprint *f, struct shape *out, struct err *e)
{
    size_t n = f->nx * f->ny;
    size_t *next = mem_array(2 * n, sizeof *next);
    double(*at)[2] = mem_array(2 * n, sizeof *at);
    enum err_code rc = next && at ? ERR_OK : shape_no_memory(e);
    for (size_t i = 0; !rc && i < 2 * n; i++)
        next[i] = SHAPE_NONE;
    for (size_t y = 0; !rc && y + 1 < f->ny; y++)
        for (size_t x = 0; x + 1 < f->nx; x++)
            shape_square(f, y * f->nx + x, next);
    for (size_t start = 0; !rc && start < 2 * n; start++) {
        size_t len = 0;
        for (size_t i = start; next[i] != SHAPE_NONE;) {
            size_t to = next[i];
            shape_crossing(f, i, at[len++]);
            next[i] = SHAPE_NONE;
            i = to;
        }
        if (len >= 3)
            len = shape_thin(at, len, SHAPE_TOLERANCE * f->cell_m);
        if (len >= 3)
            rc = shape_add(out, 0, (const double(*)[2])at, len, e);
    }
    mem_free(next);
    mem_free(at);
    return rc;
}

/* ---- to GeoJSON ---- */

/* The smallest outer ring around a hole; SHAPE_NONE: none. */
static size_t shape_owner(const struct shape *s, const struct shape_ring *hole)
{
    size_t best = SHAPE_NONE;
    for (size_t i = 0; i < s->n; i++) {
        const struct shape_ring *r = &s->rings[i];
        if (r->area_m2 > 0.0 && (best == SHAPE_NONE || r->area_m2 < s->rings[best].area_m2) &&
            outline_holds((const double(*)[2])r->at, r->n, hole->at[0][0], hole->at[0][1]))
            best = i;
    }
    return best;
}

static enum err_code shape_ring_json(const struct shape_ring *r, const struct geo_origin *origin,
                                     json_t *polygon, struct err *e)
{
    json_t *list = json_array();
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i <= r->n; i++) {
        const double enu[3] = {r->at[i % r->n][0], r->at[i % r->n][1], 0.0};
        double lon, lat, h;
        rc = geo_from_enu(origin, enu, &lon, &lat, &h, e);
        if (!rc) /* 1e-8 degrees are a millimetre */
            json_array_append_new(
                list, json_pack("[f, f]", round(lon * 1e8) / 1e8, round(lat * 1e8) / 1e8));
    }
    json_array_append_new(polygon, list);
    return rc;
}

static enum err_code shape_json(const struct shape *s, const struct geo_origin *origin,
                                json_t *polygons, double *area_m2, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < s->n; i++) {
        *area_m2 += s->rings[i].area_m2;
        if (!(s->rings[i].area_m2 > 0.0))
            continue;
        json_t *polygon = json_array();
        json_array_append_new(polygons, polygon);
        rc = shape_ring_json(&s->rings[i], origin, polygon, e);
        for (size_t k = 0; !rc && k < s->n; k++)
            if (s->rings[k].area_m2 < 0.0 && shape_owner(s, &s->rings[k]) == i)
                rc = shape_ring_json(&s->rings[k], origin, polygon, e);
    }
    return rc;
}

enum err_code footprint_write(const struct footprint *f, const struct geo_origin *origin,
                              struct buf *out, struct err *e)
{
    struct shape s = {0};
    double area = 0.0, low = HUGE_VAL, high = -HUGE_VAL;
    if (!f->nx)
        return err_set(e, ERR_DATA, "footprint: no ground is known to be supported");
    for (size_t i = 0; i < f->nx * f->ny; i++)
        if (f->inside[i]) {
            low = fmin(low, (double)f->low_m[i]);
            high = fmax(high, (double)f->high_m[i]);
        }
    json_t *polygons = json_array();
    enum err_code rc = shape_contours(f, &s, e);
    if (!rc)
        rc = shape_json(&s, origin, polygons, &area, e);
    json_t *root =
        json_pack("{s:s, s:{s:i, s:f, s:f, s:f, s:f}, s:{s:s, s:O}}", "type", "Feature",
                  "properties", "least_views", FOOTPRINT_VIEWS, "pixels_per_m", f->px_per_m,
                  "area_m2", round(area), "low_m", round(10.0 * (origin->h_m + low)) / 10.0,
                  "high_m", round(10.0 * (origin->h_m + high)) / 10.0, "geometry", "type",
                  "MultiPolygon", "coordinates", polygons);
    char *text = rc || !root ? NULL : json_dumps(root, JSON_COMPACT | JSON_REAL_PRECISION(12));
    if (!rc && !text)
        rc = shape_no_memory(e);
    if (!rc) {
        buf_add(out, text, strlen(text));
        rc = buf_check(out, e);
    }
    free(text);
    json_decref(root);
    json_decref(polygons);
    shape_free(&s);
    return rc;
}

/* ---- from GeoJSON ---- */

/* One ring, whose edges follow each other. */
static enum err_code shape_read_ring(const struct geojson_edge *edges, size_t n,
                                     const struct geo_origin *origin, struct shape *out,
                                     struct err *e)
{
    double(*at)[2] = mem_array(n, sizeof *at);
    enum err_code rc = at ? ERR_OK : shape_no_memory(e);
    for (size_t i = 0; !rc && i < n; i++) {
        double enu[3];
        rc = geo_to_enu(origin, edges[i].from[0], edges[i].from[1], origin->h_m, enu, e);
        if (!rc)
            memcpy(at[i], enu, sizeof *at);
    }
    if (!rc)
        rc = shape_add(out, edges->polygon, (const double(*)[2])at, n, e);
    mem_free(at);
    return rc;
}

static enum err_code shape_read(const struct geojson_area *a, const struct geo_origin *origin,
                                struct shape *out, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0, end; !rc && i < a->n; i = end) {
        for (end = i; end < a->n && a->edges[end].ring == a->edges[i].ring;)
            end++;
        rc = shape_read_ring(a->edges + i, end - i, origin, out, e);
    }
    return rc;
}

/* Without evidence of the scene's own: a grid over the polygons, and any height. */
static enum err_code shape_grid(const struct shape *s, struct footprint *f, struct err *e)
{
    double low[2] = {HUGE_VAL, HUGE_VAL}, high[2] = {-HUGE_VAL, -HUGE_VAL};
    for (size_t i = 0; i < s->n; i++)
        for (size_t k = 0; k < s->rings[i].n; k++)
            for (int a = 0; a < 2; a++) {
                low[a] = fmin(low[a], s->rings[i].at[k][a]);
                high[a] = fmax(high[a], s->rings[i].at[k][a]);
            }
    f->cell_m = fmax(fmax(high[0] - low[0], high[1] - low[1]) / SHAPE_SIDE, 1e-3);
    f->fade_m = 2.0 * f->cell_m;
    f->nx = (size_t)ceil((high[0] - low[0]) / f->cell_m) + 4;
    f->ny = (size_t)ceil((high[1] - low[1]) / f->cell_m) + 4;
    for (int a = 0; a < 2; a++)
        f->corner_m[a] = low[a] - 2.0 * f->cell_m;
    size_t n = f->nx * f->ny;
    f->inside = mem_array(n, 1);
    f->edge_m = mem_array(n, sizeof *f->edge_m);
    f->low_m = mem_array(n, sizeof *f->low_m);
    f->high_m = mem_array(n, sizeof *f->high_m);
    if (!f->inside || !f->edge_m || !f->low_m || !f->high_m)
        return shape_no_memory(e);
    for (size_t i = 0; i < n; i++) {
        f->low_m[i] = -SHAPE_HIGH_M;
        f->high_m[i] = SHAPE_HIGH_M;
    }
    return ERR_OK;
}

enum { SHAPE_IN = 1, SHAPE_TURNED = 2 }; /* of a cell: in a polygon; in the one that is filled */

/* Every cell west of an edge of a ring turns over. */
static void shape_fill_ring(const struct shape_ring *r, struct footprint *f)
{
    for (size_t k = 0; k < r->n; k++) {
        const double *a = r->at[k], *b = r->at[(k + 1) % r->n];
        for (size_t row = 1; row + 1 < f->ny; row++) {
            double y = f->corner_m[1] + ((double)row + 0.5) * f->cell_m;
            if ((a[1] > y) == (b[1] > y))
                continue;
            double x = a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]);
            double end = (x - f->corner_m[0]) / f->cell_m - 0.5;
            for (size_t c = 1; c + 1 < f->nx && (double)c < end; c++)
                f->inside[row * f->nx + c] ^= SHAPE_TURNED;
        }
    }
}

/* Polygons add up, whether they overlap or lie in each other. */
static size_t shape_fill(const struct shape *s, struct footprint *f)
{
    size_t n = 0, cells = f->nx * f->ny;
    memset(f->inside, 0, cells);
    for (size_t i = 0; i < s->n; i++) {
        shape_fill_ring(&s->rings[i], f);
        if (i + 1 < s->n && s->rings[i + 1].polygon == s->rings[i].polygon)
            continue;
        for (size_t c = 0; c < cells; c++)
            f->inside[c] = f->inside[c] ? SHAPE_IN : 0;
    }
    for (size_t c = 0; c < cells; c++)
        n += f->inside[c];
    return n;
}

enum err_code footprint_read(struct footprint *f, const char *path, const struct geo_origin *origin,
                             struct err *e)
{
    struct shape s = {0};
    struct geojson_area area;
    enum err_code rc = geojson_read(path, &area, e);
    if (rc)
        return rc;
    rc = shape_read(&area, origin, &s, e);
    geojson_free(&area);
    if (!rc && !f->nx)
        rc = shape_grid(&s, f, e);
    if (!rc && !shape_fill(&s, f))
        rc = err_set(e, ERR_DATA,
                     "its polygons hold nothing of the scene: are they longitude, latitude of the "
                     "same place?");
    if (!rc)
        rc = footprint_measure(f, e);
    shape_free(&s);
    return rc ? err_add(e, "%s", path) : ERR_OK;
}
