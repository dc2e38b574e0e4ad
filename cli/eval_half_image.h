/* Appearance for `citysplat eval`, and its half-image rows (train/half_image.h).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_EVAL_HALF_IMAGE_H
#define CLI_EVAL_HALF_IMAGE_H

#include "train/appearance_train.h"
#include "train/half_image.h"

struct ckpt;
struct evaluate_score;
struct photo_loader;
struct scene;

struct eval_half_image { /* {0}: no appearance; free with eval_half_image_clear */
    struct appearance model;
    struct appearance_view view;
};
void eval_half_image_clear(struct eval_half_image *h);
/* Takes the appearance model of a checkpoint, if it has one. All checkpoints since the last
 * eval_half_image_clear must have the same model. `first` is true for the first checkpoint after
 * it. ERR_DATA names a checkpoint with another model. ERR_MEM. */
enum err_code eval_half_image_take(struct eval_half_image *h, bool first, const struct ckpt *c,
                                   const char *path, const struct scene *s, struct err *e) ERR_USE;
/* As eval_half_image_take, for a store. */
enum err_code eval_half_image_take_store(struct eval_half_image *h, const struct appearance *a,
                                         const struct scene *s, struct err *e) ERR_USE;
/* The appearance to draw with; NULL: none. */
struct appearance_view *eval_half_image_appearance(struct eval_half_image *h);
/* Scores a source by the half-image protocol. Errors as half_image.h. */
enum err_code eval_half_image_run(struct eval_half_image *h, struct dev *dev, struct render *r,
                                  uint32_t steps, bool random, bool exposure,
                                  struct photo_loader *f, size_t n_photos,
                                  const struct half_image_source *src, struct evaluate_score *out,
                                  struct err *e) ERR_USE;

#endif
