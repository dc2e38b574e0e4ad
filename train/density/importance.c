/* Importance of every Gaussian, which gives the chances in the draw of density control: the error
 * that it takes part in. A number of random training photographs is drawn; the importance is the
 * sum, over their pixels, of alpha T times the mean absolute error of the three channels. Pixels
 * behind a mask have no error.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/density/importance.h"

#include <math.h>
#include <string.h>

#include "core/layout.h"
#include "core/math/sample.h"
#include "core/pool.h"
#include "render/render.h"
#include "train/base/config.h"
#include "train/base/stage.h"
#include "train/model/model.h"
#include "train/photographs/gallery.h"
#include "train/photographs/photo_loader.h"

enum {
    IMPORTANCE_CHUNK = 16384,
    IMPORTANCE_EDGE_LEAST_PX = 128 /* of a photograph that was halved */
};

struct importance {
    struct render_importance *device;
    cl_mem weight;
    size_t weight_bytes;
    float *error; /* [error_px] of a photograph */
    size_t error_px;
    uint8_t *half; /* [half_px][4]: the photograph at half its edges, and its mask behind it */
    size_t half_px;
};

void importance_free(struct importance **p)
{
    struct importance *s = *p;
    if (!s)
        return;
    render_importance_close(&s->device);
    dev_release(&s->weight);
    mem_free(s->error);
    mem_free(s->half);
    mem_free(s);
    *p = NULL;
}

/* ---- photographs at half their edges ---- */

void importance_halve(const uint8_t *px, uint32_t channels, uint32_t w, uint32_t h, uint8_t *out)
{
    const size_t row = (size_t)channels * w;
    for (uint32_t y = 0; y + 1 < h; y += 2)
        for (uint32_t x = 0; x + 1 < w; x += 2)
            for (uint32_t c = 0; c < channels; c++) {
                const uint8_t *p = px + row * y + (size_t)channels * x + c;
                *out++ = (uint8_t)((p[0] + p[channels] + p[row] + p[row + channels] + 2) / 4);
            }
}

/* A pixel counts where all four do. */
void importance_halve_mask(const uint8_t *mask, uint32_t w, uint32_t h, uint8_t *out)
{
    for (uint32_t y = 0; y + 1 < h; y += 2)
        for (uint32_t x = 0; x + 1 < w; x += 2) {
            const uint8_t *p = mask + (size_t)w * y + x;
            *out++ = p[0] && p[1] && p[w] && p[w + 1];
        }
}

/* What Gaussians add to a photograph of half the edges says as much of their order, in a quarter of
 * the pixels (docs/decisions/012-importance-and-pruning.md). Small ones stay. A last odd row or
 * column is left out. */
static enum err_code importance_photo(struct importance *s, struct photo *p, struct err *e)
{
    const uint32_t w = p->cam.width_px, h = p->cam.height_px;
    const size_t n = (size_t)(w / 2) * (h / 2);
    if (w / 2 < IMPORTANCE_EDGE_LEAST_PX || h / 2 < IMPORTANCE_EDGE_LEAST_PX)
        return ERR_OK;
    if (n > s->half_px) {
        mem_free(s->half);
        s->half_px = 0;
        s->half = mem_array(n, 4);
        if (!s->half)
            return err_set(e, ERR_MEM, "importance: out of memory for %zu pixels", n);
        s->half_px = n;
    }
    importance_halve(p->px, 3, w, h, s->half);
    if (p->mask)
        importance_halve_mask(p->mask, w, h, s->half + 3 * n);
    p->px = s->half;
    p->mask = p->mask ? s->half + 3 * n : NULL;
    p->cam.width_px = w / 2;
    p->cam.height_px = h / 2;
    p->cam.fx_px *= 0.5;
    p->cam.fy_px *= 0.5;
    p->cam.cx_px *= 0.5;
    p->cam.cy_px *= 0.5;
    return ERR_OK;
}

/* ---- errors of pixels ---- */

struct importance_picture {
    const float *color; /* planar [3][n], mapped */
    const uint8_t *px, *mask;
    float *error; /* [n] */
    size_t n;
};

static enum err_code importance_error_chunk(void *user, size_t chunk, struct err *e)
{
    (void)e;
    const struct importance_picture *p = user;
    size_t n = p->n, end = (chunk + 1) * IMPORTANCE_CHUNK < n ? (chunk + 1) * IMPORTANCE_CHUNK : n;
    for (size_t i = chunk * IMPORTANCE_CHUNK; i < end; i++) {
        float sum = 0.0f;
        for (size_t c = 0; c < 3 && !(p->mask && !p->mask[i]); c++)
            sum += fabsf(p->color[c * n + i] - (float)p->px[3 * i + c] / 255.0f);
        p->error[i] = sum / 3.0f;
    }
    return ERR_OK;
}

/* Errors of the frame that was drawn; p has all but its colours. */
static enum err_code importance_errors(const struct engine *engine, struct importance_picture p,
                                       struct err *e)
{
    size_t chunks = (p.n + IMPORTANCE_CHUNK - 1) / IMPORTANCE_CHUNK;
    cl_mem drawn = render_color_buffer(engine->render);
    struct err why = {0};
    void *color = NULL;
    enum err_code rc = dev_map(engine->dev, drawn, CL_MAP_READ, 3 * p.n * sizeof(float), &color, e);
    if (rc)
        return rc;
    p.color = color;
    rc = pool_for(chunks, 0, importance_error_chunk, &p, e);
    enum err_code done = dev_unmap(engine->dev, drawn, &color, &why);
    return !rc && done ? err_set(e, done, "%s", why.msg) : rc;
}

