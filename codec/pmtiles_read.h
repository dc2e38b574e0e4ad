/* Reads PMTiles version 3 (pmtiles.h) from bytes that are read in parts: pictures of a web map. All
 * directories are read once.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_PMTILES_READ_H
#define CODEC_PMTILES_READ_H

#include "codec/pmtiles.h"
#include "codec/read_at.h"

/* runs of equal tiles, and bytes of one tile */
enum { PMTILES_READ_RUNS_MAX = 1 << 24, PMTILES_READ_BYTES_MAX = 64 << 20 };
struct pmtiles_read; /* immutable; any thread */
struct pmtiles_place {
    uint64_t at; /* in the file */
    uint32_t size_bytes;
};

/* Reads header, metadata and directories. Each tile must lie within the file. ERR_FORMAT (no
 * PMTiles, damaged, or with tiles that are no PNG, JPEG or WebP), ERR_LIMIT, ERR_MEM, and errors of
 * the source. */
enum err_code pmtiles_read_open(const struct read_at *from, struct pmtiles_read **out,
                                struct err *e) ERR_USE;
void pmtiles_read_close(struct pmtiles_read **p);
/* What the header and the metadata say; borrowed. */
const struct pmtiles_about *pmtiles_read_about(const struct pmtiles_read *p);
/* Hash of header, metadata and directories, and so of the sizes of all tiles, and of the first 64
 * KiB of tiles. The other tiles are not read. */
struct hash128 pmtiles_read_hash(const struct pmtiles_read *p);
uint64_t pmtiles_read_count(const struct pmtiles_read *p);   /* tiles */
uint32_t pmtiles_read_largest(const struct pmtiles_read *p); /* bytes of the largest tile */
/* False: there is no such tile. */
bool pmtiles_read_find(const struct pmtiles_read *p, uint64_t id, struct pmtiles_place *out);

#endif
