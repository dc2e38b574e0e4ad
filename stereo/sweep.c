/* The plane sweep on the device. Owns its kernels and buffers.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "stereo/sweep.h"

#include <stdio.h>
#include <string.h>

#include "core/base.h"
#include "core/dev.h"

extern const char vector_cl[], sweep_cl[];

enum {
    SWEEP_TILE_W = 64, /* as in sweep.cl */
    SWEEP_TILE_H = 32,
    SWEEP_SLAB = 16,  /* planes of a work-item */
    SWEEP_ROUND = 32, /* planes are padded to a multiple */
    SWEEP_KERNELS = 4
};
enum sweep_buffer {
    SWEEP_REF,
    SWEEP_NEAR,
    SWEEP_SIZES,
    SWEEP_HOMOGRAPHY,
    SWEEP_COST,
    SWEEP_TURNED,
    SWEEP_SUM,
    SWEEP_PLANE,
    SWEEP_SCORE,
    SWEEP_BUFFERS
};

struct sweep {
    struct dev *dev; /* borrowed */
    bool wide;       /* the shape of the kernels: VW 16 */
    cl_program program;
    cl_kernel cost, turn, path, pick;
    uint32_t planes; /* padded */
    cl_mem buffer[SWEEP_BUFFERS];
    size_t bytes[SWEEP_BUFFERS];
};

void sweep_close(struct sweep **p)
{
    struct sweep *s = *p;
    if (!s)
        return;
    cl_kernel kernels[SWEEP_KERNELS] = {s->cost, s->turn, s->path, s->pick};
    for (int i = 0; i < SWEEP_KERNELS; i++)
        if (kernels[i])
            clReleaseKernel(kernels[i]);
    if (s->program)
        clReleaseProgram(s->program);
    for (int i = 0; i < SWEEP_BUFFERS; i++)
        dev_release(&s->buffer[i]);
    mem_free(s);
    *p = NULL;
}

static enum err_code sweep_build(struct sweep *s, struct err *e)
{
    const struct dev_source sources[] = {{"core/vector.cl", vector_cl},
                                         {"stereo/sweep.cl", sweep_cl}};
    char flags[256];
    snprintf(flags, sizeof flags,
             "-DPLANES=%u -DRADIUS=%d -DSLAB=%d -DCOST_MOST=%d.0f -DSTEP_COST=%d "
             "-DNOISE=%.9ef -DLIKE=%.9ef",
             s->planes, SWEEP_RADIUS, SWEEP_SLAB, SWEEP_COST_MOST, SWEEP_STEP_COST, SWEEP_NOISE,
             SWEEP_LIKE);
    enum err_code rc = dev_build(s->dev, sources, 2, flags, &s->program, e);
    if (!rc)
        rc = dev_kernel(s->program, "sweep_cost", &s->cost, e);
    if (!rc)
        rc = dev_kernel(s->program, "sweep_turn", &s->turn, e);
    if (!rc)
        rc = dev_kernel(s->program, "sweep_path", &s->path, e);
    return rc ? rc : dev_kernel(s->program, "sweep_pick", &s->pick, e);
}

enum err_code sweep_open(struct dev *dev, uint32_t planes, struct sweep **out, struct err *e)
{
    *out = NULL;
    if (planes < 2 || planes > SWEEP_PLANES_MAX)
        return err_set(e, ERR_ARG, "sweep: %u planes: 2 to %d", planes, SWEEP_PLANES_MAX);
    struct sweep *s = mem_array(1, sizeof *s);
    if (!s)
        return err_set(e, ERR_MEM, "sweep: out of memory");
    s->dev = dev;
    s->wide = dev->vector_width > 1;
    s->planes = (planes + SWEEP_ROUND - 1) / SWEEP_ROUND * SWEEP_ROUND;
    enum err_code rc = sweep_build(s, e);
    if (rc)
        sweep_close(&s);
    *out = s;
    return rc;
}

static enum err_code sweep_reserve(struct sweep *s, enum sweep_buffer which, size_t bytes,
                                   struct err *e)
{
    if (bytes <= s->bytes[which])
        return ERR_OK;
    dev_release(&s->buffer[which]);
    s->bytes[which] = 0;
    enum err_code rc = dev_buffer(s->dev, bytes, NULL, &s->buffer[which], e);
    s->bytes[which] = rc ? 0 : bytes;
    return rc;
}

