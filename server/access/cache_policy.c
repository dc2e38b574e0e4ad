/* Cache-Control by dataset. The default is `public`. A policy allows only browsers to cache, or
 * nobody, and sets the lifetime of documents that change. no-store is never changed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/access/cache_policy.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { CACHE_POLICY_SECONDS_MAX = 31536000 };

/* One "NAME=POLICY" of text[n]. */
static bool cache_policy_read_one(const char *text, size_t n, struct cache_policy *out)
{
    const char *is = memchr(text, '=', n);
    size_t n_name = is ? (size_t)(is - text) : 0, n_what = is ? n - n_name - 1 : 0;
    char what[16];
    if (!n_name || n_name >= sizeof out->row[0].ds || !n_what || n_what >= sizeof what ||
        out->n == CACHE_POLICY_MAX)
        return false;
    memcpy(what, is + 1, n_what);
    what[n_what] = '\0';
    memcpy(out->row[out->n].ds, text, n_name);
    out->row[out->n].ds[n_name] = '\0';
    if (!strcmp(what, "private"))
        out->row[out->n].kind = CACHE_POLICY_PRIVATE;
    else if (!strcmp(what, "no-store"))
        out->row[out->n].kind = CACHE_POLICY_NO_STORE;
    else if (what[strspn(what, "0123456789")] == '\0' && n_what < 9 &&
             atoi(what) <= CACHE_POLICY_SECONDS_MAX)
        snprintf(out->row[out->n].moving, sizeof out->row[0].moving,
                 "public, max-age=%d, stale-while-revalidate=600, stale-if-error=86400",
                 atoi(what));
    else if (strcmp(what, "public") != 0)
        return false;
    out->n++;
    return true;
}

enum err_code cache_policy_read(const char *list, struct cache_policy *out, struct err *e)
{
    memset(out, 0, sizeof *out);
    for (const char *p = list ? list : ""; *p;) {
        size_t n = strcspn(p, ",");
        if (!cache_policy_read_one(p, n, out))
            return err_set(e, ERR_ARG,
                           "--cache-policy %.60s: NAME=public, =private, =no-store or =SECONDS (at "
                           "most %d), by commas, * for every other name, at most %d",
                           p, CACHE_POLICY_SECONDS_MAX, CACHE_POLICY_MAX);
        p += n + (p[n] == ',');
    }
    return ERR_OK;
}

const char *cache_policy_of(const struct cache_policy *p, const char *ds, bool shared,
                            const char *usual)
{
    size_t at = p->n;
    for (size_t i = p->n; i > 0; i--)
        if (!strcmp(p->row[i - 1].ds, ds) || (at == p->n && !strcmp(p->row[i - 1].ds, "*")))
            at = i - 1;
    enum cache_policy_kind kind = at < p->n ? p->row[at].kind : CACHE_POLICY_PUBLIC;
    bool immutable = usual && strstr(usual, "immutable");
    if (!usual || strncmp(usual, "public", 6) != 0)
        return usual;
    if (kind == CACHE_POLICY_NO_STORE)
        return "private, no-store";
    if (kind == CACHE_POLICY_PRIVATE || !shared)
        return immutable ? "private, max-age=31536000, immutable" : "private, max-age=60";
    return !immutable && at < p->n && p->row[at].moving[0] ? p->row[at].moving : usual;
}
