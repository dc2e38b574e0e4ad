/* Fair scores for a model with appearance: a photograph's appearance is learned from one half of
 * it, and the other half is scored.
 *
 * For each test photograph only its embedding is optimised, with the training loss, on the columns
 * [0, W/2). If the model was trained at the mean exposure, the photograph's exposure is measured
 * first. Then the right part is drawn and scored. The same is done with the sides exchanged, and
 * the photograph's score is the mean of both. Both halves, and those of the mask, are cut out
 * before loss and metric, so that no window of SSIM crosses the middle. Learning ignores masked
 * pixels. A photograph without pixels left in one half is not scored. A model without appearance is
 * scored on the same halves and learns nothing. Protocol: NeRF in the Wild (Martin-Brualla 2021),
 * REUrbanGS (ICCV 2025).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_HALF_IMAGE_H
#define LAB_HALF_IMAGE_H

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
    struct appearance_view *appearance; /* NULL: a model without appearance */
    uint32_t steps;                     /* usually HALF_IMAGE_STEPS */
    double lr, lr_end;                  /* 0.01, falling exponentially to 0.0005 */
    /* measure the photograph's exposure on the half that is learned from; false: use its
     * exposure_ev */
    bool exposure;
    uint64_t seed;
};
#define HALF_IMAGE_STEPS 200
#define HALF_IMAGE_LR 0.01
#define HALF_IMAGE_LR_END 5e-4

/* Gives the Gaussians on the device for a camera, and options to draw them. The model is valid
 * until the next call. */
struct half_image_source {
    enum err_code (*prepare)(void *user, const struct camera *cam,
                             const struct render_model **model, struct render_options *ro,
                             struct err *e);
    void *user;
};

/* Returns the steps for each half: HALF_IMAGE_STEPS, or fewer, so that n photographs take at most
 * as long as `trained` steps of training (0: not known). Two halves of a picture cost as much as
 * one step. */
uint32_t half_image_steps(double trained, size_t n_photos);

struct half_image; /* device buffers */
/* Prepares the protocol. Free *out with half_image_close. ERR_MEM. */
enum err_code half_image_open(const struct half_image_config *c, struct half_image **out,
                              struct err *e) ERR_USE;
void half_image_close(struct half_image **h);
/* Columns [first, first + count) of a side. */
void half_image_columns(uint32_t width_px, enum half_image_side side, uint32_t *first,
                        uint32_t *count);
/* Returns whether both sides have pixels that are not masked. */
bool half_image_is_seen(const struct photo *p);
/* Measures the exposure of a photograph on one side, drawn with an embedding (NULL: without), and
 * sets p->exposure_ev. It is 0 if too few pixels are well exposed. ERR_MEM, ERR_DEVICE. */
enum err_code half_image_expose(struct half_image *h, struct photo *p, const struct render_model *m,
                                const struct render_options *ro, enum half_image_side side,
                                const float *image, struct err *e) ERR_USE;
/* Learns the embedding of a photograph from one side, which its exposure_ev brings to the mean
 * exposure. image [len_image]: start value in, result out. ERR_CANCEL: stopped by a signal.
 * ERR_MEM, ERR_DEVICE. */
enum err_code half_image_fit(struct half_image *h, const struct photo *p,
                             const struct render_model *m, const struct render_options *ro,
                             enum half_image_side side, float *image, struct err *e) ERR_USE;
/* Scores one side of a photograph, drawn with an embedding (NULL: without) at its own exposure, and
 * adds to `sum`. ERR_MEM, ERR_DEVICE, and the errors of evaluate_photo. */
enum err_code half_image_score(struct half_image *h, const struct photo *p,
                               const struct render_model *m, const struct render_options *ro,
                               enum half_image_side side, const float *image,
                               struct evaluate_score *sum, struct err *e) ERR_USE;
/* Runs the protocol over the photographs of a loader. The means are as in evaluate_run. ERR_DATA:
 * no photographs, or one with a single column. ERR_CANCEL: stopped by a signal. Else as
 * half_image_score. */
enum err_code half_image_run(struct half_image *h, struct photo_loader *f, size_t n_photos,
                             const struct half_image_source *src, struct evaluate_score *out,
                             struct err *e) ERR_USE;

#endif
