/* float32 arrays as NumPy .npy files.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_NPY_H
#define CODEC_NPY_H

#include <stddef.h>

#include "core/err.h"

/* Write, read or decode an array of float32 in C order. shape has ndim entries; the caller defines
 * units. Free *data with mem_free. ERR_NOENT, ERR_FORMAT (no such file, or another ndim),
 * ERR_LIMIT, ERR_IO, ERR_MEM. Any thread. */
enum err_code npy_write(const char *path, const float *data, size_t ndim, const size_t *shape,
                        struct err *e) ERR_USE;
enum err_code npy_read(const char *path, size_t ndim, size_t *shape, float **data,
                       struct err *e) ERR_USE;
enum err_code npy_decode(const void *bytes, size_t n, size_t ndim, size_t *shape, float **data,
                         struct err *e) ERR_USE;
#endif
