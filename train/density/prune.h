/* Measures the contribution of every Gaussian to the training photographs, and removes Gaussians
 * that contribute almost nothing.
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
struct residual_list; /* train/photographs/residual.h */
struct stage;

struct prune_report {
    /* faint, unsupported: candidates by contribution, and by support alone */
    size_t before, faint, unsupported;
    size_t removed;        /* candidates that were removed, the weakest first */
    double psnr_before_db; /* PSNR of the mean MSE over all photographs */
    double lost_db;        /* loss by the removal, in the photographs that were drawn again */
};
/* Prunes at the end of a level. It draws training photographs, each in its own appearance. For
 * every Gaussian it sums alpha T over their pixels and counts the photographs that see it. There
 * are two kinds of candidates: the faintest Gaussians, which together have the share
 * cfg->prune_contribution of the sum, and Gaussians that fewer than cfg->prune_support photographs
 * see. Candidates are removed, the weakest first, until the loss of PSNR would exceed
 * cfg->prune_loss_db. If both options are 0, nothing is removed. Moments are kept. Statistics of
 * density control become 0. `residuals` (may be NULL) gets a row for each photograph with its fit
 * before the removal, and ground (may be NULL) gives the coverage for these rows. ERR_CANCEL:
 * stopped by a signal, and nothing was removed. ERR_MEM, ERR_DEVICE, and the errors of
 * photo_loader_get_nth. */
enum err_code prune_level(struct model *m, struct gallery *g, const struct footprint *ground,
                          const struct stage *at, struct prune_report *out,
                          struct residual_list *residuals, struct err *e) ERR_USE;
struct prune_rule {
    double share;         /* share of the total contribution that the faintest may have together */
    uint32_t least_views; /* number of photographs that must show a Gaussian */
};
/* The choice alone, for tests: sets keep [n] and the counts of `out`. sum [n] over photographs
 * becomes the mean over the views [n] that show the Gaussian. scratch [n]. */
void prune_choose(float *sum, const uint16_t *views, size_t n, const struct prune_rule *rule,
                  double *scratch, uint8_t *keep, struct prune_report *out);
struct prune_trial { /* so many of the weakest removed, and what that costs */
    size_t go;
    double lost_db;
};
/* The number to remove in the next trial, above lo and below hi, which lost too much; for tests.
 * sum [go]: scores of the weakest `go`. It is where a power function through both (through hi
 * alone, if lo lost nothing) reaches the aim; halfway between the scores if hi is far off; halfway
 * between the counts if neither gives a number between. */
size_t prune_next(const double *sum, const struct prune_trial *lo, const struct prune_trial *hi,
                  double aim_db);

#endif
