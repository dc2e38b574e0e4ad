/* Contribution pruning: Gaussians that add almost nothing to any training photograph cost bytes and
 * time. The score of a Gaussian is its blending weight: the sum of alpha T over all pixels of the
 * training views, divided by the number of views that show it. The division is fair to the rim of a
 * survey, where few views show a Gaussian. Candidates are the faintest ones, which together have at
 * most a given share of all scores, and those that few photographs see: floaters close to one
 * camera.
 *
 * Candidates are moved behind all others, the weakest last, so drawing fewer rows means drawing
 * without the weakest. The number to remove is found by trials: a few photographs are drawn again
 * and may lose no more than the option allows. What they lose is about a power of the scores that
 * were removed, so where the limit lies is guessed from the trials before. One pass over all
 * photographs measures scores: what is hidden in some of them is often what closes a gap in the
 * others.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/density/prune.h"

#include <math.h>
#include <string.h>

#include "core/layout.h"
#include "core/math/sort.h"
#include "core/pool.h"
#include "render/permute.h"
#include "train/base/stage.h"
#include "train/loss/photometric.h"
#include "train/model/model.h"
#include "train/photographs/gallery.h"
#include "train/photographs/photo_loader.h"
#include "train/photographs/residual.h"

enum {
    PRUNE_CHECKS = 8,   /* photographs that are drawn again */
    PRUNE_TRIALS = 6,   /* at most */
    PRUNE_NEAR = 32,    /* a 32nd of the candidates is near enough */
    PRUNE_CHUNK = 16384 /* Gaussians that a thread takes at a time */
};
#define PRUNE_POWER 1.5 /* loss over scores: 1.2 to 1.7 were seen */
#define PRUNE_AIM 0.9   /* of the loss that is allowed; */
#define PRUNE_ENOUGH 0.7
#define PRUNE_FAR 8.0 /* a loss of so many times what is allowed tells little of where it lies */

struct prune {
    struct model *m;
    struct gallery *gallery;
    const struct stage *at;
    const struct footprint *ground;
    struct render_importance *device;
    struct model_look look;          /* what the last view shows of the model */
    const float *sums;               /* [look.shown.n][LAYOUT_IMPORTANCE_SUMS] of it, mapped */
    float *total;                    /* [n] */
    double *mse;                     /* [n_images] of photographs as they were drawn first */
    uint16_t *views;                 /* [n] */
    struct residual_list *residuals; /* NULL: not wanted (any more) */
};

/* Draw a photograph; its squared error. */
static enum err_code prune_draw(struct prune *c, size_t nth, double *mse, struct err *e)
{
    struct gallery *g = c->gallery;
    struct photo p;
    struct photometric_value v = {0};
    enum err_code rc = photo_loader_get_nth(g->photos, nth, &p, e);
    if (rc)
        return rc;
    struct render_options ro = gallery_photo_options(g, c->at, p.image);
    ro.picture = !c->device; /* of those that are drawn again nobody sums weights */
    ro.shares = c->device != NULL;
    rc = model_look(c->m, &p.cam, &ro, &c->look, e);
    if (!rc)
        rc = gallery_score(g, &p, &c->look.shown, &ro, c->residuals != NULL, &v, e);
    *mse = v.mse;
    if (!rc && c->residuals)
        rc = residual_add(c->residuals, p.name, residual_mse(&p, v.mse), residual_ssim(&p, v.ssim),
                          residual_coverage(c->ground, &p.cam), e);
    return rc;
}

/* What a view adds to the scores of a chunk of Gaussians. */
static enum err_code prune_add_chunk(void *user, size_t chunk, struct err *e)
{
    const struct prune *c = user;
    size_t n = c->look.shown.n, end = (chunk + 1) * PRUNE_CHUNK < n ? (chunk + 1) * PRUNE_CHUNK : n;
    (void)e;
    for (size_t i = chunk * PRUNE_CHUNK; i < end; i++) {
        const size_t row = model_look_row(&c->look, i);
        c->total[row] += c->sums[LAYOUT_IMPORTANCE_SUMS * i + LAYOUT_IMPORTANCE_SHARE];
        if (c->sums[LAYOUT_IMPORTANCE_SUMS * i + LAYOUT_IMPORTANCE_PIXELS] > 0.0f &&
            c->views[row] < UINT16_MAX)
            c->views[row]++;
    }
    return ERR_OK;
}

/* What the frame that was drawn adds. */
static enum err_code prune_add(struct prune *c, struct err *e)
{
    enum err_code rc = render_share_run(c->device, &c->look.shown, &c->sums, e);
    if (!rc)
        rc = model_look_map(c->m, &c->look, e);
    if (!rc)
        rc = pool_for((c->look.shown.n + PRUNE_CHUNK - 1) / PRUNE_CHUNK, 0, prune_add_chunk, c, e);
    return rc ? rc : model_look_unmap(c->m, &c->look, e);
}

