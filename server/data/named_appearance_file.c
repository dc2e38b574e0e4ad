/* Named appearances in a file: see named_appearance_file.h.
 *
 * The file is an SQLite database in WAL mode. A change is on the disk (synchronous=FULL) before it
 * is answered. One process holds the file (locking_mode=EXCLUSIVE):
 *
 *     application_id  "CSPN"      user_version  KEPT_SCHEMA
 *     kept  dataset, name         what is named; the primary key
 *           text                  its meaning
 *           model                 16 bytes, hash of the network of an embedding
 *
 * Its content is read once, when it is opened, and checked like any data from outside.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/data/named_appearance_file.h"

#include <assert.h>
#include <fcntl.h>
#include <sqlite3.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum {
    KEPT_APPLICATION_ID = 0x4353504e, /* "CSPN" */
    KEPT_SCHEMA = 1,
    KEPT_BUSY_MS = 2000,
    KEPT_PAGES_MAX = 8192, /* of 4 KiB: several times what NAMED_APPEARANCE_MAX rows take */
    KEPT_HASH_BYTES = 16
};

struct named_appearance_file {
    char path[FILE_PATH_MAX];
    sqlite3 *db;
    sqlite3_stmt *put, *remove;
    bool unborn; /* named_appearance_file_open made the file, and has not returned ERR_OK */
};

static enum err_code named_appearance_file_fail(const struct named_appearance_file *k, int code,
                                                const char *what, struct err *e)
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

static enum err_code named_appearance_file_do(const struct named_appearance_file *k,
                                              const char *sql, struct err *e)
{
    const int code = sqlite3_exec(k->db, sql, NULL, NULL, NULL);
    return code == SQLITE_OK ? ERR_OK : named_appearance_file_fail(k, code, "cannot be used", e);
}

/* The number, or the first text (as 1 where it is "ok"), that a pragma answers with. */
static enum err_code named_appearance_file_ask(const struct named_appearance_file *k,
                                               const char *sql, int *out, struct err *e)
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
    return code == SQLITE_ROW ? ERR_OK : named_appearance_file_fail(k, code, "cannot be read", e);
}

/* Is it ours? *fresh: it is nobody's yet, and has no table. Nothing is written: another program's
 * file is left alone. */
static enum err_code named_appearance_file_schema(const struct named_appearance_file *k,
                                                  bool *fresh, struct err *e)
{
    int id = 0, schema = 0, tables = 0;
    enum err_code rc = named_appearance_file_ask(k, "PRAGMA application_id", &id, e);
    if (!rc)
        rc = named_appearance_file_ask(k, "PRAGMA user_version", &schema, e);
    if (!rc)
        rc = named_appearance_file_ask(k, "SELECT count(*) FROM sqlite_schema", &tables, e);
    if (rc)
        return rc;
    *fresh = !id && !schema && !tables;
    return *fresh || (id == KEPT_APPLICATION_ID && schema == KEPT_SCHEMA)
               ? ERR_OK
               : err_set(e, ERR_FORMAT,
                         "%s: is of another program, or of a later version of this one: give "
                         "another --state-dir",
                         k->path);
}

/* From here on the file is changed: its journal, and the table of a fresh one. */
static enum err_code named_appearance_file_begin(const struct named_appearance_file *k, bool fresh,
                                                 struct err *e)
{
    char sql[64];
    static_assert(KEPT_APPLICATION_ID == 0x4353504e && KEPT_SCHEMA == 1, "as below");
    snprintf(sql, sizeof sql, "PRAGMA journal_mode=WAL; PRAGMA max_page_count=%d", KEPT_PAGES_MAX);
    enum err_code rc = named_appearance_file_do(k, sql, e);
    if (!rc && fresh)
        rc = named_appearance_file_do(
            k,
            "BEGIN IMMEDIATE;"
            "CREATE TABLE kept(dataset TEXT NOT NULL, name TEXT NOT NULL, text TEXT NOT "
            "NULL, model BLOB NOT NULL, PRIMARY KEY(dataset, name)) STRICT, WITHOUT "
            "ROWID;"
            "PRAGMA application_id=0x4353504e; PRAGMA user_version=1; COMMIT",
            e);
    return rc;
}

