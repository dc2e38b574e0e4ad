/* Blocks of a tile. The rows of a tile are in the order of a space-filling curve, so 256 of them
 * lie close together. The few that are many times larger than their neighbours get blocks of their
 * own.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/choose/block.h"

#include <math.h>

#include "lod/choose/frustum.h"

enum { BLOCK_OCTAVES = 8, BLOCK_BINS = 64 };

/* Octave of a sigma, 0 for 2^-32 m and less. */
static uint32_t block_octave(float size_log)
{
    const double ln2 = 0.69314718055994530942;
    double at = floor((double)size_log / ln2) + BLOCK_BINS / 2;
    at = at > 0 ? at : 0; /* no number: 0 */
    return (uint32_t)(at < BLOCK_BINS - 1 ? at : BLOCK_BINS - 1);
}

void block_places(const float *size_log, size_t n, uint32_t *place)
{
    size_t begin[BLOCK_BINS + 1] = {0}, count[BLOCK_BINS] = {0}, below = 0, first = 0;
    if (n <= BLOCK_ROWS) {
        for (size_t i = 0; i < n; i++)
            place[i] = (uint32_t)i;
        return;
    }
    for (size_t i = 0; i < n; i++)
        count[place[i] = block_octave(size_log[i])]++;
    /* Up to the median all are one: their boxes are as large as the distances between them. */
    while (below + count[first] <= n / 2)
        below += count[first++];
    for (size_t i = 0; i < n; i++) {
        place[i] = place[i] > first ? place[i] - (uint32_t)first : 0;
        place[i] = place[i] < BLOCK_OCTAVES ? place[i] : BLOCK_OCTAVES - 1;
        begin[place[i] + 1]++;
    }
    for (size_t k = 0; k < BLOCK_OCTAVES; k++)
        begin[k + 1] += begin[k];
    for (size_t i = 0; i < n; i++)
        place[i] = (uint32_t)begin[place[i]]++;
}

void block_measure(const float *groups, uint32_t planes, size_t n, const double origin_enu_m[3],
                   struct block *out)
{
    float most = -HUGE_VALF;
    for (size_t k = 0; k < 3; k++) {
        out->min_enu_m[k] = HUGE_VAL;
        out->max_enu_m[k] = -HUGE_VAL;
    }
    for (size_t i = 0; i < n; i++) {
        const float *row = groups + layout_at(i, planes),
                    *s = row + LAYOUT_PLANE_SCALE * LAYOUT_LANES;
        float big = s[0] > s[LAYOUT_LANES] ? s[0] : s[LAYOUT_LANES];
        big = big > s[2 * LAYOUT_LANES] ? big : s[2 * LAYOUT_LANES];
        most = big > most ? big : most;
        const double reach = FRUSTUM_REACH_SIGMA * exp((double)big);
        for (size_t k = 0; k < 3; k++) {
            double at = (double)row[k * LAYOUT_LANES] + origin_enu_m[k];
            double lo = at - reach, hi = at + reach;
            out->min_enu_m[k] = lo < out->min_enu_m[k] ? lo : out->min_enu_m[k];
            out->max_enu_m[k] = hi > out->max_enu_m[k] ? hi : out->max_enu_m[k];
        }
    }
    out->sigma_max_m = exp((double)most);
}
