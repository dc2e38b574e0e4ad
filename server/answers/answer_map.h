/* Shared by answers about the surface.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ANSWER_MAP_H
#define SERVER_ANSWER_MAP_H

#include "server/answers/response.h"

/* Returns whether the dataset has surveyed ground. If not, it has no maps and heights, and *out
 * gets the error to send. */
bool answer_map_is_surveyed(const struct dataset *d, struct response *out);

#endif
