/* Draws charts with gnuplot: a script is made in memory and run in a child process. The palette is
 * that of Okabe and Ito, which is safe for colour-blind readers; point shapes differ as well.
 * Characters that gnuplot would interpret are removed from texts.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <errno.h>
#include <math.h>
#include <spawn.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "lab/study/chart.h"

extern char **environ;

static const char *const plot_colors[] = {"#0072B2", "#D55E00", "#009E73", "#CC79A7",
                                          "#E69F00", "#56B4E9", "#000000"};
static const int plot_shapes[] = {7, 5, 9, 13, 11, 15, 2};
#define PLOT_LOG_LEAST 3.0 /* axes that span less stay linear: logarithmic tics would be few */
enum {
    PLOT_COLORS = sizeof plot_colors / sizeof *plot_colors,
    PLOT_PANEL_W_PX = 560,
    PLOT_PANEL_H_PX = 430,
    PLOT_BAR_PX = 30,     /* height of a bar's row */
    PLOT_BARS_W_PX = 300, /* width of a panel of bars */
    PLOT_KEY_PX = 20,     /* a line of the legend */
    PLOT_AXIS_PX = 62,    /* tics and title of the x axis */
    PLOT_CHAR_PX = 8,     /* of the 12 pt font, generous */
};

/* A text inside single quotes: without quotes, escapes and control characters. */
static void plot_text(struct buf *b, const char *s)
{
    for (; *s; s++)
        if ((unsigned char)*s >= 0x20 && !strchr("'\"`\\$@{}", *s))
            buf_u8(b, (unsigned char)*s);
}

/* ---- lines ---- */

/* Tics at 1 and 5 times powers of ten, at more numbers where that would leave too few. */
static void plot_log_tics(struct buf *b, char axis, double lo, double hi)
{
    bool fine = hi < 400.0 * lo, finer = hi < 12.0 * lo, finest = hi < 4.0 * lo;
    const char *comma = "";
    buf_printf(b, "set %ctics (", axis);
    for (int k = (int)floor(log10(lo)); k <= (int)ceil(log10(hi)); k++)
        for (int m = 1; m <= 9; m++) {
            double v = m * pow(10.0, k);
            if (v < lo || v > hi)
                continue;
            if (m == 1 || (m == 5 && fine) || (m == 2 && fine) || (m == 3 && finer) || finest)
                buf_printf(b, "%s'%.6g' %.9g", comma, v, v);
            else
                buf_printf(b, "%s'' %.9g 1", comma, v);
            comma = ", ";
        }
    buf_printf(b, ")\n");
}

/* A step of 1, 2 or 5 times a power of ten, not below `least`. */
static double plot_nice_step(double least)
{
    double ten = pow(10.0, floor(log10(least)));
    double m = least / ten;
    return ten * (m <= 1.0 ? 1.0 : m <= 2.0 ? 2.0 : m <= 5.0 ? 5.0 : 10.0);
}

struct plot_axis {
    char name;
    bool logarithmic;
    double lo, hi, below, above; /* of the data; room for labels in parts of it */
};

/* Range and tics of an axis. */
static void plot_set_axis(struct buf *b, const struct plot_axis *a)
{
    double lo = a->lo, hi = a->hi;
    if (a->logarithmic && lo > 0.0 && hi > PLOT_LOG_LEAST * lo) {
        double span = fmax(log(hi / lo), log(1.5));
        lo *= exp(-a->below * span);
        hi *= exp(a->above * span);
        buf_printf(b, "set logscale %c\n", a->name);
        plot_log_tics(b, a->name, lo, hi);
    } else {
        double span = hi > lo ? hi - lo : fmax(fabs(hi) * 0.05, 1e-3);
        bool whole = span <= 12.0 && floor(lo) == lo && floor(hi) == hi;
        lo -= a->below * span;
        hi += a->above * span;
        buf_printf(b, "set %ctics autofreq%s\n", a->name, a->name == 'x' && whole ? " 1" : "");
    }
    buf_printf(b, "set %crange [%.9g:%.9g]\n", a->name, lo, hi);
}

