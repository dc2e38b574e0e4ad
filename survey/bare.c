/* Bare earth: see bare.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/bare.h"

#include <math.h>
#include <string.h>

#include "core/base.h"

enum { BARE_ROUNDS = 30 /* of relaxation, each level */ };
static const double bare_step_m = 0.3; /* what noise and kerbs rise, whatever the square */
static const double bare_most_m = 2.5; /* what an opening may lower ground by, at most */
static const float bare_green = 0.05f; /* excess green, as a share of brightness */
static const float bare_house_m = 2, bare_low_m = 0.5f;

/* ---- openings ---- */

/* Least of the values within r to each side, in place; INFINITY: none. v: n of them, stride apart.
 * Of a span of 2 r + 1 it is that from its start to the end of a block and from there to its end
 * (van Herk 1992). room [3][n + 2 r]. */
static void bare_least(float *v, size_t n, size_t stride, size_t r, float *room)
{
    size_t m = n + 2 * r, block = 2 * r + 1;
    float *pad = room, *from = room + m, *to = room + 2 * m;
    for (size_t i = 0; i < m; i++)
        pad[i] = i < r || i >= r + n ? INFINITY : v[(i - r) * stride];
    for (size_t i = 0; i < m; i++)
        from[i] = i % block ? fminf(from[i - 1], pad[i]) : pad[i];
    for (size_t i = m; i-- > 0;)
        to[i] = i + 1 < m && (i + 1) % block ? fminf(to[i + 1], pad[i]) : pad[i];
    for (size_t i = 0; i < n; i++)
        v[i * stride] = fminf(to[i], from[i + 2 * r]);
}

static void bare_plane_least(float *v, uint32_t w, uint32_t h, size_t r, float *room)
{
    for (size_t y = 0; y < h; y++)
        bare_least(v + y * w, w, 1, r, room);
    for (size_t x = 0; x < w; x++)
        bare_least(v + x, h, w, r, room);
}

static void bare_negate(float *v, size_t n)
{
    for (size_t i = 0; i < n; i++)
        v[i] = isinf(v[i]) ? INFINITY : -v[i];
}

static double bare_widest(const struct bare_rule *r)
{
    return r->widest_m > 0 ? r->widest_m : BARE_WIDEST_M;
}

/* Marks cells that are no ground with NAN. low: room for the opened heights, INFINITY: none. */
static void bare_mark(float *height_m, float *low, uint32_t w, uint32_t h, double cell_m,
                      const struct bare_rule *r, float *room)
{
    size_t n = (size_t)w * h, before = 0;
    double widest = bare_widest(r), slope = r->slope > 0 ? r->slope : BARE_SLOPE;
    float *opened = room;
    for (size_t i = 0; i < n; i++)
        low[i] = isfinite(height_m[i]) ? height_m[i] : INFINITY;
    for (size_t k = 1; (2 * (double)before + 1) * cell_m < widest; k *= 2) {
        double most = fmin(bare_step_m + slope * (double)(k - before) * cell_m, bare_most_m);
        memcpy(opened, low, n * sizeof *low);
        bare_plane_least(opened, w, h, k, room + n);
        bare_negate(opened, n);
        bare_plane_least(opened, w, h, k, room + n);
        bare_negate(opened, n);
        for (size_t i = 0; i < n; i++) {
            if (isfinite(height_m[i]) && (double)(low[i] - opened[i]) > most)
                height_m[i] = NAN;
            low[i] = isinf(low[i]) ? INFINITY : opened[i];
        }
        before = k;
    }
}

/* ---- what is between ---- */

/* Fills cells that are NAN from a field of half the size, then relaxes them. ERR_MEM. */
static enum err_code bare_fill(float *v, uint32_t w, uint32_t h, struct err *e)
{
    size_t n = (size_t)w * h, missing = 0;
    for (size_t i = 0; i < n; i++)
        missing += !isfinite(v[i]);
    if (!missing || missing == n || (w == 1 && h == 1))
        return ERR_OK;
    uint32_t hw = (w + 1) / 2, hh = (h + 1) / 2;
    float *half = mem_array((size_t)hw * hh, sizeof *half);
    uint8_t *free_cell = mem_array(n, 1);
    enum err_code rc = half && free_cell ? ERR_OK : err_set(e, ERR_MEM, "out of memory for ground");
    for (size_t i = 0; !rc && i < (size_t)hw * hh; i++) {
        float sum = 0;
        int count = 0;
        for (size_t k = 0; k < 4; k++) {
            size_t x = 2 * (i % hw) + k % 2, y = 2 * (i / hw) + k / 2;
            if (x < w && y < h && isfinite(v[y * w + x])) {
                sum += v[y * w + x];
                count++;
            }
        }
        half[i] = count ? sum / (float)count : NAN;
    }
    if (!rc)
        rc = bare_fill(half, hw, hh, e);
    for (size_t i = 0; !rc && i < n; i++) {
        free_cell[i] = (uint8_t)!isfinite(v[i]);
        v[i] = free_cell[i] ? half[i / w / 2 * hw + i % w / 2] : v[i];
    }
    for (int round = 0; !rc && round < BARE_ROUNDS; round++)
        for (size_t i = 0; i < n; i++) {
            size_t x = i % w, y = i / w;
            if (free_cell[i])
                v[i] = 0.25f * (v[x ? i - 1 : i] + v[x + 1 < w ? i + 1 : i] + v[y ? i - w : i] +
                                v[y + 1 < h ? i + w : i]);
        }
    mem_free(half);
    mem_free(free_cell);
    return rc;
}

