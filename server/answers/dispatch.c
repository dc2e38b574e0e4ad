/* From a request to the function of its row, and from the end of a job to its answer. Here the
 * properties of a row are applied for all routes: listener, methods, rights, caching, queue.
 * dispatch_answer does not block, does not know libmicrohttpd, and cannot fail: a failure is an
 * answer, too.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answers/dispatch.h"

#include <stdio.h>
#include <string.h>
#include <time.h>

#include "server/access/permissions.h"
#include "server/answers/answer_appearance.h"
#include "server/answers/origin.h"
#include "server/base/condition.h"
#include "server/documents/problem_page.h"

static bool dispatch_changes(const struct request *r)
{
    return r->method == METHOD_PUT || r->method == METHOD_DELETE;
}

/* NULL, with the answer set: a preflight, or a method that the route does not take. */
static const struct route_method *dispatch_method(const struct services *s, const struct request *r,
                                                  const struct route *route, struct response *out)
{
    const struct route_method *on = route_on(route, r->method);
    const bool unkept =
        route->scope & SCOPE_STATE && dispatch_changes(r) && on && !s->named_appearances;
    if (on && !unkept)
        return on;
    if (r->method == METHOD_OPTIONS) {
        out->status = 204;
        out->cache_control = RESPONSE_NO_STORE;
    } else {
        response_problem(out, 405,
                         unkept ? "nothing is kept: the server was started without --state-dir"
                                : "the method is not one of those in Allow");
    }
    out->allow = route_allow(route, s->named_appearances);
    return NULL;
}

/* Is it on the listener that the request came to? */
static bool dispatch_is_here(const struct services *s, const struct request *r,
                             const struct target *t)
{
    const unsigned scope = t->route->scope;
    if (scope & SCOPE_FILE && !static_find(&s->web, r->target, t->path_size))
        return false;
    return r->admin ? scope & SCOPE_OPERATORS
                    : scope & SCOPE_PUBLIC && !(scope & SCOPE_MOVES && s->cfg->admin);
}

/* May who asks have this? Else the problem is set, the same for datasets that there are and are
 * not. */
static bool dispatch_may(const struct request *r, enum auth_answer answer, struct response *out)
{
    switch (answer) {
    case AUTH_OK:
        return true;
    case AUTH_UNKNOWN:
        out->unauthorized = true;
        response_problem(out, 401,
                         r->cookie ? "this dataset is for those who send a token or a signed "
                                     "address; a session has ended, or there was none"
                                   : "this dataset is for those who send a token or a signed "
                                     "address");
        break;
    case AUTH_EXPIRED:
        response_problem(out, 403, "the time of this signed address is over");
        break;
    case AUTH_LONG:
        response_problem(out, 403, "this signed address holds for longer than this server allows");
        break;
    default:
        response_problem(out, 403, "the token or the signature does not open this");
    }
    return false;
}

static const char *dispatch_tag_header(const struct server_config *cfg)
{
    static const char *const names[] = {"Surrogate-Key", "xkey", "Cache-Tag", NULL};
    return names[cfg->tag_header];
}

/* What an operator and --auth let caches keep of the dataset that was asked for. */
static const char *dispatch_policy(const struct services *s, const struct request *r,
                                   const struct target *t, const char *usual)
{
    return cache_policy_of(&s->policy, t->names.ds, permissions_is_public(r, t->names.ds), usual);
}

/* That for an answer, and the dataset's tag where there is none yet. */
static void dispatch_cached(const struct services *s, const struct request *r,
                            const struct dataset *d, const struct target *t, struct response *out)
{
    out->cache_control = dispatch_policy(s, r, t, out->cache_control);
    out->tag_header = dispatch_tag_header(s->cfg);
    if (!out->surrogate[0] && out->status < 400)
        snprintf(out->surrogate, sizeof out->surrogate, "ds-%s", d->meta.name);
    if (t->names.kept[0] && out->status < 400)
        snprintf(out->surrogate + strlen(out->surrogate),
                 sizeof out->surrogate - strlen(out->surrogate), " a-%s", t->names.kept);
}

