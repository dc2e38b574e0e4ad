/* Measures of a surface: geometry whose figures are known by hand (lab/EVALUATION.md, "Surfaces").
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/render/render_kit.h"

#include <math.h>
#include <string.h>

#include "core/splat/camera.h"
#include "lab/eval/surface_match.h"
#include "lab/truth/surface_rays.h"

enum { SIDE = 33, PIXELS = SIDE * SIDE, MIDDLE = PIXELS / 2 };
#define DEPTH_M 1e-4 /* float depths of some ten metres */

struct maps {
    float rgb[3 * PIXELS], median[PIXELS], near[PIXELS], far[PIXELS], left[PIXELS], met[PIXELS];
};

/* What 10 pixels a metre see from 20 m above (0, 0, 0). */
static void look_down(const struct gauss *g, struct maps *out)
{
    struct err e = {0};
    struct render_model m = {0};
    struct render_surface *s = NULL;
    const double eye[3] = {0, 0, 20}, target[3] = {0, 0, 0};
    struct camera cam = camera_look_at(eye, target, 0.9, SIDE, SIDE);
    const struct render_options o = {.aa = RENDER_AA_2D, .sh_degree = -1, .orthographic = true};
    const struct render_surface_maps maps = {.median_m = out->median,
                                             .near_m = out->near,
                                             .far_m = out->far,
                                             .transmittance = out->left,
                                             .met = out->met};
    cam.fx_px = cam.fy_px = 10;
    kit_ok(render_surface_open(render, &s, &e), e);
    kit_ok(render_model_upload(render, g, &m, &e), e);
    kit_ok(render_forward(render, &m, &cam, &o, out->rgb, NULL, &e), e);
    kit_ok(render_surface_run(s, NULL, &maps, &e), e);
    render_surface_close(&s);
    render_model_free(&m);
}

/* A lying disc: its height is exact, its alpha in the middle is its opacity. */
static void lay(struct gauss *g, size_t i, double x, double y, double z, double sigma,
                double opacity)
{
    const float quat[4] = {1, 0, 0, 0};
    g->mean_m[3 * i] = (float)x;
    g->mean_m[3 * i + 1] = (float)y;
    g->mean_m[3 * i + 2] = (float)z;
    memcpy(g->quat_wxyz + 4 * i, quat, sizeof quat);
    g->opacity_logit[i] = (float)log(opacity / (1 - opacity));
    for (size_t k = 0; k < 3; k++)
        g->scale_log[3 * i + k] = (float)log(k == 2 ? 1e-3 : sigma);
}

static struct surface_ray ray_of(const struct maps *m, size_t i, double truth_m)
{
    return surface_ray_make((double)m->median[i], (double)m->near[i], (double)m->far[i],
                            (double)m->left[i], (double)m->met[i], 1.0, truth_m);
}

/* A plane at 3 m over a truth of 2.8 m: one disc stops all light, so it is 0.2 m too high and has
 * no thickness. */
static void a_plane_is_thin_and_as_high_as_it_is(void **state)
{
    struct gauss g = {0};
    static struct maps m;
    kit_gauss(1, 1, 1.0, 0, 0, &g);
    lay(&g, 0, 0, 0, 3.0, 20.0, 0.999);
    look_down(&g, &m);
    for (size_t i = 0; i < PIXELS; i++) {
        struct surface_ray r = ray_of(&m, i, 20.0 - 2.8);
        assert_true(fabs((double)r.error_m - 0.2) < DEPTH_M);
        assert_true(r.thickness_m == 0.0f && r.met == 1);
        assert_true(r.left < 0.02f);
    }
    gauss_free(&g);
}

/* Layers that each take a fifth, half a metre apart: the first takes transmittance to 0.8, below
 * 0.9; 0.8^11 = 0.086 is the first below 0.1; 0.8^4 = 0.41 the first below 1/2. */
static void fog_is_as_thick_as_its_layers(void **state)
{
    enum { LAYERS = 16 };
    struct gauss g = {0};
    static struct maps m;
    kit_gauss(1, LAYERS, 1.0, 0, 0, &g);
    for (size_t i = 0; i < LAYERS; i++)
        lay(&g, i, 0, 0, 10.0 - 0.5 * (double)i, 50.0, 0.2);
    look_down(&g, &m);
    struct surface_ray r = ray_of(&m, MIDDLE, 20.0 - 10.0);
    assert_true(fabs((double)r.thickness_m - 10 * 0.5) < DEPTH_M);
    assert_true(fabs((double)r.error_m + 3 * 0.5) < DEPTH_M); /* too low */
    assert_true(fabs((double)r.left - pow(0.8, LAYERS)) < 1e-3);
    assert_int_equal(r.met, 11);
    /* With ten layers light gets through: 0.8^10 = 0.107. */
    g.n = 10;
    look_down(&g, &m);
    r = ray_of(&m, MIDDLE, 10.0);
    assert_true(isnan(r.thickness_m) && isfinite(r.error_m));
    assert_int_equal(r.met, 10);
    gauss_free(&g);
}

