/* Collections after OGC API Common and the 3D GeoVolumes draft.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/collection.h"

#include <jansson.h>
#include <stdio.h>
#include <string.h>

#include "server/document.h"
#include "server/ogc_tiles.h"
#include "server/target.h"

static void collection_add_maps(const struct dataset *d, const char *up,
                                const struct collection_options *opt, json_t *links)
{
    const char *base = ogc_tiles_base(opt->public_url, opt->base_path);
    static const struct {
        const char *rel, *type, *file, *title;
    } maps[] = {
        {"tiles", "application/json", "map.json", "Map from straight above: TileJSON 3.0.0"},
        {"tiles", "application/json", "terrain.json", "Terrain, heights as pictures: TileJSON"},
        {"tiles", "application/xml", "wmts.xml", "Map from straight above: WMTS capabilities"},
    };
    char href[160];
    for (size_t i = 0; d->area.in && i < sizeof maps / sizeof *maps; i++) {
        snprintf(href, sizeof href, "%sd/%s/%s", up, d->meta.name, maps[i].file);
        json_array_append_new(links, document_link(maps[i].rel, maps[i].type, href, maps[i].title));
    }
    snprintf(href, sizeof href, "collections/%s/map/tiles", d->meta.name);
    if (d->area.in)
        json_array_append_new(
            links, ogc_tiles_link("http://www.opengis.net/def/rel/ogc/1.0/tilesets-map",
                                  "application/json", base, href, "Map: OGC API - Tiles"));
}

/* Two boxes: that of the ground, in four numbers, which is all that GDAL 3.6 takes, and of what is
 * in it, with heights. */
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

/* `up` leads from the document to the service's root: "" or "../". */
static json_t *collection_json(const struct dataset *d, const char *up,
                               const struct collection_options *opt)
{
    const char *url = opt->public_url;
    static const char volumes[] = "http://www.opengis.net/def/rel/ogc/1.0/3d-geovolumes";
    const struct store_meta *m = &d->meta;
    char self[160], tileset[160], tilejson[160], appearances[160], model[160], photographs[160],
        tile[200], view[200];
    uint64_t count = 0;
    for (size_t i = 0; i < d->n_tiles; i++)
        if (d->tiles[i].key.z == m->zoom_max)
            count += d->tiles[i].count;
    snprintf(self, sizeof self, "%scollections/%s", up, m->name);
    snprintf(tileset, sizeof tileset, "%sd/%s/tileset.json", up, m->name);
    snprintf(tilejson, sizeof tilejson, "%scollections/%s/tiles.json", up, m->name);
    snprintf(appearances, sizeof appearances, "%sd/%s/appearances", up, m->name);
    snprintf(model, sizeof model, "%sd/%s/r/%s-%s/appearance.json", up, m->name, m->revision,
             d->edition);
    snprintf(photographs, sizeof photographs, "%sd/%s/r/%s-%s/appearances.json", up, m->name,
             m->revision, d->edition);
    snprintf(tile, sizeof tile, "%sd/%s/r/%s-%s/t/{z}/{x}/{y}.{ext}", up, m->name, m->revision,
             d->edition);
    snprintf(view, sizeof view,
             "%sd/%s/static/{lon},{lat},{h}@{heading},{pitch},{fov}/{w}x{h}.{fmt}", up, m->name);
    json_t *o = json_pack("{s:s,s:s,s:s,s:s}", "id", m->name, "title", m->name, "collectionType",
                          "3d-container", "attribution", m->attribution);
    collection_add_extents(d, o);
    json_object_set_new(
        o, "links",
        json_pack("[o,o,o]",
                  url && *url
                      ? ogc_tiles_link("self", "application/json", url, self + strlen(up), m->name)
                      : document_link("self", "application/json", self, m->name),
                  document_link(volumes, "application/3dtiles+json", tileset, "3D Tiles 1.1"),
                  document_link("tiles", "application/json", tilejson, "TileJSON 3.0.0")));
    collection_add_maps(d, up, opt, json_object_get(o, "links"));
    const struct {
        const char *rel, *href, *title;
    } more[] = {{"appearances", appearances, "Light and weather to choose from"},
                {"appearance-model", model, "The network, for clients that compute colours"},
                {"photographs", photographs, "Embeddings, times, poses, thumbnails"}};
    for (size_t i = 0; d->appearance && i < sizeof more / sizeof *more; i++)
        json_array_append_new(
            json_object_get(o, "links"),
            document_link(more[i].rel, "application/json", more[i].href, more[i].title));
    const double origin[3] = {m->origin.lon_deg, m->origin.lat_deg, m->origin.h_m};
    json_object_set_new(
        o, "splats",
        json_pack("{s:s,s:o,s:i,s:i,s:i,s:i,s:b,s:I,s:I,s:s,s:s,s:[s,s,s,s,s,s,s]}", "revision",
                  m->revision, "origin", document_numbers(origin, 3), "minzoom", (int)m->zoom_min,
                  "maxzoom", (int)m->zoom_max, "shDegree", (int)m->sh_degree, "embedLength",
                  (int)m->embed_len, "antialiased", (int)m->antialiased, "tiles",
                  (json_int_t)d->n_tiles, "gaussians", (json_int_t)count, "tileTemplate", tile,
                  "viewTemplate", view, "formats", target_ext(FORMAT_GLB), target_ext(FORMAT_SPZ),
                  target_ext(FORMAT_DRC), target_ext(FORMAT_PLY), target_ext(FORMAT_GLB_PLAIN),
                  target_ext(FORMAT_PLY_PACKED), target_ext(FORMAT_SOG)));
    return o;
}

enum err_code collection_describe(const struct dataset *d, const struct collection_options *opt,
                                  struct body **out, struct err *e)
{
    return document_make(collection_json(d, "../", opt), out, e);
}

enum err_code collection_list(struct dataset *const *ds, size_t n,
                              const struct collection_options *opt, struct body **out,
                              struct err *e)
{
    json_t *list = json_array();
    for (size_t i = 0; i < n; i++)
        json_array_append_new(list, collection_json(ds[i], "", opt));
    json_t *o = json_pack("{s:[o],s:o}", "links",
                          document_link("self", "application/json", "collections", "Datasets"),
                          "collections", list);
    if (opt->basemap && *opt->basemap)
        json_object_set_new(o, "basemap",
                            json_pack("{s:s,s:s}", "tiles", opt->basemap, "attribution",
                                      opt->attribution ? opt->attribution : ""));
    return document_make(o, out, e);
}
