/* Scene folders: writing and reading gives the same; damaged ones are refused.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include <jansson.h>

#include "codec/scene/scene.h"
#include "tests/kit.h"

enum { N_IMAGES = 3, N_POINTS = 7 };
static const double tol_rot = 1e-14; /* a rotation is made orthonormal again when it is read */

static void make_scene(struct scene *s)
{
    *s = (struct scene){.origin = {7.5, 47.25, 312.125},
                        .scale = 3.25,
                        .rot = {0, -1, 0, 1, 0, 0, 0, 0, 1},
                        .trans = {1, 2, 3},
                        .vertical_offset_m = -1.5,
                        .heights = "EPSG:7837",
                        .n_images = N_IMAGES,
                        .n_points = N_POINTS};
    s->images = arena_get(&s->arena, N_IMAGES, sizeof *s->images);
    s->points = arena_get(&s->arena, N_POINTS, sizeof *s->points);
    s->tracks = arena_get(&s->arena, N_POINTS, sizeof *s->tracks);
    s->attribution = arena_text(&s->arena, "CC0, \"a\" drone");
    for (uint32_t i = 0; i < N_IMAGES; i++) {
        struct scene_image *im = &s->images[i];
        im->name = arena_printf(&s->arena, "IMG %u.jpg", i);
        im->cam =
            camera_look_at((double[3]){10.0 * i, 5, 80}, (double[3]){1.0 + i, 2, 0}, 0.9, 400, 300);
        im->split = i ? SCENE_TRAIN : SCENE_TEST;
        im->group = i;
        im->exposure_ev[i] = 0.25f * (float)i;
        scene_time(i == 2 ? "yesterday" : "2024:06:01 10:00:59", im->time);
        im->residual_m = i == 2 ? (double)NAN : 0.1 * i;
        for (int k = 0; k < 3; k++)
            im->gps_enu_m[k] = i == 2 ? (double)NAN : 1.0 / 3 + k;
    }
    for (uint32_t i = 0; i < N_POINTS; i++) {
        s->points[i] = (struct scene_point){{0.1 * i, -1e6 / 3, 5}, {1, 2, (uint8_t)i}, 0.5f, 3};
        s->tracks[s->n_tracks++] = (struct scene_track){i, i * N_IMAGES / N_POINTS, 1.25f, 300};
    }
}

static void test_round_trip(void **state)
{
    char dir[FILE_PATH_MAX];
    struct scene a, b;
    struct err e = {0};
    make_scene(&a);
    kit_tmpdir(dir);
    kit_ok(scene_write(dir, &a, &e), e);
    kit_ok(scene_read(dir, &b, &e), e);
    assert_string_equal(b.dir, dir);
    assert_memory_equal(&a.origin, &b.origin, sizeof a.origin);
    assert_true(a.scale == b.scale && a.vertical_offset_m == b.vertical_offset_m);
    assert_memory_equal(a.rot, b.rot, sizeof a.rot);
    assert_memory_equal(a.trans, b.trans, sizeof a.trans);
    assert_string_equal(a.attribution, b.attribution);
    assert_string_equal(b.heights, "EPSG:7837");
    assert_int_equal(b.n_images, N_IMAGES);
    for (size_t i = 0; i < N_IMAGES; i++) {
        const struct scene_image *x = &a.images[i], *y = &b.images[i];
        assert_string_equal(x->name, y->name);
        assert_string_equal(y->time, i == 2 ? "" : "2024-06-01T10:00:59");
        assert_int_equal(x->split, y->split);
        assert_int_equal(x->group, y->group);
        assert_memory_equal(x->exposure_ev, y->exposure_ev, sizeof x->exposure_ev);
        assert_true(x->cam.fx_px == y->cam.fx_px && x->cam.width_px == y->cam.width_px);
        kit_near_d("rot", y->cam.rot, x->cam.rot, 9, tol_rot, 0);
        assert_memory_equal(x->cam.trans, y->cam.trans, sizeof x->cam.trans);
        if (i == 2)
            assert_true(isnan(y->residual_m) && isnan(y->gps_enu_m[0]) && isnan(y->gps_enu_m[2]));
        else
            assert_memory_equal(x->gps_enu_m, y->gps_enu_m, sizeof x->gps_enu_m);
    }
    assert_int_equal(b.n_points, N_POINTS);
    for (size_t i = 0; i < N_POINTS; i++) {
        assert_memory_equal(a.points[i].enu_m, b.points[i].enu_m, sizeof a.points[i].enu_m);
        assert_memory_equal(a.points[i].rgb, b.points[i].rgb, 3);
        assert_int_equal(a.points[i].track_length, b.points[i].track_length);
    }
    assert_int_equal(b.n_tracks, a.n_tracks);
    assert_memory_equal(a.tracks, b.tracks, a.n_tracks * sizeof *a.tracks);
    scene_free(&a);
    scene_free(&b);
    kit_rmdir(dir);
}

/* Every row of scene_image.def is in the file, in that order, and is left out or null only where it
 * is not known. */
