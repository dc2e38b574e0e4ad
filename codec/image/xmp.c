/* XMP packets: see xmp.h.
 *
 * A prefix means nothing by itself: its namespace does. Names are stored with the prefix that the
 * namespace usually has. Cameras also write prefixes that they do not declare; such a name stays as
 * it is. Expat bounds what entities can expand to, and a document type, which could declare any,
 * ends the packet. Of a packet that is no XML, as some cameras write it, name="value" and
 * <name>value< are taken wherever they stand.
 *
 * Sources: XMP specification part 1 (2012), DJI's and Autel's photographs, Pix4D's tags.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/xmp.h"

#include <expat.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

#include "core/base.h"

enum { XMP_PREFIXES = 32, XMP_PREFIX = 24, XMP_DEEP = 12 };

/* What the address of a namespace has in it -> its usual prefix. */
static const char *const xmp_spaces[][2] = {
    {"drone-dji", "drone-dji"},       {"drone-autel", "drone-autel"},
    {"drone-parrot", "drone-parrot"}, {"drone-skydio", "drone-skydio"},
    {"pix4d.com/camera", "Camera"},   {"adobe.com/exif/1.0", "exif"},
    {"22-rdf-syntax-ns", "rdf"}};
enum { XMP_SPACES = sizeof xmp_spaces / sizeof *xmp_spaces };

struct xmp_reader {
    XML_Parser parser;
    struct xmp *to;
    struct {
        char text[XMP_PREFIX];
        const char *means; /* usual prefix; NULL: the namespace is not known, or that of the name */
    } prefix[XMP_PREFIXES];
    size_t n_prefixes, deep;
    char name[XMP_DEEP][XMP_NAME]; /* of the open elements */
    char text[XMP_TEXT];           /* of the innermost */
    size_t n_text;
};

static void xmp_declare(struct xmp_reader *r, const char *prefix, const char *address)
{
    const size_t n = strlen(prefix);
    size_t k = 0;
    if (n >= XMP_PREFIX || r->n_prefixes == XMP_PREFIXES)
        return;
    memcpy(r->prefix[r->n_prefixes].text, prefix, n + 1);
    while (k < XMP_SPACES && !strstr(address, xmp_spaces[k][0]))
        k++;
    r->prefix[r->n_prefixes++].means = k < XMP_SPACES ? xmp_spaces[k][1] : NULL;
}

/* "dji:GpsLatitude" as "drone-dji:GpsLatitude"; "" if it is of no known namespace. */
static void xmp_name(const struct xmp_reader *r, const char *name, char out[XMP_NAME])
{
    const char *colon = strchr(name, ':'), *means = NULL;
    const size_t n = colon ? (size_t)(colon - name) : 0;
    for (size_t i = r->n_prefixes; i-- > 0 && !means;)
        if (!strncmp(r->prefix[i].text, name, n) && !r->prefix[i].text[n])
            means = r->prefix[i].means;
    for (size_t k = 0; k < XMP_SPACES && !means; k++)
        if (n && strlen(xmp_spaces[k][1]) == n && !strncmp(xmp_spaces[k][1], name, n))
            means = xmp_spaces[k][1];
    if (!means || snprintf(out, XMP_NAME, "%s:%s", means, colon ? colon + 1 : name) >= XMP_NAME)
        out[0] = '\0';
}

/* The same of an element or attribute within `deep` open elements. A member of a structure is named
 * after both. */
static void xmp_member(const struct xmp_reader *r, size_t deep, const char *name,
                       char out[XMP_NAME])
{
    char member[XMP_NAME];
    const char *within = "";
    xmp_name(r, name, out);
    if (!*out || !strncmp(out, "rdf:", 4))
        return;
    for (deep = deep < XMP_DEEP ? deep : XMP_DEEP; deep > 0 && !*within; deep--)
        within = strncmp(r->name[deep - 1], "rdf:", 4) ? r->name[deep - 1] : "";
    if (!*within)
        return;
    if (snprintf(member, sizeof member, "%s/%s", within, strchr(out, ':') + 1) >= XMP_NAME)
        member[0] = '\0';
    memcpy(out, member, strlen(member) + 1);
}

