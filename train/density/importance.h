/* Inside of train/: importance of Gaussians for densification.
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
 * score [n], finite and >= 0. *own keeps kernels and buffers between calls; it is NULL at first,
 * free it with importance_free. ERR_MEM, ERR_DEVICE, and the errors of photo_loader_get_nth. */
enum err_code importance_run(struct importance **own, struct model *m, struct gallery *g,
                             const struct stage *at, float *score, struct err *e) ERR_USE;
/* Parts, for tests. importance_halve gives means of 2 x 2 pixels [h / 2][w / 2][channels], rounded;
 * importance_halve_mask is 1 where none of the four is 0. */
void importance_halve(const uint8_t *px, uint32_t channels, uint32_t w, uint32_t h, uint8_t *out);
void importance_halve_mask(const uint8_t *mask, uint32_t w, uint32_t h, uint8_t *out);
#endif
