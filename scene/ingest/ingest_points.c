/* Finds sparse points that are not on a surface. A wrong match of two photographs lies metres off,
 * often below the ground. Training turns such a point into a Gaussian as large as the gap around
 * it. Training photographs do not show its tails, but every other view does.
 *
 * There are four kinds of evidence, in this order: rays that meet at too small an angle, a
 * reprojection error far above that of others, a distance to the nearest points far above that of
 * points around, and a height far below or above all points nearby. The last counts only for a weak
 * point (few observations or a poor fit), because a lamp post also stands above its street. All
 * limits are relative: to the median error, to the spacing of neighbours, to the size of a pixel
 * there.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/scene/scene.h"
#include "core/math/knn.h"
#include "core/math/sort.h"
#include "core/pool.h"
#include "scene/ingest/ingest.h"
#include "scene/ingest/ingest_internal.h"

enum {
    POINTS_GAP = 3,      /* nearest others that a gap is the mean distance of */
    POINTS_AROUND = 12,  /* others whose gaps are compared */
    POINTS_COLUMN = 24,  /* others that are near on the map */
    POINTS_TAIL = 2,     /* of them, at either end, that do not count as the surface */
    POINTS_FEW_VIEWS = 3 /* observations of a weak point, at most */
};
#define POINTS_ANGLE_DEG 1.0  /* least angle between the rays of a point */
#define POINTS_ERROR 8.0      /* largest reprojection error, in medians of all points */
#define POINTS_GAP_MOST 8.0   /* largest gap, in those of the points around */
#define POINTS_WEAK_ERROR 2.0 /* median errors of a weak point, at least */
#define POINTS_GAP_PX 2.0     /* gaps of so many pixels are usual */
#define POINTS_STEP_PX 8.0    /* and steps in height of so many */
#define POINTS_STEP_GAPS 1.5  /* steps in height of so much of the distance are usual */
#define POINTS_SURE 3.0       /* so many such steps below all: no weakness is needed */

struct points_work {
    const struct scene *s;
    size_t *first;       /* [n + 1] observations of a point in `seen_by` */
    uint32_t *seen_by;   /* images */
    double (*center)[3]; /* [n_images] */
    float *xyz, *xy0;    /* [n][3]; the second with height 0 */
    float *gap_m;        /* [n] */
    float *pixel_m;      /* [n] size of a pixel of the nearest observer */
    double error_px;     /* median of all that photographs see */
    struct knn space, map;
    uint8_t *verdict; /* [n] enum ingest_point */
};

/* ---- observers ---- */

static void points_observers(struct points_work *w)
{
    const struct scene *s = w->s;
    for (size_t k = 0; k < s->n_tracks; k++)
        w->first[s->tracks[k].point + 1]++;
    for (size_t i = 0; i < s->n_points; i++)
        w->first[i + 1] += w->first[i];
    for (size_t k = s->n_tracks; k-- > 0;) { /* from behind: first[i] is where the next one goes */
        size_t *end = &w->first[s->tracks[k].point + 1];
        w->seen_by[--*end] = s->tracks[k].image;
    }
    /* Every end has come down to its beginning. */
    memmove(w->first, w->first + 1, s->n_points * sizeof *w->first);
    w->first[s->n_points] = s->n_tracks;
    for (size_t k = 0; k < s->n_images; k++)
        camera_center(&s->images[k].cam, w->center[k]);
}

static double points_ray(const double from[3], const double to[3], double ray[3])
{
    double len = 0.0;
    for (int a = 0; a < 3; a++) {
        ray[a] = to[a] - from[a];
        len += ray[a] * ray[a];
    }
    len = sqrt(len);
    for (int a = 0; a < 3; a++)
        ray[a] /= len > 0.0 ? len : 1.0;
    return len;
}

/* The observer whose ray is farthest off this one, and the angle. */
static double points_farthest(const struct points_work *w, size_t i, const double ray[3],
                              double far[3])
{
    double least = 2.0;
    for (size_t k = w->first[i]; k < w->first[i + 1]; k++) {
        double r[3];
        points_ray(w->center[w->seen_by[k]], w->s->points[i].enu_m, r);
        double c = r[0] * ray[0] + r[1] * ray[1] + r[2] * ray[2];
        if (c < least) {
            least = c;
            memcpy(far, r, sizeof r);
        }
    }
    return acos(fmax(-1.0, fmin(1.0, least)));
}

