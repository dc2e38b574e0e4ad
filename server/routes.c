/* The words that rows of routes.def use, and the table.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/routes.h"

#include "server/answer.h"

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
enum { /* queries */
       BBOX = QUERY_BBOX,
       TILES = QUERY_TILES,
       TILE = QUERY_TILES | QUERY_PART,
       SEED_TILES = QUERY_SEED | QUERY_TILES,
       PICTURE = QUERY_VIEW | QUERY_APPEARANCE,
       MAP_APPEARANCE = QUERY_MAP | QUERY_APPEARANCE,
       TERRAIN = QUERY_TERRAIN,
       APPEARANCE = QUERY_APPEARANCE,
       SEARCH = QUERY_SEARCH,
       PLACE = QUERY_PLACE,
       MOTION = QUERY_MOTION,
};
#define JSON(schema) "200 application/json " schema ","
#define BYTES(media) "200 " media " Bytes,"
#define GET(f, gives, about) {METHOD_GET, f, NULL, gives, about, false},
#define STREAM(f, gives, about) {METHOD_GET, f, NULL, gives, about, true},
#define POST(f, takes, gives, about) {METHOD_POST, f, takes, gives, about, false},
#define PUT(f, takes, gives, about) {METHOD_PUT, f, takes, gives, about, false},
#define DELETE(f, gives, about) {METHOD_DELETE, f, NULL, gives, about, false},

const struct route ROUTES[] = {
#define ROUTE(name, path, scope, cache, rate, query, on)                                           \
    {#name, path, ROUTES_##scope, CACHE_##cache, RATE_##rate, query, {on}},
#include "server/routes.def"
#undef ROUTE
};
const size_t ROUTES_COUNT = sizeof ROUTES / sizeof *ROUTES;
