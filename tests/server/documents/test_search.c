/* Search for appearances by place, time, hour and colour: against a plain loop over the store's
 * content, pages, and invalid queries.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/lit.h"
#include "tests/server/routed.h"

#include <math.h>
#include <stdlib.h>
#include <time.h>

#include "lod/store/photograph.h"
#include "server/documents/search.h"
#include "server/route/param_time.h"

enum { PHOTOS = 60, LEN = 4, IMAGE = 8, BARE = 7 /* of this nothing is known but its embedding */ };
static struct photo {
    char name[40], time[20];
    double lon, lat;
} photo[PHOTOS];

static void photo_make(size_t i)
{
    struct photo *p = &photo[i];
    snprintf(p->name, sizeof p->name, i == 3 ? "roof 50%%&=+.jpg" : "p%02zu.jpg", i);
    snprintf(p->time, sizeof p->time, "2024-%02d-%02dT%02d:%02d:00", 1 + (int)(i % 12),
             1 + (int)(i * 7 % 28), (int)(i * 5 % 24), (int)(i % 60));
    if (i == 11)
        snprintf(p->time, sizeof p->time, "%s", "yesterday \"noon\"");
    p->lon = round((13.4 + 0.002 * (rng_unit(9, 0, i) - 0.5)) * 1e8) / 1e8;
    p->lat = round((52.5 + 0.002 * (rng_unit(9, 1, i) - 0.5)) * 1e8) / 1e8;
}

static void photo_put(struct store *s, size_t i)
{
    struct err e = {0};
    struct buf about = {0};
    char blob[PHOTOGRAPH_NAME_MAX];
    kit_ok(photograph_blob(PHOTOGRAPH_BLOB, photo[i].name, blob, &e), e);
    buf_printf(&about,
               "{\"time\":\"%s\",\"lon\":%.8f,\"lat\":%.8f,\"h\":90,\"heading\":0,\"pitch\":-45,"
               "\"fov\":50,\"thumbnail\":%s}",
               i == 11 ? "yesterday" : photo[i].time, photo[i].lon, photo[i].lat,
               i % 2 ? "true" : "false");
    kit_ok(store_put_blob(s, blob, about.data, about.size, &e), e);
    buf_free(&about);
}

static void photos_put(struct store *s)
{
    for (size_t i = 0; i < PHOTOS; i++)
        if (i != BARE)
            photo_put(s, i);
}

static void light_city(const char *path)
{
    struct err e = {0};
    struct appearance photos, model;
    kit_ok(appearance_alloc(&photos, LEN, IMAGE, 8, PHOTOS, &e), e);
    appearance_init(&photos, 5);
    for (size_t i = 0; i < PHOTOS; i++) {
        photo_make(i);
        memcpy(photos.names[i], photo[i].name, sizeof photo[i].name);
    }
    lit_city(path, "lit", &photos, photos_put, &model);
    appearance_free(&photos);
    appearance_free(&model);
}

static int setup_lit(void **state)
{
    struct err e = {0};
    char path[FILE_PATH_MAX];
    if (setup(state))
        return 1;
    kit_ok(file_join(path, t.dir, "lit.tiles", &e), e);
    light_city(path);
    catalog_drop(&t.s.catalog);
    const char *paths[] = {t.path, path};
    t.s.catalog = served_catalog(paths, 2, &served_stores, NULL);
    return 0;
}

/* ---- answers ---- */

static json_t *found(const char *query)
{
    char target[400];
    snprintf(target, sizeof target, "/d/lit/appearances?%s", query);
    struct response r = get(target);
    if (r.status != 200)
        fail_msg("%s: %d %.*s", target, r.status, (int)r.size, (const char *)r.data);
    expect("type", r.type, "application/json");
    expect("Cache-Control", r.cache_control, MOVING);
    json_t *o = json_of(&r);
    response_free(&r);
    assert_int_equal(json_integer_value(json_object_get(o, "numberReturned")),
                     json_array_size(json_object_get(o, "appearances")));
    return o;
}

static double number(const json_t *o, const char *key)
{
    return json_number_value(json_object_get(o, key));
}

