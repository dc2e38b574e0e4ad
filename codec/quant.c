/* The one quantiser: the integers of SPZ v3, which .spz, the SPZ payload of .glb and .drc all
 * carry, so that every client draws the same picture and a test can compare files bit for bit.
 *
 *   position  round(p * 4096), 24 bits         alpha  round(255 * opacity)
 *   color     round(dc * 0.15 * 255 + 127.5)   scale  round((ln(sigma) + 10) * 16)
 *   rotation  index of the largest component << 30 | three 10-bit fields (sign, 9-bit magnitude)
 *   sh        round(128 c) + 128, snapped to steps of 8 (first band) or 16
 *
 * Magnitude 0 has sign 0: a negative zero would not survive the signed integers of .drc.
 * Source: the SPZ format (Niantic, github.com/nianticlabs/spz), version 3.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/codec.h"

#include <math.h>
#include <string.h>

#define POSITION_STEPS 4096.0f /* a metre */
#define COLOR_SCALE 0.15f
#define SQRT2 1.41421356f
enum { POSITION_MAX = (1 << 23) - 1, MAGNITUDE_MAX = 511 };

enum err_code quant_alloc(struct quant *q, size_t n, uint32_t sh_degree, uint32_t embed_len,
                          struct err *e)
{
    *q = (struct quant){0};
    if (sh_degree > GAUSS_SH_DEGREE_MAX || embed_len > GAUSS_EMBED_MAX)
        return err_set(e, ERR_LIMIT, "quant : SH degree %u, embedding of %u : at most %d and %d",
                       sh_degree, embed_len, GAUSS_SH_DEGREE_MAX, GAUSS_EMBED_MAX);
    size_t sh = 3 * (gauss_sh_count(sh_degree) - 1);
    size_t row = 3 * sizeof *q->position + sizeof *q->rotation + 1 + 3 + 3 + sh + embed_len;
    uint8_t *p = q->block = mem_array(n, row);
    if (!p)
        return err_set(e, ERR_MEM, "quant : %zu Gaussians : out of memory", n);
    q->n = n;
    q->sh_degree = sh_degree;
    q->embed_len = embed_len;
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

static uint8_t clamp8(float v)
{
    return (uint8_t)(v <= 0 ? 0 : v >= 255 ? 255 : v);
}

static int32_t round_i32(float v) /* half away from zero; |v| is small */
{
    return (int32_t)(v < 0 ? v - 0.5f : v + 0.5f);
}

uint32_t quant_pack_rotation(const float quat_wxyz[4])
{
    const float q[4] = {quat_wxyz[1], quat_wxyz[2], quat_wxyz[3], quat_wxyz[0]}; /* SPZ: x y z w */
    float norm = sqrtf(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    uint32_t largest = 0;
    for (uint32_t i = 1; i < 4; i++)
        if (fabsf(q[i]) > fabsf(q[largest]))
            largest = i;
    bool negate = q[largest] < 0;
    uint32_t packed = largest;
    for (uint32_t i = 0; i < 4; i++) {
        if (i == largest)
            continue;
        uint32_t mag = (uint32_t)(MAGNITUDE_MAX * (fabsf(q[i]) / norm * SQRT2) + 0.5f);
        mag = mag > MAGNITUDE_MAX ? MAGNITUDE_MAX : mag;
        packed = packed << 10 | (uint32_t)(mag && (q[i] < 0) != negate) << 9 | mag;
    }
    return packed;
}

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

static uint8_t quant_sh(float c, int step)
{
    float v = c < -2  ? -2
              : c > 2 ? 2
                      : c; /* beyond the byte's range already; keeps the integer small */
    int byte = round_i32(v * 128) + 128;
    int bucket = (byte + step / 2) / step; /* byte < 0 ends in 0 below either way */
    return clamp8((float)(bucket * step));
}

/* Sums that are finite only if every value is: one test a row instead of sixty. */
static bool row_is_finite(const struct gauss *g, size_t i, size_t n_sh)
{
    float sum = g->opacity_logit[i] * 0.0f;
    for (size_t c = 0; c < 3; c++)
        sum += g->mean_m[3 * i + c] * 0.0f + g->scale_log[3 * i + c] * 0.0f;
    for (size_t c = 0; c < 4; c++)
        sum += g->quat_wxyz[4 * i + c] * 0.0f;
    for (size_t c = 0; c < n_sh; c++)
        sum += g->sh[i * n_sh + c] * 0.0f;
    for (size_t c = 0; c < g->embed_len; c++)
        sum += g->embed[i * g->embed_len + c] * 0.0f;
    return sum == 0.0f;
}

static enum err_code quant_row(const struct gauss *g, size_t i, struct quant *q, struct err *e)
{
    const size_t n_in = 3 * gauss_sh_count(g->sh_degree),
                 n_out = 3 * (gauss_sh_count(q->sh_degree) - 1);
    const float *quat = g->quat_wxyz + 4 * i, *sh = g->sh + i * n_in;
    if (!row_is_finite(g, i, n_in))
        return err_set(e, ERR_DATA, "quant : row %zu : not a finite number", i);
    if (!(quat[0] * quat[0] + quat[1] * quat[1] + quat[2] * quat[2] + quat[3] * quat[3] > 1e-30f))
        return err_set(e, ERR_DATA, "quant : row %zu : rotation quaternion is zero", i);
    for (size_t c = 0; c < 3; c++) {
        float p = g->mean_m[3 * i + c];
        float v = p * POSITION_STEPS; /* exact: a power of two */
        if (!(fabsf(v) < POSITION_MAX + 0.5f))
            return err_set(
                e, ERR_LIMIT,
                "quant : row %zu : mean %.1f m from the tile's origin : at most 2048 m fit, "
                "cut the scene into tiles or move the origin",
                i, (double)p);
        q->position[3 * i + c] = (int32_t)lrintf(v);
        q->color[3 * i + c] = clamp8(sh[c] * (COLOR_SCALE * 255) + 127.5f + 0.5f);
        q->scale[3 * i + c] = clamp8((g->scale_log[3 * i + c] + 10) * 16 + 0.5f);
    }
    q->alpha[i] = clamp8(255 / (1 + expf(-g->opacity_logit[i])) + 0.5f);
    q->rotation[i] = quant_pack_rotation(quat);
    size_t n_both = n_in - 3 < n_out ? n_in - 3 : n_out;
    for (size_t c = 0; c < n_both; c++)
        q->sh[i * n_out + c] = quant_sh(sh[3 + c], c < 9 ? 8 : 16);
    for (size_t c = n_both; c < n_out; c++)
        q->sh[i * n_out + c] = 128;
    return ERR_OK;
}

static void quant_embed(const struct gauss *g, struct quant *q)
{
    size_t len = g->embed_len;
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
            q->embed[i * len + d] = clamp8((g->embed[i * len + d] - lo) * steps + 0.5f);
    }
}

enum err_code quant_from_gauss(const struct gauss *g, uint32_t sh_degree, struct quant *out,
                               struct err *e)
{
    enum err_code rc = quant_alloc(out, g->n, sh_degree, g->embed_len, e);
    for (size_t i = 0; rc == ERR_OK && i < g->n; i++)
        rc = quant_row(g, i, out, e);
    if (rc != ERR_OK) {
        quant_free(out);
        return rc;
    }
    out->antialiased = g->antialiased;
    quant_embed(g, out);
    return ERR_OK;
}

enum err_code quant_to_gauss(const struct quant *q, struct gauss *out, struct err *e)
{
    enum err_code rc = gauss_alloc(out, q->n, q->sh_degree, q->embed_len, e);
    if (rc != ERR_OK)
        return rc;
    const size_t k = gauss_sh_count(q->sh_degree), rest = 3 * (k - 1), len = q->embed_len;
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
            out->mean_m[3 * i + c] = (float)q->position[3 * i + c] / POSITION_STEPS;
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
