/* Writes a tile store: a new SQLite file beside the old one, without journal and syncs, synced once
 * and renamed at the end. A crash or a full disk leaves the old file as it was.
 *
 * A tile that replaces one with other content in the old file gets its version + 1; with the same
 * content it keeps the version. The revision is a hash over all that is served, in the order of
 * keys. It depends neither on the order of writing nor on the clock.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "codec/splat/payload.h"
#include "core/math/sort.h"
#include "lod/store/store.h"
#include "lod/store/store_db.h"
#include "lod/store/tree.h"

#define STORE_REACH_SIGMA 3.33 /* sqrt(2 ln 255): where the most opaque splat falls below 1/255 */

#define STORE_CORE_CUT 0.02
enum { STORE_CORE_SAMPLE = 8192 };

static const char store_schema_sql[] =
    "CREATE TABLE meta(key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;"
    "CREATE TABLE tiles(id INTEGER PRIMARY KEY, z INTEGER NOT NULL, x INTEGER NOT NULL,"
    " y INTEGER NOT NULL, level INTEGER NOT NULL, count INTEGER NOT NULL, bytes INTEGER NOT NULL,"
    " version INTEGER NOT NULL, center_e REAL NOT NULL, center_n REAL NOT NULL, center_u REAL NOT "
    "NULL,"
    " min_e REAL NOT NULL, min_n REAL NOT NULL, min_u REAL NOT NULL,"
    " max_e REAL NOT NULL, max_n REAL NOT NULL, max_u REAL NOT NULL,"
    " core_min_e REAL NOT NULL, core_min_n REAL NOT NULL, core_min_u REAL NOT NULL,"
    " core_max_e REAL NOT NULL, core_max_n REAL NOT NULL, core_max_u REAL NOT NULL,"
    " sigma_median_m REAL NOT NULL, sigma_max_m REAL NOT NULL, geometric_error_m REAL NOT NULL,"
    " hash BLOB NOT NULL, row_hash BLOB NOT NULL, payload BLOB NOT NULL);"
    "CREATE TABLE blobs(name TEXT PRIMARY KEY, hash BLOB NOT NULL, bytes BLOB NOT NULL);";

/* What opening reads, without the payloads between. It is made at the end, so its pages lie
 * together: a store at an address opens with a few requests. */
static const char store_index_sql[] =
    "CREATE INDEX tiles_index ON tiles(z,x,y,level,count,bytes,version,center_e,center_n,center_u,"
    "min_e,min_n,min_u,max_e,max_n,max_u,core_min_e,core_min_n,core_min_u,core_max_e,core_max_n,"
    "core_max_u,sigma_median_m,sigma_max_m,geometric_error_m,hash,row_hash)";

static const char store_put_sql[] =
    "INSERT INTO "
    "tiles(id,z,x,y,level,count,bytes,version,center_e,center_n,center_u,min_e,min_n,min_u,"
    "max_e,max_n,max_u,core_min_e,core_min_n,core_min_u,core_max_e,core_max_n,core_max_u,"
    "sigma_median_m,sigma_max_m,geometric_error_m,hash,row_hash,payload)"
    " VALUES(?1,?2,?3,?4,?5,?6,?7,?8,?9,?10,?11,?12,?13,?14,?15,?16,?17,?18,?19,?20,?21,?22,?23,"
    "?24,?25,?26,?27,?28,?29)";

static enum err_code store_exec(struct store *s, const char *sql, const char *what, struct err *e)
{
    int code = sqlite3_exec(s->db, sql, NULL, NULL, NULL);
    return code == SQLITE_OK ? ERR_OK : store_db_fail(s, code, what, e);
}

