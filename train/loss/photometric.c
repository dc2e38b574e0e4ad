/* The photometric loss on the device: nothing is read back unless asked for.
 *
 * On CPUs one kernel makes the partial sums and the gradient. On GPUs the forward kernel writes the
 * derivative maps of SSIM and the partial sums of every tile, the backward kernel blurs the maps
 * and adds the L1 part. Owns the compiled kernels and the maps, which grow to the largest picture
 * seen. Kernels and their shape: photometric.cl; formulas: photometric_ref.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/loss/photometric.h"

#include <math.h>
#include <string.h>

#include "core/base.h"
#include "core/layout.h"

extern const char photometric_cl[];

struct photometric {
    struct dev *dev; /* borrowed */
    cl_program program;
    bool wide;                   /* the CPU shape of the kernels */
    cl_kernel both;              /* wide */
    cl_kernel forward, backward; /* not wide */
    cl_mem maps /* not wide */, parts;
    size_t maps_bytes, parts_bytes;
    uint32_t width_px, height_px; /* of the last run; 0 before the first */
    float l1_weight, ssim_weight;
    float *host_parts; /* parts_bytes */
};

enum err_code photometric_open(struct dev *dev, struct photometric **out, struct err *e)
{
    const struct dev_source source = {"train/loss/photometric.cl", photometric_cl};
    struct photometric *l = mem_array(1, sizeof *l);
    enum err_code rc = ERR_OK;
    *out = NULL;
    if (!l)
        return err_set(e, ERR_MEM, "photometric_open: out of memory");
    l->dev = dev;
    l->wide = dev->vector_width > 1;
    rc = dev_build(dev, &source, 1, NULL, &l->program, e);
    if (!rc && l->wide)
        rc = dev_kernel(l->program, "photometric_both", &l->both, e);
    if (!rc && !l->wide)
        rc = dev_kernel(l->program, "photometric_forward", &l->forward, e);
    if (!rc && !l->wide)
        rc = dev_kernel(l->program, "photometric_backward", &l->backward, e);
    if (rc)
        photometric_close(&l);
    *out = l;
    return rc;
}

void photometric_close(struct photometric **l)
{
    if (!l || !*l)
        return;
    struct photometric *s = *l;
    if (s->forward)
        clReleaseKernel(s->forward);
    if (s->backward)
        clReleaseKernel(s->backward);
    if (s->both)
        clReleaseKernel(s->both);
    if (s->program)
        clReleaseProgram(s->program);
    dev_release(&s->maps);
    dev_release(&s->parts);
    mem_free(s->host_parts);
    mem_free(s);
    *l = NULL;
}

static uint32_t photometric_pitch(uint32_t width_px)
{
    return (width_px + LAYOUT_TILE - 1) / LAYOUT_TILE * LAYOUT_TILE + 2 * LAYOUT_LOSS_MARGIN;
}

/* Rows of a band of the CPU shape: bands of a picture are equally high, whatever the device. */
static uint32_t photometric_rows(uint32_t height_px)
{
    uint32_t bands = (height_px + LAYOUT_LOSS_BAND - 1) / LAYOUT_LOSS_BAND;
    return ((height_px + bands - 1) / bands + 1) / 2 * 2;
}

/* Work-groups of a launch: pieces of a strip and a band or tiles, times 3 channels; *local: their
 * size. */
static size_t photometric_groups(const struct photometric *l, uint32_t width_px, uint32_t height_px,
                                 size_t *local)
{
    if (l->wide) {
        size_t rows = photometric_rows(height_px);
        *local = 1;
        return (((size_t)width_px + LAYOUT_LOSS_STRIP - 1) / LAYOUT_LOSS_STRIP) *
               ((height_px + rows - 1) / rows) * 3;
    }
    *local = LAYOUT_TILE_PIXELS;
    return (((size_t)width_px + LAYOUT_TILE - 1) / LAYOUT_TILE) *
           (((size_t)height_px + LAYOUT_TILE - 1) / LAYOUT_TILE) * 3;
}

/* Buffers for this picture. The kernels rely on zeros in the margins of the maps and write none
 * there, so the maps are cleared whenever the picture's shape changes. */
static enum err_code photometric_reserve(struct photometric *l, uint32_t w, uint32_t h,
                                         struct err *e)
{
    size_t local, maps_bytes = (size_t)9 * h * photometric_pitch(w) * sizeof(float);
    size_t parts_bytes = photometric_groups(l, w, h, &local) * LAYOUT_LOSS_PARTS * sizeof(float);
    if (w == l->width_px && h == l->height_px)
        return ERR_OK;
    l->width_px = l->height_px = 0;
    if (parts_bytes > l->parts_bytes) {
        mem_free(l->host_parts);
        l->parts_bytes = 0;
        l->host_parts = mem_array(parts_bytes, 1);
        if (!l->host_parts)
            return err_set(e, ERR_MEM, "photometric_run: out of memory");
    }
    enum err_code rc = dev_reserve(l->dev, parts_bytes, &l->parts, &l->parts_bytes, e);
    if (!rc && !l->wide)
        rc = dev_reserve(l->dev, maps_bytes, &l->maps, &l->maps_bytes, e);
    if (!rc && !l->wide)
        rc = dev_zero(l->dev, l->maps, 0, maps_bytes, e);
    if (rc)
        return err_add(e, "photometric_run: %u x %u px", w, h);
    l->width_px = w;
    l->height_px = h;
    return ERR_OK;
}

