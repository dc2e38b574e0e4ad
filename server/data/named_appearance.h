/* Named appearances, which survive restarts in a file of this server. Answers read a copy in
 * memory.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_NAMED_APPEARANCE_H
#define SERVER_NAMED_APPEARANCE_H

#include "server/data/named_appearance_table.h"

struct named_appearance; /* any thread */

/* Opens the names in dir, and makes the folder if needed. Close *out with named_appearance_close.
 * ERR_BUSY: another process uses it. ERR_FORMAT: the file is damaged or belongs to another program.
 * ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code named_appearance_open(const char *dir, struct named_appearance **out,
                                    struct err *e) ERR_USE;
/* Checks whether that would succeed. A server that uses the folder is not an error. */
enum err_code named_appearance_check(const char *dir, struct err *e) ERR_USE;
void named_appearance_close(struct named_appearance **k); /* *k may be NULL; sets it to NULL */

/* Returns all present names; free with named_appearance_drop. k NULL: NULL. */
struct named_appearance_table *named_appearance_now(struct named_appearance *k);

/* If-Match and If-None-Match of a request; NULL: absent. */
struct named_appearance_condition {
    const char *match, *none_match;
};
/* Stores a row, and replaces one with the same name; *created: there was none. After ERR_OK it is
 * on the disk. It waits for that. ERR_DATA: a condition is not met. ERR_LIMIT: too many names, or
 * the disk is full. ERR_IO, ERR_FORMAT, ERR_MEM. After these nothing has changed. */
enum err_code named_appearance_put(struct named_appearance *k,
                                   const struct named_appearance_row *row,
                                   const struct named_appearance_condition *when, bool *created,
                                   struct err *e) ERR_USE;
/* Removes a name. ERR_NOENT: there is none. Else as named_appearance_put. */
enum err_code named_appearance_remove(struct named_appearance *k, const char *ds, const char *name,
                                      const struct named_appearance_condition *when,
                                      struct err *e) ERR_USE;

#endif
