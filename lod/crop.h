/* What a polygon leaves of the tiles of a store, for documents that list them: a tile that would be
 * empty is not listed. Tiles wholly inside or outside are known by their boxes; those that lie
 * across the border are read, so the answer is exact, up to a bound of what is read.
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
/* Where a box [min_m, max_m] of the ENU frame lies, whatever its heights: by a clip without
 * heights. ERR_ARG. */
enum err_code crop_box(const struct clip *c, const struct geo_origin *origin, const double min_m[3],
                       const double max_m[3], enum crop_side *out, struct err *e) ERR_USE;

struct crop_node {
    uint32_t count; /* Gaussians of the node's tile that are left; 0: it is not to be listed */
    bool across;    /* its tile lies across the border: what is left of it is not all, or may be */
    bool any;       /* something is left of it, or may be of what lies below */
};
enum { CROP_READ_MAX = 4000000 /* Gaussians; beyond, tiles across the border count as whole */ };
/* node [tree's n_nodes]: each of those at and below `start` (an index into the store's tree), down
 * to where other documents begin if one_document: these are told by their boxes alone. mem_free it.
 * Errors of store_read_gauss: ERR_FORMAT, ERR_IO, ERR_MEM; ERR_ARG. */
enum err_code crop_tiles(const struct clip *c, struct store *s, uint32_t start, bool one_document,
                         struct crop_node **node, struct err *e) ERR_USE;

#endif
