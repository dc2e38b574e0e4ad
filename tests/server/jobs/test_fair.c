/* One client asks for far too much; the others still get their share: turns in queues, rates,
 * connections, and the identity of clients behind a proxy.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/client.h"

#include <math.h>

#include "core/pool.h"
#include "server/base/address.h"
#include "server/http/ipv6_groups.h"
#include "server/jobs/cost.h"
#include "server/jobs/fair_queue.h"
#include "server/jobs/rate.h"

/* ---- turns ---- */

struct thing {
    struct fair_queue_item place;
    int number;
};

static int taken(struct fair_queue *q)
{
    struct fair_queue_item *it = fair_queue_next(q);
    return it ? ((struct thing *)(void *)it)->number : -1;
}

enum { THINGS = 8 };
static void begin(bool newest, struct thing x[THINGS], struct fair_queue **q)
{
    struct err e = {0};
    kit_ok(fair_queue_open(newest, q, &e), e);
    for (int i = 0; i < THINGS; i++)
        x[i] = (struct thing){.number = i};
}

static void test_turns(void **state)
{
    struct thing x[THINGS];
    struct fair_queue *q = NULL;
    for (int newest = 0; newest < 2; newest++) {
        begin(newest, x, &q);
        assert_int_equal(taken(q), -1);
        for (int i = 0; i < 5; i++)
            fair_queue_add(q, &x[i].place, 77, 1);
        fair_queue_add(q, &x[5].place, 88, 1);
        fair_queue_add(q, &x[6].place, 99, 1);
        assert_int_equal(fair_queue_count(q), 7);
        const int old_first[] = {0, 5, 6, 1, 2}, new_first[] = {4, 5, 6, 3, 2};
        for (int i = 0; i < 5; i++)
            assert_int_equal(taken(q), (newest ? new_first : old_first)[i]);
        fair_queue_add(q, &x[7].place, 88, 1); /* 88 had its turn before 77 had its last */
        assert_int_equal(taken(q), 7);
        fair_queue_remove(q, &x[newest ? 1 : 3].place);
        assert_int_equal(taken(q), newest ? 0 : 4);
        assert_int_equal(taken(q), -1);
        fair_queue_close(&q);
    }
}

/* Parts of the time, not of the number: one dear item of the first, a hundred cheap ones of the
 * second. What was taken for cheap and was dear is paid for afterwards. */
static void test_parts_of_time(void **state)
{
    enum { CHEAP = 300 };
    static struct thing cheap[CHEAP], dear[THINGS];
    struct fair_queue *q = NULL;
    struct err e = {0};
    kit_ok(fair_queue_open(false, &q, &e), e);
    for (int i = 0; i < THINGS; i++) {
        dear[i] = (struct thing){.number = 1000 + i};
        fair_queue_add(q, &dear[i].place, 1, 100);
    }
    for (int i = 0; i < CHEAP; i++) {
        cheap[i] = (struct thing){.number = i};
        fair_queue_add(q, &cheap[i].place, 2, 1);
    }
    int n_dear = 0, n_cheap = 0;
    while (n_cheap < 200)
        *(taken(q) >= 1000 ? &n_dear : &n_cheap) += 1;
    assert_in_range(n_dear, 2, 3);
    /* a third sees what both have before it: their parts, up to its own */
    assert_true(fair_queue_wait_ms(q, 3) <= 101);
    assert_true(fair_queue_wait_ms(q, 1) >= 100 * (THINGS - 3));
    fair_queue_charge(q, 2, 500);
    for (int i = 0; i < 4; i++)
        assert_true(taken(q) >= 1000);
    assert_ptr_equal(fair_queue_oldest(q, 2), &cheap[200].place);
    assert_null(fair_queue_oldest(q, 9));
    while (fair_queue_count(q))
        taken(q);
    fair_queue_close(&q);
}

