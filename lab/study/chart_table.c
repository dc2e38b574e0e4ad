/* Tables of recorded runs as Markdown, with the source of their numbers.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include <jansson.h>

#include "lab/study/chart.h"
#include "lab/study/runs.h"

enum { TABLE_COLUMNS_MAX = 24 };

static bool table_is_text(const char *key)
{
    return !strcmp(key, "row") || !strcmp(key, "what") || !strcmp(key, "dataset") ||
           !strcmp(key, "gain");
}

/* Text for a cell: what would end the cell or begin markup is left out. */
static void table_text(const char *s, struct buf *out)
{
    for (; *s; s++)
        if ((unsigned char)*s >= 0x20 && !strchr("|<>`", *s))
            buf_u8(out, (unsigned char)*s);
}

static void table_cell(const json_t *line, const char *key, struct buf *out)
{
    if (table_is_text(key)) {
        const char *text = runs_text(line, key);
        table_text(*text ? text : "–", out);
        return;
    }
    struct chart_key k = chart_find_key(key);
    double v = runs_number(line, key) * k.scale;
    if (isfinite(v))
        buf_printf(out, "%.*f", k.decimals, v);
    else
        buf_printf(out, "–");
}

/* A column is shown when a record has something in it. */
static bool table_is_used(const struct chart_def *d, const json_t *lines, const char *key)
{
    size_t i;
    json_t *line;
    json_array_foreach(lines, i, line)
    {
        if (chart_takes(d, line, lines) &&
            (table_is_text(key) ? *runs_text(line, key) != '\0' : isfinite(runs_number(line, key))))
            return true;
    }
    return false;
}

void chart_table(const struct chart_def *d, const json_t *lines, struct buf *out)
{
    char columns[TABLE_COLUMNS_MAX][CHART_TEXT_MAX], key[CHART_TEXT_MAX];
    size_t n = 0, i;
    json_t *line;
    for (i = 0; n < TABLE_COLUMNS_MAX && chart_part(d->columns, i, key); i++)
        if (table_is_used(d, lines, key))
            memcpy(columns[n++], key, sizeof key);
    if (!n)
        return;
    for (i = 0; i < n; i++)
        buf_printf(out, "| %s ",
                   !strcmp(columns[i], "row") ? "run" : chart_find_key(columns[i]).head);
    buf_printf(out, "|\n");
    for (i = 0; i < n; i++)
        buf_printf(out, table_is_text(columns[i]) ? "|---" : "|---:");
    buf_printf(out, "|\n");
    json_array_foreach(lines, i, line)
    {
        if (!chart_takes(d, line, lines))
            continue;
        for (size_t k = 0; k < n; k++) {
            buf_printf(out, "| ");
            table_cell(line, columns[k], out);
            buf_u8(out, ' ');
        }
        buf_printf(out, "|\n");
    }
}

/* The distinct texts of a member, in order of appearance. */
static void table_distinct(const struct chart_def *d, const json_t *lines, const char *key,
                           struct buf *out)
{
    size_t i, j, n = 0;
    json_t *line;
    json_array_foreach(lines, i, line)
    {
        const char *text = runs_text(line, key);
        bool seen = !*text || !chart_takes(d, line, lines);
        for (j = 0; j < i && !seen; j++) {
            const json_t *before = json_array_get(lines, j);
            seen = chart_takes(d, before, lines) && !strcmp(runs_text(before, key), text);
        }
        if (seen)
            continue;
        if (n++)
            buf_printf(out, "; ");
        table_text(text, out);
    }
}

/* Least and most of `key`; a line of several runs has its own most, KEY_most. */
static void table_range(const struct chart_def *d, const json_t *lines, const char *key,
                        const char *name, const char *unit, struct buf *out)
{
    double lo = HUGE_VAL, hi = -HUGE_VAL;
    char most[64];
    size_t i;
    snprintf(most, sizeof most, "%s_most", key);
    json_t *line;
    json_array_foreach(lines, i, line)
    {
        double v = runs_number(line, key);
        if (chart_takes(d, line, lines) && isfinite(v)) {
            double top = runs_number(line, most);
            lo = fmin(lo, v);
            hi = fmax(hi, isfinite(top) ? top : v);
        }
    }
    if (lo < hi)
        buf_printf(out, ", %s %.0f to %.0f %s", name, lo, hi, unit);
    else if (lo <= hi)
        buf_printf(out, ", %s %.0f %s", name, lo, unit);
}

void chart_source(const struct chart_def *d, const json_t *lines, struct buf *out)
{
    buf_printf(out, "<sub>");
    table_distinct(d, lines, "dataset", out);
    buf_printf(out, ". `lab/study.sh %.*s`, commit ", (int)strcspn(d->study, "/"), d->study);
    table_distinct(d, lines, "commit", out);
    const size_t before = out->size;
    buf_printf(out, ", on ");
    const size_t begun = out->size;
    table_distinct(d, lines, "device", out);
    if (out->size == begun) /* no device drew, or none is told */
        out->size = before;
    table_range(d, lines, "fma_gflops", "FMA", "GFLOP/s", out);
    table_range(d, lines, "triad_gbps", "triad", "GB/s", out);
    buf_printf(out, ".</sub>\n");
}
