/* Makes a tile store of levels of Gaussians: pyramid_build.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_PYRAMID_H
#define LOD_PYRAMID_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"
#include "core/geo/heights.h"

struct store_blob;
struct gauss;
struct geo_origin;

struct pyramid_config { /* {0} has defaults for all but the name */
    /* wanted tile edge of the finest level; 0 = chosen so that tiles hold about 50,000 Gaussians */
    double tile_edge_m;
    uint32_t max_per_tile; /* 0 = 200,000; finer zooms are used until all tiles meet it */
    bool lossless; /* payloads in float32, and tile centres that lose no bit of a float32 mean */
    char name[64];
    char attribution[256];
    char heights[HEIGHTS_MAX]; /* reference of heights: core/geo/heights.h; "": the ellipsoid */
};
struct pyramid_level {     /* levels must be consecutive: 1, 2, 3, or 3 alone */
    const struct gauss *g; /* borrowed; NULL: load() gives the level in n_parts parts */
    uint8_t level;         /* 1 coarsest .. n finest, at most 7 */
    /* a pixel, on the ground, of the photographs that trained the level, if a finer level may
     * replace it; 0: not known (store_meta.pixel_m) */
    double pixel_m;
    /* Loads part `part`. It is called once for each part, from several threads. The pyramid frees
     * *out. A part should have about 100,000 rows, because each thread holds one. */
    enum err_code (*load)(void *user, size_t part, struct gauss *out, struct err *e);
    void *user;
    size_t n_parts;
};
struct pyramid_report {
    size_t n_tiles, n_gaussians[8]; /* n_gaussians: by level, [0] = overviews */
    size_t n_bad;                   /* rows left out because a value is not finite */
    /* rows left out because no tile format can hold them: kilometres above or below */
    size_t n_far;
    /* copies of coarse Gaussians at places where a finer level has nothing */
    size_t n_carried_tiles, n_carried;
    size_t max_in_tile;
    uint8_t zoom_min, zoom_max;
    char revision[13];
    double seconds;        /* whole time; writing tiles takes what read_s and plan_s leave */
    double read_s, plan_s; /* reading and sorting rows; choosing zoom and tiles */
};
/* Cuts levels [n_levels] into tiles and writes the store. Levels coarser than those given are made
 * by simplification: down to level 1, then overviews. Every Gaussian of a level lies in exactly one
 * tile of that level's zoom. A tile may have finer tiles under some of its quadrants only. The
 * Gaussians of the other quadrants are then copied one zoom down and keep their level, so that
 * replacing a tile by its children never leaves a hole. blobs [n_blobs] are stored unchanged;
 * n_blobs may be 0. report may be NULL. It uses all cores; the file does not depend on their
 * number. Only one caller at a time may use a path. ERR_ARG (levels, name, origin), ERR_DATA (no
 * usable rows, or mixed anti-aliasing), ERR_LIMIT, ERR_IO, ERR_MEM, ERR_CANCEL (signals_stopping),
 * and what load() returns. */
enum err_code pyramid_build(const struct geo_origin *origin, const struct pyramid_level *levels,
                            size_t n_levels, const struct pyramid_config *cfg,
                            const struct store_blob *blobs, size_t n_blobs, const char *out_path,
                            struct pyramid_report *report, struct err *e) ERR_USE;

#endif
