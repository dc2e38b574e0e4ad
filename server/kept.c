/* Named appearances: see kept.h.
 *
 * The file is an SQLite database in WAL mode. A change is on the disk (synchronous=FULL) before it
 * is answered. One process holds the file (locking_mode=EXCLUSIVE):
 *
 *     application_id  "CSPN"      user_version  KEPT_SCHEMA
 *     kept  dataset, name         what is named; the primary key
 *           text                  its meaning
 *           model                 16 bytes, hash of the network of an embedding
 *
 * Its content is read once, when it is opened, and checked like any data from outside. Answers read
 * a table in memory; a change makes a new one after it is on the disk. `writing` is held for a
 * whole change, `lock` only to take or replace the table.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/kept.h"

#include <assert.h>
#include <errno.h>
#include <pthread.h>
#include <sqlite3.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/condition.h"
#include "server/param.h"
#include "server/text.h"

enum {
    KEPT_APPLICATION_ID = 0x4353504e, /* "CSPN" */
    KEPT_SCHEMA = 1,
    KEPT_BUSY_MS = 2000,
    KEPT_PAGES_MAX = 8192, /* of 4 KiB: several times what KEPT_MAX rows take */
    KEPT_HASH_BYTES = 16
};

struct kept {
    char path[FILE_PATH_MAX];
    pthread_mutex_t writing; /* of db and the statements */
    sqlite3 *db;
    sqlite3_stmt *put, *remove;
    pthread_mutex_t lock; /* of table */
    struct kept_table *table;
};

/* ---- tables ---- */

static int kept_compare(const void *pa, const void *pb)
{
    const struct kept_row *a = pa, *b = pb;
    int order = strcmp(a->ds, b->ds);
    return order ? order : strcmp(a->name, b->name);
}

static struct kept_table *kept_alloc(size_t n)
{
    struct kept_table *t = mem_array(1, sizeof *t);
    if (!t)
        return NULL;
    atomic_init(&t->refs, 1);
    t->row = mem_array(n ? n : 1, sizeof *t->row);
    if (!t->row) {
        mem_free(t);
        return NULL;
    }
    return t;
}

struct kept_table *kept_ref(struct kept_table *t)
{
    if (t)
        atomic_fetch_add(&t->refs, 1);
    return t;
}

void kept_drop(struct kept_table **out)
{
    struct kept_table *t = *out;
    *out = NULL;
    if (!t || atomic_fetch_sub(&t->refs, 1) != 1)
        return;
    mem_free(t->row);
    mem_free(t);
}

struct kept_table *kept_now(struct kept *k)
{
    if (!k)
        return NULL;
    pthread_mutex_lock(&k->lock);
    struct kept_table *t = kept_ref(k->table);
    pthread_mutex_unlock(&k->lock);
    return t;
}

/* Where a name is, or would be put. */
static size_t kept_place(const struct kept_table *t, const char *ds, const char *name)
{
    size_t lo = 0, hi = t->n;
    while (lo < hi) {
        const size_t mid = lo + (hi - lo) / 2;
        int order = strcmp(t->row[mid].ds, ds);
        if (!order)
            order = strcmp(t->row[mid].name, name);
        if (order < 0)
            lo = mid + 1;
        else
            hi = mid;
    }
    return lo;
}

const struct kept_row *kept_find(const struct kept_table *t, const char *ds, const char *name)
{
    if (!t)
        return NULL;
    const size_t at = kept_place(t, ds, name);
    const bool is = at < t->n && !strcmp(t->row[at].ds, ds) && !strcmp(t->row[at].name, name);
    return is ? &t->row[at] : NULL;
}

size_t kept_of(const struct kept_table *t, const char *ds, const struct kept_row **first)
{
    size_t n = 0;
    if (!t)
        return 0;
    const size_t at = kept_place(t, ds, "");
    while (at + n < t->n && !strcmp(t->row[at + n].ds, ds))
        n++;
    *first = t->row + at;
    return n;
}

