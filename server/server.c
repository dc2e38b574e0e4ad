/* The server as a whole: it opens stores and starts threads, and ends everything in order. First
 * the listener closes and requests are finished, then jobs stop, then the rest is freed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/server.h"

#include <arpa/inet.h>
#include <jansson.h>
#include <math.h>
#include <netinet/in.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#include "core/machine.h"
#include "core/pool.h"
#include "lod/store/blocks.h"
#include "lod/store/remote.h"
#include "server/answers/routes.h"
#include "server/answers/services.h"
#include "server/answers/view_stream.h"
#include "server/answers/work.h"
#include "server/base/body_file.h"
#include "server/base/document.h"
#include "server/documents/link.h"
#include "server/http.h"
#include "server/http/supervisor.h"
#include "server/self_test.h"
#include "server/stores.h"

struct server {
    struct server_config cfg;     /* texts are borrowed from the caller */
    const struct server_own *own; /* NULL: tile stores */
    size_t workers;
    struct stores *stores;
    struct services services;
    struct pool_thread *keeper; /* looks at stores; NULL: there are none */
    pthread_mutex_t keep;       /* of what follows */
    pthread_cond_t keep_changed;
    bool stopping, kept, ticks;    /* kept: the thread has ended; ticks: server_keep was called */
    uint64_t wanted, begun, ended; /* reloads, each after the one before */
    bool tried;                    /* the last one came to stores */
    enum err_code reload_rc;
    struct err reload_why;
    double asked_s, look_s;    /* stores at addresses: last asked; not before, as a reload failed */
    double looked_s;           /* when memory was looked at */
    uint64_t streams;          /* and encoders, that were open then */
    struct http *http, *admin; /* admin: NULL without --admin */
    char url[128], memory[256];
};

static enum err_code server_reload_said(void *user, struct body **out, struct err *e);
static void server_keep_main(void *user);

static bool server_draws(const struct server_config *cfg)
{
    return !cfg->device || strcmp(cfg->device, "none") != 0;
}

static void server_stop_drawing(void *user)
{
    picture_stop(((struct services *)user)->picture);
}

static bool server_drawer_rests(void *user, size_t drawer)
{
    return picture_rests(((struct services *)user)->picture, drawer);
}

static enum err_code server_start_jobs(struct server *sv, struct err *e)
{
    struct services *s = &sv->services;
    const struct server_config *cfg = &sv->cfg;
    const bool views = server_draws(&sv->cfg);
    const struct job_config jobs = {
        .tile_threads = sv->workers,
        .draw_threads = !views            ? 0
                        : s->plan.drawers ? s->plan.drawers
                                          : 1,
        .rests = views ? server_drawer_rests : NULL,
        .queue_limit = {(size_t)cfg->queue_views, (size_t)cfg->queue_tiles,
                        (size_t)cfg->queue_prefetch, (size_t)cfg->queue_maps, (size_t)cfg->streams,
                        (size_t)cfg->queue_views},
        .cost = work_cost,
        .client_views_s = cfg->client_views_s,
        .client_tiles_s = cfg->client_tiles_s,
        .user = s,
        .run = work_run,
        .drop = work_drop,
        .passing = work_passing,
        .stop = server_stop_drawing,
    };
    enum err_code rc = views ? picture_open(cfg, &s->plan, &s->picture, e) : ERR_OK;
    if (!rc && views)
        rc = picture_start(s->picture, e);
    if (!rc)
        rc = view_stream_open(s, &s->view_streams, e);
    return !rc ? job_open(&jobs, &s->jobs, e) : rc;
}

