/* Shared by reading and writing of a tile store: row ids, row hashes, SQLite's errors.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/store_db.h"

#include <string.h>

#include "lod/key.h"
#include "lod/remote.h"

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

int64_t store_db_id(struct key k)
{
    uint64_t id = 0;
    for (int b = 0; b < KEY_ZOOM_MAX; b++)
        id |= (uint64_t)(k.x >> b & 1) << (2 * b) | (uint64_t)(k.y >> b & 1) << (2 * b + 1);
    return (int64_t)(id | (uint64_t)k.z << 56);
}

void store_db_hash_out(struct hash128 h, uint8_t out[STORE_HASH_BYTES])
{
    for (int i = 0; i < 8; i++) {
        out[i] = (uint8_t)(h.lo >> (8 * i));
        out[8 + i] = (uint8_t)(h.hi >> (8 * i));
    }
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
