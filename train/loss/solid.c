/* The loss on solid surfaces on the device: two launches over the moments of the renderer's last
 * frame. Owns its kernels, the map of inverse depths and the sums of rows.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/loss/solid.h"

#include <assert.h>
#include <string.h>

#include "core/base.h"
#include "core/layout.h"

extern const char vector_cl[], lanes_cl[], solid_cl[];

enum {
    SOLID_MARGIN = 2 * SOLID_STRIDE_MAX,
    SOLID_SUMS = 8,
    SOLID_ROW_ITEMS = 64 /* VW 1: work-items of a row */
};

struct solid {
    struct dev *dev; /* borrowed */
    cl_program program;
    bool wide; /* the shape of the kernels: VW 16 */
    cl_kernel inverse, grad;
    cl_mem map, supported, known, sums;
    size_t map_bytes, known_bytes, pixels; /* pixels: of supported */
    uint32_t width_px, height_px;          /* map is 0 in the margins of this size */
    float *rows;                           /* [height_px][SOLID_SUMS] */
};

struct solid_weights { /* as in solid.cl */
    cl_float spread, bend, light, focal, soft_px, spread_px, bend_px, cover, prior, prior_px,
        known_zeta, light_known, unknown, light_t;
    cl_uint stride;
};

void solid_close(struct solid **p)
{
    struct solid *s = *p;
    if (!s)
        return;
    if (s->inverse)
        clReleaseKernel(s->inverse);
    if (s->grad)
        clReleaseKernel(s->grad);
    if (s->program)
        clReleaseProgram(s->program);
    dev_release(&s->map);
    dev_release(&s->supported);
    dev_release(&s->known);
    dev_release(&s->sums);
    mem_free(s->rows);
    mem_free(s);
    *p = NULL;
}

