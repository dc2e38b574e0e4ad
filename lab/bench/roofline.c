/* Bytes and multiply-adds of each kernel: one row a kernel. See roofline.h.
 *
 * Bytes: each input of a kernel is read once and each output written once, as the triad counts
 * them. What a kernel reads again while a cache still has it counts once, and nothing counts for
 * lines of which only a part is used. Real traffic is never less.
 *
 * Multiply-adds: of lanes, not of vectors. a * b + c is one, so is a product or a sum that stands
 * alone. Comparisons, choices, integers, conversions and shuffles are not counted. Common terms of
 * a loop count once. So a kernel that reaches its limit does nothing but arithmetic.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/roofline.h"

#include <math.h>
#include <string.h>

#include "core/layout.h"

/* ---- arithmetic that is no multiply-add ---- */

/* How many multiply-adds of 16 lanes a core of Zen 4 makes in the time of one division or root
 * (VDIVPS, VSQRTPS of 512 bits; measured on the machine of lab/studies/roofline.md: 0.270, 1.62
 * and 2.73 ns). Machines differ. */
#define DIVIDE 6.0
#define ROOT 10.0
#define EXP2 8.0     /* exp2_v of common.cl: 2 sums and 1 for the fraction, 5 of the polynomial */
#define EXP_LOG 12.0 /* exp and log of the compiler's library: reduction 3, polynomial 6, and 3 */

/* ---- parts that kernels share; a lane each ---- */
#define LANES 16.0
#define PARAMETERS ((double)(LAYOUT_PLANES_GEOMETRY + 3 * LAYOUT_SH_MAX))
#define SH_PLANES (3.0 * LAYOUT_SH_MAX)
/* a parameter and both of its moments */
#define STATE_BYTES (4.0 + 2.0 * ROOFLINE_MOMENT_BYTES)
/* common.cl: seen_mean: three rows of three */
#define MEAN 9.0
/* common.cl: seen_ellipse: rotation 35, Jacobian 16, P 24, S 23, opacity and compensation 2; four
 * exp; divisions: 1 / z, 1 / |q|, opacity, det S0 / det S; roots: |q|, rho */
#define ELLIPSE (100.0 + 4.0 * EXP_LOG + 4.0 * DIVIDE + 2.0 * ROOT)
/* common.cl: seen_direction: 9, 1 / sqrt; sh_basis of degree 3: 38 */
#define BASIS (9.0 + 38.0 + DIVIDE + ROOT)
/* common.cl: splat_raw: u 2, v 1, e 2 */
#define RAW (5.0 + EXP2)
/* project.cl: the mean in pixels 4; project_outline: 12 and a log, 3 divisions, 4 roots;
 * project_tiles: 17 and a division, of one band 20 and 2 roots */
#define OUTLINE (53.0 + EXP_LOG + 4.0 * DIVIDE + 6.0 * ROOT)
/* project_backward.cl: ellipse_of 53, 5 divisions, 2 roots; ellipse_axes 3 x 51; ellipse_mean 33;
 * ellipse_quat 25, 1 division; ellipse_radius 4, a log, 2 roots; the rest 5 */
#define CHAIN (MEAN + ELLIPSE + 273.0 + EXP_LOG + 6.0 * DIVIDE + 4.0 * ROOT)
/* adam_plane: what is owed 2, n1 2, n2 3, the new value 3 */
#define ADAM (10.0 + DIVIDE + ROOT)
/* photometric.cl: a horizontal blur of one map at one pixel, and half of blur_column: the middle,
 * then a sum and a multiply-add for each of five pairs */
#define BLUR 11.0

/* Bytes of the sort's histogram: a row a chunk, and one of sums; of the tables of bin: a row a
 * chunk. */
#define HISTOGRAM_ROW (4.0 * (1 << LAYOUT_SORT_BITS))
#define HISTOGRAM (HISTOGRAM_ROW * LAYOUT_SORT_CHUNKS)
#define BIN_TABLE(w) (4.0 * LAYOUT_BIN_CHUNKS * (w)->tiles)
#define SLOT_BYTES (4.0 * LAYOUT_SLOT_FLOATS)

typedef struct roofline_work work;

static double roofline_none(const work *w)
{
    (void)w;
    return 0.0;
}

/* ---- project.cl ---- */

/* Geometry of all, harmonics where one of a group is visible; a record of each visible, a key and
 * a count of all. */
static double roofline_project_bytes(const work *w)
{
    return 44.0 * w->n + 4.0 * SH_PLANES * w->grouped + 64.0 * w->visible + 8.0 * w->n;
}

