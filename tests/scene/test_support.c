/* How many photographs see a place: a court behind a wall, and the blob that a store keeps.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "codec/container/seen.h"
#include "codec/scene/scene.h"
#include "scene/cells/footprint.h"
#include "scene/cells/support.h"
#include "tests/kit.h"

enum { CELLS = 20, PHOTOS = 4 };
#define CELL_M 5.0
#define WALL_M 10.0 /* height; it stands from x = 0 to 4 */

/* Three cameras in the west, 45 degrees above the middle, and one straight above. The last of the
 * west is a test photograph. */
static void survey(struct scene *s, struct footprint *f, uint8_t *inside)
{
    static const double eyes[PHOTOS][3] = {
        {-100, 0, 100}, {-104, 3, 104}, {-96, -3, 96}, {2, 0, 120}};
    const double target[3] = {2, 0, 0};
    memset(s, 0, sizeof *s);
    s->n_images = PHOTOS;
    s->images = arena_get(&s->arena, PHOTOS, sizeof *s->images);
    for (size_t i = 0; i < PHOTOS; i++) {
        s->images[i].cam = camera_look_at(eyes[i], target, 1.2, 800, 800);
        s->images[i].split = i == 2 ? SCENE_TEST : SCENE_TRAIN;
    }
    memset(inside, 1, CELLS * CELLS);
    *f = (struct footprint){.corner_m = {-50, -50},
                            .cell_m = CELL_M,
                            .nx = CELLS,
                            .ny = CELLS,
                            .inside = inside,
                            .px_per_m = 4}; /* cells of a metre */
}

static void a_wall_hides_the_court(void **state)
{
    struct err e = {0};
    struct scene scene;
    struct footprint f;
    struct support s;
    struct buf blob = {0};
    struct seen_grid seen;
    uint8_t inside[CELLS * CELLS];
    survey(&scene, &f, inside);
    kit_ok(support_open(&f, &s, &e), e);
    assert_int_equal(s.nx, 100);
    assert_int_equal(s.ny, 100);
    for (int i = 0; i < 200 * 200; i++) {
        double x = 0.5 * (i % 200) - 49.75, y = 0.5 * (i / 200) - 49.75;
        const double at[3] = {x, y, x > 0 && x < 4 ? WALL_M : 0.0},
                     veil[3] = {x, y, 30}; /* too faint to hide anything */
        support_add(&s, at, 0.9);
        support_add(&s, veil, 0.3);
    }
    const double pole[3] = {-20.5, 0.5, 9}, far[3] = {1e6, 0, 0};
    support_add(&s, pole, 0.9); /* alone: no surface */
    support_add(&s, far, 0.9);
    kit_ok(support_count(&s, &scene, &e), e);
    for (size_t i = 0; i < s.nx * s.ny; i++) {
        double x = s.corner_m[0] + ((double)(i % s.nx) + 0.5) * s.cell_m,
               y = s.corner_m[1] + ((double)(i / s.nx) + 0.5) * s.cell_m;
        if (fabs(y) > 20)
            continue;
        /* The shadow of the wall's top ends 10 m behind its edge. A cell's edge and the height that
         * hides leave a metre or two open. */
        int want = x > 4.5 && x < 4 + WALL_M - 3 ? 1 : x < -1 || x > 4 + WALL_M + 1 ? 3 : -1;
        if (want >= 0 && s.views[i] != want)
            fail_msg("%.1f, %.1f: %d photographs, not %d", x, y, s.views[i], want);
    }
    kit_ok(support_write(&s, &blob, &e), e);
    kit_ok(seen_decode(blob.data, blob.size, &seen, &e), e);
    assert_memory_equal(seen.views, s.views, s.nx * s.ny);
    assert_true(fabs(seen_at(&seen, -30.2, 4.1) - 3) < 1e-9);
    assert_true(fabs(seen_at(&seen, 6.5, 0.5) - 1) < 1e-9);
    assert_true(seen_at(&seen, 60, 0) == SEEN_VIEWS_MAX); /* outside */
    seen_free(&seen);
    buf_free(&blob);
    support_free(&s);
    arena_free(&scene.arena);
}

static void middles_are_interpolated(void **state)
{
    uint8_t views[4] = {0, 4, 2, 8};
    const struct seen_grid s = {
        .corner_m = {10, 20}, .cell_m = 2, .nx = 2, .ny = 2, .views = views};
    assert_true(fabs(seen_at(&s, 11, 21)) < 1e-12);
    assert_true(fabs(seen_at(&s, 12, 21) - 2) < 1e-12);
    assert_true(fabs(seen_at(&s, 12, 22) - 3.5) < 1e-12);
    assert_true(fabs(seen_at(&s, 13.9, 23.9) - 8) < 1e-12); /* as the border's middle */
    const struct seen_grid none = {0};
    assert_true(seen_at(&none, 0, 0) == SEEN_VIEWS_MAX);
}

static void bad_blobs_are_refused(void **state)
{
    uint8_t views[6] = {0, 1, 2, 3, 8, 8};
    const struct seen_grid s = {.cell_m = 2, .nx = 3, .ny = 2, .views = views};
    const struct seen_grid flat = {.cell_m = 2, .nx = 0, .ny = 2, .views = views};
    struct seen_grid got;
    struct buf b = {0};
    struct err e = {0};
    assert_int_equal(seen_encode(&flat, &b, &e), ERR_ARG);
    kit_ok(seen_encode(&s, &b, &e), e);
    for (size_t n = 0; n < b.size; n++)
        assert_int_equal(seen_decode(b.data, n, &got, &e), ERR_FORMAT);
    b.data[b.size - 1] = 200; /* more than are counted */
    kit_ok(seen_decode(b.data, b.size, &got, &e), e);
    assert_int_equal(got.views[5], SEEN_VIEWS_MAX);
    seen_free(&got);
    b.data[24] ^= 0xff; /* size of a cell */
    b.data[31] = 0xff;
    assert_int_equal(seen_decode(b.data, b.size, &got, &e), ERR_FORMAT);
    b.data[0] = 'X';
    assert_int_equal(seen_decode(b.data, b.size, &got, &e), ERR_FORMAT);
    buf_free(&b);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_wall_hides_the_court),
        cmocka_unit_test(middles_are_interpolated),
        cmocka_unit_test(bad_blobs_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
