/* Ground control points from files: see gcp.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "ingest/gcp.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "core/base.h"

enum { GCP_FIELDS = 16, GCP_LINE_MAX = 1024 };
enum gcp_column { GCP_X, GCP_Y, GCP_Z, GCP_PX, GCP_PY, GCP_IMAGE, GCP_NAME, GCP_COLUMNS };

struct gcp_table {
    const char *path;
    size_t line;
    bool csv;
    size_t column[GCP_COLUMNS]; /* which field; SIZE_MAX: not there */
};

void gcp_free(struct gcp_list *l)
{
    mem_free(l->gcps);
    mem_free(l->marks);
    *l = (struct gcp_list){0};
}

/* Split at commas or at blanks, in place. */
static size_t gcp_split(char *text, bool csv, char *field[GCP_FIELDS])
{
    const char *end = csv ? "," : " \t,;";
    size_t n = 0;
    char *p = text;
    while (n < GCP_FIELDS) {
        p += csv ? strspn(p, " \t") : strspn(p, end);
        if (!csv && !*p)
            break;
        size_t len = strcspn(p, end);
        bool last = !p[len];
        field[n++] = p;
        p[len] = '\0';
        for (size_t k = len; csv && k > 0 && (p[k - 1] == ' ' || p[k - 1] == '\t'); k--)
            p[k - 1] = '\0';
        if (last)
            break;
        p += len + 1;
    }
    return n;
}

/* What a column of this name holds; GCP_COLUMNS: unknown. */
static enum gcp_column gcp_column_of(const char *word)
{
    static const struct {
        const char *word;
        enum gcp_column column;
    } words[] = {{"x", GCP_X},
                 {"easting", GCP_X},
                 {"east", GCP_X},
                 {"lon", GCP_X},
                 {"longitude", GCP_X},
                 {"y", GCP_Y},
                 {"northing", GCP_Y},
                 {"north", GCP_Y},
                 {"lat", GCP_Y},
                 {"latitude", GCP_Y},
                 {"z", GCP_Z},
                 {"height", GCP_Z},
                 {"h", GCP_Z},
                 {"elevation", GCP_Z},
                 {"alt", GCP_Z},
                 {"altitude", GCP_Z},
                 {"px", GCP_PX},
                 {"im_x", GCP_PX},
                 {"col", GCP_PX},
                 {"column", GCP_PX},
                 {"u", GCP_PX},
                 {"py", GCP_PY},
                 {"im_y", GCP_PY},
                 {"row", GCP_PY},
                 {"v", GCP_PY},
                 {"image", GCP_IMAGE},
                 {"photo", GCP_IMAGE},
                 {"photograph", GCP_IMAGE},
                 {"image_name", GCP_IMAGE},
                 {"file", GCP_IMAGE},
                 {"name", GCP_NAME},
                 {"label", GCP_NAME},
                 {"gcp", GCP_NAME},
                 {"id", GCP_NAME}};
    for (size_t w = 0; w < sizeof words / sizeof *words; w++)
        if (!strcasecmp(word, words[w].word))
            return words[w].column;
    return GCP_COLUMNS;
}

/* The first line of a CSV file: which field is what. Returns the first column that is wanted and
 * not there, GCP_NAME: none. */
static enum gcp_column gcp_columns(char *text, struct gcp_table *t, int *epsg)
{
    char *field[GCP_FIELDS];
    size_t n = gcp_split(text, true, field), c = 0;
    for (size_t i = 0; i < GCP_COLUMNS; i++)
        t->column[i] = SIZE_MAX;
    for (size_t i = 0; i < n; i++) {
        enum gcp_column column = gcp_column_of(field[i]);
        if (column == GCP_COLUMNS)
            continue;
        t->column[column] = i;
        if (!strncasecmp(field[i], "lon", 3))
            *epsg = GCP_LONLAT;
    }
    while (c < GCP_NAME && t->column[c] != SIZE_MAX)
        c++;
    return (enum gcp_column)c;
}

/* "EPSG:32632", "WGS84 UTM 32N"; 0 for other words. */
static int gcp_epsg(const char *text)
{
    int code = 0, zone = 0;
    char side = 0;
    if (sscanf(text, "EPSG:%d", &code) == 1 || sscanf(text, "epsg:%d", &code) == 1)
        return code;
    if (sscanf(text, "WGS84 UTM %d%c", &zone, &side) == 2 && zone >= 1 && zone <= 60 &&
        (side == 'N' || side == 'S'))
        return (side == 'N' ? 32600 : 32700) + zone;
    return 0;
}

