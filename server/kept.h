/* Named appearances, which survive restarts: an SQLite file in --state-dir, and a copy in memory
 * that answers read.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_KEPT_H
#define SERVER_KEPT_H

#include "server/body.h"
#include "server/target.h"

enum { KEPT_DATASET_MAX = 1000, KEPT_MAX = 4096 }; /* most names of one dataset; of all */

struct kept_row {
    char ds[64], name[TARGET_KEPT_MAX];
    char text[TARGET_APPEARANCE_MAX]; /* the meaning of the name, see appearance_api.h */
    struct hash128 model;             /* network of an embedding; 0: the text names photographs */
};
struct kept_table { /* all names at one moment; immutable, reference-counted */
    _Atomic uint32_t refs;
    size_t n;
    struct kept_row *row; /* [n], sorted by ds, then name */
};
struct kept; /* any thread */

/* Opens the names in dir, and makes the folder if needed. Close *out with kept_close. ERR_BUSY:
 * another process uses it. ERR_FORMAT: the file is damaged or belongs to another program. ERR_IO,
 * ERR_LIMIT, ERR_MEM. */
enum err_code kept_open(const char *dir, struct kept **out, struct err *e) ERR_USE;
/* Checks whether kept_open would succeed. A server that uses the folder is not an error. */
enum err_code kept_check(const char *dir, struct err *e) ERR_USE;
void kept_close(struct kept **k); /* *k may be NULL; sets it to NULL */

/* Returns all present names; free with kept_drop. k NULL: NULL. */
struct kept_table *kept_now(struct kept *k);
void kept_drop(struct kept_table **t);             /* *t may be NULL; sets it to NULL */
struct kept_table *kept_ref(struct kept_table *t); /* t NULL: NULL */
/* Finds a name; borrowed from t. NULL: there is none, or t is NULL. */
const struct kept_row *kept_find(const struct kept_table *t, const char *ds, const char *name);
/* kept_of: number of names of a dataset, and the first of them. kept_hash: hash of their content.
 */
size_t kept_of(const struct kept_table *t, const char *ds, const struct kept_row **first);
struct hash128 kept_hash(const struct kept_table *t, const char *ds);
/* The entity tag of a name's content. */
void kept_etag(const struct kept_row *row, char out[BODY_ETAG_SIZE]);

/* If-Match and If-None-Match of a request; NULL: absent. */
struct kept_condition {
    const char *match, *none_match;
};
/* Stores a row, and replaces one with the same name; *created: there was none. After ERR_OK it is
 * on the disk. It waits for the disk. ERR_DATA: a condition is not met. ERR_LIMIT: too many names,
 * or the disk is full. ERR_IO, ERR_FORMAT, ERR_MEM. After an error nothing has changed. */
enum err_code kept_put(struct kept *k, const struct kept_row *row,
                       const struct kept_condition *when, bool *created, struct err *e) ERR_USE;
/* Removes a name. ERR_NOENT: there is none. Else as kept_put. */
enum err_code kept_remove(struct kept *k, const char *ds, const char *name,
                          const struct kept_condition *when, struct err *e) ERR_USE;

#endif
