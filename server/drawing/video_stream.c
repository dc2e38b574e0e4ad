/* The video of one stream: see video_stream.h.
 *
 * Quality follows the line without an estimate of its rate. What counts is how long a frame waits
 * until the socket has taken its last byte. If that is more than SEND_S, the next ones are coarser,
 * and smaller when they cannot be coarser.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/drawing/video_stream.h"

#include <math.h>

#include "codec/image/video.h"

enum {
    VIDEO_STREAM_FINEST = 22, /* at JPEG_FINEST; equal SSIM: docs/decisions/027-streams.md */
    VIDEO_STREAM_COARSEST = 54,
    VIDEO_STREAM_JPEG_FINEST = 60,
    VIDEO_STREAM_STEPS = 13, /* of sizes */
    VIDEO_STREAM_LARGER = 8, /* frames after which a larger size is taken */
    VIDEO_STREAM_SMALLER = 3
};
enum { VIDEO_STREAM_TOLD_KEY = 1, VIDEO_STREAM_TOLD_OPENED = 2, VIDEO_STREAM_TOLD_BITS = 2 };
static const double VIDEO_STREAM_SEND_S = 0.05;
static const double VIDEO_STREAM_LEAST_PX = 20000, VIDEO_STREAM_MOST_PX = 1e6;
static const double VIDEO_STREAM_LEARN = 0.2; /* part of a new frame in the mean */
/* Each has 0.7 of the pixels of the one before: a frame of half the time that it may take can be
 * larger, whatever part of that time does not depend on its size. */
static const double video_stream_step[VIDEO_STREAM_STEPS] = {
    1, 0.84, 0.71, 0.59, 0.5, 0.42, 0.35, 0.30, 0.25, 0.21, 0.18, 0.15, 0.125};

struct video_stream {
    struct video_stream_room *room;
    _Atomic int refs;
    /* of the streams */
    int quantizer, last_quantizer;  /* of the next frame, by the line alone; of the newest */
    unsigned step, larger, smaller; /* the size, and how often another one was better */
    double area_px;                 /* that is made in time; 0: not known yet */
    double line_px;                 /* that the line takes */
    double last_px;
    uint32_t wish_px[2];
    bool need_key;
    size_t reserved_bytes;
    /* of the thread that draws */
    struct video *video;
    uint32_t width_px, height_px; /* of the encoder */
    _Atomic uint64_t told;        /* microseconds, above VIDEO_STREAM_TOLD_* */
};

struct video_stream *video_stream_begin(struct video_stream_room *room)
{
    struct video_stream *f = mem_array(1, sizeof *f);
    if (!f)
        return NULL;
    f->room = room;
    f->quantizer = VIDEO_STREAM_FINEST;
    f->line_px = VIDEO_STREAM_MOST_PX;
    atomic_init(&f->refs, 1);
    return f;
}

struct video_stream *video_stream_ref(struct video_stream *f)
{
    if (f)
        atomic_fetch_add(&f->refs, 1);
    return f;
}

static void video_stream_shut(struct video_stream *f)
{
    if (f->video)
        atomic_fetch_sub(&f->room->encoders, 1);
    video_close(&f->video);
}

void video_stream_drop(struct video_stream **out)
{
    struct video_stream *f = *out;
    *out = NULL;
    if (!f || atomic_fetch_sub(&f->refs, 1) > 1)
        return;
    atomic_fetch_sub(&f->room->held_bytes, f->reserved_bytes);
    video_stream_shut(f);
    mem_free(f);
}

struct hash128 video_stream_id(struct video_stream *f)
{
    const uint64_t name[3] = {0x6d6c6966, (uintptr_t)f->room,
                              atomic_fetch_add(&f->room->serial, 1)};
    return hash_bytes(name, sizeof name);
}

/* ---- size and quality ---- */

/* The largest step of at most this factor. */
static unsigned video_stream_step_of(double factor)
{
    unsigned i = 0;
    while (i + 1 < VIDEO_STREAM_STEPS && video_stream_step[i] > factor)
        i++;
    return i;
}

static void video_stream_choose_step(struct video_stream *f, double factor)
{
    const unsigned want = video_stream_step_of(factor);
    f->larger = want < f->step ? f->larger + 1 : 0;
    f->smaller = want > f->step ? f->smaller + 1 : 0;
    if (f->larger < VIDEO_STREAM_LARGER && f->smaller < VIDEO_STREAM_SMALLER)
        return;
    f->step = want;
    f->larger = f->smaller = 0;
}

/* Memory of an encoder of this size, in place of what this video has. */
static bool video_stream_reserve(struct video_stream *f, uint32_t width_px, uint32_t height_px)
{
    struct video_stream_room *room = f->room;
    const size_t bytes = video_room(width_px, height_px), had = f->reserved_bytes;
    size_t held = atomic_load(&room->held_bytes);
    if (bytes == had)
        return true;
    do
        if (held - had + bytes > room->limit_bytes)
            return false;
    while (!atomic_compare_exchange_weak(&room->held_bytes, &held, held - had + bytes));
    f->reserved_bytes = bytes;
    return true;
}

static uint32_t video_stream_side(uint32_t side_px, double factor)
{
    return (uint32_t)fmax(1, round(side_px * factor));
}

