/* What host and kernels share: plain C that both an OpenCL 1.2 and a C17 compiler read. Sizes are
 * asserted on the host; a test asks the device for its own sizeof.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_LAYOUT_H
#define CORE_LAYOUT_H

#ifdef __OPENCL_C_VERSION__
#define LAYOUT_U32 uint
#define LAYOUT_U64 ulong
#else
#include <assert.h>
#include <stddef.h>
#include <stdint.h>
#define LAYOUT_U32 uint32_t
#define LAYOUT_U64 uint64_t
#endif

#if defined(__OPENCL_C_VERSION__) && VW == 16
/* 16 values at p, which may lie anywhere, in one instruction: vload16 and vstore16 of PoCL are made
 * of single elements, which its compiler puts together again in pieces of four more often than not.
 * space: with its qualifiers, as const __global. */
typedef float16 layout_float16 __attribute__((aligned(4)));
typedef uint16 layout_uint16 __attribute__((aligned(4)));
typedef uchar16 layout_uchar16 __attribute__((aligned(1)));
#define LAYOUT_WIDE(space, type, p) (*(space layout_##type##16 *)(p))
#endif

#define LAYOUT_LANES 16 /* Gaussians per group of the AoSoA-16 parameter layout */
#define LAYOUT_TILE 16  /* pixels per tile edge */
#define LAYOUT_TILE_PIXELS (LAYOUT_TILE * LAYOUT_TILE)
#define LAYOUT_BANDS 10 /* column ranges in a splat record */

/* Planes of a group of parameters, [planes][LAYOUT_LANES] floats; gradients and moments have the
 * same. Value of plane p of Gaussian i:
 *     params[((i / LAYOUT_LANES) * planes + p) * LAYOUT_LANES + i % LAYOUT_LANES]
 * SH coefficients are coefficient-major, plane LAYOUT_PLANE_SH + 3 k + channel; the appearance
 * embedding, if any, is the last planes. */
#define LAYOUT_PLANE_MEAN 0     /* x y z, m, relative to the model's origin */
#define LAYOUT_PLANE_SCALE 3    /* ln of three sigmas in m */
#define LAYOUT_PLANE_QUAT 6     /* w x y z */
#define LAYOUT_PLANE_OPACITY 10 /* logit */
#define LAYOUT_PLANE_SH 11
#define LAYOUT_PLANES_GEOMETRY LAYOUT_PLANE_SH /* planes before those of SH */
#define LAYOUT_PLANES_SCALE 3
#define LAYOUT_SH_MAX 16 /* coefficients of degree 3 */

/* Blending (Kerbl et al. 2023): alpha is cut to LAYOUT_ALPHA_MAX, a splat is skipped where alpha is
 * below LAYOUT_ALPHA_MIN, and a pixel stops once its transmittance is not above
 * LAYOUT_TRANSMITTANCE_MIN; the splat that brings it there is still blended. */
#define LAYOUT_ALPHA_MAX 0.99f
#define LAYOUT_ALPHA_MIN (1.0f / 255.0f)
#define LAYOUT_ALPHA_MIN_LOG2 (-7.99435343685886f)
#define LAYOUT_TRANSMITTANCE_MIN 1e-4f

/* Outputs of the appearance network, see core/appearance.h: offsets of three colours and of */
#define LAYOUT_APPEARANCE_OUT 4
#define LAYOUT_APPEARANCE_OPACITY 3 /* opacity */
/* Constants of a frame for embeddings of `len` and `hidden` units: weights, biases; a row of sums
 * of their gradients has one more, that of the opacity offsets, and is whole vectors long. VW 1: a
 * Gaussian's row in local memory, an odd length so that rows begin in different banks, and
 * work-items of a group. */
#define LAYOUT_APPEARANCE_FLOATS(len, hidden)                                                      \
    ((hidden) * ((len) + 1 + LAYOUT_APPEARANCE_OUT) + LAYOUT_APPEARANCE_OUT)
#define LAYOUT_APPEARANCE_ROW(len, hidden)                                                         \
    ((LAYOUT_APPEARANCE_FLOATS(len, hidden) + 1 + LAYOUT_LANES - 1) / LAYOUT_LANES * LAYOUT_LANES)
