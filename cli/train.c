/* citysplat train: Gaussians from a scene.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>

#include "cli/cli.h"
#include "train/train.h"

static void train_print(const struct train_result *r)
{
    printf("%-8s %12s %10s %8s\n", "level", "Gaussians", "PSNR dB", "SSIM");
    for (uint32_t i = 0; i < r->n_levels; i++) {
        printf("%u of %-3u %12zu", i + 1, r->n_levels, r->n_gaussians[i]);
        if (r->n_gaussians[i] && isfinite(r->psnr_db[i]))
            printf(" %10.3f %8.4f\n", r->psnr_db[i], r->ssim[i]);
        else
            printf(" %10s %8s\n", "-", "-");
    }
    printf("%.1f s, %.0f MiB at most\n", r->seconds, (double)r->peak_bytes / 1048576.0);
}

enum err_code cli_train(int argc, char **argv, struct err *e)
{
    struct train_config cfg;
    struct options_args args;
    struct arena arena = {0};
    struct train_result result;
    enum err_code rc = options_parse(train_options(), argc, argv, &cfg, &args, &arena, e);
    if (!rc && !args.done) {
        clock_catch_signals();
        rc = train_run(args.arg[0], &cfg, &result, e);
        if (!rc)
            train_print(&result);
    }
    arena_free(&arena);
    return rc;
}
