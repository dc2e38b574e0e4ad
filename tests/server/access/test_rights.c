/* Who may read what: files of --auth, signatures, seals of sessions, private datasets, signed
 * addresses and cookies.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/access/auth.h"
#include "tests/server/rights_kit.h"

#include <jansson.h>

static void test_files_of_auth(void **state)
{
    static const struct {
        const char *text, *says;
    } bad[] = {
        {"[]", "object"},
        {"{\"tokens\": {}}", "tokens"},
        {"{\"token\": []}", "token"},
        {"{\"keys\": {\"k\": \"short\"}}", "keys.k"},
        {"{\"keys\": {\"k k\": \"0123456789abcdef0123456789abcdef\"}}", "keys.k k"},
        {"{\"tokens\": [{\"sha256\": \"12\", \"scope\": [\"admin\"]}]}", "tokens[0].sha256"},
        {"{\"tokens\": [{\"scope\": [\"admin\"]}]}", "tokens[0].sha256"},
        {"{\"public\": [1]}", "public[0]"},
        {"{\"tokens\": [1]}", "tokens[0]"},
        {"{\"max_age_s\": 1}", "max_age_s"},
        {"{\"max_age_s\": 315360000}", "max_age_s"},
        {"{\"session_s\": \"1h\"}", "session_s"},
    };
    char path[FILE_PATH_MAX];
    struct err e = {0};
    struct auth *a = NULL;
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        kit_fails(auth_open(rights_put("bad.jsonc", bad[i].text, path), &a, &e), ERR_FORMAT, e,
                  bad[i].says);
        assert_null(a);
    }
    kit_fails(auth_open(rights_file("\"steal:x\"", "", path), &a, &e), ERR_FORMAT, e, "scope[0]");
    kit_fails(auth_open(rights_file("", "", path), &a, &e), ERR_FORMAT, e, "scope");
}

static enum auth_answer asked(const struct auth *a, enum auth_need need, const char *ds,
                              const char *seal, int64_t now_s)
{
    const struct auth_request r = {
        .path = "/d/x", .n_path = 4, .query = "", .seal = seal, .n_seal = strlen(seal)};
    return auth_check(a, need, ds, &r, now_s);
}

static enum auth_answer asked_path(const struct auth *a, const char *path, const char *query,
                                   int64_t now_s)
{
    const struct auth_request r = {
        .path = path, .query = query, .n_path = strlen(path), .n_query = strlen(query)};
    return auth_check(a, AUTH_RENDER, "toy", &r, now_s);
}

static enum auth_answer asked_cookie(const struct auth *a, enum auth_need need, const char *cookie,
                                     int64_t now_s)
{
    const struct auth_request r = {.path = "", .query = "", .cookie = cookie};
    return auth_check(a, need, "toy", &r, now_s);
}

/* No byte of it may be another. */
static void each_byte_counts(const struct auth *a, const char *text, bool is_seal)
{
    char other[AUTH_QUERY_MAX];
    for (size_t i = 0; text[i]; i++) {
        snprintf(other, sizeof other, "%s", text);
        other[i] = other[i] == 'x' ? 'y' : 'x';
        if ((is_seal ? asked(a, AUTH_READ, "toy", other, 999)
                     : asked_path(a, "/d/toy/t", other, 999)) == AUTH_OK)
            fail_msg("byte %zu of %s may be another", i, text);
    }
}

