/* The table of routes: a row of a test's own is parsed, answered and described from the row alone,
 * rows that cannot be are refused, and what describes the service has every row.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answers/metrics_text.h"
#include "tests/server/routed.h"

/* ---- a route of a test's own ---- */

/* One row and one function: docs/architecture.md shows these. */
struct squares_target { /* routes.def makes those of its rows */
    struct target all;
    struct target_row row;
};

static void answer_squares(struct services *s, const struct request *r, struct dataset *d,
                           const struct target *asked, struct response *out)
{
    const uint32_t n = ((const struct squares_target *)asked)->row.row;
    struct buf b = {0};
    (void)s;
    buf_printf(&b, "{\"dataset\":\"%s\",\"square\":%u}\n", d->meta.name, n * n);
    response_document(r, RESPONSE_JSON, body_take(&b, NULL), out);
}

static const struct route squares = {
    "squares",
    "/d/{ds}/squares/{row}",
    SCOPE_PUBLIC | SCOPE_DATASET,
    CACHE_MOVING,
    RATE_MEMORY,
    1u << TARGET_row,
    sizeof(struct squares_target),
    {[TARGET_row] = offsetof(struct squares_target, row)},
    {{METHOD_GET, answer_squares, NULL, "200 application/json Document,", "A number squared",
      false}}};

/* What dispatch_answer says to one target, of the services that have the row. */
static struct response ask_squares(struct services *s, enum method method, const char *target)
{
    const struct request r = {
        .method = method, .target = target, .target_size = strlen(target), .own_host = "localhost"};
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
    memcpy(rows, ROUTES, ROUTES_COUNT * sizeof *rows);
    rows[ROUTES_COUNT] = squares;
    kit_ok(services_open(&s, &t.cfg, NULL, rows, ROUTES_COUNT + 1, &e), e);
    s.catalog = catalog_ref(t.s.catalog);
    struct response r = ask_squares(&s, METHOD_GET, "/d/toy/squares/7");
    assert_int_equal(r.status, 200);
    assert_true(says(&r, "{\"dataset\":\"toy\",\"square\":49}"));
    expect("Cache-Control", r.cache_control, MOVING);
    assert_ptr_equal(r.route, &rows[ROUTES_COUNT]);
    response_free(&r);
    r = ask_squares(&s, METHOD_GET, "/d/toy/squares/-1");
    assert_int_equal(r.status, 404);
    response_free(&r);
    r = ask_squares(&s, METHOD_POST, "/d/toy/squares/7");
    assert_int_equal(r.status, 405);
    expect("Allow", r.allow, "GET, HEAD, OPTIONS");
    response_free(&r);
    r = ask_squares(&s, METHOD_GET, "/d/none/squares/7");
    assert_int_equal(r.status, 404);
    response_free(&r);
    r = ask_squares(&s, METHOD_GET, "/api");
    assert_true(says(&r, "\"/d/{ds}/squares/{row}\"") && says(&r, "\"A number squared\""));
    response_free(&r);
    r = ask_squares(&s, METHOD_GET, "/api.html");
    assert_true(says(&r, "GET /d/{ds}/squares/{row}"));
    response_free(&r);
    metrics_request(&s.metrics, router_index(s.routes, &rows[ROUTES_COUNT]), 200, 0.1, 1);
    kit_ok(metrics_text_write(&s, &metrics, &e), e);
    buf_u8(&metrics, 0);
    assert_non_null(
        strstr((char *)metrics.data, "{route=\"/d/{ds}/squares/{row}\",code=\"200\"} 1"));
    buf_free(&metrics);
    r = get("/d/toy/squares/7"); /* the program's own table does not have it */
    assert_int_equal(r.status, 404);
    response_free(&r);
    services_free(&s);
    mem_free(rows);
}

/* ---- a kind of work of a test's own ---- */

/* A struct of functions, one row and one answer: docs/architecture.md shows these. */
struct cube_own {
    uint32_t edge;
    char *note; /* owned */
};
static struct {
    _Atomic int made, costed, freed;
} cubes;

static enum err_code cube_make(struct services *s, const struct job *j, const struct work *w,
                               struct buf *out, struct err *e)
{
    const struct cube_own *o = work_own(w);
    (void)s, (void)j;
    atomic_fetch_add(&cubes.made, 1);
    if (o->edge > 9)
        return err_set(e, ERR_DATA, "an edge of %u is too long", o->edge);
    buf_printf(out, "%s %u", o->note, o->edge * o->edge * o->edge);
    return ERR_OK;
}

static size_t cube_room(const struct work *w)
{
    const struct cube_own *o = work_own(w);
    return strlen(o->note) + 16;
}

static double cube_cost(const struct work *w, unsigned *variant)
{
    const struct cube_own *o = work_own(w);
    atomic_fetch_add(&cubes.costed, 1);
    *variant = o->edge > 5;
    return 3;
}

static void cube_free(void *own)
{
    atomic_fetch_add(&cubes.freed, 1);
    mem_free(((struct cube_own *)own)->note);
}

static const struct work_kind cube_work = {.noun = "cube",
                                           .traits = WORK_JUDGES,
                                           .size = sizeof(struct cube_own),
                                           .make = cube_make,
                                           .room = cube_room,
                                           .cost = cube_cost,
                                           .free = cube_free};

