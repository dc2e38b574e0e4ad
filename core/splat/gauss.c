/* The Gaussian container. One allocation of `cap` rows holds all arrays, one after the other;
 * growing copies array by array.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/splat/gauss.h"

#include <math.h>
#include <string.h>

#include "core/base.h"
#include "core/math/simd.h"
#include "core/math/sort.h"

enum { GAUSS_FIELDS = 6, GAUSS_MORTON_BITS = 21 };

/* Floats a row of each array, in the order of the block. */
static void gauss_widths(uint32_t sh_degree, uint32_t embed_len, size_t width[GAUSS_FIELDS])
{
    width[0] = 3;
    width[1] = 3;
    width[2] = 4;
    width[3] = 1;
    width[4] = 3 * gauss_sh_count(sh_degree);
    width[5] = embed_len;
}

static void gauss_point_into(struct gauss *g, float *block)
{
    size_t width[GAUSS_FIELDS];
    gauss_widths(g->sh_degree, g->embed_len, width);
    float **field[GAUSS_FIELDS] = {&g->mean_m,        &g->scale_log, &g->quat_wxyz,
                                   &g->opacity_logit, &g->sh,        &g->embed};
    for (size_t f = 0; f < GAUSS_FIELDS; f++) {
        *field[f] = width[f] ? block : NULL;
        block += width[f] * g->cap;
    }
}

static size_t gauss_row_floats(const struct gauss *g)
{
    size_t width[GAUSS_FIELDS], sum = 0;
    gauss_widths(g->sh_degree, g->embed_len, width);
    for (size_t f = 0; f < GAUSS_FIELDS; f++)
        sum += width[f];
    return sum;
}

static enum err_code gauss_make(struct gauss *g, size_t cap, uint32_t sh_degree, uint32_t embed_len,
                                void *(*get)(size_t n, size_t size), struct err *e)
{
    *g = (struct gauss){0};
    if (sh_degree > GAUSS_SH_DEGREE_MAX || embed_len > GAUSS_EMBED_MAX)
        return err_set(e, ERR_LIMIT,
                       "SH degree %u (at most %d) or embedding length %u (at most %d)", sh_degree,
                       GAUSS_SH_DEGREE_MAX, embed_len, GAUSS_EMBED_MAX);
    struct gauss made = {.cap = cap, .sh_degree = sh_degree, .embed_len = embed_len};
    made.block = get(cap, gauss_row_floats(&made) * sizeof(float));
    if (!made.block)
        return err_set(e, ERR_MEM, "out of memory for %zu Gaussians", cap);
    gauss_point_into(&made, made.block);
    *g = made;
    return ERR_OK;
}

enum err_code gauss_alloc(struct gauss *g, size_t cap, uint32_t sh_degree, uint32_t embed_len,
                          struct err *e)
{
    return gauss_make(g, cap, sh_degree, embed_len, mem_array, e);
}

enum err_code gauss_uninit(struct gauss *g, size_t cap, uint32_t sh_degree, uint32_t embed_len,
                           struct err *e)
{
    return gauss_make(g, cap, sh_degree, embed_len, mem_uninit, e);
}

void gauss_free(struct gauss *g)
{
    mem_free(g->block);
    *g = (struct gauss){0};
}

enum err_code gauss_reserve(struct gauss *g, size_t want, struct err *e)
{
    if (want <= g->cap)
        return ERR_OK;
    size_t cap = g->cap + g->cap / 2;
    if (cap < want)
        cap = want;
    struct gauss big;
    enum err_code rc = gauss_alloc(&big, cap, g->sh_degree, g->embed_len, e);
    if (rc)
        return rc;
    size_t width[GAUSS_FIELDS];
    gauss_widths(g->sh_degree, g->embed_len, width);
    float *from[GAUSS_FIELDS] = {g->mean_m,        g->scale_log, g->quat_wxyz,
                                 g->opacity_logit, g->sh,        g->embed};
    float *to[GAUSS_FIELDS] = {big.mean_m,        big.scale_log, big.quat_wxyz,
                               big.opacity_logit, big.sh,        big.embed};
    for (size_t f = 0; f < GAUSS_FIELDS; f++)
        if (g->n && width[f])
            memcpy(to[f], from[f], g->n * width[f] * sizeof(float));
    big.n = g->n;
    big.antialiased = g->antialiased;
    memcpy(big.origin_enu_m, g->origin_enu_m, sizeof big.origin_enu_m);
    gauss_free(g);
    *g = big;
    return ERR_OK;
}

