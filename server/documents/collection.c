/* Collections after OGC API Common and the 3D GeoVolumes draft.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/collection.h"

#include <jansson.h>
#include <stdio.h>
#include <string.h>

#include "server/base/document.h"
#include "server/base/format.h"
#include "server/data/encode.h"
#include "server/documents/home_outline.h"
#include "server/documents/link.h"
#include "server/documents/social_preview.h"

struct collection_link {
    const char *rel, *type, *title;
    void (*to)(const struct link *l, struct buf *out);
};

/* A link to what belongs to the dataset. up: as in link.h. */
static void collection_add(const struct dataset *d, const char *up,
                           const struct collection_link *row, json_t *links)
{
    const struct link l = link_to(LINK_ROOT, up, d, d->edition);
    char href[FILE_PATH_MAX];
    json_array_append_new(links, document_link(row->rel, row->type,
                                               link_text(row->to, &l, href, sizeof href),
                                               row->title ? row->title : d->meta.name));
}

/* A picture of the whole scene, for lists. */
static void collection_add_preview(const struct dataset *d, const char *up, json_t *links)
{
    enum { WIDTH = 320, HEIGHT = 200 };
    struct buf href = {0};
    social_preview_picture(d, up ? up : "", WIDTH, HEIGHT, &href);
    if (href.size) {
        buf_u8(&href, 0);
        json_array_append_new(links, href.failed
                                         ? NULL
                                         : document_link("preview", "image/jpeg",
                                                         (const char *)href.data, d->meta.name));
    }
    buf_free(&href);
}

/* The whole city in one file, with its size, where the server makes such files. */
static void collection_add_files(const struct dataset *d, const char *up, size_t most,
                                 json_t *links)
{
    static const enum format formats[] = {FORMAT_SOG, FORMAT_SPZ};
    const uint64_t n = encode_city_count(d->index);
    for (size_t i = 0; n <= most && i < sizeof formats / sizeof *formats; i++) {
        struct link l = link_to(LINK_ROOT, up, d, NULL);
        char href[FILE_PATH_MAX];
        l.ext = format_ext(formats[i]);
        json_t *link = document_link("enclosure", format_type(formats[i]),
                                     link_text(link_city_moving, &l, href, sizeof href),
                                     "The whole city in one file");
        json_object_set_new(link, "length",
                            json_integer((json_int_t)encode_city_bytes(d->index, formats[i])));
        json_array_append_new(links, link);
    }
}

static void collection_add_maps(const struct dataset *d, const char *up, json_t *links)
{
    static const struct collection_link maps[] = {
        {"tiles", "application/json", "Map from straight above: TileJSON 3.0.0", link_mapjson},
        {"tiles", "application/json", "Terrain, heights as pictures: TileJSON", link_terrainjson},
        {"stylesheet", "application/json", "Map on its terrain: style of MapLibre", link_style},
        {"tiles", "application/xml", "Map from straight above: WMTS capabilities", link_wmts},
    };
    for (size_t i = 0; d->area.in && i < sizeof maps / sizeof *maps; i++)
        collection_add(d, up, &maps[i], links);
}

/* Two boxes: that of the ground, in four numbers, and of what is in it, with heights. */
static void collection_add_extents(const struct dataset *d, json_t *o)
{
    const double *b = d->bbox, ground[4] = {b[0], b[1], b[3], b[4]};
    json_object_set_new(o, "extent",
                        json_pack("{s:{s:[o],s:s}}", "spatial", "bbox", document_numbers(ground, 4),
                                  "crs", "http://www.opengis.net/def/crs/OGC/1.3/CRS84"));
    json_object_set_new(o, "contentExtent",
                        json_pack("{s:{s:[o],s:s}}", "spatial", "bbox", document_numbers(b, 6),
                                  "crs", "http://www.opengis.net/def/crs/OGC/0/CRS84h"));
}

/* What is to be seen first; when the store was made, and its photographs were taken; what heights
 * are above. */
static void collection_add_facts(const struct dataset *d, json_t *splats)
{
    double outline[HOME_OUTLINE_NUMBERS];
    if (home_outline(d, outline))
        json_object_set_new(splats, "outline", document_numbers(outline, HOME_OUTLINE_NUMBERS));
    json_object_set_new(splats, "heights", json_string(heights_name(d->meta.heights)));
    if (d->meta.created[0])
        json_object_set_new(splats, "created", json_string(d->meta.created));
    if (d->taken[0][0])
        json_object_set_new(splats, "taken", json_pack("[s,s]", d->taken[0], d->taken[1]));
}

