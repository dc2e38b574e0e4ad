/* The loss on solid surfaces on the device: one launch over the sums along the rays of the
 * renderer's last frame. Owns its kernel and what is handed over.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/loss/solid.h"

#include <assert.h>
#include <string.h>

#include "core/base.h"
#include "core/layout.h"

extern const char vector_cl[], solid_cl[];

enum { SOLID_BLOCK = 1024 }; /* pixels of a work-item, VW 16 */

struct solid {
    struct dev *dev; /* borrowed */
    cl_program program;
    bool wide; /* the shape of the kernel: VW 16 */
    cl_kernel grad;
    cl_mem supported;
    size_t supported_bytes;
};

struct solid_weights { /* as in solid.cl */
    cl_float spread, away, light, light_known, focal, soft_px, reach_px, soft_side, cover, light_t;
};

void solid_close(struct solid **p)
{
    struct solid *s = *p;
    if (!s)
        return;
    if (s->grad)
        clReleaseKernel(s->grad);
    if (s->program)
        clReleaseProgram(s->program);
    dev_release(&s->supported);
    mem_free(s);
    *p = NULL;
}

enum err_code solid_open(struct dev *dev, struct solid **out, struct err *e)
{
    const struct dev_source sources[] = {{"core/device/vector.cl", vector_cl},
                                         {"train/loss/solid.cl", solid_cl}};
    struct solid *s = mem_array(1, sizeof *s);
    *out = NULL;
    if (!s)
        return err_set(e, ERR_MEM, "solid: out of memory");
    s->dev = dev;
    s->wide = dev->vector_width > 1;
    enum err_code rc =
        dev_build(dev, sources, sizeof sources / sizeof *sources, NULL, &s->program, e);
    if (!rc)
        rc = dev_kernel(s->program, "solid_grad", &s->grad, e);
    if (rc)
        solid_close(&s);
    *out = s;
    return rc;
}

enum err_code solid_hand_over(struct solid *s, const struct solid_input *in, struct err *e)
{
    size_t bytes = in->supported ? (size_t)in->width_px * in->height_px : 1;
    enum err_code rc = ERR_OK;
    if (bytes > s->supported_bytes) {
        dev_release(&s->supported);
        rc = dev_buffer(s->dev, bytes, NULL, &s->supported, e);
        s->supported_bytes = rc ? 0 : bytes;
    }
    if (!rc && in->supported)
        rc = dev_write_soon(s->dev, s->supported, 0, bytes, in->supported, e);
    if (rc)
        dev_abandon(s->dev, NULL);
    return rc;
}

enum err_code solid_run(struct solid *s, struct render *r, const struct solid_input *in,
                        struct err *e)
{
    cl_uint pixels = in->width_px * in->height_px;
    double n = (double)pixels;
    const struct solid_weights k = {
        (cl_float)(in->spread / n), (cl_float)(in->spread / n * SOLID_AWAY),
        (cl_float)(in->light / n),  (cl_float)(in->light_known / n),
        (cl_float)in->focal_px,     (cl_float)SOLID_SOFT_PX,
        (cl_float)SOLID_REACH_PX,   (cl_float)SOLID_SOFT_SIDE,
        (cl_float)SOLID_COVER_MIN,  (cl_float)SOLID_LIGHT_T};
    cl_mem sums = render_moments_buffer(r), transmit = render_transmittance_buffer(r),
           grad = render_moments_grad_buffer(r), known = render_known_buffer(r);
    cl_uint has_support = in->supported != NULL, has_known = known != NULL;
    if (!sums || has_known != (in->known != NULL))
        return err_set(e, ERR_ARG, "solid: the last frame has no sums %s",
                       in->known ? "about known depths" : "of moments of depth");
    known = has_known ? known : sums;
    if (!grad)
        return err_set(e, ERR_MEM, "solid: no room on the device for gradients of %u x %u px",
                       in->width_px, in->height_px);
    assert(s->supported);
    cl_int bad = dev_arg(s->grad, 0, sums);
    bad |= dev_arg(s->grad, 1, transmit);
    bad |= dev_arg(s->grad, 2, s->supported);
    bad |= dev_arg(s->grad, 3, has_support);
    bad |= dev_arg(s->grad, 4, known);
    bad |= dev_arg(s->grad, 5, has_known);
    bad |= dev_arg(s->grad, 6, pixels);
    bad |= dev_arg(s->grad, 7, k);
    bad |= dev_arg(s->grad, 8, grad);
    if (bad != CL_SUCCESS)
        return err_set(e, ERR_DEVICE, "solid: arguments: %s", dev_error_name(bad));
    size_t block = s->wide ? SOLID_BLOCK : 1, items = (pixels + block - 1) / block;
    return dev_run(s->dev, s->grad, "solid_grad", items, dev_local(s->dev), e);
}
