/* Training steps over the photographs of a scene: of all Gaussians, against those in the frustum
 * with the others deferred (render/defer.h).
 *
 * Both kinds of step are made in turns, photograph by photograph, on the same Gaussians: those of a
 * level's checkpoint (--trained), or as many as --most says, scattered about the scene's sparse
 * points. Learning rates are 0, so that every step does the same work. The loss is against a grey
 * picture.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/bench.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/container/ckpt.h"
#include "codec/scene/scene.h"
#include "core/math/sort.h"
#include "core/pool.h"
#include "render/defer.h"
#include "render/render.h"
#include "train/loss/photometric.h"

enum { TOUR_SEED = 7, TOUR_DEGREE = 3, TOUR_GREY = 128, TOUR_WARM = 10 };
#define TOUR_SPACINGS                                                                              \
    0.4 /* sigma of a scattered Gaussian, in mean spacings of them on the ground */

enum { TOUR_RUNS_MAX = 1000, TOUR_SLICE = 65536, TOUR_CHUNK = 1024 };

struct tour_kind { /* one kind of step, and its samples */
    struct render_adam adam;
    double ms[TOUR_RUNS_MAX], cpu_ms[TOUR_RUNS_MAX];
};

struct tour {
    struct bench *b;
    struct scene scene;
    struct render *render;
    struct photometric *loss;
    struct render_model model;
    struct defer *defer;
    struct render_density_stats stats;
    cl_mem target;
    struct tour_kind all, seen;
    double share[TOUR_RUNS_MAX];
};

static void tour_free(struct tour *t)
{
    cl_mem *const mems[] = {&t->all.adam.moments, &t->stats.grad,     &t->stats.count,
                            &t->stats.radius,     &t->stats.repaired, &t->target};
    for (size_t i = 0; i < sizeof mems / sizeof *mems; i++)
        dev_release(mems[i]);
    defer_close(&t->defer);
    render_model_free(&t->model);
    photometric_close(&t->loss);
    render_close(&t->render);
    scene_free(&t->scene);
}

/* ---- Gaussians ---- */

/* Scattered Gaussians, in the order of a curve, as training has kept them since its last
 * densification. */
struct tour_scatter {
    const struct scene *scene;
    double sigma;
    const uint32_t *order; /* [n] */
    const float *mean;     /* [n][3], before they are in order */
    struct gauss slice;
    size_t first;
};

static double tour_sigma(const struct scene *s, size_t n)
{
    double lo[2] = {HUGE_VAL, HUGE_VAL}, hi[2] = {-HUGE_VAL, -HUGE_VAL};
    for (size_t i = 0; i < s->n_points; i++)
        for (size_t k = 0; k < 2; k++) {
            lo[k] = fmin(lo[k], s->points[i].enu_m[k]);
            hi[k] = fmax(hi[k], s->points[i].enu_m[k]);
        }
    return TOUR_SPACINGS * sqrt((hi[0] - lo[0]) * (hi[1] - lo[1]) / (double)n);
}

static enum err_code tour_fill(void *user, size_t chunk, struct err *e)
{
    const struct tour_scatter *s = user;
    const struct gauss *g = &s->slice;
    const size_t sh = 3 * gauss_sh_count(TOUR_DEGREE), end = (chunk + 1) * TOUR_CHUNK;
    (void)e;
    for (size_t j = chunk * TOUR_CHUNK; j < end && j < g->n; j++) {
        size_t i = s->order[s->first + j];
        for (size_t k = 0; k < 3; k++) {
            g->mean_m[3 * j + k] = s->mean[3 * i + k];
            g->scale_log[3 * j + k] =
                (float)(log(s->sigma) + 0.3 * rng_normal(TOUR_SEED, 3 + k, i));
        }
        for (size_t k = 0; k < 4; k++)
            g->quat_wxyz[4 * j + k] = (float)rng_normal(TOUR_SEED, 6 + k, i);
        g->opacity_logit[j] = (float)(2.0 * rng_normal(TOUR_SEED, 10, i));
        for (size_t k = 0; k < sh; k++)
            g->sh[sh * j + k] = (float)((k < 3 ? 1.0 : 0.1) * rng_normal(TOUR_SEED, 11 + k, i));
    }
    return ERR_OK;
}

static enum err_code tour_write(struct tour *t, struct tour_scatter *s, struct err *e)
{
    const size_t n = t->model.n;
    enum err_code rc = gauss_alloc(&s->slice, TOUR_SLICE, TOUR_DEGREE, 0, e);
    for (; !rc && s->first < n; s->first += TOUR_SLICE) {
        s->slice.n = n - s->first < TOUR_SLICE ? n - s->first : TOUR_SLICE;
        rc = pool_for((s->slice.n + TOUR_CHUNK - 1) / TOUR_CHUNK, 0, tour_fill, s, e);
        if (!rc)
            rc = render_model_write(t->render, &t->model, s->first, &s->slice, e);
    }
    gauss_free(&s->slice);
    return rc;
}

