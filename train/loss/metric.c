/* PSNR, SSIM and GMSD of a rendered picture against a photograph, in double.
 *
 * Papers use two windows. METRIC_TRAINING is what the loss minimises: it is zero padded, and
 * windows at the border see black beyond the edge. METRIC_VALID has only windows inside the
 * picture, as in most metric libraries. A window is inside exactly if its centre is at least 5 px
 * from every edge, and there the zero-padded map has the same value.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>

#include "core/base.h"
#include "train/loss/metric.h"
#include "train/loss/ssim.h"

enum {
    BORDER_PX = 5,
    GMSD_LEAST_PX = 4,
    METRIC_WITHIN_PLANES = 5 /* two pictures, and three at half their size, rounded up */
};
#define GMSD_T 170.0 /* of the paper, for grey levels 0..255 */

static double metric_clamp(double v)
{
    return v > 0 ? (v < 1 ? v : 1) : 0; /* NaN becomes 0 */
}

static enum err_code metric_check_size(const char *who, uint32_t w, uint32_t h, uint32_t least,
                                       struct err *e)
{
    if (w < least || h < least)
        return err_set(e, ERR_ARG,
                       "%s: a picture of %u x %u px is too small; at least %u x %u is needed", who,
                       w, h, least, least);
    return ERR_OK;
}

enum err_code metric_psnr(const float *rgb, const uint8_t *target, const uint8_t *mask,
                          uint32_t width_px, uint32_t height_px, double *out_db, struct err *e)
{
    enum err_code rc = metric_check_size("metric_psnr", width_px, height_px, 1, e);
    if (rc)
        return rc;
    size_t n = (size_t)width_px * height_px, used = 0;
    double sum = 0;
    for (size_t i = 0; i < n; i++) {
        if (mask && !mask[i])
            continue;
        used++;
        for (size_t c = 0; c < 3; c++) {
            double d = metric_clamp((double)rgb[3 * i + c]) - target[3 * i + c] / 255.0;
            sum += d * d;
        }
    }
    if (!used)
        return err_set(e, ERR_DATA, "metric_psnr: the mask leaves no pixel to compare");
    *out_db = sum > 0 ? 10 * log10(3.0 * (double)used / sum) : HUGE_VAL;
    return ERR_OK;
}

/* Mean of a map [3][h][w] over pixels that are `border` from all edges. */
static double metric_mean(const double *map, size_t w, size_t h, size_t border)
{
    double sum = 0;
    for (size_t c = 0; c < 3; c++)
        for (size_t r = border; r < h - border; r++)
            for (size_t q = border; q < w - border; q++)
                sum += map[(c * h + r) * w + q];
    return sum / (3.0 * (double)((w - 2 * border) * (h - 2 * border)));
}

enum err_code metric_ssim_both(const float *rgb, const uint8_t *target, const uint8_t *mask,
                               uint32_t width_px, uint32_t height_px, double *training,
                               double *valid, struct err *e)
{
    const struct ssim_input in = {rgb, target, mask, false, width_px, height_px};
    size_t w = width_px, h = height_px, n = w * h;
    enum err_code rc = metric_check_size("metric_ssim", width_px, height_px, 1, e);
    if (rc)
        return rc;
    double *map = mem_array(n, 3 * sizeof *map);
    if (!map)
        return err_set(e, ERR_MEM, "metric_ssim: %u x %u px: out of memory", width_px, height_px);
    rc = ssim_map(&in, map, e);
    if (!rc) {
        bool has_inside = w > 2 * BORDER_PX && h > 2 * BORDER_PX;
        *training = metric_mean(map, w, h, 0);
        *valid = has_inside ? metric_mean(map, w, h, BORDER_PX) : (double)NAN;
    }
    mem_free(map);
    return rc;
}

enum err_code metric_ssim(const float *rgb, const uint8_t *target, const uint8_t *mask,
                          uint32_t width_px, uint32_t height_px, enum metric_window window,
                          double *out, struct err *e)
{
    double training = 0, valid = 0;
    uint32_t least = window == METRIC_VALID ? 2 * BORDER_PX + 1 : 1;
    enum err_code rc = metric_check_size("metric_ssim", width_px, height_px, least, e);
    if (!rc)
        rc = metric_ssim_both(rgb, target, mask, width_px, height_px, &training, &valid, e);
    if (!rc)
        *out = window == METRIC_VALID ? valid : training;
    return rc;
}

