/* Where Gaussians go in 3DGS-MCMC, and the opacity and size of those that share a place.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/relocate.h"

#include <math.h>

#include "core/base.h"

/* The first of sum [n], ascending, that is above x. */
static size_t relocate_find(const double *sum, size_t n, double x)
{
    size_t lo = 0, hi = n - 1;
    while (lo < hi) {
        size_t mid = lo + (hi - lo) / 2;
        if (sum[mid] > x)
            hi = mid;
        else
            lo = mid + 1;
    }
    return lo;
}

enum err_code relocate_draw(const struct relocate_from *from, size_t room, uint8_t *copies,
                            size_t *placed, struct err *e)
{
    size_t n = from->n;
    *placed = 0;
    if (!n || !room)
        return ERR_OK;
    double *sum = mem_array(n, sizeof *sum), all = 0.0;
    if (!sum)
        return err_set(e, ERR_MEM, "relocate: out of memory for %zu Gaussians", n);
    for (size_t j = 0; j < n; j++)
        sum[j] = all += (double)from->weight[from->ids[j]];
    for (size_t j = 0; all > 0.0 && j < room; j++) {
        size_t at = relocate_find(sum, n, all * rng_unit(from->seed, from->stream, j));
        uint32_t i = from->ids[at];
        if (copies[i] >= RELOCATE_MOST - 1)
            continue;
        copies[i]++;
        ++*placed;
    }
    mem_free(sum);
    return ERR_OK;
}

struct relocate_share relocate_share(double opacity, unsigned parts)
{
    double own = -expm1(log1p(-opacity) / parts), sum = 0.0;
    for (unsigned i = 1; i <= parts; i++) {
        double term = own; /* C(i-1, k) (-1)^k own^(k+1) */
        for (unsigned k = 0; k < i; k++) {
            sum += term / sqrt(k + 1.0);
            term *= -own * (double)(i - 1 - k) / (double)(k + 1);
        }
    }
    return (struct relocate_share){own, opacity / sum};
}
