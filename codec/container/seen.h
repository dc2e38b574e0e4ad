/* The number of photographs that see each place of a city (scene/cells/support.h), as a store
 * keeps it in its blob `seen` (docs/formats.md).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_SEEN_H
#define CODEC_SEEN_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct buf;

#define SEEN_BLOB "seen"
enum { SEEN_VIEWS_MAX = 8, SEEN_SIDE_MAX = 4096 };

struct seen_grid {              /* {0}: not known */
    double corner_m[2], cell_m; /* south-west corner of the grid, ENU; edge of a cell */
    uint32_t nx, ny;            /* 1 to SEEN_SIDE_MAX; row 0 is the southernmost */
    uint8_t *views;             /* [ny][nx] photographs, at most SEEN_VIEWS_MAX, which means more */
};
/* Appends the blob. ERR_ARG (sizes), ERR_MEM. */
enum err_code seen_encode(const struct seen_grid *s, struct buf *out, struct err *e) ERR_USE;
/* Reads a blob. Free *out with seen_free. ERR_FORMAT, ERR_MEM. */
enum err_code seen_decode(const void *bytes, size_t n, struct seen_grid *out,
                          struct err *e) ERR_USE;
void seen_free(struct seen_grid *s);
/* Photographs that see a place (ENU metres), 0 to SEEN_VIEWS_MAX, interpolated between the middles
 * of cells. Outside of the grid, and where nothing is known, SEEN_VIEWS_MAX. */
double seen_at(const struct seen_grid *s, double east_m, double north_m);

#endif
