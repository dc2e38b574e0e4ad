/* Inside of train/: the training photographs of the level in work. Any of them can be drawn from
 * the model and compared with its drawing. The members are set by level.c and used by gallery.c;
 * other modules read the options, the engine and the number of photographs.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_GALLERY_H
#define TRAIN_GALLERY_H

#include "render/render.h"
#include "train/config.h"
#include "train/fixed.h"

struct appearance_train;
struct model;
struct photo;
struct photo_loader;
struct scene;
struct schedule;
struct stage;

struct gallery { /* gallery_close */
    /* -- fixed for the run; borrowed */
    const struct train_config *cfg;
    struct engine engine;
    const struct scene *scene;
    const uint32_t *images; /* [n_images] training photographs, indices into the scene's images */
    size_t n_images;
    struct appearance_train *appearance;
    double near_m; /* near plane of every frame */
    /* -- of gallery.c */
    struct photo_loader *photos; /* opened by gallery_open */
    cl_mem target;               /* uint8 [h][w][3] of the photograph that was compared last */
    size_t target_bytes;
    cl_mem mask; /* uint8 [h][w] of it, when it has one */
    size_t mask_bytes;
};
/* Open the photographs at the size of a level; those of the level before are closed. ERR_MEM,
 * ERR_LIMIT. */
enum err_code gallery_open(struct gallery *g, const struct schedule *s, struct err *e) ERR_USE;
void gallery_close(struct gallery *g);

/* How frames are drawn without appearance. */
struct render_options gallery_options(const struct gallery *g, const struct stage *at);
/* The same in the appearance of a training photograph (an index into the scene's images), once the
 * warm-up is over. Its constants are borrowed until the next call. */
struct render_options gallery_photo_options(const struct gallery *g, const struct stage *at,
                                            uint32_t image);

/* Upload a photograph and run the loss of the last frame against it: its gradient is then in the
 * renderer's, and photometric_read waits for the value. ERR_MEM, ERR_DEVICE. */
enum err_code gallery_loss(struct gallery *g, const struct photo *p, struct err *e) ERR_USE;
/* The same without gradients: for photometric_read alone. ERR_MEM, ERR_DEVICE. */
enum err_code gallery_value(struct gallery *g, const struct photo *p, struct err *e) ERR_USE;

/* Cameras of the training photographs, [n_images], mem_free them; NULL: out
 * of memory. _full: at the size of the scene's photographs; else at the size of a level. */
struct camera *gallery_cameras_full(const struct gallery *g);
struct camera *gallery_cameras(const struct gallery *g, const struct schedule *s);
/* With Mip-Splatting: the model's 3-D filter for the photographs of the level in work, computed if
 * the Gaussians have changed since. Without Mip-Splatting: nothing. ERR_MEM, ERR_DEVICE. */
enum err_code gallery_filter(const struct gallery *g, const struct stage *at, struct model *m,
                             struct err *e) ERR_USE;
/* Over supported ground no Gaussian should be longer than this, metres: cfg->size_limit times the
 * spacing that the level's budget has when it covers the cell, or times two pixels of the level's
 * photographs on the ground where that is more. 0: no limit, or the ground is not known. */
double gallery_size_limit(const struct gallery *g, const struct site *site,
                          const struct schedule *s);

#endif
