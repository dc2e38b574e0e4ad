/* What browsers get, as pure calls: the viewer's files and their coded forms, pages, what a page
 * hints at, and the card that others show of it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <fcntl.h>
#include <math.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "lod/store/tree.h"
#include "server/access/auth.h"
#include "server/documents/home_outline.h"
#include "server/documents/social_preview.h"
#include "server/headers.h"
#include "tests/server/routed.h"

static void test_viewer_files(void **state)
{
    static const char script[] = "/assets/index-D3adBeef.js";
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
    r = answer(&(struct ask){.target = script, .accept_encoding = "gzip, deflate, br"});
    assert_int_equal(r.status, 200);
    expect("Content-Encoding", r.encoding, "br");
    expect("type", r.type, "text/javascript; charset=utf-8");
    expect("Vary", r.vary, "Accept-Encoding");
    assert_int_equal(r.size, 100);
    assert_non_null(strstr(r.etag, "-br\""));
    assert_string_not_equal(r.etag, etag);
    response_free(&r);
    for (int coded = 0; coded < 2; coded++) { /* a form of a file is no file */
        r = get(coded ? "/assets/index-D3adBeef.js.br" : "/assets/index-D3adBeef.js.gz");
        assert_int_equal(r.status, 404);
        response_free(&r);
    }
    r = get("/assets/logo-big.svg"); /* no hash in its name: it may change */
    expect("Cache-Control", r.cache_control, MOVING);
    response_free(&r);
    r = get("/assets/index-D3adBeef");
    assert_int_equal(r.status, 404);
    response_free(&r);
}

/* Forms of files whose name stays while their bytes change: of other bytes when they are older. */
static void test_coded_of_other_bytes(void **state)
{
    static const struct {
        long older_s;
        size_t size, got;
    } rows[] = {{0, 40, 40}, {-9, 40, 40}, {9, 40, 0}, {0, 2000, 0}, {0, 0, 0}};
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], coded[FILE_PATH_MAX], text[2000];
    memset(text, ' ', sizeof text);
    kit_tmpdir(dir);
    for (size_t i = 0; i < 2 * (sizeof rows / sizeof *rows); i++) {
        struct static_table table = {0};
        struct err e = {0};
        bool gzip = i % 2;
        kit_ok(file_join(path, dir, "viewer.js", &e), e);
        kit_ok(file_write(path, text, 1000, &e), e);
        kit_ok(file_join(coded, dir, gzip ? "viewer.js.gz" : "viewer.js.br", &e), e);
        kit_ok(file_write(coded, text, rows[i / 2].size, &e), e);
        const struct timespec at = {.tv_sec = time(NULL) - rows[i / 2].older_s};
        assert_int_equal(0, utimensat(AT_FDCWD, coded, (const struct timespec[2]){at, at}, 0));
        kit_ok(static_load(dir, &table, &e), e);
        const struct static_file *f = static_find(&table, "/viewer.js", strlen("/viewer.js"));
        assert_int_equal(table.n, 1);
        assert_int_equal(f->body->brotli_size, gzip ? 0 : rows[i / 2].got);
        bool taken = f->body->gzip_size == 40; /* else it is made at start */
        assert_true(f->body->gzip && taken == (gzip && rows[i / 2].got));
        static_free(&table);
        assert_int_equal(unlink(coded), 0);
    }
    kit_rmdir(dir);
}

/* Of large text only the compressed forms are in memory; who takes none gets the file's bytes. */
static void test_plain_of_coded(void **state)
{
    enum { LINES = 20000 };
    static const char gz[] = "viewer.js.gz";
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct static_table table = {0}, before = t.s.web;
    struct err e = {0};
    struct buf text = {0};
    for (int i = 0; i < LINES; i++)
        buf_printf(&text, "draw(%d);\n", i);
    kit_tmpdir(dir);
    kit_ok(file_join(path, dir, "viewer.js", &e), e);
    kit_ok(file_write(path, text.data, text.size, &e), e);
    kit_ok(static_load(dir, &table, &e), e);
    const struct static_file *f = static_find(&table, "/viewer.js", strlen("/viewer.js"));
    assert_null(f->body->data);
    t.s.web = table;
    char etag[BODY_ETAG_SIZE] = "";
    for (int i = 0; i < 2; i++) { /* unpacked, and then from the cache */
        struct response r = get("/viewer.js");
        assert_int_equal(r.status, 200);
        assert_int_equal(r.size, text.size);
        assert_memory_equal(r.data, text.data, text.size);
        expect("Vary", r.vary, "Accept-Encoding");
        expect("Content-Encoding", r.encoding, NULL);
        assert_false(r.accept_ranges);
        assert_true(r.modified_s > 0);
        memcpy(etag, r.etag, sizeof etag);
        expect("ETag", etag, f->body->etag);
        response_free(&r);
    }
    struct response r = answer(&(struct ask){.target = "/viewer.js", .if_none_match = etag});
    assert_int_equal(r.status, 304);
    response_free(&r);
    r = answer(&(struct ask){.target = "/viewer.js", .accept_encoding = "gzip"});
    expect("Content-Encoding", r.encoding, "gzip");
    assert_ptr_equal(r.data, f->body->gzip);
    response_free(&r);
    static_free(&table);

    kit_ok(file_join(path, dir, gz, &e), e); /* what cannot be unpacked to the file */
    kit_ok(file_write(path, "no gzip at all", 14, &e), e);
    kit_ok(static_load(dir, &table, &e), e);
    f = static_find(&table, "/viewer.js", strlen("/viewer.js"));
    assert_non_null(f->body->data);
    static_free(&table);
    t.s.web = before;
    buf_free(&text);
    kit_rmdir(dir);
}

