/* Map views: depth maps of the renderer, the measures, the truth that synth writes, and its
 * conversion to a scene's frame.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/render/render_kit.h"
#include "tests/scene/city_kit.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "codec/container/npy.h"
#include "codec/scene/colmap.h"
#include "codec/scene/scene.h"
#include "core/layout.h"
#include "lab/truth/map_views.h"
#include "lab/truth/synth_views.h"
#include "render/render_ref.h"
#include "train/loss/metric.h"

enum { WIDTH = 53, HEIGHT = 37, PIXELS = WIDTH * HEIGHT };
#define DEPTH_REL 1e-5 /* float sums of some hundred terms */

static const struct render_options options = {.aa = RENDER_AA_2D, .sh_degree = -1};

/* ---- depth maps ---- */

struct maps {
    float rgb[3 * PIXELS], median[PIXELS], mean[PIXELS], front[PIXELS], left[PIXELS];
    float near[PIXELS], far[PIXELS], met[PIXELS];
};

static struct camera front_camera(void)
{
    const double eye[3] = {0, -10, 0}, target[3] = {0, 0, 0};
    return camera_look_at(eye, target, 0.9, WIDTH, HEIGHT);
}

/* The last frame's median by itself, which is drawn without what the other maps need. */
static void median_alone_is_the_same(struct render_surface *s, const float *want)
{
    static float alone[PIXELS];
    struct err e = {0};
    kit_ok(render_surface_run(s, NULL, &(struct render_surface_maps){.median_m = alone}, &e), e);
    assert_memory_equal(alone, want, sizeof alone);
}

static void draw(struct render *r, const struct gauss *g, const float *limit, struct maps *out)
{
    struct err e = {0};
    struct render_model m = {0};
    struct render_surface *s = NULL;
    struct camera cam = front_camera();
    const struct render_surface_maps maps = {.median_m = out->median,
                                             .mean_m = out->mean,
                                             .front = out->front,
                                             .transmittance = out->left};
    kit_ok(render_surface_open(r, &s, &e), e);
    kit_ok(render_model_upload(r, g, &m, &e), e);
    kit_ok(render_forward(r, &m, &cam, &options, out->rgb, NULL, &e), e);
    kit_ok(render_surface_run(s, limit, &maps, &e), e);
    median_alone_is_the_same(s, out->median);
    render_surface_close(&s);
    render_model_free(&m);
}

/* A faint ball at 6 m before a solid one at 10 m, on the axis. */
static void two_balls(struct gauss *g)
{
    kit_gauss(1, 2, 1.0, 0, 0, g);
    for (int i = 0; i < 2; i++) {
        const float place[3] = {0, i ? 0.0f : -4.0f, 0};
        for (int k = 0; k < 3; k++) {
            g->mean_m[3 * i + k] = place[k];
            g->scale_log[3 * i + k] = logf(1.0f);
        }
        g->opacity_logit[i] = i ? logf(0.95f / 0.05f) : logf(0.3f / 0.7f);
    }
}

static void median_is_the_surface_behind_a_faint_ball(void **state)
{
    struct gauss g = {0};
    static struct maps m;
    float limit[PIXELS];
    size_t at = (HEIGHT / 2) * WIDTH + WIDTH / 2;
    for (size_t i = 0; i < PIXELS; i++)
        limit[i] = 9.5f;
    two_balls(&g);
    draw(render, &g, limit, &m);
    double front = (double)m.front[at], all = 1.0 - (double)m.left[at];
    assert_true(fabs(front - 0.3) < 0.005); /* the anti-aliasing kernel takes a little */
    assert_true(all > 0.95);
    assert_true(fabs((double)m.median[at] - 10.0) < 1e-4);
    double mean = (front * 6.0 + (all - front) * 10.0) / all;
    assert_true(fabs((double)m.mean[at] - mean) < 1e-4);
    assert_true(m.median[0] == 0.0f && m.left[0] > 0.5f); /* a corner that nothing covers */
    gauss_free(&g);
}

