/* Fuzz targets for data from clients and from operators of the server: see fuzz.h. Besides crashes,
 * they check promises about each result.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <assert.h>
#include <jansson.h>
#include <math.h>
#include <string.h>

#include "core/options/options.h"
#include "core/splat/appearance.h"
#include "lod/surface/query.h"
#include "server/access/auth.h"
#include "server/access/cache_policy.h"
#include "server/answers/posted_view.h"
#include "server/answers/routes.h"
#include "server/base/address.h"
#include "server/base/condition.h"
#include "server/base/text.h"
#include "server/documents/appearance_api.h"
#include "server/http/request_guard.h"
#include "server/http/request_screen.h"
#include "server/route/router.h"
#include "server/route/target_query.h"
#include "tests/fuzz/fuzz.h"

static const struct options_def serve_defs[] = {
#define OPT(...) OPTIONS_ROW(struct server_config, __VA_ARGS__)
#include "server/base/options.def"
};
static const struct options_spec serve_spec = {
    .command = "serve", .defs = serve_defs, .n_defs = sizeof serve_defs / sizeof *serve_defs};
static const struct geo_origin serve_origin = {8.6821, 50.1109, 160};

static char *serve_text(const uint8_t *bytes, size_t n)
{
    char *text = mem_array(n + 1, 1);
    assert(text);
    if (n)
        memcpy(text, bytes, n);
    return text;
}

/* ---- request line ---- */

void fuzz_target(const uint8_t *bytes, size_t n)
{
    static struct router *routes; /* once for all inputs */
    union target_any any, again;
    const struct target *t = &any.all;
    char query[TARGET_QUERY_MAX];
    if (!routes)
        assert(!router_open(ROUTES, ROUTES_COUNT, &routes, NULL));
    if (router_read(routes, (const char *)bytes, n, &any, NULL))
        return;
    assert(t->path_size <= n);
    assert(strspn(t->names.ds, "abcdefghijklmnopqrstuvwxyz0123456789_-") == strlen(t->names.ds));
    assert(strspn(t->names.rev, "0123456789abcdef") == strlen(t->names.rev));
    if (target_is(t, "view")) {
        const struct target_pose *pose = &any.of_view.view.pose;
        assert(pose->fov_e3 >= 1000 && pose->heading_e3 >= 0);
    } else if (target_is(t, "kept")) {
        assert(param_is_kept_name(t->names.kept));
    } else if (target_is(t, "tile")) {
        assert(key_valid(any.of_tile.cell.key));
        target_query_tiles(&any.of_tile.tiles, query);
        assert(strlen(query) < sizeof query);
    }
    for (size_t i = 0; i < t->path_size; i++)
        assert(bytes[i] > 0x20 && bytes[i] < 0x7f && bytes[i] != '%' && bytes[i] != '"');
    assert(!router_read(routes, (const char *)bytes, n, &again, NULL) &&
           again.all.route == t->route);
}

/* ---- fields ---- */

/* Bytes through the screen in pieces, then the lines that it lets pass through the guard. */
void fuzz_headers(const uint8_t *bytes, size_t n)
{
    static struct server_config cfg = {.max_target_bytes = 2048, .max_body_kb = 64};
    struct request_screen s = {0};
    struct request r = {.target = "/", .target_size = 1};
    struct request_guard g = {.req = &r};
    char *out = mem_array(n + 4096, 1);
    size_t got = 0;
    assert(out);
    if (request_screen_attach(&s, 1000, NULL, 4096, NULL)) {
        mem_free(out);
        return;
    }
    for (size_t at = 0, piece = 1; at < n; at += piece, piece = piece % 97 + 1) {
        request_screen_put(&s, (const char *)bytes + at, piece < n - at ? piece : n - at);
        for (size_t k;
             got < n + 4095 && (k = request_screen_take(&s, out + got, n + 4095 - got)) > 0;)
            got += k;
        piece = piece < n - at ? piece : n - at;
    }
    assert(!request_screen_refused(&s, s.requests + 1)); /* of what has not come nothing is known */
    char *save = NULL;
    for (char *line = strtok_r(out, "\r\n", &save); line; line = strtok_r(NULL, "\r\n", &save)) {
        char *colon = strchr(line, ':');
        if (!colon)
            continue;
        *colon++ = '\0';
        colon += strspn(colon, " \t");
        request_guard_field(&g, line, strlen(line), colon, strlen(colon));
    }
    const char *why;
    (void)request_guard_check(&g, &cfg, "HTTP/1.1", &why);
    (void)request_guard_alone(&g, "HTTP/1.1");
    struct address_nets nets;
    if (!address_read_nets("10.0.0.0/8,::1", &nets, NULL)) {
        struct address peer = {.ip = {[10] = 0xff, 0xff, 10, 1, 2, 3}};
        char text[ADDRESS_TEXT];
        address_write(address_client(&nets, peer, r.forwarded, r.n_forwarded), text, sizeof text);
    }
    request_screen_detach(&s, 1000);
    mem_free(out);
}

