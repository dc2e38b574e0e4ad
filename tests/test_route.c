/* Routes as pure calls: what each target parses to, what each request is answered, header by
 * header. No socket is opened; jobs are run by the test itself.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/store.h"
#include "lod/view.h"
#include "tests/served.h"

#include <jansson.h>
#include <math.h>

static struct {
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], web[FILE_PATH_MAX], rev[13];
    struct arena arena;
    struct server_config cfg;
    struct services s;
    struct picture *picture; /* one that never starts: views become jobs that nobody runs here */
} t;

static enum err_code no_run(void *user, const struct job *j, void *work, size_t worker,
                            struct body **out, struct err *e)
{
    (void)user, (void)j, (void)work, (void)worker, (void)out;
    return err_set(e, ERR_INTERNAL, "the test runs jobs itself");
}

static int setup(void **state)
{
    struct err e = {0};
    char path[FILE_PATH_MAX];
    (void)state;
    kit_tmpdir(t.dir);
    kit_ok(file_join(t.path, t.dir, "toy.tiles", &e), e);
    served_city(t.path, "toy", 50);
    kit_ok(file_join(t.web, t.dir, "web", &e), e);
    kit_ok(file_join(path, t.web, "assets", &e), e);
    kit_ok(file_mkdir(path, &e), e);
    kit_ok(file_join(path, t.web, "index.html", &e), e);
    kit_ok(file_write(path, "<!doctype html><title>viewer</title>", 36, &e), e);
    kit_ok(file_join(path, t.web, "assets/index-D3adBeef.js", &e), e);
    char script[2000];
    memset(script, ';', sizeof script);
    kit_ok(file_write(path, script, sizeof script, &e), e);
    served_config(&t.cfg, &t.arena);
    kit_ok(services_open(&t.s, &t.cfg, &e), e);
    const char *paths[] = {t.path};
    kit_ok(catalog_open(paths, 1, 1, NULL, NULL, &t.s.catalog, &e), e);
    kit_ok(static_load(t.web, &t.s.web, &e), e);
    const struct job_config jobs = {.queue_limit = {1, 1, 1}, .run = no_run, .drop = work_drop};
    kit_ok(job_open(&jobs, &t.s.jobs, &e), e);
    memcpy(t.rev, t.s.catalog->ds[0]->meta.revision, sizeof t.rev);
    return 0;
}

static int teardown(void **state)
{
    (void)state;
    services_free(&t.s);
    arena_free(&t.arena);
    kit_rmdir(t.dir);
    return 0;
}

/* "REV" in text becomes the revision, "KEY15" etc. the tile about the origin. */
static const char *expand(const char *text, char *out, size_t room)
{
    size_t n = 0;
    while (*text && n + 40 < room) {
        struct key k;
        if (!strncmp(text, "REV", 3)) {
            n += (size_t)snprintf(out + n, room - n, "%s", t.rev);
            text += 3;
        } else if (!strncmp(text, "KEY", 3)) {
            k = served_key((uint8_t)((text[3] - '0') * 10 + text[4] - '0'));
            n += (size_t)snprintf(out + n, room - n, "%u/%u/%u", k.z, k.x, k.y);
            text += 5;
        } else {
            out[n++] = *text++;
        }
    }
    out[n] = 0;
    return out;
}

struct ask { /* the request in short */
    enum method method;
    const char *target, *accept, *accept_encoding, *if_none_match, *if_range, *range, *body;
};

static char last_target[4096];

/* Ask, and if a job is needed, do its work as a worker would. */
static struct response answer(const struct ask *a)
{
    struct request r = {
        .method = a->method,
        .target = expand(a->target, last_target, sizeof last_target),
        .accept = a->accept,
        .accept_encoding = a->accept_encoding,
        .if_none_match = a->if_none_match,
        .if_range = a->if_range,
        .range = a->range,
        .body = a->body,
        .body_size = a->body ? strlen(a->body) : 0,
        .local = true,
    };
    r.target_size = strlen(r.target);
    struct response out;
    route_answer(&t.s, &r, &out);
    if (out.work && out.work->kind != WORK_VIEW) {
        struct err e = {0};
        struct work *w = out.work;
        struct job_result result = {.end = JOB_OK};
        out.work = NULL;
        result.code = work_run(&t.s, NULL, w, 0, &result.body, &e);
        if (result.code != ERR_OK) {
            result.end = JOB_ERROR;
            snprintf(result.msg, sizeof result.msg, "%.200s", e.msg);
        }
        work_drop(NULL, w);
        route_finish(&t.s, &r, &result, &out);
    }
    return out;
}