static void maps_of_a_crowd_agree_with_the_picture(void **state)
{
    struct gauss g = {0};
    struct err e = {0};
    struct dev other = dev;
    struct render *shape = NULL;
    static struct maps a, b;
    float limit[PIXELS];
    size_t surface = 0, off = 0;
    kit_gauss(6, 300, 3.0, 0, 0, &g);
    for (size_t i = 0; i < g.n; i += 3)
        g.opacity_logit[i] = 10.0f;
    for (size_t i = 0; i < 3 * g.n; i++)
        g.scale_log[i] += logf(2.5f); /* large enough to cover each other */
    for (size_t i = 0; i < PIXELS; i++)
        limit[i] = INFINITY;
    draw(render, &g, limit, &a);
    other.vector_width = dev.vector_width == 1 ? LAYOUT_LANES : 1;
    kit_ok(render_open(&other, &shape, &e), e);
    draw(shape, &g, limit, &b);
    for (size_t i = 0; i < PIXELS; i++) {
        double drawn = 1.0 - (double)a.left[i];
        assert_true(fabs((double)a.front[i] - drawn) < DEPTH_REL * 10); /* all is before infinity */
        assert_true((a.median[i] > 0.0f) == (a.left[i] <= 0.5f));
        surface += a.median[i] > 0.0f;
        off += a.median[i] != b.median[i] ||
               fabs((double)a.mean[i] - (double)b.mean[i]) > 1e-3 * (double)a.mean[i];
    }
    if (!(surface > PIXELS / 8 && surface < PIXELS))
        fail_msg("%zu pixels of %d have a surface", surface, PIXELS);
    assert_true(off <= 4); /* pixels at a threshold */
    render_close(&shape);
    gauss_free(&g);
}

/* A 3 x 3 matrix, row-major. */
static void invert(const double m[9], double out[9])
{
    double det = 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            int a = (i + 1) % 3, b = (i + 2) % 3, c = (j + 1) % 3, d = (j + 2) % 3;
            out[3 * j + i] = m[3 * a + c] * m[3 * b + d] - m[3 * a + d] * m[3 * b + c];
        }
    for (int j = 0; j < 3; j++)
        det += m[j] * out[3 * j];
    for (int i = 0; i < 9; i++)
        out[i] /= det;
}

/* Where the ray of a pixel meets the most of a splat, in double. */
static double depth_on_ray(const struct ref_view *v, const struct ref_splat *s, double px,
                           double py)
{
    double axes[9], cov[9] = {0}, inv[9], num = 0, den = 0, reach = 0, z = s->cam[2];
    double x = (px - v->cx) / v->fx, y = (py - v->cy) / v->fy;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            axes[3 * i + k] = 0;
            for (int j = 0; j < 3; j++)
                axes[3 * i + k] += v->rot[3 * i + j] * s->rot[3 * j + k];
        }
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            for (int k = 0; k < 3; k++)
                cov[3 * i + j] += axes[3 * i + k] * axes[3 * j + k] * s->scale[k] * s->scale[k];
    invert(cov, inv);
    const double ray[3] = {v->orthographic ? 0 : x, v->orthographic ? 0 : y, 1};
    const double from[3] = {v->orthographic ? x : 0, v->orthographic ? y : 0, 0};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            num += ray[i] * inv[3 * i + j] * (s->cam[j] - from[j]);
            den += ray[i] * inv[3 * i + j] * ray[j];
        }
    reach = (double)LAYOUT_EXTENT_MAX * sqrt(cov[8]);
    return fmax(fmin(fmax(num / den, z - reach), z + reach), v->near_m);
}

struct replay { /* of a pixel, in double */
    double median, mean, near, far, met;
    double clear; /* how far transmittance stays from the thresholds */
};

static void reference_depth(const struct ref_view *v, const struct ref_splat *s, size_t n,
                            double px, double py, struct replay *out)
{
    const double at[] = {0.5, (double)LAYOUT_SURFACE_OPEN, (double)LAYOUT_SURFACE_OPAQUE};
    double *const to[] = {&out->median, &out->near, &out->far};
    double t = 1, sum = 0;
    *out = (struct replay){.clear = 1};
    for (size_t i = 0; i < n && t > (double)LAYOUT_TRANSMITTANCE_MIN; i++) {
        double d[2], alpha, depth;
        bool clamped;
        if (!ref_alpha(&s[i], px, py, d, &alpha, &clamped))
            continue;
        depth = depth_on_ray(v, &s[i], px, py);
        sum += alpha * t * depth;
        out->met += t > at[2];
        for (size_t k = 0; k < 3; k++) {
            if (t > at[k] && t * (1 - alpha) <= at[k])
                *to[k] = depth;
            out->clear = fmin(out->clear, fabs(t * (1 - alpha) - at[k]));
        }
        t *= 1 - alpha;
    }
    out->mean = t < 1 ? sum / (1 - t) : 0;
}

