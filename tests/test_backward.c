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
#define KERNEL_L2 2e-5 /* over all Gaussians: measured 4e-6 at worst */
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

/* Kernel gradients of s (unfused) into out, by kernels of this vector width (0: the device's own). */
static void kernel_gradients(struct render *r, const struct scene *s, uint32_t width, struct gauss *out)
{
    uint32_t own = dev_get()->vector_width;
    struct render_model m = {0};
    struct err e = {0};
    cl_mem grads;
    kernel_forward(r, s, &m);
    size_t bytes = (size_t)m.groups * m.planes * 16 * sizeof(float);
    float *junk = mem_array(bytes, 1);
    assert_non_null(junk);
    memset(junk, 0xFF, bytes); /* NaN: every plane must be written */
    kit_ok(dev_buffer(dev_get(), bytes, junk, &grads, &e), e);
    dev_get()->vector_width = width ? width : own;
    enum err_code rc = render_backward(r, &m, grads, &e);
    dev_get()->vector_width = own;
    kit_ok(rc, e);
    gauss_like(&s->g, out);
    planes_read(&m, grads, out);
    dev_release(&grads);
    mem_free(junk);
    render_model_free(&m);
}

static void check_kernels(struct render *r, struct scene *s, const char *what, uint32_t width)
{
    struct grads want = grads_make(&s->g);
    struct gauss got = {0};
    struct err e = {0};
    double sure = clear_ambiguous(s);
    if (sure < 0.5)
        fail_msg("%s: only %.2f of the pixels are away from every threshold", what, sure);
    kit_ok(render_ref_backward(&s->g, &s->cam, &s->o, s->rgb_grad, &want.r, &e), e);
    kernel_gradients(r, s, width, &got);
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
            check_kernels(r, &s, name, 0);
            scene_free(&s);
        }
        struct scene s = scene_saturated(modes[i]);
        check_kernels(r, &s, "saturated", 0);
        scene_free(&s);
        s = scene_outside(modes[i]);
        check_kernels(r, &s, "outside the picture", 0);
        scene_free(&s);
        s = scene_needles(modes[i]);
        check_kernels(r, &s, "needles", 0);
        scene_free(&s);
    }
    struct scene s = scene_make(5, 300, RENDER_AA_2D, 3); /* many groups, long lists */
    check_kernels(r, &s, "300 Gaussians", 0);
    s.o.sh_degree = 1;
    check_kernels(r, &s, "degree 1 of 3", 0);
    scene_free(&s);
    render_close(&r);
}

/* The kernels as a GPU gets them (one Gaussian or pixel a work-item), run here: those of the way back are
 * built on first use, so that the forward pass need not be narrow as well. */
static void test_narrow_kernels_match_reference(void **state)
{
    (void)state;
    for (int i = 0; i < 3; i++) {
        struct scene s = i == 0 ? scene_make(60, 40, RENDER_AA_2D, 2) : i == 1 ? scene_saturated(RENDER_AA_MIP)
                                                                             : scene_needles(RENDER_AA_NONE);
        struct render *r;
        struct err e = {0};
        kit_ok(render_open(dev_get(), &r, &e), e);
        check_kernels(r, &s, "narrow", 1);
        render_close(&r);
        scene_free(&s);
    }
}

/* ---- thresholds: forward and backward must decide alike (F25) ------------------------------------------ */

/* The picture is linear in the colours: C - T background = sum_i w_i rgb_i, and dC/drgb_i = w_i. If backward
 * took in one splat more or less at one pixel, sum_i rgb_i dC/drgb_i would be off by 1/255 T rgb at least.
 * So it is checked pixel by pixel, on splats of which many sit at the thresholds. */
