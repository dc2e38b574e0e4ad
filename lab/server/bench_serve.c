/* The fast path of the server: tiles in memory, over loopback, against libmicrohttpd alone with the
 * same bytes from a constant buffer. The difference is the cost of routing, the guard, the cache
 * and the headers. Client and server share the machine, so the ratio says more than requests a
 * second.
 *
 * Checked before timing: both answer with the tile's bytes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/bench.h"
#include "lab/server/load.h"

#include <fcntl.h>
#include <microhttpd.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "core/math/sort.h"
#include "core/pool.h"
#include "lod/store/store.h"
#include "server/answers/services.h"
#include "server/server.h"

/* ---- the cases ---- */

/* Both servers under the same load. `tile`: the bytes that the bare one sends, and that ours must.
 */
static enum err_code serve_compare(struct bench *b, const char *name, struct load *ours,
                                   const struct buf *tile, unsigned status, struct err *e)
{
    const unsigned threads = pool_cores() < 4 ? (unsigned)pool_cores() : 4;
    struct load_bare bare = {0};
    struct load other = *ours;
    struct buf got = {0};
    double ours_ms, bare_ms;
    snprintf(other.request, sizeof other.request, "GET / HTTP/1.1\r\nHost: bench\r\n\r\n");
    enum err_code rc = load_bare_start(&bare, tile, status, threads, &other.port, e);
    if (!rc)
        rc = load_ask(&other, &got, NULL, e);
    if (!rc && status == 200 &&
        (got.size != tile->size || memcmp(got.data, tile->data, got.size) != 0))
        rc = err_set(e, ERR_INTERNAL, "load: check: the two servers send other bytes");
    if (!rc)
        rc = bench_time(b, load_run, ours, &ours_ms, NULL, e);
    if (!rc)
        rc = bench_time(b, load_run, &other, &bare_ms, NULL, e);
    if (!rc) {
        double n = LOAD_CLIENTS * (double)ours->requests;
        bench_report(b, name, n / ours_ms * 1e3, "requests/s", bare_ms / ours_ms,
                     "libmicrohttpd alone");
    }
    load_bare_stop(&bare);
    buf_free(&got);
    return rc;
}

/* A server of the store at `path`, its hot tile made, and a load that asks for it. tile and etag
 * (may be NULL): what that is. */
static enum err_code serve_hot(const struct server_config *cfg, const char *const *path,
                               struct key key, struct server **server, struct load *load,
                               struct buf *tile, char etag[64], struct err *e)
{
    enum err_code rc = server_start(cfg, path, 1, server, e);
    if (rc)
        return rc;
    struct catalog *c = services_catalog(server_services(*server));
    load->port = (uint16_t)atoi(strrchr(server_url(*server), ':') + 1);
    snprintf(load->request, sizeof load->request,
             "GET /d/bench/r/%s/t/%u/%u/%u.spz HTTP/1.1\r\nHost: bench\r\n\r\n",
             c->ds[0]->meta.revision, key.z, key.x, key.y);
    catalog_drop(&c);
    for (int i = 0; !rc && i < 2;
         i++) { /* make it; then a hit: no Server-Timing, the size that counts */
        tile->size = 0;
        rc = load_ask(load, tile, etag, e);
    }
    return rc;
}

static enum err_code serve_size(struct bench *b, size_t n_gaussians, const char *name,
                                struct err *e)
{
    char path[FILE_PATH_MAX], etag[64] = "", text[96];
    struct server_config cfg;
    struct arena arena = {0};
    struct server *server = NULL;
    struct buf tile = {0}, none = {0};
    struct key key;
    struct load load = {.requests = b->quick ? 200 : 10000};
    const char *const paths[] = {path};
    enum err_code rc = file_join(path, bench_tmpdir(b), "bench.tiles", e);
    if (!rc)
        rc = load_store(path, n_gaussians, &key, e);
    if (!rc)
        rc = load_config(&cfg, &arena, e);
    if (!rc)
        rc = serve_hot(&cfg, paths, key, &server, &load, &tile, etag, e);
    if (!rc) {
        snprintf(text, sizeof text, "hot tile, %s (%zu B)", name, tile.size);
        rc = serve_compare(b, text, &load, &tile, MHD_HTTP_OK, e);
    }
    if (!rc) {
        size_t n = strlen(load.request);
        snprintf(load.request + n - 2, sizeof load.request - n + 2, "If-None-Match: %s\r\n\r\n",
                 etag);
        rc = load_ask(&load, &none, NULL, e);
        snprintf(text, sizeof text, "304 of it");
    }
    if (!rc)
        rc = serve_compare(b, text, &load, &tile, MHD_HTTP_NOT_MODIFIED, e);
    server_stop(&server);
    arena_free(&arena);
    buf_free(&tile);
    buf_free(&none);
    return rc;
}

