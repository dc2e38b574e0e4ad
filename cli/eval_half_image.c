/* Appearance and half-image rows of `citysplat eval`; see eval_half_image.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/eval_half_image.h"

#include <string.h>

#include "codec/ckpt.h"
#include "codec/scene.h"
#include "loss/photometric.h"
#include "train/appearance_train.h"
#include "train/coarse.h"
#include "train/evaluate.h"

void eval_half_image_clear(struct eval_half_image *h)
{
    appearance_view_close(&h->view);
    appearance_free(&h->model);
    *h = (struct eval_half_image){0};
}

struct appearance_view *eval_half_image_appearance(struct eval_half_image *h)
{
    return h->model.block ? &h->view : NULL;
}

enum err_code eval_half_image_take(struct eval_half_image *h, bool first, const struct ckpt *c,
                                   const char *path, const struct scene *s, struct err *e)
{
    struct appearance a;
    enum err_code rc = coarse_read_appearance(c, path, &a, e);
    if (rc)
        return rc;
    if (first) {
        h->model = a;
        return a.block ? appearance_view_open(&h->view, &h->model, s, e) : ERR_OK;
    }
    if (!a.block != !h->model.block || (a.block && !appearance_train_same(&a, &h->model)))
        rc = err_set(e, ERR_DATA,
                     "%s: its appearance model is not that of the cells before: train them with "
                     "--appearance-shared, which makes one for all",
                     path);
    appearance_free(&a);
    return rc;
}

enum err_code eval_half_image_take_store(struct eval_half_image *h, const struct appearance *a,
                                         const struct scene *s, struct err *e)
{
    if (!a)
        return ERR_OK;
    enum err_code rc =
        appearance_alloc(&h->model, a->len_gauss, a->len_image, a->hidden, a->n_images, e);
    if (rc)
        return rc;
    memcpy(h->model.w1, a->w1, appearance_weights(a) * sizeof(float));
    memcpy(h->model.images, a->images, a->n_images * a->len_image * sizeof(float));
    memcpy(h->model.names, a->names, a->n_images * sizeof *a->names);
    return appearance_view_open(&h->view, &h->model, s, e);
}

enum err_code eval_half_image_run(struct eval_half_image *h, struct dev *dev, struct render *r,
                                  uint32_t steps, bool random, bool exposure,
                                  struct photo_loader *f, size_t n_photos,
                                  const struct half_image_source *src, struct evaluate_score *out,
                                  struct err *e)
{
    struct photometric *loss = NULL;
    struct half_image *half = NULL;
    enum err_code rc = photometric_open(dev, &loss, e);
    struct half_image_config c = {.dev = dev,
                                  .render = r,
                                  .loss = loss,
                                  .appearance = eval_half_image_appearance(h),
                                  .steps = steps,
                                  .lr = HALF_IMAGE_LR,
                                  .lr_end = HALF_IMAGE_LR_END,
                                  .exposure = exposure,
                                  .random = random,
                                  .seed = 1};
    if (!rc)
        rc = half_image_open(&c, &half, e);
    if (!rc)
        rc = half_image_run(half, f, n_photos, src, out, e);
    half_image_close(&half);
    photometric_close(&loss);
    return rc;
}
