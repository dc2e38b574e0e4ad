/* TileJSON, a style of MapLibre, and WMTS capabilities: see map_document.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/map_document.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "lod/store/key.h"
#include "lod/surface/raster.h"
#include "server/base/document.h"
#include "server/base/text.h"
#include "server/documents/link.h"

static const double MAP_DOCUMENT_SCALE0 = 559082264.0287178; /* of zoom 0, WebMercatorQuad */
static const double MAP_DOCUMENT_HALF_M = 20037508.342789244;
enum { MAP_DOCUMENT_URL_MAX = TARGET_QUERY_MAX + FILE_PATH_MAX + 64 };

static void map_document_query(const struct map_document_ask *ask, char out[TARGET_QUERY_MAX])
{
    out[0] = '\0';
    if (!ask->appearance) {
        snprintf(out, TARGET_QUERY_MAX, "%s%s", ask->ground ? "?ground=true" : "",
                 ask->encoding != ENCODING_TERRARIUM ? ""
                 : ask->ground                       ? "&encoding=terrarium"
                                                     : "?encoding=terrarium");
    } else if (ask->appearance[0]) {
        strcpy(out, "?appearance=");
        text_escape(ask->appearance, out + strlen(out));
    }
}

/* base: as in map_document.h. */
static struct link map_document_link(const struct dataset *d, const char *edition, const char *base)
{
    return base && *base ? link_to(LINK_ROOT, base, d, edition)
                         : link_to(LINK_DATASET, NULL, d, edition);
}

/* What TileJSON and a source of a style have alike. */
static json_t *map_document_tiles(const struct dataset *d, const char *edition,
                                  const struct map_document_ask *ask, const char *base)
{
    const struct area *a = &d->area;
    const double bounds[4] = {a->west_deg, a->south_deg, a->east_deg, a->north_deg};
    char url[MAP_DOCUMENT_URL_MAX];
    struct link l = map_document_link(d, edition, base);
    l.ext = format_ext(FORMAT_WEBP);
    link_text(ask->appearance ? link_map : link_terrain, &l, url, sizeof url - TARGET_QUERY_MAX);
    map_document_query(ask, url + strlen(url));
    return json_pack("{s:[s],s:i,s:i,s:i,s:o}", "tiles", url, "minzoom", (int)raster_zoom_min(a),
                     "maxzoom", (int)(ask->ground ? raster_ground_zoom(a) : raster_zoom_max(a)),
                     "tileSize", RASTER_PX, "bounds", document_numbers(bounds, 4));
}

/* The members of `more`, whose reference it takes over, behind those of `o`. NULL: no memory. */
static json_t *map_document_join(json_t *o, json_t *more)
{
    const bool joined = o && more && !json_object_update(o, more);
    json_decref(more);
    if (joined)
        return o;
    json_decref(o);
    return NULL;
}

static json_t *map_document_center(const struct area *a)
{
    const double center[2] = {0.5 * (a->west_deg + a->east_deg),
                              0.5 * (a->south_deg + a->north_deg)};
    return document_numbers(center, 2);
}

enum err_code map_document_tilejson(const struct dataset *d, const char *edition,
                                    const struct map_document_ask *ask, const char *base,
                                    struct body **out, struct err *e)
{
    const struct area *a = &d->area;
    const int zoom_min = raster_zoom_min(a), zoom_max = raster_zoom_max(a);
    json_t *o =
        map_document_join(json_pack("{s:s,s:s,s:s,s:s}", "tilejson", "3.0.0", "name", d->meta.name,
                                    "attribution", d->meta.attribution, "scheme", "xyz"),
                          map_document_tiles(d, edition, ask, base));
    json_t *center = map_document_center(a);
    json_array_append_new(center, json_integer(zoom_min + 3 < zoom_max ? zoom_min + 3 : zoom_max));
    json_object_set_new(o, "center", center);
    if (!ask->appearance) {
        json_object_set_new(
            o, "encoding",
            json_string(ask->encoding == ENCODING_TERRARIUM ? "terrarium" : "mapbox"));
        char datum[HEIGHTS_WORDS_MAX];
        heights_datum(d->meta.heights, datum);
        json_object_set_new(o, "verticalDatum", json_string(datum));
        json_object_set_new(o, "voidHeight", json_real((double)raster_base_m(a)));
    }
    return document_make(o, out, e);
}

/* ---- a style ---- */