static void test_signatures(void **state)
{
    enum { MOST_S = 30 * 86400 };
    char path[FILE_PATH_MAX], seal[AUTH_SEAL_MAX], query[AUTH_QUERY_MAX],
        other[AUTH_QUERY_MAX + 64];
    struct err e = {0};
    struct auth *a = NULL;
    kit_ok(auth_open(rights_file("\"read:toy\"", "\"free\"", path), &a, &e), e);
    kit_fails(auth_sign(a, "k2", AUTH_SCOPE_BOTH, "toy", 1000, 900, seal, &e), ERR_ARG, e, "k2");
    kit_fails(auth_sign(a, NULL, AUTH_SCOPE_BOTH, "/d/toy", 1000, 900, seal, &e), ERR_ARG, e,
              "name of a dataset");
    kit_fails(auth_sign(a, NULL, AUTH_SCOPE_BOTH, "", 1000, 900, seal, &e), ERR_ARG, e, "name");
    kit_fails(auth_sign(a, NULL, AUTH_SCOPE_BOTH, "toy", 901 + MOST_S, 900, seal, &e), ERR_ARG, e,
              "max_age_s");
    kit_ok(auth_sign(a, NULL, AUTH_SCOPE_BOTH, "toy", 1000, 900, seal, &e), e);
    assert_int_equal(asked(a, AUTH_READ, "toy", seal, 999), AUTH_OK);
    assert_int_equal(asked(a, AUTH_RENDER, "toy", seal, 999), AUTH_OK);
    assert_int_equal(asked(a, AUTH_RENDER, "toy", seal, 1000), AUTH_EXPIRED);
    assert_int_equal(asked(a, AUTH_READ, "toy", seal, 900 - MOST_S), AUTH_LONG);
    assert_int_equal(asked(a, AUTH_READ, "toyota", seal, 999), AUTH_FORBIDDEN);
    assert_int_equal(asked(a, AUTH_READ, "free", seal, 999), AUTH_OK);
    assert_int_equal(asked(a, AUTH_WRITE, "toy", seal, 999), AUTH_UNKNOWN);
    assert_int_equal(asked(a, AUTH_ADMIN, NULL, seal, 999), AUTH_UNKNOWN);
    assert_int_equal(auth_check_seal(a, seal, strlen(seal), 999), AUTH_OK);
    each_byte_counts(a, seal, true);
    kit_ok(auth_sign(a, NULL, AUTH_SCOPE_READ, "toy", 1000, 900, seal, &e), e);
    assert_int_equal(asked(a, AUTH_READ, "toy", seal, 999), AUTH_OK);
    assert_int_equal(asked(a, AUTH_RENDER, "toy", seal, 999), AUTH_FORBIDDEN);
    kit_ok(auth_sign(a, NULL, AUTH_SCOPE_RENDER, "toy", 1000, 900, seal, &e), e);
    assert_int_equal(asked(a, AUTH_READ, "toy", seal, 999), AUTH_FORBIDDEN);
    assert_int_equal(asked(a, AUTH_RENDER, "toy", seal, 999), AUTH_OK);
    /* one path alone */
    kit_fails(auth_sign_path(a, NULL, "d/toy", 1000, 900, query, &e), ERR_ARG, e, "path");
    kit_ok(auth_sign_path(a, "k1", "/d/toy/t", 1000, 900, query, &e), e);
    assert_int_equal(asked_path(a, "/d/toy/t", query, 999), AUTH_OK);
    assert_int_equal(asked_path(a, "/d/toy/t", query, 1000), AUTH_EXPIRED);
    assert_int_equal(asked_path(a, "/d/toy/t2", query, 999), AUTH_FORBIDDEN);
    assert_int_equal(asked_path(a, "/d/toy/", query, 999), AUTH_FORBIDDEN);
    assert_int_equal(asked_path(a, "/d/toy/t", "", 999), AUTH_UNKNOWN);
    each_byte_counts(a, query, false);
    /* with its query and no other; v= is for caches */
    kit_ok(auth_sign_path(a, "k1", "/d/toy/t?depth=mm&supersample=2", 1000, 900, query, &e), e);
    static const struct {
        const char *before, *after;
        enum auth_answer want;
    } rows[] = {{"depth=mm&supersample=2&", "", AUTH_OK},
                {"depth=mm&", "&supersample=2", AUTH_OK},
                {"v=3&depth=mm&supersample=2&", "&v=4", AUTH_OK},
                {"", "", AUTH_FORBIDDEN},
                {"depth=mm&", "", AUTH_FORBIDDEN},
                {"depth=cm&supersample=2&", "", AUTH_FORBIDDEN},
                {"supersample=2&depth=mm&", "", AUTH_FORBIDDEN},
                {"depth=mm&supersample=2&", "&appearance=x", AUTH_FORBIDDEN}};
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        snprintf(other, sizeof other, "%s%s%s", rows[i].before, query, rows[i].after);
        if (asked_path(a, "/d/toy/t", other, 999) != rows[i].want)
            fail_msg("row %zu", i);
    }
    kit_ok(auth_sign_path(a, "k1", "/d/toy/t", 1000, 900, query, &e), e);
    snprintf(other, sizeof other, "%s&depth=mm", query);
    assert_int_equal(asked_path(a, "/d/toy/t", other, 999), AUTH_FORBIDDEN);
    /* a longer time under the same signature; what comes twice counts as it came first */
    snprintf(other, sizeof other, "exp=2000&%s", query);
    assert_int_equal(asked_path(a, "/d/toy/t", other, 999), AUTH_FORBIDDEN);
    auth_close(&a);
}

