/* Chooses the Gaussians that one densification adds and removes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_DENSIFY_PLAN_H
#define TRAIN_DENSIFY_PLAN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "render/permute.h"

/* Gaussians farther above the highest or below the lowest sparse point nearby are removed, in
 * flight heights (docs/decisions/011-density-control.md). */
#define DENSIFY_FREE_SPACE 0.05

struct cell;
struct footprint;
struct trim;

enum densify_kind { DENSIFY_KEEP, DENSIFY_CLONE, DENSIFY_SPLIT_A, DENSIFY_SPLIT_B };
/* The halves of a Gaussian that is split lie at +-0.8 sigma on the longest axis, which is shortened
 * to 0.6 in each. The pair has the parent's mean and covariance. With 0.83 of the parent's opacity
 * it also has its mass. This is the long-axis split of Improved-GS (arXiv 2508.12313); the offsets
 * follow from the moments. */
struct densify_row {
    uint32_t source;
    enum densify_kind kind;
};
struct densify_params {
    const struct cell *cell;
    double origin_enu_m[3]; /* origin of the means in `params` */
    size_t cap_inside, cap_outside;
    /* a candidate above split_above_m is split, a smaller one cloned */
    double tau, tau_outside, split_above_m;
    /* Gaussians above prune_above_m are removed; 0 = no limit */
    double prune_opacity, prune_above_m;
    const struct footprint *ground; /* NULL: not known */
    double free_space_m; /* Gaussians this far above or below all points around are removed */
    double size_limit_m; /* over supported ground, longer ones are split before all others */
    const struct trim
        *rim; /* where the photographs end: Gaussians outside are removed; NULL: not known */
    double cut_above_m; /* larger ones that reach out of the photographs are split first */
    bool keep_order;    /* rows stay near their places: children follow their parents */
    uint64_t seed;
    uint32_t level, step;
};
struct densify_input { /* host copies in the device's layout, [groups][planes][16] */
    const float *params;
    size_t n;
    uint32_t planes;
    /* [n] mean positional gradient in the frames that saw it, NDC units */
    const float *mean_grad;
    const float *opacity; /* [n] compared with prune_opacity; NULL: use the opacity in `params` */
    const float *score;   /* [n] importance, >= 0; NULL if the budget does not bind: all equal */
};
struct densify_report {
    size_t before, pruned, clone_candidates, split_candidates, room, cloned, split, after, inside,
        outside, cut;      /* cut: those of `split` that reach out of the photographs */
    bool needs_importance; /* the budget binds: call densify_plan_score */
};
struct densify_plan { /* {0} is empty; densify_plan_free */
    struct densify_row *rows;
    size_t n;
    struct densify_report report;
    uint8_t *class, *inside; /* of densify_plan.c, while the plan needs importance */
};
/* Makes a plan. If the budget binds and there is no score, it fills only the report, and rows stays
 * NULL. The plan leaves at most cap_inside Gaussians inside the cell, or as many as before if that
 * was more; the same holds outside. Free *out with densify_plan_free. ERR_LIMIT: more than 2^31
 * Gaussians. ERR_MEM. */
enum err_code densify_plan_make(const struct densify_params *p, const struct densify_input *in,
                                struct densify_plan *out, struct err *e) ERR_USE;
/* Completes a plan that needs importance: the same parameters and input, with a score. After an
 * error the plan is empty. ERR_MEM. */
enum err_code densify_plan_score(const struct densify_params *p, const struct densify_input *in,
                                 struct densify_plan *plan, struct err *e) ERR_USE;
void densify_plan_free(struct densify_plan *p);
/* The rows of a plan, in the order of their new means along a Morton curve, or as they are in the
 * plan, where the order is kept. */
struct densify_order {       /* {0} is empty; free with densify_order_free */
    struct permutation rows; /* sources of the rows; all but kept ones are PERMUTE_NEW */
    uint32_t *split;         /* [n_split] rows that are halves */
    float *mean;             /* [n_split][3] their places */
    size_t n_split;
};
/* Computes that order. Free *out with densify_order_free. ERR_MEM. */
enum err_code densify_order(const struct densify_params *p, const struct densify_input *in,
                            const struct densify_plan *plan, struct densify_order *out,
                            struct err *e) ERR_USE;
void densify_order_free(struct densify_order *o);
/* Call it after permute_move of the parameters. Copies of split parents become halves. */
void densify_halve(const struct densify_order *o, float *params);
#endif
