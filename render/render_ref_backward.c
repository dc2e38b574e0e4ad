/* The backward pass of the reference: gradients of sum(rgb * rgb_grad) in double, by the chain
 * rule.
 *
 * First compositing, per pixel, front to back. With w_i = alpha_i T_i, C the final colour
 * (background included) and P_i the sum of colours up to and including splat i:
 *
 *     dL/dalpha_i = sum_c g_c (rgb_ic T_i - (C_c - P_ic) / (1 - alpha_i)),   dL/drgb_i = w_i g
 *
 * An alpha that was cut to its maximum has no gradient. Then projection, per Gaussian: EWA
 * splatting (Zwicker et al. 2001) with the derivatives of the covariance of Kerbl et al. 2023, both
 * branches of the position's clamp in the Jacobian, and the opacity compensation rho of
 * Mip-Splatting (Yu et al. 2024). The direction of view of the harmonics is held fixed, so colour
 * does not move a mean. With appearance, gradients of colour and opacity go on through clamp and
 * sum to the outputs of the network, and from there to embeddings and to the constants of the
 * frame. Sums along a ray are of two more colours, which vary over a splat. Transmittance is the
 * background of a third colour that is 0.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "core/base.h"
#include "render/render_ref.h"

struct splat_grad { /* of what is blended */
    double mean_px[2], conic[3], opacity_eff, rgb[3];
    double depth, tilt[2];
};

/* What a pixel's objective is linear in: colours, then both sums along the ray, and T. */
enum { BACKWARD_CHANNELS = 6 };

/* A splat's value in each channel at a pixel. */
static void backward_values(const struct ref_splat *s, const struct ref_ray *ray,
                            double out[BACKWARD_CHANNELS])
{
    for (int c = 0; c < 3; c++)
        out[c] = s->rgb[c];
    out[3] = ray->value[0];
    out[4] = ray->value[1];
    out[5] = 0;
}

/* ---- compositing ---- */

/* Add the gradients of one pixel. */
static void backward_pixel(const struct ref_view *v, const struct ref_splat *splats, size_t n,
                           size_t pixel, const double background[BACKWARD_CHANNELS],
                           const double g[BACKWARD_CHANNELS], struct splat_grad *out)
{
    double total[BACKWARD_CHANNELS] = {0}, pre[BACKWARD_CHANNELS] = {0}, t = 1;
    double d[2], alpha, value[BACKWARD_CHANNELS];
    double px = (double)(pixel % v->width) + 0.5, py = (double)(pixel / v->width) + 0.5;
    bool clamped;
    for (size_t i = 0; i < n && t > (double)LAYOUT_TRANSMITTANCE_MIN; i++)
        if (ref_alpha(&splats[i], px, py, d, &alpha, &clamped)) {
            struct ref_ray ray = ref_ray(v, pixel, ref_depth(&splats[i], d));
            backward_values(&splats[i], &ray, value);
            for (int c = 0; c < BACKWARD_CHANNELS; c++)
                total[c] += value[c] * alpha * t;
            t *= 1 - alpha;
        }
    for (int c = 0; c < BACKWARD_CHANNELS; c++)
        total[c] += t * background[c];
    t = 1;
    for (size_t i = 0; i < n && t > (double)LAYOUT_TRANSMITTANCE_MIN; i++) {
        const struct ref_splat *s = &splats[i];
        struct splat_grad *o = &out[i];
        if (!ref_alpha(s, px, py, d, &alpha, &clamped))
            continue;
        struct ref_ray ray = ref_ray(v, pixel, ref_depth(s, d));
        double g_alpha = 0, g_m = alpha * t * (g[3] * ray.slope[0] + g[4] * ray.slope[1]);
        backward_values(s, &ray, value);
        for (int c = 0; c < BACKWARD_CHANNELS; c++) {
            pre[c] += value[c] * alpha * t;
            g_alpha += g[c] * (value[c] * t - (total[c] - pre[c]) / (1 - alpha));
        }
        for (int c = 0; c < 3; c++)
            o->rgb[c] += alpha * t * g[c];
        o->depth += g_m;
        for (int a = 0; a < 2; a++) {
            o->tilt[a] += g_m * d[a];
            o->mean_px[a] += g_m * s->tilt[a];
        }
        t *= 1 - alpha;
        if (clamped)
            continue;
        double g_sigma = -alpha * g_alpha;
        o->opacity_eff += alpha / s->opacity_eff * g_alpha;
        o->conic[0] += 0.5 * g_sigma * d[0] * d[0];
        o->conic[1] += g_sigma * d[0] * d[1];
        o->conic[2] += 0.5 * g_sigma * d[1] * d[1];
        o->mean_px[0] += g_sigma * (s->conic[0] * d[0] + s->conic[1] * d[1]);
        o->mean_px[1] += g_sigma * (s->conic[1] * d[0] + s->conic[2] * d[1]);
    }
}

