/* The services that answers use, and their lifetime. Many threads read them at once: everything
 * here is immutable after services_open, has its own lock, or is atomic. Only the catalog pointer
 * changes (by a reload), under catalog_lock.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answers/services.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "server/documents/api_page.h"
#include "server/documents/collection.h"
#include "server/documents/openapi.h"
#include "server/documents/service_document.h"

/* Bytes of an option in MB, or the share of the plan. */
static size_t services_share(int64_t mb, size_t share)
{
    enum { UNPLANNED_MB = 512 };
    return mb ? (size_t)mb << 20 : share ? share : (size_t)UNPLANNED_MB << 20;
}

enum err_code services_open(struct services *s, const struct server_config *cfg,
                            const struct memory_plan *plan, const struct route *routes, size_t n,
                            struct err *e)
{
    memset(s, 0, sizeof *s);
    s->cfg = cfg;
    if (plan)
        s->plan = *plan;
    s->start_s = clock_s();
    enum { TOKEN_MIN = 16 };
    if (strcmp(cfg->metrics, "local") != 0 && strcmp(cfg->metrics, "public") != 0 &&
        strlen(cfg->metrics) < TOKEN_MIN) {
        s->cfg = NULL;
        return err_set(
            e, ERR_ARG,
            "--metrics %s: neither local nor public, and too short for a token, which has "
            "%d characters or more",
            cfg->metrics, TOKEN_MIN);
    }
    enum { SIGN_IN_TRIES = 10, SIGN_IN_S = 60 };
    pthread_mutex_init(&s->catalog_lock, NULL);
    pthread_mutex_init(&s->sign_in_lock, NULL);
    enum err_code rc = rate_open((double)SIGN_IN_TRIES / SIGN_IN_S, SIGN_IN_S, &s->sign_in, e);
    if (!rc)
        rc = router_open(routes, n, &s->routes, e);
    if (!rc)
        rc = metrics_open(&s->metrics, n, e);
    if (!rc)
        rc = cache_open(services_share(cfg->cache_mb, s->plan.cache), &s->cache, e);
    if (!rc)
        rc = live_bodies_open(services_share(cfg->inflight_mb, s->plan.inflight), &s->live_bodies,
                              e);
    if (!rc && cfg->access_log)
        rc = access_log_open((enum access_format)cfg->access_format, &s->access, e);
    if (!rc)
        rc = cache_policy_read(cfg->cache_policy, &s->policy, e);
    if (!rc && cfg->auth)
        rc = auth_open(cfg->auth, &s->auth, e);
    if (!rc && (cfg->tls_cert || cfg->tls_key))
        rc = tls_open(cfg->tls_cert, cfg->tls_key, &s->tls, e);
    if (!rc)
        rc = service_document_landing(&s->landing, e);
    if (!rc)
        rc = service_document_conformance(&s->conformance, e);
    if (!rc)
        rc = openapi_describe(s->routes, &s->api, e);
    if (!rc)
        rc = api_page_describe(s->api, &s->api_page, e);
    int64_t now_s = (int64_t)time(NULL); /* they are the program's, which may be another one now */
    if (!rc)
        s->landing->modified_s = s->conformance->modified_s = s->api->modified_s =
            s->api_page->modified_s = now_s;
    if (rc)
        (void)services_free(s);
    return rc;
}

bool services_free(struct services *s)
{
    if (!s->cfg)
        return true;
    if (!job_close(&s->jobs))
        return false;
    picture_close(&s->picture);
    catalog_drop(&s->catalog);
    static_free(&s->web);
    cache_close(&s->cache);
    live_bodies_close(&s->live_bodies);
    disk_close(&s->disk);
    named_appearance_close(&s->named_appearances);
    access_log_close(&s->access);
    auth_close(&s->auth);
    tls_close(&s->tls);
    router_close(&s->routes);
    metrics_free(&s->metrics);
    body_drop(&s->landing);
    body_drop(&s->conformance);
    body_drop(&s->api);
    body_drop(&s->api_page);
    rate_close(&s->sign_in);
    pthread_mutex_destroy(&s->sign_in_lock);
    pthread_mutex_destroy(&s->catalog_lock);
    s->cfg = NULL;
    return true;
}

size_t services_held_bytes(const struct services *s)
{
    return mem_held_bytes(0) + (s->picture ? picture_held_bytes(s->picture) : 0);
}

void services_make_room(struct services *s, size_t bytes)
{
    enum { LEAST = 1 << 20 };
    (void)cache_yield(s->cache, bytes > LEAST ? bytes : LEAST);
    mem_give_back();
}

void services_note_short(struct services *s)
{
    atomic_store(&s->short_ms, (uint64_t)(clock_s() * 1e3));
    atomic_fetch_add(&s->metrics.memory_short, 1);
}

double services_short_s(const struct services *s)
{
    const uint64_t at_ms = atomic_load(&s->short_ms);
    return at_ms ? clock_s() - (double)at_ms * 1e-3 : -1;
}

double services_sign_in(struct services *s, uint64_t client, bool give_back)
{
    double wait_s = 0;
    pthread_mutex_lock(&s->sign_in_lock);
    if (give_back)
        rate_give(s->sign_in, client);
    else
        wait_s = rate_take(s->sign_in, client, clock_s());
    pthread_mutex_unlock(&s->sign_in_lock);
    return wait_s;
}

struct catalog *services_catalog(struct services *s)
{
    pthread_mutex_lock(&s->catalog_lock);
    struct catalog *c = catalog_ref(s->catalog);
    pthread_mutex_unlock(&s->catalog_lock);
    return c;
}

struct body *services_document(const struct services *s, struct dataset *d,
                               enum dataset_document which)
{
    const struct server_config *cfg = s->cfg;
    const struct collection_options o = {cfg->public_url, (size_t)cfg->city_gaussians};
    return catalog_document(d, which, &o);
}

struct auth *services_auth(struct services *s)
{
    pthread_mutex_lock(&s->catalog_lock);
    struct auth *a = auth_ref(s->auth);
    pthread_mutex_unlock(&s->catalog_lock);
    return a;
}

void services_set_auth(struct services *s, struct auth **a)
{
    pthread_mutex_lock(&s->catalog_lock);
    struct auth *was = s->auth;
    s->auth = *a;
    *a = was;
    pthread_mutex_unlock(&s->catalog_lock);
}

void services_set_catalog(struct services *s, struct catalog *c, const char *reload_error)
{
    pthread_mutex_lock(&s->catalog_lock);
    struct catalog *was = c ? s->catalog : NULL;
    s->catalog = c ? c : s->catalog;
    if (reload_error)
        snprintf(s->reload_error, sizeof s->reload_error, "%s", reload_error);
    pthread_mutex_unlock(&s->catalog_lock);
    catalog_drop(&was);
}

int services_drawing_wait_s(struct services *s)
{
    struct worker_status st = {0};
    if (s->picture)
        picture_status(s->picture, &st);
    return st.state == WORKER_OFF || st.wait_s > 0 ? (int)fmax(1, ceil(st.wait_s)) : 0;
}

double services_failing_s(struct services *s)
{
    struct worker_status st = {0};
    if (s->picture)
        picture_status(s->picture, &st);
    return st.failing_s;
}
