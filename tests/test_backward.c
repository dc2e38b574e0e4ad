/* Everything that runs backwards in render/: the double reference against finite differences, the kernels
 * against the reference, equal bits for any number of threads, Adam and its repairs.
 *
 * The picture is piecewise smooth: it jumps where alpha crosses 1/255, where a pixel saturates, where two
 * splats change places. The finite differences therefore compare a signature of these decisions and take
 * a smaller step, or leave the parameter out and count it, when a step changed one.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/camera.h"
#include "render/render.h"
#include "render/render_ref.h"

/* Fourth-order differences with steps of 2^-12 and less in double: truncation (h / sigma)^4 / 30 with sigma
 * >= 0.03 is below 1e-7, rounding 1e-16 * |L| / h below 1e-10. */
#define FD_REL 1e-6
/* Relative to the rms of the same kind of parameter: many true gradients are nearly 0. */
#define FD_ABS 1e-6

enum { PX_W = 40, PX_H = 32 };

struct scene {
    struct gauss g;
    struct camera cam;
    struct render_options o;
    double *rgb_grad; /* [h][w][3] */
};

static struct camera scene_camera(void)
{
    /* Off-centre principal point: the clamp of the Jacobian differs on every side. */
    struct camera c = {.width_px = PX_W, .height_px = PX_H, .fx_px = 45, .fy_px = 41, .cx_px = 18.3, .cy_px = 17.1};
    const double quat[4] = {0.83, 0.31, -0.4, 0.2};
    camera_quat_to_rot(quat, c.rot);
    for (int i = 0; i < 3; i++) /* looks at the origin from 3 m */
        c.trans[i] = i == 2 ? 3.0 : 0.05 * i;
    return c;
}

/* Steps of the differences are powers of two: with parameters on a grid of 2^-16 every step is exact. */
static float on_grid(double v)
{
    return (float)(round(v * 65536) / 65536);
}

static double *grad_make(size_t n, uint64_t seed)
{
    double *g = mem_array(n, sizeof *g);
    assert_non_null(g);
    for (size_t i = 0; i < n; i++)
        g[i] = (double)(float)rng_normal(seed, 77, i);
    return g;
}

static struct scene scene_make(uint64_t seed, size_t n, enum render_aa aa, uint32_t degree)
{
    struct scene s = {.cam = scene_camera(), .o = {.aa = aa, .background = {0.2f, 0.5f, 0.9f}, .sh_degree = -1}};
    struct err e = {0};
    kit_ok(gauss_alloc(&s.g, n, degree, 0, &e), e);
    s.g.n = n;
    size_t k = gauss_sh_count(degree);
    for (size_t i = 0; i < n; i++) {
        for (size_t a = 0; a < 3; a++) {
            s.g.mean_m[3 * i + a] = on_grid(2.2 * rng_unit(seed, a, i) - 1.1);
            s.g.scale_log[3 * i + a] = on_grid(-1.2 - 1.6 * rng_unit(seed, 3 + a, i));
        }
        for (size_t a = 0; a < 4; a++)
            s.g.quat_wxyz[4 * i + a] = on_grid(rng_normal(seed, 6 + a, i));
        s.g.opacity_logit[i] = on_grid(3 * rng_normal(seed, 10, i));
        for (size_t a = 0; a < 3 * k; a++)
            s.g.sh[3 * k * i + a] = on_grid((a < 3 ? 1.2 : 0.3) * rng_normal(seed, 11 + a, i));
    }
    s.rgb_grad = grad_make((size_t)PX_W * PX_H * 3, seed);
    return s;
}

static void scene_free(struct scene *s)
{
    gauss_free(&s->g);
    mem_free(s->rgb_grad);
}

/* ---- reference against finite differences ------------------------------------------------------------ */

/* sum(rgb * rgb_grad), and a hash of every decision taken on the way. The method holds the view direction of
 * SH fixed when a mean moves: `rgb_of` (may be NULL) [n][3] replaces the colours then. */
