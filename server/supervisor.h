/* The supervisor that started the program, where there is one: systemd, or whoever speaks its
 * protocol (sd_notify(3), sd_listen_fds(3)). Without libsystemd at build, and without a supervisor,
 * nothing happens.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_SUPERVISOR_H
#define SERVER_SUPERVISOR_H

#include "core/base.h"

/* A listening socket that the supervisor holds: of this FileDescriptorName, or, where name is NULL,
 * the first that is not called "admin". -1: there is none. The caller owns it. */
int supervisor_socket(const char *name);
void supervisor_ready(const char *status);
void supervisor_reloading(void);
void supervisor_stopping(void);
/* How often it wants to hear that the program is well, in seconds; 0: never. */
double supervisor_watchdog_s(void);
void supervisor_well(void);

#endif
