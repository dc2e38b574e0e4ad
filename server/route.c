/* Dispatch: a request to the family that answers it, and a job's end to its answer. route_answer does
 * not block, does not know libmicrohttpd, and cannot fail, since a failure is an answer too.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/route.h"

#include <stdio.h>
#include <string.h>

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
    else if (!answer_dataset(s, r, d, t, out) && !answer_map(s, r, d, t, out) &&
             !answer_query(s, r, d, t, out) && !answer_appearance(s, r, d, t, out))
        response_problem(out, 404, "there is nothing at this path");
}

static const char *route_allow_text(unsigned allow)
{
    return allow == ALLOW_POST                  ? "POST, OPTIONS"
           : allow == (ALLOW_READ | ALLOW_POST) ? "GET, HEAD, POST, OPTIONS"
                                                : "GET, HEAD, OPTIONS";
}

/* True when the method is answered here: a preflight, or one the route does not take. */
static bool route_method(const struct request *r, unsigned allow, struct response *out)
{
    bool read = r->method == METHOD_GET || r->method == METHOD_HEAD;
    if ((read && (allow & ALLOW_READ)) || (r->method == METHOD_POST && (allow & ALLOW_POST)))
        return false;
    if (r->method == METHOD_OPTIONS) {
        out->status = 204;
        out->cache_control = RESPONSE_NO_STORE;
    } else {
        response_problem(out, 405, "the method is not one of those in Allow");
    }
    out->allow = route_allow_text(allow);
    return true;
}

void route_answer(struct services *s, const struct request *r, struct response *out)
{
    struct err e = {0};
    struct target t;
    memset(out, 0, sizeof *out);
    out->queue_s = out->run_s = -1;
    out->route = ROUTE_NONE;
    enum err_code rc = target_parse(r->target, r->target_size, &t, &e);
    if (rc != ERR_FORMAT) {
        out->instance = r->target;
        out->n_instance = t.path_size;
    }
    bool found = t.route != ROUTE_STATIC || static_find(&s->web, r->target, t.path_size);
    if (!rc && !found)
        rc = err_set(&e, ERR_NOENT, "there is nothing at this path");
    out->route = found ? t.route : ROUTE_NONE;
    if (rc) {
        response_problem(out, rc == ERR_NOENT ? 404 : rc == ERR_DATA ? 422 : 400, e.msg);
        return;
    }
    if (route_method(r, target_allow(t.route), out) || answer_service(s, r, &t, out))
        return;
    struct catalog *c = services_catalog(s);
    struct dataset *d = catalog_find(c, t.ds, t.rev);
    if (d)
        route_data(s, r, d, &t, out);
    else
        response_problem(out, 404,
                         catalog_find(c, t.ds, "") ? "this revision is not served any more"
                                                   : "no dataset has this name");
    catalog_drop(&c);
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
    if (soon || result->code == ERR_DEVICE) {
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
