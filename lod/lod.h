/* Levels of detail: tile keys, the pyramid, the tile store (SQLite), level selection, views of a
 * store.
 *
 * Key: z/x/y of the Web Mercator quad tree (OGC WebMercatorQuad). The zoom identifies the level:
 * level 3 (finest) at zoom Z, level 2 at Z-1, level 1 at Z-2, overviews below that until one tile
 * holds the scene. A Gaussian belongs to the tile that holds the longitude/latitude of its mean,
 * half-open.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_LOD_H
#define LOD_LOD_H

#include "core/appearance.h"
#include "core/base.h"
#include "core/camera.h"
#include "core/gauss.h"
#include "core/geo.h"
#include "render/render.h"

struct ckpt_blob;

/* ---- key.c ---- */

enum { KEY_ZOOM_MAX = 24 };
struct key {
    uint8_t z;
    uint32_t x, y;
};
/* Tile that holds a place: half-open, x grows east, y grows south. Latitude clamped to +-85.0511.
 */
struct key key_at(double lon_deg, double lat_deg, uint8_t z);
struct key key_parent(struct key k);
bool key_valid(struct key k);                /* z <= 24, x, y < 2^z */
int key_compare(struct key a, struct key b); /* by z, then y, then x */
void key_center(struct key k, double *lon_deg, double *lat_deg);
void key_bounds(struct key k, double *west_deg, double *south_deg, double *east_deg,
                double *north_deg);
double key_edge_m(double lat_deg, uint8_t z); /* ground size of a tile's edge at that latitude */
uint8_t key_zoom_for(double lat_deg, double edge_m); /* zoom whose edge is nearest, in log */

/* ---- store.c: one SQLite file ---- */

struct store_tile { /* the index entry of one tile */
    struct key key;
    uint8_t level;                     /* 1..3 trained, 0 = overview */
    uint32_t count;                    /* Gaussians */
    uint64_t bytes;                    /* of the payload */
    double center_enu_m[3];            /* origin of the payload's means */
    double min_enu_m[3], max_enu_m[3]; /* conservative: means grown by 3.33 sigma */
    /* Where nearly all of it is: 2 and 98 % of the means along each axis. A few Gaussians far above
     * a roof or as large as the tile make the box above many times as high and wide; how far away a
     * tile is says this one. All 0: not known, the box above. */
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
    char revision[13]; /* first 12 hex digits of the hash over all tile hashes, set by store_commit
                        */
    char created[32];  /* ISO 8601; not part of the revision */
};

struct store; /* one thread at a time; opening is cheap, so open one a thread */
/* Create `path` (written as a sibling file and renamed by store_commit; an existing file is
 * replaced only then). */
enum err_code store_create(const char *path, const struct store_meta *meta, struct store **out,
                           struct err *e) ERR_USE;
/* Encode and add one tile; g's origin becomes center_enu_m; count, bytes, bounds, sigma, hash are
 * filled in t. */
enum err_code store_put(struct store *s, struct store_tile *t, const struct gauss *g,
                        struct err *e) ERR_USE;
/* The same in two halves: encode on any thread (the store is only asked for its options), add one
 * at a time. store_add sets the version. */
enum err_code store_encode(const struct store *s, struct store_tile *t, const struct gauss *g,
                           struct buf *payload, struct err *e) ERR_USE;
enum err_code store_add(struct store *s, struct store_tile *t, const struct buf *payload,
                        struct err *e) ERR_USE;
/* Any named JSON or binary beside the tiles: appearance models, embeddings, report. */
enum err_code store_put_blob(struct store *s, const char *name, const void *bytes, size_t n,
                             struct err *e) ERR_USE;
enum err_code store_get_blob(struct store *s, const char *name, struct buf *out,
                             struct err *e) ERR_USE;
enum err_code store_commit(struct store **s,
                           struct err *e) ERR_USE; /* revision, sync, rename, close */
/* Read-only. ERR_NOENT, ERR_FORMAT (not a tile store, other schema version, corrupt: what and
 * which). */
enum err_code store_open(const char *path, struct store **out, struct err *e) ERR_USE;
void store_close(struct store **s); /* of a store being created: removes the unfinished file */
const struct store_meta *store_info(const struct store *s);
/* The whole index, sorted by key_compare; borrowed, lives until store_close. */
const struct store_tile *store_tiles(const struct store *s, size_t *n);
const struct store_tile *store_find(const struct store *s, struct key k); /* NULL when absent */
/* Payload bytes, hash verified (ERR_FORMAT names the tile). ERR_NOENT when absent. */
enum err_code store_read(struct store *s, struct key k, struct buf *out, struct err *e) ERR_USE;
/* Decoded, ENU axes, origin = center_enu_m. */
enum err_code store_read_gauss(struct store *s, struct key k, struct gauss *out,
                               struct err *e) ERR_USE;
