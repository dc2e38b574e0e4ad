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
    0.9899 /* opacity of every Gaussian in the hard pass, just below the cut of alpha */

struct depth_input {
    const struct camera *cam;
    /* options of the colours; degree and background are not used */
    struct render_options options;
    const float *target; /* [h][w] inverse depth times unit_m; below 0 = unknown */
    double unit_m;       /* 1 / median inverse depth: makes the loss independent of scale */
    size_t n_known;      /* number of known pixels, for the mean */
    double weight;
    bool hard; /* each Gaussian has the opacity o + stop_gradient(DEPTH_HARD - o) */
};
struct depth; /* compiled kernels, and a copy of the model to draw depth with */
/* Builds the kernels. Free *out with depth_close; after an error there is nothing to free.
 * ERR_DEVICE, ERR_MEM. */
enum err_code depth_open(struct dev *dev, struct depth **out, struct err *e) ERR_USE;
void depth_close(struct depth **d);
/* Enqueues the loss L = weight / n_known sum |D - target| over the known pixels, with D = sum alpha
 * T unit / z. Its gradient is added to extra, float [groups][LAYOUT_PLANES_GEOMETRY][16]. It draws
 * a frame with r. It does not wait for the device. ERR_ARG: no pixel is known. ERR_MEM, ERR_DEVICE.
 */
enum err_code depth_run(struct depth *d, struct render *r, const struct render_model *m,
                        const struct depth_input *in, cl_mem extra, struct err *e) ERR_USE;
/* Waits, and reads the loss of the last run. ERR_DEVICE. */
enum err_code depth_read(struct depth *d, double *loss, struct err *e) ERR_USE;
/* Reference in double on the host. depth [h][w] is D. out->sh is that of the copy for depth and has
 * no use. ERR_MEM. */
enum err_code depth_ref_loss(const struct gauss *g, const struct depth_input *in, double *depth,
                             double *loss, struct err *e) ERR_USE;
enum err_code depth_ref_grads(const struct gauss *g, const struct depth_input *in,
                              const struct render_ref_grads *out, struct err *e) ERR_USE;
#endif
