/* A surface model of known depths, against a block on flat ground. Its depth maps are exact but for
 * what the test breaks: pixels that are not known, and pixels that are far off.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/scene/flight_kit.h"

#include <gdal.h>
#include <math.h>
#include <stdio.h>

#include "codec/container/npy.h"
#include "core/base.h"
#include "core/geo/geo.h"
#include "survey/depth_heights.h"

enum { MAP_W = 200, MAP_H = 150, PAIRS = 2 };
static const double ground_m = 3, roof_m = 11, half_m = 10; /* the block is about the origin */

/* Depth along the optical axis of a ray of length 1 in it, from the eye straight down. */
static double depth_of(const double eye[3], const double ray[3])
{
    double near = 0, far = HUGE_VAL;
    for (int k = 0; k < 3; k++) {
        double lo = k < 2 ? -half_m : ground_m, hi = k < 2 ? half_m : roof_m;
        double a = (lo - eye[k]) / ray[k], b = (hi - eye[k]) / ray[k];
        near = fmax(near, fmin(a, b));
        far = fmin(far, fmax(a, b));
    }
    return near < far ? near : (ground_m - eye[2]) / ray[2];
}

struct place {
    char dir[FILE_PATH_MAX], out[FILE_PATH_MAX];
    struct scene s;
};

static void scene_make(struct place *p, double unknown, double wrong)
{
    static float inverse[MAP_W * MAP_H];
    const size_t shape[2] = {MAP_H, MAP_W};
    struct err e = {0};
    char path[FILE_PATH_MAX], name[40];
    kit_tmpdir(p->dir);
    flight_kit_scene(&p->s);
    p->s.scale = 1;
    p->s.rot[0] = p->s.rot[4] = p->s.rot[8] = 1;
    kit_ok(file_join(path, p->dir, "depth", &e), e);
    kit_ok(file_mkdir(path, &e), e);
    for (size_t i = 0; i < p->s.n_images; i++) {
        struct scene_image *im = &p->s.images[i];
        double eye[3];
        snprintf(name, sizeof name, "p%02zu.jpg", i);
        im->name = arena_get(&p->s.arena, sizeof name, 1);
        memcpy(im->name, name, sizeof name);
        for (int k = 0; k < 3; k++)
            im->gps_enu_m[k] = (double)NAN;
        im->residual_m = (double)NAN;
        camera_center(&im->cam, eye);
        const struct camera c = camera_resize(&im->cam, MAP_W, MAP_H);
        for (size_t k = 0; k < MAP_W * MAP_H; k++) {
            const double ray[3] = {((double)(k % MAP_W) + 0.5 - c.cx_px) / c.fx_px,
                                   -((double)(k / MAP_W) + 0.5 - c.cy_px) / c.fy_px, -1};
            double depth = depth_of(eye, ray), u = rng_unit(i, 1, k);
            if (rng_unit(i, 2, k) < wrong)
                depth *= 0.6 + 0.5 * u;
            inverse[k] = rng_unit(i, 3, k) < unknown ? NAN : (float)(1 / depth);
        }
        snprintf(name, sizeof name, "depth/p%02zu.jpg.npy", i);
        kit_ok(file_join(path, p->dir, name, &e), e);
        kit_ok(npy_write(path, inverse, 2, shape, &e), e);
    }
    kit_ok(scene_write(p->dir, &p->s, &e), e);
    kit_ok(file_join(p->out, p->dir, "dsm.tif", &e), e);
}

static void scene_end(struct place *p)
{
    scene_free(&p->s);
    kit_rmdir(p->dir);
}

static float *pixels(const char *path, const struct map_grid *g)
{
    float *px = mem_array((size_t)g->width * g->height, PAIRS * sizeof *px);
    GDALDatasetH d = GDALOpen(path, GA_ReadOnly);
    assert_non_null(px);
    assert_non_null(d);
    for (int b = 0; b < PAIRS; b++)
        assert_int_equal(GDALRasterIO(GDALGetRasterBand(d, b + 1), GF_Read, 0, 0, (int)g->width,
                                      (int)g->height, px + b, (int)g->width, (int)g->height,
                                      GDT_Float32, PAIRS * sizeof *px,
                                      (int)(PAIRS * sizeof *px * g->width)),
                         CE_None);
    GDALClose(d);
    return px;
}

/* Heights on the block and off it; how many pixels have none, or another one. */
struct found {
    size_t ground, roof, none, other;
    double worst_m, scatter_m;
};

