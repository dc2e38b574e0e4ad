/* The server: tile stores in, HTTP out. One request's way:
 *
 *   http.c     libmicrohttpd -> struct request; refuses malformed requests; suspends and resumes
 *   target.c   the target, once, into integers and enums: no byte of it ever becomes a path
 *   route.c    request + services -> response, pure; what is not in the cache is a job first
 *   job.c      bounded queues, identical jobs share one run, deadlines, cancellation
 *   encode.c   tile -> .glb .spz .drc .ply
 *   picture.c  camera -> .jpg .png .webp
 *   cache.c    what jobs made, bounded in bytes
 *   watch.c    slow, idle and gone clients
 *
 * Nothing slow happens on an HTTP thread. Reading order: this header, target.c, route.c, job.c,
 * http.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_SERVER_H
#define SERVER_SERVER_H

#include <pthread.h>
#include <stdatomic.h>

#include "codec/quant.h"
#include "core/base.h"
#include "core/options.h"
#include "lod/lod.h"

struct server_config {
#define OPT(type, key, def, lo, hi, unit, help) OPTIONS_C_##type key;
#include "server/options.def"
#undef OPT
};

/* ---- body.c: encoded bytes that several answers share ---- */

enum { BODY_ETAG_SIZE = 32 };
struct body { /* immutable once shared; counted, body_drop frees it */
    _Atomic uint32_t refs;
    uint8_t *data;
    size_t size;
    char etag[BODY_ETAG_SIZE]; /* with its quotes */
    uint8_t *gzip;             /* the same bytes compressed; NULL when that does not pay */
    size_t gzip_size;
};
/* Take b's bytes (b is left {0}). etag NULL: the hash of the bytes. NULL when out of memory (b is
 * freed). */
struct body *body_take(struct buf *b, const char *etag);
struct body *body_text(const char *text); /* copy of a string; NULL when out of memory */
struct body *body_ref(struct body *b);
void body_drop(struct body **b); /* accepts NULL inside, leaves NULL */
/* Add the gzip form when it saves at least a tenth. Only before the body is shared. */
void body_compress(struct body *b);
/* "22 characters of base64url", quoted: the strong entity tag of a 128-bit hash. */
void body_etag(struct hash128 h, char out[BODY_ETAG_SIZE]);

/* ---- cache.c: segmented LRU in 16 shards, bounded in bytes ---- */

struct cache;
struct cache_stats {
    uint64_t hits, misses, evictions, entries, bytes;
};
enum err_code cache_open(size_t limit_bytes, struct cache **out, struct err *e) ERR_USE;
void cache_close(struct cache **c);
/* A reference to the body, or NULL. Any thread. */
struct body *cache_get(struct cache *c, struct hash128 key);
/* Keep a reference of its own. Entries larger than a shard's budget are not kept. The newer wins.
 */
void cache_put(struct cache *c, struct hash128 key, struct body *b);
void cache_count(struct cache *c, struct cache_stats *out);

/* ---- job.c: slow work, away from the HTTP threads ---- */

enum job_class { JOB_VIEW, JOB_TILE, JOB_PREFETCH, JOB_CLASSES };
enum job_end { JOB_OK, JOB_ERROR, JOB_CANCELLED, JOB_SHED, JOB_TIMEOUT, JOB_ENDS };

struct job_result {
    enum job_end end;
    enum err_code code;
    char msg[256];
    struct body *body; /* a reference of the waiter's own when end is JOB_OK */
    double queue_s, run_s;
    bool coalesced; /* another request had started this job */
};

/* Someone who wants a job's result. Lives in the caller's memory from job_submit until it was
 * woken. */
struct job_waiter {
    /* Called exactly once, on another thread, under no lock, unless job_submit refused or job_leave
     * claimed the waiter. The waiter may be freed from inside. */
    void (*wake)(struct job_waiter *w);
    struct job_result result; /* set before wake */
    struct job_waiter *next;  /* the rest belongs to job.c */
    struct job *job;
    double deadline_s;
};

