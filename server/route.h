/* Request + services -> response.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ROUTE_H
#define SERVER_ROUTE_H

#include "server/response.h"

/* Answer at once, or set out->work: the caller runs it as a job and comes back with route_finish.
 * Never blocks, never fails. response_free out. */
void route_answer(struct services *s, const struct request *r, struct response *out);
/* The job has ended: turn its result (whose body reference is taken) into the answer. */
void route_finish(struct services *s, const struct request *r, struct job_result *result,
                  struct response *out);

#endif
