/* A folder of results, one file each. A file is named by what determines its bytes (result_id.c). A
 * name never means other bytes, so no file is ever out of date. Files are written under another
 * name and renamed, without waiting for the disk. A file that a power cut damages does not match
 * the hash in its head. It counts as a miss, as any other damage does.
 *
 * The lists of files are in memory, in order of last use. A new file is on probation, and a second
 * use protects it, as in cache.c: one scan of the city pushes out what was used once. Results of
 * polygons are a list of their own. The times of the files keep the order over a restart, and their
 * mode (0600, 0500 protected, 0700 of polygons) keeps the list. Work on files is done outside the
 * lock: a file that another thread removes meanwhile is a miss. Only workers use this folder. HTTP
 * threads touch only the lists, and never wait for the lock.
 *
 *     DIR/lock              held (flock) by the server that uses the folder
 *     DIR/ab/cdef...        the rest of the name's 32 digits; a head of 64 bytes, then the result
 *     DIR/ab/cdef....part   while it is written
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/data/disk.h"

#include <assert.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "server/data/disk_scan.h"

enum { DISK_BLOCK = 4096, DISK_BUCKETS_MIN = 1024, DISK_SHARE = 16 /* of all, for one file */ };
enum { DISK_NAME = 64 /* bytes that a file's name adds to the folder's */ };
static const double DISK_TOUCH_S = 600; /* the time of a file is renewed no more often */
static const double DISK_SAY_S = 60;

struct disk_head {
    char magic[8];
    uint64_t size;
    struct hash128 id, hash; /* of the result's bytes */
    uint64_t unused[2];
};
static const char disk_magic[8] = "CSDISK1";

enum disk_part { DISK_PROBATION, DISK_PROTECTED, DISK_APART, DISK_PARTS };
enum { DISK_APART_SHARE = 8 /* of all, for those apart */ };
static const mode_t disk_mode[DISK_PARTS] = {0600, 0500, 0700};

struct disk_entry {
    struct hash128 id;
    uint64_t cost; /* bytes of the file, in whole blocks */
    double touched_s;
    enum disk_part part;
    bool unsaved; /* in the list of files whose mode does not say the part yet */
    struct disk_entry *bucket_next, *newer, *older, *unsaved_next;
};
struct disk_list {
    struct disk_entry *newest, *oldest;
    uint64_t bytes;
};
struct disk {
    char dir[FILE_PATH_MAX - DISK_NAME];
    uint64_t limit;
    int fd;               /* of the lock file */
    pthread_mutex_t lock; /* of all that follows */
    struct disk_entry **bucket, *unsaved;
    struct disk_list list[DISK_PARTS];
    size_t n_buckets;
    double said_s;
    struct disk_stats stats;
};

/* ---- the index; by the lock ---- */

static struct disk_entry **disk_find(struct disk *d, struct hash128 id)
{
    struct disk_entry **p = &d->bucket[id.lo & (d->n_buckets - 1)];
    while (*p && ((*p)->id.lo != id.lo || (*p)->id.hi != id.hi))
        p = &(*p)->bucket_next;
    return p;
}

static void disk_unlink(struct disk *d, struct disk_entry *x)
{
    struct disk_list *l = &d->list[x->part];
    *(x->newer ? &x->newer->older : &l->newest) = x->older;
    *(x->older ? &x->older->newer : &l->oldest) = x->newer;
    l->bytes -= x->cost;
}

static void disk_to_front(struct disk *d, struct disk_entry *x, enum disk_part part)
{
    struct disk_list *l = &d->list[part];
    x->part = part;
    x->newer = NULL;
    x->older = l->newest;
    *(l->newest ? &l->newest->newer : &l->oldest) = x;
    l->newest = x;
    l->bytes += x->cost;
}

/* The mode of its file does not say its part: disk_save_parts writes it. */
static void disk_note_unsaved(struct disk *d, struct disk_entry *x)
{
    if (x->unsaved)
        return;
    x->unsaved = true;
    x->unsaved_next = d->unsaved;
    d->unsaved = x;
}