void gauss_copy_row(struct gauss *dst, size_t d, const struct gauss *src, size_t s)
{
    for (size_t k = 0; k < 3; k++) {
        double at = (double)src->mean_m[3 * s + k] + (src->origin_enu_m[k] - dst->origin_enu_m[k]);
        dst->mean_m[3 * d + k] = (float)at;
        dst->scale_log[3 * d + k] = src->scale_log[3 * s + k];
    }
    memcpy(&dst->quat_wxyz[4 * d], &src->quat_wxyz[4 * s], 4 * sizeof(float));
    dst->opacity_logit[d] = src->opacity_logit[s];
    size_t kd = 3 * gauss_sh_count(dst->sh_degree), ks = 3 * gauss_sh_count(src->sh_degree);
    for (size_t k = 0; k < kd; k++)
        dst->sh[kd * d + k] = k < ks ? src->sh[ks * s + k] : 0.0f;
    for (size_t k = 0; k < dst->embed_len; k++)
        dst->embed[dst->embed_len * d + k] =
            k < src->embed_len ? src->embed[src->embed_len * s + k] : 0.0f;
}

/* The first rows of a container with the same fields. */
static void gauss_append_block(struct gauss *dst, const struct gauss *src, size_t count)
{
    size_t width[GAUSS_FIELDS], at = dst->n;
    gauss_widths(dst->sh_degree, dst->embed_len, width);
    const float *from[GAUSS_FIELDS] = {src->mean_m,        src->scale_log, src->quat_wxyz,
                                       src->opacity_logit, src->sh,        src->embed};
    float *to[GAUSS_FIELDS] = {dst->mean_m,        dst->scale_log, dst->quat_wxyz,
                               dst->opacity_logit, dst->sh,        dst->embed};
    for (size_t f = 1; f < GAUSS_FIELDS; f++)
        if (count && width[f])
            memcpy(to[f] + at * width[f], from[f], count * width[f] * sizeof(float));
    for (size_t k = 0; k < 3; k++) {
        double shift = src->origin_enu_m[k] - dst->origin_enu_m[k];
        for (size_t i = 0; i < count; i++)
            dst->mean_m[3 * (at + i) + k] = (float)((double)src->mean_m[3 * i + k] + shift);
    }
}

enum err_code gauss_append(struct gauss *dst, const struct gauss *src, const uint32_t *index,
                           size_t count, struct err *e)
{
    if (count > SIZE_MAX - dst->n)
        return err_set(e, ERR_LIMIT, "too many Gaussians");
    enum err_code rc = gauss_reserve(dst, dst->n + count, e);
    if (rc)
        return rc;
    if (!index && src->sh_degree == dst->sh_degree && src->embed_len == dst->embed_len)
        gauss_append_block(dst, src, count);
    else
        for (size_t i = 0; i < count; i++)
            gauss_copy_row(dst, dst->n + i, src, index ? index[i] : i);
    dst->n += count;
    return ERR_OK;
}

void gauss_recenter(struct gauss *g, const double origin_enu_m[3])
{
    for (size_t k = 0; k < 3; k++) {
        double shift = g->origin_enu_m[k] - origin_enu_m[k];
        for (size_t i = 0; shift != 0.0 && i < g->n; i++)
            g->mean_m[3 * i + k] = (float)((double)g->mean_m[3 * i + k] + shift);
        g->origin_enu_m[k] = origin_enu_m[k];
    }
}

struct gauss_extent {
    float lo[3], hi[3];
};

static void gauss_extend(struct gauss_extent *x, const float *mean, size_t n)
{
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k < 3; k++) {
            float at = mean[3 * i + k];
            x->lo[k] = at < x->lo[k] ? at : x->lo[k];
            x->hi[k] = at > x->hi[k] ? at : x->hi[k];
        }
}

static const struct gauss_extent gauss_nowhere = {{INFINITY, INFINITY, INFINITY},
                                                  {-INFINITY, -INFINITY, -INFINITY}};

/* 0 .. 2^21 - 1 along an axis; NaN goes first. */
static uint32_t gauss_cell(float x, float lo, double span)
{
    const double top = (1 << GAUSS_MORTON_BITS) - 1;
    double t = span > 0.0 ? ((double)x - (double)lo) / span : 0.0;
    return t >= 0.0 && t <= 1.0 ? (uint32_t)(t * top) : 0;
}

static enum err_code gauss_order_rows(size_t n, struct sort_item **item, struct err *e)
{
    if (n > UINT32_MAX)
        return err_set(e, ERR_LIMIT, "%zu Gaussians, at most 2^32 - 1 can be ordered", n);
    *item = mem_array(n, 2 * sizeof **item);
    return *item ? ERR_OK : err_set(e, ERR_MEM, "out of memory to order %zu Gaussians", n);
}

static void gauss_order_sort(struct sort_item *item, size_t n, uint32_t *order)
{
    sort_items(item, item + n, n);
    for (size_t i = 0; i < n; i++)
        order[i] = item[i].row;
    mem_free(item);
}

