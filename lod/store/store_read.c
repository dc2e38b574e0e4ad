/* Reads a tile store: one immutable SQLite file with its index in memory.
 *
 * The header is checked by hand first, because SQLite silently fills a truncated file with zeros.
 * Each index row has a hash of itself, and each payload one of its bytes. A damaged row is left out
 * with a warning. A damaged payload is an error only when it is read. All other tiles stay
 * available. store_index.c reads the index.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <errno.h>
#include <fcntl.h>
#include <jansson.h>
#include <limits.h>
#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "codec/limits.h"
#include "codec/splat/payload.h"
#include "lod/store/remote.h"
#include "lod/store/store.h"
#include "lod/store/store_db.h"
#include "lod/store/store_remote.h"
#include "lod/store/tree.h"

/* ---- opening ---- */

static uint32_t store_be32(const uint8_t *p)
{
    return (uint32_t)p[0] << 24 | (uint32_t)p[1] << 16 | (uint32_t)p[2] << 8 | p[3];
}

enum { STORE_HEADER_BYTES = 100 };

/* The first bytes of a file, and its size; *got: fewer are there. */
static enum err_code store_read_header(const char *at, const char *path,
                                       uint8_t h[STORE_HEADER_BYTES], size_t *got, uint64_t *size,
                                       struct err *e)
{
    int fd = open(at, O_RDONLY | O_CLOEXEC);
    if (fd < 0)
        return err_errno(e, errno == ENOENT ? ERR_NOENT : ERR_IO, "%s", path);
    struct stat st;
    const bool known = fstat(fd, &st) == 0;
    const ssize_t n = known ? pread(fd, h, STORE_HEADER_BYTES, 0) : -1;
    close(fd);
    *got = n > 0 ? (size_t)n : 0;
    *size = known ? (uint64_t)st.st_size : 0;
    return ERR_OK;
}

/* SQLite's header (sqlite.org/fileformat2.html, 1.3) against the file's size. */
static enum err_code store_check_header(const uint8_t h[STORE_HEADER_BYTES], size_t got,
                                        uint64_t size_bytes, const char *path, struct err *e)
{
    if (got != STORE_HEADER_BYTES || memcmp(h, "SQLite format 3", 16) ||
        store_be32(h + 68) != STORE_APPLICATION_ID)
        return err_set(
            e, ERR_FORMAT,
            "%s: not a tile store (make one with `citysplat tile` or `citysplat import`)", path);
    if (store_be32(h + 60) != STORE_SCHEMA)
        return err_set(
            e, ERR_FORMAT,
            "%s: tile store of schema %u, this program reads schema %d; tile the scene again", path,
            store_be32(h + 60), STORE_SCHEMA);
    uint64_t page = (uint64_t)h[16] << 8 | h[17], pages = store_be32(h + 28);
    uint64_t want = (page == 1 ? 65536 : page) * pages;
    if (want != size_bytes)
        return err_set(e, ERR_FORMAT, "%s: truncated or overlong: %llu bytes, its header says %llu",
                       path, (unsigned long long)size_bytes, (unsigned long long)want);
    return ERR_OK;
}

/* SQLite resolves links in a path first, and opens none; what /proc/self/fd/N is a link to may be
 * another file by now, or none. This file system takes paths as they are, and its open() takes
 * these links. */
static int store_as_is(sqlite3_vfs *vfs, const char *path, int room, char *out)
{
    (void)vfs;
    return snprintf(out, (size_t)room, "%s", path) < room ? SQLITE_OK : SQLITE_CANTOPEN;
}

static const char store_fds[] = "/proc/self/fd/";

static int store_open_call(const char *path, int flags, int mode)
{
    bool fd = !strncmp(path, store_fds, sizeof store_fds - 1);
    return open(path, fd ? flags & ~O_NOFOLLOW : flags, mode);
}

static sqlite3_vfs store_vfs;
static pthread_once_t store_vfs_once = PTHREAD_ONCE_INIT;

