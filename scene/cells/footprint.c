/* The grid of the footprint: heights from the sparse points, views from the cameras, a
 * mask without specks, distances to its border. footprint_shape.c has its polygons.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/cells/footprint.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/scene/scene.h"
#include "core/math/sort.h"
#include "core/pool.h"
#include "core/splat/camera.h"
#include "scene/cells/footprint_internal.h"

enum {
    FOOTPRINT_SIDE = 256,      /* cells along the longer side, at most */
    FOOTPRINT_SIDE_MANY = 128, /* with many photographs */
    FOOTPRINT_MANY = 2000,
    FOOTPRINT_POINTS_LEAST = 32,
    FOOTPRINT_AROUND = 2, /* heights are those of so many cells around */
    FOOTPRINT_SPECK = 16, /* holes of so few cells are closed */
    FOOTPRINT_ROUNDS = 6, /* to find where a ray meets the ground */
    FOOTPRINT_PAD = 2     /* cells around the grid that are never inside */
};
#define FOOTPRINT_REACH 4.0 /* flight heights around the cameras */
#define FOOTPRINT_COARSER                                                                          \
    4.0 /* ground seen so much more coarsely than the median is not supported */
#define FOOTPRINT_ISLAND 0.02 /* of the area: smaller islands are dropped */
#define FOOTPRINT_MARGIN                                                                           \
    0.15                   /* flight heights above the highest point around and below the lowest */
#define FOOTPRINT_WIDE 2.0 /* a Gaussian may reach so many faded edges out */
#define FOOTPRINT_FADE_CELLS 5.0 /* width of the faded edge */
#define FOOTPRINT_TALL 0.6       /* faded edges from where heights begin to fade to nothing */
#define FOOTPRINT_SIGMAS 2.0     /* a Gaussian reaches so far */

void footprint_free(struct footprint *f)
{
    mem_free(f->inside);
    mem_free(f->edge_m);
    mem_free(f->low_m);
    mem_free(f->high_m);
    mem_free(f->ground_m);
    mem_free(f->views);
    mem_free(f->has_points);
    *f = (struct footprint){0};
}

/* ---- the grid ---- */

/* Quantiles lo and hi of v[0..n), which is sorted. */
static void footprint_range(double *v, size_t n, double share, double *lo, double *hi)
{
    sort_doubles(v, n);
    *lo = v[(size_t)(share * (double)(n - 1))];
    *hi = v[n - 1 - (size_t)(share * (double)(n - 1))];
}

struct footprint_work {
    const struct scene *s;
    struct footprint *f;
    float *px;           /* [ny][nx] finest pixels per metre */
    double (*center)[3]; /* [n_images] */
};

static size_t footprint_count(const struct footprint *f)
{
    return f->nx * f->ny;
}

/* Where to look at all: around the cameras. */
static enum err_code footprint_bounds(struct footprint_work *w, double *scratch, struct err *e)
{
    const struct scene *s = w->s;
    double ground, top, low[2], high[2];
    for (size_t i = 0; i < s->n_points; i++)
        scratch[i] = s->points[i].enu_m[2];
    footprint_range(scratch, s->n_points, 0.5, &ground, &top);
    double cam_low[3] = {HUGE_VAL, HUGE_VAL, HUGE_VAL}, cam_high[3] = {-HUGE_VAL, -HUGE_VAL, 0};
    for (size_t i = 0; i < s->n_images; i++)
        for (int a = 0; a < 2; a++) {
            cam_low[a] = fmin(cam_low[a], w->center[i][a]);
            cam_high[a] = fmax(cam_high[a], w->center[i][a]);
        }
    double *h = mem_array(s->n_images, sizeof *h);
    if (!h)
        return err_set(e, ERR_MEM, "footprint: out of memory for %zu photographs", s->n_images);
    for (size_t i = 0; i < s->n_images; i++)
        h[i] = fabs(w->center[i][2] - ground);
    footprint_range(h, s->n_images, 0.5, &w->f->height_m, &top);
    mem_free(h);
    /* Cells are no finer than the points are apart; where there are none, the ground goes on. */
    double reach = FOOTPRINT_REACH * w->f->height_m, side = 0.0, area = 1.0;
    for (int a = 0; a < 2; a++) {
        for (size_t i = 0; i < s->n_points; i++)
            scratch[i] = s->points[i].enu_m[a];
        footprint_range(scratch, s->n_points, 0.01, &low[a], &high[a]);
        area *= fmax(high[a] - low[a], 1e-3);
        low[a] = cam_low[a] - reach;
        high[a] = cam_high[a] + reach;
        side = fmax(side, high[a] - low[a]);
    }
    struct footprint *f = w->f;
    double most = s->n_images > FOOTPRINT_MANY ? FOOTPRINT_SIDE_MANY : FOOTPRINT_SIDE;
    f->cell_m = fmax(fmax(side, 1e-3) / most, sqrt(area / (double)s->n_points));
    f->nx = (size_t)ceil(fmax(high[0] - low[0], 1e-3) / f->cell_m) + 2 * FOOTPRINT_PAD;
    f->ny = (size_t)ceil(fmax(high[1] - low[1], 1e-3) / f->cell_m) + 2 * FOOTPRINT_PAD;
    for (int a = 0; a < 2; a++)
        f->corner_m[a] = low[a] - FOOTPRINT_PAD * f->cell_m;
    f->fade_m = FOOTPRINT_FADE_CELLS * f->cell_m;
    f->margin_m = FOOTPRINT_MARGIN * w->f->height_m;
    return ERR_OK;
}

