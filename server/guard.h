/* Which requests are refused before anything looks at them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_GUARD_H
#define SERVER_GUARD_H

#include "server/response.h"

struct guard { /* {.req = r}, then guard_field for each header field */
    struct request *req;
    size_t n, n_length, n_coding, n_host;
    bool bad, coding_bad, host_local, has_origin;
    uint64_t length;
};
enum method guard_method(const char *name);
const char *guard_method_name(enum method m); /* for the log */
/* Look at one header field; what answers need of it is kept in req (borrowed). */
void guard_field(struct guard *g, const char *name, size_t n_name, const char *value,
                 size_t n_value);
/* All fields were seen, and req has its method and target. 0 when the request may go on, else the
 * status to refuse with, and why. */
int guard_check(const struct guard *g, const struct server_config *cfg, const char *version,
                const char **why);
/* Does it look like a request of this machine's own: asked for by a loopback name, and without a
 * sign of a proxy (RFC 9110, section 7.6.3; the fields that proxies add; HTTP/1.0, which nginx
 * speaks to what is behind it where it is not told otherwise), nor of a page of another site in
 * this machine's browser (Origin)? */
bool guard_local(const struct guard *g, const char *version);

#endif
