/* The forward pass on the device: programs, buffers, and the order of launches of a frame.
 *
 * Buffers belong to struct render, grow by half when a frame needs more, and are kept. What a frame
 * gets from the host is enqueued before its first launch. The host waits once within a frame, to
 * read the number of intersections (splat, tile) before the lists are made; meanwhile the device
 * goes on with the sort. So nothing is written beyond a buffer, and no list is cut short.
 * render/frame.h says what each stage leaves, render_ref.c defines the picture.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <assert.h>
#include <math.h>
#include <string.h>

#include "core/base.h"
#include "render/frame.h"
#include "render/supersample.h"

extern const char project_cl[], sort_cl[], bin_cl[], blend_cpu_cl[], blend_gpu_cl[],
    background_cl[], moments_cl[];

enum { RADIX_PASSES = 3 };

/* ---- open, close ---- */

static enum err_code render_build(struct render *r, struct err *e)
{
    const struct dev_source shapes[] = {{"render/blend_gpu.cl", blend_gpu_cl},
                                        {"render/blend_cpu.cl", blend_cpu_cl}};
    const struct dev_source sources[] = {FRAME_SOURCES,
                                         {"render/project.cl", project_cl},
                                         {"render/sort.cl", sort_cl},
                                         {"render/bin.cl", bin_cl},
                                         {"render/moments.cl", moments_cl},
                                         shapes[r->dev->vector_width == LAYOUT_LANES],
                                         {"render/background.cl", background_cl}};
    struct {
        const char *name;
        cl_kernel *to;
    } kernels[] = {{"project", &r->k.project},
                   {"sort_count", &r->k.sort_count},
                   {"sort_scan", &r->k.sort_scan},
                   {"sort_scatter", &r->k.sort_scatter},
                   {"bin_total", &r->k.bin_total},
                   {"bin_expand", &r->k.bin_expand},
                   {"bin_sum", &r->k.bin_sum},
                   {"bin_scan", &r->k.bin_scan},
                   {"bin_scatter", &r->k.bin_scatter},
                   {"blend", &r->k.blend},
                   {"background", &r->k.background},
                   {"planes", &r->k.planes},
                   {"blend_moments", &r->k.blend_moments}, /* the last two: VW 16 alone */
                   {"blend_shares", &r->k.blend_shares}};
    size_t n_kernels = sizeof kernels / sizeof *kernels;
    n_kernels -= r->dev->vector_width == LAYOUT_LANES ? 0 : 2;
    enum err_code rc =
        dev_build(r->dev, sources, sizeof sources / sizeof *sources, NULL, &r->program, e);
    for (size_t i = 0; !rc && i < n_kernels; i++)
        rc = dev_kernel(r->program, kernels[i].name, kernels[i].to, e);
    return rc;
}

enum err_code render_open(struct dev *dev, struct render **out, struct err *e)
{
    struct render *r = mem_array(1, sizeof *r);
    enum err_code rc = ERR_OK;
    *out = NULL;
    if (!r)
        return err_set(e, ERR_MEM, "render_open");
    r->dev = dev;
    r->vector_width = dev->vector_width;
    r->intersection_max = UINT32_MAX - LAYOUT_TILE; /* slots are 32-bit */
    rc = render_build(r, e);
    if (!rc && dev->vector_width != LAYOUT_LANES)
        rc = order_gpu_open(dev, &r->order_gpu, e);
    if (!rc)
        rc = dev_buffer(dev, sizeof(struct layout_view), NULL, &r->view_mem, e);
    if (!rc)
        rc = dev_buffer(dev, sizeof(struct layout_counts), NULL, &r->counts, e);
    if (!rc)
        *out = r;
    else
        render_close(&r);
    return rc;
}