static void store_add_vfs(void)
{
    const sqlite3_vfs *usual = sqlite3_vfs_find(NULL);
    if (!usual)
        return;
    store_vfs = *usual;
    store_vfs.pNext = NULL;
    store_vfs.zName = "citysplat-as-is";
    store_vfs.xFullPathname = store_as_is;
    store_vfs.xSetSystemCall(&store_vfs, "open", (sqlite3_syscall_ptr)store_open_call);
    sqlite3_vfs_register(&store_vfs, 0);
}

/* What is read are tables of this file: a view may have rows without end, of any length. */
static enum err_code store_check_tables(const struct store *s, struct err *e)
{
    sqlite3_stmt *q = NULL;
    int code = sqlite3_prepare_v2(s->db,
                                  "SELECT count(*) FROM sqlite_schema WHERE type='table' AND "
                                  "rootpage>0 AND lower(name) IN ('meta','tiles','blobs')",
                                  -1, &q, NULL);
    if (code == SQLITE_OK)
        code = sqlite3_step(q);
    bool whole = code == SQLITE_ROW && sqlite3_column_int(q, 0) == 3;
    enum err_code rc = ERR_OK;
    if (code != SQLITE_ROW)
        rc = store_db_fail(s, code, "schema", e);
    else if (!whole)
        rc = err_set(e, ERR_FORMAT,
                     "%s: meta, tiles and blobs are not all tables: not a tile store", s->path);
    sqlite3_finalize(q);
    return rc;
}

/* ---- meta ---- */

static enum err_code store_meta_text(struct store *s, sqlite3_stmt *q, const char *key, char *out,
                                     size_t cap, struct err *e)
{
    sqlite3_reset(q);
    sqlite3_bind_text(q, 1, key, -1, SQLITE_STATIC);
    int code = sqlite3_step(q);
    if (code != SQLITE_ROW && code != SQLITE_DONE)
        return store_db_fail(s, code, "meta", e);
    const char *text = code == SQLITE_ROW ? (const char *)sqlite3_column_text(q, 0) : NULL;
    if (!text)
        return err_set(e, ERR_FORMAT, "%s: meta: %s is missing", s->path, key);
    if (strlen(text) >= cap)
        return err_set(e, ERR_FORMAT, "%s: meta: %s is longer than %zu bytes", s->path, key,
                       cap - 1);
    memcpy(out, text, strlen(text) + 1);
    return ERR_OK;
}

static enum err_code store_meta_num(struct store *s, sqlite3_stmt *q, const char *key, double lo,
                                    double hi, double *out, struct err *e)
{
    char text[64];
    enum err_code rc = store_meta_text(s, q, key, text, sizeof text, e);
    if (rc)
        return rc;
    if (!number_list(text, 1, out) || !(*out >= lo && *out <= hi))
        return err_set(e, ERR_FORMAT, "%s: meta: %s is '%s', a number from %g to %g is expected",
                       s->path, key, text, lo, hi);
    return ERR_OK;
}

/* Name, revision and date are written into addresses, headers and documents without quoting. */
static enum err_code store_check_meta(const struct store *s, struct err *e)
{
    const struct store_meta *m = &s->meta;
    if (!store_db_name_ok(m->name))
        return err_set(e, ERR_FORMAT, "%s: meta: name is '%s', only a-z, 0-9, - and _ are allowed",
                       s->path, m->name);
    if (strlen(m->revision) != 12 || strspn(m->revision, "0123456789abcdef") != 12)
        return err_set(e, ERR_FORMAT, "%s: meta: revision is '%s', 12 hex digits are expected",
                       s->path, m->revision);
    if (m->created[strspn(m->created, "0123456789-:.+TZ")])
        return err_set(e, ERR_FORMAT, "%s: meta: created is '%s', a date is expected", s->path,
                       m->created);
    return ERR_OK;
}

/* A value that older stores do not have: "". Valid until the next use of q; NULL: out of memory. */
static enum err_code store_meta_newer(struct store *s, sqlite3_stmt *q, const char *key,
                                      const char **text, struct err *e)
{
    sqlite3_reset(q);
    sqlite3_bind_text(q, 1, key, -1, SQLITE_STATIC);
    int code = sqlite3_step(q);
    if (code != SQLITE_ROW && code != SQLITE_DONE)
        return store_db_fail(s, code, "meta", e);
    *text = code == SQLITE_ROW ? (const char *)sqlite3_column_text(q, 0) : "";
    return ERR_OK;
}

