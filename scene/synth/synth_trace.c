/* Rays into the city: a uniform grid over the ground plane, traversed cell by cell (Amanatides and
 * Woo 1987). Each cell has the height of its tallest solid, so rays high above the roofs skip whole
 * cells.
 *
 * Solids are boxes, gabled houses (a box cut by two slopes) and ellipsoids, each in a frame rotated
 * about z. The ground is the infinite plane z = 0.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "scene/synth/synth.h"

static const double far_m = 1e9;

/* ---- the grid ---- */

static double trace_solid_reach(const struct synth_solid *s, int axis)
{
    double c = fabs(s->cos_yaw), n = fabs(s->sin_yaw);
    if (s->kind == SYNTH_ELLIPSOID)
        return fmax(s->half_m[0], s->half_m[1]);
    return axis == 0 ? c * s->half_m[0] + n * s->half_m[1] : n * s->half_m[0] + c * s->half_m[1];
}

static uint32_t trace_cell_of(const struct synth_grid *g, int axis, double v)
{
    double i = floor((v - g->min_m[axis]) / g->cell_m);
    uint32_t n = axis ? g->ny : g->nx;
    return !(i > 0) ? 0 : i >= n ? n - 1 : (uint32_t)i;
}

/* Call for every cell a solid touches: count (items NULL) or store. */
static void trace_cells_visit(struct synth_grid *g, uint32_t index, uint32_t *fill)
{
    const struct synth_solid *s = &g->solids[index];
    uint32_t lo[2], hi[2];
    for (int a = 0; a < 2; a++) {
        double r = trace_solid_reach(s, a) + 1e-6;
        lo[a] = trace_cell_of(g, a, s->center_m[a] - r);
        hi[a] = trace_cell_of(g, a, s->center_m[a] + r);
    }
    for (uint32_t j = lo[1]; j <= hi[1]; j++)
        for (uint32_t i = lo[0]; i <= hi[0]; i++) {
            size_t cell = (size_t)j * g->nx + i;
            if (!fill) {
                g->start[cell + 1]++;
                g->cell_top_m[cell] = fmaxf(g->cell_top_m[cell], (float)s->ridge_m + 1e-3f);
            } else
                g->items[fill[cell]++] = index;
        }
}

static void trace_grid_size(struct synth_grid *g, size_t n)
{
    double max[2] = {-far_m, -far_m};
    g->min_m[0] = g->min_m[1] = far_m;
    for (size_t k = 0; k < n; k++)
        for (int a = 0; a < 2; a++) {
            double r = trace_solid_reach(&g->solids[k], a);
            g->min_m[a] = fmin(g->min_m[a], g->solids[k].center_m[a] - r);
            max[a] = fmax(max[a], g->solids[k].center_m[a] + r);
            g->top_m = fmax(g->top_m, g->solids[k].ridge_m);
        }
    if (n == 0)
        g->min_m[0] = g->min_m[1] = max[0] = max[1] = 0;
    g->cell_m = fmax(4, fmax(max[0] - g->min_m[0], max[1] - g->min_m[1]) / 2048);
    g->nx = 1 + (uint32_t)((max[0] - g->min_m[0]) / g->cell_m);
    g->ny = 1 + (uint32_t)((max[1] - g->min_m[1]) / g->cell_m);
}

enum err_code synth_grid_make(const struct synth_solid *solids, size_t n, struct synth_grid *out,
                              struct err *e)
{
    struct synth_grid g = {.solids = solids};
    trace_grid_size(&g, n);
    size_t cells = (size_t)g.nx * g.ny;
    g.start = mem_array(cells + 1, sizeof *g.start);
    g.cell_top_m = mem_array(cells, sizeof *g.cell_top_m);
    uint32_t *fill = mem_array(cells, sizeof *fill);
    enum err_code rc = ERR_MEM;
    if (!g.start || !g.cell_top_m || !fill)
        goto out;
    for (size_t k = 0; k < n; k++)
        trace_cells_visit(&g, (uint32_t)k, NULL);
    for (size_t c = 0; c < cells; c++) {
        g.start[c + 1] += g.start[c];
        fill[c] = g.start[c];
    }
    g.items = mem_array(g.start[cells], sizeof *g.items);
    if (!g.items)
        goto out;
    for (size_t k = 0; k < n; k++)
        trace_cells_visit(&g, (uint32_t)k, fill);
    rc = ERR_OK;
out:
    mem_free(fill);
    if (rc) {
        synth_grid_free(&g);
        return err_set(e, rc, "synth: out of memory for a grid of %zu cells", cells);
    }
    *out = g;
    return ERR_OK;
}

void synth_grid_free(struct synth_grid *g)
{
    mem_free(g->start);
    mem_free(g->items);
    mem_free(g->cell_top_m);
    *g = (struct synth_grid){0};
}

