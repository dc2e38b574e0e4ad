/* Gaussians -> picture and back, on an OpenCL device. Every stage has a reference in plain C and
 * double precision.
 *
 * Reading order: the reference (render_ref.c, render_ref_backward.c) is the method in plain C. The
 * kernels are the same algorithm in another form. Callers need only this header.
 *
 * Only one thread at a time may use a struct render and its device. Fallible functions return
 * ERR_DEVICE (an OpenCL call failed), ERR_MEM, ERR_LIMIT (more than the device or 32-bit indices
 * can hold), and ERR_ARG for an invalid camera, options or model.
 *
 * The stages of a frame are: project (cull, conic, SH colour, tile rows) -> sort visible splats by
 * depth -> tile lists -> blend front to back, one work-item a 16x16 tile. The backward pass is:
 * blend backward writes one slot for each intersection (splat, tile) -> slots are added for each
 * Gaussian in fixed order -> projection backward, optionally fused with Adam. There are no float
 * atomics: the same input gives the same bits, for any number of threads.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef RENDER_RENDER_H
#define RENDER_RENDER_H

#include "core/device/dev.h"
#include "core/layout.h"
#include "core/splat/camera.h"
#include "core/splat/gauss.h"

enum render_aa {
    RENDER_AA_NONE, /* classic 3DGS: +0.3 px^2, no compensation */
    RENDER_AA_2D,   /* the same, with opacity multiplied by rho = sqrt(det S0 / det S) */
    /* Mip-Splatting: kernel of 0.1 px^2 with rho; its 3-D filter is folded into the Gaussians */
    RENDER_AA_MIP,
};

/* What is left of Gaussians near a city's edge, as seen from straight above: their opacity is
 * multiplied by the value at their mean. Between the middles of cells it is linear, outside of the
 * square it is that of its border. */
struct render_edge {
    float left[LAYOUT_EDGE][LAYOUT_EDGE]; /* 0..1, rows from south to north */
    double middle_enu_m[2], side_m;       /* of the square, along east and north */
};

struct render_options {
    enum render_aa aa;
    float background[3]; /* 0..1, seen where transmittance is left */
    /* [h][w]; where it is not 0, background_there is behind the pixel instead. Borrowed during the
     * call. NULL: nowhere. ERR_ARG with supersampling. */
    const uint8_t *background_where;
    float background_there[3];
    double near_m; /* 0: 0.2 m */
    /* Variance that is added to Gaussians on the picture, in square pixels. 0: the variance that
     * they were trained with. A smaller value shows edges in their true place, but not every thin
     * Gaussian. */
    double kernel_px2;
    int sh_degree; /* highest degree evaluated; -1: the model's */
    /* Rays are parallel to the optical axis, and the camera's fx_px and fy_px are pixels a metre.
     * Its centre is any point of the axis with everything visible in front of it. Such a frame has
     * no backward pass (ERR_ARG). */
    bool orthographic;
    /* Appearance, see core/splat/appearance.h: constants of a frame from appearance_frame(), for
     * embeddings of the model's length and this many hidden units. They are copied. NULL: no
     * appearance. The first frame with a pair of lengths compiles kernels. */
    const float *appearance_frame;
    uint32_t appearance_hidden;
    /* 2 to SUPERSAMPLE_MOST: draw with so many times the pixels on each axis and filter down, for
     * views from farther away than the photographs. 0 and 1: off. The device keeps the finer frame.
     * ERR_ARG with RENDER_AA_NONE, which would draw Gaussians thinner. */
    uint32_t supersample;
    /* Above 0, the frame also has two sums along each ray (render_moments_buffer). Depth is
     * relative to this many metres, which are also its unit. Use about the depth of the scene, so
     * that floats keep enough digits. ERR_ARG with supersampling and orthographic views. */
    double depth_unit_m;
    /* With depth_unit_m alone, and with known_zeta above 0 (else ERR_ARG): these sums are about
     * known depths. [h][w] known_zeta / zeta*, zeta* the pixel's known depth over depth_unit_m; not
     * above 0: it is not known. Borrowed until render_forward returns. NULL: they are moments of
     * depth. */
    const float *known;
    double known_zeta;
    /* Only the picture is wanted: a tenth faster, but there is no backward pass after the frame and
     * no importance (ERR_ARG). */
    bool picture;
    /* For pictures of a camera that moves a little. list_again: depth order and tile lists are
     * those of an earlier frame. The caller makes sure that nothing was drawn since then but such
     * frames, of the same Gaussians (params and list of the model) in the same appearance.
     * ERR_ARG: it is not `picture`, it has moments, or the earlier frame had another size, another
     * number of Gaussians, or failed. Splats that the lists do not have are not drawn.
     * list_room_px: lists also have what is so near to a tile or to the picture, for such frames
     * after this one; the picture is the same. */
    bool list_again;
    float list_room_px;
    /* With `picture` alone (ERR_ARG). Borrowed during the call; list_again: the earlier frame's.
     * NULL: every Gaussian has its own opacity. */
    const struct render_edge *edge;
    /* render_share_run follows: on CPUs its sums are made with the picture. Not with `picture` or
     * depth_unit_m: ERR_ARG. */
    bool shares;
};

