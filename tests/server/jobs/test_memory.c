/* One number for memory: what the machine and its control groups have, how it is shared out, what
 * is refused, and what happens where memory runs out all the same.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/client.h"

#include "core/machine.h"
#include "server/answers/services.h"
#include "server/answers/work.h"
#include "server/base/memory.h"

enum { MB = 1 << 20 };

/* ---- what there is ---- */

static void check_size(const char *text, size_t want)
{
    struct err e = {0};
    size_t got = 0;
    enum err_code rc = machine_memory_parse(text, 2000u * MB, &got, &e);
    if (!want) {
        kit_fails(rc, ERR_ARG, e, "--memory");
        return;
    }
    kit_ok(rc, e);
    assert_int_equal(got, want);
}

static void test_sizes(void **state)
{
    static const struct {
        const char *text;
        size_t want; /* 0: refused */
    } rows[] = {{"auto", 1000u * MB}, {"512M", 512u * MB}, {"1.5G", 1536u * MB},
                {"2097152", 2 * MB},  {"4096k", 4 * MB},   {"0", 0},
                {"-1G", 0},           {"512MB", 0},        {"", 0},
                {"half", 0},          {"1e99", 0},         {"nan", 0},
                {"1000", 0}};
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        check_size(rows[i].text, rows[i].want);
}

static void put(const char *dir, const char *name, const char *text, char path[FILE_PATH_MAX])
{
    struct err e = {0};
    kit_ok(file_join(path, dir, name, &e), e);
    kit_ok(file_write(path, text, strlen(text), &e), e);
}

/* Groups of both versions: the tightest one on the way to the root counts. A path that is not below
 * the root, as in a container, means the root's own limit. */
static void test_groups(void **state)
{
    static const char *const dirs[] = {"two", "two/a",      "two/a/b",
                                       "one", "one/memory", "one/memory/x"};
    struct err e = {0};
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], two[FILE_PATH_MAX], one[FILE_PATH_MAX];
    kit_tmpdir(dir);
    for (size_t i = 0; i < sizeof dirs / sizeof *dirs; i++) {
        kit_ok(file_join(path, dir, dirs[i], &e), e);
        kit_ok(file_mkdir(path, &e), e);
    }
    kit_ok(file_join(two, dir, "two", &e), e);
    kit_ok(file_join(one, dir, "one", &e), e);
    put(dir, "two/memory.max", "max\n", path);
    put(dir, "two/a/memory.max", "300000000\n", path);
    put(dir, "two/a/b/memory.max", "400000000\n", path);
    put(dir, "one/memory/memory.limit_in_bytes", "9223372036854771712\n", path);
    put(dir, "one/memory/x/memory.limit_in_bytes", "200000000\n", path);
    put(dir, "groups", "0::/a/b\n", path);
    assert_int_equal(machine_memory_limit(1000000000, path, two), 300000000);
    assert_int_equal(machine_memory_limit(100000000, path, two), 100000000);
    put(dir, "groups", "9:cpu:/y\n4:memory:/x\n0::/\n", path);
    assert_int_equal(machine_memory_limit(1000000000, path, one), 200000000);
    put(dir, "groups", "4:memory:/elsewhere/docker/7\n", path);
    assert_int_equal(machine_memory_limit(1000000000, path, one), 1000000000);
    put(dir, "one/memory/memory.limit_in_bytes", "500000000\n", two);
    assert_int_equal(machine_memory_limit(1000000000, path, one), 500000000);
    assert_int_equal(machine_memory_limit(1000000000, "/nonexistent", one), 1000000000);
    assert_true(machine_memory() > 64u * MB);
    kit_rmdir(dir);
}

/* ---- shares ---- */

static size_t sum_of(const struct memory_plan *p)
{
    return p->cache + p->inflight + p->drawing;
}

static struct memory_needs needs(size_t budget_mb)
{
    return (struct memory_needs){.budget = budget_mb * MB,
                                 .base = 40u * MB,
                                 .workers = 2,
                                 .connections = 2048,
                                 .largest_tile = 2u * MB,
                                 .draws = true,
                                 .gaussians = 1000000,
                                 .view_gaussians = 1200000,
                                 .view_mpx = 4};
}

/* What the message of a budget that is too small names, MB. */
static size_t named_mb(const struct err *e)
{
    const char *at = strstr(e->msg, "give --memory ");
    assert_non_null(at);
    return (size_t)atol(at + strlen("give --memory "));
}