void render_close(struct render **rp)
{
    struct render *r = rp ? *rp : NULL;
    if (!r)
        return;
    if (r->backward_free)
        r->backward_free(r);
    render_appearance_close(r);
    order_gpu_close(&r->order_gpu);
    struct frame_buffer *buffers[] = {&r->splats,
                                      &r->depth_key,
                                      &r->tiles_of,
                                      &r->slot_first,
                                      &r->keys[0],
                                      &r->keys[1],
                                      &r->ids[0],
                                      &r->ids[1],
                                      &r->histogram,
                                      &r->expanded_tile,
                                      &r->expanded_splat,
                                      &r->expanded_slot,
                                      &r->bin_offset,
                                      &r->tile_start,
                                      &r->intersection_splat,
                                      &r->intersection_slot,
                                      &r->color,
                                      &r->transmit,
                                      &r->color_grad,
                                      &r->moments,
                                      &r->moments_grad,
                                      &r->known,
                                      &r->where,
                                      &r->edge,
                                      &r->hits,
                                      &r->tile_stop,
                                      &r->slots};
    for (size_t i = 0; i < sizeof buffers / sizeof *buffers; i++)
        dev_release(&buffers[i]->mem);
    cl_kernel kernels[] = {r->k.project,       r->k.sort_count,  r->k.sort_scan,  r->k.sort_scatter,
                           r->k.bin_total,     r->k.bin_expand,  r->k.bin_sum,    r->k.bin_scan,
                           r->k.bin_scatter,   r->k.blend,       r->k.background, r->k.planes,
                           r->k.blend_moments, r->k.blend_shares};
    for (size_t i = 0; i < sizeof kernels / sizeof *kernels; i++)
        if (kernels[i])
            clReleaseKernel(kernels[i]);
    if (r->program)
        clReleaseProgram(r->program);
    dev_release(&r->view_mem);
    dev_release(&r->counts);
    mem_free(r);
    *rp = NULL;
}

void render_set_stop(struct render *r, bool (*stop)(const void *user), const void *user)
{
    r->stop = stop;
    r->stop_user = user;
}

enum err_code render_go(const struct render *r, struct err *e)
{
    return r->stop && r->stop(r->stop_user) ? err_set(e, ERR_CANCEL, "cancelled") : ERR_OK;
}

/* ---- the view ---- */

static enum err_code render_view_check(const struct camera *c, struct err *e)
{
    bool finite =
        isfinite(c->cx_px) && isfinite(c->cy_px) && isfinite(c->fx_px) && isfinite(c->fy_px);
    for (int i = 0; i < 9; i++)
        finite = finite && isfinite(c->rot[i]);
    for (int i = 0; i < 3; i++)
        finite = finite && isfinite(c->trans[i]);
    if (c->width_px < 1 || c->height_px < 1 || c->width_px > RENDER_SIZE_MAX_PX ||
        c->height_px > RENDER_SIZE_MAX_PX)
        return err_set(e, ERR_ARG, "render_forward: picture of %u x %u: sizes are 1 to %d",
                       c->width_px, c->height_px, RENDER_SIZE_MAX_PX);
    if (!finite || !(c->fx_px > 0) || !(c->fy_px > 0))
        return err_set(e, ERR_ARG,
                       "render_forward: camera: not finite, or focal length not positive");
    return ERR_OK;
}

