/* Level selection: cases by hand, and two promises: selected tiles cover every visible leaf exactly
 * once, and tiles left out would not have changed a pixel.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jansson.h>

#include "core/splat/camera.h"
#include "lod/choose/pick.h"
#include "lod/store/store.h"
#include "lod/store/tree.h"
#include "render/render.h"

enum { TILES_MAX = 512 };

struct scene_tiles {
    struct store_entry tile[TILES_MAX];
    size_t n;
    struct index index;
    struct tree tree;
};

static int compare_tiles(const void *a, const void *b)
{
    const struct store_entry *x = a, *y = b;
    return key_compare(x->tile.key, y->tile.key);
}

static void finish(struct scene_tiles *s)
{
    struct err e = {0};
    qsort(s->tile, s->n, sizeof *s->tile, compare_tiles);
    for (size_t i = 0; i < s->n; i++)
        kit_ok(index_add(&s->index, &s->tile[i], s->n, &e), e);
    kit_ok(tree_build(&s->index, &s->tree, &e), e);
}

static void drop(struct scene_tiles *s)
{
    tree_free(&s->tree);
    index_free(&s->index);
}

/* ---- cases by hand ---- */

static void load_scene(const json_t *rows, struct scene_tiles *s)
{
    size_t i;
    json_t *row;
    *s = (struct scene_tiles){0};
    json_array_foreach(rows, i, row)
    {
        double v[12];
        assert_int_equal(json_array_size(row), 12);
        for (size_t k = 0; k < 12; k++)
            v[k] = json_number_value(json_array_get(row, k));
        struct store_entry *t = &s->tile[s->n++];
        t->tile.key = (struct key){(uint8_t)v[0], (uint32_t)v[1], (uint32_t)v[2]};
        memcpy(t->shape.min_enu_m, v + 3, 3 * sizeof *v);
        memcpy(t->shape.max_enu_m, v + 6, 3 * sizeof *v);
        t->shape.sigma_max_m = v[9];
        t->shape.geometric_error_m = v[10];
        t->tile.count = (uint32_t)v[11];
    }
    finish(s);
}

static struct camera load_camera(const json_t *c)
{
    static const double down[9] = {1, 0, 0, 0, -1, 0, 0, 0, -1},
                        west[9] = {0, 1, 0, 0, 0, -1, -1, 0, 0};
    struct err e = {0};
    double eye[3], size[2], focal;
    const char *look;
    kit_ok(jsonc_nums(c, "eye", 3, eye, &e), e);
    kit_ok(jsonc_nums(c, "size_px", 2, size, &e), e);
    kit_ok(jsonc_num(c, "focal_px", &focal, &e), e);
    kit_ok(jsonc_text(c, "look", &look, &e), e);
    struct camera cam = {.width_px = (uint32_t)size[0],
                         .height_px = (uint32_t)size[1],
                         .fx_px = focal,
                         .fy_px = focal,
                         .cx_px = size[0] / 2,
                         .cy_px = size[1] / 2};
    memcpy(cam.rot, !strcmp(look, "down") ? down : west, sizeof cam.rot);
    for (size_t r = 0; r < 3; r++)
        for (size_t k = 0; k < 3; k++)
            cam.trans[r] -= cam.rot[3 * r + k] * eye[k];
    return cam;
}

static void run_case(const json_t *scenes, const json_t *c)
{
    struct err e = {0};
    struct scene_tiles s;
    struct pick_options o = {0};
    uint32_t out[TILES_MAX];
    size_t n, i;
    json_t *x;
    const char *name = json_string_value(json_object_get(c, "name"));
    load_scene(json_object_get(scenes, json_string_value(json_object_get(c, "scene"))), &s);
    struct camera cam = load_camera(c);
    o.error_px = json_number_value(json_object_get(c, "error_px"));
    o.max_gaussians = (uint64_t)json_number_value(json_object_get(c, "max_gaussians"));
    o.no_lod = json_is_true(json_object_get(c, "no_lod"));
    json_array_foreach(json_object_get(c, "distance_m"), i, x)
    {
        o.metric = PICK_DISTANCE;
        o.distance_m[i] = json_number_value(x);
    }
    kit_ok(pick_select(&s.tree, &cam, &o, out, &n, &e), e);
    const json_t *want = json_object_get(c, "picked");
    char got[TILES_MAX * 16] = "";
    bool same = n == json_array_size(want);
    for (i = 0; i < n; i++) {
        char key[64];
        struct key k = s.tile[out[i]].tile.key;
        snprintf(key, sizeof key, "%u/%u/%u", k.z, k.x, k.y);
        snprintf(got + strlen(got), sizeof got - strlen(got), " %s", key);
        bool found = false;
        size_t j;
        json_array_foreach(want, j, x) found = found || !strcmp(key, json_string_value(x));
        same = same && found && (i == 0 || out[i - 1] < out[i]);
    }
    if (!same)
        fail_msg("%s: picked%s", name, got);
    drop(&s);
}

