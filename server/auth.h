/* Rights to read and write: tokens and signed addresses, from the file of --auth.
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
};           /* UNKNOWN: the request showed no credentials */
struct auth; /* immutable; any thread */

/* Reads a file: {"keys": {"NAME": "32 characters or more"}, "tokens": [{"sha256": "64 hexadecimal
 * digits of the token", "scope": ["read:NAME", "render:NAME", "write:NAME", "admin"]}], "public":
 * ["NAME"]}. A * stands for all datasets. Close *out with auth_close. ERR_IO, ERR_NOENT, ERR_FORMAT
 * (names the member), ERR_LIMIT, ERR_MEM. */
enum err_code auth_open(const char *path, struct auth **out, struct err *e) ERR_USE;
/* As auth_open, from text [n]; name is for messages. */
enum err_code auth_parse(const char *text, size_t n, const char *name, struct auth **out,
                         struct err *e) ERR_USE;
void auth_close(struct auth **a);
/* Returns whether a dataset can be read without credentials. */
bool auth_is_public(const struct auth *a, const char *ds);
/* Checks whether a request may do `need` with dataset ds (NULL with AUTH_ADMIN). A signature in the
 * query is valid for paths that begin with its scope, until its time, and only for reading. */
struct auth_request {
    const char *authorization; /* NULL: there is none */
    const char *path, *query;  /* [n_path], [n_query] */
    size_t n_path, n_query;
};
enum auth_answer auth_check(const struct auth *a, enum auth_need need, const char *ds,
                            const struct auth_request *r, int64_t now_s);
/* Makes the query "exp=...&key=...&scope=...&sig=...", which allows reading paths below `scope`
 * until exp_s. key NULL: the only key of the file. ERR_ARG (no such key, or a scope that is no
 * path). */
enum err_code auth_sign(const struct auth *a, const char *key, const char *scope, int64_t exp_s,
                        char out[AUTH_QUERY_MAX], struct err *e) ERR_USE;

#endif
