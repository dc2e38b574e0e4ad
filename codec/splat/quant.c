/* The quantiser. It makes the integers of SPZ v3 for .spz, the SPZ payload of .glb, and .drc. Every
 * client therefore draws the same picture, and a test can compare files bit by bit.
 *
 *     position  round(p * 2^frac_bits), 24 bits    alpha  round(255 * opacity)
 *     color     round(dc * 0.15 * 255 + 127.5)     scale  round((ln(sigma) + 10) * 16)
 *     rotation  index of the largest component << 30 | three 10-bit fields (sign, 9-bit magnitude)
 *     sh        round(128 c) + 128
 *
 * Each is the nearest one, or, where a preset says so, one that looks alike (quant_look.h).
 * A preset leaves low bits out: its integers are multiples of 2^k, or the field's largest value.
 * Any SPZ reader accepts that, and entropy coders spend nothing on bits that are always 0.
 * Magnitude 0 has sign 0, because the signed integers of .drc have no negative zero. Source: the
 * SPZ format (Niantic, github.com/nianticlabs/spz), version 3.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/quant.h"
#include "codec/splat/quant_look.h"
#include "core/base.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define COLOR_SCALE 0.15f
#define SQRT2 1.41421356f
enum {
    POSITION_LIMIT = 1 << 23,
    MAGNITUDE_MAX = 511,
    FRAC_BITS_MAX = 22, /* 0.24 um: means are float32 */
    SIGMA_BINS = 1024,  /* of 1/16 in ln sigma, about 1 m */
    STEPS_MIN_LOG2 = 4, /* a position step is never coarser than a sixteenth of the median sigma */
};

static const struct {
    const char *name;
    struct quant_grid grid;
} presets[QUANT_PRESETS] = {
#define PRESET(id, name, about, position, scale, rotation, alpha, color, sh1, sh2, sh3, embed,     \
               degree, look)                                                                       \
    [QUANT_##id] = {                                                                               \
        name, {position, scale, rotation, alpha, color, {sh1, sh2, sh3}, embed, degree, look}},
#include "codec/splat/presets.def"
#undef PRESET
};

const struct quant_grid *quant_preset_grid(enum quant_preset p)
{
    return &presets[p].grid;
}

const char *quant_preset_name(enum quant_preset p)
{
    return presets[p].name;
}

enum err_code quant_alloc(struct quant *q, size_t n, uint32_t sh_degree, uint32_t embed_len,
                          struct err *e)
{
    *q = (struct quant){0};
    if (sh_degree > GAUSS_SH_DEGREE_MAX || embed_len > GAUSS_EMBED_MAX)
        return err_set(e, ERR_LIMIT, "quant: SH degree %u, embedding of %u: at most %d and %d",
                       sh_degree, embed_len, GAUSS_SH_DEGREE_MAX, GAUSS_EMBED_MAX);
    size_t sh = 3 * (gauss_sh_count(sh_degree) - 1);
    size_t row = 3 * sizeof *q->position + sizeof *q->rotation + 1 + 3 + 3 + sh + embed_len;
    uint8_t *p = q->block = mem_array(n, row);
    if (!p)
        return err_set(e, ERR_MEM, "quant: %zu Gaussians: out of memory", n);
    q->n = n;
    q->sh_degree = sh_degree;
    q->embed_len = embed_len;
    q->frac_bits = QUANT_FRAC_BITS;
    q->position = q->block;
    q->rotation = (uint32_t *)q->block + 3 * n;
    p += n * (3 * sizeof *q->position + sizeof *q->rotation);
    q->alpha = p;
    q->color = q->alpha + n;
    q->scale = q->color + 3 * n;
    q->sh = q->scale + 3 * n;
    q->embed = q->sh + sh * n;
    return ERR_OK;
}

void quant_free(struct quant *q)
{
    mem_free(q->block);
    *q = (struct quant){0};
}

/* ---- to integers: columns, so that the compiler makes vectors of them ---- */

/* Nearest multiple of 2^shift to v in 0..255; 256 becomes 255. */
static inline uint8_t quant_byte_at(float v, float per_step, int shift)
{
    float index = v * per_step + 0.5f; /* per_step = 2^-shift */
    index = index < 0 ? 0 : index > 256 ? 256 : index;
    int32_t byte = (int32_t)index << shift;
    return (uint8_t)(byte > 255 ? 255 : byte);
}

static inline int32_t quant_floor_i32(float v)
{
    int32_t i = (int32_t)v;
    return i - ((float)i > v);
}

