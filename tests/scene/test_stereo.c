/* Depth of photographs from their neighbours: maps between pictures, the kernels in both shapes
 * against the reference in double, fused points, and a small city from end to end against its exact
 * depth.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jansson.h>

#include "codec/container/npy.h"
#include "codec/image/image.h"
#include "codec/scene/scene.h"
#include "core/device/dev.h"
#include "scene/stereo/depths.h"
#include "scene/stereo/fuse.h"
#include "scene/stereo/pairs.h"
#include "scene/stereo/sweep.h"
#include "tests/scene/city_kit.h"

enum { VIEWS = 4, VIEW_W = 90, VIEW_H = 70, PLANES = 40 };
#define EYE_M 40.0

static struct dev dev;
static struct arena texts;
static uint8_t grey[2][VIEWS][VIEW_H * VIEW_W];
static struct sweep_input input, aslant;

/* Value noise in three octaves: texture of level ground and of a level roof at 6 m. */
static double paint(double x, double y, uint64_t seed)
{
    double sum = 0.0;
    for (int octave = 0; octave < 3; octave++) {
        double cell = 0.6 * (1 << octave), u = x / cell + 1000, v = y / cell + 1000;
        double fu = u - floor(u), fv = v - floor(v), at[4];
        for (uint64_t k = 0; k < 4; k++)
            at[k] = rng_unit(seed, (uint64_t)octave,
                             ((uint64_t)v + k / 2) * 4096 + (uint64_t)u + k % 2);
        sum += (1 - fv) * ((1 - fu) * at[0] + fu * at[1]) + fv * ((1 - fu) * at[2] + fu * at[3]);
    }
    return sum / 3;
}

static double height_of(double x, double y)
{
    return fabs(x) < 5 && fabs(y) < 4 ? 6.0 : 0.0;
}

/* The place that a pixel shows, and its paint. Returns 0: ground, 1: roof, 2: wall at y = -4. */
static int pixel_of(const struct camera *c, double x, double y, double at[3], double *painted)
{
    double eye[3], ray[3], a = (x - c->cx_px) / c->fx_px, b = (y - c->cy_px) / c->fy_px;
    camera_center(c, eye);
    for (int k = 0; k < 3; k++)
        ray[k] = c->rot[k] * a + c->rot[3 + k] * b + c->rot[6 + k];
    const double to[3] = {-eye[2] / ray[2], (6.0 - eye[2]) / ray[2], (-4.0 - eye[1]) / ray[1]};
    for (int what = 2; what >= 0; what--) {
        for (int k = 0; k < 3; k++)
            at[k] = eye[k] + to[what] * ray[k];
        bool wall = fabs(at[0]) < 5 && at[2] >= 0.0 && at[2] <= 6.0 && eye[1] < -4;
        if (!what || (what == 1 && height_of(at[0], at[1]) > 3) || (what == 2 && wall)) {
            *painted = paint(at[0], what == 2 ? at[2] : at[1], 8 - (uint64_t)what);
            return what;
        }
    }
    return 0;
}

static void pictures_draw(struct sweep_input *in, uint8_t (*out)[VIEW_H * VIEW_W],
                          const double (*eyes)[3])
{
    for (int v = 0; v < VIEWS; v++) {
        const double target[3] = {0.2 * v, 1, 0};
        struct camera cam = camera_look_at(eyes[v], target, 0.55, VIEW_W, VIEW_H);
        for (int i = 0; i < VIEW_W * VIEW_H; i++) {
            double at[3], painted;
            (void)pixel_of(&cam, i % VIEW_W + 0.5, i / VIEW_W + 0.5, at, &painted);
            /* another exposure in every picture */
            out[v][i] = (uint8_t)(40 + 15 * v + (150 - 20 * v) * painted + 0.5);
        }
        struct sweep_view view = {cam, out[v]};
        if (v)
            in->near[v - 1] = view;
        else
            in->ref = view;
    }
    in->n_near = VIEWS - 1;
    in->low_m = -3;
    in->step_m = 0.3;
    in->planes = PLANES;
}

