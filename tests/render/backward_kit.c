/* See backward_kit.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/render/backward_kit.h"

#include <math.h>
#include <string.h>

#include "render/render_ref.h"

/* A pixel within this of a threshold (alpha at 1/255 or its maximum, T at the stop) may fall on
 * either side in float: its dL/dcolour is set to 0 so that the comparison does not depend on it. */
#define THRESHOLD_REL 2e-4
/* Known depths are so many footprints away from where slopes of sums about them jump. */
#define KINK_PX 0.1

/* ---- scenes ---- */

static struct camera scene_camera(void)
{
    /* Off-centre principal point: the clamp of the Jacobian differs on every side. */
    struct camera c = {.width_px = PX_W,
                       .height_px = PX_H,
                       .fx_px = 45,
                       .fy_px = 41,
                       .cx_px = 18.3,
                       .cy_px = 17.1};
    const double quat[4] = {0.83, 0.31, -0.4, 0.2};
    camera_quat_to_rot(quat, c.rot);
    for (int i = 0; i < 3; i++) /* looks at the origin from 3 m */
        c.trans[i] = i == 2 ? 3.0 : 0.05 * i;
    return c;
}

/* Steps of the differences are powers of two: with parameters on a grid of 2^-16 every step is
 * exact. */
static float on_grid(double v)
{
    return (float)(round(v * 65536) / 65536);
}

double *grad_make(size_t n, uint64_t seed)
{
    double *g = mem_array(n, sizeof *g);
    assert_non_null(g);
    for (size_t i = 0; i < n; i++)
        g[i] = (double)(float)rng_normal(seed, 77, i);
    return g;
}

