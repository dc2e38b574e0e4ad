/* The Gaussian container that all folders use.
 *
 * Parameters are raw, as the optimiser changes them: float32, structure of arrays, one allocation.
 * Means are metres relative to origin_enu_m (double), so that no float32 holds a large coordinate.
 * Frame: ENU metres about the scene origin, x east, y north, z up, unless a function says
 * otherwise.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_GAUSS_H
#define CORE_GAUSS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

enum { GAUSS_SH_DEGREE_MAX = 3, GAUSS_EMBED_MAX = 64 };
#define GAUSS_SH_C0 0.28209479177387814

struct gauss { /* {0} is valid and empty */
    size_t n, cap;
    uint32_t sh_degree; /* 0..3; K = (sh_degree + 1)^2 */
    uint32_t embed_len; /* length of the appearance embedding, 0 = none */
    bool antialiased;   /* trained with opacity compensation (Mip-Splatting's rho) */
    size_t n_left_out;  /* unusable rows of the file that it was read from */
    double origin_enu_m[3];
    float *mean_m;        /* [n][3], relative to origin_enu_m */
    float *scale_log;     /* [n][3], ln(sigma in metres) */
    float *quat_wxyz;     /* [n][4], normalise before use */
    float *opacity_logit; /* [n]; opacity = 1 / (1 + exp(-x)) */
    /* [n][K][3], coefficient-major, DC first; basis and signs of the INRIA 3DGS code */
    float *sh;
    float *embed; /* [n][embed_len], NULL when embed_len is 0 */
    void *block;
};

static inline size_t gauss_sh_count(uint32_t sh_degree)
{
    return (size_t)(sh_degree + 1) * (sh_degree + 1);
}

/* Allocates rows for `cap` Gaussians, with n = 0. Free it with gauss_free. ERR_MEM, ERR_LIMIT
 * (sh_degree or embed_len is too large). */
enum err_code gauss_alloc(struct gauss *g, size_t cap, uint32_t sh_degree, uint32_t embed_len,
                          struct err *e) ERR_USE;
/* As gauss_alloc, but memory is not zeroed. Use it when all rows are written at once. ERR_MEM,
 * ERR_LIMIT. */
enum err_code gauss_uninit(struct gauss *g, size_t cap, uint32_t sh_degree, uint32_t embed_len,
                           struct err *e) ERR_USE;
/* Makes cap at least `want`, and at least half as large again when it grows. Contents are kept.
 * ERR_MEM. */
enum err_code gauss_reserve(struct gauss *g, size_t want, struct err *e) ERR_USE;
void gauss_free(struct gauss *g); /* idempotent, leaves {0} */
/* Copies row s of src to row d of dst, d < dst->cap. Degrees and embedding lengths may differ:
 * missing values become 0, surplus ones are dropped. Origins may differ: the mean is converted in
 * double. */
void gauss_copy_row(struct gauss *dst, size_t d, const struct gauss *src, size_t s);
/* Appends the src rows index[0..count). If index is NULL, appends the rows 0..count. ERR_MEM. */
enum err_code gauss_append(struct gauss *dst, const struct gauss *src, const uint32_t *index,
                           size_t count, struct err *e) ERR_USE;
/* Moves the origin. Means change so that all positions in ENU stay the same. */
void gauss_recenter(struct gauss *g, const double origin_enu_m[3]);
/* Sorts rows by the Morton code of their means, with 21 bits an axis over the bounding box. Equal
 * codes keep the order of rows. order [n] gets the row numbers. ERR_MEM, ERR_LIMIT (2^32 rows). */
enum err_code gauss_morton_order(const struct gauss *g, uint32_t *order, struct err *e) ERR_USE;
/* The same of rows whose means are computed when they are asked for, twice, some at a time: rows
 * [from, to) into out [to - from][3]. ERR_MEM, ERR_LIMIT, and what `means` returns. */
enum { GAUSS_SLICE = 65536 };
struct gauss_places {
    size_t n;
    enum err_code (*means)(void *user, size_t from, size_t to, float *out, struct err *e);
    void *user;
};
enum err_code gauss_morton_order_of(const struct gauss_places *p, uint32_t *order,
                                    struct err *e) ERR_USE;
/* As gauss_morton_order, along a Hilbert curve through a cube. Files use it: rows that are close in
 * space then lie together, which compresses better. ERR_MEM, ERR_LIMIT. */
enum err_code gauss_hilbert_order(const struct gauss *g, uint32_t *order, struct err *e) ERR_USE;
/* Sorts the rows by it. After an error g is as it was. ERR_MEM, ERR_LIMIT. */
enum err_code gauss_sort(struct gauss *g, struct err *e) ERR_USE;
/* Copies rows, without embeddings, in the order of gauss_hilbert_order, with the origin at 0: far
 * from it means lose digits. Free *out with gauss_free.
 * ERR_MEM, ERR_LIMIT (2^32 rows). */
enum err_code gauss_sorted(const struct gauss *g, struct gauss *out, struct err *e) ERR_USE;
/* Bounding box in ENU metres. Each mean is widened by k_sigma times the largest sigma of its
 * Gaussian. n == 0: all 0. */
void gauss_bounds(const struct gauss *g, double k_sigma, double min_enu_m[3], double max_enu_m[3]);
/* Counts the rows with a value that is not finite or with a zero quaternion. first_bad may be NULL.
 */
size_t gauss_count_bad(const struct gauss *g, size_t *first_bad);
#define GAUSS_SCALE_LOG_MOST 88.0f /* exp of it is a finite float */
/* Counts these rows, and those with a log scale above GAUSS_SCALE_LOG_MOST. first may be NULL. */
size_t gauss_count_unusable(const struct gauss *g, size_t *first);
/* Leaves all of them out, and says so in the name of a file format. ERR_DATA: none is left. */
enum err_code gauss_keep_good(struct gauss *g, const char *format, struct err *e) ERR_USE;

#endif
