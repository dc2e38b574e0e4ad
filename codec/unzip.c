/* See unzip.h. Every number of an archive is checked before it is used: what a directory says of a
 * file when it is read, and what the file's own header says when the file is.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/unzip.h"

#include <libdeflate.h>
#include <stdlib.h>
#include <string.h>

enum {
    UNZIP_END = 22, /* bytes of the last record */
    UNZIP_COMMENT = 65535,
    UNZIP_LOCATOR = 20,
    UNZIP_END64 = 56,
    UNZIP_ENTRY = 46, /* of the directory */
    UNZIP_LOCAL = 30,
    UNZIP_DIRECTORY_MAX = 512 << 20,
    UNZIP_RATIO = 1032 /* deflate makes at most so many bytes of one */
};

struct unzip {
    struct unzip_file *file; /* [n], by name */
    size_t n;
    struct hash128 hash;
};
struct unzip_directory {
    uint64_t at, size, n;
};

/* ---- where the directory is ---- */

static enum err_code unzip_end64(const struct read_at *from, uint64_t at,
                                 struct unzip_directory *out, struct err *e)
{
    uint8_t end[UNZIP_END64];
    if (from->size_bytes < sizeof end || at > from->size_bytes - sizeof end)
        return err_set(e, ERR_FORMAT, "%s: damaged: its last records make no sense", from->name);
    enum err_code rc = from->read(from->user, at, end, sizeof end, e);
    struct cursor c = cursor_over(end, sizeof end);
    if (!rc && cursor_u32(&c) != 0x06064b50)
        rc = err_set(e, ERR_FORMAT, "%s: damaged: its last records make no sense", from->name);
    if (rc)
        return rc;
    c = cursor_over(end + 32, sizeof end - 32);
    out->n = cursor_u64(&c);
    out->size = cursor_u64(&c);
    out->at = cursor_u64(&c);
    return ERR_OK;
}

/* By the last record, behind which there may be a comment. */
static enum err_code unzip_end(const struct read_at *from, const uint8_t *tail, size_t n,
                               struct unzip_directory *out, struct err *e)
{
    const uint8_t *end = n >= UNZIP_END ? tail + n - UNZIP_END : NULL;
    for (; end && end >= tail; end--) {
        struct cursor c = cursor_over(end, UNZIP_END);
        const bool found = cursor_u32(&c) == 0x06054b50;
        c = cursor_over(end + UNZIP_END - 2, 2);
        if (found && cursor_u16(&c) == (size_t)(tail + n - end) - UNZIP_END)
            break;
    }
    if (!end || end < tail)
        return err_set(e, ERR_FORMAT, "%s: no zip archive, or not all of it: its end is not there",
                       from->name);
    struct cursor c = cursor_over(end + 10, UNZIP_END - 10);
    out->n = cursor_u16(&c);
    out->size = cursor_u32(&c);
    out->at = cursor_u32(&c);
    if (end - tail < UNZIP_LOCATOR)
        return ERR_OK;
    c = cursor_over(end - UNZIP_LOCATOR, UNZIP_LOCATOR);
    if (cursor_u32(&c) != 0x07064b50) /* no ZIP64 */
        return ERR_OK;
    (void)cursor_u32(&c);
    return unzip_end64(from, cursor_u64(&c), out, e);
}

static enum err_code unzip_locate(const struct read_at *from, struct unzip_directory *out,
                                  struct err *e)
{
    const size_t most = UNZIP_COMMENT + UNZIP_END + UNZIP_LOCATOR,
                 n = from->size_bytes < most ? (size_t)from->size_bytes : most;
    uint8_t *tail = mem_uninit(n, 1);
    if (!tail)
        return err_set(e, ERR_MEM, "%s: out of memory", from->name);
    enum err_code rc = from->read(from->user, from->size_bytes - n, tail, n, e);
    if (!rc)
        rc = unzip_end(from, tail, n, out, e);
    mem_free(tail);
    if (rc)
        return rc;
    if (out->at > from->size_bytes || out->size > from->size_bytes - out->at ||
        out->n > out->size / UNZIP_ENTRY)
        return err_set(e, ERR_FORMAT, "%s: damaged: its directory does not lie within it",
                       from->name);
    if (out->n > UNZIP_FILES_MAX || out->size > UNZIP_DIRECTORY_MAX)
        return err_set(e, ERR_LIMIT, "%s: %llu files: at most %d are read", from->name,
                       (unsigned long long)out->n, UNZIP_FILES_MAX);
    return ERR_OK;
}

/* ---- the directory ---- */

struct unzip_entry { /* as it stands there */
    uint64_t packed, plain, at;
    uint32_t flags, method, crc32;
    const uint8_t *name;
    size_t n_name;
};

