/* Tiles of a web map, against the procedural city: heights and places in the pixels of
 * WebMercatorQuad, no seams, low zooms, the footprint as the border of the survey, filled holes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/survey/survey_kit.h"

#include <stdlib.h>

#include "lod/surface/raster.h"

enum { SIDE = RASTER_PX };

/* West half of the city and a hole in it; a polygon inside of it, and one that overlaps it and a
 * part of the hole. In degrees about the origin: 1e-4 degrees of longitude are 7.15 m there, of
 * latitude 11.12 m. */
static const char half_city[] =
    "{\"type\":\"Feature\",\"properties\":{},\"geometry\":{\"type\":\"MultiPolygon\","
    "\"coordinates\":"
    "[[[[8.6817,50.1107],[8.6821,50.1107],[8.6821,50.1111],[8.6817,50.1111],[8.6817,50.1107]],"
    "[[8.6819,50.1109],[8.6819,50.1110],[8.6820,50.1110],[8.6820,50.1109],[8.6819,50.1109]]],"
    "[[[8.6820,50.1107],[8.6821,50.1107],[8.6821,50.1108],[8.6820,50.1108],[8.6820,50.1107]]],"
    "[[[8.68195,50.11095],[8.68205,50.11095],[8.68205,50.1111],[8.68195,50.1111],"
    "[8.68195,50.11095]]]]}}";

static int setup_half(void **state)
{
    survey_make(half_city);
    survey_open();
    return 0;
}

struct drawn {
    struct raster_tile tile;
    uint32_t side;
    float *rgb, *height;
    uint8_t *in;
};

static void draw(struct key k, uint32_t size, uint32_t margin, struct drawn *d)
{
    struct err e = {0};
    *d = (struct drawn){.tile = {k, size, margin}};
    d->side = raster_side(&d->tile);
    size_t n = (size_t)d->side * d->side;
    d->rgb = mem_array(3 * n, sizeof(float));
    d->height = mem_array(n, sizeof(float));
    d->in = mem_array(n, 1);
    assert_true(d->rgb && d->height && d->in);
    kit_ok(raster_draw(f.nadir, &d->tile, d->rgb, d->height, d->in, &e), e);
}

static void drop(struct drawn *d)
{
    mem_free(d->rgb);
    mem_free(d->height);
    mem_free(d->in);
}

/* ENU of a pixel's centre, by the formula of the Mercator map and nothing of lod/. */
static void place(const struct drawn *d, uint32_t x, uint32_t y, double lonlat[2], double enu[3])
{
    struct err e = {0};
    double n = pow(2, d->tile.key.z), m = d->tile.margin_px, s = d->tile.size_px;
    double u = (d->tile.key.x + (x + 0.5 - m) / s) / n, v = (d->tile.key.y + (y + 0.5 - m) / s) / n;
    lonlat[0] = 360 * u - 180;
    lonlat[1] = 360 / SURVEY_PI * atan(exp(SURVEY_PI * (1 - 2 * v))) - 90;
    kit_ok(geo_to_enu(&origin, lonlat[0], lonlat[1], origin.h_m, enu, &e), e);
}

static struct key tile_at(uint8_t z)
{
    return key_at(origin.lon_deg + 1e-5, origin.lat_deg + 1e-5, z);
}

/* Colour says where a pixel is (tests/survey/survey_kit.h), height what the rays of the city
 * say. */
static void pixels_lie_where_the_map_has_them(void **state)
{
    for (uint32_t scale = 1; scale <= 2; scale++) {
        struct drawn d;
        uint8_t z = (uint8_t)(raster_zoom_max(nadir_area(f.nadir)) - 2);
        struct shown sum = {0};
        double px_m = 0, off = 0;
        size_t n = 0, flat = 0;
        draw(tile_at(z), SIDE * scale, 0, &d);
        for (uint32_t y = 2; y + 2 < d.side; y++)
            for (uint32_t x = 2; x + 2 < d.side; x++) {
                double at[2], enu[3];
                size_t i = (size_t)y * d.side + x;
                place(&d, x, y, at, enu);
                if (fabs(enu[0]) > 28 || fabs(enu[1]) > 28)
                    continue;
                assert_true(isfinite(d.height[i]) && d.in[i] == 1);
                const float *c = d.rgb + 3 * i;
                shown_add(&sum, (double)c[0], (double)c[1], enu);
                n++;
                if (x % 4 || y % 4)
                    continue;
                if (!level_at(enu[0], enu[1], 0.5))
                    continue;
                flat++;
                off += fabs((double)d.height[i] - origin.h_m - truth_z(enu[0], enu[1])) > 0.5;
            }
        px_m = key_edge_m(origin.lat_deg, z) / d.side;
        printf("raster %u px of %.3f m: shift %.3f east %.3f north px, %zu of %zu heights off\n",
               d.side, px_m, shown_shift(&sum, 0) / px_m, shown_shift(&sum, 1) / px_m, (size_t)off,
               flat);
        assert_true(n > 20000 && flat > 700);
        for (size_t k = 0; k < 2; k++)
            assert_true(fabs(shown_shift(&sum, k)) < 0.05); /* m: a quarter of a pixel */
        assert_true(off <= 0.005 * (double)flat);
        drop(&d);
    }
}

