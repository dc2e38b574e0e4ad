/* The master payload of a tile in the store.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_PAYLOAD_H
#define CODEC_PAYLOAD_H

#include "core/base.h"
#include "core/gauss.h"

struct codec_limits;

/* Values [n] to and from the float16 that a payload keeps: nearest even, the largest for what is
 * beyond. No errors, any thread, as all here. */
void payload_to_float16(const float *in, size_t n, uint16_t *out);
void payload_from_float16(const uint16_t *in, size_t n, float *out);
/* The harmonics [n] that a payload keeps, before their rounding to float16: multiples of 2^-9. */
void payload_round_sh(float *sh, size_t n);
/* The rotation that a payload keeps, before its rounding. q is finite and not 0. */
void payload_unit_quat(const float q_wxyz[4], float out[4]);
/* The master payload of a tile: float32 means relative to the tile centre, float16 elsewhere, of
 * harmonics those nearest to multiples of 2^-9; with `lossless` all is float32. zstd. ENU axes.
 * Rows that were decoded from a payload give the same payload again. out: appended to. ERR_DATA
 * (not finite), ERR_LIMIT, ERR_MEM. */
enum err_code payload_encode(const struct gauss *g, bool lossless, struct buf *out,
                             struct err *e) ERR_USE;
/* Hostile bytes are safe. gauss_free it; empty on errors. ERR_FORMAT, ERR_LIMIT, ERR_MEM. */
enum err_code payload_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                             struct gauss *out, struct err *e) ERR_USE;
#endif
