/* Appearances of a store: tiles keep trained colours, readers get the default appearance or the one
 * they ask for, pictures of baked Gaussians equal those of the network, and errors name what cannot
 * be found.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/ckpt.h"
#include "core/geo/geo.h"
#include "core/splat/appearance.h"
#include "core/splat/camera.h"
#include "lod/choose/view.h"
#include "lod/make/merge.h"
#include "lod/make/pyramid.h"
#include "lod/make/update.h"
#include "lod/store/bake.h"
#include "lod/store/store.h"
#include "tests/lod/store_kit.h"
#include "tests/render/render_kit.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { W = 80, H = 60, PHOTOS = 6, LEN = 8 };
/* Baked colours are cut at 0 alone, those of the network at 1 as well: compared below 1 only. */
#define SAME_TOL 2e-4

static const struct geo_origin origin = {8.6821, 50.1109, 160};

struct fixture {
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], plain[FILE_PATH_MAX];
    struct appearance model;
};

static void make_model(struct appearance *a)
{
    struct err e = {0};
    kit_ok(appearance_alloc(a, LEN, 12, 16, PHOTOS, &e), e);
    appearance_init(a, 5);
    for (size_t i = 0; i < PHOTOS; i++)
        memcpy(a->names[i], (char[]){'p', (char)('0' + i), '.', 'j', 'p', 'g', 0}, 7);
    for (size_t i = 0; i < APPEARANCE_OUT * 16; i++)
        a->w2[i] *= 2.0f; /* looks that differ visibly */
}

static int setup(void **state)
{
    static struct fixture f;
    struct err e = {0};
    struct gauss g;
    struct appearance full;
    struct buf blob = {0};
    const struct pyramid_config cfg = {.tile_edge_m = 60, .name = "bake", .lossless = true};
    progress_quiet(true);
    kit_tmpdir(f.dir);
    kit_ok(file_join(f.path, f.dir, "city.tiles", &e), e);
    kit_ok(file_join(f.plain, f.dir, "plain.tiles", &e), e);
    make_model(&f.model);
    kit_gauss(3, 1500, 60, 1, LEN, &g);
    for (size_t i = 0; i < g.n; i++) {
        g.mean_m[3 * i + 2] *= 0.1f;
        for (size_t k = 0; k < 3 * gauss_sh_count(1); k++)
            g.sh[12 * i + k] *= k < 3 ? 0.3f : 0.1f; /* away from 0 and 1 */
    }
    kit_ok(bake_with_default(&f.model, &g, &full, &e), e);
    kit_ok(appearance_write(&full, &blob, &e), e);
    const struct store_blob b = {"appearance", blob.data, blob.size};
    store_fixture_level(f.path, &origin, &g, &cfg, &b);
    store_fixture_level(f.plain, &origin, &g, &cfg, NULL);
    buf_free(&blob);
    appearance_free(&full);
    gauss_free(&g);
    *state = &f;
    return render_kit_open(state);
}

static int teardown(void **state)
{
    struct fixture *f = *state;
    appearance_free(&f->model);
    kit_rmdir(f->dir);
    return render_kit_close(state);
}

static void readers_get_a_look_and_tiles_keep_what_was_trained(void **state)
{
    struct fixture *f = *state;
    struct err e = {0};
    struct store *s;
    const struct appearance *a;
    size_t n;
    kit_ok(store_open(f->path, &s, &e), e);
    kit_ok(bake_of(s, &a, &e), e);
    assert_int_equal(a->n_images, PHOTOS + 1);
    assert_string_equal(a->names[PHOTOS], BAKE_DEFAULT);
    const struct store_tile *t = store_tiles(s, &n);
    for (size_t k = 0; k < 3; k++) { /* default, a photograph, a photograph by its row */
        float image[APPEARANCE_IMAGE_MAX];
        struct gauss raw = {0}, baked = {0};
        size_t row = k ? 2 : PHOTOS;
        kit_ok(bake_find(s, k == 1 ? "p2.jpg" : BAKE_DEFAULT, image, &e), e);
        const float *look = k == 0 ? NULL : k == 1 ? image : a->images + row * a->len_image;
        kit_ok(store_read_gauss(s, t[n - 1].key, &raw, &e), e);
        kit_ok(bake_read(s, t[n - 1].key, look, &baked, &e), e);
        assert_int_equal(raw.n, baked.n);
        assert_int_equal(baked.embed_len, LEN);
        for (size_t i = 0; i < raw.n; i++) {
            double y[APPEARANCE_OUT];
            appearance_eval(a, raw.embed + LEN * i, a->images + row * a->len_image, y);
            for (size_t c = 0; c < 3; c++) {
                double want = (double)raw.sh[12 * i + c] + (2.0 * y[c] - 1.0) / GAUSS_SH_C0;
                assert_true(fabs((double)baked.sh[12 * i + c] - want) < 1e-4);
            }
            assert_true(baked.opacity_logit[i] > raw.opacity_logit[i]);
        }
        gauss_free(&raw);
        gauss_free(&baked);
    }
    store_close(&s);
}

