/* The map of structural similarity, a band of rows of one channel at a time.
 *
 * A band and the rows that its windows reach fit into the cache: its products are blurred along
 * rows into scratch, then along columns, and the five means give the map. The window is that of
 * photometric_ref.c, and sums are added in the same order.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/loss/ssim.h"

#include <math.h>
#include <string.h>

#include "core/base.h"
#include "core/math/simd.h"
#include "core/pool.h"

enum {
    SSIM_RADIUS = 5,
    SSIM_TAPS = 2 * SSIM_RADIUS + 1,
    SSIM_BAND = 32,
    SSIM_ROWS = SSIM_BAND + 2 * SSIM_RADIUS
};
enum { SSIM_X, SSIM_Y, SSIM_XX, SSIM_YY, SSIM_XY, SSIM_MEANS };
#define SSIM_SIGMA_PX 1.5
#define SSIM_C1 (0.01 * 0.01)
#define SSIM_C2 (0.03 * 0.03)

struct ssim_work {
    const struct ssim_input *in;
    double *map;
    double taps[SSIM_TAPS];
    size_t bands;
};

static void ssim_taps(double taps[SSIM_TAPS])
{
    double sum = 0;
    for (int k = 0; k < SSIM_TAPS; k++) {
        double d = k - SSIM_RADIUS;
        taps[k] = exp(-d * d / (2 * SSIM_SIGMA_PX * SSIM_SIGMA_PX));
        sum += taps[k];
    }
    for (int k = 0; k < SSIM_TAPS; k++)
        taps[k] /= sum;
}

/* A row of both pictures and its products, [SSIM_MEANS][w + 2 SSIM_RADIUS]; the ends stay 0. */
static void ssim_row(const struct ssim_input *in, size_t channel, size_t row, double *out)
{
    size_t w = in->width_px, stride = w + 2 * SSIM_RADIUS;
    for (size_t i = 0; i < w; i++) {
        size_t at = row * w + i;
        double v = (double)in->rgb[3 * at + channel], y = in->target[3 * at + channel] / 255.0;
        double x = v > 0 ? (v < 1 ? v : 1) : 0;
        bool used = !in->mask || in->mask[at];
        if (!used) {
            y = in->within ? y : 0;
            x = y;
        }
        double *to = out + SSIM_RADIUS + i;
        to[SSIM_X * stride] = x;
        to[SSIM_Y * stride] = y;
        to[SSIM_XX * stride] = x * x;
        to[SSIM_YY * stride] = y * y;
        to[SSIM_XY * stride] = x * y;
    }
}

/* out[i] = sum of taps[k] in[i + k step]: along a row with step 1, along a column with a row's. */
SIMD_WIDE static void ssim_blur(const double taps[SSIM_TAPS], const double *restrict in,
                                size_t step, size_t n, double *restrict out)
{
    for (size_t i = 0; i < n; i++) {
        double sum = 0;
        for (size_t k = 0; k < SSIM_TAPS; k++)
            sum += taps[k] * in[i + k * step];
        out[i] = sum;
    }
}

/* mean: [SSIM_MEANS][n]. */
SIMD_WIDE static void ssim_of_means(const double *restrict mean, size_t n, double *restrict map)
{
    for (size_t i = 0; i < n; i++) {
        double m1 = mean[SSIM_X * n + i], m2 = mean[SSIM_Y * n + i];
        double s1 = mean[SSIM_XX * n + i] - m1 * m1, s2 = mean[SSIM_YY * n + i] - m2 * m2;
        double s12 = mean[SSIM_XY * n + i] - m1 * m2;
        double a1 = 2 * m1 * m2 + SSIM_C1, a2 = 2 * s12 + SSIM_C2;
        double b1 = m1 * m1 + m2 * m2 + SSIM_C1, b2 = s1 + s2 + SSIM_C2;
        map[i] = a1 * a2 / (b1 * b2);
    }
}

static enum err_code ssim_band(void *user, size_t i, struct err *e)
{
    const struct ssim_work *s = user;
    size_t w = s->in->width_px, h = s->in->height_px, channel = i / s->bands;
    size_t first = i % s->bands * SSIM_BAND, wide = w + 2 * SSIM_RADIUS;
    size_t end = first + SSIM_BAND < h ? first + SSIM_BAND : h;
    /* [SSIM_ROWS][SSIM_MEANS][w] blurred rows; a row; means */
    double *rows = mem_uninit(SSIM_MEANS * (SSIM_ROWS * w + wide + w), sizeof *rows);
    if (!rows)
        return err_set(e, ERR_MEM, "SSIM: %zu x %zu px: out of memory", w, h);
    double *row = rows + (size_t)SSIM_ROWS * SSIM_MEANS * w, *mean = row + SSIM_MEANS * wide;
    memset(row, 0, SSIM_MEANS * wide * sizeof *row);
    for (size_t k = 0; k < SSIM_ROWS && first + k < end + 2 * SSIM_RADIUS; k++) {
        size_t y = first + k - SSIM_RADIUS; /* wraps above the picture */
        double *to = rows + k * SSIM_MEANS * w;
        if (y >= h) {
            memset(to, 0, SSIM_MEANS * w * sizeof *to);
            continue;
        }
        ssim_row(s->in, channel, y, row);
        for (size_t m = 0; m < SSIM_MEANS; m++)
            ssim_blur(s->taps, row + m * wide, 1, w, to + m * w);
    }
    for (size_t y = first; y < end; y++) {
        ssim_blur(s->taps, rows + (y - first) * SSIM_MEANS * w, SSIM_MEANS * w, SSIM_MEANS * w,
                  mean);
        ssim_of_means(mean, w, s->map + (channel * h + y) * w);
    }
    mem_free(rows);
    return ERR_OK;
}

enum err_code ssim_map(const struct ssim_input *in, double *map, struct err *e)
{
    struct ssim_work s = {.in = in, .bands = (in->height_px + SSIM_BAND - 1) / SSIM_BAND};
    s.map = map;
    ssim_taps(s.taps);
    return pool_for(3 * s.bands, 0, ssim_band, &s, e);
}
