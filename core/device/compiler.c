/* Both ends of the conversation with citysplat-compiler: see compiler.h. A job is a number of
 * texts, each with its length before it: the version, the device's name, the flags, the pieces of
 * the source. The answer is one byte, 'd' (done) or 'r' (refused), and the binary.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#define _GNU_SOURCE // NOLINT(cert-dcl51-cpp): memfd_create
#include "core/device/compiler.h"

#include <errno.h>
#include <signal.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include "core/library.h"

enum { COMPILER_FD = 3, COMPILER_TEXTS = 64, COMPILER_JOB_MAX = 16 << 20, COMPILER_SAID = 4096 };
/* The longest compilation; of its exit codes: it was asked wrongly, or by another version. */
enum { COMPILER_MOST_S = 900, COMPILER_ASKED_WRONGLY = 127 };

extern char **environ;

/* ---- bytes ---- */

static bool compiler_put(int fd, const void *bytes, size_t n)
{
    for (const char *p = bytes; n;) {
        ssize_t sent = send(fd, p, n, MSG_NOSIGNAL);
        if (sent < 0 && errno == EINTR)
            continue;
        if (sent <= 0)
            return false;
        p += sent;
        n -= (size_t)sent;
    }
    return true;
}

/* All that comes until the other end closes. */
static bool compiler_take(int fd, struct buf *out)
{
    char bytes[1 << 16];
    for (;;) {
        ssize_t n = read(fd, bytes, sizeof bytes);
        if (n < 0 && errno == EINTR)
            continue;
        if (n <= 0)
            return n == 0 && !out->failed;
        buf_add(out, bytes, (size_t)n);
    }
}

static void compiler_add_text(struct buf *b, const char *text)
{
    const uint32_t n = (uint32_t)strlen(text);
    buf_add(b, &n, sizeof n);
    buf_add(b, text, n + 1);
}

/* ---- who asks ---- */

/* The environment with `method` in it. The caller frees the list, not the texts. */
static char **compiler_environment(const char *method, char *text, size_t room)
{
    const size_t length = sizeof COMPILER_METHOD - 1;
    size_t n = 0, kept = 0;
    while (environ[n])
        n++;
    char **list = mem_array(n + 2, sizeof *list);
    for (size_t i = 0; list && i < n; i++)
        if (!method || strncmp(environ[i], COMPILER_METHOD, length) != 0 ||
            environ[i][length] != '=')
            list[kept++] = environ[i];
    if (list && method) {
        snprintf(text, room, COMPILER_METHOD "=%s", method);
        list[kept] = text;
    }
    return list;
}

/* Signals that come to a whole group are for the process that asks, which waits for this one. */
static int compiler_spawn(const char *path, int fd, int said, const char *method, pid_t *pid)
{
    static char name[] = "citysplat-compiler";
    static const int blocked[] = {SIGINT, SIGTERM, SIGHUP, SIGQUIT};
    char *const argv[] = {name, NULL};
    char text[96];
    char **env = compiler_environment(method, text, sizeof text);
    posix_spawn_file_actions_t files;
    posix_spawnattr_t attr;
    sigset_t mask;
    if (!env)
        return ENOMEM;
    sigemptyset(&mask);
    for (size_t i = 0; i < sizeof blocked / sizeof *blocked; i++)
        sigaddset(&mask, blocked[i]);
    posix_spawn_file_actions_init(&files);
    posix_spawnattr_init(&attr);
    int code = posix_spawn_file_actions_adddup2(&files, said, STDERR_FILENO);
    if (!code) /* last: `said` may be that descriptor */
        code = posix_spawn_file_actions_adddup2(&files, fd, COMPILER_FD);
    if (!code)
        code = posix_spawnattr_setsigmask(&attr, &mask);
    if (!code)
        code = posix_spawnattr_setflags(&attr, POSIX_SPAWN_SETSIGMASK);
    if (!code)
        code = posix_spawn(pid, path, &files, &attr, argv, env);
    posix_spawnattr_destroy(&attr);
    posix_spawn_file_actions_destroy(&files);
    mem_free(env);
    return code;
}

/* How it ended, and the last line that it wrote. */
static void compiler_tell(int status, int said, char *words, size_t room)
{
    char text[COMPILER_SAID];
    const off_t size = lseek(said, 0, SEEK_END);
    const off_t from = size > (off_t)sizeof text - 1 ? size - (off_t)sizeof text + 1 : 0;
    ssize_t n = size > 0 ? pread(said, text, sizeof text - 1, from) : 0;
    while (n > 0 && (text[n - 1] == '\n' || text[n - 1] == ' '))
        n--;
    text[n > 0 ? n : 0] = '\0';
    const char *line = strrchr(text, '\n');
    line = line ? line + 1 : text;
    if (WIFSIGNALED(status))
        snprintf(words, room, "signal %d, %s%s%.200s", WTERMSIG(status),
                 strsignal(WTERMSIG(status)), *line ? ": " : "", line);
    else
        snprintf(words, room, "exit code %d%s%.200s", WEXITSTATUS(status), *line ? ": " : "", line);
}

