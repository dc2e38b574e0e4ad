/* Pictures of a camera that turns, as JPEG by themselves and as frames of a video: bytes at equal
 * SSIM, and the time of encoding. The camera turns by one degree a picture, as it does in a stream
 * of 20 pictures a second at 20 degrees a second (bench_motion.c). --tiles names a store; else the
 * procedural city is drawn.
 *
 * SSIM is that against the picture before it was encoded. The bytes of the video at the SSIM of the
 * JPEG are read off the line between the two quantizers beside it. The first frame, a key frame, is
 * told by itself.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/image.h"
#include "codec/image/video.h"
#include "core/geo/geo.h"
#include "lab/bench/bench.h"
#include "lab/server/load.h"
#include "lod/choose/pick.h"
#include "lod/choose/view.h"
#include "lod/store/store.h"
#include "render/render.h"
#include "train/loss/metric.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { VIDEO_PICTURES = 24, VIDEO_QUANTIZERS = 6, VIDEO_JPEG = 60 };
static const int video_quantizers[VIDEO_QUANTIZERS] = {12, 20, 28, 36, 44, 52};
static const double VIDEO_TURN_DEG = 1, VIDEO_PITCH_DEG = -35, VIDEO_FOV_DEG = 60;

struct shots { /* the pictures of one size, and what was measured of one way to encode them */
    struct image picture[VIDEO_PICTURES];
    double ssim, ms;     /* means */
    size_t first, bytes; /* of the first picture, of all others */
};

static enum err_code video_likeness(const struct image *img, const struct image *as_drawn,
                                    double *ssim, struct err *e)
{
    const size_t n = (size_t)img->width_px * img->height_px * 3;
    float *rgb = mem_uninit(n, sizeof *rgb);
    if (!rgb)
        return err_set(e, ERR_MEM, "bench_video: out of memory");
    for (size_t i = 0; i < n; i++)
        rgb[i] = (float)img->px[i] / 255.0f;
    enum err_code rc = metric_ssim(rgb, as_drawn->px, NULL, img->width_px, img->height_px,
                                   METRIC_TRAINING, ssim, e);
    mem_free(rgb);
    return rc;
}

/* ---- the pictures ---- */

static enum err_code video_shoot(struct view *v, struct shots *s, uint32_t width, uint32_t height,
                                 struct err *e)
{
    const struct store_meta *meta = store_info(view_store(v));
    const struct render_options ro = {.aa = meta->antialiased ? RENDER_AA_2D : RENDER_AA_NONE,
                                      .sh_degree = -1};
    const struct pick_options po = {.max_gaussians = 1200000};
    const size_t n = (size_t)width * height * 3;
    float *rgb = mem_array(n, sizeof *rgb);
    enum err_code rc = rgb ? ERR_OK : err_set(e, ERR_MEM, "bench_video: out of memory");
    for (int k = 0; k < VIDEO_PICTURES && !rc; k++) {
        const struct view_pose pose = {.lon_deg = meta->origin.lon_deg,
                                       .lat_deg = meta->origin.lat_deg,
                                       .h_m = meta->origin.h_m + 100,
                                       .heading_deg = VIDEO_TURN_DEG * k,
                                       .pitch_deg = VIDEO_PITCH_DEG,
                                       .fov_y_deg = VIDEO_FOV_DEG};
        struct camera cam;
        rc = view_camera(&meta->origin, &pose, width, height, &cam, e);
        if (!rc)
            rc = view_render(v, &cam, &ro, &po, rgb, NULL, e);
        if (!rc)
            rc = image_alloc(width, height, 3, &s->picture[k], e);
        for (size_t i = 0; i < n && !rc; i++)
            s->picture[k].px[i] = (uint8_t)(fminf(fmaxf(rgb[i], 0), 1) * 255 + 0.5f);
    }
    mem_free(rgb);
    return rc;
}

/* ---- two ways to encode them ---- */

static void video_count(struct shots *s, int k, size_t bytes, double seconds, double ssim)
{
    if (k)
        s->bytes += bytes;
    else
        s->first = bytes;
    s->ms += seconds * 1e3 / VIDEO_PICTURES;
    s->ssim += ssim / VIDEO_PICTURES;
}

static enum err_code video_as_jpeg(struct bench *b, struct shots *s, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct buf out = {0};
    enum err_code rc = file_join(path, bench_tmpdir(b), "video.jpg", e);
    s->ssim = s->ms = 0;
    s->bytes = 0;
    for (int k = 0; k < VIDEO_PICTURES && !rc; k++) {
        struct image back = {0};
        double ssim = 0;
        out.size = 0;
        double start_s = clock_cpu_s();
        rc = image_encode(&s->picture[k], "jpg", VIDEO_JPEG, &out, e);
        double seconds = clock_cpu_s() - start_s;
        if (!rc)
            rc = file_write(path, out.data, out.size, e);
        if (!rc)
            rc = image_read(path, NULL, &back, e);
        if (!rc)
            rc = video_likeness(&back, &s->picture[k], &ssim, e);
        image_free(&back);
        video_count(s, k, out.size, seconds, ssim);
    }
    buf_free(&out);
    return rc;
}

