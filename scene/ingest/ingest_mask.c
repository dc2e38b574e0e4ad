/* Masks of photographs for the pinhole pictures that ingest makes: lens distortion is taken out.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>

#include "codec/image/image.h"
#include "codec/scene/mask.h"
#include "scene/ingest/ingest_internal.h"

enum { INGEST_MASK_SUB_MAX = 8 };

enum err_code ingest_mask_convert(const struct ingest_view *v, const char *from, bool alpha,
                                  const char *to, enum ingest_mask *made, struct err *e)
{
    struct image in = {0}, out = {0};
    uint32_t w = v->pinhole.width_px, h = v->pinhole.height_px;
    bool blank = false;
    /* A mask with transparent pixels is a cutout, whose colours are those of the photograph. */
    enum err_code rc = mask_read_alpha(from, v->lens.width_px, v->lens.height_px, &in, &blank, e);
    if (!rc && !alpha && !in.px)
        rc = mask_read(from, v->lens.width_px, v->lens.height_px, &in, e);
    *made = rc      ? INGEST_MASK_NONE
            : in.px ? INGEST_MASK_MADE
            : blank ? INGEST_MASK_BLANK
                    : INGEST_MASK_NONE;
    if (*made != INGEST_MASK_MADE)
        return rc;
    if (!rc && !v->undistort)
        rc = mask_resize(&in, w, h, &out, e);
    else if (!rc)
        rc = image_alloc(w, h, 1, &out, e);
    double step = fmax((double)v->lens.width_px / w, (double)v->lens.height_px / h);
    uint32_t sub = (uint32_t)fmin(ceil(step) + 1.0, INGEST_MASK_SUB_MAX);
    for (size_t i = 0; !rc && v->undistort && i < (size_t)w * h; i++) {
        out.px[i] = 255;
        for (uint32_t k = 0; k < sub * sub; k++) {
            double x = (double)(i % w) + (k % sub + 0.5) / sub, ux, uy;
            double y = (double)(i / w) + (k / sub + 0.5) / sub;
            lens_distort(&v->lens, (x - v->pinhole.cx_px) / v->pinhole.fx_px,
                         (y - v->pinhole.cy_px) / v->pinhole.fy_px, &ux, &uy);
            if (ux >= 0.0 && uy >= 0.0 && ux < in.width_px && uy < in.height_px &&
                !in.px[(size_t)uy * in.width_px + (size_t)ux])
                out.px[i] = 0;
        }
    }
    if (!rc && mask_is_empty(out.px, (size_t)w * h))
        *made = INGEST_MASK_WHOLE;
    if (!rc)
        rc = image_write(to, &out, 0, NULL, e);
    image_free(&in);
    image_free(&out);
    return rc;
}
