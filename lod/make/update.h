/* Puts one retrained cell into an existing store: update_build.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_UPDATE_H
#define LOD_UPDATE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct appearance;
struct gauss;

struct update_config { /* one cell that was trained again */
    /* [1..7] its rows; NULL: this level was not trained but simplified */
    const struct gauss *level[8];
    /* returns whether a place (ENU) is on the cell's ground */
    bool (*owns)(void *user, double x_m, double y_m);
    /* Returns whether anything within the box could be on the cell's ground. Tiles for which it is
     * false are not read. */
    bool (*may_own)(void *user, const double min_m[3], const double max_m[3]);
    void *user;
    uint32_t max_per_tile;               /* 0 = 200,000; fuller tiles are thinned */
    const struct appearance *appearance; /* model of the rows' embeddings; NULL: none */
};
struct update_report {
    size_t n_written, n_copied, n_removed; /* number of tiles */
    char revision[13];
};
/* Replaces the rows of one cell and all overviews that depend on them. Other tiles are copied byte
 * by byte. out_path may be store_path: the new store is written under another name and renamed, so
 * a crash leaves the old one intact. An update with the same cell again gives the same revision.
 * Tiling all cells at once gives the same rows in the same tiles. In a lossless store the bytes are
 * the same too, except for tiles that keep a centre which a new store would choose differently, and
 * overviews of those. Photographs that only c->appearance has are added to the store's. report may
 * be NULL. Only one caller at a time may use a path. It uses all cores. ERR_DATA: SH, embedding,
 * appearance model, anti-aliasing or number of levels do not match the store. ERR_ARG (no level, or
 * one missing), ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_MEM, ERR_CANCEL. */
enum err_code update_build(const char *store_path, const struct update_config *c,
                           const char *out_path, struct update_report *report,
                           struct err *e) ERR_USE;

#endif