/* Mean square difference of a look's colours to the mean over photographs. */
static double look_error(const struct appearance *a, const struct gauss *g, const float *image)
{
    double sum = 0.0;
    for (size_t i = 0; i < g->n; i++) {
        double mean[3] = {0.0}, y[APPEARANCE_OUT];
        for (size_t p = 0; p < PHOTOS; p++) {
            appearance_eval(a, g->embed + LEN * i, a->images + p * a->len_image, y);
            for (size_t c = 0; c < 3; c++)
                mean[c] += y[c] / PHOTOS;
        }
        appearance_eval(a, g->embed + LEN * i, image, y);
        for (size_t c = 0; c < 3; c++)
            sum += (y[c] - mean[c]) * (y[c] - mean[c]) / (double)g->n;
    }
    return sum;
}

static void the_default_look_is_nearest_to_the_mean_of_all(void **state)
{
    struct fixture *f = *state;
    struct err e = {0};
    struct gauss g;
    float image[APPEARANCE_IMAGE_MAX], mean[APPEARANCE_IMAGE_MAX] = {0};
    kit_gauss(4, 400, 60, 0, LEN, &g);
    kit_ok(bake_default(&f->model, &g, image, &e), e);
    double got = look_error(&f->model, &g, image);
    for (size_t p = 0; p < PHOTOS; p++) {
        float unit[APPEARANCE_IMAGE_MAX];
        bake_unit(&f->model, p, unit);
        for (size_t k = 0; k < f->model.len_image; k++)
            mean[k] += unit[k] / PHOTOS;
        assert_true(got < look_error(&f->model, &g, f->model.images + p * f->model.len_image));
    }
    assert_true(got < look_error(&f->model, &g, mean));
    gauss_free(&g);
}

static void a_picture_of_baked_gaussians_is_the_network_s(void **state)
{
    struct fixture *f = *state;
    struct err e = {0};
    struct view *v;
    static float baked[W * H * 3], network[W * H * 3], other[W * H * 3];
    float image[APPEARANCE_IMAGE_MAX], frame[2000];
    const double eye[3] = {0, -60, 70};
    struct camera cam = camera_heading(eye, 5, -45, 0.9, W, H);
    struct render_options ro = {.aa = RENDER_AA_2D, .sh_degree = -1};
    kit_ok(view_open(f->path, render, 0, &v, &e), e);
    const struct appearance *a = view_appearance(v);
    assert_non_null(a);
    kit_ok(view_render(v, &cam, &ro, NULL, other, NULL, &e), e);
    kit_ok(view_find_appearance(v, "p1.jpg", image, &e), e);
    kit_ok(view_set_appearance(v, image, &e), e);
    kit_ok(view_render(v, &cam, &ro, NULL, baked, NULL, &e), e);
    assert_memory_not_equal(baked, other, sizeof baked);
    assert_true(appearance_frame_floats(a->len_gauss, a->hidden) <= 2000);
    appearance_frame(a, image, frame);
    ro.appearance_frame = frame;
    ro.appearance_hidden = a->hidden;
    kit_ok(view_render(v, &cam, &ro, NULL, network, NULL, &e), e);
    size_t compared = 0;
    for (size_t i = 0; i < W * H * 3; i++)
        if (baked[i] < 0.9f) {
            assert_true(fabs((double)baked[i] - (double)network[i]) < SAME_TOL);
            compared++;
        }
    assert_true(compared > W * H);
    ro.appearance_frame = NULL;
    kit_ok(view_set_appearance(v, NULL, &e), e);
    kit_ok(view_render(v, &cam, &ro, NULL, baked, NULL, &e), e);
    assert_memory_equal(baked, other, sizeof baked);
    view_close(&v);
}

