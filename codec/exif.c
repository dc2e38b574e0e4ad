/* EXIF position, time and exposure of photographs, read from and put into JPEG, PNG, WebP and TIFF.
 *
 * EXIF is a small TIFF file inside the picture. OpenImageIO reads its rationals into float32, which
 * is a metre at the equator for cameras that write decimal degrees, and its writer stores no GPS in
 * PNG, WebP and TIFF (and 0.5" as infinity in JPEG). So the dozen fields that georeferencing needs
 * are handled here: all arithmetic in double, every offset checked against the bytes at hand.
 *
 * Sources: EXIF 2.32 (CIPA DC-008), TIFF 6.0, PNG 1.5 extensions (eXIf), RIFF container of WebP.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/exif.h"
#include "codec/exif_camera.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <zlib.h>

#include "core/base.h"

enum {
    TAG_EXIF_IFD = 0x8769,
    TAG_GPS_IFD = 0x8825,
    TAG_EXPOSURE = 0x829a,
    TAG_ISO = 0x8827,
    TAG_DATE_ORIGINAL = 0x9003,
    TAG_FOCAL = 0x920a,
    TAG_FOCAL_35MM = 0xa405,
    TAG_MAKE = 0x010f,
    TAG_MODEL = 0x0110,
    TAG_GPS_LAT_REF = 1,
    TAG_GPS_LAT = 2,
    TAG_GPS_LON_REF = 3,
    TAG_GPS_LON = 4,
    TAG_GPS_ALT_REF = 5,
    TAG_GPS_ALT = 6,
    TYPE_BYTE = 1,
    TYPE_ASCII = 2,
    TYPE_SHORT = 3,
    TYPE_LONG = 4,
    TYPE_RATIONAL = 5,
    TYPE_SRATIONAL = 10,
    HEAD_BYTES = 256 * 1024, /* an APP1 segment is at most 64 KiB and comes first */
};

/* ---- reading ---- */

struct tiff {
    const uint8_t *p;
    size_t n;
    bool big_endian;
};
struct field {
    unsigned type;
    uint32_t count;
    const uint8_t *data; /* checked to hold count values */
};

static uint32_t exif_tiff_uint(const struct tiff *t, const uint8_t *p, unsigned bytes)
{
    uint32_t v = 0;
    for (unsigned i = 0; i < bytes; i++)
        v |= (uint32_t)p[i] << 8 * (t->big_endian ? bytes - 1 - i : i);
    return v;
}

static size_t exif_type_bytes(unsigned type)
{
    static const uint8_t size[] = {0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8};
    return type < sizeof size ? size[type] : 0;
}

static bool exif_tiff_open(const uint8_t *p, size_t n, struct tiff *t, uint32_t *ifd0)
{
    if (n < 8 || (memcmp(p, "II*\0", 4) && memcmp(p, "MM\0*", 4)))
        return false;
    *t = (struct tiff){.p = p, .n = n, .big_endian = p[0] == 'M'};
    *ifd0 = exif_tiff_uint(t, p + 4, 4);
    return true;
}

static bool exif_ifd_find(const struct tiff *t, uint32_t ifd, unsigned tag, struct field *f)
{
    if (!ifd || ifd > t->n || t->n - ifd < 2)
        return false;
    size_t count = exif_tiff_uint(t, t->p + ifd, 2);
    for (size_t i = 0; i < count; i++) {
        size_t at = ifd + 2 + 12 * i;
        if (at > t->n || t->n - at < 12)
            return false;
        const uint8_t *entry = t->p + at;
        if (exif_tiff_uint(t, entry, 2) != tag)
            continue;
        f->type = exif_tiff_uint(t, entry + 2, 2);
        f->count = exif_tiff_uint(t, entry + 4, 4);
        size_t each = exif_type_bytes(f->type);
        if (!each || !f->count || f->count > t->n / each)
            return false;
        size_t bytes = each * f->count;
        size_t offset = bytes <= 4 ? at + 8 : exif_tiff_uint(t, entry + 8, 4);
        if (offset > t->n || t->n - offset < bytes)
            return false;
        f->data = t->p + offset;
        return true;
    }
    return false;
}

