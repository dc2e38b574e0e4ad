/* Counts photographs that see the ground: see support.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/cells/support.h"

#include <math.h>
#include <string.h>

#include "codec/container/seen.h"
#include "codec/scene/scene.h"
#include "core/base.h"
#include "core/math/sort.h"
#include "core/pool.h"
#include "core/splat/camera.h"
#include "scene/cells/footprint.h"

#define SUPPORT_OPACITY 0.5
#define SUPPORT_CELL_PX 4.0 /* edge of a cell, in pixels of the nearest photograph */
#define SUPPORT_SIDE 512.0  /* cells along the longer side, at most */
#define SUPPORT_CLEAR 1.0   /* cells by which a surface must rise above a ray to hide its end */
#define SUPPORT_STEP 0.9    /* cells from one look at the way to the next */

void support_free(struct support *s)
{
    mem_free(s->top_m);
    mem_free(s->views);
    *s = (struct support){0};
}

enum err_code support_open(const struct footprint *f, struct support *out, struct err *e)
{
    size_t low[2] = {f->nx, f->ny}, high[2] = {0, 0};
    for (size_t i = 0; i < f->nx * f->ny; i++)
        for (int a = 0; a < 2 && f->inside[i]; a++) {
            size_t at = a ? i / f->nx : i % f->nx;
            low[a] = at < low[a] ? at : low[a];
            high[a] = at + 1 > high[a] ? at + 1 : high[a];
        }
    *out = (struct support){0};
    if (high[0] <= low[0] || !(f->px_per_m > 0.0))
        return ERR_OK;
    double side[2];
    for (int a = 0; a < 2; a++) {
        out->corner_m[a] = f->corner_m[a] + (double)low[a] * f->cell_m;
        side[a] = (double)(high[a] - low[a]) * f->cell_m;
    }
    out->cell_m = fmax(SUPPORT_CELL_PX / f->px_per_m, fmax(side[0], side[1]) / SUPPORT_SIDE);
    out->nx = (size_t)ceil(side[0] / out->cell_m);
    out->ny = (size_t)ceil(side[1] / out->cell_m);
    size_t n = out->nx * out->ny;
    out->top_m = mem_array(n, sizeof *out->top_m);
    out->views = mem_array(n, 1);
    if (!out->top_m || !out->views) {
        support_free(out);
        return err_set(e, ERR_MEM, "out of memory for %zu places that photographs see", n);
    }
    for (size_t i = 0; i < n; i++)
        out->top_m[i] = NAN;
    return ERR_OK;
}

static ptrdiff_t support_cell(const struct support *s, double x_m, double y_m)
{
    double x = floor((x_m - s->corner_m[0]) / s->cell_m),
           y = floor((y_m - s->corner_m[1]) / s->cell_m);
    if (!(x >= 0.0 && y >= 0.0 && x < (double)s->nx && y < (double)s->ny))
        return -1;
    return (ptrdiff_t)y * (ptrdiff_t)s->nx + (ptrdiff_t)x;
}

void support_add(struct support *s, const double mean_m[3], double opacity)
{
    ptrdiff_t at = support_cell(s, mean_m[0], mean_m[1]);
    if (at >= 0 && opacity >= SUPPORT_OPACITY)
        s->top_m[at] = fmaxf(s->top_m[at], (float)mean_m[2]); /* takes no notice of NAN */
}

static void support_smooth_at(struct support *s, const float *from, size_t x, size_t y)
{
    double around[9];
    size_t at = y * s->nx + x, k = 0, higher = 0;
    for (size_t b = y ? y - 1 : 0; b <= y + 1 && b < s->ny; b++)
        for (size_t a = x ? x - 1 : 0; a <= x + 1 && a < s->nx; a++) {
            float z = from[b * s->nx + a];
            if (isfinite(z))
                around[k++] = (double)z;
            higher += z >= from[at] - (float)s->cell_m; /* itself too */
        }
    if (k && (!isfinite(from[at]) || higher == 1))
        s->top_m[at] = (float)sort_median(around, k);
}