/* Discs at all angles, through a perspective and a parallel camera. */
static void depths_are_those_on_the_ray(void **state)
{
    for (int ortho = 0; ortho < 2; ortho++) {
        (void)state;
        struct gauss g = {0};
        struct err e = {0};
        struct render_model m = {0};
        struct render_surface *s = NULL;
        struct render_options o = options;
        struct ref_view v;
        struct ref_splat *splats = NULL;
        static struct maps got;
        struct camera cam = front_camera();
        size_t n = 0, compared = 0, tilted = 0, opaque = 0, met_off = 0;
        kit_gauss(16, 200, 3.0, 0, 0, &g);
        for (size_t i = 0; i < g.n; i++) {
            g.opacity_logit[i] = 2.0f;
            for (size_t k = 0; k < 3; k++)
                g.scale_log[3 * i + k] = logf(k == 1 ? 0.02f : 0.7f);
        }
        o.orthographic = ortho;
        if (ortho)
            cam.fx_px = cam.fy_px = 5;
        const struct render_surface_maps maps = {.median_m = got.median,
                                                 .mean_m = got.mean,
                                                 .near_m = got.near,
                                                 .far_m = got.far,
                                                 .met = got.met};
        kit_ok(render_surface_open(render, &s, &e), e);
        kit_ok(render_model_upload(render, &g, &m, &e), e);
        kit_ok(render_forward(render, &m, &cam, &o, got.rgb, NULL, &e), e);
        kit_ok(render_surface_run(s, NULL, &maps, &e), e);
        median_alone_is_the_same(s, got.median);
        kit_ok(ref_view_init(&g, &cam, &o, &v, &e), e);
        kit_ok(ref_project_all(&v, &g, &splats, &n, &e), e);
        for (size_t i = 0; i < PIXELS; i++) {
            struct replay want;
            double centre = 0;
            reference_depth(&v, splats, n, (double)(i % WIDTH) + 0.5, (double)(i / WIDTH) + 0.5,
                            &want);
            if (want.clear < 1e-3) /* float may choose another Gaussian */
                continue;
            if (fabs((double)got.median[i] - want.median) > 2e-3 * want.median ||
                fabs((double)got.mean[i] - want.mean) > 1e-3 * want.mean ||
                fabs((double)got.near[i] - want.near) > 2e-3 * want.near ||
                fabs((double)got.far[i] - want.far) > 2e-3 * want.far)
                fail_msg(
                    "%s pixel %zu: median %g, mean %g, from %g to %g instead of %g, %g, %g, %g",
                    ortho ? "parallel" : "perspective", i, (double)got.median[i],
                    (double)got.mean[i], (double)got.near[i], (double)got.far[i], want.median,
                    want.mean, want.near, want.far);
            met_off += (double)got.met[i] != want.met;
            opaque += want.far > want.near;
            compared++;
            for (size_t k = 0; k < n; k++)
                if (fabs(splats[k].cam[2] - want.median) < fabs(centre - want.median))
                    centre = splats[k].cam[2];
            tilted += want.median > 0 && fabs(centre - want.median) > 5e-3;
        }
        if (compared < PIXELS * 8 / 10 || tilted < PIXELS / 20 || opaque < PIXELS / 20)
            fail_msg("%zu pixels compared, %zu off all centres, %zu opaque", compared, tilted,
                     opaque);
        if (met_off > PIXELS / 100) /* a Gaussian at 1/255 is met by one and not by the other */
            fail_msg("%zu pixels meet another number of Gaussians", met_off);
        mem_free(splats);
        render_surface_close(&s);
        render_model_free(&m);
        gauss_free(&g);
    }
}

