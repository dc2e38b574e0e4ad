/* citysplat ortho: the city from straight above, as a map.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/base/cli.h"
#include "cli/maps/maps.h"

struct ortho_options {
    struct maps_options maps;
#define OPT OPTIONS_MEMBER
#include "cli/maps/ortho.def"
};

static const struct options_def ortho_defs[] = {
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW_IN(struct ortho_options, maps, __VA_ARGS__)
#include "cli/maps/maps.def"
#define OPT(...) OPTIONS_ROW(struct ortho_options, __VA_ARGS__)
#include "cli/maps/ortho.def"
};

static const struct options_spec ortho_spec = {
    .command = "ortho",
    .usage = "citysplat ortho CITY.tiles -o FILE.tif [options]",
    .about =
        "Draws a tile store from straight above, orthographically, as a Cloud Optimized GeoTIFF "
        "with red, green, blue and alpha. Alpha is 0 outside of the survey. Memory does not "
        "grow with the city.",
    .example = "citysplat ortho city.tiles -o ortho.tif --gsd-m 0.1\n"
               "citysplat ortho city.tiles -o ortho.tif --epsg 25832 --bbox 8.68,50.10,8.69,50.12",
    .defs = ortho_defs,
    .n_defs = sizeof ortho_defs / sizeof *ortho_defs,
    .min_args = 1,
    .max_args = 1};

enum err_code cli_ortho(int argc, char **argv, struct err *e)
{
    struct ortho_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    enum err_code rc = options_parse(&ortho_spec, argc, argv, &o, &args, &arena, e);
    if (!rc && !args.done)
        rc = maps_write(args.arg[0], &o.maps,
                        &(struct maps_command){
                            .kind = GEOTIFF_COLOR, .appearance = o.appearance, .write = map_write},
                        e);
    arena_free(&arena);
    return rc;
}