/* ---- what else a hot tile may meet ---- */

/* One line a request, to where nobody looks. */
static enum err_code serve_logged(struct bench *b, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct server_config cfg;
    struct arena arena = {0};
    struct buf tile = {0};
    struct key key;
    struct load load = {.requests = b->quick ? 200 : 10000};
    const char *const paths[] = {path};
    double ms[2] = {1, 1};
    int err_fd = dup(STDERR_FILENO);
    enum err_code rc = file_join(path, bench_tmpdir(b), "bench.tiles", e);
    if (!rc)
        rc = load_store(path, 280, &key, e);
    if (!rc)
        rc = load_config(&cfg, &arena, e);
    for (int logged = 0; !rc && logged < 2; logged++) {
        struct server *server = NULL;
        cfg.access_log = logged;
        int nowhere = open("/dev/null", O_WRONLY | O_CLOEXEC);
        (void)dup2(nowhere, STDERR_FILENO);
        rc = serve_hot(&cfg, paths, key, &server, &load, &tile, NULL, e);
        if (!rc)
            rc = bench_time(b, load_run, &load, &ms[logged], NULL, e);
        server_stop(&server);
        (void)dup2(err_fd, STDERR_FILENO);
        close(nowhere);
    }
    if (!rc)
        bench_report(b, "hot tile, small, with an access log",
                     LOAD_CLIENTS * (double)load.requests / ms[1] * 1e3, "requests/s",
                     ms[0] / ms[1], "no log");
    close(err_fd);
    arena_free(&arena);
    buf_free(&tile);
    return rc;
}

/* Resident memory of this process, bytes. */
static double serve_resident(void)
{
    unsigned long pages = 0;
    FILE *f = fopen("/proc/self/statm", "r");
    if (f && fscanf(f, "%*u %lu", &pages) != 1)
        pages = 0;
    if (f)
        fclose(f);
    return (double)pages * (double)sysconf(_SC_PAGESIZE);
}

/* Connections that have asked once and stay open, as many as descriptors allow, up to most. */
static int *serve_idle_open(const struct load *l, size_t most, size_t *n)
{
    struct rlimit limit = {0};
    char bytes[8192];
    struct load one = {.port = l->port};
    (void)getrlimit(RLIMIT_NOFILE, &limit);
    limit.rlim_cur = limit.rlim_max;
    (void)setrlimit(RLIMIT_NOFILE, &limit);
    size_t room = limit.rlim_max == RLIM_INFINITY ? most : (size_t)(limit.rlim_max - 500) / 2;
    int *fd = mem_array(most, sizeof *fd);
    snprintf(one.request, sizeof one.request, "GET /healthz HTTP/1.1\r\nHost: bench\r\n\r\n");
    for (*n = 0; fd && *n < most && *n < room; ++*n) {
        fd[*n] = load_dial(one.port);
        if (fd[*n] < 0)
            break;
        if (!load_send(fd[*n], one.request) || recv(fd[*n], bytes, sizeof bytes, 0) <= 0) {
            close(fd[*n]);
            break;
        }
    }
    return fd;
}

static enum err_code serve_idle(struct bench *b, struct err *e)
{
    char path[FILE_PATH_MAX], text[96];
    struct server_config cfg;
    struct arena arena = {0};
    struct server *server = NULL;
    struct buf tile = {0};
    struct key key;
    struct load load = {.requests = b->quick ? 200 : 10000};
    const char *const paths[] = {path};
    const size_t most = b->quick ? 200 : 10000;
    double alone_ms = 1, ms = 1;
    size_t n = 0;
    int *fd = NULL;
    enum err_code rc = file_join(path, bench_tmpdir(b), "bench.tiles", e);
    if (!rc)
        rc = load_store(path, 280, &key, e);
    if (!rc)
        rc = load_config(&cfg, &arena, e);
    cfg.max_connections = (int64_t)most + 200;
    cfg.per_ip_connections = 0;
    cfg.idle_timeout_s = 3600;
    if (!rc)
        rc = serve_hot(&cfg, paths, key, &server, &load, &tile, NULL, e);
    if (!rc)
        rc = bench_time(b, load_run, &load, &alone_ms, NULL, e);
    if (!rc) {
        double before = serve_resident();
        fd = serve_idle_open(&load, most, &n);
        snprintf(text, sizeof text, "memory of an idle connection, of %zu", n);
        bench_report(b, text, (serve_resident() - before) / (double)(n ? n : 1) / 1024, "KiB", 0,
                     NULL);
        rc = bench_time(b, load_run, &load, &ms, NULL, e);
    }
    if (!rc) {
        snprintf(text, sizeof text, "hot tile, small, beside %zu idle connections", n);
        bench_report(b, text, LOAD_CLIENTS * (double)load.requests / ms * 1e3, "requests/s",
                     alone_ms / ms, "none");
    }
    for (size_t i = 0; fd && i < n; i++)
        close(fd[i]);
    mem_free(fd);
    server_stop(&server);
    arena_free(&arena);
    buf_free(&tile);
    return rc;
}

