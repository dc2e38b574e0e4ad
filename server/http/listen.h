/* Listening sockets.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_LISTEN_H
#define SERVER_LISTEN_H

#include "core/base.h"

#define LISTEN_PORT "--port N"
/* Listens on an address and port. `option` names the option in messages. The caller closes *fd.
 * *taken is the port. ERR_ARG (not an IP address), ERR_BUSY (the port is in use; the message says
 * what to do), ERR_IO. */
enum err_code listen_open(const char *address, int port, const char *option, int *fd,
                          uint16_t *taken, struct err *e) ERR_USE;
/* As listen_open, for "ADDR:PORT" or "[::1]:8078". */
enum err_code listen_open_at(const char *text, const char *option, int *fd, uint16_t *taken,
                             struct err *e) ERR_USE;
/* Check what the two above are given, and open nothing. ERR_ARG. */
enum err_code listen_check(const char *address, struct err *e) ERR_USE;
enum err_code listen_check_at(const char *text, const char *option, struct err *e) ERR_USE;
/* Is "ADDR:PORT" a place where a listener on `address` and `port` listens, too? Spellings do not
 * matter; 0.0.0.0 and :: are all addresses; port 0 is any free one. Both are checked before. */
bool listen_meet(const char *text, const char *address, int port);
/* Takes over a socket on which a supervisor listens. ERR_ARG: it does not accept connections. */
enum err_code listen_take(int fd, uint16_t *port, struct err *e) ERR_USE;

#endif