/* Rows from `first` on. */
static void gauss_morton_keys(const struct gauss_extent *x, const float *mean, size_t first,
                              size_t n, struct sort_item *item)
{
    for (size_t i = 0; i < n; i++) {
        item[i] = (struct sort_item){0, (uint32_t)(first + i)};
        for (size_t k = 0; k < 3; k++)
            item[i].key |= sort_spread3(gauss_cell(mean[3 * i + k], x->lo[k],
                                                   (double)x->hi[k] - (double)x->lo[k]))
                           << k;
    }
}

enum err_code gauss_morton_order(const struct gauss *g, uint32_t *order, struct err *e)
{
    struct sort_item *item;
    struct gauss_extent x = gauss_nowhere;
    enum err_code rc = gauss_order_rows(g->n, &item, e);
    if (rc)
        return rc;
    gauss_extend(&x, g->mean_m, g->n);
    gauss_morton_keys(&x, g->mean_m, 0, g->n, item);
    gauss_order_sort(item, g->n, order);
    return ERR_OK;
}

enum err_code gauss_morton_order_of(const struct gauss_places *p, uint32_t *order, struct err *e)
{
    struct sort_item *item = NULL;
    struct gauss_extent x = gauss_nowhere;
    float *mean = mem_array(p->n < GAUSS_SLICE ? p->n : GAUSS_SLICE, 3 * sizeof *mean);
    enum err_code rc = mean ? gauss_order_rows(p->n, &item, e)
                            : err_set(e, ERR_MEM, "out of memory to order %zu Gaussians", p->n);
    for (int pass = 0; !rc && pass < 2; pass++)
        for (size_t i = 0; !rc && i < p->n; i += GAUSS_SLICE) {
            const size_t n = p->n - i < GAUSS_SLICE ? p->n - i : GAUSS_SLICE;
            rc = p->means(p->user, i, i + n, mean, e);
            if (!rc && pass)
                gauss_morton_keys(&x, mean, i, n, item + i);
            else if (!rc)
                gauss_extend(&x, mean, n);
        }
    mem_free(mean);
    if (rc)
        mem_free(item);
    else
        gauss_order_sort(item, p->n, order);
    return rc;
}

enum err_code gauss_hilbert_order(const struct gauss *g, uint32_t *order, struct err *e)
{
    struct sort_item *item;
    struct sort_hilbert curve;
    struct gauss_extent x = gauss_nowhere;
    double span = 0.0;
    enum err_code rc = gauss_order_rows(g->n, &item, e);
    if (rc)
        return rc;
    sort_hilbert_init(&curve);
    gauss_extend(&x, g->mean_m, g->n);
    for (size_t k = 0; k < 3; k++)
        span = fmax(span, (double)x.hi[k] - (double)x.lo[k]);
    for (size_t i = 0; i < g->n; i++) {
        const float *at = g->mean_m + 3 * i;
        const uint32_t cell[3] = {gauss_cell(at[0], x.lo[0], span),
                                  gauss_cell(at[1], x.lo[1], span),
                                  gauss_cell(at[2], x.lo[2], span)};
        item[i] = (struct sort_item){sort_hilbert_key(&curve, cell), (uint32_t)i};
    }
    gauss_order_sort(item, g->n, order);
    return ERR_OK;
}

/* Copies rows in the order of the curve. */
static enum err_code gauss_sort_into(struct gauss *out, const struct gauss *g, uint32_t embed_len,
                                     const double origin_enu_m[3], struct err *e)
{
    uint32_t *order = mem_array(g->n, sizeof *order);
    enum err_code rc = order ? gauss_hilbert_order(g, order, e)
                             : err_set(e, ERR_MEM, "out of memory for %zu rows in order", g->n);
    if (!rc)
        rc = gauss_alloc(out, g->n, g->sh_degree, embed_len, e);
    if (!rc) {
        out->antialiased = g->antialiased;
        memcpy(out->origin_enu_m, origin_enu_m, sizeof out->origin_enu_m);
        rc = gauss_append(out, g, order, g->n, e);
    }
    mem_free(order);
    return rc;
}

enum err_code gauss_sorted(const struct gauss *g, struct gauss *out, struct err *e)
{
    return gauss_sort_into(out, g, 0, (const double[3]){0.0, 0.0, 0.0}, e);
}

enum err_code gauss_sort(struct gauss *g, struct err *e)
{
    struct gauss sorted = {0};
    enum err_code rc = gauss_sort_into(&sorted, g, g->embed_len, g->origin_enu_m, e);
    gauss_free(rc ? &sorted : g);
    if (!rc)
        *g = sorted;
    return rc;
}

