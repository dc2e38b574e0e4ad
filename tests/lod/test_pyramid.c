/* The pyramid: every Gaussian is in exactly one tile of its level, there are no holes under
 * REPLACE, and simplification keeps mass, colour and appearance.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/ckpt.h"
#include "codec/splat/quant.h"
#include "core/splat/camera.h"
#include "lod/make/pyramid.h"
#include "lod/make/simplify.h"
#include "lod/make/spill.h"
#include "lod/store/locate.h"
#include "lod/store/store.h"
#include "lod/store/tree.h"
#include "render/render.h"
#include "tests/kit.h"
#include "tests/lod/store_kit.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static const struct geo_origin origin = {8.6821, 50.1109, 160};

/* n Gaussians over a square of half-edge `half`, flat, small; the first SH value is the row's
 * number. */
static void city(uint64_t seed, size_t n, double half, struct gauss *g)
{
    kit_gauss(seed, n, half, 0, 0, g);
    for (size_t i = 0; i < n; i++) {
        g->mean_m[3 * i + 2] *= (float)(15 / half);
        for (size_t k = 0; k < 3; k++)
            g->scale_log[3 * i + k] = (float)log(0.1 + 0.4 * rng_unit(seed, 50 + k, i));
        g->sh[3 * i] = (float)i;
    }
}

static const struct pyramid_config config = {.tile_edge_m = 60, .lossless = true, .name = "p"};

/* Tile of a row, as the definition says. */
static struct key key_of(const double enu[3], uint8_t z)
{
    struct err e = {0};
    double lon, lat, h;
    kit_ok(geo_from_enu(&origin, enu, &lon, &lat, &h, &e), e);
    return key_at(lon, lat, z);
}

/* A pyramid of one level at f->path, opened. rep may be NULL. */
static struct store *build_open(struct store_fixture *f, const struct geo_origin *place,
                                const struct gauss *g, uint8_t level, struct pyramid_report *rep)
{
    struct err e = {0};
    struct store *s;
    const struct pyramid_level one = {.g = g, .level = level};
    log_set_level(LOG_ERROR);
    kit_ok(pyramid_build(place, &one, 1, &config, NULL, 0, f->path, rep, &e), e);
    log_set_level(LOG_INFO);
    kit_ok(store_open(f->path, &s, &e), e);
    return s;
}

/* Count how often each row of the level occurs in tiles at that level's zoom, and check ownership.
 */
static void assert_exactly_once(struct store *s, uint8_t level, uint8_t z, size_t n)
{
    struct err e = {0};
    uint8_t *seen = mem_array(n, 1);
    size_t n_tiles, total = 0;
    const struct store_tile *t = store_tiles(s, &n_tiles);
    for (size_t i = 0; i < n_tiles; i++) {
        if (t[i].level != level || t[i].key.z != z)
            continue;
        struct gauss g;
        kit_ok(store_read_gauss(s, t[i].key, &g, &e), e);
        assert_int_equal(g.n, t[i].count);
        total += g.n;
        for (size_t r = 0; r < g.n; r++) {
            double enu[3];
            for (size_t k = 0; k < 3; k++)
                enu[k] = (double)g.mean_m[3 * r + k] + g.origin_enu_m[k];
            assert_int_equal(key_compare(key_of(enu, z), t[i].key), 0);
            size_t id = (size_t)g.sh[3 * gauss_sh_count(g.sh_degree) * r];
            assert_true(id < n);
            assert_int_equal(seen[id]++, 0);
        }
        gauss_free(&g);
    }
    assert_int_equal(total, n);
    mem_free(seen);
}

static bool is_child(struct key parent, struct key k)
{
    while (k.z > parent.z)
        k = key_parent(k);
    return key_compare(k, parent) == 0;
}

/* Where any tile has a Gaussian, the deepest tile there is a leaf: refining all the way never loses
 * a place. */
static void assert_no_holes(struct store *s)
{
    struct err e = {0};
    size_t n;
    const struct store_tile *t = store_tiles(s, &n);
    const struct tree *tree = store_tree(s);
    for (size_t i = 0; i < n; i++) {
        struct gauss g;
        kit_ok(store_read_gauss(s, t[i].key, &g, &e), e);
        for (size_t r = 0; r < g.n; r++) {
            double enu[3];
            for (size_t k = 0; k < 3; k++)
                enu[k] = (double)g.mean_m[3 * r + k] + g.origin_enu_m[k];
            struct key fine = key_of(enu, KEY_ZOOM_MAX);
            uint32_t deepest = TREE_NONE;
            for (struct key k = fine; deepest == TREE_NONE; k = key_parent(k))
                deepest = index_find(tree->index, k);
            assert_true(is_child(t[i].key, t[deepest].key));
            assert_true(tree_leaf(tree, deepest));
        }
        gauss_free(&g);
    }
}