static void disk_move(struct disk *d, struct disk_entry *x, enum disk_part part)
{
    if (x->part != part)
        disk_note_unsaved(d, x);
    disk_unlink(d, x);
    disk_to_front(d, x, part);
}

/* At most four fifths are protected. The oldest of them fall back, so that new files have room to
 * be used a second time. */
static void disk_limit_protected(struct disk *d)
{
    const struct disk_list *l = &d->list[DISK_PROTECTED];
    while (l->bytes > d->limit / 5 * 4 && l->oldest != l->newest)
        disk_move(d, l->oldest, DISK_PROBATION);
}

/* It was used again. */
static void disk_rise(struct disk *d, struct disk_entry *x)
{
    disk_move(d, x, x->part == DISK_PROBATION ? DISK_PROTECTED : x->part);
    disk_limit_protected(d);
}

/* Staying small is allowed when memory is short. */
static void disk_grow(struct disk *d)
{
    const size_t n = d->n_buckets * 2;
    struct disk_entry **bigger = mem_array(n, sizeof(struct disk_entry *));
    if (!bigger)
        return;
    for (int part = 0; part < DISK_PARTS; part++)
        for (struct disk_entry *x = d->list[part].newest; x; x = x->older) {
            x->bucket_next = bigger[x->id.lo & (n - 1)];
            bigger[x->id.lo & (n - 1)] = x;
        }
    mem_free(d->bucket);
    d->bucket = bigger;
    d->n_buckets = n;
}

/* False when out of memory: the file then stays until the next start. */
static bool disk_add(struct disk *d, struct hash128 id, uint64_t cost, double touched_s,
                     enum disk_part part)
{
    struct disk_entry **p = disk_find(d, id), *x = *p;
    if (x) { /* written again */
        d->stats.bytes -= x->cost;
        disk_unlink(d, x);
        if (x->part != part)
            disk_note_unsaved(d, x);
        part = x->part;
    } else {
        x = mem_array(1, sizeof *x);
        if (!x)
            return false;
        x->id = id;
        *p = x;
        d->stats.entries++;
    }
    x->cost = cost;
    x->touched_s = touched_s;
    d->stats.bytes += cost;
    disk_to_front(d, x, part);
    if (d->stats.entries > d->n_buckets)
        disk_grow(d);
    return true;
}

static void disk_forget(struct disk *d, struct hash128 id)
{
    struct disk_entry **p = disk_find(d, id), *x = *p;
    if (!x)
        return;
    *p = x->bucket_next;
    for (struct disk_entry **u = &d->unsaved; x->unsaved && *u; u = &(*u)->unsaved_next)
        if (*u == x) {
            *u = x->unsaved_next;
            break;
        }
    disk_unlink(d, x);
    d->stats.bytes -= x->cost;
    d->stats.entries--;
    mem_free(x);
}

/* ---- files: the index and the names of whole files change together, under the lock ---- */

static void disk_path(const struct disk *d, struct hash128 id, const char *end,
                      char out[FILE_PATH_MAX])
{
    char name[33];
    hash_text(id, name);
    snprintf(out, FILE_PATH_MAX, "%s/%.2s/%s%s", d->dir, name, name + 2, end);
}

/* Say what went wrong, once a minute. Not under the lock. */
static void disk_say(struct disk *d, const char *what, const char *path, const char *why)
{
    pthread_mutex_lock(&d->lock);
    const double now_s = clock_s();
    const bool say = d->said_s <= 0 || now_s - d->said_s > DISK_SAY_S;
    if (say)
        d->said_s = now_s;
    pthread_mutex_unlock(&d->lock);
    if (say)
        log_warn("serve", "disk cache: %s: %s: %s", what, path, why);
}

