/* What a .drc of ours holds, and a check of foreign bytes before libdraco sees them.
 *
 * libdraco allocates what a file announces: a few bytes can ask for gigabytes. So the start of the
 * stream is read here first: header, metadata (skipped), point count, attribute list. Anything but
 * our own layout in sequential encoding is refused, and so are a count out of proportion to the
 * file and a wrong check value. Source: Draco bitstream 2.3 as libdraco 1.5.5 writes it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/draco_layout.h"

#include <string.h>
#include <zlib.h>

#include "codec/limits.h"
#include "core/base.h"
#include "core/splat/gauss.h"

enum {
    FLAG_METADATA = 0x8000,
    POINT_CLOUD = 0,
    SEQUENTIAL = 0,
    ATTRIBUTE_POSITION = 0,
    ATTRIBUTE_GENERIC = 4,
    METADATA_DEPTH_MAX = 4,
    POINTS_PER_BYTE_MAX = 1024, /* real tiles: 0.1 */
};

size_t draco_layout(uint32_t sh_degree, uint32_t embed_len,
                    struct draco_attribute out[DRACO_ID_COUNT])
{
    const struct draco_attribute all[DRACO_ID_COUNT] = {
        {DRACO_POSITION, "position", DRACO_UINT32, 3},
        {DRACO_OPACITY, "opacity", DRACO_UINT8, 1},
        {DRACO_SCALE, "scale", DRACO_UINT8, 3},
        {DRACO_ROTATION, "rotation", DRACO_UINT16, 3},
        {DRACO_ROTATION_INDEX, "rotation_index", DRACO_UINT8, 1},
        {DRACO_COLOR_G, "color_g", DRACO_UINT8, 1},
        {DRACO_COLOR_RB, "color_rb", DRACO_UINT8, 2},
        {DRACO_SH1_G, "sh1_g", DRACO_UINT8, sh_degree >= 1 ? 3 : 0},
        {DRACO_SH1_RB, "sh1_rb", DRACO_UINT8, sh_degree >= 1 ? 6 : 0},
        {DRACO_SH2_G, "sh2_g", DRACO_UINT8, sh_degree >= 2 ? 5 : 0},
        {DRACO_SH2_RB, "sh2_rb", DRACO_UINT8, sh_degree >= 2 ? 10 : 0},
        {DRACO_SH3_G, "sh3_g", DRACO_UINT8, sh_degree >= 3 ? 7 : 0},
        {DRACO_SH3_RB, "sh3_rb", DRACO_UINT8, sh_degree >= 3 ? 14 : 0},
        {DRACO_EMBEDDING, "embedding", DRACO_UINT8, embed_len},
    };
    size_t n = 0;
    for (size_t i = 0; i < DRACO_ID_COUNT; i++)
        if (all[i].components)
            out[n++] = all[i];
    return n;
}

uint32_t draco_crc(const void *bytes, size_t n)
{
    return (uint32_t)crc32_z(0, bytes, n);
}

static uint32_t layout_varint(struct cursor *c)
{
    uint32_t v = 0;
    for (int shift = 0; shift < 35; shift += 7) {
        uint32_t b = cursor_u8(c);
        v |= (b & 127) << shift;
        if (b < 128)
            return v;
    }
    c->bad = true;
    return 0;
}

static void layout_metadata_skip(struct cursor *c, int depth)
{
    if (depth > METADATA_DEPTH_MAX) {
        c->bad = true;
        return;
    }
    for (uint32_t n = layout_varint(c); n && !c->bad; n--) {
        cursor_take(c, cursor_u8(c));
        cursor_take(c, layout_varint(c));
    }
    for (uint32_t n = layout_varint(c); n && !c->bad; n--) {
        cursor_take(c, cursor_u8(c));
        layout_metadata_skip(c, depth + 1);
    }
}

