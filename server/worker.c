/* A second process, kept alive.
 *
 * One thread, the keeper, starts it, waits for its end and starts it again; another one asks.
 * Whichever of them finds that it must go kills it, but only the keeper waits for it (waitpid) and
 * closes its socket, and not while the other one asks: so a process id that is killed is never
 * another's. Everything in struct worker but cfg and hello is guarded by `lock`.
 *
 * Pauses: the first time it ends it is started again at once, because one crash is an accident and
 * somebody waits for a picture. If it was not well for steady_s before it ended once more, the
 * next start waits, each time twice as long.
 *
 * What comes from it is checked as if it came from the network: a driver that writes where it
 * should not is one of the reasons for its being a process of its own.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#define _GNU_SOURCE // NOLINT(cert-dcl51-cpp): memfd_create
#include "server/worker.h"

#include <errno.h>
#include <math.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <spawn.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "core/pool.h"

extern char **environ;

enum { WORKER_LOOK_MS = 5 /* how often it is asked whether anybody still waits */ };
static const double END_S = 1;  /* it may take so long to end by itself */
static const double KILL_S = 5; /* and so long to be gone when it was killed: beyond, a driver holds
                                   it in the kernel */

struct worker {
    struct worker_config cfg;
    uint8_t *hello;
    struct pool_thread *keeper;
    pthread_mutex_t lock;
    pthread_cond_t changed; /* state, asking, stopping */
    struct worker_status now;
    uint64_t life, number;
    int fd, memory;      /* of this life; -1: none */
    bool asking;         /* somebody uses fd and memory: the keeper leaves them open */
    bool failed, killed; /* this life is to end; it was killed because it did not answer */
    bool stopping;
    double ready_s, asked_s; /* when it was ready; when the last call began, 0: none is under way */
    double failing_since_s;  /* 0: all is well */
    double again_s;          /* not before this */
    unsigned failures;       /* in a row */
    double cpu_s;            /* of the lives before */
};

/* ---- packets ---- */

/* One packet, with a descriptor unless it is -1. ERR_IO: nobody is there. */
static enum err_code worker_send(int fd, const struct worker_head *h, const void *bytes, size_t n,
                                 int with, struct err *e)
{
    union {
        struct cmsghdr align;
        char bytes[CMSG_SPACE(sizeof(int))];
    } control;
    struct iovec parts[2] = {{(void *)(uintptr_t)h, sizeof *h}, {(void *)(uintptr_t)bytes, n}};
    struct msghdr m = {.msg_iov = parts, .msg_iovlen = n ? 2 : 1};
    ssize_t sent;
    if (with >= 0) {
        memset(&control, 0, sizeof control);
        m.msg_control = &control;
        m.msg_controllen = sizeof control;
        struct cmsghdr *c = CMSG_FIRSTHDR(&m);
        c->cmsg_level = SOL_SOCKET;
        c->cmsg_type = SCM_RIGHTS;
        c->cmsg_len = CMSG_LEN(sizeof(int));
        memcpy(CMSG_DATA(c), &with, sizeof with);
    }
    do
        sent = sendmsg(fd, &m, MSG_NOSIGNAL | MSG_DONTWAIT);
    while (sent < 0 && errno == EINTR);
    return sent < 0 ? err_errno(e, ERR_IO, "request") : ERR_OK;
}

/* Wait at most wait_ms for the answer to `number`. *got: it is there. ERR_IO: the connection has
 * ended. ERR_FORMAT: that is none. */
static enum err_code worker_receive(int fd, uint64_t number, int wait_ms, struct worker_answer *a,
                                    bool *got, struct err *e)
{
    struct pollfd p = {.fd = fd, .events = POLLIN};
    *got = false;
    if (poll(&p, 1, wait_ms) <= 0)
        return ERR_OK;
    ssize_t n = recv(fd, a, sizeof *a, MSG_DONTWAIT | MSG_TRUNC);
    if (n < 0 && (errno == EINTR || errno == EAGAIN))
        return ERR_OK;
    if (n <= 0)
        return err_set(e, ERR_IO, "it has ended");
    if (n != sizeof *a || a->magic != WORKER_MAGIC || a->number != number ||
        a->code > ERR_INTERNAL || !memchr(a->text, 0, sizeof a->text))
        return err_set(e, ERR_FORMAT, "an answer that is none");
    *got = true;
    return ERR_OK;
}