struct job; /* one run; passed to the functions below */
struct job_config {
    size_t tile_threads; /* they run JOB_TILE, then JOB_PREFETCH, oldest first */
    bool view_thread;    /* one thread runs JOB_VIEW, newest first */
    size_t queue_limit[JOB_CLASSES];
    double slow_s; /* a failed job is not tried again for this long, doubling to 60 s; 0 = 2 s */
    void *user;
    /* Make the body of `work`; poll job_cancelled where it is cheap. Tile threads pass worker
     * 0..n-1. */
    enum err_code (*run)(void *user, const struct job *j, void *work, size_t worker,
                         struct body **out, struct err *e);
    void (*drop)(void *user, void *work); /* free the work */
    void (*view_enter)(void *user); /* on the view thread, before its first job; may be NULL */
    void (*view_leave)(void *user);
};
struct job_stats {
    uint64_t ended[JOB_CLASSES][JOB_ENDS], coalesced, queued[JOB_CLASSES], running[JOB_CLASSES];
    double run_s[JOB_CLASSES]; /* sum */
};
struct jobs;
enum err_code job_open(const struct job_config *cfg, struct jobs **out, struct err *e) ERR_USE;
/* Ask for the work named `id` (equal ids are equal bytes). `work` is owned by the callee from here
 * on. ERR_OK: w will be woken. ERR_BUSY: the queue is full or the server is stopping; w->result
 * says so and w is not woken. A known failure is refused the same way with its own code and end
 * JOB_ERROR. */
enum err_code job_submit(struct jobs *js, enum job_class cls, struct hash128 id, void *work,
                         double timeout_s, struct job_waiter *w) ERR_USE;
/* The client is gone. True: w was still waiting, is out of the job now and will not be woken. A job
 * that lost its last waiter is dropped from the queue; a running view is cancelled, a running tile
 * is finished for the cache. */
bool job_leave(struct jobs *js, struct job_waiter *w);
enum job_class job_class_of(struct jobs *js, const struct job_waiter *w); /* while w waits */
bool job_cancelled(const struct job *j);
/* Wake waiters whose deadline is over; called a few times a second. */
void job_tick(struct jobs *js, double now_s);
/* Seconds after which asking again makes sense: 1..10. */
int job_retry_after(struct jobs *js, enum job_class cls);
void job_count(struct jobs *js, struct job_stats *out);
bool job_idle(struct jobs *js); /* nothing queued, nothing running */
/* Refuse new work, wake every waiter with JOB_SHED, wait for the running jobs (cancelled), join. */
void job_stop(struct jobs *js);
void job_close(struct jobs **js); /* job_stop, then free */

/* ---- look.c: the appearance API ---- */

enum { LOOK_TEXT_MAX = 512, LOOK_QUERY_MAX = 3 * LOOK_TEXT_MAX + 96 };
struct dataset;
struct target;
struct look { /* {0} is the default one */
    bool set;
    float image[APPEARANCE_IMAGE_MAX]; /* embedding, [len_image] */
    struct hash128 hash;               /* of it */
};
/* The look that a text names (bake_find); "" and BAKE_DEFAULT are the default one. */
enum err_code look_find(const struct dataset *d, const char *text, struct look *out,
                        struct err *e) ERR_USE;
/* Make *id the name of the same thing in this look. */
void look_mix(struct hash128 *id, const struct look *look);
/* "?preset=NAME&sh=N&appearance=LOOK" as far as the target says them, else "". */
void look_query(const struct target *t, char out[LOOK_QUERY_MAX]);
/* The documents: all looks of a dataset, one look. ERR_NOENT: no such look; ERR_ARG: it is no look.
 */
enum err_code look_list(const struct dataset *d, struct body **out, struct err *e) ERR_USE;
enum err_code look_describe(const struct dataset *d, const char *text, struct body **out,
                            struct err *e) ERR_USE;
