/* The video of one stream (motion.c): its encoder, what memory encoders may hold, and size and
 * quality of frames by what drawing and the line take.
 *
 * A film has three sides. What is marked [streams] is called with the lock of all streams held,
 * film_encode by the thread that draws, and the counts by any.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_FILM_H
#define SERVER_FILM_H

#include <stdatomic.h>

#include "core/base.h"

struct film_room {      /* of all films of a server */
    size_t limit_bytes; /* that their encoders may hold */
    unsigned threads;   /* of an encoder */
    _Atomic size_t held_bytes;
    _Atomic uint64_t encoders, frames, encode_us, serial;
};
struct film; /* reference-counted */
struct film_shot {
    uint32_t width_px, height_px;
    int quantizer; /* codec/video.h */
    bool key;      /* the reader lacks what other frames refer to */
};
struct film_told { /* of the newest frame */
    int quantizer;
    bool key;
    double encode_s;
};

/* NULL: out of memory. The room is borrowed, and is there until the last film is dropped. */
struct film *film_begin(struct film_room *room);
struct film *film_ref(struct film *f);
void film_drop(struct film **f);
/* A name that no other picture has: of a frame that nobody else can use. */
struct hash128 film_id(struct film *f);

/* [streams] The next frame of a wished size, of about area_px; its quality is that of a JPEG of
 * `quality`, or less where the line is slow. Its size changes seldom, because each change costs a
 * key frame. False: there is no memory for an encoder of this size. */
bool film_next(struct film *f, uint32_t width_px, uint32_t height_px, double area_px, int quality,
               struct film_shot *out);
/* [streams] It was drawn and encoded, in draw_s, and is being read. The result is the area that is
 * made in wanted_s, by the last frames. */
double film_shown(struct film *f, double draw_s, double wanted_s, struct film_told *out);
/* [streams] It is in the socket, after sent_s. */
void film_sent(struct film *f, double sent_s);
/* [streams] The next frame has to be a key frame. */
void film_need_key(struct film *f);

/* Appends the frame of a picture in planes [n]. ERR_FORMAT: n is wrong. ERR_MEM, ERR_INTERNAL. */
enum err_code film_encode(struct film *f, const struct film_shot *shot, const void *planes,
                          size_t n, struct buf *out, struct err *e) ERR_USE;

#endif
