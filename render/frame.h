/* Internals of render/: the buffers of a frame, which the forward pass leaves on the device for the
 * backward pass, and functions that both use. Only render/ and its tests include this.
 *
 * All stages run on one in-order queue:
 *
 *     project  params -> splats, depth_key, tiles         a record, a key and a tile count each
 *     sort     depth_key -> order, slot_first             32-bit LSD radix sort over fixed chunks,
 *                                                         ties by index
 *     bin      order -> tile_start, intersection_splat,   intersections of a tile in depth order
 *              intersection_slot
 *     planes   splats -> words of the splats              with sums along rays only: over words
 *                                                         that only bin reads
 *     blend    -> color, transmit, moments                one work-item a tile on CPUs, one
 *                                                         work-group a tile on GPUs
 *
 * No count depends on the number of threads and there are no atomic additions, so the same input
 * gives the same bits.
 *
 * Slots: Gaussian g owns the slots slot_first[g] .. slot_first[g] + tiles[g] - 1, one for each tile
 * that it touches, in row-major order of the tiles. Slots are in the order of the Gaussians'
 * indices, so a pass over all Gaussians reads the slots from first to last. The backward pass
 * writes the sums of an intersection to its slot. It also writes a mark, because intersections
 * after the stop of a tile are never visited. Then it adds the slots of each Gaussian in their
 * order.
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
/* Makes b at least n_bytes large. If it grows, its contents are lost; it grows at least by half,
 * within the device's limit. ERR_MEM, ERR_LIMIT. */
enum err_code frame_reserve(struct render *r, struct frame_buffer *b, size_t n_bytes,
                            struct err *e) ERR_USE;

struct render {
    struct dev *dev;                /* borrowed */
    uint32_t vector_width;          /* of dev when kernels were compiled: the sizes of launches */
    bool (*stop)(const void *user); /* see render_set_stop */
    const void *stop_user;

    /* ---- the last frame; valid for the backward pass while `drawn` ---- */
    bool drawn;
    bool listed;     /* its order and tile lists are whole: a frame with list_again may use them */
    uint64_t frames; /* begun */
    bool shares;     /* render_options.shares of the frame */
    /* Buffers of the model that was drawn, borrowed. They are never NULL while there is a frame:
     * see render_stage_project. */
    cl_mem drawn_params, drawn_list;
    struct layout_view view; /* as uploaded to view_mem */
    /* how many times larger than the picture `view` is, on each axis; 1: no supersampling */
    uint32_t supersample;
    uint32_t tiles;         /* tiles_x * tiles_y */
    uint64_t intersections; /* number of pairs (splat, tile) in the frame */
    cl_mem view_mem;        /* __constant struct layout_view[1] */

    /* per Gaussian, [groups * 16]; padding lanes have tiles 0 */
    struct frame_buffer splats;     /* struct layout_splat; undefined where tiles is 0 */
    struct frame_buffer depth_key;  /* uint: bits of depth, ~0 where culled */
    struct frame_buffer tiles_of;   /* uint: number of tiles touched, 0 = invisible */
    struct frame_buffer slot_first; /* uint */

    /* scratch of the sort, and its result */
    struct frame_buffer keys[2],
        ids[2]; /* uint [n]; depth order ends in ids[0], tile counts in keys[0] */
    struct frame_buffer histogram; /* uint [LAYOUT_SORT_CHUNKS + 1][digits] */
    cl_mem counts;                 /* struct layout_counts[1] */
    struct layout_counts counted;  /* the host's copy, once `counting` is done */
    struct dev_pending counting;

    /* per tile and per intersection */
    struct frame_buffer expanded_tile, expanded_splat,
        expanded_slot;              /* uint [intersections]: all intersections in depth order */
    struct frame_buffer bin_offset; /* uint [LAYOUT_BIN_CHUNKS][tiles rounded up to 16] */
    /* uint [.. + 1]: intersections of tile t are [start[t], start[t + 1]) */
    struct frame_buffer tile_start;
    /* uint [intersections]: index of the Gaussian, which is also that of its record */
    struct frame_buffer intersection_splat;
    struct frame_buffer intersection_slot; /* uint [intersections] */
    /* ushort [intersections]: blocks that were drawn, see blend_cpu.cl */
    struct frame_buffer hits;
    struct frame_buffer tile_stop; /* uint [tiles] */

    /* float [intersections][..]: sums for Gaussians, written by the backward pass, by
     * render_importance_run, or by blend_shares */
    struct frame_buffer slots;

    /* pictures */
    struct frame_buffer color;      /* float [3][h][w] planar, background included */
    struct frame_buffer transmit;   /* float [h][w] */
    struct frame_buffer color_grad; /* float [3][h][w] planar, dL/dcolor */
    /* with view.depth_unit_m: float [2][h][w] and [3][h][w] planar, see render.h */
    struct frame_buffer moments, moments_grad;
    struct frame_buffer known; /* float [h][w]: copy of render_options.known */
    struct frame_buffer where; /* uchar [h][w]: copy of render_options.background_where */
    struct frame_buffer edge;  /* float [LAYOUT_EDGE][LAYOUT_EDGE]: copy of render_options.edge */

