/* The backward pass on the device: dL/d(colour) of the last frame -> gradients, or one step of
 * Adam.
 *
 * There are two launches. blend_backward writes fourteen sums to one slot an intersection.
 * project_backward or project_step adds the slots of a Gaussian in order and applies the chain
 * rule. project_step also makes the Adam step at once, so gradients (236 bytes a Gaussian) are
 * never stored. Kernels and marks are in struct render_backward_state, which is made on first use;
 * render_close frees it through backward_free. The formulas are in the heads of the kernels and, in
 * double, in render_ref_backward.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <assert.h>
#include <math.h>
#include <string.h>

#include "core/base.h"
#include "render/frame.h"

extern const char adam_cl[], blend_cpu_cl[], blend_backward_cl[], project_backward_cl[];

/* Pixel gradients are scaled to normalised device coordinates by half the picture, at most this:
 * with larger pictures thresholds tuned on ordinary ones would split without end. */
static const double half_max_px = 1600;

struct render_backward_state {
    cl_program program;
    cl_kernel blend, grads, step;
    struct frame_buffer marks; /* uchar [intersections] */
    cl_mem unused;             /* stands for the buffers a caller left out */
};

static void backward_release(struct render *r)
{
    struct render_backward_state *s = r->backward;
    if (!s)
        return;
    cl_kernel kernels[] = {s->blend, s->grads, s->step};
    for (size_t i = 0; i < sizeof kernels / sizeof *kernels; i++)
        if (kernels[i])
            clReleaseKernel(kernels[i]);
    if (s->program)
        clReleaseProgram(s->program);
    dev_release(&s->marks.mem);
    dev_release(&s->unused);
    mem_free(s);
    r->backward = NULL;
}

static enum err_code backward_open(struct render *r, struct err *e)
{
    const struct dev_source sources[] = {FRAME_SOURCES,
                                         {"render/blend_backward.cl", blend_backward_cl},
                                         {"render/adam.cl", adam_cl},
                                         {"render/project_backward.cl", project_backward_cl}};
    const struct dev_source wide[] = {FRAME_SOURCES,
                                      {"render/blend_cpu.cl", blend_cpu_cl},
                                      {"render/blend_backward.cl", blend_backward_cl},
                                      {"render/adam.cl", adam_cl},
                                      {"render/project_backward.cl", project_backward_cl}};
    bool cpu = r->dev->vector_width > 1;
    struct render_backward_state *s = r->backward;
    if (s)
        return ERR_OK;
    s = mem_array(1, sizeof *s);
    if (!s)
        return err_set(e, ERR_MEM, "render_backward: out of memory");
    r->backward = s;
    r->backward_free = backward_release;
    enum err_code rc = dev_build(r->dev, cpu ? wide : sources, cpu ? 6 : 5, NULL, &s->program, e);
    if (!rc)
        rc = dev_kernel(s->program, "blend_backward", &s->blend, e);
    if (!rc)
        rc = dev_kernel(s->program, "project_backward", &s->grads, e);
    if (!rc)
        rc = dev_kernel(s->program, "project_step", &s->step, e);
    if (!rc)
        rc = dev_buffer(r->dev, 64, NULL, &s->unused, e);
    if (rc)
        backward_release(r);
    return rc;
}

/* ---- dL/dcolour ---- */

static size_t backward_picture_bytes(const struct render *r)
{
    return (size_t)3 * r->view.width * r->view.height * sizeof(float);
}

cl_mem render_color_grad_buffer(struct render *r)
{
    struct err e;
    if (!r->drawn || frame_reserve(r, &r->color_grad, backward_picture_bytes(r), &e) != ERR_OK)
        return NULL;
    return r->color_grad.mem;
}

cl_mem render_moments_grad_buffer(struct render *r)
{
    struct err e;
    size_t bytes = backward_picture_bytes(r); /* three planes, too */
    if (!r->drawn || !(r->view.depth_unit_m > 0) ||
        frame_reserve(r, &r->moments_grad, bytes, &e) != ERR_OK)
        return NULL;
    return r->moments_grad.mem;
}

