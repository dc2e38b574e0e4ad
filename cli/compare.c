/* citysplat compare: what changed between two tile stores, as a map of heights and figures in JSON.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>

#include <jansson.h>

#include "cli/cli.h"
#include "cli/maps.h"
#include "survey/change.h"

struct compare_options {
#define OPT(type, key, def, lo, hi, unit, help) OPTIONS_C_##type key;
#include "cli/compare.def"
#undef OPT
};

static const struct options_def defs[] = {
#define OPT(type, key, def, lo, hi, unit, help)                                                    \
    OPTIONS_ROW(struct compare_options, type, key, def, lo, hi, unit, help)
#include "cli/compare.def"
#undef OPT
};

static const struct options_spec spec = {
    .command = "compare",
    .usage = "citysplat compare EARLIER.tiles LATER.tiles -o CHANGE.tif [options]",
    .about =
        "Draws two tile stores of one place from straight above and writes the heights of the "
        "later minus those of the earlier as a Cloud Optimized GeoTIFF. Prints one JSON object: "
        "volumes gained and lost, how colours differ, and how far the one lies from the other "
        "as a whole.",
    .example = "citysplat compare may.tiles june.tiles -o change.tif --gsd-m 0.25",
    .defs = defs,
    .n_defs = sizeof defs / sizeof *defs,
    .min_args = 2,
    .max_args = 2};

static enum err_code compare_print(const char *output, const struct change_report *r, struct err *e)
{
    json_t *o =
        json_pack("{s:s, s:s, s:i, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:{s:f, s:f, s:f}}",
                  "map", output, "units", "m", "epsg", r->grid.epsg, "pixel_m", r->grid.pixel_m,
                  "compared_area_m2", (double)r->pixels * r->pixel_m2, "mean_m", r->mean_m,
                  "median_m", r->median_m, "spread_m", r->spread_m, "changed_share",
                  r->changed_share, "gained_m3", r->gained_m3, "lost_m3", r->lost_m3, "color_rms",
                  r->color, "shift_m", "east", r->east_m, "north", r->north_m, "up", r->up_m);
    if (!o)
        return err_set(e, ERR_MEM, "compare: out of memory");
    json_dumpf(o, stdout, JSON_INDENT(2) | JSON_REAL_PRECISION(6));
    printf("\n");
    json_decref(o);
    return ERR_OK;
}

enum err_code cli_compare(int argc, char **argv, struct err *e)
{
    struct compare_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    struct nadir *n[2] = {NULL};
    struct change_report report;
    double bbox[4];
    enum err_code rc = options_parse(&spec, argc, argv, &o, &args, &arena, e);
    bool run = !rc && !args.done;
    if (run && !o.output)
        rc = err_set(e, ERR_ARG, "-o is missing: where to write");
    if (run && !rc && o.bbox)
        rc = maps_bbox(o.bbox, bbox, e);
    const struct nadir_options no = {.device = o.device, .ceiling_m = (double)NAN};
    for (size_t k = 0; run && !rc && k < 2; k++)
        rc = nadir_open(args.arg[k], &no, &n[k], e);
    const struct change_request request = {.epsg = (int)o.epsg,
                                           .gsd_m = o.gsd_m,
                                           .bbox_deg = o.bbox ? bbox : NULL,
                                           .least_m = o.least_m};
    if (run && !rc) {
        signals_catch();
        rc = change_write(n[0], n[1], &request, o.output, &report, e);
    }
    if (run && !rc)
        rc = compare_print(o.output, &report, e);
    nadir_close(&n[0]);
    nadir_close(&n[1]);
    arena_free(&arena);
    return rc;
}
