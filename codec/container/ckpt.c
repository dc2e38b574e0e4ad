/* Checkpoints: one file with a JSON head, a set of Gaussians and named blobs, every part hashed
 * (XXH3-128).
 *
 *   0   "CSPLCKPT"   8  version u32   12 number of sections u32   16 bytes of the whole file u64
 *   24  hash of [0, 24) and the section table (lo, hi u64)   40  zeros to 64
 *   64  section table: per section { name[32], offset u64, size u64, hash lo u64, hash hi u64 }
 *   ... sections, each at a multiple of 64, zeros between
 *
 * Sections of our own begin with '#': #meta (JSON text), #gauss (counts and origin) and one per
 * array of the container; the others are the caller's. Little-endian. Reading loads the file once:
 * blobs point into that buffer, the Gaussians are copied into a container of their own.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <jansson.h>

#include "codec/container/ckpt.h"

#if __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "arrays are written as they lie in memory: a big-endian machine needs swapping here"
#endif

enum {
    CKPT_VERSION = 1,
    CKPT_HEAD = 64,
    CKPT_ENTRY = 64,
    CKPT_NAME = 32,
    CKPT_ALIGN = 64,
    CKPT_OWN = 8, /* #meta, #gauss and the six arrays */
    CKPT_SECTIONS_MAX = 4096,
    CKPT_GAUSS_BYTES = 48,
    CKPT_SLICE = 4096,    /* rows at a time */
    CKPT_PIECE = 1 << 22, /* bytes of a blob at a time */
};
static const char ckpt_magic[8] = {'C', 'S', 'P', 'L', 'C', 'K', 'P', 'T'};
static const size_t ckpt_limit_bytes = (size_t)64 << 30;

struct ckpt_entry {
    char name[CKPT_NAME];
    uint64_t offset, size;
    struct hash128 hash;
    const uint8_t *data;
};

static uint64_t ckpt_align(uint64_t n)
{
    return (n + CKPT_ALIGN - 1) / CKPT_ALIGN * CKPT_ALIGN;
}

/* The arrays of a container: where each one is and how many floats a row has. */
struct ckpt_array {
    const char *name;
    float *data;
    size_t per_row;
};
enum { CKPT_ARRAYS = 6 };

static void ckpt_arrays(const struct gauss *g, struct ckpt_array out[CKPT_ARRAYS])
{
    out[0] = (struct ckpt_array){"#mean_m", g->mean_m, 3};
    out[1] = (struct ckpt_array){"#scale_log", g->scale_log, 3};
    out[2] = (struct ckpt_array){"#quat_wxyz", g->quat_wxyz, 4};
    out[3] = (struct ckpt_array){"#opacity_logit", g->opacity_logit, 1};
    out[4] = (struct ckpt_array){"#sh", g->sh, 3 * gauss_sh_count(g->sh_degree)};
    out[5] = (struct ckpt_array){"#embed", g->embed, g->embed_len};
}

/* ---- writing ---- */

struct ckpt_writer {
    const char *path;
    FILE *f;
    const struct ckpt_source *from;
    struct ckpt_entry *t; /* [n]; offsets and hashes as far as sections are written */
    size_t n;
    float *rows; /* [CKPT_SLICE] of the array at hand */
    uint64_t at;
};

