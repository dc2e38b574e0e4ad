/* Tiles, and the whole city in one file for programs that load no tiles: from memory, or by a job.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answers/answer.h"

#include <assert.h>
#include <stdio.h>
#include <string.h>

#include "codec/splat/part.h"
#include "lod/export/clip.h"
#include "lod/export/crop.h"
#include "lod/store/store.h"
#include "server/access/permissions.h"
#include "server/answers/answer_appearance.h"
#include "server/base/text.h"
#include "server/data/encode.h"
#include "server/documents/result_id.h"
#include "server/route/param_clip.h"

/* What caches purge by. */
static void answer_tile_tags(const struct dataset *d, uint32_t z, char out[RESPONSE_TAGS])
{
    static_assert(sizeof d->meta.name + sizeof d->meta.revision + TEXT_UINT + 16 <= RESPONSE_TAGS,
                  "room for all of it");
    char *p = text_put(text_put(out, "ds-"), d->meta.name);
    p = text_put(text_put(p, " rev-"), d->meta.revision);
    *text_put_uint(text_put(p, " z-"), z) = '\0';
}

/* What clip leaves of a tile: all of it, a part, which *id is made the name of, or nothing. False,
 * with the problem set, for the last. */
static bool answer_tile_clip(const struct dataset *d, const struct store_tile *tile,
                             const struct target_clip *c, struct hash128 *id, bool *part,
                             struct response *out)
{
    struct err e = {0};
    struct clip clip = {0};
    enum crop_side side = CROP_INSIDE;
    *part = false;
    if (!c->n)
        return true;
    const struct store_shape x = store_shape(d->index, tile);
    enum err_code rc = param_clip_open(c, &clip, &e);
    if (!rc)
        rc = crop_box(&clip, &d->meta.origin, x.min_enu_m, x.max_enu_m, &side, &e);
    clip_free(&clip);
    *part = side == CROP_ACROSS;
    if (*part)
        result_id_clip(id, c);
    if (rc == ERR_MEM)
        response_no_memory(out);
    else if (rc)
        response_problem(out, 422, e.msg);
    else if (side == CROP_OUTSIDE)
        response_problem(out, 404, "no Gaussians of this tile lie within clip");
    return !rc && side != CROP_OUTSIDE;
}

/* ---- the work ---- */

struct answer_tile_own {
    bool city;        /* the finest level in one file, not a tile */
    struct key key;   /* of a tile */
    struct form form; /* complete (encode_form) */
    struct appearance_choice appearance;
    struct target_clip clip; /* n 0: all of it */
};

static enum err_code answer_tile_make(struct services *s, const struct job *j, const struct work *w,
                                      struct buf *out, struct err *e)
{
    const struct answer_tile_own *o = work_own(w);
    struct store *store = NULL;
    struct clip clip = {0};
    (void)s, (void)j;
    enum err_code rc = o->clip.n ? param_clip_open(&o->clip, &clip, e) : ERR_OK;
    if (!rc)
        rc = work_borrow(w, &store, e);
    const float *image = appearance_api_image(&o->appearance);
    const struct clip *part = o->clip.n ? &clip : NULL;
    if (!rc)
        rc = o->city ? encode_city(store, o->form, image, part, out, e)
                     : encode_tile(store, o->key, o->form, image, part, out, e);
    if (store)
        dataset_return(w->ds, store);
    clip_free(&clip);
    return rc;
}

static size_t answer_tile_count(const struct work *w, const struct answer_tile_own *o)
{
    const struct store_tile *t = store_find(w->ds->index, o->key);
    return t ? t->count : 0;
}

static size_t answer_tile_room(const struct work *w)
{
    const struct answer_tile_own *o = work_own(w);
    const size_t n = answer_tile_count(w, o), sh = 3 * gauss_sh_count(w->ds->meta.sh_degree);
    if (o->form.format == FORMAT_PLY || o->form.format == FORMAT_GLB_PLAIN)
        return n * (17 + sh) * sizeof(float);
    return n * (20 + sh + w->ds->meta.embed_len);
}

/* The formula of lab/BENCHMARKS.md for encoding. Formats differ, and what polygons cut. */
static double answer_tile_cost(const struct work *w, unsigned *variant)
{
    const double encode_ms = 1.5e-3;
    const struct answer_tile_own *o = work_own(w);
    *variant = o->clip.n ? FORMAT_COUNT : (unsigned)o->form.format;
    return 1 + encode_ms * (double)answer_tile_count(w, o);
}

static void answer_tile_tell(const struct work *w, char *out, size_t room)
{
    const struct answer_tile_own *o = work_own(w);
    snprintf(out, room, "tile %u/%u/%u.%s", o->key.z, o->key.x, o->key.y,
             format_ext(o->form.format));
}