static enum err_code store_meta_heights(struct store *s, sqlite3_stmt *q, struct store_meta *m,
                                        struct err *e)
{
    const char *text = NULL;
    enum err_code rc = store_meta_newer(s, q, "heights", &text, e);
    if (rc)
        return rc;
    if (!text || strlen(text) >= sizeof m->heights || !heights_valid(text))
        return err_set(e, ERR_FORMAT, "%s: meta: heights is none of those known", s->path);
    memcpy(m->heights, text, strlen(text) + 1);
    return ERR_OK;
}

#define STORE_PIXEL_MOST_M 1e6

static enum err_code store_meta_pixels(struct store *s, sqlite3_stmt *q, struct store_meta *m,
                                       struct err *e)
{
    const char *text = NULL;
    size_t n = 0;
    enum err_code rc = store_meta_newer(s, q, "level_pixel_m", &text, e);
    if (rc)
        return rc;
    while (text && *text && n < STORE_LEVEL_MAX) {
        const char *end = text;
        double v;
        if (!number_read(&end, &v) || !(v >= 0.0 && v < STORE_PIXEL_MOST_M))
            break;
        m->pixel_m[n++] = v;
        text = end + (*end == ' ');
    }
    return text && !*text ? ERR_OK
                          : err_set(e, ERR_FORMAT,
                                    "%s: meta: level_pixel_m is no list of at most %d lengths in "
                                    "metres",
                                    s->path, STORE_LEVEL_MAX);
}

static enum err_code store_read_meta(struct store *s, struct err *e)
{
    struct store_meta *m = &s->meta;
    sqlite3_stmt *q = NULL;
    int code = sqlite3_prepare_v2(s->db, "SELECT value FROM meta WHERE key=?1", -1, &q, NULL);
    if (code != SQLITE_OK)
        return store_db_fail(s, code, "meta", e);
    double degree = 0, embed = 0, aa = 0, lossless = 0, z0 = 0, z1 = 0;
    const struct {
        const char *key;
        double lo, hi, *out;
    } nums[] = {
        {"origin_lon_deg", -1080, 1080, &m->origin.lon_deg},
        {"origin_lat_deg", -90, 90, &m->origin.lat_deg},
        {"origin_h_m", -1e7, 1e7, &m->origin.h_m},
        {"sh_degree", 0, GAUSS_SH_DEGREE_MAX, &degree},
        {"embed_len", 0, GAUSS_EMBED_MAX, &embed},
        {"antialiased", 0, 1, &aa},
        {"lossless", 0, 1, &lossless},
        {"zoom_min", 0, KEY_ZOOM_MAX, &z0},
        {"zoom_max", 0, KEY_ZOOM_MAX, &z1},
    };
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < sizeof nums / sizeof *nums; i++)
        rc = store_meta_num(s, q, nums[i].key, nums[i].lo, nums[i].hi, nums[i].out, e);
    if (!rc)
        rc = store_meta_text(s, q, "name", m->name, sizeof m->name, e);
    if (!rc)
        rc = store_meta_text(s, q, "attribution", m->attribution, sizeof m->attribution, e);
    if (!rc)
        rc = store_meta_heights(s, q, m, e);
    if (!rc)
        rc = store_meta_pixels(s, q, m, e);
    if (!rc)
        rc = store_meta_text(s, q, "revision", m->revision, sizeof m->revision, e);
    if (!rc)
        rc = store_meta_text(s, q, "created", m->created, sizeof m->created, e);
    sqlite3_finalize(q);
    m->sh_degree = (uint32_t)degree;
    m->embed_len = (uint32_t)embed;
    m->antialiased = aa != 0.0;
    m->lossless = lossless != 0.0;
    m->zoom_min = (uint8_t)z0;
    m->zoom_max = (uint8_t)z1;
    return rc ? rc : store_check_meta(s, e);
}

/* ---- outlines ---- */

