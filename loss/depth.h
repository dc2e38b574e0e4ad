/* The loss on inverse depth.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOSS_DEPTH_H
#define LOSS_DEPTH_H

#include <stdbool.h>
#include <stddef.h>

#include "core/camera.h"
#include "core/gauss.h"
#include "render/render.h"
#include "render/render_ref.h"

#define DEPTH_HARD                                                                                 \
    0.9899 /* opacity of every Gaussian in the hard pass: just below the cut of alpha */

struct depth_input {
    const struct camera *cam;
    struct render_options options; /* of the colours; degree and background are not used */
    const float *target;           /* [h][w]: inverse depth times unit_m; below 0 = unknown */
    double unit_m;  /* 1 / median inverse depth: the loss is without unit, at any scale */
    size_t n_known; /* pixels over which the mean is taken */
    double weight;
    bool hard; /* every Gaussian with opacity o + stop_gradient(DEPTH_HARD - o) */
};
struct depth; /* compiled kernels, and a shadow of the model */
/* Build the kernels. depth_close it, after an error there is nothing. ERR_DEVICE, ERR_MEM. */
enum err_code depth_open(struct dev *dev, struct depth **out, struct err *e) ERR_USE;
void depth_close(struct depth **d);
/* Enqueue: L = weight / n_known sum |D - target| over the known pixels, D = sum alpha T unit / z,
 * its gradient added to extra, float [groups][LAYOUT_PLANES_GEOMETRY][16]. Draws a frame of r. Does
 * not wait for the device. ERR_ARG: nothing is known of the photograph; ERR_MEM, ERR_DEVICE. */
enum err_code depth_run(struct depth *d, struct render *r, const struct render_model *m,
                        const struct depth_input *in, cl_mem extra, struct err *e) ERR_USE;
/* Wait, and the loss of the last run. ERR_DEVICE. */
enum err_code depth_read(struct depth *d, double *loss, struct err *e) ERR_USE;
/* In double on the host. depth [h][w] is D; out->sh is that of the shadow and of no use.
 * ERR_MEM. */
enum err_code depth_ref_loss(const struct gauss *g, const struct depth_input *in, double *depth,
                             double *loss, struct err *e) ERR_USE;
enum err_code depth_ref_grads(const struct gauss *g, const struct depth_input *in,
                              const struct render_ref_grads *out, struct err *e) ERR_USE;
#endif
