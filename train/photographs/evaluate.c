/* Scores of a picture source against photographs: PSNR, SSIM with both window rules, GMSD, L1,
 * Gaussians and time a frame (the quickest of three, mean over photographs). The first photograph
 * is drawn once more before the clock starts, so that building kernels and growing buffers is not
 * counted.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/image/image.h"
#include "core/splat/exposure.h"
#include "scene/cells/footprint.h"
#include "train/loss/metric.h"
#include "train/model/appearance_train.h"
#include "train/photographs/evaluate.h"
#include "train/photographs/photo_loader.h"
#include "train/photographs/residual.h"

enum {
    EVALUATE_DRAWS =
        3, /* of a photograph; the quickest counts, so that a busy neighbour does not */
};

#define EVALUATE_SEEN_MIN 0.01 /* of a photograph's pixels */

/* Mean over the used pixels. */
static double evaluate_l1(const float *rgb, const uint8_t *target, const uint8_t *mask, size_t n)
{
    double sum = 0.0;
    size_t used = 0;
    for (size_t i = 0; i < n; i++) {
        bool use = !mask || mask[i / 3];
        sum += use ? fabs((double)fminf(fmaxf(rgb[i], 0.0f), 1.0f) - target[i] / 255.0) : 0.0;
        used += use;
    }
    return used ? sum / (double)used : 0.0;
}

static enum err_code evaluate_brief(const struct photo *p, const float *rgb,
                                    struct evaluate_score *sum, struct err *e)
{
    uint32_t w = p->cam.width_px, h = p->cam.height_px;
    double psnr, ssim, ssim_valid;
    enum err_code rc = metric_psnr(rgb, p->px, p->mask, w, h, &psnr, e);
    if (!rc)
        rc = metric_ssim_both(rgb, p->px, p->mask, w, h, &ssim, &ssim_valid, e);
    if (rc)
        return rc;
    sum->psnr_db += psnr;
    sum->ssim += ssim;
    sum->ssim_valid += ssim_valid;
    return ERR_OK;
}

enum err_code evaluate_photo(const struct photo *p, const float *rgb, struct evaluate_score *sum,
                             struct err *e)
{
    uint32_t w = p->cam.width_px, h = p->cam.height_px;
    double gmsd;
    enum err_code rc = evaluate_brief(p, rgb, sum, e);
    if (!rc)
        rc = metric_gmsd(rgb, p->px, p->mask, w, h, &gmsd, e);
    if (rc)
        return rc;
    sum->gmsd += gmsd;
    sum->l1 += evaluate_l1(rgb, p->px, p->mask, (size_t)w * h * 3);
    return ERR_OK;
}

/* Adds the PSNR on ground that training photographs show, if that ground fills at least a hundredth
 * of the photograph. */
static enum err_code evaluate_seen(const struct photo *p, const struct footprint *ground,
                                   const float *rgb, struct evaluate_score *sum, struct err *e)
{
    const struct camera *c = &p->cam;
    size_t n = (size_t)c->width_px * c->height_px, seen = 0;
    double from[3], ray[3], psnr;
    uint8_t *use = mem_array(n, 1);
    enum err_code rc = ERR_OK;
    if (!use)
        return err_set(e, ERR_MEM, "evaluate: out of memory for %zu pixels", n);
    camera_center(c, from);
    for (size_t i = 0; i < n; i++) {
        footprint_ray(c, (double)(i % c->width_px), (double)(i / c->width_px), ray);
        ptrdiff_t cell = footprint_meets(ground, from, ray);
        use[i] = (!p->mask || p->mask[i]) && cell >= 0 && ground->inside[cell];
        seen += use[i];
    }
    if ((double)seen >= EVALUATE_SEEN_MIN * (double)n) {
        rc = metric_psnr(rgb, p->px, use, c->width_px, c->height_px, &psnr, e);
        sum->seen_psnr_db += rc ? 0.0 : psnr;
        sum->n_seen += !rc;
    }
    mem_free(use);
    return rc;
}

