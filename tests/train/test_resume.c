/* Runs that are stopped and gone on with end as if they had not been stopped; what a run was made
 * of may not change meanwhile; and results are replaced only when that was asked for.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/image.h"
#include "scene/cells/cell.h"
#include "tests/train/blobs.h"
#include "train/base/schedule.h"
#include "train/photographs/inputs.h"

#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include <jansson.h>

/* A run that is stopped after each of these numbers of steps and resumed, but not to its end. */
static void train_in_pieces(struct trial *t, const int64_t *pieces, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        t->c.stop_after = pieces[i];
        t->c.resume = i > 0;
        t->c.overwrite = i == 0;
        kit_fails(trial_run(t), ERR_CANCEL, t->e, "--resume goes on");
    }
    t->c.stop_after = 0;
    t->c.resume = true;
}

static void stopped_run_goes_on(enum schedule_order order, const int64_t *pieces, size_t n_pieces)
{
    struct trial t;
    trial_open(&t);
    t.c.level_order = order;
    t.c.defer_from = 1;
    kit_ok(trial_run(&t), t.e);
    t.c.output = t.parts;
    train_in_pieces(&t, pieces, n_pieces);
    t.c.resume = false; /* it is not thrown away unasked */
    kit_fails(trial_run(&t), ERR_ARG, t.e, "an unfinished run is there");
    t.c.resume = true;
    t.c.seed++;
    kit_fails(trial_run(&t), ERR_ARG, t.e, "seed");
    t.c.seed--;
    t.c.cache_mib = 1; /* may change: it cannot matter */
    double now = clock_s();
    kit_ok(trial_run(&t), t.e);
    now = clock_s() - now;
    blobs_same_levels(3, t.out, t.parts);
    for (unsigned i = 0; i < 3; i++) { /* also of levels that other processes finished */
        struct ckpt level;
        toy_read_level(t.parts, i + 1, &level);
        assert_int_equal(t.r.cells[0].n_gaussians[i], level.g.n);
        assert_true(
            t.r.cells[0].psnr_db[i] ==
            json_number_value(json_object_get(json_object_get(level.meta, "test"), "psnr_db")));
        assert_true(t.r.cells[0].ssim[i] > 0.0);
        ckpt_free(&level);
    }
    assert_true(t.r.cells[0].seconds > now); /* and the time that they took */
    trial_close(&t);
}

static void a_stopped_run_goes_on_as_if_it_had_not_been(void **state)
{
    /* pieces of 1, 7, 30, ... steps: in the middle of levels, at their ends, around densifications
     * and between thinnings */
    static const int64_t up[] = {1, 7, 67, 2, 73, 40, 40, 8};
    stopped_run_goes_on(SCHEDULE_COARSE_TO_FINE, up, sizeof up / sizeof up[0]);
    /* 45, 45 and 150 steps, then 30 and 30 */
    static const int64_t both[] = {1, 44, 20, 100, 60, 30, 30, 8};
    stopped_run_goes_on(SCHEDULE_BOTH, both, sizeof both / sizeof both[0]);
}

/* They take over its network, which does not change any more. */
static void coarser_levels_have_the_finest_network(void **state)
{
    struct ckpt level[3];
    struct trial t;
    trial_open(&t);
    t.c.level_order = SCHEDULE_BOTH;
    t.c.appearance = true;
    t.c.iterations.one = 100;
    kit_ok(trial_run(&t), t.e);
    t.c.output = t.parts;
    static const int64_t pieces[] = {30, 41, 2, 20}; /* 15, 15 and 50 steps, then 10 and 10 */
    train_in_pieces(&t, pieces, sizeof pieces / sizeof pieces[0]);
    kit_ok(trial_run(&t), t.e);
    blobs_same_levels(3, t.out, t.parts);
    const struct ckpt_blob *network[3];
    for (unsigned k = 0; k < 3; k++) {
        toy_read_level(t.parts, k + 1, &level[k]);
        network[k] = ckpt_find(&level[k], "appearance");
        assert_non_null(network[k]);
        assert_int_equal(network[k]->size_bytes, network[0]->size_bytes);
        assert_memory_equal(network[k]->data, network[0]->data, network[0]->size_bytes);
        assert_true(level[k].g.embed_len > 0);
    }
    for (unsigned k = 0; k < 3; k++)
        ckpt_free(&level[k]);
    trial_close(&t);
}

