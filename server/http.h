/* The HTTP side: libmicrohttpd.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_HTTP_H
#define SERVER_HTTP_H

#include "server/services.h"

enum http_side { HTTP_PUBLIC, HTTP_ADMIN }; /* HTTP_ADMIN: the listener of operators */
struct http;
/* Take the port that cfg says, or the socket that a supervisor holds, before anything slow is
 * started; clients wait in the backlog. The errors of listen_open, ERR_MEM. */
enum err_code http_open(struct services *s, enum http_side side, struct http **out,
                        struct err *e) ERR_USE;
/* The options that http_open reads, without listening. ERR_ARG. */
enum err_code http_check(const struct server_config *cfg, struct err *e) ERR_USE;
/* Answer; needs s->jobs. ERR_IO, ERR_MEM. */
enum err_code http_start(struct http *h, struct err *e) ERR_USE;
/* Descriptors that so many connections need, with those beyond that are answered 503. */
size_t http_descriptors(size_t max_connections);
uint16_t http_port(const struct http *h);
/* Stop listening, finish what is under way (at most drain_timeout_s), then everything is closed. */
void http_close(struct http **h);

#endif