static struct response get(const char *target)
{
    return answer(&(struct ask){.target = target});
}

static void expect(const char *what, const char *got, const char *want)
{
    if (strcmp(got ? got : "", want ? want : "") != 0)
        fail_msg("%s: %s is '%s', want '%s'", last_target, what, got ? got : "", want ? want : "");
}

static json_t *json_of(const struct response *r)
{
    json_error_t je;
    json_t *o = json_loadb((const char *)r->data, r->size, JSON_REJECT_DUPLICATES, &je);
    if (!o)
        fail_msg("%s: not JSON: %s line %d", last_target, je.text, je.line);
    return o;
}

/* ---- answers ---- */

static const char IMMUTABLE[] = "public, max-age=31536000, immutable";
static const char MOVING[] = "public, max-age=60, stale-while-revalidate=600, stale-if-error=86400";

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
        {"/d/toy/r/REV/tileset.json", "application/json", IMMUTABLE},
        {"/healthz", "application/json", "no-store"},
        {"/readyz", "application/json", "no-store"},
        {"/version", "application/json", "no-store"},
    };
    (void)state;
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
    (void)state;
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
    (void)state;
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

static void test_links_lead_somewhere(void **state)
{
    static const char *const docs[][2] = {
        {"/", "/"}, {"/collections", "/"}, {"/collections/toy", "/collections/"}};
    (void)state;
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
            else
                snprintf(path, sizeof path, "%s%s", docs[i][1], !strcmp(href, "./") ? "" : href);
            struct response to = get(path);
            assert_int_equal(to.status, 200);
            response_free(&to);
        }
        json_decref(o);
        response_free(&r);
    }
}

/* The service description has every route, and no route that is not answered. */
static void test_api_lists_the_routes(void **state)
{
    struct response r = get("/api");
    json_t *o = json_of(&r), *paths = json_object_get(o, "paths");
    (void)state;
    for (int k = 0; k < ROUTE_NONE; k++)
        if (k != ROUTE_STATIC)
            assert_non_null(json_object_get(paths, target_path((enum route)k)));
    assert_int_equal(json_object_size(paths), ROUTE_NONE - 1);
    json_decref(o);
    response_free(&r);
}

static void test_tileset_uris(void **state)
{
    char want[128];
    (void)state;
    struct response fixed = get("/d/toy/r/REV/tileset.json"), moving = get("/d/toy/tileset.json");
    struct response tilejson = get("/collections/toy/tiles.json");
    assert_non_null(strstr((const char *)fixed.data, expand("\"t/KEY15.glb\"", want, sizeof want)));
    assert_non_null(
        strstr((const char *)moving.data, expand("\"r/REV/t/KEY15.glb\"", want, sizeof want)));
    assert_non_null(strstr((const char *)tilejson.data,
                           expand("\"../../d/toy/r/REV/t/{z}/{x}/{y}.glb\"", want, sizeof want)));
    response_free(&fixed);
    response_free(&moving);
    response_free(&tilejson);
}

