/* See quant_look.h.
 *
 * Colours: the error of a colour in direction d is sum_i e_i Y_i(d), e the errors of the
 * coefficients. Its mean square over directions is e' G e, G the mean of Y Y'. A direction counts
 * by the cosine to nadir, as flat ground fills pictures. Seen from above alone, G is nearly
 * singular: many sets of coefficients look alike, and the grid has one that looks much more like
 * the trained colour than the nearest integers do. With G = U' U and U upper triangular, e' G e =
 * sum_i U_ii^2 (e_i + sum_{j>i} U_ij / U_ii e_j)^2. So coefficients are rounded from the last to
 * the first, each about what makes its square 0 (Babai's nearest plane, 1986). Red and blue are
 * rounded about the green that is written, because files hold the differences.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/quant_look.h"

#include <math.h>
#include <string.h>

#include "core/layout.h"
#include "core/math/cholesky.h"
#include "core/splat/sh.h"

enum { DOWN_STEPS = 16, ROUND_STEPS = 16 }; /* directions: cosines to nadir, and azimuths */
/* Of directions from below, against those from above. It keeps G invertible, and errors bounded
 * where nobody is expected. */
#define BELOW 0.06
/* A harmonic of less than 0.5 + DEAD steps is 0, and what it lacks goes into the others. */
#define DEAD 0.25f
#define COLOR_UNIT (1 / 255.0f / 0.15f) /* of an integer, in DC */
#define SH_UNIT (1 / 128.0f)
#define COLOR_MAX (0.5f / 0.15f) /* of DC; harmonics reach 1 */
#define R 0.70710678f

struct look {
    size_t k_in, k_out, k; /* coefficients of a channel: trained, written, the more of both */
    int shift[LAYOUT_SH_MAX];
    float per_step[LAYOUT_SH_MAX], zero[LAYOUT_SH_MAX]; /* steps of one unit, and of value 0 */
    float push[LAYOUT_SH_MAX][LAYOUT_SH_MAX]; /* what an error of one adds to those before it */
};

/* The rotations that map the axes to themselves, w x y z. */
static const float turns[24][4] = {
    {1, 0, 0, 0},          {0, 1, 0, 0},           {0, 0, 1, 0},           {0, 0, 0, 1},
    {R, R, 0, 0},          {R, -R, 0, 0},          {R, 0, R, 0},           {R, 0, -R, 0},
    {R, 0, 0, R},          {R, 0, 0, -R},          {0, R, R, 0},           {0, R, -R, 0},
    {0, R, 0, R},          {0, R, 0, -R},          {0, 0, R, R},           {0, 0, R, -R},
    {.5f, .5f, .5f, .5f},  {.5f, .5f, .5f, -.5f},  {.5f, .5f, -.5f, .5f},  {.5f, .5f, -.5f, -.5f},
    {.5f, -.5f, .5f, .5f}, {.5f, -.5f, .5f, -.5f}, {.5f, -.5f, -.5f, .5f}, {.5f, -.5f, -.5f, -.5f},
};

void quant_look_turn(float q[4], uint8_t scale[3])
{
    const uint8_t was[3] = {scale[0], scale[1], scale[2]};
    const float a[4] = {q[0], q[1], q[2], q[3]}, *t = turns[0];
    float best = -1;
    for (int i = 0; i < 24; i++) { /* w of q times the turn */
        const float *p = turns[i], w = fabsf(a[0] * p[0] - a[1] * p[1] - a[2] * p[2] - a[3] * p[3]);
        if (w > best) {
            best = w;
            t = p;
        }
    }
    q[0] = a[0] * t[0] - a[1] * t[1] - a[2] * t[2] - a[3] * t[3];
    q[1] = a[0] * t[1] + a[1] * t[0] + a[2] * t[3] - a[3] * t[2];
    q[2] = a[0] * t[2] - a[1] * t[3] + a[2] * t[0] + a[3] * t[1];
    q[3] = a[0] * t[3] + a[1] * t[2] - a[2] * t[1] + a[3] * t[0];
    for (int to = 0; to < 3; to++) /* the new axis is the old one that the turn brings there */
        for (int from = 0; from < 3; from++) {
            const float both = t[1 + to] * t[1 + from], twist = t[0] * t[1 + (6 - to - from) % 3],
                        half = to == from             ? t[0] * t[0] + both - 0.5f
                               : (to + 1) % 3 == from ? both + twist
                                                      : both - twist; /* of the matrix' cell */
            if (fabsf(half) > 0.25f)
                scale[to] = was[from];
        }
}

