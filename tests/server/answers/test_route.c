/* Routes as pure calls: documents, links, redirects, refusals, how jobs end, header by header. No
 * socket is opened; jobs are run by the test itself. What browsers get: test_pages.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answers/answer_view.h"
#include "server/answers/metrics_text.h"
#include "server/answers/origin.h"
#include "server/base/condition.h"
#include "tests/server/routed.h"

static void test_documents(void **state)
{
    static const struct {
        const char *target, *type, *cache_control;
    } rows[] = {
        {"/", "application/json", MOVING},
        {"/conformance", "application/json", MOVING},
        {"/api", "application/vnd.oai.openapi+json;version=3.0", MOVING},
        {"/collections", "application/json", MOVING},
        {"/collections/toy", "application/json", MOVING},
        {"/collections/toy/tiles.json", "application/json", MOVING},
        {"/d/toy/tileset.json", "application/json", MOVING},
        {"/d/toy/r/REV+/tileset.json", "application/json", IMMUTABLE},
        {"/d/toy/r/REV/tileset.json", "application/json", MOVING},
        {"/healthz", "application/json", "no-store"},
        {"/readyz", "application/json", "no-store"},
        {"/version", "application/json", "no-store"},
    };
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        struct response r = get(rows[i].target);
        assert_int_equal(r.status, 200);
        expect("type", r.type, rows[i].type);
        expect("Cache-Control", r.cache_control, rows[i].cache_control);
        assert_int_equal(strlen(r.etag), 24);
        json_decref(json_of(&r));
        struct response gz =
            answer(&(struct ask){.target = rows[i].target, .accept_encoding = "br, gzip"});
        if (r.vary &&
            strstr(r.vary,
                   "Accept-Encoding")) { /* there are two codings, and they have two names */
            expect("Content-Encoding", gz.encoding, "gzip");
            expect("Vary", gz.vary, r.vary);
            assert_true(gz.size < r.size);
            assert_string_not_equal(gz.etag, r.etag);
        } else {
            expect("Content-Encoding", gz.encoding, NULL);
            if (strcmp(rows[i].target, "/version") != 0)
                assert_string_equal(gz.etag, r.etag);
        }
        response_free(&gz);
        response_free(&r);
    }
}

static void test_version(void **state)
{
    struct response r = get("/version");
    assert_int_equal(r.status, 200);
    json_t *o = json_of(&r), *datasets = json_object_get(o, "datasets");
    expect("name", json_string_value(json_object_get(o, "name")), "citysplat");
    expect("version", json_string_value(json_object_get(o, "version")), CITYSPLAT_VERSION);
    assert_int_equal(json_object_size(datasets), 1);
    expect("revision", json_string_value(json_object_get(datasets, "toy")), t.rev);
    json_decref(o);
    response_free(&r);
}

/* Documents made for a request when the k-th allocation fails: whole, or 503. The sanitizers see
 * what is not freed. */
static void test_documents_without_memory(void **state)
{
    static const char *const targets[] = {"/version", "/metrics"};
    for (size_t i = 0; i < 2; i++) {
        size_t refused = 0;
        for (size_t k = 1; k < 12; k++) {
            mem_fail_at(k);
            struct response r = get(targets[i]);
            mem_fail_at(0);
            if (r.status == 503)
                refused++;
            else
                assert_int_equal(r.status, 200);
            assert_true(r.status == 503 || r.size > 100);
            response_free(&r);
        }
        assert_in_range(refused, 1, 10);
    }
}

/* What meets a box; what is no box is refused. */
static void test_collections_in_a_box(void **state)
{
    static const struct {
        const char *query;
        int n; /* -1: 400 */
    } rows[] = {
        {"", 1},
        {"?bbox=13,52,14,53", 1},
        {"?bbox=13%2C52%2C14%2C53&limit=10", 1},
        {"?bbox=14,52,15,53", 0},
        {"?bbox=13,53,14,54", 0},
        {"?bbox=13.39,52.49,13.41,52.51", 1},
        {"?bbox=13,52,-100,14,53,5000", 1},
        {"?bbox=13,52,5000,14,53,6000", 0},
        {"?bbox=170,-90,20,90", 1}, /* across the date line */
        {"?bbox=170,-90,-170,90", 0},
        {"?bbox=", -1},
        {"?bbox=1,2,3", -1},
        {"?bbox=1,2,3,4,5", -1},
        {"?bbox=1,2,3,4,5,6,7", -1},
        {"?bbox=13,53,14,52", -1},
        {"?bbox=13,52,14,a", -1},
        {"?bbox=181,0,182,1", -1},
        {"?bbox=13,52,14,91", -1},
        {"?bbox=13,52,14,53&bbox=13,52,14,53", -1},
    };
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        char target[128];
        snprintf(target, sizeof target, "/collections%s", rows[i].query);
        struct response r = get(target);
        if (r.status != (rows[i].n < 0 ? 400 : 200))
            fail_msg("%s: %d", target, r.status);
        json_t *o = json_of(&r);
        if (rows[i].n >= 0 && (int)json_array_size(json_object_get(o, "collections")) != rows[i].n)
            fail_msg("%s: not %d datasets", target, rows[i].n);
        json_decref(o);
        response_free(&r);
    }
}