#define LAYOUT_APPEARANCE_STRIDE(len, hidden)                                                      \
    (((len) + 2 * (hidden) + LAYOUT_APPEARANCE_OUT + 2) | 1)
#define LAYOUT_APPEARANCE_ITEMS(len, hidden) (LAYOUT_APPEARANCE_STRIDE(len, hidden) > 128 ? 32 : 64)
#define LAYOUT_APPEARANCE_CHUNKS 512 /* partial sums of the network, VW 1 */
/* Work is cut into fixed pieces, never by the number of threads: orders and sums must not vary. */
#define LAYOUT_PROJECT_GROUPS 64 /* groups per work-item of per-Gaussian kernels, VW 16 */
#define LAYOUT_SORT_CHUNKS 32
#define LAYOUT_SORT_BITS 11   /* three passes cover a 32-bit key */
#define LAYOUT_KEY_TILES 2047 /* low key bits: spent after the first pass, then tile counts */
#define LAYOUT_BIN_CHUNKS 32
#define LAYOUT_ORDER_ITEMS 256       /* sort and bin, VW 1: items of a work-group, */
#define LAYOUT_ORDER_BLOCK 2048      /* values of a work-group, */
#define LAYOUT_ORDER_BITS 5          /* bits a pass: seven cover a key, and end where three do */
#define LAYOUT_TOTAL_INTERSECTIONS 1 /* what the total of a sum_scan is; 0: nothing of use */
#define LAYOUT_TOTAL_VISIBLE 2
#define LAYOUT_DET_MAX 1e30f    /* px^4: larger 2-D covariances are culled */
#define LAYOUT_DEPTH_MAX 1e10f  /* m */
#define LAYOUT_EXTENT_MAX 3.33f /* sigmas; sqrt(2 ln 255), the reach of an opaque splat */
#define LAYOUT_RHO2_MIN 2.5e-5f /* floor of det S0 / det S: flat discs seen edge-on stay */

/* One visible Gaussian on the screen: what blending needs, one cache line.
 *
 * With d = mean - pixel centre, the exponent of its falloff in powers of two is
 *     e = opacity_log2 - u^2 - v^2,   u = p (d.x - x_of_y d.y),   v = r d.y,      alpha = 2^e,
 * that is the quadratic form 1/2 log2(e) d^T S^-1 d in Cholesky form, S the 2-D covariance with the
 * anti-aliasing kernel: x_of_y = S01/S11, r^2 = log2(e) / (2 S11), p^2 = log2(e) S11 / (2 det S). A
 * sum of squares cannot turn negative by rounding, however long and thin the splat is.
 *
 * The tiles it touches: rows row0 .. row0 + rows - 1 are cut into at most LAYOUT_BANDS bands of
 * ceil(rows / LAYOUT_BANDS) tile rows; band b has a first and a last byte, at bit 16 (b & 1) and 8
 * above of bands[b / 2], and covers the columns from col0 + (first << shift) to before
 * col0 + ((last + 1) << shift), clipped to the picture, none where first > last.
 *     cover = row0 | col0 << 10 | (rows - 1) << 20 | shift << 30 */
struct layout_splat {
    float mean_x, mean_y; /* px */
    float p, x_of_y, r;
    float opacity_log2;
    float rgb[3]; /* >= 0 */
    float y_of_x; /* S01/S00: for a fixed d.x, e is largest at d.y = y_of_x d.x */
    LAYOUT_U32 cover;
    LAYOUT_U32 bands[LAYOUT_BANDS / 2];
};
/* Nobody reads cover and bands once the tile lists exist. In a frame with moments of depth they
 * then hold, as floats, the plane of the splat: its depth at a pixel is
 *     m = depth + tilt_x d.x + tilt_y d.y,   d = mean - pixel centre,
 * in units of view.depth_unit_m and relative to that depth. See render/moments.cl. */