/* What work takes is learned within some jobs, by kind; one that took very long is no rule. */
static void test_costs_are_learned(void **state)
{
    struct cost c = {0};
    const struct cost_kind one = {&c, 1}, two = {&c, 2}, other = {state, 1};
    assert_true(fabs(cost_predict(&c, one, 20) - 20) < 1e-9);
    for (int i = 0; i < 30; i++)
        cost_learn(&c, one, 10, 35);
    assert_true(fabs(cost_predict(&c, one, 20) / 70 - 1) < 0.02);
    assert_true(fabs(cost_predict(&c, two, 20) - 20) < 1e-9); /* another kind */
    assert_true(fabs(cost_predict(&c, other, 20) - 20) < 1e-9);
    cost_learn(&c, one, 10, 1e6);
    assert_true(cost_predict(&c, one, 20) < 120);
    for (int i = 0; i < 60; i++)
        cost_learn(&c, one, 10, 0);
    assert_true(cost_predict(&c, one, 20) > 0 && cost_predict(&c, one, 20) < 1);
    cost_learn(&c, one, (double)NAN, 5);
    assert_true(isfinite(cost_predict(&c, one, 20)));
    for (unsigned i = 0; i < 2 * COST_KINDS; i++) /* more than are learned */
        cost_learn(&c, (struct cost_kind){&c, i}, 1, 5);
    assert_true(cost_predict(&c, (struct cost_kind){&c, 0}, 20) > 20);
    assert_true(fabs(cost_predict(&c, (struct cost_kind){&c, 2 * COST_KINDS - 1}, 20) - 20) < 1e-9);
}

/* Who gives way: one of whoever has most; of equals, who had a turn last; never one who has
 * less. */
static void test_who_gives_way(void **state)
{
    struct thing x[THINGS];
    struct fair_queue *q = NULL;
    for (int newest = 0; newest < 2; newest++) {
        begin(newest, x, &q);
        fair_queue_add(q, &x[0].place, 1, 1);
        fair_queue_add(q, &x[1].place, 1, 1);
        fair_queue_add(q, &x[2].place, 1, 1);
        fair_queue_add(q, &x[3].place, 2, 1);
        assert_ptr_equal(fair_queue_shed(q, 2),
                         &x[newest ? 0 : 2].place); /* 2 has two with the new one */
        assert_ptr_equal(fair_queue_shed(q, 3), &x[newest ? 0 : 2].place);
        assert_ptr_equal(fair_queue_shed(q, 1), newest ? &x[0].place : NULL); /* its own */
        fair_queue_join(q, &x[2].place, 3); /* the third wants what the first waits for */
        assert_int_equal(fair_queue_owner(&x[2].place), 3);
        fair_queue_join(q, &x[3].place, 1);
        assert_int_equal(fair_queue_owner(&x[3].place), 2); /* who has more takes nothing over */
        while (fair_queue_count(q))
            taken(q);
        for (int i = 4; i < 7; i++)
            fair_queue_add(q, &x[i].place, (uint64_t)i, 1);
        assert_null(fair_queue_shed(q, 1));  /* all have one, and the asker had a turn last */
        assert_null(fair_queue_shed(q, 99)); /* nobody of them had one */
        int first = taken(q);
        fair_queue_add(q, &x[first].place, (uint64_t)first, 1);
        assert_ptr_equal(fair_queue_shed(q, 99), &x[first].place);
        while (fair_queue_count(q))
            taken(q);
        fair_queue_close(&q);
    }
}

/* More clients than places in the table: nothing is lost. */
static void test_very_many_clients(void **state)
{
    enum { N = 9000 };
    struct thing *x = mem_array(N, sizeof *x);
    struct fair_queue *q = NULL;
    struct err e = {0};
    uint64_t sum = 0;
    assert_non_null(x);
    kit_ok(fair_queue_open(false, &q, &e), e);
    for (int i = 0; i < N; i++) {
        x[i].number = i;
        fair_queue_add(q, &x[i].place, rng_u64(3, 0, (uint64_t)i), 1);
    }
    for (int i = 0; i < N; i++)
        sum += (uint64_t)taken(q);
    assert_int_equal(sum, (uint64_t)N * (N - 1) / 2);
    assert_int_equal(taken(q), -1);
    fair_queue_close(&q);
    mem_free(x);
}