static void plot_extent(const struct chart_data *c, size_t panel, double lo[2], double hi[2])
{
    lo[0] = lo[1] = HUGE_VAL;
    hi[0] = hi[1] = -HUGE_VAL;
    for (size_t s = 0; s < c->n_series; s++)
        for (size_t i = 0; i < c->series[s].n; i++) {
            const struct chart_point *p = &c->series[s].points[i];
            if (!isfinite(p->x) || !isfinite(p->y[panel]))
                continue;
            lo[0] = fmin(lo[0], p->x);
            hi[0] = fmax(hi[0], p->x);
            lo[1] = fmin(lo[1], p->y[panel]);
            hi[1] = fmax(hi[1], p->y[panel]);
        }
}

static void plot_points(struct buf *b, const struct chart_data *c, size_t panel)
{
    for (size_t s = 0; s < c->n_series; s++) {
        buf_printf(b, "$d%zu_%zu << EOD\n", panel, s);
        for (size_t i = 0; i < c->series[s].n; i++) {
            const struct chart_point *p = &c->series[s].points[i];
            if (!isfinite(p->x) || !isfinite(p->y[panel]))
                continue;
            buf_printf(b, "%.9g %.9g \"", p->x, p->y[panel]);
            plot_text(b, p->label);
            buf_printf(b, "\"\n");
        }
        buf_printf(b, "EOD\n");
    }
}

/* Does the line rise from its first point to its last? */
static bool plot_rises(const struct chart_series *s, size_t panel)
{
    return s->n < 2 || s->points[s->n - 1].y[panel] >= s->points[0].y[panel];
}

static bool plot_is_fit(const struct chart_def *d)
{
    return !strncmp(d->kind, "fit", 3);
}

/* Labels in the line's colour, beside the points where the line does not run; each of four lines
 * has a side of its own. */
static void plot_labels(struct buf *b, const struct chart_series *s, size_t panel, size_t nth)
{
    static const char *const side[] = {"left offset 0.8", "right offset -0.8", "center offset 0",
                                       "center offset 0"};
    static const double lift[] = {-0.5, 0.5, -1.1, 1.1};
    double up = plot_rises(s, panel) ? lift[nth % 4] : -lift[nth % 4];
    buf_printf(b, ", $d%zu_%zu using 1:2:3 with labels font ',10' textcolor rgb '%s' %s,%g notitle",
               panel, nth, plot_colors[nth % PLOT_COLORS], side[nth % 4], up);
}

static void plot_series(struct buf *b, const struct chart_def *d, const struct chart_data *c,
                        size_t panel)
{
    buf_printf(b, "plot");
    for (size_t s = 0; s < c->n_series; s++) {
        const char *color = plot_colors[s % PLOT_COLORS];
        struct chart_fit fit = {0};
        buf_printf(b,
                   "%s $d%zu_%zu using 1:2 with linespoints lw 2 ps 1.1 pt %d lc rgb '%s' title '",
                   s ? "," : "", panel, s, plot_shapes[s % PLOT_COLORS], color);
        plot_text(b, c->series[s].name);
        buf_printf(b, "'");
        if (*d->label)
            plot_labels(b, &c->series[s], panel, s);
        if (plot_is_fit(d) && chart_fit(&c->series[s], panel, &fit))
            buf_printf(b, ", %.9g + %.9g * x with lines dt 2 lw 1 lc rgb '%s' notitle", fit.a,
                       fit.b, color);
    }
    buf_printf(b, "\n");
}

/* The x axis' title; under it the fits, in words. */
static void plot_x_title(struct buf *b, const struct chart_def *d, const struct chart_data *c,
                         size_t panel)
{
    struct chart_key x = chart_find_key(d->x);
    buf_printf(b, "set xlabel \"%s", x.axis);
    for (size_t s = 0; s < c->n_series && plot_is_fit(d); s++) {
        struct chart_fit fit;
        if (!chart_fit(&c->series[s], panel, &fit))
            continue;
        buf_printf(b, "\\ndashed: %.4g + %.4g a million; mean slope in these axes %.2f", fit.a,
                   1e6 * fit.b * x.scale, fit.k);
    }
    buf_printf(b, "\" noenhanced\n");
}

/* Pixels below the x axis' title: fits in words, a legend. */
static int plot_below_px(const struct chart_def *d, const struct chart_data *c)
{
    int lines = (c->n_series > 1 ? (int)c->n_series : 0) + (plot_is_fit(d) ? (int)c->n_series : 0);
    return PLOT_KEY_PX * lines;
}

