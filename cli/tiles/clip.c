/* citysplat clip: a part of a tile store, by polygons and heights -> a tile store.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/export/clip.h"

#include <math.h>
#include <stdio.h>

#include "cli/base/cli.h"
#include "cli/base/output.h"

struct clip_options {
#define OPT OPTIONS_MEMBER
#include "cli/tiles/clip.def"
};

static const struct options_def clip_defs[] = {
#define OPT(...) OPTIONS_ROW(struct clip_options, __VA_ARGS__)
#include "cli/tiles/clip.def"
};

static const struct options_spec clip_spec = {
    .command = "clip",
    .usage = "citysplat clip CITY.tiles -o PART.tiles [options]",
    .about = "Writes a part of a tile store, at every level: the Gaussians whose means lie within "
             "polygons, between heights, or both. Tiles that lie wholly inside are copied byte by "
             "byte. The result is a tile store for serve, export and the map commands.",
    .example = "citysplat clip city.tiles -o block.tiles --polygon block.geojson\n"
               "citysplat clip city.tiles -o roofless.tiles --high-m 118",
    .defs = clip_defs,
    .n_defs = sizeof clip_defs / sizeof *clip_defs,
    .min_args = 1,
    .max_args = 1};

static enum err_code clip_parse(const struct clip_options *o, struct clip *out, struct err *e)
{
    double low_m = 0, high_m = 0;
    if (!o->polygon && !o->low_m && !o->high_m)
        return err_set(e, ERR_ARG, "clip: give --polygon FILE, --low-m or --high-m");
    enum err_code rc = options_number_of("--low-m", o->low_m, -HUGE_VAL, &low_m, e);
    if (!rc)
        rc = options_number_of("--high-m", o->high_m, HUGE_VAL, &high_m, e);
    return rc ? rc : clip_open(o->polygon, low_m, high_m, out, e);
}

enum err_code cli_clip(int argc, char **argv, struct err *e)
{
    struct clip_options o = {0};
    struct options_args args;
    struct clip_report r;
    struct clip clip = {0};
    struct arena arena = {0};
    enum err_code rc = options_parse(&clip_spec, argc, argv, &o, &args, &arena, e);
    bool run = !rc && !args.done;
    if (run)
        rc = output_needed(o.output, o.overwrite, e);
    if (run && !rc)
        rc = output_apart(o.output, args.arg[0], e);
    if (run && !rc)
        rc = output_apart(o.output, o.polygon, e);
    if (run && !rc)
        rc = clip_parse(&o, &clip, e);
    if (run && !rc) {
        signals_catch();
        rc = clip_store(&clip, args.arg[0], o.name, o.output, &r, e);
    }
    if (run && !rc)
        printf(
            "%s: %zu tiles, %zu of them as they were, %zu Gaussians kept, %zu left out, revision "
            "%s\n",
            o.output, r.n_tiles, r.n_copied, r.n_kept, r.n_dropped, r.revision);
    clip_free(&clip);
    arena_free(&arena);
    return rc;
}
