/* The map of a store as one PMTiles file, for `citysplat export`.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_EXPORT_MAP_H
#define CLI_EXPORT_MAP_H

#include "core/base.h"

struct export_map {
    const char *output, *device;
    const char *appearance, *zooms; /* NULL: the store's; those of map.json. "14-18" */
    int format;                     /* of EXPORT_MAP_FORMATS, by its place */
    int quality;                    /* of webp and jpg */
    bool dense;                     /* 512 px a tile, for dense screens */
};
#define EXPORT_MAP_FORMATS "webp|png|jpg"
/* Draw every tile that touches the survey, as `citysplat serve` answers it, and write them. ERR_ARG
 * (zooms), ERR_DATA (no ground), ERR_LIMIT (tiles), ERR_CANCEL, and the errors of nadir_open,
 * map_tile_make and pmtiles_*. */
enum err_code export_map(const char *store, const struct export_map *o, struct err *e) ERR_USE;

#endif
