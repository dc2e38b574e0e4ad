/* The city from straight above as tiles of a web map, in colours and in heights, and the documents
 * that lead to them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answers/answer_map.h"

#include <stdio.h>
#include <string.h>

#include "server/answers/answer.h"
#include "server/answers/answer_appearance.h"
#include "server/answers/answer_view.h"
#include "server/answers/origin.h"
#include "server/documents/map_document.h"
#include "server/drawing/picture_id.h"

bool answer_map_is_surveyed(const struct dataset *d, struct response *out)
{
    if (!d->area.in)
        response_problem(out, 404,
                         "nothing of this dataset was surveyed: it has no maps and no heights");
    return d->area.in != NULL;
}

/* False, with the answer set, where there is nothing to draw. */
static bool answer_map_there(const struct dataset *d, struct key key, bool terrain,
                             struct response *out)
{
    char text[160];
    int most = raster_zoom_max(&d->area) + RASTER_ZOOM_OVER;
    if (!answer_map_is_surveyed(d, out))
        return false;
    if (key.z > most) {
        snprintf(text, sizeof text,
                 "tiles end at zoom %d, where pixels are finer than what was "
                 "surveyed",
                 most > KEY_ZOOM_MAX ? KEY_ZOOM_MAX : most);
        response_problem(out, 404, text);
        return false;
    }
    if (terrain || area_touches(&d->area, key))
        return true;
    out->status = 204; /* a tile like any other, with nothing on it */
    return false;
}

/* ---- the work ---- */

struct answer_map_own {
    struct map_tile tile;
    struct appearance_choice appearance;
};

static enum err_code answer_map_make(struct services *s, const struct job *j, const struct work *w,
                                     struct buf *out, struct err *e)
{
    const struct answer_map_own *o = work_own(w);
    struct draw_request q;
    memset(&q, 0, sizeof q);
    q.kind = DRAW_MAP;
    q.appearance = o->appearance;
    q.map = o->tile;
    return work_draw(s, j, w, &q, out, e);
}

static size_t answer_map_room(const struct work *w)
{
    const struct answer_map_own *o = work_own(w);
    return (size_t)o->tile.size_px * o->tile.size_px * 4;
}

static double answer_map_cost(const struct work *w, unsigned *variant)
{
    const struct answer_map_own *o = work_own(w);
    (void)variant;
    return 5 + 4 * DRAW_PIXEL_MS * (double)o->tile.size_px * o->tile.size_px;
}

static void answer_map_tell(const struct work *w, char *out, size_t room)
{
    const struct map_tile *t = &((const struct answer_map_own *)work_own(w))->tile;
    snprintf(out, room, "map tile %u/%u/%u.%s", t->key.z, t->key.x, t->key.y,
             format_ext(t->format));
}

static const struct work_kind answer_map_work = {.noun = "map tile",
                                                 .traits = WORK_DRAWN | WORK_ON_DISK,
                                                 .size = sizeof(struct answer_map_own),
                                                 .make = answer_map_make,
                                                 .room = answer_map_room,
                                                 .cost = answer_map_cost,
                                                 .tell = answer_map_tell};

/* ---- tiles ---- */

/* tile: its key, size, format and encoding. appearance NULL: of heights. */
static void answer_map_draw(struct services *s, const struct request *r, struct dataset *d,
                            const struct map_tile *tile, const char *appearance,
                            struct response *out)
{
    struct appearance_choice choice = {0};
    char device[160];
    if (!answer_map_there(d, tile->key, !appearance, out) || !answer_view_can_draw(s, out) ||
        (appearance && !answer_appearance_find(s, d, appearance, &choice, out)))
        return;
    picture_about(s->picture, device, sizeof device);
    struct hash128 id = picture_id_map(d, device, tile, map_tile_is_flat(&d->area, tile), &choice);
    out->type = format_type(tile->format);
    snprintf(out->surrogate, sizeof out->surrogate, "ds-%s rev-%s map", d->meta.name,
             d->meta.revision);
    if (!response_made(s, r, id, out))
        return;
    struct answer_map_own *own = response_work(d, &answer_map_work, id, out);
    if (own)
        *own = (struct answer_map_own){*tile, choice};
}

void answer_map_tile(struct services *s, const struct request *r, struct dataset *d,
                     const struct target *t, struct response *out)
{
    const struct map_target *asked = target_of_map(t);
    const struct map_tile tile = {.key = asked->cell.key,
                                  .size_px = (uint32_t)RASTER_PX * asked->cell.scale,
                                  .format = asked->map.format,
                                  .quality = (int)s->cfg->quality};
    answer_map_draw(s, r, d, &tile, asked->appearance.appearance, out);
}