/* ---- GMSD ---- */

/* Gradient Magnitude Similarity Deviation (Xue, Zhang, Mou and Bovik, IEEE TIP 2014), as its
 * authors' program computes it: grey levels 0..255, means of 2 x 2 pixels, Prewitt gradients / 3,
 * zero beyond the edges, similarity (2ab + T) / (a^2 + b^2 + T), and its standard deviation over
 * the picture (with n - 1). It looks at edges and structure, where Gaussians blur, needs no weights
 * and no viewing distance, and follows people's judgement closely on the usual databases. */

static double metric_gmsd_grey(double r, double g, double b)
{
    return 255.0 * (0.299 * r + 0.587 * g + 0.114 * b); /* ITU-R BT.601 */
}

static double metric_gmsd_at(const double *v, size_t w, size_t h, ptrdiff_t x, ptrdiff_t y)
{
    return x < 0 || y < 0 || x >= (ptrdiff_t)w || y >= (ptrdiff_t)h ? 0.0
                                                                    : v[(size_t)y * w + (size_t)x];
}

/* Mean of 2 x 2 pixels; beyond the picture is zero, so an odd last row or column fades. */
static void metric_gmsd_halve(const double *in, size_t w, size_t h, double *out)
{
    size_t w2 = (w + 1) / 2, h2 = (h + 1) / 2;
    for (size_t y = 0; y < h2; y++)
        for (size_t x = 0; x < w2; x++) {
            ptrdiff_t i = (ptrdiff_t)(2 * x), j = (ptrdiff_t)(2 * y);
            out[y * w2 + x] =
                0.25 *
                (metric_gmsd_at(in, w, h, i, j) + metric_gmsd_at(in, w, h, i + 1, j) +
                 metric_gmsd_at(in, w, h, i, j + 1) + metric_gmsd_at(in, w, h, i + 1, j + 1));
        }
}

static double metric_gmsd_gradient(const double *v, size_t w, size_t h, size_t px, size_t py)
{
    double gx = 0.0, gy = 0.0;
    ptrdiff_t x = (ptrdiff_t)px, y = (ptrdiff_t)py;
    for (ptrdiff_t k = -1; k <= 1; k++) {
        gx += metric_gmsd_at(v, w, h, x + 1, y + k) - metric_gmsd_at(v, w, h, x - 1, y + k);
        gy += metric_gmsd_at(v, w, h, x + k, y + 1) - metric_gmsd_at(v, w, h, x + k, y - 1);
    }
    return sqrt(gx * gx + gy * gy) / 3.0;
}

enum err_code metric_gmsd(const float *rgb, const uint8_t *target, const uint8_t *mask,
                          uint32_t width_px, uint32_t height_px, double *out, struct err *e)
{
    enum err_code rc = metric_check_size("metric_gmsd", width_px, height_px, GMSD_LEAST_PX, e);
    if (rc)
        return rc;
    size_t w = width_px, h = height_px, n = w * h, w2 = (w + 1) / 2, h2 = (h + 1) / 2, n2 = w2 * h2;
    double *block = mem_array(2 * n + 3 * n2, sizeof *block);
    if (!block)
        return err_set(e, ERR_MEM, "metric_gmsd: %u x %u px: out of memory", width_px, height_px);
    double *x = block, *y = x + n, *small_x = y + n, *small_y = small_x + n2, *map = small_y + n2;
    for (size_t i = 0; i < n; i++) {
        const float *p = rgb + 3 * i;
        const uint8_t *t = target + 3 * i;
        bool used = !mask || mask[i];
        x[i] = used ? metric_gmsd_grey(metric_clamp((double)p[0]), metric_clamp((double)p[1]),
                                       metric_clamp((double)p[2]))
                    : 0.0;
        y[i] = used ? metric_gmsd_grey(t[0] / 255.0, t[1] / 255.0, t[2] / 255.0) : 0.0;
    }
    metric_gmsd_halve(x, w, h, small_x);
    metric_gmsd_halve(y, w, h, small_y);
    double mean = 0.0, sum = 0.0;
    for (size_t i = 0; i < n2; i++) {
        double a = metric_gmsd_gradient(small_x, w2, h2, i % w2, i / w2);
        double b = metric_gmsd_gradient(small_y, w2, h2, i % w2, i / w2);
        map[i] = (2.0 * a * b + GMSD_T) / (a * a + b * b + GMSD_T);
        mean += map[i] / (double)n2;
    }
    for (size_t i = 0; i < n2; i++)
        sum += (map[i] - mean) * (map[i] - mean);
    *out = sqrt(sum / (double)(n2 - 1));
    mem_free(block);
    return ERR_OK;
}