static enum err_code ckpt_plan(const char *path, const char *meta, const struct buf *head,
                               const struct ckpt_source *from, const struct ckpt_blob *blobs,
                               size_t n_blobs, struct ckpt_entry *t, struct err *e)
{
    struct ckpt_array arrays[CKPT_ARRAYS];
    ckpt_arrays(from->like, arrays);
    size_t k = 0;
    t[k++] =
        (struct ckpt_entry){.name = "#meta", .data = (const uint8_t *)meta, .size = strlen(meta)};
    t[k++] = (struct ckpt_entry){.name = "#gauss", .data = head->data, .size = head->size};
    for (size_t i = 0; i < CKPT_ARRAYS; i++, k++) {
        t[k].size = from->like->n * arrays[i].per_row * sizeof(float);
        memcpy(t[k].name, arrays[i].name, strlen(arrays[i].name) + 1);
    }
    for (size_t i = 0; i < n_blobs; i++, k++) {
        const char *name = blobs[i].name;
        if (!memchr(name, 0, CKPT_NAME) || !name[0] || name[0] == '#')
            return err_set(e, ERR_ARG, "ckpt_write: %s: blob %zu has no valid name", path, i);
        for (size_t j = 0; j < i; j++)
            if (!strcmp(name, blobs[j].name))
                return err_set(e, ERR_ARG, "ckpt_write: %s: two blobs named '%s'", path, name);
        t[k].data = blobs[i].data;
        t[k].size = blobs[i].size_bytes;
        memcpy(t[k].name, name, strlen(name) + 1);
    }
    return ERR_OK;
}

/* Head and section table of sections that are written. */
static void ckpt_table(const struct ckpt_writer *w, struct buf *out)
{
    struct buf body = {0};
    const struct ckpt_entry *t = w->t;
    buf_add(&body, ckpt_magic, sizeof ckpt_magic);
    buf_u32(&body, CKPT_VERSION);
    buf_u32(&body, (uint32_t)w->n);
    buf_u64(&body, w->at);
    for (size_t i = 0; i < w->n; i++) {
        buf_add(&body, t[i].name, CKPT_NAME);
        buf_u64(&body, t[i].offset);
        buf_u64(&body, t[i].size);
        buf_u64(&body, t[i].hash.lo);
        buf_u64(&body, t[i].hash.hi);
    }
    struct hash128 h = hash_bytes(body.data, body.size);
    static const uint8_t zeros[CKPT_HEAD - 40] = {0};
    buf_add(out, body.data, body.size < 24 ? body.size : 24);
    buf_u64(out, h.lo);
    buf_u64(out, h.hi);
    buf_add(out, zeros, sizeof zeros);
    if (body.size > 24)
        buf_add(out, body.data + 24, body.size - 24);
    out->failed = out->failed || body.failed;
    buf_free(&body);
}

static enum err_code ckpt_put(struct ckpt_writer *w, const void *bytes, size_t n, struct err *e)
{
    w->at += n;
    return n == 0 || fwrite(bytes, 1, n, w->f) == n
               ? ERR_OK
               : err_errno(e, ERR_IO, "ckpt_write: %s", w->path);
}

/* Zeros up to the next place where a section may begin. */
static enum err_code ckpt_pad(struct ckpt_writer *w, uint64_t to, struct err *e)
{
    static const uint8_t zeros[4096] = {0};
    enum err_code rc = ERR_OK;
    while (!rc && w->at < to)
        rc = ckpt_put(w, zeros, to - w->at < sizeof zeros ? (size_t)(to - w->at) : sizeof zeros, e);
    return rc;
}

/* An array of the Gaussians, slice by slice. */
static enum err_code ckpt_put_rows(struct ckpt_writer *w, enum ckpt_field field, size_t per_row,
                                   struct hash128 *hash, struct err *e)
{
    const struct ckpt_source *from = w->from;
    struct hash_state *h = hash_begin();
    enum err_code rc = h ? ERR_OK : err_set(e, ERR_MEM, "ckpt_write: %s: out of memory", w->path);
    for (size_t i = 0; !rc && per_row && i < from->like->n; i += CKPT_SLICE) {
        size_t n = from->like->n - i < CKPT_SLICE ? from->like->n - i : CKPT_SLICE;
        size_t bytes = n * per_row * sizeof(float);
        rc = from->rows(from->user, field, i, n, w->rows, e);
        if (!rc) {
            hash_add(h, w->rows, bytes);
            rc = ckpt_put(w, w->rows, bytes, e);
        }
    }
    *hash = hash_end(h);
    return rc;
}

