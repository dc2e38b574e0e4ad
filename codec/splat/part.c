/* What a Gaussian shows is estimated as its opacity times the area of its shadow, as a mean over
 * all directions. By that measure five eighths of the Gaussians of trained cities make 0.94 to 0.96
 * of the picture (SSIM). No other measure that was tried exceeds it by more than 0.02 (decision
 * 098).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/part.h"

#include <math.h>
#include <string.h>

#include "codec/splat/quant.h"
#include "core/base.h"
#include "core/math/sort.h"

size_t part_first(size_t n)
{
    return n < PART_LEAST ? n : (n * 5 / 8 + PART_ROWS - 1) / PART_ROWS * PART_ROWS;
}

static void part_weigh(const struct quant *q, float *out)
{
    float sigma[256];
    for (int v = 0; v < 256; v++)
        sigma[v] = (float)exp(v / 16.0 - 10);
    for (size_t i = 0; i < q->n; i++) {
        const uint8_t *s = q->scale + 3 * i;
        const float a = sigma[s[0]], b = sigma[s[1]], c = sigma[s[2]];
        out[i] = (float)q->alpha[i] * (a * b + a * c + b * c);
    }
}

/* Writes the rows of the part, ascending. `weight` and `scratch` have q->n numbers. */
static void part_choose(const struct quant *q, uint32_t part, size_t first, float *weight,
                        float *scratch, uint32_t *rows)
{
    part_weigh(q, weight);
    memcpy(scratch, weight, q->n * sizeof *weight);
    const float least = sort_select(scratch, q->n, q->n - first); /* of the first part */
    size_t equal = first, n = 0; /* of those that weigh `least`, so many are in the first part */
    for (size_t i = 0; i < q->n; i++)
        equal -= weight[i] > least;
    for (size_t i = 0; i < q->n; i++) {
        bool in_first = weight[i] > least;
        if (weight[i] == least && equal) {
            in_first = true;
            equal--;
        }
        if (in_first == (part == 1))
            rows[n++] = (uint32_t)i;
    }
}

static void part_copy(const struct quant *q, const uint32_t *rows, struct quant *out)
{
    const size_t sh = 3 * (gauss_sh_count(q->sh_degree) - 1), len = q->embed_len;
    for (size_t i = 0; i < out->n; i++) {
        const size_t r = rows[i];
        memcpy(out->position + 3 * i, q->position + 3 * r, 3 * sizeof *q->position);
        memcpy(out->color + 3 * i, q->color + 3 * r, 3);
        memcpy(out->scale + 3 * i, q->scale + 3 * r, 3);
        memcpy(out->sh + sh * i, q->sh + sh * r, sh);
        memcpy(out->embed + len * i, q->embed + len * r, len);
        out->alpha[i] = q->alpha[r];
        out->rotation[i] = q->rotation[r];
    }
    memcpy(out->embed_min, q->embed_min, sizeof q->embed_min);
    memcpy(out->embed_max, q->embed_max, sizeof q->embed_max);
    out->frac_bits = q->frac_bits;
    out->antialiased = q->antialiased;
}

enum err_code part_take(const struct quant *q, uint32_t part, struct quant *out, struct err *e)
{
    *out = (struct quant){0};
    const size_t first = part_first(q->n), n = part == 1 ? first : q->n - first;
    if (part > 1 && !n)
        return err_set(e, ERR_NOENT, "a tile of %zu Gaussians is one part", q->n);
    float *weight = mem_array(q->n + !q->n, 2 * sizeof *weight);
    uint32_t *rows = mem_array(n + !n, sizeof *rows);
    if (!weight || !rows) {
        mem_free(weight);
        mem_free(rows);
        return err_set(e, ERR_MEM, "part: %zu Gaussians: out of memory", q->n);
    }
    enum err_code rc = quant_alloc(out, n, q->sh_degree, q->embed_len, e);
    if (!rc && first == q->n)
        for (size_t i = 0; i < n; i++)
            rows[i] = (uint32_t)i;
    else if (!rc)
        part_choose(q, part, first, weight, weight + q->n, rows);
    if (!rc) {
        part_copy(q, rows, out);
        out->rest = part == 1 ? q->n - first : 0;
    }
    mem_free(weight);
    mem_free(rows);
    return rc;
}
