/* See lowpass.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/export/lowpass.h"

#include <math.h>

#include "core/splat/gauss.h"
#include "lod/store/store.h"
#include "lod/store/tree.h"

/* Measured in docs/decisions/021-low-pass.md. */
#define LOWPASS_PX2 0.4   /* added to variances, in square pixels; our renderers add 0.3 */
#define LOWPASS_FAINT 1.2 /* power of the ratio of areas: cities are seen aslant */
#define LOWPASS_LEAF 0.55 /* pixel of a leaf's low-pass form, in its median sigma */

double lowpass_pixel_m(const struct tree *t, uint32_t node)
{
    const struct tree_node v = tree_node(t, node);
    if (v.tile == TREE_NONE)
        return 0.0;
    if (v.child_count)
        return v.geometric_error_m / STORE_PX_PER_SIGMA;
    const double own_m = LOWPASS_LEAF * index_shape(t->index, v.tile).sigma_median_m;
    if (v.parent == TREE_NONE)
        return own_m;
    const double above_m = tree_node(t, v.parent).geometric_error_m / STORE_PX_PER_SIGMA;
    return fmin(own_m, above_m / TREE_ERROR_GROWTH);
}

/* Proportional to the mean over directions of the area that an ellipsoid covers; v: variances. */
static double lowpass_area(const double v[3])
{
    return sqrt(v[0] * v[1] + v[1] * v[2] + v[2] * v[0]);
}

void lowpass_gauss(struct gauss *g, double pixel_m)
{
    const double added = LOWPASS_PX2 * pixel_m * pixel_m;
    if (added <= 0.0 || !g->antialiased)
        return;
    for (size_t i = 0; i < g->n; i++) {
        double before[3], after[3];
        for (size_t k = 0; k < 3; k++) {
            float *scale = &g->scale_log[3 * i + k];
            before[k] = exp(2.0 * (double)*scale);
            after[k] = before[k] + added;
            *scale = (float)(0.5 * log(after[k]));
        }
        const double keep = pow(lowpass_area(before) / lowpass_area(after), LOWPASS_FAINT);
        const double opacity = keep / (1.0 + exp(-(double)g->opacity_logit[i]));
        g->opacity_logit[i] = (float)log(fmax(opacity, 1e-9) / fmax(1.0 - opacity, 1e-9));
    }
}
