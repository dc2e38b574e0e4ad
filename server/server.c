/* The server as a whole: it opens stores and starts threads, and ends everything in order. First
 * the listener closes and requests are finished, then jobs stop, then the rest is freed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/server.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include "core/pool.h"
#include "lod/clip.h"
#include "server/http.h"
#include "server/link.h"
#include "server/motion.h"
#include "server/routes.h"
#include "server/services.h"
#include "server/work.h"

struct server {
    struct server_config cfg; /* texts are borrowed from the caller */
    const char *const *paths;
    size_t n_paths, workers;
    struct clip clip; /* of all stores; in use if stores.clip is set */
    struct catalog_options stores;
    struct services services;
    struct http *http, *admin; /* admin: NULL without --admin */
    char url[128];
};

static void server_stop_drawing(void *user)
{
    picture_stop(((struct services *)user)->picture);
}

static enum err_code server_start_jobs(struct server *sv, struct err *e)
{
    struct services *s = &sv->services;
    const struct server_config *cfg = &sv->cfg;
    bool views = !cfg->device || strcmp(cfg->device, "none") != 0;
    const struct job_config jobs = {
        .tile_threads = sv->workers,
        .view_thread = views,
        .queue_limit = {(size_t)cfg->queue_views, (size_t)cfg->queue_tiles,
                        (size_t)cfg->queue_prefetch, (size_t)cfg->queue_maps, (size_t)cfg->streams,
                        (size_t)cfg->queue_views},
        .client_views_s = cfg->client_views_s,
        .client_tiles_s = cfg->client_tiles_s,
        .user = s,
        .run = work_run,
        .drop = work_drop,
        .passing = work_passing,
        .stop = server_stop_drawing,
    };
    enum err_code rc = views ? picture_open(cfg, &s->picture, e) : ERR_OK;
    if (!rc && views)
        rc = picture_start(s->picture, e);
    if (!rc)
        rc = motion_open(s, &s->motion, e);
    return !rc ? job_open(&jobs, &s->jobs, e) : rc;
}

static enum err_code server_load_web(struct server *sv, struct err *e)
{
    char dir[FILE_PATH_MAX];
    if (sv->cfg.web_dir)
        return static_load(sv->cfg.web_dir, &sv->services.web, e);
    if (static_default_dir(dir))
        return static_load(dir, &sv->services.web, e);
    log_warn("serve",
             "no viewer files found near the program; / shows JSON (build web/, or --web-dir DIR)");
    return ERR_OK;
}

static void server_set_url(struct server *sv)
{
    const char *a = sv->cfg.address;
    const char *host = !strcmp(a, "0.0.0.0") ? "127.0.0.1" : !strcmp(a, "::") ? "::1" : a;
    const char *open = strchr(host, ':') ? "[" : "", *close = *open ? "]" : "";
    snprintf(sv->url, sizeof sv->url, "%s://%s%s%s:%u/", sv->services.tls ? "https" : "http", open,
             host, close, http_port(sv->http));
    /* Who listens on every address does not know by which one it is seen. */
    const char *own = a[strspn(a, "0.:")] ? sv->url : NULL;
    sv->services.url = sv->cfg.public_url && *sv->cfg.public_url ? sv->cfg.public_url : own;
}

/* Where descriptors run out, accept() fails before an idle connection could give way to a new one.
 * So the limit is raised as far as this process may, and where that is not enough there are fewer
 * connections. */
static void server_fit_descriptors(struct server *sv)
{
    enum { OTHERS = 64, CONNECTIONS_MIN = 8 };
    struct rlimit limit;
    const size_t wanted = (size_t)sv->cfg.max_connections,
                 others =
                     OTHERS + sv->n_paths * (2 + sv->stores.keep_revisions) * (sv->workers + 2),
                 need = http_descriptors(wanted) + others;
    if (getrlimit(RLIMIT_NOFILE, &limit) || limit.rlim_cur == RLIM_INFINITY ||
        limit.rlim_cur >= need)
        return;
    const struct rlimit more = {
        limit.rlim_max == RLIM_INFINITY || limit.rlim_max > need ? need : limit.rlim_max,
        limit.rlim_max};
    if (!setrlimit(RLIMIT_NOFILE, &more))
        limit = more;
    if (limit.rlim_cur >= need)
        return;
    size_t room = limit.rlim_cur / 8; /* of many datasets some revisions go without */
    while (room < wanted && http_descriptors(room + 1) + others <= limit.rlim_cur)
        room++;
    room = room < CONNECTIONS_MIN ? CONNECTIONS_MIN : room;
    if (room < wanted)
        sv->cfg.max_connections = (int64_t)room;
    log_warn("serve",
             "descriptors limit=%zu needed=%zu max_connections=%zu instead of %zu: raise the limit "
             "(ulimit -n, LimitNOFILE) or ask for fewer",
             (size_t)limit.rlim_cur, need, room < wanted ? room : wanted, wanted);
}

