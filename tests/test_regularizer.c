/* Regularisers: each reference in double against finite differences, each kernel against its
 * reference, in both shapes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/appearance.h"
#include "loss/depth.h"
#include "loss/mip.h"
#include "loss/scale_loss.h"
#include "tests/backward_kit.h"

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
static const struct scale_loss_ground scale_ground = {.parts = board,
                                                      .nx = BOARD,
                                                      .ny = BOARD,
                                                      .corner_m = {-7.3, -6.1},
                                                      .cell_m = 1.9,
                                                      .s_max_m = 0.6};
enum { SCALE_INPUTS = 5 };
static const struct scale_loss_input scale_in[SCALE_INPUTS] = {
    {.s_max_m = 2.0, .r_max = 10.0, .weight = 0.05},
    {.s_max_m = 2.0, .r_max = 10.0, .weight = 0.05, .ground = &scale_ground},
    {.s_max_m = 2.0, .r_max = 10.0, .weight = 0.05, .flat_weight = 3.0, .flat_m = 0.2},
    {.s_max_m = 2.0,
     .r_max = 10.0,
     .weight = 0.05,
     .flat_weight = 3.0,
     .flat_m = 0.2,
     .ground = &scale_ground},
    {.s_max_m = 2.0,
     .r_max = 10.0,
     .weight = 0.05,
     .flat_weight = 3.0,
     .flat_m = 0.2,
     .level_weight = 2.0,
     .ground = &scale_ground}};
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

static void check_scale_differences(const struct scale_loss_input *in)
{
    double sizes[3 * SIZES], mean[3 * SIZES], quat[4 * SIZES], g[SHAPE * SIZES], fd[SHAPE * SIZES];
    const struct scale_loss_gauss of = {.mean = mean, .scale_log = sizes, .quat = quat, .n = SIZES};
    scale_sizes(sizes);
    scale_places(mean, quat);
    struct scale_loss_value v = scale_loss_ref_run(&of, in, g);
    assert_true(v.n > 20 && v.n < 400 && v.m > 20 && v.m < 190);
    for (size_t i = 0; i < SHAPE * SIZES; i++) {
        size_t one = i / SHAPE, p = i % SHAPE;
        double *is = p < 3 ? sizes + 3 * one + p : quat + 4 * one + p - 3;
        double keep = *is, at[2];
        for (int k = 0; k < 2; k++) {
            *is = keep + (k ? FD_STEP : -FD_STEP);
            struct scale_loss_value w = scale_loss_ref_run(&of, in, NULL);
            /* the indicators have no derivative: leave out what changes one */
            at[k] = w.n == v.n && w.m == v.m ? w.total : (double)NAN;
        }
        *is = keep;
        fd[i] = (at[1] - at[0]) / (2.0 * FD_STEP);
        /* where two axes are equal the middle one changes its name: only half the way is right */
        if (!isfinite(fd[i]) || (p < 3 && one % 7 == 0))
            fd[i] = g[i];
    }
    kit_near_d("dL/dshape", g, fd, SHAPE * SIZES, 1e-9, FD_REL);
}

static void scale_reference_matches_differences(void **state)
{
    (void)state;
    double x[3 * SIZES], mean[3 * SIZES], quat[4 * SIZES], total[SCALE_INPUTS];
    const struct scale_loss_gauss of = {.mean = mean, .scale_log = x, .quat = quat, .n = SIZES};
    uint32_t n[SCALE_INPUTS];
    for (int i = 0; i < SCALE_INPUTS; i++)
        check_scale_differences(&scale_in[i]);
    scale_sizes(x);
    scale_places(mean, quat);
    for (int i = 0; i < SCALE_INPUTS; i++) {
        struct scale_loss_value v = scale_loss_ref_run(&of, &scale_in[i], NULL);
        total[i] = v.total;
        n[i] = v.n;
    }
    assert_true(n[1] > n[0] + 20); /* the board has some of them */
    double part = total[3] - total[1], whole = total[2] - total[0];
    assert_true(part > 0.1 * whole && part < 0.9 * whole); /* and some of the thick ones */
    size_t lying = 0;
    for (size_t i = 0; i < SIZES; i++) {
        double column = floor((mean[3 * i] - scale_ground.corner_m[0]) / scale_ground.cell_m),
               row = floor((mean[3 * i + 1] - scale_ground.corner_m[1]) / scale_ground.cell_m);
        bool on = column >= 0 && row >= 0 && column < BOARD && row < BOARD;
        lying += on && board[(size_t)row * BOARD + (size_t)column] & SCALE_LOSS_LEVEL;
    }
    double tilt = (total[4] - total[3]) * SIZES / scale_in[4].level_weight;
    assert_true(lying > 20 && lying < SIZES / 2);
    assert_true(tilt > 0.5 * (double)lying && tilt < 0.85 * (double)lying); /* by chance 2/3 */
}