    /* ---- appearance: render_appearance.c ---- */
    /* those of the last frame; NULL: it was drawn without appearance */
    struct render_appearance_kernels *appearance;
    struct render_appearance_kernels *appearance_kernels; /* list of all that were compiled */
    /* float [appearance_frame_floats]: constants of the frame */
    struct frame_buffer appearance_frame;
    struct frame_buffer effective; /* float [groups * 16]: min(o + y3, 1) of visible Gaussians */
    /* VW 1: float [groups][LAYOUT_APPEARANCE_OUT][16]: dL/dy of visible Gaussians */
    struct frame_buffer y_grads;
    /* float [pieces][LAYOUT_APPEARANCE_ROW]: partial sums of the gradient of the constants */
    struct frame_buffer appearance_parts;
    /* float [LAYOUT_APPEARANCE_ROW]: their total, with that of y3 after them */
    struct frame_buffer appearance_sums;

    struct order_gpu *order_gpu; /* sort and bin on GPUs: order_gpu.c; NULL on CPUs */

    /* ---- programs ---- */
    cl_program
        program; /* forward: layout.h common.cl project.cl sort.cl bin.cl blend_cpu.cl or _gpu */
    struct frame_kernels {
        cl_kernel project, sort_count, sort_scan, sort_scatter, bin_total, bin_expand, bin_sum,
            bin_scan, bin_scatter, planes, blend, blend_moments, blend_shares, background;
    } k;

    /* ---- the backward pass: made by render_backward.c, freed by backward_free ---- */
    struct render_backward_state *backward;
    void (*backward_free)(struct render *r);

    struct render_stats stats;
    bool timing; /* wait after every stage and fill stats.ms_*: render_set_timing */
    /* ... with processor time of the process, which other programs disturb less */
    bool timing_cpu;
    /* use all tiles of the bounding box, for comparison and for the test of exact culling */
    bool box_tiles;
    uint64_t
        intersection_max; /* limit of 32-bit slots and of the device's buffers; more is ERR_LIMIT */
};

/* Returns the number of work-items for a kernel over `groups` groups, and the local size. VW 16:
 * one item for LAYOUT_PROJECT_GROUPS groups. VW 1: one item a Gaussian. */
size_t frame_items(const struct render *r, uint32_t groups, size_t *local);

/* Sets all arguments of a kernel and launches it:
 *
 *     frame_run(r, k, "gather", FRAME_ARGS(FRAME_ARG(mem), FRAME_ARG(n)), global, local, e)
 *
 * ERR_INTERNAL (an argument has the wrong size), ERR_DEVICE. */
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

/* Constants of a frame of this view, without supersampling. */
void render_view_fill(const struct render *r, const struct render_model *m, const struct camera *c,
                      const struct render_options *o, struct layout_view *v);

/* Appearance: render_appearance.c. render_appearance_begin sets r->appearance for this frame (NULL:
 * no appearance) and uploads the constants. render_appearance_project is for frames with
 * appearance. ERR_ARG (lengths), ERR_DEVICE, ERR_MEM. */
enum err_code render_appearance_begin(struct render *r, const struct render_model *m,
                                      const struct render_options *o, struct err *e) ERR_USE;
enum err_code render_appearance_project(struct render *r, const struct render_model *m,
                                        struct err *e) ERR_USE;
/* The kernels that replace project_backward and project_step in a backward pass with appearance,
 * and the arguments that follow theirs. It must not be moved until render_appearance_finish,
 * because arguments point into it. */
struct render_appearance_call {
    cl_kernel grads, step;
    struct frame_arg args[4];
    size_t n_args;
    cl_float each;
};
/* Prepares a backward pass. out NULL: no sums are wanted, and offset_weight is 0. ERR_DEVICE,
 * ERR_LIMIT, ERR_MEM. */
enum err_code render_appearance_prepare(struct render *r, const struct render_appearance_grad *out,
                                        struct render_appearance_call *c, struct err *e) ERR_USE;
/* Ends a backward pass, after the kernel. If the kernel left the embeddings undone, it writes their
 * gradients to `grads`; if `rates` is not NULL, it instead makes their Adam step in params and
 * moments. If `out` is not NULL, it gets the sums. ERR_DEVICE, ERR_INTERNAL. */
enum err_code render_appearance_finish(struct render *r, const struct render_model *m, cl_mem grads,
                                       const struct render_adam *adam,
                                       const struct layout_adam *rates,
                                       const struct render_appearance_call *c,
                                       struct render_appearance_grad *out, struct err *e) ERR_USE;
void render_appearance_close(struct render *r);

/* Enqueues the read of the counts of a frame, once the device has them: within the sort. The device
 * makes the later passes while the host prepares the lists. ERR_DEVICE. */
enum err_code frame_ask_counts(struct render *r, struct err *e) ERR_USE;

/* Sort and bin for vector_width 1: order_gpu.c. They leave the same results as the stages for CPUs.
 * ERR_DEVICE, ERR_LIMIT, ERR_MEM. */
enum err_code order_gpu_open(struct dev *dev, struct order_gpu **out, struct err *e) ERR_USE;
enum err_code order_gpu_sort(struct render *r, struct err *e) ERR_USE;
enum err_code order_gpu_bin(struct render *r, struct err *e) ERR_USE;
void order_gpu_close(struct order_gpu **op);

/* The sources after core/layout.h with which every program of render/ begins. */
extern const char vector_cl[], common_cl[];
#define FRAME_SOURCES                                                                              \
    {"core/device/vector.cl", vector_cl},                                                          \
    {                                                                                              \
        "render/common.cl", common_cl                                                              \
    }

/* The clock that times stages, in seconds. */
double frame_now(const struct render *r);
/* With timing on it waits for the queue, gives the milliseconds since *since_s, and sets *since_s
 * to now. ERR_DEVICE. */
enum err_code frame_clock(struct render *r, double *since_s, double *ms, struct err *e) ERR_USE;

#endif
