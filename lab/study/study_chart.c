/* citysplat-lab study-chart: makes every chart and table of the studies from recorded runs.
 *
 * The Markdown file keeps its text. Only what stands between `<!-- chart NAME -->` or `<!-- table
 * NAME -->` and `<!-- end -->` is replaced.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jansson.h>

#include "core/options/options.h"
#include "lab/lab.h"
#include "lab/study/chart.h"
#include "lab/study/runs.h"
#include "lab/study/study.h"

struct chart_options {
#define OPT OPTIONS_MEMBER
#include "lab/study/study_chart.def"
};

static const struct options_def chart_option_defs[] = {
#define OPT(...) OPTIONS_ROW(struct chart_options, __VA_ARGS__)
#include "lab/study/study_chart.def"
};

static const struct chart_def chart_defs[] = {
#define CHART(name, study, what, kind, x, y, series, label, title)                                 \
    {#name, study, what, kind, x, y, series, label, title, NULL},
#define TABLE(name, study, what, columns) {#name, study, what, "", "", "", "", "", "", columns},
#include "lab/study/charts.def"
#undef CHART
#undef TABLE
};
static const size_t chart_n_defs = sizeof chart_defs / sizeof *chart_defs;

static const struct chart_peer {
    const char *chart, *name;
    double x, y;
} chart_peers[] = {
#define PEER(chart, name, x, y) {#chart, name, x, y},
#include "lab/study/peers.def"
#undef PEER
};

struct chart_run {
    struct chart_options o;
    json_t *lines;             /* of all files */
    const char *page;          /* the Markdown file in work */
    char link[FILE_PATH_MAX];  /* folder of the charts as seen from it */
    size_t n_drawn, n_missing; /* charts */
    struct arena arena;
};

/* ---- recorded runs ---- */

static enum err_code chart_read_file(struct chart_run *r, const char *path, struct err *e)
{
    json_t *lines = NULL;
    enum err_code rc = runs_read(path, &lines, e);
    if (!rc && json_array_extend(r->lines, lines))
        rc = err_set(e, ERR_MEM, "chart: out of memory");
    json_decref(lines);
    return rc;
}

static enum err_code chart_read(struct chart_run *r, const char *path, struct err *e)
{
    static const char *const suffixes[] = {".jsonl", NULL};
    char file[FILE_PATH_MAX], **names = NULL;
    size_t n = 0;
    if (!file_is_dir(path))
        return chart_read_file(r, path, e);
    enum err_code rc = file_list(path, suffixes, &r->arena, &names, &n, e);
    for (size_t i = 0; !rc && i < n; i++) {
        rc = file_join(file, path, names[i], e);
        if (!rc)
            rc = chart_read_file(r, file, e);
    }
    if (!rc && !n)
        rc = err_set(e, ERR_NOENT, "%s: no recorded runs (*.jsonl); lab/study.sh makes them", path);
    return rc;
}

/* Refuse records that nobody can repeat or that say less than their study states, and make the
 * seeds of a row one record. What lies in no repository has no history to be in. */
static enum err_code chart_take(struct chart_run *r, const char *path, struct err *e)
{
    char dir[FILE_PATH_MAX];
    json_t *merged = NULL;
    snprintf(dir, sizeof dir, "%s", path);
    if (!file_is_dir(dir)) {
        char *slash = strrchr(dir, '/');
        snprintf(slash ? slash + 1 : dir, 2, "%s", slash ? "" : ".");
    }
    enum study_history history = study_history(dir);
    if (history == STUDY_HISTORY_SHALLOW)
        log_warn("chart", "%s: commits of records are not checked: the clone is shallow", dir);
    enum err_code rc = study_check(r->lines, history == STUDY_HISTORY_WHOLE ? dir : NULL, e);
    if (!rc)
        rc = study_merge_seeds(r->lines, &merged, e);
    if (rc)
        return rc;
    json_decref(r->lines);
    r->lines = merged;
    return ERR_OK;
}

/* ---- charts ---- */

/* Points of other programs, a line of one point each. */
static enum err_code chart_add_peers(const struct chart_def *d, struct chart_data *data,
                                     struct err *e)
{
    for (size_t i = 0; i < sizeof chart_peers / sizeof *chart_peers; i++) {
        const struct chart_peer *p = &chart_peers[i];
        if (strcmp(p->chart, d->name))
            continue;
        if (data->n_series == CHART_SERIES_MAX)
            return err_set(e, ERR_LIMIT, "chart %s: too many lines", d->name);
        struct chart_series *s = &data->series[data->n_series];
        s->points = mem_array(1, sizeof *s->points);
        if (!s->points)
            return err_set(e, ERR_MEM, "chart %s: out of memory", d->name);
        data->n_series++;
        s->n = 1;
        snprintf(s->name, sizeof s->name, "%s", p->name);
        s->points[0] = (struct chart_point){.x = p->x, .y = {p->y, (double)NAN, (double)NAN}};
    }
    return ERR_OK;
}