static void cases_by_hand(void **state)
{
    struct err e = {0};
    json_t *root, *c;
    size_t i;
    kit_ok(jsonc_read("tests/data/pick.json", &root, &e), e);
    json_array_foreach(json_object_get(root, "cases"), i, c)
        run_case(json_object_get(root, "scenes"), c);
    assert_int_equal(i, 15);
    json_decref(root);
}

/* ---- vectors of an implementation that shares no code (tests/lod/pick_vectors.c) ---- */

static void check_picked(const struct scene_tiles *s, const uint32_t *out, size_t n,
                         const json_t *want, size_t number)
{
    if (n != json_array_size(want))
        fail_msg("case %zu: %zu tiles, not %zu", number, n, json_array_size(want));
    for (size_t i = 0; i < n; i++) {
        char key[64];
        bool found = false;
        size_t j;
        json_t *x;
        struct key k = s->tile[out[i]].tile.key;
        snprintf(key, sizeof key, "%u/%u/%u", k.z, k.x, k.y);
        json_array_foreach(want, j, x) found = found || !strcmp(key, json_string_value(x));
        if (!found)
            fail_msg("case %zu: %s is picked", number, key);
    }
}

static struct camera vector_camera(const json_t *root, const json_t *c, const char *eye)
{
    struct err e = {0};
    double at[3], size[2], focal;
    struct camera cam = {0};
    kit_ok(jsonc_nums(c, eye, 3, at, &e), e);
    kit_ok(jsonc_nums(c, "rot", 9, cam.rot, &e), e);
    kit_ok(jsonc_nums(root, "size_px", 2, size, &e), e);
    kit_ok(jsonc_num(root, "focal_px", &focal, &e), e);
    cam.width_px = (uint32_t)size[0];
    cam.height_px = (uint32_t)size[1];
    cam.fx_px = cam.fy_px = focal;
    cam.cx_px = size[0] / 2;
    cam.cy_px = size[1] / 2;
    for (size_t r = 0; r < 3; r++)
        for (size_t k = 0; k < 3; k++)
            cam.trans[r] -= cam.rot[3 * r + k] * at[k];
    return cam;
}

static void vector_scene(const json_t *rows, struct scene_tiles *s)
{
    size_t i;
    json_t *row;
    *s = (struct scene_tiles){0};
    json_array_foreach(rows, i, row)
    {
        double v[19];
        assert_int_equal(json_array_size(row), 19);
        for (size_t k = 0; k < 19; k++)
            v[k] = json_number_value(json_array_get(row, k));
        s->tile[s->n++] =
            (struct store_entry){.tile = {.key = {(uint8_t)v[0], (uint32_t)v[1], (uint32_t)v[2]},
                                          .count = (uint32_t)v[17],
                                          .bytes = (uint32_t)v[18]},
                                 .shape = {.min_enu_m = {v[3], v[4], v[5]},
                                           .max_enu_m = {v[6], v[7], v[8]},
                                           .core_min_enu_m = {v[9], v[10], v[11]},
                                           .core_max_enu_m = {v[12], v[13], v[14]},
                                           .geometric_error_m = v[15],
                                           .sigma_max_m = v[16]}};
    }
    finish(s);
}

static void vector_case(const json_t *root, const json_t *c, size_t i)
{
    struct err e = {0};
    struct scene_tiles s;
    uint32_t first[TILES_MAX], out[TILES_MAX];
    size_t n_first, n;
    vector_scene(json_object_get(json_object_get(root, "scenes"),
                                 json_string_value(json_object_get(c, "scene"))),
                 &s);
    struct pick_options o = {
        .error_px = json_number_value(json_object_get(c, "error_px")),
        .max_gaussians = (uint64_t)json_number_value(json_object_get(c, "max_gaussians")),
        .max_bytes = (uint64_t)json_number_value(json_object_get(c, "max_bytes"))};
    if (!strcmp(json_string_value(json_object_get(c, "metric")), "distance")) {
        o.metric = PICK_DISTANCE;
        kit_ok(jsonc_nums(root, "distance_m", 3, o.distance_m, &e), e);
    }
    struct camera cam = vector_camera(root, c, "eye"), then = vector_camera(root, c, "then");
    kit_ok(pick_select(&s.tree, &cam, &o, first, &n_first, &e), e);
    check_picked(&s, first, n_first, json_object_get(c, "picked"), i);
    kit_ok(pick_select(&s.tree, &then, &o, out, &n, &e), e);
    check_picked(&s, out, n, json_object_get(c, "picked_then"), i);
    o.hysteresis = json_number_value(json_object_get(root, "hysteresis"));
    o.before = first;
    o.n_before = n_first;
    kit_ok(pick_select(&s.tree, &then, &o, out, &n, &e), e);
    check_picked(&s, out, n, json_object_get(c, "picked_then_with_hysteresis"), i);
    drop(&s);
}

