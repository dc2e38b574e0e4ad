/* The procedural city: the same seed gives the same bytes, and model, depth, EXIF and truth agree.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/container/ckpt.h"
#include "codec/container/npy.h"
#include "codec/image/image.h"
#include "codec/limits.h"
#include "codec/scene/colmap.h"
#include "codec/splat/ply.h"
#include "core/geo/geo.h"
#include "core/pool.h"
#include "core/splat/gauss.h"
#include "lab/truth/synth_splats.h"
#include "scene/synth/synth.h"
#include "tests/kit.h"

static const double tol_gps_m =
    0.02; /* EXIF keeps 1e-4 seconds of arc or better, and centimetres */

struct city {
    char dir[FILE_PATH_MAX];
    struct synth_config cfg;
    struct arena arena;
};

static void city_defaults(struct city *c, const char *tmp, const char *name)
{
    struct err e = {0};
    memset(c, 0, sizeof *c);
    snprintf(c->dir, sizeof c->dir, "%.3000s/%s", tmp, name);
    kit_ok(options_defaults(synth_options(), &c->cfg, &c->arena, &e), e);
    c->cfg.output = c->dir;
    c->cfg.photos = 16;
    c->cfg.width_px = 80;
    c->cfg.height_px = 60;
    c->cfg.extent_m = 80;
    c->cfg.points = 1200;
    c->cfg.supersample = 1;
}

static void city_make(struct city *c)
{
    struct err e = {0};
    kit_ok(synth_run(&c->cfg, &e), e);
}

static void read_file(const struct city *c, const char *name, struct buf *out)
{
    char path[FILE_PATH_MAX];
    struct err e = {0};
    kit_ok(file_join(path, c->dir, name, &e), e);
    kit_ok(file_read(path, 0, out, &e), e);
}

static bool same_file(const struct city *a, const struct city *b, const char *name)
{
    struct buf x = {0}, y = {0};
    read_file(a, name, &x);
    read_file(b, name, &y);
    bool same = x.size == y.size && !memcmp(x.data, y.data, x.size);
    buf_free(&x);
    buf_free(&y);
    return same;
}

static void test_same_seed_same_bytes(void **state)
{
    static const char *const files[] = {"images/IMG_0003.jpg",      "images/IMG_0016.jpg",
                                        "sparse/0/cameras.bin",     "sparse/0/images.bin",
                                        "sparse/0/points3D.bin",    "truth/truth.json",
                                        "truth/clean/IMG_0009.png", "truth/depth/IMG_0009.npy"};
    char tmp[FILE_PATH_MAX];
    struct city a, b, c;
    kit_tmpdir(tmp);
    city_defaults(&a, tmp, "a");
    city_defaults(&b, tmp, "b");
    city_defaults(&c, tmp, "c");
    a.cfg.vehicle_share = b.cfg.vehicle_share = c.cfg.vehicle_share = 0.5;
    a.cfg.exposure_ev = b.cfg.exposure_ev = c.cfg.exposure_ev = 0.3;
    c.cfg.seed = 2;
    city_make(&a);
    city_make(&b);
    city_make(&c);
    for (size_t i = 0; i < sizeof files / sizeof *files; i++) {
        if (!same_file(&a, &b, files[i]))
            fail_msg("%s differs between two runs", files[i]);
        if (strcmp(files[i], "sparse/0/cameras.bin") && same_file(&a, &c, files[i]))
            fail_msg("%s does not depend on the seed", files[i]);
    }
    /* A city is not overwritten unless asked, and nothing else ever is. */
    struct err e = {0};
    kit_fails(synth_run(&a.cfg, &e), ERR_ARG, e, "--overwrite");
    a.cfg.overwrite = true;
    kit_ok(synth_run(&a.cfg, &e), e);
    a.cfg.output = tmp;
    kit_fails(synth_run(&a.cfg, &e), ERR_ARG, e, "not made by this command");
    arena_free(&a.arena);
    arena_free(&b.arena);
    arena_free(&c.arena);
    kit_rmdir(tmp);
}

struct truth { /* of one photograph */
    double m[16], gps[3];
    bool test, outlier, pose_error, vehicles;
    int flight;
};