void sweep_homography(const struct sweep_input *in, size_t k, double z_m, double out[9])
{
    const struct camera *r = &in->ref.cam, *n = &in->near[k].cam;
    double c[3], ray[9], kr[9], e3[3], b[9];
    camera_center(r, c);
    for (int i = 0; i < 3; i++) { /* ray = R^T K^-1 */
        ray[3 * i] = r->rot[i] / r->fx_px;
        ray[3 * i + 1] = r->rot[3 + i] / r->fy_px;
        ray[3 * i + 2] = r->rot[6 + i] - ray[3 * i] * r->cx_px - ray[3 * i + 1] * r->cy_px;
    }
    for (int j = 0; j < 3; j++) { /* kr = K_k R_k */
        kr[j] = n->fx_px * n->rot[j] + n->cx_px * n->rot[6 + j];
        kr[3 + j] = n->fy_px * n->rot[3 + j] + n->cy_px * n->rot[6 + j];
        kr[6 + j] = n->rot[6 + j];
    }
    const double kt[3] = {n->fx_px * n->trans[0] + n->cx_px * n->trans[2],
                          n->fy_px * n->trans[1] + n->cy_px * n->trans[2], n->trans[2]};
    for (int i = 0; i < 3; i++) {
        e3[i] = kt[i];
        for (int j = 0; j < 3; j++)
            e3[i] += kr[3 * i + j] * c[j];
        for (int j = 0; j < 3; j++)
            b[3 * i + j] =
                kr[3 * i] * ray[j] + kr[3 * i + 1] * ray[3 + j] + kr[3 * i + 2] * ray[6 + j];
    }
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out[3 * i + j] = -(e3[i] * ray[6 + j] + (z_m - c[2]) * b[3 * i + j]);
}

/* A pixel, its right neighbour and the two below in one word, for bilinear sampling. The last row
 * and column are never first of four. */
static void sweep_quads(const struct sweep_view *v, cl_uint *out)
{
    size_t w = v->cam.width_px, h = v->cam.height_px;
    for (size_t y = 0; y < h; y++)
        for (size_t x = 0; x < w; x++) {
            size_t x1 = x + 1 < w ? x + 1 : x, y1 = y + 1 < h ? y + 1 : y;
            out[y * w + x] = (cl_uint)v->grey[y * w + x] | (cl_uint)v->grey[y * w + x1] << 8 |
                             (cl_uint)v->grey[y1 * w + x] << 16 |
                             (cl_uint)v->grey[y1 * w + x1] << 24;
        }
}

static enum err_code sweep_upload_near(struct sweep *s, const struct sweep_input *in, struct err *e)
{
    cl_uint sizes[SWEEP_NEAR_MAX][3];
    size_t pixels = 0;
    for (size_t k = 0; k < in->n_near; k++) {
        sizes[k][0] = in->near[k].cam.width_px;
        sizes[k][1] = in->near[k].cam.height_px;
        sizes[k][2] = (cl_uint)pixels;
        pixels += (size_t)sizes[k][0] * sizes[k][1];
    }
    cl_uint *quads = mem_array(pixels, sizeof *quads);
    if (!quads)
        return err_set(e, ERR_MEM, "sweep: out of memory");
    for (size_t k = 0; k < in->n_near; k++)
        sweep_quads(&in->near[k], quads + sizes[k][2]);
    enum err_code rc = sweep_reserve(s, SWEEP_NEAR, pixels * sizeof *quads, e);
    if (!rc)
        rc = sweep_reserve(s, SWEEP_SIZES, sizeof sizes, e);
    if (!rc)
        rc = dev_write(s->dev, s->buffer[SWEEP_NEAR], 0, pixels * sizeof *quads, quads, e);
    if (!rc)
        rc = dev_write(s->dev, s->buffer[SWEEP_SIZES], 0, in->n_near * sizeof *sizes, sizes, e);
    mem_free(quads);
    return rc;
}