/* ---- projection ---- */

/* dL/dS of the 2-D covariance (symmetric: G00, G01, G11) and dL/dopacity. */
static void backward_conic(const struct ref_view *v, const struct ref_splat *s,
                           const struct splat_grad *g, double cov[3], double *g_opacity)
{
    double a = s->conic[0], b = s->conic[1], c = s->conic[2];
    double ga = g->conic[0], gb = g->conic[1] / 2, gc = g->conic[2];
    /* G = -Q GQ Q */
    double m00 = a * ga + b * gb, m01 = a * gb + b * gc, m10 = b * ga + c * gb,
           m11 = b * gb + c * gc;
    cov[0] = -(m00 * a + m01 * b);
    cov[1] = -(m00 * b + m01 * c);
    cov[2] = -(m10 * b + m11 * c);
    *g_opacity = s->rho * g->opacity_eff;
    if (v->compensate && s->det0 / s->det > (double)LAYOUT_RHO2_MIN) { /* else rho is constant */
        double k = s->opacity * g->opacity_eff / (2 * s->rho), f = 1 - s->rho * s->rho;
        double eps_det = v->kernel_px2 / s->det;
        cov[0] += k * (f * a - eps_det);
        cov[1] += k * f * b;
        cov[2] += k * (f * c - eps_det);
    }
}

/* The plane of a splat: tilt = -S^-1 c / unit with c the covariance of pixel and depth. With a =
 * S^-1 dL/dtilt / unit: dL/dS = sym(a (S^-1 c)^T), added to cov, and dL/dc = -a. */
static void backward_plane(const struct ref_view *v, const struct ref_splat *s,
                           const struct splat_grad *g, double cov[3], double g_cov_z[2])
{
    g_cov_z[0] = g_cov_z[1] = 0;
    if (!(v->depth_unit_m > 0))
        return;
    const double *q = s->conic, *c = s->cov_z, *t = g->tilt;
    double a0 = (q[0] * t[0] + q[1] * t[1]) / v->depth_unit_m,
           a1 = (q[1] * t[0] + q[2] * t[1]) / v->depth_unit_m;
    double w0 = q[0] * c[0] + q[1] * c[1], w1 = q[1] * c[0] + q[2] * c[1];
    cov[0] += a0 * w0;
    cov[1] += 0.5 * (a0 * w1 + a1 * w0);
    cov[2] += a1 * w1;
    g_cov_z[0] = -a0;
    g_cov_z[1] = -a1;
}

/* out (3x3 symmetric) = P^T G P for a 2x3 matrix P. */
static void backward_sandwich(const double p[6], const double g[3], double out[9])
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out[3 * i + j] =
                p[i] * (g[0] * p[j] + g[1] * p[3 + j]) + p[3 + i] * (g[1] * p[j] + g[2] * p[3 + j]);
}

/* Mean: through the pixel position, through J and through the depth. `sigma_cam` is W Sigma W^T. */
static void backward_mean(const struct ref_view *v, const struct ref_splat *s,
                          const struct splat_grad *g, const double cov[3], const double g_cov_z[2],
                          const double sigma_cam[9], double g_mean[3])
{
    const double f[2] = {v->fx, v->fy}, z = s->cam[2], *g_px = g->mean_px;
    /* gJ = 2 G J Sigma_cam, and of c = J Sigma_cam's third column */
    double g_jac[6], g_t[3] = {0, 0, v->depth_unit_m > 0 ? g->depth / v->depth_unit_m : 0};
    for (int k = 0; k < 3; k++) {
        double r0 = 0, r1 = 0;
        for (int l = 0; l < 3; l++) {
            r0 += s->jac[l] * sigma_cam[3 * l + k];
            r1 += s->jac[3 + l] * sigma_cam[3 * l + k];
        }
        g_jac[k] = 2 * (cov[0] * r0 + cov[1] * r1) + g_cov_z[0] * sigma_cam[3 * k + 2];
        g_jac[3 + k] = 2 * (cov[1] * r0 + cov[2] * r1) + g_cov_z[1] * sigma_cam[3 * k + 2];
    }
    for (int a = 0; a < 2; a++) {
        g_t[a] += g_px[a] * f[a] / z;
        g_t[2] -= g_px[a] * f[a] * s->cam[a] / (z * z);
        double gj = g_jac[3 * a + 2]; /* of J_a2 = -f clamp(t_a / z) / z */
        if (s->inside[a]) {
            g_t[a] -= f[a] / (z * z) * gj;
            g_t[2] += 2 * f[a] * s->cam[a] / (z * z * z) * gj;
        } else {
            g_t[2] += f[a] * s->clamped[a] / (z * z) * gj;
        }
        g_t[2] -= f[a] / (z * z) * g_jac[4 * a]; /* of J_00, J_11 = f / z */
    }
    for (int k = 0; k < 3; k++)
        g_mean[k] = v->rot[k] * g_t[0] + v->rot[3 + k] * g_t[1] + v->rot[6 + k] * g_t[2];
}

