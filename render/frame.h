/* Inside of render/: what forward leaves on the device for backward, and what both share.
 *
 * Only render/ includes this (and its tests). Life of a frame, all on one in-order queue:
 *
 *   project  params -> splats, depth_key, tiles         a record, a key and a tile count each
 *   sort     depth_key -> order, slot_first             32-bit LSD radix sort over fixed chunks,
 *                                                       ties by index
 *   bin      order -> tile_start, intersection_splat,   intersections of a tile in depth order
 *            intersection_slot
 *   planes   splats' depths, over words that only bin   with moments of depth alone
 *            reads
 *   blend    -> color, transmit, moments                one work-item a tile on CPUs, one
 *                                                       work-group a tile on GPUs
 *
 * No count depends on the number of threads and nothing is added by atomics, so the same input
 * gives the same bits.
 *
 * Slots: Gaussian g owns slots slot_first[g] .. slot_first[g] + tiles[g] - 1, one per tile it
 * touches, in row-major order of those tiles; Gaussians are numbered in index order, so a gather
 * over Gaussians walks the slots from front to back. The backward pass writes what the intersection
 * (splat, tile) contributed to its slot (and a flag, since those behind the stop are never visited)
 * and sums per Gaussian in slot order.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef RENDER_FRAME_H
#define RENDER_FRAME_H

#include "core/layout.h"
#include "render/render.h"

struct order_gpu;
struct render_appearance_kernels;
struct render_backward_state;

struct frame_buffer { /* grows, never shrinks */
    cl_mem mem;
    size_t cap_bytes;
};
/* Make b at least n_bytes large; contents are lost when it grows (by half at least, within the
 * device's limit). ERR_MEM, ERR_LIMIT. */
enum err_code frame_reserve(struct render *r, struct frame_buffer *b, size_t n_bytes,
                            struct err *e) ERR_USE;

struct render {
    struct dev *dev;                /* borrowed */
    bool (*stop)(const void *user); /* see render_set_stop */
    const void *stop_user;

    /* -- the last frame; valid for backward while `drawn` -------------------------------------- */
    bool drawn;
    /* of the model that was drawn, borrowed; never NULL with a frame: see render_stage_project */
    cl_mem drawn_params, drawn_filter, drawn_list;
    struct layout_view view; /* as uploaded to view_mem */
    uint32_t supersample;    /* view is of so many times the picture's size; 1 */
    uint32_t tiles;          /* tiles_x * tiles_y */
    uint64_t intersections;  /* (splat, tile) of the frame */
    cl_mem view_mem;         /* __constant struct layout_view[1] */

    /* per Gaussian, [groups * 16]; padding lanes have tiles 0 */
    struct frame_buffer splats;     /* struct layout_splat; undefined where tiles is 0 */
    struct frame_buffer depth_key;  /* uint: bits of depth, ~0 where culled */
    struct frame_buffer tiles_of;   /* uint: number of tiles touched, 0 = invisible */
    struct frame_buffer slot_first; /* uint */

    /* scratch of the sort and the result */
    struct frame_buffer keys[2],
        ids[2]; /* uint [n]; depth order ends in ids[0], tile counts in keys[0] */
    struct frame_buffer histogram; /* uint [digits][LAYOUT_SORT_CHUNKS] */
    cl_mem counts;                 /* struct layout_counts[1] */

    /* per tile and per intersection */
    struct frame_buffer expanded_tile, expanded_splat,
        expanded_slot;              /* uint [intersections]: all of them in depth order */
    struct frame_buffer bin_offset; /* uint [LAYOUT_BIN_CHUNKS][tiles rounded up to 16] */
    /* uint [.. + 1]: intersections of tile t are [start[t], start[t + 1]) */
    struct frame_buffer tile_start;
    /* uint [intersections]: index of the Gaussian (and of its record) */
    struct frame_buffer intersection_splat;
    struct frame_buffer intersection_slot; /* uint [intersections] */
    struct frame_buffer hits;      /* ushort [intersections]: blocks drawn into, see blend_cpu.cl */
    struct frame_buffer tile_stop; /* uint [tiles] */

    struct frame_buffer slots; /* float [intersections][..]: what they leave for their Gaussians in
                                * the backward pass, or in render_importance_run */

    /* pictures */
    struct frame_buffer color;      /* float [3][h][w] planar, background included */
    struct frame_buffer transmit;   /* float [h][w] */
    struct frame_buffer color_grad; /* float [3][h][w] planar, dL/dcolor */
    /* with view.depth_unit_m: float [2][h][w] and [3][h][w] planar, see render.h */
    struct frame_buffer moments, moments_grad;
    struct frame_buffer where;      /* uchar [h][w]: render_options.background_where */

    /* -- appearance: render_appearance.c ------------------------------------------------------- */
    /* the last frame was drawn with it; NULL: plain */
    struct render_appearance_kernels *appearance;
    struct render_appearance_kernels *appearance_kernels; /* all that were made */
    struct frame_buffer appearance_frame; /* float [appearance_frame_floats]: its constants */
    struct frame_buffer effective;        /* float [groups * 16]: min(o + y3, 1), of the visible */
    /* VW 1: float [groups][LAYOUT_APPEARANCE_OUT][16]: dL/dy, of the visible */
    struct frame_buffer y_grads;
    /* float [pieces][LAYOUT_APPEARANCE_ROW]: sums of the frame's gradients */
    struct frame_buffer appearance_parts;
    /* float [LAYOUT_APPEARANCE_ROW]: their sum; behind them that of y3 */
    struct frame_buffer appearance_sums;