static ptrdiff_t footprint_cell(const struct footprint *f, double x_m, double y_m)
{
    double x = floor((x_m - f->corner_m[0]) / f->cell_m),
           y = floor((y_m - f->corner_m[1]) / f->cell_m);
    if (!(x >= 0.0 && y >= 0.0 && x < (double)f->nx && y < (double)f->ny))
        return -1;
    return (ptrdiff_t)y * (ptrdiff_t)f->nx + (ptrdiff_t)x;
}

/* ---- heights ---- */

/* Mean of the neighbours of cell i that know their heights; false: none does. */
static bool footprint_mean(const struct footprint *f, float *const v[3], size_t i, float out[3])
{
    ptrdiff_t x = (ptrdiff_t)(i % f->nx), y = (ptrdiff_t)(i / f->nx);
    float sum[3] = {0};
    int found = 0;
    for (ptrdiff_t b = y - 1; b <= y + 1; b++)
        for (ptrdiff_t a = x - 1; a <= x + 1; a++) {
            size_t j = (size_t)(b * (ptrdiff_t)f->nx + a);
            if (a < 0 || b < 0 || a >= (ptrdiff_t)f->nx || b >= (ptrdiff_t)f->ny || isnan(v[0][j]))
                continue;
            for (int k = 0; k < 3; k++)
                sum[k] += v[k][j];
            found++;
        }
    for (int k = 0; k < 3 && found; k++)
        out[k] = sum[k] / (float)found;
    return found > 0;
}

/* A cell that has no points takes the mean of its neighbours that know theirs, ring by ring. */
static enum err_code footprint_fill(const struct footprint *f, float *v[3], struct err *e)
{
    size_t n = footprint_count(f), left = 0, before = 0;
    float *next = mem_array(3 * n, sizeof *next);
    uint32_t *cell = mem_array(n, sizeof *cell); /* those that do not know theirs, ascending */
    if (!next || !cell) {
        mem_free(next);
        mem_free(cell);
        return err_set(e, ERR_MEM, "footprint: out of memory");
    }
    for (size_t i = 0; i < n; i++)
        if (isnan(v[0][i]))
            cell[left++] = (uint32_t)i;
    while (left && left < n && left != before) {
        before = left;
        left = 0;
        for (size_t k = 0; k < before; k++)
            if (!footprint_mean(f, v, cell[k], next + 3 * k))
                next[3 * k] = NAN;
        for (size_t k = 0; k < before; k++) {
            size_t i = cell[k];
            if (isnan(next[3 * k]))
                cell[left++] = (uint32_t)i;
            else
                for (int a = 0; a < 3; a++)
                    v[a][i] = next[3 * k + (size_t)a];
        }
    }
    mem_free(next);
    mem_free(cell);
    return ERR_OK;
}

/* Least (sign -1) or largest (1) value of the cells around. */
static enum err_code footprint_widen(const struct footprint *f, float *v, float sign, struct err *e)
{
    size_t n = footprint_count(f);
    ptrdiff_t nx = (ptrdiff_t)f->nx, ny = (ptrdiff_t)f->ny, r = FOOTPRINT_AROUND;
    float *from = mem_array(n, sizeof *from);
    if (!from)
        return err_set(e, ERR_MEM, "footprint: out of memory");
    memcpy(from, v, n * sizeof *v);
    for (ptrdiff_t y = 0; y < ny; y++)
        for (ptrdiff_t x = 0; x < nx; x++)
            for (ptrdiff_t b = y - r; b <= y + r; b++)
                for (ptrdiff_t a = x - r; a <= x + r; a++) {
                    if (a < 0 || b < 0 || a >= nx || b >= ny)
                        continue;
                    float *at = &v[y * nx + x], other = from[b * nx + a];
                    *at = sign * other > sign * *at ? other : *at;
                }
    mem_free(from);
    return ERR_OK;
}

