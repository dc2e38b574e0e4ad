/* OGC API - Tiles: see ogc_tiles.h.
 *
 * GDAL 3.6 determines the form. It reads a tile matrix set only in the words of OGC 17-083r2 (2019:
 * identifier, supportedCRS, tileMatrix, topLeftCorner). Other programs read those of 17-083r4
 * (2022: id, crs, tileMatrices, pointOfOrigin). Both are written. GDAL opens no tileset without
 * limits, and with limits narrower than a matrix it requests wrong tiles. The limits therefore
 * state which zooms exist, and for each the whole matrix. A tile outside the survey is 204.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/ogc_tiles.h"

#include <jansson.h>
#include <stdio.h>
#include <string.h>

#include "lod/surface/raster.h"
#include "server/base/document.h"
#include "server/base/format.h"
#include "server/documents/link.h"

#define OGC_TILES_REL "http://www.opengis.net/def/rel/ogc/1.0/"
#define OGC_TILES_SET "http://www.opengis.net/def/tilematrixset/OGC/1.0/WebMercatorQuad"
#define OGC_TILES_CRS "http://www.opengis.net/def/crs/EPSG/0/3857"
static const double OGC_TILES_SCALE0 = 559082264.0287178; /* of zoom 0 */
static const double OGC_TILES_HALF_M = 20037508.342789244;

/* A link below base. */
static json_t *ogc_tiles_link(const char *rel, const char *type, const char *base,
                              const struct dataset *d,
                              void (*to)(const struct link *l, struct buf *out), const char *title)
{
    char href[FILE_PATH_MAX + 256];
    const struct link l = {.from = LINK_ROOT, .up = base ? base : "", .ds = d->meta.name};
    return document_link(rel, type, link_text(to, &l, href, sizeof href), title);
}

/* What list and tileset both say. */
static json_t *ogc_tiles_about(const struct dataset *d)
{
    return json_pack("{s:s,s:s,s:s,s:s,s:[]}", "title", d->meta.name, "dataType", "map", "crs",
                     OGC_TILES_CRS, "tileMatrixSetURI", OGC_TILES_SET, "links");
}

static void ogc_tiles_add(json_t *o, json_t *link)
{
    json_array_append_new(json_object_get(o, "links"), link);
}

static json_t *ogc_tiles_to_tileset(const struct dataset *d, const char *rel, const char *base)
{
    return ogc_tiles_link(rel, "application/json", base, d, link_map_tileset,
                          "Map from straight above");
}

static json_t *ogc_tiles_to_matrices(const struct dataset *d, const char *base)
{
    return ogc_tiles_link(OGC_TILES_REL "tiling-scheme", "application/json", base, d, link_matrices,
                          "WebMercatorQuad");
}

enum err_code ogc_tiles_list(const struct dataset *d, const char *base, struct body **out,
                             struct err *e)
{
    json_t *tileset = ogc_tiles_about(d);
    ogc_tiles_add(tileset, ogc_tiles_to_tileset(d, "self", base));
    ogc_tiles_add(tileset, ogc_tiles_to_matrices(d, base));
    return document_make(json_pack("{s:[o],s:[o]}", "links",
                                   ogc_tiles_link("self", "application/json", base, d,
                                                  link_map_tilesets, "Tilesets"),
                                   "tilesets", tileset),
                         out, e);
}

static json_t *ogc_tiles_limits(const struct area *a)
{
    json_t *limits = json_array();
    for (int z = raster_zoom_min(a); z <= raster_zoom_max(a); z++) {
        char name[8];
        const int last = (int)((1u << z) - 1);
        snprintf(name, sizeof name, "%d", z);
        json_array_append_new(limits, json_pack("{s:s,s:i,s:i,s:i,s:i}", "tileMatrix", name,
                                                "minTileRow", 0, "maxTileRow", last, "minTileCol",
                                                0, "maxTileCol", last));
    }
    return limits;
}

