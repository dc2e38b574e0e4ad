/* The video of one stream (view_stream.c): its encoder, the memory that encoders may hold, and the
 * size and quality of frames, by the time that drawing and sending take.
 *
 * Functions marked [streams] are called with the lock of all streams held, video_stream_encode by
 * the thread that draws. Any thread may read the counts.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_VIDEO_STREAM_H
#define SERVER_VIDEO_STREAM_H

#include <stdatomic.h>

#include "core/base.h"

struct video_stream_room { /* shared by all videos of a server */
    size_t limit_bytes;    /* most that their encoders may hold */
    unsigned threads;      /* of an encoder */
    _Atomic size_t held_bytes;
    _Atomic uint64_t encoders, frames, encode_us, serial;
};
struct video_stream; /* reference-counted */
struct video_stream_shot {
    uint32_t width_px, height_px;
    int quantizer; /* codec/image/video.h */
    bool key;      /* the reader lacks the frame that other frames refer to */
};
struct video_stream_told { /* of the newest frame */
    int quantizer;
    bool key;
    double encode_s;
};

/* NULL: out of memory. The room is borrowed until the last video is dropped. */
struct video_stream *video_stream_begin(struct video_stream_room *room);
struct video_stream *video_stream_ref(struct video_stream *f);
void video_stream_drop(struct video_stream **f);
/* A name that no other picture has, for a frame that nobody else can use. */
struct hash128 video_stream_id(struct video_stream *f);

/* [streams] Plans the next frame for a requested size, with about area_px pixels. Its quality is
 * that of a JPEG of `quality`, or less where the line is slow. Its size changes seldom, because
 * each change costs a key frame. False: there is no memory for an encoder of this size. */
bool video_stream_next(struct video_stream *f, uint32_t width_px, uint32_t height_px,
                       double area_px, int quality, struct video_stream_shot *out);
/* [streams] Notes that the frame was drawn and encoded in draw_s, and is being read. Returns the
 * area that can be made in wanted_s, judged by the last frames. */
double video_stream_shown(struct video_stream *f, double draw_s, double wanted_s,
                          struct video_stream_told *out);
/* [streams] Notes that the frame is in the socket, after sent_s. */
void video_stream_sent(struct video_stream *f, double sent_s);
/* [streams] The next frame has to be a key frame. */
void video_stream_need_key(struct video_stream *f);

/* Appends the frame of a picture in planes [n]. ERR_FORMAT: n is wrong. ERR_MEM, ERR_INTERNAL. */
enum err_code video_stream_encode(struct video_stream *f, const struct video_stream_shot *shot,
                                  const void *planes, size_t n, struct buf *out,
                                  struct err *e) ERR_USE;

#endif
