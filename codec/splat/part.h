/* A tile in two parts: the five eighths of its Gaussians that show most, and the rest.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_PART_H
#define CODEC_PART_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct quant;

enum {
    PART_ROWS = 1024,  /* the first part has a multiple of these: rows of the viewer's textures */
    PART_LEAST = 4096, /* fewer Gaussians are one part */
    PARTS = 2
};
/* How many of n Gaussians are the first part: n where all are. */
size_t part_first(size_t n);
/* Part 1 or 2 of q. Rows keep their order and their integers. out->rest says how many rows follow
 * in the next part. Free *out with quant_free. ERR_NOENT: there is no second part. ERR_MEM. */
enum err_code part_take(const struct quant *q, uint32_t part, struct quant *out,
                        struct err *e) ERR_USE;

#endif