struct view_case view_case_make(uint64_t seed, size_t n, enum render_aa aa, uint32_t degree)
{
    struct view_case s = {.cam = scene_camera(),
                          .o = {.aa = aa, .background = {0.2f, 0.5f, 0.9f}, .sh_degree = -1}};
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

void view_case_split_background(struct view_case *s)
{
    static uint8_t where[PX_H * PX_W];
    for (size_t i = 0; i < sizeof where; i++)
        where[i] = i / PX_W > PX_H / 4 && i % PX_W > PX_W / 4 && i % PX_W < 3 * PX_W / 4 ? 7 : 0;
    s->o.background_where = where;
    for (size_t c = 0; c < 3; c++)
        s->o.background_there[c] = 0.9f - 0.4f * (float)c;
}

void view_case_moments(struct view_case *s)
{
    s->o.depth_unit_m = 2.5; /* centres are 2 to 4 m away */
    s->moments_grad = grad_make((size_t)s->cam.width_px * s->cam.height_px * 3, 99);
}

void view_case_known(struct view_case *s)
{
    static float known[PX_H * PX_W];
    struct ref_view v;
    struct ref_splat *splats;
    size_t n, n_known = 0;
    struct err e = {0};
    view_case_moments(s);
    s->o.known = known;
    s->o.known_zeta = 1.1;
    kit_ok(ref_view_init(&s->g, &s->cam, &s->o, &v, &e), e);
    kit_ok(ref_project_all(&v, &s->g, &splats, &n, &e), e);
    for (size_t at = 0; at < sizeof known / sizeof *known; at++) {
        bool clear = false;
        for (uint64_t try = 0; !clear && try < 9 && at % 5; try++) {
            known[at] = (float)(s->o.known_zeta / (0.8 + 0.8 * rng_unit(98, try, at)));
            clear = true;
            for (size_t i = 0; clear && i < n; i++) {
                double d[2], alpha, px;
                bool clamped;
                if (!ref_alpha(&splats[i], (double)(at % PX_W) + 0.5, (double)(at / PX_W) + 0.5, d,
                               &alpha, &clamped))
                    continue;
                px = ref_behind_px(&v, at, ref_depth(&splats[i], d));
                clear = fabs(px) > KINK_PX && fabs(fabs(px) - (double)LAYOUT_AWAY_PX) > KINK_PX;
            }
        }
        known[at] = clear ? known[at] : -1.0f;
        n_known += clear;
    }
    assert_true(n_known > PX_H * PX_W / 3);
    mem_free(splats);
}

void view_case_free(struct view_case *s)
{
    mem_free(s->moments_grad);
    gauss_free(&s->g);
    mem_free(s->rgb_grad);
}

/* Opaque splats behind one another: alpha at its maximum, and pixels that stop before the last
 * splat. */
struct view_case view_case_saturated(enum render_aa aa)
{
    struct view_case s = view_case_make(7, 12, aa, 0);
    for (size_t i = 0; i < s.g.n; i++) {
        s.g.opacity_logit[i] = on_grid(i % 3 ? 7.0 : 1.0);
        for (size_t a = 0; a < 3; a++) {
            s.g.scale_log[3 * i + a] = on_grid(-0.7 - 0.1 * (double)a - 0.02 * (double)i);
            s.g.mean_m[3 * i + a] = on_grid((double)s.g.mean_m[3 * i + a] * 0.25);
        }
    }
    return s;
}

/* Large splats whose centres lie outside the picture on every side, beyond the clamp of the
 * Jacobian. */
struct view_case view_case_outside(enum render_aa aa)
{
    struct view_case s = view_case_make(8, 8, aa, 1);
    for (size_t i = 0; i < s.g.n; i++) {
        static const double side[8][2] = {{-1, 0},  {1, 0}, {0, -1},   {0, 1},
                                          {-1, -1}, {1, 1}, {0.9, -1}, {0.1, 0.2}};
        const double cam[3] = {side[i][0] * 1.7 - s.cam.trans[0], side[i][1] * 1.5 - s.cam.trans[1],
                               2.4 - s.cam.trans[2] + 0.05 * (double)i};
        for (size_t a = 0; a < 3; a++) { /* back to the world: R^T */
            s.g.mean_m[3 * i + a] = on_grid(s.cam.rot[a] * cam[0] + s.cam.rot[3 + a] * cam[1] +
                                            s.cam.rot[6 + a] * cam[2]);
            s.g.scale_log[3 * i + a] = on_grid(-0.7 + 0.2 * (double)a);
        }
        s.g.opacity_logit[i] = 0.5f;
    }
    return s;
}

/* Needles and discs: axes from 0.4 m down to 0.1 mm. */
struct view_case view_case_needles(enum render_aa aa)
{
    struct view_case s = view_case_make(9, 8, aa, 0);
    for (size_t i = 0; i < s.g.n; i++) {
        s.g.scale_log[3 * i] = on_grid(-1.0);
        s.g.scale_log[3 * i + 1] = on_grid(i % 2 ? -1.1 : -6.0);
        s.g.scale_log[3 * i + 2] = on_grid(-4.0 - (double)(i % 4));
        s.g.opacity_logit[i] = 3.0f;
    }
    return s;
}

/* ---- differences ---- */

/* The signs of the hidden units, and what was cut. */
static void look_decisions(const struct ref_view *v, const struct gauss *g,
                           const struct ref_splat *p, struct buf *out)
{
    double unit[GAUSS_EMBED_MAX], hidden[APPEARANCE_HIDDEN_MAX], y[APPEARANCE_OUT];
    (void)ref_appearance(v, g, p->index, unit, hidden, y);
    for (size_t h = 0; h < v->hidden; h++)
        buf_u8(out, hidden[h] > 0);
    buf_u8(out, (unsigned)((p->rgb_raw[0] < 1) | (p->rgb_raw[1] < 1) << 1 |
                           (p->rgb_raw[2] < 1) << 2 | (p->opacity_raw + y[3] < 1) << 3));
}

double view_case_objective(const struct view_case *s, const double *rgb_of, uint64_t *signature)
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
        if (v.frame) {
            look_decisions(&v, &s->g, p, &decisions);
            sum += s->offset_weight * p->y[LAYOUT_APPEARANCE_OPACITY] / (double)n;
        }
    }
    for (size_t at = 0; at < (size_t)PX_W * PX_H; at++) {
        double t = 1, d[2], alpha;
        bool clamped;
        for (size_t i = 0; i < n && t > (double)LAYOUT_TRANSMITTANCE_MIN; i++) {
            if (!ref_alpha(&splats[i], (double)(at % PX_W) + 0.5, (double)(at / PX_W) + 0.5, d,
                           &alpha, &clamped))
                continue;
            buf_u32(&decisions, (uint32_t)(2 * i + clamped));
            for (size_t c = 0; c < 3; c++)
                sum += splats[i].rgb[c] * alpha * t * s->rgb_grad[3 * at + c];
            double m = ref_depth(&splats[i], d), behind_px = ref_behind_px(&v, at, m);
            struct ref_ray ray = ref_ray(&v, at, m);
            for (size_t c = 0; s->moments_grad && c < 2; c++)
                sum += ray.value[c] * alpha * t * s->moments_grad[3 * at + c];
            buf_u8(&decisions, (unsigned)(behind_px > 0) +
                                   (unsigned)(behind_px > -(double)LAYOUT_AWAY_PX) +
                                   (unsigned)(behind_px > (double)LAYOUT_AWAY_PX));
            t *= 1 - alpha;
        }
        if (s->moments_grad)
            sum += t * s->moments_grad[3 * at + 2];
        buf_u32(&decisions, ~0u);
        for (size_t c = 0; c < 3; c++)
            sum += t * ref_background(&v, at)[c] * s->rgb_grad[3 * at + c];
    }
    *signature = hash_bytes(decisions.data, decisions.size).lo;
    buf_free(&decisions);
    mem_free(splats);
    return sum;
}

