/* Bare earth: see bare.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/bare.h"

#include <math.h>
#include <string.h>

#include "core/base.h"

enum { BARE_ROUNDS = 30 /* of relaxation, each level */ };
enum bare_mark { BARE_IS, BARE_NOT };
static const double bare_step_m = 0.3; /* what noise and kerbs rise, whatever the square */
static const double bare_most_m = 1;   /* what stands higher above an opening is no ground */
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

static double bare_slope(const struct bare_rule *r)
{
    return r->slope > 0 ? r->slope : BARE_SLOPE;
}

/* The plane's greatest after its least within r: the opening. The other way: the closing. What is
 * outside or INFINITY counts as none. */
static void bare_open_plane(float *v, uint32_t w, uint32_t h, size_t r, float *room)
{
    bare_plane_least(v, w, h, r, room);
    bare_negate(v, (size_t)w * h);
    bare_plane_least(v, w, h, r, room);
    bare_negate(v, (size_t)w * h);
}

static void bare_close_plane(float *v, uint32_t w, uint32_t h, size_t r, float *room)
{
    bare_negate(v, (size_t)w * h);
    bare_open_plane(v, w, h, r, room);
    bare_negate(v, (size_t)w * h);
}

/* Marks cells that are no ground. Pits of a cell or two are closed first: at the border and between
 * other pits they would lower the opened heights around. room: of the opened heights and lines. */
static void bare_mark(const float *height_m, uint8_t *mark, float *low, uint32_t w, uint32_t h,
                      double cell_m, const struct bare_rule *r, float *room)
{
    size_t n = (size_t)w * h, before = 0,
           half = (size_t)fmax(floor(0.5 * bare_widest(r) / cell_m + 0.5), 1);
    double slope = bare_slope(r);
    float *opened = room;
    for (size_t i = 0; i < n; i++)
        low[i] = isfinite(height_m[i]) ? height_m[i] : INFINITY;
    bare_close_plane(low, w, h, 1, room + n);
    for (size_t k = 1; before < half; k = 2 * k < half ? 2 * k : half) {
        double most = fmin(bare_step_m + slope * (double)k * cell_m, bare_most_m);
        memcpy(opened, low, n * sizeof *low);
        bare_open_plane(opened, w, h, k, room + n);
        for (size_t i = 0; i < n; i++)
            if (isfinite(height_m[i]) && (double)(height_m[i] - opened[i]) > most)
                mark[i] = BARE_NOT;
        memcpy(low, opened, n * sizeof *low);
        before = k;
    }
}

/* Takes marks away that gentle slopes connect with ground: tops of hills and heights at the border.
 * queue [w * h]. */
static void bare_grow(const float *height_m, uint8_t *mark, uint32_t w, uint32_t h, double cell_m,
                      const struct bare_rule *r, uint32_t *queue)
{
    size_t n = 0;
    for (size_t i = 0; i < (size_t)w * h; i++)
        if (isfinite(height_m[i]) && mark[i] == BARE_IS)
            queue[n++] = (uint32_t)i;
    for (size_t at = 0; at < n; at++) {
        size_t i = queue[at], x = i % w, y = i / w;
        for (size_t v = y ? y - 1 : 0; v <= y + 1 && v < h; v++)
            for (size_t u = x ? x - 1 : 0; u <= x + 1 && u < w; u++) {
                size_t to = v * w + u;
                double far = cell_m * sqrt((double)(u != x) + (double)(v != y));
                if (mark[to] != BARE_NOT ||
                    (double)(height_m[to] - height_m[i]) > bare_slope(r) * far)
                    continue;
                mark[to] = BARE_IS;
                queue[n++] = (uint32_t)to;
            }
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
    uint8_t *mark = mem_array(n, 1);
    enum err_code rc =
        low && room && mark ? ERR_OK : err_set(e, ERR_MEM, "out of memory for %u x %u cells", w, h);
    if (!rc) {
        bare_mark(height_m, mark, low, w, h, cell_m, r, room);
        bare_grow(height_m, mark, w, h, cell_m, r, (uint32_t *)(void *)low);
    }
    for (size_t i = 0; !rc && i < n; i++)
        if (mark[i] == BARE_NOT)
            height_m[i] = NAN;
    mem_free(low);
    mem_free(room);
    mem_free(mark);
    return rc ? rc : bare_fill(height_m, w, h, e);
}

/* ---- of a map ---- */

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