static enum err_code chart_draw(struct chart_run *r, const struct chart_def *d, struct err *e)
{
    struct chart_data data = {0};
    enum err_code rc = chart_data_make(d, r->lines, &data, e);
    if (!rc && data.n_series)
        rc = chart_add_peers(d, &data, e);
    if (!rc && data.n_series)
        rc = chart_plot(d, &data, r->o.output, r->o.png, e);
    if (!rc && data.n_series) {
        printf("%s/%s.svg\n", r->o.output, d->name);
        r->n_drawn++;
    } else if (!rc) {
        r->n_missing++;
    }
    chart_data_free(&data);
    return rc;
}

static const struct chart_def *chart_find(const char *name, bool table)
{
    for (size_t i = 0; i < chart_n_defs; i++)
        if (!strcmp(chart_defs[i].name, name) && (chart_defs[i].columns != NULL) == table)
            return &chart_defs[i];
    return NULL;
}

static enum err_code chart_draw_all(struct chart_run *r, struct err *e)
{
    enum err_code rc = file_mkdir(r->o.output, e);
    if (r->o.only && !chart_find(r->o.only, false))
        return err_set(e, ERR_ARG, "--only %s: no such chart; lab/study/charts.def lists them",
                       r->o.only);
    for (size_t i = 0; !rc && i < chart_n_defs; i++)
        if (!chart_defs[i].columns && (!r->o.only || !strcmp(r->o.only, chart_defs[i].name)))
            rc = chart_draw(r, &chart_defs[i], e);
    return rc;
}

/* ---- Markdown ---- */

/* The path of `dir` seen from the folder of the file `from`, both absolute. */
static void chart_relative(const char *dir, const char *from, char *out, size_t room)
{
    size_t same = 0, n = 0;
    for (size_t i = 0; dir[i] && dir[i] == from[i]; i++)
        if (dir[i] == '/')
            same = i + 1;
    if (!strncmp(dir, from, strlen(dir)) && from[strlen(dir)] == '/')
        same = strlen(dir) + 1; /* the file lies in or below the folder of the charts */
    out[0] = '\0';
    for (const char *s = from + same; (s = strchr(s, '/')) && n + 4 < room; s++)
        n += (size_t)snprintf(out + n, room - n, "../");
    snprintf(out + n, room - n, "%s", same <= strlen(dir) ? dir + same : "");
}

static enum err_code chart_make_link(struct chart_run *r, struct err *e)
{
    char dir[PATH_MAX], file[PATH_MAX];
    if (!realpath(r->o.output, dir))
        return err_errno(e, ERR_IO, "%s", r->o.output);
    if (!realpath(r->page, file))
        return err_errno(e, ERR_NOENT, "%s", r->page);
    chart_relative(dir, file, r->link, sizeof r->link);
    return ERR_OK;
}

static bool chart_has_records(const struct chart_run *r, const struct chart_def *d)
{
    size_t i;
    json_t *line;
    json_array_foreach(r->lines, i, line)
    {
        if (chart_takes(d, line, r->lines))
            return true;
    }
    return false;
}

static void chart_write_block(const struct chart_run *r, const struct chart_def *d, struct buf *out)
{
    if (!chart_has_records(r, d)) {
        buf_printf(out, "*Not recorded: `lab/study.sh %.*s` does.*\n", (int)strcspn(d->study, "/"),
                   d->study);
    } else if (d->columns) {
        buf_u8(out, '\n');
        chart_table(d, r->lines, out);
        buf_u8(out, '\n');
        chart_source(d, r->lines, out);
    } else {
        buf_printf(out, "![%s](%s%s%s.svg)\n", d->title, r->link, *r->link ? "/" : "", d->name);
    }
}

/* A line that opens a block: its chart or table into *d. ERR_FORMAT for a name that is none. */
static enum err_code chart_open_block(const char *line, size_t n, const struct chart_def **d,
                                      struct err *e)
{
    char text[CHART_TEXT_MAX + 32], kind[8] = "", name[CHART_TEXT_MAX] = "";
    *d = NULL;
    if (n >= sizeof text)
        return ERR_OK;
    snprintf(text, sizeof text, "%.*s", (int)n, line);
    if (sscanf(text, "<!-- %7s %95s -->", kind, name) != 2 ||
        (strcmp(kind, "chart") && strcmp(kind, "table")))
        return ERR_OK;
    *d = chart_find(name, !strcmp(kind, "table"));
    return *d ? ERR_OK
              : err_set(e, ERR_FORMAT, "no %s is called '%s'; lab/study/charts.def lists them",
                        kind, name);
}