/* Without blanks around it. */
static void xmp_keep(struct xmp_reader *r, const char *name, const char *text)
{
    struct xmp *x = r->to;
    text += strspn(text, " \t\r\n");
    size_t n = strlen(text);
    while (n && strchr(" \t\r\n", text[n - 1]))
        n--;
    if (!*name || !n || n >= XMP_TEXT || x->n == XMP_VALUES || !strncmp(name, "rdf:", 4))
        return;
    for (size_t i = 0; i < x->n; i++)
        if (!strcmp(x->value[i].name, name))
            return;
    memcpy(x->value[x->n].name, name, strlen(name) + 1);
    memcpy(x->value[x->n].text, text, n);
    x->value[x->n++].text[n] = '\0';
}

static void XMLCALL xmp_open(void *user, const XML_Char *name, const XML_Char **att)
{
    struct xmp_reader *r = user;
    char full[XMP_NAME];
    for (size_t i = 0; att[i]; i += 2)
        if (!strncmp(att[i], "xmlns:", 6))
            xmp_declare(r, att[i] + 6, att[i + 1]);
        else if (!strcmp(att[i], "xmlns"))
            xmp_declare(r, "", att[i + 1]);
    if (r->deep < XMP_DEEP)
        xmp_member(r, r->deep, name, r->name[r->deep]);
    r->deep++;
    for (size_t i = 0; att[i]; i += 2) {
        xmp_member(r, r->deep, att[i], full);
        xmp_keep(r, full, att[i + 1]);
    }
    r->n_text = 0;
}

static void XMLCALL xmp_text(void *user, const XML_Char *text, int n)
{
    struct xmp_reader *r = user;
    for (int i = 0; i < n; i++)
        if (r->n_text < XMP_TEXT && (r->n_text || !strchr(" \t\r\n", text[i])))
            r->text[r->n_text++] = text[i];
}

/* A text belongs to its element; one in rdf:value to the property around it. */
static void XMLCALL xmp_close(void *user, const XML_Char *name)
{
    struct xmp_reader *r = user;
    (void)name;
    size_t at = --r->deep;
    if (at < XMP_DEEP && r->n_text && r->n_text < XMP_TEXT) {
        r->text[r->n_text] = '\0';
        bool value = !strcmp(r->name[at], "rdf:value");
        while (value && at && !strncmp(r->name[at], "rdf:", 4))
            at--;
        xmp_keep(r, r->name[at], r->text);
    }
    r->n_text = 0;
}

static void XMLCALL xmp_refuse(void *user, const XML_Char *name, const XML_Char *system,
                               const XML_Char *id, int internal)
{
    struct xmp_reader *r = user;
    (void)name, (void)system, (void)id, (void)internal;
    XML_StopParser(r->parser, XML_FALSE);
}

static bool xmp_is_name(char c)
{
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
           strchr("_-.", c);
}

/* The end of the value that begins after a name: in quotes, or up to the next element. NULL: there
 * is none, or it is too long. */
static const char *xmp_value(const char **at, const char *end)
{
    const char *p = *at;
    while (p < end && strchr(" \t\r\n", *p))
        p++;
    char close = '<';
    if (end - p > 2 && *p == '=') {
        for (p++; p < end && strchr(" \t\r\n", *p);)
            p++;
        if (p == end || (*p != '"' && *p != '\''))
            return NULL;
        close = *p;
    } else if (p == end || *p != '>') {
        return NULL;
    }
    *at = ++p;
    return memchr(p, close, (size_t)(end - p) < XMP_TEXT ? (size_t)(end - p) : XMP_TEXT);
}

