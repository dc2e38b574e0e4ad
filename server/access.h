/* The access log: one line a request, written in batches.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ACCESS_H
#define SERVER_ACCESS_H

#include "core/base.h"

/* ACCESS_LINE: the form of all other log lines, text or JSON. ACCESS_COMBINED: the combined format
 * of Apache and nginx, for programs that read it. */
enum access_format { ACCESS_LINE, ACCESS_COMBINED };
enum { ACCESS_TARGET = 2304 }; /* bytes of an address that the log keeps */
struct access;
struct access_line {
    const char *method, *route, *target, *client, *id;
    const char *cache, *referer, *agent; /* may be NULL */
    int status;
    uint64_t bytes;
    double seconds, job_s; /* job_s < 0: there was no job */
};
/* Opens the log. Close *out with access_close. ERR_MEM. */
enum err_code access_open(enum access_format format, struct access **out, struct err *e) ERR_USE;
void access_add(struct access *a,
                const struct access_line *x); /* any thread; never waits for I/O */
void access_flush(struct access *a);
void access_close(struct access **a); /* writes what is left */

#endif