/* The queue of what takes a job. */
static enum job_class dispatch_queue(const struct request *r, enum route_rate rate)
{
    switch (rate) {
    case RATE_TILES:
        return r->prefetch ? JOB_PREFETCH : JOB_TILE;
    case RATE_VIEWS:
        return r->prefetch && r->method == METHOD_GET ? JOB_AHEAD : JOB_VIEW;
    case RATE_MAPS:
        return JOB_MAP;
    case RATE_THUMBNAILS:
        return JOB_PREFETCH;
    default:
        return JOB_TILE;
    }
}

static void dispatch_dataset(struct services *s, const struct request *r,
                             const struct route_method *on, struct target *t, struct response *out)
{
    struct catalog *c = services_catalog(s);
    struct dataset *d = catalog_find(c, t->names.ds, t->names.rev);
    if (d) {
        out->cache_missing = dispatch_policy(s, r, t, RESPONSE_SHORT);
        if (answer_appearance_resolve(s, d, t, out)) {
            out->cache_control = response_cache_control(s, d, t);
            on->answer(s, r, d, t, out);
        }
        dispatch_cached(s, r, d, t, out);
    } else if (catalog_find(c, t->names.ds, "")) {
        response_problem(out, 404, "this server does not have this revision, or not any more");
        out->cache_control = RESPONSE_NO_STORE; /* a reload may bring it */
    } else {
        response_problem(out, 404, "no dataset has this name");
        if (!permissions_is_public(r, t->names.ds)) /* who has no token is not to learn it */
            out->cache_control = RESPONSE_NO_STORE;
    }
    catalog_drop(&c);
}

/* A signed address is a seal and another path, which it opens: what counts from here on is that
 * path. False, with the answer set, where the seal does not hold. */
static bool dispatch_unseal(struct request *r, const struct target *t, struct response *out)
{
    const struct text seal = target_of_signed(t)->seal.text;
    const size_t n_seal = (size_t)(seal.end - seal.p), n = (size_t)(seal.end - r->target);
    if (!dispatch_may(r, auth_check_seal(r->auth, seal.p, n_seal, (int64_t)time(NULL)), out))
        return false;
    if (n == t->path_size) { /* relative addresses would not lie below it */
        struct buf b = {0};
        buf_printf(&b, "%.*s/", (int)n_seal, seal.p);
        buf_u8(&b, 0);
        out->status = 308;
        out->cache_control = RESPONSE_NO_STORE;
        out->location = b.failed ? NULL : mem_text((const char *)b.data);
        buf_free(&b);
        return false;
    }
    r->seal = seal.p;
    r->n_seal = n_seal;
    r->prefix = r->target;
    r->n_prefix = n;
    r->target += n;
    r->target_size -= n;
    out->secret = true;
    return true;
}

/* False, with the answer set, where the target is none. */
static bool dispatch_read(const struct services *s, struct request *r, union target_any *any,
                          struct response *out)
{
    struct err e = {0};
    const struct target *t = &any->all;
    enum err_code rc = router_read(s->routes, r->target, r->target_size, any, &e);
    if (!rc && t->route->scope & SCOPE_SIGNED && r->auth && !r->admin && !r->seal)
        return dispatch_unseal(r, t, out) && dispatch_read(s, r, any, out);
    if (rc != ERR_FORMAT && !(!rc && t->route->scope & SCOPE_SIGNED)) {
        out->instance = r->target;
        out->n_instance = t->path_size;
    }
    if (!rc && !dispatch_is_here(s, r, t))
        rc = err_set(&e, ERR_NOENT, "there is nothing at this path");
    if (rc)
        response_problem(out, rc == ERR_NOENT ? 404 : rc == ERR_DATA ? 422 : 400, e.msg);
    return !rc;
}

static void dispatch_route(struct services *s, struct request *r, struct response *out)
{
    union target_any any;
    struct target *t = &any.all;
    if (!dispatch_read(s, r, &any, out))
        return;
    out->route = t->route;
    /* A page that is open in the browser of an operator reaches this listener. */
    if (r->admin && r->from_page) {
        response_problem(out, 403, "the operators' listener answers no pages");
        return;
    }
    if (r->admin && !origin_is_operators(s, r)) {
        response_problem(out, 403,
                         "the operators' listener is not known by this name: ask it by localhost, "
                         "an IP address, the machine's name or the host of --public-url");
        return;
    }
    const struct route_method *on = dispatch_method(s, r, t->route, out);
    if (!on)
        return;
    out->timeout_s = s->cfg->deadline_s;
    out->cls = dispatch_queue(r, t->route->rate);
    if (!(t->route->scope & SCOPE_DATASET)) {
        out->cache_control = t->route->cache == CACHE_NONE ? RESPONSE_NO_STORE : RESPONSE_MOVING;
        on->answer(s, r, NULL, t, out);
    } else if (r->admin || dispatch_changes(r) || /* which answer_named_appearance.c allows */
               dispatch_may(
                   r,
                   permissions_check(r, t, t->route->scope & SCOPE_RENDER ? AUTH_RENDER : AUTH_READ,
                                     t->names.ds),
                   out)) {
        dispatch_dataset(s, r, on, t, out);
    }
}

