/* Writes PMTiles in one pass: see pmtiles.h and the specification, version 3.
 *
 *     0       header, 127 bytes: the place of everything else
 *     127     root directory, gzip, at most 16257 bytes
 *     16384   tiles in the order of their ids ("clustered")
 *     ...     metadata, leaf directories
 *
 * The root directory must lie in the first 16 KiB, which readers fetch at once. Its size is known
 * only at the end. Tiles therefore begin after that space and need not be moved. A directory is a
 * list of numbers of variable length, stored column by column: differences of ids, run lengths,
 * lengths, offsets (0: directly after the entry before). A run is the same content at consecutive
 * ids. If one directory is too large for the root, the root lists leaf directories.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/pmtiles.h"

#include <fcntl.h>
#include <libdeflate.h>
#include <math.h>
#include <string.h>
#include <unistd.h>

enum {
    PMTILES_HEAD = 127,
    PMTILES_ROOM = 16384,
    PMTILES_ROOT_MAX = PMTILES_ROOM - PMTILES_HEAD,
    PMTILES_LEAF = 4096, /* entries of a leaf, to begin with */
    PMTILES_LEVEL = 9    /* of compression */
};

struct pmtiles_entry {
    uint64_t id, offset;  /* of tiles: from where they begin; of leaves likewise */
    uint32_t length, run; /* run 0: a leaf */
};
struct pmtiles_content {
    struct hash128 hash;
    uint64_t offset;
    uint32_t length; /* 0: an empty place */
};
struct pmtiles {
    char path[FILE_PATH_MAX], part[FILE_PATH_MAX];
    int fd;
    struct pmtiles_entry *entry; /* [n], room for cap */
    size_t n, cap;
    struct pmtiles_content *content; /* [n_places], a power of two; by hash */
    size_t n_contents, n_places;
    uint64_t tiles, bytes, next; /* next: least id that may come */
};

uint64_t pmtiles_id(uint8_t z, uint32_t x, uint32_t y)
{
    uint64_t id = (((uint64_t)1 << 2 * z) - 1) / 3; /* tiles of the zooms above */
    for (int a = z - 1; a >= 0; a--) {
        const uint32_t s = (uint32_t)1 << a;
        const bool right = x & s, low = y & s;
        id += (uint64_t)((right ? 3u : 0u) ^ (low ? 1u : 0u)) << 2 * a;
        if (!low) {
            const uint32_t was = right ? s - 1 - x : x; /* bits above s do not count any more */
            x = right ? s - 1 - y : y;
            y = was;
        }
    }
    return id;
}

/* ---- contents ---- */

static struct pmtiles_content *pmtiles_place(struct pmtiles_content *all, size_t n_places,
                                             struct hash128 hash)
{
    size_t at = hash.lo & (n_places - 1);
    while (all[at].length && (all[at].hash.lo != hash.lo || all[at].hash.hi != hash.hi))
        at = (at + 1) & (n_places - 1);
    return &all[at];
}

/* At most half of the places are taken. */
static enum err_code pmtiles_grow(struct pmtiles *p, struct err *e)
{
    const size_t more = p->n_places ? 2 * p->n_places : 1024;
    if (2 * (p->n_contents + 1) <= p->n_places)
        return ERR_OK;
    struct pmtiles_content *all = mem_array(more, sizeof *all);
    if (!all)
        return err_set(e, ERR_MEM, "%s: out of memory for %zu tiles", p->path, p->n_contents);
    for (size_t i = 0; i < p->n_places; i++)
        if (p->content[i].length)
            *pmtiles_place(all, more, p->content[i].hash) = p->content[i];
    mem_free(p->content);
    p->content = all;
    p->n_places = more;
    return ERR_OK;
}

/* ---- tiles ---- */

enum err_code pmtiles_begin(const char *path, struct pmtiles **out, struct err *e)
{
    struct pmtiles *p = mem_array(1, sizeof *p);
    *out = p;
    if (!p)
        return err_set(e, ERR_MEM, "%s: out of memory", path);
    p->fd = -1;
    enum err_code rc = file_begin(path, p->part, e);
    if (rc)
        p->part[0] = '\0'; /* nothing is there to remove */
    else
        memcpy(p->path, path, strlen(path) + 1);
    if (!rc && (p->fd = open(p->part, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666)) < 0)
        rc = err_errno(e, ERR_IO, "%s", p->part);
    if (rc)
        pmtiles_abort(out);
    return rc;
}

static void pmtiles_free(struct pmtiles **out)
{
    struct pmtiles *p = *out;
    *out = NULL;
    if (!p)
        return;
    if (p->fd >= 0)
        close(p->fd);
    mem_free(p->entry);
    mem_free(p->content);
    mem_free(p);
}