/* Neighbours drawn with a margin say the same of the ground that both show, and the step of colour
 * across their border is the one that a picture of both has there. */
static void neighbours_fit(void **state)
{
    enum { MARGIN = 16 };
    struct drawn a, b;
    uint8_t z = (uint8_t)(raster_zoom_max(nadir_area(f.nadir)) - 1);
    struct key west = tile_at(z), east = west;
    double across = 0, within = 0, color = 0;
    size_t n = 0, differ = 0, both = 0;
    east.x++;
    /* Of the two neighbours the one that has the city on both sides of the border. */
    double w, s, e, north;
    key_bounds(east, &w, &s, &e, &north);
    if (w > nadir_area(f.nadir)->east_deg - 1e-4) {
        east.x--;
        west.x--;
    }
    draw(west, SIDE, MARGIN, &a);
    draw(east, SIDE, MARGIN, &b);
    for (uint32_t y = 0; y < a.side; y++) {
        for (uint32_t x = 0; x < 2 * MARGIN; x++) {
            float p = a.height[(size_t)y * a.side + SIDE + x], q = b.height[(size_t)y * b.side + x];
            assert_int_equal(isfinite(p), isfinite(q));
            both += isfinite(p);
            for (int k = 0; k < 3 && isfinite(p); k++)
                color = fmax(color, fabs((double)a.rgb[3 * ((size_t)y * a.side + SIDE + x) + k] -
                                         (double)b.rgb[3 * ((size_t)y * b.side + x) + k]));
            differ += fabsf(p - q) > 0.05f;
        }
        size_t at = (size_t)y * a.side + MARGIN + SIDE;
        const float *last = a.rgb + 3 * (at - 1), *own = a.rgb + 3 * at,
                    *next = b.rgb + 3 * ((size_t)y * b.side + MARGIN);
        for (int k = 0; k < 2; k++) {
            if (!isfinite(last[k]) || !isfinite(own[k]))
                continue;
            across += fabs((double)next[k] - (double)last[k]);
            within += fabs((double)own[k] - (double)last[k]);
            n++;
        }
    }
    printf(
        "raster seam: %zu of %zu heights differ, colours by %.5f; step across %.5f, within %.5f\n",
        differ, both, color, across / (double)n, within / (double)n);
    assert_true(both > 3000 && n > 100);
    assert_true((double)differ <= 2e-3 * (double)both);
    assert_true(color < 1 / 255.0);
    assert_true(within > 0 && fabs(across - within) < 0.5 / 255 * (double)n);
    drop(&a);
    drop(&b);
}

/* From far away the city is a few pixels, and they lie in the right place. */
static void low_zooms_show_the_city(void **state)
{
    for (uint8_t z = 6; z <= 14; z = (uint8_t)(z + 4)) {
        struct drawn d;
        size_t n = 0;
        draw(tile_at(z), SIDE, 0, &d);
        for (uint32_t y = 0; y < SIDE; y++)
            for (uint32_t x = 0; x < SIDE; x++) {
                double at[2], enu[3], px_m = key_edge_m(origin.lat_deg, z) / SIDE;
                bool in = d.in[(size_t)y * SIDE + x];
                if (!in)
                    continue;
                place(&d, x, y, at, enu);
                assert_true(fabs(enu[0]) < 80 + px_m && fabs(enu[1]) < 80 + px_m);
                n++;
            }
        assert_true(n <= 200 && (z < 14 || n >= 60));
        drop(&d);
    }
    assert_in_range(raster_zoom_min(nadir_area(f.nadir)), 15, 17);
    assert_in_range(raster_zoom_max(nadir_area(f.nadir)), 20, 21);
}