/* Half of the picture has a plane: the other half is a hole. */
static void a_hole_has_its_share(void **state)
{
    struct gauss g = {0};
    struct err e = {0};
    struct surface_rays rays = {0};
    struct surface_figures f;
    static struct maps m;
    size_t n = 0, holes = 0;
    kit_gauss(1, 256, 1.0, 0, 0, &g);
    for (size_t i = 0; i < 256; i++) /* x from -4 to 0 */
        lay(&g, i, -0.25 * (double)(i % 16) - 0.2, 0.25 * ((double)(i / 16) - 7.5), 0.0, 0.2,
            0.999);
    look_down(&g, &m);
    for (size_t i = 0; i < PIXELS; i++) {
        double x = ((double)(i % SIDE) + 0.5 - 0.5 * SIDE) / 10.0;
        if (fabs(x) < 0.8) /* where discs fade */
            continue;
        const struct surface_ray r = ray_of(&m, i, 20.0);
        kit_ok(surface_rays_add(&rays, &r, &e), e);
        n++;
        holes += x > 0;
    }
    kit_ok(surface_rays_tell(&rays, &(struct surface_pick){0}, 0.2, &f, &e), e);
    assert_true(fabs(f.missing - (double)holes / (double)n) < 1e-12);
    assert_true(fabs(f.never - (double)holes / (double)n) < 1e-12);
    for (size_t k = 0; k < SURFACE_ABOVE; k++) /* what is not there is off */
        assert_true(fabs(f.above[k] - (double)holes / (double)n) < 1e-12);
    assert_true(f.rmse_m < DEPTH_M);
    surface_rays_free(&rays);
    gauss_free(&g);
}

static void figures_are_those_by_hand(void **state)
{
    const float error[] = {-0.1f, 0.1f, 0.3f, 0.7f, -1.2f, NAN},
                bright[] = {0.5f, 0.5f, 0.6f, 0.8f, 0.1f, 0.3f};
    struct surface_rays rays = {0};
    struct surface_figures f;
    struct err e = {0};
    for (size_t i = 0; i < 6; i++) {
        const struct surface_ray r = {.error_m = error[i],
                                      .thickness_m = i == 5 ? NAN : 0.1f * (float)(i + 1),
                                      .left = 0.01f * (float)i,
                                      .bright = bright[i],
                                      .met = (uint16_t)(2 * i),
                                      .kind = i < 3 ? SURFACE_GROUND : SURFACE_WALL,
                                      .edge = i % 2,
                                      .found = i < 5};
        kit_ok(surface_rays_add(&rays, &r, &e), e);
    }
    kit_ok(surface_rays_tell(&rays, &(struct surface_pick){0}, 0.2, &f, &e), e);
    /* Mean error of the five -0.04, mean brightness 0.5. */
    double xy = -0.06 * 0 + 0.14 * 0 + 0.34 * 0.1 + 0.74 * 0.3 + -1.16 * -0.4,
           xx = 0.06 * 0.06 + 0.14 * 0.14 + 0.34 * 0.34 + 0.74 * 0.74 + 1.16 * 1.16,
           yy = 0.01 + 0.09 + 0.16;
    const double got[] = {
        f.missing,     f.median_m,       f.off_m,    f.rmse_m,   f.nmad_m,   f.le90_m,
        f.above[0],    f.above[1],       f.above[3], f.above[4], f.above[2], f.le95_m,
        f.thickness_m, f.thickness_90_m, f.never,    f.left_90,  f.met,      f.follows_brightness};
    const double want[] = {1.0 / 6,
                           0.3,
                           0.1,
                           sqrt((0.01 + 0.01 + 0.09 + 0.49 + 1.44) / 5),
                           1.4826 * 0.2 /* about 0.1: 0, 0.2, 0.2, 0.6, 1.3 */,
                           1.2,
                           4.0 / 6,
                           3.0 / 6,
                           3.0 / 6,
                           2.0 / 6,
                           2.0 / 6,
                           1.2,
                           0.3,
                           0.5,
                           1.0 / 6,
                           0.05,
                           5.0,
                           xy / sqrt(xx * yy)};
    kit_near_d("figures", got, want, sizeof got / sizeof *got, 1e-6, 0.0);
    const struct surface_pick walls = {.kinds = 1u << SURFACE_WALL}, level = {.level = true},
                              edge = {.edge = true},
                              dark = {.bright_from = 0.2f, .bright_to = 0.55f};
    const struct surface_pick *const picks[] = {&walls, &level, &edge, &dark};
    for (size_t i = 0; i < 4; i++) {
        kit_ok(surface_rays_tell(&rays, picks[i], 0.2, &f, &e), e);
        assert_int_equal(f.n, 3);
    }
    surface_rays_free(&rays);
    kit_ok(surface_rays_tell(&rays, &level, 0.2, &f, &e), e); /* of nothing */
    assert_true(f.n == 0 && isnan(f.rmse_m) && isnan(f.never) && isnan(f.follows_brightness));
}

