/* The words that rows of routes.def use, and the table.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answers/routes.h"

#include "server/answers/answer.h"
#include "server/route/target.h"

enum { /* scopes */
       ROUTES_PUBLIC = SCOPE_PUBLIC,
       ROUTES_FILE = SCOPE_PUBLIC | SCOPE_FILE,
       ROUTES_BOTH = SCOPE_PUBLIC | SCOPE_OPERATORS,
       ROUTES_METRICS = SCOPE_PUBLIC | SCOPE_OPERATORS | SCOPE_MOVES,
       ROUTES_OPERATORS = SCOPE_OPERATORS,
       ROUTES_DATASET = SCOPE_PUBLIC | SCOPE_DATASET,
       ROUTES_RENDER = SCOPE_PUBLIC | SCOPE_DATASET | SCOPE_RENDER,
       ROUTES_KEPT = SCOPE_PUBLIC | SCOPE_OPERATORS | SCOPE_DATASET | SCOPE_STATE,
       ROUTES_SIGNED = SCOPE_PUBLIC | SCOPE_SIGNED,
};
#define JSON(schema) "200 application/json " schema ","
#define BYTES(media) "200 " media " Bytes,"
#define GET(f, gives, about) {METHOD_GET, f, NULL, gives, about, false},
#define STREAM(f, gives, about) {METHOD_GET, f, NULL, gives, about, true},
#define POST(f, takes, gives, about) {METHOD_POST, f, takes, gives, about, false},
#define PUT(f, takes, gives, about) {METHOD_PUT, f, takes, gives, about, false},
#define DELETE(f, gives, about) {METHOD_DELETE, f, NULL, gives, about, false},

/* Of a sequence of these, first the bits of the groups and then their places. */
#define MAY(group) | 1u << TARGET_##group
#define TAKES(route, group) MAY(group)
enum {
#define ROUTE(name, path, scope, cache, rate, takes, on) ROUTES_TAKES_##name = 0 takes,
#include "server/route/routes.def"
#undef ROUTE
};
#undef MAY
#undef TAKES
#define MAY(group)
#define TAKES(route, group) [TARGET_##group] = offsetof(struct route##_target, group),
const struct route ROUTES[] = {
#define ROUTE(name, path, scope, cache, rate, takes, on)                                           \
    {#name,                                                                                        \
     path,                                                                                         \
     ROUTES_##scope,                                                                               \
     CACHE_##cache,                                                                                \
     RATE_##rate,                                                                                  \
     ROUTES_TAKES_##name,                                                                          \
     sizeof(struct name##_target),                                                                 \
     {[TARGET_names] = 0, takes},                                                                  \
     {on}},
#include "server/route/routes.def"
#undef ROUTE
};
const size_t ROUTES_COUNT = sizeof ROUTES / sizeof *ROUTES;
