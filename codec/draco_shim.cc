// .drc: the quantiser's integers as generic attributes of a Draco point cloud.
//
// Sequential encoding, no Draco quantisation: a reader gets exactly the integers of struct quant.
// SH bytes go as bucket numbers (255 stands for the top one); bytes of foreign files that are on no
// bucket go as they are, with metadata sh_raw = 1. Rotation fields go as 511 +- magnitude. The
// layout is draco_layout.c's.
//
// SPDX-License-Identifier: Apache-2.0
#include "codec/draco_layout.h"

#include <draco/compression/decode.h>
#include <draco/compression/expert_encode.h>
#include <draco/point_cloud/point_cloud.h>

#include <cstdlib>
#include <cstring>
#include <memory>
#include <new>
#include <string>

#include "codec/codec.h"

static constexpr int32_t POSITION_OFFSET = 1 << 23;
static constexpr uint32_t ROTATION_ZERO = 511;

#define SHIM_CATCH(who)                                                                            \
    catch (const std::bad_alloc &)                                                                 \
    {                                                                                              \
        return err_set(e, ERR_MEM, who ": out of memory");                                         \
    }                                                                                              \
    catch (const std::exception &x)                                                                \
    {                                                                                              \
        return err_set(e, ERR_FORMAT, who ": %s", x.what());                                       \
    }                                                                                              \
    catch (...)                                                                                    \
    {                                                                                              \
        return err_set(e, ERR_INTERNAL, who ": unknown exception");                                \
    }

static size_t sh_first(enum draco_id id) // of the bands before, in bytes of a row
{
    return id == DRACO_SH1 ? 0 : id == DRACO_SH2 ? 9 : 24;
}

static unsigned sh_step(enum draco_id id, bool raw)
{
    return raw ? 1 : id == DRACO_SH1 ? 8 : 16;
}

static bool sh_is_snapped(const struct quant *q)
{
    size_t row = 3 * (gauss_sh_count(q->sh_degree) - 1);
    for (size_t i = 0; i < q->n * row; i++)
        if (q->sh[i] % (i % row < 9 ? 8 : 16) && q->sh[i] != 255)
            return false;
    return true;
}

static void copy_sh_in(const struct quant *q, enum draco_id id, size_t width, bool raw,
                       uint8_t *out)
{
    size_t row = 3 * (gauss_sh_count(q->sh_degree) - 1);
    unsigned step = sh_step(id, raw);
    for (size_t i = 0; i < q->n; i++)
        for (size_t c = 0; c < width; c++)
            *out++ = (uint8_t)((q->sh[i * row + sh_first(id) + c] + (raw ? 0u : 1u)) / step);
}

static void copy_in(const struct quant *q, const struct draco_attribute &a, bool raw, uint8_t *out)
{
    uint32_t *out32 = reinterpret_cast<uint32_t *>(out);
    uint16_t *out16 = reinterpret_cast<uint16_t *>(out);
    switch (a.id) {
    case DRACO_POSITION:
        for (size_t i = 0; i < 3 * q->n; i++)
            out32[i] = (uint32_t)(q->position[i] + POSITION_OFFSET);
        break;
    case DRACO_ROTATION:
        for (size_t i = 0; i < 3 * q->n; i++) {
            uint32_t f = q->rotation[i / 3] >> 10 * (2 - i % 3) & 1023, mag = f & 511;
            out16[i] = (uint16_t)(f & 512 ? ROTATION_ZERO - mag : ROTATION_ZERO + mag);
        }
        break;
    case DRACO_ROTATION_INDEX:
        for (size_t i = 0; i < q->n; i++)
            out[i] = (uint8_t)(q->rotation[i] >> 30);
        break;
    case DRACO_OPACITY:
        memcpy(out, q->alpha, q->n);
        break;
    case DRACO_SCALE:
        memcpy(out, q->scale, 3 * q->n);
        break;
    case DRACO_COLOR:
        memcpy(out, q->color, 3 * q->n);
        break;
    case DRACO_EMBEDDING:
        memcpy(out, q->embed, q->embed_len * q->n);
        break;
    default:
        copy_sh_in(q, a.id, a.components, raw, out);
    }
}

static std::string number_list(const float *v, size_t n) // exact: 9 digits give a float32 back
{
    std::string s;
    char text[32];
    for (size_t i = 0; i < n; i++) {
        snprintf(text, sizeof text, i ? " %.9g" : "%.9g", (double)v[i]);
        s += text;
    }
    return s;
}

