/* Density control under a budget: which Gaussians are cloned, split or removed.
 *
 * Candidates are Gaussians whose mean positional gradient exceeds a threshold. The threshold grows
 * with the distance from the cell: 1 inside .. tau_outside at one cell edge. Small candidates are
 * cloned, large ones split in two (3D Gaussian Splatting, Kerbl 2023). Inside and outside have a
 * limit each. The room under it is divided among the classes of candidates. In each class,
 * candidates are drawn without replacement with chances proportional to an importance score (Taming
 * 3DGS, Mallick 2024). The draw is an exponential race: the k smallest -ln(u_i) / importance_i,
 * with u_i from the counter generator. It is therefore the same on every machine, and has no limit
 * of size.
 *
 * Everything here works on host copies in the device's layout, and does not depend on the number of
 * threads.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/math/sample.h"
#include "core/math/sort.h"
#include "core/pool.h"
#include "core/splat/gauss.h"
#include "render/permute.h"
#include "render/render.h"
#include "scene/cells/cell.h"
#include "scene/cells/footprint.h"
#include "scene/cells/trim.h"
#include "train/base/config.h"
#include "train/model/densify_plan.h"

#define DENSIFY_AXIS_OFFSET 0.8 /* d, in sigmas of the parent */
#define DENSIFY_AXIS_SHRINK 0.6 /* sqrt(1 - d^2): the pair keeps the parent's covariance */
enum {
    DENSIFY_CUT_SHARE = 4, /* of the room, for what sticks out */
    DENSIFY_CHUNK = 4096   /* rows that a thread takes at a time */
};
#define DENSIFY_SMALLEST_M 1e-4 /* scene units; smaller Gaussians are removed */

static size_t densify_at(size_t i, uint32_t planes, uint32_t plane)
{
    return layout_at(i, planes) + (size_t)plane * LAYOUT_LANES;
}

/* ---- geometry of one row ---- */

static void densify_rotation(const float *params, uint32_t planes, size_t i, double rot[9])
{
    double q[4];
    for (uint32_t k = 0; k < 4; k++)
        q[k] = (double)params[densify_at(i, planes, LAYOUT_PLANE_QUAT + k)];
    camera_quat_to_rot(q, rot);
}

static uint32_t densify_longest(const float *params, uint32_t planes, size_t i)
{
    uint32_t axis = 0;
    for (uint32_t k = 1; k < 3; k++)
        if (params[densify_at(i, planes, LAYOUT_PLANE_SCALE + k)] >
            params[densify_at(i, planes, LAYOUT_PLANE_SCALE + axis)])
            axis = k;
    return axis;
}

/* Of a half from its parent, along the parent's axes, m. */
static void densify_offset(const struct densify_input *in, struct densify_row row, double local[3])
{
    size_t i = row.source;
    bool second = row.kind == DENSIFY_SPLIT_B;
    uint32_t longest = densify_longest(in->params, in->planes, i);
    for (uint32_t k = 0; k < 3; k++) {
        double along = k != longest ? 0.0 : second ? DENSIFY_AXIS_OFFSET : -DENSIFY_AXIS_OFFSET;
        local[k] =
            along * exp((double)in->params[densify_at(i, in->planes, LAYOUT_PLANE_SCALE + k)]);
    }
}

/* Mean of a row of the plan, metres from the origin. */
static void densify_mean(const struct densify_input *in, struct densify_row row, float mean[3])
{
    size_t i = row.source;
    for (uint32_t k = 0; k < 3; k++)
        mean[k] = in->params[densify_at(i, in->planes, LAYOUT_PLANE_MEAN + k)];
    if (row.kind != DENSIFY_SPLIT_A && row.kind != DENSIFY_SPLIT_B)
        return;
    double rot[9], local[3];
    densify_rotation(in->params, in->planes, i, rot);
    densify_offset(in, row, local);
    for (int k = 0; k < 3; k++)
        mean[k] = (float)((double)mean[k] + rot[3 * k] * local[0] + rot[3 * k + 1] * local[1] +
                          rot[3 * k + 2] * local[2]);
}

/* Where nothing was reconstructed is nothing: a cloud there shows in few photographs as what lies
 * behind it and from all other sides as a cloud. */
static bool densify_in_free_space(const struct densify_params *p, const float mean[3])
{
    double at[3];
    for (int k = 0; k < 3; k++)
        at[k] = p->origin_enu_m[k] + (double)mean[k];
    return p->ground && footprint_off(p->ground, at) > p->free_space_m;
}