static double evaluate(const struct scene *s, const double *rgb_of, uint64_t *signature)
{
    struct ref_view v;
    struct ref_splat *splats;
    size_t n;
    struct err e = {0};
    struct buf decisions = {0};
    double sum = 0;
    kit_ok(ref_view_init(&s->g, &s->cam, &s->o, &v, &e), e);
    kit_ok(ref_project_all(&v, &s->g, &splats, &n, &e), e);
    for (size_t i = 0; i < n; i++) {
        struct ref_splat *p = &splats[i];
        for (size_t c = 0; rgb_of && c < 3; c++)
            p->rgb[c] = p->rgb_raw[c] = rgb_of[3 * p->index + c];
        buf_u32(&decisions, (uint32_t)p->index);
        buf_u8(&decisions, (unsigned)(p->inside[0] | p->inside[1] << 1 | (p->rgb_raw[0] > 0) << 2 |
                                      (p->rgb_raw[1] > 0) << 3 | (p->rgb_raw[2] > 0) << 4));
        buf_u8(&decisions, p->rho > 0.005);
    }
    for (size_t at = 0; at < (size_t)PX_W * PX_H; at++) {
        double t = 1, d[2], alpha;
        bool clamped;
        for (size_t i = 0; i < n && t > (double)RENDER_T_STOP; i++) {
            if (!ref_alpha(&splats[i], (double)(at % PX_W) + 0.5, (double)(at / PX_W) + 0.5, d, &alpha, &clamped))
                continue;
            buf_u32(&decisions, (uint32_t)(2 * i + clamped));
            for (size_t c = 0; c < 3; c++)
                sum += splats[i].rgb[c] * alpha * t * s->rgb_grad[3 * at + c];
            t *= 1 - alpha;
        }
        buf_u32(&decisions, ~0u);
        for (size_t c = 0; c < 3; c++)
            sum += t * v.background[c] * s->rgb_grad[3 * at + c];
    }
    *signature = hash_bytes(decisions.data, decisions.size).lo;
    buf_free(&decisions);
    mem_free(splats);
    return sum;
}

/* Fourth-order central difference with respect to *p; false when every step changes a decision. */
static bool differentiate(struct scene *s, float *p, const double *rgb_of, double *out)
{
    uint64_t here, sig[4];
    const float keep = *p;
    (void)evaluate(s, rgb_of, &here);
    for (double h = ldexp(1, -12); h >= ldexp(1, -15); h /= 2) {
        double f[4];
        bool same = true;
        for (int k = 0; k < 4 && same; k++) {
            static const double at[4] = {-2, -1, 1, 2};
            *p = (float)((double)keep + at[k] * h);
            assert_true((double)*p - (double)keep == at[k] * h);
            f[k] = evaluate(s, rgb_of, &sig[k]);
            same = sig[k] == here;
        }
        *p = keep;
        if (same) {
            *out = (8 * (f[2] - f[1]) - (f[3] - f[0])) / (12 * h);
            return true;
        }
    }
    return false;
}

struct grads { /* grads_free */
    double *block;
    struct render_ref_grads r;
    size_t count[5];
    double *part[5];
};

static struct grads grads_make(const struct gauss *g)
{
    struct grads o = {0};
    size_t k = 3 * gauss_sh_count(g->sh_degree), n = g->n;
    const size_t count[5] = {3 * n, 3 * n, 4 * n, n, k * n};
    o.block = mem_array(n * (11 + k), sizeof *o.block);
    assert_non_null(o.block);
    double *at = o.block;
    for (size_t i = 0; i < 5; i++) {
        o.count[i] = count[i];
        o.part[i] = at;
        at += count[i];
    }
    o.r = (struct render_ref_grads){o.part[0], o.part[1], o.part[2], o.part[3], o.part[4]};
    return o;
}

static const char *const part_name[5] = {"mean", "scale_log", "quat_wxyz", "opacity_logit", "sh"};

static double rms(const double *v, size_t n)
{
    double sum = 0;
    for (size_t i = 0; i < n; i++)
        sum += v[i] * v[i];
    return sqrt(sum / (double)(n ? n : 1));
}

/* Colours of the scene as it stands, by row. */
static double *colors_of(const struct scene *s)
{
    double *rgb = mem_array(3 * s->g.n, sizeof *rgb);
    struct ref_view v;
    struct ref_splat p;
    struct err e = {0};
    assert_non_null(rgb);
    kit_ok(ref_view_init(&s->g, &s->cam, &s->o, &v, &e), e);
    for (size_t i = 0; i < s->g.n; i++)
        if (ref_project(&v, &s->g, i, &p))
            memcpy(rgb + 3 * i, p.rgb, sizeof p.rgb);
    return rgb;
}