struct footprint_height {
    size_t cell;
    double z_m;
};
static int footprint_height_compare(const void *a, const void *b)
{
    const struct footprint_height *p = a, *q = b;
    if (p->cell != q->cell)
        return p->cell < q->cell ? -1 : 1;
    return (p->z_m > q->z_m) - (p->z_m < q->z_m);
}

static enum err_code footprint_heights(struct footprint_work *w, struct err *e)
{
    struct footprint *f = w->f;
    size_t n = 0, cells = footprint_count(f);
    struct footprint_height *h = mem_array(w->s->n_points, sizeof *h);
    if (!h)
        return err_set(e, ERR_MEM, "footprint: out of memory for %zu points", w->s->n_points);
    for (size_t i = 0; i < w->s->n_points; i++) {
        const double *x = w->s->points[i].enu_m;
        ptrdiff_t c = footprint_cell(f, x[0], x[1]);
        if (c >= 0)
            h[n++] = (struct footprint_height){(size_t)c, x[2]};
    }
    qsort(h, n, sizeof *h, footprint_height_compare);
    for (size_t i = 0; i < cells; i++)
        f->ground_m[i] = f->low_m[i] = f->high_m[i] = NAN;
    for (size_t i = 0, end; i < n; i = end) {
        for (end = i; end < n && h[end].cell == h[i].cell;)
            end++;
        f->low_m[h[i].cell] = (float)h[i].z_m;
        f->high_m[h[i].cell] = (float)h[end - 1].z_m;
        f->ground_m[h[i].cell] = (float)h[i + (end - i) / 4].z_m; /* the ground, not the roofs */
        f->has_points[h[i].cell] = 1;
    }
    mem_free(h);
    float *all[3] = {f->ground_m, f->low_m, f->high_m};
    enum err_code rc = footprint_fill(f, all, e);
    if (!rc)
        rc = footprint_widen(f, f->low_m, -1.0f, e);
    if (!rc)
        rc = footprint_widen(f, f->high_m, 1.0f, e);
    for (size_t i = 0; i < cells; i++) {
        f->low_m[i] -= (float)(f->margin_m);
        f->high_m[i] += (float)(f->margin_m);
    }
    return rc;
}

/* ---- what the photographs see ---- */

static void footprint_look(struct footprint_work *w, size_t cell, const double x[3])
{
    double depth, px = 0.0;
    size_t views = 0;
    for (size_t i = 0; i < w->s->n_images; i++) {
        const struct scene_image *image = &w->s->images[i];
        if (image->split == SCENE_TRAIN && camera_frames(&image->cam, x, 0.0, &depth)) {
            views++;
            px = fmax(px, image->cam.fx_px / depth);
        }
    }
    w->f->views[cell] = (uint16_t)(views < UINT16_MAX ? views : UINT16_MAX);
    w->px[cell] = (float)px;
}

static enum err_code footprint_row_task(void *user, size_t row, struct err *e)
{
    (void)e;
    struct footprint_work *w = user;
    const struct footprint *f = w->f;
    for (size_t k = 0; k < f->nx; k++) {
        size_t i = row * f->nx + k;
        double x[3] = {f->corner_m[0] + ((double)k + 0.5) * f->cell_m,
                       f->corner_m[1] + ((double)row + 0.5) * f->cell_m, (double)w->f->ground_m[i]};
        if (k >= FOOTPRINT_PAD && row >= FOOTPRINT_PAD && k + FOOTPRINT_PAD < f->nx &&
            row + FOOTPRINT_PAD < f->ny)
            footprint_look(w, i, x);
    }
    return ERR_OK;
}

