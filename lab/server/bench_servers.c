/* Files of 6, 34 and 520 KB, a map tile and a 304 from three servers, each on one core, with the
 * clients on another: citysplat with a result in memory, libmicrohttpd alone with the same bytes,
 * and nginx with a file (sendfile, one worker, page cache). They take turns within each round, so
 * that other work on the machine affects all of them.
 *
 * Checked before timing: all answer with the tile's bytes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/bench.h"
#include "lab/server/load.h"

#include <microhttpd.h>
#include <netinet/in.h>
#include <signal.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "core/math/sort.h"
#include "core/pool.h"
#include "server/answers/services.h"
#include "server/server.h"

extern char **environ;

enum { RIVALS = 3, ROUNDS_MAX = 64 };
enum { RIVAL_OURS, RIVAL_BARE, RIVAL_NGINX };
static const char *const servers_names[RIVALS] = {"citysplat", "libmicrohttpd alone", "nginx"};

struct rival {
    bool there;
    struct load load;
    double ms[ROUNDS_MAX], cpu_s[ROUNDS_MAX]; /* a round */
};
struct servers {
    struct bench *b;
    pid_t nginx; /* 0: none */
    uint16_t nginx_port;
    struct rival rival[RIVALS];
};

/* ---- nginx ---- */

/* A port that is free now. */
static uint16_t servers_port(void)
{
    struct sockaddr_in a = {.sin_family = AF_INET};
    socklen_t n = sizeof a;
    a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    int fd = socket(AF_INET, SOCK_STREAM, 0);
    bool ok = fd >= 0 && !bind(fd, (struct sockaddr *)&a, sizeof a) &&
              !getsockname(fd, (struct sockaddr *)&a, &n);
    if (fd >= 0)
        close(fd);
    return ok ? ntohs(a.sin_port) : 0;
}

static enum err_code servers_nginx_config(const char *dir, uint16_t port, char path[FILE_PATH_MAX],
                                          struct err *e)
{
    struct buf b = {0};
    buf_printf(&b,
               "daemon off;\nmaster_process off;\nworker_processes 1;\npid %s/nginx.pid;\n"
               "events { worker_connections 1024; }\n"
               "http {\n  access_log off;\n  sendfile on;\n  tcp_nodelay on;\n"
               "  open_file_cache max=16;\n  keepalive_requests 1000000000;\n"
               "  default_type application/octet-stream;\n",
               dir);
    static const char *const temp[] = {"client_body", "proxy", "fastcgi", "uwsgi", "scgi"};
    for (size_t i = 0; i < sizeof temp / sizeof *temp; i++)
        buf_printf(&b, "  %s_temp_path %s/nginx-%s;\n", temp[i], dir, temp[i]);
    buf_printf(&b, "  server { listen 127.0.0.1:%u backlog=1024; root %s; }\n}\n", (unsigned)port,
               dir);
    enum err_code rc = buf_check(&b, e);
    if (!rc)
        rc = file_join(path, dir, "nginx.conf", e);
    if (!rc)
        rc = file_write(path, b.data, b.size, e);
    buf_free(&b);
    return rc;
}

/* On the servers' core. Without nginx its rows are left out, and it is said. */
static enum err_code servers_nginx_start(struct servers *s, struct err *e)
{
    char conf[FILE_PATH_MAX], errors[FILE_PATH_MAX];
    const char *dir = bench_tmpdir(s->b);
    const char *program = file_exists("/usr/sbin/nginx") ? "/usr/sbin/nginx" : "nginx";
    const struct timespec nap = {.tv_nsec = 20000000};
    s->nginx_port = servers_port();
    enum err_code rc = servers_nginx_config(dir, s->nginx_port, conf, e);
    if (!rc)
        rc = file_join(errors, dir, "nginx.log", e);
    if (rc)
        return rc;
    const char *argv[] = {program, "-p", dir, "-e", errors, "-c", conf, NULL};
    load_pin(LOAD_CORE_SERVER);
    int code = posix_spawnp(&s->nginx, program, NULL, NULL, (char **)(uintptr_t)argv, environ);
    load_unpin();
    if (code) {
        s->nginx = 0;
        log_warn("bench", "no nginx (Debian's package nginx-light has it): its rows are left out");
        return ERR_OK;
    }
    for (int i = 0; i < 250; i++) {
        int fd = load_dial(s->nginx_port);
        if (fd >= 0) {
            close(fd);
            s->rival[RIVAL_NGINX].there = true;
            return ERR_OK;
        }
        nanosleep(&nap, NULL);
    }
    return err_set(e, ERR_IO, "bench_servers: nginx does not listen");
}

static void servers_nginx_stop(struct servers *s)
{
    if (!s->nginx)
        return;
    kill(s->nginx, SIGTERM);
    waitpid(s->nginx, NULL, 0);
    s->nginx = 0;
}

/* ---- a case ---- */

