/* citysplat-lab chart: accuracy of a user's own runs against their cost: training time, Gaussians,
 * bytes, and time a frame.
 *
 * A run is a trained scene. Its numbers are in cells/<id>/metrics.jsonl, where training writes the
 * score of the test photographs at the end of each level. Cells are combined: times, Gaussians and
 * bytes are summed, and scores are averaged over the test photographs.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <dirent.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include <jansson.h>

#include "cli/base/output.h"
#include "core/options/options.h"
#include "lab/lab.h"
#include "lab/study/chart.h"
#include "lab/study/runs.h"
#include "train/base/config.h"

struct chart_options {
#define OPT OPTIONS_MEMBER
#include "lab/study/chart_scenes.def"
};

static const struct options_def chart_option_defs[] = {
#define OPT(...) OPTIONS_ROW(struct chart_options, __VA_ARGS__)
#include "lab/study/chart_scenes.def"
};

#define CHART_OF(name, kind, x, title)                                                             \
    {                                                                                              \
        name, "runs", "level", kind, x, "psnr_db|ssim", "group", "level", title, NULL              \
    }
static const struct chart_def chart_defs[] = {
    CHART_OF("accuracy_seconds", "log", "train_s",
             "Accuracy against training time (labels: level)"),
    CHART_OF("accuracy_gaussians", "log", "gaussians",
             "Accuracy against the number of Gaussians (labels: level)"),
    CHART_OF("accuracy_bytes", "log", "bytes", "Accuracy against checkpoint size (labels: level)"),
    CHART_OF("accuracy_frame", "line", "ms_frame", "Accuracy against time a frame (labels: level)"),
    {"runs", "runs", "level", "", "", "", "", "", "",
     "row|psnr_db|ssim|gaussians|ms_frame|bytes|train_s|train_peak_bytes"},
};
enum { CHART_DEFS = sizeof chart_defs / sizeof *chart_defs };

struct chart_level { /* sums over cells; scores and ms_frame weighted by test photographs */
    double train_s, gaussians, bytes, peak_bytes, photographs, psnr_db, ssim, ms_frame;
};
struct chart_run {
    char name[CHART_TEXT_MAX];
    struct chart_level level[TRAIN_LEVELS_MAX];
};

/* ---- what training left ---- */

static void chart_add_level(struct chart_run *r, const json_t *line, const char *cell_dir)
{
    char path[FILE_PATH_MAX + 32];
    double k = runs_number(line, "level"), n = runs_number(line, "test_photographs");
    struct stat st;
    if (strcmp(runs_text(line, "event"), "level") || !(k >= 1.0) || !(k <= TRAIN_LEVELS_MAX))
        return;
    struct chart_level *l = &r->level[(size_t)k - 1];
    double psnr_db = runs_number(line, "psnr_db"), ms = runs_number(line, "ms_frame");
    l->train_s += runs_number(line, "seconds");
    l->gaussians += runs_number(line, "gaussians");
    l->peak_bytes = fmax(l->peak_bytes, runs_number(line, "peak_bytes"));
    snprintf(path, sizeof path, "%s/level%u.ckpt", cell_dir, (unsigned)k);
    l->bytes += stat(path, &st) ? 0.0 : (double)st.st_size;
    if (n > 0.0 && isfinite(psnr_db)) {
        l->photographs += n;
        l->psnr_db += n * psnr_db;
        l->ssim += n * runs_number(line, "ssim");
        l->ms_frame += isfinite(ms) ? n * ms : 0.0;
    }
}

static enum err_code chart_read_cell(struct chart_run *r, const char *cell_dir, struct err *e)
{
    char path[FILE_PATH_MAX];
    json_t *lines = NULL, *line;
    size_t i;
    enum err_code rc = file_join(path, cell_dir, "metrics.jsonl", e);
    if (!rc)
        rc = runs_read_lines(path, &lines, e);
    json_array_foreach(lines, i, line)
    {
        chart_add_level(r, line, cell_dir);
    }
    json_decref(lines);
    return rc;
}

/* The coarse model is no cell: its Gaussians are not the city's. */
static bool chart_is_cell(const char *cells, const char *name, char out[FILE_PATH_MAX])
{
    char path[FILE_PATH_MAX + 32];
    int n = snprintf(out, FILE_PATH_MAX, "%s/%s", cells, name);
    if (name[0] == '.' || !strcmp(name, TRAIN_COARSE_ID) || n >= FILE_PATH_MAX)
        return false;
    snprintf(path, sizeof path, "%s/metrics.jsonl", out);
    return file_exists(path);
}

static enum err_code chart_read_run(struct chart_run *r, const char *scene, struct err *e)
{
    char cells[FILE_PATH_MAX], dir[FILE_PATH_MAX];
    size_t found = 0;
    snprintf(r->name, sizeof r->name, "%.80s", scene);
    enum err_code rc = file_join(cells, scene, "cells", e);
    DIR *d = rc ? NULL : opendir(cells);
    if (!rc && !d)
        return err_set(e, ERR_NOENT,
                       "%s: not a trained scene (no folder cells/); `citysplat train %s` makes it",
                       scene, scene);
    for (struct dirent *entry; !rc && (entry = readdir(d));)
        if (chart_is_cell(cells, entry->d_name, dir)) {
            rc = chart_read_cell(r, dir, e);
            found++;
        }
    if (d)
        closedir(d);
    if (!rc && !found)
        rc = err_set(e, ERR_NOENT, "%s: no cell has a metrics.jsonl; `citysplat train %s` makes it",
                     scene, scene);
    return rc;
}

