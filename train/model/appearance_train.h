/* Internal to train/: the appearance model of a cell in training (docs/appearance.md).
 *
 * Embeddings of Gaussians are planes of the model on the device, and learn there in the step fused
 * with Adam. The network and the embeddings of photographs are some thousand numbers on the host.
 * They learn from the gradient of a frame's constants. A cell with a shared model does not change
 * it, and learns only embeddings of Gaussians, so that all cells agree.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_APPEARANCE_TRAIN_H
#define TRAIN_APPEARANCE_TRAIN_H

#include "core/splat/appearance.h"

struct camera;
struct scene;
struct schedule;
struct train_config;

#define APPEARANCE_TRAIN_BLOB "appearance" /* in levels and states: see appearance_write */
#define APPEARANCE_TRAIN_BLOB_STATE                                                                \
    "appearance_train_moments" /* in states: see appearance_train_write_state */

#define APPEARANCE_TRAIN_ROW_NONE UINT32_MAX

struct appearance_train_moments { /* Adam moments of n numbers */
    float *m1, *m2;               /* [n] */
};
struct appearance_train { /* {0} is off; free with appearance_train_close */
    struct appearance model;
    bool shared;   /* a shared model: network and photographs do not change */
    uint32_t *row; /* [scene images] row of each photograph; APPEARANCE_TRAIN_ROW_NONE = none */
    size_t n_scene;
    /* [rows] first row of the same appearance group, which learns for the whole group */
    uint32_t *alike;
    struct appearance_train_moments weights, images;
    uint32_t weight_steps, *image_steps; /* number of updates so far; [rows] */
    float *frame, *frame_grad;           /* constants of the current step's frame */
    float *weight_grad, *image_grad;
};

/* Returns whether appearance is wanted. */
bool appearance_train_wanted(const struct train_config *cfg);
/* Makes a new model for these training photographs, or copies the shared one (may be NULL). Call
 * appearance_train_close afterwards, also after an error. ERR_DATA: the shared model has other
 * lengths, or lacks a photograph. ERR_LIMIT: a name is too long for the table. ERR_MEM. */
enum err_code appearance_train_open(struct appearance_train *k, const struct train_config *cfg,
                                    const struct scene *s, const uint32_t *images, size_t n_images,
                                    const struct appearance *shared, struct err *e) ERR_USE;
void appearance_train_close(struct appearance_train *k);
static inline bool appearance_train_is_on(const struct appearance_train *k)
{
    return k->model.block != NULL;
}
/* Gives embeddings to Gaussians without any: the last unit vector plus noise of sigma 0.01. All
 * begin alike, and the noise gives normalisation a gradient. It replaces *g. ERR_MEM. */
enum err_code appearance_train_embed(const struct appearance_train *k, uint64_t seed,
                                     struct gauss *g, struct err *e) ERR_USE;

/* appearance_train_learns: whether the network learns at this level. appearance_train_warmup: the
 * first step whose frames use it. */
bool appearance_train_learns(const struct appearance_train *k, const struct schedule *s);
uint32_t appearance_train_warmup(const struct appearance_train *k, const struct train_config *cfg,
                                 const struct schedule *s);
/* Learning rate of the network and of both embeddings; 0 during the warm-up. */
double appearance_train_lr(const struct appearance_train *k, const struct train_config *cfg,
                           const struct schedule *s, uint32_t step);
/* Constants of a frame in the appearance of scene image `image`. NULL: appearance is off, or the
 * photograph has no row. Borrowed until the next call. */
const float *appearance_train_frame(struct appearance_train *k, uint32_t image);
/* Makes one Adam step of the network and of a photograph, with the gradient in frame_grad. */
void appearance_train_update(struct appearance_train *k, uint32_t image, double lr);
/* Ends a level: moments become 0, learned values stay. */
void appearance_train_restart(struct appearance_train *k);

/* Opacity offset of a network that has not learned. Gaussians fainter than this plus the pruning
 * limit are removed. */
#define APPEARANCE_TRAIN_OFFSET_IDLE 0.0066928509 /* 1 / (1 + exp(5)) */

/* Appearance for cameras without one, from a model in training or from a file. */
struct appearance_view {
    const struct appearance *model; /* borrowed, as is the scene */
    const struct scene *scene;
    uint32_t *row;        /* [scene images]: in the table, or APPEARANCE_TRAIN_ROW_NONE */
    double reach_m;       /* see appearance_train_nearest */
    float *image, *frame; /* of the last camera */
    /* every camera has the appearance of this photograph, if it has a row; else that of the nearest
     * photographs */
    uint32_t photograph;
};
#define APPEARANCE_VIEW_NEAREST UINT32_MAX /* value of `photograph`: none */

/* Prepares a view. ERR_MEM: nothing has to be closed. */
enum err_code appearance_view_open(struct appearance_view *v, const struct appearance *model,
                                   const struct scene *s, struct err *e) ERR_USE;
void appearance_view_close(struct appearance_view *v);
/* Constants of a frame in the appearance of `photograph`, or of the nearest training cameras. NULL:
 * none has a row. Borrowed until the next call. */
const float *appearance_view_frame(struct appearance_view *v, const struct camera *cam);

/* Embedding for a camera without one: the mean of those of the three nearest training cameras. The
 * distance is that of the centres, plus the angle between the axes in radians times reach_m. Both
 * then measure how far the view moves on the ground. Returns the number of cameras used; 0: no
 * photograph has an embedding. out [len_image]. */
size_t appearance_train_nearest(const struct appearance *a, const struct scene *s,
                                const uint32_t *row, const struct camera *cam, double reach_m,
                                float *out);

/* ---- reading and writing checkpoints ---- */
/* Appends the moments to `out`. ERR_MEM. */
enum err_code appearance_train_write_state(const struct appearance_train *k, struct buf *out,
                                           struct err *e) ERR_USE;
/* Reads the bytes of a model and of appearance_train_write_state into k, which is open. ERR_FORMAT:
 * they are not such bytes. ERR_DATA: they have other photographs or lengths, or the shared model
 * was trained again. ERR_MEM. */
enum err_code appearance_train_read_state(struct appearance_train *k, const void *model,
                                          size_t n_model, const void *state, size_t n_state,
                                          struct err *e) ERR_USE;
/* Returns whether network, photographs and lengths are equal, bit for bit. */
bool appearance_train_same(const struct appearance *a, const struct appearance *b);

#endif