/* By the lock: what goes first. NULL: there is room. */
static const struct disk_entry *disk_victim(const struct disk *d)
{
    const struct disk_list *l = d->list;
    if (l[DISK_APART].bytes > d->limit / DISK_APART_SHARE)
        return l[DISK_APART].oldest;
    if (d->stats.bytes <= d->limit)
        return NULL;
    return l[DISK_PROBATION].oldest   ? l[DISK_PROBATION].oldest
           : l[DISK_PROTECTED].oldest ? l[DISK_PROTECTED].oldest
                                      : l[DISK_APART].oldest;
}

/* Into the modes of files: the parts that changed since the last time. Not under the lock. */
static void disk_save_parts(struct disk *d)
{
    char path[FILE_PATH_MAX];
    for (bool any = true; any;) {
        pthread_mutex_lock(&d->lock);
        struct disk_entry *x = d->unsaved;
        any = x;
        if (x) {
            d->unsaved = x->unsaved_next;
            x->unsaved = false;
            disk_path(d, x->id, "", path);
            (void)chmod(path, disk_mode[x->part]);
        }
        pthread_mutex_unlock(&d->lock);
    }
}

/* Remove the oldest until there is room. */
static void disk_make_room(struct disk *d)
{
    char path[FILE_PATH_MAX];
    for (;;) {
        pthread_mutex_lock(&d->lock);
        const struct disk_entry *victim = disk_victim(d);
        const bool over = victim;
        struct hash128 id = over ? victim->id : (struct hash128){0, 0};
        if (over) {
            disk_forget(d, id);
            d->stats.evicted++;
            disk_path(d, id, "", path);
            (void)unlink(path);
        }
        pthread_mutex_unlock(&d->lock);
        if (!over)
            return;
    }
}

static bool disk_write_all(int fd, const void *bytes, size_t n)
{
    for (const char *p = bytes; n;) {
        ssize_t put = write(fd, p, n);
        if (put < 0 && errno == EINTR)
            continue;
        if (put <= 0)
            return false;
        p += put;
        n -= (size_t)put;
    }
    return true;
}

static bool disk_read_all(int fd, void *bytes, size_t n)
{
    for (char *p = bytes; n;) {
        ssize_t got = read(fd, p, n);
        if (got < 0 && errno == EINTR)
            continue;
        if (got <= 0)
            return false;
        p += got;
        n -= (size_t)got;
    }
    return true;
}

static uint64_t disk_cost(uint64_t size)
{
    return (size + DISK_BLOCK - 1) / DISK_BLOCK * DISK_BLOCK;
}

enum disk_found { DISK_GOOD, DISK_ABSENT, DISK_DAMAGED, DISK_TOO_LARGE, DISK_NO_MEMORY };

/* Head and bytes of an open file into *out, if they are what was put under this name. Too large: it
 * was put there while the limit was higher. */
static enum disk_found disk_read(int fd, struct hash128 id, uint64_t most, struct buf *out)
{
    struct disk_head h;
    struct stat st;
    if (fstat(fd, &st) || !disk_read_all(fd, &h, sizeof h) ||
        memcmp(h.magic, disk_magic, sizeof h.magic) != 0 || h.id.lo != id.lo || h.id.hi != id.hi ||
        h.size != (uint64_t)st.st_size - sizeof h)
        return DISK_DAMAGED;
    if (h.size > most)
        return DISK_TOO_LARGE;
    const size_t was = out->size;
    uint8_t *bytes = buf_grow(out, (size_t)h.size);
    if (!bytes)
        return DISK_NO_MEMORY;
    if (!disk_read_all(fd, bytes, (size_t)h.size)) {
        out->size = was;
        return DISK_DAMAGED;
    }
    const struct hash128 hash = hash_bytes(bytes, (size_t)h.size);
    const bool good = hash.lo == h.hash.lo && hash.hi == h.hash.hi;
    out->size = good ? out->size : was;
    return good ? DISK_GOOD : DISK_DAMAGED;
}

/* ---- opening ---- */