static json_t *truth_open(const struct city *c, double *scale, double rot[9], double trans[3])
{
    char path[FILE_PATH_MAX];
    struct err e = {0};
    json_t *root;
    kit_ok(file_join(path, c->dir, "truth/truth.json", &e), e);
    kit_ok(jsonc_read(path, &root, &e), e);
    const json_t *s = json_object_get(root, "colmap_to_enu");
    kit_ok(jsonc_num(s, "scale", scale, &e), e);
    kit_ok(jsonc_nums(s, "rot", 9, rot, &e), e);
    kit_ok(jsonc_nums(s, "trans", 3, trans, &e), e);
    return root;
}

static struct truth truth_of(const json_t *root, size_t i)
{
    struct truth t;
    struct err e = {0};
    const json_t *p = json_array_get(json_object_get(root, "photographs"), i);
    kit_ok(jsonc_nums(p, "world_to_camera", 16, t.m, &e), e);
    kit_ok(jsonc_nums(p, "gps_enu_m", 3, t.gps, &e), e);
    t.test = json_is_true(json_object_get(p, "test"));
    t.outlier = json_is_true(json_object_get(p, "gps_outlier"));
    t.pose_error = json_is_true(json_object_get(p, "pose_error"));
    t.vehicles = json_is_true(json_object_get(p, "vehicles"));
    t.flight = (int)json_integer_value(json_object_get(p, "flight"));
    return t;
}

/* Every observation against the true poses, and the depth map of test photographs against the
 * points. */
static void check_model(const struct city *c)
{
    double scale, rot[9], trans[3], sum = 0, worst_mean = 0;
    struct colmap_model m;
    struct err e = {0};
    json_t *root = truth_open(c, &scale, rot, trans);
    kit_ok(colmap_read(c->dir, &m, &e), e);
    assert_int_equal(m.n_images, c->cfg.photos);
    assert_true(m.n_points > 600);
    size_t n = 0, n_depth = 0, n_deep = 0;
    for (size_t i = 0; i < m.n_images; i++) {
        struct truth t = truth_of(root, i);
        float *depth = NULL;
        size_t shape[2] = {0};
        double mean = 0;
        if (t.test) {
            char path[FILE_PATH_MAX + 64];
            snprintf(path, sizeof path, "%s/truth/depth/IMG_%04zu.npy", c->dir, i + 1);
            kit_ok(npy_read(path, 2, shape, &depth, &e), e);
            assert_int_equal(shape[0], c->cfg.height_px);
            assert_int_equal(shape[1], c->cfg.width_px);
        }
        for (size_t k = 0; k < m.images[i].n_obs; k++) {
            const struct colmap_observation *o = &m.images[i].obs[k];
            const double *x = m.points[o->point].xyz;
            double y[3], v[3], px[2];
            for (int a = 0; a < 3; a++)
                y[a] = scale * (rot[3 * a] * x[0] + rot[3 * a + 1] * x[1] + rot[3 * a + 2] * x[2]) +
                       trans[a];
            for (int a = 0; a < 3; a++)
                v[a] = t.m[4 * a] * y[0] + t.m[4 * a + 1] * y[1] + t.m[4 * a + 2] * y[2] +
                       t.m[4 * a + 3];
            lens_distort(&m.cameras[0].lens, v[0] / v[2], v[1] / v[2], &px[0], &px[1]);
            mean += hypot(px[0] - o->x_px, px[1] - o->y_px);
            if (depth && o->x_px > 0 && o->y_px > 0 && o->x_px < (double)shape[1] &&
                o->y_px < (double)shape[0]) {
                double z = (double)depth[(size_t)o->y_px * shape[1] + (size_t)o->x_px];
                n_depth++;
                n_deep += fabs(z - v[2]) < 0.03 * v[2];
            }
        }
        mem_free(depth);
        sum += mean;
        n += m.images[i].n_obs;
        worst_mean = fmax(worst_mean, mean / (double)m.images[i].n_obs);
    }
    /* 0.35 px of feature noise and 0.4 px of place noise per axis make 0.67 px on average. */
    if (sum / (double)n > 0.9 || worst_mean > 1.2)
        fail_msg("mean reprojection error %.2f px, worst photograph %.2f px", sum / (double)n,
                 worst_mean);
    assert_true(n > 5000);
    /* A pixel holds roof and street where a point lies at an edge: most, not all, agree. */
    if (n_depth < 300 || (double)n_deep < 0.8 * (double)n_depth)
        fail_msg("depth agrees with %zu of %zu points", n_deep, n_depth);
    json_decref(root);
    colmap_free(&m);
}

