/* Appearance on the device: the programs of the network, what a frame with it keeps, its gradients.
 *
 * Kernels are compiled for the lengths of the model in use, because loops of constant length keep
 * embeddings in registers. Each pair of lengths has a program, which is kept until render_close.
 * The plain renderer's program does not contain the network. A frame drawn with appearance has
 * r->appearance set, and its constants in r->appearance_frame. render_forward.c and
 * render_backward.c then launch these kernels instead of their own. The network's formulas are in
 * render/appearance.cl and, in double, in core/splat/appearance.c and render_ref.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>
#include <string.h>

#include "core/base.h"
#include "core/splat/appearance.h"
#include "render/frame.h"

extern const char adam_cl[], appearance_cl[], project_cl[], project_backward_cl[],
    appearance_backward_cl[];

struct render_appearance_kernels {
    uint32_t len, hidden;
    cl_program program;
    cl_kernel project, grads, step; /* as the plain ones, with more arguments */
    /* of appearance_backward.cl; the first two VW 1 alone */
    cl_kernel backward, backward_step, sum;
    struct render_appearance_kernels *next;
};

/* ---- programs ---- */

static void render_appearance_free(struct render_appearance_kernels **p)
{
    struct render_appearance_kernels *l = *p;
    if (!l)
        return;
    cl_kernel kernels[] = {l->project, l->grads, l->step, l->backward, l->backward_step, l->sum};
    for (size_t i = 0; i < sizeof kernels / sizeof *kernels; i++)
        if (kernels[i])
            clReleaseKernel(kernels[i]);
    if (l->program)
        clReleaseProgram(l->program);
    mem_free(l);
    *p = NULL;
}

void render_appearance_close(struct render *r)
{
    while (r->appearance_kernels) {
        struct render_appearance_kernels *next = r->appearance_kernels->next;
        render_appearance_free(&r->appearance_kernels);
        r->appearance_kernels = next;
    }
    dev_release(&r->appearance_frame.mem);
    dev_release(&r->effective.mem);
    dev_release(&r->y_grads.mem);
    dev_release(&r->appearance_parts.mem);
    dev_release(&r->appearance_sums.mem);
}

static enum err_code render_appearance_build(struct render *r, struct render_appearance_kernels *l,
                                             struct err *e)
{
    const struct dev_source sources[] = {FRAME_SOURCES,
                                         {"render/appearance.cl", appearance_cl},
                                         {"render/project.cl", project_cl},
                                         {"render/adam.cl", adam_cl},
                                         {"render/project_backward.cl", project_backward_cl},
                                         {"render/appearance_backward.cl", appearance_backward_cl}};
    struct {
        const char *name;
        cl_kernel *to;
    } kernels[] = {{"project", &l->project},
                   {"project_backward", &l->grads},
                   {"project_step", &l->step},
                   {"appearance_sum", &l->sum},
                   {"appearance_backward", &l->backward}, /* the last two: VW 1 alone */
                   {"appearance_step", &l->backward_step}};
    size_t n_kernels = sizeof kernels / sizeof *kernels;
    if (r->dev->vector_width == LAYOUT_LANES)
        n_kernels -= 2;
    char options[80];
    snprintf(options, sizeof options, "-DAPPEARANCE_LEN=%u -DAPPEARANCE_HIDDEN=%u", l->len,
             l->hidden);
    enum err_code rc =
        dev_build(r->dev, sources, sizeof sources / sizeof *sources, options, &l->program, e);
    for (size_t i = 0; !rc && i < n_kernels; i++)
        rc = dev_kernel(l->program, kernels[i].name, kernels[i].to, e);
    return rc;
}

