/* SuperSplat's compressed .ply: 16 bytes a Gaussian, in chunks of 256 that share their ranges.
 *
 *     chunk   min_x .. max_z, min_scale_x .. max_scale_z (ln sigma), min_r .. max_b (optional,
 *             we always write them)
 *     vertex  packed_position 11-10-11, packed_rotation 2-10-10-10, packed_scale 11-10-11,
 *             packed_color 8-8-8-8
 *     sh      f_rest_k u8, channel-major: ((v + 0.5) / 256 - 0.5) * 8, with 0 and 255 exact
 *
 * The first field is in the high bits. Rotations leave out the largest of w x y z. Opacity is
 * linear. A position has 2048 steps in the box of its chunk, so rows that follow each other should
 * be close in space. Source: github.com/playcanvas/splat-transform.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/limits.h"
#include "codec/splat/ply.h"
#include "codec/splat/ply_head.h"
#include "core/splat/gauss.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { CHUNK = 256, N_PACKED = 4, N_RANGES = 18 };
static const char *const packed_names[N_PACKED] = {"packed_position", "packed_rotation",
                                                   "packed_scale", "packed_color"};
static const char *const range_names[N_RANGES] = {
    "min_x",       "min_y",       "min_z",       "max_x",       "max_y",       "max_z",
    "min_scale_x", "min_scale_y", "min_scale_z", "max_scale_x", "max_scale_y", "max_scale_z",
    "min_r",       "min_g",       "min_b",       "max_r",       "max_g",       "max_b"};

bool ply_packed_is(const struct ply_head *h)
{
    const struct ply_element *v = ply_head_element(h, "vertex");
    return v && ply_head_element(h, "chunk") && ply_head_property(v, packed_names[0]);
}

struct packed {
    const struct ply_head *head;
    const struct ply_element *chunk, *vertex, *sh;
    const struct ply_property *range[N_RANGES], *field[N_PACKED], *rest[45];
    bool has_color_range;
    size_t n_rest; /* per channel */
};

static enum err_code packed_find(const struct ply_head *h, struct packed *p, struct err *e)
{
    char name[16];
    size_t n = 0;
    *p = (struct packed){.head = h,
                         .chunk = ply_head_element(h, "chunk"),
                         .vertex = ply_head_element(h, "vertex"),
                         .sh = ply_head_element(h, "sh")};
    for (int i = 0; i < N_RANGES; i++)
        p->range[i] = ply_head_property(p->chunk, range_names[i]);
    for (int i = 0; i < N_PACKED; i++)
        p->field[i] = ply_head_property(p->vertex, packed_names[i]);
    for (int i = 0; i < 12; i++)
        if (!p->range[i])
            return err_set(e, ERR_FORMAT, "ply: property %s is missing", range_names[i]);
    for (int i = 0; i < N_PACKED; i++)
        if (!p->field[i] || p->field[i]->type != PLY_U32)
            return err_set(e, ERR_FORMAT, "ply: property %s is missing or no uint",
                           packed_names[i]);
    p->has_color_range = true;
    for (int i = 12; i < N_RANGES; i++)
        p->has_color_range = p->has_color_range && p->range[i];
    for (; p->sh && n < 45; n++) {
        snprintf(name, sizeof name, "f_rest_%zu", n);
        if (!(p->rest[n] = ply_head_property(p->sh, name)))
            break;
    }
    p->n_rest = n / 3;
    if (n != 0 && n != 9 && n != 24 && n != 45)
        return err_set(e, ERR_FORMAT,
                       "ply: %zu f_rest properties: 0, 9, 24 or 45 make whole SH degrees", n);
    if (!p->chunk->rows || !p->vertex->rows || (p->sh && !p->sh->rows))
        return err_set(e, ERR_FORMAT, "ply: a compressed file must be binary, without lists");
    if (p->chunk->count < (p->vertex->count + CHUNK - 1) / CHUNK ||
        (p->sh && p->sh->count < p->vertex->count))
        return err_set(e, ERR_FORMAT, "ply: %zu chunks, %zu sh rows: too few for %zu Gaussians",
                       p->chunk->count, p->sh ? p->sh->count : 0, p->vertex->count);
    return ERR_OK;
}

/* Fields of 11, 10 and 11 bits into ranges lo[3], lo[3 + 3..]. */
static void packed_unpack3(uint32_t v, const float range[6], float out[3])
{
    const float t[3] = {(float)(v >> 21) / 2047, (float)(v >> 11 & 1023) / 1023,
                        (float)(v & 2047) / 2047};
    for (int c = 0; c < 3; c++)
        out[c] = range[c] * (1 - t[c]) + range[3 + c] * t[c];
}

static void packed_unpack_rotation(uint32_t v, float wxyz[4])
{
    uint32_t largest = v >> 30;
    float sum = 0;
    int shift = 20;
    for (uint32_t i = 0; i < 4; i++) {
        if (i == largest)
            continue;
        wxyz[i] = ((float)(v >> shift & 1023) / 1023 - 0.5f) * 1.41421356f;
        sum += wxyz[i] * wxyz[i];
        shift -= 10;
    }
    wxyz[largest] = sqrtf(sum < 1 ? 1 - sum : 0);
}

