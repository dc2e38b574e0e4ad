/* The part of a photograph that shows a cell.
 *
 * A photograph is looked at on a grid of samples. The ray of a sample meets the ground on the level
 * plane through the scene point that the photograph observes nearest to it, and the sample belongs
 * to the cell that owns this place (partition_owner). So ground at the rim of a survey, which has
 * hardly any points, has an owner too, and the samples of all cells share out the photograph.
 *
 * The part is an upright rectangle around the cell's samples, without the outermost WINDOW_TAIL on
 * each side, and with a border. If no sample of another cell follows beyond a side, that side moves
 * to the picture's own edge. Ground in the rectangle that lies outside of the cell is its
 * surroundings.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CELLS_WINDOW_H
#define SCENE_CELLS_WINDOW_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"
#include "core/splat/camera.h"

struct partition;
struct scene;

enum { WINDOW_COLUMNS = 32, WINDOW_ROWS = 24, WINDOW_NOBODY = -1 };

struct window {                   /* {0} is empty; free with window_free */
    const struct scene *scene;    /* borrowed */
    const struct partition *plan; /* borrowed */
    double ground_m;              /* median height of the points, for photographs without any */
    float *xyz;                   /* [n_tracks][3]: scratch */
    size_t n_owned;               /* samples that belong to a cell */
    /* index of the cell that owns what each sample shows; WINDOW_NOBODY: sky */
    int32_t owner[WINDOW_ROWS][WINDOW_COLUMNS];
};
/* Free *out with window_free. ERR_MEM. */
enum err_code window_open(const struct scene *s, const struct partition *plan, struct window *out,
                          struct err *e) ERR_USE;
void window_free(struct window *w);
/* Finds the owner of each sample of a photograph. ERR_MEM, ERR_LIMIT as in knn_build. */
enum err_code window_look(struct window *w, uint32_t image, struct err *e) ERR_USE;
/* The part of that photograph that shows a cell. Returns false, and the whole picture, if no sample
 * shows it. */
bool window_part(const struct window *w, size_t cell, struct camera_window *out);
/* The share of that photograph that shows a cell, 0..1: its samples among those that belong to
 * cells. The shares of all cells of a plan add up to 1. */
double window_share(const struct window *w, size_t cell);

#endif
