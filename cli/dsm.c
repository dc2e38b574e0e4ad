/* citysplat dsm: heights of the surface, as a map.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/cli.h"
#include "cli/maps.h"

struct dsm_options {
#define OPT(type, key, def, lo, hi, unit, help) OPTIONS_C_##type key;
#include "cli/dsm.def"
#undef OPT
};

static const struct options_def defs[] = {
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(type, key, def, lo, hi, unit, help)                                                    \
    OPTIONS_ROW(struct dsm_options, type, key, def, lo, hi, unit, help)
#include "cli/dsm.def"
#undef OPT
};

static const struct options_spec spec = {
    .command = "dsm",
    .usage = "citysplat dsm CITY.tiles -o FILE.tif [options]",
    .about = "Writes heights of the surface of a tile store, seen from straight above, as a Cloud "
             "Optimized GeoTIFF: float32 metres above the WGS 84 ellipsoid, -9999 where there is "
             "none. Memory does not grow with the city.",
    .example = "citysplat dsm city.tiles -o dsm.tif --gsd-m 0.25",
    .defs = defs,
    .n_defs = sizeof defs / sizeof *defs,
    .min_args = 1,
    .max_args = 1};

enum err_code cli_dsm(int argc, char **argv, struct err *e)
{
    struct dsm_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    enum err_code rc = options_parse(&spec, argc, argv, &o, &args, &arena, e);
    if (!rc && !args.done) {
        const struct maps_options m = {.store = args.arg[0],
                                       .output = o.output,
                                       .bbox = o.bbox,
                                       .ceiling = o.ceiling_m,
                                       .device = o.device,
                                       .epsg = (int)o.epsg,
                                       .gsd_m = o.gsd_m};
        rc = maps_make(GEOTIFF_HEIGHT, &m, e);
    }
    arena_free(&arena);
    return rc;
}