/* Photographs from above say little about how high a large Gaussian reaches, and nothing about how
 * it is tilted: from the side such are a veil. */
static bool densify_is_oversize(const struct densify_params *p, const float mean[3],
                                double largest_m)
{
    double at[3];
    if (!p->ground || !(p->size_limit_m > 0.0) || !(largest_m > p->size_limit_m))
        return false;
    for (int k = 0; k < 3; k++)
        at[k] = p->origin_enu_m[k] + (double)mean[k];
    return footprint_has(p->ground, at);
}

static double densify_distance(const struct densify_params *p, const float mean[3])
{
    return cell_distance(p->cell, p->origin_enu_m[0] + (double)mean[0],
                         p->origin_enu_m[1] + (double)mean[1]);
}

static bool densify_row_inside(const struct densify_params *p, const struct densify_input *in,
                               struct densify_row row)
{
    float mean[3];
    if (p->cell->whole)
        return true;
    densify_mean(in, row, mean);
    return densify_distance(p, mean) <= 0.0;
}

/* ---- choosing ---- */

enum densify_class { CLASS_KEEP, CLASS_PRUNE, CLASS_CLONE, CLASS_SPLIT, CLASS_CUT };

struct densify_lists {
    uint8_t *class, *inside;       /* [n], of the plan */
    bool known;                    /* both are filled */
    uint8_t *chosen;               /* [n] */
    uint32_t *drawn;               /* scratch for a draw, and the candidates behind it */
    struct densify_side {          /* 0 outside the cell, 1 inside */
        uint32_t *clones, *splits; /* candidates, ascending */
        size_t n_clones, n_splits, room;
    } side[2];
    size_t n_in, n_out;
};

/* Does it stick out of what photographs show? */
static enum trim_verdict densify_judge(const struct densify_params *p,
                                       const struct densify_input *in, size_t i,
                                       const float mean[3], double largest_m)
{
    double at[3], sigma[3], rot[9];
    if (!p->rim)
        return TRIM_INSIDE;
    for (uint32_t k = 0; k < 3; k++)
        at[k] = p->origin_enu_m[k] + (double)mean[k];
    if (trim_is_far(p->rim, at, largest_m))
        return TRIM_INSIDE;
    for (uint32_t k = 0; k < 3; k++)
        sigma[k] = exp((double)in->params[densify_at(i, in->planes, LAYOUT_PLANE_SCALE + k)]);
    densify_rotation(in->params, in->planes, (uint32_t)i, rot);
    return trim_judge(p->rim, at, sigma, rot, p->cut_above_m);
}

static enum densify_class densify_classify(const struct densify_params *p,
                                           const struct densify_input *in, size_t i, bool *inside)
{
    float mean[3];
    double largest = -HUGE_VAL;
    for (uint32_t k = 0; k < 3; k++) {
        mean[k] = in->params[densify_at(i, in->planes, LAYOUT_PLANE_MEAN + k)];
        largest =
            fmax(largest, (double)in->params[densify_at(i, in->planes, LAYOUT_PLANE_SCALE + k)]);
    }
    largest = exp(largest);
    double opacity =
        in->opacity
            ? (double)in->opacity[i]
            : 1.0 /
                  (1.0 + exp(-(double)in->params[densify_at(i, in->planes, LAYOUT_PLANE_OPACITY)]));
    double d = densify_distance(p, mean);
    *inside = d <= 0.0;
    if (!(opacity >= p->prune_opacity) || !(largest >= DENSIFY_SMALLEST_M) ||
        (p->prune_above_m > 0.0 && largest > p->prune_above_m) || densify_in_free_space(p, mean))
        return CLASS_PRUNE;
    enum trim_verdict rim = densify_judge(p, in, i, mean, largest);
    if (rim != TRIM_INSIDE)
        return rim == TRIM_OUTSIDE ? CLASS_PRUNE : CLASS_CUT;
    if (densify_is_oversize(p, mean, largest))
        return CLASS_CUT;
    double ramp = 1.0 + (p->tau_outside - 1.0) * fmin(d / p->cell->edge_m, 1.0);
    if (!((double)in->mean_grad[i] >= p->tau * ramp))
        return CLASS_KEEP;
    return largest > p->split_above_m ? CLASS_SPLIT : CLASS_CLONE;
}

