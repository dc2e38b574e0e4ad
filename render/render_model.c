/* Gaussians on the device: packing into the AoSoA-16 layout and back.
 *
 * Groups of 16 Gaussians store their parameters plane by plane. One vector load reads one parameter
 * of 16 neighbours, and a group that is culled early causes no further memory traffic. Padding
 * lanes of the last group are zero; kernels skip them because their index is not below n.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <assert.h>
#include <string.h>

#include "core/base.h"
#include "core/pool.h"
#include "render/frame.h"

enum { LANES = LAYOUT_LANES, GROUPS_AT_ONCE = 4096 };

/* One parameter array of struct gauss and where its planes start. */
struct plane_set {
    float *data;
    uint32_t first, count;
};

enum { SETS = 6 };

static void model_plane_sets(const struct gauss *g, struct plane_set out[SETS])
{
    out[0] = (struct plane_set){g->mean_m, LAYOUT_PLANE_MEAN, 3};
    out[1] = (struct plane_set){g->scale_log, LAYOUT_PLANE_SCALE, 3};
    out[2] = (struct plane_set){g->quat_wxyz, LAYOUT_PLANE_QUAT, 4};
    out[3] = (struct plane_set){g->opacity_logit, LAYOUT_PLANE_OPACITY, 1};
    out[4] =
        (struct plane_set){g->sh, LAYOUT_PLANE_SH, (uint32_t)(3 * gauss_sh_count(g->sh_degree))};
    out[5] = (struct plane_set){g->embed, layout_planes(g->sh_degree, 0), g->embed_len};
}

static void model_pack(const struct gauss *g, uint32_t planes, size_t group0, size_t groups,
                       float *out)
{
    struct plane_set sets[SETS];
    model_plane_sets(g, sets);
    for (size_t k = 0; k < SETS; k++)
        for (size_t i = group0 * LANES; i < (group0 + groups) * LANES && i < g->n; i++) {
            float *to = out + (i / LANES - group0) * planes * LANES + i % LANES;
            for (uint32_t p = 0; p < sets[k].count; p++)
                to[(sets[k].first + p) * LANES] = sets[k].data[i * sets[k].count + p];
        }
}

static void model_unpack(const float *in, const struct render_model *m, size_t group0,
                         size_t groups, struct gauss *g)
{
    struct plane_set sets[SETS];
    uint32_t planes = m->planes;
    model_plane_sets(g, sets);
    if (g->embed_len != m->embed_len)
        sets[SETS - 1].count = 0;
    for (size_t k = 0; k < SETS; k++)
        for (size_t i = group0 * LANES; i < (group0 + groups) * LANES && i < g->n; i++) {
            const float *from = in + (i / LANES - group0) * planes * LANES + i % LANES;
            for (uint32_t p = 0; p < sets[k].count; p++)
                sets[k].data[i * sets[k].count + p] = from[(sets[k].first + p) * LANES];
        }
}

enum err_code render_model_write(struct render *r, struct render_model *m, size_t first,
                                 const struct gauss *g, struct err *e)
{
    size_t group_floats = (size_t)m->planes * LANES, groups = (g->n + LANES - 1) / LANES;
    size_t at_once = groups < GROUPS_AT_ONCE ? groups : GROUPS_AT_ONCE;
    enum err_code rc = ERR_OK;
    assert(first % LANES == 0 && g->n <= m->cap && first <= m->cap - g->n);
    float *staging = mem_array(at_once * group_floats, sizeof *staging);
    if (!staging)
        return err_set(e, ERR_MEM, "render_model_write: %zu Gaussians", g->n);
    for (size_t at = 0; at < groups && !rc; at += at_once) {
        size_t n = groups - at < at_once ? groups - at : at_once;
        memset(staging, 0, n * group_floats * sizeof *staging);
        model_pack(g, m->planes, at, n, staging);
        rc = dev_write(r->dev, m->params, (first / LANES + at) * group_floats * sizeof(float),
                       n * group_floats * sizeof(float), staging, e);
    }
    mem_free(staging);
    return rc;
}

