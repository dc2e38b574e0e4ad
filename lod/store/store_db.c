/* Shared by reading and writing of a tile store: opening, row ids, row hashes, SQLite's errors.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/store/store_db.h"

#include <assert.h>
#include <limits.h>
#include <string.h>

#include "lod/store/key.h"
#include "lod/store/remote.h"
#include "lod/store/store_remote.h"

enum err_code store_alloc(const char *path, struct store **out, struct err *e)
{
    struct store *s = mem_array(1, sizeof *s);
    char *text = s ? mem_text(path) : NULL;
    *out = text ? s : NULL;
    if (!text) {
        mem_free(s);
        return err_set(e, ERR_MEM, "%s: out of memory", path);
    }
    s->path = text;
    return ERR_OK;
}

enum err_code store_db_fail(const struct store *s, int code, const char *what, struct err *e)
{
    if (s->remote && remote_failed(s->remote)->code) {
        const struct err far = *remote_failed(s->remote);
        remote_forgive(s->remote);
        return err_set(e, far.code, "%s: %s", what, far.msg); /* which says nothing of the file */
    }
    const char *why = s->db ? sqlite3_errmsg(s->db) : sqlite3_errstr(code);
    switch (code & 0xff) {
    case SQLITE_CORRUPT:
    case SQLITE_NOTADB:
        return err_set(e, ERR_FORMAT,
                       "%s: %s: the file is damaged (%s); restore it or tile the scene again",
                       s->path, what, why);
    case SQLITE_NOMEM:
        return err_set(e, ERR_MEM, "%s: %s: out of memory", s->path, what);
    case SQLITE_TOOBIG:
        return err_set(e, ERR_LIMIT, "%s: %s: more than SQLite holds in one row; use smaller tiles",
                       s->path, what);
    case SQLITE_FULL:
        return err_set(e, ERR_IO, "%s: %s: no space left on the disk", s->path, what);
    case SQLITE_ERROR: /* a table or column is missing: not our schema */
        return err_set(e, ERR_FORMAT, "%s: %s: %s", s->path, what, why);
    default:
        return err_set(e, ERR_IO, "%s: %s: %s", s->path, what, why);
    }
}

/* file: URI of a path: SQLite takes options such as immutable only that way. */
static enum err_code store_db_uri(const char *path, struct buf *uri, struct err *e)
{
    /* "file:a/b" is relative, "file:///a/b" absolute; a leading "//" would be read as a host. */
    buf_printf(uri, "file:%s", path[0] == '/' ? "//" : "");
    for (const char *p = path; *p; p++) {
        char c = *p;
        bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
                     strchr("/._-~", c);
        if (plain)
            buf_u8(uri, (unsigned char)c);
        else
            buf_printf(uri, "%%%02X", (unsigned char)c);
    }
    buf_printf(uri, "?mode=ro&immutable=1");
    return buf_check(uri, e);
}

enum err_code store_db_connect(struct store *s, const char *at, const char *vfs, struct err *e)
{
    struct buf uri = {0};
    enum err_code rc = store_db_uri(at, &uri, e);
    if (rc)
        goto out;
    int flags = SQLITE_OPEN_READONLY | SQLITE_OPEN_URI | SQLITE_OPEN_NOMUTEX;
    int code = sqlite3_open_v2((const char *)uri.data, &s->db, flags, vfs);
    if (code == SQLITE_OK) {
        sqlite3_db_config(s->db, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, NULL);
        sqlite3_db_config(s->db, SQLITE_DBCONFIG_DEFENSIVE, 1, NULL);
        /* 120 KB a handle, which of a thousand stores nobody has to spare */
        sqlite3_db_config(s->db, SQLITE_DBCONFIG_LOOKASIDE, NULL, 0, 0);
        s->remote = store_remote_of(s->db);
        sqlite3_limit(s->db, SQLITE_LIMIT_LENGTH,
                      s->size_bytes < INT_MAX ? (int)s->size_bytes : INT_MAX);
        code = sqlite3_exec(s->db,
                            "PRAGMA mmap_size=0; PRAGMA cell_size_check=ON; PRAGMA query_only=ON;"
                            "PRAGMA temp_store=MEMORY",
                            NULL, NULL, NULL);
    }
    if (code != SQLITE_OK)
        rc = store_db_fail(s, code, "cannot open", e);
out:
    buf_free(&uri);
    return rc;
}

