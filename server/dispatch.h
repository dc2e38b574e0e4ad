/* Request + services -> response.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_DISPATCH_H
#define SERVER_DISPATCH_H

#include "server/response.h"

/* Answer at once, or set out->work: the caller runs it as a job and comes back with
 * dispatch_finish. Never blocks, never fails. response_free out. */
void dispatch_answer(struct services *s, const struct request *r, struct response *out);
/* The job has ended: turn its result (whose body reference is taken) into the answer. */
void dispatch_finish(struct services *s, const struct request *r, struct job_result *result,
                     struct response *out);

#endif
