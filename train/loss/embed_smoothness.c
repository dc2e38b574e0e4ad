/* The smoothness loss on appearance embeddings: neighbours in space should react alike to light and
 * season.
 *
 * M Gaussians are drawn at random. For each, all pairs (a, b) of its k nearest Gaussians (itself
 * included) count, with b the farther one: w_b (1 - cos of the angle between their embeddings). It
 * runs on the host, every 50th step: a k-d tree over all means, then groups in parallel. Gradients
 * of groups are stored separately and added in order, so the sum does not depend on threads. All
 * sums are in double. Weights and groups have no gradient. Source: REUrbanGS (2025).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "core/base.h"
#include "core/layout.h"
#include "core/math/knn.h"
#include "core/math/sample.h"
#include "core/pool.h"
#include "train/loss/embed_smoothness.h"

#define EMBED_SMOOTHNESS_LENGTH_MIN 1e-12
enum {
    EMBED_SMOOTHNESS_CHUNK = 256,
    EMBED_SMOOTHNESS_EMBED_MAX = GAUSS_EMBED_MAX,
    EMBED_SMOOTHNESS_LANES = LAYOUT_LANES
};

struct embed_smoothness {
    struct embed_smoothness_input in;
    struct knn tree;
    uint32_t *chosen, *ids; /* [samples], [samples][k] */
    float *grad;            /* [samples][k][len], with respect to the unit embeddings */
    double *loss;           /* [samples] */
    size_t *found;          /* [samples] */
    size_t samples, k;
    double scale;           /* of the gradients */
    uint32_t *first, *part; /* rows: parts of row i are part[first[i]] .. part[first[i + 1] - 1],
                             * indices into ids, ascending */
};

/* v / max(|v|, 1e-12) of a row; returns the divisor. */
static double embed_smoothness_unit(const struct embed_smoothness_input *in, size_t row,
                                    double *out)
{
    const float *v = in->embed + row / EMBED_SMOOTHNESS_LANES * in->embed_group +
                     row % EMBED_SMOOTHNESS_LANES * in->embed_lane;
    double sum = 0.0;
    for (size_t c = 0; c < in->len; c++) {
        out[c] = (double)v[c * in->embed_next];
        sum += out[c] * out[c];
    }
    double len = fmax(sqrt(sum), EMBED_SMOOTHNESS_LENGTH_MIN);
    for (size_t c = 0; c < in->len; c++)
        out[c] /= len;
    return len;
}

/* One group: sum over a < b of w_b (1 - a.b), by prefix sums forth and suffix sums back. */
static void embed_smoothness_group(struct embed_smoothness *w, size_t sample)
{
    const struct embed_smoothness_input *in = &w->in;
    double unit[KNN_MAX][EMBED_SMOOTHNESS_EMBED_MAX], sum[EMBED_SMOOTHNESS_EMBED_MAX] = {0};
    double weight[KNN_MAX];
    float dist2[KNN_MAX];
    uint32_t *ids = w->ids + sample * w->k;
    float *grad = w->grad + sample * w->k * in->len;
    size_t n = knn_find(&w->tree, in->mean_m + 3 * (size_t)w->chosen[sample], KNN_NOBODY, w->k, ids,
                        dist2);
    w->found[sample] = n;
    for (size_t b = 0; b < n; b++) {
        double dot = 0.0;
        (void)embed_smoothness_unit(in, ids[b], unit[b]);
        weight[b] = exp(-in->falloff * (double)dist2[b]);
        for (size_t c = 0; c < in->len; c++) {
            dot += sum[c] * unit[b][c];
            grad[b * in->len + c] = (float)(-weight[b] * sum[c]);
            sum[c] += unit[b][c];
        }
        w->loss[sample] += weight[b] * ((double)b - dot);
    }
    memset(sum, 0, sizeof sum);
    for (size_t a = n; a-- > 0;)
        for (size_t c = 0; c < in->len; c++) {
            grad[a * in->len + c] -= (float)sum[c];
            sum[c] += weight[a] * unit[a][c];
        }
}

static enum err_code embed_smoothness_chunk(void *user, size_t chunk, struct err *e)
{
    (void)e;
    struct embed_smoothness *w = user;
    size_t end = (chunk + 1) * EMBED_SMOOTHNESS_CHUNK;
    for (size_t i = chunk * EMBED_SMOOTHNESS_CHUNK; i < end && i < w->samples; i++)
        embed_smoothness_group(w, i);
    return ERR_OK;
}

static enum err_code embed_smoothness_draw(struct embed_smoothness *w, struct err *e)
{
    const struct embed_smoothness_input *in = &w->in;
    uint32_t *all = mem_array(in->n, sizeof *all);
    if (!all)
        return err_set(e, ERR_MEM, "embed_smoothness: out of memory for %zu Gaussians", in->n);
    for (size_t i = 0; i < in->n; i++)
        all[i] = (uint32_t)i;
    enum err_code rc =
        sample_race(NULL, all, in->n, w->samples, in->seed, in->stream, w->chosen, e);
    mem_free(all);
    return rc;
}

