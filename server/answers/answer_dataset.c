/* Answers about a dataset except tiles and pictures: its documents, tilesets, prefetch lists, and
 * redirects of addresses without a revision.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answers/answer_appearance.h"

#include <stdio.h>
#include <string.h>

#include "lod/export/clip.h"
#include "lod/export/crop.h"
#include "lod/export/tileset.h"
#include "lod/store/tree.h"
#include "server/access/permissions.h"
#include "server/answers/answer.h"
#include "server/answers/origin.h"
#include "server/data/encode.h"
#include "server/documents/collection.h"
#include "server/documents/link.h"
#include "server/documents/prefetch_list.h"
#include "server/documents/result_id.h"
#include "server/documents/tileset_links.h"
#include "server/documents/use_page.h"
#include "server/http/static.h"
#include "server/route/param_clip.h"
#include "server/route/target_query.h"

/* ---- prefetch lists ---- */

/* What the polygon of a query leaves of the tiles of one document that begins at a tile (`start`),
 * or of all (from the root); mem_free it. NULL where there is no polygon. */
static enum err_code answer_dataset_crop(const struct work *w, const struct target_clip *c,
                                         const struct key *start, bool documents,
                                         struct crop_node **out, struct err *e)
{
    struct store *s = NULL;
    struct clip clip = {0};
    uint32_t first = store_tree(w->ds->index)->root;
    *out = NULL;
    if (!c->n)
        return ERR_OK;
    enum err_code rc = param_clip_open(c, &clip, e);
    if (!rc)
        rc = work_borrow(w, &s, e);
    if (start)
        first = (uint32_t)(store_find(w->ds->index, *start) - w->ds->tiles);
    if (!rc)
        rc = crop_tiles(&clip, s, first, documents, out, e);
    if (!rc && !start && !(*out)[first].any)
        rc = err_set(e, ERR_NOENT, "nothing of this dataset lies within clip");
    if (s)
        dataset_return(w->ds, s);
    clip_free(&clip);
    return rc;
}

/* Of a list of all tiles; polygons differ. */
static double answer_dataset_list_cost(const struct work *w, const struct target_clip *c,
                                       unsigned *variant)
{
    const double row_ms = 2e-3;
    *variant = c->n > 0;
    return 1 + (double)w->ds->n_tiles * row_ms * (c->n ? 1000 : 1);
}

struct answer_dataset_seed_own {
    struct seed_target asked;
    struct form form; /* complete (encode_form) */
    struct appearance_choice appearance;
};

static enum err_code answer_dataset_make_seed(struct services *s, const struct job *j,
                                              const struct work *w, struct buf *out, struct err *e)
{
    const struct answer_dataset_seed_own *o = work_own(w);
    struct crop_node *left;
    (void)j;
    enum err_code rc = answer_dataset_crop(w, &o->asked.tiles.clip, NULL, false, &left, e);
    if (!rc)
        rc = prefetch_list_write(s->cfg, w->ds, &o->asked, left, o->form, &o->appearance, out, e);
    mem_free(left);
    return rc;
}

static size_t answer_dataset_seed_room(const struct work *w)
{
    const struct answer_dataset_seed_own *o = work_own(w);
    return prefetch_list_room(w->ds, &o->asked);
}

static double answer_dataset_seed_cost(const struct work *w, unsigned *variant)
{
    const struct answer_dataset_seed_own *o = work_own(w);
    return answer_dataset_list_cost(w, &o->asked.tiles.clip, variant);
}

static const struct work_kind answer_dataset_seed_work = {
    .noun = "list of tiles",
    .size = sizeof(struct answer_dataset_seed_own),
    .make = answer_dataset_make_seed,
    .room = answer_dataset_seed_room,
    .cost = answer_dataset_seed_cost};

static void answer_dataset_list(struct services *s, const struct request *r, struct dataset *d,
                                const struct seed_target *asked, struct response *out)
{
    struct form form = encode_form(s->cfg, &d->meta, &asked->tiles.form);
    struct appearance_choice choice;
    if (!answer_appearance_find_tile(s, d, asked->tiles.appearance, &choice, out))
        return;
    form.trained = choice.trained;
    struct hash128 id = result_id_seed(d, asked, form);
    out->type = "application/x-ndjson";
    struct answer_dataset_seed_own *own =
        response_made(s, r, id, out) ? response_work(d, &answer_dataset_seed_work, id, out) : NULL;
    if (!own)
        return;
    *own = (struct answer_dataset_seed_own){*asked, form, choice};
    out->work->apart = out->work->may_lack = asked->tiles.clip.n;
}

