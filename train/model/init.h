/* The first Gaussians, from the points of the scene.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_INIT_H
#define TRAIN_INIT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/splat/gauss.h"

struct cell;
struct footprint;
struct scene;

/* Largest shares of the first level's budget that Gaussians on ground without points
 * (docs/scale.md), and at points of known depths (docs/decisions/007-stereo.md), have. */
#define INIT_GROUND_SHARE 0.25
#define INIT_DENSE_SHARE 0.7

struct init_input { /* all borrowed */
    const struct scene *scene;
    const uint32_t *images;              /* [n_images] training photographs */
    const struct camera_window *windows; /* [n_images] used part of each; NULL: all of it */
    size_t n_images;
    const struct cell *cell;
    const struct footprint *ground; /* NULL: Gaussians only at points */
    double ground_share;            /* largest share of `limit` for ground without points */
    const float *dense; /* [n_dense][6] east, north, up in m, red, green, blue, or NULL */
    size_t n_dense;
    double dense_share; /* largest share of `limit` for Gaussians at dense points */
    bool no_masks;      /* also use points on masked pixels */
    uint32_t sh_degree;
    size_t limit; /* largest number of Gaussians */
    uint64_t seed;
};
/* Makes Gaussians at the scene's points; for a cell of a plan, at the points that its photographs
 * see. The size is 0.7 of the distance to the three nearest neighbours (root mean square), the
 * opacity 0.5. If there are more points than `limit`, a random subset is used. If there are none,
 * 100 places in front of the cameras are used. Each grid cell of the ground that a photograph sees
 * and that has no point gets a Gaussian, with the height of its neighbours and the colour of the
 * nearest point. The origin is the mean of the points. The caller frees *out with gauss_free.
 * ERR_MEM. ERR_LIMIT: more points than knn_build accepts. */
enum err_code init_gauss(const struct init_input *in, struct gauss *out, struct err *e) ERR_USE;
/* The number of points that init_gauss would use without a limit. ERR_MEM. */
enum err_code init_count_points(const struct scene *s, const uint32_t *images, size_t n_images,
                                const struct cell *cell, size_t *out, struct err *e) ERR_USE;
/* Starts from a coarse model of the whole scene instead. Gaussians inside the cell are thinned
 * evenly to `limit` and enlarged to cover the same ground. Gaussians around the cell that its
 * photographs show are included, so that the cell need not learn its background again. They are the
 * last init_count_around rows. Free *out with gauss_free. ERR_MEM. */
enum err_code init_coarse(const struct init_input *in, const struct gauss *coarse,
                          struct gauss *out, struct err *e) ERR_USE;
enum err_code init_count_around(const struct gauss *coarse, const struct scene *s,
                                const uint32_t *images, const struct camera_window *windows,
                                size_t n_images, const struct cell *cell, size_t *out,
                                struct err *e) ERR_USE;
/* The shares of a scene's points that are inside the cell, and around it where its photographs show
 * them: about the shares of a coarse model that is not there yet. 0, 0: there are no points.
 * ERR_MEM. */
enum err_code init_point_shares(const struct scene *s, const uint32_t *images,
                                const struct camera_window *windows, size_t n_images,
                                const struct cell *cell, double *inside, double *around,
                                struct err *e) ERR_USE;
/* The squared size of the first Gaussians [n], as in init_gauss. It is limited to three times the
 * median size of the nine nearest points, so that an isolated point does not become huge. ERR_MEM,
 * ERR_LIMIT as in knn_build. */
enum err_code init_size2(const float *xyz, size_t n, float *size2, struct err *e) ERR_USE;
#endif
