/* VP9 by libvpx: see video.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/video.h"

#ifdef CITYSPLAT_VPX
#include <vpx/vp8cx.h>
#include <vpx/vpx_encoder.h>
#endif

/* Measured: docs/decisions/027-streams.md. */
#define VIDEO_ROOM_FIXED ((size_t)20 << 20)
enum { VIDEO_ROOM_PIXEL = 76 };

size_t video_room(uint32_t width_px, uint32_t height_px)
{
    return VIDEO_ROOM_FIXED + (size_t)width_px * height_px * VIDEO_ROOM_PIXEL;
}

/* ---- planes ---- */

static size_t video_half(uint32_t n)
{
    return ((size_t)n + 1) / 2;
}

size_t video_planes_bytes(uint32_t width_px, uint32_t height_px)
{
    return (size_t)width_px * height_px + 2 * video_half(width_px) * video_half(height_px);
}

/* In 1/65536 of BT.709 with 219 and 224 steps. */
static void video_row_y(const uint8_t *rgb, size_t n, uint8_t *y)
{
    for (size_t i = 0; i < n; i++)
        y[i] = (uint8_t)((11966 * rgb[3 * i] + 40254 * rgb[3 * i + 1] + 4064 * rgb[3 * i + 2] +
                          (16 << 16) + 32768) >>
                         16);
}

/* Two rows, which may be one and the same at the lower edge. */
static void video_row_uv(const uint8_t *a, const uint8_t *b, size_t width, uint8_t *u, uint8_t *v)
{
    for (size_t i = 0; i < width / 2; i++) {
        const uint8_t *p = a + 6 * i, *q = b + 6 * i;
        const int red = p[0] + p[3] + q[0] + q[3], green = p[1] + p[4] + q[1] + q[4],
                  blue = p[2] + p[5] + q[2] + q[5];
        u[i] = (uint8_t)((-6596 * red - 22189 * green + 28785 * blue + (512 << 16) + 131072) >> 18);
        v[i] = (uint8_t)((28785 * red - 26145 * green - 2640 * blue + (512 << 16) + 131072) >> 18);
    }
    if (width % 2) {
        const size_t i = width / 2;
        const uint8_t *p = a + 6 * i, *q = b + 6 * i;
        const int red = p[0] + q[0], green = p[1] + q[1], blue = p[2] + q[2];
        u[i] = (uint8_t)((-6596 * red - 22189 * green + 28785 * blue + (256 << 16) + 65536) >> 17);
        v[i] = (uint8_t)((28785 * red - 26145 * green - 2640 * blue + (256 << 16) + 65536) >> 17);
    }
}

void video_planes(const struct image *img, uint8_t *out)
{
    const size_t w = img->width_px, h = img->height_px, half = video_half(img->width_px);
    uint8_t *u = out + w * h, *v = u + half * video_half(img->height_px);
    for (size_t y = 0; y < h; y++)
        video_row_y(img->px + 3 * w * y, w, out + w * y);
    for (size_t y = 0; y < h; y += 2) {
        const uint8_t *row = img->px + 3 * w * y;
        video_row_uv(row, y + 1 < h ? row + 3 * w : row, w, u + half * (y / 2), v + half * (y / 2));
    }
}

#ifdef CITYSPLAT_VPX

/* ---- encoder ---- */

enum {
    VIDEO_SPEED = 8, /* of 9; its pictures at equal SSIM are 3 % smaller than those of 9 */
    VIDEO_THREADS_MAX = 8,
    VIDEO_TICK = 1,       /* the clock of the frames counts frames: their times are not used */
    VIDEO_TILE_PX = 256,  /* least width of the columns that threads share out */
    VIDEO_KBPS = 1000000, /* no limit: the quantizer is given */
};

struct video {
    vpx_codec_ctx_t codec;
    vpx_codec_enc_cfg_t cfg;
    bool is_open;
    int64_t frames;
};

bool video_can(void)
{
    return true;
}

static enum err_code video_error(struct video *v, const char *what, vpx_codec_err_t code,
                                 struct err *e)
{
    const char *why = v->codec.err_detail ? v->codec.err_detail : vpx_codec_err_to_string(code);
    return err_set(e, code == VPX_CODEC_MEM_ERROR ? ERR_MEM : ERR_INTERNAL, "video: %s: %.150s",
                   what, why);
}

/* So many columns, as a power of two, as there are threads and as the width allows. */
static int video_columns_log2(uint32_t width_px, unsigned threads)
{
    int log2 = 0;
    while (2U << log2 <= threads && (2U << log2) * VIDEO_TILE_PX <= width_px)
        log2++;
    return log2;
}

static enum err_code video_set_up(struct video *v, struct err *e)
{
    const struct {
        int what, value;
    } set[] = {
        {VP8E_SET_CPUUSED, VIDEO_SPEED},
        {VP9E_SET_TILE_COLUMNS, video_columns_log2(v->cfg.g_w, v->cfg.g_threads)},
        {VP9E_SET_ROW_MT, v->cfg.g_threads > 1},
        {VP9E_SET_AQ_MODE, 0},
        {VP9E_SET_COLOR_SPACE, VPX_CS_BT_709},
        {VP9E_SET_COLOR_RANGE, VPX_CR_STUDIO_RANGE},
    };
    for (size_t i = 0; i < sizeof set / sizeof *set; i++) {
        const vpx_codec_err_t code =
            vpx_codec_control_(&v->codec, set[i].what, (unsigned)set[i].value);
        if (code)
            return video_error(v, "the encoder refuses a setting", code, e);
    }
    return ERR_OK;
}