static void packed_row_read(const struct packed *p, const float range[N_RANGES], size_t i,
                            struct gauss *g)
{
    const uint8_t *row = p->vertex->rows + i * p->vertex->row_bytes;
    const size_t k = gauss_sh_count(g->sh_degree);
    float *sh = g->sh + 3 * k * i;
    uint32_t field[N_PACKED];
    for (int f = 0; f < N_PACKED; f++)
        field[f] = (uint32_t)ply_head_value(p->head, p->field[f], row);
    packed_unpack3(field[0], range, g->mean_m + 3 * i);
    packed_unpack_rotation(field[1], g->quat_wxyz + 4 * i);
    packed_unpack3(field[2], range + 6, g->scale_log + 3 * i);
    for (int c = 0; c < 3; c++) {
        float t = (float)(field[3] >> (24 - 8 * c) & 255) / 255;
        float color = p->has_color_range ? range[12 + c] * (1 - t) + range[15 + c] * t : t;
        sh[c] = (color - 0.5f) / (float)GAUSS_SH_C0;
    }
    float a = (float)(field[3] & 255);
    a = a < 0.25f ? 0.25f : a > 254.75f ? 254.75f : a; /* finite logits */
    g->opacity_logit[i] = logf(a / (255 - a));
    const uint8_t *rest = p->n_rest ? p->sh->rows + i * p->sh->row_bytes : NULL;
    for (size_t c = 0; c < 3; c++)
        for (size_t r = 0; rest && r < p->n_rest; r++) {
            float v = (float)ply_head_value(p->head, p->rest[c * p->n_rest + r], rest);
            float t = v == 0 ? 0 : v == 255 ? 1 : (v + 0.5f) / 256;
            sh[3 * (r + 1) + c] = (t - 0.5f) * 8;
        }
}

enum err_code ply_packed_read(const struct ply_head *h, const struct codec_limits *lim,
                              struct gauss *out, struct err *e)
{
    struct packed p;
    float range[N_RANGES] = {0};
    size_t most = lim && lim->max_gaussians ? lim->max_gaussians : CODEC_MAX_GAUSSIANS;
    enum err_code rc = packed_find(h, &p, e);
    if (!rc && p.vertex->count > most)
        rc = err_set(e, ERR_LIMIT, "ply: %zu Gaussians: the limit is %zu", p.vertex->count, most);
    if (!rc)
        rc = gauss_alloc(out, p.vertex->count,
                         p.n_rest >= 15  ? 3
                         : p.n_rest >= 8 ? 2
                                         : p.n_rest >= 3,
                         0, e);
    if (rc)
        return rc;
    out->n = p.vertex->count;
    out->antialiased = h->antialiased;
    for (size_t i = 0; i < out->n; i++) {
        for (int r = 0; i % CHUNK == 0 && r < N_RANGES; r++)
            range[r] = p.range[r]
                           ? (float)ply_head_value(h, p.range[r],
                                                   p.chunk->rows + i / CHUNK * p.chunk->row_bytes)
                           : 0;
        packed_row_read(&p, range, i, out);
    }
    rc = gauss_keep_good(out, "ply", e);
    if (rc)
        gauss_free(out);
    return rc;
}

/* ---- writing ---- */

static const float SCALE_LOG_REACH =
    20; /* beyond, a flat Gaussian would cost its chunk its steps */

static void packed_head_write(const struct gauss *g, size_t n_rest, const struct ply_info *info,
                              struct buf *out)
{
    ply_head_comments(info, g->antialiased, out);
    buf_printf(out, "element chunk %zu\n", (g->n + CHUNK - 1) / CHUNK);
    for (int i = 0; i < N_RANGES; i++)
        buf_printf(out, "property float %s\n", range_names[i]);
    buf_printf(out, "element vertex %zu\n", g->n);
    for (int i = 0; i < N_PACKED; i++)
        buf_printf(out, "property uint %s\n", packed_names[i]);
    if (n_rest)
        buf_printf(out, "element sh %zu\n", g->n);
    for (size_t i = 0; i < 3 * n_rest; i++)
        buf_printf(out, "property uchar f_rest_%zu\n", i);
    buf_printf(out, "end_header\n");
}

/* What of a row lies in ranges: position, ln sigma, colour. */
static void packed_row_values(const struct gauss *g, size_t i, float out[9])
{
    const float *sh = g->sh + 3 * gauss_sh_count(g->sh_degree) * i;
    for (size_t c = 0; c < 3; c++) {
        float ln = g->scale_log[3 * i + c];
        out[c] = (float)((double)g->mean_m[3 * i + c] + g->origin_enu_m[c]);
        out[3 + c] = fminf(fmaxf(ln, -SCALE_LOG_REACH), SCALE_LOG_REACH);
        out[6 + c] = sh[c] * (float)GAUSS_SH_C0 + 0.5f;
    }
}

