/* The method in double precision: how Gaussians become a picture, without tiles, lists or vectors.
 *
 * A Gaussian has mean mu and covariance Sigma = R diag(s)^2 R^T. EWA splatting (Zwicker et al.
 * 2001) approximates the perspective map locally by an affine one. The Gaussian's picture is then a
 * 2-D Gaussian with covariance S0 = J W Sigma W^T J^T. A small kernel is added against aliasing: S
 * = S0 + eps I. With compensation, opacity is multiplied by rho = sqrt(det S0 / det S), so that the
 * splat keeps its mass (Mip-Splatting, Yu et al. 2024). Colour is a series of real spherical
 * harmonics in the direction from the camera. Pixels blend the splats front to back (3D Gaussian
 * Splatting, Kerbl et al. 2023).
 *
 * The kernels do the same and are tested against this code. It is not meant to be fast.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "render/render_ref.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base.h"
#include "core/layout.h"
#include "core/splat/sh.h"

enum err_code ref_view_init(const struct gauss *g, const struct camera *cam,
                            const struct render_options *o, struct ref_view *out, struct err *e)
{
    struct ref_view v = {0};
    double w = cam->width_px, h = cam->height_px;
    if (cam->width_px < 1 || cam->height_px < 1 || !(cam->fx_px > 0) || !(cam->fy_px > 0))
        return err_set(e, ERR_ARG,
                       "render: camera %ux%u, focal %g %g: sizes and focals must be positive",
                       cam->width_px, cam->height_px, cam->fx_px, cam->fy_px);
    memcpy(v.rot, cam->rot, sizeof v.rot);
    for (int i = 0; i < 3; i++) {
        /* t = W (mu + origin) + d: the origin goes into the translation, in double. */
        v.trans[i] = cam->rot[3 * i] * g->origin_enu_m[0] +
                     cam->rot[3 * i + 1] * g->origin_enu_m[1] +
                     cam->rot[3 * i + 2] * g->origin_enu_m[2] + cam->trans[i];
        v.background[i] = (double)o->background[i];
        v.background_there[i] = (double)o->background_there[i];
    }
    v.background_where = o->background_where;
    v.edge = o->edge;
    memcpy(v.origin_enu_m, g->origin_enu_m, sizeof v.origin_enu_m);
    for (int i = 0; i < 3; i++)
        v.eye[i] = -(v.rot[i] * v.trans[0] + v.rot[3 + i] * v.trans[1] + v.rot[6 + i] * v.trans[2]);
    v.fx = cam->fx_px;
    v.fy = cam->fy_px;
    v.cx = cam->cx_px;
    v.cy = cam->cy_px;
    v.width = cam->width_px;
    v.height = cam->height_px;
    /* The Jacobian grows without bound at grazing angles: it is taken at most 15 % of the picture
     * outside. */
    v.lim_neg[0] = v.cx / v.fx + 0.15 * w / v.fx;
    v.lim_pos[0] = (w - v.cx) / v.fx + 0.15 * w / v.fx;
    v.lim_neg[1] = v.cy / v.fy + 0.15 * h / v.fy;
    v.lim_pos[1] = (h - v.cy) / v.fy + 0.15 * h / v.fy;
    v.near_m = o->near_m > 0 ? o->near_m : RENDER_NEAR_M;
    v.kernel_px2 = o->kernel_px2 > 0 ? o->kernel_px2 : o->aa == RENDER_AA_MIP ? 0.1 : 0.3;
    v.compensate = o->aa != RENDER_AA_NONE;
    v.half_max_px = 2 * fmax(w, h);
    v.orthographic = o->orthographic;
    v.depth_unit_m = o->depth_unit_m;
    v.known = o->known;
    v.known_zeta = o->known_zeta;
    v.sh_degree = o->sh_degree >= 0 && (uint32_t)o->sh_degree < g->sh_degree
                      ? (uint32_t)o->sh_degree
                      : g->sh_degree;
    v.frame = o->appearance_frame;
    v.embed_len = g->embed_len;
    v.hidden = o->appearance_hidden;
    if (v.frame && (!v.embed_len || v.hidden < 1 || v.hidden > APPEARANCE_HIDDEN_MAX))
        return err_set(e, ERR_ARG, "render: appearance of %u hidden units, embeddings of %u",
                       v.hidden, v.embed_len);
    *out = v;
    return ERR_OK;
}

