/* Geodesy against closed forms on the WGS 84 ellipsoid, and its errors.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>

#include "core/base.h"
#include "core/geo/geo.h"
#include "tests/kit.h"

static const double tol_m = 1e-8;    /* double at the earth's radius: eps * 6.4e6 m = 1.4e-9 m */
static const double tol_deg = 1e-13; /* 1e-8 m over 1.1e5 m per degree */
static const double wgs_a = 6378137.0, wgs_f = 1 / 298.257223563;

static void ecef(double lon_deg, double lat_deg, double h, double out[3])
{
    double e2 = wgs_f * (2 - wgs_f), lon = lon_deg * M_PI / 180, lat = lat_deg * M_PI / 180;
    double nv = wgs_a / sqrt(1 - e2 * sin(lat) * sin(lat));
    out[0] = (nv + h) * cos(lat) * cos(lon);
    out[1] = (nv + h) * cos(lat) * sin(lon);
    out[2] = (nv * (1 - e2) + h) * sin(lat);
}

static void test_enu_by_formula(void **state)
{
    struct err e = {0};
    for (uint64_t i = 0; i < 200; i++) {
        struct geo_origin o = {rng_unit(2, i, 0) * 360 - 180, rng_unit(2, i, 1) * 178 - 89,
                               rng_unit(2, i, 2) * 3000};
        double lon = o.lon_deg + rng_normal(2, i, 3) * 0.05,
               lat = o.lat_deg + rng_normal(2, i, 4) * 0.01;
        double h = o.h_m + rng_normal(2, i, 5) * 100, a[3], b[3], got[3], want[3], m[16];
        ecef(o.lon_deg, o.lat_deg, o.h_m, a);
        ecef(lon, lat, h, b);
        double l = o.lon_deg * M_PI / 180, p = o.lat_deg * M_PI / 180;
        const double axes[9] = {-sin(l),          cos(l),           0,
                                -sin(p) * cos(l), -sin(p) * sin(l), cos(p),
                                cos(p) * cos(l),  cos(p) * sin(l),  sin(p)};
        for (int k = 0; k < 3; k++)
            want[k] = axes[3 * k] * (b[0] - a[0]) + axes[3 * k + 1] * (b[1] - a[1]) +
                      axes[3 * k + 2] * (b[2] - a[2]);
        kit_ok(geo_to_enu(&o, lon, lat, h, got, &e), e);
        kit_near_d("enu", got, want, 3, tol_m, 0);
        /* The matrix takes it back to ECEF. */
        kit_ok(geo_enu_to_ecef(&o, m, &e), e);
        double back[3];
        for (int k = 0; k < 3; k++)
            back[k] = m[k] * got[0] + m[4 + k] * got[1] + m[8 + k] * got[2] + m[12 + k];
        kit_near_d("ecef", back, b, 3, tol_m, 0);
        double lon2, lat2, h2;
        kit_ok(geo_from_enu(&o, got, &lon2, &lat2, &h2, &e), e);
        const double place[2] = {remainder(lon2 - lon, 360) * cos(lat * M_PI / 180), lat2 - lat};
        kit_near_d("place", place, (const double[2]){0, 0}, 2, tol_deg, 0);
        assert_true(fabs(h2 - h) < tol_m);
    }
}

static void test_local_axes(void **state)
{
    struct err e = {0};
    struct geo_origin o = {7.5, 47.5, 300};
    double rot[9], up[3], base[3];
    kit_ok(geo_local_axes(&o, o.lon_deg, o.lat_deg, rot, &e), e);
    kit_near_d("at the origin", rot, (const double[9]){1, 0, 0, 0, 1, 0, 0, 0, 1}, 9, 1e-14, 0);
    kit_ok(geo_local_axes(&o, 7.9, 47.8, rot, &e), e);
    kit_ok(geo_to_enu(&o, 7.9, 47.8, 100, base, &e), e);
    kit_ok(geo_to_enu(&o, 7.9, 47.8, 101, up, &e), e);
    for (int k = 0; k < 3; k++)
        up[k] -= base[k];
    const double column[3] = {rot[2], rot[5], rot[8]};
    kit_near_d("up", column, up, 3, 1e-8, 0);
}

static void test_errors(void **state)
{
    struct err e = {0};
    struct geo_origin o = {7.5, 47.5, 300}, bad = {0, 91, 0}, nan = {(double)NAN, 0, 0};
    double out[3], lon, lat, h, m[16];
    kit_fails(geo_to_enu(&o, 7, 90.5, 0, out, &e), ERR_ARG, e, "latitude");
    kit_fails(geo_to_enu(&o, (double)INFINITY, 9, 0, out, &e), ERR_ARG, e, "not a number");
    kit_fails(geo_to_enu(&bad, 7, 9, 0, out, &e), ERR_ARG, e, "latitude");
    kit_fails(geo_enu_to_ecef(&nan, m, &e), ERR_ARG, e, "not a number");
    const double enu[3] = {0, (double)NAN, 0};
    kit_fails(geo_from_enu(&o, enu, &lon, &lat, &h, &e), ERR_ARG, e, "ENU");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_enu_by_formula),
        cmocka_unit_test(test_local_axes),
        cmocka_unit_test(test_errors),
    };
    return cmocka_run_group_tests_name("geo", tests, NULL, NULL);
}
