/* JSON documents as bodies. Links are relative. The host that a client used is never
 * repeated, and the service works below any prefix of a proxy.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/base/document.h"

#include <jansson.h>
#include <stdlib.h>
#include <string.h>

enum err_code document_write(json_t *json, struct buf *out, struct err *e)
{
    char *text = json ? json_dumps(json, JSON_INDENT(1) | JSON_REAL_PRECISION(15)) : NULL;
    json_decref(json);
    if (!text)
        return err_set(e, ERR_MEM, "document: out of memory");
    buf_add(out, text, strlen(text));
    buf_add(out, "\n", 1);
    free(text);
    return buf_check(out, e);
}

enum err_code document_make(json_t *json, struct body **out, struct err *e)
{
    struct buf b = {0};
    enum err_code rc = document_write(json, &b, e);
    return document_take(rc, &b, out, e);
}

enum err_code document_take(enum err_code rc, struct buf *b, struct body **out, struct err *e)
{
    *out = NULL;
    if (rc) {
        buf_free(b);
        return rc;
    }
    *out = body_take(b, NULL);
    if (!*out)
        return err_set(e, ERR_MEM, "document: out of memory");
    body_compress(*out);
    return ERR_OK;
}

json_t *document_link(const char *rel, const char *type, const char *href, const char *title)
{
    return json_pack("{s:s,s:s,s:s,s:s*}", "rel", rel, "type", type, "href", href, "title", title);
}

json_t *document_numbers(const double *v, size_t n)
{
    json_t *list = json_array();
    for (size_t i = 0; i < n; i++)
        json_array_append_new(list, json_real(v[i]));
    return list;
}
