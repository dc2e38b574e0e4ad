/* What a folder of results holds when a server starts (disk.c has the layout).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_DISK_SCAN_H
#define SERVER_DISK_SCAN_H

#include <time.h>

#include "core/base.h"

struct disk_scan_file {
    struct hash128 id;
    uint64_t bytes;
    struct timespec used; /* last, by its own time */
};
struct disk_scan { /* {0} is empty; disk_scan_free */
    struct disk_scan_file *file;
    size_t n, cap;
};
/* The files below dir, those that were used longest ago first. Its 256 folders are made where they
 * are not there; what was being written when a server ended is removed, names that are none of ours
 * are passed over. ERR_IO, ERR_LIMIT (the path is too long), ERR_MEM. */
enum err_code disk_scan_dir(const char *dir, struct disk_scan *out, struct err *e) ERR_USE;
void disk_scan_free(struct disk_scan *s);

#endif