static void gauss_of_sizes(const double *scale_log, struct gauss *g)
{
    kit_gauss(3, SIZES, 10.0, 1, 0, g);
    for (size_t i = 0; i < 3 * SIZES; i++)
        g->scale_log[i] = (float)scale_log[i];
}

static void check_scale_kernels(const struct scale_loss_input *in, uint32_t width)
{
    double x[3 * SIZES], want[SHAPE * SIZES], mean[3 * SIZES], quat[4 * SIZES];
    const struct scale_loss_gauss of = {.mean = mean, .scale_log = x, .quat = quat, .n = SIZES};
    struct gauss g = {0};
    struct render *r = NULL;
    struct render_model m = {0};
    struct scale_loss *s = NULL;
    struct scale_loss_value value;
    struct err e = {0};
    cl_mem extra = NULL;
    uint32_t own = dev_get()->vector_width;
    scale_sizes(x);
    scale_places(mean, quat);
    gauss_of_sizes(x, &g);
    struct scale_loss_value v = scale_loss_ref_run(&of, in, want);
    kit_ok(render_open(dev_get(), &r, &e), e);
    kit_ok(render_model_upload(r, &g, &m, &e), e);
    size_t floats = (size_t)m.groups * 11 * 16;
    float *junk = mem_array(floats, sizeof *junk);
    assert_non_null(junk);
    memset(junk, 0xFF, floats * sizeof *junk); /* NaN: every plane must be written */
    kit_ok(dev_buffer(dev_get(), floats * sizeof *junk, junk, &extra, &e), e);
    dev_get()->vector_width = width ? width : own;
    enum err_code rc = scale_loss_open(dev_get(), &s, &e);
    dev_get()->vector_width = own;
    kit_ok(rc, e);
    /* All planes with the value, then those of the shape alone, and the counts without it. */
    for (int only = 0; only < 2; only++) {
        size_t planes = only ? SHAPE : 11, first = only ? 0 : 3;
        struct scale_loss_input wanted = *in;
        wanted.value = !only;
        kit_ok(dev_write(dev_get(), extra, 0, floats * sizeof *junk, junk, &e), e);
        kit_ok(scale_loss_run(s, &m, &wanted, only, extra, &e), e);
        kit_ok(scale_loss_read(s, &value, &e), e);
        assert_int_equal(value.n, v.n);
        assert_int_equal(value.m, v.m);
        assert_true(only || fabs(value.total - v.total) < 1e-5 * v.total);
        float *got = floats_read(extra, floats);
        for (size_t i = 0; i < SIZES; i++)
            for (size_t p = 0; p < planes; p++) {
                double is = (double)got[(i / 16 * planes + p) * 16 + i % 16];
                bool shape = p >= first && p < first + SHAPE;
                double should = shape ? want[SHAPE * i + p - first] : 0.0;
                double rounding = shape && p >= first + 3 ? KERNEL_TURN : 0.0;
                if (!(fabs(is - should) <= KERNEL_REL * fabs(should) + rounding))
                    fail_msg("Gaussian %zu, plane %zu: %g, want %g", i, p, is, should);
            }
        for (size_t i = SIZES; i < (size_t)m.groups * 16; i++) /* padding */
            for (size_t p = 0; p < planes; p++)
                assert_true(got[(i / 16 * planes + p) * 16 + i % 16] == 0.0f);
        mem_free(got);
    }
    mem_free(junk);
    dev_release(&extra);
    scale_loss_close(&s);
    render_model_free(&m);
    render_close(&r);
    gauss_free(&g);
}