/* ---- rates ---- */

static void test_rates(void **state)
{
    struct rate *r = NULL;
    struct err e = {0};
    int n = 0;
    kit_ok(rate_open(5, 10, &r, &e), e);
    while (!(rate_take(r, 1, 100) > 0))
        n++;
    assert_int_equal(n, 50);
    assert_true(fabs(rate_take(r, 1, 100) - 0.2) < 1e-9);
    rate_give(r, 1); /* one came to nothing */
    assert_true(rate_take(r, 1, 100) == 0);
    assert_true(rate_take(r, 1, 100) > 0);
    rate_give(r, 7);                        /* of whom nothing is known */
    assert_true(rate_take(r, 2, 100) == 0); /* somebody else */
    n = 0;
    for (double at = 100; at < 120; at += 0.01)
        n += !(rate_take(r, 1, at) > 0);
    assert_in_range(n, 99, 101);
    for (uint64_t i = 10; i < 20000; i++) /* strangers push the first one's bucket out, not over */
        assert_true(rate_take(r, i, 130) == 0);
    rate_close(&r);
    kit_ok(rate_open(0, 10, &r, &e), e);
    for (int i = 0; i < 1000; i++)
        assert_true(rate_take(r, 1, 1) == 0);
    rate_close(&r);
}

/* ---- addresses ---- */

static void test_addresses(void **state)
{
    static const char trusted[] = "127.0.0.1, 10.0.0.0/8,fd00::/8,2001:db8::7";
    static const struct {
        const char *peer, *forwarded /* '|' between fields */, *client;
    } rows[] = {
        {"127.0.0.1", "9.9.9.9", "9.9.9.9"},
        {"127.0.0.1", "1.1.1.1, 9.9.9.9", "9.9.9.9"},  /* what the client wrote itself is before */
        {"127.0.0.1", "9.9.9.9, 10.3.4.5", "9.9.9.9"}, /* two proxies */
        {"127.0.0.1", "9.9.9.9:5000", "9.9.9.9"},
        {"127.0.0.1", "[2001:db8::1]:80,fd00::3", "2001:db8::1"},
        {"127.0.0.1", "2001:db8::1", "2001:db8::1"},
        {"127.0.0.1", "unknown", "127.0.0.1"},
        {"127.0.0.1", "9.9.9.9|10.3.4.5", "9.9.9.9"}, /* of a proxy that adds a field of its own */
        {"127.0.0.1", "1.1.1.1|9.9.9.9, 10.3.4.5|10.3.4.6", "9.9.9.9"},
        {"127.0.0.1", "9.9.9.9|", "9.9.9.9"},
        {"127.0.0.1", "9.9.9.9|unknown|10.3.4.5", "10.3.4.5"},
        {"127.0.0.1", "9.9.9.9|10.3.4.5|8.8.8.8", "8.8.8.8"},
        {"127.0.0.1", "", "127.0.0.1"},
        {"127.0.0.1", NULL, "127.0.0.1"},
        {"127.0.0.1", "10.1.1.1,10.2.2.2", "10.1.1.1"},
        {"127.0.0.2", "9.9.9.9", "127.0.0.2"}, /* nobody whom the server trusts */
        {"2001:db8::8", "9.9.9.9", "2001:db8::8"},
        {"2001:db8::7", "9.9.9.9", "9.9.9.9"},
        {"::ffff:10.0.0.9", "9.9.9.9", "9.9.9.9"}, /* IPv4 through an IPv6 socket */
    };
    static const char *const bad[] = {"localhost", "10.0.0.0/33", "10.0.0.0/",  "10.0.0.0/+8",
                                      "::/129",    "1.2.3",       "10.0.0.0/8x"};
    static const struct {
        const char *host;
        bool local;
    } hosts[] = {
        {"localhost", true},    {"LOCALHOST:8080", true},
        {"127.0.0.1:80", true}, {"127.9.9.9", true},
        {"[::1]:8080", true},   {"[::1]", true},
        {"example.org", false}, {"", false},
        {"citysplat", false},   {"localhost.evil", false},
        {"10.0.0.1", false},    {NULL, false},
        {"128.0.0.1:1", false}, {"[::2]", false},
    };
    struct address_nets nets;
    struct err e = {0};
    const struct hash128 secret = {1, 2}, other = {1, 3};
    kit_ok(address_read_nets(trusted, &nets, &e), e);
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        struct address peer, want, got;
        assert_true(address_parse(rows[i].peer, strlen(rows[i].peer), &peer));
        assert_true(address_parse(rows[i].client, strlen(rows[i].client), &want));
        char text[128];
        const char *fields[4];
        size_t n = 0;
        snprintf(text, sizeof text, "%s", rows[i].forwarded ? rows[i].forwarded : "");
        for (char *p = rows[i].forwarded ? text : NULL; p; p = strchr(p, '|'), p += p != NULL) {
            if (n)
                p[-1] = '\0';
            fields[n++] = p;
        }
        got = address_client(&nets, peer, fields, n);
        if (memcmp(&got, &want, sizeof got) != 0)
            fail_msg("%s with %s is not %s", rows[i].peer,
                     rows[i].forwarded ? rows[i].forwarded : "nothing", rows[i].client);
    }
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        kit_fails(address_read_nets(bad[i], &nets, &e), ERR_ARG, e, "--trusted-proxy");
    kit_ok(address_read_nets(NULL, &nets, &e), e);
    assert_int_equal(nets.n, 0);
    for (size_t i = 0; i < sizeof hosts / sizeof *hosts; i++)
        assert_int_equal(address_host_is_loopback(hosts[i].host), hosts[i].local);
    struct address a, b, c;
    assert_true(address_parse("2001:db8:1:2::5", 15, &a));
    assert_true(address_parse("2001:db8:1:2:9::", 16, &b));
    assert_true(address_parse("2001:db8:1:3::5", 15, &c));
    assert_int_equal(address_number(a, secret), address_number(b, secret)); /* one household */
    assert_int_not_equal(address_number(a, secret), address_number(c, secret));
    assert_int_not_equal(address_number(a, secret), address_number(a, other));
    assert_true(address_parse("1.2.3.4", 7, &a) && address_parse("1.2.3.5", 7, &b));
    assert_int_not_equal(address_number(a, secret), address_number(b, secret));
}

