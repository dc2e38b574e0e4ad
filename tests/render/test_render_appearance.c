/* Appearance in the renderer: the double reference against finite differences, the kernels in both
 * shapes against the reference, embeddings under Adam, sums that do not depend on threads, errors.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/splat/appearance.h"
#include "render/frame.h"
#include "render/render_ref.h"
#include "tests/render/backward_kit.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define FD_REL 1e-6     /* as in test_backward_ref.c */
#define FD_ABS 1e-6     /* of the rms of the same kind */
#define KERNEL_REL 2e-3 /* as in test_backward.c */
#define KERNEL_L2 3e-5
#define PICTURE_TOL 2e-5 /* where no pixel is near a threshold */

enum { LEN = 16, HIDDEN = 32 };

struct look { /* look_free */
    struct view_case s;
    struct appearance a;
    float *frame;
    size_t floats;
};

/* A seeded scene with embeddings; colours and opacities go to both ends of their range, weights are
 * on the grid of view_case_make. */
static struct look look_make(uint64_t seed, size_t n, uint32_t len, uint32_t hidden, int degree)
{
    struct look l = {.s = view_case_make(seed, n, RENDER_AA_2D, (uint32_t)degree)};
    struct gauss plain = l.s.g;
    struct err e = {0};
    kit_ok(gauss_alloc(&l.s.g, n, plain.sh_degree, len, &e), e);
    kit_ok(gauss_append(&l.s.g, &plain, NULL, n, &e), e);
    memcpy(l.s.g.origin_enu_m, plain.origin_enu_m, sizeof plain.origin_enu_m);
    for (size_t i = 0; i < n * len; i++)
        l.s.g.embed[i] = (float)(round(rng_normal(seed, 90, i) * 4096) / 4096);
    gauss_free(&plain);
    kit_ok(appearance_alloc(&l.a, len, 8, hidden, 1, &e), e);
    appearance_init(&l.a, seed);
    for (size_t i = 0; i < 4 * hidden; i++)
        l.a.w2[i] *= 3; /* offsets that show */
    l.a.b2[3] = -1.5f;
    l.floats = appearance_frame_floats(len, hidden);
    l.frame = mem_array(l.floats, sizeof *l.frame);
    assert_non_null(l.frame);
    appearance_frame(&l.a, l.a.images, l.frame);
    for (size_t i = 0; i < l.floats; i++)
        l.frame[i] = (float)(round((double)l.frame[i] * 65536) / 65536);
    l.s.o.appearance_frame = l.frame;
    l.s.o.appearance_hidden = hidden;
    l.s.offset_weight = 3.0;
    return l;
}

static void look_free(struct look *l)
{
    mem_free(l->frame);
    appearance_free(&l->a);
    view_case_free(&l->s);
}

/* How often colours were cut at 0 and at 1, and opacities at 1, among the visible. */
static void look_count(const struct look *l, size_t cut[3])
{
    struct ref_view v;
    struct ref_splat p;
    struct err e = {0};
    memset(cut, 0, 3 * sizeof *cut);
    kit_ok(ref_view_init(&l->s.g, &l->s.cam, &l->s.o, &v, &e), e);
    for (size_t i = 0; i < l->s.g.n; i++)
        if (ref_project(&v, &l->s.g, i, &p)) {
            for (int c = 0; c < 3; c++) {
                cut[0] += p.rgb_raw[c] <= 0;
                cut[1] += p.rgb_raw[c] >= 1;
            }
            cut[2] += p.opacity_raw + p.y[LAYOUT_APPEARANCE_OPACITY] >= 1;
        }
}

struct look_grads { /* mem_free(block) */
    double *block, *embed, *frame;
    struct grads g; /* mem_free(g.block) */
};

static struct look_grads reference(const struct look *l)
{
    struct look_grads o = {.g = grads_make(&l->s.g)};
    size_t embed = l->s.g.n * l->s.g.embed_len;
    struct err e = {0};
    o.block = mem_array(embed + l->floats, sizeof *o.block);
    assert_non_null(o.block);
    o.g.r.embed = o.embed = o.block;
    o.g.r.frame = o.frame = o.block + embed;
    o.g.r.offset_weight = l->s.offset_weight;
    kit_ok(render_ref_backward(&l->s.g, &l->s.cam, &l->s.o, l->s.rgb_grad, &o.g.r, &e), e);
    return o;
}

