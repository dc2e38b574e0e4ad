/* PMTiles version 3: tiles of a web map in one file that any web server hands out by ranges.
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
    const char *metadata; /* a JSON object */
};
/* Where a tile comes in the file: zoom by zoom, within one along Hilbert's curve. z is at most
 * PMTILES_ZOOM_MAX. */
uint64_t pmtiles_id(uint8_t z, uint32_t x, uint32_t y);

struct pmtiles; /* one caller */
/* Begin the file at `path`, beside it. pmtiles_commit or pmtiles_abort it. ERR_IO, ERR_LIMIT
 * (path), ERR_MEM. */
enum err_code pmtiles_begin(const char *path, struct pmtiles **out, struct err *e) ERR_USE;
/* The next tile, of an id above all before. Bytes that were there already are kept once. ERR_ARG
 * (order, or no bytes), ERR_LIMIT (4 GiB), ERR_IO, ERR_MEM. */
enum err_code pmtiles_add(struct pmtiles *p, uint64_t id, const void *bytes, size_t n,
                          struct err *e) ERR_USE;
/* Directories, metadata, head; synced and renamed to its name. The same tiles are the same bytes.
 * *p is freed in any case. ERR_IO, ERR_MEM, ERR_LIMIT (metadata). */
enum err_code pmtiles_commit(struct pmtiles **p, const struct pmtiles_about *about,
                             struct err *e) ERR_USE;
void pmtiles_abort(struct pmtiles **p); /* nothing is left; accepts NULL inside */
/* Of those that were added: tiles, different ones, bytes of these. */
void pmtiles_count(const struct pmtiles *p, uint64_t *tiles, uint64_t *contents, uint64_t *bytes);

#endif
