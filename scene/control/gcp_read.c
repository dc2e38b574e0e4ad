/* Ground control points from files: see gcp_read.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/control/gcp_read.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "core/base.h"
#include "scene/control/gcp_metashape.h"
#include "scene/control/table.h"
#include "scene/control/wkt.h"

enum gcp_column {
    GCP_X,
    GCP_Y,
    GCP_Z,
    GCP_PX,
    GCP_PY,
    GCP_IMAGE,
    GCP_NAME,
    GCP_PLAN_SIGMA,
    GCP_HEIGHT_SIGMA,
    GCP_SIGMA, /* of both */
    GCP_MARK_SIGMA,
    GCP_COLUMNS
};

struct gcp_table {
    const char *path;
    size_t line;
    char comma;                 /* between the fields of CSV; 0: blanks */
    size_t wide;                /* fields of the first line of CSV */
    bool bare;                  /* points may come without a mark */
    bool known;                 /* points may be those of the list, by their names alone */
    size_t column[GCP_COLUMNS]; /* which field; SIZE_MAX: not there */
};

/* Names of columns, without regard to case. */
static const struct {
    const char *word;
    enum gcp_column column;
} gcp_words[] = {{"x", GCP_X},
                 {"easting", GCP_X},
                 {"east", GCP_X},
                 {"lon", GCP_X},
                 {"longitude", GCP_X},
                 {"long", GCP_X},
                 {"y", GCP_Y},
                 {"northing", GCP_Y},
                 {"north", GCP_Y},
                 {"lat", GCP_Y},
                 {"latitude", GCP_Y},
                 {"z", GCP_Z},
                 {"height", GCP_Z},
                 {"h", GCP_Z},
                 {"elevation", GCP_Z},
                 {"elev", GCP_Z},
                 {"alt", GCP_Z},
                 {"altitude", GCP_Z},
                 {"px", GCP_PX},
                 {"im_x", GCP_PX},
                 {"col", GCP_PX},
                 {"column", GCP_PX},
                 {"u", GCP_PX},
                 {"image_x", GCP_PX},
                 {"pixel_x", GCP_PX},
                 {"image_y", GCP_PY},
                 {"pixel_y", GCP_PY},
                 {"py", GCP_PY},
                 {"im_y", GCP_PY},
                 {"row", GCP_PY},
                 {"v", GCP_PY},
                 {"image", GCP_IMAGE},
                 {"photo", GCP_IMAGE},
                 {"photograph", GCP_IMAGE},
                 {"image_name", GCP_IMAGE},
                 {"file", GCP_IMAGE},
                 {"filename", GCP_IMAGE},
                 {"file_name", GCP_IMAGE},
                 {"camera", GCP_IMAGE},
                 {"image_u", GCP_PX},
                 {"image_v", GCP_PY},
                 {"name", GCP_NAME},
                 {"marker", GCP_NAME},
                 {"gcp_name", GCP_NAME},
                 {"gcp_label", GCP_NAME},
                 {"point", GCP_NAME},
                 {"point_id", GCP_NAME},
                 {"point_name", GCP_NAME},
                 {"label", GCP_NAME},
                 {"gcp", GCP_NAME},
                 {"id", GCP_NAME},
                 {"accuracy_xy", GCP_PLAN_SIGMA},
                 {"accuracy_plan", GCP_PLAN_SIGMA},
                 {"accuracy_x/y", GCP_PLAN_SIGMA},
                 {"sigma_xy", GCP_PLAN_SIGMA},
                 {"sigma_plan", GCP_PLAN_SIGMA},
                 {"accuracy_z", GCP_HEIGHT_SIGMA},
                 {"accuracy_height", GCP_HEIGHT_SIGMA},
                 {"sigma_z", GCP_HEIGHT_SIGMA},
                 {"sigma_height", GCP_HEIGHT_SIGMA},
                 {"accuracy", GCP_SIGMA},
                 {"accuracy_m", GCP_SIGMA},
                 {"sigma", GCP_SIGMA},
                 {"accuracy_px", GCP_MARK_SIGMA},
                 {"sigma_px", GCP_MARK_SIGMA}};

