/* citysplat dsm: heights of the surface, as a map.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>

#include "cli/base/cli.h"
#include "cli/maps/maps.h"
#include "core/base.h"
#include "core/geo/geo.h"
#include "survey/depth_heights.h"

struct dsm_options {
    struct maps_options maps;
    struct geoid_options heights;
    struct ground_options bare;
    struct {
#define OPT OPTIONS_MEMBER
#include "cli/maps/dsm.def"
    } own;
};

static const struct options_def dsm_defs[] = {
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW_IN(struct dsm_options, maps, __VA_ARGS__)
#include "cli/maps/maps.def"
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW_IN(struct dsm_options, heights, __VA_ARGS__)
#include "cli/maps/geoid.def"
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW_IN(struct dsm_options, bare, __VA_ARGS__)
#include "cli/maps/ground.def"
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW_IN(struct dsm_options, own, __VA_ARGS__)
#include "cli/maps/dsm.def"
};

static const struct options_spec dsm_spec = {
    .command = "dsm",
    .usage = "citysplat dsm CITY.tiles|SCENE -o FILE.tif [options]",
    .about = "Writes heights of the surface of a tile store, seen from straight above, as a "
             "Cloud Optimized GeoTIFF. Heights are float32 metres as the store counts them, "
             "or above sea level with --geoid. Where there is no surface they are -9999. With "
             "--ground the heights are those of bare earth. Memory does not grow with the city, "
             "but with --ground by 13 bytes for every square metre. Of a scene's folder it writes "
             "the heights that `citysplat stereo` knows, without training.",
    .example = "citysplat dsm city.tiles -o dsm.tif --gsd-m 0.25\n"
               "citysplat dsm city.tiles -o dsm.tif --geoid egm96\n"
               "citysplat dsm city.tiles -o dtm.tif --ground\n"
               "citysplat dsm scene -o quick.tif",
    .defs = dsm_defs,
    .n_defs = sizeof dsm_defs / sizeof *dsm_defs,
    .min_args = 1,
    .max_args = 1};

static bool dsm_is_scene(const char *path)
{
    char file[FILE_PATH_MAX];
    struct err ignored = {0};
    return !file_join(file, path, "scene.json", &ignored) && file_exists(file);
}

/* Heights of depths that are known without training. */
static enum err_code dsm_known(const char *scene, const struct dsm_options *o, struct err *e)
{
    struct depth_heights_request r = {
        .scene = scene, .depth = o->own.depths, .epsg = (int)o->maps.epsg, .gsd_m = o->maps.gsd_m};
    struct geoid *geoid = NULL;
    struct map_report report;
    double bbox[4];
    char words[100];
    signals_catch();
    if (o->bare.ground || o->maps.ceiling_m)
        return err_set(e, ERR_ARG,
                       "%s: --ground and --ceiling-m are for a tile store: train the scene, then "
                       "run `citysplat tile`",
                       o->bare.ground ? "--ground" : "--ceiling-m");
    enum err_code rc = maps_check_output(o->maps.output, maps_geotiff, o->maps.overwrite, e);
    if (!rc && o->maps.bbox) {
        rc = maps_bbox(o->maps.bbox, bbox, e);
        r.bbox_deg = bbox;
    }
    if (!rc && o->heights.geoid)
        rc = geoid_open(o->heights.geoid, &geoid, e);
    r.geoid = geoid;
    if (!rc)
        rc = depth_heights_write(&r, o->maps.output, &report, words, e);
    if (!rc) {
        maps_print(o->maps.output, &report);
        printf("; %s, %.2f to %.2f m; known depths, without training\n", words, report.height_min_m,
               report.height_max_m);
    }
    geoid_close(&geoid);
    return rc;
}

enum err_code cli_dsm(int argc, char **argv, struct err *e)
{
    struct dsm_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    enum err_code rc = options_parse(&dsm_spec, argc, argv, &o, &args, &arena, e);
    if (!rc && !args.done && dsm_is_scene(args.arg[0]))
        rc = dsm_known(args.arg[0], &o, e);
    else if (!rc && !args.done && o.own.depths)
        rc = err_set(e, ERR_ARG, "--depths: %s is not the folder of a scene", args.arg[0]);
    else if (!rc && !args.done)
        rc = maps_write(
            args.arg[0], &o.maps,
            &(struct maps_command){
                .kind = GEOTIFF_HEIGHT, .heights = &o.heights, .bare = &o.bare, .write = map_write},
            e);
    arena_free(&arena);
    return rc;
}