    struct order_gpu *order_gpu; /* sort and bin on GPUs: order_gpu.c; NULL on CPUs */

    /* -- programs ------------------------------------------------------------------------------ */
    cl_program
        program; /* forward: layout.h common.cl project.cl sort.cl bin.cl blend_cpu.cl or _gpu */
    struct frame_kernels {
        cl_kernel project, sort_count, sort_scan, sort_scatter, bin_total, bin_expand, bin_sum,
            bin_scan, bin_scatter, planes, blend, blend_moments, background;
    } k;

    /* -- the backward pass: made by render_backward.c on first use, freed by render_close through
     *    backward_free ------------------------------------------------------------------------- */
    struct render_backward_state *backward;
    void (*backward_free)(struct render *r);

    struct render_stats stats;
    bool timing;    /* finish the queue after every stage and fill stats.ms_*: render_set_timing */
    bool box_tiles; /* tile culling off: the ablation, and the test that culling changes nothing */
    uint64_t
        intersection_max; /* ERR_LIMIT above; what 32-bit slots and the device's buffers allow */
};

/* Number of work-items of a per-Gaussian kernel over `groups` groups, and the local size to launch
 * it with: VW 16: one item per LAYOUT_PROJECT_GROUPS groups; VW 1: one item per Gaussian. */
size_t frame_items(const struct render *r, uint32_t groups, size_t *local);

/* Set all arguments of a kernel and launch it:
 *   frame_run(r, k, "gather", FRAME_ARGS(FRAME_ARG(mem), FRAME_ARG(n)), global, local, e)
 * ERR_INTERNAL (an argument does not fit), ERR_DEVICE. */
struct frame_arg {
    size_t size;
    const void *value;
};
#define FRAME_ARG(v)                                                                               \
    {                                                                                              \
        sizeof(v), &(v)                                                                            \
    }
#define FRAME_ARGS(...)                                                                            \
    (const struct frame_arg[]){__VA_ARGS__},                                                       \
        sizeof((const struct frame_arg[]){__VA_ARGS__}) / sizeof(struct frame_arg)
/* See above: ERR_INTERNAL, ERR_DEVICE. */
enum err_code frame_run(struct render *r, cl_kernel k, const char *name,
                        const struct frame_arg *args, size_t n_args, size_t global, size_t local,
                        struct err *e) ERR_USE;

/* Appearance: render_appearance.c. render_appearance_begin sets r->appearance for this frame, or
 * NULL, and uploads its constants; the others are for frames that have it. ERR_ARG (lengths),
 * ERR_DEVICE, ERR_MEM. */
enum err_code render_appearance_begin(struct render *r, const struct render_model *m,
                                      const struct render_options *o, struct err *e) ERR_USE;
enum err_code render_appearance_project(struct render *r, const struct render_model *m,
                                        struct err *e) ERR_USE;
/* A backward pass: which kernels to take in place of project_backward and project_step, and the
 * arguments that come after theirs. Stays where it is until render_appearance_finish: arguments
 * point into it. */
struct render_appearance_call {
    cl_kernel grads, step;
    struct frame_arg args[4];
    size_t n_args;
    cl_float each;
};
/* out NULL: no sums wanted, no offset_weight. ERR_DEVICE, ERR_LIMIT, ERR_MEM. */
enum err_code render_appearance_prepare(struct render *r, const struct render_appearance_grad *out,
                                        struct render_appearance_call *c, struct err *e) ERR_USE;
/* After that kernel: embeddings, where it left them to do, in grads or (rates not NULL) in params
 * and the moments of adam; sums into *out when it is not NULL. ERR_DEVICE, ERR_INTERNAL. */
enum err_code render_appearance_finish(struct render *r, const struct render_model *m, cl_mem grads,
                                       const struct render_adam *adam,
                                       const struct layout_adam *rates,
                                       const struct render_appearance_call *c,
                                       struct render_appearance_grad *out, struct err *e) ERR_USE;
void render_appearance_close(struct render *r);

/* Sort and bin where vector_width is 1: order_gpu.c. They leave behind what the stages of CPUs do.
 * ERR_DEVICE, ERR_LIMIT, ERR_MEM. */
enum err_code order_gpu_open(struct dev *dev, struct order_gpu **out, struct err *e) ERR_USE;
enum err_code order_gpu_sort(struct render *r, struct err *e) ERR_USE;
enum err_code order_gpu_bin(struct render *r, struct err *e) ERR_USE;
void order_gpu_close(struct order_gpu **op);

/* First sources of every program of render/, after core/layout.h. */
extern const char vector_cl[], common_cl[];
#define FRAME_SOURCES                                                                              \
    {"core/vector.cl", vector_cl},                                                                 \
    {                                                                                              \
        "render/common.cl", common_cl                                                              \
    }

/* With timing on: wait, and give the milliseconds since *since_s, which moves on. ERR_DEVICE. */
enum err_code frame_clock(struct render *r, double *since_s, double *ms, struct err *e) ERR_USE;

#endif
