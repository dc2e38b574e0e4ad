/* EXIF position, time and exposure of photographs, read from and put into JPEG, PNG, WebP and TIFF;
 * and where XMP packets are in them (xmp.c).
 *
 * EXIF is a small TIFF file inside the picture. OpenImageIO reads its rationals into float32, which
 * is a metre at the equator for cameras that write decimal degrees, and its writer stores no GPS in
 * PNG, WebP and TIFF (and 0.5" as infinity in JPEG). So the dozen fields that georeferencing needs
 * are handled here: all arithmetic in double, every offset checked against the bytes at hand.
 * Reading and writing stay in one file, because both walk the same containers.
 *
 * Sources: EXIF 2.32 (CIPA DC-008), TIFF 6.0, PNG 1.5 extensions (eXIf), RIFF container of WebP.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/exif.h"
#include "codec/image/exif_camera.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <zlib.h>

#include "codec/image/drone.h"
#include "codec/image/xmp.h"
#include "core/base.h"

enum {
    TAG_EXIF_IFD = 0x8769,
    TAG_GPS_IFD = 0x8825,
    TAG_EXPOSURE = 0x829a,
    TAG_ISO = 0x8827,
    TAG_DATE_ORIGINAL = 0x9003,
    TAG_FOCAL = 0x920a,
    TAG_FOCAL_35MM = 0xa405,
    TAG_XMP = 0x02bc,
    TAG_MAKE = 0x010f,
    TAG_MODEL = 0x0110,
    TAG_GPS_LAT_REF = 1,
    TAG_GPS_LAT = 2,
    TAG_GPS_LON_REF = 3,
    TAG_GPS_LON = 4,
    TAG_GPS_ALT_REF = 5,
    TAG_GPS_ALT = 6,
    TAG_GPS_STATUS = 9,
    TAG_GPS_DATUM = 0x12,
    TYPE_BYTE = 1,
    TYPE_ASCII = 2,
    TYPE_SHORT = 3,
    TYPE_LONG = 4,
    TYPE_RATIONAL = 5,
    TYPE_SBYTE = 6,
    TYPE_SSHORT = 8,
    TYPE_SLONG = 9,
    TYPE_SRATIONAL = 10,
    TYPE_FLOAT = 11,
    TYPE_DOUBLE = 12,
    TYPE_IFD = 13,           /* of Adobe's supplement to TIFF, as libtiff writes it */
    HEAD_BYTES = 256 * 1024, /* a segment is at most 64 KiB; those of interest come first */
    EXIF_PACKETS = 8,
    EXIF_INFLATED_MAX = 1 << 20,
    EXIF_WRAPPED = 100000 /* no angle, and no altitude in metres, is larger */
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
    static const uint8_t size[] = {0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8, 4};
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

static int32_t exif_signed(uint32_t v, size_t bytes)
{
    return bytes == 1 ? (int8_t)v : bytes == 2 ? (int16_t)v : (int32_t)v;
}

/* false: there is none, its denominator is 0, its numerator is all ones, which stands for unknown,
 * or it is not finite. Any type of numbers is taken: cameras write what the standard does not
 * allow. */
