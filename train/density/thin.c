/* Thinning: no more Gaussians than a scene needs, or than a level may have.
 *
 * While a level grows, gradients ask for Gaussians wherever there is error. Many of them repeat
 * what is there. Once growth has ended, every Gaussian has a price: the squared change of all
 * pixels of all training photographs if it alone were not drawn. It is the second-order term of the
 * rise of the squared error; the first-order term is near 0 in a trained model. What lies behind
 * shows through, so a Gaussian in front of others of its colour costs little, and the only one
 * before a background of another colour costs much.
 *
 * The cheapest go until the level has its number. The steps that remain repair most of the loss. It
 * happens a few times, since a price holds while the neighbours stay.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/density/thin.h"

#include <math.h>

#include "core/layout.h"
#include "core/math/sort.h"
#include "core/pool.h"
#include "render/permute.h"
#include "train/base/config.h"
#include "train/base/stage.h"
#include "train/loss/photometric.h"
#include "train/model/model.h"
#include "train/photographs/background.h"
#include "train/photographs/gallery.h"
#include "train/photographs/photo_loader.h"

enum {
    THIN_STEPS = 20,       /* of the finest level for a photograph that is drawn */
    THIN_AGAIN = 3,        /* of a derived level */
    THIN_LEAST = 16,       /* photographs that are drawn, if there are so many */
    THIN_LEAST_AGAIN = 96, /* of a derived level */
    THIN_CHUNK = 16384     /* Gaussians that a thread takes at a time */
};

struct thin {
    struct model *m;
    struct gallery *gallery;
    struct background *background;
    const struct site *site;
    const struct stage *at;
    uint32_t nth; /* thinning of the level, from 1 */
    struct render_importance *device;
    cl_mem weight; /* float [h][w]: 0 where the photograph is masked */
    size_t weight_bytes;
    float *pixels; /* its copy here */
    size_t pixels_cap;
    struct model_look look; /* what the last photograph shows of the model */
    const float *sums;      /* [look.shown.n][LAYOUT_IMPORTANCE_SUMS] of it, mapped */
    float *rise;            /* [n] */
    uint16_t *views;        /* [n] photographs that show it */
    float scale;            /* of the last photograph's sums: to a mean over pixels and channels */
    double error;           /* sum of the mean squared errors of the photographs */
};

/* Weights of the photograph's pixels, on the device. */
static enum err_code thin_weigh(struct thin *c, const struct photo *p, struct err *e)
{
    struct dev *dev = c->gallery->engine.dev;
    size_t n = (size_t)p->cam.width_px * p->cam.height_px, bytes = n * sizeof(float);
    if (n > c->pixels_cap) {
        mem_free(c->pixels);
        c->pixels_cap = 0;
        c->pixels = mem_array(n, sizeof *c->pixels);
        if (!c->pixels)
            return err_set(e, ERR_MEM, "thinning: out of memory for %zu pixels", n);
        c->pixels_cap = n;
    }
    for (size_t i = 0; i < n; i++)
        c->pixels[i] = p->mask && !p->mask[i] ? 0.0f : 1.0f;
    enum err_code rc = dev_reserve(dev, bytes, &c->weight, &c->weight_bytes, e);
    c->scale = 1.0f / (3.0f * (float)n);
    return rc ? rc : dev_write(dev, c->weight, 0, bytes, c->pixels, e);
}

/* Draws a photograph as a step would, and adds its error. */
static enum err_code thin_draw(struct thin *c, size_t nth, struct err *e)
{
    struct gallery *g = c->gallery;
    struct photo p;
    struct photometric_value v = {0};
    const uint8_t *supported;
    enum err_code rc = photo_loader_get_nth(g->photos, nth, &p, e);
    if (rc)
        return rc;
    struct render_options ro = gallery_photo_options(g, c->at, p.image);
    rc = background_support(c->background, c->site->ground, &p, &supported, e);
    if (rc)
        return rc;
    background_choose(c->background, g->cfg, supported, c->at, &p, &ro);
    rc = model_look(c->m, &p.cam, &ro, &c->look, e);
    if (!rc)
        rc = gallery_score(g, &p, &c->look.shown, &ro, false, &v, e);
    c->error += isfinite(v.mse) ? v.mse : 0.0;
    return rc ? rc : thin_weigh(c, &p, e);
}

