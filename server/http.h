/* The HTTP listeners, by libmicrohttpd.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_HTTP_H
#define SERVER_HTTP_H

#include "server/answers/services.h"

/* HTTP_ADMIN: the listener for operators. HTTP_SELF: on loopback, for self_test.c alone. */
enum http_side { HTTP_PUBLIC, HTTP_ADMIN, HTTP_SELF, HTTP_SELF_TLS };
struct http;
/* Opens the port of cfg, or takes over the socket of a supervisor, before slow parts of the server
 * start. Clients wait in the backlog. The errors of listen_open, ERR_MEM. */
enum err_code http_open(struct services *s, enum http_side side, struct http **out,
                        struct err *e) ERR_USE;
/* Checks the options that http_open reads, without listening. ERR_ARG. */
enum err_code http_check(const struct server_config *cfg, struct err *e) ERR_USE;
/* Begins to answer; it needs s->jobs. ERR_IO, ERR_MEM. */
enum err_code http_start(struct http *h, struct err *e) ERR_USE;
/* Is libmicrohttpd strict by itself (1.0 or newer)? Else request_screen.c stands before its
 * parser. */
bool http_is_strict(void);
const char *http_library(void); /* its version */
/* Number of file descriptors for max_connections connections, and for those above this limit, which
 * are answered 503. */
size_t http_descriptors(size_t max_connections);
uint16_t http_port(const struct http *h);
/* Stops listening, finishes requests in progress (for at most drain_timeout_s), then closes
 * everything. */
void http_close(struct http **h);

#endif
