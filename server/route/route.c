/* See route.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/route/route.h"

#include <string.h>

const struct route_method *route_on(const struct route *r, enum method method)
{
    const enum method asked = method == METHOD_HEAD ? METHOD_GET : method;
    for (size_t i = 0; i < ROUTE_METHODS && r->on[i].answer; i++)
        if (r->on[i].method == asked)
            return &r->on[i];
    return NULL;
}

const char *route_allow(const struct route *r, bool changes)
{
    static const char *const texts[] = {
        "OPTIONS",
        "GET, HEAD, OPTIONS",
        "POST, OPTIONS",
        "GET, HEAD, POST, OPTIONS",
        "PUT, DELETE, OPTIONS",
        "GET, HEAD, PUT, DELETE, OPTIONS",
        "POST, PUT, DELETE, OPTIONS",
        "GET, HEAD, POST, PUT, DELETE, OPTIONS",
    };
    return texts[(route_on(r, METHOD_GET) ? 1 : 0) + (route_on(r, METHOD_POST) ? 2 : 0) +
                 (changes && route_on(r, METHOD_PUT) ? 4 : 0)];
}

bool route_names_others(const struct route *r)
{
    const struct route_method *on = route_on(r, METHOD_GET);
    return on && !strstr(on->gives, " Bytes,");
}

bool route_redirects(const struct route *r)
{
    const struct route_method *on = route_on(r, METHOD_GET);
    return on && strstr(on->gives, "307,");
}

const char *route_path(const struct route *r)
{
    return r ? r->path : "unmatched";
}
