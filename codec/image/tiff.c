/* TIFF directories: see tiff.h.
 *
 * Sources: TIFF 6.0, and EXIF 2.32 (CIPA DC-008) for the signed types.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/tiff.h"

#include <math.h>
#include <string.h>

#include "core/base.h"

enum { TIFF_WRAPPED = 100000 /* no angle, and no altitude in metres, is larger */ };

/* ---- reading ---- */

uint32_t tiff_uint(const struct tiff *t, const uint8_t *p, unsigned bytes)
{
    uint32_t v = 0;
    for (unsigned i = 0; i < bytes; i++)
        v |= (uint32_t)p[i] << 8 * (t->big_endian ? bytes - 1 - i : i);
    return v;
}

static size_t tiff_type_bytes(unsigned type)
{
    static const uint8_t size[] = {0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8, 4};
    return type < sizeof size ? size[type] : 0;
}

bool tiff_open(const uint8_t *p, size_t n, struct tiff *t, uint32_t *ifd0)
{
    if (n < 8 || (memcmp(p, "II*\0", 4) && memcmp(p, "MM\0*", 4)))
        return false;
    *t = (struct tiff){.p = p, .n = n, .big_endian = p[0] == 'M'};
    *ifd0 = tiff_uint(t, p + 4, 4);
    return true;
}

bool tiff_find(const struct tiff *t, uint32_t ifd, unsigned tag, struct tiff_field *f)
{
    if (!ifd || ifd > t->n || t->n - ifd < 2)
        return false;
    size_t count = tiff_uint(t, t->p + ifd, 2);
    for (size_t i = 0; i < count; i++) {
        size_t at = ifd + 2 + 12 * i;
        if (at > t->n || t->n - at < 12)
            return false;
        const uint8_t *entry = t->p + at;
        if (tiff_uint(t, entry, 2) != tag)
            continue;
        f->type = tiff_uint(t, entry + 2, 2);
        f->count = tiff_uint(t, entry + 4, 4);
        size_t each = tiff_type_bytes(f->type);
        if (!each || !f->count || f->count > t->n / each)
            return false;
        f->n = each * f->count;
        size_t offset = f->n <= 4 ? at + 8 : tiff_uint(t, entry + 8, 4);
        if (offset > t->n || t->n - offset < f->n)
            return false;
        f->data = t->p + offset;
        return true;
    }
    return false;
}

static int32_t tiff_signed(uint32_t v, size_t bytes)
{
    return bytes == 1 ? (int8_t)v : bytes == 2 ? (int16_t)v : (int32_t)v;
}

bool tiff_field_num(const struct tiff *t, const struct tiff_field *f, size_t i, double *out)
{
    const size_t bytes = tiff_type_bytes(f->type);
    if (i >= f->count)
        return false;
    const uint8_t *p = f->data + i * bytes;
    uint32_t v = tiff_uint(t, p, bytes < 4 ? (unsigned)bytes : 4), den;
    uint64_t wide;
    float single;
    switch (f->type) {
    case TIFF_BYTE:
    case TIFF_SHORT:
    case TIFF_LONG:
    case TIFF_IFD:
        *out = v;
        break;
    case TIFF_SBYTE:
    case TIFF_SSHORT:
    case TIFF_SLONG:
        *out = tiff_signed(v, bytes);
        break;
    case TIFF_RATIONAL:
    case TIFF_SRATIONAL:
        den = tiff_uint(t, p + 4, 4);
        if (!den || (f->type == TIFF_RATIONAL && v == UINT32_MAX))
            return false;
        *out = f->type == TIFF_RATIONAL ? (double)v / den : (double)(int32_t)v / (int32_t)den;
        if (*out > TIFF_WRAPPED && v > INT32_MAX) /* a negative number without its type */
            *out = (double)(int32_t)v / den;
        break;
    case TIFF_FLOAT:
        memcpy(&single, &v, sizeof single);
        *out = (double)single;
        break;
    case TIFF_DOUBLE:
        wide = tiff_uint(t, p + 4, 4);
        wide = t->big_endian ? (uint64_t)v << 32 | wide : wide << 32 | v;
        memcpy(out, &wide, sizeof *out);
        break;
    default:
        return false;
    }
    return isfinite(*out);
}