enum err_code render_set_color_grad(struct render *r, const float *rgb_grad, struct err *e)
{
    if (!r->drawn)
        return err_set(e, ERR_ARG, "render_set_color_grad: no frame was drawn");
    size_t n = (size_t)r->view.width * r->view.height;
    enum err_code rc = frame_reserve(r, &r->color_grad, backward_picture_bytes(r), e);
    float *planar = !rc ? mem_array(n, 3 * sizeof *planar) : NULL;
    if (rc)
        return rc;
    if (!planar)
        return err_set(e, ERR_MEM, "render_set_color_grad: %zu pixels: out of memory", n);
    for (size_t i = 0; i < n; i++)
        for (size_t c = 0; c < 3; c++)
            planar[c * n + i] = rgb_grad[3 * i + c];
    rc = dev_write(r->dev, r->color_grad.mem, 0, backward_picture_bytes(r), planar, e);
    mem_free(planar);
    return rc;
}

/* ---- stages ---- */

/* The slots of the last frame, filled. */
static enum err_code backward_blend(struct render *r, const struct render_model *m,
                                    cl_uint with_abs, struct err *e)
{
    if (!r->drawn)
        return err_set(e, ERR_ARG,
                       "render_backward: no frame was drawn since the Gaussians changed");
    if (r->view.orthographic || r->view.picture)
        return err_set(e, ERR_ARG, "render_backward: %s has no backward pass",
                       r->view.picture ? "a frame that is only a picture" : "an orthographic view");
    if (r->view.sh_halves)
        return err_set(e, ERR_ARG,
                       "render_backward: Gaussians with harmonics of 16 bits are only drawn");
    if (m->n != r->view.n || m->groups != r->view.groups || m->planes != r->view.planes)
        return err_set(e, ERR_ARG, "render_backward: %u Gaussians: the last frame drew %u others",
                       m->n, r->view.n);
    enum err_code rc = backward_open(r, e);
    if (rc)
        return rc;
    struct render_backward_state *s = r->backward;
    if (r->color_grad.cap_bytes < backward_picture_bytes(r))
        return err_set(e, ERR_ARG, "render_backward: dL/dcolour was not given for this picture");
    bool moments = r->view.depth_unit_m > 0;
    if (moments && r->moments_grad.cap_bytes < backward_picture_bytes(r))
        return err_set(e, ERR_ARG,
                       "render_backward: dL/d of the moments was not given for this picture");
    cl_mem moments_grad = moments ? r->moments_grad.mem : s->unused;
    size_t mark_bytes = ((size_t)r->intersections + 3) / 4 * 4;
    /* [intersections][LAYOUT_SLOT_FLOATS], and room for one vector load */
    rc = frame_reserve(
        r, &r->slots,
        ((size_t)r->intersections * LAYOUT_SLOT_FLOATS + LAYOUT_LANES) * sizeof(float), e);
    if (!rc)
        rc = frame_reserve(r, &s->marks, mark_bytes, e);
    if (!rc)
        rc = dev_zero(r->dev, s->marks.mem, 0, mark_bytes, e);
    if (rc)
        return err_add(e, "render_backward: %llu intersections of splats and tiles",
                       (unsigned long long)r->intersections);
    size_t local = r->dev->vector_width > 1 ? 1 : LAYOUT_TILE_PIXELS;
    return frame_run(
        r, s->blend, "blend_backward",
        FRAME_ARGS(FRAME_ARG(r->view_mem), FRAME_ARG(r->splats.mem), FRAME_ARG(r->tile_start.mem),
                   FRAME_ARG(r->intersection_splat.mem), FRAME_ARG(r->intersection_slot.mem),
                   FRAME_ARG(r->color.mem), FRAME_ARG(r->color_grad.mem), FRAME_ARG(with_abs),
                   FRAME_ARG(r->slots.mem), FRAME_ARG(s->marks.mem), FRAME_ARG(r->hits.mem),
                   FRAME_ARG(r->tile_stop.mem), FRAME_ARG(r->transmit.mem),
                   FRAME_ARG(r->moments.mem), FRAME_ARG(moments_grad), FRAME_ARG(r->known.mem)),
        r->tiles * local, local, e);
}

