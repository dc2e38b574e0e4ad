/* See test_views.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/test_views.h"

#include <math.h>
#include <string.h>

#include "codec/scene/scene.h"
#include "core/splat/exposure.h"
#include "train/loss/metric.h"
#include "train/photographs/photo_loader.h"

#define VIEWS_SAME_DB 120.0 /* of a picture to itself */

enum err_code test_views_open(struct render *r, const struct scene *scene, const uint32_t *images,
                              size_t n, uint32_t max_edge_px, double downsample,
                              struct test_views *out, struct err *e)
{
    const struct photo_loader_config f = {.scene = scene,
                                          .images = images,
                                          .n_images = n,
                                          .max_edge_px = max_edge_px,
                                          .downsample = downsample,
                                          .exposure = PHOTO_LOADER_TOLD,
                                          .cache_bytes = (size_t)1 << 30};
    const struct camera cam =
        photo_loader_camera(&scene->images[images[0]].cam, max_edge_px, downsample);
    *out = (struct test_views){.render = r, .n = n, .truth = mem_array(n, sizeof *out->truth)};
    out->edge_px = cam.width_px > cam.height_px ? cam.width_px : cam.height_px;
    return out->truth ? photo_loader_open(&f, &out->feed, e) : err_set(e, ERR_MEM, "out of memory");
}

void test_views_close(struct test_views *s)
{
    for (size_t i = 0; s->truth && i < s->n; i++)
        mem_free(s->truth[i]);
    mem_free(s->truth);
    photo_loader_close(&s->feed);
    *s = (struct test_views){0};
}

static double views_psnr(const float *a, const float *b, size_t n)
{
    double sum = 0;
    for (size_t i = 0; i < n; i++) {
        double d = (double)fminf(fmaxf(a[i], 0), 1) - (double)fminf(fmaxf(b[i], 0), 1);
        sum += d * d;
    }
    return fmin(10 * log10((double)n / (sum + 1e-12)), VIEWS_SAME_DB);
}

static enum err_code views_one(struct test_views *s, size_t i, const struct render_model *m,
                               const struct render_options *ro, bool keep,
                               struct test_views_score *sum, struct err *e)
{
    struct photo photo;
    double psnr = 0, ssim = 0;
    enum err_code rc = photo_loader_get_nth(s->feed, i, &photo, e);
    if (rc)
        return rc;
    uint32_t w = photo.cam.width_px, h = photo.cam.height_px;
    size_t n = (size_t)w * h * 3;
    float *rgb = mem_array(n, sizeof *rgb);
    if (!rgb)
        return err_set(e, ERR_MEM, "out of memory for a picture");
    rc = render_forward(s->render, m, &photo.cam, ro, rgb, NULL, e);
    if (!rc && keep) {
        mem_free(s->truth[i]);
        s->truth[i] = mem_array(n, sizeof *rgb);
        if (s->truth[i])
            memcpy(s->truth[i], rgb, n * sizeof *rgb);
        else
            rc = err_set(e, ERR_MEM, "out of memory for a picture");
    }
    if (!rc && s->truth[i]) /* as drawn, before the exposure of the photograph */
        sum->self_db += views_psnr(rgb, s->truth[i], n) / (double)s->n;
    if (!rc) {
        exposure_expose(photo.exposure_ev, rgb, (size_t)w * h);
        rc = metric_psnr(rgb, photo.px, photo.mask, w, h, &psnr, e);
    }
    if (!rc)
        rc = metric_ssim(rgb, photo.px, photo.mask, w, h, METRIC_TRAINING, &ssim, e);
    sum->psnr_db += psnr / (double)s->n;
    sum->ssim += ssim / (double)s->n;
    mem_free(rgb);
    return rc;
}

enum err_code test_views_score(struct test_views *s, const struct gauss *g,
                               const struct render_options *ro, bool keep,
                               struct test_views_score *out, struct err *e)
{
    struct render_model m = {0};
    enum err_code rc = render_model_upload(s->render, g, &m, e);
    *out = (struct test_views_score){0};
    for (size_t i = 0; !rc && i < s->n; i++)
        rc = views_one(s, i, &m, ro, keep, out, e);
    render_model_free(&m);
    return rc;
}
