/* Inside of train/: the state of one cell in training. level.c moves it on, state.c saves and
 * restores it, score.c looks at it, train.c makes it. Nobody else includes this but tests.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_LEVEL_H
#define TRAIN_LEVEL_H

#include "train/budget.h"
#include "train/light.h"
#include "train/regular.h"
#include "train/rows.h"
#include "train/train.h"

struct level {
    /* -- fixed for the run; all borrowed */
    const struct train_config *cfg;
    const struct scene *scene;
    const uint32_t *images; /* training photographs */
    size_t n_images;
    struct dev *dev;
    struct render *render;
    struct loss *loss;
    struct score *score;     /* made on first use by score.c, freed by level_close */
    struct regular *regular; /* the same, by regular.c */
    struct record *record;   /* NULL: none are written */
    struct train_cell cell;
    struct schedule schedule[TRAIN_LEVELS_MAX];
    uint32_t n_levels;
    struct spent spent; /* the clock that run.c started; {0} in tests, where nobody reads it */

    struct budget budget; /* the decisions of --budget auto */

    /* -- the state that a checkpoint holds */
    uint32_t at;               /* schedule[at] is in work; n_levels = all done */
    uint32_t step;             /* steps of this level that are done */
    bool pruned;               /* its last step, contribute_prune, is done */
    size_t start;              /* Gaussians inside the cell when this level began */
    struct render_model model; /* cap may exceed n */
    struct render_adam adam; /* moments in the layout of the model; step counts within the level */
    struct render_density_stats stats;
    bool filter_is_current; /* model.filter is that of these Gaussians; with --aa mip only */
    struct light light;     /* {0}: without appearance; opened before level_open */

    /* -- scratch */
    struct feed *feed; /* of this level; opened by level_begin */
    cl_mem target;     /* uint8 [h][w][3] of the step's photograph */
    size_t target_bytes;
    cl_mem mask; /* uint8 [h][w] of the step's photograph, when it has one */
    size_t mask_bytes;
    uint32_t repaired;          /* non-finite updates seen so far */
    double loss_mean, mse_mean; /* running means for people */
    double offset_mean;         /* opacity offset, mean over the visible of the last step */
    double step_s;              /* when steps were last timed */
};

/* Device buffers and the first level at step 0, from these Gaussians. level_close it, also after an
 * error. */
enum err_code level_open(struct level *l, const struct gauss *g, struct err *e) ERR_USE;
void level_close(struct level *l);
/* Open the feed of the level in work. After level_open, level_next and a restore. */
enum err_code level_begin(struct level *l, struct err *e) ERR_USE;
/* One step: photograph, forward, loss, backward with Adam, density control. `value` (may be NULL)
 * gets the loss, which waits for the device. */
enum err_code level_step(struct level *l, struct loss_value *value, struct err *e) ERR_USE;
/* The level in work is done: the next one starts from its Gaussians with a fresh optimiser. */
enum err_code level_next(struct level *l, struct err *e) ERR_USE;
/* Gaussians as they are now. gauss_free it. */
enum err_code level_gauss(struct level *l, struct gauss *out, struct err *e) ERR_USE;
struct render_options level_render_options(const struct level *l, uint32_t step);
/* The same with the look of a training photograph, once the warm-up is over. */
struct render_options level_photo_options(struct level *l, uint32_t step, uint32_t image);
/* Room for like->n Gaussians of this kind, not yet filled, moments neither; `like` without arrays.
 * For level_open, and for a restore, which fills them. */
enum err_code level_reserve(struct level *l, const struct gauss *like, struct err *e) ERR_USE;
/* Other rows out of those there are: parameters as r says, moments 0 where that is ROWS_NEW. The
 * arrays are done one after the other, so that when they grow no more than one of them is there
 * twice. Statistics become 0. */
enum err_code level_move(struct level *l, const struct rows *r, struct err *e) ERR_USE;
/* Draw the first n rows only, or again those that level_move made; the others stay. Statistics
 * become 0. */
