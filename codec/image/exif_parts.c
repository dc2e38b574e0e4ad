/* EXIF and XMP in the files of pictures: see exif_parts.h.
 *
 * Sources: EXIF 2.32 (CIPA DC-008), PNG 1.5 extensions (eXIf), RIFF container of WebP, XMP part 3.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/exif_parts.h"

#include <stdio.h>
#include <string.h>
#include <zlib.h>

#include "codec/image/exif_tags.h"
#include "codec/image/tiff.h"
#include "codec/image/xmp.h"

enum {
    EXIF_HEAD_BYTES = 256 * 1024, /* a segment is at most 64 KiB; those of interest come first */
    EXIF_INFLATED_MAX = 1 << 20
};

void exif_parts_free(struct exif_parts *x)
{
    buf_free(&x->file);
    buf_free(&x->extended);
    buf_free(&x->inflated);
    buf_free(&x->profile);
    *x = (struct exif_parts){0};
}

static void exif_parts_packet(struct exif_parts *x, const uint8_t *p, size_t n)
{
    if (n && x->n_packets < EXIF_PACKETS)
        x->packet[x->n_packets++] = (struct exif_bytes){p, n};
}

static uint32_t exif_parts_be32(const uint8_t *p)
{
    return (uint32_t)p[0] << 24 | (uint32_t)p[1] << 16 | (uint32_t)p[2] << 8 | p[3];
}

static uint32_t exif_parts_le32(const uint8_t *p)
{
    return (uint32_t)p[3] << 24 | (uint32_t)p[2] << 16 | (uint32_t)p[1] << 8 | p[0];
}

enum exif_container exif_parts_container(const uint8_t *p, size_t n)
{
    if (n >= 4 && p[0] == 0xff && p[1] == 0xd8)
        return EXIF_JPEG;
    if (n >= 33 && !memcmp(p, "\x89PNG\r\n\x1a\n", 8))
        return EXIF_PNG;
    if (n >= 20 && !memcmp(p, "RIFF", 4) && !memcmp(p + 8, "WEBP", 4))
        return EXIF_WEBP;
    return EXIF_TIFF;
}

/* A part of a packet that is too long for a segment: length of all, place, bytes (XMP part 3,
 * 1.1.3.1). */
static void exif_parts_extended(struct exif_parts *x, const uint8_t *p, size_t n)
{
    const size_t all = exif_parts_be32(p), at = exif_parts_be32(p + 4);
    if (!x->extended.size && all <= XMP_BYTES_MAX) {
        uint8_t *room = buf_grow(&x->extended, all);
        if (room)
            memset(room, ' ', all);
    }
    if (all == x->extended.size && !x->extended.failed && at <= all && n - 8 <= all - at)
        memcpy(x->extended.data + at, p + 8, n - 8);
}

static void exif_parts_segment(struct exif_parts *x, const uint8_t *p, size_t n)
{
    static const char packet[] = "http://ns.adobe.com/xap/1.0/",
                      extended[] = "http://ns.adobe.com/xmp/extension/";
    const size_t head = sizeof extended + 32; /* and a digest */
    if (n >= 6 && !memcmp(p, "Exif\0\0", 6) && !x->exif.p)
        x->exif = (struct exif_bytes){p + 6, n - 6};
    else if (n > sizeof packet && !memcmp(p, packet, sizeof packet))
        exif_parts_packet(x, p + sizeof packet, n - sizeof packet);
    else if (n >= head + 8 && !memcmp(p, extended, sizeof extended))
        exif_parts_extended(x, p + head, n - head);
}

static void exif_parts_jpeg(const uint8_t *p, size_t n, struct exif_parts *x)
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
            exif_parts_segment(x, p + at + 4, len - 2);
        at += 2 + len;
    }
    x->cut = at + 4 > n;
}

static bool exif_parts_inflate(const uint8_t *p, size_t n, struct buf *out)
{
    uLongf got = EXIF_INFLATED_MAX;
    uint8_t *room = out->size ? NULL : buf_grow(out, EXIF_INFLATED_MAX);
    if (!room || uncompress(room, &got, p, (uLong)n) != Z_OK)
        return false;
    out->size = got;
    return true;
}

/* A text chunk: keyword, whether it is compressed, how, two texts, and the packet. */
static void exif_parts_chunk(struct exif_parts *x, const uint8_t *p, size_t n)
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
        exif_parts_packet(x, at, at ? (size_t)(end - at) : 0);
    else if (exif_parts_inflate(at, (size_t)(end - at), &x->inflated))
        exif_parts_packet(x, x->inflated.data, x->inflated.size);
}

static int exif_parts_digit(uint8_t c)
{
    return c >= '0' && c <= '9'                     ? c - '0'
           : (c | 0x20) >= 'a' && (c | 0x20) <= 'f' ? (c | 0x20) - 'a' + 10
                                                    : -1;
}

/* How Exiv2 and ImageMagick wrote EXIF before PNG had eXIf: keyword, how it is compressed, then
 * "\nexif\n  LENGTH\n" and a segment of a JPEG as digits of 16. */