static void every_field_is_in_the_file(void **state)
{
    static const char *const keys[] = {
#define FIELD(type, member, key, unit, what) key,
#include "codec/scene/scene_image.def"
#undef FIELD
    };
    struct scene a;
    struct err e = {0};
    struct json_t *root;
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    make_scene(&a);
    kit_tmpdir(dir);
    kit_ok(scene_write(dir, &a, &e), e);
    kit_ok(file_join(path, dir, "scene.json", &e), e);
    kit_ok(jsonc_read(path, &root, &e), e);
    json_t *images = json_object_get(root, "images"), *value;
    size_t n = 0;
    const char *key;
    json_object_foreach(json_array_get(images, 1), key, value) /* of which all is known */
    {
        assert_string_equal(key, keys[n++]);
        assert_false(json_is_null(value));
    }
    assert_int_equal(n, sizeof keys / sizeof *keys);
    assert_true(json_is_null(json_object_get(json_array_get(images, 2), "residual_m")));
    assert_null(json_object_get(json_array_get(images, 2), "time"));
    assert_null(json_object_get(json_array_get(images, 0), "exposure_ev"));
    json_decref(root);
    scene_free(&a);
    kit_rmdir(dir);
}

static void rewrite(const char *dir, const char *name, const char *from, const char *to)
{
    char path[FILE_PATH_MAX + 32];
    struct buf in = {0}, out = {0};
    struct err e = {0};
    snprintf(path, sizeof path, "%s/%s", dir, name);
    kit_ok(file_read(path, 0, &in, &e), e);
    buf_u8(&in, 0);
    char *at = strstr((char *)in.data, from);
    assert_non_null(at);
    buf_add(&out, in.data, (size_t)(at - (char *)in.data));
    buf_add(&out, to, strlen(to));
    buf_add(&out, at + strlen(from), strlen(at + strlen(from)));
    kit_ok(file_write(path, out.data, out.size, &e), e);
    buf_free(&in);
    buf_free(&out);
}

static void test_refused(void **state)
{
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX + 32];
    struct scene a, b;
    struct err e = {0};
    kit_tmpdir(dir);
    kit_fails(scene_read(dir, &b, &e), ERR_NOENT, e, "ingest");
    make_scene(&a);
    static const struct {
        const char *from, *to, *says;
    } bad[] = {
        {"citysplat-scene", "other", "format"},
        {"\"version\": 1", "\"version\": 9", "version"},
        {"IMG 1.jpg", "../x.jpg", "images[1]"},
        {"\"test\"", "\"both\"", "split"},
        {"\"group\": 2", "\"group\": -2", "group"},
        {"0.25", "99", "exposure_ev"},
        {"T10:00:59", " 10:00:59", "time"},
        {"\"fx\"", "\"fxx\"", "images[0]"},
        {"\"lat_deg\": 47.25", "\"lat_deg\": 147.25", "origin"},
        {"\"scale\"", "\"skale\"", "scale"},
        {"\"images\"", "\"pictures\"", "images"},
    };
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        kit_ok(scene_write(dir, &a, &e), e);
        rewrite(dir, "scene.json", bad[i].from, bad[i].to);
        kit_fails(scene_read(dir, &b, &e), ERR_FORMAT, e, bad[i].says);
    }
    kit_ok(scene_write(dir, &a, &e), e);
    struct buf whole = {0};
    snprintf(path, sizeof path, "%s/points.bin", dir);
    kit_ok(file_read(path, 0, &whole, &e), e);
    for (size_t n = 0; n < whole.size; n += 5) {
        FILE *f = fopen(path, "wb");
        assert_non_null(f);
        assert_int_equal(fwrite(whole.data, 1, n, f), n);
        assert_int_equal(fclose(f), 0);
        kit_fails(scene_read(dir, &b, &e), ERR_FORMAT, e, "points.bin");
    }
    whole.data[whole.size / 2] ^= 1;
    kit_ok(file_write(path, whole.data, whole.size, &e), e);
    kit_fails(scene_read(dir, &b, &e), ERR_FORMAT, e, "hash");
    buf_free(&whole);
    /* Points of another scene. */
    kit_ok(scene_write(dir, &a, &e), e);
    char keep[FILE_PATH_MAX + 32];
    snprintf(keep, sizeof keep, "%s/keep", dir);
    assert_int_equal(rename(path, keep), 0);
    a.points[0].rgb[0] ^= 1;
    kit_ok(scene_write(dir, &a, &e), e);
    assert_int_equal(rename(keep, path), 0);
    kit_fails(scene_read(dir, &b, &e), ERR_FORMAT, e, "does not belong");
    /* What JSON cannot hold is refused when written. */
    a.scale = (double)INFINITY;
    kit_fails(scene_write(dir, &a, &e), ERR_DATA, e, "finite");
    scene_free(&a);
    kit_rmdir(dir);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_round_trip),
        cmocka_unit_test(every_field_is_in_the_file),
        cmocka_unit_test(test_refused),
    };
    return cmocka_run_group_tests_name("scene", tests, NULL, NULL);
}