/* Rotation and scale of Sigma = M M^T, M = R diag(s), from dL/dSigma (symmetric). */
static void backward_shape(const struct ref_splat *s, const double g_sigma[9],
                           double g_scale_log[3], double g_quat[4])
{
    double v[9]; /* dL/dR */
    for (int k = 0; k < 3; k++) {
        double g_s = 0;
        for (int i = 0; i < 3; i++) {
            double g_m = 0; /* (G + G^T) M = 2 G M */
            for (int l = 0; l < 3; l++)
                g_m += 2 * g_sigma[3 * i + l] * s->rot[3 * l + k] * s->scale[k];
            g_s += s->rot[3 * i + k] * g_m;
            v[3 * i + k] = g_m * s->scale[k];
        }
        g_scale_log[k] = s->scale[k] * g_s;
    }
    const double *q = s->quat;
    double w = q[0], x = q[1], y = q[2], z = q[3];
    double d[4] = {
        2 * (x * (v[7] - v[5]) + y * (v[2] - v[6]) + z * (v[3] - v[1])),
        2 * (y * (v[1] + v[3]) + z * (v[2] + v[6]) + w * (v[7] - v[5]) - 2 * x * (v[4] + v[8])),
        2 * (x * (v[1] + v[3]) + z * (v[5] + v[7]) + w * (v[2] - v[6]) - 2 * y * (v[0] + v[8])),
        2 * (x * (v[2] + v[6]) + y * (v[5] + v[7]) + w * (v[3] - v[1]) - 2 * z * (v[0] + v[4])),
    };
    double along = w * d[0] + x * d[1] + y * d[2] + z * d[3];
    for (int k = 0; k < 4; k++)
        g_quat[k] = (d[k] - q[k] * along) / s->quat_len;
}

/* From dL/dy (colours: of `in`) through the network; frame gradients are added. */
static void backward_appearance_splat(const struct ref_view *v, const struct gauss *g,
                                      const struct ref_splat *s, const struct splat_grad *in,
                                      double g_y3, const struct render_ref_grads *out)
{
    size_t len = v->embed_len, units = v->hidden;
    double unit[GAUSS_EMBED_MAX], hidden[APPEARANCE_HIDDEN_MAX], y[APPEARANCE_OUT],
        g_z[APPEARANCE_OUT], g_unit[GAUSS_EMBED_MAX] = {0}, along = 0;
    double divisor = ref_appearance(v, g, s->index, unit, hidden, y);
    const float *w2 = v->frame + units * (len + 1);
    double *f = out->frame, *f_bias = f ? f + units * len : NULL, *f_w2 = f ? f_bias + units : NULL;
    for (int o = 0; o < APPEARANCE_OUT; o++) {
        double g_y = o == LAYOUT_APPEARANCE_OPACITY ? g_y3
                     : ref_color_open(v, s, o)      ? 2 * in->rgb[o]
                                                    : 0;
        g_z[o] = g_y * y[o] * (1 - y[o]);
        if (f)
            f_w2[APPEARANCE_OUT * units + (size_t)o] += g_z[o];
    }
    for (size_t h = 0; h < units; h++) {
        double g_h = 0;
        for (size_t o = 0; o < APPEARANCE_OUT; o++) {
            g_h += (double)w2[o * units + h] * g_z[o];
            if (f)
                f_w2[o * units + h] += g_z[o] * fmax(hidden[h], 0);
        }
        if (!(hidden[h] > 0))
            continue;
        for (size_t k = 0; k < len; k++) {
            g_unit[k] += (double)v->frame[h * len + k] * g_h;
            if (f)
                f[h * len + k] += g_h * unit[k];
        }
        if (f)
            f_bias[h] += g_h;
    }
    for (size_t k = 0; k < len && divisor > 1e-12; k++)
        along += unit[k] * g_unit[k];
    for (size_t k = 0; k < len && out->embed; k++)
        out->embed[s->index * len + k] = (g_unit[k] - unit[k] * along) / divisor;
}

