/* The city from straight above in tiles of a web map, as colours and as heights, and the documents
 * that lead to them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answer.h"

#include <stdio.h>
#include <string.h>

#include "server/map_document.h"
#include "server/ogc_tiles.h"
#include "server/result_id.h"

bool answer_is_surveyed(const struct dataset *d, struct response *out)
{
    if (!d->area.in)
        response_problem(out, 404,
                         "nothing of this dataset was surveyed: it has no maps and no heights");
    return d->area.in != NULL;
}

/* False, with the answer set, where there is nothing to draw. */
static bool answer_map_there(struct services *s, const struct dataset *d, const struct target *t,
                             struct response *out)
{
    char text[160];
    int most = raster_zoom_max(&d->area) + RASTER_ZOOM_OVER;
    if (!answer_is_surveyed(d, out))
        return false;
    if (t->key.z > most) {
        snprintf(text, sizeof text,
                 "tiles end at zoom %d, where pixels are finer than what was "
                 "surveyed",
                 most > KEY_ZOOM_MAX ? KEY_ZOOM_MAX : most);
        response_problem(out, 404, text);
        return false;
    }
    if (t->route == ROUTE_TERRAIN || area_touches(&d->area, t->key))
        return true;
    out->status = 204; /* a tile like any other, with nothing on it */
    out->cache_control = response_cache_control(s, d, t);
    return false;
}

static void answer_map_tile(struct services *s, const struct request *r, struct dataset *d,
                            const struct target *t, struct response *out)
{
    struct appearance_choice choice = {0};
    char device[160];
    bool terrain = t->route == ROUTE_TERRAIN;
    if (!answer_map_there(s, d, t, out) || !answer_can_draw(s, out) ||
        (!terrain && !answer_find_appearance(s, d, t->appearance, &choice, out)))
        return;
    const struct map_tile tile = {.key = t->key,
                                  .size_px = (uint32_t)RASTER_PX * t->scale,
                                  .format = t->form.format,
                                  .encoding = !terrain ? ENCODING_UNSAID
                                              : t->encoding == ENCODING_TERRARIUM
                                                  ? ENCODING_TERRARIUM
                                                  : ENCODING_MAPBOX,
                                  .quality = (int)s->cfg->quality};
    picture_about(s->picture, device, sizeof device);
    struct hash128 id = result_id_map(d, device, &tile, map_tile_is_flat(&d->area, &tile), &choice);
    out->type = target_type(tile.format);
    out->cache_control = response_cache_control(s, d, t);
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
    out->cls = JOB_MAP;
    out->timeout_s = s->cfg->deadline_s;
}

static void answer_map_document(struct services *s, const struct request *r, struct dataset *d,
                                const struct target *t, struct response *out)
{
    struct err e = {0};
    struct body *b = NULL;
    struct appearance_choice choice;
    char edition[9];
    bool wmts = t->route == ROUTE_WMTS;
    if (!answer_is_surveyed(d, out))
        return;
    if (t->route != ROUTE_TERRAINJSON && !answer_find_appearance(s, d, t->appearance, &choice, out))
        return;
    response_edition(s, d, t->route, edition);
    enum err_code rc = wmts ? map_document_wmts(d, edition, t, s->url, &b, &e)
                            : map_document_tilejson(d, edition, t, s->cfg->public_url, &b, &e);
    if (rc == ERR_ARG)
        response_problem(out, 404, e.msg);
    else if (rc)
        response_no_memory(out);
    else
        response_document(r, wmts ? "application/xml" : RESPONSE_JSON, RESPONSE_MOVING, b, out);
}

/* After OGC API - Tiles. */
static void answer_map_tileset(struct services *s, const struct request *r, struct dataset *d,
                               const struct target *t, struct response *out)
{
    struct body *b = NULL;
    char edition[9];
    if (!answer_is_surveyed(d, out))
        return;
    response_edition(s, d, t->route, edition);
    const char *base = ogc_tiles_base(s->cfg->public_url, s->cfg->base_path);
    enum err_code rc = t->route == ROUTE_MAP_TILESETS
                           ? ogc_tiles_list(d, base, &b, NULL)
                           : ogc_tiles_tileset(d, edition, base, &b, NULL);
    if (rc)
        response_no_memory(out);
    else
        response_document(r, RESPONSE_JSON, RESPONSE_MOVING, b, out);
}

bool answer_map(struct services *s, const struct request *r, struct dataset *d,
                const struct target *t, struct response *out)
{
    switch (t->route) {
    case ROUTE_MAP:
    case ROUTE_TERRAIN:
        answer_map_tile(s, r, d, t, out);
        return true;
    case ROUTE_MAPJSON:
    case ROUTE_TERRAINJSON:
    case ROUTE_WMTS:
        answer_map_document(s, r, d, t, out);
        return true;
    case ROUTE_MAP_TILESETS:
    case ROUTE_MAP_TILESET:
        answer_map_tileset(s, r, d, t, out);
        return true;
    default:
        return false;
    }
}
