/* citysplat-lab study-record: adds the numbers of a run to a file of recorded runs (runs.h), from
 * what `citysplat-lab eval-*` writes with -o, `citysplat train` (cells/<id>/metrics.jsonl) and
 * `citysplat-lab bench`.
 *
 * The training time of a level runs from the start of the cell to the end of the level, summed over
 * cells. The time of the longest cell is recorded too: it is the time with one machine for each
 * cell.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <dirent.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jansson.h>

#include "core/options/options.h"
#include "lab/lab.h"
#include "lab/study/runs.h"
#include "lab/study/study.h"
#include "train/base/config.h"

struct record_options {
#define OPT OPTIONS_MEMBER
#include "lab/study/study_record.def"
};

static const struct options_def record_defs[] = {
#define OPT(...) OPTIONS_ROW(struct record_options, __VA_ARGS__)
#include "lab/study/study_record.def"
};

struct record_level { /* over cells */
    double train_s, train_longest_s, peak_bytes;
    double pruned;          /* by density control and at the level's end */
    double bytes, ms_frame; /* of its photographs' score: map views are of the same files */
};

struct record_run {
    struct record_options o;
    json_t *lines; /* of the file, then of this run as well */
    struct record_level level[TRAIN_LEVELS_MAX];
    unsigned n_levels;
    double fma_gflops, triad_gbps; /* 0: not told */
    json_t *more;                  /* --set */
    size_t at;                     /* where the next record goes */
};

static enum err_code record_full(struct err *e)
{
    return err_set(e, ERR_MEM, "record: out of memory");
}

/* ---- what the run left ---- */

static enum err_code record_read_cell(struct record_run *r, const char *path, struct err *e)
{
    json_t *lines = NULL, *line;
    double ended_s[TRAIN_LEVELS_MAX] = {0}; /* a level that is made again ends twice */
    size_t i;
    enum err_code rc = runs_read_lines(path, &lines, e);
    if (rc)
        return rc;
    json_array_foreach(lines, i, line)
    {
        double level = runs_number(line, "level"), s = runs_number(line, "seconds");
        const char *event = runs_text(line, "event");
        if (!(level >= 1.0) || !(level <= TRAIN_LEVELS_MAX))
            continue;
        struct record_level *l = &r->level[(size_t)level - 1];
        if (!strcmp(event, "densify"))
            l->pruned += runs_number(line, "pruned");
        if (!strcmp(event, "prune"))
            l->pruned += runs_number(line, "removed");
        if (strcmp(event, "level"))
            continue;
        ended_s[(size_t)level - 1] = s;
        l->peak_bytes = fmax(l->peak_bytes, runs_number(line, "peak_bytes"));
        r->n_levels = (unsigned)level > r->n_levels ? (unsigned)level : r->n_levels;
    }
    for (size_t k = 0; k < TRAIN_LEVELS_MAX; k++) {
        r->level[k].train_s += ended_s[k];
        r->level[k].train_longest_s = fmax(r->level[k].train_longest_s, ended_s[k]);
    }
    json_decref(lines);
    return ERR_OK;
}

static enum err_code record_read_results(struct record_run *r, struct err *e)
{
    char path[FILE_PATH_MAX], file[FILE_PATH_MAX + 288];
    size_t found = 0;
    struct record_run before = {0};
    enum err_code rc = file_join(path, r->o.results, "cells", e);
    if (rc)
        return rc;
    DIR *dir = opendir(path);
    if (!dir)
        return err_errno(e, ERR_NOENT, "%s: not the results of `citysplat train`", path);
    for (struct dirent *d; !rc && (d = readdir(dir));) {
        snprintf(file, sizeof file, "%s/%s/metrics.jsonl", path, d->d_name);
        if (d->d_name[0] == '.' || !file_exists(file))
            continue;
        bool shared = !strcmp(d->d_name, TRAIN_COARSE_ID); /* trained before all cells */
        rc = record_read_cell(shared ? &before : r, file, e);
        found += !shared;
    }
    closedir(dir);
    for (unsigned k = 0; k < r->n_levels; k++) {
        r->level[k].train_s += before.level[0].train_s;
        r->level[k].train_longest_s += before.level[0].train_s;
        r->level[k].peak_bytes = fmax(r->level[k].peak_bytes, before.level[0].peak_bytes);
    }
    if (!rc && !found)
        rc = err_set(e, ERR_NOENT, "%s: no metrics.jsonl of any cell", path);
    return rc;
}

