/* Fast conversion of many places to tile keys. Internal to lod/.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_LOCATE_H
#define LOD_LOCATE_H

#include "core/geo/geo.h"
#include "lod/store/key.h"

struct locate {
    struct geo_origin origin;
    double ecef[16]; /* ENU -> ECEF, column-major */
};
/* Prepares the conversion. Afterwards *out is only read, by any thread. ERR_ARG as in
 * geo_enu_to_ecef. */
enum err_code locate_open(const struct geo_origin *origin, struct locate *out,
                          struct err *e) ERR_USE;
/* The tile of a place at KEY_ZOOM_MAX. The result is always equal to key_at(geo_from_enu). ERR_ARG
 * (not finite). */
enum err_code locate_key(const struct locate *l, const double enu_m[3], struct key *out,
                         struct err *e) ERR_USE;

/* Number of a tile along the Morton curve: the bits of x and y interleaved. */
uint64_t locate_code(struct key k);
struct key locate_decode(uint64_t code, uint8_t z);

#endif
