/* Streams of pictures that follow a camera: one picture at a time, the newest camera wins, small
 * pictures while it moves and a full one when it rests, limits, readers that are slow or gone, a
 * process that draws and is killed, stopping.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/reader.h"

#include <math.h>
#include <signal.h>

/* The same, and a reader of its first stream. */
static void follow(struct reader *r)
{
    start_drawing();
    reader_open(r, NAME);
    await_streams(1);
}

/* ---- tests ---- */

static void test_small_while_it_moves_full_at_rest(void **state)
{
    enum { POSES = 40 };
    struct reader r;
    struct part p;
    follow(&r);
    assert_false(reader_next(&r, 0.3, &p)); /* nobody said where the camera is */
    assert_int_equal(steer(NAME, 1, 10, 800, ""), 204);
    assert_true(reader_next(&r, PATIENCE_S, &p));
    assert_int_equal(p.pose, 1);
    assert_true(p.width < 400 && !p.rest); /* later ones as large as can be drawn in time */
    long long last = 1;
    for (int i = 2; i <= POSES; i++) { /* ten milliseconds apart: faster than any picture */
        assert_int_equal(steer(NAME, i, 10 + i, 800, ""), 204);
        nap_ms(10);
    }
    int moving = 0, full = 0,
        at_rest = 0; /* a machine that stalls makes a camera rest on its way */
    while (reader_next(&r, at_rest ? 1 : PATIENCE_S, &p)) {
        assert_true(p.pose > last || (p.rest && p.pose == last)); /* never an older camera again */
        moving += !p.rest;
        full += p.rest;
        at_rest += p.rest && p.pose == POSES;
        if (!p.rest)
            assert_true(p.width <= 800 && fabs((double)p.width / p.height - 4.0 / 3) < 0.02);
        last = p.pose;
    }
    assert_int_equal(last, POSES); /* the newest camera is what is seen in the end */
    assert_int_equal(at_rest, 1);  /* in full, once, and then nothing more is sent */
    assert_true(p.bytes == 0 && moving >= 1);
    assert_true(moving < POSES); /* pictures of cameras that had moved on were never drawn */
    struct job_stats st;
    job_count(server_services(t.server)->jobs, &st);
    assert_int_equal(st.ended[JOB_MOTION][JOB_OK], counts().pictures);
    assert_int_equal(counts().full, full);
    print_message("%d poses, %d pictures while moving, 1 at rest\n", POSES, moving);
    /* said to rest: in full at once, in another format */
    assert_int_equal(steer(NAME, POSES + 1, 99, 640, ",\"still\":true,\"format\":\"webp\""), 204);
    assert_true(reader_next(&r, PATIENCE_S, &p));
    assert_true(p.rest && p.width == 640 && p.pose == POSES + 1);
    assert_int_equal(steer(NAME, 3, 99, 640, ""), 204); /* one that was overtaken on the way */
    assert_false(reader_next(&r, 0.5, &p));
    reader_close(&r);
    await_streams(0);
}

static void test_refusals(void **state)
{
    struct reader r[3];
    struct reply a;
    t.cfg.client_streams = 2;
    start_drawing();
    assert_int_equal(steer(NAME, 1, 0, 100, ""), 404); /* nobody reads it */
    ask("GET", "/d/toy/motion/short", "", &a);
    assert_int_equal(a.status, 404);
    buf_free(&a.raw);
    assert_int_equal(status_of("GET", "/d/none/motion/0123456789abcdef", ""), 404);
    reader_open(&r[0], NAME);
    await_streams(1);
    ask("GET", "/d/toy/motion/0123456789abcdef", "", &a); /* somebody else's */
    assert_int_equal(a.status, 409);
    buf_free(&a.raw);
    reader_open(&r[1], "0123456789abcdeg");
    await_streams(2);
    ask("GET", "/d/toy/motion/0123456789abcdeh", "", &a);
    assert_int_equal(a.status, 429);
    assert_true(atoi(header(&a, "Retry-After")) >= 1);
    buf_free(&a.raw);
    assert_int_equal(steer(NAME, 1, 0, 100000, ""), 422);
    assert_int_equal(steer(NAME, 1, 0, 100, ",\"still\":3"), 422);
    assert_int_equal(steer(NAME, 1, 0, 100, ",\"number2\":3"), 422);
    assert_int_equal(status_of("HEAD", "/d/toy/motion/0123456789abcdei", ""), 200);
    assert_int_equal(status_of("PUT", "/d/toy/motion/0123456789abcdei", "Content-Length: 0\r\n"),
                     405);
    assert_int_equal(counts().streams, 2);
    reader_close(&r[0]);
    reader_close(&r[1]);
    await_streams(0); /* readers that hang up are noticed while nothing is sent */
    assert_int_equal(steer(NAME, 1, 0, 100, ""), 404);
    server_stop(&t.server);
    t.cfg.device = "none";
    t.cfg.streams = 0;
    start();
    ask("GET", "/d/toy/motion/0123456789abcdef", "", &a);
    assert_int_equal(a.status, 503);
    buf_free(&a.raw);
}

