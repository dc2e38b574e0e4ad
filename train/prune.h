/* What every Gaussian contributes to the training photographs, and the removal of those that do
 * not.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_PRUNE_H
#define TRAIN_PRUNE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct context;
struct model;
struct residual_list; /* train/residual.h */

struct prune_report {
    size_t before, faint,
        unsupported; /* removed: for their contribution; for their support alone */
    double psnr_before_db, psnr_after_db; /* mean MSE over the training photographs, as PSNR */
    bool undone; /* it cost more than cfg->prune_loss_db: nothing removed */
};
/* At the end of a level: draw all training photographs, each in its own appearance, add up alpha T of every Gaussian over their
 * pixels, count the photographs that see it, and remove the faintest, which together hold the share
 * cfg->prune_contribution of all, and those in fewer than cfg->prune_support photographs. Draws
 * them again and takes it back when that lost too much. Both options 0: nothing is done. Moments
 * are kept, statistics of density control are 0 afterwards. `residuals` (may be NULL) gets a row a
 * photograph, from before the removal; none where nothing is done. ERR_CANCEL: stopped by a signal, and nothing was removed;
 * ERR_MEM, ERR_DEVICE, and what photo_loader_get_nth fails with. */
enum err_code prune_level(struct model *m, struct context *ctx, struct prune_report *out,
                          struct residual_list *residuals, struct err *e) ERR_USE;
/* The choice by itself: keep[n], and the counts of `out`; scratch[n]. */
void prune_choose(const float *sum, const uint16_t *views, size_t n, double share,
                  uint32_t least_views, float *scratch, uint8_t *keep, struct prune_report *out);

#endif
