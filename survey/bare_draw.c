/* Bare earth of a store: see bare_draw.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/bare_draw.h"

#include <math.h>

#include "core/base.h"
#include "survey/bare.h"

static enum err_code bare_draw_begin(void *user, const struct crs *crs, const struct map_grid *g,
                                     struct err *e)
{
    struct bare *o = user;
    (void)crs;
    o->cell_px = (uint32_t)fmax(floor(BARE_CELL_M / g->pixel_m + 0.5), 1);
    o->cell_m = o->cell_px * g->pixel_m;
    o->w = (g->width - 1) / o->cell_px + 1;
    o->h = (g->height - 1) / o->cell_px + 1;
    if ((double)o->w * o->h > BARE_CELLS_MAX)
        return err_set(e, ERR_ARG,
                       "bare earth of %u x %u cells of %.2g m: at most %.0f cells; give a smaller "
                       "--bbox",
                       o->w, o->h, o->cell_m, BARE_CELLS_MAX);
    o->height_m = mem_array((size_t)o->w * o->h, sizeof *o->height_m);
    if (!o->height_m)
        return err_set(e, ERR_MEM, "out of memory for %u x %u cells", o->w, o->h);
    for (size_t i = 0; i < (size_t)o->w * o->h; i++)
        o->height_m[i] = NAN;
    return ERR_OK;
}

static enum err_code bare_draw_piece(void *user, uint32_t x, uint32_t y, uint32_t w, uint32_t h,
                                     const struct surface_maps *m, struct err *e)
{
    struct bare *o = user;
    (void)e;
    for (size_t v = 0; v < h; v++)
        for (size_t u = 0; u < w; u++) {
            float *to = &o->height_m[(y + v) / o->cell_px * o->w + (x + u) / o->cell_px],
                  at = m->height_m[v * w + u];
            if (isfinite(at))
                *to = isfinite(*to) ? fminf(*to, at) : at;
        }
    return ERR_OK;
}

enum err_code bare_draw(struct nadir *n, const struct map_request *r, const struct bare_rule *rule,
                        struct bare **out, struct err *e)
{
    struct bare *g = *out = mem_array(1, sizeof *g);
    if (!g)
        return err_set(e, ERR_MEM, "out of memory for ground");
    struct map_request map = *r;
    map.kind = GEOTIFF_HEIGHT;
    map.ground = NULL;
    const struct map_visitor v = {"ground, px", g, bare_draw_begin, bare_draw_piece, false};
    enum err_code rc = map_run(n, &map, &v, NULL, e);
    if (!rc)
        rc = bare_filter(g->height_m, g->w, g->h, g->cell_m, rule, e);
    if (rc)
        bare_close(out);
    return rc;
}