/* Every page, index row, payload and blob checked. The first fault is returned; `n_bad` (may be
 * NULL) counts them and each is logged. */
enum err_code store_verify(struct store *s, size_t *n_bad, struct err *e) ERR_USE;
/* Names of the blobs, sorted; live in the arena. */
enum err_code store_list_blobs(struct store *s, struct arena *a, char ***names, size_t *n,
                               struct err *e) ERR_USE;

/* ---- bake.c: looks of a store (docs/appearance.md) ---- */

#define BAKE_BLOB "appearance"
#define BAKE_DEFAULT "default" /* the look of clients that know of none */
/* The store's appearance model, read once; NULL when it has none. Borrowed until store_close. Its
 * rows are the training photographs and BAKE_DEFAULT. */
enum err_code bake_of(struct store *s, const struct appearance **out, struct err *e) ERR_USE;
/* Do Gaussians with embeddings that model `a` reads (NULL: none) belong into the store? Only with
 * the store's own network and the same embedding of every photograph that both know; the other
 * looks are the store's affair. ERR_DATA, which says what differs. */
enum err_code bake_fits(struct store *s, const struct appearance *a, struct err *e) ERR_USE;
/* The store's model and the photographs that only `a` has (bake_fits, else ERR_DATA), as a blob;
 * the default look stays the store's, so nothing that was made with it changes. Empty where the
 * store has no appearance. */
enum err_code bake_join(struct store *s, const struct appearance *a, struct buf *out,
                        struct err *e) ERR_USE;
/* Hash of the model, for names of what is made with it; 0 when there is none. */
enum err_code bake_hash(struct store *s, struct hash128 *out, struct err *e) ERR_USE;
/* The embedding [len_image] of a look: a photograph's name, BAKE_DEFAULT, a blend
 * "NAME:WEIGHT,NAME:WEIGHT" of unit embeddings (weights are divided by their sum), or "=" and the
 * embedding itself, see bake_text. ERR_NOENT: no such photograph, or a store without appearance;
 * ERR_ARG: no look at all. Threads may share a store for this once bake_of was called. */
enum err_code bake_find(struct store *s, const char *look, float *image, struct err *e) ERR_USE;
/* An embedding as a look's text: "=" and its float32 values, little-endian, in base64url without
 * padding (RFC 4648). */
enum { BAKE_TEXT_MAX = 2 + (4 * 4 * APPEARANCE_IMAGE_MAX + 2) / 3 };
void bake_text(const float *image, uint32_t len_image, char out[BAKE_TEXT_MAX]);
/* Change g's colours and opacities to a look (NULL: the default one); does nothing where the store
 * has no appearance. g carries the store's embeddings. */
enum err_code bake_apply(struct store *s, const float *image, struct gauss *g,
                         struct err *e) ERR_USE;
/* store_read_gauss and bake_apply. */
enum err_code bake_read(struct store *s, struct key k, const float *image, struct gauss *out,
                        struct err *e) ERR_USE;
/* The default look of a model whose Gaussians have embeddings like g's: image [len_image]. */
enum err_code bake_default(const struct appearance *a, const struct gauss *g, float *image,
                           struct err *e) ERR_USE;
/* A copy of the model with it as last row, named BAKE_DEFAULT: what a store keeps. */
enum err_code bake_with_default(const struct appearance *a, const struct gauss *g,
                                struct appearance *out, struct err *e) ERR_USE;
/* A row of the table, of length 1. */
void bake_unit(const struct appearance *a, size_t row, float *out);

/* ---- pyramid.c ---- */

