/* See problem_page.h. It has no script and loads nothing.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/problem_page.h"

#include <jansson.h>

#include "server/base/document.h"

static const char problem_page_head[] =
    "<!doctype html>\n<html lang=\"en\"><meta charset=\"utf-8\">"
    "<meta name=\"viewport\" content=\"width=device-width\">"
    "<meta name=\"color-scheme\" content=\"light dark\">\n"
    "<style>body{font:1rem/1.5 system-ui,sans-serif;max-width:36rem;margin:4rem auto;"
    "padding:0 1rem;overflow-wrap:anywhere}p a{display:inline-block;padding:.7rem 0}"
    "@media(prefers-color-scheme:dark){body{background:#111;color:#ddd}a{color:#8bf}}</style>\n"
    "<title>";

static void problem_page_line(const json_t *o, const char *key, const char *before,
                              const char *after, struct buf *b)
{
    const char *text = json_string_value(json_object_get(o, key));
    if (!text)
        return;
    buf_printf(b, "%s", before);
    buf_markup(b, text);
    buf_printf(b, "%s", after);
}

enum err_code problem_page_make(const uint8_t *problem, size_t size, const char *home,
                                struct body **out, struct err *e)
{
    struct buf b = {0};
    json_t *o = json_loadb((const char *)problem, size, 0, NULL);
    *out = NULL;
    if (!json_is_object(o)) {
        json_decref(o);
        return err_set(e, ERR_DATA, "problem: no JSON object");
    }
    problem_page_line(o, "title", problem_page_head, " – citysplat</title>\n", &b);
    problem_page_line(o, "title", "<main><h1>", "</h1>\n", &b);
    problem_page_line(o, "detail", "<p>", "</p>\n", &b);
    problem_page_line(o, "instance", "<p><code>", "</code></p>\n", &b);
    buf_printf(&b, "<p><a href=\"");
    buf_markup(&b, home);
    buf_printf(&b, "/\">To the city</a> · <a href=\"");
    buf_markup(&b, home);
    buf_printf(&b, "/api.html\">All addresses</a></p>\n");
    problem_page_line(o, "request_id", "<p><small>Request ", "</small></p>\n", &b);
    buf_printf(&b, "</main></html>\n");
    json_decref(o);
    return document_take(buf_check(&b, e), &b, out, e);
}