/* Rows of a chunk, each by itself. */
struct densify_scan {
    const struct densify_params *p;
    const struct densify_input *in;
    const struct densify_plan *plan;
    size_t first, end;       /* rows of the part at hand */
    uint8_t *class, *inside; /* densify_classify_chunk */
    float *mean;             /* densify_mean_chunk: [end - first][3] */
};

static size_t densify_chunks(size_t n)
{
    return (n + DENSIFY_CHUNK - 1) / DENSIFY_CHUNK;
}

static size_t densify_chunk_end(const struct densify_scan *s, size_t chunk)
{
    const size_t end = s->first + (chunk + 1) * DENSIFY_CHUNK;
    return end < s->end ? end : s->end;
}

static enum err_code densify_classify_chunk(void *user, size_t chunk, struct err *e)
{
    const struct densify_scan *s = user;
    (void)e;
    for (size_t i = s->first + chunk * DENSIFY_CHUNK; i < densify_chunk_end(s, chunk); i++) {
        bool inside;
        s->class[i] = (uint8_t)densify_classify(s->p, s->in, i, &inside);
        s->inside[i] = inside;
    }
    return ERR_OK;
}

static enum err_code densify_classify_all(struct densify_scan *s, struct err *e)
{
    s->first = 0;
    s->end = s->in->n;
    return pool_for(densify_chunks(s->end), 0, densify_classify_chunk, s, e);
}

/* Room for as many candidates as there are. */
static enum err_code densify_alloc(const struct densify_input *in, struct densify_lists *w,
                                   struct err *e)
{
    size_t n[CLASS_CUT + 1][2] = {{0}}, drawn = 0, all = 0;
    for (size_t i = 0; i < in->n; i++)
        n[w->class[i]][w->inside[i]]++;
    drawn = n[CLASS_CUT][0] + n[CLASS_CUT][1];
    for (size_t side = 0; side < 2; side++)
        for (size_t c = CLASS_CLONE; c <= CLASS_SPLIT; c++) {
            all += n[c][side];
            drawn = n[c][side] > drawn ? n[c][side] : drawn;
        }
    w->drawn = mem_array(drawn + all, sizeof *w->drawn);
    if (!w->drawn)
        return err_set(e, ERR_MEM, "densify: out of memory for %zu candidates", all);
    uint32_t *to = w->drawn + drawn;
    for (size_t side = 0; side < 2; side++) {
        w->side[side].clones = to;
        w->side[side].splits = to + n[CLASS_CLONE][side];
        to += n[CLASS_CLONE][side] + n[CLASS_SPLIT][side];
    }
    return ERR_OK;
}

static void densify_list(const struct densify_input *in, struct densify_lists *w)
{
    for (size_t i = 0; i < in->n; i++) {
        enum densify_class c = (enum densify_class)w->class[i];
        bool inside = w->inside[i];
        if (c == CLASS_PRUNE)
            continue;
        w->n_in += inside;
        w->n_out += !inside;
        struct densify_side *side = inside ? &w->side[1] : &w->side[0];
        if (c == CLASS_CLONE)
            side->clones[side->n_clones++] = (uint32_t)i;
        else if (c == CLASS_SPLIT)
            side->splits[side->n_splits++] = (uint32_t)i;
    }
}

/* What taking this candidate adds inside and outside; a child of a split may cross the border. */
static void densify_gain(const struct densify_params *p, const struct densify_input *in,
                         const struct densify_lists *w, uint32_t i, int *in_gain, int *out_gain)
{
    if (w->class[i] == CLASS_CLONE) {
        *in_gain = w->inside[i];
        *out_gain = !w->inside[i];
        return;
    }
    int a = densify_row_inside(p, in, (struct densify_row){i, DENSIFY_SPLIT_A});
    int b = densify_row_inside(p, in, (struct densify_row){i, DENSIFY_SPLIT_B});
    *in_gain = a + b - w->inside[i];
    *out_gain = 2 - a - b - !w->inside[i];
}

/* Take a candidate if both ceilings allow. */
static bool densify_take(const struct densify_params *p, const struct densify_input *in,
                         struct densify_lists *w, uint32_t i)
{
    int gain_in, gain_out;
    densify_gain(p, in, w, i, &gain_in, &gain_out);
    if ((gain_in > 0 && w->n_in + (size_t)gain_in > p->cap_inside) ||
        (gain_out > 0 && w->n_out + (size_t)gain_out > p->cap_outside))
        return false;
    w->n_in += (size_t)(ptrdiff_t)gain_in;
    w->n_out += (size_t)(ptrdiff_t)gain_out;
    w->chosen[i] = 1;
    return true;
}

