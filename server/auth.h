/* Who may read what: tokens and signed addresses, from the file of --auth.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_AUTH_H
#define SERVER_AUTH_H

#include "core/base.h"

enum { AUTH_QUERY_MAX = 512 };
enum auth_need { AUTH_READ, AUTH_RENDER, AUTH_WRITE, AUTH_ADMIN };
enum auth_answer {
    AUTH_OK,
    AUTH_UNKNOWN,
    AUTH_FORBIDDEN,
    AUTH_EXPIRED
};           /* UNKNOWN: nothing was shown */
struct auth; /* immutable: any thread */

/* Read a file: {"keys": {"NAME": "32 characters or more"}, "tokens": [{"sha256": "64 hexadecimal
 * digits of the token", "scope": ["read:NAME", "render:NAME", "write:NAME", "admin"]}], "public":
 * ["NAME"]},
 * where * stands for every dataset. auth_close it. ERR_IO, ERR_NOENT, ERR_FORMAT (says which
 * member), ERR_LIMIT, ERR_MEM. */
enum err_code auth_open(const char *path, struct auth **out, struct err *e) ERR_USE;
/* The same of its text[n]; name is for messages. */
enum err_code auth_parse(const char *text, size_t n, const char *name, struct auth **out,
                         struct err *e) ERR_USE;
void auth_close(struct auth **a);
/* Does it need nothing to be read? */
bool auth_is_public(const struct auth *a, const char *ds);
/* May whoever sent this do that with dataset ds (NULL of AUTH_ADMIN)? A signature in
 * the query holds for paths that begin with its scope, until its time, and for reading alone. */
struct auth_request {
    const char *authorization; /* NULL: none */
    const char *path, *query;  /* [n_path], [n_query] */
    size_t n_path, n_query;
};
enum auth_answer auth_check(const struct auth *a, enum auth_need need, const char *ds,
                            const struct auth_request *r, int64_t now_s);
/* The query "exp=...&key=...&scope=...&sig=..." that opens paths below `scope` until exp_s. key
 * NULL: the only one that there is. ERR_ARG (no such key, a scope that is no path). */
enum err_code auth_sign(const struct auth *a, const char *key, const char *scope, int64_t exp_s,
                        char out[AUTH_QUERY_MAX], struct err *e) ERR_USE;

#endif
