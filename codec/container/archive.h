/* Zip archives in memory, by libzip, for few entries. Entries are stored without compression. All
 * functions may be called from any thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_ARCHIVE_H
#define CODEC_ARCHIVE_H

#include "core/base.h"

struct archive_part {
    const char *name; /* borrowed, as are the bytes */
    struct buf bytes;
};

/* Appends a zip archive with the entries in this order to `out`. Entries are stored uncompressed
 * and dated 1980-01-01, so the bytes do not depend on the time or time zone. ERR_MEM, ERR_INTERNAL.
 */
enum err_code archive_write(const struct archive_part *part, size_t n, struct buf *out,
                            struct err *e) ERR_USE;

struct archive_reader;
/* Opens an archive. `bytes` are borrowed until archive_close. ERR_FORMAT, ERR_MEM. */
enum err_code archive_open(const void *bytes, size_t n, struct archive_reader **out,
                           struct err *e) ERR_USE;
/* Reads the content of one entry, or of the first of this name in any folder. Free it with
 * buf_free. ERR_FORMAT (it is absent or damaged), ERR_LIMIT (it has more than `most` bytes),
 * ERR_MEM. */
enum err_code archive_get(struct archive_reader *z, const char *name, size_t most, struct buf *out,
                          struct err *e) ERR_USE;
void archive_close(struct archive_reader **z);
#endif
