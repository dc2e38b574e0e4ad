// .drc: the quantiser's integers as generic attributes of a Draco point cloud.
//
// Sequential encoding, no Draco quantisation: a reader gets exactly the integers of struct quant.
// What makes it small is done to the integers before:
//   - low bits that are 0 in all rows are left out (the attribute's "shift"; presets make them, and
//     an .spz that was made by one is recognised); a field's largest value counts as one step more
//   - red and blue are written about green: a coefficient's three channels are nearly equal
//   - attributes of different statistics have their own tables; an attribute is predicted from the
//     row before only where that was measured to be smaller
// The layout is draco_layout.c's.
//
// SPDX-License-Identifier: Apache-2.0
#include "codec/limits.h"
#include "codec/splat/draco.h"
#include "codec/splat/draco_layout.h"
#include "codec/splat/quant.h"
#include "core/shim.h"

#include <draco/compression/decode.h>
#include <draco/compression/expert_encode.h>
#include <draco/point_cloud/point_cloud.h>

#include <cmath>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <new>
#include <string>

static constexpr int32_t POSITION_OFFSET = 1 << 23;
static constexpr uint32_t MAGNITUDE_MAX = 511, GREEN_OFFSET = 128;
static constexpr int BYTE_SHIFT_MAX = 7, MAGNITUDE_SHIFT_MAX = 8, POSITION_SHIFT_MAX = 22;
static constexpr size_t SAMPLE_ROWS = 256, SAMPLE_EVERY = 2048; // for the choice of prediction

// ---- where values stand in struct quant, and how many low bits they do without ------------------

struct triples { // (r, g, b) of coefficient c of row i: data[i * stride + 3 * c ...]
    uint8_t *data;
    size_t stride;
};

static size_t draco_sh_first(enum draco_id id) // of the bands before, in bytes of a row
{
    return id <= DRACO_SH1_RB ? 0 : id <= DRACO_SH2_RB ? 9 : 24;
}

static bool draco_is_rb(enum draco_id id)
{
    return id == DRACO_COLOR_RB || id == DRACO_SH1_RB || id == DRACO_SH2_RB || id == DRACO_SH3_RB;
}

// What a _g or _rb attribute is about.
static struct triples draco_triples_of(const struct quant *q, enum draco_id id)
{
    if (id == DRACO_COLOR_G || id == DRACO_COLOR_RB)
        return {q->color, 3};
    return {q->sh + draco_sh_first(id), 3 * (gauss_sh_count(q->sh_degree) - 1)};
}

static int draco_zero_bits(uint32_t all, int most) // low bits that are 0 in the OR of all values
{
    int k = 0;
    while (k < most && !(all >> k & 1))
        k++;
    return k;
}

static int draco_shift_of_bytes(const uint8_t *v, size_t rows, size_t stride, size_t width)
{
    uint8_t all = 0;
    for (size_t i = 0; i < rows; i++)
        for (size_t c = 0; c < width; c++) {
            uint8_t b = v[i * stride + c];
            all |= (uint8_t)(b == 255 ? 0 : b);
        }
    return draco_zero_bits(all, BYTE_SHIFT_MAX);
}

static int draco_shift_of(const struct quant *q, const struct draco_attribute &a)
{
    uint32_t all = 0;
    size_t width = draco_is_rb(a.id) ? a.components / 2 * 3 : a.components * 3;
    switch (a.id) {
    case DRACO_POSITION:
        for (size_t i = 0; i < 3 * q->n; i++)
            all |= (uint32_t)q->position[i];
        return draco_zero_bits(all, POSITION_SHIFT_MAX);
    case DRACO_ROTATION:
        for (size_t i = 0; i < q->n; i++)
            for (int f = 0; f < 30; f += 10) {
                uint32_t mag = q->rotation[i] >> f & 511;
                all |= mag == MAGNITUDE_MAX ? 0 : mag;
            }
        return draco_zero_bits(all, MAGNITUDE_SHIFT_MAX);
    case DRACO_ROTATION_INDEX:
        return 0;
    case DRACO_OPACITY:
        return draco_shift_of_bytes(q->alpha, 1, 0, q->n);
    case DRACO_SCALE:
        return draco_shift_of_bytes(q->scale, 1, 0, 3 * q->n);
    case DRACO_EMBEDDING:
        return draco_shift_of_bytes(q->embed, 1, 0, q->embed_len * q->n);
    default:
        struct triples t = draco_triples_of(q, a.id);
        return draco_shift_of_bytes(t.data, q->n, t.stride, width);
    }
}

