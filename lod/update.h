/* One retrained cell into a store that exists: update_build.c, see there.
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

struct update_config {            /* one cell, trained again */
    const struct gauss *level[8]; /* [1..7] its rows; NULL: this level was made, not trained */
    bool (*owns)(void *user, double x_m, double y_m); /* is this the cell's ground: ENU */
    /* Could anything within the box be on the cell's ground? Tiles of which this is false are not
     * even read. */
    bool (*may_own)(void *user, const double min_m[3], const double max_m[3]);
    void *user;
    uint32_t max_per_tile;               /* 0 = 200,000; fuller tiles are thinned */
    const struct appearance *appearance; /* what reads the rows' embeddings; NULL: nothing does */
};
struct update_report {
    size_t n_written, n_copied, n_removed; /* tiles */
    char revision[13];
};
/* Replace the rows of one cell and everything made of them; all other tiles are copied byte by
 * byte. out_path may be store_path: the new store is written beside and renamed, so a process that
 * dies on the way leaves the old one untouched. The same cell again gives the same revision. A
 * store of all cells tiled at once has the same rows in the same tiles; its bytes are the same,
 * too, in a lossless store, but for tiles that keep a centre which it would choose elsewhere, and
 * what is made of them. Photographs that only c->appearance has join the store's. report may be
 * NULL. One caller at a time a path; works on all cores.
 * ERR_DATA when SH, embedding, appearance model, anti-aliasing or the number of levels do not fit
 * the store; ERR_ARG (no level, or one missing), ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_MEM,
 * ERR_CANCEL. */
enum err_code update_build(const char *store_path, const struct update_config *c,
                           const char *out_path, struct update_report *report,
                           struct err *e) ERR_USE;

#endif