/* What lies in memory already, in pieces. */
static enum err_code ckpt_put_blob(struct ckpt_writer *w, struct ckpt_entry *t, struct err *e)
{
    struct hash_state *h = hash_begin();
    enum err_code rc = h ? ERR_OK : err_set(e, ERR_MEM, "ckpt_write: %s: out of memory", w->path);
    for (size_t at = 0, n; !rc && at < t->size; at += n) {
        n = t->size - at < CKPT_PIECE ? (size_t)t->size - at : CKPT_PIECE;
        hash_add(h, (const uint8_t *)t->data + at, n);
        rc = ckpt_put(w, (const uint8_t *)t->data + at, n, e);
    }
    t->hash = hash_end(h);
    return rc;
}

static enum err_code ckpt_put_sections(struct ckpt_writer *w, struct err *e)
{
    struct ckpt_array arrays[CKPT_ARRAYS];
    ckpt_arrays(w->from->like, arrays);
    enum err_code rc = ERR_OK;
    w->at = 0;
    uint64_t begin = ckpt_align(CKPT_HEAD + w->n * CKPT_ENTRY);
    for (size_t i = 0; !rc && i < w->n; i++) {
        struct ckpt_entry *t = &w->t[i];
        size_t array = i - (CKPT_OWN - CKPT_ARRAYS); /* wraps round before them */
        rc = ckpt_pad(w, i ? ckpt_align(w->at) : begin, e);
        t->offset = w->at;
        if (!rc && array < CKPT_ARRAYS) {
            rc = ckpt_put_rows(w, (enum ckpt_field)array, arrays[array].per_row, &t->hash, e);
        } else if (!rc) {
            rc = ckpt_put_blob(w, t, e);
        }
    }
    return rc;
}

/* The table comes last, into the room left for it: nothing has to be gone through twice. */
static enum err_code ckpt_put_all(struct ckpt_writer *w, struct err *e)
{
    struct buf table = {0};
    enum err_code rc = ckpt_put_sections(w, e);
    if (!rc) {
        ckpt_table(w, &table);
        rc = buf_check(&table, e);
    }
    if (!rc && (fseek(w->f, 0, SEEK_SET) || fwrite(table.data, 1, table.size, w->f) != table.size ||
                fflush(w->f)))
        rc = err_errno(e, ERR_IO, "ckpt_write: %s", w->path);
    buf_free(&table);
    return rc;
}

static enum err_code ckpt_put_file(struct ckpt_writer *w, struct err *e)
{
    char part[FILE_PATH_MAX];
    enum err_code rc = file_begin(w->path, part, e);
    if (rc)
        return rc;
    w->f = fopen(part, "wb");
    if (!w->f)
        return err_errno(e, ERR_IO, "ckpt_write: %s: cannot create", w->path);
    rc = ckpt_put_all(w, e);
    if (fclose(w->f) && !rc)
        rc = err_errno(e, ERR_IO, "ckpt_write: %s: cannot close", w->path);
    if (rc) {
        file_abort(part);
        return rc;
    }
    return file_commit(part, w->path, e);
}