static const double MAP_DOCUMENT_FIT_PX = 480, /* edge of the survey in the first picture */
    MAP_DOCUMENT_PITCH_DEG = 45, MAP_DOCUMENT_SHADE = 0.25;
enum {
    MAP_DOCUMENT_WORLD_PX = 512,  /* of MapLibre at zoom 0 */
    MAP_DOCUMENT_COARSE_ZOOMS = 2 /* beyond the first, of what lies under holes */
};

/* The zoom at which the survey is MAP_DOCUMENT_FIT_PX wide or high. */
static double map_document_zoom(const struct area *a)
{
    double north_west[2], south_east[2];
    key_place(a->west_deg, a->north_deg, north_west);
    key_place(a->east_deg, a->south_deg, south_east);
    const double edge = fmax(south_east[0] - north_west[0], south_east[1] - north_west[1]);
    return edge > 0 ? log2(MAP_DOCUMENT_FIT_PX / (MAP_DOCUMENT_WORLD_PX * edge))
                    : (double)raster_zoom_max(a);
}

/* Heights have no bounds: terrain tiles beyond the survey are flat at its floor, and without them
 * MapLibre would have the city on a block above height 0. Terrain and hillshade have a source each,
 * because MapLibre asks for that. */
static json_t *map_document_sources(const struct dataset *d, const char *edition,
                                    const char *appearance, const char *base)
{
    const struct map_document_ask colours = {.appearance = appearance},
                                  terrain = {.appearance = NULL, .ground = true};
    json_t *city = map_document_join(
        json_pack("{s:s,s:s}", "type", "raster", "attribution", d->meta.attribution),
        map_document_tiles(d, edition, &colours, base));
    json_t *heights =
        map_document_join(json_pack("{s:s,s:s}", "type", "raster-dem", "encoding", "mapbox"),
                          map_document_tiles(d, edition, &terrain, base));
    json_object_del(heights, "bounds");
    json_t *coarse = json_deep_copy(city); /* its pixels have no holes where finer ones do */
    json_object_set_new(coarse, "maxzoom",
                        json_integer(raster_zoom_min(&d->area) + MAP_DOCUMENT_COARSE_ZOOMS));
    return json_pack("{s:o,s:o,s:O,s:o}", "city", city, "coarse", coarse, "terrain", heights,
                     "hillshade", heights);
}

static json_t *map_document_layers(void)
{
    return json_pack("[{s:s,s:s,s:{s:s}},{s:s,s:s,s:s},{s:s,s:s,s:s},{s:s,s:s,s:s,s:{s:f}}]", "id",
                     "background", "type", "background", "paint", "background-color", "#c9ccc4",
                     "id", "coarse", "type", "raster", "source", "coarse", "id", "city", "type",
                     "raster", "source", "city", "id", "hillshade", "type", "hillshade", "source",
                     "hillshade", "paint", "hillshade-exaggeration", MAP_DOCUMENT_SHADE);
}

enum err_code map_document_style(const struct dataset *d, const char *edition,
                                 const char *appearance, const char *base, struct body **out,
                                 struct err *e)
{
    return document_make(
        json_pack("{s:i,s:s,s:o,s:f,s:f,s:o,s:{s:s,s:i},s:o}", "version", 8, "name", d->meta.name,
                  "center", map_document_center(&d->area), "zoom", map_document_zoom(&d->area),
                  "pitch", MAP_DOCUMENT_PITCH_DEG, "sources",
                  map_document_sources(d, edition, appearance, base), "terrain", "source",
                  "terrain", "exaggeration", 1, "layers", map_document_layers()),
        out, e);
}

/* ---- WMTS ---- */