/* ---- tiles while views are drawn ---- */

enum { BUSY_GAUSSIANS = 200000, BUSY_REQUESTS = 1500, BUSY_ROUNDS = 5, BUSY_PAUSE_US = 1000 };

struct busy {
    struct load tile;
    char view_prefix[256];
    double ms[2][BUSY_ROUNDS * BUSY_REQUESTS]; /* of the paced client, idle and while drawing */
    size_t n[2];
    atomic_bool draw, stop;
    atomic_int views;
};

/* One request on an open connection; reads until answer_bytes have come, or to the end of the
 * connection when that is 0. */
static bool serve_busy_ask(int fd, const char *request, size_t answer_bytes)
{
    static _Thread_local char bytes[1 << 18];
    if (!load_send(fd, request))
        return false;
    for (size_t got = 0; !answer_bytes || got < answer_bytes;) {
        ssize_t n = recv(fd, bytes, sizeof bytes, 0);
        if (n <= 0)
            return n == 0 && !answer_bytes && got > 0;
        got += (size_t)n;
    }
    return true;
}

/* Worker 0 asks for a tile every millisecond; worker 1 keeps the renderer drawing, every view
 * another one. */
static enum err_code serve_busy_work(void *user, size_t index, struct err *e)
{
    struct busy *w = user;
    char request[512];
    bool ok = true;
    int fd = index == 0 ? load_dial(w->tile.port) : -1;
    int kind = atomic_load(&w->draw);
    for (int i = 0; index == 0 && ok && i < BUSY_REQUESTS; i++) {
        double start_s = clock_s();
        ok = fd >= 0 && serve_busy_ask(fd, w->tile.request, w->tile.answer_bytes);
        w->ms[kind][w->n[kind]++] = (clock_s() - start_s) * 1e3;
        nanosleep(&(struct timespec){.tv_nsec = BUSY_PAUSE_US * 1000}, NULL);
    }
    if (index == 0)
        atomic_store(&w->stop, true);
    while (index == 1 && ok && atomic_load(&w->draw) && !atomic_load(&w->stop)) {
        snprintf(
            request, sizeof request,
            "GET %s,150@%d,-60/1280x720.jpg HTTP/1.1\r\nHost: bench\r\nConnection: close\r\n\r\n",
            w->view_prefix, atomic_fetch_add(&w->views, 1) % 360);
        int view = load_dial(w->tile.port);
        ok = view >= 0 && serve_busy_ask(view, request, 0);
        if (view >= 0)
            close(view);
    }
    if (fd >= 0)
        close(fd);
    return ok ? ERR_OK : err_set(e, ERR_IO, "load: a connection broke");
}

static enum err_code serve_busy_measure(struct busy *w, bool draw, struct err *e)
{
    atomic_store(&w->stop, false);
    atomic_store(&w->draw, draw);
    return pool_for(2, 2, serve_busy_work, w, e);
}

static void serve_busy_report(struct bench *b, struct busy *w)
{
    static const struct {
        const char *name;
        double share;
    } at[2] = {{"median", 0.5}, {"99th percentile", 0.99}};
    char text[96];
    for (int kind = 0; kind < 2; kind++)
        sort_doubles(w->ms[kind], w->n[kind]);
    for (int k = 0; k < 4; k++) {
        double idle_ms = w->ms[0][(size_t)(at[k % 2].share * (double)w->n[0])];
        double ms = w->ms[k / 2][(size_t)(at[k % 2].share * (double)w->n[k / 2])];
        snprintf(text, sizeof text, "hot tile, %s, %s", k / 2 ? "while drawing" : "idle",
                 at[k % 2].name);
        bench_report(b, text, ms, "ms", k / 2 ? ms / idle_ms : 0, k / 2 ? "no drawing" : NULL);
    }
    bench_report(b, "views drawn meanwhile", atomic_load(&w->views), "", 0, NULL);
}

