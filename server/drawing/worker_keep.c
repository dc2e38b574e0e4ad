/* The keeper: the thread that starts the second process, waits for its end and starts it again.
 *
 * Either the keeper or the asking thread may kill the process. Only the keeper waits for it
 * (waitpid) and closes its socket, and not while the other one asks. A killed process id is
 * therefore never that of another process.
 *
 * Pauses: after its first end it is started again at once, because one crash is an accident and a
 * client waits for a picture. If it was not well for steady_s before it ended again, the next start
 * is delayed, twice as long each time. A process that says at its first start that it cannot work,
 * because there is no device or its driver fails, is tried again after longer pauses: what was
 * missing, as room for compiled kernels or a driver that comes late, may be there by then.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#define _GNU_SOURCE // NOLINT(cert-dcl51-cpp): memfd_create
#include "server/drawing/worker_life.h"

#include <errno.h>
#include <math.h>
#include <poll.h>
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

static const double END_S = 1;  /* it may take so long to end by itself */
static const double KILL_S = 5; /* and so long to be gone when it was killed: beyond, a driver holds
                                   it in the kernel */

void worker_wait(struct worker *w, double wait_s)
{
    (void)pool_cond_wait(&w->changed, &w->lock, clock_s() + wait_s);
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
    w->failed = w->killed = w->leaves = false;
    w->ready_s = w->asked_s = w->again_s = 0;
    pthread_mutex_unlock(&w->lock);
    return rc ? rc : worker_packet_send(sv[0], &h, w->hello, w->cfg.n_hello, memory, e);
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
        rc = worker_packet_receive(w->fd, 0, 100, &a, &got, e);
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
    w->off_pause_s = 0;
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

/* It has ended because it held too much memory. True: it has. */
static bool worker_renewed(struct worker *w)
{
    pthread_mutex_lock(&w->lock);
    const bool renewed = w->leaves && !w->killed;
    w->now.renewals += renewed;
    pthread_mutex_unlock(&w->lock);
    if (renewed)
        log_info("serve", "the process that draws held too much memory, and is replaced");
    return renewed;
}

/* Until the next start, or until all is to stop. */
static void worker_rest(struct worker *w)
{
    pthread_mutex_lock(&w->lock);
    while (!w->stopping && clock_s() < w->again_s)
        worker_wait(w, w->again_s - clock_s());
    w->again_s = 0;
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
    worker_rest(w);
}

/* It cannot work: when is it tried again? */
static void worker_off(struct worker *w, const char *why)
{
    pthread_mutex_lock(&w->lock);
    const double now_s = clock_s();
    w->off_pause_s =
        w->off_pause_s > 0 ? fmin(2 * w->off_pause_s, w->cfg.off_pause_most_s) : w->cfg.off_pause_s;
    w->failing_since_s = w->failing_since_s > 0 ? w->failing_since_s : now_s;
    w->again_s = now_s + w->off_pause_s;
    snprintf(w->now.about, sizeof w->now.about, "%.*s",
             (int)fmin(WORKER_ABOUT - 1, (double)strcspn(why, "\n")), why);
    w->now.state = WORKER_OFF;
    pthread_cond_broadcast(&w->changed);
    pthread_mutex_unlock(&w->lock);
    log_warn("serve", "pictures are off, tiles are served; tried again in %.0f s: %s",
             w->off_pause_s, why);
    worker_rest(w);
}

void worker_keep(void *user)
{
    struct worker *w = user;
    char how[128];
    while (!worker_stopping(w)) {
        struct err e = {0};
        enum err_code rc = worker_begin(w, &e);
        if (!rc)
            rc = worker_await(w, &e);
        if (!rc)
            worker_attend(w);
        const bool off = rc == ERR_DEVICE && !w->now.known; /* one that was there comes back soon */
        worker_end(w, how);
        if (off)
            worker_off(w, e.msg);
        else if (!worker_stopping(w) && !worker_renewed(w))
            worker_pause(w, how, &e);
    }
}
