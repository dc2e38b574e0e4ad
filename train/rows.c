/* See rows.h. A few planes at a time are laid aside, each as one plain array, and spread from there
 * to where they go: every cache line of the large array is read and written once, whole, and what
 * is read in any order is small. Both ways run over fixed chunks of groups in parallel; each float
 * is written once, so the result does not depend on threads.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/rows.h"

#include <string.h>

#include "core/base.h"
#include "core/pool.h"

enum { ROWS_LANES = LAYOUT_LANES, ROWS_CHUNK_GROUPS = 1024, ROWS_PLANES = ROWS_SPARE / 4 };

struct rows_work {
    const struct rows *rows;
    const float *from;
    float *to, *aside; /* [ROWS_PLANES][stride] */
    size_t stride;
    uint32_t first, count; /* planes at hand */
    bool zero_new;
};

static size_t rows_groups(size_t n)
{
    return (n + ROWS_LANES - 1) / ROWS_LANES;
}

static size_t rows_chunks(size_t n)
{
    return (rows_groups(n) + ROWS_CHUNK_GROUPS - 1) / ROWS_CHUNK_GROUPS;
}

static size_t rows_end(size_t n, size_t chunk)
{
    size_t end = (chunk + 1) * ROWS_CHUNK_GROUPS;
    return end < rows_groups(n) ? end : rows_groups(n);
}

static enum err_code rows_lay_aside(void *user, size_t chunk, struct err *e)
{
    (void)e;
    const struct rows_work *w = user;
    size_t group_floats = (size_t)w->rows->planes * ROWS_LANES;
    for (size_t g = chunk * ROWS_CHUNK_GROUPS; g < rows_end(w->rows->n_old, chunk); g++)
        for (uint32_t p = 0; p < w->count; p++)
            memcpy(w->aside + p * w->stride + g * ROWS_LANES,
                   w->from + g * group_floats + (size_t)(w->first + p) * ROWS_LANES,
                   ROWS_LANES * sizeof(float));
    return ERR_OK;
}

static enum err_code rows_spread(void *user, size_t chunk, struct err *e)
{
    (void)e;
    const struct rows_work *w = user;
    const struct rows *r = w->rows;
    for (size_t g = chunk * ROWS_CHUNK_GROUPS; g < rows_end(r->n, chunk); g++) {
        float *to = w->to + (g * r->planes + w->first) * ROWS_LANES;
        for (size_t lane = 0; lane < ROWS_LANES; lane++) {
            size_t d = g * ROWS_LANES + lane;
            uint32_t s = d < r->n ? r->source[d] : 0;
            bool zero = d >= r->n || (w->zero_new && (s & ROWS_NEW));
            const float *aside = w->aside + (s & ~ROWS_NEW);
            for (uint32_t p = 0; p < w->count; p++)
                to[p * ROWS_LANES + lane] = zero ? 0.0f : aside[p * w->stride];
        }
    }
    return ERR_OK;
}

enum err_code rows_move(const struct rows *r, bool zero_new, const float *from, float *to,
                        struct err *e)
{
    struct rows_work w = {.rows = r,
                          .from = from,
                          .to = to,
                          .stride = rows_groups(r->n_old) * ROWS_LANES,
                          .zero_new = zero_new};
    enum err_code rc = ERR_OK;
    w.aside = mem_array(w.stride, ROWS_PLANES * sizeof(float));
    if (!w.aside)
        return err_set(e, ERR_MEM, "out of memory to reorder %zu Gaussians", r->n_old);
    for (; !rc && w.first < r->planes; w.first += w.count) {
        w.count = r->planes - w.first < ROWS_PLANES ? r->planes - w.first : ROWS_PLANES;
        rc = pool_for(rows_chunks(r->n_old), 0, rows_lay_aside, &w, e);
        if (!rc)
            rc = pool_for(rows_chunks(r->n), 0, rows_spread, &w, e);
    }
    mem_free(w.aside);
    return rc;
}
