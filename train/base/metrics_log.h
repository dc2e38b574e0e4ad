/* metrics.jsonl: one JSON object a line.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_METRICS_LOG_H
#define TRAIN_METRICS_LOG_H

#include <stdbool.h>

#include "core/err.h"

struct json_t; /* jansson.h */

struct metrics_log; /* an open metrics.jsonl */
/* Begins the file, or appends to it. Close it with metrics_log_close. ERR_IO, ERR_MEM. */
enum err_code metrics_log_open(const char *path, bool append, struct metrics_log **out,
                               struct err *e) ERR_USE;
/* Appends the line {"event": event, ...}. It takes over the reference to `members`; NULL means that
 * they ran out of memory. ERR_MEM, ERR_IO. */
enum err_code metrics_log_line(struct metrics_log *m, const char *event, struct json_t *members,
                               struct err *e) ERR_USE;
void metrics_log_close(struct metrics_log **m);
#endif
