/* OpenAPI 3.0.3, made from the route table: paths and methods are those that are served, parameters
 * are looked up by their names in the paths. What each route answers with is in openapi_answers.
 *
 * Brackets in a route's template stand for what may be left out; a path of OpenAPI cannot say that,
 * so it has the long form.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/openapi.h"

#include <jansson.h>
#include <stdio.h>
#include <string.h>

#include "codec/quant.h"
#include "server/document.h"
#include "server/openapi_schemas.h"
#include "server/target.h"

enum { OPENAPI_PATH = 256 };

/* ---- what routes answer with ---- */

/* Query parameters of a route, as bits. */
enum {
    OPENAPI_APPEARANCE = 1,
    OPENAPI_PRESET = 2, /* and sh, clip */
    OPENAPI_SEED = 4,   /* bbox, z, f, the way of a camera, pages */
    OPENAPI_BBOX = 8,
    OPENAPI_VIEW = 16, /* background, depth */
    OPENAPI_ENCODING = 32,
    OPENAPI_PLACE = 64, /* lon, lat */
    OPENAPI_SEARCH = 256,
    OPENAPI_TINT = 128 /* appearance of tiles, which may be none */
};
static const struct openapi_answer {
    const char *media, *schema; /* media NULL: a redirect; schema NULL: Document */
    unsigned query;
    const char *more[3]; /* further media types, of bytes */
} openapi_answers[ROUTE_COUNT] = {
    [ROUTE_LANDING] = {.media = "application/json", .schema = "Landing"},
    [ROUTE_CONFORMANCE] = {.media = "application/json", .schema = "Conformance"},
    [ROUTE_API] = {.media = "application/vnd.oai.openapi+json;version=3.0", .schema = "Document"},
    [ROUTE_API_PAGE] = {.media = "text/html", .schema = "Text"},
    [ROUTE_COLLECTIONS] = {.media = "application/json",
                           .schema = "Collections",
                           .query = OPENAPI_BBOX},
    [ROUTE_COLLECTION] = {.media = "application/json", .schema = "Collection"},
    [ROUTE_MAP_TILESETS] = {.media = "application/json", .schema = "Document"},
    [ROUTE_MAP_TILESET] = {.media = "application/json", .schema = "Document"},
    [ROUTE_MATRICES] = {.media = "application/json", .schema = "Document"},
    [ROUTE_TILEJSON] = {.media = "application/json", .schema = "TileJSON"},
    [ROUTE_TILESET_MOVING] = {.media = "application/json",
                              .schema = "Tileset",
                              .query = OPENAPI_TINT | OPENAPI_PRESET},
    [ROUTE_TILESET] = {.media = "application/json",
                       .schema = "Tileset",
                       .query = OPENAPI_TINT | OPENAPI_PRESET},
    [ROUTE_TILESET_PART] = {.media = "application/json",
                            .schema = "Tileset",
                            .query = OPENAPI_TINT | OPENAPI_PRESET},
    [ROUTE_TILE] = {.media = "model/gltf-binary",
                    .schema = "Bytes",
                    .query = OPENAPI_TINT | OPENAPI_PRESET,
                    .more = {"application/octet-stream"}},
    [ROUTE_TILE_MOVING] = {.media = NULL, .schema = NULL, .query = OPENAPI_TINT | OPENAPI_PRESET},
    [ROUTE_VIEW] = {.media = "image/jpeg",
                    .schema = "Bytes",
                    .query = OPENAPI_APPEARANCE | OPENAPI_VIEW,
                    .more = {"image/png", "image/webp", "application/octet-stream"}},
    [ROUTE_VIEW_MOVING] = {.media = NULL,
                           .schema = NULL,
                           .query = OPENAPI_APPEARANCE | OPENAPI_VIEW},
    [ROUTE_APPEARANCES] = {.media = "application/json",
                           .schema = "Appearances",
                           .query = OPENAPI_SEARCH},
    [ROUTE_APPEARANCE] = {.media = "application/json",
                          .schema = "Appearance",
                          .query = OPENAPI_APPEARANCE},
    [ROUTE_KEPT] = {.media = "application/json", .schema = "Kept"},
    [ROUTE_MIX] = {.media = "application/json", .schema = "Appearance"},
    [ROUTE_RENDER] = {.media = "image/jpeg",
                      .schema = "Bytes",
                      .query = 0,
                      .more = {"image/png", "image/webp", "application/octet-stream"}},
    [ROUTE_MOTION] = {.media = "multipart/x-mixed-replace", .schema = "Bytes"},
    [ROUTE_SEED_MOVING] = {.media = "application/x-ndjson",
                           .schema = "SeedLine",
                           .query = OPENAPI_TINT | OPENAPI_PRESET | OPENAPI_SEED},
    [ROUTE_SEED] = {.media = "application/x-ndjson",
                    .schema = "SeedLine",
                    .query = OPENAPI_TINT | OPENAPI_PRESET | OPENAPI_SEED},
    [ROUTE_MAP] = {.media = "image/webp",
                   .schema = "Bytes",
                   .query = OPENAPI_APPEARANCE,
                   .more = {"image/png", "image/jpeg"}},
    [ROUTE_MAP_MOVING] = {.media = NULL, .schema = NULL, .query = OPENAPI_APPEARANCE},
    [ROUTE_TERRAIN] = {.media = "image/png", .schema = "Bytes", .query = OPENAPI_ENCODING},
    [ROUTE_TERRAIN_MOVING] = {.media = NULL, .schema = NULL, .query = OPENAPI_ENCODING},
    [ROUTE_MAPJSON] = {.media = "application/json",
                       .schema = "TileJSON",
                       .query = OPENAPI_APPEARANCE},
    [ROUTE_TERRAINJSON] = {.media = "application/json",
                           .schema = "TileJSON",
                           .query = OPENAPI_ENCODING},
    [ROUTE_WMTS] = {.media = "application/xml", .schema = "Text", .query = OPENAPI_APPEARANCE},
    [ROUTE_HEIGHT] = {.media = "application/json", .schema = "Document", .query = OPENAPI_PLACE},
    [ROUTE_PICK] = {.media = "application/json", .schema = "Document"},
    [ROUTE_PROFILE] = {.media = "application/json", .schema = "Document"},
    [ROUTE_MEASURE] = {.media = "application/json", .schema = "Document"},
    [ROUTE_VISIBLE] = {.media = "application/json", .schema = "Document"},
    [ROUTE_MODEL] = {.media = "application/json", .schema = "Document"},
    [ROUTE_PHOTOGRAPHS] = {.media = "application/json", .schema = "Document"},
    [ROUTE_THUMBNAIL] = {.media = "image/jpeg", .schema = "Bytes"},
    [ROUTE_HEALTH] = {.media = "application/json", .schema = "State"},
    [ROUTE_READY] = {.media = "application/json", .schema = "State"},
    [ROUTE_VERSION] = {.media = "application/json", .schema = "Version"},
    [ROUTE_METRICS] = {.media = "text/plain; version=0.0.4; charset=utf-8", .schema = "Text"},
};

