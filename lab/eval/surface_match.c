/* Precision, recall and F1 of a surface: see surface_match.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/eval/surface_match.h"

#include <math.h>
#include <string.h>

#include "core/base.h"
#include "core/math/knn.h"
#include "core/pool.h"

enum { CLOUD_BITS = 21, MATCH_CHUNK = 4096 };

/* ---- clouds ---- */

/* The place of a voxel in the table: where it is, or where it is to be. */
static size_t surface_cloud_place(const uint64_t *seen, size_t n, uint64_t key)
{
    size_t at = (size_t)((key * 0x9E3779B97F4A7C15u) >> 20) & (n - 1);
    while (seen[at] && seen[at] != key)
        at = (at + 1) & (n - 1);
    return at;
}

/* Room for one more point, half of the table free. */
static enum err_code surface_cloud_reserve(struct surface_cloud *c, struct err *e)
{
    if (c->n < c->cap)
        return ERR_OK;
    size_t want = c->cap ? 2 * c->cap : 65536;
    float *xyz = mem_resize(c->xyz_m, c->cap, want, 3 * sizeof *xyz);
    if (xyz)
        c->xyz_m = xyz;
    uint8_t *kind = xyz ? mem_resize(c->kind, c->cap, want, sizeof *kind) : NULL;
    if (kind)
        c->kind = kind;
    uint64_t *seen = kind ? mem_array(2 * want, sizeof *seen) : NULL;
    if (!seen)
        return err_set(e, ERR_MEM, "out of memory for %zu points", want);
    for (size_t i = 0; i < c->n_seen; i++)
        if (c->seen[i])
            seen[surface_cloud_place(seen, 2 * want, c->seen[i])] = c->seen[i];
    mem_free(c->seen);
    c->seen = seen;
    c->n_seen = 2 * want;
    c->cap = want;
    return ERR_OK;
}

enum err_code surface_cloud_add(struct surface_cloud *c, const double xyz_m[3], uint8_t kind,
                                struct err *e)
{
    uint64_t key = 1; /* never 0 */
    for (int k = 0; k < 3; k++) {
        double v = floor(xyz_m[k] / c->voxel_m) + (double)(1 << (CLOUD_BITS - 1));
        if (!(v >= 0.0 && v < (double)(1 << CLOUD_BITS)))
            return err_set(e, ERR_LIMIT, "a point at %g m: too far for voxels of %g m", xyz_m[k],
                           c->voxel_m);
        key = key << CLOUD_BITS | (uint64_t)v;
    }
    enum err_code rc = surface_cloud_reserve(c, e);
    if (rc)
        return rc;
    size_t at = surface_cloud_place(c->seen, c->n_seen, key);
    if (c->seen[at])
        return ERR_OK;
    c->seen[at] = key;
    for (int k = 0; k < 3; k++)
        c->xyz_m[3 * c->n + (size_t)k] = (float)xyz_m[k];
    c->kind[c->n++] = kind;
    return ERR_OK;
}

void surface_cloud_free(struct surface_cloud *c)
{
    mem_free(c->xyz_m);
    mem_free(c->kind);
    mem_free(c->seen);
    *c = (struct surface_cloud){0};
}

/* ---- matching ---- */

struct match_side { /* points of one cloud that ask another */
    const struct surface_cloud *from, *to;
    struct knn tree; /* of `to` */
    size_t step, n;  /* every step-th point asks; so many */
    float *far_m;    /* [n] distance to the nearest */
    uint8_t *kind;   /* [n] the nearest's */
};

static enum err_code match_chunk(void *user, size_t chunk, struct err *e)
{
    struct match_side *s = user;
    size_t end = (chunk + 1) * MATCH_CHUNK < s->n ? (chunk + 1) * MATCH_CHUNK : s->n;
    if (signals_stopping())
        return err_set(e, ERR_CANCEL, "stopped");
    for (size_t i = chunk * MATCH_CHUNK; i < end; i++) {
        uint32_t id = 0;
        float d2 = HUGE_VALF;
        size_t found =
            knn_find(&s->tree, s->from->xyz_m + 3 * i * s->step, KNN_NOBODY, 1, &id, &d2);
        s->far_m[i] = sqrtf(d2);
        s->kind[i] = found ? s->to->kind[id] : SURFACE_CLASSES;
    }
    return ERR_OK;
}

static enum err_code match_ask(const struct surface_cloud *from, const struct surface_cloud *to,
                               size_t asked, struct match_side *s, struct err *e)
{
    *s = (struct match_side){
        .from = from, .to = to, .step = 1 + (from->n ? from->n - 1 : 0) / asked};
    s->n = (from->n + s->step - 1) / s->step;
    s->far_m = mem_array(s->n + 1, sizeof *s->far_m);
    s->kind = mem_array(s->n + 1, sizeof *s->kind);
    if (!s->far_m || !s->kind)
        return err_set(e, ERR_MEM, "out of memory for %zu points", s->n);
    enum err_code rc = knn_build(to->xyz_m, to->n, &s->tree, e);
    return rc ? rc : pool_for((s->n + MATCH_CHUNK - 1) / MATCH_CHUNK, 0, match_chunk, s, e);
}

static void match_free(struct match_side *s)
{
    knn_free(&s->tree);
    mem_free(s->far_m);
    mem_free(s->kind);
}

/* Share of the points of a kind (SURFACE_CLASSES: any) that have one within that distance. */
static double match_share(const struct match_side *s, bool own_kind, size_t kind, double within_m,
                          size_t *n)
{
    size_t near = 0;
    *n = 0;
    for (size_t i = 0; i < s->n; i++) {
        uint8_t k = own_kind ? s->from->kind[i * s->step] : s->kind[i];
        if (kind != SURFACE_CLASSES && k != kind)
            continue;
        ++*n;
        near += (double)s->far_m[i] <= within_m;
    }
    return (double)near / (double)*n; /* 0 / 0 is NaN */
}

enum err_code surface_match_tell(const struct surface_cloud *model,
                                 const struct surface_cloud *truth,
                                 const double within_m[SURFACE_MATCHES], size_t asked,
                                 struct surface_match out[SURFACE_MATCHES][SURFACE_CLASSES + 1],
                                 struct err *e)
{
    struct match_side precise = {0}, complete = {0};
    enum err_code rc = match_ask(model, truth, asked, &precise, e);
    if (!rc)
        rc = match_ask(truth, model, asked, &complete, e);
    for (size_t d = 0; !rc && d < SURFACE_MATCHES; d++)
        for (size_t k = 0; k <= SURFACE_CLASSES; k++) {
            struct surface_match *m = &out[d][k];
            m->precision = match_share(&precise, false, k, within_m[d], &m->n_model);
            m->recall = match_share(&complete, true, k, within_m[d], &m->n_truth);
            double sum = m->precision + m->recall;
            m->f1 = m->recall == 0.0 ? 0.0 : 2.0 * m->precision * m->recall / sum;
        }
    match_free(&precise);
    match_free(&complete);
    return rc;
}