static void test_model_agrees_with_truth(void **state)
{
    char tmp[FILE_PATH_MAX];
    struct city a, b;
    kit_tmpdir(tmp);
    city_defaults(&a, tmp, "pinhole");
    city_make(&a);
    check_model(&a);
    city_defaults(&b, tmp, "distorted");
    b.cfg.distorted = true;
    city_make(&b);
    check_model(&b);
    arena_free(&a.arena);
    arena_free(&b.arena);
    kit_rmdir(tmp);
}

static double mean_level(const char *dir, const char *sub, size_t i, const char *ext)
{
    char path[FILE_PATH_MAX + 64];
    struct image img;
    struct err e = {0};
    snprintf(path, sizeof path, "%s/%s/IMG_%04zu.%s", dir, sub, i, ext);
    kit_ok(image_read(path, &(struct codec_limits){0}, &img, &e), e);
    double sum = 0, spread = 0;
    size_t n = (size_t)img.width_px * img.height_px * 3;
    for (size_t k = 0; k < n; k++)
        sum += img.px[k];
    for (size_t k = 0; k < n; k++)
        spread += fabs(img.px[k] - sum / (double)n);
    assert_true(spread / (double)n > 15); /* texture, not a plain picture */
    image_free(&img);
    return sum / (double)n;
}

static void test_knobs(void **state)
{
    char tmp[FILE_PATH_MAX], path[FILE_PATH_MAX + 64];
    struct city c;
    struct err e = {0};
    kit_tmpdir(tmp);
    city_defaults(&c, tmp, "hard");
    c.cfg.photos = 32;
    c.cfg.exposure_ev = 0.5;
    c.cfg.vehicle_share = 0.5;
    c.cfg.gps_sigma_m = 2;
    c.cfg.gps_outlier_share = 0.2;
    c.cfg.pose_error_share = 0.2;
    c.cfg.flight_offset_m = 12;
    city_make(&c);
    double scale, rot[9], trans[3], noise2 = 0, changed = 0;
    json_t *root = truth_open(&c, &scale, rot, trans);
    const json_t *o = json_object_get(root, "origin");
    struct geo_origin origin;
    kit_ok(jsonc_num(o, "lon_deg", &origin.lon_deg, &e), e);
    kit_ok(jsonc_num(o, "lat_deg", &origin.lat_deg, &e), e);
    kit_ok(jsonc_num(o, "h_m", &origin.h_m, &e), e);
    size_t outliers = 0, wrong = 0, vehicles = 0, second = 0, n_noise = 0;
    for (size_t i = 0; i < 32; i++) {
        struct truth t = truth_of(root, i);
        struct image_gps gps;
        double enu[3], center[3];
        snprintf(path, sizeof path, "%s/images/IMG_%04zu.jpg", c.dir, i + 1);
        kit_ok(image_read_info(path, NULL, NULL, &gps, NULL, &e), e);
        assert_true(gps.has_position && gps.has_altitude && gps.time[0]);
        kit_ok(geo_to_enu(&origin, gps.lon_deg, gps.lat_deg, gps.alt_m, enu, &e), e);
        kit_near_d("EXIF position", enu, t.gps, 3, tol_gps_m, 0);
        outliers += t.outlier;
        wrong += t.pose_error;
        vehicles += t.vehicles;
        second += t.flight == 1;
        for (int a = 0; a < 3; a++)
            center[a] = -(t.m[a] * t.m[3] + t.m[4 + a] * t.m[7] + t.m[8 + a] * t.m[11]);
        center[2] += t.flight ? 12 : 0;
        double off = sqrt(pow(center[0] - enu[0], 2) + pow(center[1] - enu[1], 2) +
                          pow(center[2] - enu[2], 2));
        assert_true(t.outlier ? off > 30 : off < 11); /* 5.5 sigma */
        noise2 += t.outlier ? 0 : off * off / 3;
        n_noise += !t.outlier;
        if (t.test)
            changed = fmax(changed, fabs(mean_level(c.dir, "images", i + 1, "jpg") -
                                         mean_level(c.dir, "truth/clean", i + 1, "png")));
    }
    assert_true(outliers > 1 && outliers < 16 && wrong > 1 && wrong < 16 && vehicles > 6 &&
                vehicles < 26);
    assert_int_equal(second, 16);
    assert_true(sqrt(noise2 / (double)n_noise) > 1.4 && sqrt(noise2 / (double)n_noise) < 2.6);
    assert_true(changed > 8); /* exposure shows */
    json_decref(root);
    arena_free(&c.arena);
    kit_rmdir(tmp);
}

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* A ray from above into the city; its direction has length 1. */
static void ray_down(const struct synth_city *c, uint64_t i, double dir[3], struct synth_hit *hit)
{
    double from[3] = {0, 0, 60}, length;
    dir[2] = -1;
    for (uint64_t k = 0; k < 2; k++) {
        from[k] = (2 * rng_unit(7, 0, 4 * i + k) - 1) * c->half_m;
        dir[k] = 2 * rng_unit(7, 0, 4 * i + 2 + k) - 1;
    }
    length = sqrt(dot(dir, dir));
    for (int k = 0; k < 3; k++)
        dir[k] /= length;
    synth_trace_ray(c, NULL, from, dir, hit);
}