static void three_levels(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct gauss g[3];
    struct pyramid_level levels[3];
    struct pyramid_report rep;
    struct store *s;
    for (size_t l = 0; l < 3; l++) {
        city(10 + l, (size_t)500 << (2 * l), 200, &g[l]);
        levels[l] = (struct pyramid_level){.g = &g[l], .level = (uint8_t)(l + 1)};
    }
    const struct store_blob blob = {.name = "report", .data = "hello", .size_bytes = 5};
    kit_ok(pyramid_build(&origin, levels, 3, &config, &blob, 1, f->path, &rep, &e), e);
    uint8_t z = key_zoom_for(origin.lat_deg, 60);
    assert_int_equal(rep.zoom_max, z);
    kit_ok(store_open(f->path, &s, &e), e);
    assert_int_equal(store_info(s)->zoom_max, z);
    size_t n, counted[8] = {0};
    const struct store_tile *t = store_tiles(s, &n);
    assert_int_equal(n, rep.n_tiles);
    for (size_t i = 0; i < n; i++)
        if (t[i].level == 0 || t[i].key.z == z - 3 + t[i].level) /* not the carried ones */
            counted[t[i].level] += t[i].count;
    for (size_t l = 1; l <= 3; l++) {
        assert_int_equal(rep.n_gaussians[l], g[l - 1].n);
        assert_int_equal(counted[l], g[l - 1].n);
        assert_exactly_once(s, (uint8_t)l, (uint8_t)(z - 3 + l), g[l - 1].n);
    }
    assert_int_equal(counted[0], rep.n_gaussians[0]);
    assert_int_equal(t[0].level, 0); /* overviews up to one tile */
    assert_true(t[1].key.z > t[0].key.z);
    assert_no_holes(s);
    struct buf b = {0};
    kit_ok(store_get_blob(s, "report", &b, &e), e);
    assert_int_equal(b.size, 5);
    buf_free(&b);
    size_t bad;
    progress_quiet(true);
    kit_ok(store_verify(s, &bad, &e), e);
    store_close(&s);
    for (size_t l = 0; l < 3; l++)
        gauss_free(&g[l]);
}

/* Level 3 only in one corner, level 2 only in the west, level 1 everywhere, and some of level 3
 * where no level 2 is. */
static void sparse_levels_leave_no_holes(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct gauss g[3];
    struct pyramid_level levels[3];
    struct pyramid_report rep;
    struct store *s;
    for (size_t l = 0; l < 3; l++) {
        city(20 + l, (size_t)800 << l, 200, &g[l]);
        levels[l] = (struct pyramid_level){.g = &g[l], .level = (uint8_t)(l + 1)};
    }
    for (size_t i = 0; i < g[1].n; i++)
        g[1].mean_m[3 * i] = -fabsf(g[1].mean_m[3 * i]) - 20;
    for (size_t i = 0; i < g[2].n; i++)
        for (size_t k = 0; k < 2; k++)
            g[2].mean_m[3 * i + k] =
                i % 2 ? 0.2f * g[2].mean_m[3 * i + k] + 150 : -120 + 0.2f * g[2].mean_m[3 * i + k];
    kit_ok(pyramid_build(&origin, levels, 3, &config, NULL, 0, f->path, &rep, &e), e);
    assert_true(rep.n_carried_tiles > 4 && rep.n_carried > 400);
    kit_ok(store_open(f->path, &s, &e), e);
    for (size_t l = 1; l <= 3; l++)
        assert_exactly_once(s, (uint8_t)l, (uint8_t)(rep.zoom_max - 3 + l), g[l - 1].n);
    assert_no_holes(s);
    size_t n, carried = 0;
    const struct store_tile *t = store_tiles(s, &n);
    for (size_t i = 0; i < n; i++)
        carried += t[i].level && t[i].key.z != rep.zoom_max - 3 + t[i].level ? t[i].count : 0;
    assert_int_equal(carried, rep.n_carried);
    store_close(&s);
    for (size_t l = 0; l < 3; l++)
        gauss_free(&g[l]);
}

