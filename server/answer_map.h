/* What answers about the surface share.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ANSWER_MAP_H
#define SERVER_ANSWER_MAP_H

#include "server/response.h"

/* False, with the problem set, where nothing was surveyed: there are no maps and no heights. */
bool answer_map_is_surveyed(const struct dataset *d, struct response *out);

#endif