static void test_idle_streams_end(void **state)
{
    struct reader r;
    struct part p;
    t.cfg.stream_idle_s = 1;
    start_drawing();
    reader_open(&r, NAME);
    assert_false(reader_next(&r, PATIENCE_S, &p));
    assert_true(r.ended && r.last_chunk); /* an orderly end */
    reader_close(&r);
    await_streams(0);
}

/* Where all streams are taken, one that is not steered gives way to a new one; one that is steered
 * does not. */
static void test_unsteered_streams_give_way(void **state)
{
    struct reader r[3];
    struct part p;
    struct reply a;
    const double least_s = 1;
    t.cfg.streams = 2;
    t.cfg.stream_idle_s = 12 * least_s;
    start_drawing();
    reader_open(&r[0], NAME);
    reader_open(&r[1], "0123456789abcdeg");
    await_streams(2);
    const double begun_s = clock_s();
    ask("GET", "/d/toy/motion/0123456789abcdeh", "", &a);
    assert_true(a.status == 503 || clock_s() - begun_s > least_s / 2);
    buf_free(&a.raw);
    while (clock_s() - begun_s < 1.2 * least_s)
        nap_ms(20);
    assert_int_equal(steer("0123456789abcdeg", 1, 0, 100, ""), 204);
    reader_open(&r[2], "0123456789abcdei");
    assert_false(reader_next(&r[0], PATIENCE_S, &p));
    assert_true(r[0].ended && r[0].last_chunk); /* an orderly end */
    assert_int_equal(counts().streams, 2);
    assert_int_equal(steer("0123456789abcdeg", 2, 10, 100, ""), 204);
    assert_int_equal(steer("0123456789abcdei", 1, 10, 100, ""), 204);
    for (int i = 0; i < 3; i++)
        reader_close(&r[i]);
    await_streams(0);
}

/* A reader that stops holds up its own stream alone, and little is drawn for it. */
static void test_slow_reader(void **state)
{
    struct reader slow, fast;
    struct part p;
    t.cfg.write_timeout_s = 1;
    start_drawing();
    reader_open(&slow, NAME);
    reader_open(&fast, "fast-0123456789ab");
    await_streams(2);
    long long seen = 0;
    const char *sharp = ",\"still\":true,\"quality\":100";
    for (int i = 1; counts().streams == 2 && i < 3000; i++) {
        (void)steer(NAME, i, i % 360, 700,
                    sharp); /* large ones fill the socket; nobody reads them */
        if (i % 4 == 0) {
            assert_int_equal(steer("fast-0123456789ab", i, i % 360, 64, ""), 204);
            assert_true(reader_next(&fast, PATIENCE_S, &p));
            seen = p.pose;
        }
    }
    assert_int_equal(counts().streams, 1); /* cut after write_timeout_s */
    assert_true(seen > 0);
    reader_close(&slow);
    reader_close(&fast);
    await_streams(0);
}

