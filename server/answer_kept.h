/* How a change of a kept appearance ends.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ANSWER_KEPT_H
#define SERVER_ANSWER_KEPT_H

#include "server/response.h"

/* The answer to a change that a job made (work.h): its result, whose body is taken. */
void answer_kept_finish(struct job_result *result, struct response *out);

#endif