static void scale_kernels_match_the_reference(void **state)
{
    (void)state;
    for (size_t i = 0; i < SCALE_INPUTS; i++) {
        check_scale_kernels(&scale_in[i], 0);
        check_scale_kernels(&scale_in[i], 1);
    }
}

/* ---- the 3-D filter ---- */

static void folding_a_filter_has_the_right_derivatives(void **state)
{
    (void)state;
    for (size_t t = 0; t < 200; t++) {
        double x[4], weight[4], g_scale[3], g_opacity, fd[4];
        double f = 0.02 * rng_unit(9, 1, t);
        for (size_t k = 0; k < 4; k++) {
            x[k] = k < 3 ? log(0.005) + 2.0 * rng_unit(9, 2 + k, t) : rng_normal(9, 5, t);
            weight[k] = rng_normal(9, 6 + k, t);
        }
        /* f(folded) = weight . folded: its gradient with respect to the folded ones is weight. */
        memcpy(g_scale, weight, sizeof g_scale);
        g_opacity = weight[3];
        mip_fold_grad(f, x, x[3], g_scale, &g_opacity);
        double got[4] = {g_scale[0], g_scale[1], g_scale[2], g_opacity};
        for (size_t i = 0; i < 4; i++) {
            double at[2];
            for (int k = 0; k < 2; k++) {
                double y[4];
                memcpy(y, x, sizeof y);
                y[i] += k ? FD_STEP : -FD_STEP;
                mip_fold_one(f, y, y + 3);
                at[k] = y[0] * weight[0] + y[1] * weight[1] + y[2] * weight[2] + y[3] * weight[3];
            }
            fd[i] = (at[1] - at[0]) / (2.0 * FD_STEP);
        }
        kit_near_d("fold", got, fd, 4, 1e-8, FD_REL);
    }
}

/* Embeddings, and the constants of an appearance that leaves opacity alone: folding is before its
 * offset, the kernels' filter after it. *frame: mem_free. */
static void add_appearance(struct view_case *s, float **frame)
{
    struct gauss with = {0};
    struct appearance a = {0};
    struct err e = {0};
    kit_ok(gauss_alloc(&with, s->g.n, s->g.sh_degree, 8, &e), e);
    kit_ok(gauss_append(&with, &s->g, NULL, s->g.n, &e), e);
    for (size_t i = 0; i < with.n * 8; i++)
        with.embed[i] = (float)rng_normal(33, 0, i);
    gauss_free(&s->g);
    s->g = with;
    kit_ok(appearance_alloc(&a, 8, 4, 12, 1, &e), e);
    appearance_init(&a, 34);
    a.b2[3] = -60.0f;
    *frame = mem_array(appearance_frame_floats(8, 12), sizeof **frame);
    assert_non_null(*frame);
    appearance_frame(&a, a.images, *frame);
    s->o.appearance_frame = *frame;
    s->o.appearance_hidden = 12;
    appearance_free(&a);
}

/* A model drawn with a filter: picture and gradients are those of the folded Gaussians. */
static void check_folded(bool look)
{
    float *frames[2] = {NULL, NULL};
    struct view_case s = view_case_make(31, 40, RENDER_AA_MIP, 1),
                     folded = view_case_make(31, 40, RENDER_AA_MIP, 1);
    struct render *r = NULL;
    struct render_model m = {0};
    struct err e = {0};
    struct gauss got = {0};
    float filter[48] = {0};
    cl_mem grads = NULL;
    kit_ok(render_open(dev_get(), &r, &e), e);
    for (size_t i = 0; i < s.g.n; i++)
        filter[i] = (float)(0.01 + 0.2 * rng_unit(32, 1, i));
    if (look) {
        add_appearance(&s, &frames[0]);
        add_appearance(&folded, &frames[1]);
    }
    mip_fold(&folded.g, filter);
    memcpy(folded.rgb_grad, s.rgb_grad, (size_t)PX_W * PX_H * 3 * sizeof(double));
    (void)clear_ambiguous(&folded);
    memcpy(s.rgb_grad, folded.rgb_grad, (size_t)PX_W * PX_H * 3 * sizeof(double));
    struct grads want = grads_make(&s.g);
    kit_ok(render_ref_backward(&folded.g, &folded.cam, &folded.o, folded.rgb_grad, &want.r, &e), e);
    for (size_t i = 0; i < s.g.n; i++) {
        double x[3];
        for (size_t k = 0; k < 3; k++)
            x[k] = (double)s.g.scale_log[3 * i + k];
        mip_fold_grad((double)filter[i], x, (double)s.g.opacity_logit[i], want.r.scale_log + 3 * i,
                      want.r.opacity_logit + i);
    }
    kit_ok(render_model_upload(r, &s.g, &m, &e), e);
    kit_ok(dev_buffer(dev_get(), sizeof filter, filter, &m.filter, &e), e);
    kernel_forward(r, &s, &m);
    kit_ok(dev_buffer(dev_get(), (size_t)m.groups * m.planes * 64, NULL, &grads, &e), e);
    kit_ok(render_backward(r, &m, grads, &e), e);
    gauss_like(&s.g, &got);
    planes_read(&m, grads, &got);
    for (size_t k = 0; k < 5; k++)
        kit_near(backward_part[k], part_of(&got, k), want.part[k], want.count[k],
                 2e-3 * rms(want.part[k], want.count[k]), 2e-3); /* as in test_backward.c */
    gauss_free(&got);
    mem_free(want.block);
    dev_release(&grads);
    render_model_free(&m);
    render_close(&r);
    mem_free(frames[0]);
    mem_free(frames[1]);
    view_case_free(&s);
    view_case_free(&folded);
}

