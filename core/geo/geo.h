/* Geodesy by GeographicLib: WGS 84 and the scene's local east-north-up frame. All in double.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_GEO_H
#define CORE_GEO_H

#include "core/err.h"

#ifdef __cplusplus
extern "C" {
#endif

struct geo_origin { /* origin of the ENU frame; h_m is ellipsoidal */
    double lon_deg, lat_deg, h_m;
};

/* Convert between longitude, latitude, ellipsoidal height and ENU metres about the origin
 * (GeographicLib's LocalCartesian). ERR_ARG: a latitude is outside [-90, 90], or a value is not
 * finite. */
enum err_code geo_to_enu(const struct geo_origin *o, double lon_deg, double lat_deg, double h_m,
                         double enu_m[3], struct err *e) ERR_USE;
enum err_code geo_from_enu(const struct geo_origin *o, const double enu_m[3], double *lon_deg,
                           double *lat_deg, double *h_m, struct err *e) ERR_USE;
/* The transform ENU -> ECEF at the origin, as a column-major 4x4 matrix: root.transform of 3D
 * Tiles. ERR_ARG. */
enum err_code geo_enu_to_ecef(const struct geo_origin *o, double m[16], struct err *e) ERR_USE;
/* Rotation from the ENU frame at (lon, lat) to that of the origin, row-major. Its columns are east,
 * north and up at (lon, lat). Cameras far from the origin that are given by heading and pitch need
 * it. ERR_ARG. */
enum err_code geo_local_axes(const struct geo_origin *o, double lon_deg, double lat_deg,
                             double rot[9], struct err *e) ERR_USE;

/* A model of the geoid: the height of mean sea level above the ellipsoid. */
struct geoid;
/* Reads a geoid. `name` is the path of a .gtx grid or of a .pgm file of GeographicLib, or a model
 * of GeographicLib such as "egm96-5" or "egm2008-1" in its own folder (GEOGRAPHICLIB_GEOID_PATH, or
 * share/GeographicLib/geoids). If there is no file for "egm96", PROJ's grid is used. The file is
 * read whole, so that any thread may use it. Close it with geoid_close. ERR_NOENT: there is no such
 * file or it is no geoid; the message says what to do. ERR_FORMAT, ERR_IO, ERR_LIMIT: a grid cannot
 * be read. ERR_MEM. */
enum err_code geoid_open(const char *name, struct geoid **out, struct err *e) ERR_USE;
void geoid_close(struct geoid **g);
const char *geoid_name(const struct geoid *g);
/* Height of the geoid above the ellipsoid in metres. NAN: not a place on earth. Height above sea
 * level = ellipsoidal height - this. */
double geoid_above(const struct geoid *g, double lon_deg, double lat_deg);

#ifdef __cplusplus
}
#endif
#endif
