/* See permissions.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/access/permissions.h"

#include <time.h>

enum auth_answer permissions_check(const struct request *r, const struct target *t,
                                   enum auth_need need, const char *ds)
{
    if (!r->auth)
        return AUTH_OK;
    struct auth_request a = {.authorization = r->authorization,
                             .cookie = r->cookie,
                             .seal = r->seal,
                             .n_seal = r->n_seal,
                             .path = "",
                             .query = ""};
    if (t) {
        const size_t n = t->path_size + (r->target_size > t->path_size); /* with its '?' */
        a.path = r->target;
        a.n_path = t->path_size;
        a.query = r->target + n;
        a.n_query = r->target_size - n;
        a.names_others = route_names_others(t->route);
    }
    return auth_check(r->auth, need, ds, &a, (int64_t)time(NULL));
}

bool permissions_is_public(const struct request *r, const char *ds)
{
    return !r->auth || auth_is_public(r->auth, ds);
}