/* Cells seen well enough, but those that are seen much more coarsely than the others. */
static size_t footprint_mark(struct footprint_work *w, double *scratch)
{
    struct footprint *f = w->f;
    size_t n = 0, left = 0, cells = footprint_count(f);
    double least, high;
    for (size_t i = 0; i < cells; i++) {
        f->inside[i] = f->views[i] >= FOOTPRINT_VIEWS;
        if (f->inside[i])
            scratch[n++] = (double)w->px[i];
    }
    if (!n)
        return 0;
    footprint_range(scratch, n, 0.5, &least, &high);
    f->px_per_m = least;
    for (size_t i = 0; i < cells; i++) {
        f->inside[i] = f->inside[i] && (double)w->px[i] * FOOTPRINT_COARSER >= f->px_per_m;
        left += f->inside[i];
    }
    return left;
}

/* ---- without specks ---- */

/* Mark the cells that hang together with `start` in `seen`; how many there are. */
static size_t footprint_flood(const struct footprint *f, size_t start, uint8_t *seen, size_t *stack)
{
    size_t n = 0, depth = 0;
    uint8_t kind = f->inside[start];
    stack[depth++] = start;
    seen[start] = 1;
    while (depth) {
        size_t i = stack[depth - 1], x = i % f->nx, y = i / f->nx;
        depth--;
        n++;
        const size_t next[4] = {x ? i - 1 : i, x + 1 < f->nx ? i + 1 : i, y ? i - f->nx : i,
                                y + 1 < f->ny ? i + f->nx : i};
        for (int k = 0; k < 4; k++)
            if (!seen[next[k]] && f->inside[next[k]] == kind) {
                seen[next[k]] = 1;
                stack[depth++] = next[k];
            }
    }
    return n;
}

/* Turn regions that are too small: holes into ground, islands into nothing. */
static enum err_code footprint_clean(struct footprint *f, size_t area, struct err *e)
{
    size_t n = footprint_count(f);
    uint8_t *seen = mem_array(n, 1), *part = mem_array(n, 1);
    size_t *stack = mem_array(n, sizeof *stack);
    enum err_code rc =
        seen && part && stack ? ERR_OK : err_set(e, ERR_MEM, "footprint: out of memory");
    for (size_t i = 0; !rc && i < n; i++) {
        if (seen[i])
            continue;
        uint8_t kind = f->inside[i];
        size_t size = footprint_flood(f, i, seen, stack);
        if (kind ? (double)size >= FOOTPRINT_ISLAND * (double)area : size > FOOTPRINT_SPECK)
            continue;
        memset(part, 0, n);
        footprint_flood(f, i, part, stack);
        for (size_t k = 0; k < n; k++)
            if (part[k])
                f->inside[k] = !kind;
    }
    mem_free(seen);
    mem_free(part);
    mem_free(stack);
    return rc;
}

/* ---- distances ---- */

/* Squared distances of a line's cells to the nearest of those with value 0, given their squared
 * distances across it: lower envelope of parabolas (Felzenszwalb and Huttenlocher 2012). */
static void footprint_line(const double *v, size_t n, size_t *at, double *from, double *out)
{
    size_t k = 0;
    at[0] = 0;
    from[0] = -HUGE_VAL;
    from[1] = HUGE_VAL;
    for (size_t q = 1; q < n; q++) {
        double s;
        for (;;) {
            double p = (double)at[k], d = (double)q;
            s = ((v[q] + d * d) - (v[at[k]] + p * p)) / (2.0 * (d - p));
            if (s > from[k] || k == 0)
                break;
            k--;
        }
        if (s <= from[k]) /* k == 0: nothing of it is left */
            at[0] = q;
        else {
            at[++k] = q;
            from[k] = s;
        }
        from[k + 1] = HUGE_VAL;
    }
    for (size_t q = 0, i = 0; q < n; q++) {
        while (from[i + 1] < (double)q)
            i++;
        double d = (double)q - (double)at[i];
        out[q] = d * d + v[at[i]];
    }
}

/* Distances of all cells to the nearest one of `kind`, in cells. */
static void footprint_distance(const struct footprint *f, uint8_t kind, double *d2, double *line,
                               size_t *at)
{
    size_t longest = f->nx > f->ny ? f->nx : f->ny;
    double *out = line + longest, *from = out + longest;
    for (size_t i = 0; i < footprint_count(f); i++)
        d2[i] = f->inside[i] == kind ? 0.0 : 1e12;
    for (size_t x = 0; x < f->nx; x++) {
        for (size_t y = 0; y < f->ny; y++)
            line[y] = d2[y * f->nx + x];
        footprint_line(line, f->ny, at, from, out);
        for (size_t y = 0; y < f->ny; y++)
            d2[y * f->nx + x] = out[y];
    }
    for (size_t y = 0; y < f->ny; y++) {
        memcpy(line, d2 + y * f->nx, f->nx * sizeof *line);
        footprint_line(line, f->nx, at, from, out);
        memcpy(d2 + y * f->nx, out, f->nx * sizeof *line);
    }
}

