/* Results on disk, which survive a restart.
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
    uint64_t damaged, failed; /* damaged: files with wrong content; failed: failed writes */
};
/* Opens a folder, and makes it if needed. Only one process may use it (ERR_BUSY). Its files have at
 * most limit_bytes. Close *out with disk_close. ERR_IO, ERR_MEM. */
enum err_code disk_open(const char *dir, uint64_t limit_bytes, struct disk **out,
                        struct err *e) ERR_USE;
void disk_close(struct disk **d);
/* Checks whether disk_open could write there. A server may be using the folder. ERR_IO. */
enum err_code disk_check(const char *dir, struct err *e) ERR_USE;
/* Notes that the result of this name was used, from memory. It is then kept longer than results
 * that were used once. Never waits, so HTTP threads may call it: while another thread changes the
 * lists, the use is not noted. d may be NULL. */
void disk_note(struct disk *d, struct hash128 id);
/* Appends the bytes of this name to *out. False: there are none, or memory is short; or they were
 * damaged, or are too large for the limit of now, and have been removed. */
bool disk_get(struct disk *d, struct hash128 id, struct buf *out);
/* Keeps n bytes under a name. Files are removed to make room: first those used once, the oldest
 * first. apart: the result is one of very many, such as those of polygons. These have an eighth of
 * the folder and displace only each other. A failure is counted, and logged once a minute. d may be
 * NULL. */
void disk_put(struct disk *d, struct hash128 id, const void *bytes, size_t n, bool apart);
void disk_count(struct disk *d, struct disk_stats *out);

#endif