static enum err_code store_start(struct store *s, struct err *e)
{
    enum err_code rc = file_begin(s->path, s->part, e);
    if (rc)
        return rc;
    file_abort(s->part); /* a leftover of a killed process with our id */
    file_sweep(s->path);
    int code = sqlite3_open_v2(
        s->part, &s->db, SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE | SQLITE_OPEN_NOMUTEX, NULL);
    if (code != SQLITE_OK)
        return store_db_fail(s, code, "cannot create", e);
    store_flush_open(&s->flush, s->part);
    char pragmas[256];
    snprintf(pragmas, sizeof pragmas,
             "PRAGMA page_size=%d; PRAGMA journal_mode=OFF; PRAGMA synchronous=OFF;"
             "PRAGMA locking_mode=EXCLUSIVE; PRAGMA application_id=%d; PRAGMA user_version=%d;",
             STORE_PAGE_BYTES, STORE_APPLICATION_ID, STORE_SCHEMA);
    rc = store_exec(s, pragmas, "cannot create", e);
    if (!rc)
        rc = store_exec(s, "BEGIN", "cannot create", e);
    if (!rc)
        rc = store_exec(s, store_schema_sql, "cannot create", e);
    return rc;
}

enum err_code store_create(const char *path, const struct store_meta *meta, struct store **out,
                           struct err *e)
{
    *out = NULL;
    const struct geo_origin *o = &meta->origin;
    if (!memchr(meta->name, 0, sizeof meta->name) || !store_db_name_ok(meta->name))
        return err_set(
            e, ERR_ARG,
            "name of a tile store: '%.64s': letters a-z, digits, - and _ are allowed, at most 63",
            meta->name);
    if (!isfinite(o->lon_deg) || !isfinite(o->lat_deg) || !isfinite(o->h_m) ||
        fabs(o->lat_deg) > 90.0)
        return err_set(e, ERR_ARG, "%s: origin %g, %g, %g is no place on Earth", path, o->lon_deg,
                       o->lat_deg, o->h_m);
    if (meta->sh_degree > GAUSS_SH_DEGREE_MAX || meta->embed_len > GAUSS_EMBED_MAX)
        return err_set(e, ERR_LIMIT, "%s: SH degree %u or embedding length %u is too large", path,
                       meta->sh_degree, meta->embed_len);
    if (strlen(path) >= FILE_PATH_MAX)
        return err_set(e, ERR_LIMIT, "%s: path too long", path);
    if (file_is_dir(path))
        return err_set(e, ERR_IO, "%s: is a folder, the name of a file is expected", path);
    struct store *s = NULL;
    enum err_code rc = store_alloc(path, &s, e);
    if (rc)
        return rc;
    s->meta = *meta;
    memcpy(s->index.pixel_m, s->meta.pixel_m, sizeof s->index.pixel_m);
    s->flush.fd = -1;
    s->part = mem_array(FILE_PATH_MAX, 1);
    s->building = s->part;
    rc = s->part ? store_start(s, e) : err_set(e, ERR_MEM, "%s: out of memory", path);
    if (rc) {
        store_close(&s);
        return rc;
    }
    if (file_exists(path) && store_open(path, &s->before, NULL))
        s->before = NULL; /* whatever stood there is no store of ours: versions start at 1 */
    *out = s;
    return ERR_OK;
}

/* Median and largest of the rows' largest sigmas. */
static enum err_code store_sigmas(struct store_shape *t, const struct gauss *g, struct err *e)
{
    float *big = mem_array(g->n, sizeof *big), most = -INFINITY;
    if (!big)
        return err_set(e, ERR_MEM, "out of memory for a tile of %zu Gaussians", g->n);
    for (size_t i = 0; i < g->n; i++) {
        const float *s = &g->scale_log[3 * i];
        big[i] = s[0] > s[1] ? s[0] : s[1];
        big[i] = big[i] > s[2] ? big[i] : s[2];
        most = big[i] > most ? big[i] : most;
    }
    t->sigma_median_m = exp((double)sort_select(big, g->n, g->n / 2));
    t->sigma_max_m = exp((double)most);
    mem_free(big);
    return ERR_OK;
}