/* A column that stands alone, and a cell without a Gaussian, take the median of the nine around. */
static enum err_code support_smooth(struct support *s, struct err *e)
{
    size_t n = s->nx * s->ny;
    float *from = mem_array(n, sizeof *from);
    if (!from)
        return err_set(e, ERR_MEM, "out of memory for %zu places that photographs see", n);
    memcpy(from, s->top_m, n * sizeof *from);
    for (size_t y = 0; y < s->ny; y++)
        for (size_t x = 0; x < s->nx; x++)
            support_smooth_at(s, from, x, y);
    mem_free(from);
    return ERR_OK;
}

struct support_work {
    struct support *s;
    const struct scene *scene;
    double highest_m;
    double (*center_m)[3]; /* [n_images] */
};

/* Whether nothing stands between a place and an eye. */
static bool support_is_clear(const struct support_work *w, const double x_m[3],
                             const double eye_m[3])
{
    const struct support *s = w->s;
    double east = eye_m[0] - x_m[0], north = eye_m[1] - x_m[1], far = hypot(east, north);
    double rise = (eye_m[2] - x_m[2]) / far, step = SUPPORT_STEP * s->cell_m;
    if (!(rise > 0.0))
        return !(far > 0.0); /* straight above */
    for (size_t k = 0;; k++) {
        double at = 1.5 * s->cell_m + (double)k * step;
        if (at >= far)
            return true;
        double z = x_m[2] + at * rise;
        if (z > w->highest_m)
            return true;
        ptrdiff_t cell = support_cell(s, x_m[0] + at * east / far, x_m[1] + at * north / far);
        if (cell < 0)
            return true;
        if ((double)s->top_m[cell] > z + SUPPORT_CLEAR * s->cell_m)
            return false;
    }
}

static enum err_code support_row(void *user, size_t row, struct err *e)
{
    const struct support_work *w = user;
    const struct support *s = w->s;
    (void)e;
    for (size_t k = 0; k < s->nx; k++) {
        size_t at = row * s->nx + k;
        const double x[3] = {s->corner_m[0] + ((double)k + 0.5) * s->cell_m,
                             s->corner_m[1] + ((double)row + 0.5) * s->cell_m,
                             (double)s->top_m[at]};
        uint8_t n = 0;
        for (size_t i = 0; i < w->scene->n_images && isfinite(x[2]) && n < SEEN_VIEWS_MAX; i++) {
            const struct scene_image *image = &w->scene->images[i];
            double depth;
            if (image->split == SCENE_TRAIN && camera_frames(&image->cam, x, 0.0, &depth) &&
                support_is_clear(w, x, w->center_m[i]))
                n++;
        }
        s->views[at] = n;
    }
    return ERR_OK;
}

enum err_code support_count(struct support *s, const struct scene *scene, struct err *e)
{
    struct support_work w = {.s = s, .scene = scene, .highest_m = -HUGE_VAL};
    enum err_code rc = support_smooth(s, e);
    w.center_m = mem_array(scene->n_images + 1, sizeof *w.center_m);
    if (!rc && !w.center_m)
        rc = err_set(e, ERR_MEM, "out of memory for %zu photographs", scene->n_images);
    for (size_t i = 0; !rc && i < scene->n_images; i++)
        camera_center(&scene->images[i].cam, w.center_m[i]);
    for (size_t i = 0; i < s->nx * s->ny; i++)
        w.highest_m = fmax(w.highest_m, (double)s->top_m[i]); /* takes no notice of NAN */
    if (!rc)
        rc = pool_for(s->ny, 0, support_row, &w, e);
    mem_free(w.center_m);
    return rc;
}

enum err_code support_write(const struct support *s, struct buf *out, struct err *e)
{
    const struct seen_grid seen = {.corner_m = {s->corner_m[0], s->corner_m[1]},
                                   .cell_m = s->cell_m,
                                   .nx = (uint32_t)s->nx,
                                   .ny = (uint32_t)s->ny,
                                   .views = s->views};
    return seen_encode(&seen, out, e);
}