/* The text of a hash of the run's inputs, as a level's file has it. */
static void level_input(const char *out, const char *key, char hash[64])
{
    struct ckpt c;
    toy_read_level(out, 3, &c);
    const json_t *inputs = json_object_get(c.meta, "inputs");
    snprintf(hash, 64, "%s", json_string_value(json_object_get(inputs, key)));
    ckpt_free(&c);
}

/* With --level-order both, levels' files say nothing of the steps before they were made again. */
static int64_t steps_before_again(const struct train_config *c)
{
    struct err e = {0};
    const struct cell cell = {.edge_m = 100, .extent_m = 100, .whole = true};
    struct schedule s[TRAIN_LEVELS_MAX];
    kit_ok(schedule_make(c, BLOBS_PHOTOS, &cell, s, &e), e);
    return c->level_order == SCHEDULE_BOTH ? (int64_t)s[0].steps + s[1].steps : 0;
}

static void last_fit(enum schedule_order order)
{
    enum { PLAIN, WHOLE, PARTS, OUTS };
    struct err e = {0};
    struct arena a = {0};
    struct train_result r[2] = {0};
    struct ckpt level[2];
    char out[OUTS][FILE_PATH_MAX], hash[2][64];
    int64_t steps = 0;
    for (int i = 0; i < OUTS; i++)
        kit_tmpdir(out[i]);
    struct train_config c = toy_config(&a, out[PLAIN]);
    c.level_order = order;
    kit_ok(blobs_train(blobs_dir, &c, &r[PLAIN], &e), e);
    c.final_all = true;
    c.output = out[WHOLE];
    kit_ok(blobs_train(blobs_dir, &c, &r[WHOLE], &e), e);
    for (unsigned i = 0; i < 3; i++) {
        assert_true(r[PLAIN].cells[0].psnr_db[i] == r[WHOLE].cells[0].psnr_db[i]);
        toy_read_level(out[PLAIN], i + 1, &level[0]);
        toy_read_level(out[WHOLE], i + 1, &level[1]);
        assert_int_equal(level[0].g.n, level[1].g.n);
        bool same = !memcmp(level[0].g.mean_m, level[1].g.mean_m, level[0].g.n * 12);
        steps += json_integer_value(json_object_get(level[0].meta, "steps"));
        assert_true(same == (i < 2));
        assert_true(json_equal(json_object_get(level[0].meta, "test"),
                               json_object_get(level[1].meta, "test")));
        assert_true(json_equal(json_object_get(level[0].meta, "steps"),
                               json_object_get(level[1].meta, "steps")));
        ckpt_free(&level[0]);
        ckpt_free(&level[1]);
    }
    steps += steps_before_again(&c);
    level_input(out[PLAIN], "photographs", hash[0]); /* the test photograph counts now */
    level_input(out[WHOLE], "photographs", hash[1]);
    assert_string_not_equal(hash[0], hash[1]);
    kit_ok(blobs_train(blobs_dir, &c, &r[WHOLE], &e), e);
    assert_true(r[WHOLE].cells[0].was_done);

    c.output = out[PARTS];
    c.stop_after = steps + 2;
    kit_fails(blobs_train(blobs_dir, &c, &r[WHOLE], &e), ERR_CANCEL, e,
              "trains with all photographs");
    c.stop_after = 0;
    c.resume = true;
    kit_ok(blobs_train(blobs_dir, &c, &r[WHOLE], &e), e);
    blobs_same_levels(3, out[WHOLE], out[PARTS]);
    for (unsigned i = 0; i < 3; i++) {
        toy_read_level(out[PARTS], i + 1, &level[0]);
        assert_true(r[WHOLE].cells[0].psnr_db[i] == r[PLAIN].cells[0].psnr_db[i] &&
                    r[WHOLE].cells[0].n_gaussians[i] == level[0].g.n);
        ckpt_free(&level[0]);
    }
    for (int i = 0; i < OUTS; i++)
        kit_rmdir(out[i]);
    train_result_free(&r[0]);
    train_result_free(&r[1]);
    arena_free(&a);
}

