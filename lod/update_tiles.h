/* An update under way, and what it knows of tiles: internal to lod/. update_build.c exchanges the
 * rows of the trained levels, update_over.c makes what is made of them. One thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_UPDATE_TILES_H
#define LOD_UPDATE_TILES_H

#include "lod/edit.h"
#include "lod/store.h"
#include "lod/update.h"

struct update_border { /* rows of the cell at its border: their stored copies may lie outside */
    double *at;        /* [n][3] ENU */
    size_t n, cap;
};

struct update {
    const struct update_config *c;
    struct store *old;
    const struct store_tile *tiles;
    size_t n_tiles;
    uint8_t top;        /* the finest level */
    uint8_t zoom_given; /* the coarsest zoom of a level that is given */
    struct update_border border[STORE_LEVEL_MAX + 1]; /* by level */
    struct edit d;
};

/* The zoom of a trained level. */
uint8_t update_zoom(const struct update *u, uint8_t level);
/* Is a stored tile a copy of coarser rows? */
bool update_is_carried(const struct update *u, const struct store_tile *t);
/* Will there be a tile of its own (not a copy) at k? */
bool update_has(const struct update *u, struct key k);
/* Will there be one below k? */
bool update_has_below(const struct update *u, struct key k);
/* Does k lie under `over`, strictly? */
bool update_under(struct key over, struct key k);
/* What a tile will hold, as it will be stored; gauss_free it. ERR_MEM; errors of store_read_gauss
 * and edit_settle (ERR_NOENT, ERR_FORMAT, ERR_IO). */
enum err_code update_now(struct update *u, struct key k, struct gauss *out, struct err *e) ERR_USE;

#endif