#define RENDER_NEAR_M 0.2
enum { RENDER_SIZE_MAX_PX = 16384 }; /* largest edge of a drawing */

struct render; /* compiled kernels and buffers of a frame on one device */
/* Compiles the kernels. dev is borrowed and must outlive *out. Close it with render_close.
 * ERR_DEVICE, ERR_MEM. */
enum err_code render_open(struct dev *dev, struct render **out, struct err *e) ERR_USE;
void render_close(struct render **r);
/* From now on render_forward calls `stop` between the stages of a frame, and returns ERR_CANCEL if
 * it is true. Code that prepares frames may call render_go for the same check. NULL: never. */
void render_set_stop(struct render *r, bool (*stop)(const void *user), const void *user);
enum err_code render_go(const struct render *r, struct err *e) ERR_USE; /* ERR_CANCEL */

/* Gaussians on the device. */
struct render_model {
    cl_mem params; /* float [groups][planes][16] */
    /* Harmonics are halves, see core/layout.h. Such a model is made of pieces and only drawn: it is
     * not for render_model_write and render_model_download, and the backward pass refuses it
     * (ERR_ARG). */
    bool sh_halves;
    /* may be NULL: uint [groups], see render_model_list and render/defer.h. render_backward refuses
     * such a model (ERR_ARG); render_backward_step steps the listed groups */
    cl_mem list;
    cl_mem settled, owed; /* with a list of render/defer.h, borrowed: see there; else NULL */
    uint32_t n, cap, groups, planes, sh_degree, embed_len;
    double origin_enu_m[3]; /* origin of the means on the device */
};
/* Planes of words of 32 bits in a group: m->planes of a model with memory. */
uint32_t render_model_planes(const struct render_model *m);
/* Uploads g and keeps its origin. Free *out with render_model_free. ERR_MEM, ERR_LIMIT, ERR_DEVICE.
 */
enum err_code render_model_upload(struct render *r, const struct gauss *g, struct render_model *out,
                                  struct err *e) ERR_USE;
/* Writes the rows of g to the model from row `first` on, a multiple of LAYOUT_LANES. The model has
 * room for them, and the same SH degree, embedding length and origin as g. Lanes after the last row
 * become 0. ERR_MEM, ERR_DEVICE. */
enum err_code render_model_write(struct render *r, struct render_model *m, size_t first,
                                 const struct gauss *g, struct err *e) ERR_USE;
/* Downloads into g. If g->cap is 0 it is allocated; else its degree must be the model's. Embeddings
 * are not changed if their lengths differ. ERR_ARG (degree), ERR_MEM, ERR_DEVICE. */
enum err_code render_model_download(struct render *r, const struct render_model *m, struct gauss *g,
                                    struct err *e) ERR_USE;
void render_model_free(struct render_model *m);

/* Models of pieces that are placed once and drawn often (blocks of a city's tiles). A piece is
 * whole groups, [n_groups][planes][16], with means relative to the model's origin. Pieces stay
 * where they were placed, in any order. Each picture lists the groups that it draws. */