static bool exif_field_num(const struct tiff *t, const struct field *f, size_t i, double *out)
{
    if (i >= f->count)
        return false;
    const uint8_t *p = f->data + i * exif_type_bytes(f->type);
    if (f->type == TYPE_SHORT || f->type == TYPE_LONG || f->type == TYPE_BYTE) {
        *out = exif_tiff_uint(t, p, (unsigned)exif_type_bytes(f->type));
        return true;
    }
    if (f->type != TYPE_RATIONAL && f->type != TYPE_SRATIONAL)
        return false;
    uint32_t num = exif_tiff_uint(t, p, 4), den = exif_tiff_uint(t, p + 4, 4);
    if (!den)
        return false;
    *out = f->type == TYPE_RATIONAL ? (double)num / den : (double)(int32_t)num / (int32_t)den;
    return true;
}

static double exif_ifd_num(const struct tiff *t, uint32_t ifd, unsigned tag)
{
    struct field f;
    double v;
    return exif_ifd_find(t, ifd, tag, &f) && exif_field_num(t, &f, 0, &v) ? v : 0;
}

static uint32_t exif_ifd_offset(const struct tiff *t, uint32_t ifd, unsigned tag)
{
    double v = exif_ifd_num(t, ifd, tag);
    return v >= 0 && v <= UINT32_MAX ? (uint32_t)v : 0;
}

/* Degrees, minutes and seconds; missing or 0/0 minutes and seconds count as 0 (decimal degrees). */
static bool exif_ifd_angle(const struct tiff *t, uint32_t ifd, unsigned tag, char negative,
                           double *out)
{
    struct field f, ref;
    double deg, min = 0, sec = 0;
    if (!exif_ifd_find(t, ifd, tag, &f) || !exif_field_num(t, &f, 0, &deg))
        return false;
    if (!exif_field_num(t, &f, 1, &min))
        min = 0;
    if (!exif_field_num(t, &f, 2, &sec))
        sec = 0;
    *out = deg + min / 60 + sec / 3600;
    if (exif_ifd_find(t, ifd, tag - 1, &ref) && (ref.data[0] | 0x20) == (negative | 0x20))
        *out = -*out;
    return true;
}

static void exif_blob(const uint8_t *p, size_t n, struct image_gps *out)
{
    struct tiff t;
    uint32_t ifd0;
    struct field f;
    if (!exif_tiff_open(p, n, &t, &ifd0))
        return;
    uint32_t exif = exif_ifd_offset(&t, ifd0, TAG_EXIF_IFD);
    uint32_t gps = exif_ifd_offset(&t, ifd0, TAG_GPS_IFD);
    out->exposure_s = exif_ifd_num(&t, exif, TAG_EXPOSURE);
    out->iso = exif_ifd_num(&t, exif, TAG_ISO);
    out->focal_mm = exif_ifd_num(&t, exif, TAG_FOCAL);
    if (exif_ifd_find(&t, exif, TAG_DATE_ORIGINAL, &f) && f.type == TYPE_ASCII) {
        size_t len = f.count < sizeof out->time - 1 ? f.count : sizeof out->time - 1;
        for (size_t i = 0; i < len && f.data[i] >= 0x20 && f.data[i] < 0x7f; i++)
            out->time[i] = (char)f.data[i];
    }
    double lat, lon, below = 0;
    if (exif_ifd_angle(&t, gps, TAG_GPS_LAT, 'S', &lat) &&
        exif_ifd_angle(&t, gps, TAG_GPS_LON, 'W', &lon) && fabs(lat) <= 90 && fabs(lon) <= 180) {
        out->has_position = true;
        out->lat_deg = lat;
        out->lon_deg = lon;
    }
    if (exif_ifd_find(&t, gps, TAG_GPS_ALT, &f) && exif_field_num(&t, &f, 0, &out->alt_m)) {
        out->has_altitude = true;
        if (exif_ifd_find(&t, gps, TAG_GPS_ALT_REF, &f) && exif_field_num(&t, &f, 0, &below) &&
            below == 1)
            out->alt_m = -out->alt_m;
    }
}

static uint32_t exif_be32(const uint8_t *p)
{
    return (uint32_t)p[0] << 24 | (uint32_t)p[1] << 16 | (uint32_t)p[2] << 8 | p[3];
}

static uint32_t exif_le32(const uint8_t *p)
{
    return (uint32_t)p[3] << 24 | (uint32_t)p[2] << 16 | (uint32_t)p[1] << 8 | p[0];
}

static bool exif_is_jpeg(const uint8_t *p, size_t n)
{
    return n >= 4 && p[0] == 0xff && p[1] == 0xd8;
}

static bool exif_is_png(const uint8_t *p, size_t n)
{
    return n >= 33 && !memcmp(p, "\x89PNG\r\n\x1a\n", 8);
}