/* ---- parameters ---- */

struct openapi_parameter {
    const char *name, *schema, *about;
};
static const struct openapi_parameter openapi_in_path[] = {
    {"ds", "{'type':'string','pattern':'^[a-z0-9][a-z0-9_-]{0,62}$'}", "name of a dataset"},
    {"rev", "{'type':'string','pattern':'^[0-9a-f]{12}(-[0-9a-f]{8})?$'}",
     "revision of a dataset, and edition"},
    {"z", "{'type':'integer','minimum':0,'maximum':24}", "zoom of Web Mercator"},
    {"x", "{'type':'integer','minimum':0}", "column, from 180 degrees west"},
    {"y", "{'type':'integer','minimum':0}", "row, from the north"},
    {"ext", "{'type':'string','enum':['glb','spz','drc','ply','plain.glb','compressed.ply','sog']}",
     "format of a tile"},
    {"fmt", "{'type':'string','enum':['jpg','png','webp','npy']}",
     "format of a picture; npy of depth alone"},
    {"name", "{'type':'string','pattern':'^[a-z0-9][a-z0-9_-]{0,62}$'}",
     "that an appearance is kept under; neither default nor none"},
    {"stream", "{'type':'string','pattern':'^[a-z0-9][a-z0-9_-]{15,62}$'}",
     "a name that whoever opens the stream makes by chance"},
    {"lon", "{'type':'number','minimum':-180,'maximum':180}", "degrees"},
    {"lat", "{'type':'number','minimum':-90,'maximum':90}", "degrees"},
    {"height", OPENAPI_NUMBER, "metres above the WGS 84 ellipsoid"},
    {"heading", "{'type':'number','minimum':-360,'maximum':360}", "degrees, clockwise from north"},
    {"pitch", "{'type':'number','minimum':-90,'maximum':90}", "degrees above the horizon"},
    {"fov", "{'type':'number','minimum':1,'maximum':150}",
     "vertical field of view, degrees; 60 where it is left out"},
    {"roll", "{'type':'number','minimum':-360,'maximum':360}",
     "degrees, clockwise; 0 where it is left out"},
    {"w", "{'type':'integer','minimum':1}", "width, pixels"},
    {"h", "{'type':'integer','minimum':1}", "height, pixels"},
    {"s", "{'type':'integer','minimum':1,'maximum':4}",
     "so many pixels a unit of width and height"},
};
static const struct {
    unsigned bit;
    struct openapi_parameter is;
} openapi_in_query[] = {
    {OPENAPI_SEARCH,
     {"bbox", OPENAPI_TEXT, "west,south,east,north in degrees: photographs taken within"}},
    {OPENAPI_SEARCH,
     {"near", OPENAPI_TEXT, "lon,lat or lon,lat,radius: the nearest to a place, within metres"}},
    {OPENAPI_SEARCH,
     {"datetime", OPENAPI_TEXT,
      "a date, a time of RFC 3339, or an interval, as in 2024-06-01/..; by the cameras' clocks"}},
    {OPENAPI_SEARCH,
     {"hours", "{'type':'string','pattern':'^[0-9]{1,2}-[0-9]{1,2}$'}",
      "hours of the day, as in 17-20"}},
    {OPENAPI_SEARCH,
     {"colour", "{'type':'string','pattern':'^[0-9a-fA-F]{6}$'}",
      "RRGGBB: the nearest in what their light makes of mid grey"}},
    {OPENAPI_SEARCH,
     {"kept", "{'type':'string','enum':['true']}", "those that are kept under names alone"}},
    {OPENAPI_SEARCH,
     {"sort", "{'type':'string','enum':['number','distance','time','colour']}",
      "distance where near is given, else colour where that is, else number"}},
    {OPENAPI_SEARCH,
     {"limit", "{'type':'integer','minimum':1,'maximum':1000}", "100 where it is left out"}},
    {OPENAPI_SEARCH,
     {"after", "{'type':'integer','minimum':0,'maximum':999999999}",
      "so many are left out before"}},
    {OPENAPI_SEED | OPENAPI_BBOX,
     {"bbox", OPENAPI_TEXT, "west,south,east,north in degrees: what meets this area"}},
    {OPENAPI_SEED, {"z", OPENAPI_TEXT, "a zoom, or two as in 12-16"}},
    {OPENAPI_SEED,
     {"f", "{'type':'string','enum':['glb','spz','drc','ply','plain.glb','compressed.ply','sog']}",
      "format of the tiles"}},
    {OPENAPI_SEED,
     {"path", OPENAPI_TEXT,
      "what a camera sees: lon,lat,height@heading,pitch, or several of them joined by ; that it "
      "flies through"}},
    {OPENAPI_SEED,
     {"size", "{'type':'string','pattern':'^[0-9]+x[0-9]+$'}",
      "of the camera's picture, WxH pixels; 1280x720 where it is left out"}},
    {OPENAPI_SEED,
     {"fov", "{'type':'number','minimum':1,'maximum':150}",
      "vertical field of view, degrees; 60 where it is left out"}},
    {OPENAPI_SEED,
     {"error", "{'type':'number','minimum':0.5,'maximum':1000}",
      "screen space error that the client refines above, pixels; 16 where it is left out"}},
    {OPENAPI_SEED,
     {"speed", "{'type':'number','minimum':0.1,'maximum':1000}",
      "metres a second along the path, 20 where it is left out; of one position: straight ahead"}},
    {OPENAPI_SEED,
     {"horizon", "{'type':'number','minimum':0.1,'maximum':3600}",
      "seconds from its beginning that are listed; where it is left out all of a path, 10 s "
      "straight ahead"}},
    {OPENAPI_SEED,
     {"after", "{'type':'integer','minimum':0,'maximum':999999999}",
      "lines that are left out before"}},
    {OPENAPI_SEED,
     {"limit", "{'type':'integer','minimum':1,'maximum':100000}",
      "most lines; 10000 where it is left out"}},
    {OPENAPI_PRESET,
     {"preset", "{'type':'string','enum':['spz','preview','balanced','near-lossless']}",
      "how fine glb, spz and drc are"}},
    {OPENAPI_PRESET,
     {"sh", "{'type':'integer','minimum':0,'maximum':3}", "highest band of harmonics"}},
    {OPENAPI_PRESET,
     {"clip", OPENAPI_TEXT,
      "lon,lat,lon,lat,... of a polygon of 3 to 40 corners: what lies within it alone"}},
    {OPENAPI_VIEW,
     {"background", OPENAPI_TEXT,
      "RRGGBB, sky, or transparent (png and webp); black where it is left out"}},
    {OPENAPI_VIEW,
     {"depth", "{'type':'string','enum':['mm','cm','dm','m']}",
      "of png: depth in place of colours, 16 bits in this unit; npy is depth in metres"}},
    {OPENAPI_VIEW,
     {"supersample", "{'type':'integer','minimum':1,'maximum':4}",
      "pixels drawn for one on each axis; 2 from far away and 1 else where it is left out"}},
    {OPENAPI_ENCODING,
     {"encoding", "{'type':'string','enum':['mapbox','terrarium']}", "how colours hold heights"}},
    {OPENAPI_PLACE, {"lon", OPENAPI_NUMBER, "longitude, degrees"}},
    {OPENAPI_PLACE, {"lat", OPENAPI_NUMBER, "latitude, degrees"}},
    {OPENAPI_APPEARANCE,
     {"appearance", OPENAPI_TEXT,
      "a photograph, NAME:WEIGHT,NAME:WEIGHT, =BASE64 of an embedding, or a name that is kept"}},
    {OPENAPI_TINT,
     {"appearance", OPENAPI_TEXT,
      "a photograph, NAME:WEIGHT,NAME:WEIGHT, =BASE64 of an embedding, a name that is kept, or "
      "none: colours as they were trained, for clients that compute appearances themselves"}},
};