/* The candidates that stick out or are too long, those with the largest gradients first; equal ones
 * in their order. */
static enum err_code densify_cut_order(const struct densify_input *in, struct densify_lists *w,
                                       size_t *n_cut, struct err *e)
{
    size_t n = 0;
    for (size_t i = 0; i < in->n; i++)
        if (w->class[i] == CLASS_CUT)
            w->drawn[n++] = (uint32_t)i;
    *n_cut = n;
    struct sort_item *rank = mem_array(2 * n, sizeof *rank);
    if (!rank)
        return err_set(e, ERR_MEM, "densify: out of memory for %zu cuts", n);
    for (size_t k = 0; k < n; k++)
        rank[k] = (struct sort_item){UINT32_MAX - sort_key_float(in->mean_grad[w->drawn[k]]),
                                     w->drawn[k]};
    sort_items(rank, rank + n, n);
    for (size_t k = 0; k < n; k++)
        w->drawn[k] = rank[k].row;
    mem_free(rank);
    return ERR_OK;
}

/* What sticks out is halved first, in a part of the room: there is a next time. Where that is not
 * room enough, those go first that photographs want to move most
 * (docs/decisions/018-sizes-and-harmonics.md). */
static enum err_code densify_cut(const struct densify_params *p, const struct densify_input *in,
                                 struct densify_lists *w, size_t *taken, struct err *e)
{
    size_t n_cut = 0, room = p->cap_inside > w->n_in ? p->cap_inside - w->n_in : 0;
    if (!p->cell->whole && p->cap_outside > w->n_out)
        room += p->cap_outside - w->n_out;
    *taken = 0;
    enum err_code rc = densify_cut_order(in, w, &n_cut, e);
    for (size_t k = 0; !rc && k < n_cut && *taken < room / DENSIFY_CUT_SHARE; k++)
        *taken += densify_take(p, in, w, w->drawn[k]);
    return rc;
}

/* Draw `quota` of one class and mark them, keeping to both ceilings. */
static enum err_code densify_draw(const struct densify_params *p, const struct densify_input *in,
                                  struct densify_lists *w, const uint32_t *ids, size_t n,
                                  size_t quota, size_t *taken, struct err *e)
{
    /* Only a border can make the ceilings refuse one and call up the next in line. */
    size_t line = p->cell->whole ? quota : n;
    uint64_t stream = train_stream(TRAIN_STREAM_RACE, p->level, p->step);
    enum err_code rc = sample_race(in->score, ids, n, line, p->seed, stream, w->drawn, e);
    for (size_t j = 0; !rc && j < line && *taken < quota; j++)
        *taken += densify_take(p, in, w, w->drawn[j]);
    return rc;
}

static enum err_code densify_rows(const struct densify_input *in, const struct densify_lists *w,
                                  struct densify_plan *out, struct err *e)
{
    size_t n = 0;
    out->rows = mem_array(out->report.after, sizeof *out->rows);
    if (!out->rows)
        return err_set(e, ERR_MEM, "densify: out of memory for %zu Gaussians", out->report.after);
    for (size_t i = 0; i < in->n; i++) {
        uint32_t s = (uint32_t)i;
        if (w->class[i] == CLASS_PRUNE)
            continue;
        bool split = w->chosen[i] && w->class[i] != CLASS_CLONE;
        out->rows[n++] = (struct densify_row){s, split ? DENSIFY_SPLIT_A : DENSIFY_KEEP};
        if (w->chosen[i])
            out->rows[n++] = (struct densify_row){s, split ? DENSIFY_SPLIT_B : DENSIFY_CLONE};
    }
    out->n = n;
    return ERR_OK;
}

/* Room of one side: what its ceiling leaves, but no more than wants in. True when not all of them
 * can have it, or a split near the border could be refused. */
static bool densify_room(struct densify_side *side, size_t n, size_t cap, bool border)
{
    size_t wanted = side->n_clones + side->n_splits, left = cap > n ? cap - n : 0;
    side->room = left < wanted ? left : wanted;
    return side->room > 0 && (side->room < wanted || (border && left < 2 * wanted));
}

/* Shares of a room between its classes that leave none of it: exact in integers for any counts
 * below 2^32, and since the room is at most what is wanted, what clones leave is never more than
 * there are splits. */