struct render_piece {
    uint32_t n_groups, at; /* at: first group in params */
    float *groups;         /* set by render_place_open: write the piece there */
};
static inline uint32_t render_piece_groups(size_t n_gaussians)
{
    return (uint32_t)((n_gaussians + LAYOUT_LANES - 1) / LAYOUT_LANES);
}
/* Puts the lanes after the last of n Gaussians in its group where they are not drawn. */
void render_piece_end(float *groups, uint32_t planes, size_t n);
/* Makes room for n_groups in m, and keeps the first n_kept that are there. The caller sets
 * sh_degree, sh_halves, embed_len and origin_enu_m before; a model that is {0} elsewhere has no
 * memory yet. A buffer that has to grow gets a quarter more room than asked for.
 * render_model_capacity gives the present room. After ERR_MEM, ERR_LIMIT and ERR_DEVICE these first
 * are still there. */
enum err_code render_model_reserve(struct render *r, struct render_model *m, size_t n_groups,
                                   size_t n_kept, struct err *e) ERR_USE;
static inline uint32_t render_model_capacity(const struct render_model *m)
{
    return m->cap / LAYOUT_LANES;
}
/* Writing pieces to their places, which must be reserved: render_place_open says where in memory,
 * the caller writes, from any threads, and render_place_close ends it. On a CPU that memory is the
 * model's own, so nothing is copied. Between the two the model must not be drawn. `made` is whether
 * the caller could write; close then returns it if it is an error, and copies nothing. ERR_DEVICE,
 * ERR_MEM. */
struct render_placing {
    struct render_piece *piece; /* borrowed */
    size_t n;
    void *mapped; /* the model's memory; NULL: it is copied from `staging` */
    float *staging;
};
enum err_code render_place_open(struct render *r, const struct render_model *m,
                                struct render_piece *piece, size_t n, struct render_placing *out,
                                struct err *e) ERR_USE;
enum err_code render_place_close(struct render *r, const struct render_model *m,
                                 struct render_placing *p, enum err_code made,
                                 struct err *e) ERR_USE;
/* Draws these groups of params from now on, in this order; NULL: the first n groups. ERR_MEM,
 * ERR_LIMIT, ERR_DEVICE. */
enum err_code render_model_list(struct render *r, const uint32_t *groups, size_t n,
                                struct render_model *m, struct err *e) ERR_USE;

struct render_stats {       /* numbers of the last frame */
    uint32_t visible;       /* splats that were not culled */
    uint64_t intersections; /* pairs of splats and tiles that they touch */
    double ms_project, ms_sort, ms_bin, ms_blend,
        ms_total; /* with timing on; without, only ms_total is set */
    double ms_blend_backward, ms_project_backward; /* of render_backward_step, with timing on */
};

/* Draws a picture. rgb [h][w][3] (may be NULL): float from 0, not limited to 1. transmittance
 * [h][w] may be NULL. The camera's pose in ENU is combined with the model's origin in double. The
 * frame stays on the device for render_backward. Method: EWA projection, exact tile culling,
 * inclusive stop. ERR_ARG (camera, appearance), ERR_LIMIT (more intersections than the device can
 * hold), ERR_CANCEL (render_set_stop), ERR_MEM, ERR_DEVICE. */
enum err_code render_forward(struct render *r, const struct render_model *m,
                             const struct camera *cam, const struct render_options *o, float *rgb,
                             float *transmittance, struct err *e) ERR_USE;
/* The transmittance of the last frame, [h][w]: the share of light from behind its Gaussians.
 * ERR_ARG (no frame was drawn), ERR_MEM, ERR_DEVICE. */
enum err_code render_transmittance(struct render *r, float *out, struct err *e) ERR_USE;
const struct render_stats *render_last_stats(const struct render *r);
/* Number of frames that were begun. */
uint64_t render_frames(const struct render *r);
/* A depth along the optical axis, m, that this share (0 to 1) of the splats of the last frame are
 * nearer than; +infinity if there are none. Not after a frame with list_again (ERR_ARG: or after
 * none). ERR_DEVICE. */
