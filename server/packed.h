/* A dataset in one exported file: a 3TZ (3D Tiles) or a PMTiles (map). The file lies on this
 * machine or at an address, as a tile store may (lod/remote.h).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_PACKED_H
#define SERVER_PACKED_H

#include "codec/pmtiles_read.h"
#include "codec/unzip.h"
#include "lod/store.h"
#include "server/format.h"

enum packed_kind { PACKED_NONE, PACKED_TILES, PACKED_MAP };
/* By the end of a path or address, without a query: .3tz or .pmtiles. */
enum packed_kind packed_kind_of(const char *path);

struct packed;       /* any thread */
struct packed_part { /* a file of a 3TZ, or a tile of a map */
    struct hash128 name;
    const struct unzip_file *file; /* NULL: of a map */
    struct pmtiles_place place;
    size_t size_bytes;
};
struct packed_about {
    struct store_meta meta; /* name, attribution, revision, origin */
    double bbox[6];         /* west south hmin east north hmax */
    struct hash128 hash;    /* of all that determines the bytes */
    uint64_t n_tiles;
    size_t largest_bytes; /* of a part */
    /* of a map: */
    uint8_t zoom_min, zoom_max, zoom_center;
    enum format format;
    uint32_t tile_px;
};

/* Opens a file, for `readers` threads. Its name without the ending is that of the dataset. ERR_ARG
 * (that is no name of a dataset), ERR_NOENT, ERR_FORMAT (damaged, cut short, or not as this program
 * exports it), ERR_LIMIT, ERR_IO, ERR_BUSY, ERR_MEM. */
enum err_code packed_open(const char *path, size_t readers, struct packed **out,
                          struct err *e) ERR_USE;
void packed_close(struct packed **p);
enum packed_kind packed_kind(const struct packed *p);
const struct packed_about *packed_about(const struct packed *p); /* borrowed */
const char *packed_shown(const struct packed *p);                /* path or address, for messages */
/* Appends the entry of a 3TZ, tileset.json, in which addresses begin with `prefix`. ERR_MEM. */
enum err_code packed_entry(const struct packed *p, const char *prefix, struct buf *out,
                           struct err *e) ERR_USE;
/* Finds a file of a 3TZ by its name [n]. False: there is none. */
bool packed_find_file(const struct packed *p, const char *name, size_t n, struct packed_part *out);
/* Finds a tile of a map. False: there is none. */
bool packed_find_tile(const struct packed *p, struct key k, struct packed_part *out);
/* Reads a part; the caller frees `out`. ERR_BUSY: its server does not send it now. ERR_FORMAT,
 * ERR_IO, ERR_MEM. */
enum err_code packed_read(struct packed *p, const struct packed_part *part, struct buf *out,
                          struct err *e) ERR_USE;
/* As store_replaced and store_ask. One thread at a time may ask. */
bool packed_replaced(const struct packed *p);
enum err_code packed_ask(struct packed *p, double wait_s, struct err *e) ERR_USE;

#endif
