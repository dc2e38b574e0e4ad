/* Appearance on the device: the network's programs, what a frame with it leaves behind, and its
 * gradients.
 *
 * Kernels are compiled for the lengths of the model at hand (one program a pair of lengths, kept
 * until render_close), because loops of constant length keep embeddings in registers; the plain
 * renderer's program knows nothing of it. A frame drawn with appearance has r->look set and its
 * constants in r->look_frame; render.c and render_backward.c ask for these and launch the kernels
 * given here instead of their own. What the network computes stands in render/appearance.cl and, in
 * double, in core/appearance.c and render_ref.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>
#include <string.h>

#include "core/appearance.h"
#include "core/base.h"
#include "render/frame.h"

extern const char appearance_cl[], project_cl[], project_backward_cl[], appearance_backward_cl[];

struct render_look {
    uint32_t len, hidden;
    cl_program program;
    cl_kernel project, grads, step;         /* as the plain ones, with two more arguments */
    cl_kernel backward, backward_step, sum; /* of appearance_backward.cl */
    struct render_look *next;
};

/* ---- programs ---------------------------------------------------------------------------------
 */

static void look_free(struct render_look **p)
{
    struct render_look *l = *p;
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

void look_close(struct render *r)
{
    while (r->looks) {
        struct render_look *next = r->looks->next;
        look_free(&r->looks);
        r->looks = next;
    }
    dev_release(&r->look_frame.mem);
    dev_release(&r->effective.mem);
    dev_release(&r->look_grad.mem);
    dev_release(&r->look_parts.mem);
    dev_release(&r->look_sums.mem);
}

static enum err_code look_build(struct render *r, struct render_look *l, struct err *e)
{
    const struct dev_source sources[] = {{"render/common.cl", common_cl},
                                         {"render/appearance.cl", appearance_cl},
                                         {"render/project.cl", project_cl},
                                         {"render/project_backward.cl", project_backward_cl},
                                         {"render/appearance_backward.cl", appearance_backward_cl}};
    struct {
        const char *name;
        cl_kernel *to;
    } kernels[] = {{"project", &l->project},
                   {"project_backward", &l->grads},
                   {"project_step", &l->step},
                   {"appearance_backward", &l->backward},
                   {"appearance_step", &l->backward_step},
                   {"appearance_sum", &l->sum}};
    char options[80];
    snprintf(options, sizeof options, "-DAPPEARANCE_LEN=%u -DAPPEARANCE_HIDDEN=%u", l->len,
             l->hidden);
    enum err_code rc =
        dev_build(r->dev, sources, sizeof sources / sizeof *sources, options, &l->program, e);
    for (size_t i = 0; rc == ERR_OK && i < sizeof kernels / sizeof *kernels; i++)
        rc = dev_kernel(l->program, kernels[i].name, kernels[i].to, e);
    return rc;
}

/* The programs of these lengths, made on first use. */
static enum err_code look_get(struct render *r, uint32_t len, uint32_t hidden,
                              struct render_look **out, struct err *e)
{
    for (struct render_look *l = r->looks; l; l = l->next)
        if (l->len == len && l->hidden == hidden) {
            *out = l;
            return ERR_OK;
        }
    struct render_look *l = mem_array(1, sizeof *l);
    if (!l)
        return err_set(e, ERR_MEM, "render: appearance: out of memory");
    l->len = len;
    l->hidden = hidden;
    enum err_code rc = look_build(r, l, e);
    if (rc != ERR_OK) {
        look_free(&l);
        return rc;
    }
    l->next = r->looks;
    r->looks = *out = l;
    return ERR_OK;
}

/* ---- forward ----------------------------------------------------------------------------------
 */

enum err_code look_begin(struct render *r, const struct render_model *m,
                         const struct render_options *o, struct err *e)
{
    uint32_t hidden = o->appearance_hidden;
    r->look = NULL;
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
    enum err_code rc = look_get(r, m->embed_len, hidden, &r->look, e);
    if (rc == ERR_OK)
        rc = frame_reserve(r, &r->look_frame, bytes, e);
    if (rc == ERR_OK)
        rc = frame_reserve(r, &r->effective, (size_t)m->groups * LAYOUT_LANES * sizeof(float), e);
    if (rc == ERR_OK)
        rc = dev_write(r->dev, r->look_frame.mem, 0, bytes, o->appearance_frame, e);
    if (rc != ERR_OK)
        r->look = NULL;
    return rc;
}

enum err_code look_project(struct render *r, const struct render_model *m, struct err *e)
{
    size_t local, items = frame_items(r, m->groups, &local);
    cl_mem filter = m->filter ? m->filter : m->params; /* not read without */
    return frame_run(r, r->look->project, "project with appearance",
                     FRAME_ARGS(FRAME_ARG(r->view_mem), FRAME_ARG(m->params), FRAME_ARG(filter),
                                FRAME_ARG(r->splats.mem), FRAME_ARG(r->depth_key.mem),
                                FRAME_ARG(r->tiles_of.mem), FRAME_ARG(r->look_frame.mem),
                                FRAME_ARG(r->effective.mem)),
                     items, local, e);
}

/* ---- backward ---------------------------------------------------------------------------------
 */

enum err_code look_kernels(struct render *r, cl_kernel *grads, cl_kernel *step, struct err *e)
{
    *grads = r->look->grads;
    *step = r->look->step;
    return frame_reserve(r, &r->look_grad,
                         (size_t)r->view.groups * APPEARANCE_OUT * LAYOUT_LANES * sizeof(float), e);
}

/* The local size of appearance_backward.cl: LOOK_ITEMS there. */
static size_t look_items(const struct render *r)
{
    uint32_t columns = (r->look->len + 2 * r->look->hidden + APPEARANCE_OUT + 2) | 1;
    return r->dev->vector_width > 1 ? 1 : columns > 128 ? 32 : 64;
}

/* Sums to the host. */
static enum err_code look_read(struct render *r, struct render_appearance_grad *out, struct err *e)
{
    size_t floats = appearance_frame_floats(r->look->len, r->look->hidden);
    float offset = 0;
    enum err_code rc = frame_run(
        r, r->look->sum, "appearance_sum",
        FRAME_ARGS(FRAME_ARG(r->look_parts.mem), FRAME_ARG(r->look_sums.mem)), floats + 1, 1, e);
    if (rc == ERR_OK && out->frame)
        rc = dev_read(r->dev, r->look_sums.mem, 0, floats * sizeof(float), out->frame, e);
    if (rc == ERR_OK)
        rc = dev_read(r->dev, r->look_sums.mem, floats * sizeof(float), sizeof offset, &offset, e);
    out->visible = r->stats.visible;
    out->offset_mean = out->visible ? (double)offset / out->visible : 0;
    return rc;
}

enum err_code look_backward(struct render *r, const struct render_model *m, cl_mem grads,
                            const struct look_adam *adam, struct render_appearance_grad *out,
                            struct err *e)
{
    struct render_look *l = r->look;
    size_t sums = appearance_frame_floats(l->len, l->hidden) + 1, items = look_items(r);
    cl_float each = out && r->stats.visible ? out->offset_weight / (float)r->stats.visible : 0;
    enum err_code rc =
        frame_reserve(r, &r->look_parts, LAYOUT_APPEARANCE_CHUNKS * sums * sizeof(float), e);
    if (rc == ERR_OK)
        rc = frame_reserve(r, &r->look_sums, sums * sizeof(float), e);
    if (rc != ERR_OK)
        return rc;
    const struct frame_arg common[] = {FRAME_ARG(r->view_mem),      FRAME_ARG(r->look_frame.mem),
                                       FRAME_ARG(m->params),        FRAME_ARG(r->tiles_of.mem),
                                       FRAME_ARG(r->look_grad.mem), FRAME_ARG(each),
                                       FRAME_ARG(r->look_parts.mem)};
    struct frame_arg args[sizeof common / sizeof *common + 4];
    size_t n = sizeof common / sizeof *common;
    memcpy(args, common, sizeof common);
    if (adam) {
        args[n++] = (struct frame_arg)FRAME_ARG(adam->m1);
        args[n++] = (struct frame_arg)FRAME_ARG(adam->m2);
        args[n++] = (struct frame_arg)FRAME_ARG(adam->lr);
        args[n++] = (struct frame_arg)FRAME_ARG(adam->k);
    } else {
        args[n++] = (struct frame_arg)FRAME_ARG(grads);
    }
    rc = frame_run(r, adam ? l->backward_step : l->backward, "appearance_backward", args, n,
                   LAYOUT_APPEARANCE_CHUNKS * items, items, e);
    return rc == ERR_OK && out ? look_read(r, out, e) : rc;
}
