/* The low-pass form of tiles: what it makes of Gaussians, drawn as CesiumJS draws, and how a
 * tileset names it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/render/render_kit.h"

#include <math.h>
#include <string.h>

#include <jansson.h>

#include "core/base.h"
#include "lod/export/lowpass.h"
#include "lod/export/tileset.h"
#include "lod/store/store.h"
#include "lod/store/tree.h"

enum { WIDTH = 120, HEIGHT = 90, PIXELS = WIDTH * HEIGHT, DISCS = 6000 };
#define CESIUM_PX2 0.019 /* what its shader adds to variances, without making Gaussians fainter */

/* Ground of small flat Gaussians in strong colours, 8 x 6 m. */
static struct gauss make_ground(void)
{
    struct err e = {0};
    struct gauss g = {0};
    kit_ok(gauss_alloc(&g, DISCS, 0, 0, &e), e);
    g.n = DISCS;
    g.antialiased = true;
    for (size_t i = 0; i < DISCS; i++) {
        static const float sigma_m[3] = {0.06f, 0.03f, 0.002f};
        g.mean_m[3 * i] = (float)(8 * rng_unit(1, 0, i) - 4);
        g.mean_m[3 * i + 1] = (float)(6 * rng_unit(1, 1, i) - 3);
        g.mean_m[3 * i + 2] = (float)(0.1 * rng_unit(1, 2, i));
        for (size_t k = 0; k < 3; k++)
            g.scale_log[3 * i + k] = logf(sigma_m[k]);
        const double turn = 3.14159265 * rng_unit(1, 3, i);
        g.quat_wxyz[4 * i] = (float)cos(turn);
        g.quat_wxyz[4 * i + 3] = (float)sin(turn);
        g.opacity_logit[i] = 2.0f;
        for (size_t k = 0; k < 3; k++)
            g.sh[3 * i + k] = rng_unit(1, 4 + k, i) < 0.5 ? -1.5f : 1.5f;
    }
    return g;
}

static void draw(const struct gauss *g, const struct render_options *o, float rgb[3 * PIXELS])
{
    const double eye[3] = {0.0, -14.0, 10.0}, target[3] = {0};
    const struct camera cam = camera_look_at(eye, target, 0.5, WIDTH, HEIGHT);
    struct err e = {0};
    struct render_model m = {0};
    kit_ok(render_model_upload(render, g, &m, &e), e);
    kit_ok(render_forward(render, &m, &cam, o, rgb, NULL, &e), e);
    render_model_free(&m);
}

static double rms(const float *a, const float *b)
{
    double sum = 0;
    for (size_t i = 0; i < 3 * PIXELS; i++)
        sum += ((double)a[i] - (double)b[i]) * ((double)a[i] - (double)b[i]);
    return sqrt(sum / (3 * PIXELS));
}

/* A pixel is 0.1 m: Gaussians are 0.6 by 0.3 pixels. */
static void a_client_without_a_filter_draws_what_we_draw(void **state)
{
    static float served[3 * PIXELS], raw[3 * PIXELS], filtered[3 * PIXELS];
    const struct render_options ours = {.aa = RENDER_AA_2D, .sh_degree = -1},
                                theirs = {.aa = RENDER_AA_NONE,
                                          .sh_degree = -1,
                                          .kernel_px2 = CESIUM_PX2};
    struct gauss g = make_ground();
    draw(&g, &ours, served);
    draw(&g, &theirs, raw);
    lowpass_gauss(&g, 17.2 * 2 * tan(0.25) / HEIGHT);
    draw(&g, &theirs, filtered);
    const double before = rms(raw, served), after = rms(filtered, served);
    printf("rms to our picture %.4f, with the filter built in %.4f\n", before, after);
    assert_true(before > 0.05); /* or there is nothing to mend */
    assert_true(after < 0.5 * before);
    gauss_free(&g);
}

static void variances_grow_and_opacities_fall(void **state)
{
    struct gauss g, was;
    kit_gauss(5, 200, 4.0, 1, 0, &g);
    kit_gauss(5, 200, 4.0, 1, 0, &was);
    lowpass_gauss(&g, 0.5); /* trained without anti-aliasing: as they are */
    assert_memory_equal(g.scale_log, was.scale_log, 600 * sizeof *g.scale_log);
    g.antialiased = true;
    lowpass_gauss(&g, 0.0);
    assert_memory_equal(g.opacity_logit, was.opacity_logit, 200 * sizeof *g.opacity_logit);
    lowpass_gauss(&g, 0.5);
    for (size_t i = 0; i < 600; i++) {
        const double added =
            exp(2.0 * (double)g.scale_log[i]) - exp(2.0 * (double)was.scale_log[i]);
        kit_near_d("added", &added, &(double){0.4 * 0.25}, 1, 0, 1e-4);
    }
    for (size_t i = 0; i < 200; i++)
        assert_true(g.opacity_logit[i] < was.opacity_logit[i]);
    assert_memory_equal(g.mean_m, was.mean_m, 600 * sizeof *g.mean_m);
    assert_memory_equal(g.sh, was.sh, 200 * 12 * sizeof *g.sh);
    /* Hostile values stay finite. */
    g.scale_log[0] = g.scale_log[1] = g.scale_log[2] = -200.0f;
    g.opacity_logit[0] = 80.0f;
    g.opacity_logit[1] = -80.0f;
    lowpass_gauss(&g, 0.5);
    assert_int_equal(gauss_count_bad(&g, NULL), 0);
    gauss_free(&g);
    gauss_free(&was);
}

/* ---- the tileset ---- */

static const struct geo_origin origin = {8.6821, 50.1109, 160};

