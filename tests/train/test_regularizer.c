/* Terms of the loss on Gaussians: each reference in double against finite differences, each kernel
 * against its reference, in both shapes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/render/backward_kit.h"
#include "train/loss/flat_loss.h"
#include "train/loss/scale_loss.h"

#include <math.h>
#include <string.h>

#define FD_STEP 1e-6
#define FD_REL 1e-6      /* central differences in double: truncation h^2, rounding 1e-16 / h */
#define KERNEL_REL 2e-6  /* float against double, a handful of operations */
#define KERNEL_TURN 1e-8 /* differences of products of a rotation, times a weight of 1 / 100 */

/* ---- scale ---- */

enum { SIZES = 203 }; /* not a multiple of 16 */
/* A board of fields with a smaller limit; Gaussians lie on and beyond it. */
enum { BOARD = 7 };
static const uint8_t board[BOARD * BOARD] = {1, 6, 7, 0, 1, 2, 3, 6, 5, 0, 3, 4, 1, 6, 3, 0, 5,
                                             2, 3, 6, 1, 4, 7, 0, 1, 2, 3, 4, 1, 6, 3, 0, 5, 2,
                                             7, 2, 1, 4, 3, 0, 1, 6, 3, 6, 1, 0, 7, 2, 5};
static const struct ground_parts ground = {
    .parts = board, .nx = BOARD, .ny = BOARD, .corner_m = {-7.3, -6.1}, .cell_m = 1.9};
enum { SCALE_INPUTS = 2, FLAT_INPUTS = 3 };
static const struct scale_loss_input scale_in[SCALE_INPUTS] = {
    {.s_max_m = 2.0, .r_max = 10.0, .weight = 0.05},
    {.s_max_m = 2.0, .r_max = 10.0, .weight = 0.05, .ground = &ground, .s_near_m = 0.6}};
static const struct flat_loss_input flat_in[FLAT_INPUTS] = {
    {.flat_weight = 3.0, .flat_m = 0.2},
    {.flat_weight = 3.0, .flat_m = 0.2, .ground = &ground},
    {.flat_weight = 3.0, .flat_m = 0.2, .level_weight = 2.0, .ground = &ground}};
enum { SHAPE = 7 }; /* three sizes, and a rotation */

/* Sizes on both sides of both limits, none near one; some axes equal. */
static void scale_sizes(double *scale_log)
{
    for (size_t i = 0; i < SIZES; i++)
        for (size_t k = 0; k < 3; k++) {
            double s = log(0.05) + 5.0 * rng_unit(5, 1, 3 * i + k);
            if (i % 7 == 0 && k == 2)
                s = scale_log[3 * i + 1];
            scale_log[3 * i + k] = (double)(float)s;
        }
}

/* Where kit_gauss puts them, and how it turns them. */
static void scale_places(double *mean, double *quat)
{
    struct gauss g = {0};
    kit_gauss(3, SIZES, 10.0, 1, 0, &g);
    for (size_t i = 0; i < 3 * SIZES; i++)
        mean[i] = g.origin_enu_m[i % 3] + (double)g.mean_m[i];
    for (size_t i = 0; i < 4 * SIZES; i++)
        quat[i] = (double)g.quat_wxyz[i];
    gauss_free(&g);
}

static void scale_reference_matches_differences(void **state)
{
    double sizes[3 * SIZES], mean[3 * SIZES], quat[4 * SIZES], g[3 * SIZES], fd[3 * SIZES];
    const struct scale_loss_gauss of = {.mean = mean, .scale_log = sizes, .n = SIZES};
    uint32_t n[SCALE_INPUTS];
    scale_sizes(sizes);
    scale_places(mean, quat);
    for (size_t t = 0; t < SCALE_INPUTS; t++) {
        struct scale_loss_value v = scale_loss_ref_run(&of, &scale_in[t], g);
        n[t] = v.n;
        assert_true(v.n > 20 && v.n < 400 && v.m > 20 && v.m < 190);
        for (size_t i = 0; i < 3 * SIZES; i++) {
            double keep = sizes[i], at[2];
            for (int k = 0; k < 2; k++) {
                sizes[i] = keep + (k ? FD_STEP : -FD_STEP);
                struct scale_loss_value w = scale_loss_ref_run(&of, &scale_in[t], NULL);
                /* the indicators have no derivative: leave out what changes one */
                at[k] = w.n == v.n && w.m == v.m ? w.total : (double)NAN;
            }
            sizes[i] = keep;
            fd[i] = (at[1] - at[0]) / (2.0 * FD_STEP);
            /* where two axes are equal the middle one changes its name: only half the way is right
             */
            if (!isfinite(fd[i]) || i / 3 % 7 == 0)
                fd[i] = g[i];
        }
        kit_near_d("dL/dsize", g, fd, 3 * SIZES, 1e-9, FD_REL);
    }
    assert_true(n[1] > n[0] + 20); /* the board has some of them */
}

