/* Codebooks: few values that stand for many. The textures of SOG hold indices into them. All
 * functions are deterministic and may be called from any thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_CLUSTER_H
#define CODEC_CLUSTER_H

#include "core/base.h"

enum { CLUSTER_BOOK = 256 };

/* Finds 256 values, ascending, that approximate v [n] best (Lloyd's algorithm in one dimension),
 * and the index of the nearest one for each v. If v has few values, each stands in the book several
 * times, and the index is that of the middle one. n >= 1, and v is finite. ERR_MEM. */
enum err_code cluster_values(const float *v, size_t n, float book[CLUSTER_BOOK], uint8_t *index,
                             struct err *e) ERR_USE;
/* Divides the n rows of v [n][d] into at most `most` groups (1 to 65536). In each step the group
 * with the largest sum of squares is cut in two by a plane. The plane goes through the group's mean
 * and is normal to its longest direction. mean [most][d], label [n]; *n_groups <= most is the
 * number of groups. ERR_MEM. */
enum err_code cluster_rows(const float *v, size_t n, size_t d, size_t most, float *mean,
                           uint16_t *label, size_t *n_groups, struct err *e) ERR_USE;
#endif