/* The n bytes of an answer. A short file is an answer that is none: ERR_FORMAT. ERR_MEM. */
static enum err_code worker_take(int memory, size_t n, struct buf *out, struct err *e)
{
    size_t had = out->size;
    uint8_t *to = n ? buf_grow(out, n) : NULL;
    if (n && !to)
        return err_set(e, ERR_MEM, "out of memory for %zu bytes", n);
    for (size_t at = 0; at < n;) {
        ssize_t k = pread(memory, to + at, n - at, (off_t)at);
        if (k < 0 && errno == EINTR)
            continue;
        if (k <= 0) {
            out->size = had;
            return err_set(e, ERR_FORMAT, "an answer with bytes missing");
        }
        at += (size_t)k;
    }
    return ERR_OK;
}

/* ---- its life: the keeper ---- */

static void worker_wait(struct worker *w, double wait_s)
{
    struct timespec end;
    clock_gettime(CLOCK_MONOTONIC, &end);
    long ns = end.tv_nsec + (long)(fmod(wait_s, 1) * 1e9);
    end.tv_sec += (time_t)wait_s + ns / 1000000000;
    end.tv_nsec = ns % 1000000000;
    pthread_cond_timedwait(&w->changed, &w->lock, &end);
}

/* The process, its end of `sv` as its descriptor 3. Signals that come to a whole group are for
 * this process, which ends the other one in order. */
static enum err_code worker_spawn(const int sv[2], pid_t *pid, struct err *e)
{
    static char name[] = "citysplat", argument[] = WORKER_ARGUMENT;
    char *const argv[] = {name, argument, NULL};
    static const int blocked[] = {SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGUSR1};
    posix_spawn_file_actions_t files;
    posix_spawnattr_t attr;
    sigset_t mask;
    sigemptyset(&mask);
    for (size_t i = 0; i < sizeof blocked / sizeof *blocked; i++)
        sigaddset(&mask, blocked[i]);
    posix_spawn_file_actions_init(&files);
    posix_spawnattr_init(&attr);
    errno = posix_spawn_file_actions_adddup2(&files, sv[1], WORKER_FD);
    if (!errno)
        errno = posix_spawnattr_setsigmask(&attr, &mask);
    if (!errno)
        errno = posix_spawnattr_setflags(&attr, POSIX_SPAWN_SETSIGMASK);
    if (!errno)
        errno = posix_spawn(pid, "/proc/self/exe", &files, &attr, argv, environ);
    enum err_code rc =
        errno ? err_errno(e, ERR_IO, "the process that draws cannot be started") : ERR_OK;
    posix_spawnattr_destroy(&attr);
    posix_spawn_file_actions_destroy(&files);
    return rc;
}

/* A process with its socket and its file, which has been told hello. */
static enum err_code worker_begin(struct worker *w, struct err *e)
{
    const struct worker_head h = {.magic = WORKER_MAGIC};
    int sv[2] = {-1, -1}, memory = memfd_create("citysplat-answers", MFD_CLOEXEC);
    pid_t pid = 0;
    enum err_code rc = ERR_OK;
    if (memory < 0 || socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, sv))
        rc = err_errno(e, ERR_IO, "the process that draws: no descriptors");
    if (!rc)
        rc = worker_spawn(sv, &pid, e);
    if (sv[1] >= 0)
        close(sv[1]);
    pthread_mutex_lock(&w->lock);
    w->fd = sv[0];
    w->memory = memory;
    w->now.pid = pid;
    w->now.starts++;
    w->life++;
    w->number = 0;
    w->failed = w->killed = false;
    w->ready_s = w->asked_s = w->again_s = 0;
    pthread_mutex_unlock(&w->lock);
    return rc ? rc : worker_send(sv[0], &h, w->hello, w->cfg.n_hello, memory, e);
}

static bool worker_stopping(struct worker *w)
{
    pthread_mutex_lock(&w->lock);
    bool stopping = w->stopping;
    pthread_mutex_unlock(&w->lock);
    return stopping;
}