static void vectors(void **state)
{
    struct err e = {0};
    json_t *root, *c;
    size_t i;
    kit_ok(jsonc_read("tests/vectors/pick.json", &root, &e), e);
    json_array_foreach(json_object_get(root, "cases"), i, c) vector_case(root, c, i);
    assert_int_equal(i, 126);
    json_decref(root);
}

/* A random sparse pyramid over a square of 400 m, zooms 3 to 7. */
static void random_scene(uint64_t seed, struct scene_tiles *s)
{
    *s = (struct scene_tiles){0};
    uint64_t draw = 0;
    for (uint8_t z = 3; z <= 7; z++)
        for (uint32_t y = 0; y < 1u << (z - 3); y++)
            for (uint32_t x = 0; x < 1u << (z - 3); x++) {
                if (rng_unit(seed, 0, draw++) < (z == 3 ? 0.2 : 0.45))
                    continue;
                double edge = ldexp(400, 3 - z), grow = edge * 0.1 * rng_unit(seed, 1, draw);
                struct store_entry *t = &s->tile[s->n++];
                t->tile.key = (struct key){z, x, y};
                const double lo[3] = {x * edge - 200 - grow, 200 - (y + 1) * edge - grow, -grow};
                const double hi[3] = {lo[0] + edge + 2 * grow, lo[1] + edge + 2 * grow,
                                      30 * rng_unit(seed, 2, draw)};
                memcpy(t->shape.min_enu_m, lo, sizeof lo);
                memcpy(t->shape.max_enu_m, hi, sizeof hi);
                t->shape.sigma_max_m = edge / 30;
                t->shape.geometric_error_m = 16 * edge / 100 * (0.5 + rng_unit(seed, 3, draw));
                t->tile.count = 1 + (uint32_t)(1000 * rng_unit(seed, 4, draw));
            }
    finish(s);
    /* Let each tile's own box hold those below, so that an ancestor is visible wherever a leaf is.
     */
    for (size_t i = 0; i < s->n; i++) {
        const struct tree_bounds b = tree_bounds(&s->tree, (uint32_t)i);
        struct store_shape *x = &s->tile[i].shape;
        memcpy(x->min_enu_m, b.min_enu_m, sizeof x->min_enu_m);
        memcpy(x->max_enu_m, b.max_enu_m, sizeof x->max_enu_m);
        x->sigma_max_m = b.sigma_max_m;
    }
    drop(s);
    finish(s);
}

static struct camera random_camera(uint64_t seed)
{
    double eye[3] = {600 * rng_unit(seed, 5, 0) - 300, 600 * rng_unit(seed, 5, 1) - 300,
                     1 + 200 * rng_unit(seed, 5, 2)};
    return camera_heading(eye, 360 * rng_unit(seed, 5, 3), -90 * rng_unit(seed, 5, 4),
                          0.3 + rng_unit(seed, 5, 5), 320, 240);
}

/* How often the picked tiles of a camera change that goes to and fro. */
static size_t changes_to_and_fro(const struct scene_tiles *s, double error_px, double hysteresis)
{
    struct err e = {0};
    uint32_t before[TILES_MAX], out[TILES_MAX];
    size_t n_before = 0, n, changes = 0;
    for (int step = 0; step < 40; step++) {
        /* 280 m away at least, and all in view: 8 m are less than the band of 5 %. */
        const double eye[3] = {0, step % 2 ? -508 : -500, 60};
        struct camera cam = camera_heading(eye, 0, -5, 1.8, 320, 240);
        struct pick_options o = {.error_px = error_px,
                                 .hysteresis = hysteresis,
                                 .before = step ? before : NULL,
                                 .n_before = n_before};
        kit_ok(pick_select(&s->tree, &cam, &o, out, &n, &e), e);
        changes += step > 1 && (n != n_before || memcmp(out, before, n * sizeof *out));
        memcpy(before, out, n * sizeof *out);
        n_before = n;
    }
    return changes;
}

