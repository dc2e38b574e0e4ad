/* See permute.h. A few planes at a time are copied to plain arrays, and from there to their new
 * places. Every cache line of the large array is thus read and written once, as a whole, and random
 * access stays within small arrays. Both copies run over fixed chunks of groups in parallel. Each
 * float is written once, so the result does not depend on threads.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "render/permute.h"

#include <string.h>

#include "core/base.h"
#include "core/pool.h"

enum {
    PERMUTE_LANES = LAYOUT_LANES,
    PERMUTE_CHUNK_GROUPS = 1024,
    PERMUTE_PLANES = PERMUTE_SPARE / 4
};

struct permute_work {
    const struct permutation *rows;
    const float *from;
    float *to, *aside; /* [PERMUTE_PLANES][stride] */
    size_t stride;
    uint32_t first, count; /* planes at hand */
    bool zero_new;
};

static size_t permute_groups(size_t n)
{
    return (n + PERMUTE_LANES - 1) / PERMUTE_LANES;
}

static size_t permute_chunks(size_t n)
{
    return (permute_groups(n) + PERMUTE_CHUNK_GROUPS - 1) / PERMUTE_CHUNK_GROUPS;
}

static size_t permute_rows_end(size_t n, size_t chunk)
{
    size_t end = (chunk + 1) * PERMUTE_CHUNK_GROUPS;
    return end < permute_groups(n) ? end : permute_groups(n);
}

static enum err_code permute_lay_aside(void *user, size_t chunk, struct err *e)
{
    (void)e;
    const struct permute_work *w = user;
    size_t group_floats = (size_t)w->rows->planes * PERMUTE_LANES;
    for (size_t g = chunk * PERMUTE_CHUNK_GROUPS; g < permute_rows_end(w->rows->n_old, chunk); g++)
        for (uint32_t p = 0; p < w->count; p++)
            memcpy(w->aside + p * w->stride + g * PERMUTE_LANES,
                   w->from + g * group_floats + (size_t)(w->first + p) * PERMUTE_LANES,
                   PERMUTE_LANES * sizeof(float));
    return ERR_OK;
}

static enum err_code permute_spread(void *user, size_t chunk, struct err *e)
{
    (void)e;
    const struct permute_work *w = user;
    const struct permutation *r = w->rows;
    for (size_t g = chunk * PERMUTE_CHUNK_GROUPS; g < permute_rows_end(r->n, chunk); g++) {
        float *to = w->to + (g * r->planes + w->first) * PERMUTE_LANES;
        for (size_t lane = 0; lane < PERMUTE_LANES; lane++) {
            size_t d = g * PERMUTE_LANES + lane;
            uint32_t s = d < r->n ? r->source[d] : 0;
            bool zero = d >= r->n || (w->zero_new && (s & PERMUTE_NEW));
            const float *aside = w->aside + (s & ~PERMUTE_NEW);
            for (uint32_t p = 0; p < w->count; p++)
                to[p * PERMUTE_LANES + lane] = zero ? 0.0f : aside[p * w->stride];
        }
    }
    return ERR_OK;
}

enum err_code permute_move(const struct permutation *r, bool zero_new, const float *from, float *to,
                           struct err *e)
{
    struct permute_work w = {.rows = r,
                             .from = from,
                             .to = to,
                             .stride = permute_groups(r->n_old) * PERMUTE_LANES,
                             .zero_new = zero_new};
    enum err_code rc = ERR_OK;
    w.aside = mem_array(w.stride, PERMUTE_PLANES * sizeof(float));
    if (!w.aside)
        return err_set(e, ERR_MEM, "out of memory to reorder %zu Gaussians", r->n_old);
    for (; !rc && w.first < r->planes; w.first += w.count) {
        w.count = r->planes - w.first < PERMUTE_PLANES ? r->planes - w.first : PERMUTE_PLANES;
        rc = pool_for(permute_chunks(r->n_old), 0, permute_lay_aside, &w, e);
        if (!rc)
            rc = pool_for(permute_chunks(r->n), 0, permute_spread, &w, e);
    }
    mem_free(w.aside);
    return rc;
}