static void kernels_draw_the_folded_gaussians(void **state)
{
    (void)state;
    check_folded(false);
    check_folded(true);
}

static void check_filter_kernels(uint32_t width)
{
    struct gauss g = {0};
    struct render *r = NULL;
    struct render_model m = {0};
    struct mip *mip = NULL;
    struct err e = {0};
    struct camera cams[3];
    double want[SIZES];
    uint32_t own = dev_get()->vector_width;
    kit_gauss(8, SIZES, 30.0, 0, 0, &g);
    g.origin_enu_m[0] = 1e5; /* the origin must leave the numbers before they are floats */
    for (size_t i = 0; i < 3; i++) {
        double eye[3] = {1e5 + 20.0 * (double)i - 20.0, 5.0, 40.0 + 10.0 * (double)i},
               target[3] = {1e5, 0.0, 0.0};
        cams[i] = camera_look_at(eye, target, 0.4, 100, 80);
    }
    mip_ref_filter(&g, cams, 3, want);
    kit_ok(render_open(dev_get(), &r, &e), e);
    kit_ok(render_model_upload(r, &g, &m, &e), e);
    dev_get()->vector_width = width ? width : own;
    enum err_code rc = mip_open(dev_get(), &mip, &e);
    dev_get()->vector_width = own;
    kit_ok(rc, e);
    kit_ok(mip_run(mip, &m, cams, 3, &e), e);
    float *got = floats_read(m.filter, SIZES);
    kit_near("filter", got, want, SIZES, 0.0, 1e-5);
    double largest = 0.0; /* what those take that no camera sees */
    size_t unseen = 0;
    for (size_t i = 0; i < SIZES; i++)
        largest = fmax(largest, want[i]);
    for (size_t i = 0; i < SIZES; i++)
        unseen += want[i] == largest;
    assert_true(unseen > 3 && unseen < SIZES - 20);
    mem_free(got);
    mip_close(&mip);
    render_model_free(&m);
    render_close(&r);
    gauss_free(&g);
}

static void filter_kernels_match_the_reference(void **state)
{
    (void)state;
    check_filter_kernels(0);
    check_filter_kernels(1);
}

/* ---- depth ---- */

/* backward_kit.h has a struct view_case of its own: what depth needs of it. */
struct depth_case {
    struct view_case s;
    struct depth_input in;
    float *target;
};