static enum err_code record_read_ceilings(struct record_run *r, struct err *e)
{
    json_t *lines = NULL, *line;
    size_t i;
    enum err_code rc = runs_read_lines(r->o.ceilings, &lines, e);
    if (rc)
        return rc;
    json_array_foreach(lines, i, line)
    {
        if (strcmp(runs_text(line, "bench"), "ceiling"))
            continue;
        if (!strcmp(runs_text(line, "case"), "fma"))
            r->fma_gflops = runs_number(line, "value");
        if (!strcmp(runs_text(line, "case"), "triad"))
            r->triad_gbps = runs_number(line, "value");
    }
    json_decref(lines);
    if (!(r->fma_gflops > 0.0) || !(r->triad_gbps > 0.0))
        return err_set(e, ERR_DATA, "%s: no ceilings; `citysplat-lab ceiling` prints them",
                       r->o.ceilings);
    return ERR_OK;
}

static enum err_code record_parse_set(struct record_run *r, struct err *e)
{
    const char *at = r->o.set ? r->o.set : "";
    r->more = json_object();
    if (!r->more)
        return record_full(e);
    while (*at) {
        char key[64];
        char *end = NULL;
        size_t n = strcspn(at, "=");
        if (!n || n >= sizeof key || at[n] != '=')
            return err_set(e, ERR_ARG, "--set: expected key=number at '%s'", at);
        memcpy(key, at, n);
        key[n] = '\0';
        double v = strtod(at + n + 1, &end);
        if (end == at + n + 1 || (*end && *end != ',') || !isfinite(v))
            return err_set(e, ERR_ARG, "--set: %s: expected a number at '%s'", key, at + n + 1);
        if (json_object_set_new(r->more, key, json_real(v)))
            return record_full(e);
        at = *end ? end + 1 : end;
    }
    return ERR_OK;
}

/* ---- the records ---- */

static bool record_is(const json_t *line, const char *study, const char *row)
{
    return !strcmp(runs_text(line, "study"), study) && !strcmp(runs_text(line, "row"), row);
}

/* Remove what the file has of this row: a row is one run. The new records take its place. */
static void record_remove(struct record_run *r)
{
    r->at = json_array_size(r->lines);
    for (size_t i = r->at; i-- > 0;)
        if (record_is(json_array_get(r->lines, i), r->o.study, r->o.row)) {
            json_array_remove(r->lines, i);
            r->at = i;
        }
}

/* Takes over the reference to `numbers`. */
static enum err_code record_add(struct record_run *r, const char *what, const char *device,
                                json_t *numbers, struct err *e)
{
    const struct record_options *o = &r->o;
    json_t *line = json_pack(
        "{s:s, s:s, s:s, s:s, s:s, s:s, s:s, s:o, s:o}", "study", o->study, "row", o->row, "what",
        what, "dataset", o->dataset ? o->dataset : "", "command", o->command ? o->command : "",
        "commit", o->commit ? o->commit : "", "device", device, "fma_gflops",
        r->fma_gflops > 0.0 ? json_real(r->fma_gflops) : json_null(), "triad_gbps",
        r->triad_gbps > 0.0 ? json_real(r->triad_gbps) : json_null());
    if (!line || !numbers || json_object_update(numbers, r->more) ||
        json_object_set(line, "numbers", numbers) || json_array_insert(r->lines, r->at++, line)) {
        json_decref(line);
        json_decref(numbers);
        return record_full(e);
    }
    json_decref(line);
    json_decref(numbers);
    return ERR_OK;
}