/* The programs of these lengths, made on first use. */
static enum err_code render_appearance_get(struct render *r, uint32_t len, uint32_t hidden,
                                           struct render_appearance_kernels **out, struct err *e)
{
    for (struct render_appearance_kernels *l = r->appearance_kernels; l; l = l->next)
        if (l->len == len && l->hidden == hidden) {
            *out = l;
            return ERR_OK;
        }
    struct render_appearance_kernels *l = mem_array(1, sizeof *l);
    if (!l)
        return err_set(e, ERR_MEM, "render: appearance: out of memory");
    l->len = len;
    l->hidden = hidden;
    enum err_code rc = render_appearance_build(r, l, e);
    if (rc) {
        render_appearance_free(&l);
        return rc;
    }
    l->next = r->appearance_kernels;
    r->appearance_kernels = *out = l;
    return ERR_OK;
}

/* ---- forward ---- */

enum err_code render_appearance_begin(struct render *r, const struct render_model *m,
                                      const struct render_options *o, struct err *e)
{
    uint32_t hidden = o->appearance_hidden;
    r->appearance = NULL;
    if (!o->appearance_frame)
        return ERR_OK;
    if (m->embed_len < 1 || m->embed_len > GAUSS_EMBED_MAX || hidden < 1 ||
        hidden > APPEARANCE_HIDDEN_MAX)
        return err_set(
            e, ERR_ARG,
            "render_forward: appearance of %u hidden units for Gaussians with embeddings "
            "of %u: both must be 1 to %d; train with appearance first",
            hidden, m->embed_len, GAUSS_EMBED_MAX);
    size_t bytes = appearance_frame_floats(m->embed_len, hidden) * sizeof(float);
    enum err_code rc = render_appearance_get(r, m->embed_len, hidden, &r->appearance, e);
    if (!rc)
        rc = frame_reserve(r, &r->appearance_frame, bytes, e);
    if (!rc)
        rc = frame_reserve(r, &r->effective, (size_t)m->groups * LAYOUT_LANES * sizeof(float), e);
    if (!rc)
        rc = dev_write_soon(r->dev, r->appearance_frame.mem, 0, bytes, o->appearance_frame, e);
    if (rc)
        r->appearance = NULL;
    return rc;
}

enum err_code render_appearance_project(struct render *r, const struct render_model *m,
                                        struct err *e)
{
    size_t local, items = frame_items(r, m->groups, &local);
    cl_mem list = m->list ? m->list : m->params;
    return frame_run(r, r->appearance->project, "project with appearance",
                     FRAME_ARGS(FRAME_ARG(r->view_mem), FRAME_ARG(m->params), FRAME_ARG(list),
                                FRAME_ARG(r->splats.mem), FRAME_ARG(r->depth_key.mem),
                                FRAME_ARG(r->tiles_of.mem), FRAME_ARG(r->edge.mem),
                                FRAME_ARG(r->appearance_frame.mem), FRAME_ARG(r->effective.mem)),
                     items, local, e);
}

/* ---- backward ---- */

/* Numbers in a row of sums. */
static size_t render_appearance_row(const struct render_appearance_kernels *l)
{
    return LAYOUT_APPEARANCE_ROW((size_t)l->len, (size_t)l->hidden);
}

/* Rows: work-items of the kernels that go through the network, or work-groups. */
static size_t render_appearance_rows(const struct render *r)
{
    size_t local, items = frame_items(r, r->view.groups, &local);
    return r->dev->vector_width == LAYOUT_LANES ? items : LAYOUT_APPEARANCE_CHUNKS;
}

