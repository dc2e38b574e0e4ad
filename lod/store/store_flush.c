/* Starts writing to the disk while a store is built, every few megabytes, so that the sync at the
 * end has little to do. Without this, the sync of a city of ten million Gaussians waits for a
 * gigabyte. Linux only; elsewhere the sync takes longer.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#define _GNU_SOURCE /* sync_file_range */
#include <fcntl.h>
#include <unistd.h>

#include "lod/store/store_db.h"

enum { STORE_FLUSH_BYTES = 32 << 20 };

void store_flush_open(struct store_flush *f, const char *path)
{
    *f = (struct store_flush){.fd = open(path, O_RDONLY | O_CLOEXEC)};
}

void store_flush_wrote(struct store_flush *f, size_t bytes)
{
    f->waiting += bytes;
    if (f->fd < 0 || f->waiting < STORE_FLUSH_BYTES)
        return;
    f->waiting = 0;
#ifdef SYNC_FILE_RANGE_WRITE
    (void)sync_file_range(f->fd, 0, 0,
                          SYNC_FILE_RANGE_WRITE); /* starts it; errors show at the end */
#endif
}

void store_flush_close(struct store_flush *f)
{
    if (f->fd >= 0)
        close(f->fd);
    f->fd = -1;
}