void answer_dataset_seed(struct services *s, const struct request *r, struct dataset *d,
                         const struct target *t, struct response *out)
{
    answer_dataset_list(s, r, d, target_of_seed(t), out);
}

void answer_dataset_seed_moving(struct services *s, const struct request *r, struct dataset *d,
                                const struct target *t, struct response *out)
{
    const struct seed_moving_target *asked = target_of_seed_moving(t);
    const struct seed_target same = {asked->all, asked->page, asked->zooms, asked->tiles};
    answer_dataset_list(s, r, d, &same, out);
}

/* ---- tilesets ---- */

struct answer_dataset_tileset_own {
    struct target_tiles tiles; /* how it asks for them */
    enum tileset_links_of of;
    struct key key; /* TILESET_LINKS_PART: the document that begins here */
};

/* A tileset whose tiles are all asked for with the same query, or a part of one. */
static enum err_code answer_dataset_make_tileset(struct services *s, const struct job *j,
                                                 const struct work *w, struct buf *out,
                                                 struct err *e)
{
    const struct answer_dataset_tileset_own *o = work_own(w);
    const struct key *part = o->of == TILESET_LINKS_PART ? &o->key : NULL;
    char query[TARGET_QUERY_MAX];
    struct buf text = {0};
    struct tileset_links links;
    struct crop_node *left = NULL;
    (void)s, (void)j;
    target_query_tiles(&o->tiles, query);
    enum err_code rc = tileset_links_make(w->ds, o->of, query, &text, &links, e);
    if (!rc)
        rc = answer_dataset_crop(w, &o->tiles.clip, part, true, &left, e);
    if (!rc)
        rc = tileset_write(w->ds->index, &links, part, left, out, e);
    mem_free(left);
    buf_free(&text);
    return rc;
}

/* Rows repeat the query, which may be longer than all the rest of them. */
static size_t answer_dataset_tileset_room(const struct work *w)
{
    enum { ROW = 768 };
    const struct answer_dataset_tileset_own *o = work_own(w);
    char query[TARGET_QUERY_MAX];
    target_query_tiles(&o->tiles, query);
    return w->ds->n_tiles * (ROW + 2 * strlen(query));
}

static double answer_dataset_tileset_cost(const struct work *w, unsigned *variant)
{
    const struct answer_dataset_tileset_own *o = work_own(w);
    return answer_dataset_list_cost(w, &o->tiles.clip, variant);
}

static const struct work_kind answer_dataset_tileset_work = {
    .noun = "tileset",
    .traits = WORK_COMPRESSED,
    .size = sizeof(struct answer_dataset_tileset_own),
    .make = answer_dataset_make_tileset,
    .room = answer_dataset_tileset_room,
    .cost = answer_dataset_tileset_cost};

/* The plain one is made when a dataset is opened; one that asks for its tiles with a query is a
 * job, and so are the parts of large ones. part: for TILESET_LINKS_PART. */
static void answer_dataset_entry(struct services *s, const struct request *r, struct dataset *d,
                                 const struct target_tiles *tiles, enum tileset_links_of of,
                                 const struct key *part, struct response *out)
{
    char query[TARGET_QUERY_MAX];
    struct appearance_choice choice;
    const bool moving = of == TILESET_LINKS_MOVING;
    target_query_tiles(tiles, query);
    out->type = RESPONSE_JSON;
    if (!moving)
        snprintf(out->surrogate, sizeof out->surrogate, "ds-%s rev-%s", d->meta.name,
                 d->meta.revision);
    if (!part && permissions_is_public(r, d->meta.name))
        link_header_tileset(d, moving, tiles, out->hints);
    if (!query[0] && !part) {
        response_body(r, services_document(s, d, moving ? DATASET_TILESET_MOVING : DATASET_TILESET),
                      out);
        return;
    }
    struct hash128 id = result_id_tileset(d, tiles, moving, part);
    if (!answer_appearance_find_tile(s, d, tiles->appearance, &choice, out) ||
        !response_made(s, r, id, out))
        return;
    struct answer_dataset_tileset_own *own =
        response_work(d, &answer_dataset_tileset_work, id, out);
    if (!own)
        return;
    own->tiles = *tiles;
    own->of = of;
    if (part)
        own->key = *part;
    out->work->apart = out->work->may_lack = tiles->clip.n;
}

void answer_dataset_tileset(struct services *s, const struct request *r, struct dataset *d,
                            const struct target *t, struct response *out)
{
    answer_dataset_entry(s, r, d, &target_of_tileset(t)->tiles, TILESET_LINKS_ENTRY, NULL, out);
}