static enum err_code disk_scan_all(struct disk *d, struct err *e)
{
    struct disk_scan found = {0};
    enum err_code rc = disk_scan_dir(d->dir, &found, e);
    for (size_t i = 0; !rc && i < found.n; i++)
        if (!disk_add(d, found.file[i].id, disk_cost(found.file[i].bytes), -DISK_TOUCH_S,
                      found.file[i].mode == disk_mode[DISK_PROTECTED] ? DISK_PROTECTED
                      : found.file[i].mode == disk_mode[DISK_APART]   ? DISK_APART
                                                                      : DISK_PROBATION))
            rc = err_set(e, ERR_MEM, "disk cache: out of memory for its list of files");
    disk_limit_protected(d);
    disk_scan_free(&found);
    return rc;
}

static enum err_code disk_open_lock(const char *dir, int *fd, struct err *e)
{
    char path[FILE_PATH_MAX];
    enum err_code rc = file_mkdir(dir, e);
    if (!rc)
        rc = file_join(path, dir, "lock", e);
    if (rc)
        return err_add(e, "--cache-dir");
    *fd = open(path, O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600);
    return *fd < 0 ? err_errno(e, ERR_IO, "--cache-dir: %s", path) : ERR_OK;
}

enum err_code disk_check(const char *dir, struct err *e)
{
    int fd = -1;
    enum err_code rc = disk_open_lock(dir, &fd, e);
    if (fd >= 0)
        close(fd);
    return rc;
}

enum err_code disk_open(const char *dir, uint64_t limit_bytes, struct disk **out, struct err *e)
{
    struct disk *d = mem_array(1, sizeof *d);
    *out = d;
    if (!d || !(d->bucket = mem_array(DISK_BUCKETS_MIN, sizeof(struct disk_entry *)))) {
        mem_free(d);
        *out = NULL;
        return err_set(e, ERR_MEM, "disk cache: out of memory");
    }
    enum err_code rc = strlen(dir) < sizeof d->dir
                           ? ERR_OK
                           : err_set(e, ERR_ARG, "--cache-dir %.80s...: the path is too long", dir);
    d->limit = limit_bytes;
    d->n_buckets = DISK_BUCKETS_MIN;
    d->fd = -1;
    pthread_mutex_init(&d->lock, NULL);
    if (!rc) {
        snprintf(d->dir, sizeof d->dir, "%s", dir);
        rc = disk_open_lock(dir, &d->fd, e);
    }
    if (!rc && flock(d->fd, LOCK_EX | LOCK_NB))
        rc = errno == EWOULDBLOCK
                 ? err_set(e, ERR_BUSY, "--cache-dir %s: another server uses it: give each its own",
                           dir)
                 : err_errno(e, ERR_IO, "--cache-dir %s: lock", dir);
    if (!rc)
        rc = disk_scan_all(d, e);
    if (rc)
        disk_close(out);
    else
        disk_make_room(d);
    return rc;
}

void disk_close(struct disk **out)
{
    struct disk *d = *out;
    *out = NULL;
    if (!d)
        return;
    disk_save_parts(d);
    for (int part = 0; part < DISK_PARTS; part++)
        for (struct disk_entry *x = d->list[part].newest, *older; x; x = older) {
            older = x->older;
            mem_free(x);
        }
    if (d->fd >= 0)
        close(d->fd);
    pthread_mutex_destroy(&d->lock);
    mem_free(d->bucket);
    mem_free(d);
}

/* ---- using ---- */

/* True if it is there; *touch: its file's time is to be renewed. */
static bool disk_use(struct disk *d, struct hash128 id, bool *touch)
{
    pthread_mutex_lock(&d->lock);
    struct disk_entry *x = *disk_find(d, id);
    if (x) {
        const double now_s = clock_s();
        *touch = now_s - x->touched_s > DISK_TOUCH_S;
        if (*touch)
            x->touched_s = now_s;
        disk_rise(d, x);
    } else {
        d->stats.misses++;
    }
    pthread_mutex_unlock(&d->lock);
    return x;
}