static enum compiler_end compiler_ask(const char *path, const struct buf *job, const char *method,
                                      struct buf *binary, char *words, size_t room)
{
    int sv[2] = {-1, -1}, status = 0;
    const int said = memfd_create("citysplat-compiler", MFD_CLOEXEC);
    pid_t pid = 0;
    int code = said < 0 || socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, sv) ? errno : 0;
    if (!code)
        code = compiler_spawn(path, sv[1], said, method, &pid);
    if (sv[1] >= 0)
        close(sv[1]);
    enum compiler_end end = COMPILER_MISSING;
    if (code) {
        snprintf(words, room, "%s: %s", path, strerror(code));
    } else {
        bool well = compiler_put(sv[0], job->data, job->size) && !shutdown(sv[0], SHUT_WR) &&
                    compiler_take(sv[0], binary) && binary->size > 0;
        while (waitpid(pid, &status, 0) < 0 && errno == EINTR)
            ;
        const int left = WIFEXITED(status) ? WEXITSTATUS(status) : 0;
        well = well && WIFEXITED(status) && left == 0;
        end = well && binary->data[0] == 'd' ? COMPILER_DONE
              : well                         ? COMPILER_REFUSED
              : left >= 126 ? COMPILER_MISSING /* 127 of the system's linker, too */
                            : COMPILER_DIED;
        if (!well)
            compiler_tell(status, said, words, room);
    }
    if (end == COMPILER_DONE)
        memmove(binary->data, binary->data + 1, --binary->size);
    else
        buf_free(binary);
    if (sv[0] >= 0)
        close(sv[0]);
    if (said >= 0)
        close(said);
    return end;
}

enum compiler_end compiler_run(const struct compiler_job *job, const char *method,
                               struct buf *binary, char *words, size_t room)
{
    char path[FILE_PATH_MAX];
    struct buf b = {0};
    words[0] = '\0';
    if (!library_find("citysplat-compiler", path)) {
        snprintf(words, room, "citysplat-compiler: is not beside the program");
        return COMPILER_MISSING;
    }
    compiler_add_text(&b, CITYSPLAT_VERSION);
    compiler_add_text(&b, job->device);
    compiler_add_text(&b, job->flags);
    for (size_t i = 0; i < job->n_text; i++)
        compiler_add_text(&b, job->text[i]);
    enum compiler_end end = COMPILER_MISSING;
    if (b.failed)
        snprintf(words, room, "out of memory");
    else
        end = compiler_ask(path, &b, method, binary, words, room);
    buf_free(&b);
    return end;
}

/* ---- who answers ---- */

/* The texts of a job; 0: it is none. */
static size_t compiler_read(const struct buf *b, const char *text[COMPILER_TEXTS])
{
    size_t n = 0;
    for (size_t at = 0; at < b->size; n++) {
        uint32_t length;
        if (n == COMPILER_TEXTS || b->size - at < sizeof length)
            return 0;
        memcpy(&length, b->data + at, sizeof length);
        at += sizeof length;
        if (length >= b->size - at || b->data[at + length] != '\0')
            return 0;
        text[n] = (const char *)b->data + at;
        at += (size_t)length + 1;
    }
    return n > 3 && !strcmp(text[0], CITYSPLAT_VERSION) ? n : 0;
}

int compiler_serve(bool (*build)(const struct compiler_job *job, struct buf *out))
{
    const struct rlimit no_core = {0, 0}; /* its death is expected, and told */
    const char *text[COMPILER_TEXTS];
    struct buf in = {0}, out = {0};
    (void)setrlimit(RLIMIT_CORE, &no_core);
    (void)prctl(PR_SET_DUMPABLE, 0);
    (void)prctl(PR_SET_PDEATHSIG, SIGKILL); /* nobody waits for it any more */
    (void)alarm(COMPILER_MOST_S);
    size_t n = compiler_take(COMPILER_FD, &in) && in.size <= COMPILER_JOB_MAX
                   ? compiler_read(&in, text)
                   : 0;
    if (!n) {
        fprintf(stderr,
                "citysplat-compiler: compiles OpenCL programs for citysplat, which starts it\n");
        return COMPILER_ASKED_WRONGLY;
    }
    const struct compiler_job job = {
        .device = text[1], .flags = text[2], .text = text + 3, .n_text = n - 3};
    buf_add(&out, "d", 1);
    const bool well = build(&job, &out) && !out.failed;
    return (well ? compiler_put(COMPILER_FD, out.data, out.size)
                 : compiler_put(COMPILER_FD, "r", 1))
               ? 0
               : 1;
}