/* Until it is ready. ERR_DEVICE: it says that it never will be. */
static enum err_code worker_await(struct worker *w, struct err *e)
{
    struct worker_answer a;
    double start_s = clock_s();
    bool got = false;
    enum err_code rc = ERR_OK;
    while (!rc && !got) {
        rc = worker_receive(w->fd, 0, 100, &a, &got, e);
        if (!rc && !got && worker_stopping(w))
            rc = err_set(e, ERR_CANCEL, "the server is stopping");
        else if (!rc && !got && w->cfg.start_s > 0 && clock_s() - start_s > w->cfg.start_s)
            rc = err_set(e, ERR_BUSY, "not ready after %.0f s", w->cfg.start_s);
    }
    if (!rc && a.code)
        rc = err_set(e, ERR_DEVICE, "%s", a.text);
    if (rc)
        return rc;
    pthread_mutex_lock(&w->lock);
    snprintf(w->now.about, sizeof w->now.about, "%.*s", WORKER_ABOUT - 1, a.text);
    w->now.state = WORKER_READY;
    w->now.known = true;
    w->now.cpu_s = a.cpu_s;
    w->now.peak_bytes = a.peak_bytes;
    w->ready_s = clock_s();
    log_info("serve", "pictures are on device=\"%s\" pid=%ld start_s=%.2f", w->now.about,
             (long)w->now.pid, w->ready_s - start_s);
    pthread_cond_broadcast(&w->changed);
    pthread_mutex_unlock(&w->lock);
    return ERR_OK;
}

/* Under the lock: was it well for long enough, up to now or to the call that is under way? */
static bool worker_steady(const struct worker *w)
{
    double until_s = w->asked_s > 0 ? w->asked_s : clock_s();
    return w->ready_s > 0 && until_s - w->ready_s > w->cfg.steady_s;
}

/* While it lives and is wanted. */
static void worker_attend(struct worker *w)
{
    struct pollfd p = {.fd = w->fd}; /* events 0: its end alone */
    bool on = true;
    while (on) {
        bool ended = poll(&p, 1, 100) > 0;
        pthread_mutex_lock(&w->lock);
        on = !ended && !w->failed && !w->stopping;
        if (on && worker_steady(w))
            w->failing_since_s = 0;
        pthread_mutex_unlock(&w->lock);
    }
}

/* Wait for its end, at most wait_s. */
static bool worker_reap(pid_t pid, double wait_s, int *status)
{
    const struct timespec nap = {.tv_nsec = 2000000};
    double end_s = clock_s() + wait_s;
    pid_t got;
    while ((got = waitpid(pid, status, WNOHANG)) == 0 && clock_s() < end_s)
        nanosleep(&nap, NULL);
    return got != 0;
}

/* How it ended, for people. */
static void worker_epitaph(const struct worker *w, bool gone, int status, char out[128])
{
    if (!gone)
        snprintf(out, 128, "cannot be killed: its driver holds it");
    else if (w->killed)
        snprintf(out, 128, "was killed: it did not answer as it should");
    else if (WIFSIGNALED(status))
        snprintf(out, 128, "ended by signal %d (%s)", WTERMSIG(status),
                 sigdescr_np(WTERMSIG(status)));
    else
        snprintf(out, 128, "ended with exit code %d", WEXITSTATUS(status));
}

/* Out of the way with it: nobody asks it any more, its descriptors are closed, it is gone. */
static void worker_end(struct worker *w, char how[128])
{
    pthread_mutex_lock(&w->lock);
    int fd = w->fd, memory = w->memory, status = 0;
    pid_t pid = w->now.pid;
    bool now = w->killed;
    w->now.state = WORKER_AGAIN;
    if (fd >= 0)
        shutdown(fd, SHUT_RDWR); /* whoever asks sees its end, and so does it */
    while (w->asking)
        pthread_cond_wait(&w->changed, &w->lock);
    w->fd = w->memory = -1;
    now |= w->killed;
    pthread_mutex_unlock(&w->lock);
    if (fd >= 0)
        close(fd);
    if (memory >= 0)
        close(memory);
    bool gone = pid <= 0 || (!now && worker_reap(pid, END_S, &status));
    if (!gone) {
        kill(pid, SIGKILL);
        gone = worker_reap(pid, KILL_S, &status);
    }
    pthread_mutex_lock(&w->lock);
    w->now.pid = 0;
    w->cpu_s += w->now.cpu_s;
    w->now.cpu_s = 0;
    worker_epitaph(w, gone, status, how);
    pthread_mutex_unlock(&w->lock);
}

