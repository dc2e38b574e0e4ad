/* See permute.h. Some planes at a time are laid aside, row by row, and from there go to their new
 * places. Every cache line of the large array is thus read and written once, as a whole, and a row
 * that is fetched from its old place is half a line. Both copies run over fixed chunks of groups in
 * parallel. Each float is written once, so the result does not depend on threads.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "render/permute.h"

#include <string.h>

#include "core/base.h"
#include "core/math/simd.h"
#include "core/pool.h"

enum {
    PERMUTE_LANES = LAYOUT_LANES,
    PERMUTE_CHUNK_GROUPS = 1024,
    PERMUTE_SOON = 64, /* rows ahead that are fetched: their old places are near, and jump */
    PERMUTE_PLANES = PERMUTE_SPARE / 4 /* floats of a row that is laid aside */
};

struct permute_work {
    const struct permutation *rows;
    const float *from;
    float *to, *aside;     /* [groups][lanes][PERMUTE_PLANES] */
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

/* ---- between planes and rows ---- */

typedef float permute_wide __attribute__((vector_size(16)));
enum { PERMUTE_WIDE = 4 };
static_assert((int)PERMUTE_PLANES % (int)PERMUTE_WIDE == 0 &&
                  (int)PERMUTE_LANES % (int)PERMUTE_WIDE == 0,
              "planes and lanes of whole vectors");

/* Rows become columns. */
SIMD_INLINE void permute_turn(permute_wide v[PERMUTE_WIDE])
{
    permute_wide a = __builtin_shufflevector(v[0], v[1], 0, 4, 1, 5),
                 b = __builtin_shufflevector(v[0], v[1], 2, 6, 3, 7),
                 c = __builtin_shufflevector(v[2], v[3], 0, 4, 1, 5),
                 d = __builtin_shufflevector(v[2], v[3], 2, 6, 3, 7);
    v[0] = __builtin_shufflevector(a, c, 0, 1, 4, 5);
    v[1] = __builtin_shufflevector(a, c, 2, 3, 6, 7);
    v[2] = __builtin_shufflevector(b, d, 0, 1, 4, 5);
    v[3] = __builtin_shufflevector(b, d, 2, 3, 6, 7);
}

/* Rows of a group, all planes that are at hand. */
SIMD_INLINE void permute_all_out(const float *restrict group, float *restrict rows)
{
    for (size_t lane = 0; lane < PERMUTE_LANES; lane += PERMUTE_WIDE)
        for (size_t p = 0; p < PERMUTE_PLANES; p += PERMUTE_WIDE) {
            permute_wide v[PERMUTE_WIDE];
            for (size_t k = 0; k < PERMUTE_WIDE; k++)
                memcpy(&v[k], group + (p + k) * PERMUTE_LANES + lane, sizeof v[k]);
            permute_turn(v);
            for (size_t k = 0; k < PERMUTE_WIDE; k++)
                memcpy(rows + (lane + k) * PERMUTE_PLANES + p, &v[k], sizeof v[k]);
        }
}

/* The same back; row[lane] is NULL for zeros. */
SIMD_INLINE void permute_all_in(const float *const row[PERMUTE_LANES], float *restrict group)
{
    static const float zeros[PERMUTE_PLANES];
    for (size_t lane = 0; lane < PERMUTE_LANES; lane += PERMUTE_WIDE)
        for (size_t p = 0; p < PERMUTE_PLANES; p += PERMUTE_WIDE) {
            permute_wide v[PERMUTE_WIDE];
            for (size_t k = 0; k < PERMUTE_WIDE; k++)
                memcpy(&v[k], (row[lane + k] ? row[lane + k] : zeros) + p, sizeof v[k]);
            permute_turn(v);
            for (size_t k = 0; k < PERMUTE_WIDE; k++)
                memcpy(group + (p + k) * PERMUTE_LANES + lane, &v[k], sizeof v[k]);
        }
}

/* Rows of a group, `count` of their planes. */
SIMD_INLINE void permute_rows_out(const float *restrict group, uint32_t count, float *restrict rows)
{
    for (size_t lane = 0; lane < PERMUTE_LANES; lane++)
        for (size_t p = 0; p < count; p++)
            rows[lane * PERMUTE_PLANES + p] = group[p * PERMUTE_LANES + lane];
}

/* The same back; row[lane] is NULL for zeros. */
SIMD_INLINE void permute_rows_in(const float *const row[PERMUTE_LANES], uint32_t count,
                                 float *restrict group)
{
    static const float zeros[PERMUTE_PLANES];
    for (size_t lane = 0; lane < PERMUTE_LANES; lane++) {
        const float *from = row[lane] ? row[lane] : zeros;
        for (size_t p = 0; p < count; p++)
            group[p * PERMUTE_LANES + lane] = from[p];
    }
}

SIMD_WIDE static enum err_code permute_lay_aside(void *user, size_t chunk, struct err *e)
{
    (void)e;
    const struct permute_work *w = user;
    for (size_t g = chunk * PERMUTE_CHUNK_GROUPS; g < permute_rows_end(w->rows->n_old, chunk);
         g++) {
        const float *from = w->from + (g * w->rows->planes + w->first) * PERMUTE_LANES;
        float *rows = w->aside + g * PERMUTE_LANES * PERMUTE_PLANES;
        if (w->count == PERMUTE_PLANES)
            permute_all_out(from, rows);
        else
            permute_rows_out(from, w->count, rows);
    }
    return ERR_OK;
}

SIMD_WIDE static enum err_code permute_spread(void *user, size_t chunk, struct err *e)
{
    (void)e;
    const struct permute_work *w = user;
    const struct permutation *r = w->rows;
    for (size_t g = chunk * PERMUTE_CHUNK_GROUPS; g < permute_rows_end(r->n, chunk); g++) {
        const float *row[PERMUTE_LANES];
        float *to = w->to + (g * r->planes + w->first) * PERMUTE_LANES;
        for (size_t lane = 0; lane < PERMUTE_LANES; lane++) {
            size_t d = g * PERMUTE_LANES + lane;
            uint32_t s = d < r->n ? r->source[d] : 0;
            bool zero = d >= r->n || (w->zero_new && (s & PERMUTE_NEW));
            if (d + PERMUTE_SOON < r->n)
                SIMD_SOON(w->aside +
                          (size_t)(r->source[d + PERMUTE_SOON] & ~PERMUTE_NEW) * PERMUTE_PLANES);
            row[lane] = zero ? NULL : w->aside + (size_t)(s & ~PERMUTE_NEW) * PERMUTE_PLANES;
        }
        if (w->count == PERMUTE_PLANES)
            permute_all_in(row, to);
        else
            permute_rows_in(row, w->count, to);
    }
    return ERR_OK;
}

// NOLINTNEXTLINE(readability-non-const-parameter): threads write to it
enum err_code permute_move(const struct permutation *r, bool zero_new, const float *from, float *to,
                           struct err *e)
{
    struct permute_work w = {.rows = r, .from = from, .to = to, .zero_new = zero_new};
    enum err_code rc = ERR_OK;
    w.aside = mem_uninit(permute_groups(r->n_old) * PERMUTE_LANES, PERMUTE_PLANES * sizeof(float));
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