/* One view of one model: constants of a frame. World means here: relative to the model's origin. */
struct layout_view {
    float rot[9];   /* world -> camera, row-major */
    float trans[3]; /* m */
    float eye[3];   /* centre of projection, world, m */
    float fx, fy, cx, cy;
    float lim_neg_x, lim_pos_x, lim_neg_y, lim_pos_y; /* clamp of x/z and y/z inside the Jacobian */
    float near_m;
    float kernel_px2;  /* added to the diagonal of the 2-D covariance */
    float half_max_px; /* culled when larger than this and nearer than 4 near_m */
    float background[3];
    LAYOUT_U32 width, height, tiles_x, tiles_y;
    LAYOUT_U32 n, groups, planes; /* planes of a group of parameters, whatever sh_degree says */
    LAYOUT_U32 sh_degree;         /* evaluated */
    LAYOUT_U32 compensate;        /* 1: opacity times rho = sqrt(det S0 / det S) */
    LAYOUT_U32 tile_cull;         /* 0: tiles of the bounding box instead of the exact ones */
    LAYOUT_U32 smooth;            /* 1: Gaussians are widened by a 3-D filter each */
    LAYOUT_U32 listed;            /* 1: a list says which groups of parameters these are */
    LAYOUT_U32 orthographic;      /* 1: fx, fy are px a metre, all rays are rot[6..8] */
    float depth_unit_m;           /* of moments of depth; 0: the frame has none */
};

/* Words of struct layout_splat where kernels move records as vectors. */
#define LAYOUT_SPLAT_MEAN_X 0
#define LAYOUT_SPLAT_MEAN_Y 1
#define LAYOUT_SPLAT_P 2
#define LAYOUT_SPLAT_X_OF_Y 3
#define LAYOUT_SPLAT_R 4
#define LAYOUT_SPLAT_OPACITY_LOG2 5
#define LAYOUT_SPLAT_RGB 6
#define LAYOUT_SPLAT_Y_OF_X 9
#define LAYOUT_SPLAT_COVER 10
#define LAYOUT_SPLAT_BANDS 11
#define LAYOUT_SPLAT_DEPTH LAYOUT_SPLAT_COVER /* after the tile lists; tilts follow */
#define LAYOUT_SPLAT_WORDS 16

/* Counts that the device finds in a frame; the host reads them once, before the lists of
 * intersections are made. An intersection is a splat in a tile that it touches. */
struct layout_counts {
    LAYOUT_U64 intersections;
    LAYOUT_U64 chunk_intersections[LAYOUT_SORT_CHUNKS]; /* of chunks of Gaussians, then starts */
    LAYOUT_U32 visible, unused;
    LAYOUT_U32 bin_intersections[LAYOUT_BIN_CHUNKS]; /* of chunks of the depth order */
};

/* What an intersection leaves in its slot in the backward pass, see render/blend_backward.cl: sums
 * over its pixels. */
#define LAYOUT_SLOT_RGB 0 /* dL/d of the colour */
#define LAYOUT_SLOT_Q 3   /* moments of q = dL/d ln alpha in the whitened offset (u, v) */
#define LAYOUT_SLOT_QU 4
#define LAYOUT_SLOT_QV 5
#define LAYOUT_SLOT_QUU 6
#define LAYOUT_SLOT_QUV 7
#define LAYOUT_SLOT_QVV 8
#define LAYOUT_SLOT_ABS 9 /* two moduli of the gradient of the mean in pixels */
#define LAYOUT_SLOT_DEPTH 11 /* moments of dL/d of the depth at a pixel, as of q; 0 without */
#define LAYOUT_SLOT_DEPTH_U 12
#define LAYOUT_SLOT_DEPTH_V 13
#define LAYOUT_SLOT_FLOATS 14

/* What render_importance_run sums for a Gaussian: its slots hold the first
 * LAYOUT_IMPORTANCE_SLOT. */
#define LAYOUT_IMPORTANCE_WEIGHT 0
#define LAYOUT_IMPORTANCE_PIXELS 1
#define LAYOUT_IMPORTANCE_SHARE 2    /* alpha T */
#define LAYOUT_IMPORTANCE_DISTANCE 3 /* of the pixel from the mean, px */
#define LAYOUT_IMPORTANCE_SLOT 4
#define LAYOUT_IMPORTANCE_DEPTH 4  /* m */
#define LAYOUT_IMPORTANCE_RADIUS 5 /* px */
#define LAYOUT_IMPORTANCE_SUMS 8   /* the last two are 0 */

/* Maps of a frame's depth, see render/surface.cl. */
#define LAYOUT_SURFACE_MEDIAN 0
#define LAYOUT_SURFACE_MEAN 1
#define LAYOUT_SURFACE_FRONT 2
#define LAYOUT_SURFACE_MAPS 3
#define LAYOUT_SURFACE_TILT 7 /* floats of a Gaussian: how its depth varies over its ellipse */

