/* Changes to some tiles of a pyramid. Internal to lod/: update_build.c and merge.c use it.
 *
 * An edit holds the new Gaussians of tiles, by key. Tiles that are not edited are copied from their
 * store byte by byte.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_EDIT_H
#define LOD_EDIT_H

#include "core/base.h"
#include "core/splat/gauss.h"
#include "lod/store/locate.h"
#include "lod/store/store.h"

struct edit_tile {
    struct key key;
    uint8_t level;
    bool carried;   /* a copy of coarser rows; overviews are not made from it */
    bool whole;     /* rows of a trained level: never thinned, however full the tile is */
    bool settled;   /* edit_settle was called: the rows are as the store will have them */
    struct gauss g; /* n == 0: the tile is removed */
};
struct edit_part { /* some rows; borrowed */
    const struct gauss *g;
    const uint32_t *index; /* [n]; NULL: the first n */
    size_t n;
};
struct edit { /* set `locate` and `meta`, {0} elsewhere; free with edit_free */
    struct locate locate;
    struct store_meta meta; /* metadata of the store to be written */
    uint32_t max_per_tile;
    struct buf appearance; /* replaces the blob "appearance"; empty: keep that of the store */
    struct edit_tile *tile;
    size_t n, cap;
    size_t n_far;
};

void edit_free(struct edit *d);
struct edit_tile *edit_find(const struct edit *d, struct key k);
/* Returns the edit of a tile, and makes an empty one if there is none. Pointers to other edits
 * become invalid. ERR_MEM. */
enum err_code edit_touch(struct edit *d, struct key k, uint8_t level, struct edit_tile **out,
                         struct err *e) ERR_USE;
/* Adds the rows that an edit keeps of the store's tile. The rows are relative to that tile's
 * centre. ERR_MEM. */
enum err_code edit_keep(struct edit *d, struct edit_tile *t, const struct gauss *g,
                        const uint32_t *index, size_t n, struct err *e) ERR_USE;
/* Adds rows. The tile keeps its centre, so that rows already in it do not move. It gets a new
 * centre if it has none or if rows would be out of reach. All rows must be given at once, so that
 * it moves only once. ERR_MEM. */
enum err_code edit_add(struct edit *d, struct edit_tile *t, const struct edit_part *part,
                       size_t n_parts, struct err *e) ERR_USE;
/* Brings rows to their final state: removes those beyond the reach of the formats, thins to what a
 * tile may hold, and sorts along a Hilbert curve. Overviews are made of settled rows, as in the
 * pyramid. ERR_MEM, ERR_LIMIT. */
enum err_code edit_settle(struct edit *d, struct edit_tile *t, struct err *e) ERR_USE;
/* Key of row i at zoom z. ERR_ARG (not finite). */
enum err_code edit_key(const struct edit *d, const struct gauss *g, size_t i, uint8_t z,
                       struct key *out, struct err *e) ERR_USE;
/* Settles all edits, writes the store and commits it. The new store has the edits, copies of the
 * other tiles of `a`, and copies of tiles that only `b` (may be NULL) has; also the blobs of a, and
 * those of b that a lacks. n_copied may be NULL. It uses all cores. ERR_CANCEL, ERR_DATA (no
 * tiles), ERR_FORMAT, ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code edit_write(struct edit *d, struct store *a, struct store *b, const char *out_path,
                         size_t *n_copied, size_t *n_written, struct err *e) ERR_USE;

#endif
