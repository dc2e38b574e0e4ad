/* Tile keys: known tiles, half-open edges, clamping, and that zooms nest.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/store/key.h"
#include "tests/kit.h"

#include <math.h>

static void assert_near(double got, double want, double tolerance)
{
    kit_near_d("value", &got, &want, 1, tolerance, 0);
}

static void assert_key(struct key k, uint8_t z, uint32_t x, uint32_t y)
{
    if (k.z != z || k.x != x || k.y != y)
        fail_msg("got %u/%u/%u, want %u/%u/%u", k.z, k.x, k.y, z, x, y);
}

/* Places and tiles as OpenStreetMap's slippy-map formula gives them. */
static void known_places(void **state)
{
    assert_key(key_at(0, 0, 0), 0, 0, 0);
    assert_key(key_at(13.3777, 52.5163, 15), 15, 17601, 10746);   /* Brandenburg Gate */
    assert_key(key_at(-122.4783, 37.8199, 12), 12, 654, 1582);    /* Golden Gate */
    assert_key(key_at(151.2153, -33.8568, 16), 16, 60295, 39325); /* Sydney Opera House */
}

static void edges_are_half_open(void **state)
{
    /* The meridian and the equator belong to the east and the south. */
    assert_key(key_at(0, 0, 1), 1, 1, 1);
    assert_key(key_at(nextafter(0, -1) - 1e-12, 1e-9, 1), 1, 0, 0);
    for (uint8_t z = 0; z <= KEY_ZOOM_MAX; z++) {
        struct key k = key_at(13.3777, 52.5163, z);
        double w, s, e, n;
        key_bounds(k, &w, &s, &e, &n);
        double lat = 0.5 * (s + n);
        assert_key(key_at(w, lat, z), z, k.x, k.y); /* west edges are exact in double */
        if (k.x + 1 < (UINT32_C(1) << z))
            assert_key(key_at(e, lat, z), z, k.x + 1, k.y);
    }
}

static void poles_and_antimeridian_are_clamped(void **state)
{
    assert_key(key_at(-180, 90, 4), 4, 0, 0);
    assert_key(key_at(180, -90, 4), 4, 15, 15);
    assert_key(key_at(180, 0, 24), 24, (1u << 24) - 1, 1u << 23);
    assert_key(key_at(-200, 89.9, 3), 3, 0, 0);
    assert_key(key_at(1e9, -1e9, 3), 3, 7, 7);
    assert_true(key_valid(key_at((double)NAN, (double)NAN, 24)));
    assert_int_equal(key_at(0, 0, 99).z, KEY_ZOOM_MAX);
}

static void zooms_nest_and_centres_round_trip(void **state)
{
    for (uint64_t i = 0; i < 2000; i++) {
        double lon = rng_unit(1, 0, i) * 360 - 180, lat = rng_unit(1, 1, i) * 178 - 89;
        struct key fine = key_at(lon, lat, KEY_ZOOM_MAX);
        for (int z = KEY_ZOOM_MAX; z >= 0; z--) {
            struct key k = key_at(lon, lat, (uint8_t)z);
            assert_key(fine, k.z, k.x, k.y);
            double clon, clat, w, s, e, n;
            key_center(k, &clon, &clat);
            assert_key(key_at(clon, clat, (uint8_t)z), k.z, k.x, k.y);
            key_bounds(k, &w, &s, &e, &n);
            assert_true(w < e && s < n && clon > w && clon < e && clat > s && clat < n);
            fine = key_parent(fine);
        }
    }
    assert_key(key_parent((struct key){0}), 0, 0, 0);
}

static void bounds_cover_the_square(void **state)
{
    double w, s, e, n;
    key_bounds((struct key){0}, &w, &s, &e, &n);
    assert_near(w, -180, 0);
    assert_near(e, 180, 0);
    assert_near(n, 85.0511287798066, 1e-10);
    assert_near(s, -85.0511287798066, 1e-10);
}

static void order_is_zoom_row_column(void **state)
{
    const struct key sorted[] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {1, 0, 1}, {2, 0, 0}};
    for (int i = 0; i < 5; i++)
        for (int j = 0; j < 5; j++)
            assert_int_equal(key_compare(sorted[i], sorted[j]), i < j ? -1 : i > j);
    assert_false(key_valid((struct key){3, 8, 0}));
    assert_false(key_valid((struct key){3, 0, 8}));
    assert_false(key_valid((struct key){25, 0, 0}));
    assert_true(key_valid((struct key){3, 7, 7}));
}

static void edge_lengths_and_the_zoom_for_them(void **state)
{
    assert_near(key_edge_m(0, 0), 40075016.685578488, 1e-6);
    assert_near(key_edge_m(60, 1), 40075016.685578488 / 4, 1e-3);
    for (int z = 0; z <= KEY_ZOOM_MAX; z++) {
        assert_int_equal(key_zoom_for(47.5, key_edge_m(47.5, (uint8_t)z)), z);
        assert_int_equal(key_zoom_for(47.5, 1.3 * key_edge_m(47.5, (uint8_t)z)), z);
        assert_int_equal(key_zoom_for(47.5, 0.8 * key_edge_m(47.5, (uint8_t)z)), z);
    }
    assert_int_equal(key_zoom_for(0, 1e12), 0);
    assert_int_equal(key_zoom_for(0, 1e-12), KEY_ZOOM_MAX);
    assert_int_equal(key_zoom_for(0, (double)NAN), 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(known_places),
        cmocka_unit_test(edges_are_half_open),
        cmocka_unit_test(poles_and_antimeridian_are_clamped),
        cmocka_unit_test(zooms_nest_and_centres_round_trip),
        cmocka_unit_test(bounds_cover_the_square),
        cmocka_unit_test(order_is_zoom_row_column),
        cmocka_unit_test(edge_lengths_and_the_zoom_for_them),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
