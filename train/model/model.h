/* Internal to train/: the Gaussians in training on the device, and their optimiser: parameters,
 * both Adam moments, and statistics for densification. It does not know levels, photographs or
 * options.
 *
 *     gauss.params             float [groups][planes][16], capacity gauss.cap rows
 *     adam.moments             uint32_t, the same: both moments of each parameter (render.h)
 *     stats.*                  float [cap]
 *
 * Only one thread at a time uses a model. The device's queue orders the work on it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_MODEL_H
#define TRAIN_MODEL_H

#include "render/permute.h"
#include "render/render.h"

struct camera;
struct cell;
struct defer;
struct dev;
struct render_options;

struct model {       /* {0} is empty; free with model_close */
    struct dev *dev; /* borrowed, as is the renderer */
    struct render *render;
    struct render_model gauss;         /* Gaussians to draw; cap may exceed n */
    struct render_adam adam;           /* moments, and learning rates set by level.c */
    struct render_density_stats stats; /* opacity is NULL if Gaussians have no embeddings */
    struct defer *defer;               /* steps that Gaussians are owed; made on first use */
    struct render_model
        seen; /* model_see: what the step at hand draws, borrowed of the two above */
};

/* Allocates room for like->n Gaussians with like's degree, embedding length and origin. `like`
 * needs no arrays. Parameters and moments are not filled, statistics are 0. `most` is the largest
 * number expected now; room for it is allocated at once if it is less than twice n. Call
 * model_close afterwards, also after an error; the model can be opened again then. ERR_LIMIT: more
 * than the renderer can count. ERR_MEM, ERR_DEVICE: the device has no room. */
enum err_code model_open(struct model *m, struct dev *dev, struct render *render,
                         const struct gauss *like, size_t most, struct err *e) ERR_USE;
void model_close(struct model *m);
/* Fills the parameters from g, the `like` of model_open, and sets moments to 0. ERR_DEVICE. */
enum err_code model_fill(struct model *m, const struct gauss *g, struct err *e) ERR_USE;
/* Copies the present Gaussians. The caller sets whether they are anti-aliased. Free *out with
 * gauss_free. ERR_MEM, ERR_DEVICE. */
enum err_code model_gauss(const struct model *m, struct gauss *out, struct err *e) ERR_USE;
/* Bytes in use in each of two arrays: the parameters and their moments. */
size_t model_bytes(const struct model *m);

/* Sets m->seen, the Gaussians that a step with this view draws and moves. With `defers` these are
 * the groups in the frustum, and the others are owed the step (render/defer.h); else all, which
 * are settled first. After the step's backward pass call model_stepped. ERR_MEM, ERR_DEVICE. */
enum err_code model_see(struct model *m, bool defers, const struct camera *cam,
                        const struct render_options *o, struct err *e) ERR_USE;
enum err_code model_stepped(struct model *m, struct err *e) ERR_USE;
/* Gaussians make the steps that they are owed. Call it before anything but a step reads or changes
 * parameters or moments. ERR_MEM, ERR_DEVICE. */
enum err_code model_settle(struct model *m, struct err *e) ERR_USE;

/* What a frame shows that is only drawn: all Gaussians, or where steps were deferred the groups in
 * its frustum. The frame has the same bits. */
struct model_look {
    struct render_model shown; /* borrowed of the model; draw it before it looks again */
    void *groups; /* model_look_map: [shown.groups], mapped; NULL: all, in their order */
};
/* Looks at a model that is owed no steps (model_settle). ERR_ARG (camera), ERR_MEM, ERR_LIMIT,
 * ERR_DEVICE. */
enum err_code model_look(struct model *m, const struct camera *cam, const struct render_options *o,
                         struct model_look *out, struct err *e) ERR_USE;
/* Shows the host which groups these are, until model_look_unmap. ERR_DEVICE. */
enum err_code model_look_map(const struct model *m, struct model_look *l, struct err *e) ERR_USE;
enum err_code model_look_unmap(const struct model *m, struct model_look *l, struct err *e) ERR_USE;
/* The model's row of a Gaussian in the frame. */
static inline size_t model_look_row(const struct model_look *l, size_t i)
{
    const uint32_t *groups = l->groups;
    return groups ? (size_t)groups[i / LAYOUT_LANES] * LAYOUT_LANES + i % LAYOUT_LANES : i;
}

/* What a state needs to go on as if it had not been saved. model_owed: the last step that each
 * group has made, uint32_t [gauss.groups] on the device; *out is NULL if none is owed any.
 * model_owe takes it back, and returns the first step that model_stepped has to be called for with
 * m->adam of that step, before steps go on after the present one. ERR_MEM, ERR_DEVICE. */
enum err_code model_owed(struct model *m, cl_mem *out, struct err *e) ERR_USE;
enum err_code model_owe(struct model *m, const uint32_t *settled, uint32_t *first,
                        struct err *e) ERR_USE;

/* Replaces the rows by those that r describes. Moments are 0 for PERMUTE_NEW, statistics become 0.
 * Arrays are changed one after another, so at most one of them exists twice when they grow. `most`:
 * as in model_open. ERR_LIMIT: more than the renderer can count. ERR_MEM, ERR_DEVICE. */
enum err_code model_move(struct model *m, const struct permutation *r, size_t most,
                         struct err *e) ERR_USE;
/* Draws only the first n rows from now on; a larger n shows rows of the last model_move again.
 * Hidden rows are kept. Statistics become 0. ERR_DEVICE. */
enum err_code model_show(struct model *m, size_t n, struct err *e) ERR_USE;
/* Set moments, or statistics, to 0. ERR_DEVICE. */
enum err_code model_zero_moments(struct model *m, struct err *e) ERR_USE;
enum err_code model_zero_stats(struct model *m, struct err *e) ERR_USE;
/* Number of Gaussians inside the cell. outside [n]: 1 where one is not, else 0; may be NULL.
 * ERR_DEVICE. */
enum err_code model_count_inside(struct model *m, const struct cell *cell, uint8_t *outside,
                                 size_t *out, struct err *e) ERR_USE;

#endif
