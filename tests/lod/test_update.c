/* Stores made from stores: a retrained cell changes only what it touches, and two areas are merged
 * without losing or doubling a Gaussian.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <math.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "core/splat/camera.h"
#include "lod/choose/view.h"
#include "lod/make/merge.h"
#include "lod/make/pyramid.h"
#include "lod/make/update.h"
#include "lod/store/store.h"
#include "lod/store/tree.h"
#include "render/render.h"

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
                deepest = index_find(store_tree(s)->index, k);
            assert_true(tree_leaf(store_tree(s), deepest));
        }
        gauss_free(&g);
    }
}

static void a_cell_changes_what_it_touches(void **state)
{
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
    bool *in_west = mem_array(n_old, sizeof *in_west);
    memcpy(old, t, n_old * sizeof *old);
    for (size_t i = 0; i < n_old; i++)
        in_west[i] = store_shape(s, &t[i]).max_enu_m[0] < 0;
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
        bool west_only = in_west[i];
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

    east[2].antialiased = true;
    kit_fails(update_build(path, &c, path, &rep, &e), ERR_DATA, e, "anti-aliasing");
    for (size_t l = 1; l <= 3; l++) {
        gauss_free(&west[l]);
        gauss_free(&east[l]);
        gauss_free(&all[l]);
    }
    mem_free(old);
    mem_free(in_west);
    kit_rmdir(dir);
}

/* ---- twice is once ---- */

#define HARD_BORDER_M 0.1

static bool owns_beyond_border(void *user, double x_m, double y_m)
{
    (void)user;
    (void)y_m;
    return x_m >= HARD_BORDER_M;
}

/* Rows of the ground east (side 1) or west (-1) of the border, as hard as it gets: some so near to
 * it, or to the edge of a tile, that float32 about a tile's centre puts them across, one far above.
 */
static void hard_rows(uint64_t seed, size_t n, int side, struct gauss *g)
{
    struct err e = {0};
    rows(seed, n, side > 0 ? 0.2 : -200, side > 0 ? 200 : 0, g);
    for (size_t i = 0; i < n; i++) {
        double west, south, east, north, at[3];
        g->sh[3 * i] = (float)rng_normal(seed, 60, i);
        if (i % 3 == 0) {
            key_bounds(key_of(&origin, g, i, 20), &west, &south, &east, &north);
            kit_ok(geo_to_enu(&origin, 0.5 * (west + east), south, 160, at, &e), e);
            g->mean_m[3 * i + 1] = (float)(at[1] + 1e-5 * rng_normal(seed, 61, i));
        }
        if (i % 7 == 0) { /* a millionth of a metre beyond: up to some ulp of what is stored */
            g->mean_m[3 * i] = (float)HARD_BORDER_M;
            while (owns_beyond_border(NULL, (double)g->mean_m[3 * i], 0) != (side > 0))
                g->mean_m[3 * i] = nextafterf(g->mean_m[3 * i], side > 0 ? 1.0f : -1.0f);
        }
        if (i == 3)
            g->mean_m[3 * i + 2] = 9000;
    }
}

/* Tiles of one store that the other lacks or has otherwise. */
static size_t n_different(const char *path_a, const char *path_b, size_t *n_all)
{
    struct err e = {0};
    struct store *a, *b;
    size_t na, nb, differ = 0;
    kit_ok(store_open(path_a, &a, &e), e);
    kit_ok(store_open(path_b, &b, &e), e);
    const struct store_tile *t = store_tiles(a, &na), *other;
    store_tiles(b, &nb);
    for (size_t i = 0; i < na; i++) {
        other = store_find(b, t[i].key);
        differ += !other || other->hash.lo != t[i].hash.lo || other->hash.hi != t[i].hash.hi;
    }
    for (size_t i = 0; i < nb; i++)
        differ += !store_find(a, store_tiles(b, &nb)[i].key);
    *n_all = na;
    store_close(&a);
    store_close(&b);
    return differ;
}