/* Everything in double until the origin is out of the numbers. */
void render_view_fill(const struct render *r, const struct render_model *m, const struct camera *c,
                      const struct render_options *o, struct layout_view *v)
{
    double trans[3], w = c->width_px, h = c->height_px;
    memset(v, 0, sizeof *v);
    for (int i = 0; i < 3; i++) {
        trans[i] = c->rot[3 * i] * m->origin_enu_m[0] + c->rot[3 * i + 1] * m->origin_enu_m[1] +
                   c->rot[3 * i + 2] * m->origin_enu_m[2] + c->trans[i];
        v->trans[i] = (float)trans[i];
        v->background[i] = o->background[i];
    }
    for (int i = 0; i < 3; i++)
        v->eye[i] =
            (float)-(c->rot[i] * trans[0] + c->rot[3 + i] * trans[1] + c->rot[6 + i] * trans[2]);
    for (int i = 0; i < 9; i++)
        v->rot[i] = (float)c->rot[i];
    v->fx = (float)c->fx_px;
    v->fy = (float)c->fy_px;
    v->cx = (float)c->cx_px;
    v->cy = (float)c->cy_px;
    if (!o->orthographic) { /* else 0: the Jacobian has no third column */
        v->lim_neg_x = (float)(c->cx_px / c->fx_px + 0.15 * w / c->fx_px);
        v->lim_pos_x = (float)((w - c->cx_px) / c->fx_px + 0.15 * w / c->fx_px);
        v->lim_neg_y = (float)(c->cy_px / c->fy_px + 0.15 * h / c->fy_px);
        v->lim_pos_y = (float)((h - c->cy_px) / c->fy_px + 0.15 * h / c->fy_px);
    }
    v->near_m = (float)(o->near_m > 0 ? o->near_m : RENDER_NEAR_M);
    v->kernel_px2 = o->kernel_px2 > 0 ? (float)o->kernel_px2 : o->aa == RENDER_AA_MIP ? 0.1f : 0.3f;
    v->compensate = o->aa != RENDER_AA_NONE;
    v->half_max_px = 2 * (float)(w > h ? w : h);
    v->width = c->width_px;
    v->height = c->height_px;
    v->tiles_x = (c->width_px + LAYOUT_TILE - 1) / LAYOUT_TILE;
    v->tiles_y = (c->height_px + LAYOUT_TILE - 1) / LAYOUT_TILE;
    v->n = m->n;
    v->groups = m->groups;
    v->planes = m->planes;
    v->sh_degree = o->sh_degree >= 0 && (uint32_t)o->sh_degree < m->sh_degree
                       ? (uint32_t)o->sh_degree
                       : m->sh_degree;
    v->tile_cull = !r->box_tiles;
    v->listed = m->list != NULL;
    v->sh_halves = m->sh_halves;
    v->orthographic = o->orthographic;
    v->picture = o->picture;
    v->depth_unit_m = (float)o->depth_unit_m;
    v->known_zeta = o->known ? (float)o->known_zeta : 0.0f;
    v->room_px = o->list_room_px;
    v->again = o->list_again;
    if (o->edge) {
        v->edge_x = (float)(o->edge->middle_enu_m[0] - o->edge->side_m / 2 - m->origin_enu_m[0]);
        v->edge_y = (float)(o->edge->middle_enu_m[1] - o->edge->side_m / 2 - m->origin_enu_m[1]);
        v->edge_cells = (float)(LAYOUT_EDGE / o->edge->side_m);
    }
}

/* ---- stages ---- */

static uint32_t render_bin_stride(const struct render *r)
{
    return (r->tiles + 15) / 16 * 16;
}

static enum err_code render_frame_buffers(struct render *r, struct err *e)
{
    size_t lanes = (size_t)r->view.groups * LAYOUT_LANES;
    size_t pixels = (size_t)r->view.width * r->view.height, word = sizeof(uint32_t);
    size_t stride = render_bin_stride(r);
    const struct {
        struct frame_buffer *b;
        size_t bytes;
    } wants[] = {{&r->splats, lanes * sizeof(struct layout_splat)},
                 {&r->depth_key, lanes * word},
                 {&r->tiles_of, lanes * word},
                 {&r->slot_first, lanes * word},
                 {&r->keys[0], lanes * word},
                 {&r->keys[1], lanes * word},
                 {&r->ids[0], lanes * word},
                 {&r->ids[1], lanes * word},
                 {&r->histogram, (word << LAYOUT_SORT_BITS) * (LAYOUT_SORT_CHUNKS + 1)},
                 {&r->bin_offset, LAYOUT_BIN_CHUNKS * stride * word},
                 {&r->tile_start, (stride + 1) * word},
                 {&r->tile_stop, stride * word},
                 {&r->color, 3 * pixels * sizeof(float)},
                 {&r->transmit, pixels * sizeof(float)},
                 {&r->moments, (r->view.depth_unit_m > 0 ? 2 * pixels : 1) * sizeof(float)},
                 {&r->known, (r->view.known_zeta > 0 ? pixels : 1) * sizeof(float)}};
    for (size_t i = 0; i < sizeof wants / sizeof *wants; i++) {
        enum err_code rc = frame_reserve(r, wants[i].b, wants[i].bytes, e);
        if (rc)
            return err_add(e, "render_forward: %u Gaussians, %u x %u px", r->view.n, r->view.width,
                           r->view.height);
    }
    return ERR_OK;
}

