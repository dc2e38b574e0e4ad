/* The work of the last step, counted in what a renderer left on the device.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_ROOFLINE_COUNT_H
#define LAB_ROOFLINE_COUNT_H

#include "core/base.h"
#include "lab/bench/roofline.h"

struct dev;
struct render;

/* Entries, drawn entries and blocks of the tiles' lists, of a frame that has hits and of VW 16.
 * ERR_MEM, ERR_DEVICE. */
enum err_code roofline_count_lists(struct dev *d, const struct render *r, struct roofline_work *out,
                                   struct err *e) ERR_USE;
/* These and all else but `all` and `owed`. ERR_MEM, ERR_DEVICE. */
enum err_code roofline_count(struct dev *d, const struct render *r, struct roofline_work *out,
                             struct err *e) ERR_USE;

#endif
