/* The forecast of a run, against recorded times of a run and against simulated ones.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>

#include "codec/scene/scene.h"
#include "tests/kit.h"
#include "train/base/stage.h"
#include "train/forecast.h"
#include "train/photographs/gallery.h"

enum { PHOTOS = 73, TESTS = 11, LEVELS = 3, LIMIT_PERCENT = 20 };

/* A city of the demo's size, 3,000 steps at 480 x 360 px, two cores, levels 1 to 3. */
static const struct look {
    uint32_t level, step; /* step 0: the level begins */
    double gaussians, at_s;
} recorded[] = {
    {1, 0, 64707, 0.1},       {1, 100, 69587, 0.96},    {1, 200, 73074, 1.76},
    {1, 300, 75165, 2.62},    {1, 400, 75863, 3.27},    {1, 450, 75863, 3.51},
    {2, 0, 75863, 3.68},      {2, 100, 109053, 5.3},    {2, 200, 132761, 6.93},
    {2, 300, 146985, 8.69},   {2, 400, 151727, 10.45},  {2, 450, 151727, 11.18},
    {3, 0, 151727, 11.61},    {3, 100, 191981, 14.47},  {3, 200, 226042, 17.29},
    {3, 300, 253910, 20.41},  {3, 400, 275585, 23.51},  {3, 500, 291068, 26.81},
    {3, 600, 300357, 30.15},  {3, 700, 303454, 33.51},  {3, 800, 265091, 37.6},
    {3, 900, 231578, 41.57},  {3, 1000, 202303, 45.31}, {3, 1100, 202303, 47.82},
    {3, 1200, 202303, 50.38}, {3, 1300, 202303, 52.91}, {3, 1400, 202303, 55.39},
    {3, 1500, 202303, 57.93},
};
#define RECORDED_S 60.12 /* the whole */

struct fixture {
    struct train_config cfg;
    struct scene_image images[PHOTOS];
    uint32_t list[PHOTOS];
    struct scene scene;
    struct gallery gallery;
    struct stage at;
    struct forecast forecast;
};

static void open_demo(struct fixture *f)
{
    *f = (struct fixture){0};
    for (uint32_t i = 0; i < PHOTOS; i++) {
        f->images[i].cam = (struct camera){.width_px = 480, .height_px = 360};
        f->list[i] = i;
    }
    f->scene = (struct scene){.images = f->images, .n_images = PHOTOS};
    f->gallery =
        (struct gallery){.cfg = &f->cfg, .scene = &f->scene, .images = f->list, .n_images = PHOTOS};
    f->at.n_levels = LEVELS;
    static const size_t budget[LEVELS] = {75863, 151727, 202303};
    static const double downsample[LEVELS] = {4, 2, 1};
    for (uint32_t k = 0; k < LEVELS; k++)
        f->at.levels[k] = (struct schedule){.level = k + 1,
                                            .n_levels = LEVELS,
                                            .steps = k < 2 ? 450 : 1500,
                                            .downsample = downsample[k],
                                            .budget = budget[k],
                                            .interval = 50,
                                            .densify_until = 750};
    forecast_open(&f->forecast, &f->gallery, &f->at, TESTS, true);
}

/* From 10 s on, a seventh of the run, until its last steps. */
static void a_recorded_run_is_forecast_within_a_fifth(void **state)
{
    static struct fixture f;
    double worst = 0.0, worst_s = 0.0;
    open_demo(&f);
    assert_true(forecast_left_s(&f.forecast, &f.at, 1000.0) == 0.0);
    for (size_t i = 1; i < sizeof recorded / sizeof recorded[0]; i++) {
        const struct look *a = &recorded[i - 1], *b = &recorded[i];
        f.at.at = b->level - 1;
        f.at.step = b->step;
        if (!b->step)
            continue;
        forecast_add(&f.forecast, &f.at, a->step, b->gaussians, b->at_s - a->at_s);
        double left = forecast_left_s(&f.forecast, &f.at, b->gaussians);
        double off = 100.0 * (left / (RECORDED_S - b->at_s) - 1.0);
        printf("level %u step %4u: %5.1f s left, %5.1f s were: %+.0f %%\n", b->level, b->step, left,
               RECORDED_S - b->at_s, off);
        if (b->at_s > 10.0 && b->at_s < 0.9 * RECORDED_S && fabs(off) > worst) {
            worst = fabs(off);
            worst_s = b->at_s;
        }
    }
    printf("worst %.0f %% at %.0f s, limit %d %%\n", worst, worst_s, LIMIT_PERCENT);
    assert_true(worst <= LIMIT_PERCENT);
}