/* A target well away from the picture, unknown in every fifth pixel: signs do not change. */
static struct depth_case depth_case_make(uint64_t seed, size_t n, bool hard)
{
    struct depth_case c = {.s = view_case_make(seed, n, RENDER_AA_2D, 1)};
    struct err e = {0};
    size_t pixels = (size_t)PX_W * PX_H;
    double loss, *depth = mem_array(pixels, sizeof *depth);
    c.target = mem_array(pixels, sizeof *c.target);
    assert_true(depth && c.target);
    c.in = (struct depth_input){.cam = &c.s.cam,
                                .options = c.s.o,
                                .target = c.target,
                                .unit_m = 2.5,
                                .n_known = pixels,
                                .weight = 0.5,
                                .hard = hard};
    kit_ok(depth_ref_loss(&c.s.g, &c.in, depth, &loss, &e), e);
    for (size_t i = 0; i < pixels; i++) {
        double away = rng_unit(seed, 99, i) < 0.5 ? 0.4 : -0.4;
        c.target[i] = i % 5 ? (float)fmax(depth[i] + away, 0.0) : -1.0f;
        if (i % 5 && fabs((double)c.target[i] - depth[i]) < 0.05)
            c.target[i] = (float)(depth[i] + 0.4);
    }
    mem_free(depth);
    return c;
}

static void depth_case_free(struct depth_case *c)
{
    mem_free(c->target);
    view_case_free(&c->s);
}

static double depth_loss_of(struct depth_case *c)
{
    static double depth[PX_W * PX_H];
    double loss;
    struct err e = {0};
    c->in.cam = &c->s.cam;
    kit_ok(depth_ref_loss(&c->s.g, &c->in, depth, &loss, &e), e);
    return loss;
}

/* Fourth-order difference at two steps; false where they disagree: a splat crossed 1/255 there. */
static bool depth_differ(struct depth_case *c, float *p, double *out)
{
    const float keep = *p;
    double d[2];
    for (int k = 0; k < 2; k++) {
        double h = ldexp(1, -14 - k), f[4];
        for (int j = 0; j < 4; j++) {
            *p = (float)((double)keep + (j < 2 ? j - 2 : j - 1) * h);
            f[j] = depth_loss_of(c);
        }
        d[k] = (8 * (f[2] - f[1]) - (f[3] - f[0])) / (12 * h);
    }
    *p = keep;
    *out = d[1];
    return fabs(d[0] - d[1]) <= 1e-7 + 1e-5 * fabs(d[1]);
}

static void depth_reference_matches_differences(void **state)
{
    (void)state;
    struct err e = {0};
    for (int hard = 0; hard < 2; hard++) {
        struct depth_case c = depth_case_make(51, 6, hard);
        struct grads want = grads_make(&c.s.g);
        size_t skipped = 0, all = 0;
        c.in.cam = &c.s.cam;
        kit_ok(depth_ref_grads(&c.s.g, &c.in, &want.r, &e), e);
        for (size_t part = 0; part < (hard ? 3u : 4u); part++) { /* opacity of hard: see below */
            double *fd = mem_array(want.count[part], sizeof *fd);
            assert_non_null(fd);
            for (size_t i = 0; i < want.count[part]; i++, all++)
                if (!depth_differ(&c, &part_of(&c.s.g, part)[i], &fd[i])) {
                    fd[i] = want.part[part][i];
                    skipped++;
                }
            kit_near_d(backward_part[part], want.part[part], fd, want.count[part],
                       1e-6 * rms(fd, want.count[part]) + 1e-9, 1e-5);
            mem_free(fd);
        }
        assert_true(skipped * 3 < all);
        mem_free(want.block);
        depth_case_free(&c);
    }
}

/* Straight through: dL/do of the hard pass is that of a soft pass in which all have DEPTH_HARD. */
static void opacity_of_the_hard_pass_goes_straight_through(void **state)
{
    (void)state;
    struct err e = {0};
    struct depth_case hard = depth_case_make(52, 9, true), soft = depth_case_make(52, 9, true);
    struct grads h = grads_make(&hard.s.g), s = grads_make(&soft.s.g);
    soft.in.hard = false;
    soft.in.target = hard.target;
    soft.in.cam = &soft.s.cam;
    hard.in.cam = &hard.s.cam;
    for (size_t i = 0; i < soft.s.g.n; i++)
        soft.s.g.opacity_logit[i] = (float)log(DEPTH_HARD / (1.0 - DEPTH_HARD));
    kit_ok(depth_ref_grads(&hard.s.g, &hard.in, &h.r, &e), e);
    kit_ok(depth_ref_grads(&soft.s.g, &soft.in, &s.r, &e), e);
    double largest = 0.0;
    for (size_t i = 0; i < hard.s.g.n; i++) {
        double o = 1.0 / (1.0 + exp(-(double)hard.s.g.opacity_logit[i]));
        double want = s.r.opacity_logit[i] / (DEPTH_HARD * (1.0 - DEPTH_HARD)) * o * (1.0 - o);
        assert_true(fabs(h.r.opacity_logit[i] - want) <= 1e-12 + 1e-6 * fabs(want));
        largest = fmax(largest, fabs(want));
    }
    assert_true(largest > 1e-6);
    mem_free(h.block);
    mem_free(s.block);
    depth_case_free(&hard);
    depth_case_free(&soft);
}

