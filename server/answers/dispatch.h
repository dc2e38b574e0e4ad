/* From a request to a response.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_DISPATCH_H
#define SERVER_DISPATCH_H

#include "server/answers/response.h"

/* Answers at once, or sets out->work. In that case the caller runs the work as a job and then calls
 * dispatch_finish. It never blocks and never fails. Free *out with response_free. */
void dispatch_answer(struct services *s, const struct request *r, struct response *out);
/* Turns the result of the job into the answer. It takes over the result's body. */
void dispatch_finish(struct services *s, const struct request *r, struct job_result *result,
                     struct response *out);

#endif
