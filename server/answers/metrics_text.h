/* The Prometheus text of all counters.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_METRICS_TEXT_H
#define SERVER_METRICS_TEXT_H

#include "server/answers/services.h"

/* Appends it to `out`. ERR_MEM. */
enum err_code metrics_text_write(struct services *s, struct buf *out, struct err *e) ERR_USE;

#endif