void answer_dataset_tileset_moving(struct services *s, const struct request *r, struct dataset *d,
                                   const struct target *t, struct response *out)
{
    answer_dataset_entry(s, r, d, &target_of_tileset_moving(t)->tiles, TILESET_LINKS_MOVING, NULL,
                         out);
}

void answer_dataset_tileset_part(struct services *s, const struct request *r, struct dataset *d,
                                 const struct target *t, struct response *out)
{
    const struct tileset_part_target *asked = target_of_tileset_part(t);
    if (tileset_has_part(d->index, asked->cell.key))
        answer_dataset_entry(s, r, d, &asked->tiles, TILESET_LINKS_PART, &asked->cell.key, out);
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
        response_document(r, RESPONSE_JSON, services_document(s, d, DATASET_COLLECTION), out);
        return;
    }
    origin_read(s, r, &at); /* what is absolute in it must lie below the seal */
    const struct collection_options collection = {at.public_url, (size_t)s->cfg->city_gaussians};
    if (collection_describe(d, &collection, &b, NULL))
        response_no_memory(out);
    else
        response_document(r, RESPONSE_JSON, b, out);
}

void answer_dataset_use(struct services *s, const struct request *r, struct dataset *d,
                        const struct target *t, struct response *out)
{
    static const char path[] = "/use.html", module[] = "/viewer.js";
    const struct static_file *page = static_find(&s->web, path, sizeof path - 1);
    const struct static_file *viewer = static_find(&s->web, module, sizeof module - 1);
    struct err e = {0};
    struct body *b = NULL;
    char origin[ORIGIN_MAX], name[40];
    (void)t;
    if (!page || !viewer) {
        response_problem(out, 404,
                         "this server has no viewer, which this page comes with: see "
                         "--web-dir");
        return;
    }
    if (!*origin_or_own(s, r, origin)) {
        response_problem(out, 404,
                         "the address that clients see is not known: start the server "
                         "with --public-url");
        return;
    }
    snprintf(name, sizeof name, "viewer-%s.js", viewer->digest);
    const enum err_code rc = use_page_write(page->body, d, origin, name, &b, &e);
    if (rc)
        response_problem(out, rc == ERR_NOENT ? 404 : 503, e.msg);
    else
        response_document(r, page->type, b, out);
    if (out->status < 400)
        out->vary = origin_vary(s, out->vary ? ORIGIN_ENCODED : ORIGIN_ALONE);
}

struct answer_dataset_tilejson_own {
    char *public_url; /* owned; NULL: its addresses are relative */
};

/* A row a tile: 200 bytes and 2 us each, so it is made when it is asked for. */
static enum err_code answer_dataset_make_tilejson(struct services *s, const struct job *j,
                                                  const struct work *w, struct buf *out,
                                                  struct err *e)
{
    const struct answer_dataset_tilejson_own *o = work_own(w);
    struct buf tile = {0};
    (void)s, (void)j;
    struct link l =
        link_to(LINK_ROOT, o->public_url ? o->public_url : "../..", w->ds, w->ds->edition);
    l.ext = format_ext(FORMAT_GLB);
    link_tile(&l, &tile);
    buf_u8(&tile, 0);
    enum err_code rc = buf_check(&tile, e);
    if (!rc)
        rc = tileset_tilejson(w->ds->index, (const char *)tile.data, out, e);
    buf_free(&tile);
    return rc;
}

static size_t answer_dataset_tilejson_room(const struct work *w)
{
    enum { ROW = 384 };
    const char *footprint = store_footprint(w->ds->index);
    return (footprint ? strlen(footprint) : 0) + w->ds->n_tiles * ROW;
}

static double answer_dataset_tilejson_cost(const struct work *w, unsigned *variant)
{
    const struct target_clip none = {0};
    return answer_dataset_list_cost(w, &none, variant);
}

static void answer_dataset_free_tilejson(void *own)
{
    mem_free(((struct answer_dataset_tilejson_own *)own)->public_url);
}

static const struct work_kind answer_dataset_tilejson_work = {
    .noun = "TileJSON",
    .traits = WORK_COMPRESSED,
    .size = sizeof(struct answer_dataset_tilejson_own),
    .make = answer_dataset_make_tilejson,
    .room = answer_dataset_tilejson_room,
    .cost = answer_dataset_tilejson_cost,
    .free = answer_dataset_free_tilejson};

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
    struct answer_dataset_tilejson_own *own =
        response_work(d, &answer_dataset_tilejson_work, id, out);
    if (own && url && !(own->public_url = mem_text(url)))
        response_no_memory(out);
}