/* A camera that goes to and fro about every limit on its way, by less than the band: each tile
 * changes its level once at most. Without a band it does at every step. */
static void a_trembling_camera_does_not_flap(void **state)
{
    size_t changes[2] = {0};
    for (uint64_t seed = 0; seed < 20; seed++) {
        struct scene_tiles s;
        random_scene(seed, &s);
        for (size_t with = 0; with < 2; with++)
            changes[with] +=
                changes_to_and_fro(&s, 0.4 + 0.02 * (double)seed, with ? PICK_HYSTERESIS : 0);
        drop(&s);
    }
    assert_int_equal(changes[1], 0);
    assert_in_range(changes[0], 38, 20 * 38); /* or the test would say nothing */
}

/* ---- promises ---- */

/* How many picked nodes stand on the way from `node` to the root, itself included. */
static size_t picked_above(const struct scene_tiles *s, const bool *picked, uint32_t node)
{
    size_t n = 0;
    for (uint32_t v = node; v != TREE_NONE; v = tree_node(&s->tree, v).parent)
        n += v < s->n && picked[v];
    return n;
}

static void a_pick_is_a_cut(void **state)
{
    struct err e = {0};
    for (uint64_t seed = 0; seed < 200; seed++) {
        struct scene_tiles s;
        uint32_t out[TILES_MAX], leaves[TILES_MAX];
        bool picked[TILES_MAX] = {false};
        size_t n, n_leaves;
        random_scene(seed, &s);
        struct camera cam = random_camera(seed);
        struct pick_options o = {.error_px = 0.2 + 5 * rng_unit(seed, 6, 0)};
        if (seed % 4 == 1)
            o.max_gaussians = 1 + (uint64_t)(20000 * rng_unit(seed, 6, 1));
        if (seed % 4 == 2)
            o = (struct pick_options){.metric = PICK_DISTANCE, .distance_m = {20, 60, 150}};
        kit_ok(pick_select(&s.tree, &cam, &o, out, &n, &e), e);
        for (size_t i = 0; i < n; i++)
            picked[out[i]] = true;
        /* No picked tile above another one. */
        for (size_t i = 0; i < n; i++)
            assert_int_equal(picked_above(&s, picked, out[i]), 1);
        /* Every visible leaf is shown, by itself or by an ancestor. */
        const struct pick_options all = {.no_lod = true};
        kit_ok(pick_select(&s.tree, &cam, &all, leaves, &n_leaves, &e), e);
        for (size_t i = 0; i < n_leaves; i++) {
            assert_true(tree_leaf(&s.tree, leaves[i]));
            assert_int_equal(picked_above(&s, picked, leaves[i]), 1);
        }
        drop(&s);
    }
}

static void tighter_errors_only_refine(void **state)
{
    struct err e = {0};
    for (uint64_t seed = 0; seed < 50; seed++) {
        struct scene_tiles s;
        uint32_t out[TILES_MAX];
        bool before[TILES_MAX] = {false};
        size_t n, n_before = SIZE_MAX;
        random_scene(seed, &s);
        struct camera cam = random_camera(seed + 1000);
        for (double px = 16; px > 0.05; px /= 2) {
            struct pick_options o = {.error_px = px};
            kit_ok(pick_select(&s.tree, &cam, &o, out, &n, &e), e);
            for (size_t i = 0; n_before != SIZE_MAX && i < n; i++)
                assert_int_equal(picked_above(&s, before, out[i]), 1);
            memset(before, 0, sizeof before);
            for (size_t i = 0; i < n; i++)
                before[out[i]] = true;
            n_before = n;
        }
        drop(&s);
    }
}

static void errors_fall_strictly_and_boxes_nest(void **state)
{
    for (uint64_t seed = 0; seed < 50; seed++) {
        struct scene_tiles s;
        random_scene(seed, &s);
        for (size_t i = 0; i < s.tree.n_nodes; i++) {
            const struct tree_node v = tree_node(&s.tree, i);
            const bool top = v.parent == TREE_NONE;
            assert_true(v.child_count ? v.geometric_error_m > 0 : v.geometric_error_m == 0);
            const struct tree_bounds inner = tree_bounds(&s.tree, (uint32_t)i),
                                     outer = tree_bounds(&s.tree, top ? s.tree.root : v.parent);
            for (size_t k = 0; k < 3; k++)
                assert_true(outer.min_enu_m[k] <= inner.min_enu_m[k] &&
                            outer.max_enu_m[k] >= inner.max_enu_m[k]);
            assert_true(top ||
                        tree_node(&s.tree, v.parent).geometric_error_m > v.geometric_error_m);
        }
        drop(&s);
    }
}