struct scene3 { /* three levels, two cells; the east is trained again */
    struct gauss all[4], east[4];
    struct pyramid_level levels[3];
    struct update_config c;
};

static void scene_make(struct scene3 *x, size_t n_levels, size_t per_level)
{
    struct err e = {0};
    *x = (struct scene3){.c = {.owns = owns_beyond_border, .may_own = may_own_east}};
    for (size_t l = 1; l <= n_levels; l++) {
        struct gauss west;
        hard_rows(40 + l, per_level << (2 * l), 1, &x->all[l]);
        hard_rows(50 + l, per_level << (2 * l), -1, &west);
        kit_ok(gauss_append(&x->all[l], &west, NULL, west.n, &e), e);
        hard_rows(60 + l, per_level << (2 * l), 1, &x->east[l]);
        for (size_t i = 0; l == 3 && i < x->east[l].n; i++) /* ground without the finest level */
            if (x->east[l].mean_m[3 * i] > 120)
                x->east[l].mean_m[3 * i] -= 100;
        x->levels[l - 1] = (struct pyramid_level){.g = &x->all[l], .level = (uint8_t)l};
        x->c.level[l] = &x->east[l];
        gauss_free(&west);
    }
}

static void scene_free3(struct scene3 *x)
{
    for (size_t l = 1; l <= 3; l++) {
        gauss_free(&x->all[l]);
        gauss_free(&x->east[l]);
    }
}

static void the_same_cell_twice_is_once(void **state)
{
    char dir[FILE_PATH_MAX], path[3][FILE_PATH_MAX];
    struct err e = {0};
    struct update_report first, again;
    static const struct {
        size_t n_levels, per_level;
        bool lossless;
        uint32_t max_per_tile; /* of the update */
    } cases[] = {
        {3, 150, true, 0},    {3, 150, false, 0},  {1, 1500, false, 0},
        {1, 1500, true, 0},   {3, 150, false, 40}, /* tiles that are too full: also overviews */
        {1, 1500, false, 60},
    };
    kit_tmpdir(dir);
    for (size_t i = 0; i < 3; i++)
        kit_ok(file_join(path[i], dir, (const char *[]){"0", "1", "2"}[i], &e), e);
    log_set_level(LOG_ERROR);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct scene3 x;
        struct pyramid_config cfg = config;
        size_t n_all, bad;
        struct store *s;
        cfg.lossless = cases[i].lossless;
        cfg.tile_edge_m = 30;
        scene_make(&x, cases[i].n_levels, cases[i].per_level);
        x.c.max_per_tile = cases[i].max_per_tile;
        kit_ok(
            pyramid_build(&origin, x.levels, cases[i].n_levels, &cfg, NULL, 0, path[0], NULL, &e),
            e);
        kit_ok(update_build(path[0], &x.c, path[1], &first, &e), e);
        assert_true(n_different(path[0], path[1], &n_all) > n_all / 4);
        kit_ok(update_build(path[1], &x.c, path[2], &again, &e), e);
        size_t differ = n_different(path[1], path[2], &n_all);
        if (differ)
            fail_msg("case %zu: %zu of %zu tiles change when nothing does", i, differ, n_all);
        assert_string_equal(first.revision, again.revision);
        assert_int_equal(again.n_removed, 0);
        kit_ok(store_open(path[2], &s, &e), e);
        kit_ok(store_verify(s, &bad, &e), e);
        assert_no_holes(s);
        store_close(&s);
        scene_free3(&x);
    }
    log_set_level(LOG_INFO);
    kit_rmdir(dir);
}

/* ---- an update is what tiling all cells again would be ---- */

