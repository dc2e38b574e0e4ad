/* Rows in a tile: its centre, the reach of its formats, and the quarter that goes to the tile
 * above.
 *
 * Merged rows stay inside the tile, with a margin for the rounding of the tile above. An update can
 * therefore find them again by their place.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/make/pyramid_fit.h"

#include <math.h>

#include "core/math/sort.h"
#include "lod/make/simplify.h"
#include "lod/store/locate.h"

enum { PYRAMID_ZOOM_LOCAL = 6 /* above, a tile has latitudes of many scales */ };
#define PYRAMID_ROUNDING 1.25e-7 /* of the reach: float32, twice, is closer */
#define PYRAMID_FENCE_PAD 0.01   /* of a tile's width */
#define PYRAMID_FENCE_WIDE 2e4   /* metres: edges bend by less than 0.5 % up to 85 degrees */

struct gauss pyramid_view(const struct gauss *g, size_t from, size_t n)
{
    struct gauss v = *g;
    v.n = v.cap = n;
    v.mean_m += 3 * from;
    v.scale_log += 3 * from;
    v.quat_wxyz += 4 * from;
    v.opacity_logit += from;
    v.sh += 3 * gauss_sh_count(g->sh_degree) * from;
    if (g->embed)
        v.embed += g->embed_len * from;
    v.block = NULL;
    return v;
}

/* A lossless store needs m - c to be exact in float32: true for c = 0, and by Sterbenz's lemma for
 * c / 2 <= m <= 2 c. */
double pyramid_center_axis(bool lossless, double reach_m, double *at, size_t n)
{
    double lo = at[0], hi = at[0];
    for (size_t i = 1; i < n; i++) {
        lo = fmin(lo, at[i]);
        hi = fmax(hi, at[i]);
    }
    double c = round(0.5 * (lo + hi)) + 0.0;
    if (!(hi - lo < 2.0 * reach_m)) {
        sort_doubles(at, n);
        c = round(at[n / 2]) + 0.0;
    }
    if (!lossless)
        return c;
    bool exact = (lo > 0.0 && c <= 2.0 * lo && hi <= 2.0 * c) ||
                 (hi < 0.0 && c >= 2.0 * hi && lo >= 2.0 * c);
    return exact || fmax(-lo, hi) > reach_m ? c : 0.0;
}

double pyramid_reach_m(double lat_deg, uint8_t z)
{
    /* Far up, tiles of one zoom differ: the widest. */
    double edge = key_edge_m(z > PYRAMID_ZOOM_LOCAL ? lat_deg : 0.0, z);
    return edge > 2.0 * PYRAMID_REACH_M ? edge : PYRAMID_REACH_M;
}

size_t pyramid_fit(struct gauss *g, double reach_m)
{
    const float most = (float)(PYRAMID_ALLOWANCE * reach_m);
    const float least = (float)log(PYRAMID_SIGMA_LEAST * reach_m);
    size_t n = 0;
    for (size_t i = 0; i < g->n; i++) {
        const float *m = &g->mean_m[3 * i];
        if (!(fmaxf(fabsf(m[0]), fmaxf(fabsf(m[1]), fabsf(m[2]))) < most))
            continue;
        if (n != i)
            gauss_copy_row(g, n, g, i);
        n++;
    }
    for (size_t i = 0; reach_m > PYRAMID_REACH_M && i < 3 * n; i++)
        g->scale_log[i] = g->scale_log[i] > least ? g->scale_log[i] : least;
    size_t n_far = g->n - n;
    g->n = n;
    return n_far;
}

size_t pyramid_thin_count(size_t n)
{
    size_t target = (n + 3) / 4;
    return target >= PYRAMID_KEEP ? target : n < PYRAMID_KEEP ? n : PYRAMID_KEEP;
}

struct pyramid_fence { /* the ground of a tile, for rows of about one height */
    const struct locate *l;
    uint64_t code;
    unsigned shift;
    double mid[3], rounding_m;
    double min_m[2], max_m[2]; /* ENU; surely inside, empty when the tile is too wide to say */
};

/* The rectangle inside the tile's corners at the lowest and the highest row. Edges bend by less
 * than the part of them that is left out, up to PYRAMID_FENCE_WIDE. */
