/* The table of routes: a row of a test's own is parsed, answered and described from the row alone,
 * rows that cannot be are refused, and what describes the service has every row.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/metrics_text.h"
#include "tests/routed.h"

/* ---- a route of a test's own ---- */

/* One row and one function: docs/architecture.md shows these. */
static void answer_squares(struct services *s, const struct request *r, struct dataset *d,
                           const struct target *asked, struct response *out)
{
    struct buf b = {0};
    (void)s;
    buf_printf(&b, "{\"dataset\":\"%s\",\"square\":%u}\n", d->meta.name,
               asked->limit * asked->limit);
    response_document(r, RESPONSE_JSON, body_take(&b, NULL), out);
}

static const struct route squares = {
    "squares",
    "/d/{ds}/squares",
    SCOPE_PUBLIC | SCOPE_DATASET,
    CACHE_MOVING,
    RATE_MEMORY,
    QUERY_SEARCH,
    {{METHOD_GET, answer_squares, NULL, "200 application/json Document,", "A number squared",
      false}}};

/* What dispatch_answer says to one target, of the services that have the row. */
static struct response ask_squares(struct services *s, enum method method, const char *target)
{
    const struct request r = {
        .method = method, .target = target, .target_size = strlen(target), .local = true};
    struct response out;
    dispatch_answer(s, &r, &out);
    return out;
}

/* The parser, the dispatch, Allow, the document, the page and the metrics know a row of the table
 * from the row alone. */
static void test_one_row_and_one_function(void **state)
{
    struct err e = {0};
    struct services s;
    struct buf metrics = {0};
    struct route *rows = mem_array(ROUTES_COUNT + 1, sizeof *rows);
    (void)state;
    memcpy(rows, ROUTES, ROUTES_COUNT * sizeof *rows);
    rows[ROUTES_COUNT] = squares;
    kit_ok(services_open(&s, &t.cfg, NULL, rows, ROUTES_COUNT + 1, &e), e);
    s.catalog = catalog_ref(t.s.catalog);
    struct response r = ask_squares(&s, METHOD_GET, "/d/toy/squares?limit=7");
    assert_int_equal(r.status, 200);
    assert_true(says(&r, "{\"dataset\":\"toy\",\"square\":49}"));
    expect("Cache-Control", r.cache_control, MOVING);
    assert_ptr_equal(r.route, &rows[ROUTES_COUNT]);
    response_free(&r);
    r = ask_squares(&s, METHOD_GET, "/d/toy/squares?limit=0");
    assert_int_equal(r.status, 400);
    response_free(&r);
    r = ask_squares(&s, METHOD_POST, "/d/toy/squares");
    assert_int_equal(r.status, 405);
    expect("Allow", r.allow, "GET, HEAD, OPTIONS");
    response_free(&r);
    r = ask_squares(&s, METHOD_GET, "/d/none/squares");
    assert_int_equal(r.status, 404);
    response_free(&r);
    r = ask_squares(&s, METHOD_GET, "/api");
    assert_true(says(&r, "\"/d/{ds}/squares\"") && says(&r, "\"A number squared\""));
    response_free(&r);
    r = ask_squares(&s, METHOD_GET, "/api.html");
    assert_true(says(&r, "GET /d/{ds}/squares"));
    response_free(&r);
    metrics_request(&s.metrics, router_index(s.routes, &rows[ROUTES_COUNT]), 200, 0.1, 1);
    kit_ok(metrics_text_write(&s, &metrics, &e), e);
    buf_u8(&metrics, 0);
    assert_non_null(strstr((char *)metrics.data, "{route=\"/d/{ds}/squares\",code=\"200\"} 1"));
    buf_free(&metrics);
    r = get("/d/toy/squares"); /* the program's own table does not have it */
    assert_int_equal(r.status, 404);
    response_free(&r);
    services_free(&s);
    mem_free(rows);
}

/* A row that cannot be is an error of the start, and names the row. */
static void test_rows_that_cannot_be(void **state)
{
    static const char *const paths[] = {"/d/{ds}/{nobody}", "/d/{ds}[/{x}", "/d/{ds}]"};
    (void)state;
    for (size_t i = 0; i < sizeof paths / sizeof *paths; i++) {
        struct err e = {0};
        struct route row = squares;
        struct router *routes = NULL;
        row.path = paths[i];
        kit_fails(router_open(&row, 1, &routes, &e), ERR_INTERNAL, e, "squares");
        assert_null(routes);
    }
    for (size_t i = 0; i < ROUTES_COUNT; i++)
        for (size_t k = 0; k < i; k++) {
            assert_string_not_equal(ROUTES[i].path, ROUTES[k].path);
            assert_string_not_equal(ROUTES[i].name, ROUTES[k].name);
        }
}

