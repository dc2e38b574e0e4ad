/* Tiles of a store in memory: decoded, and on the device. Internal to lod/: what view.c draws from.
 *
 * Two caches. Decoded tiles stay in the device's layout up to a number of bytes, least recently
 * used out first. On the device tiles stay in pages of a block each, wherever there was room, until
 * that is needed: a tile is copied when it comes into view and not while it stays there. A picture
 * lists the blocks that may be seen, by tile and block, so its bits do not depend on where pages
 * are.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_RESIDENT_H
#define LOD_RESIDENT_H

#include "lod/block.h"
#include "lod/frustum.h"
#include "render/render.h"

struct store;

struct resident_tile {   /* by index into store_tiles */
    float *packed;       /* see render_piece_pack; NULL: not in memory */
    size_t bytes;        /* of packed */
    struct block *block; /* known once it was decoded */
    uint32_t *page;      /* of each block; NULL: not on the device */
    float missing;       /* share of its opacity that is not on the device: see resident_weigh */
    uint64_t used;
};
struct resident {
    struct store *store;   /* borrowed */
    struct render *render; /* borrowed */
    struct resident_tile *tile;
    size_t n_tiles;
    size_t bytes, limit_bytes; /* of packed */
    uint64_t clock;
    struct render_model model, flat; /* pages; tiles one behind the other, see resident_flat */
    uint32_t *free_page;             /* stack, [n_pages] */
    size_t n_free, n_pages;
    uint32_t *list, *next; /* groups of the last picture, scratch: [n_pages * BLOCK_GROUPS] */
    size_t n_list;
    bool list_valid;
    struct resident_tile **scratch; /* [n_tiles] */
};

/* Tiles have embeddings of embed_len in the pictures, 0: theirs are left out. The model's origin is
 * the first tile's centre whatever is in view: a picture depends on its request alone. ERR_MEM. One
 * thread at a time, as all here. */
enum err_code resident_open(struct store *s, struct render *r, uint32_t embed_len,
                            size_t limit_bytes, struct resident *out, struct err *e) ERR_USE;
void resident_close(struct resident *r);
/* From now on a tile is drawn with this share of its opacity, above 0, to 1. */
void resident_weigh(struct resident *r, uint32_t tile, float share);
/* Tiles picked[0..n), ascending, on the device, and of them what f may see (NULL: everything)
 * listed: then r->model draws it. *n_gaussians: how many those are. ERR_FORMAT, ERR_IO, ERR_DEVICE,
 * ERR_LIMIT, ERR_MEM; ERR_CANCEL: the renderer is told to stop (render_set_stop). */
enum err_code resident_show(struct resident *r, const uint32_t *picked, size_t n,
                            const struct frustum *f, uint64_t *n_gaussians, struct err *e) ERR_USE;
/* All of the tiles in r->flat, a model without a list. Errors as resident_show: ERR_FORMAT, ERR_IO,
 * ERR_DEVICE, ERR_LIMIT, ERR_CANCEL, ERR_MEM. */
enum err_code resident_flat(struct resident *r, const uint32_t *picked, size_t n,
                            struct err *e) ERR_USE;

#endif
