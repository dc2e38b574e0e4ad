/* Named appearances that three servers share, by way of an object at a server of its own: what one
 * keeps all answer, changes of two are both there, requests for unknown names cannot make many, and
 * without that server what is known is answered and the rest is 503.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/ranges_kit.h"

#include "tests/client.h"
#include "tests/lit.h"

enum { NODES = 3 };
static const char BLEND[] = "{\"weights\":{\"p1.jpg\":1,\"p2.jpg\":3}}";
static const char DAWN[] = "{\"appearance\":\"dawn\"}";

static struct {
    char url[64];
    struct node {
        struct server *server;
        uint16_t port, admin;
    } node[NODES];
} f;

static void node_start(struct node *n, double refresh_s)
{
    struct err e = {0};
    t.cfg.state_url = f.url;
    t.cfg.state_refresh_s = refresh_s;
    t.cfg.admin = "127.0.0.1:0";
    kit_ok(server_start(&t.cfg, t.paths, 1, &n->server, &e), e);
    n->port = (uint16_t)atoi(strrchr(server_url(n->server), ':') + 1);
    n->admin = server_admin_port(n->server);
}

static void fleet_start(double refresh_s)
{
    for (size_t i = 0; i < NODES; i++)
        node_start(&f.node[i], refresh_s);
}

static int setup_fleet(void **state)
{
    setup(state);
    atomic_store(&ranges.way, RANGES_WELL);
    ranges_forget();
    return 0;
}

static int teardown_fleet(void **state)
{
    atomic_store(&ranges.way, RANGES_WELL);
    for (size_t i = 0; i < NODES; i++)
        server_stop(&f.node[i].server);
    return teardown(state);
}

static int setup_all_shared(void **state)
{
    setup_all(state);
    lit_by_five(t.path, 5);
    ranges_start();
    snprintf(f.url, sizeof f.url, "http://127.0.0.1:%u/names.json", ranges.port);
    return 0;
}

static int teardown_all_shared(void **state)
{
    ranges_stop();
    return teardown_all(state);
}

static const char *path_of(const char *name)
{
    static char path[128];
    snprintf(path, sizeof path, "/d/toy/appearances/%s", name);
    return path;
}

static int change(const struct node *n, const char *method, const char *name, const char *extra,
                  const char *body)
{
    struct reply r;
    say_to(n->admin, method, path_of(name), extra, body, &r);
    buf_free(&r.raw);
    return r.status;
}

static int get(const struct node *n, const char *target)
{
    struct reply r;
    ask_port(n->port, "GET", target, "", &r);
    buf_free(&r.raw);
    return r.status;
}

/* Asks until the status is this one. */
static void await_status(const struct node *n, const char *target, int status)
{
    const double end_s = clock_s() + PATIENCE_S;
    int is = 0;
    while ((is = get(n, target)) != status && clock_s() < end_s)
        nap_ms(20);
    assert_int_equal(is, status);
}

/* ---- one place ---- */

static void what_one_keeps_all_answer_at_once(void **state)
{
    char tile[128], target[256], name[32];
    struct reply a, b;
    (void)state;
    fleet_start(3600); /* what is found is found because it is asked for */
    t.server = f.node[0].server;
    struct catalog *c = services_catalog(server_services(t.server));
    memcpy(t.rev, c->ds[0]->meta.revision, sizeof t.rev);
    catalog_drop(&c);
    (void)tile_target(17, "ply", tile);
    t.server = NULL;
    const char *const targets[] = {
        "/d/toy/appearances/", "/d/toy/tileset.json?appearance=", "/d/toy/seed.ndjson?appearance=",
        "/d/toy/appearance?appearance=", tile};
    for (size_t i = 0; i < sizeof targets / sizeof *targets; i++)
        for (size_t at = 1; at < NODES; at++) {
            snprintf(name, sizeof name, "n%zu-%zu", i, at);
            snprintf(target, sizeof target, "%s%s%s", targets[i],
                     targets[i] == tile ? "?appearance=" : "", name);
            assert_int_equal(get(&f.node[at], target), 404);
            assert_int_equal(change(&f.node[0], "PUT", name, "", BLEND), 201);
            ask_port(f.node[at].port, "GET", target, "", &b);
            if (b.status != 200)
                fail_msg("%s: %d %.*s", target, b.status, (int)b.body_size, (const char *)b.body);
            ask_port(f.node[0].port, "GET", target, "", &a);
            assert_int_equal(a.body_size, b.body_size);
            assert_memory_equal(a.body, b.body, b.body_size);
            buf_free(&a.raw);
            buf_free(&b.raw);
        }
    assert_int_equal(change(&f.node[2], "PUT", "mine", "", BLEND), 201);
    say_to(f.node[1].port, "POST", "/d/toy/appearances:mix", "", "{\"appearance\":\"mine\"}", &b);
    assert_int_equal(b.status, 200);
    buf_free(&b.raw);
    assert_int_equal(change(&f.node[2], "PUT", "other", "", BLEND), 201);
    assert_int_equal(change(&f.node[1], "PUT", "copy", "", "{\"appearance\":\"other\"}"), 201);
}