/* each: of the mean opacity offset, for one Gaussian's. */
static void backward_splat(const struct ref_view *v, const struct gauss *g,
                           const struct ref_splat *s, const struct splat_grad *in, double each,
                           const struct render_ref_grads *out)
{
    size_t i = s->index, sh_count = gauss_sh_count(g->sh_degree),
           used = gauss_sh_count(v->sh_degree);
    double cov[3], g_cov_z[2], g_opacity, m[9], sigma_cam[9] = {0}, g_sigma_cam[9],
                                                g_sigma[9] = {0};
    backward_conic(v, s, in, cov, &g_opacity);
    backward_plane(v, s, in, cov, g_cov_z);
    for (int r = 0; r < 3; r++) /* W M */
        for (int k = 0; k < 3; k++)
            m[3 * r + k] = (v->rot[3 * r] * s->rot[k] + v->rot[3 * r + 1] * s->rot[3 + k] +
                            v->rot[3 * r + 2] * s->rot[6 + k]) *
                           s->scale[k];
    for (int r = 0; r < 3; r++)
        for (int k = 0; k < 3; k++)
            for (int l = 0; l < 3; l++)
                sigma_cam[3 * r + k] += m[3 * r + l] * m[3 * k + l];
    backward_mean(v, s, in, cov, g_cov_z, sigma_cam, out->mean + 3 * i);
    backward_sandwich(s->jac, cov, g_sigma_cam);
    for (int l = 0; l < 3; l++) { /* c is symmetric in Sigma_cam as well */
        double half = 0.5 * (s->jac[l] * g_cov_z[0] + s->jac[3 + l] * g_cov_z[1]);
        g_sigma_cam[3 * l + 2] += half;
        g_sigma_cam[6 + l] += half;
    }
    for (int r = 0; r < 3; r++) /* W^T G W */
        for (int k = 0; k < 3; k++)
            for (int a = 0; a < 3; a++)
                for (int b = 0; b < 3; b++)
                    g_sigma[3 * r + k] +=
                        v->rot[3 * a + r] * g_sigma_cam[3 * a + b] * v->rot[3 * b + k];
    backward_shape(s, g_sigma, out->scale_log + 3 * i, out->quat_wxyz + 4 * i);
    if (s->opacity_raw + s->y[LAYOUT_APPEARANCE_OPACITY] >= 1 && v->frame)
        g_opacity = 0; /* cut to 1 */
    out->opacity_logit[i] = s->opacity_raw * (1 - s->opacity_raw) * g_opacity;
    if (v->frame)
        backward_appearance_splat(v, g, s, in, g_opacity + each, out);
    for (int c = 0; c < 3; c++) {
        double g_raw = ref_color_open(v, s, c) ? in->rgb[c] : 0;
        for (size_t k = 0; k < used; k++)
            out->sh[3 * (i * sh_count + k) + (size_t)c] = s->basis[k] * g_raw;
    }
}

enum err_code render_ref_backward(const struct gauss *g, const struct camera *cam,
                                  const struct render_options *o, const double *rgb_grad,
                                  const struct render_ref_grads *out, struct err *e)
{
    struct ref_view v;
    struct ref_splat *splats = NULL;
    struct splat_grad *grads = NULL;
    size_t n = 0;
    enum err_code rc = ref_view_init(g, cam, o, &v, e);
    if (!rc && v.orthographic)
        rc = err_set(e, ERR_ARG, "render_ref_backward: an orthographic view has no backward pass");
    if (!rc && out->moments_grad && !(v.depth_unit_m > 0))
        rc = err_set(e, ERR_ARG, "render_ref_backward: the options have no unit of depth");
    if (!rc)
        rc = ref_project_all(&v, g, &splats, &n, e);
    if (rc)
        goto out;
    grads = mem_array(n, sizeof *grads);
    if (!grads) {
        rc = err_set(e, ERR_MEM, "render_ref_backward: %zu splats: out of memory", n);
        goto out;
    }
    memset(out->mean, 0, g->n * 3 * sizeof(double));
    memset(out->scale_log, 0, g->n * 3 * sizeof(double));
    memset(out->quat_wxyz, 0, g->n * 4 * sizeof(double));
    memset(out->opacity_logit, 0, g->n * sizeof(double));
    memset(out->sh, 0, g->n * gauss_sh_count(g->sh_degree) * 3 * sizeof(double));
    if (out->embed)
        memset(out->embed, 0, g->n * g->embed_len * sizeof(double));
    if (out->frame)
        memset(out->frame, 0, appearance_frame_floats(v.embed_len, v.hidden) * sizeof(double));
    for (size_t at = 0; at < (size_t)v.width * v.height; at++) {
        double background[BACKWARD_CHANNELS] = {[5] = 1}, grad[BACKWARD_CHANNELS] = {0};
        memcpy(background, ref_background(&v, at), 3 * sizeof *background);
        memcpy(grad, rgb_grad + 3 * at, 3 * sizeof *grad);
        if (out->moments_grad)
            memcpy(grad + 3, out->moments_grad + 3 * at, 3 * sizeof *grad);
        backward_pixel(&v, splats, n, at, background, grad, grads);
    }
    for (size_t i = 0; i < n; i++)
        backward_splat(&v, g, &splats[i], &grads[i], out->offset_weight / (double)n, out);
out:
    mem_free(splats);
    mem_free(grads);
    return rc;
}
