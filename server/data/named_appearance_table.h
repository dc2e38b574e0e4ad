/* Tables of named appearances: all names at one moment, sorted. A table is immutable once it is
 * shared between threads.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_NAMED_APPEARANCE_TABLE_H
#define SERVER_NAMED_APPEARANCE_TABLE_H

#include "server/base/body.h"
#include "server/route/target.h"

enum {
    NAMED_APPEARANCE_DATASET_MAX = 1000,
    NAMED_APPEARANCE_MAX = 4096
}; /* most names of one dataset; of all */

struct named_appearance_row {
    char ds[64], name[TARGET_KEPT_MAX];
    char text[TARGET_APPEARANCE_MAX]; /* the meaning of the name, see appearance_api.h */
    struct hash128 model;             /* network of an embedding; 0: the text names photographs */
};
struct named_appearance_table { /* reference-counted */
    _Atomic uint32_t refs;
    size_t n;
    struct named_appearance_row *row; /* [n], sorted by ds, then name */
};
/* Allocates an empty table with room for n rows. NULL: out of memory. */
struct named_appearance_table *named_appearance_table_alloc(size_t n);
void named_appearance_drop(struct named_appearance_table **t); /* *t may be NULL; sets it to NULL */
struct named_appearance_table *
named_appearance_ref(struct named_appearance_table *t); /* t NULL: NULL */
/* Finds a name; borrowed from t. NULL: there is none, or t is NULL. */
const struct named_appearance_row *named_appearance_find(const struct named_appearance_table *t,
                                                         const char *ds, const char *name);
/* named_appearance_of: number of names of a dataset, and the first of them. named_appearance_hash:
 * hash of their content. */
size_t named_appearance_of(const struct named_appearance_table *t, const char *ds,
                           const struct named_appearance_row **first);
struct hash128 named_appearance_hash(const struct named_appearance_table *t, const char *ds);
/* The entity tag of a name's content. */
void named_appearance_etag(const struct named_appearance_row *row, char out[BODY_ETAG_SIZE]);

/* The rest is for named_appearance*.c. Makes a copy of t in which the name stands for `row`, or for
 * nothing (row NULL). NULL: out of memory. */
struct named_appearance_table *
named_appearance_table_change(const struct named_appearance_table *t, const char *ds,
                              const char *name, const struct named_appearance_row *row);
void named_appearance_table_sort(struct named_appearance_table *t);
/* Returns whether a row that was read has a dataset, a name and a text that could be kept. */
bool named_appearance_table_row_ok(const struct named_appearance_row *row);

#endif
