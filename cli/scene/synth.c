/* citysplat synth: make a procedural city and photograph it from the air.
 *
 * It has the options that a demo needs. `citysplat-lab synth` has all of struct synth_config.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <stdio.h>

#include "cli/base/cli.h"
#include "scene/synth/synth.h"

static const struct options_def synth_defs[] = {
#define OPT(...) OPTIONS_ROW(struct synth_config, __VA_ARGS__)
#include "scene/synth/synth.def"
};

static const struct options_spec synth_spec = {
    .command = "synth",
    .usage = "citysplat synth -o DIR [options]",
    .about = "Makes a procedural city and photographs it from the air. Writes DIR/images with EXIF "
             "GPS, a COLMAP model in DIR/sparse/0, and the exact truth (poses, depth, clean "
             "pictures) in DIR/truth.",
    .example = "citysplat synth -o city",
    .defs = synth_defs,
    .n_defs = sizeof synth_defs / sizeof *synth_defs,
};

/* What the command line does not have keeps its default. */
static enum err_code synth_parse(int argc, char **argv, struct synth_config *out,
                                 struct options_args *args, struct arena *a, struct err *e)
{
    struct synth_config told;
    json_t *json = NULL;
    enum err_code rc = options_parse(&synth_spec, argc, argv, &told, args, a, e);
    if (!rc)
        rc = options_to_json(&synth_spec, &told, &json, e);
    if (!rc)
        rc = options_defaults(synth_options(), out, a, e);
    if (!rc)
        rc = options_from_json(synth_options(), json, out, a, e);
    json_decref(json);
    return rc;
}

enum err_code cli_synth(int argc, char **argv, struct err *e)
{
    struct arena a = {0};
    struct synth_config cfg;
    struct options_args args;
    enum err_code rc = synth_parse(argc, argv, &cfg, &args, &a, e);
    if (rc || args.done)
        goto out;
    signals_catch();
    double start = clock_s();
    rc = synth_run(&cfg, e);
    if (!rc)
        printf("%s: %lld photographs of %lld x %lld px in %.1f s\n", cfg.output,
               (long long)cfg.photos, (long long)cfg.width_px, (long long)cfg.height_px,
               clock_s() - start);
out:
    arena_free(&a);
    return rc;
}
