/* TileJSON and WMTS capabilities: see map_document.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/map_document.h"

#include <jansson.h>
#include <stdio.h>
#include <string.h>

#include "lod/raster.h"
#include "server/document.h"

static const double MAP_DOCUMENT_SCALE0 = 559082264.0287178; /* of zoom 0, WebMercatorQuad */
static const double MAP_DOCUMENT_HALF_M = 20037508.342789244;
enum { MAP_DOCUMENT_URL_MAX = TARGET_QUERY_MAX + FILE_PATH_MAX + 64 };

/* The address of a dataset's revision, with '/' at its end. */
static void map_document_root(const struct dataset *d, const char *edition, const char *base,
                              char *out, size_t room)
{
    const char *dash = *edition ? "-" : "";
    size_t n = base ? strlen(base) : 0;
    while (n && base[n - 1] == '/')
        n--;
    if (n)
        snprintf(out, room, "%.*s/d/%s/r/%s%s%s/", (int)n, base, d->meta.name, d->meta.revision,
                 dash, edition);
    else
        snprintf(out, room, "r/%s%s%s/", d->meta.revision, dash, edition);
}

static void map_document_query(const struct target *t, char out[TARGET_QUERY_MAX])
{
    out[0] = '\0';
    if (t->route == ROUTE_TERRAINJSON) {
        if (t->encoding == ENCODING_TERRARIUM)
            snprintf(out, TARGET_QUERY_MAX, "?encoding=terrarium");
    } else if (t->appearance[0]) {
        strcpy(out, "?appearance=");
        target_escape(t->appearance, out + strlen(out));
    }
}

enum err_code map_document_tilejson(const struct dataset *d, const char *edition,
                                    const struct target *t, const char *base, struct body **out,
                                    struct err *e)
{
    const struct area *a = &d->area;
    char root[FILE_PATH_MAX], query[TARGET_QUERY_MAX], url[MAP_DOCUMENT_URL_MAX];
    bool terrain = t->route == ROUTE_TERRAINJSON;
    const double bounds[4] = {a->west_deg, a->south_deg, a->east_deg, a->north_deg};
    int zoom_min = raster_zoom_min(a), zoom_max = raster_zoom_max(a);
    map_document_root(d, edition, base, root, sizeof root);
    map_document_query(t, query);
    snprintf(url, sizeof url, "%s%s/{z}/{x}/{y}.%s%s", root, terrain ? "terrain" : "map",
             terrain ? "png" : "webp", query);
    json_t *o =
        json_pack("{s:s,s:s,s:s,s:s,s:[s],s:i,s:i,s:i,s:o,s:[f,f,i]}", "tilejson", "3.0.0", "name",
                  d->meta.name, "attribution", d->meta.attribution, "scheme", "xyz", "tiles", url,
                  "minzoom", zoom_min, "maxzoom", zoom_max, "tileSize", RASTER_PX, "bounds",
                  document_numbers(bounds, 4), "center", 0.5 * (bounds[0] + bounds[2]),
                  0.5 * (bounds[1] + bounds[3]), zoom_min + 3 < zoom_max ? zoom_min + 3 : zoom_max);
    if (terrain) {
        json_object_set_new(
            o, "encoding", json_string(t->encoding == ENCODING_TERRARIUM ? "terrarium" : "mapbox"));
        char datum[HEIGHTS_WORDS_MAX];
        heights_datum(d->meta.heights, datum);
        json_object_set_new(o, "verticalDatum", json_string(datum));
        json_object_set_new(o, "voidHeight", json_real((double)raster_base_m(a)));
    }
    return document_make(o, out, e);
}

/* ---- WMTS ---- */

static void map_document_layer(struct buf *b, const struct dataset *d, const struct target *t,
                               const char *root)
{
    static const enum format formats[] = {FORMAT_PNG, FORMAT_WEBP, FORMAT_JPG};
    const struct area *a = &d->area;
    char query[TARGET_QUERY_MAX];
    map_document_query(t, query);
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
        buf_printf(b, "<Format>%s</Format>\n", target_type(formats[i]));
    buf_printf(b, "<TileMatrixSetLink><TileMatrixSet>WebMercatorQuad</TileMatrixSet>"
                  "</TileMatrixSetLink>\n");
    for (size_t i = 0; i < sizeof formats / sizeof *formats; i++) {
        buf_printf(b, "<ResourceURL format=\"%s\" resourceType=\"tile\" template=\"",
                   target_type(formats[i]));
        buf_markup(b, root);
        buf_printf(b, "map/{TileMatrix}/{TileCol}/{TileRow}.%s%s\"/>\n", target_ext(formats[i]),
                   query);
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
                                const struct target *t, const char *base, struct body **out,
                                struct err *e)
{
    struct buf b = {0};
    char root[FILE_PATH_MAX], self[FILE_PATH_MAX], query[TARGET_QUERY_MAX];
    if (!base || !*base)
        return err_set(e, ERR_ARG,
                       "clients of WMTS need absolute addresses: start the server with "
                       "--public-url URL, the address that they see");
    map_document_root(d, edition, base, root, sizeof root);
    map_document_root(d, "", base, self, sizeof self);
    size_t n = strlen(self) - strlen("r//") - strlen(d->meta.revision);
    snprintf(self + n, sizeof self - n, "wmts.xml");
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
    map_document_layer(&b, d, t, root);
    map_document_matrices(&b, raster_zoom_max(&d->area));
    buf_printf(&b, "</Contents>\n<ServiceMetadataURL xlink:href=\"");
    buf_markup(&b, self);
    map_document_query(t, query);
    buf_markup(&b, query);
    buf_printf(&b, "\"/>\n</Capabilities>\n");
    return document_take(buf_check(&b, e), &b, out, e);
}
