/* Routes that need no dataset: landing page, files of the viewer, descriptions, health, metrics.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answers/answer.h"

#include <jansson.h>
#include <string.h>
#include <strings.h>

#include "server/access/permissions.h"
#include "server/answers/metrics_text.h"
#include "server/answers/origin.h"
#include "server/base/address.h"
#include "server/base/condition.h"
#include "server/base/document.h"
#include "server/documents/collection.h"
#include "server/documents/link_header.h"
#include "server/documents/social_preview.h"

/* Is who asks told that there is this dataset? */
static bool answer_service_shows(const struct request *r, const struct target *t,
                                 const struct dataset *d)
{
    return r->admin || permissions_check(r, t, AUTH_READ, d->meta.name) == AUTH_OK;
}

static enum err_code answer_service_about(struct services *s, const struct request *r,
                                          const struct target *t, struct body **out, struct err *e)
{
    char about[160] = "off: started with --device none, or with exported files alone";
    static const char *const states[] = {"starting", "ready", "off"};
    const char *state = s->picture ? states[picture_state(s->picture)] : states[PICTURE_OFF];
    if (s->picture)
        picture_about(s->picture, about, sizeof about);
    json_t *revisions = json_object();
    struct catalog *c = services_catalog(s);
    for (size_t i = 0; i < c->n_current; i++)
        if (answer_service_shows(r, t, c->ds[i]))
            json_object_set_new(revisions, c->ds[i]->meta.name,
                                json_string(c->ds[i]->meta.revision));
    catalog_drop(&c);
    return document_make(json_pack("{s:s,s:s,s:o,s:{s:s,s:s}}", "name", "citysplat", "version",
                                   CITYSPLAT_VERSION, "datasets", revisions, "pictures", "state",
                                   state, "device", about),
                         out, e);
}

/* The viewer's page for the scene that this query opens. NULL: none that everybody may read. */
static struct body *answer_service_card(struct services *s, const struct request *r,
                                        const struct catalog *c, const struct body *index,
                                        const char *query, size_t n)
{
    const struct dataset *d = link_header_scene(c, query, n);
    struct body *page = NULL;
    char origin[ORIGIN_MAX];
    if (!d || !permissions_is_public(r, d->meta.name))
        return NULL;
    const bool pictures = s->picture && picture_state(s->picture) != PICTURE_OFF;
    if (social_preview_page(index, d, origin_of(s, r, origin), pictures, &page, NULL))
        body_drop(&page);
    return page;
}

void answer_service_landing(struct services *s, const struct request *r, struct dataset *d,
                            const struct target *t, struct response *out)
{
    (void)d;
    const struct static_file *index = static_find(&s->web, "/index.html", strlen("/index.html"));
    out->vary = "Accept";
    if (!index || !condition_html(r->accept)) {
        response_document(r, RESPONSE_JSON, body_ref(s->landing), out);
        return;
    }
    size_t from = t->path_size < r->target_size ? t->path_size + 1 : r->target_size;
    struct catalog *c = services_catalog(s);
    if (!r->auth) /* hints name datasets, and caches keep the page for whoever comes next */
        link_header_write(c, r->target + from, r->target_size - from, out->hints);
    struct body *page =
        answer_service_card(s, r, c, index->body, r->target + from, r->target_size - from);
    catalog_drop(&c);
    response_document(r, index->type, page ? page : body_ref(index->body), out);
    if (out->status < 400)
        out->vary = origin_vary(s, ORIGIN_ACCEPTED);
}

static const double SHORT_S = 60; /* how long memory that ran out is told */

static bool answer_service_is_local(const struct request *r)
{
    return r->own_host && address_host_is_loopback(r->own_host);
}

/* Who may learn names of files and what a driver says. */
static bool answer_service_is_operator(const struct request *r)
{
    return r->admin || answer_service_is_local(r);
}

/* Datasets whose files do not give all their tiles. */
static void answer_service_damaged(const struct catalog *c, const struct request *r, json_t *o)
{
    json_t *failed = json_object();
    for (size_t i = 0; i < c->n; i++) {
        uint32_t n = atomic_load(&c->ds[i]->n_failed);
        if (n)
            json_object_set_new(failed,
                                r->admin || permissions_is_public(r, c->ds[i]->meta.name)
                                    ? c->ds[i]->meta.name
                                    : "(not public)",
                                json_integer(n));
    }
    if (json_object_size(failed))
        json_object_set_new(o, "failed", failed);
    else
        json_decref(failed);
}

