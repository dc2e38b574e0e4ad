/* Supersampling. A Gaussian smaller than a pixel is drawn as large as a pixel and fainter. Several
 * of them that cover a surface then let things behind it shine through. At a higher resolution they
 * cover it. The filter gives the small picture the blur of its own kernel.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "render/supersample.h"

#include <assert.h>
#include <math.h>
#include <stdbool.h>

#include "core/base.h"
#include "core/pool.h"

#define SUPERSAMPLE_SIGMAS 3.0
enum {
    SUPERSAMPLE_TAPS = 20,    /* at most */
    SUPERSAMPLE_COLUMNS = 64, /* of a picture at a time */
    SUPERSAMPLE_LINE = SUPERSAMPLE_COLUMNS * SUPERSAMPLE_MOST + SUPERSAMPLE_TAPS
};

struct supersample {
    const float *plane;
    float *out;
    size_t stride, width, height, factor;
    size_t taps;   /* of each axis */
    size_t before; /* fine pixels before a pixel's first own one */
    float weight[SUPERSAMPLE_TAPS];
};

static void supersample_weights(struct supersample *s, double kernel_px2)
{
    double f = (double)s->factor, variance = kernel_px2 * (f * f - 1.0);
    s->before = (size_t)fmax(ceil(SUPERSAMPLE_SIGMAS * sqrt(variance) - 0.5 * f), 0.0);
    s->taps = s->factor + 2 * s->before;
    assert(s->taps <= SUPERSAMPLE_TAPS);
    for (size_t i = 0; i < s->taps; i++) {
        double d = (double)i + 0.5 - 0.5 * (double)s->taps;
        s->weight[i] = (float)exp(-0.5 * d * d / variance);
    }
}

/* The taps of pixel `at` of an axis of n pixels that lie inside, [*first, *end); 1 / their sum. */
static float supersample_span(const struct supersample *s, size_t at, size_t n, size_t *first,
                              size_t *end)
{
    size_t from = at * s->factor, most = n * s->factor + s->before; /* both of fine pixels, moved */
    float sum = 0.0f;
    *first = from < s->before ? s->before - from : 0;
    *end = from + s->taps > most ? most - from : s->taps;
    for (size_t i = *first; i < *end; i++)
        sum += s->weight[i];
    return 1.0f / sum;
}

/* A row, some columns at a time: their fine columns down the rows, then along. What is beyond the
 * picture counts as 0, and the weights of a pixel there as not being. */
static enum err_code supersample_row(void *user, size_t y, struct err *e)
{
    const struct supersample *s = user;
    size_t first, end, fine_width = s->width * s->factor;
    float share = supersample_span(s, y, s->height, &first, &end), all = 0.0f;
    for (size_t k = 0; k < s->taps; k++)
        all += s->weight[k];
    const float *row = s->plane + (y * s->factor + first - s->before) * fine_width;
    (void)e;
    for (size_t x0 = 0; x0 < s->width; x0 += SUPERSAMPLE_COLUMNS) {
        float line[SUPERSAMPLE_LINE] = {0}; /* fine pixel x0 * factor - before first */
        float sum[SUPERSAMPLE_COLUMNS] = {0};
        float phase[SUPERSAMPLE_MOST][SUPERSAMPLE_COLUMNS + SUPERSAMPLE_TAPS] = {{0}};
        size_t columns = s->width - x0 < SUPERSAMPLE_COLUMNS ? s->width - x0 : SUPERSAMPLE_COLUMNS;
        size_t left = x0 ? s->before : 0, n = left + columns * s->factor + s->before;
        size_t at = x0 * s->factor - left;
        const size_t inside = n < fine_width - at ? n : fine_width - at;
        for (size_t k = first; k < end; k++)
            for (size_t i = 0; i < inside; i++)
                line[s->before - left + i] += s->weight[k] * row[(k - first) * fine_width + at + i];
        for (size_t i = 0; i < columns * s->factor + 2 * s->before; i++)
            phase[i % s->factor][i / s->factor] = line[i];
        for (size_t k = 0; k < s->taps; k++)
            for (size_t x = 0; x < columns; x++)
                sum[x] += s->weight[k] * phase[k % s->factor][k / s->factor + x];
        for (size_t x = 0; x < columns; x++) {
            size_t a, b, to = x0 + x;
            bool whole =
                to * s->factor >= s->before && (to + 1) * s->factor + s->before <= fine_width;
            float along = whole ? 1.0f / all : supersample_span(s, to, s->width, &a, &b);
            s->out[(y * s->width + to) * s->stride] = sum[x] * (share * along);
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
