/* F22 (popping and holes) and F23 (altitude) on a store of tiles whose finest level is known.
 *
 * The city is ground and boxes of flat Gaussians. The truth of a view is a model drawn at three
 * times the size and averaged down, as a camera would see it. Even the finest level does not draw
 * that exactly. The pyramid makes all coarser tiles.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "lod/choose/pick.h"
#include "lod/choose/view.h"
#include "lod/make/pyramid.h"
#include "tests/stability/toy.h"

enum { W = 240, H = 180, OVER = 3, VALUES = W * H * 3 };
#define CITY_HALF_M 160.0
#define SPACING_M 1.0
#define LENS_PX 0.5 /* blur of the camera, standard deviation */

/* Of PSNR between frames 1 m apart, beyond what the finest level loses there; and of the mean loss
 * of all frames. */
struct flight_limit {
    double jump_db, mean_db;
};
#define F22_HOLE (1.0 / 255) /* with culling against without */
enum { F22_STEPS = 60 };
#define F23_HEIGHT_M 500.0
#define F23_FEWER 3.0
#define F23_LOSS_DB 0.3 /* with splats refined to half a pixel */
#define F23_ERROR_PX 0.5
#define F23_DEFAULT_LOSS_DB 0.8 /* with one pixel, the default: 16 times fewer, 0.5 dB */
#define F23_MODEL_ERROR 0.15    /* amplitude of colour: no-LOD pictures of 24 to 30 dB */
enum { F23_PX = 80 };

static const struct geo_origin origin = {8.6821, 50.1109, 160};
static const struct render_options draw = {
    .aa = RENDER_AA_2D, .background = {0.5f, 0.6f, 0.7f}, .sh_degree = -1};

static char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
static struct render *render;
static struct view *view;
static struct gauss finest;       /* all of it, in one piece */
static struct render_model whole; /* the same on the device: no tiles, no culling */

/* ---- the city ---- */

/* Smooth noise, period about `scale_m`, -1 .. 1. */
static double noise(double x, double y, double scale_m, uint64_t stream)
{
    double u = x / scale_m, v = y / scale_m, fu = floor(u), fv = floor(v), sum = 0.0;
    double s = u - fu, t = v - fv;
    s = s * s * (3.0 - 2.0 * s);
    t = t * t * (3.0 - 2.0 * t);
    for (int k = 0; k < 4; k++) {
        uint64_t at = (uint64_t)(fu + (k & 1) + 4096.0) * 8192 + (uint64_t)(fv + (k >> 1) + 4096.0);
        sum +=
            (k & 1 ? s : 1.0 - s) * (k >> 1 ? t : 1.0 - t) * (2.0 * rng_unit(7, stream, at) - 1.0);
    }
    return sum;
}

/* A disc with its normal along `axis`; `error` is of its colour, over metres. */
static void city_disc(struct gauss *g, const double at[3], size_t axis, double tone, double error)
{
    struct err e = {0};
    size_t i = g->n;
    kit_ok(gauss_reserve(g, i + 1, &e), e);
    g->n = i + 1;
    double texture = 0.12 * noise(at[0] + at[2], at[1] - at[2], 12.0, 20) +
                     0.12 * noise(at[0] - at[2], at[1] + at[2], 3.0, 21) +
                     0.10 * rng_normal(7, 22, i);
    for (size_t k = 0; k < 3; k++) {
        g->mean_m[3 * i + k] = (float)at[k];
        g->scale_log[3 * i + k] = (float)log(k == axis ? 0.05 : 0.6 * SPACING_M);
        double tint = 0.05 * noise(at[0], at[1], 40.0, 23 + k) +
                      error * noise(at[0] + at[2], at[1] - at[2], 6.0, 26 + k);
        g->sh[3 * i + k] = (float)((tone + texture + tint - 0.5) / GAUSS_SH_C0);
    }
    g->quat_wxyz[4 * i] = 1.0f;
    g->quat_wxyz[4 * i + 1] = g->quat_wxyz[4 * i + 2] = g->quat_wxyz[4 * i + 3] = 0.0f;
    g->opacity_logit[i] = 2.5f;
}

