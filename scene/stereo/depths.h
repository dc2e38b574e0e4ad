/* Depth maps of a scene's photographs. Each photograph is swept, and then compared with the maps of
 * its neighbours.
 *
 * The place of a pixel is looked up in each neighbour's map. A neighbour agrees if its map has the
 * same height there, within DEPTHS_TOLERANCE planes. A pixel is kept if at least DEPTHS_AGREE
 * neighbours agree, and its height becomes the mean of theirs and its own. This is the left-right
 * check of stereo, for many views (Merrell et al. 2007). Few photographs look into a court, or at
 * the foot of a wall. One neighbour is therefore enough where windows correlate by at least `sure`
 * and no neighbour sees lower ground through the place.
 *
 * Samples of all maps are fused into points (scene/stereo/fuse.h). Training begins with these.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_STEREO_DEPTHS_H
#define SCENE_STEREO_DEPTHS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct dev;
struct scene;

/* Measured: docs/decisions/007-stereo.md. */
enum { DEPTHS_NEAR = 6 }; /* neighbours that a photograph is compared with */
#define DEPTHS_SURE 0.4
#define DEPTHS_EDGE 4.0

struct depths_config {
    uint32_t max_edge_px; /* of maps */
    double sure;          /* 0..1; DEPTHS_SURE but in tests */
    /* planes: a pixel is not kept if its window reaches ground this much lower over an edge.
     * DEPTHS_EDGE but in tests. */
    double edge;
    bool test_split; /* leave the test photographs out */
    bool overwrite;
};
struct depths_result {
    size_t photographs, maps;
    uint64_t pixels, known; /* of the maps */
    size_t points;
    double seconds;
};
/* Sets *out: whether any training photograph has neighbours, so that depths can be made. Reads no
 * photograph. ERR_MEM. */
enum err_code depths_possible(const struct scene *s, bool *out, struct err *e) ERR_USE;
/* Writes `dir`/NAME.npy for every photograph with neighbours: inverse depth in 1/m, [h][w], NaN
 * where neighbours do not agree; points.npy, [n][6]: east, north, up in metres, red, green, blue;
 * and depths.json. The folder appears when it is complete. ERR_ARG (the folder exists), ERR_DATA
 * (no points, no photograph has neighbours, or one has another size than the scene says),
 * ERR_NOENT, ERR_IO, ERR_FORMAT: of files. ERR_MEM, ERR_DEVICE, ERR_CANCEL. */
enum err_code depths_make(struct dev *dev, const struct scene *s, const struct depths_config *cfg,
                          const char *dir, struct depths_result *out, struct err *e) ERR_USE;

#endif