#define LINEAR_REL 2e-5
static void test_same_decisions(void **state)
{
    (void)state;
    struct render *r;
    struct render_model m = {0};
    struct err e = {0};
    struct scene s = scene_saturated(RENDER_AA_NONE);
    struct gauss g = {0};
    const size_t px = (size_t)PX_W * PX_H;
    float *rgb = mem_array(px, 3 * sizeof *rgb), *t = mem_array(px, sizeof *t), *g1 = mem_array(px, 3 * sizeof *g1);
    cl_mem grads;
    assert_true(rgb && t && g1);
    kit_ok(gauss_reserve(&s.g, 400, &e), e);
    for (size_t i = s.g.n; i < 400; i++) { /* faint splats: peaks within 2 % of 1/255 */
        gauss_copy_row(&s.g, i, &s.g, i % 12);
        s.g.opacity_logit[i] = (float)(log(1 / 254.0) + 0.04 * (rng_unit(3, 1, i) - 0.5));
        for (size_t a = 0; a < 3; a++) {
            s.g.mean_m[3 * i + a] = (float)(2 * rng_unit(3, 2 + a, i) - 1);
            s.g.scale_log[3 * i + a] = -1.0f;
        }
    }
    s.g.n = 400;
    kit_ok(render_open(dev_get(), &r, &e), e);
    kit_ok(render_model_upload(r, &s.g, &m, &e), e);
    kit_ok(render_forward(r, &m, &s.cam, &s.o, rgb, t, &e), e);
    kit_ok(dev_buffer(dev_get(), (size_t)m.groups * m.planes * 64, NULL, &grads, &e), e);
    gauss_like(&s.g, &g);
    size_t stopped = 0;
    for (uint64_t k = 0; k < 200; k++) {
        size_t at = (size_t)(rng_unit(4, 0, k) * (double)px);
        double sum = 0, want = 0;
        memset(g1, 0, px * 3 * sizeof *g1);
        for (size_t c = 0; c < 3; c++) {
            g1[3 * at + c] = 1;
            want += (double)rgb[3 * at + c] - (double)t[at] * (double)s.o.background[c];
        }
        kit_ok(render_set_color_grad(r, g1, &e), e);
        kit_ok(render_backward(r, &m, grads, &e), e);
        planes_read(&m, grads, &g);
        for (size_t i = 0; i < 3 * s.g.n; i++)
            sum += (0.5 + GAUSS_SH_C0 * (double)s.g.sh[i]) * (double)g.sh[i] / GAUSS_SH_C0;
        if (fabs(sum - want) > LINEAR_REL * fmax(want, 0.1))
            fail_msg("pixel %zu: colours give %.8g, backward took in %.8g", at, want, sum);
        stopped += t[at] <= RENDER_T_STOP;
    }
    assert_true(stopped > 5);
    dev_release(&grads);
    render_model_free(&m);
    render_close(&r);
    gauss_free(&g);
    mem_free(rgb);
    mem_free(t);
    mem_free(g1);
    scene_free(&s);
}

/* ---- Adam ---------------------------------------------------------------------------------------------- */

struct trainer { /* a model with its optimiser; trainer_free */
    struct render *r;
    struct render_model m;
    struct render_adam adam;
    struct render_density_stats stats;
};

static struct trainer trainer_make(const struct gauss *g)
{
    struct trainer t = {.adam = {.lr_mean = 2e-3f, .lr_scale = 5e-3f, .lr_quat = 1e-3f, .lr_opacity = 5e-2f,
                                 .lr_sh_dc = 2.5e-3f, .lr_sh_rest = 1.25e-4f, .beta1 = 0.9f, .beta2 = 0.999f,
                                 .eps = 1e-15f, .scale_log_min = -13.8f, .scale_log_max = 4.5f}};
    struct dev *d = dev_get();
    struct err e = {0};
    kit_ok(render_open(d, &t.r, &e), e);
    kit_ok(render_model_upload(t.r, g, &t.m, &e), e);
    size_t bytes = (size_t)t.m.groups * t.m.planes * 64, lanes = (size_t)t.m.groups * 64;
    cl_mem *const mems[7] = {&t.adam.m1, &t.adam.m2, &t.stats.grad, &t.stats.absg, &t.stats.count, &t.stats.radius,
                             &t.stats.repaired};
    for (size_t i = 0; i < 7; i++) {
        kit_ok(dev_buffer(d, i < 2 ? bytes : lanes, NULL, mems[i], &e), e);
        kit_ok(dev_zero(d, *mems[i], 0, i < 2 ? bytes : lanes, &e), e);
    }
    return t;
}

static void trainer_free(struct trainer *t)
{
    cl_mem *const mems[8] = {&t->adam.m1, &t->adam.m2, &t->stats.grad, &t->stats.absg, &t->stats.count,
                             &t->stats.radius, &t->stats.repaired, &t->adam.extra_grad};
    for (size_t i = 0; i < 8; i++)
        dev_release(mems[i]);
    render_model_free(&t->m);
    render_close(&t->r);
}