static enum err_code chart_rewrite(const struct chart_run *r, const struct buf *in, struct buf *out,
                                   struct err *e)
{
    static const char end_mark[] = "<!-- end -->";
    const struct chart_def *open = NULL, *d = NULL;
    size_t number = 0;
    for (size_t at = 0; at < in->size;) {
        const char *line = (const char *)in->data + at;
        const char *end = memchr(line, '\n', in->size - at);
        size_t n = end ? (size_t)(end - line) : in->size - at;
        bool closes = n == sizeof end_mark - 1 && !memcmp(line, end_mark, n);
        number++;
        at += n + 1;
        enum err_code rc = chart_open_block(line, n, &d, e);
        if (!rc && d && open)
            rc = err_set(e, ERR_FORMAT, "'%s' is not closed by %s", open->name, end_mark);
        if (rc)
            return err_add(e, "%s, line %zu", r->page, number);
        if (open && !closes)
            continue;
        if (open)
            chart_write_block(r, open, out);
        open = d;
        buf_add(out, line, n);
        buf_u8(out, '\n');
    }
    if (open)
        return err_set(e, ERR_FORMAT, "%s: '%s' is not closed by %s", r->page, open->name,
                       end_mark);
    return buf_check(out, e);
}

static enum err_code chart_write_page(struct chart_run *r, const char *path, struct err *e)
{
    struct buf in = {0}, out = {0};
    r->page = path;
    enum err_code rc = chart_make_link(r, e);
    if (!rc)
        rc = file_read(path, 0, &in, e);
    if (!rc)
        rc = chart_rewrite(r, &in, &out, e);
    if (!rc && r->o.check && (in.size != out.size || memcmp(in.data, out.data, in.size)))
        rc = err_set(e, ERR_DATA,
                     "%s: a table says something else than the records: `citysplat-lab study-chart "
                     "--markdown` writes it anew",
                     path);
    else if (!rc && !r->o.check)
        rc = file_write(path, out.data, out.size, e);
    buf_free(&in);
    buf_free(&out);
    return rc;
}

/* A page, or all pages of a folder. */
static enum err_code chart_write_markdown(struct chart_run *r, struct err *e)
{
    static const char *const suffixes[] = {".md", NULL};
    char file[FILE_PATH_MAX], **names = NULL;
    size_t n = 0;
    if (!file_is_dir(r->o.markdown))
        return chart_write_page(r, r->o.markdown, e);
    enum err_code rc = file_list(r->o.markdown, suffixes, &r->arena, &names, &n, e);
    for (size_t i = 0; !rc && i < n; i++) {
        rc = file_join(file, r->o.markdown, names[i], e);
        if (!rc)
            rc = chart_write_page(r, file, e);
    }
    return rc;
}

/* ---- the command ---- */

enum err_code lab_study_chart(int argc, char **argv, struct err *e)
{
    const struct options_spec spec = {
        .command = "study-chart",
        .usage = "citysplat-lab study-chart RUNS... -o DIR [options]",
        .about = "Draws the charts of recorded runs (folders or files of JSON lines, which "
                 "lab/study.sh and `citysplat-lab study-record` write) with gnuplot, as SVG and "
                 "PNG, and rewrites the tables of Markdown files. Records are refused that are "
                 "shorter or of fewer seeds than lab/study/studies.def states for their study, and "
                 "those whose commit is not in the history of HEAD.",
        .example = "citysplat-lab study-chart lab/runs -o lab/charts --markdown lab/studies",
        .defs = chart_option_defs,
        .n_defs = sizeof chart_option_defs / sizeof *chart_option_defs,
        .min_args = 1,
        .max_args = 16};
    struct chart_run r = {0};
    struct options_args args;
    enum err_code rc = options_parse(&spec, argc, argv, &r.o, &args, &r.arena, e);
    if (rc || args.done)
        goto out;
    if (!r.o.output)
        rc = err_set(e, ERR_ARG, "chart: -o DIR is required");
    if (!rc && !(r.lines = json_array()))
        rc = err_set(e, ERR_MEM, "chart: out of memory");
    for (size_t i = 0; !rc && i < args.n; i++)
        rc = chart_read(&r, args.arg[i], e);
    if (!rc)
        rc = chart_take(&r, args.arg[0], e);
    if (!rc && !r.o.check)
        rc = chart_draw_all(&r, e);
    if (!rc && r.o.markdown)
        rc = chart_write_markdown(&r, e);
    if (!rc && r.n_missing)
        log_info("chart", "drawn=%zu not_recorded=%zu", r.n_drawn, r.n_missing);
out:
    json_decref(r.lines);
    arena_free(&r.arena);
    return rc;
}
