/* The surface as a height field: medians on shapes whose heights are known, slanted rays against
 * the procedural city, and uncertainties against errors where Gaussians scatter.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/survey/survey_kit.h"

#include "codec/container/seen.h"
#include "core/base.h"
#include "core/pool.h"
#include "lod/surface/surface.h"

enum { SIDE = 40, PIXELS = SIDE * SIDE, PIECE = 160 };
static const struct surface_window window = {2, 4};
#define PIECE_GSD_M 0.25

struct field {
    float height[PIXELS], rgb[3 * PIXELS], out[PIXELS], spread[PIXELS];
};

static void smooth(struct field *f_)
{
    struct err e = {0};
    kit_ok(surface_smooth(f_->height, f_->rgb, SIDE, SIDE, window, f_->out, f_->spread, &e), e);
}

static void windows_grow_with_the_gaussians(void **state)
{
    const struct surface_window fine = surface_window(3.5), coarse = surface_window(0.1),
                                huge = surface_window(1e6);
    assert_true(fine.near_px == 2 && fine.far_px == 4);
    assert_true(coarse.near_px == 1 && coarse.far_px == 1);
    assert_true(huge.far_px == 32 && huge.near_px == 16);
}

/* A plane stays one, but at the border of the field, where the window is cut off. */
static void a_plane_stays(void **state)
{
    static struct field p;
    for (size_t i = 0; i < PIXELS; i++)
        p.height[i] = 0.25f * (float)(i % SIDE) + 0.5f * (float)(i / SIDE);
    smooth(&p);
    for (size_t y = 4; y < SIDE - 4; y++)
        for (size_t x = 4; x < SIDE - 4; x++)
            assert_true(fabsf(p.out[y * SIDE + x] - p.height[y * SIDE + x]) < 1e-5f);
}

/* A roof 9 m above a street, heights wrong by two pixels along its edge: colour says where it ends.
 * Without colours it stays where the heights have it. */
static void a_step_lies_where_colours_change(void **state)
{
    static struct field p;
    for (int painted = 0; painted < 2; painted++) {
        size_t end = painted ? 20 : 22;
        for (size_t i = 0; i < PIXELS; i++) {
            p.height[i] = i % SIDE < 22 ? 9 : 0;
            for (size_t k = 0; k < 3; k++)
                p.rgb[3 * i + k] = painted && i % SIDE < 20 ? 0.7f : 0.2f;
        }
        smooth(&p);
        for (size_t x = 0; x < SIDE; x++)
            assert_true(p.out[20 * SIDE + x] == (x < end ? 9.0f : 0.0f));
    }
}

/* Single pixels that are far off go; what is larger than the window's half stays; a hole stays a
 * hole and spoils nothing around it. */
static void bumps_go_and_holes_stay(void **state)
{
    static struct field p;
    size_t spike = 10 * SIDE + 10, hole = 25 * SIDE + 25;
    memset(&p, 0, sizeof p);
    p.height[spike] = 30;
    for (size_t y = 8; y < 24; y++)
        for (size_t x = 22; x < 38; x++)
            p.height[y * SIDE + x] = 3;
    p.height[hole] = NAN;
    smooth(&p);
    assert_true(p.out[spike] == 0.0f && p.spread[spike] == 0.0f);
    assert_true(p.out[16 * SIDE + 30] == 3.0f);
    assert_true(isnan(p.out[hole]) && isnan(p.spread[hole]));
    for (size_t i = 0; i < PIXELS; i++)
        assert_true(i == hole || (isfinite(p.out[i]) && isfinite(p.spread[i])));
    assert_true(p.out[hole + 1] == 0.0f);
}

static void threads_change_nothing(void **state)
{
    static struct field a, b;
    for (size_t i = 0; i < PIXELS; i++) {
        a.height[i] = (float)rng_normal(5, 1, i);
        for (size_t k = 0; k < 3; k++)
            a.rgb[3 * i + k] = (float)rng_unit(5, 2, 3 * i + k);
    }
    b = a;
    smooth(&a);
    pool_limit(1);
    smooth(&b);
    pool_limit(0);
    assert_memory_equal(a.out, b.out, sizeof a.out);
    assert_memory_equal(a.spread, b.spread, sizeof a.spread);
}

/* ---- of a store ---- */

static struct nadir_piece piece_at(double gsd_m)
{
    return (struct nadir_piece){.lon_deg = origin.lon_deg,
                                .lat_deg = origin.lat_deg,
                                .px_per_m_x = 1 / gsd_m,
                                .px_per_m_y = 1 / gsd_m,
                                .width = PIECE,
                                .height = PIECE};
}

