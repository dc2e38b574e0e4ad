/* See load.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#define _GNU_SOURCE // NOLINT(cert-dcl51-cpp): affinity
#include "lab/server/load.h"

#include <errno.h>
#include <microhttpd.h>
#include <netinet/in.h>
#include <poll.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "core/options/options.h"
#include "core/pool.h"
#include "lab/bench/city.h"
#include "lod/make/pyramid.h"
#include "lod/store/store.h"

/* ---- something to serve ---- */

enum err_code load_store(const char *path, size_t n, struct key *key, struct err *e)
{
    struct store_meta meta = {.name = "bench",
                              .origin = {13.4, 52.5, 40},
                              .sh_degree = 1,
                              .zoom_min = LOAD_ZOOM,
                              .zoom_max = LOAD_ZOOM};
    struct store *s = NULL;
    struct gauss g = {0};
    *key = key_at(meta.origin.lon_deg, meta.origin.lat_deg, LOAD_ZOOM);
    struct store_entry tile = {.tile = {.key = *key, .level = 3}, .shape.geometric_error_m = 1};
    enum err_code rc = gauss_alloc(&g, n, 1, 0, e);
    if (rc)
        return rc;
    g.n = n;
    for (size_t i = 0; i < n; i++) {
        for (size_t a = 0; a < 3; a++) {
            g.mean_m[3 * i + a] = (float)(60 * rng_unit(1, a, i) - 30);
            g.scale_log[3 * i + a] = (float)(-1 - rng_unit(1, 3 + a, i));
        }
        for (size_t a = 0; a < 4; a++)
            g.quat_wxyz[4 * i + a] = (float)rng_normal(1, 6 + a, i);
        for (size_t a = 0; a < 12; a++)
            g.sh[12 * i + a] = (float)(0.3 * rng_normal(1, 10 + a, i));
        g.opacity_logit[i] = (float)rng_normal(1, 30, i);
    }
    rc = store_create(path, &meta, &s, e);
    if (!rc)
        rc = store_put(s, &tile, &g, e);
    if (!rc)
        rc = store_commit(&s, e);
    if (s)
        store_close(&s);
    gauss_free(&g);
    return rc;
}

enum err_code load_city(const char *path, size_t n, struct err *e)
{
    static const struct geo_origin origin = {8.6821, 50.1109, 160};
    const struct pyramid_config cfg = {.name = "bench", .tile_edge_m = 60};
    struct pyramid_report report;
    struct gauss g = {0};
    enum err_code rc = city_sorted_degree(n, 1, &g, e);
    const struct pyramid_level level = {.g = &g, .level = 3};
    if (!rc)
        rc = pyramid_build(&origin, &level, 1, &cfg, NULL, 0, path, &report, e);
    gauss_free(&g);
    return rc;
}

enum err_code load_config(struct server_config *cfg, struct arena *a, struct err *e)
{
    enum err_code rc = config_defaults(cfg, a, e);
    cfg->port = 0;
    cfg->device = "none";
    cfg->access_log = false;
    cfg->requests_per_connection = 1000000000;
    cfg->client_views_s = 0;
    return rc;
}

/* ---- the client ---- */

int load_dial(uint16_t port)
{
    return load_dial_from(1, port);
}

int load_dial_from(unsigned host, uint16_t port)
{
    struct sockaddr_in a = {.sin_family = AF_INET, .sin_port = htons(port)}, own = a;
    a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    own.sin_addr.s_addr = htonl((INADDR_LOOPBACK & ~255u) + host);
    own.sin_port = 0;
    int fd = socket(AF_INET, SOCK_STREAM, 0);
    if (fd >= 0 && host > 1 && bind(fd, (struct sockaddr *)&own, sizeof own) != 0) {
        close(fd);
        return -1;
    }
    if (fd >= 0 && connect(fd, (struct sockaddr *)&a, sizeof a) != 0) {
        close(fd);
        fd = -1;
    }
    return fd;
}

bool load_send(int fd, const char *text)
{
    size_t n = strlen(text);
    return send(fd, text, n, MSG_NOSIGNAL) == (ssize_t)n;
}

static double load_thread_cpu_s(void)
{
    struct timespec ts;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &ts);
    return (double)ts.tv_sec + (double)ts.tv_nsec * 1e-9;
}

static _Thread_local cpu_set_t load_unpinned;

void load_pin(int core)
{
    cpu_set_t one;
    CPU_ZERO(&one);
    CPU_SET((size_t)core, &one);
    (void)sched_getaffinity(0, sizeof load_unpinned, &load_unpinned);
    (void)sched_setaffinity(0, sizeof one, &one);
}

void load_unpin(void)
{
    (void)sched_setaffinity(0, sizeof load_unpinned, &load_unpinned);
}

double load_cpu_of(pid_t pid)
{
    clockid_t clock;
    struct timespec t;
    if (clock_getcpuclockid(pid, &clock) || clock_gettime(clock, &t))
        return 0;
    return (double)t.tv_sec + (double)t.tv_nsec * 1e-9;
}

