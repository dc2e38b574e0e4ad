/* Ground control points in longitude and latitude: see control.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/scene/control.h"

#include <math.h>

#include "core/base.h"
#include "survey/crs.h"

/* One place, by a system that is named only now; its errors are answers. */
static enum err_code control_unproject_one(int epsg, double *x, double *y, struct err *e)
{
    struct crs *crs = NULL;
    enum err_code rc = crs_open_places(epsg, &crs, e);
    if (!rc)
        rc = crs_unproject(crs, 1, x, y, e);
    crs_close(&crs);
    return rc;
}

static bool control_like_degrees(double x, double y)
{
    return fabs(x) <= 180 && fabs(y) <= 90;
}

enum err_code control_unproject_place(const struct crs *crs, double *x, double *y, struct err *e)
{
    if (!crs_is_degrees(crs) && control_like_degrees(*x, *y))
        return err_set(e, ERR_ARG,
                       "%.9g %.9g looks like longitude and latitude, and EPSG:%d counts metres: "
                       "give the system of the coordinates, e.g. 4326",
                       *x, *y, crs_epsg(crs));
    return crs_unproject(crs, 1, x, y, e);
}

/* A system that is used elsewhere on Earth is the wrong one, or x and y are swapped. */
static void control_check_area(const struct crs *crs, const struct gcp *g)
{
    double off_deg = crs_outside_deg(crs, g->at[0], g->at[1]);
    if (off_deg > 3)
        log_warn("gcp",
                 "line %zu: ground control point %s lies %.0f degrees outside of where EPSG:%d is "
                 "used: another zone, x and y swapped, or feet?",
                 g->line, g->name, off_deg, crs_epsg(crs));
}

/* What is likely wrong with a point that lies nowhere in its system. */
static const char *control_suspicion(const struct gcp *g)
{
    const double zone = floor(g->file[0] / 1e6), rest = g->file[0] - 1e6 * zone;
    if (control_like_degrees(g->file[0], g->file[1]))
        return "degrees";
    return zone >= 1 && zone <= 60 && rest > 1e5 && rest < 9e5 && fabs(g->file[1]) < 1e7
               ? "do the eastings begin with the number of the zone"
               : "x and y swapped, feet, or millimetres";
}

/* The system as text, for files that have it so. Heights that PROJ does not know are left out here:
 * ingest refuses them. */
static enum err_code control_tell_system(struct crs *crs, struct gcp_list *l, struct err *e)
{
    if (l->heights_epsg && l->heights_epsg != CRS_ELLIPSOIDAL &&
        crs_set_vertical(crs, l->heights_epsg, NULL))
        log_debug("gcp", "EPSG:%d is no system of heights", l->heights_epsg);
    mem_free(l->wkt);
    l->wkt = NULL;
    return crs_wkt(crs, &l->wkt, e);
}

enum err_code control_unproject(const char *path, int epsg, struct gcp_list *l, struct err *e)
{
    struct crs *crs = NULL;
    enum err_code rc = ERR_OK;
    epsg = epsg ? epsg : l->epsg;
    if (!epsg)
        rc = err_set(e, ERR_ARG,
                     "%s: does not say its coordinate system in words known here: give it with "
                     "--gcp-epsg CODE, e.g. 32632, or 4326 for longitude and latitude",
                     path);
    if (!rc)
        rc = crs_split(&epsg, &l->heights_epsg, e);
    /* WGS 84 has a text of its own, unless its heights count from elsewhere */
    const bool plain = !l->heights_epsg || l->heights_epsg == CRS_ELLIPSOIDAL;
    if (!rc && !(epsg == GCP_LONLAT && plain))
        rc = crs_open_places(epsg, &crs, e);
    if (epsg && rc)
        err_add(e, "%s", path);
    l->degrees = !rc && (!crs || crs_is_degrees(crs));
    for (size_t i = 0; !rc && l->degrees && i < l->n; i++)
        if (fabs(l->gcps[i].at[0]) > 360 || fabs(l->gcps[i].at[1]) > 90)
            rc =
                err_set(e, ERR_ARG,
                        "%s: line %zu: ground control point %s: %.9g %.9g is no longitude and "
                        "latitude: name the coordinate system that these are in, or swap x and y",
                        path, l->gcps[i].line, l->gcps[i].name, l->gcps[i].at[0], l->gcps[i].at[1]);
    for (size_t i = 0; !rc && crs && i < l->n; i++) {
        struct gcp *g = &l->gcps[i];
        rc = control_unproject_place(crs, &g->at[0], &g->at[1], e);
        if (rc)
            err_add(e, "%s: line %zu: ground control point %s (%s?)", path, g->line, g->name,
                    control_suspicion(g));
        else
            control_check_area(crs, g);
    }
    if (!rc && crs)
        rc = control_tell_system(crs, l, e);
    l->epsg = epsg;
    l->unproject = control_unproject_one;
    crs_close(&crs);
    return rc;
}