/* Scores and coarser levels are those of a run without it. It can be stopped and repeats. */
static void a_last_fit_takes_all_photographs(void **state)
{
    last_fit(SCHEDULE_COARSE_TO_FINE);
    last_fit(SCHEDULE_BOTH);
}

static void a_damaged_state_is_refused(void **state)
{
    char path[FILE_PATH_MAX + 64];
    struct buf file = {0};
    struct trial t;
    trial_open(&t);
    t.c.stop_after = 3;
    kit_fails(trial_run(&t), ERR_CANCEL, t.e, "step 3");
    snprintf(path, sizeof path, "%s/cells/all/resume.ckpt", t.out);
    kit_ok(file_read(path, 0, &file, &t.e), t.e);
    t.c.resume = true;
    kit_ok(file_write(path, file.data, file.size - 5, &t.e), t.e);
    kit_fails(trial_run(&t), ERR_FORMAT, t.e, "truncated");
    file.data[file.size - 1] ^= 1;
    kit_ok(file_write(path, file.data, file.size, &t.e), t.e);
    kit_fails(trial_run(&t), ERR_FORMAT, t.e, "stat_radius");
    buf_free(&file);
    trial_close(&t);
}

/* States of before have two arrays of floats where there is one of words now. */
static void a_state_with_wide_moments_is_refused(void **state)
{
    struct ckpt s;
    size_t found = 0;
    char path[FILE_PATH_MAX + 64];
    struct trial t;
    trial_open(&t);
    t.c.stop_after = 3;
    kit_fails(trial_run(&t), ERR_CANCEL, t.e, "step 3");
    snprintf(path, sizeof path, "%s/cells/all/resume.ckpt", t.out);
    kit_ok(ckpt_read(path, &s, &t.e), t.e);
    for (size_t i = 0; i < s.n_blobs; i++)
        if (!strcmp(s.blobs[i].name, "adam")) {
            memcpy(s.blobs[i].name, "adam_m1", sizeof "adam_m1");
            found++;
        }
    assert_int_equal(found, 1);
    kit_ok(ckpt_write(path, s.meta, &s.g, s.blobs, s.n_blobs, &t.e), t.e);
    ckpt_free(&s);
    t.c.resume = true;
    kit_fails(trial_run(&t), ERR_FORMAT, t.e, "begin anew with --overwrite");
    t.c.resume = false;
    t.c.overwrite = true;
    kit_fails(trial_run(&t), ERR_CANCEL, t.e, "step 3");
    trial_close(&t);
}

/* One byte more at the end of a file, which no decoder reads. */
static void lengthen(const char *dir, const char *name)
{
    struct err e = {0};
    struct buf b = {0};
    char path[FILE_PATH_MAX];
    kit_ok(file_join(path, dir, name, &e), e);
    kit_ok(file_read(path, 0, &b, &e), e);
    buf_u8(&b, 0);
    kit_ok(file_write(path, b.data, b.size, &e), e);
    buf_free(&b);
}

/* The second pose moves by a centimetre. */
static void move_a_camera(const char *dir)
{
    struct err e = {0};
    struct scene s;
    kit_ok(scene_read(dir, &s, &e), e);
    s.images[1].cam.trans[2] += 0.01;
    kit_ok(scene_write(dir, &s, &e), e);
    scene_free(&s);
}

static void write_mask(const char *dir, uint8_t value)
{
    struct err e = {0};
    struct image mask = {0};
    char path[FILE_PATH_MAX];
    kit_ok(file_join(path, dir, "masks", &e), e);
    kit_ok(file_mkdir(path, &e), e);
    kit_ok(file_join(path, dir, "masks/p1.png.png", &e), e);
    kit_ok(image_alloc(BLOBS_WIDTH, BLOBS_HEIGHT, 1, &mask, &e), e);
    memset(mask.px, 255, BLOBS_WIDTH * BLOBS_HEIGHT);
    memset(mask.px, value, BLOBS_WIDTH);
    kit_ok(image_write(path, &mask, 0, NULL, &e), e);
    image_free(&mask);
}

