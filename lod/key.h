/* Tile keys: z/x/y of the Web Mercator quad tree (OGC WebMercatorQuad).
 *
 * The zoom identifies the level of detail: level 3 (finest) is at zoom Z, level 2 at Z-1, level 1
 * at Z-2, overviews below that until one tile holds the scene. A Gaussian belongs to the tile that
 * holds the longitude and latitude of its mean, half-open.
 *
 * Pure functions: no errors, any thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_KEY_H
#define LOD_KEY_H

#include <stdbool.h>
#include <stdint.h>

enum { KEY_ZOOM_MAX = 24 };
struct key {
    uint8_t z;
    uint32_t x, y; /* x grows east, y grows south */
};
/* Tile that holds a place: half-open; latitude clamped to +-85.0511 degrees. */
struct key key_at(double lon_deg, double lat_deg, uint8_t z);
struct key key_parent(struct key k);
/* z <= KEY_ZOOM_MAX and x, y < 2^z. */
bool key_valid(struct key k);
/* By z, then y, then x: negative, 0 or positive. */
int key_compare(struct key a, struct key b);
/* Where a place lies in the Mercator square: u grows east, v grows south, 0 to 1 each; latitude
 * clamped as above. And back. */
void key_place(double lon_deg, double lat_deg, double uv[2]);
void key_unplace(const double uv[2], double *lon_deg, double *lat_deg);
void key_center(struct key k, double *lon_deg, double *lat_deg);
void key_bounds(struct key k, double *west_deg, double *south_deg, double *east_deg,
                double *north_deg);
/* Length of a tile's edge on the ground at that latitude. */
double key_edge_m(double lat_deg, uint8_t z);
/* The zoom whose edge is nearest to edge_m, in log. */
uint8_t key_zoom_for(double lat_deg, double edge_m);

#endif
