/* Cuts Gaussians off where the photographs end.
 *
 * At the rim of a survey a Gaussian has photographs on one side only, so nothing limits its size on
 * the other side. Where few photographs fix its distance, it may float above the ground or lie
 * below it. Seen from elsewhere, the city then has a soft edge of some metres with blobs. Such a
 * Gaussian is halved along the axis that reaches outside. Halves are halved again while they reach
 * outside and are large. Pieces whose middle is outside are removed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CELLS_TRIM_H
#define SCENE_CELLS_TRIM_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct footprint;
struct gauss;
struct scene;

struct trim {                   /* {0} changes nothing; free with trim_free */
    const struct scene *scene;  /* borrowed */
    const struct footprint *at; /* borrowed: the grid */
    /* [ny][nx] number of cells to the nearest one that photographs do not show completely, up to a
     * limit; 0: this cell is one */
    uint8_t *deep;
    /* [ny nx + 1] index into cams; only cells that are shown in part have entries */
    size_t *first;
    uint32_t *cams; /* training photographs that show a part of the cell */
    double least_m; /* smaller sigmas are not changed */
    uint32_t sure;  /* number of photographs that fix a distance well, at least 2 */
    /* height allowed above and below the points around, where `sure` photographs look; a quarter of
     * it where only one does. 0: heights are not checked */
    double free_m;
};
/* Prepares trimming from the training photographs. `at` and `s` must outlive *out. If the footprint
 * is empty, *out is {0}. Free it with trim_free. ERR_MEM. */
enum err_code trim_open(const struct scene *s, const struct footprint *at, uint32_t sure,
                        double free_m, struct trim *out, struct err *e) ERR_USE;
void trim_free(struct trim *t);
/* Returns whether a training photograph shows this place (ENU metres). Occlusion is not considered.
 */
bool trim_shows(const struct trim *t, const double x_m[3]);
/* Returns whether a training photograph shows this place, and its height is allowed there. */
bool trim_holds(const struct trim *t, const double x_m[3]);
enum trim_verdict { TRIM_INSIDE, TRIM_STICKS_OUT, TRIM_OUTSIDE };
/* Judges a Gaussian by its mean, sigmas and rotation (row-major; the columns are its axes).
 * TRIM_STICKS_OUT: an axis with a sigma above largest_m reaches out of the photographs. Heights do
 * not count for that. */
enum trim_verdict trim_judge(const struct trim *t, const double mean_m[3], const double sigma_m[3],
                             const double rot[9], double largest_m);
/* True: the Gaussian is so far from where the photographs end that trim_judge says TRIM_INSIDE for
 * every rotation. */
bool trim_is_far(const struct trim *t, const double mean_m[3], double largest_sigma_m);
/* Cuts rows of g. Pieces are appended after the rows that remain, which keep their order. *gone is
 * the number of rows of which nothing remained. ERR_MEM. */
enum err_code trim_rows(const struct trim *t, struct gauss *g, size_t *gone, struct err *e) ERR_USE;

#endif
