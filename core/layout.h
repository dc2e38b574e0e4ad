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
#define LAYOUT_BANDS 10 /* column ranges in a splat record */
/* Work is cut into fixed pieces, never by the number of threads: orders and sums must not vary. */
#define LAYOUT_PROJECT_GROUPS 64 /* groups per work-item of per-Gaussian kernels, VW 16 */
#define LAYOUT_SORT_CHUNKS 32
#define LAYOUT_SORT_BITS 11   /* three passes cover a 32-bit key */
#define LAYOUT_KEY_TILES 2047 /* low key bits: spent after the first pass, then tile counts */
#define LAYOUT_BIN_CHUNKS 32
#define LAYOUT_ORDER_ITEMS 256  /* sort and bin, VW 1: items of a work-group, */
#define LAYOUT_ORDER_BLOCK 2048 /* values of a work-group, */
#define LAYOUT_ORDER_BITS 5     /* bits a pass: seven cover a key, and end where three do */
#define LAYOUT_TOTAL_ENTRIES 1  /* what the total of a sum_scan is; 0: nothing of use */
#define LAYOUT_TOTAL_VISIBLE 2
#define LAYOUT_APPEARANCE_CHUNKS 512 /* partial sums of the appearance network, VW 1 */
#define LAYOUT_DET_MAX 1e30f         /* px^4: larger 2-D covariances are culled */
#define LAYOUT_DEPTH_MAX 1e10f       /* m */
#define LAYOUT_EXTENT_MAX 3.33f      /* sigmas; sqrt(2 ln 255), the reach of an opaque splat */
#define LAYOUT_RHO2_MIN 2.5e-5f      /* floor of det S0 / det S: flat discs seen edge-on stay */

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
};

/* Counts that the device finds in a frame; the host reads them once, before the entry lists are
 * made. */
struct layout_counts {
    LAYOUT_U64 entries;                           /* (splat, tile) pairs */
    LAYOUT_U64 chunk_entries[LAYOUT_SORT_CHUNKS]; /* of chunks of Gaussians; then their starts */
    LAYOUT_U32 visible, unused;
    LAYOUT_U32 bin_pairs[LAYOUT_BIN_CHUNKS]; /* entries of each chunk of the depth order */
};

/* What one (splat, tile) pair leaves behind in the backward pass, see render/blend_backward.cl. */
#define LAYOUT_SLOT_FLOATS 11

#ifndef __OPENCL_C_VERSION__
static_assert(sizeof(struct layout_splat) == 64, "one cache line a splat");
static_assert(sizeof(struct layout_counts) == 8 * (2 + LAYOUT_SORT_CHUNKS) + 4 * LAYOUT_BIN_CHUNKS,
              "no padding");
static_assert(sizeof(struct layout_view) == 42 * 4, "no padding: kernels read the same words");
#endif

#endif