/* What a column of this name holds; GCP_COLUMNS: unknown. */
static enum gcp_column gcp_column_of(const char *word)
{
    char plain[TABLE_HEADING];
    table_heading(word, plain);
    for (size_t w = 0; w < sizeof gcp_words / sizeof *gcp_words; w++)
        if (!strcasecmp(plain, gcp_words[w].word))
            return gcp_words[w].column;
    return GCP_COLUMNS;
}

static bool gcp_known(const char *field)
{
    return gcp_column_of(field) != GCP_COLUMNS;
}

/* "marker, camera, x, y" are marks of points that another file has: x and y are pixels. */
static void gcp_marks_alone(struct gcp_table *t)
{
    size_t *c = t->column;
    if (c[GCP_NAME] == SIZE_MAX || c[GCP_IMAGE] == SIZE_MAX || c[GCP_PX] != SIZE_MAX ||
        c[GCP_Z] != SIZE_MAX)
        return;
    c[GCP_PX] = c[GCP_X];
    c[GCP_PY] = c[GCP_Y];
    c[GCP_X] = c[GCP_Y] = SIZE_MAX;
}

static bool gcp_has_marks_alone(const struct gcp_table *t)
{
    const size_t *c = t->column;
    return t->comma && c[GCP_X] == SIZE_MAX && c[GCP_Y] == SIZE_MAX && c[GCP_Z] == SIZE_MAX &&
           c[GCP_PX] != SIZE_MAX && c[GCP_PY] != SIZE_MAX && c[GCP_IMAGE] != SIZE_MAX &&
           c[GCP_NAME] != SIZE_MAX;
}

/* The first line of a CSV file: which field is what. Returns the first column that is wanted and
 * not there, GCP_NAME: none. */
static enum gcp_column gcp_columns(char *text, struct gcp_table *t, int *epsg)
{
    char *field[TABLE_FIELDS], plain[TABLE_HEADING];
    t->comma = table_separator(text, gcp_known);
    t->comma = t->comma ? t->comma : ','; /* columns by blanks have no names */
    size_t n = table_split(text, t->comma, field), c = 0;
    t->wide = n;
    for (size_t i = 0; i < GCP_COLUMNS; i++)
        t->column[i] = SIZE_MAX;
    for (size_t i = 0; i < n; i++) {
        enum gcp_column column = gcp_column_of(field[i]);
        if (column == GCP_COLUMNS || t->column[column] != SIZE_MAX)
            continue;
        t->column[column] = i;
        table_heading(field[i], plain);
        if (!strncasecmp(plain, "lon", 3) && !*epsg)
            *epsg = GCP_LONLAT;
    }
    gcp_marks_alone(t);
    while (c < GCP_NAME && t->column[c] != SIZE_MAX)
        c++;
    return (enum gcp_column)c;
}

static void gcp_take_epsg(const char *text, struct gcp_list *l)
{
    int heights, code;
    if (wkt_system(text, &code, &heights)) {
        l->epsg = code;
        l->heights_epsg = heights;
    }
}

static bool gcp_names_columns(char *text)
{
    char *field[TABLE_FIELDS];
    size_t n = table_split(text, '\0', field), known = 0;
    for (size_t i = 0; i < n; i++)
        known += gcp_column_of(field[i]) != GCP_COLUMNS;
    return known > 1;
}

static enum err_code gcp_check_units(const struct gcp_table *t, const char *line, struct err *e)
{
    char copy[TABLE_LINE_MAX], *field[TABLE_FIELDS];
    enum err_code rc = ERR_OK;
    snprintf(copy, sizeof copy, "%s", line);
    const size_t n = table_split(copy, t->comma, field);
    for (size_t c = 0; !rc && c < GCP_COLUMNS; c++)
        if (t->column[c] < n)
            rc = table_check_unit(t->path, t->line, field[t->column[c]], e);
    return rc;
}