static int pictures_make(void **state)
{
    static const double eyes[VIEWS][3] = {
        {0, -8, EYE_M}, {9, -7, EYE_M + 1}, {-9, -8, EYE_M}, {1, 2, EYE_M - 2}};
    static const double eyes_aslant[VIEWS][3] = {
        {0, -32, 26}, {6, -31, 27}, {-7, -32, 26}, {1, -27, 30}};
    struct err e = {0};
    if (kit_tmp_make(state))
        return 1;
    kit_ok(dev_open(NULL, &dev, &e), e);
    pictures_draw(&input, grey[0], eyes);
    pictures_draw(&aslant, grey[1], eyes_aslant);
    aslant.walls = true;
    return 0;
}

static int pictures_remove(void **state)
{
    dev_close(&dev);
    arena_free(&texts);
    return kit_tmp_remove(state);
}

/* A place in the plane falls on the same pixels by the map as by the cameras. */
static void a_plane_maps_pixels_as_the_cameras_do(void **state)
{
    for (size_t k = 0; k < input.n_near; k++)
        for (uint64_t i = 0; i < 50; i++) {
            double at[3] = {8 * rng_unit(1, k, i) - 4, 8 * rng_unit(2, k, i) - 4,
                            6 * rng_unit(3, k, i) - 2};
            double a[2], b[2], h[9];
            assert_true(camera_project(&input.ref.cam, at, 0.1, a, NULL));
            assert_true(camera_project(&input.near[k].cam, at, 0.1, b, NULL));
            struct sweep_plane level = sweep_level(at[2]);
            sweep_homography(&input, k, &level, h);
            double q = h[6] * a[0] + h[7] * a[1] + h[8];
            assert_true(q > 0);
            assert_true(fabs((h[0] * a[0] + h[1] * a[1] + h[2]) / q - b[0]) < 1e-8);
            assert_true(fabs((h[3] * a[0] + h[4] * a[1] + h[5]) / q - b[1]) < 1e-8);
        }
}

/* A place in an upright plane too, and each pixel's heights lie in the planes of its tile. */
static void an_upright_plane_maps_pixels_as_the_cameras_do(void **state)
{
    for (size_t k = 0; k < aslant.n_near; k++)
        for (uint32_t tile = 0; tile < 2; tile++)
            for (uint64_t i = 0; i < 30; i++) {
                struct sweep_wall w;
                double x = 40 * rng_unit(1, k, i) + 4, y = 20 * rng_unit(2, k, i) + 40, d[3], at[3],
                       c[3], h[9], px[2];
                assert_true(sweep_wall(&aslant, 0, tile * SWEEP_TILE_H, &w));
                struct sweep_plane up = sweep_upright(&aslant, &w, (int)(20 * rng_unit(3, k, i)));
                camera_center(&aslant.ref.cam, c);
                sweep_ray(&aslant, x, y, d);
                double way = up.at_m, along = 0;
                for (int j = 0; j < 3; j++) {
                    way -= up.normal[j] * c[j];
                    along += up.normal[j] * d[j];
                }
                for (int j = 0; j < 3; j++)
                    at[j] = c[j] + way / along * d[j];
                assert_true(camera_project(&aslant.near[k].cam, at, 0.1, px, NULL));
                sweep_homography(&aslant, k, &up, h);
                double q = h[6] * x + h[7] * y + h[8];
                assert_true(q > 0);
                assert_true(fabs((h[0] * x + h[1] * y + h[2]) / q - px[0]) < 1e-8);
                assert_true(fabs((h[3] * x + h[4] * y + h[5]) / q - px[1]) < 1e-8);
            }
    struct sweep_input down = input;
    struct sweep_wall w;
    assert_false(sweep_wall(&input, 0, 0, &w)); /* none are asked for */
    down.walls = true;
    assert_false(sweep_wall(&down, 13, 47, &w)); /* it looks straight down there */
}

