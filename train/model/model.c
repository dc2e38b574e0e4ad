/* Gaussians in training, on the device.
 *
 * On a CPU device the host sees the same memory, so arrays are mapped and changed in place. When
 * they have to grow, they are moved into larger buffers one after another.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/model/model.h"

#include <math.h>
#include <string.h>

#include "render/defer.h"
#include "scene/cells/cell.h"

enum { MODEL_ARRAYS = 2, MODEL_STATS = 5 };

/* Parameters and moments: words of 4 bytes, of which 0 is 0. */
static void model_arrays(struct model *m, cl_mem *out[MODEL_ARRAYS])
{
    out[0] = &m->gauss.params;
    out[1] = &m->adam.moments;
}

/* The statistics, and how many of them are kept: the last only with appearance. */
static size_t model_stats(struct model *m, cl_mem *out[MODEL_STATS])
{
    out[0] = &m->stats.grad;
    out[1] = &m->stats.absg;
    out[2] = &m->stats.count;
    out[3] = &m->stats.radius;
    out[4] = &m->stats.opacity;
    return m->gauss.embed_len ? MODEL_STATS : MODEL_STATS - 1;
}

static void model_release_stats(struct model *m)
{
    cl_mem *rows[MODEL_STATS];
    (void)model_stats(m, rows);
    for (size_t i = 0; i < MODEL_STATS; i++)
        dev_release(rows[i]);
}

void model_close(struct model *m)
{
    defer_close(&m->defer);
    m->seen = (struct render_model){0};
    render_model_free(&m->gauss);
    dev_release(&m->adam.moments);
    model_release_stats(m);
    dev_release(&m->stats.repaired);
}

size_t model_bytes(const struct model *m)
{
    return layout_floats(m->gauss.n, m->gauss.planes) * sizeof(float);
}

/* Room for n Gaussians that are there, and for those to come. Memory that is reserved and not
 * touched costs a CPU device nothing, but a buffer that has become too small takes a copy: when all
 * that there may be is no more than twice as many, that is the size. */
static size_t model_room(size_t n, size_t most)
{
    size_t cap = most >= n && most / 2 <= n ? most : n + n / 4;
    return (cap + LAYOUT_LANES - 1) / LAYOUT_LANES * LAYOUT_LANES;
}

static void model_count(struct model *m, size_t n)
{
    m->gauss.n = (uint32_t)n;
    m->gauss.groups = (uint32_t)((n + LAYOUT_LANES - 1) / LAYOUT_LANES);
}

enum err_code model_zero_moments(struct model *m, struct err *e)
{
    enum err_code rc = model_settle(m, e);
    return rc ? rc : dev_zero(m->dev, m->adam.moments, 0, model_bytes(m), e);
}

enum err_code model_zero_stats(struct model *m, struct err *e)
{
    cl_mem *rows[MODEL_STATS];
    size_t n = model_stats(m, rows);
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < n; i++)
        if (!*rows[i])
            rc = dev_buffer(m->dev, m->gauss.cap * sizeof(float), NULL, rows[i], e);
    for (size_t i = 0; !rc && i < n; i++)
        rc = dev_zero(m->dev, *rows[i], 0, layout_floats(m->gauss.n, 1) * sizeof(float), e);
    return rc;
}

enum err_code model_open(struct model *m, struct dev *dev, struct render *render,
                         const struct gauss *like, size_t most, struct err *e)
{
    struct render_model *g = &m->gauss;
    size_t cap = model_room(like->n, most);
    if (cap > UINT32_MAX)
        return err_set(e, ERR_LIMIT, "%zu Gaussians are more than the renderer counts", like->n);
    m->dev = dev;
    m->render = render;
    g->sh_degree = like->sh_degree;
    g->embed_len = like->embed_len;
    g->planes = layout_planes(like->sh_degree, like->embed_len);
    memcpy(g->origin_enu_m, like->origin_enu_m, sizeof g->origin_enu_m);
    g->cap = (uint32_t)cap;
    model_count(m, like->n);
    cl_mem *arrays[MODEL_ARRAYS];
    model_arrays(m, arrays);
    size_t bytes = layout_floats(cap, g->planes) * sizeof(float);
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < MODEL_ARRAYS; i++)
        rc = dev_buffer(dev, bytes, NULL, arrays[i], e);
    if (!rc)
        rc = dev_buffer(dev, sizeof(uint32_t), NULL, &m->stats.repaired, e);
    if (!rc)
        rc = dev_zero(dev, m->stats.repaired, 0, sizeof(uint32_t), e);
    if (!rc)
        rc = model_zero_stats(m, e);
    return rc ? err_add(e, "training %zu Gaussians", like->n) : ERR_OK;
}

enum err_code model_fill(struct model *m, const struct gauss *g, struct err *e)
{
    enum err_code rc = render_model_write(m->render, &m->gauss, 0, g, e);
    return rc ? rc : model_zero_moments(m, e);
}

enum err_code model_gauss(const struct model *m, struct gauss *out, struct err *e)
{
    *out = (struct gauss){0};
    return render_model_download(m->render, &m->gauss, out, e);
}

/* ---- steps ---- */

enum err_code model_settle(struct model *m, struct err *e)
{
    return m->defer ? defer_settle(m->defer, &m->gauss, &m->adam, e) : ERR_OK;
}

