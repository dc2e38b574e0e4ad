/* The query of a prefetch list, and what it has in common with others: between target.c and
 * target_seed.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_TARGET_SEED_H
#define SERVER_TARGET_SEED_H

#include "server/target.h"
#include "server/text.h"

enum { TARGET_LIMIT = 10000, TARGET_LIMIT_MAX = 100000 }; /* lines of a prefetch list */

/* The rest must be one of the extensions [first, last]. */
bool target_take_format(struct text *t, enum format first, enum format last, enum format *out);
/* preset=NAME, sh=N, appearance=A or, of terrain, encoding=E, of views, background=B and depth=U,
 * each at most once; *known says whether it was one of them. ERR_FORMAT. */
enum err_code target_take_form(struct text *one, struct target *target, bool *known,
                               struct err *e) ERR_USE;
/* The query of a prefetch list. ERR_FORMAT; ERR_DATA (numbers out of range). */
enum err_code target_parse_seed(const char *query, size_t n, struct target *out,
                                struct err *e) ERR_USE;
/* Such a query again, "?…", that goes on after so many lines. path: of the course, for the borrowed
 * one may be gone; NULL where there is none. */
void target_seed_query(const struct target *t, const char *path, uint32_t after, struct buf *out);

#endif