static struct hash128 kept_row_hash(const struct kept_row *row)
{
    const struct {
        struct hash128 text, model;
    } is = {hash_bytes(row->text, strlen(row->text)), row->model};
    return hash_bytes(&is, sizeof is);
}

struct hash128 kept_hash(const struct kept_table *t, const char *ds)
{
    const struct kept_row *row = NULL;
    const size_t n = kept_of(t, ds, &row);
    struct hash128 all = {0};
    for (size_t i = 0; i < n; i++) {
        const struct hash128 part[3] = {all, hash_bytes(row[i].name, strlen(row[i].name)),
                                        kept_row_hash(&row[i])};
        all = hash_bytes(part, sizeof part);
    }
    return all;
}

void kept_etag(const struct kept_row *row, char out[BODY_ETAG_SIZE])
{
    body_etag(kept_row_hash(row), out);
}

/* A copy of t with `row` at its place, or without the row there (row NULL). NULL: out of memory. */
static struct kept_table *kept_changed(const struct kept_table *t, size_t at, bool replaces,
                                       const struct kept_row *row)
{
    struct kept_table *out = kept_alloc(t->n + 1);
    if (!out)
        return NULL;
    const size_t after = at + replaces;
    memcpy(out->row, t->row, at * sizeof *t->row);
    if (row)
        out->row[at] = *row;
    memcpy(out->row + at + (row != NULL), t->row + after, (t->n - after) * sizeof *t->row);
    out->n = t->n - replaces + (row != NULL);
    return out;
}

/* ---- the file ---- */

static enum err_code kept_fail(const struct kept *k, int code, const char *what, struct err *e)
{
    const char *why = k->db ? sqlite3_errmsg(k->db) : sqlite3_errstr(code);
    switch (code & 0xff) {
    case SQLITE_BUSY:
    case SQLITE_LOCKED:
        return err_set(e, ERR_BUSY, "%s: another server uses this folder", k->path);
    case SQLITE_NOMEM:
        return err_set(e, ERR_MEM, "%s: %s: out of memory", k->path, what);
    case SQLITE_FULL:
        return err_set(e, ERR_LIMIT, "%s: %s: no space left", k->path, what);
    case SQLITE_CORRUPT:
    case SQLITE_NOTADB:
    case SQLITE_ERROR:
    case SQLITE_MISMATCH:
        return err_set(
            e, ERR_FORMAT,
            "%s: %s: the file is damaged (%s): put a copy back, or move it away to begin "
            "without names",
            k->path, what, why);
    default:
        return err_set(e, ERR_IO, "%s: %s: %s", k->path, what, why);
    }
}

static enum err_code kept_do(const struct kept *k, const char *sql, struct err *e)
{
    const int code = sqlite3_exec(k->db, sql, NULL, NULL, NULL);
    return code == SQLITE_OK ? ERR_OK : kept_fail(k, code, "cannot be used", e);
}

/* The number, or the first text (as 1 where it is "ok"), that a pragma answers with. */
static enum err_code kept_ask(const struct kept *k, const char *sql, int *out, struct err *e)
{
    sqlite3_stmt *q = NULL;
    int code = sqlite3_prepare_v2(k->db, sql, -1, &q, NULL);
    if (code == SQLITE_OK)
        code = sqlite3_step(q);
    const char *text = code == SQLITE_ROW && sqlite3_column_type(q, 0) == SQLITE_TEXT
                           ? (const char *)sqlite3_column_text(q, 0)
                           : NULL;
    if (code == SQLITE_ROW)
        *out = text ? !strcmp(text, "ok") : sqlite3_column_int(q, 0);
    sqlite3_finalize(q);
    return code == SQLITE_ROW ? ERR_OK : kept_fail(k, code, "cannot be read", e);
}