/* Numbers that have no room in 32 bits stand behind the name, in this order. */
static void unzip_wide(const uint8_t *extra, size_t n, struct unzip_entry *out, bool *bad)
{
    struct cursor c = cursor_over(extra, n);
    uint64_t *const wide[] = {&out->plain, &out->packed, &out->at};
    while (!c.bad && cursor_left(&c) >= 4) {
        const uint16_t id = cursor_u16(&c), size = cursor_u16(&c);
        const uint8_t *part = cursor_take(&c, size);
        struct cursor in = cursor_over(part ? part : extra, part ? size : 0);
        for (size_t i = 0; id == 1 && i < 3; i++)
            if (*wide[i] == UINT32_MAX) {
                *wide[i] = cursor_u64(&in);
                *bad |= in.bad;
            }
        if (id == 1)
            return;
    }
}

static bool unzip_next(struct cursor *c, struct unzip_entry *out)
{
    bool bad = cursor_u32(c) != 0x02014b50;
    (void)cursor_u32(c); /* versions */
    out->flags = cursor_u16(c);
    out->method = cursor_u16(c);
    (void)cursor_u32(c); /* date */
    out->crc32 = cursor_u32(c);
    out->packed = cursor_u32(c);
    out->plain = cursor_u32(c);
    out->n_name = cursor_u16(c);
    const size_t n_extra = cursor_u16(c), n_comment = cursor_u16(c);
    (void)cursor_u64(c); /* disk, attributes */
    out->at = cursor_u32(c);
    out->name = cursor_take(c, out->n_name);
    const uint8_t *extra = cursor_take(c, n_extra);
    (void)cursor_take(c, n_comment);
    if (!c->bad && !bad)
        unzip_wide(extra, n_extra, out, &bad);
    return !c->bad && !bad;
}

/* Checks an entry, and takes it in. Folders are no files. */
static enum err_code unzip_take(const struct read_at *from, const struct unzip_directory *d,
                                const struct unzip_entry *x, struct unzip *u, struct err *e)
{
    const int n = (int)(x->n_name < 80 ? x->n_name : 80);
    const char *name = (const char *)x->name, *why = NULL;
    const uint64_t head = UNZIP_LOCAL + x->n_name;
    if (x->n_name && x->name[x->n_name - 1] == '/')
        return ERR_OK;
    if (x->flags & 1)
        why = "it is encrypted";
    else if (x->method != 0 && x->method != 8)
        why = "it is compressed by a method that is not deflate";
    else if (x->at > d->at || d->at - x->at < head || x->packed > d->at - x->at - head)
        why = "it does not lie within the archive";
    else if (x->method ? x->plain > (x->packed + 1) * UNZIP_RATIO : x->plain != x->packed)
        why = "its bytes cannot be as many as the directory says";
    if (why)
        return err_set(e, ERR_FORMAT, "%s: file %.*s: %s", from->name, n, name, why);
    if (x->plain > UNZIP_BYTES_MAX || x->packed > UNZIP_BYTES_MAX)
        return err_set(e, ERR_LIMIT, "%s: file %.*s: more than %d MiB", from->name, n, name,
                       UNZIP_BYTES_MAX >> 20);
    u->file[u->n++] = (struct unzip_file){.name = hash_bytes(x->name, x->n_name),
                                          .at = x->at,
                                          .packed = (uint32_t)x->packed,
                                          .plain = (uint32_t)x->plain,
                                          .crc32 = x->crc32,
                                          .deflated = x->method != 0};
    return ERR_OK;
}

static int unzip_compare(const struct hash128 *a, const struct hash128 *b)
{
    return a->hi != b->hi   ? (a->hi < b->hi ? -1 : 1)
           : a->lo != b->lo ? (a->lo < b->lo ? -1 : 1)
                            : 0;
}

static int unzip_by_name(const void *a, const void *b)
{
    return unzip_compare(&((const struct unzip_file *)a)->name,
                         &((const struct unzip_file *)b)->name);
}

static enum err_code unzip_parse(const struct read_at *from, const struct unzip_directory *d,
                                 const uint8_t *bytes, struct unzip *u, struct err *e)
{
    struct cursor c = cursor_over(bytes, (size_t)d->size);
    struct unzip_entry x;
    enum err_code rc = ERR_OK;
    for (uint64_t i = 0; !rc && i < d->n; i++)
        rc = unzip_next(&c, &x)
                 ? unzip_take(from, d, &x, u, e)
                 : err_set(e, ERR_FORMAT, "%s: damaged: entry %llu of its directory makes no sense",
                           from->name, (unsigned long long)i);
    if (rc)
        return rc;
    qsort(u->file, u->n, sizeof *u->file, unzip_by_name);
    for (size_t i = 1; i < u->n; i++)
        if (!unzip_by_name(&u->file[i - 1], &u->file[i]))
            return err_set(e, ERR_FORMAT, "%s: two files of it have one name", from->name);
    u->hash = hash_bytes(bytes, (size_t)d->size);
    return ERR_OK;
}

