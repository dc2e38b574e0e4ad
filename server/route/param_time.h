/* Dates and times in a query.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_PARAM_TIME_H
#define SERVER_PARAM_TIME_H

#include "core/base.h"

struct text;

/* Parses text [n]: a date, or a time of RFC 3339. "Z" may be missing. from_s: seconds since 1970 by
 * the clock of the text. to_s (may be NULL): the end, which for a date is the end of that day.
 * Returns false if the text is neither date nor time. */
bool param_time_read(const char *text, size_t n, int64_t *from_s, int64_t *to_s);
/* Reads one of them, or two joined by '/', into a struct target_search. ".." is open (INT64_MIN,
 * INT64_MAX). ERR_NOENT: it is no such text. ERR_DATA: it ends before it begins. */
enum err_code param_time_interval(struct text *one, void *search, struct err *e) ERR_USE;
/* Writes a time as "2024-06-01T10:00:00Z" or "..". */
void param_time_write(int64_t s, struct buf *out);

#endif
