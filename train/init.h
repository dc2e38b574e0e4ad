/* The first Gaussians: from the points of the scene.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_INIT_H
#define TRAIN_INIT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/gauss.h"

struct cell;
struct footprint;
struct scene;

struct init_input { /* all borrowed */
    const struct scene *scene;
    const uint32_t *images; /* [n_images] training photographs */
    size_t n_images;
    const struct cell *cell;
    const struct footprint *ground; /* NULL: no Gaussians but those of points */
    double ground_share;            /* of `limit`, most Gaussians on ground without points */
    bool no_masks;                  /* take points on ignored pixels, too */
    uint32_t sh_degree;
    size_t limit; /* most Gaussians */
    uint64_t seed;
};
/* Gaussians at the scene's points (for a cell of a plan: at those that its photographs see): size
 * from the three nearest neighbours, opacity 0.1. More points than `limit`: an even random choice.
 * None: 100 places in front of the cameras. Beside them, one in each cell of the ground that has no
 * point and that a photograph sees, as high as its neighbours and of the nearest point's colour.
 * Origin: mean of the points. gauss_free it. ERR_MEM; ERR_LIMIT: more points than knn_build
 * takes. */
enum err_code init_gauss(const struct init_input *in, struct gauss *out, struct err *e) ERR_USE;
/* How many points that would be without a limit. ERR_MEM. */
enum err_code init_count_points(const struct scene *s, const uint32_t *images, size_t n_images,
                                const struct cell *cell, size_t *out, struct err *e) ERR_USE;
/* dist2[i]: mean squared distance of point i to its three nearest others (fewer when there are
 * fewer). ERR_MEM, ERR_LIMIT. */
enum err_code init_neighbour_dist2(const float *xyz, size_t n, float *dist2, struct err *e) ERR_USE;
/* Those of a coarse model of the whole scene instead: of the cell, thinned evenly to `limit` and
 * then as much larger, and all around it that the cell's photographs show: what stands behind the
 * cell in a picture is there already, and is not learnt once more by each cell. As many rows behind
 * as init_count_around says. gauss_free it. ERR_MEM. */
enum err_code init_coarse(const struct init_input *in, const struct gauss *coarse,
                          struct gauss *out, struct err *e) ERR_USE;
size_t init_count_around(const struct gauss *coarse, const struct scene *s, const uint32_t *images,
                         size_t n_images, const struct cell *cell);
/* The square of the first Gaussians' size [n]: the same, but for a point that lies alone no more
 * than three times the median size of the nine points nearest to it. ERR_MEM, ERR_LIMIT as
 * knn_build. */
enum err_code init_size2(const float *xyz, size_t n, float *size2, struct err *e) ERR_USE;
#endif