/* Share of the wall's pixels within 0.1 m of its height, a third of a plane. */
static double walls_right(const struct sweep_input *in, const float *plane)
{
    double at[3], painted;
    size_t n = 0, right = 0;
    for (int i = 0; i < VIEW_W * VIEW_H; i++) {
        if (pixel_of(&in->ref.cam, i % VIEW_W + 0.5, i / VIEW_W + 0.5, at, &painted) != 2)
            continue;
        n++;
        right += fabs(in->low_m + in->step_m * (double)plane[i] - at[2]) < 0.1;
    }
    assert_true(n > 500);
    return (double)right / (double)n;
}

static void walls_are_found_by_upright_planes(void **state)
{
    enum { N = VIEW_W * VIEW_H };
    static float plane[N], score[N], level[N];
    static double want[N], want_score[N];
    struct sweep_input without = aslant;
    uint32_t own = dev.vector_width;
    kit_ok(sweep_ref_run(&aslant, want, want_score, &(struct err){0}), (struct err){0});
    for (int shape = 0; shape < 2; shape++) {
        struct err e = {0};
        struct sweep *s;
        size_t other = 0;
        dev.vector_width = shape ? 1 : own;
        kit_ok(sweep_open(&dev, PLANES, &s, &e), e);
        kit_ok(sweep_run(s, &aslant, plane, score, &e), e);
        without.walls = false;
        kit_ok(sweep_run(s, &without, level, score, &e), e);
        sweep_close(&s);
        dev.vector_width = own;
        for (int i = 0; i < N; i++)
            other += fabs((double)plane[i] - want[i]) > 0.25;
        if (other > N / 50)
            fail_msg("%zu of %d pixels differ from the reference", other, N);
        double with = walls_right(&aslant, plane), none = walls_right(&aslant, level);
        if (with < 0.5 || with < 1.5 * none)
            fail_msg("%.2f of the wall are right, %.2f without upright planes", with, none);
    }
}

static void check_kernels(uint32_t width)
{
    enum { N = VIEW_W * VIEW_H };
    static float plane[N], score[N];
    static double want[N], want_score[N];
    struct err e = {0};
    struct sweep *s;
    uint32_t own = dev.vector_width;
    size_t other = 0, ground = 0, roof = 0, wrong = 0;
    dev.vector_width = width ? width : own;
    kit_ok(sweep_open(&dev, PLANES, &s, &e), e);
    kit_ok(sweep_run(s, &input, plane, score, &e), e);
    dev.vector_width = own;
    kit_ok(sweep_ref_run(&input, want, want_score, &e), e);
    for (int i = 0; i < N; i++) {
        double x = i % VIEW_W + 0.5, y = i / VIEW_W + 0.5, at[3], painted;
        /* Costs are whole numbers on the device: close rivals may change places. */
        other += fabs((double)plane[i] - want[i]) > 0.25 ||
                 fabs((double)score[i] - want_score[i]) > 0.02;
        if (x < 8 || y < 8 || x > VIEW_W - 8 || y > VIEW_H - 8)
            continue;
        (void)pixel_of(&input.ref.cam, x, y, at, &painted);
        double z = at[2], far = 2.0;
        bool inside =
            fabs(at[0]) < 5 - far && fabs(at[1])<4 - far, outside = fabs(at[0])> 5 + far ||
            fabs(at[1]) > 4 + far;
        if (!inside && !outside)
            continue;
        ground += z < 3;
        roof += z > 3;
        wrong += fabs(input.low_m + input.step_m * (double)plane[i] - z) > 0.3;
    }
    if (other > N / 50)
        fail_msg("%zu of %d pixels differ from the reference", other, N);
    assert_true(ground > 500 && roof > 80);
    /* 2.0 % when this was written: behind the roof, where one neighbour sees the ground */
    if (wrong > (ground + roof) / 33)
        fail_msg("%zu of %zu pixels are off by more than a plane", wrong, ground + roof);
    sweep_close(&s);
}

static void kernels_equal_the_reference(void **state)
{
    check_kernels(0);
    check_kernels(1);
}

