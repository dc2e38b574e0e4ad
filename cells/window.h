/* The part of a photograph that shows a cell.
 *
 * It is an upright rectangle of the picture around the cell's sparse points: all but the outermost
 * WINDOW_TAIL of those that the picture frames on each side, and a border. A side beyond which the
 * picture frames no point of another cell is the picture's own: the ground there, without points,
 * is the cell's. What is seen in the rectangle and lies outside of the cell is its surroundings.
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
/* The part of a picture that shows the cell; false, and all of it: it frames none of its points. */
bool window_of(struct window_points *p, const struct camera *cam, struct camera_window *out);
/* The share of a photograph that shows the cell, 0..1: the share of its observations of points that
 * lie in the cell. The shares of all cells of a plan add up to 1. A photograph without observations
 * has the area of its window, or 0. */
double window_share(struct window_points *p, const struct cell *cell, uint32_t image);

#endif
