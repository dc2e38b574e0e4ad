/* A request target as integers and enums.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_TARGET_H
#define SERVER_TARGET_H

#include "core/base.h"
#include "lod/key.h"

struct clip;

enum { TARGET_KEPT_MAX = 64 };   /* a name that an appearance is kept under, with its NUL */
enum { TARGET_STREAM_MIN = 16 }; /* a name cannot be guessed: whoever knows it steers */
enum { TARGET_CLIP_CORNERS = 40, TARGET_CLIP_TEXT = TARGET_CLIP_CORNERS * 26 };
enum {
    TARGET_APPEARANCE_MAX = 512,
    TARGET_QUERY_MAX = 3 * TARGET_APPEARANCE_MAX + TARGET_CLIP_TEXT + 96
};

enum { TARGET_SEARCH = 100, TARGET_SEARCH_MAX = 1000 };   /* appearances of a page */
enum { TARGET_LIMIT = 10000, TARGET_LIMIT_MAX = 100000 }; /* lines of a prefetch list */

enum method {
    METHOD_GET,
    METHOD_HEAD,
    METHOD_POST,
    METHOD_PUT,
    METHOD_DELETE,
    METHOD_OPTIONS,
    METHOD_OTHER,
    METHOD_UNKNOWN
};
/* What a route answers, as bits. */
enum { ALLOW_READ = 1, ALLOW_POST = 2, ALLOW_CHANGE = 4 /* PUT and DELETE */ };

