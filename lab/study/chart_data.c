/* Selects the records of a chart and groups them into series.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jansson.h>

#include "lab/study/chart.h"
#include "lab/study/runs.h"

static const struct chart_key chart_keys[] = {
#define KEY(key, head, axis, scale, decimals, better) {#key, head, axis, scale, decimals, better},
#include "lab/study/keys.def"
#undef KEY
};

static const char chart_no_lod[] = "tiles, no LOD";

struct chart_key chart_find_key(const char *key)
{
    for (size_t i = 0; i < sizeof chart_keys / sizeof *chart_keys; i++)
        if (!strcmp(chart_keys[i].key, key))
            return chart_keys[i];
    return (struct chart_key){key, key, key, 1.0, 3, 0};
}

bool chart_part(const char *list, size_t nth, char *out)
{
    for (; nth; nth--) {
        list = strchr(list, '|');
        if (!list)
            return false;
        list++;
    }
    snprintf(out, CHART_TEXT_MAX, "%.*s", (int)strcspn(list, "|"), list);
    return *out != '\0';
}

void chart_si(double v, char *out, size_t room)
{
    double size = fabs(v);
    if (size >= 999.5e3)
        snprintf(out, room, size < 10e6 ? "%.1f M" : "%.0f M", v / 1e6);
    else if (size >= 1e3)
        snprintf(out, room, size < 10e3 ? "%.1f k" : "%.0f k", v / 1e3);
    else
        snprintf(out, room, "%.3g", v);
}

static bool chart_same_row(const json_t *a, const json_t *b)
{
    return !strcmp(runs_text(a, "study"), runs_text(b, "study")) &&
           !strcmp(runs_text(a, "row"), runs_text(b, "row"));
}

/* "level 3" and "level 3, half image" are scored against photographs; "level 3, surface" and map
 * views are not. */
static bool chart_of_photographs(const json_t *line)
{
    const char *what = runs_text(line, "what"), *rest = strchr(what, ',');
    return !strncmp(what, "level ", 6) && (!rest || !strcmp(rest, ", half image"));
}

bool chart_takes(const struct chart_def *d, const json_t *line, const json_t *lines)
{
    size_t i;
    json_t *other;
    size_t n = strcspn(d->study, "/");
    const char *study = runs_text(line, "study"), *group = d->study + n + (d->study[n] == '/');
    if (strlen(study) != n || strncmp(study, d->study, n) ||
        strncmp(runs_text(line, "row"), group, strlen(group)))
        return false;
    if (*d->what &&
        !strstr(d->what, "half image") != !strstr(runs_text(line, "what"), "half image"))
        return false;
    if (strncmp(d->what, "finest", 6))
        return !strncmp(runs_text(line, "what"), d->what, strlen(d->what));
    double level = runs_number(line, "level");
    if (!(level > 0.0) || !chart_of_photographs(line))
        return false;
    json_array_foreach(lines, i, other)
    {
        if (chart_same_row(line, other) && runs_number(other, "level") > level)
            return false;
    }
    return true;
}

static double chart_scaled(const json_t *line, const char *key)
{
    return runs_number(line, key) * chart_find_key(key).scale;
}

/* The row's name without its group: "edge: 20 m" -> "20 m". */
static const char *chart_row_name(const json_t *line)
{
    const char *row = runs_text(line, "row"), *colon = strchr(row, ':');
    return colon ? colon + 1 + strspn(colon + 1, " ") : row;
}

static void chart_label(const struct chart_def *d, const json_t *line, char *out, size_t room)
{
    char part[CHART_TEXT_MAX], text[CHART_TEXT_MAX];
    size_t n = 0;
    out[0] = '\0';
    for (size_t i = 0; chart_part(d->label, i, part); i++) {
        if (!strcmp(part, "row"))
            snprintf(text, sizeof text, "%s", chart_row_name(line));
        else
            chart_si(runs_number(line, part), text, sizeof text);
        int k = snprintf(out + n, room - n, "%s%s", i ? ", " : "", text);
        if (k < 0 || (size_t)k >= room - n)
            return;
        n += (size_t)k;
    }
}

static void chart_series_name(const struct chart_def *d, const json_t *line, char *out)
{
    const char *row = runs_text(line, "row");
    if (!strcmp(d->series, "group"))
        snprintf(out, CHART_TEXT_MAX, "%.*s", (int)strcspn(row, ":"), row);
    else
        snprintf(out, CHART_TEXT_MAX, "%s", runs_text(line, d->series));
}

/* The series of that name, made when it is new; NULL when there are too many or memory is out. */
static struct chart_series *chart_series_of(struct chart_data *c, const char *name, size_t most)
{
    for (size_t i = 0; i < c->n_series; i++)
        if (!strcmp(c->series[i].name, name))
            return &c->series[i];
    if (c->n_series == CHART_SERIES_MAX)
        return NULL;
    struct chart_series *s = &c->series[c->n_series];
    s->points = mem_array(most, sizeof *s->points);
    if (!s->points)
        return NULL;
    snprintf(s->name, sizeof s->name, "%s", name);
    c->n_series++;
    return s;
}

static void chart_values(const struct chart_def *d, const struct chart_data *c, const json_t *line,
                         struct chart_point *p)
{
    char key[CHART_TEXT_MAX];
    p->x = *d->x ? chart_scaled(line, d->x) : 0.0;
    for (size_t k = 0; k < c->n_panels && chart_part(d->y, k, key); k++)
        p->y[k] = chart_scaled(line, key);
}