static void what_is_kept_outlives_its_server(void **state)
{
    (void)state;
    fleet_start(3600);
    assert_int_equal(change(&f.node[0], "PUT", "evening", "If-None-Match: *\r\n", BLEND), 201);
    server_stop(&f.node[0].server);
    assert_int_equal(get(&f.node[1], path_of("evening")), 200);
    node_start(&f.node[0], 3600);
    assert_int_equal(get(&f.node[0], path_of("evening")), 200);
    assert_int_equal(change(&f.node[2], "PUT", "evening", "If-None-Match: *\r\n", DAWN), 412);
}

static void changes_and_removals_come_by_themselves(void **state)
{
    struct reply r;
    char tag[64];
    (void)state;
    fleet_start(0.1);
    assert_int_equal(change(&f.node[0], "PUT", "evening", "", BLEND), 201);
    ask_port(f.node[1].port, "GET", path_of("evening"), "", &r);
    snprintf(tag, sizeof tag, "If-None-Match: %s\r\n", header(&r, "ETag"));
    buf_free(&r.raw);
    assert_int_equal(change(&f.node[2], "PUT", "evening", "", DAWN), 204);
    for (double end_s = clock_s() + PATIENCE_S;;) {
        ask_port(f.node[1].port, "GET", path_of("evening"), tag, &r);
        buf_free(&r.raw);
        if (r.status == 200)
            break;
        assert_int_equal(r.status, 304);
        assert_true(clock_s() < end_s);
    }
    assert_int_equal(change(&f.node[1], "DELETE", "evening", "", NULL), 204);
    await_status(&f.node[0], path_of("evening"), 404);
    assert_int_equal(change(&f.node[0], "DELETE", "evening", "", NULL), 404);
}

/* ---- many at once ---- */

enum { EACH = 25 };
static _Atomic int n_made, n_first, n_odd;

static void *keep_many(void *user)
{
    const struct node *n = user;
    char name[32];
    for (int i = 0; i < EACH; i++) {
        struct reply r;
        char target[128];
        snprintf(name, sizeof name, "n%d-%d", (int)(n - f.node), i);
        snprintf(target, sizeof target, "/d/toy/appearances/%s", name);
        say_to(n->admin, "PUT", target, "", BLEND, &r);
        n_made += r.status == 201;
        n_odd += r.status != 201 && r.status != 503;
        buf_free(&r.raw);
        snprintf(target, sizeof target, "/d/toy/appearances/first-%d", i);
        say_to(n->admin, "PUT", target, "If-None-Match: *\r\n", BLEND, &r);
        n_first += r.status == 201;
        n_odd += r.status != 201 && r.status != 412 && r.status != 503;
        buf_free(&r.raw);
    }
    return NULL;
}

static void keep_by_all(void)
{
    pthread_t thread[NODES];
    char name[32];
    int there = 0, firsts = 0;
    for (size_t i = 0; i < NODES; i++)
        assert_int_equal(pthread_create(&thread[i], NULL, keep_many, &f.node[i]), 0);
    for (size_t i = 0; i < NODES; i++)
        pthread_join(thread[i], NULL);
    for (int i = 0; i < EACH; i++) {
        for (int at = 0; at < NODES; at++) {
            snprintf(name, sizeof name, "n%d-%d", at, i);
            there += get(&f.node[(at + 1) % NODES], path_of(name)) == 200;
        }
        snprintf(name, sizeof name, "first-%d", i);
        firsts += get(&f.node[i % NODES], path_of(name)) == 200;
    }
    print_message("shared names: %d of %d kept, %d first\n", n_made, NODES * EACH, n_first);
    assert_int_equal(n_odd, 0);
    assert_in_range(n_made, NODES * EACH * 9 / 10, NODES * EACH);
    assert_int_equal(there, n_made);
    assert_int_equal(firsts, n_first);
}