/* The photographs that `wanted` holds for are those that were found, in the order of `by`. */
static void check(const char *query, bool (*wanted)(const struct photo *p), const char *by)
{
    json_t *o = found(query), *list = json_object_get(o, "appearances"), *row;
    bool seen[PHOTOS] = {false};
    size_t k, n = 0;
    double last = -HUGE_VAL;
    json_array_foreach(list, k, row)
    {
        const size_t at = (size_t)number(row, "number");
        assert_true(at < PHOTOS && !seen[at]);
        seen[at] = true;
        expect("name", json_string_value(json_object_get(row, "name")), photo[at].name);
        if (by) {
            assert_true(number(row, by) >= last);
            last = number(row, by);
        }
    }
    for (size_t i = 0; i < PHOTOS; i++) {
        bool want = i != BARE && wanted(&photo[i]);
        n += want;
        if (want != seen[i])
            fail_msg("%s: %s is %s", query, photo[i].name, seen[i] ? "found" : "missing");
    }
    assert_int_equal(json_integer_value(json_object_get(o, "numberMatched")), n);
    assert_true(n > 2 && n < PHOTOS - 2);
    json_decref(o);
}

static bool in_bbox(const struct photo *p)
{
    return p->lon >= 13.3996 && p->lon <= 13.4006 && p->lat >= 52.4995 && p->lat <= 52.5007;
}

/* On a sphere with the ellipsoid's radii at 52.5 degrees: within a millimetre over 100 m. */
static double far_m(const struct photo *p)
{
    const double rad = 0.017453292519943295;
    return hypot((p->lat - 52.5) * rad * 6375692.886, (p->lon - 13.4) * rad * 3890969.761);
}

static bool in_circle(const struct photo *p)
{
    return far_m(p) <= 70;
}

static bool in_spring(const struct photo *p)
{
    return strcmp(p->time, "2024-03-08T00:00:00") >= 0 &&
           strcmp(p->time, "2024-05-31T23:59:59") <= 0;
}

static bool at_night(const struct photo *p)
{
    int hour = atoi(p->time + 11);
    return p->time[0] == '2' && (hour >= 22 || hour < 4);
}

static bool late(const struct photo *p)
{
    return p->time[0] == '2' && strcmp(p->time, "2024-11-01") >= 0;
}

static void test_places_and_times(void **state)
{
    (void)state;
    check("bbox=13.3996,52.4995,13.4006,52.5007", in_bbox, "number");
    check("bbox=13.3996%2C52.4995%2c13.4006,52.5007&sort=number", in_bbox, "number");
    check("near=13.4,52.5,70", in_circle, "distance_m");
    check("datetime=2024-03-08/2024-05-31", in_spring, NULL);
    check("datetime=2024-03-08T00%3A00:00Z%2F2024-05-31t23:59:59.999z&sort=time", in_spring, NULL);
    check("datetime=2024-11-01/..", late, NULL);
    check("datetime=2024-11-01/", late, NULL);
    check("hours=22-4", at_night, NULL);
    json_t *o = found("near=13.4,52.5&limit=1000"), *list = json_object_get(o, "appearances"), *row;
    size_t k;
    assert_int_equal(json_array_size(list), PHOTOS - 1);
    json_array_foreach(list, k, row)
    {
        const struct photo *p = &photo[(size_t)number(row, "number")];
        assert_true(fabs(number(row, "distance_m") - far_m(p)) < 0.01);
        assert_true(fabs(number(row, "lon") - p->lon) < 1e-9);
        if (json_object_get(row, "time"))
            expect("time", json_string_value(json_object_get(row, "time")), p->time);
        else
            assert_ptr_equal(p, &photo[11]);
    }
    json_decref(o);
    /* exactly one second, both ends of it counted; the other side of the world; nobody */
    char query[80];
    snprintf(query, sizeof query, "datetime=%s", photo[20].time);
    o = found(query);
    assert_int_equal(number(o, "numberMatched"), 1);
    json_decref(o);
    o = found("near=-166.6,-52.5,1000000");
    assert_int_equal(number(o, "numberMatched"), 0);
    json_decref(o);
    o = found("bbox=179,-90,-179,90");
    assert_int_equal(number(o, "numberMatched"), 0);
    json_decref(o);
    o = found("bbox=13,-90,-179,90"); /* over the antimeridian */
    assert_int_equal(number(o, "numberMatched"), PHOTOS - 1);
    json_decref(o);
}

/* ---- colours ---- */

/* CIE Lab as textbooks have it, with the slope of 7.787. */
static void lab_of(long rgb, double lab[3])
{
    double v[3], f[3];
    for (int i = 0; i < 3; i++) {
        v[i] = (double)(rgb >> (16 - 8 * i) & 255) / 255;
        v[i] = v[i] > 0.04045 ? pow((v[i] + 0.055) / 1.055, 2.4) : v[i] / 12.92;
    }
    f[0] = (0.4124 * v[0] + 0.3576 * v[1] + 0.1805 * v[2]) / 0.9505;
    f[1] = 0.2126 * v[0] + 0.7152 * v[1] + 0.0722 * v[2];
    f[2] = (0.0193 * v[0] + 0.1192 * v[1] + 0.9505 * v[2]) / 1.089;
    for (int i = 0; i < 3; i++)
        f[i] = f[i] > 0.008856 ? pow(f[i], 1.0 / 3) : 7.787 * f[i] + 16.0 / 116;
    lab[0] = 116 * f[1] - 16;
    lab[1] = 500 * (f[0] - f[1]);
    lab[2] = 200 * (f[1] - f[2]);
}

