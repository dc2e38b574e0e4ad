/* The tile store: tiles of Gaussians with an index, in one SQLite file (docs/formats.md).
 *
 * A store is built once and never changed: store_create writes beside the path and store_commit
 * renames. Readers map it. A struct store is for one thread at a time, except where a function says
 * otherwise; opening is cheap, so open one a thread. Messages begin with the path.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_STORE_H
#define LOD_STORE_H

#include "core/base.h"
#include "core/geo.h"
#include "lod/key.h"

struct gauss;

enum { STORE_LEVEL_MAX = 7 };
struct store_tile { /* the index entry of one tile */
    struct key key;
    uint8_t level;                     /* 1..STORE_LEVEL_MAX trained, 0 = overview */
    uint32_t count;                    /* Gaussians */
    uint64_t bytes;                    /* of the payload */
    double center_enu_m[3];            /* origin of the payload's means */
    double min_enu_m[3], max_enu_m[3]; /* conservative: means grown by 3.33 sigma */
    /* Where nearly all of it is: 2 and 98 % of the means along each axis. A few Gaussians far above
     * a roof or as large as the tile make the box above many times as high and wide, so distances
     * to a tile are taken from this box. All 0: not known, the box above counts. */
    double core_min_enu_m[3], core_max_enu_m[3];
    double sigma_median_m;    /* median over the tile of each Gaussian's largest sigma */
    double sigma_max_m;       /* the largest of them: how far EWA may reach beyond the box */
    double geometric_error_m; /* 16 sigma_median_m: sigma is 1 px where clients refine at 16 px */
    struct hash128 hash;      /* of the payload */
    uint32_t version;         /* counts up when the tile is replaced */
};
struct store_meta {
    char name[64]; /* [a-z0-9][a-z0-9_-]* */
    struct geo_origin origin;
    uint32_t sh_degree, embed_len;
    bool antialiased;
    bool lossless;              /* payloads keep every field in float32 (imports) */
    uint8_t zoom_min, zoom_max; /* root .. finest level; found by store_commit */
    char attribution[256];
    char revision
        [13]; /* first 12 hex digits of the hash over tiles, blobs, name, origin, attribution;
                        * by store_commit */
    char created[32]; /* ISO 8601; not part of the revision */
};

struct store;

/* ---- writing: store_build.c ---- */

/* Begin a store that will stand at `path`; an existing file is replaced only by store_commit.
 * meta: copied; zooms, revision and date are found later. store_commit or store_close it.
 * ERR_ARG (name, origin), ERR_LIMIT (path, SH degree, embedding), ERR_IO, ERR_MEM. */
enum err_code store_create(const char *path, const struct store_meta *meta, struct store **out,
                           struct err *e) ERR_USE;
/* Encode g and add it as one tile. In t the caller sets key and level; center_enu_m becomes g's
 * origin, and count, bytes, bounds, sigmas, hash and version are filled in.
 * ERR_ARG (key, no rows), ERR_DATA (not finite), ERR_LIMIT (2 GiB), ERR_IO, ERR_MEM, ERR_INTERNAL
 * (a store that was opened for reading). */
enum err_code store_put(struct store *s, struct store_tile *t, const struct gauss *g,
                        struct err *e) ERR_USE;
/* store_put in two halves: encode into `payload` (caller frees) on any thread, since the store is
 * only asked for its options; then add, one at a time, which sets the version. Errors as
 * store_put: ERR_ARG, ERR_DATA, ERR_LIMIT, ERR_MEM, ERR_INTERNAL; ERR_IO of adding. */
enum err_code store_encode(const struct store *s, struct store_tile *t, const struct gauss *g,
                           struct buf *payload, struct err *e) ERR_USE;
enum err_code store_add(struct store *s, struct store_tile *t, const struct buf *payload,
                        struct err *e) ERR_USE;
