/* Masks of photographs: reading, shrinking, undistorting, and what they do to points and residuals.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/mask.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { MASK_USE = 128, MASK_SUB_MAX = 8, MASK_PATCH = 2 };
#define MASK_OUTLIER (3.0f * 1.4826f) /* robust standard deviations from the MAD */

enum err_code mask_path(const char *dir, const char *photo_name, char out[FILE_PATH_MAX],
                        struct err *e)
{
    char name[FILE_PATH_MAX];
    if (snprintf(name, sizeof(name), "%s.png", photo_name) >= (int)sizeof(name))
        return err_set(e, ERR_LIMIT, "%.100s...: the name is too long", photo_name);
    return file_join(out, dir, name, e);
}

enum err_code mask_read(const char *path, uint32_t width_px, uint32_t height_px, struct image *out,
                        struct err *e)
{
    struct image img = {0};
    *out = (struct image){0};
    enum err_code rc = image_read(path, NULL, &img, e);
    if (!rc && (img.width_px != width_px || img.height_px != height_px))
        rc = err_set(e, ERR_DATA, "%s: a mask of %u x %u pixels for a photograph of %u x %u", path,
                     img.width_px, img.height_px, width_px, height_px);
    if (!rc)
        rc = image_alloc(width_px, height_px, 1, out, e);
    for (size_t i = 0; !rc && i < (size_t)width_px * height_px; i++)
        out->px[i] = img.px[i * img.channels] < MASK_USE ? 0 : 255;
    image_free(&img);
    return rc;
}

enum err_code mask_resize(const struct image *in, uint32_t width_px, uint32_t height_px,
                          struct image *out, struct err *e)
{
    enum err_code rc = image_alloc(width_px, height_px, 1, out, e);
    if (rc)
        return rc;
    memset(out->px, 255, (size_t)width_px * height_px);
    for (uint32_t y = 0; y < in->height_px; y++)
        for (uint32_t x = 0; x < in->width_px; x++) {
            if (in->px[(size_t)y * in->width_px + x])
                continue;
            /* All pixels of the result that this one touches. */
            uint64_t x0 = (uint64_t)x * width_px / in->width_px;
            uint64_t x1 = ((uint64_t)(x + 1) * width_px - 1) / in->width_px;
            uint64_t y0 = (uint64_t)y * height_px / in->height_px;
            uint64_t y1 = ((uint64_t)(y + 1) * height_px - 1) / in->height_px;
            for (uint64_t j = y0; j <= y1; j++)
                memset(out->px + j * width_px + x0, 0, x1 - x0 + 1);
        }
    return ERR_OK;
}

enum err_code mask_convert(const struct ingest_view *v, const char *from, const char *to,
                           struct err *e)
{
    struct image in = {0}, out = {0};
    uint32_t w = v->pinhole.width_px, h = v->pinhole.height_px;
    enum err_code rc = mask_read(from, v->lens.width_px, v->lens.height_px, &in, e);
    if (!rc && !v->undistort)
        rc = mask_resize(&in, w, h, &out, e);
    else if (!rc)
        rc = image_alloc(w, h, 1, &out, e);
    double step = fmax((double)v->lens.width_px / w, (double)v->lens.height_px / h);
    uint32_t sub = (uint32_t)fmin(ceil(step) + 1.0, MASK_SUB_MAX);
    for (size_t i = 0; !rc && v->undistort && i < (size_t)w * h; i++) {
        out.px[i] = 255;
        for (uint32_t k = 0; k < sub * sub; k++) {
            double x = (double)(i % w) + (k % sub + 0.5) / sub, ux, uy;
            double y = (double)(i / w) + (k / sub + 0.5) / sub;
            lens_distort(&v->lens, (x - v->pinhole.cx_px) / v->pinhole.fx_px,
                         (y - v->pinhole.cy_px) / v->pinhole.fy_px, &ux, &uy);
            if (ux >= 0.0 && uy >= 0.0 && ux < in.width_px && uy < in.height_px &&
                !in.px[(size_t)uy * in.width_px + (size_t)ux])
                out.px[i] = 0;
        }
    }
    if (!rc)
        rc = image_write(to, &out, 0, NULL, e);
    image_free(&in);
    image_free(&out);
    return rc;
}

