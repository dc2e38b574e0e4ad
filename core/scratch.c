/* A mapped file without a name. See scratch.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#define _GNU_SOURCE // NOLINT(cert-dcl51-cpp): O_TMPFILE, fallocate, sync_file_range
#include "core/scratch.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/vfs.h>
#include <unistd.h>

#include "core/base.h"

enum { SCRATCH_LOOK = 1 << 16 /* pages that scratch_held_bytes asks for at a time */ };
#define SCRATCH_TMPFS 0x01021994
#define SCRATCH_RAMFS 0x858458f6

static size_t scratch_page(void)
{
    const long page = sysconf(_SC_PAGESIZE);
    return page > 0 ? (size_t)page : 4096;
}

/* Where the file system has no files without a name, it loses its name at once. */
static int scratch_create(const char *dir, struct err *e)
{
    char path[FILE_PATH_MAX];
    int fd = open(dir, O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
    if (fd >= 0)
        return fd;
    if (file_join(path, dir, ".scratch-XXXXXX", e))
        return -1;
    fd = mkostemp(path, O_CLOEXEC);
    if (fd < 0)
        (void)err_errno(e, ERR_IO, "%s: cannot make a file there", dir);
    else
        (void)unlink(path);
    return fd;
}

enum err_code scratch_open(const char *dir, size_t n_bytes, struct scratch *out, struct err *e)
{
    *out = (struct scratch){.fd = -1};
    if (n_bytes > INT64_MAX)
        return err_set(e, ERR_LIMIT, "%s: a file of %zu bytes", dir, n_bytes);
    int fd = scratch_create(dir, e);
    if (fd < 0)
        return ERR_IO;
    int code = posix_fallocate(fd, 0, (off_t)n_bytes);
    if (code) {
        close(fd);
        errno = code;
        return err_errno(e, ERR_IO, "%s: no room for a file of %.1f MB that stands in for memory",
                         dir, (double)n_bytes * 1e-6);
    }
    void *at = mmap(NULL, n_bytes, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (at == MAP_FAILED) {
        close(fd);
        return err_errno(e, ERR_LIMIT, "%s: a file of %.1f MB cannot be mapped", dir,
                         (double)n_bytes * 1e-6);
    }
    *out = (struct scratch){.at = at, .n_bytes = n_bytes, .fd = fd};
    scratch_stream(out, false);
    return ERR_OK;
}

void scratch_close(struct scratch *s)
{
    if (!s->at)
        return;
    (void)munmap(s->at, s->n_bytes);
    (void)close(s->fd);
    *s = (struct scratch){0};
}

enum err_code scratch_zero(struct scratch *s, struct err *e)
{
    const off_t n = (off_t)s->n_bytes;
    if (!fallocate(s->fd, FALLOC_FL_ZERO_RANGE | FALLOC_FL_KEEP_SIZE, 0, n))
        return ERR_OK;
    /* A hole, and its room reserved again. */
    if (!fallocate(s->fd, FALLOC_FL_PUNCH_HOLE | FALLOC_FL_KEEP_SIZE, 0, n)) {
        errno = posix_fallocate(s->fd, 0, n);
        return errno ? err_errno(e, ERR_IO, "no room on the disk for %.1f MB of scratch",
                                 (double)s->n_bytes * 1e-6)
                     : ERR_OK;
    }
    memset(s->at, 0, s->n_bytes);
    return ERR_OK;
}

void scratch_stream(const struct scratch *s, bool on)
{
    (void)madvise(s->at, s->n_bytes, on ? MADV_SEQUENTIAL : MADV_RANDOM);
}

/* The pages of [from, to): those that it touches, or those that it covers. */
static size_t scratch_pages(const struct scratch *s, size_t *from, size_t to, bool covers)
{
    const size_t page = scratch_page();
    to = to < s->n_bytes ? to : s->n_bytes;
    *from = (covers ? *from + page - 1 : *from) / page * page;
    if (to < s->n_bytes)
        to = (covers ? to : to + page - 1) / page * page;
    return to > *from ? to - *from : 0;
}

void scratch_fetch(const struct scratch *s, size_t from, size_t to)
{
    const size_t n = scratch_pages(s, &from, to, false);
    if (n)
        (void)madvise(s->at + from, n, MADV_WILLNEED);
}

void scratch_flush(const struct scratch *s, size_t from, size_t to)
{
    const size_t n = scratch_pages(s, &from, to, false);
    if (n)
        (void)sync_file_range(s->fd, (off_t)from, (off_t)n, SYNC_FILE_RANGE_WRITE);
}

void scratch_drop(const struct scratch *s, size_t from, size_t to)
{
    const size_t n = scratch_pages(s, &from, to, true);
    if (!n)
        return;
    (void)madvise(s->at + from, n, MADV_DONTNEED); /* of a shared file: nothing is lost */
    (void)sync_file_range(s->fd, (off_t)from, (off_t)n,
                          SYNC_FILE_RANGE_WAIT_BEFORE | SYNC_FILE_RANGE_WRITE |
                              SYNC_FILE_RANGE_WAIT_AFTER);
    (void)posix_fadvise(s->fd, (off_t)from, (off_t)n, POSIX_FADV_DONTNEED);
}

size_t scratch_held_bytes(const struct scratch *s)
{
    const size_t page = scratch_page(), n = (s->n_bytes + page - 1) / page;
    unsigned char *in = mem_array(SCRATCH_LOOK, 1);
    size_t held = 0;
    for (size_t i = 0; in && i < n; i += SCRATCH_LOOK) {
        const size_t some = n - i < SCRATCH_LOOK ? n - i : SCRATCH_LOOK;
        if (mincore(s->at + i * page, some * page, in))
            break;
        for (size_t k = 0; k < some; k++)
            held += (in[k] & 1U) * page;
    }
    mem_free(in);
    return held;
}

bool scratch_is_memory(const char *dir)
{
    struct statfs fs;
    return !statfs(dir, &fs) && (fs.f_type == SCRATCH_TMPFS || fs.f_type == SCRATCH_RAMFS);
}