struct store_blob {
    const char *name;
    const void *data;
    size_t size_bytes;
};
/* Any named JSON or binary beside the tiles: appearance models, embeddings, reports. Copied; a blob
 * of that name is replaced. ERR_IO, ERR_LIMIT, ERR_MEM, ERR_INTERNAL. */
enum err_code store_put_blob(struct store *s, const char *name, const void *bytes, size_t n,
                             struct err *e) ERR_USE;
/* Write meta and revision, sync, rename and close; *s becomes NULL on success. ERR_DATA (no tiles),
 * ERR_IO, ERR_MEM, ERR_INTERNAL. */
enum err_code store_commit(struct store **s, struct err *e) ERR_USE;

/* ---- reading: store_read.c ---- */

/* Open for reading; store_close it. ERR_NOENT, ERR_FORMAT (no tile store, another schema version,
 * damaged: what and which), ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code store_open(const char *path, struct store **out, struct err *e) ERR_USE;
/* The same of a file that is open already, whatever its name stands for by now: also when it was
 * renamed over or removed. fd is borrowed during the call; name is what errors call it. /proc must
 * be there. Errors as store_open, ERR_NOENT among them. */
enum err_code store_open_fd(int fd, const char *name, struct store **out, struct err *e) ERR_USE;
/* One more handle to the file of fd, which `first` was opened from, for another thread. It has the
 * index of first, which is closed after it. ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code store_open_more(int fd, const struct store *first, struct store **out,
                              struct err *e) ERR_USE;
/* Close; of a store that is being built: removes the unfinished file. NULL inside is fine. */
void store_close(struct store **s);
/* Borrowed, until store_close. */
const struct store_meta *store_info(const struct store *s);
/* The whole index [*n], sorted by key_compare; borrowed, until store_close. */
const struct store_tile *store_tiles(const struct store *s, size_t *n);
/* One entry of it, NULL when absent. */
const struct store_tile *store_find(const struct store *s, struct key k);
/* Payload of a tile into `out` (caller frees), hash verified. ERR_NOENT when absent, ERR_FORMAT
 * names the tile, ERR_IO, ERR_MEM. */
enum err_code store_read(struct store *s, struct key k, struct buf *out, struct err *e) ERR_USE;
/* The same decoded: ENU axes, origin_enu_m = center_enu_m; gauss_free it. Errors as store_read:
 * ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code store_read_gauss(struct store *s, struct key k, struct gauss *out,
                               struct err *e) ERR_USE;
/* Bytes that store_read gave for `t`, decoded likewise. The store is only read, so threads may
 * share it. No more memory is taken than a tile of t->count Gaussians needs. ERR_FORMAT: no
 * payload, or one of another number, degree or embedding than index and meta say. ERR_MEM. */
enum err_code store_decode(const struct store *s, const struct store_tile *t,
                           const struct buf *bytes, struct gauss *out, struct err *e) ERR_USE;
/* A blob into `out` (caller frees), hash verified. ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code store_get_blob(struct store *s, const char *name, struct buf *out,
                             struct err *e) ERR_USE;
/* The ground that the photographs support (docs/footprint.md): a GeoJSON Feature, one line; NULL:
 * none was stored. Borrowed until store_close. */
#define STORE_FOOTPRINT "footprint" /* its blob */
const char *store_footprint(const struct store *s);
/* What the store was clipped to (lod/clip.h): a GeoJSON FeatureCollection, one line; what is left
 * lies within every feature of it. NULL: it was not. Borrowed until store_close. */
#define STORE_CLIP "clip"
const char *store_clip(const struct store *s);
/* Names of the blobs [*n], sorted; live in the arena. ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code store_list_blobs(struct store *s, struct arena *a, char ***names, size_t *n,
                               struct err *e) ERR_USE;
/* Check every page, index row, payload and blob. Returns the first fault (ERR_FORMAT, ERR_IO,
 * ERR_MEM); n_bad (may be NULL) counts them and each is logged. */
enum err_code store_verify(struct store *s, size_t *n_bad, struct err *e) ERR_USE;

#endif