static bool exif_is_webp(const uint8_t *p, size_t n)
{
    return n >= 20 && !memcmp(p, "RIFF", 4) && !memcmp(p + 8, "WEBP", 4);
}

static void exif_parse_jpeg(const uint8_t *p, size_t n, struct image_gps *out)
{
    for (size_t at = 2; at + 4 <= n && p[at] == 0xff && p[at + 1] != 0xda;) {
        size_t len = (size_t)p[at + 2] << 8 | p[at + 3];
        if (len < 2 || len > n - at - 2)
            return;
        if (p[at + 1] == 0xe1 && len >= 8 && !memcmp(p + at + 4, "Exif\0\0", 6)) {
            exif_blob(p + at + 10, len - 8, out);
            return;
        }
        at += 2 + len;
    }
}

static void exif_parse_png(const uint8_t *p, size_t n, struct image_gps *out)
{
    for (size_t at = 8; n - at >= 12;) {
        size_t len = exif_be32(p + at);
        if (len > n - at - 12)
            return;
        if (!memcmp(p + at + 4, "eXIf", 4)) {
            exif_blob(p + at + 8, len, out);
            return;
        }
        at += 12 + len;
    }
}

static void exif_parse_webp(const uint8_t *p, size_t n, struct image_gps *out)
{
    for (size_t at = 12; at <= n && n - at >= 8;) {
        size_t len = exif_le32(p + at + 4);
        if (len > n - at - 8)
            return;
        if (!memcmp(p + at, "EXIF", 4)) {
            size_t skip = len >= 6 && !memcmp(p + at + 8, "Exif\0\0", 6) ? 6 : 0;
            exif_blob(p + at + 8 + skip, len - skip, out);
            return;
        }
        at += 8 + len + (len & 1);
    }
}

void exif_parse(const void *bytes, size_t n, struct image_gps *out)
{
    const uint8_t *p = bytes;
    *out = (struct image_gps){0};
    if (exif_is_jpeg(p, n))
        exif_parse_jpeg(p, n, out);
    else if (exif_is_png(p, n))
        exif_parse_png(p, n, out);
    else if (exif_is_webp(p, n))
        exif_parse_webp(p, n, out);
    else
        exif_blob(p, n, out);
}

enum err_code exif_read(const char *path, struct image_gps *out, struct err *e)
{
    *out = (struct image_gps){0};
    FILE *f = fopen(path, "rb");
    if (!f)
        return err_errno(e, file_exists(path) ? ERR_IO : ERR_NOENT, "exif: %s", path);
    uint8_t *head = mem_array(HEAD_BYTES, 1);
    if (!head) {
        fclose(f);
        return err_set(e, ERR_MEM, "exif: %s: out of memory", path);
    }
    size_t n = fread(head, 1, HEAD_BYTES, f);
    fclose(f);
    exif_parse(head, n, out);
    bool whole = n < HEAD_BYTES || exif_is_jpeg(head, n);
    mem_free(head);
    if (whole)
        return ERR_OK;
    struct buf b = {0}; /* WebP and TIFF may keep it at the end */
    enum err_code rc = file_read(path, 0, &b, e);
    if (!rc)
        exif_parse(b.data, b.size, out);
    buf_free(&b);
    return rc;
}

/* ---- the camera ---- */

/* Printable text of a field, without blanks at its end. */
static void exif_ifd_text(const struct tiff *t, uint32_t ifd, unsigned tag, char *out, size_t room)
{
    struct field f;
    size_t n = 0;
    if (exif_ifd_find(t, ifd, tag, &f) && f.type == TYPE_ASCII)
        while (n < f.count && n + 1 < room && f.data[n] >= 0x20 && f.data[n] < 0x7f) {
            out[n] = (char)f.data[n];
            n++;
        }
    while (n && out[n - 1] == ' ')
        n--;
    out[n] = '\0';
}

static void exif_camera_blob(const uint8_t *p, size_t n, struct exif_camera *out)
{
    struct tiff t;
    uint32_t ifd0;
    char make[40], model[48];
    if (!exif_tiff_open(p, n, &t, &ifd0))
        return;
    uint32_t exif = exif_ifd_offset(&t, ifd0, TAG_EXIF_IFD);
    exif_ifd_text(&t, ifd0, TAG_MAKE, make, sizeof make);
    exif_ifd_text(&t, ifd0, TAG_MODEL, model, sizeof model);
    bool twice = !strncmp(model, make, strlen(make)); /* many models begin with the maker */
    snprintf(out->model, sizeof out->model, "%s%s%s", twice ? "" : make,
             !twice && *make && *model ? " " : "", model);
    out->focal_mm = exif_ifd_num(&t, exif, TAG_FOCAL);
    out->focal_35mm = exif_ifd_num(&t, exif, TAG_FOCAL_35MM);
}

