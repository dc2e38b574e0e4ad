/* Maps of a store with known truth: the procedural city covered with Gaussians, haze above it and
 * large Gaussians far around. Heights are compared with rays into the city; there are no seams;
 * GDAL reads the file; invalid requests are refused.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/truth/synth_map.h"
#include "tests/survey/survey_kit.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <gdal/gdal.h>
#include <jansson.h>

#include "codec/image/image.h"
#include "core/library.h"
#include "lab/truth/edge.h"
#include "lod/surface/probe.h"
#include "survey/change.h"
#include "survey/gdal_library.h"
#include "survey/map.h"

#define GSD_M 0.25

/* ---- a map in memory ---- */

struct map {
    char path[FILE_PATH_MAX];
    struct map_report report;
    uint32_t w, h;
    float *height;
    uint8_t *rgba;
};

static void map_make(struct map *m, const char *name, enum geotiff_kind kind, uint32_t piece_px)
{
    struct err e = {0};
    const struct map_request r = {.kind = kind, .gsd_m = GSD_M, .piece_px = piece_px};
    memset(m, 0, sizeof *m);
    kit_ok(file_join(m->path, f.dir, name, &e), e);
    kit_ok(map_write(f.nadir, &r, m->path, &m->report, &e), e);
    m->w = m->report.grid.width;
    m->h = m->report.grid.height;
    GDALDatasetH d = GDALOpen(m->path, GA_ReadOnly);
    assert_non_null(d);
    assert_int_equal(GDALGetRasterXSize(d), m->w);
    assert_int_equal(GDALGetRasterYSize(d), m->h);
    m->height = mem_array((size_t)m->w * m->h, sizeof *m->height);
    m->rgba = mem_array((size_t)m->w * m->h, 4);
    assert_non_null(m->height);
    assert_non_null(m->rgba);
    if (kind == GEOTIFF_HEIGHT)
        assert_int_equal(GDALRasterIO(GDALGetRasterBand(d, 1), GF_Read, 0, 0, (int)m->w, (int)m->h,
                                      m->height, (int)m->w, (int)m->h, GDT_Float32, 0, 0),
                         CE_None);
    else
        assert_int_equal(GDALDatasetRasterIO(d, GF_Read, 0, 0, (int)m->w, (int)m->h, m->rgba,
                                             (int)m->w, (int)m->h, GDT_Byte, 4, NULL, 4,
                                             (int)(4 * m->w), 1),
                         CE_None);
    GDALClose(d);
}

static void map_free(struct map *m)
{
    mem_free(m->height);
    mem_free(m->rgba);
}

/* ENU of a pixel centre of the map, and the ellipsoidal height of ENU z = 0 there. */
static void pixel_place(const struct map *m, const struct crs *crs, double u, double v,
                        double enu[3])
{
    struct err e = {0};
    double lon = m->report.grid.west_m + (u + 0.5) * GSD_M,
           lat = m->report.grid.north_m - (v + 0.5) * GSD_M;
    kit_ok(crs_unproject(crs, 1, &lon, &lat, &e), e);
    kit_ok(geo_to_enu(&origin, lon, lat, origin.h_m, enu, &e), e);
}