// ---- to values ---------------------------------------------------------------------------------

static unsigned draco_index_of(unsigned v, int shift) // 255 and 511 stand for the step above them
{
    return (v + (1u << shift) - 1) >> shift;
}

static void draco_copy_bytes_in(const uint8_t *in, size_t n, int shift, uint8_t *out)
{
    for (size_t i = 0; i < n; i++)
        out[i] = (uint8_t)draco_index_of(in[i], shift);
}

static void draco_copy_triples_in(const struct quant *q, const struct draco_attribute &a, int shift,
                                  uint8_t *out)
{
    struct triples t = draco_triples_of(q, a.id);
    if (!draco_is_rb(a.id)) {
        for (size_t i = 0; i < q->n; i++)
            for (size_t c = 0; c < a.components; c++)
                *out++ = (uint8_t)draco_index_of(t.data[i * t.stride + 3 * c + 1], shift);
        return;
    }
    for (size_t i = 0; i < q->n; i++)
        for (size_t c = 0; c < a.components / 2; c++) {
            const uint8_t *rgb = t.data + i * t.stride + 3 * c;
            unsigned g = draco_index_of(rgb[1], shift);
            *out++ = (uint8_t)(draco_index_of(rgb[0], shift) - g + GREEN_OFFSET);
            *out++ = (uint8_t)(draco_index_of(rgb[2], shift) - g + GREEN_OFFSET);
        }
}

static void draco_copy_in(const struct quant *q, const struct draco_attribute &a, int shift,
                          uint8_t *out)
{
    uint32_t *out32 = reinterpret_cast<uint32_t *>(out);
    uint16_t *out16 = reinterpret_cast<uint16_t *>(out);
    const uint32_t zero = draco_index_of(MAGNITUDE_MAX, shift);
    switch (a.id) {
    case DRACO_POSITION:
        for (size_t i = 0; i < 3 * q->n; i++) // a multiple: the division is exact
            out32[i] = (uint32_t)(q->position[i] / (1 << shift) + POSITION_OFFSET);
        break;
    case DRACO_ROTATION:
        for (size_t i = 0; i < q->n; i++)
            for (int f = 20; f >= 0; f -= 10) {
                uint32_t field = q->rotation[i] >> f & 1023;
                uint32_t mag = draco_index_of(field & 511, shift);
                *out16++ = (uint16_t)(field & 512 ? zero - mag : zero + mag);
            }
        break;
    case DRACO_ROTATION_INDEX:
        for (size_t i = 0; i < q->n; i++)
            out[i] = (uint8_t)(q->rotation[i] >> 30);
        break;
    case DRACO_OPACITY:
        draco_copy_bytes_in(q->alpha, q->n, shift, out);
        break;
    case DRACO_SCALE:
        draco_copy_bytes_in(q->scale, 3 * q->n, shift, out);
        break;
    case DRACO_EMBEDDING:
        draco_copy_bytes_in(q->embed, q->embed_len * q->n, shift, out);
        break;
    default:
        draco_copy_triples_in(q, a, shift, out);
    }
}

// Would differences to the row before take fewer bits? Order-0 entropy of some rows.
static bool draco_delta_pays(const uint8_t *v, size_t n, size_t width)
{
    uint32_t plain[256] = {0}, delta[256] = {0};
    double bits = 0;
    for (size_t at = 0; at<n; at += n> 8 * SAMPLE_EVERY ? SAMPLE_EVERY : SAMPLE_ROWS) {
        size_t end = at + SAMPLE_ROWS < n ? at + SAMPLE_ROWS : n;
        for (size_t i = (at + 1) * width; i < end * width; i++) {
            plain[v[i]]++;
            delta[(uint8_t)(v[i] - v[i - width])]++;
        }
    }
    for (int k = 0; k < 256; k++) {
        bits += plain[k] ? plain[k] * std::log2((double)plain[k]) : 0;
        bits -= delta[k] ? delta[k] * std::log2((double)delta[k]) : 0;
    }
    return bits < 0; // sum c log2 c is larger where the entropy is smaller
}

static std::string draco_number_list(const float *v,
                                     size_t n) // exact: 9 digits give a float32 back
{
    std::string s;
    char text[32];
    for (size_t i = 0; i < n; i++) {
        snprintf(text, sizeof text, i ? " %.9g" : "%.9g", (double)v[i]);
        s += text;
    }
    return s;
}

