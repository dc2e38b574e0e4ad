/* OpenAPI 3.0.3, made from the route table: paths, methods, parameters, rights and answers are
 * those of the rows. It is written as text, parsed, and sent as all documents are.
 *
 * Brackets in a route's template mark an optional part. OpenAPI cannot express that in a path, so
 * it has the long form. A row does not list answers that follow from the kind of its route: 206,
 * 304 and 416 of a GET, and problems. Schemas of JSON are openapi_schemas.json, which is embedded.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/openapi.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "server/base/document.h"

extern const char openapi_schemas_json[]; /* openapi_schemas.json, embedded */

/* the schema of what has a media type */
#define OPENAPI_CONTENT "'%s':{'schema':{'$ref':'#/components/schemas/%s'}}"

/* Appends JSON: ' of the form is a quotation mark, and %s, its only conversion, a text of a table.
 * A comma at its start is left out behind an opening bracket. */
static void ERR_PRINTF(2, 3) openapi_put(struct buf *b, const char *form, ...)
{
    va_list args;
    va_start(args, form);
    form += *form == ',' && b->size && strchr("[{", b->data[b->size - 1]);
    for (; *form; form++)
        if (*form == '%') {
            const char *text = va_arg(args, const char *);
            buf_add(b, text, strlen(text));
            form++;
        } else {
            buf_u8(b, *form == '\'' ? '"' : (unsigned char)*form);
        }
    va_end(args);
}

/* ---- parameters ---- */

static void openapi_enum(const struct param *p, struct buf *b)
{
    size_t n;
    const char *word;
    openapi_put(b, ",'enum':[");
    for (uint32_t i = 0; (word = param_choice(p, i, &n)) != NULL; i++) {
        openapi_put(b, ",'");
        buf_add(b, word, n);
        openapi_put(b, "'");
    }
    openapi_put(b, "]");
}

static void openapi_schema(const struct param *p, struct buf *b)
{
    const bool whole = p->type == PARAM_NATURAL || p->type == PARAM_COUNT;
    const bool number =
        whole || p->type == PARAM_E7 || p->type == PARAM_E3 || p->type == PARAM_ANGLE;
    openapi_put(b, "{'type':'%s'", whole ? "integer" : number ? "number" : "string");
    if (p->type == PARAM_NAME)
        buf_printf(b, ",\"pattern\":\"^[a-z0-9][a-z0-9_-]{%g,%g}$\"", p->least - 1, p->most - 1);
    else if (p->type == PARAM_FORMAT || p->type == PARAM_WORD)
        openapi_enum(p, b);
    else if (number)
        buf_printf(b, ",\"minimum\":%.15g", p->least);
    else if (p->words)
        openapi_put(b, ",'pattern':'%s'", p->words);
    if (number && p->most != UINT32_MAX)
        buf_printf(b, ",\"maximum\":%.15g", p->most);
    if (p->standard)
        openapi_put(b, number ? ",'default':%s" : ",'default':'%s'", p->standard);
    openapi_put(b, "}");
}

static void openapi_parameters(const struct router *routes, const struct route *r, bool of_query,
                               struct buf *b)
{
    const struct param *const *params;
    const size_t n = router_params(routes, r, of_query, &params);
    for (size_t i = 0; i < n; i++) {
        openapi_put(b, ",{'name':'%s','in':'%s','required':%s,'description':'%s','schema':",
                    params[i]->name, of_query ? "query" : "path", of_query ? "false" : "true",
                    params[i]->about);
        openapi_schema(params[i], b);
        openapi_put(b, "}");
    }
}

/* ---- answers ---- */

static const char *openapi_about(const char *status)
{
    static const char *const rows[] = {"200The resource",
                                       "201It is kept; the name is new",
                                       "204Done, or there is nothing here",
                                       "206The range that was asked for",
                                       "303It is done; a page follows",
                                       "304You have it already",
                                       "307It is in the current revision",
                                       "416The range lies outside"};
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        if (!strncmp(rows[i], status, 3))
            return rows[i] + 3;
    return "A problem document, RFC 9457";
}

/* The answer `status`, with the media types that GIVES of a row has for the status `of`. */
static void openapi_answer(const char *status, const char *of, const char *gives, struct buf *b)
{
    bool content = false;
    openapi_put(b, ",'%s':{'description':'%s'", status, openapi_about(status));
    for (const char *p = gives; *p; p += strcspn(p, ",") + 1) {
        char is[4] = "", media[120], schema[40], *rest = media;
        if (sscanf(p, "%3[0-9X] %119[^ ,] %39[^,]", is, media, schema) < 3 || strcmp(is, of) != 0)
            continue;
        for (const char *one = strtok_r(media, "|", &rest); one; one = strtok_r(NULL, "|", &rest)) {
            openapi_put(b, content ? "," : ",'content':{");
            openapi_put(b, OPENAPI_CONTENT, one, schema);
            content = true;
        }
    }
    openapi_put(b, content ? "}" : "");
    if (!strcmp(status, "307"))
        openapi_put(b, ",'headers':{'Location':{'description':'%s','schema':{'type':'string'}}}",
                    "relative to the request's path");
    openapi_put(b, "}");
}

