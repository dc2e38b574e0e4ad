/* Many places to tile keys, quickly: internal to lod/.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_LOCATE_H
#define LOD_LOCATE_H

#include "core/geo.h"
#include "lod/key.h"

struct locate {
    struct geo_origin origin;
    double ecef[16]; /* of ENU, column-major */
};
/* Errors as geo_enu_to_ecef: ERR_ARG. The struct is only read afterwards, by any thread. */
enum err_code locate_open(const struct geo_origin *origin, struct locate *out,
                          struct err *e) ERR_USE;
/* The tile at KEY_ZOOM_MAX of a place: always what key_at(geo_from_enu) says. ERR_ARG (not
 * finite). */
enum err_code locate_key(const struct locate *l, const double enu_m[3], struct key *out,
                         struct err *e) ERR_USE;

/* Tiles along the Morton curve: bits of x and y interleaved. */
uint64_t locate_code(struct key k);
struct key locate_decode(uint64_t code, uint8_t z);

#endif