/* 2 and 98 % of the means, from an even sample of them. */
static enum err_code store_core(struct store_shape *t, const struct gauss *g, struct err *e)
{
    size_t step = g->n / STORE_CORE_SAMPLE + 1, n = 0;
    float *x = mem_array(g->n / step + 1, sizeof *x);
    if (!x)
        return err_set(e, ERR_MEM, "out of memory for a tile of %zu Gaussians", g->n);
    for (size_t k = 0; k < 3; k++) {
        n = 0;
        for (size_t i = 0; i < g->n; i += step)
            x[n++] = g->mean_m[3 * i + k];
        size_t cut = (size_t)(STORE_CORE_CUT * (double)n);
        t->core_min_enu_m[k] = g->origin_enu_m[k] + (n ? (double)sort_select(x, n, cut) : 0.0);
        t->core_max_enu_m[k] =
            g->origin_enu_m[k] + (n ? (double)sort_select(x, n, n - 1 - cut) : 0.0);
    }
    mem_free(x);
    return ERR_OK;
}

/* How much larger a sigma may come out of the payload than it went in: its logarithm is rounded to
 * a half float, by 2^-11 of itself. */
static double store_growth(const struct store *s, const struct gauss *g)
{
    float most = 0.0f;
    for (size_t i = 0; i < 3 * g->n; i++) {
        float a = fabsf(g->scale_log[i]);
        most = a > most ? a : most;
    }
    return s->meta.lossless ? 1.0 : exp(ldexp((double)most, -11));
}

/* Bounds and sigmas of the rows. */
static enum err_code store_measure(const struct store *s, struct store_entry *of,
                                   const struct gauss *g, struct err *e)
{
    struct store_shape *t = &of->shape;
    double growth = store_growth(s, g);
    enum err_code rc = store_sigmas(t, g, e);
    if (rc)
        return rc;
    if (!(t->sigma_median_m > 0.0))
        return err_set(e, ERR_DATA,
                       "half of the Gaussians are of size 0: their log scales are below what exp "
                       "can hold; remove them");
    rc = store_core(t, g, e);
    if (rc)
        return rc;
    gauss_bounds(g, STORE_REACH_SIGMA * growth, t->min_enu_m, t->max_enu_m);
    t->sigma_max_m *= growth;
    if (!(t->geometric_error_m > 0.0))
        t->geometric_error_m = index_error_m(s->meta.pixel_m, of->tile.level, t->sigma_median_m);
    double sum = t->sigma_median_m + t->sigma_max_m + t->geometric_error_m;
    for (size_t k = 0; k < 3; k++) {
        /* SQLite keeps -0.0 as 0, which would hash differently. */
        t->center_enu_m[k] = g->origin_enu_m[k] + 0.0;
        t->min_enu_m[k] += 0.0;
        t->max_enu_m[k] += 0.0;
        t->core_min_enu_m[k] += 0.0;
        t->core_max_enu_m[k] += 0.0;
        sum += t->center_enu_m[k] + t->min_enu_m[k] + t->max_enu_m[k];
    }
    if (!isfinite(sum))
        return err_set(e, ERR_DATA, "a mean or scale is not a finite number");
    return ERR_OK;
}