static const struct work_kind answer_tile_work = {.noun = "tile",
                                                  .traits = WORK_ON_DISK | WORK_OF_STORE,
                                                  .size = sizeof(struct answer_tile_own),
                                                  .make = answer_tile_make,
                                                  .room = answer_tile_room,
                                                  .cost = answer_tile_cost,
                                                  .tell = answer_tile_tell};

static size_t answer_tile_city_room(const struct work *w)
{
    const size_t sh = 3 * gauss_sh_count(w->ds->meta.sh_degree);
    return encode_city_count(w->ds->index) * (17 + sh) * sizeof(float);
}

/* Files of different formats differ. */
static double answer_tile_city_cost(const struct work *w, unsigned *variant)
{
    const double encode_ms = 3e-3;
    *variant = (unsigned)((const struct answer_tile_own *)work_own(w))->form.format;
    return 1 + encode_ms * (double)encode_city_count(w->ds->index);
}

static const struct work_kind answer_tile_city_work = {.noun = "city in one file",
                                                       .traits = WORK_ON_DISK | WORK_OF_STORE,
                                                       .size = sizeof(struct answer_tile_own),
                                                       .make = answer_tile_make,
                                                       .room = answer_tile_city_room,
                                                       .cost = answer_tile_city_cost};

/* ---- the answers ---- */

void answer_tile(struct services *s, const struct request *r, struct dataset *d,
                 const struct target *t, struct response *out)
{
    const struct tile_target *asked = target_of_tile(t);
    const struct key key = asked->cell.key;
    const struct store_tile *tile = store_find(d->index, key);
    if (!tile) {
        response_problem(out, 404, "no Gaussians in this tile");
        return;
    }
    struct form form = encode_form(s->cfg, &d->meta, &asked->tiles.form);
    struct appearance_choice choice;
    if (!answer_appearance_find_tile(s, d, asked->tiles.appearance, &choice, out))
        return;
    form.trained = choice.trained;
    if (part_first(tile->count) == tile->count && form.part == 1)
        form.part = 0; /* the same body under the same tag */
    struct hash128 id = result_id_tile(d, tile, form, &choice);
    bool part = false;
    if (!answer_tile_clip(d, tile, &asked->tiles.clip, &id, &part, out))
        return;
    out->type = format_type(form.format);
    answer_tile_tags(d, key.z, out->surrogate);
    const bool job = response_made(s, r, id, out);
    if (out->status < 300 && permissions_is_public(r, d->meta.name)) /* a 304 has none */
        link_header_tile(d, tile, &asked->tiles, out->hints);
    if (!job)
        return;
    struct answer_tile_own *own = response_work(d, &answer_tile_work, id, out);
    if (own) {
        own->key = key;
        own->form = form;
        own->appearance = choice;
        if (part)
            own->clip = asked->tiles.clip;
        out->work->apart = part;
        out->work->may_lack = part || form.part;
    }
    out->tile = key;
    memcpy(out->tile_of, d->meta.name, sizeof out->tile_of);
}

void answer_tile_city(struct services *s, const struct request *r, struct dataset *d,
                      const struct target *t, struct response *out)
{
    const struct target_tiles *asked = &target_of_city(t)->tiles;
    const struct form form = encode_form(s->cfg, &d->meta, &asked->form);
    const uint64_t n = encode_city_count(d->index);
    struct appearance_choice choice;
    char text[200];
    if (n > (uint64_t)s->cfg->city_gaussians) {
        snprintf(
            text, sizeof text,
            "the finest level has %llu Gaussians, and files of more than %d are not made here: "
            "take the tiles, or citysplat export",
            (unsigned long long)n, (int)s->cfg->city_gaussians);
        response_problem(out, 422, text);
        return;
    }
    if (!answer_appearance_find_tile(s, d, asked->appearance, &choice, out))
        return;
    if (choice.trained) {
        response_problem(out, 400, "a file has an appearance; \"none\" is of tiles");
        return;
    }
    struct hash128 id = result_id_city(d, form, &choice);
    if (asked->clip.n)
        result_id_clip(&id, &asked->clip);
    out->type = format_type(form.format);
    snprintf(out->surrogate, sizeof out->surrogate, "ds-%s rev-%s", d->meta.name, d->meta.revision);
    struct answer_tile_own *own =
        response_made(s, r, id, out) ? response_work(d, &answer_tile_city_work, id, out) : NULL;
    if (!own)
        return;
    *own = (struct answer_tile_own){
        .city = true, .form = form, .appearance = choice, .clip = asked->clip};
    out->work->apart = true;
    out->work->may_lack = asked->clip.n;
}