static enum err_code sweep_upload(struct sweep *s, const struct sweep_input *in, struct err *e)
{
    size_t pixels = (size_t)in->ref.cam.width_px * in->ref.cam.height_px;
    size_t maps = (size_t)in->planes * in->n_near * 9;
    float *h = mem_array(maps, sizeof *h);
    if (!h)
        return err_set(e, ERR_MEM, "sweep: out of memory");
    for (uint32_t p = 0; p < in->planes; p++)
        for (size_t k = 0; k < in->n_near; k++) {
            double one[9];
            sweep_homography(in, k, in->low_m + in->step_m * p, one);
            for (int i = 0; i < 9; i++)
                h[(p * in->n_near + k) * 9 + (size_t)i] = (float)one[i];
        }
    enum err_code rc = sweep_upload_near(s, in, e);
    if (!rc)
        rc = sweep_reserve(s, SWEEP_REF, pixels, e);
    if (!rc)
        rc = sweep_reserve(s, SWEEP_HOMOGRAPHY, maps * sizeof *h, e);
    if (!rc)
        rc = dev_write(s->dev, s->buffer[SWEEP_REF], 0, pixels, in->ref.grey, e);
    if (!rc)
        rc = dev_write(s->dev, s->buffer[SWEEP_HOMOGRAPHY], 0, maps * sizeof *h, h, e);
    mem_free(h);
    return rc;
}

static enum err_code sweep_costs(struct sweep *s, const struct sweep_input *in, struct err *e)
{
    cl_uint w = in->ref.cam.width_px, h = in->ref.cam.height_px, near = (cl_uint)in->n_near,
            best = near > 4   ? 3
                   : near > 1 ? 2
                              : 1,
            planes = in->planes;
    size_t tiles = (size_t)((w + SWEEP_TILE_W - 1) / SWEEP_TILE_W) *
                   ((h + SWEEP_TILE_H - 1) / SWEEP_TILE_H),
           slabs = (planes + SWEEP_SLAB - 1) / SWEEP_SLAB, pixels = (size_t)w * h;
    cl_int bad = dev_arg(s->cost, 0, s->buffer[SWEEP_REF]);
    bad |= dev_arg(s->cost, 1, s->buffer[SWEEP_NEAR]);
    bad |= dev_arg(s->cost, 2, s->buffer[SWEEP_SIZES]);
    bad |= dev_arg(s->cost, 3, s->buffer[SWEEP_HOMOGRAPHY]);
    bad |= dev_arg(s->cost, 4, near);
    bad |= dev_arg(s->cost, 5, best);
    bad |= dev_arg(s->cost, 6, planes);
    bad |= dev_arg(s->cost, 7, w);
    bad |= dev_arg(s->cost, 8, h);
    bad |= dev_arg(s->cost, 9, s->buffer[SWEEP_COST]);
    bad |= dev_arg(s->turn, 0, s->buffer[SWEEP_COST]);
    bad |= dev_arg(s->turn, 1, planes);
    bad |= dev_arg(s->turn, 2, w);
    bad |= dev_arg(s->turn, 3, h);
    bad |= dev_arg(s->turn, 4, s->buffer[SWEEP_TURNED]);
    if (bad != CL_SUCCESS)
        return err_set(e, ERR_DEVICE, "sweep: arguments: %s", dev_error_name(bad));
    size_t local = dev_local(s->dev);
    enum err_code rc =
        dev_run(s->dev, s->cost, "sweep_cost", s->wide ? tiles * slabs : pixels * planes, local, e);
    return rc ? rc : dev_run(s->dev, s->turn, "sweep_turn", s->wide ? h : pixels, local, e);
}