static void test_links_lead_somewhere(void **state)
{
    static const char *const docs[][2] = {
        {"/", "/"}, {"/collections", "/"}, {"/collections/toy", "/collections/"}};
    for (size_t i = 0; i < 3; i++) {
        struct response r = get(docs[i][0]);
        json_t *o = json_of(&r), *links = json_object_get(o, "links"), *link;
        size_t k;
        if (i == 1)
            links = json_object_get(json_array_get(json_object_get(o, "collections"), 0), "links");
        assert_true(json_array_size(links) >= 3);
        json_array_foreach(links, k, link)
        {
            char path[256];
            const char *href = json_string_value(json_object_get(link, "href"));
            assert_non_null(href);
            assert_null(strstr(href, "://"));
            if (!strncmp(href, "../", 3))
                snprintf(path, sizeof path, "/%s", href + 3);
            else if (href[0] == '/')
                snprintf(path, sizeof path, "%s", href);
            else
                snprintf(path, sizeof path, "%s%s", docs[i][1], !strcmp(href, "./") ? "" : href);
            struct response to = get(path);
            const char *rel = json_string_value(json_object_get(link, "rel"));
            assert_int_equal(to.status, rel && !strcmp(rel, "preview") ? 307 : 200);
            response_free(&to);
        }
        json_decref(o);
        response_free(&r);
    }
}

/* Addresses begin with the host that was asked. A proxy that is not trusted may have another. */
static void test_origins(void **state)
{
    static const struct {
        struct request r;
        const char *public_url, *base_path, *want;
    } rows[] = {
        {{.host = "maps.example:8080"}, NULL, NULL, "http://maps.example:8080"},
        {{.host = "[::1]:80"}, NULL, "/splats", "http://[::1]:80/splats"},
        {{.host = "a"}, "https://public.example/", "/splats", "https://public.example"},
        {{.host = "a", .proxied = true}, NULL, NULL, ""},
        {{.host = "a", .proxied = true, .forwarded_host = "b"}, NULL, NULL, ""},
        {{.host = "a", .proxied = true, .trusted = true}, NULL, NULL, "http://a"},
        {{.host = "a", .proxied = true, .trusted = true, .forwarded_proto = "https"},
         NULL,
         NULL,
         "https://a"},
        {{.host = "a", .proxied = true, .trusted = true, .forwarded_proto = "javascript"},
         NULL,
         NULL,
         "http://a"},
        {{.host = "a",
          .proxied = true,
          .trusted = true,
          .forwarded_host = "maps.example",
          .forwarded_proto = "HTTPS"},
         NULL,
         "/x",
         "https://maps.example/x"},
        {{.host = "a\"><b"}, NULL, NULL, ""},
        {{.host = "a/../b"}, NULL, NULL, ""},
        {{.host = ""}, NULL, NULL, ""},
        {{.host = NULL}, NULL, NULL, ""},
    };
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        struct server_config cfg = {.public_url = rows[i].public_url,
                                    .base_path = rows[i].base_path};
        const struct services s = {.cfg = &cfg};
        char out[ORIGIN_MAX];
        expect(rows[i].r.host ? rows[i].r.host : "no host", origin_of(&s, &rows[i].r, out),
               rows[i].want);
    }
}

static void test_tileset_uris(void **state)
{
    char want[128];
    struct response fixed = get("/d/toy/r/REV/tileset.json"), moving = get("/d/toy/tileset.json");
    struct response tilejson = get("/collections/toy/tiles.json");
    assert_true(says(&fixed, expand("\"t/KEY15.glb\"", want, sizeof want)));
    assert_true(says(&moving, expand("\"r/REV+/t/KEY15.glb\"", want, sizeof want)));
    assert_true(
        says(&tilejson, expand("\"../../d/toy/r/REV+/t/{z}/{x}/{y}.glb\"", want, sizeof want)));
    response_free(&fixed);
    response_free(&moving);
    response_free(&tilejson);
}

