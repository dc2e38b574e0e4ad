/* Inside of the reference: one Gaussian on the screen, in double, for render_ref.c and
 * render_ref_backward.c. Names follow the EWA splatting derivation (Zwicker et al. 2001; Kerbl et
 * al. 2023); formulas are written where they are computed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef RENDER_RENDER_REF_H
#define RENDER_RENDER_REF_H

#include "core/appearance.h"
#include "render/render.h"

struct ref_view {            /* a camera and options with every default resolved */
    double rot[9], trans[3]; /* model frame -> camera; trans holds the model's origin */
    double eye[3];           /* centre of projection, relative to the model's origin */
    double fx, fy, cx, cy;
    uint32_t width, height;
    double lim_neg[2], lim_pos[2]; /* clamp of x/z, y/z inside the Jacobian */
    double near_m, kernel_px2, half_max_px;
    double background[3];
    const uint8_t *background_where; /* borrowed; NULL: nowhere */
    double background_there[3];
    double depth_unit_m; /* of moments of depth; 0: none */
    bool compensate, orthographic;
    uint32_t sh_degree; /* evaluated */
    const float *frame; /* constants of an appearance, borrowed; NULL: none */
    uint32_t embed_len, hidden;
};

struct ref_splat {
    size_t index; /* row of the gauss */
    /* projected */
    double quat[4], quat_len;    /* normalised; length before */
    double rot[9];               /* R of the quaternion, row-major */
    double scale[3];             /* sigma, m */
    double cam[3];               /* t = W mu + d */
    double clamped[2];           /* t'x / z, t'y / z after the clamp */
    bool inside[2];              /* the clamp did nothing */
    double jac[6];               /* J, 2 x 3 row-major, at the clamped position */
    double cov0[3], det0;        /* S0 = J W Sigma W^T J^T: s00, s01, s11 */
    double det;                  /* of S = S0 + kernel I */
    double opacity_raw;          /* sigmoid */
    double opacity, rho;         /* as drawn: raw, or min(raw + y3, 1); compensation (1 when off) */
    double y[APPEARANCE_OUT];    /* of the appearance, 0 without */
    double basis[LAYOUT_SH_MAX]; /* Y_k at the view direction, 0 above the evaluated degree */
    double rgb_raw[3];           /* before the clamp: from 0, with appearance to 1 */
    /* what is blended */
    double mean_px[2];
    double conic[3];    /* A, B, C of S^-1 */
    double opacity_eff; /* opacity * rho */
    double rgb[3];
    double half_px[2]; /* unrounded half-sizes k sqrt(S00), k sqrt(S11) */
    /* With moments of depth: m = depth + tilt . (mean_px - pixel), in units of depth_unit_m */
    double depth, tilt[2];
    double cov_z[2]; /* covariance of the pixel and the depth, px m */
};

/* ERR_ARG when the camera or the options make no picture. */
enum err_code ref_view_init(const struct gauss *g, const struct camera *cam,
                            const struct render_options *o, struct ref_view *out,
                            struct err *e) ERR_USE;
/* The background behind a pixel, [3]. */
const double *ref_background(const struct ref_view *v, size_t pixel);
/* False when Gaussian i is culled; *out is unspecified then. */
bool ref_project(const struct ref_view *v, const struct gauss *g, size_t i, struct ref_splat *out);
/* All visible splats in blending order: by depth as float32 (what the device sorts by), ties by
 * index. *out: caller frees with mem_free. ERR_MEM. */
enum err_code ref_project_all(const struct ref_view *v, const struct gauss *g,
                              struct ref_splat **out, size_t *n, struct err *e) ERR_USE;
/* One Gaussian through the network: its embedding normalised (returns the divisor), the hidden
 * layer before the ReLU, and y. The arrays hold embed_len and hidden values. */
double ref_appearance(const struct ref_view *v, const struct gauss *g, size_t i, double *unit,
                      double *hidden, double y[APPEARANCE_OUT]);
/* The splat's colour passes a gradient on. */
bool ref_color_open(const struct ref_view *v, const struct ref_splat *s, int channel);
/* The depth of a splat at an offset d = mean - pixel: m of render_moments_buffer. */
double ref_depth(const struct ref_splat *s, const double d[2]);
/* Exponent and alpha of a splat at a pixel centre; false when it does not contribute there. d =
 * mean - pixel; *clamped tells that alpha was cut to LAYOUT_ALPHA_MAX. */
bool ref_alpha(const struct ref_splat *s, double px, double py, double d[2], double *alpha,
               bool *clamped);
/* Real spherical harmonics basis, INRIA's signs, up to `degree`; dir is normalised. */
void ref_sh_basis(const double dir[3], uint32_t degree, double out[LAYOUT_SH_MAX]);

#endif
