/* Looks and half-image rows of `citysplat eval`; see halves.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/halves.h"

#include <string.h>

#include "train/shared.h"

void halves_clear(struct halves *h)
{
    light_view_close(&h->look);
    appearance_free(&h->model);
    *h = (struct halves){0};
}

struct light_view *halves_look(struct halves *h)
{
    return h->model.block ? &h->look : NULL;
}

enum err_code halves_take(struct halves *h, bool first, const struct ckpt *c, const char *path,
                          const struct scene *s, struct err *e)
{
    struct appearance a;
    enum err_code rc = shared_read_model(c, path, &a, e);
    if (rc)
        return rc;
    if (first) {
        h->model = a;
        return a.block ? light_view_open(&h->look, &h->model, s, e) : ERR_OK;
    }
    if (!a.block != !h->model.block || (a.block && !light_same(&a, &h->model)))
        rc = err_set(e, ERR_DATA,
                     "%s: its appearance model is not that of the cells before: train them with "
                     "--appearance-shared, which makes one for all",
                     path);
    appearance_free(&a);
    return rc;
}

enum err_code halves_take_store(struct halves *h, const struct appearance *a, const struct scene *s,
                                struct err *e)
{
    if (!a)
        return ERR_OK;
    enum err_code rc =
        appearance_alloc(&h->model, a->len_gauss, a->len_image, a->hidden, a->n_images, e);
    if (rc)
        return rc;
    memcpy(h->model.w1, a->w1, appearance_weights(a) * sizeof(float));
    memcpy(h->model.images, a->images, a->n_images * a->len_image * sizeof(float));
    memcpy(h->model.names, a->names, a->n_images * sizeof(*a->names));
    return light_view_open(&h->look, &h->model, s, e);
}

enum err_code halves_run(struct halves *h, struct dev *dev, struct render *r, uint32_t steps,
                         bool random, struct feed *f, size_t n_photos,
                         const struct half_source *src, struct evaluate_score *out, struct err *e)
{
    struct loss *loss = NULL;
    struct half *half = NULL;
    enum err_code rc = loss_open(dev, &loss, e);
    struct half_config c = {.dev = dev,
                            .render = r,
                            .loss = loss,
                            .look = halves_look(h),
                            .steps = steps,
                            .lr = HALF_LR,
                            .lr_end = HALF_LR_END,
                            .random = random,
                            .seed = 1};
    if (!rc)
        rc = half_open(&c, &half, e);
    if (!rc)
        rc = half_run(half, f, n_photos, src, out, e);
    half_close(&half);
    loss_close(&loss);
    return rc;
}
