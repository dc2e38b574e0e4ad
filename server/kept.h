/* Appearances that somebody gave a name, kept over restarts: one SQLite file in --state-dir, and a
 * copy in memory that answers read.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_KEPT_H
#define SERVER_KEPT_H

#include "server/body.h"
#include "server/target.h"

enum { KEPT_DATASET_MAX = 1000, KEPT_MAX = 4096 }; /* of one dataset, of all */

struct kept_row {
    char ds[64], name[TARGET_KEPT_MAX];
    char text[TARGET_APPEARANCE_MAX]; /* what the name stands for: see appearance_api.h */
    struct hash128 model;             /* network that an embedding is for; 0: the text names
                                       * photographs */
};
struct kept_table { /* immutable, counted: all names at one moment */
    _Atomic uint32_t refs;
    size_t n;
    struct kept_row *row; /* [n], by ds, then name */
};
struct kept; /* any thread */

/* The names in dir, which is made where it is not there; kept_close it. One process at a time:
 * ERR_BUSY. ERR_FORMAT: the file is damaged or another program's; ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code kept_open(const char *dir, struct kept **out, struct err *e) ERR_USE;
/* Could it be opened? A server that uses it is no error. */
enum err_code kept_check(const char *dir, struct err *e) ERR_USE;
void kept_close(struct kept **k); /* accepts NULL inside, leaves NULL */

/* All names of now; kept_drop it. k NULL: NULL. */
struct kept_table *kept_now(struct kept *k);
void kept_drop(struct kept_table **t);             /* accepts NULL inside, leaves NULL */
struct kept_table *kept_ref(struct kept_table *t); /* of NULL: NULL */
/* NULL: there is none, as where t is NULL. Borrowed from t. */
const struct kept_row *kept_find(const struct kept_table *t, const char *ds, const char *name);
/* Those of a dataset: how many, and the first; a hash of all that they say. */
size_t kept_of(const struct kept_table *t, const char *ds, const struct kept_row **first);
struct hash128 kept_hash(const struct kept_table *t, const char *ds);
/* The entity tag of what a name stands for. */
void kept_etag(const struct kept_row *row, char out[BODY_ETAG_SIZE]);

/* If-Match and If-None-Match of a request, NULL: absent. */
struct kept_condition {
    const char *match, *none_match;
};
/* Keep a row, in place of one of its name; *created: there was none. When this returns ERR_OK it is
 * on the disk. ERR_DATA: a condition does not hold; ERR_LIMIT: too many names, or the disk is full;
 * ERR_IO, ERR_FORMAT, ERR_MEM. In all of these nothing has changed. Waits for the disk. */
enum err_code kept_put(struct kept *k, const struct kept_row *row,
                       const struct kept_condition *when, bool *created, struct err *e) ERR_USE;
/* Forget one. ERR_NOENT: there is none; the others as of kept_put. */
enum err_code kept_remove(struct kept *k, const char *ds, const char *name,
                          const struct kept_condition *when, struct err *e) ERR_USE;

#endif