static void check_depth_kernels(uint32_t width, bool hard)
{
    struct depth_case c = depth_case_make(53, 70, hard);
    struct grads want = grads_make(&c.s.g);
    struct render *r = NULL;
    struct render_model m = {0};
    struct depth *d = NULL;
    struct err e = {0};
    cl_mem extra = NULL;
    double loss;
    uint32_t own = dev_get()->vector_width;
    c.in.cam = &c.s.cam;
    /* Pixels near a threshold may be decided differently in float: make them unknown. */
    struct view_case twin = view_case_make(53, 70, RENDER_AA_2D, 1);
    for (size_t i = 0; hard && i < twin.g.n; i++)
        twin.g.opacity_logit[i] = (float)log(DEPTH_HARD / (1.0 - DEPTH_HARD));
    (void)clear_ambiguous(&twin);
    for (size_t i = 0; i < (size_t)PX_W * PX_H; i++)
        if (twin.rgb_grad[3 * i] == 0.0)
            c.target[i] = -1.0f;
    view_case_free(&twin);
    kit_ok(depth_ref_grads(&c.s.g, &c.in, &want.r, &e), e);
    kit_ok(render_open(dev_get(), &r, &e), e);
    kit_ok(render_model_upload(r, &c.s.g, &m, &e), e);
    size_t floats = (size_t)m.groups * 11 * 16;
    kit_ok(dev_buffer(dev_get(), floats * sizeof(float), NULL, &extra, &e), e);
    kit_ok(dev_zero(dev_get(), extra, 0, floats * sizeof(float), &e), e);
    dev_get()->vector_width = width ? width : own;
    enum err_code rc = depth_open(dev_get(), &d, &e);
    dev_get()->vector_width = own;
    kit_ok(rc, e);
    for (int k = 0; k < 2; k++) /* added, not written: twice the gradient */
        kit_ok(depth_run(d, r, &m, &c.in, extra, &e), e);
    kit_ok(depth_read(d, &loss, &e), e);
    double expected = depth_loss_of(&c);
    assert_true(fabs(loss - expected) < 1e-4 * expected);
    float *got = floats_read(extra, floats);
    static const size_t first[4] = {0, 3, 6, 10}, planes[4] = {3, 3, 4, 1};
    for (size_t part = 0; part < 4; part++) {
        float *v = mem_array(want.count[part], sizeof *v);
        assert_non_null(v);
        for (size_t i = 0; i < want.count[part]; i++) {
            size_t row = i / planes[part], p = first[part] + i % planes[part];
            v[i] = 0.5f * got[(row / 16 * 11 + p) * 16 + row % 16];
        }
        kit_near(backward_part[part], v, want.part[part], want.count[part],
                 2e-3 * rms(want.part[part], want.count[part]), 2e-3);
        mem_free(v);
    }
    mem_free(got);
    dev_release(&extra);
    depth_close(&d);
    render_model_free(&m);
    render_close(&r);
    mem_free(want.block);
    depth_case_free(&c);
}

static void depth_kernels_match_the_reference(void **state)
{
    (void)state;
    for (int hard = 0; hard < 2; hard++)
        for (uint32_t width = 0; width < 2; width++)
            check_depth_kernels(width, hard);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(scale_reference_matches_differences),
        cmocka_unit_test(scale_kernels_match_the_reference),
        cmocka_unit_test(folding_a_filter_has_the_right_derivatives),
        cmocka_unit_test(kernels_draw_the_folded_gaussians),
        cmocka_unit_test(filter_kernels_match_the_reference),
        cmocka_unit_test(depth_reference_matches_differences),
        cmocka_unit_test(opacity_of_the_hard_pass_goes_straight_through),
        cmocka_unit_test(depth_kernels_match_the_reference),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    dev_close(dev_get());
    return failed;
}
