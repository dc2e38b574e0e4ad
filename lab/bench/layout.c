/* See layout.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/layout.h"

#include <string.h>

#include "codec/splat/draco_layout.h"
#include "codec/splat/quant.h"
#include "core/base.h"

enum { COLUMNS_MAX = 96, MAGNITUDE_MAX = 511, POSITION_OFFSET = 1 << 23 };

struct cut { /* columns being put together */
    const struct quant *q;
    const struct layout *l;
    struct draco_column column[COLUMNS_MAX];
    void *values[COLUMNS_MAX];
    size_t n;
    bool failed;
};

static unsigned layout_zero_bits(uint32_t all, unsigned most)
{
    unsigned k = 0;
    while (k < most && !(all >> k & 1))
        k++;
    return k;
}

static unsigned layout_byte_shift(const uint8_t *v, size_t rows, size_t stride, size_t from,
                                  size_t width)
{
    uint32_t all = 0;
    for (size_t i = 0; i < rows; i++)
        for (size_t c = from; c < from + width; c++)
            all |= v[i * stride + c] == 255 ? 0 : v[i * stride + c];
    return layout_zero_bits(all, 7);
}

static unsigned layout_step_of(unsigned v, unsigned shift)
{
    return (v + (1u << shift) - 1) >> shift;
}

static void *layout_cut_add(struct cut *c, enum draco_type type, uint32_t components)
{
    size_t size = type == DRACO_UINT32 ? 4 : type == DRACO_UINT16 ? 2 : 1;
    void *v = c->n < COLUMNS_MAX ? mem_array(c->q->n * components, size) : NULL;
    if (!v) {
        c->failed = true;
        return NULL;
    }
    enum draco_prediction p = DRACO_PREDICT_NEVER;
    if (c->l->predict == LAYOUT_PREDICT_ALL || type == DRACO_UINT32)
        p = DRACO_PREDICT_ROW;
    else if (c->l->predict == LAYOUT_PREDICT_PAYING && type == DRACO_UINT8)
        p = DRACO_PREDICT_WHERE_IT_PAYS;
    c->values[c->n] = v;
    c->column[c->n++] = (struct draco_column){type, components, p, v};
    return v;
}

/* `width` bytes a row, as one attribute or each by itself. */
static void layout_cut_bytes(struct cut *c, const uint8_t *v, size_t width, bool split)
{
    for (size_t a = 0; a < (split ? width : 1); a++) {
        size_t n = split ? 1 : width;
        uint8_t *to = layout_cut_add(c, DRACO_UINT8, (uint32_t)n);
        for (size_t i = 0; to && i < c->q->n; i++)
            memcpy(to + n * i, v + width * i + a, n);
    }
}

static void layout_cut_position(struct cut *c)
{
    uint32_t all = 0;
    for (size_t i = 0; i < 3 * c->q->n; i++)
        all |= (uint32_t)c->q->position[i];
    const int32_t step = 1 << layout_zero_bits(all, 22);
    size_t n = c->l->split_position ? 1 : 3;
    for (size_t a = 0; a < 3; a += n) {
        uint32_t *to = layout_cut_add(c, DRACO_UINT32, (uint32_t)n);
        for (size_t i = 0; to && i < c->q->n; i++)
            for (size_t k = 0; k < n; k++)
                to[n * i + k] = (uint32_t)(c->q->position[3 * i + a + k] / step + POSITION_OFFSET);
    }
}

static void layout_cut_scale(struct cut *c, uint8_t *scratch)
{
    const struct quant *q = c->q;
    unsigned shift = layout_byte_shift(q->scale, q->n, 3, 0, 3);
    for (size_t i = 0; i < 3 * q->n; i++)
        scratch[i] = (uint8_t)layout_step_of(q->scale[i], shift);
    for (size_t i = 0; c->l->scale_differences && i < q->n; i++) {
        scratch[3 * i + 1] = (uint8_t)(scratch[3 * i + 1] - scratch[3 * i] + 128);
        scratch[3 * i + 2] = (uint8_t)(scratch[3 * i + 2] - scratch[3 * i] + 128);
    }
    layout_cut_bytes(c, scratch, 3, c->l->split_scale || c->l->scale_differences);
}

