/* The cost of merging neighbours: the inner loop of the simplifier. It is in single precision and
 * has no branches, so that a compiler can use vectors. It adds, multiplies and divides in a fixed
 * order, so results are the same on every machine.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <string.h>

#include "core/math/simd.h"
#include "lod/make/simplify_cost.h"

#define SIMPLIFY_COST_MAX 3e37f /* of what cannot be compared: merged last */
enum { SIMPLIFY_BLOCK = 1024 };

/* log2 for positive normal floats within 2e-5: exponent, and a polynomial over [0.75, 1.5). */
SIMD_INLINE float simplify_log2(float x)
{
    int32_t bits;
    memcpy(&bits, &x, sizeof bits);
    int32_t exponent = (bits - 0x3f400000) >> 23;
    bits -= exponent * (1 << 23);
    float m;
    memcpy(&m, &bits, sizeof m);
    float t = (m - 1.0f) / (m + 1.0f), t2 = t * t; /* log m = 2 atanh t, |t| <= 0.2 */
    float p = 2.8853901f + t2 * (0.96179670f + t2 * (0.57707802f + t2 * 0.41219858f));
    return (float)exponent + t * p;
}

SIMD_INLINE float simplify_log_det6(float xx, float xy, float xz, float yy, float yz, float zz,
                                    float blur2)
{
    xx += blur2;
    yy += blur2;
    zz += blur2;
    float det = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz);
    /* All eigenvalues are at least blur2, and one is a third of the trace: rounding cannot have
     * more. */
    float least = blur2 * blur2 * (xx + yy + zz) * 0.333f;
    det = det > least ? det : least;
    det = det > 1e-37f ? det : 1e-37f;
    det = det < 3e38f ? det : 3e38f;
    return simplify_log2(det);
}

float simplify_log_det(const float c[6], float blur2)
{
    return simplify_log_det6(c[0], c[1], c[2], c[3], c[4], c[5], blur2);
}

/* Costs of the pairs (i, i + d) for i in [from, to). */
SIMD_INLINE void simplify_pairs(const struct simplify_set *s, size_t d, size_t from, size_t to,
                                float blur2, float *restrict cost)
{
    const float *x = s->f[SIMPLIFY_X], *y = s->f[SIMPLIFY_X + 1], *z = s->f[SIMPLIFY_X + 2];
    const float *xx = s->f[SIMPLIFY_CXX], *xy = s->f[SIMPLIFY_CXX + 1],
                *xz = s->f[SIMPLIFY_CXX + 2], *yy = s->f[SIMPLIFY_CXX + 3],
                *yz = s->f[SIMPLIFY_CXX + 4], *zz = s->f[SIMPLIFY_CXX + 5];
    const float *red = s->f[SIMPLIFY_RED], *green = s->f[SIMPLIFY_RED + 1],
                *blue = s->f[SIMPLIFY_RED + 2];
    const float *cover = s->f[SIMPLIFY_COVER], *info = s->f[SIMPLIFY_INFO];
    for (size_t i = from; i < to; i++) {
        size_t j = i + d;
        float w = cover[i] + cover[j], wa = cover[i] / w, wb = cover[j] / w, wab = wa * wb;
        float dx = x[j] - x[i], dy = y[j] - y[i], dz = z[j] - z[i];
        float step = (red[j] - red[i]) * (red[j] - red[i]) +
                     (green[j] - green[i]) * (green[j] - green[i]) +
                     (blue[j] - blue[i]) * (blue[j] - blue[i]);
        float joint = simplify_log_det6(
            wa * xx[i] + wb * xx[j] + wab * dx * dx, wa * xy[i] + wb * xy[j] + wab * dx * dy,
            wa * xz[i] + wb * xz[j] + wab * dx * dz, wa * yy[i] + wb * yy[j] + wab * dy * dy,
            wa * yz[i] + wb * yz[j] + wab * dy * dz, wa * zz[i] + wb * zz[j] + wab * dz * dz,
            blur2);
        /* 0.5 ln 2 from log2 to half a natural logarithm */
        float c =
            0.34657359f * (w * joint - info[i] - info[j]) + SIMPLIFY_COLOR_WEIGHT * wab * w * step;
        c = c < SIMPLIFY_COST_MAX ? c : SIMPLIFY_COST_MAX; /* NaN as well */
        cost[i - from] = c > 0.0f ? c : 0.0f;
    }
}

SIMD_INLINE void simplify_keep(const float *restrict c, size_t n, uint32_t first_other,
                               float *restrict cost, uint32_t *restrict who)
{
    for (size_t i = 0; i < n; i++) {
        uint32_t other = first_other + (uint32_t)i;
        who[i] = c[i] < cost[i] ? other : who[i];
        cost[i] = c[i] < cost[i] ? c[i] : cost[i];
    }
}

SIMD_WIDE void simplify_cost(const struct simplify_set *s, float blur2, float *cost, uint32_t *who,
                             float *scratch)
{
    for (size_t i = 0; i < s->n; i++) {
        cost[i] = 3.2e37f; /* a little above what any pair costs: the first one is taken */
        who[i] = 0;
    }
    /* Block by block, so that all distances find the fields in the nearest cache. */
    for (size_t from = 0; from < s->n; from += SIMPLIFY_BLOCK)
        for (size_t d = 1; d <= SIMPLIFY_WINDOW && from + d < s->n; d++) {
            size_t to = from + SIMPLIFY_BLOCK < s->n - d ? from + SIMPLIFY_BLOCK : s->n - d;
            simplify_pairs(s, d, from, to, blur2, scratch);
            simplify_keep(scratch, to - from, (uint32_t)(from + d), cost + from, who + from);
            simplify_keep(scratch, to - from, (uint32_t)from, cost + from + d, who + from + d);
        }
}
