/* Reads single files of a zip archive, such as a 3TZ (package.h), from bytes that are read in
 * parts. The archive's own directory is read once. Files are stored or deflated.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_UNZIP_H
#define CODEC_UNZIP_H

#include "codec/read_at.h"

enum { UNZIP_FILES_MAX = 1 << 22 };
enum { UNZIP_BYTES_MAX = 256 << 20 }; /* of one file */
struct unzip;                         /* immutable; any thread */
struct unzip_file {
    struct hash128 name;           /* hash of it */
    uint64_t at;                   /* of its local header */
    uint32_t packed, plain, crc32; /* bytes in the archive, bytes of the file */
    bool deflated;
};

/* Reads the directory. Each file must lie within the archive and have one name, and none may be
 * larger than UNZIP_BYTES_MAX or than deflate can make of its bytes. ERR_FORMAT, ERR_LIMIT,
 * ERR_MEM, and errors of the source. */
enum err_code unzip_open(const struct read_at *from, struct unzip **out, struct err *e) ERR_USE;
void unzip_close(struct unzip **u);
/* All files [*n], in no order that means anything. */
const struct unzip_file *unzip_files(const struct unzip *u, size_t *n);
/* Hash of all names, sizes and checksums. */
struct hash128 unzip_hash(const struct unzip *u);
/* NULL: there is no such file. */
const struct unzip_file *unzip_find(const struct unzip *u, const char *name, size_t n);
/* Reads a file and checks its checksum; the caller frees `out`. ERR_FORMAT (damaged), ERR_MEM, and
 * errors of the source. */
enum err_code unzip_read(const struct read_at *from, const struct unzip_file *f, struct buf *out,
                         struct err *e) ERR_USE;

#endif
