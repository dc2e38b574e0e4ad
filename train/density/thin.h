/* Thins a level out in its middle: removes the Gaussians whose removal is predicted to cost the
 * least, as many as may cost a given share of the squared error of the training photographs. The
 * steps that follow recover most of it. The number of Gaussians then follows from the scene, and
 * hardly from the seed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_THIN_H
#define TRAIN_THIN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct background;
struct gallery;
struct model;
struct site;
struct stage;
struct render_importance;

struct thin_report {
    size_t before, removed;
    size_t unseen;  /* no photograph that was drawn shows them */
    double psnr_db; /* PSNR of the mean squared error before the removal */
    double rise;    /* the predicted rise of that error, as a share of it */
};
/* Draws training photographs of the current level, each in its own appearance and with the
 * background of the step. For every Gaussian it sums over their pixels the squared change of colour
 * if it alone were not there, brought to the mean number of photographs that show a Gaussian. The
 * least are removed, until the sum of these prices is the share of the squared error that lowers
 * the PSNR by cfg->thin_db. Gaussians that no photograph shows cost nothing; they are kept if a
 * short level draws only some of the photographs. At most a third goes. Moments are kept,
 * statistics of density control become 0. ERR_CANCEL: stopped by a signal, and nothing was removed.
 * ERR_MEM, ERR_DEVICE, and the errors of photo_loader_get_nth. */
enum err_code thin_run(struct model *m, struct gallery *g, struct background *background,
                       const struct site *site, const struct stage *at, struct thin_report *out,
                       struct err *e) ERR_USE;
struct thin_rule {
    double limit; /* largest sum of the prices of what goes */
    bool all_drawn;
};
/* The choice alone, for tests. rise [n]: prices; views [n]: photographs that show a Gaussian. What
 * none shows goes if all were drawn. keep [n] gets the rows that stay, ascending, *n_keep their
 * number, at least two thirds of n, and *given the prices of what goes. Equal ones go in the order
 * of rows. ERR_MEM. */
enum err_code thin_choose(const float *rise, const uint16_t *views, size_t n,
                          const struct thin_rule *rule, uint32_t *keep, size_t *n_keep,
                          double *given, struct err *e) ERR_USE;

#endif
