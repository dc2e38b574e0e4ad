/* Named appearances, which survive restarts: in a file of this server, or in an object that several
 * servers share. A copy in memory answers read.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_KEPT_H
#define SERVER_KEPT_H

#include "server/kept_table.h"

struct kept; /* any thread */

/* Opens the names in dir, and makes the folder if needed. Close *out with kept_close. ERR_BUSY:
 * another process uses it. ERR_FORMAT: the file is damaged or belongs to another program. ERR_IO,
 * ERR_LIMIT, ERR_MEM. */
enum err_code kept_open(const char *dir, struct kept **out, struct err *e) ERR_USE;
/* Opens the names at an address, which are read again every refresh_s. If its server does not
 * answer now, there are no names until it does. ERR_FORMAT: the object is no list of names, or its
 * server ignores conditions. ERR_ARG, ERR_IO, ERR_LIMIT (the address is too long), ERR_MEM. */
enum err_code kept_open_shared(const char *url, double refresh_s, struct kept **out,
                               struct err *e) ERR_USE;
/* Checks whether one of these would succeed; dir or url is NULL. A server that uses the folder is
 * not an error. */
enum err_code kept_check(const char *dir, const char *url, struct err *e) ERR_USE;
/* Wakes all who wait, and lets nobody wait any more. k may be NULL. */
void kept_stop(struct kept *k);
void kept_close(struct kept **k); /* *k may be NULL; sets it to NULL */

/* Returns all present names; free with kept_drop. k NULL: NULL. */
struct kept_table *kept_now(struct kept *k);

/* If-Match and If-None-Match of a request; NULL: absent. */
struct kept_condition {
    const char *match, *none_match;
};
/* Stores a row, and replaces one with the same name; *created: there was none. After ERR_OK it is
 * on the disk or at the address. It waits for that. ERR_DATA: a condition is not met. ERR_LIMIT:
 * too many names, or the disk is full. ERR_BUSY: the server of the address does not answer now, and
 * the change may have been made. ERR_IO, ERR_FORMAT, ERR_MEM. After these nothing has changed. */
enum err_code kept_put(struct kept *k, const struct kept_row *row,
                       const struct kept_condition *when, bool *created, struct err *e) ERR_USE;
/* Removes a name. ERR_NOENT: there is none. Else as kept_put. */
enum err_code kept_remove(struct kept *k, const char *ds, const char *name,
                          const struct kept_condition *when, struct err *e) ERR_USE;

/* Returns whether other servers may keep names that kept_now does not have yet. k NULL: false. */
bool kept_is_shared(const struct kept *k);
/* A request that waits until shared names have been read once more. All who wait share one read,
 * which begins after they came, and reads have a distance, so clients cannot cause many. */
struct kept_waiter {
    /* Called exactly once, in another thread and without a lock, after kept_await returned true. */
    void (*wake)(struct kept_waiter *w);
    bool failed;              /* set before wake: the names could not be read */
    struct kept_waiter *next; /* belongs to kept.c */
};
/* False: the last read failed a moment ago, too many wait, or the server is stopping. */
bool kept_await(struct kept *k, struct kept_waiter *w);
struct kept_stats {
    uint64_t reads, failed; /* of shared names */
    double age_s;           /* since the last one that succeeded; < 0: none has */
};
/* Counts reads of shared names. k NULL or not shared: all 0. */
void kept_count(struct kept *k, struct kept_stats *out);

#endif
