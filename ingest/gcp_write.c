/* Writes lists of ground control points: see gcp_write.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "ingest/gcp_write.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

enum gcp_form gcp_form_of(const char *path)
{
    const char *dot = strrchr(path, '.');
    return dot && !strcasecmp(dot, ".csv") ? GCP_FORM_CSV : GCP_FORM_ODM;
}

bool gcp_name_fits(enum gcp_form form, const char *name)
{
    for (const char *p = name; *p; p++)
        if ((unsigned char)*p < ' ' || strchr(form == GCP_FORM_ODM ? " \",;" : "\",;", *p))
            return false;
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

/* "EPSG:25832", with the heights' system where there is one. */
static enum err_code gcp_put_head(const struct gcp_list *l, enum gcp_form form, struct buf *b,
                                  struct err *e)
{
    if (!l->epsg)
        return err_set(e, ERR_DATA, "the coordinate system of the points is not known");
    buf_printf(b, form == GCP_FORM_CSV ? "# EPSG:%d" : "EPSG:%d", l->epsg);
    if (l->heights_epsg)
        buf_printf(b, "+%d", l->heights_epsg);
    buf_u8(b, '\n');
    if (form == GCP_FORM_CSV)
        buf_printf(b, "name,x,y,z,px,py,image,accuracy_xy,accuracy_z,accuracy_px\n");
    return ERR_OK;
}

static enum err_code gcp_check_name(enum gcp_form form, const char *what, const char *name,
                                    struct err *e)
{
    if (gcp_name_fits(form, name))
        return ERR_OK;
    return err_set(e, ERR_DATA, "%s '%s': a list of this form cannot hold the name, which has a %s",
                   what, name,
                   form == GCP_FORM_ODM ? "blank, comma, semicolon or quotation mark: write a .csv"
                                        : "comma, semicolon or quotation mark");
}

enum err_code gcp_write(const struct gcp_list *l, enum gcp_form form, struct buf *out,
                        struct err *e)
{
    enum err_code rc = gcp_put_head(l, form, out, e);
    for (size_t i = 0; !rc && i < l->n; i++) {
        const struct gcp *g = &l->gcps[i];
        size_t marks = 0;
        rc = gcp_check_name(form, "ground control point", g->name, e);
        for (size_t k = 0; !rc && k < l->n_marks; k++) {
            const struct gcp_mark *m = &l->marks[k];
            if (m->gcp != i)
                continue;
            rc = gcp_check_name(form, "photograph", m->image, e);
            marks++;
            (form == GCP_FORM_CSV ? gcp_put_csv : gcp_put_odm)(out, g, m);
        }
        if (!rc && !marks)
            gcp_put_bare(out, g);
    }
    return !rc ? buf_check(out, e) : rc;
}