static void trainer_step(struct trainer *t, const struct scene *s)
{
    struct err e = {0};
    kernel_forward(t->r, s, &t->m);
    t->adam.step++;
    kit_ok(render_backward_step(t->r, &t->m, &t->adam, &t->stats, &e), e);
}

static uint32_t trainer_repaired(const struct trainer *t)
{
    uint32_t n;
    struct err e = {0};
    kit_ok(dev_read(dev_get(), t->stats.repaired, 0, sizeof n, &n, &e), e);
    return n;
}

static float *floats_read(cl_mem mem, size_t n)
{
    struct err e = {0};
    float *v = mem_array(n, sizeof *v);
    assert_non_null(v);
    kit_ok(dev_read(dev_get(), mem, 0, n * sizeof *v, v, &e), e);
    return v;
}

static double lr_of(const struct render_adam *a, size_t plane)
{
    const float lr[6] = {a->lr_mean, a->lr_scale, a->lr_quat, a->lr_opacity, a->lr_sh_dc, a->lr_sh_rest};
    return (double)lr[plane < 3 ? 0 : plane < 6 ? 1 : plane < 10 ? 2 : plane < 11 ? 3 : plane < 14 ? 4 : 5];
}

/* Adam by the book, over the planes of `used` coefficients. */
static void adam_plain(const struct render_adam *a, const float *grads, size_t groups, size_t planes, size_t used,
                       double *p, double *m1, double *m2)
{
    double b1 = (double)a->beta1, b2 = (double)a->beta2;
    for (size_t i = 0; i < groups * planes * 16; i++) {
        size_t plane = i / 16 % planes;
        double g = (double)grads[i];
        if (plane >= 11 + 3 * used)
            continue;
        m1[i] = b1 * m1[i] + (1 - b1) * g;
        m2[i] = b2 * m2[i] + (1 - b2) * g * g;
        double h1 = m1[i] / (1 - pow(b1, a->step)), h2 = m2[i] / (1 - pow(b2, a->step));
        p[i] -= lr_of(a, plane) * h1 / (sqrt(h2) + (double)a->eps);
        if (plane >= 3 && plane < 6)
            p[i] = fmin(fmax(p[i], (double)a->scale_log_min), (double)a->scale_log_max);
    }
}

/* float Adam against double: a rounding of 1e-7 in p and a few in the moments a step; where |g| is far below
 * what it was, m1 / sqrt(m2) keeps 1e-6. The unfused gradients come from another kernel: 1e-6 again. */
#define ADAM_REL 2e-5
#define ADAM_ABS 2e-6