/* Launch project_backward or project_step with the arguments of a frame with appearance behind. */
static enum err_code backward_run(struct render *r, cl_kernel k, const char *name,
                                  const struct frame_arg *args, size_t n,
                                  const struct render_appearance_call *more, struct err *e)
{
    struct frame_arg all[32];
    size_t local, items = frame_items(r, r->view.groups, &local);
    assert(n + more->n_args <= sizeof all / sizeof *all);
    memcpy(all, args, n * sizeof *all);
    memcpy(all + n, more->args, more->n_args * sizeof *all);
    return frame_run(r, k, name, all, n + more->n_args, items, local, e);
}

enum err_code render_backward_appearance(struct render *r, const struct render_model *m,
                                         cl_mem grads, struct render_appearance_grad *a,
                                         struct err *e)
{
    if (m->list)
        return err_set(e, ERR_ARG,
                       "render_backward: a list of groups has no gradients, only steps");
    if (r->drawn && a && !r->appearance)
        return err_set(e, ERR_ARG, "render_backward: the last frame was drawn without appearance");
    enum err_code rc = backward_blend(r, m, 0, e);
    if (rc)
        return rc;
    const struct render_backward_state *s = r->backward;
    struct render_appearance_call call = {.grads = s->grads};
    if (r->appearance)
        rc = render_appearance_prepare(r, a, &call, e);
    const struct frame_arg args[] = {
        FRAME_ARG(r->view_mem),       FRAME_ARG(m->params),
        FRAME_ARG(r->splats.mem),     FRAME_ARG(r->tiles_of.mem),
        FRAME_ARG(r->slot_first.mem), FRAME_ARG(r->slots.mem),
        FRAME_ARG(s->marks.mem),      FRAME_ARG(grads),
    };
    if (!rc)
        rc = backward_run(r, call.grads, "project_backward", args, sizeof args / sizeof *args,
                          &call, e);
    return !rc && r->appearance ? render_appearance_finish(r, m, grads, NULL, NULL, &call, a, e)
                                : rc;
}

enum err_code render_backward(struct render *r, const struct render_model *m, cl_mem grads,
                              struct err *e)
{
    return render_backward_appearance(r, m, grads, NULL, e);
}

/* ---- Adam ---- */

/* The bias corrections of both moments at a step, 1-based. */
static void backward_bias(const struct render_adam *a, uint32_t step, double *bias1,
                          float *inv_bias2)
{
    *bias1 = 1 - pow((double)a->beta1, step);
    *inv_bias2 = (float)(1 / sqrt(1 - pow((double)a->beta2, step)));
}

static uint32_t backward_wants(const struct render_adam *a,
                               const struct render_density_stats *stats)
{
    uint32_t wants = 0;
    if (a->extra_grad)
        wants |= LAYOUT_STEP_EXTRA;
    if (stats)
        wants |= LAYOUT_STEP_STATS | (stats->absg ? LAYOUT_STEP_ABS : 0) |
                 (stats->opacity ? LAYOUT_STEP_OPACITY : 0);
    return wants;
}

/* The step's numbers as project_step wants them. */
static struct layout_adam backward_rates(const struct render *r, const struct render_adam *a,
                                         const struct render_density_stats *stats)
{
    double bias1, embed_bias1;
    struct layout_adam k = {.beta1 = a->beta1,
                            .beta2 = a->beta2,
                            .eps = a->eps,
                            .scale_log_min = a->scale_log_min,
                            .scale_log_max = a->scale_log_max,
                            .half_width = (float)fmin(0.5 * r->view.width, half_max_px),
                            .half_height = (float)fmin(0.5 * r->view.height, half_max_px),
                            .wants = backward_wants(a, stats),
                            .step = a->step};
    backward_bias(a, a->step, &bias1, &k.inv_bias2);
    k.lr_mean = (float)((double)a->lr_mean / bias1);
    k.lr_scale = (float)((double)a->lr_scale / bias1);
    k.lr_quat = (float)((double)a->lr_quat / bias1);
    k.lr_opacity = (float)((double)a->lr_opacity / bias1);
    k.lr_sh_dc = (float)((double)a->lr_sh_dc / bias1);
    k.lr_sh_rest = (float)((double)a->lr_sh_rest / bias1);
    if (r->appearance) {
        backward_bias(a, a->embed_step, &embed_bias1, &k.inv_bias2_embed);
        k.lr_embed = (float)((double)a->lr_embed / embed_bias1);
    }
    return k;
}

