/* Shared by the files of the footprint.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CELLS_FOOTPRINT_INTERNAL_H
#define SCENE_CELLS_FOOTPRINT_INTERNAL_H

#include "core/err.h"

struct footprint;

/* footprint.c: computes edge_m from `inside`. ERR_MEM. */
enum err_code footprint_measure(struct footprint *f, struct err *e) ERR_USE;

#endif
