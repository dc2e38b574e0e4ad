/* Dates and times in a query.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_PARAM_TIME_H
#define SERVER_PARAM_TIME_H

#include "core/base.h"

struct text;

/* Reads a date, or a time of RFC 3339 with an offset, "Z" or neither: seconds since 1970 00:00 by
 * the same clock. to_s (may be NULL): its end; for a date the end of the day. Returns false if it
 * is neither. */
bool param_time_read(const char *text, size_t n, int64_t *from_s, int64_t *to_s);
/* Reads one of them, or two joined by '/', where ".." is open (INT64_MIN, INT64_MAX). ERR_NOENT: it
 * is no such text. ERR_DATA: it ends before it begins. */
enum err_code param_time_interval(struct text *one, int64_t time_s[2], struct err *e) ERR_USE;
/* Writes a time as "2024-06-01T10:00:00Z" or "..". */
void param_time_write(int64_t s, struct buf *out);

#endif