enum err_code video_open(uint32_t width_px, uint32_t height_px, unsigned threads,
                         struct video **out, struct err *e)
{
    *out = NULL;
    if (!width_px || !height_px || width_px > VIDEO_SIDE_MAX || height_px > VIDEO_SIDE_MAX)
        return err_set(e, ERR_ARG, "video: %u x %u px: 1 to %d are expected", width_px, height_px,
                       VIDEO_SIDE_MAX);
    struct video *v = mem_array(1, sizeof *v);
    if (!v)
        return err_set(e, ERR_MEM, "video: out of memory");
    vpx_codec_enc_cfg_t *c = &v->cfg;
    vpx_codec_err_t code = vpx_codec_enc_config_default(vpx_codec_vp9_cx(), c, 0);
    c->g_w = width_px;
    c->g_h = height_px;
    c->g_threads = threads < 1 ? 1 : threads > VIDEO_THREADS_MAX ? VIDEO_THREADS_MAX : threads;
    c->g_timebase = (vpx_rational_t){1, 25};
    c->g_lag_in_frames = 0;
    c->rc_end_usage = VPX_CBR;
    c->rc_target_bitrate = VIDEO_KBPS;
    c->rc_dropframe_thresh = 0;
    c->kf_mode = VPX_KF_DISABLED; /* key frames are those that are asked for */
    if (!code)
        code = vpx_codec_enc_init(&v->codec, vpx_codec_vp9_cx(), c, 0);
    v->is_open = !code;
    enum err_code rc = code ? video_error(v, "no encoder", code, e) : video_set_up(v, e);
    if (rc)
        video_close(&v);
    *out = v;
    return rc;
}

void video_close(struct video **out)
{
    struct video *v = *out;
    *out = NULL;
    if (v && v->is_open)
        (void)vpx_codec_destroy(&v->codec);
    mem_free(v);
}

static enum err_code video_quantize(struct video *v, int quantizer, struct err *e)
{
    if (quantizer < 0 || quantizer > VIDEO_QUANTIZER_MOST)
        return err_set(e, ERR_ARG, "video: a quantizer of %d: 0 to %d is expected", quantizer,
                       VIDEO_QUANTIZER_MOST);
    const unsigned q = (unsigned)quantizer;
    if (v->frames && v->cfg.rc_min_quantizer == q)
        return ERR_OK;
    v->cfg.rc_min_quantizer = v->cfg.rc_max_quantizer = q;
    const vpx_codec_err_t code = vpx_codec_enc_config_set(&v->codec, &v->cfg);
    return code ? video_error(v, "no such quantizer", code, e) : ERR_OK;
}

enum err_code video_encode(struct video *v, const uint8_t *planes, int quantizer, bool *key,
                           struct buf *out, struct err *e)
{
    vpx_image_t img;
    vpx_codec_iter_t iter = NULL;
    const size_t had = out->size;
    const unsigned w = v->cfg.g_w, h = v->cfg.g_h;
    enum err_code rc = video_quantize(v, quantizer, e);
    if (rc)
        return rc;
    /* It is only read. */
    uint8_t *y = (uint8_t *)(uintptr_t)planes;
    if (!vpx_img_wrap(&img, VPX_IMG_FMT_I420, w, h, 1, y))
        return err_set(e, ERR_INTERNAL, "video: %u x %u px do not fit", w, h);
    img.planes[VPX_PLANE_Y] = y;
    img.planes[VPX_PLANE_U] = y + (size_t)w * h;
    img.planes[VPX_PLANE_V] = img.planes[VPX_PLANE_U] + video_half(w) * video_half(h);
    img.stride[VPX_PLANE_Y] = (int)w;
    img.stride[VPX_PLANE_U] = img.stride[VPX_PLANE_V] = (int)video_half(w);
    const vpx_codec_err_t code =
        vpx_codec_encode(&v->codec, &img, v->frames * VIDEO_TICK, VIDEO_TICK,
                         *key ? VPX_EFLAG_FORCE_KF : 0, VPX_DL_REALTIME);
    if (code)
        return video_error(v, "a picture is not encoded", code, e);
    v->frames++;
    for (const vpx_codec_cx_pkt_t *p; (p = vpx_codec_get_cx_data(&v->codec, &iter));)
        if (p->kind == VPX_CODEC_CX_FRAME_PKT) {
            *key = p->data.frame.flags & VPX_FRAME_IS_KEY;
            buf_add(out, p->data.frame.buf, p->data.frame.sz);
        }
    rc = buf_check(out, e);
    return rc                ? rc
           : out->size > had ? ERR_OK
                             : err_set(e, ERR_INTERNAL, "video: the encoder left a picture out");
}

#else

bool video_can(void)
{
    return false;
}

enum err_code video_open(uint32_t width_px, uint32_t height_px, unsigned threads,
                         struct video **out, struct err *e)
{
    (void)width_px, (void)height_px, (void)threads;
    *out = NULL;
    return err_set(e, ERR_ARG, "video: this program was built without libvpx");
}

enum err_code video_encode(struct video *v, const uint8_t *planes, int quantizer, bool *key,
                           struct buf *out, struct err *e)
{
    (void)v, (void)planes, (void)quantizer, (void)out;
    *key = false;
    return err_set(e, ERR_ARG, "video: this program was built without libvpx");
}

void video_close(struct video **v)
{
    *v = NULL;
}

#endif