/* ---- the server ---- */

/* STARTED: what may have been under way, or next in turn, when the victim came and when it left:
 * the tile that the one worker makes, and one more, twice. */
enum { ABUSERS = 24, VICTIM = ABUSERS, TILES = 12, STARTED = 4 };
enum { HEAD_SLOW_MS = 500 }; /* client_watch.c: a request that is not complete then gives way */
struct load {
    atomic_bool stop;
    atomic_int served, refused; /* abusers' answers */
    double end_s;               /* nobody goes on after this */
    double victim_s;
    int victim_ok, victim_other;
    uint64_t made_before, made_after;
};

static uint64_t tiles_made(void)
{
    struct job_stats st;
    job_count(server_services(t.server)->jobs, &st);
    return served_tiles(&st, JOB_OK);
}

/* A tile that is in no cache; n tells them apart, and those of the victim from those of others. */
static const char *cold_target(int n, bool victim, char out[160])
{
    static const char *const exts[] = {"glb", "spz", "drc"};
    static const char *const presets[] = {"spz", "preview", "balanced", "near-lossless"};
    const struct key k = served_key((uint8_t)(victim ? 15 : 16 + n / 24 % 2));
    snprintf(out, 160, "/d/toy/r/%s/t/%u/%u/%u.%s?preset=%s&sh=%d", t.rev, k.z, k.x, k.y,
             exts[n % 3], presets[n / 3 % 4], n / 12 % 2);
    return out;
}

static int ask_as(const char *target, const char *client)
{
    char line[64];
    snprintf(line, sizeof line, "X-Forwarded-For: %s\r\n", client);
    return status_of("GET", target, line);
}