/* The same form signs sessions and addresses, and neither passes for the other. */
static void test_session_seals(void **state)
{
    char path[FILE_PATH_MAX], seal[AUTH_SEAL_MAX], cookie[AUTH_SEAL_MAX + 64];
    struct err e = {0};
    struct auth *a = NULL, *again = NULL;
    int64_t for_s = 0;
    kit_ok(auth_open(rights_file("\"read:toy\",\"write:toy\"", "", path), &a, &e), e);
    assert_int_equal(auth_session(a, "wrong", 900, seal, &for_s), AUTH_FORBIDDEN);
    assert_int_equal(auth_session(a, TOKEN, 900, seal, &for_s), AUTH_OK);
    assert_int_equal(for_s, 12 * 3600);
    snprintf(cookie, sizeof cookie, "a=b; citysplat=%s; c=d", seal);
    assert_int_equal(asked_cookie(a, AUTH_READ, cookie, 999), AUTH_OK);
    assert_int_equal(asked_cookie(a, AUTH_RENDER, cookie, 999), AUTH_FORBIDDEN);
    assert_int_equal(asked_cookie(a, AUTH_WRITE, cookie, 999), AUTH_UNKNOWN);
    assert_int_equal(asked_cookie(a, AUTH_READ, cookie, 900 + for_s), AUTH_UNKNOWN);
    assert_int_equal(asked_cookie(a, AUTH_READ, "citysplat=", 999), AUTH_UNKNOWN);
    assert_int_equal(asked_cookie(a, AUTH_READ, "xcitysplat=1", 999), AUTH_UNKNOWN);
    assert_int_equal(auth_check_seal(a, seal, strlen(seal), 999), AUTH_FORBIDDEN);
    assert_int_equal(asked(a, AUTH_READ, "toy", seal, 999), AUTH_FORBIDDEN);
    kit_ok(auth_sign(a, NULL, AUTH_SCOPE_BOTH, "toy", 1000, 900, seal, &e), e);
    snprintf(cookie, sizeof cookie, "citysplat=%s", seal);
    assert_int_equal(asked_cookie(a, AUTH_READ, cookie, 999), AUTH_UNKNOWN);
    kit_ok(auth_open(path, &again, &e), e);
    assert_true(auth_is_same(a, again));
    auth_close(&again);
    kit_ok(auth_open(rights_file("\"read:toy\"", "", path), &again, &e), e);
    assert_false(auth_is_same(a, again));
    auth_close(&again);
    auth_close(&a);
}