/* text [n] has no NUL. */
static void xmp_salvage(struct xmp_reader *r, const char *text, size_t n)
{
    const char *end = text + n;
    for (const char *p = text, *colon; (colon = memchr(p, ':', (size_t)(end - p))) != NULL;) {
        const char *from = colon, *to = p = colon + 1;
        while (from > text && xmp_is_name(from[-1]))
            from--;
        while (to < end && xmp_is_name(*to))
            to++;
        const char *value = to, *close = xmp_value(&value, end);
        char name[XMP_NAME], full[XMP_NAME], kept[XMP_TEXT];
        if (!close || (size_t)(to - from) >= sizeof name || (size_t)(close - value) >= sizeof kept)
            continue;
        snprintf(name, sizeof name, "%.*s", (int)(to - from), from);
        snprintf(kept, sizeof kept, "%.*s", (int)(close - value), value);
        if (!strncmp(name, "xmlns:", 6))
            xmp_declare(r, name + 6, kept);
        xmp_name(r, name, full);
        xmp_keep(r, full, kept);
    }
}

/* The packet without NULs, which also makes UTF-16 of Latin letters plain text. */
static void xmp_salvage_any(struct xmp_reader *r, const char *packet, size_t n)
{
    struct buf plain = {0};
    char *to = (char *)buf_grow(&plain, n + 1);
    size_t k = 0;
    for (size_t i = 0; to && i < n; i++)
        if (packet[i])
            to[k++] = packet[i];
    if (to) {
        to[k] = '\0';
        xmp_salvage(r, to, k);
    }
    buf_free(&plain);
}

void xmp_add(struct xmp *x, const void *packet, size_t n)
{
    const char *text = packet;
    struct xmp_reader r = {.to = x};
    while (n && *text && strchr(" \t\r\n", *text)) { /* nothing may stand before a declaration */
        text++;
        n--;
    }
    r.parser = n && n <= XMP_BYTES_MAX ? XML_ParserCreate(NULL) : NULL;
    if (!r.parser)
        return;
    XML_SetUserData(r.parser, &r);
    XML_SetElementHandler(r.parser, xmp_open, xmp_close);
    XML_SetCharacterDataHandler(r.parser, xmp_text);
    XML_SetStartDoctypeDeclHandler(r.parser, xmp_refuse);
    const bool whole = XML_Parse(r.parser, text, (int)n, XML_TRUE) == XML_STATUS_OK;
    const enum XML_Error why = XML_GetErrorCode(r.parser);
    XML_ParserFree(r.parser);
    if (!whole && why != XML_ERROR_ABORTED && why != XML_ERROR_JUNK_AFTER_DOC_ELEMENT)
        xmp_salvage_any(&r, text, n);
}

static char xmp_in_case(char c, int form)
{
    const bool lower = c >= 'a' && c <= 'z', upper = c >= 'A' && c <= 'Z';
    return (char)((form == 1 && upper) || (form == 2 && lower) ? c ^ 0x20 : c);
}

void xmp_add_sidecars(struct xmp *x, const char *path)
{
    static const char *const ends[] = {".xmp", ".XMP", ".Xmp"};
    const char *slash = strrchr(path, '/'), *dot = strrchr(slash ? slash : path, '.');
    const size_t base = slash ? (size_t)(slash + 1 - path) : 0;
    for (int k = 0; k < 18; k++) {
        const int stem = k % 2 && dot ? (int)(dot - path) : (int)strlen(path), form = k / 6;
        char name[FILE_PATH_MAX];
        struct buf b = {0};
        if (snprintf(name, sizeof name, "%.*s%s", stem, path, ends[k / 2 % 3]) >= (int)sizeof name)
            continue;
        for (size_t i = base; i < (size_t)stem; i++)
            name[i] = xmp_in_case(name[i], form);
        if ((!form || memcmp(name + base, path + base, (size_t)stem - base) != 0) &&
            file_exists(name) && !file_read(name, XMP_BYTES_MAX, &b, NULL))
            xmp_add(x, b.data, b.size);
        buf_free(&b);
    }
}

bool xmp_get(const void *xmp, const char *name, char *text, size_t room)
{
    const struct xmp *x = xmp;
    for (size_t i = 0; i < x->n; i++)
        if (!strcasecmp(x->value[i].name, name))
            return (size_t)snprintf(text, room, "%s", x->value[i].text) < room;
    return false;
}
