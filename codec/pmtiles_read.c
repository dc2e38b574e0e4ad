/* See pmtiles_read.h. Bytes of the file are hostile until checked: places lie within the file, ids
 * grow from entry to entry over all directories (so none is read twice), and what decompresses to
 * more than its limit is refused before it is decompressed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/pmtiles_read.h"

#include <libdeflate.h>
#include <string.h>

enum {
    PMTILES_READ_HEAD = 127,
    PMTILES_READ_METADATA = 4 << 20,   /* most bytes of it */
    PMTILES_READ_DIRECTORY = 16 << 20, /* most bytes of one */
    PMTILES_READ_SAMPLE = 64 << 10,    /* bytes of tiles that are hashed */
    PMTILES_READ_DEPTH = 3             /* of leaves below leaves */
};
enum { PMTILES_READ_PLAIN = 1, PMTILES_READ_GZIP = 2 };

struct pmtiles_read_run { /* the same content at `run` ids in a row */
    uint64_t id, at;
    uint32_t size_bytes, run;
};
struct pmtiles_read_part {
    uint64_t at, size;
};
struct pmtiles_read {
    struct pmtiles_read_run *run; /* [n], by id */
    size_t n, cap;
    uint64_t tiles, next; /* next: least id that may come */
    uint32_t largest;
    struct pmtiles_about about;
    struct buf metadata;
    struct hash128 hash;
    struct pmtiles_read_part root, meta, leaves, data;
    unsigned packing; /* of directories and metadata */
};
struct pmtiles_read_from {
    const struct read_at *from;
    struct hash_state *hash;
    struct pmtiles_read *p;
};

/* ---- parts of the file ---- */

static enum err_code pmtiles_read_unpack(const struct read_at *from, const struct buf *packed,
                                         size_t most, struct buf *out, struct err *e)
{
    struct cursor c = {0};
    size_t got = 0;
    if (packed->size < 18) /* of an empty one */
        return err_set(e, ERR_FORMAT, "%s: damaged: a part is not gzip", from->name);
    c = cursor_over(packed->data + packed->size - 4, 4);
    const size_t n = cursor_u32(&c); /* what it says it will be */
    if (n > most)
        return err_set(e, ERR_LIMIT, "%s: a directory or its metadata has more than %zu MiB",
                       from->name, most >> 20);
    struct libdeflate_decompressor *z = libdeflate_alloc_decompressor();
    uint8_t *to = z ? buf_grow(out, n) : NULL;
    const bool fine = to && libdeflate_gzip_decompress(z, packed->data, packed->size, to, n,
                                                       &got) == LIBDEFLATE_SUCCESS;
    libdeflate_free_decompressor(z);
    if (!to)
        return err_set(e, ERR_MEM, "%s: out of memory", from->name);
    return fine && got == n ? ERR_OK
                            : err_set(e, ERR_FORMAT, "%s: damaged: a part is not gzip", from->name);
}

/* Appends a part, unpacked, to out. */
static enum err_code pmtiles_read_part(const struct pmtiles_read_from *f,
                                       struct pmtiles_read_part part, size_t most, struct buf *out,
                                       struct err *e)
{
    struct buf raw = {0};
    if (part.size > most)
        return err_set(e, ERR_LIMIT, "%s: a directory or its metadata has more than %zu MiB",
                       f->from->name, most >> 20);
    uint8_t *to = buf_grow(&raw, (size_t)part.size);
    enum err_code rc = buf_check(&raw, e);
    if (!rc && part.size)
        rc = f->from->read(f->from->user, part.at, to, (size_t)part.size, e);
    if (!rc)
        hash_add(f->hash, raw.data, raw.size);
    if (!rc && f->p->packing == PMTILES_READ_GZIP) {
        rc = pmtiles_read_unpack(f->from, &raw, most, out, e);
    } else if (!rc) {
        buf_add(out, raw.data, raw.size);
        rc = buf_check(out, e);
    }
    buf_free(&raw);
    return rc;
}

/* ---- directories ---- */