static void test_refusals(void **state)
{
    static const struct {
        enum method method;
        const char *target;
        int status;
        const char *allow, *cache_control;
    } rows[] = {
        {METHOD_GET, "/nothing", 404, NULL, "public, max-age=60"},
        {METHOD_GET, "/d/none/tileset.json", 404, NULL, "public, max-age=60"},
        {METHOD_GET, "/d/toy/r/000000000000/tileset.json", 404, NULL, "no-store"},
        {METHOD_GET, "/d/toy/r/REV/t/17/0/0.glb", 404, NULL, "public, max-age=60"},
        {METHOD_GET, "/d/toy/r/REV/t/99/0/0.glb", 404, NULL, "public, max-age=60"},
        {METHOD_GET, "/%2e%2e/secret", 400, NULL, "no-store"},
        {METHOD_GET, "/d/toy/static/x,0,0@0,0/64x64.jpg", 400, NULL, "no-store"},
        {METHOD_GET, "/d/toy/static/0,99,0@0,0/64x64.jpg", 422, NULL, "no-store"},
        {METHOD_GET, "/d/toy/render", 405, "POST, OPTIONS", "no-store"},
        {METHOD_POST, "/d/toy/tileset.json", 405, "GET, HEAD, OPTIONS", "no-store"},
        {METHOD_POST, "/", 405, "GET, HEAD, OPTIONS", "no-store"},
        {METHOD_OTHER, "/d/toy/r/REV/t/KEY17.glb", 405, "GET, HEAD, OPTIONS", "no-store"},
        {METHOD_OTHER, "/nothing", 404, NULL, "public, max-age=60"},
    };
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        struct response r =
            answer(&(struct ask){.method = rows[i].method, .target = rows[i].target});
        if (r.status != rows[i].status)
            fail_msg("%s: got %d, want %d", last_target, r.status, rows[i].status);
        expect("Allow", r.allow, rows[i].allow);
        expect("Cache-Control", r.cache_control, rows[i].cache_control);
        expect("type", r.type, "application/problem+json");
        json_t *o = json_of(&r);
        assert_int_equal(json_integer_value(json_object_get(o, "status")), r.status);
        expect("title", json_string_value(json_object_get(o, "title")),
               response_status_text(r.status));
        assert_true(strlen(json_string_value(json_object_get(o, "detail"))) > 5);
        assert_false(says(&r, "secret")); /* input is not echoed */
        json_decref(o);
        response_free(&r);
    }
    /* For a person's browser it is a page, which leads to the viewer; its texts are escaped. */
    static const char browser[] = "text/html,application/xhtml+xml,*/*;q=0.8";
    struct response r = answer(&(struct ask){.target = "/nothing", .accept = browser});
    assert_int_equal(r.status, 404);
    expect("type", r.type, "text/html; charset=utf-8");
    expect("Vary", r.vary, "Accept");
    assert_true(says(&r, "<h1>Not Found</h1>"));
    assert_true(says(&r, "<a href=\"/\">"));
    response_free(&r);
    r = answer(&(struct ask){.target = "/%22%0a", .accept = browser});
    assert_true(r.status >= 400 && says(&r, "<h1>"));
    assert_false(says(&r, "%22"));
    response_free(&r);
    r = answer(&(struct ask){.method = METHOD_OPTIONS, .target = "/d/toy/render"});
    assert_int_equal(r.status, 204);
    expect("Allow", r.allow, "POST, OPTIONS");
    response_free(&r);
}

/* A problem says which resource it is about, where that can be said: a target that could be
 * read. */
static void test_instances(void **state)
{
    static const struct {
        const char *target, *instance;
    } rows[] = {
        {"/nothing?a=b", "/nothing"},
        {"/d/toy/r/000000000000/tileset.json", "/d/toy/r/000000000000/tileset.json"},
        {"/d/toy/static/0,99,0@0,0/64x64.jpg", "/d/toy/static/0,99,0@0,0/64x64.jpg"},
        {"/d/toy/r/REV/static/0,9,0@0,0/64x64.jpg?appearance=x",
         "/d/toy/r/REV/static/0,9,0@0,0/64x64.jpg"},
        {"/%22%0a", NULL},
    };
    char want[256];
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        struct response r = get(rows[i].target);
        json_t *o = json_of(&r);
        expect("instance", json_string_value(json_object_get(o, "instance")),
               rows[i].instance ? expand(rows[i].instance, want, sizeof want) : NULL);
        json_decref(o);
        response_free(&r);
    }
}