/* One run of one of them: its time, and the CPU time of the server alone. */
static enum err_code servers_run(struct servers *s, int which, int round, struct err *e)
{
    struct rival *r = &s->rival[which];
    double clients_s = r->load.cpu_s[0] + r->load.cpu_s[1], start_s = clock_s();
    double cpu_s = which == RIVAL_NGINX ? load_cpu_of(s->nginx) : clock_cpu_s();
    enum err_code rc = load_run(&r->load, e);
    if (rc)
        return err_add(e, "%s", servers_names[which]);
    if (round < 0) /* caches are warm now */
        return rc;
    r->ms[round] = (clock_s() - start_s) * 1e3;
    clients_s = r->load.cpu_s[0] + r->load.cpu_s[1] - clients_s;
    r->cpu_s[round] =
        which == RIVAL_NGINX ? load_cpu_of(s->nginx) - cpu_s : clock_cpu_s() - cpu_s - clients_s;
    return rc;
}

/* To nginx, of the same round: the median, and from the least to the most. */
static void servers_report_ratio(struct servers *s, const char *what, int rounds)
{
    char text[128];
    double ratio[ROUNDS_MAX];
    for (int i = 0; i < rounds; i++)
        ratio[i] = s->rival[RIVAL_OURS].cpu_s[i] / s->rival[RIVAL_NGINX].cpu_s[i];
    sort_doubles(ratio, (size_t)rounds);
    snprintf(text, sizeof text, "%s: CPU time to nginx's, %.2f to %.2f in %d rounds", what,
             ratio[0], ratio[rounds - 1], rounds);
    bench_report(s->b, text, ratio[rounds / 2], "", 0, NULL);
}

static void servers_report(struct servers *s, const char *what, int rounds)
{
    char text[96];
    double per_s[RIVALS] = {0}, us[RIVALS] = {0};
    for (int i = 0; i < RIVALS; i++) {
        struct rival *r = &s->rival[i];
        double n = LOAD_CLIENTS * (double)r->load.requests;
        if (!r->there)
            continue;
        double cpu_s[ROUNDS_MAX];
        memcpy(cpu_s, r->cpu_s, sizeof cpu_s);
        sort_doubles(r->ms, (size_t)rounds);
        per_s[i] = n / r->ms[rounds / 2] * 1e3;
        sort_doubles(cpu_s, (size_t)rounds);
        us[i] = cpu_s[rounds / 2] / n * 1e6;
        snprintf(text, sizeof text, "%s: %s", what, servers_names[i]);
        bench_report(s->b, text, per_s[i], "requests/s", per_s[i] / per_s[0], "citysplat");
        snprintf(text, sizeof text, "%s: %s, CPU time of a request", what, servers_names[i]);
        bench_report(s->b, text, us[i], "us", us[i] / us[0], "citysplat");
    }
    if (s->rival[RIVAL_NGINX].there)
        servers_report_ratio(s, what, rounds);
}

/* Rounds of all of them. tile: what a 200 must have as its body. */
static enum err_code servers_compare(struct servers *s, const char *what, const struct buf *tile,
                                     unsigned status, struct err *e)
{
    int rounds = s->b->runs < ROUNDS_MAX ? s->b->runs : ROUNDS_MAX;
    enum err_code rc = ERR_OK;
    for (int i = 0; i < RIVALS && !rc; i++) {
        struct buf got = {0};
        struct rival *r = &s->rival[i];
        if (!r->there)
            continue;
        rc = load_ask(&r->load, &got, NULL, e);
        if (!rc && status == MHD_HTTP_OK &&
            (got.size != tile->size || memcmp(got.data, tile->data, got.size) != 0))
            rc = err_set(e, ERR_INTERNAL, "bench_servers: check: %s sends other bytes",
                         servers_names[i]);
        buf_free(&got);
    }
    for (int round = -1; !rc && round < rounds; round++)
        for (int i = 0; !rc && i < RIVALS; i++)
            if (s->rival[i].there)
                rc = servers_run(s, i, round, e);
    if (!rc)
        servers_report(s, what, rounds);
    return rc;
}

/* The three on the same bytes; 304: told that they are known. */
static enum err_code servers_case(struct servers *s, const char *what, struct load *ours,
                                  const struct buf *tile, const char *etag, struct err *e)
{
    char name[32], path[FILE_PATH_MAX], nginx_tag[64] = "";
    struct load_bare bare = {0};
    struct buf none = {0};
    struct load *l = &s->rival[RIVAL_BARE].load, *n = &s->rival[RIVAL_NGINX].load;
    unsigned status = etag ? MHD_HTTP_NOT_MODIFIED : MHD_HTTP_OK;
    snprintf(name, sizeof name, "%zu.bin", tile->size); /* nginx keeps open what it has seen */
    enum err_code rc = file_join(path, bench_tmpdir(s->b), name, e);
    if (!rc && !etag) /* else it is there, and a younger file would have another tag */
        rc = file_write(path, tile->data, tile->size, e);
    s->rival[RIVAL_OURS].load = *l = *n = *ours;
    s->rival[RIVAL_OURS].there = s->rival[RIVAL_BARE].there = true;
    snprintf(l->request, sizeof l->request, "GET / HTTP/1.1\r\nHost: bench\r\n\r\n");
    snprintf(n->request, sizeof n->request, "GET /%s HTTP/1.1\r\nHost: bench\r\n\r\n", name);
    n->port = s->nginx_port;
    if (!rc && etag && s->nginx) {
        rc = load_ask(n, &none, nginx_tag, e);
        snprintf(n->request, sizeof n->request,
                 "GET /%s HTTP/1.1\r\nHost: bench\r\nIf-None-Match: %s\r\n\r\n", name, nginx_tag);
    }
    load_pin(LOAD_CORE_SERVER);
    if (!rc)
        rc = load_bare_start(&bare, tile, status, 1, &l->port, e);
    load_unpin();
    if (!rc)
        rc = servers_compare(s, what, tile, status, e);
    load_bare_stop(&bare);
    buf_free(&none);
    return rc;
}

