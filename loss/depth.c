/* The depth loss on the device: one frame of inverse depth, drawn and differentiated by the kernels
 * for colours.
 *
 * A copy of the model has the shapes of the trained Gaussians and, as its only colour, unit / z of
 * their centres. Drawing it gives D = sum alpha T unit / z. The hard pass draws every Gaussian with
 * opacity DEPTH_HARD. A floater then counts fully, and has to move or to fade. The soft pass would
 * let it be as faint as the colours allow. DEPTH_HARD is just below the cut of alpha, so the
 * derivative with respect to opacity is never cut to 0. The method asks for opacity 1 and a
 * derivative that ignores the cut; the picture is the same within 1 / 255.
 *
 * It owns its kernels, the copy (56 bytes a Gaussian) and its gradients (as much). The frame of the
 * colours must be drawn afterwards, because this one replaces it. Equations: docs/training.md.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>

#include "core/base.h"
#include "core/layout.h"
#include "loss/depth.h"

extern const char vector_cl[], lanes_cl[], depth_cl[];

struct depth {
    struct dev *dev; /* borrowed */
    bool wide;       /* the shape of the kernels: VW 16 */
    cl_program program;
    cl_kernel model, loss, add;
    cl_mem shadow, grads, target, pieces;
    size_t shadow_bytes, grads_bytes, target_bytes;
    double per_value; /* weight / n_known of the last run */
};

void depth_close(struct depth **p)
{
    struct depth *d = *p;
    if (!d)
        return;
    cl_kernel kernels[] = {d->model, d->loss, d->add};
    for (size_t i = 0; i < sizeof kernels / sizeof kernels[0]; i++)
        if (kernels[i])
            clReleaseKernel(kernels[i]);
    if (d->program)
        clReleaseProgram(d->program);
    dev_release(&d->shadow);
    dev_release(&d->grads);
    dev_release(&d->target);
    dev_release(&d->pieces);
    mem_free(d);
    *p = NULL;
}

enum err_code depth_open(struct dev *dev, struct depth **out, struct err *e)
{
    const struct dev_source sources[] = {
        {"core/vector.cl", vector_cl}, {"loss/lanes.cl", lanes_cl}, {"loss/depth.cl", depth_cl}};
    struct depth *d = mem_array(1, sizeof *d);
    *out = NULL;
    if (!d)
        return err_set(e, ERR_MEM, "depth: out of memory");
    d->dev = dev;
    d->wide = dev->vector_width > 1;
    enum err_code rc =
        dev_build(dev, sources, sizeof sources / sizeof *sources, NULL, &d->program, e);
    if (!rc)
        rc = dev_kernel(d->program, "depth_model", &d->model, e);
    if (!rc)
        rc = dev_kernel(d->program, "depth_loss", &d->loss, e);
    if (!rc)
        rc = dev_kernel(d->program, "depth_add", &d->add, e);
    if (!rc)
        rc = dev_buffer(dev, LAYOUT_LOSS_PIECES * sizeof(float), NULL, &d->pieces, e);
    if (rc)
        depth_close(&d);
    *out = d;
    return rc;
}

static enum err_code depth_reserve(struct depth *d, const struct render_model *m, size_t pixels,
                                   struct err *e)
{
    size_t n = m->cap > m->n ? m->cap : m->n;
    size_t bytes = layout_floats(n, LAYOUT_DEPTH_PLANES) * sizeof(float);
    enum err_code rc = dev_reserve(d->dev, bytes, &d->shadow, &d->shadow_bytes, e);
    if (!rc)
        rc = dev_reserve(d->dev, bytes, &d->grads, &d->grads_bytes, e);
    if (!rc)
        rc = dev_reserve(d->dev, pixels * sizeof(float), &d->target, &d->target_bytes, e);
    return rc ? err_add(e, "depth of %u Gaussians", m->n) : ERR_OK;
}

/* The third row of world -> camera, the origin of the model taken in in double. */
static cl_float4 depth_row(const struct render_model *m, const struct camera *c)
{
    cl_float4 row;
    double w = c->trans[2];
    for (int k = 0; k < 3; k++) {
        row.s[k] = (cl_float)c->rot[6 + k];
        w += c->rot[6 + k] * m->origin_enu_m[k];
    }
    row.s[3] = (cl_float)w;
    return row;
}

/* A work-item has LAYOUT_PROJECT_GROUPS groups (VW 16) or a Gaussian (VW 1). */
static enum err_code depth_over_all(struct depth *d, cl_kernel k, const char *name, uint32_t groups,
                                    struct err *e)
{
    return d->wide ? dev_run(d->dev, k, name,
                             (groups + LAYOUT_PROJECT_GROUPS - 1) / LAYOUT_PROJECT_GROUPS, 1, e)
                   : dev_run(d->dev, k, name, (size_t)groups * LAYOUT_LANES, dev_local(d->dev), e);
}

