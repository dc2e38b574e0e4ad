/* Masks: reading and refusing, shrinking, the way through ingest, points on masked pixels, and a
 * city with moving vehicles trained with and without its masks (F17).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/image.h"
#include "codec/scene/mask.h"
#include "codec/scene/scene.h"
#include "core/options/options.h"
#include "scene/cells/cell.h"
#include "scene/ingest/ingest.h"
#include "scene/ingest/ingest_internal.h"
#include "tests/kit.h"
#include "train/model/init.h"

#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

static void mask_write(const char *path, uint32_t w, uint32_t h, uint32_t x0, uint32_t y0,
                       uint32_t edge)
{
    struct err e = {0};
    struct image img = {0};
    kit_ok(image_alloc(w, h, 1, &img, &e), e);
    memset(img.px, 255, (size_t)w * h);
    for (uint32_t y = y0; y < y0 + edge; y++)
        memset(img.px + (size_t)y * w + x0, 0, edge);
    kit_ok(image_write(path, &img, 0, NULL, &e), e);
    image_free(&img);
}

static void a_pixel_is_ignored_when_any_below_it_is(void **state)
{
    struct err e = {0};
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct image full = {0}, small = {0}, large = {0};
    kit_tmpdir(dir);
    kit_ok(mask_path(dir, "a.jpg", path, &e), e);
    kit_expect_text(path, "/a.jpg.png", __FILE__, __LINE__);
    mask_write(path, 10, 6, 4, 3, 1);
    kit_ok(mask_read(path, 10, 6, &full, &e), e);
    assert_int_equal(full.channels, 1);
    for (uint32_t i = 0; i < 60; i++)
        assert_int_equal(full.px[i], i == 34 ? 0 : 255);
    /* 10 x 6 -> 4 x 2: column 4 covers 1.6..2.0 of the result's columns, row 3 is its row 1. */
    kit_ok(mask_resize(&full, 4, 2, &small, &e), e);
    for (uint32_t i = 0; i < 8; i++)
        assert_int_equal(small.px[i], i == 4 + 1 ? 0 : 255);
    kit_ok(mask_resize(&full, 20, 12, &large, &e), e);
    size_t ignored = 0;
    for (uint32_t i = 0; i < 240; i++)
        ignored += !large.px[i];
    assert_int_equal(ignored, 4);
    image_free(&full);
    kit_fails(mask_read(path, 11, 6, &full, &e), ERR_DATA, e, "10 x 6");
    kit_expect_text(e.msg, "a.jpg.png", __FILE__, __LINE__);
    image_free(&small);
    image_free(&large);
    kit_rmdir(dir);
}

/* Masks of 0 and 1, and of numbers of kinds: what is not 0 is used. Black leaves nothing. */
static void dark_masks_have_numbers(void **state)
{
    enum { W = 8, H = 4 };
    struct err e = {0};
    char dir[FILE_PATH_MAX], from[FILE_PATH_MAX], to[FILE_PATH_MAX];
    struct image img = {0}, out = {0};
    struct ingest_view v;
    enum ingest_mask made;
    const struct lens lens = {
        .model = LENS_SIMPLE_PINHOLE, .width_px = W, .height_px = H, .params = {10, 4, 2}};
    kit_tmpdir(dir);
    kit_ok(file_join(from, dir, "in.png", &e), e);
    kit_ok(file_join(to, dir, "out.png", &e), e);
    kit_ok(ingest_view_make(&lens, W, H, W, &v, &e), e);
    for (uint8_t most = 0; most < 128; most = (uint8_t)(2 * most + 1)) {
        kit_ok(image_alloc(W, H, 1, &img, &e), e);
        for (size_t i = 0; i < W * H; i++)
            img.px[i] = i % 2 ? most : 0;
        kit_ok(image_write(from, &img, 0, NULL, &e), e);
        image_free(&img);
        kit_ok(ingest_mask_convert(&v, from, false, to, &made, &e), e);
        assert_int_equal(made, most ? INGEST_MASK_MADE : INGEST_MASK_WHOLE);
        kit_ok(mask_read(to, W, H, &out, &e), e);
        for (size_t i = 0; i < W * H; i++)
            assert_int_equal(out.px[i], i % 2 && most ? 255 : 0);
        image_free(&out);
    }
    kit_rmdir(dir);
}

