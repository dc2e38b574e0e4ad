/* Level selection: the tiles that a view needs (pick.c). The viewer uses the same measure
 * (web/src/screenerror.ts).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_PICK_H
#define LOD_PICK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct camera;
struct store;
struct tree;

enum pick_metric { PICK_SCREEN, PICK_DISTANCE };
#define PICK_HYSTERESIS 0.05 /* usual value of pick_options.hysteresis */
struct pick_options {        /* {0} = screen metric with defaults */
    enum pick_metric metric;
    /* screen metric: refine while the error is larger; 0 = 16 px of geometric error, 1 px of median
     * sigma */
    double error_px;
    /* distance metric: thresholds of the levels, finest first, ended by 0 */
    double distance_m[8];
    /* 0 = no limit; else the farthest tiles are coarsened until it is met */
    uint64_t max_gaussians;
    uint64_t max_bytes; /* the same for bytes of payloads, which a client must fetch and keep */
    bool no_lod;        /* the finest level everywhere */
    bool whole_tiles;   /* view_render: draw tiles whole instead of only their blocks in view */
    /* the camera is orthographic, so errors do not depend on distance; set by view_render */
    bool orthographic;
    /* For moving cameras. A tile that was refined in the last picture stays refined until its error
     * is this share below the limit. A camera that trembles near a limit then does not make the
     * level flicker. `before` is the last result of pick_tiles, or NULL; without it a view depends
     * on its own camera alone. The result is never coarser than without hysteresis. */
    double hysteresis;      /* 0 to 0.5 */
    const uint32_t *before; /* [n_before], borrowed */
    size_t n_before;
};
/* Selects tiles. out [n_tiles] gets indices into store_tiles(), ascending; it must not be `before`.
 * No tile that may be visible is left out. The store is only read, so threads may share it. ERR_ARG
 * (camera, hysteresis, before), ERR_MEM. */
enum err_code pick_tiles(const struct store *s, const struct camera *cam,
                         const struct pick_options *o, uint32_t *out, size_t *n_out,
                         struct err *e) ERR_USE;
/* As pick_tiles, on a tree (lod/store/tree.h) and its index, for tests without a store. ERR_ARG,
 * ERR_MEM. */
enum err_code pick_select(const struct tree *t, const struct camera *cam,
                          const struct pick_options *o, uint32_t *out, size_t *n_out,
                          struct err *e) ERR_USE;

#endif
