/* Finds the coordinate system that a text describes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CONTROL_WKT_H
#define SCENE_CONTROL_WKT_H

#include <stdbool.h>

/* The EPSG codes of a system in OGC's well-known text, of versions 1 and 2: its own, and that of
 * its heights if it is compound. 0: the text gives none. Returns false if this is no such text. */
bool wkt_epsg(const char *wkt, int *epsg, int *heights);
/* As wkt_epsg, from any text that names a system: well-known text, "EPSG:25832+7837", "EPSG 32632",
 * "WGS84 UTM 32N", "WGS 84 / UTM zone 32N", "+proj=utm +zone=32 +datum=WGS84", "+proj=longlat ...",
 * and Metashape's "# CoordinateSystem: ...", in any case. Returns false if the code is not known:
 * a shift, another ellipsoid, meridian or unit makes another system, whatever its datum's name. */
bool wkt_system(const char *text, int *epsg, int *heights);

#endif
