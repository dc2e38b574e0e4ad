/* Definitions that host and kernels share, in the C that OpenCL 1.2 and C17 have in common. The
 * host asserts the sizes, and a test compares them with the device's sizeof.
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
/* Reads or writes 16 values at p with one instruction; p needs no alignment. PoCL's vload16 and
 * vstore16 access single elements, and its compiler seldom joins these accesses. `space` is the
 * address space with its qualifiers, such as const __global. */
typedef float16 layout_float16 __attribute__((aligned(4)));
typedef uint16 layout_uint16 __attribute__((aligned(4)));
typedef ushort16 layout_ushort16 __attribute__((aligned(2)));
typedef uchar16 layout_uchar16 __attribute__((aligned(1)));
#define LAYOUT_WIDE(space, type, p) (*(space layout_##type##16 *)(p))
#endif

#define LAYOUT_LANES 16 /* Gaussians per group of the AoSoA-16 parameter layout */
#define LAYOUT_TILE 16  /* pixels per tile edge */
#define LAYOUT_EDGE 128 /* cells on a side of render_edge */
#define LAYOUT_TILE_PIXELS (LAYOUT_TILE * LAYOUT_TILE)
#define LAYOUT_BANDS 10 /* column ranges in a splat record */

/* Parameters lie in groups of 16 Gaussians, [planes][LAYOUT_LANES] floats a group. Gradients have
 * the same layout, and so have the moments of Adam, one word of 32 bits a parameter
 * (render/adam.cl). The value of plane p of Gaussian i is
 *
 *     params[((i / LAYOUT_LANES) * planes + p) * LAYOUT_LANES + i % LAYOUT_LANES]
 *
 * SH coefficients are coefficient-major: plane LAYOUT_PLANE_SH + 3 k + channel. The last planes are
 * the appearance embedding, if there is one.
 *
 * A model that is only drawn may have its harmonics as halves (IEEE binary16), as a tile's payload
 * has them. Two of their planes then share one of words, and planes of words are counted. Value j =
 * 3 k + channel of the Gaussian at lane l is half 16 j + l of those that begin at plane
 * LAYOUT_PLANE_SH. */
#define LAYOUT_PLANE_MEAN 0     /* x y z in m, relative to the model's origin */
#define LAYOUT_PLANE_SCALE 3    /* ln of the three sigmas in m */
#define LAYOUT_PLANE_QUAT 6     /* w x y z */
#define LAYOUT_PLANE_OPACITY 10 /* logit */
#define LAYOUT_PLANE_SH 11
#define LAYOUT_PLANES_GEOMETRY LAYOUT_PLANE_SH /* planes before the SH planes */
#define LAYOUT_PLANES_SCALE 3
#define LAYOUT_PLANES_SHAPE 7 /* sizes and rotation, from LAYOUT_PLANE_SCALE on */
#define LAYOUT_SH_MAX 16      /* coefficients of degree 3 */

/* Limits of blending (Kerbl et al. 2023). alpha is cut to LAYOUT_ALPHA_MAX. A splat whose alpha is
 * below LAYOUT_ALPHA_MIN is skipped. A pixel stops when its transmittance is
 * LAYOUT_TRANSMITTANCE_MIN or less; the splat that causes this is still blended. */
#define LAYOUT_ALPHA_MAX 0.99f
#define LAYOUT_ALPHA_MIN (1.0f / 255.0f)
#define LAYOUT_ALPHA_MIN_LOG2 (-7.99435343685886f)
#define LAYOUT_TRANSMITTANCE_MIN 1e-4f

/* Sums along a ray about its known depth (ray_values in render/common.cl), in footprints of a
 * pixel. SIDE: so far off side is 1/4, half of its limit. AWAY: nearer light is not away. BEHIND:
 * weight of what is away behind the depth; before it 1. */
#define LAYOUT_SIDE_PX 2.0f
#define LAYOUT_AWAY_PX 0.5f
#define LAYOUT_AWAY_BEHIND 0.4f

