/* Finds the tiles of a store that are not empty after clipping, for documents that list tiles. For
 * a tile completely inside or outside a polygon its box is enough. Tiles across the border are
 * read, up to a limit of Gaussians, so the answer is exact below that limit.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_CROP_H
#define LOD_CROP_H

#include "core/base.h"

struct clip;
struct geo_origin;
struct store;
struct store_tile;

enum crop_side { CROP_OUTSIDE, CROP_INSIDE, CROP_ACROSS };
/* Compares a box [min_m, max_m] of the ENU frame with a clip without heights. Heights of the box do
 * not matter. ERR_ARG. */
enum err_code crop_box(const struct clip *c, const struct geo_origin *origin, const double min_m[3],
                       const double max_m[3], enum crop_side *out, struct err *e) ERR_USE;

struct crop_node {
    uint32_t count; /* Gaussians of the node's tile that are left; 0: do not list it */
    /* its tile lies across the border, so some of its Gaussians are or may be outside */
    bool across;
    bool any; /* Gaussians are left in it, or may be left in a tile below */
};
enum { CROP_READ_MAX = 4000000 /* Gaussians; further tiles across the border count as whole */ };
/* Computes node [n_nodes of the tree] for node `start` of the store's tree and all nodes below it.
 * With one_document it stops where other documents begin; there only boxes are compared. Free *node
 * with mem_free. ERR_FORMAT, ERR_IO, ERR_MEM as in store_read_gauss; ERR_ARG. */
enum err_code crop_tiles(const struct clip *c, struct store *s, uint32_t start, bool one_document,
                         struct crop_node **node, struct err *e) ERR_USE;

#endif
