/* Options of `citysplat ingest`: the table of ingest.def as struct ingest_config.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/ingest/ingest.h"

static const struct options_def ingest_defs[] = {
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW(struct ingest_config, __VA_ARGS__)
#include "scene/ingest/ingest.def"
};

const struct options_spec *ingest_options(void)
{
    static const struct options_spec spec = {
        .command = "ingest",
        .usage = "citysplat ingest PHOTOS SPARSE -o SCENE [options]",
        .about = "Makes a scene in metres, east-north-up, from photographs with EXIF GPS and "
                 "their COLMAP model (a folder with cameras, images and points3D, .bin or "
                 ".txt). The scene has undistorted pictures, poses and points. Photographs "
                 "whose pose or GPS position cannot be right are dropped and named.",
        .example = "citysplat ingest photos photos/sparse/0 -o scene",
        .defs = ingest_defs,
        .n_defs = sizeof ingest_defs / sizeof *ingest_defs,
        .min_args = 2,
        .max_args = 2,
    };
    return &spec;
}
