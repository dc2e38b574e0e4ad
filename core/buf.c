/* Byte strings: a growing writer with a sticky error, and a bounds-checked reader. Little-endian
 * files on any host.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "core/base.h"

static bool buf_reserve_for(struct buf *b, size_t n)
{
    if (b->failed)
        return false;
    if (b->data && n <= b->cap - b->size)
        return true;
    size_t cap = b->cap ? b->cap : 256;
    if (n > SIZE_MAX / 4 || cap > SIZE_MAX / 4) {
        b->failed = true;
        return false;
    }
    if (b->cap)
        cap *= 2;
    if (cap < b->size + n)
        cap = b->size + n;
    uint8_t *p = mem_uninit(cap, 1);
    if (!p) {
        b->failed = true;
        return false;
    }
    if (b->size)
        memcpy(p, b->data, b->size);
    mem_free(b->data);
    b->data = p;
    b->cap = cap;
    return true;
}

uint8_t *buf_grow(struct buf *b, size_t n)
{
    if (!buf_reserve_for(b, n))
        return NULL;
    uint8_t *p = b->data + b->size;
    b->size += n;
    return p;
}

void buf_add(struct buf *b, const void *bytes, size_t n)
{
    uint8_t *p = buf_grow(b, n);
    if (p && n)
        memcpy(p, bytes, n);
}

static void buf_le(struct buf *b, uint64_t v, size_t n)
{
    uint8_t *p = buf_grow(b, n);
    for (size_t i = 0; p && i < n; i++)
        p[i] = (uint8_t)(v >> (8 * i));
}

void buf_u8(struct buf *b, unsigned v)
{
    buf_le(b, v, 1);
}

void buf_u16(struct buf *b, unsigned v)
{
    buf_le(b, v, 2);
}

void buf_u32(struct buf *b, uint32_t v)
{
    buf_le(b, v, 4);
}

void buf_u64(struct buf *b, uint64_t v)
{
    buf_le(b, v, 8);
}

void buf_f32(struct buf *b, float v)
{
    uint32_t u;
    memcpy(&u, &v, sizeof u);
    buf_le(b, u, 4);
}

void buf_f64(struct buf *b, double v)
{
    uint64_t u;
    memcpy(&u, &v, sizeof u);
    buf_le(b, u, 8);
}

void buf_printf(struct buf *b, const char *fmt, ...)
{
    va_list ap;
    va_start(ap, fmt);
    va_list again;
    va_copy(again, ap);
    int n = vsnprintf(NULL, 0, fmt, ap);
    va_end(ap);
    if (n < 0)
        b->failed = true;
    else if (buf_reserve_for(b, (size_t)n + 1)) {
        vsnprintf((char *)b->data + b->size, (size_t)n + 1, fmt, again);
        b->size += (size_t)n;
    }
    va_end(again);
}

void buf_markup(struct buf *b, const char *text)
{
    for (; text && *text; text++)
        switch (*text) {
        case '&':
            buf_printf(b, "&amp;");
            break;
        case '<':
            buf_printf(b, "&lt;");
            break;
        case '>':
            buf_printf(b, "&gt;");
            break;
        case '"':
            buf_printf(b, "&quot;");
            break;
        case '\'':
            buf_printf(b, "&#39;");
            break;
        default:
            if ((unsigned char)*text >= 0x20 || strchr("\t\n\r", *text))
                buf_u8(b, (uint8_t)*text);
        }
}

enum err_code buf_check(const struct buf *b, struct err *e)
{
    return b->failed ? err_set(e, ERR_MEM, "out of memory for %zu bytes", b->size) : ERR_OK;
}

void buf_free(struct buf *b)
{
    mem_free(b->data);
    *b = (struct buf){0};
}

struct cursor cursor_over(const void *bytes, size_t n)
{
    const uint8_t *p = bytes;
    return (struct cursor){.p = p, .end = n ? p + n : p, .bad = false};
}

size_t cursor_left(const struct cursor *c)
{
    return (size_t)(c->end - c->p);
}

const uint8_t *cursor_take(struct cursor *c, size_t n)
{
    if (c->bad || n > cursor_left(c)) {
        c->bad = true;
        return NULL;
    }
    const uint8_t *p = c->p;
    c->p += n;
    return p;
}

static uint64_t buf_cursor_le(struct cursor *c, size_t n)
{
    const uint8_t *p = cursor_take(c, n);
    uint64_t v = 0;
    for (size_t i = 0; p && i < n; i++)
        v |= (uint64_t)p[i] << (8 * i);
    return v;
}

uint8_t cursor_u8(struct cursor *c)
{
    return (uint8_t)buf_cursor_le(c, 1);
}

uint16_t cursor_u16(struct cursor *c)
{
    return (uint16_t)buf_cursor_le(c, 2);
}

uint32_t cursor_u32(struct cursor *c)
{
    return (uint32_t)buf_cursor_le(c, 4);
}

uint64_t cursor_u64(struct cursor *c)
{
    return buf_cursor_le(c, 8);
}

float cursor_f32(struct cursor *c)
{
    uint32_t u = cursor_u32(c);
    float v;
    memcpy(&v, &u, sizeof v);
    return v;
}

double cursor_f64(struct cursor *c)
{
    uint64_t u = cursor_u64(c);
    double v;
    memcpy(&v, &u, sizeof v);
    return v;
}