/* Where a step moves those in the frustum alone, from 20,000 on, it is shorter by what whole runs
 * are: 0.91 of caliterra's (docs/decisions/010-deferred-steps.md). Not with what moves all. */
static void a_step_in_the_frustum_is_shorter(void **state)
{
    static struct fixture f;
    double left[3];
    for (size_t i = 0; i < 3; i++) {
        open_demo(&f);
        f.cfg.defer_from = i ? 20000 : 0;
        f.cfg.appearance = i == 2;
        forecast_open(&f.forecast, &f.gallery, &f.at, TESTS, true);
        f.forecast.work = f.forecast.seconds = 1.0; /* a unit is a second */
        left[i] = forecast_left_s(&f.forecast, &f.at, 10000.0);
    }
    assert_true(left[1] < 0.94 * left[0] && left[1] > 0.88 * left[0]);
    assert_true(left[2] == left[0]);
}

/* A machine that is K times slower, with steps that all cost what the model says. */
static void a_slower_machine_is_measured(void **state)
{
    static struct fixture f;
    double left[2], seconds[2] = {2.0, 14.0};
    for (size_t i = 0; i < 2; i++) {
        open_demo(&f);
        f.at.step = 100;
        forecast_add(&f.forecast, &f.at, 0, 20000.0, seconds[i]);
        left[i] = forecast_left_s(&f.forecast, &f.at, 20000.0);
    }
    assert_true(left[0] > 0.0 && fabs(left[1] / left[0] - 7.0) < 1e-9);
}

static void what_is_done_is_not_left(void **state)
{
    static struct fixture f;
    open_demo(&f);
    f.at.step = 100;
    forecast_add(&f.forecast, &f.at, 0, 20000.0, 2.0);
    double before = forecast_left_s(&f.forecast, &f.at, 20000.0);
    f.at.step = 400;
    double later = forecast_left_s(&f.forecast, &f.at, 75000.0);
    f.at.at = LEVELS - 1;
    f.at.step = 1500;
    double end = forecast_left_s(&f.forecast, &f.at, 300000.0);
    f.at.at = LEVELS;
    assert_true(later < before && end < later && end > 0.0);
    assert_true(forecast_left_s(&f.forecast, &f.at, 300000.0) == 0.0);
}

/* The finest level first, whose steps cost most, and then ever less. */
static void the_order_of_levels_counts(void **state)
{
    static struct fixture f;
    double left[LEVELS + 1];
    open_demo(&f);
    f.at.turned = true;
    f.at.levels[0].derived = f.at.levels[1].derived = true;
    f.at.levels[0].thin_share = f.at.levels[1].thin_share = 0.5;
    for (size_t k = 0; k < 2; k++)
        f.at.levels[k].densify_until = 0;
    f.at.at = LEVELS - 1;
    f.at.step = 100;
    forecast_add(&f.forecast, &f.at, 0, 20000.0, 2.0);
    f.at.step = 0;
    for (size_t i = 0; i <= LEVELS; i++) {
        left[i] = forecast_left_s(&f.forecast, &f.at, 300000.0 / (double)(1 << i));
        assert_true(i == 0 || left[i] < left[i - 1]);
        f.at.at = stage_after(&f.at, f.at.at);
    }
    assert_true(left[LEVELS] == 0.0 && left[0] > 3.0 * left[1]);
}

static void times_are_told_in_words(void **state)
{
    char text[32];
    static const struct {
        double s;
        const char *text;
    } times[] = {{42.4, "42 s"}, {600.0, "10 min"}, {12000.0, "3 h 20 min"}, {190800.0, "2 d 5 h"}};
    for (size_t i = 0; i < sizeof times / sizeof times[0]; i++) {
        forecast_text(times[i].s, text, sizeof text);
        assert_string_equal(text, times[i].text);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_recorded_run_is_forecast_within_a_fifth),
        cmocka_unit_test(a_step_in_the_frustum_is_shorter),
        cmocka_unit_test(a_slower_machine_is_measured),
        cmocka_unit_test(what_is_done_is_not_left),
        cmocka_unit_test(the_order_of_levels_counts),
        cmocka_unit_test(times_are_told_in_words),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