static uint64_t pmtiles_read_number(struct cursor *c)
{
    uint64_t v = 0;
    for (unsigned shift = 0; shift < 64; shift += 7) {
        const uint64_t byte = cursor_u8(c);
        v |= (byte & 127) << shift;
        if (byte < 128)
            return v;
    }
    c->bad = true;
    return 0;
}

/* The columns of a directory as rows [n]; mem_free *out. Sizes and places are not checked yet. */
static enum err_code pmtiles_read_rows(const struct read_at *from, const struct buf *b,
                                       struct pmtiles_read_run **out, size_t *n, struct err *e)
{
    struct cursor c = cursor_over(b->data, b->size);
    const uint64_t count = pmtiles_read_number(&c);
    uint64_t id = 0;
    *out = NULL;
    if (c.bad || count > cursor_left(&c) / 4) /* an entry takes four bytes at the least */
        return err_set(e, ERR_FORMAT, "%s: damaged: a directory makes no sense", from->name);
    struct pmtiles_read_run *row = mem_array((size_t)count, sizeof *row);
    if (!row)
        return err_set(e, ERR_MEM, "%s: out of memory for a directory", from->name);
    *n = (size_t)count;
    for (size_t i = 0; i < *n; i++) {
        const uint64_t step = pmtiles_read_number(&c);
        c.bad |= step > (uint64_t)1 << 60;
        id += step;
        c.bad |= id > (uint64_t)1 << 60;
        row[i].id = id;
    }
    for (size_t i = 0; i < 2 * *n; i++) {
        const uint64_t v = pmtiles_read_number(&c);
        c.bad |= v > UINT32_MAX;
        *(i < *n ? &row[i].run : &row[i - *n].size_bytes) = (uint32_t)v;
    }
    for (size_t i = 0; i < *n; i++) {
        const uint64_t v = pmtiles_read_number(&c);
        c.bad |= !v && !i;
        row[i].at = v ? v - 1 : i ? row[i - 1].at + row[i - 1].size_bytes : 0;
        c.bad |= row[i].at > (uint64_t)1 << 60;
    }
    *out = row;
    return !c.bad ? ERR_OK
                  : err_set(e, ERR_FORMAT, "%s: damaged: a directory makes no sense", from->name);
}

static enum err_code pmtiles_read_directory(const struct pmtiles_read_from *f,
                                            struct pmtiles_read_part at, int depth, struct err *e);

static bool pmtiles_read_within(const struct pmtiles_read_run *r,
                                const struct pmtiles_read_part *in)
{
    return r->size_bytes && r->at <= in->size && r->size_bytes <= in->size - r->at;
}

static enum err_code pmtiles_read_take(const struct pmtiles_read_from *f,
                                       const struct pmtiles_read_run *r, int depth, struct err *e)
{
    struct pmtiles_read *p = f->p;
    const struct pmtiles_read_part *in = r->run ? &p->data : &p->leaves;
    if (r->id < p->next || !pmtiles_read_within(r, in))
        return err_set(e, ERR_FORMAT,
                       "%s: damaged: tile %llu comes twice, or does not lie within the file",
                       f->from->name, (unsigned long long)r->id);
    if (!r->run)
        return pmtiles_read_directory(f, (struct pmtiles_read_part){in->at + r->at, r->size_bytes},
                                      depth + 1, e);
    if (p->n == PMTILES_READ_RUNS_MAX || r->size_bytes > PMTILES_READ_BYTES_MAX)
        return err_set(e, ERR_LIMIT, "%s: more than %d tiles, or one of more than %d MiB",
                       f->from->name, PMTILES_READ_RUNS_MAX, PMTILES_READ_BYTES_MAX >> 20);
    void *more = mem_room(p->run, p->n, &p->cap, 1024, sizeof *p->run);
    if (!more)
        return err_set(e, ERR_MEM, "%s: out of memory for %zu tiles", f->from->name, p->n);
    p->run = more;
    p->run[p->n] = *r;
    p->run[p->n++].at += in->at;
    p->tiles += r->run;
    p->next = r->id + r->run;
    p->largest = r->size_bytes > p->largest ? r->size_bytes : p->largest;
    return ERR_OK;
}

