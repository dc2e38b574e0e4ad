/* Large bodies in files of memory. The kernel sends from such a file without a copy (sendfile), as
 * nginx does from the page cache; a copy of 520 KB takes as long as all else of the request.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#define _GNU_SOURCE // NOLINT(cert-dcl51-cpp): memfd_create, MAP_POPULATE
#include "server/base/body_file.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

static _Atomic int64_t body_file_most, body_file_count;

void body_file_limit(size_t most)
{
    atomic_store(&body_file_most, (int64_t)most);
}

static bool body_file_write(int fd, const uint8_t *data, size_t size)
{
    for (size_t at = 0; at < size;) {
        const ssize_t n = write(fd, data + at, size - at);
        if (n <= 0)
            return false;
        at += (size_t)n;
    }
    return true;
}

static void body_file_unmap(struct body *b)
{
    (void)munmap(b->data, b->size);
    close(b->fd);
    atomic_fetch_sub(&body_file_count, 1);
    b->data = NULL;
    b->unmap = NULL;
}

void body_file_move(struct body *b)
{
    enum { LEAST = 128 << 10 }; /* where sendfile begins to take less time than send */
    if (b->size < LEAST || b->coded || b->unmap)
        return;
    const bool room = atomic_fetch_add(&body_file_count, 1) < atomic_load(&body_file_most);
    const int fd = room ? memfd_create("citysplat-result", MFD_CLOEXEC) : -1;
    void *map = MAP_FAILED;
    /* With its pages in the table, they count as memory of this process. */
    if (fd >= 0 && body_file_write(fd, b->data, b->size))
        map = mmap(NULL, b->size, PROT_READ, MAP_SHARED | MAP_POPULATE, fd, 0);
    if (map == MAP_FAILED) {
        if (fd >= 0)
            close(fd);
        atomic_fetch_sub(&body_file_count, 1);
        return;
    }
    struct buf bytes = {.data = b->data, .size = b->size};
    buf_free(&bytes);
    b->data = map;
    b->fd = fd;
    b->unmap = body_file_unmap;
}

int body_file_of(const struct body *b, const uint8_t *data, uint64_t *at)
{
    if (!b->unmap || data < b->data || data >= b->data + b->size)
        return -1;
    *at = (uint64_t)(data - b->data);
    return fcntl(b->fd, F_DUPFD_CLOEXEC, 0);
}