/* One of four directions: rows and columns, forward and back. */
static enum err_code sweep_path(struct sweep *s, uint32_t w, uint32_t h, int direction,
                                struct err *e)
{
    bool column = direction & 1, back = direction & 2;
    cl_uint lines = column ? w : h, count = column ? h : w, low = SWEEP_JUMP_LOW,
            high = SWEEP_JUMP_HIGH;
    cl_int next = column ? (cl_int)w : 1, line_step = column ? 1 : (cl_int)w;
    cl_int first = back ? next * ((cl_int)count - 1) : 0, step = back ? -next : next;
    cl_float edge = (cl_float)SWEEP_EDGE;
    cl_int bad = dev_arg(s->path, 0, s->buffer[SWEEP_TURNED]);
    bad |= dev_arg(s->path, 1, s->buffer[SWEEP_REF]);
    bad |= dev_arg(s->path, 2, lines);
    bad |= dev_arg(s->path, 3, first);
    bad |= dev_arg(s->path, 4, line_step);
    bad |= dev_arg(s->path, 5, step);
    bad |= dev_arg(s->path, 6, count);
    bad |= dev_arg(s->path, 7, low);
    bad |= dev_arg(s->path, 8, high);
    bad |= dev_arg(s->path, 9, edge);
    bad |= dev_arg(s->path, 10, s->buffer[SWEEP_SUM]);
    if (bad != CL_SUCCESS)
        return err_set(e, ERR_DEVICE, "sweep: arguments: %s", dev_error_name(bad));
    size_t items = s->wide ? 1 : s->planes; /* of a line */
    return dev_run(s->dev, s->path, "sweep_path", lines * items, items, e);
}

static enum err_code sweep_pick(struct sweep *s, const struct sweep_input *in, struct err *e)
{
    cl_uint w = in->ref.cam.width_px, h = in->ref.cam.height_px, planes = in->planes;
    cl_int bad = dev_arg(s->pick, 0, s->buffer[SWEEP_TURNED]);
    bad |= dev_arg(s->pick, 1, s->buffer[SWEEP_SUM]);
    bad |= dev_arg(s->pick, 2, planes);
    bad |= dev_arg(s->pick, 3, w);
    bad |= dev_arg(s->pick, 4, h);
    bad |= dev_arg(s->pick, 5, s->buffer[SWEEP_PLANE]);
    bad |= dev_arg(s->pick, 6, s->buffer[SWEEP_SCORE]);
    if (bad != CL_SUCCESS)
        return err_set(e, ERR_DEVICE, "sweep: arguments: %s", dev_error_name(bad));
    size_t items = s->wide ? h : (size_t)w * h;
    return dev_run(s->dev, s->pick, "sweep_pick", items, dev_local(s->dev), e);
}

enum err_code sweep_run(struct sweep *s, const struct sweep_input *in, float *plane, float *score,
                        struct err *e)
{
    size_t pixels = (size_t)in->ref.cam.width_px * in->ref.cam.height_px;
    static const enum sweep_buffer rooms[] = {SWEEP_COST, SWEEP_TURNED, SWEEP_SUM, SWEEP_PLANE,
                                              SWEEP_SCORE};
    const size_t bytes[] = {pixels * in->planes, pixels * s->planes,
                            pixels * s->planes * sizeof(cl_ushort), pixels * sizeof(float),
                            pixels * sizeof(float)};
    if (!in->n_near || in->n_near > SWEEP_NEAR_MAX || in->planes < 2 || in->planes > s->planes)
        return err_set(e, ERR_ARG, "sweep: %zu neighbours, %u planes: 1 to %d, 2 to %u", in->n_near,
                       in->planes, SWEEP_NEAR_MAX, s->planes);
    enum err_code rc = sweep_upload(s, in, e);
    for (size_t i = 0; !rc && i < sizeof rooms / sizeof *rooms; i++)
        rc = sweep_reserve(s, rooms[i], bytes[i], e);
    if (!rc)
        rc = sweep_costs(s, in, e);
    if (!rc)
        rc = dev_zero(s->dev, s->buffer[SWEEP_SUM], 0, bytes[2], e);
    for (int d = 0; !rc && d < 4; d++)
        rc = sweep_path(s, in->ref.cam.width_px, in->ref.cam.height_px, d, e);
    if (!rc)
        rc = sweep_pick(s, in, e);
    if (!rc)
        rc = dev_read(s->dev, s->buffer[SWEEP_PLANE], 0, pixels * sizeof *plane, plane, e);
    return rc ? rc : dev_read(s->dev, s->buffer[SWEEP_SCORE], 0, pixels * sizeof *score, score, e);
}