/* The first line names the columns, or the coordinate system, or it is a mark (*mark). */
static enum err_code gcp_head(const char *line, struct gcp_table *t, struct gcp_list *l, bool *mark,
                              struct err *e)
{
    static const char *const wanted[GCP_NAME] = {
        "x (or easting, lon)", "y (or northing, lat)", "z (or height)", "px", "py", "image"};
    char copy[TABLE_LINE_MAX], *end;
    snprintf(copy, sizeof copy, "%s", line);
    enum gcp_column lacks = gcp_columns(copy, t, &l->epsg);
    *mark = false;
    if (lacks == GCP_NAME || (t->bare && lacks >= GCP_PX) || (t->known && gcp_has_marks_alone(t)))
        return gcp_check_units(t, line, e);
    if (gcp_has_marks_alone(t))
        return err_set(e, ERR_FORMAT,
                       "%s: line %zu: has marks and no coordinates: give the file with the points "
                       "before it, as POINTS.csv,%s",
                       t->path, t->line, t->path);
    t->comma = '\0';
    for (size_t c = 0; c < GCP_COLUMNS; c++)
        t->column[c] = c <= GCP_NAME ? c : SIZE_MAX;
    gcp_take_epsg(line, l);
    strtod(line, &end);
    *mark = end != line && *end && strchr(" \t,;", *end);
    snprintf(copy, sizeof copy, "%s", line);
    bool comma = strpbrk(line, ",;") && !strchr(line, '['); /* WKT has both */
    const bool names = gcp_names_columns(copy);
    if (*mark || (l->epsg && !(comma && names)) || !(comma || names))
        return ERR_OK;
    return err_set(e, ERR_FORMAT,
                   "%s: line %zu: no column for %s; expected are the names of the columns, by "
                   "commas, or the coordinate system",
                   t->path, t->line, wanted[lacks]);
}

/* Commas within numbers would shift all that follows by a column: they are points where semicolons
 * or tabs divide the fields. */
static enum err_code gcp_check_commas(struct table *lines, const struct gcp_table *t, char *line,
                                      struct err *e)
{
    const char *at = line;
    if (t->comma != ',' && strpbrk(line, "\t;"))
        table_decimal_points(lines, line);
    size_t n = t->comma == ',' || !strchr(line, ' ') ? 0 : table_decimal_comma(line, &at);
    if (!n)
        return ERR_OK;
    return err_set(e, ERR_FORMAT,
                   "%s: line %zu: '%.*s' has a decimal comma: write numbers with a decimal point",
                   t->path, t->line, (int)(n < 40 ? n : 40), at);
}

/* Fields that the first line does not name, and a photograph that is a number, come of commas
 * within numbers. */
static enum err_code gcp_check_fields(const struct gcp_table *t, char *field[TABLE_FIELDS],
                                      size_t n, const char *image, struct err *e)
{
    double number;
    while (t->comma && n > t->wide && !*field[n - 1])
        n--;
    if (t->comma && n > t->wide)
        return err_set(e, ERR_FORMAT,
                       "%s: line %zu: %zu fields, but the first line names %zu; " TABLE_DIVIDED,
                       t->path, t->line, n, t->wide);
    if (table_number(image, &number))
        return err_set(e, ERR_FORMAT,
                       "%s: line %zu: the photograph is '%s', a number; " TABLE_DIVIDED
                       "; expected is %s",
                       t->path, t->line, image,
                       t->comma ? "what the first line names"
                                : "x y z column row photograph [name], and a name with blanks only "
                                  "where tabs divide");
    return ERR_OK;
}

/* The number of a column that may be missing or empty: then 0. */
static enum err_code gcp_sigma(const struct gcp_table *t, char *field[TABLE_FIELDS], size_t n,
                               enum gcp_column column, double *out, struct err *e)
{
    size_t i = t->column[column];
    if (i >= n || !*field[i])
        return ERR_OK;
    if (table_number(field[i], out) && *out > 0)
        return ERR_OK;
    return err_set(
        e, ERR_FORMAT,
        "%s: line %zu: field %zu, '%.40s', is no accuracy: a number above 0 is expected, "
        "or nothing where it is not known",
        t->path, t->line, i + 1, field[i]);
}

/* Is this line a point alone, "x y z [name]", or CSV without a photograph? */
static bool gcp_is_bare(const struct gcp_table *t, char *const field[TABLE_FIELDS], size_t n)
{
    const size_t image = t->column[GCP_IMAGE];
    double number;
    if (!t->bare)
        return false;
    if (t->comma)
        return image >= n || !*field[image];
    return n <= 4 || !table_number(field[3], &number);
}

static void gcp_take_sigmas(struct gcp *g, const double sigma[3])
{
    for (size_t k = 0; k < 2; k++)
        if (sigma[k] > 0 || sigma[2] > 0)
            g->sigma_m[k] = sigma[k] > 0 ? sigma[k] : sigma[2];
}

