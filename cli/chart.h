/* Charts and tables of recorded runs (cli/runs.h): chart_data.c picks and groups the records of a
 * chart, chart_plot.c has gnuplot draw them, chart_table.c writes tables. `citysplat chart` draws
 * a user's own runs with it, `citysplat-study chart` (studies/study_chart.c) the studies of docs/.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_CHART_H
#define CLI_CHART_H

#include "core/base.h"

enum { CHART_PANELS_MAX = 3, CHART_SERIES_MAX = 16, CHART_TEXT_MAX = 96 };

struct chart_def { /* one chart or table; the fields are explained in studies/charts.def */
    const char *name, *study, *what, *kind, *x, *y, *series, *label, *title;
    const char *columns; /* of a table; NULL for a chart */
};

struct chart_key { /* of keys.def; unknown keys get a head of their own name */
    const char *key, *head, *axis;
    double scale;
    int decimals, better;
};
struct chart_key chart_find_key(const char *key);
/* The nth part of "a|b|c" into `out` (CHART_TEXT_MAX bytes); false when there are fewer. */
bool chart_part(const char *list, size_t nth, char *out);
/* 46392 -> "46 k", 1.2e6 -> "1.2 M". */
void chart_si(double v, char *out, size_t room);

struct chart_point {
    double x, y[CHART_PANELS_MAX]; /* scaled by their keys; NaN: not measured */
    char label[2 * CHART_TEXT_MAX];
};
struct chart_series {
    char name[CHART_TEXT_MAX];
    struct chart_point *points; /* in the order of x; of bars in the order of the records */
    size_t n;
};
struct chart_data { /* {0} is empty */
    struct chart_series series[CHART_SERIES_MAX];
    size_t n_series, n_panels;
};

/* Does the record belong to the chart or table? `lines` are all records: "finest" looks around. */
bool chart_takes(const struct chart_def *d, const struct json_t *line, const struct json_t *lines);
/* Pick the records of a chart. No record: n_series is 0. chart_data_free. */
enum err_code chart_data_make(const struct chart_def *d, const struct json_t *lines,
                              struct chart_data *out, struct err *e) ERR_USE;
void chart_data_free(struct chart_data *c);

/* Least squares of y = a + b x and of log y = log c + k log x over points that have both (positive
 * ones for the second). false with fewer than two. */
struct chart_fit {
    double a, b, c, k;
};
bool chart_fit(const struct chart_series *s, size_t panel, struct chart_fit *out);

/* Draw to DIR/NAME.svg (and .png). ERR_NOENT tells how to install gnuplot when there is none. */
enum err_code chart_plot(const struct chart_def *d, const struct chart_data *c, const char *dir,
                         bool png, struct err *e) ERR_USE;

/* Append a table of the records as Markdown; nothing when there are none. */
void chart_table(const struct chart_def *d, const struct json_t *lines, struct buf *out);
/* Append the line that says where the numbers come from. */
void chart_source(const struct chart_def *d, const struct json_t *lines, struct buf *out);

#endif