struct pyramid_config {
    double tile_edge_m; /* edge wanted for the finest level's tiles; 0 = chosen so that tiles hold
                           about 50 k */
    uint32_t max_per_tile; /* 0 = 200,000; finer zooms are taken until it holds */
    bool lossless; /* float32 payloads, and tile centres that lose no bit of a float32 mean */
    char name[64];
    char attribution[256];
};
struct pyramid_level {     /* levels given must be consecutive, e.g. 1, 2, 3 or 3 alone */
    const struct gauss *g; /* borrowed; NULL: load() makes it in n_parts parts */
    uint8_t level;         /* 1 coarsest .. n finest, at most 7 */
    /* Part `part`, once each, from several threads at a time; the pyramid frees it. A part should
     * have some 100,000 rows: each worker holds one. */
    enum err_code (*load)(void *user, size_t part, struct gauss *out, struct err *e);
    void *user;
    size_t n_parts;
};
struct pyramid_report {
    size_t n_tiles, n_gaussians[8]; /* per level, [0] = overviews */
    size_t n_bad;                   /* rows with non-finite values, left out */
    size_t n_far; /* rows that no tile format can hold: kilometres above or below, left out */
    size_t n_carried_tiles,
        n_carried; /* copies of coarse Gaussians where a finer level has nothing at all */
    size_t max_in_tile;
    uint8_t zoom_min, zoom_max;
    char revision[13];
    double seconds;
};
/* Cut levels into tiles, make what is coarser than the coarsest one given (levels down to 1, then
 * overviews) by simplification, write the store. Every Gaussian of each level lands in exactly one
 * tile of that level's zoom. Where a tile has finer tiles under some of its quadrants only, the
 * Gaussians of the others are copied one zoom down, so that replacing a tile by its children never
 * opens a hole; such a tile keeps the level of its Gaussians. blobs (n_blobs, may be 0) are stored
 * as they are. */
enum err_code pyramid_build(const struct geo_origin *origin, const struct pyramid_level *levels,
                            size_t n_levels, const struct pyramid_config *cfg,
                            const struct ckpt_blob *blobs, size_t n_blobs, const char *out_path,
                            struct pyramid_report *report, struct err *e) ERR_USE;
/* ---- update.c, merge.c: a store from stores ---- */

struct update_config {            /* one cell, trained again */
    const struct gauss *level[8]; /* [1..7] its rows; NULL: this level was made, not trained */
    bool (*owns)(void *user, double x_m, double y_m); /* whose ground it is: ENU */
    /* Could anything within the box be on the cell's ground? Tiles of which this is false are not
     * even read. */
    bool (*may_own)(void *user, const double min_m[3], const double max_m[3]);
    void *user;
    uint32_t max_per_tile;         /* 0 = 200,000; fuller tiles are thinned */
    const struct appearance *look; /* what reads the rows' embeddings; NULL: nothing does */
};
struct update_report {
    size_t n_written, n_copied, n_removed; /* tiles */
    char revision[13];
};
/* Replace the rows of one cell and everything made of them; all other tiles are copied byte by
 * byte. out_path may be store_path: written beside and renamed, so whoever dies in between leaves
 * the old store. The same cell again gives the same revision. A store of all cells tiled at once
 * has the same rows in the same tiles; its bytes are the same, too, in a lossless store, but for
 * tiles that keep a centre which it would choose elsewhere, and what is made of them. Photographs
 * that only c->look has join the store's. ERR_DATA when SH, embedding, appearance model,
 * anti-aliasing or the number of levels do not fit the store. */
enum err_code update_build(const char *store_path, const struct update_config *c,
                           const char *out_path, struct update_report *report,
                           struct err *e) ERR_USE;

struct merge_report {
    size_t n_written, n_copied; /* tiles made of both or moved; taken over as they are */
    double turn_deg;            /* between the frames of the two */
    char revision[13];
};
/* Two stores of neighbouring places in one, in the frame of the first: tiles of both with one key
 * are made of both's Gaussians. Origins may differ; rows of the second are then moved and turned,
 * SH too. Ground that both cover shows both. name NULL = the first's. Attributions are put side by
 * side, each once; the appearance model has the photographs of both and the first's default look;
 * of other blobs of one name the first's is kept. ERR_DATA when embeddings, the models that read
 * them, or anti-aliasing do not fit; ERR_ARG for a store and itself. */
enum err_code merge_build(const char *path_a, const char *path_b, const char *name,
                          const char *out_path, struct merge_report *report, struct err *e) ERR_USE;

/* Fewer Gaussians of the same look: merge neighbours by moment matching down to `target` rows. */
enum err_code simplify_gauss(const struct gauss *in, size_t target, struct gauss *out,
                             struct err *e) ERR_USE;

/* ---- tileset.c: 3D Tiles 1.1 ---- */

/* The explicit tileset JSON: one document. `content_format` is a printf-free template with
 * {z}/{x}/{y}, "t/{z}/{x}/{y}.glb". */
