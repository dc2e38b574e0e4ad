/* Lists a folder of results when a server starts (disk.c defines the layout).
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
    struct timespec used; /* time of last use, from the file itself */
    unsigned mode;        /* of the file: what disk.c wrote there */
};
struct disk_scan { /* {0} is empty; free with disk_scan_free */
    struct disk_scan_file *file;
    size_t n, cap;
};
/* Lists the files below dir, least recently used first. It makes the 256 folders if they are
 * missing, and removes files that were incomplete when a server ended. Other names are ignored.
 * ERR_IO, ERR_LIMIT (the path is too long), ERR_MEM. */
enum err_code disk_scan_dir(const char *dir, struct disk_scan *out, struct err *e) ERR_USE;
void disk_scan_free(struct disk_scan *s);

#endif