enum err_code exif_camera_read(const char *path, struct exif_camera *out, struct err *e)
{
    struct buf b = {0};
    *out = (struct exif_camera){0};
    enum err_code rc = file_read(path, 0, &b, e);
    const uint8_t *p = b.data;
    if (!rc && exif_is_jpeg(p, b.size)) {
        for (size_t at = 2; at + 4 <= b.size && p[at] == 0xff && p[at + 1] != 0xda;) {
            size_t len = (size_t)p[at + 2] << 8 | p[at + 3];
            if (len < 2 || len > b.size - at - 2)
                break;
            if (p[at + 1] == 0xe1 && len >= 8 && !memcmp(p + at + 4, "Exif\0\0", 6)) {
                exif_camera_blob(p + at + 10, len - 8, out);
                break;
            }
            at += 2 + len;
        }
    } else if (!rc) {
        exif_camera_blob(p, b.size, out);
    }
    buf_free(&b);
    return rc;
}

/* ---- writing ---- */

struct entry {
    uint16_t tag, type;
    uint32_t count, size;
    uint8_t data[32];
};

static void exif_put_u32(uint8_t *p, uint32_t v)
{
    for (int i = 0; i < 4; i++)
        p[i] = (uint8_t)(v >> 8 * i);
}

static void exif_put_be32(uint8_t *p, uint32_t v)
{
    for (int i = 0; i < 4; i++)
        p[i] = (uint8_t)(v >> (24 - 8 * i));
}

static struct entry exif_entry_text(unsigned tag, const char *text)
{
    struct entry en = {.tag = (uint16_t)tag, .type = TYPE_ASCII};
    size_t len = strlen(text) < sizeof en.data - 1 ? strlen(text) : sizeof en.data - 1;
    memcpy(en.data, text, len);
    en.count = en.size = (uint32_t)len + 1;
    return en;
}

static struct entry exif_entry_num(unsigned tag, unsigned type, uint32_t v)
{
    struct entry en = {.tag = (uint16_t)tag, .type = (uint16_t)type, .count = 1};
    en.size = (uint32_t)exif_type_bytes(type);
    exif_put_u32(en.data, v);
    return en;
}

static void exif_entry_ratio(struct entry *en, double v, double den)
{
    double num = round(v * den);
    exif_put_u32(en->data + en->size, num < 0 ? 0 : num > UINT32_MAX ? UINT32_MAX : (uint32_t)num);
    exif_put_u32(en->data + en->size + 4, (uint32_t)den);
    en->size += 8;
    en->count++;
}

static struct entry exif_entry_rational(unsigned tag, double v, double den)
{
    struct entry en = {.tag = (uint16_t)tag, .type = TYPE_RATIONAL};
    while (den > 1 && v * den > UINT32_MAX) /* precision gives way to range */
        den = floor(den / 10);
    exif_entry_ratio(&en, v, den);
    return en;
}

static struct entry exif_entry_angle(unsigned tag, double deg)
{
    struct entry en = {.tag = (uint16_t)tag, .type = TYPE_RATIONAL};
    double units = round(fabs(deg) * 3600 * 1e7); /* 1e-7 arc seconds; carried before splitting */
    double minutes = floor(units / 6e8);
    exif_entry_ratio(&en, floor(minutes / 60), 1);
    exif_entry_ratio(&en, fmod(minutes, 60), 1);
    exif_entry_ratio(&en, (units - minutes * 6e8) / 1e7, 1e7);
    return en;
}

/* One IFD at offset `base` of the block, its values right behind it. Entries sorted by tag. */
static void exif_ifd_write(struct buf *b, uint32_t base, const struct entry *en, size_t n)
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

/* Appends the Exif and GPS IFDs to b, whose offsets count from b's start + `shift`; returns where
 * each is. */
