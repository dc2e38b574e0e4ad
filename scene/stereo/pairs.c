/* Neighbours of photographs by the points they share, and the heights to search: see pairs.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/stereo/pairs.h"

#include <math.h>
#include <string.h>

#include "codec/scene/scene.h"
#include "core/base.h"
#include "core/math/sort.h"

#define PAIRS_ANGLE 12.0 /* degrees */
#define PAIRS_BELOW 4.0
#define PAIRS_ABOVE 10.0
#define PAIRS_OUTSIDE 0.002 /* share of the points that lie below, and above, the heights */
#define PAIRS_MARGIN 0.05   /* of their range */
#define PAIRS_LESS 8.0
#define PAIRS_DEG 57.29577951308232

enum { PAIRS_COLUMNS = 16, PAIRS_ROWS = 12, PAIRS_PLACES = PAIRS_COLUMNS * PAIRS_ROWS };

struct pairs_work {
    const struct scene *scene;
    size_t *first;  /* [n_points + 1] into seen */
    uint32_t *seen; /* [n_tracks] images, by point */
    double (*center)[3];
    double *height; /* [n_tracks] */
    /* of one photograph: */
    uint32_t *shared; /* [n_images] points that both observe */
    float *weight;    /* [n_images][PAIRS_PLACES] */
    double place_m[PAIRS_PLACES][3];
    bool is_down[PAIRS_PLACES]; /* the ray meets ground */
    double covered[PAIRS_PLACES];
};

void pairs_free(struct pairs *p)
{
    mem_free(p->near);
    mem_free(p->n_near);
    mem_free(p->n_swept);
    *p = (struct pairs){0};
}

static void pairs_close(struct pairs_work *w)
{
    mem_free(w->first);
    mem_free(w->seen);
    mem_free(w->weight);
    mem_free(w->height);
    mem_free(w->shared);
    mem_free(w->center);
}

/* The images of each point. */
static enum err_code pairs_open(const struct scene *s, struct pairs_work *w, struct err *e)
{
    *w = (struct pairs_work){.scene = s};
    w->first = mem_array(s->n_points + 2, sizeof *w->first);
    w->seen = mem_array(s->n_tracks + 1, sizeof *w->seen);
    w->height = mem_array(s->n_tracks + 1, sizeof *w->height);
    w->weight = mem_array((s->n_images + 1) * PAIRS_PLACES, sizeof *w->weight);
    w->shared = mem_array(s->n_images + 1, sizeof *w->shared);
    w->center = mem_array(s->n_images + 1, sizeof *w->center);
    if (!w->first || !w->seen || !w->weight || !w->height || !w->shared || !w->center)
        return err_set(e, ERR_MEM, "stereo: out of memory for %zu points", s->n_points);
    for (size_t i = 0; i < s->n_tracks; i++)
        w->first[s->tracks[i].point + 2]++;
    for (size_t i = 2; i < s->n_points + 2; i++)
        w->first[i] += w->first[i - 1];
    for (size_t i = 0; i < s->n_tracks; i++)
        w->seen[w->first[s->tracks[i].point + 1]++] = s->tracks[i].image;
    for (size_t i = 0; i < s->n_images; i++)
        camera_center(&s->images[i].cam, w->center[i]);
    return ERR_OK;
}

static double pairs_weight(const double x[3], const double a[3], const double b[3])
{
    double dot = 0.0, na = 0.0, nb = 0.0;
    for (int k = 0; k < 3; k++) {
        double p = a[k] - x[k], q = b[k] - x[k];
        dot += p * q;
        na += p * p;
        nb += q * q;
    }
    if (!(na > 0.0) || !(nb > 0.0))
        return 0.0;
    double angle = acos(fmin(fmax(dot / sqrt(na * nb), -1.0), 1.0)) * PAIRS_DEG;
    double r = (angle - PAIRS_ANGLE) / (angle < PAIRS_ANGLE ? PAIRS_BELOW : PAIRS_ABOVE);
    return exp(-0.5 * r * r);
}

/* Part of the picture that a point falls into, PAIRS_PLACES: none. */
static size_t pairs_part(const struct camera *c, const double x_m[3])
{
    double px[2];
    if (!camera_project(c, x_m, 0.0, px, NULL) || !(px[0] >= 0.0) || !(px[1] >= 0.0) ||
        !(px[0] < c->width_px) || !(px[1] < c->height_px))
        return PAIRS_PLACES;
    size_t column = (size_t)(px[0] * PAIRS_COLUMNS / c->width_px),
           row = (size_t)(px[1] * PAIRS_ROWS / c->height_px);
    return row * PAIRS_COLUMNS + column;
}