static void test_private_datasets(void **state)
{
    static const char *const scopes[] = {"\"read:toy\"", "\"read:*\",\"render:*\",\"admin\"",
                                         "\"read:other\""};
    static const struct {
        const char *target;
        bool of_toy;
    } missing[] = {/* two by a job, and one of no dataset */
                   {"/d/toy/tileset.json?clip=1,1,2,1,1,2", true},
                   {"/d/toy/seed.ndjson?clip=1,1,2,1,1,2", true},
                   {"/d/none/tileset.json", false}};
    char path[FILE_PATH_MAX], target[128], line[128], seal[AUTH_SEAL_MAX], query[AUTH_QUERY_MAX],
        signed_target[800];
    struct err e = {0};
    struct reply r;
    struct auth *a = NULL;
    snprintf(line, sizeof line, "Authorization: Bearer %s\r\n", TOKEN);
    for (int k = 0; k < 3; k++) {
        t.cfg.auth = rights_file(scopes[k], "", path);
        start();
        ask("GET", tile_target(17, "glb", target), "", &r);
        assert_int_equal(r.status, 401);
        assert_string_equal(header(&r, "WWW-Authenticate"), "Bearer");
        assert_string_equal(header(&r, "Cache-Control"), "no-store");
        buf_free(&r.raw);
        assert_int_equal(status_of("GET", target, "Authorization: Bearer wrong\r\n"), 403);
        assert_int_equal(status_of("GET", "/d/none/tileset.json", ""),
                         401); /* as one that there is */
        assert_int_equal(status_of("GET", "/collections/toy", ""), 401);
        assert_int_equal(status_of("OPTIONS", target, "Access-Control-Request-Method: GET\r\n"),
                         204);
        ask("GET", target, line, &r);
        assert_int_equal(r.status, k < 2 ? 200 : 403);
        if (k < 2)
            assert_string_equal(header(&r, "Cache-Control"),
                                "private, max-age=31536000, immutable");
        buf_free(&r.raw);
        for (size_t i = 0; i < sizeof missing / sizeof *missing; i++) {
            ask("GET", missing[i].target, line, &r);
            assert_int_equal(r.status, k == 1 || (k < 1 && missing[i].of_toy) ? 404 : 403);
            assert_string_equal(header(&r, "Cache-Control"), r.status == 404 && missing[i].of_toy
                                                                 ? "private, max-age=60"
                                                                 : "no-store");
            buf_free(&r.raw);
        }
        assert_int_equal(status_of("GET", "/d/toy/height?lon=1&lat=1", line), k == 1 ? 503 : 403);
        ask("GET", "/collections", line, &r);
        assert_int_equal(strstr((const char *)r.body, "\"toy\"") != NULL, k < 2);
        buf_free(&r.raw);
        ask("GET", "/collections", "", &r);
        assert_null(strstr((const char *)r.body, "\"toy\""));
        buf_free(&r.raw);
        ask("GET", "/version", "", &r);
        assert_null(strstr((const char *)r.body, "\"toy\""));
        buf_free(&r.raw);
        const int64_t now_s = (int64_t)time(NULL);
        kit_ok(auth_open(path, &a, &e), e);
        kit_ok(auth_sign_path(a, NULL, target, now_s + 60, now_s, query, &e), e);
        snprintf(signed_target, sizeof signed_target, "%s?%s", target, query);
        assert_int_equal(status_of("GET", signed_target, ""), 200);
        /* a document names what this signature does not open */
        kit_ok(auth_sign_path(a, NULL, "/d/toy/map.json", now_s + 60, now_s, query, &e), e);
        snprintf(signed_target, sizeof signed_target, "/d/toy/map.json?%s", query);
        assert_int_equal(status_of("GET", signed_target, ""), 403);
        kit_ok(auth_sign(a, NULL, AUTH_SCOPE_BOTH, "toy", now_s - 1, now_s, seal, &e), e);
        snprintf(signed_target, sizeof signed_target, "/signed/%s%s", seal, target);
        assert_int_equal(status_of("GET", signed_target, ""), 403);
        auth_close(&a);
        server_stop(&t.server);
    }
}

/* What a seal does not open, and what it does not tell. */
static void seal_opens_no_more(const char *base, const char *seal)
{
    char target[900], want[400], tile[128];
    struct reply r;
    tile_target(17, "glb", tile);
    snprintf(target, sizeof target, "%s%s", base, tile);
    assert_int_equal(status_of("GET", target, ""), 200);
    snprintf(target, sizeof target, "%s/d/other/tileset.json", base);
    assert_int_equal(status_of("GET", target, ""), 403);
    snprintf(target, sizeof target, "%s%s%s", base, base, tile); /* not twice */
    assert_int_equal(status_of("GET", target, ""), 404);
    ask("GET", base, "", &r); /* relative addresses need the slash */
    assert_int_equal(r.status, 308);
    snprintf(want, sizeof want, "%s/", seal);
    assert_string_equal(header(&r, "Location"), want);
    buf_free(&r.raw);
    snprintf(target, sizeof target, "%sx%s", base, tile);
    ask("GET", target, "", &r);
    assert_int_equal(r.status, 403);
    assert_null(strstr((const char *)r.body, seal)); /* no problem document repeats it */
    buf_free(&r.raw);
    snprintf(target, sizeof target, "%s/nothing", base);
    ask("GET", target, "", &r);
    assert_int_equal(r.status, 404);
    assert_null(strstr((const char *)r.body, seal));
    buf_free(&r.raw);
}

