/* Shared by answers with pictures.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ANSWER_VIEW_H
#define SERVER_ANSWER_VIEW_H

#include "server/response.h"

/* Returns whether anything can be drawn; if not, the problem is set. While the device starts it
 * sets out->unnamed, so call it before the result is named. */
bool answer_view_can_draw(struct services *s, struct response *out);
/* Checks a picture and chooses its supersampling. False: pictures are off, or this one is too large
 * or too expensive; the problem is set. */
bool answer_view_check(struct services *s, uint32_t width_px, uint32_t height_px, enum format f,
                       struct paint *paint, struct response *out);

#endif
