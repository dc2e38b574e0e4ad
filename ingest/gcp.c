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

/* The first line of a CSV file: which field is what. False: it is no such line. */
static bool gcp_columns(char *text, struct gcp_table *t, int *epsg)
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
    char *field[GCP_FIELDS];
    size_t n = gcp_split(text, true, field);
    for (size_t c = 0; c < GCP_COLUMNS; c++)
        t->column[c] = SIZE_MAX;
    for (size_t i = 0; i < n; i++)
        for (size_t w = 0; w < sizeof words / sizeof *words; w++)
            if (!strcasecmp(field[i], words[w].word)) {
                t->column[words[w].column] = i;
                if (!strncasecmp(field[i], "lon", 3))
                    *epsg = GCP_LONLAT;
            }
    for (size_t c = 0; c < GCP_NAME; c++)
        if (t->column[c] == SIZE_MAX)
            return false;
    return true;
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

/* The point of a name, or without one of these coordinates; new where there is none yet. */
static enum err_code gcp_find(struct gcp_list *l, const char *name, const double at[3], size_t *out,
                              struct err *e)
{
    for (size_t i = 0; i < l->n; i++)
        if (*name ? !strcmp(l->gcps[i].name, name)
                  : !memcmp(l->gcps[i].at, at, sizeof l->gcps[i].at)) {
            *out = i;
            return ERR_OK;
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
        snprintf(g->name, sizeof g->name, "%.*s", GCP_NAME_MAX - 1, name);
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
    if (t->column[GCP_IMAGE] >= n || !*field[t->column[GCP_IMAGE]])
        return err_set(e, ERR_FORMAT, "%s: line %zu: no photograph is named", t->path, t->line);
    const char *name = t->column[GCP_NAME] < n ? field[t->column[GCP_NAME]] : "";
    struct gcp_mark m = {.x_px = v[GCP_PX], .y_px = v[GCP_PY]};
    snprintf(m.image, sizeof m.image, "%.*s", GCP_IMAGE_MAX - 1, field[t->column[GCP_IMAGE]]);
    enum err_code rc = gcp_find(l, name, v, &m.gcp, e);
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
    for (char *p = rc ? NULL : (char *)b.data, *next; p && !rc; p = next) {
        char line[GCP_LINE_MAX], copy[GCP_LINE_MAX];
        size_t n = strcspn(p, "\r\n");
        next = p[n] ? p + n + 1 : NULL;
        t.line += !(p[n] == '\n' && p > (char *)b.data && p[-1] == '\r' && n == 0);
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
        memcpy(copy, line, n + 1);
        if (head) {
            head = false;
            t.csv = strchr(line, ',') && gcp_columns(copy, &t, &out->epsg);
            if (t.csv)
                continue;
            for (size_t c = 0; c < GCP_COLUMNS; c++)
                t.column[c] = c;
            out->epsg = gcp_epsg(line);
            continue;
        }
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
