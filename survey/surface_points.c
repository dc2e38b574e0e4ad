/* Coloured points of a surface: see surface_points.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/surface_points.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/geo/geo.h"
#include "survey/bare.h"
#include "survey/las.h"

/* A wall is where heights around differ by more than twice this; points so far below its top and
 * above its foot lie on it. */
static const float surface_points_wall_m = 1;
enum { SURFACE_POINTS_NEAR = 2 /* px, of a wall */ };

struct surface_points {
    struct nadir *nadir;
    const struct map_request *request;
    struct crs *crs;
    float *height_m;     /* of a piece, ellipsoidal; only for walls */
    float sea_m;         /* of the piece: the geoid above the ellipsoid */
    uint32_t x, y, w, h; /* of the piece */
    uint64_t walls;
    const struct store_meta *meta;
    const char *path;
    const struct bare *ground; /* NULL: no classes */
    struct map_grid grid;
    struct las *out;
    struct las_point *row;
};

static enum err_code surface_points_begin(void *user, const struct crs *crs,
                                          const struct map_grid *g, struct err *e)
{
    struct surface_points *s = user;
    char source[32], *wkt;
    double n = (double)g->width * g->height;
    if (n > SURFACE_POINTS_MAX)
        return err_set(e, ERR_ARG,
                       "up to %.3g points: at most %.0f; from %.3g m between points on this area "
                       "fits, or give a smaller --bbox",
                       n, SURFACE_POINTS_MAX, g->pixel_m * sqrt(n / SURFACE_POINTS_MAX) * 1.01);
    s->grid = *g;
    s->row = mem_array(NADIR_SIZE_MAX, sizeof *s->row);
    if (!s->row)
        return err_set(e, ERR_MEM, "out of memory for a row of points");
    size_t side = s->request->piece_px ? s->request->piece_px : MAP_PIECE_PX;
    if (s->request->walls && !(s->height_m = mem_array(side * side, sizeof *s->height_m)))
        return err_set(e, ERR_MEM, "out of memory for heights of a piece");
    enum err_code rc = crs_open(g->epsg, &s->crs, e);
    if (!rc)
        rc = crs_wkt(crs, &wkt, e);
    if (rc)
        return rc;
    snprintf(source, sizeof source, "%.18s %.12s", s->meta->name, s->meta->revision);
    const struct las_info info = {.offset_m = {floor(g->west_m), floor(g->north_m), 0},
                                  .wkt = wkt,
                                  .source = source,
                                  .created = s->meta->created};
    rc = las_create(s->path, &info, &s->out, e);
    mem_free(wkt);
    return rc;
}

static uint8_t surface_points_class(const struct surface_points *s, uint32_t x, uint32_t y,
                                    float height_m, const float *rgb)
{
    return s->ground ? (uint8_t)bare_class_of(height_m - bare_at(s->ground, x, y), rgb) : 0;
}

static enum err_code surface_points_wall(void *user, const struct nadir_point *p, struct err *e)
{
    struct surface_points *s = user;
    int64_t x = (int64_t)p->at_px[0], y = (int64_t)p->at_px[1];
    float lo = INFINITY, hi = -INFINITY;
    for (int64_t v = y - SURFACE_POINTS_NEAR; v <= y + SURFACE_POINTS_NEAR; v++)
        for (int64_t u = x - SURFACE_POINTS_NEAR; u <= x + SURFACE_POINTS_NEAR; u++) {
            if (u < 0 || v < 0 || u >= s->w || v >= s->h)
                continue;
            lo = fminf(lo, s->height_m[v * s->w + u]); /* takes no notice of NAN */
            hi = fmaxf(hi, s->height_m[v * s->w + u]);
        }
    if (!(p->height_m > lo + surface_points_wall_m && p->height_m < hi - surface_points_wall_m))
        return ERR_OK;
    float height_m = p->height_m - s->sea_m;
    struct las_point out = {
        {s->grid.west_m + (s->x + p->at_px[0]) * s->grid.pixel_m,
         s->grid.north_m - (s->y + p->at_px[1]) * s->grid.pixel_m, (double)height_m},
        {p->rgb[0], p->rgb[1], p->rgb[2]},
        surface_points_class(s, s->x + (uint32_t)x, s->y + (uint32_t)y, height_m, p->rgb)};
    s->walls++;
    return las_add(s->out, &out, 1, e);
}

/* What slanted rays from four sides meet between the top and the foot of a step. */
static enum err_code surface_points_walls(struct surface_points *s, uint32_t x, uint32_t y,
                                          uint32_t w, uint32_t h, const float *height_m,
                                          struct err *e)
{
    struct nadir_piece p = {.width = w, .height = h};
    double corner[8], off_px = 0;
    enum err_code rc = map_place(s->nadir, s->crs, &s->grid, x, y, &p, corner, &off_px, e);
    if (rc)
        return rc;
    s->x = x;
    s->y = y;
    s->w = w;
    s->h = h;
    s->sea_m = s->request->geoid ? (float)geoid_above(s->request->geoid, p.lon_deg, p.lat_deg) : 0;
    for (size_t i = 0; i < (size_t)w * h; i++)
        s->height_m[i] = height_m[i] + s->sea_m;
    for (unsigned way = 0; !rc && way < NADIR_WAYS; way++)
        rc = nadir_slant_points(s->nadir, &p, way, s->height_m, surface_points_wall, s, e);
    return rc;
}

static enum err_code surface_points_piece(void *user, uint32_t x, uint32_t y, uint32_t w,
                                          uint32_t h, const struct surface_maps *m, struct err *e)
{
    struct surface_points *s = user;
    const struct map_grid *g = &s->grid;
    enum err_code rc = ERR_OK;
    for (size_t v = 0; !rc && v < h; v++) {
        size_t n = 0;
        for (size_t u = 0; u < w; u++) {
            size_t i = v * w + u;
            if (!isfinite(m->height_m[i]))
                continue;
            s->row[n] = (struct las_point){{g->west_m + ((double)(x + u) + 0.5) * g->pixel_m,
                                            g->north_m - ((double)(y + v) + 0.5) * g->pixel_m,
                                            (double)m->height_m[i]},
                                           {0},
                                           0};
            memcpy(s->row[n].rgb, m->rgb + 3 * i, sizeof s->row[0].rgb);
            s->row[n].class = surface_points_class(s, x + (uint32_t)u, y + (uint32_t)v,
                                                   m->height_m[i], m->rgb + 3 * i);
            n++;
        }
        if (n)
            rc = las_add(s->out, s->row, n, e);
    }
    return rc || !s->request->walls ? rc : surface_points_walls(s, x, y, w, h, m->height_m, e);
}

enum err_code surface_points_write(struct nadir *n, const struct map_request *r, const char *path,
                                   struct map_report *report, struct err *e)
{
    struct surface_points s = {.nadir = n,
                               .request = r,
                               .meta = store_info(nadir_store(n)),
                               .path = path,
                               .ground = r->ground};
    const struct map_visitor v = {"points, px", &s, surface_points_begin, surface_points_piece,
                                  false};
    enum err_code rc = map_run(n, r, &v, report, e);
    if (!rc)
        rc = las_commit(&s.out, e);
    if (!rc && report)
        report->more = s.walls;
    las_close(&s.out);
    crs_close(&s.crs);
    mem_free(s.row);
    mem_free(s.height_m);
    return rc;
}