/* The analytic gradient of every parameter of the scene against differences. */
static void check_reference(struct scene *s, const char *what)
{
    struct grads want = grads_make(&s->g);
    struct err e = {0};
    float *const params[5] = {s->g.mean_m, s->g.scale_log, s->g.quat_wxyz, s->g.opacity_logit, s->g.sh};
    double *rgb = colors_of(s);
    size_t skipped = 0, all = 0;
    kit_ok(render_ref_backward(&s->g, &s->cam, &s->o, s->rgb_grad, &want.r, &e), e);
    for (size_t k = 0; k < 5; k++) {
        double *fd = mem_array(want.count[k], sizeof *fd);
        char name[96];
        assert_non_null(fd);
        for (size_t i = 0; i < want.count[k]; i++, all++)
            if (!differentiate(s, &params[k][i], k == 0 ? rgb : NULL, &fd[i])) {
                fd[i] = want.part[k][i];
                skipped++;
            }
        snprintf(name, sizeof name, "%s: %s", what, part_name[k]);
        kit_near_d(name, want.part[k], fd, want.count[k], FD_ABS * rms(fd, want.count[k]), FD_REL);
        mem_free(fd);
    }
    if (skipped * 8 > all)
        fail_msg("%s: %zu of %zu parameters could not be differentiated", what, skipped, all);
    mem_free(rgb);
    mem_free(want.block);
}

static void test_ref_all_parameters(void **state)
{
    (void)state;
    static const struct {
        enum render_aa aa;
        uint32_t degree;
        const char *name;
    } cases[] = {{RENDER_AA_NONE, 0, "none, degree 0"}, {RENDER_AA_2D, 1, "2d, degree 1"},
                 {RENDER_AA_MIP, 2, "mip, degree 2"},   {RENDER_AA_2D, 3, "2d, degree 3"}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct scene s = scene_make(100 + i, 7, cases[i].aa, cases[i].degree);
        check_reference(&s, cases[i].name);
        scene_free(&s);
    }
}

/* Opaque splats behind one another: alpha at its maximum, and pixels that stop before the last splat. */
static struct scene scene_saturated(enum render_aa aa)
{
    struct scene s = scene_make(7, 12, aa, 0);
    for (size_t i = 0; i < s.g.n; i++) {
        s.g.opacity_logit[i] = on_grid(i % 3 ? 7.0 : 1.0);
        for (size_t a = 0; a < 3; a++) {
            s.g.scale_log[3 * i + a] = on_grid(-0.7 - 0.1 * (double)a - 0.02 * (double)i);
            s.g.mean_m[3 * i + a] = on_grid((double)s.g.mean_m[3 * i + a] * 0.25);
        }
    }
    return s;
}

static void test_ref_saturated(void **state)
{
    (void)state;
    struct scene s = scene_saturated(RENDER_AA_2D);
    struct err e = {0};
    double *rgb = mem_array((size_t)PX_W * PX_H, 3 * sizeof *rgb), *t = mem_array((size_t)PX_W * PX_H, sizeof *t);
    size_t stopped = 0;
    assert_true(rgb && t);
    kit_ok(render_ref_forward(&s.g, &s.cam, &s.o, rgb, t, &e), e);
    for (size_t i = 0; i < (size_t)PX_W * PX_H; i++)
        stopped += t[i] <= (double)RENDER_T_STOP;
    assert_true(stopped > 50);
    check_reference(&s, "saturated");
    mem_free(rgb);
    mem_free(t);
    scene_free(&s);
}

/* Large splats whose centres lie outside the picture on every side, beyond the clamp of the Jacobian. */
static struct scene scene_outside(enum render_aa aa)
{
    struct scene s = scene_make(8, 8, aa, 1);
    for (size_t i = 0; i < s.g.n; i++) {
        static const double side[8][2] = {{-1, 0}, {1, 0}, {0, -1}, {0, 1}, {-1, -1}, {1, 1}, {0.9, -1}, {0.1, 0.2}};
        const double cam[3] = {side[i][0] * 1.7 - s.cam.trans[0], side[i][1] * 1.5 - s.cam.trans[1],
                               2.4 - s.cam.trans[2] + 0.05 * (double)i};
        for (size_t a = 0; a < 3; a++) { /* back to the world: R^T */
            s.g.mean_m[3 * i + a] = on_grid(s.cam.rot[a] * cam[0] + s.cam.rot[3 + a] * cam[1] + s.cam.rot[6 + a] * cam[2]);
            s.g.scale_log[3 * i + a] = on_grid(-0.7 + 0.2 * (double)a);
        }
        s.g.opacity_logit[i] = 0.5f;
    }
    return s;
}