static void test_tiles(void **state)
{
    static const struct {
        const char *ext, *type, *magic;
    } rows[] = {
        {"glb", "model/gltf-binary", "glTF"},
        {"plain.glb", "model/gltf-binary", "glTF"},
        {"spz", "application/octet-stream", "\x1f\x8b"},
        {"drc", "application/octet-stream", "DRACO"},
        {"ply", "application/octet-stream", "ply\n"},
    };
    (void)state;
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        char target[128];
        snprintf(target, sizeof target, "/d/toy/r/REV/t/KEY17.%s", rows[i].ext);
        struct response r = get(target);
        assert_int_equal(r.status, 200);
        expect("cache", r.cache, "miss");
        expect("type", r.type, rows[i].type);
        expect("Cache-Control", r.cache_control, IMMUTABLE);
        expect("Vary", r.vary, NULL);
        assert_true(r.accept_ranges);
        assert_true(r.size > 100);
        assert_memory_equal(r.data, rows[i].magic, strlen(rows[i].magic));
        char surrogate[128];
        expect("Surrogate-Key", r.surrogate,
               expand("ds-toy rev-REV z-17", surrogate, sizeof surrogate));
        struct response again = get(target);
        expect("cache", again.cache, "hit");
        assert_ptr_equal(again.body, r.body);
        assert_string_equal(again.etag, r.etag);
        /* 304 repeats what a cache must know */
        struct response same = answer(&(struct ask){.target = target, .if_none_match = r.etag});
        assert_int_equal(same.status, 304);
        expect("ETag", same.etag, r.etag);
        expect("Cache-Control", same.cache_control, IMMUTABLE);
        response_free(&same);
        response_free(&again);
        response_free(&r);
    }
    /* a name of the bytes decides 304 without the bytes: this tile was never made */
    struct response cold = get("/d/toy/r/REV/t/KEY15.spz");
    char etag[BODY_ETAG_SIZE], weak[BODY_ETAG_SIZE + 2];
    memcpy(etag, cold.etag, sizeof etag);
    snprintf(weak, sizeof weak, "W/%s", etag);
    response_free(&cold);
    cache_close(&t.s.cache);
    struct err e = {0};
    kit_ok(cache_open((size_t)64 << 20, &t.s.cache, &e), e);
    const char *target = expand("/d/toy/r/REV/t/KEY15.spz", last_target, sizeof last_target);
    struct request q = {.target = target, .target_size = strlen(target), .if_none_match = weak};
    struct response r;
    route_answer(&t.s, &q, &r);
    assert_int_equal(r.status, 304);
    assert_null(r.work);
    response_free(&r);
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
        {METHOD_GET, "/d/toy/r/000000000000/tileset.json", 404, NULL, "public, max-age=60"},
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
    (void)state;
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
        assert_null(strstr((const char *)r.data, "secret")); /* input is not echoed */
        json_decref(o);
        response_free(&r);
    }
    struct response r = answer(&(struct ask){.method = METHOD_OPTIONS, .target = "/d/toy/render"});
    assert_int_equal(r.status, 204);
    expect("Allow", r.allow, "POST, OPTIONS");
    response_free(&r);
}

static void test_redirects(void **state)
{
    char want[256];
    (void)state;
    struct response r = get("/d/toy/t/KEY17.glb");
    assert_int_equal(r.status, 307);
    expect("Location", r.location, expand("../../../r/REV/t/KEY17.glb", want, sizeof want));
    response_free(&r);
    r = get("/d/toy/static/13.4,52.5,120@0,-90/64x64.jpg");
    assert_int_equal(r.status, 307);
    expect("Location", r.location,
           expand("../../r/REV/static/13.4,52.5,120@0,-90/64x64.jpg", want, sizeof want));
    expect("Cache-Control", r.cache_control, MOVING);
    response_free(&r);
}