/* The same rows, whatever their order and the tile's centre; means to what float32 rounds. */
static void same_rows(const struct gauss *a, const struct gauss *b)
{
    assert_int_equal(a->n, b->n);
    for (size_t i = 0; i < a->n; i++) {
        size_t found = SIZE_MAX;
        for (size_t r = 0; r < b->n && found == SIZE_MAX; r++)
            if (!memcmp(a->sh + 3 * i, b->sh + 3 * r, 12) &&
                !memcmp(a->quat_wxyz + 4 * i, b->quat_wxyz + 4 * r, 16))
                found = r;
        assert_true(found != SIZE_MAX);
        assert_memory_equal(a->scale_log + 3 * i, b->scale_log + 3 * found, 12);
        assert_memory_equal(a->opacity_logit + i, b->opacity_logit + found, 4);
        for (size_t k = 0; k < 3; k++) {
            double at = (double)a->mean_m[3 * i + k] + a->origin_enu_m[k];
            double other = (double)b->mean_m[3 * found + k] + b->origin_enu_m[k];
            assert_true(fabs(at - other) < 1e-4);
        }
    }
}

/* All tiles of a zoom from 400 m above. */
static void picture_of(struct store *s, uint8_t z, double *rgb, uint32_t width, uint32_t height)
{
    struct err e = {0};
    struct gauss g = {0};
    size_t n;
    const struct store_tile *t = store_tiles(s, &n);
    const struct render_options ro = {.aa = RENDER_AA_2D, .sh_degree = -1};
    const double eye[3] = {0, 0, 400};
    struct camera cam = camera_heading(eye, 0, -90, 1.0, width, height);
    kit_ok(gauss_alloc(&g, 0, 0, 0, &e), e);
    for (size_t i = 0; i < n; i++) {
        struct gauss x;
        if (t[i].key.z != z)
            continue;
        kit_ok(store_read_gauss(s, t[i].key, &x, &e), e);
        kit_ok(gauss_append(&g, &x, NULL, x.n, &e), e);
        gauss_free(&x);
    }
    kit_ok(render_ref_forward(&g, &cam, &ro, rgb, NULL, &e), e);
    gauss_free(&g);
}

/* Does the tile, or one below it, keep another centre than a full build gives it? Then means differ
 * in the last bits, and what is made of them may in a choice of whom to merge. */
static bool is_moved(struct store *su, struct store *sf, struct key over)
{
    size_t n;
    const struct store_tile *t = store_tiles(sf, &n);
    for (size_t i = 0; i < n; i++) {
        const struct store_tile *u = store_find(su, t[i].key);
        struct key k = t[i].key;
        while (k.z > over.z)
            k = key_parent(k);
        if (!u || key_compare(k, over))
            continue;
        const struct store_shape a = store_shape(su, u), b = store_shape(sf, &t[i]);
        if (memcmp(a.center_enu_m, b.center_enu_m, sizeof a.center_enu_m))
            return true;
    }
    return false;
}

