/* Bare earth under a surface, and what stands on it.
 *
 * Ground is found by progressive morphology (Zhang and others 2003, doi:10.1109/TGRS.2003.810682)
 * on cells of about a metre that hold the lowest surface in them. Openings by growing squares
 * remove what is narrower than the square. A cell that an opening lowers by more than the ground
 * can rise over the square is not ground, unless a gentle slope connects it with ground. Cells that
 * are not ground are filled between the ground around them (Laplace's equation).
 * docs/decisions/030-terrain-and-survey-files.md gives the reasons.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_BARE_H
#define SURVEY_BARE_H

#include <stdint.h>

#include "core/err.h"

struct bare_rule {
    double widest_m; /* nothing wider stands on the ground; 0: BARE_WIDEST_M */
    double slope;    /* rise of the ground over a metre, at most; 0: BARE_SLOPE */
};
#define BARE_WIDEST_M 60.0
#define BARE_SLOPE 0.3
#define BARE_CELL_M 1.0
#define BARE_NEAR_M 0.3 /* a surface at most this far above the bare earth is ground */
#define BARE_CELLS_MAX 1.0e8

/* Classes of LAS 1.4. */
enum bare_class {
    BARE_OTHER = 1,
    BARE_GROUND = 2,
    BARE_LOW_PLANT = 3, /* below 0.5 m */
    BARE_PLANT = 4,     /* below 2 m */
    BARE_HIGH_PLANT = 5,
    BARE_BUILDING = 6
};

/* Filters a height field [h][w] of cells in place; NAN: nothing known. Afterwards every cell has a
 * height, except if none had one. ERR_MEM. */
enum err_code bare_filter(float *height_m, uint32_t w, uint32_t h, double cell_m,
                          const struct bare_rule *r, struct err *e) ERR_USE;

/* The bare earth of a map (survey/bare_draw.h). Free with bare_close. */
struct bare {
    uint32_t cell_px, w, h; /* of a cell, in pixels of the map; cells */
    double cell_m;
    float *height_m; /* [h][w] */
};
void bare_close(struct bare **g);
/* Height of the bare earth at the middle of pixel (x, y) of the map. */
float bare_at(const struct bare *g, uint32_t x, uint32_t y);
/* The class of a surface at above_m over the ground, by its colour [3]: plants are green. */
enum bare_class bare_class_of(float above_m, const float *rgb);

#endif
