/* citysplat compare: changes between two tile stores, as a map of heights and as numbers in JSON.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>

#include <jansson.h>

#include "cli/base/cli.h"
#include "cli/maps/maps.h"
#include "survey/change.h"

struct compare_options {
    struct maps_options maps;
#define OPT OPTIONS_MEMBER
#include "cli/maps/compare.def"
};

static const struct options_def compare_defs[] = {
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW_IN(struct compare_options, maps, __VA_ARGS__)
#include "cli/maps/maps.def"
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW(struct compare_options, __VA_ARGS__)
#include "cli/maps/compare.def"
};

static const struct options_spec compare_spec = {
    .command = "compare",
    .usage = "citysplat compare EARLIER.tiles LATER.tiles -o CHANGE.tif [options]",
    .about = "Draws two tile stores of one place from straight above. Writes the heights of the "
             "later store minus those of the earlier one as a Cloud Optimized GeoTIFF. Prints one "
             "JSON object: volumes gained and lost, difference of colours, and the shift of the "
             "later store as a whole. --align corrects that shift first.",
    .example = "citysplat compare may.tiles june.tiles -o change.tif --gsd-m 0.25 --align",
    .defs = compare_defs,
    .n_defs = sizeof compare_defs / sizeof *compare_defs,
    .min_args = 2,
    .max_args = 2};

/* Not known: null. */
static json_t *compare_pose(const struct change_pose *p)
{
    return json_pack("{s:o, s:o, s:o, s:o, s:o}", "east_m", jsonc_real(p->east_m), "north_m",
                     jsonc_real(p->north_m), "up_m", jsonc_real(p->up_m), "tilt_east_mm_per_m",
                     jsonc_real(1000 * p->tilt_east), "tilt_north_mm_per_m",
                     jsonc_real(1000 * p->tilt_north));
}

static enum err_code compare_print(const char *output, const struct change_report *r, struct err *e)
{
    const struct changed_report *c = &r->changed;
    json_t *o = json_pack(
        "{s:s, s:s, s:i, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:I, s:f, s:f, s:f, s:f, s:o, s:f, "
        "s:o, "
        "s:b}",
        "map", output, "units", "m", "epsg", r->grid.epsg, "pixel_m", r->grid.pixel_m,
        "compared_area_m2", (double)r->pixels * r->pixel_m2, "mean_m", r->mean_m, "median_m",
        r->median_m, "spread_m", r->spread_m, "differs_share", r->differs_share, "changed_share",
        (double)c->pixels / (double)r->pixels, "regions", (json_int_t)c->regions, "gained_m3",
        c->gained_m3, "gained_95_m3", c->gained_95_m3, "lost_m3", c->lost_m3, "lost_95_m3",
        c->lost_95_m3, "correlation_m", jsonc_real(c->correlation_m), "color_rms", r->color,
        "shift", compare_pose(&r->pose), "aligned", r->aligned);
    if (o && r->aligned) {
        json_object_set_new(o, "rounds", json_integer(r->rounds));
        json_object_set_new(o, "shift_left", compare_pose(&r->left));
    }
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
    struct maps m[2] = {{0}, {0}};
    struct change_report report = {0};
    enum err_code rc = options_parse(&compare_spec, argc, argv, &o, &args, &arena, e);
    bool run = !rc && !args.done;
    if (run && o.polygons)
        rc = maps_check_output(o.polygons, maps_vector, o.maps.overwrite, e);
    for (size_t k = 0; run && !rc && k < 2; k++)
        rc = maps_open(args.arg[k], &o.maps, maps_geotiff, NULL, NULL, &m[k], e);
    const struct map_request *r = &m[0].request;
    const struct change_request request = {.epsg = r->epsg,
                                           .gsd_m = r->gsd_m,
                                           .bbox_deg = r->bbox_deg,
                                           .least_m = o.least_m,
                                           .polygons = o.polygons,
                                           .align = o.align};
    if (run && !rc)
        rc = change_write(m[0].nadir, m[1].nadir, &request, o.maps.output, &report, e);
    if (run && !rc)
        rc = compare_print(o.maps.output, &report, e);
    maps_close(&m[0]);
    maps_close(&m[1]);
    arena_free(&arena);
    return rc;
}
