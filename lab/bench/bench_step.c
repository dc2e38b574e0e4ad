/* Training: whole iterations (draw, loss, backward pass, Adam of 59 parameters) and their parts: of
 * all Gaussians, with appearance, and as a run makes them from --defer-from Gaussians on: those in
 * the frustum, from one of several cameras in turn, with what they were owed (render/defer.h).
 *
 * The photograph is a picture of the city. The model is the city with all parameters disturbed, so
 * gradients and list lengths are as in real training. Learning rates are 0, so that every timed
 * iteration does the same work. Checked before timing: one iteration at real learning rates must
 * lower the loss; a frame of those in the frustum has the bits of a frame of all.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/bench.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/math/sort.h"
#include "lab/bench/city.h"
#include "lab/bench/roofline_count.h"
#include "render/defer.h"
#include "render/render.h"
#include "train/loss/photometric.h"

enum { SEED = 7, STEP_KERNELS_MAX = 64, STEP_CAMERAS = 6, STEP_ROUNDS = 5 };
enum step_kind { STEP_ALL, STEP_FRUSTUM, STEP_APPEARANCE };

struct step_case {
    struct dev *dev; /* borrowed */
    struct render *render;
    struct photometric *loss;
    struct render_model model;
    struct render_adam adam;
    struct render_density_stats stats;
    struct camera cam;
    cl_mem target;
    /* cameras in turn; defer NULL: one camera. all: nothing is deferred */
    struct defer *defer;
    bool all;
    struct camera turn[STEP_CAMERAS];
    struct render_model seen;
    /* with appearance; frame NULL: without */
    struct appearance appearance;
    float *frame, *frame_grad;
    struct render_appearance_grad grad;
};

static void step_free(struct step_case *c)
{
    cl_mem *const mems[] = {&c->adam.moments, &c->stats.grad,     &c->stats.absg, &c->stats.count,
                            &c->stats.radius, &c->stats.repaired, &c->target};
    for (size_t i = 0; i < sizeof mems / sizeof *mems; i++)
        dev_release(mems[i]);
    defer_close(&c->defer);
    render_model_free(&c->model);
    photometric_close(&c->loss);
    render_close(&c->render);
    appearance_free(&c->appearance);
    mem_free(c->frame);
    mem_free(c->frame_grad);
}

static void step_rates(struct step_case *c, float scale)
{
    struct render_adam *a = &c->adam;
    a->lr_mean = 5e-3f * scale;
    a->lr_scale = 5e-3f * scale;
    a->lr_quat = 1e-3f * scale;
    a->lr_opacity = 5e-2f * scale;
    a->lr_sh_dc = 2.5e-3f * scale;
    a->lr_sh_rest = 1.25e-4f * scale;
    a->lr_embed = 1e-2f * scale;
}

static struct render_model *step_model(struct step_case *c)
{
    return c->defer && !c->all ? &c->seen : &c->model;
}

static enum err_code step_draw(void *user, struct err *e)
{
    struct step_case *c = user;
    const struct render_options o = {.aa = RENDER_AA_2D,
                                     .sh_degree = -1,
                                     .appearance_frame = c->frame,
                                     .appearance_hidden = APPEARANCE_HIDDEN};
    enum err_code rc = ERR_OK;
    if (c->defer)
        c->cam = c->turn[c->adam.step % STEP_CAMERAS];
    if (c->defer && !c->all)
        rc = defer_see(c->defer, &c->model, &c->adam, &c->cam, &o, &c->seen, e);
    if (!rc)
        rc = render_forward(c->render, step_model(c), &c->cam, &o, NULL, NULL, e);
    return !rc ? dev_finish(c->dev, e) : rc;
}

static enum err_code step_loss(void *user, struct err *e)
{
    struct step_case *c = user;
    const struct photometric_input in = {.color = render_color_buffer(c->render),
                                         .target = c->target,
                                         .width_px = c->cam.width_px,
                                         .height_px = c->cam.height_px,
                                         .l1_weight = PHOTOMETRIC_L1_WEIGHT,
                                         .ssim_weight = PHOTOMETRIC_SSIM_WEIGHT};
    enum err_code rc = photometric_run(c->loss, &in, render_color_grad_buffer(c->render), e);
    return !rc ? dev_finish(c->dev, e) : rc;
}

