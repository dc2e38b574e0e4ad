/* Contribution pruning: Gaussians that add next to nothing to any training photograph cost bytes
 * and time for ever after. The score is the blending weight itself, the sum of alpha T over all
 * pixels of all training views; the faintest go that together hold no more than a given share of
 * all weight, which bounds what can change whatever the size of pictures and Gaussians. Support,
 * the number of photographs that see a Gaussian, finds floaters close to one camera.
 *
 * One pass over the photographs measures, a second one checks: a removal that costs more than the
 * option allows is taken back. Views are added in the order of the list.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/prune.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "loss/photometric.h"
#include "render/permute.h"
#include "train/context.h"
#include "train/model.h"
#include "train/photo_loader.h"
#include "train/residual.h"

enum { PRUNE_SUMS = 8, PRUNE_PIXELS = 1, PRUNE_SHARE = 2 };

struct prune {
    struct model *m;
    struct context *ctx;
    struct render_importance *device;
    cl_mem weight; /* zeros: only alpha T is of interest */
    size_t weight_bytes;
    float *total;                    /* [n] */
    uint16_t *views;                 /* [n] */
    struct residual_list *residuals; /* NULL: not wanted (any more) */
};

/* Draw a photograph; its squared error. */
static enum err_code prune_draw(struct prune *c, size_t nth, double *mse, struct err *e)
{
    struct context *ctx = c->ctx;
    struct photo p;
    struct photometric_value v = {0};
    enum err_code rc = photo_loader_get_nth(ctx->photos, nth, &p, e);
    if (rc)
        return rc;
    struct render_options ro = context_photo_options(ctx, ctx->step, p.image);
    rc = render_forward(ctx->render, &c->m->gauss, &p.cam, &ro, NULL, NULL, e);
    if (!rc)
        rc = context_photo_value(ctx, &p, e);
    if (!rc)
        rc = photometric_read(ctx->loss, &v, e);
    *mse += v.mse / (double)ctx->n_images;
    if (!rc && c->residuals)
        rc = residual_add(c->residuals, p.name, v.mse, v.ssim, e);
    size_t bytes = (size_t)p.cam.width_px * p.cam.height_px * sizeof(float);
    if (rc || !c->device || bytes <= c->weight_bytes)
        return rc;
    dev_release(&c->weight);
    c->weight_bytes = 0;
    rc = dev_buffer(ctx->dev, bytes, NULL, &c->weight, e);
    if (!rc)
        rc = dev_zero(ctx->dev, c->weight, 0, bytes, e);
    c->weight_bytes = rc ? 0 : bytes;
    return rc;
}

static enum err_code prune_measure(struct prune *c, double *mse, struct err *e)
{
    struct model *m = c->m;
    struct context *ctx = c->ctx;
    size_t n = m->gauss.n;
    c->total = mem_array(n, sizeof(float));
    c->views = mem_array(n, sizeof(uint16_t));
    if (!c->total || !c->views)
        return err_set(e, ERR_MEM, "pruning: out of memory for %zu Gaussians", n);
    enum err_code rc = render_importance_open(ctx->render, &c->device, e);
    if (!rc)
        rc = context_filter(ctx, m, e);
    for (size_t v = 0; !rc && v < ctx->n_images; v++) {
        const float *sums = NULL;
        rc = prune_draw(c, v, mse, e);
        if (!rc)
            rc = render_importance_run(c->device, &m->gauss, c->weight, &sums, e);
        for (size_t i = 0; !rc && i < n; i++) {
            c->total[i] += sums[PRUNE_SUMS * i + PRUNE_SHARE];
            if (sums[PRUNE_SUMS * i + PRUNE_PIXELS] > 0.0f && c->views[i] < UINT16_MAX)
                c->views[i]++;
        }
        if (!rc && signals_stopping())
            rc = err_set(e, ERR_CANCEL, "stopped while pruning");
    }
    return rc;
}

static int prune_compare(const void *a, const void *b)
{
    float x, y;
    memcpy(&x, a, sizeof x);
    memcpy(&y, b, sizeof y);
    return (x > y) - (x < y);
}