/* ---- the reference ---- */

static void differences(struct look *l, const char *what, float *p, const double *want, size_t n)
{
    double *fd = mem_array(n, sizeof *fd);
    size_t skipped = 0;
    assert_non_null(fd);
    for (size_t i = 0; i < n; i++)
        if (!view_case_differentiate(&l->s, &p[i], NULL, &fd[i])) {
            fd[i] = want[i];
            skipped++;
        }
    kit_near_d(what, want, fd, n, FD_ABS * rms(fd, n), FD_REL);
    if (skipped * 4 > n)
        fail_msg("%s: %zu of %zu could not be differentiated", what, skipped, n);
    mem_free(fd);
}

static void test_reference(void **state)
{
    static const struct {
        uint32_t len, hidden;
        int degree;
    } cases[] = {{3, 5, 0}, {8, 4, 1}};
    for (size_t i = 0; i < 2; i++) {
        struct look l = look_make(70 + i, 7, cases[i].len, cases[i].hidden, cases[i].degree);
        struct look_grads want = reference(&l);
        size_t cut[3], w1 = (size_t)cases[i].len * cases[i].hidden, h = cases[i].hidden;
        look_count(&l, cut);
        assert_true(cut[0] && cut[1] && cut[2]);
        differences(&l, "embedding", l.s.g.embed, want.embed, l.s.g.n * cases[i].len);
        differences(&l, "W1", l.frame, want.frame, w1);
        differences(&l, "bias", l.frame + w1, want.frame + w1, h);
        differences(&l, "W2", l.frame + w1 + h, want.frame + w1 + h, 4 * h);
        differences(&l, "b2", l.frame + w1 + 5 * h, want.frame + w1 + 5 * h, 4);
        differences(&l, "opacity", l.s.g.opacity_logit, want.g.part[3], want.g.count[3]);
        differences(&l, "SH", l.s.g.sh, want.g.part[4], want.g.count[4]);
        differences(&l, "scale", l.s.g.scale_log, want.g.part[1], want.g.count[1]);
        mem_free(want.block);
        mem_free(want.g.block);
        look_free(&l);
    }
}

/* The reference's network is the host's. */
static void test_same_network(void **state)
{
    struct look l = look_make(80, 30, LEN, HIDDEN, 0);
    struct ref_view v;
    struct err e = {0};
    appearance_frame(&l.a, l.a.images, l.frame);
    kit_ok(ref_view_init(&l.s.g, &l.s.cam, &l.s.o, &v, &e), e);
    for (size_t i = 0; i < l.s.g.n; i++) {
        double unit[GAUSS_EMBED_MAX], hidden[APPEARANCE_HIDDEN_MAX], got[4], want[4];
        (void)ref_appearance(&v, &l.s.g, i, unit, hidden, got);
        appearance_eval(&l.a, l.s.g.embed + LEN * i, l.a.images, want);
        kit_near_d("y", got, want, 4, 1e-6, 0); /* the frame's bias is rounded to float */
    }
    look_free(&l);
}

/* ---- kernels ---- */

/* The embedding's planes. */
static float *embed_read(const struct render_model *m, cl_mem mem)
{
    size_t first = layout_planes(m->sh_degree, 0), len = m->embed_len;
    float *raw = floats_read(mem, (size_t)m->groups * m->planes * 16),
          *out = mem_array(m->n, len * sizeof *out);
    assert_non_null(out);
    for (size_t i = 0; i < m->n; i++)
        for (size_t k = 0; k < len; k++)
            out[i * len + k] = raw[(i / 16 * m->planes + first + k) * 16 + i % 16];
    mem_free(raw);
    return out;
}

static void near_part(const char *what, const char *part, const float *got, const double *want,
                      size_t n)
{
    char name[96];
    double err2 = 0, ref2 = 0;
    snprintf(name, sizeof name, "%s: %s", what, part);
    kit_near(name, got, want, n, KERNEL_REL * rms(want, n), KERNEL_REL);
    for (size_t i = 0; i < n; i++) {
        err2 += ((double)got[i] - want[i]) * ((double)got[i] - want[i]);
        ref2 += want[i] * want[i];
    }
    if (getenv("CITYSPLAT_TEST_VERBOSE"))
        print_message("%s: relative L2 %.2g\n", name, sqrt(err2 / ref2));
    if (!(sqrt(err2) <= KERNEL_L2 * sqrt(ref2)))
        fail_msg("%s: relative L2 error %g > %g", name, sqrt(err2 / ref2), KERNEL_L2);
}

