/* Headers of conditional and partial requests, and of content negotiation.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_CONDITION_H
#define SERVER_CONDITION_H

#include "core/base.h"

/* Returns whether If-None-Match (a list or *) contains `etag`, by weak comparison. NULL header:
 * false. */
bool condition_none_match(const char *header, const char *etag);
/* Returns whether these headers (NULL: absent) allow a change of a resource with this entity tag
 * (NULL: it does not exist). If-Match allows it if it lists the tag, or is * and the resource
 * exists. If-None-Match allows it if it does not list the tag, or is * and the resource does not
 * exist. An invalid header allows nothing. */
bool condition_may_write(const char *match, const char *none_match, const char *etag);
enum condition_range { RANGE_ALL, RANGE_PART, RANGE_BAD };
/* Parses one `bytes=` range of a body of `size`. Several ranges, other units and invalid text give
 * RANGE_ALL. */
enum condition_range condition_range(const char *header, uint64_t size, uint64_t *first,
                                     uint64_t *length);
/* Returns whether Accept-Encoding allows gzip (q > 0). */
bool condition_gzip(const char *header);
/* Returns whether it allows brotli and does not prefer gzip. */
bool condition_brotli(const char *header);
/* Returns whether Accept prefers text/html to application/json. */
bool condition_html(const char *header);

/* Returns whether modified_s (since 1970) is exactly the time of If-Modified-Since. An older time
 * counts as modified, because a file that was restored from a backup is older and different. False:
 * the header is absent, or not in the date format that RFC 9110, section 5.6.7, prescribes. */
bool condition_not_modified(const char *header, int64_t modified_s);
/* Returns whether modified_s is later than the time of If-Unmodified-Since. False: the header is
 * absent or no date, or modified_s is 0, not known (RFC 9110, section 13.1.4). */
bool condition_modified(const char *header, int64_t modified_s);
/* Writes a time in that format. */
enum { CONDITION_DATE = 32 };
void condition_date(int64_t at_s, char out[CONDITION_DATE]);

#endif