static enum err_code record_set(json_t *o, const char *key, double v, struct err *e)
{
    return v > 0.0 && json_object_set_new(o, key, json_real(v)) ? record_full(e) : ERR_OK;
}

/* What training took up to level k, and for map views the files and frames of its photographs. */
static enum err_code record_training(struct record_run *r, unsigned k, bool map_views,
                                     json_t *numbers, struct err *e)
{
    struct record_level *l = &r->level[k - 1];
    double pruned = 0.0;
    for (unsigned i = 0; i < k; i++)
        pruned += r->level[i].pruned;
    if (!map_views) {
        l->bytes = json_number_value(json_object_get(numbers, "bytes"));
        l->ms_frame = json_number_value(json_object_get(numbers, "ms_frame"));
    }
    enum err_code rc = record_set(numbers, "train_s", l->train_s, e);
    if (!rc)
        rc = record_set(numbers, "train_longest_s", l->train_longest_s, e);
    if (!rc)
        rc = record_set(numbers, "train_peak_bytes", l->peak_bytes, e);
    if (!rc)
        rc = record_set(numbers, "pruned", pruned, e);
    if (!rc && map_views)
        rc = record_set(numbers, "bytes", l->bytes, e);
    if (!rc && map_views)
        rc = record_set(numbers, "ms_frame", l->ms_frame, e);
    return rc;
}

/* Numbers of a score, and of the training up to its level (the last one for a tile store). */
static enum err_code record_score(struct record_run *r, const json_t *score, const char *device,
                                  struct err *e)
{
    const char *what = runs_text(score, "what"), *key;
    char kind[96];
    json_t *numbers = json_object(), *v;
    unsigned level = r->n_levels;
    enum err_code rc = numbers ? ERR_OK : record_full(e);
    if (sscanf(what, "level %u", &level) == 1 && !rc)
        rc = record_set(numbers, "level", level, e);
    json_object_foreach((json_t *)(uintptr_t)score, key, v)
    {
        if (!rc && json_is_number(v) && json_object_set(numbers, key, v))
            rc = record_full(e);
    }
    if (!rc && level >= 1 && level <= r->n_levels)
        rc = record_training(r, level, runs_text(score, "views_of")[0], numbers, e);
    if (rc) {
        json_decref(numbers);
        return rc;
    }
    if (runs_text(score, "views_of")[0]) { /* a kind of map views */
        snprintf(kind, sizeof kind, "%s%s, %s", strncmp(what, "tiles", 5) ? "" : "views of ", what,
                 runs_text(score, "views_of"));
        what = kind;
    }
    return record_add(r, what, device, numbers, e);
}

static enum err_code record_scores_of(struct record_run *r, const char *path, struct err *e)
{
    json_t *file = NULL, *score;
    size_t i;
    enum err_code rc = jsonc_read(path, &file, e);
    if (!rc && !json_array_size(json_object_get(file, "scores")))
        rc = err_set(e, ERR_DATA, "%s: no scores; `citysplat-lab eval-photographs -o` writes them",
                     path);
    json_array_foreach(json_object_get(file, "scores"), i, score)
    {
        if (!rc)
            rc = record_score(r, score, runs_text(file, "device"), e);
    }
    json_decref(file);
    return rc;
}

static enum err_code record_scores(struct record_run *r, struct err *e)
{
    char path[FILE_PATH_MAX];
    enum err_code rc = ERR_OK;
    for (const char *at = r->o.scores; !rc && *at;) {
        size_t n = strcspn(at, ",");
        snprintf(path, sizeof path, "%.*s", (int)n, at);
        rc = record_scores_of(r, path, e);
        at += n + (at[n] == ',');
    }
    return rc;
}