/* Angle between two of its rays, near the largest one; 0 with fewer than two. */
static double points_angle(const struct points_work *w, size_t i)
{
    double ray[3], a[3] = {0}, b[3];
    if (w->first[i + 1] - w->first[i] < 2)
        return 0.0;
    points_ray(w->center[w->seen_by[w->first[i]]], w->s->points[i].enu_m, ray);
    points_farthest(w, i, ray, a);
    return points_farthest(w, i, a, b);
}

static double points_pixel(const struct points_work *w, size_t i)
{
    double least = HUGE_VAL, ray[3];
    for (size_t k = w->first[i]; k < w->first[i + 1]; k++) {
        uint32_t image = w->seen_by[k];
        double d = points_ray(w->center[image], w->s->points[i].enu_m, ray);
        least = fmin(least, d / w->s->images[image].cam.fx_px);
    }
    return isfinite(least) ? least : 0.0;
}

/* ---- neighbours ---- */

static enum err_code points_gap_task(void *user, size_t i, struct err *e)
{
    (void)e;
    struct points_work *w = user;
    uint32_t ids[POINTS_GAP];
    float d2[POINTS_GAP];
    size_t n = knn_find(&w->space, w->xyz + 3 * i, (uint32_t)i, POINTS_GAP, ids, d2);
    double sum = 0.0;
    for (size_t k = 0; k < n; k++)
        sum += sqrt((double)d2[k]);
    w->gap_m[i] = n ? (float)(sum / (double)n) : 0.0f;
    w->pixel_m[i] = (float)points_pixel(w, i);
    return ERR_OK;
}

static bool points_alone(const struct points_work *w, size_t i)
{
    uint32_t ids[POINTS_AROUND];
    float d2[POINTS_AROUND];
    double gap[POINTS_AROUND];
    size_t n = knn_find(&w->space, w->xyz + 3 * i, (uint32_t)i, POINTS_AROUND, ids, d2);
    for (size_t k = 0; k < n; k++)
        gap[k] = (double)w->gap_m[ids[k]];
    double usual = fmax(sort_median(gap, n), POINTS_GAP_PX * (double)w->pixel_m[i]);
    return n == POINTS_AROUND && (double)w->gap_m[i] > POINTS_GAP_MOST * usual;
}

static bool points_weak(const struct points_work *w, size_t i)
{
    const struct scene_point *p = &w->s->points[i];
    return p->track_length && (p->track_length <= POINTS_FEW_VIEWS ||
                               (double)p->error_px > POINTS_WEAK_ERROR * w->error_px);
}

/* Metres below (negative) or above what is near on the map, in steps that would be usual there. */
static double points_off_surface(const struct points_work *w, size_t i)
{
    uint32_t ids[POINTS_COLUMN];
    float d2[POINTS_COLUMN];
    double z[POINTS_COLUMN];
    size_t n = knn_find(&w->map, w->xy0 + 3 * i, (uint32_t)i, POINTS_COLUMN, ids, d2);
    if (n < POINTS_COLUMN)
        return 0.0;
    for (size_t k = 0; k < n; k++)
        z[k] = (double)w->xyz[3 * ids[k] + 2];
    sort_median(z, n); /* sorts */
    double low = z[POINTS_TAIL], high = z[n - 1 - POINTS_TAIL], at = (double)w->xyz[3 * i + 2];
    double step = fmax(high - low, POINTS_STEP_GAPS * sqrt((double)d2[n - 1]));
    step = fmax(step, POINTS_STEP_PX * (double)w->pixel_m[i]);
    return at < low ? (at - low) / step : at > high ? (at - high) / step : 0.0;
}

static enum err_code points_judge_task(void *user, size_t i, struct err *e)
{
    (void)e;
    struct points_work *w = user;
    bool weak = points_weak(w, i);
    enum ingest_point v = INGEST_POINT_KEPT;
    double off = points_off_surface(w, i);
    if (w->first[i + 1] - w->first[i] >= 2 &&
        points_angle(w, i) < POINTS_ANGLE_DEG / 57.29577951308232)
        v = INGEST_POINT_ANGLE;
    else if (w->s->points[i].track_length &&
             (double)w->s->points[i].error_px > POINTS_ERROR * w->error_px)
        v = INGEST_POINT_ERROR;
    else if (points_alone(w, i))
        v = INGEST_POINT_ALONE;
    else if (off < -POINTS_SURE || (weak && off < -1.0))
        v = INGEST_POINT_BELOW;
    else if (weak && off > 1.0)
        v = INGEST_POINT_ABOVE;
    w->verdict[i] = (uint8_t)v;
    return ERR_OK;
}