static enum err_code server_load_web(const struct server *sv, struct static_table *out,
                                     struct err *e)
{
    char dir[FILE_PATH_MAX];
    if (sv->cfg.web_dir)
        return static_load(sv->cfg.web_dir, out, e);
    if (static_default_dir(dir))
        return static_load(dir, out, e);
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

/* What this process may have open: as much as it may allow itself, as stores that a reload finds
 * need descriptors, too. */
static size_t server_descriptors(void)
{
    struct rlimit limit;
    if (getrlimit(RLIMIT_NOFILE, &limit))
        return SIZE_MAX;
    const struct rlimit most = {limit.rlim_max, limit.rlim_max};
    if (limit.rlim_cur != limit.rlim_max && !setrlimit(RLIMIT_NOFILE, &most))
        limit = most;
    return limit.rlim_cur == RLIM_INFINITY ? SIZE_MAX : (size_t)limit.rlim_cur;
}

/* What stores and the program itself need, without connections. */
static size_t server_other_descriptors(const struct server *sv, const struct catalog *c)
{
    enum { OTHERS = 64 };
    const size_t revisions = 2 + (size_t)sv->cfg.keep_revisions;
    return OTHERS + (c->n_current + c->n_absent) * revisions * (sv->workers + 2);
}

/* Where descriptors run out, accept() fails before an idle connection could give way to a new one.
 * So where there are too few of them, there are fewer connections. */
static void server_fit_descriptors(struct server *sv)
{
    enum { CONNECTIONS_MIN = 8, FILES_MOST = 4096 };
    const size_t wanted = (size_t)sv->cfg.max_connections, limit = server_descriptors(),
                 others = server_other_descriptors(sv, stores_first(sv->stores)),
                 need = http_descriptors(wanted) + others;
    if (limit >= need) { /* of what is left, half: each answer from a file takes one, too */
        const size_t left = (limit - need) / 2;
        body_file_limit(left < FILES_MOST ? left : FILES_MOST);
        return;
    }
    body_file_limit(0);
    size_t room = limit / 8; /* of many datasets some revisions go without */
    while (room < wanted && http_descriptors(room + 1) + others <= limit)
        room++;
    room = room < CONNECTIONS_MIN ? CONNECTIONS_MIN : room;
    if (room < wanted)
        sv->cfg.max_connections = (int64_t)room;
    log_warn("serve",
             "descriptors limit=%zu needed=%zu max_connections=%zu instead of %zu: raise the limit "
             "(ulimit -n, LimitNOFILE) or ask for fewer",
             limit, need, room < wanted ? room : wanted, wanted);
}

/* After a reload, with the stores of now. How many connections there may be was settled before. */
static void server_check_descriptors(struct server *sv)
{
    struct catalog *c = services_catalog(&sv->services);
    const size_t limit = server_descriptors(),
                 need = http_descriptors((size_t)sv->cfg.max_connections) +
                        server_other_descriptors(sv, c);
    if (limit < need)
        log_warn("serve",
                 "descriptors limit=%zu needed=%zu: raise the limit (ulimit -n, LimitNOFILE), or "
                 "restart, which makes connections fewer",
                 limit, need);
    catalog_drop(&c);
}

/* What the stores ask of memory. */
static void server_needs(const struct catalog *c, struct memory_needs *n)
{
    for (size_t i = 0; i < c->n; i++) {
        const struct dataset *d = c->ds[i];
        const size_t row =
            (11 + 3 * gauss_sh_count(d->meta.sh_degree) + d->meta.embed_len) * sizeof(float);
        uint64_t of_zoom[KEY_ZOOM_MAX + 1] = {0};
        for (size_t k = 0; k < d->n_tiles; k++) {
            const struct store_tile *t = &d->tiles[k];
            of_zoom[t->key.z] += t->count;
            n->largest_tile = t->count * row > n->largest_tile ? t->count * row : n->largest_tile;
        }
        for (size_t z = 0; z <= KEY_ZOOM_MAX; z++)
            n->gaussians = of_zoom[z] > n->gaussians ? of_zoom[z] : n->gaussians;
    }
}

/* Options that say how much become what --memory allows. */
static enum err_code server_plan(struct server *sv, const struct catalog *c,
                                 struct memory_plan *plan, struct err *e)
{
    struct server_config *cfg = &sv->cfg;
    struct memory_needs n = {.base = mem_held_bytes(0),
                             .workers = sv->workers,
                             .connections = (size_t)cfg->max_connections,
                             .draws = server_draws(&sv->cfg),
                             .drawers = (unsigned)cfg->drawers,
                             .view_gaussians = (uint64_t)cfg->view_gaussians,
                             .view_mpx = cfg->max_view_mpx,
                             .video = view_stream_video_bytes((size_t)cfg->streams),
                             .cache = (size_t)cfg->cache_mb << 20,
                             .inflight = (size_t)cfg->inflight_mb << 20,
                             .view_cache = (size_t)cfg->view_cache_mb << 20};
    const size_t machine = machine_memory();
    enum err_code rc = machine_memory_parse(cfg->memory, machine, &n.budget, e);
    server_needs(c, &n);
    if (!rc)
        rc = memory_plan(&n, plan, e);
    if (rc)
        return rc;
    sv->workers = plan->workers;
    cfg->max_connections = (int64_t)plan->connections;
    if (n.draws) {
        cfg->view_gaussians = (int64_t)plan->view_gaussians;
        cfg->max_view_mpx = plan->view_mpx;
    }
    snprintf(sv->memory, sizeof sv->memory,
             "memory budget_mb=%zu of=%zu base_mb=%zu cache_mb=%zu inflight_mb=%zu drawing_mb=%zu "
             "drawers=%u view_cache_mb=%zu video_mb=%zu workers=%zu connections=%zu",
             plan->budget >> 20, machine >> 20, n.base >> 20, plan->cache >> 20,
             plan->inflight >> 20, plan->drawing >> 20, plan->drawers, plan->view_cache >> 20,
             plan->video >> 20, plan->workers, plan->connections);
    if (n.draws && cfg->drawers > plan->drawers)
        log_warn("serve", "--memory has room for %u of %u processes that draw", plan->drawers,
                 (unsigned)cfg->drawers);
    if (plan->lowered)
        log_warn("serve",
                 "--memory holds pictures to %llu Gaussians and %.2f megapixels, %.2f of them "
                 "supersampled",
                 (unsigned long long)(plan->view_gaussians ? plan->view_gaussians : n.gaussians),
                 plan->view_mpx, fmin(plan->view_mpx, (double)plan->drawn_px * 0.25e-6));
    return ERR_OK;
}

/* Stores and the viewer's files, which say what is needed, and then what uses memory. all: also
 * stores at addresses, however long that takes. */
static enum err_code server_open_services(struct server *sv, const char *const *paths, size_t n,
                                          bool all, struct err *e)
{
    struct static_table web = {0};
    struct memory_plan plan;
    enum err_code rc = stores_open(&sv->cfg, paths, n, sv->workers, all, &sv->stores, e);
    if (!rc)
        rc = server_load_web(sv, &web, e);
    if (!rc)
        rc = server_plan(sv, stores_first(sv->stores), &plan, e);
    if (!rc)
        server_fit_descriptors(sv);
    if (!rc)
        rc = services_open(&sv->services, &sv->cfg, &plan, sv->own ? sv->own->routes : ROUTES,
                           sv->own ? sv->own->n : ROUTES_COUNT, e);
    if (!rc) {
        sv->services.own = sv->own ? sv->own->data : NULL;
        sv->services.web = web;
        stores_give(sv->stores, &sv->services);
    } else {
        static_free(&web);
    }
    return rc;
}

/* An allocation has failed. */
static void server_on_short(void *user, size_t bytes)
{
    services_make_room(user, 2 * bytes);
}

void server_keep_memory(struct server *sv, double now_s)
{
    static const double every_s = 0.25;
    struct services *s = &sv->services;
    const size_t budget = s->plan.budget;
    if (now_s - sv->looked_s < every_s)
        return;
    sv->looked_s = now_s;
    struct view_stream_counts streams;
    view_stream_count(s->view_streams, &streams);
    const uint64_t open = streams.streams + streams.encoders;
    const bool fewer = open < sv->streams; /* each held megabytes, which malloc keeps */
    sv->streams = open;
    if (!fewer && services_held_bytes(s) <= budget)
        return;
    mem_give_back();
    const size_t held = services_held_bytes(s);
    if (held > budget)
        services_make_room(s, held - budget);
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

/* Of stores at addresses. What was read of them is kept beside what was made of them. */
static enum err_code server_set_remote(const struct server_config *cfg, struct err *e)
{
    char dir[FILE_PATH_MAX];
    enum err_code rc = cfg->cache_dir ? file_join(dir, cfg->cache_dir, "stores", e) : ERR_OK;
    blocks_configure(cfg->cache_dir && !rc ? dir : NULL, (uint64_t)cfg->cache_dir_mb << 20);
    remote_patience(cfg->deadline_s);
    return rc;
}

static enum err_code server_begin(const struct server_config *cfg, const char *const *paths,
                                  size_t n, const struct server_own *own, struct server **out,
                                  struct err *e)
{
    struct server *sv = mem_array(1, sizeof *sv);
    *out = sv;
    if (!sv)
        return err_set(e, ERR_MEM, "serve: out of memory");
    mem_return_large();
    signal(SIGPIPE,
           SIG_IGN); /* a client that hangs up is an error of write(), not of the program */
    sv->cfg = *cfg;
    sv->own = own;
    pthread_mutex_init(&sv->keep, NULL);
    pool_cond_init(&sv->keep_changed);
    sv->workers = cfg->workers ? (size_t)cfg->workers : pool_cores();
    struct services *s = &sv->services;
    enum err_code rc = log_start(e);
    if (!rc)
        rc = server_set_remote(cfg, e);
    if (!rc)
        rc = server_open_services(sv, paths, n, false, e);
    if (!rc)
        mem_on_short(server_on_short, s);
    s->reload = own ? NULL : server_reload_said;
    s->reload_user = sv;
    if (!rc && cfg->cache_dir)
        rc = disk_open(cfg->cache_dir, (uint64_t)cfg->cache_dir_mb << 20, &s->disk, e);
    if (!rc && cfg->state_dir)
        rc = named_appearance_open(cfg->state_dir, &s->named_appearances, e);
    if (!rc)
        rc = http_open(s, HTTP_PUBLIC, &sv->http, e);
    if (!rc && cfg->admin)
        rc = http_open(s, HTTP_ADMIN, &sv->admin, e);
    if (!rc) {
        server_set_url(sv);
        rc = server_start_jobs(sv, e);
    }
    if (!rc)
        rc = self_test(s, e);
    if (!rc)
        rc = http_start(sv->http, e);
    if (!rc && sv->admin)
        rc = http_start(sv->admin, e);
    if (!rc && !own) {
        atomic_store(&s->metrics.reload_well, true); /* no reload has failed yet */
        atomic_store(&s->metrics.reload_good_s, (uint64_t)time(NULL));
        log_info("serve", "%s", sv->memory);
        server_log_disk(sv);
    }
    if (!rc)
        rc = stores_start(sv->stores, e);
    if (!rc && !own)
        rc = pool_start(server_keep_main, sv, &sv->keeper, e);
    if (rc)
        server_stop(out);
    return rc;
}

enum err_code server_start(const struct server_config *cfg, const char *const *paths, size_t n,
                           struct server **out, struct err *e)
{
    return server_begin(cfg, paths, n, NULL, out, e);
}

enum err_code server_start_own(const struct server_config *cfg, const struct server_own *own,
                               struct server **out, struct err *e)
{
    return server_begin(cfg, NULL, 0, own, out, e);
}

size_t server_count(struct server *sv)
{
    struct catalog *c = services_catalog(&sv->services);
    const size_t n = c->n_current;
    catalog_drop(&c);
    return n;
}

const char *server_url(const struct server *sv)
{
    return sv->url;
}

struct services *server_services(struct server *sv)
{
    return &sv->services;
}

/* Who may read what. It comes first and by itself: a token is revoked at once, whatever the stores
 * are like. */
static enum err_code server_reload_auth(struct server *sv, struct err *e)
{
    struct auth *a = NULL;
    if (!sv->cfg.auth)
        return ERR_OK;
    enum err_code rc = auth_open(sv->cfg.auth, &a, e);
    if (rc)
        return rc;
    services_set_auth(&sv->services, &a);
    struct auth *now = services_auth(&sv->services);
    const bool same = auth_is_same(a, now);
    auth_close(&a);
    if (!same) {
        view_stream_recheck(sv->services.view_streams, now);
        log_info("serve", "tokens, keys and signatures are those of %s as it is now", sv->cfg.auth);
    }
    auth_close(&now);
    return ERR_OK;
}

/* How the last reload went, for supervisor, /readyz, metrics and whoever asked for it. */
static void server_tell_reload(struct server *sv, enum err_code rc, bool stores_alone,
                               const struct err *e)
{
    struct services *s = &sv->services;
    char status[sizeof e->msg + 32];
    atomic_store(&s->metrics.reload_well, !rc);
    if (!rc)
        atomic_store(&s->metrics.reload_good_s, (uint64_t)time(NULL));
    else
        atomic_fetch_add(&s->metrics.reload_failed, 1);
    services_set_catalog(s, NULL, rc && !stores_alone ? e->msg : "");
    if (rc)
        log_error("serve", "reload failed%s: %s",
                  stores_alone ? ", what could be opened is served" : ", the old data stay",
                  e->msg);
    else
        log_info("serve", "reloaded");
    snprintf(status, sizeof status, rc ? "reload failed: %s" : "serving", e->msg);
    for (char *p = status; *p; p++) /* a line of the protocol */
        *p = (unsigned char)*p < 0x20 ? ' ' : *p;
    supervisor_ready(status);
}

static enum err_code server_reload_all(struct server *sv, bool *tried, struct err *e)
{
    struct services *s = &sv->services;
    struct tls_pair *pair = NULL;
    *tried = false;
    supervisor_reloading();
    enum err_code rc = server_reload_auth(sv, e);
    if (!rc && s->tls)
        rc = tls_read(s->tls, &pair, e);
    if (!rc) {
        rc = stores_reload(sv->stores, tried, e);
        server_check_descriptors(sv);
    }
    if (s->tls && (!rc || *tried))
        tls_use(s->tls, &pair);
    tls_discard(&pair);
    server_tell_reload(sv, rc, *tried, e);
    return rc;
}

/* The number of a reload that has not begun yet. */
static uint64_t server_want(struct server *sv)
{
    pthread_mutex_lock(&sv->keep);
    const uint64_t number = sv->wanted = sv->begun + 1;
    pthread_cond_broadcast(&sv->keep_changed);
    pthread_mutex_unlock(&sv->keep);
    return number;
}

void server_ask_reload(struct server *sv)
{
    (void)server_want(sv);
}

/* Waits for a reload that begins from now on. */
static enum err_code server_reload_wait(struct server *sv, bool *tried, struct err *e)
{
    const uint64_t number = server_want(sv);
    enum err_code rc = ERR_OK;
    pthread_mutex_lock(&sv->keep);
    while (sv->ended < number && !sv->stopping)
        pthread_cond_wait(&sv->keep_changed, &sv->keep);
    *tried = sv->ended >= number && sv->tried;
    if (sv->ended < number)
        rc = err_set(e, ERR_BUSY, "the server is stopping");
    else if (sv->reload_rc)
        rc = err_set(e, sv->reload_rc, "%s", sv->reload_why.msg);
    pthread_mutex_unlock(&sv->keep);
    return rc;
}

enum err_code server_reload(struct server *sv, struct err *e)
{
    bool tried;
    return server_reload_wait(sv, &tried, e);
}

/* services.reload: the same, and what there is to say about it. */
static enum err_code server_reload_said(void *user, struct body **out, struct err *e)
{
    struct server *sv = user;
    struct services *s = &sv->services;
    struct err why = {0};
    struct catalog *before = services_catalog(s);
    bool tried;
    const enum err_code rc = server_reload_wait(sv, &tried, &why);
    struct catalog *now = services_catalog(s);
    json_t *o = tried ? catalog_changes(before, now) : json_object();
    catalog_drop(&now);
    catalog_drop(&before);
    json_object_set_new(o, "status", json_string(rc ? "failed" : "reloaded"));
    if (rc)
        json_object_set_new(o, "why", json_string(why.msg));
    const enum err_code made = document_make(o, out, e);
    return made ? made : rc;
}

/* A store that was found replaced is opened again at once, but not more often than it is asked:
 * what is there now may be no store. */
void server_look(struct server *sv, double now_s)
{
    const double ask_s = 2, every_s = sv->cfg.remote_refresh_s;
    struct services *s = &sv->services;
    struct catalog *c = services_catalog(s);
    const bool asks = every_s > 0 && now_s - sv->asked_s >= every_s;
    bool replaced = false;
    for (size_t i = 0; i < c->n_current; i++) {
        struct err e = {0};
        struct dataset *d = c->ds[i];
        if (asks && !store_replaced(d->index) && store_ask(d->stores[0], ask_s, &e) &&
            e.code != ERR_DATA)
            log_warn("serve", "not known whether ds=%s is as it was: %s", d->meta.name, e.msg);
        replaced |= store_replaced(d->index);
    }
    catalog_drop(&c);
    if (asks)
        sv->asked_s = now_s;
    if (!replaced || now_s < sv->look_s)
        return;
    sv->look_s = now_s + fmax(every_s, ask_s);
    log_info("serve", "a store was replaced at its server: it is opened again");
    atomic_store(&s->reload_asked, true);
}

void server_expire(struct server *sv, double now_s)
{
    stores_tick(sv->stores, now_s);
}

/* ---- the thread that looks at stores ---- */

static void server_keep_reload(struct server *sv)
{
    struct err why = {0};
    bool tried = false;
    const enum err_code rc = server_reload_all(sv, &tried, &why);
    pthread_mutex_lock(&sv->keep);
    sv->ended = sv->begun;
    sv->tried = tried;
    sv->reload_rc = rc;
    sv->reload_why = why;
    pthread_cond_broadcast(&sv->keep_changed);
    pthread_mutex_unlock(&sv->keep);
}

static void server_keep_tick(struct server *sv)
{
    server_look(sv, clock_s());
    server_expire(sv, clock_s());
    if (server_reload_asked(sv))
        server_ask_reload(sv);
}

static void server_keep_main(void *user)
{
    static const double every_s = 0.1, seldom_s = 60;
    struct server *sv = user;
    pthread_mutex_lock(&sv->keep);
    while (!sv->stopping) {
        const bool reload = sv->wanted > sv->begun, ticks = sv->ticks;
        sv->begun += reload;
        pthread_mutex_unlock(&sv->keep);
        if (reload)
            server_keep_reload(sv);
        if (ticks)
            server_keep_tick(sv);
        pthread_mutex_lock(&sv->keep);
        if (!sv->stopping && sv->wanted == sv->begun && sv->ticks == ticks)
            (void)pool_cond_wait(&sv->keep_changed, &sv->keep,
                                 clock_s() + (ticks ? every_s : seldom_s));
    }
    sv->kept = true;
    pthread_cond_broadcast(&sv->keep_changed);
    pthread_mutex_unlock(&sv->keep);
}

void server_keep(struct server *sv)
{
    pthread_mutex_lock(&sv->keep);
    sv->ticks = true;
    pthread_cond_broadcast(&sv->keep_changed);
    pthread_mutex_unlock(&sv->keep);
}

/* Has it begin no reload, and those go on who wait for one. */
static void server_stop_keeper(struct server *sv)
{
    pthread_mutex_lock(&sv->keep);
    sv->stopping = true;
    pthread_cond_broadcast(&sv->keep_changed);
    pthread_mutex_unlock(&sv->keep);
}

/* False: it does not return from a call, such as opening a file of a server that is away. */
static bool server_end_keeper(struct server *sv)
{
    static const double patience_s = 5;
    if (!sv->keeper)
        return true;
    pthread_mutex_lock(&sv->keep);
    for (const double end_s = clock_s() + patience_s; !sv->kept && clock_s() < end_s;)
        (void)pool_cond_wait(&sv->keep_changed, &sv->keep, end_s);
    const bool kept = sv->kept;
    pthread_mutex_unlock(&sv->keep);
    if (kept)
        pool_join(&sv->keeper);
    return kept;
}

bool server_stop(struct server **out)
{
    struct server *sv = *out;
    *out = NULL;
    if (!sv)
        return true;
    mem_on_short(NULL, NULL);
    server_stop_keeper(sv);
    http_close(&sv->http);
    http_close(&sv->admin); /* last: it says how the stopping goes */
    bool ended = server_end_keeper(sv);
    if (ended) {
        stores_close(&sv->stores);
        ended = services_free(&sv->services);
    }
    if (!ended)
        log_error("serve", "a thread does not return from a call; it is left behind");
    log_stop(1);
    if (ended) {
        view_stream_close(&sv->services.view_streams);
        pthread_cond_destroy(&sv->keep_changed);
        pthread_mutex_destroy(&sv->keep);
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
    sv.workers = cfg->workers ? (size_t)cfg->workers : pool_cores();
    enum err_code rc = server_set_remote(cfg, e);
    if (!rc)
        rc = server_open_services(&sv, paths, n, true, e);
    const struct catalog *c = s->catalog;
    if (!rc && c->n_absent)
        rc = err_set(e, c->absent[0].code, "%s", c->absent[0].why);
    if (!rc)
        rc = http_check(cfg, e);
    if (!rc && cfg->cache_dir)
        rc = disk_check(cfg->cache_dir, e);
    if (!rc && cfg->state_dir)
        rc = named_appearance_check(cfg->state_dir, e);
    for (size_t i = 0; !rc && out && i < c->n; i++)
        fprintf(out, "dataset %s revision %s, %zu tiles: %s\n", c->ds[i]->meta.name,
                c->ds[i]->meta.revision, c->ds[i]->n_tiles, store_path(c->ds[i]->index));
    if (!rc && out && s->tls) {
        char text[256];
        tls_about(s->tls, text, sizeof text);
        fprintf(out, "TLS: %s\n", text);
    }
    if (!rc && out)
        fprintf(out, "%s\nviewer: %zu files\nwell\n", sv.memory, s->web.n);
    (void)services_free(s);
    stores_close(&sv.stores);
    return rc;
}