/* A schema's text to JSON. */
static json_t *openapi_json(const char *text)
{
    struct buf b = {0};
    for (const char *p = text; *p; p++)
        buf_u8(&b, *p == '\'' ? '"' : (unsigned char)*p);
    json_t *o = b.failed ? NULL : json_loadb((const char *)b.data, b.size, JSON_DECODE_ANY, NULL);
    buf_free(&b);
    return o;
}

static json_t *openapi_parameter_json(const struct openapi_parameter *p, const char *in)
{
    return json_pack("{s:s,s:s,s:b,s:s,s:o}", "name", p->name, "in", in, "required",
                     !strcmp(in, "path"), "description", p->about, "schema",
                     openapi_json(p->schema));
}

static json_t *openapi_parameters(const char *path, unsigned query)
{
    json_t *list = json_array();
    for (const char *p = strchr(path, '{'); p; p = strchr(p + 1, '{')) {
        size_t n = strcspn(p + 1, "}");
        char name[32];
        snprintf(name, sizeof name, "%.*s", (int)n, p + 1);
        struct openapi_parameter unknown = {name, OPENAPI_TEXT, "a part of the address"};
        const struct openapi_parameter *is = &unknown;
        for (size_t i = 0; i < sizeof openapi_in_path / sizeof *openapi_in_path; i++)
            if (!strcmp(openapi_in_path[i].name, name))
                is = &openapi_in_path[i];
        json_array_append_new(list, openapi_parameter_json(is, "path"));
    }
    for (size_t i = 0; i < sizeof openapi_in_query / sizeof *openapi_in_query; i++)
        if (query & openapi_in_query[i].bit)
            json_array_append_new(list, openapi_parameter_json(&openapi_in_query[i].is, "query"));
    return list;
}