/* It has ended unasked: when is the next start? */
static void worker_pause(struct worker *w, const char *how, const struct err *e)
{
    pthread_mutex_lock(&w->lock);
    double now_s = clock_s();
    bool steady = worker_steady(w);
    w->failures = steady ? 1 : w->failures + 1;
    w->failing_since_s = steady || !(w->failing_since_s > 0) ? now_s : w->failing_since_s;
    double pause_s = w->failures > 1 ? w->cfg.pause_s * exp2(fmin(w->failures - 2, 30)) : 0;
    pause_s = fmin(pause_s, w->cfg.pause_most_s);
    w->again_s = now_s + pause_s;
    w->now.crashes += !w->killed;
    w->now.kills += w->killed;
    pthread_cond_broadcast(&w->changed);
    pthread_mutex_unlock(&w->lock);
    log_error("serve", "the process that draws %s%s%s; tiles are served, it is started again%s",
              how, e->code ? " before it was ready: " : "", e->code ? e->msg : "",
              pause_s > 0 ? " after a pause" : "");
    pthread_mutex_lock(&w->lock);
    while (!w->stopping && clock_s() < w->again_s)
        worker_wait(w, w->again_s - clock_s());
    w->again_s = 0;
    pthread_mutex_unlock(&w->lock);
}

static void worker_off(struct worker *w, const char *why)
{
    log_warn("serve", "pictures are off, tiles are served: %s", why);
    pthread_mutex_lock(&w->lock);
    snprintf(w->now.about, sizeof w->now.about, "%.*s", WORKER_ABOUT - 1, why);
    w->now.state = WORKER_OFF;
    pthread_cond_broadcast(&w->changed);
    pthread_mutex_unlock(&w->lock);
}

static void worker_keep(void *user)
{
    struct worker *w = user;
    char how[128];
    bool off = false;
    while (!off && !worker_stopping(w)) {
        struct err e = {0};
        enum err_code rc = worker_begin(w, &e);
        if (!rc)
            rc = worker_await(w, &e);
        if (!rc)
            worker_attend(w);
        off = rc == ERR_DEVICE && !w->now.known; /* a device that was there may come back */
        worker_end(w, how);
        if (off)
            worker_off(w, e.msg);
        else if (!worker_stopping(w))
            worker_pause(w, how, &e);
    }
}

/* ---- the interface ---- */

enum err_code worker_open(const struct worker_config *cfg, struct worker **out, struct err *e)
{
    struct worker *w = mem_array(1, sizeof *w);
    pthread_condattr_t monotonic;
    *out = w;
    if (!w || !(w->hello = mem_array(cfg->n_hello, 1))) {
        mem_free(w);
        *out = NULL;
        return err_set(e, ERR_MEM, "worker: out of memory");
    }
    w->cfg = *cfg;
    memcpy(w->hello, cfg->hello, cfg->n_hello);
    w->cfg.hello = NULL; /* the caller's */
    w->fd = w->memory = -1;
    pthread_mutex_init(&w->lock, NULL);
    pthread_condattr_init(&monotonic);
    pthread_condattr_setclock(&monotonic, CLOCK_MONOTONIC);
    pthread_cond_init(&w->changed, &monotonic);
    pthread_condattr_destroy(&monotonic);
    enum err_code rc = pool_start(worker_keep, w, &w->keeper, e);
    if (rc)
        worker_close(out);
    return rc;
}

void worker_stop(struct worker *w)
{
    pthread_mutex_lock(&w->lock);
    w->stopping = true;
    pthread_cond_broadcast(&w->changed);
    pthread_mutex_unlock(&w->lock);
}

void worker_close(struct worker **out)
{
    struct worker *w = *out;
    *out = NULL;
    if (!w)
        return;
    worker_stop(w);
    if (w->keeper)
        pool_join(&w->keeper);
    pthread_cond_destroy(&w->changed);
    pthread_mutex_destroy(&w->lock);
    mem_free(w->hello);
    mem_free(w);
}

void worker_status(struct worker *w, struct worker_status *out)
{
    pthread_mutex_lock(&w->lock);
    double now_s = clock_s();
    *out = w->now;
    out->cpu_s += w->cpu_s;
    out->wait_s = fmax(0, w->again_s - now_s);
    out->failing_s = w->failing_since_s > 0 ? now_s - w->failing_since_s : 0;
    pthread_mutex_unlock(&w->lock);
}

