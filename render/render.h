/* Gaussians -> image and back, on an OpenCL device, with a plain-C double-precision twin of every
 * stage.
 *
 * Reading order: the reference (render_ref.c, render_ref_backward.c) is the method in plain C; the
 * kernels are the same algorithm in another shape; this header is all that callers need.
 *
 * One caller at a time a struct render and its device. Fallible functions return ERR_DEVICE (a call
 * of OpenCL failed), ERR_MEM, ERR_LIMIT (more than the device or 32-bit indices hold), and ERR_ARG
 * where a camera, options or a model do not fit.
 *
 * The stages of a frame: project (cull, conic, SH colour, tile rows) -> sort visible splats by
 * depth -> tile lists -> blend, front to back, one work-item per 16x16 tile. The backward pass:
 * blend backward writes one slot per intersection (splat, tile) -> gather per Gaussian in fixed
 * order -> projection backward, optionally fused with Adam. No float atomics anywhere: same input,
 * same bits, any number of threads.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef RENDER_RENDER_H
#define RENDER_RENDER_H

#include "core/camera.h"
#include "core/dev.h"
#include "core/gauss.h"
#include "core/layout.h"

enum render_aa {
    RENDER_AA_NONE, /* classic 3DGS: +0.3 px^2 without compensation */
    RENDER_AA_2D,   /* the same with opacity scaled by rho = sqrt(det S0 / det S) */
    RENDER_AA_MIP,  /* Mip-Splatting: kernel 0.1 px^2 with rho; the 3-D filter is in
                       render_model.filter, or folded into the Gaussians */
};

struct render_options {
    enum render_aa aa;
    float background[3]; /* 0..1, shown where transmittance is left */
    /* [h][w], not 0: background_there is behind this pixel instead. Borrowed for the call; NULL:
     * behind none. ERR_ARG with supersampling. */
    const uint8_t *background_where;
    float background_there[3];
    double near_m; /* 0: 0.2 m */
    int sh_degree; /* highest degree evaluated; -1: all that the model has */
    /* Rays are parallel to the optical axis: the camera's fx_px and fy_px are pixels a metre, and
     * its centre is any point on the axis with all that is to be seen in front of it. Such a frame
     * has no backward pass (ERR_ARG). */
    bool orthographic;
    /* Appearance, see core/appearance.h: constants made by appearance_frame() for embeddings of the
     * model's length and this many hidden units; copied. NULL: plain spherical harmonics. The first
     * frame of a pair of lengths compiles kernels for it. */
    const float *appearance_frame;
    uint32_t appearance_hidden;
    /* 2 to SUPERSAMPLE_MOST: drawn with so many pixels for one on each axis and filtered down, for
     * views from farther away than the photographs were taken. 0, 1: not. What is left on the
     * device is the finer frame. ERR_ARG without compensation (RENDER_AA_NONE), whose Gaussians
     * would be thinner. */
    uint32_t supersample;
};

#define RENDER_NEAR_M 0.2
enum { RENDER_SIZE_MAX_PX = 16384 }; /* a side of what is drawn */

/* Planes of the parameters of a group of Gaussians, see LAYOUT_PLANE_MEAN in core/layout.h. */
static inline uint32_t render_planes(uint32_t sh_degree)
{
    return LAYOUT_PLANE_SH + 3 * (sh_degree + 1) * (sh_degree + 1);
}
/* The same with embeddings behind: they start at plane render_planes(sh_degree). */
static inline uint32_t render_planes_embed(uint32_t sh_degree, uint32_t embed_len)
{
    return render_planes(sh_degree) + embed_len;
}

struct render; /* compiled kernels and per-frame buffers of one device; one caller at a time */
/* Compile the kernels. dev is borrowed and outlives *out; render_close it. ERR_DEVICE, ERR_MEM. */
enum err_code render_open(struct dev *dev, struct render **out, struct err *e) ERR_USE;
void render_close(struct render **r);
/* From here on render_forward asks between the stages of a frame whether the picture is still
 * wanted, and is ERR_CANCEL when stop is true; whoever prepares frames may ask as well. NULL:
 * never. */
void render_set_stop(struct render *r, bool (*stop)(const void *user), const void *user);
enum err_code render_go(const struct render *r, struct err *e) ERR_USE; /* ERR_CANCEL */