static int compare_double(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* ---- tests ---- */

/* Median at most half a pixel, 95 % at most two, wherever the truth is not steep within two pixels;
 * and no edge is displaced by more than that, or heights beside it would be metres off. */
static void heights_are_the_citys(void **state)
{
    struct map m;
    struct crs *crs;
    struct err e = {0};
    size_t n = 0, off = 0;
    double edge = 0.5 * EXTENT_M - 2 * GSD_M;
    map_make(&m, "dsm.tif", GEOTIFF_HEIGHT, 0);
    assert_int_equal(m.report.grid.epsg, 32632);
    kit_ok(crs_open(32632, &crs, &e), e);
    double *error = mem_array((size_t)m.w * m.h, sizeof *error);
    assert_non_null(error);
    for (uint32_t y = 0; y < m.h; y++)
        for (uint32_t x = 0; x < m.w; x++) {
            double enu[3], lo = HUGE_VAL, hi = -HUGE_VAL;
            pixel_place(&m, crs, x, y, enu);
            if (fabs(enu[0]) > edge || fabs(enu[1]) > edge)
                continue;
            for (int k = 0; k < 25; k++) {
                double z = truth_z(enu[0] + (k % 5 - 2) * GSD_M, enu[1] + (k / 5 - 2) * GSD_M);
                lo = fmin(lo, z);
                hi = fmax(hi, z);
            }
            float got = m.height[(size_t)y * m.w + x];
            assert_true(got > -100); /* no holes within the city */
            if (hi - lo > 1)
                continue;
            error[n] = fabs((double)got - origin.h_m - truth_z(enu[0], enu[1]));
            off += error[n++] > 1;
        }
    assert_true(n > 20000);
    qsort(error, n, sizeof *error, compare_double);
    printf("survey dsm: %zu px of %.2f m, error median %.4f m (%.3f px), 95 %% %.4f m (%.3f px), "
           "beyond 1 m %.4f %%\n",
           n, GSD_M, error[n / 2], error[n / 2] / GSD_M, error[n * 95 / 100],
           error[n * 95 / 100] / GSD_M, 100 * (double)off / (double)n);
    printf("survey plane: %.5f px from UTM\n", m.report.off_px);
    assert_true(m.report.off_px < 0.001);
    assert_true(error[n / 2] <= 0.5 * GSD_M);
    assert_true(error[n * 95 / 100] <= 2 * GSD_M);
    assert_true((double)off < 1e-3 * (double)n);
    mem_free(error);
    crs_close(&crs);
    map_free(&m);
}

/* Add the walls that line y of the map crosses, or column y. */
static void edges_of_line(const struct map *m, const struct crs *crs, uint32_t y, bool down,
                          struct edge_list *l)
{
    struct err e = {0};
    size_t w = down ? m->h : m->w;
    float *line = mem_array(w, sizeof *line), *truth[2];
    for (uint32_t k = 0; k < 2; k++) {
        double from[3], to[3];
        truth[k] = mem_array(w * EDGE_FINE, sizeof *truth[k]);
        assert_non_null(truth[k]);
        pixel_place(m, crs, down ? y + k : -0.5, down ? -0.5 : y + k, from);
        pixel_place(m, crs, down ? y + k : (double)w - 0.5, down ? (double)w - 0.5 : y + k, to);
        for (size_t i = 0; i < w * EDGE_FINE; i++) {
            double t = ((double)i + 0.5) / (double)(w * EDGE_FINE),
                   at[2] = {from[0] + t * (to[0] - from[0]), from[1] + t * (to[1] - from[1])};
            bool in = fabs(at[0]) < 0.5 * EXTENT_M - 1 && fabs(at[1]) < 0.5 * EXTENT_M - 1;
            truth[k][i] = in ? (float)truth_z(at[0], at[1]) : NAN;
        }
    }
    assert_non_null(line);
    for (size_t x = 0; x < w; x++)
        line[x] = m->height[down ? x * m->w + y : (size_t)y * m->w + x] - (float)origin.h_m;
    kit_ok(edge_line(l, line, truth[0], truth[1], w, GSD_M, &e), e);
    mem_free(line);
    mem_free(truth[0]);
    mem_free(truth[1]);
}

/* Edges of roofs within two pixels; and an edge that is moved is found where it was moved to. */
static void roofs_end_where_they_do(void **state)
{
    struct map m;
    struct crs *crs;
    struct err e = {0};
    struct edge_list l = {0};
    struct edge_score s;
    map_make(&m, "edges.tif", GEOTIFF_HEIGHT, 0);
    kit_ok(crs_open(m.report.grid.epsg, &crs, &e), e);
    for (uint32_t y = 0; y + 1 < m.h; y += 8)
        edges_of_line(&m, crs, y, false, &l);
    for (uint32_t x = 0; x + 1 < m.w; x += 8)
        edges_of_line(&m, crs, x, true, &l);
    kit_ok(edge_tell(&l, &s, &e), e);
    printf("survey edges: %zu walls, %zu missing; off by median %.2f px, 95 %% %.2f px, %.1f %% "
           "within 2 px, roofs reach out by %.2f px\n",
           l.n, l.missing, s.median_px, s.most_px, 100 * s.within_2_px, s.out_px);
    assert_true(l.n > 60 && s.within_2_px > 0.95 && s.most_px <= 2);
    edge_free(&l);
    crs_close(&crs);
    map_free(&m);
}

/* A wall at a known place, drawn at another: what edge_line says of it. */
static void edges_are_measured(void **state)
{
    enum { W = 60 };
    float height[W], truth[W * EDGE_FINE], next[W * EDGE_FINE];
    struct err e = {0};
    struct edge_score s;
    for (int k = 0; k < 12; k++) {
        double wall = 30, at = wall + 0.5 * (k % 6 - 2), aslant = k < 6 ? 0 : 1;
        struct edge_list l = {0};
        for (int i = 0; i < W * EDGE_FINE; i++) {
            double x = (i + 0.5) / EDGE_FINE;
            truth[i] = x < wall ? 10 : 0;
            next[i] = x < wall + aslant ? 10 : 0;
        }
        for (int x = 0; x < W; x++) /* the share of the pixel that the roof covers */
            height[x] = 10 * (float)fmin(fmax(at - x, 0), 1);
        kit_ok(edge_line(&l, height, truth, next, W, 0.25, &e), e);
        kit_ok(edge_tell(&l, &s, &e), e);
        assert_true(l.n == 1 && l.missing == 0);
        assert_true(fabs(s.out_px - (at - wall) / hypot(1, aslant)) < 1e-6);
        for (int x = 0; x < W; x++)
            height[x] = 0;
        kit_ok(edge_line(&l, height, truth, next, W, 0.25, &e), e);
        assert_true(l.n == 1 && l.missing == 1);
        edge_free(&l);
    }
}

/* Colour says where a pixel is: to a fifth of a pixel on average, alpha 0 outside of the survey. */
static void colours_lie_where_they_belong(void **state)
{
    struct map m;
    struct crs *crs;
    struct err e = {0};
    struct shown sum = {0};
    size_t n = 0, outside = 0;
    map_make(&m, "ortho.tif", GEOTIFF_COLOR, 0);
    kit_ok(crs_open(m.report.grid.epsg, &crs, &e), e);
    for (uint32_t y = 0; y < m.h; y++)
        for (uint32_t x = 0; x < m.w; x++) {
            double enu[3];
            const uint8_t *px = m.rgba + 4 * ((size_t)y * m.w + x);
            pixel_place(&m, crs, x, y, enu);
            if (fabs(enu[0]) < 28 && fabs(enu[1]) < 28) {
                assert_int_equal(px[3], 255);
                shown_add(&sum, px[0], px[1], enu);
                n++;
            }
            if (fabs(enu[0]) > 36 || fabs(enu[1]) > 36) {
                assert_int_equal(px[3], 0);
                outside++;
            }
        }
    assert_true(n > 40000 && outside > 100);
    for (size_t k = 0; k < 2; k++) {
        double shift_px = shown_shift(&sum, k) / GSD_M;
        printf("survey ortho: %s shifted by %.3f px\n", k ? "north" : "east", shift_px);
        assert_true(fabs(shift_px) < 0.2);
    }
    crs_close(&crs);
    map_free(&m);
}

/* The same map in pieces of another size: the same but for rounding. */
static void pieces_leave_no_seams(void **state)
{
    struct map a, b;
    size_t differ = 0, held = 0;
    map_make(&a, "a.tif", GEOTIFF_HEIGHT, 512);
    map_make(&b, "b.tif", GEOTIFF_HEIGHT, 96);
    assert_int_equal(a.w, b.w);
    assert_int_equal(a.h, b.h);
    for (size_t i = 0; i < (size_t)a.w * a.h; i++) {
        held += a.height[i] > -100;
        differ += fabsf(a.height[i] - b.height[i]) > 0.01f;
    }
    printf("survey seams: %zu of %zu px differ by more than 1 cm\n", differ, held);
    assert_true(held > 60000 && (double)differ < 5e-4 * (double)held);
    map_free(&a);
    map_free(&b);
}

/* gdalinfo -json without its blanks has this text. */
static void gdal_says(const struct buf *json, const char *want)
{
    struct buf bare = {0};
    struct err e = {0};
    for (size_t i = 0; i < json->size; i++)
        if (json->data[i] != ' ' && json->data[i] != '\n')
            buf_u8(&bare, json->data[i]);
    buf_u8(&bare, 0);
    kit_ok(buf_check(&bare, &e), e);
    if (!strstr((const char *)bare.data, want))
        fail_msg("gdalinfo does not say %s: %s", want, (const char *)bare.data);
    buf_free(&bare);
}

static void gdal_calls_it_cloud_optimized(void **state)
{
    static const char *const wants[] = {
        "\"LAYOUT\":\"COG\"", "\"noDataValue\":-9999.0",        "\"overviews\":[{\"size\":[",
        "WGS84/UTMzone32N",   "\"type\":\"Float32\"",           "\"block\":[512,512]",
        "\"unit\":\"metre\"", "\"TIFFTAG_COPYRIGHT\":\"ours\"", "\"AREA_OR_POINT\":\"Area\""};
    struct buf out = {0};
    struct err e = {0};
    char path[FILE_PATH_MAX];
    const struct map_request r = {.kind = GEOTIFF_HEIGHT, .gsd_m = 0.1};
    kit_ok(file_join(path, f.dir, "cog.tif", &e), e);
    kit_ok(map_write(f.nadir, &r, path, NULL, &e), e);
    if (kit_run(&out, "gdalinfo -json '%s'", path) != 0)
        fail_msg("gdalinfo: %s", (const char *)out.data);
    for (size_t i = 0; i < sizeof wants / sizeof *wants; i++)
        gdal_says(&out, wants[i]);
    buf_free(&out);
    assert_int_equal(kit_run(&out, "ls '%s' | grep -c part", f.dir), 1); /* none */
    buf_free(&out);
}

/* Background does not widen the survey. */
static void far_gaussians_are_no_survey(void **state)
{
    const struct area *a = nadir_area(f.nadir);
    struct err e = {0};
    double lo[3], hi[3];
    kit_ok(geo_to_enu(&origin, a->west_deg, a->south_deg, origin.h_m, lo, &e), e);
    kit_ok(geo_to_enu(&origin, a->east_deg, a->north_deg, origin.h_m, hi, &e), e);
    for (size_t k = 0; k < 2; k++) {
        assert_true(lo[k] <= -0.5 * EXTENT_M + 1 && lo[k] > -100);
        assert_true(hi[k] >= 0.5 * EXTENT_M - 1 && hi[k] < 100);
    }
    assert_true(fabs(a->sigma_m - 0.7 * SPACING_M) < 0.1 * SPACING_M);
}

static void places_have_heights(void **state)
{
    struct probe p;
    struct err e = {0};
    size_t n = 0;
    for (int i = 0; i < 40; i++) {
        const double enu[3] = {(i % 8 - 3.5) * 7.1, (i / 8 - 2) * 11.3, 0};
        double lon, lat, h, z = truth_z(enu[0], enu[1]);
        kit_ok(geo_from_enu(&origin, enu, &lon, &lat, &h, &e), e);
        const double at[1][2] = {{lon, lat}};
        kit_ok(probe_many(f.nadir, at, 1, 0, &p, &e), e);
        assert_true(p.surveyed && p.found && p.level == 3);
        assert_true(p.height_min_m <= p.height_m && p.height_m <= p.height_max_m);
        if (p.height_max_m - p.height_min_m < 0.3) { /* no edge at the place */
            assert_true(fabs(p.height_m - origin.h_m - z) < 0.3);
            n++;
        }
    }
    assert_true(n > 15);
    kit_ok(probe_many(f.nadir, (const double[1][2]){{8.7, 50.2}}, 1, 0, &p, &e), e);
    assert_true(!p.surveyed && !p.found && isnan(p.height_m));
    kit_fails(probe_many(f.nadir, (const double[1][2]){{8, 91}}, 1, 0, &p, &e), ERR_ARG, e,
              "latitude");
}

static void refused(const struct map_request *r, const char *part)
{
    struct err e = {0};
    char path[FILE_PATH_MAX];
    kit_ok(file_join(path, f.dir, "refused.tif", &e), e);
    kit_fails(map_write(f.nadir, r, path, NULL, &e), ERR_ARG, e, part);
    assert_false(file_exists(path));
}

static void nonsense_is_refused(void **state)
{
    static const double elsewhere[4] = {9, 51, 9.1, 51.1};
    static const int no_heights[] = {6360, 5715, 5555}; /* feet; depths; a plane as well */
    struct err e = {0};
    struct crs *crs;
    refused(&(struct map_request){.epsg = 4326}, "not a projection in metres");
    refused(&(struct map_request){.epsg = 2263}, "not a projection in metres"); /* feet */
    refused(&(struct map_request){.epsg = 4258}, "not a projection in metres");
    refused(&(struct map_request){.epsg = 5555}, "give the plane alone, EPSG:25832");
    refused(&(struct map_request){.epsg = 999999}, "no such coordinate system");
    refused(&(struct map_request){.bbox_deg = elsewhere}, "the area is empty: surveyed is");
    refused(&(struct map_request){.gsd_m = 1e-5}, "from ");
    refused(&(struct map_request){.gsd_m = 0.5, .epsg = 6931}, "shears"); /* equal areas */
    kit_ok(crs_open(32632, &crs, &e), e);
    double x = 8.68, y = 50.11;
    kit_ok(crs_project(crs, 1, &x, &y, &e), e);
    kit_ok(crs_unproject(crs, 1, &x, &y, &e), e);
    assert_true(fabs(x - 8.68) < 1e-9 && fabs(y - 50.11) < 1e-9);
    for (size_t i = 0; i < sizeof no_heights / sizeof *no_heights; i++)
        kit_fails(crs_set_vertical(crs, no_heights[i], &e), ERR_ARG, e,
                  "no system of heights in metres");
    crs_close(&crs);
    assert_int_equal(crs_utm(-179.9, -10), 32701);
    assert_int_equal(crs_utm(180, 10), 32660);
    assert_int_equal(crs_utm(5.3, 60.4), 32632);  /* Bergen */
    assert_int_equal(crs_utm(15.6, 78.2), 32633); /* Longyearbyen */
    assert_int_equal(crs_utm(0, 84), 32661);
    assert_int_equal(crs_utm(0, -80.1), 32761);
}

/* Through the program: exit codes, one line of error, nothing left. */
static void the_program_says_the_same(void **state)
{
    struct buf out = {0};
    const char *bin = kit_program();
    assert_int_equal(
        kit_run(&out, "'%s' dsm -q '%s' -o '%s/cli.tif' --gsd-m 0.5", bin, f.path, f.dir), 0);
    kit_expect_text((const char *)out.data, "EPSG:32632", __FILE__, __LINE__);
    buf_free(&out);
    assert_int_equal(
        kit_run(&out, "'%s' ortho -q '%s' -o '%s/no.tif' --bbox 9,51,8,52", bin, f.path, f.dir), 2);
    kit_expect_text((const char *)out.data, "west must be less", __FILE__, __LINE__);
    buf_free(&out);
    assert_int_equal(
        kit_run(&out, "'%s' ortho -q '%s' -o '%s/none/no.tif' --gsd-m 1", bin, f.path, f.dir), 1);
    buf_free(&out);
    assert_int_equal(kit_run(&out, "ls '%s' | grep -c 'no.tif\\|part'", f.dir), 1);
    buf_free(&out);
    assert_int_equal(kit_run(&out, "'%s' height -q '%s' 8.6821,50.1109 9,51", bin, f.path), 0);
    kit_expect_text((const char *)out.data, "\"height_m\": null", __FILE__, __LINE__);
    kit_expect_text((const char *)out.data, "WGS 84 ellipsoid", __FILE__, __LINE__);
    buf_free(&out);
    assert_int_equal(kit_run(&out, "'%s' height -q '%s' 8.6821", bin, f.path), 2);
    buf_free(&out);
    static const struct {
        const char *command, *file, *says;
    } ends[] = {{"dsm", "no.png", "must end in .tif or .tiff"},
                {"ortho", "no", "must end in .tif or .tiff"},
                {"points", "no.laz", "no library for .laz"},
                {"contour", "no.shp", "must end in .geojson or .gpkg"}};
    for (size_t i = 0; i < sizeof ends / sizeof *ends; i++) {
        assert_int_equal(kit_run(&out, "'%s' %s -q '%s' -o '%s/%s'", bin, ends[i].command, f.path,
                                 f.dir, ends[i].file),
                         2);
        kit_expect_text((const char *)out.data, ends[i].says, __FILE__, __LINE__);
        buf_free(&out);
    }
}

/* The city once more: moved as a whole, tilted (higher by so much a metre to the east), or with a
 * block of 6 x 6 m put up on level ground. */
static void later_city(const char *name, double east, double north, double up, double tilt,
                       const double block[2], char path[FILE_PATH_MAX])
{
    struct err e = {0};
    struct gauss g;
    struct geo_origin moved;
    const double shift[3] = {east, north, up};
    cover(&g);
    for (size_t i = 0; i < g.n; i++) {
        float *at = g.mean_m + 3 * i;
        at[2] += (float)(tilt * (double)at[0]);
        if (block && fabs((double)at[0] - block[0]) < 3 && fabs((double)at[1] - block[1]) < 3)
            at[2] += 5;
    }
    kit_ok(geo_from_enu(&origin, shift, &moved.lon_deg, &moved.lat_deg, &moved.h_m, &e), e);
    kit_ok(file_join(path, f.dir, name, &e), e);
    const struct pyramid_config cfg = {.tile_edge_m = 30, .name = "later", .attribution = "ours"};
    const struct pyramid_level level = {.g = &g, .level = 3};
    kit_ok(pyramid_build(&moved, &level, 1, &cfg, NULL, 0, path, NULL, &e), e);
    gauss_free(&g);
}

static void compare(const char *path, const char *name, bool align, struct change_report *r)
{
    struct err e = {0};
    struct nadir *later;
    char out[FILE_PATH_MAX];
    const struct nadir_options no = {.ceiling_m = (double)NAN};
    const struct change_request request = {.gsd_m = GSD_M, .align = align};
    kit_ok(file_join(out, f.dir, name, &e), e);
    kit_ok(nadir_open(path, &no, &later, &e), e);
    kit_ok(change_write(f.nadir, later, &request, out, r, &e), e);
    nadir_close(&later);
}

/* A store whose heights are not ellipsoidal says so in its products, and no geoid is taken off. */
static void other_heights_are_named(void **state)
{
    static const struct {
        const char *heights, *says;
    } kinds[] = {{"sea-exif", "height above sea level by EXIF"},
                 {"EPSG:5773", "height above the zero of EPSG:5773"}};
    const char *bin = kit_program();
    struct buf out = {0};
    for (size_t i = 0; i < 2; i++) {
        struct err e = {0};
        struct gauss g;
        struct pyramid_config cfg = {.tile_edge_m = 30, .name = "sea"};
        const struct pyramid_level level = {.g = &g, .level = 3};
        char path[FILE_PATH_MAX];
        cover(&g);
        snprintf(cfg.heights, sizeof cfg.heights, "%s", kinds[i].heights);
        kit_ok(file_join(path, f.dir, "sea.tiles", &e), e);
        kit_ok(pyramid_build(&origin, &level, 1, &cfg, NULL, 0, path, NULL, &e), e);
        gauss_free(&g);
        assert_int_equal(
            kit_run(&out,
                    "cd '%s' && '%s' dsm -q sea.tiles -o sea.tif --gsd-m 0.5 --overwrite && "
                    "gdalinfo sea.tif",
                    f.dir, bin),
            0);
        kit_expect_text((const char *)out.data, kinds[i].says, __FILE__, __LINE__);
        assert_true(!strstr((const char *)out.data, "WGS 84 ellipsoid"));
        assert_true(!!strstr((const char *)out.data, "EGM96 height") == (i == 1));
        buf_free(&out);
        assert_int_equal(kit_run(&out, "'%s' height -q '%s' 8.6821,50.1109", bin, path), 0);
        kit_expect_text((const char *)out.data, i ? "\"EPSG:5773\"" : "sea level by EXIF", __FILE__,
                        __LINE__);
        buf_free(&out);
        /* no change is told between heights of two references; a .ply keeps the reference */
        assert_int_equal(kit_run(&out,
                                 "cd '%s' && ! '%s' compare -q '%s' sea.tiles -o no.tif && "
                                 "'%s' export -q sea.tiles -o sea.ply --overwrite && "
                                 "'%s' import -q sea.ply -o back.tiles --overwrite && "
                                 "'%s' info back.tiles --json",
                                 f.dir, bin, f.path, bin, bin, bin),
                         0);
        kit_expect_text((const char *)out.data, kinds[i].heights, __FILE__, __LINE__);
        buf_free(&out);
        /* 3D Tiles are ellipsoidal: a warning, or raised by the geoid, about 48 m there */
        assert_int_equal(kit_run(&out,
                                 "cd '%s' && '%s' export sea.tiles -o sea.3tz --overwrite 2>&1 && "
                                 "{ '%s' export -q sea.tiles -o up.ply --overwrite --geoid egm96 "
                                 "2>&1; grep -a 'citysplat [oh]' up.ply; }",
                                 f.dir, bin, bin),
                         0);
        kit_expect_text((const char *)out.data, "take them as ellipsoidal", __FILE__, __LINE__);
        kit_expect_text((const char *)out.data,
                        i ? "not from the sea" : "comment citysplat heights ellipsoid", __FILE__,
                        __LINE__);
        buf_free(&out);
    }
    assert_int_equal(
        kit_run(&out, "cd '%s' && '%s' dsm -q sea.tiles -o no.tif --geoid none/egm96", f.dir, bin),
        1);
    buf_free(&out);
}

/* One polygon around the block, of its size, in both formats; files are not replaced unasked. */
static void changes_are_outlined(const char *later)
{
    static const char *const name[] = {"c.geojson", "c.gpkg"};
    struct buf out = {0};
    for (size_t i = 0; i < 2; i++) {
        assert_int_equal(kit_run(&out,
                                 "'%s' compare -q '%s' '%s' -o '%s/c.tif' --gsd-m 0.25 --polygons "
                                 "'%s/%s' --overwrite",
                                 kit_program(), f.path, later, f.dir, f.dir, name[i]),
                         0);
        kit_expect_text((const char *)out.data, "\"regions\": 1,", __FILE__, __LINE__);
        buf_free(&out);
        assert_int_equal(kit_run(&out,
                                 "ogrinfo -q -al '%s/%s' -dialect SQLite -sql 'SELECT COUNT(*) AS "
                                 "n, MAX(area_m2) AS area, MAX(volume_m3) AS volume, "
                                 "MAX(volume_95_m3) AS half FROM changes'",
                                 f.dir, name[i]),
                         0);
        const char *area = strstr((const char *)out.data, "area (Real) = "),
                   *volume = strstr((const char *)out.data, "volume (Real) = ");
        kit_expect_text((const char *)out.data, "n (Integer) = 1", __FILE__, __LINE__);
        assert_true(area && volume);
        assert_true(fabs(strtod(area + 14, NULL) - 36) < 8);
        assert_true(fabs(strtod(volume + 16, NULL) - 180) < 27);
        buf_free(&out);
    }
    assert_int_equal(kit_run(&out, "'%s' compare -q '%s' '%s' -o '%s/c.tif' --gsd-m 0.5",
                             kit_program(), f.path, later, f.dir),
                     2);
    kit_expect_text((const char *)out.data, "replace it with --overwrite", __FILE__, __LINE__);
    buf_free(&out);
}

static void changes_are_found(void **state)
{
    struct change_report r;
    const struct changed_report *c = &r.changed;
    struct buf out = {0};
    struct err e = {0};
    char path[FILE_PATH_MAX];
    double block[2] = {0, 0};
    bool level = false;
    later_city("moved.tiles", 0.2, -0.15, 0.3, 0, NULL, path);
    compare(path, "moved.tif", false, &r);
    printf("survey compare: shift %.3f %.3f %.3f m, spread %.3f m\n", r.pose.east_m, r.pose.north_m,
           r.pose.up_m, r.spread_m);
    assert_true(fabs(r.pose.east_m - 0.2) < 0.1 && fabs(r.pose.north_m + 0.15) < 0.1);
    assert_true(fabs(r.pose.up_m - 0.3) < 0.03 && fabs(r.median_m - 0.3) < 0.02);
    for (double y = -24; y < 24 && !level; y += 2)
        for (double x = -24; x < 24 && !level; x += 2) {
            level = true;
            for (int k = 0; k < 900 && level; k++)
                level = fabs(truth_z(x - 3.5 + k % 30 * 0.24, y - 3.5 + k / 30 * 0.24) -
                             truth_z(x, y)) < 1;
            block[0] = x;
            block[1] = y;
        }
    assert_true(level);
    later_city("block.tiles", 0, 0, 0, 0, block, path);
    compare(path, "block.tif", false, &r);
    printf("survey compare: gained %.1f +- %.1f m3 of 180, lost %.1f, %u regions, alike over %.2f "
           "m, changed %.4f\n",
           c->gained_m3, c->gained_95_m3, c->lost_m3, c->regions, c->correlation_m,
           (double)c->pixels / (double)r.pixels);
    assert_int_equal(c->regions, 1);
    assert_true(fabs(c->gained_m3 - 180) < 0.15 * 180 && c->lost_m3 == 0);
    assert_true(fabs(c->gained_m3 - 180) < c->gained_95_m3);
    assert_true(fabs((double)c->pixels * r.pixel_m2 - 36) < 8);
    assert_true(fabs(r.pose.east_m) < 0.02 && fabs(r.pose.north_m) < 0.02 &&
                fabs(r.pose.up_m) < 0.02);
    assert_int_equal(kit_run(&out, "gdalinfo -json '%s/block.tif'", f.dir), 0);
    gdal_says(&out, "\"LAYOUT\":\"COG\"");
    gdal_says(&out, "\"noDataValue\":-9999.0");
    buf_free(&out);
    /* through the program, and what has nothing in common */
    assert_int_equal(kit_run(&out, "'%s' compare -q '%s' '%s' -o '%s/c.tif' --gsd-m 0.5",
                             kit_program(), f.path, path, f.dir),
                     0);
    kit_expect_text((const char *)out.data, "\"gained_m3\"", __FILE__, __LINE__);
    buf_free(&out);
    changes_are_outlined(path);
    const double far[4] = {9, 51, 9.1, 51.1};
    const struct change_request nowhere = {.bbox_deg = far};
    kit_fails(change_write(f.nadir, f.nadir, &nowhere, "x.tif", &r, &e), ERR_ARG, e,
              "nothing to compare");
}

static void aligned(const char *name, double east, double north, double up, double tilt)
{
    struct change_report r, before;
    char path[FILE_PATH_MAX];
    later_city(name, east, north, up, tilt, NULL, path);
    compare(path, "before.tif", false, &before);
    compare(path, "after.tif", true, &r);
    printf(
        "survey align: %.2f %.2f %.2f m, %.1f mm/m: found %.3f %.3f %.3f, %.2f in %u rounds; left "
        "%.3f %.3f %.3f; changed %.4f before, %.4f after\n",
        east, north, up, 1000 * tilt, r.pose.east_m, r.pose.north_m, r.pose.up_m,
        1000 * r.pose.tilt_east, r.rounds, r.left.east_m, r.left.north_m, r.left.up_m,
        before.differs_share, r.differs_share);
    assert_true(r.aligned && !before.aligned);
    assert_true(hypot(r.pose.east_m - east, r.pose.north_m - north) < 0.1 * GSD_M + 0.02);
    assert_true(fabs(r.pose.up_m - up) < 0.01 && fabs(r.pose.tilt_east - tilt) < 2e-4);
    assert_true(fabs(r.pose.tilt_north) < 2e-4);
    assert_true(r.differs_share < 0.25 * before.differs_share && fabs(r.median_m) < 0.011);
}

/* A store that was moved by a known amount is moved back by it: to the tenth of a pixel, also where
 * all heights are metres off and the ground slopes. */
static void what_lies_askew_is_aligned(void **state)
{
    struct buf out = {0};
    aligned("askew.tiles", 0.6, -0.35, 0.3, 0.004);
    aligned("high.tiles", -0.4, 0.8, 7.5, 0);
    assert_int_equal(
        kit_run(&out,
                "cd '%s' && '%s' compare -q city.tiles high.tiles -o c.tif --overwrite --gsd-m 0.5 "
                "--align",
                f.dir, kit_program()),
        0);
    kit_expect_text((const char *)out.data, "\"aligned\": true", __FILE__, __LINE__);
    kit_expect_text((const char *)out.data, "\"shift_left\"", __FILE__, __LINE__);
    buf_free(&out);
    /* Far above: the plan is not known without it. */
    assert_int_equal(
        kit_run(&out,
                "cd '%s' && '%s' compare -q city.tiles high.tiles -o c.tif --overwrite --gsd-m 0.5",
                f.dir, kit_program()),
        0);
    kit_expect_text((const char *)out.data, "\"east_m\": null", __FILE__, __LINE__);
    buf_free(&out);
}

/* ---- against the city's own picture ---- */

/* The cover in the city's colours as seen from above, without haze, moved to the east. */
static void painted_city(const char *name, double east_m, char path[FILE_PATH_MAX])
{
    struct err e = {0};
    struct gauss g;
    struct image img = {0};
    struct geo_origin moved;
    const uint32_t n = (uint32_t)(EXTENT_M / SPACING_M), size[2] = {n, n};
    const double half = 0.5 * EXTENT_M, shift[3] = {east_m, 0, 0},
                 corner[4][2] = {{-half, half}, {half, half}, {-half, -half}, {half, -half}};
    size_t kept = 0;
    kit_ok(synth_map_draw(&f.city, corner, size, 2, 0, &img, &e), e);
    cover(&g);
    for (size_t i = 0; i < g.n; i++) {
        double x = (double)g.mean_m[3 * i], y = (double)g.mean_m[3 * i + 1];
        double u = floor((x + half) / SPACING_M), v = floor((half - y) / SPACING_M);
        if (exp((double)g.scale_log[3 * i]) > SPACING_M || u < 0 || v < 0 || u >= n || v >= n)
            continue; /* haze, and what is far away */
        gauss_copy_row(&g, kept, &g, i);
        for (size_t k = 0; k < 3; k++)
            g.sh[3 * kept + k] =
                (float)((img.px[3 * ((size_t)v * n + (size_t)u) + k] / 255.0 - 0.5) / 0.28209479);
        g.opacity_logit[kept++] = 7;
    }
    g.n = kept;
    image_free(&img);
    kit_ok(geo_from_enu(&origin, shift, &moved.lon_deg, &moved.lat_deg, &moved.h_m, &e), e);
    kit_ok(file_join(path, f.dir, name, &e), e);
    const struct pyramid_config cfg = {.tile_edge_m = 30, .name = "painted"};
    const struct pyramid_level level = {.g = &g, .level = 3};
    kit_ok(pyramid_build(&moved, &level, 1, &cfg, NULL, 0, path, NULL, &e), e);
    gauss_free(&g);
}

/* What `citysplat-lab truth` says of an orthophoto of this store, dB. */
static double score(const char *tiles)
{
    struct buf out = {0};
    double psnr_db = 0;
    const char *bin = kit_program(), *at;
    assert_int_equal(kit_run(&out,
                             "cd '%s' && '%s' ortho -q '%s' -o o.tif --gsd-m 0.25 --overwrite && "
                             "'%s-lab' truth . o.tif -o truth.tif -q",
                             f.dir, bin, tiles, bin),
                     0);
    at = strstr((const char *)out.data, "; ");
    at = strstr(at ? at : "", "over ") ? strstr((const char *)out.data, "PSNR ") : NULL;
    assert_non_null(at);
    psnr_db = strtod(at + 5, NULL);
    buf_free(&out);
    return psnr_db;
}

/* Discs in the city's own colours give its picture back; the same a metre off do not. */
static void ortho_is_the_citys_picture(void **state)
{
    struct err e = {0};
    struct buf out = {0};
    char path[FILE_PATH_MAX];
    json_t *config;
    f.cfg.lon_deg = origin.lon_deg;
    f.cfg.lat_deg = origin.lat_deg;
    f.cfg.ground_h_m = origin.h_m;
    kit_ok(options_to_json(synth_options(), &f.cfg, &config, &e), e);
    json_t *root = json_pack("{s:o}", "config", config);
    kit_ok(file_join(path, f.dir, "truth", &e), e);
    kit_ok(file_mkdir(path, &e), e);
    kit_ok(file_join(path, f.dir, "truth/truth.json", &e), e);
    kit_ok(jsonc_write(path, root, &e), e);
    json_decref(root);
    painted_city("painted.tiles", 0, path);
    double there = score(path);
    painted_city("off.tiles", 1, path);
    double off = score(path);
    printf("survey ortho: PSNR %.2f dB against the city, %.2f dB a metre off\n", there, off);
    assert_true(there > 25 && off < there - 5);
    assert_int_equal(
        kit_run(&out, "cd '%s' && '%s-lab' truth . truth/truth.json -q", f.dir, kit_program()), 1);
    kit_expect_text((const char *)out.data, "not a GeoTIFF", __FILE__, __LINE__);
    buf_free(&out);
}

/* A library that was left over from an older installation. */
static void a_library_of_another_version_is_refused(void **state)
{
    struct err e = {0};
    struct library l = {"maps", GDAL_LIBRARY_FILE, GDAL_LIBRARY_SYMBOL, GDAL_LIBRARY_VERSION};
    const void *table;
    kit_ok(library_load(&l, &table, &e), e);
    assert_ptr_equal(table, gdal);
    l.version++;
    assert_int_equal(library_load(&l, &table, &e), ERR_INTERNAL);
    kit_expect_text(e.msg, "another version", __FILE__, __LINE__);
    assert_null(table);
    l.symbol = "no_such_table";
    assert_int_equal(library_load(&l, &table, &e), ERR_INTERNAL);
    kit_expect_text(e.msg, "cannot be loaded", __FILE__, __LINE__);
    l.file = "citysplat-none.so";
    assert_int_equal(library_load(&l, &table, &e), ERR_NOENT);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(heights_are_the_citys),
        cmocka_unit_test(edges_are_measured),
        cmocka_unit_test(roofs_end_where_they_do),
        cmocka_unit_test(colours_lie_where_they_belong),
        cmocka_unit_test(pieces_leave_no_seams),
        cmocka_unit_test(gdal_calls_it_cloud_optimized),
        cmocka_unit_test(far_gaussians_are_no_survey),
        cmocka_unit_test(places_have_heights),
        cmocka_unit_test(other_heights_are_named),
        cmocka_unit_test(changes_are_found),
        cmocka_unit_test(what_lies_askew_is_aligned),
        cmocka_unit_test(ortho_is_the_citys_picture),
        cmocka_unit_test(nonsense_is_refused),
        cmocka_unit_test(the_program_says_the_same),
        cmocka_unit_test(a_library_of_another_version_is_refused),
    };
    return cmocka_run_group_tests_name("survey", tests, survey_setup, survey_teardown);
}
