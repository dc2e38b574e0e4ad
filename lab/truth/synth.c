/* citysplat-lab synth: the procedural city of `citysplat synth` with everything that studies vary.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/synth/synth.h"

#include <stdio.h>

#include "lab/lab.h"

enum err_code lab_synth(int argc, char **argv, struct err *e)
{
    struct arena a = {0};
    struct synth_config cfg;
    struct options_args args;
    enum err_code rc = options_parse(synth_options(), argc, argv, &cfg, &args, &a, e);
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
