/* Pictures of a few Gaussians by the kernels, compared with the double-precision reference.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_DRAW_KIT_H
#define TESTS_DRAW_KIT_H

#include "tests/render/render_kit.h"

#include <math.h>
#include <string.h>

#include "core/splat/camera.h"
#include "render/render_ref.h"

/* Float against double: typical pixels agree to a few rounding errors of sums of tens of terms. */
#define RMS_TOL 4e-6
/* A splat at the 1/255 cut-off may be drawn by one and not by the other: 0.004 of its colour (about
 * 1). */
#define MAX_TOL 6e-3
/* How many pixels may be off by more than rounding: those with a splat within 1e-5 of the cut-off.
 */
#define ROUNDING_TOL 5e-5
#define OUTLIERS_PER_VALUE 2e-3

struct picture {
    float *rgb, *t;
    size_t pixels;
};

static inline void picture_free(struct picture *p)
{
    mem_free(p->rgb);
    mem_free(p->t);
    memset(p, 0, sizeof *p);
}

static inline struct picture draw_with(struct render *r, const struct gauss *g,
                                       const struct camera *cam, const struct render_options *o)
{
    struct err e = {0};
    struct render_model m = {0};
    struct picture p = {.pixels = (size_t)cam->width_px * cam->height_px};
    p.rgb = mem_array(3 * p.pixels, sizeof *p.rgb);
    p.t = mem_array(p.pixels, sizeof *p.t);
    assert_non_null(p.rgb);
    assert_non_null(p.t);
    kit_ok(render_model_upload(r, g, &m, &e), e);
    kit_ok(render_forward(r, &m, cam, o, p.rgb, p.t, &e), e);
    render_model_free(&m);
    return p;
}

static inline struct picture draw(const struct gauss *g, const struct camera *cam,
                                  const struct render_options *o)
{
    return draw_with(render, g, cam, o);
}

static inline void compare(const char *what, const float *got, const double *want, size_t n)
{
    double sum = 0, worst = 0;
    size_t at = 0, outliers = 0;
    for (size_t i = 0; i < n; i++) {
        double d = fabs((double)got[i] - want[i]);
        assert_true(isfinite(got[i]));
        if (d > worst) {
            worst = d;
            at = i;
        }
        if (d > ROUNDING_TOL)
            outliers++;
        else
            sum += d * d;
    }
    if (worst > MAX_TOL || sqrt(sum / (double)n) > RMS_TOL ||
        (double)outliers > 1 + OUTLIERS_PER_VALUE * (double)n)
        fail_msg(
            "%s: rms %.3g (limit %.3g), %zu of %zu beyond rounding, worst [%zu] got %.9g want %.9g",
            what, sqrt(sum / (double)n), RMS_TOL, outliers, n, at, (double)got[at], want[at]);
}

/* Device against reference for one view. */
static inline void check(const char *what, const struct gauss *g, const struct camera *cam,
                         const struct render_options *o)
{
    struct err e = {0};
    struct picture p = draw(g, cam, o);
    double *rgb = mem_array(3 * p.pixels, sizeof *rgb), *t = mem_array(p.pixels, sizeof *t);
    assert_non_null(rgb);
    assert_non_null(t);
    kit_ok(render_ref_forward(g, cam, o, rgb, t, &e), e);
    compare(what, p.rgb, rgb, 3 * p.pixels);
    compare(what, p.t, t, p.pixels);
    mem_free(rgb);
    mem_free(t);
    picture_free(&p);
}

static inline struct camera view_from(double x, double y, double z, uint32_t width, uint32_t height)
{
    const double eye[3] = {x, y, z}, target[3] = {0.2, -0.1, 0.1};
    return camera_look_at(eye, target, 0.9, width, height);
}

static const struct render_options PLAIN = {.aa = RENDER_AA_2D, .sh_degree = -1};

static inline void expect_same_bits(const char *what, const struct picture *a,
                                    const struct picture *b)
{
    if (memcmp(a->rgb, b->rgb, 3 * a->pixels * sizeof(float)) ||
        memcmp(a->t, b->t, a->pixels * sizeof(float)))
        fail_msg("%s: pictures differ", what);
}

#endif
