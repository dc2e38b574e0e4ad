/* The header fields of an answer.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_HEADERS_H
#define SERVER_HEADERS_H

#include "server/answers/response.h"

enum { HEADERS_MAX = 32 };
struct headers { /* values are borrowed from the response, or lie in the texts below */
    size_t n;
    struct {
        const char *name, *value;
    } field[HEADERS_MAX];
    char range[80], retry[16], timing[80], modified[32];
};
/* Returns whether the answer repeats the id that the client sent. Answers that a cache may keep do
 * not, because other clients would get the id. */
bool headers_repeat_id(const struct response *r);
/* Makes the header fields of r. last: the connection closes after it. out must not outlive r. */
void headers_make(const struct response *r, bool last, struct headers *out);

#endif