/* The page of a dataset has its words in place of those in braces; others stay. */
static void test_a_page_says_how_to_use_a_dataset(void **state)
{
    char want[200];
    const struct key k = served_key(SERVED_ZOOM_MAX);
    struct response r = get("/d/toy/use");
    assert_int_equal(r.status, 200);
    snprintf(want, sizeof want, "/d/toy/t/%u/", k.z);
    assert_true(says(&r, "<p>toy of http") && says(&r, want) && says(&r, ".spz, {nothing}"));
    assert_false(says(&r, "{tile}"));
    response_free(&r);
}

/* The module has an address for ever; that of another version leads to the present one. */
static void test_the_module_has_an_address_for_ever(void **state)
{
    char path[40];
    const struct static_file *f = static_find(&t.s.web, "/viewer.js", strlen("/viewer.js"));
    assert_non_null(f);
    struct response r = get("/viewer.js");
    snprintf(path, sizeof path, "/viewer-%s.js", f->digest);
    assert_non_null(strstr(r.hints, path + 1));
    response_free(&r);
    r = get(path);
    assert_int_equal(r.status, 200);
    assert_non_null(strstr(r.cache_control, "immutable"));
    assert_true(says(&r, "export {}"));
    response_free(&r);
    r = get("/viewer-000000000000.js");
    assert_int_equal(r.status, 307);
    assert_string_equal(r.location, "viewer.js");
    response_free(&r);
    r = get("/viewer-12.js");
    assert_int_equal(r.status, 404);
    response_free(&r);
}

/* What the page will ask for, by its query. */
static void test_hints(void **state)
{
    static const char how[] = "; rel=preload; as=fetch; crossorigin";
    static const struct {
        const char *target;
        size_t n;
        const char *last;
    } rows[] = {
        {"/", 3, "<d/toy/r/REV+/t/KEY15.drc?preset=preview&sh=0>"},
        {"/?scene=toy&lang=de", 3, "<d/toy/r/REV+/t/KEY15.drc?preset=preview&sh=0>"},
        {"/?scene=other", 1, "<collections>"},
        {"/?thin", 1, "<collections>"},
        {"/?ui=off&colours=server", 1, "<collections>"},
        {"/?scene=%zz", 1, "<collections>"},
        {"/?server=https://city.example/", 0, ""},
        {"/?scene=toy&url=x.json", 0, ""},
    };
    char want[200];
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        struct response r = answer(&(struct ask){.target = rows[i].target, .accept = "text/html"});
        size_t n = 0;
        for (const char *p = r.hints; (p = strstr(p, how)); p++)
            n++;
        if (n != rows[i].n || !strstr(r.hints, expand(rows[i].last, want, sizeof want)))
            fail_msg("%s: Link is '%s'", rows[i].target, r.hints);
        struct headers h;
        headers_make(&r, false, &h);
        size_t sent = 0;
        for (size_t k = 0; k < h.n; k++)
            sent += !strcmp(h.field[k].name, "Link") && h.field[k].value == r.hints;
        assert_int_equal(sent, rows[i].n > 0);
        response_free(&r);
    }
    struct response r = get("/"); /* as JSON */
    expect("Link", r.hints, "");
    response_free(&r);

    /* A server that asks for tokens names no dataset in a page that caches keep. */
    static const char access[] = "{\"public\": [\"toy\"]}";
    struct err e = {0};
    assert_int_equal(auth_parse(access, sizeof access - 1, "access.json", &t.s.auth, &e), 0);
    r = answer(&(struct ask){.target = "/", .accept = "text/html"});
    expect("Link", r.hints, "");
    response_free(&r);
    auth_close(&t.s.auth);
}