/* ---- operations ---- */

static json_t *openapi_content(const char *media, const char *schema)
{
    char ref[80];
    snprintf(ref, sizeof ref, "#/components/schemas/%s", schema);
    return json_pack("{s:{s:{s:s}}}", media, "schema", "$ref", ref);
}

static json_t *openapi_responses(const struct openapi_answer *a, bool post)
{
    json_t *o = json_object();
    if (a->media) {
        const char *schema = a->schema ? a->schema : "Document";
        json_t *content = openapi_content(a->media, schema);
        for (size_t i = 0; i < 3 && a->more[i]; i++) {
            json_t *more = openapi_content(a->more[i], schema);
            json_object_update(content, more);
            json_decref(more);
        }
        json_object_set_new(
            o, "200", json_pack("{s:s,s:o}", "description", "The resource", "content", content));
        if (!post)
            json_object_set_new(o, "304", json_pack("{s:s}", "description", "You have it already"));
    } else {
        json_object_set_new(o, "307",
                            json_pack("{s:s,s:{s:{s:s,s:{s:s}}}}", "description",
                                      "It is in the current revision", "headers", "Location",
                                      "description", "relative to the request's path", "schema",
                                      "type", "string"));
    }
    json_object_set_new(o, "default",
                        json_pack("{s:s,s:o}", "description", "A problem document, RFC 9457",
                                  "content",
                                  openapi_content("application/problem+json", "Problem")));
    return o;
}

