/* The map of a store as one PMTiles file, for `citysplat export`.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_EXPORT_MAP_H
#define CLI_EXPORT_MAP_H

#include "core/base.h"

struct export_map {
    const char *output, *device;
    /* NULL: the store's default appearance, and the zooms of map.json; else zooms as "14-18" */
    const char *appearance, *zooms;
    int format; /* index into EXPORT_MAP_FORMATS */
    bool dense; /* tiles of 512 px, for dense screens */
};
#define EXPORT_MAP_FORMATS "webp|png|jpg"
/* Draws all tiles that touch the survey, as `citysplat serve` would, and writes them. ERR_ARG
 * (zooms), ERR_DATA (no ground), ERR_LIMIT (tiles), ERR_CANCEL, and the errors of nadir_open,
 * map_tile_make and pmtiles_*. */
enum err_code export_map(const char *store, const struct export_map *o, struct err *e) ERR_USE;

#endif