static void openapi_answers(const struct route_method *on, struct buf *b)
{
    static const char problem[] = "4XX application/problem+json Problem,";
    for (const char *p = on->gives; *p; p += strcspn(p, ",") + 1) {
        const char status[4] = {p[0], p[1], p[2]};
        if (strstr(on->gives, status) == p)
            openapi_answer(status, status, on->gives, b);
    }
    if (on->method == METHOD_GET && !on->whole && !strncmp(on->gives, "200 ", 4)) {
        openapi_answer("206", "200", on->gives, b);
        openapi_answer("304", "304", on->gives, b);
        openapi_answer("416", "4XX", problem, b);
    }
    openapi_answer("4XX", "4XX", problem, b);
    openapi_answer("5XX", "4XX", problem, b);
}

/* ---- operations ---- */

static void openapi_operation(const struct router *routes, const struct route *r,
                              const struct route_method *on, struct buf *b)
{
    static const char *const verbs[] = {[METHOD_GET] = "get",
                                        [METHOD_POST] = "post",
                                        [METHOD_PUT] = "put",
                                        [METHOD_DELETE] = "delete"};
    const char *const verb = verbs[on->method];
    const bool of_dataset = r->scope & SCOPE_DATASET, first = on == r->on;
    openapi_put(b, ",'%s':{'operationId':'%s%s%s','summary':'%s','tags':['%s'],'security':[", verb,
                r->name, first ? "" : "_", first ? "" : verb, on->about,
                of_dataset                    ? "datasets"
                : r->scope == SCOPE_OPERATORS ? "operators"
                                              : "service");
    if (of_dataset) /* without --auth nothing is needed */
        openapi_put(b, "{},{'token':[]}");
    if (of_dataset && on->method == METHOD_GET)
        openapi_put(b, ",{'signature':[]}");
    openapi_put(b, "],'parameters':[");
    openapi_parameters(routes, r, false, b);
    if (on->method == METHOD_GET)
        openapi_parameters(routes, r, true, b);
    openapi_put(b, "],'responses':{");
    openapi_answers(on, b);
    openapi_put(b, "}");
    if (on->takes)
        openapi_put(b, ",'requestBody':{'required':true,'content':{" OPENAPI_CONTENT "}}",
                    "application/json", on->takes);
    openapi_put(b, "}");
}

static void openapi_paths(const struct router *routes, struct buf *b)
{
    size_t n;
    const struct route *rows = router_rows(routes, &n);
    for (const struct route *r = rows; r < rows + n; r++) {
        if (r->scope & SCOPE_FILE) /* whatever the viewer has: no part of the interface */
            continue;
        openapi_put(b, ",'");
        for (const char *p = r->path; *p; p++)
            if (*p != '[' && *p != ']')
                buf_u8(b, (unsigned char)*p);
        openapi_put(b, "':{");
        for (const struct route_method *on = r->on; on < r->on + ROUTE_METHODS && on->answer; on++)
            openapi_operation(routes, r, on, b);
        openapi_put(b, "}");
    }
}

enum err_code openapi_describe(const struct router *routes, struct body **out, struct err *e)
{
    struct buf b = {0};
    struct json_t *o = NULL;
    openapi_put(&b, "{'openapi':'3.0.3','info':{'title':'citysplat','version':'" CITYSPLAT_VERSION
                    "','description':'Tiles and pictures of cities of 3D Gaussians','license':{"
                    "'name':'Apache 2.0','url':'https://www.apache.org/licenses/LICENSE-2.0'}},"
                    "'servers':[{'url':'.'}],'tags':["
                    "{'name':'service','description':'The service as a whole'},"
                    "{'name':'datasets','description':'One dataset; --auth says who may read it'},"
                    "{'name':'operators','description':'On the listener of --admin alone'}],"
                    "'paths':{");
    openapi_paths(routes, &b);
    openapi_put(&b, "},'components':{'schemas':");
    buf_printf(&b, "%s", openapi_schemas_json);
    openapi_put(&b, ",'securitySchemes':{'token':{'type':'http','scheme':'bearer'},"
                    "'signature':{'type':'apiKey','in':'query','name':'sig'}}}}");
    enum err_code rc = buf_check(&b, e);
    if (!rc)
        rc = jsonc_parse((const char *)b.data, b.size, "openapi", &o, e);
    buf_free(&b);
    return rc ? rc : document_make(o, out, e);
}
