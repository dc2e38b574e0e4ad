/* The video of one stream (motion.c): its encoder, the memory that encoders may hold, and the size
 * and quality of frames, by the time that drawing and sending take.
 *
 * Functions marked [streams] are called with the lock of all streams held, film_encode by the
 * thread that draws. Any thread may read the counts.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_FILM_H
#define SERVER_FILM_H

#include <stdatomic.h>

#include "core/base.h"

struct film_room {      /* shared by all films of a server */
    size_t limit_bytes; /* most that their encoders may hold */
    unsigned threads;   /* of an encoder */
    _Atomic size_t held_bytes;
    _Atomic uint64_t encoders, frames, encode_us, serial;
};
struct film; /* reference-counted */
struct film_shot {
    uint32_t width_px, height_px;
    int quantizer; /* codec/video.h */
    bool key;      /* the reader lacks the frame that other frames refer to */
};
struct film_told { /* of the newest frame */
    int quantizer;
    bool key;
    double encode_s;
};

/* NULL: out of memory. The room is borrowed until the last film is dropped. */
struct film *film_begin(struct film_room *room);
struct film *film_ref(struct film *f);
void film_drop(struct film **f);
/* A name that no other picture has, for a frame that nobody else can use. */
struct hash128 film_id(struct film *f);

/* [streams] Plans the next frame for a requested size, with about area_px pixels. Its quality is
 * that of a JPEG of `quality`, or less where the line is slow. Its size changes seldom, because
 * each change costs a key frame. False: there is no memory for an encoder of this size. */
bool film_next(struct film *f, uint32_t width_px, uint32_t height_px, double area_px, int quality,
               struct film_shot *out);
/* [streams] Notes that the frame was drawn and encoded in draw_s, and is being read. Returns the
 * area that can be made in wanted_s, judged by the last frames. */
double film_shown(struct film *f, double draw_s, double wanted_s, struct film_told *out);
/* [streams] Notes that the frame is in the socket, after sent_s. */
void film_sent(struct film *f, double sent_s);
/* [streams] The next frame has to be a key frame. */
void film_need_key(struct film *f);

/* Appends the frame of a picture in planes [n]. ERR_FORMAT: n is wrong. ERR_MEM, ERR_INTERNAL. */
enum err_code film_encode(struct film *f, const struct film_shot *shot, const void *planes,
                          size_t n, struct buf *out, struct err *e) ERR_USE;

#endif
