/* Scores of a model with appearance, fairly: a photograph's light is learnt from one half of it and
 * judged on the other.
 *
 * For each test photograph only its embedding is optimised, on the pixels left of the middle
 * (columns [0, W/2)), with the training loss; then the whole picture is drawn and the part right of
 * the middle is scored. Then the other way round, from the start. The photograph's score is the
 * mean of both. Both halves are cut out before loss and metric, so no window of SSIM sees across
 * the middle. A model without appearance is scored on the same halves and learns nothing. Protocol:
 * NeRF in the Wild (Martin-Brualla 2021), REUrbanGS (ICCV 2025).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_HALF_H
#define TRAIN_HALF_H

#include "train/light.h"

enum half_side { HALF_LEFT, HALF_RIGHT };

struct half_config { /* all borrowed */
    struct dev *dev;
    struct render *render;
    struct loss *loss;
    struct light_view *look; /* NULL: a model without appearance */
    uint32_t steps;          /* 200 */
    double lr, lr_end;       /* 0.01 falling to 0.0005, exponentially */
    bool random;             /* start from N(0, 1) instead of the nearest cameras' mean */
    uint64_t seed;
};
#define HALF_STEPS 200
#define HALF_LR 0.01
#define HALF_LR_END 5e-4

/* What draws: gives the Gaussians on the device for a camera and how to draw them. The model is
 * valid until the next call. */
struct half_source {
    enum err_code (*prepare)(void *user, const struct camera *cam,
                             const struct render_model **model, struct render_options *ro,
                             struct err *e);
    void *user;
};

struct half; /* device buffers */
enum err_code half_open(const struct half_config *c, struct half **out, struct err *e) ERR_USE;
void half_close(struct half **h);
/* Columns [first, first + count) of a side. */
void half_columns(uint32_t width_px, enum half_side side, uint32_t *first, uint32_t *count);
/* Learn the embedding of a photograph from one side. image [len_image]: start in, result out. */
enum err_code half_fit(struct half *h, const struct feed_photo *p, const struct render_model *m,
                       const struct render_options *ro, enum half_side side, float *image,
                       struct err *e) ERR_USE;
/* Score one side of a photograph drawn with an embedding (NULL: without); added to sum. */
enum err_code half_score(struct half *h, const struct feed_photo *p, const struct render_model *m,
                         const struct render_options *ro, enum half_side side, const float *image,
                         struct evaluate_score *sum, struct err *e) ERR_USE;
/* The protocol over a feed's list: means as evaluate_run's. */
enum err_code half_run(struct half *h, struct feed *f, size_t n_photos,
                       const struct half_source *src, struct evaluate_score *out,
                       struct err *e) ERR_USE;

#endif
