/* citysplat height: heights of the surface at given longitudes and latitudes, as JSON.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/base/cli.h"
#include "cli/maps/ask.h"

struct height_options {
#define OPT OPTIONS_MEMBER
#include "cli/maps/height.def"
    struct ask_options ask;
};

static const struct options_def height_defs[] = {
#define OPT(...) OPTIONS_ROW(struct height_options, __VA_ARGS__)
#include "cli/maps/height.def"
#define OPT(...) OPTIONS_ROW_IN(struct height_options, ask, __VA_ARGS__)
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#include "cli/maps/ask.def"
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW_IN(struct height_options, ask, __VA_ARGS__)
#include "cli/maps/geoid.def"
};

static const struct options_spec height_spec = {
    .command = "height",
    .usage = "citysplat height CITY.tiles LON,LAT [LON,LAT ..., at most 15] [options]",
    .about = "Prints the height of the surface of a tile store at places, seen from straight "
             "above, as one JSON object. Heights are in metres as the store counts them, which "
             "vertical_datum names, and null where there is no surface.",
    .example = "citysplat height city.tiles 8.6821,50.1109 8.6830,50.1112",
    .defs = height_defs,
    .n_defs = sizeof height_defs / sizeof *height_defs,
    .min_args = 2,
    .max_args = 1 + ASK_PLACES_MAX};

enum err_code cli_height(int argc, char **argv, struct err *e)
{
    struct height_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    struct query q = {.kind = QUERY_HEIGHT};
    enum err_code rc = options_parse(&height_spec, argc, argv, &o, &args, &arena, e);
    q.gsd_m = o.gsd_m;
    if (!rc && !args.done)
        rc = ask_print(&args, &o.ask, &q, e);
    arena_free(&arena);
    return rc;
}
