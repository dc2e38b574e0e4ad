/* Puts EXIF into encoded pictures: exif_insert of exif.h.
 *
 * Sources: EXIF 2.32 (CIPA DC-008), TIFF 6.0, PNG 1.5 extensions (eXIf), RIFF container of WebP.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/exif.h"

#include <math.h>
#include <stdint.h>
#include <string.h>
#include <zlib.h>

#include "codec/image/exif_parts.h"
#include "codec/image/exif_tags.h"
#include "codec/image/tiff.h"
#include "core/base.h"

static struct tiff_entry exif_entry_angle(unsigned tag, double deg)
{
    struct tiff_entry en = {.tag = (uint16_t)tag, .type = TIFF_RATIONAL};
    double units = round(fabs(deg) * 3600 * 1e7); /* 1e-7 arc seconds; carried before splitting */
    double minutes = floor(units / 6e8);
    tiff_entry_ratio(&en, floor(minutes / 60), 1);
    tiff_entry_ratio(&en, fmod(minutes, 60), 1);
    tiff_entry_ratio(&en, (units - minutes * 6e8) / 1e7, 1e7);
    return en;
}

/* Appends the Exif and GPS IFDs to b, whose offsets count from b's start + `shift`; returns where
 * each is. */
static void exif_sub_ifds_write(struct buf *b, uint32_t shift, const struct image_gps *g,
                                uint32_t *exif, uint32_t *gps)
{
    struct tiff_entry en[8];
    size_t n = 0;
    if (g->exposure_s > 0)
        en[n++] = g->exposure_s < 1 ? tiff_entry_rational(EXIF_TAG_EXPOSURE, g->exposure_s, 1e9)
                                    : tiff_entry_rational(EXIF_TAG_EXPOSURE, g->exposure_s, 1e6);
    if (g->iso > 0)
        en[n++] = tiff_entry_num(EXIF_TAG_ISO, TIFF_SHORT,
                                 g->iso < 65535 ? (uint32_t)lround(g->iso) : 65535);
    if (g->time[0])
        en[n++] = tiff_entry_text(EXIF_TAG_DATE_ORIGINAL, g->time);
    if (g->focal_mm > 0)
        en[n++] = tiff_entry_rational(EXIF_TAG_FOCAL, g->focal_mm, 1e5);
    *exif = (uint32_t)b->size + shift;
    tiff_write(b, *exif, en, n);

    n = 0;
    en[n++] = tiff_entry_num(EXIF_GPS_VERSION, TIFF_BYTE, 0x00000302); /* 2.3.0.0 */
    en[0].count = en[0].size = 4;
    if (g->has_position) {
        en[n++] = tiff_entry_text(EXIF_GPS_LAT_REF, g->lat_deg < 0 ? "S" : "N");
        en[n++] = exif_entry_angle(EXIF_GPS_LAT, g->lat_deg);
        en[n++] = tiff_entry_text(EXIF_GPS_LON_REF, g->lon_deg < 0 ? "W" : "E");
        en[n++] = exif_entry_angle(EXIF_GPS_LON, g->lon_deg);
    }
    if (g->has_altitude) {
        en[n++] = tiff_entry_num(EXIF_GPS_ALT_REF, TIFF_BYTE, g->alt_m < 0);
        en[n++] = tiff_entry_rational(EXIF_GPS_ALT, fabs(g->alt_m), 1e4);
    }
    *gps = (uint32_t)b->size + shift;
    tiff_write(b, *gps, en, n);
}

static void exif_blob_write(struct buf *b, const struct image_gps *g)
{
    enum { IFD0 = 8, IFD0_BYTES = 2 + 2 * 12 + 4 };
    struct buf sub = {0};
    uint32_t exif = 0, gps = 0;
    exif_sub_ifds_write(&sub, IFD0 + IFD0_BYTES, g, &exif, &gps);
    buf_add(b, "II*\0", 4);
    buf_u32(b, IFD0);
    struct tiff_entry en[2] = {tiff_entry_num(EXIF_TAG_IFD, TIFF_LONG, exif),
                               tiff_entry_num(EXIF_TAG_GPS_IFD, TIFF_LONG, gps)};
    tiff_write(b, IFD0, en, 2);
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

static void exif_add_be32(struct buf *out, uint32_t v)
{
    for (int shift = 24; shift >= 0; shift -= 8)
        buf_u8(out, v >> shift & 255);
}

static void exif_insert_png(const struct buf *file, const struct buf *blob, struct buf *out)
{
    enum { AFTER_IHDR = 33 };
    buf_add(out, file->data, AFTER_IHDR);
    exif_add_be32(out, (uint32_t)blob->size);
    const size_t start = out->size;
    buf_add(out, "eXIf", 4);
    buf_add(out, blob->data, blob->size);
    if (!out->failed)
        exif_add_be32(out, (uint32_t)crc32(0, out->data + start, (uInt)(out->size - start)));
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
        uint32_t bits = p[9] | (uint32_t)p[10] << 8 | (uint32_t)p[11] << 16 | (uint32_t)p[12] << 24;
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
        tiff_put_u32(out->data + 4, (uint32_t)out->size - 8);
    return true;
}

/* A new first IFD at the end of the file: the old entries and the two pointers, sorted by tag. */
static bool exif_insert_tiff(const struct buf *file, const struct image_gps *g, struct buf *out)
{
    struct tiff t;
    uint32_t ifd0, exif, gps;
    if (!tiff_open(file->data, file->size, &t, &ifd0) || t.big_endian || ifd0 > t.n ||
        t.n - ifd0 < 2 || t.n > UINT32_MAX / 2)
        return false;
    size_t n = tiff_uint(&t, t.p + ifd0, 2);
    if (t.n - ifd0 - 2 < 12 * n)
        return false;
    buf_add(out, file->data, file->size);
    if (out->size & 1)
        buf_u8(out, 0);
    exif_sub_ifds_write(out, 0, g, &exif, &gps);
    size_t at = out->size, kept = 0;
    buf_u16(out, 0);
    struct tiff_entry add[2] = {tiff_entry_num(EXIF_TAG_IFD, TIFF_LONG, exif),
                                tiff_entry_num(EXIF_TAG_GPS_IFD, TIFF_LONG, gps)};
    for (size_t i = 0, a = 0; i < n || a < 2;) {
        const uint8_t *old = t.p + ifd0 + 2 + 12 * i;
        unsigned tag = i < n ? tiff_uint(&t, old, 2) : 0x10000;
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
        tiff_put_u32(out->data + 4, (uint32_t)at);
    }
    return true;
}

enum err_code exif_insert(struct buf *file, const struct image_gps *gps, struct err *e)
{
    struct buf blob = {0}, out = {0};
    bool known = true;
    exif_blob_write(&blob, gps);
    switch (exif_parts_container(file->data, file->size)) {
    case EXIF_JPEG:
        exif_insert_jpeg(file, &blob, &out);
        break;
    case EXIF_PNG:
        exif_insert_png(file, &blob, &out);
        break;
    case EXIF_WEBP:
        known = exif_insert_webp(file, &blob, &out);
        break;
    case EXIF_TIFF:
        known = exif_insert_tiff(file, gps, &out);
        break;
    }
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
