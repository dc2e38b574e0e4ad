/* Limits of decoders. A decoder compares counts with the bytes at hand before it allocates, keeps
 * these limits, and leaves its output empty on an error.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_LIMITS_H
#define CODEC_LIMITS_H

#include <stddef.h>

#define CODEC_MAX_GAUSSIANS ((size_t)64 << 20)
#define CODEC_MAX_BYTES ((size_t)16 << 30)
#define CODEC_MAX_PIXELS ((size_t)512 << 20)

struct codec_limits {     /* {0} = the defaults in brackets */
    size_t max_gaussians; /* [64 Mi] */
    size_t max_bytes;     /* decompressed bytes of one file [16 GiB] */
    size_t max_pixels;    /* pixels of one image [512 Mi] */
};
#endif