/* Gaussians on the device. */
struct render_model {
    cl_mem params; /* float [groups][planes][16] */
    cl_mem filter; /* may be NULL: float [groups][16], m: sigma of the 3-D smoothing filter of each
                    * Gaussian (Mip-Splatting, Yu et al. 2024): it is drawn with sqrt(sigma^2 + f^2)
                    * and opacity times prod sigma / sigma'; gradients are of the raw parameters,
                    * f has none. Set by the caller, freed with the model */
    cl_mem list;   /* may be NULL: uint [groups], see render_model_list; the backward pass
                    * refuses a model with one (ERR_ARG) */
    uint32_t n, cap, groups, planes, sh_degree, embed_len;
    double origin_enu_m[3]; /* means on the device are relative to this */
};
/* Upload g (its origin is kept). render_model_free it. ERR_MEM, ERR_LIMIT, ERR_DEVICE. */
enum err_code render_model_upload(struct render *r, const struct gauss *g, struct render_model *out,
                                  struct err *e) ERR_USE;
/* Put g's rows at row `first`, a multiple of LAYOUT_LANES, of a model with room for them, g's
 * degree and length of embeddings, and the same origin. Lanes behind the last row become 0.
 * ERR_MEM, ERR_DEVICE. */
enum err_code render_model_write(struct render *r, struct render_model *m, size_t first,
                                 const struct gauss *g, struct err *e) ERR_USE;
/* Download into g (gauss_alloc'ed by the callee if cap is 0, else its degree must be the model's;
 * embeddings are left alone when its length differs). ERR_ARG (degree), ERR_MEM, ERR_DEVICE. */
enum err_code render_model_download(struct render *r, const struct render_model *m, struct gauss *g,
                                    struct err *e) ERR_USE;
void render_model_free(struct render_model *m);

/* Models out of pieces that are packed once and drawn often (blocks of a city's tiles): memory is
 * copied, nothing is computed. A piece is whole groups, [n_groups][planes][16], with means relative
 * to the model's origin; lanes beyond its last Gaussian are never drawn. Pieces stay where they
 * were placed, in any order, and each picture lists the groups it takes. */
struct render_piece {
    const float *groups;
    uint32_t n_groups, at; /* at: first group in params */
};
static inline uint32_t render_piece_groups(size_t n_gaussians)
{
    return (uint32_t)((n_gaussians + LAYOUT_LANES - 1) / LAYOUT_LANES);
}
/* out: render_piece_groups(g->n) * render_planes_embed(...) * LAYOUT_LANES floats. */
void render_piece_pack(const struct gauss *g, const double origin_enu_m[3], float *out);
/* Room for n_groups in m. The caller has set sh_degree, embed_len and origin_enu_m; {0} besides
 * these is a model without memory. *kept: false when it had to grow, by a quarter more than asked
 * for at least; what was placed before is lost then. render_model_capacity says how much there is.
 * ERR_MEM, ERR_LIMIT. */
enum err_code render_model_reserve(struct render *r, struct render_model *m, size_t n_groups,
                                   bool *kept, struct err *e) ERR_USE;
static inline uint32_t render_model_capacity(const struct render_model *m)
{
    return m->cap / LAYOUT_LANES;
}
/* Copy pieces to their places, which have been reserved. ERR_DEVICE. */
enum err_code render_model_place(struct render *r, const struct render_piece *pieces,
                                 size_t n_pieces, struct render_model *m, struct err *e) ERR_USE;
/* Draw these groups of params, in this order; NULL: the first n of them. ERR_MEM, ERR_LIMIT,
 * ERR_DEVICE. */
enum err_code render_model_list(struct render *r, const uint32_t *groups, size_t n,
                                struct render_model *m, struct err *e) ERR_USE;

struct render_stats {       /* of the last frame */
    uint32_t visible;       /* splats that passed the cull */
    uint64_t intersections; /* of splats with the tiles they touch */
    double ms_project, ms_sort, ms_bin, ms_blend,
        ms_total;                                  /* filled when timing is on, else only total */
    double ms_blend_backward, ms_project_backward; /* of render_backward_step, with timing on */
};

/* Draw. rgb (may be NULL): [h][w][3] float, 0..1 not clamped above; transmittance (may be NULL):
 * [h][w]. The camera's ENU pose is combined with the model's origin in double. The frame stays on
 * the device for render_backward. Method: EWA projection, exact tile culling, inclusive stop.
 * ERR_ARG (camera, appearance), ERR_LIMIT (more intersections than the device holds), ERR_CANCEL
 * (render_set_stop), ERR_MEM, ERR_DEVICE. */
enum err_code render_forward(struct render *r, const struct render_model *m,
                             const struct camera *cam, const struct render_options *o, float *rgb,
                             float *transmittance, struct err *e) ERR_USE;
