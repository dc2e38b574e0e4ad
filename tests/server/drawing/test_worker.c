/* The second process: it is asked, crashes, hangs, sends nonsense, is ended from outside, and is
 * started again and again. This program is both sides; the second one does what the first letter of
 * a request says.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <dirent.h>
#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <sysexits.h>
#include <unistd.h>

#include "server/drawing/worker.h"

static size_t open_files(void)
{
    size_t n = 0;
    DIR *d = opendir("/proc/self/fd");
    while (d && readdir(d))
        n++;
    if (d)
        closedir(d);
    return n;
}

/* ---- the other process ---- */

static void fake_crash(void)
{
    signal(SIGSEGV, SIG_DFL); /* sanitizers have handlers */
    raise(SIGSEGV);
}

static void fake_hang(void)
{
    for (;;)
        pause();
}

static enum err_code fake_open(const void *hello, size_t n, void **user, char about[WORKER_ABOUT],
                               struct err *e)
{
    static int nothing;
    char text[512] = "";
    memcpy(text, hello, n < sizeof text - 1 ? n : sizeof text - 1);
    *user = &nothing;
    if (!strcmp(text, "crash"))
        fake_crash();
    if (!strcmp(text, "hang"))
        fake_hang();
    snprintf(about, WORKER_ABOUT, "fake %.100s", text);
    if (!strncmp(text, "until ", 6)) /* a device that is there when this file is */
        return file_exists(text + 6) ? ERR_OK
                                     : err_set(e, ERR_DEVICE, "no device yet\n/a driver's log");
    return !strcmp(text, "off") ? err_set(e, ERR_DEVICE, "no device here") : ERR_OK;
}

static bool fake_rests_too_full; /* what its rest() says */

/* An answer made by hand. */
static void fake_answer(uint32_t magic, uint64_t number, uint64_t n_bytes, size_t size)
{
    struct worker_answer a = {.magic = magic, .number = number, .n_bytes = n_bytes};
    (void)!send(WORKER_FD, &a, size, MSG_NOSIGNAL);
    fake_hang();
}

static void fake_wait(void)
{
    while (!worker_cancelled(NULL))
        nap_ms(1);
}

static enum err_code fake_run(void *user, const void *request, size_t n, int fd, struct buf *out,
                              struct err *e)
{
    const char *text = request;
    char bytes[64];
    (void)user;
    switch (text[0]) {
    case 'e': /* as many bytes as it says */
        for (long k = 0, want = strtol(text + 1, NULL, 10); k < want; k++)
            buf_u8(out, (unsigned)k % 251);
        return ERR_OK;
    case 'z':
        if (buf_grow(out, 100000))
            memset(out->data, 1, out->size);
        return ERR_OK;
    case 'm': /* an error of its own */
        return err_set(e, ERR_DATA, "cannot be: %.*s", (int)(n - 1), text + 1);
    case 'f': { /* what is in the file that came along */
        ssize_t got = pread(fd, bytes, sizeof bytes, 0);
        close(fd);
        buf_add(out, bytes, got > 0 ? (size_t)got : 0);
        return ERR_OK;
    }
    case 'r': /* from now on it holds too much */
        fake_rests_too_full = true;
        return ERR_OK;
    case 'd':
        buf_printf(out, "%zu %d", open_files(), fcntl(2, F_GETFD) >= 0);
        return ERR_OK;
    case 's':
        fake_crash();
        return ERR_OK;
    case 'x':
        _exit(3);
    case 'h':
        fake_hang();
        return ERR_OK;
    case 'c':
        fake_wait();
        return err_set(e, ERR_CANCEL, "cancelled");
    case 'C': /* takes notice, and is done all the same */
        fake_wait();
        buf_u8(out, 7);
        return ERR_OK;
    case '1':
        fake_answer(WORKER_MAGIC, 1, 0, 5);
        return ERR_OK;
    case '2':
        fake_answer(1234, 1, 0, sizeof(struct worker_answer));
        return ERR_OK;
    case '3': /* of a request that was never made */
        fake_answer(WORKER_MAGIC, 99, 0, sizeof(struct worker_answer));
        return ERR_OK;
    case '4': /* bytes that are not there */
        fake_answer(WORKER_MAGIC, 1, 50, sizeof(struct worker_answer));
        return ERR_OK;
    case '5': /* more than anybody may have */
        fake_answer(WORKER_MAGIC, 1, UINT64_MAX, sizeof(struct worker_answer));
        return ERR_OK;
    default:
        return err_set(e, ERR_INTERNAL, "what?");
    }
}