static void pixel_at(size_t i, double gsd_m, double at[2])
{
    at[0] = ((double)(i % PIECE) + 0.5 - 0.5 * PIECE) * gsd_m;
    at[1] = (0.5 * PIECE - (double)(i / PIECE) - 0.5) * gsd_m;
}

/* Through the true surface all four sides meet it, where nothing stands in the way. */
static void slanted_rays_meet_the_surface(void **state)
{
    static float truth[PIECE * PIECE], got[PIECE * PIECE];
    const struct nadir_piece p = piece_at(PIECE_GSD_M);
    struct err e = {0};
    for (size_t i = 0; i < PIECE * PIECE; i++) {
        double at[2];
        pixel_at(i, PIECE_GSD_M, at);
        truth[i] = (float)(origin.h_m + truth_z(at[0], at[1]));
    }
    truth[77] = NAN;
    for (unsigned way = 0; way < NADIR_WAYS; way++) {
        size_t level = 0, met = 0;
        kit_ok(nadir_slant(f.nadir, &p, way, 2, truth, got, &e), e);
        assert_true(isnan(got[77]));
        for (size_t i = 0; i < PIECE * PIECE; i++) {
            double at[2];
            pixel_at(i, PIECE_GSD_M, at);
            if (i == 77 || !level_at(at[0], at[1], 0.3))
                continue;
            level++;
            met += fabsf(got[i] - truth[i]) < 0.15f;
        }
        printf("surface: from side %u %zu of %zu level places are seen\n", way, met, level);
        assert_true(level > 5000 && (double)met > 0.6 * (double)level);
    }
}

/* A store of Gaussians that scatter by scatter_m about the city's surface. */
static void loose_store(const char *name, double scatter_m, const struct store_blob *blobs,
                        size_t n_blobs, char path[FILE_PATH_MAX])
{
    struct err e = {0};
    struct gauss g;
    size_t side = (size_t)(EXTENT_M / SPACING_M);
    kit_ok(gauss_alloc(&g, side * side, 0, 0, &e), e);
    g.antialiased = true;
    g.n = 0;
    for (size_t i = 0; i < side * side; i++) {
        double x = ((double)(i % side) + rng_unit(3, 1, i)) * SPACING_M - 0.5 * EXTENT_M,
               y = ((double)(i / side) + rng_unit(3, 2, i)) * SPACING_M - 0.5 * EXTENT_M;
        if (x > 0.4 * PIECE * PIECE_GSD_M && rng_unit(3, 4, i) < 0.7)
            continue; /* a strip with holes */
        put(&g, x, y, truth_z(x, y) + scatter_m * rng_normal(3, 3, i), 0.7 * SPACING_M, 0.02, 0.95);
    }
    kit_ok(file_join(path, f.dir, name, &e), e);
    const struct pyramid_config cfg = {.tile_edge_m = 30, .name = "loose", .attribution = "ours"};
    const struct pyramid_level level = {.g = &g, .level = 3};
    kit_ok(pyramid_build(&origin, &level, 1, &cfg, blobs, n_blobs, path, NULL, &e), e);
    gauss_free(&g);
}

/* The cover of the city with discs that scatter in height: errors on level ground are about as
 * large as the uncertainty says, and smaller than those of one ray. Of overlapping discs the upper
 * ones are seen, which lifts all: errors are taken from their mean, and the uncertainty is that
 * without what all have in common. */
