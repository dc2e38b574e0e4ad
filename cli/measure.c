/* citysplat measure: lengths between places, area and volume within a polygon, as JSON.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include <jansson.h>

#include "cli/ask.h"
#include "cli/cli.h"
#include "cli/maps.h"

struct measure_options {
#define OPT(type, key, def, lo, hi, unit, help) OPTIONS_C_##type key;
#include "cli/measure.def"
#undef OPT
};

static const struct options_def defs[] = {
#define OPT(type, key, def, lo, hi, unit, help)                                                    \
    OPTIONS_ROW(struct measure_options, type, key, def, lo, hi, unit, help)
#include "cli/measure.def"
#undef OPT
};

static const struct options_spec spec = {
    .command = "measure",
    .usage = "citysplat measure CITY.tiles [LON,LAT LON,LAT ...] [options]",
    .about = "Measures on the surface of a tile store. Of two or more places: lengths in the plan "
             "and in space. With --polygon: area in the plan and of the surface, volume above and "
             "below a base.",
    .example = "citysplat measure city.tiles 8.6821,50.1109 8.6860,50.1131\n"
               "citysplat measure city.tiles --polygon heap.geojson",
    .defs = defs,
    .n_defs = sizeof defs / sizeof *defs,
    .min_args = 1,
    .max_args = 1 + 15};

/* The question of the server's /measure, with the polygon of a file. */
static enum err_code measure_polygon_read(const struct measure_options *o, struct query *q,
                                          struct err *e)
{
    json_t *root = NULL, *ask = NULL;
    double base_m;
    enum err_code rc = maps_number("--base-m", o->base_m, &base_m, e);
    if (!rc)
        rc = jsonc_read(o->polygon, &root, e);
    json_t *shape = json_object_get(root, "geometry");
    shape = shape ? shape : root;
    const char *type = json_string_value(json_object_get(shape, "type"));
    json_t *rings = json_object_get(shape, "coordinates");
    if (!rc && (!type || strcmp(type, "Polygon") || json_array_size(rings) != 1))
        rc = err_set(e, ERR_ARG,
                     "%s: a GeoJSON Polygon, or a Feature with one, of one ring is expected, in "
                     "longitude and latitude",
                     o->polygon);
    if (!rc)
        ask = json_pack("{s:O}", "polygon", json_array_get(rings, 0));
    if (ask && isfinite(base_m))
        json_object_set_new(ask, "base", json_real(base_m));
    if (!rc && query_read(QUERY_MEASURE, ask, NULL, q, e)) {
        err_add(e, "%s", o->polygon);
        rc = ERR_ARG;
    }
    json_decref(ask);
    json_decref(root);
    return rc;
}

enum err_code cli_measure(int argc, char **argv, struct err *e)
{
    struct measure_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    struct query q = {.kind = QUERY_MEASURE};
    enum err_code rc = options_parse(&spec, argc, argv, &o, &args, &arena, e);
    bool run = !rc && !args.done;
    if (run && (o.polygon ? args.n > 1 : args.n < 3))
        rc = err_set(e, ERR_ARG, "measure: give two or more places LON,LAT, or --polygon FILE");
    for (size_t i = 1; run && !rc && i < args.n; i++)
        rc = ask_place(args.arg[i], q.place[q.n++], e);
    if (run && !rc && o.polygon)
        rc = measure_polygon_read(&o, &q, e);
    q.gsd_m = o.gsd_m;
    const struct ask_options ask = {run ? args.arg[0] : NULL, o.ceiling_m, o.device, o.geoid,
                                    o.geoid_dir};
    if (run && !rc)
        rc = ask_print(&ask, &q, e);
    arena_free(&arena);
    return rc;
}
