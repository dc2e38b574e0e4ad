/* The tile store: tiles of Gaussians with an index, in one SQLite file (docs/formats.md).
 *
 * A store is built once and never changed. store_create writes under another name, and store_commit
 * renames. Only one thread at a time may use a struct store, unless a function says otherwise.
 * Opening is cheap, so each thread opens its own. Messages begin with the path.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_STORE_H
#define LOD_STORE_H

#include "core/base.h"
#include "core/geo/geo.h"
#include "core/geo/heights.h"
#include "lod/store/key.h"

struct gauss;
struct payload;

/* geometric error over sigma: an error of 16 px is a sigma of 1 px */
#define STORE_PX_PER_SIGMA 16.0
/* A level is replaced by the finer one where a pixel is this part of those it was trained on. */
#define STORE_PIXEL_SHARE 0.75

enum { STORE_LEVEL_MAX = 7, STORE_VERSION_MAX = 0xffffff, STORE_REVISION = 13 };
struct store_tile { /* the row of one tile in the index */
    struct key key;
    uint32_t count;        /* number of Gaussians */
    uint32_t bytes;        /* size of the payload */
    uint32_t version : 24; /* grows by 1 when the tile is replaced */
    uint32_t level : 8;    /* 1..STORE_LEVEL_MAX: trained; 0: overview */
    struct hash128 hash;   /* of the payload */
};
struct store_shape {                   /* where a tile is */
    double center_enu_m[3];            /* origin of the payload's means */
    double min_enu_m[3], max_enu_m[3]; /* box around the means, each widened by 3.33 sigma */
    /* Box of nearly all Gaussians: from 2 to 98 % of the means along each axis. A few Gaussians
     * high above a roof, or as large as the tile, make the other box many times larger. Distances
     * to a tile are therefore measured to this one. All 0: not known; use the other box. */
    double core_min_enu_m[3], core_max_enu_m[3];
    double sigma_median_m; /* median over the tile of the largest sigma of each Gaussian */
    /* largest sigma: it limits how far EWA splatting may draw beyond the box */
    double sigma_max_m;
    /* 16 sigma_median_m, so that clients that refine at 16 px see a sigma of 1 px; less where the
     * level was trained on finer pixels (store_meta.pixel_m) */
    double geometric_error_m;
};
struct store_entry { /* both, as they are written */
    struct store_tile tile;
    struct store_shape shape;
};
struct store_meta {
    char name[64]; /* [a-z0-9][a-z0-9_-]* */
    struct geo_origin origin;
    uint32_t sh_degree, embed_len;
    bool antialiased;
    bool lossless;              /* payloads have all fields in float32 (imports) */
    uint8_t zoom_min, zoom_max; /* zooms of the root and of the finest level; set by store_commit */
    char attribution[256];
    char heights[HEIGHTS_MAX]; /* reference of heights: core/geo/heights.h; "": the ellipsoid */
    /* of level l at [l - 1]: a pixel, on the ground, of the photographs that trained it; 0: not
     * known. Errors are at most 16 STORE_PIXEL_SHARE of it
     * (docs/decisions/020-level-selection.md) */
    double pixel_m[STORE_LEVEL_MAX];
    /* by store_commit: hash of tiles, blobs, name, origin, attribution, 12 hex digits */
    char revision[STORE_REVISION];
    char created[32]; /* ISO 8601; not part of the revision */
};

struct store;

/* ---- writing: store_build.c ---- */

/* Begins a store for `path`; only store_commit replaces an existing file. meta is copied; zooms,
 * revision and date are set later. End with store_commit or store_close. ERR_ARG (name, origin),
 * ERR_LIMIT (path, SH degree, embedding), ERR_IO, ERR_MEM. */
enum err_code store_create(const char *path, const struct store_meta *meta, struct store **out,
                           struct err *e) ERR_USE;
/* Encodes g and adds it as one tile. The caller sets key and level in t. center_enu_m becomes the
 * origin of g, and the other members are computed; a geometric error that is set stays. ERR_ARG
 * (key, no rows), ERR_DATA (not finite), ERR_LIMIT (2 GiB), ERR_IO, ERR_MEM, ERR_INTERNAL (the
 * store was opened for reading). */
enum err_code store_put(struct store *s, struct store_entry *t, const struct gauss *g,
                        struct err *e) ERR_USE;
/* store_put in two steps. Any thread may call store_encode, which only reads options of the store;
 * the caller frees `payload`. Only one thread at a time may call store_add, which sets the version.
 * ERR_ARG, ERR_DATA, ERR_LIMIT, ERR_MEM, ERR_INTERNAL; store_add also ERR_IO. */
enum err_code store_encode(const struct store *s, struct store_entry *t, const struct gauss *g,
                           struct buf *payload, struct err *e) ERR_USE;
enum err_code store_add(struct store *s, struct store_entry *t, const struct buf *payload,
                        struct err *e) ERR_USE;
struct store_blob {
    const char *name;
    const void *data;
    size_t size_bytes;
};
/* Adds named JSON or binary data beside the tiles: appearance models, embeddings, reports. It is
 * copied, and replaces a blob of the same name. ERR_IO, ERR_LIMIT, ERR_MEM, ERR_INTERNAL. */
enum err_code store_put_blob(struct store *s, const char *name, const void *bytes, size_t n,
                             struct err *e) ERR_USE;
/* Writes meta and revision, syncs, renames and closes. *s becomes NULL on success. ERR_DATA (no
 * tiles), ERR_IO, ERR_MEM, ERR_INTERNAL. */