enum err_code ckpt_write_from(const char *path, const struct json_t *meta,
                              const struct ckpt_source *from, const struct ckpt_blob *blobs,
                              size_t n_blobs, struct err *e)
{
    const struct gauss *g = from->like;
    struct ckpt_writer w = {.path = path, .from = from, .n = CKPT_OWN + n_blobs};
    enum err_code rc = ERR_MEM;
    struct buf head = {0};
    char *text = NULL;
    if (!json_is_object(meta))
        return err_set(e, ERR_ARG, "ckpt_write: %s: the metadata must be a JSON object", path);
    if (n_blobs > CKPT_SECTIONS_MAX - CKPT_OWN)
        return err_set(e, ERR_LIMIT, "ckpt_write: %s: %zu blobs, at most %d", path, n_blobs,
                       CKPT_SECTIONS_MAX - CKPT_OWN);
    struct ckpt_array arrays[CKPT_ARRAYS];
    size_t widest = 0;
    ckpt_arrays(g, arrays);
    for (size_t i = 0; i < CKPT_ARRAYS; i++)
        widest = arrays[i].per_row > widest ? arrays[i].per_row : widest;
    text = json_dumps(meta, JSON_REAL_PRECISION(17) | JSON_COMPACT);
    w.t = mem_array(w.n, sizeof *w.t);
    w.rows = mem_array(g->n < CKPT_SLICE ? g->n : CKPT_SLICE, widest * sizeof(float));
    buf_u64(&head, g->n);
    buf_u32(&head, g->sh_degree);
    buf_u32(&head, g->embed_len);
    buf_u32(&head, g->antialiased);
    buf_u32(&head, 0);
    for (int i = 0; i < 3; i++)
        buf_f64(&head, g->origin_enu_m[i]);
    if (!text || !w.t || !w.rows || head.failed)
        err_set(e, ERR_MEM, "ckpt_write: %s: out of memory", path);
    else
        rc = ckpt_plan(path, text, &head, from, blobs, n_blobs, w.t, e);
    if (!rc)
        rc = ckpt_put_file(&w, e);
    free(text); /* jansson's, made with malloc */
    mem_free(w.t);
    mem_free(w.rows);
    buf_free(&head);
    return rc;
}

static enum err_code ckpt_copy_rows(void *user, enum ckpt_field field, size_t first, size_t n,
                                    float *out, struct err *e)
{
    struct ckpt_array arrays[CKPT_ARRAYS];
    (void)e;
    ckpt_arrays(user, arrays);
    const struct ckpt_array *a = &arrays[field];
    memcpy(out, a->data + first * a->per_row, n * a->per_row * sizeof(float));
    return ERR_OK;
}

enum err_code ckpt_write(const char *path, const struct json_t *meta, const struct gauss *g,
                         const struct ckpt_blob *blobs, size_t n_blobs, struct err *e)
{
    struct gauss all = *g;
    struct ckpt_source from = {.like = g, .rows = ckpt_copy_rows, .user = &all};
    return ckpt_write_from(path, meta, &from, blobs, n_blobs, e);
}

/* ---- reading ---- */

static enum err_code ckpt_bad(const char *path, const char *why, struct err *e)
{
    return err_set(e, ERR_FORMAT, "%s: %s", path, why);
}

/* Check the head and the table and list the sections; `head` begins the file of `file_size` bytes
 * and holds at least them. The caller frees *out, also after an error. */