/* The posted mix, as a look's text. ERR_FORMAT = 400, ERR_DATA = 422, ERR_NOENT = 404. */
enum err_code look_read_mix(const struct dataset *d, const void *body, size_t n,
                            char text[LOOK_TEXT_MAX], struct err *e) ERR_USE;

/* ---- dataset.c: the stores that are served ---- */

struct dataset { /* immutable; counted */
    _Atomic uint32_t refs;
    char *path;
    struct store_meta meta;
    const struct store_tile *tiles;
    size_t n_tiles;
    const struct store *index;           /* for store_find and look_find only */
    const struct appearance *appearance; /* of the store; NULL: one look only */
    double bbox[6];                      /* west south hmin east north hmax, degrees and metres */
    struct hash128 salt;         /* of all that goes into an encoded tile beside its payload */
    struct body *tileset;        /* URIs relative to d/NAME/r/REV/ */
    struct body *tileset_moving; /* URIs relative to d/NAME/ */
    struct body *tilejson;
    struct body *collection;
    struct body *appearances;
    double retired_s;     /* clock_s() when a newer revision took over; 0 = current */
    pthread_mutex_t lock; /* of free_store, n_free */
    struct store **stores, **free_store;
    size_t n_stores, n_free;
};
/* Open `path` with `readers` handles for workers and make its documents. */
enum err_code dataset_open(const char *path, size_t readers, const char *public_url,
                           struct dataset **out, struct err *e) ERR_USE;
struct dataset *dataset_ref(struct dataset *d);
void dataset_drop(struct dataset **d);
/* A handle for this thread alone until dataset_return. NULL only if more threads borrow than
 * `readers`. */
struct store *dataset_borrow(struct dataset *d);
void dataset_return(struct dataset *d, struct store *s);

struct catalog { /* immutable; counted: a reload makes a new one */
    _Atomic uint32_t refs;
    size_t n;
    struct dataset **ds; /* sorted by name; the current revision of a name first */
    struct body *collections;
};
/* Open every path. `older` (may be NULL) gives unchanged datasets and revisions that stay a day
 * more. */
enum err_code catalog_open(const char *const *paths, size_t n, size_t readers,
                           const char *public_url, struct catalog *older, struct catalog **out,
                           struct err *e) ERR_USE;
struct catalog *catalog_ref(struct catalog *c);
void catalog_drop(struct catalog **c);
/* rev "" = the current one. NULL when there is none. */
struct dataset *catalog_find(const struct catalog *c, const char *name, const char *rev);

/* ---- static.c: the viewer's files, loaded at start ---- */

struct static_file {
    char *path; /* "/assets/x.js" */
    const char *type;
    bool immutable; /* its name carries a hash */
    struct body *body;
};
struct static_table {         /* {0} is empty */
    struct static_file *file; /* sorted by path */
    size_t n, cap;
};
/* Load all files below dir (at most 4096 files, 256 MB). static_free it. */
enum err_code static_load(const char *dir, struct static_table *out, struct err *e) ERR_USE;
void static_free(struct static_table *t);
const struct static_file *static_find(const struct static_table *t, const char *path, size_t n);
/* Where the viewer is when --web-dir is not given: ../../web/dist (a build folder), ../web/dist or
 * ../share/citysplat/web beside the running program. False when it is in none of them. */
bool static_default_dir(char out[FILE_PATH_MAX]);

/* ---- target.c: a request target as integers and enums ---- */

enum method { METHOD_GET, METHOD_HEAD, METHOD_POST, METHOD_OPTIONS, METHOD_OTHER, METHOD_UNKNOWN };
/* What a route answers, as bits. */
enum { ALLOW_READ = 1, ALLOW_POST = 2 };

