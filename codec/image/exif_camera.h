/* Which camera and lens took a photograph, by EXIF.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_EXIF_CAMERA_H
#define CODEC_EXIF_CAMERA_H

#include "core/err.h"

struct exif_camera {
    char model[96];              /* "Canon PowerShot SX260 HS"; "" = not given */
    double focal_mm, focal_35mm; /* 0 = not given; the latter as on 36 x 24 mm film */
};
/* Missing or damaged fields are empty, as in exif_read. ERR_NOENT, ERR_IO, ERR_MEM. */
enum err_code exif_camera_read(const char *path, struct exif_camera *out, struct err *e) ERR_USE;

#endif