static enum err_code densify_draw_side(const struct densify_params *p,
                                       const struct densify_input *in, struct densify_lists *w,
                                       const struct densify_side *side, struct densify_report *r,
                                       struct err *e)
{
    size_t wanted = side->n_clones + side->n_splits, cloned = 0, split = 0;
    if (!wanted)
        return ERR_OK;
    size_t clones = (size_t)((uint64_t)side->room * side->n_clones / wanted);
    size_t splits = side->room - clones;
    enum err_code rc = densify_draw(p, in, w, side->clones, side->n_clones, clones, &cloned, e);
    if (!rc)
        rc = densify_draw(p, in, w, side->splits, side->n_splits, splits, &split, e);
    r->cloned += cloned;
    r->split += split;
    return rc;
}

static enum err_code densify_fill(const struct densify_params *p, const struct densify_input *in,
                                  struct densify_lists *w, struct densify_plan *out, struct err *e)
{
    struct densify_report *r = &out->report;
    struct densify_side *inside = &w->side[1], *outside = &w->side[0];
    struct densify_scan scan = {.p = p, .in = in, .class = w->class, .inside = w->inside};
    enum err_code rc = w->known ? ERR_OK : densify_classify_all(&scan, e);
    if (!rc)
        rc = densify_alloc(in, w, e);
    if (rc)
        return rc;
    densify_list(in, w);
    size_t pruned = in->n - w->n_in - w->n_out, cut = 0;
    rc = densify_cut(p, in, w, &cut, e);
    if (rc)
        return rc;
    bool border = !p->cell->whole;
    bool binds = densify_room(inside, w->n_in, p->cap_inside, border);
    binds |= densify_room(outside, w->n_out, p->cap_outside, border);
    *r = (struct densify_report){.before = in->n,
                                 .pruned = pruned,
                                 .split = cut,
                                 .cut = cut,
                                 .clone_candidates = inside->n_clones + outside->n_clones,
                                 .split_candidates = inside->n_splits + outside->n_splits,
                                 .room = inside->room + outside->room};
    if (!in->score && binds) {
        r->needs_importance = true;
        return ERR_OK;
    }
    rc = densify_draw_side(p, in, w, inside, r, e);
    if (!rc)
        rc = densify_draw_side(p, in, w, outside, r, e);
    r->inside = w->n_in;
    r->outside = w->n_out;
    r->after = w->n_in + w->n_out;
    return rc ? rc : densify_rows(in, w, out, e);
}

static void densify_forget_classes(struct densify_plan *p)
{
    mem_free(p->class);
    mem_free(p->inside);
    p->class = p->inside = NULL;
}

/* `out` has the classes, known or not. */
static enum err_code densify_choose(const struct densify_params *p, const struct densify_input *in,
                                    bool known, struct densify_plan *out, struct err *e)
{
    struct densify_lists w = {.class = out->class, .inside = out->inside, .known = known};
    enum err_code rc = ERR_OK;
    w.chosen = mem_array(in->n, 1);
    if (!w.class || !w.inside || !w.chosen)
        rc = err_set(e, ERR_MEM, "densify: out of memory for %zu Gaussians", in->n);
    else
        rc = densify_fill(p, in, &w, out, e);
    mem_free(w.chosen);
    mem_free(w.drawn);
    if (rc)
        densify_plan_free(out);
    else if (!out->report.needs_importance)
        densify_forget_classes(out);
    return rc;
}

enum err_code densify_plan_make(const struct densify_params *p, const struct densify_input *in,
                                struct densify_plan *out, struct err *e)
{
    *out = (struct densify_plan){0};
    if (in->n > UINT32_MAX / 2)
        return err_set(e, ERR_LIMIT, "densify: %zu Gaussians are more than one cell can hold",
                       in->n);
    out->class = mem_array(in->n, 1);
    out->inside = mem_array(in->n, 1);
    return densify_choose(p, in, false, out, e);
}

enum err_code densify_plan_score(const struct densify_params *p, const struct densify_input *in,
                                 struct densify_plan *plan, struct err *e)
{
    assert(plan->report.needs_importance && in->score);
    return densify_choose(p, in, true, plan, e);
}

void densify_plan_free(struct densify_plan *p)
{
    mem_free(p->rows);
    densify_forget_classes(p);
    *p = (struct densify_plan){0};
}

/* ---- applying ---- */