static void add_metadata(const struct quant *q, const char *tile, bool raw, draco::PointCloud *pc)
{
    std::unique_ptr<draco::GeometryMetadata> m(new draco::GeometryMetadata());
    m->AddEntryString("format", "citysplat-1");
    m->AddEntryInt("frac_bits", 12);
    m->AddEntryInt("sh_degree", (int32_t)q->sh_degree);
    m->AddEntryInt("sh_raw", raw);
    m->AddEntryInt("antialiased", q->antialiased);
    m->AddEntryString("axes", "gltf");
    if (tile && *tile) // libdraco cannot read back empty text
        m->AddEntryString("tile", tile);
    if (q->embed_len) {
        m->AddEntryString("embed_min", number_list(q->embed_min, q->embed_len));
        m->AddEntryString("embed_max", number_list(q->embed_max, q->embed_len));
    }
    pc->AddMetadata(std::move(m));
}

extern "C" enum err_code draco_encode(const struct quant *q, const char *tile, struct buf *out,
                                      struct err *e)
try {
    struct draco_attribute list[DRACO_ID_COUNT];
    size_t count = draco_layout(q->sh_degree, q->embed_len, list);
    if (!q->n || q->n > INT32_MAX)
        return err_set(e, ERR_LIMIT, "draco : %zu Gaussians : a file holds 1 to 2^31-1", q->n);
    bool raw = !sh_is_snapped(q);
    draco::PointCloud pc;
    pc.set_num_points((uint32_t)q->n);
    add_metadata(q, tile, raw, &pc);
    for (size_t i = 0; i < count; i++) {
        const struct draco_attribute &a = list[i];
        size_t stride = a.components * (a.type == DRACO_UINT32   ? 4
                                        : a.type == DRACO_UINT16 ? 2
                                                                 : 1);
        draco::GeometryAttribute ga;
        ga.Init(a.id == DRACO_POSITION ? draco::GeometryAttribute::POSITION
                                       : draco::GeometryAttribute::GENERIC,
                nullptr, (uint8_t)a.components, (draco::DataType)a.type, false, (int64_t)stride, 0);
        int id = pc.AddAttribute(ga, true, (uint32_t)q->n);
        pc.attribute(id)->set_unique_id(a.id);
        copy_in(q, a, raw, pc.attribute(id)->buffer()->data());
        std::unique_ptr<draco::AttributeMetadata> m(new draco::AttributeMetadata());
        m->AddEntryString("name", a.name);
        pc.AddAttributeMetadata(id, std::move(m));
    }
    draco::ExpertEncoder enc(pc);
    enc.SetEncodingMethod(draco::POINT_CLOUD_SEQUENTIAL_ENCODING);
    enc.SetSpeedOptions(0, 0);
    for (size_t i = 0; i < count; i++)
        if (!list[i].delta &&
            !enc.SetAttributePredictionScheme((int)i, draco::PREDICTION_NONE).ok())
            return err_set(e, ERR_INTERNAL, "draco : %s : prediction scheme refused", list[i].name);
    draco::EncoderBuffer b;
    draco::Status s = enc.EncodeToBuffer(&b);
    if (!s.ok())
        return err_set(e, ERR_INTERNAL, "draco : %s", s.error_msg());
    buf_add(out, b.data(), b.size());
    buf_u32(out, draco_crc(b.data(), b.size()));
    return buf_check(out, e);
}
SHIM_CATCH("draco_encode")

// One attribute back into the quant; false when a value is out of its range.
static bool copy_out(const struct draco_attribute &a, const uint8_t *in, bool raw, struct quant *q)
{
    const uint32_t *in32 = reinterpret_cast<const uint32_t *>(in);
    const uint16_t *in16 = reinterpret_cast<const uint16_t *>(in);
    size_t row = 3 * (gauss_sh_count(q->sh_degree) - 1);
    unsigned step = sh_step(a.id, raw);
    bool ok = true;
    switch (a.id) {
    case DRACO_POSITION:
        for (size_t i = 0; i < 3 * q->n; i++) {
            ok = ok && in32[i] > 0 && in32[i] < 2 * (uint32_t)POSITION_OFFSET;
            q->position[i] = (int32_t)(in32[i] & 0xffffff) - POSITION_OFFSET;
        }
        break;
    case DRACO_ROTATION:
        for (size_t i = 0; i < 3 * q->n; i++) {
            uint32_t v = in16[i];
            ok = ok && v <= 2 * ROTATION_ZERO;
            uint32_t f = v < ROTATION_ZERO ? 512 | (ROTATION_ZERO - v) : v - ROTATION_ZERO;
            q->rotation[i / 3] |= (f & 1023) << 10 * (2 - i % 3);
        }
        break;
    case DRACO_ROTATION_INDEX:
        for (size_t i = 0; i < q->n; i++) {
            ok = ok && in[i] < 4;
            q->rotation[i] |= (uint32_t)(in[i] & 3) << 30;
        }
        break;
    case DRACO_OPACITY:
        memcpy(q->alpha, in, q->n);
        break;
    case DRACO_SCALE:
        memcpy(q->scale, in, 3 * q->n);
        break;
    case DRACO_COLOR:
        memcpy(q->color, in, 3 * q->n);
        break;
    case DRACO_EMBEDDING:
        memcpy(q->embed, in, q->embed_len * q->n);
        break;
    default:
        for (size_t i = 0; i < q->n; i++)
            for (size_t c = 0; c < a.components; c++) {
                unsigned v = *in++ * step;
                ok = ok && v <= 256;
                q->sh[i * row + sh_first(a.id) + c] = (uint8_t)(v > 255 ? 255 : v);
            }
    }
    return ok;
}