/* What the last frame's Gaussians leave of what is behind them: [h][w] of the picture. ERR_ARG (no
 * frame was drawn), ERR_MEM, ERR_DEVICE. */
enum err_code render_transmittance(struct render *r, float *out, struct err *e) ERR_USE;
const struct render_stats *render_last_stats(const struct render *r);
/* Stage times in render_stats cost a wait after every stage: off unless asked for. */
void render_set_timing(struct render *r, bool on);
/* The colour of the last frame on the device: float [3][h][w] planar, for the loss. Borrowed. */
cl_mem render_color_buffer(struct render *r);

/* ---- backward: see render_backward.c ---- */

/* dL/d(colour) of the last forward frame: float [3][h][w] planar on the device, same layout as
 * render_color_buffer; borrowed, filled by the loss (or by render_set_color_grad). Ask after each
 * frame. NULL when no frame was drawn or memory is out. */
cl_mem render_color_grad_buffer(struct render *r);
/* The same from the host. ERR_ARG (no frame was drawn), ERR_MEM, ERR_DEVICE. */
enum err_code render_set_color_grad(struct render *r, const float *rgb_grad /*[h][w][3]*/,
                                    struct err *e) ERR_USE;
/* Gradients of the last frame into `grads`: float [groups][planes][16], raw parameters (before
 * activation); every plane of every Gaussian is written (0 where invisible, and the embedding's 0
 * after a frame without appearance). ERR_ARG (no frame of m was drawn, or one without a backward
 * pass; dL/dcolour is missing), ERR_MEM, ERR_LIMIT, ERR_DEVICE. */
enum err_code render_backward(struct render *r, const struct render_model *m, cl_mem grads,
                              struct err *e) ERR_USE;

/* Gradients of a frame with appearance beyond the Gaussians' own. The objective is the loss plus
 * offset_weight times the mean of y3 (the opacity offset) over the visible Gaussians. */
struct render_appearance_grad {
    float offset_weight; /* in */
    float *frame;        /* out, NULL: not wanted: [appearance_frame_floats], laid out as the frame,
                          * see appearance_backward() for the weights' and the photograph's */
    double offset_mean;  /* out: mean of y3 over the visible; 0 when there are none */
    uint32_t visible;    /* out: how many that are */
};
/* render_backward of a frame that was drawn with appearance (ERR_ARG else), with these as well. */
enum err_code render_backward_appearance(struct render *r, const struct render_model *m,
                                         cl_mem grads, struct render_appearance_grad *a,
                                         struct err *e) ERR_USE;

/* Adam state of a trainable model: same layout as params. */
struct render_adam {
    cl_mem m1, m2; /* first and second moments */
    float lr_mean, lr_scale, lr_quat, lr_opacity, lr_sh_dc, lr_sh_rest;
    float beta1, beta2, eps;
    uint32_t step;                      /* 1-based, for bias correction */
    float scale_log_min, scale_log_max; /* clamp after the step */
    /* After frames with appearance, and only then, the embeddings step as well, all of them as the
     * other parameters do. embed_step: as step, for their bias correction: 1 at the first frame
     * with appearance. `appearance` (NULL: not wanted, no offset_weight) gets the frame's part,
     * which waits for the device. */
    float lr_embed;
    uint32_t embed_step;
    struct render_appearance_grad *appearance;
    cl_mem extra_grad; /* may be NULL: float [groups][LAYOUT_PLANES_GEOMETRY][16], added to the
                        * gradients of these planes of every Gaussian, seen or not (regularizers) */
    bool extra_sizes;  /* it is float [groups][LAYOUT_PLANES_SCALE][16], of the scales alone */
};
/* Per-Gaussian densification statistics, accumulated by render_backward_step:
 *   grad   float [cap]  sum of ||(0.5 W g_u, 0.5 H g_v)||        (positional gradient, NDC units)
 *   absg   float [cap]  sum of ||(0.5 W a_u, 0.5 H a_v)||        (AbsGS); NULL: not wanted, a
 *                       little faster
 *   count  float [cap]  number of frames in which it was visible
 *   radius float [cap]  largest half-size in px
 *   repaired uint32 [1] number of non-finite updates dropped / quaternions reset (F1)
 *   opacity float [cap] largest opacity it was drawn with, before compensation: min(o + y3, 1) with
 *                       appearance, o without; 0 when it was not visible; NULL: not wanted */