static void senseless_sweeps_are_refused(void **state)
{
    static float out[VIEW_W * VIEW_H];
    struct sweep_input none = input, many = input;
    struct err e = {0};
    struct sweep *s;
    kit_fails(sweep_open(&dev, 1, &s, &e), ERR_ARG, e, "planes");
    kit_ok(sweep_open(&dev, 32, &s, &e), e);
    none.n_near = 0;
    kit_fails(sweep_run(s, &none, out, out, &e), ERR_ARG, e, "neighbours");
    many.planes = 33;
    kit_fails(sweep_run(s, &many, out, out, &e), ERR_ARG, e, "planes");
    sweep_close(&s);
}

static void cubes_hold_the_mean_of_their_samples(void **state)
{
    static const struct fuse_sample samples[] = {{{0.1f, 0.1f, 0}, {10, 20, 30}},
                                                 {{5.2f, 0, 1}, {1, 1, 1}},
                                                 {{0.3f, 0.5f, 0}, {30, 40, 50}},
                                                 {{1.2f, 0.1f, 0}, {9, 9, 9}}};
    float *points;
    size_t n;
    struct err e = {0};
    kit_ok(fuse_samples(samples, 4, 1.0, &points, &n, &e), e);
    assert_int_equal(n, 3);
    double sum[6] = {0};
    for (size_t i = 0; i < n * 6; i++)
        sum[i % 6] += (double)points[i];
    static const double want[6] = {0.2 + 5.2 + 1.2, 0.3 + 0 + 0.1, 1, 30, 40, 50};
    for (int k = 0; k < 6; k++)
        assert_true(fabs(sum[k] - want[k]) < 1e-5);
    mem_free(points);
    kit_ok(fuse_samples(samples, 0, 1.0, &points, &n, &e), e);
    assert_int_equal(n, 0);
    mem_free(points);
}

/* ---- a city ---- */

struct city_score {
    size_t truth, known, far, close; /* pixels; of the known: off by more than 2 %, within 0.5 % */
};

static struct city_score city_score(const char *dir)
{
    struct err e = {0};
    struct buf names = {0};
    struct city_score s = {0};
    char map_dir[FILE_PATH_MAX], truth_dir[FILE_PATH_MAX];
    kit_ok(file_join(map_dir, kit_tmp, dir, &e), e);
    kit_ok(file_join(truth_dir, kit_tmp, "city/truth/depth", &e), e);
    assert_int_equal(kit_run(&names, "cd '%s/city/truth/depth' && ls", kit_tmp), 0);
    buf_u8(&names, 0);
    char *rest = (char *)names.data;
    for (char *name; (name = strtok_r(rest, "\n", &rest));) {
        char path[FILE_PATH_MAX], map[32];
        size_t shape[2], same[2];
        float *truth, *got;
        kit_ok(file_join(path, truth_dir, name, &e), e);
        kit_ok(npy_read(path, 2, shape, &truth, &e), e);
        snprintf(map, sizeof map, "%.8s.jpg.npy", name);
        kit_ok(file_join(path, map_dir, map, &e), e);
        kit_ok(npy_read(path, 2, same, &got, &e), e);
        assert_memory_equal(shape, same, sizeof shape);
        for (size_t i = 0; i < shape[0] * shape[1]; i++) {
            double off = fabs(1 / (double)got[i] - (double)truth[i]) / (double)truth[i];
            bool known = truth[i] > 0.0f && isfinite(got[i]);
            s.truth += truth[i] > 0.0f;
            s.known += known;
            s.far += known && off > 0.02;
            s.close += known && off < 0.005;
        }
        mem_free(truth);
        mem_free(got);
    }
    buf_free(&names);
    assert_true(s.truth > 10000);
    return s;
}

