/* Tile keys: the Web Mercator quad tree (OGC WebMercatorQuad, the z/x/y of web maps).
 *
 * The column is floor(u 2^z) with u = lon / 360 + 1/2. The row is floor(v 2^z) with v = 1/2 -
 * asinh(tan lat) / 2 pi. u and v are computed once in double, and scaling by 2^z is exact. A tile
 * at zoom z is therefore always the ancestor of the tile at a finer zoom: key_at(p, z) ==
 * key_parent(key_at(p, z + 1)). The pyramid depends on that.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>

#include "lod/store/key.h"

#define KEY_PI 3.14159265358979323846
#define KEY_LAT_MAX_DEG 85.05112877980659 /* where the Mercator square ends: atan(sinh(pi)) */
#define KEY_EQUATOR_M (2.0 * KEY_PI * 6378137.0)

/* floor(t * 2^z), kept inside the row or column; a NaN goes to 0. */
static uint32_t key_cell(double t, uint8_t z)
{
    double n = ldexp(1.0, z), cell = floor(t * n);
    if (!(cell >= 0.0))
        return 0;
    return cell < n ? (uint32_t)cell : (uint32_t)(n - 1.0);
}

void key_place(double lon_deg, double lat_deg, double uv[2])
{
    double lat = fmin(fmax(lat_deg, -KEY_LAT_MAX_DEG), KEY_LAT_MAX_DEG) * (KEY_PI / 180.0);
    uv[0] = lon_deg / 360.0 + 0.5;
    uv[1] = 0.5 - asinh(tan(lat)) / (2.0 * KEY_PI);
}

struct key key_at(double lon_deg, double lat_deg, uint8_t z)
{
    double uv[2];
    key_place(lon_deg, lat_deg, uv);
    if (z > KEY_ZOOM_MAX)
        z = KEY_ZOOM_MAX;
    return (struct key){.z = z, .x = key_cell(uv[0], z), .y = key_cell(uv[1], z)};
}

struct key key_parent(struct key k)
{
    if (k.z == 0)
        return k;
    return (struct key){.z = (uint8_t)(k.z - 1), .x = k.x >> 1, .y = k.y >> 1};
}

bool key_valid(struct key k)
{
    return k.z <= KEY_ZOOM_MAX && k.x < (UINT32_C(1) << k.z) && k.y < (UINT32_C(1) << k.z);
}

int key_compare(struct key a, struct key b)
{
    if (a.z != b.z)
        return a.z < b.z ? -1 : 1;
    if (a.y != b.y)
        return a.y < b.y ? -1 : 1;
    return a.x < b.x ? -1 : a.x > b.x;
}

static double key_lat_deg(double v)
{
    return atan(sinh(KEY_PI * (1.0 - 2.0 * v))) * (180.0 / KEY_PI);
}

void key_unplace(const double uv[2], double *lon_deg, double *lat_deg)
{
    *lon_deg = (uv[0] - 0.5) * 360.0;
    *lat_deg = key_lat_deg(uv[1]);
}

void key_center(struct key k, double *lon_deg, double *lat_deg)
{
    double n = ldexp(1.0, k.z);
    *lon_deg = (k.x + 0.5) / n * 360.0 - 180.0;
    *lat_deg = key_lat_deg((k.y + 0.5) / n);
}

void key_bounds(struct key k, double *west_deg, double *south_deg, double *east_deg,
                double *north_deg)
{
    double n = ldexp(1.0, k.z);
    *west_deg = k.x / n * 360.0 - 180.0;
    *east_deg = (k.x + 1.0) / n * 360.0 - 180.0;
    *north_deg = key_lat_deg(k.y / n);
    *south_deg = key_lat_deg((k.y + 1.0) / n);
}

double key_edge_m(double lat_deg, uint8_t z)
{
    double lat = fmin(fmax(lat_deg, -KEY_LAT_MAX_DEG), KEY_LAT_MAX_DEG) * (KEY_PI / 180.0);
    return ldexp(KEY_EQUATOR_M * cos(lat), -(int)z);
}

uint8_t key_zoom_for(double lat_deg, double edge_m)
{
    double z = round(log2(key_edge_m(lat_deg, 0) / edge_m));
    if (!(z > 0.0))
        return 0;
    return z < KEY_ZOOM_MAX ? (uint8_t)z : KEY_ZOOM_MAX;
}