static void one_level_makes_the_coarser_ones(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct gauss g;
    struct pyramid_report rep;
    city(30, 20000, 150, &g);
    for (size_t i = 0; i < g.n; i++) /* colours from here on */
        g.sh[3 * i] = (float)(rng_unit(30, 60, i) - 0.5);
    struct store *s = build_open(f, &origin, &g, 3, &rep);
    assert_int_equal(rep.n_gaussians[3], 20000);
    assert_in_range(rep.n_gaussians[2], 5000, 5200); /* each tile rounds up */
    assert_in_range(rep.n_gaussians[1], 1250, 1500);
    assert_int_equal(rep.n_carried, 0);
    char revision[13];
    memcpy(revision, store_info(s)->revision, sizeof revision);
    size_t n;
    const struct store_tile *t = store_tiles(s, &n);
    for (size_t i = 0; i < n; i++) {
        struct gauss x;
        kit_ok(store_read_gauss(s, t[i].key, &x, &e), e);
        assert_int_equal(gauss_count_bad(&x, NULL), 0);
        for (size_t r = 0; r < x.n; r++) { /* merged means stay in the tile that holds them */
            double enu[3];
            for (size_t k = 0; k < 3; k++)
                enu[k] = (double)x.mean_m[3 * r + k] + x.origin_enu_m[k];
            assert_int_equal(key_compare(key_of(enu, t[i].key.z), t[i].key), 0);
        }
        gauss_free(&x);
    }
    assert_no_holes(s);
    store_close(&s);
    /* The same input gives the same bytes but for the date. */
    s = build_open(f, &origin, &g, 3, NULL);
    assert_string_equal(store_info(s)->revision, revision);
    store_close(&s);
    gauss_free(&g);
}

static void tiles_keep_to_the_limit_and_to_the_wish(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct gauss g;
    struct pyramid_report rep;
    struct pyramid_config c = config;
    city(40, 20000, 100, &g);
    const struct pyramid_level level = {.g = &g, .level = 1};
    c.max_per_tile = 700;
    c.tile_edge_m = 500;
    log_set_level(LOG_ERROR);
    kit_ok(pyramid_build(&origin, &level, 1, &c, NULL, 0, f->path, &rep, &e), e);
    log_set_level(LOG_INFO);
    assert_true(rep.max_in_tile <= 700);
    assert_true(rep.zoom_max > key_zoom_for(origin.lat_deg, 500));
    struct store *s;
    size_t n, finest = 0;
    kit_ok(store_open(f->path, &s, &e), e);
    const struct store_tile *t = store_tiles(s, &n);
    for (size_t i = 0; i < n; i++) {
        assert_in_range(t[i].count, 1, 700); /* overviews too, which are thinned */
        finest += t[i].level == 1 ? t[i].count : 0;
    }
    assert_int_equal(finest, 20000); /* split, none left out */
    store_close(&s);
    c = config;
    c.tile_edge_m = 0; /* 20,000 fit into one tile: the smallest that holds all of them */
    kit_ok(pyramid_build(&origin, &level, 1, &c, NULL, 0, f->path, &rep, &e), e);
    assert_int_equal(rep.zoom_max, rep.zoom_min);
    assert_in_range(rep.n_tiles, 1, 4);
    gauss_free(&g);
}

static void unusable_rows_are_left_out(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct gauss g;
    struct pyramid_report rep;
    city(50, 300, 50, &g);
    g.mean_m[3 * 7] = NAN;
    g.sh[3 * 11 + 1] = INFINITY;
    memset(&g.quat_wxyz[4 * 13], 0, 4 * sizeof(float));
    g.scale_log[3 * 17 + 2] = 800; /* exp is more than a double holds */
    const struct pyramid_level level = {.g = &g, .level = 1};
    log_set_level(LOG_ERROR);
    kit_ok(pyramid_build(&origin, &level, 1, &config, NULL, 0, f->path, &rep, &e), e);
    log_set_level(LOG_INFO);
    assert_int_equal(rep.n_bad, 4);
    assert_int_equal(rep.n_gaussians[1], 296);
    for (size_t i = 0; i < g.n; i++)
        g.mean_m[3 * i] = NAN;
    char other[FILE_PATH_MAX];
    kit_ok(file_join(other, f->dir, "none.tiles", &e), e);
    kit_fails(pyramid_build(&origin, &level, 1, &config, NULL, 0, other, NULL, &e), ERR_DATA, e,
              "none of its 300");
    assert_false(file_exists(other));
    const struct pyramid_level gap[2] = {{.g = &g, .level = 1}, {.g = &g, .level = 3}};
    kit_fails(pyramid_build(&origin, gap, 2, &config, NULL, 0, other, NULL, &e), ERR_ARG, e,
              "consecutive");
    gauss_free(&g);
}

