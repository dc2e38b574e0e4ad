/* The loss on solid surfaces in double, pixel by pixel, by the formulas in train/loss/solid.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "core/base.h"
#include "train/loss/solid.h"

static bool solid_knows(const struct solid_input *in, size_t at)
{
    return in->known && in->known[at] > 0.0f;
}

/* ---- about known depths: m is S, W, T of a pixel ---- */

/* The integral of p' from 0, with s^2 = q^2 + e^2 and dq q / s = ds. */
static double solid_primitive(double s)
{
    double k = 1 + 4 * SOLID_SOFT_SIDE * SOLID_SOFT_SIDE;
    return 4 * (k * k * s - 8 * k * s * s * s / 3 + 16 * s * s * s * s * s / 5);
}

static double solid_balance(const double m[3], const double held[3])
{
    double q = m[0] / (1 - m[2]), loss = SOLID_AWAY * m[1];
    if (1 - m[2] >= SOLID_COVER_MIN)
        loss += (1 - held[2]) * (solid_primitive(sqrt(q * q + SOLID_SOFT_SIDE * SOLID_SOFT_SIDE)) -
                                 solid_primitive(SOLID_SOFT_SIDE));
    return loss;
}

static void solid_balance_grad(double weight, const double m[3], double g[3])
{
    double q = m[0] / (1 - m[2]), left = 1 - 4 * q * q;
    g[1] += weight * SOLID_AWAY;
    if (1 - m[2] < SOLID_COVER_MIN)
        return;
    double slope = weight * 4 * q * left * left / sqrt(q * q + SOLID_SOFT_SIDE * SOLID_SOFT_SIDE);
    g[0] += slope;
    g[2] += slope * q; /* of T: minus that of the A in q */
}

/* ---- without: m is the moments of depth and T ---- */

struct solid_pixel {
    double a, d, second, zeta, var;
};

static struct solid_pixel solid_at(const double m[3])
{
    double a = 1 - m[2], d = m[0] / a, second = m[1] / a;
    return (struct solid_pixel){a, d, second, 1 + d, fmax(second - d * d, 0)};
}

static bool solid_spreads(const double m[3])
{
    return 1 - m[2] >= SOLID_COVER_MIN && 1 - m[2] + m[0] > 0;
}

/* sqrt(V + e^2); px: footprints in a unit of depth */
static double solid_sigma(struct solid_pixel p, double px)
{
    return sqrt(p.var + SOLID_SOFT_PX * SOLID_SOFT_PX / (px * px));
}

static double solid_spread(double focal_px, const double m[3], const double held[3])
{
    double px = focal_px / solid_at(held).zeta, c = SOLID_REACH_PX,
           s = px * solid_sigma(solid_at(m), px) - SOLID_SOFT_PX;
    return (1 - held[2]) * (s / (1 + s * s / (c * c)) + c * atan(s / c)) / 2;
}

static void solid_spread_grad(double weight, double focal_px, const double m[3], double g[3])
{
    struct solid_pixel p = solid_at(m);
    double px = focal_px / p.zeta, sigma = solid_sigma(p, px),
           r = (px * sigma - SOLID_SOFT_PX) / SOLID_REACH_PX, more = 1 + r * r;
    double g_v = p.var > 0 ? weight * px / (2 * sigma * more * more) : 0; /* of V, A over A */
    g[0] -= 2 * g_v * p.d;
    g[1] += g_v;
    g[2] += g_v * (p.second - 2 * p.d * p.d); /* of T: minus that of A */
}

/* ---- both ---- */

/* h(T) */
static double solid_through(double t)
{
    return t < SOLID_LIGHT_T ? t * t / (2 * SOLID_LIGHT_T) : t - SOLID_LIGHT_T / 2;
}

struct solid_value solid_ref_value(const struct solid_input *in, const double *sums,
                                   const double *held)
{
    struct solid_value v = {0};
    size_t n = (size_t)in->width_px * in->height_px;
    for (size_t at = 0; at < n; at++) {
        const double *m = sums + 3 * at;
        if (in->known)
            v.spread += solid_balance(m, held + 3 * at) / (double)n;
        else if (solid_spreads(m))
            v.spread += solid_spread(in->focal_px, m, held + 3 * at) / (double)n;
        if (in->supported && in->supported[at])
            *(solid_knows(in, at) ? &v.light_known : &v.light) += solid_through(m[2]) / (double)n;
    }
    return v;
}

void solid_ref_grad(const struct solid_input *in, const double *sums, double *grad)
{
    size_t n = (size_t)in->width_px * in->height_px;
    memset(grad, 0, 3 * n * sizeof *grad);
    for (size_t at = 0; at < n; at++) {
        double *g = grad + 3 * at;
        const double *m = sums + 3 * at;
        if (in->known)
            solid_balance_grad(in->spread / (double)n, m, g);
        else if (solid_spreads(m))
            solid_spread_grad(in->spread / (double)n, in->focal_px, m, g);
        if (in->supported && in->supported[at])
            g[2] += (solid_knows(in, at) ? in->light_known : in->light) *
                    fmin(m[2] / SOLID_LIGHT_T, 1) / (double)n;
    }
}
