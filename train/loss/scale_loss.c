/* The scale regularizer: Gaussians longer than a building, and needles, shrink.
 *
 * A step has two launches: counts over fixed pieces, then gradients. It owns its kernels and a
 * small buffer. A flat disc (two long axes, one short) is no needle, because the ratio is that of
 * the longest axis to the middle one. Gaussians become such discs. The division by n + 1 makes the
 * pull on one Gaussian independent of their number. Source: REUrbanGS (2025).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "core/base.h"
#include "core/layout.h"
#include "train/loss/scale_loss.h"

extern const char vector_cl[], lanes_cl[], axes_cl[], scale_loss_cl[];

#define SCALE_RATIO_EPS 1e-8

struct scale_loss {
    struct dev *dev; /* borrowed */
    cl_program program;
    cl_kernel count, grad;
    cl_mem pieces;
    cl_mem parts;  /* uint8 [ny][nx] of the ground of the first run */
    double weight; /* of the last run */
    bool wide;     /* the shape of the kernels: VW 16 */
};

void scale_loss_close(struct scale_loss **p)
{
    struct scale_loss *s = *p;
    if (!s)
        return;
    cl_kernel kernels[] = {s->count, s->grad};
    for (size_t i = 0; i < sizeof kernels / sizeof kernels[0]; i++)
        if (kernels[i])
            clReleaseKernel(kernels[i]);
    if (s->program)
        clReleaseProgram(s->program);
    dev_release(&s->pieces);
    dev_release(&s->parts);
    mem_free(s);
    *p = NULL;
}

enum err_code scale_loss_open(struct dev *dev, struct scale_loss **out, struct err *e)
{
    const struct dev_source sources[] = {{"core/device/vector.cl", vector_cl},
                                         {"train/loss/lanes.cl", lanes_cl},
                                         {"train/loss/axes.cl", axes_cl},
                                         {"train/loss/scale_loss.cl", scale_loss_cl}};
    struct scale_loss *s = mem_array(1, sizeof *s);
    *out = NULL;
    if (!s)
        return err_set(e, ERR_MEM, "scale_loss: out of memory");
    s->dev = dev;
    s->wide = dev->vector_width == LAYOUT_LANES;
    enum err_code rc =
        dev_build(dev, sources, sizeof sources / sizeof *sources, NULL, &s->program, e);
    if (!rc)
        rc = dev_kernel(s->program, "scale_count", &s->count, e);
    if (!rc)
        rc = dev_kernel(s->program, "scale_grad", &s->grad, e);
    if (!rc)
        rc = dev_buffer(dev, LAYOUT_LOSS_PIECES * sizeof(struct layout_scale_piece), NULL,
                        &s->pieces, e);
    if (rc)
        scale_loss_close(&s);
    *out = s;
    return rc;
}

/* Arguments 6 to 12 of both kernels: the smaller limit and where it holds. */
static enum err_code scale_set_ground(struct scale_loss *s, const struct render_model *m,
                                      const struct scale_loss_input *in, cl_int *bad, struct err *e)
{
    const struct ground_parts *g = in->ground;
    cl_kernel both[2] = {s->count, s->grad};
    cl_uint nx = g ? (cl_uint)g->nx : 0, ny = g ? (cl_uint)g->ny : 0;
    cl_float near_m = g ? (cl_float)in->s_near_m : INFINITY,
             per_m = g ? (cl_float)(1.0 / g->cell_m) : 0.0f, corner[2] = {0.0f, 0.0f};
    enum err_code rc = ERR_OK;
    if (g && !s->parts)
        rc = dev_buffer(s->dev, g->nx * g->ny, g->parts, &s->parts, e);
    if (rc)
        return rc;
    for (size_t k = 0; g && k < 2; k++)
        corner[k] = (cl_float)(g->corner_m[k] - m->origin_enu_m[k]);
    for (size_t i = 0; i < 2; i++) {
        *bad |= dev_arg(both[i], 6, near_m);
        *bad |= dev_arg(both[i], 7, corner[0]);
        *bad |= dev_arg(both[i], 8, corner[1]);
        *bad |= dev_arg(both[i], 9, per_m);
        *bad |= dev_arg(both[i], 10, nx);
        *bad |= dev_arg(both[i], 11, ny);
        *bad |= dev_arg(both[i], 12, *(s->parts ? &s->parts : &s->pieces));
    }
    return ERR_OK;
}