/* Outputs of the appearance network (core/splat/appearance.h): offsets of three colours, then of
 * opacity.
 */
#define LAYOUT_APPEARANCE_OUT 4
#define LAYOUT_APPEARANCE_OPACITY 3 /* the fourth output */
/* Sizes for embeddings of `len` numbers and `hidden` units. FLOATS: the constants of a frame, which
 * are weights and biases. ROW: a row of sums of their gradients; it has one more value, for the
 * opacity offsets, and is padded to whole vectors. STRIDE (VW 1): floats of a Gaussian in local
 * memory; it is odd, so that rows begin in different banks. ITEMS (VW 1): work-items of a group. */
#define LAYOUT_APPEARANCE_FLOATS(len, hidden)                                                      \
    ((hidden) * ((len) + 1 + LAYOUT_APPEARANCE_OUT) + LAYOUT_APPEARANCE_OUT)
#define LAYOUT_APPEARANCE_ROW(len, hidden)                                                         \
    ((LAYOUT_APPEARANCE_FLOATS(len, hidden) + 1 + LAYOUT_LANES - 1) / LAYOUT_LANES * LAYOUT_LANES)
#define LAYOUT_APPEARANCE_STRIDE(len, hidden)                                                      \
    (((len) + 2 * (hidden) + LAYOUT_APPEARANCE_OUT + 2) | 1)
#define LAYOUT_APPEARANCE_ITEMS(len, hidden) (LAYOUT_APPEARANCE_STRIDE(len, hidden) > 128 ? 32 : 64)
#define LAYOUT_APPEARANCE_CHUNKS 512 /* number of partial sums of the network's gradient, VW 1 */
/* Work is cut into pieces of fixed size. Sums and orders then do not depend on the number of
 * threads. */
#define LAYOUT_PROJECT_GROUPS 64 /* groups per work-item of per-Gaussian kernels, VW 16 */
#define LAYOUT_SORT_CHUNKS 32
#define LAYOUT_SORT_BITS 11 /* three passes cover a 32-bit key */
/* mask of the low key bits, which hold tile counts after the first pass */
#define LAYOUT_KEY_TILES 2047
#define LAYOUT_BIN_CHUNKS 32
#define LAYOUT_ORDER_ITEMS 256  /* sort and bin, VW 1: work-items of a group */
#define LAYOUT_ORDER_BLOCK 2048 /* values that a work-group handles */
/* bits a pass; seven passes cover a key, and often three are enough */
#define LAYOUT_ORDER_BITS 5
/* count in which sum_scan stores its total; 0: in none */
#define LAYOUT_TOTAL_INTERSECTIONS 1
#define LAYOUT_TOTAL_VISIBLE 2
#define LAYOUT_DET_MAX 1e30f    /* px^4: larger 2-D covariances are culled */
#define LAYOUT_DEPTH_MAX 1e10f  /* m */
#define LAYOUT_EXTENT_MAX 3.33f /* in sigmas: reach of an opaque splat, sqrt(2 ln 255) */
/* least det S0 / det S, so that flat discs seen edge-on stay visible */
#define LAYOUT_RHO2_MIN 2.5e-5f

/* One visible Gaussian in the picture, with all that blending needs. It fills one cache line.
 *
 * With d = mean - pixel centre, alpha = 2^e and
 *
 *     e = opacity_log2 - u^2 - v^2,   u = p (d.x - x_of_y d.y),   v = r d.y
 *
 * This is the quadratic form 1/2 log2(e) d^T S^-1 d in Cholesky form. S is the 2-D covariance with
 * the anti-aliasing kernel:
 *
 *     x_of_y = S01 / S11,   r^2 = log2(e) / (2 S11),   p^2 = log2(e) S11 / (2 det S)
 *
 * A sum of squares stays positive under rounding, even for a long and thin splat.
 *
 * A splat touches the tile rows row0 .. row0 + rows - 1. They are cut into at most LAYOUT_BANDS
 * bands of ceil(rows / LAYOUT_BANDS) tile rows. Band b has two bytes in bands[b / 2], `first` at
 * bit 16 (b & 1) and `last` 8 bits above it. It covers the tile columns from col0 + (first <<
 * shift) to before col0 + ((last + 1) << shift), clipped to the picture. It covers none when last <
 * first.
 *
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
/* Only bin reads cover and bands. In a frame with sums along rays, the same words later hold the
 * plane of the splat, as floats. The splat's depth at a pixel is
 *
 *     m = depth + tilt_x d.x + tilt_y d.y,   d = mean - pixel centre
 *
 * in units of view.depth_unit_m, and relative to that depth. See render/moments.cl. */

