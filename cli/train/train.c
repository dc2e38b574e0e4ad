/* citysplat train: Gaussians from a scene.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "cli/base/cli.h"
#include "cli/base/output.h"
#include "codec/scene/scene.h"
#include "core/trace.h"
#include "scene/cells/footprint.h"
#include "train/auto_plan.h"
#include "train/base/config.h"
#include "train/base/timing.h"
#include "train/jobs.h"
#include "train/train.h"

static void train_print_cell(const struct train_cell_result *c)
{
    if (c->was_done) {
        printf("%-10s complete already\n", c->id);
        return;
    }
    for (uint32_t i = 0; i < c->n_levels; i++) {
        printf("%-10s %u of %-3u %12zu", c->id, i + 1, c->n_levels, c->n_gaussians[i]);
        if (isfinite(c->psnr_db[i]))
            printf(" %10.3f %8.4f\n", c->psnr_db[i], c->ssim[i]);
        else
            printf(" %10s %8s\n", "-", "-");
    }
}

/* Photographs of one survey score so differently, as a standard deviation (docs/training.md). */
static const double photo_spread_db = 1.5;
enum { SCORES_FEW = 16 };

static void train_print_worth(const struct train_result *r)
{
    size_t n = 0;
    for (size_t i = 0; i < r->n_cells; i++)
        n += r->cells[i].n_test;
    if (n && n < SCORES_FEW)
        printf("scores are means of %zu photograph%s that did not train: another choice of so few "
               "may score %.1f dB more or less\n",
               n, n == 1 ? "" : "s", photo_spread_db / sqrt((double)n));
}

static void train_print(const struct train_result *r)
{
    struct timing_seconds spent = {0};
    char text[512];
    printf("%-10s %-8s %12s %10s %8s\n", "cell", "level", "Gaussians", "PSNR dB", "SSIM");
    for (size_t i = 0; i < r->n_cells; i++)
        train_print_cell(&r->cells[i]);
    for (size_t i = 0; i < r->n_cells; i++)
        if (!r->cells[i].was_done)
            timing_add(&spent, &r->cells[i].timing);
    train_print_worth(r);
    printf("%.1f s, %.0f MiB at most\n", r->seconds, (double)r->peak_bytes / 1048576.0);
    if (timing_total(&spent) > 0.0) {
        timing_text(&spent, text, sizeof text);
        printf("time: %s\n", text);
    }
}

/* A line a cell, tab-separated, the id first: `cut -f1` feeds a scheduler. */
static enum err_code train_print_list(const char *scene_dir, const struct train_config *cfg,
                                      struct err *e)
{
    struct jobs_list list;
    log_set_level(LOG_WARN); /* what each job is told when it starts */
    enum err_code rc = jobs_list(scene_dir, NULL, cfg, true, &list, e);
    for (size_t i = 0; i < list.n_cells; i++) {
        const struct jobs_cell *c = &list.cells[i];
        uint64_t steps = 0;
        for (uint32_t k = 0; k < c->n_turns; k++)
            steps += c->steps[k];
        printf("%s\t%s\t%zu\t%llu\t%.0f\t%.0f\n", c->id, jobs_state_name(c->state), c->photos,
               (unsigned long long)steps, ceil(c->memory_bytes / 1048576.0), ceil(c->cpu_s));
    }
    jobs_list_free(&list);
    return rc;
}

/* What all cells wait for, before each gets a process of its own. */
static enum err_code train_coarse_first(const char *scene_dir, const struct train_config *cfg,
                                        struct train_result *out, struct err *e)
{
    struct train_config first = *cfg;
    char device[128];
    if (!cfg->coarse_only && !train_needs_coarse(cfg))
        return ERR_OK;
    snprintf(device, sizeof device, "%.*s", (int)strcspn(cfg->device, ","), cfg->device);
    first.device = device;
    first.coarse_only = true;
    enum err_code rc = train_run(scene_dir, &first, out, e);
    train_result_free(out);
    return rc;
}