static void test_viewer_files(void **state)
{
    static const char script[] = "/assets/index-D3adBeef.js";
    (void)state;
    struct response r = answer(&(struct ask){.target = "/", .accept = "text/html,*/*;q=0.8"});
    expect("type", r.type, "text/html; charset=utf-8");
    assert_non_null(r.vary);
    assert_non_null(strstr(r.vary, "Accept"));
    response_free(&r);
    r = answer(&(struct ask){.target = "/", .accept = "application/json, text/html;q=0.9"});
    expect("type", r.type, "application/json");
    response_free(&r);
    r = answer(&(struct ask){.target = script, .accept_encoding = "gzip"});
    assert_int_equal(r.status, 200);
    expect("type", r.type, "text/javascript; charset=utf-8");
    expect("Cache-Control", r.cache_control, IMMUTABLE);
    expect("Content-Encoding", r.encoding, "gzip");
    expect("Vary", r.vary, "Accept-Encoding");
    char etag[BODY_ETAG_SIZE];
    memcpy(etag, r.etag, sizeof etag);
    assert_non_null(strstr(etag, "-gz\""));
    response_free(&r);
    r = answer(&(struct ask){.target = script, .accept_encoding = "gzip", .if_none_match = etag});
    assert_int_equal(r.status, 304);
    response_free(&r);
    r = answer(&(struct ask){.target = script,
                             .if_none_match = etag}); /* the identity form has another name */
    assert_int_equal(r.status, 200);
    assert_int_equal(r.size, 2000);
    response_free(&r);
    r = get("/assets/index-D3adBeef");
    assert_int_equal(r.status, 404);
    response_free(&r);
}

static void test_ranges(void **state)
{
    const char *target = "/d/toy/r/REV/t/KEY17.ply";
    struct response whole = get(target);
    (void)state;
    assert_int_equal(whole.status, 200);
    struct buf sum = {0};
    size_t step = whole.size / 7 + 1;
    for (size_t at = 0; at < whole.size;
         at += step) { /* the parts, one after the other, are the whole */
        char range[64];
        snprintf(range, sizeof range, "bytes=%zu-%zu", at, at + step - 1);
        struct response part =
            answer(&(struct ask){.target = target, .range = range, .if_range = whole.etag});
        assert_int_equal(part.status, 206);
        assert_int_equal(part.range_first, at);
        assert_int_equal(part.range_total, whole.size);
        assert_string_equal(part.etag, whole.etag);
        buf_add(&sum, part.data, part.size);
        response_free(&part);
    }
    assert_int_equal(sum.size, whole.size);
    assert_memory_equal(sum.data, whole.data, whole.size);
    buf_free(&sum);
    struct response r = answer(&(struct ask){.target = target, .range = "bytes=99999999-"});
    assert_int_equal(r.status, 416);
    assert_int_equal(r.range_total, whole.size);
    response_free(&r);
    r = answer(&(struct ask){.target = target, .range = "bytes=0-9", .if_range = "\"another\""});
    assert_int_equal(r.status, 200);
    response_free(&r);
    r = answer(&(struct ask){.method = METHOD_HEAD, .target = target, .range = "bytes=0-9"});
    assert_int_equal(r.status, 200); /* Range is defined for GET alone */
    response_free(&r);
    response_free(&whole);
}

static void test_seed(void **state)
{
    struct response r = get("/d/toy/seed.ndjson");
    size_t lines = 0, last_z = 0;
    char *text = mem_array(r.size + 1, 1), *rest = NULL;
    (void)state;
    assert_int_equal(r.status, 200);
    expect("type", r.type, "application/x-ndjson");
    memcpy(text, r.data, r.size);
    for (char *line = strtok_r(text, "\n", &rest); line;
         line = strtok_r(NULL, "\n", &rest), lines++) {
        json_t *o = json_loads(line, 0, NULL);
        assert_non_null(o);
        char target[256];
        unsigned z;
        const char *url = json_string_value(json_object_get(o, "url"));
        assert_int_equal(sscanf(url, "r/%*12[0-9a-f]/t/%u/", &z), 1);
        assert_true(z >= last_z);
        last_z = z;
        snprintf(target, sizeof target, "/d/toy/%s", url);
        struct response tile = get(target);
        assert_int_equal(tile.status, 200);
        expect("etag", json_string_value(json_object_get(o, "etag")), tile.etag);
        response_free(&tile);
        json_decref(o);
    }
    assert_int_equal(lines, 4);
    mem_free(text);
    response_free(&r);
    r = get("/d/toy/seed.ndjson?z=17&f=drc");
    assert_non_null(strstr((const char *)r.data, ".drc"));
    assert_null(strstr((const char *)r.data, "/t/15/"));
    response_free(&r);
    r = get("/d/toy/seed.ndjson?bbox=0,0,1,1");
    assert_int_equal(r.status, 200);
    assert_int_equal(r.size, 0);
    response_free(&r);
}