static void exif_sub_ifds_write(struct buf *b, uint32_t shift, const struct image_gps *g,
                                uint32_t *exif, uint32_t *gps)
{
    struct entry en[8];
    size_t n = 0;
    if (g->exposure_s > 0)
        en[n++] = g->exposure_s < 1 ? exif_entry_rational(TAG_EXPOSURE, g->exposure_s, 1e9)
                                    : exif_entry_rational(TAG_EXPOSURE, g->exposure_s, 1e6);
    if (g->iso > 0)
        en[n++] =
            exif_entry_num(TAG_ISO, TYPE_SHORT, g->iso < 65535 ? (uint32_t)lround(g->iso) : 65535);
    if (g->time[0])
        en[n++] = exif_entry_text(TAG_DATE_ORIGINAL, g->time);
    if (g->focal_mm > 0)
        en[n++] = exif_entry_rational(TAG_FOCAL, g->focal_mm, 1e5);
    *exif = (uint32_t)b->size + shift;
    exif_ifd_write(b, *exif, en, n);

    n = 0;
    en[n++] = exif_entry_num(0, TYPE_BYTE, 0x00000302); /* GPSVersionID 2.3.0.0 */
    en[0].count = en[0].size = 4;
    if (g->has_position) {
        en[n++] = exif_entry_text(TAG_GPS_LAT_REF, g->lat_deg < 0 ? "S" : "N");
        en[n++] = exif_entry_angle(TAG_GPS_LAT, g->lat_deg);
        en[n++] = exif_entry_text(TAG_GPS_LON_REF, g->lon_deg < 0 ? "W" : "E");
        en[n++] = exif_entry_angle(TAG_GPS_LON, g->lon_deg);
    }
    if (g->has_altitude) {
        en[n++] = exif_entry_num(TAG_GPS_ALT_REF, TYPE_BYTE, g->alt_m < 0);
        en[n++] = exif_entry_rational(TAG_GPS_ALT, fabs(g->alt_m), 1e4);
    }
    *gps = (uint32_t)b->size + shift;
    exif_ifd_write(b, *gps, en, n);
}

static void exif_blob_write(struct buf *b, const struct image_gps *g)
{
    enum { IFD0 = 8, IFD0_BYTES = 2 + 2 * 12 + 4 };
    struct buf sub = {0};
    uint32_t exif = 0, gps = 0;
    exif_sub_ifds_write(&sub, IFD0 + IFD0_BYTES, g, &exif, &gps);
    buf_add(b, "II*\0", 4);
    buf_u32(b, IFD0);
    struct entry en[2] = {exif_entry_num(TAG_EXIF_IFD, TYPE_LONG, exif),
                          exif_entry_num(TAG_GPS_IFD, TYPE_LONG, gps)};
    exif_ifd_write(b, IFD0, en, 2);
    buf_add(b, sub.data, sub.size);
    b->failed = b->failed || sub.failed;
    buf_free(&sub);
}

/* What follows the head of a JPEG, but for Exif that its encoder put in: of two, some readers take
 * the other. */
static void exif_copy_jpeg(const struct buf *file, struct buf *out)
{
    const uint8_t *p = file->data;
    size_t at = 2;
    while (at + 4 <= file->size && p[at] == 0xff && p[at + 1] != 0xda) {
        size_t len = 2 + ((size_t)p[at + 2] << 8 | p[at + 3]);
        if (len > file->size - at)
            break;
        if (p[at + 1] != 0xe1 || len < 10 || memcmp(p + at + 4, "Exif\0\0", 6) != 0)
            buf_add(out, p + at, len);
        at += len;
    }
    buf_add(out, p + at, file->size - at);
}

static void exif_insert_jpeg(const struct buf *file, const struct buf *blob, struct buf *out)
{
    size_t len = blob->size + 8;
    buf_add(out, file->data, 2);
    buf_u8(out, 0xff);
    buf_u8(out, 0xe1);
    buf_u8(out, (unsigned)(len >> 8));
    buf_u8(out, (unsigned)(len & 255));
    buf_add(out, "Exif\0\0", 6);
    buf_add(out, blob->data, blob->size);
    exif_copy_jpeg(file, out);
}

static void exif_insert_png(const struct buf *file, const struct buf *blob, struct buf *out)
{
    enum { AFTER_IHDR = 33 };
    uint8_t word[4];
    buf_add(out, file->data, AFTER_IHDR);
    exif_put_be32(word, (uint32_t)blob->size);
    buf_add(out, word, 4);
    size_t start = out->size;
    buf_add(out, "eXIf", 4);
    buf_add(out, blob->data, blob->size);
    if (!out->failed)
        exif_put_be32(word, (uint32_t)crc32(0, out->data + start, (uInt)(out->size - start)));
    buf_add(out, word, 4);
    buf_add(out, file->data + AFTER_IHDR, file->size - AFTER_IHDR);
}