static enum err_code render_stage_project(struct render *r, const struct render_model *m,
                                          struct err *e)
{
    size_t local, items = frame_items(r, m->groups, &local);
    cl_mem list = m->list ? m->list : m->params;
    r->drawn_params = m->params;
    r->drawn_list = list;
    if (r->appearance)
        return render_appearance_project(r, m, e);
    return frame_run(r, r->k.project, "project",
                     FRAME_ARGS(FRAME_ARG(r->view_mem), FRAME_ARG(m->params), FRAME_ARG(list),
                                FRAME_ARG(r->splats.mem), FRAME_ARG(r->depth_key.mem),
                                FRAME_ARG(r->tiles_of.mem), FRAME_ARG(r->edge.mem)),
                     items, local, e);
}

static enum err_code render_stage_sort(struct render *r, struct err *e)
{
    cl_uint n = r->view.n;
    for (cl_uint pass = 0; pass < RADIX_PASSES; pass++) {
        /* depth_key -> [0] -> [1] -> [0] */
        const struct frame_buffer *keys = pass ? &r->keys[(pass + 1) % 2] : &r->depth_key;
        const struct frame_buffer *ids = &r->ids[(pass + 1) % 2];
        const struct frame_buffer *keys_out = &r->keys[pass % 2], *ids_out = &r->ids[pass % 2];
        enum err_code rc = frame_run(r, r->k.sort_count, "sort_count",
                                     FRAME_ARGS(FRAME_ARG(keys->mem), FRAME_ARG(r->tiles_of.mem),
                                                FRAME_ARG(n), FRAME_ARG(pass),
                                                FRAME_ARG(r->histogram.mem), FRAME_ARG(r->counts)),
                                     LAYOUT_SORT_CHUNKS, 1, e);
        if (!rc)
            rc = frame_run(
                r, r->k.sort_scan, "sort_scan",
                FRAME_ARGS(FRAME_ARG(r->histogram.mem), FRAME_ARG(pass), FRAME_ARG(r->counts)), 1,
                1, e);
        if (!rc && pass == 0)
            rc = frame_ask_counts(r, e);
        if (!rc)
            rc = frame_run(r, r->k.sort_scatter, "sort_scatter",
                           FRAME_ARGS(FRAME_ARG(keys->mem), FRAME_ARG(ids->mem),
                                      FRAME_ARG(r->tiles_of.mem), FRAME_ARG(n), FRAME_ARG(pass),
                                      FRAME_ARG(r->histogram.mem), FRAME_ARG(r->counts),
                                      FRAME_ARG(keys_out->mem), FRAME_ARG(ids_out->mem),
                                      FRAME_ARG(r->slot_first.mem)),
                           LAYOUT_SORT_CHUNKS, 1, e);
        if (rc)
            return rc;
    }
    return ERR_OK;
}

/* How long are the lists? Make room. */
static enum err_code render_stage_count(struct render *r, struct err *e)
{
    enum err_code rc = dev_wait(r->dev, &r->counting, e);
    if (rc)
        return rc;
    r->intersections = r->counted.intersections;
    r->stats.intersections = r->counted.intersections;
    r->stats.visible = r->counted.visible;
    if (r->intersections > r->intersection_max)
        return err_set(
            e, ERR_LIMIT,
            "render_forward: %llu intersections of splats and tiles: at most %llu; draw a smaller "
            "picture or fewer Gaussians",
            (unsigned long long)r->intersections, (unsigned long long)r->intersection_max);
    struct frame_buffer *lists[] = {&r->expanded_tile, &r->expanded_splat, &r->expanded_slot,
                                    &r->intersection_splat, &r->intersection_slot};
    for (size_t i = 0; !rc && i < sizeof lists / sizeof *lists; i++)
        rc = frame_reserve(r, lists[i], (size_t)r->intersections * sizeof(uint32_t), e);
    if (!rc)
        rc = frame_reserve(r, &r->hits, (size_t)r->intersections * sizeof(uint16_t), e);
    return rc;
}

