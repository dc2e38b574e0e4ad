/* Figures of rays through a surface: see surface_rays.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/truth/surface_rays.h"

#include <math.h>

#include "core/base.h"
#include "core/math/sort.h"

static const double nmad_normal = 1.4826; /* sigma of a normal distribution over its MAD */

const char *surface_class_name(enum surface_class c)
{
    static const char *const names[SURFACE_CLASSES] = {
        "ground",  "roof",        "wall", "tree",       "car",
        "asphalt", "white marks", "lawn", "black roof", "glass front"};
    return names[c];
}

enum surface_class surface_class_base(enum surface_class c)
{
    switch (c) {
    case SURFACE_ASPHALT:
    case SURFACE_MARK:
    case SURFACE_LAWN:
        return SURFACE_GROUND;
    case SURFACE_BLACK:
        return SURFACE_ROOF;
    case SURFACE_GLASS:
        return SURFACE_WALL;
    default:
        return c;
    }
}

uint32_t surface_class_bits(enum surface_class base)
{
    uint32_t bits = 0;
    for (unsigned c = 0; c < SURFACE_CLASSES; c++)
        bits |= surface_class_base((enum surface_class)c) == base ? UINT32_C(1) << c : 0;
    return bits;
}

struct surface_ray surface_ray_make(double median_m, double near_m, double far_m, double left,
                                    double met, double slant, double truth_m)
{
    /* Gaussians are blended by their centres' depths, so the far one may be nearer by a little. */
    return (struct surface_ray){
        .error_m = median_m > 0.0 && truth_m > 0.0 ? (float)(truth_m - slant * median_m) : NAN,
        .thickness_m = far_m > 0.0 ? (float)(slant * fmax(far_m - near_m, 0.0)) : NAN,
        .left = (float)left,
        .found = median_m > 0.0,
        .met = (uint16_t)fmin(met, UINT16_MAX)};
}

enum err_code surface_rays_add(struct surface_rays *s, const struct surface_ray *r, struct err *e)
{
    struct surface_ray *grown = mem_room(s->ray, s->n, &s->cap, 65536, sizeof *grown);
    if (!grown)
        return err_set(e, ERR_MEM, "out of memory for %zu rays", s->n + 1);
    s->ray = grown;
    s->ray[s->n++] = *r;
    return ERR_OK;
}

void surface_rays_free(struct surface_rays *s)
{
    mem_free(s->ray);
    *s = (struct surface_rays){0};
}

static bool surface_picked(const struct surface_pick *p, const struct surface_ray *r)
{
    return (!p->kinds || (p->kinds >> r->kind & 1)) && !(p->level && r->edge) &&
           !(p->edge && !r->edge) &&
           (!(p->bright_to > 0.0f) || (r->bright >= p->bright_from && r->bright < p->bright_to));
}

/* The value that a share of x[n] does not exceed; x is put into another order. */
static double surface_quantile(float *x, size_t n, double share)
{
    return n ? (double)sort_select(x, n, (size_t)(share * (double)(n - 1) + 0.5)) : (double)NAN;
}

/* error[n] in another order afterwards; scratch[n]. */
static void surface_errors(float *error, float *scratch, size_t n, struct surface_figures *out)
{
    double sum = 0.0;
    for (size_t i = 0; i < n; i++) {
        sum += (double)error[i] * (double)error[i];
        scratch[i] = fabsf(error[i]);
    }
    out->rmse_m = sqrt(sum / (double)n);
    out->median_m = surface_quantile(scratch, n, 0.5);
    out->le90_m = surface_quantile(scratch, n, 0.9);
    out->le95_m = surface_quantile(scratch, n, 0.95);
    out->off_m = surface_quantile(error, n, 0.5);
    for (size_t i = 0; i < n; i++)
        scratch[i] = fabsf(error[i] - (float)out->off_m);
    out->nmad_m = nmad_normal * surface_quantile(scratch, n, 0.5);
}

struct surface_sums {
    double n, x, y, xx, yy, xy; /* of errors x and brightness y */
    double met, never, missing, above[SURFACE_ABOVE];
};

static void surface_add(struct surface_sums *s, const struct surface_ray *r, double gsd_m)
{
    const double limit_m[SURFACE_ABOVE] = {gsd_m, 2.0 * gsd_m, 5.0 * gsd_m, 0.5, 1.0};
    double x = (double)r->error_m, y = (double)r->bright;
    for (size_t k = 0; k < SURFACE_ABOVE; k++)
        s->above[k] += !(fabs(x) <= limit_m[k]);
    s->met += r->met;
    s->never += !isfinite(r->thickness_m);
    s->missing += !r->found;
    if (!isfinite(x))
        return;
    s->n += 1.0;
    s->x += x;
    s->y += y;
    s->xx += x * x;
    s->yy += y * y;
    s->xy += x * y;
}

static double surface_correlation(const struct surface_sums *s)
{
    double xx = s->xx - s->x * s->x / s->n, yy = s->yy - s->y * s->y / s->n;
    return (s->xy - s->x * s->y / s->n) / sqrt(xx * yy);
}

enum err_code surface_rays_tell(const struct surface_rays *s, const struct surface_pick *p,
                                double gsd_m, struct surface_figures *out, struct err *e)
{
    enum { ERROR, THICK, LEFT, SCRATCH, ARRAYS };
    struct surface_sums sums = {0};
    float *x = mem_array(s->n ? s->n : 1, ARRAYS * sizeof *x);
    size_t n = 0, found = 0, opaque = 0;
    if (!x)
        return err_set(e, ERR_MEM, "out of memory for %zu rays", s->n);
    float *error = x + ERROR * s->n, *thick = x + THICK * s->n, *left = x + LEFT * s->n;
    for (size_t i = 0; i < s->n; i++) {
        const struct surface_ray *r = &s->ray[i];
        if (!surface_picked(p, r))
            continue;
        surface_add(&sums, r, gsd_m);
        left[n++] = r->left;
        if (isfinite(r->error_m))
            error[found++] = r->error_m;
        if (isfinite(r->thickness_m))
            thick[opaque++] = r->thickness_m;
    }
    double all = (double)n; /* 0 / 0 is NaN */
    *out = (struct surface_figures){.n = n,
                                    .missing = sums.missing / all,
                                    .follows_brightness = surface_correlation(&sums),
                                    .never = sums.never / all,
                                    .met = sums.met / all};
    for (size_t k = 0; k < SURFACE_ABOVE; k++)
        out->above[k] = sums.above[k] / all;
    surface_errors(error, x + SCRATCH * s->n, found, out);
    out->thickness_m = surface_quantile(thick, opaque, 0.5);
    out->thickness_90_m = surface_quantile(thick, opaque, 0.9);
    out->left = surface_quantile(left, n, 0.5);
    out->left_90 = surface_quantile(left, n, 0.9);
    mem_free(x);
    return ERR_OK;
}
