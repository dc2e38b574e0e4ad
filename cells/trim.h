/* Gaussians that stick out of what photographs show, cut off at its edge.
 *
 * At the rim of a survey a Gaussian has a photograph on one side of it and nothing on the other, so
 * nothing keeps it from reaching out by as much as it is large; and with few photographs to say how
 * far away it is, it stands above the ground or lies under it. Seen from elsewhere the city has a
 * soft edge of some metres with blobs on it. Such a Gaussian becomes two halves along the axis that
 * sticks out, these again while they stick out and are large; what has its middle outside goes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CELLS_TRIM_H
#define CELLS_TRIM_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct footprint;
struct gauss;
struct scene;

struct trim {                   /* {0} leaves everything as it is; trim_free */
    const struct scene *scene;  /* borrowed */
    const struct footprint *at; /* borrowed: the grid */
    uint8_t *deep; /* [ny][nx] cells all around that photographs show as a whole; 0: not this one */
    size_t *first; /* [ny nx + 1] into cams; only of cells that are shown in part */
    uint32_t *cams; /* training photographs that show something of the cell */
    double least_m; /* sigmas below this are left alone */
    uint32_t sure;  /* photographs that know how far away a thing is, at least 2 */
    double free_m;  /* above and below the points around, where so many look; a quarter of it where
                    * one does. 0: heights are not asked about */
};
/* From the training photographs. `at` and `s` live as long as *out; an empty footprint gives {0}.
 * ERR_MEM. */
enum err_code trim_open(const struct scene *s, const struct footprint *at, uint32_t sure,
                        double free_m, struct trim *out, struct err *e) ERR_USE;
void trim_free(struct trim *t);
/* Does a training photograph look at this place, ENU metres? What hides it is not asked. */
bool trim_shows(const struct trim *t, const double x_m[3]);
/* And can there be something, or is it above or below all that the few photographs there allow? */
bool trim_holds(const struct trim *t, const double x_m[3]);
enum trim_verdict { TRIM_INSIDE, TRIM_STICKS_OUT, TRIM_OUTSIDE };
/* A Gaussian of this mean, sigmas and rotation (row-major, columns are its axes). TRIM_STICKS_OUT:
 * of the photographs, whatever its height, by an axis of a sigma above largest_m. */
enum trim_verdict trim_judge(const struct trim *t, const double mean_m[3], const double sigma_m[3],
                             const double rot[9], double largest_m);
/* Cut rows of g: pieces go behind the rows that are left, which keep their order. *gone: rows of
 * which nothing was left. ERR_MEM. */
enum err_code trim_rows(const struct trim *t, struct gauss *g, size_t *gone, struct err *e) ERR_USE;

#endif
