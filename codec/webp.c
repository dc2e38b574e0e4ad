/* WebP by libwebp: see webp.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/webp.h"

#include <webp/encode.h>

enum { WEBP_METHOD = 2 /* of 0, fast, to 6, small and many times slower */ };

static int webp_write(const uint8_t *bytes, size_t n, const WebPPicture *picture)
{
    struct buf *out = picture->custom_ptr;
    buf_add(out, bytes, n);
    return !out->failed;
}

enum err_code webp_encode(const uint8_t *px, uint32_t width_px, uint32_t height_px,
                          uint32_t channels, int quality, struct buf *out, struct err *e)
{
    WebPConfig config;
    WebPPicture picture;
    if (!width_px || !height_px || width_px > WEBP_MAX_DIMENSION ||
        height_px > WEBP_MAX_DIMENSION || (channels != 3 && channels != 4))
        return err_set(e, ERR_ARG, "webp : %u x %u px of %u channels : 1 to %d px, 3 or 4 channels",
                       width_px, height_px, channels, WEBP_MAX_DIMENSION);
    if (!WebPConfigPreset(&config, WEBP_PRESET_DEFAULT, (float)quality) ||
        !WebPPictureInit(&picture))
        return err_set(e, ERR_INTERNAL, "webp : another version of libwebp than at compile time");
    config.method = WEBP_METHOD;
    picture.width = (int)width_px;
    picture.height = (int)height_px;
    picture.writer = webp_write;
    picture.custom_ptr = out;
    int stride = (int)(width_px * channels);
    int ok = channels == 4 ? WebPPictureImportRGBA(&picture, px, stride)
                           : WebPPictureImportRGB(&picture, px, stride);
    ok = ok && WebPEncode(&config, &picture);
    int code = picture.error_code;
    WebPPictureFree(&picture);
    enum err_code rc = buf_check(out, e);
    if (rc || ok)
        return rc;
    return code == VP8_ENC_ERROR_OUT_OF_MEMORY
               ? err_set(e, ERR_MEM, "webp : out of memory")
               : err_set(e, ERR_INTERNAL, "webp : libwebp fails with error %d", code);
}