static enum err_code gcp_bare_row(const struct gcp_table *t, char *field[TABLE_FIELDS], size_t n,
                                  const double at[3], struct gcp_list *l, struct err *e)
{
    const size_t named = t->comma ? t->column[GCP_NAME] : 3;
    double sigma[3] = {0};
    size_t g;
    enum err_code rc = gcp_check_fields(t, field, n, "", e);
    for (size_t k = 0; !rc && k < 3; k++)
        rc = gcp_sigma(t, field, n, (enum gcp_column)(GCP_PLAN_SIGMA + k), &sigma[k], e);
    if (!rc)
        rc = gcp_find(t->path, t->line, l, named < n ? field[named] : "", at, &g, e);
    if (!rc)
        gcp_take_sigmas(&l->gcps[g], sigma);
    return rc;
}

/* A marker that was not surveyed, in a list of points. */
static bool gcp_is_nowhere(const struct gcp_table *t, char *const field[TABLE_FIELDS], size_t n)
{
    bool empty = t->comma && t->bare;
    for (size_t c = GCP_X; c <= GCP_Z; c++)
        empty = empty && t->column[c] < n && !*field[t->column[c]];
    return empty;
}

/* The point of this name; GCP_MAX: it was not surveyed. */
static size_t gcp_named(const struct gcp_list *l, const char *name)
{
    for (size_t i = 0; i < l->n; i++)
        if (!strcmp(l->gcps[i].name, name))
            return i;
    return GCP_MAX;
}

/* Fields of a line with tabs are divided at them alone, if these are enough: names may have blanks.
 */
static size_t gcp_split(const struct gcp_table *t, char *text, char *field[TABLE_FIELDS])
{
    size_t tabs = 0;
    for (const char *p = text; *p; p++)
        tabs += *p == '\t' && p[1] != '\t';
    const size_t least = t->bare ? 2 : GCP_IMAGE;
    if (t->comma || tabs < least || strpbrk(text, ",;"))
        return table_split(text, t->comma, field);
    char *to = text; /* tabs in a row divide once */
    for (const char *p = text; *p; p++)
        if (*p != '\t' || p[1] != '\t')
            *to++ = *p;
    *to = '\0';
    return table_split(text, '\t', field);
}

/* Does a name end as photographs' do? */
static bool gcp_is_photo(const char *name)
{
    static const char *const ends[] = {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".dng"};
    const char *dot = strrchr(name, '.');
    for (size_t k = 0; dot && k < sizeof ends / sizeof *ends; k++)
        if (!strcasecmp(dot, ends[k]))
            return true;
    return false;
}

/* A name with blanks in a line that is divided by blanks would shift what follows. */
static enum err_code gcp_check_blanks(const struct gcp_table *t, char *field[TABLE_FIELDS],
                                      size_t n, struct err *e)
{
    double number;
    for (size_t i = GCP_IMAGE + 1; !t->comma && i < n && !gcp_is_photo(field[GCP_IMAGE]); i++)
        if (gcp_is_photo(field[i]) && !table_number(field[GCP_IMAGE], &number))
            return err_set(e, ERR_FORMAT,
                           "%s: line %zu: the name of the photograph, '%s ... %s', has blanks: "
                           "divide the fields by tabs, or rename it",
                           t->path, t->line, field[GCP_IMAGE], field[i]);
    return ERR_OK;
}

static enum err_code gcp_no_number(const struct gcp_table *t, size_t i, const char *field,
                                   struct err *e)
{
    if (table_is_grouped(field))
        return err_set(e, ERR_FORMAT,
                       "%s: line %zu: field %zu, '%.40s', has a thousands separator: write it "
                       "without, and with a decimal point, as 5123456.78",
                       t->path, t->line, i + 1, field);
    return err_set(e, ERR_FORMAT, "%s: line %zu: field %zu is no number; expected is %s", t->path,
                   t->line, i + 1,
                   t->comma ? "what the first line names" : "x y z column row photograph [name]");
}

/* No ground lies lower; -9999 and its like stand for unknown. */
static const double lowest_m = -1000;

