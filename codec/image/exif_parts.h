/* Where EXIF and XMP are in a JPEG, PNG, WebP or TIFF file. All functions may be called from any
 * thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_EXIF_PARTS_H
#define CODEC_EXIF_PARTS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base.h"

enum { EXIF_PACKETS = 8 };
enum exif_container { EXIF_TIFF, EXIF_JPEG, EXIF_PNG, EXIF_WEBP };

struct exif_bytes {
    const uint8_t *p; /* NULL: there are none */
    size_t n;
};
struct exif_parts { /* {0} is empty; exif_parts_free it */
    struct exif_bytes exif, packet[EXIF_PACKETS];
    size_t n_packets;
    struct buf file; /* what exif_parts_read has read */
    /* What the file does not have in one piece: put together, inflated, or in digits. */
    struct buf extended, inflated, profile;
    bool cut; /* the bytes end before all of them could come */
};

/* EXIF_TIFF is whatever is none of the others. */
enum exif_container exif_parts_container(const uint8_t *p, size_t n);
/* x is empty before, and points into p [n] after. Damaged parts are left out. */
void exif_parts_find(const uint8_t *p, size_t n, struct exif_parts *x);
/* Finds them in a file: in the head of a JPEG, which is all that is read of most, or in all of it.
 * x is empty before. ERR_NOENT, ERR_IO, ERR_MEM. */
enum err_code exif_parts_read(const char *path, struct exif_parts *x, struct err *e) ERR_USE;
void exif_parts_free(struct exif_parts *x);

#endif
