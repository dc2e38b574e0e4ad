/* The access log: one line a request, written in batches.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ACCESS_H
#define SERVER_ACCESS_H

#include "core/base.h"

struct access;
struct access_line {
    const char *method, *target, *cache; /* cache may be NULL */
    int status;
    uint64_t bytes;
    double seconds;
};
enum err_code access_open(struct access **out, struct err *e) ERR_USE;
void access_add(struct access *a,
                const struct access_line *x); /* any thread, never waits for I/O */
void access_flush(struct access *a);
void access_close(struct access **a); /* flushes */

#endif