/* What a route takes as a body; other routes that take one take a document. */
static const char *openapi_takes(enum route r)
{
    static const struct {
        enum route route;
        const char *schema;
    } takes[] = {{ROUTE_RENDER, "Render"},   {ROUTE_MIX, "Mix"},         {ROUTE_KEPT, "Mix"},
                 {ROUTE_HEIGHT, "Places"},   {ROUTE_PICK, "Pick"},       {ROUTE_PROFILE, "Profile"},
                 {ROUTE_MEASURE, "Measure"}, {ROUTE_VISIBLE, "Visible"}, {ROUTE_MOTION, "Steer"}};
    for (size_t i = 0; i < sizeof takes / sizeof *takes; i++)
        if (takes[i].route == r)
            return takes[i].schema;
    return "Document";
}

static json_t *openapi_operation(enum route r, bool post, const char *name, const char *summary,
                                 const char *path)
{
    const struct openapi_answer *a = &openapi_answers[r];
    const struct openapi_answer unknown = {"application/octet-stream", "Bytes", 0, {NULL}};
    bool both = target_allow(r) == (ALLOW_READ | ALLOW_POST);
    char id[64];
    if (!a->media && !strstr(name, "_MOVING"))
        a = &unknown;
    snprintf(id, sizeof id, "%s%s", name, both && post ? "_POST" : "");
    json_t *o = json_pack("{s:s,s:s,s:o,s:o}", "operationId", id, "summary", summary, "parameters",
                          openapi_parameters(path, both && post ? 0 : a->query), "responses",
                          openapi_responses(a, post));
    if (post)
        json_object_set_new(o, "requestBody",
                            json_pack("{s:b,s:o}", "required", 1, "content",
                                      openapi_content("application/json", openapi_takes(r))));
    return o;
}

