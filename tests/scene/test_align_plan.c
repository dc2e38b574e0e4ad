/* The look at a folder before alignment: places, copies, blur, lenses, pairs, the choice of sizes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/image/image.h"
#include "codec/limits.h"
#include "scene/ingest/align_plan.h"
#include "tests/scene/city_kit.h"

enum { PHOTOS = 20, NEIGHBOURS = 4, NEXT = 2 };
static struct arena texts;
static char images[FILE_PATH_MAX];

static int folder_make(void **state)
{
    struct err e = {0};
    struct synth_config c;
    char city[FILE_PATH_MAX];
    if (kit_tmp_make(state))
        return 1;
    kit_ok(file_join(city, kit_tmp, "city", &e), e);
    kit_ok(file_join(images, city, "images", &e), e);
    city_kit_config(&c, &texts, city, PHOTOS);
    kit_ok(synth_run(&c, &e), e);
    return 0;
}

static int folder_remove(void **state)
{
    arena_free(&texts);
    return kit_tmp_remove(state);
}

static size_t index_of(const struct align_plan *p, const char *name)
{
    for (size_t i = 0; i < p->n; i++)
        if (!strcmp(p->photos[i].name, name))
            return i;
    fail_msg("%s is not in the plan", name);
    return 0;
}

static void a_flight_is_one_lens_and_one_place(void **state)
{
    struct err e = {0};
    struct align_plan p;
    kit_ok(align_plan_read(images, &p, &e), e);
    assert_int_equal(p.n, PHOTOS);
    assert_int_equal(p.n_usable, PHOTOS);
    assert_int_equal(p.n_gps, PHOTOS);
    assert_int_equal(p.n_groups, 1);
    assert_int_equal(p.n_clusters, 1);
    assert_int_equal(p.n_copies + p.n_blurred + p.n_broken, 0);
    for (size_t i = 0; i < p.n; i++)
        assert_int_equal(align_plan_find(&p, p.photos[i].link), i);
    assert_true(align_plan_find(&p, "000099.jpg") == SIZE_MAX);
    align_plan_free(&p);
}

static void pairs_are_neighbours_and_successors(void **state)
{
    struct err e = {0};
    struct align_plan p;
    kit_ok(align_plan_read(images, &p, &e), e);
    kit_ok(align_plan_pairs(&p, NEIGHBOURS, NEXT, &e), e);
    assert_true(p.n_pairs >= PHOTOS - 1 && p.n_pairs <= PHOTOS * (NEIGHBOURS + NEXT));
    bool seen[PHOTOS][PHOTOS] = {{false}};
    for (size_t k = 0; k < p.n_pairs; k++) {
        assert_true(p.pairs[k].a < p.pairs[k].b && p.pairs[k].b < PHOTOS);
        assert_false(seen[p.pairs[k].a][p.pairs[k].b]);
        seen[p.pairs[k].a][p.pairs[k].b] = true;
    }
    for (size_t i = 0; i < PHOTOS; i++) { /* by another way: no nearer one than the nearest */
        size_t nearest = SIZE_MAX;
        double least = HUGE_VAL;
        for (size_t k = 0; k < PHOTOS; k++) {
            double d = hypot(p.photos[i].at_m[0] - p.photos[k].at_m[0],
                             p.photos[i].at_m[1] - p.photos[k].at_m[1]);
            if (k != i && d < least) {
                least = d;
                nearest = k;
            }
        }
        assert_true(seen[i < nearest ? i : nearest][i < nearest ? nearest : i]);
        if (i + 1 < PHOTOS)
            assert_true(seen[i][i + 1]);
    }
    align_plan_free(&p);
}

/* A mean over 9 x 9 pixels. */
static void blur(const struct image *in, struct image *out)
{
    struct err e = {0};
    int w = (int)in->width_px, h = (int)in->height_px;
    kit_ok(image_alloc(in->width_px, in->height_px, 3, out, &e), e);
    for (int y = 0; y < h; y++)
        for (int x = 0; x < 3 * w; x++) {
            int sum = 0, n = 0;
            for (int v = y - 4; v <= y + 4; v++)
                for (int u = x - 12; u <= x + 12; u += 3)
                    if (v >= 0 && v < h && u >= 0 && u < 3 * w) {
                        sum += in->px[v * 3 * w + u];
                        n++;
                    }
            out->px[y * 3 * w + x] = (uint8_t)(sum / n);
        }
}

