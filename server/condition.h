/* The conditional, partial and negotiating headers.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_CONDITION_H
#define SERVER_CONDITION_H

#include "core/base.h"

/* Does If-None-Match (a list or *) hold `etag`, compared weakly? NULL header: false. */
bool condition_none_match(const char *header, const char *etag);
/* May a resource whose entity tag is this (NULL: there is none) be changed by a request with these
 * headers (NULL: absent)? If-Match holds for one of its tags, or * for any; If-None-Match for none
 * of them, or * for no resource. What cannot be read holds for nothing. */
bool condition_may_write(const char *match, const char *none_match, const char *etag);
enum condition_range { RANGE_ALL, RANGE_PART, RANGE_BAD };
/* One `bytes=` range over a body of `size`. Several ranges, other units and nonsense mean
 * RANGE_ALL. */
enum condition_range condition_range(const char *header, uint64_t size, uint64_t *first,
                                     uint64_t *length);
/* Accept-Encoding takes gzip (q > 0). */
bool condition_gzip(const char *header);
/* It takes brotli, and not less gladly than gzip. */
bool condition_brotli(const char *header);
/* Accept prefers text/html over application/json. */
bool condition_html(const char *header);

/* Was the thing last modified (modified_s, since 1970) when If-Modified-Since says? A file that was
 * put back is older than that and another one all the same. False where the header is absent or no
 * date of the form that RFC 9110, section 5.6.7 asks to be sent. */
bool condition_not_modified(const char *header, int64_t modified_s);
/* A time in that form. */
enum { CONDITION_DATE = 32 };
void condition_date(int64_t at_s, char out[CONDITION_DATE]);

#endif