void fuzz_range(const uint8_t *bytes, size_t n)
{
    uint64_t size = 0, first = 0, length = 0;
    if (n < 8)
        return;
    memcpy(&size, bytes, 8);
    char *text = serve_text(bytes + 8, n - 8);
    enum condition_range got = condition_range(text, size, &first, &length);
    assert(got != RANGE_PART || (length && first < size && length <= size - first));
    (void)condition_none_match(text, "\"AAAAAAAAAAAAAAAAAAAAAA\"");
    (void)condition_not_modified(text, 1700000000);
    /* What may be written if it matches may not be if it must not. */
    assert(!condition_may_write(text, text, "\"AAAAAAAAAAAAAAAAAAAAAA\"") &&
           !condition_may_write(text, NULL, NULL));
    mem_free(text);
}

void fuzz_accept(const uint8_t *bytes, size_t n)
{
    char *text = serve_text(bytes, n);
    bool gzip = condition_gzip(text), html = condition_html(text);
    assert(n || (!gzip && !html));
    mem_free(text);
}

/* ---- bodies ---- */

/* What is posted to mix, and put under a name. */
static void serve_mix(const uint8_t *bytes, size_t n)
{
    static struct appearance a;
    const struct dataset d = {.appearance = &a};
    char text[TARGET_APPEARANCE_MAX];
    if (!a.w1 && appearance_alloc(&a, 2, 3, 4, 1, NULL))
        return;
    if (!appearance_api_read_mix(&d, bytes, n, text, NULL))
        assert(*text && strlen(text) < sizeof text && text_is_utf8(text));
}

void fuzz_body(const uint8_t *bytes, size_t n)
{
    serve_mix(bytes, n);
    static struct server_config cfg = {
        .max_view_px = 2048, .max_view_mpx = 4, .quality = 85, .deadline_s = 15};
    struct posted_view p;
    struct err e = {0};
    json_t *o = NULL;
    for (int motion = 0; motion < 2; motion++)
        if (!(motion ? posted_view_read_stream(&cfg, &serve_origin, bytes, n, &p, &e)
                     : posted_view_read(&cfg, &serve_origin, bytes, n, &p, &e))) {
            assert(isfinite(p.cam.fx_px) && p.cam.fx_px > 0 && isfinite(p.cam.trans[0]));
            assert(p.cam.width_px && p.cam.height_px && p.quality >= 1 && p.quality <= 100);
            assert(p.timeout_s > 0 && p.timeout_s <= 30 && p.number >= 0);
        }
    if (n && !jsonc_parse((const char *)bytes, n, "body", &o, &e))
        for (int k = QUERY_HEIGHT; k <= QUERY_VISIBLE; k++) {
            struct query *q = mem_array(1, sizeof *q);
            if (q)
                (void)!query_read((enum query_kind)k, o, &serve_origin, q, &e);
            mem_free(q);
        }
    json_decref(o);
}

/* ---- what operators write ---- */

void fuzz_conf(const uint8_t *bytes, size_t n)
{
    struct arena arena = {0};
    struct server_config cfg;
    struct address_nets nets;
    struct cache_policy policy;
    struct auth *auth = NULL;
    json_t *o = NULL, *back = NULL;
    char *text = serve_text(bytes, n), query[AUTH_QUERY_MAX], seal[AUTH_SEAL_MAX];
    int64_t for_s;
    (void)!address_read_nets(text, &nets, NULL);
    if (!cache_policy_read(text, &policy, NULL))
        assert(cache_policy_of(&policy, "x", true, "no-store"));
    if (n && !auth_parse(text, n, "auth", &auth, NULL)) {
        struct auth_request r = {.authorization = text, .path = "/d/x/", .query = text};
        r.n_path = 5;
        r.n_query = n;
        (void)auth_check(auth, AUTH_READ, "x", &r, 5);
        r.authorization = NULL;
        r.cookie = text;
        (void)auth_check(auth, AUTH_READ, "x", &r, 5);
        (void)auth_check_seal(auth, text, n, 5);
        (void)auth_session(auth, text, 5, seal, &for_s);
        if (!auth_sign(auth, NULL, AUTH_SCOPE_READ, "x", 10, 5, seal, NULL)) {
            r = (struct auth_request){.path = "", .query = "", .seal = seal};
            r.n_seal = strlen(seal);
            assert(auth_check(auth, AUTH_READ, "x", &r, 5) == AUTH_OK);
            assert(auth_is_public(auth, "x") ||
                   auth_check(auth, AUTH_RENDER, "x", &r, 5) == AUTH_FORBIDDEN);
        }
        if (!auth_sign_path(auth, NULL, "/d/x/t", 10, 5, query, NULL)) {
            r = (struct auth_request){.path = "/d/x/t", .query = query};
            r.n_path = 6;
            r.n_query = strlen(query);
            assert(auth_check(auth, AUTH_READ, "x", &r, 5) == AUTH_OK);
        }
    }
    auth_close(&auth);
    if (n && !options_defaults(&serve_spec, &cfg, &arena, NULL) &&
        !jsonc_parse(text, n, "conf", &o, NULL) && json_is_object(o) &&
        !options_from_json(&serve_spec, o, &cfg, &arena, NULL)) {
        assert(cfg.port >= 0 && cfg.port <= 65535 && cfg.cache_mb >= 0);
        assert(!options_to_json(&serve_spec, &cfg, &back, NULL));
        assert(!options_from_json(&serve_spec, back, &cfg, &arena, NULL));
    }
    json_decref(back);
    json_decref(o);
    mem_free(text);
    arena_free(&arena);
}

