/* Bare earth (survey/bare.h) of a store: the map of a request is drawn once and filtered as a
 * whole.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_BARE_DRAW_H
#define SURVEY_BARE_DRAW_H

#include "survey/map.h"

struct bare_rule;

/* Draws and filters. Free *out with bare_close. ERR_ARG: too many cells. Else the errors of
 * map_run. */
enum err_code bare_draw(struct nadir *n, const struct map_request *r, const struct bare_rule *rule,
                        struct bare **out, struct err *e) ERR_USE;

#endif