/* ---- the whole ---- */

static enum err_code points_open(struct points_work *w, struct err *e)
{
    const struct scene *s = w->s;
    size_t n = s->n_points, n_seen = 0;
    double *error = mem_array(n, sizeof *error);
    w->first = mem_array(n + 1, sizeof *w->first);
    w->seen_by = mem_array(s->n_tracks, sizeof *w->seen_by);
    w->center = mem_array(s->n_images, sizeof *w->center);
    w->xyz = mem_array(3 * n, sizeof *w->xyz);
    w->xy0 = mem_array(3 * n, sizeof *w->xy0);
    w->gap_m = mem_array(n, sizeof *w->gap_m);
    w->pixel_m = mem_array(n, sizeof *w->pixel_m);
    w->verdict = mem_array(n, 1);
    enum err_code rc = ERR_OK;
    if (!error || !w->first || !w->seen_by || !w->center || !w->xyz || !w->xy0 || !w->gap_m ||
        !w->pixel_m || !w->verdict)
        rc = err_set(e, ERR_MEM, "ingest: out of memory for %zu points", n);
    for (size_t i = 0; !rc && i < n; i++) {
        if (s->points[i].track_length) /* others come without an error */
            error[n_seen++] = (double)s->points[i].error_px;
        for (int k = 0; k < 3; k++)
            w->xyz[3 * i + k] = (float)s->points[i].enu_m[k];
        memcpy(w->xy0 + 3 * i, w->xyz + 3 * i, 2 * sizeof *w->xy0);
    }
    if (!rc)
        w->error_px = sort_median(error, n_seen);
    mem_free(error);
    if (!rc)
        points_observers(w);
    if (!rc)
        rc = knn_build(w->xyz, n, &w->space, e);
    return rc ? rc : knn_build(w->xy0, n, &w->map, e);
}

static void points_close(struct points_work *w)
{
    mem_free(w->first);
    mem_free(w->seen_by);
    mem_free(w->center);
    mem_free(w->xyz);
    mem_free(w->xy0);
    mem_free(w->gap_m);
    mem_free(w->pixel_m);
    mem_free(w->verdict);
    knn_free(&w->space);
    knn_free(&w->map);
}

/* Close the gaps; observations of what is gone go with it. */
static enum err_code points_remove(struct scene *s, const uint8_t *verdict, struct err *e)
{
    uint32_t *number = mem_array(s->n_points, sizeof *number);
    if (!number)
        return err_set(e, ERR_MEM, "ingest: out of memory for %zu points", s->n_points);
    size_t n = 0, left = 0;
    for (size_t i = 0; i < s->n_points; i++) {
        number[i] = verdict[i] == INGEST_POINT_KEPT ? (uint32_t)n : UINT32_MAX;
        if (verdict[i] == INGEST_POINT_KEPT)
            s->points[n++] = s->points[i];
    }
    for (size_t k = 0; k < s->n_tracks; k++) {
        struct scene_track t = s->tracks[k];
        if (number[t.point] == UINT32_MAX)
            continue;
        t.point = number[t.point];
        s->tracks[left++] = t;
    }
    s->n_points = n;
    s->n_tracks = left;
    mem_free(number);
    return ERR_OK;
}

enum err_code ingest_points_filter(const struct ingest_config *cfg, struct scene *s,
                                   size_t count[INGEST_POINT_VERDICTS], struct err *e)
{
    struct points_work w = {.s = s};
    size_t n = s->n_points;
    memset(count, 0, INGEST_POINT_VERDICTS * sizeof *count);
    count[INGEST_POINT_KEPT] = n;
    if (!cfg->point_filter || !n)
        return ERR_OK;
    enum err_code rc = points_open(&w, e);
    if (!rc)
        rc = pool_for(n, 0, points_gap_task, &w, e);
    if (!rc)
        rc = pool_for(n, 0, points_judge_task, &w, e);
    if (!rc) {
        count[INGEST_POINT_KEPT] = 0;
        for (size_t i = 0; i < n; i++)
            count[w.verdict[i]]++;
        rc = points_remove(s, w.verdict, e);
    }
    points_close(&w);
    if (!rc && (double)count[INGEST_POINT_KEPT] < 0.8 * (double)n)
        log_warn("ingest",
                 "%zu of %zu sparse points look wrong and are left out (--point-filter); is the "
                 "COLMAP model sound?",
                 n - count[INGEST_POINT_KEPT], n);
    return rc;
}
