/* Reads the index of a tile store: one row a tile, each with a hash of itself.
 *
 * A million rows of 28 columns are read at each start, so they do not come back from SQLite one by
 * one: the query calls a function of ours with all columns of a row. Where there are many rows, two
 * threads read half of them each, from both ends into one list.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdatomic.h>
#include <string.h>

#include "core/pool.h"
#include "lod/store/key.h"
#include "lod/store/store_db.h"

/* From the covering index that a store has beside its tiles (store_build.c), where the rows lie
 * together; older stores have none, and the rows are read between the payloads. */
#define STORE_INDEX_SQL                                                                            \
    "SELECT count(take_row(id,z,x,y,level,count,bytes,version,center_e,center_n,center_u,"         \
    "min_e,min_n,min_u,max_e,max_n,max_u,core_min_e,core_min_n,core_min_u,"                        \
    "core_max_e,core_max_n,core_max_u,sigma_median_m,sigma_max_m,geometric_error_m,"               \
    "hash,row_hash)) FROM tiles"
#define STORE_ROWS_SQL STORE_INDEX_SQL " NOT INDEXED"
enum { STORE_COLUMNS = 28 };

/* ---- a row ---- */

static uint64_t store_value_u(sqlite3_value *v, uint64_t limit, bool *ok)
{
    const sqlite3_int64 n = sqlite3_value_int64(v);
    if (n < 0 || (uint64_t)n > limit)
        *ok = false;
    return (uint64_t)n;
}

static struct hash128 store_value_hash(sqlite3_value *v, bool *ok)
{
    const void *p = sqlite3_value_blob(v);
    if (!p || sqlite3_value_bytes(v) != STORE_HASH_BYTES) {
        *ok = false;
        return (struct hash128){0};
    }
    return store_db_hash_in(p);
}

/* Sizes go into documents, which have no infinite numbers: nothing is farther than 15 radii of the
 * earth. */
#define STORE_SIZE_MOST_M 1e8
static bool store_shape_ok(const struct store_shape *x)
{
    const double *const at[] = {x->center_enu_m, x->min_enu_m, x->max_enu_m, x->core_min_enu_m,
                                x->core_max_enu_m};
    const double sizes[] = {x->sigma_median_m, x->sigma_max_m, x->geometric_error_m};
    bool ok = true;
    for (size_t i = 0; i < sizeof at / sizeof *at; i++)
        for (int k = 0; k < 3; k++)
            ok &= fabs(at[i][k]) <= STORE_SIZE_MOST_M; /* and no NaN */
    for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++)
        ok &= sizes[i] >= 0 && sizes[i] <= STORE_SIZE_MOST_M;
    return ok;
}

/* One row; false when its hash says that it is damaged. */
static bool store_row(sqlite3_value **v, struct store_entry *out)
{
    bool ok = true;
    const int64_t id = sqlite3_value_int64(v[0]);
    struct store_tile *t = &out->tile;
    struct store_shape *x = &out->shape;
    t->key.z = (uint8_t)store_value_u(v[1], KEY_ZOOM_MAX, &ok);
    t->key.x = (uint32_t)store_value_u(v[2], UINT32_MAX, &ok);
    t->key.y = (uint32_t)store_value_u(v[3], UINT32_MAX, &ok);
    t->level = (uint8_t)store_value_u(v[4], STORE_LEVEL_MAX, &ok);
    t->count = (uint32_t)store_value_u(v[5], UINT32_MAX, &ok);
    t->bytes = (uint32_t)store_value_u(v[6], INT32_MAX, &ok);
    t->version = store_value_u(v[7], STORE_VERSION_MAX, &ok) & STORE_VERSION_MAX;
    for (int k = 0; k < 3; k++) {
        x->center_enu_m[k] = sqlite3_value_double(v[8 + k]);
        x->min_enu_m[k] = sqlite3_value_double(v[11 + k]);
        x->max_enu_m[k] = sqlite3_value_double(v[14 + k]);
        x->core_min_enu_m[k] = sqlite3_value_double(v[17 + k]);
        x->core_max_enu_m[k] = sqlite3_value_double(v[20 + k]);
    }
    x->sigma_median_m = sqlite3_value_double(v[23]);
    x->sigma_max_m = sqlite3_value_double(v[24]);
    x->geometric_error_m = sqlite3_value_double(v[25]);
    t->hash = store_value_hash(v[26], &ok);
    const struct hash128 want = store_value_hash(v[27], &ok), have = store_db_row_hash(out);
    return ok && key_valid(t->key) && store_db_id(t->key) == id && have.lo == want.lo &&
           have.hi == want.hi;
}