struct render_density_stats {
    cl_mem grad, absg, count, radius, repaired, opacity;
};
/* Backward fused with Adam: updates m->params and the moments in place; `stats` may be NULL. Dense:
 * Gaussians that were not seen move on with gradient 0, as Adam has it. SH above the degree of the
 * frame is left alone. A Gaussian whose gradient is not finite is left as it is, a quaternion
 * shorter than 1e-6 or not finite becomes the identity with zero moments; both are counted in
 * `repaired`. Draw again before the next call. ERR_ARG (as render_backward; numbers of Adam out of
 * range), ERR_MEM, ERR_LIMIT, ERR_DEVICE. */
enum err_code render_backward_step(struct render *r, struct render_model *m,
                                   struct render_adam *adam, struct render_density_stats *stats,
                                   struct err *e) ERR_USE;

/* ---- importance for density control: see render_importance.c ---- */

/* compiled kernels and buffers; borrows the renderer; one caller at a time */
struct render_importance;
/* ERR_MEM, ERR_DEVICE. */
enum err_code render_importance_open(struct render *r, struct render_importance **out,
                                     struct err *e) ERR_USE;
void render_importance_close(struct render_importance **s); /* before render_close */
/* Sums over the pixels that a Gaussian was blended into in the last frame of m. weight: float
 * [h][w] on the device, what each pixel counts. *sums: float [n][LAYOUT_IMPORTANCE_SUMS], see
 * core/layout.h, until the next call and render_importance_close; all 0 where invisible. ERR_ARG
 * (no frame of m was drawn), ERR_MEM, ERR_LIMIT, ERR_DEVICE. */
enum err_code render_importance_run(struct render_importance *s, const struct render_model *m,
                                    cl_mem weight, const float **sums, struct err *e) ERR_USE;
/* Give back the sums and the memory they took, 32 bytes a Gaussian. */
void render_importance_forget(struct render_importance *s);

/* ---- depth of a frame: see render_surface.c ---- */

/* a compiled kernel and its maps; borrows the renderer; one caller at a time */
struct render_surface;
/* ERR_MEM, ERR_DEVICE. */
enum err_code render_surface_open(struct render *r, struct render_surface **out,
                                  struct err *e) ERR_USE;
void render_surface_close(struct render_surface **s); /* before render_close */
/* Maps [h][w] of the last frame, to be filled; NULL: not wanted. Depths are along the optical axis,
 * m: those at which a pixel's ray meets the most of each Gaussian. */
struct render_surface_maps {
    float *median_m; /* where transmittance falls to 1/2: the surface that is seen; 0: nowhere */
    float *mean_m;   /* sum alpha T z / sum alpha T; 0 where nothing is drawn */
    float *front;    /* sum alpha T of what is nearer than limit_m */
    float *transmittance;  /* what is left behind the last Gaussian */
    float *near_m, *far_m; /* where transmittance falls to 0.9, to 0.1; 0: nowhere */
    float *met;            /* Gaussians met until it is 0.1, with the one that makes it so */
};
/* limit_m [h][w], NULL: front is 0. The model that was drawn still exists, as it was. ERR_ARG when
 * no frame was drawn; ERR_MEM, ERR_LIMIT, ERR_DEVICE. */
enum err_code render_surface_run(struct render_surface *s, const float *limit_m,
                                 const struct render_surface_maps *out, struct err *e) ERR_USE;

/* ---- the reference, double precision: see render_ref.c ---- */

/* Brute force, per pixel over all splats in depth order. rgb [h][w][3], transmittance [h][w] or
 * NULL. ERR_ARG, ERR_MEM. */
enum err_code render_ref_forward(const struct gauss *g, const struct camera *cam,
                                 const struct render_options *o, double *rgb, double *transmittance,
                                 struct err *e) ERR_USE;
/* Gradients of sum(rgb * rgb_grad) with respect to the raw parameters; arrays in the layout of
 * gauss (n x 3, n x 3, n x 4, n, n x K x 3), written, not added. */
struct render_ref_grads {
    double *mean, *scale_log, *quat_wxyz, *opacity_logit, *sh;
    /* With appearance, NULL: not wanted: [n][embed_len], [appearance_frame_floats]. The objective
     * is then sum(rgb * rgb_grad) + offset_weight * mean of y3 over the visible. */
    double *embed, *frame;
    double offset_weight;
};
/* rgb_grad [h][w][3]. ERR_ARG, ERR_MEM. */
enum err_code render_ref_backward(const struct gauss *g, const struct camera *cam,
                                  const struct render_options *o, const double *rgb_grad,
                                  const struct render_ref_grads *out, struct err *e) ERR_USE;

#endif