enum err_code bare_filter(float *height_m, uint32_t w, uint32_t h, double cell_m,
                          const struct bare_rule *r, struct err *e)
{
    size_t n = (size_t)w * h, reach = (size_t)(bare_widest(r) / cell_m) + 2,
           line = (w > h ? w : h) + 2 * reach;
    float *low = mem_array(n, sizeof *low), *room = mem_array(n + 3 * line, sizeof *room);
    enum err_code rc =
        low && room ? ERR_OK : err_set(e, ERR_MEM, "out of memory for %u x %u cells", w, h);
    if (!rc)
        bare_mark(height_m, low, w, h, cell_m, r, room);
    mem_free(low);
    mem_free(room);
    return rc ? rc : bare_fill(height_m, w, h, e);
}

/* ---- of a store ---- */

struct bare {
    uint32_t cell_px, w, h;
    float *height_m; /* [h][w] */
    double pixel_m;
};

static enum err_code bare_begin(void *user, const struct crs *crs, const struct map_grid *g,
                                struct err *e)
{
    struct bare *o = user;
    (void)crs;
    o->pixel_m = g->pixel_m;
    o->cell_px = (uint32_t)fmax(floor(BARE_CELL_M / g->pixel_m + 0.5), 1);
    o->w = (g->width - 1) / o->cell_px + 1;
    o->h = (g->height - 1) / o->cell_px + 1;
    if ((double)o->w * o->h > BARE_CELLS_MAX)
        return err_set(e, ERR_ARG,
                       "bare earth of %u x %u cells of %.2g m: at most %.0f cells; give a smaller "
                       "--bbox",
                       o->w, o->h, o->cell_px * g->pixel_m, BARE_CELLS_MAX);
    o->height_m = mem_array((size_t)o->w * o->h, sizeof *o->height_m);
    if (!o->height_m)
        return err_set(e, ERR_MEM, "out of memory for %u x %u cells", o->w, o->h);
    for (size_t i = 0; i < (size_t)o->w * o->h; i++)
        o->height_m[i] = NAN;
    return ERR_OK;
}

static enum err_code bare_piece(void *user, uint32_t x, uint32_t y, uint32_t w, uint32_t h,
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

enum err_code bare_open(struct nadir *n, const struct map_request *r, const struct bare_rule *rule,
                        struct bare **out, struct err *e)
{
    struct bare *g = *out = mem_array(1, sizeof *g);
    if (!g)
        return err_set(e, ERR_MEM, "out of memory for ground");
    struct map_request map = *r;
    map.kind = GEOTIFF_HEIGHT;
    map.ground = NULL;
    const struct map_visitor v = {"ground, px", g, bare_begin, bare_piece, false};
    enum err_code rc = map_run(n, &map, &v, NULL, e);
    if (!rc)
        rc = bare_filter(g->height_m, g->w, g->h, g->cell_px * g->pixel_m, rule, e);
    if (rc)
        bare_close(out);
    return rc;
}

void bare_close(struct bare **g)
{
    if (!*g)
        return;
    mem_free((*g)->height_m);
    mem_free(*g);
    *g = NULL;
}

float bare_at(const struct bare *g, uint32_t x, uint32_t y)
{
    double u = fmax((x + 0.5) / g->cell_px - 0.5, 0), v = fmax((y + 0.5) / g->cell_px - 0.5, 0);
    size_t x0 = (size_t)u, y0 = (size_t)v, x1 = x0 + 1 < g->w ? x0 + 1 : x0,
           y1 = y0 + 1 < g->h ? y0 + 1 : y0;
    double s = u - (double)x0, t = v - (double)y0;
    const float *a = g->height_m;
    return (float)((1 - t) * ((1 - s) * (double)a[y0 * g->w + x0] + s * (double)a[y0 * g->w + x1]) +
                   t * ((1 - s) * (double)a[y1 * g->w + x0] + s * (double)a[y1 * g->w + x1]));
}

enum bare_class bare_class_of(float above_m, const float *rgb)
{
    float sum = rgb[0] + rgb[1] + rgb[2];
    if (above_m <= (float)BARE_NEAR_M)
        return BARE_GROUND;
    if (2 * rgb[1] - rgb[0] - rgb[2] > bare_green * sum)
        return above_m < bare_low_m     ? BARE_LOW_PLANT
               : above_m < bare_house_m ? BARE_PLANT
                                        : BARE_HIGH_PLANT;
    return above_m < bare_house_m ? BARE_OTHER : BARE_BUILDING;
}
