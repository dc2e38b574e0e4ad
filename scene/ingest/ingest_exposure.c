/* Exposure and white balance of every photograph, from sparse points that several photographs see.
 *
 * The light of point j in photograph i, channel k, is L = A[j][k] * 2^ev[i][k]. The logarithm is a
 * sum, and its least squares have a unique solution except for one constant a channel. That
 * constant is chosen so that the mean over the photographs is exactly 0. The solution alternates
 * between points and photographs. The weight of an observation is 1 / (1 + (r / 0.3)^2) for a
 * residual of r stops (Cauchy), so cars, glints and moving shadows have little effect. Each
 * photograph has four additional observations of 0, so that chains of few points do not drift.
 *
 * Light is the mean over 5 x 5 pixels of the scene's picture around the observation. Clipped and
 * black pixels are left out.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "codec/image/image.h"
#include "core/pool.h"
#include "core/splat/exposure.h"
#include "scene/ingest/ingest_internal.h"

enum { EXPOSURE_HALF_PX = 2, EXPOSURE_SWEEPS = 100, EXPOSURE_OBSERVATIONS_MIN = 30 };
#define EXPOSURE_CAUCHY_EV 0.3
#define EXPOSURE_PRIOR 4.0 /* observations that say 0 */
#define EXPOSURE_DONE_EV 5e-4
#define EXPOSURE_LEAST_EV 0.04 /* root mean square over photographs: below, it is noise */

struct exposure { /* of one ingest */
    struct ingest *g;
    size_t *first;     /* [images + 1] into the scene's tracks, which are sorted by image */
    float (*light)[3]; /* [tracks] log2 of linear light; NaN: not known */
    double (*point)[3], (*image)[3], *weight; /* [points], [images], [points] sums */
};

/* ---- what the pictures say ---- */

static void exposure_sample(const struct image *img, const float linear[256],
                            const struct scene_track *t, float out[3])
{
    double x = floor((double)t->x_px), y = floor((double)t->y_px), sum[3] = {0.0};
    size_t n = 0;
    for (int dy = -EXPOSURE_HALF_PX; dy <= EXPOSURE_HALF_PX; dy++)
        for (int dx = -EXPOSURE_HALF_PX; dx <= EXPOSURE_HALF_PX; dx++) {
            double u = x + dx, v = y + dy;
            if (!(u >= 0.0 && v >= 0.0 && u < img->width_px && v < img->height_px))
                continue;
            const uint8_t *px = img->px + 3 * ((size_t)v * img->width_px + (size_t)u);
            for (size_t k = 0; k < 3; k++) {
                if (px[k] < EXPOSURE_BYTE_MIN || px[k] > EXPOSURE_BYTE_MAX)
                    n = SIZE_MAX / 2; /* one clipped pixel, and the mean is wrong */
                sum[k] += (double)linear[px[k]];
            }
            n++;
        }
    for (size_t k = 0; k < 3; k++)
        out[k] = n && n < SIZE_MAX / 2 ? (float)log2(sum[k] / (double)n) : NAN;
}

