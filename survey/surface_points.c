/* Coloured points of a surface: see surface_points.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/surface_points.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "survey/bare.h"
#include "survey/las.h"

struct surface_points {
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
    enum err_code rc = crs_wkt(crs, &wkt, e);
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
            if (s->ground)
                s->row[n].class = (uint8_t)bare_class_of(
                    m->height_m[i] - bare_at(s->ground, x + (uint32_t)u, y + (uint32_t)v),
                    m->rgb + 3 * i);
            n++;
        }
        if (n)
            rc = las_add(s->out, s->row, n, e);
    }
    return rc;
}

enum err_code surface_points_write(struct nadir *n, const struct map_request *r, const char *path,
                                   struct map_report *report, struct err *e)
{
    struct surface_points s = {
        .meta = store_info(nadir_store(n)), .path = path, .ground = r->ground};
    const struct map_visitor v = {"points, px", &s, surface_points_begin, surface_points_piece,
                                  false};
    enum err_code rc = map_run(n, r, &v, report, e);
    if (!rc)
        rc = las_commit(&s.out, e);
    las_close(&s.out);
    mem_free(s.row);
    return rc;
}