static void exif_parts_profile(struct exif_parts *x, const uint8_t *p, size_t n, bool packed)
{
    static const char *const keys[] = {"Raw profile type exif", "Raw profile type APP1"};
    struct buf text = {0};
    const size_t head = strlen(keys[0]) + 1 + packed; /* both are as long */
    if (n < head || x->profile.size ||
        (memcmp(p, keys[0], head - packed) != 0 && memcmp(p, keys[1], head - packed) != 0))
        return;
    const uint8_t *at = p + head, *end = p + n;
    if (packed) {
        const bool whole = exif_parts_inflate(at, n - head, &text);
        at = text.data;
        end = whole ? at + text.size : at;
    }
    for (int line = 0; line < 3 && at < end; line++)
        while (at < end && *at++ != '\n')
            ;
    for (int high = -1; at < end; at++) {
        const int digit = exif_parts_digit(*at);
        if (digit >= 0 && high >= 0)
            buf_u8(&x->profile, (unsigned)(high << 4 | digit));
        if (digit >= 0)
            high = high < 0 ? digit : -1;
    }
    buf_free(&text);
    if (!x->profile.failed)
        exif_parts_segment(x, x->profile.data, x->profile.size);
}

static void exif_parts_png(const uint8_t *p, size_t n, struct exif_parts *x)
{
    for (size_t at = 8; n - at >= 12;) {
        const size_t len = exif_parts_be32(p + at);
        if (len > n - at - 12)
            break;
        if (!memcmp(p + at + 4, "eXIf", 4) && (!x->exif.p || x->profile.size))
            x->exif = (struct exif_bytes){p + at + 8, len};
        if (!memcmp(p + at + 4, "iTXt", 4))
            exif_parts_chunk(x, p + at + 8, len);
        if (!memcmp(p + at + 4, "zTXt", 4) || !memcmp(p + at + 4, "tEXt", 4))
            exif_parts_profile(x, p + at + 8, len, p[at + 4] == 'z');
        at += 12 + len;
    }
    x->cut = true; /* they may stand behind the picture */
}

static void exif_parts_webp(const uint8_t *p, size_t n, struct exif_parts *x)
{
    for (size_t at = 12; at <= n && n - at >= 8;) {
        const size_t len = exif_parts_le32(p + at + 4);
        if (len > n - at - 8)
            break;
        if (!memcmp(p + at, "EXIF", 4) && !x->exif.p) {
            size_t skip = len >= 6 && !memcmp(p + at + 8, "Exif\0\0", 6) ? 6 : 0;
            x->exif = (struct exif_bytes){p + at + 8 + skip, len - skip};
        }
        if (!memcmp(p + at, "XMP ", 4))
            exif_parts_packet(x, p + at + 8, len);
        at += 8 + len + (len & 1);
    }
    x->cut = true;
}

void exif_parts_find(const uint8_t *p, size_t n, struct exif_parts *x)
{
    struct tiff t;
    struct tiff_field f;
    uint32_t ifd0;
    switch (exif_parts_container(p, n)) {
    case EXIF_JPEG:
        exif_parts_jpeg(p, n, x);
        break;
    case EXIF_PNG:
        exif_parts_png(p, n, x);
        break;
    case EXIF_WEBP:
        exif_parts_webp(p, n, x);
        break;
    case EXIF_TIFF:
        x->exif = (struct exif_bytes){p, n};
        x->cut = true;
        break;
    }
    if (x->exif.p && tiff_open(x->exif.p, x->exif.n, &t, &ifd0)) {
        if (tiff_find(&t, ifd0, EXIF_TAG_XMP, &f))
            exif_parts_packet(x, f.data, f.n);
        if (tiff_find(&t, tiff_offset(&t, ifd0, EXIF_TAG_IFD), EXIF_TAG_XMP, &f)) /* DJI's */
            exif_parts_packet(x, f.data, f.n);
    }
    exif_parts_packet(x, x->extended.data, x->extended.failed ? 0 : x->extended.size);
}

enum err_code exif_parts_read(const char *path, struct exif_parts *x, struct err *e)
{
    FILE *f = fopen(path, "rb");
    if (!f)
        return err_errno(e, file_exists(path) ? ERR_IO : ERR_NOENT, "exif: %s", path);
    uint8_t *head = buf_grow(&x->file, EXIF_HEAD_BYTES);
    const size_t n = head ? fread(head, 1, EXIF_HEAD_BYTES, f) : 0;
    fclose(f);
    if (!head)
        return err_set(e, ERR_MEM, "exif: %s: out of memory", path);
    exif_parts_find(head, n, x);
    if (!x->cut || n < EXIF_HEAD_BYTES)
        return ERR_OK;
    exif_parts_free(x);
    enum err_code rc = file_read(path, 0, &x->file, e);
    if (!rc)
        exif_parts_find(x->file.data, x->file.size, x);
    return rc;
}
