/* The listening socket.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_LISTEN_H
#define SERVER_LISTEN_H

#include "core/base.h"

#define LISTEN_PORT "--port N"
/* Listen on an address and port; `option` is what says so, for messages. *fd is the caller's to
 * close, *port the one that was taken. ERR_ARG (no IP address), ERR_BUSY (the port is taken: names
 * it, and what to do), ERR_IO. */
enum err_code listen_open(const char *address, int port, const char *option, int *fd,
                          uint16_t *taken, struct err *e) ERR_USE;
/* The same of "ADDR:PORT", "[::1]:9090". */
enum err_code listen_open_at(const char *text, const char *option, int *fd, uint16_t *taken,
                             struct err *e) ERR_USE;
/* Take over a socket that a supervisor listens on. ERR_ARG (it is not one that accepts
 * connections). */
enum err_code listen_take(int fd, uint16_t *port, struct err *e) ERR_USE;

#endif
