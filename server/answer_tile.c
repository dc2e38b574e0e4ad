/* Tiles: from memory, or by a job.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answer.h"

#include <assert.h>
#include <string.h>

#include "codec/part.h"
#include "lod/clip.h"
#include "lod/crop.h"
#include "lod/store.h"
#include "server/answer_appearance.h"
#include "server/encode.h"
#include "server/param_clip.h"
#include "server/result_id.h"
#include "server/right.h"
#include "server/text.h"

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
    const struct store_shape x = store_shape(d->index, tile);
    enum crop_side side = CROP_INSIDE;
    enum err_code rc = c->n ? param_clip_open(c, &clip, &e) : ERR_OK;
    if (!rc && c->n)
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

void answer_tile(struct services *s, const struct request *r, struct dataset *d,
                 const struct target *t, struct response *out)
{
    const struct store_tile *tile = store_find(d->index, t->key);
    if (!tile) {
        response_problem(out, 404, "no Gaussians in this tile");
        return;
    }
    struct form form = encode_form(s->cfg, &d->meta, &t->form);
    struct appearance_choice choice;
    if (!answer_appearance_find_tile(s, d, t->appearance, &choice, out))
        return;
    form.trained = choice.trained;
    if (part_first(tile->count) == tile->count && form.part == 1)
        form.part = 0; /* the same body under the same tag */
    struct hash128 id = result_id_tile(d, tile, form, &choice);
    bool part = false;
    if (!answer_tile_clip(d, tile, &t->clip, &id, &part, out))
        return;
    out->type = format_type(form.format);
    answer_tile_tags(d, t->key.z, out->surrogate);
    const bool job = response_made(s, r, id, out);
    if (out->status < 300 && right_is_public(r, d->meta.name)) /* a 304 has none */
        hint_tile(d, tile, t, out->hints);
    if (!job)
        return;
    struct work *w = response_work(d, WORK_TILE, id, form, out);
    if (w) {
        w->key = t->key;
        w->appearance = choice;
        if (part)
            w->target.clip = t->clip;
    }
    out->tile = t->key;
    memcpy(out->tile_of, d->meta.name, sizeof out->tile_of);
}