/* ---- one view ---- */

struct importance_work {
    struct importance *made;
    struct model *m;
    struct gallery *gallery;
    const struct stage *at;
    struct model_look look; /* what the view shows of the model */
    const float *sums;      /* [look.shown.n][LAYOUT_IMPORTANCE_SUMS] of it, mapped */
    float *score;           /* [m->gauss.n] */
};

/* Draws the view and hands over its errors. */
static enum err_code importance_draw(struct importance_work *w, const struct photo *p,
                                     struct err *e)
{
    struct importance *s = w->made;
    const struct engine *engine = &w->gallery->engine;
    size_t n = (size_t)p->cam.width_px * p->cam.height_px, bytes = n * sizeof(float);
    struct render_options ro = gallery_photo_options(w->gallery, w->at, p->image);
    if (n > s->error_px) {
        mem_free(s->error);
        s->error_px = 0;
        s->error = mem_array(n, sizeof *s->error);
        if (!s->error)
            return err_set(e, ERR_MEM, "importance: out of memory for %zu pixels", n);
        s->error_px = n;
    }
    const struct importance_picture picture = {
        .px = p->px, .mask = p->mask, .error = s->error, .n = n};
    enum err_code rc = dev_reserve(engine->dev, bytes, &s->weight, &s->weight_bytes, e);
    if (!rc)
        rc = model_look(w->m, &p->cam, &ro, &w->look, e);
    if (!rc)
        rc = render_forward(engine->render, &w->look.shown, &p->cam, &ro, NULL, NULL, e);
    if (!rc)
        rc = importance_errors(engine, picture, e);
    return rc ? rc : dev_write(engine->dev, s->weight, 0, bytes, s->error, e);
}

static enum err_code importance_add_chunk(void *user, size_t chunk, struct err *e)
{
    (void)e;
    struct importance_work *w = user;
    size_t n = w->look.shown.n,
           end = (chunk + 1) * IMPORTANCE_CHUNK < n ? (chunk + 1) * IMPORTANCE_CHUNK : n;
    for (size_t i = chunk * IMPORTANCE_CHUNK; i < end; i++) {
        const float own = w->sums[LAYOUT_IMPORTANCE_SUMS * i + LAYOUT_IMPORTANCE_WEIGHT];
        if (own > 0.0f && isfinite(own))
            w->score[model_look_row(&w->look, i)] += own;
    }
    return ERR_OK;
}

static enum err_code importance_view(struct importance_work *w, size_t nth, struct err *e)
{
    struct photo photo;
    enum err_code rc = photo_loader_get_nth(w->gallery->photos, nth, &photo, e);
    if (!rc)
        rc = importance_photo(w->made, &photo, e);
    if (!rc)
        rc = importance_draw(w, &photo, e);
    if (!rc)
        rc = render_importance_run(w->made->device, &w->look.shown, w->made->weight, &w->sums, e);
    if (!rc)
        rc = model_look_map(w->m, &w->look, e);
    if (rc)
        return rc;
    const size_t chunks = (w->look.shown.n + IMPORTANCE_CHUNK - 1) / IMPORTANCE_CHUNK;
    struct err why = {0};
    rc = pool_for(chunks, 0, importance_add_chunk, w, e);
    enum err_code done = model_look_unmap(w->m, &w->look, &why);
    return !rc && done ? err_set(e, done, "%s", why.msg) : rc;
}

static enum err_code importance_make(struct importance **out, struct render *render, struct err *e)
{
    if (*out)
        return ERR_OK;
    *out = mem_array(1, sizeof **out);
    return *out ? render_importance_open(render, &(*out)->device, e)
                : err_set(e, ERR_MEM, "importance: out of memory");
}

/* What a run needs for itself alone. */
static void importance_forget(struct importance *s)
{
    if (!s)
        return;
    mem_free(s->error);
    mem_free(s->half);
    s->error = NULL;
    s->half = NULL;
    s->error_px = s->half_px = 0;
    if (s->device)
        render_importance_forget(s->device);
}

enum err_code importance_run(struct importance **own, struct model *m, struct gallery *g,
                             const struct stage *at, float *score, struct err *e)
{
    struct importance_work w = {.m = m, .gallery = g, .at = at, .score = score};
    uint32_t *all = mem_array(g->n_images, sizeof *all);
    size_t n_views = g->n_images < IMPORTANCE_VIEWS ? g->n_images : IMPORTANCE_VIEWS;
    uint32_t *views = mem_array(n_views, sizeof *views);
    enum err_code rc = all && views ? importance_make(own, g->engine.render, e)
                                    : err_set(e, ERR_MEM, "importance: out of memory");
    w.made = *own;
    for (size_t i = 0; !rc && i < g->n_images; i++)
        all[i] = (uint32_t)i;
    memset(score, 0, m->gauss.n * sizeof *score);
    if (!rc)
        rc = sample_race(NULL, all, g->n_images, n_views, (uint64_t)g->cfg->seed,
                         train_stream(TRAIN_STREAM_VIEWS, at->at + 1, at->step), views, e);
    for (size_t v = 0; !rc && v < n_views; v++)
        rc = importance_view(&w, views[v], e);
    importance_forget(*own);
    mem_free(views);
    mem_free(all);
    return rc;
}