/* Calls `take` with user (sqlite3_user_data) for the rows that sql gives. */
static int store_each_row(sqlite3 *db, const char *sql, struct key from,
                          void (*take)(sqlite3_context *, int, sqlite3_value **), void *user)
{
    sqlite3_stmt *q = NULL;
    int code =
        sqlite3_create_function_v2(db, "take_row", STORE_COLUMNS, SQLITE_UTF8 | SQLITE_DIRECTONLY,
                                   user, take, NULL, NULL, NULL);
    if (code == SQLITE_OK)
        code = sqlite3_prepare_v2(db, sql, -1, &q, NULL);
    if (code == SQLITE_OK && sqlite3_bind_parameter_count(q)) {
        sqlite3_bind_int64(q, 1, from.z);
        sqlite3_bind_int64(q, 2, from.x);
    }
    if (code == SQLITE_OK && (code = sqlite3_step(q)) == SQLITE_ROW) /* the count */
        code = sqlite3_step(q);
    sqlite3_finalize(q);
    sqlite3_create_function_v2(db, "take_row", STORE_COLUMNS, SQLITE_UTF8, NULL, NULL, NULL, NULL,
                               NULL); /* gone, as `user` will be */
    return code;
}

/* ---- all rows ---- */

int64_t store_db_tiles(const struct store *s)
{
    sqlite3_stmt *q = NULL;
    int64_t n = 0;
    if (sqlite3_prepare_v2(s->db, "SELECT CAST(value AS INTEGER) FROM meta WHERE key='tiles'", -1,
                           &q, NULL) == SQLITE_OK &&
        sqlite3_step(q) == SQLITE_ROW)
        n = sqlite3_column_int64(q, 0);
    sqlite3_finalize(q);
    return n;
}

/* How many tiles there are, as the file says, but no more than fit into it. It is where the list
 * begins, and no more than that: it grows where there are more. */
static size_t store_expected(const struct store *s)
{
    enum { UNKNOWN = 64 };
    const int64_t n = store_db_tiles(s), most = (int64_t)(s->size_bytes / STORE_ROW_BYTES);
    return (size_t)(n < 1 ? UNKNOWN : n < most ? n : most);
}

struct store_taken {
    struct store *s;
    size_t expected, n_bad;
    struct key first; /* of those */
    enum err_code rc;
    struct err *e;
};

/* Pages that point to each other in circles give rows for ever: no more are read than the file has
 * room for. */
static void store_take_row(sqlite3_context *c, int n, sqlite3_value **v)
{
    struct store_taken *t = sqlite3_user_data(c);
    struct index *x = &t->s->index;
    struct store_entry row = {0};
    (void)n;
    if (t->rc)
        return;
    const bool sound = store_row(v, &row);
    if (sound && !store_shape_ok(&row.shape))
        t->rc = err_set(t->e, ERR_FORMAT,
                        "tile %u/%u/%u: a place or a size is beyond %g m: the store was forged, or "
                        "is of a faulty program; make it again",
                        row.tile.key.z, row.tile.key.x, row.tile.key.y, STORE_SIZE_MOST_M);
    else if (sound)
        t->rc = index_add(x, &row, t->expected, t->e);
    else if (!t->n_bad++)
        t->first = row.tile.key;
    if (t->rc)
        err_add(t->e, "%s", t->s->path);
    else if (x->n + t->n_bad > t->s->size_bytes / STORE_ROW_BYTES)
        t->rc = err_set(t->e, ERR_FORMAT, "%s: damaged: more index rows than fit into the file",
                        t->s->path);
    if (t->rc)
        sqlite3_result_error(c, "stopped", -1);
}

/* Rows come in the order of the index or of the tiles; the damaged ones are left out and
 * counted. */
static enum err_code store_read_rows(struct store *s, const char *sql, size_t *n_bad, struct err *e)
{
    struct store_taken t = {.s = s, .expected = store_expected(s), .e = e};
    memcpy(s->index.pixel_m, s->meta.pixel_m, sizeof s->index.pixel_m);
    const int code = store_each_row(s->db, sql, (struct key){0}, store_take_row, &t);
    if (!t.rc && code != SQLITE_DONE)
        t.rc = store_db_fail(s, code, "index", e);
    if (t.n_bad)
        log_warn(
            "store",
            "%s: damaged index rows: %zu, that of tile %u/%u/%u first: these tiles are left out",
            s->path, t.n_bad, t.first.z, t.first.x, t.first.y);
    *n_bad = t.n_bad;
    return t.rc;
}

