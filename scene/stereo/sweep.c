/* The plane sweep on the device. Owns its kernels and buffers.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/stereo/sweep.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/base.h"
#include "core/device/dev.h"

extern const char vector_cl[], sweep_cl[];

enum {
    SWEEP_SLAB = 16,  /* planes of a work-item */
    SWEEP_ROUND = 32, /* planes are padded to a multiple */
    SWEEP_KERNELS = 4,
    SWEEP_TILE = 5 /* numbers a tile of upright planes, as in sweep.cl */
};
enum sweep_buffer {
    SWEEP_REF,
    SWEEP_NEAR,
    SWEEP_SIZES,
    SWEEP_HOMOGRAPHY,
    SWEEP_UPRIGHT, /* homographies of upright planes */
    SWEEP_TILES,
    SWEEP_COST,
    SWEEP_WALLS, /* costs of upright planes */
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
    const struct dev_source sources[] = {{"core/device/vector.cl", vector_cl},
                                         {"scene/stereo/sweep.cl", sweep_cl}};
    char flags[256];
    snprintf(flags, sizeof flags,
             "-DPLANES=%u -DRADIUS=%d -DSLAB=%d -DCOST_MOST=%d.0f -DSTEP_COST=%d "
             "-DNOISE=%.9ef -DLIKE=%.9ef -DTILE_W=%d -DTILE_H=%d -DWALL_MORE=%d -DWALL_COST=%d "
             "-DWALL_EVERY=%d.0f -DDOWN=%.9ef",
             s->planes, SWEEP_RADIUS, SWEEP_SLAB, SWEEP_COST_MOST, SWEEP_STEP_COST, SWEEP_NOISE,
             SWEEP_LIKE, SWEEP_TILE_W, SWEEP_TILE_H, SWEEP_WALL_MORE, SWEEP_WALL_COST,
             SWEEP_WALL_EVERY, SWEEP_DOWN);
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

/* M = R^T K^-1, row-major */
static void sweep_rays(const struct camera *r, double out[9])
{
    for (int i = 0; i < 3; i++) {
        out[3 * i] = r->rot[i] / r->fx_px;
        out[3 * i + 1] = r->rot[3 + i] / r->fy_px;
        out[3 * i + 2] = r->rot[6 + i] - out[3 * i] * r->cx_px - out[3 * i + 1] * r->cy_px;
    }
}

void sweep_ray(const struct sweep_input *in, double x, double y, double out[3])
{
    double m[9];
    sweep_rays(&in->ref.cam, m);
    for (int i = 0; i < 3; i++)
        out[i] = m[3 * i] * x + m[3 * i + 1] * y + m[3 * i + 2];
}

void sweep_homography(const struct sweep_input *in, size_t k, const struct sweep_plane *plane,
                      double out[9])
{
    const struct camera *n = &in->near[k].cam;
    double c[3], ray[9], kr[9], away[3], far_m = plane->at_m;
    camera_center(&in->ref.cam, c);
    sweep_rays(&in->ref.cam, ray);
    for (int j = 0; j < 3; j++) { /* kr = K_k R_k, away = n^T M, far = s - n^T c */
        kr[j] = n->fx_px * n->rot[j] + n->cx_px * n->rot[6 + j];
        kr[3 + j] = n->fy_px * n->rot[3 + j] + n->cy_px * n->rot[6 + j];
        kr[6 + j] = n->rot[6 + j];
        away[j] = plane->normal[0] * ray[j] + plane->normal[1] * ray[3 + j] +
                  plane->normal[2] * ray[6 + j];
        far_m -= plane->normal[j] * c[j];
    }
    const double kt[3] = {n->fx_px * n->trans[0] + n->cx_px * n->trans[2],
                          n->fy_px * n->trans[1] + n->cy_px * n->trans[2], n->trans[2]};
    for (int i = 0; i < 3; i++) {
        double eye = kt[i];
        for (int j = 0; j < 3; j++)
            eye += kr[3 * i + j] * c[j];
        for (int j = 0; j < 3; j++)
            out[3 * i + j] =
                eye * away[j] + far_m * (kr[3 * i] * ray[j] + kr[3 * i + 1] * ray[3 + j] +
                                         kr[3 * i + 2] * ray[6 + j]);
    }
}

struct sweep_plane sweep_level(double z_m)
{
    return (struct sweep_plane){{0.0, 0.0, -1.0}, -z_m};
}

/* The planes in which a pixel's heights lie. False: it does not look down, or not at the wall. */
static bool sweep_wall_span(const struct sweep_input *in, const struct sweep_wall *w, double x,
                            double y, double *low, double *high)
{
    double d[3], c[3];
    sweep_ray(in, x, y, d);
    camera_center(&in->ref.cam, c);
    double scale = (w->direction[0] * d[0] + w->direction[1] * d[1]) / d[2] / w->rho,
           from = (c[2] - in->low_m) / in->step_m * (1.0 - scale);
    *low = fmin(*low, from / SWEEP_WALL_EVERY);
    *high = fmax(*high, (from + scale * (in->planes - 1.0)) / SWEEP_WALL_EVERY);
    return d[2] < -SWEEP_DOWN && scale > 0.0;
}

bool sweep_wall(const struct sweep_input *in, uint32_t x0, uint32_t y0, struct sweep_wall *out)
{
    const int least = -SWEEP_WALL_MORE, most = (int)sweep_upright_planes(in) - SWEEP_WALL_MORE;
    uint32_t x1 = x0 + SWEEP_TILE_W, y1 = y0 + SWEEP_TILE_H;
    double d[3], low = (double)INFINITY, high = -low;
    sweep_ray(in, 0.5 * (x0 + x1), 0.5 * (y0 + y1), d);
    double flat = hypot(d[0], d[1]);
    *out = (struct sweep_wall){{d[0] / flat, d[1] / flat}, flat / d[2], least, most};
    if (!in->walls || !(d[2] < -SWEEP_DOWN) || !(out->rho < -SWEEP_WALL_SLOPE))
        return false;
    bool all = true; /* scale is a ratio of linear functions: its extremes lie at the corners */
    for (int k = 0; k < 4; k++)
        all &= sweep_wall_span(in, out, k % 2 ? x1 : x0, k / 2 ? y1 : y0, &low, &high);
    if (all) {
        out->first = (int)fmax(floor(low), least);
        out->end = (int)fmin(floor(high) + 2.0, most);
    }
    return out->first < out->end;
}

struct sweep_plane sweep_upright(const struct sweep_input *in, const struct sweep_wall *w, int q)
{
    double c[3];
    camera_center(&in->ref.cam, c);
    double far_m = (in->low_m + in->step_m * SWEEP_WALL_EVERY * q - c[2]) * w->rho;
    return (struct sweep_plane){{w->direction[0], w->direction[1], 0.0},
                                w->direction[0] * c[0] + w->direction[1] * c[1] + far_m};
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

/* The maps to all neighbours, row-major, as floats. */
static void sweep_maps(const struct sweep_input *in, const struct sweep_plane *plane, float *out)
{
    for (size_t k = 0; k < in->n_near; k++) {
        double one[9];
        sweep_homography(in, k, plane, one);
        for (int i = 0; i < 9; i++)
            out[9 * k + (size_t)i] = (float)one[i];
    }
}

static enum err_code sweep_send(struct sweep *s, enum sweep_buffer which, const void *from,
                                size_t bytes, struct err *e)
{
    enum err_code rc = sweep_reserve(s, which, bytes, e);
    return rc ? rc : dev_write(s->dev, s->buffer[which], 0, bytes, from, e);
}

static enum err_code sweep_upload(struct sweep *s, const struct sweep_input *in, struct err *e)
{
    size_t pixels = (size_t)in->ref.cam.width_px * in->ref.cam.height_px;
    size_t maps = (size_t)in->planes * in->n_near * 9;
    float *h = mem_array(maps, sizeof *h);
    if (!h)
        return err_set(e, ERR_MEM, "sweep: out of memory");
    for (uint32_t p = 0; p < in->planes; p++) {
        struct sweep_plane level = sweep_level(in->low_m + in->step_m * p);
        sweep_maps(in, &level, h + p * in->n_near * 9);
    }
    enum err_code rc = sweep_upload_near(s, in, e);
    if (!rc)
        rc = sweep_send(s, SWEEP_REF, in->ref.grey, pixels, e);
    if (!rc)
        rc = sweep_send(s, SWEEP_HOMOGRAPHY, h, maps * sizeof *h, e);
    mem_free(h);
    return rc;
}

static size_t sweep_across(const struct sweep_input *in)
{
    return (in->ref.cam.width_px + SWEEP_TILE_W - 1) / SWEEP_TILE_W;
}

static size_t sweep_tiles(const struct sweep_input *in)
{
    return sweep_across(in) * ((in->ref.cam.height_px + SWEEP_TILE_H - 1) / SWEEP_TILE_H);
}

/* Maps of upright planes, and of each tile the direction, 1 / rho, and which planes it has. */
static enum err_code sweep_upload_walls(struct sweep *s, const struct sweep_input *in,
                                        struct err *e)
{
    size_t tiles = sweep_tiles(in), across = sweep_across(in), each = in->n_near * 9,
           all = sweep_upright_planes(in) * each;
    float *h = mem_array(tiles * all, sizeof *h), *t = mem_array(tiles * SWEEP_TILE, sizeof *t);
    enum err_code rc = h && t ? ERR_OK : err_set(e, ERR_MEM, "sweep: out of memory");
    for (size_t i = 0; !rc && i < tiles; i++) {
        struct sweep_wall w;
        if (!sweep_wall(in, (uint32_t)(i % across) * SWEEP_TILE_W,
                        (uint32_t)(i / across) * SWEEP_TILE_H, &w))
            continue; /* it has no planes */
        const double tile[SWEEP_TILE] = {w.direction[0], w.direction[1], 1.0 / w.rho,
                                         w.first + SWEEP_WALL_MORE, w.end + SWEEP_WALL_MORE};
        for (int k = 0; k < SWEEP_TILE; k++)
            t[SWEEP_TILE * i + (size_t)k] = (float)tile[k];
        for (int p = w.first; p < w.end; p++) {
            struct sweep_plane up = sweep_upright(in, &w, p);
            sweep_maps(in, &up, h + i * all + (size_t)(p + SWEEP_WALL_MORE) * each);
        }
    }
    if (!rc)
        rc = sweep_send(s, SWEEP_UPRIGHT, h, tiles * all * sizeof *h, e);
    if (!rc)
        rc = sweep_send(s, SWEEP_TILES, t, tiles * SWEEP_TILE * sizeof *t, e);
    mem_free(h);
    mem_free(t);
    return rc;
}

/* Costs of level planes, or of upright ones. */
static enum err_code sweep_cost(struct sweep *s, const struct sweep_input *in, bool upright,
                                struct err *e)
{
    cl_uint w = in->ref.cam.width_px, h = in->ref.cam.height_px, near = (cl_uint)in->n_near,
            best = near > 4   ? 3
                   : near > 1 ? 2
                              : 1,
            planes = upright ? (cl_uint)sweep_upright_planes(in) : in->planes,
            each = upright ? planes * near * 9 : 0;
    size_t slabs = (planes + SWEEP_SLAB - 1) / SWEEP_SLAB, pixels = (size_t)w * h;
    cl_int bad = dev_arg(s->cost, 0, s->buffer[SWEEP_REF]);
    bad |= dev_arg(s->cost, 1, s->buffer[SWEEP_NEAR]);
    bad |= dev_arg(s->cost, 2, s->buffer[SWEEP_SIZES]);
    bad |= dev_arg(s->cost, 3, s->buffer[upright ? SWEEP_UPRIGHT : SWEEP_HOMOGRAPHY]);
    bad |= dev_arg(s->cost, 4, each);
    bad |= dev_arg(s->cost, 5, s->buffer[upright ? SWEEP_TILES : SWEEP_HOMOGRAPHY]);
    bad |= dev_arg(s->cost, 6, near);
    bad |= dev_arg(s->cost, 7, best);
    bad |= dev_arg(s->cost, 8, planes);
    bad |= dev_arg(s->cost, 9, w);
    bad |= dev_arg(s->cost, 10, h);
    bad |= dev_arg(s->cost, 11, s->buffer[upright ? SWEEP_WALLS : SWEEP_COST]);
    if (bad != CL_SUCCESS)
        return err_set(e, ERR_DEVICE, "sweep: arguments: %s", dev_error_name(bad));
    return dev_run(s->dev, s->cost, "sweep_cost",
                   s->wide ? sweep_tiles(in) * slabs : pixels * planes, dev_local(s->dev), e);
}

/* The lesser cost of both, planes of a pixel side by side. */
static enum err_code sweep_turn(struct sweep *s, const struct sweep_input *in, struct err *e)
{
    cl_uint w = in->ref.cam.width_px, h = in->ref.cam.height_px, planes = in->planes,
            upright = in->walls ? (cl_uint)sweep_upright_planes(in) : 0;
    struct {
        cl_float m[9], from; /* from: (c_z - low) / step */
    } rays;
    double m[9], c[3];
    sweep_rays(&in->ref.cam, m);
    camera_center(&in->ref.cam, c);
    for (int i = 0; i < 9; i++)
        rays.m[i] = (cl_float)m[i];
    rays.from = (cl_float)((c[2] - in->low_m) / in->step_m);
    /* without walls these two are not read */
    cl_mem walls = s->buffer[in->walls ? SWEEP_WALLS : SWEEP_COST],
           tiles = s->buffer[in->walls ? SWEEP_TILES : SWEEP_COST];
    cl_int bad = dev_arg(s->turn, 0, s->buffer[SWEEP_COST]);
    bad |= dev_arg(s->turn, 1, walls);
    bad |= dev_arg(s->turn, 2, tiles);
    bad |= dev_arg(s->turn, 3, rays);
    bad |= dev_arg(s->turn, 4, upright);
    bad |= dev_arg(s->turn, 5, planes);
    bad |= dev_arg(s->turn, 6, w);
    bad |= dev_arg(s->turn, 7, h);
    bad |= dev_arg(s->turn, 8, s->buffer[SWEEP_TURNED]);
    if (bad != CL_SUCCESS)
        return err_set(e, ERR_DEVICE, "sweep: arguments: %s", dev_error_name(bad));
    return dev_run(s->dev, s->turn, "sweep_turn", s->wide ? h : (size_t)w * h, dev_local(s->dev),
                   e);
}

static enum err_code sweep_costs(struct sweep *s, const struct sweep_input *in, struct err *e)
{
    enum err_code rc = sweep_cost(s, in, false, e);
    if (!rc && in->walls)
        rc = sweep_upload_walls(s, in, e);
    if (!rc && in->walls)
        rc = sweep_cost(s, in, true, e);
    return rc ? rc : sweep_turn(s, in, e);
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
    static const enum sweep_buffer rooms[] = {SWEEP_COST,  SWEEP_TURNED, SWEEP_SUM,
                                              SWEEP_PLANE, SWEEP_SCORE,  SWEEP_WALLS};
    const size_t bytes[] = {pixels * in->planes,
                            pixels * s->planes,
                            pixels * s->planes * sizeof(cl_ushort),
                            pixels * sizeof(float),
                            pixels * sizeof(float),
                            in->walls ? pixels * sweep_upright_planes(in) : 0};
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
