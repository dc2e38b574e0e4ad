/* Sort and tile lists on GPUs: the launches of order_gpu.cl.
 *
 * Depth order ends in ids[0], and the lists in tile_start, intersection_splat and
 * intersection_slot, as with sort.cl and bin.cl. Unlike there, keys[0] holds depth keys; no later
 * stage reads it. The state belongs to struct render and grows with it. Passes over tiles end at
 * the highest bit of a tile number.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <string.h>

#include "core/base.h"
#include "render/frame.h"

extern const char order_gpu_cl[];

enum { DEPTH_PASSES = 7 };
static_assert(DEPTH_PASSES * LAYOUT_ORDER_BITS >= 31, "positive floats have no sign to sort by");
static_assert(DEPTH_PASSES % 2 == 1, "the last pass writes ids[0]");

struct order_gpu {
    struct dev *dev; /* borrowed */
    cl_program program;
    cl_kernel sum_blocks, sum_scan, sum_apply, radix_count, radix_scatter, bin_expand, bin_gather;
    struct frame_buffer sums;  /* uint [blocks], [digits][blocks] */
    struct frame_buffer first; /* uint [lanes]: intersections before a splat, in depth order */
    struct frame_buffer tile;  /* uint [intersections]: the other side of expanded_tile */
    /* uint [intersections]: in the order of tiles, which of the expanded ones it is */
    struct frame_buffer expanded_at[2];
};

static size_t order_blocks(uint64_t n)
{
    return n ? (size_t)((n + LAYOUT_ORDER_BLOCK - 1) / LAYOUT_ORDER_BLOCK) : 1;
}

enum err_code order_gpu_open(struct dev *dev, struct order_gpu **out, struct err *e)
{
    struct order_gpu *o = mem_array(1, sizeof *o);
    *out = NULL;
    if (!o)
        return err_set(e, ERR_MEM, "render_open");
    o->dev = dev;
    const struct dev_source source = {"render/order_gpu.cl", order_gpu_cl};
    struct {
        const char *name;
        cl_kernel *to;
    } kernels[] = {{"sum_blocks", &o->sum_blocks},       {"sum_scan", &o->sum_scan},
                   {"sum_apply", &o->sum_apply},         {"radix_count", &o->radix_count},
                   {"radix_scatter", &o->radix_scatter}, {"bin_expand", &o->bin_expand},
                   {"bin_gather", &o->bin_gather}};
    enum err_code rc = dev_build(dev, &source, 1, NULL, &o->program, e);
    for (size_t i = 0; !rc && i < sizeof kernels / sizeof *kernels; i++)
        rc = dev_kernel(o->program, kernels[i].name, kernels[i].to, e);
    if (!rc)
        *out = o;
    else
        order_gpu_close(&o);
    return rc;
}

void order_gpu_close(struct order_gpu **op)
{
    struct order_gpu *o = *op;
    if (!o)
        return;
    cl_kernel kernels[] = {o->sum_blocks,    o->sum_scan,   o->sum_apply, o->radix_count,
                           o->radix_scatter, o->bin_expand, o->bin_gather};
    struct frame_buffer *buffers[] = {&o->sums, &o->first, &o->tile, &o->expanded_at[0],
                                      &o->expanded_at[1]};
    for (size_t i = 0; i < sizeof kernels / sizeof *kernels; i++)
        if (kernels[i])
            clReleaseKernel(kernels[i]);
    for (size_t i = 0; i < sizeof buffers / sizeof *buffers; i++)
        dev_release(&buffers[i]->mem);
    if (o->program)
        clReleaseProgram(o->program);
    mem_free(o);
    *op = NULL;
}

static enum err_code order_scan(struct render *r, cl_uint n, cl_uint total_is, struct err *e)
{
    struct order_gpu *o = r->order_gpu;
    return frame_run(
        r, o->sum_scan, "sum_scan",
        FRAME_ARGS(FRAME_ARG(n), FRAME_ARG(total_is), FRAME_ARG(o->sums.mem), FRAME_ARG(r->counts)),
        LAYOUT_ORDER_ITEMS, LAYOUT_ORDER_ITEMS, e);
}

/* out[i] = sum of tiles_of before i; `ordered`: of the visible ones in depth order. */
static enum err_code order_sums(struct render *r, cl_uint ordered, cl_mem out, struct err *e)
{
    struct order_gpu *o = r->order_gpu;
    cl_uint n = r->view.n, blocks = (cl_uint)order_blocks(n);
    size_t items = (size_t)blocks * LAYOUT_ORDER_ITEMS;
    enum err_code rc = frame_run(r, o->sum_blocks, "sum_blocks",
                                 FRAME_ARGS(FRAME_ARG(r->tiles_of.mem), FRAME_ARG(r->ids[0].mem),
                                            FRAME_ARG(ordered), FRAME_ARG(n), FRAME_ARG(r->counts),
                                            FRAME_ARG(o->sums.mem)),
                                 items, LAYOUT_ORDER_ITEMS, e);
    if (!rc)
        rc = order_scan(r, blocks, ordered ? 0 : LAYOUT_TOTAL_INTERSECTIONS, e);
    if (!rc)
        rc = frame_run(r, o->sum_apply, "sum_apply",
                       FRAME_ARGS(FRAME_ARG(r->tiles_of.mem), FRAME_ARG(r->ids[0].mem),
                                  FRAME_ARG(ordered), FRAME_ARG(n), FRAME_ARG(r->counts),
                                  FRAME_ARG(o->sums.mem), FRAME_ARG(out)),
                       items, LAYOUT_ORDER_ITEMS, e);
    return rc;
}

