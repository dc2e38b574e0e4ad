/* Layouts for the attributes of a .drc, to compare with that of codec/splat/draco_layout.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_LAYOUT_H
#define LAB_LAYOUT_H

#include <stdbool.h>

#include "core/err.h"

struct buf;
struct err;
struct quant;

/* GREEN: red and blue minus green */
enum layout_channels { LAYOUT_GREEN, LAYOUT_RGB, LAYOUT_YCOCG };
enum layout_predict { LAYOUT_PREDICT_PAYING, LAYOUT_PREDICT_POSITION, LAYOUT_PREDICT_ALL };
struct layout { /* {0}: the layout of codec/splat/draco_layout.c */
    enum layout_channels channels;
    enum layout_predict predict;
    bool split_position, split_scale, split_rotation, split_color; /* one attribute a component */
    bool join_channels;     /* all channels of a band in one attribute; false: green apart */
    bool scale_differences; /* the second and third sigma are differences from the first */
};
/* Encodes a cloud without names. Low bits that are 0 in all rows are left out first. ERR_MEM,
 * ERR_INTERNAL. */
enum err_code layout_encode(const struct quant *q, const struct layout *l, struct buf *out,
                            struct err *e) ERR_USE;

#endif
