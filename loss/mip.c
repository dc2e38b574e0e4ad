/* The 3-D filter of Mip-Splatting (Yu et al. 2024): no Gaussian is thinner than the finest sampling
 * of the training cameras that see it.
 *
 * The filter of a Gaussian is a length f. It is computed every MIP_EVERY steps, and when Gaussians
 * were added or removed. It is a constant for the optimiser. The kernels of render/ draw with
 * sqrt(sigma^2 + f^2) and opacity times prod sigma / sigma' (render_model.filter), and give
 * gradients of the raw parameters. Cameras have the picture size of the level, so a coarse level
 * learns coarse Gaussians. Results of training have the filter folded in (mip_fold).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "core/base.h"
#include "core/layout.h"
#include "loss/mip.h"

extern const char vector_cl[], lanes_cl[], mip_cl[];

#define MIP_SIGMA2 0.2
/* A folded opacity stays below what a float can tell from 1. */
#define MIP_LOGIT_MAX 16.0

struct mip {
    struct dev *dev; /* borrowed */
    cl_program program;
    cl_kernel depth, fill;
    cl_mem cameras, pieces;
    size_t n_cameras; /* room in `cameras` */
};

void mip_close(struct mip **p)
{
    struct mip *m = *p;
    if (!m)
        return;
    if (m->depth)
        clReleaseKernel(m->depth);
    if (m->fill)
        clReleaseKernel(m->fill);
    if (m->program)
        clReleaseProgram(m->program);
    dev_release(&m->cameras);
    dev_release(&m->pieces);
    mem_free(m);
    *p = NULL;
}

enum err_code mip_open(struct dev *dev, struct mip **out, struct err *e)
{
    const struct dev_source sources[] = {
        {"core/vector.cl", vector_cl}, {"loss/lanes.cl", lanes_cl}, {"loss/mip.cl", mip_cl}};
    struct mip *m = mem_array(1, sizeof *m);
    *out = NULL;
    if (!m)
        return err_set(e, ERR_MEM, "mip: out of memory");
    m->dev = dev;
    enum err_code rc =
        dev_build(dev, sources, sizeof sources / sizeof *sources, NULL, &m->program, e);
    if (!rc)
        rc = dev_kernel(m->program, "mip_depth", &m->depth, e);
    if (!rc)
        rc = dev_kernel(m->program, "mip_fill", &m->fill, e);
    if (!rc)
        rc = dev_buffer(dev, LAYOUT_LOSS_PIECES * sizeof(float), NULL, &m->pieces, e);
    if (rc)
        mip_close(&m);
    *out = m;
    return rc;
}

/* f_max: the largest focal length, px. */
static double mip_focal(const struct camera *cams, size_t n)
{
    double f = 0.0;
    for (size_t i = 0; i < n; i++)
        f = fmax(f, cams[i].fx_px);
    return f;
}

static enum err_code mip_upload(struct mip *m, const struct camera *cams, size_t n,
                                const double origin[3], struct err *e)
{
    struct layout_mip_camera *host = mem_array(n, sizeof *host);
    enum err_code rc = ERR_OK;
    if (!host)
        return err_set(e, ERR_MEM, "mip: out of memory for %zu cameras", n);
    for (size_t i = 0; i < n; i++) {
        const struct camera *c = &cams[i];
        for (int k = 0; k < 9; k++)
            host[i].rot[k] = (float)c->rot[k];
        for (int k = 0; k < 3; k++)
            host[i].trans[k] = (float)(c->rot[3 * k] * origin[0] + c->rot[3 * k + 1] * origin[1] +
                                       c->rot[3 * k + 2] * origin[2] + c->trans[k]);
        host[i].fx = (float)c->fx_px;
        host[i].fy = (float)c->fy_px;
        host[i].cx = (float)c->cx_px;
        host[i].cy = (float)c->cy_px;
        host[i].width = (float)c->width_px;
        host[i].height = (float)c->height_px;
    }
    if (m->n_cameras < n) {
        dev_release(&m->cameras);
        m->n_cameras = 0;
        rc = dev_buffer(m->dev, n * sizeof *host, NULL, &m->cameras, e);
        m->n_cameras = rc ? 0 : n;
    }
    if (!rc)
        rc = dev_write(m->dev, m->cameras, 0, n * sizeof *host, host, e);
    mem_free(host);
    return rc;
}