static enum err_code server_read_clip(const struct server_config *cfg, struct clip *out, bool *any,
                                      struct err *e)
{
    return clip_of_options(cfg->clip, cfg->clip_low_m, cfg->clip_high_m, "clip-", out, any, e);
}

/* What options say of stores; sv->clip is freed by the caller. */
static enum err_code server_read_stores(struct server *sv, size_t readers, struct err *e)
{
    const struct server_config *cfg = &sv->cfg;
    bool clips = false;
    enum err_code rc = server_read_clip(cfg, &sv->clip, &clips, e);
    sv->stores = (struct catalog_options){.readers = readers,
                                          .clip = clips ? &sv->clip : NULL,
                                          .clip_dir = cfg->clip_dir,
                                          .public_url = cfg->public_url,
                                          .base_path = cfg->base_path,
                                          .keep_s = cfg->keep_s,
                                          .keep_revisions = (size_t)cfg->keep_revisions,
                                          .basemap = cfg->basemap,
                                          .basemap_attribution = cfg->basemap_attribution,
                                          .preset = (unsigned)cfg->preset};
    return rc;
}

static void server_log_disk(const struct server *sv)
{
    struct disk_stats st;
    if (!sv->services.disk)
        return;
    disk_count(sv->services.disk, &st);
    log_info("serve", "disk cache files=%zu mb=%llu of=%d dir=%s", st.entries,
             (unsigned long long)(st.bytes >> 20), (int)sv->cfg.cache_dir_mb, sv->cfg.cache_dir);
}

enum err_code server_start(const struct server_config *cfg, const char *const *paths, size_t n,
                           struct server **out, struct err *e)
{
    struct server *sv = mem_array(1, sizeof *sv);
    *out = sv;
    if (!sv)
        return err_set(e, ERR_MEM, "serve: out of memory");
    signal(SIGPIPE,
           SIG_IGN); /* a client that hangs up is an error of write(), not of the program */
    sv->cfg = *cfg;
    sv->paths = paths;
    sv->n_paths = n;
    sv->workers = cfg->workers ? (size_t)cfg->workers : pool_cores();
    struct services *s = &sv->services;
    enum err_code rc = log_start(e);
    if (!rc)
        rc = server_read_stores(sv, sv->workers, e);
    if (!rc)
        server_fit_descriptors(sv);
    if (!rc)
        rc = services_open(s, &sv->cfg, ROUTES, ROUTES_COUNT, e);
    if (!rc && cfg->cache_dir)
        rc = disk_open(cfg->cache_dir, (uint64_t)cfg->cache_dir_mb << 20, &s->disk, e);
    if (!rc && cfg->state_dir)
        rc = kept_open(cfg->state_dir, &s->kept, e);
    if (!rc)
        rc = catalog_open(paths, n, &sv->stores, NULL, &s->catalog, e);
    if (!rc)
        rc = http_open(s, HTTP_PUBLIC, &sv->http, e);
    if (!rc && cfg->admin)
        rc = http_open(s, HTTP_ADMIN, &sv->admin, e);
    if (!rc) {
        server_set_url(sv);
        rc = server_load_web(sv, e);
    }
    if (!rc)
        rc = server_start_jobs(sv, e);
    if (!rc)
        rc = http_start(sv->http, e);
    if (!rc && sv->admin)
        rc = http_start(sv->admin, e);
    if (!rc) {
        log_info("serve", "memory cache_mb=%d inflight_mb=%d view_cache_mb=%d", (int)cfg->cache_mb,
                 (int)cfg->inflight_mb, s->picture ? (int)cfg->view_cache_mb : 0);
        server_log_disk(sv);
        for (size_t i = 0; i < s->catalog->n; i++)
            log_info("serve", "dataset name=%s revision=%s tiles=%zu file=%s",
                     s->catalog->ds[i]->meta.name, s->catalog->ds[i]->meta.revision,
                     s->catalog->ds[i]->n_tiles, s->catalog->ds[i]->path);
    } else {
        server_stop(out);
    }
    return rc;
}

const char *server_url(const struct server *sv)
{
    return sv->url;
}

struct services *server_services(struct server *sv)
{
    return &sv->services;
}

enum err_code server_reload(struct server *sv, struct err *e)
{
    struct services *s = &sv->services;
    struct err own = {0};
    struct catalog *older = services_catalog(s), *newer = NULL;
    struct tls_pair *pair = NULL;
    struct clip clip;
    struct catalog_options stores = sv->stores;
    bool clips = false;
    e = e ? e : &own;                                                /* what it says is kept */
    enum err_code rc = server_read_clip(&sv->cfg, &clip, &clips, e); /* as its file is now */
    stores.clip = clips ? &clip : NULL;
    if (!rc && s->tls)
        rc = tls_read(s->tls, &pair, e);
    if (!rc)
        rc = catalog_open(sv->paths, sv->n_paths, &stores, older, &newer, e);
    if (!rc && s->tls)
        tls_use(s->tls, &pair);
    tls_discard(&pair);
    if (rc)
        atomic_fetch_add(&s->metrics.reload_failed, 1);
    services_set_catalog(s, newer, rc ? e->msg : "");
    if (!rc)
        job_forgive(s->jobs);
    catalog_drop(&older);
    clip_free(&clip);
    return rc;
}

