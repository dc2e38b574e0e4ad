/* Lines of fields: see table.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/control/table.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

#include "core/base.h"

/* ---- the bytes of a file as UTF-8 ---- */

/* Is it UTF-16, and of which order? By its mark, or by the zeros in its first letters. */
static bool table_is_wide(const uint8_t *p, size_t n, bool *big)
{
    *big = n >= 2 && (p[0] == 0xfe || (p[0] == 0 && p[1]));
    return n >= 4 && ((p[0] == 0xff && p[1] == 0xfe) || (p[0] == 0xfe && p[1] == 0xff) ||
                      (!p[0] && p[1] && !p[2] && p[3]) || (p[0] && !p[1] && p[2] && !p[3]));
}

static void table_put(struct buf *out, uint32_t c)
{
    if (c < 0x80) {
        buf_u8(out, c);
        return;
    }
    const unsigned more = c < 0x800 ? 1 : c < 0x10000 ? 2 : 3;
    buf_u8(out, (0xff00u >> (more + 1) & 0xff) | c >> 6 * more);
    for (unsigned k = more; k-- > 0;)
        buf_u8(out, 0x80 | (c >> 6 * k & 0x3f));
}

static void table_narrow(const uint8_t *p, size_t n, bool big, struct buf *out)
{
    for (size_t i = 0; i + 1 < n; i += 2) {
        uint32_t c = (uint32_t)p[i + big] | (uint32_t)p[i + !big] << 8;
        if (c >= 0xd800 && c < 0xdc00 && i + 3 < n) { /* the first of a pair */
            c = 0x10000 + ((c & 0x3ff) << 10) +
                (((uint32_t)p[i + 2 + big] | (uint32_t)p[i + 2 + !big] << 8) & 0x3ff);
            i += 2;
        }
        table_put(out, c);
    }
}

/* No-break spaces are blanks, and typographic minus signs minus. */
static void table_plain(char *text)
{
    char *to = text;
    for (const char *p = text; *p;) {
        const bool space = !strncmp(p, "\xc2\xa0", 2), minus = !strncmp(p, "\xe2\x88\x92", 3);
        *to++ = space ? ' ' : minus ? '-' : *p;
        p += space ? 2 : minus ? 3 : 1;
    }
    *to = '\0';
}

static enum err_code table_decode(struct table *t, struct err *e)
{
    bool big;
    struct buf wide = *t->bytes;
    if (table_is_wide(wide.data, wide.size, &big)) {
        *t->bytes = (struct buf){0};
        table_narrow(wide.data, wide.size, big, t->bytes);
        buf_free(&wide);
    }
    const void *nul = t->bytes->size ? memchr(t->bytes->data, 0, t->bytes->size) : NULL;
    buf_u8(t->bytes, 0);
    enum err_code rc = buf_check(t->bytes, e);
    if (!rc && nul)
        rc = err_set(e, ERR_FORMAT, "%s: holds a NUL byte: not a text file", t->path);
    if (!rc)
        table_plain((char *)t->bytes->data);
    return rc;
}