/* The ground seen from 2 m above it: discs as large as their distance allows. */
static void a_street_is_as_deep_as_its_plane(void **state)
{
    enum { DISCS = 400 };
    struct gauss g = {0};
    struct err e = {0};
    struct render_model m = {0};
    struct render_surface *s = NULL;
    static struct maps got;
    const double eye[3] = {0, 0, 2}, target[3] = {0, 10, 2};
    struct camera cam = camera_look_at(eye, target, 0.9, WIDTH, HEIGHT);
    double worst = 0;
    size_t n = 0;
    kit_gauss(3, DISCS, 1.0, 0, 0, &g);
    for (size_t i = 0; i < DISCS; i++) {
        const float place[3] = {2.0f * ((float)(i % 10) - 4.5f), 2.0f * (float)(i / 10), 0};
        const float quat[4] = {1, 0, 0, 0};
        memcpy(g.mean_m + 3 * i, place, sizeof place);
        memcpy(g.quat_wxyz + 4 * i, quat, sizeof quat);
        g.opacity_logit[i] = 3.0f;
        for (size_t k = 0; k < 3; k++)
            g.scale_log[3 * i + k] = logf(k == 2 ? 0.002f : 1.0f);
    }
    const struct render_surface_maps maps = {.median_m = got.median};
    kit_ok(render_surface_open(render, &s, &e), e);
    kit_ok(render_model_upload(render, &g, &m, &e), e);
    kit_ok(render_forward(render, &m, &cam, &options, got.rgb, NULL, &e), e);
    kit_ok(render_surface_run(s, NULL, &maps, &e), e);
    for (size_t y = HEIGHT / 2 + 4; y < HEIGHT; y++) {
        double plane = 2.0 * cam.fy_px / ((double)y + 0.5 - cam.cy_px);
        size_t i = y * WIDTH + WIDTH / 2;
        if (got.median[i] > 0.0f && plane < 40) {
            worst = fmax(worst, fabs((double)got.median[i] / plane - 1));
            n++;
        }
    }
    if (n < HEIGHT / 3 || !(worst < 0.02))
        fail_msg("%zu rows, depth off by %g", n, worst);
    render_surface_close(&s);
    render_model_free(&m);
    gauss_free(&g);
}

static void no_frame_is_an_error(void **state)
{
    struct err e = {0};
    struct render *fresh = NULL;
    struct render_surface *s = NULL;
    kit_ok(render_open(&dev, &fresh, &e), e);
    kit_ok(render_surface_open(fresh, &s, &e), e);
    kit_fails(render_surface_run(s, NULL, &(struct render_surface_maps){0}, &e), ERR_ARG, e,
              "no frame");
    render_surface_close(&s);
    render_close(&fresh);
}

/* ---- measures ---- */

static void within_a_mask_only_its_pixels_count(void **state)
{
    enum { W = 24, H = 20, N = W * H };
    float rgb[3 * N];
    uint8_t target[3 * N], mask[N];
    struct metric_scores all, part, again;
    double psnr, ssim, gmsd;
    struct err e = {0};
    for (size_t i = 0; i < 3 * N; i++) {
        target[i] = (uint8_t)(255.0 * rng_unit(1, 0, i));
        rgb[i] = (float)fmin(1.0, target[i] / 255.0 + 0.1 * rng_unit(1, 1, i));
    }
    memset(mask, 255, sizeof mask);
    kit_ok(metric_within(rgb, target, mask, W, H, &all, &e), e);
    kit_ok(metric_psnr(rgb, target, NULL, W, H, &psnr, &e), e);
    kit_ok(metric_ssim(rgb, target, NULL, W, H, METRIC_TRAINING, &ssim, &e), e);
    kit_ok(metric_gmsd(rgb, target, NULL, W, H, &gmsd, &e), e);
    assert_true(fabs(all.psnr_db - psnr) < 1e-9 && fabs(all.ssim - ssim) < 1e-12);
    assert_true(fabs(all.gmsd - gmsd) < 1e-12);
    for (size_t i = 0; i < N; i++)
        mask[i] = i % W < W / 2 ? 255 : 0;
    kit_ok(metric_within(rgb, target, mask, W, H, &part, &e), e);
    for (size_t i = 0; i < N; i++)
        for (size_t c = 0; c < 3 && !mask[i]; c++)
            rgb[3 * i + c] = 0.0f;
    kit_ok(metric_within(rgb, target, mask, W, H, &again, &e), e);
    assert_memory_equal(&part, &again, sizeof part);
    memset(mask, 0, sizeof mask);
    kit_fails(metric_within(rgb, target, mask, W, H, &part, &e), ERR_DATA, e, "empty");
}