enum err_code solid_open(struct dev *dev, struct solid **out, struct err *e)
{
    const struct dev_source sources[] = {{"core/device/vector.cl", vector_cl},
                                         {"train/loss/lanes.cl", lanes_cl},
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
        rc = dev_kernel(s->program, "solid_inverse", &s->inverse, e);
    if (!rc)
        rc = dev_kernel(s->program, "solid_grad", &s->grad, e);
    if (rc)
        solid_close(&s);
    *out = s;
    return rc;
}

static cl_uint solid_pitch(uint32_t width_px)
{
    return (width_px + LAYOUT_LANES - 1) / LAYOUT_LANES * LAYOUT_LANES + 2 * SOLID_MARGIN;
}

/* Buffers of this size; margins are cleared when it changes. */
static enum err_code solid_reserve(struct solid *s, uint32_t w, uint32_t h, struct err *e)
{
    enum err_code rc = ERR_OK;
    size_t bytes = ((size_t)h + 2 * SOLID_MARGIN) * solid_pitch(w) * sizeof(float);
    size_t sums = (size_t)h * SOLID_SUMS * sizeof(float);
    if (w == s->width_px && h == s->height_px)
        return ERR_OK;
    s->width_px = s->height_px = 0;
    if (bytes > s->map_bytes) {
        dev_release(&s->map);
        s->map_bytes = 0;
        rc = dev_buffer(s->dev, bytes, NULL, &s->map, e);
        s->map_bytes = rc ? 0 : bytes;
    }
    dev_release(&s->sums);
    mem_free(s->rows);
    s->rows = mem_array(sums, 1);
    if (!rc && !s->rows)
        rc = err_set(e, ERR_MEM, "solid: out of memory");
    if (!rc)
        rc = dev_buffer(s->dev, sums, NULL, &s->sums, e);
    if (!rc)
        rc = dev_zero(s->dev, s->map, 0, bytes, e);
    if (rc)
        return err_add(e, "solid: %u x %u px", w, h);
    s->width_px = w;
    s->height_px = h;
    return ERR_OK;
}

static enum err_code solid_support(struct solid *s, const struct solid_input *in, struct err *e)
{
    size_t pixels = (size_t)in->width_px * in->height_px;
    enum err_code rc = ERR_OK;
    if (pixels > s->pixels) {
        dev_release(&s->supported);
        s->pixels = 0;
        rc = dev_buffer(s->dev, pixels, NULL, &s->supported, e);
        s->pixels = rc ? 0 : pixels;
    }
    return !rc && in->supported ? dev_write_soon(s->dev, s->supported, 0, pixels, in->supported, e)
                                : rc;
}

static enum err_code solid_known(struct solid *s, const struct solid_input *in, struct err *e)
{
    size_t bytes = in->known ? (size_t)in->width_px * in->height_px * sizeof(float) : sizeof(float);
    enum err_code rc = ERR_OK;
    if (bytes > s->known_bytes) {
        dev_release(&s->known);
        s->known_bytes = 0;
        rc = dev_buffer(s->dev, bytes, NULL, &s->known, e);
        s->known_bytes = rc ? 0 : bytes;
    }
    return !rc && in->known ? dev_write_soon(s->dev, s->known, 0, bytes, in->known, e) : rc;
}

static enum err_code solid_launch(struct solid *s, struct render *r, const struct solid_input *in,
                                  cl_mem grad, struct err *e)
{
    double n = (double)in->width_px * in->height_px;
    const struct solid_weights k = {
        (cl_float)(in->spread / n), (cl_float)(in->bend / n),  (cl_float)(in->light / n),
        (cl_float)in->focal_px,     (cl_float)SOLID_SOFT_PX,   (cl_float)SOLID_SPREAD_PX,
        (cl_float)SOLID_BEND_PX,    (cl_float)SOLID_COVER_MIN, (cl_float)(in->prior / n),
        (cl_float)SOLID_PRIOR_PX,   (cl_float)in->known_zeta,  (cl_float)(in->light_known / n),
        (cl_float)in->unknown,      (cl_float)SOLID_LIGHT_T,   in->stride};
    cl_mem moments = render_moments_buffer(r), transmit = render_transmittance_buffer(r);
    cl_uint w = in->width_px, h = in->height_px, pitch = solid_pitch(w),
            has_support = in->supported != NULL, has_known = in->known != NULL;
    cl_float cover = (cl_float)SOLID_BEND_COVER;
    cl_int bad = dev_arg(s->inverse, 0, moments);
    bad |= dev_arg(s->inverse, 1, transmit);
    bad |= dev_arg(s->inverse, 2, s->known);
    bad |= dev_arg(s->inverse, 3, has_known);
    bad |= dev_arg(s->inverse, 4, w);
    bad |= dev_arg(s->inverse, 5, h);
    bad |= dev_arg(s->inverse, 6, pitch);
    bad |= dev_arg(s->inverse, 7, cover);
    bad |= dev_arg(s->inverse, 8, s->map);
    bad |= dev_arg(s->grad, 0, moments);
    bad |= dev_arg(s->grad, 1, transmit);
    bad |= dev_arg(s->grad, 2, s->map);
    bad |= dev_arg(s->grad, 3, s->supported);
    bad |= dev_arg(s->grad, 4, has_support);
    bad |= dev_arg(s->grad, 5, s->known);
    bad |= dev_arg(s->grad, 6, has_known);
    bad |= dev_arg(s->grad, 7, w);
    bad |= dev_arg(s->grad, 8, h);
    bad |= dev_arg(s->grad, 9, pitch);
    bad |= dev_arg(s->grad, 10, k);
    bad |= dev_arg(s->grad, 11, grad);
    bad |= dev_arg(s->grad, 12, s->sums);
    if (bad != CL_SUCCESS)
        return err_set(e, ERR_DEVICE, "solid: arguments: %s", dev_error_name(bad));
    size_t local = s->wide ? 1 : SOLID_ROW_ITEMS;
    enum err_code rc = dev_run(s->dev, s->inverse, "solid_inverse", h * local, local, e);
    return rc ? rc : dev_run(s->dev, s->grad, "solid_grad", h * local, local, e);
}

enum err_code solid_hand_over(struct solid *s, const struct solid_input *in, struct err *e)
{
    enum err_code rc = solid_support(s, in, e);
    if (!rc)
        rc = solid_known(s, in, e);
    if (rc)
        dev_abandon(s->dev, NULL);
    return rc;
}

enum err_code solid_run(struct solid *s, struct render *r, const struct solid_input *in,
                        struct err *e)
{
    cl_mem grad = render_moments_grad_buffer(r);
    if (!render_moments_buffer(r))
        return err_set(e, ERR_ARG, "solid: the last frame has no moments of depth");
    if (in->stride < 1 || in->stride > SOLID_STRIDE_MAX)
        return err_set(e, ERR_ARG, "solid: a stride of %u px: 1 to %d", in->stride,
                       SOLID_STRIDE_MAX);
    if (!grad)
        return err_set(e, ERR_MEM, "solid: no room on the device for gradients of %u x %u px",
                       in->width_px, in->height_px);
    assert(s->supported && s->known);
    enum err_code rc = solid_reserve(s, in->width_px, in->height_px, e);
    return rc ? rc : solid_launch(s, r, in, grad, e);
}

enum err_code solid_read(struct solid *s, struct solid_value *out, struct err *e)
{
    double sum[SOLID_SUMS] = {0}, n = (double)s->width_px * s->height_px;
    *out = (struct solid_value){0};
    if (!s->height_px)
        return ERR_OK;
    enum err_code rc =
        dev_read(s->dev, s->sums, 0, s->height_px * SOLID_SUMS * sizeof *s->rows, s->rows, e);
    for (size_t i = 0; !rc && i < (size_t)s->height_px * SOLID_SUMS; i++)
        sum[i % SOLID_SUMS] += (double)s->rows[i];
    *out = (struct solid_value){.spread = sum[0] / n,
                                .bend = sum[1] / n,
                                .light = sum[2] / n,
                                .prior = sum[3] / n,
                                .light_known = sum[4] / n};
    return rc;
}