enum err_code photometric_run(struct photometric *l, const struct photometric_input *in,
                              cl_mem grad, struct err *e)
{
    uint32_t w = in->width_px, h = in->height_px;
    if (w == 0 || h == 0 || w > 16384 || h > 16384)
        return err_set(e, ERR_ARG,
                       "photometric_run: a picture of %u x %u px: sizes must be 1 to 16384", w, h);
    if (!grad && !in->value_only) /* a kernel would take it for an address */
        return err_set(e, ERR_MEM,
                       "photometric_run: no room on the device for the gradient of %u x %u px", w,
                       h);
    enum err_code rc = photometric_reserve(l, w, h, e);
    if (rc)
        return rc;
    cl_int wi = (cl_int)w, hi = (cl_int)h, pitch = (cl_int)photometric_pitch(w);
    cl_int has_mask = in->mask != NULL, with_ssim = in->ssim_weight != 0;
    cl_mem mask =
        in->mask ? in->mask : in->target; /* never read without has_mask, but must be a buffer */
    double n = 3.0 * w * h;
    cl_float scale_l1 = (float)((double)in->l1_weight / n);
    cl_float scale_ssim = (float)(-(double)in->ssim_weight / n);
    l->l1_weight = in->l1_weight;
    l->ssim_weight = in->ssim_weight;
    cl_int with_grad = !in->value_only, rows = (cl_int)photometric_rows(h), bad = CL_SUCCESS;
    cl_kernel both[2] = {l->wide ? l->both : l->forward, l->backward};
    size_t local, groups = photometric_groups(l, w, h, &local), n_kernels = l->wide ? 1 : 2;
    for (size_t i = 0; i < n_kernels; i++) {
        bad |= dev_arg(both[i], 0, in->color);
        bad |= dev_arg(both[i], 1, in->target);
        bad |= dev_arg(both[i], 2, mask);
        bad |= dev_arg(both[i], 3, has_mask);
        bad |= dev_arg(both[i], 4, wi);
        bad |= dev_arg(both[i], 5, hi);
        bad |= l->wide ? dev_arg(l->both, 6, rows) : dev_arg(both[i], 6, pitch);
        bad |= dev_arg(both[i], 7, with_ssim);
    }
    if (l->wide) {
        bad |= dev_arg(l->both, 8, l->parts);
        bad |= dev_arg(l->both, 9, scale_l1);
        bad |= dev_arg(l->both, 10, scale_ssim);
        bad |= dev_arg(l->both, 11, with_grad);
        /* never written without with_grad, but must be a buffer */
        bad |= in->value_only ? dev_arg(l->both, 12, l->parts) : dev_arg(l->both, 12, grad);
    } else {
        bad |= dev_arg(l->forward, 8, l->maps);
        bad |= dev_arg(l->forward, 9, l->parts);
        bad |= dev_arg(l->backward, 8, l->maps);
        bad |= dev_arg(l->backward, 9, scale_l1);
        bad |= dev_arg(l->backward, 10, scale_ssim);
        if (!in->value_only)
            bad |= dev_arg(l->backward, 11, grad);
    }
    if (bad != CL_SUCCESS)
        return err_set(e, ERR_DEVICE, "photometric_run: arguments: %s", dev_error_name(bad));
    if (l->wide)
        return dev_run(l->dev, l->both, "photometric_both", groups * local, local, e);
    rc = dev_run(l->dev, l->forward, "photometric_forward", groups * local, local, e);
    if (!rc && !in->value_only)
        rc = dev_run(l->dev, l->backward, "photometric_backward", groups * local, local, e);
    return rc;
}

enum err_code photometric_read(struct photometric *l, struct photometric_value *out, struct err *e)
{
    *out = (struct photometric_value){0};
    if (l->width_px == 0)
        return err_set(e, ERR_ARG, "photometric_read: nothing was run yet");
    size_t local, items = photometric_groups(l, l->width_px, l->height_px, &local);
    enum err_code rc =
        dev_read(l->dev, l->parts, 0, items * LAYOUT_LOSS_PARTS * sizeof(float), l->host_parts, e);
    if (rc)
        return rc;
    double sum[3] = {0};
    for (size_t i = 0; i < items; i++)
        for (size_t k = 0; k < 3; k++)
            sum[k] += (double)l->host_parts[i * LAYOUT_LOSS_PARTS + k];
    double n = 3.0 * l->width_px * l->height_px;
    out->l1 = sum[0] / n;
    out->ssim = l->ssim_weight != 0 ? sum[1] / n : 1;
    out->mse = sum[2] / n;
    out->total = (double)l->l1_weight * out->l1 + (double)l->ssim_weight * (1 - out->ssim);
    return ERR_OK;
}