/* X(id, allow, path, summary): the routes; /api, metrics and 405 answers come from this list. */
#define ROUTE_LIST(X)                                                                              \
    X(LANDING, ALLOW_READ, "/", "The viewer (HTML) or the landing page (JSON), by Accept")         \
    X(STATIC, ALLOW_READ, "/{file}", "Files of the viewer")                                        \
    X(CONFORMANCE, ALLOW_READ, "/conformance", "Conformance classes")                              \
    X(API, ALLOW_READ, "/api", "This description (OpenAPI 3.0)")                                   \
    X(API_PAGE, ALLOW_READ, "/api.html", "This description, to read")                              \
    X(COLLECTIONS, ALLOW_READ, "/collections", "All datasets")                                     \
    X(COLLECTION, ALLOW_READ, "/collections/{ds}", "One dataset")                                  \
    X(TILEJSON, ALLOW_READ, "/collections/{ds}/tiles.json", "TileJSON 3.0.0 of a dataset")         \
    X(MAP_TILESETS, ALLOW_READ, "/collections/{ds}/map/tiles",                                     \
      "Tilesets of the map after OGC API - Tiles")                                                 \
    X(MAP_TILESET, ALLOW_READ, "/collections/{ds}/map/tiles/WebMercatorQuad",                      \
      "The tileset of the map after OGC API - Tiles")                                              \
    X(MATRICES, ALLOW_READ, "/tileMatrixSets/WebMercatorQuad",                                     \
      "The tile matrix set of all map tiles")                                                      \
    X(TILESET_MOVING, ALLOW_READ, "/d/{ds}/tileset.json", "3D Tiles 1.1 entry, current revision")  \
    X(TILESET, ALLOW_READ, "/d/{ds}/r/{rev}/tileset.json", "3D Tiles 1.1 tileset of a revision")   \
    X(TILESET_PART, ALLOW_READ, "/d/{ds}/r/{rev}/tileset/{z}/{x}/{y}.json",                        \
      "The part of a large tileset that begins at a tile")                                         \
    X(TILE, ALLOW_READ, "/d/{ds}/r/{rev}/t/{z}/{x}/{y}.{ext}", "One tile of Gaussians")            \
    X(TILE_MOVING, ALLOW_READ, "/d/{ds}/t/{z}/{x}/{y}.{ext}", "Redirect to the current revision")  \
    X(VIEW, ALLOW_READ,                                                                            \
      "/d/{ds}/r/{rev}/static/{lon},{lat},{height}@{heading},{pitch}[,{fov}[,{roll}]]/"            \
      "{w}x{h}[@{s}x].{fmt}",                                                                      \
      "A rendered view")                                                                           \
    X(VIEW_MOVING, ALLOW_READ,                                                                     \
      "/d/{ds}/static/{lon},{lat},{height}@{heading},{pitch}[,{fov}[,{roll}]]/"                    \
      "{w}x{h}[@{s}x].{fmt}",                                                                      \
      "Redirect to the current revision")                                                          \
    X(MAP, ALLOW_READ, "/d/{ds}/r/{rev}/map/{z}/{x}/{y}.{fmt}",                                    \
      "A map tile: the city from straight above; {y}@2x is 512 px")                                \
    X(MAP_MOVING, ALLOW_READ, "/d/{ds}/map/{z}/{x}/{y}.{fmt}", "Redirect to the current revision") \
    X(TERRAIN, ALLOW_READ, "/d/{ds}/r/{rev}/terrain/{z}/{x}/{y}.png",                              \
      "Heights of the surface as a picture, after Mapbox or Terrarium")                            \
    X(TERRAIN_MOVING, ALLOW_READ, "/d/{ds}/terrain/{z}/{x}/{y}.png",                               \
      "Redirect to the current revision")                                                          \
    X(MAPJSON, ALLOW_READ, "/d/{ds}/map.json", "TileJSON 3.0.0 of the map tiles")                  \
    X(TERRAINJSON, ALLOW_READ, "/d/{ds}/terrain.json", "TileJSON 3.0.0 of the terrain tiles")      \
    X(WMTS, ALLOW_READ, "/d/{ds}/wmts.xml", "OGC WMTS 1.0.0 capabilities of the map tiles")        \
    X(HEIGHT, ALLOW_READ | ALLOW_POST, "/d/{ds}/height",                                           \
      "How high the surface is: at ?lon= and ?lat=, or at posted places")                          \
    X(PICK, ALLOW_POST, "/d/{ds}/pick",                                                            \
      "What a pixel of a camera shows: longitude, latitude, height")                               \
    X(PROFILE, ALLOW_POST, "/d/{ds}/profile", "Heights of the surface along a line")               \
    X(MEASURE, ALLOW_POST, "/d/{ds}/measure", "Lengths; areas and volumes within a polygon")       \
    X(VISIBLE, ALLOW_POST, "/d/{ds}/visible", "Is one place seen from another?")                   \
    X(APPEARANCES, ALLOW_READ, "/d/{ds}/appearances", "All appearances of a dataset")              \
    X(KEPT, ALLOW_READ | ALLOW_CHANGE, "/d/{ds}/appearances/{name}",                               \
      "An appearance that is kept under a name: PUT keeps it, DELETE forgets it")                  \
    X(MODEL, ALLOW_READ, "/d/{ds}/r/{rev}/appearance.json",                                        \
      "The appearance network of a revision, for clients that compute colours themselves")         \
    X(PHOTOGRAPHS, ALLOW_READ, "/d/{ds}/r/{rev}/appearances.json",                                 \
      "Photographs of a revision: embeddings, times, poses, thumbnails")                           \
    X(THUMBNAIL, ALLOW_READ, "/d/{ds}/r/{rev}/appearances/{row}.jpg",                              \
      "A photograph, 160 pixels wide or high")                                                     \
    X(APPEARANCE, ALLOW_READ, "/d/{ds}/appearance",                                                \
      "One appearance or blend: embedding, nearest photographs, links")                            \
    X(MIX, ALLOW_POST, "/d/{ds}/appearances:mix", "An appearance from weights or an embedding")    \
    X(RENDER, ALLOW_POST, "/d/{ds}/render", "A rendered view of a posted camera")                  \
    X(MOTION, ALLOW_READ | ALLOW_POST, "/d/{ds}/motion/{stream}",                                  \
      "GET: pictures that follow a camera, in one answer; POST: where the camera is")              \
    X(SEED_MOVING, ALLOW_READ, "/d/{ds}/seed.ndjson", "Tiles to prefetch, most important first")   \
    X(SEED, ALLOW_READ, "/d/{ds}/r/{rev}/seed.ndjson",                                             \
      "Tiles of a revision to prefetch, most important first")                                     \
    X(HEALTH, ALLOW_READ, "/healthz", "200 while the process lives")                               \
    X(READY, ALLOW_READ, "/readyz", "200 while requests are welcome")                              \
    X(VERSION, ALLOW_READ, "/version", "Program, datasets, device")                                \
    X(METRICS, ALLOW_READ, "/metrics", "Prometheus text, to whom --metrics allows it")             \
    X(RELOAD, ALLOW_POST, "/-/reload", "Open the stores again (on the listener of --admin alone)") \
    X(NONE, 0, "unmatched", "No such path")

