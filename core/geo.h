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

struct geo_origin { /* of the ENU frame; ellipsoidal height */
    double lon_deg, lat_deg, h_m;
};

/* Longitude/latitude/height <-> ENU metres about the origin (GeographicLib LocalCartesian).
 * ERR_ARG when a latitude is outside [-90, 90] or anything is not finite. */
enum err_code geo_to_enu(const struct geo_origin *o, double lon_deg, double lat_deg, double h_m,
                         double enu_m[3], struct err *e) ERR_USE;
enum err_code geo_from_enu(const struct geo_origin *o, const double enu_m[3], double *lon_deg,
                           double *lat_deg, double *h_m, struct err *e) ERR_USE;
/* ENU -> ECEF at the origin as a column-major 4x4 (3D Tiles' root.transform). ERR_ARG. */
enum err_code geo_enu_to_ecef(const struct geo_origin *o, double m[16], struct err *e) ERR_USE;
/* Rotation of the ENU frame at (lon, lat) expressed in the origin's ENU frame, row-major: columns
 * are that place's east, north and up. For cameras given by heading and pitch far from the origin.
 * ERR_ARG. */
enum err_code geo_local_axes(const struct geo_origin *o, double lon_deg, double lat_deg,
                             double rot[9], struct err *e) ERR_USE;

/* A model of the geoid: how high mean sea level lies above the ellipsoid. */
struct geoid;
/* NAME.pgm as GeographicLib has it ("egm96-5", "egm2008-1"), in a folder; dir NULL: GeographicLib's
 * own (GEOGRAPHICLIB_GEOID_PATH, or share/GeographicLib/geoids). Read whole, so that any thread may
 * ask. geoid_close it. ERR_NOENT: no such file, or not one of a geoid: says what to do; ERR_MEM. */
enum err_code geoid_open(const char *name, const char *dir, struct geoid **out,
                         struct err *e) ERR_USE;
void geoid_close(struct geoid **g);
const char *geoid_name(const struct geoid *g);
/* Metres; NAN where the place is none. Sea-level height = ellipsoidal height - this. */
double geoid_above(const struct geoid *g, double lon_deg, double lat_deg);

#ifdef __cplusplus
}
#endif
#endif