/* ---- as records ---- */

static enum err_code chart_add_records(const struct chart_run *r, json_t *lines, struct err *e)
{
    for (unsigned k = 0; k < TRAIN_LEVELS_MAX; k++) {
        const struct chart_level *l = &r->level[k];
        char row[CHART_TEXT_MAX + 32], what[16];
        if (!(l->photographs > 0.0))
            continue;
        snprintf(row, sizeof row, "%s: level %u", r->name, k + 1);
        snprintf(what, sizeof what, "level %u", k + 1);
        json_t *numbers =
            json_pack("{s:i, s:f, s:f, s:f, s:f, s:f, s:f, s:f}", "level", (int)k + 1, "train_s",
                      l->train_s, "gaussians", l->gaussians, "bytes", l->bytes, "train_peak_bytes",
                      l->peak_bytes, "psnr_db", l->psnr_db / l->photographs, "ssim",
                      l->ssim / l->photographs, "ms_frame", l->ms_frame / l->photographs);
        json_t *line = json_pack("{s:s, s:s, s:s, s:s, s:o}", "study", "runs", "row", row, "what",
                                 what, "dataset", r->name, "numbers", numbers);
        if (!line || json_array_append_new(lines, line))
            return err_set(e, ERR_MEM, "chart: out of memory");
    }
    return ERR_OK;
}

static enum err_code chart_read_all(const struct options_args *args, json_t *lines, struct err *e)
{
    enum err_code rc = lines ? ERR_OK : err_set(e, ERR_MEM, "chart: out of memory");
    for (size_t i = 0; !rc && i < args->n; i++) {
        struct chart_run run = {0};
        size_t before = json_array_size(lines);
        rc = chart_read_run(&run, args->arg[i], e);
        if (!rc)
            rc = chart_add_records(&run, lines, e);
        if (!rc && json_array_size(lines) == before)
            rc = err_set(e, ERR_DATA,
                         "%s: no level has a score; a scene without test photographs has none "
                         "(`citysplat ingest --test-every 8`)",
                         args->arg[i]);
    }
    return rc;
}

static enum err_code chart_draw(const struct chart_def *d, const json_t *lines,
                                const struct chart_options *o, struct err *e)
{
    struct chart_data data = {0};
    char path[FILE_PATH_MAX], name[64];
    snprintf(name, sizeof name, "%s.svg", d->name);
    enum err_code rc = chart_data_make(d, lines, &data, e);
    if (!rc && data.n_series)
        rc = file_join(path, o->output, name, e);
    if (!rc && data.n_series)
        rc = output_check(path, o->overwrite, e);
    if (!rc && data.n_series)
        rc = chart_plot(d, &data, o->output, o->png, e);
    if (!rc && data.n_series)
        fprintf(stderr, "%s/%s.svg\n", o->output, d->name);
    chart_data_free(&data);
    return rc;
}

static enum err_code chart_draw_all(const struct chart_options *o, const json_t *lines,
                                    struct err *e)
{
    struct buf table = {0};
    enum err_code rc = file_mkdir(o->output, e);
    for (size_t i = 0; !rc && i < CHART_DEFS; i++) {
        if (chart_defs[i].columns)
            chart_table(&chart_defs[i], lines, &table);
        else
            rc = chart_draw(&chart_defs[i], lines, o, e);
    }
    if (!rc)
        rc = buf_check(&table, e);
    if (!rc)
        fwrite(table.data, 1, table.size, stdout);
    buf_free(&table);
    return rc;
}

enum err_code lab_chart_scenes(int argc, char **argv, struct err *e)
{
    const struct options_spec spec = {
        .command = "chart",
        .usage = "citysplat-lab chart SCENE... -o DIR [options]",
        .about = "Draws charts of trained scenes: PSNR and SSIM of the test photographs against "
                 "training time, number of Gaussians, checkpoint size and time a frame. Each "
                 "scene is a line and each level a point. Charts are written to DIR as SVG and "
                 "PNG (by gnuplot), and a Markdown table to stdout.",
        .example = "citysplat-lab chart short/scene long/scene -o charts",
        .defs = chart_option_defs,
        .n_defs = sizeof chart_option_defs / sizeof *chart_option_defs,
        .min_args = 1,
        .max_args = CHART_SERIES_MAX};
    struct chart_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    json_t *lines = NULL;
    enum err_code rc = options_parse(&spec, argc, argv, &o, &args, &arena, e);
    if (!rc && !args.done && !o.output)
        rc = err_set(e, ERR_ARG, "chart: -o DIR is required");
    if (!rc && !args.done) {
        lines = json_array();
        rc = chart_read_all(&args, lines, e);
    }
    if (lines && !rc)
        rc = chart_draw_all(&o, lines, e);
    json_decref(lines);
    arena_free(&arena);
    return rc;
}