static void check_adam(bool with_extra, int sh_degree, uint32_t width)
{
    uint32_t own = dev_get()->vector_width;
    struct scene s = scene_make(31, 75, RENDER_AA_2D, 2);
    struct err e = {0};
    struct dev *d = dev_get();
    for (size_t i = 16; i < 36; i++) /* a whole group and more behind the camera */
        for (size_t a = 0; a < 3; a++)
            s.g.mean_m[3 * i + a] -= (float)(9 * s.cam.rot[6 + a]);
    s.o.sh_degree = sh_degree;
    struct trainer t = trainer_make(&s.g);
    size_t words = (size_t)t.m.groups * t.m.planes * 16, used = gauss_sh_count(sh_degree < 0 ? 2 : (uint32_t)sh_degree);
    double *v = mem_array(words, 3 * sizeof *v), *p = v, *m1 = v + words, *m2 = m1 + words;
    float *start = floats_read(t.m.params, words), *raw = mem_array(words, sizeof *raw);
    cl_mem grads;
    assert_true(v && raw);
    for (size_t i = 0; i < words; i++) { /* moments from before, also of the Gaussians that nobody sees */
        p[i] = (double)start[i];
        m1[i] = (double)(float)(1e-3 * rng_normal(1, 1, i));
        raw[i] = (float)m1[i];
    }
    kit_ok(dev_write(d, t.adam.m1, 0, words * sizeof *raw, raw, &e), e);
    for (size_t i = 0; i < words; i++) {
        m2[i] = (double)(float)(1e-6 * (0.1 + rng_unit(1, 2, i)));
        raw[i] = (float)m2[i];
    }
    kit_ok(dev_write(d, t.adam.m2, 0, words * sizeof *raw, raw, &e), e);
    kit_ok(dev_buffer(d, words * sizeof *raw, NULL, &grads, &e), e);
    if (with_extra) {
        for (size_t i = 0; i < (size_t)t.m.groups * 176; i++)
            raw[i] = (float)(0.01 * rng_normal(1, 3, i));
        kit_ok(dev_buffer(d, (size_t)t.m.groups * 176 * sizeof *raw, raw, &t.adam.extra_grad, &e), e);
    }
    for (t.adam.step = 0; t.adam.step < 4;) {
        float *extra = with_extra ? floats_read(t.adam.extra_grad, (size_t)t.m.groups * 176) : NULL;
        kernel_forward(t.r, &s, &t.m);
        d->vector_width = width ? width : own;
        kit_ok(render_backward(t.r, &t.m, grads, &e), e);
        float *g = floats_read(grads, words);
        for (size_t i = 0; extra && i < words; i++)
            if (i / 16 % t.m.planes < 11)
                g[i] += extra[i / 16 / t.m.planes * 176 + i % (16 * t.m.planes)];
        t.adam.step++;
        kit_ok(render_backward_step(t.r, &t.m, &t.adam, &t.stats, &e), e);
        d->vector_width = own;
        adam_plain(&t.adam, g, t.m.groups, t.m.planes, used, p, m1, m2);
        float *const got[3] = {floats_read(t.m.params, words), floats_read(t.adam.m1, words),
                               floats_read(t.adam.m2, words)};
        double *const want[3] = {p, m1, m2};
        static const char *const names[3] = {"parameters", "first moments", "second moments"};
        for (size_t k = 0; k < 3; k++) {
            for (size_t i = 0; i < words; i++) { /* padding lanes are nobody's; then follow the kernel's rounding */
                if (i / 16 / t.m.planes * 16 + i % 16 >= t.m.n)
                    want[k][i] = (double)got[k][i];
            }
            kit_near(names[k], got[k], want[k], words, ADAM_ABS, ADAM_REL);
            for (size_t i = 0; i < words; i++)
                want[k][i] = (double)got[k][i];
            mem_free(got[k]);
        }
        mem_free(g);
        mem_free(extra);
    }
    float *end = floats_read(t.m.params, words);
    size_t moved = 0;
    for (size_t i = 0; i < words; i++) {
        size_t plane = i / 16 % t.m.planes, row = i / 16 / t.m.planes * 16 + i % 16;
        if (plane >= 11 + 3 * used || row >= t.m.n)
            assert_true(end[i] == start[i]);
        else
            moved += end[i] != start[i] && row >= 16 && row < 32;
    }
    assert_true(moved > 100); /* the unseen coast on their momentum */
    assert_int_equal(trainer_repaired(&t), 0);
    mem_free(end);
    mem_free(start);
    mem_free(raw);
    mem_free(v);
    dev_release(&grads);
    trainer_free(&t);
    scene_free(&s);
}

static void test_step_is_adam(void **state)
{
    (void)state;
    check_adam(false, -1, 0);
    check_adam(true, -1, 0);
    check_adam(false, 1, 0);
    check_adam(true, -1, 1); /* as a GPU has it */
}

/* F1: what must never be in a model is repaired, and counted. */
static void test_repairs(void **state)
{
    (void)state;
    struct scene s = scene_make(32, 40, RENDER_AA_2D, 1);
    struct gauss out = {0};
    for (size_t a = 0; a < 4; a++) {
        s.g.quat_wxyz[4 * 3 + a] = 0.0f;
        s.g.quat_wxyz[4 * 7 + a] = a == 2 ? NAN : 0.5f;
        s.g.quat_wxyz[4 * 20 + a] = 1e-30f;
        s.g.quat_wxyz[4 * 21 + a] = a == 0 ? INFINITY : 0.0f;
    }
    struct trainer t = trainer_make(&s.g);
    trainer_step(&t, &s);
    assert_int_equal(trainer_repaired(&t), 4);
    gauss_like(&s.g, &out);
    planes_read(&t.m, t.m.params, &out);
    assert_int_equal(gauss_count_bad(&out, NULL), 0);
    static const size_t rows[] = {3, 7, 20, 21};
    for (size_t i = 0; i < 4; i++)
        assert_true(out.quat_wxyz[4 * rows[i]] == 1.0f && out.quat_wxyz[4 * rows[i] + 3] == 0.0f);
    trainer_step(&t, &s);
    assert_int_equal(trainer_repaired(&t), 4); /* once is enough */
    gauss_free(&out);
    trainer_free(&t);
    scene_free(&s);
}

