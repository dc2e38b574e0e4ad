/* Frames of VP9 back to pictures: see video.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/video.h"

#ifdef CITYSPLAT_VPX
#include <math.h>

#include <vpx/vp8dx.h>
#include <vpx/vpx_decoder.h>

struct video_decoder {
    vpx_codec_ctx_t codec;
};

enum err_code video_decoder_open(struct video_decoder **out, struct err *e)
{
    struct video_decoder *d = *out = mem_array(1, sizeof *d);
    if (!d)
        return err_set(e, ERR_MEM, "video: out of memory");
    if (!vpx_codec_dec_init(&d->codec, vpx_codec_vp9_dx(), NULL, 0))
        return ERR_OK;
    mem_free(d);
    *out = NULL;
    return err_set(e, ERR_INTERNAL, "video: libvpx has no decoder of VP9");
}

static uint8_t video_byte(double v)
{
    return (uint8_t)lrint(fmin(fmax(v, 0.0), 255.0));
}

static void video_colours(const vpx_image_t *img, struct image *out)
{
    uint8_t *to = out->px;
    for (size_t y = 0; y < out->height_px; y++)
        for (size_t x = 0; x < out->width_px; x++, to += 3) {
            const double l = (img->planes[0][y * (size_t)img->stride[0] + x] - 16) * (255.0 / 219);
            const size_t at = y / 2 * (size_t)img->stride[1] + x / 2;
            const double u = (img->planes[1][at] - 128) * (255.0 / 224),
                         v = (img->planes[2][at] - 128) * (255.0 / 224);
            to[0] = video_byte(l + 1.5748 * v);
            to[1] = video_byte(l - 0.1873 * u - 0.4681 * v);
            to[2] = video_byte(l + 1.8556 * u);
        }
}

enum err_code video_decode(struct video_decoder *d, const void *frame, size_t n, struct image *out,
                           struct err *e)
{
    vpx_codec_iter_t iter = NULL;
    const bool ok = n < UINT32_MAX && !vpx_codec_decode(&d->codec, frame, (unsigned)n, NULL, 0);
    const vpx_image_t *img = ok ? vpx_codec_get_frame(&d->codec, &iter) : NULL;
    if (!img || img->fmt != VPX_IMG_FMT_I420)
        return err_set(e, ERR_FORMAT, "video: %zu bytes that are no frame here", n);
    if (img->d_w != out->width_px || img->d_h != out->height_px || out->channels != 3) {
        image_free(out);
        enum err_code rc = image_alloc(img->d_w, img->d_h, 3, out, e);
        if (rc)
            return rc;
    }
    video_colours(img, out);
    return ERR_OK;
}

void video_decoder_close(struct video_decoder **d)
{
    if (*d)
        (void)vpx_codec_destroy(&(*d)->codec);
    mem_free(*d);
    *d = NULL;
}

#else

enum err_code video_decoder_open(struct video_decoder **out, struct err *e)
{
    *out = NULL;
    return err_set(e, ERR_ARG, "video: this program was built without libvpx");
}

enum err_code video_decode(struct video_decoder *d, const void *frame, size_t n, struct image *out,
                           struct err *e)
{
    (void)d, (void)frame, (void)n, (void)out;
    return err_set(e, ERR_ARG, "video: this program was built without libvpx");
}

void video_decoder_close(struct video_decoder **d)
{
    *d = NULL;
}

#endif