static void fake_close(void *user)
{
    (void)user;
}

static bool fake_rest(void *user)
{
    (void)user;
    return fake_rests_too_full;
}

static const struct worker_service fake = {fake_open, fake_run, fake_close, fake_rest, 0};

/* ---- this process ---- */

static struct worker *w;
static struct buf out;

static void begin(const char *hello, const struct worker_config *more)
{
    struct err e = {0};
    struct worker_config cfg = *more;
    cfg.hello = hello;
    cfg.n_hello = strlen(hello);
    kit_ok(worker_open(&cfg, &w, &e), e);
}

static int end(void **state)
{
    worker_close(&w);
    buf_free(&out);
    return 0;
}

static struct worker_status status(void)
{
    struct worker_status st;
    worker_status(w, &st);
    return st;
}

/* Ask with a descriptor; waits until it is ready first. */
static enum err_code ask_with(const char *request, int fd, struct err *e)
{
    uint64_t life = 0;
    out.size = 0;
    enum err_code rc = worker_ready(w, NULL, NULL, &life, e);
    return rc ? rc
              : worker_ask(w, life, request, strlen(request) + 1, fd, 1 << 20, NULL, NULL, &out, e);
}

static enum err_code ask(const char *request, struct err *e)
{
    return ask_with(request, -1, e);
}

/* Gone, or a zombie of whoever adopts orphans here. */
static bool is_gone(pid_t pid)
{
    char path[64], text[512] = "";
    snprintf(path, sizeof path, "/proc/%ld/stat", (long)pid);
    FILE *f = fopen(path, "r");
    if (!f)
        return true;
    size_t n = fread(text, 1, sizeof text - 1, f);
    fclose(f);
    text[n] = 0;
    const char *after = strrchr(text, ')');
    return !after || after[2] == 'Z';
}

static const struct worker_config quick = {.start_s = 10,
                                           .ask_s = 10,
                                           .pause_s = 0.2,
                                           .pause_most_s = 1,
                                           .off_pause_s = 10,
                                           .off_pause_most_s = 10,
                                           .steady_s = 0.3};

/* A process that holds too much answers once more, and is replaced: no crash, no pause. */
static void test_renewed(void **state)
{
    struct err e = {0};
    begin("hello", &quick);
    for (uint64_t i = 1; i <= 3; i++) { /* also when it is replaced again and again */
        kit_ok(ask("r", &e), e);
        const pid_t was = status().pid;
        kit_ok(ask("e7", &e), e);
        assert_int_equal(out.size, 7);
        kit_ok(ask("e8", &e), e); /* waits for the new one */
        assert_int_equal(out.size, 8);
        assert_int_not_equal(status().pid, was);
        assert_int_equal(status().renewals, i);
        kit_await(is_gone(was));
    }
    assert_int_equal(status().crashes, 0);
    assert_int_equal(status().kills, 0);
    assert_true(status().failing_s <= 0);
}

static void test_answers(void **state)
{
    struct err e = {0};
    size_t before = open_files();
    FILE *f = tmpfile();
    begin("hello", &quick);
    kit_ok(ask("e1000", &e), e);
    assert_int_equal(out.size, 1000);
    for (size_t i = 0; i < out.size; i++)
        assert_int_equal(out.data[i], i % 251);
    assert_string_equal(status().about, "fake hello");
    kit_ok(ask("e300000", &e), e);
    assert_int_equal(out.size, 300000);
    kit_ok(ask("e0", &e), e); /* shorter than the one before: nothing of it is left */
    assert_int_equal(out.size, 0);
    kit_ok(ask("e1048576", &e), e);
    assert_int_equal(out.size, 1 << 20);
    kit_fails(ask("mit", &e), ERR_DATA, e, "cannot be: it");
    fputs("what is in it", f);
    fflush(f);
    kit_ok(ask_with("f", fileno(f), &e), e);
    assert_int_equal(out.size, strlen("what is in it"));
    assert_memory_equal(out.data, "what is in it", out.size);
    fclose(f);
    kit_ok(ask("d", &e), e); /* 0, 1, 2, 3, the answers', that of the folder, "." and ".." */
    assert_memory_equal(out.data, "8 1", 3);
    enum { TIMES = 300 };
    double took_s[2];
    for (int i = 0; i < 2; i++) {
        took_s[i] = clock_s();
        for (int k = 0; k < TIMES; k++)
            kit_ok(ask(i ? "z" : "e0", &e), e);
        took_s[i] = (clock_s() - took_s[i]) / TIMES;
    }
    print_message("an answer without bytes: %.0f us, of 100 KB: %.0f us\n", took_s[0] * 1e6,
                  took_s[1] * 1e6);
    struct worker_status st = status();
    assert_int_equal(st.starts, 1);
    assert_int_equal(st.crashes + st.kills, 0);
    assert_true(st.peak_bytes > 0 && st.failing_s == 0);
    end(NULL);
    kit_await(is_gone(st.pid));
    assert_int_equal(open_files(), before);
}