static void an_update_is_what_a_full_build_gives(void **state)
{
    enum { W = 64, H = 48, LEVELS = 2 };
    static double a[W * H * 3], b[W * H * 3];
    char dir[FILE_PATH_MAX], updated[FILE_PATH_MAX], full[FILE_PATH_MAX];
    struct err e = {0};
    kit_tmpdir(dir);
    kit_ok(file_join(updated, dir, "updated", &e), e);
    kit_ok(file_join(full, dir, "full", &e), e);
    for (int lossless = 0; lossless < 2; lossless++) {
        struct gauss before[LEVELS + 1], after[LEVELS + 1], east[LEVELS + 1];
        struct pyramid_level lb[LEVELS], la[LEVELS];
        struct update_config c = {.owns = owns_east, .may_own = may_own_east};
        struct pyramid_config cfg = config;
        struct store *su, *sf;
        cfg.lossless = lossless;
        cfg.tile_edge_m = 30;
        for (size_t l = 1; l <= LEVELS; l++) {
            rows(70 + l, (size_t)300 << (2 * l), 0.01, 200, &before[l]);
            rows(80 + l, (size_t)300 << (2 * l), -200, -0.01, &after[l]);
            rows(90 + l, (size_t)300 << (2 * l), 0.01, l == 2 ? 150 : 200, &east[l]);
            for (size_t i = 0; i < 3 * after[l].n; i++) { /* colours */
                before[l].sh[i] = (float)rng_normal(70 + l, 200, i);
                after[l].sh[i] = (float)rng_normal(80 + l, 200, i);
                east[l].sh[i] = (float)rng_normal(90 + l, 200, i);
            }
            kit_ok(gauss_append(&before[l], &after[l], NULL, after[l].n, &e), e);
            kit_ok(gauss_append(&after[l], &east[l], NULL, east[l].n, &e), e);
            lb[l - 1] = (struct pyramid_level){.g = &before[l], .level = (uint8_t)l};
            la[l - 1] = (struct pyramid_level){.g = &after[l], .level = (uint8_t)l};
            c.level[l] = &east[l];
        }
        kit_ok(pyramid_build(&origin, lb, LEVELS, &cfg, NULL, 0, updated, NULL, &e), e);
        kit_ok(update_build(updated, &c, updated, NULL, &e), e);
        kit_ok(pyramid_build(&origin, la, LEVELS, &cfg, NULL, 0, full, NULL, &e), e);
        kit_ok(store_open(updated, &su, &e), e);
        kit_ok(store_open(full, &sf, &e), e);
        size_t nu, nf, equal = 0, moved = 0;
        const struct store_tile *tf = store_tiles(sf, &nf);
        store_tiles(su, &nu);
        assert_int_equal(nu, nf);
        for (size_t i = 0; i < nf; i++) {
            const struct store_tile *tu = store_find(su, tf[i].key);
            struct gauss gu, gf;
            assert_non_null(tu);
            assert_int_equal(tu->level, tf[i].level);
            assert_int_equal(tu->count, tf[i].count);
            bool same = tu->hash.lo == tf[i].hash.lo && tu->hash.hi == tf[i].hash.hi;
            bool other_center = is_moved(su, sf, tf[i].key);
            equal += same;
            moved += other_center;
            if (lossless)
                assert_true(same || other_center);
            if (tf[i].level == 0)
                continue;
            kit_ok(store_read_gauss(su, tf[i].key, &gu, &e), e);
            kit_ok(store_read_gauss(sf, tf[i].key, &gf, &e), e);
            same_rows(&gu, &gf);
            gauss_free(&gu);
            gauss_free(&gf);
        }
        assert_true(equal > nf / 2 && moved < nf / 2);
        picture_of(su, store_info(su)->zoom_min, a, W, H);
        picture_of(sf, store_info(sf)->zoom_min, b, W, H);
        double sum = 0;
        for (size_t i = 0; i < W * H * 3; i++)
            sum += (a[i] - b[i]) * (a[i] - b[i]) / (W * H * 3);
        if (!(sum < 1e-4))
            fail_msg("overviews differ by %.1f dB", -10 * log10(sum));
        store_close(&su);
        store_close(&sf);
        for (size_t l = 1; l <= LEVELS; l++) {
            gauss_free(&before[l]);
            gauss_free(&after[l]);
            gauss_free(&east[l]);
        }
    }
    kit_rmdir(dir);
}

/* ---- in the middle of an update ---- */

/* A child process that may write files of `bytes` at most and then dies (`dies`) or is told; its
 * exit code, or minus the signal. */
static int update_with_limit(const char *path, const struct update_config *c, size_t bytes,
                             bool dies)
{
    int status = 0;
    pid_t child = fork();
    assert_true(child >= 0);
    if (child == 0) {
        struct rlimit r = {bytes, bytes};
        struct err e = {0};
        signal(SIGXFSZ, dies ? SIG_DFL : SIG_IGN);
        if (setrlimit(RLIMIT_FSIZE, &r))
            _exit(99);
        enum err_code rc = update_build(path, c, path, NULL, &e);
        _exit(!rc ? 0 : rc == ERR_IO && strstr(e.msg, "city.tiles") ? 1 : 2);
    }
    assert_int_equal(waitpid(child, &status, 0), child);
    return WIFSIGNALED(status) ? -WTERMSIG(status) : WEXITSTATUS(status);
}