static int chart_compare_x(const void *a, const void *b)
{
    const struct chart_point *p = a, *q = b;
    return (p->x > q->x) - (p->x < q->x);
}

/* Bars show differences: take the row "full" away from all others. */
static enum err_code chart_subtract_full(const struct chart_def *d, struct chart_data *c,
                                         struct err *e)
{
    struct chart_series *s = &c->series[0];
    size_t full = 0, n = 0;
    while (full < s->n && strcmp(s->points[full].label, "full"))
        full++;
    if (full == s->n)
        return err_set(e, ERR_DATA, "chart %s: study '%s' has no row 'full' to compare with",
                       d->name, d->study);
    const struct chart_point base = s->points[full];
    for (size_t i = 0; i < s->n; i++) {
        if (i == full)
            continue;
        struct chart_point p = s->points[i];
        for (size_t k = 0; k < c->n_panels; k++)
            p.y[k] -= base.y[k];
        s->points[n++] = p;
    }
    s->n = n;
    return ERR_OK;
}

/* The mean of all scores without LOD as one point: what there is to lose. */
static enum err_code chart_add_reference(const struct chart_def *d, const json_t *lines,
                                         struct chart_data *c, struct err *e)
{
    size_t i;
    json_t *line;
    double n = 0.0;
    struct chart_point sum = {0}, p = {0};
    json_array_foreach(lines, i, line)
    {
        if (strcmp(runs_text(line, "study"), d->study) ||
            strcmp(runs_text(line, "what"), chart_no_lod))
            continue;
        chart_values(d, c, line, &p);
        sum.x += p.x;
        for (size_t k = 0; k < c->n_panels; k++)
            sum.y[k] += p.y[k];
        n += 1.0;
    }
    if (!(n > 0.0))
        return ERR_OK;
    struct chart_series *s = chart_series_of(c, "no level of detail", 1);
    if (!s)
        return err_set(e, ERR_LIMIT, "chart %s: too many lines", d->name);
    sum.x /= n;
    for (size_t k = 0; k < c->n_panels; k++)
        sum.y[k] /= n;
    s->points[s->n++] = sum;
    return ERR_OK;
}

enum err_code chart_data_make(const struct chart_def *d, const json_t *lines,
                              struct chart_data *out, struct err *e)
{
    char key[CHART_TEXT_MAX], name[CHART_TEXT_MAX] = "";
    bool bars = !strncmp(d->kind, "bars", 4);
    enum err_code rc = ERR_OK;
    size_t i;
    json_t *line;
    *out = (struct chart_data){0};
    while (out->n_panels < CHART_PANELS_MAX && chart_part(d->y, out->n_panels, key))
        out->n_panels++;
    json_array_foreach(lines, i, line)
    {
        if (rc || !chart_takes(d, line, lines))
            continue;
        if (!bars)
            chart_series_name(d, line, name);
        struct chart_series *s = chart_series_of(out, name, json_array_size(lines));
        if (!s) {
            rc = err_set(e, ERR_LIMIT, "chart %s: more than %d lines, or out of memory", d->name,
                         CHART_SERIES_MAX);
            continue;
        }
        struct chart_point *p = &s->points[s->n++];
        chart_values(d, out, line, p);
        if (bars)
            snprintf(p->label, sizeof p->label, "%s", chart_row_name(line));
        else
            chart_label(d, line, p->label, sizeof p->label);
    }
    if (!rc && bars && out->n_series)
        rc = chart_subtract_full(d, out, e);
    for (size_t k = 0; k < out->n_series && !bars; k++)
        qsort(out->series[k].points, out->series[k].n, sizeof *out->series[k].points,
              chart_compare_x);
    if (!rc && strchr(d->kind, '+') && out->n_series)
        rc = chart_add_reference(d, lines, out, e);
    if (rc)
        chart_data_free(out);
    return rc;
}

void chart_data_free(struct chart_data *c)
{
    for (size_t i = 0; i < c->n_series; i++)
        mem_free(c->series[i].points);
    *c = (struct chart_data){0};
}

/* Least squares of a line through n points; false when they do not define one. */
static bool chart_line(const double *x, const double *y, size_t n, double *a, double *b)
{
    double mx = 0, my = 0, sxx = 0, sxy = 0;
    for (size_t i = 0; i < n; i++) {
        mx += x[i] / (double)n;
        my += y[i] / (double)n;
    }
    for (size_t i = 0; i < n; i++) {
        sxx += (x[i] - mx) * (x[i] - mx);
        sxy += (x[i] - mx) * (y[i] - my);
    }
    if (n < 2 || !(sxx > 0.0))
        return false;
    *b = sxy / sxx;
    *a = my - *b * mx;
    return true;
}

bool chart_fit(const struct chart_series *s, size_t panel, struct chart_fit *out)
{
    enum { MOST = 64 };
    double x[MOST], y[MOST], lx[MOST], ly[MOST], log_c = 0.0;
    size_t n = 0;
    for (size_t i = 0; i < s->n && n < MOST; i++) {
        double u = s->points[i].x, v = s->points[i].y[panel];
        if (!(u > 0.0) || !(v > 0.0) || !isfinite(u) || !isfinite(v))
            continue;
        x[n] = u;
        y[n] = v;
        lx[n] = log(u);
        ly[n++] = log(v);
    }
    if (!chart_line(x, y, n, &out->a, &out->b) || !chart_line(lx, ly, n, &log_c, &out->k))
        return false;
    out->c = exp(log_c);
    return true;
}