static double city_height(double x, double y)
{
    double bx = floor(x / 40.0), by = floor(y / 40.0);
    double u = x - 40.0 * bx, v = y - 40.0 * by;
    if (u < 12.0 || u > 32.0 || v < 12.0 || v > 30.0)
        return 0.0;
    return 5.0 + floor(15.0 * rng_unit(7, 30, (uint64_t)((bx + 64.0) * 128.0 + by + 64.0)));
}

static void city_make(double error, struct gauss *g)
{
    struct err e = {0};
    kit_ok(gauss_alloc(g, 1 << 17, 0, 0, &e), e);
    g->antialiased = true;
    for (double x = -CITY_HALF_M; x < CITY_HALF_M; x += SPACING_M)
        for (double y = -CITY_HALF_M; y < CITY_HALF_M; y += SPACING_M) {
            double h = city_height(x, y), at[3] = {x, y, h};
            city_disc(g, at, 2, h > 0.0 ? 0.55 : 0.4, error);
            for (size_t axis = 0; axis < 2; axis++) { /* walls where the height jumps */
                double next = city_height(x + (axis == 0 ? SPACING_M : 0.0),
                                          y + (axis == 1 ? SPACING_M : 0.0));
                for (double z = fmin(h, next); z < fmax(h, next); z += SPACING_M) {
                    double wall[3] = {x, y, z};
                    city_disc(g, wall, axis, 0.65, error);
                }
            }
        }
}

static int setup(void **state)
{
    struct err e = {0};
    const struct pyramid_config cfg = {.tile_edge_m = 40, .name = "city", .lossless = true};
    struct pyramid_report report;
    if (toy_open_device(state))
        return -1;
    kit_tmpdir(dir);
    kit_ok(file_join(path, dir, "city.tiles", &e), e);
    city_make(0.0, &finest);
    const struct pyramid_level level = {.g = &finest, .level = 3};
    kit_ok(pyramid_build(&origin, &level, 1, &cfg, NULL, 0, path, &report, &e), e);
    kit_ok(render_open(&toy_dev, &render, &e), e);
    kit_ok(view_open(path, render, 0, &view, &e), e);
    kit_ok(render_model_upload(render, &finest, &whole, &e), e);
    return 0;
}

static int teardown(void **state)
{
    view_close(&view);
    render_model_free(&whole);
    render_close(&render);
    gauss_free(&finest);
    kit_rmdir(dir);
    return toy_close_device(state);
}

/* ---- views ---- */

/* One axis of what a camera does: a pixel's width and a lens' blur of half a pixel, on samples. */
static void see(const float *in, size_t n_in, size_t stride_in, float *out, size_t n_out,
                size_t stride_out)
{
    const double sigma = OVER * sqrt(1.0 / 12 + LENS_PX * LENS_PX);
    for (size_t i = 0; i < n_out; i++) {
        double sum = 0.0, weight = 0.0, center = OVER * ((double)i + 0.5) - 0.5;
        size_t from = center > 4.0 * sigma ? (size_t)(center - 4.0 * sigma) : 0;
        for (size_t k = from; k < n_in && (double)k < center + 4.0 * sigma; k++) {
            double d = ((double)k - center) / sigma;
            weight += exp(-0.5 * d * d);
            sum += exp(-0.5 * d * d) * (double)in[k * stride_in];
        }
        out[i * stride_out] = (float)(sum / weight);
    }
}