enum route {
#define ROUTE_ENUM(id, allow, path, summary) ROUTE_##id,
    ROUTE_LIST(ROUTE_ENUM)
#undef ROUTE_ENUM
        ROUTE_COUNT
};
/* The template of a route's paths, and what it allows. */
const char *target_path(enum route r);
unsigned target_allow(enum route r);

/* X(id, extension, media type): what a tile and a picture can be. */
#define FORMAT_LIST(X)                                                                             \
    X(GLB, "glb", "model/gltf-binary")                                                             \
    X(SPZ, "spz", "application/octet-stream")                                                      \
    X(DRC, "drc", "application/octet-stream")                                                      \
    X(PLY, "ply", "application/octet-stream")                                                      \
    X(GLB_PLAIN, "plain.glb", "model/gltf-binary")                                                 \
    X(PLY_PACKED, "compressed.ply", "application/octet-stream")                                    \
    X(SOG, "sog", "application/zip")                                                               \
    X(JPG, "jpg", "image/jpeg")                                                                    \
    X(PNG, "png", "image/png")                                                                     \
    X(WEBP, "webp", "image/webp")                                                                  \
    X(NPY, "npy", "application/octet-stream")

enum format {
#define FORMAT_ENUM(id, ext, type) FORMAT_##id,
    FORMAT_LIST(FORMAT_ENUM)
#undef FORMAT_ENUM
        FORMAT_COUNT
};
const char *target_ext(enum format f);
const char *target_type(enum format f);

struct target_pose {              /* fixed point, so that equal views are equal keys */
    int32_t lon_e7, lat_e7;       /* 1e-7 degrees */
    int32_t h_mm;                 /* ellipsoidal, mm */
    int32_t heading_e3, pitch_e3; /* 1e-3 degrees; heading 0..359999 */
    int32_t fov_e3;               /* vertical */
    int32_t roll_e3;              /* clockwise, 0..359999 */
};
/* What is behind the Gaussians of a picture, or in place of their colours; how fine it is drawn. */
enum background { BACKGROUND_COLOUR, BACKGROUND_SKY, BACKGROUND_TRANSPARENT };
enum depth { DEPTH_NONE, DEPTH_MM, DEPTH_CM, DEPTH_DM, DEPTH_M }; /* unit of a picture of depth */
struct paint {                                                    /* {0}: on black */
    enum background background;
    uint32_t rgb; /* of BACKGROUND_COLOUR: 0xRRGGBB */
    enum depth depth;
    bool said_background;
    uint32_t supersample; /* pixels drawn for one on each axis; 0: as the server finds best */
};
/* A tile's bytes are those of a format, and of the quantised ones (.glb .spz .drc) in a preset and
 * a degree of harmonics. */
