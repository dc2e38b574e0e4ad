/* Converts a photograph for a scene: reduces it and removes lens distortion.
 *
 * The pinhole that replaces a distorted lens has square pixels, its principal point in the middle,
 * and the smallest focal length for which every pixel has a source. This is the widest view without
 * black borders, which training would take for black buildings. A photograph that is much too large
 * is first reduced to twice the final size, undistorted there with Catmull-Rom splines, and reduced
 * again with Lanczos. This is as sharp as undistorting at full size, and much faster. Photographs
 * of a pinhole camera are only reduced, or copied unchanged.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>
#include <strings.h>

#include "codec/image/image.h"
#include "codec/limits.h"
#include "scene/ingest/ingest_photo.h"

enum { JPEG_QUALITY = 98, FOCAL_STEPS = 60 };
static const double focal_max = 8; /* times the lens' own: beyond that the view is a keyhole */

/* Does every border pixel of a w x h pinhole picture of focal length f come from inside the
 * photograph? */
static bool photo_borders_inside(const struct lens *l, double f)
{
    double w = l->width_px, h = l->height_px;
    uint32_t steps = 200;
    for (uint32_t side = 0; side < 4; side++)
        for (uint32_t i = 0; i <= steps; i++) {
            double t = (double)i / steps, u, v;
            double px = side == 0   ? 0
                        : side == 1 ? w
                                    : t * w,
                   py = side == 2   ? 0
                        : side == 3 ? h
                                    : t * h;
            double x = (px - 0.5 * w) / f, y = (py - 0.5 * h) / f, bx, by;
            lens_distort(l, x, y, &u, &v);
            if (!(u >= 0 && v >= 0 && u <= w && v <= h))
                return false;
            if (i % 20 == 0) { /* and not by way of a fold in the distortion */
                if (!lens_undistort(l, u, v, &bx, &by) || fabs(bx - x) > 1e-6 ||
                    fabs(by - y) > 1e-6)
                    return false;
            }
        }
    return true;
}

static bool photo_find_focal(const struct lens *l, double *out)
{
    double fx, fy, cx, cy;
    lens_focal(l, &fx, &fy, &cx, &cy);
    double lo = 0.2 * fmin(fx, fy), hi = fmax(fx, fy);
    while (!photo_borders_inside(l, hi)) {
        lo = hi;
        hi *= 1.1;
        if (hi > focal_max * fmax(fx, fy))
            return false;
    }
    for (int i = 0; i < FOCAL_STEPS && hi - lo > 1e-6 * hi; i++) {
        double mid = 0.5 * (lo + hi);
        if (photo_borders_inside(l, mid))
            hi = mid;
        else
            lo = mid;
    }
    *out = hi;
    return true;
}

enum err_code ingest_view_make(const struct lens *lens, uint32_t width_px, uint32_t height_px,
                               uint32_t max_edge_px, struct ingest_view *out, struct err *e)
{
    struct ingest_view v = {.lens = lens_resize(lens, width_px, height_px),
                            .undistort = !lens_is_pinhole(lens)};
    double shrink = fmin(1, max_edge_px / fmax(width_px, height_px));
    uint32_t w = (uint32_t)fmax(1, floor(width_px * shrink + 0.5)),
             h = (uint32_t)fmax(1, floor(height_px * shrink + 0.5));
    struct camera full = {.width_px = width_px, .height_px = height_px};
    if (v.undistort) {
        if (!photo_find_focal(&v.lens, &full.fx_px))
            return err_set(e, ERR_DATA,
                           "the %s lens has no pinhole view without black borders; undistort the "
                           "photographs with COLMAP's image_undistorter first",
                           lens_name(lens->model));
        full.fy_px = full.fx_px;
        full.cx_px = 0.5 * width_px;
        full.cy_px = 0.5 * height_px;
    } else
        lens_focal(&v.lens, &full.fx_px, &full.fy_px, &full.cx_px, &full.cy_px);
    v.pinhole = camera_resize(&full, w, h);
    v.mid_width_px = width_px > 2 * w ? 2 * w : width_px;
    v.mid_height_px = height_px > 2 * h ? 2 * h : height_px;
    *out = v;
    return ERR_OK;
}

bool ingest_view_map(const struct ingest_view *v, const struct lens *lens, double x_px, double y_px,
                     double *u_px, double *v_px)
{
    double x, y;
    if (!lens_undistort(lens, x_px, y_px, &x, &y))
        return false;
    *u_px = v->pinhole.fx_px * x + v->pinhole.cx_px;
    *v_px = v->pinhole.fy_px * y + v->pinhole.cy_px;
    return *u_px >= 0 && *v_px >= 0 && *u_px < v->pinhole.width_px && *v_px < v->pinhole.height_px;
}

/* ---- pixels ---- */

/* Catmull-Rom weights of four neighbours at fraction t between the middle two. */
static void photo_cubic_weights(float t, float w[4])
{
    w[0] = t * (-0.5f + t * (1 - 0.5f * t));
    w[1] = 1 + t * t * (1.5f * t - 2.5f);
    w[2] = t * (0.5f + t * (2 - 1.5f * t));
    w[3] = t * t * (0.5f * t - 0.5f);
}

