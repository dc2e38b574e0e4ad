/* Importance of Gaussians in the last frame: launches importance.cl over the buffers of
 * render_forward. It owns the compiled kernel and the sums. It uses the slots of the backward pass
 * and changes nothing else of the frame, so render_backward may follow.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/base.h"
#include "render/frame.h"

extern const char blend_cpu_cl[], blend_backward_cl[], importance_cl[];

enum { IMPORTANCE_LOCAL = 64 };

struct render_importance {
    struct render *render; /* borrowed */
    cl_program program;
    cl_kernel tiles, shares /* VW 1 */, removal, gather;
    struct frame_buffer sums;
    void *seen; /* sums, mapped for the caller */
};

enum err_code render_importance_open(struct render *r, struct render_importance **out,
                                     struct err *e)
{
    const struct dev_source cpu[] = {FRAME_SOURCES,
                                     {"render/blend_cpu.cl", blend_cpu_cl},
                                     {"render/blend_backward.cl", blend_backward_cl},
                                     {"render/importance.cl", importance_cl}};
    const struct dev_source gpu[] = {FRAME_SOURCES, {"render/importance.cl", importance_cl}};
    bool wide = r->dev->vector_width > 1;
    *out = NULL;
    struct render_importance *s = mem_array(1, sizeof *s);
    if (!s)
        return err_set(e, ERR_MEM, "render_importance_open: out of memory");
    s->render = r;
    enum err_code rc = dev_build(r->dev, wide ? cpu : gpu, wide ? 5 : 3, NULL, &s->program, e);
    if (!rc)
        rc = dev_kernel(s->program, "importance_tiles", &s->tiles, e);
    if (!rc)
        rc = wide ? ERR_OK : dev_kernel(s->program, "share_tiles", &s->shares, e);
    if (!rc)
        rc = dev_kernel(s->program, "removal_tiles", &s->removal, e);
    if (!rc)
        rc = dev_kernel(s->program, "importance_gather", &s->gather, e);
    if (rc)
        render_importance_close(&s);
    *out = s;
    return rc;
}

void render_importance_forget(struct render_importance *s)
{
    if (s->seen)
        clEnqueueUnmapMemObject(s->render->dev->queue, s->sums.mem, s->seen, 0, NULL, NULL);
    s->seen = NULL;
    dev_release(&s->sums.mem);
    s->sums.cap_bytes = 0;
}

void render_importance_close(struct render_importance **p)
{
    struct render_importance *s = *p;
    if (!s)
        return;
    if (s->tiles)
        clReleaseKernel(s->tiles);
    if (s->shares)
        clReleaseKernel(s->shares);
    if (s->removal)
        clReleaseKernel(s->removal);
    if (s->gather)
        clReleaseKernel(s->gather);
    if (s->program)
        clReleaseProgram(s->program);
    render_importance_forget(s);
    mem_free(s);
    *p = NULL;
}

/* One of the kernels over the tiles: that of shares (GPUs; on CPUs blending wrote their slots) asks
 * for no weights, and only that of removal for the colours, which come last. */
static enum err_code render_importance_tiles(struct render_importance *s, cl_kernel tiles,
                                             const char *name, cl_mem weight, struct err *e)
{
    struct render *r = s->render;
    size_t group = r->dev->vector_width == 1 ? LAYOUT_TILE_PIXELS : 1;
    const cl_mem args[] = {r->view_mem,
                           r->splats.mem,
                           r->tile_start.mem,
                           r->intersection_splat.mem,
                           r->intersection_slot.mem,
                           r->hits.mem,
                           r->tile_stop.mem,
                           r->slots.mem,
                           weight,
                           render_color_buffer(r)};
    cl_uint n = sizeof args / sizeof args[0];
    n -= tiles == s->shares ? 2 : tiles != s->removal;
    cl_int bad = CL_SUCCESS;
    for (cl_uint i = 0; i < n; i++)
        bad |= dev_arg(tiles, i, args[i]);
    if (bad)
        return err_set(e, ERR_DEVICE, "render_importance: arguments of %s", name);
    return dev_run(r->dev, tiles, name, r->tiles * group, group, e);
}

static enum err_code render_importance_gather(struct render_importance *s, uint32_t n,
                                              struct err *e)
{
    struct render *r = s->render;
    cl_uint count = n;
    cl_mem args[] = {r->tiles_of.mem, r->slot_first.mem, r->slots.mem, s->sums.mem};
    cl_int bad = dev_arg(s->gather, 0, count);
    for (cl_uint i = 0; i < sizeof args / sizeof args[0]; i++)
        bad |= dev_arg(s->gather, i + 1, args[i]);
    if (bad)
        return err_set(e, ERR_DEVICE, "render_importance: arguments of importance_gather");
    return dev_run(r->dev, s->gather, "importance_gather", n, IMPORTANCE_LOCAL, e);
}

/* tiles NULL: the slots are there. */
static enum err_code render_importance_sum(struct render_importance *s, cl_kernel tiles,
                                           const char *name, const struct render_model *m,
                                           cl_mem weight, const float **sums, struct err *e)
{
    struct render *r = s->render;
    *sums = NULL;
    if (!r->drawn || r->view.n != m->n)
        return err_set(e, ERR_ARG, "render_importance: no frame of this model was drawn");
    if (r->view.picture)
        return err_set(e, ERR_ARG, "render_importance: the frame was only a picture");
    if (tiles == s->shares && !r->shares)
        return err_set(e, ERR_ARG, "render_importance: the frame was drawn without shares");
    if (m->n == 0)
        return ERR_OK;
    size_t slots_bytes = (size_t)r->intersections * LAYOUT_IMPORTANCE_SUMS * sizeof(float);
    size_t sums_bytes = (size_t)m->n * LAYOUT_IMPORTANCE_SUMS * sizeof(float);
    enum err_code rc = dev_unmap(r->dev, s->sums.mem, &s->seen, e);
    if (!rc)
        rc = frame_reserve(r, &r->slots, slots_bytes, e);
    if (!rc)
        rc = frame_reserve(r, &s->sums, sums_bytes, e);
    if (!rc && slots_bytes && tiles)
        rc = dev_zero(r->dev, r->slots.mem, 0, slots_bytes, e);
    if (!rc && r->intersections && tiles)
        rc = render_importance_tiles(s, tiles, name, weight, e);
    if (!rc)
        rc = render_importance_gather(s, m->n, e);
    if (!rc)
        rc = dev_map(r->dev, s->sums.mem, CL_MAP_READ, sums_bytes, &s->seen, e);
    *sums = s->seen;
    return rc;
}

enum err_code render_importance_run(struct render_importance *s, const struct render_model *m,
                                    cl_mem weight, const float **sums, struct err *e)
{
    return render_importance_sum(s, s->tiles, "importance_tiles", m, weight, sums, e);
}

enum err_code render_share_run(struct render_importance *s, const struct render_model *m,
                               const float **sums, struct err *e)
{
    return render_importance_sum(s, s->shares, "share_tiles", m, NULL, sums, e);
}

enum err_code render_removal_run(struct render_importance *s, const struct render_model *m,
                                 cl_mem weight, const float **sums, struct err *e)
{
    return render_importance_sum(s, s->removal, "removal_tiles", m, weight, sums, e);
}
