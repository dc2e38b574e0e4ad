/* SuperSplat's compressed .ply: 16 bytes a Gaussian, in chunks of 256 that share their ranges.
 * Import only.
 *
 *   chunk   min_x .. max_z, min_scale_x .. max_scale_z (ln sigma), optionally min_r .. max_b
 *   vertex  packed_position 11-10-11, packed_rotation 2-10-10-10, packed_scale 11-10-11,
 *           packed_color 8-8-8-8
 *   sh      f_rest_k u8, channel-major: ((v + 0.5) / 256 - 0.5) * 8, with 0 and 255 exact
 *
 * The first field is in the high bits. Rotations leave out the largest of w x y z; opacity is
 * linear. Source: github.com/playcanvas/splat-transform.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/limits.h"
#include "codec/ply_head.h"
#include "core/gauss.h"

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
            return err_set(e, ERR_FORMAT, "ply : property %s is missing", range_names[i]);
    for (int i = 0; i < N_PACKED; i++)
        if (!p->field[i] || p->field[i]->type != PLY_U32)
            return err_set(e, ERR_FORMAT, "ply : property %s is missing or no uint",
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
                       "ply : %zu f_rest properties : 0, 9, 24 or 45 make whole SH degrees", n);
    if (!p->chunk->rows || !p->vertex->rows || (p->sh && !p->sh->rows))
        return err_set(e, ERR_FORMAT, "ply : a compressed file must be binary, without lists");
    if (p->chunk->count < (p->vertex->count + CHUNK - 1) / CHUNK ||
        (p->sh && p->sh->count < p->vertex->count))
        return err_set(e, ERR_FORMAT, "ply : %zu chunks, %zu sh rows : too few for %zu Gaussians",
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
    size_t most = lim && lim->max_gaussians ? lim->max_gaussians : CODEC_MAX_GAUSSIANS, bad = 0;
    enum err_code rc = packed_find(h, &p, e);
    if (!rc && p.vertex->count > most)
        rc = err_set(e, ERR_LIMIT, "ply : %zu Gaussians : the limit is %zu", p.vertex->count, most);
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
    if (gauss_count_bad(out, &bad)) {
        rc = err_set(e, ERR_DATA, "ply : row %zu : not finite, or no rotation", bad);
        gauss_free(out);
    }
    return rc;
}
