/* The file of a remote object: its table is mapped, its blocks are read and written.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#define _GNU_SOURCE // NOLINT(cert-dcl51-cpp): fallocate
#include "lod/store/blocks.h"

#include <assert.h>
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "core/math/sort.h"

enum { BLOCKS_VERSION = 1, BLOCKS_HEAD = 4096, BLOCKS_FORGET_S = 30 * 86400, BLOCKS_TOUCH_S = 60 };
static const char blocks_magic[8] = "CSBLOCKS", blocks_end[] = ".blocks";

struct blocks_head {
    char magic[8];
    uint32_t version, block_bytes;
    uint64_t size_bytes, n, data_at;
    _Atomic uint64_t down_until_ms; /* of the system's clock */
    _Atomic uint64_t present;       /* filled slots, about */
    _Atomic uint64_t limit_bytes;
    _Atomic uint32_t changed;
    char etag[RANGE_TAG_MAX], modified[RANGE_DATE_MAX], url[RANGE_URL_MAX];
};
static_assert(sizeof(struct blocks_head) <= BLOCKS_HEAD, "the table follows");

struct blocks_slot {
    _Atomic uint64_t hash; /* of the bytes; 0: empty */
    _Atomic uint32_t used_s, spare;
};

struct blocks {
    int fd;
    struct blocks_head *head; /* mapped, with the table */
    struct blocks_slot *slot; /* [n] */
    uint64_t n, data_at;
    struct range_object object;
    char url[RANGE_URL_MAX];
};

static struct {
    char dir[FILE_PATH_MAX]; /* "": not configured */
    uint64_t limit;
} blocks_where = {.limit = (uint64_t)4 << 30};

void blocks_configure(const char *dir, uint64_t limit_bytes)
{
    snprintf(blocks_where.dir, sizeof blocks_where.dir, "%s", dir ? dir : "");
    blocks_where.limit = limit_bytes;
}

static uint64_t blocks_now_ms(void)
{
    struct timespec t;
    (void)clock_gettime(CLOCK_REALTIME, &t);
    return (uint64_t)t.tv_sec * 1000 + (uint64_t)t.tv_nsec / 1000000;
}

static uint64_t blocks_table_end(uint64_t n)
{
    const uint64_t end = BLOCKS_HEAD + n * sizeof(struct blocks_slot);
    return (end + BLOCKS_HEAD - 1) / BLOCKS_HEAD * BLOCKS_HEAD;
}

static uint64_t blocks_count(uint64_t size_bytes)
{
    return (size_bytes + BLOCKS_BYTES - 1) / BLOCKS_BYTES;
}

/* ---- making ---- */

static bool blocks_folder(char dir[FILE_PATH_MAX])
{
    const char *xdg = getenv("XDG_CACHE_HOME"), *home = getenv("HOME");
    int n = -1;
    if (blocks_where.dir[0])
        n = snprintf(dir, FILE_PATH_MAX, "%s", blocks_where.dir);
    else if (xdg && *xdg == '/')
        n = snprintf(dir, FILE_PATH_MAX, "%s/citysplat/stores", xdg);
    else if (home && *home == '/')
        n = snprintf(dir, FILE_PATH_MAX, "%s/.cache/citysplat/stores", home);
    if (n < 0 || n >= FILE_PATH_MAX - 128 || file_mkdir(dir, NULL))
        return false;
    return access(dir, W_OK | X_OK) == 0;
}

/* Of the address, and of the state: a name is both. A signature in the address changes, while the
 * object does not. */
static void blocks_name(const char *url, const struct range_object *o, char out[80])
{
    char shown[RANGE_URL_MAX], of[33], state[33];
    struct buf b = {0};
    range_show(url, shown);
    hash_text(hash_bytes(shown, strlen(shown)), of);
    buf_printf(&b, "%s\n%s\n%llu", o->etag, o->etag[0] ? "" : o->modified,
               (unsigned long long)o->size_bytes);
    hash_text(hash_bytes(b.data, b.size), state);
    buf_free(&b);
    snprintf(out, 80, "%.16s-%.16s%s", of, state, blocks_end);
}