/* Photograph and drawing side by side, as DIR/NAME.png. */
static enum err_code evaluate_picture(const char *dir, const struct photo *p, const float *rgb,
                                      struct err *e)
{
    char name[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct image img = {0};
    uint32_t w = p->cam.width_px, h = p->cam.height_px;
    const char *dot = strrchr(p->name, '.');
    snprintf(name, sizeof name, "%.*s.png", (int)(dot ? dot - p->name : (ptrdiff_t)strlen(p->name)),
             p->name);
    enum err_code rc = file_mkdir(dir, e);
    if (!rc)
        rc = file_join(path, dir, name, e);
    if (!rc)
        rc = image_alloc(2 * w, h, 3, &img, e);
    if (rc)
        return rc;
    for (uint32_t y = 0; y < h; y++) {
        uint8_t *to = img.px + (size_t)y * 6 * w;
        memcpy(to, p->px + (size_t)y * 3 * w, 3 * (size_t)w);
        for (size_t i = 0; i < 3 * (size_t)w; i++)
            to[3 * (size_t)w + i] =
                (uint8_t)(fminf(fmaxf(rgb[(size_t)y * 3 * w + i], 0.0f), 1.0f) * 255.0f + 0.5f);
    }
    rc = image_write(path, &img, 0, NULL, e);
    image_free(&img);
    return rc;
}

static void evaluate_add(struct evaluate_score *sum, const struct evaluate_score *one)
{
    sum->psnr_db += one->psnr_db;
    sum->seen_psnr_db += one->seen_psnr_db;
    sum->n_seen += one->n_seen;
    sum->ssim += one->ssim;
    sum->ssim_valid += one->ssim_valid;
    sum->l1 += one->l1;
    sum->gmsd += one->gmsd;
    sum->gaussians += one->gaussians;
    sum->visible += one->visible;
    sum->ms_frame += one->ms_frame;
}

/* Whether its mask leaves no pixel. */
static bool evaluate_is_masked(const struct photo *p)
{
    size_t n = (size_t)p->cam.width_px * p->cam.height_px, i = 0;
    while (p->mask && i < n && !p->mask[i])
        i++;
    return p->mask && i == n;
}

static enum err_code evaluate_one(struct photo_loader *f, size_t nth,
                                  const struct evaluate_source *src, struct evaluate_score *sum,
                                  struct err *e)
{
    struct photo photo;
    enum err_code rc = photo_loader_get_nth(f, nth, &photo, e);
    if (rc)
        return rc;
    if (evaluate_is_masked(&photo)) {
        log_warn("eval", "%s: its mask leaves no pixel: not scored", photo.name);
        return ERR_OK;
    }
    float *rgb = mem_array((size_t)photo.cam.width_px * photo.cam.height_px * 3, sizeof *rgb);
    if (!rgb)
        return err_set(e, ERR_MEM, "evaluate: out of memory for %u x %u pixels", photo.cam.width_px,
                       photo.cam.height_px);
    double gaussians = 0.0, start = 0.0, quickest = HUGE_VAL, more = 0.0;
    if (!sum->n_photos)
        rc = src->draw(src->user, &photo.cam, rgb, &gaussians, e);
    for (int k = 0; !rc && k < (src->brief ? 1 : EVALUATE_DRAWS); k++) {
        start = clock_s();
        rc = src->draw(src->user, &photo.cam, rgb, &gaussians, e);
        quickest = fmin(quickest, clock_s() - start);
    }
    if (!rc)
        exposure_expose(photo.exposure_ev, rgb, (size_t)photo.cam.width_px * photo.cam.height_px);
    struct evaluate_score one = {0};
    if (!rc)
        rc = (src->brief ? evaluate_brief : evaluate_photo)(&photo, rgb, &one, e);
    if (!rc && src->ground)
        rc = evaluate_seen(&photo, src->ground, rgb, &one, e);
    if (!rc && src->residuals)
        rc = residual_add(src->residuals, photo.name, pow(10.0, -0.1 * one.psnr_db),
                          residual_ssim(&photo, one.ssim),
                          residual_coverage(src->ground, &photo.cam), e);
    if (!rc) {
        one.ms_frame = 1e3 * quickest;
        one.gaussians = gaussians;
        one.visible = src->render ? render_last_stats(src->render)->visible : 0.0;
        evaluate_add(sum, &one);
        sum->n_photos++;
    }
    if (!rc && src->more)
        rc = src->more->run(src->more->user, &photo, rgb, &more, e);
    sum->more += more;
    if (!rc && src->pictures)
        rc = evaluate_picture(src->pictures, &photo, rgb, e);
    mem_free(rgb);
    return rc;
}

void evaluate_divide(struct evaluate_score *sum, double n)
{
    sum->psnr_db /= n;
    if (sum->n_seen)
        sum->seen_psnr_db /= (double)sum->n_seen;
    sum->ssim /= n;
    sum->ssim_valid /= n;
    sum->l1 /= n;
    sum->gmsd /= n;
    sum->more /= n;
    sum->gaussians /= n;
    sum->visible /= n;
    sum->ms_frame /= n;
}

enum err_code evaluate_run(struct photo_loader *f, size_t n_photos,
                           const struct evaluate_source *src, struct evaluate_score *out,
                           struct err *e)
{
    *out = (struct evaluate_score){.bytes = src->bytes};
    if (!n_photos)
        return err_set(e, ERR_DATA, "evaluate: no test photographs");
    for (size_t i = 0; i < n_photos; i++) {
        enum err_code rc = evaluate_one(f, i, src, out, e);
        if (rc)
            return rc;
        if (signals_stopping())
            return err_set(e, ERR_CANCEL, "stopped while scoring");
    }
    evaluate_divide(out, (double)out->n_photos); /* 0 / 0 is NaN */
    return ERR_OK;
}

enum err_code evaluate_draw_model(void *user, const struct camera *cam, float *rgb,
                                  double *gaussians, struct err *e)
{
    const struct evaluate_model *m = user;
    struct render_options ro = m->options;
    ro.picture = true;
    *gaussians = m->model->n;
    if (m->appearance) {
        ro.appearance_frame = appearance_view_frame(m->appearance, cam);
        ro.appearance_hidden = m->appearance->model->hidden;
    }
    return render_forward(m->render, m->model, cam, &ro, rgb, NULL, e);
}