enum err_code render_depth_quantile(struct render *r, double share, double *depth_m,
                                    struct err *e) ERR_USE;
/* Turns times of stages in render_stats on or off. These times need a wait after every stage, so
 * they are off at first. */
void render_set_timing(struct render *r, bool on);
/* The colour of the last frame on the device, for the loss: float [3][h][w] planar. Borrowed. */
cl_mem render_color_buffer(struct render *r);
/* The transmittance of the last frame on the device: float [h][w]. Borrowed. */
cl_mem render_transmittance_buffer(struct render *r);
/* The two sums along each ray of the last frame, if it was drawn with depth_unit_m: float [2][h][w]
 * planar on the device. w is alpha T of a splat. m is z / depth_unit_m - 1, at the depth where the
 * pixel's ray meets the splat's densest point (render/moments.cl). The background does not count.
 * Without `known` they are moments of depth, sum w m and sum w m^2. With it, x is how many
 * footprints of a pixel that depth lies behind the known one, x = fx ((1 + m) / zeta* - 1), and
 *
 *     sum w x / (2 (C + |x|)),   sum w b max(|x| - F, 0) / (C + |x|),
 *
 * C = LAYOUT_SIDE_PX, F = LAYOUT_AWAY_PX, b = LAYOUT_AWAY_BEHIND where x > 0, else 1; both are 0
 * where no depth is known. The first is 0 where light before the known depth weighs as much as
 * light behind it; far light weighs 1/2. Borrowed. NULL: the frame has none. */
cl_mem render_moments_buffer(struct render *r);
/* render_options.known of the last frame on the device. Borrowed. NULL: it had none. */
cl_mem render_known_buffer(struct render *r);

/* ---- backward pass: see render_backward.c ---- */

/* dL/d(colour) of the last frame on the device: float [3][h][w] planar, as render_color_buffer.
 * Borrowed. The loss or render_set_color_grad fills it. Ask for it after each frame. NULL: no frame
 * was drawn, or memory is short. */
cl_mem render_color_grad_buffer(struct render *r);
/* dL/d(moments) and dL/d(transmittance) of the last frame: float [3][h][w] planar on the device.
 * Borrowed. Fill it before the backward pass of a frame with moments. NULL: the frame has none, or
 * memory is short. */
cl_mem render_moments_grad_buffer(struct render *r);
/* Sets dL/d(colour) from the host. ERR_ARG (no frame was drawn), ERR_MEM, ERR_DEVICE. */
enum err_code render_set_color_grad(struct render *r, const float *rgb_grad /*[h][w][3]*/,
                                    struct err *e) ERR_USE;
/* Writes the gradients of the last frame to `grads`: float [groups][planes][16], of the raw
 * parameters (before activation). Every plane of every Gaussian is written. Invisible Gaussians
 * have 0; embeddings have 0 after a frame without appearance. ERR_ARG (no frame of m was drawn, it
 * has no backward pass, or dL/d(colour) is missing), ERR_MEM, ERR_LIMIT, ERR_DEVICE. */
enum err_code render_backward(struct render *r, const struct render_model *m, cl_mem grads,
                              struct err *e) ERR_USE;

/* Further gradients of a frame with appearance. The objective is the loss plus offset_weight times
 * the mean of y3 (the opacity offset) over the visible Gaussians. */
struct render_appearance_grad {
    float offset_weight; /* in */
    /* out: [appearance_frame_floats], in the layout of the constants of a frame;
     * appearance_backward() turns it into gradients of weights and photograph. NULL: not wanted */
    float *frame;
    double offset_mean; /* out: mean of y3 over visible Gaussians; 0: none is visible */
    uint32_t visible;   /* out: number of visible Gaussians */
};
/* As render_backward, with these gradients, for a frame with appearance. ERR_ARG: it has none; else
 * as render_backward. */
enum err_code render_backward_appearance(struct render *r, const struct render_model *m,
                                         cl_mem grads, struct render_appearance_grad *a,
                                         struct err *e) ERR_USE;