static bool gcp_names_columns(char *text)
{
    char *field[GCP_FIELDS];
    size_t n = gcp_split(text, false, field), known = 0;
    for (size_t i = 0; i < n; i++)
        known += gcp_column_of(field[i]) != GCP_COLUMNS;
    return known > 1;
}

/* The first line names the columns, or the coordinate system, or it is a mark (*mark). */
static enum err_code gcp_head(const char *line, struct gcp_table *t, int *epsg, bool *mark,
                              struct err *e)
{
    static const char *const wanted[GCP_NAME] = {
        "x (or easting, lon)", "y (or northing, lat)", "z (or height)", "px", "py", "image"};
    char copy[GCP_LINE_MAX], *end;
    snprintf(copy, sizeof copy, "%s", line);
    enum gcp_column lacks = gcp_columns(copy, t, epsg);
    *mark = false;
    t->csv = lacks == GCP_NAME;
    if (t->csv)
        return ERR_OK;
    for (size_t c = 0; c < GCP_COLUMNS; c++)
        t->column[c] = c;
    *epsg = gcp_epsg(line);
    strtod(line, &end);
    *mark = end != line && strchr(" \t,;", *end);
    snprintf(copy, sizeof copy, "%s", line);
    bool comma = strpbrk(line, ",;") && !strchr(line, '['); /* WKT has both */
    if (*mark || *epsg || !(comma || gcp_names_columns(copy)))
        return ERR_OK;
    return err_set(e, ERR_FORMAT,
                   "%s: line %zu: no column for %s; expected are the names of the columns, by "
                   "commas, or the coordinate system",
                   t->path, t->line, wanted[lacks]);
}

/* The point of a name, or without one of these coordinates; new where there is none yet. */
static enum err_code gcp_find(const struct gcp_table *t, struct gcp_list *l, const char *name,
                              const double at[3], size_t *out, struct err *e)
{
    if (strlen(name) >= GCP_NAME_MAX)
        return err_set(e, ERR_FORMAT, "%s: line %zu: '%.40s...': names have at most %d bytes",
                       t->path, t->line, name, GCP_NAME_MAX - 1);
    for (size_t i = 0; i < l->n; i++) {
        const struct gcp *g = &l->gcps[i];
        bool there = g->at[0] == at[0] && g->at[1] == at[1] && g->at[2] == at[2];
        if (*name ? strcmp(g->name, name) != 0 : !there)
            continue;
        *out = i;
        if (there)
            return ERR_OK;
        return err_set(
            e, ERR_FORMAT,
            "%s: line %zu: ground control point %s lies at %.10g %.10g %.10g here and at "
            "%.10g %.10g %.10g before: mend the one that is wrong",
            t->path, t->line, name, at[0], at[1], at[2], g->at[0], g->at[1], g->at[2]);
    }
    if (l->n == GCP_MAX)
        return err_set(e, ERR_DATA, "more than %d ground control points", GCP_MAX);
    if (l->n == l->cap) {
        size_t cap = l->cap ? 2 * l->cap : 16;
        struct gcp *p = mem_resize(l->gcps, l->cap, cap, sizeof *p);
        if (!p)
            return err_set(e, ERR_MEM, "out of memory for ground control points");
        l->gcps = p;
        l->cap = cap;
    }
    struct gcp *g = &l->gcps[l->n];
    *g = (struct gcp){.at = {at[0], at[1], at[2]}};
    if (*name)
        snprintf(g->name, sizeof g->name, "%s", name);
    else
        snprintf(g->name, sizeof g->name, "%zu", l->n + 1);
    *out = l->n++;
    return ERR_OK;
}

static enum err_code gcp_add_mark(struct gcp_list *l, const struct gcp_mark *m, struct err *e)
{
    if (l->n_marks == l->cap_marks) {
        size_t cap = l->cap_marks ? 2 * l->cap_marks : 16;
        struct gcp_mark *p = mem_resize(l->marks, l->cap_marks, cap, sizeof *p);
        if (!p)
            return err_set(e, ERR_MEM, "out of memory for ground control points");
        l->marks = p;
        l->cap_marks = cap;
    }
    l->marks[l->n_marks++] = *m;
    return ERR_OK;
}

