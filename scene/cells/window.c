/* See window.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/cells/window.h"

#include <math.h>
#include <string.h>

#include "codec/scene/scene.h"
#include "core/math/knn.h"
#include "core/math/sort.h"
#include "scene/cells/partition.h"

#define WINDOW_TAIL 0.005  /* of a cell's samples, on each side */
#define WINDOW_BORDER 0.04 /* of the picture's edge, on each side */

enum err_code window_open(const struct scene *s, const struct partition *plan, struct window *out,
                          struct err *e)
{
    size_t n = s->n_points;
    double *height_m = mem_array(n + 1, sizeof *height_m);
    *out = (struct window){.scene = s, .plan = plan};
    out->xyz = mem_array(3 * s->n_tracks + 1, sizeof *out->xyz);
    if (!height_m || !out->xyz) {
        mem_free(height_m);
        window_free(out);
        return err_set(e, ERR_MEM, "windows: out of memory for %zu observations", s->n_tracks);
    }
    for (size_t i = 0; i < n; i++)
        height_m[i] = s->points[i].enu_m[2];
    sort_doubles(height_m, n);
    out->ground_m = n ? height_m[n / 2] : 0.0;
    mem_free(height_m);
    return ERR_OK;
}

void window_free(struct window *w)
{
    mem_free(w->xyz);
    *w = (struct window){0};
}

/* The cell that owns the place where a pixel's ray meets the plane at this height. */
static int32_t window_owner(const struct window *w, const struct camera *cam, double x_px,
                            double y_px, double height_m)
{
    const double x = (x_px - cam->cx_px) / cam->fx_px, y = (y_px - cam->cy_px) / cam->fy_px;
    double from_m[3], ray[3];
    camera_center(cam, from_m);
    for (int k = 0; k < 3; k++)
        ray[k] = cam->rot[k] * x + cam->rot[3 + k] * y + cam->rot[6 + k];
    double t = (height_m - from_m[2]) / ray[2];
    if (!(t > 0.0) || !isfinite(t))
        return WINDOW_NOBODY;
    return (int32_t)partition_owner(w->plan, from_m[0] + t * ray[0], from_m[1] + t * ray[1]);
}

enum err_code window_look(struct window *w, uint32_t image, struct err *e)
{
    const struct scene *s = w->scene;
    const struct camera *cam = &s->images[image].cam;
    struct knn tree = {0};
    size_t first = scene_first_track(s, image), n = 0;
    for (; first + n < s->n_tracks && s->tracks[first + n].image == image; n++) {
        w->xyz[3 * n] = s->tracks[first + n].x_px;
        w->xyz[3 * n + 1] = s->tracks[first + n].y_px;
        w->xyz[3 * n + 2] = 0.0f;
    }
    enum err_code rc = n ? knn_build(w->xyz, n, &tree, e) : ERR_OK;
    w->n_owned = 0;
    for (int32_t r = 0; !rc && r < WINDOW_ROWS; r++)
        for (int32_t c = 0; c < WINDOW_COLUMNS; c++) {
            double x_px = (c + 0.5) / WINDOW_COLUMNS * cam->width_px,
                   y_px = (r + 0.5) / WINDOW_ROWS * cam->height_px, height_m = w->ground_m;
            const float at[3] = {(float)x_px, (float)y_px, 0.0f};
            uint32_t id = 0;
            float dist2;
            if (n && knn_find(&tree, at, KNN_NOBODY, 1, &id, &dist2))
                height_m = s->points[s->tracks[first + id].point].enu_m[2];
            w->owner[r][c] = window_owner(w, cam, x_px, y_px, height_m);
            w->n_owned += w->owner[r][c] != WINDOW_NOBODY;
        }
    knn_free(&tree);
    return rc;
}

/* The first and last of n bins that hold all but a tail of `total`, as shares of the edge, with a
 * border. */
static void window_range(const size_t *bins, size_t n, size_t total, double border, double *from,
                         double *to)
{
    size_t tail = (size_t)floor(WINDOW_TAIL * (double)total), first = 0, last = n - 1;
    for (size_t sum = bins[0]; sum <= tail; sum += bins[first])
        first++;
    for (size_t sum = bins[n - 1]; sum <= tail; sum += bins[last])
        last--;
    *from = fmax((double)first / (double)n - border, 0.0);
    *to = fmin((double)(last + 1) / (double)n + border, 1.0);
}

/* Moves sides to the picture's own beyond which no sample of others lies in the same rows, or
 * columns. */
static void window_open_sides(const struct window *w, int32_t cell, struct camera_window *out)
{
    const struct camera_window was = *out;
    bool left = false, right = false, above = false, below = false;
    for (int r = 0; r < WINDOW_ROWS; r++)
        for (int c = 0; c < WINDOW_COLUMNS; c++) {
            double x = (c + 0.5) / WINDOW_COLUMNS, y = (r + 0.5) / WINDOW_ROWS;
            bool rows = y >= was.y0 && y <= was.y1, columns = x >= was.x0 && x <= was.x1;
            if (w->owner[r][c] == cell || w->owner[r][c] == WINDOW_NOBODY)
                continue;
            left |= rows && x < was.x0;
            right |= rows && x > was.x1;
            above |= columns && y < was.y0;
            below |= columns && y > was.y1;
        }
    out->x0 = left ? out->x0 : 0.0;
    out->x1 = right ? out->x1 : 1.0;
    out->y0 = above ? out->y0 : 0.0;
    out->y1 = below ? out->y1 : 1.0;
}

bool window_part(const struct window *w, size_t cell, struct camera_window *out)
{
    size_t rows[WINDOW_ROWS] = {0}, columns[WINDOW_COLUMNS] = {0}, own = 0;
    *out = (struct camera_window){0.0, 0.0, 1.0, 1.0};
    for (size_t r = 0; r < WINDOW_ROWS; r++)
        for (size_t c = 0; c < WINDOW_COLUMNS; c++)
            if (w->owner[r][c] == (int32_t)cell) {
                rows[r]++;
                columns[c]++;
                own++;
            }
    if (!own)
        return false;
    window_range(columns, WINDOW_COLUMNS, own, WINDOW_BORDER, &out->x0, &out->x1);
    window_range(rows, WINDOW_ROWS, own, WINDOW_BORDER, &out->y0, &out->y1);
    window_open_sides(w, (int32_t)cell, out);
    return true;
}

double window_share(const struct window *w, size_t cell)
{
    size_t own = 0;
    for (size_t r = 0; r < WINDOW_ROWS; r++)
        for (size_t c = 0; c < WINDOW_COLUMNS; c++)
            own += w->owner[r][c] == (int32_t)cell;
    return w->n_owned ? (double)own / (double)w->n_owned : 0.0;
}
