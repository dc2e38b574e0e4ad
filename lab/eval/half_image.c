/* The half-image protocol; see half_image.h.
 *
 * Learning draws only the columns of the half, by a camera with a narrower picture, which halves
 * its cost. Scoring draws the whole picture and cuts it, so that pixels are the same as in any
 * other score.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/eval/half_image.h"

#include <math.h>
#include <string.h>

#include "core/layout.h"
#include "core/splat/exposure.h"
#include "lab/eval/exposure_fit.h"
#include "train/loss/photometric.h"
#include "train/model/appearance_train.h"
#include "train/photographs/evaluate.h"
#include "train/photographs/photo_loader.h"

struct half_image {
    struct half_image_config c;
    cl_mem target, mask, grads;
    size_t target_bytes, mask_bytes, grads_bytes;
    float *frame, *frame_grad, *image_grad, *image, *m1, *m2;
};

uint32_t half_image_steps(double trained, size_t n_photos)
{
    double most = n_photos ? floor(trained / (double)n_photos) : 0.0;
    return trained > 0.0 ? (uint32_t)fmin(fmax(most, 1.0), HALF_IMAGE_STEPS) : HALF_IMAGE_STEPS;
}

enum err_code half_image_open(const struct half_image_config *c, struct half_image **out,
                              struct err *e)
{
    struct half_image *h = mem_array(1, sizeof *h);
    *out = h;
    if (!h)
        return err_set(e, ERR_MEM, "half-image score: out of memory");
    h->c = *c;
    if (!c->appearance)
        return ERR_OK;
    const struct appearance *a = c->appearance->model;
    size_t floats = appearance_frame_floats(a->len_gauss, a->hidden);
    h->frame = mem_array(floats, sizeof(float));
    h->frame_grad = mem_array(floats, sizeof(float));
    h->image_grad = mem_array(a->len_image, sizeof(float));
    h->image = mem_array(a->len_image, sizeof(float));
    h->m1 = mem_array(a->len_image, sizeof(float));
    h->m2 = mem_array(a->len_image, sizeof(float));
    if (h->frame && h->frame_grad && h->image_grad && h->image && h->m1 && h->m2)
        return ERR_OK;
    half_image_close(out);
    return err_set(e, ERR_MEM, "half-image score: out of memory");
}

void half_image_close(struct half_image **p)
{
    struct half_image *h = *p;
    if (!h)
        return;
    dev_release(&h->target);
    dev_release(&h->mask);
    dev_release(&h->grads);
    mem_free(h->frame);
    mem_free(h->frame_grad);
    mem_free(h->image_grad);
    mem_free(h->image);
    mem_free(h->m1);
    mem_free(h->m2);
    mem_free(h);
    *p = NULL;
}

void half_image_columns(uint32_t width_px, enum half_image_side side, uint32_t *first,
                        uint32_t *count)
{
    *first = side == HALF_IMAGE_LEFT ? 0 : width_px / 2;
    *count = side == HALF_IMAGE_LEFT ? width_px / 2 : width_px - width_px / 2;
}

static enum half_image_side half_image_other(enum half_image_side side)
{
    return side == HALF_IMAGE_LEFT ? HALF_IMAGE_RIGHT : HALF_IMAGE_LEFT;
}

/* ---- learning ---- */

static struct camera half_image_camera(const struct camera *cam, enum half_image_side side)
{
    struct camera c = *cam;
    uint32_t first, count;
    half_image_columns(cam->width_px, side, &first, &count);
    c.width_px = count;
    c.cx_px -= first;
    return c;
}

/* The columns of a side out of px [h][w][bytes]. */
static void half_image_cut(const struct photo *p, enum half_image_side side, const uint8_t *px,
                           size_t bytes, uint8_t *out)
{
    uint32_t first, count, w = p->cam.width_px;
    half_image_columns(w, side, &first, &count);
    for (size_t y = 0; y < p->cam.height_px; y++)
        memcpy(out + y * count * bytes, px + (y * w + first) * bytes, count * bytes);
}