static enum err_code depth_draw(struct depth *d, struct render *r, const struct render_model *m,
                                const struct depth_input *in, struct render_model *shadow,
                                struct err *e)
{
    cl_uint planes = m->planes, groups = m->groups, hard = in->hard;
    cl_float unit = (cl_float)in->unit_m, logit = (cl_float)log(DEPTH_HARD / (1.0 - DEPTH_HARD));
    cl_float4 row = depth_row(m, in->cam);
    cl_int bad = dev_arg(d->model, 0, m->params);
    bad |= dev_arg(d->model, 1, planes);
    bad |= dev_arg(d->model, 2, groups);
    bad |= dev_arg(d->model, 3, row);
    bad |= dev_arg(d->model, 4, unit);
    bad |= dev_arg(d->model, 5, hard);
    bad |= dev_arg(d->model, 6, logit);
    bad |= dev_arg(d->model, 7, d->shadow);
    if (bad != CL_SUCCESS)
        return err_set(e, ERR_DEVICE, "depth_model: arguments: %s", dev_error_name(bad));
    enum err_code rc = depth_over_all(d, d->model, "depth_model", groups, e);
    struct render_options o = in->options;
    o.sh_degree = 0;
    o.appearance_frame = NULL;
    for (int k = 0; k < 3; k++)
        o.background[k] = 0.0f; /* infinitely far */
    *shadow = (struct render_model){.params = d->shadow,
                                    .filter = m->filter,
                                    .n = m->n,
                                    .cap = m->groups * LAYOUT_LANES,
                                    .groups = m->groups,
                                    .planes = LAYOUT_DEPTH_PLANES};
    for (int k = 0; k < 3; k++)
        shadow->origin_enu_m[k] = m->origin_enu_m[k];
    return rc ? rc : render_forward(r, shadow, in->cam, &o, NULL, NULL, e);
}

static enum err_code depth_compare(struct depth *d, struct render *r, const struct depth_input *in,
                                   struct err *e)
{
    cl_uint pixels = in->cam->width_px * in->cam->height_px;
    cl_float per_pixel = (cl_float)(in->weight / (double)in->n_known);
    cl_mem color = render_color_buffer(r), grad = render_color_grad_buffer(r);
    if (!grad)
        return err_set(e, ERR_MEM, "depth: no room on the device for the gradient of %u pixels",
                       pixels);
    enum err_code rc = dev_write(d->dev, d->target, 0, pixels * sizeof(float), in->target, e);
    cl_int bad = dev_arg(d->loss, 0, color);
    bad |= dev_arg(d->loss, 1, d->target);
    bad |= dev_arg(d->loss, 2, pixels);
    bad |= dev_arg(d->loss, 3, per_pixel);
    bad |= dev_arg(d->loss, 4, grad);
    bad |= dev_arg(d->loss, 5, d->pieces);
    if (!rc && bad != CL_SUCCESS)
        rc = err_set(e, ERR_DEVICE, "depth_loss: arguments: %s", dev_error_name(bad));
    d->per_value = in->weight / (double)in->n_known;
    return rc ? rc : dev_run(d->dev, d->loss, "depth_loss", LAYOUT_LOSS_PIECES, 1, e);
}

static enum err_code depth_gather(struct depth *d, const struct render_model *m,
                                  const struct depth_input *in, cl_mem extra, struct err *e)
{
    cl_uint planes = m->planes, groups = m->groups, hard = in->hard;
    cl_float unit_c0 = (cl_float)(in->unit_m / GAUSS_SH_C0),
             per_hard = (cl_float)(1.0 / (DEPTH_HARD * (1.0 - DEPTH_HARD)));
    cl_float4 row = depth_row(m, in->cam);
    cl_int bad = dev_arg(d->add, 0, m->params);
    bad |= dev_arg(d->add, 1, planes);
    bad |= dev_arg(d->add, 2, groups);
    bad |= dev_arg(d->add, 3, row);
    bad |= dev_arg(d->add, 4, unit_c0);
    bad |= dev_arg(d->add, 5, hard);
    bad |= dev_arg(d->add, 6, per_hard);
    bad |= dev_arg(d->add, 7, d->grads);
    bad |= dev_arg(d->add, 8, extra);
    if (bad != CL_SUCCESS)
        return err_set(e, ERR_DEVICE, "depth_add: arguments: %s", dev_error_name(bad));
    return depth_over_all(d, d->add, "depth_add", groups, e);
}

enum err_code depth_run(struct depth *d, struct render *r, const struct render_model *m,
                        const struct depth_input *in, cl_mem extra, struct err *e)
{
    struct render_model shadow;
    size_t pixels = (size_t)in->cam->width_px * in->cam->height_px;
    if (!in->n_known || !(in->unit_m > 0.0))
        return err_set(e, ERR_ARG, "depth: nothing is known of this photograph's depth");
    enum err_code rc = depth_reserve(d, m, pixels, e);
    if (!rc)
        rc = depth_draw(d, r, m, in, &shadow, e);
    if (!rc)
        rc = depth_compare(d, r, in, e);
    if (!rc)
        rc = render_backward(r, &shadow, d->grads, e);
    return rc ? rc : depth_gather(d, m, in, extra, e);
}

enum err_code depth_read(struct depth *d, double *loss, struct err *e)
{
    float pieces[LAYOUT_LOSS_PIECES];
    enum err_code rc = dev_read(d->dev, d->pieces, 0, sizeof pieces, pieces, e);
    *loss = 0.0;
    for (size_t i = 0; !rc && i < LAYOUT_LOSS_PIECES; i++)
        *loss += (double)pieces[i] * d->per_value;
    return rc;
}
