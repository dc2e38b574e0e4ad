/* See window.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cells/window.h"

#include <math.h>
#include <string.h>

#include "cells/cell.h"
#include "codec/scene.h"
#include "core/sort.h"

#define WINDOW_AROUND 0.05 /* of the cell's edge: points this near to it count */
#define WINDOW_TAIL 0.005  /* of the points, on each side */
#define WINDOW_BORDER 0.04 /* of the picture's longer edge, on each side */
#define WINDOW_NEAR_M 0.1

enum err_code window_open(const struct scene *s, const struct cell *cell, struct window_points *out,
                          struct err *e)
{
    size_t n = s->n_points;
    *out = (struct window_points){.scene = s};
    out->mine = mem_array(n, sizeof *out->mine);
    out->xy = mem_array(2 * n, sizeof *out->xy);
    out->x = mem_array(n, sizeof *out->x);
    out->y = mem_array(n, sizeof *out->y);
    if (n && (!out->mine || !out->xy || !out->x || !out->y)) {
        window_free(out);
        return err_set(e, ERR_MEM, "windows: out of memory for %zu points", n);
    }
    for (size_t i = 0; i < n; i++) {
        const double *at = s->points[i].enu_m;
        out->mine[i] = cell_owned_distance(cell, at[0], at[1]) <= WINDOW_AROUND * cell->edge_m;
    }
    return ERR_OK;
}

void window_free(struct window_points *p)
{
    mem_free(p->mine);
    mem_free(p->xy);
    mem_free(p->x);
    mem_free(p->y);
    *p = (struct window_points){0};
}

/* The range of most of n values, sorted here, and a border, as shares of `size`. */
static void window_range(double *v, size_t n, double border, double size, double *from, double *to)
{
    sort_doubles(v, n);
    double last = (double)(n - 1);
    *from = fmax((v[(size_t)floor(WINDOW_TAIL * last)] - border) / size, 0.0);
    *to = fmin((v[(size_t)ceil((1.0 - WINDOW_TAIL) * last)] + border) / size, 1.0);
}

/* Projects all points, NaN where the picture does not frame one. Returns the number of the cell's
 * own, whose places are in x and y. */
static size_t window_project(struct window_points *p, const struct camera *cam)
{
    size_t own = 0;
    for (size_t i = 0; i < p->scene->n_points; i++) {
        double *px = p->xy + 2 * i;
        const double *at = p->scene->points[i].enu_m;
        if (!camera_project(cam, at, WINDOW_NEAR_M, px, NULL) || !(px[0] >= 0.0) ||
            !(px[1] >= 0.0) || !(px[0] < cam->width_px) || !(px[1] < cam->height_px)) {
            px[0] = px[1] = (double)NAN;
        } else if (p->mine[i]) {
            p->x[own] = px[0];
            p->y[own++] = px[1];
        }
    }
    return own;
}

/* Moves sides to the picture's own beyond which no point of others lies in the same rows, or
 * columns. */
static void window_open_sides(const struct window_points *p, const struct camera *cam,
                              struct camera_window *w)
{
    const struct camera_window was = *w;
    bool left = false, right = false, above = false, below = false;
    for (size_t i = 0; i < p->scene->n_points; i++) {
        double x = p->xy[2 * i] / cam->width_px, y = p->xy[2 * i + 1] / cam->height_px;
        bool rows = y >= was.y0 && y <= was.y1, columns = x >= was.x0 && x <= was.x1;
        left |= !p->mine[i] && rows && x < was.x0;
        right |= !p->mine[i] && rows && x > was.x1;
        above |= !p->mine[i] && columns && y < was.y0;
        below |= !p->mine[i] && columns && y > was.y1;
    }
    w->x0 = left ? w->x0 : 0.0;
    w->x1 = right ? w->x1 : 1.0;
    w->y0 = above ? w->y0 : 0.0;
    w->y1 = below ? w->y1 : 1.0;
}

bool window_of(struct window_points *p, const struct camera *cam, struct camera_window *out)
{
    double w = cam->width_px, h = cam->height_px, border = WINDOW_BORDER * fmax(w, h);
    *out = (struct camera_window){0.0, 0.0, 1.0, 1.0};
    size_t own = window_project(p, cam);
    if (!own)
        return false;
    window_range(p->x, own, border, w, &out->x0, &out->x1);
    window_range(p->y, own, border, h, &out->y0, &out->y1);
    window_open_sides(p, cam, out);
    return true;
}

double window_share(struct window_points *p, const struct cell *cell, uint32_t image)
{
    const struct scene *s = p->scene;
    size_t n = 0, inside = 0;
    size_t first = scene_first_track(s, image);
    for (size_t i = first; i < s->n_tracks && s->tracks[i].image == image; i++) {
        const double *at = s->points[s->tracks[i].point].enu_m;
        inside += cell_owned_distance(cell, at[0], at[1]) <= 0.0;
        n++;
    }
    if (n)
        return (double)inside / (double)n;
    struct camera_window w;
    bool shown = window_of(p, &s->images[image].cam, &w);
    return shown ? (w.x1 - w.x0) * (w.y1 - w.y0) : 0.0;
}