/* A splat far above its tile is left out, kilometres to the side it gets a tile, and no tile is
 * wider than formats can hold. */
static void far_rows(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct gauss g;
    struct pyramid_report rep;
    city(55, 400, 50, &g);
    g.mean_m[3 * 5 + 2] = 9000;
    g.mean_m[3 * 6] = 30000;
    struct store *s = build_open(f, &origin, &g, 2, &rep);
    assert_int_equal(rep.n_far, 1);
    size_t n, fine = 0;
    const struct store_tile *t = store_tiles(s, &n);
    for (size_t i = 0; i < n; i++) {
        struct gauss x;
        fine += t[i].level == 2 ? t[i].count : 0;
        kit_ok(store_read_gauss(s, t[i].key, &x, &e), e);
        for (size_t k = 0; k < 3 * x.n; k++)
            assert_true(fabsf(x.mean_m[k]) < 2048);
        gauss_free(&x);
    }
    assert_int_equal(fine, 399);
    assert_no_holes(s);
    store_close(&s);
    gauss_free(&g);
}

/* float32 means come back bit for bit, near the origin, far from it and across it. */
static void lossless_means(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct gauss g;
    city(60, 4000, 300, &g);
    for (size_t i = 0; i < g.n; i++)
        if (i % 3 == 0) /* many magnitudes about the axes */
            for (size_t k = 0; k < 3; k++)
                g.mean_m[3 * i + k] *= (float)pow(10, -8 * rng_unit(60, 70, i));
    struct store *s = build_open(f, &origin, &g, 1, NULL);
    size_t n, leaves = 0;
    const struct store_tile *t = store_tiles(s, &n);
    for (size_t i = 0; i < n; i++) {
        struct gauss x;
        if (t[i].level != 1)
            continue;
        kit_ok(store_read_gauss(s, t[i].key, &x, &e), e);
        const double zero[3] = {0};
        gauss_recenter(&x, zero);
        for (size_t r = 0; r < x.n; r++) {
            size_t id = (size_t)x.sh[3 * r];
            assert_memory_equal(&x.mean_m[3 * r], &g.mean_m[3 * id], 3 * sizeof(float));
            assert_memory_equal(&x.quat_wxyz[4 * r], &g.quat_wxyz[4 * id], 4 * sizeof(float));
            assert_memory_equal(&x.scale_log[3 * r], &g.scale_log[3 * id], 3 * sizeof(float));
            leaves++;
        }
        gauss_free(&x);
    }
    assert_int_equal(leaves, g.n);
    store_close(&s);
    gauss_free(&g);
}

/* A scene across the corner of four zoom-0..n tiles (0, 0): no chain of overviews down to zoom 0.
 */
static void a_scene_across_the_equator(void **state)
{
    struct store_fixture *f = *state;
    struct gauss g;
    struct pyramid_report rep;
    const struct geo_origin null_island = {0, 0, 0};
    city(70, 2000, 200, &g);
    struct store *s = build_open(f, &null_island, &g, 1, &rep);
    assert_true(rep.zoom_min > 12);
    const struct tree *t = store_tree(s);
    assert_int_equal(tree_node(t, t->root).tile, TREE_NONE);
    assert_in_range(tree_node(t, t->root).child_count, 2, 4);
    store_close(&s);
    gauss_free(&g);
}

/* A scene two cells wide across an edge of the quad tree at every zoom, small and wide: overviews
 * go on until one tile holds it, or up to four that meet at a corner and would not become fewer for
 * three zooms. Every tile fits the formats, and what it shows is inside. */