/* Without gloss colour does not depend on the direction of view; with it that of some surfaces
 * does. They keep of their own what they do not mirror, and are brighter where they mirror the sun.
 */
static void test_gloss(void **state)
{
    enum { RAYS = 4000 };
    struct synth_config cfg;
    struct arena arena = {0};
    struct synth_city city;
    struct err e = {0};
    size_t shiny = 0, sunny = 0, glint = 0;
    struct synth_light light = synth_shade_light();
    kit_ok(options_defaults(synth_options(), &cfg, &arena, &e), e);
    cfg.extent_m = 80;
    kit_ok(synth_city_make(&cfg, &city, &e), e);
    for (uint64_t i = 0; i < RAYS; i++) {
        struct synth_hit hit;
        double dir[3], other[3], image[3];
        float matt[3], matt_other[3], gloss[3], image_gloss[3], image_matt[3];
        ray_down(&city, i, dir, &hit);
        double along = dot(dir, hit.normal), facing = dot(city.sun, hit.normal);
        for (int k = 0; k < 3; k++) {
            other[k] = 2 * along * hit.normal[k] - dir[k]; /* as steep, from the other side */
            image[k] =
                city.sun[k] - 2 * facing * hit.normal[k]; /* of an eye that sees it mirrored */
        }
        city.gloss = 0;
        synth_shade_hit(&city, NULL, &light, dir, &hit, 0.05, matt);
        synth_shade_hit(&city, NULL, &light, other, &hit, 0.05, matt_other);
        assert_memory_equal(matt, matt_other, sizeof matt);
        city.gloss = 1;
        synth_shade_hit(&city, NULL, &light, dir, &hit, 0.05, gloss);
        if (!memcmp(matt, gloss, sizeof matt))
            continue;
        shiny++;
        if (!hit.solid || hit.solid->material != SYNTH_TREE)
            /* at right angles a quarter at most is mirrored, more the flatter the view */
            for (int k = 0; k < 3; k++)
                assert_true((double)gloss[k] >= (0.75 - pow(1 + along, 5)) * (double)matt[k]);
        else
            fail_msg("leaves shine");
        if (facing < 0.3)
            continue;
        sunny++;
        synth_shade_hit(&city, NULL, &light, image, &hit, 0.05, image_gloss);
        city.gloss = 0;
        synth_shade_hit(&city, NULL, &light, image, &hit, 0.05, image_matt);
        glint += image_gloss[1] > image_matt[1] + 0.02f && image_gloss[1] > gloss[1];
    }
    if (shiny < RAYS / 5 || shiny > RAYS * 4 / 5)
        fail_msg("%zu of %d places shine", shiny, RAYS);
    if (glint < sunny / 2)
        fail_msg("of %zu places that shine and face the sun %zu mirror it", sunny, glint);
    synth_city_free(&city);
    arena_free(&arena);
}