enum err_code render_model_upload(struct render *r, const struct gauss *g, struct render_model *out,
                                  struct err *e)
{
    struct render_model m = {0};
    memset(out, 0, sizeof *out);
    if (g->n > INT32_MAX - LANES)
        return err_set(e, ERR_LIMIT,
                       "render_model_upload: %zu Gaussians: at most 2^31; use smaller cells", g->n);
    m.n = (uint32_t)g->n;
    m.groups = (m.n + LANES - 1) / LANES;
    m.cap = m.groups * LANES;
    m.sh_degree = g->sh_degree;
    m.embed_len = g->embed_len;
    m.planes = layout_planes(g->sh_degree, g->embed_len);
    memcpy(m.origin_enu_m, g->origin_enu_m, sizeof m.origin_enu_m);
    enum err_code rc =
        dev_buffer(r->dev, (size_t)m.groups * m.planes * LANES * sizeof(float), NULL, &m.params, e);
    if (!rc)
        rc = render_model_write(r, &m, 0, g, e);
    if (rc)
        render_model_free(&m);
    else
        *out = m;
    return rc;
}

enum err_code render_model_download(struct render *r, const struct render_model *m, struct gauss *g,
                                    struct err *e)
{
    size_t group_floats = (size_t)m->planes * LANES;
    size_t at_once = m->groups < GROUPS_AT_ONCE ? m->groups : GROUPS_AT_ONCE;
    enum err_code rc = ERR_OK;
    float *staging = NULL;
    if (g->cap == 0)
        rc = gauss_alloc(g, m->n, m->sh_degree, m->embed_len, e);
    else if (g->sh_degree != m->sh_degree)
        rc = err_set(e, ERR_ARG, "render_model_download: degree %u into a container of degree %u",
                     m->sh_degree, g->sh_degree);
    else
        rc = gauss_reserve(g, m->n, e);
    if (rc)
        return rc;
    staging = mem_array(at_once * group_floats, sizeof *staging);
    if (!staging)
        return err_set(e, ERR_MEM, "render_model_download: %u Gaussians", m->n);
    g->n = m->n;
    memcpy(g->origin_enu_m, m->origin_enu_m, sizeof g->origin_enu_m);
    for (size_t at = 0; at < m->groups && !rc; at += at_once) {
        size_t n = m->groups - at < at_once ? m->groups - at : at_once;
        rc = dev_read(r->dev, m->params, at * group_floats * sizeof(float),
                      n * group_floats * sizeof(float), staging, e);
        if (!rc)
            model_unpack(staging, m, at, n, g);
    }
    mem_free(staging);
    return rc;
}

/* ---- pieces ---- */

/* Behind every camera or beyond every far plane, and no appearance changes that. */
#define NOWHERE_M 1e20f

void render_piece_pack(const struct gauss *g, const double origin_enu_m[3], float *out)
{
    uint32_t planes = layout_planes(g->sh_degree, g->embed_len);
    size_t groups = render_piece_groups(g->n), lanes = groups * LANES;
    memset(out, 0, lanes * planes * sizeof *out);
    model_pack(g, planes, 0, groups, out);
    for (size_t i = 0; i < lanes; i++)
        for (size_t k = 0; k < 3; k++) {
            float *at = out + (i / LANES * planes + LAYOUT_PLANE_MEAN + k) * LANES + i % LANES;
            *at = i < g->n ? (float)((double)*at + (g->origin_enu_m[k] - origin_enu_m[k]))
                           : NOWHERE_M;
        }
}