enum { FORM_UNSAID = 255 };
struct form {
    enum format format;
    uint8_t preset;    /* enum quant_preset; QUANT_PRESETS: not said */
    uint8_t sh_degree; /* highest band; FORM_UNSAID */
    bool trained;      /* colours as they were trained, no appearance applied; never said here */
};
/* How a picture holds heights: what each of its colours is worth. */
enum encoding {
    ENCODING_UNSAID,
    ENCODING_MAPBOX,   /* -10000 + 0.1 (65536 R + 256 G + B) metres */
    ENCODING_TERRARIUM /* -32768 + 256 R + G + B / 256 metres */
};
/* Where a camera goes (course.h), in thousandths but for pixels; 0: not said. */
struct target_course {
    const char *path; /* [n_path], borrowed from the target's text; NULL: no camera is named */
    size_t n_path;
    uint32_t width_px, height_px, fov_e3, error_e3, speed_e3, horizon_e3;
};
/* A polygon that does not cross itself; in one spelling, so that equal ones are equal bytes. */
struct target_clip {
    uint32_t n; /* corners, 0: none was said */
    int32_t corner_e7[TARGET_CLIP_CORNERS][2];
};
enum search_sort { SEARCH_BY_NUMBER, SEARCH_BY_DISTANCE, SEARCH_BY_TIME, SEARCH_BY_COLOUR };
struct target_search { /* of appearances; the target has bbox and page */
    bool asked, has_near, has_time, has_hours, has_colour, kept; /* kept: named ones alone */
    int32_t near_e7[2];
    uint32_t radius_e3; /* m; 0: any */
    int64_t time_s[2];  /* since 1970 by the cameras' clocks, both included */
    uint8_t hours[2];   /* from, and to without it; over midnight where from is the later */
    uint32_t rgb;
    enum search_sort sort;
};
struct target {
    enum route route;
    char ds[64], rev[13], edition[9]; /* edition: "": not said */
    struct key key;
    struct form form;                       /* of views only the format counts */
    char appearance[TARGET_APPEARANCE_MAX]; /* "": not said */
    char kept[TARGET_KEPT_MAX];             /* of KEPT; elsewhere the name that appearance was,
                                             * before it became what it stands for; "": none */
    struct target_clip clip;                /* of tiles and what lists them */
    struct target_pose pose; /* of height: longitude and latitude alone, if has_place */
    bool has_place;
    uint32_t width_px, height_px; /* of the picture, @2x and so on counted */
    struct paint paint;
    uint8_t scale;          /* of map and terrain tiles: 1, or 2 for twice the pixels */
    enum encoding encoding; /* of terrain */
    uint32_t row;           /* of a thumbnail */
    char stream[64];        /* of motion */
    struct target_search search;
    /* seed, collections and search: */
    bool has_bbox;
    int32_t bbox_e7[4]; /* west south east north */
    bool has_heights;   /* these of collections */
    int64_t heights_mm[2];
    /* seed, and search: */
    uint8_t z_min, z_max;
    uint32_t after, limit; /* lines that are left out before, and at most */
    struct target_course course;
    size_t path_size; /* bytes of the path, before '?' */
};
/* May an appearance be kept under it? [a-z0-9][a-z0-9_-]*, and none of the words that mean
 * something. */
bool target_is_kept_name(const char *name);
/* ERR_FORMAT: bytes no legal target has (status 400). ERR_DATA: well formed, impossible numbers
 * (422). ERR_NOENT: no such route, or a key out of range (404). `path` has n bytes and no NUL. */
enum err_code target_parse(const char *text, size_t n, struct target *out, struct err *e) ERR_USE;

/* RRGGBB, sky or transparent; mm, cm, dm or m: what a text[n] says. False: neither. */
bool target_read_background(const char *text, size_t n, struct paint *out);
bool target_read_depth(const char *text, size_t n, struct paint *out);

/* Percent-encode a text as a value of a query: RFC 3986's unreserved characters stay, and ',' ':'
 * '=', which it allows there. out holds 3 bytes for each of text, and one more. */
void target_escape(const char *text, char *out);
/* The query of a prefetch list again, "?...", that goes on after so many lines. path: of the
 * course, for the borrowed one may be gone; NULL where there is none. */
