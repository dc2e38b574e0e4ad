/* A Gaussian smaller than a pixel is drawn as large as a pixel and fainter, and several that tile a
 * surface then let what is behind them through, which their area would have covered. Drawn finer,
 * they cover again; the filter gives the picture the blur that its own kernel would have.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "render/supersample.h"

#include <math.h>

#include "core/base.h"
#include "core/pool.h"

#define SUPERSAMPLE_SIGMAS 3.0
enum { SUPERSAMPLE_TAPS = 20, SUPERSAMPLE_COLUMNS = 64 };

struct supersample {
    const float *plane;
    float *out;
    size_t stride, width, height, factor;
    size_t taps;      /* of each axis */
    ptrdiff_t before; /* fine pixels before a pixel's first own one */
    float weight[SUPERSAMPLE_TAPS];
};

static void supersample_weights(struct supersample *s, double kernel_px2)
{
    double f = (double)s->factor, variance = kernel_px2 * (f * f - 1.0);
    s->before = (ptrdiff_t)ceil(SUPERSAMPLE_SIGMAS * sqrt(variance) - 0.5 * f);
    s->before = s->before > 0 ? s->before : 0;
    s->taps = s->factor + 2 * (size_t)s->before;
    for (size_t i = 0; i < s->taps; i++) {
        double d = (double)i + 0.5 - 0.5 * (double)s->taps;
        s->weight[i] = (float)exp(-0.5 * d * d / variance);
    }
}

/* The taps of pixel `at` of an axis of n pixels that lie inside, [*first, *end), and the fine pixel
 * of the first of them; 1 / their sum. */
static float supersample_span(const struct supersample *s, size_t at, size_t n, size_t *first,
                              size_t *end, size_t *fine)
{
    ptrdiff_t from = (ptrdiff_t)(at * s->factor) - s->before, most = (ptrdiff_t)(n * s->factor);
    float sum = 0.0f;
    *first = from < 0 ? (size_t)-from : 0;
    *end = from + (ptrdiff_t)s->taps > most ? (size_t)(most - from) : s->taps;
    *fine = (size_t)(from + (ptrdiff_t)*first);
    for (size_t i = *first; i < *end; i++)
        sum += s->weight[i];
    return 1.0f / sum;
}

/* A row, some columns at a time: their fine columns down the rows, then along. */
static enum err_code supersample_row(void *user, size_t y, struct err *e)
{
    const struct supersample *s = user;
    float column[SUPERSAMPLE_COLUMNS * SUPERSAMPLE_MOST + 2 * SUPERSAMPLE_TAPS];
    size_t first, end, fine, fine_width = s->width * s->factor;
    float share = supersample_span(s, y, s->height, &first, &end, &fine);
    (void)e;
    for (size_t x0 = 0; x0 < s->width; x0 += SUPERSAMPLE_COLUMNS) {
        size_t x1 = x0 + SUPERSAMPLE_COLUMNS < s->width ? x0 + SUPERSAMPLE_COLUMNS : s->width;
        size_t a, b, left, right, f0, f1;
        (void)supersample_span(s, x0, s->width, &a, &b, &f0);
        (void)supersample_span(s, x1 - 1, s->width, &left, &right, &f1);
        size_t n = f1 + (right - left) - f0;
        for (size_t i = 0; i < n; i++)
            column[i] = 0.0f;
        for (size_t k = first; k < end; k++) {
            const float *from = s->plane + (fine + k - first) * fine_width + f0;
            for (size_t i = 0; i < n; i++)
                column[i] += s->weight[k] * from[i];
        }
        for (size_t x = x0; x < x1; x++) {
            size_t at;
            float sum = 0.0f, along = supersample_span(s, x, s->width, &a, &b, &at);
            for (size_t k = a; k < b; k++)
                sum += s->weight[k] * column[at - f0 + k - a];
            s->out[(y * s->width + x) * s->stride] = sum * share * along;
        }
    }
    return ERR_OK;
}

/* NOLINTBEGIN(readability-non-const-parameter): out is written through `s` */
enum err_code supersample_reduce(const float *plane, uint32_t width_px, uint32_t height_px,
                                 uint32_t factor, double kernel_px2, float *out, size_t stride,
                                 struct err *e)
{
    struct supersample s = {.plane = plane,
                            .out = out,
                            .stride = stride,
                            .width = width_px,
                            .height = height_px,
                            .factor = factor};
    supersample_weights(&s, kernel_px2);
    return pool_for(height_px, 0, supersample_row, &s, e);
}
/* NOLINTEND(readability-non-const-parameter) */
