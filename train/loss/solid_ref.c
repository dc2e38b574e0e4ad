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
    double a, d, second, zeta;
};

static struct solid_pixel solid_at(const double m[3])
{
    double a = 1 - m[2];
    return (struct solid_pixel){a, m[0] / a, m[1] / a, 1 + m[0] / a};
}

static bool solid_spreads(const double m[3])
{
    return 1 - m[2] >= SOLID_COVER_MIN && 1 - m[2] + m[0] > 0;
}

/* What the spread of a pixel is about. */
struct solid_about {
    bool known;
    double m, c, weight; /* m*, if it is known; c of the term, and its weight */
    double part;         /* f */
};

static struct solid_about solid_about(const struct solid_input *in, size_t at)
{
    double t = in->known ? (double)in->known[at] : 0.0;
    if (t > 0.0)
        return (struct solid_about){true, in->known_zeta / t - 1, SOLID_PRIOR_PX, in->prior, 1};
    double part = in->known ? in->unknown : 1;
    return (struct solid_about){false, 0, SOLID_SPREAD_PX, in->spread, part};
}

/* V, about the known depth if there is one; below 0 by rounding alone. */
static double solid_variance(struct solid_pixel p, struct solid_about about)
{
    double m = about.known ? about.m : p.d;
    return fmax(p.second - 2 * p.d * m + m * m, 0);
}

/* s of a pixel, in footprints at the depth of `held`. */
static double solid_sigma(const struct solid_input *in, size_t at, const double m[3],
                          const double held[3])
{
    double px = in->focal_px / solid_at(held).zeta, soft = SOLID_SOFT_PX / px;
    double v = solid_variance(solid_at(m), solid_about(in, at));
    return px * (sqrt(v + soft * soft) - soft);
}

/* The pixel that lies `by` strides off along x (axis 0) or y, NULL: none that has part in bends. */
static const double *solid_beside(const struct solid_input *in, const double *moments, size_t at,
                                  int axis, int by)
{
    ptrdiff_t x = (ptrdiff_t)(at % in->width_px), y = (ptrdiff_t)(at / in->width_px);
    ptrdiff_t off = by * (ptrdiff_t)in->stride;
    x += axis ? 0 : off;
    y += axis ? off : 0;
    if (x < 0 || y < 0 || x >= (ptrdiff_t)in->width_px || y >= (ptrdiff_t)in->height_px)
        return NULL;
    const double *m = moments + 3 * ((size_t)y * in->width_px + (size_t)x);
    return 1 - m[2] >= SOLID_BEND_COVER && 1 - m[2] + m[0] > 0 ? m : NULL;
}

/* b of the triplet around a pixel; *factor is what it is multiplied by. False: there is none. */
static bool solid_bend(const struct solid_input *in, const double *moments, const double *held,
                       size_t at, int axis, double *b, double *factor)
{
    const double *m[3];
    double q[3];
    for (int k = 0; k < 3; k++) {
        m[k] = solid_beside(in, moments, at, axis, k - 1);
        if (!m[k])
            return false;
        q[k] = 1 / solid_at(m[k]).zeta;
    }
    *factor = in->focal_px * solid_at(held + 3 * at).zeta;
    *b = *factor * (q[0] - 2 * q[1] + q[2]);
    return true;
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
        if (solid_spreads(moments + 3 * at)) {
            struct solid_about about = solid_about(in, at);
            double s = solid_sigma(in, at, moments + 3 * at, held + 3 * at), c = about.c;
            *(about.known ? &v.prior : &v.spread) += about.part * (1 - held[3 * at + 2]) *
                                                     (s / (1 + s * s / (c * c)) + c * atan(s / c)) /
                                                     (2 * (double)n);
        }
        for (int axis = 0; axis < 2; axis++) {
            double b, factor, c = SOLID_BEND_PX;
            if (solid_bend(in, moments, held, at, axis, &b, &factor))
                v.bend +=
                    solid_about(in, at).part * b * b / (1 + b * b / (c * c)) / (2 * (double)n);
        }
        if (in->supported && in->supported[at])
            *(solid_about(in, at).known ? &v.light_known : &v.light) +=
                solid_through(moments[3 * at + 2]) / (double)n;
    }
    return v;
}

/* Add dL/d of the three numbers of a pixel from dL/dq, q = A / (A + sum w m). */
static void solid_add_inverse(const double m[3], double g, double grad[3])
{
    struct solid_pixel p = solid_at(m);
    double q = 1 / p.zeta;
    grad[0] -= g * q * q / p.a;
    grad[2] -= g * q * (1 - q) / p.a; /* T = 1 - A */
}

static void solid_add_bends(const struct solid_input *in, const double *moments, size_t at,
                            double *grad)
{
    static const double part[3] = {1, -2, 1};
    double n = (double)in->width_px * in->height_px;
    for (int axis = 0; axis < 2; axis++) {
        double b, factor;
        if (!solid_bend(in, moments, moments, at, axis, &b, &factor))
            continue;
        double more = 1 + b * b / (SOLID_BEND_PX * SOLID_BEND_PX),
               pull = in->bend / n * solid_about(in, at).part * factor * b / (more * more);
        for (int k = 0; k < 3; k++) {
            const double *m = solid_beside(in, moments, at, axis, k - 1);
            solid_add_inverse(m, pull * part[k], grad + (m - moments));
        }
    }
}

void solid_ref_grad(const struct solid_input *in, const double *moments, double *grad)
{
    size_t n = (size_t)in->width_px * in->height_px;
    memset(grad, 0, 3 * n * sizeof *grad);
    for (size_t at = 0; at < n; at++) {
        double *g = grad + 3 * at;
        if (solid_spreads(moments + 3 * at)) {
            struct solid_pixel p = solid_at(moments + 3 * at);
            struct solid_about about = solid_about(in, at);
            double px = in->focal_px / p.zeta, soft = SOLID_SOFT_PX / px,
                   m = about.known ? about.m : p.d, v = solid_variance(p, about);
            double sigma = sqrt(v + soft * soft), s = px * (sigma - soft);
            double more = 1 + s * s / (about.c * about.c),
                   g_s = about.weight * about.part / (double)n * p.a / (more * more);
            double g_v = g_s * px / (2 * sigma);
            g[1] += g_v / p.a;
            g[0] -= g_v * 2 * m / p.a;
            g[2] += g_v * (p.second - 2 * p.d * m) / p.a; /* dV/dT = -dV/dA */
        }
        solid_add_bends(in, moments, at, grad);
        if (in->supported && in->supported[at])
            g[2] += (solid_about(in, at).known ? in->light_known : in->light) *
                    fmin(moments[3 * at + 2] / SOLID_LIGHT_T, 1) / (double)n;
    }
}