static enum err_code video_as_frames(struct shots *s, int quantizer, struct err *e)
{
    const uint32_t width = s->picture[0].width_px, height = s->picture[0].height_px;
    struct video *v = NULL;
    struct video_decoder *d = NULL;
    struct image back = {0};
    struct buf out = {0};
    uint8_t *planes = mem_array(1, video_planes_bytes(width, height));
    enum err_code rc = planes ? video_open(width, height, 2, &v, e)
                              : err_set(e, ERR_MEM, "bench_video: out of memory");
    if (!rc)
        rc = video_decoder_open(&d, e);
    s->ssim = s->ms = 0;
    s->bytes = 0;
    for (int k = 0; k < VIDEO_PICTURES && !rc; k++) {
        bool key = false;
        double ssim = 0;
        out.size = 0;
        double start_s = clock_cpu_s();
        video_planes(&s->picture[k], planes);
        rc = video_encode(v, planes, quantizer, &key, &out, e);
        double seconds = clock_cpu_s() - start_s;
        if (!rc)
            rc = video_decode(d, out.data, out.size, &back, e);
        if (!rc)
            rc = video_likeness(&back, &s->picture[k], &ssim, e);
        video_count(s, k, out.size, seconds, ssim);
    }
    image_free(&back);
    video_decoder_close(&d);
    video_close(&v);
    buf_free(&out);
    mem_free(planes);
    return rc;
}

/* ---- report ---- */

static void video_report(struct bench *b, uint32_t width, uint32_t height, const char *what,
                         double value, const char *unit)
{
    char name[96];
    snprintf(name, sizeof name, "%u x %u: %s", width, height, what);
    bench_report(b, name, value, unit, 0, NULL);
}

static enum err_code video_size(struct bench *b, struct view *v, uint32_t width, uint32_t height,
                                struct err *e)
{
    struct shots *s = mem_array(1, sizeof *s);
    double kb[VIDEO_QUANTIZERS], ssim[VIDEO_QUANTIZERS], ms[VIDEO_QUANTIZERS],
        key[VIDEO_QUANTIZERS];
    const double others = 1e3 * (VIDEO_PICTURES - 1);
    enum err_code rc =
        s ? video_shoot(v, s, width, height, e) : err_set(e, ERR_MEM, "bench_video: out of memory");
    if (!rc)
        rc = video_as_jpeg(b, s, e);
    const double jpeg_kb = rc ? 0 : (double)s->bytes / others, jpeg_ssim = rc ? 0 : s->ssim,
                 jpeg_ms = rc ? 0 : s->ms;
    for (int i = 0; i < VIDEO_QUANTIZERS && !rc; i++) {
        rc = video_as_frames(s, video_quantizers[i], e);
        kb[i] = (double)s->bytes / others;
        key[i] = (double)s->first / 1e3;
        ssim[i] = s->ssim;
        ms[i] = s->ms;
    }
    for (int k = 0; s && k < VIDEO_PICTURES; k++)
        image_free(&s->picture[k]);
    mem_free(s);
    if (rc)
        return rc;
    int i = 0; /* between this quantizer and the next */
    while (i + 2 < VIDEO_QUANTIZERS && ssim[i + 1] > jpeg_ssim)
        i++;
    const double t = (ssim[i] - jpeg_ssim) / fmax(ssim[i] - ssim[i + 1], 1e-9);
    const double equal_kb = kb[i] * pow(kb[i + 1] / kb[i], t);
    video_report(b, width, height, "SSIM of JPEG 60", jpeg_ssim, "");
    video_report(b, width, height, "JPEG 60, a picture", jpeg_kb, "kB");
    video_report(b, width, height, "VP9 at equal SSIM, a picture", equal_kb, "kB");
    video_report(b, width, height, "VP9 at equal SSIM, quantizer",
                 video_quantizers[i] + t * (video_quantizers[i + 1] - video_quantizers[i]), "");
    video_report(b, width, height, "VP9 at about equal SSIM, a key frame", key[i], "kB");
    video_report(b, width, height, "20 a second as JPEG 60", 20 * jpeg_kb, "kB/s");
    video_report(b, width, height, "20 a second as VP9 at equal SSIM", 20 * equal_kb, "kB/s");
    video_report(b, width, height, "encoding JPEG 60, processor time", jpeg_ms, "ms");
    video_report(b, width, height, "encoding VP9, processor time", ms[i], "ms");
    return ERR_OK;
}

enum err_code bench_video(struct bench *b, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct render *render = NULL;
    struct view *v = NULL;
    if (!video_can())
        return err_set(e, ERR_ARG, "bench_video: this program was built without libvpx");
    if (!b->dev)
        return err_set(e, ERR_DEVICE, "bench_video: no OpenCL device");
    enum err_code rc = file_join(path, bench_tmpdir(b), "video.tiles", e);
    if (!rc && !b->tiles)
        rc = load_city(path, b->quick ? 50000 : 1000000, e);
    if (!rc)
        rc = render_open(b->dev, &render, e);
    if (!rc)
        rc = view_open(b->tiles ? b->tiles : path, render, 0, &v, e);
    if (!rc)
        rc = video_size(b, v, 640, 360, e);
    if (!rc && !b->quick)
        rc = video_size(b, v, 1280, 720, e);
    view_close(&v);
    render_close(&render);
    return rc;
}