/* All that is in a directory and below it; at most PMTILES_READ_DEPTH deep. */
static enum err_code pmtiles_read_directory(const struct pmtiles_read_from *f,
                                            struct pmtiles_read_part at, int depth, struct err *e)
{
    struct buf b = {0};
    struct pmtiles_read_run *row = NULL;
    size_t n = 0;
    if (depth > PMTILES_READ_DEPTH)
        return err_set(e, ERR_FORMAT, "%s: damaged: directories lie too deep", f->from->name);
    const uint64_t before = f->p->next;
    const bool first = !f->p->n;
    enum err_code rc = pmtiles_read_part(f, at, PMTILES_READ_DIRECTORY, &b, e);
    if (!rc)
        rc = pmtiles_read_rows(f->from, &b, &row, &n, e);
    buf_free(&b);
    for (size_t i = 0; !rc && i < n; i++)
        rc = pmtiles_read_take(f, &row[i], depth, e);
    /* A leaf without tiles could be listed any number of times. */
    if (!rc && depth && (first ? !f->p->n : f->p->next == before))
        rc = err_set(e, ERR_FORMAT, "%s: damaged: a directory without tiles", f->from->name);
    mem_free(row);
    return rc;
}

/* ---- the head ---- */

static enum err_code pmtiles_read_kinds(const struct read_at *from, const uint8_t *kind,
                                        struct pmtiles_read *p, struct err *e)
{
    enum { UNKNOWN, NONE };
    struct pmtiles_about *a = &p->about;
    p->packing = kind[1];
    if (kind[1] != PMTILES_READ_PLAIN && kind[1] != PMTILES_READ_GZIP)
        return err_set(e, ERR_FORMAT,
                       "%s: its directories are compressed by a method that is not "
                       "gzip",
                       from->name);
    if (kind[3] != PMTILES_PNG && kind[3] != PMTILES_JPEG && kind[3] != PMTILES_WEBP)
        return err_set(e, ERR_FORMAT,
                       "%s: its tiles are no PNG, JPEG or WebP: only maps of "
                       "pictures are served",
                       from->name);
    if (kind[2] != UNKNOWN && kind[2] != NONE)
        return err_set(e, ERR_FORMAT, "%s: its tiles are compressed once more", from->name);
    a->type = (enum pmtiles_type)kind[3];
    a->zoom_min = kind[4];
    a->zoom_max = kind[5];
    return a->zoom_min <= a->zoom_max && a->zoom_max <= PMTILES_ZOOM_MAX
               ? ERR_OK
               : err_set(e, ERR_FORMAT, "%s: damaged: its zooms make no sense", from->name);
}

static enum err_code pmtiles_read_bounds(const struct read_at *from, struct cursor *c,
                                         struct pmtiles_about *a, struct err *e)
{
    for (int i = 0; i < 4; i++)
        a->bbox_deg[i] = (int32_t)cursor_u32(c) * 1e-7;
    a->zoom_center = cursor_u8(c);
    const double *b = a->bbox_deg;
    return b[0] >= -180 && b[1] >= -90 && b[0] <= b[2] && b[1] <= b[3] && b[2] <= 180 && b[3] <= 90
               ? ERR_OK
               : err_set(e, ERR_FORMAT, "%s: damaged: its bounds make no sense", from->name);
}

