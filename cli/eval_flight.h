/* `citysplat eval --flight`: visible jumps while a camera flies into a city (lab/EVALUATION.md).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_EVAL_FLIGHT_H
#define CLI_EVAL_FLIGHT_H

#include "lod/pick.h"
#include "lod/store.h"
#include "lod/view.h"

struct json_t;
struct scene;

struct eval_flight_request {
    const struct scene *scene; /* gives the path of the flight and its height */
    size_t frames;
    size_t fade;          /* length of a change of levels in frames; 0: at once */
    uint32_t max_edge_px; /* width of the pictures; 0: 640 */
    struct json_t *rows;  /* a JSON array; the results are appended */
};
/* Flies twice, with the levels of `po` and with the finest level alone, and prints a row for each.
 * ERR_ARG: fewer than two frames, a scene without points, or a fade in a store with appearance.
 * ERR_MEM, and the errors of drawing. */
enum err_code eval_flight_run(const struct eval_flight_request *q, struct view *v,
                              const struct render_options *ro, const struct pick_options *po,
                              struct err *e) ERR_USE;

#endif