static void a_death_in_the_middle_leaves_the_old_store(void **state)
{
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], copy[FILE_PATH_MAX];
    struct err e = {0};
    struct buf before = {0}, after = {0}, now = {0};
    struct scene3 x;
    size_t done = 0, killed = 0, refused = 0, left = 0, bad;
    enum { STEPS = 12 };
    kit_tmpdir(dir);
    kit_ok(file_join(path, dir, "city.tiles", &e), e);
    kit_ok(file_join(copy, dir, "copy", &e), e);
    scene_make(&x, 3, 40);
    log_set_level(LOG_ERROR);
    kit_ok(pyramid_build(&origin, x.levels, 3, &config, NULL, 0, path, NULL, &e), e);
    kit_ok(file_read(path, 0, &before, &e), e);
    kit_ok(update_build(path, &x.c, copy, NULL, &e), e);
    kit_ok(file_read(copy, 0, &after, &e), e);
    for (size_t i = 0; i <= 2 * STEPS + 1; i++) {
        size_t limit = (after.size + 4096) * (i / 2) / STEPS;
        struct store *s;
        int got = update_with_limit(path, &x.c, limit, i % 2);
        killed += got == -SIGXFSZ;
        refused += got == 1;
        left += kit_run(NULL, "ls '%s' | grep part-", dir) == 0;
        assert_true(got == 0 || got == (i % 2 ? -SIGXFSZ : 1));
        now.size = 0;
        kit_ok(file_read(path, 0, &now, &e), e);
        if (got != 0) {
            assert_int_equal(now.size, before.size);
            assert_memory_equal(now.data, before.data, now.size);
        }
        kit_ok(store_open(path, &s, &e), e);
        kit_ok(store_verify(s, &bad, &e), e);
        store_close(&s);
        done += got == 0;
        kit_ok(file_write(path, before.data, before.size, &e), e);
    }
    assert_true(done == 2 && killed == STEPS && refused == STEPS);
    /* Who is killed leaves what it was writing beside; the next one removes it. Who can still speak
     * leaves nothing. */
    assert_in_range(left, 1, STEPS);
    assert_int_equal(kit_run(NULL, "ls '%s' | grep part-", dir), 1);
    log_set_level(LOG_INFO);
    scene_free3(&x);
    buf_free(&before);
    buf_free(&after);
    buf_free(&now);
    kit_rmdir(dir);
}

/* Two overlapping areas, the second about another origin, tiled finer and less deep: every row is
 * there, where it was on Earth. */
