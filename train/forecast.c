/* The time left of a run, from what its steps cost so far.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/forecast.h"

#include <math.h>
#include <stdio.h>

#include "codec/scene.h"
#include "train/gallery.h"
#include "train/photo_loader.h"
#include "train/stage.h"

/* Measured on the demo city on two cores: 0.5 ms a thousand Gaussians, 1.1 ms a thousand pixels. */
#define FORECAST_PIXEL 2.0 /* a pixel costs so many Gaussians */
#define FORECAST_KEEP 0.8  /* of what was measured before, a look: the last dozen counts */

/* Of one step of a level. */
static double forecast_work(const struct gallery *g, const struct schedule *s, double gaussians)
{
    double pixels = 0.0;
    for (size_t i = 0; i < g->n_images; i++) {
        struct camera c = photo_loader_camera(&g->scene->images[g->images[i]].cam,
                                              (uint32_t)g->cfg->max_edge_px, s->downsample);
        pixels += (double)c.width_px * c.height_px;
    }
    return gaussians + FORECAST_PIXEL * pixels / (double)g->n_images;
}

void forecast_add(struct forecast *f, const struct gallery *g, const struct stage *at,
                  double gaussians, double steps, double seconds)
{
    f->work =
        FORECAST_KEEP * f->work + steps * forecast_work(g, stage_schedule(at), gaussians);
    f->seconds = FORECAST_KEEP * f->seconds + seconds;
}

double forecast_left_s(const struct forecast *f, const struct gallery *g, const struct stage *at,
                       double gaussians)
{
    double left = 0.0;
    for (uint32_t i = at->at; i < at->n_levels; i++) {
        const struct schedule *s = &at->levels[i];
        double steps = s->steps - (i == at->at ? at->step : 0);
        double n = i == at->at ? gaussians : fmax((double)s->budget, gaussians);
        left += steps * forecast_work(g, s, n);
    }
    return f->work > 0.0 ? f->seconds * left / f->work : 0.0;
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