/* Asked for what ends it: the answer is lost, and it is there again at once. */
static void crash(const char *request)
{
    struct err e = {0};
    kit_ok(ask("e1", &e), e);
    pid_t pid = status().pid;
    double start_s = clock_s();
    kit_fails(ask(request, &e), ERR_DEVICE, e, "the process that draws ended at this");
    assert_true(status().state != WORKER_READY || status().pid != pid);
    kit_await(is_gone(pid));
    kit_ok(ask("e1", &e), e);
    print_message("ready again after %.3f s\n", clock_s() - start_s);
    assert_true(status().pid != pid);
    assert_true(status().failing_s > 0);
}

/* A crash costs the answer that was asked for, and is over at once. */
static void test_crash(void **state)
{
    struct err e = {0};
    begin("hello", &quick);
    for (int i = 0; i < 2; i++) {
        crash(i ? "x" : "s");
        for (double end_s = clock_s() + 0.6; clock_s() < end_s;) { /* idle, or asked without end */
            if (i)
                nap_ms(100);
            else
                kit_ok(ask("e1000", &e), e);
        }
        assert_true(status().failing_s == 0); /* the next crash is the first one again */
    }
    assert_int_equal(status().crashes, 2);
    assert_int_equal(status().starts, 3);
}

static void test_hang(void **state)
{
    struct err e = {0};
    struct worker_config cfg = quick;
    cfg.ask_s = 0.3;
    begin("hello", &cfg);
    kit_ok(ask("e1", &e), e);
    pid_t pid = status().pid;
    double start_s = clock_s();
    kit_fails(ask("h", &e), ERR_DEVICE, e, "not made in");
    assert_true(clock_s() - start_s >= 0.3);
    kit_ok(ask("e1", &e), e);
    kit_await(is_gone(pid));
    assert_int_equal(status().kills, 1);
    assert_int_equal(status().crashes, 0);
}

/* Whatever it sends, nothing but the right number of the right bytes is taken. */
static void test_nonsense(void **state)
{
    struct err e = {0};
    struct worker_config cfg = quick;
    cfg.pause_s = 0.01;
    for (const char *how = "12345"; *how; how++) {
        begin("hello", &cfg);
        char request[2] = {*how, 0};
        kit_fails(ask(request, &e), ERR_DEVICE, e, "answer");
        assert_int_equal(out.size, 0);
        kit_ok(ask("e3", &e), e);
        assert_int_equal(out.size, 3);
        assert_int_equal(status().kills, 1);
        end(NULL);
    }
    begin("hello", &cfg); /* more than this request may have, but no nonsense */
    kit_fails(ask("e1048577", &e), ERR_DEVICE, e, "1048576 are the most");
}

/* The first time at once, then after pauses that double, and nobody waits for them. */
static void test_pauses(void **state)
{
    struct err e = {0};
    double last_s = 0;
    begin("hello", &quick);
    kit_fails(ask("s", &e), ERR_DEVICE, e, NULL);
    for (int i = 0; i < 4; i++) {
        kit_fails(ask("s", &e), ERR_DEVICE, e, NULL); /* waits for the start, if there is one */
        double ended_s = clock_s();
        kit_await(status().wait_s > 0);
        double wait_s = status().wait_s, start_s = clock_s();
        kit_fails(ask("e1", &e), ERR_BUSY, e, "times in a row; it is started again in");
        assert_true(clock_s() - start_s < wait_s);
        assert_true(status().failing_s > last_s);
        last_s = status().failing_s;
        double want_s = i < 2 ? 0.2 * (1 << i) : i < 3 ? 0.8 : 1; /* 1: as long as it gets */
        assert_true(wait_s <= want_s && wait_s + start_s - ended_s > want_s / 2);
        kit_await(status().wait_s <= 0);
    }
    kit_ok(ask("e1", &e), e);
    nap_ms(600);
    assert_true(status().failing_s == 0);
    kit_fails(ask("s", &e), ERR_DEVICE, e, NULL); /* as if it was the first time */
    kit_ok(ask("e1", &e), e);
}

