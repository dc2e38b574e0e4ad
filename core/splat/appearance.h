/* Appearance: how light, season and weather of a photograph change the colour of every Gaussian.
 *
 * A small network maps two embeddings to offsets of colour and opacity: g of a Gaussian and p of a
 * photograph. Both are first scaled to length 1.
 *
 *     h = max(0, W1 [g; p] + b1)        W1 [hidden][len_g + len_p]
 *     y = sigmoid(W2 h + b2)            W2 [4][hidden]
 *     rgb = clamp(SH(v) + 0.5 + 2 y[0..2] - 1, 0, 1),   opacity = min(opacity + y[3], 1)
 *
 * The photograph's part of the first layer is the same for all Gaussians of a frame. It is
 * therefore added to the bias once a frame. Kernels get the columns of W1 that belong to g, then b1
 * + W1 p, W2 and b2. These are the constants of a frame. Method: Robust and Efficient 3D Gaussian
 * Splatting for Urban Scene Reconstruction (ICCV 2025).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_APPEARANCE_H
#define CORE_APPEARANCE_H

#include <stddef.h>
#include <stdint.h>

#include "core/base.h"
#include "core/layout.h"
#include "core/splat/gauss.h"

enum {
    APPEARANCE_GAUSS_LEN = 16, /* defaults; *_MAX are limits */
    APPEARANCE_IMAGE_LEN = 32,
    APPEARANCE_HIDDEN = 32,
    APPEARANCE_OUT = LAYOUT_APPEARANCE_OUT,
    APPEARANCE_IMAGE_MAX = 64,
    APPEARANCE_HIDDEN_MAX = 64,
    APPEARANCE_NAME_MAX = 128
};

struct appearance { /* {0} is empty; free with appearance_free */
    uint32_t len_gauss, len_image, hidden;
    size_t n_images;
    float *w1, *b1, *w2, *b2; /* [hidden][len_gauss + len_image], [hidden], [4][hidden], [4] */
    float *images;            /* [n_images][len_image], not normalised */
    char (*names)[APPEARANCE_NAME_MAX]; /* names of the photographs, as in scene.json */
    void *block;
};

/* Allocates an appearance whose values are all 0. ERR_LIMIT: a length is out of range (len_gauss
 * 1..GAUSS_EMBED_MAX, len_image 1..APPEARANCE_IMAGE_MAX, hidden 1..APPEARANCE_HIDDEN_MAX). ERR_MEM.
 */
enum err_code appearance_alloc(struct appearance *a, uint32_t len_gauss, uint32_t len_image,
                               uint32_t hidden, size_t n_images, struct err *e) ERR_USE;
void appearance_free(struct appearance *a);
/* Sets random start values. Weights: uniform in +-1/sqrt(fan in). Bias of the opacity output: -5,
 * so that opacity offsets start near 0. Biases of the colour outputs: 0. Photographs: N(0, 1). */
void appearance_init(struct appearance *a, uint64_t seed);
/* Returns how many floats w1, b1, w2 and b2 have together. They lie in this order in one array that
 * begins at w1. */
size_t appearance_weights(const struct appearance *a);
/* Returns the photograph's row in `images`, or -1 if it has none. */
ptrdiff_t appearance_find(const struct appearance *a, const char *name);

/* Computes the constants of a frame: columns of W1 for g [hidden][len_gauss], b1 + W1 p [hidden],
 * W2 [4][hidden], b2 [4]. image [len_image] need not have length 1. `out` has
 * appearance_frame_floats() floats. */
size_t appearance_frame_floats(uint32_t len_gauss, uint32_t hidden);
void appearance_frame(const struct appearance *a, const float *image, float *out);
/* Computes y of one Gaussian in double. It is the reference of the kernels. embed [len_gauss] and
 * image [len_image] need not have length 1. */
void appearance_eval(const struct appearance *a, const float *embed, const float *image,
                     double y[APPEARANCE_OUT]);
/* Turns dL/d(constants of a frame) into dL/d(weights) and dL/d(image) [len_image]. frame_grad has
 * the layout of appearance_frame, weights_grad that of appearance_weights. The gradient passes
 * through the normalisation v^ = v / max(|v|, 1e-12): g_v = (g_v^ - v^ (v^ . g_v^)) / |v|. Results
 * overwrite what was there. Either result may be NULL. */
void appearance_backward(const struct appearance *a, const float *image, const float *frame_grad,
                         float *weights_grad, float *image_grad);
/* Puts one appearance into the colours and opacities of g for good: DC += (2 y - 1) / C0, opacity =
 * min(opacity + y[3], 1 - 1e-6). g keeps its embeddings. Runs in parallel. ERR_DATA: the embeddings
 * of g do not have len_gauss numbers. */
enum err_code appearance_bake(const struct appearance *a, const float *image, struct gauss *g,
                              struct err *e) ERR_USE;
/* out [len_image] = sum of weight[i] * images[index[i]] over n photographs. */
void appearance_blend(const struct appearance *a, const uint32_t *index, const double *weight,
                      size_t n, float *out);

/* Appends an appearance to `out`, or reads it. The bytes are one little-endian block with a version
 * and a hash. Checkpoints and tile stores keep it as the blob "appearance". Hostile bytes are safe
 * to read. After ERR_FORMAT, ERR_LIMIT or ERR_MEM *out is empty; after success free it with
 * appearance_free. */
enum err_code appearance_write(const struct appearance *a, struct buf *out, struct err *e) ERR_USE;
enum err_code appearance_read(const void *bytes, size_t n, struct appearance *out,
                              struct err *e) ERR_USE;

#endif
