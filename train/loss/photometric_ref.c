/* The photometric loss and its gradient in double on the host, the reference of the kernels.
 *
 * K is the window operator (11x11 Gaussian, zero padded, symmetric). With m1 = Kx, m2 = Ky, s1 =
 * Kx^2 - m1^2, s2 = Ky^2 - m2^2, s12 = K(xy) - m1 m2:
 *
 *     A1 = 2 m1 m2 + C1,  A2 = 2 s12 + C2,  B1 = m1^2 + m2^2 + C1,  B2 = s1 + s2 + C2
 *     S = A1 A2 / (B1 B2)
 *
 * As a function of (Kx, Kx^2, K(xy)), S has the derivatives pm, ps, pc. K is its own transpose, so
 * d(sum S)/dx = K pm + 2 x K ps + y K pc. Structural similarity: Wang, Bovik, Sheikh, Simoncelli
 * 2004.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "core/base.h"
#include "train/loss/photometric.h"

enum { RADIUS = 5, TAPS = 2 * RADIUS + 1 };
static const double sigma_px = 1.5;

static void ref_taps(double taps[TAPS])
{
    double sum = 0;
    for (int k = 0; k < TAPS; k++) {
        double d = k - RADIUS;
        taps[k] = exp(-d * d / (2 * sigma_px * sigma_px));
        sum += taps[k];
    }
    for (int k = 0; k < TAPS; k++)
        taps[k] /= sum;
}

static void ref_blur(const double *in, size_t w, size_t h, double *tmp, double *out)
{
    double taps[TAPS];
    ref_taps(taps);
    for (size_t y = 0; y < h; y++)
        for (size_t x = 0; x < w; x++) {
            double sum = 0;
            for (size_t k = 0; k < TAPS; k++)
                if (x + k >= RADIUS && x + k - RADIUS < w)
                    sum += taps[k] * in[y * w + x + k - RADIUS];
            tmp[y * w + x] = sum;
        }
    for (size_t y = 0; y < h; y++)
        for (size_t x = 0; x < w; x++) {
            double sum = 0;
            for (size_t k = 0; k < TAPS; k++)
                if (y + k >= RADIUS && y + k - RADIUS < h)
                    sum += taps[k] * tmp[(y + k - RADIUS) * w + x];
            out[y * w + x] = sum;
        }
}

/* Planes of the scratch block of one channel. */
enum { M1, M2, Q1, Q2, R12, PRODUCT, TMP, PLANES };

static void ref_blur_product(const double *a, const double *b, size_t w, size_t h, double *s,
                             double *out)
{
    size_t n = w * h;
    for (size_t i = 0; i < n; i++)
        s[PRODUCT * n + i] = a[i] * b[i];
    ref_blur(s + PRODUCT * n, w, h, s + TMP * n, out);
}

static void ref_ssim(const double *x, const double *y, size_t w, size_t h, double *s, double *map)
{
    const double c1 = 0.01 * 0.01, c2 = 0.03 * 0.03;
    size_t n = w * h;
    ref_blur(x, w, h, s + TMP * n, s + M1 * n);
    ref_blur(y, w, h, s + TMP * n, s + M2 * n);
    ref_blur_product(x, x, w, h, s, s + Q1 * n);
    ref_blur_product(y, y, w, h, s, s + Q2 * n);
    ref_blur_product(x, y, w, h, s, s + R12 * n);
    for (size_t i = 0; i < n; i++) {
        double m1 = s[M1 * n + i], m2 = s[M2 * n + i];
        double s1 = s[Q1 * n + i] - m1 * m1, s2 = s[Q2 * n + i] - m2 * m2;
        double s12 = s[R12 * n + i] - m1 * m2;
        double a1 = 2 * m1 * m2 + c1, a2 = 2 * s12 + c2;
        double b1 = m1 * m1 + m2 * m2 + c1, b2 = s1 + s2 + c2;
        double ssim = a1 * a2 / (b1 * b2);
        double pc = 2 * a1 / (b1 * b2), ps = -ssim / b2;
        double pm = 2 * m2 * a2 / (b1 * b2) - 2 * m1 * ssim / b1 - 2 * m1 * ps - m2 * pc;
        map[i] = ssim;
        s[Q1 * n + i] =
            pm; /* the blurred products are no longer needed: keep the derivatives there */
        s[Q2 * n + i] = ps;
        s[R12 * n + i] = pc;
    }
}

/* grad += weight * d(sum of SSIM)/dx, from the derivatives ref_ssim left in s. */
static void ref_add_ssim_grad(const double *x, const double *y, size_t w, size_t h, double *s,
                              double weight, double *grad)
{
    size_t n = w * h;
    ref_blur(s + Q1 * n, w, h, s + TMP * n, s + PRODUCT * n);
    for (size_t i = 0; i < n; i++)
        grad[i] += weight * s[PRODUCT * n + i];
    ref_blur(s + Q2 * n, w, h, s + TMP * n, s + PRODUCT * n);
    for (size_t i = 0; i < n; i++)
        grad[i] += weight * 2 * x[i] * s[PRODUCT * n + i];
    ref_blur(s + R12 * n, w, h, s + TMP * n, s + PRODUCT * n);
    for (size_t i = 0; i < n; i++)
        grad[i] += weight * y[i] * s[PRODUCT * n + i];
}

enum err_code photometric_ref_run(const double *rgb, const double *target, const uint8_t *mask,
                                  uint32_t width_px, uint32_t height_px, double l1_weight,
                                  double ssim_weight, double *grad, struct photometric_value *out,
                                  struct err *e)
{
    size_t w = width_px, h = height_px, n = w * h;
    if (!n)
        return err_set(e, ERR_ARG, "photometric_ref_run: %u x %u: the picture is empty", width_px,
                       height_px);
    double *block = mem_array(n, (PLANES + 4) * sizeof *block);
    if (!block)
        return err_set(e, ERR_MEM, "photometric_ref_run: %u x %u: out of memory", width_px,
                       height_px);
    double *x = block, *y = x + n, *map = y + n, *g = map + n, *scratch = g + n;
    double scale = 1 / (3.0 * (double)n);
    *out = (struct photometric_value){0};
    for (size_t c = 0; c < 3; c++) {
        for (size_t i = 0; i < n; i++) {
            double m = !mask || mask[i] ? 1 : 0;
            x[i] = m * rgb[3 * i + c];
            y[i] = m * target[3 * i + c];
            double d = x[i] - y[i];
            out->l1 += scale * fabs(d);
            out->mse += scale * d * d;
            g[i] = l1_weight * scale * (double)((d > 0) - (d < 0));
        }
        ref_ssim(x, y, w, h, scratch, map);
        for (size_t i = 0; i < n; i++)
            out->ssim += scale * map[i];
        ref_add_ssim_grad(x, y, w, h, scratch, -ssim_weight * scale, g);
        for (size_t i = 0; grad && i < n; i++)
            grad[3 * i + c] = !mask || mask[i] ? g[i] : 0;
    }
    if (ssim_weight == 0)
        out->ssim = 1;
    out->total = l1_weight * out->l1 + ssim_weight * (1 - out->ssim);
    mem_free(block);
    return ERR_OK;
}