/* A client that guesses tokens waits; one behind a trusted proxy does not wait for another. */
static void test_guesses_wait(void **state)
{
    enum { TRIES = 10 };
    char path[FILE_PATH_MAX], right[256], wrong[256];
    static const char *const clients[] = {"X-Forwarded-For: 203.0.113.7\r\n",
                                          "X-Forwarded-For: 203.0.113.8\r\n"};
    struct reply r;
    t.cfg.auth = rights_file("\"read:toy\"", "", path);
    t.cfg.trusted_proxy = "127.0.0.1";
    start();
    snprintf(wrong, sizeof wrong, "{\"token\": \"%s\"}", "another-token-that-is-not-in-it");
    snprintf(right, sizeof right, "{\"token\": \"%s\"}", TOKEN);
    for (int i = 0; i < 3 * TRIES; i++) { /* right ones count nothing */
        const char *body = i < 2 * TRIES ? right : wrong;
        char extra[160], text[600];
        snprintf(extra, sizeof extra, "%sContent-Length: %zu\r\n", clients[0], strlen(body));
        snprintf(text, sizeof text,
                 "POST /session HTTP/1.1\r\nHost: localhost\r\n%sConnection: "
                 "close\r\n\r\n%s",
                 extra, body);
        int fd = dial(t.port);
        say(fd, text);
        hear(fd, true, NULL, &r);
        assert_int_equal(r.status, i < 2 * TRIES ? 204 : 403);
        buf_free(&r.raw);
        close(fd);
    }
    for (int i = 0; i < 2; i++) {
        char text[600];
        snprintf(text, sizeof text,
                 "POST /session HTTP/1.1\r\nHost: localhost\r\n%sContent-Length: "
                 "%zu\r\nConnection: close\r\n\r\n%s",
                 clients[i], strlen(right), right);
        int fd = dial(t.port);
        say(fd, text);
        hear(fd, true, NULL, &r);
        assert_int_equal(r.status, i ? 204 : 429); /* not even the right one is looked at */
        if (!i)
            assert_true(atoi(header(&r, "Retry-After")) >= 1 &&
                        atoi(header(&r, "Retry-After")) <= 6);
        buf_free(&r.raw);
        close(fd);
    }
}

/* With --public-url no answer depends on the name that a client says, and caches need not know of
 * it. Without it a stranger's X-Forwarded-Host counts for nothing. */
static void test_names_of_strangers(void **state)
{
    static const char *const documents[] = {"/d/toy/map.json", "/d/toy/style.json",
                                            "/d/toy/wmts.xml", "/collections/toy", "/"};
    static const char evil[] = "X-Forwarded-Host: evil.example\r\nX-Forwarded-Proto: https\r\n"
                               "Forwarded: host=evil.example\r\nAccept: text/html\r\n";
    struct reply r;
    for (int told = 0; told < 2; told++) {
        t.cfg.public_url = told ? "https://maps.example" : NULL;
        t.cfg.trusted_proxy = told ? "127.0.0.1" : NULL;
        start();
        for (size_t i = 0; i < sizeof documents / sizeof *documents; i++) {
            char text[600];
            snprintf(text, sizeof text,
                     "GET %s HTTP/1.1\r\nHost: %s\r\n%sConnection: close\r\n\r\n", documents[i],
                     told ? "evil.example" : "localhost", evil);
            int fd = dial(t.port);
            say(fd, text);
            hear(fd, true, NULL, &r);
            buf_u8(&r.raw, 0);
            assert_int_equal(r.status, 200);
            assert_null(strstr((const char *)r.raw.data, "evil.example"));
            if (told)
                assert_null(strstr(header(&r, "Vary"), "Host"));
            buf_free(&r.raw);
            close(fd);
        }
        server_stop(&t.server);
    }
}

/* Below a seal lies the whole service, and what is absolute in documents lies there, too. */
static void test_signed_addresses(void **state)
{
    static const struct {
        const char *path, *has; /* %s: what stands before the path */
    } rows[] = {
        {"/collections", "\"id\": \"toy\""},
        {"/collections/toy/tiles.json", "\"../../d/toy/r/"},
        {"/collections/toy", "\"../d/toy/map.json\""},
        {"/d/toy/tileset.json", "\"uri\":\"r/"},
        {"/d/toy/map.json", "\"http://localhost%s/d/toy/r/"},
        {"/d/toy/terrain.json", "\"http://localhost%s/d/toy/r/"},
        {"/d/toy/style.json", "\"http://localhost%s/d/toy/r/"},
        {"/d/toy/wmts.xml", "\"http://localhost%s/d/toy/r/"},
        {"/d/toy/seed.ndjson?z=15-17", "{\"url\":\"r/"},
        {"/version", "\"toy\""},
        {"/healthz", "ok"},
    };
    char path[FILE_PATH_MAX], seal[AUTH_SEAL_MAX], base[300], target[900], want[400];
    struct err e = {0};
    struct reply r;
    struct auth *a = NULL;
    t.cfg.auth = rights_file("\"admin\"", "", path);
    start();
    kit_ok(auth_open(path, &a, &e), e);
    const int64_t now_s = (int64_t)time(NULL);
    kit_ok(auth_sign(a, NULL, AUTH_SCOPE_BOTH, "toy", now_s + 60, now_s, seal, &e), e);
    snprintf(base, sizeof base, "/signed/%s", seal);
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        snprintf(target, sizeof target, "%s%s", base, rows[i].path);
        ask("GET", target, "", &r);
        const char *mark = strstr(rows[i].has, "%s");
        snprintf(want, sizeof want, "%.*s%s%s", (int)(mark ? mark - rows[i].has : 0), rows[i].has,
                 mark ? base : "", mark ? mark + 2 : rows[i].has);
        if (r.status != 200 || !strstr((const char *)r.body, want))
            fail_msg("%s: %d without %s: %s", target, r.status, want, (const char *)r.body);
        if (rows[i].path[1] == 'd')
            assert_non_null(strstr(header(&r, "Cache-Control"), "private"));
        assert_string_equal(header(&r, "Referrer-Policy"), "strict-origin");
        buf_free(&r.raw);
    }
    seal_opens_no_more(base, seal);
    auth_close(&a);
}