/* Keep every connection busy until `requests` answers have come. */
static enum err_code load_client(void *user, size_t index, struct err *e)
{
    struct load *l = user;
    static const char fail[] = "load: a connection broke";
    char *bytes = mem_array(1 << 18, 1);
    struct pollfd p[LOAD_CONNECTIONS];
    size_t due[LOAD_CONNECTIONS], sent = 0, done = 0, opened = 0;
    enum err_code rc = bytes ? ERR_OK : err_set(e, ERR_MEM, "load: out of memory");
    double start_s = load_thread_cpu_s();
    if (l->pinned)
        load_pin(LOAD_CORE_CLIENT);
    for (; opened < LOAD_CONNECTIONS && !rc; opened++) {
        p[opened] = (struct pollfd){.fd = load_dial(l->port), .events = POLLIN};
        due[opened] = l->answer_bytes;
        if (p[opened].fd < 0 || !load_send(p[opened].fd, l->request))
            rc = err_set(e, ERR_IO, "%s", fail);
        sent++;
    }
    while (!rc && done < sent) {
        if (poll(p, LOAD_CONNECTIONS, 10000) <= 0)
            rc = err_set(e, ERR_IO, "load: no answer for 10 s");
        for (size_t i = 0; i < LOAD_CONNECTIONS && !rc; i++) {
            if (!(p[i].revents & (POLLIN | POLLHUP | POLLERR)))
                continue;
            ssize_t n = recv(p[i].fd, bytes, 1 << 18, MSG_DONTWAIT);
            if (n < 0 && errno == EAGAIN)
                continue;
            if (n <= 0)
                rc = n ? err_errno(e, ERR_IO, "%s", fail)
                       : err_set(e, ERR_IO, "%s: closed after %zu answers", fail, done);
            else if ((size_t)n > due[i])
                rc = err_set(e, ERR_IO, "%s: an answer is longer than the first one", fail);
            else
                due[i] -= (size_t)n;
            if (rc || due[i])
                continue;
            done++;
            due[i] = l->answer_bytes;
            if (sent < l->requests && !load_send(p[i].fd, l->request))
                rc = err_set(e, ERR_IO, "%s", fail);
            else if (sent < l->requests)
                sent++;
        }
    }
    for (size_t i = 0; i < opened; i++)
        if (p[i].fd >= 0)
            close(p[i].fd);
    if (l->pinned)
        load_unpin();
    l->cpu_s[index] += load_thread_cpu_s() - start_s;
    mem_free(bytes);
    return rc;
}

enum err_code load_run(void *user, struct err *e)
{
    return pool_for(LOAD_CLIENTS, LOAD_CLIENTS, load_client, user, e);
}

enum err_code load_ask(struct load *l, struct buf *body, char etag[64], struct err *e)
{
    char bytes[65536];
    struct buf all = {0};
    enum err_code rc = ERR_OK;
    int fd = load_dial(l->port);
    size_t want = 0;
    if (fd < 0 || !load_send(fd, l->request))
        rc = err_set(e, ERR_IO, "load: cannot connect");
    while (!rc && (!want || all.size < want)) {
        ssize_t n = recv(fd, bytes, sizeof bytes, 0);
        if (n <= 0)
            rc = err_set(e, ERR_IO, "load: the answer breaks off");
        else
            buf_add(&all, bytes, (size_t)n);
        if (!rc)
            rc = buf_check(&all, e);
        if (rc || want)
            continue;
        buf_add(&all, "", 1);
        all.size--;
        const char *head = (const char *)all.data, *end = strstr(head, "\r\n\r\n");
        const char *length = strstr(head, "Content-Length: "), *tag = strstr(head, "ETag: ");
        bool bodyless = !strncmp(head + 9, "304", 3);
        if (!end)
            continue;
        size_t n_head = (size_t)(end + 4 - head);
        want = n_head + (bodyless || !length ? 0 : strtoul(length + 16, NULL, 10));
        if (etag && tag)
            snprintf(etag, 64, "%.*s", (int)strcspn(tag + 6, "\r"), tag + 6);
        l->answer_bytes = want;
        body->size = n_head; /* where the body begins, until all is here */
    }
    if (fd >= 0)
        close(fd);
    size_t at = body->size;
    body->size = 0;
    if (!rc)
        buf_add(body, all.data + at, all.size - at);
    buf_free(&all);
    return !rc ? buf_check(body, e) : rc;
}

/* ---- libmicrohttpd alone ---- */

/* NOLINTBEGIN(readability-non-const-parameter): as libmicrohttpd has them */
static enum MHD_Result load_bare_answer(void *cls, struct MHD_Connection *c, const char *url,
                                        const char *method, const char *version, const char *upload,
                                        size_t *n_upload, void **context)
{
    /* NOLINTEND(readability-non-const-parameter) */
    struct load_bare *s = cls;
    (void)url, (void)method, (void)version, (void)upload, (void)n_upload;
    if (!*context) { /* the first call has the headers; an answer then would close the connection */
        *context = s;
        return MHD_YES;
    }
    return MHD_queue_response(c, s->status, s->response);
}

enum err_code load_bare_start(struct load_bare *s, const struct buf *body, unsigned status,
                              unsigned threads, uint16_t *port, struct err *e)
{
    s->status = status;
    s->response = MHD_create_response_from_buffer(body->size, body->data, MHD_RESPMEM_PERSISTENT);
    s->daemon = MHD_start_daemon(MHD_USE_EPOLL_INTERNAL_THREAD, 0, NULL, NULL, load_bare_answer, s,
                                 threads > 1 ? MHD_OPTION_THREAD_POOL_SIZE : MHD_OPTION_END,
                                 threads, MHD_OPTION_END);
    const union MHD_DaemonInfo *info =
        s->daemon ? MHD_get_daemon_info(s->daemon, MHD_DAEMON_INFO_BIND_PORT) : NULL;
    if (!s->response || !info)
        return err_set(e, ERR_IO, "load: libmicrohttpd does not start");
    *port = info->port;
    return ERR_OK;
}

void load_bare_stop(struct load_bare *s)
{
    if (s->daemon)
        MHD_stop_daemon(s->daemon);
    if (s->response)
        MHD_destroy_response(s->response);
}