/* Attribute list against the layout it must be: what is there tells degree and embedding. */
static bool layout_attributes_match(struct cursor *c, struct draco_head *h)
{
    struct draco_attribute want[DRACO_ID_COUNT];
    uint8_t components[DRACO_ID_COUNT] = {0}, type[DRACO_ID_COUNT] = {0};
    if (cursor_u8(c) != 1) /* attribute decoders */
        return false;
    uint32_t count = layout_varint(c);
    if (count > DRACO_ID_COUNT)
        return false;
    for (uint32_t i = 0; i < count; i++) {
        uint8_t kind = cursor_u8(c), t = cursor_u8(c), n = cursor_u8(c), normalized = cursor_u8(c);
        uint32_t id = layout_varint(c);
        if (c->bad || id >= DRACO_ID_COUNT || components[id] || normalized || !n ||
            kind != (id == DRACO_POSITION ? ATTRIBUTE_POSITION : ATTRIBUTE_GENERIC))
            return false;
        components[id] = n;
        type[id] = t;
    }
    h->sh_degree = components[DRACO_SH3_G]   ? 3
                   : components[DRACO_SH2_G] ? 2
                   : components[DRACO_SH1_G] ? 1
                                             : 0;
    h->embed_len = components[DRACO_EMBEDDING];
    if (h->embed_len > GAUSS_EMBED_MAX || draco_layout(h->sh_degree, h->embed_len, want) != count)
        return false;
    for (uint32_t i = 0; i < count; i++)
        if (components[want[i].id] != want[i].components || type[want[i].id] != want[i].type)
            return false;
    return true;
}

enum err_code draco_check(const void *bytes, size_t n, const struct codec_limits *lim,
                          struct draco_head *out, struct err *e)
{
    struct cursor c = cursor_over(bytes, n);
    const uint8_t *magic = cursor_take(&c, 5);
    unsigned major = cursor_u8(&c), minor = cursor_u8(&c);
    unsigned type = cursor_u8(&c), method = cursor_u8(&c), flags = cursor_u16(&c);
    *out = (struct draco_head){0};
    if (c.bad || memcmp(magic, "DRACO", 5))
        return err_set(e, ERR_FORMAT, "draco: not a Draco file, or truncated in its header");
    if (major != 2 || type != POINT_CLOUD || method != SEQUENTIAL)
        return err_set(
            e, ERR_FORMAT,
            "draco: version %u.%u, type %u, method %u: only sequential point clouds of version 2 "
            "hold tiles",
            major, minor, type, method);
    if (flags & FLAG_METADATA) {
        for (uint32_t k = layout_varint(&c); k && !c.bad; k--) {
            layout_varint(&c);
            layout_metadata_skip(&c, 0);
        }
        layout_metadata_skip(&c, 0);
    }
    out->n = cursor_u32(&c);
    bool ok = layout_attributes_match(&c, out);
    size_t most = lim && lim->max_gaussians ? lim->max_gaussians : CODEC_MAX_GAUSSIANS;
    if (c.bad)
        return err_set(e, ERR_FORMAT, "draco: truncated");
    if (out->n > most)
        return err_set(e, ERR_LIMIT, "draco: %u Gaussians: the limit is %zu", out->n, most);
    if (!ok || !out->n || out->n / POINTS_PER_BYTE_MAX > n)
        return err_set(e, ERR_FORMAT, "draco: %u points: not the attributes of a splat tile",
                       out->n);
    if (cursor_left(&c) < DRACO_CRC_BYTES)
        return err_set(e, ERR_FORMAT, "draco: truncated");
    out->stream_bytes = n - DRACO_CRC_BYTES;
    c = cursor_over((const uint8_t *)bytes + out->stream_bytes, DRACO_CRC_BYTES);
    if (cursor_u32(&c) != draco_crc(bytes, out->stream_bytes))
        return err_set(e, ERR_FORMAT, "draco: damaged or truncated, its check value differs");
    return ERR_OK;
}