/* A text column, where it fits and is one. */
static bool named_appearance_file_column(sqlite3_stmt *q, int column, char *out, size_t room)
{
    const unsigned char *text = sqlite3_column_text(q, column);
    const size_t n = text ? (size_t)sqlite3_column_bytes(q, column) : 0;
    if (!n || n >= room || strlen((const char *)text) != n)
        return false;
    memcpy(out, text, n + 1);
    return true;
}

static bool named_appearance_file_read_row(sqlite3_stmt *q, struct named_appearance_row *row)
{
    memset(row, 0, sizeof *row);
    if (!named_appearance_file_column(q, 0, row->ds, sizeof row->ds) ||
        !named_appearance_file_column(q, 1, row->name, sizeof row->name) ||
        !named_appearance_file_column(q, 2, row->text, sizeof row->text) ||
        sqlite3_column_bytes(q, 3) != KEPT_HASH_BYTES)
        return false;
    memcpy(&row->model, sqlite3_column_blob(q, 3), KEPT_HASH_BYTES);
    return named_appearance_table_row_ok(row);
}

static enum err_code named_appearance_file_read(const struct named_appearance_file *k,
                                                struct named_appearance_table **out, struct err *e)
{
    static_assert(sizeof(struct hash128) == KEPT_HASH_BYTES, "as it is in the file");
    sqlite3_stmt *q = NULL;
    struct named_appearance_table *t = named_appearance_table_alloc(NAMED_APPEARANCE_MAX);
    enum err_code rc = t ? ERR_OK : err_set(e, ERR_MEM, "%s: out of memory", k->path);
    int code =
        sqlite3_prepare_v2(k->db, "SELECT dataset, name, text, model FROM kept", -1, &q, NULL);
    while (!rc && code == SQLITE_OK && (code = sqlite3_step(q)) == SQLITE_ROW) {
        if (t->n == NAMED_APPEARANCE_MAX)
            rc = err_set(e, ERR_LIMIT, "%s: more than %d names", k->path, NAMED_APPEARANCE_MAX);
        else if (!named_appearance_file_read_row(q, &t->row[t->n]))
            rc = err_set(e, ERR_FORMAT, "%s: row %zu: is damaged", k->path, t->n);
        else
            t->n++;
        code = SQLITE_OK;
    }
    if (!rc && code != SQLITE_DONE)
        rc = named_appearance_file_fail(k, code, "cannot be read", e);
    sqlite3_finalize(q);
    if (rc)
        named_appearance_drop(&t);
    else
        named_appearance_table_sort(t);
    *out = t;
    return rc;
}

static enum err_code named_appearance_file_prepare(struct named_appearance_file *k, struct err *e)
{
    int code = sqlite3_prepare_v2(k->db, "INSERT OR REPLACE INTO kept VALUES(?1, ?2, ?3, ?4)", -1,
                                  &k->put, NULL);
    if (code == SQLITE_OK)
        code = sqlite3_prepare_v2(k->db, "DELETE FROM kept WHERE dataset = ?1 AND name = ?2", -1,
                                  &k->remove, NULL);
    return code == SQLITE_OK ? ERR_OK : named_appearance_file_fail(k, code, "cannot be used", e);
}

/* SQLite takes an empty file for a new one. One that was there is refused: names were lost. */
static enum err_code named_appearance_file_create(struct named_appearance_file *k, struct err *e)
{
    struct stat st;
    const int fd = open(k->path, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0644);
    k->unborn = fd >= 0;
    if (fd >= 0)
        close(fd);
    else if (!stat(k->path, &st) && !st.st_size)
        return named_appearance_file_fail(k, SQLITE_NOTADB, "it is empty", e);
    return ERR_OK;
}

static enum err_code named_appearance_file_connect(struct named_appearance_file *k, struct err *e)
{
    int well = 0;
    bool fresh = false;
    enum err_code rc = named_appearance_file_create(k, e);
    if (rc)
        return rc;
    const int code = sqlite3_open_v2(
        k->path, &k->db, SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE | SQLITE_OPEN_NOMUTEX, NULL);
    if (code != SQLITE_OK)
        return named_appearance_file_fail(k, code, "cannot be opened", e);
    (void)sqlite3_busy_timeout(k->db, KEPT_BUSY_MS);
    (void)sqlite3_db_config(k->db, SQLITE_DBCONFIG_DEFENSIVE, 1, NULL);
    (void)sqlite3_db_config(k->db, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, NULL);
    rc = named_appearance_file_do(k,
                                  "PRAGMA locking_mode=EXCLUSIVE; PRAGMA synchronous=FULL;"
                                  "PRAGMA cell_size_check=ON; BEGIN EXCLUSIVE; COMMIT",
                                  e);
    if (!rc)
        rc = named_appearance_file_ask(k, "PRAGMA quick_check(1)", &well, e);
    if (!rc && !well)
        rc = named_appearance_file_fail(k, SQLITE_CORRUPT, "quick_check", e);
    if (!rc)
        rc = named_appearance_file_schema(k, &fresh, e);
    return !rc ? named_appearance_file_begin(k, fresh, e) : rc;
}