/* Pictures up to W x H. */
static void truth_of(const struct render_model *model, const struct camera *cam, float *rgb)
{
    struct err e = {0};
    static float large[OVER * OVER * VALUES], rows[OVER * VALUES];
    size_t w = cam->width_px, h = cam->height_px;
    struct camera big = camera_resize(cam, OVER * cam->width_px, OVER * cam->height_px);
    kit_ok(render_forward(render, model, &big, &draw, large, NULL, &e), e);
    for (size_t y = 0; y < OVER * h; y++)
        for (size_t c = 0; c < 3; c++)
            see(large + 3 * y * OVER * w + c, OVER * w, 3, rows + 3 * y * w + c, w, 3);
    for (size_t x = 0; x < w; x++)
        for (size_t c = 0; c < 3; c++)
            see(rows + 3 * x + c, OVER * h, 3 * w, rgb + 3 * x + c, h, 3 * w);
}

static uint64_t picture_of(const struct camera *cam, const struct pick_options *po, float *rgb)
{
    struct err e = {0};
    struct view_stats stats;
    kit_ok(view_render(view, cam, &draw, po, rgb, &stats, &e), e);
    return stats.n_gaussians;
}

/* Along a street and over the roofs, 1 m a frame, turning a little. */
static struct camera on_the_path(size_t i)
{
    const double eye[3] = {-70.0 + (double)i, -110.0 + 0.05 * (double)i, 45.0};
    return camera_heading(eye, 20.0 + 0.2 * (double)i, -28.0, 0.9, W, H);
}

struct flight {
    double worst_db, mean_db, share;
    size_t changes; /* frames at which the set of tiles changed */
};

struct leg { /* the path's truth, and what the finest level makes of it: the same for all flights */
    float *truth; /* [F22_STEPS][VALUES] */
    double fine_db[F22_STEPS];
    uint64_t fine_sum;
};

static void leg_make(struct leg *l)
{
    static float fine[VALUES];
    const struct pick_options no_lod = {.no_lod = true, .whole_tiles = true}; /* as fly counts */
    *l = (struct leg){.truth = mem_array((size_t)F22_STEPS * VALUES, sizeof(float))};
    assert_non_null(l->truth);
    for (size_t i = 0; i < F22_STEPS; i++) {
        struct camera cam = on_the_path(i);
        truth_of(&whole, &cam, l->truth + i * VALUES);
        l->fine_sum += picture_of(&cam, &no_lod, fine);
        l->fine_db[i] = toy_psnr(fine, l->truth + i * VALUES, VALUES);
    }
}

/* Fly the path with these options. The jump of a frame is by how much its PSNR changes against the
 * frame before, beyond the change that the finest level shows there: up or down, both are seen. */
static struct flight fly(const struct leg *l, const struct pick_options *po)
{
    static float lod[VALUES];
    struct flight f = {0};
    double before = 0.0;
    uint64_t n_before = 0, sum = 0;
    struct pick_options tiles = *po;
    tiles.whole_tiles = true; /* the same picture, and a number that only other tiles change */
    for (size_t i = 0; i < F22_STEPS; i++) {
        struct camera cam = on_the_path(i);
        uint64_t n = picture_of(&cam, &tiles, lod);
        double loss = l->fine_db[i] - toy_psnr(lod, l->truth + i * VALUES, VALUES);
        if (i) {
            f.worst_db = fmax(f.worst_db, fabs(loss - before));
            f.changes += n != n_before;
        }
        before = loss;
        n_before = n;
        sum += n;
        f.mean_db += loss / F22_STEPS;
    }
    f.share = (double)sum / (double)l->fine_sum;
    return f;
}

static struct flight flown(const struct leg *l, const char *metric, const struct pick_options *po,
                           const struct flight_limit *limit)
{
    struct flight f = fly(l, po);
    kit_figure("F22",
               "metric=%s worst_jump_db=%.2f limit=%.2f mean_loss_db=%.2f limit=%.2f changes=%zu "
               "gaussians_share=%.2f",
               metric, f.worst_db, limit->jump_db, f.mean_db, limit->mean_db, f.changes, f.share);
    assert_true(f.worst_db <= limit->jump_db);
    assert_true(f.mean_db <= limit->mean_db);
    return f;
}

