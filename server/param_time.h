/* Dates and times in a query.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_PARAM_TIME_H
#define SERVER_PARAM_TIME_H

#include "core/base.h"

struct text;

/* A date, or a time as RFC 3339 writes it but for an offset, "Z" or nothing: seconds since 1970
 * 00:00 by the same clock. to_s (may be NULL): its end, of a date the day's. False: neither. */
bool param_time_read(const char *text, size_t n, int64_t *from_s, int64_t *to_s);
/* One of them, or two joined by '/', where ".." is open (INT64_MIN, INT64_MAX). ERR_NOENT: it is
 * no such text. ERR_DATA: it ends before it begins. */
enum err_code param_time_interval(struct text *one, int64_t time_s[2], struct err *e) ERR_USE;
/* The time again, "2024-06-01T10:00:00Z", or "..". */
void param_time_write(int64_t s, struct buf *out);

#endif