enum err_code named_appearance_file_open(const char *dir, struct named_appearance_file **out,
                                         struct named_appearance_table **table, struct err *e)
{
    struct named_appearance_file *k = mem_array(1, sizeof *k);
    *out = k;
    if (!k)
        return err_set(e, ERR_MEM, "--state-dir: out of memory");
    enum err_code rc = file_mkdir(dir, e);
    if (!rc)
        rc = file_join(k->path, dir, "appearances.sqlite", e);
    if (!rc)
        rc = named_appearance_file_connect(k, e);
    if (!rc)
        rc = named_appearance_file_read(k, table, e);
    if (!rc)
        rc = named_appearance_file_prepare(k, e);
    if (rc == ERR_LIMIT) /* a full disk is no damage: a supervisor tries again */
        rc = e ? (e->code = ERR_IO) : ERR_IO;
    k->unborn &= rc && rc != ERR_BUSY; /* whoever has locked it since goes on */
    if (rc) {
        named_appearance_file_close(out);
        named_appearance_drop(table);
    }
    return rc;
}

/* The next start is to find no file, and not one that is empty, which would be damage to it. */
static void named_appearance_file_unmake(const struct named_appearance_file *k)
{
    static const char *const ends[] = {"-wal", "-journal", ""};
    char path[FILE_PATH_MAX + sizeof "-journal"];
    for (size_t i = 0; i < sizeof ends / sizeof *ends; i++) {
        snprintf(path, sizeof path, "%s%s", k->path, ends[i]);
        (void)unlink(path);
    }
}

void named_appearance_file_close(struct named_appearance_file **out)
{
    struct named_appearance_file *k = *out;
    *out = NULL;
    if (!k)
        return;
    sqlite3_finalize(k->put);
    sqlite3_finalize(k->remove);
    sqlite3_close(k->db);
    if (k->unborn)
        named_appearance_file_unmake(k);
    mem_free(k);
}

static enum err_code named_appearance_file_step(struct named_appearance_file *k, sqlite3_stmt *q,
                                                struct err *e)
{
    const int code = sqlite3_step(q);
    enum err_code rc =
        code == SQLITE_DONE ? ERR_OK : named_appearance_file_fail(k, code, "cannot be written", e);
    (void)sqlite3_reset(q);
    (void)sqlite3_clear_bindings(q);
    return rc;
}

enum err_code named_appearance_file_put(struct named_appearance_file *k,
                                        const struct named_appearance_row *row, struct err *e)
{
    sqlite3_stmt *q = k->put;
    int code = sqlite3_bind_text(q, 1, row->ds, -1, SQLITE_STATIC);
    if (code == SQLITE_OK)
        code = sqlite3_bind_text(q, 2, row->name, -1, SQLITE_STATIC);
    if (code == SQLITE_OK)
        code = sqlite3_bind_text(q, 3, row->text, -1, SQLITE_STATIC);
    if (code == SQLITE_OK)
        code = sqlite3_bind_blob(q, 4, &row->model, KEPT_HASH_BYTES, SQLITE_STATIC);
    return code == SQLITE_OK ? named_appearance_file_step(k, q, e)
                             : named_appearance_file_fail(k, code, "cannot be written", e);
}

enum err_code named_appearance_file_remove(struct named_appearance_file *k, const char *ds,
                                           const char *name, struct err *e)
{
    int code = sqlite3_bind_text(k->remove, 1, ds, -1, SQLITE_STATIC);
    if (code == SQLITE_OK)
        code = sqlite3_bind_text(k->remove, 2, name, -1, SQLITE_STATIC);
    return code == SQLITE_OK ? named_appearance_file_step(k, k->remove, e)
                             : named_appearance_file_fail(k, code, "cannot be written", e);
}