/* Row d holds a copy of a parent: make it one of its halves. */
static void densify_halve_row(const struct densify_order *o, float *params, size_t d,
                              const float mean[3])
{
    uint32_t planes = o->rows.planes, longest = densify_longest(params, planes, d);
    for (uint32_t k = 0; k < 3; k++) {
        float *scale = &params[densify_at(d, planes, LAYOUT_PLANE_SCALE + k)];
        params[densify_at(d, planes, LAYOUT_PLANE_MEAN + k)] = mean[k];
        if (k == longest)
            *scale += (float)log(DENSIFY_AXIS_SHRINK);
    }
    /* 2 x 0.6 sigma long: as much mass needs 1 / 1.2 of the opacity. */
    float *logit = &params[densify_at(d, planes, LAYOUT_PLANE_OPACITY)];
    double opacity = 0.5 / DENSIFY_AXIS_SHRINK / (1.0 + exp(-(double)*logit));
    *logit = (float)log(opacity / (1.0 - opacity));
}

void densify_halve(const struct densify_order *o, float *params)
{
    for (size_t i = 0; i < o->n_split; i++)
        densify_halve_row(o, params, o->split[i], o->mean + 3 * i);
}

static bool densify_is_half(struct densify_row row)
{
    return row.kind == DENSIFY_SPLIT_A || row.kind == DENSIFY_SPLIT_B;
}

static enum err_code densify_mean_chunk(void *user, size_t chunk, struct err *e)
{
    const struct densify_scan *s = user;
    (void)e;
    for (size_t i = s->first + chunk * DENSIFY_CHUNK; i < densify_chunk_end(s, chunk); i++)
        densify_mean(s->in, s->plan->rows[i], s->mean + 3 * (i - s->first));
    return ERR_OK;
}

/* Means of rows [from, to) of the plan, whose sources ascend. */
static enum err_code densify_means(void *user, size_t from, size_t to, float *out, struct err *e)
{
    struct densify_scan *s = user;
    s->first = from;
    s->end = to;
    s->mean = out;
    return pool_for(densify_chunks(to - from), 0, densify_mean_chunk, s, e);
}

/* Along the curve, or as they are; which row of the plan comes where is forgotten once rows and
 * halves are known. */
static enum err_code densify_sort(struct densify_scan *s, uint32_t *source, struct densify_order *o,
                                  struct err *e)
{
    const struct densify_plan *plan = s->plan;
    const struct gauss_places places = {plan->n, densify_means, s};
    size_t n = 0;
    enum err_code rc = s->p->keep_order ? ERR_OK : gauss_morton_order_of(&places, source, e);
    if (rc)
        return rc;
    for (size_t d = 0; s->p->keep_order && d < plan->n; d++)
        source[d] = (uint32_t)d;
    for (size_t d = 0; d < plan->n; d++)
        o->n_split += densify_is_half(plan->rows[d]);
    o->split = mem_array(o->n_split, sizeof *o->split);
    o->mean = mem_array(3 * o->n_split, sizeof *o->mean);
    if (!o->split || !o->mean)
        return err_set(e, ERR_MEM, "densify: out of memory for %zu halves", o->n_split);
    for (size_t d = 0; d < plan->n; d++) {
        uint32_t at = source[d];
        struct densify_row row = plan->rows[at];
        source[d] = row.source | (row.kind == DENSIFY_KEEP ? 0 : PERMUTE_NEW);
        if (!densify_is_half(row))
            continue;
        o->split[n] = (uint32_t)d;
        densify_mean(s->in, row, o->mean + 3 * n++);
    }
    return ERR_OK;
}

enum err_code densify_order(const struct densify_params *p, const struct densify_input *in,
                            const struct densify_plan *plan, struct densify_order *out,
                            struct err *e)
{
    uint32_t *source = mem_array(plan->n, sizeof *source);
    struct densify_scan scan = {.p = p, .in = in, .plan = plan};
    *out = (struct densify_order){.rows = {source, plan->n, in->n, in->planes}};
    enum err_code rc =
        source ? densify_sort(&scan, source, out, e)
               : err_set(e, ERR_MEM, "densify: out of memory for %zu Gaussians", plan->n);
    if (rc)
        densify_order_free(out);
    return rc;
}

void densify_order_free(struct densify_order *o)
{
    mem_free((void *)(uintptr_t)o->rows.source);
    mem_free(o->split);
    mem_free(o->mean);
    *o = (struct densify_order){0};
}