/* Kept as text that is known to be JSON, since it goes into documents as it is. */
static enum err_code store_read_outline(struct store *s, const char *name, char **out,
                                        struct err *e)
{
    struct buf b = {0};
    json_t *root = NULL;
    struct err why = {0};
    enum err_code rc = store_get_blob(s, name, &b, &why);
    if (rc == ERR_NOENT)
        return ERR_OK;
    if (rc == ERR_BUSY)
        return err_set(e, rc, "%s", why.msg);
    if (!rc)
        rc = jsonc_parse((const char *)b.data, b.size, name, &root, NULL);
    if (!rc)
        *out = json_dumps(root, JSON_COMPACT | JSON_REAL_PRECISION(12));
    json_decref(root);
    buf_free(&b);
    if (rc || !*out) /* what is drawn does not need it; verify finds what is damaged */
        log_warn("store", "%s: its %s cannot be read: it is left out", s->path, name);
    return ERR_OK;
}

const char *store_footprint(const struct store *s)
{
    return s->footprint;
}

const char *store_clip(const struct store *s)
{
    return s->clip;
}

static enum err_code store_far_header(struct remote *far, uint8_t h[STORE_HEADER_BYTES],
                                      size_t *got, uint64_t *size, struct err *e)
{
    *size = remote_size(far);
    *got = *size < STORE_HEADER_BYTES ? (size_t)*size : STORE_HEADER_BYTES;
    return remote_read(far, 0, h, *got, e);
}

/* The file at `at`, which messages call `path`. far: it is a remote one, else NULL. */
static enum err_code store_open_at(const char *at, const char *path, const char *vfs,
                                   struct remote *far, struct store **out, struct err *e)
{
    *out = NULL;
    if (strlen(path) >= FILE_PATH_MAX)
        return err_set(e, ERR_LIMIT, "%s: path too long", path);
    uint8_t h[STORE_HEADER_BYTES];
    size_t got = 0;
    uint64_t size_bytes = 0;
    enum err_code rc = far ? store_far_header(far, h, &got, &size_bytes, e)
                           : store_read_header(at, path, h, &got, &size_bytes, e);
    if (!rc)
        rc = store_check_header(h, got, size_bytes, path, e);
    if (rc)
        return rc;
    struct store *s = NULL;
    rc = store_alloc(path, &s, e);
    if (rc)
        return rc;
    s->size_bytes = size_bytes;
    rc = store_db_connect(s, at, vfs, e);
    if (!rc)
        rc = store_check_tables(s, e);
    if (!rc)
        rc = store_read_meta(s, e);
    if (!rc)
        rc = store_read_index(s, at, vfs, e);
    if (!rc)
        rc = tree_build(&s->index, &s->tree, e);
    if (!rc) {
        rc = store_read_outline(s, STORE_FOOTPRINT, &s->footprint, e);
        if (!rc)
            rc = store_read_outline(s, STORE_CLIP, &s->clip, e);
    }
    if (rc)
        store_close(&s);
    *out = s;
    return rc;
}

/* Opening a FIFO would wait for a writer. */
static enum err_code store_check_file(const char *path, struct err *e)
{
    struct stat st;
    if (!stat(path, &st) && !S_ISREG(st.st_mode))
        return err_set(e, ERR_FORMAT,
                       S_ISDIR(st.st_mode)
                           ? "%s: a folder, not a tile store: a store is one file, CITY.tiles; "
                             "`citysplat tile` makes one of a trained scene"
                           : "%s: no file: a tile store is a file",
                       path);
    return ERR_OK;
}

enum err_code store_open(const char *path, struct store **out, struct err *e)
{
    int fd = -1;
    *out = NULL;
    if (!range_is_url(path)) {
        enum err_code rc = store_check_file(path, e);
        return !rc ? store_open_at(path, path, NULL, NULL, out, e) : rc;
    }
    enum err_code rc = remote_open(path, &fd, e);
    if (rc)
        return rc;
    rc = store_open_fd(fd, path, out, e);
    close(fd);
    return rc;
}

