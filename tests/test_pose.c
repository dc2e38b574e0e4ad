/* Poses that are refined: what moves a camera, the gauge, a step, the file.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/scene.h"
#include "core/camera.h"
#include "kit.h"
#include "train/pose.h"

enum { PHOTOS = 12 };
#define HEIGHT 80.0

/* Photographs that look down at different angles from about HEIGHT. */
static void flight(struct scene *s)
{
    memset(s, 0, sizeof *s);
    s->n_images = PHOTOS;
    s->images = arena_get(&s->arena, PHOTOS, sizeof *s->images);
    for (size_t i = 0; i < PHOTOS; i++) {
        double eye[3] = {30.0 * (double)(i % 4), 25.0 * (double)(i / 4),
                         HEIGHT + 5.0 * rng_normal(1, 0, i)};
        char *name = arena_get(&s->arena, 16, 1);
        snprintf(name, 16, "p%02zu.jpg", i);
        s->images[i].name = name;
        s->images[i].cam =
            camera_heading(eye, 37.0 * (double)i, -60.0 - 2.0 * (double)i, 0.9, 400, 300);
    }
}

static void all_of(uint32_t images[PHOTOS])
{
    for (uint32_t i = 0; i < PHOTOS; i++)
        images[i] = i;
}

static void project(const struct camera *c, const double x[3], double px[2])
{
    double t[3];
    for (int a = 0; a < 3; a++)
        t[a] = c->rot[3 * a] * x[0] + c->rot[3 * a + 1] * x[1] + c->rot[3 * a + 2] * x[2] +
               c->trans[a];
    px[0] = c->fx_px * t[0] / t[2] + c->cx_px;
    px[1] = c->fy_px * t[1] / t[2] + c->cy_px;
}

static const double nothing[POSE_NUMBERS];

/* Everything moved, turned by b and scaled by s about a middle: what a camera sees of it stays. */
static void common(const struct pose_set *p, const double a[3], const double b[3], double s,
                   double middle[3])
{
    for (size_t k = 0; k < 3; k++) {
        middle[k] = 0.0;
        for (size_t i = 0; i < PHOTOS; i++)
            middle[k] += p->center_m[3 * i + k] / PHOTOS;
    }
    for (size_t i = 0; i < PHOTOS; i++) {
        double *d = p->block + POSE_STATE * i;
        const double *c = p->center_m + 3 * i;
        for (size_t k = 0; k < 3; k++) {
            size_t u = (k + 1) % 3, v = (k + 2) % 3;
            d[k] += a[k] + b[u] * (c[v] - middle[v]) - b[v] * (c[u] - middle[u]) +
                    s * (c[k] - middle[k]);
            d[3 + k] -= b[k];
        }
    }
}