static void check_picture(struct render *r, const struct look *l)
{
    size_t px = (size_t)PX_W * PX_H, off = 0;
    float *got = floats_read(render_color_buffer(r), 3 * px);
    double *want = mem_array(3 * px, sizeof *want);
    struct err e = {0};
    assert_non_null(want);
    kit_ok(render_ref_forward(&l->s.g, &l->s.cam, &l->s.o, want, NULL, &e), e);
    for (size_t i = 0; i < 3 * px; i++)
        off += fabs((double)got[i % 3 * px + i / 3] - want[i]) > PICTURE_TOL;
    if (off * 200 > 3 * px) /* a splat at the cut-off of 1/255, as in test_render.c */
        fail_msg("%zu of %zu values of the picture are off", off, 3 * px);
    mem_free(got);
    mem_free(want);
}

/* Forward, and every gradient, by kernels of this vector width (0: the device's own). */
static void check_kernels(const char *what, struct look *l, uint32_t width)
{
    struct dev *d = dev_get();
    uint32_t own = d->vector_width;
    struct render *r;
    struct render_model m = {0};
    struct err e = {0};
    struct gauss got = {0};
    cl_mem grads;
    double sure = clear_ambiguous(&l->s);
    if (sure < 0.5)
        fail_msg("%s: only %.2f of the pixels are away from every threshold", what, sure);
    struct look_grads want = reference(l);
    float *frame = mem_array(l->floats, sizeof *frame);
    struct render_appearance_grad a = {.frame = frame, .offset_weight = (float)l->s.offset_weight};
    assert_non_null(frame);
    d->vector_width = width ? width : own;
    kit_ok(render_open(d, &r, &e), e);
    kernel_forward(r, &l->s, &m);
    size_t bytes = (size_t)m.groups * m.planes * 64;
    float *junk = mem_array(bytes, 1);
    assert_non_null(junk);
    memset(junk, 0xFF, bytes); /* NaN: every plane must be written */
    kit_ok(dev_buffer(d, bytes, junk, &grads, &e), e);
    check_picture(r, l);
    kit_ok(render_backward_appearance(r, &m, grads, &a, &e), e);
    d->vector_width = own;
    gauss_like(&l->s.g, &got);
    planes_read(&m, grads, &got);
    for (size_t k = 0; k < 5; k++)
        near_part(what, backward_part[k], part_of(&got, k), want.g.part[k], want.g.count[k]);
    float *embed = embed_read(&m, grads);
    near_part(what, "embedding", embed, want.embed, m.n * m.embed_len);
    size_t w1 = (size_t)m.embed_len * l->s.o.appearance_hidden, h = l->s.o.appearance_hidden;
    near_part(what, "W1", frame, want.frame, w1);
    near_part(what, "bias", frame + w1, want.frame + w1, h);
    near_part(what, "W2", frame + w1 + h, want.frame + w1 + h, 4 * h);
    near_part(what, "b2", frame + w1 + 5 * h, want.frame + w1 + 5 * h, 4);
    /* what came with them */
    struct ref_view v;
    struct ref_splat *splats;
    size_t n;
    double mean = 0;
    kit_ok(ref_view_init(&l->s.g, &l->s.cam, &l->s.o, &v, &e), e);
    kit_ok(ref_project_all(&v, &l->s.g, &splats, &n, &e), e);
    for (size_t i = 0; i < n; i++)
        mean += splats[i].y[LAYOUT_APPEARANCE_OPACITY] / (double)n;
    if (l->s.offset_weight > 0) {
        assert_int_equal(a.visible, n);
        kit_near_d("mean offset", &a.offset_mean, &mean, 1, 1e-6, 1e-5);
    }
    assert_true(a.visible <= n && a.visible * 50 >= n * 49);
    mem_free(splats);
    mem_free(embed);
    mem_free(junk);
    mem_free(frame);
    dev_release(&grads);
    gauss_free(&got);
    render_model_free(&m);
    render_close(&r);
    mem_free(want.block);
    mem_free(want.g.block);
}