enum err_code store_open_file(const char *path, int *fd, struct err *e)
{
    *fd = -1;
    if (range_is_url(path))
        return remote_open(path, fd, e);
    enum err_code rc = store_check_file(path, e);
    if (rc)
        return rc;
    *fd = open(path, O_RDONLY | O_CLOEXEC);
    return *fd < 0 ? err_errno(e, errno == ENOENT ? ERR_NOENT : ERR_IO, "%s", path) : ERR_OK;
}

/* The part of a remote store that was clipped is a file of its own. */
static bool store_is_far(int fd, const char *name)
{
    return range_is_url(name) && remote_is(fd);
}

enum err_code store_open_fd(int fd, const char *name, struct store **out, struct err *e)
{
    char at[32];
    struct remote *far = NULL;
    snprintf(at, sizeof at, "%s%d", store_fds, fd);
    if (!store_is_far(fd, name)) {
        pthread_once(&store_vfs_once, store_add_vfs);
        return store_open_at(at, name, store_vfs.zName, NULL, out, e);
    }
    *out = NULL;
    enum err_code rc = remote_attach(fd, &far, e);
    if (!rc)
        rc = store_open_at(at, remote_shown(far), store_remote_vfs(), far, out, e);
    remote_close(&far);
    return rc;
}

void store_lift(struct store *s, double up_m)
{
    struct store_meta *m = &s->meta;
    char text[64];
    if (up_m == 0)
        return;
    const int n = snprintf(text, sizeof text, "%s %.3f", m->revision, up_m);
    m->origin.h_m += up_m;
    snprintf(m->heights, sizeof m->heights, "ellipsoid");
    snprintf(m->revision, sizeof m->revision, "%012llx",
             (unsigned long long)(hash_bytes(text, (size_t)n).lo & 0xffffffffffff));
}

enum err_code store_open_more(int fd, const struct store *first, struct store **out, struct err *e)
{
    char at[32];
    snprintf(at, sizeof at, "%s%d", store_fds, fd);
    pthread_once(&store_vfs_once, store_add_vfs);
    const char *vfs = first->remote ? store_remote_vfs() : store_vfs.zName;
    enum err_code rc = store_alloc(first->path, out, e);
    struct store *s = *out;
    if (rc)
        return rc;
    s->size_bytes = first->size_bytes;
    s->meta = first->meta;
    s->index = first->index;
    s->tree = first->tree;
    s->footprint = first->footprint;
    s->clip = first->clip;
    s->borrows = true;
    rc = store_db_connect(s, at, vfs, e);
    /* The pages that lead to tiles are in memory from here on: a file that is cut short later has
     * lost tiles, not the way to all of them. Of more tiles than these, SQLite keeps no pages. */
    int code = SQLITE_OK;
    if (!rc && !s->remote)
        code = sqlite3_exec(
            s->db, "SELECT max(row_hash) FROM (SELECT row_hash FROM tiles NOT INDEXED LIMIT 4096)",
            NULL, NULL, NULL);
    if (code != SQLITE_OK)
        rc = store_db_fail(s, code, "index", e);
    if (rc)
        store_close(&s);
    *out = s;
    return rc;
}

void store_rest(struct store *s)
{
    if (!s->remote) /* there a page may be a request */
        (void)sqlite3_db_release_memory(s->db);
}

void store_close(struct store **sp)
{
    struct store *s = *sp;
    if (!s)
        return;
    sqlite3_finalize(s->get);
    sqlite3_finalize(s->put);
    sqlite3_finalize(s->get_blob);
    sqlite3_close(s->db);
    if (s->building) {
        store_flush_close(&s->flush);
        file_abort(s->part);
    }
    mem_free(s->part);
    mem_free(s->path);
    store_close(&s->before);
    if (s->bake_free)
        s->bake_free(s);
    if (!s->borrows) {
        tree_free(&s->tree);
        index_free(&s->index);
        free(s->footprint); /* jansson's */
        free(s->clip);
    }
    mem_free(s);
    *sp = NULL;
}

const struct store_meta *store_info(const struct store *s)
{
    return &s->meta;
}

const char *store_path(const struct store *s)
{
    return s->path;
}

bool store_replaced(const struct store *s)
{
    return s->remote && remote_changed(s->remote);
}

enum err_code store_ask(struct store *s, double wait_s, struct err *e)
{
    return s->remote ? remote_check(s->remote, wait_s, e) : ERR_OK;
}

