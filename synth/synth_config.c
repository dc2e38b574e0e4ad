/* Options of `citysplat synth`: the table of synth.def as struct synth_config.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "synth/synth.h"

static const struct options_def synth_defs[] = {
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(type, tier, key, def, lo, hi, unit, help)                                              \
    OPTIONS_ROW(struct synth_config, type, tier, key, def, lo, hi, unit, help)
#include "synth/synth.def"
#undef OPT
};

const struct options_spec *synth_options(void)
{
    static const struct options_spec spec = {
        .command = "synth",
        .usage = "citysplat synth -o DIR [options]\n"
                 "       citysplat synth --splats N -o FILE.ply|DIR [options]",
        .about = "Makes a procedural city and photographs it from the air. Writes DIR/images "
                 "with EXIF GPS, a COLMAP model in DIR/sparse/0, and the exact truth (poses, "
                 "depth, clean pictures) in DIR/truth. --splats writes a city of any size as "
                 "Gaussians.",
        .example = "citysplat synth -o city\n"
                   "citysplat synth -o hard --exposure-ev 0.4 --white-balance 0.2 --gps-sigma-m 3 "
                   "--vehicle-share 0.2\n"
                   "citysplat synth --splats 4M -o large.ply",
        .defs = synth_defs,
        .n_defs = sizeof synth_defs / sizeof *synth_defs,
    };
    return &spec;
}
