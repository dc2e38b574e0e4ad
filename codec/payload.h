/* The master payload of a tile in the store.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_PAYLOAD_H
#define CODEC_PAYLOAD_H

#include "core/base.h"
#include "core/gauss.h"

struct codec_limits;

/* Master payload of a tile in the store: float32 mean relative to the tile centre, half floats
 * elsewhere (opacity, scale and rotation float32 where lossless is set), zstd. ENU axes. */
/* Values to and from the half floats that a payload keeps: nearest even, the largest for what is
 * beyond. */
void payload_to_float16(const float *in, size_t n, uint16_t *out);
void payload_from_float16(const uint16_t *in, size_t n, float *out);
/* The rotation that a payload keeps, before its rounding. q is finite and not 0. */
void payload_unit_quat(const float q_wxyz[4], float out[4]);
/* Rows that were rounded by these give the same payload as before. */
enum err_code payload_encode(const struct gauss *g, bool lossless, struct buf *out,
                             struct err *e) ERR_USE;
enum err_code payload_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                             struct gauss *out, struct err *e) ERR_USE;
#endif