static void quant_positions(const float *mean, size_t n, float scale, int shift, int32_t *out)
{
    for (size_t i = 0; i < n; i++) { /* powers of two: exact but for the one rounding */
        int32_t v = quant_floor_i32(mean[i] * scale + 0.5f);
        out[i] = (int32_t)((uint32_t)v << shift);
    }
}

static void quant_bytes(const float *in, size_t n, float gain, float offset, int shift,
                        uint8_t *out)
{
    const float per_step = 1 / (float)(1 << shift);
    for (size_t i = 0; i < n; i++)
        out[i] = quant_byte_at(in[i] * gain + offset, per_step, shift);
}

static uint32_t quant_largest_three(const float quat_wxyz[4], int shift)
{
    const float q[4] = {quat_wxyz[1], quat_wxyz[2], quat_wxyz[3], quat_wxyz[0]}; /* SPZ: x y z w */
    float a[4], sum = 0;
    for (int i = 0; i < 4; i++) {
        a[i] = fabsf(q[i]);
        sum += a[i] * a[i];
    }
    uint32_t largest = a[1] > a[0];
    largest = a[2] > a[largest] ? 2 : largest;
    largest = a[3] > a[largest] ? 3 : largest;
    const float steps = (float)MAGNITUDE_MAX * SQRT2 / sqrtf(sum) / (float)(1 << shift);
    uint32_t negate = q[largest] < 0, packed = largest;
    for (uint32_t i = 0; i < 4; i++) {
        if (i == largest)
            continue;
        uint32_t mag = (uint32_t)(a[i] * steps + 0.5f) << shift;
        mag = mag > MAGNITUDE_MAX ? MAGNITUDE_MAX : mag;
        packed = packed << 10 | (mag ? (uint32_t)(q[i] < 0) ^ negate : 0) << 9 | mag;
    }
    return packed;
}

uint32_t quant_pack_rotation(const float quat_wxyz[4])
{
    return quant_largest_three(quat_wxyz, 0);
}

/* Coefficients after DC of rows that may have more or fewer of them. */
static void quant_sh(const struct gauss *g, const uint8_t shift[3], struct quant *q)
{
    const size_t n_in = 3 * gauss_sh_count(g->sh_degree),
                 n_out = 3 * (gauss_sh_count(q->sh_degree) - 1),
                 n_both = n_in - 3 < n_out ? n_in - 3 : n_out;
    static const size_t end[4] = {0, 9, 24, 45};
    float per_step[3];
    for (int b = 0; b < 3; b++)
        per_step[b] = 1 / (float)(1 << shift[b]);
    for (size_t i = 0; i < q->n; i++) {
        const float *in = g->sh + i * n_in + 3;
        uint8_t *out = q->sh + i * n_out;
        for (int b = 0; b < 3 && end[b] < n_both; b++)
            for (size_t c = end[b]; c < end[b + 1]; c++)
                out[c] = quant_byte_at(in[c] * 128 + 128, per_step[b], shift[b]);
        for (size_t c = n_both; c < n_out; c++)
            out[c] = 128;
    }
}

static void quant_embed(const struct gauss *g, int shift, struct quant *q)
{
    size_t len = g->embed_len;
    const float per_step = 1 / (float)(1 << shift);
    for (size_t d = 0; d < len; d++) {
        float lo = g->n ? g->embed[d] : 0, hi = lo;
        for (size_t i = 1; i < g->n; i++) {
            float v = g->embed[i * len + d];
            lo = v < lo ? v : lo;
            hi = v > hi ? v : hi;
        }
        q->embed_min[d] = lo;
        q->embed_max[d] = hi;
        float steps = hi > lo ? 255 / (hi - lo) : 0;
        for (size_t i = 0; i < g->n; i++)
            q->embed[i * len + d] =
                quant_byte_at((g->embed[i * len + d] - lo) * steps, per_step, shift);
    }
}

/* log2 of the median over the rows of each one's middle sigma, in metres, to a sixteenth of ln: the
 * width of a needle, not its length, and the breadth of a disc, not its thickness. */