static enum err_code thin_add_chunk(void *user, size_t chunk, struct err *e)
{
    const struct thin *c = user;
    size_t n = c->look.shown.n, end = (chunk + 1) * THIN_CHUNK < n ? (chunk + 1) * THIN_CHUNK : n;
    (void)e;
    for (size_t i = chunk * THIN_CHUNK; i < end; i++) {
        const float *sums = c->sums + LAYOUT_IMPORTANCE_SUMS * i;
        const size_t row = model_look_row(&c->look, i);
        c->rise[row] += c->scale * sums[LAYOUT_REMOVAL_RISE];
        if (sums[LAYOUT_IMPORTANCE_PIXELS] > 0.0f && c->views[row] < UINT16_MAX)
            c->views[row]++;
    }
    return ERR_OK;
}

/* What the frame that was drawn adds. */
static enum err_code thin_add(struct thin *c, struct err *e)
{
    enum err_code rc = render_removal_run(c->device, &c->look.shown, c->weight, &c->sums, e);
    if (!rc)
        rc = model_look_map(c->m, &c->look, e);
    if (!rc)
        rc = pool_for((c->look.shown.n + THIN_CHUNK - 1) / THIN_CHUNK, 0, thin_add_chunk, c, e);
    return rc ? rc : model_look_unmap(c->m, &c->look, e);
}

/* Spread over the list, and others at each thinning. */
static size_t thin_nth(uint32_t nth, size_t v, size_t n_views, size_t n)
{
    return (SCHEDULE_THINNINGS * v + nth - 1) * n / (SCHEDULE_THINNINGS * n_views);
}

static enum err_code thin_measure(struct thin *c, size_t n_views, struct err *e)
{
    struct gallery *g = c->gallery;
    enum err_code rc = render_importance_open(g->engine.render, &c->device, e);
    for (size_t v = 0; !rc && v < n_views; v++) {
        rc = thin_draw(c, thin_nth(c->nth, v, n_views, g->n_images), e);
        if (!rc)
            rc = thin_add(c, e);
        if (!rc && signals_stopping())
            rc = err_set(e, ERR_CANCEL, "stopped while thinning");
    }
    render_importance_close(&c->device);
    return rc;
}

enum err_code thin_choose(const float *rise, const uint16_t *views, size_t n,
                          const struct thin_rule *rule, uint32_t *keep, size_t *n_keep,
                          double *given, struct err *e)
{
    size_t gone[THIN_SIDES] = {0};
    struct sort_item *rank = mem_array(2 * n, sizeof *rank);
    uint8_t *goes = mem_array(n, 1);
    bool ok = rank && goes;
    *n_keep = 0;
    *given = 0.0;
    for (size_t i = 0; ok && i < n; i++)
        rank[i] = (struct sort_item){
            sort_key_float(views[i] || rule->all_drawn ? rise[i] : INFINITY), (uint32_t)i};
    if (ok)
        sort_items(rank, rank + n, n);
    for (size_t k = 0; ok && k < n; k++) {
        const uint32_t i = rank[k].row;
        const uint8_t side = rule->outside ? rule->outside[i] : 0;
        const bool priced = views[i] || rule->all_drawn;
        if (gone[side] == rule->most[side])
            continue;
        *given += priced ? (double)rise[i] : 0.0;
        goes[i] = 1;
        gone[side]++;
    }
    for (size_t i = 0; ok && i < n; i++)
        if (!goes[i])
            keep[(*n_keep)++] = (uint32_t)i;
    mem_free(rank);
    mem_free(goes);
    return ok ? ERR_OK : err_set(e, ERR_MEM, "thinning: out of memory for %zu Gaussians", n);
}

/* Prices as in a photograph of mean coverage: the rim, which few photographs show, would be cheap
 * otherwise, and maps show it as often as the middle. These few are also far away, and a Gaussian
 * covers fewer of their pixels. A derived level, which is for views from afar, allows for that. */
static void thin_even(const struct thin *c, struct thin_report *r)
{
    size_t n = c->m->gauss.n;
    double views = 0.0;
    for (size_t i = 0; i < n; i++) {
        views += c->views[i];
        r->unseen += !c->views[i];
    }
    float mean = (float)(views / fmax((double)(n - r->unseen), 1.0));
    for (size_t i = 0; i < n; i++) {
        const float part = c->views[i] ? mean / (float)c->views[i] : 0.0f;
        c->rise[i] *= stage_schedule(c->at)->derived ? part * sqrtf(part) : part;
    }
}