bool video_stream_next(struct video_stream *f, uint32_t width_px, uint32_t height_px,
                       double area_px, int quality, struct video_stream_shot *out)
{
    const double area = fmin(f->area_px > 0 ? f->area_px : area_px, f->line_px);
    const double factor = sqrt(area / ((double)width_px * height_px));
    if (f->wish_px[0] != width_px || f->wish_px[1] != height_px)
        f->step = video_stream_step_of(factor);
    else
        video_stream_choose_step(f, factor);
    f->wish_px[0] = width_px;
    f->wish_px[1] = height_px;
    const int coarser =
                  quality < VIDEO_STREAM_JPEG_FINEST ? (VIDEO_STREAM_JPEG_FINEST - quality) / 2 : 0,
              quantizer = f->quantizer + coarser;
    *out = (struct video_stream_shot){
        video_stream_side(width_px, video_stream_step[f->step]),
        video_stream_side(height_px, video_stream_step[f->step]),
        quantizer < VIDEO_STREAM_COARSEST ? quantizer : VIDEO_STREAM_COARSEST, f->need_key};
    if (!video_can() || out->width_px > VIDEO_SIDE_MAX || out->height_px > VIDEO_SIDE_MAX ||
        !video_stream_reserve(f, out->width_px, out->height_px))
        return false;
    f->last_px = (double)out->width_px * out->height_px;
    f->last_quantizer = out->quantizer;
    f->need_key = true; /* until it is known that the reader gets this one */
    return true;
}

double video_stream_shown(struct video_stream *f, double draw_s, double wanted_s,
                          struct video_stream_told *out)
{
    const uint64_t told = atomic_load(&f->told);
    const double area = f->last_px * fmin(4, wanted_s / fmax(draw_s, 1e-3));
    f->need_key = false;
    *out = (struct video_stream_told){f->last_quantizer, told & VIDEO_STREAM_TOLD_KEY,
                                      (double)(told >> VIDEO_STREAM_TOLD_BITS) * 1e-6};
    /* To open an encoder takes a busy machine as long as many frames. If that counted, one change
     * of size would be followed by others, to smaller ones. */
    if (!(told & VIDEO_STREAM_TOLD_OPENED))
        f->area_px = f->area_px > 0 ? f->area_px + VIDEO_STREAM_LEARN * (area - f->area_px) : area;
    if (f->area_px > 0)
        f->area_px = fmin(VIDEO_STREAM_MOST_PX, fmax(VIDEO_STREAM_LEAST_PX, f->area_px));
    return f->area_px > 0 ? f->area_px : f->last_px;
}

void video_stream_sent(struct video_stream *f, double sent_s)
{
    enum { MUCH = 8, MORE = 3 };
    const int most = VIDEO_STREAM_COARSEST;
    if (sent_s > VIDEO_STREAM_SEND_S && f->quantizer == most)
        f->line_px = fmax(VIDEO_STREAM_LEAST_PX, 0.7 * fmin(f->line_px, f->last_px));
    else if (sent_s > VIDEO_STREAM_SEND_S)
        f->quantizer += sent_s > 2 * VIDEO_STREAM_SEND_S ? MUCH : MORE;
    else if (f->quantizer > VIDEO_STREAM_FINEST)
        f->quantizer -= sent_s < VIDEO_STREAM_SEND_S / 2;
    f->quantizer = f->quantizer < most ? f->quantizer : most;
    if (f->quantizer < (VIDEO_STREAM_FINEST + most) / 2)
        f->line_px = fmin(VIDEO_STREAM_MOST_PX, 1.05 * f->line_px);
}

void video_stream_need_key(struct video_stream *f)
{
    f->need_key = true;
}

/* ---- encoding ---- */

static enum err_code video_stream_open(struct video_stream *f, const struct video_stream_shot *shot,
                                       struct err *e)
{
    video_stream_shut(f);
    enum err_code rc = video_open(shot->width_px, shot->height_px, f->room->threads, &f->video, e);
    if (rc)
        return rc;
    atomic_fetch_add(&f->room->encoders, 1);
    f->width_px = shot->width_px;
    f->height_px = shot->height_px;
    return ERR_OK;
}

enum err_code video_stream_encode(struct video_stream *f, const struct video_stream_shot *shot,
                                  const void *planes, size_t n, struct buf *out, struct err *e)
{
    const double start_s = clock_s();
    bool key = shot->key, opened = false;
    if (n != video_planes_bytes(shot->width_px, shot->height_px))
        return err_set(e, ERR_FORMAT, "a picture of %zu bytes, not of %u x %u px", n,
                       (unsigned)shot->width_px, (unsigned)shot->height_px);
    if (!f->video || f->width_px != shot->width_px || f->height_px != shot->height_px) {
        enum err_code rc = video_stream_open(f, shot, e);
        if (rc)
            return rc;
        opened = true;
    }
    enum err_code rc = video_encode(f->video, planes, shot->quantizer, &key, out, e);
    if (rc) { /* it may have lost track of its frames */
        video_stream_shut(f);
        return rc;
    }
    const uint64_t us = (uint64_t)((clock_s() - start_s) * 1e6);
    atomic_store(&f->told, us << VIDEO_STREAM_TOLD_BITS | (key ? VIDEO_STREAM_TOLD_KEY : 0) |
                               (opened ? VIDEO_STREAM_TOLD_OPENED : 0));
    atomic_fetch_add(&f->room->frames, 1);
    atomic_fetch_add(&f->room->encode_us, us);
    return ERR_OK;
}