/* ---- seeds ---- */

bool fuzz_seed_serve(const char *target, size_t i, struct buf *out)
{
    static const struct {
        const char *target, *text[FUZZ_SEEDS];
    } seeds[] = {
        {"target",
         {"/d/toy/r/0123456789ab/t/17/70406/43020.glb?preset=balanced&sh=1&appearance=a%2Cb",
          "/d/toy/r/0123456789ab/static/13.4,52.5,150@10.5,-40,55,3/"
          "640x480@2x.png?background=sky&depth=cm",
          "/d/toy/seed.ndjson?bbox=1,2%2C3,4&z=12-16&f=plain.glb&exp=1&key=k&scope=/d/&sig=x"}},
        {"headers",
         {"GET / HTTP/1.1\r\nHost: a\r\nAccept: */*\r\nRange: bytes=0-1\r\n\r\n",
          "POST /d/toy/render HTTP/1.1\r\nHost: [::1]:80\r\nContent-Length: 2\r\n\r\n{}GET / "
          "HTTP/1.1\r\n"
          "Host: a\r\nX-Forwarded-For: 1.2.3.4, [::1]:8\r\n\r\n",
          "POST / HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: chunked\r\n\r\n2;x=y\r\n{}\r\n0\r\nA: "
          "b\r\n\r\n"}},
        {"range",
         {"\x10\x27\0\0\0\0\0\0bytes=10-19",
          "\xff\xff\0\0\0\0\0\0"
          "bytes=-500",
          "\1\0\0\0\0\0\0\0W/\"AAAAAAAAAAAAAAAAAAAAAA\", \"b\""}},
        {"accept",
         {"gzip;q=0.5, br, *;q=0", "text/html,application/xhtml+xml;q=0.9,*/*;q=0.8",
          "application/json, text/html;q=0.1"}},
        {"body",
         {"{\"pose\":{\"lon\":8.68,\"lat\":50.1,\"height\":260,\"heading\":10,\"pitch\":-30,"
          "\"fov\":60},"
          "\"width\":640,\"height\":480,\"format\":\"png\",\"number\":3,\"still\":true}",
          "{\"camera\":{\"width\":64,\"height\":48,\"fx\":60,\"fy\":60,\"cx\":32,\"cy\":24,"
          "\"world_to_camera\":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]},\"quality\":50,\"depth\":\"cm\","
          "\"format\":\"png\"}",
          "{\"polygon\":[[7.57,47.55],[7.58,47.55],[7.57,47.56]],\"base\":\"rim\",\"gsd_m\":0.5}"}},
        {"conf",
         {"// a file\n{\"port\": 80, \"device\": \"none\", \"admin\": \"127.0.0.1:9090\", "
          "\"keep_s\": 3.5}",
          "{\"public\":[\"a\"],\"keys\":{\"k\":\"0123456789abcdef0123456789abcdef\"},\"tokens\":[{"
          "\"sha256\":"
          "\"00112233445566778899aabbccddeeff00112233445566778899aabbccddeeff\",\"scope\":[\"read:*"
          "\"]}]}",
          "a=private,b=300,*=no-store"}},
    };
    for (size_t k = 0; k < sizeof seeds / sizeof *seeds; k++) {
        if (strcmp(seeds[k].target, target) != 0)
            continue;
        const char *text = seeds[k].text[i];
        size_t head = strcmp(target, "range") ? 0 : 8; /* a number, with zeros in it */
        buf_add(out, text, head + strlen(text + head));
        return !out->failed;
    }
    return false;
}