static enum err_code ckpt_read_table(const char *path, const struct buf *head, uint64_t file_size,
                                     struct ckpt_entry **out, size_t *n_out, struct err *e)
{
    if (head->size < CKPT_HEAD || memcmp(head->data, ckpt_magic, sizeof ckpt_magic))
        return ckpt_bad(path, "not a checkpoint of citysplat", e);
    struct cursor c = cursor_over(head->data + 8, head->size - 8);
    uint32_t version = cursor_u32(&c), n = cursor_u32(&c);
    uint64_t bytes = cursor_u64(&c);
    struct hash128 want = {.lo = cursor_u64(&c)};
    want.hi = cursor_u64(&c);
    if (version != CKPT_VERSION)
        return err_set(e, ERR_FORMAT, "%s: checkpoint version %u, this program reads %d", path,
                       version, CKPT_VERSION);
    if (bytes != file_size)
        return err_set(e, ERR_FORMAT, "%s: %s: %llu bytes, the head says %llu", path,
                       file_size < bytes ? "truncated" : "damaged", (unsigned long long)file_size,
                       (unsigned long long)bytes);
    if (n < CKPT_OWN || n > CKPT_SECTIONS_MAX || (head->size - CKPT_HEAD) / CKPT_ENTRY < n)
        return ckpt_bad(path, "damaged: impossible number of sections", e);
    size_t table = (size_t)n * CKPT_ENTRY;
    struct buf body = {0};
    buf_add(&body, head->data, 24);
    buf_add(&body, head->data + CKPT_HEAD, table);
    struct hash128 got = body.failed ? (struct hash128){0} : hash_bytes(body.data, body.size);
    struct ckpt_entry *t = mem_array(n, sizeof *t);
    bool no_memory = body.failed || !t;
    buf_free(&body);
    *out = t;
    *n_out = n;
    if (no_memory)
        return err_set(e, ERR_MEM, "%s: out of memory", path);
    if (got.lo != want.lo || got.hi != want.hi)
        return ckpt_bad(path, "damaged: the hash of the section table differs", e);
    c = cursor_over(head->data + CKPT_HEAD, table);
    for (size_t i = 0; i < n; i++) {
        memcpy(t[i].name, cursor_take(&c, CKPT_NAME), CKPT_NAME);
        t[i].offset = cursor_u64(&c);
        t[i].size = cursor_u64(&c);
        t[i].hash.lo = cursor_u64(&c);
        t[i].hash.hi = cursor_u64(&c);
        if (!memchr(t[i].name, 0, CKPT_NAME) || !t[i].name[0])
            return ckpt_bad(path, "damaged: a section without a name", e);
        if (t[i].offset % CKPT_ALIGN || t[i].offset > file_size ||
            t[i].size > file_size - t[i].offset)
            return err_set(e, ERR_FORMAT, "%s: damaged: section '%s' lies outside the file", path,
                           t[i].name);
    }
    return ERR_OK;
}

static enum err_code ckpt_check_sections(const char *path, const struct buf *file,
                                         struct ckpt_entry *t, size_t n, struct err *e)
{
    for (size_t i = 0; i < n; i++) {
        t[i].data = file->data + t[i].offset;
        struct hash128 h = hash_bytes(t[i].data, (size_t)t[i].size);
        if (h.lo != t[i].hash.lo || h.hi != t[i].hash.hi)
            return err_set(e, ERR_FORMAT, "%s: damaged: the hash of section '%s' differs", path,
                           t[i].name);
    }
    return ERR_OK;
}

static const struct ckpt_entry *ckpt_section(const struct ckpt_entry *t, size_t n, const char *name)
{
    for (size_t i = 0; i < n; i++)
        if (!strcmp(t[i].name, name))
            return &t[i];
    return NULL;
}

/* Counts, degrees and origin; no arrays. `head` is the section '#gauss'. */
static enum err_code ckpt_read_counts(const char *path, const struct ckpt_entry *t, size_t n,
                                      const uint8_t *head, struct gauss *g, struct err *e)
{
    struct cursor c = cursor_over(head, CKPT_GAUSS_BYTES);
    uint64_t rows = cursor_u64(&c);
    g->sh_degree = cursor_u32(&c);
    g->embed_len = cursor_u32(&c);
    g->antialiased = cursor_u32(&c) != 0;
    (void)cursor_u32(&c);
    for (int i = 0; i < 3; i++)
        g->origin_enu_m[i] = cursor_f64(&c);
    const struct ckpt_entry *opacity = ckpt_section(t, n, "#opacity_logit");
    if (!opacity || rows > opacity->size / sizeof(float))
        return ckpt_bad(path, "damaged: fewer Gaussians than the head says", e);
    if (g->sh_degree > GAUSS_SH_DEGREE_MAX || g->embed_len > GAUSS_EMBED_MAX)
        return ckpt_bad(path, "damaged: impossible SH degree or embedding", e);
    g->n = (size_t)rows;
    struct ckpt_array arrays[CKPT_ARRAYS];
    ckpt_arrays(g, arrays);
    for (size_t i = 0; i < CKPT_ARRAYS; i++) {
        const struct ckpt_entry *s = ckpt_section(t, n, arrays[i].name);
        if (!s || s->size != g->n * arrays[i].per_row * sizeof(float))
            return err_set(e, ERR_FORMAT, "%s: damaged: section '%s' does not hold %zu rows", path,
                           arrays[i].name, g->n);
    }
    return ERR_OK;
}

