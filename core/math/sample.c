/* Weighted sampling without replacement, by an exponential race: the k smallest of -ln(u_i) /
 * score_i (Efraimidis and Spirakis 2006). u_i comes from the counter generator, so the sample is
 * the same on every machine. There is no limit of size.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/math/sample.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base.h"

/* Non-negative floats keep their order as integers; the place in the list breaks ties. */
static uint64_t sample_key(float key, uint32_t place)
{
    uint32_t bits;
    memcpy(&bits, &key, sizeof bits);
    return (uint64_t)bits << 32 | place;
}

/* Hoare's selection: afterwards the k smallest are in front. */
static void sample_select(uint64_t *key, size_t n, size_t k)
{
    size_t lo = 0, hi = n;
    while (hi - lo > 1 && k > lo && k < hi) {
        uint64_t pivot = key[lo + (hi - lo) / 2];
        size_t i = lo, j = hi - 1;
        for (;;) {
            while (key[i] < pivot)
                i++;
            while (key[j] > pivot)
                j--;
            if (i >= j)
                break;
            uint64_t swap = key[i];
            key[i++] = key[j];
            key[j--] = swap;
        }
        size_t mid = key[i] < pivot ? i + 1 : i; /* [lo, mid) <= pivot <= [mid, hi) */
        if (mid == lo)
            mid = lo + 1;
        if (k < mid)
            hi = mid;
        else
            lo = mid;
    }
}

static int sample_compare(const void *a, const void *b)
{
    uint64_t x, y;
    memcpy(&x, a, sizeof x);
    memcpy(&y, b, sizeof y);
    return x < y ? -1 : x > y;
}

enum err_code sample_race(const float *score, const uint32_t *ids, size_t n, size_t k,
                          uint64_t seed, uint64_t stream, uint32_t *chosen, struct err *e)
{
    if (k > n)
        return err_set(e, ERR_ARG, "sample: %zu of %zu cannot be drawn", k, n);
    uint64_t *key = mem_array(n, sizeof *key);
    if (!key)
        return err_set(e, ERR_MEM, "sample: out of memory for %zu candidates", n);
    for (size_t j = 0; j < n; j++) {
        double s = score ? (double)score[ids[j]] : 1.0;
        double arrival = -log1p(-rng_unit(seed, stream, ids[j]));
        float at = s > 0.0 ? (float)(arrival / s) : INFINITY;
        key[j] = sample_key(at, (uint32_t)j);
    }
    sample_select(key, n, k);
    qsort(key, k, sizeof *key, sample_compare);
    for (size_t j = 0; j < k; j++)
        chosen[j] = ids[key[j] & 0xffffffffu];
    mem_free(key);
    return ERR_OK;
}
