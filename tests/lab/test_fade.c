/* Cross-fade between levels: the curve and the rule, by vectors that also test the viewer
 * (tests/web/source.test.mjs).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <jansson.h>

#include "core/base.h"
#include "lab/eval/fade.h"
#include "lod/store/tree.h"

enum { TILES_MAX = 8 };

static json_t *vectors(void)
{
    struct err e = {0};
    json_t *root;
    kit_ok(jsonc_read("tests/vectors/fade.json", &root, &e), e);
    return root;
}

static void the_curve(void **state)
{
    json_t *root = vectors(), *row;
    size_t i;
    json_array_foreach(json_object_get(root, "curve"), i, row)
    {
        double t = json_number_value(json_array_get(row, 0));
        assert_true(fade_share(t) == json_number_value(json_array_get(row, 1)));
    }
    assert_int_equal(i, 8);
    json_decref(root);
}

static void load_tiles(const json_t *rows, struct index *index)
{
    struct err e = {0};
    size_t i;
    json_t *row;
    json_array_foreach(rows, i, row)
    {
        assert_true(i < TILES_MAX);
        const struct store_entry t = {
            .tile.key = {(uint8_t)json_integer_value(json_array_get(row, 0)),
                         (uint32_t)json_integer_value(json_array_get(row, 1)),
                         (uint32_t)json_integer_value(json_array_get(row, 2))},
            .shape.geometric_error_m = 1.0};
        kit_ok(index_add(index, &t, TILES_MAX, &e), e);
        assert_true(i == 0 || key_compare(index->tiles[i - 1].key, t.tile.key) < 0);
    }
}

static void check_step(struct fade *f, const json_t *step, const char *what, size_t at)
{
    uint32_t wanted[TILES_MAX], tile[TILES_MAX + 1];
    float weight[TILES_MAX + 1];
    const json_t *want = json_object_get(step, "wanted"), *drawn = json_object_get(step, "drawn");
    for (size_t i = 0; i < json_array_size(want); i++)
        wanted[i] = (uint32_t)json_integer_value(json_array_get(want, i));
    size_t n = fade_next(f, wanted, json_array_size(want), tile, weight);
    if (n != json_array_size(drawn))
        fail_msg("%s: frame %zu: %zu tiles, not %zu", what, at, n, json_array_size(drawn));
    for (size_t i = 0; i < n; i++) {
        const json_t *one = json_array_get(drawn, i);
        double share = json_number_value(json_array_get(one, 1)) / 8;
        if ((json_int_t)tile[i] != json_integer_value(json_array_get(one, 0)) ||
            (double)weight[i] != share)
            fail_msg("%s: frame %zu: tile %u has %g, not %g", what, at, tile[i], (double)weight[i],
                     share);
    }
}

static void the_rule(void **state)
{
    struct err e = {0};
    json_t *root = vectors(), *c, *step;
    size_t i, k;
    json_array_foreach(json_object_get(root, "cases"), i, c)
    {
        struct index index = {0};
        struct tree tree;
        struct fade f;
        load_tiles(json_object_get(c, "tiles"), &index);
        kit_ok(tree_build(&index, &tree, &e), e);
        size_t frames = (size_t)json_integer_value(json_object_get(c, "frames"));
        kit_ok(fade_open(&tree, frames, &f, &e), e);
        json_array_foreach(json_object_get(c, "steps"), k, step)
            check_step(&f, step, json_string_value(json_object_get(c, "what")), k);
        fade_close(&f);
        tree_free(&tree);
        index_free(&index);
    }
    assert_int_equal(i, 5);
    json_decref(root);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_curve),
        cmocka_unit_test(the_rule),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