static void one_tile_or_a_corner_holds_the_scene(void **state)
{
    struct store_fixture *f = *state;
    static const struct {
        double half_m, edge_m;
    } sizes[] = {{200, 60}, {15000, 3000}, {90000, 4000}};
    static const double lats[] = {0, 50.1, -33.4, 72.3};
    log_set_level(LOG_ERROR);
    for (uint8_t zb = 0; zb <= 16; zb += 2)
        for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++) {
            struct err e = {0};
            struct gauss g;
            struct pyramid_report rep;
            struct pyramid_config cfg = config;
            struct store *s;
            double west, south, east, north;
            const struct key k = key_at(zb ? 25.0 : 180.0, lats[zb / 2 % 4], zb ? zb : 1);
            key_bounds(k, &west, &south, &east, &north);
            const struct geo_origin o = {zb ? west : 180, zb % 4 ? north : lats[zb / 2 % 4], 100};
            cfg.tile_edge_m = sizes[i].edge_m;
            cfg.lossless = zb % 4 == 0;
            city(zb + 100 * i, 1500, sizes[i].half_m, &g);
            const struct pyramid_level level = {.g = &g, .level = 1};
            kit_ok(pyramid_build(&o, &level, 1, &cfg, NULL, 0, f->path, &rep, &e), e);
            kit_ok(store_open(f->path, &s, &e), e);
            size_t n, roots = 0, up = 0, leaves = 0;
            struct key above = {0};
            const struct store_tile *t = store_tiles(s, &n);
            for (size_t r = 0; r < n; r++) {
                struct gauss x;
                struct quant q;
                kit_ok(store_read_gauss(s, t[r].key, &x, &e), e);
                for (size_t c = 0; c < x.n; c++) {
                    double enu[3], lon, lat, h;
                    for (size_t a = 0; a < 3; a++)
                        enu[a] = (double)x.mean_m[3 * c + a] + x.origin_enu_m[a];
                    kit_ok(geo_from_enu(&o, enu, &lon, &lat, &h, &e), e);
                    if (t[r].level == 0) /* trained rows: float32 on an edge, see three_levels */
                        assert_int_equal(key_compare(key_at(lon, lat, t[r].key.z), t[r].key), 0);
                }
                kit_ok(quant_from_gauss(&x, 3, NULL, &q, &e), e);
                quant_free(&q);
                gauss_free(&x);
                leaves += tree_leaf(store_tree(s), r) ? t[r].count : 0;
                if (t[r].key.z != rep.zoom_min)
                    continue;
                struct key at = t[r].key;
                for (int z = 0; z < 3 && at.z > 0; z++)
                    at = key_parent(at);
                up += roots++ == 0 || key_compare(at, above) != 0;
                above = at;
            }
            assert_int_equal(leaves, g.n);
            if (!(roots == 1 || (roots <= 4 && up == roots)))
                fail_msg("edge of zoom %u, %g m: %zu roots at zoom %u", zb, sizes[i].half_m, roots,
                         rep.zoom_min);
            store_close(&s);
            gauss_free(&g);
        }
    log_set_level(LOG_INFO);
}

/* The fast way to a tile gives the tile that GeographicLib and key_at give: all over a city, on the
 * edges of tiles to the last bit, high up, at the date line and at the poles. */
static void located_as_by_definition(void **state)
{
    struct err e = {0};
    static const struct geo_origin places[] = {{8.6821, 50.1109, 160},
                                               {-179.9999, -16.5, 5},
                                               {0, 0, 0},
                                               {20, 84.9, 0},
                                               {20, -89.99, 2800}};
    for (size_t o = 0; o < sizeof places / sizeof *places; o++) {
        struct locate l;
        kit_ok(locate_open(&places[o], &l, &e), e);
        for (uint64_t i = 0; i < 6000; i++) {
            double lon, lat, h, enu[3], west, south, east, north;
            const double reach = i % 5 ? 3e3 : 3e5;
            for (uint64_t k = 0; k < 3; k++)
                enu[k] = reach * (rng_unit(o, k, i) - 0.5) * (k == 2 ? 0.3 : 2);
            kit_ok(geo_from_enu(&places[o], enu, &lon, &lat, &h, &e), e);
            struct key want = key_at(lon, lat, KEY_ZOOM_MAX), got;
            if (i % 2) { /* onto an edge, give or take less than rounding can do */
                key_bounds(want, &west, &south, &east, &north);
                kit_ok(geo_to_enu(&places[o], west, i % 4 == 1 ? north : lat, h, enu, &e), e);
                enu[0] += 1e-8 * (rng_unit(o, 3, i) - 0.5);
                kit_ok(geo_from_enu(&places[o], enu, &lon, &lat, &h, &e), e);
                want = key_at(lon, lat, KEY_ZOOM_MAX);
            }
            kit_ok(locate_key(&l, enu, &got, &e), e);
            assert_int_equal(key_compare(got, want), 0);
            assert_int_equal(key_compare(locate_decode(locate_code(got), KEY_ZOOM_MAX), got), 0);
        }
    }
}

/* ---- simplification ---- */