/* Of classes in colours nothing says which are to be ignored. Black and one colour are a mask, and
 * a tint is grey. */
static void colours_are_no_mask(void **state)
{
    enum { W = 8, H = 4 };
    static const uint8_t road[3] = {128, 64, 128}, house[3] = {70, 70, 70},
                         white[3] = {255, 240, 250};
    struct err e = {0};
    struct image img = {0}, out = {0};
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    kit_tmpdir(dir);
    kit_ok(file_join(path, dir, "classes.png", &e), e);
    kit_ok(image_alloc(W, H, 3, &img, &e), e);
    for (size_t i = 0; i < W * H; i++)
        memcpy(img.px + 3 * i, i % 5 ? house : road, 3);
    kit_ok(image_write(path, &img, 0, NULL, &e), e);
    kit_fails(mask_read(path, W, H, &out, &e), ERR_DATA, e, "has several colours, (128, 64, 128)");
    assert_null(out.px);
    for (size_t i = 0; i < W * H; i++)
        memcpy(img.px + 3 * i, i % 5 ? (const uint8_t[3]){0, 0, 200} : (const uint8_t[3]){0, 0, 0},
               3);
    kit_ok(image_write(path, &img, 0, NULL, &e), e);
    kit_ok(mask_read(path, W, H, &out, &e), e);
    for (size_t i = 0; i < W * H; i++)
        assert_int_equal(out.px[i], i % 5 ? 255 : 0);
    image_free(&out);
    for (size_t i = 0; i < W * H; i++)
        memcpy(img.px + 3 * i, i % 5 ? white : (const uint8_t[3]){0, 0, 0}, 3);
    kit_ok(image_write(path, &img, 0, NULL, &e), e);
    kit_ok(mask_read(path, W, H, &out, &e), e);
    for (size_t i = 0; i < W * H; i++)
        assert_int_equal(out.px[i], i % 5 ? 255 : 0);
    image_free(&img);
    image_free(&out);
    kit_rmdir(dir);
}

/* A mask of two greys, as of a palette for the eye, masks nothing: the first of them is reported.
 * One of 1 alone belongs to masks of 0 and 1, and is white. */
static void greys_without_black_are_told(void **state)
{
    enum { W = 8, H = 4 };
    static const struct {
        const char *name;
        uint8_t grey[2];
    } masks[] = {{"ones.png", {1, 1}}, {"greys.png", {38, 75}}, {"more.png", {38, 75}}};
    struct err e = {0};
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct buf said = {0};
    kit_tmpdir(dir);
    kit_ok(file_join(path, dir, "log", &e), e);
    const int was = dup(STDERR_FILENO), log = open(path, O_CREAT | O_WRONLY, 0600);
    assert_true(was >= 0 && log >= 0 && dup2(log, STDERR_FILENO) >= 0);
    for (size_t k = 0; k < sizeof masks / sizeof *masks; k++) {
        struct image img = {0}, out = {0};
        kit_ok(file_join(path, dir, masks[k].name, &e), e);
        kit_ok(image_alloc(W, H, 1, &img, &e), e);
        for (size_t i = 0; i < W * H; i++)
            img.px[i] = masks[k].grey[i % 2];
        kit_ok(image_write(path, &img, 0, NULL, &e), e);
        kit_ok(mask_read(path, W, H, &out, &e), e);
        assert_null(memchr(out.px, 0, W * H));
        image_free(&img);
        image_free(&out);
    }
    dup2(was, STDERR_FILENO);
    close(was);
    close(log);
    kit_ok(file_join(path, dir, "log", &e), e);
    kit_ok(file_read(path, 0, &said, &e), e);
    buf_u8(&said, 0);
    kit_expect_text((const char *)said.data, "greys.png: has greys from 38 to 75", __FILE__,
                    __LINE__);
    assert_null(strstr((const char *)said.data, "ones.png"));
    assert_null(strstr((const char *)said.data, "more.png"));
    buf_free(&said);
    kit_rmdir(dir);
}