/* Servers that write at the same time lose nothing of each other, and one alone is the first. */
static void changes_of_many_are_all_there(void **state)
{
    (void)state;
    fleet_start(3600);
    n_made = n_first = n_odd = 0;
    keep_by_all();
}

/* An answer that does not come, and another that is quicker, are no reason to fail. */
static void changes_are_repeated(void **state)
{
    static const int ways[] = {RANGES_LOST, RANGES_BEATEN, RANGES_BUSY};
    char name[32];
    (void)state;
    fleet_start(3600);
    for (int i = 0; i < 12; i++) {
        snprintf(name, sizeof name, "n%d", i);
        atomic_store(&ranges.way, ways[i % 3]);
        assert_int_equal(change(&f.node[0], "PUT", name, "If-None-Match: *\r\n", BLEND), 201);
        atomic_store(&ranges.way, RANGES_WELL);
        assert_int_equal(get(&f.node[1], path_of(name)), 200);
        atomic_store(&ranges.way, ways[i % 3]);
        assert_int_equal(change(&f.node[0], "DELETE", name, "", NULL), 204);
        atomic_store(&ranges.way, RANGES_WELL);
    }
}

/* Ceph's gateway refuses a tag with its quotes: what was refused is read, found unchanged, and sent
 * bare. A change then needs no second attempt, and one that is really late is still refused. */
static void bare_tags_are_found_out(void **state)
{
    char name[32];
    (void)state;
    atomic_store(&ranges.way, RANGES_BARE);
    fleet_start(3600);
    for (int i = 0; i < 8; i++) {
        snprintf(name, sizeof name, "n%d", i);
        const unsigned before = atomic_load(&ranges.n_put);
        assert_int_equal(change(&f.node[i % 2], "PUT", name, "If-None-Match: *\r\n", BLEND), 201);
        assert_int_equal(get(&f.node[2], path_of(name)), 200);
        if (i >= 4)
            assert_int_equal(atomic_load(&ranges.n_put) - before, 1);
    }
    n_made = n_first = n_odd = 0;
    keep_by_all();
    atomic_store(&ranges.way, RANGES_WELL); /* which refuses bare tags */
    assert_int_equal(change(&f.node[0], "PUT", "after", "", BLEND), 201);
    assert_int_equal(change(&f.node[0], "DELETE", "after", "", NULL), 204);
}

/* ---- whoever asks for what is not there ---- */

static void unknown_names_cause_few_requests(void **state)
{
    enum { ASKED = 400 };
    char target[128];
    (void)state;
    fleet_start(3600);
    const unsigned before = atomic_load(&ranges.n);
    const double start_s = clock_s();
    int fds[ASKED], n_404 = 0;
    for (int i = 0; i < ASKED; i++) { /* all at once */
        struct buf q = {0};
        snprintf(target, sizeof target, "/d/toy/tileset.json?appearance=not%d", i);
        fds[i] = dial(f.node[1].port);
        buf_printf(&q, "GET %s HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n", target);
        say_bytes(fds[i], (char *)q.data, q.size);
        buf_free(&q);
        if (i % 64 < 63 && i < ASKED - 1)
            continue;
        for (int k = i / 64 * 64; k <= i; k++) {
            struct reply r;
            hear(fds[k], true, NULL, &r);
            n_404 += r.status == 404;
            buf_free(&r.raw);
            close(fds[k]);
        }
    }
    const unsigned sent = atomic_load(&ranges.n) - before;
    const double took_s = clock_s() - start_s;
    print_message("%d unknown names: %u requests in %.2f s\n", ASKED, sent, took_s);
    assert_int_equal(n_404, ASKED);
    assert_in_range(sent, 1, (unsigned)(took_s / 0.25) + 2);
    /* what is no name, a photograph or a blend, causes none */
    const unsigned then = atomic_load(&ranges.n);
    assert_int_equal(get(&f.node[1], "/d/toy/tileset.json?appearance=p1.jpg"), 200);
    assert_int_equal(get(&f.node[1], "/d/toy/tileset.json?appearance=p1.jpg:1,p9.jpg:1"), 404);
    assert_int_equal(get(&f.node[1], "/d/other/tileset.json?appearance=evening"), 404);
    assert_int_equal(atomic_load(&ranges.n), then);
}

/* ---- the place does not answer ---- */

