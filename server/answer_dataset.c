/* Answers about a dataset except tiles and pictures: its documents, tilesets, prefetch lists, and
 * redirects of addresses without a revision.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answer_appearance.h"

#include <stdio.h>
#include <string.h>

#include "lod/tileset.h"
#include "server/answer.h"
#include "server/collection.h"
#include "server/encode.h"
#include "server/link.h"
#include "server/origin.h"
#include "server/result_id.h"
#include "server/right.h"
#include "server/target_query.h"

void answer_dataset_seed(struct services *s, const struct request *r, struct dataset *d,
                         const struct target *t, struct response *out)
{
    struct form form = encode_form(s->cfg, &d->meta, &t->form);
    struct appearance_choice choice;
    if (!answer_appearance_find_tile(s, d, t->appearance, &choice, out))
        return;
    form.trained = choice.trained;
    struct hash128 id = result_id_seed(d, t, form);
    out->type = "application/x-ndjson";
    struct work *w =
        response_made(s, r, id, out) ? response_work(d, WORK_SEED, id, form, out) : NULL;
    if (!w)
        return;
    w->target = *t;
    w->appearance = choice;
}

/* The plain one is made when a dataset is opened; one that asks for its tiles with a query is a
 * job, and so are the parts of large ones. */
static void answer_dataset_entry(struct services *s, const struct request *r, struct dataset *d,
                                 const struct target *t, const struct key *part,
                                 struct response *out)
{
    char query[TARGET_QUERY_MAX];
    struct appearance_choice choice;
    const bool moving = !t->rev[0];
    target_query_tiles(t, query);
    out->type = RESPONSE_JSON;
    if (!moving)
        snprintf(out->surrogate, sizeof out->surrogate, "ds-%s rev-%s", d->meta.name,
                 d->meta.revision);
    if (!part && right_is_public(r, d->meta.name))
        hint_tileset(d, t, out->hints);
    if (!query[0] && !part) {
        response_body(r, body_ref(moving ? d->tileset_moving : d->tileset), out);
        return;
    }
    struct hash128 id = result_id_tileset(d, t, part);
    if (!answer_appearance_find_tile(s, d, t->appearance, &choice, out) ||
        !response_made(s, r, id, out))
        return;
    struct work *w = response_work(d, WORK_TILESET, id, (struct form){0}, out);
    if (!w)
        return;
    w->target = *t;
    if (part) {
        w->part = true;
        w->key = *part;
    }
}

void answer_dataset_tileset(struct services *s, const struct request *r, struct dataset *d,
                            const struct target *t, struct response *out)
{
    answer_dataset_entry(s, r, d, t, NULL, out);
}

void answer_dataset_tileset_moving(struct services *s, const struct request *r, struct dataset *d,
                                   const struct target *t, struct response *out)
{
    answer_dataset_entry(s, r, d, t, NULL, out);
}

void answer_dataset_tileset_part(struct services *s, const struct request *r, struct dataset *d,
                                 const struct target *t, struct response *out)
{
    if (tileset_has_part(d->index, t->key))
        answer_dataset_entry(s, r, d, t, &t->key, out);
    else
        response_problem(out, 404, "no part of the tileset begins at this tile");
}

/* ---- addresses without a revision ---- */

/* 307 to the same thing in the current revision and edition, relative, so that it works below any
 * prefix. */
static void answer_dataset_moving(struct services *s, const struct request *r,
                                  const struct dataset *d, const struct target *t, enum edition of,
                                  struct response *out)
{
    char edition[9];
    const char *rest = link_below_dataset(r->target), *end = r->target + t->path_size;
    const struct link l = link_to(LINK_DATASET, NULL, d, edition);
    struct buf b = {0};
    response_edition(s, d, of, edition);
    for (const char *p = rest; p < end; p++)
        if (*p == '/')
            buf_printf(&b, "../");
    link_revision(&l, &b);
    buf_printf(&b, "%s", rest); /* with its query */
    if (b.failed || !(out->location = mem_text((const char *)b.data)))
        response_no_memory(out);
    else
        out->status = 307;
    buf_free(&b);
}

void answer_dataset_moving_tile(struct services *s, const struct request *r, struct dataset *d,
                                const struct target *t, struct response *out)
{
    answer_dataset_moving(s, r, d, t, EDITION_TILES, out);
}

void answer_dataset_moving_picture(struct services *s, const struct request *r, struct dataset *d,
                                   const struct target *t, struct response *out)
{
    answer_dataset_moving(s, r, d, t, EDITION_PICTURES, out);
}

/* ---- documents ---- */

void answer_dataset_collection(struct services *s, const struct request *r, struct dataset *d,
                               const struct target *t, struct response *out)
{
    struct body *b = NULL;
    struct origin_places at;
    (void)t;
    if (!r->seal) {
        response_document(r, RESPONSE_JSON, body_ref(d->collection), out);
        return;
    }
    origin_read(s, r, &at); /* what is absolute in it must lie below the seal */
    const struct collection_options collection = {at.public_url, at.base_path, s->cfg->basemap,
                                                  s->cfg->basemap_attribution};
    if (collection_describe(d, &collection, &b, NULL))
        response_no_memory(out);
    else
        response_document(r, RESPONSE_JSON, b, out);
}

void answer_dataset_tilejson(struct services *s, const struct request *r, struct dataset *d,
                             const struct target *t, struct response *out)
{
    struct origin_places at;
    (void)t;
    origin_read(s, r, &at); /* behind a seal, what is absolute in it must lie below the seal */
    const char *url = at.public_url && *at.public_url ? at.public_url : NULL;
    struct hash128 id = result_id_tilejson(d, url);
    out->type = RESPONSE_JSON;
    if (!response_made(s, r, id, out))
        return;
    struct work *w = response_work(d, WORK_TILEJSON, id, (struct form){0}, out);
    if (w && url && !(w->public_url = mem_text(url)))
        response_no_memory(out);
}
