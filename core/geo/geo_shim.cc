/* WGS 84 by GeographicLib: the scene's local frame, and its place in ECEF.
 *
 * This is the only C++ in core. Nothing is kept between calls, because a LocalCartesian is cheap to
 * set up. No exception leaves this file.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/geo/geo.h"
#include "core/geo/gtx.h"
#include "core/shim.h"

#include <GeographicLib/Geocentric.hpp>
#include <GeographicLib/Geoid.hpp>
#include <GeographicLib/LocalCartesian.hpp>
#include <cmath>
#include <exception>
#include <memory>
#include <string>
#include <strings.h>
#include <vector>

namespace
{

enum err_code check_place(double lon_deg, double lat_deg, double h_m, struct err *e)
{
    if (!std::isfinite(lon_deg) || !std::isfinite(lat_deg) || !std::isfinite(h_m))
        return err_set(e, ERR_ARG, "geo: longitude, latitude or height is not a number");
    if (std::fabs(lat_deg) > 90)
        return err_set(e, ERR_ARG, "geo: latitude %.9g is outside -90..90 degrees", lat_deg);
    if (std::fabs(lon_deg) > 1080)
        return err_set(e, ERR_ARG, "geo: longitude %.9g is not in degrees", lon_deg);
    return ERR_OK;
}

} // namespace

extern "C" enum err_code geo_to_enu(const struct geo_origin *o, double lon_deg, double lat_deg,
                                    double h_m, double enu_m[3], struct err *e)
try {
    enum err_code rc = check_place(o->lon_deg, o->lat_deg, o->h_m, e);
    if (!rc)
        rc = check_place(lon_deg, lat_deg, h_m, e);
    if (rc)
        return rc;
    GeographicLib::LocalCartesian frame(o->lat_deg, o->lon_deg, o->h_m);
    frame.Forward(lat_deg, lon_deg, h_m, enu_m[0], enu_m[1], enu_m[2]);
    return ERR_OK;
}
SHIM_CATCH("geo: GeographicLib", ERR_INTERNAL)

extern "C" enum err_code geo_from_enu(const struct geo_origin *o, const double enu_m[3],
                                      double *lon_deg, double *lat_deg, double *h_m, struct err *e)
try {
    enum err_code rc = check_place(o->lon_deg, o->lat_deg, o->h_m, e);
    if (rc)
        return rc;
    if (!std::isfinite(enu_m[0]) || !std::isfinite(enu_m[1]) || !std::isfinite(enu_m[2]))
        return err_set(e, ERR_ARG, "geo: an ENU coordinate is not a number");
    GeographicLib::LocalCartesian frame(o->lat_deg, o->lon_deg, o->h_m);
    frame.Reverse(enu_m[0], enu_m[1], enu_m[2], *lat_deg, *lon_deg, *h_m);
    return ERR_OK;
}
SHIM_CATCH("geo: GeographicLib", ERR_INTERNAL)

extern "C" enum err_code geo_enu_to_ecef(const struct geo_origin *o, double m[16], struct err *e)
try {
    enum err_code rc = check_place(o->lon_deg, o->lat_deg, o->h_m, e);
    if (rc)
        return rc;
    std::vector<double> axes(9); /* row-major, columns east, north, up */
    double x, y, z;
    GeographicLib::Geocentric::WGS84().Forward(o->lat_deg, o->lon_deg, o->h_m, x, y, z, axes);
    for (int c = 0; c < 3; c++) {
        for (int r = 0; r < 3; r++)
            m[4 * c + r] = axes[3 * r + c];
        m[4 * c + 3] = 0;
    }
    m[12] = x;
    m[13] = y;
    m[14] = z;
    m[15] = 1;
    return ERR_OK;
}
SHIM_CATCH("geo: GeographicLib", ERR_INTERNAL)

extern "C" enum err_code geo_local_axes(const struct geo_origin *o, double lon_deg, double lat_deg,
                                        double rot[9], struct err *e)
try {
    enum err_code rc = check_place(o->lon_deg, o->lat_deg, o->h_m, e);
    if (!rc)
        rc = check_place(lon_deg, lat_deg, 0, e);
    if (rc)
        return rc;
    GeographicLib::LocalCartesian frame(o->lat_deg, o->lon_deg, o->h_m);
    std::vector<double> axes(9);
    double x, y, z;
    frame.Forward(lat_deg, lon_deg, o->h_m, x, y, z, axes);
    for (int i = 0; i < 9; i++)
        rot[i] = axes[i];
    return ERR_OK;
}
SHIM_CATCH("geo: GeographicLib", ERR_INTERNAL)

struct geoid {
    std::string name;
    std::unique_ptr<GeographicLib::Geoid> model;
    struct gtx *grid = NULL; /* instead of a model */
    ~geoid()
    {
        gtx_close(&grid);
    }
};

namespace
{

enum err_code open_grid(const char *path, const std::string &name, struct geoid **out,
                        struct err *e)
{
    auto g = std::make_unique<geoid>();
    g->name = name;
    enum err_code rc = gtx_open(path, &g->grid, e);
    if (!rc)
        *out = g.release();
    return rc;
}

bool ends_with(const std::string &s, const std::string &t)
{
    return s.size() >= t.size() && strcasecmp(s.c_str() + s.size() - t.size(), t.c_str()) == 0;
}

} // namespace

extern "C" enum err_code geoid_open(const char *name, struct geoid **out, struct err *e)
try {
    *out = NULL;
    std::string path(name);
    size_t slash = path.rfind('/');
    bool plain = slash == std::string::npos;
    std::string stem = plain ? path : path.substr(slash + 1), folder;
    if (ends_with(path, ".gtx"))
        return open_grid(name, stem.substr(0, stem.size() - 4), out, e);
    if (!plain)
        folder = path.substr(0, slash);
    if (stem.size() > 4 && stem.compare(stem.size() - 4, 4, ".pgm") == 0) { // GeographicLib adds it
        folder = folder.empty() ? "." : folder;
        stem.resize(stem.size() - 4);
    }
    char grid[4096];
    bool proj =
        folder.empty() && (stem == "egm96" || stem == "egm96-15") && gtx_find("egm96_15.gtx", grid);
    auto g = std::make_unique<geoid>();
    g->name = stem;
    try {
        g->model = std::make_unique<GeographicLib::Geoid>(stem, folder, true, true);
    } catch (const GeographicLib::GeographicErr &) {
        if (!proj)
            throw;
        return open_grid(grid, "egm96-15", out, e);
    }
    *out = g.release();
    return ERR_OK;
} catch (const std::bad_alloc &) {
    return err_set(e, ERR_MEM, "geoid %s: out of memory", name);
} catch (const std::exception &x) {
    return err_set(
        e, ERR_NOENT,
        "geoid %s: %s: give egm96, a model of GeographicLib, as egm2008-1, or the path of its "
        ".pgm (geographiclib-get-geoids fetches it), or a .gtx file of PROJ",
        name, x.what());
} catch (...) {
    return err_set(e, ERR_INTERNAL, "geoid %s: unknown exception", name);
}

extern "C" void geoid_close(struct geoid **g)
{
    delete *g;
    *g = NULL;
}

extern "C" const char *geoid_name(const struct geoid *g)
{
    return g->name.c_str();
}

extern "C" double geoid_above(const struct geoid *g, double lon_deg, double lat_deg)
try {
    return g->grid ? gtx_above(g->grid, lon_deg, lat_deg) : (*g->model)(lat_deg, lon_deg);
} catch (...) {
    return (double)NAN;
}
