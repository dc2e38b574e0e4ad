/* Inside of train/: the Gaussians in training as they lie on the device, and what moves them:
 * parameters, both Adam moments, statistics for densification and the 3-D filter of Mip-Splatting.
 * Knows nothing of levels, photographs or options.
 *
 *   gauss.params, adam.m1, adam.m2   float [groups][planes][16], capacity gauss.cap rows
 *   stats.*, gauss.filter            float [cap]
 *
 * One thread at a time uses a model. The device's queue orders what happens to it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_MODEL_H
#define TRAIN_MODEL_H

#include "render/permute.h"
#include "render/render.h"

struct camera;
struct cell;
struct dev;
struct mip;

struct model {       /* {0} is empty; model_close */
    struct dev *dev; /* borrowed, as is the renderer */
    struct render *render;
    struct render_model gauss;         /* what is drawn; cap may exceed n */
    struct render_adam adam;           /* the moments, and rates that level.c sets */
    struct render_density_stats stats; /* opacity NULL where Gaussians have no embeddings */
    struct mip *mip;                   /* made on first use */
    bool filter_is_current;            /* gauss.filter is that of these Gaussians */
};

/* Room for like->n Gaussians of like's degree, embeddings and origin; parameters and moments are
 * not filled, statistics are 0. `like` needs no arrays. `most`: Gaussians that there will be at
 * most as far as is known now; room for them is taken at once where that is less than twice n.
 * ERR_LIMIT: more than the renderer counts; ERR_MEM, ERR_DEVICE: the device has no room.
 * model_close it, also after an error. */
enum err_code model_open(struct model *m, struct dev *dev, struct render *render,
                         const struct gauss *like, size_t most, struct err *e) ERR_USE;
void model_close(struct model *m);
/* After model_open with this g: its parameters, and moments 0. ERR_DEVICE: from the device. */
enum err_code model_fill(struct model *m, const struct gauss *g, struct err *e) ERR_USE;
/* Gaussians as they are now; the caller says whether they are anti-aliased. gauss_free it. ERR_MEM,
 * ERR_DEVICE. */
enum err_code model_gauss(const struct model *m, struct gauss *out, struct err *e) ERR_USE;
/* Bytes in use of each of the parameters and the two moments. */
size_t model_bytes(const struct model *m);

/* Other rows out of those there are: parameters as r says, moments 0 where that is PERMUTE_NEW. The
 * arrays are done one after the other, so that when they grow no more than one of them is there
 * twice. Statistics become 0. `most` as in model_open. ERR_LIMIT: more than the renderer counts;
 * ERR_MEM, ERR_DEVICE. */
enum err_code model_move(struct model *m, const struct permutation *r, size_t most,
                         struct err *e) ERR_USE;
/* Draw the first n rows only, or again those that model_move made; the others stay. Statistics
 * become 0. ERR_DEVICE. */
enum err_code model_show(struct model *m, size_t n, struct err *e) ERR_USE;
/* The rows that are not shown are gone for good. ERR_DEVICE. */
enum err_code model_forget(struct model *m, struct err *e) ERR_USE;

/* The optimiser begins anew. ERR_DEVICE. */
enum err_code model_zero_moments(struct model *m, struct err *e) ERR_USE;
enum err_code model_zero_stats(struct model *m, struct err *e) ERR_USE;
/* Lower every opacity to `top` (0..1) and forget its moments. ERR_DEVICE. */
enum err_code model_reset_opacity(struct model *m, double top, struct err *e) ERR_USE;
/* Gaussians inside the cell. ERR_DEVICE. */
enum err_code model_count_inside(const struct model *m, const struct cell *cell, size_t *out,
                                 struct err *e) ERR_USE;
/* Compute gauss.filter for these cameras if it is not current. ERR_MEM, ERR_DEVICE. */
enum err_code model_filter(struct model *m, const struct camera *cams, size_t n_cams,
                           struct err *e) ERR_USE;

#endif
