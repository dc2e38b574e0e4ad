/* The description as HTML, made from the OpenAPI document, so that both agree: every path with its
 * parameters and answers. It has no script and loads nothing.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/api_page.h"

#include <jansson.h>
#include <string.h>

#include "server/base/document.h"
#include "server/documents/link.h"

static const char api_page_head[] =
    "<!doctype html>\n<html lang=\"en\"><meta charset=\"utf-8\">"
    "<meta name=\"viewport\" content=\"width=device-width\"><title>citysplat: addresses</title>\n"
    "<style>body{font:16px/1.45 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 "
    "1rem}"
    "h2{font-size:1rem;margin:2rem 0 .3rem;overflow-wrap:anywhere}p{margin:.3rem 0}"
    "table{border-collapse:collapse;margin:.4rem 0}td{padding:.15rem 1rem .15rem 0;vertical-align:"
    "top}code{font-size:.95em}@media(prefers-color-scheme:dark){body{background:#111;color:#ddd}"
    "a{color:#8bf}}</style>\n";

static const char *api_page_word(const json_t *o, const char *key)
{
    const char *text = json_string_value(json_object_get(o, key));
    return text ? text : "";
}

/* "#/components/schemas/NAME" -> NAME */
static const char *api_page_schema(const json_t *media)
{
    const char *ref = api_page_word(json_object_get(media, "schema"), "$ref"),
               *slash = strrchr(ref, '/');
    return slash ? slash + 1 : "";
}

static void api_page_content(struct buf *b, const char *what, const json_t *content)
{
    const char *type;
    json_t *media;
    json_object_foreach((json_t *)(uintptr_t)content, type, media)
    {
        buf_printf(b, "<tr><td>%s<td><code>", what);
        buf_markup(b, type);
        buf_printf(b, "</code><td>");
        buf_markup(b, api_page_schema(media));
        buf_printf(b, "\n");
    }
}

static void api_page_operation(struct buf *b, const char *verb, const char *path,
                               const json_t *operation)
{
    size_t i;
    const json_t *p;
    const char *status;
    json_t *response;
    buf_printf(b, "<h2><code>");
    for (const char *c = verb; *c; c++)
        buf_u8(b, (unsigned)(*c - 'a' + 'A'));
    buf_printf(b, " ");
    buf_markup(b, path);
    buf_printf(b, "</code></h2>\n<p>");
    buf_markup(b, api_page_word(operation, "summary"));
    buf_printf(b, "</p>\n<table>");
    json_array_foreach(json_object_get(operation, "parameters"), i, p)
    {
        buf_printf(b, "<tr><td>%s<td><code>", api_page_word(p, "in"));
        buf_markup(b, api_page_word(p, "name"));
        buf_printf(b, "</code><td>");
        buf_markup(b, api_page_word(p, "description"));
        buf_printf(b, "\n");
    }
    api_page_content(b, "body",
                     json_object_get(json_object_get(operation, "requestBody"), "content"));
    json_object_foreach(json_object_get(operation, "responses"), status, response)
    {
        if (strcmp(status, "default") != 0)
            api_page_content(b, status, json_object_get(response, "content"));
    }
    buf_printf(b, "</table>\n");
}

static void api_page_write(const json_t *o, struct buf *b)
{
    const char *path, *verb;
    json_t *verbs, *operation;
    buf_printf(b, "%s<h1>citysplat: addresses</h1>\n<p>Version ", api_page_head);
    buf_markup(b, api_page_word(json_object_get(o, "info"), "version"));
    buf_printf(b, ". The same for programs, with the shapes of all JSON: <a href=\"");
    link_api(&(struct link){.from = LINK_ROOT}, b);
    buf_printf(b, "\">OpenAPI 3.0</a>. <a href=\"./\">Back</a>. Errors are problem documents (RFC "
                  "9457).</p>\n");
    json_object_foreach(json_object_get(o, "paths"), path, verbs)
    {
        json_object_foreach(verbs, verb, operation)
        {
            api_page_operation(b, verb, path, operation);
        }
    }
    buf_printf(b, "</html>\n");
}

enum err_code api_page_describe(const struct body *openapi, struct body **out, struct err *e)
{
    struct buf b = {0};
    json_t *o = json_loadb((const char *)openapi->data, openapi->size, 0, NULL);
    *out = NULL;
    if (!o)
        return err_set(e, ERR_INTERNAL, "the description of the service is no JSON");
    api_page_write(o, &b);
    json_decref(o);
    return document_take(buf_check(&b, e), &b, out, e);
}
