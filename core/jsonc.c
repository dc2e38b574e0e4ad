/* JSON with // comments on lines of their own. Lines whose first characters are // are blanked
 * before parsing. A JSON string cannot contain a newline, so this never changes a string. Line
 * numbers in errors stay right.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include <jansson.h>

#include "core/base.h"

enum { JSONC_FILE_LIMIT = 256 << 20 };

static void jsonc_blank_comments(char *text, size_t n)
{
    bool line_start = true;
    for (size_t i = 0; i < n; i++) {
        if (line_start && text[i] == '/' && i + 1 < n && text[i + 1] == '/')
            while (i < n && text[i] != '\n')
                text[i++] = ' ';
        if (i < n && text[i] == '\n')
            line_start = true;
        else if (i < n && text[i] != ' ' && text[i] != '\t')
            line_start = false;
    }
}

enum err_code jsonc_parse(const char *text, size_t n, const char *name, struct json_t **out,
                          struct err *e)
{
    static const char bom[] = "\xef\xbb\xbf";
    char *copy = mem_array(n + 1, 1);
    if (!copy)
        return err_set(e, ERR_MEM, "%s: out of memory", name);
    if (n >= sizeof bom - 1 && !memcmp(text, bom, sizeof bom - 1)) { /* as Windows begins files */
        text += sizeof bom - 1;
        n -= sizeof bom - 1;
    }
    if (n)
        memcpy(copy, text, n);
    jsonc_blank_comments(copy, n);
    json_error_t je;
    json_t *j = json_loadb(copy, n, JSON_REJECT_DUPLICATES, &je);
    mem_free(copy);
    if (!j)
        return err_set(e, ERR_FORMAT, "%s: line %d, column %d: %s", name, je.line, je.column,
                       je.text);
    *out = j;
    return ERR_OK;
}

enum err_code jsonc_read(const char *path, struct json_t **out, struct err *e)
{
    struct buf b = {0};
    enum err_code rc = file_read(path, JSONC_FILE_LIMIT, &b, e);
    if (!rc)
        rc = jsonc_parse((const char *)b.data, b.size, path, out, e);
    buf_free(&b);
    return rc;
}

enum err_code jsonc_write(const char *path, const struct json_t *json, struct err *e)
{
    struct buf b = {0};
    const size_t flags = JSON_INDENT(2) | JSON_PRESERVE_ORDER | JSON_REAL_PRECISION(17);
    size_t n = json_dumpb(json, NULL, 0, flags);
    uint8_t *p = n ? buf_grow(&b, n + 1) : NULL;
    if (!p || json_dumpb(json, (char *)p, n, flags) != n) {
        buf_free(&b);
        return err_set(e, ERR_MEM, "%s: cannot write the JSON text", path);
    }
    p[n] = '\n';
    enum err_code rc = file_write(path, b.data, b.size, e);
    buf_free(&b);
    return rc;
}

enum err_code jsonc_num(const struct json_t *o, const char *key, double *out, struct err *e)
{
    const json_t *v = json_object_get(o, key);
    if (!json_is_number(v))
        return err_set(e, ERR_FORMAT, "\"%s\": %s, a number is expected", key,
                       v ? "wrong type" : "missing");
    *out = json_number_value(v);
    return ERR_OK;
}

enum err_code jsonc_nums(const struct json_t *o, const char *key, size_t n, double *out,
                         struct err *e)
{
    const json_t *a = json_object_get(o, key);
    if (!json_is_array(a) || json_array_size(a) != n)
        return err_set(e, ERR_FORMAT, "\"%s\": an array of %zu numbers is expected", key, n);
    for (size_t i = 0; i < n; i++) {
        const json_t *v = json_array_get(a, i);
        if (!json_is_number(v))
            return err_set(e, ERR_FORMAT, "\"%s\": element %zu is not a number", key, i);
        out[i] = json_number_value(v);
    }
    return ERR_OK;
}

enum err_code jsonc_text(const struct json_t *o, const char *key, const char **out, struct err *e)
{
    const json_t *v = json_object_get(o, key);
    if (!json_is_string(v))
        return err_set(e, ERR_FORMAT, "\"%s\": %s, a text is expected", key,
                       v ? "wrong type" : "missing");
    *out = json_string_value(v);
    return ERR_OK;
}

enum err_code jsonc_known(const json_t *o, const char *const *known, const char *what,
                          struct err *e)
{
    const char *key;
    json_t *v;
    json_object_foreach((json_t *)(uintptr_t)o, key, v)
    {
        struct buf list = {0};
        size_t i = 0;
        while (known[i] && strcmp(known[i], key) != 0)
            i++;
        if (known[i])
            continue;
        for (i = 0; known[i]; i++)
            buf_printf(&list, "%s%s", i ? ", " : "", known[i]);
        const enum err_code rc = buf_check(&list, e)
                                     ? ERR_MEM
                                     : err_set(e, ERR_DATA, "%s takes no '%.40s'; it takes %.*s",
                                               what, key, (int)list.size, (const char *)list.data);
        buf_free(&list);
        return rc;
    }
    return ERR_OK;
}

json_t *jsonc_real(double v)
{
    return isfinite(v) ? json_real(v) : json_null();
}