static void draco_add_metadata(const struct quant *q, const char *tile, draco::PointCloud *pc)
{
    std::unique_ptr<draco::GeometryMetadata> m(new draco::GeometryMetadata());
    m->AddEntryString("format", "citysplat-2");
    m->AddEntryInt("frac_bits", (int32_t)q->frac_bits);
    m->AddEntryInt("sh_degree", (int32_t)q->sh_degree);
    m->AddEntryInt("antialiased", q->antialiased);
    m->AddEntryString("axes", "gltf");
    if (q->rest)
        m->AddEntryInt("rest", (int32_t)q->rest);
    if (tile && *tile) // libdraco cannot read back empty text
        m->AddEntryString("tile", tile);
    if (q->embed_len) {
        m->AddEntryString("embed_min", draco_number_list(q->embed_min, q->embed_len));
        m->AddEntryString("embed_max", draco_number_list(q->embed_max, q->embed_len));
    }
    pc->AddMetadata(std::move(m));
}

static size_t draco_value_bytes(enum draco_type type)
{
    return type == DRACO_UINT32 ? 4 : type == DRACO_UINT16 ? 2 : 1;
}

static int draco_add_values(draco::PointCloud *pc, bool position, enum draco_type type,
                            uint32_t components, size_t n)
{
    draco::GeometryAttribute ga;
    ga.Init(position ? draco::GeometryAttribute::POSITION : draco::GeometryAttribute::GENERIC,
            nullptr, (uint8_t)components, (draco::DataType)type, false,
            (int64_t)(components * draco_value_bytes(type)), 0);
    return pc->AddAttribute(ga, true, (uint32_t)n);
}

// Returns whether the attribute is to be predicted.
static bool draco_add_attribute(const struct quant *q, const struct draco_attribute &a, int shift,
                                draco::PointCloud *pc)
{
    int id = draco_add_values(pc, a.id == DRACO_POSITION, a.type, a.components, q->n);
    pc->attribute(id)->set_unique_id(a.id);
    uint8_t *values = pc->attribute(id)->buffer()->data();
    draco_copy_in(q, a, shift, values);
    std::unique_ptr<draco::AttributeMetadata> m(new draco::AttributeMetadata());
    m->AddEntryString("name", a.name);
    m->AddEntryInt("shift", shift);
    pc->AddAttributeMetadata(id, std::move(m));
    return a.id == DRACO_POSITION ||
           (a.type == DRACO_UINT8 && draco_delta_pays(values, q->n, a.components));
}

static bool draco_encode_cloud(const draco::PointCloud &pc, const bool *predicted, size_t count,
                               draco::EncoderBuffer *out, std::string *why)
{
    draco::ExpertEncoder enc(pc);
    enc.SetEncodingMethod(draco::POINT_CLOUD_SEQUENTIAL_ENCODING);
    enc.SetSpeedOptions(0, 0);
    draco::Status s;
    for (size_t i = 0; i < count && s.ok(); i++)
        if (!predicted[i])
            s = enc.SetAttributePredictionScheme((int)i, draco::PREDICTION_NONE);
    if (s.ok())
        s = enc.EncodeToBuffer(out);
    *why = s.error_msg_string();
    return s.ok();
}

extern "C" enum err_code draco_encode_columns(const struct draco_column *column, size_t n_columns,
                                              size_t n, struct buf *out, struct err *e)
try {
    draco::PointCloud pc;
    draco::EncoderBuffer b;
    std::string why;
    std::unique_ptr<bool[]> predicted(new bool[n_columns]);
    pc.set_num_points((uint32_t)n);
    for (size_t i = 0; i < n_columns; i++) {
        const struct draco_column &c = column[i];
        int id = draco_add_values(&pc, i == 0, c.type, c.components, n);
        memcpy(pc.attribute(id)->buffer()->data(), c.values,
               n * c.components * draco_value_bytes(c.type));
        predicted[i] =
            c.prediction == DRACO_PREDICT_WHERE_IT_PAYS
                ? draco_delta_pays(static_cast<const uint8_t *>(c.values), n, c.components)
                : c.prediction == DRACO_PREDICT_ROW;
    }
    if (!draco_encode_cloud(pc, predicted.get(), n_columns, &b, &why))
        return err_set(e, ERR_INTERNAL, "draco: %s", why.c_str());
    buf_add(out, b.data(), b.size());
    return buf_check(out, e);
}
SHIM_CATCH("draco_encode_columns", ERR_FORMAT)