static void eigen_of_known_matrices(void **state)
{
    for (uint64_t i = 0; i < 500; i++) {
        double q[4], rot[9], want[3], cov[6], value[3], v[9];
        for (uint64_t k = 0; k < 4; k++)
            q[k] = rng_normal(1, k, i);
        for (uint64_t k = 0; k < 3; k++)
            want[k] = pow(10, (i % 2 ? -6.0 : -1.0) * rng_unit(1, 4 + k, i));
        camera_quat_to_rot(q, rot);
        static const int at[6][2] = {{0, 0}, {0, 1}, {0, 2}, {1, 1}, {1, 2}, {2, 2}};
        for (size_t m = 0; m < 6; m++) {
            cov[m] = 0;
            for (size_t k = 0; k < 3; k++)
                cov[m] += rot[3 * at[m][0] + k] * rot[3 * at[m][1] + k] * want[k];
        }
        simplify_eigen(cov, value, v);
        assert_true(value[0] >= value[1] && value[1] >= value[2]);
        double back[6], orth[6];
        for (size_t m = 0; m < 6; m++) {
            back[m] = orth[m] = 0;
            for (size_t k = 0; k < 3; k++) {
                back[m] += v[3 * at[m][0] + k] * v[3 * at[m][1] + k] * value[k];
                orth[m] += v[3 * at[m][0] + k] * v[3 * at[m][1] + k];
            }
        }
        const double one[6] = {1, 0, 0, 1, 0, 1};
        kit_near_d("V diag V^T", back, cov, 6, 2e-12, 0); /* where the sweeps stop */
        kit_near_d("V V^T", orth, one, 6, 2e-12, 0);
        double det = v[0] * (v[4] * v[8] - v[5] * v[7]) - v[1] * (v[3] * v[8] - v[5] * v[6]) +
                     v[2] * (v[3] * v[7] - v[4] * v[6]),
               right = 1;
        kit_near_d("det", &det, &right, 1, 1e-12, 0);
    }
}

/* Over pi: a sphere shows r^2 from everywhere, a thin disc half its face on average. */
static void projected_areas(void **state)
{
    const double sphere[3] = {2, 2, 2}, disc[3] = {3, 3, 1e-6};
    double got[2] = {simplify_area(sphere), simplify_area(disc)};
    const double want[2] = {4, 4.5};
    kit_near_d("area", got, want, 2, 0, 0.015); /* Thomsen: within 1.1 % */
}

static double logistic(double x)
{
    return 1 / (1 + exp(-x));
}

/* Two small, far apart, faint discs: their merger has the weighted moments and the sum of the
 * coverage. */
static void two_become_one_by_moments(void **state)
{
    struct err e = {0};
    struct gauss g, out;
    kit_ok(gauss_alloc(&g, 2, 1, 2, &e), e);
    g.n = 2;
    for (size_t i = 0; i < 2; i++) {
        g.mean_m[3 * i] = i ? 6.0f : -2.0f;
        g.quat_wxyz[4 * i] = 1;
        g.scale_log[3 * i] = g.scale_log[3 * i + 1] = (float)log(0.5);
        g.scale_log[3 * i + 2] = (float)log(0.01);
        g.opacity_logit[i] = i ? 0.0f : (float)log(0.1 / 0.9);
        for (size_t k = 0; k < 12; k++)
            g.sh[12 * i + k] = (float)(k + 10 * i);
        g.embed[2 * i] = (float)i;
    }
    kit_ok(simplify_gauss(&g, 1, &out, &e), e);
    assert_int_equal(out.n, 1);
    const double wb = 5.0 / 6; /* opacities 0.1 and 0.5, equal areas */
    const double want[3] = {-2 + 8 * wb, 0, 0};
    kit_near("mean", out.mean_m, want, 3, 1e-5, 0);
    double spread = 0.25 + wb * (1 - wb) * 64;
    const double sigma[3] = {0.5 * log(spread), log(0.5), log(0.01)};
    kit_near("scale", out.scale_log, sigma, 3, 1e-4, 0);
    double sh[12];
    for (size_t k = 0; k < 12; k++)
        sh[k] = (double)k + 10 * wb;
    kit_near("sh", out.sh, sh, 12, 1e-4, 0);
    assert_true(fabs((double)out.embed[0] - wb) < 1e-6);
    const double axes[3] = {sqrt(spread), 0.5, 0.01}, each[3] = {0.5, 0.5, 0.01};
    double have = logistic((double)out.opacity_logit[0]) * simplify_area(axes);
    double before = 0.6 * simplify_area(each);
    assert_true(fabs(have - before) < 1e-3 * before); /* they hide e^-64 of each other */
    gauss_free(&g);
    gauss_free(&out);
}