static enum err_code step_once(void *user, struct err *e)
{
    struct step_case *c = user;
    enum err_code rc = step_draw(c, e);
    if (!rc)
        rc = step_loss(c, e);
    c->adam.step++;
    c->adam.embed_step = c->adam.step;
    if (!rc)
        rc = render_backward_step(c->render, step_model(c), &c->adam, &c->stats, e);
    if (!rc && c->defer && !c->all)
        rc = defer_stepped(c->defer, &c->adam, e);
    return !rc ? dev_finish(c->dev, e) : rc;
}

/* As photographs of a survey: from around the middle, each across a part of the city. */
static void step_turn(struct step_case *c, uint32_t w, uint32_t h)
{
    for (int k = 0; k < STEP_CAMERAS; k++) {
        const double turn = 2.0 * 3.14159265358979323846 * k / STEP_CAMERAS;
        const double eye[3] = {40.0 * cos(turn), 40.0 * sin(turn), 95.0},
                     target[3] = {110.0 * cos(turn), 110.0 * sin(turn), 5.0};
        c->turn[k] = camera_look_at(eye, target, 0.75, w, h);
    }
}

/* The photograph: the undisturbed city as it is drawn. */
static enum err_code step_target(struct step_case *c, const struct gauss *city, struct err *e)
{
    size_t n = (size_t)c->cam.width_px * c->cam.height_px * 3;
    float *rgb = mem_array(n, sizeof *rgb);
    uint8_t *bytes = mem_array(n, 1);
    struct render_model m = {0};
    const struct render_options o = {.aa = RENDER_AA_2D, .sh_degree = -1};
    enum err_code rc = rgb && bytes ? render_model_upload(c->render, city, &m, e)
                                    : err_set(e, ERR_MEM, "bench_step: picture");
    if (!rc)
        rc = render_forward(c->render, &m, &c->cam, &o, rgb, NULL, e);
    for (size_t i = 0; !rc && i < n; i++)
        bytes[i] = (uint8_t)(255 * (rgb[i] < 1 ? rgb[i] : 1) + 0.5f);
    if (!rc)
        rc = dev_buffer(c->dev, n, bytes, &c->target, e);
    render_model_free(&m);
    mem_free(rgb);
    mem_free(bytes);
    return rc;
}

static void step_disturb(struct gauss *g)
{
    size_t k = 3 * gauss_sh_count(g->sh_degree);
    for (size_t i = 0; i < g->n; i++) {
        for (size_t a = 0; a < 3; a++) {
            g->mean_m[3 * i + a] += (float)(0.1 * rng_normal(SEED, a, i));
            g->scale_log[3 * i + a] += (float)(0.1 * rng_normal(SEED, 3 + a, i));
            g->sh[k * i + a] += (float)(0.2 * rng_normal(SEED, 6 + a, i));
        }
        g->opacity_logit[i] += (float)(0.3 * rng_normal(SEED, 9, i));
    }
}

/* Embeddings for these Gaussians, and room for the frame's gradients. */
static enum err_code step_look(struct step_case *c, struct gauss *g, struct err *e)
{
    struct gauss with = {0};
    enum err_code rc = city_appearance(g, &with, &c->appearance, &c->frame, e);
    c->frame_grad = mem_array(appearance_frame_floats(APPEARANCE_GAUSS_LEN, APPEARANCE_HIDDEN),
                              sizeof *c->frame_grad);
    if (!rc && !c->frame_grad)
        rc = err_set(e, ERR_MEM, "bench_step: appearance");
    c->grad = (struct render_appearance_grad){.frame = c->frame_grad, .offset_weight = 0.05f};
    c->adam.appearance = &c->grad;
    gauss_free(g);
    *g = with;
    return rc;
}

