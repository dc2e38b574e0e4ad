/* The camera of a photograph by EXIF: see exif_camera.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/exif_camera.h"

#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "codec/image/exif_parts.h"
#include "codec/image/exif_tags.h"
#include "codec/image/tiff.h"

static void exif_camera_fields(const uint8_t *p, size_t n, struct exif_camera *out)
{
    struct tiff t;
    uint32_t ifd0;
    char make[40], model[48];
    if (!tiff_open(p, n, &t, &ifd0))
        return;
    uint32_t exif = tiff_offset(&t, ifd0, EXIF_TAG_IFD);
    tiff_text(&t, ifd0, EXIF_TAG_MAKE, make, sizeof make);
    tiff_text(&t, ifd0, EXIF_TAG_MODEL, model, sizeof model);
    bool twice = !strncmp(model, make, strlen(make)); /* many models begin with the maker */
    snprintf(out->model, sizeof out->model, "%s%s%s", twice ? "" : make,
             !twice && *make && *model ? " " : "", model);
    out->focal_mm = tiff_num(&t, exif, EXIF_TAG_FOCAL);
    out->focal_35mm = tiff_num(&t, exif, EXIF_TAG_FOCAL_35MM);
}

enum err_code exif_camera_read(const char *path, struct exif_camera *out, struct err *e)
{
    struct exif_parts x = {0};
    *out = (struct exif_camera){0};
    enum err_code rc = exif_parts_read(path, &x, e);
    if (x.exif.p)
        exif_camera_fields(x.exif.p, x.exif.n, out);
    exif_parts_free(&x);
    return rc;
}
