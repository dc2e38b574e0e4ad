/* Running COLMAP: see align_run.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/scene/align_run.h"

#include <assert.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

enum { RUN_TAIL = 4096, RUN_NOT_FOUND = 127, RUN_PAUSE_MS = 64 };
static const double look_every_s = 2, patience_s = 10; /* of a program that was asked to stop */

static enum err_code run_missing(const char *program, struct err *e)
{
    return err_set(e, ERR_NOENT,
                   "%s: no such program; install COLMAP (Debian: apt-get install colmap), or name "
                   "it with --colmap",
                   program);
}

enum err_code align_run_find(const char *program, struct err *e)
{
    const char *at = getenv("PATH");
    char path[FILE_PATH_MAX];
    if (strchr(program, '/'))
        return access(program, X_OK) || file_is_dir(program) ? run_missing(program, e) : ERR_OK;
    while (at && *at) {
        size_t n = strcspn(at, ":");
        int len = snprintf(path, sizeof path, "%.*s/%s", (int)n, n ? at : ".", program);
        if (len > 0 && (size_t)len < sizeof path && !access(path, X_OK) && !file_is_dir(path))
            return ERR_OK;
        at += n + (at[n] == ':');
    }
    return run_missing(program, e);
}

/* Runs between fork and exec: async-signal-safe calls only. */
static void run_become(const char *const *argv, int log, pid_t parent)
{
    int null = open("/dev/null", O_RDONLY);
    prctl(PR_SET_PDEATHSIG, SIGKILL); /* what is half done is done again; nobody waits for it */
    if (getppid() != parent || dup2(null, STDIN_FILENO) < 0 || dup2(log, STDOUT_FILENO) < 0 ||
        dup2(log, STDERR_FILENO) < 0)
        _exit(126);
    union { /* exec promises not to write to them, in a type older than const */
        const char *const *from;
        char *const *to;
    } args = {.from = argv};
    assert(argv[0]);
    execvp(argv[0], args.to);
    _exit(RUN_NOT_FOUND);
}

/* The last line of the log that says something. */
static void run_last_line(const char *log, char out[256])
{
    char text[RUN_TAIL];
    out[0] = '\0';
    FILE *f = fopen(log, "rb");
    if (!f)
        return;
    long size = fseek(f, 0, SEEK_END) ? 0 : ftell(f);
    (void)fseek(f, size > RUN_TAIL - 1 ? size - (RUN_TAIL - 1) : 0, SEEK_SET);
    text[fread(text, 1, RUN_TAIL - 1, f)] = '\0';
    fclose(f);
    for (char *end = text + strlen(text); end > text;) {
        while (end > text && strchr(" \t\r\n", end[-1]))
            *--end = '\0';
        char *line = strrchr(text, '\n');
        line = line ? line + 1 : text;
        if (strlen(line) > 3) {
            snprintf(out, 256, "%.255s", line);
            return;
        }
        end = line;
        *end = '\0';
    }
}

static enum err_code run_failed(const struct align_run *r, int status, struct err *e)
{
    char line[256];
    run_last_line(r->log, line);
    if (WIFEXITED(status) && WEXITSTATUS(status) == RUN_NOT_FOUND)
        return run_missing(r->argv[0], e);
    if (WIFSIGNALED(status))
        return err_set(e, ERR_DATA, "%s %s: killed by signal %d%s; its log is %s", r->argv[0],
                       r->argv[1], WTERMSIG(status),
                       WTERMSIG(status) == SIGKILL ? " (out of memory? Try a smaller --max-edge-px)"
                                                   : "",
                       r->log);
    return err_set(e, ERR_DATA, "%s %s: exit %d: %s; its log is %s", r->argv[0], r->argv[1],
                   WEXITSTATUS(status), line, r->log);
}

/* Wait for it; ask it to stop when we are. */
static int run_wait(const struct align_run *r, pid_t pid, bool *stopped)
{
    struct progress p = {0};
    double looked_s = clock_s(), asked_s = 0;
    int status = 0;
    long pause_ms = 1; /* calls that have nothing to do end at once */
    if (r->what)
        progress_start(&p, r->what, r->total);
    for (;;) {
        pid_t got = waitpid(pid, &status, WNOHANG);
        if (got == pid || (got < 0 && errno != EINTR))
            break;
        if (signals_stopping() && !*stopped) {
            *stopped = true;
            asked_s = clock_s();
            kill(pid, SIGTERM);
        }
        if (*stopped && clock_s() - asked_s > patience_s)
            kill(pid, SIGKILL);
        if (r->what && r->count && clock_s() - looked_s > look_every_s) {
            looked_s = clock_s();
            uint64_t done = r->count(r->user);
            progress_step(&p, done < r->total ? done : r->total, NULL);
        }
        nanosleep(&(struct timespec){.tv_nsec = pause_ms * 1000 * 1000}, NULL);
        pause_ms = pause_ms < RUN_PAUSE_MS ? 2 * pause_ms : pause_ms;
    }
    if (r->what)
        progress_end(&p, NULL);
    return status;
}

enum err_code align_run(const struct align_run *r, struct err *e)
{
    bool stopped = false;
    int log = open(r->log, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0666);
    if (log < 0)
        return err_errno(e, ERR_IO, "%s: cannot open", r->log);
    dprintf(log, "$ %s", r->argv[0]);
    for (const char *const *a = r->argv + 1; *a; a++)
        dprintf(log, " %s", *a);
    dprintf(log, "\n");
    setenv("QT_QPA_PLATFORM", "offscreen", 0); /* COLMAP wants a display even without its window */
    pid_t parent = getpid(), pid = fork();
    if (pid == 0)
        run_become(r->argv, log, parent);
    int why = errno;
    close(log);
    errno = why;
    if (pid < 0)
        return err_errno(e, ERR_IO, "cannot start %s", r->argv[0]);
    int status = run_wait(r, pid, &stopped);
    if (stopped || signals_stopping())
        return err_set(e, ERR_CANCEL, "stopped; the same command goes on");
    return status ? run_failed(r, status, e) : ERR_OK;
}