static void test_kernels(void **state)
{
    static const struct {
        uint32_t len, hidden, n;
        int degree;
        uint32_t width;
    } cases[] = {{16, 32, 40, 3, 0}, {16, 32, 300, 1, 0}, {4, 32, 25, 0, 0}, {8, 7, 20, 2, 0},
                 {64, 8, 20, 0, 0},  {16, 32, 70, 1, 1},  {17, 5, 20, 0, 1}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        char what[64];
        struct look l =
            look_make(40 + i, cases[i].n, cases[i].len, cases[i].hidden, cases[i].degree);
        size_t cut[3];
        snprintf(what, sizeof what, "%u -> %u, %u Gaussians, width %u", cases[i].len,
                 cases[i].hidden, cases[i].n, cases[i].width);
        look_count(&l, cut);
        assert_true(cut[0] && cut[1] && cut[2]);
        if (cases[i].n == 300) /* one lies between pixel centres: the kernels do not count it */
            l.s.offset_weight = 0;
        check_kernels(what, &l, cases[i].width);
        look_free(&l);
    }
}

/* Frames with and without, and of other lengths, in any order: each as if alone. */
static void test_switching(void **state)
{
    struct look l = look_make(55, 60, LEN, HIDDEN, 1), other = look_make(56, 60, 4, 8, 1);
    struct render *r;
    struct render_model m = {0}, n = {0};
    struct err e = {0};
    const size_t floats = (size_t)PX_W * PX_H * 3;
    float *first[3], *again;
    struct view_case plain = l.s;
    plain.o.appearance_frame = NULL;
    kit_ok(render_open(dev_get(), &r, &e), e);
    const struct view_case *scenes[3] = {&l.s, &plain, &other.s};
    for (int k = 0; k < 6; k++) {
        kernel_forward(r, scenes[k % 3], k % 3 == 2 ? &n : &m);
        again = floats_read(render_color_buffer(r), floats);
        if (k < 3) {
            first[k] = again;
        } else {
            assert_memory_equal(first[k - 3], again, floats * sizeof *again);
            mem_free(again);
        }
    }
    assert_memory_not_equal(first[0], first[1], floats * sizeof *again);
    /* without it embeddings change nothing */
    struct gauss bare = {0};
    struct view_case s = plain;
    kit_ok(gauss_alloc(&bare, plain.g.n, 1, 0, &e), e);
    kit_ok(gauss_append(&bare, &plain.g, NULL, plain.g.n, &e), e);
    s.g = bare;
    struct render_model b = {0};
    kernel_forward(r, &s, &b);
    again = floats_read(render_color_buffer(r), floats);
    assert_memory_equal(first[1], again, floats * sizeof *again);
    mem_free(again);
    for (int k = 0; k < 3; k++)
        mem_free(first[k]);
    gauss_free(&bare);
    render_model_free(&b);
    render_model_free(&m);
    render_model_free(&n);
    render_close(&r);
    look_free(&l);
    look_free(&other);
}

/* Embeddings travel with the model. */
static void test_upload_download(void **state)
{
    struct gauss g, back = {0}, other = {0};
    struct render *r;
    struct render_model m;
    struct err e = {0};
    kit_gauss(7, 100, 3.0, 2, 9, &g);
    for (size_t i = 0; i < g.n * 9; i++)
        g.embed[i] = (float)rng_normal(7, 1, i);
    kit_ok(render_open(dev_get(), &r, &e), e);
    kit_ok(render_model_upload(r, &g, &m, &e), e);
    assert_int_equal(m.planes, 11 + 27 + 9);
    kit_ok(render_model_download(r, &m, &back, &e), e);
    assert_int_equal(back.embed_len, 9);
    assert_memory_equal(back.embed, g.embed, g.n * 9 * sizeof(float));
    assert_memory_equal(back.sh, g.sh, g.n * 27 * sizeof(float));
    kit_ok(gauss_alloc(&other, 100, 2, 4, &e), e);
    kit_ok(render_model_download(r, &m, &other, &e), e);
    assert_memory_equal(other.sh, g.sh, g.n * 27 * sizeof(float));
    render_model_free(&m);
    render_close(&r);
    gauss_free(&g);
    gauss_free(&back);
    gauss_free(&other);
}

/* ---- the optimiser ---- */

#define ADAM_REL 2e-5 /* as in test_step.c */
#define ADAM_ABS 2e-6