static void what_speaks_against_photographs(void **state)
{
    struct err e = {0};
    struct codec_limits lim = {0};
    struct align_plan p;
    struct image sharp = {0}, soft = {0};
    struct buf b = {0};
    char from[FILE_PATH_MAX], to[FILE_PATH_MAX];
    kit_ok(align_plan_read(images, &p, &e), e);
    kit_ok(file_join(from, images, p.photos[3].name, &e), e);
    align_plan_free(&p);
    kit_ok(file_join(to, images, "soft.jpg", &e), e);
    kit_ok(image_read(from, &lim, &sharp, &e), e);
    blur(&sharp, &soft);
    struct image_gps far = {.has_position = true, .lat_deg = 47.6, .lon_deg = 7.6};
    kit_ok(image_write(to, &soft, 95, &far, &e), e); /* 5 km from the others */
    kit_ok(file_join(to, images, "zz again.jpg", &e), e);
    kit_ok(file_read(from, 0, &b, &e), e);
    kit_ok(file_write(to, b.data, b.size, &e), e);
    kit_ok(file_join(to, images, "half.jpg", &e), e);
    kit_ok(file_write(to, b.data, 40, &e), e);
    kit_ok(align_plan_read(images, &p, &e), e);
    assert_int_equal(p.n, PHOTOS + 3);
    assert_int_equal(p.n_usable, PHOTOS + 1);
    assert_int_equal(p.n_copies, 1);
    assert_int_equal(p.n_broken, 1);
    assert_non_null(p.photos[index_of(&p, "half.jpg")].fault);
    assert_int_equal(p.n_blurred, 1);
    assert_true(p.photos[index_of(&p, "soft.jpg")].blurred);
    assert_int_equal(p.n_clusters, 2);
    assert_true(p.apart_m > 4000 && p.apart_m < 6000);
    kit_ok(align_plan_pairs(&p, NEIGHBOURS, NEXT, &e), e);
    for (size_t k = 0; k < p.n_pairs; k++)
        assert_true(align_plan_usable(&p.photos[p.pairs[k].a]) &&
                    align_plan_usable(&p.photos[p.pairs[k].b]));
    align_plan_free(&p);
    image_free(&sharp);
    image_free(&soft);
    buf_free(&b);
}

static void sizes_follow_the_time_there_is(void **state)
{
    struct align_photo photo = {.width_px = 5472, .height_px = 3648, .copy_of = SIZE_MAX};
    struct align_plan p = {
        .photos = &photo, .n = 1, .n_usable = 300, .megapixels = 20, .n_pairs = 3000};
    const struct align_pace pace = {.cores = 2, .slow = 1, .load = 1}, busy = {2, 2, 3},
                            board = {2, 4, 1};
    struct align_forecast most = align_plan_afford(&p, 0, 0, &pace, 1e9), last = most;
    assert_int_equal(most.edge_px, 3200);
    for (int k = 0; k < 17; k++) {
        double s = 1e5 / (double)(1 << k);
        struct align_forecast f = align_plan_afford(&p, 0, 0, &pace, s);
        double all = align_plan_clock_s(&f, &pace);
        assert_true(all > align_plan_cpu_s(&f) / 2 && all < align_plan_cpu_s(&f));
        assert_true(fabs(align_plan_clock_s(&f, &busy) / all - 3) < 1e-9);
        /* What else the machine does decides no poses. */
        struct align_forecast same = align_plan_afford(&p, 0, 0, &busy, s),
                              fewer = align_plan_afford(&p, 0, 0, &board, s),
                              quarter = align_plan_afford(&p, 0, 0, &pace, s / 4);
        assert_true(same.edge_px == f.edge_px && same.features == f.features);
        assert_true(fabs(same.matches_s / f.matches_s - 2) < 1e-9);
        assert_true(fewer.edge_px == quarter.edge_px && fewer.features == quarter.features);
        assert_true(f.edge_px <= last.edge_px && f.features <= last.features);
        assert_true(all <= s || f.edge_px == 1000);
        last = f;
    }
    assert_int_equal(last.edge_px, 1000);
    assert_int_equal(align_plan_afford(&p, 2222, 0, &pace, 1).edge_px, 2222);
    assert_int_equal(align_plan_afford(&p, 0, 777, &pace, 1).features, 777);
    struct align_forecast slow = align_plan_forecast(&p, 1600, 2048, 3),
                          usual = align_plan_forecast(&p, 1600, 2048, 1);
    assert_true(fabs(slow.matches_s / usual.matches_s - 3) < 1e-9);
}

static void folders_without_use_are_errors(void **state)
{
    struct err e = {0};
    struct align_plan p;
    char empty[FILE_PATH_MAX];
    kit_ok(file_join(empty, kit_tmp, "empty", &e), e);
    kit_fails(align_plan_read(empty, &p, &e), ERR_NOENT, e, "no such folder");
    kit_ok(file_mkdir(empty, &e), e);
    kit_fails(align_plan_read(empty, &p, &e), ERR_NOENT, e, "no photographs");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_flight_is_one_lens_and_one_place),
        cmocka_unit_test(pairs_are_neighbours_and_successors),
        cmocka_unit_test(what_speaks_against_photographs),
        cmocka_unit_test(sizes_follow_the_time_there_is),
        cmocka_unit_test(folders_without_use_are_errors),
    };
    return cmocka_run_group_tests(tests, folder_make, folder_remove);
}