static enum err_code step_open(struct bench *b, size_t n, uint32_t w, uint32_t h,
                               enum step_kind kind, struct step_case *c, struct err *e)
{
    struct gauss g = {0};
    memset(c, 0, sizeof *c);
    c->dev = b->dev;
    c->cam = city_camera(w, h);
    c->adam.beta1 = 0.9f;
    c->adam.beta2 = 0.999f;
    c->adam.eps = 1e-15f;
    c->adam.scale_log_min = -12;
    c->adam.scale_log_max = 4;
    enum err_code rc = city_sorted(n, &g, e);
    if (!rc)
        rc = render_open(b->dev, &c->render, e);
    if (!rc)
        rc = photometric_open(b->dev, &c->loss, e);
    if (!rc)
        rc = step_target(c, &g, e);
    if (!rc)
        step_disturb(&g);
    if (!rc && kind == STEP_APPEARANCE)
        rc = step_look(c, &g, e);
    if (!rc)
        rc = render_model_upload(c->render, &g, &c->model, e);
    size_t lanes = (size_t)c->model.groups * 16 * sizeof(float), state = lanes * c->model.planes;
    cl_mem *const mems[] = {&c->adam.moments, &c->stats.grad,   &c->stats.absg,
                            &c->stats.count,  &c->stats.radius, &c->stats.repaired};
    for (size_t i = 0; !rc && i < sizeof mems / sizeof *mems; i++) {
        size_t bytes = i < 1 ? state : lanes;
        rc = dev_buffer(b->dev, bytes, NULL, mems[i], e);
        if (!rc)
            rc = dev_zero(b->dev, *mems[i], 0, bytes, e);
    }
    step_turn(c, w, h);
    if (!rc && kind == STEP_FRUSTUM)
        rc = defer_open(c->render, &c->defer, e);
    gauss_free(&g);
    return rc;
}

/* One iteration at real rates must lower the loss. */
static enum err_code step_check(struct step_case *c, struct err *e)
{
    struct photometric_value before = {0}, after = {0};
    step_rates(c, 1);
    enum err_code rc = step_once(c, e);
    if (!rc)
        rc = photometric_read(c->loss, &before, e);
    step_rates(c, 0);
    if (!rc)
        rc = step_once(c, e);
    if (!rc)
        rc = photometric_read(c->loss, &after, e);
    if (!rc && !(after.total < before.total))
        rc = err_set(e, ERR_INTERNAL, "bench_step: the loss rose from %.6f to %.6f in one step",
                     before.total, after.total);
    return rc;
}

/* Each camera's frame of the frustum, a step later each, against that of all. *share: of all groups
 * that are listed, in the mean. */
static enum err_code step_check_frustum(struct step_case *c, double *share, struct err *e)
{
    const struct render_options o = {.aa = RENDER_AA_2D, .sh_degree = -1};
    const size_t n = (size_t)c->cam.width_px * c->cam.height_px * 3;
    float *all = mem_array(n, sizeof *all), *seen = mem_array(n, sizeof *seen);
    enum err_code rc = all && seen ? ERR_OK : err_set(e, ERR_MEM, "bench_step: picture");
    *share = 0.0;
    for (int k = 0; !rc && k < STEP_CAMERAS; k++) {
        rc = step_draw(c, e);
        *share += (double)c->seen.groups / (double)c->model.groups / STEP_CAMERAS;
        if (!rc)
            rc = render_forward(c->render, &c->model, &c->cam, &o, all, NULL, e);
        if (!rc)
            rc = render_forward(c->render, &c->seen, &c->cam, &o, seen, NULL, e);
        if (!rc && memcmp(all, seen, n * sizeof *all) != 0)
            rc = err_set(e, ERR_INTERNAL, "bench_step: the frustum draws another picture");
        if (!rc)
            rc = step_once(c, e);
    }
    mem_free(all);
    mem_free(seen);
    return rc;
}

/* The stages of one iteration, each waited for. */
static enum err_code step_stages(struct bench *b, struct step_case *c, const char *name,
                                 struct err *e)
{
    char text[128];
    render_set_timing(c->render, true);
    enum err_code rc = step_once(c, e);
    render_set_timing(c->render, false);
    const struct render_stats *s = render_last_stats(c->render);
    const struct {
        const char *name;
        double ms;
    } rows[] = {{"project", s->ms_project},
                {"sort", s->ms_sort},
                {"bin", s->ms_bin},
                {"blend", s->ms_blend},
                {"blend backward", s->ms_blend_backward},
                {"projection backward and Adam", s->ms_project_backward}};
    for (size_t i = 0; !rc && i < sizeof rows / sizeof *rows; i++) {
        snprintf(text, sizeof text, "%s: %s", name, rows[i].name);
        bench_report(b, text, rows[i].ms, "ms", 0, NULL);
    }
    return rc;
}

/* *total_ms: of the iteration of all, which that with appearance is compared with. That of the
 * frustum is compared with one of all from the same cameras. */
