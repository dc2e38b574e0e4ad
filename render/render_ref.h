/* Internals of the reference: one Gaussian in the picture, in double, for render_ref.c and
 * render_ref_backward.c. Names follow the derivation of EWA splatting (Zwicker et al. 2001; Kerbl
 * et al. 2023). Formulas stand where they are computed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef RENDER_RENDER_REF_H
#define RENDER_RENDER_REF_H

#include "core/splat/appearance.h"
#include "render/render.h"

struct ref_view {            /* a camera and options, with all defaults filled in */
    double rot[9], trans[3]; /* model frame -> camera; trans includes the model's origin */
    double eye[3];           /* centre of projection, relative to the model's origin */
    double fx, fy, cx, cy;
    uint32_t width, height;
    double lim_neg[2], lim_pos[2]; /* limits of x/z and y/z in the Jacobian */
    double near_m, kernel_px2, half_max_px;
    double background[3];
    const uint8_t *background_where; /* borrowed; NULL: no pixel has the other background */
    double background_there[3];
    const struct render_edge *edge; /* borrowed; NULL: none */
    double origin_enu_m[2];         /* of the model */
    double depth_unit_m;            /* of sums along rays; 0: none */
    const float *known;             /* borrowed; NULL: these sums are moments of depth */
    double known_zeta;
    bool compensate, orthographic;
    uint32_t sh_degree; /* degree that is evaluated */
    const float *frame; /* constants of a frame with appearance, borrowed; NULL: none */
    uint32_t embed_len, hidden;
};

struct ref_splat {
    size_t index; /* row of the gauss */
    /* -- geometry and colour -- */
    double quat[4], quat_len; /* normalised; its length before */
    double rot[9];            /* R of the quaternion, row-major */
    double scale[3];          /* sigma, m */
    double cam[3];            /* t = W mu + d */
    double clamped[2];        /* t'x / z, t'y / z after the clamp */
    bool inside[2];           /* the position was inside the limits */
    double jac[6];            /* J, 2 x 3 row-major, at the clamped position */
    double cov0[3], det0;     /* S0 = J W Sigma W^T J^T: s00, s01, s11 */
    double det;               /* of S = S0 + kernel I */
    double opacity_raw;       /* sigmoid */
    double opacity, rho;      /* opacity: raw, or min(raw + y3, 1); rho: compensation, 1 when off */
    double y[APPEARANCE_OUT]; /* outputs of the appearance network, 0 without */
    double basis[LAYOUT_SH_MAX]; /* Y_k in the direction of view, 0 above the evaluated degree */
    /* before it is clamped from below at 0, and with appearance from above at 1 */
    double rgb_raw[3];
    /* -- what is blended -- */
    double mean_px[2];
    double conic[3];    /* A, B, C of S^-1 */
    double opacity_eff; /* opacity * rho */
    double rgb[3];
    double half_px[2]; /* half-sizes k sqrt(S00), k sqrt(S11), not rounded */
    /* with sums along rays: m = depth + tilt . (mean_px - pixel), in units of depth_unit_m */
    double depth, tilt[2];
    double cov_z[2]; /* covariance of the pixel and the depth, px m */
};

/* Fills in a view. ERR_ARG: camera or options are invalid. */
enum err_code ref_view_init(const struct gauss *g, const struct camera *cam,
                            const struct render_options *o, struct ref_view *out,
                            struct err *e) ERR_USE;
/* The background of a pixel, [3]. */
const double *ref_background(const struct ref_view *v, size_t pixel);
/* Projects Gaussian i. Returns false if it is culled; *out is then unspecified. */
bool ref_project(const struct ref_view *v, const struct gauss *g, size_t i, struct ref_splat *out);
/* Projects all Gaussians and returns the visible splats in the order of blending: by depth as
 * float32, as on the device, then by index. The caller frees *out with mem_free. ERR_MEM. */
enum err_code ref_project_all(const struct ref_view *v, const struct gauss *g,
                              struct ref_splat **out, size_t *n, struct err *e) ERR_USE;
/* Runs Gaussian i through the appearance network. unit [embed_len] is its normalised embedding,
 * hidden [hidden] the hidden layer before the ReLU. Returns the length that the embedding was
 * divided by. */
double ref_appearance(const struct ref_view *v, const struct gauss *g, size_t i, double *unit,
                      double *hidden, double y[APPEARANCE_OUT]);
/* Returns whether a gradient of this channel passes the clamp of the colour. */
bool ref_color_open(const struct ref_view *v, const struct ref_splat *s, int channel);
/* Returns the depth of a splat at an offset d = mean - pixel: the m of render_moments_buffer. */
double ref_depth(const struct ref_splat *s, const double d[2]);
/* What a splat at this depth adds to both sums along the ray of a pixel, over its weight, and the
 * slopes by the depth: see render_moments_buffer. */
struct ref_ray {
    double value[2], slope[2];
};
struct ref_ray ref_ray(const struct ref_view *v, size_t pixel, double depth);
/* How many footprints this depth lies behind the known depth of a pixel; 0: none is known. */
double ref_behind_px(const struct ref_view *v, size_t pixel, double depth);
/* Computes the alpha of a splat at a pixel centre. Returns false if the splat does not contribute
 * there. d = mean - pixel. *clamped: alpha was cut to LAYOUT_ALPHA_MAX. */
bool ref_alpha(const struct ref_splat *s, double px, double py, double d[2], double *alpha,
               bool *clamped);

#endif