/* Presets and degrees are bytes of their own, each with a tag of its own; what is not said is the
 * server's; what a format does not know makes no other bytes. */
static void test_presets(void **state)
{
    static const struct {
        const char *a, *b;
        bool same;
    } rows[] = {
        {"drc", "drc?preset=balanced", true},
        {"drc", "drc?preset=spz", false},
        {"drc?preset=preview", "drc?preset=near-lossless", false},
        {"glb", "glb?preset=preview", false},
        {"spz", "spz?v=17", true},
        {"spz?sh=0", "spz?sh=1", false},
        {"spz?sh=3", "spz", true},
        {"ply", "ply?preset=preview&sh=0", true},
        {"plain.glb", "plain.glb?preset=preview", true},
    };
    (void)state;
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        char target[128];
        snprintf(target, sizeof target, "/d/toy/r/REV/t/KEY17.%s", rows[i].a);
        struct response a = get(target);
        snprintf(target, sizeof target, "/d/toy/r/REV/t/KEY17.%s", rows[i].b);
        struct response b = get(target);
        assert_int_equal(a.status, 200);
        assert_int_equal(b.status, 200);
        bool same = a.size == b.size && !memcmp(a.data, b.data, a.size);
        if (same != rows[i].same || !strcmp(a.etag, b.etag) != rows[i].same)
            fail_msg("%s and %s: bytes %s, tags %s and %s", rows[i].a, rows[i].b,
                     same ? "equal" : "differ", a.etag, b.etag);
        response_free(&a);
        response_free(&b);
    }
    struct response r = get("/d/toy/t/KEY17.drc?preset=preview&sh=0");
    assert_int_equal(r.status, 307);
    assert_non_null(strstr(r.location, ".drc?preset=preview&sh=0"));
    response_free(&r);
    r = get("/d/toy/r/REV/t/KEY17.drc?preset=best");
    assert_int_equal(r.status, 400);
    response_free(&r);
    r = get("/d/toy/seed.ndjson?z=17&f=drc&preset=spz&sh=1");
    assert_non_null(strstr((const char *)r.data, ".drc?preset=spz&sh=1\","));
    response_free(&r);
}

/* A damaged tile is that tile's problem alone. */
static void test_damaged_tile(void **state)
{
    struct err e = {0};
    char path[FILE_PATH_MAX];
    struct catalog *damaged = NULL, *sound = t.s.catalog;
    (void)state;
    kit_ok(file_join(path, t.dir, "damaged.tiles", &e), e);
    served_city(path, "damaged", 20);
    store_fixture_damage(path, served_key(17), path);
    const char *paths[] = {path};
    kit_ok(catalog_open(paths, 1, 1, NULL, NULL, &damaged, &e), e);
    t.s.catalog = damaged;
    char target[256], where[64];
    snprintf(target, sizeof target, "/d/damaged/r/%s/t/%s.glb", damaged->ds[0]->meta.revision,
             expand("KEY17", where, sizeof where));
    struct response r = get(target);
    assert_int_equal(r.status, 500);
    assert_null(strstr((const char *)r.data, path)); /* no file name for the client */
    expect("type", r.type, "application/problem+json");
    expect("cache", r.cache_control, "no-store");
    json_t *o = json_of(&r);
    const struct key k = served_key(17);
    unsigned z, x, y;
    const char *dataset, *detail;
    assert_int_equal(json_unpack(o, "{s:s,s:s,s:{s:i,s:i,s:i}}", "detail", &detail, "dataset",
                                 &dataset, "tile", "z", &z, "x", &x, "y", &y),
                     0);
    assert_true(z == k.z && x == k.x && y == k.y);
    expect("dataset", dataset, "damaged");
    snprintf(where, sizeof where, "tile %u/%u/%u of dataset damaged is damaged", k.z, k.x, k.y);
    assert_non_null(strstr(detail, where));
    json_decref(o);
    response_free(&r);
    snprintf(target, sizeof target, "/d/damaged/r/%s/t/%s.glb", damaged->ds[0]->meta.revision,
             expand("KEY16", where, sizeof where));
    r = get(target);
    assert_int_equal(r.status, 200);
    response_free(&r);
    t.s.catalog = sound;
    catalog_drop(&damaged);
}

