/* The listening socket.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_LISTEN_H
#define SERVER_LISTEN_H

#include "core/base.h"
#include "server/config.h"

/* Listen on cfg's address and port. *fd is the caller's to close, *port the one that was taken.
 * ERR_ARG (no IP address), ERR_BUSY (the port is taken: names it, and what to do), ERR_IO. */
enum err_code listen_open(const struct server_config *cfg, int *fd, uint16_t *port,
                          struct err *e) ERR_USE;

#endif