static void test_ref_outside(void **state)
{
    (void)state;
    struct scene s = scene_outside(RENDER_AA_2D);
    struct ref_view v;
    struct ref_splat p;
    struct err e = {0};
    int clamped[2] = {0}, inside[2] = {0};
    kit_ok(ref_view_init(&s.g, &s.cam, &s.o, &v, &e), e);
    for (size_t i = 0; i < s.g.n; i++) {
        assert_true(ref_project(&v, &s.g, i, &p));
        for (int a = 0; a < 2; a++) {
            clamped[a] += !p.inside[a];
            inside[a] += p.inside[a];
        }
    }
    assert_true(clamped[0] >= 4 && clamped[1] >= 4 && inside[0] && inside[1]);
    check_reference(&s, "outside the picture");
    scene_free(&s);
}

/* Needles and discs: axes from 0.4 m down to 0.1 mm. */
static struct scene scene_needles(enum render_aa aa)
{
    struct scene s = scene_make(9, 8, aa, 0);
    for (size_t i = 0; i < s.g.n; i++) {
        s.g.scale_log[3 * i] = on_grid(-1.0);
        s.g.scale_log[3 * i + 1] = on_grid(i % 2 ? -1.1 : -6.0);
        s.g.scale_log[3 * i + 2] = on_grid(-4.0 - (double)(i % 4));
        s.g.opacity_logit[i] = 3.0f;
    }
    return s;
}

static void test_ref_needles(void **state)
{
    (void)state;
    static const enum render_aa modes[] = {RENDER_AA_NONE, RENDER_AA_2D, RENDER_AA_MIP};
    for (size_t i = 0; i < 3; i++) {
        struct scene s = scene_needles(modes[i]);
        check_reference(&s, "needles");
        scene_free(&s);
    }
}

/* An SH degree below the model's: the rest has no gradient. A culled Gaussian has none at all. */
static void test_ref_untouched(void **state)
{
    (void)state;
    struct scene s = scene_make(12, 5, RENDER_AA_2D, 3);
    struct grads g = grads_make(&s.g);
    struct err e = {0};
    s.o.sh_degree = 1;
    for (size_t i = 0; i < s.g.n; i++) {
        for (size_t a = 0; a < 48; a++)
            s.g.sh[48 * i + a] = a < 3 ? 2.0f : 0.01f; /* no colour is clamped */
        for (size_t a = 0; a < 3; a++)
            s.g.mean_m[3 * i + a] *= 0.25f;
        s.g.opacity_logit[i] = 0.0f;
    }
    for (size_t a = 0; a < 3; a++)
        s.g.mean_m[a] = (float)(-9 * s.cam.rot[6 + a]); /* behind the camera */
    for (size_t i = 0; i < 5 * (11 + 48); i++)
        g.block[i] = 1e9; /* must be overwritten */
    kit_ok(render_ref_backward(&s.g, &s.cam, &s.o, s.rgb_grad, &g.r, &e), e);
    for (size_t i = 0; i < 5; i++)
        for (size_t k = 0; k < 48; k++)
            assert_true((g.r.sh[48 * i + k] != 0) == (i > 0 && k < 12));
    for (size_t k = 0; k < 3; k++)
        assert_true(g.r.mean[k] == 0 && g.r.scale_log[k] == 0 && g.r.quat_wxyz[k] == 0);
    mem_fail_at(1);
    kit_fails(render_ref_backward(&s.g, &s.cam, &s.o, s.rgb_grad, &g.r, &e), ERR_MEM, e, NULL);
    mem_fail_at(0);
    mem_free(g.block);
    scene_free(&s);
}

/* ---- kernels against the reference -------------------------------------------------------------------- */

/* float against double: single gradients are sums of hundreds of products with cancellation. */
#define KERNEL_REL 2e-3
#define KERNEL_L2 1e-4
/* A pixel within this of a threshold (alpha at 1/255 or its maximum, T at the stop) may fall on either side
 * in float: its dL/dcolour is set to 0 so that the comparison does not depend on it. */
