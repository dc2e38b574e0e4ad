/* citysplat stereo: depth maps of photographs from their neighbours.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>

#include "cli/base/cli.h"
#include "codec/scene/scene.h"
#include "core/device/dev.h"
#include "core/pool.h"
#include "scene/stereo/depths.h"

struct stereo_options {
#define OPT OPTIONS_MEMBER
#include "cli/scene/stereo.def"
};

static const struct options_def stereo_defs[] = {
#define OPT(...) OPTIONS_ROW(struct stereo_options, __VA_ARGS__)
#include "cli/scene/stereo.def"
};

static enum err_code stereo_make(const struct stereo_options *o, const char *dir, struct err *e)
{
    const struct depths_config cfg = {.max_edge_px = (uint32_t)o->max_edge_px,
                                      .sure = DEPTHS_SURE,
                                      .edge = DEPTHS_EDGE,
                                      .test_split = o->test_split,
                                      .overwrite = o->overwrite};
    struct scene scene = {0};
    struct dev dev = {0};
    struct depths_result r;
    char path[FILE_PATH_MAX];
    enum err_code rc = scene_read(dir, &scene, e);
    if (!rc)
        rc = file_join(path, dir, "depth", e);
    const char *out = o->output ? o->output : path;
    pool_limit((size_t)o->threads);
    signals_catch();
    if (!rc)
        rc = dev_open(o->device, &dev, e);
    if (!rc) {
        rc = depths_make(&dev, &scene, &cfg, out, &r, e);
        dev_close(&dev);
    }
    if (!rc)
        printf(
            "%s: %zu maps of %zu photographs, %.1f %% of their pixels known, %zu points, %.1f s\n",
            out, r.maps, r.photographs, 100.0 * (double)r.known / (double)r.pixels, r.points,
            r.seconds);
    scene_free(&scene);
    return rc;
}

enum err_code cli_stereo(int argc, char **argv, struct err *e)
{
    const struct options_spec spec = {
        .command = "stereo",
        .usage = "citysplat stereo SCENE [options]",
        .about = "Computes the depth of every training photograph from its neighbours, by a sweep "
                 "of planes. Writes SCENE/depth/NAME.npy: inverse depth in 1/m, NaN where "
                 "neighbours do not agree. `citysplat train --depth-prior stereo` uses them.",
        .example = "citysplat stereo scene --max-edge-px 800",
        .defs = stereo_defs,
        .n_defs = sizeof stereo_defs / sizeof stereo_defs[0],
        .min_args = 1,
        .max_args = 1};
    struct stereo_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    enum err_code rc = options_parse(&spec, argc, argv, &o, &args, &arena, e);
    if (!rc && !args.done)
        rc = stereo_make(&o, args.arg[0], e);
    arena_free(&arena);
    return rc;
}