static enum err_code store_insert(struct store *s, const struct store_entry *t,
                                  const struct buf *payload, struct err *e)
{
    uint8_t hash[STORE_HASH_BYTES], row_hash[STORE_HASH_BYTES];
    store_db_hash_out(t->tile.hash, hash);
    store_db_hash_out(store_db_row_hash(t), row_hash);
    if (!s->put) {
        int code = sqlite3_prepare_v2(s->db, store_put_sql, -1, &s->put, NULL);
        if (code != SQLITE_OK)
            return store_db_fail(s, code, "cannot write", e);
    }
    sqlite3_stmt *q = s->put;
    const sqlite3_int64 ints[] = {store_db_id(t->tile.key),
                                  t->tile.key.z,
                                  t->tile.key.x,
                                  t->tile.key.y,
                                  t->tile.level,
                                  t->tile.count,
                                  (sqlite3_int64)t->tile.bytes,
                                  t->tile.version};
    for (int i = 0; i < 8; i++)
        sqlite3_bind_int64(q, 1 + i, ints[i]);
    for (int k = 0; k < 3; k++) {
        sqlite3_bind_double(q, 9 + k, t->shape.center_enu_m[k]);
        sqlite3_bind_double(q, 12 + k, t->shape.min_enu_m[k]);
        sqlite3_bind_double(q, 15 + k, t->shape.max_enu_m[k]);
        sqlite3_bind_double(q, 18 + k, t->shape.core_min_enu_m[k]);
        sqlite3_bind_double(q, 21 + k, t->shape.core_max_enu_m[k]);
    }
    sqlite3_bind_double(q, 24, t->shape.sigma_median_m);
    sqlite3_bind_double(q, 25, t->shape.sigma_max_m);
    sqlite3_bind_double(q, 26, t->shape.geometric_error_m);
    sqlite3_bind_blob(q, 27, hash, sizeof hash, SQLITE_STATIC);
    sqlite3_bind_blob(q, 28, row_hash, sizeof row_hash, SQLITE_STATIC);
    sqlite3_bind_blob64(q, 29, payload->data, payload->size, SQLITE_STATIC);
    int code = sqlite3_step(q);
    enum err_code rc = code == SQLITE_DONE ? ERR_OK : store_db_fail(s, code, "cannot write", e);
    sqlite3_reset(q);
    sqlite3_clear_bindings(q);
    return rc;
}

enum err_code store_encode(const struct store *s, struct store_entry *t, const struct gauss *g,
                           struct buf *payload, struct err *e)
{
    if (!s->building)
        return err_set(e, ERR_INTERNAL, "%s: a published store is never changed", s->path);
    if (!key_valid(t->tile.key) || g->n == 0 || g->n > UINT32_MAX)
        return err_set(e, ERR_ARG, "%s: tile %u/%u/%u with %zu Gaussians cannot be stored", s->path,
                       t->tile.key.z, t->tile.key.x, t->tile.key.y, g->n);
    t->tile.count = (uint32_t)g->n;
    enum err_code rc = store_measure(s, t, g, e);
    if (!rc)
        rc = payload_encode(g, s->meta.lossless, payload, e);
    if (!rc && payload->size > INT32_MAX)
        rc = err_set(e, ERR_LIMIT, "payload of %zu bytes, at most 2 GiB; use smaller tiles",
                     payload->size);
    if (rc)
        return err_add(e, "tile %u/%u/%u", t->tile.key.z, t->tile.key.x, t->tile.key.y);
    t->tile.bytes = (uint32_t)payload->size;
    t->tile.hash = hash_bytes(payload->data, payload->size);
    return ERR_OK;
}

enum err_code store_add(struct store *s, struct store_entry *t, const struct buf *payload,
                        struct err *e)
{
    if (!s->building)
        return err_set(e, ERR_INTERNAL, "%s: a published store is never changed", s->path);
    const struct store_tile *old = s->before ? store_find(s->before, t->tile.key) : NULL;
    bool same = old && old->hash.lo == t->tile.hash.lo && old->hash.hi == t->tile.hash.hi;
    t->tile.version = 1;
    if (old) /* at most STORE_VERSION_MAX */
        t->tile.version = (old->version + (same || old->version == STORE_VERSION_MAX ? 0U : 1U)) &
                          STORE_VERSION_MAX;
    enum err_code rc = store_insert(s, t, payload, e);
    if (rc)
        return err_add(e, "tile %u/%u/%u", t->tile.key.z, t->tile.key.x, t->tile.key.y);
    store_flush_wrote(&s->flush, payload->size);
    enum { FIRST = 64 };
    return index_add(&s->index, t, FIRST, e);
}

enum err_code store_put(struct store *s, struct store_entry *t, const struct gauss *g,
                        struct err *e)
{
    struct buf payload = {0};
    enum err_code rc = store_encode(s, t, g, &payload, e);
    if (!rc)
        rc = store_add(s, t, &payload, e);
    buf_free(&payload);
    return rc;
}