static enum err_code gcp_row(const struct gcp_table *t, char *text, struct gcp_list *l,
                             struct err *e)
{
    char *field[GCP_FIELDS], *end;
    double v[GCP_IMAGE];
    size_t n = gcp_split(text, t->csv, field);
    for (size_t c = 0; c < GCP_IMAGE; c++) {
        size_t i = t->column[c];
        v[c] = i < n ? strtod(field[i], &end) : 0;
        if (i >= n || end == field[i] || *end || !isfinite(v[c]) || fabs(v[c]) > 1e9)
            return err_set(e, ERR_FORMAT, "%s: line %zu: field %zu is no number; expected is %s",
                           t->path, t->line, i + 1,
                           t->csv ? "what the first line names"
                                  : "x y z column row photograph [name]");
    }
    const char *image = t->column[GCP_IMAGE] < n ? field[t->column[GCP_IMAGE]] : "";
    if (!*image)
        return err_set(e, ERR_FORMAT, "%s: line %zu: no photograph is named", t->path, t->line);
    if (strlen(image) >= GCP_IMAGE_MAX)
        return err_set(e, ERR_FORMAT,
                       "%s: line %zu: '%.40s...': names of photographs have at most %d bytes",
                       t->path, t->line, image, GCP_IMAGE_MAX - 1);
    const char *name = t->column[GCP_NAME] < n ? field[t->column[GCP_NAME]] : "";
    struct gcp_mark m = {.x_px = v[GCP_PX], .y_px = v[GCP_PY]};
    snprintf(m.image, sizeof m.image, "%s", image);
    enum err_code rc = gcp_find(t, l, name, v, &m.gcp, e);
    return rc ? rc : gcp_add_mark(l, &m, e);
}

enum err_code gcp_read(const char *path, struct gcp_list *out, struct err *e)
{
    struct buf b = {0};
    struct gcp_table t = {.path = path, .column = {0, 1, 2, 3, 4, 5, 6}};
    bool head = true;
    *out = (struct gcp_list){0};
    enum err_code rc = file_read(path, 0, &b, e);
    if (!rc) {
        buf_u8(&b, 0);
        rc = buf_check(&b, e);
    }
    char *first = (char *)b.data;
    if (!rc && !strncmp(first, "\xef\xbb\xbf", 3)) /* the byte-order mark of UTF-8 */
        first += 3;
    for (char *p = rc ? NULL : first, *next; p && !rc; p = next) {
        char line[GCP_LINE_MAX];
        size_t n = strcspn(p, "\r\n");
        next = p[n] ? p + n + 1 : NULL;
        t.line += !(p[n] == '\n' && p > first && p[-1] == '\r' && n == 0);
        p += strspn(p, " \t");
        n = strcspn(p, "\r\n");
        if (n == 0 || *p == '#')
            continue;
        if (n >= sizeof line) {
            rc = err_set(e, ERR_FORMAT, "%s: line %zu is too long", path, t.line);
            break;
        }
        memcpy(line, p, n);
        line[n] = '\0';
        bool mark = true;
        if (head)
            rc = gcp_head(line, &t, &out->epsg, &mark, e);
        head = false;
        if (!rc && mark)
            rc = gcp_row(&t, line, out, e);
    }
    if (!rc && !out->n_marks)
        rc = err_set(e, ERR_DATA,
                     "%s: no ground control points; expected is gcp_list.txt of OpenDroneMap, or "
                     "CSV with columns x, y, z, px, py, image and name",
                     path);
    buf_free(&b);
    if (rc)
        gcp_free(out);
    return rc;
}

enum err_code gcp_keep_out(struct gcp_list *l, const char *names, struct err *e)
{
    for (const char *p = names; *p;) {
        size_t n = strcspn(p, ","), found = 0;
        for (size_t i = 0; i < l->n; i++)
            if (strlen(l->gcps[i].name) == n && !strncmp(l->gcps[i].name, p, n)) {
                l->gcps[i].check = true;
                found++;
            }
        if (!found)
            return err_set(e, ERR_ARG,
                           "--check: there is no ground control point '%.*s'; the first is '%s'",
                           (int)(n < 80 ? n : 80), p, l->n ? l->gcps[0].name : "");
        p += n + (p[n] == ',');
    }
    return ERR_OK;
}
