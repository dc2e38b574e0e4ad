/* What the arguments of a step of `citysplat city` were made of, so that a later run notices that a
 * file has changed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_CITY_INPUTS_H
#define CLI_CITY_INPUTS_H

#include <stddef.h>

#include "core/base.h"

/* Appends to `out` all arguments in one line, and then a line for each argument that names a file
 * or a folder: a hash of what it holds, a space, the argument. Of a file the bytes count, of a
 * folder the names and sizes of all files below, and the bytes of COLMAP's. ERR_IO, ERR_MEM,
 * ERR_LIMIT. */
enum err_code city_inputs_tell(const char *const *args, size_t n, struct buf *out,
                               struct err *e) ERR_USE;
/* Compares what was told of `made` with what is told now. ERR_ARG: the arguments differ, or what
 * one of them names; the message says which, and what to do. A text that an earlier version wrote
 * has arguments alone. */
enum err_code city_inputs_same(const char *made, const struct buf *was, const struct buf *now,
                               struct err *e) ERR_USE;

#endif
