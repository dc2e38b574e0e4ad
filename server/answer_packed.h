/* Answers of a dataset that is an exported file (packed.h).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ANSWER_PACKED_H
#define SERVER_ANSWER_PACKED_H

#include "server/response.h"

/* Answers in place of the function that the route table names for stores. What the file does not
 * hold is 404, which says so. */
void answer_packed(struct services *s, const struct request *r, struct dataset *d,
                   const struct target *t, route_function *of_stores, struct response *out);

#endif
