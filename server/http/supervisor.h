/* The supervisor that started the program: systemd, or another one with its protocol (sd_notify(3),
 * sd_listen_fds(3)). Without libsystemd at build time, or without a supervisor, these functions do
 * nothing.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_SUPERVISOR_H
#define SERVER_SUPERVISOR_H

#include "core/base.h"

/* A listening socket from the supervisor, with this FileDescriptorName. name NULL: the first that
 * is not called "admin". -1: there is none. The caller owns it. */
int supervisor_socket(const char *name);
void supervisor_ready(const char *status);
void supervisor_reloading(void);
/* The last message: the status of a later reload is not sent. */
void supervisor_stopping(void);
/* Interval in seconds at which the supervisor expects supervisor_well(); 0: never. */
double supervisor_watchdog_s(void);
void supervisor_well(void);

#endif
