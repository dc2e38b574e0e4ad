/* How many Gaussians a level may have: the number in the table of budgets, or the number that its
 * photographs support, or (--budget auto) the number from which held-out photographs still gain.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_BUDGET_H
#define TRAIN_BUDGET_H

#include "train/appearance_train.h"
#include "train/config.h"
#include "train/schedule.h"

struct cell;
struct gallery;
struct half_image;
struct model;
struct photo_loader;
struct scene;
struct stage;

enum budget_mode { BUDGET_TABLE, BUDGET_FIT, BUDGET_AUTO }; /* as options.def lists them */

/* The budget that n photographs of one level support: density * sum over them of sqrt(w h) px, but
 * at least n_points, the Gaussians that training starts from, and at most `table`. Detail grows
 * like the length of edges in a picture, not like its area. */
size_t budget_fit(const struct scene *s, const uint32_t *images, size_t n_images,
                  const struct train_config *cfg, double downsample, size_t n_points, size_t table);
/* Apply cfg->budget_rule to the budgets of all levels, which are the table's before; they never
 * fall from level to level. Logs what was lowered. With BUDGET_AUTO a level begins with half of
 * what fits. */
void budget_limit(const struct scene *s, const uint32_t *images, size_t n_images,
                  const struct train_config *cfg, size_t n_points,
                  struct schedule levels[TRAIN_LEVELS_MAX]);

/* ---- BUDGET_AUTO ---- */

/* Photographs i with i % 16 = 8 of the training photographs are held out: they carry no gradient
 * and are not the test photographs. Both lists are filled, [n_images] each; in any other mode, and
 * with fewer than 16 photographs, none is held out. */
void budget_hold_out(const struct train_config *cfg, const uint32_t *images, size_t n_images,
                     uint32_t *train, size_t *n_train, uint32_t *held, size_t *n_held);

struct budget { /* {0}: not automatic. What a state to resume from holds of it is in `at`. */
    const uint32_t *held;
    size_t n_held;
    size_t table[TRAIN_LEVELS_MAX]; /* the most that a budget can be raised to */
    struct photo_loader *photos;    /* held out, of the level in work; made on first use */
    struct appearance_view view;    /* with appearance, as is the next: made on first use */
    struct half_image *half;
    struct budget_point {  /* where the last decision was taken */
        double n, psnr_db; /* Gaussians inside the cell, 0: none yet */
        bool stopped;
    } at;
};
void budget_close(struct budget *b);
/* Before densification x of the level in work; acts about ten times a level. Scores the held-out
 * photographs, each in its own appearance: that of its group, or that of a shared model. Where
 * neither exists, a few steps on the photograph's left half learn one, and the right half is
 * scored. The gain since the last decision is in dB for a doubling of the Gaussians. At or above
 * cfg->budget_gain_db the budget rises by 1.3 when it is nearly used. Below, growth stops for the
 * rest of the level, inside the cell and outside. A photograph that a mask covers whole is not
 * scored. Changes the budget of the level in work.
 * ERR_MEM, ERR_DEVICE, and what photo_loader_get_nth fails with. */
enum err_code budget_look(struct budget *b, const struct model *m, const struct gallery *g,
                          const struct cell *cell, struct stage *at, uint32_t x,
                          struct err *e) ERR_USE;
/* At the hand-over to the level in work, which starts with at->start Gaussians inside the cell: the
 * level before can have grown beyond the budget that this one begins with, and a level that cannot
 * grow at all never measures what growth is worth. Its budget becomes at least 1.3 times the start,
 * up to the table. Logs what was raised. */
void budget_next(const struct budget *b, struct stage *at);
/* The decision by itself. */
enum budget_step { BUDGET_KEEP, BUDGET_RAISE, BUDGET_STOP };
enum budget_step budget_decide(const struct budget_point *last, double n, double psnr_db,
                               size_t budget, double gain_db);

#endif
