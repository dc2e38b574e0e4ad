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
#include "loss/scale_loss.h"

extern const char vector_cl[], lanes_cl[], scale_loss_cl[];

#define SCALE_RATIO_EPS 1e-8

struct scale_loss {
    struct dev *dev; /* borrowed */
    cl_program program;
    cl_kernel count, grad;
    cl_mem pieces;
    cl_mem parts;               /* uint8 [ny][nx] of the ground of the first run */
    double weight, flat, level; /* of the last run; flat: over 2 N, level: over N */
    bool wide;                  /* the shape of the kernels: VW 16 */
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
    const struct dev_source sources[] = {{"core/vector.cl", vector_cl},
                                         {"loss/lanes.cl", lanes_cl},
                                         {"loss/scale_loss.cl", scale_loss_cl}};
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
                                      const struct scale_loss_ground *g, cl_int *bad, struct err *e)
{
    cl_kernel both[2] = {s->count, s->grad};
    cl_uint nx = g ? (cl_uint)g->nx : 0, ny = g ? (cl_uint)g->ny : 0;
    cl_float near_m = g ? (cl_float)g->s_max_m : INFINITY,
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
                             const struct scale_loss_input *in, bool shapes_only, cl_mem extra,
                             struct err *e)
{
    cl_uint only = shapes_only, n = m->n, planes = m->planes, groups = m->groups;
    cl_uint listed = m->list != NULL;
    cl_mem list = m->list ? m->list : m->params; /* not read without */
    cl_float s_max = (cl_float)in->s_max_m, r_max = (cl_float)in->r_max,
             weight = (cl_float)in->weight, flat = n ? (cl_float)(in->flat_weight / n) : 0.0f,
             per_flat = in->flat_weight > 0.0 ? (cl_float)(1.0 / in->flat_m) : 0.0f,
             level = n ? (cl_float)(in->level_weight / n) : 0.0f, none = 0.0f;
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
    /* What presses on the least axis is counted by nothing but the value. */
    bad |= dev_arg(s->count, 13, *(in->value ? &per_flat : &none));
    bad |= dev_arg(s->count, 14, *(in->value ? &level : &none));
    bad |= dev_arg(s->grad, 13, per_flat);
    bad |= dev_arg(s->grad, 14, level);
    enum err_code rc = scale_set_ground(s, m, in->ground, &bad, e);
    if (rc)
        return rc;
    bad |= dev_arg(s->count, 15, s->pieces);
    bad |= dev_arg(s->count, 16, list);
    bad |= dev_arg(s->count, 17, listed);
    bad |= dev_arg(s->grad, 15, weight);
    bad |= dev_arg(s->grad, 16, flat);
    bad |= dev_arg(s->grad, 17, s->pieces);
    bad |= dev_arg(s->grad, 18, only);
    bad |= dev_arg(s->grad, 19, extra);
    bad |= dev_arg(s->grad, 20, list);
    bad |= dev_arg(s->grad, 21, listed);
    if (bad != CL_SUCCESS)
        return err_set(e, ERR_DEVICE, "scale_loss: arguments: %s", dev_error_name(bad));
    s->weight = in->weight;
    s->flat = n ? 0.5 * in->flat_weight / n : 0.0;
    s->level = n ? in->level_weight / n : 0.0;
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
        double n, m, size, ratio, flat, tilt;
    } t = {0};
    enum err_code rc = dev_read(s->dev, s->pieces, 0, sizeof pieces, pieces, e);
    if (rc)
        return rc;
    for (size_t i = 0; i < LAYOUT_LOSS_PIECES; i++) {
        t.n += pieces[i].n;
        t.m += pieces[i].m;
        t.size += (double)pieces[i].size;
        t.ratio += (double)pieces[i].ratio;
        t.flat += (double)pieces[i].flat;
        t.tilt += (double)pieces[i].tilt;
    }
    *out = (struct scale_loss_value){.total = s->weight *
                                                  (t.size / (t.n + 1.0) + t.ratio / (t.m + 1.0)) +
                                              s->flat * t.flat + s->level * t.tilt,
                                     .n = (uint32_t)t.n,
                                     .m = (uint32_t)t.m};
    return ERR_OK;
}

/* ---- the reference ---- */

struct scale_axes {
    double s[3], ratio;
    int largest, middle, least;
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
    a.least = 0;
    for (int k = 1; k < 3; k++)
        if (a.s[k] < a.s[a.least])
            a.least = k; /* the first of equals */
    a.ratio = a.s[a.largest] / (a.s[a.middle] + SCALE_RATIO_EPS);
    return a;
}

