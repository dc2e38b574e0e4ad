/* The end of a change of a named appearance.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ANSWER_KEPT_H
#define SERVER_ANSWER_KEPT_H

#include "server/response.h"

/* Answers a change that a job made (work.h), from its result. It takes over the result's body. */
void answer_kept_finish(struct job_result *result, struct response *out);

#endif