static void assert_not_known(const struct node *n, const char *target)
{
    struct reply r;
    ask_port(n->port, "GET", target, "", &r);
    assert_int_equal(r.status, 503);
    assert_int_equal(atoi(header(&r, "Retry-After")), 1);
    assert_null(strstr((const char *)r.body, "127.0.0.1")); /* where it is nobody learns */
    buf_free(&r.raw);
}

static void what_is_known_outlasts_the_place(void **state)
{
    (void)state;
    fleet_start(0.2);
    assert_int_equal(change(&f.node[0], "PUT", "evening", "", BLEND), 201);
    assert_int_equal(get(&f.node[1], path_of("evening")), 200);
    server_stop(&f.node[2].server);
    atomic_store(&ranges.way, RANGES_DOWN);
    assert_not_known(&f.node[1], path_of("morning"));
    assert_not_known(&f.node[1], "/d/toy/tileset.json?appearance=morning");
    assert_int_equal(get(&f.node[1], path_of("evening")), 200);
    assert_int_equal(get(&f.node[1], "/d/toy/tileset.json?appearance=p1.jpg"), 200);
    assert_int_equal(get(&f.node[1], "/readyz"), 200);
    assert_int_equal(change(&f.node[0], "PUT", "morning", "", DAWN), 503);
    node_start(&f.node[2], 0.2); /* it starts without */
    assert_not_known(&f.node[2], path_of("evening"));
    atomic_store(&ranges.way, RANGES_WELL);
    await_status(&f.node[2], path_of("evening"), 200);
    await_status(&f.node[1], path_of("morning"), 404);
    assert_int_equal(change(&f.node[0], "PUT", "morning", "", DAWN), 201);
    assert_int_equal(get(&f.node[1], path_of("morning")), 200);
}

/* Documents of other appearances, while a request for an unknown name waits for a place that says
 * nothing. Returns whether they came before that request could have ended. */
static bool others_do_not_wait(const struct node *n)
{
    static int asked;
    struct reply r;
    char line[128];
    const double start_s = clock_s();
    const int fd = dial(n->port);
    snprintf(line, sizeof line,
             "GET /d/toy/appearances/night%d HTTP/1.1\r\nHost: localhost\r\n"
             "Connection: close\r\n\r\n",
             asked++);
    say(fd, line);
    nap_ms(300);
    assert_int_equal(get(n, "/d/toy/tileset.json?appearance=evening"), 200);
    assert_int_equal(get(n, "/d/toy/tileset.json?appearance=p2.jpg"), 200);
    const bool soon = clock_s() - start_s < 1.9;
    hear(fd, true, NULL, &r);
    assert_int_equal(r.status, 503);
    buf_free(&r.raw);
    close(fd);
    return soon;
}

/* A place that says nothing keeps neither the request for long nor those for anything else. */
static void a_slow_place_keeps_nobody(void **state)
{
    bool soon = false;
    (void)state;
    fleet_start(3600);
    assert_int_equal(change(&f.node[0], "PUT", "evening", "", BLEND), 201);
    atomic_store(&ranges.way, RANGES_SILENT);
    for (int i = 0; i < 5 && !soon; i++, nap_ms(1100)) /* the machine may be busy */
        soon = others_do_not_wait(&f.node[0]);
    assert_true(soon);
    assert_not_known(&f.node[0], path_of("morning"));
    double start_s = clock_s();
    assert_int_equal(change(&f.node[0], "PUT", "morning", "", DAWN), 503);
    assert_true(clock_s() - start_s < PATIENCE_S);
    start_s = clock_s(); /* and one that waits does not keep the server from its end */
    const int waits = dial(f.node[1].port);
    say(waits, "GET /d/toy/appearances/night HTTP/1.1\r\nHost: localhost\r\n\r\n");
    nap_ms(100);
    server_stop(&f.node[1].server);
    assert_true(clock_s() - start_s < PATIENCE_S);
    close(waits);
}

/* ---- places that cannot be used ---- */

static void put_object(const char *text)
{
    struct err e = {0};
    char path[FILE_PATH_MAX];
    kit_ok(file_join(path, t.dir, "object", &e), e);
    kit_ok(file_write(path, text, strlen(text), &e), e);
    ranges_serve(path, "given");
}

#define ROW(name, text) "{\"dataset\":\"toy\",\"name\":\"" name "\",\"appearance\":\"" text "\"}"
#define LIST(rows) "{\"format\":\"citysplat-names-1\",\"names\":[" rows "]}"