/* A gradient that is not finite: those Gaussians stay as they are, the others move. */
static void test_dropped_updates(void **state)
{
    (void)state;
    struct scene s = scene_make(33, 48, RENDER_AA_2D, 1);
    s.rgb_grad[3 * (PX_W * 10 + 20)] = (double)NAN;
    s.rgb_grad[3 * (PX_W * 20 + 9) + 1] = (double)INFINITY;
    struct trainer t = trainer_make(&s.g);
    struct gauss out = {0};
    trainer_step(&t, &s);
    gauss_like(&s.g, &out);
    planes_read(&t.m, t.m.params, &out);
    assert_int_equal(gauss_count_bad(&out, NULL), 0);
    size_t kept = 0;
    for (size_t i = 0; i < s.g.n; i++)
        kept += !memcmp(out.mean_m + 3 * i, s.g.mean_m + 3 * i, 12) && out.opacity_logit[i] == s.g.opacity_logit[i];
    uint32_t dropped = trainer_repaired(&t);
    assert_true(dropped > 0 && dropped < s.g.n && dropped <= kept && kept < s.g.n);
    gauss_free(&out);
    trainer_free(&t);
    scene_free(&s);
}

/* F2: anything that Adam and densification can bring about stays finite, forwards and backwards. */
static void test_wild_shapes(void **state)
{
    (void)state;
    const size_t n = 20000;
    struct scene s = scene_make(34, n, RENDER_AA_2D, 0);
    for (size_t i = 0; i < n; i++) {
        for (size_t a = 0; a < 3; a++) {
            s.g.scale_log[3 * i + a] = (float)(-14 + 18 * rng_unit(35, a, i)); /* 1e-6 m to 55 m: ratios to 6e7 */
            s.g.mean_m[3 * i + a] *= (float)exp(3 * rng_normal(35, 9, i));
        }
        s.g.opacity_logit[i] = (float)(8 * rng_normal(35, 4, i));
    }
    struct trainer t = trainer_make(&s.g);
    struct gauss out = {0};
    gauss_like(&s.g, &out);
    for (int k = 0; k < 3; k++) {
        struct err e = {0};
        cl_mem grads;
        kernel_forward(t.r, &s, &t.m);
        float *rgb = floats_read(render_color_buffer(t.r), (size_t)PX_W * PX_H * 3);
        for (size_t i = 0; i < (size_t)PX_W * PX_H * 3; i++)
            assert_true(isfinite(rgb[i]));
        mem_free(rgb);
        kit_ok(dev_buffer(dev_get(), (size_t)t.m.groups * t.m.planes * 64, NULL, &grads, &e), e);
        kit_ok(render_backward(t.r, &t.m, grads, &e), e);
        planes_read(&t.m, grads, &out);
        for (size_t i = 0; i < 4 * n; i++)
            assert_true(isfinite(out.quat_wxyz[i]) && isfinite(out.mean_m[i % (3 * n)]) &&
                        isfinite(out.scale_log[i % (3 * n)]) && isfinite(out.opacity_logit[i % n]));
        dev_release(&grads);
        trainer_step(&t, &s);
        planes_read(&t.m, t.m.params, &out);
        assert_int_equal(gauss_count_bad(&out, NULL), 0);
        for (size_t i = 0; i < 3 * n; i++)
            assert_true(out.scale_log[i] >= t.adam.scale_log_min && out.scale_log[i] <= t.adam.scale_log_max);
    }
    assert_int_equal(trainer_repaired(&t), 0);
    gauss_free(&out);
    trainer_free(&t);
    scene_free(&s);
}

/* ---- densification statistics ---------------------------------------------------------------------------- */

/* Per pixel sum_c g_c C_c of splats as they are given. */
static void composite(const struct scene *s, const struct ref_view *v, const struct ref_splat *splats, size_t n,
                      double *out)
{
    for (size_t at = 0; at < (size_t)PX_W * PX_H; at++) {
        double t = 1, d[2], alpha;
        bool clamped;
        out[at] = 0;
        for (size_t i = 0; i < n && t > (double)RENDER_T_STOP; i++) {
            if (!ref_alpha(&splats[i], (double)(at % PX_W) + 0.5, (double)(at / PX_W) + 0.5, d, &alpha, &clamped))
                continue;
            for (size_t c = 0; c < 3; c++)
                out[at] += splats[i].rgb[c] * alpha * t * s->rgb_grad[3 * at + c];
            t *= 1 - alpha;
        }
        for (size_t c = 0; c < 3; c++)
            out[at] += t * v->background[c] * s->rgb_grad[3 * at + c];
    }
}