static enum err_code tour_scatter(struct tour *t, struct err *e)
{
    const size_t n = t->model.n;
    uint32_t *order = mem_array(n, sizeof *order);
    float *mean = mem_array(n, 3 * sizeof *mean);
    struct tour_scatter s = {.scene = &t->scene, .order = order, .mean = mean};
    if (!order || !mean) {
        mem_free(order);
        mem_free(mean);
        return err_set(e, ERR_MEM, "bench_tour: out of memory for %zu Gaussians", n);
    }
    s.sigma = tour_sigma(&t->scene, n);
    for (size_t i = 0; i < 3 * n; i++) {
        const struct scene_point *p = &t->scene.points[i / 3 % t->scene.n_points];
        mean[i] = (float)(p->enu_m[i % 3] + s.sigma * rng_normal(TOUR_SEED, i % 3, i / 3));
    }
    const struct gauss shape = {.n = n, .mean_m = mean};
    enum err_code rc = gauss_morton_order(&shape, order, e);
    if (!rc)
        rc = tour_write(t, &s, e);
    mem_free(order);
    mem_free(mean);
    return rc;
}

/* Parameters and moments for n Gaussians. */
static enum err_code tour_arrays(struct tour *t, size_t n, uint32_t degree, struct err *e)
{
    struct render_model *m = &t->model;
    cl_mem *const arrays[] = {&m->params, &t->all.adam.moments};
    enum err_code rc = ERR_OK;
    m->n = (uint32_t)n;
    m->sh_degree = degree;
    m->planes = layout_planes(degree, 0);
    m->groups = (m->n + LAYOUT_LANES - 1) / LAYOUT_LANES;
    m->cap = m->groups * LAYOUT_LANES;
    for (size_t k = 0; !rc && k < sizeof arrays / sizeof *arrays; k++) {
        size_t bytes = layout_floats(n, m->planes) * sizeof(float);
        rc = dev_buffer(t->b->dev, bytes, NULL, arrays[k], e);
        if (!rc)
            rc = dev_zero(t->b->dev, *arrays[k], 0, bytes, e);
    }
    return rc;
}

static enum err_code tour_model(struct tour *t, struct err *e)
{
    struct ckpt c = {0};
    size_t n = t->b->most ? (size_t)t->b->most : t->scene.n_points;
    bool trained = t->b->trained != t->b->scene; /* that is its default */
    enum err_code rc = ERR_OK;
    if (!trained && !t->scene.n_points)
        return err_set(e, ERR_DATA, "bench_tour: the scene has no sparse points: give --trained");
    if (trained)
        rc = ckpt_read(t->b->trained, &c, e);
    if (!rc)
        rc = tour_arrays(t, trained ? c.g.n : n, trained ? c.g.sh_degree : TOUR_DEGREE, e);
    if (!rc && trained) {
        memcpy(t->model.origin_enu_m, c.g.origin_enu_m, sizeof c.g.origin_enu_m);
        rc = render_model_write(t->render, &t->model, 0, &c.g, e);
    } else if (!rc) {
        rc = tour_scatter(t, e);
    }
    ckpt_free(&c);
    return rc;
}

/* The camera of a photograph, and smaller or larger with --edge-px. */
static struct camera tour_camera(const struct tour *t, size_t i)
{
    const struct camera *c = &t->scene.images[i].cam;
    double edge = fmax(c->width_px, c->height_px), k = t->b->edge_px / edge;
    if (!t->b->edge_px)
        return *c;
    return camera_resize(c, (uint32_t)fmax(1.0, c->width_px * k),
                         (uint32_t)fmax(1.0, c->height_px * k));
}

/* A picture for the largest of them. */
static enum err_code tour_grey(struct tour *t, struct err *e)
{
    size_t most = 0;
    for (size_t i = 0; i < t->scene.n_images; i++) {
        struct camera c = tour_camera(t, i);
        size_t px = (size_t)c.width_px * c.height_px;
        most = px > most ? px : most;
    }
    uint8_t *grey = mem_array(most, 3);
    if (!grey)
        return err_set(e, ERR_MEM, "bench_tour: out of memory for %zu pixels", most);
    memset(grey, TOUR_GREY, 3 * most);
    enum err_code rc = dev_buffer(t->b->dev, 3 * most, grey, &t->target, e);
    mem_free(grey);
    return rc;
}

static enum err_code tour_open(struct tour *t, struct err *e)
{
    enum err_code rc = scene_read(t->b->scene, &t->scene, e);
    if (!rc && !t->scene.n_images)
        rc = err_set(e, ERR_DATA, "bench_tour: %s has no photographs", t->b->scene);
    if (!rc)
        rc = render_open(t->b->dev, &t->render, e);
    if (!rc)
        rc = photometric_open(t->b->dev, &t->loss, e);
    t->all.adam = (struct render_adam){
        .beta1 = 0.9f, .beta2 = 0.999f, .eps = 1e-15f, .scale_log_min = -12, .scale_log_max = 8};
    if (!rc)
        rc = tour_model(t, e);
    if (!rc)
        rc = defer_open(t->render, &t->defer, e);
    if (rc)
        return rc;
    size_t lanes = (size_t)t->model.groups * LAYOUT_LANES * sizeof(float);
    cl_mem *const mems[] = {&t->stats.grad, &t->stats.count, &t->stats.radius, &t->stats.repaired};
    for (size_t i = 0; !rc && i < sizeof mems / sizeof *mems; i++) {
        rc = dev_buffer(t->b->dev, lanes, NULL, mems[i], e);
        if (!rc)
            rc = dev_zero(t->b->dev, *mems[i], 0, lanes, e);
    }
    t->seen.adam = t->all.adam; /* the same moments */
    return !rc ? tour_grey(t, e) : rc;
}

