/* Definitions that the writer and the reader of SOG share.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_SOG_LAYOUT_H
#define CODEC_SOG_LAYOUT_H

#include <stddef.h>

/* Signs of a half turn about x. It turns glTF axes into the axes of trainers' .ply files (y down),
 * which SOG uses too. They apply to x y z, to w x y z, and to the basis functions of harmonics of
 * degree 1, 2 and 3. */
static const float sog_flip[3] = {1, -1, -1};
static const float sog_flip_quat[4] = {1, 1, -1, -1};
static const float sog_flip_sh[15] = {-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1};

enum {
    SOG_MEAN_STEPS = 65535,
    SOG_QUAT_TAG = 252, /* alpha of a rotation is this plus the index of its largest component */
    SOG_PALETTE_COLUMNS = 64, /* centroids in a row of the texture */
    SOG_PALETTE_MOST = 65536,
};
#endif