static enum err_code step_measure(struct bench *b, size_t n, uint32_t w, uint32_t h,
                                  enum step_kind kind, double *total_ms, struct err *e)
{
    static const char *const names[] = {"", ", in the frustum", ", appearance"},
                             *const against[] = {NULL, "all, same cameras", "without appearance"};
    struct step_case c;
    char name[64], text[128];
    double ms = 0, draw_ms = 0, loss_ms = 0, spread = 0, share = 0, core_ms = 0, all_core_ms = 0;
    enum err_code rc = step_open(b, n, w, h, kind, &c, e);
    c.all = kind == STEP_FRUSTUM;
    if (!rc && c.all)
        rc = bench_time(b, step_once, &c, total_ms, &spread, e);
    if (!rc && c.all)
        rc = bench_cpu_time(b, step_once, &c, &all_core_ms, &spread, e);
    c.all = false;
    if (!rc)
        rc = kind == STEP_FRUSTUM ? step_check_frustum(&c, &share, e) : step_check(&c, e);
    if (!rc)
        rc = bench_time(b, step_once, &c, &ms, &spread, e);
    if (!rc)
        rc = bench_cpu_time(b, step_once, &c, &core_ms, &spread, e);
    if (!rc)
        rc = bench_time(b, step_draw, &c, &draw_ms, &spread, e);
    if (!rc)
        rc = bench_time(b, step_loss, &c, &loss_ms, &spread, e);
    if (!rc) {
        *total_ms = kind == STEP_ALL ? ms : *total_ms;
        snprintf(name, sizeof name, "%zu k, %ux%u%s", n / 1000, w, h, names[kind]);
        bench_report(b, name, ms, "ms", kind == STEP_ALL ? 0 : ms / *total_ms, against[kind]);
        snprintf(text, sizeof text, "%s: processor time", name);
        bench_report(b, text, core_ms, "core ms", kind == STEP_FRUSTUM ? core_ms / all_core_ms : 0,
                     kind == STEP_FRUSTUM ? against[kind] : NULL);
        snprintf(text, sizeof text, "%s: draw", name);
        bench_report(b, text, draw_ms, "ms", 0, NULL);
        snprintf(text, sizeof text, "%s: loss", name);
        bench_report(b, text, loss_ms, "ms", 0, NULL);
        snprintf(text, sizeof text, "%s: backward and Adam", name);
        bench_report(b, text, ms - draw_ms - loss_ms, "ms", 0, NULL);
        snprintf(text, sizeof text, "%s: share of groups", name);
        if (kind == STEP_FRUSTUM)
            bench_report(b, text, 100.0 * share, "%", 0, NULL);
        rc = step_stages(b, &c, name, e);
    }
    step_free(&c);
    return rc;
}

enum err_code bench_step(struct bench *b, struct err *e)
{
    static const struct {
        size_t n;
        uint32_t w, h;
    } cases[] = {{50000, 400, 301}, {100000, 400, 300}, {100000, 800, 600}, {1000000, 1280, 720}},
      quick[] = {{5000, 200, 150}};
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < (b->quick ? 1 : sizeof cases / sizeof *cases); i++) {
        double ms = 0;
        size_t n = b->quick ? quick[i].n : cases[i].n;
        uint32_t w = b->quick ? quick[i].w : cases[i].w, h = b->quick ? quick[i].h : cases[i].h;
        double turn_ms = 0;
        rc = step_measure(b, n, w, h, STEP_ALL, &ms, e);
        if (!rc)
            rc = step_measure(b, n, w, h, STEP_FRUSTUM, &turn_ms, e);
        if (!rc)
            rc = step_measure(b, n, w, h, STEP_APPEARANCE, &ms, e);
    }
    return rc;
}

enum err_code bench_step_at(struct bench *b, const char *name, size_t n, uint32_t width_px,
                            uint32_t height_px, struct err *e)
{
    struct step_case c;
    double ms = 0;
    enum err_code rc = step_open(b, n, width_px, height_px, STEP_ALL, &c, e);
    if (!rc)
        rc = bench_time(b, step_once, &c, &ms, NULL, e);
    if (!rc)
        bench_report_at(b, name, ms, "ms", (double)n, (double)width_px * height_px);
    step_free(&c);
    return rc;
}

/* ---- kernels ---- */

/* A kernel over all turns, and in each round. */
struct step_kernel {
    struct dev_time sum;
    double took_ms[STEP_ROUNDS]; /* of a step, the least of the round's turns */
};