/* ---- steps ---- */

/* Step `nth` of a kind; below 0 it is not counted. */
static enum err_code tour_step(struct tour *t, const struct camera *cam, bool deferred,
                               ptrdiff_t nth, struct err *e)
{
    const struct render_options o = {.aa = RENDER_AA_2D, .sh_degree = -1};
    struct tour_kind *kind = deferred ? &t->seen : &t->all;
    struct render_adam *adam = &kind->adam;
    struct render_model seen = t->model;
    enum err_code rc = dev_finish(t->b->dev, e);
    double since = clock_s(), cpu_since = clock_cpu_s();
    if (!rc && deferred)
        rc = defer_see(t->defer, &t->model, adam, cam, &o, &seen, e);
    if (!rc)
        rc = render_forward(t->render, &seen, cam, &o, NULL, NULL, e);
    const struct photometric_input in = {.color = render_color_buffer(t->render),
                                         .target = t->target,
                                         .width_px = cam->width_px,
                                         .height_px = cam->height_px,
                                         .l1_weight = PHOTOMETRIC_L1_WEIGHT,
                                         .ssim_weight = PHOTOMETRIC_SSIM_WEIGHT};
    if (!rc)
        rc = photometric_run(t->loss, &in, render_color_grad_buffer(t->render), e);
    adam->step++;
    if (!rc)
        rc = render_backward_step(t->render, &seen, adam, &t->stats, e);
    if (!rc && deferred)
        rc = defer_stepped(t->defer, adam, e);
    if (!rc)
        rc = dev_finish(t->b->dev, e);
    if (nth < 0)
        return rc;
    kind->ms[nth] = (clock_s() - since) * 1e3;
    kind->cpu_ms[nth] = (clock_cpu_s() - cpu_since) * 1e3;
    if (deferred)
        t->share[nth] = (double)seen.groups / (double)t->model.groups;
    return rc;
}

static void tour_report(struct tour *t, const char *what, double *all, double *seen, size_t n)
{
    char name[96];
    sort_doubles(all, n);
    sort_doubles(seen, n);
    snprintf(name, sizeof name, "%u k, %s of a step of all", t->model.n / 1000, what);
    bench_report(t->b, name, all[n / 2], "ms", 0, NULL);
    snprintf(name, sizeof name, "%u k, %s of a step in the frustum", t->model.n / 1000, what);
    bench_report(t->b, name, seen[n / 2], "ms", seen[n / 2] / all[n / 2], "all");
}

/* At random with repetition. */
static struct camera tour_next(const struct tour *t, ptrdiff_t i)
{
    double at = rng_unit(TOUR_SEED, 99, (size_t)(i + TOUR_WARM));
    return tour_camera(t, (size_t)(at * (double)t->scene.n_images));
}

static double tour_median(double *x, size_t n)
{
    sort_doubles(x, n);
    return x[n / 2];
}

static enum err_code tour_run(struct tour *t, struct err *e)
{
    ptrdiff_t n = t->b->runs < TOUR_RUNS_MAX ? t->b->runs : TOUR_RUNS_MAX;
    enum err_code rc = ERR_OK;
    char name[96];
    for (ptrdiff_t i = -TOUR_WARM; !rc && i < n; i++) {
        struct camera cam = tour_next(t, i);
        bool turn = i & 1;
        rc = tour_step(t, &cam, turn, i, e);
        if (!rc)
            rc = tour_step(t, &cam, !turn, i, e);
    }
    if (rc)
        return rc;
    tour_report(t, "time", t->all.ms, t->seen.ms, (size_t)n);
    tour_report(t, "CPU time", t->all.cpu_ms, t->seen.cpu_ms, (size_t)n);
    snprintf(name, sizeof name, "%u k, in the frustum", t->model.n / 1000);
    bench_report(t->b, name, 100.0 * tour_median(t->share, (size_t)n), "%", 0, NULL);
    return ERR_OK;
}

enum err_code bench_tour(struct bench *b, struct err *e)
{
    struct tour *t = mem_array(1, sizeof *t);
    if (!t)
        return err_set(e, ERR_MEM, "bench_tour: out of memory");
    t->b = b;
    enum err_code rc = b->scene ? tour_open(t, e) : err_set(e, ERR_ARG, "tour: give --scene");
    if (!rc)
        rc = tour_run(t, e);
    tour_free(t);
    mem_free(t);
    return rc;
}
