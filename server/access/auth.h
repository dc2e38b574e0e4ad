/* Rights to read and write: tokens, sessions and signed addresses, from the file of --auth.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_AUTH_H
#define SERVER_AUTH_H

#include "core/base.h"

/* A seal is "KEY.EXP.WORD.NAME.SIGNATURE", in characters that need no escape in an address or a
 * cookie. */
enum { AUTH_QUERY_MAX = 512, AUTH_SEAL_MAX = 256 };
enum auth_need { AUTH_READ, AUTH_RENDER, AUTH_WRITE, AUTH_ADMIN };
enum auth_answer {
    AUTH_OK,
    AUTH_UNKNOWN, /* the request showed no credentials */
    AUTH_FORBIDDEN,
    AUTH_EXPIRED,
    AUTH_LONG /* it would be valid for longer than the file allows */
};
/* The rights to a dataset that a signature gives. */
enum auth_scope { AUTH_SCOPE_READ, AUTH_SCOPE_RENDER, AUTH_SCOPE_BOTH };
struct auth; /* immutable, reference-counted; any thread */

/* Reads a file: {"keys": {"NAME": "32 characters or more"}, "tokens": [{"sha256": "64 hexadecimal
 * digits of the token", "scope": ["read:NAME", "render:NAME", "write:NAME", "admin"]}], "public":
 * ["NAME"], "max_age_s": 2592000, "session_s": 43200}. A * stands for all datasets. Close *out with
 * auth_close. ERR_ARG: users other than the owner and a group may read the file. ERR_IO, ERR_NOENT,
 * ERR_FORMAT (names the member), ERR_LIMIT, ERR_MEM. */
enum err_code auth_open(const char *path, struct auth **out, struct err *e) ERR_USE;
/* As auth_open, from text [n]; name is for messages. */
enum err_code auth_parse(const char *text, size_t n, const char *name, struct auth **out,
                         struct err *e) ERR_USE;
struct auth *auth_ref(struct auth *a);                         /* NULL: NULL */
void auth_close(struct auth **a);                              /* gives a reference back */
bool auth_is_same(const struct auth *a, const struct auth *b); /* was it read from equal bytes? */
/* Returns whether a dataset can be read without credentials. */
bool auth_is_public(const struct auth *a, const char *ds);

struct auth_request {
    const char *authorization, *cookie; /* NULL: there is none */
    const char *seal;                   /* [n_seal], of a signed address; NULL: none */
    size_t n_seal;
    const char *path, *query; /* [n_path], [n_query] */
    size_t n_path, n_query;
    bool names_others; /* the requested document names other addresses */
};
/* Checks whether a request may do `need` with dataset ds (NULL with AUTH_ADMIN). A seal or a cookie
 * opens a whole dataset for reading. A signature in the query opens one path with the rest of the
 * query alone, and no document that names other addresses. Writing needs a token. */
enum auth_answer auth_check(const struct auth *a, enum auth_need need, const char *ds,
                            const struct auth_request *r, int64_t now_s);
/* Checks whether a seal [n] of a signed address is valid now, whatever it opens. */
enum auth_answer auth_check_seal(const struct auth *a, const char *seal, size_t n, int64_t now_s);

/* Makes the seal that opens dataset ds until exp_s. key NULL: the only key of the file. ERR_ARG: no
 * such key, no name of a dataset, or a time that auth_check refuses. */
enum err_code auth_sign(const struct auth *a, const char *key, enum auth_scope scope,
                        const char *ds, int64_t exp_s, int64_t now_s, char out[AUTH_SEAL_MAX],
                        struct err *e) ERR_USE;
/* Makes the query "exp=...&key=...&sig=..." that opens one path, with the query that stands behind
 * '?' in `path` and no other, until exp_s. It goes behind that query. ERR_ARG as auth_sign, and if
 * `path` is no path. */
enum err_code auth_sign_path(const struct auth *a, const char *key, const char *path, int64_t exp_s,
                             int64_t now_s, char out[AUTH_QUERY_MAX], struct err *e) ERR_USE;
/* Makes the seal of a session. For *for_s it has the token's rights to read and to request
 * drawings. AUTH_OK; AUTH_FORBIDDEN: no such token; AUTH_UNKNOWN: the file has no key to sign with.
 */
enum auth_answer auth_session(const struct auth *a, const char *token, int64_t now_s,
                              char out[AUTH_SEAL_MAX], int64_t *for_s);
extern const char AUTH_COOKIE[]; /* the name of the cookie with this seal */

#endif