enum err_code store_put_blob(struct store *s, const char *name, const void *bytes, size_t n,
                             struct err *e)
{
    uint8_t hash[STORE_HASH_BYTES];
    sqlite3_stmt *q = NULL;
    if (!s->building)
        return err_set(e, ERR_INTERNAL, "%s: a published store is never changed", s->path);
    store_db_hash_out(hash_bytes(n ? bytes : "", n), hash);
    int code = sqlite3_prepare_v2(s->db, "INSERT INTO blobs(name,hash,bytes) VALUES(?1,?2,?3)", -1,
                                  &q, NULL);
    if (code == SQLITE_OK) {
        sqlite3_bind_text(q, 1, name, -1, SQLITE_STATIC);
        sqlite3_bind_blob(q, 2, hash, sizeof hash, SQLITE_STATIC);
        sqlite3_bind_blob64(q, 3, n ? bytes : "", n, SQLITE_STATIC);
        code = sqlite3_step(q);
    }
    enum err_code rc = code == SQLITE_DONE ? ERR_OK : store_db_fail(s, code, name, e);
    sqlite3_finalize(q);
    return rc;
}

/* ---- commit ---- */

enum err_code store_revision(const struct store *s, char out[STORE_REVISION], struct err *e)
{
    struct buf b = {0};
    sqlite3_stmt *q = NULL;
    buf_printf(&b, "%s\n%.17g %.17g %.17g\n%u %u %d\n%s\n", s->meta.name, s->meta.origin.lon_deg,
               s->meta.origin.lat_deg, s->meta.origin.h_m, s->meta.sh_degree, s->meta.embed_len,
               s->meta.antialiased, s->meta.attribution);
    if (!heights_ellipsoidal(s->meta.heights))
        buf_printf(&b, "heights %s\n", s->meta.heights);
    enum err_code rc = ERR_OK;
    for (size_t i = 0; i < s->index.n; i++) {
        struct store_entry t = {s->index.tiles[i], index_shape(&s->index, i)};
        t.tile.version = 0; /* a history is not content */
        struct hash128 row = store_db_row_hash(&t);
        buf_u64(&b, row.lo);
        buf_u64(&b, row.hi);
    }
    int code = sqlite3_prepare_v2(s->db, "SELECT name,hash FROM blobs ORDER BY name", -1, &q, NULL);
    if (code != SQLITE_OK)
        rc = store_db_fail(s, code, "revision", e);
    while (!rc && (code = sqlite3_step(q)) == SQLITE_ROW) {
        buf_printf(&b, "%s\n", (const char *)sqlite3_column_text(q, 0));
        buf_add(&b, sqlite3_column_blob(q, 1), (size_t)sqlite3_column_bytes(q, 1));
    }
    if (!rc && code != SQLITE_DONE)
        rc = store_db_fail(s, code, "revision", e);
    sqlite3_finalize(q);
    if (!rc)
        rc = buf_check(&b, e);
    if (!rc) {
        char hex[33];
        hash_text(hash_bytes(b.data, b.size), hex);
        snprintf(out, STORE_REVISION, "%.12s", hex);
    }
    buf_free(&b);
    return rc;
}

enum { STORE_PIXELS_TEXT = 26 * STORE_LEVEL_MAX };

/* Up to the finest level that has one, separated by spaces. */
static void store_pixels_text(const struct store_meta *m, char out[STORE_PIXELS_TEXT])
{
    size_t n = STORE_LEVEL_MAX, at = 0;
    while (n > 0 && !(m->pixel_m[n - 1] > 0.0))
        n--;
    out[0] = '\0';
    for (size_t l = 0; l < n; l++)
        at += (size_t)snprintf(&out[at], STORE_PIXELS_TEXT - at, l ? " %.17g" : "%.17g",
                               m->pixel_m[l]);
}

