/* Tile keys: z/x/y of the Web Mercator quad tree (OGC WebMercatorQuad).
 *
 * The zoom gives the level of detail: level 3 (finest) is at zoom Z, level 2 at Z-1, level 1 at
 * Z-2. Overviews are at the zooms below, down to one tile for the scene. A Gaussian belongs to the
 * tile that contains the longitude and latitude of its mean, half-open.
 *
 * Functions are pure: they cannot fail, and any thread may call them.
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
/* The tile of a place, half-open. Latitude is clamped to +-85.0511 degrees. */
struct key key_at(double lon_deg, double lat_deg, uint8_t z);
struct key key_parent(struct key k);
/* Returns whether z <= KEY_ZOOM_MAX and x, y < 2^z. */
bool key_valid(struct key k);
/* Compares by z, then y, then x. Returns a negative number, 0 or a positive number. */
int key_compare(struct key a, struct key b);
/* Convert a place to the Mercator square and back: u grows east, v grows south, both 0 to 1.
 * Latitude is clamped as in key_at. */
void key_place(double lon_deg, double lat_deg, double uv[2]);
void key_unplace(const double uv[2], double *lon_deg, double *lat_deg);
void key_center(struct key k, double *lon_deg, double *lat_deg);
void key_bounds(struct key k, double *west_deg, double *south_deg, double *east_deg,
                double *north_deg);
/* Length in metres of a tile's edge on the ground at this latitude. */
double key_edge_m(double lat_deg, uint8_t z);
/* The zoom whose tile edge is nearest to edge_m, in logarithms. */
uint8_t key_zoom_for(double lat_deg, double edge_m);

#endif