/* ---- points ---- */

enum { GRID = 80 }; /* points on an edge of a square, 0.05 m apart */

static void spread(struct surface_cloud *c, double x0, double x1, double z, uint8_t kind)
{
    struct err e = {0};
    for (size_t i = 0; i < GRID * GRID; i++) {
        const double p[3] = {0.05 * ((double)(i % GRID) + 0.5), 0.05 * ((double)(i / GRID) + 0.5),
                             z};
        if (p[0] > x0 && p[0] < x1)
            kit_ok(surface_cloud_add(c, p, kind, &e), e);
    }
}

/* The truth: ground on the left half, roof on the right. The model: the ground 0.03 m too high, the
 * roof 0.15 m too high, and a sheet of haze as large as the ground. */
static void matches_are_those_by_hand(void **state)
{
    struct surface_cloud model = {.voxel_m = 0.05}, truth = {.voxel_m = 0.05};
    struct surface_match m[SURFACE_MATCHES][SURFACE_CLASSES + 1];
    const double within[SURFACE_MATCHES] = {0.1, 0.2};
    struct err e = {0};
    spread(&truth, 0.0, 2.0, 0.01, SURFACE_GROUND);
    spread(&truth, 2.0, 4.0, 5.01, SURFACE_ROOF);
    spread(&model, 0.0, 2.0, 0.04, SURFACE_CLASSES);
    spread(&model, 2.0, 4.0, 5.16, SURFACE_CLASSES);
    spread(&model, 0.0, 2.0, 2.01, SURFACE_CLASSES);
    for (int pass = 0; pass < 2; pass++) { /* of all points, and of every other */
        kit_ok(surface_match_tell(&model, &truth, within, pass ? 5000 : 100000, m, &e), e);
        const double got[] = {m[0][SURFACE_CLASSES].precision,
                              m[0][SURFACE_CLASSES].recall,
                              m[1][SURFACE_CLASSES].precision,
                              m[1][SURFACE_CLASSES].recall,
                              m[0][SURFACE_GROUND].precision,
                              m[0][SURFACE_GROUND].recall,
                              m[0][SURFACE_GROUND].f1,
                              m[0][SURFACE_ROOF].f1,
                              m[1][SURFACE_ROOF].f1};
        const double want[] = {1.0 / 3, 0.5, 2.0 / 3, 1.0, 0.5, 1.0, 2.0 / 3, 0.0, 1.0};
        kit_near_d("matches", got, want, sizeof got / sizeof *got, 1e-9, 0.0);
    }
    assert_true(isnan(m[0][SURFACE_TREE].f1));
    /* The first point of a voxel stays. */
    assert_int_equal(truth.n, GRID * GRID);
    spread(&truth, 0.0, 4.0, 0.02, SURFACE_WALL);
    assert_int_equal(truth.n, GRID * GRID * 3 / 2);
    surface_cloud_free(&model);
    /* A model of nothing finds nothing. */
    kit_ok(surface_match_tell(&model, &truth, within, 1000, m, &e), e);
    assert_true(isnan(m[0][SURFACE_CLASSES].precision) && m[0][SURFACE_CLASSES].recall == 0.0 &&
                m[0][SURFACE_CLASSES].f1 == 0.0);
    const double far[3] = {1e6, 0, 0}, unknown[3] = {0, (double)NAN, 0};
    kit_fails(surface_cloud_add(&truth, far, 0, &e), ERR_LIMIT, e, "too far");
    kit_fails(surface_cloud_add(&truth, unknown, 0, &e), ERR_LIMIT, e, "too far");
    surface_cloud_free(&truth);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_plane_is_thin_and_as_high_as_it_is),
        cmocka_unit_test(fog_is_as_thick_as_its_layers),
        cmocka_unit_test(a_hole_has_its_share),
        cmocka_unit_test(figures_are_those_by_hand),
        cmocka_unit_test(matches_are_those_by_hand),
    };
    return cmocka_run_group_tests(tests, render_kit_open, render_kit_close);
}
