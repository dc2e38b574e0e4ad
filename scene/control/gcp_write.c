/* Writes lists of ground control points: see gcp_write.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/control/gcp_write.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

enum gcp_form gcp_form_of(const char *path)
{
    const char *dot = strrchr(path, '.');
    return dot && !strcasecmp(dot, ".csv")   ? GCP_FORM_CSV
           : dot && !strcasecmp(dot, ".xml") ? GCP_FORM_XML
                                             : GCP_FORM_ODM;
}

bool gcp_name_fits(enum gcp_form form, const char *name)
{
    static const char *const separators[] = {
        [GCP_FORM_ODM] = " \",;", [GCP_FORM_CSV] = "\",;", [GCP_FORM_XML] = ""};
    for (const char *p = name; *p; p++)
        if ((unsigned char)*p < ' ' || strchr(separators[form], *p))
            return false;
    if (form == GCP_FORM_XML)
        return *name;
    return *name && *name != '#' && name[strlen(name) - 1] != ' ' && *name != ' ';
}

/* The shortest text of plain digits that reads back as this number. */
static void gcp_put_number(struct buf *b, double v)
{
    char text[400];
    for (int digits = 0; digits < 18; digits++) {
        snprintf(text, sizeof text, "%.*f", digits, v);
        if (strtod(text, NULL) == v)
            break;
    }
    buf_printf(b, "%s", text);
}

static void gcp_put_numbers(struct buf *b, const double *v, size_t n, char between)
{
    for (size_t k = 0; k < n; k++) {
        gcp_put_number(b, v[k]);
        buf_u8(b, (unsigned char)between);
    }
}

static void gcp_put_sigma(struct buf *b, double v)
{
    buf_u8(b, ',');
    if (v > 0)
        gcp_put_number(b, v);
}

/* Without a mark a point can only be a comment: `ingest --gcp` expects a photograph. */
static void gcp_put_bare(struct buf *b, const struct gcp *g)
{
    buf_printf(b, "# not marked: ");
    gcp_put_numbers(b, g->file, 3, ' ');
    buf_printf(b, "%s\n", g->name);
}

static void gcp_put_csv(struct buf *b, const struct gcp *g, const struct gcp_mark *m)
{
    const double at[2] = {m->x_px, m->y_px};
    buf_printf(b, "%s,", g->name);
    gcp_put_numbers(b, g->file, 3, ',');
    gcp_put_numbers(b, at, 2, ',');
    buf_printf(b, "%s", m->image);
    gcp_put_sigma(b, g->sigma_m[0]);
    gcp_put_sigma(b, g->sigma_m[1]);
    gcp_put_sigma(b, m->sigma_px);
    buf_u8(b, '\n');
}

static void gcp_put_odm(struct buf *b, const struct gcp *g, const struct gcp_mark *m)
{
    const double at[2] = {m->x_px, m->y_px};
    gcp_put_numbers(b, g->file, 3, '\t');
    gcp_put_numbers(b, at, 2, '\t');
    buf_printf(b, "%s\t%s\n", m->image, g->name);
}

/* ---- Metashape ---- */

static void gcp_put_attr(struct buf *b, const char *name, const char *text)
{
    buf_printf(b, " %s=\"", name);
    buf_markup(b, text);
    buf_u8(b, '"');
}

static void gcp_put_number_attr(struct buf *b, const char *name, double v)
{
    buf_printf(b, " %s=\"", name);
    gcp_put_number(b, v);
    buf_u8(b, '"');
}

static void gcp_put_marker(struct buf *b, const struct gcp *g, size_t id)
{
    static const char *const axes[3] = {"x", "y", "z"};
    buf_printf(b, "      <marker id=\"%zu\"", id);
    gcp_put_attr(b, "label", g->name);
    buf_printf(b, ">\n        <reference");
    for (size_t k = 0; k < 3; k++)
        gcp_put_number_attr(b, axes[k], g->file[k]);
    if (g->sigma_m[0] > 0)
        gcp_put_number_attr(b, "sxy", g->sigma_m[0]);
    if (g->sigma_m[1] > 0)
        gcp_put_number_attr(b, "sz", g->sigma_m[1]);
    buf_printf(b, " enabled=\"%s\"/>\n      </marker>\n", g->check ? "false" : "true");
}

/* The first mark in the same photograph: its place is the photograph's id. */
static size_t gcp_first_mark(const struct gcp_list *l, size_t mark)
{
    size_t k = 0;
    while (strcmp(l->marks[k].image, l->marks[mark].image))
        k++;
    return k;
}