static enum err_code gcp_row(struct table *lines, const struct gcp_table *t, char *text,
                             struct gcp_list *l, struct err *e)
{
    char *field[TABLE_FIELDS];
    double v[GCP_IMAGE], sigma[4] = {0};
    enum err_code rc = gcp_check_commas(lines, t, text, e);
    if (rc)
        return rc;
    size_t n = gcp_split(t, text, field);
    const bool alone = gcp_has_marks_alone(t), bare = !alone && gcp_is_bare(t, field, n);
    if (bare && gcp_is_nowhere(t, field, n))
        return ERR_OK;
    for (size_t c = alone ? GCP_PX : GCP_X; c < (bare ? GCP_PX : GCP_IMAGE); c++) {
        size_t i = t->column[c];
        if (i >= n || !table_number(field[i], &v[c]))
            return gcp_no_number(t, i, i < n ? field[i] : "", e);
    }
    if (!alone && v[GCP_Z] < lowest_m)
        return err_set(e, ERR_FORMAT,
                       "%s: line %zu: the height is %g m, which stands for unknown: give it, or "
                       "remove the point",
                       t->path, t->line, v[GCP_Z]);
    if (bare)
        return gcp_bare_row(t, field, n, v, l, e);
    const char *image = t->column[GCP_IMAGE] < n ? field[t->column[GCP_IMAGE]] : "";
    if (!*image)
        return err_set(e, ERR_FORMAT, "%s: line %zu: no photograph is named", t->path, t->line);
    if (strlen(image) >= GCP_IMAGE_MAX)
        return err_set(e, ERR_FORMAT,
                       "%s: line %zu: '%.40s...': names of photographs have at most %d bytes",
                       t->path, t->line, image, GCP_IMAGE_MAX - 1);
    rc = gcp_check_blanks(t, field, n, e);
    if (!rc)
        rc = gcp_check_fields(t, field, n, image, e);
    for (size_t k = 0; !rc && k < 4; k++)
        rc = gcp_sigma(t, field, n, (enum gcp_column)(GCP_PLAN_SIGMA + k), &sigma[k], e);
    const char *name = t->column[GCP_NAME] < n ? field[t->column[GCP_NAME]] : "";
    struct gcp_mark m = {
        .x_px = v[GCP_PX], .y_px = v[GCP_PY], .sigma_px = sigma[3], .line = t->line};
    snprintf(m.image, sizeof m.image, "%s", image);
    if (!rc && alone && (m.gcp = gcp_named(l, name)) == GCP_MAX)
        return ERR_OK;
    if (!rc && !alone)
        rc = gcp_find(t->path, t->line, l, name, v, &m.gcp, e);
    if (rc)
        return rc;
    gcp_take_sigmas(&l->gcps[m.gcp], sigma);
    return gcp_add_mark(l, &m, e);
}

static int gcp_mark_compare(const void *a, const void *b)
{
    const struct gcp_mark *const *p = a, *const *q = b;
    if ((*p)->gcp != (*q)->gcp)
        return (*p)->gcp < (*q)->gcp ? -1 : 1;
    int order = strcmp((*p)->image, (*q)->image);
    return order ? order : ((*p)->line > (*q)->line) - ((*p)->line < (*q)->line);
}

/* A point has one mark a photograph: two are two points of one name, or a mistake. */
static enum err_code gcp_check_twice(const char *path, const struct gcp_list *l, struct err *e)
{
    const struct gcp_mark **sorted = mem_array(l->n_marks, sizeof *sorted);
    enum err_code rc =
        sorted ? ERR_OK : err_set(e, ERR_MEM, "out of memory for ground control points");
    for (size_t i = 0; !rc && i < l->n_marks; i++)
        sorted[i] = &l->marks[i];
    if (!rc)
        qsort(sorted, l->n_marks, sizeof *sorted, gcp_mark_compare);
    for (size_t i = 1; !rc && i < l->n_marks; i++) {
        const struct gcp_mark *a = sorted[i - 1], *b = sorted[i];
        if (a->gcp == b->gcp && !strcmp(a->image, b->image))
            rc = err_set(e, ERR_FORMAT,
                         "%s: lines %zu and %zu both mark ground control point %s in %.100s: "
                         "remove one, or give two points two names",
                         path, a->line, b->line, l->gcps[b->gcp].name, b->image);
    }
    mem_free(sorted);
    return rc;
}