static void flat_reference_matches_differences(void **state)
{
    double x[3 * SIZES], mean[3 * SIZES], quat[4 * SIZES], total[FLAT_INPUTS];
    double g[SHAPE * SIZES], fd[SHAPE * SIZES];
    const struct flat_loss_gauss of = {.mean = mean, .scale_log = x, .quat = quat, .n = SIZES};
    scale_sizes(x);
    scale_places(mean, quat);
    for (size_t t = 0; t < FLAT_INPUTS; t++) {
        total[t] = flat_loss_ref_run(&of, &flat_in[t], g);
        for (size_t i = 0; i < SHAPE * SIZES; i++) {
            size_t one = i / SHAPE, k = i % SHAPE;
            double *is = k < 3 ? x + 3 * one + k : quat + 4 * one + k - 3, keep = *is, at[2];
            for (int side = 0; side < 2; side++) {
                *is = keep + (side ? FD_STEP : -FD_STEP);
                at[side] = flat_loss_ref_run(&of, &flat_in[t], NULL);
            }
            *is = keep;
            /* where two axes are equal the least one changes its name */
            fd[i] = k < 3 && one % 7 == 0 ? g[i] : (at[1] - at[0]) / (2.0 * FD_STEP);
        }
        kit_near_d("dL/dshape", g, fd, SHAPE * SIZES, 1e-9, FD_REL);
    }
    assert_true(total[1] > 0.1 * total[0] && total[1] < 0.9 * total[0]); /* some are on the board */
    size_t lying = 0;
    for (size_t i = 0; i < SIZES; i++)
        lying += ground_parts_has(&ground, mean + 3 * i, GROUND_PART_LEVEL);
    double tilt = (total[2] - total[1]) * SIZES / flat_in[2].level_weight;
    assert_true(lying > 20 && lying < SIZES / 2);
    assert_true(tilt > 0.5 * (double)lying && tilt < 0.85 * (double)lying); /* by chance 2/3 */
}

/* A model of these Gaussians, and a buffer for gradients of its shapes. */
struct shapes {
    struct gauss g;
    struct render *r;
    struct render_model m;
    cl_mem extra;
    size_t floats;
    double sizes[3 * SIZES], mean[3 * SIZES], quat[4 * SIZES];
};

static void shapes_open(struct shapes *s)
{
    struct err e = {0};
    *s = (struct shapes){0};
    scale_sizes(s->sizes);
    scale_places(s->mean, s->quat);
    kit_gauss(3, SIZES, 10.0, 1, 0, &s->g);
    for (size_t i = 0; i < 3 * SIZES; i++)
        s->g.scale_log[i] = (float)s->sizes[i];
    kit_ok(render_open(dev_get(), &s->r, &e), e);
    kit_ok(render_model_upload(s->r, &s->g, &s->m, &e), e);
    s->floats = (size_t)s->m.groups * SHAPE * 16;
    kit_ok(dev_buffer(dev_get(), s->floats * sizeof(float), NULL, &s->extra, &e), e);
}

static void shapes_close(struct shapes *s)
{
    dev_release(&s->extra);
    render_model_free(&s->m);
    render_close(&s->r);
    gauss_free(&s->g);
}