static enum err_code pmtiles_read_head(const struct pmtiles_read_from *f, struct err *e)
{
    uint8_t head[PMTILES_READ_HEAD] = {0};
    const struct read_at *from = f->from;
    struct pmtiles_read *p = f->p;
    struct pmtiles_read_part *const parts[] = {&p->root, &p->meta, &p->leaves, &p->data};
    if (from->size_bytes < sizeof head)
        return err_set(e, ERR_FORMAT, "%s: no PMTiles, or not all of it", from->name);
    enum err_code rc = from->read(from->user, 0, head, sizeof head, e);
    if (!rc && (memcmp(head, "PMTiles", 7) != 0 || head[7] != 3))
        rc = err_set(e, ERR_FORMAT, "%s: no PMTiles of version 3", from->name);
    if (rc)
        return rc;
    hash_add(f->hash, head, sizeof head);
    struct cursor c = cursor_over(head + 8, sizeof head - 8);
    for (size_t i = 0; i < 4; i++) {
        parts[i]->at = cursor_u64(&c);
        parts[i]->size = cursor_u64(&c);
        const uint64_t least = parts[i]->at + parts[i]->size;
        if (parts[i]->at > from->size_bytes || parts[i]->size > from->size_bytes - parts[i]->at)
            return err_set(e, ERR_FORMAT,
                           "%s: not all of it is there, or it is damaged: it should have %llu "
                           "bytes or more",
                           from->name, (unsigned long long)least);
    }
    (void)cursor_take(&c, 24); /* counts */
    const uint8_t *kinds = cursor_take(&c, 6);
    rc = pmtiles_read_kinds(from, kinds, p, e);
    return rc ? rc : pmtiles_read_bounds(from, &c, &p->about, e);
}

/* Tiles that are drawn otherwise may have the sizes of those before. */
static enum err_code pmtiles_read_sample(const struct pmtiles_read_from *f, struct err *e)
{
    const struct pmtiles_read_part *data = &f->p->data;
    const size_t n =
        data->size < PMTILES_READ_SAMPLE ? (size_t)data->size : (size_t)PMTILES_READ_SAMPLE;
    uint8_t *bytes = mem_uninit(n, 1);
    if (!bytes)
        return err_set(e, ERR_MEM, "%s: out of memory", f->from->name);
    enum err_code rc = n ? f->from->read(f->from->user, data->at, bytes, n, e) : ERR_OK;
    if (!rc)
        hash_add(f->hash, bytes, n);
    mem_free(bytes);
    return rc;
}

enum err_code pmtiles_read_open(const struct read_at *from, struct pmtiles_read **out,
                                struct err *e)
{
    struct pmtiles_read_from f = {from, hash_begin(), mem_array(1, sizeof *f.p)};
    struct pmtiles_read *p = *out = f.p;
    enum err_code rc = f.hash && p ? pmtiles_read_head(&f, e)
                                   : err_set(e, ERR_MEM, "%s: out of memory", from->name);
    if (!rc && p->meta.size)
        rc = pmtiles_read_part(&f, p->meta, PMTILES_READ_METADATA, &p->metadata, e);
    if (!rc) {
        buf_u8(&p->metadata, 0);
        rc = buf_check(&p->metadata, e);
    }
    if (!rc)
        rc = pmtiles_read_directory(&f, p->root, 0, e);
    if (!rc)
        rc = pmtiles_read_sample(&f, e);
    const struct hash128 hash = hash_end(f.hash);
    if (rc) {
        pmtiles_read_close(out);
        return rc;
    }
    p->about.metadata = (const char *)p->metadata.data;
    p->hash = hash;
    return ERR_OK;
}

void pmtiles_read_close(struct pmtiles_read **out)
{
    struct pmtiles_read *p = *out;
    *out = NULL;
    if (!p)
        return;
    mem_free(p->run);
    buf_free(&p->metadata);
    mem_free(p);
}

const struct pmtiles_about *pmtiles_read_about(const struct pmtiles_read *p)
{
    return &p->about;
}

struct hash128 pmtiles_read_hash(const struct pmtiles_read *p)
{
    return p->hash;
}

uint64_t pmtiles_read_count(const struct pmtiles_read *p)
{
    return p->tiles;
}

uint32_t pmtiles_read_largest(const struct pmtiles_read *p)
{
    return p->largest;
}

bool pmtiles_read_find(const struct pmtiles_read *p, uint64_t id, struct pmtiles_place *out)
{
    size_t lo = 0, hi = p->n; /* the last run that begins at id or before */
    while (lo < hi) {
        const size_t mid = lo + (hi - lo) / 2;
        if (p->run[mid].id <= id)
            lo = mid + 1;
        else
            hi = mid;
    }
    if (!lo || id - p->run[lo - 1].id >= p->run[lo - 1].run)
        return false;
    *out = (struct pmtiles_place){p->run[lo - 1].at, p->run[lo - 1].size_bytes};
    return true;
}