/* The service description has every route, and no route that is not answered; a path in it has no
 * brackets, and its parameters, each once, are those that are declared. */
static void test_api_lists_the_routes(void **state)
{
    struct response r = get("/api");
    json_t *o = json_of(&r), *paths = json_object_get(o, "paths"), *methods, *operation;
    const char *path, *verb;
    (void)state;
    assert_int_equal(json_object_size(paths), ROUTES_COUNT - 1); /* without files */
    json_object_foreach(paths, path, methods)
    {
        assert_null(strpbrk(path, "[]"));
        json_object_foreach(methods, verb, operation)
        {
            const json_t *list = json_object_get(operation, "parameters");
            size_t i = 0;
            for (const char *p = strchr(path, '{'); p; p = strchr(p + 1, '{'), i++) {
                const char *name =
                    json_string_value(json_object_get(json_array_get(list, i), "name"));
                assert_non_null(name);
                if (strncmp(p + 1, name, strlen(name)) != 0 || p[1 + strlen(name)] != '}')
                    fail_msg("%s: parameter %zu is %s", path, i, name);
                for (size_t k = 0; k < i; k++)
                    assert_string_not_equal(
                        name, json_string_value(json_object_get(json_array_get(list, k), "name")));
            }
            assert_true(json_object_size(json_object_get(operation, "responses")) >= 2);
        }
    }
    json_decref(o);
    response_free(&r);
}

/* The page to read names every path and verb of the description, and the landing page names it. */
static void test_the_page_says_what_the_description_says(void **state)
{
    struct response r = get("/api"), page = get("/api.html"), landing = get("/");
    json_t *o = json_of(&r), *methods, *operation;
    const char *path, *verb;
    char want[300];
    size_t n = 0;
    (void)state;
    expect("type", page.type, "text/html; charset=utf-8");
    expect("Cache-Control", page.cache_control, MOVING);
    json_object_foreach(json_object_get(o, "paths"), path, methods)
    {
        json_object_foreach(methods, verb, operation)
        {
            snprintf(want, sizeof want, "<code>%s %s</code>",
                     !strcmp(verb, "get")    ? "GET"
                     : !strcmp(verb, "post") ? "POST"
                     : !strcmp(verb, "put")  ? "PUT"
                                             : "DELETE",
                     path);
            if (!says(&page, want))
                fail_msg("%s is not on the page", want);
            n++;
        }
    }
    assert_true(n > 40 && says(&page, "<a href=\"api\">") && !says(&page, "<script"));
    assert_true(says(&landing, "\"service-doc\"") && says(&landing, "\"api.html\""));
    json_decref(o);
    response_free(&r);
    response_free(&page);
    response_free(&landing);
}

/* What /api says of ?appearance=: tiles, tilesets and lists of them may have none, pictures not. */
static void test_api_knows_no_appearance(void **state)
{
    struct response r = get("/api");
    json_t *o = json_of(&r), *methods;
    const char *path;
    int with = 0, without = 0;
    (void)state;
    json_object_foreach(json_object_get(o, "paths"), path, methods)
    {
        const json_t *list = json_object_get(json_object_get(methods, "get"), "parameters");
        for (size_t i = 0; i < json_array_size(list); i++) {
            const json_t *p = json_array_get(list, i);
            const char *about = json_string_value(json_object_get(p, "description"));
            if (strcmp(json_string_value(json_object_get(p, "name")), "appearance") != 0)
                continue;
            bool none = about && strstr(about, "none"),
                 tiles = strstr(path, "/t/") || strstr(path, "tileset") || strstr(path, "seed");
            if (none != tiles)
                fail_msg("%s: appearance is '%s'", path, about ? about : "");
            with += none;
            without += !none;
        }
    }
    assert_true(with >= 5 && without >= 3);
    json_decref(o);
    response_free(&r);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_one_row_and_one_function),
        cmocka_unit_test(test_rows_that_cannot_be),
        cmocka_unit_test(test_api_lists_the_routes),
        cmocka_unit_test(test_the_page_says_what_the_description_says),
        cmocka_unit_test(test_api_knows_no_appearance),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