void disk_note(struct disk *d, struct hash128 id)
{
    if (!d || pthread_mutex_trylock(&d->lock))
        return;
    struct disk_entry *x = *disk_find(d, id);
    if (x)
        disk_rise(d, x);
    pthread_mutex_unlock(&d->lock);
}

bool disk_get(struct disk *d, struct hash128 id, struct buf *out)
{
    char path[FILE_PATH_MAX];
    bool touch = false;
    if (!disk_use(d, id, &touch))
        return false;
    disk_path(d, id, "", path);
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    const enum disk_found found =
        fd < 0 ? DISK_ABSENT : disk_read(fd, id, d->limit / DISK_SHARE, out);
    const bool good = found == DISK_GOOD, damaged = found == DISK_DAMAGED,
               large = found == DISK_TOO_LARGE;
    if (good && touch)
        (void)futimens(fd, NULL);
    if (fd >= 0)
        close(fd);
    disk_save_parts(d);
    pthread_mutex_lock(&d->lock);
    d->stats.hits += good;
    d->stats.misses += !good;
    d->stats.damaged += damaged;
    d->stats.evicted += large;
    if (damaged || large || found == DISK_ABSENT)
        disk_forget(d, id);
    if (damaged || large)
        (void)unlink(path);
    pthread_mutex_unlock(&d->lock);
    if (damaged)
        disk_say(d, "removed", path, "it is not what was written");
    return good;
}

/* Its folder as well, for somebody may have emptied the cache. */
static int disk_create(const struct disk *d, struct hash128 id, const char *part, mode_t mode)
{
    const int flags = O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW;
    char folder[FILE_PATH_MAX];
    int fd = open(part, flags, mode);
    if (fd >= 0 || errno != ENOENT)
        return fd;
    disk_path(d, id, "", folder);
    *strrchr(folder, '/') = '\0';
    return mkdir(folder, 0700) && errno != EEXIST ? -1 : open(part, flags, mode);
}

/* The file, under its own name when it is whole, and its entry. */
static void disk_write(struct disk *d, struct hash128 id, const void *bytes, size_t n,
                       enum disk_part list)
{
    char path[FILE_PATH_MAX], part[FILE_PATH_MAX];
    struct disk_head h = {.size = n, .id = id, .hash = hash_bytes(bytes, n)};
    static_assert(sizeof h == 64, "the head's layout");
    memcpy(h.magic, disk_magic, sizeof h.magic);
    disk_path(d, id, "", path);
    disk_path(d, id, ".part", part);
    int fd = disk_create(d, id, part, disk_mode[list]);
    if (fd < 0) {
        const int why_not = errno;
        pthread_mutex_lock(&d->lock);
        d->stats.failed++;
        pthread_mutex_unlock(&d->lock);
        disk_say(d, "not kept", part, strerror(why_not));
        return;
    }
    bool ok = disk_write_all(fd, &h, sizeof h) && disk_write_all(fd, bytes, n);
    int why = errno;
    if (close(fd) && ok) {
        ok = false;
        why = errno;
    }
    pthread_mutex_lock(&d->lock);
    if (ok && rename(part, path)) {
        ok = false;
        why = errno;
    }
    d->stats.written += ok;
    d->stats.failed += !ok;
    if (ok)
        (void)disk_add(d, id, disk_cost(n + sizeof h), clock_s(), list);
    pthread_mutex_unlock(&d->lock);
    if (!ok) {
        (void)unlink(part);
        disk_say(d, "not kept", part, strerror(why));
    }
}

void disk_put(struct disk *d, struct hash128 id, const void *bytes, size_t n, bool apart)
{
    if (!d || n > d->limit / DISK_SHARE)
        return;
    disk_write(d, id, bytes, n, apart ? DISK_APART : DISK_PROBATION);
    disk_make_room(d);
    disk_save_parts(d);
}

void disk_count(struct disk *d, struct disk_stats *out)
{
    pthread_mutex_lock(&d->lock);
    *out = d->stats;
    pthread_mutex_unlock(&d->lock);
}