/* Embeddings of a step against Adam by the book, the unseen included. */
static void check_adam(uint32_t width)
{
    struct dev *d = dev_get();
    uint32_t own = d->vector_width;
    struct look l = look_make(91, 75, 8, 12, 1);
    struct err e = {0};
    cl_mem grads;
    for (size_t i = 16; i < 36; i++) /* a whole group and more behind the camera */
        for (size_t a = 0; a < 3; a++)
            l.s.g.mean_m[3 * i + a] -= (float)(9 * l.s.cam.rot[6 + a]);
    d->vector_width = width ? width : own;
    struct trainer t = trainer_make(&l.s.g);
    float *frame[2] = {mem_array(l.floats, sizeof(float)), mem_array(l.floats, sizeof(float))};
    size_t words = (size_t)t.m.groups * t.m.planes * 16, n = t.m.n * (size_t)8;
    struct render_appearance_grad a = {.offset_weight = 3, .frame = frame[0]}, b = a;
    b.frame = frame[1];
    t.adam.lr_embed = 0.01f;
    t.adam.appearance = &b;
    t.adam.step = 700; /* appearance came later */
    kit_ok(dev_buffer(d, words * sizeof(float), NULL, &grads, &e), e);
    struct moment_rounding rounding = {0};
    double *m1 = mem_array(n, 3 * sizeof *m1), *m2 = m1 + n, *want = m2 + n;
    assert_true(m1 && frame[0] && frame[1]);
    for (uint32_t step = 1; step <= 4; step++) {
        float *p = embed_read(&t.m, t.m.params);
        kernel_forward(t.r, &l.s, &t.m);
        kit_ok(render_backward_appearance(t.r, &t.m, grads, &a, &e), e);
        float *g = embed_read(&t.m, grads);
        t.adam.step++;
        t.adam.embed_step = step;
        kit_ok(render_backward_step(t.r, &t.m, &t.adam, &t.stats, &e), e);
        double *f = mem_array(l.floats, sizeof *f);
        for (size_t i = 0; i < l.floats; i++)
            f[i] = (double)frame[0][i];
        kit_near("frame", frame[1], f, l.floats, ADAM_REL * rms(f, l.floats), ADAM_REL);
        mem_free(f);
        assert_true(a.visible == b.visible && a.visible < t.m.n);
        kit_near_d("mean", &b.offset_mean, &a.offset_mean, 1, 1e-7, 0);
        for (size_t i = 0; i < n; i++) {
            double x = (double)g[i];
            m1[i] = 0.9 * m1[i] + 0.1 * x;
            m2[i] = 0.999 * m2[i] + 0.001 * x * x;
            want[i] = (double)p[i] - 0.01 * m1[i] / (1 - pow(0.9, step)) /
                                         (sqrt(m2[i] / (1 - pow(0.999, step))) + 1e-15);
        }
        float *got = embed_read(&t.m, t.m.params), *words_got = embed_read(&t.m, t.adam.moments),
              *stored = mem_array(n, 2 * sizeof *stored);
        size_t moved = 0;
        assert_non_null(stored);
        moments_split(words_got, n, stored);
        kit_near("embeddings", got, want, n, ADAM_ABS, ADAM_REL);
        for (size_t i = 0; i < 2 * n; i++) {
            const double near = ADAM_REL * (rms(i < n ? m1 : m2, n) + fabs(m1[i]));
            if (!moment_rounds(&rounding, stored[i], m1[i], near))
                fail_msg("moment %zu is %g, not next to %g", i, (double)stored[i], m1[i]);
        }
        for (size_t i = 0; i < n; i++) {
            m1[i] = (double)stored[i];
            m2[i] = (double)stored[n + i];
            moved += got[i] != p[i];
        }
        assert_true(moved > n / 4 && moved < n); /* what nobody ever saw stays */
        float *const all[] = {p, g, got, words_got, stored};
        for (size_t i = 0; i < 5; i++)
            mem_free(all[i]);
    }
    moment_rounding_check(&rounding, 30);
    d->vector_width = own;
    assert_int_equal(trainer_repaired(&t), 0);
    dev_release(&grads);
    mem_free(m1);
    mem_free(frame[0]);
    mem_free(frame[1]);
    trainer_free(&t);
    look_free(&l);
}

static void test_step_is_adam(void **state)
{
    check_adam(0);
    check_adam(1);
}

