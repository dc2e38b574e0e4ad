/* The city from straight above as tiles of a web map, in colours and in heights, and the documents
 * that lead to them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answer_map.h"

#include <stdio.h>
#include <string.h>

#include "server/answer.h"
#include "server/answer_appearance.h"
#include "server/answer_view.h"
#include "server/map_document.h"
#include "server/ogc_tiles.h"
#include "server/origin.h"
#include "server/result_id.h"

bool answer_map_is_surveyed(const struct dataset *d, struct response *out)
{
    if (!d->area.in)
        response_problem(out, 404,
                         "nothing of this dataset was surveyed: it has no maps and no heights");
    return d->area.in != NULL;
}

/* False, with the answer set, where there is nothing to draw. */
static bool answer_map_there(const struct dataset *d, const struct target *t,
                             enum map_document_of of, struct response *out)
{
    char text[160];
    int most = raster_zoom_max(&d->area) + RASTER_ZOOM_OVER;
    if (!answer_map_is_surveyed(d, out))
        return false;
    if (t->key.z > most) {
        snprintf(text, sizeof text,
                 "tiles end at zoom %d, where pixels are finer than what was "
                 "surveyed",
                 most > KEY_ZOOM_MAX ? KEY_ZOOM_MAX : most);
        response_problem(out, 404, text);
        return false;
    }
    if (of == MAP_DOCUMENT_TERRAIN || area_touches(&d->area, t->key))
        return true;
    out->status = 204; /* a tile like any other, with nothing on it */
    return false;
}

static void answer_map_draw(struct services *s, const struct request *r, struct dataset *d,
                            const struct target *t, enum map_document_of of, struct response *out)
{
    struct appearance_choice choice = {0};
    char device[160];
    const bool terrain = of == MAP_DOCUMENT_TERRAIN;
    if (!answer_map_there(d, t, of, out) || !answer_view_can_draw(s, out) ||
        (!terrain && !answer_appearance_find(s, d, t->appearance, &choice, out)))
        return;
    const struct map_tile tile = {.key = t->key,
                                  .size_px = (uint32_t)RASTER_PX * t->scale,
                                  .format = terrain ? FORMAT_PNG : t->form.format,
                                  .encoding = !terrain ? ENCODING_UNSAID
                                              : t->encoding == ENCODING_TERRARIUM
                                                  ? ENCODING_TERRARIUM
                                                  : ENCODING_MAPBOX,
                                  .quality = (int)s->cfg->quality};
    picture_about(s->picture, device, sizeof device);
    struct hash128 id = result_id_map(d, device, &tile, map_tile_is_flat(&d->area, &tile), &choice);
    out->type = format_type(tile.format);
    snprintf(out->surrogate, sizeof out->surrogate, "ds-%s rev-%s map", d->meta.name,
             d->meta.revision);
    if (!response_made(s, r, id, out))
        return;
    struct work *w = response_work(d, WORK_MAP, id, (struct form){.format = tile.format}, out);
    if (w) {
        w->key = t->key;
        w->map = tile;
        w->appearance = choice;
    }
}

void answer_map_tile(struct services *s, const struct request *r, struct dataset *d,
                     const struct target *t, struct response *out)
{
    answer_map_draw(s, r, d, t, MAP_DOCUMENT_COLOURS, out);
}

void answer_map_terrain(struct services *s, const struct request *r, struct dataset *d,
                        const struct target *t, struct response *out)
{
    answer_map_draw(s, r, d, t, MAP_DOCUMENT_TERRAIN, out);
}

/* ---- documents ---- */

void answer_map_document(const struct services *s, const struct request *r, const char *type,
                         struct body *b, struct response *out)
{
    response_document(r, type, b, out);
    if (out->status < 400 && !(s->cfg->public_url && *s->cfg->public_url))
        out->vary = out->vary ? ORIGIN_VARY_ENCODED : ORIGIN_VARY;
}

/* The edition that a document names in its addresses. False, and answered: there is no survey, or
 * not the appearance that was asked for; terrain has none. */
static bool answer_map_edition(struct services *s, struct dataset *d, const struct target *t,
                               enum map_document_of of, char edition[9], struct response *out)
{
    struct appearance_choice choice;
    if (!answer_map_is_surveyed(d, out))
        return false;
    if (of == MAP_DOCUMENT_COLOURS && !answer_appearance_find(s, d, t->appearance, &choice, out))
        return false;
    response_edition(s, d, EDITION_PICTURES, edition);
    return true;
}

static void answer_map_describe(struct services *s, const struct request *r, struct dataset *d,
                                const struct target *t, enum map_document_of of,
                                struct response *out)
{
    struct err e = {0};
    struct body *b = NULL;
    char edition[9], origin[ORIGIN_MAX];
    if (!answer_map_edition(s, d, t, of, edition, out))
        return;
    if (map_document_tilejson(d, edition, of, t, origin_of(s, r, origin), &b, &e))
        response_no_memory(out);
    else
        answer_map_document(s, r, RESPONSE_JSON, b, out);
}

void answer_map_tilejson(struct services *s, const struct request *r, struct dataset *d,
                         const struct target *t, struct response *out)
{
    answer_map_describe(s, r, d, t, MAP_DOCUMENT_COLOURS, out);
}

void answer_map_terrain_tilejson(struct services *s, const struct request *r, struct dataset *d,
                                 const struct target *t, struct response *out)
{
    answer_map_describe(s, r, d, t, MAP_DOCUMENT_TERRAIN, out);
}

void answer_map_style(struct services *s, const struct request *r, struct dataset *d,
                      const struct target *t, struct response *out)
{
    struct err e = {0};
    struct body *b = NULL;
    char edition[9], origin[ORIGIN_MAX];
    if (!answer_map_edition(s, d, t, MAP_DOCUMENT_COLOURS, edition, out))
        return;
    if (map_document_style(d, edition, t, origin_of(s, r, origin), &b, &e))
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
    if (!answer_map_edition(s, d, t, MAP_DOCUMENT_COLOURS, edition, out))
        return;
    enum err_code rc = map_document_wmts(d, edition, t, origin_or_own(s, r, origin), &b, &e);
    if (rc == ERR_ARG)
        response_problem(out, 404, e.msg);
    else if (rc)
        response_no_memory(out);
    else
        answer_map_document(s, r, "application/xml", b, out);
}

/* After OGC API - Tiles. */
void answer_map_tilesets(struct services *s, const struct request *r, struct dataset *d,
                         const struct target *t, struct response *out)
{
    struct body *b = NULL;
    struct origin_places at;
    (void)t;
    if (!answer_map_is_surveyed(d, out))
        return;
    origin_read(s, r, &at);
    if (ogc_tiles_list(d, ogc_tiles_base(at.public_url, at.base_path), &b, NULL))
        response_no_memory(out);
    else
        response_document(r, RESPONSE_JSON, b, out);
}

void answer_map_tileset(struct services *s, const struct request *r, struct dataset *d,
                        const struct target *t, struct response *out)
{
    struct body *b = NULL;
    struct origin_places at;
    char edition[9];
    (void)t;
    if (!answer_map_is_surveyed(d, out))
        return;
    response_edition(s, d, EDITION_PICTURES, edition);
    origin_read(s, r, &at);
    if (ogc_tiles_tileset(d, edition, ogc_tiles_base(at.public_url, at.base_path), &b, NULL))
        response_no_memory(out);
    else
        response_document(r, RESPONSE_JSON, b, out);
}
