/* The appearance of what `citysplat eval` scores, and its half-image rows (train/half_image.h).
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

struct eval_half_image { /* {0}: without appearance; eval_half_image_clear */
    struct appearance model;
    struct appearance_view view;
};
void eval_half_image_clear(struct eval_half_image *h);
/* Take the appearance model of a checkpoint, if it has one. All checkpoints taken since the last
 * eval_half_image_clear must have the same: ERR_DATA names the one that differs. `first`: it is the
 * first.
 */
enum err_code eval_half_image_take(struct eval_half_image *h, bool first, const struct ckpt *c,
                                   const char *path, const struct scene *s, struct err *e) ERR_USE;
/* The same of a store. */
enum err_code eval_half_image_take_store(struct eval_half_image *h, const struct appearance *a,
                                         const struct scene *s, struct err *e) ERR_USE;
/* For drawing; NULL without appearance. */
struct appearance_view *eval_half_image_appearance(struct eval_half_image *h);
/* Score a source by the half-image protocol. */
enum err_code eval_half_image_run(struct eval_half_image *h, struct dev *dev, struct render *r,
                                  uint32_t steps, bool random, bool exposure,
                                  struct photo_loader *f, size_t n_photos,
                                  const struct half_image_source *src, struct evaluate_score *out,
                                  struct err *e) ERR_USE;

#endif