/* Moving one splat on the screen by 1e-6 px either way gives its gradient in every pixel. */
#define STAT_STEP 1e-6
#define STAT_REL 1e-4

static void test_density_statistics(void **state)
{
    (void)state;
    struct scene s = scene_make(36, 20, RENDER_AA_2D, 0);
    struct ref_view v;
    struct ref_splat *splats;
    size_t n;
    struct err e = {0};
    double *up = mem_array((size_t)PX_W * PX_H, 2 * sizeof *up), *down = up + (size_t)PX_W * PX_H;
    double want[4][20] = {{0}};
    assert_non_null(up);
    (void)clear_ambiguous(&s);
    kit_ok(ref_view_init(&s.g, &s.cam, &s.o, &v, &e), e);
    kit_ok(ref_project_all(&v, &s.g, &splats, &n, &e), e);
    for (size_t i = 0; i < n; i++) {
        double g[2] = {0}, a[2] = {0};
        for (size_t k = 0; k < 2; k++) {
            double keep = splats[i].mean_px[k];
            splats[i].mean_px[k] = keep + STAT_STEP;
            composite(&s, &v, splats, n, up);
            splats[i].mean_px[k] = keep - STAT_STEP;
            composite(&s, &v, splats, n, down);
            splats[i].mean_px[k] = keep;
            for (size_t at = 0; at < (size_t)PX_W * PX_H; at++) {
                double d = (up[at] - down[at]) / (2 * STAT_STEP);
                g[k] += d;
                a[k] += fabs(d);
            }
        }
        size_t row = splats[i].index;
        want[0][row] = 3 * hypot(PX_W / 2 * g[0], PX_H / 2 * g[1]);
        want[1][row] = 2 * hypot(PX_W / 2 * a[0], PX_H / 2 * a[1]);
        want[2][row] = 3;
        want[3][row] = fmax(splats[i].half_px[0], splats[i].half_px[1]);
    }
    struct trainer t = trainer_make(&s.g);
    t.adam.lr_mean = t.adam.lr_scale = t.adam.lr_quat = t.adam.lr_opacity = t.adam.lr_sh_dc = 0;
    trainer_step(&t, &s);
    trainer_step(&t, &s); /* the same again: sums grow, the radius does not */
    cl_mem absg = t.stats.absg;
    t.stats.absg = NULL; /* and once without moduli */
    trainer_step(&t, &s);
    t.stats.absg = absg;
    const cl_mem mems[4] = {t.stats.grad, t.stats.absg, t.stats.count, t.stats.radius};
    static const char *const names[4] = {"gradient", "absolute gradient", "count", "radius"};
    for (size_t k = 0; k < 4; k++) {
        float *got = floats_read(mems[k], 20);
        kit_near(names[k], got, want[k], 20, STAT_REL * rms(want[k], 20), STAT_REL);
        mem_free(got);
    }
    trainer_free(&t);
    mem_free(splats);
    mem_free(up);
    scene_free(&s);
}

/* ---- same bits, errors ------------------------------------------------------------------------------------ */

/* Parameters, moments and statistics after three steps on a picture of many tiles; `test_backward digest`
 * prints it so that runs with other numbers of worker threads can be compared. */
static void digest(char out[33])
{
    struct scene s = scene_make(41, 600, RENDER_AA_2D, 3);
    s.cam = camera_resize(&s.cam, 170, 130);
    mem_free(s.rgb_grad);
    s.rgb_grad = grad_make((size_t)170 * 130 * 3, 41);
    struct trainer t = trainer_make(&s.g);
    for (int i = 0; i < 3; i++)
        trainer_step(&t, &s);
    size_t words = (size_t)t.m.groups * t.m.planes * 16, lanes = (size_t)t.m.groups * 16;
    const cl_mem mems[6] = {t.m.params, t.adam.m1, t.adam.m2, t.stats.grad, t.stats.absg, t.stats.radius};
    struct buf all = {0};
    for (size_t i = 0; i < 6; i++) {
        float *v = floats_read(mems[i], i < 3 ? words : lanes);
        buf_add(&all, v, (i < 3 ? words : lanes) * sizeof *v);
        mem_free(v);
    }
    assert_false(all.failed);
    hash_text(hash_bytes(all.data, all.size), out);
    buf_free(&all);
    trainer_free(&t);
    scene_free(&s);
}