static void two_areas_become_one(void **state)
{
    char dir[FILE_PATH_MAX], a[FILE_PATH_MAX], b[FILE_PATH_MAX], out[FILE_PATH_MAX];
    struct err e = {0};
    struct gauss ga, gb;
    struct merge_report rep;
    struct store *s, *sb;
    const struct geo_origin other = {8.6851, 50.1120, 140};
    struct pyramid_config ca = config, cb = config;
    kit_tmpdir(dir);
    kit_ok(file_join(a, dir, "a.tiles", &e), e);
    kit_ok(file_join(b, dir, "b.tiles", &e), e);
    kit_ok(file_join(out, dir, "c.tiles", &e), e);
    rows(31, 4000, -200, 200, &ga);
    rows(32, 3000, -200, 200, &gb);
    const struct pyramid_level la = {.g = &ga, .level = 3}, lb = {.g = &gb, .level = 2};
    cb.tile_edge_m = 120;
    memcpy(ca.attribution, "Bureau; A", 10);
    memcpy(cb.attribution, "A; B", 5);
    kit_ok(pyramid_build(&origin, &la, 1, &ca, NULL, 0, a, NULL, &e), e);
    kit_ok(pyramid_build(&other, &lb, 1, &cb, NULL, 0, b, NULL, &e), e);
    log_set_level(LOG_ERROR);
    kit_ok(merge_build(a, b, "both", out, &rep, &e), e);
    log_set_level(LOG_INFO);
    kit_ok(store_open(out, &s, &e), e);
    kit_ok(store_open(b, &sb, &e), e);
    assert_string_equal(store_info(s)->name, "both");
    assert_string_equal(store_info(s)->attribution, "Bureau; A; B");
    assert_in_range((uint64_t)(1e5 * rep.turn_deg), 100,
                    400); /* 214 m east: 0.0019 degrees of longitude */
    assert_no_holes(s);
    /* Leaves hold every row once. */
    size_t n, leaves = 0;
    const struct store_tile *t = store_tiles(s, &n);
    for (size_t i = 0; i < n; i++)
        leaves += tree_leaf(store_tree(s), i) ? t[i].count : 0;
    assert_int_equal(leaves, ga.n + gb.n);
    /* A row of b stands where it stood. */
    double want[3], lon, lat, h,
        enu[3] = {(double)gb.mean_m[0], (double)gb.mean_m[1], (double)gb.mean_m[2]};
    kit_ok(geo_from_enu(&other, enu, &lon, &lat, &h, &e), e);
    kit_ok(geo_to_enu(&origin, lon, lat, h, want, &e), e);
    double best = HUGE_VAL;
    for (size_t i = 0; i < n; i++) {
        struct gauss g;
        if (!tree_leaf(store_tree(s), i))
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

/* Two neighbours, each with a single tile on top, get overviews until one tile holds both, once. */
static void neighbours_get_a_common_overview(void **state)
{
    char dir[FILE_PATH_MAX], path[3][FILE_PATH_MAX];
    struct err e = {0};
    struct gauss g;
    struct store *s;
    const struct geo_origin east = {8.7021, 50.1109, 160}; /* 1430 m to the east */
    kit_tmpdir(dir);
    for (size_t i = 0; i < 3; i++)
        kit_ok(file_join(path[i], dir, (const char *[]){"a", "b", "c"}[i], &e), e);
    rows(33, 3000, -150, 150, &g);
    for (size_t i = 0; i < g.n; i++)
        g.sh[3 * i] = 0.5f;
    const struct pyramid_level level = {.g = &g, .level = 1};
    struct pyramid_config other = config;
    memcpy(other.name, "east", 5);
    kit_ok(pyramid_build(&origin, &level, 1, &config, NULL, 0, path[0], NULL, &e), e);
    kit_ok(pyramid_build(&east, &level, 1, &other, NULL, 0, path[1], NULL, &e), e);
    kit_ok(merge_build(path[0], path[1], NULL, path[2], NULL, &e), e);
    kit_ok(store_open(path[2], &s, &e), e);
    size_t n, at_zoom[KEY_ZOOM_MAX + 1] = {0}, n_tiles[KEY_ZOOM_MAX + 1] = {0};
    const struct store_tile *t = store_tiles(s, &n);
    for (size_t i = 0; i < n; i++) {
        at_zoom[t[i].key.z] += t[i].count;
        n_tiles[t[i].key.z]++;
    }
    uint8_t z0 = store_info(s)->zoom_min, z1 = store_info(s)->zoom_max;
    assert_int_equal(n_tiles[z0], 1);
    assert_int_equal(at_zoom[z1], 2 * g.n);
    for (uint8_t z = z0; z < z1; z++) /* a quarter each, and what rounding up adds */
        assert_in_range(at_zoom[z], at_zoom[z + 1] / 4, at_zoom[z + 1] / 4 + 16 * n_tiles[z + 1]);
    assert_no_holes(s);
    store_close(&s);
    gauss_free(&g);
    kit_rmdir(dir);
}

/* SH turned with the frame: far apart, so that the turn is large, a Gaussian looks the same from
 * the same place on Earth. */
static void views_turn_with_the_frame(void **state)
{
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
        if (t[i].level != 1 || fabs(store_shape(s, &t[i]).center_enu_m[0]) < 1e5)
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
        cmocka_unit_test(the_same_cell_twice_is_once),
        cmocka_unit_test(an_update_is_what_a_full_build_gives),
        cmocka_unit_test(a_death_in_the_middle_leaves_the_old_store),
        cmocka_unit_test(two_areas_become_one),
        cmocka_unit_test(neighbours_get_a_common_overview),
        cmocka_unit_test(views_turn_with_the_frame),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