/* The mean of the parts beside that have a height; NAN: none has. */
static double pairs_beside(const double height_m[PAIRS_PLACES], size_t at)
{
    size_t x = at % PAIRS_COLUMNS, y = at / PAIRS_COLUMNS;
    const double beside[4] = {x > 0 ? height_m[at - 1] : (double)NAN,
                              x + 1 < PAIRS_COLUMNS ? height_m[at + 1] : (double)NAN,
                              y > 0 ? height_m[at - PAIRS_COLUMNS] : (double)NAN,
                              y + 1 < PAIRS_ROWS ? height_m[at + PAIRS_COLUMNS] : (double)NAN};
    double sum = 0.0, n = 0.0;
    for (int k = 0; k < 4; k++)
        if (!isnan(beside[k])) {
            sum += beside[k];
            n += 1.0;
        }
    return n > 0.0 ? sum / n : (double)NAN;
}

/* Gives parts without a height the mean of those beside that have one, ring by ring. */
static void pairs_fill(double height_m[PAIRS_PLACES])
{
    for (bool more = true; more;) {
        double before[PAIRS_PLACES];
        memcpy(before, height_m, sizeof before);
        more = false;
        for (size_t at = 0; at < PAIRS_PLACES; at++)
            if (isnan(before[at])) {
                height_m[at] = pairs_beside(before, at);
                more = more || !isnan(height_m[at]);
            }
    }
}

/* Median heights of the points that the photograph of the tracks first to last observes, in each
 * part of its picture. */
static void pairs_ground(const struct pairs_work *w, uint32_t image, size_t first, size_t last,
                         double height_m[PAIRS_PLACES])
{
    const struct scene *s = w->scene;
    size_t start[PAIRS_PLACES + 2] = {0};
    for (size_t i = first; i < last; i++)
        start[pairs_part(&s->images[image].cam, s->points[s->tracks[i].point].enu_m) + 1]++;
    for (size_t at = 0; at <= PAIRS_PLACES; at++)
        start[at + 1] += start[at];
    for (size_t i = first; i < last; i++) {
        const double *x = s->points[s->tracks[i].point].enu_m;
        w->height[start[pairs_part(&s->images[image].cam, x)]++] = x[2];
    }
    for (size_t at = 0, from = 0; at < PAIRS_PLACES; from = start[at++])
        height_m[at] =
            start[at] > from ? sort_median(w->height + from, start[at] - from) : (double)NAN;
    pairs_fill(height_m);
}

/* The ground that a photograph shows. */
static void pairs_places(struct pairs_work *w, uint32_t image, size_t first, size_t last)
{
    const struct camera *c = &w->scene->images[image].cam;
    double height_m[PAIRS_PLACES], eye[3];
    camera_center(c, eye);
    pairs_ground(w, image, first, last, height_m);
    for (size_t at = 0; at < PAIRS_PLACES; at++) {
        double x = ((double)(at % PAIRS_COLUMNS) + 0.5) / PAIRS_COLUMNS * c->width_px,
               y = ((double)(at / PAIRS_COLUMNS) + 0.5) / PAIRS_ROWS * c->height_px,
               a = (x - c->cx_px) / c->fx_px, b = (y - c->cy_px) / c->fy_px, ray[3];
        for (int k = 0; k < 3; k++)
            ray[k] = c->rot[k] * a + c->rot[3 + k] * b + c->rot[6 + k];
        double depth = (height_m[at] - eye[2]) / ray[2];
        w->is_down[at] = ray[2] < -SWEEP_DOWN && depth > 0.0;
        for (int k = 0; k < 3; k++)
            w->place_m[at][k] = eye[k] + depth * ray[k];
    }
}

/* The candidate that adds most; n_images: none adds anything. */
static size_t pairs_best(const struct pairs_work *w)
{
    size_t n = w->scene->n_images, best = n;
    double need[PAIRS_PLACES], most = 0.0;
    for (size_t at = 0; at < PAIRS_PLACES; at++)
        need[at] = pow(1.0 + w->covered[at], -PAIRS_LESS);
    for (size_t j = 0; j < n; j++) {
        double gain = 0.0;
        for (size_t at = 0; at < PAIRS_PLACES && w->shared[j] >= PAIRS_SHARED_MIN; at++)
            gain += (double)w->weight[j * PAIRS_PLACES + at] * need[at];
        if (gain > most) {
            most = gain;
            best = j;
        }
    }
    return best;
}