static void test_gauge(void **state)
{
    (void)state;
    struct scene scene;
    struct pose_set p, own;
    struct err e = {0};
    uint32_t images[PHOTOS];
    double middle[3];
    const double a[3] = {0.02, -0.03, 0.01}, b[3] = {2e-5, -3e-5, 4e-5};
    flight(&scene);
    all_of(images);
    kit_ok(pose_open(&p, &scene, images, PHOTOS, HEIGHT, &e), e);
    kit_ok(pose_open(&own, &scene, images, PHOTOS, HEIGHT, &e), e);
    /* It is invisible: a point that moves along is where it was in the picture. */
    common(&p, a, b, 1e-5, middle);
    for (size_t i = 0; i < PHOTOS; i++) {
        struct camera c = scene.images[i].cam;
        const double x[3] = {40, 20, 3};
        double y[3], before[2], after[2];
        for (size_t k = 0; k < 3; k++) {
            size_t u = (k + 1) % 3, v = (k + 2) % 3;
            y[k] = x[k] + a[k] + b[u] * (x[v] - middle[v]) - b[v] * (x[u] - middle[u]) +
                   1e-5 * (x[k] - middle[k]);
        }
        project(&c, x, before);
        pose_apply(&p, i, &c);
        project(&c, y, after);
        assert_true(hypot(after[0] - before[0], after[1] - before[1]) < 1e-5);
    }
    /* And it is taken out, all of it. */
    pose_update(&p, 0, nothing, 0.0);
    struct pose_report r = pose_describe(&p);
    assert_true(r.largest_m < 1e-9 && r.largest_deg < 1e-9);
    /* Each photograph's own part stays, whatever is added to it in common. */
    for (size_t i = 0; i < PHOTOS; i++)
        for (size_t k = 0; k < POSE_NUMBERS; k++)
            p.block[POSE_STATE * i + k] = own.block[POSE_STATE * i + k] =
                rng_normal(2, i, k) * (k < 3 ? 0.1 : 1e-3);
    common(&p, a, b, -2e-5, middle);
    pose_update(&p, 0, nothing, 0.0);
    pose_update(&own, 3, nothing, 0.0);
    double sum[3] = {0}, along = 0.0;
    for (size_t i = 0; i < PHOTOS; i++)
        for (size_t k = 0; k < POSE_NUMBERS; k++) {
            double d = p.block[POSE_STATE * i + k];
            assert_true(fabs(d - own.block[POSE_STATE * i + k]) < 1e-9);
            if (k < 3) {
                sum[k] += d;
                along += d * (p.center_m[3 * i + k] - middle[k]);
            }
        }
    for (size_t k = 0; k < 3; k++)
        assert_true(fabs(sum[k]) < 1e-9);
    assert_true(fabs(along) < 1e-6);
    r = pose_describe(&p);
    assert_true(r.rms_m > 0.1 && r.rms_m < 0.2 && r.rms_deg > 0.05 && r.rms_deg < 0.15);
    pose_free(&p);
    pose_free(&own);
    arena_free(&scene.arena);
}

/* Steps go down: one photograph off by 20 px is pulled back by the gradient of its squared distance
 * in pixels, and the others stay. */
static void test_steps(void **state)
{
    (void)state;
    struct scene scene;
    struct pose_set p;
    struct err e = {0};
    uint32_t images[PHOTOS];
    enum { POINTS = 20, STEPS = 300 };
    double first = 0.0, last = 0.0;
    flight(&scene);
    all_of(images);
    kit_ok(pose_open(&p, &scene, images, PHOTOS, HEIGHT, &e), e);
    struct camera truth = scene.images[5].cam;
    const double off[POSE_NUMBERS] = {2.0, -1.0, 0.5, 0.02, -0.01, 0.015};
    memcpy(p.block + POSE_STATE * 5, off, sizeof off);
    pose_apply(&p, 5, &scene.images[5].cam); /* what the scene says is wrong */
    memset(p.block + POSE_STATE * 5, 0, sizeof off);
    camera_center(&scene.images[5].cam, p.center_m + 15);
    for (int t = 0; t < STEPS; t++) {
        double g[POSE_NUMBERS] = {0};
        last = 0.0;
        for (int k = -1; k < POSE_NUMBERS; k++) { /* by differences */
            double *d = p.block + POSE_STATE * 5, keep = k < 0 ? 0.0 : d[k], sum = 0.0;
            struct camera c = scene.images[5].cam;
            if (k >= 0)
                d[k] += 1e-6;
            pose_apply(&p, 5, &c);
            for (uint64_t i = 0; i < POINTS; i++) {
                double x[3] = {30 + 20 * rng_normal(3, 0, i), 25 + 20 * rng_normal(3, 1, i),
                               5 * rng_unit(3, 2, i)},
                       want[2], got[2];
                project(&truth, x, want);
                project(&c, x, got);
                sum += (pow(got[0] - want[0], 2) + pow(got[1] - want[1], 2)) / POINTS;
            }
            if (k < 0)
                last = sum;
            else {
                d[k] = keep;
                g[k] = (sum - last) / 1e-6;
            }
        }
        first = t ? first : last;
        pose_update(&p, 5, g, 2e-3 * pow(0.01, (double)t / STEPS));
    }
    print_message("%.2f px at first, %.3f px at last\n", sqrt(first), sqrt(last));
    assert_true(sqrt(first) > 5.0 && sqrt(last) < 0.1 * sqrt(first));
    const double bad[POSE_NUMBERS] = {0, 0, (double)NAN, 0, 0, 0};
    double before[POSE_STATE];
    memcpy(before, p.block + POSE_STATE * 5, sizeof before);
    pose_update(&p, 5, bad, 1.0);
    assert_memory_equal(before, p.block + POSE_STATE * 5, sizeof before);
    pose_free(&p);
    arena_free(&scene.arena);
}