static void sums_say_halo_haze_and_depth(void **state)
{
    /* A strip: 100 pixels unobserved, 100 seen by one photograph, 800 supported, and below it one
     * of pixels that are hidden, which count for nothing but gaps. */
    enum { W = 100, H = 11, N = W * 10, ALL = W * H };
    static float rgb[3 * ALL], median[ALL], front[ALL], left[ALL], depth[ALL];
    static uint8_t mask[ALL], square[ALL], px[3 * ALL];
    struct err e = {0};
    struct map_truth t = {
        .width_px = W, .height_px = H, .mask = mask, .square = square, .depth_m = depth};
    const struct map_drawing d = {rgb, median, front, left};
    struct map_sums s = {0};
    t.picture = (struct image){.width_px = W, .height_px = H, .channels = 3, .px = px};
    for (size_t i = 0; i < N; i++) {
        mask[i] = i < 100 ? 0 : i < 200 ? 128 : 255;
        depth[i] = i < 50 ? 0.0f : 100.0f;
        left[i] = i < 100 ? 0.75f : i < 200 ? 0.0f : 0.1f;
        median[i] = i < 100 ? 20.0f : 101.0f; /* 1 % behind */
        px[3 * i] = px[3 * i + 1] = px[3 * i + 2] = 128;
        for (size_t c = 0; c < 3; c++)
            rgb[3 * i + c] = i < 200 ? 0.0f : 128.0f / 255.0f + 0.1f;
    }
    for (size_t i = 100; i < 190; i++)
        median[i] = 94.0f; /* 6 % in front: haze */
    for (size_t i = 200; i < 280; i++)
        median[i] = i < 240 ? 0.0f : 96.0f; /* holes; 4 % in front: wrong, yet no haze */
    for (size_t i = 100; i < N; i++)
        front[i] = 0.25f;
    for (size_t i = N; i < ALL; i++) {
        mask[i] = 64;
        depth[i] = 100.0f;
        left[i] = 0.1f;
        median[i] = 3.0f;
        front[i] = 0.9f;
    }
    kit_ok(map_sums_add(&s, &t, &d, &e), e);
    struct map_score m = map_sums_score(&s);
    float more[3] = MAP_VIEWS_BRIGHT; /* a tenth of it shines through, 0.1 off before */
    double mse = 0.0;
    for (int c = 0; c < 3; c++)
        mse += pow(0.1 + 0.1 * (double)more[c], 2) / 3.0;
    const double got[] = {m.halo,       m.haze,        m.veil,          m.depth_median,
                          m.depth_95,   m.depth_above, m.psnr_db,       m.supported,
                          m.unobserved, m.gaps,        m.bright_psnr_db};
    const double want[] = {
        0.25, 0.1, 0.25, 0.01, 0.04, 0.1, 20.0, 0.8 / 1.1, 0.1 / 1.1, 0.9, -10.0 * log10(mse)};
    kit_near_d("measures", got, want, sizeof got / sizeof *got, 0.0, 1e-4);
    assert_int_equal(m.n_supported, 1);
    assert_int_equal(m.n_square, 0);
    assert_true(isnan(m.square_psnr_db) && isnan(m.bright_square_psnr_db));
    map_sums_free(&s);
}

/* One observed pixel: halo is everything around it, fog what is farther than the edge may be
 * wide. */
static void fog_is_halo_beyond_the_edge(void **state)
{
    enum { W = 40, H = 30, N = W * H, X = 11, Y = 4 };
    static float rgb[3 * N], median[N], front[N], left[N], depth[N];
    static uint8_t mask[N], square[N], px[3 * N];
    struct err e = {0};
    struct map_truth t = {
        .width_px = W, .height_px = H, .mask = mask, .square = square, .depth_m = depth};
    const struct map_drawing d = {rgb, median, front, left};
    struct map_sums s = {0};
    double all = 0;
    t.picture = (struct image){.width_px = W, .height_px = H, .channels = 3, .px = px};
    mask[Y * W + X] = 128;
    for (size_t i = 0; i < N; i++) {
        int dx = abs((int)(i % W) - X), dy = abs((int)(i / W) - Y);
        left[i] = dx <= MAP_VIEWS_EDGE_PX && dy <= MAP_VIEWS_EDGE_PX ? 0.5f : 0.75f;
        all += mask[i] ? 0 : 1 - (double)left[i];
    }
    kit_ok(map_sums_add(&s, &t, &d, &e), e);
    struct map_score m = map_sums_score(&s);
    const double got[] = {m.fog, m.halo}, want[] = {0.25, all / (N - 1)};
    kit_near_d("fog, halo", got, want, 2, 0.0, 1e-9);
    map_sums_free(&s);
}

/* ---- the truth that synth writes ---- */

