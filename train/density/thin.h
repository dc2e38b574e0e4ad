/* Thins a level: removes the Gaussians whose removal is predicted to cost the least. The steps
 * that follow recover most of it. The finest level grows beyond its budget and is thinned down to
 * it in its middle. A coarser level is the finer one thinned down to its share of Gaussians.
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
struct schedule;
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
 * least are removed. After the last thinning (schedule_thinning) the finest level has its budget
 * inside the cell; nothing goes outside. A derived level has its share of Gaussians, inside and
 * outside; outside, as many as came from the coarse model are no part of that.
 * Gaussians that no photograph shows cost nothing, or go last if a short level draws only some of
 * the photographs. Moments are kept, statistics of density control become 0. ERR_CANCEL: stopped
 * by a signal, and nothing was removed. ERR_MEM, ERR_DEVICE, and the errors of
 * photo_loader_get_nth. */
enum err_code thin_run(struct model *m, struct gallery *g, struct background *background,
                       const struct site *site, const struct stage *at, struct thin_report *out,
                       struct err *e) ERR_USE;
/* Photographs that a thinning of the level draws, of n. */
size_t thin_views(const struct schedule *s, size_t n);
/* How many Gaussians of n stay inside at a thinning of the level, and outside at one of a derived
 * level; nth: from 1. */
size_t thin_inside(const struct schedule *s, uint32_t nth, size_t n);
size_t thin_outside(const struct schedule *s, size_t n);

enum { THIN_SIDES = 2 };
struct thin_rule {
    bool all_drawn;          /* all photographs were drawn */
    const uint8_t *outside;  /* [n] side of each; NULL: all are on side 0 */
    size_t most[THIN_SIDES]; /* of each side that may go */
};
/* The choice alone, for tests. rise [n]: prices; views [n]: photographs that show a Gaussian. What
 * none shows goes first if all were drawn, else last, at an infinite price. keep [n] gets the rows
 * that stay, ascending, *n_keep their number, and *given the finite prices of what goes. Gaussians
 * of equal price are removed in the order of rows. ERR_MEM. */
enum err_code thin_choose(const float *rise, const uint16_t *views, size_t n,
                          const struct thin_rule *rule, uint32_t *keep, size_t *n_keep,
                          double *given, struct err *e) ERR_USE;

#endif
