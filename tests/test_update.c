/* Stores made of stores: a retrained cell changes what it touches and nothing else, and two areas
 * become one without losing or doubling a Gaussian.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lod/lod.h"
#include "lod/tree.h"

static const struct geo_origin origin = {8.6821, 50.1109, 160};
static const struct pyramid_config config = {.tile_edge_m = 60, .lossless = true, .name = "u"};

/* n rows over a rectangle; the first SH value is the row's number. */
static void rows(uint64_t seed, size_t n, double x0, double x1, struct gauss *g)
{
    kit_gauss(seed, n, 200, 0, 0, g);
    for (size_t i = 0; i < n; i++) {
        g->mean_m[3 * i] = (float)(x0 + (x1 - x0) * rng_unit(seed, 40, i));
        g->mean_m[3 * i + 2] *= 0.1f;
        for (size_t k = 0; k < 3; k++)
            g->scale_log[3 * i + k] = (float)log(0.1 + 0.4 * rng_unit(seed, 50 + k, i));
        g->sh[3 * i] = (float)i;
    }
}

static bool owns_east(void *user, double x_m, double y_m)
{
    (void)user;
    (void)y_m;
    return x_m >= 0;
}

static bool may_own_east(void *user, const double lo[3], const double hi[3])
{
    (void)user;
    (void)lo;
    return hi[0] >= 0;
}

static struct key key_of(const struct geo_origin *o, const struct gauss *g, size_t i, uint8_t z)
{
    struct err e = {0};
    double lon, lat, h, enu[3];
    for (size_t k = 0; k < 3; k++)
        enu[k] = (double)g->mean_m[3 * i + k] + g->origin_enu_m[k];
    kit_ok(geo_from_enu(o, enu, &lon, &lat, &h, &e), e);
    return key_at(lon, lat, z);
}

/* Rows of a level at its own zoom: each in the tile that owns it. Returns how many. */
static size_t count_level(struct store *s, uint8_t level, uint8_t top)
{
    struct err e = {0};
    size_t n, total = 0;
    const struct store_tile *t = store_tiles(s, &n);
    for (size_t i = 0; i < n; i++) {
        struct gauss g;
        if (t[i].level != level || t[i].key.z != store_info(s)->zoom_max - (top - level))
            continue;
        kit_ok(store_read_gauss(s, t[i].key, &g, &e), e);
        total += g.n;
        for (size_t r = 0; r < g.n; r++)
            assert_int_equal(
                key_compare(key_of(&store_info(s)->origin, &g, r, t[i].key.z), t[i].key), 0);
        gauss_free(&g);
    }
    return total;
}

/* Refining all the way never loses a place. */
static void assert_no_holes(struct store *s)
{
    struct err e = {0};
    size_t n;
    const struct store_tile *t = store_tiles(s, &n);
    for (size_t i = 0; i < n; i++) {
        struct gauss g;
        kit_ok(store_read_gauss(s, t[i].key, &g, &e), e);
        for (size_t r = 0; r < g.n; r++) {
            uint32_t deepest = TREE_NONE;
            struct key k = key_of(&store_info(s)->origin, &g, r, KEY_ZOOM_MAX);
            for (; deepest == TREE_NONE; k = key_parent(k))
                deepest = tree_find(t, n, k);
            assert_int_equal(store_tree(s)->nodes[deepest].child_count, 0);
        }
        gauss_free(&g);
    }
}

