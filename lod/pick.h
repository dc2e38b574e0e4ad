/* Which tiles of a store a view needs: pick.c, see there. The viewer measures the same
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
struct store_tile;
struct tree;

enum pick_metric { PICK_SCREEN, PICK_DISTANCE };
#define PICK_HYSTERESIS 0.05 /* a usual band */
struct pick_options {        /* {0} = screen metric, defaults */
    enum pick_metric metric;
    /* Screen: refine while error > this; 0 = 1 px of median sigma (a geometric error of 16 px). */
    double error_px;
    double distance_m[8]; /* distance metric: level l+1.. thresholds, finest first; 0-terminated */
    uint64_t max_gaussians; /* 0 = no limit: coarsen farthest first until it fits */
    uint64_t max_bytes;     /* likewise of the payloads: what a client must fetch and keep */
    bool no_lod;            /* finest level everywhere */
    bool whole_tiles;       /* view_render: hand over tiles whole, not only their blocks in view */
    bool orthographic;      /* cam is one of render_options.orthographic: errors do not depend on
                               distance; view_render sets it */
    /* For cameras that move: a tile that was refined in the picture before stays so until its error
     * is this share below the limit, so that a camera that trembles at a limit does not make the
     * level flicker. `before` is what pick_tiles gave then, NULL for none; without it a view
     * depends on its own camera alone. Never coarser than without. */
    double hysteresis;      /* 0 to 0.5 */
    const uint32_t *before; /* [n_before], borrowed */
    size_t n_before;
};
/* Indices into store_tiles(), ascending, into out [n_tiles], which must not be `before`. A tile
 * that may be visible is never dropped. The store is only read, so threads may share it. ERR_ARG
 * (camera, hysteresis, before), ERR_MEM. */
enum err_code pick_tiles(const struct store *s, const struct camera *cam,
                         const struct pick_options *o, uint32_t *out, size_t *n_out,
                         struct err *e) ERR_USE;
/* pick_tiles on a bare index and its tree (lod/tree.h), for tests that have no store. ERR_ARG,
 * ERR_MEM. */
enum err_code pick_select(const struct store_tile *tiles, const struct tree *t,
                          const struct camera *cam, const struct pick_options *o, uint32_t *out,
                          size_t *n_out, struct err *e) ERR_USE;

#endif
