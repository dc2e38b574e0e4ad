/* Importance of every Gaussian, which gives the chances in the draw of density control (Taming
 * 3DGS, Mallick 2024).
 *
 * A number of random training views is drawn. In each, the weight of a pixel is 50 times its error
 * plus 50 times the edge strength of the photograph, both stretched to 0..1. Every Gaussian sums
 * over the pixels that it touches. Nine quantities, each divided by its median over the Gaussians
 * that have it, are added with fixed coefficients. A view counts by its loss L:
 *
 *     50 L (25 gradient + 100 opacity + 5 depth + 10 radius + 25 volume + 50 distance + 10 weight
 *           + 0.1 pixels + 50 alpha T)
 *
 * A picture of one colour, or a view that sees nothing, gives zeros, never a division by zero.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "core/layout.h"
#include "core/math/sample.h"
#include "core/math/sort.h"
#include "core/pool.h"
#include "render/render.h"
#include "train/base/config.h"
#include "train/base/stage.h"
#include "train/density/importance.h"
#include "train/loss/photometric.h"
#include "train/model/model.h"
#include "train/photographs/gallery.h"
#include "train/photographs/photo_loader.h"

enum {
    IMPORTANCE_FIELDS = 9,
    IMPORTANCE_MEDIAN_SAMPLE = 16384,
    IMPORTANCE_CHUNK = 16384,
    IMPORTANCE_EDGE_LEAST_PX = 128, /* of a photograph that was halved */
    IMPORTANCE_PICTURES = 3
};
enum importance_field {
    IMPORTANCE_GRADIENT,
    IMPORTANCE_OPACITY,
    IMPORTANCE_VOLUME, /* the same in every view */
    IMPORTANCE_WEIGHT,
    IMPORTANCE_PIXELS,
    IMPORTANCE_SHARE,
    IMPORTANCE_DISTANCE,
    IMPORTANCE_DEPTH,
    IMPORTANCE_RADIUS
};
static_assert(IMPORTANCE_RADIUS - IMPORTANCE_WEIGHT == LAYOUT_IMPORTANCE_RADIUS &&
                  IMPORTANCE_SHARE - IMPORTANCE_WEIGHT == LAYOUT_IMPORTANCE_SHARE,
              "fields of a view in the order of its sums");
static const float importance_coefficient[IMPORTANCE_FIELDS] = {25.0f, 100.0f, 25.0f, 10.0f, 0.1f,
                                                                50.0f, 50.0f,  5.0f,  10.0f};
#define IMPORTANCE_VIEW 50.0
#define IMPORTANCE_ERROR 50.0f
#define IMPORTANCE_EDGE 50.0f

