/* Charts and tables of recorded runs (lab/study/runs.h). chart_data.c selects and groups the
 * records of a chart, chart_plot.c draws them with gnuplot, chart_table.c writes tables.
 * `citysplat-lab chart` uses it for runs of one's own, `citysplat-lab study-chart` for the studies.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_CHART_H
#define LAB_CHART_H

#include "core/base.h"

enum { CHART_PANELS_MAX = 3, CHART_SERIES_MAX = 16, CHART_TEXT_MAX = 96 };

struct chart_def { /* one chart or table; lab/study/charts.def explains the fields */
    const char *name, *study, *what, *kind, *x, *y, *series, *label, *title;
    const char *columns; /* of a table; NULL for a chart */
};

struct chart_key { /* a row of keys.def; an unknown key has its own name as head */
    const char *key, *head, *axis;
    double scale;
    int decimals, better;
};
struct chart_key chart_find_key(const char *key);
/* Writes the nth part of "a|b|c" to out [CHART_TEXT_MAX]. Returns false if there are fewer parts.
 */
bool chart_part(const char *list, size_t nth, char *out);
/* Writes a number with a prefix: 46392 -> "46 k", 1.2e6 -> "1.2 M". */
void chart_si(double v, char *out, size_t room);

struct chart_point {
    double x, y[CHART_PANELS_MAX]; /* in the scale of their keys; NaN: not measured */
    char label[2 * CHART_TEXT_MAX];
};
struct chart_series {
    char name[CHART_TEXT_MAX];
    struct chart_point *points; /* sorted by x; for bars in the order of the records */
    size_t n;
};
struct chart_data { /* {0} is empty; free with chart_data_free */
    struct chart_series series[CHART_SERIES_MAX];
    size_t n_series, n_panels;
};

/* Returns whether a record belongs to a chart or table. `lines` are all records, for "finest". */
bool chart_takes(const struct chart_def *d, const struct json_t *line, const struct json_t *lines);
/* Selects the records of a chart. Without records n_series is 0. Free *out with chart_data_free.
 * ERR_MEM, ERR_LIMIT. */
enum err_code chart_data_make(const struct chart_def *d, const struct json_t *lines,
                              struct chart_data *out, struct err *e) ERR_USE;
void chart_data_free(struct chart_data *c);

/* Least squares fits of y = a + b x and of log y = log c + k log x, over the points that have both
 * values. The second uses positive points alone. Returns false for fewer than two points. */
struct chart_fit {
    double a, b, c, k;
};
bool chart_fit(const struct chart_series *s, size_t panel, struct chart_fit *out);

/* Draws a chart to DIR/NAME.svg, and with `png` to .png. ERR_NOENT: gnuplot is missing; the message
 * says how to install it. ERR_IO, ERR_MEM. */
enum err_code chart_plot(const struct chart_def *d, const struct chart_data *c, const char *dir,
                         bool png, struct err *e) ERR_USE;

/* Appends a Markdown table of the records. Without records it appends nothing. */
void chart_table(const struct chart_def *d, const struct json_t *lines, struct buf *out);
/* Appends the line that names the source of the numbers. */
void chart_source(const struct chart_def *d, const struct json_t *lines, struct buf *out);

#endif
