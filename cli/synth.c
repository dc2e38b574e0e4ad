/* citysplat synth: make a procedural city and photograph it from the air.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>

#include "cli/cli.h"
#include "cli/truth.h"
#include "synth/synth.h"

static enum err_code synth_score_map(const struct synth_config *cfg, struct err *e)
{
    struct truth_score s;
    if (!cfg->city)
        return err_set(e, ERR_ARG, "synth: --map: an orthophoto of which city? give --city CITY");
    enum err_code rc = truth_map(cfg, &s, e);
    if (!rc)
        printf("%s: PSNR %.2f dB over %llu pixels; %.2f dB over %llu within the built-up square\n",
               cfg->map, s.psnr_db, (unsigned long long)s.pixels, s.inside_psnr_db,
               (unsigned long long)s.inside);
    return rc;
}

enum err_code cli_synth(int argc, char **argv, struct err *e)
{
    struct arena a = {0};
    struct synth_config cfg;
    struct options_args args;
    enum err_code rc = options_parse(synth_options(), argc, argv, &cfg, &args, &a, e);
    if (rc || args.done)
        goto out;
    signals_catch();
    double start = clock_s();
    if (cfg.map) {
        rc = synth_score_map(&cfg, e);
        goto out;
    }
    if (cfg.city) {
        char dir[FILE_PATH_MAX];
        rc = synth_views_run(&cfg, dir, e);
        if (!rc)
            printf("%s: %lld map views of %s in %.1f s\n", dir, (long long)cfg.map_views, cfg.city,
                   clock_s() - start);
        goto out;
    }
    rc = synth_run(&cfg, e);
    if (!rc)
        printf("%s: %lld photographs of %lld x %lld px in %.1f s\n", cfg.output,
               (long long)cfg.photos, (long long)cfg.width_px, (long long)cfg.height_px,
               clock_s() - start);
out:
    arena_free(&a);
    return rc;
}
