/* Remembers work that failed recently, so that it is not repeated at once.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_FAILURE_H
#define SERVER_FAILURE_H

#include "core/base.h"

enum { FAILURE_KEPT = 64 };
struct failure {
    struct hash128 id;
    enum err_code code;
    char msg[256];
    double until_s, pause_s; /* pause_s 0: the entry is free */
};
struct failures { /* {.pause_s = x}: the first pause; the caller holds the lock */
    struct failure kept[FAILURE_KEPT];
    size_t next;
    double pause_s;
};

/* Returns the failure that forbids this work now, or NULL. */
const struct failure *failure_find(const struct failures *f, struct hash128 id, double now_s);
/* Records a failure. The work is not repeated for pause_s, and for twice as long after each further
 * failure, up to 60 s. */
void failure_note(struct failures *f, struct hash128 id, enum err_code code, const char *msg,
                  double now_s);
/* Records a success. */
void failure_forget(struct failures *f, struct hash128 id);
void failure_forget_all(struct failures *f);

#endif
