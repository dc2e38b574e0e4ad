/* Weights of networks from .safetensors files: a length, a JSON header of names, shapes and places,
 * and the numbers. Nothing in such a file is ever executed, unlike in a pickle.
 * Source: the format's specification, https://github.com/huggingface/safetensors.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_TENSORS_H
#define CODEC_TENSORS_H

#include "core/base.h"

enum { TENSORS_DIMS_MAX = 4 };

struct tensor { /* float32, C order */
    const char *name;
    size_t ndim, shape[TENSORS_DIMS_MAX], count;
    const float *data; /* [count], in the file's block */
};
struct tensors { /* {0} is empty; owns everything */
    struct tensor *list;
    size_t n;
    float *block;
    struct arena arena;
};
/* Read all float32 tensors of at most four dimensions; others are left out. tensors_free
 * it. ERR_FORMAT, ERR_MEM; of a file also ERR_NOENT, ERR_IO, ERR_LIMIT. Any thread. */
enum err_code tensors_decode(const void *bytes, size_t n, struct tensors *out,
                             struct err *e) ERR_USE;
enum err_code tensors_read(const char *path, struct tensors *out, struct err *e) ERR_USE;
void tensors_free(struct tensors *t);
const struct tensor *tensors_find(const struct tensors *t, const char *name); /* or NULL */

#endif