/* A new file gets its table; another program's is left alone. */
static enum err_code kept_schema(const struct kept *k, struct err *e)
{
    int id = 0, schema = 0, tables = 0;
    enum err_code rc = kept_ask(k, "PRAGMA application_id", &id, e);
    if (!rc)
        rc = kept_ask(k, "PRAGMA user_version", &schema, e);
    if (!rc)
        rc = kept_ask(k, "SELECT count(*) FROM sqlite_schema", &tables, e);
    if (rc)
        return rc;
    if (!id && !schema && !tables)
        return kept_do(k,
                       "BEGIN IMMEDIATE;"
                       "CREATE TABLE kept(dataset TEXT NOT NULL, name TEXT NOT NULL, text TEXT NOT "
                       "NULL, model BLOB NOT NULL, PRIMARY KEY(dataset, name)) STRICT, WITHOUT "
                       "ROWID;"
                       "PRAGMA application_id=0x4353504e; PRAGMA user_version=1; COMMIT",
                       e);
    static_assert(KEPT_APPLICATION_ID == 0x4353504e && KEPT_SCHEMA == 1, "as above");
    return id == KEPT_APPLICATION_ID && schema == KEPT_SCHEMA
               ? ERR_OK
               : err_set(e, ERR_FORMAT,
                         "%s: is of another program, or of a later version of this one: give "
                         "another --state-dir",
                         k->path);
}

/* A text column, where it fits and is one. */
static bool kept_column(sqlite3_stmt *q, int column, char *out, size_t room)
{
    const unsigned char *text = sqlite3_column_text(q, column);
    const size_t n = text ? (size_t)sqlite3_column_bytes(q, column) : 0;
    if (!n || n >= room || strlen((const char *)text) != n)
        return false;
    memcpy(out, text, n + 1);
    return text_is_utf8(out);
}

static bool kept_read_row(sqlite3_stmt *q, struct kept_row *row)
{
    memset(row, 0, sizeof *row);
    if (!kept_column(q, 0, row->ds, sizeof row->ds) ||
        !kept_column(q, 1, row->name, sizeof row->name) || !param_is_kept_name(row->name) ||
        !kept_column(q, 2, row->text, sizeof row->text) ||
        sqlite3_column_bytes(q, 3) != KEPT_HASH_BYTES)
        return false;
    memcpy(&row->model, sqlite3_column_blob(q, 3), KEPT_HASH_BYTES);
    return true;
}

static enum err_code kept_read(struct kept *k, struct err *e)
{
    static_assert(sizeof(struct hash128) == KEPT_HASH_BYTES, "as it is in the file");
    sqlite3_stmt *q = NULL;
    struct kept_table *t = kept_alloc(KEPT_MAX);
    enum err_code rc = t ? ERR_OK : err_set(e, ERR_MEM, "%s: out of memory", k->path);
    int code =
        sqlite3_prepare_v2(k->db, "SELECT dataset, name, text, model FROM kept", -1, &q, NULL);
    while (!rc && code == SQLITE_OK && (code = sqlite3_step(q)) == SQLITE_ROW) {
        if (t->n == KEPT_MAX)
            rc = err_set(e, ERR_LIMIT, "%s: more than %d names", k->path, KEPT_MAX);
        else if (!kept_read_row(q, &t->row[t->n]))
            rc = err_set(e, ERR_FORMAT, "%s: row %zu: is damaged", k->path, t->n);
        else
            t->n++;
        code = SQLITE_OK;
    }
    if (!rc && code != SQLITE_DONE)
        rc = kept_fail(k, code, "cannot be read", e);
    sqlite3_finalize(q);
    if (rc)
        kept_drop(&t);
    else
        qsort(t->row, t->n, sizeof *t->row, kept_compare);
    k->table = t;
    return rc;
}

static enum err_code kept_prepare(struct kept *k, struct err *e)
{
    int code = sqlite3_prepare_v2(k->db, "INSERT OR REPLACE INTO kept VALUES(?1, ?2, ?3, ?4)", -1,
                                  &k->put, NULL);
    if (code == SQLITE_OK)
        code = sqlite3_prepare_v2(k->db, "DELETE FROM kept WHERE dataset = ?1 AND name = ?2", -1,
                                  &k->remove, NULL);
    return code == SQLITE_OK ? ERR_OK : kept_fail(k, code, "cannot be used", e);
}