/* ---- within a mask ---- */

static double metric_within_ssim(const double *map, const uint8_t *mask, size_t n)
{
    size_t used = 0;
    double sum = 0;
    for (size_t i = 0; i < 3 * n; i++)
        if (mask[i % n]) {
            sum += map[i];
            used++;
        }
    return sum / (double)used;
}

static double metric_within_gmsd(const float *rgb, const uint8_t *target, const uint8_t *mask,
                                 size_t w, size_t h, double *block)
{
    size_t n = w * h, w2 = (w + 1) / 2, h2 = (h + 1) / 2, n2 = w2 * h2, used = 0;
    double *x = block, *y = x + n, *small_x = y + n, *small_y = small_x + n2, *map = small_y + n2;
    double mean = 0, sum = 0;
    for (size_t i = 0; i < n; i++) {
        const float *p = rgb + 3 * i;
        const uint8_t *t = target + 3 * i;
        y[i] = metric_gmsd_grey(t[0] / 255.0, t[1] / 255.0, t[2] / 255.0);
        x[i] = mask[i] ? metric_gmsd_grey(metric_clamp((double)p[0]), metric_clamp((double)p[1]),
                                          metric_clamp((double)p[2]))
                       : y[i];
    }
    metric_gmsd_halve(x, w, h, small_x);
    metric_gmsd_halve(y, w, h, small_y);
    for (size_t i = 0; i < n2; i++) {
        size_t px = 2 * (i % w2), py = 2 * (i / w2);
        if (px + 1 >= w || py + 1 >= h || !mask[py * w + px] || !mask[py * w + px + 1] ||
            !mask[(py + 1) * w + px] || !mask[(py + 1) * w + px + 1])
            continue;
        double a = metric_gmsd_gradient(small_x, w2, h2, i % w2, i / w2);
        double b = metric_gmsd_gradient(small_y, w2, h2, i % w2, i / w2);
        map[used] = (2.0 * a * b + GMSD_T) / (a * a + b * b + GMSD_T);
        mean += map[used++];
    }
    for (size_t i = 0; i < used; i++)
        sum += (map[i] - mean / (double)used) * (map[i] - mean / (double)used);
    return used > 1 ? sqrt(sum / (double)(used - 1)) : 0;
}

enum err_code metric_within(const float *rgb, const uint8_t *target, const uint8_t *mask,
                            uint32_t width_px, uint32_t height_px, struct metric_scores *out,
                            struct err *e)
{
    enum err_code rc = metric_check_size("metric_within", width_px, height_px, GMSD_LEAST_PX, e);
    if (rc)
        return rc;
    size_t w = width_px, h = height_px, n = w * h, used = 0;
    double sum = 0;
    for (size_t i = 0; i < n; i++)
        for (size_t c = 0; c < 3 && mask[i]; c++) {
            double d = metric_clamp((double)rgb[3 * i + c]) - target[3 * i + c] / 255.0;
            sum += d * d;
            used++;
        }
    if (!used)
        return err_set(e, ERR_DATA, "metric_within: the mask is empty");
    const struct ssim_input in = {rgb, target, mask, true, w, h};
    double *block = mem_array(n, METRIC_WITHIN_PLANES * sizeof *block);
    if (!block)
        return err_set(e, ERR_MEM, "metric_within: %u x %u px: out of memory", width_px, height_px);
    out->psnr_db = sum > 0 ? 10 * log10((double)used / sum) : HUGE_VAL;
    rc = ssim_map(&in, block, e);
    if (!rc) {
        out->ssim = metric_within_ssim(block, mask, n);
        out->gmsd = metric_within_gmsd(rgb, target, mask, w, h, block);
    }
    mem_free(block);
    return rc;
}
