/* What every Gaussian contributes to the training photographs, and the removal of Gaussians that
 * contribute next to nothing.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_PRUNE_H
#define TRAIN_PRUNE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct footprint;
struct gallery;
struct model;
struct residual_list; /* train/residual.h */
struct stage;

struct prune_report {
    size_t before, faint, unsupported; /* candidates: for their contribution; for support alone */
    size_t removed;                    /* of them, the weakest first */
    double psnr_before_db;             /* of the photographs that measured: mean MSE, as PSNR */
    double lost_db;                    /* by the removal, in those that were drawn again */
};
/* At the end of a level: draw training photographs, each in its own appearance, add up alpha T of
 * every Gaussian over their pixels, and count the photographs that see it. Two kinds are
 * candidates: the faintest, which together hold the share cfg->prune_contribution of the sum, and
 * Gaussians in fewer than cfg->prune_support photographs. They are removed, the weakest first,
 * until the loss of PSNR would exceed cfg->prune_loss_db. With both options 0 nothing is removed.
 * Moments are kept; statistics of density control are 0 afterwards. With `residuals`, all
 * photographs are drawn and each gets a row with its fit before the removal. Without (NULL), a
 * short level draws some of the photographs and does not ask for support. ground (may be NULL) is
 * for the coverage of these rows. ERR_CANCEL: stopped by a signal, and nothing was removed;
 * ERR_MEM, ERR_DEVICE, and what photo_loader_get_nth fails with. */
enum err_code prune_level(struct model *m, struct gallery *g, const struct footprint *ground,
                          const struct stage *at, struct prune_report *out,
                          struct residual_list *residuals, struct err *e) ERR_USE;
/* Did all photographs measure, or some? With some, a Gaussian that none of them shows is kept. */
enum prune_measured { PRUNE_ALL, PRUNE_SOME };
struct prune_rule {
    enum prune_measured measured;
    double share;         /* of all contribution: as much as the faintest may hold together */
    uint32_t least_views; /* photographs that have to show a Gaussian */
};
/* The choice by itself: keep[n], and the counts of `out`; sum [n] over photographs becomes the mean
 * over the views [n] that show it; scratch[n]. */
void prune_choose(float *sum, const uint16_t *views, size_t n, const struct prune_rule *rule,
                  double *scratch, uint8_t *keep, struct prune_report *out);

#endif