/* Groups of five large Gaussians as tiles, a wide lens among them: leaving out the culled groups
 * changes nothing. */
static void culled_tiles_contribute_nothing(void **state)
{
    struct err e = {0};
    enum { GROUPS = 40, EACH = 5, W = 40, H = 30 };
    size_t culled = 0;
    for (uint64_t seed = 0; seed < 60; seed++) {
        struct gauss all, kept;
        struct scene_tiles s = {0};
        double full[W * H * 3], part[W * H * 3];
        uint32_t out[TILES_MAX];
        size_t n;
        kit_gauss(seed, GROUPS * EACH, 30, 1, 0, &all);
        /* Groups stay together: means near their group's first. */
        for (size_t i = 0; i < all.n; i++)
            for (size_t k = 0; k < 3; k++)
                all.mean_m[3 * i + k] =
                    all.mean_m[3 * (i - i % EACH) + k] + 0.05f * all.mean_m[3 * i + k];
        for (uint32_t i = 0; i < GROUPS; i++) {
            struct gauss g = all;
            g.n = EACH;
            g.mean_m += 3 * EACH * i;
            g.scale_log += 3 * EACH * i;
            struct store_entry *t = &s.tile[s.n++];
            *t = (struct store_entry){.tile = {.key = {10, i, 0}, .count = EACH},
                                      .shape.geometric_error_m = 1};
            struct store_shape *x = &t->shape;
            gauss_bounds(&g, 3.33, x->min_enu_m, x->max_enu_m);
            for (size_t k = 0; k < 3 * EACH; k++)
                x->sigma_max_m = fmax(x->sigma_max_m, exp((double)g.scale_log[k]));
        }
        finish(&s);
        double eye[3] = {20 * rng_normal(seed, 7, 0), 20 * rng_normal(seed, 7, 1),
                         20 * rng_normal(seed, 7, 2)};
        struct camera cam =
            camera_heading(eye, 360 * rng_unit(seed, 7, 3), 160 * rng_unit(seed, 7, 4) - 80,
                           0.4 + 1.8 * rng_unit(seed, 7, 5), W, H);
        cam.cx_px += 10 * rng_normal(seed, 7, 6);
        const struct pick_options o = {.no_lod = true};
        const struct render_options ro = {.aa = RENDER_AA_2D, .sh_degree = -1};
        kit_ok(pick_select(&s.tree, &cam, &o, out, &n, &e), e);
        culled += GROUPS - n;
        kit_ok(gauss_alloc(&kept, n * EACH, 1, 0, &e), e);
        for (size_t i = 0; i < n; i++)
            for (uint32_t k = 0; k < EACH; k++) {
                uint32_t row = EACH * s.tile[out[i]].tile.key.x + k;
                kit_ok(gauss_append(&kept, &all, &row, 1, &e), e);
            }
        kit_ok(render_ref_forward(&all, &cam, &ro, full, NULL, &e), e);
        kit_ok(render_ref_forward(&kept, &cam, &ro, part, NULL, &e), e);
        assert_memory_equal(full, part, sizeof full);
        gauss_free(&all);
        gauss_free(&kept);
        drop(&s);
    }
    assert_in_range(culled, 60 * GROUPS / 4, 60 * GROUPS); /* or the test would say nothing */
}

static void nothing_to_pick_from(void **state)
{
    struct err e = {0};
    struct tree t;
    const struct index none = {0};
    uint32_t out[1];
    size_t n = 7;
    struct camera cam = random_camera(1);
    kit_ok(tree_build(&none, &t, &e), e);
    kit_ok(pick_select(&t, &cam, NULL, out, &n, &e), e);
    assert_int_equal(n, 0);
    struct scene_tiles s;
    random_scene(1, &s);
    cam.fx_px = (double)NAN;
    kit_fails(pick_select(&s.tree, &cam, NULL, out, &n, &e), ERR_ARG, e, "focal");
    drop(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(cases_by_hand),
        cmocka_unit_test(vectors),
        cmocka_unit_test(a_trembling_camera_does_not_flap),
        cmocka_unit_test(a_pick_is_a_cut),
        cmocka_unit_test(tighter_errors_only_refine),
        cmocka_unit_test(errors_fall_strictly_and_boxes_nest),
        cmocka_unit_test(culled_tiles_contribute_nothing),
        cmocka_unit_test(nothing_to_pick_from),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
