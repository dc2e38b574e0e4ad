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

#ifdef __cplusplus
}
#endif
#endif