/* What the photographs support, as a file beside the results; nothing where that is not known. */
static enum err_code train_footprint(const char *scene_dir, const struct train_config *cfg,
                                     struct err *e)
{
    struct scene scene = {0};
    struct footprint ground = {0};
    struct buf text = {0};
    char path[FILE_PATH_MAX];
    if (cfg->cell || cfg->coarse_only) /* a part of a run that writes it */
        return ERR_OK;
    const char *dir = cfg->output ? cfg->output : scene_dir;
    enum err_code rc = scene_read(scene_dir, &scene, e);
    if (!rc)
        rc = footprint_of(&scene, &ground, e);
    if (!rc && ground.nx)
        rc = footprint_write(&ground, &scene.origin, &text, e);
    if (!rc && text.size)
        rc = file_mkdir(dir, e);
    if (!rc && text.size)
        rc = file_join(path, dir, "footprint.geojson", e);
    if (!rc && text.size)
        rc = file_write(path, text.data, text.size, e);
    buf_free(&text);
    footprint_free(&ground);
    scene_free(&scene);
    return rc;
}

/* Where --jobs is left to the program: a run that it does not share out. */
static bool train_is_one(const char *scene_dir, const struct train_config *cfg)
{
    char plan[FILE_PATH_MAX];
    struct err none = {0};
    return cfg->cell || cfg->coarse_only || cfg->trace || cfg->stop_after > 0 ||
           file_join(plan, scene_dir, "plan.json", &none) || !file_exists(plan);
}

static enum err_code train_all(const char *scene_dir, const struct train_config *cfg,
                               struct train_result *out, struct err *e)
{
    struct train_config many = *cfg;
    struct jobs_list list;
    signals_catch();
    enum err_code rc = auto_plan(scene_dir, cfg, e);
    if (rc)
        return rc;
    if (cfg->jobs == 1 || (!cfg->jobs && train_is_one(scene_dir, cfg)))
        return train_run(scene_dir, cfg, out, e);
    if (cfg->coarse_only)
        return train_coarse_first(scene_dir, cfg, out, e);
    rc = jobs_list(scene_dir, NULL, cfg, !cfg->jobs, &list, e);
    size_t n = list.n_cells, at_once = (size_t)cfg->jobs;
    if (!rc && !cfg->jobs)
        rc = jobs_at_once(cfg, &list, &at_once, e);
    jobs_list_free(&list);
    if (rc || n < 2 || at_once < 2)
        return rc ? rc : train_run(scene_dir, cfg, out, e);
    many.jobs = (int64_t)at_once;
    if (!cfg->jobs)
        log_info("train", "%zu of %zu cells at a time (--jobs)", at_once, n);
    rc = train_coarse_first(scene_dir, &many, out, e);
    return rc ? rc : jobs_run("/proc/self/exe", scene_dir, &many, out, e);
}

static enum err_code train_trace_end(enum err_code rc, const char *path, struct err *e)
{
    struct trace_result t;
    struct err why = {0};
    if (trace_end(&t, rc ? &why : e)) {
        if (!rc)
            return ERR_IO;
        log_warn("train", "%s", why.msg);
    } else {
        printf("trace: %s: %zu spans, %zu dropped; kernels ran %.0f %% of %.1f s, %.2f cores were "
               "busy\n",
               path, t.spans, t.dropped, 100.0 * t.device, t.seconds, t.cores);
    }
    return rc;
}

/* train_all, with a trace of it where one is asked for. */
static enum err_code train_traced(const char *scene_dir, const struct train_config *cfg,
                                  struct train_result *out, struct err *e)
{
    if (!cfg->trace)
        return train_all(scene_dir, cfg, out, e);
    if (cfg->jobs > 1)
        return err_set(e, ERR_ARG,
                       "--trace records one process, and --jobs %d starts others: leave one out",
                       (int)cfg->jobs);
    if (output_check(cfg->trace, cfg->overwrite, e)) /* here --overwrite replaces results as well */
        return err_set(e, ERR_ARG, "%s: exists; give --trace another name", cfg->trace);
    enum err_code rc = trace_begin(cfg->trace, e);
    if (rc)
        return rc;
    return train_trace_end(train_all(scene_dir, cfg, out, e), cfg->trace, e);
}

enum err_code cli_train(int argc, char **argv, struct err *e)
{
    struct train_config cfg;
    struct options_args args;
    struct arena arena = {0};
    struct train_result result = {0};
    enum err_code rc = options_parse(train_options(), argc, argv, &cfg, &args, &arena, e);
    if (!rc && !args.done && cfg.list) {
        rc = train_print_list(args.arg[0], &cfg, e);
    } else if (!rc && !args.done) {
        rc = train_traced(args.arg[0], &cfg, &result, e);
        if (!rc)
            rc = train_footprint(args.arg[0], &cfg, e);
        if (!rc || result.n_cells)
            train_print(&result);
    }
    train_result_free(&result);
    arena_free(&arena);
    return rc;
}
