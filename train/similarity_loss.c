/* The similarity loss on the Gaussians' appearance embeddings: neighbours in space should react to
 * light and season alike.
 *
 * For M Gaussians drawn at random and their k nearest (themselves included), every pair (a, b) of
 * such a group, b the farther one, pays w_b (1 - cos of the angle between their embeddings). It
 * runs on the host, every 50th step: a k-d tree over all means, then groups in parallel; each
 * group's gradient is kept apart and added up in order, so the sum does not depend on threads. All
 * sums in double. Source: REUrbanGS (2025); weights and groups carry no gradient.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "core/pool.h"
#include "train/knn.h"
#include "train/regular.h"
#include "train/train.h"

#define SIMILARITY_LENGTH_MIN 1e-12
enum { SIMILARITY_CHUNK = 256, SIMILARITY_EMBED_MAX = GAUSS_EMBED_MAX };

struct similarity_work {
    const struct similarity_loss_input *in;
    struct knn tree;
    uint32_t *chosen, *ids; /* [samples], [samples][k] */
    float *grad;            /* [samples][k][len], with respect to the unit embeddings */
    double *loss;           /* [samples] */
    size_t *found;          /* [samples] */
    size_t samples, k;
};

/* v / max(|v|, 1e-12) of a row; returns the divisor. */
static double similarity_unit(const struct similarity_loss_input *in, size_t row, double *out)
{
    const float *v = in->embed + row * in->len;
    double sum = 0.0;
    for (size_t c = 0; c < in->len; c++)
        sum += (double)v[c] * (double)v[c];
    double len = fmax(sqrt(sum), SIMILARITY_LENGTH_MIN);
    for (size_t c = 0; c < in->len; c++)
        out[c] = (double)v[c] / len;
    return len;
}

/* One group: sum over a < b of w_b (1 - a.b), by prefix sums forth and suffix sums back. */
static void similarity_group(struct similarity_work *w, size_t sample)
{
    const struct similarity_loss_input *in = w->in;
    double unit[KNN_MAX][SIMILARITY_EMBED_MAX], sum[SIMILARITY_EMBED_MAX] = {0};
    double weight[KNN_MAX];
    float dist2[KNN_MAX];
    uint32_t *ids = w->ids + sample * w->k;
    float *grad = w->grad + sample * w->k * in->len;
    size_t n = knn_find(&w->tree, in->mean_m + 3 * (size_t)w->chosen[sample], KNN_NOBODY, w->k, ids,
                        dist2);
    w->found[sample] = n;
    for (size_t b = 0; b < n; b++) {
        double dot = 0.0;
        (void)similarity_unit(in, ids[b], unit[b]);
        weight[b] = exp(-in->falloff * (double)dist2[b]);
        for (size_t c = 0; c < in->len; c++) {
            dot += sum[c] * unit[b][c];
            grad[b * in->len + c] = (float)(-weight[b] * sum[c]);
            sum[c] += unit[b][c];
        }
        w->loss[sample] += weight[b] * ((double)b - dot);
    }
    memset(sum, 0, sizeof(sum));
    for (size_t a = n; a-- > 0;)
        for (size_t c = 0; c < in->len; c++) {
            grad[a * in->len + c] -= (float)sum[c];
            sum[c] += weight[a] * unit[a][c];
        }
}

static enum err_code similarity_chunk(void *user, size_t chunk, struct err *e)
{
    (void)e;
    struct similarity_work *w = user;
    size_t end = (chunk + 1) * SIMILARITY_CHUNK;
    for (size_t i = chunk * SIMILARITY_CHUNK; i < end && i < w->samples; i++)
        similarity_group(w, i);
    return ERR_OK;
}

