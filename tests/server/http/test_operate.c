/* What operators set up in front of users: caches by dataset, ids of requests, base paths, and
 * their own listener. The program itself: test_program.c, its stores: test_stores.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/access/cache_policy.h"
#include "tests/server/client.h"

static void test_cache_policies(void **state)
{
    static const char immutable[] = "public, max-age=31536000, immutable",
                      moving[] =
                          "public, max-age=60, stale-while-revalidate=600, stale-if-error=86400";
    static const char *const bad[] = {"a",    "=private",   "a=",    "a=never",
                                      "a=-1", "a=99999999", "a=b=c", ",a=1"};
    struct cache_policy p;
    struct err e = {0};
    struct reply r;
    char target[128];
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        kit_fails(cache_policy_read(bad[i], &p, &e), ERR_ARG, e, "--cache-policy");
    kit_ok(cache_policy_read("a=private,b=no-store,c=300,*=public", &p, &e), e);
    assert_string_equal(cache_policy_of(&p, "a", true, immutable),
                        "private, max-age=31536000, immutable");
    assert_string_equal(cache_policy_of(&p, "a", true, moving), "private, max-age=60");
    assert_string_equal(cache_policy_of(&p, "a", true, "no-store"), "no-store");
    assert_string_equal(cache_policy_of(&p, "b", true, immutable), "private, no-store");
    assert_string_equal(cache_policy_of(&p, "c", true, immutable), immutable);
    assert_string_equal(cache_policy_of(&p, "c", true, moving),
                        "public, max-age=300, stale-while-revalidate=600, stale-if-error=86400");
    assert_string_equal(cache_policy_of(&p, "d", true, moving), moving);
    assert_string_equal(cache_policy_of(&p, "d", false, immutable),
                        "private, max-age=31536000, immutable");
    kit_ok(cache_policy_read(NULL, &p, &e), e);
    assert_string_equal(cache_policy_of(&p, "d", true, immutable), immutable);

    static const char *const tags[] = {"Surrogate-Key", "xkey", "Cache-Tag", "none"};
    t.cfg.cache_policy = "toy=private";
    for (int k = 0; k < 4; k++) {
        t.cfg.tag_header = k;
        start();
        for (int again = 0; again < 2; again++) {
            ask("GET", tile_target(17, "glb", target), "", &r);
            assert_string_equal(header(&r, "Cache-Control"),
                                "private, max-age=31536000, immutable");
            assert_string_equal(header(&r, "Cache-Status"),
                                again ? "citysplat; hit" : "citysplat; fwd=miss; stored");
            for (int i = 0; i < 3; i++)
                assert_int_equal(header(&r, tags[i])[0] != 0, i == k);
            buf_free(&r.raw);
        }
        ask("GET", "/d/toy/tileset.json", "", &r); /* what moves has the tag of its dataset */
        assert_string_equal(header(&r, "Cache-Control"), "private, max-age=60");
        if (k < 3)
            assert_string_equal(header(&r, tags[k]), "ds-toy");
        buf_free(&r.raw);
        ask("GET", "/d/toy/seed.ndjson?clip=1,1,2,1,1,2", "", &r); /* a job finds nothing */
        assert_int_equal(r.status, 404);
        assert_string_equal(header(&r, "Cache-Control"), "private, max-age=60");
        buf_free(&r.raw);
        server_stop(&t.server);
    }
}