enum err_code render_model_reserve(struct render *r, struct render_model *m, size_t n_groups,
                                   bool *kept, struct err *e)
{
    *kept = true;
    m->planes = layout_planes(m->sh_degree, m->embed_len);
    if (m->params && n_groups <= render_model_capacity(m))
        return ERR_OK;
    size_t cap = n_groups + n_groups / 4 + 1;
    if (cap > (size_t)(INT32_MAX / LANES))
        return err_set(e, ERR_LIMIT, "%zu Gaussians in one picture: at most 2^31",
                       n_groups * LANES);
    *kept = false;
    dev_release(&m->params);
    m->cap = m->n = m->groups = 0;
    enum err_code rc =
        dev_buffer(r->dev, cap * LANES * m->planes * sizeof(float), NULL, &m->params, e);
    m->cap = !rc ? (uint32_t)(cap * LANES) : 0;
    return rc;
}

struct placing {
    const struct render_piece *pieces;
    float *to;
    size_t group_floats;
};

static enum err_code model_place_piece(void *user, size_t i, struct err *e)
{
    const struct placing *a = user;
    const struct render_piece *p = &a->pieces[i];
    (void)e;
    memcpy(a->to + p->at * a->group_floats, p->groups,
           p->n_groups * a->group_floats * sizeof(float));
    return ERR_OK;
}

/* On a CPU the buffer is memory like any other: all cores copy. */
static enum err_code model_place_mapped(struct render *r, struct placing *a, size_t n,
                                        cl_mem params, size_t bytes, struct err *e)
{
    cl_int code = CL_SUCCESS;
    a->to = clEnqueueMapBuffer(r->dev->queue, params, CL_TRUE, CL_MAP_READ | CL_MAP_WRITE, 0, bytes,
                               0, NULL, NULL, &code);
    if (code != CL_SUCCESS)
        return err_set(e, ERR_DEVICE, "placing %zu pieces: %s", n, dev_error_name(code));
    enum err_code rc = pool_for(n, 0, model_place_piece, a, e);
    code = clEnqueueUnmapMemObject(r->dev->queue, params, a->to, 0, NULL, NULL);
    if (!rc && code != CL_SUCCESS)
        rc = err_set(e, ERR_DEVICE, "placing %zu pieces: %s", n, dev_error_name(code));
    return rc;
}

enum err_code render_model_place(struct render *r, const struct render_piece *pieces,
                                 size_t n_pieces, struct render_model *m, struct err *e)
{
    struct placing a = {pieces, NULL, (size_t)m->planes * LANES};
    size_t bytes = a.group_floats * sizeof(float);
    enum err_code rc = ERR_OK;
    if (n_pieces == 0)
        return ERR_OK;
    for (size_t i = 0; i < n_pieces; i++)
        assert((size_t)pieces[i].at + pieces[i].n_groups <= render_model_capacity(m));
    if (r->dev->is_cpu)
        return model_place_mapped(r, &a, n_pieces, m->params, render_model_capacity(m) * bytes, e);
    for (size_t i = 0; !rc && i < n_pieces; i++)
        rc = dev_write(r->dev, m->params, pieces[i].at * bytes, pieces[i].n_groups * bytes,
                       pieces[i].groups, e);
    return rc;
}

enum err_code render_model_list(struct render *r, const uint32_t *groups, size_t n,
                                struct render_model *m, struct err *e)
{
    enum err_code rc = ERR_OK;
    if (n > INT32_MAX / LANES)
        return err_set(e, ERR_LIMIT, "%zu Gaussians in one picture: at most 2^31", n * LANES);
    m->groups = m->n = 0;
    dev_release(&m->list);
    if (groups)
        rc = dev_buffer(r->dev, n * sizeof *groups, groups, &m->list, e);
    if (!rc) {
        m->groups = (uint32_t)n;
        m->n = (uint32_t)(n * LANES);
    }
    return rc;
}

void render_model_free(struct render_model *m)
{
    if (!m)
        return;
    dev_release(&m->params);
    dev_release(&m->filter);
    dev_release(&m->list);
    memset(m, 0, sizeof *m);
}