enum err_code level_show(struct level *l, size_t n, struct err *e) ERR_USE;
/* The rows that are not shown are gone for good. */
enum err_code level_forget(struct level *l, struct err *e) ERR_USE;

/* Upload a photograph and run the loss of the last frame against it. */
enum err_code level_photo_loss(struct level *l, const struct feed_photo *p, struct err *e) ERR_USE;
/* The same without gradients: for loss_read alone. */
enum err_code level_photo_value(struct level *l, const struct feed_photo *p, struct err *e) ERR_USE;

/* ---- state.c ---- */

/* Everything needed to go on, and where the run stands. */
enum err_code state_save(struct level *l, const char *path, struct err *e) ERR_USE;
/* Into a level whose fixed part is set and which was not opened. ERR_ARG names the first option
 * that differs from the saved run's; level_close it, also after an error. */
enum err_code state_load(struct level *l, const char *path, struct err *e) ERR_USE;
/* The result of the level in work; `score` may be NULL. */
enum err_code state_save_level(struct level *l, const char *path,
                               const struct evaluate_score *score, struct err *e) ERR_USE;

/* Is this file the result of the level, last of l, by a run with l's options, cell and photographs?
 */
enum err_code state_is_result_of(const struct level *l, const char *path, bool *yes,
                                 struct err *e) ERR_USE;

/* ---- run.c ---- */

struct run_cell { /* one cell to train; all borrowed */
    const struct train_config *cfg;
    const char *base_dir; /* cells/ goes there */
    const struct scene *scene;
    const uint32_t *images;
    uint32_t *test_images;
    size_t n_images, n_test;
    struct train_cell cell;
    struct dev *dev;
    struct render *render;
    struct loss *loss;
    const struct appearance *shared; /* of all cells; NULL: the cell learns its own */
    uint64_t *steps;                 /* of this process, counted on */
};
/* Locks the cell's folder, trains what is missing in it and writes done.json last. ERR_BUSY:
 * another process is at it. */
enum err_code run_cell(const struct run_cell *job, struct train_cell_result *out,
                       struct err *e) ERR_USE;

/* ---- train.c: a scene and which of its cells are meant ---- */

struct train_scene { /* train_scene_close it, also after an error */
    const struct train_config *cfg;
    const char *dir; /* borrowed */
    struct scene scene;
    struct partition plan; /* n_cells 0: none, the scene is one cell */
    size_t *cells;         /* indices into plan.cells of those to train; {0} without a plan */
    size_t n_cells;
};
enum err_code train_scene_open(const char *dir, const struct train_config *cfg,
                               struct train_scene *out, struct err *e) ERR_USE;
void train_scene_close(struct train_scene *s);
/* Fill cell, images and test_images of `job`; they live in the scene's arena. `index` is one of
 * s->cells. */
enum err_code train_scene_cell(struct train_scene *s, size_t index, struct run_cell *job,
                               struct err *e) ERR_USE;

/* ---- score.c ---- */

struct score;
void score_free(struct score **s);
/* Importance of every Gaussian over cfg->score_views random training views: score[n], finite and >=
 * 0. params: the model's parameters as the host sees them; mean_grad [n]. */
enum err_code score_run(struct level *l, const float *params, const float *mean_grad, float *score,
                        struct err *e) ERR_USE;
/* Its parts, for tests. x -> 0..1, 0 when all are equal. Edges: [h][w], stretched. 1 / median of
 * the values above 0 among x[0], x[stride] .. x[(n - 1) stride] (0 when there are none). */
void score_stretch(float *x, size_t n);
void score_edges(const uint8_t *px, uint32_t w, uint32_t h, float *luma, float *out);
enum err_code score_inverse_median(const float *x, size_t n, size_t stride, float *out,
                                   struct err *e) ERR_USE;

#endif