/* last: of a smaller budget. */
static void check_plan(const struct memory_plan *p, const struct memory_plan *last,
                       const struct memory_needs *n)
{
    assert_true(sum_of(p) + n->base <= n->budget);
    /* but for what one more worker or store to draw takes */
    const size_t step = n->largest_tile * 5 + 2 * (size_t)MB;
    assert_true(p->cache + step >= last->cache);
    assert_true(p->inflight + step >= last->inflight);
    assert_true(p->drawing + step >= last->drawing);
    assert_in_range(p->workers, 1, INT32_MAX);
    assert_in_range(p->connections, 64, INT32_MAX);
    assert_int_equal(p->drawing > 0, n->draws);
}

static void check_budget(size_t mb, bool draws, size_t *said, struct memory_plan *last)
{
    struct err e = {0};
    struct memory_plan p;
    struct memory_needs n = needs(mb);
    n.draws = draws;
    enum err_code rc = memory_plan(&n, &p, &e);
    if (rc) {
        kit_fails(rc, ERR_LIMIT, e, "--memory ");
        *said = named_mb(&e);
        assert_in_range(*said, mb + 1, SIZE_MAX);
        return;
    }
    assert_in_range(*said, 1, mb + 4);
    check_plan(&p, last, &n);
    *last = p;
}

/* For every budget: the shares and what is held besides do not exceed it, and none of them shrinks
 * where there is more. Below the least the message names a size, and that size is enough. */
static void test_shares(void **state)
{
    struct memory_plan last = {0};
    for (int draws = 0; draws < 2; draws++) {
        size_t said = 0;
        last = (struct memory_plan){0};
        for (size_t mb = 16; mb < 40000; mb += mb < 1000 ? 4 : 512)
            check_budget(mb, draws, &said, &last);
        assert_false(last.lowered);
        assert_int_equal(last.workers, 2);
        assert_int_equal(last.connections, 2048);
        assert_true(last.cache > (size_t)10000 * MB);
    }
    assert_int_equal(last.slots, 4);
    assert_int_equal(last.view_gaussians, 1200000);
}

/* Options that say how much are taken out of the rest, and are refused where they do not fit. */
static void test_overrides(void **state)
{
    struct err e = {0};
    struct memory_plan p;
    struct memory_needs n = needs(1000);
    n.cache = 300u * MB;
    n.inflight = 50u * MB;
    n.view_cache = 60u * MB;
    kit_ok(memory_plan(&n, &p, &e), e);
    assert_int_equal(p.cache, 300u * MB);
    assert_int_equal(p.inflight, 50u * MB);
    assert_int_equal(p.view_cache, 60u * MB);
    assert_true(sum_of(&p) + n.base <= n.budget);
    n.cache = 900u * MB;
    kit_fails(memory_plan(&n, &p, &e), ERR_LIMIT, e, "--device none");
    n.draws = false;
    n.cache = 990u * MB;
    kit_fails(memory_plan(&n, &p, &e), ERR_LIMIT, e, "too little for these stores");
}

/* Little memory: fewer workers for large tiles, fewer connections, smaller pictures. */
static void test_lowered(void **state)
{
    struct err e = {0};
    struct memory_plan p;
    struct memory_needs n = needs(400);
    n.workers = 16;
    kit_ok(memory_plan(&n, &p, &e), e);
    assert_true(p.workers < 16 && p.workers >= 1);
    assert_true(p.connections < 2048);
    assert_true(p.lowered && p.view_gaussians >= 50000 && p.view_gaussians < 1000000);
    assert_true(p.view_mpx >= 1 && p.slots == 1);
}

/* As many processes draw as have room for pictures that are not lowered, and one in any case. */
static void test_drawers(void **state)
{
    struct err e = {0};
    struct memory_plan p, one;
    struct memory_needs n = needs(400);
    unsigned last = 1;
    n.drawers = 4;
    for (size_t mb = 400; mb <= 8000; mb += 100) {
        n.budget = mb * MB;
        kit_ok(memory_plan(&n, &p, &e), e);
        assert_in_range(p.drawers, last, 4);
        assert_true(sum_of(&p) <= n.budget);
        assert_true(p.drawers == 1 || !p.lowered);
        last = p.drawers;
    }
    assert_int_equal(last, 4);
    n.drawers = 1;
    kit_ok(memory_plan(&n, &one, &e), e);
    assert_true(p.drawing > one.drawing);
    n.budget = 400 * MB;
    n.drawers = 4;
    kit_ok(memory_plan(&n, &p, &e), e);
    assert_int_equal(p.drawers, 1);
}