/* Somebody opened an address in a browser: a problem is a page then. */
static void dispatch_show(const struct services *s, const struct request *r, struct response *out)
{
    struct origin_places at;
    struct body *page;
    const bool reads = r->method == METHOD_GET || r->method == METHOD_HEAD;
    if (out->status < 400 || r->admin || !reads || !out->body || !condition_html(r->accept))
        return;
    origin_read(s, r, &at);
    if (problem_page_make(out->data, out->size, at.public_url ? at.public_url : at.base_path, &page,
                          NULL))
        return;
    body_drop(&out->body);
    out->body = page;
    out->data = page->data;
    out->size = page->size;
    out->type = "text/html; charset=utf-8";
}

void dispatch_answer(struct services *s, const struct request *r, struct response *out)
{
    struct request own = *r;
    own.auth = services_auth(s);
    memset(out, 0, sizeof *out);
    out->queue_s = out->run_s = -1;
    out->id = r->id;
    out->id_sent = r->id_sent;
    out->same_origin = r->admin;
    dispatch_route(s, &own, out);
    dispatch_show(s, &own, out);
    auth_close(&own.auth);
}

/* What may be told of a failure: a message with a path is for the log. */
static const char *dispatch_says(const struct job_result *r)
{
    return r->code == ERR_MEM    ? "out of memory"
           : strchr(r->msg, '/') ? "it could not be made now; the server's log says why"
                                 : r->msg;
}

/* Why there is no result. */
static void dispatch_failed(struct services *s, const struct job_result *result,
                            struct response *out)
{
    const enum job_class cls = out->cls;
    const bool soon = result->end != JOB_ERROR || result->code == ERR_MEM ||
                      result->code == ERR_BUSY || result->code == ERR_DEVICE;
    char text[80]; /* the message names files and is in the log */
    if (soon) {
        response_problem(out,
                         result->end == JOB_TIMEOUT                             ? 504
                         : result->end == JOB_LIMITED                           ? 429
                         : result->code == ERR_LIMIT && result->end == JOB_SHED ? 429
                                                                                : 503,
                         dispatch_says(result));
        const int wait_s = out->kind->traits & WORK_DRAWN ? services_drawing_wait_s(s) : 0;
        out->retry_after_s = result->retry_s ? result->retry_s : job_retry_after(s->jobs, cls);
        out->retry_after_s = out->retry_after_s > wait_s ? out->retry_after_s : wait_s;
    } else if (result->code == ERR_DATA && out->kind->traits & WORK_JUDGES) {
        response_problem(out, 422, result->msg); /* a question without an answer */
    } else if (result->code == ERR_NOENT) {
        response_problem(out, 404, result->msg);
    } else if (out->tile_of[0]) {
        response_tile_problem(out, result->code == ERR_FORMAT);
    } else {
        snprintf(text, sizeof text, "the %s could not be made; the log says why", out->kind->noun);
        response_problem(out, 500, text);
    }
}

void dispatch_finish(struct services *s, const struct request *r, struct job_result *result,
                     struct response *out)
{
    out->queue_s = result->queue_s;
    out->run_s = result->run_s;
    out->cache = result->coalesced ? "shared" : out->cache;
    out->work = NULL; /* the job owned it */
    if (out->kind->finish) {
        out->kind->finish(result, out);
        return;
    }
    struct body *b = result->body;
    result->body = NULL;
    if (result->end == JOB_OK && out->unnamed) {
        out->body = b;
        out->data = b->data;
        out->size = b->size;
    } else if (result->end == JOB_OK) {
        response_body(r, b, out);
    } else {
        body_drop(&b);
        dispatch_failed(s, result, out);
        dispatch_show(s, r, out);
    }
}
