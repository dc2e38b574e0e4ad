/* Map projections: see crs.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/crs.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base.h"
#include "survey/gdal_library.h"

struct crs {
    int epsg;
    OGRSpatialReferenceH wgs84, plane, compound; /* compound: NULL without heights */
    OGRCoordinateTransformationH to, from;
};

/* Norway's zone 32 takes three degrees of 31, and Svalbard has four wide zones. */
static int crs_zone(double lon_deg, double lat_deg)
{
    int zone = (int)floor((lon_deg + 180.0) / 6.0) + 1;
    if (lat_deg >= 56.0 && lat_deg < 64.0 && lon_deg >= 3.0 && lon_deg < 12.0)
        return 32;
    if (lat_deg >= 72.0 && lon_deg >= 0.0 && lon_deg < 42.0)
        return lon_deg < 9.0 ? 31 : lon_deg < 21.0 ? 33 : lon_deg < 33.0 ? 35 : 37;
    return zone < 1 ? 1 : zone > 60 ? 60 : zone;
}

int crs_utm(double lon_deg, double lat_deg)
{
    if (lat_deg >= 84.0)
        return 32661;
    if (lat_deg < -80.0)
        return 32761;
    return (lat_deg >= 0.0 ? 32600 : 32700) + crs_zone(lon_deg, lat_deg);
}

/* Longitude first, east first, whatever the authority says. */
static OGRSpatialReferenceH crs_reference(int epsg)
{
    OGRSpatialReferenceH r = gdal->OSRNewSpatialReference(NULL);
    if (r && gdal->OSRImportFromEPSG(r, epsg) != OGRERR_NONE) {
        gdal->OSRDestroySpatialReference(r);
        return NULL;
    }
    if (r)
        gdal->OSRSetAxisMappingStrategy(r, OAMS_TRADITIONAL_GIS_ORDER);
    return r;
}

static int crs_code(OGRSpatialReferenceH r, const char *node)
{
    const char *code = gdal->OSRGetAuthorityCode(r, node);
    return code ? (int)strtol(code, NULL, 10) : 0;
}

enum err_code crs_split(int *epsg, int *heights, struct err *e)
{
    if (!*epsg || *epsg == 4326) /* the library is not needed */
        return ERR_OK;
    enum err_code rc = gdal_load(e);
    if (rc)
        return rc;
    gdal_errors_keep();
    OGRSpatialReferenceH r = crs_reference(*epsg);
    const bool places = r && (gdal->OSRIsProjected(r) || gdal->OSRIsGeographic(r));
    if (places && gdal->OSRGetAxesCount(r) == 3) {
        const int vertical = crs_code(r, "VERT_CS"), up = vertical ? vertical : CRS_ELLIPSOIDAL;
        const int plane = gdal->OSRDemoteTo2D(r, NULL) == OGRERR_NONE ? crs_code(r, NULL) : 0;
        if (!plane)
            rc = err_set(e, ERR_ARG,
                         "EPSG:%d: its plane has no code: give the codes of plane and heights, "
                         "e.g. EPSG:25832+7837",
                         *epsg);
        else if (*heights && *heights != up)
            rc = err_set(e, ERR_ARG,
                         "EPSG:%d has heights of EPSG:%d, and EPSG:%d is named for them: name one "
                         "of them, with the plane's code EPSG:%d",
                         *epsg, up, *heights, plane);
        if (!rc) {
            *epsg = plane;
            *heights = up;
        }
    }
    if (r)
        gdal->OSRDestroySpatialReference(r);
    gdal_errors_show();
    return rc;
}

static bool crs_degrees(OGRSpatialReferenceH r)
{
    return gdal->OSRIsGeographic(r) && fabs(gdal->OSRGetAngularUnits(r, NULL) - M_PI / 180) < 1e-12;
}