static void city_config(struct synth_config *cfg, struct arena *a, const char *dir)
{
    city_kit_config(cfg, a, dir, 24);
    cfg->width_px = 64;
    cfg->height_px = 48;
    cfg->extent_m = 90;
    cfg->points = 400;
}

static void same_file(const char *a, const char *b, const char *name)
{
    char pa[FILE_PATH_MAX], pb[FILE_PATH_MAX];
    struct buf x = {0}, y = {0};
    struct err e = {0};
    kit_ok(file_join(pa, a, name, &e), e);
    kit_ok(file_join(pb, b, name, &e), e);
    kit_ok(file_read(pa, 0, &x, &e), e);
    kit_ok(file_read(pb, 0, &y, &e), e);
    if (x.size != y.size || memcmp(x.data, y.data, x.size))
        fail_msg("%s and %s differ", pa, pb);
    buf_free(&x);
    buf_free(&y);
}

/* A scene whose frame is the truth's. */
static struct scene truth_scene(const struct synth_config *cfg)
{
    struct synth_similarity f = synth_model_frame(cfg);
    struct scene s = {.scale = f.scale};
    memcpy(s.rot, f.rot, sizeof s.rot);
    memcpy(s.trans, f.trans, sizeof s.trans);
    return s;
}

/* In the truth's own frame, against photographs and poses. */
static void check_view(const struct synth_config *cfg, const struct synth_city *city,
                       const struct synth_photo *photos, const struct map_views *v, size_t i,
                       size_t seen[3])
{
    struct err e = {0};
    struct map_truth t;
    const struct camera *cam = &v->views[i].cam;
    struct lens lens = synth_flight_lens(cfg);
    kit_ok(map_views_load(v, i, &t, &e), e);
    for (size_t k = 0; k < (size_t)t.width_px * t.height_px; k += 7) {
        double u = (double)(k % t.width_px) + 0.5, w = (double)(k / t.width_px) + 0.5;
        double ray[3] = {(u - cam->cx_px) / cam->fx_px, (w - cam->cy_px) / cam->fy_px, 1};
        double eye[3], place[3];
        size_t by = 0, framed = 0;
        seen[t.mask[k] == 255 ? 2 : t.mask[k] == 128 ? 1 : 0]++;
        assert_true(t.mask[k] == 0 || t.mask[k] == 64 || t.mask[k] == 128 || t.mask[k] == 255);
        if (!(t.depth_m[k] > 0.0f)) {
            assert_int_equal(t.mask[k], 0);
            continue;
        }
        camera_center(cam, eye);
        for (int c = 0; c < 3; c++)
            place[c] =
                eye[c] + (double)t.depth_m[k] * (cam->rot[c] * ray[0] + cam->rot[3 + c] * ray[1] +
                                                 cam->rot[6 + c] * ray[2]);
        assert_true(place[2] > -0.05);
        for (size_t p = 0; p < (size_t)cfg->photos; p++)
            if (p % (size_t)cfg->test_every) {
                by += synth_model_sees(city, &lens, &photos[p].cam, place);
                framed += synth_model_frames(&lens, &photos[p].cam, place);
            }
        /* Float depths move the place by less than what counts as the same. */
        if (t.mask[k] == 255 ? by < 3 : t.mask[k] < 128 && by > 1)
            fail_msg("view %zu pixel %zu: mask %d, %zu photographs", i, k, t.mask[k], by);
        if (t.mask[k] == 0 ? framed > 1 : framed == 0)
            fail_msg("view %zu pixel %zu: mask %d, framed by %zu", i, k, t.mask[k], framed);
    }
    map_truth_free(&t);
}

/* Squared differences of neighbours in a row, of the first view of a folder. */
static double roughness(const struct scene *s, const char *dir)
{
    struct map_views v;
    struct map_truth t;
    struct err e = {0};
    double sum = 0;
    kit_ok(map_views_read(dir, s, &v, &e), e);
    kit_ok(map_views_load(&v, 0, &t, &e), e);
    for (size_t i = 3; i < 3 * (size_t)t.width_px * t.height_px; i++) {
        double d = (double)t.picture.px[i] - (double)t.picture.px[i - 3];
        sum += d * d;
    }
    map_truth_free(&t);
    map_views_free(&v);
    return sum;
}