static void test_request_ids(void **state)
{
    struct reply r;
    char own[2][80];
    const char *at;
    start();
    ask("GET", "/healthz", "X-Request-Id: proxy-7.a_B\r\n", &r);
    assert_string_equal(header(&r, "X-Request-Id"), "proxy-7.a_B");
    buf_free(&r.raw);
    static const char *const cached[] = {"/d/toy/tileset.json", "/nothing/here",
                                         "/d/none/map.json"};
    for (int i = 0; i < 3; i++) /* a cache would give it to everybody */
        for (int again = 0; again < 2; again++) {
            ask("GET", cached[i], "X-Request-Id: of-one\r\n", &r);
            assert_non_null(strstr(header(&r, "Cache-Control"), "public"));
            assert_string_equal(header(&r, "X-Request-Id"), "");
            buf_u8(&r.raw, 0);
            assert_null(strstr((const char *)r.raw.data, "of-one"));
            buf_free(&r.raw);
        }
    ask("GET", "/metrics", "X-Request-Id: of-one\r\nX-Forwarded-For: 1.2.3.4\r\n", &r);
    assert_int_equal(r.status, 403); /* not kept: there it is */
    assert_string_equal(header(&r, "X-Request-Id"), "of-one");
    assert_non_null(strstr((const char *)r.body, "\"request_id\":\"of-one\""));
    buf_free(&r.raw);
    ask("GET", "/healthz", "", &r);
    assert_string_equal(header(&r, "X-Request-Id"), "");
    buf_free(&r.raw);
    for (int i = 0; i < 2; i++) { /* neither quotes nor what is too long are repeated */
        ask("GET", "/nothing/here", i ? "X-Request-Id: a\"b\r\n" : "", &r);
        assert_int_equal(r.status, 404);
        snprintf(own[i], sizeof own[i], "%s", header(&r, "X-Request-Id"));
        assert_int_equal(strlen(own[i]), 16);
        assert_non_null(at = strstr((const char *)r.body, "\"request_id\":\""));
        assert_memory_equal(at + 14, own[i], 16);
        buf_free(&r.raw);
    }
    assert_string_not_equal(own[0], own[1]);
    char line[200] = "X-Request-Id: ";
    memset(line + 14, 'a', 65);
    memcpy(line + 79, "\r\n", 3);
    ask("GET", "/nothing/here", line, &r);
    assert_int_equal(strlen(header(&r, "X-Request-Id")), 16);
    buf_free(&r.raw);
}

static void test_base_path(void **state)
{
    static const char *const bad[] = {"splats", "/", "/splats/", "//a", "/a/../b", "/a b"};
    struct err e = {0};
    struct reply r;
    struct server *none = NULL;
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        t.cfg.base_path = bad[i];
        kit_fails(server_start(&t.cfg, t.paths, 1, &none, &e), ERR_ARG, e, "--base-path");
    }
    t.cfg.base_path = "/maps/splats";
    start();
    assert_int_equal(status_of("GET", "/maps/splats/d/toy/tileset.json", ""), 200);
    assert_int_equal(status_of("GET", "/d/toy/tileset.json", ""), 200); /* a proxy that strips it */
    assert_int_equal(status_of("GET", "/maps/splatsd/toy/tileset.json", ""), 404);
    assert_int_equal(status_of("GET", "/maps/splats/maps/splats/healthz", ""), 404);
    ask("GET", "/maps/splats", "", &r);
    assert_int_equal(r.status, 308);
    assert_string_equal(header(&r, "Location"), "/maps/splats/");
    buf_free(&r.raw);
    ask("GET", "/maps/splats/d/toy/t/17/1/1.glb", "",
        &r); /* relative, so it holds below the path */
    assert_int_equal(r.status, 307);
    assert_int_not_equal(header(&r, "Location")[0], '/');
    buf_free(&r.raw);
}

/* A page in an operator's browser: it asks for nothing, and reads nothing. */
static void admin_refuses_pages(uint16_t admin)
{
    struct reply r;
    ask_port(admin, "POST", "/-/reload",
             "Origin: https://elsewhere.example\r\nContent-Length: 0\r\n", &r);
    assert_int_equal(r.status, 403);
    assert_string_equal(header(&r, "Access-Control-Allow-Origin"), "");
    buf_free(&r.raw);
    ask_port(admin, "GET", "/metrics", "Origin: https://elsewhere.example\r\n", &r);
    assert_int_equal(r.status, 403);
    buf_free(&r.raw);
}

/* The status of a request for metrics that names a host. */
static int status_by_name(uint16_t port, const char *host)
{
    char text[400];
    struct reply r;
    snprintf(text, sizeof text, "GET /metrics HTTP/1.1\r\nHost: %s\r\nConnection: close\r\n\r\n",
             host);
    int fd = dial(port);
    say(fd, text);
    hear(fd, true, NULL, &r);
    const int status = r.status;
    buf_free(&r.raw);
    close(fd);
    return status;
}