/* How long a hot tile takes while the server draws one view after the other. */
static enum err_code serve_busy(struct bench *b, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct server_config cfg;
    struct arena arena = {0};
    struct server *server = NULL;
    struct buf tile = {0};
    struct key key;
    const char *const paths[] = {path};
    struct busy *w = mem_array(1, sizeof *w);
    enum err_code rc = w ? file_join(path, bench_tmpdir(b), "bench.tiles", e)
                         : err_set(e, ERR_MEM, "load: out of memory");
    if (!rc)
        rc = load_store(path, b->quick ? 2000 : BUSY_GAUSSIANS, &key, e);
    if (!rc)
        rc = load_config(&cfg, &arena, e);
    cfg.device = "auto";
    if (!rc)
        rc = serve_hot(&cfg, paths, key, &server, &w->tile, &tile, NULL, e);
    if (rc)
        goto out;
    struct catalog *c = services_catalog(server_services(server));
    snprintf(w->view_prefix, sizeof w->view_prefix, "/d/bench/r/%s/static/%.6f,%.6f",
             c->ds[0]->meta.revision, c->ds[0]->meta.origin.lon_deg, c->ds[0]->meta.origin.lat_deg);
    catalog_drop(&c);
    for (int i = 0; !rc && i < 2 * (b->quick ? 1 : BUSY_ROUNDS); i++) /* in turns */
        rc = serve_busy_measure(w, i % 2, e);
    if (!rc)
        serve_busy_report(b, w);
out:
    server_stop(&server);
    arena_free(&arena);
    buf_free(&tile);
    mem_free(w);
    return rc;
}

/* ---- jobs that do nothing ---- */

enum { JOB_WAITERS = 256 };
struct trivial { /* jobs are asked for by as many waiters as a busy server has */
    struct jobs *jobs;
    size_t n;
    struct trivial_waiter {
        struct job_waiter waiter; /* first */
        _Atomic bool busy;
    } waiters[JOB_WAITERS];
};

static enum err_code serve_job_run(void *user, const struct job *j, void *work, size_t worker,
                                   struct body **out, struct err *e)
{
    struct buf b = {0};
    (void)user, (void)j, (void)work, (void)worker;
    buf_u8(&b, 1);
    *out = body_take(&b, "\"a tag\"");
    return *out ? ERR_OK : err_set(e, ERR_MEM, "load: out of memory");
}

static void serve_job_drop(void *user, void *work)
{
    (void)user;
    mem_free(work);
}

static void serve_job_wake(struct job_waiter *w)
{
    body_drop(&w->result.body);
    atomic_store_explicit(&((struct trivial_waiter *)(void *)w)->busy, false, memory_order_release);
}

/* Each with a name of its own; then until all have ended. */
static enum err_code serve_job_round(void *user, struct err *e)
{
    struct trivial *t = user;
    static uint64_t name;
    for (size_t i = 0; i < t->n + JOB_WAITERS; i++) {
        struct trivial_waiter *w = &t->waiters[i % JOB_WAITERS];
        while (atomic_load_explicit(&w->busy, memory_order_acquire))
            sched_yield();
        if (i >= t->n)
            continue;
        name++;
        w->waiter = (struct job_waiter){.wake = serve_job_wake};
        atomic_store(&w->busy, true);
        if (job_submit(t->jobs, JOB_TILE, hash_bytes(&name, sizeof name), mem_array(1, 1), i % 16,
                       10, &w->waiter))
            return err_set(e, ERR_INTERNAL, "load: a job was refused: %s", w->waiter.result.msg);
    }
    return ERR_OK;
}

/* Queue, single flight, threads and waking: what a request that misses pays beside its work. */
static enum err_code serve_jobs(struct bench *b, struct err *e)
{
    const struct job_config cfg = {.tile_threads = pool_cores(),
                                   .queue_limit = {1, 2 * JOB_WAITERS, 1, 1, 1, 1},
                                   .run = serve_job_run,
                                   .drop = serve_job_drop};
    struct trivial *t = mem_array(1, sizeof *t);
    double ms;
    if (!t)
        return err_set(e, ERR_MEM, "load: out of memory");
    t->n = b->quick ? 500 : 20000;
    enum err_code rc = job_open(&cfg, &t->jobs, e);
    if (!rc)
        rc = bench_time(b, serve_job_round, t, &ms, NULL, e);
    if (!rc)
        bench_report(b, "jobs that do nothing", (double)t->n / ms * 1e3, "jobs/s", 0, NULL);
    (void)job_close(&t->jobs);
    mem_free(t);
    return rc;
}

enum err_code bench_serve(struct bench *b, struct err *e)
{
    enum err_code rc = serve_jobs(b, e);
    if (!rc)
        rc = serve_size(b, 280, "small", e);
    if (!rc)
        rc = serve_size(b, 2600, "usual", e);
    if (!rc)
        rc = serve_logged(b, e);
    if (!rc)
        rc = serve_idle(b, e);
    return !rc ? serve_busy(b, e) : rc;
}
