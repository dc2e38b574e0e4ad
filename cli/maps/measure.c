/* citysplat measure: lengths between places, area and volume within a polygon, as JSON.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "cli/base/cli.h"
#include "cli/maps/ask.h"
#include "cli/maps/maps.h"
#include "codec/container/geojson.h"

struct measure_options {
#define OPT OPTIONS_MEMBER
#include "cli/maps/measure.def"
    struct ask_options ask;
};

static const struct options_def measure_defs[] = {
#define OPT(...) OPTIONS_ROW(struct measure_options, __VA_ARGS__)
#include "cli/maps/measure.def"
#define OPT(...) OPTIONS_ROW_IN(struct measure_options, ask, __VA_ARGS__)
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#include "cli/maps/ask.def"
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW_IN(struct measure_options, ask, __VA_ARGS__)
#include "cli/maps/geoid.def"
};

static const struct options_spec measure_spec = {
    .command = "measure",
    .usage = "citysplat measure CITY.tiles [LON,LAT LON,LAT ..., at most 15] [options]",
    .about = "Measures on the surface of a tile store. For two or more places it prints lengths "
             "in plan and in space. With --polygon it prints the area in plan and of the "
             "surface, and the volume above and below a base.",
    .example = "citysplat measure city.tiles 8.6821,50.1109 8.6860,50.1131\n"
               "citysplat measure city.tiles --polygon heap.geojson",
    .defs = measure_defs,
    .n_defs = sizeof measure_defs / sizeof *measure_defs,
    .min_args = 1,
    .max_args = 1 + ASK_PLACES_MAX};

/* The one polygon of the file. */
static enum err_code measure_polygon_read(const struct measure_options *o, struct query *q,
                                          struct err *e)
{
    struct geojson_area area = {0};
    enum err_code rc = options_number_of("--base-m", o->base_m, (double)NAN, &q->base_m, e);
    if (!rc)
        rc = geojson_read(o->polygon, &area, e);
    if (!rc && area.n_rings != 1)
        rc = err_set(e, ERR_ARG, "%s: %zu polygons of %zu rings: one of one ring is measured",
                     o->polygon, area.n_polygons, area.n_rings);
    if (!rc && area.n > QUERY_PLACES_MAX)
        rc = err_set(e, ERR_ARG, "%s: a polygon of %zu corners: at most %d", o->polygon, area.n,
                     QUERY_PLACES_MAX);
    q->ring = 1;
    for (size_t i = 0; !rc && i < area.n; i++)
        memcpy(q->place[q->n++], area.edges[i].from, sizeof q->place[0]);
    geojson_free(&area);
    return rc == ERR_DATA ? ERR_ARG : rc; /* the question's fault */
}

enum err_code cli_measure(int argc, char **argv, struct err *e)
{
    struct measure_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    struct query q = {.kind = QUERY_MEASURE};
    enum err_code rc = options_parse(&measure_spec, argc, argv, &o, &args, &arena, e);
    bool run = !rc && !args.done;
    if (run && (o.polygon ? args.n > 1 : args.n < 3))
        rc = err_set(e, ERR_ARG, "measure: give two or more places LON,LAT, or --polygon FILE");
    if (run && !rc && o.polygon)
        rc = measure_polygon_read(&o, &q, e);
    q.gsd_m = o.gsd_m;
    if (run && !rc)
        rc = ask_print(&args, &o.ask, &q, e);
    arena_free(&arena);
    return rc;
}