static bool half_holds(double lon, double lat)
{
    bool hole = lon > 8.6819 && lon < 8.6820 && lat > 50.1109 && lat<50.1110, over = lon> 8.68195 &&
                lon < 8.68205 && lat > 50.11095;
    return lon > 8.6817 && lon < 8.6821 && lat > 50.1107 && lat < 50.1111 && (!hole || over);
}

/* A store that knows its footprint is surveyed there and nowhere else. */
static void the_footprint_is_the_border(void **state)
{
    const struct area *a = nadir_area(f.nadir);
    struct drawn d;
    size_t n = 0;
    assert_true(fabs(a->west_deg - 8.6817) < 1e-9 && fabs(a->east_deg - 8.6821) < 1e-9);
    assert_true(fabs(a->south_deg - 50.1107) < 1e-9 && fabs(a->north_deg - 50.1111) < 1e-9);
    draw(key_at(8.68195, 50.11095, 19), SIDE, 0, &d);
    for (uint32_t y = 0; y < SIDE; y++)
        for (uint32_t x = 0; x < SIDE; x++) {
            double at[2], enu[3];
            size_t i = (size_t)y * SIDE + x;
            place(&d, x, y, at, enu);
            bool want = half_holds(at[0], at[1]);
            assert_int_equal(d.in[i], want);
            assert_int_equal(area_holds(a, at[0], at[1]), want);
            if (!want)
                assert_true(isnan(d.height[i]) && isnan(d.rgb[3 * i]));
            n += want;
        }
    assert_in_range(n, 2000, 40000);
    drop(&d);
    struct key far = key_at(8.70, 50.2, 19);
    assert_false(area_touches(a, far));
    assert_true(area_touches(a, key_at(8.6819, 50.1109, 19)));
}

/* One that makes no sense is no footprint. */
static void nonsense_is_no_footprint(void **state)
{
    static const char *const texts[] = {
        "[]", "{\"geometry\":{\"type\":\"MultiPolygon\",\"coordinates\":[]}}",
        "{\"geometry\":{\"type\":\"MultiPolygon\",\"coordinates\":[[[[8,50],[9,50],[8,50]]]]}}",
        "{\"geometry\":{\"type\":\"MultiPolygon\",\"coordinates\":[[[[8,50],[9,\"x\"],[9,51],[8,50]"
        "]]]}}",
        "{\"geometry\":{\"type\":\"MultiPolygon\",\"coordinates\":[[[[8,500],[9,50],[9,51],[8,50]]]"
        "]}}"};
    log_set_level(LOG_ERROR);
    for (size_t i = 0; i < sizeof texts / sizeof *texts; i++) {
        struct err e = {0};
        struct store *s = NULL;
        struct area a;
        survey_make(texts[i]);
        kit_ok(store_open(f.path, &s, &e), e);
        kit_ok(area_make(s, &a, &e), e);
        assert_null(a.edges);
        assert_true(area_holds(&a, origin.lon_deg, origin.lat_deg) && a.west_deg < a.east_deg);
        area_free(&a);
        store_close(&s);
        survey_drop();
    }
}

/* Stores that others wrote. */
static void a_store_of_no_size_has_no_maps(void **state)
{
    struct err e = {0};
    struct store *s = NULL;
    struct area a;
    struct gauss g;
    struct buf payload = {0};
    struct store_entry t = {
        .tile = {.key = key_at(origin.lon_deg, origin.lat_deg, 18), .level = 3}};
    const struct store_meta meta = {.name = "none", .origin = origin};
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    kit_tmpdir(dir);
    kit_ok(file_join(path, dir, "none.tiles", &e), e);
    kit_gauss(3, 20, 5, 0, 0, &g);
    kit_ok(store_create(path, &meta, &s, &e), e);
    kit_ok(store_encode(s, &t, &g, &payload, &e), e);
    t.shape.sigma_median_m = 0;
    kit_ok(store_add(s, &t, &payload, &e), e);
    kit_ok(store_commit(&s, &e), e);
    kit_ok(store_open(path, &s, &e), e);
    kit_fails(area_make(s, &a, &e), ERR_DATA, e, "median size of 0 m");
    store_close(&s);
    buf_free(&payload);
    gauss_free(&g);
    kit_rmdir(dir);
}