static enum err_code render_stage_bin(struct render *r, struct err *e)
{
    cl_uint stride = render_bin_stride(r), tiles = r->tiles, cap = (cl_uint)r->intersections;
    enum err_code rc = frame_run(r, r->k.bin_total, "bin_total",
                                 FRAME_ARGS(FRAME_ARG(r->ids[0].mem), FRAME_ARG(r->keys[0].mem),
                                            FRAME_ARG(r->tiles_of.mem), FRAME_ARG(r->counts)),
                                 LAYOUT_BIN_CHUNKS, 1, e);
    if (!rc)
        rc = frame_run(r, r->k.bin_expand, "bin_expand",
                       FRAME_ARGS(FRAME_ARG(r->view_mem), FRAME_ARG(r->ids[0].mem),
                                  FRAME_ARG(r->splats.mem), FRAME_ARG(r->slot_first.mem),
                                  FRAME_ARG(r->counts), FRAME_ARG(cap), FRAME_ARG(stride),
                                  FRAME_ARG(r->expanded_tile.mem), FRAME_ARG(r->expanded_splat.mem),
                                  FRAME_ARG(r->expanded_slot.mem), FRAME_ARG(r->bin_offset.mem)),
                       LAYOUT_BIN_CHUNKS, 1, e);
    if (!rc)
        rc = frame_run(r, r->k.bin_sum, "bin_sum",
                       FRAME_ARGS(FRAME_ARG(stride), FRAME_ARG(r->bin_offset.mem),
                                  FRAME_ARG(r->tile_start.mem)),
                       stride / 16, 1, e);
    if (!rc)
        rc = frame_run(r, r->k.bin_scan, "bin_scan",
                       FRAME_ARGS(FRAME_ARG(tiles), FRAME_ARG(r->tile_start.mem)), 1, 1, e);
    if (!rc)
        rc = frame_run(r, r->k.bin_scatter, "bin_scatter",
                       FRAME_ARGS(FRAME_ARG(r->view_mem), FRAME_ARG(r->counts), FRAME_ARG(cap),
                                  FRAME_ARG(stride), FRAME_ARG(r->expanded_tile.mem),
                                  FRAME_ARG(r->expanded_splat.mem), FRAME_ARG(r->expanded_slot.mem),
                                  FRAME_ARG(r->tile_start.mem), FRAME_ARG(r->bin_offset.mem),
                                  FRAME_ARG(r->intersection_splat.mem),
                                  FRAME_ARG(r->intersection_slot.mem)),
                       LAYOUT_BIN_CHUNKS, 1, e);
    return rc;
}

/* Blending takes half of a frame: to know whether it is wanted is worth a wait. */
static enum err_code render_before_blend(struct render *r, struct err *e)
{
    enum err_code rc = r->stop ? dev_finish(r->dev, e) : ERR_OK;
    return !rc ? render_go(r, e) : rc;
}

/* A new order and new tile lists. */
static enum err_code render_stage_lists(struct render *r, double *since, struct err *e)
{
    enum err_code rc = r->order_gpu ? order_gpu_sort(r, e) : render_stage_sort(r, e);
    if (!rc)
        rc = render_stage_count(r, e);
    if (!rc)
        rc = render_go(r, e); /* the host has waited anyway */
    if (!rc)
        rc = frame_clock(r, since, &r->stats.ms_sort, e);
    if (!rc)
        rc = r->order_gpu ? order_gpu_bin(r, e) : render_stage_bin(r, e);
    return !rc ? frame_clock(r, since, &r->stats.ms_bin, e) : rc;
}

/* Those of an earlier frame: all tiles are to be drawn once more. */
static enum err_code render_lists_again(struct render *r, struct err *e)
{
    static const cl_uint first = 0; /* the device may read it later */
    r->stats.intersections = r->counted.intersections;
    r->stats.visible = r->counted.visible;
    return dev_write_soon(r->dev, r->counts, offsetof(struct layout_counts, next_tile),
                          sizeof first, &first, e);
}

static enum err_code render_lists_check(const struct render *r, const struct layout_view *was,
                                        const struct render_options *o, struct err *e)
{
    const struct layout_view *v = &r->view;
    if (!(o->list_room_px >= 0) || !isfinite(o->list_room_px))
        return err_set(e, ERR_ARG, "render_forward: room of %g px in lists",
                       (double)o->list_room_px);
    if (!o->list_again)
        return ERR_OK;
    return r->listed && o->picture && !(v->depth_unit_m > 0) && was->picture &&
                   v->width == was->width && v->height == was->height && v->n == was->n &&
                   v->groups == was->groups
               ? ERR_OK
               : err_set(e, ERR_ARG,
                         "render_forward: lists of an earlier frame are for a picture of the same "
                         "size and Gaussians");
}