static void test_colours(void **state)
{
    json_t *o = found("colour=808080&limit=1000"), *list = json_object_get(o, "appearances"), *row;
    size_t k;
    double last = 0;
    char first[8], query[40];
    (void)state;
    assert_int_equal(json_array_size(list), PHOTOS);
    json_array_foreach(list, k, row)
    {
        const char *hex = json_string_value(json_object_get(row, "colour"));
        assert_true(number(row, "colour_distance") >= last && strlen(hex) == 6);
        last = number(row, "colour_distance");
        /* what the network makes of mid grey */
        struct err e = {0};
        struct gauss g = {0};
        struct dataset *d = catalog_find(t.s.catalog, "lit", "");
        const struct appearance *a = d->appearance;
        double sum[3] = {0};
        kit_ok(store_read_gauss(d->stores[0], served_key(17), &g, &e), e);
        ptrdiff_t at = appearance_find(a, json_string_value(json_object_get(row, "name")));
        for (size_t i = 0; i < 8; i++) {
            double y[APPEARANCE_OUT];
            appearance_eval(a, g.embed + (i * g.n / 8) * LEN, a->images + at * IMAGE, y);
            for (int c = 0; c < 3; c++)
                sum[c] += fmin(1, fmax(0, 0.5 + 2 * y[c] - 1)) / 8;
        }
        long rgb = strtol(hex, NULL, 16);
        for (int c = 0; c < 3; c++)
            assert_true(fabs((double)(rgb >> (16 - 8 * c) & 255) - 255 * sum[c]) <= 0.501);
        gauss_free(&g);
    }
    snprintf(first, sizeof first, "%s",
             json_string_value(json_object_get(json_array_get(list, 40), "colour")));
    json_decref(o);
    snprintf(query, sizeof query, "colour=%s&limit=1", first);
    o = found(query);
    row = json_array_get(json_object_get(o, "appearances"), 0);
    expect("colour", json_string_value(json_object_get(row, "colour")), first);
    assert_true(number(row, "colour_distance") == 0);
    json_decref(o);
    o = found("colour=ff0000&limit=1000"); /* 53.2408, 80.0925, 67.2032 */
    json_array_foreach(json_object_get(o, "appearances"), k, row)
    {
        double lab[3];
        lab_of(strtol(json_string_value(json_object_get(row, "colour")), NULL, 16), lab);
        assert_true(fabs(number(row, "colour_distance") -
                         sqrt(pow(lab[0] - 53.2408, 2) + pow(lab[1] - 80.0925, 2) +
                              pow(lab[2] - 67.2032, 2))) < 0.1);
    }
    json_decref(o);
}

/* ---- pages, links, refusals ---- */

static void test_pages(void **state)
{
    char names[PHOTOS][48], target[500] = "/d/lit/appearances?near=13.4,52.5,90&limit=7&hours=3-22";
    size_t n = 0, pages = 0;
    (void)state;
    for (;; pages++) {
        struct response r = get(target);
        assert_int_equal(r.status, 200);
        json_t *o = json_of(&r), *row;
        const char *next = NULL;
        size_t k;
        json_array_foreach(json_object_get(o, "appearances"), k, row)
            snprintf(names[n++], 48, "%s", json_string_value(json_object_get(row, "name")));
        json_array_foreach(json_object_get(o, "links"), k, row)
        {
            const char *href = json_string_value(json_object_get(row, "href"));
            if (!strcmp(json_string_value(json_object_get(row, "rel")), "next"))
                next = href;
            snprintf(target, sizeof target, "/d/lit/%s", href);
            struct response linked = get(target);
            assert_int_equal(linked.status, 200);
            response_free(&linked);
        }
        if (next)
            snprintf(target, sizeof target, "/d/lit/%s", next);
        json_decref(o);
        response_free(&r);
        if (!next)
            break;
    }
    json_t *all = found("near=13.4,52.5,90&hours=3-22"), *row;
    size_t k;
    assert_true(pages > 2);
    assert_int_equal(number(all, "numberMatched"), n);
    json_array_foreach(json_object_get(all, "appearances"), k, row)
        expect("name", names[k], json_string_value(json_object_get(row, "name")));
    json_decref(all);
}

