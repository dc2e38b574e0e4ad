/* Which Gaussians are added and removed at one densification.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_DENSIFY_PLAN_H
#define TRAIN_DENSIFY_PLAN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "render/permute.h"

struct cell;
struct footprint;
struct trim;

enum densify_kind {
    DENSIFY_KEEP,
    DENSIFY_CLONE,
    DENSIFY_SPLIT_A,
    DENSIFY_SPLIT_B,
    DENSIFY_SHARE /* one of `parts` in the same place, see relocate.h */
};
struct densify_row {
    uint32_t source;
    uint16_t kind, parts;
};
enum densify_strategy { DENSIFY_STRATEGY_SPLIT, DENSIFY_STRATEGY_MCMC }; /* as options.def */
/* Where the two halves of a Gaussian go (order of --split). DENSIFY_SPLIT_AXIS: at +-0.8 sigma on
 * its longest axis, which is 0.6 times as long in each half. Mean and covariance of the pair are
 * those of the parent; with 0.83 of its opacity so is the mass. This is the long-axis split of
 * Improved-GS (arXiv 2508.12313), with offsets from the moments. DENSIFY_SPLIT_RANDOM: at two
 * places drawn from the parent's distribution, all axes 1.6 times shorter, opacity unchanged
 * (3DGS). */
enum densify_split { DENSIFY_SPLIT_AXIS, DENSIFY_SPLIT_RANDOM };
struct densify_params {
    const struct cell *cell;
    double origin_enu_m[3]; /* of the means in `params` */
    size_t cap_inside, cap_outside;
    enum densify_strategy strategy;         /* MCMC: tau, split and scores are not used */
    double tau, tau_outside, split_above_m; /* larger ones are split */
    enum densify_split split;
    double prune_opacity, prune_above_m; /* 0 = no limit of size */
    const struct footprint *ground;      /* NULL: nothing is known of it */
    double free_space_m; /* what lies farther above or below all points around is removed */
    double size_limit_m; /* over supported ground, longer ones are split before all others */
    const struct trim
        *rim;           /* where photographs end; NULL: not known. What lies outside is removed */
    double cut_above_m; /* larger ones that stick out of the photographs are split first */
    uint64_t seed;
    uint32_t level, step;
};
struct densify_input { /* host copies in the device layout, [groups][planes][16] */
    const float *params;
    size_t n;
    uint32_t planes;
    const float *mean_grad; /* [n] mean positional gradient per frame seen, NDC units */
    const float *opacity; /* [n] what to compare with prune_opacity; NULL: that of the parameters */
    const float *score;   /* [n] importance, >= 0; NULL while the budget does not bind: all equal */
};
struct densify_report {
    size_t before, pruned, clone_candidates, split_candidates, room, cloned, split, after, inside,
        outside, cut;      /* cut: split because they stick out, of `split` */
    bool needs_importance; /* the budget binds: call again with a score */
};
struct densify_plan { /* {0} is empty; densify_plan_free */
    struct densify_row *rows;
    size_t n;
    struct densify_report report;
};
/* Choose. Where the budget binds and there is no score, only the report is filled and rows stays
 * NULL. Afterwards there are at most cap_inside Gaussians inside the cell, or as many as before if
 * that was more; the same holds outside. densify_plan_free it. ERR_LIMIT: more than 2^31 Gaussians;
 * ERR_MEM. */
enum err_code densify_plan_make(const struct densify_params *p, const struct densify_input *in,
                                struct densify_plan *out, struct err *e) ERR_USE;
void densify_plan_free(struct densify_plan *p);
/* The rows of a plan along the Morton curve of their new means. */
struct densify_order {       /* {0} is empty; densify_order_free */
    struct permutation rows; /* where each comes from; all but those kept are PERMUTE_NEW */
    uint32_t *split;         /* [n_split] rows that are halves ... */
    float *mean;             /* [n_split][3] ... and go there */
    size_t n_split;
    uint32_t *shared; /* [n_shared] rows that share a place ... */
    uint16_t *parts;  /* [n_shared] ... with so many, themselves included */
    size_t n_shared;
    enum densify_split how;
};
/* Put the rows of a plan in that order. densify_order_free it. ERR_MEM. */
enum err_code densify_order(const struct densify_params *p, const struct densify_input *in,
                            const struct densify_plan *plan, struct densify_order *out,
                            struct err *e) ERR_USE;
void densify_order_free(struct densify_order *o);
/* After permute_move of the parameters: copies of parents that were split become their halves, and
 * those that share a place their parts. */
void densify_halve(const struct densify_order *o, float *params);
#endif
