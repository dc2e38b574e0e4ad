/* Refuses invalid requests before any answer looks at them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_REQUEST_GUARD_H
#define SERVER_REQUEST_GUARD_H

#include "server/base/config.h"
#include "server/base/request.h"

struct request_guard { /* {.req = r}, then request_guard_field for each header field */
    struct request *req;
    size_t n, n_length, n_coding, n_host;
    bool bad, coding_bad, has_origin;
    uint64_t length;
};
enum method request_guard_method(const char *name);
const char *request_guard_method_name(enum method m); /* for the log */
/* Checks one header field, and stores in req the values that answers need (borrowed). */
void request_guard_field(struct request_guard *g, const char *name, size_t n_name,
                         const char *value, size_t n_value);
/* Checks the request after all fields; req has its method and target. Returns 0 if it may go on,
 * else the status of the refusal, and the reason. */
int request_guard_check(const struct request_guard *g, const struct server_config *cfg,
                        const char *version, const char **why);
/* The authority of a target in absolute form, in place of Host (RFC 9112, section 3.2.2). Call it
 * after all fields. */
void request_guard_authority(struct request_guard *g, const char *authority);
/* Returns whether nothing indicates that a request comes from somebody else than its client: it has
 * no sign of a proxy (RFC 9110, section 7.6.3; fields that proxies add; HTTP/1.0, which nginx uses
 * by default), and does not come from a page of another site in a browser (Origin). */
bool request_guard_alone(const struct request_guard *g, const char *version);

#endif