/* Groups that are culled on the way do a part of it, which is not counted. */
static double roofline_project_ops(const work *w)
{
    return MEAN * w->n + (ELLIPSE + OUTLINE + BASIS + SH_PLANES) * w->grouped;
}

/* ---- sort.cl, three passes; order_gpu.cl ---- */

static double roofline_sort_count_bytes(const work *w)
{
    return 8.0 * w->n + 2.0 * 4.0 * w->visible + 3.0 * HISTOGRAM;
}

static double roofline_sort_scan_bytes(const work *w)
{
    (void)w;
    return 3.0 * 2.0 * (HISTOGRAM + HISTOGRAM_ROW);
}

/* The first pass reads keys and counts of all, writes the slots of all and keys and indices of what
 * is visible. */
static double roofline_sort_scatter_bytes(const work *w)
{
    return 12.0 * w->n + 8.0 * w->visible + 2.0 * 16.0 * w->visible +
           3.0 * (HISTOGRAM + HISTOGRAM_ROW);
}

/* Passes over the number of a tile. */
static double roofline_tile_passes(const work *w)
{
    return ceil(log2(w->tiles) / LAYOUT_ORDER_BITS);
}

static double roofline_sum_blocks_bytes(const work *w)
{
    return 4.0 * w->n + 8.0 * w->visible;
}

/* Read and written: a word a block, and 32 of each radix pass. */
static double roofline_sum_scan_bytes(const work *w)
{
    const double digits = 1 << LAYOUT_ORDER_BITS,
                 sorted = w->n + 6.0 * w->visible + roofline_tile_passes(w) * w->lists;
    return 8.0 * (w->n + w->visible + digits * sorted) / LAYOUT_ORDER_BLOCK;
}

static double roofline_sum_apply_bytes(const work *w)
{
    return 8.0 * w->n + 12.0 * w->visible;
}

static double roofline_radix_count_bytes(const work *w)
{
    return 4.0 * w->n + 6.0 * 4.0 * w->visible + roofline_tile_passes(w) * 4.0 * w->lists;
}

static double roofline_radix_scatter_bytes(const work *w)
{
    return 4.0 * w->n + 8.0 * w->visible + 6.0 * 16.0 * w->visible + 12.0 * w->lists +
           (roofline_tile_passes(w) - 1.0) * 16.0 * w->lists;
}

/* ---- bin.cl ---- */

static double roofline_bin_total_bytes(const work *w)
{
    return 4.0 * w->visible;
}

/* Index, record and slot of each splat; tile, splat and slot of each intersection. VW 16 also
 * counts them: what it reads again fits the cache. */
static double roofline_bin_expand_bytes(const work *w)
{
    return 72.0 * w->visible + 12.0 * w->lists + (w->gpu ? 0.0 : BIN_TABLE(w));
}

static double roofline_bin_sum_bytes(const work *w)
{
    return 2.0 * BIN_TABLE(w) + 4.0 * w->tiles;
}

static double roofline_bin_scan_bytes(const work *w)
{
    return 8.0 * w->tiles;
}

static double roofline_bin_scatter_bytes(const work *w)
{
    return 12.0 * w->lists + 8.0 * w->lists + 2.0 * BIN_TABLE(w) + 4.0 * w->tiles;
}

static double roofline_bin_gather_bytes(const work *w)
{
    return 16.0 * w->lists + 8.0 * w->lists;
}

/* ---- blend_cpu.cl, blend_gpu.cl, blend_backward.cl ---- */

/* VW 16: a record comes from memory once, however many tiles it is in: neighbours in the lists of
 * neighbouring tiles are in a cache. VW 1: at most once a tile. */
static double roofline_records(const work *w, double entries)
{
    return 64.0 * (w->gpu || entries < w->visible ? entries : w->visible);
}

static double roofline_blend_bytes(const work *w)
{
    const double entries = w->gpu ? w->lists : w->entries;
    return roofline_records(w, entries) + 4.0 * entries + 2.0 * entries + 16.0 * w->pixels +
           (w->gpu ? 0.0 : 8.0 * w->tiles);
}

/* blend_splat: offsets 2, share, transmittance, three colours; blend_masks: 3 and, of four rows 20,
 * four columns 12, sixteen blocks 128; the background */
static double roofline_blend_ops(const work *w)
{
    return LANES * (2.0 + RAW + 5.0) * w->blocks + 163.0 * w->entries + 3.0 * w->pixels;
}

/* Lists, hits and slots of what was visited; a slot and its mark of what was drawn. */
static double roofline_blend_backward_bytes(const work *w)
{
    if (w->gpu)
        return 72.0 * w->lists + (SLOT_BYTES + 1.0) * w->lists + 24.0 * w->pixels;
    return roofline_records(w, w->drawn) + (2.0 + 4.0 + 4.0) * w->entries +
           (SLOT_BYTES + 1.0) * w->drawn + 24.0 * w->pixels + 8.0 * w->tiles;
}