static enum err_code record_bench(struct record_run *r, struct err *e)
{
    json_t *lines = NULL, *line, *v;
    const char *key;
    size_t i;
    char what[256];
    enum err_code rc = runs_read_lines(r->o.bench, &lines, e);
    json_array_foreach(lines, i, line)
    {
        if (rc || !strcmp(runs_text(line, "bench"), "ceiling"))
            continue;
        snprintf(what, sizeof what, "%s: %s (%s)", runs_text(line, "bench"),
                 runs_text(line, "case"), runs_text(line, "unit"));
        json_t *numbers = json_object();
        rc = numbers ? ERR_OK : record_full(e);
        json_object_foreach(line, key, v)
        {
            if (!rc && json_is_number(v) && json_object_set(numbers, key, v))
                rc = record_full(e);
        }
        if (!rc)
            rc = record_add(r, what, runs_text(line, "device"), numbers, e);
        else
            json_decref(numbers);
    }
    json_decref(lines);
    return rc;
}

static enum err_code record_open(struct record_run *r, const char *path, struct err *e)
{
    enum err_code rc = record_parse_set(r, e);
    if (!rc && file_exists(path))
        return runs_read(path, &r->lines, e);
    if (!rc && !(r->lines = json_array()))
        rc = record_full(e);
    return rc;
}

/* --check: the row is there, made by the same command. */
static enum err_code record_find(const struct record_run *r, const char *path, struct err *e)
{
    size_t i;
    json_t *line;
    json_array_foreach(r->lines, i, line)
    {
        if (record_is(line, r->o.study, r->o.row) &&
            !strcmp(runs_text(line, "command"), r->o.command ? r->o.command : ""))
            return ERR_OK;
    }
    return err_set(e, ERR_NOENT, "%s: no row '%s' of study '%s' by that command", path, r->o.row,
                   r->o.study);
}

static enum err_code record_run(struct record_run *r, const char *path, struct err *e)
{
    enum err_code rc = record_open(r, path, e);
    if (rc || r->o.check)
        return rc ? rc : record_find(r, path, e);
    record_remove(r);
    if (r->o.ceilings)
        rc = record_read_ceilings(r, e);
    if (!rc && r->o.results)
        rc = record_read_results(r, e);
    if (!rc && r->o.scores)
        rc = record_scores(r, e);
    if (!rc && r->o.bench)
        rc = record_bench(r, e);
    if (!rc && !r->o.scores && !r->o.bench) {
        json_t *numbers = json_object();
        rc = record_add(r, "", "", numbers, e);
    }
    return !rc ? runs_write(path, r->lines, e) : rc;
}

enum err_code lab_study_record(int argc, char **argv, struct err *e)
{
    const struct options_spec spec = {
        .command = "study-record",
        .usage = "citysplat-lab study-record FILE.jsonl --study NAME --row NAME [options]",
        .about = "Adds the numbers of a run to a file of recorded runs, from which "
                 "`citysplat-lab study-chart` draws. A row that is there already is replaced. "
                 "lab/study.sh uses it.",
        .example = "citysplat eval scene -o scores.json\ncitysplat-lab study-record "
                   "lab/runs/budgets.jsonl "
                   "--study budgets --row '50 k' --scores scores.json --results scene --set "
                   "budget=50000",
        .defs = record_defs,
        .n_defs = sizeof record_defs / sizeof *record_defs,
        .min_args = 1,
        .max_args = 1};
    struct record_run r = {0};
    struct options_args args;
    struct arena arena = {0};
    enum err_code rc = options_parse(&spec, argc, argv, &r.o, &args, &arena, e);
    if (!rc && !args.done && (!r.o.study || !r.o.row))
        rc = err_set(e, ERR_ARG, "record: --study and --row are required");
    if (!rc && !args.done)
        rc = record_run(&r, args.arg[0], e);
    json_decref(r.lines);
    json_decref(r.more);
    arena_free(&arena);
    return rc;
}
