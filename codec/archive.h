/* Zip archives in memory, by libzip: few entries, stored as they are.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_ARCHIVE_H
#define CODEC_ARCHIVE_H

#include "core/base.h"

struct archive_part {
    const char *name; /* borrowed, as bytes is */
    struct buf bytes;
};

/* Entries in this order, stored, dated 1980-01-01: the same bytes at any time and in any time zone.
 * Appended to out. ERR_MEM, ERR_INTERNAL. Any thread, as all here. */
enum err_code archive_write(const struct archive_part *part, size_t n, struct buf *out,
                            struct err *e) ERR_USE;

struct archive_reader;
/* bytes are borrowed until archive_close. ERR_FORMAT, ERR_MEM. */
enum err_code archive_open(const void *bytes, size_t n, struct archive_reader **out,
                           struct err *e) ERR_USE;
/* One entry's content; buf_free it. ERR_FORMAT (absent, damaged), ERR_LIMIT (more than most bytes
 * when decompressed), ERR_MEM. */
enum err_code archive_get(struct archive_reader *z, const char *name, size_t most, struct buf *out,
                          struct err *e) ERR_USE;
void archive_close(struct archive_reader **z);
#endif