static const char *self;

static void test_same_bits(void **state)
{
    (void)state;
    char first[33], again[33];
    digest(first);
    digest(again);
    assert_string_equal(first, again);
    for (int threads = 1; threads <= 3; threads++) {
        struct buf out = {0};
        if (kit_run(&out, "POCL_MAX_PTHREAD_COUNT=%d %s digest", threads, self) != 0 ||
            !strstr((char *)out.data, first))
            fail_msg("%d threads: got %s, want %s", threads, out.data ? (char *)out.data : "nothing", first);
        buf_free(&out);
    }
}

static void test_errors(void **state)
{
    (void)state;
    struct scene s = scene_make(50, 4, RENDER_AA_NONE, 0);
    struct trainer t = trainer_make(&s.g);
    struct render_model other = t.m;
    struct err e = {0};
    float g[3] = {0};
    kit_fails(render_set_color_grad(t.r, g, &e), ERR_ARG, e, "no frame");
    assert_null(render_color_grad_buffer(t.r));
    t.adam.step = 1;
    kit_fails(render_backward_step(t.r, &t.m, &t.adam, NULL, &e), ERR_ARG, e, "no frame");
    kit_ok(render_forward(t.r, &t.m, &s.cam, &s.o, NULL, NULL, &e), e);
    kit_fails(render_backward_step(t.r, &t.m, &t.adam, NULL, &e), ERR_ARG, e, "not given");
    kernel_forward(t.r, &s, &t.m);
    t.adam.step = 0;
    kit_fails(render_backward_step(t.r, &t.m, &t.adam, NULL, &e), ERR_ARG, e, "counts from 1");
    t.adam.step = 1;
    t.adam.beta2 = 1;
    kit_fails(render_backward_step(t.r, &t.m, &t.adam, NULL, &e), ERR_ARG, e, "betas");
    t.adam.beta2 = 0.999f;
    other.n = 3;
    kit_fails(render_backward_step(t.r, &other, &t.adam, NULL, &e), ERR_ARG, e, "others");
    kit_ok(render_backward_step(t.r, &t.m, &t.adam, NULL, &e), e);
    kit_fails(render_backward_step(t.r, &t.m, &t.adam, NULL, &e), ERR_ARG, e, "no frame");
    trainer_free(&t);
    scene_free(&s);
}

/* Nothing to see is a picture too. */
static void test_empty(void **state)
{
    (void)state;
    struct scene s = scene_make(51, 3, RENDER_AA_2D, 1);
    struct gauss before = {0}, after = {0};
    for (size_t i = 0; i < s.g.n; i++)
        for (size_t a = 0; a < 3; a++)
            s.g.mean_m[3 * i + a] = (float)(-9 * s.cam.rot[6 + a]);
    struct trainer t = trainer_make(&s.g);
    gauss_like(&s.g, &before);
    gauss_like(&s.g, &after);
    trainer_step(&t, &s);
    planes_read(&t.m, t.m.params, &after);
    assert_memory_equal(after.mean_m, s.g.mean_m, 3 * s.g.n * sizeof(float));
    assert_int_equal(trainer_repaired(&t), 0);
    trainer_free(&t);
    gauss_free(&before);
    gauss_free(&after);
    scene_free(&s);
}

int main(int argc, char **argv)
{
    if (argc > 1 && !strcmp(argv[1], "digest")) {
        char text[33];
        digest(text);
        puts(text);
        dev_close(dev_get());
        return 0;
    }
    self = argv[0];
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_ref_all_parameters), cmocka_unit_test(test_ref_saturated),
        cmocka_unit_test(test_ref_outside),        cmocka_unit_test(test_ref_needles),
        cmocka_unit_test(test_ref_untouched),      cmocka_unit_test(test_kernels_match_reference),
        cmocka_unit_test(test_narrow_kernels_match_reference), cmocka_unit_test(test_same_decisions),     cmocka_unit_test(test_step_is_adam),
        cmocka_unit_test(test_repairs),            cmocka_unit_test(test_dropped_updates),
        cmocka_unit_test(test_wild_shapes),        cmocka_unit_test(test_density_statistics),
        cmocka_unit_test(test_same_bits),          cmocka_unit_test(test_errors),
        cmocka_unit_test(test_empty),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    dev_close(dev_get());
    return failed;
}
