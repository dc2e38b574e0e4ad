/* PMTiles version 3: the tiles of a web map in one file. Any web server can serve it by byte
 * ranges.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_PMTILES_H
#define CODEC_PMTILES_H

#include "core/base.h"

enum { PMTILES_ZOOM_MAX = 26 };
enum pmtiles_type { PMTILES_PNG = 2, PMTILES_JPEG = 3, PMTILES_WEBP = 4 };

struct pmtiles_about {
    enum pmtiles_type type;
    uint8_t zoom_min, zoom_max, zoom_center;
    double bbox_deg[4];   /* west south east north */
    const char *metadata; /* a JSON object, as text */
};
/* Position of a tile in the file. Tiles are sorted by zoom, and within a zoom along a Hilbert
 * curve. z is at most PMTILES_ZOOM_MAX. */
uint64_t pmtiles_id(uint8_t z, uint32_t x, uint32_t y);

struct pmtiles; /* only one thread may use it */
/* Begins the file `path` under another name. End with pmtiles_commit or pmtiles_abort. ERR_IO,
 * ERR_LIMIT (path), ERR_MEM. */
enum err_code pmtiles_begin(const char *path, struct pmtiles **out, struct err *e) ERR_USE;
/* Adds the next tile. Its id must be larger than all before. Equal bytes are stored once. ERR_ARG
 * (wrong order, or no bytes), ERR_LIMIT (4 GiB), ERR_IO, ERR_MEM. */
enum err_code pmtiles_add(struct pmtiles *p, uint64_t id, const void *bytes, size_t n,
                          struct err *e) ERR_USE;
/* Writes directories, metadata and header, then syncs and renames the file. The same tiles give the
 * same bytes. It frees *p in any case. ERR_IO, ERR_MEM, ERR_LIMIT (metadata). */
enum err_code pmtiles_commit(struct pmtiles **p, const struct pmtiles_about *about,
                             struct err *e) ERR_USE;
void pmtiles_abort(struct pmtiles **p); /* removes the file; *p may be NULL */
/* Counts of what was added: tiles, different contents, and their bytes. */
void pmtiles_count(const struct pmtiles *p, uint64_t *tiles, uint64_t *contents, uint64_t *bytes);

#endif