static struct found compare(const struct place *p, const struct map_report *r)
{
    struct found f = {0};
    struct err e = {0};
    struct crs *crs;
    float *px = pixels(p->out, &r->grid);
    kit_ok(crs_open(r->grid.epsg, &crs, &e), e);
    for (size_t i = 0; i < (size_t)r->grid.width * r->grid.height; i++) {
        double x = r->grid.west_m + ((double)(i % r->grid.width) + 0.5) * r->grid.pixel_m,
               y = r->grid.north_m - ((double)(i / r->grid.width) + 0.5) * r->grid.pixel_m, enu[3],
               lon, lat, h;
        kit_ok(crs_unproject(crs, 1, &x, &y, &e), e);
        kit_ok(geo_to_enu(&p->s.origin, x, y, p->s.origin.h_m, enu, &e), e);
        double edge = fmax(fabs(enu[0]), fabs(enu[1]));
        if (fabs(edge - half_m) < r->grid.pixel_m || edge > 60) /* walls, and the rim */
            continue;
        bool roof = edge < half_m;
        enu[2] = roof ? roof_m : ground_m;
        kit_ok(geo_from_enu(&p->s.origin, enu, &lon, &lat, &h, &e), e);
        double off = fabs((double)px[PAIRS * i] - h);
        if (px[PAIRS * i] == GEOTIFF_NODATA)
            f.none++;
        else if (off > 0.05)
            f.other++;
        else {
            f.worst_m = fmax(f.worst_m, off);
            f.scatter_m = fmax(f.scatter_m, (double)px[PAIRS * i + 1]);
            f.ground += !roof;
            f.roof += roof;
        }
    }
    crs_close(&crs);
    mem_free(px);
    return f;
}

static void test_block(void **state)
{
    struct place p;
    struct err e = {0};
    struct map_report r, in_bands;
    char words[100], other[FILE_PATH_MAX];
    scene_make(&p, 0.3, 0.1);
    struct depth_heights_request req = {.scene = p.dir, .gsd_m = 0.5};
    kit_ok(depth_heights_write(&req, p.out, &r, words, &e), e);
    assert_string_equal(words, "height above the WGS 84 ellipsoid");
    struct found f = compare(&p, &r);
    printf(
        "block: %zu px of ground, %zu of roof within %.3f m, scatter at most %.3f m; %zu without "
        "a height, %zu with another\n",
        f.ground, f.roof, f.worst_m, f.scatter_m, f.none, f.other);
    assert_true(f.roof > 1300 && f.ground > 50000);
    assert_true(f.none + f.other < (f.ground + f.roof) / 50);
    /* In bands of few samples the same bytes. */
    kit_ok(file_join(other, p.dir, "bands.tif", &e), e);
    req.most_samples = 40000;
    kit_ok(depth_heights_write(&req, other, &in_bands, words, &e), e);
    float *a = pixels(p.out, &r.grid), *b = pixels(other, &in_bands.grid);
    assert_int_equal(r.pixels_held, in_bands.pixels_held);
    assert_memory_equal(a, b, (size_t)r.grid.width * r.grid.height * PAIRS * sizeof *a);
    mem_free(a);
    mem_free(b);
    scene_end(&p);
}

static void test_refusals(void **state)
{
    struct place p;
    struct err e = {0};
    struct map_report r;
    char words[100], path[FILE_PATH_MAX];
    scene_make(&p, 0.5, 0);
    struct depth_heights_request req = {.scene = p.dir, .gsd_m = 1e-5};
    kit_fails(depth_heights_write(&req, p.out, &r, words, &e), ERR_ARG, e, "a pixel");
    const double away[4] = {8, 48, 8.001, 48.001};
    req.gsd_m = 0.5;
    req.bbox_deg = away;
    kit_fails(depth_heights_write(&req, p.out, &r, words, &e), ERR_ARG, e, "empty");
    req.bbox_deg = NULL;
    req.depth = "/nowhere";
    kit_fails(depth_heights_write(&req, p.out, &r, words, &e), ERR_NOENT, e, "citysplat stereo");
    req.depth = NULL;
    kit_ok(file_join(path, p.dir, "depth/p07.jpg.npy", &e), e);
    kit_ok(file_write(path, "no array", 8, &e), e);
    kit_fails(depth_heights_write(&req, p.out, &r, words, &e), ERR_FORMAT, e, "p07.jpg.npy");
    assert_false(file_exists(p.out));
    scene_end(&p);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_block),
        cmocka_unit_test(test_refusals),
    };
    GDALAllRegister();
    progress_quiet(true);
    log_set_level(LOG_WARN);
    return cmocka_run_group_tests_name("depth_heights", tests, NULL, NULL);
}