#define THRESHOLD_REL 2e-4

static struct dev *dev_get(void)
{
    static struct dev dev;
    struct err e = {0};
    if (!dev.context)
        kit_ok(dev_open(NULL, &dev, &e), e);
    return &dev;
}

static bool near(double a, double b)
{
    return fabs(a - b) <= THRESHOLD_REL * fabs(b);
}

/* Clear rgb_grad where float and double could decide differently; the fraction that is left. */
static double clear_ambiguous(struct scene *s)
{
    struct ref_view v;
    struct ref_splat *splats;
    size_t n, px = (size_t)s->cam.width_px * s->cam.height_px, left = 0;
    struct err e = {0};
    kit_ok(ref_view_init(&s->g, &s->cam, &s->o, &v, &e), e);
    kit_ok(ref_project_all(&v, &s->g, &splats, &n, &e), e);
    for (size_t at = 0; at < px; at++) {
        double t = 1, x = (double)(at % s->cam.width_px) + 0.5, y = (double)(at / s->cam.width_px) + 0.5;
        bool sure = true;
        for (size_t i = 0; i < n && t > (double)RENDER_T_STOP; i++) {
            const struct ref_splat *p = &splats[i];
            double dx = p->mean_px[0] - x, dy = p->mean_px[1] - y;
            double sigma = 0.5 * (p->conic[0] * dx * dx + p->conic[2] * dy * dy) + p->conic[1] * dx * dy;
            double a = p->opacity_eff * exp(-sigma);
            sure = sure && !near(a, 1 / 255.0) && !near(a, (double)RENDER_ALPHA_MAX);
            if (a < 1 / 255.0)
                continue;
            t *= 1 - fmin(a, (double)RENDER_ALPHA_MAX);
            sure = sure && !near(t, (double)RENDER_T_STOP);
        }
        for (size_t c = 0; c < 3 && !sure; c++)
            s->rgb_grad[3 * at + c] = 0;
        left += sure;
    }
    mem_free(splats);
    return (double)left / (double)px;
}

/* Forward and set dL/dcolour; the model stays for the caller. */
static void kernel_forward(struct render *r, const struct scene *s, struct render_model *m)
{
    struct err e = {0};
    size_t n = (size_t)s->cam.width_px * s->cam.height_px * 3;
    float *g = mem_array(n, sizeof *g);
    assert_non_null(g);
    for (size_t i = 0; i < n; i++)
        g[i] = (float)s->rgb_grad[i];
    if (!m->params)
        kit_ok(render_model_upload(r, &s->g, m, &e), e);
    kit_ok(render_forward(r, m, &s->cam, &s->o, NULL, NULL, &e), e);
    kit_ok(render_set_color_grad(r, g, &e), e);
    mem_free(g);
}

/* A buffer in the layout of the parameters, as arrays in the layout of gauss. */
static void planes_read(const struct render_model *m, cl_mem mem, struct gauss *out)
{
    struct err e = {0};
    size_t k = 3 * gauss_sh_count(m->sh_degree), words = (size_t)m->groups * m->planes * 16;
    float *raw = mem_array(words, sizeof *raw);
    assert_non_null(raw);
    kit_ok(dev_read(dev_get(), mem, 0, words * sizeof *raw, raw, &e), e);
    for (size_t i = 0; i < m->n; i++) {
        const float *p = raw + i / 16 * m->planes * 16 + i % 16;
        for (size_t a = 0; a < 3; a++) {
            out->mean_m[3 * i + a] = p[16 * (RENDER_PLANE_MEAN + a)];
            out->scale_log[3 * i + a] = p[16 * (RENDER_PLANE_SCALE + a)];
        }
        for (size_t a = 0; a < 4; a++)
            out->quat_wxyz[4 * i + a] = p[16 * (RENDER_PLANE_QUAT + a)];
        out->opacity_logit[i] = p[16 * RENDER_PLANE_OPACITY];
        for (size_t a = 0; a < k; a++)
            out->sh[k * i + a] = p[16 * (RENDER_PLANE_SH + a)];
    }
    mem_free(raw);
}

static void gauss_like(const struct gauss *g, struct gauss *out)
{
    struct err e = {0};
    kit_ok(gauss_alloc(out, g->n, g->sh_degree, 0, &e), e);
    out->n = g->n;
}

