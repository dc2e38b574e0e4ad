/* Which part of a store was surveyed: the ground of the finest tiles whose Gaussians are about as
 * fine as those of most. Training also leaves a few large Gaussians far around a city, for what
 * photographs see behind it: tiles of these are no survey.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_AREA_H
#define SURVEY_AREA_H

#include "lod/store.h"

#define AREA_COARSE 4.0 /* a tile with this many times the usual median sigma is background */

struct area {                  /* {0} is empty */
    const struct store *store; /* borrowed */
    bool *in;                  /* by index into store_tiles */
    size_t n_in;
    double west_deg, south_deg, east_deg, north_deg; /* around the tiles that are in */
    double floor_m, ceiling_m; /* ENU: nearly all of the surveyed lies between */
    double sigma_m;            /* usual median sigma: half of the Gaussians are in finer tiles */
};
/* area_free it. ERR_DATA when the store has no tiles, ERR_MEM. */
enum err_code area_make(const struct store *s, struct area *out, struct err *e) ERR_USE;
void area_free(struct area *a);
/* Is the place of this tile of the finest zoom surveyed? */
bool area_holds(const struct area *a, struct key finest);

#endif