static void answer_cube(struct services *s, const struct request *r, struct dataset *d,
                        const struct target *asked, struct response *out)
{
    const uint32_t edge = ((const struct squares_target *)asked)->row.row;
    const struct hash128 id = hash_bytes(&edge, sizeof edge);
    out->type = "text/plain";
    struct cube_own *own =
        response_made(s, r, id, out) ? response_work(d, &cube_work, id, out) : NULL;
    if (own) {
        own->edge = edge;
        own->note = mem_text("cube");
    }
}

static struct {
    struct job_waiter waiter;
    pthread_mutex_t lock;
    pthread_cond_t woken;
    bool is_woken;
} cube = {.lock = PTHREAD_MUTEX_INITIALIZER, .woken = PTHREAD_COND_INITIALIZER};

static void cube_on_wake(struct job_waiter *w)
{
    (void)w;
    pthread_mutex_lock(&cube.lock);
    cube.is_woken = true;
    pthread_cond_signal(&cube.woken);
    pthread_mutex_unlock(&cube.lock);
}

/* What the connection of a client does: asks, submits the work, waits, and answers. */
static struct response ask_cube(struct services *s, const char *target)
{
    const struct request r = {
        .target = target, .target_size = strlen(target), .own_host = "localhost"};
    struct response out;
    dispatch_answer(s, &r, &out);
    if (!out.work)
        return out;
    struct work *w = out.work;
    out.work = NULL;
    cube.waiter = (struct job_waiter){.wake = cube_on_wake};
    cube.is_woken = false;
    assert_int_equal(job_submit(s->jobs, out.cls, w->id, w, 1, 10, &cube.waiter), ERR_OK);
    pthread_mutex_lock(&cube.lock);
    while (!cube.is_woken)
        pthread_cond_wait(&cube.woken, &cube.lock);
    pthread_mutex_unlock(&cube.lock);
    dispatch_finish(s, &r, &cube.waiter.result, &out);
    return out;
}

/* A kind that no file of the server knows is submitted, timed, made in its room, answered, kept and
 * dropped. */
static void test_one_kind_of_work(void **state)
{
    struct err e = {0};
    struct services s;
    struct route *rows = mem_array(ROUTES_COUNT + 1, sizeof *rows);
    memcpy(rows, ROUTES, ROUTES_COUNT * sizeof *rows);
    rows[ROUTES_COUNT] = squares;
    rows[ROUTES_COUNT].path = "/d/{ds}/cube/{row}";
    rows[ROUTES_COUNT].rate = RATE_LISTS;
    rows[ROUTES_COUNT].on[0].answer = answer_cube;
    kit_ok(services_open(&s, &t.cfg, NULL, rows, ROUTES_COUNT + 1, &e), e);
    s.catalog = catalog_ref(t.s.catalog);
    const struct job_config jobs = {.tile_threads = 1,
                                    .queue_limit = {8, 8, 8},
                                    .cost = work_cost,
                                    .run = work_run,
                                    .drop = work_drop,
                                    .passing = work_passing,
                                    .user = &s};
    kit_ok(job_open(&jobs, &s.jobs, &e), e);
    struct response r = ask_cube(&s, "/d/toy/cube/7");
    assert_int_equal(r.status, 200);
    assert_true(says(&r, "cube 343"));
    expect("cache", r.cache, "miss");
    response_free(&r);
    r = ask_cube(&s, "/d/toy/cube/7"); /* it is kept under its name */
    assert_true(says(&r, "cube 343"));
    expect("cache", r.cache, "hit");
    response_free(&r);
    r = ask_cube(&s, "/d/toy/cube/10"); /* the kind judges */
    assert_int_equal(r.status, 422);
    assert_true(says(&r, "an edge of 10 is too long"));
    response_free(&r);
    struct work *w = work_make(&cube_work, s.catalog->ds[0]);
    struct cost_kind kind;
    assert_non_null(w);
    *(struct cube_own *)work_own(w) = (struct cube_own){7, mem_text("a note")};
    assert_int_equal(work_room(w), WORK_ROOM_HEAD + 6 + 16);
    assert_true(work_cost(w, &kind) == 3 && kind.of == &cube_work && kind.variant == 1);
    assert_true(work_passing(w)); /* it is not kept */
    work_drop(&s, w);
    services_free(&s); /* joins the thread, which drops its work after the waiter was woken */
    assert_int_equal(cubes.made, 2);
    assert_int_equal(cubes.costed, 3);
    assert_int_equal(cubes.freed, 3);
    mem_free(rows);
}

/* A row that cannot be is an error of the start, and names the row. */
static void test_rows_that_cannot_be(void **state)
{
    static const char *const paths[] = {"/d/{ds}/{nobody}", "/d/{ds}[/{x}", "/d/{ds}]"};
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
    json_object_foreach(json_object_get(o, "paths"), path, methods)
    {
        const json_t *list = json_object_get(json_object_get(methods, "get"), "parameters");
        for (size_t i = 0; i < json_array_size(list); i++) {
            const json_t *p = json_array_get(list, i);
            const char *about = json_string_value(json_object_get(p, "description"));
            if (strcmp(json_string_value(json_object_get(p, "name")), "appearance") != 0)
                continue;
            bool none = about && strstr(about, "none"),
                 tiles = strstr(path, "/t/") || strstr(path, "tileset") || strstr(path, "seed") ||
                         strstr(path, "/city."); /* which says 400 to it */
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
        cmocka_unit_test(test_one_kind_of_work),
        cmocka_unit_test(test_rows_that_cannot_be),
        cmocka_unit_test(test_api_lists_the_routes),
        cmocka_unit_test(test_the_page_says_what_the_description_says),
        cmocka_unit_test(test_api_knows_no_appearance),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
