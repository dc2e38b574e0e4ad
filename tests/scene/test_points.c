/* Sparse points that ingest leaves out: all that were put where no surface is, and no others.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/scene/scene.h"
#include "scene/ingest/ingest.h"
#include "scene/ingest/ingest_internal.h"
#include "tests/kit.h"

enum { SIDE = 60, CAMERAS = 16, ROOM = 6000 };

struct town {
    struct scene s;
    uint8_t want[ROOM]; /* enum ingest_point */
    size_t n_want[INGEST_POINT_VERDICTS];
};

/* A point that the first n of these cameras see. */
static void add(struct town *t, double x, double y, double z, float error_px, const uint32_t *by,
                size_t n, enum ingest_point want)
{
    size_t i = t->s.n_points++;
    assert_true(i < ROOM);
    t->s.points[i] =
        (struct scene_point){.enu_m = {x, y, z}, .error_px = error_px, .track_length = (uint32_t)n};
    for (size_t k = 0; k < n; k++)
        t->s.tracks[t->s.n_tracks++] = (struct scene_track){(uint32_t)i, by[k], 1.0f, 1.0f};
    t->want[i] = (uint8_t)want;
    t->n_want[want]++;
}

static void cameras(struct town *t)
{
    t->s.images = arena_get(&t->s.arena, CAMERAS, sizeof *t->s.images);
    t->s.n_images = CAMERAS;
    for (uint32_t k = 0; k < CAMERAS;
         k++) { /* looking down from 80 m, 15 m apart; two of them 0.1 m */
        struct camera *c = &t->s.images[k].cam;
        double at[3] = {15.0 * (k % 4), 15.0 * (k / 4), 80.0};
        if (k == 1)
            at[0] = 0.1;
        kit_camera_down(at, c);
    }
}

/* A park of 60 m at 1 m spacing, a tower of 40 m, a lamp post of three points, and what matching
 * got wrong. */
static void town_make(struct town *t)
{
    static const uint32_t all[CAMERAS] = {0, 3, 12, 15, 5, 6, 9, 10}, same[2] = {0, 1},
                          apart[2] = {2, 13};
    memset(t, 0, sizeof *t);
    t->s.points = arena_get(&t->s.arena, ROOM, sizeof *t->s.points);
    t->s.tracks = arena_get(&t->s.arena, ROOM * CAMERAS, sizeof *t->s.tracks);
    cameras(t);
    for (int y = 0; y < SIDE; y++)
        for (int x = 0; x < SIDE; x++)
            add(t, x, y, 0.2 * sin(0.7 * x) * cos(0.9 * y), 0.3f, all, 5 + (size_t)(x + y) % 4,
                INGEST_POINT_KEPT);
    for (int z = 1; z < 40; z++)
        for (int k = 0; k < 10; k++) {
            add(t, 20 + k, 20, z, 0.3f, all, 4, INGEST_POINT_KEPT);
            add(t, 20, 20 + k, z, 0.4f, all, 4, INGEST_POINT_KEPT);
        }
    for (int z = 1; z <= 3; z++)
        add(t, 45.5, 10.5, 1.2 * z, 0.3f, all, 6, INGEST_POINT_KEPT);
    for (int k = 0; k < 40; k++) /* under the park */
        add(t, 5 + (k * 7) % 50, 5 + (k * 11) % 50, -12.0 - 5.5 * k, 0.8f, apart, 2,
            INGEST_POINT_ALONE);
    add(t, 30.5, 50.5, -6.0, 0.8f, apart, 2, INGEST_POINT_BELOW);
    add(t, 50.5, 30.5, 6.5, 0.8f, apart, 2, INGEST_POINT_ABOVE);
    add(t, 40.5, 40.5, 25.0, 0.3f, apart, 2, INGEST_POINT_ALONE);
    add(t, 10.5, 40.5, 0.0, 0.3f, same, 2, INGEST_POINT_ANGLE);
    add(t, 12.5, 42.5, 0.0, 3.0f, all, 8, INGEST_POINT_ERROR);
}

static int track_compare(const void *a, const void *b)
{
    const struct scene_track *p = a, *q = b;
    return p->image != q->image ? (p->image > q->image) - (p->image < q->image)
                                : (p->point > q->point) - (p->point < q->point);
}

static void config(struct ingest_config *c, struct arena *a)
{
    struct err e = {0};
    kit_ok(options_defaults(ingest_options(), c, a, &e), e);
}

static void test_outliers(void **state)
{
    static struct town t;
    static struct scene_point before[ROOM];
    struct ingest_config cfg;
    struct arena texts = {0};
    struct err e = {0};
    size_t count[INGEST_POINT_VERDICTS], k = 0;
    config(&cfg, &texts);
    town_make(&t);
    size_t n = t.s.n_points;
    qsort(t.s.tracks, t.s.n_tracks, sizeof *t.s.tracks, track_compare);
    memcpy(before, t.s.points, n * sizeof *before);
    kit_ok(ingest_points_filter(&cfg, &t.s, count, &e), e);
    /* Deep outliers have one another for neighbours: either reason is right. */
    assert_int_equal(count[INGEST_POINT_ALONE] + count[INGEST_POINT_BELOW],
                     t.n_want[INGEST_POINT_ALONE] + t.n_want[INGEST_POINT_BELOW]);
    assert_true(count[INGEST_POINT_ALONE] > 0 && count[INGEST_POINT_BELOW] > 0);
    assert_int_equal(count[INGEST_POINT_ANGLE], t.n_want[INGEST_POINT_ANGLE]);
    assert_int_equal(count[INGEST_POINT_ERROR], t.n_want[INGEST_POINT_ERROR]);
    assert_int_equal(count[INGEST_POINT_ABOVE], t.n_want[INGEST_POINT_ABOVE]);
    assert_int_equal(t.s.n_points, t.n_want[INGEST_POINT_KEPT]);
    for (size_t i = 0; i < n; i++) /* the right ones, in their order */
        if (t.want[i] == INGEST_POINT_KEPT)
            assert_memory_equal(&t.s.points[k++], &before[i], sizeof *before);
    uint32_t *seen = mem_array(t.s.n_points, sizeof *seen);
    for (size_t i = 0; i < t.s.n_tracks; i++) {
        assert_true(t.s.tracks[i].point < t.s.n_points);
        assert_true(!i || track_compare(&t.s.tracks[i - 1], &t.s.tracks[i]) < 0);
        seen[t.s.tracks[i].point]++;
    }
    for (size_t i = 0; i < t.s.n_points; i++)
        assert_int_equal(seen[i], t.s.points[i].track_length);
    mem_free(seen);
    arena_free(&t.s.arena);
    arena_free(&texts);
}

static void test_off_and_empty(void **state)
{
    static struct town t;
    struct scene none = {0};
    struct ingest_config cfg;
    struct arena texts = {0};
    struct err e = {0};
    size_t count[INGEST_POINT_VERDICTS];
    config(&cfg, &texts);
    kit_ok(ingest_points_filter(&cfg, &none, count, &e), e);
    assert_int_equal(count[INGEST_POINT_KEPT], 0);
    town_make(&t);
    size_t n = t.s.n_points;
    cfg.point_filter = false;
    kit_ok(ingest_points_filter(&cfg, &t.s, count, &e), e);
    assert_int_equal(t.s.n_points, n);
    assert_int_equal(count[INGEST_POINT_KEPT], n);
    arena_free(&t.s.arena);
    arena_free(&texts);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_outliers),
        cmocka_unit_test(test_off_and_empty),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