static void what_is_no_list_of_names_is_refused(void **state)
{
    static const char *const wrong[] = {
        "",
        "<html>",
        "{}",
        "{\"format\":\"citysplat-names-2\",\"names\":[]}",
        "{\"format\":\"citysplat-names-1\"}",
        LIST("7"),
        LIST(ROW("default", "dawn")),
        LIST(ROW("a/b", "dawn")),
        LIST(ROW("a", "")),
        LIST(ROW("a", "dawn\\u0000")),
        LIST(ROW("a", "dawn") "," ROW("a", "p1.jpg")),
        LIST("{\"dataset\":\"toy\",\"name\":\"a\",\"appearance\":\"=A\",\"model\":\"12\"}"),
        LIST("{\"dataset\":\"toy\",\"name\":\"a\",\"name\":\"b\",\"appearance\":\"dawn\"}"),
    };
    struct kept *k = NULL;
    (void)state;
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
        struct err e = {0};
        put_object(wrong[i]);
        const enum err_code rc = kept_open_shared(f.url, 1, &k, &e);
        if (rc != ERR_FORMAT)
            fail_msg("%s: %d %s", wrong[i], rc, e.msg);
        assert_null(k);
    }
    put_object(LIST(ROW("b", "dawn") "," ROW("a", "p1.jpg")));
    struct err e = {0};
    kit_ok(kept_open_shared(f.url, 3600, &k, &e), e);
    struct kept_table *all = kept_now(k);
    assert_int_equal(all->n, 2);
    assert_string_equal(kept_find(all, "toy", "a")->text, "p1.jpg");
    kept_drop(&all);
    kept_close(&k);
}

/* What comes to be wrong later is not used, and not written over. */
static void a_list_that_is_damaged_later_is_left_alone(void **state)
{
    (void)state;
    fleet_start(3600);
    assert_int_equal(change(&f.node[0], "PUT", "evening", "", BLEND), 201);
    put_object("{\"format\":");
    assert_not_known(&f.node[0], path_of("morning"));
    assert_int_equal(get(&f.node[0], path_of("evening")), 200);
    assert_int_equal(change(&f.node[0], "PUT", "morning", "", DAWN), 500);
    assert_int_equal(ranges.object.size, 10);
}

static void places_that_would_lose_changes_are_refused(void **state)
{
    static const struct {
        int way;
        enum err_code code;
        const char *says;
    } cases[] = {
        {RANGES_DEAF, ERR_FORMAT, "ignores If-Match"},
        {RANGES_UNNAMED, ERR_FORMAT, "no strong ETag"},
        {RANGES_CODED, ERR_FORMAT, "compressed"},
        {RANGES_FORBIDDEN, ERR_IO, "may not be read"},
        {RANGES_AROUND, ERR_IO, "redirects"},
        {RANGES_FILE, ERR_IO, "file"},
    };
    struct err e = {0};
    struct kept *k = NULL;
    (void)state;
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        put_object(LIST(ROW("a", "dawn")));
        atomic_store(&ranges.way, cases[i].way);
        kit_fails(kept_open_shared(f.url, 1, &k, &e), cases[i].code, e, cases[i].says);
    }
    kit_fails(kept_open_shared("/tmp/names", 1, &k, &e), ERR_ARG, e, "https://");
    put_object(LIST(ROW("a", "dawn")));
    atomic_store(&ranges.way, RANGES_FIXED); /* of a server that may only read */
    node_start(&f.node[0], 3600);
    assert_int_equal(get(&f.node[0], path_of("a")), 200);
    assert_int_equal(change(&f.node[0], "PUT", "b", "", DAWN), 500);
    assert_int_equal(get(&f.node[0], path_of("b")), 404);
}

int main(void)
{
#define TEST(f) cmocka_unit_test_setup_teardown(f, setup_fleet, teardown_fleet)
    const struct CMUnitTest tests[] = {
        TEST(what_one_keeps_all_answer_at_once),
        TEST(what_is_kept_outlives_its_server),
        TEST(changes_and_removals_come_by_themselves),
        TEST(changes_of_many_are_all_there),
        TEST(bare_tags_are_found_out),
        TEST(changes_are_repeated),
        TEST(unknown_names_cause_few_requests),
        TEST(what_is_known_outlasts_the_place),
        TEST(a_slow_place_keeps_nobody),
        TEST(what_is_no_list_of_names_is_refused),
        TEST(a_list_that_is_damaged_later_is_left_alone),
        TEST(places_that_would_lose_changes_are_refused),
    };
    return cmocka_run_group_tests(tests, setup_all_shared, teardown_all_shared);
}
