/* Polygons of a GeoJSON file: what every option that takes an area reads.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_GEOJSON_H
#define CODEC_GEOJSON_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

enum { GEOJSON_CORNERS_MAX = 20000 }; /* of a ring */
struct geojson_edge {
    double from[2], to[2]; /* longitude, latitude */
    size_t polygon, ring;  /* which it is of */
};
struct geojson_area {           /* {0} is empty; geojson_free */
    struct geojson_edge *edges; /* ring after ring */
    size_t n, cap, n_polygons, n_rings;
};
/* Polygon, MultiPolygon, Feature, FeatureCollection or GeometryCollection, in longitude and
 * latitude; what is no polygon is passed over. ERR_NOENT, ERR_IO, ERR_LIMIT; ERR_FORMAT: no such
 * GeoJSON, no polygon in it, or another coordinate system; ERR_DATA: a ring that crosses itself or
 * has no area; each says which file and what to do; ERR_MEM. */
enum err_code geojson_read(const char *path, struct geojson_area *out, struct err *e) ERR_USE;
/* The polygon of one ring [n]: longitude, latitude, the first position not repeated. ERR_DATA: it
 * crosses itself or has no area; ERR_MEM. */
enum err_code geojson_of_ring(const double (*at)[2], size_t n, struct geojson_area *out,
                              struct err *e) ERR_USE;
void geojson_free(struct geojson_area *a);
bool geojson_holds(const struct geojson_area *a, double lon_deg, double lat_deg); /* even-odd */

#endif