/* Largest opacity drawn, with appearance and without; frames without leave embeddings alone. */
static void test_opacity_statistic(void **state)
{
    struct look l = look_make(92, 50, LEN, HIDDEN, 0);
    struct view_case plain = l.s;
    struct trainer t = trainer_make(&l.s.g);
    struct err e = {0};
    double want[50] = {0};
    plain.o.appearance_frame = NULL;
    t.adam = (struct render_adam){.moments = t.adam.moments,
                                  .beta1 = 0.9f,
                                  .beta2 = 0.999f,
                                  .eps = 1e-15f,
                                  .scale_log_min = -20,
                                  .scale_log_max = 20,
                                  .embed_step = 1,
                                  .lr_embed = 0};
    kit_ok(dev_buffer(dev_get(), (size_t)t.m.groups * 64, NULL, &t.stats.opacity, &e), e);
    kit_ok(dev_zero(dev_get(), t.stats.opacity, 0, (size_t)t.m.groups * 64, &e), e);
    float *before = embed_read(&t.m, t.m.params);
    for (int k = 0; k < 3; k++) { /* plain, appearance, plain again */
        const struct view_case *s = k == 1 ? &l.s : &plain;
        struct ref_view v;
        struct ref_splat p;
        kit_ok(ref_view_init(&s->g, &s->cam, &s->o, &v, &e), e);
        for (size_t i = 0; i < 50; i++)
            if (ref_project(&v, &s->g, i, &p))
                want[i] = fmax(want[i], p.opacity);
        if (k != 1)
            t.adam.lr_embed = 1; /* must not be used */
        trainer_step(&t, s);
        t.adam.lr_embed = 0;
        float *got = floats_read(t.stats.opacity, 50);
        kit_near("largest opacity", got, want, 50, 1e-6, 1e-6);
        mem_free(got);
    }
    float *after = embed_read(&t.m, t.m.params);
    assert_memory_equal(before, after, 50 * LEN * sizeof *after);
    mem_free(before);
    mem_free(after);
    dev_release(&t.stats.opacity);
    trainer_free(&t);
    look_free(&l);
}

/* Embeddings that are no numbers: drawn as if 0, harmless to the others. */
static void test_hostile_embeddings(void **state)
{
    static const float odd[] = {NAN, INFINITY, -INFINITY, 1e30f, 0.0f, 1e-30f};
    for (uint32_t width = 0; width < 2; width++) {
        struct dev *d = dev_get();
        uint32_t own = d->vector_width;
        struct look l = look_make(93, 48, LEN, HIDDEN, 0);
        float *frame = mem_array(l.floats, sizeof *frame);
        struct render_appearance_grad a = {.frame = frame};
        assert_non_null(frame);
        for (size_t i = 0; i < 24; i++)
            for (size_t k = 0; k < (i % 2 ? LEN : 1); k++)
                l.s.g.embed[LEN * i + k] = odd[i / 2 % 6];
        d->vector_width = width ? width : own;
        struct trainer t = trainer_make(&l.s.g);
        t.adam.lr_embed = 0.01f;
        t.adam.embed_step = 1;
        t.adam.appearance = &a;
        trainer_step(&t, &l.s);
        d->vector_width = own;
        float *rgb = floats_read(render_color_buffer(t.r), (size_t)PX_W * PX_H * 3);
        for (size_t i = 0; i < (size_t)PX_W * PX_H * 3; i++)
            assert_true(isfinite(rgb[i]));
        for (size_t i = 0; i < l.floats; i++)
            assert_true(isfinite(frame[i]));
        assert_true(isfinite(a.offset_mean));
        float *after = embed_read(&t.m, t.m.params);
        for (size_t i = 24 * LEN; i < 48 * LEN; i++)
            assert_true(isfinite(after[i]));
        mem_free(after);
        mem_free(rgb);
        mem_free(frame);
        trainer_free(&t);
        look_free(&l);
    }
}

/* ---- same bits, errors ---- */