/* Entry documents say when what they describe was written; who has it since then gets 304, unless
 * he also says which he has. */
static void test_last_modified(void **state)
{
    static const char *const targets[] = {"/",
                                          "/api",
                                          "/conformance",
                                          "/collections",
                                          "/collections/toy",
                                          "/d/toy/tileset.json",
                                          "/d/toy/r/REV/tileset.json",
                                          "/d/toy/appearances",
                                          "/assets/index-D3adBeef.js"};
    static const struct {
        int64_t at_s;
        const char *text;
    } dates[] = {{784111777, "Sun, 06 Nov 1994 08:49:37 GMT"},
                 {951782400, "Tue, 29 Feb 2000 00:00:00 GMT"},
                 {4102444799, "Thu, 31 Dec 2099 23:59:59 GMT"},
                 {1, "Thu, 01 Jan 1970 00:00:01 GMT"}};
    static const char *const bad[] = {"",
                                      "Sun, 06 Nov 1994",
                                      "Sunday, 06-Nov-94 08:49:37 GMT",
                                      "0",
                                      "Sun, 06 Nxv 1994 08:49:37 GMT",
                                      "Sun, 06 Nov 1994 08:49:37 CET"};
    char date[CONDITION_DATE];
    for (size_t i = 0; i < sizeof dates / sizeof *dates; i++) {
        condition_date(dates[i].at_s, date);
        assert_string_equal(date, dates[i].text);
        assert_true(condition_not_modified(date, dates[i].at_s));
        assert_false(condition_not_modified(date, dates[i].at_s + 1));
        assert_false(
            condition_not_modified(date, dates[i].at_s - 1)); /* a file that was put back */
    }
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        assert_false(condition_not_modified(bad[i], 1));
    for (size_t i = 0; i < sizeof targets / sizeof *targets; i++) {
        struct response r = get(targets[i]);
        assert_int_equal(r.status, 200);
        assert_true(r.modified_s > 1577836800); /* 2020 */
        condition_date(r.modified_s, date);
        response_free(&r);
        struct ask a = {.target = targets[i], .if_modified_since = date};
        r = answer(&a);
        assert_int_equal(r.status, 304);
        response_free(&r);
        a.if_none_match = "\"another\"";
        r = answer(&a);
        assert_int_equal(r.status, 200);
        response_free(&r);
        a = (struct ask){.target = targets[i],
                         .if_modified_since = "Sun, 06 Nov 1994 08:49:37 GMT"};
        r = answer(&a);
        assert_int_equal(r.status, 200);
        response_free(&r);
        const struct {
            const char *date, *match;
            int status;
        } unmodified[] = {{date, NULL, 200},
                          {"Thu, 31 Dec 2099 23:59:59 GMT", NULL, 200},
                          {"Sun, 06 Nov 1994 08:49:37 GMT", NULL, 412},
                          {"Sun, 06 Nov 1994 08:49:37 GMT", "*", 200}, /* comes first */
                          {"long ago", NULL, 200}};
        for (size_t k = 0; k < sizeof unmodified / sizeof *unmodified; k++) {
            r = answer(&(struct ask){.target = targets[i],
                                     .if_unmodified_since = unmodified[k].date,
                                     .if_match = unmodified[k].match});
            assert_int_equal(r.status, unmodified[k].status);
            response_free(&r);
        }
    }
}

static void test_redirects(void **state)
{
    char want[256];
    struct response r = get("/d/toy/t/KEY17.glb");
    assert_int_equal(r.status, 307);
    expect("Location", r.location, expand("../../../r/REV+/t/KEY17.glb", want, sizeof want));
    response_free(&r);
    r = get("/d/toy/static/13.4,52.5,120@0,-90/64x64.jpg");
    assert_int_equal(r.status, 307);
    expect("Location", r.location,
           expand("../../r/REV/static/13.4,52.5,120@0,-90/64x64.jpg", want, sizeof want));
    expect("Cache-Control", r.cache_control, MOVING);
    response_free(&r);
}

