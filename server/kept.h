/* Named appearances, which survive restarts in a file of this server. Answers read a copy in
 * memory.
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
/* Checks whether that would succeed. A server that uses the folder is not an error. */
enum err_code kept_check(const char *dir, struct err *e) ERR_USE;
void kept_close(struct kept **k); /* *k may be NULL; sets it to NULL */

/* Returns all present names; free with kept_drop. k NULL: NULL. */
struct kept_table *kept_now(struct kept *k);

/* If-Match and If-None-Match of a request; NULL: absent. */
struct kept_condition {
    const char *match, *none_match;
};
/* Stores a row, and replaces one with the same name; *created: there was none. After ERR_OK it is
 * on the disk. It waits for that. ERR_DATA: a condition is not met. ERR_LIMIT: too many names, or
 * the disk is full. ERR_IO, ERR_FORMAT, ERR_MEM. After these nothing has changed. */
enum err_code kept_put(struct kept *k, const struct kept_row *row,
                       const struct kept_condition *when, bool *created, struct err *e) ERR_USE;
/* Removes a name. ERR_NOENT: there is none. Else as kept_put. */
enum err_code kept_remove(struct kept *k, const char *ds, const char *name,
                          const struct kept_condition *when, struct err *e) ERR_USE;

#endif
