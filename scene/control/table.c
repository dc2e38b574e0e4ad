/* Lines of fields: see table.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/control/table.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "core/base.h"

enum err_code table_open(const char *path, struct table *out, struct err *e)
{
    *out = (struct table){.path = path, .bytes = mem_array(1, sizeof *out->bytes)};
    enum err_code rc = out->bytes ? file_read(path, 0, out->bytes, e)
                                  : err_set(e, ERR_MEM, "%s: out of memory", path);
    if (!rc) {
        buf_u8(out->bytes, 0);
        rc = buf_check(out->bytes, e);
    }
    if (rc) {
        table_close(out);
        return rc;
    }
    out->next = (char *)out->bytes->data;
    if (!strncmp(out->next, "\xef\xbb\xbf", 3)) /* the byte-order mark of UTF-8 */
        out->next += 3;
    return ERR_OK;
}

void table_close(struct table *t)
{
    if (t->bytes)
        buf_free(t->bytes);
    mem_free(t->bytes);
    t->bytes = NULL;
    t->next = NULL;
}

enum err_code table_next(struct table *t, char line[TABLE_LINE_MAX], bool *more, struct err *e)
{
    for (*more = false; t->next && !*more;) {
        char *p = t->next;
        size_t n = strcspn(p, "\r\n");
        t->next = !p[n] ? NULL : p[n] == '\r' && p[n + 1] == '\n' ? p + n + 2 : p + n + 1;
        t->line++;
        p += strspn(p, " \t");
        n = strcspn(p, "\r\n");
        if (!n)
            continue;
        if (n >= TABLE_LINE_MAX)
            return err_set(e, ERR_FORMAT, "%s: line %zu is too long", t->path, t->line);
        memcpy(line, p, n);
        line[n] = '\0';
        *more = true;
    }
    return ERR_OK;
}

size_t table_split(char *text, char comma, char *field[TABLE_FIELDS])
{
    const char commas[2] = {comma, '\0'}, *end = comma ? commas : " \t,;";
    size_t n = 0;
    char *p = text;
    while (n < TABLE_FIELDS) {
        p += comma ? strspn(p, " \t") : strspn(p, end);
        if (!comma && !*p)
            break;
        size_t len = strcspn(p, end);
        const char *close = comma && *p == '"' ? strchr(p + 1, '"') : NULL;
        if (close && (close[1] == comma || !close[1 + strspn(close + 1, " \t")])) {
            p++; /* a quoted field may have commas */
            len = (size_t)(close - p);
            p[len++] = ' ';
            len += strcspn(p + len, end);
        }
        bool last = !p[len];
        field[n++] = p;
        p[len] = '\0';
        for (size_t k = len; comma && k > 0 && (p[k - 1] == ' ' || p[k - 1] == '\t'); k--)
            p[k - 1] = '\0';
        if (last)
            break;
        p += len + 1;
    }
    return n;
}

void table_heading(const char *field, char out[TABLE_HEADING])
{
    size_t n = 0;
    field += *field == '#';
    if (*field && field[1] == '/')
        field += 2;
    for (const char *p = field; *p && !strchr("([{", *p) && n + 1 < TABLE_HEADING; p++)
        out[n++] = *p == ' ' || *p == '-' ? '_' : *p;
    while (n && out[n - 1] == '_')
        n--;
    out[n] = '\0';
}

bool table_number(const char *text, double *out)
{
    char *end;
    *out = strtod(text, &end);
    return end != text && !*end && isfinite(*out) && fabs(*out) <= 1e12;
}

size_t table_decimal_comma(const char *line, const char **at)
{
    for (const char *p = strchr(line, ','); p; p = strchr(p + 1, ',')) {
        const char *a = p, *b = p + 1;
        while (a > line && strchr("0123456789+-.", a[-1]))
            a--;
        b += strspn(b, "0123456789");
        if (a == p || b == p + 1 || (*b && !strchr(" \t;\"", *b)) ||
            (a > line && !strchr(" \t;\"", a[-1])))
            continue;
        *at = a;
        return (size_t)(b - a);
    }
    return 0;
}

static bool table_is_slash(char c)
{
    return c == '/' || c == '\\';
}

/* Length without the ending of a file's name; as it is if there is none. */
static size_t table_stem(const char *path)
{
    size_t n = strlen(path), dot = n;
    for (size_t k = n; k > 0 && !table_is_slash(path[k - 1]); k--)
        if (path[k - 1] == '.' && dot == n)
            dot = k - 1;
    return dot;
}

/* As table_alike, of the first n and k characters. */
static size_t table_rate(const char *photo, size_t n, const char *listed, size_t k)
{
    size_t same = 0, least = n < k ? n : k;
    while (same < least) {
        char a = photo[n - same - 1], b = listed[k - same - 1];
        if (table_is_slash(a) ? !table_is_slash(b) : strncasecmp(&a, &b, 1) != 0)
            return 0;
        same++;
    }
    if ((n > least && !table_is_slash(photo[n - least - 1])) ||
        (k > least && !table_is_slash(listed[k - least - 1])))
        return 0;
    return 4 * same + 2 * (n == k) + (n == k && !strncmp(photo, listed, n));
}

size_t table_alike(const char *photo, const char *listed)
{
    const size_t n = strlen(photo), k = strlen(listed), stem = table_stem(photo);
    const size_t rate = table_rate(photo, n, listed, k);
    return rate || stem == n || !stem || table_stem(listed) != k
               ? rate
               : table_rate(photo, stem, listed, k);
}
