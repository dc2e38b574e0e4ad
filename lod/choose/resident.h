/* Tiles of a store on the device. Internal to lod/: view.c draws from them.
 *
 * A block of a tile occupies a page there, and stays until the page is needed. A tile is therefore
 * read and decoded only when it comes into view, straight to its pages where host and device share
 * memory. There are as many pages as a picture needs, and more up to a number of bytes; then the
 * least recently used tiles leave first. A picture lists its blocks in the order of tiles and
 * blocks, so its bits do not depend on the pages.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_RESIDENT_H
#define LOD_RESIDENT_H

#include "lod/choose/block.h"
#include "lod/choose/frustum.h"
#include "render/render.h"

struct store;

struct resident_tile {   /* by index into store_tiles */
    struct block *block; /* known after the first decoding */
    uint32_t *page;      /* page of each block; NULL: not on the device */
    float missing;       /* share of opacity taken away: see resident_weigh */
    uint64_t used;
};
struct resident {
    struct store *store;   /* borrowed */
    struct render *render; /* borrowed */
    struct resident_tile *tile;
    size_t n_tiles;
    size_t limit_bytes; /* of pages beyond those that a picture needs */
    uint64_t clock;
    /* model: the pages, with harmonics as halves; flat: tiles one after another, see resident_flat
     */
    struct render_model model, flat;
    uint32_t *free_page; /* stack, [n_pages] */
    size_t n_free, n_pages;
    size_t top;            /* pages from here on were never used */
    uint32_t *list, *next; /* groups of the last picture, and scratch: [n_pages * BLOCK_GROUPS] */
    size_t n_list;
    bool list_valid;
    struct resident_tile **scratch; /* [n_tiles] */
};

/* Prepares the caches. Pictures have embeddings of embed_len; 0: the tiles' embeddings are left
 * out. The model's origin is the first tile's centre for any view, so that a picture depends on its
 * request alone. Only one thread at a time may use *out. ERR_MEM. */
enum err_code resident_open(struct store *s, struct render *r, uint32_t embed_len,
                            size_t limit_bytes, struct resident *out, struct err *e) ERR_USE;
void resident_close(struct resident *r);
/* Frees all tiles. */
void resident_shrink(struct resident *r);
/* From now on a tile is drawn with this share of its opacity, above 0 and up to 1. */
void resident_weigh(struct resident *r, uint32_t tile, float share);
/* Brings the tiles picked[0..n), ascending, to the device and lists the blocks that f (NULL: all)
 * may see. r->model then draws them. *n_gaussians: their Gaussians. ERR_FORMAT, ERR_IO, ERR_DEVICE,
 * ERR_LIMIT, ERR_MEM. ERR_CANCEL: the renderer was told to stop (render_set_stop). */
enum err_code resident_show(struct resident *r, const uint32_t *picked, size_t n,
                            const struct frustum *f, uint64_t *n_gaussians, struct err *e) ERR_USE;
/* Brings all of these tiles into r->flat, a model without a list, in floats, so that it has
 * gradients. ERR_FORMAT, ERR_IO, ERR_DEVICE,
 * ERR_LIMIT, ERR_CANCEL, ERR_MEM. */
enum err_code resident_flat(struct resident *r, const uint32_t *picked, size_t n,
                            struct err *e) ERR_USE;

#endif