/* Photograph and mask of a side: `out` borrows from *room, mem_free it. */
static enum err_code half_image_part(const struct photo *p, enum half_image_side side,
                                     struct photo *out, uint8_t **room, struct err *e)
{
    *out = *p;
    out->cam = half_image_camera(&p->cam, side);
    size_t n = (size_t)out->cam.width_px * out->cam.height_px;
    *room = mem_array(n, 4);
    if (!*room)
        return err_set(e, ERR_MEM, "half-image score: out of memory for %zu pixels", n);
    half_image_cut(p, side, p->px, 3, *room);
    out->px = *room;
    if (p->mask) {
        half_image_cut(p, side, p->mask, 1, *room + 3 * n);
        out->mask = *room + 3 * n;
    }
    return ERR_OK;
}

/* What learning is compared with: the part at the mean exposure, without what is clipped then.
 * `part` lies in a room of half_image_part. */
static void half_image_to_mean(struct photo *part, uint8_t *room)
{
    size_t n = (size_t)part->cam.width_px * part->cam.height_px;
    const uint8_t white[3] = {255, 255, 255};
    if (exposure_is_mean(part->exposure_ev))
        return;
    if (!part->mask && exposure_clipped(part->exposure_ev, white)) {
        memset(room + 3 * n, 255, n);
        part->mask = room + 3 * n;
    }
    exposure_to_mean(part->exposure_ev, room, n, part->mask ? room + 3 * n : NULL);
}

bool half_image_is_seen(const struct photo *p)
{
    size_t n = (size_t)p->cam.width_px * p->cam.height_px;
    bool seen[2] = {!p->mask, !p->mask};
    for (size_t i = 0; p->mask && i < n; i++)
        if (p->mask[i])
            seen[i % p->cam.width_px >= p->cam.width_px / 2] = true;
    return seen[HALF_IMAGE_LEFT] && seen[HALF_IMAGE_RIGHT];
}

static void half_image_adam(struct half_image *h, float *image, size_t n, uint32_t t)
{
    const double beta1 = 0.9, beta2 = 0.999, eps = 1e-15;
    double u = h->c.steps > 1 ? (double)(t - 1) / (double)(h->c.steps - 1) : 0.0;
    double lr = h->c.lr * pow(h->c.lr_end / h->c.lr, u);
    for (size_t i = 0; i < n; i++) {
        double g = (double)h->image_grad[i];
        double a = beta1 * (double)h->m1[i] + (1.0 - beta1) * g;
        double b = beta2 * (double)h->m2[i] + (1.0 - beta2) * g * g;
        h->m1[i] = (float)a;
        h->m2[i] = (float)b;
        a /= 1.0 - pow(beta1, t);
        b /= 1.0 - pow(beta2, t);
        image[i] = (float)((double)image[i] - lr * a / (sqrt(b) + eps));
    }
}

static enum err_code half_image_step(struct half_image *h, const struct photo *part,
                                     const struct render_model *m, struct render_options ro,
                                     const float *image, struct err *e)
{
    const struct camera *cam = &part->cam;
    const struct appearance *a = h->c.appearance->model;
    struct photometric_input in = {.target = h->target,
                                   .mask = part->mask ? h->mask : NULL,
                                   .width_px = cam->width_px,
                                   .height_px = cam->height_px,
                                   .l1_weight = PHOTOMETRIC_L1_WEIGHT,
                                   .ssim_weight = PHOTOMETRIC_SSIM_WEIGHT};
    appearance_frame(a, image, h->frame);
    ro.appearance_frame = h->frame;
    ro.appearance_hidden = a->hidden;
    struct render_appearance_grad grad = {.frame = h->frame_grad};
    enum err_code rc = render_forward(h->c.render, m, cam, &ro, NULL, NULL, e);
    in.color = render_color_buffer(h->c.render);
    if (!rc)
        rc = photometric_run(h->c.loss, &in, render_color_grad_buffer(h->c.render), e);
    if (!rc)
        rc = render_backward_appearance(h->c.render, m, h->grads, &grad, e);
    if (!rc)
        appearance_backward(a, image, h->frame_grad, NULL, h->image_grad);
    return rc;
}