enum err_code scale_loss_run(struct scale_loss *s, const struct render_model *m,
                             const struct scale_loss_input *in, bool fresh, cl_mem extra,
                             struct err *e)
{
    cl_uint is_fresh = fresh, n = m->n, planes = m->planes, groups = m->groups;
    cl_uint listed = m->list != NULL;
    cl_mem list = m->list ? m->list : m->params; /* not read without */
    cl_float s_max = (cl_float)in->s_max_m, r_max = (cl_float)in->r_max,
             weight = (cl_float)in->weight;
    cl_int bad = CL_SUCCESS;
    cl_kernel both[2] = {s->count, s->grad};
    for (size_t i = 0; i < 2; i++) {
        bad |= dev_arg(both[i], 0, m->params);
        bad |= dev_arg(both[i], 1, n);
        bad |= dev_arg(both[i], 2, planes);
        bad |= dev_arg(both[i], 3, groups);
        bad |= dev_arg(both[i], 4, s_max);
        bad |= dev_arg(both[i], 5, r_max);
    }
    enum err_code rc = scale_set_ground(s, m, in, &bad, e);
    if (rc)
        return rc;
    bad |= dev_arg(s->count, 13, s->pieces);
    bad |= dev_arg(s->count, 14, list);
    bad |= dev_arg(s->count, 15, listed);
    bad |= dev_arg(s->grad, 13, weight);
    bad |= dev_arg(s->grad, 14, s->pieces);
    bad |= dev_arg(s->grad, 15, is_fresh);
    bad |= dev_arg(s->grad, 16, extra);
    bad |= dev_arg(s->grad, 17, list);
    bad |= dev_arg(s->grad, 18, listed);
    if (bad != CL_SUCCESS)
        return err_set(e, ERR_DEVICE, "scale_loss: arguments: %s", dev_error_name(bad));
    s->weight = in->weight;
    size_t local = s->wide ? 1 : LAYOUT_SCALE_ITEMS;
    size_t of_group = s->wide ? LAYOUT_PROJECT_GROUPS : LAYOUT_SCALE_ITEMS / LAYOUT_LANES;
    size_t items = (groups + of_group - 1) / of_group * local;
    rc = dev_run(s->dev, s->count, "scale_count", LAYOUT_LOSS_PIECES * local, local, e);
    return rc ? rc : dev_run(s->dev, s->grad, "scale_grad", items, local, e);
}

enum err_code scale_loss_read(struct scale_loss *s, struct scale_loss_value *out, struct err *e)
{
    struct layout_scale_piece pieces[LAYOUT_LOSS_PIECES];
    struct {
        double n, m, size, ratio;
    } t = {0};
    enum err_code rc = dev_read(s->dev, s->pieces, 0, sizeof pieces, pieces, e);
    if (rc)
        return rc;
    for (size_t i = 0; i < LAYOUT_LOSS_PIECES; i++) {
        t.n += pieces[i].n;
        t.m += pieces[i].m;
        t.size += (double)pieces[i].size;
        t.ratio += (double)pieces[i].ratio;
    }
    *out = (struct scale_loss_value){.total =
                                         s->weight * (t.size / (t.n + 1.0) + t.ratio / (t.m + 1.0)),
                                     .n = (uint32_t)t.n,
                                     .m = (uint32_t)t.m};
    return ERR_OK;
}

/* ---- the reference ---- */

struct scale_axes {
    double s[3], ratio;
    int largest, middle;
};

static struct scale_axes scale_axes_of(const double *scale_log)
{
    struct scale_axes a;
    int least = 0;
    a.largest = 0;
    for (int k = 0; k < 3; k++) {
        a.s[k] = exp(scale_log[k]);
        if (a.s[k] > a.s[a.largest])
            a.largest = k;
    }
    least = a.largest == 2 ? 1 : 2; /* the last of equals, so that the middle one is the first */
    for (int k = 2; k >= 0; k--)
        if (k != a.largest && a.s[k] < a.s[least])
            least = k;
    a.middle = 3 - a.largest - least;
    a.ratio = a.s[a.largest] / (a.s[a.middle] + SCALE_RATIO_EPS);
    return a;
}

/* The limit at a place. */
static double scale_limit(const struct scale_loss_input *in, const double *mean)
{
    return in->ground && mean && ground_parts_has(in->ground, mean, GROUND_PART_LIMITED)
               ? fmin(in->s_near_m, in->s_max_m)
               : in->s_max_m;
}

struct scale_loss_value scale_loss_ref_run(const struct scale_loss_gauss *g,
                                           const struct scale_loss_input *in, double *grad)
{
    struct scale_loss_value v = {0};
    double size = 0.0, ratio = 0.0;
    for (size_t i = 0; i < g->n; i++) {
        struct scale_axes a = scale_axes_of(g->scale_log + 3 * i);
        double s_max = scale_limit(in, g->mean ? g->mean + 3 * i : NULL);
        for (int k = 0; k < 3; k++)
            if (a.s[k] > s_max) {
                v.n++;
                size += a.s[k];
            }
        if (a.ratio > in->r_max) {
            v.m++;
            ratio += a.ratio;
        }
    }
    v.total = in->weight * (size / (v.n + 1.0) + ratio / (v.m + 1.0));
    for (size_t i = 0; grad && i < g->n; i++) {
        struct scale_axes a = scale_axes_of(g->scale_log + 3 * i);
        double s_max = scale_limit(in, g->mean ? g->mean + 3 * i : NULL), *out = grad + 3 * i;
        double per_m = in->weight / (v.m + 1.0), q = a.s[a.middle] + SCALE_RATIO_EPS;
        for (int k = 0; k < 3; k++)
            out[k] = a.s[k] > s_max ? in->weight / (v.n + 1.0) * a.s[k] : 0.0;
        if (!(a.ratio > in->r_max))
            continue;
        out[a.largest] += per_m * a.ratio;
        out[a.middle] -= per_m * a.ratio * a.s[a.middle] / q;
    }
    return v;
}