static enum err_code exposure_sample_task(void *user, size_t i, struct err *e)
{
    struct exposure *x = user;
    const struct scene *s = &x->g->scene;
    char folder[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct image img = {0};
    float linear[256];
    if (signals_stopping())
        return err_set(e, ERR_CANCEL, "stopped");
    enum err_code rc = file_join(folder, x->g->dir.part, "images", e);
    if (!rc)
        rc = file_join(path, folder, s->images[i].name, e);
    if (!rc)
        rc = image_read(path, NULL, &img, e);
    for (size_t k = 0; k < 256; k++)
        linear[k] = exposure_to_linear((float)k / 255.0f);
    for (size_t t = x->first[i]; !rc && t < x->first[i + 1]; t++)
        exposure_sample(&img, linear, &s->tracks[t], x->light[t]);
    image_free(&img);
    return rc;
}

/* ---- least squares ---- */

/* How far the observation lies from what its point and photograph say, mean square over
 * channels. */
static double exposure_weight(const struct exposure *x, size_t t)
{
    const struct scene_track *o = &x->g->scene.tracks[t];
    double r2 = 0.0;
    for (size_t k = 0; k < 3; k++) {
        double r = (double)x->light[t][k] - x->point[o->point][k] - x->image[o->image][k];
        r2 += r * r / 3.0;
    }
    return 1.0 / (1.0 + r2 / (EXPOSURE_CAUCHY_EV * EXPOSURE_CAUCHY_EV));
}

/* Every point's light, given the photographs. `even`: all observations weigh alike, as before there
 * are residuals. */
static void exposure_fit_points(struct exposure *x, double *next, bool even)
{
    const struct scene *s = &x->g->scene;
    memset(x->weight, 0, s->n_points * sizeof *x->weight);
    memset(next, 0, 3 * s->n_points * sizeof *next);
    for (size_t t = 0; t < s->n_tracks; t++) {
        const struct scene_track *o = &s->tracks[t];
        if (isnan(x->light[t][0]))
            continue;
        double w = even ? 1.0 : exposure_weight(x, t);
        x->weight[o->point] += w;
        for (size_t k = 0; k < 3; k++)
            next[3 * o->point + k] += w * ((double)x->light[t][k] - x->image[o->image][k]);
    }
    for (size_t j = 0; j < s->n_points; j++)
        for (size_t k = 0; k < 3; k++)
            x->point[j][k] = x->weight[j] > 0.0 ? next[3 * j + k] / x->weight[j] : 0.0;
}

/* Every photograph's exposure, given the points; the largest change, stops. */
static double exposure_fit_images(struct exposure *x)
{
    const struct scene *s = &x->g->scene;
    double mean[3] = {0.0}, change = 0.0;
    for (size_t i = 0; i < s->n_images; i++) {
        double sum[3] = {0.0}, w = EXPOSURE_PRIOR;
        for (size_t t = x->first[i]; t < x->first[i + 1]; t++) {
            if (isnan(x->light[t][0]))
                continue;
            double one = exposure_weight(x, t);
            w += one;
            for (size_t k = 0; k < 3; k++)
                sum[k] += one * ((double)x->light[t][k] - x->point[s->tracks[t].point][k]);
        }
        for (size_t k = 0; k < 3; k++) {
            change = fmax(change, fabs(sum[k] / w - x->image[i][k]));
            x->image[i][k] = sum[k] / w;
            mean[k] += x->image[i][k] / (double)s->n_images;
        }
    }
    for (size_t i = 0; i < s->n_images; i++)
        for (size_t k = 0; k < 3; k++)
            x->image[i][k] -= mean[k];
    return change;
}

/* Known observations of a photograph, and their root mean square residual. */
static size_t exposure_count(const struct exposure *x, size_t i, double *residual_ev)
{
    const struct scene *s = &x->g->scene;
    double sum = 0.0;
    size_t n = 0;
    for (size_t t = x->first[i]; t < x->first[i + 1]; t++) {
        const struct scene_track *o = &s->tracks[t];
        for (size_t k = 0; k < 3 && !isnan(x->light[t][0]); k++) {
            double r = (double)x->light[t][k] - x->point[o->point][k] - x->image[i][k];
            sum += r * r / 3.0;
            n += k == 0;
        }
    }
    *residual_ev = n ? sqrt(sum / (double)n) : 0.0;
    return n;
}

/* Into the scene; photographs with too few observations keep the mean, all do where they hardly
 * differ. The mean over all is exactly 0. */
static size_t exposure_keep(struct exposure *x)
{
    struct scene *s = &x->g->scene;
    double mean[3] = {0.0}, sum = 0.0;
    size_t known = 0;
    for (size_t i = 0; i < s->n_images; i++) {
        double r;
        bool enough = exposure_count(x, i, &r) >= EXPOSURE_OBSERVATIONS_MIN;
        known += enough;
        for (size_t k = 0; k < 3; k++) {
            x->image[i][k] = enough ? fmin(fmax(x->image[i][k], -(double)EXPOSURE_EV_MAX / 2.0),
                                           (double)EXPOSURE_EV_MAX / 2.0)
                                    : (double)NAN;
            mean[k] += enough ? x->image[i][k] : 0.0;
        }
    }
    for (size_t i = 0; i < s->n_images; i++)
        for (size_t k = 0; k < 3; k++)
            x->image[i][k] = isnan(x->image[i][k]) ? 0.0 : x->image[i][k] - mean[k] / (double)known;
    for (size_t i = 0; i < s->n_images; i++)
        for (size_t k = 0; k < 3; k++)
            sum += x->image[i][k] * x->image[i][k];
    bool differ = known && sqrt(sum / (3.0 * (double)known)) >= EXPOSURE_LEAST_EV;
    for (size_t i = 0; i < s->n_images; i++)
        for (size_t k = 0; k < 3; k++)
            s->images[i].exposure_ev[k] = differ ? (float)x->image[i][k] : 0.0f;
    return known;
}

enum err_code ingest_exposure_find(struct ingest *g, struct err *e)
{
    struct scene *s = &g->scene;
    struct exposure x = {.g = g};
    double *next = mem_array(s->n_points, 3 * sizeof *next);
    x.first = mem_array(s->n_images + 1, sizeof *x.first);
    x.light = mem_array(s->n_tracks, sizeof *x.light);
    x.point = mem_array(s->n_points, sizeof *x.point);
    x.image = mem_array(s->n_images, sizeof *x.image);
    x.weight = mem_array(s->n_points, sizeof *x.weight);
    enum err_code rc =
        next && x.first && x.light && x.point && x.image && x.weight
            ? ERR_OK
            : err_set(e, ERR_MEM, "ingest: out of memory for exposures of %zu points", s->n_points);
    for (size_t t = 0; !rc && t < s->n_tracks; t++)
        x.first[s->tracks[t].image + 1] = t + 1;
    for (size_t i = 1; !rc && i <= s->n_images; i++)
        if (x.first[i] < x.first[i - 1])
            x.first[i] = x.first[i - 1];
    if (!rc)
        rc = pool_for(s->n_images, 0, exposure_sample_task, &x, e);
    double change = HUGE_VAL;
    for (int k = 0; !rc && k < EXPOSURE_SWEEPS && change > EXPOSURE_DONE_EV; k++) {
        exposure_fit_points(&x, next, k == 0);
        change = exposure_fit_images(&x);
    }
    if (!rc) {
        size_t known = exposure_keep(&x);
        if (known < s->n_images)
            log_warn("ingest",
                     "%zu of %zu photographs share too few points with others for their exposure "
                     "to be found: the mean is taken",
                     s->n_images - known, s->n_images);
    }
    mem_free(next);
    mem_free(x.first);
    mem_free(x.light);
    mem_free(x.point);
    mem_free(x.image);
    mem_free(x.weight);
    return rc;
}
