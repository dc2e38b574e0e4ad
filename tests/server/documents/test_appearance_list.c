/* The list of appearances: against the content of the store.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/lit.h"
#include "tests/server/routed.h"

#include <math.h>
#include <stdlib.h>

#include "lod/store/photograph.h"

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

static json_t *list_of(const char *target)
{
    struct response r = get(target);
    if (r.status != 200)
        fail_msg("%s: %d %.*s", target, r.status, (int)r.size, (const char *)r.data);
    expect("type", r.type, "application/json");
    expect("Cache-Control", r.cache_control, MOVING);
    json_t *o = json_of(&r);
    response_free(&r);
    return o;
}

static double number(const json_t *o, const char *key)
{
    return json_number_value(json_object_get(o, key));
}

/* All photographs in their order, then the default; place and time as far as they are known. */
static void test_places_and_times(void **state)
{
    json_t *o = list_of("/d/lit/appearances"), *list = json_object_get(o, "appearances"), *row;
    size_t k;
    assert_int_equal(json_array_size(list), PHOTOS + 1);
    assert_int_equal(number(o, "numberMatched"), PHOTOS + 1);
    assert_int_equal(number(o, "numberReturned"), PHOTOS + 1);
    assert_int_equal(number(o, "embeddingLength"), IMAGE);
    json_array_foreach(list, k, row)
    {
        const char *name = json_string_value(json_object_get(row, "name"));
        const struct photo *p = &photo[k % PHOTOS];
        const bool is_photo = k < PHOTOS, known = is_photo && k != BARE;
        expect("name", name, is_photo ? p->name : json_string_value(json_object_get(o, "default")));
        assert_int_equal(json_object_get(row, "number") != NULL, is_photo);
        assert_true(!is_photo || number(row, "number") == (double)k);
        assert_int_equal(json_object_get(row, "lon") != NULL, known);
        assert_int_equal(json_object_get(row, "time") != NULL, known && k != 11);
        assert_int_equal(json_object_get(row, "thumbnail") != NULL, known && k % 2);
        if (known)
            assert_true(fabs(number(row, "lon") - p->lon) < 1e-9 &&
                        fabs(number(row, "lat") - p->lat) < 1e-9);
        if (json_object_get(row, "time"))
            expect("time", json_string_value(json_object_get(row, "time")), p->time);
    }
    json_decref(o);
}

/* What the network makes of mid grey. */
static void test_colours(void **state)
{
    json_t *o = list_of("/d/lit/appearances"), *row;
    struct err e = {0};
    struct gauss g = {0};
    struct dataset *d = catalog_find(t.s.catalog, "lit", "");
    const struct appearance *a = d->appearance;
    size_t k;
    kit_ok(store_read_gauss(d->stores[0], served_key(17), &g, &e), e);
    json_array_foreach(json_object_get(o, "appearances"), k, row)
    {
        const char *hex = json_string_value(json_object_get(row, "colour"));
        ptrdiff_t at = appearance_find(a, json_string_value(json_object_get(row, "name")));
        double sum[3] = {0};
        assert_int_equal(strlen(hex), 6);
        for (size_t i = 0; i < 8; i++) {
            double y[APPEARANCE_OUT];
            appearance_eval(a, g.embed + (i * g.n / 8) * LEN, a->images + at * IMAGE, y);
            for (int c = 0; c < 3; c++)
                sum[c] += fmin(1, fmax(0, 0.5 + 2 * y[c] - 1)) / 8;
        }
        long rgb = strtol(hex, NULL, 16);
        for (int c = 0; c < 3; c++)
            assert_true(fabs((double)(rgb >> (16 - 8 * c) & 255) - 255 * sum[c]) <= 0.501);
    }
    gauss_free(&g);
    json_decref(o);
}

/* Links of the list and of its rows lead to what they say. */
static void test_links(void **state)
{
    json_t *o = list_of("/d/lit/appearances"), *row, *link;
    size_t k, i;
    char target[300];
    json_array_foreach(json_object_get(o, "appearances"), k, row)
        json_array_foreach(json_object_get(row, "links"), i, link)
    {
        snprintf(target, sizeof target, "/d/lit/%s",
                 json_string_value(json_object_get(link, "href")));
        struct response r = get(target);
        assert_int_equal(r.status, 200);
        response_free(&r);
    }
    link = json_array_get(json_object_get(o, "links"), 0);
    expect("rel", json_string_value(json_object_get(link, "rel")), "self");
    snprintf(target, sizeof target, "/d/lit/%s", json_string_value(json_object_get(link, "href")));
    json_t *again = list_of(target);
    assert_true(json_equal(o, again));
    json_decref(again);
    json_decref(o);
}

/* A city without appearance has none. */
static void test_none(void **state)
{
    json_t *o = list_of("/d/toy/appearances");
    assert_int_equal(json_array_size(json_object_get(o, "appearances")), 0);
    expect("default", json_string_value(json_object_get(o, "default")), "");
    json_decref(o);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_places_and_times),
        cmocka_unit_test(test_colours),
        cmocka_unit_test(test_links),
        cmocka_unit_test(test_none),
    };
    return cmocka_run_group_tests(tests, setup_lit, teardown);
}