enum err_code mip_run(struct mip *m, struct render_model *model, const struct camera *cams,
                      size_t n_cams, struct err *e)
{
    cl_uint n = model->n, planes = model->planes, groups = model->groups, count = (cl_uint)n_cams;
    cl_float per_m = (cl_float)(1.0 / mip_focal(cams, n_cams));
    enum err_code rc = ERR_OK;
    if (!n_cams)
        return err_set(e, ERR_ARG, "mip: no cameras");
    if (!model->filter)
        rc = dev_buffer(m->dev, (size_t)model->cap * sizeof(float), NULL, &model->filter, e);
    if (!rc)
        rc = mip_upload(m, cams, n_cams, model->origin_enu_m, e);
    if (rc)
        return rc;
    cl_int bad = dev_arg(m->depth, 0, model->params);
    bad |= dev_arg(m->depth, 1, n);
    bad |= dev_arg(m->depth, 2, planes);
    bad |= dev_arg(m->depth, 3, groups);
    bad |= dev_arg(m->depth, 4, m->cameras);
    bad |= dev_arg(m->depth, 5, count);
    bad |= dev_arg(m->depth, 6, model->filter);
    bad |= dev_arg(m->depth, 7, m->pieces);
    bad |= dev_arg(m->fill, 0, groups);
    bad |= dev_arg(m->fill, 1, per_m);
    bad |= dev_arg(m->fill, 2, m->pieces);
    bad |= dev_arg(m->fill, 3, model->filter);
    if (bad != CL_SUCCESS)
        return err_set(e, ERR_DEVICE, "mip: arguments: %s", dev_error_name(bad));
    rc = dev_run(m->dev, m->depth, "mip_depth", LAYOUT_LOSS_PIECES, 1, e);
    return rc ? rc : dev_run(m->dev, m->fill, "mip_fill", LAYOUT_LOSS_PIECES, 1, e);
}

/* ---- the reference ---- */

static bool mip_sees(const struct camera *c, const double enu_m[3], double *z)
{
    const double grow = (double)LAYOUT_MIP_GROW;
    double px[2];
    return camera_project(c, enu_m, (double)LAYOUT_MIP_NEAR_M, px, z) &&
           px[0] >= -grow * c->width_px && px[0] <= (1.0 + grow) * c->width_px &&
           px[1] >= -grow * c->height_px && px[1] <= (1.0 + grow) * c->height_px;
}

void mip_ref_filter(const struct gauss *g, const struct camera *cams, size_t n_cams, double *f)
{
    double largest = 0.0, per_m = sqrt(MIP_SIGMA2) / mip_focal(cams, n_cams);
    for (size_t i = 0; i < g->n; i++) {
        double enu[3], z;
        for (size_t k = 0; k < 3; k++)
            enu[k] = g->origin_enu_m[k] + (double)g->mean_m[3 * i + k];
        f[i] = (double)INFINITY;
        for (size_t c = 0; c < n_cams; c++)
            if (mip_sees(&cams[c], enu, &z))
                f[i] = fmin(f[i], z);
        if (isfinite(f[i]))
            largest = fmax(largest, f[i]);
    }
    for (size_t i = 0; i < g->n; i++)
        f[i] = per_m * (isfinite(f[i]) ? f[i] : largest);
}

void mip_fold_one(double f, double scale_log[3], double *opacity_logit)
{
    double o = 1.0 / (1.0 + exp(-*opacity_logit)), rho = 1.0;
    for (int k = 0; k < 3; k++) {
        double own = exp(2.0 * scale_log[k]), wide = own + f * f;
        rho *= sqrt(own / wide);
        scale_log[k] = 0.5 * log(wide);
    }
    o *= rho;
    double logit = log(o) - log1p(-o);
    *opacity_logit = fmin(fmax(logit, -MIP_LOGIT_MAX), MIP_LOGIT_MAX);
}

void mip_fold_grad(double f, const double scale_log[3], double opacity_logit, double g_scale[3],
                   double *g_opacity)
{
    double folded[3], logit = opacity_logit;
    memcpy(folded, scale_log, sizeof folded);
    mip_fold_one(f, folded, &logit);
    /* q = dL/d ln(opacity after folding) */
    double q = *g_opacity * (1.0 + exp(logit));
    for (int k = 0; k < 3; k++) {
        double keep = exp(2.0 * (scale_log[k] - folded[k]));
        g_scale[k] = g_scale[k] * keep + q * (1.0 - keep);
    }
    *g_opacity = q / (1.0 + exp(opacity_logit));
}

void mip_fold(struct gauss *g, const float *filter)
{
    for (size_t i = 0; i < g->n; i++) {
        double s[3], o = (double)g->opacity_logit[i];
        for (size_t k = 0; k < 3; k++)
            s[k] = (double)g->scale_log[3 * i + k];
        mip_fold_one((double)filter[i], s, &o);
        for (size_t k = 0; k < 3; k++)
            g->scale_log[3 * i + k] = (float)s[k];
        g->opacity_logit[i] = (float)o;
    }
}