/* Depths of the splats over their pixels, where sums along rays are wanted. */
static enum err_code render_stage_planes(struct render *r, struct err *e)
{
    size_t local, items = frame_items(r, r->view.groups, &local);
    if (!(r->view.depth_unit_m > 0) || !items)
        return ERR_OK;
    return frame_run(r, r->k.planes, "planes",
                     FRAME_ARGS(FRAME_ARG(r->view_mem), FRAME_ARG(r->drawn_params),
                                FRAME_ARG(r->drawn_list), FRAME_ARG(r->tiles_of.mem),
                                FRAME_ARG(r->splats.mem)),
                     items, local, e);
}

static enum err_code render_stage_blend(struct render *r, struct err *e)
{
    bool wide = r->dev->vector_width == LAYOUT_LANES, moments = r->view.depth_unit_m > 0;
    size_t local = wide ? 1 : LAYOUT_TILE_PIXELS;
    bool shares = r->shares && wide;
    const struct frame_arg counts = FRAME_ARG(r->counts), maps = FRAME_ARG(r->moments.mem),
                           known = FRAME_ARG(r->known.mem), slots = FRAME_ARG(r->slots.mem),
                           slot_of = FRAME_ARG(r->intersection_slot.mem);
    const struct frame_arg args[] = {
        FRAME_ARG(r->view_mem),       FRAME_ARG(r->splats.mem),
        FRAME_ARG(r->tile_start.mem), FRAME_ARG(r->intersection_splat.mem),
        FRAME_ARG(r->color.mem),      FRAME_ARG(r->transmit.mem),
        FRAME_ARG(r->hits.mem),       FRAME_ARG(r->tile_stop.mem),
        wide ? counts : maps,         shares ? slot_of : wide ? maps : known,
        shares ? slots : known};
    size_t n = sizeof args / sizeof *args - (!wide ? 1 : shares || moments ? 0 : 2);
    cl_kernel kernel = shares            ? r->k.blend_shares
                       : wide && moments ? r->k.blend_moments
                                         : r->k.blend;
    return frame_run(r, kernel, "blend", args, n, r->tiles * local, local, e);
}

/* Slots of shares, which blending writes where it draws. */
static enum err_code render_stage_slots(struct render *r, struct err *e)
{
    size_t bytes = (size_t)r->intersections * LAYOUT_IMPORTANCE_SUMS * sizeof(float);
    if (!r->shares || r->dev->vector_width == 1)
        return ERR_OK;
    enum err_code rc = frame_reserve(r, &r->slots, bytes, e);
    return rc ? rc : dev_zero(r->dev, r->slots.mem, 0, bytes, e);
}

/* What the frame gets from the host; render_stage_count waits for it. */
static enum err_code render_hand_over(struct render *r, const struct render_options *o,
                                      struct err *e)
{
    size_t pixels = (size_t)r->view.width * r->view.height;
    enum err_code rc = dev_write_soon(r->dev, r->view_mem, 0, sizeof r->view, &r->view, e);
    if (!rc)
        rc = frame_reserve(r, &r->edge, o->edge ? sizeof o->edge->left : sizeof(float), e);
    if (!rc && o->edge)
        rc = dev_write_soon(r->dev, r->edge.mem, 0, sizeof o->edge->left, o->edge->left, e);
    if (!rc && o->background_where)
        rc = frame_reserve(r, &r->where, pixels, e);
    if (!rc && o->background_where)
        rc = dev_write_soon(r->dev, r->where.mem, 0, pixels, o->background_where, e);
    return !rc && o->known
               ? dev_write_soon(r->dev, r->known.mem, 0, pixels * sizeof(float), o->known, e)
               : rc;
}