/* Whether a place belongs to a part of the ground. */
static bool scale_inside(const struct scale_loss_input *in, const double *mean,
                         enum scale_loss_part part)
{
    const struct scale_loss_ground *g = in->ground;
    if (!g || !mean)
        return part == SCALE_LOSS_FLAT;
    double column = floor((mean[0] - g->corner_m[0]) / g->cell_m),
           row = floor((mean[1] - g->corner_m[1]) / g->cell_m);
    bool known = column >= 0.0 && row >= 0.0 && column < (double)g->nx && row < (double)g->ny;
    return known && g->parts[(size_t)row * g->nx + (size_t)column] & part;
}

/* The limit at a place. */
static double scale_limit(const struct scale_loss_input *in, const double *mean)
{
    return scale_inside(in, mean, SCALE_LOSS_LIMITED) ? fmin(in->ground->s_max_m, in->s_max_m)
                                                      : in->s_max_m;
}

/* The least axis in units of flat_m; 0 where it does not count. */
static double scale_thick(const struct scale_loss_input *in, const double *mean,
                          const struct scale_axes *a)
{
    return in->flat_weight > 0.0 && scale_inside(in, mean, SCALE_LOSS_FLAT)
               ? a->s[a->least] / in->flat_m
               : 0.0;
}

/* n_z of the least axis and its derivatives on the rotation; 0 where Gaussians need not lie. */
static double scale_upright(const struct scale_loss_input *in, const double *mean, const double *q,
                            const struct scale_axes *a, double d[4])
{
    memset(d, 0, 4 * sizeof *d);
    if (!(in->level_weight > 0.0) || !scale_inside(in, mean, SCALE_LOSS_LEVEL))
        return 0.0;
    double w = q[0], x = q[1], y = q[2], z = q[3], per = 1.0 / (w * w + x * x + y * y + z * z);
    const double up[3] = {2.0 * (x * z - w * y), 2.0 * (y * z + w * x),
                          w * w - x * x - y * y + z * z};
    const double of[3][4] = {{-2.0 * y, 2.0 * z, -2.0 * w, 2.0 * x},
                             {2.0 * x, 2.0 * w, 2.0 * z, 2.0 * y},
                             {2.0 * w, -2.0 * x, -2.0 * y, 2.0 * z}};
    double n_z = up[a->least] * per;
    for (int k = 0; k < 4; k++)
        d[k] = (of[a->least][k] - 2.0 * n_z * q[k]) * per;
    return n_z;
}

struct scale_loss_value scale_loss_ref_run(const struct scale_loss_gauss *g,
                                           const struct scale_loss_input *in, double *grad)
{
    struct scale_loss_value v = {0};
    double size = 0.0, ratio = 0.0, flat = 0.0, tilt = 0.0, d[4];
    double pull = g->n ? in->flat_weight / (double)g->n : 0.0,
           level = g->n ? in->level_weight / (double)g->n : 0.0;
    for (size_t i = 0; i < g->n; i++) {
        struct scale_axes a = scale_axes_of(g->scale_log + 3 * i);
        const double *mean = g->mean ? g->mean + 3 * i : NULL;
        double s_max = scale_limit(in, mean);
        for (int k = 0; k < 3; k++)
            if (a.s[k] > s_max) {
                v.n++;
                size += a.s[k];
            }
        flat += log1p(pow(scale_thick(in, mean, &a), 2.0));
        if (in->level_weight > 0.0 && scale_inside(in, mean, SCALE_LOSS_LEVEL))
            tilt += 1.0 - pow(scale_upright(in, mean, g->quat + 4 * i, &a, d), 2.0);
        if (a.ratio > in->r_max) {
            v.m++;
            ratio += a.ratio;
        }
    }
    v.total =
        in->weight * (size / (v.n + 1.0) + ratio / (v.m + 1.0)) + 0.5 * pull * flat + level * tilt;
    for (size_t i = 0; grad && i < g->n; i++) {
        struct scale_axes a = scale_axes_of(g->scale_log + 3 * i);
        const double *mean = g->mean ? g->mean + 3 * i : NULL;
        double s_max = scale_limit(in, mean), *out = grad + 7 * i;
        double per_m = in->weight / (v.m + 1.0), q = a.s[a.middle] + SCALE_RATIO_EPS;
        for (int k = 0; k < 3; k++)
            out[k] = a.s[k] > s_max ? in->weight / (v.n + 1.0) * a.s[k] : 0.0;
        double thick = scale_thick(in, mean, &a);
        out[a.least] += pull * thick * thick / (1.0 + thick * thick);
        double up = scale_upright(in, mean, g->quat ? g->quat + 4 * i : NULL, &a, d);
        for (int k = 0; k < 4; k++)
            out[3 + k] = -2.0 * level * up * d[k];
        if (!(a.ratio > in->r_max))
            continue;
        out[a.largest] += per_m * a.ratio;
        out[a.middle] -= per_m * a.ratio * a.s[a.middle] / q;
    }
    return v;
}
