/* citysplat-lab bench [NAME...]: runs the named benchmarks (all without a name), the ceilings
 * always first. JSON lines on stdout as they come, then a table on stderr.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#define _XOPEN_SOURCE 700
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jansson.h>

#include "core/math/sort.h"
#include "core/options/options.h"
#include "lab/bench/bench.h"
#include "lab/lab.h"

struct bench_row {
    const char *bench, *name, *unit, *against;
    double value, ratio;
    double took_ms; /* of a kernel, with the next two; 0: it is none */
    struct roofline_need need;
    struct roofline_limit limit;
};

enum { BENCH_TEXT_MAX = 160 };

struct bench_config {
#define OPT OPTIONS_MEMBER
#include "lab/bench/bench.def"
};

static const struct options_def bench_defs[] = {
#define OPT(...) OPTIONS_ROW(struct bench_config, __VA_ARGS__)
#include "lab/bench/bench.def"
};

struct bench_entry {
    const char *name, *about;
    enum err_code (*run)(struct bench *b, struct err *e);
    bool only_named; /* too long for a run of all */
};
static const struct bench_entry entries[] = {
#define BENCH(name, about) {#name, about, bench_##name, false},
#define BENCH_LONG(name, about) {#name, about, bench_##name, true},
#include "lab/benches.def"
#undef BENCH_LONG
#undef BENCH
};
enum { ENTRIES = sizeof entries / sizeof entries[0], BENCH_ROWS_MAX = 4096 };

/* Print a case as a line of JSON and keep it for the table; takes over the reference to `o`. */
static void bench_emit(struct bench *b, json_t *o)
{
    if (o && b->dev && !json_object_set_new(o, "device", json_string(b->dev->name)))
        json_dumpf(o, stdout, JSON_COMPACT | JSON_PRESERVE_ORDER | JSON_REAL_PRECISION(6));
    json_decref(o);
    putchar('\n');
    fflush(stdout);
}

static void bench_keep(struct bench *b, const char *case_name, double value, const char *unit,
                       double ratio, const char *against)
{
    if (b->n_rows < BENCH_ROWS_MAX)
        b->rows[b->n_rows++] =
            (struct bench_row){.bench = b->name,
                               .name = arena_text(&b->arena, case_name),
                               .unit = arena_text(&b->arena, unit),
                               .against = against ? arena_text(&b->arena, against) : NULL,
                               .value = value,
                               .ratio = ratio};
}

void bench_report(struct bench *b, const char *case_name, double value, const char *unit,
                  double ratio, const char *against)
{
    bench_emit(b, json_pack("{s:s, s:s, s:f, s:s, s:o, s:s?}", "bench", b->name, "case", case_name,
                            "value", value, "unit", unit, "ratio",
                            against ? json_real(ratio) : json_null(), "against", against));
    bench_keep(b, case_name, value, unit, ratio, against);
}

void bench_report_at(struct bench *b, const char *case_name, double value, const char *unit,
                     double gaussians, double pixels)
{
    char text[BENCH_TEXT_MAX];
    snprintf(text, sizeof text, "%s: %.0f Gaussians, %.0f pixels", case_name, gaussians, pixels);
    bench_emit(b, json_pack("{s:s, s:s, s:f, s:s, s:n, s:n, s:s, s:f, s:f}", "bench", b->name,
                            "case", text, "value", value, "unit", unit, "ratio", "against",
                            "series", case_name, "gaussians", gaussians, "pixels", pixels));
    bench_keep(b, text, value, unit, 0.0, NULL);
}

void bench_report_kernel(struct bench *b, const char *case_name, const struct bench_kernel *k,
                         double gaussians, double pixels)
{
    const char *bound = k->limit.memory ? "memory" : "arithmetic", *against = "its limit";
    char text[BENCH_TEXT_MAX];
    snprintf(text, sizeof text, "%s: %.0f Gaussians, %.0f pixels", case_name, gaussians, pixels);
    bench_emit(b, json_pack("{s:s, s:s, s:f, s:s, s:f, s:s, s:s, s:f, s:f, "
                            "s:f, s:f, s:f, s:f, s:s}",
                            "bench", b->name, "case", text, "value", k->ms, "unit", "ms", "ratio",
                            k->ratio, "against", against, "series", case_name, "gaussians",
                            gaussians, "pixels", pixels, "took_ms", k->took_ms, "bytes",
                            k->need.bytes, "multiply_adds", k->need.multiply_adds, "limit_ms",
                            k->limit.ms, "bound", bound));
    size_t at = b->n_rows;
    bench_keep(b, text, k->ms, "ms", k->ratio, against);
    if (b->n_rows > at) {
        b->rows[at].took_ms = k->took_ms;
        b->rows[at].need = k->need;
        b->rows[at].limit = k->limit;
    }
}

