/* The payload of a tile in the store. Functions may be called from any thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_PAYLOAD_H
#define CODEC_PAYLOAD_H

#include "core/base.h"
#include "core/gauss.h"

struct codec_limits;

/* Convert n values to the float16 of a payload and back. They round to nearest even; a value beyond
 * float16's range becomes the largest one. They cannot fail. */
void payload_to_float16(const float *in, size_t n, uint16_t *out);
void payload_from_float16(const uint16_t *in, size_t n, float *out);
/* Rounds n harmonics to multiples of 2^-9, as a payload does before float16. */
void payload_round_sh(float *sh, size_t n);
/* The rotation that a payload stores, before it is rounded. q_wxyz is finite and not 0. */
void payload_unit_quat(const float q_wxyz[4], float out[4]);
/* Appends the payload of a tile to `out`, in ENU axes, compressed by zstd. Means are float32
 * relative to the tile's centre. Other values are float16, and harmonics are rounded to multiples
 * of 2^-9 before. With `lossless` all values are float32. Encoding decoded rows gives the same
 * bytes. ERR_DATA (a value is not finite), ERR_LIMIT, ERR_MEM. */
enum err_code payload_encode(const struct gauss *g, bool lossless, struct buf *out,
                             struct err *e) ERR_USE;
/* Reads a payload. Hostile bytes are safe. Free *out with gauss_free; it is empty on errors.
 * ERR_FORMAT, ERR_LIMIT, ERR_MEM. */
enum err_code payload_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                             struct gauss *out, struct err *e) ERR_USE;
#endif