/* EXIF needs the extended header VP8X, which repeats the size of the picture. */
static bool exif_insert_webp(const struct buf *file, const struct buf *blob, struct buf *out)
{
    const uint8_t *p = file->data + 12;
    size_t left = file->size - 12;
    uint32_t w, h, flags = 0x08;
    if (!memcmp(p, "VP8 ", 4) && left >= 18) {
        w = (p[14] | (uint32_t)p[15] << 8) & 0x3fff;
        h = (p[16] | (uint32_t)p[17] << 8) & 0x3fff;
    } else if (!memcmp(p, "VP8L", 4) && left >= 13) {
        uint32_t bits = exif_le32(p + 9);
        w = (bits & 0x3fff) + 1;
        h = (bits >> 14 & 0x3fff) + 1;
        flags |= bits >> 28 & 1 ? 0x10 : 0;
    } else {
        return false;
    }
    buf_add(out, file->data, 12);
    buf_add(out, "VP8X", 4);
    buf_u32(out, 10);
    buf_u32(out, flags);
    buf_u16(out, (w - 1) & 0xffff);
    buf_u8(out, (w - 1) >> 16);
    buf_u16(out, (h - 1) & 0xffff);
    buf_u8(out, (h - 1) >> 16);
    buf_add(out, p, left);
    if (left & 1)
        buf_u8(out, 0);
    buf_add(out, "EXIF", 4);
    buf_u32(out, (uint32_t)blob->size);
    buf_add(out, blob->data, blob->size);
    if (blob->size & 1)
        buf_u8(out, 0);
    if (!out->failed)
        exif_put_u32(out->data + 4, (uint32_t)out->size - 8);
    return true;
}

/* A new first IFD at the end of the file: the old entries and the two pointers, sorted by tag. */
static bool exif_insert_tiff(const struct buf *file, const struct image_gps *g, struct buf *out)
{
    struct tiff t;
    uint32_t ifd0, exif, gps;
    if (!exif_tiff_open(file->data, file->size, &t, &ifd0) || t.big_endian || ifd0 > t.n ||
        t.n - ifd0 < 2 || t.n > UINT32_MAX / 2)
        return false;
    size_t n = exif_tiff_uint(&t, t.p + ifd0, 2);
    if (t.n - ifd0 - 2 < 12 * n)
        return false;
    buf_add(out, file->data, file->size);
    if (out->size & 1)
        buf_u8(out, 0);
    exif_sub_ifds_write(out, 0, g, &exif, &gps);
    size_t at = out->size, kept = 0;
    buf_u16(out, 0);
    struct entry add[2] = {exif_entry_num(TAG_EXIF_IFD, TYPE_LONG, exif),
                           exif_entry_num(TAG_GPS_IFD, TYPE_LONG, gps)};
    for (size_t i = 0, a = 0; i < n || a < 2;) {
        const uint8_t *old = t.p + ifd0 + 2 + 12 * i;
        unsigned tag = i < n ? exif_tiff_uint(&t, old, 2) : 0x10000;
        if (a < 2 && add[a].tag <= tag) {
            i += add[a].tag == tag; /* replaced */
            buf_u16(out, add[a].tag);
            buf_u16(out, add[a].type);
            buf_u32(out, 1);
            buf_add(out, add[a++].data, 4);
        } else {
            buf_add(out, old, 12);
            i++;
        }
        kept++;
    }
    buf_u32(out, 0);
    if (!out->failed) {
        out->data[at] = (uint8_t)kept;
        out->data[at + 1] = (uint8_t)(kept >> 8);
        exif_put_u32(out->data + 4, (uint32_t)at);
    }
    return true;
}

enum err_code exif_insert(struct buf *file, const struct image_gps *gps, struct err *e)
{
    struct buf blob = {0}, out = {0};
    bool known = true;
    exif_blob_write(&blob, gps);
    if (exif_is_jpeg(file->data, file->size))
        exif_insert_jpeg(file, &blob, &out);
    else if (exif_is_png(file->data, file->size))
        exif_insert_png(file, &blob, &out);
    else if (exif_is_webp(file->data, file->size))
        known = exif_insert_webp(file, &blob, &out);
    else
        known = exif_insert_tiff(file, gps, &out);
    out.failed = out.failed || blob.failed;
    buf_free(&blob);
    enum err_code rc = known ? buf_check(&out, e)
                             : err_set(e, ERR_FORMAT, "exif: not a JPEG, PNG, WebP or TIFF file");
    if (!rc) {
        buf_free(file);
        *file = out;
    } else {
        buf_free(&out);
    }
    return rc;
}
