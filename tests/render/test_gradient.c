/* citysplat gradient, through the program: files in the order of the .ply against the double
 * reference, and its error messages.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/npy.h"
#include "codec/splat/ply.h"
#include "core/splat/camera.h"
#include "render/render.h"
#include "tests/kit.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

/* float kernels against double, see test_backward.c; pixels near a threshold may decide otherwise
 * here, each worth 1/255 of one splat in one pixel of 768. */
#define GRADIENT_REL 5e-3

enum { W = 32, H = 24, N = 21, DEGREE = 2, K = 9 };

static const double quat[4] = {0.9, 0.2, -0.3, 0.1};

static void files_make(const char *dir, struct gauss *g, struct camera *cam, float *grad)
{
    char path[FILE_PATH_MAX];
    struct err e = {0};
    struct buf ply = {0}, json = {0};
    const struct ply_info info = {0};
    const size_t shape[3] = {H, W, 3};
    kit_gauss(5, N, 0.8, DEGREE, 0, g);
    *cam = (struct camera){.width_px = W,
                           .height_px = H,
                           .fx_px = 35,
                           .fy_px = 33,
                           .cx_px = 15,
                           .cy_px = 12.5,
                           .trans = {0.1, 0, 3}};
    camera_quat_to_rot(quat, cam->rot);
    const double *r = cam->rot, *t = cam->trans;
    buf_printf(&json,
               "{\"width\": %d, \"height\": %d, \"fx\": 35, \"fy\": 33, \"cx\": 15, \"cy\": 12.5, "
               "\"world_to_camera\": [%.17g,%.17g,%.17g,%g, %.17g,%.17g,%.17g,%g, "
               "%.17g,%.17g,%.17g,%g, 0,0,0,1]}\n",
               W, H, r[0], r[1], r[2], t[0], r[3], r[4], r[5], t[1], r[6], r[7], r[8], t[2]);
    kit_ok(ply_encode(g, &info, &ply, &e), e);
    kit_ok(file_join(path, dir, "scene.ply", &e), e);
    kit_ok(file_write(path, ply.data, ply.size, &e), e);
    kit_ok(file_join(path, dir, "cam.json", &e), e);
    kit_ok(file_write(path, json.data, json.size, &e), e);
    for (size_t i = 0; i < (size_t)W * H * 3; i++)
        grad[i] = (float)rng_normal(9, 0, i);
    kit_ok(file_join(path, dir, "dl.npy", &e), e);
    kit_ok(npy_write(path, grad, 3, shape, &e), e);
    buf_free(&ply);
    buf_free(&json);
}

static void compare(const char *dir, const char *name, size_t ndim, const size_t *shape,
                    const double *want)
{
    char path[FILE_PATH_MAX];
    struct err e = {0};
    size_t got_shape[3] = {0}, n = 1;
    float *got;
    double err2 = 0, ref2 = 0;
    kit_ok(file_join(path, dir, name, &e), e);
    kit_ok(npy_read(path, ndim, got_shape, &got, &e), e);
    for (size_t i = 0; i < ndim; i++) {
        assert_int_equal(got_shape[i], shape[i]);
        n *= shape[i];
    }
    for (size_t i = 0; i < n; i++) {
        err2 += ((double)got[i] - want[i]) * ((double)got[i] - want[i]);
        ref2 += want[i] * want[i];
    }
    assert_true(ref2 > 0);
    if (!(sqrt(err2) <= GRADIENT_REL * sqrt(ref2)))
        fail_msg("%s: relative L2 error %g", name, sqrt(err2 / ref2));
    mem_free(got);
}