struct order_pass { /* one stable pass over n keys (ordered: over counts->visible) */
    cl_uint first, ordered, n, shift, culls;
    cl_mem keys, ids, keys_out, ids_out;
};

static enum err_code order_pass(struct render *r, const struct order_pass *p, struct err *e)
{
    struct order_gpu *o = r->order_gpu;
    size_t blocks = order_blocks(p->n), items = blocks * LAYOUT_ORDER_ITEMS;
    enum err_code rc = frame_run(
        r, o->radix_count, "radix_count",
        FRAME_ARGS(FRAME_ARG(p->keys), FRAME_ARG(p->ordered), FRAME_ARG(p->n), FRAME_ARG(r->counts),
                   FRAME_ARG(p->shift), FRAME_ARG(p->culls), FRAME_ARG(o->sums.mem)),
        items, LAYOUT_ORDER_ITEMS, e);
    if (!rc)
        rc = order_scan(r, (cl_uint)(blocks << LAYOUT_ORDER_BITS),
                        p->culls ? LAYOUT_TOTAL_VISIBLE : 0, e);
    if (!rc)
        rc = frame_run(r, o->radix_scatter, "radix_scatter",
                       FRAME_ARGS(FRAME_ARG(p->keys), FRAME_ARG(p->ids), FRAME_ARG(p->first),
                                  FRAME_ARG(p->ordered), FRAME_ARG(p->n), FRAME_ARG(r->counts),
                                  FRAME_ARG(p->shift), FRAME_ARG(p->culls), FRAME_ARG(o->sums.mem),
                                  FRAME_ARG(p->keys_out), FRAME_ARG(p->ids_out)),
                       items, LAYOUT_ORDER_ITEMS, e);
    return rc;
}

enum err_code order_gpu_sort(struct render *r, struct err *e)
{
    struct order_gpu *o = r->order_gpu;
    size_t word = sizeof(cl_uint), lanes = (size_t)r->view.groups * LAYOUT_LANES;
    enum err_code rc =
        frame_reserve(r, &o->sums, (order_blocks(r->view.n) << LAYOUT_ORDER_BITS) * word, e);
    if (!rc)
        rc = frame_reserve(r, &o->first, lanes * word, e);
    if (!rc)
        rc = order_sums(r, 0, r->slot_first.mem, e);
    for (cl_uint pass = 0; !rc && pass < DEPTH_PASSES; pass++) {
        size_t to = pass % 2;
        struct order_pass p = {.first = pass == 0,
                               .ordered = pass != 0,
                               .n = r->view.n,
                               .shift = pass * LAYOUT_ORDER_BITS,
                               .culls = pass == 0,
                               .keys = pass ? r->keys[1 - to].mem : r->depth_key.mem,
                               .ids = r->ids[1 - to].mem,
                               .keys_out = r->keys[to].mem,
                               .ids_out = r->ids[to].mem};
        rc = order_pass(r, &p, e);
        if (!rc && pass == 0)
            rc = frame_ask_counts(r, e);
    }
    return rc;
}

enum err_code order_gpu_bin(struct render *r, struct err *e)
{
    struct order_gpu *o = r->order_gpu;
    cl_uint n = (cl_uint)r->intersections, tiles = r->tiles, last = 0;
    struct frame_buffer *lists[] = {&o->tile, &o->expanded_at[0], &o->expanded_at[1]};
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < sizeof lists / sizeof *lists; i++)
        rc = frame_reserve(r, lists[i], (size_t)n * sizeof(cl_uint), e);
    if (!rc)
        rc = order_sums(r, 1, o->first.mem, e);
    if (!rc) /* not sooner: the sums above need less, and a larger buffer begins empty */
        rc =
            frame_reserve(r, &o->sums, (order_blocks(n) << LAYOUT_ORDER_BITS) * sizeof(cl_uint), e);
    if (!rc)
        rc = frame_run(r, o->bin_expand, "bin_expand",
                       FRAME_ARGS(FRAME_ARG(r->view_mem), FRAME_ARG(r->ids[0].mem),
                                  FRAME_ARG(r->splats.mem), FRAME_ARG(r->slot_first.mem),
                                  FRAME_ARG(r->counts), FRAME_ARG(o->first.mem), FRAME_ARG(n),
                                  FRAME_ARG(r->expanded_tile.mem), FRAME_ARG(r->expanded_splat.mem),
                                  FRAME_ARG(r->expanded_slot.mem)),
                       r->view.n, 64, e);
    cl_mem keys[2] = {o->tile.mem, r->expanded_tile.mem};
    for (cl_uint pass = 0; !rc && (pass == 0 || (tiles - 1) >> (pass * LAYOUT_ORDER_BITS));
         pass++) {
        struct order_pass p = {.first = pass == 0,
                               .n = n,
                               .shift = pass * LAYOUT_ORDER_BITS,
                               .keys = keys[(pass + 1) % 2],
                               .ids = o->expanded_at[(pass + 1) % 2].mem,
                               .keys_out = keys[pass % 2],
                               .ids_out = o->expanded_at[pass % 2].mem};
        rc = order_pass(r, &p, e);
        last = pass % 2;
    }
    if (!rc)
        rc = frame_run(
            r, o->bin_gather, "bin_gather",
            FRAME_ARGS(FRAME_ARG(n), FRAME_ARG(tiles), FRAME_ARG(keys[last]),
                       FRAME_ARG(o->expanded_at[last].mem), FRAME_ARG(r->expanded_splat.mem),
                       FRAME_ARG(r->expanded_slot.mem), FRAME_ARG(r->tile_start.mem),
                       FRAME_ARG(r->intersection_splat.mem), FRAME_ARG(r->intersection_slot.mem)),
            n ? n : 1, 64, e);
    return rc;
}