static enum err_code crs_check_axes(const struct crs *c, bool degrees, struct err *e)
{
    int plane = c->epsg, heights = 0;
    const bool metres = gdal->OSRIsProjected(c->plane) &&
                        fabs(gdal->OSRGetLinearUnits(c->plane, NULL) - 1.0) <= 1e-9;
    if (degrees && !metres && !crs_degrees(c->plane))
        return err_set(e, ERR_ARG,
                       "EPSG:%d: neither a projection in metres nor longitude and latitude in "
                       "degrees: convert the coordinates to such a system, e.g. by gdaltransform",
                       c->epsg);
    if (!degrees && !metres)
        return err_set(e, ERR_ARG,
                       "EPSG:%d: not a projection in metres; use one, e.g. 326xx or 327xx (UTM) or "
                       "the country's own",
                       c->epsg);
    if (!degrees && gdal->OSRGetAxesCount(c->plane) == 3) {
        enum err_code rc = crs_split(&plane, &heights, e);
        return !rc ? err_set(e, ERR_ARG,
                             "EPSG:%d: has heights of its own, and heights of a map are those of "
                             "its scene: give the plane alone, EPSG:%d",
                             c->epsg, plane)
                   : rc;
    }
    return ERR_OK;
}

static enum err_code crs_open_as(int epsg, bool degrees, struct crs **out, struct err *e)
{
    *out = NULL;
    enum err_code rc = gdal_load(e);
    if (rc)
        return rc;
    struct crs *c = mem_array(1, sizeof *c);
    if (!c)
        return err_set(e, ERR_MEM, "EPSG:%d: out of memory", epsg);
    gdal_errors_keep();
    c->epsg = epsg;
    c->wgs84 = crs_reference(4326);
    c->plane = crs_reference(epsg);
    if (!c->wgs84)
        rc = err_set(e, ERR_IO, "EPSG:4326: PROJ finds no database of coordinate systems");
    else if (!c->plane)
        rc = err_set(e, ERR_ARG,
                     "EPSG:%d: no such coordinate system; e.g. 32632 is UTM zone 32 north", epsg);
    else
        rc = crs_check_axes(c, degrees, e);
    if (!rc) {
        c->to = gdal->OCTNewCoordinateTransformation(c->wgs84, c->plane);
        c->from = gdal->OCTNewCoordinateTransformation(c->plane, c->wgs84);
        if (!c->to || !c->from)
            rc = err_set(e, ERR_ARG, "EPSG:%d: PROJ knows no way from WGS 84: %s", epsg,
                         gdal->CPLGetLastErrorMsg());
    }
    gdal_errors_show();
    if (rc)
        crs_close(&c);
    *out = c;
    return rc;
}

enum err_code crs_open(int epsg, struct crs **out, struct err *e)
{
    return crs_open_as(epsg, false, out, e);
}

enum err_code crs_open_places(int epsg, struct crs **out, struct err *e)
{
    return crs_open_as(epsg, true, out, e);
}

void crs_close(struct crs **cp)
{
    struct crs *c = *cp;
    if (!c)
        return;
    if (c->to)
        gdal->OCTDestroyCoordinateTransformation(c->to);
    if (c->from)
        gdal->OCTDestroyCoordinateTransformation(c->from);
    if (c->wgs84)
        gdal->OSRDestroySpatialReference(c->wgs84);
    if (c->plane)
        gdal->OSRDestroySpatialReference(c->plane);
    if (c->compound)
        gdal->OSRDestroySpatialReference(c->compound);
    mem_free(c);
    *cp = NULL;
}

int crs_epsg(const struct crs *c)
{
    return c->epsg;
}

bool crs_is_degrees(const struct crs *c)
{
    return gdal->OSRIsGeographic(c->plane);
}

double crs_outside_deg(const struct crs *c, double lon_deg, double lat_deg)
{
    double west, south, east, north;
    if (!gdal->OSRGetAreaOfUse(c->plane, &west, &south, &east, &north, NULL) || west < -180 ||
        east < west)
        return 0; /* not known, or across the date line */
    return fmax(fmax(west - lon_deg, lon_deg - east),
                fmax(fmax(south - lat_deg, lat_deg - north), 0));
}

const void *crs_handle(const struct crs *c)
{
    return c->plane;
}

int crs_vertical(const char *geoid)
{
    static const struct {
        const char *name;
        int epsg;
    } models[] = {{"egm84", 5798}, {"egm96", 5773}, {"egm2008", 3855}};
    size_t n = strcspn(geoid, "-"); /* what follows is the spacing of its grid, minutes */
    for (size_t i = 0; i < sizeof models / sizeof *models; i++)
        if (strlen(models[i].name) == n && !memcmp(models[i].name, geoid, n))
            return models[i].epsg;
    return 0;
}

