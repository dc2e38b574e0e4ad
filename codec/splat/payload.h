/* The payload of a tile in the store. Functions may be called from any thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_PAYLOAD_H
#define CODEC_PAYLOAD_H

#include "core/base.h"
#include "core/splat/gauss.h"

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

/* A payload that was unpacked, but not decoded. {0} is valid. It keeps its memory for the next
 * payload, until payload_free. */
struct payload {
    size_t n;
    uint32_t sh_degree, embed_len;
    bool lossless, antialiased;
    double origin_enu_m[3];
    struct buf plain;         /* the planes */
    struct ZSTD_DCtx_s *zstd; /* NULL before the first */
};
/* Unpacks a payload into *p. Hostile bytes are safe. ERR_FORMAT, ERR_LIMIT, ERR_MEM. */
enum err_code payload_open(struct payload *p, const void *bytes, size_t n,
                           const struct codec_limits *lim, struct err *e) ERR_USE;
void payload_free(struct payload *p);
/* Its rows. Free *out with gauss_free; it is empty on errors. ERR_FORMAT (a value is not finite, or
 * a rotation is 0), ERR_LIMIT, ERR_MEM. */
enum err_code payload_gauss(const struct payload *p, struct gauss *out, struct err *e) ERR_USE;
/* out [p->n] becomes the logarithm of each row's largest sigma. It may be no number. */
void payload_sizes(const struct payload *p, float *out);
/* Where the rows of a payload go, in the layout that is drawn (core/layout.h). */
struct payload_target {
    float *const *block;   /* row k goes to block[k / block_rows], which is whole groups */
    const uint32_t *place; /* [n]: row i becomes row place[i], which is below n */
    size_t block_rows;     /* a power of two, a multiple of LAYOUT_LANES */
    bool sh_halves;        /* harmonics are halves */
    uint32_t embed_len;    /* that of the payload, or 0: embeddings are left out */
    double origin_enu_m[3];
};
/* Writes the same values as payload_gauss there, with means about the target's origin, without
 * other memory. Harmonics of a lossless payload are rounded where the target has halves. Lanes of a
 * group that get no row are not changed. ERR_FORMAT as payload_gauss; rows may be written already.
 * ERR_MEM. */
enum err_code payload_place(const struct payload *p, const struct payload_target *to,
                            struct err *e) ERR_USE;
#endif
