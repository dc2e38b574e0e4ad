/* Gaussians are flat: one launch, and the reference.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/loss/flat_loss.h"

#include <math.h>
#include <string.h>

#include "core/base.h"
#include "core/layout.h"

extern const char vector_cl[], lanes_cl[], axes_cl[], flat_loss_cl[];

struct flat_loss {
    struct dev *dev; /* borrowed */
    cl_program program;
    cl_kernel grad;
    cl_mem parts; /* uint8 [ny][nx] of the ground of the first run */
    bool wide;    /* the shape of the kernel: VW 16 */
};

void flat_loss_close(struct flat_loss **p)
{
    struct flat_loss *s = *p;
    if (!s)
        return;
    if (s->grad)
        clReleaseKernel(s->grad);
    if (s->program)
        clReleaseProgram(s->program);
    dev_release(&s->parts);
    mem_free(s);
    *p = NULL;
}

enum err_code flat_loss_open(struct dev *dev, struct flat_loss **out, struct err *e)
{
    const struct dev_source sources[] = {{"core/device/vector.cl", vector_cl},
                                         {"train/loss/lanes.cl", lanes_cl},
                                         {"train/loss/axes.cl", axes_cl},
                                         {"train/loss/flat_loss.cl", flat_loss_cl}};
    struct flat_loss *s = mem_array(1, sizeof *s);
    *out = NULL;
    if (!s)
        return err_set(e, ERR_MEM, "flat_loss: out of memory");
    s->dev = dev;
    s->wide = dev->vector_width == LAYOUT_LANES;
    enum err_code rc =
        dev_build(dev, sources, sizeof sources / sizeof *sources, NULL, &s->program, e);
    if (!rc)
        rc = dev_kernel(s->program, "flat_grad", &s->grad, e);
    if (rc)
        flat_loss_close(&s);
    *out = s;
    return rc;
}

/* Arguments 4 to 9: where the term holds. */
static enum err_code flat_set_ground(struct flat_loss *s, const struct render_model *m,
                                     const struct ground_parts *g, cl_int *bad, struct err *e)
{
    cl_uint nx = g ? (cl_uint)g->nx : 0, ny = g ? (cl_uint)g->ny : 0;
    cl_float per_m = g ? (cl_float)(1.0 / g->cell_m) : 0.0f, corner[2] = {0.0f, 0.0f};
    cl_mem params = m->params; /* not read without a ground */
    enum err_code rc = ERR_OK;
    if (g && !s->parts)
        rc = dev_buffer(s->dev, g->nx * g->ny, g->parts, &s->parts, e);
    for (size_t k = 0; g && k < 2; k++)
        corner[k] = (cl_float)(g->corner_m[k] - m->origin_enu_m[k]);
    *bad |= dev_arg(s->grad, 4, corner[0]);
    *bad |= dev_arg(s->grad, 5, corner[1]);
    *bad |= dev_arg(s->grad, 6, per_m);
    *bad |= dev_arg(s->grad, 7, nx);
    *bad |= dev_arg(s->grad, 8, ny);
    *bad |= dev_arg(s->grad, 9, *(s->parts ? &s->parts : &params));
    return rc;
}

enum err_code flat_loss_run(struct flat_loss *s, const struct render_model *m,
                            const struct flat_loss_input *in, bool fresh, cl_mem extra,
                            struct err *e)
{
    cl_uint is_fresh = fresh, n = m->n, planes = m->planes, groups = m->groups;
    cl_uint listed = m->list != NULL;
    cl_mem params = m->params, list = m->list ? m->list : m->params; /* not read without */
    cl_float flat = n ? (cl_float)(in->weight / n) : 0.0f,
             per_flat = in->weight > 0.0 ? (cl_float)(1.0 / in->flat_m) : 0.0f;
    cl_int bad = CL_SUCCESS;
    enum err_code rc = flat_set_ground(s, m, in->ground, &bad, e);
    if (rc)
        return rc;
    bad |= dev_arg(s->grad, 0, params);
    bad |= dev_arg(s->grad, 1, n);
    bad |= dev_arg(s->grad, 2, planes);
    bad |= dev_arg(s->grad, 3, groups);
    bad |= dev_arg(s->grad, 10, per_flat);
    bad |= dev_arg(s->grad, 11, flat);
    bad |= dev_arg(s->grad, 12, is_fresh);
    bad |= dev_arg(s->grad, 13, extra);
    bad |= dev_arg(s->grad, 14, list);
    bad |= dev_arg(s->grad, 15, listed);
    if (bad != CL_SUCCESS)
        return err_set(e, ERR_DEVICE, "flat_loss: arguments: %s", dev_error_name(bad));
    size_t local = s->wide ? 1 : LAYOUT_SCALE_ITEMS;
    size_t of_group = s->wide ? LAYOUT_PROJECT_GROUPS : LAYOUT_SCALE_ITEMS / LAYOUT_LANES;
    size_t items = (groups + of_group - 1) / of_group * local;
    return dev_run(s->dev, s->grad, "flat_grad", items, local, e);
}

/* ---- the reference ---- */

static int flat_least(const double *scale_log)
{
    int least = 0;
    for (int k = 1; k < 3; k++)
        if (scale_log[k] < scale_log[least])
            least = k; /* the first of equals */
    return least;
}

double flat_loss_ref_run(const struct flat_loss_gauss *g, const struct flat_loss_input *in,
                         double *grad)
{
    double flat = 0.0, pull = g->n ? in->weight / (double)g->n : 0.0;
    if (grad)
        memset(grad, 0, 3 * g->n * sizeof *grad);
    for (size_t i = 0; i < g->n; i++) {
        if (in->ground && g->mean &&
            !ground_parts_has(in->ground, g->mean + 3 * i, GROUND_PART_FLAT))
            continue;
        size_t least = 3 * i + (size_t)flat_least(g->scale_log + 3 * i);
        double thick = pow(exp(g->scale_log[least]) / in->flat_m, 2.0);
        flat += log1p(thick);
        if (grad)
            grad[least] = pull * thick / (1.0 + thick);
    }
    return 0.5 * pull * flat;
}