enum err_code ogc_tiles_tileset(const struct dataset *d, const char *edition, const char *base,
                                struct body **out, struct err *e)
{
    static const enum format formats[] = {FORMAT_PNG, FORMAT_JPG, FORMAT_WEBP};
    static const char *const names[3] = {"tileMatrix", "tileCol", "tileRow"};
    const struct area *a = &d->area;
    const double low[2] = {a->west_deg, a->south_deg}, high[2] = {a->east_deg, a->north_deg};
    json_t *o = ogc_tiles_about(d);
    ogc_tiles_add(o, ogc_tiles_to_tileset(d, "self", base));
    ogc_tiles_add(o, ogc_tiles_to_matrices(d, base));
    for (size_t i = 0; i < sizeof formats / sizeof *formats; i++) {
        char href[FILE_PATH_MAX + 256];
        struct link l = link_to(LINK_ROOT, base ? base : "", d, edition);
        l.key_names = names;
        l.ext = format_ext(formats[i]);
        json_t *item = document_link("item", format_type(formats[i]),
                                     link_text(link_map, &l, href, sizeof href), "A map tile");
        json_object_set_new(item, "templated", json_true());
        ogc_tiles_add(o, item);
    }
    json_object_set_new(o, "tileMatrixSetLimits", ogc_tiles_limits(a));
    json_object_set_new(o, "boundingBox",
                        json_pack("{s:o,s:o,s:s}", "lowerLeft", document_numbers(low, 2),
                                  "upperRight", document_numbers(high, 2), "crs",
                                  "http://www.opengis.net/def/crs/OGC/1.3/CRS84"));
    if (d->meta.attribution[0])
        json_object_set_new(o, "attribution", json_string(d->meta.attribution));
    return document_make(o, out, e);
}

/* ---- the tile matrix set ---- */

static json_t *ogc_tiles_matrix(int z, bool of_2019)
{
    char name[8];
    const double side = (double)(1u << z), corner[2] = {-OGC_TILES_HALF_M, OGC_TILES_HALF_M};
    snprintf(name, sizeof name, "%d", z);
    json_t *o = json_pack("{s:s,s:f,s:o,s:i,s:i,s:i,s:i}", of_2019 ? "identifier" : "id", name,
                          "scaleDenominator", OGC_TILES_SCALE0 / side,
                          of_2019 ? "topLeftCorner" : "pointOfOrigin", document_numbers(corner, 2),
                          "tileWidth", RASTER_PX, "tileHeight", RASTER_PX, "matrixWidth",
                          (int)(1u << z), "matrixHeight", (int)(1u << z));
    if (!of_2019)
        json_object_set_new(o, "cellSize", json_real(2 * OGC_TILES_HALF_M / RASTER_PX / side));
    return o;
}

enum err_code ogc_tiles_matrices(struct body **out, struct err *e)
{
    static const char well_known[] = "http://www.opengis.net/def/wkss/OGC/1.0/GoogleMapsCompatible";
    const double low[2] = {-OGC_TILES_HALF_M, -OGC_TILES_HALF_M},
                 high[2] = {OGC_TILES_HALF_M, OGC_TILES_HALF_M};
    json_t *now = json_array(), *of_2019 = json_array();
    for (int z = 0; z <= KEY_ZOOM_MAX; z++) {
        json_array_append_new(now, ogc_tiles_matrix(z, false));
        json_array_append_new(of_2019, ogc_tiles_matrix(z, true));
    }
    return document_make(
        json_pack("{s:s,s:s,s:s,s:s,s:s,s:s,s:s,s:[s,s],s:{s:s,s:o,s:o},s:o,s:o}", "id",
                  "WebMercatorQuad", "identifier", "WebMercatorQuad", "title",
                  "Google Maps Compatible for the World", "uri", OGC_TILES_SET, "crs",
                  OGC_TILES_CRS, "supportedCRS", OGC_TILES_CRS, "wellKnownScaleSet", well_known,
                  "orderedAxes", "X", "Y", "boundingBox", "crs", OGC_TILES_CRS, "lowerLeft",
                  document_numbers(low, 2), "upperRight", document_numbers(high, 2), "tileMatrices",
                  now, "tileMatrix", of_2019),
        out, e);
}