static void test_job_ends(void **state)
{
    static const struct {
        enum job_end end;
        enum err_code code;
        int status;
        bool retry;
    } rows[] = {
        {JOB_ERROR, ERR_FORMAT, 500, false},    {JOB_ERROR, ERR_MEM, 503, true},
        {JOB_ERROR, ERR_DEVICE, 503, true},     {JOB_ERROR, ERR_NOENT, 404, false},
        {JOB_SHED, ERR_BUSY, 503, true},        {JOB_TIMEOUT, ERR_BUSY, 504, true},
        {JOB_CANCELLED, ERR_CANCEL, 503, true},
    };
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        struct request q = {.target = "/", .target_size = 1};
        struct response r = {
            .cache_control = IMMUTABLE, .cls = JOB_TILE, .kind = &answer_view_work, .queue_s = -1};
        struct job_result result = {.end = rows[i].end, .code = rows[i].code, .msg = "because"};
        dispatch_finish(&t.s, &q, &result, &r);
        assert_int_equal(r.status, rows[i].status);
        assert_int_equal(r.retry_after_s > 0, rows[i].retry);
        assert_true(r.status == 404 || !strcmp(r.cache_control, "no-store"));
        response_free(&r);
    }
}

/* Each kind of work has a word of its own. */
static void test_words_of_failures(void **state)
{
    static const struct {
        const char *target, *says;
    } rows[] = {{"/d/toy/r/REV/t/KEY15.glb", "tile 15/"},
                {"/d/toy/seed.ndjson", "the list of tiles could"},
                {"/collections/toy/tiles.json", "the TileJSON could"},
                {"/d/toy/tileset.json?sh=0", "the tileset could not"}};
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        struct request q = {.target = expand(rows[i].target, last_target, sizeof last_target)};
        q.target_size = strlen(q.target);
        struct response r;
        struct job_result result = {.end = JOB_ERROR, .code = ERR_INTERNAL, .msg = "a path"};
        dispatch_answer(&t.s, &q, &r);
        assert_non_null(r.work);
        work_drop(NULL, r.work);
        dispatch_finish(&t.s, &q, &result, &r);
        assert_int_equal(r.status, 500);
        if (!says(&r, rows[i].says) || says(&r, "a path"))
            fail_msg("%.*s, not %s", (int)r.size, (const char *)r.data, rows[i].says);
        response_free(&r);
    }
}

static void test_metrics_are_local(void **state)
{
    struct response r = get("/metrics");
    assert_int_equal(r.status, 200);
    assert_true(says(&r, "citysplat_dataset_info{ds=\"toy\""));
    response_free(&r);
    struct request q = {.target = "/metrics", .target_size = 8};
    dispatch_answer(&t.s, &q, &r);
    assert_int_equal(r.status, 403);
    response_free(&r);
    static const struct {
        const char *metrics, *authorization;
        bool local;
        int status;
    } rows[] = {
        {"local", NULL, true, 200},
        {"local", "Bearer local", false, 403},
        {"public", NULL, false, 200},
        {"sixteen characters", NULL, true, 403},
        {"sixteen characters", "Bearer sixteen characters", false, 200},
        {"sixteen characters", "bearer sixteen characters", false, 200},
        {"sixteen characters", "Bearer sixteen charactersx", false, 403},
        {"sixteen characters", "Bearer sixteen character", false, 403},
        {"sixteen characters", "Bearer ", false, 403},
        {"sixteen characters", "sixteen characters", false, 403},
    };
    struct server_config cfg = t.cfg;
    t.s.cfg = &cfg;
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        cfg.metrics = rows[i].metrics;
        q.own_host = rows[i].local ? "localhost" : NULL;
        q.authorization = rows[i].authorization;
        dispatch_answer(&t.s, &q, &r);
        if (r.status != rows[i].status)
            fail_msg("--metrics '%s', '%s': %d", rows[i].metrics,
                     q.authorization ? q.authorization : "", r.status);
        response_free(&r);
    }
    t.s.cfg = &t.cfg;
    struct services other;
    struct err e = {0};
    cfg.metrics = "short";
    kit_fails(services_open(&other, &cfg, NULL, ROUTES, ROUTES_COUNT, &e), ERR_ARG, e, "--metrics");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_words_of_failures), /* before these documents are kept */
        cmocka_unit_test(test_documents),
        cmocka_unit_test(test_version),
        cmocka_unit_test(test_documents_without_memory),
        cmocka_unit_test(test_collections_in_a_box),
        cmocka_unit_test(test_links_lead_somewhere),
        cmocka_unit_test(test_tileset_uris),
        cmocka_unit_test(test_refusals),
        cmocka_unit_test(test_instances),
        cmocka_unit_test(test_last_modified),
        cmocka_unit_test(test_redirects),
        cmocka_unit_test(test_job_ends),
        cmocka_unit_test(test_metrics_are_local),
        cmocka_unit_test(test_origins),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