size_t thin_inside(const struct schedule *s, uint32_t nth, size_t n)
{
    if (!s->derived) {
        const double left = SCHEDULE_THINNINGS - nth, over = (double)n / (double)s->budget;
        const double most = (double)s->budget * pow(over, left / (left + 1.0));
        return over > 1.0 ? (size_t)floor(most) : n;
    }
    const uint32_t all = schedule_thinnings_derived(s);
    const size_t stay = (size_t)floor((double)n * pow(s->thin_share, 1.0 / (double)all));
    const size_t most = nth < all || s->budget > stay ? stay : s->budget;
    return most > 0 || n == 0 ? most : 1;
}

size_t thin_outside(const struct schedule *s, size_t n)
{
    const size_t kept = n < s->around ? n : s->around;
    const double part = pow(s->thin_share, 1.0 / (double)schedule_thinnings_derived(s));
    return kept + (size_t)floor((double)(n - kept) * part);
}

static enum err_code thin_make_rule(struct thin *c, uint8_t *outside, struct thin_rule *rule,
                                    struct err *e)
{
    const struct schedule *s = stage_schedule(c->at);
    const size_t n = c->m->gauss.n;
    size_t inside = 0;
    enum err_code rc = model_count_inside(c->m, &c->site->cell, outside, &inside, e);
    rule->outside = outside;
    rule->most[0] = inside - thin_inside(s, c->nth, inside);
    rule->most[1] = s->derived ? n - inside - thin_outside(s, n - inside) : 0;
    return rc;
}

static enum err_code thin_remove(struct thin *c, bool all_drawn, struct thin_report *r,
                                 struct err *e)
{
    struct model *m = c->m;
    size_t n = m->gauss.n, left = 0;
    double given = 0.0;
    struct thin_rule rule = {.all_drawn = all_drawn};
    uint32_t *keep = mem_array(n, sizeof *keep);
    uint8_t *outside = mem_array(n, 1);
    enum err_code rc = keep && outside
                           ? thin_make_rule(c, outside, &rule, e)
                           : err_set(e, ERR_MEM, "thinning: out of memory for %zu Gaussians", n);
    if (!rc)
        rc = thin_choose(c->rise, c->views, n, &rule, keep, &left, &given, e);
    if (!rc && left < n)
        rc = model_move(m, &(struct permutation){keep, left, n, m->gauss.planes}, n, e);
    r->removed = rc ? 0 : n - left;
    r->rise = c->error > 0.0 ? given / c->error : 0.0;
    mem_free(outside);
    mem_free(keep);
    return rc;
}

size_t thin_views(const struct schedule *s, size_t n)
{
    size_t some = s->steps / (s->derived ? THIN_AGAIN : THIN_STEPS);
    const size_t least = s->derived ? THIN_LEAST_AGAIN : THIN_LEAST;
    some = some > least ? some : least;
    return some < n ? some : n;
}

enum err_code thin_run(struct model *m, struct gallery *g, struct background *background,
                       const struct site *site, const struct stage *at, struct thin_report *out,
                       struct err *e)
{
    const struct schedule *s = stage_schedule(at);
    struct thin c = {.m = m,
                     .gallery = g,
                     .background = background,
                     .site = site,
                     .at = at,
                     .nth = schedule_thinning(s, at->step)};
    const size_t n = m->gauss.n, n_views = thin_views(s, g->n_images);
    *out = (struct thin_report){.before = n};
    c.rise = mem_array(n, sizeof *c.rise);
    c.views = mem_array(n, sizeof *c.views);
    enum err_code rc = c.rise && c.views
                           ? thin_measure(&c, n_views, e)
                           : err_set(e, ERR_MEM, "thinning: out of memory for %zu Gaussians", n);
    if (!rc) {
        thin_even(&c, out);
        rc = thin_remove(&c, n_views == g->n_images, out, e);
    }
    out->psnr_db = -10.0 * log10(c.error / (double)n_views);
    dev_release(&c.weight);
    mem_free(c.pixels);
    mem_free(c.rise);
    mem_free(c.views);
    return rc;
}
