/* Cold start. It measures a `citysplat render` process from its start to its exit after the first
 * picture, with kernels in the disk cache, and a `citysplat serve` process to the first 200 of
 * /readyz and to the first tile, on a quiet machine and with all cores busy. The tile store is
 * small, so that start-up dominates, or that of --tiles.
 *
 * Checked before timing: the picture exists and the tile is 200. The first run may build kernels
 * and is reported separately.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/bench.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <spawn.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "core/geo/geo.h"
#include "core/math/sort.h"
#include "core/pool.h"
#include "lab/bench/city.h"
#include "lab/server/load.h"
#include "lod/make/pyramid.h"

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
    const char *argv[] = {c->program, "render",      c->store, "-o",          c->picture,
                          "--lon",    "8.6821",      "--lat",  "50.1100",     "--height-m",
                          "260",      "--width-px",  "1280",   "--height-px", "720",
                          "-q",       "--overwrite", NULL};
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

/* ---- a server ---- */

enum { START_RUNS_MAX = 32, START_HOGS_MAX = 64 };
enum { START_READY, START_TILE, START_CPU, START_FIGURES };
struct start_server {
    const struct start_case *c;
    char tile[256]; /* its path; "": the first run asks for it */
    double ms[START_FIGURES][START_RUNS_MAX];
};

/* A process whose stdout is a pipe: *out. */
static enum err_code start_spawn(const struct start_case *c, pid_t *pid, FILE **out, struct err *e)
{
    const char *argv[] = {c->program, "serve",           c->store, "--port",
                          "0",        "--no-access-log", "-q",     NULL};
    int line[2] = {-1, -1};
    posix_spawn_file_actions_t files;
    if (pipe(line) || posix_spawn_file_actions_init(&files))
        return err_errno(e, ERR_IO, "bench_start: a pipe");
    int rc = posix_spawn_file_actions_adddup2(&files, line[1], STDOUT_FILENO);
    if (!rc)
        rc = posix_spawn_file_actions_addclose(&files, line[0]);
    if (!rc)
        rc = posix_spawn(pid, c->program, &files, NULL, (char **)(uintptr_t)argv, environ);
    posix_spawn_file_actions_destroy(&files);
    close(line[1]);
    *out = fdopen(line[0], "r");
    if (rc || !*out)
        return err_set(e, ERR_IO, "bench_start: %s: %s", c->program, strerror(rc));
    return ERR_OK;
}

/* The path of the most important tile: the first line of the prefetch list. */
static enum err_code start_find_tile(struct start_server *s, uint16_t port, struct err *e)
{
    struct load l = {.port = port};
    struct buf body = {0};
    char name[64] = "", base[64];
    snprintf(l.request, sizeof l.request, "GET /collections HTTP/1.1\r\nHost: bench\r\n\r\n");
    enum err_code rc = load_ask(&l, &body, NULL, e);
    buf_u8(&body, 0);
    const char *id = rc ? NULL : strstr((const char *)body.data, "\"id\":");
    if (id)
        sscanf(id + 5, " \"%63[a-z0-9_-]\"", name);
    body.size = 0;
    snprintf(base, sizeof base, "/d/%.50s/", name);
    snprintf(l.request, sizeof l.request,
             "GET %sseed.ndjson?limit=1 HTTP/1.1\r\nHost: bench\r\n\r\n", base);
    if (!rc)
        rc = load_ask(&l, &body, NULL, e);
    buf_u8(&body, 0);
    const char *url = rc ? NULL : strstr((const char *)body.data, "\"url\":\"");
    if (!rc && !url)
        rc = err_set(e, ERR_INTERNAL, "bench_start: no tile in %sseed.ndjson", base);
    if (!rc)
        snprintf(s->tile, sizeof s->tile, "%s%.*s", url[7] == '/' ? "" : base,
                 (int)strcspn(url + 7, "\""), url + 7);
    buf_free(&body);
    return rc;
}