/* The page says which scene it is, in words that cannot become markup; of private ones nothing. */
static void test_card(void **state)
{
    static const char private[] = "{\"public\": []}", plain[] = "<title>viewer</title>";
    struct dataset *d = t.s.catalog->ds[0];
    char kept[sizeof d->meta.attribution];
    struct err e = {0};
    memcpy(kept, d->meta.attribution, sizeof kept);
    snprintf(d->meta.attribution, sizeof d->meta.attribution, "%s",
             "\"><script>alert(1)</script>&'");
    struct response r = answer(
        &(struct ask){.target = "/?scene=toy", .accept = "text/html", .host = "city.example"});
    assert_int_equal(r.status, 200);
    assert_true(says(&r, "<title>toy – citysplat</title>"));
    assert_true(says(&r, "property=\"og:title\" content=\"toy\""));
    assert_true(says(&r, "content=\"http://city.example/?scene=toy\""));
    assert_true(says(&r, "&quot;&gt;&lt;script&gt;alert(1)&lt;/script&gt;&amp;&#39;"));
    assert_false(says(&r, "<script>alert"));
    assert_false(says(&r, "og:image")); /* nothing is drawn here */
    assert_false(says(&r, plain));
    assert_non_null(strstr(r.vary, "Host"));
    response_free(&r);

    struct body *page =
                    body_text("<!doctype html><meta name=\"description\" content=\"x\" />\n"
                              "<meta property=\"og:title\" content=\"x\" />\n<title>x</title>"
                              "<script data-first src=\"./first.js\"></script>"
                              "<noscript>x</noscript><main>y</main><svg><title>z</title></svg>"),
                *made = NULL;
    kit_ok(social_preview_page(page, d, "https://a.example/below", true, &made, &e), e);
    struct response one = {.data = made->data, .size = made->size};
    assert_true(says(&one, "property=\"og:image\" "
                           "content=\"https://a.example/below/d/toy/static/"));
    assert_true(says(&one, "/1200x630.jpg\""));
    assert_true(says(&one, "content=\"summary_large_image\""));
    assert_true(says(&one, "<noscript><img src=\"./d/toy/static/"));
    assert_true(says(&one, "<script data-first data-still=\"./d/toy/static/\" "
                           "data-origin=\"13.40000000,52.50000000,40.000\" data-outline=\"-"));
    assert_true(says(&one, "\" src=\"./first.js\"></script>"));
    assert_true(says(&one, "<main>y</main><svg><title>z</title></svg>"));
    assert_false(says(&one, "content=\"x\""));
    assert_false(says(&one, ">x<"));
    body_drop(&made);
    kit_ok(social_preview_page(page, d, "", true, &made, &e), e); /* who asks by no name */
    one = (struct response){.data = made->data, .size = made->size};
    assert_false(says(&one, "og:image"));
    assert_false(says(&one, "og:url"));
    body_drop(&made);
    body_drop(&page);
    memcpy(d->meta.attribution, kept, sizeof kept);

    r = answer(&(struct ask){.target = "/?scene=none", .accept = "text/html"});
    assert_true(says(&r, plain));
    response_free(&r);
    assert_int_equal(auth_parse(private, sizeof private - 1, "access.json", &t.s.auth, &e), 0);
    r = answer(&(struct ask){.target = "/?scene=toy", .accept = "text/html"});
    assert_true(says(&r, plain));
    assert_false(says(&r, "toy"));
    response_free(&r);
    auth_close(&t.s.auth);
}

/* A town of blocks that stand askew: its rectangle is turned as they are. Without a footprint it is
 * the box around most Gaussians. */
static void test_outline(void **state)
{
    enum { N = 400 };
    const double c = cos(0.6108652), s = sin(0.6108652); /* 35 degrees */
    double points[N][2], out[HOME_OUTLINE_NUMBERS], far[2] = {0, 0};
    for (int i = 0; i < N; i++) {
        const double u = 300 * (i % 20) / 19.0, v = 100 * (i / 20) / 19.0;
        points[i][0] = 50 + c * u - s * v;
        points[i][1] = -20 + s * u + c * v;
    }
    home_outline_around((const double(*)[2])points, N, out);
    for (int i = 0; i < 4; i++) {
        const int k = (i + 1) % 4;
        far[i % 2] = hypot(out[2 * k] - out[2 * i], out[2 * k + 1] - out[2 * i + 1]);
    }
    assert_true(fabs(far[0] * far[1] - 300 * 100) < 0.1);
    assert_true(fabs(fmax(far[0], far[1]) - 300) < 1e-3);
    bool corner = false;
    for (int i = 0; i < 4; i++)
        corner |= hypot(out[2 * i] - 50, out[2 * i + 1] + 20) < 1e-3;
    assert_true(corner);
    const struct dataset *d = t.s.catalog->ds[0];
    const struct tree_bounds b = tree_bounds(store_tree(d->index), store_tree(d->index)->root);
    assert_true(home_outline(d, out));
    assert_true(fabs(out[0] - b.core_min_enu_m[0]) < 1e-9);
    assert_true(fabs(out[5] - b.core_max_enu_m[1]) < 1e-9);
    assert_true(fabs(out[9] - d->area.ceiling_m) < 1e-9);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_viewer_files),
        cmocka_unit_test(test_coded_of_other_bytes),
        cmocka_unit_test(test_plain_of_coded),
        cmocka_unit_test(test_a_page_says_how_to_use_a_dataset),
        cmocka_unit_test(test_the_module_has_an_address_for_ever),
        cmocka_unit_test(test_hints),
        cmocka_unit_test(test_card),
        cmocka_unit_test(test_outline),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
