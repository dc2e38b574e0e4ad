/* Inside of train/: importance of Gaussians for densification (Taming 3DGS, Mallick 2024).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_IMPORTANCE_H
#define TRAIN_IMPORTANCE_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct gallery;
struct model;
struct stage;

struct importance;
void importance_free(struct importance **s);
/* lab/studies/importance.md */
enum { IMPORTANCE_VIEWS = 10 };
/* Computes the importance of every Gaussian over so many random training photographs:
 * score [n], finite and >= 0. params: host view of the model's parameters; mean_grad [n]. *own
 * keeps kernels and buffers between calls; it is NULL at first, free it with importance_free.
 * ERR_MEM, ERR_DEVICE, and the errors of photo_loader_get_nth. */
enum err_code importance_run(struct importance **own, struct model *m, struct gallery *g,
                             const struct stage *at, const float *params, const float *mean_grad,
                             float *score, struct err *e) ERR_USE;
/* Parts, for tests. importance_halve gives means of 2 x 2 pixels [h / 2][w / 2][channels], rounded;
 * importance_halve_mask is 1 where none of the four is 0. importance_stretch maps x to 0..1, or to
 * 0 if all are equal. importance_edges gives edge strengths [h][w], stretched.
 * importance_inverse_median gives 1 / median of the values above 0 among x[0], x[stride] .. x[(n -
 * 1) stride], or 0 if there are none. ERR_MEM. */
void importance_halve(const uint8_t *px, uint32_t channels, uint32_t w, uint32_t h, uint8_t *out);
void importance_halve_mask(const uint8_t *mask, uint32_t w, uint32_t h, uint8_t *out);
void importance_stretch(float *x, size_t n);
void importance_edges(const uint8_t *px, uint32_t w, uint32_t h, float *luma, float *out);
enum err_code importance_inverse_median(const float *x, size_t n, size_t stride, float *out,
                                        struct err *e) ERR_USE;
#endif