/* Room to the right for the longest label, in parts of the axis. */
static double plot_headroom(const struct chart_data *c)
{
    size_t longest = 0;
    for (size_t s = 0; s < c->n_series; s++)
        for (size_t i = 0; i < c->series[s].n; i++) {
            size_t n = strlen(c->series[s].points[i].label);
            longest = n > longest ? n : longest;
        }
    return 0.06 + 0.0178 * (double)longest;
}

static void plot_panel(struct buf *b, const struct chart_def *d, const struct chart_data *c,
                       size_t panel)
{
    char key[CHART_TEXT_MAX];
    double lo[2], hi[2];
    bool log_y = !strncmp(d->kind, "loglog", 6) || plot_is_fit(d);
    bool log_x = log_y || !strncmp(d->kind, "log", 3);
    plot_extent(c, panel, lo, hi);
    if (!(lo[0] <= hi[0])) { /* nobody measured it */
        buf_printf(b, "set multiplot next\n");
        return;
    }
    plot_points(b, c, panel);
    plot_x_title(b, d, c, panel);
    chart_part(d->y, panel, key);
    buf_printf(b, "set ylabel '%s'\n", chart_find_key(key).axis);
    buf_printf(b, "unset logscale\n");
    double below = c->n_series > 1 ? plot_headroom(c) : 0.1;
    plot_set_axis(b, &(struct plot_axis){'x', log_x, lo[0], hi[0], below, plot_headroom(c)});
    plot_set_axis(b, &(struct plot_axis){'y', log_y, lo[1], hi[1], 0.12, 0.1});
    buf_printf(b, c->n_series > 1 ? "set key bmargin center vertical maxcols 1 noenhanced\n"
                                  : "unset key\n");
    plot_series(b, d, c, panel);
}

static void plot_panels(struct buf *b, const struct chart_def *d, const struct chart_data *c,
                        int width_px, int height_px)
{
    double each = 1.0 / (double)c->n_panels, left = 84.0 / width_px, right = 20.0 / width_px;
    buf_printf(b, "set bmargin at screen %.4f\n",
               (double)(PLOT_AXIS_PX + plot_below_px(d, c)) / height_px);
    for (size_t k = 0; k < c->n_panels; k++) {
        buf_printf(b, "set lmargin at screen %.4f\nset rmargin at screen %.4f\n",
                   each * (double)k + left, each * (double)(k + 1) - right);
        plot_panel(b, d, c, k);
    }
}

/* ---- bars ---- */

/* A difference with its sign and unit, "+0.12". */
static void plot_bar_data(struct buf *b, const struct chart_series *s, size_t panel, int decimals)
{
    for (int sign = 0; sign < 2; sign++) {
        buf_printf(b, "$b%zu_%d << EOD\n", panel, sign);
        for (size_t i = 0; i < s->n; i++) {
            double v = s->points[i].y[panel], y = (double)(s->n - 1 - i);
            if (!isfinite(v) || (v < 0.0) != (sign == 1))
                continue;
            buf_printf(b, "%.9g %g %.9g %.9g %g %g \"%+.*f\"\n", v, y, fmin(v, 0.0), fmax(v, 0.0),
                       y - 0.32, y + 0.32, decimals, v);
        }
        buf_printf(b, "EOD\n");
    }
}

static size_t plot_bar_count(const struct chart_series *s, size_t panel, int sign)
{
    size_t n = 0;
    for (size_t i = 0; i < s->n; i++)
        n += isfinite(s->points[i].y[panel]) && (s->points[i].y[panel] < 0.0) == (sign == 1);
    return n;
}