extern "C" enum err_code draco_encode(const struct quant *q, const char *tile, struct buf *out,
                                      struct err *e)
try {
    struct draco_attribute list[DRACO_ID_COUNT];
    bool delta[DRACO_ID_COUNT];
    int shift[DRACO_ID_COUNT];
    size_t count = draco_layout(q->sh_degree, q->embed_len, list);
    if (!q->n || q->n > INT32_MAX)
        return err_set(e, ERR_LIMIT, "draco: %zu Gaussians: a file holds 1 to 2^31-1", q->n);
    draco::PointCloud pc;
    pc.set_num_points((uint32_t)q->n);
    draco_add_metadata(q, tile, &pc);
    for (size_t i = 0; i < count; i++) { // red and blue go in the steps of their green
        shift[i] = draco_is_rb(list[i].id) ? shift[i - 1] : draco_shift_of(q, list[i]);
        delta[i] = draco_add_attribute(q, list[i], shift[i], &pc);
    }
    draco::EncoderBuffer b;
    std::string why;
    if (!draco_encode_cloud(pc, delta, count, &b, &why))
        return err_set(e, ERR_INTERNAL, "draco: %s", why.c_str());
    buf_add(out, b.data(), b.size());
    buf_u32(out, draco_crc(b.data(), b.size()));
    return buf_check(out, e);
}
SHIM_CATCH("draco_encode", ERR_FORMAT)

// ---- and back ----------------------------------------------------------------------------------

// One step's number back to the byte; false when there is no such step.
static bool draco_byte_of(unsigned index, int shift, uint8_t *out)
{
    unsigned v = index << shift;
    *out = (uint8_t)(v > 255 ? 255 : v);
    return v <= 256;
}

static bool draco_copy_bytes_out(const uint8_t *in, size_t n, int shift, uint8_t *out)
{
    bool ok = true;
    for (size_t i = 0; i < n; i++)
        ok &= draco_byte_of(in[i], shift, out + i);
    return ok;
}

// Green first: it is in place when red and blue come.
static bool draco_copy_triples_out(const struct draco_attribute &a, const uint8_t *in, int shift,
                                   struct quant *q)
{
    struct triples t = draco_triples_of(q, a.id);
    bool ok = true;
    if (!draco_is_rb(a.id)) {
        for (size_t i = 0; i < q->n; i++)
            for (size_t c = 0; c < a.components; c++)
                ok &= draco_byte_of(*in++, shift, t.data + i * t.stride + 3 * c + 1);
        return ok;
    }
    for (size_t i = 0; i < q->n; i++)
        for (size_t c = 0; c < a.components / 2; c++) {
            uint8_t *rgb = t.data + i * t.stride + 3 * c;
            unsigned g = draco_index_of(rgb[1], shift) + 256 - GREEN_OFFSET;
            ok &= draco_byte_of((*in++ + g) & 255, shift, rgb);
            ok &= draco_byte_of((*in++ + g) & 255, shift, rgb + 2);
        }
    return ok;
}

static bool draco_copy_rotations_out(const uint16_t *in, int shift, struct quant *q)
{
    const uint32_t zero = draco_index_of(MAGNITUDE_MAX, shift);
    bool ok = true;
    for (size_t i = 0; i < q->n; i++)
        for (int f = 20; f >= 0; f -= 10) {
            uint32_t v = *in++, mag = v < zero ? zero - v : v - zero;
            ok &= v <= 2 * zero;
            mag <<= shift;
            mag = mag > MAGNITUDE_MAX ? MAGNITUDE_MAX : mag;
            q->rotation[i] |= (v < zero ? 512 | mag : mag) << f;
        }
    return ok;
}