static enum err_code bench_clock(struct bench *b, double (*now)(void),
                                 enum err_code (*fn)(void *user, struct err *e), void *user,
                                 double *median_ms, double *spread_ms, struct err *e)
{
    size_t n = (size_t)b->runs;
    double *ms = mem_array(n, sizeof *ms);
    if (!ms)
        return err_set(e, ERR_MEM, "out of memory");
    enum err_code rc = fn(user, e); /* builds kernels and warms caches; not counted */
    for (size_t i = 0; !rc && i < n; i++) {
        double start = now();
        rc = fn(user, e);
        ms[i] = 1e3 * (now() - start);
    }
    sort_doubles(ms, n);
    *median_ms = ms[n / 2];
    if (spread_ms)
        *spread_ms = 0.5 * (ms[3 * n / 4] - ms[n / 4]);
    mem_free(ms);
    return rc;
}

enum err_code bench_time(struct bench *b, enum err_code (*fn)(void *user, struct err *e),
                         void *user, double *median_ms, double *spread_ms, struct err *e)
{
    return bench_clock(b, clock_s, fn, user, median_ms, spread_ms, e);
}

enum err_code bench_cpu_time(struct bench *b, enum err_code (*fn)(void *user, struct err *e),
                             void *user, double *median_ms, double *spread_ms, struct err *e)
{
    return bench_clock(b, clock_cpu_s, fn, user, median_ms, spread_ms, e);
}

static char tmpdir[FILE_PATH_MAX]; /* made on first use by one thread, removed at the end of main */

const char *bench_tmpdir(struct bench *b)
{
    (void)b;
    if (!tmpdir[0]) {
        const char *base = getenv("TMPDIR");
        snprintf(tmpdir, sizeof tmpdir, "%s/citysplat-lab-XXXXXX", base && *base ? base : "/tmp");
        if (!mkdtemp(tmpdir))
            snprintf(tmpdir, sizeof tmpdir, ".");
    }
    return tmpdir;
}

/* The value of the same case in the baseline, 0 when it has none. The file is JSON lines. */
static double bench_baseline_value(const json_t *lines, const char *of, const char *case_name)
{
    size_t i;
    json_t *o;
    json_array_foreach(lines, i, o)
    {
        const char *bench = json_string_value(json_object_get(o, "bench"));
        const char *name = json_string_value(json_object_get(o, "case"));
        if (bench && name && !strcmp(bench, of) && !strcmp(name, case_name))
            return json_number_value(json_object_get(o, "value"));
    }
    return 0.0;
}

/* How much slower (+1) or faster (-1) a larger value of this unit is; 0: neither. */
static int bench_baseline_sense(const char *unit)
{
    return !strcmp(unit, "ms") || !strcmp(unit, "s") || !strcmp(unit, "us") ? 1
           : strstr(unit, "/s")                                             ? -1
                                                                            : 0;
}

/* Now against then, and for times and rates also as if the machine had had the same ceilings then:
 * slower memory or cores (or a neighbour) show in both, so that a ratio far from 1 is ours. */
static void bench_print_compared(const struct bench *b, const struct bench_row *r)
{
    double then = bench_baseline_value(b->baseline, r->bench, r->name);
    double fma = bench_baseline_value(b->baseline, "ceiling", "fma");
    double triad = bench_baseline_value(b->baseline, "ceiling", "triad");
    if (!(then > 0.0))
        return;
    int sense = strcmp(r->bench, "ceiling") ? bench_baseline_sense(r->unit) : 0;
    fprintf(stderr, "  now/then %.3f", r->value / then);
    if (sense && fma > 0.0 && triad > 0.0)
        fprintf(stderr, " (by FMA %.3f, by triad %.3f)",
                r->value / then * pow(b->fma_gflops / fma, sense),
                r->value / then * pow(b->triad_gbps / triad, sense));
}

static enum err_code bench_baseline_read(const char *path, json_t **out, struct err *e)
{
    struct buf b = {0};
    enum err_code rc = file_read(path, 0, &b, e);
    json_t *lines = rc ? NULL : json_array();
    for (size_t at = 0; lines && at < b.size;) {
        const char *line = (const char *)b.data + at;
        const char *end = memchr(line, '\n', b.size - at);
        size_t n = end ? (size_t)(end - line) : b.size - at;
        json_t *o = n ? json_loadb(line, n, 0, NULL) : NULL;
        if (o)
            json_array_append_new(lines, o);
        at += n + 1;
    }
    buf_free(&b);
    *out = lines;
    return rc;
}

static void bench_print_table(const struct bench *b)
{
    fprintf(stderr, "\n%-10s %-44s %12s %-12s %s\n", "bench", "case", "value", "unit", "ratio");
    for (size_t i = 0; i < b->n_rows; i++) {
        const struct bench_row *r = &b->rows[i];
        fprintf(stderr, "%-10s %-44s %12.4g %-12s", r->bench, r->name, r->value, r->unit);
        if (r->against)
            fprintf(stderr, " %.3g of %s", r->ratio, r->against);
        if (b->baseline)
            bench_print_compared(b, r);
        fputc('\n', stderr);
    }
}

