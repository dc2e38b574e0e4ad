/* Fair scores of a model with appearance: the light of a photograph is learnt from one half of it,
 * and the other half is scored.
 *
 * For each test photograph only its embedding is optimised, with the training loss, on the pixels
 * left of the middle (columns [0, W/2)). If the model was trained at the mean exposure, the
 * photograph's exposure is found first. Then the part right of the middle is drawn and scored. The
 * same is done with the sides exchanged. The photograph's score is the mean of both. Both halves,
 * and those of its mask, are cut out before loss and metric, so no window of SSIM crosses the
 * middle. Learning ignores masked pixels; a photograph whose mask leaves nothing of one
 * half is not scored. A model without appearance is scored on the same halves and learns nothing.
 * Protocol: NeRF in the Wild (Martin-Brualla 2021), REUrbanGS (ICCV 2025).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_HALF_IMAGE_H
#define TRAIN_HALF_IMAGE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct appearance_view;
struct camera;
struct dev;
struct err;
struct evaluate_score;
struct photo;
struct photo_loader;
struct photometric;
struct render;
struct render_model;
struct render_options;

enum half_image_side { HALF_IMAGE_LEFT, HALF_IMAGE_RIGHT };

struct half_image_config { /* all borrowed */
    struct dev *dev;
    struct render *render;
    struct photometric *loss;
    struct appearance_view *appearance; /* NULL: a model without */
    uint32_t steps;                     /* HALF_IMAGE_STEPS */
    double lr, lr_end;                  /* 0.01 falling to 0.0005, exponentially */
    bool exposure; /* the photograph's exposure is found from the half that is learnt from; else its
                      exposure_ev is used */
    bool random;   /* start from N(0, 1) instead of the nearest cameras' mean */
    uint64_t seed;
};
#define HALF_IMAGE_STEPS 200
#define HALF_IMAGE_LR 0.01
#define HALF_IMAGE_LR_END 5e-4

/* What draws: gives the Gaussians on the device for a camera and how to draw them. The model is
 * valid until the next call. */
struct half_image_source {
    enum err_code (*prepare)(void *user, const struct camera *cam,
                             const struct render_model **model, struct render_options *ro,
                             struct err *e);
    void *user;
};

/* Steps for each half: HALF_IMAGE_STEPS, or fewer, so that n photographs take at most as long as
 * `trained` steps of training did (0: not known). Two halves of a picture cost as much as one step
 * of training. */
uint32_t half_image_steps(double trained, size_t n_photos);

struct half_image; /* device buffers */
/* half_image_close it. ERR_MEM. */
enum err_code half_image_open(const struct half_image_config *c, struct half_image **out,
                              struct err *e) ERR_USE;
void half_image_close(struct half_image **h);
/* Columns [first, first + count) of a side. */
void half_image_columns(uint32_t width_px, enum half_image_side side, uint32_t *first,
                        uint32_t *count);
/* Is there anything on both sides to learn from and to score? */
bool half_image_is_seen(const struct photo *p);
/* The exposure of a photograph (p->exposure_ev is set) from one side of it, drawn with an embedding
 * (NULL: without). 0 where too few pixels are exposed well. ERR_MEM, ERR_DEVICE. */
enum err_code half_image_expose(struct half_image *h, struct photo *p, const struct render_model *m,
                                const struct render_options *ro, enum half_image_side side,
                                const float *image, struct err *e) ERR_USE;
/* Learn the embedding of a photograph, brought to the mean exposure by its exposure_ev, from one
 * side. image [len_image]: start in, result out. ERR_CANCEL: stopped by a signal; ERR_MEM,
 * ERR_DEVICE. */
enum err_code half_image_fit(struct half_image *h, const struct photo *p,
                             const struct render_model *m, const struct render_options *ro,
                             enum half_image_side side, float *image, struct err *e) ERR_USE;
/* Score one side of a photograph drawn with an embedding (NULL: without) and exposed as it was;
 * added to sum. ERR_MEM, ERR_DEVICE, and what evaluate_photo fails with. */
enum err_code half_image_score(struct half_image *h, const struct photo *p,
                               const struct render_model *m, const struct render_options *ro,
                               enum half_image_side side, const float *image,
                               struct evaluate_score *sum, struct err *e) ERR_USE;
/* The protocol over a loader's list: means as evaluate_run's. ERR_DATA: no photographs, or one of a
 * single column; ERR_CANCEL: stopped by a signal; else as of half_image_score. */
enum err_code half_image_run(struct half_image *h, struct photo_loader *f, size_t n_photos,
                             const struct half_image_source *src, struct evaluate_score *out,
                             struct err *e) ERR_USE;

#endif