/* The maps of the city's scene by other rules than those of `citysplat stereo`. */
static struct city_score city_score_by(const char *name, double sure, double edge)
{
    const struct depths_config cfg = {.max_edge_px = 800, .sure = sure, .edge = edge};
    struct err e = {0};
    struct scene scene;
    struct depths_result r;
    char dir[FILE_PATH_MAX];
    kit_ok(file_join(dir, kit_tmp, "scene", &e), e);
    kit_ok(scene_read(dir, &scene, &e), e);
    kit_ok(file_join(dir, kit_tmp, name, &e), e);
    kit_ok(depths_make(&dev, &scene, &cfg, dir, &r, &e), e);
    scene_free(&scene);
    return city_score(name);
}

static void a_city_from_its_photographs(void **state)
{
    struct buf out = {0};
    const char *bin = kit_program();
    assert_int_equal(
        kit_run(&out,
                "cd '%s' && '%s' synth -o city --photos 30 --extent-m 60 --width-px 240 "
                "--height-px 180 --seed 5 -q && '%s' ingest city/images city/sparse -o scene -q && "
                "'%s' stereo scene --no-test-split -q",
                kit_tmp, bin, bin, bin),
        0);
    struct city_score s = city_score("scene/depth"),
                      edges = city_score_by("edges", DEPTHS_SURE, 1e6),
                      two = city_score_by("two", 2.0, DEPTHS_EDGE);
    /* 59 % known, 3.5 % of these off by more than 2 %, when this was written; photographs of 480 px
     * have 1.1 % (docs/decisions/007-stereo.md) */
    if (s.known < s.truth / 3 || s.far > s.known / 20 || s.close < s.known * 3 / 4)
        fail_msg("of %zu pixels %zu are known, %zu off by more than 2 %%, %zu within 0.5 %%",
                 s.truth, s.known, s.far, s.close);
    /* what windows make wider is known to all views alike, and wrong */
    assert_true(edges.known > s.known);
    assert_true(edges.far - s.far > (edges.known - s.known) / 10);
    /* One neighbour is enough for 2 % more of the pixels. 4 % of these were off by more than 2 %
     * when this was written, and 2 % of those that two agree on. */
    assert_true(s.known > two.known + s.truth / 100);
    assert_true(s.far - two.far < (s.known - two.known) / 8);
    /* the same bytes with one thread */
    assert_int_equal(kit_run(&out,
                             "cd '%s' && '%s' stereo scene -o again --no-test-split --threads 1 -q "
                             "&& diff -r scene/depth again",
                             kit_tmp, bin),
                     0);
    /* the maps are there: nothing is replaced unasked */
    assert_int_equal(kit_run(&out, "cd '%s' && '%s' stereo scene -q", kit_tmp, bin), 2);
    assert_non_null(strstr((char *)out.data, "--overwrite"));
    buf_free(&out);
}

static double angle_deg(const double x[3], const double a[3], const double b[3])
{
    double dot = 0, na = 0, nb = 0;
    for (int k = 0; k < 3; k++) {
        dot += (a[k] - x[k]) * (b[k] - x[k]);
        na += (a[k] - x[k]) * (a[k] - x[k]);
        nb += (b[k] - x[k]) * (b[k] - x[k]);
    }
    return acos(dot / sqrt(na * nb)) * 57.29577951308232;
}

/* Ground that other photographs show at 5 to 30 degrees is shown by chosen neighbours too, and that
 * which few show no less. */