static void targets_are_met_exactly(void **state)
{
    struct err e = {0};
    struct gauss g, a, b;
    kit_gauss(80, 3000, 10, 1, 4, &g);
    for (size_t i = 0; i < 300; i++) /* heaps of equal rows: ties */
        gauss_copy_row(&g, i, &g, 2999);
    const size_t targets[] = {3000, 2999, 1500, 100, 1};
    for (size_t k = 0; k < 5; k++) {
        kit_ok(simplify_gauss(&g, targets[k], &a, &e), e);
        assert_int_equal(a.n, targets[k]);
        assert_int_equal(gauss_count_bad(&a, NULL), 0);
        kit_ok(simplify_gauss(&g, targets[k], &b, &e), e);
        assert_memory_equal(a.mean_m, b.mean_m, 3 * a.n * sizeof(float));
        assert_memory_equal(a.sh, b.sh, 12 * a.n * sizeof(float));
        gauss_free(&a);
        gauss_free(&b);
    }
    kit_fails(simplify_gauss(&g, 0, &a, &e), ERR_ARG, e, "at least 1");
    g.n = 0;
    kit_ok(simplify_gauss(&g, 5, &a, &e), e);
    assert_int_equal(a.n, 0);
    gauss_free(&a);
    gauss_free(&g);
}

static double psnr(const double *a, const double *b, size_t n)
{
    double sum = 0;
    for (size_t i = 0; i < n; i++)
        sum += (a[i] - b[i]) * (a[i] - b[i]);
    return -10 * log10(sum / (double)n + 1e-30);
}

/* An opaque chequered floor from where the simplified sigma is about a pixel: close to the
 * original, far closer than taking every fourth splat, and no thinner. */
/* Foreign files hold any finite number: sizes beyond the range of a squared double, in all rows or
 * in some. */
static void absurd_sizes_come_to_an_end(void **state)
{
    struct err e = {0};
    static const float absurd[] = {300.0f, -300.0f, 88.0f, 3e38f};
    for (size_t k = 0; k < sizeof absurd / sizeof *absurd; k++)
        for (size_t every = 1; every <= 7; every += 3) {
            struct gauss g, out;
            city(40 + k, 200, 10, &g);
            for (size_t i = 0; i < 3 * g.n; i += 1 + (every - 1) * (i % 2))
                g.scale_log[i] = absurd[k];
            alarm(20); /* a hang is a failure */
            kit_ok(simplify_gauss(&g, 3, &out, &e), e);
            alarm(0);
            assert_int_equal(out.n, 3);
            assert_int_equal(gauss_count_bad(&out, NULL), 0);
            gauss_free(&g);
            gauss_free(&out);
        }
}

static void a_quarter_looks_like_the_whole(void **state)
{
    struct err e = {0};
    enum { W = 48, H = 36, SIDE = 56 };
    struct gauss g, less, some;
    static double full[W * H * 3], merged[W * H * 3], thinned[W * H * 3], t0[W * H], t1[W * H];
    kit_ok(gauss_alloc(&g, SIDE * SIDE, 0, 0, &e), e);
    g.n = SIDE * SIDE;
    for (size_t i = 0; i < g.n; i++) {
        double x = (double)(i % SIDE) - SIDE / 2 + 0.5 * rng_unit(90, 0, i);
        double y = (double)(i / SIDE) - SIDE / 2 + 0.5 * rng_unit(90, 1, i);
        bool dark = ((int)floor(x / 8) + (int)floor(y / 8)) & 1;
        g.mean_m[3 * i] = (float)x;
        g.mean_m[3 * i + 1] = (float)y;
        g.scale_log[3 * i] = g.scale_log[3 * i + 1] = (float)log(0.6);
        g.scale_log[3 * i + 2] = (float)log(0.02);
        g.quat_wxyz[4 * i] = 1;
        g.opacity_logit[i] = 2;
        for (size_t k = 0; k < 3; k++)
            g.sh[3 * i + k] = dark ? -1.0f : 0.8f + 0.4f * (float)rng_unit(90, 2, i);
    }
    const double eye[3] = {0, 0, 60};
    struct camera cam =
        camera_heading(eye, 0, -90, 2 * atan(H / 2.0 / 60), W, H); /* 1 px a metre */
    const struct render_options ro = {.aa = RENDER_AA_2D, .background = {1, 0, 1}, .sh_degree = -1};
    kit_ok(simplify_gauss(&g, g.n / 4, &less, &e), e);
    kit_ok(gauss_alloc(&some, g.n, 0, 0, &e), e);
    for (uint32_t i = 0; i < g.n; i += 4)
        kit_ok(gauss_append(&some, &g, &i, 1, &e), e);
    kit_ok(render_ref_forward(&g, &cam, &ro, full, t0, &e), e);
    kit_ok(render_ref_forward(&less, &cam, &ro, merged, t1, &e), e);
    kit_ok(render_ref_forward(&some, &cam, &ro, thinned, NULL, &e), e);
    double close = psnr(full, merged, W * H * 3), far = psnr(full, thinned, W * H * 3);
    if (!(close > 27 && close > far + 12))
        fail_msg("merged %.2f dB, thinned %.2f dB", close, far);
    double left0 = 0, left1 = 0;
    for (size_t i = 0; i < W * H; i++) {
        left0 += t0[i] / (W * H);
        left1 += t1[i] / (W * H);
    }
    assert_true(fabs(left0 - left1) < 0.02); /* of full coverage */
    gauss_free(&g);
    gauss_free(&less);
    gauss_free(&some);
}

