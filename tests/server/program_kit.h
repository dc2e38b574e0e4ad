/* The program `citysplat serve`, started by a test that is its supervisor and reads its log.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_PROGRAM_KIT_H
#define TESTS_PROGRAM_KIT_H

#include "tests/server/rights_kit.h"

#include <signal.h>
#include <sys/un.h>
#include <sys/wait.h>

struct program {
    pid_t pid;
    int out, notify; /* what it prints; what its supervisor hears */
    char log[FILE_PATH_MAX], socket[FILE_PATH_MAX], line[256];
    uint16_t port;
    bool journal; /* its log is taken for the journal */
    bool alone;   /* it has no supervisor, which would have to hear it */
};

static inline void program_exec(struct program *p, const char *name, const int *listener,
                                const char *const *args)
{
    /* of the store of the tests, unless there are others */
    const char *argv[24] = {name, "serve", "--device", "none", t.path};
    char pid[16], fds[4] = "0";
    int n = args[0] && args[0][0] != '-' ? 4 : 5, k = 0;
    for (int i = 0; args[i]; i++)
        argv[n++] = args[i];
    argv[n] = NULL;
    for (; k < 2 && listener && listener[k] >= 0; k++)
        if (dup2(listener[k], 3 + k) < 0)
            _exit(126);
    dup2(p->out, 1);
    struct stat st;
    char stream[64];
    if (!freopen(p->log, "w", stderr) || fstat(2, &st))
        _exit(126);
    snprintf(stream, sizeof stream, "%llu:%llu", (unsigned long long)st.st_dev,
             (unsigned long long)st.st_ino + !p->journal);
    setenv("JOURNAL_STREAM", stream, 1);
    snprintf(pid, sizeof pid, "%ld", (long)getpid());
    snprintf(fds, sizeof fds, "%d", k);
    if (!p->alone)
        setenv("NOTIFY_SOCKET", p->socket, 1);
    setenv("WATCHDOG_PID", pid, 1);
    setenv("WATCHDOG_USEC", "400000", 1);
    if (k) {
        setenv("LISTEN_PID", pid, 1);
        setenv("LISTEN_FDS", fds, 1);
        setenv("LISTEN_FDNAMES", k > 1 ? "http:admin" : "http", 1);
    }
    execv(argv[0], (char *const *)(uintptr_t)argv);
    _exit(127);
}

static inline void program_start(struct program *p, const int *listener, const char *const *args)
{
    struct err e = {0};
    struct sockaddr_un a = {.sun_family = AF_UNIX};
    int out[2];
    const char *name = kit_program(); /* skips the test where there is none */
    kit_ok(file_join(p->log, t.dir, "operate.log", &e), e);
    kit_ok(file_join(p->socket, t.dir, "notify", &e), e);
    unlink(p->socket);
    snprintf(a.sun_path, sizeof a.sun_path, "%.100s", p->socket);
    p->notify = socket(AF_UNIX, SOCK_DGRAM, 0);
    assert_int_equal(bind(p->notify, (struct sockaddr *)&a, sizeof a), 0);
    assert_int_equal(pipe(out), 0);
    p->out = out[1];
    p->pid = fork();
    assert_true(p->pid >= 0);
    if (p->pid == 0)
        program_exec(p, name, listener, args);
    close(out[1]);
    p->out = out[0];
    size_t n = 0;
    for (; n + 1 < sizeof p->line && read(p->out, p->line + n, 1) == 1; n++)
        if (p->line[n] == '\n')
            break;
    p->line[n] = '\0';
    const char *colon = strrchr(p->line, ':');
    p->port = colon ? (uint16_t)atoi(colon + 1) : 0;
}

static inline int program_end(struct program *p, int sig)
{
    int status = -1;
    if (sig)
        kill(p->pid, sig);
    assert_int_equal(waitpid(p->pid, &status, 0), p->pid);
    close(p->out);
    close(p->notify);
    assert_true(WIFEXITED(status));
    return WEXITSTATUS(status);
}

/* The supervisor hears this before PATIENCE_S is over. */
static inline void hears(struct program *p, const char *what)
{
    char text[512];
    for (double end_s = clock_s() + PATIENCE_S; clock_s() < end_s;) {
        struct pollfd f = {.fd = p->notify, .events = POLLIN};
        if (poll(&f, 1, 1000) != 1)
            continue;
        ssize_t n = recv(p->notify, text, sizeof text - 1, 0);
        text[n > 0 ? n : 0] = '\0';
        if (strstr(text, what))
            return;
    }
    fail_msg("the supervisor does not hear %s", what);
}

/* What the log of a program says, and how often. */
static inline size_t log_says(const struct program *p, const char *what)
{
    struct buf log = {0};
    struct err e = {0};
    size_t n = 0;
    kit_ok(file_read(p->log, 0, &log, &e), e);
    buf_u8(&log, 0);
    for (const char *at = (const char *)log.data; (at = strstr(at, what)); at++)
        n++;
    buf_free(&log);
    return n;
}

#endif