enum err_code model_see(struct model *m, bool defers, const struct camera *cam,
                        const struct render_options *o, struct err *e)
{
    enum err_code rc = ERR_OK;
    m->seen = m->gauss;
    if (!defers) {
        rc = model_settle(m, e);
        if (m->defer)
            defer_moved(m->defer); /* all are about to make a step */
        return rc;
    }
    if (!m->defer)
        rc = defer_open(m->render, &m->defer, e);
    return rc ? rc : defer_see(m->defer, &m->gauss, &m->adam, cam, o, &m->seen, e);
}

enum err_code model_look(struct model *m, const struct camera *cam, const struct render_options *o,
                         struct model_look *out, struct err *e)
{
    *out = (struct model_look){.shown = m->gauss};
    return m->defer ? defer_look(m->defer, &m->gauss, &m->adam, cam, o, &out->shown, e) : ERR_OK;
}

enum err_code model_look_map(const struct model *m, struct model_look *l, struct err *e)
{
    size_t bytes = l->shown.groups * sizeof(uint32_t);
    return l->shown.list ? dev_map(m->dev, l->shown.list, CL_MAP_READ, bytes, &l->groups, e)
                         : ERR_OK;
}

enum err_code model_look_unmap(const struct model *m, struct model_look *l, struct err *e)
{
    return l->shown.list ? dev_unmap(m->dev, l->shown.list, &l->groups, e) : ERR_OK;
}

enum err_code model_stepped(struct model *m, struct err *e)
{
    return defer_owes(m->defer) ? defer_stepped(m->defer, &m->adam, e) : ERR_OK;
}

enum err_code model_owed(struct model *m, cl_mem *out, struct err *e)
{
    *out = NULL;
    return defer_owes(m->defer) ? defer_save(m->defer, &m->gauss, &m->adam, out, e) : ERR_OK;
}

enum err_code model_owe(struct model *m, const uint32_t *settled, uint32_t *first, struct err *e)
{
    enum err_code rc = m->defer ? ERR_OK : defer_open(m->render, &m->defer, e);
    return rc ? rc : defer_restore(m->defer, &m->gauss, settled, first, e);
}

/* ---- moving rows ---- */

/* One of the arrays, in place or into a new one of `cap`, which takes its place. */
static enum err_code model_move_array(struct model *m, size_t nth, const struct permutation *r,
                                      size_t cap, struct err *e)
{
    cl_mem *arrays[MODEL_ARRAYS], *at, grown = NULL;
    size_t before = layout_floats(r->n_old, r->planes), after = layout_floats(r->n, r->planes);
    size_t most = before > after ? before : after;
    bool grows = cap > m->gauss.cap;
    void *from = NULL, *to = NULL;
    struct err why = {0};
    enum err_code rc = ERR_OK, done = ERR_OK;
    model_arrays(m, arrays);
    at = arrays[nth];
    if (grows)
        rc = dev_buffer(m->dev, layout_floats(cap, r->planes) * sizeof(float), NULL, &grown, e);
    if (!rc)
        rc = dev_map(m->dev, *at, grows ? CL_MAP_READ : CL_MAP_READ | CL_MAP_WRITE,
                     (grows ? before : most) * sizeof(float), &from, e);
    if (!rc && grows)
        rc = dev_map(m->dev, grown, CL_MAP_WRITE, after * sizeof(float), &to, e);
    if (!rc)
        rc = permute_move(r, nth > 0, from, grows ? to : from, e);
    done = dev_unmap(m->dev, *at, &from, &why);
    if (!done && grows)
        done = dev_unmap(m->dev, grown, &to, &why);
    if (!done)
        done = dev_finish(m->dev, &why); /* what is released below goes at once */
    if (!rc && done)
        rc = err_set(e, done, "%s", why.msg);
    if (!rc && grows) {
        cl_mem old = *at;
        *at = grown;
        grown = old;
    }
    dev_release(&grown);
    return rc;
}

enum err_code model_move(struct model *m, const struct permutation *r, size_t most, struct err *e)
{
    size_t cap = r->n > m->gauss.cap ? model_room(r->n, most) : m->gauss.cap;
    enum err_code rc = ERR_OK;
    if (cap > UINT32_MAX)
        return err_set(e, ERR_LIMIT, "%zu Gaussians are more than the renderer counts", r->n);
    if (cap > m->gauss.cap)
        model_release_stats(m);
    for (size_t k = 0; !rc && k < MODEL_ARRAYS; k++)
        rc = model_move_array(m, k, r, cap, e);
    if (rc)
        return err_add(e, "training %zu Gaussians", r->n);
    if (m->defer)
        defer_moved(m->defer);
    m->gauss.cap = (uint32_t)cap;
    model_count(m, r->n);
    return model_zero_stats(m, e);
}

enum err_code model_show(struct model *m, size_t n, struct err *e)
{
    model_count(m, n);
    return model_zero_stats(m, e);
}

/* ---- looking at it and changing it in place ---- */

enum err_code model_count_inside(struct model *m, const struct cell *cell, uint8_t *outside,
                                 size_t *out, struct err *e)
{
    const struct render_model *g = &m->gauss;
    size_t n = 0;
    void *params = NULL;
    enum err_code rc = dev_map(m->dev, g->params, CL_MAP_READ, model_bytes(m), &params, e);
    if (rc)
        return rc;
    for (size_t i = 0; i < g->n; i++) {
        const float *mean = (const float *)params + layout_at(i, g->planes);
        const bool inside = cell_distance(cell, g->origin_enu_m[0] + (double)mean[0],
                                          g->origin_enu_m[1] + (double)mean[LAYOUT_LANES]) <= 0.0;
        n += inside;
        if (outside)
            outside[i] = !inside;
    }
    *out = n;
    return dev_unmap(m->dev, g->params, &params, e);
}
