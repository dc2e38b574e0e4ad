/* What is below a dataset beside tiles and pictures: its documents, tilesets, prefetch lists, and
 * the redirects of addresses without a revision.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answer.h"

#include <stdio.h>
#include <string.h>

#include "server/encode.h"
#include "server/result_id.h"

static void answer_dataset_seed(struct services *s, const struct request *r, struct dataset *d,
                                const struct target *t, struct response *out)
{
    struct form form = encode_form(s->cfg, &d->meta, &t->form);
    struct appearance_choice choice;
    if (!answer_find_tile_appearance(d, t->appearance, &choice, out))
        return;
    form.trained = choice.trained;
    struct hash128 id = result_id_seed(d, t, form);
    out->type = "application/x-ndjson";
    out->cache_control = RESPONSE_MOVING;
    if (!response_made(s, r, id, out))
        return;
    struct work *w = response_work(d, WORK_SEED, id, form, out);
    if (w) {
        w->target = *t;
        w->appearance = choice;
    }
    out->cls = JOB_TILE;
    out->timeout_s = s->cfg->deadline_s;
}

/* The plain one is made when a dataset is opened; one that asks for its tiles with a query is a
 * job. */
static void answer_dataset_tileset(struct services *s, const struct request *r, struct dataset *d,
                                   const struct target *t, struct response *out)
{
    char query[TARGET_QUERY_MAX];
    struct appearance_choice choice;
    bool moving = t->route == ROUTE_TILESET_MOVING;
    target_query(t, query);
    out->type = RESPONSE_JSON;
    out->cache_control = moving ? RESPONSE_MOVING : response_cache_control(s, d, t);
    if (!moving)
        snprintf(out->surrogate, sizeof out->surrogate, "ds-%s rev-%s", d->meta.name,
                 d->meta.revision);
    if (!query[0]) {
        response_body(r, body_ref(moving ? d->tileset_moving : d->tileset), out);
        return;
    }
    struct hash128 id = result_id_tileset(d, t);
    if (!answer_find_tile_appearance(d, t->appearance, &choice, out) ||
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
        answer_dataset_tileset(s, r, d, t, out);
        return true;
    case ROUTE_TILE_MOVING:
    case ROUTE_VIEW_MOVING:
    case ROUTE_MAP_MOVING:
    case ROUTE_TERRAIN_MOVING:
        answer_dataset_moving(s, r, d, t, out);
        return true;
    case ROUTE_SEED:
        answer_dataset_seed(s, r, d, t, out);
        return true;
    default:
        return false;
    }
}
