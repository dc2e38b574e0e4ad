/* The server as a whole: stores opened, threads started, and all of it taken down again in order.
 * First the listener closes and answers drain, then jobs stop, then what they used is freed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/server.h"

#include <signal.h>
#include <stdio.h>
#include <string.h>

#include "core/pool.h"
#include "lod/clip.h"
#include "server/http.h"
#include "server/services.h"
#include "server/work.h"

struct server {
    struct server_config cfg; /* texts are borrowed from the caller */
    const char *const *paths;
    size_t n_paths, workers;
    struct clip clip; /* of all stores; in use if stores.clip is set */
    struct catalog_options stores;
    struct services services;
    struct http *http;
    char url[128];
};

static void server_enter_view(void *user)
{
    picture_enter(((struct services *)user)->picture);
}

static void server_leave_view(void *user)
{
    picture_leave(((struct services *)user)->picture);
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
                        (size_t)cfg->queue_prefetch, (size_t)cfg->queue_maps},
        .client_views_s = cfg->client_views_s,
        .client_tiles_s = cfg->client_tiles_s,
        .user = s,
        .run = work_run,
        .drop = work_drop,
        .passing = work_passing,
        .view_enter = server_enter_view,
        .view_leave = server_leave_view,
    };
    enum err_code rc = views ? picture_open(cfg, &s->picture, e) : ERR_OK;
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
    snprintf(sv->url, sizeof sv->url, "http://%s%s%s:%u/", open, host, close, http_port(sv->http));
    /* Who listens on every address does not know by which one it is seen. */
    const char *own = a[strspn(a, "0.:")] ? sv->url : NULL;
    sv->services.url = sv->cfg.public_url && *sv->cfg.public_url ? sv->cfg.public_url : own;
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
    sv->stores = (struct catalog_options){.readers = sv->workers,
                                          .clip_dir = cfg->clip_dir,
                                          .public_url = cfg->public_url,
                                          .keep_s = cfg->keep_s,
                                          .keep_revisions = (size_t)cfg->keep_revisions};
    struct services *s = &sv->services;
    bool clips = false;
    enum err_code rc = log_start(e);
    if (!rc)
        rc = clip_of_options(cfg->clip, cfg->clip_low_m, cfg->clip_high_m, "clip-", &sv->clip,
                             &clips, e);
    sv->stores.clip = clips ? &sv->clip : NULL;
    if (!rc)
        rc = services_open(s, &sv->cfg, e);
    if (!rc)
        rc = catalog_open(paths, n, &sv->stores, NULL, &s->catalog, e);
    if (!rc)
        rc = http_open(s, &sv->http, e);
    if (!rc) {
        server_set_url(sv);
        rc = server_load_web(sv, e);
    }
    if (!rc)
        rc = server_start_jobs(sv, e);
    if (!rc)
        rc = http_start(sv->http, e);
    if (!rc) {
        log_info("serve", "memory cache_mb=%d inflight_mb=%d view_cache_mb=%d", (int)cfg->cache_mb,
                 (int)cfg->inflight_mb, s->picture ? (int)cfg->view_cache_mb : 0);
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
    struct catalog *older = services_catalog(s), *newer = NULL;
    enum err_code rc = catalog_open(sv->paths, sv->n_paths, &sv->stores, older, &newer, e);
    if (rc)
        atomic_fetch_add(&s->metrics.reload_failed, 1);
    services_set_catalog(s, newer, rc ? e->msg : "");
    catalog_drop(&older);
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
    bool ended = services_free(&sv->services);
    if (!ended)
        log_error("serve", "the device does not return from a call; its thread is left behind");
    log_stop(1);
    clip_free(&sv->clip);
    if (ended)
        mem_free(sv);
    return ended;
}

double server_hangs_s(struct server *sv)
{
    return services_hangs_s(&sv->services);
}