/* Other states of the object, and what nobody has opened for a month. Who has one open keeps it. */
static void blocks_tidy(const char *dir, const char *keep)
{
    DIR *d = opendir(dir);
    const size_t tail = strlen(blocks_end);
    for (struct dirent *f; d && (f = readdir(d));) {
        struct stat st;
        const size_t n = strlen(f->d_name);
        if (n < tail || strcmp(f->d_name + n - tail, blocks_end) || !strcmp(f->d_name, keep) ||
            fstatat(dirfd(d), f->d_name, &st, AT_SYMLINK_NOFOLLOW) || !S_ISREG(st.st_mode))
            continue;
        if (!strncmp(f->d_name, keep, 17) || time(NULL) - st.st_mtime > BLOCKS_FORGET_S)
            (void)unlinkat(dirfd(d), f->d_name, 0);
    }
    if (d)
        closedir(d);
}

/* The table is given its room now: a mapped page that finds the disk full ends the program. */
static enum err_code blocks_write_head(int fd, const char *url, const struct range_object *o,
                                       struct err *e)
{
    static const struct blocks_head zero;
    struct blocks_head h = zero;
    memcpy(h.magic, blocks_magic, sizeof h.magic);
    h.version = BLOCKS_VERSION;
    h.block_bytes = BLOCKS_BYTES;
    h.size_bytes = o->size_bytes;
    h.n = blocks_count(o->size_bytes);
    h.data_at = blocks_table_end(h.n);
    atomic_init(&h.limit_bytes, blocks_where.limit);
    snprintf(h.etag, sizeof h.etag, "%s", o->etag);
    snprintf(h.modified, sizeof h.modified, "%s", o->modified);
    snprintf(h.url, sizeof h.url, "%s", url);
    errno = posix_fallocate(fd, 0, (off_t)h.data_at);
    if (errno || ftruncate(fd, (off_t)(h.data_at + h.n * BLOCKS_BYTES)) ||
        pwrite(fd, &h, sizeof h, 0) != (ssize_t)sizeof h)
        return err_errno(e, ERR_IO, "no room for the table of a remote store");
    return ERR_OK;
}

static enum err_code blocks_make_unnamed(const char *url, const struct range_object *o, int *fd,
                                         struct err *e)
{
    char path[FILE_PATH_MAX];
    const char *in = getenv("TMPDIR");
    const int n =
        snprintf(path, sizeof path, "%s/citysplat-blocks-XXXXXX", in && *in ? in : "/tmp");
    if (n < 0 || (size_t)n >= sizeof path)
        return err_set(e, ERR_LIMIT, "TMPDIR: the path is too long");
    *fd = mkostemp(path, O_CLOEXEC);
    if (*fd < 0)
        return err_errno(e, ERR_IO, "%s: no file for what is read of a remote store", path);
    (void)unlink(path);
    return blocks_write_head(*fd, url, o, e);
}

/* The file of that name if it is whole and of this object; else -1. */
static int blocks_find(const char *path, const char *url, const struct range_object *o)
{
    struct blocks *b = NULL;
    int fd = open(path, O_RDWR | O_CLOEXEC | O_NOFOLLOW);
    if (fd < 0)
        return -1;
    bool same = !blocks_attach(fd, &b, NULL) && b->object.size_bytes == o->size_bytes &&
                !strcmp(b->object.etag, o->etag) &&
                (o->etag[0] || !strcmp(b->object.modified, o->modified));
    if (same && strcmp(b->url, url)) /* with another signature */
        snprintf(b->head->url, sizeof b->head->url, "%s", url);
    if (same)
        atomic_store(&b->head->limit_bytes, blocks_where.limit);
    blocks_detach(&b);
    if (same)
        (void)futimens(fd, NULL);
    else
        close(fd);
    return same ? fd : -1;
}