static bool exif_field_num(const struct tiff *t, const struct field *f, size_t i, double *out)
{
    const size_t bytes = exif_type_bytes(f->type);
    if (i >= f->count)
        return false;
    const uint8_t *p = f->data + i * bytes;
    uint32_t v = exif_tiff_uint(t, p, bytes < 4 ? (unsigned)bytes : 4), den;
    uint64_t wide;
    float single;
    switch (f->type) {
    case TYPE_BYTE:
    case TYPE_SHORT:
    case TYPE_LONG:
    case TYPE_IFD:
        *out = v;
        break;
    case TYPE_SBYTE:
    case TYPE_SSHORT:
    case TYPE_SLONG:
        *out = exif_signed(v, bytes);
        break;
    case TYPE_RATIONAL:
    case TYPE_SRATIONAL:
        den = exif_tiff_uint(t, p + 4, 4);
        if (!den || (f->type == TYPE_RATIONAL && v == UINT32_MAX))
            return false;
        *out = f->type == TYPE_RATIONAL ? (double)v / den : (double)(int32_t)v / (int32_t)den;
        if (*out > EXIF_WRAPPED && v > INT32_MAX) /* a negative number without its type */
            *out = (double)(int32_t)v / den;
        break;
    case TYPE_FLOAT:
        memcpy(&single, &v, sizeof single);
        *out = (double)single;
        break;
    case TYPE_DOUBLE:
        wide = exif_tiff_uint(t, p + 4, 4);
        wide = t->big_endian ? (uint64_t)v << 32 | wide : wide << 32 | v;
        memcpy(out, &wide, sizeof *out);
        break;
    default:
        return false;
    }
    return isfinite(*out);
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

/* The first letter of a text, in lower case; 0: none. */
static int exif_ifd_letter(const struct tiff *t, uint32_t ifd, unsigned tag)
{
    struct field f;
    if (exif_ifd_find(t, ifd, tag, &f))
        for (size_t i = 0; i < f.count * exif_type_bytes(f.type); i++)
            if (f.data[i] > ' ')
                return f.data[i] | 0x20;
    return 0;
}

/* Degrees, minutes and seconds. A fraction of one that the next repeats counts once. Minutes and
 * seconds that are missing or n/0 are 0; more than 60 are no angle. South and west are what either
 * the letter or a sign says. odd_sign: the letter says the other hemisphere. no_letter: none says
 * it. */
static bool exif_ifd_angle(const struct tiff *t, uint32_t ifd, unsigned tag, const char letters[2],
                           double *out, struct image_gps *g)
{
    struct field f;
    double part[3] = {0};
    if (!exif_ifd_find(t, ifd, tag, &f) || !exif_field_num(t, &f, 0, &part[0]))
        return false;
    for (size_t i = 1; i < 3; i++)
        if (!exif_field_num(t, &f, i, &part[i]))
            part[i] = 0;
    const bool minus = part[0] < 0 || part[1] < 0 || part[2] < 0;
    for (size_t i = 0; i < 3; i++)
        part[i] = fabs(part[i]);
    if (fabs((part[0] - floor(part[0])) * 60 - part[1]) < 1 && part[0] > floor(part[0]))
        part[1] = part[2] = 0;
    if (fabs((part[1] - floor(part[1])) * 60 - part[2]) < 1 && part[1] > floor(part[1]))
        part[2] = 0;
    const int letter = exif_ifd_letter(t, ifd, tag - 1);
    *out = part[0] + part[1] / 60 + part[2] / 3600;
    g->odd_sign |= minus && letter && letter != letters[1];
    g->no_letter |= !minus && letter != letters[0] && letter != letters[1];
    if (minus || letter == letters[1])
        *out = -*out;
    return part[1] <= 60 && part[2] <= 60;
}

/* Longitudes may count to 360. 0, 0 is what cameras write without a fix. */
static void exif_position(const struct tiff *t, uint32_t gps, struct image_gps *out)
{
    double lat, lon;
    if (!exif_ifd_angle(t, gps, TAG_GPS_LAT, "ns", &lat, out) ||
        !exif_ifd_angle(t, gps, TAG_GPS_LON, "ew", &lon, out))
        return;
    lon = fabs(lon) > 180 && fabs(lon) <= 360 ? remainder(lon, 360) : lon;
    if (fabs(lat) > 90 || fabs(lon) > 180 || (lat == 0 && lon == 0))
        return;
    out->has_position = true;
    out->lat_deg = lat;
    out->lon_deg = lon;
}

/* Is GPSMapDatum one of those that lie tens of metres and more from WGS 84? */
static bool exif_far_datum(const struct tiff *t, uint32_t gps)
{
    static const char *const far[] = {"tokyo", "nad27",    "nad 27", "nad-27",  "ed50",
                                      "ed 50", "european", "osgb",   "pulkovo", "agd"};
    struct field f;
    char low[32] = "";
    if (!exif_ifd_find(t, gps, TAG_GPS_DATUM, &f) || f.type != TYPE_ASCII)
        return false;
    for (size_t i = 0; i < f.count && f.data[i] && i + 1 < sizeof low; i++)
        low[i] = (char)(f.data[i] >= 'A' && f.data[i] <= 'Z' ? f.data[i] | 0x20 : f.data[i]);
    for (size_t k = 0; k < sizeof far / sizeof *far; k++)
        if (strstr(low, far[k]))
            return true;
    return false;
}

/* EXIF 3.0: 0 above, 1 below the sea; 2 above, 3 below the ellipsoid. Some write the digit. */
static void exif_altitude(const struct tiff *t, uint32_t gps, struct image_gps *out)
{
    struct field f;
    double ref = 0;
    if (!exif_ifd_find(t, gps, TAG_GPS_ALT, &f) || !exif_field_num(t, &f, 0, &out->alt_m))
        return;
    out->has_altitude = true;
    if (!exif_ifd_find(t, gps, TAG_GPS_ALT_REF, &f))
        return;
    if (!exif_field_num(t, &f, 0, &ref))
        ref = f.data[0];
    ref = ref >= '0' && ref <= '3' ? ref - '0' : ref;
    out->ellipsoidal = ref == 2 || ref == 3;
    if (ref == 1 || ref == 3)
        out->alt_m = -fabs(out->alt_m);
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
    exif_position(&t, gps, out);
    exif_altitude(&t, gps, out);
    out->interrupted = exif_ifd_letter(&t, gps, TAG_GPS_STATUS) == 'v';
    out->far_datum = exif_far_datum(&t, gps);
}

/* ---- where EXIF and XMP are in a file ---- */

struct exif_bytes {
    const uint8_t *p; /* NULL: there are none */
    size_t n;
};
struct exif_parts { /* {0}, then exif_find; exif_parts_free it */
    struct exif_bytes exif, packet[EXIF_PACKETS];
    size_t n_packets;
    /* What the file does not have in one piece: put together, inflated, or in digits. */
    struct buf extended, inflated, profile;
    bool cut; /* the bytes end before all of them could come */
};

static void exif_parts_free(struct exif_parts *x)
{
    buf_free(&x->extended);
    buf_free(&x->inflated);
    buf_free(&x->profile);
}

static void exif_packet(struct exif_parts *x, const uint8_t *p, size_t n)
{
    if (n && x->n_packets < EXIF_PACKETS)
        x->packet[x->n_packets++] = (struct exif_bytes){p, n};
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

/* A part of a packet that is too long for a segment: length of all, place, bytes (XMP part 3,
 * 1.1.3.1). */
static void exif_extended(struct exif_parts *x, const uint8_t *p, size_t n)
{
    const size_t all = exif_be32(p), at = exif_be32(p + 4);
    if (!x->extended.size && all <= XMP_BYTES_MAX) {
        uint8_t *room = buf_grow(&x->extended, all);
        if (room)
            memset(room, ' ', all);
    }
    if (all == x->extended.size && !x->extended.failed && at <= all && n - 8 <= all - at)
        memcpy(x->extended.data + at, p + 8, n - 8);
}

static void exif_segment(struct exif_parts *x, const uint8_t *p, size_t n)
{
    static const char packet[] = "http://ns.adobe.com/xap/1.0/",
                      extended[] = "http://ns.adobe.com/xmp/extension/";
    const size_t head = sizeof extended + 32; /* and a digest */
    if (n >= 6 && !memcmp(p, "Exif\0\0", 6) && !x->exif.p)
        x->exif = (struct exif_bytes){p + 6, n - 6};
    else if (n > sizeof packet && !memcmp(p, packet, sizeof packet))
        exif_packet(x, p + sizeof packet, n - sizeof packet);
    else if (n >= head + 8 && !memcmp(p, extended, sizeof extended))
        exif_extended(x, p + head, n - head);
}

static void exif_find_jpeg(const uint8_t *p, size_t n, struct exif_parts *x)
{
    size_t at = 2;
    while (at + 4 <= n && p[at] == 0xff && p[at + 1] != 0xda) {
        const size_t len = (size_t)p[at + 2] << 8 | p[at + 3];
        if (p[at + 1] == 0xff) { /* markers may be padded */
            at++;
            continue;
        }
        if (len < 2 || len > n - at - 2) {
            x->cut = len >= 2;
            return;
        }
        if (p[at + 1] == 0xe1)
            exif_segment(x, p + at + 4, len - 2);
        at += 2 + len;
    }
    x->cut = at + 4 > n;
}

static bool exif_inflate(const uint8_t *p, size_t n, struct buf *out)
{
    uLongf got = EXIF_INFLATED_MAX;
    uint8_t *room = out->size ? NULL : buf_grow(out, EXIF_INFLATED_MAX);
    if (!room || uncompress(room, &got, p, (uLong)n) != Z_OK)
        return false;
    out->size = got;
    return true;
}

/* A text chunk: keyword, whether it is compressed, how, two texts, and the packet. */
static void exif_chunk_packet(struct exif_parts *x, const uint8_t *p, size_t n)
{
    static const char key[] = "XML:com.adobe.xmp";
    const uint8_t *end = p + n, *at = p + sizeof key + 2;
    if (n < sizeof key + 4 || memcmp(p, key, sizeof key) != 0)
        return;
    for (int texts = 0; texts < 2 && at; texts++) {
        at = memchr(at, 0, (size_t)(end - at));
        at = at ? at + 1 : NULL;
    }
    if (!at || !p[sizeof key])
        exif_packet(x, at, at ? (size_t)(end - at) : 0);
    else if (exif_inflate(at, (size_t)(end - at), &x->inflated))
        exif_packet(x, x->inflated.data, x->inflated.size);
}

static int exif_digit(uint8_t c)
{
    return c >= '0' && c <= '9'                     ? c - '0'
           : (c | 0x20) >= 'a' && (c | 0x20) <= 'f' ? (c | 0x20) - 'a' + 10
                                                    : -1;
}

/* How Exiv2 and ImageMagick wrote EXIF before PNG had eXIf: keyword, how it is compressed, then
 * "\nexif\n  LENGTH\n" and a segment of a JPEG as digits of 16. */
static void exif_chunk_profile(struct exif_parts *x, const uint8_t *p, size_t n, bool packed)
{
    static const char *const keys[] = {"Raw profile type exif", "Raw profile type APP1"};
    struct buf text = {0};
    const size_t head = strlen(keys[0]) + 1 + packed; /* both are as long */
    if (n < head || x->profile.size ||
        (memcmp(p, keys[0], head - packed) && memcmp(p, keys[1], head - packed)))
        return;
    const uint8_t *at = p + head, *end = p + n;
    if (packed && exif_inflate(at, n - head, &text)) {
        at = text.data;
        end = at + text.size;
    }
    for (int line = 0; line < 3 && at < end; line++)
        while (at < end && *at++ != '\n')
            ;
    for (int high = -1; at < end; at++) {
        const int digit = exif_digit(*at);
        if (digit >= 0 && high >= 0)
            buf_u8(&x->profile, (unsigned)(high << 4 | digit));
        if (digit >= 0)
            high = high < 0 ? digit : -1;
    }
    buf_free(&text);
    if (!x->profile.failed)
        exif_segment(x, x->profile.data, x->profile.size);
}

static void exif_find_png(const uint8_t *p, size_t n, struct exif_parts *x)
{
    for (size_t at = 8; n - at >= 12;) {
        const size_t len = exif_be32(p + at);
        if (len > n - at - 12)
            break;
        if (!memcmp(p + at + 4, "eXIf", 4) && !x->exif.p)
            x->exif = (struct exif_bytes){p + at + 8, len};
        if (!memcmp(p + at + 4, "iTXt", 4))
            exif_chunk_packet(x, p + at + 8, len);
        if (!memcmp(p + at + 4, "zTXt", 4) || !memcmp(p + at + 4, "tEXt", 4))
            exif_chunk_profile(x, p + at + 8, len, p[at + 4] == 'z');
        at += 12 + len;
    }
    x->cut = true; /* they may stand behind the picture */
}

static void exif_find_webp(const uint8_t *p, size_t n, struct exif_parts *x)
{
    for (size_t at = 12; at <= n && n - at >= 8;) {
        const size_t len = exif_le32(p + at + 4);
        if (len > n - at - 8)
            break;
        if (!memcmp(p + at, "EXIF", 4) && !x->exif.p) {
            size_t skip = len >= 6 && !memcmp(p + at + 8, "Exif\0\0", 6) ? 6 : 0;
            x->exif = (struct exif_bytes){p + at + 8 + skip, len - skip};
        }
        if (!memcmp(p + at, "XMP ", 4))
            exif_packet(x, p + at + 8, len);
        at += 8 + len + (len & 1);
    }
    x->cut = true;
}

static void exif_find(const uint8_t *p, size_t n, struct exif_parts *x)
{
    struct tiff t;
    struct field f;
    uint32_t ifd0;
    if (exif_is_jpeg(p, n))
        exif_find_jpeg(p, n, x);
    else if (exif_is_png(p, n))
        exif_find_png(p, n, x);
    else if (exif_is_webp(p, n))
        exif_find_webp(p, n, x);
    else {
        x->exif = (struct exif_bytes){p, n};
        x->cut = true;
    }
    if (x->exif.p && exif_tiff_open(x->exif.p, x->exif.n, &t, &ifd0)) {
        if (exif_ifd_find(&t, ifd0, TAG_XMP, &f))
            exif_packet(x, f.data, f.count * exif_type_bytes(f.type));
        if (exif_ifd_find(&t, exif_ifd_offset(&t, ifd0, TAG_EXIF_IFD), TAG_XMP, &f)) /* DJI's */
            exif_packet(x, f.data, f.count * exif_type_bytes(f.type));
    }
    exif_packet(x, x->extended.data, x->extended.failed ? 0 : x->extended.size);
}

void exif_parse(const void *bytes, size_t n, struct image_gps *out, struct xmp *xmp)
{
    struct exif_parts x = {0};
    *out = (struct image_gps){0};
    exif_find(bytes, n, &x);
    if (x.exif.p)
        exif_blob(x.exif.p, x.exif.n, out);
    for (size_t i = 0; xmp && i < x.n_packets; i++)
        xmp_add(xmp, x.packet[i].p, x.packet[i].n);
    exif_parts_free(&x);
}

/* The bytes that have EXIF and XMP in them: the head of a JPEG, or all. */
static enum err_code exif_file(const char *path, struct buf *out, struct err *e)
{
    struct exif_parts x = {0};
    FILE *f = fopen(path, "rb");
    if (!f)
        return err_errno(e, file_exists(path) ? ERR_IO : ERR_NOENT, "exif: %s", path);
    uint8_t *head = buf_grow(out, HEAD_BYTES);
    const size_t n = head ? fread(head, 1, HEAD_BYTES, f) : 0;
    fclose(f);
    if (!head)
        return err_set(e, ERR_MEM, "exif: %s: out of memory", path);
    out->size = n;
    exif_find(head, n, &x);
    const bool more = x.cut && n == HEAD_BYTES;
    exif_parts_free(&x);
    if (!more)
        return ERR_OK;
    buf_free(out);
    return file_read(path, 0, out, e);
}

static char exif_in_case(char c, int form)
{
    const bool lower = c >= 'a' && c <= 'z', upper = c >= 'A' && c <= 'Z';
    return (char)((form == 1 && upper) || (form == 2 && lower) ? c ^ 0x20 : c);
}

/* photo.xmp and photo.JPG.xmp beside photo.JPG: the name as it is, in small letters or in capitals.
 */
static void exif_sidecars(const char *path, struct xmp *xmp)
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
            name[i] = exif_in_case(name[i], form);
        if ((!form || memcmp(name + base, path + base, (size_t)stem - base) != 0) &&
            file_exists(name) && !file_read(name, XMP_BYTES_MAX, &b, NULL))
            xmp_add(xmp, b.data, b.size);
        buf_free(&b);
    }
}

enum err_code exif_read(const char *path, struct image_gps *gps, struct drone_meta *drone,
                        struct err *e)
{
    struct buf b = {0};
    struct xmp *xmp = mem_array(1, sizeof *xmp);
    *gps = (struct image_gps){0};
    *drone = (struct drone_meta){0};
    enum err_code rc =
        xmp ? exif_file(path, &b, e) : err_set(e, ERR_MEM, "exif: %s: out of memory", path);
    if (!rc) {
        exif_parse(b.data, b.size, gps, xmp);
        exif_sidecars(path, xmp);
        drone_read(xmp_get, xmp, drone);
    }
    mem_free(xmp);
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
    struct exif_parts x = {0};
    *out = (struct exif_camera){0};
    enum err_code rc = exif_file(path, &b, e);
    if (!rc)
        exif_find(b.data, b.size, &x);
    if (x.exif.p)
        exif_camera_blob(x.exif.p, x.exif.n, out);
    exif_parts_free(&x);
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
