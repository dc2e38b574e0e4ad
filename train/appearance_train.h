/* Inside of train/: the appearance model of a cell in training (docs/appearance.md).
 *
 * The Gaussians' embeddings are planes of the device's model and learn there, in the step fused
 * with Adam. The network and the photographs' embeddings are some thousand numbers: they live here,
 * on the host, and learn from the gradient of a frame's constants. A cell that was given a shared
 * model keeps it as it is and learns embeddings of Gaussians only, so that all cells agree.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_APPEARANCE_TRAIN_H
#define TRAIN_APPEARANCE_TRAIN_H

#include "core/appearance.h"

struct camera;
struct scene;
struct schedule;
struct train_config;

#define APPEARANCE_TRAIN_BLOB "appearance" /* in levels and states: appearance_write */
#define APPEARANCE_TRAIN_BLOB_STATE                                                                \
    "appearance_train_moments" /* in states: appearance_train_write_state */

#define APPEARANCE_TRAIN_ROW_NONE UINT32_MAX

struct appearance_train_moments { /* Adam of n numbers */
    float *m1, *m2;               /* [n] */
};
struct appearance_train { /* {0} is off; appearance_train_close */
    struct appearance model;
    bool shared; /* given: the network and the photographs stay as they are */
    uint32_t
        *row; /* [scene images] row of the photograph, APPEARANCE_TRAIN_ROW_NONE = it has none */
    size_t n_scene;
    uint32_t *alike; /* [rows] the first row of the same appearance group, which learns for it */
    struct appearance_train_moments weights, images;
    uint32_t weight_steps, *image_steps; /* updates so far; [rows] */
    float *frame, *frame_grad;           /* constants of the step's frame */
    float *weight_grad, *image_grad;
};

/* Is appearance wanted? */
bool appearance_train_wanted(const struct train_config *cfg);
/* A fresh model for these training photographs, or a copy of the shared one (may be NULL).
 * ERR_DATA when the shared one has other lengths, or lacks one of the photographs; ERR_LIMIT: a
 * name is too long for the table; ERR_MEM. appearance_train_close it, also after an error. */
enum err_code appearance_train_open(struct appearance_train *k, const struct train_config *cfg,
                                    const struct scene *s, const uint32_t *images, size_t n_images,
                                    const struct appearance *shared, struct err *e) ERR_USE;
void appearance_train_close(struct appearance_train *k);
static inline bool appearance_train_is_on(const struct appearance_train *k)
{
    return k->model.block != NULL;
}
/* Embeddings for Gaussians that have none: the last unit vector plus noise of sigma 0.01, so that
 * normalising has a gradient and all begin alike. Replaces *g. ERR_MEM. */
enum err_code appearance_train_embed(const struct appearance_train *k, uint64_t seed,
                                     struct gauss *g, struct err *e) ERR_USE;

/* Does the network learn at this level, and from which step on are frames drawn with it? */
bool appearance_train_learns(const struct appearance_train *k, const struct train_config *cfg,
                             const struct schedule *s);
uint32_t appearance_train_warmup(const struct appearance_train *k, const struct train_config *cfg,
                                 const struct schedule *s);
/* Learning rate of network and both embeddings; 0 during the warm-up. */
double appearance_train_lr(const struct appearance_train *k, const struct train_config *cfg,
                           const struct schedule *s, uint32_t step);
/* Constants of a frame of scene image `image`; NULL when appearance is off or the photograph has no
 * row. Borrowed until the next call. */
const float *appearance_train_frame(struct appearance_train *k, uint32_t image);
/* The embedding of a photograph that has a row, [len_image]; and set it, for all that learn as one
 * with it. */
void appearance_train_get(const struct appearance_train *k, uint32_t image, float *out);
void appearance_train_set(struct appearance_train *k, uint32_t image, const float *in);
/* One Adam step of the network and of a photograph from the gradient in frame_grad. */
void appearance_train_update(struct appearance_train *k, uint32_t image, double lr);
/* A level is done: moments begin anew, what was learnt stays. */
void appearance_train_restart(struct appearance_train *k);

/* What a network that has learnt nothing adds to opacity: fainter sums than this and the pruning
 * limit together are removed. */
#define APPEARANCE_TRAIN_OFFSET_IDLE 0.0066928509 /* 1 / (1 + exp(5)) */

/* Appearance for cameras that have none, of a model in training or one that was read. */
struct appearance_view {
    const struct appearance *model; /* borrowed, as is the scene */
    const struct scene *scene;
    uint32_t *row;        /* [scene images] as appearance_train_rows */
    double reach_m;       /* as appearance_train_nearest */
    float *image, *frame; /* of the last camera */
    uint32_t photograph;  /* of the scene, whose appearance every camera has, if it has a row; else
                           * that of the nearest */
};
#define APPEARANCE_VIEW_NEAREST UINT32_MAX /* photograph: none */

/* ERR_MEM, and then there is nothing to close. */
enum err_code appearance_view_open(struct appearance_view *v, const struct appearance *model,
                                   const struct scene *s, struct err *e) ERR_USE;
void appearance_view_close(struct appearance_view *v);
/* Constants of a frame in the appearance of `photograph`, or of the nearest training cameras; NULL
 * when none has a row. Borrowed until the next call. */
const float *appearance_view_frame(struct appearance_view *v, const struct camera *cam);

/* Embedding for a camera without one: mean of those of the three nearest training cameras. Distance
 * between centres, plus the angle between the axes in radians times `reach_m`, so that both count
 * as what is seen moves over the ground. 0 when no photograph of the scene has one. out
 * [len_image]. */
size_t appearance_train_nearest(const struct appearance *a, const struct scene *s,
                                const uint32_t *row, const struct camera *cam, double reach_m,
                                float *out);
/* row [scene images]: the row of each photograph in the table, or APPEARANCE_TRAIN_ROW_NONE.
 * ERR_MEM. */
enum err_code appearance_train_rows(const struct appearance *a, const struct scene *s,
                                    uint32_t *row, struct err *e) ERR_USE;
/* How far the cameras look: mean height above the scene's points, at least 1 m. */
double appearance_train_reach(const struct scene *s);

/* ---- into and out of checkpoints ---- */
/* The moments, added to `out`. ERR_MEM. */
enum err_code appearance_train_write_state(const struct appearance_train *k, struct buf *out,
                                           struct err *e) ERR_USE;
/* Into one that is open: the model's bytes and those of appearance_train_write_state. ERR_FORMAT:
 * not such bytes; ERR_DATA: of other photographs or lengths, or of a shared model that was trained
 * anew; ERR_MEM. */
enum err_code appearance_train_read_state(struct appearance_train *k, const void *model,
                                          size_t n_model, const void *state, size_t n_state,
                                          struct err *e) ERR_USE;
/* The same network, photographs and lengths, bit for bit? */
bool appearance_train_same(const struct appearance *a, const struct appearance *b);

#endif
