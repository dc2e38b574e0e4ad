/* How solid a surface is and how far off: figures of rays through it (docs/evaluation.md,
 * "Surfaces").
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_SURFACE_RAYS_H
#define TRAIN_SURFACE_RAYS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

enum surface_class { /* what the truth has where a ray ends */
                     SURFACE_GROUND,
                     SURFACE_ROOF,
                     SURFACE_WALL,
                     SURFACE_TREE,
                     SURFACE_CAR,
                     SURFACE_CLASSES
};
const char *surface_class_name(enum surface_class c);

struct surface_ray {
    float
        error_m; /* by how much the place where half of the light is gone lies before the truth: of
                    * rays from above, too high; NAN: there is none */
    float thickness_m; /* from transmittance 0.9 to 0.1 along the ray; NAN: it stays above */
    float left;        /* light that passes everything, 0 to 1 */
    float bright;      /* sRGB luma of the truth there, 0 to 1 */
    uint16_t met;      /* Gaussians until transmittance is 0.1 */
    uint8_t kind;      /* enum surface_class */
    bool edge;         /* near a step of the truth */
    bool found;        /* half of the light is gone somewhere */
};
/* Where a drawing's maps say the surface is (render_surface_maps), along a ray that grows by
 * `slant` for a metre of depth. truth_m: along the ray; 0: none. */
struct surface_ray surface_ray_make(double median_m, double near_m, double far_m, double left,
                                    double met, double slant, double truth_m);

struct surface_rays { /* {0} is empty; surface_rays_free */
    struct surface_ray *ray;
    size_t n, cap;
};
/* ERR_MEM. */
enum err_code surface_rays_add(struct surface_rays *s, const struct surface_ray *r,
                               struct err *e) ERR_USE;
void surface_rays_free(struct surface_rays *s);

struct surface_pick {             /* which rays; {0}: all */
    uint32_t kinds;               /* bits 1 << enum surface_class; 0: any */
    bool level, edge;             /* away from edges alone; near them alone */
    float bright_from, bright_to; /* [from, to); to 0: any */
};
enum { SURFACE_ABOVE = 5 };
struct surface_figures { /* of nothing: NAN */
    size_t n;
    double missing; /* share without a surface */
    /* Errors, m, of those with one: median of their absolute values and with their signs, root mean
     * square, 1.4826 times the median absolute deviation, 90 and 95 % of absolute values. */
    double median_m, off_m, rmse_m, nmad_m, le90_m, le95_m;
    double above[SURFACE_ABOVE];        /* share off by more than 1, 2, 5 GSD, 0.5 m, 1 m; without a
                                  * surface is off */
    double follows_brightness;          /* Pearson's correlation of error and brightness */
    double thickness_m, thickness_90_m; /* median and 90 % of those that get opaque */
    double never;                       /* share of those that do not */
    double left, left_90;               /* median and 90 % */
    double met;                         /* mean */
};
/* ERR_MEM. */
enum err_code surface_rays_tell(const struct surface_rays *s, const struct surface_pick *p,
                                double gsd_m, struct surface_figures *out, struct err *e) ERR_USE;

#endif