// One attribute back into the quant; false when a value is out of its range.
static bool draco_copy_out(const struct draco_attribute &a, const uint8_t *in, int shift,
                           struct quant *q)
{
    const uint32_t *in32 = reinterpret_cast<const uint32_t *>(in);
    bool ok = true;
    switch (a.id) {
    case DRACO_POSITION:
        for (size_t i = 0; i < 3 * q->n; i++) {
            int64_t v = ((int64_t)in32[i] - POSITION_OFFSET) * (1 << shift);
            bool fits = v > -POSITION_OFFSET && v < POSITION_OFFSET;
            q->position[i] = fits ? (int32_t)v : 0;
            ok &= fits;
        }
        return ok;
    case DRACO_ROTATION:
        return draco_copy_rotations_out(reinterpret_cast<const uint16_t *>(in), shift, q);
    case DRACO_ROTATION_INDEX:
        for (size_t i = 0; i < q->n; i++) {
            ok &= in[i] < 4;
            q->rotation[i] |= (uint32_t)(in[i] & 3) << 30;
        }
        return ok;
    case DRACO_OPACITY:
        return draco_copy_bytes_out(in, q->n, shift, q->alpha);
    case DRACO_SCALE:
        return draco_copy_bytes_out(in, 3 * q->n, shift, q->scale);
    case DRACO_EMBEDDING:
        return draco_copy_bytes_out(in, q->embed_len * q->n, shift, q->embed);
    default:
        return draco_copy_triples_out(a, in, shift, q);
    }
}

static bool draco_read_numbers(const draco::Metadata *m, const char *name, float *out, size_t n)
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

static bool draco_read_shift(const draco::PointCloud &pc, enum draco_id id, int *out)
{
    const draco::AttributeMetadata *m =
        pc.GetAttributeMetadataByAttributeId(pc.GetAttributeIdByUniqueId(id));
    int32_t shift;
    if (!m || !m->GetEntryInt("shift", &shift))
        return false;
    *out = shift;
    return shift >= 0 && shift <= (id == DRACO_POSITION   ? POSITION_SHIFT_MAX
                                   : id == DRACO_ROTATION ? MAGNITUDE_SHIFT_MAX
                                                          : BYTE_SHIFT_MAX);
}

static enum err_code draco_read_cloud(const draco::PointCloud &pc, struct quant *q, struct err *e)
{
    struct draco_attribute list[DRACO_ID_COUNT];
    size_t count = draco_layout(q->sh_degree, q->embed_len, list);
    const draco::GeometryMetadata *m = pc.GetMetadata();
    std::string format;
    int32_t bits = -1, antialiased = 0;
    if (!m || !m->GetEntryString("format", &format) || format != "citysplat-2" ||
        !m->GetEntryInt("frac_bits", &bits) || bits < 0 || bits > 23)
        return err_set(e, ERR_FORMAT, "draco: not a splat tile of format citysplat-2");
    q->frac_bits = (uint32_t)bits;
    q->antialiased = m->GetEntryInt("antialiased", &antialiased) && antialiased;
    if (q->embed_len && (!draco_read_numbers(m, "embed_min", q->embed_min, q->embed_len) ||
                         !draco_read_numbers(m, "embed_max", q->embed_max, q->embed_len)))
        return err_set(e, ERR_FORMAT, "draco: ranges of the embedding are missing");
    for (size_t i = 0; i < count; i++) {
        const draco::PointAttribute *a = pc.GetAttributeByUniqueId(list[i].id);
        size_t bytes = list[i].components * draco_value_bytes(list[i].type) * q->n;
        int shift;
        if (!a || a->size() != q->n || !a->is_mapping_identity() ||
            a->buffer()->data_size() < bytes || !draco_read_shift(pc, list[i].id, &shift))
            return err_set(e, ERR_FORMAT, "draco: attribute %s is damaged", list[i].name);
        if (!draco_copy_out(list[i], a->buffer()->data(), shift, q))
            return err_set(e, ERR_FORMAT, "draco: attribute %s has a value out of range",
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
    if (rc)
        return rc;
    draco::DecoderBuffer b;
    b.Init(static_cast<const char *>(bytes), h.stream_bytes);
    draco::Decoder dec;
    auto pc = dec.DecodePointCloudFromBuffer(&b);
    if (!pc.ok())
        return err_set(e, ERR_FORMAT, "draco: damaged or truncated (%s)", pc.status().error_msg());
    if (pc.value()->num_points() != h.n)
        return err_set(e, ERR_FORMAT, "draco: damaged point count");
    struct quant q = {};
    std::unique_ptr<struct quant, void (*)(struct quant *)> guard(&q, quant_free);
    rc = quant_alloc(&q, h.n, h.sh_degree, h.embed_len, e);
    if (!rc)
        rc = draco_read_cloud(*pc.value(), &q, e);
    if (!rc) {
        *out = q;
        q = {}; // moved out
    }
    return rc;
}
SHIM_CATCH("draco_decode", ERR_FORMAT)
