/* citysplat points: the surface as coloured points.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/base/cli.h"
#include "cli/maps/maps.h"
#include "survey/surface_points.h"

struct points_options {
    struct maps_options maps;
    struct geoid_options heights;
    struct ground_options bare;
#define OPT OPTIONS_MEMBER
#include "cli/maps/ortho.def"
#define OPT OPTIONS_MEMBER
#include "cli/maps/points.def"
};

static const struct options_def points_defs[] = {
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW_IN(struct points_options, maps, __VA_ARGS__)
#include "cli/maps/maps.def"
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW_IN(struct points_options, heights, __VA_ARGS__)
#include "cli/maps/geoid.def"
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW_IN(struct points_options, bare, __VA_ARGS__)
#include "cli/maps/ground.def"
#define OPT(...) OPTIONS_ROW(struct points_options, __VA_ARGS__)
#include "cli/maps/ortho.def"
#define OPT(...) OPTIONS_ROW(struct points_options, __VA_ARGS__)
#include "cli/maps/points.def"
};

static const struct options_spec points_spec = {
    .command = "points",
    .usage = "citysplat points CITY.tiles -o FILE.las [options]",
    .about =
        "Writes the surface of a tile store, seen from straight above, as coloured points in "
        "LAS 1.4. There is one point for every pixel of an orthophoto with this --gsd-m, and with "
        "--walls more on walls. With "
        "--ground points have classes. Memory does not grow with the city, but with --ground by 13 "
        "bytes for every square metre.",
    .example = "citysplat points city.tiles -o city.las --gsd-m 0.25 --epsg 25832",
    .defs = points_defs,
    .n_defs = sizeof points_defs / sizeof *points_defs,
    .min_args = 1,
    .max_args = 1};

enum err_code cli_points(int argc, char **argv, struct err *e)
{
    struct points_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    enum err_code rc = options_parse(&points_spec, argc, argv, &o, &args, &arena, e);
    if (!rc && !args.done)
        rc = maps_write(args.arg[0], &o.maps,
                        &(struct maps_command){.kind = GEOTIFF_COLOR,
                                               .appearance = o.appearance,
                                               .heights = &o.heights,
                                               .bare = &o.bare,
                                               .walls = o.walls,
                                               .counts = "points",
                                               .ends = maps_points,
                                               .write = surface_points_write},
                        e);
    arena_free(&arena);
    return rc;
}