void pmtiles_abort(struct pmtiles **out)
{
    if (*out && (*out)->part[0])
        file_abort((*out)->part);
    pmtiles_free(out);
}

static enum err_code pmtiles_enter(struct pmtiles *p, uint64_t id, uint64_t offset, uint32_t length,
                                   struct err *e)
{
    struct pmtiles_entry *last = p->n ? &p->entry[p->n - 1] : NULL;
    if (last && last->offset == offset && last->id + last->run == id && last->run < UINT32_MAX) {
        last->run++;
        return ERR_OK;
    }
    void *more = mem_room(p->entry, p->n, &p->cap, 1024, sizeof *p->entry);
    if (!more)
        return err_set(e, ERR_MEM, "%s: out of memory for %zu tiles", p->path, p->n + 1);
    p->entry = more;
    p->entry[p->n++] = (struct pmtiles_entry){id, offset, length, 1};
    return ERR_OK;
}

enum err_code pmtiles_add(struct pmtiles *p, uint64_t id, const void *bytes, size_t n,
                          struct err *e)
{
    if (!n || id < p->next)
        return err_set(e, ERR_ARG, "%s: tile %llu: %s", p->path, (unsigned long long)id,
                       n ? "comes after one of a later place" : "is empty");
    if (n > UINT32_MAX)
        return err_set(e, ERR_LIMIT, "%s: tile %llu: more than 4 GiB", p->path,
                       (unsigned long long)id);
    enum err_code rc = pmtiles_grow(p, e);
    if (rc)
        return rc;
    const struct hash128 hash = hash_bytes(bytes, n);
    struct pmtiles_content *c = pmtiles_place(p->content, p->n_places, hash);
    if (!c->length) {
        rc = file_write_at(p->fd, p->part, bytes, n, PMTILES_ROOM + p->bytes, e);
        if (rc)
            return rc;
        *c = (struct pmtiles_content){hash, p->bytes, (uint32_t)n};
        p->n_contents++;
        p->bytes += n;
    }
    rc = pmtiles_enter(p, id, c->offset, c->length, e);
    p->tiles += !rc;
    p->next = id + 1;
    return rc;
}

void pmtiles_count(const struct pmtiles *p, uint64_t *tiles, uint64_t *contents, uint64_t *bytes)
{
    *tiles = p->tiles;
    *contents = p->n_contents;
    *bytes = p->bytes;
}

/* ---- directories ---- */

static void pmtiles_number(struct buf *b, uint64_t v)
{
    for (; v >= 128; v >>= 7)
        buf_u8(b, (unsigned)(v & 127) | 128);
    buf_u8(b, (unsigned)v);
}

static enum err_code pmtiles_pack(const void *bytes, size_t n, struct buf *out, struct err *e)
{
    struct libdeflate_compressor *z = libdeflate_alloc_compressor(PMTILES_LEVEL);
    const size_t room = z ? libdeflate_gzip_compress_bound(z, n) : 0;
    uint8_t *to = z ? buf_grow(out, room) : NULL;
    const size_t packed = to ? libdeflate_gzip_compress(z, bytes, n, to, room) : 0;
    libdeflate_free_compressor(z);
    out->size -= to ? room - packed : 0;
    return packed ? ERR_OK : err_set(e, ERR_MEM, "PMTiles: out of memory for a directory");
}

/* Entries as a directory, packed, appended to out. */
static enum err_code pmtiles_directory(const struct pmtiles_entry *d, size_t n, struct buf *out,
                                       struct err *e)
{
    struct buf b = {0};
    pmtiles_number(&b, n);
    for (size_t i = 0; i < n; i++)
        pmtiles_number(&b, d[i].id - (i ? d[i - 1].id : 0));
    for (size_t i = 0; i < n; i++)
        pmtiles_number(&b, d[i].run);
    for (size_t i = 0; i < n; i++)
        pmtiles_number(&b, d[i].length);
    for (size_t i = 0; i < n; i++) {
        const bool follows = i && d[i].offset == d[i - 1].offset + d[i - 1].length;
        pmtiles_number(&b, follows ? 0 : d[i].offset + 1);
    }
    enum err_code rc = buf_check(&b, e);
    if (!rc)
        rc = pmtiles_pack(b.data, b.size, out, e);
    buf_free(&b);
    return rc;
}