static enum err_code ckpt_read_gauss(const char *path, const struct ckpt_entry *t, size_t n,
                                     struct gauss *g, struct err *e)
{
    const struct ckpt_entry *s = ckpt_section(t, n, "#gauss");
    struct gauss head = {0};
    if (!s || s->size != CKPT_GAUSS_BYTES)
        return ckpt_bad(path, "damaged: section '#gauss' is missing or too short", e);
    enum err_code rc = ckpt_read_counts(path, t, n, s->data, &head, e);
    if (!rc)
        rc = gauss_alloc(g, head.n, head.sh_degree, head.embed_len, e);
    if (rc)
        return rc;
    g->n = head.n;
    g->antialiased = head.antialiased;
    memcpy(g->origin_enu_m, head.origin_enu_m, sizeof g->origin_enu_m);
    struct ckpt_array arrays[CKPT_ARRAYS];
    ckpt_arrays(g, arrays);
    for (size_t i = 0; i < CKPT_ARRAYS; i++) {
        s = ckpt_section(t, n, arrays[i].name);
        if (s->size)
            memcpy(arrays[i].data, s->data, (size_t)s->size);
    }
    return ERR_OK;
}

static enum err_code ckpt_read_rest(const char *path, const struct ckpt_entry *t, size_t n,
                                    struct ckpt *out, struct err *e)
{
    const struct ckpt_entry *meta = ckpt_section(t, n, "#meta");
    if (!meta)
        return ckpt_bad(path, "damaged: section '#meta' is missing", e);
    enum err_code rc =
        jsonc_parse((const char *)meta->data, (size_t)meta->size, path, &out->meta, e);
    if (rc)
        return rc;
    if (!json_is_object(out->meta))
        return ckpt_bad(path, "damaged: the metadata is not an object", e);
    rc = ckpt_read_gauss(path, t, n, &out->g, e);
    if (rc)
        return rc;
    out->blobs = mem_array(n, sizeof *out->blobs);
    if (!out->blobs)
        return err_set(e, ERR_MEM, "%s: out of memory", path);
    for (size_t i = 0; i < n; i++) {
        if (t[i].name[0] == '#')
            continue;
        struct ckpt_blob *b = &out->blobs[out->n_blobs++];
        memcpy(b->name, t[i].name, CKPT_NAME);
        b->data = t[i].data;
        b->size_bytes = (size_t)t[i].size;
    }
    return ERR_OK;
}

enum err_code ckpt_read(const char *path, struct ckpt *out, struct err *e)
{
    struct ckpt_entry *t = NULL;
    size_t n = 0;
    *out = (struct ckpt){0};
    enum err_code rc = file_read(path, ckpt_limit_bytes, &out->file, e);
    if (!rc)
        rc = ckpt_read_table(path, &out->file, out->file.size, &t, &n, e);
    if (!rc)
        rc = ckpt_check_sections(path, &out->file, t, n, e);
    if (!rc)
        rc = ckpt_read_rest(path, t, n, out, e);
    mem_free(t);
    if (rc)
        ckpt_free(out);
    return rc;
}

const struct ckpt_blob *ckpt_find(const struct ckpt *c, const char *name)
{
    for (size_t i = 0; i < c->n_blobs; i++)
        if (!strcmp(c->blobs[i].name, name))
            return &c->blobs[i];
    return NULL;
}

void ckpt_free(struct ckpt *c)
{
    json_decref(c->meta);
    gauss_free(&c->g);
    mem_free(c->blobs);
    buf_free(&c->file);
    *c = (struct ckpt){0};
}

/* ---- reading by the slice ---- */

struct ckpt_rows {
    char path[FILE_PATH_MAX];
    int fd;
    struct gauss head; /* counts only */
    struct ckpt_entry *entry;
    size_t n_entries;
};