/* Links of a row lead to what they say; the same question is one thing in the cache. */
static void test_links_of_a_row(void **state)
{
    (void)state;
    json_t *o = found("datetime=2024-04-01/2024-04-30&limit=1000"), *row, *link;
    size_t k, i, thumbnails = 0;
    json_array_foreach(json_object_get(o, "appearances"), k, row)
    {
        char target[300];
        json_array_foreach(json_object_get(row, "links"), i, link)
        {
            snprintf(target, sizeof target, "/d/lit/%s",
                     json_string_value(json_object_get(link, "href")));
            struct response r = get(target);
            assert_int_equal(r.status, 200);
            response_free(&r);
        }
        thumbnails += json_object_get(row, "thumbnail") != NULL;
    }
    assert_true(thumbnails == 0 ||
                thumbnails == json_array_size(json_object_get(o, "appearances")));
    json_decref(o);
    struct response a = get("/d/lit/appearances?hours=3-9&near=13.4,52.50");
    struct response b = get("/d/lit/appearances?near=13.40,52.5&hours=3-9&sort=distance");
    expect("cache", b.cache, "hit");
    expect("ETag", b.etag, a.etag);
    response_free(&a);
    response_free(&b);
    a = get("/d/lit/appearances"); /* the list as ever */
    assert_true(says(&a, "\"embeddingLength\""));
    response_free(&a);
    a = get("/d/toy/appearances?hours=3-9");
    assert_int_equal(a.status, 404);
    response_free(&a);
}

static void test_refused(void **state)
{
    static const struct {
        const char *query;
        int status;
    } rows[] = {
        {"colour=12345", 400},
        {"colour=sky", 400},
        {"colour=1234567", 400},
        {"near=1", 400},
        {"near=1,2,x", 400},
        {"near=1,2,3,4", 400},
        {"near=nan,2", 400},
        {"near=1,91", 422},
        {"near=1,2,0", 422},
        {"near=1,2,-5", 422},
        {"near=1,2,999999999", 422},
        {"bbox=1,2,3", 400},
        {"bbox=1,2,3,4,5,6", 400},
        {"bbox=1,5,3,4", 422},
        {"bbox=1,2,3,400", 422},
        {"hours=5", 400},
        {"hours=5-5", 422},
        {"hours=24-5", 422},
        {"hours=05-7", 400},
        {"hours=5-25", 422},
        {"datetime=", 400},
        {"datetime=/x", 400},
        {"datetime=2024", 400},
        {"datetime=2024-13-01", 400},
        {"datetime=2023-02-29", 400},
        {"datetime=2024-06-01T10:00:00+02:00", 400},
        {"datetime=2024-06-01T25:00:00Z", 400},
        {"datetime=2024-06-01T10:00:00.Z", 400},
        {"datetime=2024-06-02/2024-06-01", 422},
        {"datetime=2024-06-01/2024-06-02/..", 400},
        {"sort=name", 400},
        {"sort=distance", 400},
        {"sort=colour&near=1,2", 400},
        {"limit=0", 400},
        {"limit=1001", 400},
        {"limit=-1", 400},
        {"after=1e3", 400},
        {"place=1,2", 400},
        {"near=1,2&near=1,2", 400},
        {"&", 400},
        {"hours=3-4&x", 400},
        {"appearance=p01.jpg", 400},
    };
    (void)state;
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        char target[200];
        snprintf(target, sizeof target, "/d/lit/appearances?%s", rows[i].query);
        struct response r = get(target);
        if (r.status != rows[i].status)
            fail_msg("%s: %d, want %d: %.*s", target, r.status, rows[i].status, (int)r.size,
                     (const char *)r.data);
        response_free(&r);
    }
}

/* Dates against the C library's. */
static void test_dates(void **state)
{
    (void)state;
    for (int64_t day = -200000; day < 2932897; day += 97) {
        time_t s = (time_t)(day * 86400 + day % 86400 * (day > 0));
        struct tm tm;
        char text[40];
        int64_t got, end;
        if (!gmtime_r(&s, &tm) || tm.tm_year + 1900 > 9999)
            continue;
        strftime(text, sizeof text, "%Y-%m-%dT%H:%M:%SZ", &tm);
        assert_true(param_time_read(text, strlen(text), &got, &end));
        assert_true(got == (int64_t)s && end == got);
        struct buf again = {0};
        param_time_write(got, &again);
        assert_string_equal((char *)again.data, text);
        buf_free(&again);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_places_and_times),
        cmocka_unit_test(test_colours),
        cmocka_unit_test(test_pages),
        cmocka_unit_test(test_links_of_a_row),
        cmocka_unit_test(test_refused),
        cmocka_unit_test(test_dates),
    };
    return cmocka_run_group_tests(tests, setup_lit, teardown);
}
