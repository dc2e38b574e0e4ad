/* The state of an update, and questions about its tiles. Internal to lod/. update_build.c replaces
 * rows of trained levels, update_over.c makes the overviews. Only one thread uses it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_UPDATE_TILES_H
#define LOD_UPDATE_TILES_H

#include "lod/make/edit.h"
#include "lod/make/update.h"
#include "lod/store/store.h"

/* rows of the cell near its border; rounding may have put their stored copies outside */
struct update_border {
    double *at; /* [n][3] ENU */
    size_t n, cap;
};

struct update {
    const struct update_config *c;
    struct store *old;
    const struct store_tile *tiles;
    size_t n_tiles;
    uint8_t top;        /* the finest level */
    uint8_t zoom_given; /* coarsest zoom of the levels that are given */
    struct update_border border[STORE_LEVEL_MAX + 1]; /* by level */
    struct edit d;
};

/* The zoom of a trained level. */
uint8_t update_zoom(const struct update *u, uint8_t level);
/* Returns whether a stored tile is a copy of coarser rows. */
bool update_is_carried(const struct update *u, const struct store_tile *t);
/* Returns whether there will be a tile at k that is not a copy. */
bool update_has(const struct update *u, struct key k);
/* Returns whether there will be such a tile below k. */
bool update_has_below(const struct update *u, struct key k);
/* Returns whether k lies strictly below `over`. */
bool update_under(struct key over, struct key k);
/* The rows that a tile will have in the store. Free *out with gauss_free. ERR_MEM, ERR_NOENT,
 * ERR_FORMAT, ERR_IO as in store_read_gauss and edit_settle. */
enum err_code update_now(struct update *u, struct key k, struct gauss *out, struct err *e) ERR_USE;

#endif