static void digest(char out[33])
{
    struct look l = look_make(41, 700, LEN, HIDDEN, 2);
    l.s.cam = camera_resize(&l.s.cam, 170, 130);
    mem_free(l.s.rgb_grad);
    l.s.rgb_grad = grad_make((size_t)170 * 130 * 3, 41);
    struct trainer t = trainer_make(&l.s.g);
    float *frame = mem_array(l.floats, sizeof *frame);
    struct render_appearance_grad a = {.frame = frame, .offset_weight = 0.05f};
    struct buf all = {0};
    t.adam.lr_embed = 0.01f;
    t.adam.appearance = &a;
    for (uint32_t i = 1; i <= 3; i++) {
        t.adam.embed_step = i;
        trainer_step(&t, &l.s);
        buf_add(&all, frame, l.floats * sizeof *frame);
        buf_add(&all, &a.offset_mean, sizeof a.offset_mean);
    }
    size_t words = (size_t)t.m.groups * t.m.planes * 16;
    const cl_mem mems[2] = {t.m.params, t.adam.moments};
    for (size_t i = 0; i < 2; i++) {
        float *v = floats_read(mems[i], words);
        buf_add(&all, v, words * sizeof *v);
        mem_free(v);
    }
    assert_false(all.failed);
    hash_text(hash_bytes(all.data, all.size), out);
    buf_free(&all);
    mem_free(frame);
    trainer_free(&t);
    look_free(&l);
}

static void test_same_bits(void **state)
{
    kit_same_bits(digest);
}

static void test_errors(void **state)
{
    struct look l = look_make(50, 4, 4, 4, 0);
    struct trainer t = trainer_make(&l.s.g);
    struct render_appearance_grad a = {0};
    struct view_case s = l.s;
    struct err e = {0};
    cl_mem grads;
    kit_ok(dev_buffer(dev_get(), (size_t)t.m.groups * t.m.planes * 64, NULL, &grads, &e), e);
    s.o.appearance_hidden = 0;
    kit_fails(render_forward(t.r, &t.m, &s.cam, &s.o, NULL, NULL, &e), ERR_ARG, e, "0 hidden");
    s.o.appearance_hidden = APPEARANCE_HIDDEN_MAX + 1;
    kit_fails(render_forward(t.r, &t.m, &s.cam, &s.o, NULL, NULL, &e), ERR_ARG, e, "65 hidden");
    s.o.appearance_frame = NULL;
    kernel_forward(t.r, &s, &t.m);
    kit_fails(render_backward_appearance(t.r, &t.m, grads, &a, &e), ERR_ARG, e, "without");
    t.adam.step = 1;
    t.adam.appearance = &a;
    kit_fails(render_backward_step(t.r, &t.m, &t.adam, NULL, &e), ERR_ARG, e, "frames with");
    kernel_forward(t.r, &l.s, &t.m);
    kit_fails(render_backward_step(t.r, &t.m, &t.adam, NULL, &e), ERR_ARG, e, "counts from 1");
    t.adam.embed_step = 1;
    kit_ok(render_backward_step(t.r, &t.m, &t.adam, NULL, &e), e);
    /* a model without embeddings */
    struct view_case bare = view_case_make(50, 4, RENDER_AA_2D, 0);
    struct render_model m = {0};
    bare.o.appearance_frame = l.frame;
    bare.o.appearance_hidden = 4;
    kit_ok(render_model_upload(t.r, &bare.g, &m, &e), e);
    kit_fails(render_forward(t.r, &m, &bare.cam, &bare.o, NULL, NULL, &e), ERR_ARG, e,
              "embeddings of 0");
    double rgb[3];
    kit_fails(render_ref_forward(&bare.g, &bare.cam, &bare.o, rgb, NULL, &e), ERR_ARG, e,
              "embeddings of 0");
    render_model_free(&m);
    view_case_free(&bare);
    dev_release(&grads);
    trainer_free(&t);
    look_free(&l);
}

/* An argument is "digest", or a pattern of test names: what a simulator can do in time. */
int main(int argc, char **argv)
{
    if (kit_digest(argc, argv, digest)) {
        dev_close(dev_get());
        return 0;
    }
    if (argc > 1)
        cmocka_set_test_filter(argv[1]);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_reference),         cmocka_unit_test(test_same_network),
        cmocka_unit_test(test_upload_download),   cmocka_unit_test(test_kernels),
        cmocka_unit_test(test_switching),         cmocka_unit_test(test_step_is_adam),
        cmocka_unit_test(test_opacity_statistic), cmocka_unit_test(test_hostile_embeddings),
        cmocka_unit_test(test_same_bits),         cmocka_unit_test(test_errors),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    dev_close(dev_get());
    return failed;
}