static void uncertainty_is_that_of_the_errors(void **state)
{
    static const double scatter_m = 0.2;
    static const struct nadir_options no = {.ceiling_m = (double)NAN};
    static float height[PIECE * PIECE], sigma[PIECE * PIECE], noise[PIECE * PIECE],
        repeat[PIECE * PIECE], single[PIECE * PIECE], rgb[3 * PIECE * PIECE];
    struct err e = {0};
    struct nadir *n;
    char path[FILE_PATH_MAX];
    size_t known = 0;
    double sum[2] = {0}, sum2[2] = {0}, sigma2 = 0;
    loose_store("loose.tiles", scatter_m, NULL, 0, path);
    kit_ok(nadir_open(path, &no, &n, &e), e);
    const struct nadir_piece p = piece_at(PIECE_GSD_M);
    const struct surface_maps maps = {
        .rgb = rgb, .height_m = height, .sigma_m = sigma, .noise_m = noise, .repeat_m = repeat};
    kit_ok(surface_draw(n, &p, &maps, &e), e);
    kit_ok(nadir_draw(n, &p, NULL, single, &e), e);
    for (size_t i = 0; i < PIECE * PIECE; i++) {
        double at[2];
        pixel_at(i, PIECE_GSD_M, at);
        double truth = origin.h_m + truth_z(at[0], at[1]);
        const double off[2] = {(double)height[i] - truth, (double)single[i] - truth};
        for (size_t k = 0; k < 3; k++) /* two kernels, one surface */
            assert_int_equal(isfinite(rgb[3 * i + k]) != 0, isfinite(height[i]) != 0);
        assert_true(!isfinite(height[i]) ||
                    (noise[i] > 0 && noise[i] <= repeat[i] && repeat[i] < sigma[i]));
        if (!isfinite(height[i]) || at[0] > 0.35 * PIECE * PIECE_GSD_M ||
            !level_at(at[0], at[1], 0.1))
            continue;
        known++;
        for (size_t k = 0; k < 2; k++) {
            sum[k] += off[k];
            sum2[k] += off[k] * off[k];
        }
        sigma2 += (double)repeat[i] * (double)repeat[i];
    }
    assert_true(known > 5000);
    double of = (double)known, rmse = sqrt(sum2[0] / of - sum[0] * sum[0] / (of * of)),
           single_rmse = sqrt(sum2[1] / of - sum[1] * sum[1] / (of * of)),
           ratio = rmse / sqrt(sigma2 / of);
    printf("surface: %zu level places, RMSE %.3f m where one ray has %.3f, of the uncertainty %.2f "
           "times; all lie %.3f m high\n",
           known, rmse, single_rmse, ratio, sum[0] / of);
    assert_true(rmse < 0.75 * single_rmse);
    assert_true(ratio > 0.6 && ratio < 1.25);
    nadir_close(&n);
}

/* ---- walls ---- */

enum { BOX_STEP = 5 /* Gaussians a metre */, BOX_GROUND = 24, BOX_EDGE = 8, BOX_TOP = 6 };
struct box_seen {
    size_t n, wall[4], off;
};

/* A box in the middle of a piece of 10 pixels a metre, right x and down -y. */
static enum err_code box_meets(void *user, const struct nadir_point *p, struct err *e)
{
    struct box_seen *s = user;
    double x = p->at_px[0] / 10 - 0.5 * BOX_GROUND, y = 0.5 * BOX_GROUND - p->at_px[1] / 10,
           z = (double)p->height_m - origin.h_m, half = 0.5 * BOX_EDGE,
           off[4] = {fabs(x - half), fabs(x + half), fabs(y - half), fabs(y + half)};
    (void)e;
    if (z < 1 || z > BOX_TOP - 1)
        return ERR_OK;
    s->n++;
    bool near = false;
    for (size_t k = 0; k < 4; k++) {
        double along = k < 2 ? y : x;
        bool on = off[k] < 0.2 && fabs(along) < half + 0.2;
        s->wall[k] += on;
        near = near || on;
    }
    s->off += !near;
    return ERR_OK;
}

static void slanted_rays_find_walls(void **state)
{
    static const struct nadir_options no = {.ceiling_m = (double)NAN};
    static float height[BOX_GROUND * 10 * BOX_GROUND * 10];
    enum { N = BOX_GROUND * BOX_STEP, M = BOX_EDGE * BOX_STEP, T = BOX_TOP * BOX_STEP };
    struct box_seen seen = {0};
    struct err e = {0};
    struct gauss g;
    struct nadir *n;
    char path[FILE_PATH_MAX];
    const double step = 1.0 / BOX_STEP, half = 0.5 * BOX_EDGE;
    kit_ok(gauss_alloc(&g, N * N + 4 * M * T, 0, 0, &e), e);
    g.antialiased = true;
    g.n = 0;
    for (size_t i = 0; i < N * N; i++) {
        double x = ((double)(i % N) + 0.5) * step - 0.5 * BOX_GROUND,
               y = ((double)(i / N) + 0.5) * step - 0.5 * BOX_GROUND;
        put(&g, x, y, fabs(x) < half && fabs(y) < half ? BOX_TOP : 0, 0.12, 0.05, 0.99);
    }
    for (size_t i = 0; i < 4 * M * T; i++) {
        size_t side = i / (M * T);
        double along = ((double)(i % M) + 0.5) * step - half,
               z = ((double)(i / M % T) + 0.5) * step, at = side % 2 ? half : -half;
        put(&g, side < 2 ? at : along, side < 2 ? along : at, z, 0.1, 0.1, 0.99);
    }
    kit_ok(file_join(path, f.dir, "box.tiles", &e), e);
    const struct pyramid_config cfg = {.tile_edge_m = 30, .name = "box", .attribution = "ours"};
    const struct pyramid_level level = {.g = &g, .level = 3};
    kit_ok(pyramid_build(&origin, &level, 1, &cfg, NULL, 0, path, NULL, &e), e);
    gauss_free(&g);
    kit_ok(nadir_open(path, &no, &n, &e), e);
    const struct nadir_piece p = {.lon_deg = origin.lon_deg,
                                  .lat_deg = origin.lat_deg,
                                  .px_per_m_x = 10,
                                  .px_per_m_y = 10,
                                  .width = BOX_GROUND * 10,
                                  .height = BOX_GROUND * 10};
    kit_ok(nadir_draw(n, &p, NULL, height, &e), e);
    for (unsigned way = 0; way < NADIR_WAYS; way++)
        kit_ok(nadir_slant_points(n, &p, way, height, box_meets, &seen, &e), e);
    printf("walls: %zu points between top and foot, %zu, %zu, %zu and %zu on the walls, %zu on "
           "none\n",
           seen.n, seen.wall[0], seen.wall[1], seen.wall[2], seen.wall[3], seen.off);
    for (size_t k = 0; k < 4; k++)
        assert_true(seen.wall[k] > 1000);
    assert_true(30 * seen.off < seen.n); /* at corners */
    nadir_close(&n);
}

