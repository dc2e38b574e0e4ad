/* Between the halves of an update, internal to lod/: update.c exchanges the rows of the trained
 * levels, update_over.c makes what is made of them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_UPDATE_H
#define LOD_UPDATE_H

#include "lod/edit.h"

struct update_border { /* rows of the cell at its border: their stored copies may lie outside */
    double *at;        /* [n][3] ENU */
    size_t n, cap;
};

struct update {
    const struct update_config *c;
    struct store *old;
    const struct store_tile *tiles;
    size_t n_tiles;
    uint8_t top;                    /* the finest level */
    uint8_t zoom_given;             /* the coarsest zoom of a level that is given */
    struct update_border border[8]; /* by level */
    struct edit d;
};

/* Is a stored tile a copy of coarser rows? */
bool update_is_carried(const struct update *u, const struct store_tile *t);
/* Will there be a tile of its own (not a copy) at k? */
bool update_has(const struct update *u, struct key k);
bool update_under(struct key over, struct key k); /* strictly */
/* What a tile will hold, as it will be stored; gauss_free it. */
enum err_code update_now(struct update *u, struct key k, struct gauss *out, struct err *e) ERR_USE;
/* Everything above the given levels, one zoom after the other, up to the store's top. */
enum err_code update_overviews(struct update *u, struct err *e) ERR_USE;

#endif