/* Pictures have the blur that is asked for, whatever that of the photographs. */
static void check_blur(const char *city, struct synth_views_options *again, const struct scene *s,
                       const char *dir)
{
    char out[FILE_PATH_MAX];
    struct err e = {0};
    double soft = roughness(s, dir);
    again->blur_px = 0;
    kit_ok(synth_views_run(city, again, out, &e), e);
    double sharp = roughness(s, dir);
    if (!(soft < 0.8 * sharp && soft > 0.2 * sharp))
        fail_msg("roughness %g sharp, %g blurred", sharp, soft);
}

static void synth_writes_views_that_are_true(void **state)
{
    char tmp[FILE_PATH_MAX], city_dir[FILE_PATH_MAX], own[FILE_PATH_MAX], out[FILE_PATH_MAX];
    char more[FILE_PATH_MAX];
    struct synth_config cfg;
    struct synth_views_options first = {.count = 8, .seed = 1, .blur_px = 0.6};
    struct arena a = {0};
    struct err e = {0};
    struct map_views v;
    struct synth_city city = {0};
    struct synth_photo photos[24];
    size_t seen[3] = {0}, kinds = 0;
    kit_tmpdir(tmp);
    snprintf(city_dir, sizeof city_dir, "%.3000s/city", tmp);
    snprintf(own, sizeof own, "%.3000s/city/map-views", tmp);
    snprintf(more, sizeof more, "%.3000s/more", tmp);
    city_config(&cfg, &a, city_dir);
    kit_ok(synth_run(&cfg, &e), e);
    kit_ok(synth_views_run(city_dir, &first, out, &e), e);
    assert_string_equal(out, own);
    /* More of them: the first are the same. */
    struct synth_views_options again = first;
    again.output = more;
    again.count = 9;
    kit_ok(synth_views_run(city_dir, &again, out, &e), e);
    assert_string_equal(out, more);
    struct scene s = truth_scene(&cfg);
    kit_ok(map_views_read(own, &s, &v, &e), e);
    assert_int_equal(v.n, 8);
    assert_true(fabs(v.scale - 1) < 1e-12);
    kit_ok(synth_city_make(&cfg, &city, &e), e);
    synth_flight_make(&cfg, photos);
    for (size_t i = 0; i < v.n; i++) {
        static const char *const tails[] = {".png", ".npy", ".json", "_mask.png", "_square.png"};
        for (size_t k = 0; k < sizeof tails / sizeof *tails; k++) {
            char name[96];
            snprintf(name, sizeof name, "%s%s", v.views[i].name, tails[k]);
            same_file(own, more, name);
        }
        bool known = false;
        for (size_t k = 0; k < i; k++)
            known = known || !strcmp(v.views[k].kind, v.views[i].kind);
        kinds += !known;
        check_view(&cfg, &city, photos, &v, i, seen);
    }
    assert_int_equal(kinds, 6);
    assert_true(seen[0] > 100 && seen[1] > 20 && seen[2] > 300);
    /* Other seeds stand elsewhere, and nothing is overwritten unasked. */
    kit_fails(synth_views_run(city_dir, &again, out, &e), ERR_ARG, e, "--overwrite");
    again.overwrite = true;
    again.seed = 2;
    again.count = 1;
    kit_ok(synth_views_run(city_dir, &again, out, &e), e);
    struct map_views w;
    kit_ok(map_views_read(more, &s, &w, &e), e);
    assert_true(memcmp(w.views[0].cam.trans, v.views[0].cam.trans, sizeof w.views[0].cam.trans));
    map_views_free(&w);
    check_blur(city_dir, &again, &s, more);
    map_views_free(&v);
    synth_city_free(&city);
    arena_free(&a);
    kit_rmdir(tmp);
}

static void write_text(const char *dir, const char *name, const char *text)
{
    char path[FILE_PATH_MAX];
    struct err e = {0};
    kit_ok(file_join(path, dir, name, &e), e);
    kit_ok(file_write(path, text, strlen(text), &e), e);
}

#define CAMERA                                                                                     \
    "{\"width\":8,\"height\":6,\"fx\":7,\"fy\":7,\"cx\":4,\"cy\":3,"                               \
    "\"world_to_camera\":[0,1,0,2, 0,0,-1,3, -1,0,0,5, 0,0,0,1]}"