enum err_code store_commit(struct store **s, struct err *e) ERR_USE;

/* ---- reading: store_read.c ---- */

/* Raises the origin of an open store: its heights counted from the sea, and count from the
 * ellipsoid now, as another revision. 0 m: nothing changes. */
void store_lift(struct store *s, double up_m);

/* Opens a store for reading: a file, or an object at http://, https:// or s3://. Close it with
 * store_close. Here and below, ERR_BUSY means that a server does not send the bytes now. ERR_NOENT,
 * ERR_FORMAT (not a tile store, another schema version, or damaged; the message says which),
 * ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code store_open(const char *path, struct store **out, struct err *e) ERR_USE;
/* Opens the file of a store without reading it, for store_open_fd. For an address, *fd is the file
 * of the object's blocks (remote.h), for the object as it is now. The caller closes *fd. ERR_ARG
 * (the address), ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_BUSY, ERR_LIMIT, ERR_MEM. */
enum err_code store_open_file(const char *path, int *fd, struct err *e) ERR_USE;
/* As store_open, from an open file, even if it was removed or replaced by a rename since. fd is
 * borrowed during the call. `name` is for messages. It needs /proc. ERR_NOENT, ERR_FORMAT, ERR_IO,
 * ERR_LIMIT, ERR_MEM. */
enum err_code store_open_fd(int fd, const char *name, struct store **out, struct err *e) ERR_USE;
/* Opens another handle, for another thread, on the file fd from which `first` was opened. It uses
 * the index of `first`, so `first` must stay open longer. ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_MEM.
 */
enum err_code store_open_more(int fd, const struct store *first, struct store **out,
                              struct err *e) ERR_USE;
/* Frees the database pages that this handle keeps in memory, 20 or more. A handle that is seldom
 * read from does not need them; they are read again when needed. */
void store_rest(struct store *s);
/* Closes a store. If it is being built, the unfinished file is removed. *s may be NULL. */
void store_close(struct store **s);
/* Borrowed until store_close. */
const struct store_meta *store_info(const struct store *s);
/* Path or address of the store, for messages; without password or signature. Borrowed. */
const char *store_path(const struct store *s);
/* Returns whether a read or store_ask found that the object at the store's address was replaced.
 * Any thread. */
bool store_replaced(const struct store *s);
/* Asks the server of an address, for wait_s at most, whether its object is the same. ERR_DATA: it
 * is another one; ERR_BUSY, ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_MEM. A file is never asked. */
enum err_code store_ask(struct store *s, double wait_s, struct err *e) ERR_USE;
/* The whole index [*n], sorted by key_compare. Borrowed until store_close. */
const struct store_tile *store_tiles(const struct store *s, size_t *n);
/* One row of the index, or NULL. */
const struct store_tile *store_find(const struct store *s, struct key k);
/* The shape of a tile in store_tiles, or that store_find found. */
struct store_shape store_shape(const struct store *s, const struct store_tile *t);
/* Reads the payload of a tile and checks its hash; the caller frees `out`. ERR_NOENT (no such
 * tile), ERR_FORMAT names the tile, ERR_IO, ERR_MEM. */
enum err_code store_read(struct store *s, struct key k, struct buf *out, struct err *e) ERR_USE;
/* As store_read, decoded: ENU axes, origin_enu_m = center_enu_m. Free *out with gauss_free.
 * ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code store_read_gauss(struct store *s, struct key k, struct gauss *out,
                               struct err *e) ERR_USE;
/* Unpacks bytes that store_read gave for `t`: see codec/splat/payload.h. *out keeps its memory from
 * call to call. The store is only read, so threads may share it. It uses no more memory than a tile
 * of t->count Gaussians needs. ERR_FORMAT: it is no payload, or its count, degree or embedding
 * differ from index and meta. ERR_MEM. */
enum err_code store_unpack(const struct store *s, const struct store_tile *t,
                           const struct buf *bytes, struct payload *out, struct err *e) ERR_USE;
/* Adds the names of the store and of the tile to an error, whose code it returns. ERR_FORMAT,
 * ERR_MEM. */
enum err_code store_name_tile(const struct store *s, const struct store_tile *t,
                              struct err *e) ERR_USE;
/* Reads a blob and checks its hash; the caller frees `out`. ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_MEM.
 */
enum err_code store_get_blob(struct store *s, const char *name, struct buf *out,
                             struct err *e) ERR_USE;
/* The ground that the photographs support (docs/scale.md), as a GeoJSON Feature in one line.
 * NULL: none was stored. Borrowed until store_close. */
#define STORE_FOOTPRINT "footprint" /* name of its blob */
const char *store_footprint(const struct store *s);
/* The polygons that the store was clipped to (lod/export/clip.h), as a GeoJSON FeatureCollection in
 * one line. All Gaussians lie within every feature. NULL: it was not clipped. Borrowed until
 * store_close. */
#define STORE_CLIP "clip"
const char *store_clip(const struct store *s);
/* Names of all blobs [*n], sorted. They live in the arena. ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code store_list_blobs(struct store *s, struct arena *a, char ***names, size_t *n,
                               struct err *e) ERR_USE;
/* Checks all pages, index rows, payloads and blobs; and, if these are whole, that they are those of
 * the revision, as many as meta says. It returns the first fault (ERR_FORMAT, ERR_IO, ERR_MEM),
 * logs each, and counts them in n_bad (may be NULL). */
enum err_code store_verify(struct store *s, size_t *n_bad, struct err *e) ERR_USE;

#endif