/* backward_splat: offsets 2, share and transmittance 2, g . rgb 3, rest 1, colours 3, q 3 and a
 * division, moments 8, moduli 4; twelve sums of vectors a slot; backward_load 3 */
static double roofline_blend_backward_ops(const work *w)
{
    return LANES * (26.0 + RAW + DIVIDE) * w->blocks + LANES * 12.0 * w->drawn + 3.0 * w->pixels;
}

/* ---- photometric.cl ---- */

/* Picture 12, photograph 3, nine maps 36; the maps and the two again, the gradient 12. */
static double roofline_photometric_forward_bytes(const work *w)
{
    return (15.0 + 36.0) * w->pixels;
}

static double roofline_photometric_backward_bytes(const work *w)
{
    return (36.0 + 15.0 + 12.0) * w->pixels;
}

/* Without maps. What two pieces share is in a cache. */
static double roofline_photometric_both_bytes(const work *w)
{
    return (15.0 + 12.0) * w->pixels;
}

/* Of each channel: load and sums 7, four maps blurred both ways, ssim_of 25 and a division, its
 * sum; three maps blurred both ways, backward_write 7. What pieces make twice counts once. */
static double roofline_photometric_both_ops(const work *w)
{
    return 3.0 * (33.0 + 2.0 * 4.0 * BLUR + DIVIDE + 7.0 + 2.0 * 3.0 * BLUR) * w->pixels;
}

/* ---- scale_loss.cl: ln sigma of all; gradients of sizes ---- */

static double roofline_scale_count_bytes(const work *w)
{
    return 12.0 * w->n;
}

static double roofline_scale_grad_bytes(const work *w)
{
    return 12.0 * w->n + 4.0 * LAYOUT_PLANES_SCALE * w->n;
}

/* Three exp, the ratio. */
static double roofline_scale_ops(const work *w)
{
    return (3.0 * EXP_LOG + 1.0 + DIVIDE) * w->n;
}

/* ---- project_backward.cl ---- */

/* Parameters and moments of all, read and written; slots and marks. VW 16 also reads counts of
 * tiles of all, and where one of a group is visible first slots, the lines of the colours and four
 * statistics, which it writes. */
static double roofline_project_step_bytes(const work *w)
{
    const double adam = 2.0 * PARAMETERS * STATE_BYTES * w->n;
    if (w->gpu)
        return adam + (SLOT_BYTES + 1.0) * w->lists + 64.0 * w->visible;
    return adam + SLOT_BYTES * w->drawn + w->lists + 4.0 * w->n +
           (4.0 + 64.0 + 4.0 * 8.0) * w->grouped;
}

/* Adam of all, two norms of the quaternion; the chain rule, the basis, gradients of harmonics,
 * stats_add 11 and two roots where one of a group is visible; sums of slots. */
static double roofline_project_step_ops(const work *w)
{
    return (PARAMETERS * ADAM + 8.0 + SH_PLANES) * w->n +
           (CHAIN + BASIS + 11.0 + 2.0 * ROOT) * w->grouped + LANES * w->drawn;
}

/* ---- defer.cl ---- */

#define BOUND_BYTES (4.0 * LAYOUT_DEFER_BOUND / LAYOUT_LANES) /* a Gaussian */

static double roofline_defer_count_bytes(const work *w)
{
    return BOUND_BYTES * w->all;
}

static double roofline_defer_list_bytes(const work *w)
{
    return BOUND_BYTES * w->all + 4.0 / LAYOUT_LANES * w->n;
}

/* Five sides of the picture, seven each. */
static double roofline_defer_see_ops(const work *w)
{
    return 35.0 / LAYOUT_LANES * w->all;
}

/* Parameters and moments read, parameters written; list and last step of each group listed. */
static double roofline_defer_settle_bytes(const work *w)
{
    return PARAMETERS * (STATE_BYTES + 4.0) * w->owed + 8.0 / LAYOUT_LANES * w->n;
}

static double roofline_defer_settle_ops(const work *w)
{
    return PARAMETERS * (2.0 + DIVIDE + ROOT) * w->owed;
}

/* Seven planes with their moments; bounds and last step of a group. */
static double roofline_defer_bound_bytes(const work *w)
{
    return (7.0 * STATE_BYTES + BOUND_BYTES + 4.0 / LAYOUT_LANES) * w->n;
}