static void views_move_into_the_scene(void **state)
{
    char tmp[FILE_PATH_MAX];
    struct err e = {0};
    struct map_views v;
    const double qa[4] = {0.9, 0.1, -0.3, 0.2}, qb[4] = {0.2, -0.5, 0.4, 0.7};
    struct scene s = {.scale = 3.1, .trans = {10, -20, 5}};
    double rot[9], scale = 2.2;
    const double trans[3] = {-4, 7, 1}, x[3] = {0.4, -1.7, 2.6};
    char text[2048];
    camera_quat_to_rot(qa, s.rot);
    camera_quat_to_rot(qb, rot);
    kit_tmpdir(tmp);
    write_text(tmp, "a.json", CAMERA);
    snprintf(text, sizeof text,
             "{\"format\":\"citysplat-views\",\"colmap_to_enu\":{\"scale\":%.17g,\"rot\":[%.17g,"
             "%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g],\"trans\":[%g,%g,%g]},\"views\":"
             "[{\"name\":\"a\",\"kind\":\"orbit\"}]}",
             scale, rot[0], rot[1], rot[2], rot[3], rot[4], rot[5], rot[6], rot[7], rot[8],
             trans[0], trans[1], trans[2]);
    write_text(tmp, "views.json", text);
    kit_ok(map_views_read(tmp, &s, &v, &e), e);
    /* One place of the COLMAP model, through either frame: camera coordinates scale, no more. */
    double there[3], here[3], cam_there[3] = {2, 3, 5}, got[3], want[3];
    for (int i = 0; i < 3; i++) {
        there[i] = trans[i];
        here[i] = s.trans[i];
        for (int k = 0; k < 3; k++) {
            there[i] += scale * rot[3 * i + k] * x[k];
            here[i] += s.scale * s.rot[3 * i + k] * x[k];
        }
    }
    const double w[9] = {0, 1, 0, 0, 0, -1, -1, 0, 0};
    const struct camera *c = &v.views[0].cam;
    for (int i = 0; i < 3; i++) {
        got[i] = c->trans[i];
        for (int k = 0; k < 3; k++) {
            cam_there[i] += w[3 * i + k] * there[k];
            got[i] += c->rot[3 * i + k] * here[k];
        }
    }
    for (int i = 0; i < 3; i++)
        want[i] = cam_there[i] * s.scale / scale;
    kit_near_d("camera coordinates", got, want, 3, 1e-9, 1e-9);
    assert_true(fabs(v.scale - s.scale / scale) < 1e-12);
    /* And back again. */
    struct map_move from = {.scale = scale}, to, back;
    struct camera moved = *c;
    memcpy(from.rot, rot, sizeof rot);
    memcpy(from.trans, trans, sizeof trans);
    kit_ok(map_views_move(&from, &s, &to, &e), e);
    back = map_views_move_back(&to);
    map_views_move_camera(&back, &moved);
    kit_near_d("rotation", moved.rot, w, 9, 1e-12, 0);
    kit_near_d("translation", moved.trans, (const double[3]){2, 3, 5}, 3, 1e-9, 0);
    from.scale = 0;
    kit_fails(map_views_move(&from, &s, &to, &e), ERR_FORMAT, e, "scale 0");
    map_views_free(&v);
    /* Names are files: nothing leads out of the folder. */
    char *name = strstr(text, "\"name\":\"a\"");
    memcpy(name, "\"name\":\"/\"", 10);
    write_text(tmp, "views.json", text);
    kit_fails(map_views_read(tmp, &s, &v, &e), ERR_FORMAT, e, "letters, digits");
    write_text(tmp, "views.json", "{\"format\":\"citysplat-scene\"}");
    kit_fails(map_views_read(tmp, &s, &v, &e), ERR_FORMAT, e, "instead of citysplat-views");
    kit_rmdir(tmp);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(median_is_the_surface_behind_a_faint_ball),
        cmocka_unit_test(depths_are_those_on_the_ray),
        cmocka_unit_test(a_street_is_as_deep_as_its_plane),
        cmocka_unit_test(maps_of_a_crowd_agree_with_the_picture),
        cmocka_unit_test(no_frame_is_an_error),
        cmocka_unit_test(within_a_mask_only_its_pixels_count),
        cmocka_unit_test(sums_say_halo_haze_and_depth),
        cmocka_unit_test(fog_is_halo_beyond_the_edge),
        cmocka_unit_test(synth_writes_views_that_are_true),
        cmocka_unit_test(views_move_into_the_scene),
    };
    return cmocka_run_group_tests(tests, render_kit_open, render_kit_close);
}
