/* Shared by answers with pictures.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ANSWER_VIEW_H
#define SERVER_ANSWER_VIEW_H

#include "server/answers/response.h"

/* Returns whether anything can be drawn; if not, the problem is set. While the device starts it
 * sets out->unnamed, so call it before the result is named. */
bool answer_view_can_draw(struct services *s, struct response *out);
/* Checks a picture and chooses its supersampling. False: pictures are off, or this one is too large
 * or too expensive; the problem is set. */
bool answer_view_check(struct services *s, uint32_t width_px, uint32_t height_px, enum format f,
                       struct composite *paint, struct response *out);

/* The work of drawing a view: for streams, too. */
struct answer_view_own {
    struct draw_view view;
    struct appearance_choice appearance;
};
extern const struct work_kind answer_view_work;
/* Upper limit of the bytes of a view in any format, and the time that a usual one takes. */
size_t answer_view_room(const struct draw_view *v);
double answer_view_cost_ms(const struct draw_view *v);

#endif