static enum err_code prune_measure(struct prune *c, struct err *e)
{
    struct model *m = c->m;
    struct gallery *g = c->gallery;
    size_t n = m->gauss.n;
    c->total = mem_array(n, sizeof(float));
    c->views = mem_array(n, sizeof(uint16_t));
    c->mse = mem_array(g->n_images, sizeof(double));
    if (!c->total || !c->views || !c->mse)
        return err_set(e, ERR_MEM, "pruning: out of memory for %zu Gaussians", n);
    enum err_code rc = render_importance_open(g->engine.render, &c->device, e);
    for (size_t nth = 0; !rc && nth < g->n_images; nth++) {
        rc = prune_draw(c, nth, &c->mse[nth], e);
        if (!rc)
            rc = prune_add(c, e);
        if (!rc && signals_stopping())
            rc = err_set(e, ERR_CANCEL, "stopped while pruning");
    }
    return rc;
}

void prune_choose(float *sum, const uint16_t *views, size_t n, const struct prune_rule *rule,
                  double *scratch, uint8_t *keep, struct prune_report *out)
{
    double all = 0.0, given = 0.0;
    float limit = 0.0f; /* those with at least this stay */
    for (size_t i = 0; i < n; i++) {
        sum[i] /= (float)(views[i] ? views[i] : 1);
        scratch[i] = (double)sum[i];
    }
    sort_doubles(scratch, n);
    for (size_t i = 0; i < n; i++)
        all += scratch[i];
    for (size_t i = 0; i < n && given <= rule->share * all; i++) {
        limit = (float)scratch[i];
        given += scratch[i];
    }
    for (size_t i = 0; i < n; i++) {
        bool faint = rule->share > 0.0 && sum[i] < limit, alone = views[i] < rule->least_views;
        keep[i] = !faint && !alone;
        out->faint += faint;
        out->unsupported += alone && !faint;
    }
}

/* ---- removing rows ---- */

/* Rows that stay in front, in their order; candidates behind them, the weakest last. */
static enum err_code prune_order(const struct prune *c, const uint8_t *keep, size_t n,
                                 size_t n_keep, uint32_t *order, struct err *e)
{
    size_t front = 0, behind = 0, n_behind = n - n_keep;
    struct sort_item *rank = mem_array(2 * n_behind, sizeof *rank);
    if (!rank)
        return err_set(e, ERR_MEM, "pruning: out of memory for %zu candidates", n_behind);
    for (size_t i = 0; i < n; i++)
        if (keep[i])
            order[front++] = (uint32_t)i;
        else
            rank[behind++] =
                (struct sort_item){UINT32_MAX - sort_key_float(c->total[i]), (uint32_t)i};
    sort_items(rank, rank + n_behind, n_behind);
    for (size_t k = 0; k < n_behind; k++)
        order[n_keep + k] = rank[k].row;
    mem_free(rank);
    return ERR_OK;
}

/* PSNR of some photographs, drawn with the first n rows; n 0: as they were at first. */
static enum err_code prune_psnr(struct prune *c, size_t n, double *db, struct err *e)
{
    const size_t all = c->gallery->n_images, m = all < PRUNE_CHECKS ? all : PRUNE_CHECKS;
    double sum = 0.0;
    enum err_code rc = n ? model_show(c->m, n, e) : ERR_OK;
    for (size_t k = 0; !rc && k < m; k++) { /* spread evenly over all */
        size_t nth = k * all / m;
        double mse = c->mse[nth];
        if (n)
            rc = prune_draw(c, nth, &mse, e);
        sum += mse / (double)m;
    }
    *db = -10.0 * log10(sum);
    return rc;
}

size_t prune_next(const double *sum, const struct prune_trial *lo, const struct prune_trial *hi,
                  double aim_db)
{
    size_t least = lo->go + 1, most = hi->go - 1;
    double from = sum[lo->go], to = sum[hi->go], power = PRUNE_POWER;
    bool both = lo->lost_db > 0.0 && from > 0.0;
    if (both)
        power = log(hi->lost_db / lo->lost_db) / log(to / from);
    double want = both && hi->lost_db > PRUNE_FAR * aim_db
                      ? sqrt(from * to)
                      : to * pow(aim_db / hi->lost_db, 1.0 / power);
    if (!(want > from && want < to))
        return least + (most - least) / 2;
    while (least < most) {
        size_t mid = least + (most - least + 1) / 2;
        if (sum[mid] <= want)
            least = mid;
        else
            most = mid - 1;
    }
    return least;
}