static enum err_code similarity_draw(struct similarity_work *w, struct err *e)
{
    const struct similarity_loss_input *in = w->in;
    uint32_t *all = mem_array(in->n, sizeof(*all));
    if (!all)
        return err_set(e, ERR_MEM, "similarity: out of memory for %zu Gaussians", in->n);
    for (size_t i = 0; i < in->n; i++)
        all[i] = (uint32_t)i;
    enum err_code rc =
        densify_race(NULL, all, in->n, w->samples, in->seed, in->stream, w->chosen, e);
    mem_free(all);
    return rc;
}

/* Add the groups up, in order, and go back through the normalisation. Rows in no group keep 0. */
static void similarity_gather(const struct similarity_work *w, double scale, double *sum,
                              uint8_t *touched, float *grad)
{
    const struct similarity_loss_input *in = w->in;
    for (size_t s = 0; s < w->samples; s++)
        for (size_t a = 0; a < w->found[s]; a++) {
            size_t row = w->ids[s * w->k + a];
            touched[row] = 1;
            for (size_t c = 0; c < in->len; c++)
                sum[row * in->len + c] += (double)w->grad[(s * w->k + a) * in->len + c];
        }
    for (size_t i = 0; i < in->n; i++) {
        double unit[SIMILARITY_EMBED_MAX], along = 0.0;
        if (!touched[i])
            continue;
        double len = similarity_unit(in, i, unit);
        for (size_t c = 0; c < in->len; c++)
            along += unit[c] * sum[i * in->len + c];
        for (size_t c = 0; c < in->len; c++)
            grad[i * in->len + c] = (float)(scale * (sum[i * in->len + c] - unit[c] * along) / len);
    }
}

enum err_code similarity_loss_run(const struct similarity_loss_input *in, double *loss, float *grad,
                                  struct err *e)
{
    struct similarity_work w = {.in = in};
    double *sum = NULL;
    uint8_t *touched = NULL;
    *loss = 0.0;
    if (in->len < 1 || in->len > SIMILARITY_EMBED_MAX || in->neighbours < 2 ||
        in->neighbours > KNN_MAX)
        return err_set(
            e, ERR_ARG,
            "similarity: %zu neighbours, embeddings of %zu: 2 to %d, 1 to %d are possible",
            in->neighbours, in->len, KNN_MAX, SIMILARITY_EMBED_MAX);
    memset(grad, 0, in->n * in->len * sizeof(*grad));
    if (in->n < 2)
        return ERR_OK;
    w.samples = in->samples < in->n ? in->samples : in->n;
    w.k = in->neighbours < in->n ? in->neighbours : in->n;
    enum err_code rc = knn_build(in->mean_m, in->n, &w.tree, e);
    if (rc)
        return rc;
    w.chosen = mem_array(w.samples, sizeof(*w.chosen));
    w.ids = mem_array(w.samples * w.k, sizeof(*w.ids));
    w.grad = mem_array(w.samples * w.k, in->len * sizeof(*w.grad));
    w.loss = mem_array(w.samples, sizeof(*w.loss));
    w.found = mem_array(w.samples, sizeof(*w.found));
    sum = mem_array(in->n, in->len * sizeof(*sum));
    touched = mem_array(in->n, 1);
    if (!w.chosen || !w.ids || !w.grad || !w.loss || !w.found || !sum || !touched)
        rc = err_set(e, ERR_MEM, "similarity: out of memory for %zu Gaussians", in->n);
    if (!rc)
        rc = similarity_draw(&w, e);
    if (!rc)
        rc = pool_for((w.samples + SIMILARITY_CHUNK - 1) / SIMILARITY_CHUNK, 0, similarity_chunk,
                      &w, e);
    if (!rc) {
        double scale = in->weight / ((double)w.samples * 0.5 * (double)(w.k * (w.k - 1)));
        for (size_t i = 0; i < w.samples; i++)
            *loss += scale * w.loss[i];
        similarity_gather(&w, scale, sum, touched, grad);
    }
    knn_free(&w.tree);
    mem_free(w.chosen);
    mem_free(w.ids);
    mem_free(w.grad);
    mem_free(w.loss);
    mem_free(w.found);
    mem_free(sum);
    mem_free(touched);
    return rc;
}
