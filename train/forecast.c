/* The time left of a run, from what its steps cost so far.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/forecast.h"

#include <math.h>
#include <stdio.h>

#include "codec/scene/scene.h"
#include "train/base/stage.h"
#include "train/density/importance.h"
#include "train/density/thin.h"
#include "train/photographs/gallery.h"
#include "train/photographs/photo_loader.h"

/* Costs in Gaussians of a step. Measured on the demo city on two cores, 3,000 steps at three
 * levels, where a Gaussian of a step takes 0.06 us. */
#define FORECAST_STEP 25e3 /* launches and waiting, whatever is drawn */
#define FORECAST_PIXEL 1.1 /* of a step's photograph */
/* A Gaussian where a step moves those in the frustum alone: makes whole runs 0.91 and 0.92 of as
 * long, as they are (docs/decisions/010-deferred-steps.md). */
#define FORECAST_SEEN 0.86
#define FORECAST_DRAW 0.5        /* of a step: drawing a photograph for pruning */
#define FORECAST_IMPORTANCE 0.35 /* of a step: drawing half a photograph for importance */
#define FORECAST_DENSIFY 4.0     /* a Gaussian of a densification, without importance */
#define FORECAST_SCORE_PX 4.5    /* a pixel of a test photograph */
#define FORECAST_THIN 0.6        /* of a step: drawing a photograph for thinning */
#define FORECAST_OUTSIDE 0.5     /* of those inside a cell: schedule_cap_outside */
#define FORECAST_KEEP 0.9        /* of what was measured before, a look */
enum { FORECAST_PRUNE_AGAIN = 32 /* photographs that train/density/prune.c draws once more */ };

void forecast_open(struct forecast *f, const struct gallery *g, const struct stage *at,
                   size_t n_tests, bool whole)
{
    const struct train_config *c = g->cfg;
    const bool all = c->defer_from <= 0 || c->appearance; /* every step moves all */
    *f = (struct forecast){.cfg = c,
                           .views = (double)IMPORTANCE_VIEWS,
                           .seen_from = all ? HUGE_VAL : (double)c->defer_from,
                           .outside = whole ? 0.0 : FORECAST_OUTSIDE,
                           .n_images = g->n_images,
                           .n_tests = n_tests};
    const struct schedule *s = &at->levels[at->n_levels - 1];
    for (size_t i = 0; i < g->n_images; i++) {
        struct camera cam = gallery_camera(g, i, s);
        f->pixels += (double)cam.width_px * cam.height_px / (double)g->n_images;
    }
    f->pixels *= s->downsample * s->downsample;
}

double forecast_all(const struct forecast *f, const struct schedule *s, double inside)
{
    return (1.0 + f->outside) * inside + (double)s->around;
}

static double forecast_inside(const struct forecast *f, const struct stage *at, double gaussians)
{
    return fmax(gaussians - (double)stage_schedule(at)->around, 0.0) / (1.0 + f->outside);
}

static double forecast_pixels(const struct forecast *f, const struct schedule *s)
{
    return f->pixels / (s->downsample * s->downsample);
}

static double forecast_step(const struct forecast *f, const struct schedule *s, double gaussians)
{
    const double moved = gaussians < f->seen_from ? gaussians : FORECAST_SEEN * gaussians;
    return moved + FORECAST_PIXEL * forecast_pixels(f, s) + FORECAST_STEP;
}

static double forecast_densify(const struct forecast *f, const struct schedule *s, double gaussians)
{
    return FORECAST_DENSIFY * gaussians +
           FORECAST_IMPORTANCE * f->views * forecast_step(f, s, gaussians);
}

/* Pruning and the test photographs. */
static double forecast_end(const struct forecast *f, const struct stage *at,
                           const struct schedule *s, double gaussians)
{
    double views = stage_prunes(at, s) ? (double)f->n_images + FORECAST_PRUNE_AGAIN : 0.0;
    return views * FORECAST_DRAW * forecast_step(f, s, gaussians) +
           (double)f->n_tests * FORECAST_SCORE_PX * forecast_pixels(f, s);
}

/* One thinning. */
static double forecast_thin(const struct forecast *f, const struct schedule *s, double gaussians)
{
    return FORECAST_THIN * (double)thin_views(s, f->n_images) * forecast_step(f, s, gaussians);
}

