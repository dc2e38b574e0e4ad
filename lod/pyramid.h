/* Levels of Gaussians -> a tile store: pyramid_build.c, see there.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_PYRAMID_H
#define LOD_PYRAMID_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct store_blob;
struct gauss;
struct geo_origin;

struct pyramid_config { /* {0} = defaults, but for the name */
    /* Edge wanted for the finest level's tiles; 0 = chosen so that tiles hold about 50,000. */
    double tile_edge_m;
    uint32_t max_per_tile; /* 0 = 200,000; finer zooms are taken until it holds */
    bool lossless; /* float32 payloads, and tile centres that lose no bit of a float32 mean */
    char name[64];
    char attribution[256];
};
struct pyramid_level {     /* levels given must be consecutive, e.g. 1, 2, 3 or 3 alone */
    const struct gauss *g; /* borrowed; NULL: load() makes it in n_parts parts */
    uint8_t level;         /* 1 coarsest .. n finest, at most 7 */
    /* Part `part`, once each, from several threads at a time; the pyramid frees it. A part should
     * have some 100,000 rows: each worker holds one. */
    enum err_code (*load)(void *user, size_t part, struct gauss *out, struct err *e);
    void *user;
    size_t n_parts;
};
struct pyramid_report {
    size_t n_tiles, n_gaussians[8]; /* per level, [0] = overviews */
    size_t n_bad;                   /* rows with non-finite values, left out */
    size_t n_far; /* rows that no tile format can hold: kilometres above or below, left out */
    /* Copies of coarse Gaussians where a finer level has nothing at all. */
    size_t n_carried_tiles, n_carried;
    size_t max_in_tile;
    uint8_t zoom_min, zoom_max;
    char revision[13];
    double seconds;
};
/* Cut levels [n_levels] into tiles, make what is coarser than the coarsest one given (levels down
 * to 1, then overviews) by simplification, and write the store. Every Gaussian of each level lands
 * in exactly one tile of that level's zoom. Where a tile has finer tiles under some of its
 * quadrants only, the Gaussians of the others are copied one zoom down, so that replacing a tile by
 * its children never opens a hole; such a tile keeps the level of its Gaussians. blobs [n_blobs]
 * (may be 0) are stored as they are. report may be NULL.
 * Works on all cores; one caller at a time a path. The file does not depend on their number.
 * ERR_ARG (levels, name, origin), ERR_DATA (no usable rows, mixed anti-aliasing), ERR_LIMIT,
 * ERR_IO, ERR_MEM, ERR_CANCEL (signals_stopping), and what load() returns. */
enum err_code pyramid_build(const struct geo_origin *origin, const struct pyramid_level *levels,
                            size_t n_levels, const struct pyramid_config *cfg,
                            const struct store_blob *blobs, size_t n_blobs, const char *out_path,
                            struct pyramid_report *report, struct err *e) ERR_USE;

#endif
