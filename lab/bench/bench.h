/* Benchmarks. Each has a name, checks its results before it measures time, and gives medians and a
 * value to compare with.
 *
 * A benchmark is a function in bench_NAME.c and a row in benches.def. For each case it calls
 * bench_report, which prints one JSON line on stdout:
 * {"bench","case","value","unit","ratio","against","device"}. Cases of a series also have
 * "gaussians" and "pixels", and kernels what they had to do (bench_report_kernel). A table follows
 * at the end. lab/runs/README.md explains the keys. A
 * benchmark never fails because it is slow: other work on the machine is not a bug.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_BENCH_H
#define LAB_BENCH_H

#include "core/base.h"
#include "core/device/dev.h"
#include "lab/bench/roofline.h"

struct bench {
    const char *name;  /* of the running benchmark */
    struct dev *dev;   /* opened once for all benchmarks; NULL: there is no device */
    double fma_gflops; /* measured in this run: the device's peak of arithmetic */
    /* measured in this run: memory bandwidth of a[i] = b[i] + s * c[i], counting the bytes of all
     * three arrays */
    double triad_gbps;
    int runs;   /* --runs: timed repetitions of each case, of which the median counts */
    bool quick; /* --quick: small sizes, to check that benchmarks work */
    struct bench_row *rows;
    size_t n_rows;
    struct arena arena;
    struct json_t *baseline; /* --compare FILE, or NULL */
    /* For the studies `rd` and `pyramid`: the scene, its store, its checkpoints, and the file for
     * rows. NULL: not given. */
    const char *scene, *tiles, *trained, *record;
    double edge_m; /* for `map`: edge of the only square to draw; 0: all sizes */
    int64_t most;  /* for `sizes`: largest number of Gaussians; 0: no limit; for `tour`: number */
    uint32_t edge_px;     /* for `tour`: longest edge of its pictures; 0: of the photographs */
    double round_trip_ms; /* for `motion`: the only one; below 0: all */
    const char *dataset, *study, *command, *commit; /* members of every row */
    struct json_t *lines;                           /* rows so far, or NULL */
};

/* Reports a case. `ratio` is value over `against` ("DRAM triad", "naive C"). 0 and NULL: none. */
void bench_report(struct bench *b, const char *case_name, double value, const char *unit,
                  double ratio, const char *against);
struct bench_kernel {
    double ms;             /* by the device's clock */
    double took_ms, ratio; /* processor time over the cores; over limit.ms */
    struct roofline_need need;
    struct roofline_limit limit;
};
/* As bench_report_at, for a kernel in its launches of a step. value is k->ms. Adds "took_ms",
 * "bytes", "multiply_adds", "limit_ms" and "bound" to the line, and a row to a table of its own. */
void bench_report_kernel(struct bench *b, const char *case_name, const struct bench_kernel *k,
                         double gaussians, double pixels);
/* Reports a case of a series, for so many Gaussians and pixels. */
void bench_report_at(struct bench *b, const char *case_name, double value, const char *unit,
                     double gaussians, double pixels);
/* In bench_ceiling.c: both ceilings now, the best of a few runs. On CPUs in processor time of all
 * cores, as if no other program took a part of it. bench_ceilings_open allocates its arrays.
 * ERR_MEM, ERR_LIMIT, ERR_DEVICE. */
struct bench_ceilings {
    double fma_gflops, triad_gbps;
};
struct ceiling;
enum err_code bench_ceilings_open(struct bench *b, struct ceiling **out, struct err *e) ERR_USE;
enum err_code bench_ceilings(struct bench *b, struct ceiling *t, struct bench_ceilings *out,
                             struct err *e) ERR_USE;
void bench_ceilings_close(struct ceiling **t);
/* Cores that the device's kernels run on; 1 on a GPU. */
unsigned bench_cores(const struct bench *b);
/* Calls fn once and then b->runs times, and gives the median time of these b->runs calls in
 * milliseconds of wall time. spread (may be NULL): half the distance between the quartiles. Errors
 * of fn, ERR_MEM. */
enum err_code bench_time(struct bench *b, enum err_code (*fn)(void *user, struct err *e),
                         void *user, double *median_ms, double *spread_ms, struct err *e) ERR_USE;
/* As bench_time, in the CPU time of the process. For work in one thread this is its time on a free
 * core. */
enum err_code bench_cpu_time(struct bench *b, enum err_code (*fn)(void *user, struct err *e),
                             void *user, double *median_ms, double *spread_ms,
                             struct err *e) ERR_USE;
/* Adds a row to the study. It takes over the reference to `numbers`. ERR_MEM. */
enum err_code bench_record(struct bench *b, const char *row, const char *what,
                           struct json_t *numbers, struct err *e) ERR_USE;
/* writes all rows to b->record (NULL: nowhere) and forgets them */
enum err_code bench_record_write(struct bench *b, struct err *e) ERR_USE;
/* In bench_step.c. bench_step_at measures one training iteration of n Gaussians of the city
 * (city.h, SH of degree 3) with a photograph of that size, bench_step_growth a series for the
 * growth benchmark. Both report with bench_report_at. They skip the check of bench_step, whose
 * learning rates suit only its own sizes. */
enum err_code bench_step_at(struct bench *b, const char *name, size_t n, uint32_t width_px,
                            uint32_t height_px, struct err *e) ERR_USE;
enum err_code bench_step_growth(struct bench *b, struct err *e) ERR_USE;
/* A folder for scratch files of this run. It is removed at exit. */
const char *bench_tmpdir(struct bench *b);

#define BENCH(name, about) enum err_code bench_##name(struct bench *b, struct err *e) ERR_USE;
#define BENCH_LONG(name, about) BENCH(name, about)
#include "lab/benches.def"
#undef BENCH_LONG
#undef BENCH

#endif