static void test_views(void **state)
{
    const char *target = "/d/toy/r/REV/static/13.4,52.5,120@0,-90/64x48.jpg";
    struct err e = {0};
    (void)state;
    struct response r = get(target);
    assert_int_equal(r.status, 503); /* --device none */
    assert_non_null(strstr((const char *)r.data, "--device none"));
    assert_in_range(r.retry_after_s, 1, 10);
    response_free(&r);
    kit_ok(picture_open(&t.cfg, &t.s.picture, &e), e); /* as while the device starts */
    r = get(target);
    assert_non_null(r.work);
    assert_int_equal(r.cls, JOB_VIEW);
    assert_int_equal(r.work->view.cam.width_px, 64);
    struct camera want;
    const struct view_pose pose = {13.4, 52.5, 120, 0, -90, 60};
    kit_ok(view_camera(&served_origin, &pose, 64, 48, &want, &e), e);
    for (int i = 0; i < 9; i++)
        assert_true(fabs(r.work->view.cam.rot[i] - want.rot[i]) < 1e-12);
    response_free(&r);
    r = get("/d/toy/r/REV/static/13.4,52.5,120@0,-90/4000x48.jpg");
    assert_int_equal(r.status, 422);
    response_free(&r);
    r = get("/d/toy/r/REV/static/13.4,52.5,120@0,-90/0x48.jpg");
    assert_int_equal(r.status, 422);
    response_free(&r);
    picture_close(&t.s.picture);
}

/* What a server is configured with is in the tag, and an address whose bytes depend on more than the
 * program's defaults is not immutable. */
static void test_configuration_and_tags(void **state)
{
    static const char *const immutable = "public, max-age=31536000, immutable";
    struct err e = {0};
    struct server_config usual = *t.s.cfg, other = usual;
    char target[256];
    const struct key k = served_key(17);
    (void)state;
    kit_ok(picture_open(t.s.cfg, &t.s.picture, &e), e);
    other.view_gaussians = 1000;
    other.preset = QUANT_PREVIEW;
    for (int view = 0; view < 2; view++) {
        if (view)
            snprintf(target, sizeof target, "/d/toy/r/%s/static/13.4,52.5,120@0,-90/64x48.png",
                     t.rev);
        else
            snprintf(target, sizeof target, "/d/toy/r/%s/t/%u/%u/%u.spz", t.rev, k.z, k.x, k.y);
        struct request r = {.target = target, .target_size = strlen(target)};
        struct response a = {0}, b = {0};
        route_answer(&t.s, &r, &a);
        t.s.cfg = &other;
        route_answer(&t.s, &r, &b);
        t.s.cfg = &usual;
        assert_string_not_equal(a.etag, b.etag);
        assert_string_equal(a.cache_control, immutable);
        assert_string_not_equal(b.cache_control, immutable);
        response_free(&a);
        response_free(&b);
    }
    t.s.cfg = &t.cfg;
    picture_close(&t.s.picture);
    struct response r = get("/d/toy/t/17/1/1.glb?x=%0d%0a"); /* encoded bytes stay encoded */
    assert_int_equal(r.status, 307);
    assert_null(strpbrk(r.location, "\r\n"));
    response_free(&r);
    static const char bad[] = "/d/toy/t/17/1/1.glb?x=\r\nSet-Cookie:a";
    struct request q = {.target = bad, .target_size = sizeof bad - 1};
    route_answer(&t.s, &q, &r);
    assert_int_equal(r.status, 400);
    response_free(&r);
}

