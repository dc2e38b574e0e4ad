/* What 3DGS-MCMC (Kheradmand et al. 2024) adds to a step, and its reference.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "loss/mcmc.h"

#include <math.h>

#include "core/base.h"
#include "core/camera.h"
#include "core/layout.h"

extern const char vector_cl[], mcmc_cl[];

#define MCMC_STEEP 100.0
#define MCMC_DEAD 0.005

struct mcmc {
    struct dev *dev; /* borrowed */
    cl_program program;
    cl_kernel pull, noise;
    bool wide; /* the shape of the kernels: VW 16 */
};

void mcmc_close(struct mcmc **p)
{
    struct mcmc *c = *p;
    if (!c)
        return;
    cl_kernel kernels[] = {c->pull, c->noise};
    for (size_t i = 0; i < sizeof kernels / sizeof kernels[0]; i++)
        if (kernels[i])
            clReleaseKernel(kernels[i]);
    if (c->program)
        clReleaseProgram(c->program);
    mem_free(c);
    *p = NULL;
}

enum err_code mcmc_open(struct dev *dev, struct mcmc **out, struct err *e)
{
    const struct dev_source sources[] = {{"core/vector.cl", vector_cl}, {"loss/mcmc.cl", mcmc_cl}};
    struct mcmc *c = mem_array(1, sizeof *c);
    *out = NULL;
    if (!c)
        return err_set(e, ERR_MEM, "mcmc: out of memory");
    c->dev = dev;
    c->wide = dev->vector_width == LAYOUT_LANES;
    enum err_code rc =
        dev_build(dev, sources, sizeof sources / sizeof *sources, NULL, &c->program, e);
    if (!rc)
        rc = dev_kernel(c->program, "mcmc_pull", &c->pull, e);
    if (!rc)
        rc = dev_kernel(c->program, "mcmc_noise", &c->noise, e);
    if (rc)
        mcmc_close(&c);
    *out = c;
    return rc;
}

/* The arguments that both kernels begin with. */
static cl_int mcmc_args(cl_kernel k, const struct render_model *m)
{
    cl_uint n = m->n, planes = m->planes, groups = m->groups;
    cl_int bad = dev_arg(k, 0, m->params);
    bad |= dev_arg(k, 1, n);
    bad |= dev_arg(k, 2, planes);
    return bad | dev_arg(k, 3, groups);
}

static enum err_code mcmc_run(const struct mcmc *c, cl_kernel k, const char *name, cl_int bad,
                              const struct render_model *m, struct err *e)
{
    if (bad != CL_SUCCESS)
        return err_set(e, ERR_DEVICE, "%s: arguments: %s", name, dev_error_name(bad));
    size_t local = c->wide ? 1 : LAYOUT_SCALE_ITEMS;
    size_t of_group = c->wide ? LAYOUT_PROJECT_GROUPS : LAYOUT_SCALE_ITEMS / LAYOUT_LANES;
    return dev_run(c->dev, k, name, (m->groups + of_group - 1) / of_group * local, local, e);
}

enum err_code mcmc_pull_run(struct mcmc *c, const struct render_model *m,
                            const struct mcmc_pull *in, cl_mem extra, struct err *e)
{
    cl_float per_opacity = (cl_float)(in->opacity_weight / m->n);
    cl_float per_size = (cl_float)(in->size_weight / (3.0 * m->n * in->unit_m));
    cl_int bad = mcmc_args(c->pull, m);
    bad |= dev_arg(c->pull, 4, per_opacity);
    bad |= dev_arg(c->pull, 5, per_size);
    bad |= dev_arg(c->pull, 6, extra);
    return mcmc_run(c, c->pull, "mcmc_pull", bad, m, e);
}

/* Two words for the device, which counts in 32 bits. */
static void mcmc_words(const struct mcmc_noise *in, uint32_t word[2])
{
    uint64_t both = rng_u64(in->seed, in->stream, 0);
    word[0] = (uint32_t)both;
    word[1] = (uint32_t)(both >> 32);
}

enum err_code mcmc_noise_run(struct mcmc *c, const struct render_model *m,
                             const struct mcmc_noise *in, struct err *e)
{
    uint32_t word[2];
    mcmc_words(in, word);
    cl_float rate = (cl_float)in->rate_per_m;
    cl_uint lo = word[0], hi = word[1];
    cl_int bad = mcmc_args(c->noise, m);
    bad |= dev_arg(c->noise, 4, rate);
    bad |= dev_arg(c->noise, 5, lo);
    bad |= dev_arg(c->noise, 6, hi);
    return mcmc_run(c, c->noise, "mcmc_noise", bad, m, e);
}

/* ---- the reference ---- */

static double mcmc_sigmoid(double x)
{
    return 1.0 / (1.0 + exp(-x));
}

double mcmc_ref_pull(const double *scale_log, const double *logit, size_t n,
                     const struct mcmc_pull *in, double *grad)
{
    double per_opacity = in->opacity_weight / (double)n;
    double per_size = in->size_weight / (3.0 * (double)n * in->unit_m), total = 0.0;
    for (size_t i = 0; i < n; i++) {
        double o = mcmc_sigmoid(logit[i]);
        total += per_opacity * o;
        for (size_t k = 0; k < 3; k++) {
            double pull = per_size * exp(scale_log[3 * i + k]);
            total += pull;
            if (grad)
                grad[4 * i + k] += pull;
        }
        if (grad)
            grad[4 * i + 3] += per_opacity * o * (1.0 - o);
    }
    return total;
}

static uint32_t mcmc_mix(uint32_t x)
{
    x ^= x >> 16;
    x *= UINT32_C(0x85ebca6b);
    x ^= x >> 13;
    x *= UINT32_C(0xc2b2ae35);
    return x ^ (x >> 16);
}

static double mcmc_unit(uint32_t i, uint32_t k, const uint32_t word[2])
{
    uint32_t x = mcmc_mix(mcmc_mix(mcmc_mix(4u * i + k) ^ word[0]) ^ word[1]);
    return ((double)(x >> 9) + 0.5) * 0x1p-23;
}

void mcmc_ref_noise(const double scale_log[3], const double quat[4], double logit, uint32_t i,
                    const struct mcmc_noise *in, double add[3])
{
    uint32_t word[2];
    double u[4], rot[9], own[3];
    double gate = in->rate_per_m * mcmc_sigmoid(-MCMC_STEEP * (mcmc_sigmoid(logit) - MCMC_DEAD));
    mcmc_words(in, word);
    for (uint32_t k = 0; k < 4; k++)
        u[k] = mcmc_unit(i, k, word);
    double r = sqrt(-2.0 * log(u[0])), r2 = sqrt(-2.0 * log(u[2]));
    double turn = 2.0 * M_PI * u[1], turn2 = 2.0 * M_PI * u[3];
    double xi[3] = {r * cos(turn), r * sin(turn), r2 * cos(turn2)};
    camera_quat_to_rot(quat, rot);
    for (int k = 0; k < 3; k++)
        own[k] =
            exp(2.0 * scale_log[k]) * (rot[k] * xi[0] + rot[3 + k] * xi[1] + rot[6 + k] * xi[2]);
    for (int k = 0; k < 3; k++)
        add[k] = gate * (rot[3 * k] * own[0] + rot[3 * k + 1] * own[1] + rot[3 * k + 2] * own[2]);
}