/* Stores that are not served as they are now. */
static void answer_service_absent(const struct catalog *c, const struct request *r, json_t *o)
{
    char text[96];
    if (!c->n_absent)
        return;
    snprintf(text, sizeof text, "%zu not served as they are now; the log says why", c->n_absent);
    if (!answer_service_is_operator(r)) {
        json_object_set_new(o, "stores", json_string(text));
        return;
    }
    json_t *changes = catalog_changes(NULL, c);
    json_object_set(o, "stores", json_object_get(changes, "failed"));
    json_decref(changes);
}

static void answer_service_pictures(const struct services *s, const struct request *r, json_t *o)
{
    struct worker_status drawing = {0};
    char text[WORKER_ABOUT + 96];
    if (s->picture)
        picture_status(s->picture, &drawing);
    if (drawing.state == WORKER_OFF) {
        snprintf(text, sizeof text, "off: %s; tried again in %.0f s",
                 answer_service_is_operator(r) ? drawing.about
                                               : "the device did not start, the log says why",
                 drawing.wait_s);
        json_object_set_new(o, "pictures", json_string(text));
    } else if (drawing.state == WORKER_AGAIN) {
        json_object_set_new(o, "pictures",
                            json_string("the process that draws has ended, and is started again"));
    }
}

static void answer_service_reloaded(struct services *s, const struct request *r, json_t *o)
{
    char why[sizeof s->reload_error];
    pthread_mutex_lock(&s->catalog_lock);
    memcpy(why, s->reload_error, sizeof why);
    pthread_mutex_unlock(&s->catalog_lock);
    if (why[0]) /* it names files */
        json_object_set_new(o, "reload",
                            json_string(answer_service_is_operator(r)
                                            ? why
                                            : "the last reload failed, and the data from before "
                                              "it are served; the log says why"));
}

/* Ready, or degraded, and by what: a store cannot be opened, or does not give all its tiles, a
 * reload failed, pictures are off, or memory ran out. Still 200, because everything else is served,
 * and taking it out would help nobody; but 503 where there is nothing to serve. */
static void answer_service_state(struct services *s, const struct request *r, struct response *out)
{
    struct body *b = NULL;
    json_t *o = json_pack("{s:s}", "status", "ready");
    struct catalog *c = services_catalog(s);
    const bool none = s->reload && !c->n_current;
    answer_service_damaged(c, r, o);
    answer_service_absent(c, r, o);
    catalog_drop(&c);
    answer_service_reloaded(s, r, o);
    answer_service_pictures(s, r, o);
    const double short_s = services_short_s(s);
    if (short_s >= 0 && short_s < SHORT_S)
        json_object_set_new(o, "memory",
                            json_string("answers were refused because memory ran out; nothing is "
                                        "damaged: give --memory less than there is"));
    if (none)
        json_object_set_new(o, "help",
                            json_string("no store is served: add a file NAME.tiles to what serve "
                                        "was started with, and reload"));
    if (json_object_size(o) > 1)
        json_object_set_new(o, "status", json_string(none ? "empty" : "degraded"));
    if (document_make(o, &b, NULL))
        body_drop(&b);
    response_document(r, RESPONSE_JSON, b, out);
    if (none && b)
        out->status = 503;
}

void answer_service_ready(struct services *s, const struct request *r, struct dataset *d,
                          const struct target *t, struct response *out)
{
    (void)d, (void)t;
    if (atomic_load(&s->draining))
        response_problem(out, 503, "the server is stopping");
    else
        answer_service_state(s, r, out);
}

/* Compared in a time that does not depend on where they differ. */
static bool answer_service_token(const char *given, const char *token)
{
    const char *bearer = given && !strncasecmp(given, "Bearer ", 7) ? given + 7 : "";
    size_t n = strlen(token), m = strlen(bearer);
    unsigned differ = n != m;
    for (size_t i = 0; i < m; i++)
        differ |= (unsigned)(bearer[i] ^ token[i % n]);
    return !differ;
}

/* Metrics say who asks for what, and how much: nothing that a proxy's configuration should publish
 * by forgetting about it. */
static bool answer_service_may(const struct services *s, const struct request *r)
{
    const struct server_config *cfg = s->cfg;
    if (r->admin || (r->auth && permissions_check(r, NULL, AUTH_ADMIN, NULL) == AUTH_OK))
        return true;
    if (!strcmp(cfg->metrics, "public"))
        return true;
    if (!strcmp(cfg->metrics, "local"))
        return answer_service_is_local(r);
    return answer_service_token(r->authorization, cfg->metrics);
}