/* Constants of a frame: one view of one model. World coordinates here are relative to the model's
 * origin. */
struct layout_view {
    float rot[9];   /* world -> camera, row-major */
    float trans[3]; /* m */
    float eye[3];   /* centre of projection in the world frame, m */
    float fx, fy, cx, cy;
    float lim_neg_x, lim_pos_x, lim_neg_y, lim_pos_y; /* limits of x/z and y/z in the Jacobian */
    float near_m;
    float kernel_px2;  /* added to the diagonal of the 2-D covariance */
    float half_max_px; /* a splat larger than this and nearer than 4 near_m is culled */
    float background[3];
    LAYOUT_U32 width, height, tiles_x, tiles_y;
    /* planes: number in a group of parameters, whatever sh_degree is */
    LAYOUT_U32 n, groups, planes;
    LAYOUT_U32 sh_degree;  /* degree that is evaluated */
    LAYOUT_U32 compensate; /* 1: opacity is multiplied by rho = sqrt(det S0 / det S) */
    LAYOUT_U32 tile_cull;  /* 1: exact tiles of a splat; 0: all tiles of its bounding box */
    LAYOUT_U32 listed;     /* 1: a list names the groups of parameters to draw */
    /* 1: fx and fy are pixels a metre, and all rays have direction rot[6..8] */
    LAYOUT_U32 orthographic;
    float depth_unit_m;   /* unit of sums along rays; 0: the frame has none */
    float known_zeta;     /* above 0: these sums are about known depths, see render_options */
    LAYOUT_U32 sh_halves; /* 1: harmonics are halves */
    /* 1: a frame that no gradients or scores follow. Intersections have no slots and no hits */
    LAYOUT_U32 picture;
    /* px: splats are also listed in tiles that they come so near to; 0: only where they are drawn
     */
    float room_px;
    LAYOUT_U32 again; /* 1: the tile lists are those of an earlier frame */
    /* render_edge: its south-west corner, m from the model's origin; cells a metre, 0: no edge */
    float edge_x, edge_y, edge_cells;
};

/* Word numbers in struct layout_splat, for kernels that move records as vectors. */
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
#define LAYOUT_SPLAT_DEPTH LAYOUT_SPLAT_COVER /* used once the tile lists are made; tilts follow */
#define LAYOUT_SPLAT_WORDS 16

/* Counts that the device finds in a frame. The host reads them once, before the intersections are
 * listed. An intersection is a pair of a splat and a tile that it touches. */
struct layout_counts {
    LAYOUT_U64 intersections;
    /* counts of chunks of Gaussians, later where each chunk starts */
    LAYOUT_U64 chunk_intersections[LAYOUT_SORT_CHUNKS];
    LAYOUT_U32 visible;
    LAYOUT_U32 next_tile; /* VW 16: tiles that blend has begun; nothing depends on who drew one */
    LAYOUT_U32 bin_intersections[LAYOUT_BIN_CHUNKS]; /* counts of chunks of the depth order */
};

/* What the backward pass writes for an intersection: sums over its pixels. See
 * render/blend_backward.cl. */
