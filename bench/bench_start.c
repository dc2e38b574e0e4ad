/* Cold start: from the start of a `citysplat render` process to its exit with the first picture
 * written, kernels in the cache on disk. A small tile store, so that it is start-up that counts.
 *
 * Checked before timing: the picture is there. The first run, which may build kernels, is told
 * apart.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "bench/bench.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <spawn.h>
#include <stdio.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "bench/city.h"
#include "core/geo.h"
#include "lod/pyramid.h"

extern char **environ;

struct start_case {
    char program[PATH_MAX], store[FILE_PATH_MAX], picture[FILE_PATH_MAX];
};

static const struct geo_origin start_origin = {8.6821, 50.1109, 160};

/* `citysplat` beside this program. */
static enum err_code start_program(char *out, struct err *e)
{
    ssize_t n = readlink("/proc/self/exe", out, PATH_MAX - 16);
    if (n <= 0)
        return err_errno(e, ERR_IO, "bench_start: /proc/self/exe");
    out[n] = '\0';
    char *slash = strrchr(out, '/');
    strcpy(slash ? slash + 1 : out, "citysplat");
    return file_exists(out) ? ERR_OK
                            : err_set(e, ERR_NOENT, "bench_start: %s is not there; build it", out);
}

static enum err_code start_run(void *user, struct err *e)
{
    const struct start_case *c = user;
    const char *argv[] = {c->program, "render",     c->store, "-o",          c->picture,
                          "--lon",    "8.6821",     "--lat",  "50.1100",     "--height-m",
                          "260",      "--width-px", "1280",   "--height-px", "720",
                          "-q",       NULL};
    pid_t pid;
    int status = 0;
    posix_spawn_file_actions_t quiet; /* our own stdout is JSON lines */
    if (posix_spawn_file_actions_init(&quiet))
        return err_set(e, ERR_MEM, "bench_start: out of memory");
    int rc = posix_spawn_file_actions_addopen(&quiet, STDOUT_FILENO, "/dev/null", O_WRONLY, 0);
    if (!rc)
        rc = posix_spawn(&pid, c->program, &quiet, NULL, (char **)(uintptr_t)argv, environ);
    posix_spawn_file_actions_destroy(&quiet);
    if (rc)
        return err_set(e, ERR_IO, "bench_start: %s: %s", c->program, strerror(rc));
    while (waitpid(pid, &status, 0) < 0 && errno == EINTR)
        ;
    if (!WIFEXITED(status) || WEXITSTATUS(status) || !file_exists(c->picture))
        return err_set(e, ERR_INTERNAL, "bench_start: check: no picture from %s", c->program);
    return ERR_OK;
}

enum err_code bench_start(struct bench *b, struct err *e)
{
    struct start_case c;
    struct gauss g = {0};
    struct pyramid_report report;
    double ms = 0.0, first = 0.0;
    const struct pyramid_config cfg = {.name = "start", .tile_edge_m = 60};
    const char *dir = bench_tmpdir(b);
    enum err_code rc = start_program(c.program, e);
    if (!rc)
        rc = file_join(c.store, dir, "start.tiles", e);
    if (!rc)
        rc = file_join(c.picture, dir, "start.jpg", e);
    if (!rc)
        rc = city_sorted(b->quick ? 5000 : 50000, &g, e);
    const struct pyramid_level level = {.g = &g, .level = 3};
    if (!rc)
        rc = pyramid_build(&start_origin, &level, 1, &cfg, NULL, 0, c.store, &report, e);
    gauss_free(&g);
    double begin = clock_s();
    if (!rc)
        rc = start_run(&c, e);
    first = 1e3 * (clock_s() - begin);
    if (!rc)
        rc = bench_time(b, start_run, &c, &ms, NULL, e);
    if (!rc) {
        bench_report(b, "first run of this session, 1280x720", first, "ms", 0, NULL);
        bench_report(b, "process start to first picture, 1280x720", ms, "ms", 0, NULL);
    }
    return rc;
}