/* Seven speeds, the box 9, the reach 8, two exp, a log, two divisions and a root. */
static double roofline_defer_bound_ops(const work *w)
{
    return (7.0 * (1.0 + DIVIDE + ROOT) + 17.0 + 3.0 * EXP_LOG + 2.0 * DIVIDE + ROOT) * w->n;
}

/* ---- all ---- */

enum shape { CPU = 1, GPU = 2, BOTH = 3 };
static const struct roofline_row {
    const char *name;
    enum shape shape;
    double (*bytes)(const work *w), (*ops)(const work *w); /* ops: of VW 16 alone */
    bool frame, alone;
} roofline_rows[] = {
    {"defer_bound", CPU, roofline_defer_bound_bytes, roofline_defer_bound_ops, false, false},
    {"defer_count", CPU, roofline_defer_count_bytes, roofline_defer_see_ops, false, false},
    {"defer_list", CPU, roofline_defer_list_bytes, roofline_defer_see_ops, false, false},
    {"defer_settle", CPU, roofline_defer_settle_bytes, roofline_defer_settle_ops, false, false},
    {"project", BOTH, roofline_project_bytes, roofline_project_ops, true, false},
    {"sort_count", CPU, roofline_sort_count_bytes, roofline_none, true, false},
    {"sort_scan", CPU, roofline_sort_scan_bytes, roofline_none, true, true},
    {"sort_scatter", CPU, roofline_sort_scatter_bytes, roofline_none, true, false},
    {"sum_blocks", GPU, roofline_sum_blocks_bytes, roofline_none, true, false},
    {"sum_scan", GPU, roofline_sum_scan_bytes, roofline_none, true, true},
    {"sum_apply", GPU, roofline_sum_apply_bytes, roofline_none, true, false},
    {"radix_count", GPU, roofline_radix_count_bytes, roofline_none, true, false},
    {"radix_scatter", GPU, roofline_radix_scatter_bytes, roofline_none, true, false},
    {"bin_total", CPU, roofline_bin_total_bytes, roofline_none, true, false},
    {"bin_expand", BOTH, roofline_bin_expand_bytes, roofline_none, true, false},
    {"bin_sum", CPU, roofline_bin_sum_bytes, roofline_none, true, false},
    {"bin_scan", CPU, roofline_bin_scan_bytes, roofline_none, true, true},
    {"bin_scatter", CPU, roofline_bin_scatter_bytes, roofline_none, true, false},
    {"bin_gather", GPU, roofline_bin_gather_bytes, roofline_none, true, false},
    {"blend", BOTH, roofline_blend_bytes, roofline_blend_ops, true, false},
    {"photometric_both", CPU, roofline_photometric_both_bytes, roofline_photometric_both_ops, false,
     false},
    {"photometric_forward", GPU, roofline_photometric_forward_bytes, roofline_none, false, false},
    {"photometric_backward", GPU, roofline_photometric_backward_bytes, roofline_none, false, false},
    {"scale_count", BOTH, roofline_scale_count_bytes, roofline_scale_ops, false, false},
    {"scale_grad", BOTH, roofline_scale_grad_bytes, roofline_scale_ops, false, false},
    {"blend_backward", BOTH, roofline_blend_backward_bytes, roofline_blend_backward_ops, false,
     false},
    {"project_step", BOTH, roofline_project_step_bytes, roofline_project_step_ops, false, false},
};

bool roofline_need(const char *kernel, const struct roofline_work *w, struct roofline_need *out)
{
    const enum shape shape = w->gpu ? GPU : CPU;
    for (size_t i = 0; i < sizeof roofline_rows / sizeof *roofline_rows; i++)
        if (!strcmp(roofline_rows[i].name, kernel) && (roofline_rows[i].shape & shape)) {
            *out = (struct roofline_need){.bytes = roofline_rows[i].bytes(w),
                                          .multiply_adds = w->gpu ? 0.0 : roofline_rows[i].ops(w),
                                          .frame = roofline_rows[i].frame,
                                          .alone = roofline_rows[i].alone};
            return true;
        }
    return false;
}

const char *roofline_name(size_t i)
{
    return i < sizeof roofline_rows / sizeof *roofline_rows ? roofline_rows[i].name : NULL;
}

struct roofline_limit roofline_limit(const struct roofline_need *need, double fma_gflops,
                                     double triad_gbps)
{
    const double memory_ms = need->bytes / triad_gbps * 1e-6,
                 arithmetic_ms = 2.0 * need->multiply_adds / fma_gflops * 1e-6;
    return (struct roofline_limit){.ms = fmax(memory_ms, arithmetic_ms),
                                   .memory = memory_ms >= arithmetic_ms};
}