/* A comment above the rows, "# EPSG:25832"; Metashape's "#Label,X/Easting,..." names columns. */
static bool gcp_is_comment(const char *line, bool bare)
{
    struct gcp_table t = {.bare = bare};
    char copy[TABLE_LINE_MAX];
    int epsg = 0;
    snprintf(copy, sizeof copy, "%s", line);
    if (*line != '#')
        return !strncmp(line, "//", 2);
    const enum gcp_column lacks = gcp_columns(copy, &t, &epsg);
    return t.column[GCP_NAME] != 0 || (lacks <= GCP_Z && !gcp_has_marks_alone(&t));
}

/* Points that the list itself names as check points; it may name some that are not marked. */
static void gcp_take_checks(const char *names, struct gcp_list *l)
{
    for (const char *p = names; *p;) {
        p += strspn(p, ", \t");
        const size_t n = strcspn(p, ",");
        for (size_t i = 0; i < l->n; i++)
            l->gcps[i].check |= strlen(l->gcps[i].name) == n && !strncmp(l->gcps[i].name, p, n);
        p += n;
    }
}

static enum err_code gcp_read_table(const char *path, bool bare, bool known, struct gcp_list *l,
                                    struct err *e)
{
    struct table lines;
    struct gcp_table t = {.path = path, .bare = bare, .known = known};
    char line[TABLE_LINE_MAX], checks[TABLE_LINE_MAX] = "";
    bool head = true, more = true;
    enum err_code rc = table_open(path, &lines, e);
    while (!rc && !(rc = table_next(&lines, line, &more, e)) && more) {
        bool mark = true;
        if (!strncmp(line, GCP_CHECKS, sizeof GCP_CHECKS - 1)) {
            snprintf(checks, sizeof checks, "%s", line + sizeof GCP_CHECKS - 1);
            continue;
        }
        if (head ? gcp_is_comment(line, bare) : *line == '#') {
            if (head)
                gcp_take_epsg(line + 1 + strspn(line + 1, " \t"), l);
            continue;
        }
        t.line = lines.line;
        if (head)
            rc = gcp_head(line, &t, l, &mark, e);
        head = false;
        if (!rc && mark)
            rc = gcp_row(&lines, &t, line, l, e);
    }
    table_close(&lines);
    gcp_take_checks(checks, l);
    return rc;
}

/* A file, or one with points and one with their marks, "POINTS.csv,MARKS.csv". */
static enum err_code gcp_read_lines(const char *path, bool bare, struct gcp_list *out,
                                    struct err *e)
{
    char first[FILE_PATH_MAX];
    const char *comma = file_exists(path) ? NULL : strchr(path, ',');
    const size_t n = comma ? (size_t)(comma - path) : 0;
    enum err_code rc = ERR_OK;
    *out = (struct gcp_list){0};
    if (comma && n < sizeof first) {
        memcpy(first, path, n);
        first[n] = '\0';
        rc = gcp_read_table(first, true, false, out, e);
        path = comma + 1;
    }
    if (!rc)
        rc = gcp_metashape_is(path) ? gcp_metashape_read(path, out, e)
                                    : gcp_read_table(path, bare, comma != NULL, out, e);
    if (!rc)
        rc = gcp_check_twice(path, out, e);
    return rc;
}

enum err_code gcp_read(const char *path, struct gcp_list *out, struct err *e)
{
    enum err_code rc = gcp_read_lines(path, false, out, e);
    if (!rc && !out->n)
        rc = err_set(e, ERR_DATA,
                     "%s: no ground control points; expected is gcp_list.txt of OpenDroneMap, CSV "
                     "with columns x, y, z, px, py, image and name, or markers that Metashape "
                     "exports as XML",
                     path);
    if (!rc && !out->n_marks)
        rc = err_set(e, ERR_DATA,
                     "%s: %zu ground control points, of which none is marked in a photograph: "
                     "`citysplat mark` marks them",
                     path, out->n);
    if (rc)
        gcp_free(out);
    return rc;
}

enum err_code gcp_read_points(const char *path, struct gcp_list *out, struct err *e)
{
    enum err_code rc = gcp_read_lines(path, true, out, e);
    if (rc)
        gcp_free(out);
    return rc;
}