enum err_code blocks_make(const char *url, const struct range_object *o, int *fd, struct err *e)
{
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], part[FILE_PATH_MAX], name[80];
    *fd = -1;
    blocks_name(url, o, name);
    enum err_code rc = ERR_OK;
    if (!blocks_folder(dir) || file_join(path, dir, name, NULL)) {
        rc = blocks_make_unnamed(url, o, fd, e);
        goto out;
    }
    blocks_tidy(dir, name);
    if ((*fd = blocks_find(path, url, o)) >= 0)
        return ERR_OK;
    const int n = snprintf(part, sizeof part, "%s/new-XXXXXX", dir);
    *fd = n > 0 && (size_t)n < sizeof part ? mkostemp(part, O_CLOEXEC) : -1;
    if (*fd < 0)
        return err_errno(e, ERR_IO, "%s: no file for what is read of a remote store", dir);
    rc = blocks_write_head(*fd, url, o, e);
    if (!rc && rename(part, path))
        rc = err_errno(e, ERR_IO, "%s", path);
    if (rc)
        (void)unlink(part);
out:
    if (rc && *fd >= 0) {
        close(*fd);
        *fd = -1;
    }
    return rc;
}

/* ---- using ---- */

static bool blocks_head_ok(const struct blocks_head *h, uint64_t file_bytes)
{
    return !memcmp(h->magic, blocks_magic, sizeof h->magic) && h->version == BLOCKS_VERSION &&
           h->block_bytes == BLOCKS_BYTES && h->size_bytes && h->n == blocks_count(h->size_bytes) &&
           h->n < UINT32_MAX && h->data_at == blocks_table_end(h->n) &&
           h->data_at + h->n * BLOCKS_BYTES == file_bytes && memchr(h->url, 0, sizeof h->url) &&
           memchr(h->etag, 0, sizeof h->etag) && memchr(h->modified, 0, sizeof h->modified) &&
           range_is_url(h->url);
}

bool blocks_is(int fd)
{
    char magic[sizeof blocks_magic];
    return pread(fd, magic, sizeof magic, 0) == (ssize_t)sizeof magic &&
           !memcmp(magic, blocks_magic, sizeof magic);
}

enum err_code blocks_attach(int fd, struct blocks **out, struct err *e)
{
    struct stat st;
    struct blocks_head h;
    *out = NULL;
    if (fstat(fd, &st) || !S_ISREG(st.st_mode) || pread(fd, &h, sizeof h, 0) != (ssize_t)sizeof h ||
        !blocks_head_ok(&h, (uint64_t)st.st_size))
        return err_set(e, ERR_FORMAT, "not the file of a remote store");
    struct blocks *b = mem_array(1, sizeof *b);
    if (!b)
        return err_set(e, ERR_MEM, "out of memory for a remote store");
    b->n = h.n;
    b->data_at = h.data_at;
    b->object.size_bytes = h.size_bytes;
    memcpy(b->object.etag, h.etag, sizeof h.etag);
    memcpy(b->object.modified, h.modified, sizeof h.modified);
    memcpy(b->url, h.url, sizeof h.url);
    enum err_code rc = ERR_OK;
    void *map = MAP_FAILED;
    b->fd = fcntl(fd, F_DUPFD_CLOEXEC, 3);
    if (b->fd < 0 ||
        (map = mmap(NULL, b->data_at, PROT_READ | PROT_WRITE, MAP_SHARED, b->fd, 0)) == MAP_FAILED)
        rc = err_errno(e, ERR_IO, "the file of a remote store cannot be mapped");
    b->head = map == MAP_FAILED ? NULL : map;
    if (b->head)
        b->slot = (struct blocks_slot *)((uint8_t *)map + BLOCKS_HEAD);
    *out = b;
    if (rc)
        blocks_detach(out);
    return rc;
}

void blocks_detach(struct blocks **out)
{
    struct blocks *b = *out;
    *out = NULL;
    if (!b)
        return;
    if (b->head)
        (void)munmap(b->head, b->data_at);
    if (b->fd >= 0)
        close(b->fd);
    mem_free(b);
}

const char *blocks_url(const struct blocks *b)
{
    return b->url;
}

const struct range_object *blocks_object(const struct blocks *b)
{
    return &b->object;
}

bool blocks_has(const struct blocks *b, uint64_t i)
{
    return atomic_load_explicit(&b->slot[i].hash, memory_order_acquire) != 0;
}