static void a_cell_changes_what_it_touches(void **state)
{
    (void)state;
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct err e = {0};
    struct gauss west[4], east[4], all[4];
    struct pyramid_level levels[3];
    struct update_config c = {.owns = owns_east, .may_own = may_own_east};
    struct update_report rep;
    struct store *s;
    kit_tmpdir(dir);
    kit_ok(file_join(path, dir, "u.tiles", &e), e);
    for (size_t l = 1; l <= 3; l++) {
        rows(l, (size_t)300 << (2 * l), -200, 0, &west[l]);
        rows(10 + l, (size_t)300 << (2 * l), 0, 200, &all[l]);
        kit_ok(gauss_append(&all[l], &west[l], NULL, west[l].n, &e), e);
        /* Trained again: other rows, and some ground that had none of level 3. */
        rows(20 + l, (size_t)250 << (2 * l), 0, l == 1 ? 200 : 150, &east[l]);
        levels[l - 1] = (struct pyramid_level){.g = &all[l], .level = (uint8_t)l};
        c.level[l] = &east[l];
    }
    kit_ok(pyramid_build(&origin, levels, 3, &config, NULL, 0, path, NULL, &e), e);
    kit_ok(store_open(path, &s, &e), e);
    size_t n_old, n, same = 0, changed = 0;
    const struct store_tile *t = store_tiles(s, &n_old);
    struct store_tile *old = mem_array(n_old, sizeof *old);
    memcpy(old, t, n_old * sizeof *old);
    char revision[13];
    memcpy(revision, store_info(s)->revision, sizeof revision);
    store_close(&s);

    kit_ok(update_build(path, &c, path, &rep, &e), e);
    kit_ok(store_open(path, &s, &e), e);
    assert_string_not_equal(store_info(s)->revision, revision);
    assert_string_equal(store_info(s)->revision, rep.revision);
    for (uint8_t l = 1; l <= 3; l++)
        assert_int_equal(count_level(s, l, 3), west[l].n + east[l].n);
    assert_no_holes(s);
    t = store_tiles(s, &n);
    assert_int_equal(n, rep.n_copied + rep.n_written);
    for (size_t i = 0; i < n_old; i++) {
        const struct store_tile *now = store_find(s, old[i].key);
        bool west_only = old[i].max_enu_m[0] < 0;
        if (!now)
            continue; /* the copies east of 150 m came instead */
        bool equal = now->hash.lo == old[i].hash.lo && now->hash.hi == old[i].hash.hi;
        assert_int_equal(now->version, equal ? 1 : 2);
        assert_true(equal || !west_only);
        same += equal;
        changed += !equal;
    }
    assert_true(same > n_old / 3 && changed > n_old / 3);
    size_t bad;
    kit_ok(store_verify(s, &bad, &e), e);
    /* Overviews show the new east: nothing of level 0 is missing or doubled by much. */
    size_t over = 0, over_old = 0;
    for (size_t i = 0; i < n; i++)
        over += t[i].level == 0 ? t[i].count : 0;
    for (size_t i = 0; i < n_old; i++)
        over_old += old[i].level == 0 ? old[i].count : 0;
    assert_in_range(over, over_old / 2, over_old);
    store_close(&s);

    /* The same again changes nothing. */
    kit_ok(update_build(path, &c, path, &rep, &e), e);
    kit_ok(store_open(path, &s, &e), e);
    for (uint8_t l = 1; l <= 3; l++)
        assert_int_equal(count_level(s, l, 3), west[l].n + east[l].n);
    store_close(&s);
    east[2].antialiased = true;
    kit_fails(update_build(path, &c, path, &rep, &e), ERR_DATA, e, "anti-aliasing");
    for (size_t l = 1; l <= 3; l++) {
        gauss_free(&west[l]);
        gauss_free(&east[l]);
        gauss_free(&all[l]);
    }
    mem_free(old);
    kit_rmdir(dir);
}

/* Two overlapping areas, the second about another origin, tiled finer and less deep: every row is
 * there, where it was on Earth. */
static void two_areas_become_one(void **state)
{
    (void)state;
    char dir[FILE_PATH_MAX], a[FILE_PATH_MAX], b[FILE_PATH_MAX], out[FILE_PATH_MAX];
    struct err e = {0};
    struct gauss ga, gb;
    struct merge_report rep;
    struct store *s, *sb;
    const struct geo_origin other = {8.6851, 50.1120, 140};
    struct pyramid_config cb = config;
    kit_tmpdir(dir);
    kit_ok(file_join(a, dir, "a.tiles", &e), e);
    kit_ok(file_join(b, dir, "b.tiles", &e), e);
    kit_ok(file_join(out, dir, "c.tiles", &e), e);
    rows(31, 4000, -200, 200, &ga);
    rows(32, 3000, -200, 200, &gb);
    const struct pyramid_level la = {.g = &ga, .level = 3}, lb = {.g = &gb, .level = 2};
    cb.tile_edge_m = 120;
    memcpy(cb.attribution, "B", 2);
    kit_ok(pyramid_build(&origin, &la, 1, &config, NULL, 0, a, NULL, &e), e);
    kit_ok(pyramid_build(&other, &lb, 1, &cb, NULL, 0, b, NULL, &e), e);
    log_set_level(LOG_ERROR);
    kit_ok(merge_build(a, b, "both", out, &rep, &e), e);
    log_set_level(LOG_INFO);
    kit_ok(store_open(out, &s, &e), e);
    kit_ok(store_open(b, &sb, &e), e);
    assert_string_equal(store_info(s)->name, "both");
    assert_string_equal(store_info(s)->attribution, "B");
    assert_in_range((uint64_t)(1e5 * rep.turn_deg), 100,
                    400); /* 214 m east: 0.0019 degrees of longitude */
    assert_no_holes(s);
    /* Leaves hold every row once. */
    size_t n, leaves = 0;
    const struct store_tile *t = store_tiles(s, &n);
    for (size_t i = 0; i < n; i++)
        leaves += store_tree(s)->nodes[i].child_count ? 0 : t[i].count;
    assert_int_equal(leaves, ga.n + gb.n);
    /* A row of b stands where it stood. */
    double want[3], lon, lat, h,
        enu[3] = {(double)gb.mean_m[0], (double)gb.mean_m[1], (double)gb.mean_m[2]};
    kit_ok(geo_from_enu(&other, enu, &lon, &lat, &h, &e), e);
    kit_ok(geo_to_enu(&origin, lon, lat, h, want, &e), e);
    double best = HUGE_VAL;
    for (size_t i = 0; i < n; i++) {
        struct gauss g;
        if (store_tree(s)->nodes[i].child_count)
            continue;
        kit_ok(store_read_gauss(s, t[i].key, &g, &e), e);
        for (size_t r = 0; r < g.n; r++) {
            double d2 = 0;
            for (size_t k = 0; k < 3; k++) {
                double d = (double)g.mean_m[3 * r + k] + g.origin_enu_m[k] - want[k];
                d2 += d * d;
            }
            best = fmin(best, d2);
        }
        gauss_free(&g);
    }
    assert_true(best < 1e-8); /* 0.1 mm: float32 about a tile's centre */
    store_close(&s);
    store_close(&sb);
    gauss_free(&ga);
    gauss_free(&gb);
    kit_rmdir(dir);
}