/* A photograph whose background was made transparent: its colours are no mask. */
static void cutouts_are_masks_by_their_alpha(void **state)
{
    enum { W = 8, H = 4 };
    struct err e = {0};
    char dir[FILE_PATH_MAX], from[FILE_PATH_MAX], to[FILE_PATH_MAX];
    struct image img = {0}, out = {0};
    struct ingest_view v;
    enum ingest_mask made;
    const struct lens lens = {
        .model = LENS_SIMPLE_PINHOLE, .width_px = W, .height_px = H, .params = {10, 4, 2}};
    kit_tmpdir(dir);
    kit_ok(file_join(from, dir, "in.png", &e), e);
    kit_ok(file_join(to, dir, "out.png", &e), e);
    kit_ok(ingest_view_make(&lens, W, H, W, &v, &e), e);
    for (int opaque = 0; opaque < 2; opaque++) { /* where nothing is, colours count */
        kit_ok(image_alloc(W, H, 4, &img, &e), e);
        for (size_t i = 0; i < W * H; i++) {
            memset(img.px + 4 * i, i % 3 ? 200 : 20, 3);
            img.px[4 * i + 3] = opaque || i % 2 ? 255 : 0;
        }
        kit_ok(image_write(from, &img, 0, NULL, &e), e);
        image_free(&img);
        kit_ok(ingest_mask_convert(&v, from, false, to, &made, &e), e);
        assert_int_equal(made, INGEST_MASK_MADE);
        kit_ok(mask_read(to, W, H, &out, &e), e);
        for (size_t i = 0; i < W * H; i++)
            assert_int_equal(out.px[i], i % (opaque ? 3 : 2) ? 255 : 0);
        image_free(&out);
    }
    kit_rmdir(dir);
}

static void undistortion_moves_masks_as_it_moves_pictures(void **state)
{
    enum { W = 120, H = 80 };
    struct err e = {0};
    char dir[FILE_PATH_MAX], from[FILE_PATH_MAX], to[FILE_PATH_MAX];
    struct image out = {0};
    struct ingest_view v;
    struct lens lens = {.model = LENS_OPENCV,
                        .width_px = W,
                        .height_px = H,
                        .params = {100.0, 100.0, 60.0, 40.0, -0.08, 0.01, 0.0, 0.0}};
    kit_tmpdir(dir);
    kit_ok(file_join(from, dir, "in.png", &e), e);
    kit_ok(file_join(to, dir, "out.png", &e), e);
    mask_write(from, W, H, 90, 55, 9); /* 90..98 x 55..63 */
    kit_ok(ingest_view_make(&lens, W, H, 60, &v, &e), e);
    enum ingest_mask made;
    kit_ok(ingest_mask_convert(&v, from, false, to, &made, &e), e);
    assert_int_equal(made, INGEST_MASK_MADE);
    kit_ok(mask_read(to, v.pinhole.width_px, v.pinhole.height_px, &out, &e), e);
    double x, y;
    assert_true(ingest_view_map(&v, &lens, 94.5, 59.5, &x, &y)); /* the middle of the square */
    assert_int_equal(out.px[(size_t)y * out.width_px + (size_t)x], 0);
    assert_true(ingest_view_map(&v, &lens, 84.0, 59.5, &x, &y)); /* six pixels beside it */
    assert_int_equal(out.px[(size_t)y * out.width_px + (size_t)x], 255);
    image_free(&out);
    kit_rmdir(dir);
}