/* push[j][i] = U_ij / U_ii for i < j, otherwise 0. */
static void look_push(size_t k, float push[LAYOUT_SH_MAX][LAYOUT_SH_MAX])
{
    double g[LAYOUT_SH_MAX][LAYOUT_SH_MAX] = {{0}}, y[LAYOUT_SH_MAX];
    for (int i = 0; i < DOWN_STEPS; i++)
        for (int j = 0; j < ROUND_STEPS; j++) {
            const double down = (i + 0.5) / DOWN_STEPS, side = sqrt(1 - down * down),
                         azimuth = (j + 0.5) * 2 * 3.14159265358979323846 / ROUND_STEPS;
            sh_basis((const double[3]){side * cos(azimuth), -down, side * sin(azimuth)},
                     GAUSS_SH_DEGREE_MAX, y);
            for (size_t r = 0; r < k; r++)
                for (size_t c = 0; c <= r; c++)
                    g[r][c] += 2 * down * y[r] * y[c] / (DOWN_STEPS * ROUND_STEPS);
        }
    for (size_t r = 0; r < k; r++)
        g[r][r] += BELOW * GAUSS_SH_C0 * GAUSS_SH_C0;
    memset(push, 0, LAYOUT_SH_MAX * sizeof *push);
    if (cholesky_factor(&g[0][0], k, LAYOUT_SH_MAX)) /* always: BELOW */
        for (size_t j = 0; j < k; j++)
            for (size_t i = 0; i < j; i++)
                push[j][i] = (float)(g[j][i] / g[i][i]);
}

/* The step nearest to v steps, 0 for less than 0.5 + dead of them. */
static int look_round(float v, float dead)
{
    const float size = fabsf(v);
    const int step = (int)(size + 0.5f - (size < 1 ? dead : 0));
    return v < 0 ? -step : step;
}

/* The step of coefficient i nearest to `target`, rounded about a step. */
static int look_step(const struct look *l, size_t i, float target, int about)
{
    const float at = target * l->per_step[i] + l->zero[i] - (float)about;
    const int step = about + look_round(at, i ? DEAD : 0), most = 256 >> l->shift[i];
    return step < 0 ? 0 : step > most ? most : step;
}

/* One row; its channels side by side, because each waits for its own coefficient before. */
static void look_row(const struct look *l, const float *in, uint8_t *color, uint8_t *sh)
{
    static const size_t order[3] = {1, 0, 2}; /* the others are rounded about green */
    float target[3][LAYOUT_SH_MAX] = {{0}}, want[3][LAYOUT_SH_MAX] = {{0}};
    for (size_t i = 0; i < l->k_in; i++)
        for (size_t c = 0; c < 3; c++) {
            const float v = in[3 * i + c], most = i ? 1 : COLOR_MAX;
            want[c][i] = target[c][i] = v < -most ? -most : v > most ? most : v;
        }
    for (size_t i = l->k; i-- > 0;) {
        int about = 128 >> l->shift[i];
        for (size_t n = 0; n < 3; n++) {
            const size_t c = order[n];
            float error = want[c][i];
            if (i < l->k_out) {
                const int step = look_step(l, i, target[c][i], about);
                const int v = step << l->shift[i] > 255 ? 255 : step << l->shift[i];
                about = n ? about : step;
                error -= ((float)v - (i ? 128 : 127.5f)) * (i ? SH_UNIT : COLOR_UNIT);
                *(i ? sh + 3 * (i - 1) + c : color + c) = (uint8_t)v;
            }
            for (size_t j = 0; j < LAYOUT_SH_MAX; j++)
                target[c][j] += l->push[i][j] * error;
        }
    }
}

void quant_look_colors(const struct gauss *g, uint32_t sh_degree, unsigned color_bits,
                       const uint8_t sh_bits[3], uint8_t *color, uint8_t *sh)
{
    struct look l = {.k_in = gauss_sh_count(g->sh_degree), .k_out = gauss_sh_count(sh_degree)};
    l.k = l.k_in > l.k_out ? l.k_in : l.k_out;
    look_push(l.k, l.push);
    for (size_t i = 0; i < LAYOUT_SH_MAX; i++) {
        l.shift[i] = i == 0 ? (int)color_bits : sh_bits[i < 4 ? 0 : i < 9 ? 1 : 2];
        l.per_step[i] = 1 / ((i ? SH_UNIT : COLOR_UNIT) * (float)(1 << l.shift[i]));
        l.zero[i] = (i ? 128 : 127.5f) / (float)(1 << l.shift[i]);
    }
    for (size_t row = 0; row < g->n; row++)
        look_row(&l, g->sh + row * l.k_in * 3, color + 3 * row, sh + row * (l.k_out - 1) * 3);
}