static enum err_code crowd_run(void *user, size_t i, struct err *e)
{
    struct load *c = user;
    char target[160];
    (void)e;
    if (i != VICTIM) {
        for (int n = (int)i * 7; !atomic_load(&c->stop) && clock_s() < c->end_s; n++) {
            int status = ask_as(cold_target(n, false, target), "203.0.113.9");
            atomic_fetch_add(status == 200 ? &c->served : &c->refused, 1);
        }
        return ERR_OK;
    }
    while (atomic_load(&c->served) < 2 * ABUSERS && clock_s() < c->end_s)
        nap_ms(2);
    c->made_before = tiles_made();
    double start_s = clock_s();
    for (int n = 0; n < TILES; n++) {
        int status = ask_as(cold_target(n, true, target), "198.51.100.7");
        *(status == 200 ? &c->victim_ok : &c->victim_other) += 1;
    }
    c->victim_s = clock_s() - start_s;
    c->made_after = tiles_made();
    atomic_store(&c->stop, true);
    return ERR_OK;
}

/* Twenty-four connections of one address ask for tiles that nobody has, one after the other, in a
 * queue that they fill; one connection of another does the same. Each address gets half, so the
 * victim gets at least one tile for each two of theirs, and is never turned away. */
static void test_a_share_of_tiles(void **state)
{
    struct err e = {0};
    char path[FILE_PATH_MAX];
    kit_ok(file_join(path, t.dir, "fair.tiles", &e), e);
    served_city(path, "toy", 20000);
    t.paths[0] = path;
    t.cfg.workers = 1;
    t.cfg.cache_mb = 1; /* such tiles are too large to be kept */
    t.cfg.queue_tiles = 12;
    t.cfg.client_tiles_s = 0;
    t.cfg.trusted_proxy = "127.0.0.1";
    start();
    t.paths[0] = t.path;
    struct load c = {.end_s = clock_s() + 3 * PATIENCE_S};
    kit_ok(pool_for(ABUSERS + 1, ABUSERS + 1, crowd_run, &c, &e), e);
    int theirs = (int)(c.made_after - c.made_before) - c.victim_ok;
    print_message("victim: %d tiles in %.2f s, the others %d, and %d refused\n", c.victim_ok,
                  c.victim_s, theirs, atomic_load(&c.refused));
    assert_int_equal(c.victim_ok, TILES);
    assert_int_equal(c.victim_other, 0);
    assert_true(atomic_load(&c.served) >= 2 * ABUSERS); /* else they were too slow to be a crowd */
    assert_true(theirs <= 2 * TILES + STARTED);
    assert_true(atomic_load(&c.refused) > 0); /* the queue was full */
}

static void test_limited_rates(void **state)
{
    enum { ASKED = 40 };
    char target[160];
    struct reply r;
    int ok = 0, limited = 0;
    t.cfg.client_tiles_s = 2;
    t.cfg.trusted_proxy = "127.0.0.1";
    start();
    double start_s = clock_s();
    for (int n = 0; n < ASKED; n++) {
        ask("GET", cold_target(n, false, target), "X-Forwarded-For: 203.0.113.9\r\n", &r);
        ok += r.status == 200;
        limited += r.status == 429;
        if (r.status == 429) {
            assert_in_range(atoi(header(&r, "Retry-After")), 1, 2);
            assert_string_equal(header(&r, "Content-Type"), "application/problem+json");
            assert_string_equal(header(&r, "Cache-Control"), "no-store");
        }
        buf_free(&r.raw);
    }
    int more = (int)((clock_s() - start_s) * 2) + 1;
    assert_int_equal(ok + limited, ASKED);
    assert_in_range(ok, 20, 20 + more);
    for (int i = 0; i < 60; i++) /* hot tiles are never limited, nor is a name that fits already */
        assert_int_equal(ask_as(cold_target(0, false, target), "203.0.113.9"), 200);
    assert_int_equal(ask_as(cold_target(ASKED - 1, false, target), "198.51.100.7"), 200);
    ask("GET", "/metrics", "", &r);
    buf_free(&r.raw);
    struct job_stats st;
    job_count(server_services(t.server)->jobs, &st);
    assert_int_equal(served_tiles(&st, JOB_LIMITED), limited);
}