static void flying_over_the_city_does_not_pop(void **state)
{
    const struct pick_options screen = {0}, coarse = {.error_px = 2.0};
    const struct pick_options distance = {.metric = PICK_DISTANCE, .distance_m = {90.0, 180.0}};
    struct leg l;
    leg_make(&l);
    struct flight f = flown(&l, "screen", &screen, &(struct flight_limit){0.1, 0.15}),
                  c = flown(&l, "screen-2px", &coarse, &(struct flight_limit){1.5, 2.5});
    (void)flown(&l, "distance-90-180", &distance, &(struct flight_limit){0.5, 4.5});
    mem_free(l.truth);
    assert_true(f.changes > 5); /* levels did change on the way */
    assert_true(f.share <= 1.0 && c.share < f.share);
}

static void culled_tiles_leave_no_hole(void **state)
{
    static float culled[VALUES], all[VALUES];
    const struct pick_options no_lod = {.no_lod = true};
    struct err e = {0};
    double worst = 0.0, share = 0.0;
    for (size_t i = 0; i < F22_STEPS; i += 4) {
        struct camera cam = on_the_path(i);
        share += (double)picture_of(&cam, &no_lod, culled) / (double)finest.n / (F22_STEPS / 4);
        kit_ok(render_forward(render, &whole, &cam, &draw, all, NULL, &e), e);
        worst = fmax(worst, toy_max_diff(culled, all, VALUES));
    }
    kit_figure("F22", "culling_max_difference=%.6f limit=%.6f drawn_share=%.2f", worst, F22_HOLE,
               share);
    assert_true(share < 0.8); /* something was culled */
    assert_true(worst <= F22_HOLE);
}

/* Photographs of a city whose colours differ from the model's by as much as trained models miss
 * theirs: a loss of level of detail counts beside that. In the pictures the finest Gaussians stand
 * a quarter of a pixel apart, as those of 180 m with two million do in photographs of 1000 px. */
static void from_high_up_far_fewer_are_drawn(void **state)
{
    static float photo[VALUES], lod[VALUES], fine[VALUES];
    const struct pick_options no_lod = {.no_lod = true};
    const double eye[3] = {0.0, 0.0, F23_HEIGHT_M};
    struct camera cam = camera_heading(eye, 30.0, -90.0, 0.6, F23_PX, F23_PX);
    struct gauss real = {0};
    struct render_model seen = {0};
    struct err e = {0};
    const size_t values = (size_t)F23_PX * F23_PX * 3;
    city_make(F23_MODEL_ERROR, &real);
    kit_ok(render_model_upload(render, &real, &seen, &e), e);
    truth_of(&seen, &cam, photo);
    uint64_t n_fine = picture_of(&cam, &no_lod, fine);
    double db_fine = toy_psnr(fine, photo, values);
    assert_true(db_fine > 24.0 && db_fine < 30.0); /* as good as trained models are */
    for (int k = 0; k < 2; k++) {
        struct pick_options po = {.error_px = k ? 0.0 : F23_ERROR_PX}; /* and the default */
        uint64_t n = picture_of(&cam, &po, lod);
        double fewer = (double)n_fine / (double)n, loss = db_fine - toy_psnr(lod, photo, values);
        double limit = k ? F23_DEFAULT_LOSS_DB : F23_LOSS_DB;
        kit_figure("F23",
                   "error_px=%s height_m=%.0f fewer=%.1f limit=%.1f loss_db=%.2f limit=%.2f "
                   "no_lod_db=%.2f",
                   k ? "default" : "0.5", F23_HEIGHT_M, fewer, F23_FEWER, loss, limit, db_fine);
        assert_true(fewer >= F23_FEWER);
        assert_true(loss < limit);
    }
    render_model_free(&seen);
    gauss_free(&real);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(flying_over_the_city_does_not_pop),
        cmocka_unit_test(culled_tiles_leave_no_hole),
        cmocka_unit_test(from_high_up_far_fewer_are_drawn),
    };
    return cmocka_run_group_tests_name("lod", tests, setup, teardown);
}