/* Leaves of `size` entries each, and the root that points at them. */
static enum err_code pmtiles_leaves(const struct pmtiles *p, size_t size, struct buf *root,
                                    struct buf *leaves, struct err *e)
{
    const size_t n = (p->n + size - 1) / size;
    struct pmtiles_entry *to = mem_array(n, sizeof *to);
    enum err_code rc = to ? ERR_OK : err_set(e, ERR_MEM, "%s: out of memory", p->path);
    leaves->size = root->size = 0;
    for (size_t i = 0; !rc && i < n; i++) {
        const size_t from = i * size, count = p->n - from < size ? p->n - from : size;
        to[i] = (struct pmtiles_entry){.id = p->entry[from].id, .offset = leaves->size};
        rc = pmtiles_directory(p->entry + from, count, leaves, e);
        to[i].length = (uint32_t)(leaves->size - to[i].offset);
    }
    if (!rc)
        rc = pmtiles_directory(to, n, root, e);
    mem_free(to);
    return rc;
}

/* leaves is empty where one directory holds everything. */
static enum err_code pmtiles_directories(const struct pmtiles *p, struct buf *root,
                                         struct buf *leaves, struct err *e)
{
    enum err_code rc = ERR_OK;
    if (p->n <= PMTILES_ROOT_MAX) /* an entry takes a byte at the least */
        rc = pmtiles_directory(p->entry, p->n, root, e);
    for (size_t size = PMTILES_LEAF;
         !rc && (p->n > PMTILES_ROOT_MAX || root->size > PMTILES_ROOT_MAX) &&
         (!leaves->size || root->size > PMTILES_ROOT_MAX);
         size += size / 4)
        rc = pmtiles_leaves(p, size, root, leaves, e);
    return rc;
}

/* ---- the head ---- */

/* 1e-7 degrees. */
static void pmtiles_degrees(struct buf *b, double deg)
{
    buf_u32(b, (uint32_t)(int32_t)lround(fmin(fmax(deg, -180), 180) * 1e7));
}

static void pmtiles_head(const struct pmtiles *p, const struct pmtiles_about *a, size_t root,
                         size_t metadata, size_t leaves, struct buf *b)
{
    enum { CLUSTERED = 1, GZIP = 2, NONE = 1 };
    const uint64_t end = PMTILES_ROOM + p->bytes;
    const uint64_t at[] = {PMTILES_HEAD, root,     end,      metadata, end + metadata, leaves,
                           PMTILES_ROOM, p->bytes, p->tiles, p->n,     p->n_contents};
    const uint8_t kinds[] = {CLUSTERED, GZIP, NONE, (uint8_t)a->type, a->zoom_min, a->zoom_max};
    buf_add(b, "PMTiles\3", 8);
    for (size_t i = 0; i < sizeof at / sizeof *at; i++)
        buf_u64(b, at[i]);
    buf_add(b, kinds, sizeof kinds);
    for (int i = 0; i < 4; i++)
        pmtiles_degrees(b, a->bbox_deg[i]);
    buf_u8(b, a->zoom_center);
    for (int i = 0; i < 2; i++)
        pmtiles_degrees(b, 0.5 * (a->bbox_deg[i] + a->bbox_deg[i + 2]));
}

enum err_code pmtiles_commit(struct pmtiles **out, const struct pmtiles_about *a, struct err *e)
{
    struct pmtiles *p = *out;
    struct buf head = {0}, root = {0}, leaves = {0}, metadata = {0};
    enum err_code rc = pmtiles_directories(p, &root, &leaves, e);
    if (!rc)
        rc = pmtiles_pack(a->metadata, strlen(a->metadata), &metadata, e);
    if (!rc) {
        pmtiles_head(p, a, root.size, metadata.size, leaves.size, &head);
        buf_add(&head, root.data, root.size);
        while (head.size < PMTILES_ROOM && !head.failed)
            buf_u8(&head, 0);
        rc = buf_check(&head, e);
    }
    if (!rc)
        rc = file_write_at(p->fd, p->part, head.data, head.size, 0, e);
    if (!rc)
        rc =
            file_write_at(p->fd, p->part, metadata.data, metadata.size, PMTILES_ROOM + p->bytes, e);
    if (!rc && leaves.size)
        rc = file_write_at(p->fd, p->part, leaves.data, leaves.size,
                           PMTILES_ROOM + p->bytes + metadata.size, e);
    if (!rc) {
        const int fd = p->fd;
        p->fd = -1; /* a descriptor is gone even if close fails */
        if (close(fd))
            rc = err_errno(e, ERR_IO, "%s", p->part);
    }
    if (!rc)
        rc = file_commit(p->part, p->path, e);
    if (rc)
        pmtiles_abort(out);
    else
        pmtiles_free(out);
    buf_free(&head);
    buf_free(&root);
    buf_free(&leaves);
    buf_free(&metadata);
    return rc;
}
