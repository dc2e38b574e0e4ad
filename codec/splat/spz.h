/* SPZ files of Gaussians. Functions may be called from any thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_SPZ_H
#define CODEC_SPZ_H

#include "core/base.h"

struct codec_limits;
struct quant;

/* Appends a .spz of version 3 or 4 to `out`. ERR_ARG (version), ERR_LIMIT, ERR_MEM. */
enum err_code spz_encode(const struct quant *q, int version, struct buf *out,
                         struct err *e) ERR_USE;
/* The place of a file on earth. A point p in glTF axes lies at q p q* + origin, in geocentric
 * metres of EPSG:4978. q is the rotation. */
struct spz_place {
    double origin_m[3], rotation_xyzw[4]; /* rotation has length 1 */
};
/* As spz_encode, version 4, with the record SPZ_NIANTIC_georeference (proposed in pull request 105
 * of github.com/nianticlabs/spz). Readers that do not know it skip it. ERR_LIMIT, ERR_MEM. */
enum err_code spz_encode_placed(const struct quant *q, const struct spz_place *place,
                                struct buf *out, struct err *e) ERR_USE;
/* Reads versions 1 to 4 into glTF axes. Hostile bytes are safe. Free *out with quant_free; it is
 * empty on errors. ERR_FORMAT, ERR_LIMIT, ERR_MEM. */
enum err_code spz_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                         struct quant *out, struct err *e) ERR_USE;
#endif
