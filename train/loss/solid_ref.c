/* The loss on solid surfaces in double, pixel by pixel, by the formulas in train/loss/solid.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "core/base.h"
#include "train/loss/solid.h"

/* Of a pixel's three numbers. */
struct solid_pixel {
    double a, d, second, zeta, deviation; /* sqrt V */
};

static struct solid_pixel solid_at(const double m[3])
{
    double a = 1 - m[2], d = m[0] / a, second = m[1] / a;
    return (struct solid_pixel){a, d, second, 1 + d, sqrt(fmax(second - d * d, 0))};
}

static bool solid_knows(const struct solid_input *in, size_t at)
{
    return in->known && in->known[at] > 0.0f;
}

static bool solid_spreads(const struct solid_input *in, size_t at, const double m[3])
{
    return 1 - m[2] >= SOLID_COVER_MIN && 1 - m[2] + m[0] > 0 &&
           (!in->known || solid_knows(in, at));
}

/* b: how far the mean depth is behind the known one. */
static double solid_bias(const struct solid_input *in, size_t at, struct solid_pixel p)
{
    return solid_knows(in, at) ? p.zeta - in->known_zeta / (double)in->known[at] : 0;
}

/* z; px: footprints in a unit of depth. */
static double solid_free(const struct solid_input *in, double px)
{
    return in->known ? SOLID_FREE_PX / px : 0;
}

/* sqrt(b^2 + u^2 + e^2) */
static double solid_sigma(struct solid_pixel p, double bias, double free, double px)
{
    double over = fmax(p.deviation - free, 0), soft = SOLID_SOFT_PX / px;
    return sqrt(bias * bias + over * over + soft * soft);
}

/* s of a pixel, in footprints at the depth of `held`. */
static double solid_spread(const struct solid_input *in, size_t at, const double m[3],
                           const double held[3])
{
    double px = in->focal_px / solid_at(held).zeta;
    struct solid_pixel p = solid_at(m);
    return px * solid_sigma(p, solid_bias(in, at, p), solid_free(in, px), px) - SOLID_SOFT_PX;
}

/* h(T) */
static double solid_through(double t)
{
    return t < SOLID_LIGHT_T ? t * t / (2 * SOLID_LIGHT_T) : t - SOLID_LIGHT_T / 2;
}

struct solid_value solid_ref_value(const struct solid_input *in, const double *moments,
                                   const double *held)
{
    struct solid_value v = {0};
    size_t n = (size_t)in->width_px * in->height_px;
    for (size_t at = 0; at < n; at++) {
        if (solid_spreads(in, at, moments + 3 * at)) {
            double c = SOLID_REACH_PX, s = solid_spread(in, at, moments + 3 * at, held + 3 * at);
            v.spread += (1 - held[3 * at + 2]) * (s / (1 + s * s / (c * c)) + c * atan(s / c)) /
                        (2 * (double)n);
        }
        if (in->supported && in->supported[at])
            *(solid_knows(in, at) ? &v.light_known : &v.light) +=
                solid_through(moments[3 * at + 2]) / (double)n;
    }
    return v;
}

void solid_ref_grad(const struct solid_input *in, const double *moments, double *grad)
{
    size_t n = (size_t)in->width_px * in->height_px;
    memset(grad, 0, 3 * n * sizeof *grad);
    for (size_t at = 0; at < n; at++) {
        double *g = grad + 3 * at;
        if (solid_spreads(in, at, moments + 3 * at)) {
            struct solid_pixel p = solid_at(moments + 3 * at);
            double px = in->focal_px / p.zeta, bias = solid_bias(in, at, p),
                   free = solid_free(in, px), sigma = solid_sigma(p, bias, free, px);
            double r = (px * sigma - SOLID_SOFT_PX) / SOLID_REACH_PX, more = 1 + r * r,
                   g_s = in->spread / (double)n * p.a / (more * more);
            double g_b = g_s * px / (2 * sigma); /* of b^2 */
            double g_v = p.deviation > free ? g_b * (1 - free / p.deviation) : 0;
            g[0] += 2 * (g_b * bias - g_v * p.d) / p.a;
            g[1] += g_v / p.a;
            /* of T: minus that of A */
            g[2] += (2 * g_b * bias * p.d + g_v * (p.second - 2 * p.d * p.d)) / p.a;
        }
        if (in->supported && in->supported[at])
            g[2] += (solid_knows(in, at) ? in->light_known : in->light) *
                    fmin(moments[3 * at + 2] / SOLID_LIGHT_T, 1) / (double)n;
    }
}
