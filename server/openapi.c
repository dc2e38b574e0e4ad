/* OpenAPI 3.0.3, made from the route table: paths, methods, parameters, rights and answers are
 * those of the rows.
 *
 * Brackets in a route's template mark an optional part. OpenAPI cannot express that in a path, so
 * it has the long form. A row does not list answers that follow from the kind of its route: 206,
 * 304 and 416 of a GET, and problems.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/openapi.h"

#include <jansson.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/document.h"
#include "server/openapi_schemas.h"

enum { OPENAPI_PATH = 256 };

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

/* ---- parameters ---- */

static json_t *openapi_enum(const struct param *p)
{
    json_t *words = json_array();
    if (p->type == PARAM_FORMAT)
        for (int f = (int)p->least; f <= (int)p->most; f++)
            json_array_append_new(words, json_string(format_ext((enum format)f)));
    for (const char *w = p->words; p->type == PARAM_WORD && *w; w += *w == '|') {
        json_array_append_new(words, json_stringn(w, strcspn(w, "|")));
        w += strcspn(w, "|");
    }
    return json_pack("{s:s,s:o}", "type", "string", "enum", words);
}

static json_t *openapi_range(const struct param *p, const char *type)
{
    json_t *o = json_pack("{s:s}", "type", type);
    const double ends[2] = {p->least, p->most};
    for (int k = 0; k < 2; k++)
        if (ends[k] != UINT32_MAX)
            json_object_set_new(o, k ? "maximum" : "minimum",
                                ends[k] == (double)(json_int_t)ends[k]
                                    ? json_integer((json_int_t)ends[k])
                                    : json_real(ends[k]));
    return o;
}

static json_t *openapi_schema(const struct param *p)
{
    char pattern[64];
    switch (p->type) {
    case PARAM_NAME:
        snprintf(pattern, sizeof pattern, "^[a-z0-9][a-z0-9_-]{%d,%d}$", (int)p->least - 1,
                 (int)p->most - 1);
        return json_pack("{s:s,s:s}", "type", "string", "pattern", pattern);
    case PARAM_NATURAL:
    case PARAM_COUNT:
        return openapi_range(p, "integer");
    case PARAM_E7:
    case PARAM_E3:
    case PARAM_ANGLE:
        return openapi_range(p, "number");
    case PARAM_FORMAT:
    case PARAM_WORD:
        return openapi_enum(p);
    default:
        return json_pack("{s:s,s:s*}", "type", "string", "pattern", p->words);
    }
}

static json_t *openapi_parameter(const struct param *p, const char *in)
{
    json_t *schema = openapi_schema(p);
    const bool number = json_object_get(schema, "minimum") != NULL;
    if (p->standard)
        json_object_set_new(schema, "default",
                            number ? json_integer(atoi(p->standard)) : json_string(p->standard));
    return json_pack("{s:s,s:s,s:b,s:s,s:o}", "name", p->name, "in", in, "required",
                     !strcmp(in, "path"), "description", p->about, "schema", schema);
}

/* Those of a query belong to GET. */
static json_t *openapi_parameters(const struct router *routes, const struct route *r,
                                  enum method method)
{
    const struct param *const *params;
    json_t *list = json_array();
    size_t n = router_path_params(routes, r, &params);
    for (size_t i = 0; i < n; i++)
        json_array_append_new(list, openapi_parameter(params[i], "path"));
    n = method == METHOD_GET ? router_query_params(routes, r, &params) : 0;
    for (size_t i = 0; i < n; i++)
        json_array_append_new(list, openapi_parameter(params[i], "query"));
    return list;
}

/* ---- answers ---- */

static json_t *openapi_content(const char *media, const char *schema)
{
    char ref[80];
    snprintf(ref, sizeof ref, "#/components/schemas/%s", schema);
    return json_pack("{s:{s:{s:s}}}", media, "schema", "$ref", ref);
}

static const char *openapi_about(const char *status)
{
    static const struct {
        const char *status, *about;
    } rows[] = {{"200", "The resource"},
                {"201", "It is kept; the name is new"},
                {"202", "It will be done"},
                {"204", "Done, or there is nothing here"},
                {"206", "The range that was asked for"},
                {"304", "You have it already"},
                {"307", "It is in the current revision"},
                {"416", "The range lies outside"}};
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        if (!strcmp(rows[i].status, status))
            return rows[i].about;
    return "A problem document, RFC 9457";
}

/* The answer of a status, which is made where it is not there yet. */
static json_t *openapi_response(json_t *responses, const char *status)
{
    json_t *o = json_object_get(responses, status);
    if (!o) {
        o = json_pack("{s:s}", "description", openapi_about(status));
        json_object_set_new(responses, status, o);
    }
    return o;
}

/* Media types "A|B" of a schema. */
static void openapi_add_media(json_t *response, const char *media, const char *schema)
{
    json_t *content = json_object_get(response, "content");
    if (!content) {
        content = json_object();
        json_object_set_new(response, "content", content);
    }
    for (char one[80]; *media; media += *media == '|') {
        const size_t n = strcspn(media, "|");
        snprintf(one, sizeof one, "%.*s", (int)n, media);
        json_t *more = openapi_content(one, schema);
        json_object_update(content, more);
        json_decref(more);
        media += n;
    }
}

static void openapi_add_location(json_t *response)
{
    json_object_set_new(response, "headers",
                        json_pack("{s:{s:s,s:{s:s}}}", "Location", "description",
                                  "relative to the request's path", "schema", "type", "string"));
}