/* min[3], max[3] of positions, of scales, of colours: range_names' order. */
static void packed_ranges(const struct gauss *g, size_t first, size_t n, float range[N_RANGES])
{
    for (size_t i = first; i < first + n; i++) {
        float v[9];
        packed_row_values(g, i, v);
        for (size_t c = 0; c < 9; c++) {
            float *lo = range + c / 3 * 6 + c % 3, *hi = lo + 3;
            *lo = i == first || v[c] < *lo ? v[c] : *lo;
            *hi = i == first || v[c] > *hi ? v[c] : *hi;
        }
    }
}

/* The nearest of `most` + 1 steps from 0 to 1. */
static uint32_t packed_step(double t, uint32_t most)
{
    return !(t > 0) ? 0 : t >= 1 ? most : (uint32_t)(t * most + 0.5);
}

static uint32_t packed_within(float v, const float *lo, const float *hi, uint32_t most)
{
    double width = (double)*hi - (double)*lo;
    return width > 0 ? packed_step(((double)v - (double)*lo) / width, most) : 0;
}

static uint32_t packed_pack3(const float v[3], const float range[6])
{
    return packed_within(v[0], range, range + 3, 2047) << 21 |
           packed_within(v[1], range + 1, range + 4, 1023) << 11 |
           packed_within(v[2], range + 2, range + 5, 2047);
}

static uint32_t packed_pack_rotation(const float wxyz[4])
{
    uint32_t largest = 0, out;
    double norm = 0;
    for (uint32_t c = 0; c < 4; c++) {
        norm += (double)wxyz[c] * (double)wxyz[c];
        largest = fabsf(wxyz[c]) > fabsf(wxyz[largest]) ? c : largest;
    }
    norm = copysign(sqrt(norm), (double)wxyz[largest]);
    out = largest;
    for (uint32_t c = 0; c < 4; c++)
        if (c != largest)
            out = out << 10 | packed_step((double)wxyz[c] / norm * M_SQRT1_2 + 0.5, 1023);
    return out;
}

static void packed_row_write(const struct gauss *g, size_t i, const float range[N_RANGES],
                             struct buf *out)
{
    float v[9];
    packed_row_values(g, i, v);
    uint32_t color = packed_step(1 / (1 + exp(-(double)g->opacity_logit[i])), 255);
    for (int c = 0; c < 3; c++)
        color |= packed_within(v[6 + c], range + 12 + c, range + 15 + c, 255) << (24 - 8 * c);
    buf_u32(out, packed_pack3(v, range));
    buf_u32(out, packed_pack_rotation(g->quat_wxyz + 4 * i));
    buf_u32(out, packed_pack3(v + 3, range + 6));
    buf_u32(out, color);
}

static void packed_harmonics_write(const struct gauss *g, size_t i, size_t n_rest, struct buf *out)
{
    const float *sh = g->sh + 3 * gauss_sh_count(g->sh_degree) * i;
    for (size_t c = 0; c < 3; c++)
        for (size_t r = 1; r <= n_rest; r++) {
            double t = 256 * ((double)sh[3 * r + c] / 8 + 0.5);
            buf_u8(out, !(t > 0) ? 0 : t >= 255 ? 255 : (unsigned)t);
        }
}

enum err_code ply_packed_encode(const struct gauss *g, uint32_t sh_degree,
                                const struct ply_info *info, struct buf *out, struct err *e)
{
    const size_t start = out->size;
    size_t bad = 0, n_rest = gauss_sh_count(sh_degree) - 1;
    if (sh_degree > g->sh_degree)
        return err_set(e, ERR_ARG, "ply: degree %u of Gaussians of degree %u", sh_degree,
                       g->sh_degree);
    if (gauss_count_bad(g, &bad))
        return err_set(e, ERR_DATA, "ply: row %zu: not finite, or no rotation", bad);
    packed_head_write(g, n_rest, info, out);
    float *range = mem_array((g->n + CHUNK - 1) / CHUNK + 1, N_RANGES * sizeof *range);
    if (!range)
        return out->size = start, err_set(e, ERR_MEM, "ply: %zu Gaussians: out of memory", g->n);
    for (size_t i = 0; i < g->n; i += CHUNK) {
        float *r = range + i / CHUNK * N_RANGES;
        packed_ranges(g, i, g->n - i < CHUNK ? g->n - i : CHUNK, r);
        for (int k = 0; k < N_RANGES; k++)
            buf_f32(out, r[k]);
    }
    for (size_t i = 0; i < g->n; i++)
        packed_row_write(g, i, range + i / CHUNK * N_RANGES, out);
    for (size_t i = 0; i < g->n && n_rest; i++)
        packed_harmonics_write(g, i, n_rest, out);
    mem_free(range);
    enum err_code rc = buf_check(out, e);
    if (rc)
        out->size = start;
    return rc;
}