struct importance {
    struct render_importance *device;
    cl_mem weight;
    size_t weight_bytes;
    float *scratch; /* IMPORTANCE_PICTURES pictures of scratch_px pixels */
    size_t scratch_px;
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
    mem_free(s->scratch);
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

/* ---- weights of pixels ---- */

/* x -> (x - least) / (largest - least); 0 when all are equal or none is finite. */
void importance_stretch(float *x, size_t n)
{
    float lo = INFINITY, hi = -INFINITY;
    for (size_t i = 0; i < n; i++) { /* not fminf: a call each */
        lo = x[i] < lo ? x[i] : lo;
        hi = x[i] > hi ? x[i] : hi;
    }
    float span = hi - lo;
    for (size_t i = 0; i < n; i++)
        x[i] = span > 0.0f && isfinite(span) ? (x[i] - lo) / span : 0.0f;
}

static int importance_luma(const uint8_t *px) /* ITU-R 601, as 8 bits */
{
    return (299 * px[0] + 587 * px[1] + 114 * px[2] + 500) / 1000;
}

static float importance_edge(const float *above, const float *row, const float *below, size_t l,
                             size_t x, size_t r)
{
    float sum = 9.0f * row[x] - (above[l] + above[x] + above[r]) - (row[l] + row[x] + row[r]) -
                (below[l] + below[x] + below[r]);
    return sum < 0.0f ? 0.0f : sum > 255.0f ? 255.0f : sum;
}

/* 8 * centre - neighbours of 8-bit luma, cut to 0..255; neighbours beyond the edge repeat it. All
 * are whole numbers, so floats are exact. luma: scratch [h][w]. */
void importance_edges(const uint8_t *px, uint32_t w, uint32_t h, float *luma, float *out)
{
    size_t n = (size_t)w * h;
    for (size_t i = 0; i < n; i++)
        luma[i] = (float)importance_luma(px + 3 * i);
    for (uint32_t y = 0; y < h; y++) {
        const float *row = luma + (size_t)y * w, *above = y ? row - w : row,
                    *below = y + 1 < h ? row + w : row;
        float *to = out + (size_t)y * w;
        for (uint32_t x = 1; x + 1 < w; x++)
            to[x] = importance_edge(above, row, below, x - 1, x, x + 1);
        to[0] = importance_edge(above, row, below, 0, 0, w > 1);
        to[w - 1] = importance_edge(above, row, below, w > 1 ? w - 2 : 0, w - 1, w - 1);
    }
    importance_stretch(out, n);
}

/* The pixels of a view, some at a time: first their errors, then their weights. */
struct importance_picture {
    const float *color; /* planar [3][n], mapped */
    const uint8_t *px, *mask;
    const float *edge;
    float *weight; /* [n]: errors at first */
    size_t n;
};

static enum err_code importance_error_chunk(void *user, size_t chunk, struct err *e)
{
    (void)e;
    const struct importance_picture *p = user;
    size_t n = p->n, end = (chunk + 1) * IMPORTANCE_CHUNK < n ? (chunk + 1) * IMPORTANCE_CHUNK : n;
    for (size_t i = chunk * IMPORTANCE_CHUNK; i < end; i++) {
        p->weight[i] = 0.0f;
        if (p->mask && !p->mask[i])
            continue;
        float sum = 0.0f;
        for (size_t c = 0; c < 3; c++)
            sum += fabsf(p->color[c * n + i] - (float)p->px[3 * i + c] / 255.0f);
        p->weight[i] = sum / 3.0f;
    }
    return ERR_OK;
}

static enum err_code importance_weight_chunk(void *user, size_t chunk, struct err *e)
{
    (void)e;
    const struct importance_picture *p = user;
    size_t n = p->n, end = (chunk + 1) * IMPORTANCE_CHUNK < n ? (chunk + 1) * IMPORTANCE_CHUNK : n;
    for (size_t i = chunk * IMPORTANCE_CHUNK; i < end; i++)
        p->weight[i] = p->mask && !p->mask[i]
                           ? 0.0f
                           : IMPORTANCE_ERROR * p->weight[i] + IMPORTANCE_EDGE * p->edge[i];
    return ERR_OK;
}

/* Weights of the frame that was drawn; p has all but its colours. */
static enum err_code importance_weigh(const struct engine *engine, struct importance_picture p,
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
    if (!rc)
        importance_stretch(p.weight, p.n);
    if (!rc)
        rc = pool_for(chunks, 0, importance_weight_chunk, &p, e);
    enum err_code done = dev_unmap(engine->dev, drawn, &color, &why);
    return !rc && done ? err_set(e, done, "%s", why.msg) : rc;
}

/* ---- one view ---- */

struct importance_work {
    struct importance *made;
    struct model *m;
    struct gallery *gallery;
    const struct stage *at;
    struct model_look look;              /* what the view shows of the model */
    const float *params, *sums;          /* mapped; sums [look.shown.n][LAYOUT_IMPORTANCE_SUMS] */
    const float *own[IMPORTANCE_WEIGHT]; /* [n] fields that no view changes */
    float *opacity, *volume;             /* two of them */
    float *total, inverse[IMPORTANCE_FIELDS]; /* [n] */
    size_t n, first;                          /* first: of the part at hand */
    float view_factor;
};

static enum err_code importance_alloc_all(struct importance *s, size_t n_px, struct err *e)
{
    if (n_px <= s->scratch_px)
        return ERR_OK;
    mem_free(s->scratch);
    s->scratch_px = 0;
    s->scratch = mem_array(n_px, IMPORTANCE_PICTURES * sizeof *s->scratch);
    if (!s->scratch)
        return err_set(e, ERR_MEM, "importance: out of memory");
    s->scratch_px = n_px;
    return ERR_OK;
}

/* Draw the view, find its loss, weigh its pixels on the device. */
static enum err_code importance_draw(struct importance_work *w, const struct photo *p,
                                     double *view_loss, struct err *e)
{
    struct importance *s = w->made;
    struct gallery *g = w->gallery;
    size_t n = (size_t)p->cam.width_px * p->cam.height_px, bytes = n * sizeof(float);
    struct render_options ro = gallery_photo_options(g, w->at, p->image);
    struct photometric_value v = {0};
    enum err_code rc = importance_alloc_all(s, n, e);
    if (rc)
        return rc;
    float *weight = s->scratch, *edge = weight + n, *luma = edge + n;
    const struct importance_picture picture = {
        .px = p->px, .mask = p->mask, .edge = edge, .weight = weight, .n = n};
    rc = dev_reserve(g->engine.dev, bytes, &s->weight, &s->weight_bytes, e);
    if (!rc)
        rc = gallery_hand_over(g, p, e);
    if (!rc)
        rc = model_look(w->m, &p->cam, &ro, &w->look, e);
    if (!rc)
        rc = render_forward(g->engine.render, &w->look.shown, &p->cam, &ro, NULL, NULL, e);
    if (!rc)
        rc = gallery_value(g, p, e);
    if (!rc) /* while the device works */
        importance_edges(p->px, p->cam.width_px, p->cam.height_px, luma, edge);
    if (!rc)
        rc = photometric_read(g->engine.loss, &v, e);
    if (!rc)
        rc = importance_weigh(&g->engine, picture, e);
    if (!rc)
        rc = dev_write(g->engine.dev, s->weight, 0, bytes, weight, e);
    *view_loss = isfinite(v.total) ? v.total : 0.0;
    return rc;
}

/* ---- adding up ---- */

struct importance_column { /* one number of each Gaussian of a view, or of all */
    const float *x;
    size_t n, stride;
    const struct model_look *look; /* NULL: of all */
};

static size_t importance_keep(float x, float *sample, size_t k)
{
    sample[k] = x;
    return k + (x > 0.0f && isfinite(x));
}

/* The finite values above 0 of every step-th row of the model, of those that the view shows: their
 * number. Rows that it does not show have none. sample: [c->n + 1]. */
static size_t importance_sample(const struct importance_column *c, uint32_t step, float *sample)
{
    const uint32_t *groups = c->look ? c->look->groups : NULL;
    size_t k = 0;
    for (size_t i = 0; !groups && i < c->n; i += step)
        k = importance_keep(c->x[c->stride * i], sample, k);
    for (size_t first = 0; groups && first < c->n; first += LAYOUT_LANES) {
        const size_t left = c->n - first, end = left < LAYOUT_LANES ? left : LAYOUT_LANES;
        const uint32_t over = groups[first / LAYOUT_LANES] * LAYOUT_LANES % step;
        for (size_t lane = over ? step - over : 0; lane < end; lane += step)
            k = importance_keep(c->x[c->stride * (first + lane)], sample, k);
    }
    return k;
}

/* 1 / median of them, from an even sample of n_rows; 0 when there are none. */
static enum err_code importance_column_median(const struct importance_column *c, size_t n_rows,
                                              float *out, struct err *e)
{
    uint32_t step = (uint32_t)(n_rows / IMPORTANCE_MEDIAN_SAMPLE) + 1;
    *out = 0.0f;
    float *sample = c->n ? mem_uninit(c->n + 1, sizeof *sample) : NULL;
    if (!c->n)
        return ERR_OK;
    if (!sample)
        return err_set(e, ERR_MEM, "importance: out of memory for a median of %zu values", c->n);
    size_t k = importance_sample(c, step, sample);
    if (!k && step > 1) /* few have it: look at all */
        k = importance_sample(c, 1, sample);
    if (k)
        *out = 1.0f / sort_select(sample, k, k / 2);
    mem_free(sample);
    return ERR_OK;
}

enum err_code importance_inverse_median(const float *x, size_t n, size_t stride, float *out,
                                        struct err *e)
{
    const struct importance_column c = {.x = x, .n = n, .stride = stride};
    return importance_column_median(&c, n, out, e);
}

static enum err_code importance_static_chunk(void *user, size_t chunk, struct err *e)
{
    (void)e;
    struct importance_work *w = user;
    uint32_t planes = w->m->gauss.planes;
    const size_t from = w->first + chunk * IMPORTANCE_CHUNK,
                 end = w->n - from < IMPORTANCE_CHUNK ? w->n : from + IMPORTANCE_CHUNK;
    for (size_t i = from; i < end; i++) {
        const float *p = w->params + layout_at(i, planes);
        float volume = 0.0f;
        for (size_t k = 0; k < 3; k++)
            volume += p[(LAYOUT_PLANE_SCALE + k) * LAYOUT_LANES];
        w->opacity[i] = 1.0f / (1.0f + expf(-p[LAYOUT_PLANE_OPACITY * LAYOUT_LANES]));
        w->volume[i] = expf(volume);
    }
    return ERR_OK;
}

static enum err_code importance_static(struct importance_work *w, struct err *e)
{
    return pool_for((w->n + IMPORTANCE_CHUNK - 1) / IMPORTANCE_CHUNK, 0, importance_static_chunk, w,
                    e);
}

static enum err_code importance_own_field(void *user, size_t f, struct err *e)
{
    struct importance_work *w = user;
    return importance_inverse_median(w->own[f], w->n, 1, &w->inverse[f], e);
}

/* Fields of the view, one column of its sums a call. */
static enum err_code importance_view_field(void *user, size_t k, struct err *e)
{
    struct importance_work *w = user;
    const struct importance_column c = {w->sums + k, w->look.shown.n, LAYOUT_IMPORTANCE_SUMS,
                                        &w->look};
    return importance_column_median(&c, w->n, &w->inverse[IMPORTANCE_WEIGHT + k], e);
}

static enum err_code importance_add_chunk(void *user, size_t chunk, struct err *e)
{
    (void)e;
    struct importance_work *w = user;
    size_t n = w->look.shown.n,
           end = (chunk + 1) * IMPORTANCE_CHUNK < n ? (chunk + 1) * IMPORTANCE_CHUNK : n;
    for (size_t i = chunk * IMPORTANCE_CHUNK; i < end; i++) {
        const float *view = w->sums + LAYOUT_IMPORTANCE_SUMS * i;
        const size_t row = model_look_row(&w->look, i);
        float sum = 0.0f;
        if (!(view[IMPORTANCE_DEPTH - IMPORTANCE_WEIGHT] > 0.0f)) /* not visible */
            continue;
        for (size_t f = 0; f < IMPORTANCE_WEIGHT; f++)
            sum += importance_coefficient[f] * w->own[f][row] * w->inverse[f];
        for (size_t f = IMPORTANCE_WEIGHT; f < IMPORTANCE_FIELDS; f++)
            sum += importance_coefficient[f] * view[f - IMPORTANCE_WEIGHT] * w->inverse[f];
        sum *= w->view_factor;
        if (sum > 0.0f && isfinite(sum))
            w->total[row] += sum;
    }
    return ERR_OK;
}

static enum err_code importance_alloc(struct importance_work *w, const float *mean_grad,
                                      struct err *e)
{
    w->own[IMPORTANCE_GRADIENT] = mean_grad;
    w->own[IMPORTANCE_OPACITY] = w->opacity = mem_array(w->n, sizeof(float));
    w->own[IMPORTANCE_VOLUME] = w->volume = mem_array(w->n, sizeof(float));
    return w->opacity && w->volume
               ? ERR_OK
               : err_set(e, ERR_MEM, "importance: out of memory for %zu Gaussians", w->n);
}

static enum err_code importance_view(struct importance_work *w, size_t nth, struct err *e)
{
    struct photo photo;
    double loss = 0.0;
    enum err_code rc = photo_loader_get_nth(w->gallery->photos, nth, &photo, e);
    if (!rc)
        rc = importance_photo(w->made, &photo, e);
    if (!rc)
        rc = importance_draw(w, &photo, &loss, e);
    if (!rc)
        rc = render_importance_run(w->made->device, &w->look.shown, w->made->weight, &w->sums, e);
    if (!rc)
        rc = model_look_map(w->m, &w->look, e);
    if (rc)
        return rc;
    const size_t chunks = (w->look.shown.n + IMPORTANCE_CHUNK - 1) / IMPORTANCE_CHUNK;
    struct err why = {0};
    w->view_factor = (float)(IMPORTANCE_VIEW * loss);
    rc = pool_for(IMPORTANCE_FIELDS - IMPORTANCE_WEIGHT, 0, importance_view_field, w, e);
    if (!rc)
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
    mem_free(s->scratch);
    mem_free(s->half);
    s->scratch = NULL;
    s->half = NULL;
    s->scratch_px = s->half_px = 0;
    if (s->device)
        render_importance_forget(s->device);
}

enum err_code importance_run(struct importance **own, struct model *m, struct gallery *g,
                             const struct stage *at, const float *params, const float *mean_grad,
                             float *score, struct err *e)
{
    struct importance_work w = {
        .m = m, .gallery = g, .at = at, .params = params, .total = score, .n = m->gauss.n};
    uint32_t *views = NULL, *all = mem_array(g->n_images, sizeof *all);
    size_t n_views = g->n_images < IMPORTANCE_VIEWS ? g->n_images : IMPORTANCE_VIEWS;
    views = mem_array(n_views, sizeof *views);
    enum err_code rc = all && views ? importance_make(own, g->engine.render, e)
                                    : err_set(e, ERR_MEM, "importance: out of memory");
    w.made = *own;
    if (!rc)
        rc = importance_alloc(&w, mean_grad, e);
    if (rc)
        goto out;
    for (size_t i = 0; i < g->n_images; i++)
        all[i] = (uint32_t)i;
    memset(score, 0, w.n * sizeof *score);
    rc = sample_race(NULL, all, g->n_images, n_views, (uint64_t)g->cfg->seed,
                     train_stream(TRAIN_STREAM_VIEWS, at->at + 1, at->step), views, e);
    if (!rc)
        rc = importance_static(&w, e);
    if (!rc)
        rc = pool_for(IMPORTANCE_WEIGHT, 0, importance_own_field, &w, e);
    for (size_t v = 0; !rc && v < n_views; v++)
        rc = importance_view(&w, views[v], e);
out:
    importance_forget(*own);
    mem_free(w.opacity);
    mem_free(w.volume);
    mem_free(views);
    mem_free(all);
    return rc;
}