/* Paint of a tricky city has one albedo a class, and its shapes are those of the other city. */
static void test_tricky(void **state)
{
    enum { RAYS = 20000, PAINTS = SYNTH_GLASS + 1 };
    struct synth_config cfg;
    struct arena arena = {0};
    struct synth_city rich, city;
    struct err e = {0};
    struct synth_light light = synth_shade_light();
    size_t n[PAINTS] = {0}, plain = 0, darker = 0, mirrors = 0;
    float first[PAINTS][3] = {{0}};
    kit_ok(options_defaults(synth_options(), &cfg, &arena, &e), e);
    cfg.extent_m = 120;
    kit_ok(synth_city_make(&cfg, &rich, &e), e);
    cfg.paint = SYNTH_PAINT_TRICKY;
    kit_ok(synth_city_make(&cfg, &city, &e), e);
    for (int i = 0; i < 3; i++) { /* of light from the sky alone a level place has one colour */
        light.sun[i] = 0;
        light.sky[i] = 1;
    }
    for (uint64_t i = 0; i < RAYS; i++) {
        struct synth_hit hit, same;
        double dir[3], same_dir[3];
        float rgb[3], before[3], again[3];
        ray_down(&city, i, dir, &hit);
        ray_down(&rich, i, same_dir, &same);
        assert_true(hit.t_m == same.t_m);
        assert_int_equal(synth_shade_paint(&rich, &same), SYNTH_RICH);
        enum synth_paint paint = synth_shade_paint(&city, &hit);
        synth_shade_hit(&city, NULL, &light, dir, &hit, 0.05, rgb);
        synth_shade_hit(&rich, NULL, &light, dir, &same, 0.05, before);
        n[paint]++;
        if (paint == SYNTH_RICH) {
            assert_memory_equal(rgb, before, sizeof rgb);
            continue;
        }
        darker += rgb[1] < before[1];
        if (paint == SYNTH_GLASS) { /* from another side it mirrors something else */
            dir[2] *= 0.5;
            synth_shade_hit(&city, NULL, &light, dir, &hit, 0.05, again);
            mirrors += memcmp(rgb, again, sizeof rgb) != 0;
        }
        if (hit.normal[2] < 1 || paint == SYNTH_GLASS)
            continue;
        if (plain++, first[paint][1] == 0)
            memcpy(first[paint], rgb, sizeof rgb);
        assert_memory_equal(rgb, first[paint], sizeof rgb);
    }
    for (size_t k = 0; k < PAINTS; k++)
        if (n[k] < RAYS / 200)
            fail_msg("%zu of %d rays meet paint %zu", n[k], RAYS, k);
    if (plain < RAYS / 4 || darker < RAYS / 5 || mirrors < n[SYNTH_GLASS] / 2)
        fail_msg("%zu plain, %zu darker, %zu of %zu mirror", plain, darker, mirrors,
                 n[SYNTH_GLASS]);
    synth_city_free(&rich);
    synth_city_free(&city);
    arena_free(&arena);
}

/* ---- a city of Gaussians ---- */

/* Distance from the place to the nearest row, and whether rows are what they should be. */
static double nearest_m(const struct gauss *g, const double at[3])
{
    double best = HUGE_VAL;
    for (size_t i = 0; i < g->n; i++) {
        double d = 0;
        for (size_t k = 0; k < 3; k++)
            d += pow((double)g->mean_m[3 * i + k] + g->origin_enu_m[k] - at[k], 2);
        best = fmin(best, d);
    }
    return sqrt(best);
}

