/* Video of pictures that come one by one, as frames of VP9 by libvpx. Each picture is encoded at
 * once: no frame waits for a later frame or refers to a later one. A build without libvpx has no
 * video.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_VIDEO_H
#define CODEC_VIDEO_H

#include "codec/image/image.h"

/* Quantizers: 0 is finest. */
enum { VIDEO_QUANTIZER_MOST = 63, VIDEO_SIDE_MAX = 4096 };

struct video; /* an encoder; only one thread at a time may use it */

bool video_can(void); /* whether this build has it */
/* Upper limit of the memory of an encoder, without that of its output. */
size_t video_room(uint32_t width_px, uint32_t height_px);
/* Bytes of a picture in planes: Y, then U and V with half as many pixels on each axis (4:2:0). */
size_t video_planes_bytes(uint32_t width_px, uint32_t height_px);
/* Converts a picture of 3 channels to planes in `out`: BT.709, 16 to 235 and 16 to 240. */
void video_planes(const struct image *img, uint8_t *out);
/* Opens an encoder that may use some threads, at most 8. Close *out with video_close. ERR_ARG (a
 * size, or video_can() is false), ERR_MEM. */
enum err_code video_open(uint32_t width_px, uint32_t height_px, unsigned threads,
                         struct video **out, struct err *e) ERR_USE;
/* Encodes a picture in planes and appends the frame. *key: set it to ask for a key frame, which
 * refers to no other frame. On return it says whether the frame is one; the first always is.
 * ERR_ARG (quantizer), ERR_MEM, ERR_INTERNAL. */
enum err_code video_encode(struct video *v, const uint8_t *planes, int quantizer, bool *key,
                           struct buf *out, struct err *e) ERR_USE;
void video_close(struct video **v);

/* Decodes the frames of video_encode, for tests and benchmarks. Close *out with
 * video_decoder_close. ERR_ARG (video_can() is false), ERR_MEM, ERR_INTERNAL. */
struct video_decoder;
enum err_code video_decoder_open(struct video_decoder **out, struct err *e) ERR_USE;
/* Decodes the next frame [n] into a picture of 3 channels, which is allocated again if its size
 * differs; {0} is valid. ERR_FORMAT: the frame is damaged, or one before it is missing. ERR_MEM. */
enum err_code video_decode(struct video_decoder *d, const void *frame, size_t n, struct image *out,
                           struct err *e) ERR_USE;
void video_decoder_close(struct video_decoder **d);

#endif