/* How many of the candidates, the last rows, can go. */
static enum err_code prune_search(struct prune *c, const double *sum, size_t n, size_t n_candidates,
                                  struct prune_report *r, struct err *e)
{
    const double limit = c->gallery->cfg->prune_loss_db;
    struct prune_trial lo = {0}, hi = {n_candidates + 1, HUGE_VAL};
    const size_t n_images = c->gallery->n_images;
    double before, all = 0.0;
    enum err_code rc = prune_psnr(c, 0, &before, e);
    for (size_t k = 0; k < n_images; k++)
        all += c->mse[k] / (double)n_images;
    r->psnr_before_db = -10.0 * log10(all);
    for (int k = 0; !rc && k < PRUNE_TRIALS && lo.go + 1 < hi.go; k++) {
        size_t go = k ? prune_next(sum, &lo, &hi, PRUNE_AIM * limit) : n_candidates;
        double db;
        rc = prune_psnr(c, n - go, &db, e);
        bool low = db >= before - limit;
        *(low ? &lo : &hi) = (struct prune_trial){go, before - db};
        if (!rc && signals_stopping())
            rc = err_set(e, ERR_CANCEL, "stopped while pruning");
        if (lo.go &&
            (lo.lost_db >= PRUNE_ENOUGH * limit || hi.go - lo.go <= n_candidates / PRUNE_NEAR))
            break;
    }
    r->removed = rc ? 0 : lo.go;
    r->lost_db = lo.lost_db;
    return rc;
}

/* Scores of the weakest so many candidates, sum [n_candidates + 1]. */
static void prune_sum(const struct prune *c, const uint32_t *order, size_t n, size_t n_candidates,
                      double *sum)
{
    sum[0] = 0.0;
    for (size_t k = 0; k < n_candidates; k++)
        sum[k + 1] = sum[k] + (double)c->total[order[n - 1 - k]];
}

/* Put candidates behind, see how many can go, and put the rest back where they were. */
static enum err_code prune_apply(struct prune *c, const uint8_t *keep, size_t n_keep,
                                 struct prune_report *r, struct err *e)
{
    struct model *m = c->m;
    struct err why = {0};
    size_t n = m->gauss.n, left = 0;
    uint32_t planes = m->gauss.planes, *order = mem_array(2 * n, sizeof *order);
    double *sum = mem_array(n - n_keep + 1, sizeof *sum);
    uint32_t *back = order + n;
    enum err_code rc = order && sum
                           ? prune_order(c, keep, n, n_keep, order, e)
                           : err_set(e, ERR_MEM, "pruning: out of memory for %zu Gaussians", n);
    if (!rc)
        rc = model_move(m, &(struct permutation){order, n, n, planes}, n, e);
    if (rc) {
        mem_free(sum);
        mem_free(order);
        return rc;
    }
    prune_sum(c, order, n, n - n_keep, sum);
    c->residuals = NULL; /* they know these photographs */
    rc = prune_search(c, sum, n, n - n_keep, r, e);
    mem_free(sum);
    for (size_t i = 0; i < n; i++)
        back[i] = UINT32_MAX;
    for (size_t d = 0; d < n - r->removed; d++)
        back[order[d]] = (uint32_t)d;
    for (size_t i = 0; i < n; i++)
        if (back[i] != UINT32_MAX)
            order[left++] = back[i];
    enum err_code done = model_show(m, n, &why);
    if (!done)
        done = model_move(m, &(struct permutation){order, left, n, planes}, n, &why);
    if (!rc && done)
        rc = err_set(e, done, "%s", why.msg);
    mem_free(order);
    return rc;
}

enum err_code prune_level(struct model *m, struct gallery *g, const struct footprint *ground,
                          const struct stage *at, struct prune_report *out,
                          struct residual_list *residuals, struct err *e)
{
    struct prune c = {.m = m, .gallery = g, .at = at, .ground = ground, .residuals = residuals};
    size_t n = m->gauss.n;
    uint32_t support = (uint32_t)g->cfg->prune_support;
    *out = (struct prune_report){.before = n};
    if (!(g->cfg->prune_contribution > 0.0) && !support && !residuals)
        return ERR_OK;
    if (g->n_images < 2 * support) /* then few say nothing */
        support = 0;
    uint8_t *keep = mem_array(n, 1);
    enum err_code rc = keep ? prune_measure(&c, e)
                            : err_set(e, ERR_MEM, "pruning: out of memory for %zu Gaussians", n);
    render_importance_close(&c.device);
    double *scratch = rc ? NULL : mem_array(n, sizeof *scratch);
    if (!rc && !scratch)
        rc = err_set(e, ERR_MEM, "pruning: out of memory for %zu Gaussians", n);
    if (!rc)
        prune_choose(c.total, c.views, n, &(struct prune_rule){g->cfg->prune_contribution, support},
                     scratch, keep, out);
    mem_free(scratch);
    size_t n_keep = n - out->faint - out->unsupported;
    if (!rc && n_keep && n_keep < n)
        rc = prune_apply(&c, keep, n_keep, out, e);
    mem_free(c.total);
    mem_free(c.views);
    mem_free(c.mse);
    mem_free(keep);
    return rc;
}
