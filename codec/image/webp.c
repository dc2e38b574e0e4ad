/* WebP by libwebp: see webp.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/webp.h"

#include <webp/decode.h>
#include <webp/encode.h>

enum {
    WEBP_METHOD = 2, /* of 0, fast, to 6, small and many times slower */
    WEBP_EXACT = 1,  /* the same of what is lossless, 0 to 9 */
};

static int webp_write(const uint8_t *bytes, size_t n, const WebPPicture *picture)
{
    struct buf *out = picture->custom_ptr;
    buf_add(out, bytes, n);
    return !out->failed;
}

static enum err_code webp_write_all(const WebPConfig *config, const uint8_t *px, uint32_t width_px,
                                    uint32_t height_px, uint32_t channels, struct buf *out,
                                    struct err *e)
{
    WebPPicture picture;
    if (!WebPPictureInit(&picture))
        return err_set(e, ERR_INTERNAL, "webp: another version of libwebp than at compile time");
    picture.use_argb = config->lossless;
    picture.width = (int)width_px;
    picture.height = (int)height_px;
    picture.writer = webp_write;
    picture.custom_ptr = out;
    int stride = (int)(width_px * channels);
    int ok = channels == 4 ? WebPPictureImportRGBA(&picture, px, stride)
                           : WebPPictureImportRGB(&picture, px, stride);
    ok = ok && WebPEncode(config, &picture);
    int code = picture.error_code;
    WebPPictureFree(&picture);
    enum err_code rc = buf_check(out, e);
    if (rc || ok)
        return rc;
    return code == VP8_ENC_ERROR_OUT_OF_MEMORY
               ? err_set(e, ERR_MEM, "webp: out of memory")
               : err_set(e, ERR_INTERNAL, "webp: libwebp fails with error %d", code);
}

enum err_code webp_encode(const uint8_t *px, uint32_t width_px, uint32_t height_px,
                          uint32_t channels, int quality, struct buf *out, struct err *e)
{
    WebPConfig config;
    if (!width_px || !height_px || width_px > WEBP_MAX_DIMENSION ||
        height_px > WEBP_MAX_DIMENSION || (channels != 3 && channels != 4))
        return err_set(e, ERR_ARG, "webp: %u x %u px of %u channels: 1 to %d px, 3 or 4 channels",
                       width_px, height_px, channels, WEBP_MAX_DIMENSION);
    if (!WebPConfigPreset(&config, WEBP_PRESET_DEFAULT, (float)quality))
        return err_set(e, ERR_INTERNAL, "webp: another version of libwebp than at compile time");
    config.method = WEBP_METHOD;
    return webp_write_all(&config, px, width_px, height_px, channels, out, e);
}

enum err_code webp_encode_exact(const uint8_t *px, uint32_t width_px, uint32_t height_px,
                                struct buf *out, struct err *e)
{
    WebPConfig config;
    if (!width_px || !height_px || width_px > WEBP_MAX_DIMENSION || height_px > WEBP_MAX_DIMENSION)
        return err_set(e, ERR_ARG, "webp: %u x %u px: 1 to %d px", width_px, height_px,
                       WEBP_MAX_DIMENSION);
    if (!WebPConfigInit(&config) || !WebPConfigLosslessPreset(&config, WEBP_EXACT))
        return err_set(e, ERR_INTERNAL, "webp: another version of libwebp than at compile time");
    config.exact = 1; /* bytes under an alpha of 0 are data too */
    return webp_write_all(&config, px, width_px, height_px, 4, out, e);
}

enum err_code webp_decode(const void *bytes, size_t n, size_t most_px, uint8_t **px,
                          uint32_t *width_px, uint32_t *height_px, struct err *e)
{
    int w, h;
    *px = NULL;
    if (!WebPGetInfo(bytes, n, &w, &h) || w <= 0 || h <= 0)
        return err_set(e, ERR_FORMAT, "webp: no WebP picture");
    if ((size_t)w * (size_t)h > most_px)
        return err_set(e, ERR_LIMIT, "webp: %d x %d px: %zu px are expected at most", w, h,
                       most_px);
    uint8_t *out = mem_uninit((size_t)w * (size_t)h, 4);
    if (!out)
        return err_set(e, ERR_MEM, "webp: out of memory");
    if (!WebPDecodeRGBAInto(bytes, n, out, (size_t)w * (size_t)h * 4, 4 * w)) {
        mem_free(out);
        return err_set(e, ERR_FORMAT, "webp: damaged, or cut off");
    }
    *px = out;
    *width_px = (uint32_t)w;
    *height_px = (uint32_t)h;
    return ERR_OK;
}