static void write_depths(const char *dir)
{
    struct err e = {0};
    char path[FILE_PATH_MAX];
    kit_ok(file_join(path, dir, "depth", &e), e);
    kit_ok(file_mkdir(path, &e), e);
    kit_ok(file_join(path, dir, "depth/depths.json", &e), e);
    kit_ok(file_write(path, "{}", 2, &e), e);
}

static void remove_depths(const char *dir)
{
    struct err e = {0};
    char path[FILE_PATH_MAX];
    kit_ok(file_join(path, dir, "depth/depths.json", &e), e);
    assert_int_equal(unlink(path), 0);
}

/* A finished run, and one to go on with, of other photographs, masks, poses or depths are neither
 * "complete" nor gone on with. */
static void what_a_run_was_made_of_may_not_change(void **state)
{
    struct err e = {0};
    struct arena a = {0};
    struct train_result r = {0};
    char dir[FILE_PATH_MAX], half[FILE_PATH_MAX];
    kit_tmpdir(dir);
    kit_tmpdir(half);
    blobs_write(dir, true);
    write_mask(dir, 255);
    struct train_config whole = toy_config(&a, NULL), part = toy_config(&a, half);
    whole.depth_prior = part.depth_prior = "auto";
    whole.iterations.one = 30;
    part.stop_after = 3;
    kit_ok(blobs_train(dir, &whole, &r, &e), e);
    kit_fails(blobs_train(dir, &part, &r, &e), ERR_CANCEL, e, "--resume goes on");
    part.resume = true;
    kit_ok(blobs_train(dir, &whole, &r, &e), e);
    assert_true(r.cells[0].was_done);
    kit_fails(blobs_train(dir, &part, &r, &e), ERR_CANCEL, e, "--resume goes on");
    for (int i = 0; i < 4; i++) {
        static const char *const said[] = {"photographs, or which of them train, have changed",
                                           "masks have changed", "poses, exposures or sparse",
                                           "had no known depths, now there are some"};
        if (i == 0)
            lengthen(dir, "images/p4.png");
        else if (i == 1)
            write_mask(dir, 0);
        else if (i == 2)
            move_a_camera(dir);
        else
            write_depths(dir);
        kit_fails(blobs_train(dir, &whole, &r, &e), ERR_ARG, e, said[i]);
        kit_expect_text(e.msg, "--overwrite", __FILE__, __LINE__);
        kit_fails(blobs_train(dir, &part, &r, &e), ERR_DATA, e, said[i]);
        kit_expect_text(e.msg, "--overwrite", __FILE__, __LINE__);
        if (i == 3) /* maps that say nothing: it would not train with them */
            continue;
        whole.overwrite = part.overwrite = true;
        part.resume = false;
        kit_ok(blobs_train(dir, &whole, &r, &e), e);
        assert_false(r.cells[0].was_done);
        kit_fails(blobs_train(dir, &part, &r, &e), ERR_CANCEL, e, "--resume goes on");
        whole.overwrite = part.overwrite = false;
        part.resume = true;
    }
    remove_depths(dir);
    kit_ok(blobs_train(dir, &whole, &r, &e), e);
    assert_true(r.cells[0].was_done);
    struct inputs none = {0}, some = {0};
    snprintf(some.hash[INPUTS_DEPTHS], sizeof some.hash[INPUTS_DEPTHS], "a hash");
    json_t *meta = json_pack("{s:o}", "inputs", inputs_to_json(&some));
    assert_int_equal(inputs_check(&some, "a.ckpt", meta, &e), ERR_OK);
    kit_fails(inputs_check(&none, "a.ckpt", meta, &e), ERR_DATA, e, "had known depths, now");
    json_decref(meta);
    kit_rmdir(dir);
    kit_rmdir(half);
    train_result_free(&r);
    arena_free(&a);
}

