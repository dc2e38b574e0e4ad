/* Solidity and errors of a surface: statistics of rays through it (lab/EVALUATION.md, "Surfaces").
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_SURFACE_RAYS_H
#define LAB_SURFACE_RAYS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

/* Class of the truth at the end of a ray. */
enum surface_class {
    SURFACE_GROUND,
    SURFACE_ROOF,
    SURFACE_WALL,
    SURFACE_TREE,
    SURFACE_CAR,
    SURFACE_BASES,
    /* Paint that shows little of shape. Each is a part of its base. */
    SURFACE_ASPHALT = SURFACE_BASES,
    SURFACE_MARK,
    SURFACE_LAWN,
    SURFACE_BLACK, /* a roof */
    SURFACE_GLASS, /* a wall */
    SURFACE_CLASSES
};
const char *surface_class_name(enum surface_class c);
/* The base of a class: ground, roof or wall for a paint, else the class itself. */
enum surface_class surface_class_base(enum surface_class c);
/* Bits of all classes with this base. */
uint32_t surface_class_bits(enum surface_class base);

struct surface_ray {
    /* how far the median depth lies before the truth, or for rays from above how high over it;
     * NAN: there is none */
    float error_m;
    float thickness_m; /* from transmittance 0.9 to 0.1 along the ray; NAN: 0.1 is not reached */
    float left;        /* share of light that passes everything, 0 to 1 */
    float bright;      /* sRGB luma of the truth there, 0 to 1 */
    uint16_t met;      /* number of Gaussians until transmittance is 0.1 */
    uint8_t kind;      /* enum surface_class */
    bool edge;         /* near a step of the truth */
    bool found;        /* transmittance falls to 1/2 somewhere */
};
/* Makes a ray from the maps of a drawing (render_surface_maps). The ray's length grows by `slant`
 * for a metre of depth. truth_m: along the ray; 0: none. */
struct surface_ray surface_ray_make(double median_m, double near_m, double far_m, double left,
                                    double met, double slant, double truth_m);

struct surface_rays { /* {0} is empty; surface_rays_free */
    struct surface_ray *ray;
    size_t n, cap;
};
/* Adds a ray. ERR_MEM. */
enum err_code surface_rays_add(struct surface_rays *s, const struct surface_ray *r,
                               struct err *e) ERR_USE;
void surface_rays_free(struct surface_rays *s);

struct surface_pick {             /* selects rays; {0}: all */
    uint32_t kinds;               /* bits 1 << enum surface_class; 0: all */
    bool level, edge;             /* level: only rays away from edges; edge: only rays near them */
    float bright_from, bright_to; /* [from, to); to 0: all */
};
enum { SURFACE_ABOVE = 5 };
struct surface_figures { /* NAN: there are no rays */
    size_t n;
    double missing; /* share of rays without a surface */
    /* Errors in m of rays with a surface: median of absolute values, median with sign, root mean
     * square, 1.4826 times the median absolute deviation, and 90 and 95 % of absolute values. */
    double median_m, off_m, rmse_m, nmad_m, le90_m, le95_m;
    /* share with an error above 1, 2, 5 GSD, 0.5 m, 1 m; no surface counts as an error */
    double above[SURFACE_ABOVE];
    double follows_brightness;          /* Pearson's correlation of error and brightness */
    double thickness_m, thickness_90_m; /* of rays that become opaque: median and 90 % quantile */
    double never;                       /* share of rays that do not become opaque */
    double left, left_90;               /* median and 90 % quantile */
    double met;                         /* mean */
};
/* Computes the statistics of the selected rays. ERR_MEM. */
enum err_code surface_rays_tell(const struct surface_rays *s, const struct surface_pick *p,
                                double gsd_m, struct surface_figures *out, struct err *e) ERR_USE;

#endif
