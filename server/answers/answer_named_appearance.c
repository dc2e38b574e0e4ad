/* Appearances under names: PUT keeps one, DELETE forgets it, GET says what it stands for; and a
 * name wherever an appearance is asked for. A change waits for the disk, so a job makes it.
 *
 * A name may stand for something else tomorrow: an address that says one is cached for a minute,
 * and documents hand out what it stands for, which is as immutable as ever. Its tag is a-NAME.
 *
 * Changes come from the operators' listener, or with a token that may write (decision 036).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>
#include <string.h>

#include "server/access/permissions.h"
#include "server/answers/answer.h"

/* ---- the work ---- */

struct answer_named_appearance_own {
    bool removes;
    struct named_appearance_row row; /* to remove a name: only ds and name are set */
    char *match, *none_match;        /* owned; NULL: absent */
};

static void answer_named_appearance_free(void *own)
{
    struct answer_named_appearance_own *o = own;
    mem_free(o->match);
    mem_free(o->none_match);
}

/* Keep a name or forget one. What is kept is described to whoever kept it; empty is the body of a
 * name that was there before, or is no more. */
static enum err_code answer_named_appearance_act(struct services *s, const struct work *w,
                                                 struct body **out, struct err *e)
{
    const struct answer_named_appearance_own *o = work_own(w);
    const struct named_appearance_condition when = {o->match, o->none_match};
    struct buf none = {0};
    char etag[BODY_ETAG_SIZE] = "";
    bool created = false;
    enum err_code rc =
        o->removes ? named_appearance_remove(s->named_appearances, o->row.ds, o->row.name, &when, e)
                   : named_appearance_put(s->named_appearances, &o->row, &when, &created, e);
    if (rc && rc != ERR_DATA && rc != ERR_NOENT)
        log_error("serve", "%s of ds=%s is not %s: %s", o->row.name, o->row.ds,
                  o->removes ? "forgotten" : "kept", e->msg);
    if (rc)
        return rc;
    log_info("serve", "appearance %s of ds=%s is %s", o->row.name, o->row.ds,
             o->removes ? "forgotten" : "kept");
    if (!o->removes)
        named_appearance_etag(&o->row, etag);
    if (created)
        rc = appearance_api_describe_kept(w->ds, &o->row, out, e);
    else
        *out = body_take(&none, etag);
    if (!rc && !*out)
        rc = err_set(e, ERR_MEM, "out of memory for the answer");
    return rc;
}

static int answer_named_appearance_status(enum err_code rc)
{
    return rc == ERR_DATA    ? 412
           : rc == ERR_NOENT ? 404
           : rc == ERR_LIMIT ? 507
           : rc == ERR_MEM   ? 503
           : rc == ERR_BUSY  ? 503
                             : 500;
}

/* A name that is new is described, and Location is that of the request, whose last part is the
 * name; else all is said by the status. */
static void answer_named_appearance_done(struct body *b, struct response *out)
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

static void answer_named_appearance_finish(struct job_result *result, struct response *out)
{
    struct body *b = result->body;
    result->body = NULL;
    if (result->end == JOB_OK) {
        answer_named_appearance_done(b, out);
        return;
    }
    body_drop(&b);
    const int status = answer_named_appearance_status(result->code);
    response_problem(out, status, result->msg);
    out->retry_after_s = status == 503 ? 1 : 0;
}

static const struct work_kind answer_named_appearance_work = {
    .noun = "change",
    .size = sizeof(struct answer_named_appearance_own),
    .act = answer_named_appearance_act,
    .free = answer_named_appearance_free,
    .finish = answer_named_appearance_finish};

/* ---- the answers ---- */

/* May whoever asks change names? Else the problem is set. */
static bool answer_named_appearance_may(struct services *s, const struct request *r,
                                        const struct target *t, struct response *out)
{
    (void)s;
    if (!r->admin && !r->auth)
        response_problem(out, 403,
                         "names are kept and forgotten on the operators' listener (--admin), or "
                         "with a token whose scope is write:NAME (--auth)");
    else if (r->admin)
        return true;
    else
        switch (permissions_check(r, t, AUTH_WRITE, t->names.ds)) {
        case AUTH_OK:
            return true;
        case AUTH_UNKNOWN:
            out->unauthorized = true;
            response_problem(out, 401, "names are kept and forgotten by those who send a token");
            break;
        default:
            response_problem(out, 403, "the token may not keep or forget names of this dataset");
        }
    return false;
}

static char *answer_named_appearance_copy(const char *header, bool *failed)
{
    char *text = header ? mem_text(header) : NULL;
    *failed |= header && !text;
    return text;
}

/* A job that makes the change. Its name is its own: equal changes are not one. */
static void answer_named_appearance_ask(struct services *s, const struct request *r,
                                        struct dataset *d, const struct named_appearance_row *row,
                                        struct response *out)
{
    static _Atomic uint64_t asked;
    const uint64_t name[2] = {atomic_fetch_add(&asked, 1), (uint64_t)(uintptr_t)s};
    bool failed = false;
    out->unnamed = true;
    out->cache_control = RESPONSE_NO_STORE;
    struct answer_named_appearance_own *c =
        response_work(d, &answer_named_appearance_work, hash_bytes(name, sizeof name), out);
    if (!c)
        return;
    c->removes = r->method == METHOD_DELETE;
    c->row = *row;
    c->match = answer_named_appearance_copy(r->if_match, &failed);
    c->none_match = answer_named_appearance_copy(r->if_none_match, &failed);
    if (failed)
        response_no_memory(out);
}

void answer_named_appearance_read(struct services *s, const struct request *r, struct dataset *d,
                                  const struct target *t, struct response *out)
{
    struct err e = {0};
    struct body *b = NULL;
    struct named_appearance_table *kept = named_appearance_now(s->named_appearances);
    const struct named_appearance_row *row =
        named_appearance_find(kept, d->meta.name, t->names.kept);
    if (!row) {
        response_problem(out, 404,
                         s->named_appearances
                             ? "no appearance is kept under this name"
                             : "no appearance is kept: the server was started without "
                               "--state-dir");
    } else if (appearance_api_describe_kept(d, row, &b, &e)) {
        response_no_memory(out);
    } else {
        response_document(r, RESPONSE_JSON, b, out);
    }
    named_appearance_drop(&kept);
}

void answer_named_appearance_change(struct services *s, const struct request *r, struct dataset *d,
                                    const struct target *t, struct response *out)
{
    struct err e = {0};
    struct named_appearance_row row = {0};
    if (!answer_named_appearance_may(s, r, t, out))
        return;
    snprintf(row.ds, sizeof row.ds, "%s", d->meta.name);
    snprintf(row.name, sizeof row.name, "%s", t->names.kept);
    enum err_code rc = ERR_OK;
    if (r->method == METHOD_PUT) {
        struct named_appearance_table *kept = named_appearance_now(s->named_appearances);
        rc = appearance_api_read_kept(d, kept, r->body, r->body_size, &row, &e);
        named_appearance_drop(&kept);
    }
    if (!rc)
        answer_named_appearance_ask(s, r, d, &row, out);
    else if (rc == ERR_ARG)
        response_problem(out, 409, e.msg);
    else
        response_refused(out, rc, e.msg);
}