struct step_kernels {
    struct step_kernel kernel[STEP_KERNELS_MAX];
    size_t n;
    int rounds, turns, steps; /* turns of a round, steps of a turn */
    struct bench_ceilings ceiling[STEP_ROUNDS];
    struct roofline_work work; /* of a step */
};

/* Groups of the list that the step before did not have: they are owed steps. listed: of the step
 * before, then of this one. */
static enum err_code step_owed(struct step_case *c, uint8_t *listed, double *owed, struct err *e)
{
    const size_t n = c->seen.groups, groups = c->model.groups;
    uint32_t *list = mem_array(n + 1, sizeof *list);
    enum err_code rc = list ? ERR_OK : err_set(e, ERR_MEM, "bench_step: out of memory");
    if (!rc)
        rc = dev_read(c->dev, c->seen.list, 0, n * sizeof *list, list, e);
    for (size_t i = 0; !rc && i < n; i++)
        listed[list[i]] |= 2;
    *owed = 0.0;
    for (size_t i = 0; !rc && i < groups; i++) {
        *owed += listed[i] == 2 ? LAYOUT_LANES : 0;
        listed[i] >>= 1;
    }
    mem_free(list);
    return rc;
}

static void step_work_add(struct roofline_work *sum, const struct roofline_work *w, double share)
{
    double *const to[] = {&sum->n,       &sum->all,    &sum->owed,    &sum->visible,
                          &sum->grouped, &sum->lists,  &sum->entries, &sum->drawn,
                          &sum->blocks,  &sum->pixels, &sum->tiles};
    const double from[] = {w->n,       w->all,   w->owed,   w->visible, w->grouped, w->lists,
                           w->entries, w->drawn, w->blocks, w->pixels,  w->tiles};
    for (size_t i = 0; i < sizeof from / sizeof *from; i++)
        *to[i] += share * from[i];
    sum->gpu = w->gpu;
}

/* The work of a turn, a step in the mean. A turn before it tells whom steps are owed to. */
static enum err_code step_work(struct step_case *c, struct step_kernels *k, struct err *e)
{
    uint8_t *listed = mem_array((size_t)c->model.groups + 1, 1);
    enum err_code rc = listed ? ERR_OK : err_set(e, ERR_MEM, "bench_step: out of memory");
    for (int i = 0; !rc && i < 2 * k->steps; i++) {
        struct roofline_work w = {0};
        double owed = 0.0;
        rc = step_once(c, e);
        if (!rc)
            rc = roofline_count(c->dev, c->render, &w, e);
        if (!rc && c->defer)
            rc = step_owed(c, listed, &owed, e);
        w.all = c->model.n;
        w.owed = owed;
        if (i >= k->steps)
            step_work_add(&k->work, &w, 1.0 / k->steps);
    }
    mem_free(listed);
    return rc;
}

static enum err_code step_turn_timed(struct bench *b, struct step_case *c, struct step_kernels *k,
                                     int round, struct err *e)
{
    struct dev_time times[STEP_KERNELS_MAX];
    size_t n = 0;
    enum err_code rc = dev_time_begin(b->dev, e), ended = ERR_OK;
    if (rc)
        return rc;
    dev_time_cores(b->dev);
    for (int i = 0; !rc && i < k->steps; i++)
        rc = step_once(c, e);
    ended = dev_time_end(b->dev, times, STEP_KERNELS_MAX, &n, e);
    rc = rc ? rc : ended;
    for (size_t i = 0; !rc && i < n; i++) {
        size_t at = 0;
        while (at < k->n && strcmp(k->kernel[at].sum.name, times[i].name) != 0)
            at++;
        if (at == k->n)
            k->kernel[k->n++] = (struct step_kernel){.sum = {.name = times[i].name}};
        struct step_kernel *to = &k->kernel[at];
        double took_ms = (b->dev->is_cpu ? times[i].core_ms : times[i].ms) / k->steps;
        to->sum.ms += times[i].ms;
        to->sum.launches += times[i].launches;
        if (!(to->took_ms[round] > 0.0) || took_ms < to->took_ms[round])
            to->took_ms[round] = took_ms;
    }
    return rc;
}

static double step_median(double *v, int n)
{
    sort_doubles(v, (size_t)n);
    return n % 2 ? v[n / 2] : 0.5 * (v[n / 2 - 1] + v[n / 2]);
}