/* Streams open and end while others steer them: nothing is left over. */
static void test_come_and_go(void **state)
{
    enum { ROUNDS = 12, STREAMS = 3 };
    struct reader r[STREAMS];
    struct part p;
    char name[STREAMS][32];
    start_drawing();
    for (int round = 0; round < ROUNDS; round++) {
        for (int i = 0; i < STREAMS; i++) {
            snprintf(name[i], sizeof name[i], "come-and-go-%d-%06d", i, round);
            reader_open(&r[i], name[i]);
        }
        await_streams(STREAMS);
        for (int k = 0; k < 4; k++)
            for (int i = 0; i < STREAMS; i++)
                assert_int_equal(steer(name[i], k, k, 300, round % 2 ? ",\"still\":true" : ""),
                                 204);
        if (round % 3 == 0)
            assert_true(reader_next(&r[0], PATIENCE_S, &p));
        for (int i = 0; i < STREAMS; i++)
            reader_close(&r[i]);
        await_streams(0);
    }
    struct services *s = server_services(t.server);
    kit_await(job_idle(s->jobs));
    await_no_connections();
}

/* The process that draws is killed, between two pictures or in the middle of one: the stream goes
 * on with the newest camera, in order, whole pictures only (reader_next decodes each), and no other
 * process is left over. `still`: drawn in full, so that the kill comes while a picture is made. */
static void kill_and_go_on(struct reader *r, int number, bool still)
{
    struct picture *drawing = server_services(t.server)->picture;
    struct job_stats st = {0};
    struct worker_status before, after;
    struct part p;
    picture_status(drawing, &before);
    assert_true(before.pid > 0);
    if (!still)
        kill(before.pid, SIGKILL);
    assert_int_equal(
        steer(NAME, number, 3 * number, still ? 1800 : 400, still ? ",\"still\":true" : ""), 204);
    for (double end_s = clock_s() + PATIENCE_S;
         still && !st.running[JOB_MOTION] && clock_s() < end_s;)
        job_count(server_services(t.server)->jobs, &st);
    if (still)
        kill(before.pid, SIGKILL);
    double start_s = clock_s();
    do
        assert_true(reader_next(r, PATIENCE_S, &p));
    while (p.pose != number || !p.rest);
    picture_status(drawing, &after);
    print_message("killed %s: the newest camera is seen in full %.2f s later\n",
                  still ? "while it draws" : "between pictures", clock_s() - start_s);
    assert_true(after.pid != before.pid);
    assert_int_equal(after.crashes, before.crashes + 1);
    assert_int_equal(kill(before.pid, 0), -1);
    assert_int_equal(counts().streams, 1);
}

static void test_the_process_that_draws_is_killed(void **state)
{
    struct reader r;
    struct part p;
    follow(&r);
    assert_int_equal(steer(NAME, 1, 10, 400, ""), 204);
    assert_true(reader_next(&r, PATIENCE_S, &p));
    kill_and_go_on(&r, 2, false);
    kill_and_go_on(&r, 3, true);
    reader_close(&r);
    await_streams(0);
}

/* Stopping ends streams at once, in order, with a picture under way as well. */
static void test_stopping(void **state)
{
    struct reader r[2];
    struct part p;
    start_drawing();
    reader_open(&r[0], NAME);
    reader_open(&r[1], "0123456789abcdeg");
    await_streams(2);
    assert_int_equal(steer(NAME, 1, 10, 1600, ""), 204);
    double start_s = clock_s();
    server_stop(&t.server);
    assert_true(clock_s() - start_s < 10);
    for (int i = 0; i < 2; i++) {
        while (reader_next(&r[i], 1, &p))
            continue;
        assert_true(r[i].ended && r[i].last_chunk);
        reader_close(&r[i]);
    }
}

int main(int argc, char **argv)
{
    if (worker_asked(argc, argv))
        return draw_main();
    const struct CMUnitTest tests[] = {
        HTTP_TEST(test_small_while_it_moves_full_at_rest),
        HTTP_TEST(test_refusals),
        HTTP_TEST(test_idle_streams_end),
        HTTP_TEST(test_unsteered_streams_give_way),
        HTTP_TEST(test_slow_reader),
        HTTP_TEST(test_come_and_go),
        HTTP_TEST(test_the_process_that_draws_is_killed),
        HTTP_TEST(test_stopping),
    };
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