static enum err_code pyramid_fence_open(const struct locate *l, const struct gauss *g, struct key k,
                                        struct pyramid_fence *out, struct err *e)
{
    double lon[3], lat[3], low = 0.0, high = 0.0;
    *out = (struct pyramid_fence){
        .l = l,
        .code = locate_code(k),
        .shift = 2u * (unsigned)(KEY_ZOOM_MAX - k.z),
        .rounding_m = /* about the centre of the tile above */
        PYRAMID_ROUNDING * pyramid_reach_m(l->origin.lat_deg, k.z ? (uint8_t)(k.z - 1) : 0),
        .min_m = {-HUGE_VAL, -HUGE_VAL},
        .max_m = {HUGE_VAL, HUGE_VAL},
    };
    key_bounds(k, &lon[0], &lat[0], &lon[2], &lat[2]);
    key_center(k, &lon[1], &lat[1]);
    enum err_code rc = geo_to_enu(&l->origin, lon[1], lat[1], l->origin.h_m, out->mid, e);
    for (size_t i = 0; i < g->n; i++) {
        double up = (double)g->mean_m[3 * i + 2] + g->origin_enu_m[2] - out->mid[2];
        low = up < low ? up : low;
        high = up > high ? up : high;
    }
    for (size_t i = 0; !rc && i < 8; i++) {
        double at[3], h = l->origin.h_m + (i & 4 ? high : low);
        rc = geo_to_enu(&l->origin, lon[i & 1 ? 2 : 0], lat[i & 2 ? 2 : 0], h, at, e);
        for (size_t a = 0; !rc && a < 2; a++) {
            bool upper = i & (a ? 2 : 1);
            if (upper)
                out->max_m[a] = fmin(out->max_m[a], at[a]);
            else
                out->min_m[a] = fmax(out->min_m[a], at[a]);
        }
    }
    bool wide = key_edge_m(lat[1], k.z) > PYRAMID_FENCE_WIDE;
    for (size_t a = 0; a < 2; a++) {
        double pad = PYRAMID_FENCE_PAD * (out->max_m[a] - out->min_m[a]);
        out->min_m[a] = wide ? HUGE_VAL : out->min_m[a] + pad;
        out->max_m[a] -= pad;
    }
    return rc;
}

/* Is the place in the tile, and all around it that it may be rounded to? */
static enum err_code pyramid_fence_holds(const struct pyramid_fence *f, const double enu[3],
                                         bool *holds, struct err *e)
{
    enum err_code rc = ERR_OK;
    *holds = enu[0] > f->min_m[0] && enu[0] < f->max_m[0] && enu[1] > f->min_m[1] &&
             enu[1] < f->max_m[1];
    if (*holds)
        return ERR_OK;
    *holds = true;
    for (unsigned i = 0; !rc && *holds && i < 4; i++) {
        const double at[3] = {enu[0] + (i & 1 ? f->rounding_m : -f->rounding_m),
                              enu[1] + (i & 2 ? f->rounding_m : -f->rounding_m), enu[2]};
        struct key k;
        rc = locate_key(f->l, at, &k, e);
        *holds = !rc && locate_code(k) >> f->shift == f->code;
    }
    return rc;
}

/* A merged mean lies among the means it came from, which can be outside by what float32 rounded or
 * by the bend of an edge. Draw it towards the middle until the tile owns it. */
static enum err_code pyramid_fence_in(const struct pyramid_fence *f, struct gauss *g, size_t i,
                                      struct err *e)
{
    for (double pull = 0.0; pull<1.0; pull = pull> 0.0 ? 4.0 * pull : 1e-7) {
        double enu[3];
        bool holds;
        for (size_t a = 0; a < 3; a++) {
            float *m = &g->mean_m[3 * i + a];
            enu[a] = (double)*m + g->origin_enu_m[a];
            if (a < 2 && pull > 0.0) {
                enu[a] += pull * (f->mid[a] - enu[a]);
                *m = (float)(enu[a] - g->origin_enu_m[a]);
                enu[a] = (double)*m + g->origin_enu_m[a];
            }
        }
        enum err_code rc = pyramid_fence_holds(f, enu, &holds, e);
        if (rc || holds)
            return rc;
    }
    return ERR_OK;
}

enum err_code pyramid_thin(const struct locate *l, const struct gauss *g, struct key k,
                           struct gauss *out, struct err *e)
{
    struct pyramid_fence f;
    enum err_code rc = simplify_gauss(g, pyramid_thin_count(g->n), out, e);
    if (!rc)
        rc = pyramid_fence_open(l, out, k, &f, e);
    for (size_t i = 0; !rc && i < out->n; i++)
        rc = pyramid_fence_in(&f, out, i, e);
    return rc;
}