static void test_unmoved(void **state)
{
    (void)state;
    struct scene scene;
    struct pose_set p, none = {0};
    struct err e = {0};
    uint32_t images[PHOTOS];
    flight(&scene);
    all_of(images);
    kit_ok(pose_open(&p, &scene, images, PHOTOS, HEIGHT, &e), e);
    struct camera c = scene.images[3].cam;
    pose_apply(&p, 3, &c);
    pose_apply(&none, 3, &c);
    assert_memory_equal(&c, &scene.images[3].cam, sizeof c);
    pose_free(&p);
    arena_free(&scene.arena);
}

static void expect_bad(struct pose_set *p, const struct scene *s, const char *text,
                       const char *part)
{
    char path[FILE_PATH_MAX];
    struct err e = {0};
    kit_ok(file_join(path, kit_tmp, "bad.json", &e), e);
    kit_ok(file_write(path, text, strlen(text), &e), e);
    kit_fails(pose_read(p, s, path, &e), ERR_FORMAT, e, part);
}

static void test_file(void **state)
{
    (void)state;
    struct scene scene;
    struct pose_set p, back;
    struct err e = {0};
    char path[FILE_PATH_MAX];
    uint32_t images[PHOTOS];
    flight(&scene);
    all_of(images);
    kit_ok(pose_open(&p, &scene, images, PHOTOS - 1, HEIGHT, &e), e);
    kit_ok(pose_open(&back, &scene, images, PHOTOS - 1, HEIGHT, &e), e);
    for (size_t i = 0; i < PHOTOS; i++)
        for (size_t k = 0; k < POSE_NUMBERS; k++)
            p.block[POSE_STATE * i + k] = rng_normal(4, i, k) * 0.01;
    kit_ok(file_join(path, kit_tmp, "poses.json", &e), e);
    kit_ok(pose_write(&p, &scene, path, &e), e);
    kit_ok(pose_read(&back, &scene, path, &e), e);
    for (size_t i = 0; i < PHOTOS; i++) /* the last one does not train and is not in the file */
        for (size_t k = 0; k < POSE_NUMBERS; k++)
            assert_true(back.block[POSE_STATE * i + k] ==
                        (i + 1 < PHOTOS ? p.block[POSE_STATE * i + k] : 0.0));
    expect_bad(&back, &scene, "{\"format\": \"other\", \"photographs\": []}", "no file of poses");
    expect_bad(&back, &scene, "{\"format\": \"citysplat-poses\"}", "no file of poses");
    expect_bad(&back, &scene,
               "{\"format\": \"citysplat-poses\", \"photographs\": [{\"name\": \"x.jpg\", "
               "\"move_m\": [0, 0, 0], \"turn_rad\": [0, 0, 0]}]}",
               "x.jpg: the scene has no such photograph");
    expect_bad(&back, &scene,
               "{\"format\": \"citysplat-poses\", \"photographs\": [{\"name\": \"p01.jpg\", "
               "\"move_m\": [0, 0, 0], \"turn_rad\": [0, 4, 0]}]}",
               "p01.jpg: a correction of 4");
    expect_bad(&back, &scene,
               "{\"format\": \"citysplat-poses\", \"photographs\": [{\"name\": \"p01.jpg\", "
               "\"move_m\": [0, 0], \"turn_rad\": [0, 0, 0]}]}",
               "move_m");
    pose_free(&back);
    mem_fail_at(1);
    assert_int_equal(pose_open(&back, &scene, images, PHOTOS, HEIGHT, &e), ERR_MEM);
    mem_fail_at(0);
    pose_free(&p);
    arena_free(&scene.arena);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_gauge),
        cmocka_unit_test(test_steps),
        cmocka_unit_test(test_unmoved),
        cmocka_unit_test(test_file),
    };
    return cmocka_run_group_tests(tests, kit_tmp_make, kit_tmp_remove);
}