/* Rotation of the normalised quaternion and the three sigmas. */
static void ref_shape(const struct gauss *g, size_t i, struct ref_splat *s)
{
    double n = 0;
    for (int k = 0; k < 4; k++) {
        s->quat[k] = (double)g->quat_wxyz[4 * i + k];
        n += s->quat[k] * s->quat[k];
    }
    s->quat_len = fmax(sqrt(n), 1e-12); /* a zero quaternion turns nothing */
    for (int k = 0; k < 4; k++)
        s->quat[k] /= s->quat_len;
    double w = s->quat[0], x = s->quat[1], y = s->quat[2], z = s->quat[3];
    const double rot[9] = {
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
        2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
    memcpy(s->rot, rot, sizeof rot);
    for (int k = 0; k < 3; k++)
        s->scale[k] = exp((double)g->scale_log[3 * i + k]);
}

/* S0 = P P^T with P = J W R diag(s), 2 x 3; its determinant by Cauchy-Binet, as a sum of squares.
 */
static void ref_covariance(const struct ref_view *v, struct ref_splat *s)
{
    double rx = s->cam[0] / s->cam[2], ry = s->cam[1] / s->cam[2], z = s->cam[2], p[6];
    s->clamped[0] = fmin(fmax(rx, -v->lim_neg[0]), v->lim_pos[0]);
    s->clamped[1] = fmin(fmax(ry, -v->lim_neg[1]), v->lim_pos[1]);
    if (v->orthographic) { /* J = diag(fx, fy) 0 */
        z = 1;
        s->clamped[0] = s->clamped[1] = 0;
    }
    s->inside[0] = s->clamped[0] == rx;
    s->inside[1] = s->clamped[1] == ry;
    const double jac[6] = {v->fx / z, 0,         -v->fx * s->clamped[0] / z,
                           0,         v->fy / z, -v->fy * s->clamped[1] / z};
    memcpy(s->jac, jac, sizeof jac);
    for (int row = 0; row < 2; row++)
        for (int col = 0; col < 3; col++) {
            double sum = 0; /* (J W)[row][.] R[.][col] s[col] */
            for (int m = 0; m < 3; m++) {
                double jw = jac[3 * row] * v->rot[m] + jac[3 * row + 1] * v->rot[3 + m] +
                            jac[3 * row + 2] * v->rot[6 + m];
                sum += jw * s->rot[3 * m + col];
            }
            p[3 * row + col] = sum * s->scale[col];
        }
    s->cov0[0] = p[0] * p[0] + p[1] * p[1] + p[2] * p[2];
    s->cov0[1] = p[0] * p[3] + p[1] * p[4] + p[2] * p[5];
    s->cov0[2] = p[3] * p[3] + p[4] * p[4] + p[5] * p[5];
    double m01 = p[0] * p[4] - p[1] * p[3], m02 = p[0] * p[5] - p[2] * p[3],
           m12 = p[1] * p[5] - p[2] * p[4];
    s->det0 = m01 * m01 + m02 * m02 + m12 * m12;
    s->det = s->det0 + v->kernel_px2 * (s->cov0[0] + s->cov0[2]) + v->kernel_px2 * v->kernel_px2;
    for (int k = 0; k < 3; k++) { /* third row of W R diag(s) */
        double z_k =
            (v->rot[6] * s->rot[k] + v->rot[7] * s->rot[3 + k] + v->rot[8] * s->rot[6 + k]) *
            s->scale[k];
        s->cov_z[0] += p[k] * z_k;
        s->cov_z[1] += p[3 + k] * z_k;
    }
}

/* The regression of depth on the pixel: z - cov_z^T S^-1 d. See render/moments.cl. */
static void ref_plane(const struct ref_view *v, struct ref_splat *s)
{
    const double *q = s->conic;
    s->depth = s->cam[2] / v->depth_unit_m - 1;
    s->tilt[0] = -(q[0] * s->cov_z[0] + q[1] * s->cov_z[1]) / v->depth_unit_m;
    s->tilt[1] = -(q[1] * s->cov_z[0] + q[2] * s->cov_z[1]) / v->depth_unit_m;
}

double ref_depth(const struct ref_splat *s, const double d[2])
{
    return s->depth + s->tilt[0] * d[0] + s->tilt[1] * d[1];
}

double ref_behind_px(const struct ref_view *v, size_t pixel, double depth)
{
    return v->known && v->known[pixel] > 0.0f
               ? v->fx * ((1 + depth) * (double)v->known[pixel] / v->known_zeta - 1)
               : 0;
}

struct ref_ray ref_ray(const struct ref_view *v, size_t pixel, double depth)
{
    if (!v->known)
        return (struct ref_ray){{depth, depth * depth}, {1, 2 * depth}};
    const double side = (double)LAYOUT_SIDE_PX, free = (double)LAYOUT_AWAY_PX,
                 behind = (double)LAYOUT_AWAY_BEHIND;
    double x = ref_behind_px(v, pixel, depth), far = side + fabs(x), away = fmax(fabs(x) - free, 0);
    double px = v->known[pixel] > 0.0f ? v->fx * (double)v->known[pixel] / v->known_zeta : 0;
    double slope = away > 0 ? px * (side + free) / (far * far) : 0;
    return (struct ref_ray){{x / (2 * far), (x > 0 ? behind : 1) * away / far},
                            {px * side / (2 * far * far), (x > 0 ? behind : -1) * slope}};
}

/* y = sigmoid(W2 max(0, W1 g^ + b) + b2), see core/splat/appearance.h. */
double ref_appearance(const struct ref_view *v, const struct gauss *g, size_t i, double *unit,
                      double *hidden, double y[APPEARANCE_OUT])
{
    const float *embed = g->embed + i * v->embed_len, *bias = v->frame + v->hidden * v->embed_len,
                *w2 = bias + v->hidden, *b2 = w2 + APPEARANCE_OUT * v->hidden;
    double len = 0;
    for (size_t k = 0; k < v->embed_len; k++)
        len += (double)embed[k] * (double)embed[k];
    len = fmax(sqrt(len), 1e-12);
    for (size_t k = 0; k < v->embed_len; k++)
        unit[k] = (double)embed[k] / len;
    for (size_t h = 0; h < v->hidden; h++) {
        hidden[h] = (double)bias[h];
        for (size_t k = 0; k < v->embed_len; k++)
            hidden[h] += (double)v->frame[h * v->embed_len + k] * unit[k];
    }
    for (size_t o = 0; o < APPEARANCE_OUT; o++) {
        double z = (double)b2[o];
        for (size_t h = 0; h < v->hidden; h++)
            z += (double)w2[o * v->hidden + h] * fmax(hidden[h], 0);
        y[o] = 1 / (1 + exp(-z));
    }
    return len;
}

bool ref_color_open(const struct ref_view *v, const struct ref_splat *s, int channel)
{
    return s->rgb_raw[channel] > 0 && (!v->frame || s->rgb_raw[channel] < 1);
}

static void ref_color(const struct ref_view *v, const struct gauss *g, size_t i,
                      struct ref_splat *s)
{
    size_t count = gauss_sh_count(g->sh_degree);
    double dir[3], len = 0;
    for (int k = 0; k < 3; k++) {
        dir[k] = v->orthographic ? v->rot[6 + k] : (double)g->mean_m[3 * i + k] - v->eye[k];
        len += dir[k] * dir[k];
    }
    len = fmax(sqrt(len), 1e-12);
    for (int k = 0; k < 3; k++)
        dir[k] /= len;
    sh_basis(dir, v->sh_degree, s->basis);
    for (int c = 0; c < 3; c++) {
        s->rgb_raw[c] = 0.5;
        for (size_t k = 0; k < count; k++)
            s->rgb_raw[c] += s->basis[k] * (double)g->sh[(i * count + k) * 3 + c];
        if (v->frame)
            s->rgb_raw[c] += 2 * s->y[c] - 1;
        s->rgb[c] = fmax(s->rgb_raw[c], 0);
        if (v->frame)
            s->rgb[c] = fmin(s->rgb[c], 1);
    }
}

/* render_edge at a mean, between the middles of four cells. */
static double ref_edge(const struct ref_view *v, const float mean_m[3])
{
    double at[2];
    size_t cell[2];
    for (int a = 0; a < 2; a++) {
        const double corner = v->edge->middle_enu_m[a] - v->edge->side_m / 2;
        at[a] = ((double)mean_m[a] + v->origin_enu_m[a] - corner) * LAYOUT_EDGE / v->edge->side_m;
        at[a] = fmin(fmax(at[a] - 0.5, 0), LAYOUT_EDGE - 1.001);
        cell[a] = (size_t)at[a];
        at[a] -= (double)cell[a];
    }
    const float *south = &v->edge->left[cell[1]][cell[0]], *north = south + LAYOUT_EDGE;
    return (1 - at[1]) * ((1 - at[0]) * (double)south[0] + at[0] * (double)south[1]) +
           at[1] * ((1 - at[0]) * (double)north[0] + at[0] * (double)north[1]);
}

bool ref_project(const struct ref_view *v, const struct gauss *g, size_t i, struct ref_splat *out)
{
    struct ref_splat s = {.index = i};
    for (int k = 0; k < 3; k++) {
        s.cam[k] = v->trans[k];
        for (int m = 0; m < 3; m++)
            s.cam[k] += v->rot[3 * k + m] * (double)g->mean_m[3 * i + m];
    }
    if (!(s.cam[2] > v->near_m) || !(s.cam[2] < (double)LAYOUT_DEPTH_MAX))
        return false; /* written so that NaN is culled too, here and below */
    ref_shape(g, i, &s);
    ref_covariance(v, &s);
    if (!(s.det > 0) || !(s.det < (double)LAYOUT_DET_MAX))
        return false;
    s.opacity = s.opacity_raw = 1 / (1 + exp(-(double)g->opacity_logit[i]));
    if (v->frame) {
        double unit[GAUSS_EMBED_MAX], hidden[APPEARANCE_HIDDEN_MAX];
        (void)ref_appearance(v, g, i, unit, hidden, s.y);
        s.opacity = fmin(s.opacity_raw + s.y[LAYOUT_APPEARANCE_OPACITY], 1);
    }
    if (v->edge)
        s.opacity *= ref_edge(v, g->mean_m + 3 * i);
    s.rho = v->compensate ? sqrt(fmax((double)LAYOUT_RHO2_MIN, s.det0 / s.det)) : 1;
    s.opacity_eff = s.opacity * s.rho;
    if (!(s.opacity_eff >= (double)LAYOUT_ALPHA_MIN))
        return false;
    double s00 = s.cov0[0] + v->kernel_px2, s11 = s.cov0[2] + v->kernel_px2;
    s.conic[0] = s11 / s.det;
    s.conic[1] = -s.cov0[1] / s.det;
    s.conic[2] = s00 / s.det;
    if (v->depth_unit_m > 0)
        ref_plane(v, &s);
    double z = v->orthographic ? 1 : s.cam[2];
    s.mean_px[0] = v->fx * s.cam[0] / z + v->cx;
    s.mean_px[1] = v->fy * s.cam[1] / z + v->cy;
    /* Beyond k sigmas alpha is below 1/255. */
    double k = fmin((double)LAYOUT_EXTENT_MAX, sqrt(2 * log(255 * s.opacity_eff)));
    s.half_px[0] = k * sqrt(s00);
    s.half_px[1] = k * sqrt(s11);
    if (!(s.mean_px[0] + s.half_px[0] > 0) || !(s.mean_px[0] - s.half_px[0] < v->width) ||
        !(s.mean_px[1] + s.half_px[1] > 0) || !(s.mean_px[1] - s.half_px[1] < v->height))
        return false;
    /* A splat just before the lens that covers everything is an artefact of the affine
     * approximation. */
    if (s.cam[2] < 4 * v->near_m && fmax(s.half_px[0], s.half_px[1]) > v->half_max_px)
        return false;
    ref_color(v, g, i, &s);
    *out = s;
    return true;
}

static int ref_order(const void *a, const void *b)
{
    const struct ref_splat *x = a, *y = b;
    float zx = (float)x->cam[2], zy = (float)y->cam[2];
    if (zx != zy)
        return zx < zy ? -1 : 1;
    return x->index < y->index ? -1 : x->index > y->index;
}

enum err_code ref_project_all(const struct ref_view *v, const struct gauss *g,
                              struct ref_splat **out, size_t *n, struct err *e)
{
    struct ref_splat *splats = mem_array(g->n, sizeof *splats);
    size_t count = 0;
    *out = NULL;
    *n = 0;
    if (!splats)
        return err_set(e, ERR_MEM, "render_ref: %zu Gaussians", g->n);
    for (size_t i = 0; i < g->n; i++)
        count += ref_project(v, g, i, &splats[count]) ? 1 : 0;
    if (count)
        qsort(splats, count, sizeof *splats, ref_order);
    *out = splats;
    *n = count;
    return ERR_OK;
}

bool ref_alpha(const struct ref_splat *s, double px, double py, double d[2], double *alpha,
               bool *clamped)
{
    d[0] = s->mean_px[0] - px;
    d[1] = s->mean_px[1] - py;
    double sigma =
        0.5 * (s->conic[0] * d[0] * d[0] + s->conic[2] * d[1] * d[1]) + s->conic[1] * d[0] * d[1];
    double a = s->opacity_eff * exp(-sigma);
    if (!(sigma >= 0) || !(a >= (double)LAYOUT_ALPHA_MIN))
        return false;
    *clamped = a > (double)LAYOUT_ALPHA_MAX;
    *alpha = *clamped ? (double)LAYOUT_ALPHA_MAX : a;
    return true;
}

const double *ref_background(const struct ref_view *v, size_t pixel)
{
    bool there = v->background_where && v->background_where[pixel];
    return there ? v->background_there : v->background;
}

enum err_code render_ref_forward(const struct gauss *g, const struct camera *cam,
                                 const struct render_options *o, double *rgb, double *transmittance,
                                 struct err *e)
{
    struct ref_view v;
    struct ref_splat *splats = NULL;
    size_t n = 0;
    enum err_code rc = ref_view_init(g, cam, o, &v, e);
    if (!rc)
        rc = ref_project_all(&v, g, &splats, &n, e);
    for (size_t at = 0; !rc && at < (size_t)v.width * v.height; at++) {
        double px = (double)(at % v.width) + 0.5, py = (double)(at / v.width) + 0.5;
        double t = 1, sum[3] = {0, 0, 0};
        /* Front to back; the splat that brings T to the limit is still blended. */
        for (size_t i = 0; i < n && t > (double)LAYOUT_TRANSMITTANCE_MIN; i++) {
            double d[2], alpha;
            bool clamped;
            if (!ref_alpha(&splats[i], px, py, d, &alpha, &clamped))
                continue;
            for (int c = 0; c < 3; c++)
                sum[c] += splats[i].rgb[c] * alpha * t;
            t *= 1 - alpha;
        }
        for (int c = 0; c < 3; c++)
            rgb[3 * at + c] = sum[c] + t * ref_background(&v, at)[c];
        if (transmittance)
            transmittance[at] = t;
    }
    mem_free(splats);
    return rc;
}

enum err_code render_ref_moments(const struct gauss *g, const struct camera *cam,
                                 const struct render_options *o, double *moments, struct err *e)
{
    struct ref_view v;
    struct ref_splat *splats = NULL;
    size_t n = 0;
    enum err_code rc = ref_view_init(g, cam, o, &v, e);
    if (!rc && !(v.depth_unit_m > 0))
        rc = err_set(e, ERR_ARG, "render_ref_moments: the options have no unit of depth");
    if (!rc)
        rc = ref_project_all(&v, g, &splats, &n, e);
    for (size_t at = 0; !rc && at < (size_t)v.width * v.height; at++) {
        double px = (double)(at % v.width) + 0.5, py = (double)(at / v.width) + 0.5;
        double t = 1, sum[2] = {0, 0};
        for (size_t i = 0; i < n && t > (double)LAYOUT_TRANSMITTANCE_MIN; i++) {
            double d[2], alpha;
            bool clamped;
            if (!ref_alpha(&splats[i], px, py, d, &alpha, &clamped))
                continue;
            struct ref_ray ray = ref_ray(&v, at, ref_depth(&splats[i], d));
            sum[0] += alpha * t * ray.value[0];
            sum[1] += alpha * t * ray.value[1];
            t *= 1 - alpha;
        }
        moments[3 * at] = sum[0];
        moments[3 * at + 1] = sum[1];
        moments[3 * at + 2] = t;
    }
    mem_free(splats);
    return rc;
}