/* What is seen from straight above has a Gaussian near it, whatever their number. */
/* A block is put on open ground, nothing else moves, and straight rays measure its volume. */
static void test_block(void **state)
{
    enum { RASTER = 900 };
    const double step = 0.1;
    struct synth_config cfg;
    struct arena arena = {0};
    struct synth_city before, after;
    struct err e = {0};
    double volume = 0;
    kit_ok(options_defaults(synth_options(), &cfg, &arena, &e), e);
    cfg.extent_m = 120;
    kit_ok(synth_city_make(&cfg, &before, &e), e);
    cfg.block_m3 = 400;
    kit_ok(synth_city_make(&cfg, &after, &e), e);
    assert_int_equal(after.n_solids, before.n_solids + 1);
    for (size_t i = 0; i < before.n_solids; i++) {
        const struct synth_solid *a = &before.solids[i], *b = &after.solids[i];
        assert_memory_equal(a->center_m, b->center_m, sizeof a->center_m);
        assert_true(a->seed == b->seed && a->z1_m == b->z1_m);
    }
    for (int y = 0; y < RASTER; y++)
        for (int x = 0; x < RASTER; x++) {
            const double from[3] = {step * (x + 0.5 - RASTER / 2), step * (y + 0.5 - RASTER / 2),
                                    60},
                         down[3] = {0, 0, -1};
            struct synth_hit a, b;
            synth_trace_ray(&before, NULL, from, down, &a);
            synth_trace_ray(&after, NULL, from, down, &b);
            volume += step * step * (a.t_m - b.t_m);
            if (b.solid == after.solids + before.n_solids && a.solid)
                fail_msg("the block stands on a solid at %.1f, %.1f m", from[0], from[1]);
        }
    if (fabs(volume - 400) > 0.02 * 400)
        fail_msg("the block has %.1f m3, not 400", volume);
    cfg.block_m3 = 1e5;
    synth_city_free(&after);
    kit_fails(synth_city_make(&cfg, &after, &e), ERR_ARG, e, "--block-m3");
    synth_city_free(&before);
    arena_free(&arena);
}

static void test_splats_cover(void **state)
{
    enum { N = 60000, PLACES = 300 };
    struct synth_splats s;
    struct synth_city c;
    struct gauss g, part;
    struct err e = {0};
    kit_ok(synth_splats_open(5, 1, N, 1.0, &s, &e), e);
    assert_int_equal(s.n_districts, 1);
    kit_ok(synth_city_district(5, 0, 0, &c, &e), e);
    kit_ok(synth_splats_make(&s, N, 0, N, true, &g, &e), e);
    assert_int_equal(g.n, N);
    assert_int_equal(gauss_count_bad(&g, NULL), 0);
    double spacing = synth_splats_spacing(&s, N), cy = cos(c.yaw_rad), sy = sin(c.yaw_rad);
    size_t near = 0, dark = 0;
    for (uint64_t i = 0; i < PLACES; i++) {
        const double eye[3] = {(rng_unit(1, 1, i) - 0.5) * 2 * c.half_m,
                               (rng_unit(1, 2, i) - 0.5) * 2 * c.half_m, 500},
                     down[3] = {0, 0, -1};
        struct synth_hit hit;
        synth_trace_ray(&c, NULL, eye, down, &hit);
        const double at[3] = {cy * hit.pos[0] - sy * hit.pos[1], sy * hit.pos[0] + cy * hit.pos[1],
                              hit.pos[2]};
        near += nearest_m(&g, at) < 1.2 * spacing;
    }
    if ((double)near < 0.97 * PLACES)
        fail_msg("%zu of %d places have a Gaussian within %.2f m", near, PLACES, 1.2 * spacing);
    for (size_t i = 0; i < N; i++)
        dark += g.sh[12 * i] < -1.2f;
    if (dark > N / 4) /* streets in the sun are not black, and walls are not */
        fail_msg("%zu of %d Gaussians are nearly black", dark, N);
    kit_ok(synth_splats_make(&s, N, 777, 1000, true, &part, &e), e);
    assert_memory_equal(part.mean_m, g.mean_m + 3 * 777, 3000 * sizeof *g.mean_m);
    assert_memory_equal(part.sh, g.sh + 12 * 777, 12000 * sizeof *g.sh);
    gauss_free(&g);
    gauss_free(&part);
    synth_city_free(&c);
    synth_splats_free(&s);
}