void target_seed_query(const struct target *t, const char *path, uint32_t after, struct buf *out);

/* "?preset=NAME&sh=N&clip=C&appearance=A" as far as the target says them, else "". */
void target_query(const struct target *t, char out[TARGET_QUERY_MAX]);

/* ---- target_clip.c ---- */

/* The polygon for use: clip_free it. ERR_DATA, ERR_MEM. */
enum err_code target_open_clip(const struct target_clip *c, struct clip *out,
                               struct err *e) ERR_USE;
/* "lon,lat,lon,lat,...", the one spelling of it. */
void target_clip_text(const struct target_clip *c, char out[TARGET_CLIP_TEXT]);

/* ---- target_search.c ---- */

/* A date, or a time as RFC 3339 writes it but for an offset, "Z" or nothing: seconds since 1970
 * 00:00 by the same clock. to_s (may be NULL): its end, of a date the day's. False: neither. */
bool target_read_time(const char *text, size_t n, int64_t *from_s, int64_t *to_s);
/* The query of a search again, "?...", that goes on after so many. */
void target_search_query(const struct target *t, uint32_t after, struct buf *out);

/* What target.c, target_place.c and target_seed.c have of each other: each reads on from t, or a
 * whole query of n bytes, and fills its part of the target. Errors as of target_parse. */
struct text;

/* ---- target.c ---- */

bool target_is_terrain(enum route r);
bool target_is_of_tiles(enum route r); /* a tile, or what lists tiles */
/* The rest must be one of the extensions [first, last]. */
bool target_take_format(struct text *t, enum format first, enum format last, enum format *out);
/* One part of a query: preset=NAME, sh=N, appearance=A, clip=C, of terrain encoding=E, of views
 * background=B and depth=U, each at most once; *known says whether it was one of them. */
enum err_code target_take_form(struct text *one, struct target *target, bool *known,
                               struct err *e) ERR_USE;

/* ---- target_place.c ---- */

/* {z}/{x}/{y}.{ext} */
enum err_code target_parse_tile(struct text *t, enum route route, struct target *out,
                                struct err *e) ERR_USE;
/* {z}/{x}/{y}.json: a part of a tileset */
enum err_code target_parse_part(struct text *t, struct target *out, struct err *e) ERR_USE;
/* {z}/{x}/{y}[@2x].{fmt}: a map; terrain is PNG, since its pixels are numbers. */
enum err_code target_parse_map(struct text *t, enum route route, struct target *out,
                               struct err *e) ERR_USE;
/* {lon},{lat},{h}@{heading},{pitch}[,{fov}[,{roll}]]/{w}x{h}[@{s}x].{fmt} */
enum err_code target_parse_view(struct text *t, enum route route, struct target *out,
                                struct err *e) ERR_USE;
/* ?lon=X&lat=Y, both or (for POST) neither; other keys are ignored. */
enum err_code target_parse_place(const char *query, size_t n, struct target *out,
                                 struct err *e) ERR_USE;
/* Of /collections?bbox=w,s,e,n or w,s,lowest,e,n,highest; commas may come as %2C. Other keys are
 * ignored. */
enum err_code target_parse_bbox(const char *query, size_t n, struct target *out,
                                struct err *e) ERR_USE;

/* ---- target_clip.c ---- */

/* What follows "clip=". ERR_FORMAT: no such text, or a route of something else; ERR_DATA: no
 * polygon. */
enum err_code target_take_clip(struct text *one, struct target *out, struct err *e) ERR_USE;

/* ---- target_search.c ---- */

/* The query of a search for appearances; ERR_FORMAT, ERR_DATA: numbers out of range. */
enum err_code target_parse_search(const char *query, size_t n, struct target *out,
                                  struct err *e) ERR_USE;

/* ---- target_seed.c ---- */

/* The query of a prefetch list; ERR_DATA: numbers out of range. */
enum err_code target_parse_seed(const char *query, size_t n, struct target *out,
                                struct err *e) ERR_USE;

#endif