/* SH turned with the frame: far apart, so that the turn is large, a Gaussian looks the same from
 * the same place on Earth. */
static void views_turn_with_the_frame(void **state)
{
    (void)state;
    char dir[FILE_PATH_MAX], a[FILE_PATH_MAX], b[FILE_PATH_MAX], out[FILE_PATH_MAX];
    enum { W = 24, H = 20 };
    struct err e = {0};
    struct gauss one, g;
    struct store *s;
    const struct geo_origin far = {40, -20, 50};
    const struct view_pose pose = {.lon_deg = 40,
                                   .lat_deg = -20.0002,
                                   .h_m = 75,
                                   .heading_deg = 0,
                                   .pitch_deg = -45,
                                   .fov_y_deg = 30};
    const struct render_options ro = {.sh_degree = -1};
    static double before[W * H * 3], after[W * H * 3];
    struct camera cam;
    kit_tmpdir(dir);
    kit_ok(file_join(a, dir, "a.tiles", &e), e);
    kit_ok(file_join(b, dir, "b.tiles", &e), e);
    kit_ok(file_join(out, dir, "c.tiles", &e), e);
    kit_gauss(7, 40, 5, 3, 0, &one);
    for (size_t i = 0; i < one.n; i++)
        for (size_t k = 0; k < 48; k++)
            one.sh[48 * i + k] = (float)(0.35 * rng_normal(9, k, i));
    const struct pyramid_level level = {.g = &one, .level = 1};
    kit_ok(pyramid_build(&origin, &level, 1, &config, NULL, 0, a, NULL, &e), e);
    kit_ok(pyramid_build(&far, &level, 1, &config, NULL, 0, b, NULL, &e), e);
    kit_ok(view_camera(&far, &pose, W, H, &cam, &e), e);
    kit_ok(render_ref_forward(&one, &cam, &ro, before, NULL, &e), e);
    kit_ok(merge_build(a, b, NULL, out, NULL, &e), e);
    kit_ok(store_open(out, &s, &e), e);
    size_t n;
    const struct store_tile *t = store_tiles(s, &n);
    kit_ok(view_camera(&origin, &pose, W, H, &cam, &e), e);
    kit_ok(gauss_alloc(&g, 0, 3, 0, &e), e);
    for (size_t i = 0; i < n; i++) {
        struct gauss x;
        if (t[i].level != 1 || fabs(t[i].center_enu_m[0]) < 1e5)
            continue;
        kit_ok(store_read_gauss(s, t[i].key, &x, &e), e);
        if (g.n == 0)
            memcpy(g.origin_enu_m, x.origin_enu_m, sizeof g.origin_enu_m);
        kit_ok(gauss_append(&g, &x, NULL, x.n, &e), e);
        gauss_free(&x);
    }
    assert_int_equal(g.n, 40);
    kit_ok(render_ref_forward(&g, &cam, &ro, after, NULL, &e), e);
    double most = 0, sum = 0;
    for (size_t p = 0; p < W * H * 3; p++) {
        most = fmax(most, fabs(before[p] - after[p]));
        sum += before[p];
    }
    assert_true(sum > 10); /* something was to be seen */
    if (!(most < 2e-4))
        fail_msg("pictures differ by %g",
                 most); /* float32 of means 6,000 km away about a tile's centre */
    store_close(&s);
    gauss_free(&g);
    gauss_free(&one);
    kit_rmdir(dir);
}

int main(void)
{
    progress_quiet(true);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_cell_changes_what_it_touches),
        cmocka_unit_test(two_areas_become_one),
        cmocka_unit_test(views_turn_with_the_frame),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