/* X(id, allow, path, summary): the routes; /api, metrics and 405 answers come from this list. */
#define ROUTE_LIST(X)                                                                              \
    X(LANDING, ALLOW_READ, "/", "The viewer (HTML) or the landing page (JSON), by Accept")         \
    X(STATIC, ALLOW_READ, "/{file}", "Files of the viewer")                                        \
    X(CONFORMANCE, ALLOW_READ, "/conformance", "Conformance classes")                              \
    X(API, ALLOW_READ, "/api", "This description (OpenAPI 3.0)")                                   \
    X(COLLECTIONS, ALLOW_READ, "/collections", "All datasets")                                     \
    X(COLLECTION, ALLOW_READ, "/collections/{ds}", "One dataset")                                  \
    X(TILEJSON, ALLOW_READ, "/collections/{ds}/tiles.json", "TileJSON 3.0.0 of a dataset")         \
    X(TILESET_MOVING, ALLOW_READ, "/d/{ds}/tileset.json", "3D Tiles 1.1 entry, current revision")  \
    X(TILESET, ALLOW_READ, "/d/{ds}/r/{rev}/tileset.json", "3D Tiles 1.1 tileset of a revision")   \
    X(TILE, ALLOW_READ, "/d/{ds}/r/{rev}/t/{z}/{x}/{y}.{ext}", "One tile of Gaussians")            \
    X(TILE_MOVING, ALLOW_READ, "/d/{ds}/t/{z}/{x}/{y}.{ext}", "Redirect to the current revision")  \
    X(VIEW, ALLOW_READ,                                                                            \
      "/d/{ds}/r/{rev}/static/{lon},{lat},{h}@{heading},{pitch}[,{fov}]/{w}x{h}.{fmt}",            \
      "A rendered view")                                                                           \
    X(VIEW_MOVING, ALLOW_READ,                                                                     \
      "/d/{ds}/static/{lon},{lat},{h}@{heading},{pitch}[,{fov}]/{w}x{h}.{fmt}",                    \
      "Redirect to the current revision")                                                          \
    X(APPEARANCES, ALLOW_READ, "/d/{ds}/appearances", "All looks of a dataset")                    \
    X(APPEARANCE, ALLOW_READ, "/d/{ds}/appearance",                                                \
      "One look or blend: embedding, nearest photographs, links")                                  \
    X(MIX, ALLOW_POST, "/d/{ds}/appearances:mix", "A look from weights or from an embedding")      \
    X(RENDER, ALLOW_POST, "/d/{ds}/render", "A rendered view of a posted camera")                  \
    X(SEED, ALLOW_READ, "/d/{ds}/seed.ndjson", "Tiles to prefetch, most important first")          \
    X(HEALTH, ALLOW_READ, "/healthz", "200 while the process lives")                               \
    X(READY, ALLOW_READ, "/readyz", "200 while requests are welcome")                              \
    X(VERSION, ALLOW_READ, "/version", "Program, datasets, device")                                \
    X(METRICS, ALLOW_READ, "/metrics", "Prometheus text, to loopback clients only")                \
    X(NONE, 0, "unmatched", "No such path")

enum route {
#define ROUTE_ENUM(id, allow, path, summary) ROUTE_##id,
    ROUTE_LIST(ROUTE_ENUM)
#undef ROUTE_ENUM
        ROUTE_COUNT
};

/* X(id, extension, media type): what a tile and a picture can be. */
#define FORMAT_LIST(X)                                                                             \
    X(GLB, "glb", "model/gltf-binary")                                                             \
    X(SPZ, "spz", "application/octet-stream")                                                      \
    X(DRC, "drc", "application/octet-stream")                                                      \
    X(PLY, "ply", "application/octet-stream")                                                      \
    X(GLB_PLAIN, "plain.glb", "model/gltf-binary")                                                 \
    X(JPG, "jpg", "image/jpeg")                                                                    \
    X(PNG, "png", "image/png")                                                                     \
    X(WEBP, "webp", "image/webp")

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
};
/* A tile's bytes are those of a format, and of the quantised ones (.glb .spz .drc) in a preset and
 * a degree of harmonics. */