void answer_service_metrics(struct services *s, const struct request *r, struct dataset *d,
                            const struct target *t, struct response *out)
{
    struct buf b = {0};
    (void)d, (void)t;
    if (!answer_service_may(s, r)) {
        response_problem(
            out, 403,
            !strcmp(s->cfg->metrics, "local")
                ? "metrics are for this machine: ask http://127.0.0.1 or http://localhost "
                  "without a proxy, or see --metrics"
                : "metrics are for those who send the token of --metrics as "
                  "Authorization: Bearer TOKEN");
        return;
    }
    struct body *text = metrics_text_write(s, &b, NULL) ? NULL : body_take(&b, NULL);
    buf_free(&b);
    response_document(r, "text/plain; version=0.0.4; charset=utf-8", text, out);
}

void answer_service_version(struct services *s, const struct request *r, struct dataset *d,
                            const struct target *t, struct response *out)
{
    (void)d;
    struct body *b = NULL;
    /* A statement of its own: the order in which arguments of a call are evaluated is open. */
    if (answer_service_about(s, r, t, &b, NULL))
        body_drop(&b);
    response_document(r, RESPONSE_JSON, b, out);
}

/* Does a dataset meet the box that is asked for? One that ends east of where it begins crosses the
 * date line. */
static bool answer_service_meets(const struct dataset *d, const struct target_box *t)
{
    const double west = t->bbox_e7[0] / 1e7, south = t->bbox_e7[1] / 1e7,
                 east = t->bbox_e7[2] / 1e7, north = t->bbox_e7[3] / 1e7;
    bool in_west = d->bbox[3] >= west, in_east = d->bbox[0] <= east;
    return (west <= east ? in_west && in_east : in_west || in_east) && d->bbox[4] >= south &&
           d->bbox[1] <= north &&
           (!t->has_heights || (d->bbox[5] * 1e3 >= (double)t->heights_mm[0] &&
                                d->bbox[2] * 1e3 <= (double)t->heights_mm[1]));
}

void answer_service_collections(struct services *s, const struct request *r, struct dataset *d,
                                const struct target *t, struct response *out)
{
    (void)d;
    const struct target_box *box = &target_of_collections(t)->box;
    struct catalog *c = services_catalog(s);
    struct body *b = NULL;
    if (box->has_bbox || r->auth) {
        struct origin_places at;
        origin_read(s, r, &at);
        const struct collection_options collection = {at.public_url,
                                                      (size_t)s->cfg->city_gaussians};
        struct dataset **ds = mem_array(c->n_current, sizeof *ds);
        size_t n = 0;
        for (size_t i = 0; ds && i < c->n_current; i++)
            if (answer_service_shows(r, t, c->ds[i]) &&
                (!box->has_bbox || answer_service_meets(c->ds[i], box)))
                ds[n++] = c->ds[i];
        if (!ds || collection_list(ds, n, &collection, &b, NULL))
            body_drop(&b);
        else
            b->modified_s = c->collections->modified_s;
        mem_free(ds);
    } else {
        b = body_ref(c->collections);
    }
    if (r->auth) /* others see other datasets */
        out->cache_control = RESPONSE_NO_STORE;
    response_document(r, RESPONSE_JSON, b, out);
    catalog_drop(&c);
}

/* ---- what never changes ---- */

static const char ANSWER_SERVICE_MODULE[] = "/viewer.js";

/* Of a file of which only compressed forms are in memory, for a client that takes none of them: few
 * do, so it is unpacked here, 10 ms for the largest, and kept as results are. */
static struct body *answer_service_plain(struct services *s, const struct static_file *file)
{
    const struct hash128 id = hash_bytes(file->body->etag, strlen(file->body->etag));
    struct body *b = cache_get(s->cache, id, NULL);
    if (!b && (b = static_plain(file)))
        cache_put(s->cache, id, b);
    return b;
}

static void answer_service_send_file(struct services *s, const struct request *r,
                                     const struct static_file *file, bool immutable,
                                     struct response *out)
{
    if (immutable)
        out->cache_control = RESPONSE_IMMUTABLE;
    const struct body *b = file->body;
    const bool there = b->data || (b->brotli && condition_brotli(r->accept_encoding)) ||
                       (b->gzip && condition_gzip(r->accept_encoding));
    response_document(r, file->type, there ? body_ref(file->body) : answer_service_plain(s, file),
                      out);
}

