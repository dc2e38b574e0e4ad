/* The EXIF fields that we need, in JPEG, PNG, WebP and TIFF files. All functions may be called from
 * any thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_EXIF_H
#define CODEC_EXIF_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

struct buf;
struct drone_meta;
struct xmp;

#ifdef __cplusplus
extern "C" {
#endif

struct image_gps {
    bool has_position, has_altitude;
    double lat_deg, lon_deg, alt_m;   /* alt_m as in the file: usually above sea level */
    char time[32];                    /* EXIF DateTimeOriginal or "" */
    double exposure_s, iso, focal_mm; /* 0 = not given */
    bool ellipsoidal;                 /* EXIF says that alt_m counts from the ellipsoid */
    bool odd_sign;                    /* a sign and a hemisphere contradict each other */
    bool interrupted;                 /* EXIF says that measurement was interrupted */
    bool no_letter;                   /* neither sign nor letter tells the hemisphere */
    bool far_datum;                   /* EXIF names a datum that is metres from WGS 84 */
};

/* Reads the fields of a file, and what drones write into XMP: in the file or in a sidecar,
 * photo.xmp or photo.JPG.xmp. Missing or damaged fields are not errors: has_position is false,
 * numbers are 0, texts "". ERR_NOENT, ERR_IO, ERR_MEM. */
enum err_code exif_read(const char *path, struct image_gps *gps, struct drone_meta *drone,
                        struct err *e) ERR_USE;
/* Reads the fields from a whole file in memory, and adds its XMP to `xmp`, which may be NULL. */
void exif_parse(const void *bytes, size_t n, struct image_gps *out, struct xmp *xmp);
/* Puts an EXIF block into an encoded picture. Angles are stored to 1e-7 arc seconds, heights to 0.1
 * mm. ERR_FORMAT (not a JPEG, PNG, WebP or TIFF), ERR_MEM. */
enum err_code exif_insert(struct buf *file, const struct image_gps *gps, struct err *e) ERR_USE;

#ifdef __cplusplus
}
#endif
#endif
