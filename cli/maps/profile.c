/* citysplat profile: heights of the surface along a line, as JSON.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/base/cli.h"
#include "cli/maps/ask.h"

struct profile_options {
#define OPT OPTIONS_MEMBER
#include "cli/maps/profile.def"
    struct ask_options ask;
};

static const struct options_def profile_defs[] = {
#define OPT(...) OPTIONS_ROW(struct profile_options, __VA_ARGS__)
#include "cli/maps/profile.def"
#define OPT(...) OPTIONS_ROW_IN(struct profile_options, ask, __VA_ARGS__)
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#include "cli/maps/ask.def"
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW_IN(struct profile_options, ask, __VA_ARGS__)
#include "cli/maps/geoid.def"
};

static const struct options_spec profile_spec = {
    .command = "profile",
    .usage = "citysplat profile CITY.tiles LON,LAT LON,LAT [LON,LAT ..., at most 15] [options]",
    .about = "Samples the surface of a tile store along a line of places. Prints one JSON "
             "object: distance, place and height of every sample, lengths in plan and along the "
             "surface, climb and fall.",
    .example = "citysplat profile city.tiles 8.6821,50.1109 8.6860,50.1131 --step-m 1",
    .defs = profile_defs,
    .n_defs = sizeof profile_defs / sizeof *profile_defs,
    .min_args = 3,
    .max_args = 1 + ASK_PLACES_MAX};

enum err_code cli_profile(int argc, char **argv, struct err *e)
{
    struct profile_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    struct query q = {.kind = QUERY_PROFILE};
    enum err_code rc = options_parse(&profile_spec, argc, argv, &o, &args, &arena, e);
    q.step_m = o.step_m;
    if (!rc && !args.done)
        rc = ask_print(&args, &o.ask, &q, e);
    arena_free(&arena);
    return rc;
}
