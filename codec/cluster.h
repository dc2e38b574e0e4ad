/* Codebooks: few values that stand for many, as SOG's textures index them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_CLUSTER_H
#define CODEC_CLUSTER_H

#include "core/base.h"

enum { CLUSTER_BOOK = 256 };

/* 256 values, ascending, that lie nearest to v [n] (Lloyd's algorithm on the line), and for each of
 * v the index of its nearest. n >= 1, v finite. Deterministic. ERR_MEM. Any thread, as all here. */
enum err_code cluster_values(const float *v, size_t n, float book[CLUSTER_BOOK], uint8_t *index,
                             struct err *e) ERR_USE;
/* n rows of v [n][d] in at most `most` (1 to 65536) groups: of all groups the one with the largest
 * sum of squares is divided, by the plane through its mean across its longest direction, until
 * there are enough. mean [most][d], label [n]; *n_groups <= most says how many there are.
 * ERR_MEM. */
enum err_code cluster_rows(const float *v, size_t n, size_t d, size_t most, float *mean,
                           uint16_t *label, size_t *n_groups, struct err *e) ERR_USE;
#endif