static void points_on_masked_pixels_are_left_out(void **state)
{
    struct err e = {0};
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    char name[] = "p.jpg", other[] = "q.jpg";
    struct scene_image images[2] = {{.name = name, .cam = {.width_px = 20, .height_px = 10}},
                                    {.name = other, .cam = {.width_px = 20, .height_px = 10}}};
    struct scene_track tracks[4] = {{.point = 0, .image = 0, .x_px = 5.5f, .y_px = 5.5f},
                                    {.point = 1, .image = 0, .x_px = 15.5f, .y_px = 5.5f},
                                    {.point = 1, .image = 1, .x_px = 5.5f, .y_px = 5.5f},
                                    {.point = 2, .image = 1, .x_px = 5.5f, .y_px = 5.5f}};
    struct scene s = {
        .images = images, .n_images = 2, .n_points = 3, .tracks = tracks, .n_tracks = 4};
    const uint32_t list[2] = {0, 1};
    uint8_t use[3] = {1, 1, 1};
    kit_tmpdir(s.dir);
    kit_ok(mask_points(&s, list, 2, use, &e), e);
    assert_true(use[0] && use[1] && use[2]);
    kit_ok(file_join(dir, s.dir, "masks", &e), e);
    kit_ok(file_mkdir(dir, &e), e);
    kit_ok(mask_path(dir, "p.jpg", path, &e), e);
    mask_write(path, 20, 10, 15, 5, 1);
    kit_ok(mask_points(&s, list, 2, use, &e), e);
    assert_true(use[0] && !use[1] && use[2]);
    mask_write(path, 21, 10, 15, 5, 1);
    kit_fails(mask_points(&s, list, 2, use, &e), ERR_DATA, e, "21 x 10");
    kit_rmdir(s.dir);
}

/* --no-masks asks no mask for the first Gaussians, either. */
static void without_masks_all_points_are_used(void **state)
{
    struct err e = {0};
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], name[] = "p.jpg";
    struct scene_image image = {.name = name, .cam = {.width_px = 20, .height_px = 10}};
    struct scene_point points[3] = {
        {.enu_m = {0, 0, 0}}, {.enu_m = {1, 0, 0}}, {.enu_m = {0, 1, 0}}};
    struct scene_track tracks[3] = {{.point = 0, .x_px = 5.5f, .y_px = 5.5f},
                                    {.point = 1, .x_px = 15.5f, .y_px = 5.5f},
                                    {.point = 2, .x_px = 7.5f, .y_px = 5.5f}};
    struct scene s = {.images = &image,
                      .n_images = 1,
                      .points = points,
                      .n_points = 3,
                      .tracks = tracks,
                      .n_tracks = 3};
    const struct cell cell = {
        .id = "all", .whole = true, .edge_m = 10, .extent_m = 10, .scene_extent_m = 10};
    const uint32_t list[1] = {0};
    struct init_input in = {.scene = &s, .images = list, .n_images = 1, .cell = &cell, .limit = 10};
    kit_tmpdir(s.dir);
    kit_ok(file_join(dir, s.dir, "masks", &e), e);
    kit_ok(file_mkdir(dir, &e), e);
    kit_ok(mask_path(dir, name, path, &e), e);
    mask_write(path, 20, 10, 15, 5, 1);
    for (int k = 0; k < 2; k++) {
        struct gauss g;
        in.no_masks = k;
        kit_ok(init_gauss(&in, &g, &e), e);
        assert_int_equal(g.n, k ? 3 : 2);
        gauss_free(&g);
    }
    mask_write(path, 21, 10, 15, 5, 1); /* not even one that does not fit */
    struct gauss g;
    kit_ok(init_gauss(&in, &g, &e), e);
    gauss_free(&g);
    in.no_masks = false;
    kit_fails(init_gauss(&in, &g, &e), ERR_DATA, e, "21 x 10");
    kit_rmdir(s.dir);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_pixel_is_ignored_when_any_below_it_is),
        cmocka_unit_test(dark_masks_have_numbers),
        cmocka_unit_test(greys_without_black_are_told),
        cmocka_unit_test(colours_are_no_mask),
        cmocka_unit_test(cutouts_are_masks_by_their_alpha),
        cmocka_unit_test(undistortion_moves_masks_as_it_moves_pictures),
        cmocka_unit_test(points_on_masked_pixels_are_left_out),
        cmocka_unit_test(without_masks_all_points_are_used),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