enum err_code tileset_write(const struct store *s, const char *content_template, struct buf *out,
                            struct err *e) ERR_USE;
/* TileJSON 3.0.0 with the "splats" member. `tiles_template` as above, may be relative. */
enum err_code tileset_tilejson(const struct store *s, const char *tiles_template, struct buf *out,
                               struct err *e) ERR_USE;

/* ---- pick.c: which tiles a view needs ---- */

enum pick_metric { PICK_SCREEN, PICK_DISTANCE };
#define PICK_HYSTERESIS 0.05 /* a usual band */
struct pick_options {        /* {0} = screen metric, defaults */
    enum pick_metric metric;
    double
        error_px; /* screen: refine while error > this; 0 = 1 px of median sigma (formats: 16 ge) */
    double distance_m[8]; /* distance metric: level l+1.. thresholds, finest first; 0-terminated */
    uint64_t max_gaussians; /* 0 = no limit: coarsen farthest first until it fits */
    uint64_t max_bytes;     /* likewise of the payloads: what a client must fetch and keep */
    bool no_lod;            /* finest level everywhere */
    bool whole_tiles;       /* view_render: hand over tiles whole, not only their blocks in view */
    /* For cameras that move: a tile that was refined in the picture before stays so until its error
     * is this share below the limit, so that a camera that trembles at a limit does not make the
     * level flicker. `before` is what pick_tiles gave then, NULL for none; without it a view
     * depends on its own camera alone. Never coarser than without. */
    double hysteresis; /* 0 to 0.5 */
    const uint32_t *before;
    size_t n_before;
};
/* Writes indices into store_tiles(), ascending; out holds n_tiles entries and must not be `before`.
 * Never drops a tile that may be visible. */
enum err_code pick_tiles(const struct store *s, const struct camera *cam,
                         const struct pick_options *o, uint32_t *out, size_t *n_out,
                         struct err *e) ERR_USE;

/* ---- view.c: a picture of a store ---- */

struct view; /* a store, a renderer, and the tiles resident on the device; one caller at a time */
/* cache_bytes: of decoded tiles in memory, 0 = 1 GiB. r is borrowed until view_close. */
enum err_code view_open(const char *store_path, struct render *r, size_t cache_bytes,
                        struct view **out, struct err *e) ERR_USE;
void view_close(struct view **v);
const struct store *view_store(const struct view *v);
const struct appearance *view_appearance(const struct view *v); /* of the store; NULL: none */
/* The look of pictures of a store with appearance: an embedding (copied), NULL for the default one.
 */
enum err_code view_set_look(struct view *v, const float *image, struct err *e) ERR_USE;
/* bake_find of the view's store. */
enum err_code view_find_look(struct view *v, const char *look, float *image, struct err *e) ERR_USE;
struct view_stats {
    size_t n_tiles;
    uint64_t n_gaussians; /* handed to the renderer: blocks of the tiles that may be in view */
    uint64_t n_visible;   /* of them in the picture; 0 from view_model */
    double ms_pick, ms_load, ms_render;
};
/* rgb [h][w][3] float. A frame of the network in ro comes before the look that was set. */
enum err_code view_render(struct view *v, const struct camera *cam, const struct render_options *ro,
                          const struct pick_options *po, float *rgb, struct view_stats *stats,
                          struct err *e) ERR_USE;
/* The same with the tiles that pick_cam needs: what a change of levels alone does to a picture.
 * ERR_ARG, and what pick_tiles and render_forward give. */
enum err_code view_render_picked(struct view *v, const struct camera *pick_cam,
                                 const struct camera *cam, const struct render_options *ro,
                                 const struct pick_options *po, float *rgb,
                                 struct view_stats *stats, struct err *e) ERR_USE;

/* The Gaussians that such a picture is drawn from, tiles whole, on the device until the next call:
 * colours as they were trained, with embeddings where the store has appearance. There is a way back
 * through this model (render_backward). */
enum err_code view_model(struct view *v, const struct camera *cam, const struct pick_options *po,
                         const struct render_model **out, struct view_stats *stats,
                         struct err *e) ERR_USE;

/* A camera as maps give it: heading clockwise from north, pitch above the horizon, height
 * ellipsoidal. */
struct view_pose {
    double lon_deg, lat_deg, h_m, heading_deg, pitch_deg, fov_y_deg;
};
enum err_code view_camera(const struct geo_origin *origin, const struct view_pose *pose,
                          uint32_t width_px, uint32_t height_px, struct camera *out,
                          struct err *e) ERR_USE;

#endif
