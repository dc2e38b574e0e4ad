/* `citysplat eval --flight`: what pops while a camera flies into a city (docs/evaluation.md).
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
    const struct scene *scene; /* where to fly, and how high "high" is */
    size_t frames;
    size_t fade;          /* frames that a change of levels takes; 0: it is at once */
    uint32_t max_edge_px; /* width of the pictures; 0: 640 */
    struct json_t *rows;  /* a JSON array that the figures are added to */
};
/* Fly, with po's levels and with the finest level alone, and print a row of each. ERR_ARG for fewer
 * than two frames, a scene without points, or a fade of tiles with appearance; ERR_MEM, and what
 * drawing gives. */
enum err_code eval_flight_run(const struct eval_flight_request *q, struct view *v,
                              const struct render_options *ro, const struct pick_options *po,
                              struct err *e) ERR_USE;

#endif
