/* The conditional, partial and negotiating headers.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_CONDITION_H
#define SERVER_CONDITION_H

#include "core/base.h"

/* Does If-None-Match (a list or *) hold `etag`, compared weakly? NULL header: false. */
bool condition_none_match(const char *header, const char *etag);
enum condition_range { RANGE_ALL, RANGE_PART, RANGE_BAD };
/* One `bytes=` range over a body of `size`. Several ranges, other units and nonsense mean
 * RANGE_ALL. */
enum condition_range condition_range(const char *header, uint64_t size, uint64_t *first,
                                     uint64_t *length);
/* Accept-Encoding takes gzip (q > 0). */
bool condition_gzip(const char *header);
/* Accept prefers text/html over application/json. */
bool condition_html(const char *header);

#endif