enum err_code worker_ready(struct worker *w, bool (*stop)(const void *user), const void *user,
                           uint64_t *life, struct err *e)
{
    enum err_code rc = ERR_OK;
    pthread_mutex_lock(&w->lock);
    while (!rc && (w->now.state != WORKER_READY || w->failed)) {
        double wait_s = w->again_s - clock_s();
        if (w->stopping || (stop && stop(user)))
            rc = err_set(e, ERR_CANCEL, "cancelled");
        else if (w->now.state == WORKER_OFF)
            rc = err_set(e, ERR_DEVICE, "pictures are off: %s", w->now.about);
        else if (wait_s > 0)
            rc = err_set(e, ERR_BUSY,
                         "the process that draws has ended %u times in a row; it is started again "
                         "in %.0f s",
                         w->failures, ceil(wait_s));
        else
            worker_wait(w, WORKER_LOOK_MS * 4e-3);
    }
    *life = w->life;
    pthread_mutex_unlock(&w->lock);
    return rc;
}

/* Wait for the answer and take its bytes. ERR_IO, ERR_FORMAT, ERR_BUSY: this life is over. */
static enum err_code worker_hear(struct worker *w, const struct worker_head *h, size_t limit,
                                 bool (*stop)(const void *user), const void *user, struct buf *out,
                                 struct err *e)
{
    const double start_s = clock_s();
    struct worker_head cancel = *h;
    struct worker_answer a;
    bool got = false, told = false;
    enum err_code rc = ERR_OK;
    cancel.cancel = true;
    while (!rc && !got) {
        rc = worker_receive(w->fd, h->number, WORKER_LOOK_MS, &a, &got, e);
        if (rc || got)
            break;
        if (!told && stop && stop(user)) {
            told = true;
            rc = worker_send(w->fd, &cancel, NULL, 0, -1, e);
        }
        double took_s = clock_s() - start_s;
        if (!rc && w->cfg.ask_s > 0 && took_s > w->cfg.ask_s)
            rc = err_set(e, ERR_BUSY, "not made in %.0f s", took_s);
    }
    if (rc)
        return rc;
    pthread_mutex_lock(&w->lock);
    w->now.cpu_s = a.cpu_s;
    w->now.peak_bytes = a.peak_bytes;
    w->now.cancels += a.code == ERR_CANCEL;
    pthread_mutex_unlock(&w->lock);
    if (a.code || told) { /* an error of the call, not of the connection */
        err_set(e, a.code ? (enum err_code)a.code : ERR_CANCEL, "%s",
                a.code ? a.text : "cancelled");
        return ERR_OK;
    }
    if (a.n_bytes > limit)
        return err_set(e, ERR_FORMAT, "an answer of %llu bytes where %zu are the most",
                       (unsigned long long)a.n_bytes, limit);
    return worker_take(w->memory, (size_t)a.n_bytes, out, e);
}

/* A call has ended, with it this life if rc is an error. Is all to stop? */
static bool worker_answered(struct worker *w, enum err_code rc)
{
    pthread_mutex_lock(&w->lock);
    w->asking = false;
    if (rc) {
        w->failed = true;
        w->now.state = WORKER_AGAIN;
        w->killed = rc != ERR_IO && !w->stopping;
        if (rc != ERR_IO && w->now.pid > 0)
            kill(w->now.pid, SIGKILL);
    } else {
        w->asked_s = 0;
    }
    bool stopping = w->stopping;
    pthread_cond_broadcast(&w->changed);
    pthread_mutex_unlock(&w->lock);
    return stopping;
}

/* NOLINTNEXTLINE(readability-function-size): its parameters */
enum err_code worker_ask(struct worker *w, uint64_t life, const void *request, size_t n, int fd,
                         size_t limit, bool (*stop)(const void *user), const void *user,
                         struct buf *out, struct err *e)
{
    struct err own = {0}, *said = &own;
    struct worker_head h = {.magic = WORKER_MAGIC};
    pthread_mutex_lock(&w->lock);
    bool there = w->now.state == WORKER_READY && w->life == life && !w->failed && !w->stopping;
    w->asking = there;
    w->asked_s = there ? clock_s() : w->asked_s;
    h.number = ++w->number;
    pthread_mutex_unlock(&w->lock);
    if (!there)
        return err_set(e, ERR_BUSY, "the process that draws is started again");
    enum err_code rc = worker_send(w->fd, &h, request, n, fd, said);
    if (!rc)
        rc = worker_hear(w, &h, limit, stop, user, out, said);
    bool over = rc && rc != ERR_MEM, stopping = worker_answered(w, over ? rc : ERR_OK);
    if (over && stopping)
        return err_set(e, ERR_CANCEL, "cancelled");
    if (over)
        return err_set(e, ERR_DEVICE,
                       "the process that draws ended at this (%s); it is started "
                       "again",
                       said->msg);
    return own.code ? err_set(e, own.code, "%s", own.msg) : rc;
}
