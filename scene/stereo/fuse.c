/* Samples to points by sorting them by the cubes of a grid: see fuse.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/stereo/fuse.h"

#include <math.h>

#include "core/base.h"
#include "core/math/sort.h"

enum { FUSE_AXIS_MAX = (1 << 21) - 1 };

static uint64_t fuse_key(const struct fuse_sample *s, const float low[3], double edge_m)
{
    uint64_t key = 0;
    for (int k = 0; k < 3; k++) {
        double at = floor((double)(s->enu_m[k] - low[k]) / edge_m);
        key |= sort_spread3((uint64_t)fmin(fmax(at, 0.0), FUSE_AXIS_MAX)) << k;
    }
    return key;
}

static size_t fuse_means(const struct fuse_sample *s, const struct sort_item *items, size_t n,
                         float *out)
{
    size_t points = 0;
    for (size_t i = 0, end; i < n; i = end, points++) {
        double sum[FUSE_COLUMNS] = {0};
        for (end = i; end < n && items[end].key == items[i].key; end++) {
            const struct fuse_sample *one = &s[items[end].row];
            for (int k = 0; k < 3; k++) {
                sum[k] += (double)one->enu_m[k];
                sum[3 + k] += one->rgb[k];
            }
        }
        for (int k = 0; k < FUSE_COLUMNS; k++)
            out[points * FUSE_COLUMNS + (size_t)k] = (float)(sum[k] / (double)(end - i));
    }
    return points;
}

enum err_code fuse_samples(const struct fuse_sample *s, size_t n, double edge_m, float **out,
                           size_t *n_out, struct err *e)
{
    float low[3] = {INFINITY, INFINITY, INFINITY};
    *out = NULL;
    *n_out = 0;
    if (n > UINT32_MAX)
        return err_set(e, ERR_LIMIT, "stereo: %zu samples of the surface: 2^32 at most", n);
    struct sort_item *items = mem_array(n + 1, sizeof *items), *scratch = NULL;
    scratch = mem_array(n + 1, sizeof *scratch);
    *out = mem_array(FUSE_COLUMNS * (n + 1), sizeof **out);
    enum err_code rc = items && scratch && *out
                           ? ERR_OK
                           : err_set(e, ERR_MEM, "stereo: out of memory for %zu samples", n);
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < 3; k++)
            low[k] = fminf(low[k], s[i].enu_m[k]);
    for (size_t i = 0; !rc && i < n; i++)
        items[i] = (struct sort_item){fuse_key(&s[i], low, edge_m), (uint32_t)i};
    if (!rc) {
        sort_items(items, scratch, n);
        *n_out = fuse_means(s, items, n, *out);
    } else {
        mem_free(*out);
        *out = NULL;
    }
    mem_free(items);
    mem_free(scratch);
    return rc;
}