static enum err_code store_write_meta(struct store *s, struct err *e)
{
    const struct store_meta *m = &s->meta;
    char num[10][40], pixels[STORE_PIXELS_TEXT];
    const double values[10] = {m->origin.lon_deg, m->origin.lat_deg, m->origin.h_m, m->sh_degree,
                               m->embed_len,      m->antialiased,    m->lossless,   m->zoom_min,
                               m->zoom_max,       (double)s->index.n};
    for (size_t i = 0; i < 10; i++)
        snprintf(num[i], sizeof num[i], "%.17g", values[i]);
    store_pixels_text(m, pixels);
    const char *const rows[][2] = {
        {"name", m->name},
        {"origin_lon_deg", num[0]},
        {"origin_lat_deg", num[1]},
        {"origin_h_m", num[2]},
        {"sh_degree", num[3]},
        {"embed_len", num[4]},
        {"antialiased", num[5]},
        {"lossless", num[6]},
        {"zoom_min", num[7]},
        {"zoom_max", num[8]},
        {"tiles", num[9]},
        {"attribution", m->attribution},
        {"heights", m->heights},
        {"level_pixel_m", pixels},
        {"revision", m->revision},
        {"created", m->created},
        {"writer", "citysplat " CITYSPLAT_VERSION},
    };
    sqlite3_stmt *q = NULL;
    int code = sqlite3_prepare_v2(s->db, "INSERT INTO meta(key,value) VALUES(?1,?2)", -1, &q, NULL);
    for (size_t i = 0; code != SQLITE_ERROR && q && i < sizeof rows / sizeof *rows; i++) {
        sqlite3_bind_text(q, 1, rows[i][0], -1, SQLITE_STATIC);
        sqlite3_bind_text(q, 2, rows[i][1], -1, SQLITE_STATIC);
        code = sqlite3_step(q);
        sqlite3_reset(q);
        if (code != SQLITE_DONE)
            break;
    }
    enum err_code rc = code == SQLITE_DONE ? ERR_OK : store_db_fail(s, code, "meta", e);
    sqlite3_finalize(q);
    return rc;
}

static enum err_code store_finish_meta(struct store *s, struct err *e)
{
    enum err_code rc = index_sort(&s->index, e);
    s->meta.zoom_min = s->index.tiles[0].key.z;
    s->meta.zoom_max = s->index.tiles[s->index.n - 1].key.z;
    time_t now = time(NULL);
    struct tm tm;
    if (!s->meta.created[0] && gmtime_r(&now, &tm))
        strftime(s->meta.created, sizeof s->meta.created, "%Y-%m-%dT%H:%M:%SZ", &tm);
    return rc;
}

enum err_code store_commit(struct store **sp, struct err *e)
{
    struct store *s = *sp;
    *sp = NULL;
    enum err_code rc = ERR_OK;
    if (!s->building) {
        rc = err_set(e, ERR_INTERNAL, "%s: a published store is never changed", s->path);
        goto out;
    }
    if (s->index.n == 0) {
        rc = err_set(e, ERR_DATA, "%s: no tiles, nothing to write", s->path);
        goto out;
    }
    rc = store_finish_meta(s, e);
    if (!rc)
        rc = store_revision(s, s->meta.revision, e);
    if (!rc)
        rc = store_write_meta(s, e);
    if (!rc)
        rc = store_exec(s, store_index_sql, "cannot write", e);
    if (!rc)
        rc = store_exec(s, "COMMIT", "cannot write", e);
    sqlite3_finalize(s->get);
    sqlite3_finalize(s->put);
    sqlite3_finalize(s->get_blob);
    s->get = s->put = s->get_blob = NULL;
    int code = sqlite3_close(s->db);
    if (!rc && code != SQLITE_OK)
        rc = store_db_fail(s, code, "cannot close", e);
    s->db = code == SQLITE_OK ? NULL : s->db;
    store_flush_close(&s->flush);
    if (!rc)
        rc = file_commit(s->part, s->path, e);
    if (!rc)
        s->building = false; /* so that closing does not remove it */
out:
    store_close(&s);
    return rc;
}
