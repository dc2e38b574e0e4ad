/* The finest Gaussians of a tile store, as clients get them: tile by tile.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef BENCH_LEAVES_H
#define BENCH_LEAVES_H

#include "core/gauss.h"

struct leaves {         /* {0} is empty */
    struct gauss *tile; /* [n_tiles], ENU about each one's centre */
    size_t n_tiles, n;  /* n: Gaussians of all */
};
/* Tiles without children. ERR_DATA when there are none. leaves_free it, also after an error. */
enum err_code leaves_read(const char *store_path, struct leaves *out, struct err *e) ERR_USE;
void leaves_free(struct leaves *l);

#endif
