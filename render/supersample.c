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
#include "core/math/simd.h"
#include "core/pool.h"

#define SUPERSAMPLE_SIGMAS 3.0
enum {
    SUPERSAMPLE_TAPS = 20,    /* at most */
    SUPERSAMPLE_COLUMNS = 64, /* of a picture at a time */
    SUPERSAMPLE_ROWS = 16,    /* ... and rows that a thread takes */
    SUPERSAMPLE_PHASE = SUPERSAMPLE_COLUMNS + SUPERSAMPLE_TAPS / 2, /* taps at 2, of each parity */
    SUPERSAMPLE_LINE = SUPERSAMPLE_PHASE * SUPERSAMPLE_MOST
};

struct supersample {
    const float *planes;
    float *out;
    size_t n, width, height, factor;     /* n: planes; the size is that of the small picture */
    size_t taps;                         /* of each axis */
    size_t before;                       /* fine pixels before a pixel's first own one */
    size_t whole[2];                     /* columns whose taps all lie inside */
    float weight[SUPERSAMPLE_TAPS], all; /* all: their sum */
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
        s->all += s->weight[i];
    }
    s->whole[0] = (s->before + s->factor - 1) / s->factor;
    while (s->whole[1] < s->width &&
           (s->whole[1] + 1) * s->factor + s->before <= s->width * s->factor)
        s->whole[1]++;
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

/* Values of planes side by side. */
SIMD_INLINE void supersample_lace(float v[][SUPERSAMPLE_COLUMNS], size_t columns, const size_t n,
                                  float *out)
{
    for (size_t x = 0; x < columns; x++)
        for (size_t p = 0; p < n; p++)
            out[n * x + p] = v[p][x];
}

/* The fine rows of a row: taps first to end - 1, and 1 over the sum of their weights. */
struct supersample_down {
    size_t first, end;
    float share;
};

/* Some columns of a row: their fine columns down the rows, then along. What is beyond the picture
 * counts as 0, and the weights of a pixel there as not being. `row`: the first fine row. */
SIMD_INLINE void supersample_columns(const struct supersample *s, const float *row, size_t x0,
                                     size_t columns, const struct supersample_down down,
                                     const size_t factor, float out[SUPERSAMPLE_COLUMNS])
{
    float line[SUPERSAMPLE_LINE] = {0}; /* fine pixel x0 * factor - before first */
    float sum[SUPERSAMPLE_COLUMNS] = {0}, phase[SUPERSAMPLE_MOST][SUPERSAMPLE_PHASE];
    const size_t fine_width = s->width * factor, left = x0 ? s->before : 0;
    const size_t n = left + columns * factor + s->before, at = x0 * factor - left;
    const size_t inside = n < fine_width - at ? n : fine_width - at;
    for (size_t k = down.first; k < down.end; k++) {
        const float w = s->weight[k], *from = row + (k - down.first) * fine_width + at;
        float *to = line + s->before - left;
        for (size_t i = 0; i < inside; i++)
            to[i] += w * from[i];
    }
    for (size_t i = 0; i < SUPERSAMPLE_PHASE; i++)
        for (size_t p = 0; p < factor; p++)
            phase[p][i] = line[i * factor + p];
    for (size_t k = 0; k < s->taps; k++) {
        const float w = s->weight[k], *from = &phase[k % factor][k / factor];
        for (size_t x = 0; x < SUPERSAMPLE_COLUMNS; x++)
            sum[x] += w * from[x];
    }
    const float usual = down.share * (1.0f / s->all);
    for (size_t x = 0; x < SUPERSAMPLE_COLUMNS; x++)
        out[x] = sum[x] * usual;
    for (size_t x = 0; x < columns; x++) {
        size_t a, b;
        if (x0 + x < s->whole[0] || x0 + x >= s->whole[1])
            out[x] = sum[x] * (down.share * supersample_span(s, x0 + x, s->width, &a, &b));
    }
}

SIMD_INLINE void supersample_row_of(const struct supersample *s, size_t y, const size_t factor,
                                    const size_t n_planes)
{
    size_t fine_width = s->width * factor, fine = fine_width * s->height * factor;
    struct supersample_down down;
    down.share = supersample_span(s, y, s->height, &down.first, &down.end);
    const float *row = s->planes + (y * factor + down.first - s->before) * fine_width;
    float v[SUPERSAMPLE_PLANES][SUPERSAMPLE_COLUMNS];
    for (size_t x0 = 0; x0 < s->width; x0 += SUPERSAMPLE_COLUMNS) {
        size_t columns = s->width - x0 < SUPERSAMPLE_COLUMNS ? s->width - x0 : SUPERSAMPLE_COLUMNS;
        for (size_t p = 0; p < n_planes; p++)
            supersample_columns(s, row + p * fine, x0, columns, down, factor, v[p]);
        supersample_lace(v, columns, n_planes, s->out + n_planes * (y * s->width + x0));
    }
}

SIMD_INLINE void supersample_copy_of(const struct supersample *s, size_t y, const size_t n_planes)
{
    const float *row = s->planes + y * s->width;
    float *out = s->out + n_planes * y * s->width;
    for (size_t x = 0; x < s->width; x++)
        for (size_t p = 0; p < n_planes; p++)
            out[n_planes * x + p] = row[p * s->width * s->height + x];
}

/* Sizes that are usual are constants to the compiler. */
SIMD_WIDE static void supersample_row_wide(const struct supersample *s, size_t y)
{
    if (s->factor == 1 && s->n == 3)
        supersample_copy_of(s, y, 3);
    else if (s->factor == 1)
        supersample_copy_of(s, y, s->n);
    else if (s->factor == 2 && s->n == 3)
        supersample_row_of(s, y, 2, 3);
    else
        supersample_row_of(s, y, s->factor, s->n);
}

static enum err_code supersample_rows(void *user, size_t band, struct err *e)
{
    const struct supersample *s = user;
    (void)e;
    for (size_t y = band * SUPERSAMPLE_ROWS; y < s->height && y < (band + 1) * SUPERSAMPLE_ROWS;
         y++)
        supersample_row_wide(s, y);
    return ERR_OK;
}

/* NOLINTBEGIN(readability-non-const-parameter): out is written through `s` */
enum err_code supersample_reduce(const float *planes, size_t n, uint32_t width_px,
                                 uint32_t height_px, uint32_t factor, double kernel_px2, float *out,
                                 struct err *e)
{
    struct supersample s = {.planes = planes,
                            .out = out,
                            .n = n,
                            .width = width_px,
                            .height = height_px,
                            .factor = factor};
    assert(n >= 1 && n <= SUPERSAMPLE_PLANES && factor >= 1 && factor <= SUPERSAMPLE_MOST);
    if (factor > 1)
        supersample_weights(&s, kernel_px2);
    return pool_for((height_px + SUPERSAMPLE_ROWS - 1) / SUPERSAMPLE_ROWS, 0, supersample_rows, &s,
                    e);
}
/* NOLINTEND(readability-non-const-parameter) */
