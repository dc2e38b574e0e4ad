/* citysplat points: the surface as coloured points.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <inttypes.h>
#include <stdio.h>

#include "cli/cli.h"
#include "cli/maps.h"
#include "survey/surface_points.h"

struct points_options {
    struct maps_options maps;
    struct geoid_options heights;
};

static const struct options_def defs[] = {
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(type, key, def, lo, hi, unit, help)                                                    \
    OPTIONS_ROW_IN(struct points_options, maps, type, key, def, lo, hi, unit, help)
#include "cli/maps.def"
#undef OPT
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(type, key, def, lo, hi, unit, help)                                                    \
    OPTIONS_ROW_IN(struct points_options, heights, type, key, def, lo, hi, unit, help)
#include "cli/geoid.def"
#undef OPT
};

static const struct options_spec spec = {
    .command = "points",
    .usage = "citysplat points CITY.tiles -o FILE.las [options]",
    .about =
        "Writes the surface of a tile store, seen from straight above, as coloured points: LAS "
        "1.4, one point for every pixel that an orthophoto of this --gsd-m has. Memory does "
        "not grow with the city.",
    .example = "citysplat points city.tiles -o city.las --gsd-m 0.25 --epsg 25832",
    .defs = defs,
    .n_defs = sizeof defs / sizeof *defs,
    .min_args = 1,
    .max_args = 1};

enum err_code cli_points(int argc, char **argv, struct err *e)
{
    struct points_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    struct maps m = {0};
    enum err_code rc = options_parse(&spec, argc, argv, &o, &args, &arena, e);
    bool run = !rc && !args.done;
    if (run)
        rc = maps_open(args.arg[0], &o.maps, &o.heights, NULL, &m, e);
    struct map_report r = {0};
    m.request.kind = GEOTIFF_COLOR;
    if (run && !rc)
        rc = surface_points_write(m.nadir, &m.request, o.maps.output, &r, e);
    if (run && !rc) {
        maps_print(o.maps.output, &r);
        maps_print_heights(&m, &r);
        printf("; %" PRIu64 " points\n", r.pixels_held);
    }
    maps_close(&m);
    arena_free(&arena);
    return rc;
}