void gauss_bounds(const struct gauss *g, double k_sigma, double min_enu_m[3], double max_enu_m[3])
{
    for (size_t k = 0; k < 3; k++) {
        min_enu_m[k] = g->n ? HUGE_VAL : 0.0;
        max_enu_m[k] = g->n ? -HUGE_VAL : 0.0;
    }
    for (size_t i = 0; i < g->n; i++) {
        const float *s = &g->scale_log[3 * i];
        float big = s[0] > s[1] ? s[0] : s[1];
        double reach = k_sigma * exp((double)(big > s[2] ? big : s[2]));
        for (size_t k = 0; k < 3; k++) {
            double at = (double)g->mean_m[3 * i + k] + g->origin_enu_m[k];
            double lo = at - reach, hi = at + reach;
            min_enu_m[k] = lo < min_enu_m[k] ? lo : min_enu_m[k];
            max_enu_m[k] = hi > max_enu_m[k] ? hi : max_enu_m[k];
        }
    }
}

SIMD_WIDE static bool gauss_finite(const float *p, size_t n)
{
    uint32_t most = 0; /* of the exponents: no branch, so that it becomes vector code */
    for (size_t i = 0; i < n; i++) {
        uint32_t bits;
        memcpy(&bits, p + i, sizeof bits);
        bits &= 0x7f800000;
        most = bits > most ? bits : most;
    }
    return most < 0x7f800000;
}

/* NaN compares as false here: gauss_finite sees it. */
SIMD_WIDE static float gauss_least_norm2(const float *quat, size_t n)
{
    float least = INFINITY;
    for (size_t i = 0; i < n; i++) {
        const float *q = &quat[4 * i];
        float norm = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
        least = norm < least ? norm : least;
    }
    return least;
}

static bool gauss_all_good(const struct gauss *g)
{
    return gauss_least_norm2(g->quat_wxyz, g->n) > 0.0f && gauss_finite(g->mean_m, 3 * g->n) &&
           gauss_finite(g->scale_log, 3 * g->n) && gauss_finite(g->quat_wxyz, 4 * g->n) &&
           gauss_finite(g->opacity_logit, g->n) &&
           gauss_finite(g->sh, 3 * gauss_sh_count(g->sh_degree) * g->n) &&
           gauss_finite(g->embed, (g->embed ? g->embed_len : 0) * g->n);
}

static bool gauss_row_good(const struct gauss *g, size_t i)
{
    const size_t k = 3 * gauss_sh_count(g->sh_degree);
    const float *q = &g->quat_wxyz[4 * i];
    return gauss_finite(&g->mean_m[3 * i], 3) && gauss_finite(&g->scale_log[3 * i], 3) &&
           gauss_finite(q, 4) && isfinite(g->opacity_logit[i]) && gauss_finite(&g->sh[k * i], k) &&
           gauss_finite(g->embed ? &g->embed[g->embed_len * i] : NULL, g->embed_len) &&
           q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3] > 0.0f;
}

SIMD_WIDE static bool gauss_scales_fit(const float *scale_log, size_t n)
{
    float most = -INFINITY;
    for (size_t i = 0; i < n; i++)
        most = scale_log[i] > most ? scale_log[i] : most;
    return most <= GAUSS_SCALE_LOG_MOST;
}

static bool gauss_row_fits(const struct gauss *g, size_t i)
{
    return gauss_row_good(g, i) && gauss_scales_fit(&g->scale_log[3 * i], 3);
}

size_t gauss_count_bad(const struct gauss *g, size_t *first_bad)
{
    size_t bad = 0;
    if (gauss_all_good(g))
        return 0;
    for (size_t i = 0; i < g->n; i++)
        if (!gauss_row_good(g, i) && bad++ == 0 && first_bad)
            *first_bad = i;
    return bad;
}

size_t gauss_count_unusable(const struct gauss *g, size_t *first)
{
    size_t bad = 0;
    if (gauss_scales_fit(g->scale_log, 3 * g->n) && gauss_all_good(g))
        return 0;
    for (size_t i = 0; i < g->n; i++)
        if (!gauss_row_fits(g, i) && bad++ == 0 && first)
            *first = i;
    return bad;
}

enum err_code gauss_keep_good(struct gauss *g, const char *format, struct err *e)
{
    size_t first = 0, n = 0;
    const size_t bad = gauss_count_unusable(g, &first);
    if (!bad)
        return ERR_OK;
    if (bad == g->n)
        return err_set(e, ERR_DATA, "%s: none of %zu rows is finite and has a rotation", format,
                       g->n);
    for (size_t i = 0; i < g->n; i++)
        if (gauss_row_fits(g, i)) {
            if (n < i)
                gauss_copy_row(g, n, g, i);
            n++;
        }
    log_warn(format, "%zu of %zu rows are left out: not finite, or no rotation; row %zu first", bad,
             g->n, first);
    g->n = n;
    g->n_left_out = bad;
    return ERR_OK;
}