static void test_never_ready(void **state)
{
    struct err e = {0};
    struct worker_config cfg = quick;
    begin("off", &cfg);
    kit_await(status().state == WORKER_OFF);
    kit_fails(ask("e1", &e), ERR_BUSY, e, "pictures are off: the device did not start");
    assert_null(strstr(e.msg, "no device here")); /* clients read this */
    assert_string_equal(status().about, "no device here");
    assert_false(status().known);
    assert_int_equal(status().pid, 0);
    end(NULL);

    cfg.pause_s = cfg.pause_most_s = 10; /* not waited for when this side ends */
    begin("crash", &cfg);
    kit_await(status().wait_s > 0);
    assert_int_equal(status().crashes, 2);
    kit_fails(ask("e1", &e), ERR_BUSY, e, NULL);
    double start_s = clock_s();
    end(NULL);
    assert_true(clock_s() - start_s < 5);

    cfg.start_s = 0.2;
    begin("hang", &cfg);
    kit_await(status().wait_s > 0);
    assert_int_equal(status().starts, 2);
    assert_int_equal(status().crashes + status().kills, 2);
}

/* A device that comes late is found, after pauses that double; meanwhile pictures fail, which
 * serve --exit-hung counts. */
static void test_tried_again(void **state)
{
    struct err e = {0};
    struct worker_config cfg = quick;
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], hello[FILE_PATH_MAX + 8];
    double last_s = 0;
    cfg.off_pause_s = 0.2;
    cfg.off_pause_most_s = 0.5;
    kit_tmpdir(dir);
    kit_ok(file_join(path, dir, "device", &e), e);
    snprintf(hello, sizeof hello, "until %s", path);
    begin(hello, &cfg);
    for (uint64_t i = 1; i <= 4; i++) {
        kit_await(status().starts >= i && status().wait_s > 0);
        assert_int_equal(status().state, WORKER_OFF);
        assert_string_equal(status().about, "no device yet");
        const double want_s = i < 3 ? 0.1 * (1 << i) : 0.5;
        assert_true(status().wait_s <= want_s);
        assert_true(status().failing_s >= last_s);
        last_s = status().failing_s;
    }
    assert_true(last_s >= 0.2 + 0.4 + 0.5);
    kit_ok(file_write(path, "", 0, &e), e);
    kit_await(status().state == WORKER_READY);
    kit_ok(ask("e1", &e), e);
    nap_ms(600);
    assert_true(status().failing_s <= 0);
    end(NULL);
    kit_rmdir(dir);
}

/* Says stop from the second time on. */
static bool stop_second(const void *user)
{
    atomic_int *n = *(atomic_int *const *)user;
    return atomic_fetch_add(n, 1) > 0;
}

static void test_cancelled(void **state)
{
    struct err e = {0};
    uint64_t life, again;
    begin("hello", &quick);
    for (int i = 0; i < 40; i++) {
        atomic_int n = 0, *pn = &n;
        out.size = 0;
        kit_ok(worker_ready(w, NULL, NULL, &life, &e), e);
        kit_fails(worker_ask(w, life, i % 2 ? "C" : "c", 2, -1, 100, stop_second, &pn, &out, &e),
                  ERR_CANCEL, e, "cancelled");
        assert_int_equal(out.size, 0);
        kit_ok(worker_ready(w, NULL, NULL, &again, &e), e);
        assert_int_equal(life, again); /* nothing was killed for it */
        if (i % 4 == 0)
            kit_ok(ask("e9", &e), e); /* what is still said about the one before disturbs nobody */
    }
    assert_int_equal(status().cancels, 20);
    kit_fails(worker_ask(w, life + 1, "e1", 3, -1, 100, NULL, NULL, &out, &e), ERR_BUSY, e, NULL);
}

static void *stopper(void *user)
{
    nap_ms(100);
    worker_stop(user);
    return NULL;
}