/* ---- a server ---- */

static void expect_body(const char *target, const char *text, bool there)
{
    struct reply r;
    ask("GET", target, "", &r);
    assert_int_equal(r.status, 200);
    buf_add(&r.raw, "", 1);
    assert_int_equal(strstr((const char *)r.body, text) != NULL, there);
    buf_free(&r.raw);
}

/* A budget that is too small is refused at the start, and the size that the message names works. */
static void test_too_small(void **state)
{
    struct err e = {0};
    char least[32];
    t.cfg.cache_mb = 0;
    t.cfg.memory = "8M";
    kit_fails(server_start(&t.cfg, t.paths, 1, &t.server, &e), ERR_LIMIT, e, "give --memory ");
    assert_null(t.server);
    const char *at = strstr(e.msg, "give --memory ") + strlen("give --memory ");
    snprintf(least, sizeof least, "%ldM", atol(at) + 16); /* the first try left a little behind */
    t.cfg.memory = least;
    start();
    assert_int_equal(status_of("GET", "/d/toy/tileset.json", ""), 200);
    const struct services *s = server_services(t.server);
    assert_true(s->plan.cache >= 4u * MB);
    expect_body("/metrics", "citysplat_memory_budget_bytes ", true);
}

/* More is held than the budget: entries of the cache go, and freed memory goes back. */
static void test_yields(void **state)
{
    char target[128];
    struct reply r;
    struct cache_stats before, after;
    t.cfg.memory = "4G";
    start();
    struct services *s = server_services(t.server);
    for (int z = SERVED_ZOOM_MIN; z <= SERVED_ZOOM_MAX; z++) {
        ask("GET", tile_target((uint8_t)z, "ply", target), "", &r);
        assert_int_equal(r.status, 200);
        buf_free(&r.raw);
    }
    cache_count(s->cache, &before);
    assert_true(before.entries >= 3);
    server_keep_memory(t.server, clock_s());
    cache_count(s->cache, &after);
    assert_int_equal(after.entries, before.entries); /* within the budget nothing goes */
    s->plan.budget = 1;
    server_keep_memory(t.server, clock_s() + 1);
    cache_count(s->cache, &after);
    assert_int_equal(after.entries, 0);
    assert_int_equal(cache_bytes(s->cache), 0);
    assert_int_equal(status_of("GET", tile_target(16, "ply", target), ""), 200);
}

/* An allocation that fails once: the cache gives way, the work is done again, nobody notices. */
static void test_makes_room(void **state)
{
    char target[128];
    struct cache_stats after;
    start();
    struct services *s = server_services(t.server);
    assert_int_equal(status_of("GET", tile_target(16, "ply", target), ""), 200);
    mem_fail_at(1);
    void *p = mem_array(1000, 1000); /* fails, asks the server for room, and succeeds */
    mem_fail_at(0);
    assert_non_null(p);
    mem_free(p);
    cache_count(s->cache, &after);
    assert_int_equal(after.entries, 0);
}

/* Memory that runs out: 503 with Retry-After, /readyz says memory, not damage. */
static void test_short(void **state)
{
    start();
    struct services *s = server_services(t.server);
    expect_body("/readyz", "\"ready\"", true);
    services_note_short(s);
    expect_body("/readyz", "memory", true);
    expect_body("/readyz", "degraded", true);
    expect_body("/readyz", "toy", false);
    atomic_store(&s->short_ms,
                 (uint64_t)(clock_s() * 1e3) > 61000 ? (uint64_t)(clock_s() * 1e3) - 61000 : 1);
    if (clock_s() > 62)
        expect_body("/readyz", "\"ready\"", true);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_sizes),
        cmocka_unit_test(test_groups),
        cmocka_unit_test(test_shares),
        cmocka_unit_test(test_overrides),
        cmocka_unit_test(test_lowered),
        cmocka_unit_test(test_drawers),
        cmocka_unit_test_setup_teardown(test_too_small, setup, teardown),
        cmocka_unit_test_setup_teardown(test_yields, setup, teardown),
        cmocka_unit_test_setup_teardown(test_makes_room, setup, teardown),
        cmocka_unit_test_setup_teardown(test_short, setup, teardown),
    };
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
