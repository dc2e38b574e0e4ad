/* Parses a request's target from left to right: see text.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/base/text.h"

#include <jansson.h>
#include <string.h>

bool text_take(struct text *t, const char *word)
{
    size_t n = strlen(word);
    if ((size_t)(t->end - t->p) < n || memcmp(t->p, word, n) != 0)
        return false;
    t->p += n;
    return true;
}

int text_hex(char c)
{
    return c >= '0' && c <= '9'   ? c - '0'
           : c >= 'a' && c <= 'f' ? c - 'a' + 10
           : c >= 'A' && c <= 'F' ? c - 'A' + 10
                                  : -1;
}

bool text_at_end(const struct text *t)
{
    return t->p == t->end;
}

/* Of the next byte. */
static bool text_is_digit(const struct text *t)
{
    return t->p < t->end && *t->p >= '0' && *t->p <= '9';
}

bool text_take_uint(struct text *t, uint32_t *out)
{
    const char *start = t->p;
    uint32_t v = 0;
    for (; text_is_digit(t) && t->p - start < 10; t->p++)
        v = v * 10 + (uint32_t)(*t->p - '0') * (t->p - start < 9);
    *out = v;
    size_t n = (size_t)(t->p - start);
    return n >= 1 && n <= 9 && (n == 1 || *start != '0');
}

bool text_take_fixed(struct text *t, int scale, int64_t *out)
{
    const bool negative = text_take(t, "-");
    if (!negative)
        (void)text_take(t, "+");
    uint32_t whole;
    if (!text_take_uint(t, &whole))
        return false;
    int64_t v = whole;
    int done = 0;
    bool up = false;
    if (text_take(t, ".")) {
        const char *point = t->p;
        if (!text_is_digit(t))
            return false;
        for (; text_is_digit(t); t->p++)
            if (done < scale)
                v = v * 10 + (*t->p - '0'), done++;
            else if (t->p == point + scale)
                up = *t->p >= '5';
    }
    for (; done < scale; done++)
        v *= 10;
    *out = negative ? -(v + up) : v + up;
    return true;
}

enum err_code text_take_degrees(struct text *t, int n, const char *what, int32_t *out_e7,
                                struct err *e)
{
    for (int i = 0; i < n; i++) {
        int64_t v;
        const int64_t most = i % 2 ? 900000000 : 1800000000;
        if ((i && !text_take(t, ",")) || !text_take_fixed(t, 7, &v))
            return ERR_NOENT;
        if (v < -most || v > most)
            return err_set(e, ERR_DATA, "%s no longitude and latitude", what);
        out_e7[i] = (int32_t)v;
    }
    return ERR_OK;
}

bool text_take_unescaped(struct text *t, char plus, char *out, size_t room)
{
    size_t n = 0;
    for (; t->p < t->end; t->p++) {
        char c = *t->p == '+' ? plus : *t->p;
        if (c == '%') {
            int hi = t->end - t->p > 2 ? text_hex(t->p[1]) : -1,
                lo = hi < 0 ? -1 : text_hex(t->p[2]);
            if (lo < 0)
                return false;
            c = (char)(hi * 16 + lo);
            t->p += 2;
        }
        if (n + 1 >= room || (unsigned char)c < 0x20 || c == 0x7f)
            return false;
        out[n++] = c;
    }
    out[n] = '\0';
    return true;
}

bool text_take_decoded(struct text *t, char *out, size_t room)
{
    return text_take_unescaped(t, ' ', out, room) && *out && text_is_utf8(out);
}

bool text_is_utf8(const char *text)
{
    json_t *o = json_string(text); /* NULL for anything else, or without memory */
    bool is = o != NULL;
    json_decref(o);
    return is;
}

static bool text_is_control(unsigned char c)
{
    return (c < 0x20 && c != '\t') || c == 0x7f;
}

enum { TEXT_WORD = 8 };

/* Eight bytes: which are below 0x20 or 0x7f shows in their highest bits; a false alarm (tabs, or a
 * byte above a hit) costs a closer look. */
static bool text_word_is_clean(const char *p)
{
    const uint64_t ones = 0x0101010101010101u, high = 0x80 * ones;
    uint64_t x;
    memcpy(&x, p, sizeof x);
    const uint64_t del = x ^ 0x7f * ones;
    if (!((((x - 0x20 * ones) & ~x) | ((del - ones) & ~del)) & high))
        return true;
    for (size_t i = 0; i < TEXT_WORD; i++)
        if (text_is_control((unsigned char)p[i]))
            return false;
    return true;
}

bool text_is_clean(const char *p, size_t n)
{
    if (n >= TEXT_WORD) { /* the last word begins within the one before it */
        for (; n > TEXT_WORD; p += TEXT_WORD, n -= TEXT_WORD)
            if (!text_word_is_clean(p))
                return false;
        return text_word_is_clean(p + n - TEXT_WORD);
    }
    for (; n; p++, n--)
        if (text_is_control((unsigned char)*p))
            return false;
    return true;
}

char *text_put(char *p, const char *word)
{
    size_t n = strlen(word);
    memcpy(p, word, n); // NOLINT(bugprone-not-null-terminated-result): the caller ends the text
    return p + n;
}

char *text_put_uint(char *p, uint32_t v)
{
    char digits[TEXT_UINT];
    int n = 0;
    do
        digits[n++] = (char)('0' + v % 10);
    while (v /= 10);
    while (n)
        *p++ = digits[--n];
    return p;
}

void text_escape(const char *text, char *out)
{
    static const char hex[] = "0123456789ABCDEF";
    for (; *text; text++) {
        unsigned char c = (unsigned char)*text;
        bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
                     strchr("-._~,:=", c);
        if (plain) {
            *out++ = (char)c;
        } else {
            *out++ = '%';
            *out++ = hex[c >> 4];
            *out++ = hex[c & 15];
        }
    }
    *out = '\0';
}
