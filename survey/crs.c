/* Map projections: see crs.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/crs.h"

#include <math.h>

#include <gdal/cpl_error.h>
#include <gdal/ogr_srs_api.h>

#include "core/base.h"

struct crs {
    int epsg;
    OGRSpatialReferenceH wgs84, plane;
    OGRCoordinateTransformationH to, from;
};

int crs_utm(double lon_deg, double lat_deg)
{
    int zone = (int)floor((lon_deg + 180.0) / 6.0) + 1;
    zone = zone < 1 ? 1 : zone > 60 ? 60 : zone;
    return (lat_deg >= 0.0 ? 32600 : 32700) + zone;
}

/* Longitude first, east first, whatever the authority says. */
static OGRSpatialReferenceH crs_reference(int epsg)
{
    OGRSpatialReferenceH r = OSRNewSpatialReference(NULL);
    if (r && OSRImportFromEPSG(r, epsg) != OGRERR_NONE) {
        OSRDestroySpatialReference(r);
        return NULL;
    }
    if (r)
        OSRSetAxisMappingStrategy(r, OAMS_TRADITIONAL_GIS_ORDER);
    return r;
}

enum err_code crs_open(int epsg, struct crs **out, struct err *e)
{
    *out = NULL;
    struct crs *c = mem_array(1, sizeof *c);
    if (!c)
        return err_set(e, ERR_MEM, "EPSG:%d: out of memory", epsg);
    enum err_code rc = ERR_OK;
    CPLPushErrorHandler(CPLQuietErrorHandler);
    c->epsg = epsg;
    c->wgs84 = crs_reference(4326);
    c->plane = crs_reference(epsg);
    if (!c->wgs84)
        rc = err_set(e, ERR_IO, "EPSG:4326: PROJ finds no database of coordinate systems");
    else if (!c->plane)
        rc = err_set(e, ERR_ARG,
                     "EPSG:%d: no such coordinate system; e.g. 32632 is UTM zone 32 north", epsg);
    else if (!OSRIsProjected(c->plane) || fabs(OSRGetLinearUnits(c->plane, NULL) - 1.0) > 1e-9)
        rc = err_set(e, ERR_ARG,
                     "EPSG:%d: not a projection in metres; use one, e.g. 326xx or 327xx (UTM) or "
                     "the country's own",
                     epsg);
    if (!rc) {
        c->to = OCTNewCoordinateTransformation(c->wgs84, c->plane);
        c->from = OCTNewCoordinateTransformation(c->plane, c->wgs84);
        if (!c->to || !c->from)
            rc = err_set(e, ERR_ARG, "EPSG:%d: PROJ knows no way from WGS 84: %s", epsg,
                         CPLGetLastErrorMsg());
    }
    CPLPopErrorHandler();
    if (rc)
        crs_close(&c);
    *out = c;
    return rc;
}

void crs_close(struct crs **cp)
{
    struct crs *c = *cp;
    if (!c)
        return;
    if (c->to)
        OCTDestroyCoordinateTransformation(c->to);
    if (c->from)
        OCTDestroyCoordinateTransformation(c->from);
    if (c->wgs84)
        OSRDestroySpatialReference(c->wgs84);
    if (c->plane)
        OSRDestroySpatialReference(c->plane);
    mem_free(c);
    *cp = NULL;
}

int crs_epsg(const struct crs *c)
{
    return c->epsg;
}

const void *crs_handle(const struct crs *c)
{
    return c->plane;
}

static enum err_code crs_apply(const struct crs *c, OGRCoordinateTransformationH t, size_t n,
                               double *x, double *y, struct err *e)
{
    for (size_t i = 0; i < n; i++) {
        double x0 = x[i], y0 = y[i];
        CPLPushErrorHandler(CPLQuietErrorHandler);
        int ok = OCTTransform(t, 1, x + i, y + i, NULL);
        CPLPopErrorHandler();
        if (!ok || !isfinite(x[i]) || !isfinite(y[i]))
            return err_set(e, ERR_ARG, "EPSG:%d: it does not reach the place %.9g %.9g", c->epsg,
                           x0, y0);
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