static void looks_are_found_by_name_and_blended(void **state)
{
    struct fixture *f = *state;
    struct err e = {0};
    struct store *s;
    float x[APPEARANCE_IMAGE_MAX], a[APPEARANCE_IMAGE_MAX], b[APPEARANCE_IMAGE_MAX];
    kit_ok(store_open(f->path, &s, &e), e);
    kit_ok(bake_find(s, "p0.jpg", a, &e), e);
    kit_ok(bake_find(s, "p3.jpg", b, &e), e);
    kit_ok(bake_find(s, "p0.jpg:1,p3.jpg:3", x, &e), e);
    for (size_t i = 0; i < 12; i++)
        assert_true(fabs((double)x[i] - 0.25 * (double)a[i] - 0.75 * (double)b[i]) < 1e-6);
    kit_fails(bake_find(s, "p9.jpg", x, &e), ERR_NOENT, e, "p9.jpg");
    kit_fails(bake_find(s, "p0.jpg:much", x, &e), ERR_ARG, e, "number");
    kit_fails(bake_find(s, "p0.jpg:1,p3.jpg:-1", x, &e), ERR_ARG, e, "weights");
    kit_fails(bake_find(s, "p0.jpg:-1", x, &e), ERR_ARG, e, "weights");
    kit_fails(bake_find(s, "p0.jpg:-3,p3.jpg:1", x, &e), ERR_ARG, e, "weights");
    kit_ok(bake_find(s, "p0.jpg:3,p3.jpg:-1", x, &e), e);
    for (size_t i = 0; i < 12; i++)
        assert_true(fabs((double)x[i] - 1.5 * (double)a[i] + 0.5 * (double)b[i]) < 1e-6);
    kit_fails(bake_find(s, "", x, &e), ERR_ARG, e, "photograph");
    store_close(&s);
    kit_ok(store_open(f->plain, &s, &e), e); /* embeddings, but nothing to read them with */
    const struct appearance *none;
    struct gauss raw, same;
    size_t n;
    kit_ok(bake_of(s, &none, &e), e);
    assert_null(none);
    kit_fails(bake_find(s, "p0.jpg", x, &e), ERR_NOENT, e, "without appearance");
    const struct store_tile *t = store_tiles(s, &n);
    kit_ok(store_read_gauss(s, t[0].key, &raw, &e), e);
    kit_ok(bake_read(s, t[0].key, NULL, &same, &e), e);
    assert_memory_equal(raw.sh, same.sh, raw.n * 12 * sizeof(float));
    gauss_free(&raw);
    gauss_free(&same);
    store_close(&s);
}

/* Of many photographs, whatever their order, each is found, and none that is not there: as many as
 * a city has, for servers look for several in each request. */