/* ---- one solid ---- */

struct span { /* of a ray inside a convex body, with the normal where it enters */
    double enter, leave, normal[3];
};

/* Keep the part of the span on the inner side of the plane normal . p <= offset. */
static bool trace_span_clip(struct span *s, const double o[3], const double d[3], double nx,
                            double ny, double nz, double offset)
{
    double dist = nx * o[0] + ny * o[1] + nz * o[2] - offset;
    double rate = nx * d[0] + ny * d[1] + nz * d[2];
    if (rate == 0)
        return dist <= 0;
    double t = -dist / rate;
    if (rate < 0) {
        if (t > s->enter) {
            s->enter = t;
            s->normal[0] = nx;
            s->normal[1] = ny;
            s->normal[2] = nz;
        }
    } else if (t < s->leave)
        s->leave = t;
    return s->enter < s->leave;
}

static bool trace_box_span(const struct synth_solid *s, const double o[3], const double d[3],
                           struct span *out)
{
    *out = (struct span){.enter = -far_m, .leave = far_m};
    if (!trace_span_clip(out, o, d, 1, 0, 0, s->half_m[0]) ||
        !trace_span_clip(out, o, d, -1, 0, 0, s->half_m[0]) ||
        !trace_span_clip(out, o, d, 0, 1, 0, s->half_m[1]) ||
        !trace_span_clip(out, o, d, 0, -1, 0, s->half_m[1]) ||
        !trace_span_clip(out, o, d, 0, 0, 1, s->ridge_m) ||
        !trace_span_clip(out, o, d, 0, 0, -1, -s->z0_m))
        return false;
    if (s->kind != SYNTH_GABLE)
        return true;
    /* Slopes through the eaves (|y| = half, z1) and the ridge (y = 0). */
    double run = s->half_m[1], up = s->ridge_m - s->z1_m, len = sqrt(run * run + up * up);
    double ny = up / len, nz = run / len, offset = nz * s->ridge_m;
    return trace_span_clip(out, o, d, 0, ny, nz, offset) &&
           trace_span_clip(out, o, d, 0, -ny, nz, offset);
}

static bool trace_ellipsoid_span(const struct synth_solid *s, const double o[3], const double d[3],
                                 struct span *out)
{
    double hz = 0.5 * (s->z1_m - s->z0_m), cz = 0.5 * (s->z1_m + s->z0_m);
    const double inv[3] = {1 / s->half_m[0], 1 / s->half_m[1], 1 / hz};
    double p[3] = {o[0] * inv[0], o[1] * inv[1], (o[2] - cz) * inv[2]}, q[3], a = 0, b = 0, c = -1;
    for (int i = 0; i < 3; i++) {
        q[i] = d[i] * inv[i];
        a += q[i] * q[i];
        b += p[i] * q[i];
        c += p[i] * p[i];
    }
    double disc = b * b - a * c;
    if (!(disc > 0))
        return false;
    double root = sqrt(disc), len = 0;
    out->enter = (-b - root) / a;
    out->leave = (-b + root) / a;
    for (int i = 0; i < 3; i++) {
        out->normal[i] = (p[i] + out->enter * q[i]) * inv[i];
        len += out->normal[i] * out->normal[i];
    }
    len = 1 / sqrt(len);
    for (int i = 0; i < 3; i++)
        out->normal[i] *= len;
    return true;
}

static bool trace_solid_span(const struct synth_solid *s, const double o[3], const double d[3],
                             struct span *out)
{
    double rx = o[0] - s->center_m[0], ry = o[1] - s->center_m[1], c = s->cos_yaw, n = s->sin_yaw;
    const double lo[3] = {c * rx + n * ry, -n * rx + c * ry, o[2]};
    const double ld[3] = {c * d[0] + n * d[1], -n * d[0] + c * d[1], d[2]};
    return s->kind == SYNTH_ELLIPSOID ? trace_ellipsoid_span(s, lo, ld, out)
                                      : trace_box_span(s, lo, ld, out);
}

/* ---- the walk ---- */

struct walk {
    int64_t cell[2], step[2];
    double t, t_end, next[2], delta[2];
};