void server_expire(struct server *sv, double now_s)
{
    struct services *s = &sv->services;
    struct catalog *now = services_catalog(s), *fewer = NULL;
    if (!catalog_expire(now, &sv->stores, now_s, &fewer, NULL) && fewer)
        services_set_catalog(s, fewer, NULL);
    catalog_drop(&now);
}

bool server_stop(struct server **out)
{
    struct server *sv = *out;
    *out = NULL;
    if (!sv)
        return true;
    http_close(&sv->http);
    http_close(&sv->admin); /* last: it says how the stopping goes */
    bool ended = services_free(&sv->services);
    if (!ended)
        log_error("serve", "a thread does not return from a call; it is left behind");
    log_stop(1);
    clip_free(&sv->clip);
    if (ended) {
        motion_close(&sv->services.motion);
        mem_free(sv);
    }
    return ended;
}

bool server_reload_asked(struct server *sv)
{
    return atomic_exchange(&sv->services.reload_asked, false);
}

uint16_t server_admin_port(const struct server *sv)
{
    return sv->admin ? http_port(sv->admin) : 0;
}

double server_failing_s(struct server *sv)
{
    return services_failing_s(&sv->services);
}

/* ---- is it well? ---- */

bool server_answers(const struct server *sv, double wait_s)
{
    const struct link health = {.from = LINK_ROOT, .up = ""};
    char path[32], ask[128], answer[16] = "";
    const size_t n = (size_t)snprintf(ask, sizeof ask,
                                      "GET %s HTTP/1.1\r\nHost: localhost\r\n"
                                      "User-Agent: citysplat-watchdog\r\nConnection: close\r\n\r\n",
                                      link_text(link_healthz, &health, path, sizeof path));
    struct sockaddr_in a = {.sin_family = AF_INET, .sin_port = htons(http_port(sv->http))};
    const struct timeval wait = {.tv_sec = (time_t)wait_s + 1};
    if (inet_pton(AF_INET, sv->cfg.address, &a.sin_addr) != 1 || !a.sin_port)
        return true; /* IPv6, or a socket of a file: not looked at */
    if (a.sin_addr.s_addr == htonl(INADDR_ANY))
        a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (fd < 0)
        return false;
    (void)setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &wait, sizeof wait);
    (void)setsockopt(fd, SOL_SOCKET, SO_SNDTIMEO, &wait, sizeof wait);
    bool answers = connect(fd, (struct sockaddr *)&a, sizeof a) == 0;
    if (answers && sv->services.tls)
        answers = tls_ask(fd, ask, answer, sizeof answer - 1);
    else if (answers)
        answers = send(fd, ask, n, MSG_NOSIGNAL) == (ssize_t)n &&
                  recv(fd, answer, sizeof answer - 1, MSG_WAITALL) > 0;
    answers = answers && !strncmp(answer, "HTTP/1.1 ", 9);
    close(fd);
    return answers;
}

enum err_code server_check(const struct server_config *cfg, const char *const *paths, size_t n,
                           FILE *out, struct err *e)
{
    struct server sv = {.cfg = *cfg};
    struct services *s = &sv.services;
    enum err_code rc = server_read_stores(&sv, 1, e);
    if (!rc)
        rc = services_open(s, &sv.cfg, ROUTES, ROUTES_COUNT, e);
    if (!rc)
        rc = http_check(cfg, e);
    if (!rc && cfg->cache_dir)
        rc = disk_check(cfg->cache_dir, e);
    if (!rc && cfg->state_dir)
        rc = kept_check(cfg->state_dir, e);
    if (!rc)
        rc = catalog_open(paths, n, &sv.stores, NULL, &s->catalog, e);
    if (!rc)
        rc = server_load_web(&sv, e);
    for (size_t i = 0; !rc && out && i < s->catalog->n; i++)
        fprintf(out, "dataset %s revision %s, %zu tiles: %s\n", s->catalog->ds[i]->meta.name,
                s->catalog->ds[i]->meta.revision, s->catalog->ds[i]->n_tiles,
                s->catalog->ds[i]->path);
    if (!rc && out && s->tls) {
        char text[256];
        tls_about(s->tls, text, sizeof text);
        fprintf(out, "TLS: %s\n", text);
    }
    if (!rc && out)
        fprintf(out, "viewer: %zu files\nwell\n", s->web.n);
    (void)services_free(s);
    clip_free(&sv.clip);
    return rc;
}