size_t blocks_size(const struct blocks *b, uint64_t i)
{
    const uint64_t at = i * BLOCKS_BYTES, left = b->object.size_bytes - at;
    return left < BLOCKS_BYTES ? (size_t)left : BLOCKS_BYTES;
}

static uint64_t blocks_hash(const uint8_t *bytes, size_t n)
{
    return hash_bytes(bytes, n).lo | 1; /* 0 is an empty slot */
}

bool blocks_get(struct blocks *b, uint64_t i, uint8_t *out)
{
    const size_t n = blocks_size(b, i);
    struct blocks_slot *s = &b->slot[i];
    uint64_t hash = atomic_load_explicit(&s->hash, memory_order_acquire);
    if (!hash)
        return false;
    if (pread(b->fd, out, n, (off_t)(b->data_at + i * BLOCKS_BYTES)) != (ssize_t)n ||
        blocks_hash(out, n) != hash) {
        atomic_compare_exchange_strong(&s->hash, &hash, 0);
        return false;
    }
    const uint32_t now_s = (uint32_t)time(NULL);
    if (now_s - atomic_load_explicit(&s->used_s, memory_order_relaxed) > BLOCKS_TOUCH_S)
        atomic_store_explicit(&s->used_s, now_s, memory_order_relaxed);
    return true;
}

static void blocks_drop(struct blocks *b, uint64_t i)
{
    if (atomic_exchange(&b->slot[i].hash, 0))
        atomic_fetch_sub(&b->head->present, 1);
    (void)fallocate(b->fd, FALLOC_FL_PUNCH_HOLE | FALLOC_FL_KEEP_SIZE,
                    (off_t)(b->data_at + i * BLOCKS_BYTES), BLOCKS_BYTES);
}

/* A tenth of what is there, and what was used longest ago. */
static void blocks_make_room(struct blocks *b)
{
    static pthread_mutex_t one = PTHREAD_MUTEX_INITIALIZER;
    if (pthread_mutex_trylock(&one))
        return;
    const uint32_t now_s = (uint32_t)time(NULL);
    float *age = mem_array(b->n, sizeof *age);
    size_t n = 0;
    for (uint64_t i = 0; age && i < b->n; i++)
        if (blocks_has(b, i))
            age[n++] = (float)(uint32_t)(now_s - atomic_load(&b->slot[i].used_s));
    atomic_store(&b->head->present, n);
    size_t drop = n / 10 + 1;
    const float least = n ? sort_select(age, n, n - (drop < n ? drop : n)) : 0;
    for (uint64_t i = 0; n && i < b->n && drop; i++)
        if (blocks_has(b, i) &&
            (float)(uint32_t)(now_s - atomic_load(&b->slot[i].used_s)) >= least) {
            blocks_drop(b, i);
            drop--;
        }
    mem_free(age);
    pthread_mutex_unlock(&one);
}

void blocks_put(struct blocks *b, uint64_t i, const uint8_t *bytes)
{
    const size_t n = blocks_size(b, i);
    struct blocks_slot *s = &b->slot[i];
    if (pwrite(b->fd, bytes, n, (off_t)(b->data_at + i * BLOCKS_BYTES)) != (ssize_t)n)
        return;
    atomic_store(&s->used_s, (uint32_t)time(NULL));
    if (!atomic_exchange(&s->hash, blocks_hash(bytes, n)) &&
        (atomic_fetch_add(&b->head->present, 1) + 1) * BLOCKS_BYTES >
            atomic_load(&b->head->limit_bytes))
        blocks_make_room(b);
}

void blocks_note_changed(struct blocks *b, bool changed)
{
    atomic_store(&b->head->changed, changed);
}

bool blocks_changed(const struct blocks *b)
{
    return atomic_load(&b->head->changed);
}

void blocks_note_down(struct blocks *b, double for_s)
{
    atomic_store(&b->head->down_until_ms,
                 for_s > 0 ? blocks_now_ms() + (uint64_t)(for_s * 1e3) : 0);
}

bool blocks_down(const struct blocks *b)
{
    return blocks_now_ms() < atomic_load(&b->head->down_until_ms);
}