static void map_document_layer(struct buf *b, const struct dataset *d,
                               const struct map_document_ask *ask, struct link l)
{
    static const enum format formats[] = {FORMAT_PNG, FORMAT_WEBP, FORMAT_JPG};
    static const char *const names[3] = {"TileMatrix", "TileCol", "TileRow"};
    const struct area *a = &d->area;
    char url[MAP_DOCUMENT_URL_MAX];
    l.key_names = names;
    buf_printf(b, "<Layer>\n<ows:Title>%s</ows:Title>\n<ows:Abstract>", d->meta.name);
    buf_markup(b, d->meta.attribution);
    buf_printf(b,
               "</ows:Abstract>\n<ows:WGS84BoundingBox>"
               "<ows:LowerCorner>%.9f %.9f</ows:LowerCorner>"
               "<ows:UpperCorner>%.9f %.9f</ows:UpperCorner></ows:WGS84BoundingBox>\n"
               "<ows:Identifier>%s</ows:Identifier>\n"
               "<Style isDefault=\"true\"><ows:Identifier>default</ows:Identifier></Style>\n",
               a->west_deg, a->south_deg, a->east_deg, a->north_deg, d->meta.name);
    for (size_t i = 0; i < sizeof formats / sizeof *formats; i++)
        buf_printf(b, "<Format>%s</Format>\n", format_type(formats[i]));
    buf_printf(b, "<TileMatrixSetLink><TileMatrixSet>WebMercatorQuad</TileMatrixSet>"
                  "</TileMatrixSetLink>\n");
    for (size_t i = 0; i < sizeof formats / sizeof *formats; i++) {
        buf_printf(b, "<ResourceURL format=\"%s\" resourceType=\"tile\" template=\"",
                   format_type(formats[i]));
        l.ext = format_ext(formats[i]);
        link_text(link_map, &l, url, sizeof url - TARGET_QUERY_MAX);
        map_document_query(ask, url + strlen(url));
        buf_markup(b, url);
        buf_printf(b, "\"/>\n");
    }
    buf_printf(b, "</Layer>\n");
}

static void map_document_matrices(struct buf *b, int zoom_max)
{
    buf_printf(b, "<TileMatrixSet>\n<ows:Identifier>WebMercatorQuad</ows:Identifier>\n"
                  "<ows:SupportedCRS>urn:ogc:def:crs:EPSG::3857</ows:SupportedCRS>\n"
                  "<WellKnownScaleSet>urn:ogc:def:wkss:OGC:1.0:GoogleMapsCompatible"
                  "</WellKnownScaleSet>\n");
    for (int z = 0; z <= zoom_max; z++) {
        unsigned side = 1u << z;
        buf_printf(b,
                   "<TileMatrix><ows:Identifier>%d</ows:Identifier>"
                   "<ScaleDenominator>%.10f</ScaleDenominator>"
                   "<TopLeftCorner>%.9f %.9f</TopLeftCorner>"
                   "<TileWidth>%d</TileWidth><TileHeight>%d</TileHeight>"
                   "<MatrixWidth>%u</MatrixWidth><MatrixHeight>%u</MatrixHeight></TileMatrix>\n",
                   z, MAP_DOCUMENT_SCALE0 / side, -MAP_DOCUMENT_HALF_M, MAP_DOCUMENT_HALF_M,
                   RASTER_PX, RASTER_PX, side, side);
    }
    buf_printf(b, "</TileMatrixSet>\n");
}

enum err_code map_document_wmts(const struct dataset *d, const char *edition,
                                const char *appearance, const char *base, struct body **out,
                                struct err *e)
{
    struct buf b = {0};
    const struct link l = link_to(LINK_ROOT, base, d, edition);
    const struct map_document_ask ask = {.appearance = appearance};
    char self[MAP_DOCUMENT_URL_MAX];
    if (!base || !*base)
        return err_set(e, ERR_ARG,
                       "clients of WMTS need absolute addresses: start the server with "
                       "--public-url URL, the address that they see");
    buf_printf(&b,
               "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n"
               "<Capabilities xmlns=\"http://www.opengis.net/wmts/1.0\" "
               "xmlns:ows=\"http://www.opengis.net/ows/1.1\" "
               "xmlns:xlink=\"http://www.w3.org/1999/xlink\" version=\"1.0.0\">\n"
               "<ows:ServiceIdentification><ows:Title>%s</ows:Title>"
               "<ows:ServiceType>OGC WMTS</ows:ServiceType>"
               "<ows:ServiceTypeVersion>1.0.0</ows:ServiceTypeVersion>"
               "</ows:ServiceIdentification>\n<Contents>\n",
               d->meta.name);
    map_document_layer(&b, d, &ask, l);
    map_document_matrices(&b, raster_zoom_max(&d->area));
    buf_printf(&b, "</Contents>\n<ServiceMetadataURL xlink:href=\"");
    link_text(link_wmts, &l, self, sizeof self - TARGET_QUERY_MAX);
    map_document_query(&ask, self + strlen(self));
    buf_markup(&b, self);
    buf_printf(&b, "\"/>\n</Capabilities>\n");
    return document_take(buf_check(&b, e), &b, out, e);
}