static void pairs_of(struct pairs_work *w, uint32_t image, size_t first, size_t last,
                     const uint8_t *use, size_t swept, struct pairs *out)
{
    const struct scene *s = w->scene;
    memset(w->shared, 0, s->n_images * sizeof *w->shared);
    memset(w->covered, 0, sizeof w->covered);
    for (size_t i = first; i < last; i++)
        for (size_t p = s->tracks[i].point, k = w->first[p]; k < w->first[p + 1]; k++)
            w->shared[w->seen[k]] += use[w->seen[k]] && w->seen[k] != image;
    pairs_places(w, image, first, last);
    for (size_t j = 0; j < s->n_images; j++)
        for (size_t at = 0; at < PAIRS_PLACES && w->shared[j] >= PAIRS_SHARED_MIN; at++) {
            double depth;
            bool is_seen =
                w->is_down[at] && camera_frames(&s->images[j].cam, w->place_m[at], 0.0, &depth);
            w->weight[j * PAIRS_PLACES + at] =
                is_seen ? (float)pairs_weight(w->place_m[at], w->center[image], w->center[j])
                        : 0.0F;
        }
    size_t n = 0;
    for (size_t best; n < PAIRS_NEAR_MAX && (best = pairs_best(w)) < s->n_images; n++) {
        out->near[image][n] = (uint32_t)best;
        for (size_t at = 0; at < PAIRS_PLACES; at++)
            w->covered[at] += (double)w->weight[best * PAIRS_PLACES + at];
        w->shared[best] = 0;
    }
    out->n_near[image] = (uint8_t)n;
    out->n_swept[image] = (uint8_t)(n < swept ? n : swept);
}

static enum err_code pairs_heights(const struct scene *s, struct pairs *out, struct err *e)
{
    double *z = mem_array(s->n_points, sizeof *z);
    if (!z)
        return err_set(e, ERR_MEM, "stereo: out of memory for %zu points", s->n_points);
    for (size_t i = 0; i < s->n_points; i++)
        z[i] = s->points[i].enu_m[2];
    (void)sort_median(z, s->n_points); /* sorts */
    size_t out_of = (size_t)(PAIRS_OUTSIDE * (double)s->n_points);
    double low = z[out_of], high = z[s->n_points - 1 - out_of];
    double margin = PAIRS_MARGIN * (high - low) + 1e-3;
    out->low_m = low - margin;
    out->high_m = high + margin;
    mem_free(z);
    return ERR_OK;
}

enum err_code pairs_find(const struct scene *s, const uint8_t *use, size_t swept, struct pairs *out,
                         struct err *e)
{
    struct pairs_work w = {0};
    *out = (struct pairs){.n = s->n_images};
    if (!s->n_points || !s->n_tracks)
        return err_set(e, ERR_DATA,
                       "%s: the scene has no points that photographs observe: "
                       "neighbours and heights are not known",
                       s->dir);
    out->near = mem_array(s->n_images, sizeof *out->near);
    out->n_near = mem_array(s->n_images, 1);
    out->n_swept = mem_array(s->n_images, 1);
    if (!out->near || !out->n_near || !out->n_swept) {
        pairs_free(out);
        return err_set(e, ERR_MEM, "stereo: out of memory for %zu photographs", s->n_images);
    }
    enum err_code rc = pairs_open(s, &w, e);
    for (size_t i = 0, first = 0; !rc && i < s->n_images; i++) {
        size_t last = first;
        while (last < s->n_tracks && s->tracks[last].image == i)
            last++;
        if (use[i])
            pairs_of(&w, (uint32_t)i, first, last, use, swept, out);
        first = last;
    }
    if (!rc)
        rc = pairs_heights(s, out, e);
    if (rc)
        pairs_free(out);
    pairs_close(&w);
    return rc;
}

/* The pixel of neighbour k where x of the reference falls at height z; false: not before both. */
static bool pairs_place(const struct sweep_input *in, size_t k, const double x[2], double z,
                        double out[2])
{
    double h[9];
    struct sweep_plane level = sweep_level(z);
    sweep_homography(in, k, &level, h);
    double q = h[6] * x[0] + h[7] * x[1] + h[8];
    out[0] = (h[0] * x[0] + h[1] * x[1] + h[2]) / q;
    out[1] = (h[3] * x[0] + h[4] * x[1] + h[5]) / q;
    return q > 0.0;
}

bool pairs_planes(const struct pairs *p, double move_px, struct sweep_input *in)
{
    const struct camera *c = &in->ref.cam;
    double middle = 0.5 * (p->low_m + p->high_m), most = 0.0;
    /* the middle of the lower half: it looks down where a photograph shows the horizon */
    const double x[2] = {0.5 * c->width_px, 0.75 * c->height_px};
    for (size_t k = 0; k < in->n_near; k++) {
        double a[2], b[2];
        if (pairs_place(in, k, x, middle, a) && pairs_place(in, k, x, middle + 1e-2, b))
            most = fmax(most, hypot(b[0] - a[0], b[1] - a[1]) * 1e2);
    }
    if (!(most > 0.0))
        return false;
    double range = p->high_m - p->low_m, planes = ceil(range * most / move_px) + 1.0;
    planes = fmin(fmax(planes, 2.0), SWEEP_PLANES_MAX);
    in->low_m = p->low_m;
    in->planes = (uint32_t)planes;
    in->step_m = range / (planes - 1.0);
    return true;
}