static void test_posted_cameras(void **state)
{
    static const struct {
        const char *body;
        int status; /* 0: becomes a job */
    } rows[] = {
        {"{\"pose\":{\"lon\":13.4,\"lat\":52.5,\"height\":120,\"heading\":0,\"pitch\":-45},"
         "\"width\":64,\"height\":48}",
         0},
        {"{\"camera\":{\"width\":64,\"height\":48,\"fx\":50,\"fy\":50,\"cx\":32,\"cy\":24,\"world_"
         "to_camera\":"
         "[1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]},\"format\":\"png\",\"deadline_ms\":900}",
         0},
        {"", 400},
        {"{", 400},
        {"[]", 400},
        {"{\"a\":1,\"a\":2}", 400},
        {"{\"pose\":1e999}", 400},
        {"{}", 422},
        {"{\"camera\":{\"width\":64,\"height\":48,\"fx\":1e308,\"fy\":50,\"cx\":32,\"cy\":24,"
         "\"world_to_camera\":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}}",
         422},
        {"{\"camera\":{\"width\":64,\"height\":48,\"fx\":50,\"fy\":1e-308,\"cx\":32,\"cy\":24,"
         "\"world_to_camera\":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}}",
         422},
        {"{\"camera\":{\"width\":64,\"height\":48,\"fx\":50,\"fy\":50,\"cx\":1e300,\"cy\":24,"
         "\"world_to_camera\":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}}",
         422},
        {"{\"camera\":{\"width\":64,\"height\":48,\"fx\":50,\"fy\":50,\"cx\":32,\"cy\":24,\"world_"
         "to_camera\":[1,0,0,1e300,0,1,0,0,0,0,1,0,0,0,0,1]}}",
         422},
        {"{\"camera\":{}}", 422},
        {"{\"camera\":1}", 422},
        {"{\"pose\":{\"lon\":13,\"lat\":52,\"height\":1,\"heading\":0,\"pitch\":0}}", 422},
        {"{\"pose\":{\"lon\":13,\"lat\":92,\"height\":1,\"heading\":0,\"pitch\":0},\"width\":64,"
         "\"height\":48}",
         422},
        {"{\"pose\":{\"lon\":13,\"lat\":52,\"height\":1,\"heading\":0,\"pitch\":0,\"fov\":0},"
         "\"width\":64,\"height\":48}",
         422},
        {"{\"pose\":{\"lon\":13,\"lat\":52,\"height\":1,\"heading\":0,\"pitch\":0},\"width\":64,"
         "\"height\":99999}",
         422},
        {"{\"pose\":{\"lon\":13,\"lat\":52,\"height\":1,\"heading\":0,\"pitch\":0,\"roll\":1},"
         "\"width\":64,\"height\":48}",
         422},
        {"{\"pose\":{\"lon\":13,\"lat\":52,\"height\":1,\"heading\":0,\"pitch\":0},\"width\":64,"
         "\"height\":48,\"format\":\"gif\"}",
         422},
        {"{\"pose\":{\"lon\":13,\"lat\":52,\"height\":1,\"heading\":0,\"pitch\":0},\"width\":64,"
         "\"height\":48,\"quality\":101}",
         422},
        {"{\"pose\":{\"lon\":13,\"lat\":52,\"height\":1,\"heading\":0,\"pitch\":0},\"width\":64.5,"
         "\"height\":48}",
         422},
    };
    struct err e = {0};
    (void)state;
    kit_ok(picture_open(&t.cfg, &t.s.picture, &e), e);
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        struct response r = answer(
            &(struct ask){.method = METHOD_POST, .target = "/d/toy/render", .body = rows[i].body});
        if ((r.work ? 0 : r.status) != rows[i].status)
            fail_msg("%s: got %d (%.*s)", rows[i].body, r.status, (int)r.size,
                     (const char *)r.data);
        expect("Cache-Control", r.cache_control, "no-store");
        if (r.work)
            assert_false(r.work->keep);
        response_free(&r);
    }
    struct buf deep = {0};
    for (int i = 0; i < 30000; i++)
        buf_add(&deep, "[", 1);
    buf_add(&deep, "", 1);
    struct response r = answer(&(struct ask){
        .method = METHOD_POST, .target = "/d/toy/render", .body = (const char *)deep.data});
    assert_int_equal(r.status, 400);
    response_free(&r);
    buf_free(&deep);
    picture_close(&t.s.picture);
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
    (void)state;
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        struct request q = {.target = "/", .target_size = 1};
        struct response r = {.cache_control = IMMUTABLE, .cls = JOB_TILE, .queue_s = -1};
        struct job_result result = {.end = rows[i].end, .code = rows[i].code, .msg = "because"};
        route_finish(&t.s, &q, &result, &r);
        assert_int_equal(r.status, rows[i].status);
        assert_int_equal(r.retry_after_s > 0, rows[i].retry);
        assert_true(r.status == 404 || !strcmp(r.cache_control, "no-store"));
        response_free(&r);
    }
}