enum err_code render_appearance_prepare(struct render *r, const struct render_appearance_grad *out,
                                        struct render_appearance_call *c, struct err *e)
{
    bool wide = r->dev->vector_width == LAYOUT_LANES;
    size_t row = render_appearance_row(r->appearance) * sizeof(float);
    size_t grad = (size_t)r->view.groups * LAYOUT_APPEARANCE_OUT * LAYOUT_LANES * sizeof(float);
    memset(c, 0, sizeof *c);
    c->grads = r->appearance->grads;
    c->step = r->appearance->step;
    c->each = out && r->stats.visible ? out->offset_weight / (float)r->stats.visible : 0;
    enum err_code rc = frame_reserve(r, &r->appearance_parts, render_appearance_rows(r) * row, e);
    if (!rc)
        rc = frame_reserve(r, &r->appearance_sums, row, e);
    if (!rc && !wide)
        rc = frame_reserve(r, &r->y_grads, grad, e);
    const struct frame_arg all[4] = {FRAME_ARG(r->effective.mem),
                                     FRAME_ARG(r->appearance_frame.mem), FRAME_ARG(c->each),
                                     FRAME_ARG(r->appearance_parts.mem)},
                           narrow[2] = {FRAME_ARG(r->effective.mem), FRAME_ARG(r->y_grads.mem)};
    memcpy(c->args, wide ? all : narrow, wide ? sizeof all : sizeof narrow);
    c->n_args = wide ? 4 : 2;
    return rc;
}

/* VW 1: what project_backward.cl left to do. */
static enum err_code render_appearance_backward(struct render *r, const struct render_model *m,
                                                cl_mem grads, const struct render_adam *adam,
                                                const struct layout_adam *rates,
                                                const struct render_appearance_call *c,
                                                struct err *e)
{
    const struct render_appearance_kernels *l = r->appearance;
    size_t items = LAYOUT_APPEARANCE_ITEMS(l->len, l->hidden);
    struct frame_arg args[9] = {FRAME_ARG(r->view_mem),
                                FRAME_ARG(r->appearance_frame.mem),
                                FRAME_ARG(m->params),
                                FRAME_ARG(r->tiles_of.mem),
                                FRAME_ARG(r->y_grads.mem),
                                FRAME_ARG(c->each),
                                FRAME_ARG(r->appearance_parts.mem)};
    size_t n = 7;
    if (rates) {
        args[n++] = (struct frame_arg)FRAME_ARG(adam->moments);
        args[n++] = (struct frame_arg)FRAME_ARG(*rates);
    } else {
        args[n++] = (struct frame_arg)FRAME_ARG(grads);
    }
    return frame_run(r, rates ? l->backward_step : l->backward, "appearance_backward", args, n,
                     LAYOUT_APPEARANCE_CHUNKS * items, items, e);
}

/* Sums to the host. */
static enum err_code render_appearance_read(struct render *r, struct render_appearance_grad *out,
                                            struct err *e)
{
    size_t floats = appearance_frame_floats(r->appearance->len, r->appearance->hidden);
    cl_uint rows = (cl_uint)render_appearance_rows(r);
    float offset = 0;
    enum err_code rc = frame_run(r, r->appearance->sum, "appearance_sum",
                                 FRAME_ARGS(FRAME_ARG(r->appearance_parts.mem), FRAME_ARG(rows),
                                            FRAME_ARG(r->appearance_sums.mem)),
                                 render_appearance_row(r->appearance) / r->dev->vector_width, 1, e);
    if (!rc && out->frame)
        rc = dev_read(r->dev, r->appearance_sums.mem, 0, floats * sizeof(float), out->frame, e);
    if (!rc)
        rc = dev_read(r->dev, r->appearance_sums.mem, floats * sizeof(float), sizeof offset,
                      &offset, e);
    out->visible = r->stats.visible;
    out->offset_mean = out->visible ? (double)offset / out->visible : 0;
    return rc;
}

enum err_code render_appearance_finish(struct render *r, const struct render_model *m, cl_mem grads,
                                       const struct render_adam *adam,
                                       const struct layout_adam *rates,
                                       const struct render_appearance_call *c,
                                       struct render_appearance_grad *out, struct err *e)
{
    enum err_code rc = ERR_OK;
    if (r->dev->vector_width != LAYOUT_LANES)
        rc = render_appearance_backward(r, m, grads, adam, rates, c, e);
    return !rc && out ? render_appearance_read(r, out, e) : rc;
}