static size_t photo_clamp_index(int64_t i, size_t n)
{
    return i < 0 ? 0 : (size_t)i >= n ? n - 1 : (size_t)i;
}

static void photo_sample_cubic(const struct image *img, double u, double v, uint8_t out[3])
{
    double x = u - 0.5, y = v - 0.5;
    int64_t i = (int64_t)floor(x), j = (int64_t)floor(y);
    float wx[4], wy[4], sum[3] = {0};
    photo_cubic_weights((float)(x - (double)i), wx);
    photo_cubic_weights((float)(y - (double)j), wy);
    for (int b = 0; b < 4; b++) {
        const uint8_t *row =
            img->px + photo_clamp_index(j - 1 + b, img->height_px) * img->width_px * 3;
        for (int a = 0; a < 4; a++) {
            const uint8_t *p = row + 3 * photo_clamp_index(i - 1 + a, img->width_px);
            float w = wx[a] * wy[b];
            for (int c = 0; c < 3; c++)
                sum[c] += w * p[c];
        }
    }
    for (int c = 0; c < 3; c++)
        out[c] = (uint8_t)(sum[c] <= 0 ? 0 : sum[c] >= 255 ? 255 : sum[c] + 0.5f);
}

/* img becomes the pinhole's picture at img's own size. */
static enum err_code photo_undistort(const struct ingest_view *v, struct image *img, struct err *e)
{
    struct lens lens = lens_resize(&v->lens, img->width_px, img->height_px);
    struct camera cam = camera_resize(&v->pinhole, img->width_px, img->height_px);
    struct image out = {0};
    enum err_code rc = image_alloc(img->width_px, img->height_px, 3, &out, e);
    if (rc)
        return rc;
    for (uint32_t y = 0; y < out.height_px; y++)
        for (uint32_t x = 0; x < out.width_px; x++) {
            double u, w;
            lens_distort(&lens, (x + 0.5 - cam.cx_px) / cam.fx_px,
                         (y + 0.5 - cam.cy_px) / cam.fy_px, &u, &w);
            photo_sample_cubic(img, u, w, out.px + 3 * ((size_t)y * out.width_px + x));
        }
    image_free(img);
    *img = out;
    return ERR_OK;
}

/* Replace img by itself at another size. */
static enum err_code photo_shrink_to(struct image *img, uint32_t width_px, uint32_t height_px,
                                     struct err *e)
{
    struct image out = {0};
    if (img->width_px == width_px && img->height_px == height_px)
        return ERR_OK;
    enum err_code rc = image_resize(img, width_px, height_px, &out, e);
    if (rc)
        return rc;
    image_free(img);
    *img = out;
    return ERR_OK;
}

static bool photo_same_suffix(const char *a, const char *b)
{
    const char *p = strrchr(a, '.'), *q = strrchr(b, '.');
    return p && q && !strcasecmp(p, q);
}

static enum err_code photo_copy_bytes(const char *from, const char *to, struct err *e)
{
    struct buf b = {0};
    enum err_code rc = file_read(from, 0, &b, e);
    if (!rc)
        rc = file_write(to, b.data, b.size, e);
    buf_free(&b);
    return rc;
}

/* A usual photograph says so with its first rows. */
static enum ingest_light photo_light(const struct image *img)
{
    const size_t n = (size_t)img->width_px * img->height_px * img->channels, few = n / 16;
    size_t below = 0;
    bool dark = true;
    for (size_t k = 0; k < n && (dark || below <= few); k++) {
        dark = dark && img->px[k] <= INGEST_DARK_MOST;
        below += img->px[k] < 255;
    }
    return dark ? INGEST_LIGHT_DARK : below <= few ? INGEST_LIGHT_WHITE : INGEST_LIGHT_USUAL;
}

enum err_code ingest_photo_convert(const struct ingest_view *v, const char *from, const char *to,
                                   const struct codec_limits *lim, enum ingest_light *light,
                                   struct err *e)
{
    struct image img = {0};
    *light = INGEST_LIGHT_USUAL;
    enum err_code rc =
        image_read(from, lim, &img, e); /* also when it is only copied: it must be readable */
    if (rc)
        goto out;
    if (img.width_px != v->lens.width_px || img.height_px != v->lens.height_px) {
        rc = err_set(e, ERR_FORMAT, "%s: decodes to %u x %u px, its header says %u x %u", from,
                     img.width_px, img.height_px, v->lens.width_px, v->lens.height_px);
        goto out;
    }
    *light = photo_light(&img);
    bool same_size = img.width_px == v->pinhole.width_px && img.height_px == v->pinhole.height_px;
    if (!v->undistort && same_size && photo_same_suffix(from, to)) {
        rc = photo_copy_bytes(from, to, e);
        goto out;
    }
    if (v->undistort) {
        rc = photo_shrink_to(&img, v->mid_width_px, v->mid_height_px, e);
        if (!rc)
            rc = photo_undistort(v, &img, e);
    }
    if (!rc)
        rc = photo_shrink_to(&img, v->pinhole.width_px, v->pinhole.height_px, e);
    if (!rc)
        rc = image_write(to, &img, JPEG_QUALITY, NULL, e);
out:
    image_free(&img);
    return rc;
}