static void plot_bars_panel(struct buf *b, const struct chart_def *d, const struct chart_data *c,
                            size_t panel, double left, double width)
{
    char name[CHART_TEXT_MAX];
    const struct chart_series *s = &c->series[0];
    double lo = 0.0, hi = 0.0;
    chart_part(d->y, panel, name);
    struct chart_key key = chart_find_key(name);
    for (size_t i = 0; i < s->n; i++)
        if (isfinite(s->points[i].y[panel])) {
            lo = fmin(lo, s->points[i].y[panel]);
            hi = fmax(hi, s->points[i].y[panel]);
        }
    double span = hi > lo ? hi - lo : 1.0;
    bool minus = plot_bar_count(s, panel, 1) > 0, plus = plot_bar_count(s, panel, 0) > 0;
    plot_bar_data(b, s, panel, key.decimals);
    buf_printf(b, "set lmargin at screen %.4f\nset rmargin at screen %.4f\n", left, left + width);
    buf_printf(b, "set title '%s%s' font ',11' noenhanced\n", key.axis,
               key.better > 0 ? ", higher is better" : "");
    buf_printf(b, "set xrange [%.9g:%.9g]\nset yrange [-0.6:%g]\n",
               lo - (minus ? 0.45 : 0.06) * span, hi + (plus ? 0.45 : 0.06) * span,
               (double)s->n - 0.4);
    buf_printf(b, "set ytics scale 0 (");
    for (size_t i = 0; i < s->n; i++) {
        buf_printf(b, "%s'", i ? ", " : "");
        if (!panel)
            plot_text(b, s->points[i].label);
        buf_printf(b, "' %zu", s->n - 1 - i);
    }
    buf_printf(b, ") noenhanced\nset xtics autofreq %.9g\n", plot_nice_step(span / 2.0));
    buf_printf(b, "plot");
    for (int sign = 0; sign < 2; sign++) {
        const char *color = plot_colors[sign];
        if (!plot_bar_count(s, panel, sign))
            continue;
        buf_printf(b,
                   "%s $b%zu_%d using 1:2:3:4:5:6 with boxxyerror fs solid 0.85 noborder lc rgb "
                   "'%s' notitle, $b%zu_%d using 1:2:7 with labels font ',10' %s notitle",
                   sign && plus ? "," : "", panel, sign, color, panel, sign,
                   sign ? "right offset -0.6,0" : "left offset 0.6,0");
    }
    buf_printf(b, "\n");
}

static void plot_bars(struct buf *b, const struct chart_def *d, const struct chart_data *c,
                      int width_px)
{
    size_t longest = 0;
    for (size_t i = 0; i < c->series[0].n; i++) {
        size_t n = strlen(c->series[0].points[i].label);
        longest = n > longest ? n : longest;
    }
    double left = (double)(longest * PLOT_CHAR_PX + 24) / width_px;
    double each = (1.0 - left - 0.02) / (double)c->n_panels;
    buf_printf(b, "unset key\nset grid noytics\nset arrow 1 from first 0, graph 0 to "
                  "first 0, graph 1 nohead lw 1 lc rgb '#404040' front\n");
    for (size_t k = 0; k < c->n_panels; k++)
        plot_bars_panel(b, d, c, k, left + each * (double)k, each - 0.035);
}

/* ---- scripts ---- */

static void plot_size(const struct chart_def *d, const struct chart_data *c, int *w, int *h)
{
    int panels = (int)c->n_panels;
    *w = PLOT_PANEL_W_PX * panels;
    *h = PLOT_PANEL_H_PX + plot_below_px(d, c);
    if (!strncmp(d->kind, "bars", 4)) {
        size_t longest = 0;
        for (size_t i = 0; i < c->series[0].n; i++) {
            size_t n = strlen(c->series[0].points[i].label);
            longest = n > longest ? n : longest;
        }
        *w = PLOT_BARS_W_PX * panels + (int)longest * PLOT_CHAR_PX + 24;
        *h = PLOT_BAR_PX * (int)c->series[0].n + 130;
    }
}

static void plot_script(struct buf *b, const struct chart_def *d, const struct chart_data *c,
                        const char *terminal, const char *path)
{
    int w, h;
    plot_size(d, c, &w, &h);
    buf_printf(b, "set terminal %s size %d,%d font 'DejaVu Sans,12' background rgb '#ffffff'\n",
               terminal, w, h);
    buf_printf(b, "set encoding utf8\nset output '");
    for (const char *s = path; *s; s++) {
        buf_u8(b, (unsigned char)*s);
        if (*s == '\'')
            buf_u8(b, '\'');
    }
    buf_printf(b, "'\nset multiplot layout 1,%zu title '", c->n_panels);
    plot_text(b, d->title);
    buf_printf(b,
               "' font ',13' noenhanced\n"
               "set grid lc rgb '#d8d8d8' lt 1\nset border 3 lc rgb '#404040'\nset tics nomirror\n"
               "set tmargin at screen %.4f\n",
               1.0 - (!strncmp(d->kind, "bars", 4) ? 85.0 : 52.0) / h);
    if (!strncmp(d->kind, "bars", 4))
        plot_bars(b, d, c, w);
    else
        plot_panels(b, d, c, w, h);
    buf_printf(b, "unset multiplot\nunset output\nreset\n");
}