enum err_code crs_set_vertical(struct crs *c, int epsg, struct err *e)
{
    OGRSpatialReferenceH up = crs_reference(epsg), both = gdal->OSRNewSpatialReference(NULL);
    const char *name = up ? gdal->OSRGetName(up) : NULL;
    OGRAxisOrientation axis = OAO_Other;
    char text[200];
    enum err_code rc = ERR_OK;
    if (!both)
        rc = err_set(e, ERR_MEM, "EPSG:%d: out of memory", epsg);
    else if (!name || !gdal->OSRIsVertical(up))
        rc = err_set(e, ERR_IO, "EPSG:%d: PROJ's database has no such heights", epsg);
    else if (gdal->OSRGetAxesCount(up) != 1 ||
             fabs(gdal->OSRGetLinearUnits(up, NULL) - 1.0) > 1e-9 ||
             !gdal->OSRGetAxis(up, NULL, 0, &axis) || axis != OAO_Up)
        rc = err_set(
            e, ERR_ARG,
            "EPSG:%d (%s): no system of heights in metres: give one, e.g. 5773, and heights "
            "that are in it",
            epsg, name);
    if (!rc)
        snprintf(text, sizeof text, "%s + %s", gdal->OSRGetName(c->plane), name);
    if (!rc && gdal->OSRSetCompoundCS(both, text, c->plane, up) != OGRERR_NONE)
        rc = err_set(e, ERR_IO, "EPSG:%d + EPSG:%d: %s", c->epsg, epsg, gdal->CPLGetLastErrorMsg());
    if (up)
        gdal->OSRDestroySpatialReference(up);
    if (rc && both)
        gdal->OSRDestroySpatialReference(both);
    if (rc)
        return rc;
    gdal->OSRSetAxisMappingStrategy(both, OAMS_TRADITIONAL_GIS_ORDER);
    if (c->compound)
        gdal->OSRDestroySpatialReference(c->compound);
    c->compound = both;
    return ERR_OK;
}

const void *crs_with_heights(const struct crs *c)
{
    return c->compound ? c->compound : c->plane;
}

enum err_code crs_wkt(const struct crs *c, char **out, struct err *e)
{
    char *text = NULL;
    OGRSpatialReferenceH r = (OGRSpatialReferenceH)(uintptr_t)crs_with_heights(c);
    *out = gdal->OSRExportToWkt(r, &text) == OGRERR_NONE && text ? mem_text(text) : NULL;
    gdal->CPLFree(text);
    return *out ? ERR_OK : err_set(e, ERR_MEM, "EPSG:%d: out of memory for its text", c->epsg);
}

static enum err_code crs_apply(const struct crs *c, OGRCoordinateTransformationH t, size_t n,
                               double *x, double *y, struct err *e)
{
    enum { BATCH = 256 };
    for (size_t from = 0; from < n; from += BATCH) {
        double x0[BATCH], y0[BATCH];
        int ok[BATCH];
        size_t many = n - from < BATCH ? n - from : BATCH;
        memcpy(x0, x + from, many * sizeof *x0);
        memcpy(y0, y + from, many * sizeof *y0);
        gdal_errors_keep();
        gdal->OCTTransformEx(t, (int)many, x + from, y + from, NULL, ok);
        gdal_errors_show();
        for (size_t i = 0; i < many; i++)
            if (!ok[i] || !isfinite(x[from + i]) || !isfinite(y[from + i]))
                return err_set(e, ERR_ARG, "EPSG:%d: it does not reach the place %.9g %.9g",
                               c->epsg, x0[i], y0[i]);
    }
    return ERR_OK;
}

enum err_code crs_project(const struct crs *c, size_t n, double *x, double *y, struct err *e)
{
    return crs_apply(c, c->to, n, x, y, e);
}

enum err_code crs_unproject(const struct crs *c, size_t n, double *x, double *y, struct err *e)
{
    return crs_apply(c, c->from, n, x, y, e);
}