/* Asks until the map tile is there: the process that draws has to start. *is: it came. */
static enum err_code servers_await_map(struct load *l, struct buf *tile, bool *is, struct err *e)
{
    const struct timespec nap = {.tv_nsec = 200000000};
    enum err_code rc = ERR_OK;
    *is = false;
    for (double end_s = clock_s() + 60; !rc && !*is && clock_s() < end_s;) {
        tile->size = 0;
        rc = load_ask(l, tile, NULL, e);
        *is = !rc && tile->size > 2 && tile->data[0] == 0xff && tile->data[1] == 0xd8;
        if (!*is)
            nanosleep(&nap, NULL);
    }
    return rc;
}

/* A tile of n Gaussians, or the map tile of the same place; with_304: and what is asked for again.
 */
static enum err_code servers_size(struct servers *s, size_t n_gaussians, size_t requests, bool map,
                                  bool with_304, struct err *e)
{
    bool is = true;
    char path[FILE_PATH_MAX], etag[64] = "", text[96];
    struct server_config cfg = {0};
    struct arena arena = {0};
    struct server *server = NULL;
    struct buf tile = {0};
    struct key key;
    struct load load = {.requests = s->b->quick ? 200 : requests, .pinned = true};
    const char *const paths[] = {path};
    enum err_code rc = file_join(path, bench_tmpdir(s->b), "servers.tiles", e);
    (void)remove(path);
    if (!rc)
        rc = load_store(path, n_gaussians, &key, e);
    if (!rc)
        rc = load_config(&cfg, &arena, e);
    cfg.http_threads = cfg.workers = 1;
    cfg.device = map ? "cpu" : cfg.device;
    load_pin(LOAD_CORE_SERVER);
    if (!rc)
        rc = server_start(&cfg, paths, 1, &server, e);
    load_unpin();
    if (rc)
        goto out;
    struct catalog *c = services_catalog(server_services(server));
    load.port = (uint16_t)atoi(strrchr(server_url(server), ':') + 1);
    int n = snprintf(load.request, sizeof load.request,
                     "GET /d/bench/r/%s/%s/%u/%u/%u.%s HTTP/1.1\r\nHost: bench\r\n\r\n",
                     c->ds[0]->meta.revision, map ? "map" : "t", key.z, key.x, key.y,
                     map ? "jpg" : "spz");
    catalog_drop(&c);
    if (map)
        rc = servers_await_map(&load, &tile, &is, e);
    if (!is) {
        log_warn("bench", "no map tile in 60 s (no OpenCL device?): its rows are left out");
        goto out;
    }
    for (int i = 0; !rc && i < 2; i++) { /* make the tile; then a hit, whose size counts */
        tile.size = 0;
        rc = load_ask(&load, &tile, etag, e);
    }
    snprintf(text, sizeof text, "%s%.1f KB", map ? "map tile, " : "", (double)tile.size * 1e-3);
    if (!rc)
        rc = servers_case(s, text, &load, &tile, NULL, e);
    if (!rc && with_304) {
        snprintf(load.request + n - 2, sizeof load.request - (size_t)n + 2,
                 "If-None-Match: %s\r\n\r\n", etag);
        rc = servers_case(s, "304", &load, &tile, etag, e);
    }
out:
    server_stop(&server);
    arena_free(&arena);
    buf_free(&tile);
    return rc;
}

enum err_code bench_servers(struct bench *b, struct err *e)
{
    static const struct {
        size_t gaussians, requests; /* of each client and round: about a second */
        bool map, with_304;
    } sizes[] = {{280, 30000, false, false},
                 {1850, 20000, false, true},
                 {28800, 3000, false, false},
                 {1850, 20000, true, false}};
    struct servers s = {.b = b};
    if (pool_cores() < 2)
        return err_set(e, ERR_LIMIT, "bench_servers: needs two cores, one for servers");
    enum err_code rc = servers_nginx_start(&s, e);
    for (size_t i = 0; !rc && i < sizeof sizes / sizeof *sizes; i++)
        rc = servers_size(&s, sizes[i].gaussians, sizes[i].requests, sizes[i].map,
                          sizes[i].with_304, e);
    servers_nginx_stop(&s);
    return rc;
}