/* In the order in which Metashape writes it: cameras, markers, places, coordinate system. */
static enum err_code gcp_put_xml(const struct gcp_list *l, struct buf *b, struct err *e)
{
    static const char wgs84[] =
        "GEOGCS[\"WGS 84\",DATUM[\"World Geodetic System 1984\",SPHEROID[\"WGS "
        "84\",6378137,298.257223563,AUTHORITY[\"EPSG\",\"7030\"]],AUTHORITY[\"EPSG\",\"6326\"]],"
        "PRIMEM[\"Greenwich\",0,AUTHORITY[\"EPSG\",\"8901\"]],UNIT[\"degree\",0.01745329251994328,"
        "AUTHORITY[\"EPSG\",\"9102\"]],AUTHORITY[\"EPSG\",\"4326\"]]";
    const char *wkt = !l->wkt && l->epsg == GCP_LONLAT ? wgs84 : l->wkt;
    if (!wkt)
        return err_set(e, ERR_DATA, "EPSG:%d has no text for Metashape", l->epsg);
    buf_printf(b, "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<document version=\"1.2.0\">\n"
                  "  <chunk>\n    <cameras>\n");
    for (size_t k = 0; k < l->n_marks; k++)
        if (gcp_first_mark(l, k) == k) {
            buf_printf(b, "      <camera id=\"%zu\"", k);
            gcp_put_attr(b, "label", l->marks[k].image);
            buf_printf(b, "/>\n");
        }
    buf_printf(b, "    </cameras>\n    <markers>\n");
    for (size_t i = 0; i < l->n; i++)
        gcp_put_marker(b, &l->gcps[i], i);
    buf_printf(b, "    </markers>\n    <frames>\n      <frame id=\"0\">\n        <markers>\n");
    for (size_t i = 0; i < l->n; i++) {
        buf_printf(b, "          <marker marker_id=\"%zu\">\n", i);
        for (size_t k = 0; k < l->n_marks; k++)
            if (l->marks[k].gcp == i) {
                buf_printf(b, "            <location camera_id=\"%zu\" pinned=\"true\"",
                           gcp_first_mark(l, k));
                gcp_put_number_attr(b, "x", l->marks[k].x_px);
                gcp_put_number_attr(b, "y", l->marks[k].y_px);
                buf_printf(b, "/>\n");
            }
        buf_printf(b, "          </marker>\n");
    }
    buf_printf(b, "        </markers>\n      </frame>\n    </frames>\n    <reference>");
    buf_markup(b, wkt);
    buf_printf(b, "</reference>\n  </chunk>\n</document>\n");
    return ERR_OK;
}

/* ---- lines ---- */

/* "EPSG:25832", with the heights' system where there is one. */
static void gcp_put_head(const struct gcp_list *l, enum gcp_form form, struct buf *b)
{
    buf_printf(b, form == GCP_FORM_CSV ? "# EPSG:%d" : "EPSG:%d", l->epsg);
    if (l->heights_epsg)
        buf_printf(b, "+%d", l->heights_epsg);
    buf_u8(b, '\n');
    if (form == GCP_FORM_CSV)
        buf_printf(b, "name,x,y,z,px,py,image,accuracy_xy,accuracy_z,accuracy_px\n");
}

static enum err_code gcp_check_name(enum gcp_form form, const char *what, const char *name,
                                    struct err *e)
{
    if (gcp_name_fits(form, name))
        return ERR_OK;
    static const char *const has[] = {
        [GCP_FORM_ODM] = "has a blank, comma, semicolon or quotation mark: write a .csv or .xml",
        [GCP_FORM_CSV] = "has a comma, semicolon or quotation mark: write a .xml",
        [GCP_FORM_XML] = "is empty or has a control character"};
    return err_set(e, ERR_DATA, "%s '%s': a list of this form cannot hold the name, which %s", what,
                   name, has[form]);
}

/* A comment that gcp_read.h understands: no column of these forms holds it. */
static void gcp_put_checks(const struct gcp_list *l, struct buf *b)
{
    size_t n = 0;
    for (size_t i = 0; i < l->n; i++)
        if (l->gcps[i].check)
            buf_printf(b, "%s%s", n++ ? "," : GCP_CHECKS " ", l->gcps[i].name);
    if (n)
        buf_u8(b, '\n');
}

static void gcp_put_lines(const struct gcp_list *l, enum gcp_form form, struct buf *out)
{
    gcp_put_head(l, form, out);
    gcp_put_checks(l, out);
    for (size_t i = 0; i < l->n; i++) {
        const struct gcp *g = &l->gcps[i];
        size_t marks = 0;
        for (size_t k = 0; k < l->n_marks; k++)
            if (l->marks[k].gcp == i) {
                marks++;
                (form == GCP_FORM_CSV ? gcp_put_csv : gcp_put_odm)(out, g, &l->marks[k]);
            }
        if (!marks)
            gcp_put_bare(out, g);
    }
}

enum err_code gcp_write(const struct gcp_list *l, enum gcp_form form, struct buf *out,
                        struct err *e)
{
    enum err_code rc = ERR_OK;
    if (!l->epsg)
        rc = err_set(e, ERR_DATA, "the coordinate system of the points is not known");
    for (size_t i = 0; !rc && i < l->n; i++)
        rc = gcp_check_name(form, "ground control point", l->gcps[i].name, e);
    for (size_t k = 0; !rc && k < l->n_marks; k++)
        rc = gcp_check_name(form, "photograph", l->marks[k].image, e);
    if (!rc && form == GCP_FORM_XML)
        rc = gcp_put_xml(l, out, e);
    else if (!rc)
        gcp_put_lines(l, form, out);
    return !rc ? buf_check(out, e) : rc;
}