enum err_code footprint_measure(struct footprint *f, struct err *e)
{
    size_t n = footprint_count(f), longest = f->nx > f->ny ? f->nx : f->ny;
    double *out = mem_array(n, sizeof *out), *in = mem_array(n, sizeof *in);
    double *line = mem_array(3 * longest + 2, sizeof *line);
    size_t *at = mem_array(longest + 1, sizeof *at);
    enum err_code rc =
        out && in && line && at ? ERR_OK : err_set(e, ERR_MEM, "footprint: out of memory");
    if (!rc) {
        footprint_distance(f, 1, out, line, at);
        footprint_distance(f, 0, in, line, at);
    }
    for (size_t i = 0; !rc && i < n; i++) /* the border is half a cell from both middles */
        f->edge_m[i] = (float)(f->cell_m * (f->inside[i] ? 0.5 - sqrt(in[i]) : sqrt(out[i]) - 0.5));
    mem_free(out);
    mem_free(in);
    mem_free(line);
    mem_free(at);
    return rc;
}

/* ---- the whole ---- */

static enum err_code footprint_alloc(struct footprint_work *w, struct err *e)
{
    struct footprint *f = w->f;
    size_t n = footprint_count(f);
    f->inside = mem_array(n, 1);
    f->edge_m = mem_array(n, sizeof *f->edge_m);
    f->low_m = mem_array(n, sizeof *f->low_m);
    f->high_m = mem_array(n, sizeof *f->high_m);
    f->ground_m = mem_array(n, sizeof *f->ground_m);
    f->views = mem_array(n, sizeof *f->views);
    f->has_points = mem_array(n, 1);
    w->px = mem_array(n, sizeof *w->px);
    if (f->inside && f->edge_m && f->low_m && f->high_m && f->ground_m && f->views &&
        f->has_points && w->px)
        return ERR_OK;
    return err_set(e, ERR_MEM, "footprint: out of memory for %zu cells", n);
}

static enum err_code footprint_make(struct footprint_work *w, double *scratch, struct err *e)
{
    size_t area = 0;
    enum err_code rc = footprint_bounds(w, scratch, e);
    if (!rc)
        rc = footprint_alloc(w, e);
    if (!rc)
        rc = footprint_heights(w, e);
    if (!rc)
        rc = pool_for(w->f->ny, 0, footprint_row_task, w, e);
    double *px = rc ? NULL : mem_array(footprint_count(w->f), sizeof *px);
    if (!rc && !px)
        rc = err_set(e, ERR_MEM, "footprint: out of memory");
    if (!rc)
        area = footprint_mark(w, px);
    mem_free(px);
    if (!rc && area)
        rc = footprint_clean(w->f, area, e);
    if (!rc && area)
        rc = footprint_measure(w->f, e);
    if (!rc && !area)
        footprint_free(w->f);
    return rc;
}

enum err_code footprint_of(const struct scene *s, struct footprint *out, struct err *e)
{
    struct footprint_work w = {.s = s, .f = out};
    enum err_code rc = ERR_OK;
    *out = (struct footprint){0};
    if (s->n_points >= FOOTPRINT_POINTS_LEAST && s->n_images >= FOOTPRINT_VIEWS) {
        double *scratch = mem_array(s->n_points, sizeof *scratch);
        w.center = mem_array(s->n_images, sizeof *w.center);
        if (!scratch || !w.center)
            rc = err_set(e, ERR_MEM, "footprint: out of memory for %zu points", s->n_points);
        for (size_t i = 0; !rc && i < s->n_images; i++)
            camera_center(&s->images[i].cam, w.center[i]);
        if (!rc)
            rc = footprint_make(&w, scratch, e);
        mem_free(scratch);
    }
    mem_free(w.center);
    mem_free(w.px);
    if (rc)
        footprint_free(out);
    else if (!out->nx)
        log_warn("footprint",
                 "no ground is seen by %d photographs: nothing is known of what they support",
                 FOOTPRINT_VIEWS);
    return rc;
}

/* ---- a Gaussian ---- */