/* Where the west is seen by two photographs and the east by many, the west is uncertain by the same
 * part more, and the east as if the store did not know. */
static void few_photographs_are_uncertain(void **state)
{
    static const struct nadir_options no = {.ceiling_m = (double)NAN};
    static float repeat[2][PIECE * PIECE], height[2][PIECE * PIECE];
    struct err e = {0};
    struct buf blob = {0};
    enum { CELLS = 20 };
    uint8_t views[CELLS * CELLS];
    const struct seen_grid seen = {
        .corner_m = {-100, -100}, .cell_m = 10, .nx = CELLS, .ny = CELLS, .views = views};
    for (size_t i = 0; i < CELLS * CELLS; i++)
        views[i] = i % CELLS < CELLS / 2 ? 2 : SEEN_VIEWS_MAX;
    size_t west = 0, east = 0;
    kit_ok(seen_encode(&seen, &blob, &e), e);
    const struct store_blob kept = {SEEN_BLOB, blob.data, blob.size};
    for (size_t k = 0; k < 2; k++) {
        struct nadir *n;
        char path[FILE_PATH_MAX];
        loose_store(k ? "seen.tiles" : "unseen.tiles", 0.2, &kept, k, path);
        kit_ok(nadir_open(path, &no, &n, &e), e);
        const struct nadir_piece p = piece_at(PIECE_GSD_M);
        const struct surface_maps maps = {.height_m = height[k], .repeat_m = repeat[k]};
        kit_ok(surface_draw(n, &p, &maps, &e), e);
        nadir_close(&n);
    }
    double least = HUGE_VAL, most = 0;
    for (size_t i = 0; i < PIECE * PIECE; i++) {
        double at[2], before = (double)repeat[0][i], now = (double)repeat[1][i];
        pixel_at(i, PIECE_GSD_M, at);
        assert_int_equal(isfinite(before) != 0, isfinite(now) != 0);
        if (!isfinite(before))
            continue;
        assert_true(height[0][i] == height[1][i]);
        if (at[0] > 5) { /* middles of cells: values between them are interpolated */
            assert_true(now == before);
            east++;
        } else if (at[0] < -5) {
            double part = sqrt(fmax(now * now - before * before, 0));
            least = fmin(least, part);
            most = fmax(most, part);
            west++;
        }
    }
    assert_true(west > 1000 && east > 1000);
    assert_true(least > 0.05 && most < 1.01 * least);
    buf_free(&blob);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(windows_grow_with_the_gaussians),
        cmocka_unit_test(a_plane_stays),
        cmocka_unit_test(a_step_lies_where_colours_change),
        cmocka_unit_test(bumps_go_and_holes_stay),
        cmocka_unit_test(threads_change_nothing),
        cmocka_unit_test(slanted_rays_meet_the_surface),
        cmocka_unit_test(uncertainty_is_that_of_the_errors),
        cmocka_unit_test(few_photographs_are_uncertain),
        cmocka_unit_test(slanted_rays_find_walls),
    };
    return cmocka_run_group_tests(tests, survey_setup, survey_teardown);
}