static float *part_of(struct gauss *g, size_t part)
{
    float *const parts[5] = {g->mean_m, g->scale_log, g->quat_wxyz, g->opacity_logit, g->sh};
    return parts[part];
}

/* Kernel gradients of s (unfused) into out. */
static void kernel_gradients(struct render *r, const struct scene *s, struct gauss *out)
{
    struct render_model m = {0};
    struct err e = {0};
    cl_mem grads;
    kernel_forward(r, s, &m);
    size_t bytes = (size_t)m.groups * m.planes * 16 * sizeof(float);
    float *junk = mem_array(bytes, 1);
    assert_non_null(junk);
    memset(junk, 0xFF, bytes); /* NaN: every plane must be written */
    kit_ok(dev_buffer(dev_get(), bytes, junk, &grads, &e), e);
    kit_ok(render_backward(r, &m, grads, &e), e);
    gauss_like(&s->g, out);
    planes_read(&m, grads, out);
    dev_release(&grads);
    mem_free(junk);
    render_model_free(&m);
}

static void check_kernels(struct render *r, struct scene *s, const char *what)
{
    struct grads want = grads_make(&s->g);
    struct gauss got = {0};
    struct err e = {0};
    double sure = clear_ambiguous(s);
    if (sure < 0.5)
        fail_msg("%s: only %.2f of the pixels are away from every threshold", what, sure);
    kit_ok(render_ref_backward(&s->g, &s->cam, &s->o, s->rgb_grad, &want.r, &e), e);
    kernel_gradients(r, s, &got);
    for (size_t k = 0; k < 5; k++) {
        char name[96];
        const float *v = part_of(&got, k);
        double err2 = 0, ref2 = 0;
        for (size_t i = 0; i < want.count[k]; i++) {
            err2 += ((double)v[i] - want.part[k][i]) * ((double)v[i] - want.part[k][i]);
            ref2 += want.part[k][i] * want.part[k][i];
        }
        snprintf(name, sizeof name, "%s: %s", what, part_name[k]);
        kit_near(name, v, want.part[k], want.count[k], KERNEL_REL * rms(want.part[k], want.count[k]),
                 KERNEL_REL);
        if (getenv("CITYSPLAT_TEST_VERBOSE"))
            print_message("%s: relative L2 %.2g, %.2f of the pixels\n", name, sqrt(err2 / ref2), sure);
        if (!(sqrt(err2) <= KERNEL_L2 * sqrt(ref2)))
            fail_msg("%s: relative L2 error %g > %g", name, sqrt(err2 / ref2), KERNEL_L2);
    }
    gauss_free(&got);
    mem_free(want.block);
}

static void test_kernels_match_reference(void **state)
{
    (void)state;
    static const enum render_aa modes[] = {RENDER_AA_NONE, RENDER_AA_2D, RENDER_AA_MIP};
    struct render *r;
    struct err e = {0};
    kit_ok(render_open(dev_get(), &r, &e), e);
    for (uint32_t i = 0; i < 3; i++) {
        char name[64];
        for (uint32_t degree = 0; degree < 4; degree++) {
            struct scene s = scene_make(20 + i, 15 + degree, modes[i], degree);
            snprintf(name, sizeof name, "mode %u, degree %u", i, degree);
            check_kernels(r, &s, name);
            scene_free(&s);
        }
        struct scene s = scene_saturated(modes[i]);
        check_kernels(r, &s, "saturated");
        scene_free(&s);
        s = scene_outside(modes[i]);
        check_kernels(r, &s, "outside the picture");
        scene_free(&s);
        s = scene_needles(modes[i]);
        check_kernels(r, &s, "needles");
        scene_free(&s);
    }
    struct scene s = scene_make(5, 300, RENDER_AA_2D, 3); /* many groups, long lists */
    check_kernels(r, &s, "300 Gaussians");
    s.o.sh_degree = 1;
    check_kernels(r, &s, "degree 1 of 3");
    scene_free(&s);
    render_close(&r);
}

int main(int argc, char **argv)
{
    (void)argc;
    (void)argv;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_ref_all_parameters), cmocka_unit_test(test_ref_saturated),
        cmocka_unit_test(test_ref_outside),        cmocka_unit_test(test_ref_needles),
        cmocka_unit_test(test_ref_untouched),      cmocka_unit_test(test_kernels_match_reference),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    dev_close(dev_get());
    return failed;
}