/* After the slots are filled. */
static enum err_code backward_adam(struct render *r, const struct render_model *m,
                                   const struct render_adam *adam,
                                   const struct render_density_stats *stats, struct err *e)
{
    struct render_backward_state *s = r->backward;
    const struct layout_adam rates = backward_rates(r, adam, stats);
    cl_mem none = s->unused, extra = adam->extra_grad ? adam->extra_grad : none;
    struct render_density_stats d = stats ? *stats : (struct render_density_stats){0};
    cl_mem *const buffers[] = {&d.grad, &d.absg, &d.count, &d.radius, &d.repaired, &d.opacity};
    cl_mem list = m->list ? m->list : m->params, settled = m->list ? m->settled : m->params,
           owed = m->list ? m->owed : m->params;
    enum err_code rc = ERR_OK;
    struct render_appearance_call call = {.step = s->step};
    for (size_t i = 0; i < sizeof buffers / sizeof *buffers; i++)
        if (!*buffers[i])
            *buffers[i] = none;
    if (r->appearance)
        rc = render_appearance_prepare(r, adam->appearance, &call, e);
    if (rc)
        return rc;
    r->drawn = false; /* the parameters are about to differ from what was drawn */
    const struct frame_arg args[] = {
        FRAME_ARG(r->view_mem),
        FRAME_ARG(m->params),

        FRAME_ARG(list),
        FRAME_ARG(r->splats.mem),
        FRAME_ARG(r->tiles_of.mem),
        FRAME_ARG(r->slot_first.mem),
        FRAME_ARG(r->slots.mem),
        FRAME_ARG(s->marks.mem),
        FRAME_ARG(adam->moments),
        FRAME_ARG(rates),
        FRAME_ARG(extra),
        FRAME_ARG(d.grad),
        FRAME_ARG(d.absg),
        FRAME_ARG(d.count),
        FRAME_ARG(d.radius),
        FRAME_ARG(d.opacity),
        FRAME_ARG(d.repaired),
        FRAME_ARG(settled),
        FRAME_ARG(owed),
    };
    rc = backward_run(r, call.step, "project_step", args, sizeof args / sizeof *args, &call, e);
    if (!rc && r->appearance)
        rc = render_appearance_finish(r, m, NULL, adam, &rates, &call, adam->appearance, e);
    return rc;
}

enum err_code render_backward_step(struct render *r, struct render_model *m,
                                   struct render_adam *adam, struct render_density_stats *stats,
                                   struct err *e)
{
    if (adam->step < 1 || !(adam->beta1 >= 0 && adam->beta1 < 1) ||
        !(adam->beta2 >= 0 && adam->beta2 < 1) || !(adam->scale_log_min <= adam->scale_log_max))
        return err_set(
            e, ERR_ARG,
            "render_backward_step: step %u, betas %g %g, scale limits %g %g: step counts from 1, "
            "betas are in [0, 1), limits in order",
            adam->step, (double)adam->beta1, (double)adam->beta2, (double)adam->scale_log_min,
            (double)adam->scale_log_max);
    if (r->drawn && r->appearance ? adam->embed_step < 1 : adam->appearance != NULL)
        return err_set(e, ERR_ARG,
                       "render_backward_step: appearance: embed_step counts from 1, and gradients "
                       "can be had after frames with appearance only");
    if (m->list && (!m->settled || (r->drawn && r->appearance)))
        return err_set(e, ERR_ARG,
                       "render_backward_step: a list of groups has steps only by render/defer.h, "
                       "and without appearance");
    double since = frame_now(r);
    enum err_code rc = backward_blend(r, m, stats && stats->absg, e);
    if (!rc)
        rc = frame_clock(r, &since, &r->stats.ms_blend_backward, e);
    if (!rc)
        rc = backward_adam(r, m, adam, stats, e);
    return !rc ? frame_clock(r, &since, &r->stats.ms_project_backward, e) : rc;
}