void prune_choose(const float *sum, const uint16_t *views, size_t n, double share,
                  uint32_t least_views, float *scratch, uint8_t *keep, struct prune_report *out)
{
    double all = 0.0, given = 0.0;
    float limit = 0.0f; /* those with at least this stay */
    memcpy(scratch, sum, n * sizeof *sum);
    qsort(scratch, n, sizeof *scratch, prune_compare);
    for (size_t i = 0; i < n; i++)
        all += (double)scratch[i];
    for (size_t i = 0; i < n && given <= share * all; i++) {
        limit = scratch[i];
        given += (double)scratch[i];
    }
    for (size_t i = 0; i < n; i++) {
        bool faint = share > 0.0 && sum[i] < limit, alone = views[i] < least_views;
        keep[i] = !faint && !alone;
        out->faint += faint;
        out->unsupported += alone && !faint;
    }
}

/* ---- removing rows ---- */

/* Rows that stay in front, the others behind them, each in their order; and the inverse. */
static void prune_order(const uint8_t *keep, size_t n, size_t n_keep, uint32_t *there,
                        uint32_t *back)
{
    size_t front = 0, behind = n_keep;
    for (size_t i = 0; i < n; i++) {
        size_t d = keep[i] ? front++ : behind++;
        there[d] = (uint32_t)i;
        back[i] = (uint32_t)d;
    }
}

/* Keep the rows of `keep`, look at the photographs again, take it back if need be: until then those
 * that go lie behind the last row that is drawn. */
static enum err_code prune_apply(struct prune *c, const uint8_t *keep, size_t n_keep, double mse,
                                 struct prune_report *r, struct err *e)
{
    struct model *m = c->m;
    struct context *ctx = c->ctx;
    size_t n = m->gauss.n;
    uint32_t planes = m->gauss.planes, *order = mem_array(2 * n, sizeof *order);
    double after = 0.0;
    if (!order)
        return err_set(e, ERR_MEM, "pruning: out of memory for %zu Gaussians", n);
    prune_order(keep, n, n_keep, order, order + n);
    enum err_code rc = model_move(m, &(struct permutation){order, n, n, planes}, n, e);
    if (!rc)
        rc = model_show(m, n_keep, e);
    if (!rc)
        rc = context_filter(ctx, m, e);
    c->residuals = NULL; /* the second pass only draws */
    for (size_t v = 0; !rc && v < ctx->n_images; v++)
        rc = prune_draw(c, v, &after, e);
    r->psnr_before_db = -10.0 * log10(mse);
    r->psnr_after_db = -10.0 * log10(after);
    r->undone = !(r->psnr_after_db >= r->psnr_before_db - ctx->cfg->prune_loss_db);
    if (!rc && r->undone)
        rc = model_show(m, n, e);
    if (!rc && r->undone)
        rc = model_move(m, &(struct permutation){order + n, n, n, planes}, n, e);
    else if (!rc)
        rc = model_forget(m, e);
    mem_free(order);
    return rc;
}

enum err_code prune_level(struct model *m, struct context *ctx, struct prune_report *out,
                          struct residual_list *residuals, struct err *e)
{
    struct prune c = {.m = m, .ctx = ctx, .residuals = residuals};
    double mse = 0.0;
    size_t n = m->gauss.n;
    uint32_t support = (uint32_t)ctx->cfg->prune_support;
    *out = (struct prune_report){.before = n};
    if (!(ctx->cfg->prune_contribution > 0.0) && !support)
        return ERR_OK;
    if (ctx->n_images < 2 * support) /* then few views are all there are */
        support = 0;
    uint8_t *keep = mem_array(n, 1);
    enum err_code rc = keep ? prune_measure(&c, &mse, e)
                            : err_set(e, ERR_MEM, "pruning: out of memory for %zu Gaussians", n);
    render_importance_close(&c.device);
    float *scratch = rc ? NULL : mem_array(n, sizeof *scratch);
    if (!rc && !scratch)
        rc = err_set(e, ERR_MEM, "pruning: out of memory for %zu Gaussians", n);
    if (!rc)
        prune_choose(c.total, c.views, n, ctx->cfg->prune_contribution, support, scratch, keep,
                     out);
    mem_free(scratch);
    mem_free(c.total);
    mem_free(c.views);
    size_t n_keep = n - out->faint - out->unsupported;
    if (!rc && n_keep && n_keep < n)
        rc = prune_apply(&c, keep, n_keep, mse, out, e);
    dev_release(&c.weight);
    mem_free(keep);
    return rc;
}