enum { FORM_UNSAID = 255 };
struct form {
    enum format format;
    uint8_t preset;    /* enum quant_preset; QUANT_PRESETS: not said */
    uint8_t sh_degree; /* highest band; FORM_UNSAID */
};
struct target {
    enum route route;
    char ds[64], rev[13];
    struct key key;
    struct form form;               /* of views only the format counts */
    char appearance[LOOK_TEXT_MAX]; /* the look, "": not said */
    struct target_pose pose;
    uint32_t width_px, height_px;
    /* seed: */
    bool has_bbox;
    int32_t bbox_e7[4]; /* west south east north */
    uint8_t z_min, z_max;
    size_t path_size; /* bytes of the path, before '?' */
};
/* ERR_FORMAT: bytes no legal target has (status 400). ERR_DATA: well formed, impossible numbers
 * (422). ERR_NOENT: no such route, or a key out of range (404). `path` has n bytes and no NUL. */
enum err_code target_parse(const char *text, size_t n, struct target *out, struct err *e) ERR_USE;

/* ---- condition.c: the conditional and negotiating headers ---- */

/* Does If-None-Match (a list or *) hold `etag`, compared weakly? NULL header: false. */
bool condition_none_match(const char *header, const char *etag);
enum condition_range { RANGE_ALL, RANGE_PART, RANGE_BAD };
/* One `bytes=` range over a body of `size`. Several ranges, other units and nonsense mean
 * RANGE_ALL. */
enum condition_range condition_range(const char *header, uint64_t size, uint64_t *first,
                                     uint64_t *length);
/* Accept-Encoding takes gzip (q > 0). */
bool condition_gzip(const char *header);
/* Accept prefers text/html over application/json. */
bool condition_html(const char *header);

/* ---- picture.c: views of stores, on one thread that owns the OpenCL device ---- */

struct picture;
enum picture_state { PICTURE_STARTING, PICTURE_READY, PICTURE_OFF };
enum err_code picture_open(const struct server_config *cfg, struct picture **out,
                           struct err *e) ERR_USE;
void picture_close(struct picture **p);
void picture_enter(struct picture *p); /* on the view thread: open the device, build the kernels */
void picture_leave(struct picture *p);
enum picture_state picture_state(const struct picture *p);
/* Device name when ready, else why there is none. Copied under the lock. */
void picture_about(struct picture *p, char *out, size_t n);

/* ---- encode.c: the work of jobs ---- */

enum work_kind { WORK_TILE, WORK_SEED, WORK_TILESET, WORK_VIEW };
struct work { /* freed with encode_drop */
    enum work_kind kind;
    struct dataset *ds; /* a reference */
    struct hash128 id;  /* names the result: cache key and job id */
    struct key key;     /* WORK_TILE */
    struct form form;   /* nothing left unsaid */
    struct look look;
    struct target target; /* WORK_SEED, WORK_TILESET */
    struct camera cam;    /* WORK_VIEW */
    int quality;
    bool keep; /* put the result into the cache */
};
struct services;
/* Run on a worker: from the store to bytes. The result goes to the cache before the job ends. */
enum err_code encode_run(void *services, const struct job *j, void *work, size_t worker,
                         struct body **out, struct err *e) ERR_USE;
void encode_drop(void *services, void *work);
/* What a target leaves unsaid: the preset that `citysplat serve` was given, the dataset's degree.
 * Of formats that are not quantised there is one form only. */
struct form encode_form(const struct server_config *cfg, const struct store_meta *meta,
                        const struct form *asked);
/* One tile to bytes of a form, in a look. */
enum err_code encode_tile(struct store *s, struct key key, struct form form,
                          const struct look *look, struct buf *out, struct err *e) ERR_USE;
/* form, look: of the entity tags; the addresses have them where t says them. */
enum err_code encode_seed(const struct dataset *d, const struct target *t, struct form form,
                          const struct look *look, struct buf *out, struct err *e) ERR_USE;
/* Hash of what the encoders make of a fixed sample with this meta. Entity tags contain it, so that
 * they change whenever the encoders, or the libraries below them, do: equal tags are equal bytes.
 */
enum err_code encode_fingerprint(const struct store_meta *meta, struct hash128 *out,
                                 struct err *e) ERR_USE;