/* `up` leads from the document to the service's root: NULL or "..". */
static json_t *collection_json(const struct dataset *d, const char *up,
                               const struct collection_options *opt)
{
    const char *url = opt->public_url;
    const struct store_meta *m = &d->meta;
    struct link l = link_to(LINK_ROOT, up, d, d->edition);
    char tile[200], view[200];
    uint64_t count = 0;
    for (size_t i = 0; i < d->n_tiles; i++)
        if (d->tiles[i].key.z == m->zoom_max)
            count += d->tiles[i].count;
    link_text(link_tile, &l, tile, sizeof tile);
    l.with = "fov";
    link_text(link_view_moving, &l, view, sizeof view);
    json_t *o = json_pack("{s:s,s:s,s:s,s:s}", "id", m->name, "title", m->name, "collectionType",
                          "3d-container", "attribution", m->attribution);
    collection_add_extents(d, o);
    static const struct collection_link rows[] = {
        {"http://www.opengis.net/def/rel/ogc/1.0/3d-geovolumes", "application/3dtiles+json",
         "3D Tiles 1.1", link_tileset_moving},
        {"tiles", "application/json", "TileJSON 3.0.0", link_tilejson},
        {"help", "text/html", "Code for map clients, with the addresses of this dataset", link_use},
    };
    static const struct collection_link appearance[] = {
        {"appearances", "application/json", "Light and weather to choose from", link_appearances},
        {"appearance-model", "application/json", "The network, for clients that compute colours",
         link_model},
        {"photographs", "application/json", "Embeddings, times, poses, thumbnails",
         link_photographs}};
    const struct collection_link self = {"self", "application/json", NULL, link_collection};
    json_t *links = json_array();
    collection_add(d, url && *url ? url : up, &self, links);
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        collection_add(d, up, &rows[i], links);
    collection_add_maps(d, up, links);
    collection_add_preview(d, up, links);
    collection_add_files(d, up, opt->city_gaussians, links);
    for (size_t i = 0; d->appearance && i < sizeof appearance / sizeof *appearance; i++)
        collection_add(d, up, &appearance[i], links);
    json_object_set_new(o, "links", links);
    const double origin[3] = {m->origin.lon_deg, m->origin.lat_deg, m->origin.h_m};
    json_object_set_new(
        o, "splats",
        json_pack("{s:s,s:o,s:i,s:i,s:i,s:i,s:b,s:I,s:I,s:s,s:s,s:[s,s,s,s,s,s,s,s]}", "revision",
                  m->revision, "origin", document_numbers(origin, 3), "minzoom", (int)m->zoom_min,
                  "maxzoom", (int)m->zoom_max, "shDegree", (int)m->sh_degree, "embedLength",
                  (int)m->embed_len, "antialiased", (int)m->antialiased, "tiles",
                  (json_int_t)d->n_tiles, "gaussians", (json_int_t)count, "tileTemplate", tile,
                  "viewTemplate", view, "formats", format_ext(FORMAT_GLB), format_ext(FORMAT_SPZ),
                  format_ext(FORMAT_DRC), format_ext(FORMAT_PLY), format_ext(FORMAT_GLB_PLAIN),
                  format_ext(FORMAT_GLB_LOWPASS), format_ext(FORMAT_PLY_PACKED),
                  format_ext(FORMAT_SOG)));
    collection_add_facts(d, json_object_get(o, "splats"));
    return o;
}

enum err_code collection_describe(const struct dataset *d, const struct collection_options *opt,
                                  struct body **out, struct err *e)
{
    return document_make(collection_json(d, "..", opt), out, e);
}

enum err_code collection_list(struct dataset *const *ds, size_t n,
                              const struct collection_options *opt, struct body **out,
                              struct err *e)
{
    json_t *list = json_array();
    for (size_t i = 0; i < n; i++)
        json_array_append_new(list, collection_json(ds[i], NULL, opt));
    char self[40];
    link_text(link_collections, &(struct link){.from = LINK_ROOT}, self, sizeof self);
    json_t *o =
        json_pack("{s:[o],s:o}", "links",
                  document_link("self", "application/json", self, "Datasets"), "collections", list);
    return document_make(o, out, e);
}