static enum err_code kept_connect(struct kept *k, struct err *e)
{
    char sql[128];
    int well = 0;
    const int code = sqlite3_open_v2(
        k->path, &k->db, SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE | SQLITE_OPEN_NOMUTEX, NULL);
    if (code != SQLITE_OK)
        return kept_fail(k, code, "cannot be opened", e);
    (void)sqlite3_busy_timeout(k->db, KEPT_BUSY_MS);
    (void)sqlite3_db_config(k->db, SQLITE_DBCONFIG_DEFENSIVE, 1, NULL);
    (void)sqlite3_db_config(k->db, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, NULL);
    snprintf(sql, sizeof sql, "PRAGMA max_page_count=%d", KEPT_PAGES_MAX);
    enum err_code rc = kept_do(k,
                               "PRAGMA locking_mode=EXCLUSIVE; PRAGMA journal_mode=WAL;"
                               "PRAGMA synchronous=FULL; PRAGMA cell_size_check=ON;"
                               "BEGIN IMMEDIATE; COMMIT",
                               e);
    if (!rc)
        rc = kept_ask(k, "PRAGMA quick_check(1)", &well, e);
    if (!rc && !well)
        rc = kept_fail(k, SQLITE_CORRUPT, "quick_check", e);
    if (!rc)
        rc = kept_schema(k, e);
    return !rc ? kept_do(k, sql, e) : rc;
}

enum err_code kept_open(const char *dir, struct kept **out, struct err *e)
{
    struct kept *k = mem_array(1, sizeof *k);
    *out = k;
    if (!k)
        return err_set(e, ERR_MEM, "--state-dir: out of memory");
    pthread_mutex_init(&k->writing, NULL);
    pthread_mutex_init(&k->lock, NULL);
    enum err_code rc = file_mkdir(dir, e);
    if (!rc)
        rc = file_join(k->path, dir, "appearances.sqlite", e);
    if (!rc)
        rc = kept_connect(k, e);
    if (!rc)
        rc = kept_read(k, e);
    if (!rc)
        rc = kept_prepare(k, e);
    if (rc == ERR_LIMIT) /* a full disk is no damage: a supervisor tries again */
        rc = e ? (e->code = ERR_IO) : ERR_IO;
    if (rc)
        kept_close(out);
    return rc;
}

enum err_code kept_check(const char *dir, struct err *e)
{
    struct kept *k = NULL;
    struct err why = {0};
    enum err_code rc = kept_open(dir, &k, &why);
    kept_close(&k);
    return rc && rc != ERR_BUSY ? err_set(e, rc, "%s", why.msg) : ERR_OK;
}

void kept_close(struct kept **out)
{
    struct kept *k = *out;
    *out = NULL;
    if (!k)
        return;
    sqlite3_finalize(k->put);
    sqlite3_finalize(k->remove);
    sqlite3_close(k->db);
    kept_drop(&k->table);
    pthread_mutex_destroy(&k->writing);
    pthread_mutex_destroy(&k->lock);
    mem_free(k);
}

/* ---- changes; by `writing` ---- */

/* ERR_DATA: the request's conditions do not hold for what the name stands for (NULL: nothing). */
static enum err_code kept_holds(const struct kept_condition *when, const struct kept_row *row,
                                struct err *e)
{
    char etag[BODY_ETAG_SIZE] = "";
    if (row)
        kept_etag(row, etag);
    if (condition_may_write(when->match, when->none_match, row ? etag : NULL))
        return ERR_OK;
    return err_set(e, ERR_DATA,
                   row ? "the name stands for something else by now"
                       : "there is nothing of this name");
}

