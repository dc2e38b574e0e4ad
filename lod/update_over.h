/* What is made of tiles that an update changed: internal to lod/.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_UPDATE_OVER_H
#define LOD_UPDATE_OVER_H

#include "core/err.h"

struct update;

/* Make everything above the given levels again, one zoom after the other, up to the store's top.
 * ERR_MEM; errors of store_read_gauss and simplify_gauss (ERR_FORMAT, ERR_IO, ERR_LIMIT). */
enum err_code update_overviews(struct update *u, struct err *e) ERR_USE;

#endif