static void layout_cut_rotation(struct cut *c, uint8_t *scratch)
{
    const struct quant *q = c->q;
    uint32_t all = 0;
    for (size_t i = 0; i < q->n; i++)
        for (unsigned f = 0; f < 30; f += 10)
            all |= (q->rotation[i] >> f & 511) == MAGNITUDE_MAX ? 0 : q->rotation[i] >> f & 511;
    const unsigned shift = layout_zero_bits(all, 8), zero = layout_step_of(MAGNITUDE_MAX, shift);
    size_t n = c->l->split_rotation ? 1 : 3;
    for (size_t a = 0; a < 3; a += n) {
        uint16_t *to = layout_cut_add(c, DRACO_UINT16, (uint32_t)n);
        for (size_t i = 0; to && i < q->n; i++)
            for (size_t k = 0; k < n; k++) {
                uint32_t field = q->rotation[i] >> (20 - 10 * (a + k)) & 1023;
                unsigned mag = layout_step_of(field & 511, shift);
                to[n * i + k] = (uint16_t)(field & 512 ? zero - mag : zero + mag);
            }
    }
    for (size_t i = 0; i < q->n; i++)
        scratch[i] = (uint8_t)(q->rotation[i] >> 30);
    layout_cut_bytes(c, scratch, 1, false);
}

/* One triple of steps in the channels asked for: [0] the first of them, then the two others. All
 * three forms can be turned back modulo 256. */
static void layout_cut_triple(enum layout_channels channels, const uint8_t rgb[3], unsigned shift,
                              uint8_t out[3])
{
    uint8_t r = (uint8_t)layout_step_of(rgb[0], shift), g = (uint8_t)layout_step_of(rgb[1], shift),
            b = (uint8_t)layout_step_of(rgb[2], shift);
    if (channels == LAYOUT_YCOCG) { /* YCoCg-R (Malvar 2003): lifting steps */
        uint8_t co = (uint8_t)(r - b), t = (uint8_t)(b + (uint8_t)((int8_t)co / 2));
        uint8_t cg = (uint8_t)(g - t);
        out[0] = (uint8_t)(t + (uint8_t)((int8_t)cg / 2));
        out[1] = (uint8_t)(co + 128);
        out[2] = (uint8_t)(cg + 128);
        return;
    }
    bool about = channels == LAYOUT_GREEN;
    out[0] = g;
    out[1] = about ? (uint8_t)(r - g + 128) : r;
    out[2] = about ? (uint8_t)(b - g + 128) : b;
}

/* k coefficients of three channels a row. */
static void layout_cut_color(struct cut *c, const uint8_t *v, size_t stride, size_t k,
                             uint8_t *scratch)
{
    const struct layout *l = c->l;
    const size_t n = c->q->n;
    unsigned shift = layout_byte_shift(v, n, stride, 0, 3 * k);
    bool joined = l->join_channels || l->channels == LAYOUT_RGB;
    uint8_t *first = scratch, *rest = scratch + (joined ? 0 : k * n);
    for (size_t i = 0; i < n; i++)
        for (size_t a = 0; a < k; a++) {
            uint8_t t[3];
            layout_cut_triple(l->channels, v + stride * i + 3 * a, shift, t);
            if (joined) {
                memcpy(first + 3 * (k * i + a), t, 3);
                continue;
            }
            first[k * i + a] = t[0];
            memcpy(rest + 2 * (k * i + a), t + 1, 2);
        }
    layout_cut_bytes(c, first, joined ? 3 * k : k, l->split_color);
    if (!joined)
        layout_cut_bytes(c, rest, 2 * k, l->split_color);
}

enum err_code layout_encode(const struct quant *q, const struct layout *l, struct buf *out,
                            struct err *e)
{
    struct cut *c = mem_array(1, sizeof *c);
    uint8_t *scratch = mem_array(q->n, 64);
    if (!c || !scratch) {
        mem_free(c);
        mem_free(scratch);
        return err_set(e, ERR_MEM, "out of memory for %zu rows", q->n);
    }
    c->q = q;
    c->l = l;
    const size_t stride = 3 * (gauss_sh_count(q->sh_degree) - 1);
    layout_cut_position(c);
    unsigned shift = layout_byte_shift(q->alpha, q->n, 1, 0, 1);
    for (size_t i = 0; i < q->n; i++)
        scratch[i] = (uint8_t)layout_step_of(q->alpha[i], shift);
    layout_cut_bytes(c, scratch, 1, false);
    layout_cut_scale(c, scratch);
    layout_cut_rotation(c, scratch);
    layout_cut_color(c, q->color, 3, 1, scratch);
    for (uint32_t d = 1, at = 0; d <= q->sh_degree; at += 3 * (2 * d + 1), d++)
        layout_cut_color(c, q->sh + at, stride, 2 * d + 1, scratch);
    enum err_code rc = c->failed ? err_set(e, ERR_MEM, "out of memory for %zu rows", q->n)
                                 : draco_encode_columns(c->column, c->n, q->n, out, e);
    for (size_t i = 0; i < c->n; i++)
        mem_free(c->values[i]);
    mem_free(c);
    mem_free(scratch);
    return rc;
}