double tiff_num(const struct tiff *t, uint32_t ifd, unsigned tag)
{
    struct tiff_field f;
    double v;
    return tiff_find(t, ifd, tag, &f) && tiff_field_num(t, &f, 0, &v) ? v : 0;
}

uint32_t tiff_offset(const struct tiff *t, uint32_t ifd, unsigned tag)
{
    double v = tiff_num(t, ifd, tag);
    return v >= 0 && v <= UINT32_MAX ? (uint32_t)v : 0;
}

void tiff_text(const struct tiff *t, uint32_t ifd, unsigned tag, char *out, size_t room)
{
    struct tiff_field f;
    size_t n = 0;
    if (tiff_find(t, ifd, tag, &f) && f.type == TIFF_ASCII)
        while (n < f.count && n + 1 < room && f.data[n] >= 0x20 && f.data[n] < 0x7f) {
            out[n] = (char)f.data[n];
            n++;
        }
    while (n && out[n - 1] == ' ')
        n--;
    out[n] = '\0';
}

/* ---- writing ---- */

void tiff_put_u32(uint8_t *p, uint32_t v)
{
    for (int i = 0; i < 4; i++)
        p[i] = (uint8_t)(v >> 8 * i);
}

struct tiff_entry tiff_entry_text(unsigned tag, const char *text)
{
    struct tiff_entry en = {.tag = (uint16_t)tag, .type = TIFF_ASCII};
    size_t len = strlen(text) < sizeof en.data - 1 ? strlen(text) : sizeof en.data - 1;
    memcpy(en.data, text, len);
    en.count = en.size = (uint32_t)len + 1;
    return en;
}

struct tiff_entry tiff_entry_num(unsigned tag, unsigned type, uint32_t v)
{
    struct tiff_entry en = {.tag = (uint16_t)tag, .type = (uint16_t)type, .count = 1};
    en.size = (uint32_t)tiff_type_bytes(type);
    tiff_put_u32(en.data, v);
    return en;
}

void tiff_entry_ratio(struct tiff_entry *en, double v, double den)
{
    double num = round(v * den);
    tiff_put_u32(en->data + en->size, num < 0 ? 0 : num > UINT32_MAX ? UINT32_MAX : (uint32_t)num);
    tiff_put_u32(en->data + en->size + 4, (uint32_t)den);
    en->size += 8;
    en->count++;
}

struct tiff_entry tiff_entry_rational(unsigned tag, double v, double den)
{
    struct tiff_entry en = {.tag = (uint16_t)tag, .type = TIFF_RATIONAL};
    while (den > 1 && v * den > UINT32_MAX) /* precision gives way to range */
        den = floor(den / 10);
    tiff_entry_ratio(&en, v, den);
    return en;
}

void tiff_write(struct buf *b, uint32_t base, const struct tiff_entry *en, size_t n)
{
    uint32_t at = base + 2 + 12 * (uint32_t)n + 4;
    buf_u16(b, (unsigned)n);
    for (size_t i = 0; i < n; i++) {
        buf_u16(b, en[i].tag);
        buf_u16(b, en[i].type);
        buf_u32(b, en[i].count);
        if (en[i].size <= 4) {
            buf_add(b, en[i].data, 4);
            continue;
        }
        buf_u32(b, at);
        at += (en[i].size + 1) & ~1u;
    }
    buf_u32(b, 0);
    for (size_t i = 0; i < n; i++)
        if (en[i].size > 4)
            buf_add(b, en[i].data, (en[i].size + 1) & ~1u);
}
