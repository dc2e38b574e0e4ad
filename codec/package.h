/* 3TZ: a tileset's folder as one zip archive (3D Tiles Archive Format 1.3, Maxar).
 *
 * Every file is stored as it is, so that a reader can map it, and the last entry, @3dtilesIndex1@,
 * is a table of where they are: 24 bytes each, the MD5 of the name and the offset of the local
 * header (both little-endian), sorted by the hash taken as two 64-bit numbers. A reader then finds
 * a file in a few reads, without the zip's own directory.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_PACKAGE_H
#define CODEC_PACKAGE_H

#include "core/base.h"

#define PACKAGE_INDEX "@3dtilesIndex1@"

/* The files dir/names[n] as a 3TZ, by libzip, in this order, dated 1980-01-01: the same files are
 * the same bytes. Written beside and renamed; an older file of that name is replaced. As much room
 * on the disk as the files take, more than 4 GiB and 65535 files by ZIP64. ERR_NOENT, ERR_IO,
 * ERR_LIMIT (path), ERR_MEM, ERR_INTERNAL, ERR_CANCEL. */
enum err_code package_write(const char *dir, char *const *names, size_t n, const char *path,
                            struct err *e) ERR_USE;

#endif