static double quant_sigma_log2(const struct gauss *g)
{
    uint32_t bins[SIGMA_BINS] = {0};
    for (size_t i = 0; i < g->n; i++) {
        const float *s = g->scale_log + 3 * i;
        float lo = s[0] < s[1] ? s[0] : s[1], hi = s[0] < s[1] ? s[1] : s[0];
        float m = (s[2] < lo ? lo : s[2] > hi ? hi : s[2]) * 16 + SIGMA_BINS / 2;
        bins[(int)(m < 0 ? 0 : m > SIGMA_BINS - 1 ? SIGMA_BINS - 1 : m)]++;
    }
    size_t seen = 0, at = 0;
    while (at < SIGMA_BINS - 1 && (seen += bins[at]) * 2 < g->n)
        at++;
    return ((double)at + 0.5 - SIGMA_BINS / 2) / 16 / 0.6931471805599453;
}

/* Does the farthest coordinate fit 24 bits, rounded to the step that is wanted? */
static bool quant_position_fits(float reach_m, long bits, long want)
{
    double step = bits > want ? ldexp(1, (int)(bits - want)) : 1;
    return ldexp((double)reach_m, (int)bits) + step / 2 < POSITION_LIMIT;
}

/* How positions are written: q->frac_bits for the file, and how many low bits of them are 0. A
 * preset asks for a step that is a part of the median sigma; without one it is 2^-12 m. More than
 * 12 bits are written only where they are asked for, fewer only where the range needs it. */
static enum err_code quant_choose_position(const struct gauss *g, const struct quant_grid *grid,
                                           struct quant *q, int *shift, struct err *e)
{
    float reach = 0;
    size_t row = 0;
    for (size_t i = 0; i < 3 * g->n; i++)
        if (fabsf(g->mean_m[i]) > reach) {
            reach = fabsf(g->mean_m[i]);
            row = i / 3;
        }
    const double sigma = quant_sigma_log2(g);
    long want = grid->position ? lround(grid->position - sigma) : QUANT_FRAC_BITS;
    want = want < 0 ? 0 : want > FRAC_BITS_MAX ? FRAC_BITS_MAX : want;
    long least = (long)ceil(STEPS_MIN_LOG2 - sigma), bits = want;
    least = least < 0 ? 0 : least > want ? want : least;
    bits = bits > QUANT_FRAC_BITS ? bits : QUANT_FRAC_BITS;
    while (bits > least && !quant_position_fits(reach, bits, want))
        bits--;
    if (!quant_position_fits(reach, bits, want))
        return err_set(e, ERR_LIMIT,
                       "quant: row %zu: %.1f m from the origin: 24 bits reach %.0f m at the "
                       "precision that Gaussians of %.2g m need ; cut the scene into tiles or move "
                       "the origin",
                       row, (double)reach, ldexp(POSITION_LIMIT, -(int)least), exp2(sigma));
    q->frac_bits = (uint32_t)bits;
    *shift = (int)(bits > want ? bits - want : 0);
    return ERR_OK;
}

static enum err_code quant_check_rows(const struct gauss *g, struct err *e)
{
    size_t bad;
    if (!gauss_count_bad(g, &bad))
        return ERR_OK;
    const float *q = g->quat_wxyz + 4 * bad;
    bool zero = q[0] == 0 && q[1] == 0 && q[2] == 0 && q[3] == 0;
    return err_set(e, ERR_DATA, "quant: row %zu: %s", bad,
                   zero ? "rotation quaternion is zero" : "not a finite number");
}

static float quant_area(const float ln[3])
{
    return expf(ln[0] + ln[1]) + expf(ln[0] + ln[2]) + expf(ln[1] + ln[2]);
}

/* The opacity with which the rounded sizes cover as much as the trained ones did. */
static float quant_same_mass(float opacity, const float scale_log[3], const uint8_t scale[3])
{
    float trained[3], rounded[3];
    for (int c = 0; c < 3; c++) {
        trained[c] = fminf(fmaxf(scale_log[c], -10), 255 / 16.0f - 10);
        rounded[c] = (float)scale[c] / 16 - 10;
    }
    return fminf(opacity * quant_area(trained) / quant_area(rounded), 1);
}