static void test_against_reference(void **state)
{
    static const char *const modes[] = {"none", "2d", "mip"};
    const char *program = kit_program();
    char dir[FILE_PATH_MAX], out[FILE_PATH_MAX];
    struct gauss g;
    struct camera cam;
    struct err e = {0};
    float grad[W * H * 3];
    double rgb_grad[W * H * 3], mean[3 * N], scale[3 * N], rot[4 * N], opacity[N], sh[3 * K * N];
    kit_tmpdir(dir);
    files_make(dir, &g, &cam, grad);
    for (size_t i = 0; i < (size_t)W * H * 3; i++)
        rgb_grad[i] = (double)grad[i];
    kit_ok(file_join(out, dir, "grads", &e), e);
    for (int k = 0; k < 3; k++) { /* the second and third time into the folder of the first */
        const struct render_options o = {
            .aa = (enum render_aa)k, .background = {0.25f, 0.5f, 1}, .sh_degree = k ? -1 : 1};
        const struct render_ref_grads ref = {
            .mean = mean, .scale_log = scale, .quat_wxyz = rot, .opacity_logit = opacity, .sh = sh};
        struct buf log = {0};
        if (kit_run(&log,
                    "%s gradient %s/scene.ply --camera %s/cam.json --grad %s/dl.npy -o %s --aa %s "
                    "--background 0.25,0.5,1 --sh-degree %d --overwrite",
                    program, dir, dir, dir, out, modes[k], k ? -1 : 1) != 0)
            fail_msg("%s", log.data ? (char *)log.data : "no output");
        kit_ok(render_ref_backward(&g, &cam, &o, rgb_grad, &ref, &e), e);
        const size_t n_3[2] = {N, 3}, n_4[2] = {N, 4}, n_1[1] = {N}, n_k[3] = {N, K, 3};
        compare(out, "mean.npy", 2, n_3, mean);
        compare(out, "log_scale.npy", 2, n_3, scale);
        compare(out, "quat_wxyz.npy", 2, n_4, rot);
        compare(out, "opacity_logit.npy", 1, n_1, opacity);
        compare(out, "sh.npy", 3, n_k, sh);
        buf_free(&log);
    }
    struct arena a = {0};
    char **names;
    size_t n;
    kit_ok(file_list(out, NULL, &a, &names, &n, &e), e);
    assert_int_equal(n, 5);
    arena_free(&a);
    gauss_free(&g);
    kit_rmdir(dir);
}

/* Run with `args`; expect exit code, text, and no output folder beside what was there. */
static void refuse(const char *dir, const char *args, int code, const char *text)
{
    struct buf log = {0};
    struct err e = {0};
    char out[FILE_PATH_MAX];
    int got = kit_run(&log, "cd %s && %s gradient %s", dir, kit_program(), args);
    if (got != code || !strstr((char *)log.data, text))
        fail_msg("gradient %s: exit %d (want %d), said: %s(want: %s)", args, got, code,
                 (char *)log.data, text);
    kit_ok(file_join(out, dir, "out", &e), e);
    assert_false(file_exists(out) || file_is_dir(out));
    buf_free(&log);
}

static void test_refusals(void **state)
{
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct gauss g;
    struct camera cam;
    struct err e = {0};
    float grad[W * H * 3] = {0};
    const size_t flat[3] = {W, H, 3};
    (void)kit_program();
    kit_tmpdir(dir);
    files_make(dir, &g, &cam, grad);
    refuse(dir, "scene.ply --camera cam.json --grad dl.npy", 2, "-o DIR is missing");
    refuse(dir, "scene.ply --grad dl.npy -o out", 2, "--camera FILE is missing");
    refuse(dir, "scene.ply --camera cam.json --grad dl.npy -o out --background 1,2", 2,
           "three numbers");
    refuse(dir, "scene.ply --camera cam.json --grad dl.npy -o out --aa fancy", 2, "aa");
    refuse(dir, "scene.ply --camera none.json --grad dl.npy -o out", 1, "none.json");
    refuse(dir, "none.ply --camera cam.json --grad dl.npy -o out", 1, "none.ply");
    refuse(dir, "scene.ply --camera scene.ply --grad dl.npy -o out", 1, "scene.ply");
    refuse(dir, "scene.ply --camera cam.json --grad cam.json -o out", 1, "cam.json");
    kit_ok(file_join(path, dir, "flat.npy", &e), e);
    kit_ok(npy_write(path, grad, 3, flat, &e), e);
    refuse(dir, "scene.ply --camera cam.json --grad flat.npy -o out", 1, "[24, 32, 3]");
    kit_ok(file_join(path, dir, "mine", &e), e);
    kit_ok(file_mkdir(path, &e), e);
    kit_ok(file_join(path, dir, "mine/notes.txt", &e), e);
    kit_ok(file_write(path, "x", 1, &e), e);
    refuse(dir, "scene.ply --camera cam.json --grad dl.npy -o mine", 2, "notes.txt");
    assert_true(file_exists(path));
    gauss_free(&g);
    kit_rmdir(dir);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_against_reference),
                                       cmocka_unit_test(test_refusals)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
