/* Neighbours of photographs by the points they share, and the heights to search: see pairs.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "stereo/pairs.h"

#include <math.h>
#include <string.h>

#include "codec/scene.h"
#include "core/base.h"
#include "core/sort.h"

#define PAIRS_ANGLE 12.0 /* degrees */
#define PAIRS_BELOW 4.0
#define PAIRS_ABOVE 10.0
#define PAIRS_OUTSIDE 0.002 /* share of the points that lie below, and above, the heights */
#define PAIRS_MARGIN 0.05   /* of their range */
#define PAIRS_DEG 57.29577951308232

struct pairs_work {
    const struct scene *scene;
    size_t *first;  /* [n_points + 1] into seen */
    uint32_t *seen; /* [n_tracks] images, by point */
    double *score;  /* [n_images] of one photograph */
    uint32_t *shared;
    double (*center)[3];
};

void pairs_free(struct pairs *p)
{
    mem_free(p->near);
    mem_free(p->n_near);
    *p = (struct pairs){0};
}

static void pairs_close(struct pairs_work *w)
{
    mem_free(w->first);
    mem_free(w->seen);
    mem_free(w->score);
    mem_free(w->shared);
    mem_free(w->center);
}

/* The images of each point. */
static enum err_code pairs_open(const struct scene *s, struct pairs_work *w, struct err *e)
{
    *w = (struct pairs_work){.scene = s};
    w->first = mem_array(s->n_points + 2, sizeof *w->first);
    w->seen = mem_array(s->n_tracks + 1, sizeof *w->seen);
    w->score = mem_array(s->n_images + 1, sizeof *w->score);
    w->shared = mem_array(s->n_images + 1, sizeof *w->shared);
    w->center = mem_array(s->n_images + 1, sizeof *w->center);
    if (!w->first || !w->seen || !w->score || !w->shared || !w->center)
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

static void pairs_of(const struct pairs_work *w, uint32_t image, size_t first, size_t last,
                     const uint8_t *use, size_t most, struct pairs *out)
{
    const struct scene *s = w->scene;
    memset(w->score, 0, s->n_images * sizeof *w->score);
    memset(w->shared, 0, s->n_images * sizeof *w->shared);
    for (size_t i = first; i < last; i++) {
        uint32_t point = s->tracks[i].point;
        for (size_t k = w->first[point]; k < w->first[point + 1]; k++) {
            uint32_t other = w->seen[k];
            if (other == image || !use[other])
                continue;
            w->shared[other]++;
            w->score[other] +=
                pairs_weight(s->points[point].enu_m, w->center[image], w->center[other]);
        }
    }
    size_t n = 0;
    for (; n < most; n++) {
        size_t best = s->n_images;
        for (size_t j = 0; j < s->n_images; j++)
            if (w->shared[j] >= PAIRS_SHARED_MIN && w->score[j] > 0.0 &&
                (best == s->n_images || w->score[j] > w->score[best]))
                best = j;
        if (best == s->n_images)
            break;
        out->near[image][n] = (uint32_t)best;
        w->score[best] = 0.0;
    }
    out->n_near[image] = (uint8_t)n;
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

enum err_code pairs_find(const struct scene *s, const uint8_t *use, size_t most, struct pairs *out,
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
    enum err_code rc =
        out->near && out->n_near
            ? ERR_OK
            : err_set(e, ERR_MEM, "stereo: out of memory for %zu photographs", s->n_images);
    if (!rc)
        rc = pairs_open(s, &w, e);
    for (size_t i = 0, first = 0; !rc && i < s->n_images; i++) {
        size_t last = first;
        while (last < s->n_tracks && s->tracks[last].image == i)
            last++;
        if (use[i])
            pairs_of(&w, (uint32_t)i, first, last, use, most, out);
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