/* Eight /64s of a /56 are clients of their own. With a ninth the /56 is one client for a minute;
 * /56s of a /48 likewise. Others, and IPv4, are not touched. */
static void test_networks(void **state)
{
    struct ipv6_groups *c = NULL;
    struct err e = {0};
    struct address a = {.ip = {0x20, 1, 0xd, 0xb8, 0, 1}},
                   other = {.ip = {0x20, 1, 0xd, 0xb8, 0, 2}};
    struct address v4;
    assert_true(address_parse("192.0.2.7", 9, &v4));
    kit_ok(ipv6_groups_open((struct hash128){4, 5}, &c, &e), e);
    a.ip[15] = other.ip[15] = 1;
    for (int round = 0; round < 3; round++)
        for (int i = 0; i < IPV6_GROUPS_MOST; i++) {
            a.ip[7] = (uint8_t)i;
            struct address got = ipv6_groups_client(c, a, 10 + round);
            assert_memory_equal(got.ip, a.ip, 8);
            assert_int_equal(got.ip[15], 0);
        }
    a.ip[7] = 100;
    assert_int_equal(ipv6_groups_client(c, a, 20).ip[7], 0); /* the ninth: all are one */
    a.ip[7] = 3;
    assert_int_equal(ipv6_groups_client(c, a, 21).ip[7], 0);
    assert_int_equal(ipv6_groups_client(c, a, 20.5 + IPV6_GROUPS_S).ip[7],
                     3);             /* over: only two asked since */
    for (int i = 0; i < 1000; i++) { /* of a /48: a /64 in each of its /56s */
        a.ip[6] = (uint8_t)i;
        a.ip[7] = (uint8_t)(i / 3);
        struct address got = ipv6_groups_client(c, a, 200 + 0.01 * i);
        assert_int_equal(got.ip[6] || got.ip[7], i > 0 && i < IPV6_GROUPS_MOST);
    }
    other.ip[7] = 9;
    assert_memory_equal(ipv6_groups_client(c, other, 200).ip, other.ip, 8);
    assert_memory_equal(ipv6_groups_client(c, v4, 200).ip, v4.ip, 16);
    for (uint32_t i = 0; i < 100000; i++) { /* very many networks: others are forgotten */
        memcpy(a.ip + 2, &i, 4);
        assert_memory_equal(ipv6_groups_client(c, a, 300 + 1e-3 * i).ip, a.ip, 8);
    }
    ipv6_groups_close(&c);
}

/* ---- connections ---- */

static int dial_and_ask(int *status)
{
    struct reply r;
    int fd = dial(t.port);
    say(fd, "GET /healthz HTTP/1.1\r\n" H "\r\n");
    hear(fd, true, NULL, &r);
    *status = r.status;
    buf_free(&r.raw);
    return fd;
}

/* Until so many connections are idle in the eyes of the server, each for another number of
 * milliseconds than the one that comes next. */
static void await_idle(uint64_t n)
{
    struct services *s = server_services(t.server);
    for (double end_s = clock_s() + PATIENCE_S; clock_s() < end_s; nap_ms(1))
        if (!atomic_load(&s->metrics.inflight) && connections() >= n)
            break;
    for (double since_s = clock_s(); clock_s() - since_s < 0.002;)
        nap_ms(1);
}

static bool ended(int fd, double wait_s)
{
    struct buf b = {0};
    bool open = hear_some(fd, &b, wait_s);
    buf_free(&b);
    return !open;
}

/* Idle connections give way, the one that is idle longest first. */
static void test_idle_connections_give_way(void **state)
{
    enum { LIMIT = 8, MORE = 5 };
    int fd[LIMIT + MORE], status;
    for (int all = 0; all < 2; all++) {
        *(all ? &t.cfg.max_connections : &t.cfg.per_ip_connections) = LIMIT;
        start();
        for (int i = 0; i < LIMIT + MORE; i++) {
            fd[i] = dial_and_ask(&status);
            assert_int_equal(status, 200);
            await_idle(i + 1 < LIMIT ? (size_t)i + 1 : LIMIT);
        }
        for (int i = 0; i < LIMIT + MORE; i++)
            assert_int_equal(ended(fd[i], i < MORE ? PATIENCE_S : 0.05), i < MORE);
        assert_int_equal(atomic_load(&server_services(t.server)->metrics.displaced), MORE);
        for (int i = 0; i < LIMIT + MORE; i++)
            close(fd[i]);
        server_stop(&t.server);
        t.cfg.per_ip_connections = 256;
    }
}