/* Another background behind some pixels. */
static enum err_code render_stage_background(struct render *r, const struct render_options *o,
                                             struct err *e)
{
    size_t pixels = (size_t)r->view.width * r->view.height, local = LAYOUT_TILE_PIXELS;
    float more[3];
    if (!o->background_where)
        return ERR_OK;
    for (int c = 0; c < 3; c++)
        more[c] = o->background_there[c] - o->background[c];
    return frame_run(r, r->k.background, "background",
                     FRAME_ARGS(FRAME_ARG(r->view_mem), FRAME_ARG(more[0]), FRAME_ARG(more[1]),
                                FRAME_ARG(more[2]), FRAME_ARG(r->where.mem),
                                FRAME_ARG(r->transmit.mem), FRAME_ARG(r->color.mem)),
                     (pixels + local - 1) / local * local, local, e);
}

/* Planes of the device, [n][h][w], interleaved for the caller; mapping costs nothing on CPUs. */
static enum err_code render_planes_out(struct render *r, cl_mem from, size_t n, float *out,
                                       struct err *e)
{
    size_t pixels = (size_t)r->view.width * r->view.height;
    cl_int code = CL_SUCCESS;
    const float *planes = clEnqueueMapBuffer(r->dev->queue, from, CL_TRUE, CL_MAP_READ, 0,
                                             n * pixels * sizeof(float), 0, NULL, NULL, &code);
    if (code != CL_SUCCESS)
        return err_set(e, ERR_DEVICE, "render_forward: picture: %s", dev_error_name(code));
    enum err_code rc = supersample_reduce(planes, n, r->view.width / r->supersample,
                                          r->view.height / r->supersample, r->supersample,
                                          (double)r->view.kernel_px2, out, e);
    code = clEnqueueUnmapMemObject(r->dev->queue, from, (void *)(uintptr_t)planes, 0, NULL, NULL);
    if (!rc && code != CL_SUCCESS)
        rc = err_set(e, ERR_DEVICE, "render_forward: picture: %s", dev_error_name(code));
    return rc ? rc : dev_finish(r->dev, e);
}

static enum err_code render_frame_output(struct render *r, float *rgb, float *transmittance,
                                         struct err *e)
{
    enum err_code rc = ERR_OK;
    if (transmittance)
        rc = render_planes_out(r, r->transmit.mem, 1, transmittance, e);
    return !rc && rgb ? render_planes_out(r, r->color.mem, 3, rgb, e) : rc;
}

/* The camera that is drawn: the caller's, or finer. */
static enum err_code render_fine_camera(struct render *r, const struct camera *cam,
                                        const struct render_options *o, struct camera *fine,
                                        struct err *e)
{
    uint32_t factor = r->supersample = o->supersample > 1 ? o->supersample : 1;
    enum err_code rc = render_view_check(cam, e);
    *fine = *cam;
    if (!rc && o->depth_unit_m > 0 && (o->orthographic || factor > 1))
        return err_set(e, ERR_ARG,
                       "render_forward: sums along rays are of perspective views, one pixel for "
                       "one");
    if (!rc && o->known &&
        !(o->depth_unit_m > 0 && (float)o->known_zeta > 0.0f && isfinite(o->known_zeta)))
        return err_set(
            e, ERR_ARG,
            "render_forward: known depths need a unit of depth and a known_zeta above 0");
    if (rc || factor == 1)
        return rc;
    if (o->background_where)
        return err_set(e, ERR_ARG,
                       "render_forward: another background behind some pixels is not supersampled");
    if (factor > SUPERSAMPLE_MOST || o->aa == RENDER_AA_NONE)
        return err_set(e, ERR_ARG,
                       "render_forward: supersampling is 1 to %d, of anti-aliased Gaussians",
                       SUPERSAMPLE_MOST);
    if (cam->width_px > RENDER_SIZE_MAX_PX / factor || cam->height_px > RENDER_SIZE_MAX_PX / factor)
        return err_set(e, ERR_ARG,
                       "render_forward: picture of %u x %u: with supersampling %u a side is at "
                       "most %u",
                       cam->width_px, cam->height_px, factor, RENDER_SIZE_MAX_PX / factor);
    *fine = camera_resize(cam, factor * cam->width_px, factor * cam->height_px);
    return ERR_OK;
}