/* A page of another site whose name leads to this machine (DNS rebinding) learns nothing. */
static void admin_knows_its_names(uint16_t admin)
{
    static const char *const own[] = {"localhost", "LOCALHOST:9", "127.0.0.1:9", "[::1]:9",
                                      "10.1.2.3:80"},
                             *const foreign[] = {"evil.example",           "evil.example:80",
                                                 "localhost.evil.example", "127.0.0.1.evil.example",
                                                 "maps.example",           ""};
    char name[300] = "", longer[330];
    for (size_t i = 0; i < sizeof own / sizeof *own; i++)
        if (status_by_name(admin, own[i]) != 200)
            fail_msg("%s is refused", own[i]);
    for (size_t i = 0; i < sizeof foreign / sizeof *foreign; i++)
        if (status_by_name(admin, foreign[i]) != 403)
            fail_msg("%s is not refused", foreign[i]);
    assert_int_equal(gethostname(name, 256), 0);
    assert_int_equal(status_by_name(admin, name), 200);
    snprintf(longer, sizeof longer, "%s.evil.example", name);
    assert_int_equal(status_by_name(admin, longer), 403);
}

/* The host of --public-url is one of its names. */
static void test_admin_of_a_public_url(void **state)
{
    t.cfg.admin = "127.0.0.1:0";
    t.cfg.public_url = "https://maps.example:8443/splats";
    start();
    const uint16_t admin = server_admin_port(t.server);
    assert_int_equal(status_by_name(admin, "maps.example"), 200);
    assert_int_equal(status_by_name(admin, "evil.example"), 403);
}

static void test_admin_listener(void **state)
{
    struct err e = {0};
    struct reply r;
    struct server *none = NULL;
    t.cfg.admin = "localhost:1";
    kit_fails(server_start(&t.cfg, t.paths, 1, &none, &e), ERR_ARG, e, "--admin");
    t.cfg.admin = "127.0.0.1";
    kit_fails(server_start(&t.cfg, t.paths, 1, &none, &e), ERR_ARG, e, "--admin");
    t.cfg.admin = "127.0.0.1:0";
    start();
    uint16_t admin = server_admin_port(t.server);
    assert_int_not_equal(admin, 0);
    assert_int_not_equal(admin, t.port);
    assert_int_equal(status_of("GET", "/metrics", ""), 404);
    assert_int_equal(status_of("POST", "/-/reload", "Content-Length: 0\r\n"), 404);
    ask_port(admin, "GET", "/metrics", "X-Forwarded-For: 1.2.3.4\r\n", &r);
    assert_int_equal(r.status, 200);
    assert_non_null(strstr((const char *)r.body, "citysplat_http_requests_total"));
    buf_free(&r.raw);
    static const char *const there[] = {"/healthz", "/readyz", "/version"},
                             *const not_there[] = {"/", "/d/toy/tileset.json", "/collections"};
    for (int i = 0; i < 3; i++) {
        ask_port(admin, "GET", there[i], "", &r);
        assert_int_equal(r.status, 200);
        buf_free(&r.raw);
        ask_port(admin, "GET", not_there[i], "", &r);
        assert_int_equal(r.status, 404);
        buf_free(&r.raw);
    }
    admin_refuses_pages(admin);
    admin_knows_its_names(admin);
    ask_port(admin, "GET", "/metrics", "", &r);
    assert_int_equal(r.status, 200);
    assert_string_equal(header(&r, "Access-Control-Allow-Origin"), "");
    assert_string_equal(header(&r, "Cross-Origin-Resource-Policy"), "same-origin");
    buf_free(&r.raw);
    ask_port(admin, "POST", "/-/reload", "Content-Length: 0\r\n", &r);
    assert_int_equal(r.status, 200);
    assert_non_null(strstr((const char *)r.body, "\"status\": \"reloaded\""));
    buf_free(&r.raw);
    assert_true(server_answers(t.server, 2));
    /* idle connections of operators do not hold up the end */
    int fd = dial(admin);
    say(fd, "GET /healthz HTTP/1.1\r\n" H "\r\n");
    hear(fd, true, NULL, &r);
    buf_free(&r.raw);
    double start_s = clock_s();
    server_stop(&t.server);
    assert_true(clock_s() - start_s < 5);
    close(fd);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        HTTP_TEST(test_cache_policies),
        HTTP_TEST(test_request_ids),
        HTTP_TEST(test_base_path),
        HTTP_TEST(test_admin_listener),
        HTTP_TEST(test_admin_of_a_public_url),
    };
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
