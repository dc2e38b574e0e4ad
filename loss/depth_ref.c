/* The depth loss of depth.c in double, computed in two ways. depth_ref_loss blends inverse depths
 * pixel by pixel. depth_ref_grads works as the kernels do, with the reference of the backward pass.
 * A test compares finite differences of the first with the second.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "core/base.h"
#include "loss/depth.h"
#include "render/render_ref.h"

/* A copy of degree 0 whose red is unit / z, for this camera. */
static enum err_code depth_ref_shadow(const struct gauss *g, const struct depth_input *in,
                                      struct gauss *out, struct err *e)
{
    const struct camera *c = in->cam;
    enum err_code rc = gauss_alloc(out, g->n, 0, 0, e);
    if (rc)
        return rc;
    out->n = g->n;
    memcpy(out->origin_enu_m, g->origin_enu_m, sizeof g->origin_enu_m);
    for (size_t i = 0; i < g->n; i++) {
        double z = c->trans[2];
        gauss_copy_row(out, i, g, i);
        for (size_t k = 0; k < 3; k++)
            z += c->rot[6 + k] * (g->origin_enu_m[k] + (double)g->mean_m[3 * i + k]);
        if (in->hard)
            out->opacity_logit[i] = (float)log(DEPTH_HARD / (1.0 - DEPTH_HARD));
        out->sh[3 * i] = z > 0.0 ? (float)((in->unit_m / z - 0.5) / GAUSS_SH_C0) : 0.0f;
        out->sh[3 * i + 1] = out->sh[3 * i + 2] = (float)(-0.5 / GAUSS_SH_C0);
    }
    return ERR_OK;
}

static struct render_options depth_ref_options(const struct depth_input *in)
{
    struct render_options o = in->options;
    o.sh_degree = 0;
    memset(o.background, 0, sizeof o.background);
    return o;
}

enum err_code depth_ref_loss(const struct gauss *g, const struct depth_input *in, double *depth,
                             double *loss, struct err *e)
{
    struct render_options o = depth_ref_options(in);
    struct ref_view v;
    struct ref_splat *splats = NULL;
    struct gauss shadow = {0};
    size_t n = 0, pixels = (size_t)in->cam->width_px * in->cam->height_px;
    enum err_code rc = depth_ref_shadow(g, in, &shadow, e);
    if (!rc)
        rc = ref_view_init(&shadow, in->cam, &o, &v, e);
    if (!rc)
        rc = ref_project_all(&v, &shadow, &splats, &n, e);
    *loss = 0.0;
    for (size_t at = 0; !rc && at < pixels; at++) {
        double px = (double)(at % v.width) + 0.5, py = (double)(at / v.width) + 0.5, t = 1.0,
               sum = 0.0, d[2], alpha;
        bool clamped;
        for (size_t i = 0; i < n && t > (double)LAYOUT_TRANSMITTANCE_MIN; i++) {
            if (!ref_alpha(&splats[i], px, py, d, &alpha, &clamped))
                continue;
            sum += alpha * t * in->unit_m / splats[i].cam[2];
            t *= 1.0 - alpha;
        }
        depth[at] = sum;
        if (in->target[at] >= 0.0f)
            *loss += in->weight / (double)in->n_known * fabs(sum - (double)in->target[at]);
    }
    mem_free(splats);
    gauss_free(&shadow);
    return rc;
}

enum err_code depth_ref_grads(const struct gauss *g, const struct depth_input *in,
                              const struct render_ref_grads *out, struct err *e)
{
    struct render_options o = depth_ref_options(in);
    struct gauss shadow = {0};
    size_t pixels = (size_t)in->cam->width_px * in->cam->height_px;
    double loss, *depth = mem_array(pixels, sizeof *depth),
                 *grad = mem_array(3 * pixels, sizeof *grad);
    enum err_code rc = ERR_OK;
    if (!depth || !grad)
        rc = err_set(e, ERR_MEM, "depth_ref: %zu pixels: out of memory", pixels);
    if (!rc)
        rc = depth_ref_loss(g, in, depth, &loss, e);
    if (!rc)
        rc = depth_ref_shadow(g, in, &shadow, e);
    for (size_t i = 0; !rc && i < pixels; i++) {
        double d = depth[i] - (double)in->target[i], w = in->weight / (double)in->n_known;
        grad[3 * i] = !(in->target[i] >= 0.0f) || d == 0.0 ? 0.0 : d > 0.0 ? w : -w;
    }
    if (!rc)
        rc = render_ref_backward(&shadow, in->cam, &o, grad, out, e);
    for (size_t i = 0; !rc && i < g->n; i++) {
        const double *row = in->cam->rot + 6;
        double z = in->cam->trans[2], own = 1.0 / (1.0 + exp(-(double)g->opacity_logit[i]));
        for (size_t k = 0; k < 3; k++)
            z += row[k] * (g->origin_enu_m[k] + (double)g->mean_m[3 * i + k]);
        /* dL/dDC = C0 dL/dc, c = unit / z */
        double along = -out->sh[3 * i] / GAUSS_SH_C0 * in->unit_m / (z * z);
        for (size_t k = 0; k < 3; k++)
            out->mean[3 * i + k] += along * row[k];
        if (in->hard)
            out->opacity_logit[i] *= own * (1.0 - own) / (DEPTH_HARD * (1.0 - DEPTH_HARD));
    }
    gauss_free(&shadow);
    mem_free(depth);
    mem_free(grad);
    return rc;
}