/* Results are replaced only when that was asked for. */
static void a_finished_run_is_not_lost(void **state)
{
    char path[FILE_PATH_MAX + 64];
    struct buf first = {0}, again = {0};
    struct trial t;
    trial_open(&t);
    t.c.iterations.one = 12;
    t.c.prune_contribution = 0.0; /* photographs are ranked all the same */
    t.c.prune_support = 0;
    kit_ok(trial_run(&t), t.e);
    assert_false(t.r.cells[0].was_done);
    snprintf(path, sizeof path, "%s/cells/all/residuals.json", t.out);
    assert_true(file_exists(path));
    snprintf(path, sizeof path, "%s/cells/all/level3.ckpt", t.out);
    kit_ok(file_read(path, 0, &first, &t.e), t.e);
    kit_ok(trial_run(&t), t.e); /* the same options: nothing to do */
    assert_true(t.r.cells[0].was_done);
    t.c.iterations.one = 15;
    for (int resume = 0; resume < 2; resume++) {
        t.c.resume = resume;
        kit_fails(trial_run(&t), ERR_ARG, t.e, "iterations = 12, now it is 15");
        assert_non_null(strstr(t.e.msg, "--overwrite"));
    }
    kit_ok(file_read(path, 0, &again, &t.e), t.e);
    assert_int_equal(first.size, again.size);
    assert_memory_equal(first.data, again.data, first.size);
    t.c.resume = false;
    t.c.level_count = 2; /* and where the finest level has another number */
    kit_fails(trial_run(&t), ERR_ARG, t.e, "--overwrite");
    t.c.level_count = 3;
    t.c.overwrite = true;
    kit_ok(trial_run(&t), t.e);
    assert_false(t.r.cells[0].was_done);
    t.c.overwrite = false;
    kit_ok(trial_run(&t), t.e);
    assert_true(t.r.cells[0].was_done);
    t.c.overwrite = true; /* nothing is left that tells of the run before */
    t.c.stop_after = 2;
    kit_fails(trial_run(&t), ERR_CANCEL, t.e, "stopped");
    snprintf(path, sizeof path, "%s/cells/all/residuals.json", t.out);
    assert_false(file_exists(path));
    buf_free(&first);
    buf_free(&again);
    trial_close(&t);
}

/* A run that begins anew and ends before its first own state leaves none of the run before. */
static void a_state_that_was_given_up_is_gone(void **state)
{
    char resume[FILE_PATH_MAX + 64], metrics[FILE_PATH_MAX + 64];
    struct trial t;
    trial_open(&t);
    snprintf(resume, sizeof resume, "%s/cells/all/resume.ckpt", t.out);
    snprintf(metrics, sizeof metrics, "%s/cells/all/metrics.jsonl", t.out);
    t.c.stop_after = 2;
    kit_fails(trial_run(&t), ERR_CANCEL, t.e, "stopped");
    assert_true(file_exists(resume));
    assert_int_equal(unlink(metrics), 0);
    kit_ok(file_mkdir(metrics, &t.e), t.e); /* what stops the next run early */
    t.c.overwrite = true;
    kit_fails(trial_run(&t), ERR_IO, t.e, "metrics.jsonl");
    assert_false(file_exists(resume));
    assert_int_equal(rmdir(metrics), 0);
    trial_close(&t);
}

int main(int argc, char **argv)
{
    if (argc > 1)
        cmocka_set_test_filter(argv[1]);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_stopped_run_goes_on_as_if_it_had_not_been),
        cmocka_unit_test(coarser_levels_have_the_finest_network),
        cmocka_unit_test(a_last_fit_takes_all_photographs),
        cmocka_unit_test(a_damaged_state_is_refused),
        cmocka_unit_test(a_state_with_wide_moments_is_refused),
        cmocka_unit_test(what_a_run_was_made_of_may_not_change),
        cmocka_unit_test(a_finished_run_is_not_lost),
        cmocka_unit_test(a_state_that_was_given_up_is_gone),
    };
    return cmocka_run_group_tests_name("resume", tests, blobs_open, blobs_close);
}
