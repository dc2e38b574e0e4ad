/* Appearances: the list, one of them, a posted mix; the network and the photographs for clients
 * that compute colours; and what a request says about an appearance.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answer.h"

#include <stdio.h>

#include "server/appearance_model.h"
#include "server/result_id.h"

static void answer_appearance_problem(const struct dataset *d, enum err_code rc,
                                      const struct err *e, struct response *out)
{
    int status = rc == ERR_NOENT ? 404 : rc == ERR_MEM ? 503 : 400;
    response_problem(out, status,
                     d->appearance ? e->msg
                                   : "this dataset was trained without appearance: it has one "
                                     "appearance, leave `appearance` out");
}

bool answer_find_tile_appearance(struct services *s, const struct dataset *d, const char *text,
                                 struct appearance_choice *out, struct response *res)
{
    struct err e = {0};
    char is[TARGET_APPEARANCE_MAX], name[TARGET_KEPT_MAX];
    struct kept_table *kept = *text ? kept_now(s->kept) : NULL;
    snprintf(is, sizeof is, "%s", text);
    enum err_code rc = appearance_api_resolve(d, kept, is, name, &e);
    if (!rc)
        rc = appearance_api_find(d, is, out, &e);
    if (rc)
        answer_appearance_problem(d, rc, &e, res);
    kept_drop(&kept);
    return !rc;
}

bool answer_find_appearance(struct services *s, const struct dataset *d, const char *text,
                            struct appearance_choice *out, struct response *res)
{
    if (!answer_find_tile_appearance(s, d, text, out, res))
        return false;
    if (out->trained)
        response_problem(res, 400, "a picture has an appearance; \"none\" is of tiles");
    return !out->trained;
}

static void answer_appearance_one(const struct request *r, struct dataset *d, const char *text,
                                  const char *cache_control, struct response *out)
{
    struct err e = {0};
    struct body *b = NULL;
    enum err_code rc = appearance_api_describe(d, text, &b, &e);
    if (!rc)
        response_document(r, RESPONSE_JSON, cache_control, b, out);
    else
        answer_appearance_problem(d, rc, &e, out);
}

static void answer_appearance_mix(struct services *s, const struct request *r, struct dataset *d,
                                  struct response *out)
{
    struct err e = {0};
    char text[TARGET_APPEARANCE_MAX], name[TARGET_KEPT_MAX];
    struct kept_table *kept = kept_now(s->kept);
    enum err_code rc = appearance_api_read_mix(d, r->body, r->body_size, text, &e);
    if (!rc)
        rc = appearance_api_resolve(d, kept, text, name, &e);
    kept_drop(&kept);
    if (!rc)
        answer_appearance_one(r, d, text, RESPONSE_NO_STORE, out);
    else
        response_problem(out,
                         rc == ERR_MEM     ? 503
                         : rc == ERR_NOENT ? 404
                         : rc == ERR_DATA  ? 422
                                           : 400,
                         e.msg);
}

/* A document of a revision; b NULL: the dataset has no appearance. */
static void answer_appearance_document(struct services *s, const struct request *r,
                                       struct dataset *d, const struct target *t, struct body *b,
                                       struct response *out)
{
    if (!b) {
        response_problem(out, 404, "this dataset was trained without appearance");
        return;
    }
    snprintf(out->surrogate, sizeof out->surrogate, "ds-%s rev-%s", d->meta.name, d->meta.revision);
    response_document(r, RESPONSE_JSON, response_cache_control(s, d, t), body_ref(b), out);
}

static void answer_appearance_thumbnail(struct services *s, const struct request *r,
                                        struct dataset *d, const struct target *t,
                                        struct response *out)
{
    const char *name = appearance_model_photograph(d, t->row);
    if (!name) {
        response_problem(out, 404, "no photograph has this number");
        return;
    }
    struct hash128 id = result_id_thumbnail(d, name);
    out->type = target_type(FORMAT_JPG);
    out->cache_control = RESPONSE_IMMUTABLE; /* its bytes are the store's own */
    snprintf(out->surrogate, sizeof out->surrogate, "ds-%s rev-%s", d->meta.name, d->meta.revision);
    if (!response_made(s, r, id, out))
        return;
    struct work *w = response_work(d, WORK_THUMBNAIL, id, (struct form){.format = FORMAT_JPG}, out);
    if (w)
        w->target = *t;
    out->cls = JOB_PREFETCH;
    out->timeout_s = s->cfg->deadline_s;
}

/* What the query looks for; without one the list of all, which is made when a dataset is opened,
 * and again when names are kept or forgotten. */
static void answer_appearance_list(struct services *s, const struct request *r, struct dataset *d,
                                   const struct target *t, struct response *out)
{
    const struct kept_row *row = NULL;
    struct kept_table *kept = kept_now(s->kept);
    const size_t n_kept = d->appearance ? kept_of(kept, d->meta.name, &row) : 0;
    out->type = RESPONSE_JSON;
    out->cache_control = RESPONSE_MOVING;
    if (!t->search.asked && !n_kept) {
        response_body(r, body_ref(d->appearances), out);
    } else if (!d->search) {
        response_problem(out, 404, "this dataset was trained without appearance");
    } else {
        struct hash128 id = result_id_search(d, t, kept_hash(kept, d->meta.name));
        struct work *w = response_made(s, r, id, out)
                             ? response_work(d, WORK_SEARCH, id, (struct form){0}, out)
                             : NULL;
        if (w) {
            w->target = *t;
            w->kept = kept_ref(kept);
        }
        out->cls = JOB_TILE;
        out->timeout_s = s->cfg->deadline_s;
    }
    kept_drop(&kept);
}

bool answer_appearance(struct services *s, const struct request *r, struct dataset *d,
                       const struct target *t, struct response *out)
{
    if (t->route == ROUTE_MODEL)
        answer_appearance_document(s, r, d, t, d->model, out);
    else if (t->route == ROUTE_PHOTOGRAPHS)
        answer_appearance_document(s, r, d, t, d->photographs, out);
    else if (t->route == ROUTE_THUMBNAIL)
        answer_appearance_thumbnail(s, r, d, t, out);
    else if (t->route == ROUTE_APPEARANCES)
        answer_appearance_list(s, r, d, t, out);
    else if (t->route == ROUTE_APPEARANCE)
        answer_appearance_one(r, d, t->appearance, RESPONSE_MOVING, out);
    else if (t->route == ROUTE_MIX)
        answer_appearance_mix(s, r, d, out);
    else
        return false;
    return true;
}
