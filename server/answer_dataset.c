/* What is below a dataset beside tiles and pictures: its documents, tilesets, prefetch lists, and
 * the redirects of addresses without a revision.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answer.h"

#include <stdio.h>
#include <string.h>

#include "lod/tileset.h"
#include "server/encode.h"
#include "server/result_id.h"

/* What a camera needs on its way; *out NULL where the target names none. False, with the problem
 * set, where it makes no sense. */
static bool answer_dataset_course(const struct target *t, struct course **out, struct response *res)
{
    struct err e = {0};
    *out = NULL;
    if (!t->course.path)
        return true;
    if (!(*out = mem_array(1, sizeof **out))) {
        response_no_memory(res);
        return false;
    }
    enum err_code rc = course_read(&t->course, *out, &e);
    if (!rc)
        return true;
    mem_free(*out);
    *out = NULL;
    response_problem(res, rc == ERR_DATA ? 422 : 400, e.msg);
    return false;
}

static void answer_dataset_seed(struct services *s, const struct request *r, struct dataset *d,
                                const struct target *t, struct response *out)
{
    struct form form = encode_form(s->cfg, &d->meta, &t->form);
    struct appearance_choice choice;
    struct course *c = NULL;
    if (!answer_find_tile_appearance(s, d, t->appearance, &choice, out) ||
        !answer_dataset_course(t, &c, out))
        return;
    form.trained = choice.trained;
    struct hash128 id = result_id_seed(d, t, c, form);
    out->type = "application/x-ndjson";
    out->cache_control = t->route == ROUTE_SEED ? response_cache_control(s, d, t) : RESPONSE_MOVING;
    struct work *w =
        response_made(s, r, id, out) ? response_work(d, WORK_SEED, id, form, out) : NULL;
    if (!w) {
        mem_free(c);
        return;
    }
    w->target = *t;
    w->target.course.path = NULL; /* borrowed */
    w->appearance = choice;
    w->course = c;
    out->cls = JOB_TILE;
    out->timeout_s = s->cfg->deadline_s;
}

/* The plain one is made when a dataset is opened; one that asks for its tiles with a query is a
 * job, and so are the parts of large ones. */
static void answer_dataset_tileset(struct services *s, const struct request *r, struct dataset *d,
                                   const struct target *t, struct response *out)
{
    char query[TARGET_QUERY_MAX];
    struct appearance_choice choice;
    bool moving = t->route == ROUTE_TILESET_MOVING, part = t->route == ROUTE_TILESET_PART;
    if (part && !tileset_has_part(d->index, t->key)) {
        response_problem(out, 404, "no part of the tileset begins at this tile");
        return;
    }
    target_query(t, query);
    out->type = RESPONSE_JSON;
    out->cache_control = moving ? RESPONSE_MOVING : response_cache_control(s, d, t);
    if (!moving)
        snprintf(out->surrogate, sizeof out->surrogate, "ds-%s rev-%s", d->meta.name,
                 d->meta.revision);
    if (!part && (!s->auth || auth_is_public(s->auth, d->meta.name)))
        hint_tileset(d, t, out->hints);
    if (!query[0] && !part) {
        response_body(r, body_ref(moving ? d->tileset_moving : d->tileset), out);
        return;
    }
    struct hash128 id = result_id_tileset(d, t);
    if (!answer_find_tile_appearance(s, d, t->appearance, &choice, out) ||
        !response_made(s, r, id, out))
        return;
    struct work *w = response_work(d, WORK_TILESET, id, (struct form){0}, out);
    if (w)
        w->target = *t;
    out->cls = JOB_TILE;
    out->timeout_s = s->cfg->deadline_s;
}

/* 307 to the same thing in the current revision and edition, relative, so that it works below any
 * prefix. */
static void answer_dataset_moving(struct services *s, const struct request *r,
                                  const struct dataset *d, const struct target *t,
                                  struct response *out)
{
    char edition[9];
    const char *word = t->route == ROUTE_TILE_MOVING      ? "/t/"
                       : t->route == ROUTE_MAP_MOVING     ? "/map/"
                       : t->route == ROUTE_TERRAIN_MOVING ? "/terrain/"
                                                          : "/static/";
    const char *up = t->route == ROUTE_VIEW_MOVING ? "../../" : "../../../";
    struct buf b = {0};
    size_t at = strlen("/d/") + strlen(t->ds) + strlen(word);
    response_edition(s, d, t->route, edition);
    buf_printf(&b, "%sr/%s%s%s%s%.*s", up, d->meta.revision, *edition ? "-" : "", edition, word,
               (int)(r->target_size - at), r->target + at); /* with its query */
    if (b.failed || !(out->location = mem_text((const char *)b.data)))
        response_problem(out, 503, "out of memory");
    else
        out->status = 307;
    out->cache_control = out->status == 307 ? RESPONSE_MOVING : RESPONSE_NO_STORE;
    buf_free(&b);
}

bool answer_dataset(struct services *s, const struct request *r, struct dataset *d,
                    const struct target *t, struct response *out)
{
    switch (t->route) {
    case ROUTE_COLLECTION:
        response_document(r, RESPONSE_JSON, RESPONSE_MOVING, body_ref(d->collection), out);
        return true;
    case ROUTE_TILEJSON:
        response_document(r, RESPONSE_JSON, RESPONSE_MOVING, body_ref(d->tilejson), out);
        return true;
    case ROUTE_TILESET_MOVING:
    case ROUTE_TILESET:
    case ROUTE_TILESET_PART:
        answer_dataset_tileset(s, r, d, t, out);
        return true;
    case ROUTE_TILE_MOVING:
    case ROUTE_VIEW_MOVING:
    case ROUTE_MAP_MOVING:
    case ROUTE_TERRAIN_MOVING:
        answer_dataset_moving(s, r, d, t, out);
        return true;
    case ROUTE_SEED:
    case ROUTE_SEED_MOVING:
        answer_dataset_seed(s, r, d, t, out);
        return true;
    default:
        return false;
    }
}