/* Photograph and mask of a side onto the device, and room for the gradients. */
static enum err_code half_image_upload(struct half_image *h, const struct photo *part,
                                       const struct render_model *m, struct err *e)
{
    size_t n = (size_t)part->cam.width_px * part->cam.height_px;
    size_t grads = layout_floats(m->cap, m->planes) * sizeof(float);
    enum err_code rc = dev_reserve(h->c.dev, 3 * n, &h->target, &h->target_bytes, e);
    if (!rc)
        rc = dev_reserve(h->c.dev, grads, &h->grads, &h->grads_bytes, e);
    if (!rc)
        rc = dev_write(h->c.dev, h->target, 0, 3 * n, part->px, e);
    if (!rc && part->mask)
        rc = dev_reserve(h->c.dev, n, &h->mask, &h->mask_bytes, e);
    return !rc && part->mask ? dev_write(h->c.dev, h->mask, 0, n, part->mask, e) : rc;
}

enum err_code half_image_fit(struct half_image *h, const struct photo *p,
                             const struct render_model *m, const struct render_options *ro,
                             enum half_image_side side, float *image, struct err *e)
{
    size_t len = h->c.appearance->model->len_image;
    struct photo part;
    uint8_t *room = NULL;
    enum err_code rc = half_image_part(p, side, &part, &room, e);
    if (!rc) {
        half_image_to_mean(&part, room);
        rc = half_image_upload(h, &part, m, e);
    }
    memset(h->m1, 0, len * sizeof(float));
    memset(h->m2, 0, len * sizeof(float));
    for (uint32_t t = 1; !rc && t <= h->c.steps; t++) {
        rc = half_image_step(h, &part, m, *ro, image, e);
        if (!rc)
            half_image_adam(h, image, len, t);
        if (!rc && signals_stopping())
            rc = err_set(e, ERR_CANCEL, "stopped while scoring");
    }
    mem_free(room);
    return rc;
}

/* ---- scoring ---- */

/* The whole picture, drawn with an embedding (NULL: without): *rgb [h][w][3], mem_free it. */
static enum err_code half_image_draw(struct half_image *h, const struct camera *cam,
                                     const struct render_model *m, const struct render_options *ro,
                                     const float *image, float **rgb, struct err *e)
{
    struct render_options with = *ro;
    *rgb = mem_array((size_t)cam->width_px * cam->height_px * 3, sizeof **rgb);
    if (!*rgb)
        return err_set(e, ERR_MEM, "half-image score: out of memory");
    if (image) {
        appearance_frame(h->c.appearance->model, image, h->frame);
        with.appearance_frame = h->frame;
        with.appearance_hidden = h->c.appearance->model->hidden;
    }
    return render_forward(h->c.render, m, cam, &with, *rgb, NULL, e);
}

enum err_code half_image_expose(struct half_image *h, struct photo *p, const struct render_model *m,
                                const struct render_options *ro, enum half_image_side side,
                                const float *image, struct err *e)
{
    uint32_t first, count, w = p->cam.width_px;
    float *rgb = NULL;
    half_image_columns(w, side, &first, &count);
    enum err_code rc = half_image_draw(h, &p->cam, m, ro, image, &rgb, e);
    if (!rc &&
        !exposure_fit(rgb, p->px, p->mask, w, p->cam.height_px, first, count, p->exposure_ev))
        log_debug("eval", "%s: too few pixels of one half tell its exposure", p->name);
    mem_free(rgb);
    return rc;
}