/* Limits of the rounds, and what was taken, each with the ceilings of its round; *took_ms and
 * *limit_ms may be sums over kernels. */
struct step_rounds {
    double took_ms[STEP_ROUNDS], limit_ms[STEP_ROUNDS];
};

static void step_medians(const struct step_rounds *r, int rounds, double *took_ms, double *limit_ms,
                         double *ratio)
{
    struct step_rounds s = *r;
    double ratios[STEP_ROUNDS];
    for (int i = 0; i < rounds; i++)
        ratios[i] = r->took_ms[i] / r->limit_ms[i];
    *took_ms = step_median(s.took_ms, rounds);
    *limit_ms = step_median(s.limit_ms, rounds);
    *ratio = step_median(ratios, rounds);
}

/* Each kernel against its limit, then all of a frame and all of a step. */
static enum err_code step_report(struct bench *b, const struct step_kernels *k, const char *where,
                                 struct err *e)
{
    const double steps = (double)k->rounds * k->turns * k->steps, cores = bench_cores(b);
    struct step_rounds sums[2] = {0}; /* of a frame, of a step */
    struct roofline_need total[2] = {0};
    double total_ms[2] = {0};
    char text[128];
    for (size_t i = 0; i < k->n; i++) {
        const struct step_kernel *kernel = &k->kernel[i];
        struct bench_kernel out = {.ms = kernel->sum.ms / steps};
        struct roofline_need *need = &out.need;
        struct step_rounds rounds = {0};
        if (!roofline_need(kernel->sum.name, &k->work, need))
            return err_set(e, ERR_INTERNAL, "bench_kernels: no formula for %s in roofline.c",
                           kernel->sum.name);
        for (int r = 0; r < k->rounds; r++) {
            out.limit = roofline_limit(need, k->ceiling[r].fma_gflops, k->ceiling[r].triad_gbps);
            rounds.limit_ms[r] = out.limit.ms;
            rounds.took_ms[r] = kernel->took_ms[r] / (need->alone ? 1.0 : cores);
            for (int s = need->frame ? 0 : 1; s < 2; s++) {
                sums[s].limit_ms[r] += rounds.limit_ms[r];
                sums[s].took_ms[r] += rounds.took_ms[r];
            }
        }
        for (int s = need->frame ? 0 : 1; s < 2; s++) {
            total[s].bytes += need->bytes;
            total[s].multiply_adds += need->multiply_adds;
            total_ms[s] += out.ms;
        }
        step_medians(&rounds, k->rounds, &out.took_ms, &out.limit.ms, &out.ratio);
        snprintf(text, sizeof text, "%s (%.3g launches%s)", kernel->sum.name,
                 (double)kernel->sum.launches / steps, where);
        bench_report_kernel(b, text, &out, k->work.all, k->work.pixels);
    }
    for (int s = 0; s < 2; s++) {
        struct bench_kernel out = {.ms = total_ms[s], .need = total[s]};
        step_medians(&sums[s], k->rounds, &out.took_ms, &out.limit.ms, &out.ratio);
        out.limit.memory =
            total[s].bytes / b->triad_gbps > 2.0 * total[s].multiply_adds / b->fma_gflops;
        snprintf(text, sizeof text, "all kernels of a %s%s", s ? "step" : "frame", where);
        bench_report_kernel(b, text, &out, k->work.all, k->work.pixels);
    }
    return ERR_OK;
}

static void step_report_work(struct bench *b, const struct step_kernels *k)
{
    const struct roofline_work *w = &k->work;
    double fma[STEP_ROUNDS], triad[STEP_ROUNDS];
    const struct {
        const char *name, *unit;
        double value;
    } rows[] = {{"Gaussians of the frame", "Gaussians", w->n},
                {"visible", "Gaussians", w->visible},
                {"in groups that are visible", "Gaussians", w->grouped},
                {"steps are owed to", "Gaussians", w->owed},
                {"intersections", "intersections", w->lists},
                {"list entries visited", "intersections", w->entries},
                {"list entries drawn", "intersections", w->drawn},
                {"blocks drawn into", "blocks", w->blocks}};
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        bench_report_at(b, rows[i].name, rows[i].value, rows[i].unit, w->all, w->pixels);
    for (int r = 0; r < k->rounds; r++) {
        fma[r] = k->ceiling[r].fma_gflops;
        triad[r] = k->ceiling[r].triad_gbps;
    }
    bench_report_at(b, "fma, between the turns", step_median(fma, k->rounds), "GFLOP/s", w->all,
                    w->pixels);
    bench_report_at(b, "triad, between the turns", step_median(triad, k->rounds), "GB/s", w->all,
                    w->pixels);
}

