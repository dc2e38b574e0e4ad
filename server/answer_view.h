/* What answers with pictures share.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ANSWER_VIEW_H
#define SERVER_ANSWER_VIEW_H

#include "server/response.h"

/* False, with the problem set, when nothing can be drawn. Sets out->unnamed while the device
 * starts: ask before the result is named. */
bool answer_view_can_draw(struct services *s, struct response *out);
/* False, with the problem set, when pictures cannot be made or this one is too large, or too much
 * would be drawn for it. Settles how fine it is drawn. */
bool answer_view_check(struct services *s, uint32_t width_px, uint32_t height_px, enum format f,
                       struct paint *paint, struct response *out);

#endif
