/* The finest Gaussians of a tile store, tile by tile, as clients get them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_LEAVES_H
#define LAB_LEAVES_H

#include "core/splat/gauss.h"

struct leaves {         /* {0} is empty */
    struct gauss *tile; /* [n_tiles], ENU, each about its own centre */
    size_t n_tiles, n;  /* n: Gaussians of all tiles */
};
/* Reads all tiles without children. Call leaves_free afterwards, also after an error. ERR_DATA:
 * there are none. Other errors are those of store_open and store_read_gauss. */
enum err_code leaves_read(const char *store_path, struct leaves *out, struct err *e) ERR_USE;
void leaves_free(struct leaves *l);

#endif