static void one_of_many_photographs_is_found(void **state)
{
    enum { MANY = 20000, STEP = 7919 /* a prime: the order is scrambled */, TIMES = 200 };
    const struct fixture *f = *state;
    struct err e = {0};
    struct appearance a;
    struct buf blob = {0};
    struct gauss g;
    struct store *s;
    char path[FILE_PATH_MAX], name[64], blend[512] = "";
    float image[APPEARANCE_IMAGE_MAX], unit[APPEARANCE_IMAGE_MAX];
    const struct pyramid_config cfg = {.tile_edge_m = 60, .name = "many", .lossless = true};
    kit_ok(appearance_alloc(&a, LEN, 12, 16, MANY + 1, &e), e);
    appearance_init(&a, 5);
    for (size_t i = 0; i < MANY; i++)
        snprintf(a.names[i], sizeof a.names[i], "DJI_%05zu.JPG", i * STEP % MANY);
    snprintf(a.names[MANY], sizeof a.names[MANY], BAKE_DEFAULT);
    kit_ok(appearance_write(&a, &blob, &e), e);
    kit_gauss(3, 50, 60, 1, LEN, &g);
    kit_ok(file_join(path, f->dir, "many.tiles", &e), e);
    const struct store_blob b = {"appearance", blob.data, blob.size};
    store_fixture_level(path, &origin, &g, &cfg, &b);
    kit_ok(store_open(path, &s, &e), e);
    for (size_t i = 0; i <= MANY; i++) {
        kit_ok(bake_find(s, a.names[i], image, &e), e);
        bake_unit(&a, i, unit);
        assert_memory_equal(image, unit, a.len_image * sizeof(float));
    }
    static const char *const none[] = {"DJI_20000.JPG", "DJI_00000.JP", "DJI_00000.JPGG", "A", "z"};
    for (size_t i = 0; i < sizeof none / sizeof *none; i++)
        kit_fails(bake_find(s, none[i], image, &e), ERR_NOENT, e, none[i]);
    for (int i = 0; i < 16; i++) {
        snprintf(name, sizeof name, "%sDJI_%05d.JPG:1", i ? "," : "", MANY - 1 - i);
        strcat(blend, name);
    }
    double start_s = clock_s();
    for (int i = 0; i < TIMES; i++)
        kit_ok(bake_find(s, blend, image, &e), e);
    print_message("a blend of 16 of %d photographs: %.1f us\n", MANY,
                  (clock_s() - start_s) / TIMES * 1e6);
    store_close(&s);
    buf_free(&blob);
    gauss_free(&g);
    appearance_free(&a);
}

/* Tiles of the same bytes and another network are other tiles to a cache. */
static void another_model_is_another_hash(void **state)
{
    struct fixture *f = *state;
    struct err e = {0};
    struct store *s;
    struct hash128 with, without;
    kit_ok(store_open(f->path, &s, &e), e);
    kit_ok(bake_hash(s, &with, &e), e);
    store_close(&s);
    kit_ok(store_open(f->plain, &s, &e), e);
    kit_ok(bake_hash(s, &without, &e), e);
    store_close(&s);
    assert_true((with.lo || with.hi) && !without.lo && !without.hi);
}

static bool owns_all(void *user, double x_m, double y_m)
{
    (void)user;
    (void)x_m;
    (void)y_m;
    return true;
}

static bool may_own_all(void *user, const double lo[3], const double hi[3])
{
    (void)user;
    (void)lo;
    (void)hi;
    return true;
}

/* Embeddings mean something to their own network only: nothing is put beside those of another. */
static void permute_of_another_model_are_refused(void **state)
{
    struct fixture *f = *state;
    struct err e = {0};
    struct store *s;
    struct gauss g;
    char out[FILE_PATH_MAX];
    struct appearance other;
    make_model(&other);
    kit_ok(file_join(out, f->dir, "never.tiles", &e), e);
    kit_gauss(8, 300, 60, 1, LEN, &g);
    const struct update_config same = {.level = {[3] = &g},
                                       .owns = owns_all,
                                       .may_own = may_own_all,
                                       .appearance = &other},
                               none = {
                                   .level = {[3] = &g}, .owns = owns_all, .may_own = may_own_all};
    kit_ok(update_build(f->path, &same, out, NULL, &e), e);
    assert_int_equal(remove(out), 0);
    kit_fails(update_build(f->path, &none, out, NULL, &e), ERR_DATA, e, "there is none");
    kit_fails(update_build(f->plain, &same, out, NULL, &e), ERR_DATA, e, "the store has none");
    kit_fails(merge_build(f->path, f->plain, NULL, out, NULL, &e), ERR_DATA, e, "there is none");
    kit_ok(store_open(f->path, &s, &e), e);
    kit_ok(bake_fits(s, &other, &e), e);
    memcpy(other.names[1], "new.jpg", 8); /* a photograph that the store does not know */
    other.images[other.len_image] += 1.0f;
    kit_ok(bake_fits(s, &other, &e), e);
    other.images[0] += 1.0f;
    kit_fails(bake_fits(s, &other, &e), ERR_DATA, e, "photograph has another embedding");
    other.b2[0] += 1e-6f;
    kit_fails(bake_fits(s, &other, &e), ERR_DATA, e, "other weights");
    kit_fails(update_build(f->path, &same, out, NULL, &e), ERR_DATA, e, "--appearance-shared");
    assert_false(file_exists(out));
    kit_fails(merge_build(f->path, f->path, NULL, out, NULL, &e), ERR_ARG, e, "the same tiles");
    store_close(&s);
    appearance_free(&other);
    gauss_free(&g);
}

