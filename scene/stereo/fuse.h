/* Points of a surface from many depth maps: one for each filled cube of a grid, at the mean of the
 * places and colours in it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_STEREO_FUSE_H
#define SCENE_STEREO_FUSE_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct fuse_sample {
    float enu_m[3];
    uint8_t rgb[3];
};
enum { FUSE_COLUMNS = 6 }; /* of a point: east, north, up in m; red, green, blue in 0..255 */
/* Replaces the samples by points with a cube of edge_m each, ordered by cube: *out [*n_out][6].
 * Free it with mem_free. ERR_MEM, ERR_LIMIT (2^32 samples). */
enum err_code fuse_samples(const struct fuse_sample *s, size_t n, double edge_m, float **out,
                           size_t *n_out, struct err *e) ERR_USE;

#endif