/* The low 24 bits, each followed by a zero. */
static uint64_t store_db_spread(uint32_t v)
{
    uint64_t b = v & ((UINT32_C(1) << KEY_ZOOM_MAX) - 1);
    b = (b | b << 16) & UINT64_C(0x0000ffff0000ffff);
    b = (b | b << 8) & UINT64_C(0x00ff00ff00ff00ff);
    b = (b | b << 4) & UINT64_C(0x0f0f0f0f0f0f0f0f);
    b = (b | b << 2) & UINT64_C(0x3333333333333333);
    return (b | b << 1) & UINT64_C(0x5555555555555555);
}

int64_t store_db_id(struct key k)
{
    static_assert(KEY_ZOOM_MAX <= 28, "two coordinates below the zoom");
    return (int64_t)(store_db_spread(k.x) | store_db_spread(k.y) << 1 | (uint64_t)k.z << 56);
}

void store_db_hash_out(struct hash128 h, uint8_t out[STORE_HASH_BYTES])
{
    for (int i = 0; i < 8; i++) {
        out[i] = (uint8_t)(h.lo >> (8 * i));
        out[8 + i] = (uint8_t)(h.hi >> (8 * i));
    }
}

static uint64_t store_db_little(const uint8_t *p)
{
    uint64_t v;
    memcpy(&v, p, sizeof v);
#if __BYTE_ORDER__ == __ORDER_BIG_ENDIAN__
    v = __builtin_bswap64(v);
#endif
    return v;
}

struct hash128 store_db_hash_in(const uint8_t in[STORE_HASH_BYTES])
{
    return (struct hash128){.lo = store_db_little(in), .hi = store_db_little(in + 8)};
}

struct hash128 store_db_row_hash(const struct store_entry *t)
{
    const struct store_shape *x = &t->shape;
    const double nums[] = {x->center_enu_m[0],   x->center_enu_m[1],   x->center_enu_m[2],
                           x->min_enu_m[0],      x->min_enu_m[1],      x->min_enu_m[2],
                           x->max_enu_m[0],      x->max_enu_m[1],      x->max_enu_m[2],
                           x->core_min_enu_m[0], x->core_min_enu_m[1], x->core_min_enu_m[2],
                           x->core_max_enu_m[0], x->core_max_enu_m[1], x->core_max_enu_m[2],
                           x->sigma_median_m,    x->sigma_max_m,       x->geometric_error_m};
    enum { N_NUMS = sizeof nums / sizeof *nums, N_INTS = 7 };
    uint64_t word[N_INTS + N_NUMS] = {(uint64_t)store_db_id(t->tile.key),
                                      t->tile.level,
                                      t->tile.count,
                                      t->tile.bytes,
                                      t->tile.version,
                                      t->tile.hash.lo,
                                      t->tile.hash.hi};
    memcpy(word + N_INTS, nums, sizeof nums);
#if __BYTE_ORDER__ == __ORDER_BIG_ENDIAN__ /* little-endian whatever the machine */
    for (size_t i = 0; i < sizeof word / sizeof *word; i++)
        word[i] = __builtin_bswap64(word[i]);
#endif
    return hash_bytes(word, sizeof word);
}

bool store_db_name_ok(const char *name)
{
    if (!((*name >= 'a' && *name <= 'z') || (*name >= '0' && *name <= '9')))
        return false;
    for (const char *p = name; *p; p++)
        if (!((*p >= 'a' && *p <= 'z') || (*p >= '0' && *p <= '9') || *p == '_' || *p == '-'))
            return false;
    return true;
}
