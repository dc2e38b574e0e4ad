/* Options of the procedural city: the tables of synth.def and synth_vary.def as struct
 * synth_config.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/synth/synth.h"

static const struct options_def synth_defs[] = {
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW(struct synth_config, __VA_ARGS__)
#include "scene/synth/synth.def"
#define OPT(...) OPTIONS_ROW(struct synth_config, __VA_ARGS__)
#include "scene/synth/synth_vary.def"
};

const struct options_spec *synth_options(void)
{
    static const struct options_spec spec = {
        .command = "synth",
        .usage = "citysplat-lab synth -o DIR [options]",
        .about = "Makes a procedural city and photographs it from the air, as `citysplat synth`, "
                 "with everything that studies vary. Writes DIR/images with EXIF GPS, a COLMAP "
                 "model in DIR/sparse/0, and the exact truth (poses, depth, clean pictures) in "
                 "DIR/truth.",
        .example = "citysplat-lab synth -o hard --exposure-ev 0.4 --white-balance 0.2 "
                   "--gps-sigma-m 3 --vehicle-share 0.2",
        .defs = synth_defs,
        .n_defs = sizeof synth_defs / sizeof *synth_defs,
    };
    return &spec;
}