bool view_case_differentiate(struct view_case *s, float *p, const double *rgb_of, double *out)
{
    uint64_t here, sig[4];
    const float keep = *p;
    (void)view_case_objective(s, rgb_of, &here);
    for (double h = ldexp(1, -12); h >= ldexp(1, -15); h /= 2) {
        double f[4];
        bool same = true;
        for (int k = 0; k < 4 && same; k++) {
            static const double at[4] = {-2, -1, 1, 2};
            *p = (float)((double)keep + at[k] * h);
            assert_true((double)*p - (double)keep == at[k] * h);
            f[k] = view_case_objective(s, rgb_of, &sig[k]);
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

double *view_case_colors(const struct view_case *s)
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

/* ---- reference ---- */

struct grads grads_make(const struct gauss *g)
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
    o.r = (struct render_ref_grads){.mean = o.part[0],
                                    .scale_log = o.part[1],
                                    .quat_wxyz = o.part[2],
                                    .opacity_logit = o.part[3],
                                    .sh = o.part[4]};
    return o;
}

const char *const backward_part[5] = {"mean", "scale_log", "quat_wxyz", "opacity_logit", "sh"};

double rms(const double *v, size_t n)
{
    double sum = 0;
    for (size_t i = 0; i < n; i++)
        sum += v[i] * v[i];
    return sqrt(sum / (double)(n ? n : 1));
}

/* ---- device ---- */

struct dev *dev_get(void)
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
double clear_ambiguous(struct view_case *s)
{
    struct ref_view v;
    struct ref_splat *splats;
    size_t n, px = (size_t)s->cam.width_px * s->cam.height_px, left = 0;
    struct err e = {0};
    kit_ok(ref_view_init(&s->g, &s->cam, &s->o, &v, &e), e);
    kit_ok(ref_project_all(&v, &s->g, &splats, &n, &e), e);
    for (size_t at = 0; at < px; at++) {
        double t = 1, x = (double)(at % s->cam.width_px) + 0.5,
               y = (double)(at / s->cam.width_px) + 0.5;
        bool sure = true;
        for (size_t i = 0; i < n && t > (double)LAYOUT_TRANSMITTANCE_MIN; i++) {
            const struct ref_splat *p = &splats[i];
            double dx = p->mean_px[0] - x, dy = p->mean_px[1] - y;
            double sigma =
                0.5 * (p->conic[0] * dx * dx + p->conic[2] * dy * dy) + p->conic[1] * dx * dy;
            double a = p->opacity_eff * exp(-sigma);
            sure = sure && !near(a, 1 / 255.0) && !near(a, (double)LAYOUT_ALPHA_MAX);
            if (a < 1 / 255.0)
                continue;
            t *= 1 - fmin(a, (double)LAYOUT_ALPHA_MAX);
            sure = sure && !near(t, (double)LAYOUT_TRANSMITTANCE_MIN);
        }
        for (size_t c = 0; c < 3 && !sure; c++) {
            s->rgb_grad[3 * at + c] = 0;
            if (s->moments_grad)
                s->moments_grad[3 * at + c] = 0;
        }
        left += sure;
    }
    mem_free(splats);
    return (double)left / (double)px;
}

/* Forward and set dL/dcolour; the model stays for the caller. */
void kernel_forward(struct render *r, const struct view_case *s, struct render_model *m)
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
    for (size_t i = 0; s->moments_grad && i < n; i++)
        g[i % 3 * (n / 3) + i / 3] = (float)s->moments_grad[i];
    if (s->moments_grad)
        kit_ok(dev_write(dev_get(), render_moments_grad_buffer(r), 0, n * sizeof *g, g, &e), e);
    mem_free(g);
}

/* A buffer in the layout of the parameters, as arrays in the layout of gauss. */
void planes_read(const struct render_model *m, cl_mem mem, struct gauss *out)
{
    struct err e = {0};
    size_t k = 3 * gauss_sh_count(m->sh_degree), words = (size_t)m->groups * m->planes * 16;
    float *raw = mem_array(words, sizeof *raw);
    assert_non_null(raw);
    kit_ok(dev_read(dev_get(), mem, 0, words * sizeof *raw, raw, &e), e);
    for (size_t i = 0; i < m->n; i++) {
        const float *p = raw + i / 16 * m->planes * 16 + i % 16;
        for (size_t a = 0; a < 3; a++) {
            out->mean_m[3 * i + a] = p[16 * (LAYOUT_PLANE_MEAN + a)];
            out->scale_log[3 * i + a] = p[16 * (LAYOUT_PLANE_SCALE + a)];
        }
        for (size_t a = 0; a < 4; a++)
            out->quat_wxyz[4 * i + a] = p[16 * (LAYOUT_PLANE_QUAT + a)];
        out->opacity_logit[i] = p[16 * LAYOUT_PLANE_OPACITY];
        for (size_t a = 0; a < k; a++)
            out->sh[k * i + a] = p[16 * (LAYOUT_PLANE_SH + a)];
    }
    mem_free(raw);
}

void gauss_like(const struct gauss *g, struct gauss *out)
{
    struct err e = {0};
    kit_ok(gauss_alloc(out, g->n, g->sh_degree, 0, &e), e);
    out->n = g->n;
}

float *part_of(struct gauss *g, size_t part)
{
    float *const parts[5] = {g->mean_m, g->scale_log, g->quat_wxyz, g->opacity_logit, g->sh};
    return parts[part];
}

/* ---- training ---- */

struct trainer trainer_make(const struct gauss *g)
{
    struct trainer t = {.adam = {.lr_mean = 2e-3f,
                                 .lr_scale = 5e-3f,
                                 .lr_quat = 1e-3f,
                                 .lr_opacity = 5e-2f,
                                 .lr_sh_dc = 2.5e-3f,
                                 .lr_sh_rest = 1.25e-4f,
                                 .beta1 = 0.9f,
                                 .beta2 = 0.999f,
                                 .eps = 1e-15f,
                                 .scale_log_min = -13.8f,
                                 .scale_log_max = 4.5f}};
    struct dev *d = dev_get();
    struct err e = {0};
    kit_ok(render_open(d, &t.r, &e), e);
    kit_ok(render_model_upload(t.r, g, &t.m, &e), e);
    size_t bytes = (size_t)t.m.groups * t.m.planes * 64, lanes = (size_t)t.m.groups * 64;
    cl_mem *const mems[6] = {&t.adam.moments, &t.stats.grad,   &t.stats.absg,
                             &t.stats.count,  &t.stats.radius, &t.stats.repaired};
    for (size_t i = 0; i < 6; i++) {
        kit_ok(dev_buffer(d, i < 1 ? bytes : lanes, NULL, mems[i], &e), e);
        kit_ok(dev_zero(d, *mems[i], 0, i < 1 ? bytes : lanes, &e), e);
    }
    return t;
}

void trainer_free(struct trainer *t)
{
    cl_mem *const mems[7] = {&t->adam.moments,   &t->stats.grad,   &t->stats.absg,
                             &t->stats.count,    &t->stats.radius, &t->stats.repaired,
                             &t->adam.extra_grad};
    for (size_t i = 0; i < 7; i++)
        dev_release(mems[i]);
    render_model_free(&t->m);
    render_close(&t->r);
}

void trainer_step(struct trainer *t, const struct view_case *s)
{
    struct err e = {0};
    kernel_forward(t->r, s, &t->m);
    t->adam.step++;
    kit_ok(render_backward_step(t->r, &t->m, &t->adam, &t->stats, &e), e);
}

uint32_t trainer_repaired(const struct trainer *t)
{
    uint32_t n;
    struct err e = {0};
    kit_ok(dev_read(dev_get(), t->stats.repaired, 0, sizeof n, &n, &e), e);
    return n;
}

float *floats_read(cl_mem mem, size_t n)
{
    struct err e = {0};
    float *v = mem_array(n, sizeof *v);
    assert_non_null(v);
    kit_ok(dev_read(dev_get(), mem, 0, n * sizeof *v, v, &e), e);
    return v;
}

/* ---- moments ---- */

static float float_of(uint32_t bits)
{
    float x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

static uint32_t bits_of(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

void moments_split(const void *words, size_t n, float *out)
{
    const uint32_t *w = words;
    for (size_t i = 0; i < n; i++) {
        out[i] = float_of(w[i] & 0xffff0000u);
        out[n + i] = float_of(w[i] << 16);
    }
}

float *moments_read(cl_mem mem, size_t n)
{
    struct err e = {0};
    uint32_t *words = mem_array(n, sizeof *words);
    float *v = mem_array(n, 2 * sizeof *v);
    assert_true(words && v);
    kit_ok(dev_read(dev_get(), mem, 0, n * sizeof *words, words, &e), e);
    moments_split(words, n, v);
    mem_free(words);
    return v;
}

void moments_write(cl_mem mem, const float *first, const float *second, size_t n)
{
    struct err e = {0};
    uint32_t *words = mem_array(n, sizeof *words);
    assert_non_null(words);
    for (size_t i = 0; i < n; i++)
        words[i] = (bits_of(first[i]) & 0xffff0000u) | bits_of(second[i]) >> 16;
    kit_ok(dev_write(dev_get(), mem, 0, n * sizeof *words, words, &e), e);
    mem_free(words);
}

/* The distance of the neighbours of x that 16 bits hold: eight bits of a number are kept. */
static double moment_step(double x)
{
    int exponent;
    (void)frexp(fmax(fabs(x), 0x1p-126), &exponent);
    return ldexp(1.0, exponent - 8);
}

bool moment_rounds(struct moment_rounding *r, float got, double want, double tolerance)
{
    const double step = moment_step(want), x = fabs(want) / step, rel = tolerance / step,
                 over = x - floor(x), is = fabs((double)got) / step;
    if ((signbit(got) != 0) != (want < 0.0) && fabs((double)got) > tolerance)
        return false;
    if (is < floor(x - rel) || is > floor(x + rel) + 1.0)
        return false;
    if (is > 0.0 && rel < 0.01) {
        const size_t at = (size_t)(over * MOMENT_STRATA);
        r->n[at]++;
        r->over[at] += over;
        r->up[at] += is > floor(x) + 0.5;
    }
    return true;
}

void moment_rounding_check(const struct moment_rounding *r, size_t least)
{
    for (size_t i = 0; i < MOMENT_STRATA; i++) {
        const double n = (double)r->n[i], share = r->over[i] / n;
        if (r->n[i] < least ||
            fabs(r->up[i] / n - share) > 5.0 * sqrt((share * (1.0 - share) + 1.0 / n) / n))
            fail_msg("of %zu numbers %.3f of a step above a neighbour, %.3f were rounded up",
                     r->n[i], share, r->up[i] / n);
    }
}