void answer_map_terrain(struct services *s, const struct request *r, struct dataset *d,
                        const struct target *t, struct response *out)
{
    const struct terrain_target *asked = target_of_terrain(t);
    const bool terrarium = asked->terrain.encoding == ENCODING_TERRARIUM;
    const struct map_tile tile = {.key = asked->cell.key,
                                  .size_px = (uint32_t)RASTER_PX * asked->cell.scale,
                                  .format = FORMAT_PNG,
                                  .encoding = terrarium ? ENCODING_TERRARIUM : ENCODING_MAPBOX,
                                  .ground = asked->terrain.ground,
                                  .quality = (int)s->cfg->quality};
    if (tile.ground && raster_ground_radius(tile.key, tile.size_px) > RASTER_GROUND_PX) {
        response_problem(out, 404,
                         "tiles of bare ground end where pixels are much smaller than "
                         "buildings: terrain.json?ground=true has their zooms");
        return;
    }
    answer_map_draw(s, r, d, &tile, NULL, out);
}

/* ---- documents ---- */

static void answer_map_document(const struct services *s, const struct request *r, const char *type,
                                struct body *b, struct response *out)
{
    response_document(r, type, b, out);
    if (out->status < 400)
        out->vary = origin_vary(s, out->vary ? ORIGIN_ENCODED : ORIGIN_ALONE);
}

/* The edition that a document names in its addresses. appearance NULL: it is one of heights. False,
 * and answered: there is no survey, or not the appearance that was asked for. */
static bool answer_map_edition(struct services *s, struct dataset *d, const char *appearance,
                               char edition[9], struct response *out)
{
    struct appearance_choice choice;
    if (!answer_map_is_surveyed(d, out))
        return false;
    if (appearance && !answer_appearance_find(s, d, appearance, &choice, out))
        return false;
    response_edition(s, d, EDITION_PICTURES, edition);
    return true;
}

static void answer_map_describe(struct services *s, const struct request *r, struct dataset *d,
                                const struct map_document_ask *ask, struct response *out)
{
    struct err e = {0};
    struct body *b = NULL;
    char edition[9], origin[ORIGIN_MAX];
    if (!answer_map_edition(s, d, ask->appearance, edition, out))
        return;
    if (map_document_tilejson(d, edition, ask, origin_of(s, r, origin), &b, &e))
        response_no_memory(out);
    else
        answer_map_document(s, r, RESPONSE_JSON, b, out);
}

void answer_map_tilejson(struct services *s, const struct request *r, struct dataset *d,
                         const struct target *t, struct response *out)
{
    const struct map_document_ask ask = {.appearance = target_of_mapjson(t)->appearance.appearance};
    answer_map_describe(s, r, d, &ask, out);
}

void answer_map_terrain_tilejson(struct services *s, const struct request *r, struct dataset *d,
                                 const struct target *t, struct response *out)
{
    const struct target_terrain *terrain = &target_of_terrainjson(t)->terrain;
    const struct map_document_ask ask = {.encoding = terrain->encoding, .ground = terrain->ground};
    answer_map_describe(s, r, d, &ask, out);
}

void answer_map_style(struct services *s, const struct request *r, struct dataset *d,
                      const struct target *t, struct response *out)
{
    struct err e = {0};
    struct body *b = NULL;
    char edition[9], origin[ORIGIN_MAX];
    const char *appearance = target_of_style(t)->appearance.appearance;
    if (!answer_map_edition(s, d, appearance, edition, out))
        return;
    if (map_document_style(d, edition, appearance, origin_of(s, r, origin), &b, &e))
        response_no_memory(out);
    else
        answer_map_document(s, r, RESPONSE_JSON, b, out);
}

void answer_map_wmts(struct services *s, const struct request *r, struct dataset *d,
                     const struct target *t, struct response *out)
{
    struct err e = {0};
    struct body *b = NULL;
    char edition[9], origin[ORIGIN_MAX];
    const char *appearance = target_of_wmts(t)->appearance.appearance;
    if (!answer_map_edition(s, d, appearance, edition, out))
        return;
    enum err_code rc =
        map_document_wmts(d, edition, appearance, origin_or_own(s, r, origin), &b, &e);
    if (rc == ERR_ARG)
        response_problem(out, 404, e.msg);
    else if (rc)
        response_no_memory(out);
    else
        answer_map_document(s, r, "application/xml", b, out);
}