/* "STATUS MEDIA|MEDIA SCHEMA,STATUS," */
static json_t *openapi_responses(const struct route_method *on)
{
    json_t *all = json_object();
    bool part = false;
    for (const char *p = on->gives; *p;) {
        char status[4] = "", media[120] = "", schema[40] = "";
        int n = sscanf(p, "%3[0-9] %119[^ ,] %39[^,]", status, media, schema);
        json_t *o = openapi_response(all, status);
        if (n == 3)
            openapi_add_media(o, media, schema);
        if (!strcmp(status, "307"))
            openapi_add_location(o);
        part |= n == 3 && on->method == METHOD_GET && !on->whole && !strcmp(status, "200");
        p += strcspn(p, ",");
        p += *p == ',';
    }
    if (part) {
        json_object_set(openapi_response(all, "206"), "content",
                        json_object_get(json_object_get(all, "200"), "content"));
        (void)openapi_response(all, "304");
        openapi_add_media(openapi_response(all, "416"), "application/problem+json", "Problem");
    }
    static const char *const problems[] = {"4XX", "5XX"};
    for (int k = 0; k < 2; k++)
        openapi_add_media(openapi_response(all, problems[k]), "application/problem+json",
                          "Problem");
    return all;
}

/* ---- operations ---- */

static const char *openapi_tag(const struct route *r)
{
    return r->scope & SCOPE_DATASET      ? "datasets"
           : r->scope == SCOPE_OPERATORS ? "operators"
                                         : "service";
}

/* Without --auth nothing is needed. */
static json_t *openapi_security(const struct route *r, enum method method)
{
    if (!(r->scope & SCOPE_DATASET))
        return json_array();
    json_t *o = json_pack("[{},{s:[]}]", "token");
    if (method == METHOD_GET)
        json_array_append_new(o, json_pack("{s:[]}", "signature"));
    return o;
}

static json_t *openapi_operation(const struct router *routes, const struct route *r,
                                 const struct route_method *on, const char *verb)
{
    char id[64];
    snprintf(id, sizeof id, "%s%s%s", r->name, on == r->on ? "" : "_", on == r->on ? "" : verb);
    json_t *o =
        json_pack("{s:s,s:s,s:[s],s:o,s:o,s:o}", "operationId", id, "summary", on->about, "tags",
                  openapi_tag(r), "security", openapi_security(r, on->method), "parameters",
                  openapi_parameters(routes, r, on->method), "responses", openapi_responses(on));
    if (on->takes)
        json_object_set_new(o, "requestBody",
                            json_pack("{s:b,s:o}", "required", 1, "content",
                                      openapi_content("application/json", on->takes)));
    return o;
}

/* A route's template without its brackets. */
static void openapi_path(const struct route *r, char out[OPENAPI_PATH])
{
    size_t n = 0;
    for (const char *p = r->path; *p && n + 1 < OPENAPI_PATH; p++)
        if (*p != '[' && *p != ']')
            out[n++] = *p;
    out[n] = '\0';
}

static json_t *openapi_paths(const struct router *routes)
{
    static const char *const verbs[] = {[METHOD_GET] = "get",
                                        [METHOD_POST] = "post",
                                        [METHOD_PUT] = "put",
                                        [METHOD_DELETE] = "delete"};
    size_t n;
    const struct route *rows = router_rows(routes, &n);
    json_t *paths = json_object();
    for (const struct route *r = rows; r < rows + n; r++) {
        char path[OPENAPI_PATH];
        if (r->scope & SCOPE_FILE) /* whatever the viewer has: no part of the interface */
            continue;
        json_t *all = json_object();
        for (const struct route_method *on = r->on; on < r->on + ROUTE_METHODS && on->answer; on++)
            json_object_set_new(all, verbs[on->method],
                                openapi_operation(routes, r, on, verbs[on->method]));
        openapi_path(r, path);
        json_object_set_new(paths, path, all);
    }
    return paths;
}

static json_t *openapi_components(void)
{
    static const struct {
        const char *name, *schema;
    } schemas[] = {
#define SCHEMA_ROW(name, schema) {name, schema},
        OPENAPI_SCHEMAS(SCHEMA_ROW)
#undef SCHEMA_ROW
    };
    json_t *shapes = json_object();
    for (size_t i = 0; i < sizeof schemas / sizeof *schemas; i++)
        json_object_set_new(shapes, schemas[i].name, openapi_json(schemas[i].schema));
    return json_pack("{s:o,s:{s:{s:s,s:s},s:{s:s,s:s,s:s}}}", "schemas", shapes, "securitySchemes",
                     "token", "type", "http", "scheme", "bearer", "signature", "type", "apiKey",
                     "in", "query", "name", "sig");
}

enum err_code openapi_describe(const struct router *routes, struct body **out, struct err *e)
{
    json_t *tags = json_pack("[{s:s,s:s},{s:s,s:s},{s:s,s:s}]", "name", "service", "description",
                             "The service as a whole", "name", "datasets", "description",
                             "One dataset; --auth says who may read it", "name", "operators",
                             "description", "On the listener of --admin alone");
    json_t *o =
        json_pack("{s:s,s:{s:s,s:s,s:s,s:{s:s,s:s}},s:[{s:s}],s:o,s:o,s:o}", "openapi", "3.0.3",
                  "info", "title", "citysplat", "version", CITYSPLAT_VERSION, "description",
                  "Tiles and pictures of cities of 3D Gaussians", "license", "name", "Apache 2.0",
                  "url", "https://www.apache.org/licenses/LICENSE-2.0", "servers", "url", ".",
                  "tags", tags, "paths", openapi_paths(routes), "components", openapi_components());
    return document_make(o, out, e);
}
