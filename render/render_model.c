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
#include "render/frame.h"

enum { LANES = LAYOUT_LANES, GROUPS_AT_ONCE = 4096 };

uint32_t render_model_planes(const struct render_model *m)
{
    return (m->sh_halves ? layout_planes_halves : layout_planes)(m->sh_degree, m->embed_len);
}

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
    assert(first % LANES == 0 && g->n <= m->cap && first <= m->cap - g->n && !m->sh_halves);
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
    assert(!m->sh_halves);
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

void render_piece_end(float *groups, uint32_t planes, size_t n)
{
    for (size_t i = n; i % LANES != 0; i++)
        for (uint32_t p = 0; p < LAYOUT_PLANES_GEOMETRY; p++)
            groups[layout_at(i, planes) + p * LANES] = p < LAYOUT_PLANE_MEAN + 3 ? NOWHERE_M : 0.0f;
}

enum err_code render_model_reserve(struct render *r, struct render_model *m, size_t n_groups,
                                   size_t n_kept, struct err *e)
{
    cl_mem params = NULL;
    m->planes = render_model_planes(m);
    if (m->params && n_groups <= render_model_capacity(m))
        return ERR_OK;
    const size_t cap = n_groups + n_groups / 4 + 1, group = m->planes * LANES * sizeof(float);
    if (cap > (size_t)(INT32_MAX / LANES))
        return err_set(e, ERR_LIMIT, "%zu Gaussians in one picture: at most 2^31",
                       n_groups * LANES);
    if (!n_kept)
        dev_release(&m->params);
    enum err_code rc = dev_buffer(r->dev, cap * group, NULL, &params, e);
    cl_int code = CL_SUCCESS;
    if (!rc && n_kept)
        code = clEnqueueCopyBuffer(r->dev->queue, m->params, params, 0, 0, n_kept * group, 0, NULL,
                                   NULL);
    if (code != CL_SUCCESS)
        rc = err_set(e, ERR_DEVICE, "copying %zu Gaussians: %s", n_kept * LANES,
                     dev_error_name(code));
    if (!rc) {
        dev_release(&m->params);
        m->params = params;
        m->cap = (uint32_t)(cap * LANES);
        return ERR_OK;
    }
    dev_release(&params);
    m->cap = m->params ? m->cap : 0;
    return rc;
}

enum err_code render_place_open(struct render *r, const struct render_model *m,
                                struct render_piece *piece, size_t n, struct render_placing *out,
                                struct err *e)
{
    const size_t group = (size_t)m->planes * LANES;
    size_t groups = 0;
    *out = (struct render_placing){.piece = piece, .n = n};
    for (size_t i = 0; i < n; i++) {
        assert((size_t)piece[i].at + piece[i].n_groups <= render_model_capacity(m));
        groups += piece[i].n_groups;
    }
    if (r->dev->is_cpu) {
        enum err_code rc =
            dev_map(r->dev, m->params, CL_MAP_READ | CL_MAP_WRITE,
                    render_model_capacity(m) * group * sizeof(float), &out->mapped, e);
        for (size_t i = 0; !rc && i < n; i++)
            piece[i].groups = (float *)out->mapped + piece[i].at * group;
        return rc;
    }
    out->staging = mem_uninit(groups * group, sizeof(float));
    if (!out->staging)
        return err_set(e, ERR_MEM, "out of memory for %zu Gaussians", groups * LANES);
    for (size_t i = 0, at = 0; i < n; at += piece[i++].n_groups)
        piece[i].groups = out->staging + at * group;
    return ERR_OK;
}

enum err_code render_place_close(struct render *r, const struct render_model *m,
                                 struct render_placing *p, enum err_code made, struct err *e)
{
    const size_t bytes = (size_t)m->planes * LANES * sizeof(float);
    struct err unmap;
    enum err_code rc = made;
    for (size_t i = 0; !rc && p->staging && i < p->n; i++)
        rc = dev_write(r->dev, m->params, p->piece[i].at * bytes, p->piece[i].n_groups * bytes,
                       p->piece[i].groups, e);
    enum err_code ended = dev_unmap(r->dev, m->params, &p->mapped, made ? &unmap : e);
    mem_free(p->staging);
    *p = (struct render_placing){0};
    return rc ? rc : ended;
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
    dev_release(&m->list);
    memset(m, 0, sizeof *m);
}
