/* Pictures drawn finer than wanted and filtered, against the filter by its definition.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/render/draw_kit.h"

#include <math.h>

/* The filter, by its definition: weights of both axes at once, in double. */
static void reduce(const double *fine, size_t width, size_t height, size_t factor, size_t channels,
                   double *out)
{
    double variance = 0.3 * (double)(factor * factor - 1);
    ptrdiff_t f = (ptrdiff_t)factor, w = (ptrdiff_t)width, h = (ptrdiff_t)height;
    ptrdiff_t reach = (ptrdiff_t)ceil(3.0 * sqrt(variance) - 0.5 * (double)f);
    for (ptrdiff_t i = 0; i < w * h; i++) {
        double sum[3] = {0}, all = 0.0;
        for (ptrdiff_t y = i / w * f - reach; y < (i / w + 1) * f + reach; y++)
            for (ptrdiff_t x = i % w * f - reach; x < (i % w + 1) * f + reach; x++) {
                double dx = (double)x + 0.5 - ((double)(i % w) + 0.5) * (double)f,
                       dy = (double)y + 0.5 - ((double)(i / w) + 0.5) * (double)f,
                       weight = exp(-0.5 * (dx * dx + dy * dy) / variance);
                if (x < 0 || y < 0 || x >= f * w || y >= f * h)
                    continue;
                all += weight;
                for (size_t c = 0; c < channels; c++)
                    sum[c] += weight * fine[(size_t)(y * f * w + x) * channels + c];
            }
        for (size_t c = 0; c < channels; c++)
            out[(size_t)i * channels + c] = sum[c] / all;
    }
}

static void test_supersampling(void **state)
{
    static const uint32_t sizes[][2] = {{33, 20}, {1, 1}, {130, 3}}; /* 64 columns at a time */
    static double fine[4 * 4 * 33 * 20 * 3], fine_t[4 * 4 * 33 * 20], rgb[33 * 20 * 3], t[33 * 20];
    struct err e = {0};
    struct gauss g;
    kit_gauss(23, 200, 3.0, 1, 0, &g);
    for (uint32_t factor = 2; factor <= 4; factor++)
        for (size_t s = 0; s < sizeof sizes / sizeof *sizes; s++) {
            uint32_t w = sizes[s][0], h = sizes[s][1];
            struct camera cam = view_from(20, 10, 5, w, h);
            const struct camera large = camera_resize(&cam, factor * w, factor * h);
            struct render_options o = PLAIN;
            o.background[1] = 0.5f;
            kit_ok(render_ref_forward(&g, &large, &o, fine, fine_t, &e), e);
            reduce(fine, w, h, factor, 3, rgb);
            reduce(fine_t, w, h, factor, 1, t);
            o.supersample = factor;
            struct picture p = draw(&g, &cam, &o);
            compare("supersampled colours", p.rgb, rgb, 3 * p.pixels);
            compare("supersampled transmittance", p.t, t, p.pixels);
            picture_free(&p);
        }
    struct render_options o = {.aa = RENDER_AA_NONE, .supersample = 2};
    struct camera cam = view_from(20, 10, 5, 8, 8), wide = view_from(20, 10, 5, 8193, 1);
    struct render_model m;
    kit_ok(render_model_upload(render, &g, &m, &e), e);
    kit_fails(render_forward(render, &m, &cam, &o, NULL, NULL, &e), ERR_ARG, e, "anti-aliased");
    o.aa = RENDER_AA_2D;
    o.supersample = 5;
    kit_fails(render_forward(render, &m, &cam, &o, NULL, NULL, &e), ERR_ARG, e, "1 to 4");
    o.supersample = 2;
    kit_fails(render_forward(render, &m, &wide, &o, NULL, NULL, &e), ERR_ARG, e, "at most 8192");
    o.background_where = (const uint8_t[8 * 8]){0};
    kit_fails(render_forward(render, &m, &cam, &o, NULL, NULL, &e), ERR_ARG, e,
              "another background");
    render_model_free(&m);
    gauss_free(&g);
}

/* Opaque splats that tile a wall hide what is behind it; smaller than a pixel, each is faint, and
 * drawn finer they hide more again. */
static void test_supersampling_hides_more(void **state)
{
    enum { SIDE = 120 };
    struct gauss g;
    double left[2] = {0};
    kit_gauss(24, (size_t)SIDE * SIDE, 1.0, 0, 0, &g);
    for (size_t i = 0; i < g.n; i++) {
        g.mean_m[3 * i] = 0.05f * ((float)(i % SIDE) - 0.5f * SIDE);
        g.mean_m[3 * i + 1] = 0.05f * ((float)(i / SIDE) - 0.5f * SIDE);
        g.mean_m[3 * i + 2] = 0.0f;
        g.opacity_logit[i] = 4.0f;
        for (size_t k = 0; k < 3; k++)
            g.scale_log[3 * i + k] = logf(0.03f);
    }
    const double eye[3] = {0, 0, 40}, target[3] = {0};
    const struct camera cam = camera_look_at(eye, target, 0.12, 32, 32);
    for (uint32_t factor = 1; factor <= 2; factor++) {
        struct render_options o = PLAIN;
        o.supersample = factor;
        struct picture p = draw(&g, &cam, &o);
        for (size_t i = 0; i < p.pixels; i++)
            left[factor - 1] += (double)p.t[i] / (double)p.pixels;
        picture_free(&p);
    }
    assert_true(left[1] < 0.9 * left[0]);
    gauss_free(&g);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_supersampling),
        cmocka_unit_test(test_supersampling_hides_more),
    };
    return cmocka_run_group_tests_name("supersample", tests, render_kit_open, render_kit_close);
}
