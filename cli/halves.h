/* The looks of what `citysplat eval` scores, and its half-image rows (train/half.h).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_HALVES_H
#define CLI_HALVES_H

#include "lod/lod.h"
#include "train/half.h"

struct halves { /* {0}: without appearance; halves_clear */
    struct appearance model;
    struct light_view look;
};
void halves_clear(struct halves *h);
/* Take the appearance model of a checkpoint, if it has one. All checkpoints taken since the last
 * halves_clear must have the same: ERR_DATA names the one that differs. `first`: it is the first.
 */
enum err_code halves_take(struct halves *h, bool first, const struct ckpt *c, const char *path,
                          const struct scene *s, struct err *e) ERR_USE;
/* The same of a store. */
enum err_code halves_take_store(struct halves *h, const struct appearance *a, const struct scene *s,
                                struct err *e) ERR_USE;
/* For drawing; NULL without appearance. */
struct light_view *halves_look(struct halves *h);
/* Score a source by the half-image protocol. */
enum err_code halves_run(struct halves *h, struct dev *dev, struct render *r, uint32_t steps,
                         bool random, struct feed *f, size_t n_photos,
                         const struct half_source *src, struct evaluate_score *out,
                         struct err *e) ERR_USE;

#endif
