/* Shared by the parts of the tile store: store_read.c and store_index.c read, store_build.c writes,
 * store_verify.c checks. Internal to lod/.
 *
 * The file is an SQLite database:
 *
 *     application_id  "CSPT"     user_version  schema, STORE_SCHEMA
 *     meta   key, value          name, origin, degrees, zooms, revision, ... as text
 *                                (doubles with 17 digits)
 *     tiles  id                  zoom and Morton code of x, y; one row a tile
 *            index columns       see store_build.c
 *            hash                of the payload
 *            row_hash            over the index columns and that hash
 *            payload             see codec/splat/payload.h
 *     blobs  name, hash, bytes   data beside the tiles
 *
 * Hashes are XXH3-128, 16 bytes, low word first. Nothing is changed in place: a file is written
 * under another name and renamed, so a reader sees one revision.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_STORE_DB_H
#define LOD_STORE_DB_H

#include <sqlite3.h>

#include "lod/store/index.h"
#include "lod/store/store.h"
#include "lod/store/tree.h"

struct bake;
struct remote;

enum {
    STORE_APPLICATION_ID = 0x43535054, /* "CSPT" */
    STORE_SCHEMA = 2,
    STORE_PAGE_BYTES = 8192,
    STORE_HASH_BYTES = 16,
    STORE_ROW_BYTES = 48, /* least size of an index row: two hashes, lengths of 28 columns */
};

/* Sends data to the disk while a store is built: store_flush.c. */
struct store_flush {
    int fd;
    size_t waiting; /* bytes */
};
void store_flush_open(struct store_flush *f, const char *path);
void store_flush_wrote(struct store_flush *f, size_t bytes);
void store_flush_close(struct store_flush *f);

struct store {
    sqlite3 *db;
    sqlite3_stmt *get, *put, *get_blob;
    bool building;
    struct store_flush flush; /* while building */
    char *path;               /* path as the caller gave it; below FILE_PATH_MAX */
    char *part;               /* [FILE_PATH_MAX] while building: the file that is written */
    uint64_t size_bytes;      /* opened: size of the file */
    struct store_meta meta;
    struct index index; /* opened: sorted by key; building: in the order of store_put */
    struct tree tree;   /* only when opened */
    /* Opened: the appearance, which bake.c reads on first use; NULL: none. store_close frees it
     * with bake_free, which is NULL until then. */
    struct bake *bake;
    bool bake_known;
    void (*bake_free)(struct store *s);
    char *footprint;       /* opened: GeoJSON; NULL: none */
    char *clip;            /* opened: GeoJSON; NULL: none */
    bool borrows;          /* opened: index, tree and what the blobs say belong to another handle */
    struct remote *remote; /* opened from an address: its reader, which belongs to db; else NULL */
    /* building: the store that will be replaced, for tile versions; may be NULL */
    struct store *before;
};

/* A handle without a database; store_close frees it. `path` is below FILE_PATH_MAX. ERR_MEM. */
enum err_code store_alloc(const char *path, struct store **out, struct err *e) ERR_USE;
/* Sets ERR_IO, ERR_FORMAT, ERR_MEM or ERR_LIMIT by SQLite's code. The message is "PATH: WHAT:
 * sqlite's message". */
enum err_code store_db_fail(const struct store *s, int code, const char *what, struct err *e);
/* Row id of a tile. */
int64_t store_db_id(struct key k);
void store_db_hash_out(struct hash128 h, uint8_t out[STORE_HASH_BYTES]);
struct hash128 store_db_hash_in(const uint8_t in[STORE_HASH_BYTES]);
/* Hash over all members of t, to detect damaged index rows. */
struct hash128 store_db_row_hash(const struct store_entry *t);
/* Computes the revision: a hash over what is served, in fixed order: identity, origin, attribution,
 * every tile's row, sorted by key_compare, and every blob. ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code store_revision(const struct store *s, char out[STORE_REVISION],
                             struct err *e) ERR_USE;
/* Returns how many tiles there are, as meta says; 0: not known, as in older files. */
int64_t store_db_tiles(const struct store *s);
/* Returns whether a name may stand in URLs and documents unchanged: a-z, 0-9, - and _. */
bool store_db_name_ok(const char *name);
/* Opens s->db to read the file `at`, by a file system of SQLite's (NULL: the usual one). s->path is
 * what messages call it. ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code store_db_connect(struct store *s, const char *at, const char *vfs,
                               struct err *e) ERR_USE;
/* Reads s->index of an opened database; `at` and `vfs` are those of store_db_connect. Damaged rows
 * are left out with a warning. ERR_FORMAT, ERR_BUSY, ERR_MEM, ERR_IO. */
enum err_code store_read_index(struct store *s, const char *at, const char *vfs,
                               struct err *e) ERR_USE;
/* Reads the index in two halves at once, by two handles. False: read it as a whole, which also says
 * what is wrong with it. For store_read_index, and for tests. */
bool store_read_halves(struct store *s, const char *at, const char *vfs);
/* Reads the index rows of all tiles again, where they lie between the payloads, and counts the
 * damaged ones. Opening the store left those out. ERR_FORMAT, ERR_BUSY, ERR_MEM, ERR_IO. */
enum err_code store_check_rows(const struct store *s, size_t *n_bad, struct err *e) ERR_USE;

#endif