const struct store_tile *store_tiles(const struct store *s, size_t *n)
{
    *n = s->index.n;
    return s->index.tiles;
}

const struct tree *store_tree(const struct store *s)
{
    return &s->tree;
}

const struct store_tile *store_find(const struct store *s, struct key k)
{
    if (!s->building) {
        uint32_t i = index_find(&s->index, k);
        return i == INDEX_NONE ? NULL : &s->index.tiles[i];
    }
    for (size_t i = 0; i < s->index.n; i++)
        if (key_compare(s->index.tiles[i].key, k) == 0)
            return &s->index.tiles[i];
    return NULL;
}

struct store_shape store_shape(const struct store *s, const struct store_tile *t)
{
    return index_shape(&s->index, (size_t)(t - s->index.tiles));
}

/* ---- payloads and blobs ---- */

static struct hash128 store_column_hash(sqlite3_stmt *q, int column, bool *ok)
{
    const void *p = sqlite3_column_blob(q, column);
    if (!p || sqlite3_column_bytes(q, column) != STORE_HASH_BYTES) {
        *ok = false;
        return (struct hash128){0};
    }
    return store_db_hash_in(p);
}

/* Copy a (hash, bytes) row into `out`, verified. `what` names it in errors. */
static enum err_code store_take(struct store *s, sqlite3_stmt *q, const char *what, struct buf *out,
                                struct err *e)
{
    bool ok = true;
    int code = sqlite3_step(q);
    if (code == SQLITE_DONE)
        return err_set(e, ERR_NOENT, "%s: %s: not in this store", s->path, what);
    if (code != SQLITE_ROW)
        return store_db_fail(s, code, what, e);
    struct hash128 want = store_column_hash(q, 0, &ok);
    /* NULL of an empty blob is fine. NULL of a page that cannot be read, or for want of memory, is
     * not, and says nothing about the hash. */
    const void *p = sqlite3_column_blob(q, 1);
    size_t n = (size_t)sqlite3_column_bytes(q, 1);
    code = sqlite3_errcode(s->db);
    if ((!p || !ok) && code != SQLITE_ROW && code != SQLITE_OK)
        return store_db_fail(s, code, what, e);
    struct hash128 have = hash_bytes(p ? p : "", n);
    if (!ok || have.lo != want.lo || have.hi != want.hi)
        return err_set(
            e, ERR_FORMAT,
            "%s: %s: damaged (its hash differs); restore the file or tile the scene again", s->path,
            what);
    out->size = 0;
    buf_add(out, p, n);
    return buf_check(out, e);
}

enum err_code store_read(struct store *s, struct key k, struct buf *out, struct err *e)
{
    char what[64];
    snprintf(what, sizeof what, "tile %u/%u/%u", k.z, k.x, k.y);
    if (!key_valid(k))
        return err_set(e, ERR_NOENT, "%s: %s: no such tile", s->path, what);
    if (!s->get) {
        int code = sqlite3_prepare_v2(s->db, "SELECT hash,payload FROM tiles WHERE id=?1", -1,
                                      &s->get, NULL);
        if (code != SQLITE_OK)
            return store_db_fail(s, code, what, e);
    }
    const struct store_tile *t = s->remote ? store_find(s, k) : NULL;
    if (t)
        remote_expect(s->remote, t->bytes);
    sqlite3_bind_int64(s->get, 1, store_db_id(k));
    enum err_code rc = store_take(s, s->get, what, out, e);
    sqlite3_reset(s->get);
    if (t)
        remote_expect(s->remote, 0);
    if (rc)
        buf_free(out);
    return rc;
}

/* The code of *e, whose message then says which tile it is. */
enum err_code store_name_tile(const struct store *s, const struct store_tile *t, struct err *e)
{
    return err_add(e, "%s: tile %u/%u/%u", s->path, t->key.z, t->key.x, t->key.y);
}

/* A hash says that the bytes are those that were written, not that whoever wrote them meant
 * well. */
