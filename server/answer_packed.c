/* See answer_packed.h. One table says which routes a 3TZ and a PMTiles answer. Their parts are read
 * by jobs, because the file may lie at an address.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answer_packed.h"

#include <stdio.h>
#include <string.h>

#include "lod/raster.h"
#include "server/answer.h"
#include "server/answer_map.h"
#include "server/link.h"
#include "server/map_document.h"
#include "server/origin.h"
#include "server/target_query.h"

/* The file has each tile in one form. False, with the problem set: another one is asked for. */
static bool answer_packed_plain(const struct target *t, struct response *out)
{
    char query[TARGET_QUERY_MAX];
    target_query_tiles(t, query);
    if (query[0] || t->form.part)
        response_problem(out, 404,
                         "this dataset is an exported 3TZ, which has each tile in one form: leave "
                         "preset, sh, part, clip and appearance out, or have the tile store served "
                         "that it came from");
    return !query[0] && !t->form.part;
}

/* A part, from memory or by a job. document: it is JSON. */
static void answer_packed_part(struct services *s, const struct request *r, struct dataset *d,
                               const struct packed_part *part, bool document, struct response *out)
{
    const struct hash128 both[2] = {d->salt, part->name};
    const struct hash128 id = hash_bytes(both, sizeof both);
    snprintf(out->surrogate, sizeof out->surrogate, "ds-%s rev-%s", d->meta.name, d->meta.revision);
    out->cls = r->prefetch ? JOB_PREFETCH : JOB_TILE; /* of maps, too: nothing is drawn */
    if (!response_made(s, r, id, out))
        return;
    struct work *w = response_work(d, WORK_PACKED, id, (struct form){0}, out);
    if (w) {
        w->packed = *part;
        w->part = document;
    }
}

static void answer_packed_entry(struct services *s, const struct request *r, struct dataset *d,
                                const struct target *t, struct response *out)
{
    (void)s;
    if (answer_packed_plain(t, out))
        response_document(r, RESPONSE_JSON, body_ref(d->tileset_moving), out);
}

/* What an address names below the folder of its revision is the name of the file. */
static void answer_packed_file(struct services *s, const struct request *r, struct dataset *d,
                               const struct target *t, struct response *out)
{
    struct packed_part part;
    const char *name = link_below_dataset(r->target), *end = r->target + t->path_size;
    for (int i = 0; i < 2; i++) /* "r/REV/" */
        name = strchr(name, '/') + 1;
    const bool document = end[-1] == 'n'; /* .json; tiles end in another letter */
    if (!answer_packed_plain(t, out))
        return;
    if (!packed_find_file(d->packed, name, (size_t)(end - name), &part)) {
        response_problem(out, 404,
                         "the exported 3TZ that is this dataset has no such file: it has its "
                         "tiles as .glb alone");
        return;
    }
    out->type = document ? RESPONSE_JSON : format_type(FORMAT_GLB);
    out->tile = t->key;
    memcpy(out->tile_of, d->meta.name, sizeof out->tile_of);
    answer_packed_part(s, r, d, &part, document, out);
}

static void answer_packed_mapjson(struct services *s, const struct request *r, struct dataset *d,
                                  const struct target *t, struct response *out)
{
    struct body *b = NULL;
    char origin[ORIGIN_MAX];
    if (t->appearance[0])
        response_problem(out, 404,
                         "this dataset is an exported PMTiles, which has one appearance: leave "
                         "appearance out");
    else if (map_document_packed(d, origin_of(s, r, origin), &b, NULL))
        response_no_memory(out);
    else
        answer_map_document(s, r, RESPONSE_JSON, b, out);
}

/* Is it of the form that the file has? */
static bool answer_packed_is_map(const struct packed_about *a, const struct target *t,
                                 struct response *out)
{
    char text[200];
    const bool dense = a->tile_px > RASTER_PX;
    const bool fine = t->form.format == a->format && (t->scale > 1) == dense && !t->appearance[0];
    if (!fine)
        snprintf(text, sizeof text,
                 "this dataset is an exported PMTiles, whose tiles are z/x/y%s.%s in one "
                 "appearance",
                 dense ? "@2x" : "", format_ext(a->format));
    else
        snprintf(text, sizeof text, "the tiles of this exported map have zooms %u to %u",
                 a->zoom_min, a->zoom_max);
    if (fine && t->key.z >= a->zoom_min && t->key.z <= a->zoom_max)
        return true;
    response_problem(out, 404, text);
    return false;
}

static void answer_packed_map(struct services *s, const struct request *r, struct dataset *d,
                              const struct target *t, struct response *out)
{
    const struct packed_about *a = packed_about(d->packed);
    struct packed_part part;
    if (!answer_packed_is_map(a, t, out))
        return;
    if (!packed_find_tile(d->packed, t->key, &part)) {
        out->status = 204; /* a tile like any other, with nothing on it */
        return;
    }
    out->type = format_type(a->format);
    out->tile = t->key;
    memcpy(out->tile_of, d->meta.name, sizeof out->tile_of);
    answer_packed_part(s, r, d, &part, false, out);
}

static void answer_packed_nothing(const struct dataset *d, struct response *out)
{
    response_problem(out, 404,
                     packed_kind(d->packed) == PACKED_MAP
                         ? "this dataset is an exported PMTiles, which has map.json and map tiles "
                           "alone: for all else have the tile store served that it came from"
                         : "this dataset is an exported 3TZ, which has tileset.json and its tiles "
                           "alone: for all else have the tile store served that it came from");
}

/* Views and terrain have addresses without a revision, too. */
static void answer_packed_moving(struct services *s, const struct request *r, struct dataset *d,
                                 const struct target *t, struct response *out)
{
    if (t->route->query & QUERY_MAP)
        answer_dataset_moving_picture(s, r, d, t, out);
    else
        answer_packed_nothing(d, out);
}

void answer_packed(struct services *s, const struct request *r, struct dataset *d,
                   const struct target *t, route_function *of_stores, struct response *out)
{
    static const struct {
        route_function *of_stores;
        enum packed_kind kind; /* PACKED_NONE: of both */
        route_function *answer;
    } rows[] = {
        {answer_dataset_collection, PACKED_NONE, answer_dataset_collection},
        {answer_dataset_tileset_moving, PACKED_TILES, answer_packed_entry},
        {answer_dataset_tileset, PACKED_TILES, answer_packed_file},
        {answer_dataset_tileset_part, PACKED_TILES, answer_packed_file},
        {answer_tile, PACKED_TILES, answer_packed_file},
        {answer_dataset_moving_tile, PACKED_TILES, answer_dataset_moving_tile},
        {answer_map_tilejson, PACKED_MAP, answer_packed_mapjson},
        {answer_map_tile, PACKED_MAP, answer_packed_map},
        {answer_dataset_moving_picture, PACKED_MAP, answer_packed_moving},
    };
    const enum packed_kind kind = packed_kind(d->packed);
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        if (rows[i].of_stores == of_stores && (!rows[i].kind || rows[i].kind == kind)) {
            rows[i].answer(s, r, d, t, out);
            return;
        }
    answer_packed_nothing(d, out);
}
