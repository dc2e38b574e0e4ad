/* The HTTP side: libmicrohttpd.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_HTTP_H
#define SERVER_HTTP_H

#include "server/services.h"

struct http;
/* Take the port that cfg says, before anything slow is started; clients wait in the backlog.
 * The errors of listen_open, ERR_MEM. */
enum err_code http_open(struct services *s, struct http **out, struct err *e) ERR_USE;
/* Answer; needs s->jobs. ERR_IO, ERR_MEM. */
enum err_code http_start(struct http *h, struct err *e) ERR_USE;
/* Descriptors that so many connections need, with those beyond that are answered 503. */
size_t http_descriptors(size_t max_connections);
uint16_t http_port(const struct http *h);
/* Stop listening, finish what is under way (at most drain_timeout_s), then everything is closed. */
void http_close(struct http **h);

#endif
