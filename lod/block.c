/* Blocks of a tile. The rows of a tile are in the order of a space-filling curve, so 256 of them
 * lie close together. The few that are many times larger than their neighbours get blocks of their
 * own.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/block.h"

#include <math.h>
#include <string.h>

#include "core/base.h"
#include "lod/frustum.h"

enum { BLOCK_OCTAVES = 8, BLOCK_BINS = 64 };

/* Octave of the largest sigma, 0 for 2^-32 m and less. */
static uint8_t block_octave(const float *scale_log)
{
    const double ln2 = 0.69314718055994530942;
    double big = fmax(fmax((double)scale_log[0], (double)scale_log[1]), (double)scale_log[2]);
    double at = floor(big / ln2) + BLOCK_BINS / 2;
    return (uint8_t)fmin(fmax(at, 0.0), BLOCK_BINS - 1);
}

enum err_code block_order(const struct gauss *g, uint32_t *order, struct err *e)
{
    size_t begin[BLOCK_BINS + 1] = {0}, count[BLOCK_BINS] = {0}, below = 0, first = 0;
    for (size_t i = 0; i < g->n; i++)
        order[i] = (uint32_t)i;
    if (g->n <= BLOCK_ROWS)
        return ERR_OK;
    uint8_t *octave = mem_uninit(g->n, sizeof *octave);
    if (!octave)
        return err_set(e, ERR_MEM, "out of memory for a tile of %zu Gaussians", g->n);
    for (size_t i = 0; i < g->n; i++)
        count[octave[i] = block_octave(g->scale_log + 3 * i)]++;
    /* Up to the median all are one: their boxes are as large as the distances between them. */
    while (below + count[first] <= g->n / 2)
        below += count[first++];
    for (size_t i = 0; i < g->n; i++) {
        octave[i] = octave[i] > first ? (uint8_t)(octave[i] - first) : 0;
        octave[i] = octave[i] < BLOCK_OCTAVES ? octave[i] : BLOCK_OCTAVES - 1;
        begin[octave[i] + 1]++;
    }
    for (size_t k = 0; k < BLOCK_OCTAVES; k++)
        begin[k + 1] += begin[k];
    for (size_t i = 0; i < g->n; i++)
        order[begin[octave[i]]++] = (uint32_t)i;
    mem_free(octave);
    return ERR_OK;
}

void block_measure(const struct gauss *g, struct block *out)
{
    for (size_t b = 0; b < block_count(g->n); b++) {
        size_t from = b * BLOCK_ROWS, to = from + BLOCK_ROWS < g->n ? from + BLOCK_ROWS : g->n;
        struct block *x = &out[b];
        float big = -HUGE_VALF;
        for (size_t i = 3 * from; i < 3 * to; i++)
            big = fmaxf(big, g->scale_log[i]);
        struct gauss part = {
            .n = to - from, .mean_m = g->mean_m + 3 * from, .scale_log = g->scale_log + 3 * from};
        memcpy(part.origin_enu_m, g->origin_enu_m, sizeof part.origin_enu_m);
        gauss_bounds(&part, FRUSTUM_REACH_SIGMA, x->min_enu_m, x->max_enu_m);
        x->sigma_max_m = exp((double)big);
    }
}