enum err_code store_unpack(const struct store *s, const struct store_tile *t,
                           const struct buf *bytes, struct payload *out, struct err *e)
{
    enum { MEAN_SCALE_QUAT_OPACITY = 11 };
    const struct store_meta *m = &s->meta;
    const size_t row = MEAN_SCALE_QUAT_OPACITY + 3 * gauss_sh_count(m->sh_degree) + m->embed_len;
    const struct codec_limits limits = {.max_gaussians = t->count ? t->count : 1, /* 0: no limit */
                                        .max_bytes = t->count * row * sizeof(float) + 1};
    enum err_code rc = payload_open(out, bytes->data, bytes->size, &limits, e);
    if (!rc &&
        (out->n != t->count || out->sh_degree > m->sh_degree || out->embed_len != m->embed_len))
        rc = ERR_LIMIT;
    if (rc == ERR_LIMIT)
        rc = err_set(e, ERR_FORMAT,
                     "other harmonics, embeddings or number of Gaussians than the index says");
    if (!rc) {
        const struct store_shape x = store_shape(s, t);
        memcpy(out->origin_enu_m, x.center_enu_m, sizeof out->origin_enu_m);
        return ERR_OK;
    }
    return store_name_tile(s, t, e);
}

static enum err_code store_decode(const struct store *s, const struct store_tile *t,
                                  const struct buf *bytes, struct gauss *out, struct err *e)
{
    struct payload p = {0};
    *out = (struct gauss){0};
    enum err_code rc = store_unpack(s, t, bytes, &p, e);
    if (!rc && payload_gauss(&p, out, e))
        rc = store_name_tile(s, t, e);
    payload_free(&p);
    return rc;
}

enum err_code store_read_gauss(struct store *s, struct key k, struct gauss *out, struct err *e)
{
    struct buf b = {0};
    *out = (struct gauss){0};
    const struct store_tile *t = store_find(s, k);
    if (!t)
        return err_set(e, ERR_NOENT, "%s: tile %u/%u/%u: not in this store", s->path, k.z, k.x,
                       k.y);
    enum err_code rc = store_read(s, k, &b, e);
    if (!rc)
        rc = store_decode(s, t, &b, out, e);
    buf_free(&b);
    return rc;
}

enum err_code store_get_blob(struct store *s, const char *name, struct buf *out, struct err *e)
{
    char what[160];
    snprintf(what, sizeof what, "blob '%.120s'", name);
    if (!s->get_blob) {
        int code = sqlite3_prepare_v2(s->db, "SELECT hash,bytes FROM blobs WHERE name=?1", -1,
                                      &s->get_blob, NULL);
        if (code != SQLITE_OK)
            return store_db_fail(s, code, what, e);
    }
    sqlite3_bind_text(s->get_blob, 1, name, -1, SQLITE_STATIC);
    enum err_code rc = store_take(s, s->get_blob, what, out, e);
    sqlite3_reset(s->get_blob);
    sqlite3_clear_bindings(s->get_blob);
    if (rc)
        buf_free(out);
    return rc;
}

enum err_code store_list_blobs(struct store *s, struct arena *a, char ***names, size_t *n,
                               struct err *e)
{
    sqlite3_stmt *q = NULL;
    char **list = NULL;
    *n = 0;
    *names = NULL;
    int code = sqlite3_prepare_v2(s->db, "SELECT name,count(*) OVER () FROM blobs ORDER BY name",
                                  -1, &q, NULL);
    enum err_code rc = code == SQLITE_OK ? ERR_OK : store_db_fail(s, code, "blobs", e);
    while (!rc && (code = sqlite3_step(q)) == SQLITE_ROW) {
        size_t total = (size_t)sqlite3_column_int64(q, 1);
        const char *name = (const char *)sqlite3_column_text(q, 0);
        if (!list)
            list = arena_get(a, total, sizeof *list);
        char *copy = name && list && *n < total ? arena_text(a, name) : NULL;
        if (!copy)
            rc = err_set(e, ERR_MEM, "%s: out of memory for the names of blobs", s->path);
        else
            list[(*n)++] = copy;
    }
    if (!rc && code != SQLITE_DONE)
        rc = store_db_fail(s, code, "blobs", e);
    sqlite3_finalize(q);
    *names = list;
    return rc;
}