static enum err_code ckpt_verify_section(const struct ckpt_rows *r, const struct ckpt_entry *t,
                                         struct err *e)
{
    enum { BLOCK = 1 << 20 };
    uint8_t *block = mem_array(BLOCK, 1);
    struct hash_state *h = hash_begin();
    enum err_code rc = block && h ? ERR_OK : err_set(e, ERR_MEM, "%s: out of memory", r->path);
    for (uint64_t at = 0; !rc && at < t->size; at += BLOCK) {
        size_t n = t->size - at < BLOCK ? (size_t)(t->size - at) : BLOCK;
        rc = file_read_at(r->fd, r->path, block, n, t->offset + at, e);
        if (!rc)
            hash_add(h, block, n);
    }
    struct hash128 got = hash_end(h);
    if (!rc && (got.lo != t->hash.lo || got.hi != t->hash.hi))
        rc = err_set(e, ERR_FORMAT, "%s: damaged: the hash of section '%s' differs", r->path,
                     t->name);
    mem_free(block);
    return rc;
}

static enum err_code ckpt_open_head(struct ckpt_rows *r, struct err *e)
{
    struct buf head = {0};
    struct stat st;
    uint8_t counts[CKPT_GAUSS_BYTES];
    if (fstat(r->fd, &st))
        return err_errno(e, ERR_IO, "%s", r->path);
    size_t most = CKPT_HEAD + (size_t)CKPT_SECTIONS_MAX * CKPT_ENTRY, size = (size_t)st.st_size;
    size_t n = size < most ? size : most;
    uint8_t *p = buf_grow(&head, n);
    enum err_code rc = buf_check(&head, e);
    if (!rc)
        rc = file_read_at(r->fd, r->path, p, n, 0, e);
    if (!rc)
        rc = ckpt_read_table(r->path, &head, size, &r->entry, &r->n_entries, e);
    buf_free(&head);
    const struct ckpt_entry *s = rc ? NULL : ckpt_section(r->entry, r->n_entries, "#gauss");
    if (!rc && (!s || s->size != CKPT_GAUSS_BYTES))
        rc = ckpt_bad(r->path, "damaged: section '#gauss' is missing or too short", e);
    if (!rc)
        rc = file_read_at(r->fd, r->path, counts, sizeof counts, s->offset, e);
    if (!rc)
        rc = ckpt_read_counts(r->path, r->entry, r->n_entries, counts, &r->head, e);
    for (size_t i = 0; !rc && i < r->n_entries; i++)
        if (r->entry[i].name[0] == '#')
            rc = ckpt_verify_section(r, &r->entry[i], e);
    return rc;
}

enum err_code ckpt_rows_open(const char *path, struct ckpt_rows **out, struct err *e)
{
    struct ckpt_rows *r = mem_array(1, sizeof *r);
    *out = NULL;
    if (!r)
        return err_set(e, ERR_MEM, "%s: out of memory", path);
    snprintf(r->path, sizeof r->path, "%s", path);
    r->fd = open(path, O_RDONLY | O_CLOEXEC);
    enum err_code rc = r->fd < 0 ? err_errno(e, errno == ENOENT ? ERR_NOENT : ERR_IO, "%s", path)
                                 : ckpt_open_head(r, e);
    if (rc)
        ckpt_rows_close(&r);
    *out = r;
    return rc;
}

size_t ckpt_rows_count(const struct ckpt_rows *r)
{
    return r->head.n;
}

const struct gauss *ckpt_rows_like(const struct ckpt_rows *r)
{
    return &r->head;
}

enum err_code ckpt_rows_meta(const struct ckpt_rows *r, struct json_t **out, struct err *e)
{
    struct buf text = {0};
    *out = NULL;
    enum err_code rc = ckpt_rows_blob(r, "#meta", &text, e);
    if (!rc && !text.data)
        rc = ckpt_bad(r->path, "damaged: section '#meta' is missing", e);
    if (!rc)
        rc = jsonc_parse((const char *)text.data, text.size, r->path, out, e);
    if (!rc && !json_is_object(*out))
        rc = ckpt_bad(r->path, "damaged: the metadata is not an object", e);
    buf_free(&text);
    return rc;
}

