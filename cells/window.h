/* The part of a photograph that shows a cell.
 *
 * It is an upright rectangle around those of the cell's sparse points that the picture frames,
 * without the outermost WINDOW_TAIL on each side, and with a border. If the picture frames no point
 * of another cell beyond a side, that side moves to the picture's own edge: ground without points
 * there counts as the cell's. Ground in the rectangle that lies outside of the cell is its
 * surroundings.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CELLS_WINDOW_H
#define CELLS_WINDOW_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/camera.h"

struct cell;
struct scene;

struct window_points {         /* {0} is empty; free with window_free */
    const struct scene *scene; /* borrowed */
    bool *mine;                /* [scene->n_points] points in the cell or a little around it */
    double *xy, *x, *y;        /* [n_points][2], [n_points] twice: scratch */
};
/* Free *out with window_free. ERR_MEM. */
enum err_code window_open(const struct scene *s, const struct cell *cell, struct window_points *out,
                          struct err *e) ERR_USE;
void window_free(struct window_points *p);
/* Finds the part of a picture that shows the cell. Returns false, and the whole picture, if the
 * picture frames none of the cell's points. */
bool window_of(struct window_points *p, const struct camera *cam, struct camera_window *out);
/* The share of a photograph that shows the cell, 0..1: the share of its observations whose points
 * lie in the cell. The shares of all cells of a plan add up to 1. For a photograph without
 * observations it is the area of its window, or 0. */
double window_share(struct window_points *p, const struct cell *cell, uint32_t image);

#endif
