/* What caches may keep of each dataset, where an operator changed the default.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_CACHE_POLICY_H
#define SERVER_CACHE_POLICY_H

#include "core/base.h"

enum { CACHE_POLICY_MAX = 32 };
enum cache_policy_kind { CACHE_POLICY_PUBLIC, CACHE_POLICY_PRIVATE, CACHE_POLICY_NO_STORE };
struct cache_policy { /* {0}: none */
    size_t n;
    struct {
        char ds[64]; /* "*": all others */
        enum cache_policy_kind kind;
        char moving[112]; /* Cache-Control of answers that change; "": the default */
    } row[CACHE_POLICY_MAX];
};

/* Parses "NAME=private,OTHER=no-store,*=300". NULL: none. ERR_ARG. */
enum err_code cache_policy_read(const char *list, struct cache_policy *out, struct err *e) ERR_USE;
/* The Cache-Control of an answer about a dataset, given its default `usual`. shared false: the
 * reader had to show credentials. The text is borrowed from p or from `usual`. */
const char *cache_policy_of(const struct cache_policy *p, const char *ds, bool shared,
                            const char *usual);

#endif
