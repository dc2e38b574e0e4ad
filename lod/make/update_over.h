/* Overviews of tiles that an update changed. Internal to lod/.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_UPDATE_OVER_H
#define LOD_UPDATE_OVER_H

#include "core/err.h"

struct update;

/* Makes the affected tiles above the given levels again, one zoom after another, up to the store's
 * top. ERR_MEM, ERR_FORMAT, ERR_IO, ERR_LIMIT as in store_read_gauss and simplify_gauss. */
enum err_code update_overviews(struct update *u, struct err *e) ERR_USE;

#endif
