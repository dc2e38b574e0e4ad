/* Scores of drawings against photographs.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_EVALUATE_H
#define TRAIN_EVALUATE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "render/render.h"

struct footprint; /* scene/cells/footprint.h */
struct photo;
struct photo_loader;

struct evaluate_score { /* means over the photographs */
    size_t n_photos;
    size_t n_seen; /* number of photographs that show ground which training photographs show too */
    double psnr_db, seen_psnr_db; /* seen: on that ground alone; 0: the ground is not known */
    /* ssim: zero padded, as in the loss; ssim_valid: only windows inside */
    double ssim, ssim_valid;
    double l1, gmsd;
    double more;      /* of evaluate_source.more; 0: there is none */
    double gaussians; /* number given to the renderer for a frame */
    double visible;   /* number of these in the picture; 0: not known */
    double ms_frame;
    double bytes; /* size of the source's files; 0: not known */
};
struct residual_list; /* train/photographs/residual.h */
/* A score beside those of struct evaluate_score. run() compares rgb [h][w][3] with a photograph. */
struct evaluate_more {
    const char *key; /* its name in documents */
    enum err_code (*run)(void *user, const struct photo *p, const float *rgb, double *out,
                         struct err *e);
    void *user;
};
/* A source of drawings. draw() renders into rgb [h][w][3] and returns the number of Gaussians. */
struct evaluate_source {
    enum err_code (*draw)(void *user, const struct camera *cam, float *rgb, double *gaussians,
                          struct err *e);
    void *user;
    /* folder for NAME.png with photograph left and drawing right; NULL: none */
    const char *pictures;
    double bytes;                /* size of the source's files, copied to the score */
    const struct render *render; /* renderer of draw(), which gives `visible`; NULL: not known */
    const struct evaluate_more *more; /* NULL: none */
    const struct footprint *ground;   /* NULL: no seen_psnr_db */
    struct residual_list *residuals;  /* gets a row for each photograph; NULL: none */
    /* PSNR and SSIM are all that is wanted: l1 and gmsd stay 0, and ms_frame is of one drawing */
    bool brief;
};
/* evaluate_photo adds the scores of one photograph against its drawing to `sum` (PSNR, SSIM, L1).
 * evaluate_divide makes means of n such sums. ERR_DATA: its mask leaves no pixel. ERR_ARG: less
 * than 4 x 4 pixels. ERR_MEM. */
enum err_code evaluate_photo(const struct photo *p, const float *rgb, struct evaluate_score *sum,
                             struct err *e) ERR_USE;
void evaluate_divide(struct evaluate_score *sum, double n);
/* Scores the first n_photos of the loader's list, without those that are completely masked. If none
 * is left, out->n_photos is 0 and the means are NaN. ERR_DATA: the argument n_photos is 0.
 * ERR_CANCEL: stopped by a signal. ERR_ARG: pictures are too small. ERR_IO: `pictures` cannot be
 * written. ERR_MEM, ERR_DEVICE, and the errors of photo_loader_get_nth. */
enum err_code evaluate_run(struct photo_loader *f, size_t n_photos,
                           const struct evaluate_source *src, struct evaluate_score *out,
                           struct err *e) ERR_USE;
/* A model on the device as a source; `user` is a struct evaluate_model. */
struct appearance_view;
struct evaluate_model {
    struct render *render;
    const struct render_model *model;
    struct render_options options;
    struct appearance_view
        *appearance; /* NULL: none; else each camera has that of the nearest training cameras */
};
/* Draws it, as evaluate_source.draw. ERR_MEM, ERR_DEVICE. */
enum err_code evaluate_draw_model(void *user, const struct camera *cam, float *rgb,
                                  double *gaussians, struct err *e) ERR_USE;
#endif