static void neighbours_cover_the_picture(void **state)
{
    struct err e = {0};
    struct scene scene;
    struct pairs pairs;
    char dir[FILE_PATH_MAX];
    size_t places[2] = {0}, covered[2] = {0}; /* shown by 2 to 4 others; by more */
    (void)kit_program();                      /* the scene of the test above */
    kit_ok(file_join(dir, kit_tmp, "scene", &e), e);
    kit_ok(scene_read(dir, &scene, &e), e);
    uint8_t *use = mem_array(scene.n_images, 1);
    assert_non_null(use);
    memset(use, 1, scene.n_images);
    kit_ok(pairs_find(&scene, use, 6, &pairs, &e), e);
    for (size_t i = 0; i < scene.n_images; i++)
        for (int part = 0; part < 81; part++) {
            const struct camera *c = &scene.images[i].cam;
            double eye[3], x[3], other[3], depth;
            double a = ((part % 9 + 0.5) / 9 * c->width_px - c->cx_px) / c->fx_px,
                   b = ((part / 9 + 0.5) / 9 * c->height_px - c->cy_px) / c->fy_px;
            size_t all = 0, chosen = 0;
            camera_center(c, eye);
            for (int k = 2; k >= 0; k--) {
                double down = c->rot[2] * a + c->rot[5] * b + c->rot[8];
                x[k] = eye[k] - eye[2] / down * (c->rot[k] * a + c->rot[3 + k] * b + c->rot[6 + k]);
            }
            for (size_t j = 0; j < scene.n_images; j++) {
                camera_center(&scene.images[j].cam, other);
                double angle = angle_deg(x, eye, other);
                if (j == i || !camera_frames(&scene.images[j].cam, x, 0.0, &depth) || angle < 5 ||
                    angle > 30)
                    continue;
                all++;
                for (size_t k = 0; k < pairs.n_swept[i]; k++)
                    chosen += pairs.near[i][k] == j;
            }
            places[all > 4] += all >= 2;
            covered[all > 4] += all >= 2 && chosen;
        }
    /* All, when this was written. The neighbours that show the most left 14 of 559 out. */
    assert_true(places[0] > 300 && places[1] > 300);
    if (covered[0] * 100 < places[0] * 99 || covered[1] * 100 < places[1] * 99)
        fail_msg(
            "of places that 2 to 4 others show %zu of %zu are covered, of those that more show "
            "%zu of %zu",
            covered[0], places[0], covered[1], places[1]);
    pairs_free(&pairs);
    scene_free(&scene);
    mem_free(use);
}

/* `train` with these options on the city's scene fails and says this. */
static void refused(const char *options, const char *says)
{
    struct buf out = {0};
    assert_int_equal(kit_run(&out, "cd '%s' && '%s' train scene -q --output trained %s 2>&1",
                             kit_tmp, kit_program(), options),
                     1);
    buf_u8(&out, 0);
    if (!strstr((char *)out.data, says))
        fail_msg("%s: %s", options, (char *)out.data);
    buf_free(&out);
}

static void training_refuses_other_folders(void **state)
{
    static const float five[5] = {1, 2, 3, 4, 5}, bad[6] = {0, 0, NAN, 1, 2, 3};
    const size_t shape_five[2] = {1, 5}, shape_bad[2] = {1, 6};
    struct err e = {0};
    char path[FILE_PATH_MAX];
    kit_ok(file_join(path, kit_tmp, "again/points.npy", &e), e);
    refused("--depth-prior elsewhere", "citysplat stereo");
    kit_ok(npy_write(path, five, 2, shape_five, &e), e);
    refused("--depth-prior again", "6 are expected");
    kit_ok(npy_write(path, bad, 2, shape_bad, &e), e);
    refused("--depth-prior again", "not finite");
    assert_int_equal(kit_run(NULL, "rm '%s' '%s'/again/IMG*", path, kit_tmp), 0);
    refused("--depth-prior again", "no depth map can be used");
    assert_int_equal(kit_run(NULL, "mv '%s/scene/depth' '%s/gone'", kit_tmp, kit_tmp), 0);
    refused("--depth-prior stereo", "citysplat stereo");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_plane_maps_pixels_as_the_cameras_do),
        cmocka_unit_test(an_upright_plane_maps_pixels_as_the_cameras_do),
        cmocka_unit_test(kernels_equal_the_reference),
        cmocka_unit_test(walls_are_found_by_upright_planes),
        cmocka_unit_test(senseless_sweeps_are_refused),
        cmocka_unit_test(cubes_hold_the_mean_of_their_samples),
        cmocka_unit_test(a_city_from_its_photographs),
        cmocka_unit_test(neighbours_cover_the_picture),
        cmocka_unit_test(training_refuses_other_folders),
    };
    return cmocka_run_group_tests(tests, pictures_make, pictures_remove);
}