/* PUT or DELETE of what is kept under a name. */
static json_t *openapi_change(enum route r, bool removes, const char *name, const char *path)
{
    static const struct {
        const char *status, *about;
    } ends[] = {{"204", "Done: there was one, of the same or of another appearance"},
                {"412", "If-Match or If-None-Match does not hold"}};
    char id[64];
    snprintf(id, sizeof id, "%s_%s", name, removes ? "DELETE" : "PUT");
    json_t *o = json_pack("{s:s,s:s,s:o}", "operationId", id, "summary",
                          removes ? "Forget the name" : "Keep an appearance under a name",
                          "parameters", openapi_parameters(path, 0));
    json_t *all = json_object();
    for (size_t i = 0; i < sizeof ends / sizeof *ends; i++)
        json_object_set_new(all, ends[i].status, json_pack("{s:s}", "description", ends[i].about));
    if (!removes) {
        json_object_set_new(all, "201",
                            json_pack("{s:s,s:o}", "description", "It is kept; the name is new",
                                      "content", openapi_content("application/json", "Kept")));
        json_object_set_new(o, "requestBody",
                            json_pack("{s:b,s:o}", "required", 1, "content",
                                      openapi_content("application/json", openapi_takes(r))));
    }
    json_object_set_new(all, "default",
                        json_pack("{s:s,s:o}", "description", "A problem document, RFC 9457",
                                  "content",
                                  openapi_content("application/problem+json", "Problem")));
    json_object_set_new(o, "responses", all);
    return o;
}

/* A route's template without its brackets. */
static void openapi_path(enum route r, char out[OPENAPI_PATH])
{
    size_t n = 0;
    for (const char *p = target_path(r); *p && n + 1 < OPENAPI_PATH; p++)
        if (*p != '[' && *p != ']')
            out[n++] = *p;
    out[n] = '\0';
}

enum err_code openapi_describe(struct body **out, struct err *e)
{
    static const struct {
        const char *name, *summary;
    } names[] = {
#define ROUTE_NAME(id, allow, path, summary) {#id, summary},
        ROUTE_LIST(ROUTE_NAME)
#undef ROUTE_NAME
    };
    static const struct {
        const char *name, *schema;
    } schemas[] = {
#define SCHEMA_ROW(name, schema) {name, schema},
        OPENAPI_SCHEMAS(SCHEMA_ROW)
#undef SCHEMA_ROW
    };
    json_t *paths = json_object(), *shapes = json_object();
    for (int r = 0; r < ROUTE_NONE; r++) {
        char path[OPENAPI_PATH];
        if (r == ROUTE_STATIC)
            continue;
        openapi_path((enum route)r, path);
        json_t *verbs = json_object();
        for (int post = 0; post < 2; post++)
            if (target_allow((enum route)r) & (post ? ALLOW_POST : ALLOW_READ))
                json_object_set_new(
                    verbs, post ? "post" : "get",
                    openapi_operation((enum route)r, post, names[r].name, names[r].summary, path));
        for (int removes = 0; removes < 2 && target_allow((enum route)r) & ALLOW_CHANGE; removes++)
            json_object_set_new(verbs, removes ? "delete" : "put",
                                openapi_change((enum route)r, removes, names[r].name, path));
        json_object_set_new(paths, path, verbs);
    }
    for (size_t i = 0; i < sizeof schemas / sizeof *schemas; i++)
        json_object_set_new(shapes, schemas[i].name, openapi_json(schemas[i].schema));
    json_t *o =
        json_pack("{s:s,s:{s:s,s:s,s:s,s:{s:s,s:s}},s:[{s:s}],s:o,s:{s:o}}", "openapi", "3.0.3",
                  "info", "title", "citysplat", "version", CITYSPLAT_VERSION, "description",
                  "Tiles and pictures of cities of 3D Gaussians", "license", "name", "Apache 2.0",
                  "url", "https://www.apache.org/licenses/LICENSE-2.0", "servers", "url", "./",
                  "paths", paths, "components", "schemas", shapes);
    return document_make(o, out, e);
}
