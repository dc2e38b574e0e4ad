/* Benchmarks: named, each checks before it times, each figure a median with what it is compared
 * against.
 *
 * A benchmark is a function in bench_NAME.c and a row in benches.def. It calls bench_report once a
 * case: one JSON line on stdout, {"bench","case","value","unit","ratio","against","device"}, growth
 * cases with "gaussians" and "pixels" as well; a table follows at the end. docs/runs/README.md
 * documents the keys. Benchmarks never fail for being slow: a busy neighbour is not a bug.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef BENCH_BENCH_H
#define BENCH_BENCH_H

#include "core/base.h"
#include "core/dev.h"

struct bench {
    const char *name;  /* of the running benchmark */
    struct dev *dev;   /* opened once for all; NULL when there is no device */
    double fma_gflops; /* ceiling of the device, measured in this run */
    double triad_gbps; /* a[i] = b[i] + s * c[i], bytes of all three streams */
    int runs;          /* how often to time each case (median), --runs */
    bool quick;        /* --quick: small sizes, for checking that benchmarks work */
    struct bench_row *rows;
    size_t n_rows;
    struct arena arena;
    struct json_t *baseline; /* --compare FILE, or NULL */
    /* Of the studies `rd` and `pyramid`, NULL when not given: the scene; what was made of it; where
     * rows go. */
    const char *scene, *tiles, *trained, *record;
    double edge_m;                                  /* of `map`: one square alone; 0: all */
    int64_t most;                                   /* Gaussians of `sizes`; 0: all sizes */
    const char *dataset, *study, *command, *commit; /* what rows say of themselves */
    struct json_t *lines;                           /* rows so far, or NULL */
};

/* ratio 0 = none; `against` says what the ratio is to ("DRAM triad", "naive C"), NULL when none. */
void bench_report(struct bench *b, const char *case_name, double value, const char *unit,
                  double ratio, const char *against);
/* A case of a series: value at so many Gaussians and pixels. */
void bench_report_at(struct bench *b, const char *case_name, double value, const char *unit,
                     double gaussians, double pixels);
/* Median of b->runs timed calls of fn (after one that is not counted), in milliseconds of wall
 * time; spread (may be NULL): half the distance between the quartiles. */
enum err_code bench_time(struct bench *b, enum err_code (*fn)(void *user, struct err *e),
                         void *user, double *median_ms, double *spread_ms, struct err *e) ERR_USE;
/* The same by the process's CPU clock: for work of one thread, what a core of its own would take.
 */
enum err_code bench_cpu_time(struct bench *b, enum err_code (*fn)(void *user, struct err *e),
                             void *user, double *median_ms, double *spread_ms,
                             struct err *e) ERR_USE;
/* A row of the study that runs: `numbers` is taken over. Written to b->record, if any, when all are
 * there. */
enum err_code bench_record(struct bench *b, const char *row, const char *what,
                           struct json_t *numbers, struct err *e) ERR_USE;
enum err_code bench_record_write(struct bench *b, struct err *e) ERR_USE; /* forgets the rows */
/* Of bench_step.c: a whole iteration of training n Gaussians of the city (city.h, degree 3) with a
 * photograph of that size, reported by bench_report_at; and those of the growth benchmark. Not
 * checked as bench_step does: the rates of its check suit its own sizes. */
enum err_code bench_step_at(struct bench *b, const char *name, size_t n, uint32_t width_px,
                            uint32_t height_px, struct err *e) ERR_USE;
enum err_code bench_step_growth(struct bench *b, struct err *e) ERR_USE;
/* A path for scratch files of this run; removed at exit. */
const char *bench_tmpdir(struct bench *b);

#define BENCH(name, about) enum err_code bench_##name(struct bench *b, struct err *e) ERR_USE;
#define BENCH_LONG(name, about) BENCH(name, about)
#include "bench/benches.def"
#undef BENCH_LONG
#undef BENCH

#endif
