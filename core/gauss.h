/* The Gaussian container: what every other folder means by "a set of Gaussians".
 *
 * Raw parameters as the optimiser sees them, float32, structure of arrays, one allocation. Means
 * are metres relative to origin_enu_m (double), so float32 never holds a large coordinate. Frame:
 * ENU metres, x east, y north, z up, about the scene origin, unless a function says otherwise.
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
    uint32_t embed_len; /* appearance embedding length, 0 = none */
    bool antialiased;   /* trained with 2-D compensation (Mip-Splatting's rho) */
    double origin_enu_m[3];
    float *mean_m;        /* [n][3] relative to origin_enu_m */
    float *scale_log;     /* [n][3] ln(sigma in metres) */
    float *quat_wxyz;     /* [n][4], normalise before use */
    float *opacity_logit; /* [n]; opacity = 1 / (1 + exp(-x)) */
    float *sh;            /* [n][K][3] coefficient-major, DC first; basis and signs of INRIA 3DGS */
    float *embed;         /* [n][embed_len], NULL when embed_len is 0 */
    void *block;
};

static inline size_t gauss_sh_count(uint32_t sh_degree)
{
    return (size_t)(sh_degree + 1) * (sh_degree + 1);
}

/* Room for `cap` Gaussians, n = 0. gauss_free it. ERR_MEM, ERR_LIMIT (degree or embed_len too
 * large). */
enum err_code gauss_alloc(struct gauss *g, size_t cap, uint32_t sh_degree, uint32_t embed_len,
                          struct err *e) ERR_USE;
/* gauss_alloc without zeroing, for rows that are all written at once. ERR_MEM, ERR_LIMIT. */
enum err_code gauss_uninit(struct gauss *g, size_t cap, uint32_t sh_degree, uint32_t embed_len,
                           struct err *e) ERR_USE;
/* cap >= want afterwards (grows by at least half); contents kept. ERR_MEM. */
enum err_code gauss_reserve(struct gauss *g, size_t want, struct err *e) ERR_USE;
void gauss_free(struct gauss *g); /* idempotent, leaves {0} */
/* dst row d = src row s. Degrees and embedding lengths may differ: missing values become 0, surplus
 * ones are dropped. Origins may differ: the mean is moved in double. d < dst->cap. */
void gauss_copy_row(struct gauss *dst, size_t d, const struct gauss *src, size_t s);
/* Append src rows index[0..count) (index NULL: all rows 0..count). ERR_MEM. */
enum err_code gauss_append(struct gauss *dst, const struct gauss *src, const uint32_t *index,
                           size_t count, struct err *e) ERR_USE;
/* Move the origin; every mean changes so that positions in ENU do not. */
void gauss_recenter(struct gauss *g, const double origin_enu_m[3]);
/* order[0..n): rows in Morton order of their means (21 bits an axis over the bounding box), ties by
 * row. ERR_MEM, ERR_LIMIT (2^32 rows). */
enum err_code gauss_morton_order(const struct gauss *g, uint32_t *order, struct err *e) ERR_USE;
/* The same along Hilbert's curve through a cube: rows of files, where neighbours save bytes.
 * ERR_MEM, ERR_LIMIT. */
enum err_code gauss_hilbert_order(const struct gauss *g, uint32_t *order, struct err *e) ERR_USE;
/* Bounds of the means grown by k_sigma * largest sigma of each Gaussian, in ENU metres. n == 0: all
 * 0. */
void gauss_bounds(const struct gauss *g, double k_sigma, double min_enu_m[3], double max_enu_m[3]);
/* Number of rows with a non-finite value or a zero quaternion; first_bad may be NULL. */
size_t gauss_count_bad(const struct gauss *g, size_t *first_bad);

#endif