/* ---- in halves ---- */

struct store_half {
    sqlite3 *db;
    const char *sql;
    struct key from; /* where the second half begins */
    struct index *x;
    atomic_size_t *left; /* places of x that neither half has taken */
    size_t first, n;     /* the second one fills x from its end */
    bool down, odd;
};

static void store_take_half(sqlite3_context *c, int n, sqlite3_value **v)
{
    struct store_half *h = sqlite3_user_data(c);
    struct store_entry row = {0};
    (void)n;
    if (h->odd)
        return;
    const bool room = store_row(v, &row) && store_shape_ok(&row.shape) &&
                      atomic_fetch_sub(h->left, 1) - 1 < h->x->cap;
    h->odd = !room || !index_set(h->x, h->down ? h->first - h->n : h->first + h->n, &row);
    h->n++;
    if (h->odd)
        sqlite3_result_error(c, "stopped", -1);
}

static enum err_code store_read_half(void *user, size_t i, struct err *e)
{
    struct store_half *h = (struct store_half *)user + i;
    const int code = store_each_row(h->db, h->sql, h->from, store_take_half, h);
    return code == SQLITE_DONE ? ERR_OK : err_set(e, ERR_FORMAT, "not in halves");
}

/* Where the second half begins: a third into the columns of the finest zoom, which has three of
 * four tiles of a pyramid. */
static bool store_find_half(const struct store *s, struct key *from)
{
    static const char sql[] =
        "SELECT (SELECT min(x) FROM tiles WHERE z=?1),(SELECT max(x) FROM tiles WHERE z=?1) "
        "FROM sqlite_schema WHERE type='index' AND name='tiles_index'";
    sqlite3_stmt *q = NULL;
    bool found = sqlite3_prepare_v2(s->db, sql, -1, &q, NULL) == SQLITE_OK &&
                 sqlite3_bind_int(q, 1, s->meta.zoom_max) == SQLITE_OK &&
                 sqlite3_step(q) == SQLITE_ROW;
    const sqlite3_int64 lo = found ? sqlite3_column_int64(q, 0) : -1,
                        hi = found ? sqlite3_column_int64(q, 1) : -1;
    sqlite3_finalize(q);
    found = lo >= 0 && hi >= lo && hi < (sqlite3_int64)1 << KEY_ZOOM_MAX;
    if (found)
        *from = (struct key){.z = s->meta.zoom_max, .x = (uint32_t)(lo + (hi - lo) / 3)};
    return found;
}

bool store_read_halves(struct store *s, const char *at, const char *vfs)
{
    struct store other = {.path = s->path, .size_bytes = s->size_bytes};
    struct index x = {0};
    struct key from;
    struct err e = {0};
    const size_t n = store_expected(s);
    atomic_size_t left;
    memcpy(x.pixel_m, s->meta.pixel_m, sizeof x.pixel_m);
    atomic_init(&left, n);
    bool whole = store_find_half(s, &from) && !store_db_connect(&other, at, vfs, &e) &&
                 !index_reserve(&x, n, &e);
    if (whole) {
        struct store_half half[2] = {
            {s->db, STORE_INDEX_SQL " WHERE (z,x)<(?1,?2)", from, &x, &left, 0, 0, false, false},
            {other.db, STORE_INDEX_SQL " WHERE (z,x)>=(?1,?2)", from, &x, &left, n - 1, 0, true,
             false}};
        whole = !pool_for(2, 0, store_read_half, half, &e) && half[0].n + half[1].n == n;
    }
    sqlite3_close(other.db);
    if (whole) {
        x.n = n;
        s->index = x;
    } else
        index_free(&x);
    return whole;
}

enum err_code store_read_index(struct store *s, const char *at, const char *vfs, struct err *e)
{
    enum { MANY = 1 << 16 };
    size_t n_bad;
    enum err_code rc = ERR_OK;
    if (s->remote || store_expected(s) < MANY || !store_read_halves(s, at, vfs))
        rc = store_read_rows(s, STORE_INDEX_SQL, &n_bad, e);
    return rc ? rc : index_sort(&s->index, e);
}

enum err_code store_check_rows(const struct store *s, size_t *n_bad, struct err *e)
{
    struct store again = {.db = s->db,
                          .path = s->path,
                          .size_bytes = s->size_bytes,
                          .meta = s->meta,
                          .remote = s->remote};
    enum err_code rc = store_read_rows(&again, STORE_ROWS_SQL, n_bad, e);
    index_free(&again.index);
    return rc;
}
