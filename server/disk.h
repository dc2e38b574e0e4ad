/* Results on disk: what was made once is there after a restart.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_DISK_H
#define SERVER_DISK_H

#include "core/base.h"

struct disk; /* any thread */
struct disk_stats {
    size_t entries;
    uint64_t bytes, hits, misses, written, evicted;
    uint64_t damaged, failed; /* files that are not what was written; writes that failed */
};
/* The folder, made if it is not there, which no other process uses meanwhile (ERR_BUSY); at most
 * limit_bytes of files. disk_close it. ERR_IO, ERR_MEM. */
enum err_code disk_open(const char *dir, uint64_t limit_bytes, struct disk **out,
                        struct err *e) ERR_USE;
void disk_close(struct disk **d);
/* Can disk_open write there? Beside a server that uses it as well. ERR_IO. */
enum err_code disk_check(const char *dir, struct err *e) ERR_USE;
/* Add the bytes that were put under this name to *out. False: there are none, or they were not
 * what was put: then they are gone. */
bool disk_get(struct disk *d, struct hash128 id, struct buf *out);
/* Keep n bytes under a name; what was not asked for for longest makes room. Failing is counted, and
 * said once a minute. d may be NULL. */
void disk_put(struct disk *d, struct hash128 id, const void *bytes, size_t n);
void disk_count(struct disk *d, struct disk_stats *out);

#endif
