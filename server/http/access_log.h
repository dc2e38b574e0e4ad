/* The access log: one line a request, written in batches.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ACCESS_LOG_H
#define SERVER_ACCESS_LOG_H

#include "core/base.h"

/* ACCESS_LOG_LINE: the form of all other log lines, text or JSON. ACCESS_LOG_COMBINED: the combined
 * format of Apache and nginx, for programs that read it. */
enum access_format { ACCESS_LOG_LINE, ACCESS_LOG_COMBINED };
enum { ACCESS_LOG_TARGET = 2304 }; /* bytes of an address that the log keeps */
struct access_log;
struct access_log_line {
    const char *method, *route, *target, *client, *id;
    const char *cache, *referer, *agent; /* may be NULL */
    int status;
    uint64_t bytes;
    double seconds, job_s; /* job_s < 0: there was no job */
};
/* Opens the log. Close *out with access_log_close. ERR_MEM. */
enum err_code access_log_open(enum access_format format, struct access_log **out,
                              struct err *e) ERR_USE;
void access_log_add(struct access_log *a,
                    const struct access_log_line *x); /* any thread; never waits for I/O */
void access_log_flush(struct access_log *a);
void access_log_close(struct access_log **a); /* writes what is left */

#endif