/* The stretch of the ray over the grid and below the tallest solid; false when there is none. */
static bool trace_walk_start(const struct synth_grid *g, const double o[3], const double d[3],
                             double t_end, struct walk *w)
{
    double lo = 0, hi = t_end;
    const double size[2] = {g->nx * g->cell_m, g->ny * g->cell_m};
    for (int a = 0; a < 2; a++) {
        double p = o[a] - g->min_m[a];
        if (d[a] == 0) {
            if (p < 0 || p > size[a])
                return false;
            continue;
        }
        double t0 = -p / d[a], t1 = (size[a] - p) / d[a];
        lo = fmax(lo, fmin(t0, t1));
        hi = fmin(hi, fmax(t0, t1));
    }
    double t_top = d[2] != 0 ? (g->top_m - o[2]) / d[2] : far_m;
    if (d[2] < 0)
        lo = fmax(lo, t_top);
    else if (o[2] > g->top_m)
        return false;
    else if (d[2] > 0)
        hi = fmin(hi, t_top);
    if (!(lo < hi))
        return false;
    w->t = lo;
    w->t_end = hi;
    for (int a = 0; a < 2; a++) {
        double p = o[a] - g->min_m[a] + lo * d[a];
        uint32_t n = a ? g->ny : g->nx;
        double i = floor(p / g->cell_m);
        w->cell[a] = i < 0 ? 0 : i >= n ? n - 1 : (int64_t)i;
        w->step[a] = d[a] > 0 ? 1 : -1;
        if (d[a] == 0) {
            w->next[a] = w->delta[a] = far_m;
            continue;
        }
        w->delta[a] = g->cell_m / fabs(d[a]);
        w->next[a] = ((double)(w->cell[a] + (d[a] > 0)) * g->cell_m + g->min_m[a] - o[a]) / d[a];
    }
    return true;
}

/* Nearest solid of one grid with enter in (t_min, *t); updates *t, *best, span. With `any` the
 * first will do. */
static void trace_grid_trace(const struct synth_grid *g, const double o[3], const double d[3],
                             double *t, const struct synth_solid **best, struct span *span,
                             bool any)
{
    struct walk w;
    if (!g->start || !trace_walk_start(g, o, d, *t, &w))
        return;
    while (w.cell[0] >= 0 && w.cell[1] >= 0 && w.cell[0] < g->nx && w.cell[1] < g->ny) {
        size_t cell = (size_t)w.cell[1] * g->nx + (size_t)w.cell[0];
        double t_out = w.next[0] < w.next[1] ? w.next[0] : w.next[1];
        double z_low = o[2] + (d[2] < 0 ? (t_out < w.t_end ? t_out : w.t_end) : w.t) * d[2];
        if (z_low < (double)g->cell_top_m[cell])
            for (uint32_t k = g->start[cell]; k < g->start[cell + 1]; k++) {
                struct span s;
                const struct synth_solid *solid = &g->solids[g->items[k]];
                if (z_low >= solid->ridge_m) /* the ray leaves the cell before it is that low */
                    continue;
                if (trace_solid_span(solid, o, d, &s) && s.enter > 1e-9 && s.enter < *t) {
                    *t = s.enter;
                    *best = solid;
                    *span = s;
                    if (any)
                        return;
                }
            }
        if (*t <= t_out || t_out >= w.t_end)
            return;
        int a = w.next[0] < w.next[1] ? 0 : 1;
        w.t = w.next[a];
        w.next[a] += w.delta[a];
        w.cell[a] += w.step[a];
    }
}

void synth_trace_ray(const struct synth_city *c, const struct synth_grid *moving,
                     const double origin[3], const double dir[3], struct synth_hit *out)
{
    const struct synth_solid *best = NULL;
    struct span span = {0};
    double t = dir[2] < 0 && origin[2] > 0 ? -origin[2] / dir[2] : HUGE_VAL;
    double ground = t;
    trace_grid_trace(&c->grid, origin, dir, &t, &best, &span, false);
    if (moving)
        trace_grid_trace(moving, origin, dir, &t, &best, &span, false);
    *out = (struct synth_hit){.t_m = t, .solid = best};
    if (!best && !isfinite(ground))
        return;
    for (int i = 0; i < 3; i++)
        out->pos[i] = origin[i] + t * dir[i];
    if (!best) {
        out->normal[2] = out->local_normal[2] = 1;
        out->pos[2] = 0;
        memcpy(out->local, out->pos, sizeof out->local);
        return;
    }
    double rx = out->pos[0] - best->center_m[0], ry = out->pos[1] - best->center_m[1];
    double cs = best->cos_yaw, sn = best->sin_yaw;
    out->local[0] = cs * rx + sn * ry;
    out->local[1] = -sn * rx + cs * ry;
    out->local[2] = out->pos[2] - best->z0_m;
    memcpy(out->local_normal, span.normal, sizeof span.normal);
    out->normal[0] = cs * span.normal[0] - sn * span.normal[1];
    out->normal[1] = sn * span.normal[0] + cs * span.normal[1];
    out->normal[2] = span.normal[2];
}

bool synth_trace_shadow(const struct synth_city *c, const struct synth_grid *moving,
                        const double origin[3])
{
    const struct synth_solid *best = NULL;
    struct span span;
    double t = HUGE_VAL;
    trace_grid_trace(&c->grid, origin, c->sun, &t, &best, &span, true);
    if (!best && moving)
        trace_grid_trace(moving, origin, c->sun, &t, &best, &span, true);
    return best != NULL;
}
