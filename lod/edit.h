/* A pyramid changed in places: internal to lod/, shared by update_build.c and merge.c.
 *
 * An edit holds the new Gaussians of tiles, by key. Everything that is not edited is copied byte by
 * byte from the store it is in.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_EDIT_H
#define LOD_EDIT_H

#include "core/base.h"
#include "core/gauss.h"
#include "lod/locate.h"
#include "lod/store.h"

struct edit_tile {
    struct key key;
    uint8_t level;
    bool carried;   /* a copy of coarser rows: stands for nothing in what is made above */
    bool whole;     /* never thinned for being too full: rows of a trained level */
    bool settled;   /* edit_settle was here: the rows are as the store will have them */
    struct gauss g; /* n == 0: the tile goes away */
};
struct edit_part { /* some rows; borrowed */
    const struct gauss *g;
    const uint32_t *index; /* [n]; NULL: the first n */
    size_t n;
};
struct edit { /* {0} and `locate`, `meta` filled in; edit_free */
    struct locate locate;
    struct store_meta meta; /* of the store that will be written */
    uint32_t max_per_tile;
    struct buf appearance; /* in place of the blob "appearance"; empty: what the store has */
    struct edit_tile *tile;
    size_t n, cap;
    size_t n_far;
};

void edit_free(struct edit *d);
struct edit_tile *edit_find(const struct edit *d, struct key k);
/* The edit of a tile, made empty if there is none yet. Pointers to others become invalid.
 * ERR_MEM. */
enum err_code edit_touch(struct edit *d, struct key k, uint8_t level, struct edit_tile **out,
                         struct err *e) ERR_USE;
/* The rows that an edit keeps of the store's tile, about that tile's centre. ERR_MEM. */
enum err_code edit_keep(struct edit *d, struct edit_tile *t, const struct gauss *g,
                        const uint32_t *index, size_t n, struct err *e) ERR_USE;
/* Add rows. A tile keeps its centre, so that what it kept does not move, unless there is none yet
 * or rows would be out of its reach; all rows are known then, so that it moves once. ERR_MEM. */
enum err_code edit_add(struct edit *d, struct edit_tile *t, const struct edit_part *part,
                       size_t n_parts, struct err *e) ERR_USE;
/* Leave out rows beyond every format's reach, thin to what a tile may hold, put along the Hilbert
 * curve. What is made of a tile is made of its settled rows, as in the pyramid. ERR_MEM,
 * ERR_LIMIT. */
enum err_code edit_settle(struct edit *d, struct edit_tile *t, struct err *e) ERR_USE;
/* Key of row i at zoom z. ERR_ARG (not finite). */
enum err_code edit_key(const struct edit *d, const struct gauss *g, size_t i, uint8_t z,
                       struct key *out, struct err *e) ERR_USE;
/* Settle what is not, write edits and copies of `a` and then `b` (NULL; only tiles
 * that neither an edit nor a has), blobs of a and those of b that a lacks, and commit.
 * n_copied may be NULL. Works on all cores. ERR_CANCEL, ERR_DATA (no tiles), ERR_FORMAT, ERR_IO,
 * ERR_LIMIT, ERR_MEM. */
enum err_code edit_write(struct edit *d, struct store *a, struct store *b, const char *out_path,
                         size_t *n_copied, size_t *n_written, struct err *e) ERR_USE;

#endif
