/* Reads XML: see xml.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/xml.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { XML_NUMBER = 64 };

enum err_code xml_bad(const struct xml *x, const char *why, struct err *e)
{
    return err_set(e, ERR_FORMAT, "%s: line %zu: %s", x->path, x->line, why);
}

/* Beyond `text`; false: it does not come. */
static bool xml_skip(struct xml *x, const char *text)
{
    const char *to = strstr(x->p, text);
    if (!to)
        return false;
    for (to += strlen(text); x->p < to; x->p++)
        x->line += *x->p == '\n';
    return true;
}

/* The end of the tag that begins at x->p, after '<'; NULL: there is none. */
static const char *xml_tag_end(const struct xml *x)
{
    char quote = 0;
    const char *p = x->p;
    for (; *p && (quote || *p != '>'); p++) {
        if (!quote && *p == '<')
            return NULL;
        if (quote ? *p == quote : *p == '"' || *p == '\'')
            quote = quote ? 0 : *p;
    }
    return *p ? p : NULL;
}

enum err_code xml_next(struct xml *x, struct xml_tag *t, bool *more, struct err *e)
{
    *more = false;
    while (xml_skip(x, "<")) {
        if (!strncmp(x->p, "!--", 3) || *x->p == '?') {
            if (!xml_skip(x, *x->p == '?' ? "?>" : "-->"))
                return xml_bad(x, "a comment or declaration does not end", e);
            continue;
        }
        if (*x->p == '!')
            return xml_bad(x, "document types and CDATA are not read", e);
        const char *end = xml_tag_end(x);
        if (!end)
            return xml_bad(x, "a tag does not end", e);
        *t = (struct xml_tag){.end = end};
        t->closes = *x->p == '/';
        t->opens = !t->closes;
        const char *name = x->p + t->closes;
        const size_t n = strcspn(name, " \t\r\n/>");
        memcpy(t->name, name, n < XML_NAME - 1 ? n : XML_NAME - 1);
        t->attrs = name + n;
        t->closes = t->closes || end[-1] == '/';
        for (; x->p <= end; x->p++)
            x->line += *x->p == '\n';
        *more = true;
        return ERR_OK;
    }
    return ERR_OK;
}

/* Appends one Unicode character as UTF-8. */
static size_t xml_put(unsigned long c, char *out)
{
    if (c < 0x80) {
        out[0] = (char)c;
        return 1;
    }
    size_t n = c < 0x800 ? 2 : c < 0x10000 ? 3 : 4;
    for (size_t k = n - 1; k > 0; k--, c >>= 6)
        out[k] = (char)(0x80 | (c & 0x3f));
    out[0] = (char)((0xf00 >> n & 0xff) | c);
    return n;
}

const char *xml_character(const char *p, const char *end, char out[8], size_t *n)
{
    static const struct {
        const char *text;
        char c;
    } named[] = {{"&amp;", '&'}, {"&lt;", '<'}, {"&gt;", '>'}, {"&quot;", '"'}, {"&apos;", '\''}};
    *n = 1;
    *out = *p;
    if (*p != '&')
        return p + 1;
    for (size_t k = 0; k < sizeof named / sizeof *named; k++)
        if (!strncmp(p, named[k].text, strlen(named[k].text))) {
            *out = named[k].c;
            return p + strlen(named[k].text);
        }
    if (p + 2 < end && p[1] == '#') {
        char *stop;
        const bool hex = p[2] == 'x';
        const unsigned long c = strtoul(p + 2 + hex, &stop, hex ? 16 : 10);
        if (*stop == ';' && c > 0 && c < 0x110000) {
            *n = xml_put(c, out);
            return stop + 1;
        }
    }
    return p + 1;
}

bool xml_attr(const struct xml_tag *t, const char *name, char *out, size_t size)
{
    const size_t n = strlen(name);
    for (const char *p = t->attrs; p < t->end;) {
        p += strspn(p, " \t\r\n/");
        const size_t len = strcspn(p, " \t\r\n=/>");
        const bool this = len == n && !strncmp(p, name, n);
        p += len;
        p += strspn(p, " \t\r\n");
        if (p >= t->end || *p != '=')
            return false;
        p += 1 + strspn(p + 1, " \t\r\n");
        const char quote = *p;
        if (p >= t->end || (quote != '"' && quote != '\''))
            return false;
        const char *end = strchr(p + 1, quote);
        if (!end || end > t->end)
            return false;
        size_t used = 0;
        for (p++; this && p < end && used + 8 < size;) {
            char c[8];
            size_t bytes;
            p = xml_character(p, end, c, &bytes);
            memcpy(out + used, c, bytes);
            used += bytes;
        }
        if (this) {
            out[used] = '\0';
            return p >= end;
        }
        p = end + 1;
    }
    return false;
}

bool xml_number(const struct xml_tag *t, const char *name, double *out)
{
    char text[XML_NUMBER], *end;
    if (!xml_attr(t, name, text, sizeof text))
        return false;
    *out = strtod(text, &end);
    return end != text && !*end && isfinite(*out);
}

bool xml_id(const struct xml_tag *t, const char *name, long long *out)
{
    char text[XML_NUMBER], *end;
    if (!xml_attr(t, name, text, sizeof text))
        return false;
    *out = strtoll(text, &end, 10);
    return end != text && !*end;
}

bool xml_off(const struct xml_tag *t, const char *name)
{
    char text[XML_NUMBER];
    return xml_attr(t, name, text, sizeof text) && (!strcmp(text, "0") || !strcmp(text, "false"));
}