/* Adam's state for a model. */
struct render_adam {
    /* Both moments of each parameter in one word of 32 bits, in the layout of params. Each is the
     * upper half of a float, the first in the upper half of the word. They are rounded at random,
     * by step, row and plane: see adam.cl. A word of 0 is a parameter that had no gradient. */
    cl_mem moments;
    float lr_mean, lr_scale, lr_quat, lr_opacity, lr_sh_dc, lr_sh_rest;
    float beta1, beta2, eps;
    uint32_t step;                      /* from 1, for bias correction */
    float scale_log_min, scale_log_max; /* limits after the step */
    /* After a frame with appearance all embeddings also make a step, as the other parameters do.
     * embed_step is their step number for bias correction: 1 at the first frame with appearance.
     * `appearance` gets the gradients of the frame's constants, and the call then waits for the
     * device; NULL: not wanted, and offset_weight is 0. */
    float lr_embed;
    uint32_t embed_step;
    struct render_appearance_grad *appearance;
    /* may be NULL: float [groups][LAYOUT_PLANES_SHAPE][16], added to the gradients of sizes and
     * rotation of every Gaussian, visible or not (terms of the loss on Gaussians) */
    cl_mem extra_grad;
};
/* Statistics of each Gaussian for densification, accumulated by render_backward_step:
 *
 *     grad     float [cap]  sum of ||(0.5 W g_u, 0.5 H g_v)||, the positional gradient in NDC units
 *     absg     float [cap]  sum of ||(0.5 W a_u, 0.5 H a_v)|| (AbsGS); NULL: not wanted
 *     count    float [cap]  number of frames in which it was visible
 *     radius   float [cap]  largest half-size in px
 *     repaired uint32 [1]   number of non-finite updates dropped and of quaternions reset (F1)
 *     opacity  float [cap]  largest opacity drawn, before compensation: min(o + y3, 1) with
 *                           appearance, o without; 0: it was not visible; NULL: not wanted */
struct render_density_stats {
    cl_mem grad, absg, count, radius, repaired, opacity;
};
/* Makes the backward pass and an Adam step at once. It updates m->params and the moments in place;
 * `stats` may be NULL. Gaussians that were not visible also move, with gradient 0, as Adam defines
 * it. SH above the degree of the frame is not changed. A Gaussian with a gradient that is not
 * finite is not changed. A quaternion that is shorter than 1e-6 or not finite becomes the identity
 * with zero moments. Both are counted in `repaired`. A new frame must be drawn before the next
 * call. ERR_ARG (as render_backward, or invalid numbers for Adam), ERR_MEM, ERR_LIMIT, ERR_DEVICE.
 */
enum err_code render_backward_step(struct render *r, struct render_model *m,
                                   struct render_adam *adam, struct render_density_stats *stats,
                                   struct err *e) ERR_USE;

/* ---- importance for density control: see render_importance.c ---- */

/* compiled kernels and buffers; it borrows the renderer; only one thread may use it */
struct render_importance;
/* Compiles the kernels. Free *out with render_importance_close. ERR_MEM, ERR_DEVICE. */
enum err_code render_importance_open(struct render *r, struct render_importance **out,
                                     struct err *e) ERR_USE;
void render_importance_close(struct render_importance **s); /* call it before render_close */
/* Sums over the pixels in which a Gaussian was blended, in the last frame of m. weight: float
 * [h][w] on the device, the weight of each pixel. *sums: float [n][LAYOUT_IMPORTANCE_SUMS], see
 * core/layout.h; valid until the next call or render_importance_close. Invisible Gaussians have 0.
 * ERR_ARG (no frame of m was drawn), ERR_MEM, ERR_LIMIT, ERR_DEVICE. */
enum err_code render_importance_run(struct render_importance *s, const struct render_model *m,
                                    cl_mem weight, const float **sums, struct err *e) ERR_USE;
/* As render_importance_run, without weights: it sums pixels and alpha T. The frame was drawn with
 * `shares` (ERR_ARG), and nothing else was summed since. Errors as there: ERR_ARG, ERR_MEM,
 * ERR_LIMIT, ERR_DEVICE. */
