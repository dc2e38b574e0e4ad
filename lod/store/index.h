/* A store's index in memory. Each tile has a row (struct store_tile: key, level, counts) and a
 * shape (struct store_shape: boxes, centre and sizes).
 *
 * Shapes take most of the memory, so they are packed: 96 bytes instead of 144. A shape that would
 * not be unpacked to the same bits is kept unpacked. The tiler writes no such shape.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_INDEX_H
#define LOD_INDEX_H

#include "lod/store/store.h"

struct index_shape {
    double min_enu_m[3], max_enu_m[3], sigma_max_m;
    float core_min_m[3], core_max_m[3]; /* from the centre */
    int32_t center_enu_m[3];            /* whole metres; of a whole shape: [0] is its place */
    float sigma_median_log;             /* not a number: the shape is kept whole */
};

struct index {                       /* {0} is empty */
    double pixel_m[STORE_LEVEL_MAX]; /* of store_meta: what limits errors; set before tiles come */
    struct store_tile *tiles;
    struct index_shape *shapes;
    struct store_shape *whole;
    size_t n, cap, n_whole, cap_whole;
};

/* The geometric error of a tile of a level (0: an overview), by its sigma. In a picture whose
 * pixels are as large as those a level was trained on, the level is as good as the next finer one,
 * whatever the size of its Gaussians. */
double index_error_m(const double pixel_m[STORE_LEVEL_MAX], uint32_t level, double sigma_median_m);
/* Adds a tile. `expected` is how many there will be, as far as it is known. Free with index_free.
 * ERR_MEM. */
enum err_code index_add(struct index *x, const struct store_entry *t, size_t expected,
                        struct err *e) ERR_USE;
/* Gives room for `cap` tiles, at least x->n. ERR_MEM. */
enum err_code index_reserve(struct index *x, size_t cap, struct err *e) ERR_USE;
/* Writes a tile to place i, below x->cap, and leaves x->n to the caller; several threads may write
 * to different places. False: its shape must be kept whole, which only index_add does. */
bool index_set(struct index *x, size_t i, const struct store_entry *t);
/* Sorts by key_compare. ERR_MEM. */
enum err_code index_sort(struct index *x, struct err *e) ERR_USE;
void index_free(struct index *x);
/* Place of `k` in a sorted index, or INDEX_NONE. */
#define INDEX_NONE UINT32_MAX
uint32_t index_find(const struct index *x, struct key k);
/* The shape of the tile at place i, below x->n, with the bits that index_add was given. */
struct store_shape index_shape(const struct index *x, size_t i);
/* As index_shape, in less time: without the median sigma and the geometric error. */
struct store_shape index_bounds(const struct index *x, size_t i);
double index_sigma_median_m(const struct index *x, size_t i);

#endif