/* Holes get what is around them, and far from everything there is the base. */
static void holes_are_filled(void **state)
{
    enum { N = 40, REACH = 5 };
    float h[N * N], filled[N * N];
    for (size_t i = 0; i < N * N; i++)
        h[i] = i % N < 20 ? 10 + (float)(i / N) : NAN; /* a slope; nothing east of 20 */
    for (size_t y = 18; y < 21; y++)
        for (size_t x = 8; x < 11; x++)
            h[y * N + x] = NAN;
    raster_fill(h, N, REACH, -7, filled);
    for (size_t i = 0; i < N * N; i++) {
        size_t x = i % N, y = i / N;
        if (isfinite(h[i]))
            assert_true(filled[i] == h[i]);
        else if (x < 20)
            assert_true(fabsf(filled[i] - (10 + (float)y)) < 0.7f);
        else if (x >= 20 + REACH)
            assert_true(filled[i] == -7);
        else
            assert_true(filled[i] > 0);
    }
    assert_true(fabsf(filled[19 * N + 9] - 29) < 1e-4f); /* the middle of the hole */
}

static void sizes_are_limited(void **state)
{
    struct err e = {0};
    uint8_t in[1];
    const struct raster_tile wide = {tile_at(19), RASTER_SIDE_MAX, 1}, none = {tile_at(19), 0, 0};
    kit_fails(raster_draw(f.nadir, &wide, NULL, NULL, in, &e), ERR_ARG, e, "at most");
    kit_fails(raster_draw(f.nadir, &none, NULL, NULL, in, &e), ERR_ARG, e, "at most");
}

/* A slope with a house, a hole and an end: the house is gone, the hole is ground, the end has no
 * cliff, and a window that is shifted has the same heights where its margin is. */
static void bare_ground_has_no_houses_and_no_cliffs(void **state)
{
    enum { N = 120, RADIUS = 10, SHIFT = 7, END = 90 };
    const float slope = 0.05f, base = -4, house = 15, step_most = 1.0f;
    struct err e = {0};
    float *h = mem_array((size_t)N * (N + SHIFT), sizeof *h), *one = mem_array(N * N, sizeof *one),
          *two = mem_array(N * N, sizeof *two), *window = mem_array(N * N, sizeof *window);
    for (int y = 0; y < N; y++)
        for (int x = 0; x < N + SHIFT; x++) {
            const bool in_house = x >= 30 && x < 46 && y >= 40 && y < 56;
            const bool in_hole = x >= 60 && x < 66 && y >= 60 && y < 66;
            h[y * (N + SHIFT) + x] =
                x >= END || in_hole ? NAN : slope * (float)x + (in_house ? house : 0);
        }
    for (int k = 0; k < 2; k++) {
        for (int y = 0; y < N; y++)
            memcpy(window + y * N, h + y * (N + SHIFT) + k * SHIFT, N * sizeof *window);
        kit_ok(raster_ground(window, N, RADIUS, base, k ? two : one, &e), e);
    }
    const int margin = (int)raster_ground_margin(RADIUS);
    for (int y = margin; y < N - margin; y++) {
        for (int x = 1; x < N; x++) {
            const float v = one[y * N + x];
            if (x >= margin && x < END - margin)
                assert_true(fabsf(v - slope * (float)x) < slope * 2 * RADIUS);
            assert_true(fabsf(v - one[y * N + x - 1]) < step_most);
            if (x >= margin + SHIFT && x < N - margin)
                assert_true(v == two[y * N + x - SHIFT]);
        }
        assert_true(fabsf(one[y * N + N - 1] - base) < 1e-4f); /* more than two radii away */
    }
    mem_free(h);
    mem_free(one);
    mem_free(two);
    mem_free(window);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(bare_ground_has_no_houses_and_no_cliffs),
        cmocka_unit_test(pixels_lie_where_the_map_has_them),
        cmocka_unit_test(neighbours_fit),
        cmocka_unit_test(low_zooms_show_the_city),
        cmocka_unit_test(sizes_are_limited),
        cmocka_unit_test(a_store_of_no_size_has_no_maps),
        cmocka_unit_test(holes_are_filled),
    };
    const struct CMUnitTest half[] = {cmocka_unit_test(the_footprint_is_the_border)};
    const struct CMUnitTest alone[] = {cmocka_unit_test(nonsense_is_no_footprint)};
    int failed = cmocka_run_group_tests_name("raster", tests, survey_setup, survey_teardown);
    failed += cmocka_run_group_tests_name("raster_footprint", half, setup_half, survey_teardown);
    return failed + cmocka_run_group_tests_name("raster_nonsense", alone, NULL, NULL);
}
