/* Convex hull of camera centres: Andrew's monotone chain (1979).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cells/camera_hull.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/scene.h"

static int camera_hull_compare(const void *a, const void *b)
{
    const double *p = a, *q = b;
    if (p[0] != q[0])
        return p[0] < q[0] ? -1 : 1;
    return p[1] < q[1] ? -1 : p[1] > q[1];
}

static double camera_hull_side(const double a[2], const double b[2], const double c[2])
{
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
}

enum err_code camera_hull_of(const struct scene *s, struct camera_hull *out, struct err *e)
{
    size_t n = s->n_images, k = 0;
    double(*at)[2] = mem_array(n, sizeof *at);
    out->corner = mem_array(2 * n + 1, sizeof *out->corner);
    if (!at || !out->corner || n == 0) {
        mem_free(at);
        return err_set(e, n ? ERR_MEM : ERR_DATA,
                       n ? "out of memory" : "the scene has no photographs");
    }
    for (size_t i = 0; i < n; i++) {
        double center[3];
        camera_center(&s->images[i].cam, center);
        memcpy(at[i], center, sizeof at[i]);
    }
    qsort(at, n, sizeof *at, camera_hull_compare);
    double(*h)[2] = out->corner;
    for (size_t i = 0; i < n; i++) {
        while (k >= 2 && camera_hull_side(h[k - 2], h[k - 1], at[i]) <= 0.0)
            k--;
        memcpy(h[k++], at[i], sizeof at[i]);
    }
    for (size_t i = n - 1, low = k + 1; i-- > 0;) {
        while (k >= low && camera_hull_side(h[k - 2], h[k - 1], at[i]) <= 0.0)
            k--;
        memcpy(h[k++], at[i], sizeof at[i]);
    }
    out->n = k > 1 ? k - 1 : k;
    mem_free(at);
    return ERR_OK;
}

void camera_hull_free(struct camera_hull *g)
{
    mem_free(g->corner);
    *g = (struct camera_hull){0};
}

double camera_hull_distance(const struct camera_hull *g, double x_m, double y_m)
{
    const double p[2] = {x_m, y_m};
    double least = HUGE_VAL;
    bool inside = g->n >= 3;
    for (size_t i = 0; i < g->n; i++) {
        const double *a = g->corner[i], *b = g->corner[(i + 1) % g->n];
        double d[2] = {b[0] - a[0], b[1] - a[1]}, len2 = d[0] * d[0] + d[1] * d[1];
        double t = len2 > 0.0 ? ((p[0] - a[0]) * d[0] + (p[1] - a[1]) * d[1]) / len2 : 0.0;
        t = fmin(fmax(t, 0.0), 1.0);
        least = fmin(least, hypot(p[0] - a[0] - t * d[0], p[1] - a[1] - t * d[1]));
        inside = inside && camera_hull_side(a, b, p) >= 0.0;
    }
    return inside ? 0.0 : least;
}