/* Several districts: all rows are there, and streets go on from one to the next. */
static void test_splats_districts(void **state)
{
    enum { N = 50000 };
    struct synth_splats s;
    struct synth_city a, b;
    struct gauss g;
    struct err e = {0};
    kit_ok(synth_splats_open(9, 0, N, 4.0, &s, &e), e);
    assert_in_range(s.n_districts, 3, 8);
    kit_ok(synth_splats_make(&s, N, 0, N, false, &g, &e), e);
    assert_int_equal(g.n, N);
    double low[3], high[3];
    gauss_bounds(&g, 0, low, high);
    for (size_t k = 0; k < 2; k++)
        assert_true(high[k] - low[k] > 1.5 * SYNTH_DISTRICT_M && fabs(high[k]) < s.reach_m + 5);
    kit_ok(synth_city_district(9, 0, 0, &a, &e), e);
    kit_ok(synth_city_district(9, 0, 1, &b, &e), e);
    assert_memory_equal(a.street_m[0], b.street_m[0], a.n_streets[0] * sizeof *a.street_m[0]);
    assert_memory_not_equal(a.street_m[1], b.street_m[1], a.n_streets[1] * sizeof *a.street_m[1]);
    assert_true(a.n_solids != b.n_solids || memcmp(a.solids, b.solids, a.n_solids));
    synth_city_free(&a);
    synth_city_free(&b);
    gauss_free(&g);
    synth_splats_free(&s);
}

static void splats_write(const char *dir, const char *name, int64_t seed, char path[FILE_PATH_MAX])
{
    struct err e = {0};
    const struct synth_splats_options o = {
        .output = path, .count = 9001, .sh_degree = 2, .spacing_m = 8, .seed = seed};
    kit_ok(file_join(path, dir, name, &e), e);
    kit_ok(synth_splats_write(&o, &e), e);
}

/* The same bytes whatever the number of threads, others of another seed; three levels that hold
 * the same city. */
static void test_splats_files(void **state)
{
    char tmp[FILE_PATH_MAX], path[4][FILE_PATH_MAX], level[FILE_PATH_MAX];
    struct city base;
    struct buf one = {0}, other = {0};
    struct gauss g;
    struct ply_info info;
    struct ckpt c;
    struct err e = {0};
    kit_tmpdir(tmp);
    city_defaults(&base, tmp, "base");
    splats_write(tmp, "a.ply", 1, path[0]);
    pool_limit(1);
    splats_write(tmp, "b.ply", 1, path[1]);
    pool_limit(0);
    splats_write(tmp, "c.ply", 2, path[2]);
    splats_write(tmp, "levels", 1, path[3]);
    kit_ok(file_read(path[0], 0, &one, &e), e);
    kit_ok(file_read(path[1], 0, &other, &e), e);
    assert_int_equal(one.size, other.size);
    assert_memory_equal(one.data, other.data, one.size);
    buf_free(&other);
    kit_ok(file_read(path[2], 0, &other, &e), e);
    assert_int_equal(one.size, other.size);
    assert_memory_not_equal(one.data, other.data, one.size);
    kit_ok(ply_read(path[0], NULL, &g, &info, &e), e);
    assert_int_equal(g.n, 9001);
    assert_true(info.has_origin && info.origin.lat_deg == base.cfg.lat_deg);
    for (int l = 1; l <= 3; l++) {
        char name[64];
        snprintf(name, sizeof name, "cells/all/level%d.ckpt", l);
        kit_ok(file_join(level, path[3], name, &e), e);
        kit_ok(ckpt_read(level, &c, &e), e);
        assert_int_equal(c.g.n, 9001 >> (3 - l));
        if (l == 3) {
            assert_memory_equal(c.g.mean_m, g.mean_m, 3 * g.n * sizeof *g.mean_m);
            assert_memory_equal(c.g.quat_wxyz, g.quat_wxyz, 4 * g.n * sizeof *g.quat_wxyz);
            assert_memory_equal(c.g.sh, g.sh, 27 * g.n * sizeof *g.sh);
        }
        ckpt_free(&c);
    }
    gauss_free(&g);
    buf_free(&one);
    buf_free(&other);
    arena_free(&base.arena);
    kit_rmdir(tmp);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_same_seed_same_bytes),
        cmocka_unit_test(test_model_agrees_with_truth),
        cmocka_unit_test(test_knobs),
        cmocka_unit_test(test_gloss),
        cmocka_unit_test(test_tricky),
        cmocka_unit_test(test_block),
        cmocka_unit_test(test_splats_cover),
        cmocka_unit_test(test_splats_districts),
        cmocka_unit_test(test_splats_files),
    };
    progress_quiet(true);
    log_set_level(LOG_WARN);
    return cmocka_run_group_tests_name("synth", tests, NULL, NULL);
}