/* A store of other photographs read by the same network, merged or put in as a cell: every
 * photograph's look is there, those of both once, and the default look is the first store's. */
static void photographs_of_both_are_there(void **state)
{
    struct fixture *f = *state;
    struct err e = {0};
    struct store *s;
    struct gauss g;
    struct buf blob = {0};
    struct appearance other, full;
    const struct appearance *both;
    char second[FILE_PATH_MAX], out[FILE_PATH_MAX];
    static const struct geo_origin near = {8.6921, 50.1109, 160}; /* 700 m to the east */
    make_model(&other);
    for (size_t i = 1; i < other.n_images; i++) {
        snprintf(other.names[i], APPEARANCE_NAME_MAX, "second%zu.jpg", i);
        other.images[i * other.len_image] += 0.25f;
    }
    kit_ok(file_join(second, f->dir, "second.tiles", &e), e);
    kit_ok(file_join(out, f->dir, "both.tiles", &e), e);
    kit_gauss(9, 300, 60, 1, LEN, &g);
    kit_ok(bake_with_default(&other, &g, &full, &e), e);
    kit_ok(appearance_write(&full, &blob, &e), e);
    const struct store_blob b = {BAKE_BLOB, blob.data, blob.size};
    const struct pyramid_level level = {.g = &g, .level = 3};
    const struct pyramid_config cfg = {.name = "second", .attribution = "B; Survey"};
    kit_ok(pyramid_build(&near, &level, 1, &cfg, &b, 1, second, NULL, &e), e);
    const struct update_config cell = {
        .level = {[3] = &g}, .owns = owns_all, .may_own = may_own_all, .appearance = &other};
    for (int round = 0; round < 2; round++) {
        float first[APPEARANCE_IMAGE_MAX], now[APPEARANCE_IMAGE_MAX];
        kit_ok(store_open(f->path, &s, &e), e);
        kit_ok(bake_find(s, BAKE_DEFAULT, first, &e), e);
        store_close(&s);
        if (round == 0)
            kit_ok(merge_build(f->path, second, NULL, out, NULL, &e), e);
        else
            kit_ok(update_build(f->path, &cell, out, NULL, &e), e);
        kit_ok(store_open(out, &s, &e), e);
        kit_ok(bake_of(s, &both, &e), e);
        assert_int_equal(both->n_images, 2 * (other.n_images - 1) + 1 + 1);
        for (size_t i = 0; i < other.n_images; i++) {
            ptrdiff_t at = appearance_find(both, other.names[i]);
            assert_true(at >= 0);
            assert_memory_equal(both->images + (size_t)at * both->len_image,
                                other.images + i * other.len_image,
                                other.len_image * sizeof(float));
        }
        kit_ok(bake_find(s, BAKE_DEFAULT, now, &e), e);
        assert_memory_equal(first, now, both->len_image * sizeof(float));
        size_t bad;
        kit_ok(store_verify(s, &bad, &e), e);
        store_close(&s);
    }
    appearance_free(&other);
    appearance_free(&full);
    buf_free(&blob);
    gauss_free(&g);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(readers_get_a_look_and_tiles_keep_what_was_trained),
        cmocka_unit_test(the_default_look_is_nearest_to_the_mean_of_all),
        cmocka_unit_test(a_picture_of_baked_gaussians_is_the_network_s),
        cmocka_unit_test(looks_are_found_by_name_and_blended),
        cmocka_unit_test(one_of_many_photographs_is_found),
        cmocka_unit_test(another_model_is_another_hash),
        cmocka_unit_test(permute_of_another_model_are_refused),
        cmocka_unit_test(photographs_of_both_are_there),
    };
    return cmocka_run_group_tests_name("bake", tests, setup, teardown);
}
