/* Appearance: what light, season and weather of a photograph do to every Gaussian's colour.
 *
 * A small network maps a Gaussian's embedding g and a photograph's embedding p, both normalised to
 * length 1, to offsets of colour and opacity:
 *
 *     h = max(0, W1 [g; p] + b1)        W1 [hidden][len_g + len_p]
 *     y = sigmoid(W2 h + b2)            W2 [4][hidden]
 *     rgb = clamp(SH(v) + 0.5 + 2 y[0..2] - 1, 0, 1),   opacity = min(opacity + y[3], 1)
 *
 * The photograph's part of the first layer is the same for every Gaussian of a frame, so it folds
 * into the bias: kernels get W1's first columns, b1 + W1 p, W2 and b2 ("frame" below).
 * Method: Robust and Efficient 3D Gaussian Splatting for Urban Scene Reconstruction (ICCV 2025).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_APPEARANCE_H
#define CORE_APPEARANCE_H

#include <stddef.h>
#include <stdint.h>

#include "core/base.h"
#include "core/gauss.h"
#include "core/layout.h"

enum {
    APPEARANCE_GAUSS_LEN = 16, /* defaults and limits */
    APPEARANCE_IMAGE_LEN = 32,
    APPEARANCE_HIDDEN = 32,
    APPEARANCE_OUT = LAYOUT_APPEARANCE_OUT,
    APPEARANCE_IMAGE_MAX = 64,
    APPEARANCE_HIDDEN_MAX = 64,
    APPEARANCE_NAME_MAX = 128
};

struct appearance { /* {0} is empty; appearance_free */
    uint32_t len_gauss, len_image, hidden;
    size_t n_images;
    float *w1, *b1, *w2, *b2; /* [hidden][len_gauss + len_image], [hidden], [4][hidden], [4] */
    float *images;            /* [n_images][len_image], not normalised */
    char (*names)[APPEARANCE_NAME_MAX]; /* of the photographs, as in scene.json */
    void *block;
};

/* Room, all zero. ERR_LIMIT: lengths out of range (len_gauss 1..GAUSS_EMBED_MAX, len_image
 * 1..APPEARANCE_IMAGE_MAX, hidden 1..APPEARANCE_HIDDEN_MAX). */
enum err_code appearance_alloc(struct appearance *a, uint32_t len_gauss, uint32_t len_image,
                               uint32_t hidden, size_t n_images, struct err *e) ERR_USE;
void appearance_free(struct appearance *a);
/* Layers U(-1/sqrt(fan in), 1/sqrt(fan in)), bias of the opacity output -5 (offsets start near 0),
 * biases of the colour outputs 0, photographs N(0, 1). */
void appearance_init(struct appearance *a, uint64_t seed);
/* Numbers in w1, b1, w2, b2, which lie one behind the other from w1 on. */
size_t appearance_weights(const struct appearance *a);
/* -1 when absent. */
ptrdiff_t appearance_find(const struct appearance *a, const char *name);

/* Constants of a frame: W1's columns of g [hidden][len_gauss], b1 + W1 p^ [hidden], W2 [4][hidden],
 * b2 [4]. image: [len_image], not normalised. */
size_t appearance_frame_floats(uint32_t len_gauss, uint32_t hidden);
void appearance_frame(const struct appearance *a, const float *image, float *out);
/* y of one Gaussian in double (the reference of the kernels). embed: [len_gauss], not normalised.
 */
void appearance_eval(const struct appearance *a, const float *embed, const float *image,
                     double y[APPEARANCE_OUT]);
/* From dL/d(frame), laid out as the frame, to dL/d(weights) (laid out from w1 on, see
 * appearance_weights) and dL/d(image) [len_image], through the normalisation v^ = v / max(|v|,
 * 1e-12): g_v = (g_v^ - v^ (v^ . g_v^)) / |v|. Written, not added; either may be NULL. */
void appearance_backward(const struct appearance *a, const float *image, const float *frame_grad,
                         float *weights_grad, float *image_grad);
/* Apply a photograph's appearance for good: DC += (2 y - 1) / C0, opacity = min(opacity + y3, 1 -
 * 1e-6). g keeps its embeddings. ERR_DATA when g's embedding length is not len_gauss. Parallel. */
enum err_code appearance_bake(const struct appearance *a, const float *image, struct gauss *g,
                              struct err *e) ERR_USE;
/* out [len_image] = sum of weight[i] * images[index[i]] (a blend). */
void appearance_blend(const struct appearance *a, const uint32_t *index, const double *weight,
                      size_t n, float *out);

/* One self-describing little-endian block, versioned and hashed, appended to out: the blob
 * "appearance" of checkpoints and tile stores. Reading hostile bytes is safe: ERR_FORMAT,
 * ERR_LIMIT; *out is empty then, else appearance_free it. */
enum err_code appearance_write(const struct appearance *a, struct buf *out, struct err *e) ERR_USE;
enum err_code appearance_read(const void *bytes, size_t n, struct appearance *out,
                              struct err *e) ERR_USE;

#endif