static enum err_code kept_step(struct kept *k, sqlite3_stmt *q, struct err *e)
{
    const int code = sqlite3_step(q);
    enum err_code rc = code == SQLITE_DONE ? ERR_OK : kept_fail(k, code, "cannot be written", e);
    (void)sqlite3_reset(q);
    (void)sqlite3_clear_bindings(q);
    return rc;
}

/* What was written is what is read from now on; what was not is dropped. newer is taken. */
static void kept_settle(struct kept *k, struct kept_table *newer, enum err_code written)
{
    if (written) {
        kept_drop(&newer);
        return;
    }
    pthread_mutex_lock(&k->lock);
    struct kept_table *was = k->table;
    k->table = newer;
    pthread_mutex_unlock(&k->lock);
    kept_drop(&was);
}

static enum err_code kept_room(const struct kept_table *t, const char *ds, struct err *e)
{
    const struct kept_row *first;
    if (t->n < KEPT_MAX && kept_of(t, ds, &first) < KEPT_DATASET_MAX)
        return ERR_OK;
    return err_set(
        e, ERR_LIMIT,
        "no more names are kept: %d of a dataset, %d of all; delete some that nobody uses",
        KEPT_DATASET_MAX, KEPT_MAX);
}

static enum err_code kept_write(struct kept *k, const struct kept_row *row, struct err *e)
{
    sqlite3_stmt *q = k->put;
    int code = sqlite3_bind_text(q, 1, row->ds, -1, SQLITE_STATIC);
    if (code == SQLITE_OK)
        code = sqlite3_bind_text(q, 2, row->name, -1, SQLITE_STATIC);
    if (code == SQLITE_OK)
        code = sqlite3_bind_text(q, 3, row->text, -1, SQLITE_STATIC);
    if (code == SQLITE_OK)
        code = sqlite3_bind_blob(q, 4, &row->model, KEPT_HASH_BYTES, SQLITE_STATIC);
    return code == SQLITE_OK ? kept_step(k, q, e) : kept_fail(k, code, "cannot be written", e);
}

enum err_code kept_put(struct kept *k, const struct kept_row *row,
                       const struct kept_condition *when, bool *created, struct err *e)
{
    pthread_mutex_lock(&k->writing); /* the table is replaced by whoever holds it */
    const struct kept_row *was = kept_find(k->table, row->ds, row->name);
    const bool same = was && !strcmp(was->text, row->text) &&
                      !memcmp(&was->model, &row->model, sizeof row->model);
    *created = !was;
    enum err_code rc = kept_holds(when, was, e);
    if (!rc && !was)
        rc = kept_room(k->table, row->ds, e);
    if (!rc && !same) {
        struct kept_table *newer =
            kept_changed(k->table, kept_place(k->table, row->ds, row->name), was != NULL, row);
        rc = newer ? kept_write(k, row, e) : err_set(e, ERR_MEM, "names: out of memory");
        kept_settle(k, newer, rc);
    }
    pthread_mutex_unlock(&k->writing);
    return rc;
}

enum err_code kept_remove(struct kept *k, const char *ds, const char *name,
                          const struct kept_condition *when, struct err *e)
{
    pthread_mutex_lock(&k->writing);
    const struct kept_row *was = kept_find(k->table, ds, name);
    enum err_code rc = kept_holds(when, was, e);
    if (!rc && !was)
        rc = err_set(e, ERR_NOENT, "no appearance is kept under this name");
    if (!rc) {
        struct kept_table *newer =
            kept_changed(k->table, kept_place(k->table, ds, name), true, NULL);
        int code = sqlite3_bind_text(k->remove, 1, ds, -1, SQLITE_STATIC);
        if (code == SQLITE_OK)
            code = sqlite3_bind_text(k->remove, 2, name, -1, SQLITE_STATIC);
        rc = !newer              ? err_set(e, ERR_MEM, "names: out of memory")
             : code == SQLITE_OK ? kept_step(k, k->remove, e)
                                 : kept_fail(k, code, "cannot be written", e);
        kept_settle(k, newer, rc);
    }
    pthread_mutex_unlock(&k->writing);
    return rc;
}