/* When this side stops, whoever asks is answered, and a process that hangs is not waited for. */
static void test_stopping_while_it_hangs(void **state)
{
    struct err e = {0};
    pthread_t id;
    begin("hello", &quick);
    kit_ok(ask("e1", &e), e);
    pid_t pid = status().pid;
    assert_int_equal(pthread_create(&id, NULL, stopper, w), 0);
    double start_s = clock_s();
    kit_fails(ask("h", &e), ERR_CANCEL, e, NULL);
    assert_true(clock_s() - start_s < 5);
    pthread_join(id, NULL);
    kit_fails(ask("e1", &e), ERR_CANCEL, e, NULL);
    end(NULL);
    assert_true(clock_s() - start_s < 10);
    kit_await(is_gone(pid));
}

/* Ended from outside while nobody asks: it is there again before anybody does. */
static void test_ended_while_idle(void **state)
{
    begin("hello", &quick);
    kit_await(status().state == WORKER_READY);
    pid_t pid = status().pid;
    double start_s = clock_s();
    kill(pid, SIGKILL);
    kit_await(status().state == WORKER_READY && status().pid != pid);
    print_message("ready again after %.3f s\n", clock_s() - start_s);
    kill(status().pid, SIGTERM); /* those of a group are not for it */
    nap_ms(100);
    assert_int_equal(status().starts, 2);
}

/* The process goes when this one does, whatever it is at. */
static void test_this_side_killed(void **state)
{
    char pid[32] = "";
    int line[2];
    for (int hangs = 0; hangs < 2; hangs++) {
        assert_int_equal(pipe(line), 0);
        pid_t parent = fork(); /* no other thread is there now */
        assert_true(parent >= 0);
        if (parent == 0) {
            dup2(line[1], 1);
            execl("/proc/self/exe", "test_worker", hangs ? "hangs" : "idles", (char *)NULL);
            _exit(127);
        }
        close(line[1]);
        size_t n = 0;
        while (n + 1 < sizeof pid && read(line[0], pid + n, 1) == 1 && pid[n] != '\n')
            n++;
        close(line[0]);
        assert_true(atol(pid) > 0);
        kill(parent, SIGKILL);
        assert_int_equal(waitpid(parent, NULL, 0), parent);
        kit_await(is_gone((pid_t)atol(pid)));
    }
}

/* The other program of the test above. */
static int parent_main(bool hangs)
{
    struct err e = {0};
    struct worker_config cfg = quick;
    uint64_t life;
    cfg.hello = "hello";
    cfg.n_hello = 5;
    if (worker_open(&cfg, &w, &e) || worker_ready(w, NULL, NULL, &life, &e))
        return 1;
    printf("%ld\n", (long)status().pid);
    fflush(stdout);
    if (hangs)
        (void)!worker_ask(w, life, "h", 2, -1, 100, NULL, NULL, &out, &e);
    for (;;)
        pause();
}

static void test_by_hand(void **state)
{
    struct buf said = {0};
    assert_int_equal(
        kit_run(&said, "'%s' %s </dev/null 3</dev/null", kit_program(), WORKER_ARGUMENT), EX_USAGE);
    buf_u8(&said, 0);
    assert_non_null(strstr((char *)said.data, "is for `citysplat serve` alone"));
    buf_free(&said);
}

int main(int argc, char **argv)
{
    if (worker_asked(argc, argv))
        return worker_main(&fake);
    if (argc == 2 && (!strcmp(argv[1], "hangs") || !strcmp(argv[1], "idles")))
        return parent_main(argv[1][0] == 'h');
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_this_side_killed), /* first: it forks */
        cmocka_unit_test_teardown(test_answers, end),
        cmocka_unit_test_teardown(test_renewed, end),
        cmocka_unit_test_teardown(test_crash, end),
        cmocka_unit_test_teardown(test_hang, end),
        cmocka_unit_test_teardown(test_nonsense, end),
        cmocka_unit_test_teardown(test_pauses, end),
        cmocka_unit_test_teardown(test_never_ready, end),
        cmocka_unit_test_teardown(test_tried_again, end),
        cmocka_unit_test_teardown(test_cancelled, end),
        cmocka_unit_test_teardown(test_stopping_while_it_hangs, end),
        cmocka_unit_test_teardown(test_ended_while_idle, end),
        cmocka_unit_test(test_by_hand),
    };
    log_set_level(LOG_ERROR);
    return cmocka_run_group_tests(tests, NULL, NULL);
}
