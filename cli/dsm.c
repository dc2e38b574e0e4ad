/* citysplat dsm: heights of the surface, as a map.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/cli.h"
#include "cli/maps.h"

struct dsm_options {
    struct maps_options maps;
    struct geoid_options heights;
    struct ground_options bare;
};

static const struct options_def dsm_defs[] = {
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(type, tier, key, def, lo, hi, unit, help)                                              \
    OPTIONS_ROW_IN(struct dsm_options, maps, type, tier, key, def, lo, hi, unit, help)
#include "cli/maps.def"
#undef OPT
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(type, tier, key, def, lo, hi, unit, help)                                              \
    OPTIONS_ROW_IN(struct dsm_options, heights, type, tier, key, def, lo, hi, unit, help)
#include "cli/geoid.def"
#undef OPT
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(type, tier, key, def, lo, hi, unit, help)                                              \
    OPTIONS_ROW_IN(struct dsm_options, bare, type, tier, key, def, lo, hi, unit, help)
#include "cli/ground.def"
#undef OPT
};

static const struct options_spec dsm_spec = {
    .command = "dsm",
    .usage = "citysplat dsm CITY.tiles -o FILE.tif [options]",
    .about = "Writes heights of the surface of a tile store, seen from straight above, as a "
             "Cloud Optimized GeoTIFF. Heights are float32 metres above the WGS 84 ellipsoid, "
             "or above sea level with --geoid. Where there is no surface they are -9999. With "
             "--ground the heights are those of bare earth. Memory does not grow with the city, "
             "but with --ground by 13 bytes for every square metre.",
    .example = "citysplat dsm city.tiles -o dsm.tif --gsd-m 0.25\n"
               "citysplat dsm city.tiles -o dsm.tif --geoid egm2008-1\n"
               "citysplat dsm city.tiles -o dtm.tif --ground",
    .defs = dsm_defs,
    .n_defs = sizeof dsm_defs / sizeof *dsm_defs,
    .min_args = 1,
    .max_args = 1};

enum err_code cli_dsm(int argc, char **argv, struct err *e)
{
    struct dsm_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    enum err_code rc = options_parse(&dsm_spec, argc, argv, &o, &args, &arena, e);
    if (!rc && !args.done)
        rc = maps_write(
            args.arg[0], &o.maps,
            &(struct maps_command){
                .kind = GEOTIFF_HEIGHT, .heights = &o.heights, .bare = &o.bare, .write = map_write},
            e);
    arena_free(&arena);
    return rc;
}