/* ---- the child ---- */

/* The first line of what the child said, or "". */
static void plot_first_line(FILE *f, char *out, size_t room)
{
    rewind(f);
    out[0] = '\0';
    while (fgets(out, (int)room, f))
        if (strspn(out, " \t\n^") < strlen(out)) {
            out[strcspn(out, "\n")] = '\0';
            return;
        }
}

static enum err_code plot_spawn(FILE *script, FILE *said, struct err *e)
{
    static const char *const argv[] = {"gnuplot", "-d", "-", NULL};
    posix_spawn_file_actions_t actions;
    pid_t pid;
    int status = 0;
    if (posix_spawn_file_actions_init(&actions))
        return err_set(e, ERR_MEM, "gnuplot: out of memory");
    int rc = posix_spawn_file_actions_adddup2(&actions, fileno(script), STDIN_FILENO);
    if (!rc)
        rc = posix_spawn_file_actions_adddup2(&actions, fileno(said), STDERR_FILENO);
    if (!rc)
        rc = posix_spawnp(&pid, argv[0], &actions, NULL, (char **)(uintptr_t)argv, environ);
    posix_spawn_file_actions_destroy(&actions);
    if (rc == ENOENT)
        return err_set(e, ERR_NOENT,
                       "gnuplot is not installed; it draws the charts (Debian: apt-get install "
                       "gnuplot-nox)");
    if (rc)
        return err_set(e, ERR_IO, "gnuplot: cannot start: %s", strerror(rc));
    while (waitpid(pid, &status, 0) < 0 && errno == EINTR)
        ;
    if (WIFEXITED(status) && WEXITSTATUS(status) == 0)
        return ERR_OK;
    char line[256];
    plot_first_line(said, line, sizeof line);
    return err_set(e, ERR_INTERNAL, "gnuplot failed: %s", line[0] ? line : "no message");
}

static enum err_code plot_run(const struct buf *text, struct err *e)
{
    enum err_code rc = ERR_OK;
    FILE *script = tmpfile(), *said = tmpfile();
    if (!script || !said)
        rc = err_errno(e, ERR_IO, "gnuplot: cannot make a temporary file");
    else if (fwrite(text->data, 1, text->size, script) != text->size || fflush(script) ||
             fseek(script, 0, SEEK_SET))
        rc = err_errno(e, ERR_IO, "gnuplot: cannot write its script");
    else
        rc = plot_spawn(script, said, e);
    if (script)
        fclose(script);
    if (said)
        fclose(said);
    return rc;
}

static enum err_code plot_one(const struct chart_def *d, const struct chart_data *c,
                              const char *terminal, const char *path, struct err *e)
{
    char part[FILE_PATH_MAX];
    struct buf b = {0};
    struct stat st;
    enum err_code rc = file_begin(path, part, e);
    if (rc)
        return rc;
    plot_script(&b, d, c, terminal, part);
    rc = buf_check(&b, e);
    if (!rc)
        rc = plot_run(&b, e);
    if (!rc && (stat(part, &st) || st.st_size == 0))
        rc = err_set(e, ERR_INTERNAL, "gnuplot wrote nothing to %s", path);
    if (!rc)
        rc = file_commit(part, path, e);
    else
        file_abort(part);
    buf_free(&b);
    return !rc ? rc : err_add(e, "chart %s", d->name);
}

enum err_code chart_plot(const struct chart_def *d, const struct chart_data *c, const char *dir,
                         bool png, struct err *e)
{
    char name[CHART_TEXT_MAX], path[FILE_PATH_MAX];
    snprintf(name, sizeof name, "%s.svg", d->name);
    enum err_code rc = file_join(path, dir, name, e);
    if (!rc)
        rc = plot_one(d, c, "svg dynamic noenhanced", path, e);
    if (rc || !png)
        return rc;
    snprintf(name, sizeof name, "%s.png", d->name);
    rc = file_join(path, dir, name, e);
    return !rc ? plot_one(d, c, "pngcairo noenhanced", path, e) : rc;
}