/* Tracks are sorted by photograph. */
static size_t mask_first_track(const struct scene *s, uint32_t image)
{
    size_t lo = 0, hi = s->n_tracks;
    while (lo < hi) {
        size_t mid = lo + (hi - lo) / 2;
        if (s->tracks[mid].image < image)
            lo = mid + 1;
        else
            hi = mid;
    }
    return lo;
}

enum err_code mask_points(const struct scene *s, const uint32_t *images, size_t n_images,
                          uint8_t *use, struct err *e)
{
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    enum err_code rc = file_join(dir, s->dir, "masks", e);
    if (rc || !file_is_dir(dir))
        return rc;
    for (size_t i = 0; !rc && i < n_images; i++) {
        const struct scene_image *im = &s->images[images[i]];
        struct image mask = {0};
        rc = mask_path(dir, im->name, path, e);
        if (rc || !file_exists(path))
            continue;
        rc = mask_read(path, im->cam.width_px, im->cam.height_px, &mask, e);
        for (size_t t = mask_first_track(s, images[i]);
             !rc && t < s->n_tracks && s->tracks[t].image == images[i]; t++) {
            float x = s->tracks[t].x_px, y = s->tracks[t].y_px;
            if (x >= 0.0f && y >= 0.0f && x < (float)mask.width_px && y < (float)mask.height_px &&
                !mask.px[(size_t)y * mask.width_px + (size_t)x])
                use[s->tracks[t].point] = 0;
        }
        image_free(&mask);
    }
    return rc;
}

/* ---- robust weighting ---- */

enum { MASK_BINS = 4096 };

/* The value below which half of the counts lie, by a histogram over 0..1: 1/4096 is far below what
 * matters, and the cost does not depend on the data. */
static float mask_median(const uint32_t bin[MASK_BINS], size_t n)
{
    size_t below = 0;
    uint32_t k = 0;
    while (k + 1 < MASK_BINS && (below += bin[k]) * 2 < n)
        k++;
    return ((float)k + 0.5f) / MASK_BINS;
}

static uint32_t mask_bin(float v)
{
    return v >= 1.0f ? MASK_BINS - 1 : v > 0.0f ? (uint32_t)(v * MASK_BINS) : 0;
}

void mask_robust(const float *color, const uint8_t *px, uint32_t width_px, uint32_t height_px,
                 float *scratch, uint8_t *out)
{
    uint32_t bin[MASK_BINS] = {0};
    size_t n = (size_t)width_px * height_px, used = 0;
    for (size_t i = 0; i < n; i++) {
        scratch[i] = 0.0f;
        for (size_t c = 0; c < 3; c++)
            scratch[i] += fabsf(color[c * n + i] - (float)px[3 * i + c] / 255.0f) / 3.0f;
        bin[mask_bin(scratch[i])] += out[i] != 0;
        used += out[i] != 0;
    }
    float median = mask_median(bin, used);
    memset(bin, 0, sizeof(bin));
    for (size_t i = 0; i < n; i++)
        bin[mask_bin(fabsf(scratch[i] - median))] += out[i] != 0;
    float limit = median + MASK_OUTLIER * mask_median(bin, used);
    for (int64_t y = 0; y < height_px; y++)
        for (int64_t x = 0; x < width_px; x++) {
            int over = 0, all = 0;
            for (int64_t v = y - MASK_PATCH; v <= y + MASK_PATCH; v++)
                for (int64_t u = x - MASK_PATCH; u <= x + MASK_PATCH; u++)
                    if (u >= 0 && v >= 0 && u < width_px && v < height_px) {
                        all++;
                        over += scratch[v * width_px + u] > limit;
                    }
            if (2 * over > all)
                out[y * width_px + x] = 0;
        }
}