/* Of a grid at a place inside of it, between the middles of cells. */
static double footprint_at(const struct footprint *f, const float *v, double x, double y)
{
    double cx = fmax(0.0, fmin(x - 0.5, (double)f->nx - 1.0)),
           cy = fmax(0.0, fmin(y - 0.5, (double)f->ny - 1.0));
    size_t i = (size_t)cx, j = (size_t)cy;
    i = i + 2 > f->nx ? f->nx - 2 : i;
    j = j + 2 > f->ny ? f->ny - 2 : j;
    double a = cx - (double)i, b = cy - (double)j;
    const float *p = v + j * f->nx + i;
    return (1.0 - b) * ((1.0 - a) * (double)p[0] + a * (double)p[1]) +
           b * ((1.0 - a) * (double)p[f->nx] + a * (double)p[f->nx + 1]);
}

/* 1 up to the border, 0 from the end of the faded edge on. */
static double footprint_fade(double beyond_m, double fade_m)
{
    double t = fmax(0.0, fmin(beyond_m / fade_m, 1.0));
    return 1.0 - t * t * (3.0 - 2.0 * t);
}

bool footprint_is_deep(const struct footprint *f, size_t cell)
{
    return f->inside[cell] && f->views[cell] >= FOOTPRINT_DEEP_VIEWS &&
           (double)f->edge_m[cell] <= -FOOTPRINT_DEEP * f->height_m;
}

bool footprint_has(const struct footprint *f, const double x_m[3])
{
    ptrdiff_t i = f->nx ? footprint_cell(f, x_m[0], x_m[1]) : -1;
    return i >= 0 && f->inside[i];
}

double footprint_off(const struct footprint *f, const double x_m[3])
{
    ptrdiff_t i = f->nx ? footprint_cell(f, x_m[0], x_m[1]) : -1;
    if (i < 0)
        return -HUGE_VAL;
    double over = x_m[2] - ((double)f->high_m[i] - f->margin_m),
           under = (double)f->low_m[i] + f->margin_m - x_m[2];
    return fmax(over, under);
}

void footprint_ray(const struct camera *c, double x_px, double y_px, double ray[3])
{
    double x = (x_px + 0.5 - c->cx_px) / c->fx_px, y = (y_px + 0.5 - c->cy_px) / c->fy_px;
    for (int a = 0; a < 3; a++)
        ray[a] = c->rot[a] * x + c->rot[3 + a] * y + c->rot[6 + a];
}

ptrdiff_t footprint_meets(const struct footprint *f, const double from_m[3], const double ray[3])
{
    ptrdiff_t i = f->nx ? footprint_cell(f, from_m[0], from_m[1]) : -1;
    double ground_m = i < 0 ? 0.0 : (double)f->ground_m[i];
    if (i < 0 || !(ray[2] < 0.0))
        return -1;
    for (int k = 0; k < FOOTPRINT_ROUNDS && i >= 0; k++) {
        /* Where it is as high as the ground there; found when it is the cell that was tried. */
        double t = (ground_m - from_m[2]) / ray[2];
        ptrdiff_t at = footprint_cell(f, from_m[0] + t * ray[0], from_m[1] + t * ray[1]);
        if (at == i)
            break;
        i = at;
        ground_m = i < 0 ? 0.0 : (double)f->ground_m[i];
    }
    return i;
}

double footprint_weight(const struct footprint *f, const double mean_m[3], const double cov[9])
{
    if (!f->nx)
        return 1.0;
    double x = (mean_m[0] - f->corner_m[0]) / f->cell_m,
           y = (mean_m[1] - f->corner_m[1]) / f->cell_m;
    if (!(x >= 0.0 && y >= 0.0 && x <= (double)f->nx && y <= (double)f->ny))
        return 0.0;
    double wide = FOOTPRINT_SIGMAS * sqrt(fmax(fmax(cov[0], cov[4]), 0.0)),
           tall = fmax(FOOTPRINT_SIGMAS * sqrt(fmax(cov[8], 0.0)) - f->margin_m, 0.0);
    double out = footprint_at(f, f->edge_m, x, y) + fmax(wide - FOOTPRINT_WIDE * f->fade_m, 0.0);
    size_t cell =
        (size_t)fmin(y, (double)f->ny - 1.0) * f->nx + (size_t)fmin(x, (double)f->nx - 1.0);
    double over = mean_m[2] - (double)f->high_m[cell] + tall,
           under = (double)f->low_m[cell] - mean_m[2] + tall;
    return footprint_fade(out, f->fade_m) *
           footprint_fade(fmax(over, under), FOOTPRINT_TALL * f->fade_m);
}
