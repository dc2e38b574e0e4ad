/* Dispatch: a request to the family that answers it, and a job's end to its answer. route_answer
 * does not block, does not know libmicrohttpd, and cannot fail, since a failure is an answer too.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/route.h"

#include <stdio.h>
#include <string.h>
#include <time.h>

#include "server/answer.h"

/* Routes below a dataset. */
static void route_data(struct services *s, const struct request *r, struct dataset *d,
                       const struct target *t, struct response *out)
{
    if (t->route == ROUTE_TILE)
        answer_tile(s, r, d, t, out);
    else if (t->route == ROUTE_VIEW)
        answer_view(s, r, d, t, out);
    else if (t->route == ROUTE_RENDER)
        answer_render(s, r, d, out);
    else if (t->route == ROUTE_KEPT)
        answer_kept(s, r, d, t, out);
    else if (t->route == ROUTE_MOTION)
        answer_motion(s, r, d, t, out);
    else if (!answer_dataset(s, r, d, t, out) && !answer_map(s, r, d, t, out) &&
             !answer_query(s, r, d, t, out) && !answer_appearance(s, r, d, t, out))
        response_problem(out, 404, "there is nothing at this path");
}

static bool route_changes(const struct request *r)
{
    return r->method == METHOD_PUT || r->method == METHOD_DELETE;
}

static const char *route_allow_text(unsigned allow)
{
    return allow & ALLOW_CHANGE                 ? "GET, HEAD, PUT, DELETE, OPTIONS"
           : allow == ALLOW_POST                ? "POST, OPTIONS"
           : allow == (ALLOW_READ | ALLOW_POST) ? "GET, HEAD, POST, OPTIONS"
                                                : "GET, HEAD, OPTIONS";
}

/* True when the method is answered here: a preflight, or one the route does not take. */
static bool route_method(const struct request *r, unsigned allow, struct response *out)
{
    bool read = r->method == METHOD_GET || r->method == METHOD_HEAD;
    const bool change = route_changes(r);
    if ((read && (allow & ALLOW_READ)) || (r->method == METHOD_POST && (allow & ALLOW_POST)) ||
        (change && (allow & ALLOW_CHANGE)))
        return false;
    if (r->method == METHOD_OPTIONS) {
        out->status = 204;
        out->cache_control = RESPONSE_NO_STORE;
    } else {
        response_problem(out, 405,
                         change && out->route == ROUTE_KEPT
                             ? "nothing is kept: the server was started without --state-dir"
                             : "the method is not one of those in Allow");
    }
    out->allow = route_allow_text(allow);
    return true;
}

/* What operators ask is answered by their listener, where there is one, and nothing else is
 * there. */
static bool route_is_here(const struct services *s, const struct request *r, enum route route)
{
    bool both = route == ROUTE_HEALTH || route == ROUTE_READY || route == ROUTE_VERSION;
    if (r->admin)
        return both || route == ROUTE_METRICS || route == ROUTE_RELOAD || route == ROUTE_KEPT;
    return route != ROUTE_RELOAD && !(route == ROUTE_METRICS && s->cfg->admin);
}

static bool route_is_drawn(enum route route)
{
    static const enum route drawn[] = {ROUTE_VIEW,    ROUTE_VIEW_MOVING, ROUTE_RENDER,
                                       ROUTE_MOTION,  ROUTE_PICK,        ROUTE_PROFILE,
                                       ROUTE_MEASURE, ROUTE_VISIBLE,     ROUTE_HEIGHT};
    for (size_t i = 0; i < sizeof drawn / sizeof *drawn; i++)
        if (drawn[i] == route)
            return true;
    return false;
}

/* May who asks have this? Else the problem is set, the same for datasets that there are and are
 * not. */
static bool route_may(const struct services *s, const struct request *r, const struct target *t,
                      struct response *out)
{
    if (!s->auth)
        return true;
    size_t n = t->path_size + (r->target_size > t->path_size);
    const struct auth_request a = {r->authorization, r->target, r->target + n, t->path_size,
                                   r->target_size - n};
    switch (auth_check(s->auth, route_is_drawn(t->route) ? AUTH_RENDER : AUTH_READ, t->ds, &a,
                       (int64_t)time(NULL))) {
    case AUTH_OK:
        return true;
    case AUTH_UNKNOWN:
        out->unauthorized = true;
        response_problem(out, 401,
                         "this dataset is for those who send a token or a signed address");
        break;
    case AUTH_EXPIRED:
        response_problem(out, 403, "the time of this signed address is over");
        break;
    default:
        response_problem(out, 403, "the token or the signature does not open this");
    }
    return false;
}

static const char *route_tag_header(const struct server_config *cfg)
{
    static const char *const names[] = {"Surrogate-Key", "xkey", "Cache-Tag", NULL};
    return names[cfg->tag_header];
}

/* What an operator says about caches of this dataset, and its tag where there is none yet. */
static void route_cached(const struct services *s, const struct dataset *d, const struct target *t,
                         struct response *out)
{
    bool shared = !s->auth || auth_is_public(s->auth, d->meta.name);
    out->cache_control = cache_policy_of(&s->policy, d->meta.name, shared, out->cache_control);
    out->tag_header = route_tag_header(s->cfg);
    if (!out->surrogate[0] && out->status < 400)
        snprintf(out->surrogate, sizeof out->surrogate, "ds-%s", d->meta.name);
    if (t->kept[0] && out->status < 400)
        snprintf(out->surrogate + strlen(out->surrogate),
                 sizeof out->surrogate - strlen(out->surrogate), " a-%s", t->kept);
}