/* Name of a tile's bytes: payload, form, and everything else that decides them. */
struct hash128 encode_tile_id(const struct dataset *d, const struct store_tile *t, struct form f,
                              const struct look *look);
/* On the view thread. */
enum err_code picture_make(struct picture *p, const struct job *j, const struct work *w,
                           struct buf *out, struct err *e) ERR_USE;

/* ---- metrics.c ---- */

enum { METRICS_CODES = 24, METRICS_BUCKETS = 14 };
struct metrics {
    _Atomic uint64_t requests[ROUTE_COUNT][METRICS_CODES];
    _Atomic uint64_t seconds_bucket[ROUTE_COUNT][METRICS_BUCKETS], seconds_us[ROUTE_COUNT];
    _Atomic uint64_t response_bytes, inflight, connections, client_aborts, reaped, store_errors,
        reload_failed, rejected;
};
void metrics_request(struct metrics *m, enum route route, int status, double seconds,
                     uint64_t bytes);
struct services;
enum err_code metrics_text(struct services *s, struct buf *out, struct err *e) ERR_USE;

/* ---- access.c: one log line a request, written in batches ---- */

struct access;
struct access_line {
    const char *method, *target, *cache; /* cache may be NULL */
    int status;
    uint64_t bytes;
    double seconds;
};
enum err_code access_open(struct access **out, struct err *e) ERR_USE;
void access_add(struct access *a,
                const struct access_line *x); /* any thread, never waits for I/O */
void access_flush(struct access *a);
void access_close(struct access **a); /* flushes */

/* ---- route.c: the pure heart ---- */

struct services { /* what an answer may draw on; all shared, all thread-safe */
    const struct server_config *cfg;
    pthread_mutex_t catalog_lock; /* of catalog */
    struct catalog *catalog;
    struct static_table web;
    struct cache *cache;
    struct jobs *jobs;
    struct picture *picture; /* NULL: pictures are off */
    struct access *access;   /* NULL: no access log */
    struct metrics metrics;
    struct body *landing, *conformance, *api; /* documents that never change */
    _Atomic bool draining;
    double start_s;
};
/* {0} services -> ready documents; services_free takes back everything. */
enum err_code services_open(struct services *s, const struct server_config *cfg,
                            struct err *e) ERR_USE;
void services_free(struct services *s);
struct catalog *services_catalog(struct services *s); /* a reference */

struct request { /* borrowed from the connection */
    enum method method;
    const char *target; /* raw, as sent */
    size_t target_size;
    const char *accept, *accept_encoding, *if_none_match, *if_range, *range; /* NULL when absent */
    const void *body;
    size_t body_size;
    bool prefetch; /* Sec-Purpose: prefetch, or a low Priority */
    bool local;    /* the client is this machine, and no proxy speaks for another */
};
struct response { /* {0}, then route_answer; route_free it */
    int status;
    enum route route;
    const char *type, *cache_control, *allow, *vary, *encoding; /* static strings, NULL = none */
    char *location;                                             /* owned */
    char etag[BODY_ETAG_SIZE];                                  /* "" = none */
    char surrogate[96];
    struct key tile;     /* that is asked for, and the name of its dataset, "" for anything else: */
    char tile_of[64];    /* what a problem with it names */
    struct body *body;   /* a reference; NULL = no bytes */
    const uint8_t *data; /* what to send: inside body */
    size_t size;
    uint64_t range_first, range_total; /* of 206 and 416 */
    bool accept_ranges;
    int retry_after_s;     /* 0 = none */
    double queue_s, run_s; /* of the job, for Server-Timing; < 0: there was none */
    const char *cache;     /* "hit", "miss", "shared": for the log */
    struct work *work;     /* not NULL: submit it, then route_finish */
    enum job_class cls;
    double timeout_s;
};
/* Answer at once, or set out->work. Never blocks, never fails: a failure is an answer too. */
void route_answer(struct services *s, const struct request *r, struct response *out);
/* The job has ended: turn its result (whose body reference is taken) into the answer. */
void route_finish(struct services *s, const struct request *r, struct job_result *result,
                  struct response *out);