enum err_code half_image_score(struct half_image *h, const struct photo *p,
                               const struct render_model *m, const struct render_options *ro,
                               enum half_image_side side, const float *image,
                               struct evaluate_score *sum, struct err *e)
{
    struct photo part;
    uint8_t *room = NULL;
    float *rgb = NULL;
    uint32_t first, count, w = p->cam.width_px, rows = p->cam.height_px;
    half_image_columns(w, side, &first, &count);
    enum err_code rc = half_image_part(p, side, &part, &room, e);
    double start = clock_s();
    if (!rc)
        rc = half_image_draw(h, &p->cam, m, ro, image, &rgb, e);
    if (!rc) {
        sum->ms_frame += 1e3 * (clock_s() - start);
        sum->gaussians += m->n;
        for (size_t y = 0; y < rows; y++) /* in place: rows only move towards the start */
            memmove(rgb + y * count * 3, rgb + (y * w + first) * 3,
                    (size_t)count * 3 * sizeof(float));
        exposure_expose(p->exposure_ev, rgb, (size_t)count * rows);
        rc = evaluate_photo(&part, rgb, sum, e);
    }
    mem_free(rgb);
    mem_free(room);
    return rc;
}

static void half_image_start(struct half_image *h, const struct photo *p)
{
    struct appearance_view *v = h->c.appearance;
    size_t len = v->model->len_image;
    size_t n = appearance_train_nearest(v->model, v->scene, v->row, &p->cam, v->reach_m, h->image);
    for (size_t i = 0; !n && i < len; i++)
        h->image[i] = (float)rng_normal(h->c.seed, p->image, i);
}

static enum err_code half_image_photo(struct half_image *h, const struct photo *p,
                                      const struct half_image_source *src,
                                      struct evaluate_score *sum, struct err *e)
{
    const struct render_model *m = NULL;
    struct render_options ro;
    float *image = h->c.appearance ? h->image : NULL;
    enum err_code rc = src->prepare(src->user, &p->cam, &m, &ro, e);
    for (int k = HALF_IMAGE_LEFT; !rc && k <= HALF_IMAGE_RIGHT; k++) {
        enum half_image_side side = (enum half_image_side)k;
        struct photo photo = *p;
        if (image)
            half_image_start(h, p);
        if (h->c.exposure)
            rc = half_image_expose(h, &photo, m, &ro, side, image, e);
        if (!rc && image)
            rc = half_image_fit(h, &photo, m, &ro, side, image, e);
        if (!rc)
            rc = half_image_score(h, &photo, m, &ro, half_image_other(side), image, sum, e);
    }
    return rc;
}

enum err_code half_image_run(struct half_image *h, struct photo_loader *f, size_t n_photos,
                             const struct half_image_source *src, struct evaluate_score *out,
                             struct err *e)
{
    *out = (struct evaluate_score){0};
    struct progress progress;
    enum err_code rc =
        n_photos ? ERR_OK : err_set(e, ERR_DATA, "half-image score: no test photographs");
    progress_start(&progress, "half images", n_photos);
    for (size_t i = 0; !rc && i < n_photos; i++) {
        struct photo photo;
        rc = photo_loader_get_nth(f, i, &photo, e);
        if (!rc && photo.cam.width_px < 2)
            rc = err_set(e, ERR_DATA, "%s: one column has no halves", photo.name);
        if (!rc && half_image_is_seen(&photo)) {
            rc = half_image_photo(h, &photo, src, out, e);
            out->n_photos++;
        } else if (!rc) {
            log_warn("eval", "%s: its mask leaves nothing of one half: not scored", photo.name);
        }
        if (!rc && signals_stopping())
            rc = err_set(e, ERR_CANCEL, "stopped while scoring");
        progress_step(&progress, i + 1, NULL);
    }
    progress_end(&progress, NULL);
    if (!rc && !out->n_photos)
        rc = err_set(e, ERR_DATA, "half-image score: masks leave no photograph to score");
    evaluate_divide(out, 2.0 * (double)out->n_photos);
    return rc;
}
