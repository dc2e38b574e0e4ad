/* citysplat contour: contour lines of the surface.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <inttypes.h>
#include <stdio.h>

#include "cli/base/cli.h"
#include "cli/maps/maps.h"
#include "survey/contour.h"

struct contour_options {
    struct maps_options maps;
    struct geoid_options heights;
#define OPT OPTIONS_MEMBER
#include "cli/maps/contour.def"
};

static const struct options_def contour_defs[] = {
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW_IN(struct contour_options, maps, __VA_ARGS__)
#include "cli/maps/maps.def"
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW(struct contour_options, __VA_ARGS__)
#include "cli/maps/contour.def"
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW_IN(struct contour_options, heights, __VA_ARGS__)
#include "cli/maps/geoid.def"
};

static const struct options_spec contour_spec = {
    .command = "contour",
    .usage = "citysplat contour CITY.tiles -o FILE.gpkg [options]",
    .about =
        "Writes contour lines of the surface of a tile store, seen from straight above. The "
        "file is GeoJSON in longitude and latitude (.geojson) or a GeoPackage in the projection "
        "(.gpkg). Memory does not grow with the city.",
    .example = "citysplat contour city.tiles -o lines.gpkg --interval-m 0.5 --least-m 5\n"
               "citysplat contour city.tiles -o lines.geojson --geoid egm96",
    .defs = contour_defs,
    .n_defs = sizeof contour_defs / sizeof *contour_defs,
    .min_args = 1,
    .max_args = 1};

enum err_code cli_contour(int argc, char **argv, struct err *e)
{
    struct contour_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    struct maps m = {0};
    enum err_code rc = options_parse(&contour_spec, argc, argv, &o, &args, &arena, e);
    bool run = !rc && !args.done;
    if (run)
        rc = maps_open(args.arg[0], &o.maps, maps_vector, &o.heights, NULL, &m, e);
    struct contour_report r = {0};
    m.request.kind = GEOTIFF_HEIGHT;
    const struct contour_request request = {m.request, o.interval_m, o.least_m};
    if (run && !rc)
        rc = contour_write(m.nadir, &request, o.maps.output, &r, e);
    if (run && !rc) {
        maps_print(o.maps.output, &r.map);
        maps_print_heights(&m, &r.map);
        printf("; %" PRIu64 " lines of %" PRIu64 " points, %" PRIu64 " shorter ones left out\n",
               r.lines, r.points, r.n_short);
    }
    maps_close(&m);
    arena_free(&arena);
    return rc;
}