/* What kernels had to do, and what of that binds them. */
static void bench_print_kernels(const struct bench *b)
{
    bool titled = false;
    for (size_t i = 0; i < b->n_rows; i++) {
        const struct bench_row *r = &b->rows[i];
        if (!(r->took_ms > 0.0))
            continue;
        if (!titled)
            fprintf(stderr, "\n%-76s %9s %9s %9s %9s %6s %s\n", "kernel", "MB", "M mul-add",
                    "took, ms", "limit, ms", "times", "bound by");
        titled = true;
        fprintf(stderr, "%-76s %9.4g %9.4g %9.4g %9.4g %6.3g %s\n", r->name, r->need.bytes * 1e-6,
                r->need.multiply_adds * 1e-6, r->took_ms, r->limit.ms, r->ratio,
                r->limit.memory ? "memory" : "arithmetic");
    }
}

static bool bench_wanted(const struct options_args *args, const struct bench_entry *entry)
{
    for (size_t i = 0; i < args->n; i++)
        if (!strcmp(args->arg[i], entry->name))
            return true;
    return args->n == 0 && !entry->only_named;
}

static enum err_code bench_check_names(const struct options_args *args, struct err *e)
{
    for (size_t i = 0; i < args->n; i++) {
        size_t k = 0;
        while (k < ENTRIES && strcmp(entries[k].name, args->arg[i]))
            k++;
        if (k == ENTRIES)
            return err_set(e, ERR_ARG, "no benchmark '%s'; --help lists them", args->arg[i]);
    }
    return ERR_OK;
}

static enum err_code bench_run_all(struct bench *b, const struct options_args *args, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < ENTRIES; i++) {
        /* The ceilings come first whatever was asked: the others are fractions of them. */
        if (i > 0 && !bench_wanted(args, &entries[i]))
            continue;
        b->name = entries[i].name;
        rc = entries[i].run(b, e);
        if (rc)
            err_add(e, "%s", entries[i].name);
    }
    return rc;
}

enum err_code lab_bench(int argc, char **argv, struct err *e)
{
    struct dev dev = {0};
    struct bench b = {0};
    struct bench_config cfg = {0};
    struct options_args args;
    char about[4096] =
        "Runs the named benchmarks, all without a name. JSON lines on stdout, a table on "
        "stderr. Names:";
    for (size_t i = 0; i < ENTRIES; i++)
        snprintf(about + strlen(about), sizeof about - strlen(about), " %s (%s)%s", entries[i].name,
                 entries[i].about, i + 1 < ENTRIES ? "," : ".");
    const struct options_spec spec = {.command = "bench",
                                      .usage = "citysplat-lab bench [NAME...] [options]\n"
                                               "       citysplat-lab NAME... [options]",
                                      .about = about,
                                      .defs = bench_defs,
                                      .n_defs = sizeof bench_defs / sizeof bench_defs[0],
                                      .max_args = 16};
    enum err_code rc = options_parse(&spec, argc, argv, &cfg, &args, &b.arena, e);
    if (rc || args.done)
        goto out;
    b.runs = (int)cfg.runs;
    b.quick = cfg.quick;
    b.scene = cfg.scene;
    b.tiles = cfg.tiles;
    b.trained = cfg.trained ? cfg.trained : cfg.scene;
    b.edge_m = cfg.edge_m;
    b.most = cfg.most;
    b.edge_px = (uint32_t)cfg.edge_px;
    b.round_trip_ms = cfg.round_trip_ms;
    b.record = cfg.record;
    b.dataset = cfg.dataset ? cfg.dataset : "unnamed";
    b.study = cfg.study;
    b.command = cfg.command;
    b.commit = cfg.commit ? cfg.commit : "";
    b.rows = mem_array(BENCH_ROWS_MAX, sizeof *b.rows);
    if (!b.rows)
        rc = err_set(e, ERR_MEM, "out of memory");
    if (!rc)
        rc = bench_check_names(&args, e);
    if (!rc && cfg.compare)
        rc = bench_baseline_read(cfg.compare, &b.baseline, e);
    if (!rc)
        rc = dev_open(cfg.device, &dev, e);
    b.dev = &dev;
    if (!rc)
        log_info("bench", "device name=\"%s\" driver=\"%s\" runs=%d", dev.name, dev.driver, b.runs);
    if (!rc)
        rc = bench_run_all(&b, &args, e);
    if (b.n_rows) {
        bench_print_table(&b);
        bench_print_kernels(&b);
    }
out:
    dev_close(&dev);
    json_decref(b.baseline);
    json_decref(b.lines);
    mem_free(b.rows);
    arena_free(&b.arena);
    if (tmpdir[0] && strcmp(tmpdir, "."))
        file_remove_tree(tmpdir);
    return rc;
}