enum err_code quant_from_gauss(const struct gauss *g, uint32_t sh_degree,
                               const struct quant_grid *grid, struct quant *out, struct err *e)
{
    int shift = 0;
    if (!grid)
        grid = quant_preset_grid(QUANT_SPZ);
    uint32_t degree = sh_degree < grid->sh_degree ? sh_degree : grid->sh_degree;
    *out = (struct quant){0};
    enum err_code rc = quant_check_rows(g, e);
    if (!rc)
        rc = quant_alloc(out, g->n, degree, g->embed_len, e);
    if (!rc)
        rc = quant_choose_position(g, grid, out, &shift, e);
    if (rc) {
        quant_free(out);
        return rc;
    }
    const size_t n = g->n, k = 3 * gauss_sh_count(g->sh_degree);
    const float alpha_step = 1 / (float)(1 << grid->alpha),
                color_step = 1 / (float)(1 << grid->color);
    out->antialiased = g->antialiased;
    quant_positions(g->mean_m, 3 * n, ldexpf(1, (int)out->frac_bits - shift), shift, out->position);
    quant_bytes(g->scale_log, 3 * n, 16, 160, grid->scale, out->scale);
    for (size_t i = 0; i < n; i++) {
        float quat[4], opacity = 1 / (1 + expf(-g->opacity_logit[i]));
        memcpy(quat, g->quat_wxyz + 4 * i, sizeof quat);
        if (grid->look) {
            opacity = quant_same_mass(opacity, g->scale_log + 3 * i, out->scale + 3 * i);
            quant_look_turn(quat, out->scale + 3 * i);
        }
        out->alpha[i] = quant_byte_at(255 * opacity, alpha_step, grid->alpha);
        out->rotation[i] = quant_largest_three(quat, grid->rotation);
        for (size_t c = 0; c < 3; c++)
            out->color[3 * i + c] = quant_byte_at(g->sh[k * i + c] * (COLOR_SCALE * 255) + 127.5f,
                                                  color_step, grid->color);
    }
    if (grid->look)
        quant_look_colors(g, degree, grid->color, grid->sh, out->color, out->sh);
    else
        quant_sh(g, grid->sh, out);
    quant_embed(g, grid->embed, out);
    return ERR_OK;
}

/* ---- and back ---- */

void quant_unpack_rotation(uint32_t packed, float quat_wxyz[4])
{
    uint32_t largest = packed >> 30;
    float q[4], sum = 0;
    for (int i = 3; i >= 0; i--) {
        if ((uint32_t)i == largest)
            continue;
        float v = (float)(packed & 511) / (MAGNITUDE_MAX * SQRT2);
        sum += v * v;
        q[i] = packed >> 9 & 1 ? -v : v;
        packed >>= 10;
    }
    q[largest] = sqrtf(sum < 1 ? 1 - sum : 0);
    float norm = sqrtf(sum + q[largest] * q[largest]); /* 1, unless foreign fields exceed it */
    quat_wxyz[0] = q[3] / norm;
    quat_wxyz[1] = q[0] / norm;
    quat_wxyz[2] = q[1] / norm;
    quat_wxyz[3] = q[2] / norm;
}

enum err_code quant_to_gauss(const struct quant *q, struct gauss *out, struct err *e)
{
    enum err_code rc = gauss_alloc(out, q->n, q->sh_degree, q->embed_len, e);
    if (rc)
        return rc;
    const size_t k = gauss_sh_count(q->sh_degree), rest = 3 * (k - 1), len = q->embed_len;
    const float metre = ldexpf(1, -(int)q->frac_bits);
    float logit[256], sh_value[256];
    for (int v = 0; v < 256;
         v++) { /* 0 and 255 stand for a quarter step inside, so that logits are finite */
        double a = v == 0 ? 0.25 : v == 255 ? 254.75 : v;
        logit[v] = (float)log(a / (255 - a));
        sh_value[v] = (float)(v - 128) / 128;
    }
    out->n = q->n;
    out->antialiased = q->antialiased;
    for (size_t i = 0; i < q->n; i++) {
        for (size_t c = 0; c < 3; c++) {
            out->mean_m[3 * i + c] = (float)q->position[3 * i + c] * metre;
            out->scale_log[3 * i + c] = (float)q->scale[3 * i + c] / 16 - 10;
            out->sh[i * 3 * k + c] = ((float)q->color[3 * i + c] / 255 - 0.5f) / COLOR_SCALE;
        }
        out->opacity_logit[i] = logit[q->alpha[i]];
        quant_unpack_rotation(q->rotation[i], out->quat_wxyz + 4 * i);
        for (size_t c = 0; c < rest; c++)
            out->sh[i * 3 * k + 3 + c] = sh_value[q->sh[i * rest + c]];
        for (size_t d = 0; d < len; d++)
            out->embed[i * len + d] = q->embed_min[d] + (float)q->embed[i * len + d] / 255 *
                                                            (q->embed_max[d] - q->embed_min[d]);
    }
    return ERR_OK;
}
