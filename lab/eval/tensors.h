/* Weights of networks in .safetensors files. A file has a length, a JSON header with names, shapes
 * and offsets, and the numbers. Unlike a pickle, it has nothing to execute. Source: the format's
 * specification, https://github.com/huggingface/safetensors.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_TENSORS_H
#define LAB_TENSORS_H

#include "core/base.h"

enum { TENSORS_DIMS_MAX = 4 };

struct tensor { /* float32, C order */
    const char *name;
    size_t ndim, shape[TENSORS_DIMS_MAX], count;
    const float *data; /* [count]; lies in `block` */
};
struct tensors { /* {0} is empty; owns everything below */
    struct tensor *list;
    size_t n;
    float *block;
    struct arena arena;
};
/* Read all float32 tensors of at most four dimensions. Others are left out. Free with tensors_free.
 * ERR_FORMAT, ERR_MEM; tensors_read also ERR_NOENT, ERR_IO, ERR_LIMIT. Any thread. */
enum err_code tensors_decode(const void *bytes, size_t n, struct tensors *out,
                             struct err *e) ERR_USE;
enum err_code tensors_read(const char *path, struct tensors *out, struct err *e) ERR_USE;
void tensors_free(struct tensors *t);
/* NULL: no such tensor */
const struct tensor *tensors_find(const struct tensors *t, const char *name);

#endif
