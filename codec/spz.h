/* SPZ files of Gaussians.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_SPZ_H
#define CODEC_SPZ_H

#include "core/base.h"

struct codec_limits;
struct quant;

/* .spz, versions 3 and 4, appended to out. ERR_ARG (version), ERR_LIMIT, ERR_MEM. Any thread. */
enum err_code spz_encode(const struct quant *q, int version, struct buf *out,
                         struct err *e) ERR_USE;
/* Where a file's frame is: glTF axes to geocentric metres of EPSG:4978, q p q* + origin. */
struct spz_place {
    double origin_m[3], rotation_xyzw[4]; /* of length 1 */
};
/* Version 4 with a georeference record, SPZ_NIANTIC_georeference as github.com/nianticlabs/spz
 * proposes it (pull request 105): readers that do not know it pass over it. ERR_LIMIT, ERR_MEM. */
enum err_code spz_encode_placed(const struct quant *q, const struct spz_place *place,
                                struct buf *out, struct err *e) ERR_USE;
/* Versions 2, 3 and 4; hostile bytes are safe. quant_free it; empty on errors. ERR_FORMAT,
 * ERR_LIMIT, ERR_MEM. Any thread. */
enum err_code spz_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                         struct quant *out, struct err *e) ERR_USE;
#endif
