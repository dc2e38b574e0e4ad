/* citysplat height: how high the surface is at places given by longitude and latitude, as JSON.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include <jansson.h>

#include "cli/cli.h"
#include "cli/maps.h"
#include "lod/probe.h"

enum { HEIGHT_PLACES_MAX = 15 };

struct height_options {
#define OPT(type, key, def, lo, hi, unit, help) OPTIONS_C_##type key;
#include "cli/height.def"
#undef OPT
};

static const struct options_def defs[] = {
#define OPT(type, key, def, lo, hi, unit, help)                                                    \
    OPTIONS_ROW(struct height_options, type, key, def, lo, hi, unit, help)
#include "cli/height.def"
#undef OPT
};

static const struct options_spec spec = {
    .command = "height",
    .usage = "citysplat height CITY.tiles LON,LAT [LON,LAT ...] [options]",
    .about = "Tells how high the surface of a tile store is at places, seen from straight above: "
             "one JSON object, heights in metres above the WGS 84 ellipsoid, null where there is "
             "no surface.",
    .example = "citysplat height city.tiles 8.6821,50.1109 8.6830,50.1112",
    .defs = defs,
    .n_defs = sizeof defs / sizeof *defs,
    .min_args = 2,
    .max_args = 1 + HEIGHT_PLACES_MAX};

static enum err_code height_place(const char *text, double out[2], struct err *e)
{
    char *end;
    out[0] = strtod(text, &end);
    const char *lat = end + 1;
    if (end == text || *end != ',')
        return err_set(e, ERR_ARG, "'%s': LON,LAT in degrees is expected, e.g. 8.6821,50.1109",
                       text);
    out[1] = strtod(lat, &end);
    if (end == lat || *end || !(fabs(out[0]) <= 180) || !(fabs(out[1]) <= 90))
        return err_set(e, ERR_ARG, "'%s': LON,LAT in degrees is expected, e.g. 8.6821,50.1109",
                       text);
    return ERR_OK;
}

static json_t *height_json(const double place[2], const struct probe *p)
{
    char tile[48];
    snprintf(tile, sizeof tile, "%u/%u/%u", p->tile.z, p->tile.x, p->tile.y);
    json_t *o =
        json_pack("{s:f, s:f, s:b, s:o, s:o, s:o}", "lon", place[0], "lat", place[1], "surveyed",
                  p->surveyed, "height_m", jsonc_real(p->height_m), "height_min_m",
                  jsonc_real(p->height_min_m), "height_max_m", jsonc_real(p->height_max_m));
    if (o && p->surveyed) {
        json_object_set_new(o, "tile", json_string(tile));
        json_object_set_new(o, "level", json_integer(p->level));
    }
    if (o && p->found)
        json_object_set_new(o, "rgb",
                            json_pack("[i,i,i]", (int)lroundf(p->rgb[0] * 255),
                                      (int)lroundf(p->rgb[1] * 255),
                                      (int)lroundf(p->rgb[2] * 255)));
    return o;
}

static enum err_code height_run(const struct options_args *args, const struct height_options *o,
                                json_t *places, struct err *e)
{
    struct nadir_options no = {.device = o->device};
    struct nadir *n = NULL;
    double at[2];
    enum err_code rc = maps_number("--ceiling-m", o->ceiling_m, &no.ceiling_m, e);
    for (size_t i = 1; !rc && i < args->n; i++) /* before the store is opened */
        rc = height_place(args->arg[i], at, e);
    if (!rc)
        rc = nadir_open(args->arg[0], &no, &n, e);
    for (size_t i = 1; !rc && i < args->n; i++) {
        struct probe p;
        rc = height_place(args->arg[i], at, e);
        if (!rc)
            rc = probe_at(n, at[0], at[1], o->gsd_m, &p, e);
        if (!rc && json_array_append_new(places, height_json(at, &p)))
            rc = err_set(e, ERR_MEM, "height: out of memory");
    }
    nadir_close(&n);
    return rc;
}

enum err_code cli_height(int argc, char **argv, struct err *e)
{
    struct height_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    json_t *places = json_array(), *all = NULL;
    enum err_code rc = places ? options_parse(&spec, argc, argv, &o, &args, &arena, e)
                              : err_set(e, ERR_MEM, "height: out of memory");
    if (rc || args.done)
        goto out;
    rc = height_run(&args, &o, places, e);
    if (rc)
        goto out;
    all = json_pack("{s:s, s:s, s:O}", "vertical_datum", "WGS 84 ellipsoid", "units", "m", "places",
                    places);
    if (!all) {
        rc = err_set(e, ERR_MEM, "height: out of memory");
        goto out;
    }
    json_dumpf(all, stdout, JSON_INDENT(2) | JSON_REAL_PRECISION(12));
    printf("\n");
out:
    json_decref(all);
    json_decref(places);
    arena_free(&arena);
    return rc;
}
