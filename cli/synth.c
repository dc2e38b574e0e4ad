/* citysplat synth: make a procedural city and photograph it from the air.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>

#include "cli/cli.h"
#include "cli/truth.h"
#include "cli/truth_heights.h"
#include "synth/synth.h"
#include "synth/synth_splats.h"

/* Completeness: what has a surface within so many GSD of the city's. */
static void synth_print_heights(const char *where, const struct surface_figures *f)
{
    printf("%-6s %10zu %9.3f %9.3f %7.3f %7.3f %7.3f %7.3f %9.2f %8.2f %8.2f %8.2f\n", where, f->n,
           f->median_m, f->off_m, f->rmse_m, f->nmad_m, f->le90_m, f->le95_m, 100 * f->above[4],
           100 - 100 * f->above[0], 100 - 100 * f->above[1], 100 - 100 * f->above[2]);
}

static void synth_print_sigma(const char *where, const struct truth_sigma *s)
{
    if (s->n)
        printf("sigma   %s: %zu pixels, median %.3f m; %.1f, %.1f and %.1f %% of the errors within "
               "1, 2 and 3; median of error over sigma %.2f\n",
               where, s->n, s->median_m, 100 * s->within[0], 100 * s->within[1], 100 * s->within[2],
               s->ratio_middle);
}

static enum err_code synth_score_heights(const struct synth_config *cfg, struct err *e)
{
    struct truth_heights t;
    enum err_code rc = truth_heights(cfg, &t, e);
    if (rc)
        return rc;
    printf(
        "%s: %llu pixels of %g m within the built-up square, %llu of them without a surface; GSD "
        "of the photographs %.3f m\n",
        cfg->map, (unsigned long long)t.inside, t.pixel_m, (unsigned long long)t.none, t.gsd_m);
    printf("%-6s %10s %9s %9s %7s %7s %7s %7s %9s %8s %8s %8s\n", "places", "pixels", "median m",
           "signed m", "RMSE m", "NMAD m", "LE90 m", "LE95 m", "> 1 m %", "1 GSD %", "2 GSD %",
           "5 GSD %");
    synth_print_heights(cfg->map_ground ? "seen" : "level", &t.level);
    synth_print_heights(cfg->map_ground ? "below" : "edges", &t.zone);
    synth_print_heights("all", &t.all);
    synth_print_sigma(cfg->map_ground ? "seen" : "level", &t.sigma[0]);
    synth_print_sigma(cfg->map_ground ? "below" : "edges", &t.sigma[1]);
    synth_print_sigma("all", &t.sigma[2]);
    if (cfg->map_ground)
        return ERR_OK;
    printf("walls   %zu steps of 3 m and more, %zu of them missing: off by median %.2f px, 95 %% "
           "%.2f px; %.1f %% within 2 px; roofs reach out by %+.2f px (%+.3f m)\n"
           "volume  %+.0f m3 against the city\n",
           t.edges, t.missing, t.edge.median_px, t.edge.most_px, 100 * t.edge.within_2_px,
           t.edge.out_px, t.edge.out_px * t.pixel_m, t.volume_m3);
    return ERR_OK;
}

static enum err_code synth_score_map(const struct synth_config *cfg, struct err *e)
{
    struct truth_score s;
    if (!cfg->city)
        return err_set(e, ERR_ARG, "synth: --map: an orthophoto of which city? give --city CITY");
    enum err_code rc = truth_map(cfg, &s, e);
    if (rc == ERR_FORMAT) { /* no orthophoto: heights, or the first reason counts */
        struct err why = *e;
        enum err_code heights = synth_score_heights(cfg, e);
        if (heights != ERR_FORMAT)
            return heights;
        *e = why;
    }
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
    if (cfg.sh_degree && !cfg.splats) {
        rc = err_set(e, ERR_ARG, "--sh-degree is that of Gaussians; give --splats N as well");
        goto out;
    }
    if (cfg.splats) {
        rc = synth_splats_write(&cfg, e);
        double took = clock_s() - start;
        if (!rc)
            printf("%s: %lld Gaussians in %.1f s (%.2f M/s)\n", cfg.output, (long long)cfg.splats,
                   took, (double)cfg.splats / took / 1e6);
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
