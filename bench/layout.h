/* Other ways to cut a tile's integers into attributes of a .drc than the one in codec/: what it was
 * chosen from.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef BENCH_LAYOUT_H
#define BENCH_LAYOUT_H

#include <stdbool.h>

#include "core/err.h"

struct buf;
struct err;
struct quant;

enum layout_channels { LAYOUT_GREEN, LAYOUT_RGB, LAYOUT_YCOCG }; /* GREEN: red and blue about it */
enum layout_predict { LAYOUT_PREDICT_PAYING, LAYOUT_PREDICT_POSITION, LAYOUT_PREDICT_ALL };
struct layout { /* {0}: as codec/draco_layout.c has it */
    enum layout_channels channels;
    enum layout_predict predict;
    bool split_position, split_scale, split_rotation, split_color; /* attributes of one component */
    bool join_channels;     /* a band's channels in one attribute, not green apart */
    bool scale_differences; /* second and third sigma about the first */
};
/* The cloud's stream, without names. Values are the steps that remain when the zero bits of all
 * rows are left out. */
enum err_code layout_encode(const struct quant *q, const struct layout *l, struct buf *out,
                            struct err *e) ERR_USE;

#endif