static void test_sessions(void **state)
{
    char path[FILE_PATH_MAX], body[128], target[128], cookie[AUTH_SEAL_MAX + 64];
    struct reply r;
    t.cfg.auth = rights_file("\"read:toy\"", "", path);
    start();
    tile_target(17, "glb", target);
    snprintf(body, sizeof body, "{\"token\": \"%s\"}", TOKEN);
    assert_int_equal(post_text("/session", "{\"token\": \"wrong\"}", &r), 403);
    buf_free(&r.raw);
    assert_int_equal(post_text("/session", "[]", &r), 400);
    buf_free(&r.raw);
    assert_int_equal(post_text("/session", body, &r), 204);
    const char *set = header(&r, "Set-Cookie");
    assert_non_null(strstr(set, "; HttpOnly; SameSite=Lax"));
    assert_null(strstr(set, "Secure")); /* the client came without TLS */
    snprintf(cookie, sizeof cookie, "Cookie: %.*s\r\n", (int)strcspn(set, ";"), set);
    assert_string_equal(header(&r, "Cache-Control"), "no-store");
    buf_free(&r.raw);
    assert_int_equal(status_of("GET", target, ""), 401);
    assert_int_equal(status_of("GET", target, "Cookie: citysplat=1.2.3.4.5\r\n"), 401);
    ask("GET", target, cookie, &r);
    assert_int_equal(r.status, 200);
    assert_non_null(strstr(header(&r, "Cache-Control"), "private"));
    buf_free(&r.raw);
    ask("GET", "/collections", cookie, &r);
    assert_non_null(strstr((const char *)r.body, "\"toy\""));
    buf_free(&r.raw);
    assert_int_equal(status_of("GET", "/d/toy/height?lon=1&lat=1", cookie), 403);
    snprintf(body, sizeof body, "token=%s&x=1", TOKEN); /* of the form, which then goes home */
    assert_int_equal(post_text("/session", body, &r), 303);
    assert_string_equal(header(&r, "Location"), "./");
    buf_free(&r.raw);
    ask("GET", "/session", "", &r);
    assert_int_equal(r.status, 200);
    assert_non_null(strstr((const char *)r.body, "name=\"token\""));
    buf_free(&r.raw);
    assert_int_equal(post_text("/session:end", "", &r), 204);
    assert_non_null(strstr(header(&r, "Set-Cookie"), "citysplat=; Path=/; Max-Age=0;"));
    buf_free(&r.raw);
    /* a page elsewhere gives nobody a session */
    ask("POST", "/session", "Origin: https://elsewhere.example\r\nContent-Length: 0\r\n", &r);
    assert_int_equal(r.status, 403);
    buf_free(&r.raw);
    ask("POST", "/session", "Origin: http://localhost\r\nContent-Length: 0\r\n", &r);
    assert_int_equal(r.status, 400);
    buf_free(&r.raw);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        HTTP_TEST(test_files_of_auth), HTTP_TEST(test_signatures),
        HTTP_TEST(test_session_seals), HTTP_TEST(test_signed_addresses),
        HTTP_TEST(test_sessions),      HTTP_TEST(test_private_datasets),
        HTTP_TEST(test_guesses_wait),  HTTP_TEST(test_names_of_strangers),
    };
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