enum err_code table_open(const char *path, struct table *out, struct err *e)
{
    *out = (struct table){.path = path, .bytes = mem_array(1, sizeof *out->bytes)};
    enum err_code rc = out->bytes ? file_read(path, 0, out->bytes, e)
                                  : err_set(e, ERR_MEM, "%s: out of memory", path);
    if (!rc)
        rc = table_decode(out, e);
    if (rc) {
        table_close(out);
        return rc;
    }
    out->next = (char *)out->bytes->data;
    if (!strncmp(out->next, "\xef\xbb\xbf", 3)) /* the byte-order mark of UTF-8 */
        out->next += 3;
    if (!strncasecmp(out->next, "sep=", 4) && out->next[4] && strchr("\r\n", out->next[5]))
        out->next += 5; /* a spreadsheet's word on its separator, which the headings tell as well */
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

char table_separator(const char *line, bool (*known)(const char *field))
{
    static const char separators[] =
        ",;\t"; /* if none of these divides it, blanks: names have some */
    char best = '\0';
    size_t most = 1;
    for (size_t k = 0; separators[k]; k++) {
        char copy[TABLE_LINE_MAX], *field[TABLE_FIELDS];
        size_t n = 0;
        snprintf(copy, sizeof copy, "%s", line);
        for (size_t i = table_split(copy, separators[k], field); i-- > 0;)
            n += known(field[i]);
        if (n > most)
            best = separators[k];
        most = n > most ? n : most;
    }
    return best;
}

/* The quotation mark that closes the field that begins with one; NULL: none. A doubled one is part
 * of the text. */
static char *table_closing(char *field)
{
    char *p = strchr(field + 1, '"');
    while (p && p[1] == '"')
        p = strchr(p + 2, '"');
    return p;
}

/* Text within quotation marks, up to `close`: doubled ones become one, and blanks follow. */
static void table_unquote(char *text, char *close)
{
    char *to = text;
    for (const char *from = text; from < close; from++) {
        *to++ = *from;
        from += *from == '"';
    }
    memset(to, ' ', (size_t)(close + 1 - to));
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
        char *close = comma && *p == '"' ? table_closing(p) : NULL;
        if (close && (close[1] == comma || !close[1 + strspn(close + 1, " \t")])) {
            p++; /* a quoted field may have commas */
            table_unquote(p, close);
            len = (size_t)(close - p) + 1;
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
    field += *field == '#' ? 1 + strspn(field + 1, " \t") : 0;
    if (*field && field[1] == '/')
        field += 2;
    for (const char *p = field; *p && !strchr("([{", *p) && n + 1 < TABLE_HEADING; p++)
        out[n++] = *p == ' ' || *p == '-' ? '_' : *p;
    while (n && out[n - 1] == '_')
        n--;
    out[n] = '\0';
}

enum err_code table_check_unit(const char *path, size_t line, const char *field, struct err *e)
{
    static const char *const bad[] = {"f", "us", "km", "mm", "cm", "rad", "dms", "gra", "gon"};
    const char *unit = strpbrk(field, "([{");
    for (size_t k = 0; unit && k < sizeof bad / sizeof *bad; k++)
        if (!strncasecmp(unit + 1, bad[k], strlen(bad[k])))
            return err_set(e, ERR_FORMAT,
                           "%s: line %zu: column '%.40s': metres and decimal degrees are read: "
                           "convert it",
                           path, line, field);
    return ERR_OK;
}

bool table_number(const char *text, double *out)
{
    return number_list(text, 1, out) && fabs(*out) <= 1e12;
}

bool table_is_grouped(const char *field)
{
    /* ’ and the thin and the narrow blank at the end */
    static const char digits[] = "0123456789", *const marks[] = {" ",
                                                                 "'",
                                                                 ",",
                                                                 ".",
                                                                 "\xe2\x80\x99",
                                                                 "\xe2\x80\x89",
                                                                 "\xe2\x80\xaf"};
    const char *first = field + strspn(field, "+-");
    const size_t head = strspn(first, digits);
    for (size_t k = 0; head >= 1 && head <= 3 && *first != '0' && k < sizeof marks / sizeof *marks;
         k++) {
        const size_t n = strlen(marks[k]);
        const char *from = first + head, *p = from;
        while (!strncmp(p, marks[k], n) && strspn(p + n, digits) == 3)
            p += n + 3;
        const bool grouped = p > from;
        p += *p == '.' || *p == ',';
        if (grouped && !p[strspn(p, digits)])
            return true;
    }
    return false;
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

/* May the comma separate thousands? As in "634,676", which may be millimetres as well. */
static bool table_may_be_thousands(const char *number, size_t n)
{
    const char *first = number + strspn(number, "+-"), *comma = strchr(first, ',');
    size_t before = (size_t)(comma - first), after = (size_t)(number + n - comma) - 1;
    return after == 3 && before >= 1 && before <= 3 && *first != '0' &&
           strspn(first, "0123456789") == before;
}

void table_decimal_points(struct table *t, char *line)
{
    const char *at;
    for (size_t n; (n = table_decimal_comma(line, &at)) > 0;) {
        char *number = line + (at - line), *comma = strchr(number, ',');
        const int shown = (int)(n < 40 ? n : 40);
        if (!t->commas)
            log_info("table", "%s: line %zu: decimal commas are read as points: '%.*s'", t->path,
                     t->line, shown, number);
        if (!t->thousands && table_may_be_thousands(number, n)) {
            log_warn("table",
                     "%s: line %zu: '%.*s' is read as %.*s.%.3s: if the comma separates thousands, "
                     "write the number without it",
                     t->path, t->line, shown, number, (int)(comma - number), number, comma + 1);
            t->thousands = true;
        }
        t->commas = true;
        *comma = '.';
    }
}

/* ---- names of photographs ---- */

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

/* Also without the ending that the listed one lacks. */
static size_t table_rate_ends(const char *photo, const char *listed)
{
    const size_t n = strlen(photo), k = strlen(listed), stem = table_stem(photo);
    const size_t rate = table_rate(photo, n, listed, k);
    return rate || stem == n || !stem || table_stem(listed) != k
               ? rate
               : table_rate(photo, stem, listed, k);
}

/* A character of UTF-8; 0: the end, or none. */
static uint32_t table_character(const char **p)
{
    const unsigned char *s = (const unsigned char *)*p;
    const size_t more = *s < 0xc0 ? 0 : *s < 0xe0 ? 1 : *s < 0xf0 ? 2 : 3;
    uint32_t c = more ? *s & (0x3fu >> more) : *s;
    *p += *s != 0;
    for (size_t k = 0; k < more && (**p & 0xc0) == 0x80; k++)
        c = c << 6 | ((unsigned char)*(*p)++ & 0x3f);
    return c;
}

/* Combining marks of letters, and of kana. */
static bool table_is_mark(uint32_t c)
{
    return (c >= 0x300 && c < 0x370) || c == 0x3099 || c == 0x309a;
}

/* Letters of which some are one with a mark: Latin, Greek and Cyrillic, kana. */
static bool table_may_have_mark(uint32_t c)
{
    return (c >= 0xc0 && c < 0x530) || (c >= 0x1e00 && c < 0x2000) || (c >= 0x3040 && c < 0x3100);
}

/* Replaces each letter with a mark, in one character or two, by one sign, and says whether there
 * were marks of their own. Returns whether there were any such letters and `out` holds all. */
static bool table_fold(const char *text, char *out, size_t room, bool *apart)
{
    const char sign = 1;
    bool any = false;
    size_t n = 0;
    *apart = false;
    for (const char *p = text, *from = p; *p; from = p) {
        const uint32_t c = table_character(&p);
        bool marked = table_may_have_mark(c);
        for (const char *q = p; table_is_mark(table_character(&q)); p = q)
            marked = *apart = true;
        const size_t len = marked ? 1 : (size_t)(p - from);
        if (n + len >= room)
            return false;
        memcpy(out + n, marked ? &sign : from, len);
        n += len;
        any = any || marked;
    }
    out[n] = '\0';
    return any;
}

/* Both without marks, if one has them in characters of their own and the other has not. Names of
 * one form are compared as they are: which letter it is counts there. */
static bool table_without_marks(const char *one, const char *other, char a[TABLE_LINE_MAX],
                                char b[TABLE_LINE_MAX])
{
    bool apart_a, apart_b;
    return table_fold(one, a, TABLE_LINE_MAX, &apart_a) &&
           table_fold(other, b, TABLE_LINE_MAX, &apart_b) && apart_a != apart_b;
}

size_t table_alike(const char *photo, const char *listed)
{
    char a[TABLE_LINE_MAX], b[TABLE_LINE_MAX];
    const size_t rate = table_rate_ends(photo, listed);
    return rate || !table_without_marks(photo, listed, a, b) ? rate : table_rate_ends(a, b) > 0;
}

bool table_same_path(const char *a, const char *b)
{
    char x[TABLE_LINE_MAX], y[TABLE_LINE_MAX];
    if (table_without_marks(a, b, x, y)) {
        a = x;
        b = y;
    }
    return strlen(a) == strlen(b) && table_rate(a, strlen(a), b, strlen(b)) > 0;
}

void table_rename(struct table_renamed *r, const char *photo, const char *listed)
{
    const size_t n = strlen(photo), k = strlen(listed), stem = table_stem(photo);
    const size_t ends[] = {n, stem};
    for (size_t i = 0; i < 2; i++) {
        const size_t least = ends[i] < k ? ends[i] : k;
        if (!memcmp(photo + ends[i] - least, listed + k - least, least))
            return;
    }
    if (!r->n++) {
        r->photo = photo;
        r->listed = listed;
    }
}

void table_tell_renamed(const struct table_renamed *r, const char *what)
{
    if (r->n)
        log_info("table",
                 "%s: %zu names differ from those of the photographs in case, slashes or accents; "
                 "'%s' is taken for '%s'",
                 what, r->n, r->listed, r->photo);
}