#define LAYOUT_SLOT_RGB 0 /* dL/d(colour) */
#define LAYOUT_SLOT_Q 3   /* moments of q = dL/d ln alpha in the whitened offset (u, v) */
#define LAYOUT_SLOT_QU 4
#define LAYOUT_SLOT_QV 5
#define LAYOUT_SLOT_QUU 6
#define LAYOUT_SLOT_QUV 7
#define LAYOUT_SLOT_QVV 8
#define LAYOUT_SLOT_ABS 9 /* two: absolute gradients of the mean, px */
/* moments of h = dL/d(depth at a pixel), like those of q; 0: no moments */
#define LAYOUT_SLOT_DEPTH 11
#define LAYOUT_SLOT_DEPTH_U 12
#define LAYOUT_SLOT_DEPTH_V 13
#define LAYOUT_SLOT_FLOATS 14

/* Sums that render_importance_run makes for a Gaussian, and its slots hold. */
#define LAYOUT_IMPORTANCE_WEIGHT 0 /* alpha T times the pixel's weight */
#define LAYOUT_IMPORTANCE_PIXELS 1
#define LAYOUT_IMPORTANCE_SHARE 2 /* alpha T */
#define LAYOUT_REMOVAL_RISE 0     /* of render_removal_run, in the place of the weight */
#define LAYOUT_IMPORTANCE_SUMS 4  /* the last one is 0 */

/* Depth maps of a frame, see render/surface.cl. */
#define LAYOUT_SURFACE_MEDIAN 0
#define LAYOUT_SURFACE_MEAN 1
#define LAYOUT_SURFACE_FRONT 2
#define LAYOUT_SURFACE_NEAR 3
#define LAYOUT_SURFACE_FAR 4
#define LAYOUT_SURFACE_MET 5
#define LAYOUT_SURFACE_MAPS 6
#define LAYOUT_SURFACE_OPEN 0.9f   /* transmittance where a surface begins */
#define LAYOUT_SURFACE_OPAQUE 0.1f /* transmittance where it is opaque */
#define LAYOUT_SURFACE_TILT 7      /* floats a Gaussian: how its depth varies over its ellipse */

/* Losses sum over Gaussians or pixels in this many fixed pieces. */
#define LAYOUT_LOSS_PIECES 256
#define LAYOUT_SCALE_ITEMS 64 /* work-items of a group of train/loss/scale_loss.cl, VW 1 */
/* Pieces of photometric.cl: pixels of a strip, most rows of a band; of its maps (VW 1): margin of a
 * row in floats. */
#define LAYOUT_LOSS_STRIP 160
#define LAYOUT_LOSS_BAND 128
#define LAYOUT_LOSS_MARGIN 16
#define LAYOUT_LOSS_PARTS 4 /* sums of a piece: |x - y|, S, (x - y)^2, 0 */
/* lpips.cl: zeros beside and above a map, then rows and output channels of a work-item. */
#define LAYOUT_LPIPS_MARGIN 16
#define LAYOUT_LPIPS_ROWS 2
#define LAYOUT_LPIPS_CHANNELS 8

struct layout_scale_piece {
    LAYOUT_U32 n, m; /* n: axes longer than s_max; m: Gaussians whose axis ratio is above r_max */
    float size, ratio;
};

/* One step of Adam (Kingma and Ba 2015) with its side tasks: an argument of project_step. */
struct layout_adam {
    /* learning rates divided by the first moment's bias correction */
    float lr_mean, lr_scale, lr_quat, lr_opacity, lr_sh_dc, lr_sh_rest, lr_embed;
    float beta1, beta2, eps;
    float inv_bias2;       /* 1 / sqrt(bias correction of the second moment) */
    float inv_bias2_embed; /* the same for embeddings, whose training may have begun later */
    float scale_log_min, scale_log_max;
    /* Half the picture's size, at most 1600 px. Gradients per pixel times this are gradients per
     * unit of normalised device coordinates, the unit of densification thresholds. */
    float half_width, half_height;
    LAYOUT_U32 wants; /* LAYOUT_STEP_*; buffers for other tasks are not read */
    LAYOUT_U32 step;  /* from 1; moments are rounded by it */
};
/* add extra gradients of sizes and rotation, [groups][LAYOUT_PLANES_SHAPE][16] */
#define LAYOUT_STEP_EXTRA 1
#define LAYOUT_STEP_STATS 4    /* collect densification statistics; the next two need it */
#define LAYOUT_STEP_ABS 8      /* also absolute gradients of positions (AbsGS) */
#define LAYOUT_STEP_OPACITY 16 /* also the largest opacity that was drawn */