/* Status of one GET on a new connection, -1 while nobody listens. */
static int start_get(uint16_t port, const char *path)
{
    char request[512], head[16] = "";
    int fd = load_dial(port);
    snprintf(request, sizeof request, "GET %s HTTP/1.1\r\nHost: bench\r\nConnection: close\r\n\r\n",
             path);
    bool ok = fd >= 0 && load_send(fd, request);
    for (ssize_t n = 0, got = 1; ok && n < 12 && got > 0; n += got)
        got = read(fd, head + n, (size_t)(12 - n));
    if (fd >= 0)
        close(fd);
    return ok && head[9] ? atoi(head + 9) : -1;
}

/* One start; run < 0: not counted. */
static enum err_code start_serve_once(struct start_server *s, int run, struct err *e)
{
    char line[256] = "";
    pid_t pid = 0;
    FILE *out = NULL;
    double start_s = clock_s(), ready_s, tile_s, cpu_s;
    enum err_code rc = start_spawn(s->c, &pid, &out, e);
    if (rc)
        return rc;
    const char *colon = fgets(line, sizeof line, out) ? strrchr(line, ':') : NULL;
    uint16_t port = colon ? (uint16_t)atoi(colon + 1) : 0;
    int ready = 0;
    while (port && ready != 200 && clock_s() < start_s + 60)
        ready = start_get(port, "/readyz");
    ready_s = clock_s();
    if (ready != 200)
        rc = err_set(e, ERR_INTERNAL, "bench_start: check: /readyz says %d", ready);
    if (!rc && !s->tile[0])
        rc = start_find_tile(s, port, e);
    int tile = rc ? 0 : start_get(port, s->tile);
    tile_s = clock_s();
    cpu_s = load_cpu_of(pid);
    if (!rc && tile != 200)
        rc = err_set(e, ERR_INTERNAL, "bench_start: check: %s says %d", s->tile, tile);
    if (!rc && run >= 0) {
        s->ms[START_READY][run] = (ready_s - start_s) * 1e3;
        s->ms[START_TILE][run] = (tile_s - start_s) * 1e3;
        s->ms[START_CPU][run] = cpu_s * 1e3;
    }
    kill(pid, SIGTERM);
    while (waitpid(pid, NULL, 0) < 0 && errno == EINTR)
        ;
    fclose(out);
    return rc;
}

static void start_hog(void *user)
{
    volatile unsigned long spins = 0;
    while (!atomic_load((atomic_bool *)user))
        spins++;
}

/* Starts with every core busy or not. */
static enum err_code start_serve(struct bench *b, struct start_server *s, bool busy, struct err *e)
{
    static const char *const figures[] = {"/readyz says 200", "the first tile is there",
                                          "CPU time until then"};
    struct pool_thread *hogs[START_HOGS_MAX] = {0};
    atomic_bool stop = false;
    char text[96];
    int runs = b->runs < START_RUNS_MAX ? b->runs : START_RUNS_MAX;
    enum err_code rc = ERR_OK;
    for (size_t i = 0; busy && !rc && i < pool_cores() && i < START_HOGS_MAX; i++)
        rc = pool_start(start_hog, &stop, &hogs[i], e);
    for (int run = -1; !rc && run < runs; run++)
        rc = start_serve_once(s, run, e);
    atomic_store(&stop, true);
    for (size_t i = 0; i < START_HOGS_MAX; i++)
        if (hogs[i])
            pool_join(&hogs[i]);
    for (int k = 0; !rc && k < START_FIGURES; k++) {
        sort_doubles(s->ms[k], (size_t)runs);
        snprintf(text, sizeof text, "serve, %s: %s", busy ? "all cores busy" : "nothing else",
                 figures[k]);
        bench_report(b, text, s->ms[k][runs / 2], "ms", 0, NULL);
    }
    return rc;
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
    struct start_server *s = mem_array(1, sizeof *s);
    if (!rc && !s)
        rc = err_set(e, ERR_MEM, "bench_start: out of memory");
    if (b->tiles)
        snprintf(c.store, sizeof c.store, "%s", b->tiles);
    if (s)
        s->c = &c;
    for (int busy = 0; !rc && busy < 2; busy++)
        rc = start_serve(b, s, busy, e);
    mem_free(s);
    return rc;
}
