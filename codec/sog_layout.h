/* What writing and reading SOG share.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_SOG_LAYOUT_H
#define CODEC_SOG_LAYOUT_H

#include <stddef.h>

/* Half a turn about x, between glTF axes and those that trainers' .ply files have by custom (y
 * down), which SOG shares with them: signs of x y z, of w x y z, and of the basis functions of the
 * harmonics of degree 1, 2, 3. */
static const float sog_flip[3] = {1, -1, -1};
static const float sog_flip_quat[4] = {1, 1, -1, -1};
static const float sog_flip_sh[15] = {-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1};

enum {
    SOG_MEAN_STEPS = 65535,
    SOG_QUAT_TAG = 252,       /* alpha of a rotation: this and the index of its largest component */
    SOG_PALETTE_COLUMNS = 64, /* centroids in a row of their texture */
    SOG_PALETTE_MOST = 65536,
};
#endif