/* What of an iteration each kernel takes, on the device's own clock and against what its bytes and
 * its arithmetic take at least, and what is left of the iteration: gaps between launches, the
 * host's work and its waiting.
 *
 * Other programs may use the machine. So ceilings and turns of steps are measured in rounds, each
 * round gives ratios, and medians of these are reported. On a CPU both are in processor time over
 * the number of cores, of which the least of a round's turns counts. */
static enum err_code step_kernels(struct bench *b, size_t n, uint32_t w, uint32_t h,
                                  enum step_kind kind, struct err *e)
{
    struct step_case c;
    struct ceiling *ceiling = NULL;
    struct step_kernels k = {.rounds = b->runs < STEP_ROUNDS ? 1 : STEP_ROUNDS,
                             .steps = kind == STEP_FRUSTUM ? STEP_CAMERAS : 1};
    const char *where = kind == STEP_FRUSTUM ? ", in the frustum" : "";
    double all_ms = 0, kernels_ms = 0;
    char text[64];
    k.turns = (b->runs + k.rounds * k.steps - 1) / (k.rounds * k.steps);
    enum err_code rc = step_open(b, n, w, h, kind, &c, e);
    if (!rc)
        rc = bench_time(b, step_once, &c, &all_ms, NULL, e);
    if (!rc)
        rc = step_work(&c, &k, e);
    if (!rc)
        rc = bench_ceilings_open(b, &ceiling, e);
    for (int r = 0; !rc && r < k.rounds; r++) {
        rc = bench_ceilings(b, ceiling, &k.ceiling[r], e);
        for (int t = 0; !rc && t < k.turns; t++)
            rc = step_turn_timed(b, &c, &k, r, e);
    }
    if (!rc)
        rc = step_report(b, &k, where, e);
    for (size_t i = 0; !rc && i < k.n; i++)
        kernels_ms += k.kernel[i].sum.ms / (k.rounds * k.turns * k.steps);
    if (!rc) {
        step_report_work(b, &k);
        bench_report_at(b, "all but kernels", all_ms - kernels_ms, "ms", (double)n, (double)w * h);
        snprintf(text, sizeof text, "training iteration%s", where);
        bench_report_at(b, text, all_ms, "ms", (double)n, (double)w * h);
    }
    bench_ceilings_close(&ceiling);
    step_free(&c);
    return rc;
}

enum err_code bench_kernels(struct bench *b, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (int kind = STEP_ALL; !rc && kind <= STEP_FRUSTUM; kind++) {
        const enum step_kind k = (enum step_kind)kind;
        rc = step_kernels(b, b->quick ? 5000 : 100000, 400, 300, k, e);
        if (!rc && !b->quick)
            rc = step_kernels(b, 1000000, 1280, 720, k, e);
        if (!rc && !b->quick && !b->dev->is_cpu)
            rc = step_kernels(b, 6840000, 1600, 1200, k, e);
    }
    return rc;
}

/* Whole iterations against Gaussians at 1280 x 720, and against pixels with 100,000 Gaussians. */
enum err_code bench_step_growth(struct bench *b, struct err *e)
{
    static const struct {
        const char *name;
        size_t n;
        uint32_t w, h;
    } cases[] = {
        {"training, Gaussians", 10000, 1280, 720},   {"training, Gaussians", 30000, 1280, 720},
        {"training, Gaussians", 100000, 1280, 720},  {"training, Gaussians", 300000, 1280, 720},
        {"training, Gaussians", 1000000, 1280, 720}, {"training, Gaussians", 3000000, 1280, 720},
        {"training, pixels", 100000, 320, 180},      {"training, pixels", 100000, 640, 360},
        {"training, pixels", 100000, 1280, 720},     {"training, pixels", 100000, 1920, 1080}};
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < (b->quick ? 2 : sizeof cases / sizeof *cases); i++)
        rc = bench_step_at(b, cases[i].name, cases[i].n, cases[i].w, cases[i].h, e);
    return rc;
}