enum err_code render_forward(struct render *r, const struct render_model *m,
                             const struct camera *cam, const struct render_options *o, float *rgb,
                             float *transmittance, struct err *e)
{
    double start = frame_now(r), since = start;
    struct camera fine;
    const struct layout_view was = r->view;
    enum err_code rc = render_fine_camera(r, cam, o, &fine, e);
    r->drawn = false;
    r->frames++;
    r->shares = o->shares;
    memset(&r->stats, 0, sizeof r->stats);
    if (!rc && o->shares && (o->picture || o->depth_unit_m > 0))
        rc = err_set(e, ERR_ARG, "render_forward: shares, and a picture alone or sums along rays");
    if (!rc && o->edge && (!o->picture || !(o->edge->side_m > 0)))
        rc = err_set(e, ERR_ARG, "render_forward: an edge without a side, or not a picture alone");
    if (rc) {
        r->listed = false;
        return rc;
    }
    assert(r->vector_width == r->dev->vector_width);
    assert(m->n <= (size_t)m->groups * LAYOUT_LANES && m->planes == render_model_planes(m));
    render_view_fill(r, m, &fine, o, &r->view);
    r->tiles = r->view.tiles_x * r->view.tiles_y;
    rc = render_lists_check(r, &was, o, e);
    r->listed = false;
    if (!rc)
        rc = render_go(r, e);
    if (!rc)
        rc = render_frame_buffers(r, e);
    if (!rc)
        rc = render_appearance_begin(r, m, o, e);
    if (!rc)
        rc = render_hand_over(r, o, e);
    if (!rc)
        rc = render_stage_project(r, m, e);
    if (!rc)
        rc = frame_clock(r, &since, &r->stats.ms_project, e);
    if (!rc)
        rc = o->list_again ? render_lists_again(r, e) : render_stage_lists(r, &since, e);
    if (!rc)
        rc = render_before_blend(r, e);
    if (!rc)
        rc = render_stage_slots(r, e);
    if (!rc)
        rc = render_stage_planes(r, e);
    if (!rc)
        rc = render_stage_blend(r, e);
    if (!rc)
        rc = render_stage_background(r, o, e);
    if (!rc)
        rc = frame_clock(r, &since, &r->stats.ms_blend, e);
    if (!rc)
        rc = render_frame_output(r, rgb, transmittance, e);
    if (rc)
        dev_abandon(r->dev, &r->counting);
    r->drawn = r->listed = !rc;
    r->stats.ms_total = (frame_now(r) - start) * 1e3;
    return rc;
}

/* ---- what the last frame left ---- */

enum err_code render_transmittance(struct render *r, float *out, struct err *e)
{
    if (!r->drawn)
        return err_set(e, ERR_ARG, "render_transmittance: no frame was drawn");
    return render_planes_out(r, r->transmit.mem, 1, out, e);
}

const struct render_stats *render_last_stats(const struct render *r)
{
    return &r->stats;
}

uint64_t render_frames(const struct render *r)
{
    return r->frames;
}

enum err_code render_depth_quantile(struct render *r, double share, double *depth_m, struct err *e)
{
    const cl_uint n = r->counted.visible;
    cl_uint id = 0;
    float depth = INFINITY; /* its bits are the key */
    if (!r->drawn || r->view.again)
        return err_set(e, ERR_ARG, "render_depth_quantile: no frame with lists of its own");
    size_t at = (size_t)(share * n);
    enum err_code rc = ERR_OK;
    if (n)
        rc = dev_read(r->dev, r->ids[0].mem, (at < n ? at : n - 1) * sizeof id, sizeof id, &id, e);
    if (!rc && n)
        rc = dev_read(r->dev, r->depth_key.mem, id * sizeof depth, sizeof depth, &depth, e);
    *depth_m = (double)depth;
    return rc;
}

void render_set_timing(struct render *r, bool on)
{
    r->timing = on;
}

cl_mem render_color_buffer(struct render *r)
{
    return r->color.mem;
}

cl_mem render_transmittance_buffer(struct render *r)
{
    return r->transmit.mem;
}

cl_mem render_moments_buffer(struct render *r)
{
    return r->view.depth_unit_m > 0 ? r->moments.mem : NULL;
}

cl_mem render_known_buffer(struct render *r)
{
    return r->view.known_zeta > 0 ? r->known.mem : NULL;
}
