/* Tables of named appearances: all names at one moment, sorted. A table is immutable once it is
 * shared between threads.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_KEPT_TABLE_H
#define SERVER_KEPT_TABLE_H

#include "server/body.h"
#include "server/target.h"

enum { KEPT_DATASET_MAX = 1000, KEPT_MAX = 4096 }; /* most names of one dataset; of all */

struct kept_row {
    char ds[64], name[TARGET_KEPT_MAX];
    char text[TARGET_APPEARANCE_MAX]; /* the meaning of the name, see appearance_api.h */
    struct hash128 model;             /* network of an embedding; 0: the text names photographs */
};
struct kept_table { /* reference-counted */
    _Atomic uint32_t refs;
    size_t n;
    struct kept_row *row; /* [n], sorted by ds, then name */
};
/* Allocates an empty table with room for n rows. NULL: out of memory. */
struct kept_table *kept_table_alloc(size_t n);
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

/* The rest is for kept*.c. Makes a copy of t in which the name stands for `row`, or for nothing
 * (row NULL). NULL: out of memory. */
struct kept_table *kept_table_change(const struct kept_table *t, const char *ds, const char *name,
                                     const struct kept_row *row);
void kept_table_sort(struct kept_table *t);
/* Returns whether a row that was read has a dataset, a name and a text that could be kept. */
bool kept_table_row_ok(const struct kept_row *row);

#endif