/* Losses: sums over Gaussians or pixels are taken in this many fixed pieces. */
#define LAYOUT_LOSS_PIECES 256
#define LAYOUT_SCALE_ITEMS 64                     /* of a work-group of loss/scale_loss.cl, VW 1 */
#define LAYOUT_DEPTH_PLANES (LAYOUT_PLANE_SH + 3) /* of the shadow model of loss/depth.cl */
/* Pieces of photometric.cl: pixels of a strip, rows of a band, floats beside a row of the maps. */
#define LAYOUT_LOSS_STRIP 64
#define LAYOUT_LOSS_BAND 64
#define LAYOUT_LOSS_MARGIN 16
#define LAYOUT_LOSS_PARTS 4 /* sums of a piece: |x - y|, S, (x - y)^2, 0 */
/* Maps of lpips.cl: zeros beside and above a picture; output channels of a work-item. */
#define LAYOUT_LPIPS_MARGIN 16
#define LAYOUT_LPIPS_ROWS 2
#define LAYOUT_LPIPS_CHANNELS 8
#define LAYOUT_MIP_NEAR_M 0.01f /* loss/mip.cl: a camera sees what is beyond, in its picture */
#define LAYOUT_MIP_GROW 0.15f   /* grown by this much of its size */

struct layout_scale_piece {
    LAYOUT_U32 n, m; /* axes longer than s_max, Gaussians with a ratio above r_max */
    float size, ratio;
};

struct layout_mip_camera { /* trans: relative to the model's origin */
    float rot[9], trans[3], fx, fy, cx, cy, width, height;
};

/* One step of Adam (Kingma and Ba 2015) and what goes with it: an argument of project_step. */
struct layout_adam {
    /* Learning rates over the first moment's bias correction. */
    float lr_mean, lr_scale, lr_quat, lr_opacity, lr_sh_dc, lr_sh_rest, lr_embed;
    float beta1, beta2, eps;
    float inv_bias2;       /* 1 / sqrt of the second moment's bias correction */
    float inv_bias2_embed; /* the same of the embeddings, which may have started later */
    float scale_log_min, scale_log_max;
    /* Half the picture, px (at most 1600): pixel gradients times these are per unit of normalised
     * device coordinates, which is what densification thresholds are stated in. */
    float half_width, half_height;
    LAYOUT_U32 wants; /* LAYOUT_STEP_*; buffers of what it does not name are not read */
};
#define LAYOUT_STEP_EXTRA 1       /* add extra gradients [groups][LAYOUT_PLANES_GEOMETRY][16], */
#define LAYOUT_STEP_EXTRA_SCALE 2 /* or [groups][LAYOUT_PLANES_SCALE][16] of the scales alone */
#define LAYOUT_STEP_STATS 4       /* densification statistics; with them: */
#define LAYOUT_STEP_ABS 8         /* moduli of the positional gradients (AbsGS) */
#define LAYOUT_STEP_OPACITY 16    /* the largest opacity drawn */

#ifndef __OPENCL_C_VERSION__
static_assert(sizeof(struct layout_splat) == 64 && LAYOUT_SPLAT_WORDS == 16,
              "one cache line a splat, one vector");
static_assert(offsetof(struct layout_splat, p) == 4 * LAYOUT_SPLAT_P &&
                  offsetof(struct layout_splat, rgb) == 4 * LAYOUT_SPLAT_RGB &&
                  offsetof(struct layout_splat, y_of_x) == 4 * LAYOUT_SPLAT_Y_OF_X &&
                  offsetof(struct layout_splat, bands) == 4 * LAYOUT_SPLAT_BANDS,
              "words of a record");
static_assert(LAYOUT_PLANES_GEOMETRY == LAYOUT_PLANE_OPACITY + 1, "opacity is the last before SH");
static_assert(sizeof(struct layout_adam) == 17 * 4, "no padding: an argument of a kernel");
static_assert(sizeof(struct layout_counts) == 8 * (2 + LAYOUT_SORT_CHUNKS) + 4 * LAYOUT_BIN_CHUNKS,
              "no padding");
static_assert(sizeof(struct layout_view) == 43 * 4, "no padding: kernels read the same words");
#endif

#endif
