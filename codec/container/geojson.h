/* Polygons of a GeoJSON file. Every option that takes an area reads it with geojson_read.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_GEOJSON_H
#define CODEC_GEOJSON_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

enum { GEOJSON_CORNERS_MAX = 20000 }; /* of one ring */
struct geojson_edge {
    double from[2], to[2]; /* longitude, latitude, or what they were projected to */
    size_t polygon, ring;  /* numbers of its polygon and ring, which do not fall */
};
struct geojson_area {           /* {0} is empty; free with geojson_free */
    struct geojson_edge *edges; /* ring after ring */
    size_t n, cap, n_polygons, n_rings;
};
/* Reads a Polygon, MultiPolygon, Feature, FeatureCollection or GeometryCollection in longitude and
 * latitude. Other geometries, and features whose geometry is null, are skipped. Messages name the
 * file and say what to do. ERR_NOENT, ERR_IO, ERR_LIMIT, ERR_MEM. ERR_FORMAT: it is not GeoJSON of
 * one of these types, has no polygon or uses another coordinate system. ERR_DATA: a ring crosses
 * itself or has no area. */
enum err_code geojson_read(const char *path, struct geojson_area *out, struct err *e) ERR_USE;
/* Makes a polygon of one ring [n] of longitude and latitude. The first position is not repeated at
 * the end. ERR_DATA: it crosses itself or has no area. ERR_MEM. */
enum err_code geojson_of_ring(const double (*at)[2], size_t n, struct geojson_area *out,
                              struct err *e) ERR_USE;
void geojson_free(struct geojson_area *a);
/* Whether the place, in the edges' units, is inside of a polygon: in its outer ring and not in a
 * hole. Polygons may overlap, or lie in each other. */
bool geojson_holds(const struct geojson_edge *edges, size_t n, double x, double y);

#endif