enum err_code render_share_run(struct render_importance *s, const struct render_model *m,
                               const float **sums, struct err *e) ERR_USE;
/* As render_importance_run, with another sum: LAYOUT_REMOVAL_RISE is the sum of weight times the
 * squared change of the pixel's colour (all three channels) if this Gaussian alone were not drawn.
 * Errors as there: ERR_ARG, ERR_MEM, ERR_LIMIT, ERR_DEVICE. */
enum err_code render_removal_run(struct render_importance *s, const struct render_model *m,
                                 cl_mem weight, const float **sums, struct err *e) ERR_USE;
/* Frees the sums, 16 bytes a Gaussian. */
void render_importance_forget(struct render_importance *s);

/* ---- depth of a frame: see render_surface.c ---- */

/* a compiled kernel and its maps; it borrows the renderer; only one thread may use it */
struct render_surface;
/* Compiles the kernel. Free *out with render_surface_close. ERR_MEM, ERR_DEVICE. */
enum err_code render_surface_open(struct render *r, struct render_surface **out,
                                  struct err *e) ERR_USE;
void render_surface_close(struct render_surface **s); /* call it before render_close */
/* Maps [h][w] of the last frame to compute; NULL: not wanted. Depths are along the optical axis in
 * m. The depth of a Gaussian at a pixel is where the ray meets its densest point. */
struct render_surface_maps {
    float *median_m;       /* where transmittance falls to 1/2: the visible surface; 0: nowhere */
    float *mean_m;         /* sum alpha T z / sum alpha T; 0 where nothing is drawn */
    float *front;          /* sum alpha T of Gaussians nearer than limit_m */
    float *transmittance;  /* transmittance behind the last Gaussian */
    float *near_m, *far_m; /* where transmittance falls to 0.9, and to 0.1; 0: nowhere */
    float *met; /* number of Gaussians until transmittance is 0.1, the last one included */
};
/* Computes the maps. limit_m [h][w]; NULL: front is 0. The model that was drawn must still exist
 * unchanged. ERR_ARG: no frame was drawn. ERR_MEM, ERR_LIMIT, ERR_DEVICE. */
enum err_code render_surface_run(struct render_surface *s, const float *limit_m,
                                 const struct render_surface_maps *out, struct err *e) ERR_USE;

/* ---- the reference, double precision: see render_ref.c ---- */

/* Draws by brute force: each pixel loops over all splats in depth order. rgb [h][w][3],
 * transmittance [h][w] or NULL. ERR_ARG, ERR_MEM. */
enum err_code render_ref_forward(const struct gauss *g, const struct camera *cam,
                                 const struct render_options *o, double *rgb, double *transmittance,
                                 struct err *e) ERR_USE;
/* The sums along the rays of a frame with depth_unit_m, and transmittance, [h][w][3]
 * (render_moments_buffer). ERR_ARG, ERR_MEM. */
enum err_code render_ref_moments(const struct gauss *g, const struct camera *cam,
                                 const struct render_options *o, double *moments,
                                 struct err *e) ERR_USE;
/* Gradients of sum(rgb * rgb_grad) with respect to the raw parameters, in the layout of gauss (n x
 * 3, n x 3, n x 4, n, n x K x 3). They overwrite what was there. */
struct render_ref_grads {
    double *mean, *scale_log, *quat_wxyz, *opacity_logit, *sh;
    /* With appearance: [n][embed_len] and [appearance_frame_floats]; NULL: not wanted. The
     * objective is then sum(rgb * rgb_grad) + offset_weight * mean of y3 over the visible
     * Gaussians. */
    double *embed, *frame;
    double offset_weight;
    /* Input, NULL: none: [h][w][3]. The objective then also has sum(moments * moments_grad), with
     * depth_unit_m in the options (render_ref_moments). */
    const double *moments_grad;
};
/* Computes these gradients. rgb_grad [h][w][3]. ERR_ARG, ERR_MEM. */
enum err_code render_ref_backward(const struct gauss *g, const struct camera *cam,
                                  const struct render_options *o, const double *rgb_grad,
                                  const struct render_ref_grads *out, struct err *e) ERR_USE;

#endif