static bool read_numbers(const draco::Metadata *m, const char *name, float *out, size_t n)
{
    std::string s;
    if (!m->GetEntryString(name, &s))
        return false;
    const char *p = s.c_str();
    for (size_t i = 0; i < n; i++) {
        char *end;
        out[i] = strtof(p, &end);
        if (end == p || !(out[i] - out[i] == 0)) // not a number, or not finite
            return false;
        p = end;
    }
    return true;
}

static enum err_code read_cloud(const draco::PointCloud &pc, struct quant *q, struct err *e)
{
    struct draco_attribute list[DRACO_ID_COUNT];
    size_t count = draco_layout(q->sh_degree, q->embed_len, list);
    const draco::GeometryMetadata *m = pc.GetMetadata();
    std::string format;
    int32_t bits = 0, raw = 0, antialiased = 0;
    if (!m || !m->GetEntryString("format", &format) || format != "citysplat-1" ||
        !m->GetEntryInt("frac_bits", &bits) || bits != 12)
        return err_set(e, ERR_FORMAT, "draco : not a splat tile of format citysplat-1");
    m->GetEntryInt("sh_raw", &raw);
    q->antialiased = m->GetEntryInt("antialiased", &antialiased) && antialiased;
    if (q->embed_len && (!read_numbers(m, "embed_min", q->embed_min, q->embed_len) ||
                         !read_numbers(m, "embed_max", q->embed_max, q->embed_len)))
        return err_set(e, ERR_FORMAT, "draco : ranges of the embedding are missing");
    for (size_t i = 0; i < count; i++) {
        const draco::PointAttribute *a = pc.GetAttributeByUniqueId(list[i].id);
        size_t bytes = list[i].components *
                       (list[i].type == DRACO_UINT32   ? 4
                        : list[i].type == DRACO_UINT16 ? 2
                                                       : 1) *
                       q->n;
        if (!a || a->size() != q->n || !a->is_mapping_identity() ||
            a->buffer()->data_size() < bytes)
            return err_set(e, ERR_FORMAT, "draco : attribute %s is damaged", list[i].name);
        if (!copy_out(list[i], a->buffer()->data(), raw, q))
            return err_set(e, ERR_FORMAT, "draco : attribute %s has a value out of range",
                           list[i].name);
    }
    return ERR_OK;
}

extern "C" enum err_code draco_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                                      struct quant *out, struct err *e)
try {
    struct draco_head h;
    *out = {};
    enum err_code rc = draco_check(bytes, n, lim, &h, e);
    if (rc != ERR_OK)
        return rc;
    draco::DecoderBuffer b;
    b.Init(static_cast<const char *>(bytes), h.stream_bytes);
    draco::Decoder dec;
    auto pc = dec.DecodePointCloudFromBuffer(&b);
    if (!pc.ok())
        return err_set(e, ERR_FORMAT, "draco : damaged or truncated (%s)", pc.status().error_msg());
    if (pc.value()->num_points() != h.n)
        return err_set(e, ERR_FORMAT, "draco : damaged point count");
    struct quant q = {};
    std::unique_ptr<struct quant, void (*)(struct quant *)> guard(&q, quant_free);
    rc = quant_alloc(&q, h.n, h.sh_degree, h.embed_len, e);
    if (rc == ERR_OK)
        rc = read_cloud(*pc.value(), &q, e);
    if (rc == ERR_OK) {
        *out = q;
        q = {}; // moved out
    }
    return rc;
}
SHIM_CATCH("draco_decode")