static void test_metrics_are_local(void **state)
{
    (void)state;
    struct response r = get("/metrics");
    assert_int_equal(r.status, 200);
    assert_non_null(strstr((const char *)r.data, "citysplat_dataset_info{ds=\"toy\""));
    response_free(&r);
    struct request q = {.target = "/metrics", .target_size = 8};
    route_answer(&t.s, &q, &r);
    assert_int_equal(r.status, 403);
    response_free(&r);
}

static void test_reload(void **state)
{
    struct err e = {0};
    char path[FILE_PATH_MAX];
    struct catalog *first = NULL, *second = NULL, *third = NULL;
    (void)state;
    kit_ok(file_join(path, t.dir, "moving.tiles", &e), e);
    const char *paths[] = {path};
    served_city(path, "moving", 10);
    kit_ok(catalog_open(paths, 1, 1, NULL, NULL, &first, &e), e);
    kit_ok(catalog_open(paths, 1, 1, NULL, first, &second, &e), e);
    assert_int_equal(second->n, 1);
    assert_ptr_equal(second->ds[0], first->ds[0]); /* unchanged: the same one */
    served_city(path, "moving", 11);
    kit_ok(catalog_open(paths, 1, 1, NULL, second, &third, &e), e);
    assert_int_equal(third->n, 2);
    struct dataset *now = catalog_find(third, "moving", ""), *old = first->ds[0];
    assert_string_not_equal(now->meta.revision, old->meta.revision);
    assert_ptr_equal(catalog_find(third, "moving", old->meta.revision), old);
    struct buf b = {
        0}; /* the older revision's tiles are read from the file that was renamed over */
    struct store *s = dataset_borrow(old);
    const struct form form = {FORMAT_SPZ, QUANT_BALANCED, 3};
    kit_ok(encode_tile(s, served_key(17), form, NULL, &b, &e), e);
    dataset_return(old, s);
    buf_free(&b);
    struct catalog *bad = NULL;
    kit_ok(file_write(path, "not a store", 11, &e), e);
    kit_fails(catalog_open(paths, 1, 1, NULL, third, &bad, &e), ERR_FORMAT, e, "moving.tiles");
    assert_null(bad);
    catalog_drop(&third);
    catalog_drop(&second);
    catalog_drop(&first);
    const char *twice[] = {t.path, t.path};
    kit_fails(catalog_open(twice, 2, 1, NULL, NULL, &bad, &e), ERR_ARG, e, "toy");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_documents),
        cmocka_unit_test(test_version),
        cmocka_unit_test(test_documents_without_memory),
        cmocka_unit_test(test_links_lead_somewhere),
        cmocka_unit_test(test_api_lists_the_routes),
        cmocka_unit_test(test_tileset_uris),
        cmocka_unit_test(test_tiles),
        cmocka_unit_test(test_refusals),
        cmocka_unit_test(test_redirects),
        cmocka_unit_test(test_viewer_files),
        cmocka_unit_test(test_ranges),
        cmocka_unit_test(test_seed),
        cmocka_unit_test(test_presets),
        cmocka_unit_test(test_damaged_tile),
        cmocka_unit_test(test_views),
        cmocka_unit_test(test_configuration_and_tags),
        cmocka_unit_test(test_posted_cameras),
        cmocka_unit_test(test_job_ends),
        cmocka_unit_test(test_metrics_are_local),
        cmocka_unit_test(test_reload),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