/* The index of a run against the codes themselves, at zooms above and below its groups. */
static void slices_of_a_run(void **state)
{
    struct store_fixture *f = *state;
    enum { ROWS = 3000 };
    struct locate l;
    struct gauss g;
    struct spill s;
    struct spill_run run = {0};
    struct err e = {0};
    struct sort_item *items = mem_array(2 * ROWS, sizeof *items);
    kit_ok(locate_open(&origin, &l, &e), e);
    city(11, ROWS, 80, &g);
    for (size_t i = 0; i < ROWS; i++) {
        const double enu[3] = {(double)g.mean_m[3 * i], (double)g.mean_m[3 * i + 1],
                               (double)g.mean_m[3 * i + 2]};
        struct key k;
        kit_ok(locate_key(&l, enu, &k, &e), e);
        items[i] = (struct sort_item){locate_code(k), (uint32_t)i};
    }
    sort_items(items, items + ROWS, ROWS);
    kit_ok(spill_open(f->path, false, &s, &e), e);
    s.locate = &l;
    kit_ok(spill_index(&run, items, ROWS, &e), e);
    assert_in_range(run.n_groups, 2, ROWS / 16 + 1);
    assert_in_range(run.shift, 2, 20);
    kit_ok(spill_add(&s, &g, items, ROWS, &run, &e), e);
    for (unsigned shift = 0; shift < 48; shift += 2)
        for (size_t from = 0, to; from < ROWS; from = to) {
            uint64_t code;
            size_t want = from, first, last;
            kit_ok(spill_tile(&s, &run, shift, from, &code, &to, &e), e);
            while (want < ROWS && items[want].key >> shift == items[from].key >> shift)
                want++;
            assert_int_equal(code, items[from].key >> shift);
            assert_int_equal(to, want);
            kit_ok(spill_slice(&s, &run, code << shift, (code + 1) << shift, &first, &last, &e), e);
            assert_int_equal(first, from);
            assert_int_equal(last, to);
        }
    for (uint64_t i = 0; i < 500; i++) { /* between codes, and outside of all */
        uint64_t spread = 2 * (run.code_last - run.code_first),
                 a = run.code_first - spread / 4 + rng_u64(1, 1, i) % spread,
                 b = a + rng_u64(1, 2, i) % spread;
        size_t from, to, want[2] = {0, 0};
        for (size_t k = 0; k < ROWS; k++) {
            want[0] += items[k].key < a;
            want[1] += items[k].key < b;
        }
        kit_ok(spill_slice(&s, &run, a, b, &from, &to, &e), e);
        assert_int_equal(to - from, want[1] - want[0]);
        if (to > from)
            assert_int_equal(from, want[0]);
    }
    spill_run_free(&run);
    spill_close(&s);
    mem_free(items);
    gauss_free(&g);
}

int main(void)
{
#define CASE(name)                                                                                 \
    cmocka_unit_test_setup_teardown(name, store_fixture_setup, store_fixture_teardown)
    progress_quiet(true);
    const struct CMUnitTest tests[] = {
        CASE(three_levels),
        CASE(sparse_levels_leave_no_holes),
        CASE(one_level_makes_the_coarser_ones),
        CASE(tiles_keep_to_the_limit_and_to_the_wish),
        CASE(unusable_rows_are_left_out),
        CASE(far_rows),
        CASE(lossless_means),
        CASE(a_scene_across_the_equator),
        CASE(one_tile_or_a_corner_holds_the_scene),
        CASE(slices_of_a_run),
        cmocka_unit_test(located_as_by_definition),
        cmocka_unit_test(eigen_of_known_matrices),
        cmocka_unit_test(projected_areas),
        cmocka_unit_test(two_become_one_by_moments),
        cmocka_unit_test(targets_are_met_exactly),
        cmocka_unit_test(absurd_sizes_come_to_an_end),
        cmocka_unit_test(a_quarter_looks_like_the_whole),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