/* Steps from + 1 to the end of a level that has grown, with the thinnings among them. */
static double forecast_grown(const struct forecast *f, const struct schedule *s, uint32_t from,
                             double *gaussians)
{
    double work = 0.0;
    for (uint32_t step = from + 1; !s->derived && step <= s->steps; step++) {
        const uint32_t nth = schedule_thinning(s, step);
        if (!nth || *gaussians <= (double)s->budget)
            continue;
        const double all = forecast_all(f, s, *gaussians);
        work += (step - from) * forecast_step(f, s, all) + forecast_thin(f, s, all);
        from = step;
        *gaussians = (double)thin_inside(s, nth, (size_t)*gaussians);
    }
    return work + (s->steps - from) * forecast_step(f, s, forecast_all(f, s, *gaussians));
}

/* Steps first + 1 to last, with the densifications and thinnings among them. *gaussians are those
 * inside the cell, which grow; those around it are drawn and moved, too. */
static double forecast_steps(const struct forecast *f, const struct schedule *s, uint32_t first,
                             double *gaussians)
{
    uint32_t count = schedule_densify_count(s), from = first;
    const double begin = *gaussians;
    double work = 0.0;
    uint32_t done = 0; /* densifications before `first` */
    for (uint32_t step = s->interval; step <= first; step += s->interval)
        done = schedule_densify_index(s, step) ? schedule_densify_index(s, step) : done;
    for (uint32_t step = (first / s->interval + 1) * s->interval; step <= s->steps;
         step += s->interval) {
        uint32_t x = schedule_densify_index(s, step);
        if (!x)
            continue;
        work += (step - from) * forecast_step(f, s, forecast_all(f, s, *gaussians)) +
                forecast_densify(f, s, forecast_all(f, s, *gaussians));
        from = step;
        if (x > done && count > done + 1) /* the parabola from here on */
            *gaussians =
                (double)schedule_cap((size_t)begin, schedule_grows(s), x - done, count - done);
    }
    return work + forecast_grown(f, s, from, gaussians);
}

void forecast_add(struct forecast *f, const struct stage *at, uint32_t first, double gaussians,
                  double seconds)
{
    const struct schedule *s = stage_schedule(at);
    double work = (at->step - first) * forecast_step(f, s, gaussians);
    for (uint32_t step = first + 1; step <= at->step; step++)
        if (schedule_densify_index(s, step))
            work += forecast_densify(f, s, gaussians);
    f->work = FORECAST_KEEP * f->work + work;
    f->seconds = FORECAST_KEEP * f->seconds + seconds;
}

double forecast_left_s(const struct forecast *f, const struct stage *now, double gaussians)
{
    struct stage copy = *now, *at = &copy;
    double left = 0.0, n = forecast_inside(f, now, gaussians);
    for (uint32_t i = at->at; i < at->n_levels; i = stage_after(at, i)) {
        const bool here = i == now->at && at->turned == now->turned;
        const struct schedule *s = &at->levels[i];
        if (!here && s->derived) {
            left += schedule_thinnings_derived(s) * forecast_thin(f, s, forecast_all(f, s, n));
            n *= s->thin_share;
        }
        left += forecast_steps(f, s, here ? at->step : 0, &n);
        left += forecast_end(f, at, s, forecast_all(f, s, n));
        if (at->again && !at->turned && i + 1 == at->n_levels)
            stage_turn(at, f->cfg);
    }
    return f->work > 0.0 ? f->seconds * left / f->work : 0.0;
}

double forecast_steps_s(const struct forecast *f, const struct stage *at, double gaussians)
{
    double n = forecast_inside(f, at, gaussians);
    return f->work > 0.0 ? f->seconds * forecast_steps(f, stage_schedule(at), 0, &n) / f->work
                         : 0.0;
}

void forecast_text(double seconds, char *out, size_t size)
{
    double minutes = floor(seconds / 60.0 + 0.5), hours = floor(minutes / 60.0);
    if (seconds < 90.0)
        snprintf(out, size, "%.0f s", seconds);
    else if (minutes < 90.0)
        snprintf(out, size, "%.0f min", minutes);
    else if (hours < 48.0)
        snprintf(out, size, "%.0f h %.0f min", hours, minutes - 60.0 * hours);
    else
        snprintf(out, size, "%.0f d %.0f h", floor(hours / 24.0), fmod(hours, 24.0));
}