/* A neighbour on the same address holds all connections with headers that never end, bodies that
 * never come and answers that it does not read; whoever comes is served. */
static void test_slow_neighbours(void **state)
{
    enum { LIMIT = 16, ASKED = 20 };
    int fd[2 * LIMIT];
    t.cfg.per_ip_connections = LIMIT;
    start();
    for (int i = 0; i < 2 * LIMIT; i++) {
        fd[i] = dial(t.port);
        say(fd[i], i % 2 ? "GET / HTTP/1.1\r\nX: " : POST "Content-Length: 100\r\n\r\n{");
    }
    for (double since_s = clock_s(); (clock_s() - since_s) * 1000 < HEAD_SLOW_MS + 200;)
        nap_ms(20);
    for (int i = 0; i < ASKED; i++)
        assert_int_equal(status_of("GET", "/healthz", ""), 200);
    for (int i = 0; i < 2 * LIMIT; i++)
        close(fd[i]);
}

/* Fills the limit with connections that say nothing and asks on one more. *in_time: none of them
 * had been open for long enough to give way when the answer was here, so that the answer is the one
 * of a full server. */
static void ask_when_full(int limit, struct reply *r, bool *in_time)
{
    int fd[16];
    assert_in_range(limit, 1, sizeof fd / sizeof *fd);
    double start_s = clock_s();
    for (int i = 0; i < limit; i++)
        fd[i] = dial(t.port);
    /* Threads of the server accept: what was dialled first need not be counted first. */
    for (double end_s = clock_s() + PATIENCE_S; clock_s() < end_s && connections() < (size_t)limit;)
        nap_ms(1);
    ask("GET", "/healthz", "", r);
    *in_time = (clock_s() - start_s) * 1000 < HEAD_SLOW_MS;
    for (int i = 0; i < limit; i++)
        close(fd[i]);
    await_no_connections();
}

/* Where every connection has come just now, one more is told so, in time. A machine that is too
 * busy to open them within the time after which they give way is asked again. */
static void test_too_many_connections_are_told(void **state)
{
    enum { LIMIT = 8, TRIES = 20 };
    struct reply r;
    for (int all = 0; all < 2; all++) {
        *(all ? &t.cfg.max_connections : &t.cfg.per_ip_connections) = LIMIT;
        start();
        bool in_time = false;
        for (int n = 0; n < TRIES && !in_time; n++) {
            ask_when_full(LIMIT, &r, &in_time);
            if (in_time) {
                assert_int_equal(r.status, 503);
                assert_string_equal(header(&r, "Connection"), "close");
                assert_string_equal(header(&r, "Content-Type"), "application/problem+json");
                assert_true(atoi(header(&r, "Retry-After")) >= 1);
            }
            buf_free(&r.raw);
        }
        assert_true(in_time);
        assert_int_equal(status_of("GET", "/healthz", ""), 200);
        server_stop(&t.server);
        t.cfg.per_ip_connections = 256;
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_turns),
        cmocka_unit_test(test_parts_of_time),
        cmocka_unit_test(test_costs_are_learned),
        cmocka_unit_test(test_who_gives_way),
        cmocka_unit_test(test_very_many_clients),
        cmocka_unit_test(test_rates),
        cmocka_unit_test(test_addresses),
        cmocka_unit_test(test_networks),
        HTTP_TEST(test_a_share_of_tiles),
        HTTP_TEST(test_limited_rates),
        HTTP_TEST(test_idle_connections_give_way),
        HTTP_TEST(test_slow_neighbours),
        HTTP_TEST(test_too_many_connections_are_told),
    };
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
