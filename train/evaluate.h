/* How close drawings come to photographs.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_EVALUATE_H
#define TRAIN_EVALUATE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "render/render.h"

struct footprint; /* cells/footprint.h */
struct photo;
struct photo_loader;

struct evaluate_score { /* means over the photographs */
    size_t n_photos;
    size_t n_seen; /* of them, those that show ground which training photographs show */
    double psnr_db, seen_psnr_db; /* seen: within that ground; 0 where it is not known */
    double ssim, ssim_valid; /* ssim: zero padded as in the loss; ssim_valid: inner windows only */
    double l1, gmsd, lpips;  /* lpips: 0 without weights */
    double gaussians;        /* handed to the renderer a frame */
    double visible;          /* of them in the picture; 0 when not told */
    double ms_frame;
    double bytes; /* what the source takes in files, 0 when not told */
};
struct lpips;         /* loss/lpips.h */
struct residual_list; /* train/residual.h */
/* Something that draws: draw() renders into rgb [h][w][3] and says how many Gaussians it took. */
struct evaluate_source {
    enum err_code (*draw)(void *user, const struct camera *cam, float *rgb, double *gaussians,
                          struct err *e);
    void *user;
    void *own_size; /* user of the same, not supersampled, for maps of the surface that is drawn;
                     * NULL: user is that */
    void *above;    /* user of the same as own_size, drawn orthographically; NULL: there is none */
    const char *pictures; /* folder for NAME.png, photograph left and drawing right; NULL: none */
    double bytes;         /* of the source's files, handed through to the score */
    const struct render
        *render;         /* what draw() draws with: visible is asked of it; NULL: not told */
    struct lpips *lpips; /* NULL: no weights, not scored */
    const struct footprint *ground;  /* NULL: no seen_psnr_db */
    struct residual_list *residuals; /* gets a row a photograph; NULL: none kept */
};
/* Add the PSNR within the ground that training photographs show, if the photograph shows at least a
 * hundredth of it. ERR_MEM. */
enum err_code evaluate_seen(const struct photo *p, const struct footprint *ground, const float *rgb,
                            struct evaluate_score *sum, struct err *e) ERR_USE;
/* Add the scores of one photograph against its drawing to `sum` (PSNR, SSIM, L1), and make means of
 * `n` such sums. ERR_DATA: its mask leaves no pixel; ERR_ARG: fewer than 4 x 4 pixels; ERR_MEM. */
enum err_code evaluate_photo(const struct photo *p, const float *rgb, struct evaluate_score *sum,
                             struct err *e) ERR_USE;
bool evaluate_is_masked(const struct photo *p); /* does its mask leave no pixel? */
void evaluate_divide(struct evaluate_score *sum, double n);
/* Score the first n_photos of the loader's list, but those that a mask covers whole. ERR_DATA:
 * there are none; ERR_CANCEL: stopped by a signal; ERR_ARG: pictures too small for a score; ERR_IO:
 * `pictures` cannot be written; ERR_MEM, ERR_DEVICE, and what photo_loader_get_nth fails with. */
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
        *appearance; /* NULL: without; else that of the nearest training cameras */
};
/* ERR_MEM, ERR_DEVICE. */
enum err_code evaluate_draw_model(void *user, const struct camera *cam, float *rgb,
                                  double *gaussians, struct err *e) ERR_USE;
#endif