/* render/defer.cl: a row of its table. W of each learning rate; how far means, ln sigma and opacity
 * logits drift at most, times their speed; powers of both betas. */
#define LAYOUT_DEFER_MEAN 0
#define LAYOUT_DEFER_SCALE 1
#define LAYOUT_DEFER_QUAT 2
#define LAYOUT_DEFER_OPACITY 3
#define LAYOUT_DEFER_SH_DC 4
#define LAYOUT_DEFER_SH_REST 5
#define LAYOUT_DEFER_RATES 6
#define LAYOUT_DEFER_DRIFT 6 /* three */
#define LAYOUT_DEFER_DECAY 9 /* two */
#define LAYOUT_DEFER_ROW 12
#define LAYOUT_DEFER_CHUNKS 64
/* planes of a group's bounds: centre and half-sizes of the box of its means, largest reach, m */
#define LAYOUT_DEFER_BOUND 7
#define LAYOUT_DEFER_SIGMAS 3.34f /* a little more than LAYOUT_EXTENT_MAX */

#ifndef __OPENCL_C_VERSION__
static_assert(sizeof(struct layout_splat) == 64 && LAYOUT_SPLAT_WORDS == 16,
              "one cache line a splat, one vector");
static_assert(offsetof(struct layout_splat, p) == 4 * LAYOUT_SPLAT_P &&
                  offsetof(struct layout_splat, rgb) == 4 * LAYOUT_SPLAT_RGB &&
                  offsetof(struct layout_splat, y_of_x) == 4 * LAYOUT_SPLAT_Y_OF_X &&
                  offsetof(struct layout_splat, bands) == 4 * LAYOUT_SPLAT_BANDS,
              "words of a record");
static_assert(LAYOUT_PLANES_GEOMETRY == LAYOUT_PLANE_OPACITY + 1, "opacity is the last before SH");
static_assert(sizeof(struct layout_adam) == 18 * 4, "no padding: an argument of a kernel");
static_assert(sizeof(struct layout_counts) == 8 * (2 + LAYOUT_SORT_CHUNKS) + 4 * LAYOUT_BIN_CHUNKS,
              "no padding");
static_assert(sizeof(struct layout_view) == 50 * 4, "no padding: kernels read the same words");

/* Number of planes of a group of parameters. Embeddings begin at plane layout_planes(sh_degree, 0).
 */
static inline uint32_t layout_planes(uint32_t sh_degree, uint32_t embed_len)
{
    return LAYOUT_PLANE_SH + 3 * (sh_degree + 1) * (sh_degree + 1) + embed_len;
}
/* The same where harmonics are halves. */
static inline uint32_t layout_planes_halves(uint32_t sh_degree, uint32_t embed_len)
{
    return LAYOUT_PLANE_SH + (3 * (sh_degree + 1) * (sh_degree + 1) + 1) / 2 + embed_len;
}
/* Index of a row's value in plane 0. */
static inline size_t layout_at(size_t row, uint32_t planes)
{
    return row / LAYOUT_LANES * planes * LAYOUT_LANES + row % LAYOUT_LANES;
}
/* Number of floats, or words of moments, of an array with n rows. */
static inline size_t layout_floats(size_t n, uint32_t planes)
{
    return (n + LAYOUT_LANES - 1) / LAYOUT_LANES * planes * LAYOUT_LANES;
}
#endif

#endif