/* Which groups have a part in each row, in their order. */
static enum err_code embed_smoothness_index(struct embed_smoothness *w, struct err *e)
{
    size_t n = w->in.n;
    w->first = mem_array(n + 2, sizeof *w->first);
    w->part = mem_array(w->samples * w->k, sizeof *w->part);
    if (!w->first || !w->part)
        return err_set(e, ERR_MEM, "embed_smoothness: out of memory for %zu Gaussians", n);
    for (size_t s = 0; s < w->samples; s++)
        for (size_t a = 0; a < w->found[s]; a++)
            w->first[w->ids[s * w->k + a] + 2]++;
    for (size_t i = 2; i < n + 2; i++)
        w->first[i] += w->first[i - 1];
    for (size_t s = 0; s < w->samples; s++) /* [i + 1] walks from the first part to the last */
        for (size_t a = 0; a < w->found[s]; a++)
            w->part[w->first[w->ids[s * w->k + a] + 1]++] = (uint32_t)(s * w->k + a);
    return ERR_OK;
}

/* Add the groups up, in order, and go back through the normalisation. Rows in no group have 0. */
void embed_smoothness_rows(const struct embed_smoothness *w, size_t first, size_t count,
                           float *grad)
{
    const struct embed_smoothness_input *in = &w->in;
    memset(grad, 0, count * in->len * sizeof *grad);
    for (size_t i = first; w->first && i < first + count; i++, grad += in->len) {
        double unit[EMBED_SMOOTHNESS_EMBED_MAX], sum[EMBED_SMOOTHNESS_EMBED_MAX] = {0}, along = 0.0;
        if (w->first[i] == w->first[i + 1])
            continue;
        for (uint32_t k = w->first[i]; k < w->first[i + 1]; k++)
            for (size_t c = 0; c < in->len; c++)
                sum[c] += (double)w->grad[w->part[k] * in->len + c];
        double len = embed_smoothness_unit(in, i, unit);
        for (size_t c = 0; c < in->len; c++)
            along += unit[c] * sum[c];
        for (size_t c = 0; c < in->len; c++)
            grad[c] = (float)(w->scale * (sum[c] - unit[c] * along) / len);
    }
}

void embed_smoothness_close(struct embed_smoothness **p)
{
    struct embed_smoothness *w = *p;
    if (!w)
        return;
    knn_free(&w->tree);
    mem_free(w->chosen);
    mem_free(w->ids);
    mem_free(w->grad);
    mem_free(w->loss);
    mem_free(w->found);
    mem_free(w->first);
    mem_free(w->part);
    mem_free(w);
    *p = NULL;
}

static enum err_code embed_smoothness_groups(struct embed_smoothness *w, struct err *e)
{
    const struct embed_smoothness_input *in = &w->in;
    w->samples = in->samples < in->n ? in->samples : in->n;
    w->k = in->neighbours < in->n ? in->neighbours : in->n;
    if (w->samples > UINT32_MAX / w->k)
        return err_set(e, ERR_LIMIT, "embed_smoothness: %zu groups of %zu are more than 2^32",
                       w->samples, w->k);
    w->chosen = mem_array(w->samples, sizeof *w->chosen);
    enum err_code rc = w->chosen ? embed_smoothness_draw(w, e)
                                 : err_set(e, ERR_MEM, "embed_smoothness: out of memory");
    if (!rc)
        rc = knn_build(in->mean_m, in->n, &w->tree, e);
    if (rc)
        return rc;
    w->ids = mem_array(w->samples * w->k, sizeof *w->ids);
    w->grad = mem_array(w->samples * w->k, in->len * sizeof *w->grad);
    w->loss = mem_array(w->samples, sizeof *w->loss);
    w->found = mem_array(w->samples, sizeof *w->found);
    if (!w->ids || !w->grad || !w->loss || !w->found)
        return err_set(e, ERR_MEM, "embed_smoothness: out of memory for %zu groups", w->samples);
    rc = pool_for((w->samples + EMBED_SMOOTHNESS_CHUNK - 1) / EMBED_SMOOTHNESS_CHUNK, 0,
                  embed_smoothness_chunk, w, e);
    knn_free(&w->tree);
    return rc ? rc : embed_smoothness_index(w, e);
}

enum err_code embed_smoothness_open(const struct embed_smoothness_input *in,
                                    struct embed_smoothness **out, double *loss, struct err *e)
{
    *loss = 0.0;
    *out = NULL;
    if (in->len < 1 || in->len > EMBED_SMOOTHNESS_EMBED_MAX || in->neighbours < 2 ||
        in->neighbours > KNN_MAX)
        return err_set(
            e, ERR_ARG,
            "embed_smoothness: %zu neighbours, embeddings of %zu: 2 to %d, 1 to %d are possible",
            in->neighbours, in->len, KNN_MAX, EMBED_SMOOTHNESS_EMBED_MAX);
    struct embed_smoothness *w = mem_array(1, sizeof *w);
    if (!w)
        return err_set(e, ERR_MEM, "embed_smoothness: out of memory");
    w->in = *in;
    *out = w;
    if (in->n < 2)
        return ERR_OK;
    enum err_code rc = embed_smoothness_groups(w, e);
    w->scale = in->weight / ((double)w->samples * 0.5 * (double)(w->k * (w->k - 1)));
    for (size_t i = 0; !rc && i < w->samples; i++)
        *loss += w->scale * w->loss[i];
    return rc;
}
