/* 3TZ: a tileset's folder as one zip archive (3D Tiles Archive Format 1.3, Maxar).
 *
 * Files are stored without compression, so a reader can map them. The last entry, @3dtilesIndex1@,
 * is a table of 24 bytes a file: the MD5 of its name and the offset of its local header, both
 * little-endian. Rows are sorted by the hash, taken as two 64-bit numbers. A reader finds a file in
 * a few reads, without the zip's own directory.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_PACKAGE_H
#define CODEC_PACKAGE_H

#include "core/base.h"

#define PACKAGE_INDEX "@3dtilesIndex1@"

/* Writes the files dir/names[n] as a 3TZ, in this order, with libzip. Entries are dated 1980-01-01,
 * so the same files give the same bytes. The archive is written under another name and renamed; it
 * replaces an older file. It needs as much disk as the files. More than 4 GiB or 65535 files use
 * ZIP64. ERR_NOENT, ERR_IO, ERR_LIMIT (path), ERR_MEM, ERR_INTERNAL, ERR_CANCEL. */
enum err_code package_write(const char *dir, char *const *names, size_t n, const char *path,
                            struct err *e) ERR_USE;

#endif