static void put(struct store *s, struct key key, double sigma_m)
{
    struct err e = {0};
    struct gauss g;
    double lon, lat;
    key_center(key, &lon, &lat);
    kit_gauss(1, 9, 5.0, 0, 0, &g);
    g.antialiased = store_info(s)->antialiased;
    for (size_t i = 0; i < 27; i++)
        g.scale_log[i] = (float)log(sigma_m);
    kit_ok(geo_to_enu(&origin, lon, lat, 160, g.origin_enu_m, &e), e);
    struct store_entry t = {.tile = {.key = key, .level = 1}};
    kit_ok(store_put(s, &t, &g, &e), e);
    gauss_free(&g);
}

/* A root of sigma 1 m above leaves of 0.8 m and of 3 m, in a folder. */
static struct store *make_store(const char *dir, bool antialiased)
{
    const struct key root = key_at(origin.lon_deg, origin.lat_deg, 14);
    struct err e = {0};
    struct store *s;
    char path[FILE_PATH_MAX];
    kit_ok(file_join(path, dir, antialiased ? "a.tiles" : "b.tiles", &e), e);
    const struct store_meta meta = {.name = "two", .origin = origin, .antialiased = antialiased};
    kit_ok(store_create(path, &meta, &s, &e), e);
    put(s, root, 1.0);
    put(s, (struct key){15, 2 * root.x, 2 * root.y}, 0.8);
    put(s, (struct key){15, 2 * root.x + 1, 2 * root.y}, 3.0);
    kit_ok(store_commit(&s, &e), e);
    kit_ok(store_open(path, &s, &e), e);
    return s;
}

static const struct tileset_links both = {
    .tile = "{z}/{x}/{y}.glb", .lowpass = "{z}/{x}/{y}.lowpass.glb", .part = "{z}/{x}/{y}.json"};

static json_t *document_of(const struct store *s, const struct tileset_links *links)
{
    struct err e = {0};
    struct buf b = {0};
    json_t *j;
    kit_ok(tileset_write(s, links, NULL, NULL, &b, &e), e);
    kit_ok(jsonc_parse((const char *)b.data, b.size, "tileset", &j, &e), e);
    buf_free(&b);
    return j;
}

static void assert_content(const json_t *node, struct key k, const char *ext)
{
    char want[64];
    snprintf(want, sizeof want, "%u/%u/%u.%s", k.z, k.x, k.y, ext);
    assert_string_equal(json_string_value(json_object_get(json_object_get(node, "content"), "uri")),
                        want);
}

static double error_of(const json_t *node)
{
    return json_number_value(json_object_get(node, "geometricError"));
}

static void leaves_have_the_tile_itself_below(void **state)
{
    char dir[FILE_PATH_MAX];
    size_t n;
    kit_tmpdir(dir);
    struct store *s = make_store(dir, true);
    const struct tree *tree = store_tree(s);
    const struct store_tile *t = store_tiles(s, &n);
    const struct store_shape top = store_shape(s, &t[0]), low = store_shape(s, &t[1]);
    json_t *j = document_of(s, &both);
    const json_t *root = json_object_get(j, "root"), *leaves = json_object_get(root, "children");
    assert_content(root, t[0].key, "lowpass.glb");
    kit_near_d("root", &(double){error_of(root)}, &top.geometric_error_m, 1, 0, 1e-6);
    kit_near_d("its pixel", &(double){lowpass_pixel_m(tree, 0)}, &top.sigma_median_m, 1, 0, 1e-6);
    assert_int_equal(json_array_size(leaves), 2);
    for (size_t i = 0; i < 2; i++) {
        const json_t *leaf = json_array_get(leaves, i), *below = json_object_get(leaf, "children");
        const json_t *near = json_array_get(below, 0);
        /* The coarse one is cut to less than its parent's. */
        const double want = i ? top.sigma_median_m / 1.01 : 0.55 * low.sigma_median_m;
        kit_near_d("pixel", &(double){lowpass_pixel_m(tree, (uint32_t)(i + 1))}, &want, 1, 0, 1e-6);
        kit_near_d("error", &(double){error_of(leaf)}, &(double){16 * want}, 1, 0, 1e-6);
        assert_content(leaf, t[i + 1].key, "lowpass.glb");
        assert_int_equal(json_array_size(below), 1);
        assert_content(near, t[i + 1].key, "glb");
        assert_true(error_of(near) == 0);
        assert_null(json_object_get(near, "transform")); /* it stands where the leaf does */
        assert_true(json_equal(json_object_get(near, "boundingVolume"),
                               json_object_get(leaf, "boundingVolume")));
    }
    json_decref(j);
    store_close(&s);
    kit_rmdir(dir);
}

/* Also where the store is drawn as it is, and in a folder of files. */
static void others_name_tiles_as_they_are(void **state)
{
    char dir[FILE_PATH_MAX];
    kit_tmpdir(dir);
    for (int antialiased = 0; antialiased < 2; antialiased++) {
        struct store *s = make_store(dir, antialiased);
        struct tileset_links links = both;
        if (antialiased)
            links.lowpass = NULL;
        json_t *j = document_of(s, &links);
        char *text = json_dumps(j, 0);
        assert_non_null(text);
        assert_null(strstr(text, "lowpass"));
        free(text);
        const json_t *leaves = json_object_get(json_object_get(j, "root"), "children");
        assert_true(error_of(json_array_get(leaves, 0)) == 0);
        json_decref(j);
        store_close(&s);
    }
    kit_rmdir(dir);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_client_without_a_filter_draws_what_we_draw),
        cmocka_unit_test(variances_grow_and_opacities_fall),
        cmocka_unit_test(leaves_have_the_tile_itself_below),
        cmocka_unit_test(others_name_tiles_as_they_are),
    };
    return cmocka_run_group_tests(tests, render_kit_open, render_kit_close);
}