enum err_code ckpt_rows_read(const struct ckpt_rows *r, size_t from, size_t n, struct gauss *out,
                             struct err *e)
{
    *out = (struct gauss){0};
    if (from > r->head.n || n > r->head.n - from)
        return err_set(e, ERR_ARG, "%s: rows %zu to %zu of %zu", r->path, from, from + n,
                       r->head.n);
    enum err_code rc = gauss_alloc(out, n, r->head.sh_degree, r->head.embed_len, e);
    if (rc)
        return rc;
    out->n = n;
    out->antialiased = r->head.antialiased;
    memcpy(out->origin_enu_m, r->head.origin_enu_m, sizeof out->origin_enu_m);
    struct ckpt_array arrays[CKPT_ARRAYS];
    ckpt_arrays(out, arrays);
    for (size_t i = 0; !rc && i < CKPT_ARRAYS; i++) {
        const struct ckpt_entry *s = ckpt_section(r->entry, r->n_entries, arrays[i].name);
        size_t row = arrays[i].per_row * sizeof(float);
        rc = file_read_at(r->fd, r->path, arrays[i].data, n * row, s->offset + from * row, e);
    }
    if (rc)
        gauss_free(out);
    return rc;
}

/* A section's bytes to where there is room for them, against its hash. */
static enum err_code ckpt_read_section(const struct ckpt_rows *r, const struct ckpt_entry *s,
                                       uint8_t *out, struct err *e)
{
    struct hash_state *h = hash_begin();
    enum err_code rc = h ? ERR_OK : err_set(e, ERR_MEM, "%s: out of memory", r->path);
    for (size_t at = 0, n; !rc && at < s->size; at += n) {
        n = s->size - at < CKPT_PIECE ? (size_t)s->size - at : CKPT_PIECE;
        rc = file_read_at(r->fd, r->path, out + at, n, s->offset + at, e);
        hash_add(h, out + at, rc ? 0 : n);
    }
    const struct hash128 got = hash_end(h);
    if (!rc && (got.lo != s->hash.lo || got.hi != s->hash.hi))
        rc = err_set(e, ERR_FORMAT, "%s: damaged: the hash of section '%s' differs", r->path,
                     s->name);
    return rc;
}

enum err_code ckpt_rows_blob(const struct ckpt_rows *r, const char *name, struct buf *out,
                             struct err *e)
{
    const struct ckpt_entry *s = ckpt_section(r->entry, r->n_entries, name);
    if (!s)
        return ERR_OK;
    uint8_t *to = buf_grow(out, s->size);
    enum err_code rc = to ? ckpt_read_section(r, s, to, e)
                          : err_set(e, ERR_MEM, "%s: out of memory for '%s'", r->path, name);
    if (rc)
        buf_free(out);
    return rc;
}

bool ckpt_rows_has(const struct ckpt_rows *r, const char *name)
{
    return ckpt_section(r->entry, r->n_entries, name) != NULL;
}

enum err_code ckpt_rows_blob_to(const struct ckpt_rows *r, const char *name, void *out,
                                size_t n_bytes, struct err *e)
{
    const struct ckpt_entry *s = ckpt_section(r->entry, r->n_entries, name);
    if (!s || s->size != n_bytes)
        return err_set(e, ERR_FORMAT, "%s: '%s' does not hold %zu bytes", r->path, name, n_bytes);
    return ckpt_read_section(r, s, out, e);
}

void ckpt_rows_close(struct ckpt_rows **rp)
{
    struct ckpt_rows *r = *rp;
    if (!r)
        return;
    if (r->fd >= 0)
        close(r->fd);
    mem_free(r->entry);
    mem_free(r);
    *rp = NULL;
}