enum err_code unzip_open(const struct read_at *from, struct unzip **out, struct err *e)
{
    struct unzip_directory d = {0};
    uint8_t *bytes = NULL;
    struct unzip *u = mem_array(1, sizeof *u);
    *out = u;
    enum err_code rc =
        u ? unzip_locate(from, &d, e) : err_set(e, ERR_MEM, "%s: out of memory", from->name);
    if (!rc && (!(bytes = mem_uninit((size_t)d.size, 1)) ||
                !(u->file = mem_array((size_t)d.n, sizeof *u->file))))
        rc = err_set(e, ERR_MEM, "%s: out of memory for its %llu files", from->name,
                     (unsigned long long)d.n);
    if (!rc)
        rc = from->read(from->user, d.at, bytes, (size_t)d.size, e);
    if (!rc)
        rc = unzip_parse(from, &d, bytes, u, e);
    mem_free(bytes);
    if (rc)
        unzip_close(out);
    return rc;
}

void unzip_close(struct unzip **u)
{
    if (*u)
        mem_free((*u)->file);
    mem_free(*u);
    *u = NULL;
}

const struct unzip_file *unzip_files(const struct unzip *u, size_t *n)
{
    *n = u->n;
    return u->file;
}

struct hash128 unzip_hash(const struct unzip *u)
{
    return u->hash;
}

/* ---- files ---- */

const struct unzip_file *unzip_find(const struct unzip *u, const char *name, size_t n)
{
    const struct hash128 want = hash_bytes(name, n);
    for (size_t lo = 0, hi = u->n; lo < hi;) {
        const size_t mid = lo + (hi - lo) / 2;
        const int order = unzip_compare(&u->file[mid].name, &want);
        if (!order)
            return &u->file[mid];
        if (order < 0)
            lo = mid + 1;
        else
            hi = mid;
    }
    return NULL;
}

/* Where the bytes of a file begin: its own header must say so too. */
static enum err_code unzip_begin(const struct read_at *from, const struct unzip_file *f,
                                 uint64_t *at, struct err *e)
{
    uint8_t local[UNZIP_LOCAL];
    enum err_code rc = from->read(from->user, f->at, local, sizeof local, e);
    if (rc)
        return rc;
    struct cursor c = cursor_over(local, sizeof local);
    const bool begins = cursor_u32(&c) == 0x04034b50;
    (void)cursor_u32(&c); /* version, flags */
    const uint32_t method = cursor_u16(&c);
    c = cursor_over(local + 26, 4);
    *at = f->at + UNZIP_LOCAL + cursor_u16(&c);
    *at += cursor_u16(&c);
    return begins && method == (f->deflated ? 8 : 0) && *at <= from->size_bytes &&
                   f->packed <= from->size_bytes - *at
               ? ERR_OK
               : err_set(e, ERR_FORMAT, "%s: damaged: a file does not begin where it should",
                         from->name);
}

static enum err_code unzip_inflate(const struct read_at *from, const struct unzip_file *f,
                                   const uint8_t *packed, uint8_t *plain, struct err *e)
{
    size_t got = 0;
    struct libdeflate_decompressor *z = libdeflate_alloc_decompressor();
    if (!z)
        return err_set(e, ERR_MEM, "%s: out of memory", from->name);
    const bool fine = libdeflate_deflate_decompress(z, packed, f->packed, plain, f->plain, &got) ==
                          LIBDEFLATE_SUCCESS &&
                      got == f->plain;
    libdeflate_free_decompressor(z);
    return fine ? ERR_OK
                : err_set(e, ERR_FORMAT, "%s: damaged: a file cannot be decompressed", from->name);
}

enum err_code unzip_read(const struct read_at *from, const struct unzip_file *f, struct buf *out,
                         struct err *e)
{
    uint64_t at;
    uint8_t *packed = NULL, *plain = buf_grow(out, f->plain);
    enum err_code rc = buf_check(out, e);
    if (!rc && f->deflated && !(packed = mem_uninit(f->packed, 1)))
        rc = err_set(e, ERR_MEM, "%s: out of memory for a file", from->name);
    if (!rc)
        rc = unzip_begin(from, f, &at, e);
    if (!rc && f->packed)
        rc = from->read(from->user, at, packed ? packed : plain, f->packed, e);
    if (!rc && packed)
        rc = unzip_inflate(from, f, packed, plain, e);
    mem_free(packed);
    if (!rc && libdeflate_crc32(0, plain, f->plain) != f->crc32)
        rc = err_set(e, ERR_FORMAT, "%s: damaged: a file does not have its checksum", from->name);
    return rc;
}
