/* Internal to train/: the training photographs of the current level. Any of them can be drawn from
 * the model and compared with its drawing. level.c sets the members and gallery.c uses them. Other
 * modules read the options, the engine and the number of photographs.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_GALLERY_H
#define TRAIN_GALLERY_H

#include "render/render.h"
#include "train/base/config.h"
#include "train/base/fixed.h"

struct appearance_train;
struct model;
struct photo;
struct photometric_value;
struct photo_loader;
struct scene;
struct schedule;
struct stage;

struct gallery { /* free with gallery_close */
    /* -- fixed for the run; borrowed -- */
    const struct train_config *cfg;
    struct engine engine;
    const struct scene *scene;
    const uint32_t *images; /* [n_images] training photographs, indices into the scene's images */
    size_t n_images;
    const struct camera_window *windows; /* [n_images] parts that show the cell; NULL: all */
    struct appearance_train *appearance;
    double near_m; /* near plane of all frames */
    /* -- of gallery.c -- */
    struct photo_loader *photos; /* opened by gallery_open */
    cl_mem target;               /* uint8 [h][w][3] of the photograph that was compared last */
    size_t target_bytes;
    cl_mem mask; /* uint8 [h][w] of its mask, if it has one */
    size_t mask_bytes;
};
/* Opens the photographs at the size of a level, and closes those of the level before. ERR_MEM,
 * ERR_LIMIT. */
enum err_code gallery_open(struct gallery *g, const struct schedule *s, struct err *e) ERR_USE;
void gallery_close(struct gallery *g);

/* Options for a frame without appearance. */
struct render_options gallery_options(const struct gallery *g, const struct stage *at);
/* Options for a frame in the appearance of a training photograph, once the warm-up is over. image:
 * index into the scene's images. The constants of the frame are borrowed until the next call. */
struct render_options gallery_photo_options(const struct gallery *g, const struct stage *at,
                                            uint32_t image);

/* Hands a photograph to the device, without waiting for the device: its frame must be drawn next,
 * and the photograph must stay until then. ERR_MEM, ERR_DEVICE. */
enum err_code gallery_hand_over(struct gallery *g, const struct photo *p, struct err *e) ERR_USE;
/* Computes the loss of the last frame against its photograph, which was handed over. The renderer
 * then has the gradient, and photometric_read waits for the value. ERR_MEM, ERR_DEVICE. */
enum err_code gallery_loss(struct gallery *g, const struct photo *p, struct err *e) ERR_USE;
/* Hands a photograph over, draws Gaussians as it shows them, and reads the value; without SSIM it
 * takes a fraction of the time, ssim is 1, and total is without it. It waits. ERR_MEM,
 * ERR_DEVICE. */
enum err_code gallery_score(struct gallery *g, const struct photo *p, const struct render_model *m,
                            const struct render_options *ro, bool with_ssim,
                            struct photometric_value *out, struct err *e) ERR_USE;

/* Cameras of the training photographs at the size of the scene's, [n_images]; free them with
 * mem_free. NULL: out of memory. */
struct camera *gallery_cameras_full(const struct gallery *g);
/* The camera of photograph `nth` of the list, as it is drawn at a level. */
struct camera gallery_camera(const struct gallery *g, size_t nth, const struct schedule *s);
/* The footprint of a pixel of the level's photographs on the ground, in metres. 0: the ground is
 * not known. */
double gallery_footprint_m(const struct gallery *g, const struct site *site,
                           const struct schedule *s);
/* The longest sigma in metres of Gaussians that density control clones; longer ones are split. It
 * is the footprint of a pixel of the level's photographs on the ground. If the ground is not known,
 * it is a fixed share of the camera extent (3DGS). */
double gallery_split_above(const struct gallery *g, const struct site *site,
                           const struct schedule *s);
/* The length in metres that no Gaussian should exceed over supported ground. It is five times the
 * larger of two lengths: the spacing of the level's budget if it covered the cell evenly, and two
 * pixels of the level's photographs on the ground. 0: the ground is not known. */
double gallery_size_limit(const struct gallery *g, const struct site *site,
                          const struct schedule *s);

#endif