/* A problem document (RFC 9457) in place of whatever `out` held. */
void route_problem(struct response *out, int status, const char *detail);
void route_free(struct response *r);
const char *route_status_text(int status);
const char *route_path(enum route r);
unsigned route_allow(enum route r);

/* describe.c: the JSON documents. */
/* json's reference is taken; NULL json is out of memory. */
enum err_code describe_json(struct json_t *json, struct body **out, struct err *e) ERR_USE;
enum err_code describe_landing(struct body **out, struct err *e) ERR_USE;
enum err_code describe_conformance(struct body **out, struct err *e) ERR_USE;
enum err_code describe_api(struct body **out, struct err *e) ERR_USE;
enum err_code describe_collection(const struct dataset *d, struct body **out,
                                  struct err *e) ERR_USE;
enum err_code describe_collections(const struct catalog *c, struct body **out,
                                   struct err *e) ERR_USE;
enum err_code describe_version(struct services *s, struct body **out, struct err *e) ERR_USE;
/* The posted camera of /d/{ds}/render. ERR_FORMAT = 400, ERR_DATA = 422. */
struct describe_render {
    struct camera cam;
    enum format format;
    int quality;
    double timeout_s;
    char appearance[LOOK_TEXT_MAX]; /* "": the default look */
};
enum err_code describe_read_render(const struct server_config *cfg, const struct geo_origin *origin,
                                   const void *text, size_t n, struct describe_render *out,
                                   struct err *e) ERR_USE;

/* ---- watch.c: clients that are slow, idle or gone ---- */

enum watch_phase { WATCH_IDLE, WATCH_HEADER, WATCH_BODY, WATCH_WORK, WATCH_SEND };
struct watch;
struct watch_slot;
/* Connections up to `limit`. gone() is called under no lock when a waiting client has hung up and
 * its job was left; it must resume the connection. */
enum err_code watch_open(size_t limit, struct services *s, void (*gone)(struct job_waiter *w),
                         struct watch **out, struct err *e) ERR_USE;
void watch_close(struct watch **w);
struct watch_slot *watch_add(struct watch *w, int fd); /* NULL when full */
void watch_remove(struct watch *w, struct watch_slot *slot);
/* Enter a phase that must end within `timeout_s` (0 = for ever). Lock-free. */
void watch_phase(struct watch_slot *slot, enum watch_phase phase, double timeout_s);
uint32_t watch_requests(struct watch_slot *slot); /* counts requests of the connection: 1, 2, ... */
/* While w waits for its job, look whether the client hangs up: expect before job_submit, arm after
 * it, disarm before resuming (if that came first, arm does nothing). */
void watch_expect(struct watch *w, struct watch_slot *slot);
void watch_arm(struct watch *w, struct watch_slot *slot, struct job_waiter *waiter);
void watch_disarm(struct watch *w, struct watch_slot *slot);
void watch_stop_idle(struct watch *w); /* end of reading for idle connections: used to drain */

/* ---- http.c, server.c ---- */

struct http;
/* Take the port that cfg says, before anything slow is started; clients wait in the backlog.
 * ERR_BUSY names the port and what to do. */
enum err_code http_open(struct services *s, struct http **out, struct err *e) ERR_USE;
enum err_code http_start(struct http *h, struct err *e) ERR_USE; /* needs s->jobs */
uint16_t http_port(const struct http *h);
/* Stop listening, finish what is under way (at most drain_timeout_s), then everything is closed. */
void http_close(struct http **h);

struct server;
/* Open the stores and listen. server_stop it. */
enum err_code server_start(const struct server_config *cfg, const char *const *paths, size_t n,
                           struct server **out, struct err *e) ERR_USE;
const char *server_url(const struct server *s); /* "http://127.0.0.1:8080/" */
struct services *server_services(struct server *s);
/* Open the stores again; on any error the old ones stay. */
enum err_code server_reload(struct server *s, struct err *e) ERR_USE;
void server_stop(struct server **s); /* drains */

#endif
