/* The number of Gaussians that a level may have. There are three rules: the table of budgets, what
 * the photographs support, or (--budget-rule auto) growth as long as held-out photographs gain.
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

enum budget_mode { BUDGET_TABLE, BUDGET_FIT, BUDGET_AUTO }; /* in the order of options.def */

/* The photographs of a cell. */
struct budget_photos {
    const struct scene *scene;
    const uint32_t *images; /* [n] */
    const double *shares;   /* [n] share of each that shows the cell, 0..1; NULL: all of it */
    size_t n, n_points;     /* n_points: Gaussians that training starts from */
};
/* The budget that n photographs of a level support: density * sum of share * sqrt(w h) px. It is at
 * least n_points, and at most `table`. It grows with the side of a picture and not with the area,
 * because detail grows with the length of edges. Shares make the budgets of cells add up to that of
 * the scene. */
size_t budget_fit(const struct budget_photos *p, const struct train_config *cfg, double downsample,
                  size_t table);
/* Applies cfg->budget_rule to the budgets of all levels, which come from the table. A level never
 * has a smaller budget than the one before. It logs what it lowered. With BUDGET_AUTO a level
 * begins with half of what fits. */
void budget_limit(const struct budget_photos *p, const struct train_config *cfg,
                  struct schedule levels[TRAIN_LEVELS_MAX]);

/* ---- BUDGET_AUTO ---- */

/* Divides the training photographs: those with i % 16 = 8 are held out and have no gradient. They
 * are not test photographs. Both lists have room for n_images. With another rule, or with fewer
 * than 16 photographs, none is held out. */
void budget_hold_out(const struct train_config *cfg, const uint32_t *images, size_t n_images,
                     uint32_t *train, size_t *n_train, uint32_t *held, size_t *n_held);

struct budget { /* {0}: not automatic. A saved state contains only `at` of it. */
    const uint32_t *held;
    size_t n_held;
    const struct camera_window *windows; /* [n_held] parts that count; NULL: whole ones; borrowed */
    size_t table[TRAIN_LEVELS_MAX];      /* largest values that budgets can be raised to */
    /* held-out photographs at the size of the level; made on first use */
    struct photo_loader *photos;
    struct appearance_view view; /* this and the next: with appearance; made on first use */
    struct half_image *half;
    struct budget_point {  /* state at the last decision */
        double n, psnr_db; /* n: Gaussians inside the cell, 0: none yet */
        bool stopped;
    } at;
};
void budget_close(struct budget *b);
/* Decides about the budget before densification x of the level; it acts about ten times a level. It
 * scores the held-out photographs, each in its own appearance: that of its group, or that of a
 * shared model. If there is neither, a few steps on the left half of the photograph learn one, and
 * the right half is scored. The gain since the last decision is in dB for a doubling of the
 * Gaussians. If it is at least cfg->budget_gain_db and the budget is nearly used, the budget rises
 * by a factor of 1.3. If it is less, growth ends for the rest of the level, inside the cell and
 * outside. A photograph that is completely masked is not scored. ERR_MEM, ERR_DEVICE, and the
 * errors of photo_loader_get_nth. */
enum err_code budget_look(struct budget *b, const struct model *m, const struct gallery *g,
                          const struct cell *cell, struct stage *at, uint32_t x,
                          struct err *e) ERR_USE;
/* Adjusts the budget at the start of a level that begins with at->start Gaussians inside the cell.
 * The level before may have grown beyond this level's first budget. A level that cannot grow would
 * never measure the gain of growth. The budget therefore becomes at least 1.3 times the start, up
 * to the table. It logs what it raised. */
void budget_next(const struct budget *b, struct stage *at);
/* The decision alone, as a pure function. */
enum budget_step { BUDGET_KEEP, BUDGET_RAISE, BUDGET_STOP };
enum budget_step budget_decide(const struct budget_point *last, double n, double psnr_db,
                               size_t budget, double gain_db);

#endif