void route_answer(struct services *s, const struct request *r, struct response *out)
{
    struct err e = {0};
    struct target t;
    memset(out, 0, sizeof *out);
    out->queue_s = out->run_s = -1;
    out->route = ROUTE_NONE;
    out->id = r->id;
    out->id_sent = r->id_sent;
    enum err_code rc = target_parse(r->target, r->target_size, &t, &e);
    if (rc != ERR_FORMAT) {
        out->instance = r->target;
        out->n_instance = t.path_size;
    }
    bool found = t.route != ROUTE_STATIC || static_find(&s->web, r->target, t.path_size);
    found = found && route_is_here(s, r, t.route);
    if (!rc && !found)
        rc = err_set(&e, ERR_NOENT, "there is nothing at this path");
    out->route = found ? t.route : ROUTE_NONE;
    if (rc) {
        response_problem(out, rc == ERR_NOENT ? 404 : rc == ERR_DATA ? 422 : 400, e.msg);
        return;
    }
    unsigned allow = target_allow(t.route);
    if (!s->kept)
        allow &= ~(unsigned)ALLOW_CHANGE;
    if (route_method(r, allow, out) || answer_service(s, r, &t, out))
        return;
    if (!r->admin && !route_changes(r) && !route_may(s, r, &t, out))
        return; /* whether it may be changed says answer_kept.c */
    struct catalog *c = services_catalog(s);
    struct dataset *d = catalog_find(c, t.ds, t.rev);
    if (d) {
        if (t.route == ROUTE_KEPT || answer_resolve(s, d, &t, out))
            route_data(s, r, d, &t, out);
        route_cached(s, d, &t, out);
    } else if (catalog_find(c, t.ds, "")) {
        response_problem(out, 404, "this server does not have this revision, or not any more");
        out->cache_control = RESPONSE_NO_STORE; /* a reload may bring it */
    } else {
        response_problem(out, 404, "no dataset has this name");
    }
    catalog_drop(&c);
}

/* A name that is new is described, and Location is that of the request, whose last part is the
 * name; else all is said by the status. */
static void route_finish_change(struct body *b, struct response *out)
{
    char name[TARGET_KEPT_MAX];
    size_t n = 0;
    while (n < out->n_instance && out->instance[out->n_instance - n - 1] != '/')
        n++;
    snprintf(name, sizeof name, "%.*s", (int)n, out->instance + out->n_instance - n);
    out->body = b;
    out->data = b->data;
    out->size = b->size;
    memcpy(out->etag, b->etag, sizeof out->etag);
    out->status = b->size ? 201 : 204;
    out->type = b->size ? RESPONSE_JSON : NULL;
    out->location = b->size ? mem_text(name) : NULL;
}

void route_finish(struct services *s, const struct request *r, struct job_result *result,
                  struct response *out)
{
    out->queue_s = result->queue_s;
    out->run_s = result->run_s;
    out->cache = result->coalesced ? "shared" : out->cache;
    out->work = NULL; /* the job owned it */
    struct body *b = result->body;
    result->body = NULL;
    if (result->end == JOB_OK && out->kind == WORK_KEEP) {
        route_finish_change(b, out);
        return;
    }
    if (result->end == JOB_OK) {
        if (out->unnamed) {
            out->body = b;
            out->data = b->data;
            out->size = b->size;
        } else {
            response_body(r, b, out);
        }
        return;
    }
    body_drop(&b);
    enum job_class cls = out->cls;
    bool soon = result->end != JOB_ERROR || result->code == ERR_MEM || result->code == ERR_BUSY;
    if (result->end == JOB_ERROR && out->kind == WORK_KEEP) {
        const int status = answer_kept_status(result->code);
        response_problem(out, status,
                         status == 500 ? "the change could not be written; the log says why"
                                       : result->msg);
        out->retry_after_s = status == 503 ? 1 : 0;
    } else if (soon || result->code == ERR_DEVICE) {
        response_problem(out,
                         result->end == JOB_TIMEOUT                             ? 504
                         : result->end == JOB_LIMITED                           ? 429
                         : result->code == ERR_LIMIT && result->end == JOB_SHED ? 429
                                                                                : 503,
                         result->msg);
        out->retry_after_s = result->retry_s ? result->retry_s : job_retry_after(s->jobs, cls);
    } else if (result->code == ERR_DATA &&
               out->kind == WORK_QUERY) { /* a question without an answer */
        response_problem(out, 422, result->msg);
    } else if (result->code == ERR_NOENT) {
        response_problem(out, 404, result->msg);
    } else {
        char text[80]; /* the message names files and is in the log */
        if (out->tile_of[0])
            response_tile_problem(out, result->code == ERR_FORMAT);
        else {
            snprintf(text, sizeof text, "the %s could not be made; the log says why",
                     work_noun(out->kind));
            response_problem(out, 500, text);
        }
    }
}