void answer_service_file(struct services *s, const struct request *r, struct dataset *d,
                         const struct target *t, struct response *out)
{
    (void)d;
    const struct static_file *file = static_find(&s->web, r->target, t->path_size);
    answer_service_send_file(s, r, file, file->immutable, out);
    if (!strcmp(file->path, ANSWER_SERVICE_MODULE) && out->status < 300)
        snprintf(out->hints, sizeof out->hints, "<viewer-%s.js>; rel=bookmark", file->digest);
}

/* Pages keep an address for years, and a server has the files of one version: they get that. */
void answer_service_module(struct services *s, const struct request *r, struct dataset *d,
                           const struct target *t, struct response *out)
{
    (void)d;
    const struct static_file *file =
        static_find(&s->web, ANSWER_SERVICE_MODULE, strlen(ANSWER_SERVICE_MODULE));
    if (!file)
        response_problem(out, 404, "this server has no viewer: see --web-dir");
    else if (!strcmp(file->digest, t->names.rev))
        answer_service_send_file(s, r, file, true, out);
    else if ((out->location = mem_text(ANSWER_SERVICE_MODULE + 1)))
        out->status = 307;
    else
        response_no_memory(out);
}

void answer_service_conformance(struct services *s, const struct request *r, struct dataset *d,
                                const struct target *t, struct response *out)
{
    (void)d, (void)t;
    response_document(r, RESPONSE_JSON, body_ref(s->conformance), out);
}

void answer_service_api(struct services *s, const struct request *r, struct dataset *d,
                        const struct target *t, struct response *out)
{
    (void)d, (void)t;
    response_document(r, "application/vnd.oai.openapi+json;version=3.0", body_ref(s->api), out);
}

void answer_service_api_page(struct services *s, const struct request *r, struct dataset *d,
                             const struct target *t, struct response *out)
{
    (void)d, (void)t;
    response_document(r, "text/html; charset=utf-8", body_ref(s->api_page), out);
}

void answer_service_health(struct services *s, const struct request *r, struct dataset *d,
                           const struct target *t, struct response *out)
{
    (void)s, (void)d, (void)t;
    response_document(r, RESPONSE_JSON, body_text("{\"status\":\"ok\"}\n"), out);
}

/* ---- a reload, which waits for disks and servers: so an errand waits for it ---- */

static enum err_code answer_service_reload_act(struct services *s, const struct work *w,
                                               struct body **out, struct err *e)
{
    (void)w;
    atomic_fetch_add(&s->reloads_begun, 1); /* first: who comes from now on gets the next one */
    enum err_code rc = s->reload(s->reload_user, out, e);
    return *out ? ERR_OK : rc; /* it says by itself what failed */
}

/* 200, or 500 where something failed: whoever asked by a script sees it. */
static void answer_service_reload_finish(struct job_result *result, struct response *out)
{
    struct body *b = result->body;
    result->body = NULL;
    if (result->end != JOB_OK) {
        response_problem(out, 503,
                         "the reload was not begun, or is not done yet; the log says how it goes");
        out->retry_after_s = 1;
        return;
    }
    json_t *o = json_loadb((const char *)b->data, b->size, 0, NULL);
    const char *status = json_string_value(json_object_get(o, "status"));
    out->status = status && !strcmp(status, "reloaded") ? 200 : 500;
    json_decref(o);
    out->body = b;
    out->data = b->data;
    out->size = b->size;
    out->type = RESPONSE_JSON;
}

static const struct work_kind answer_service_reload_work = {
    .noun = "reload", .act = answer_service_reload_act, .finish = answer_service_reload_finish};

void answer_service_reload(struct services *s, const struct request *r, struct dataset *d,
                           const struct target *t, struct response *out)
{
    static const double most_s = 600; /* a clip of a large store takes minutes */
    struct {
        char kind[8];
        uint64_t begun; /* those who ask before it begins wait for the same one */
    } name = {.kind = "reload", .begun = atomic_load(&s->reloads_begun)};
    (void)r, (void)t;
    if (!s->reload) {
        response_problem(out, 404, "nothing is reloaded here");
        return;
    }
    out->unnamed = true;
    out->timeout_s = most_s;
    out->cls = JOB_ERRAND;
    out->cache_control = RESPONSE_NO_STORE;
    (void)response_work(d, &answer_service_reload_work, hash_bytes(&name, sizeof name), out);
}