/* Before a run: NaN where the buffer is fresh, because all of it must be written; else 0.25. */
static void shapes_fill(struct shapes *s, bool fresh)
{
    struct err e = {0};
    float *v = mem_array(s->floats, sizeof *v);
    assert_non_null(v);
    for (size_t i = 0; i < s->floats; i++)
        v[i] = fresh ? NAN : 0.25f;
    kit_ok(dev_write(dev_get(), s->extra, 0, s->floats * sizeof *v, v, &e), e);
    mem_free(v);
}

/* want [SIZES][planes], the first planes; the others have no gradient. */
static void shapes_expect(struct shapes *s, bool fresh, const double *want, size_t planes)
{
    double before = fresh ? 0.0 : 0.25, add = fresh ? 0.0 : 2e-8; /* a rounding of the sum */
    float *got = floats_read(s->extra, s->floats);
    for (size_t i = 0; i < (size_t)s->m.groups * 16; i++)
        for (size_t p = 0; p < SHAPE; p++) {
            double is = (double)got[(i / 16 * SHAPE + p) * 16 + i % 16];
            bool real = i < SIZES && p < planes; /* else padding, or a plane that has no part */
            double should = before + (real ? want[planes * i + p] : 0.0);
            double rounding = add + (p >= 3 ? KERNEL_TURN : 0.0);
            if (!(fabs(is - should) <= KERNEL_REL * fabs(should) + rounding))
                fail_msg("Gaussian %zu, plane %zu: %g, want %g", i, p, is, should);
        }
    mem_free(got);
}

static void check_scale_kernels(const struct scale_loss_input *in, uint32_t width)
{
    struct shapes s;
    struct scale_loss *loss = NULL;
    struct scale_loss_value value;
    struct err e = {0};
    double want[3 * SIZES];
    uint32_t own = dev_get()->vector_width;
    shapes_open(&s);
    const struct scale_loss_gauss of = {.mean = s.mean, .scale_log = s.sizes, .n = SIZES};
    struct scale_loss_value v = scale_loss_ref_run(&of, in, want);
    dev_get()->vector_width = width ? width : own;
    enum err_code rc = scale_loss_open(dev_get(), &loss, &e);
    dev_get()->vector_width = own;
    kit_ok(rc, e);
    for (int fresh = 0; fresh < 2; fresh++) {
        shapes_fill(&s, fresh);
        kit_ok(scale_loss_run(loss, &s.m, in, fresh, s.extra, &e), e);
        kit_ok(scale_loss_read(loss, &value, &e), e);
        assert_int_equal(value.n, v.n);
        assert_int_equal(value.m, v.m);
        assert_true(fabs(value.total - v.total) < 1e-5 * v.total);
        shapes_expect(&s, fresh, want, 3);
    }
    scale_loss_close(&loss);
    shapes_close(&s);
}

static void check_flat_kernels(const struct flat_loss_input *in, uint32_t width)
{
    struct shapes s;
    struct flat_loss *loss = NULL;
    struct err e = {0};
    double want[SHAPE * SIZES];
    uint32_t own = dev_get()->vector_width;
    shapes_open(&s);
    const struct flat_loss_gauss of = {
        .mean = s.mean, .scale_log = s.sizes, .quat = s.quat, .n = SIZES};
    (void)flat_loss_ref_run(&of, in, want);
    dev_get()->vector_width = width ? width : own;
    enum err_code rc = flat_loss_open(dev_get(), &loss, &e);
    dev_get()->vector_width = own;
    kit_ok(rc, e);
    for (int fresh = 0; fresh < 2; fresh++) {
        shapes_fill(&s, fresh);
        kit_ok(flat_loss_run(loss, &s.m, in, fresh, s.extra, &e), e);
        shapes_expect(&s, fresh, want, SHAPE);
    }
    flat_loss_close(&loss);
    shapes_close(&s);
}

static void kernels_match_their_references(void **state)
{
    for (uint32_t width = 0; width < 2; width++) {
        for (size_t i = 0; i < SCALE_INPUTS; i++)
            check_scale_kernels(&scale_in[i], width);
        for (size_t i = 0; i < FLAT_INPUTS; i++)
            check_flat_kernels(&flat_in[i], width);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(scale_reference_matches_differences),
        cmocka_unit_test(flat_reference_matches_differences),
        cmocka_unit_test(kernels_match_their_references),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    dev_close(dev_get());
    return failed;
}
