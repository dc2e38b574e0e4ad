/* Pictures and depth of the procedural city for any camera: rays through a lens are traced and
 * shaded.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdlib.h>

#include "codec/image/image.h"
#include "scene/synth/synth.h"

enum { LENS_STEP_PX = 2 }; /* spacing of the table of rays; linear in between is good to 1e-3 px */

static enum err_code draw_rays(struct synth_draw *d, struct err *e)
{
    d->cols = (size_t)d->lens.width_px / LENS_STEP_PX + 2;
    d->rows = (size_t)d->lens.height_px / LENS_STEP_PX + 2;
    d->rays = mem_array(d->rows * d->cols, 2 * sizeof *d->rays);
    if (!d->rays)
        return err_set(e, ERR_MEM, "synth: out of memory for a picture of %u x %u px",
                       d->lens.width_px, d->lens.height_px);
    for (size_t r = 0; r < d->rows; r++)
        for (size_t c = 0; c < d->cols; c++) {
            double x, y;
            if (!lens_undistort(&d->lens, (double)(c * LENS_STEP_PX), (double)(r * LENS_STEP_PX),
                                &x, &y))
                return err_set(
                    e, ERR_ARG,
                    "synth: the distorted lens has no view at the corner of such a wide picture; "
                    "use a smaller --fov-deg");
            d->rays[2 * (r * d->cols + c)] = (float)x;
            d->rays[2 * (r * d->cols + c) + 1] = (float)y;
        }
    return ERR_OK;
}

enum err_code synth_draw_open(const struct synth_city *city, const struct lens *lens,
                              int supersample, double blur_px, struct synth_draw *out,
                              struct err *e)
{
    *out = (struct synth_draw){
        .city = city, .lens = *lens, .supersample = supersample, .blur_px = blur_px};
    enum err_code rc = draw_rays(out, e);
    if (rc)
        synth_draw_close(out);
    return rc;
}

void synth_draw_close(struct synth_draw *d)
{
    mem_free(d->rays);
    *d = (struct synth_draw){0};
}

/* Unit ray of a pixel position in the city's frame; returns the cosine to the optical axis. */
static double draw_ray(const struct synth_draw *d, const double rot[9], double u, double v,
                       double dir[3])
{
    double gu = u / LENS_STEP_PX, gv = v / LENS_STEP_PX;
    size_t c = (size_t)gu, r = (size_t)gv;
    double fu = gu - (double)c, fv = gv - (double)r, x[2];
    const float *p = d->rays + 2 * (r * d->cols + c), *q = p + 2 * d->cols;
    for (int k = 0; k < 2; k++)
        x[k] = (1 - fv) * ((1 - fu) * (double)p[k] + fu * (double)p[2 + k]) +
               fv * ((1 - fu) * (double)q[k] + fu * (double)q[2 + k]);
    double len = sqrt(x[0] * x[0] + x[1] * x[1] + 1);
    for (int i = 0; i < 3; i++)
        dir[i] = (rot[i] * x[0] + rot[3 + i] * x[1] + rot[6 + i]) / len;
    return 1 / len;
}

/* Camera pose in the city's frame. */
static void draw_pose(const struct synth_city *c, const struct camera *cam, double eye[3],
                      double rot[9])
{
    double cs = cos(c->yaw_rad), sn = sin(c->yaw_rad), p[3];
    camera_center(cam, p);
    eye[0] = cs * p[0] + sn * p[1];
    eye[1] = -sn * p[0] + cs * p[1];
    eye[2] = p[2];
    for (int i = 0; i < 3; i++) {
        rot[3 * i] = cam->rot[3 * i] * cs + cam->rot[3 * i + 1] * sn;
        rot[3 * i + 1] = -cam->rot[3 * i] * sn + cam->rot[3 * i + 1] * cs;
        rot[3 * i + 2] = cam->rot[3 * i + 2];
    }
}

/* One row or column of three channels blurred by a Gaussian; `step` is the distance of neighbours
 * in floats. */
static void draw_blur_line(float *v, size_t n, size_t step, const float *tap, int radius,
                           float *line)
{
    for (size_t k = 0; k < 3; k++) {
        for (size_t i = 0; i < n; i++)
            line[i] = v[i * step + k];
        for (size_t i = 0; i < n; i++) {
            float sum = 0;
            for (int t = -radius; t <= radius; t++) {
                ptrdiff_t at = (ptrdiff_t)i + t;
                sum += tap[abs(t)] * line[at < 0 ? 0 : at >= (ptrdiff_t)n ? (ptrdiff_t)n - 1 : at];
            }
            v[i * step + k] = sum;
        }
    }
}

/* No lens is sharper than its pixels: without this, detail finer than a pixel turns into patterns
 * that differ from photograph to photograph and that no scene can explain. */
enum err_code synth_draw_blur(float *rgb, size_t w, size_t h, double sigma_px, struct err *e)
{
    enum { RADIUS_MAX = 16 };
    int radius = (int)fmin(ceil(3 * sigma_px), RADIUS_MAX);
    float tap[RADIUS_MAX + 1], sum = 0;
    if (radius == 0)
        return ERR_OK;
    float *line = mem_array(w > h ? w : h, sizeof *line);
    if (!line)
        return err_set(e, ERR_MEM, "synth: out of memory for a picture");
    for (int t = 0; t <= radius; t++) {
        tap[t] = (float)exp(-0.5 * t * t / (sigma_px * sigma_px));
        sum += t ? 2 * tap[t] : tap[t];
    }
    for (int t = 0; t <= radius; t++)
        tap[t] /= sum;
    for (size_t y = 0; y < h; y++)
        draw_blur_line(rgb + 3 * w * y, w, 3, tap, radius, line);
    for (size_t x = 0; x < w; x++)
        draw_blur_line(rgb + 3 * x, h, 3 * w, tap, radius, line);
    mem_free(line);
    return ERR_OK;
}

enum err_code synth_draw_picture(const struct synth_draw *d, const struct camera *cam,
                                 const struct synth_light *light, const struct synth_grid *moving,
                                 struct image *out, struct err *e)
{
    double eye[3], rot[9], dir[3];
    int ss = d->supersample;
    size_t w = cam->width_px, h = cam->height_px;
    enum err_code rc = image_alloc(cam->width_px, cam->height_px, 3, out, e);
    if (rc)
        return rc;
    float *linear = mem_array(w * h, 3 * sizeof *linear);
    if (!linear)
        return err_set(e, ERR_MEM, "synth: out of memory for a picture of %zu x %zu px", w, h);
    draw_pose(d->city, cam, eye, rot);
    for (size_t y = 0; y < h; y++)
        for (size_t x = 0; x < w; x++) {
            float *sum = linear + 3 * (y * w + x);
            for (int s = 0; s < ss * ss; s++) {
                /* The fixed pattern of a rotated grid: no two samples share a row or a column. */
                double du = ((s % ss) + (0.5 + s / ss) / ss) / ss,
                       dv = ((s / ss) + 1 - (0.5 + s % ss) / ss) / ss;
                draw_ray(d, rot, (double)x + du, (double)y + dv, dir);
                struct synth_hit hit;
                float rgb[3];
                synth_trace_ray(d->city, moving, eye, dir, &hit);
                synth_shade_hit(d->city, moving, light, dir, &hit, hit.t_m / cam->fx_px, rgb);
                for (int k = 0; k < 3; k++)
                    sum[k] += (rgb[k] < 1 ? rgb[k] : 1) / (float)(ss * ss);
            }
        }
    rc = synth_draw_blur(linear, w, h, d->blur_px, e);
    for (size_t i = 0; !rc && i < 3 * w * h; i++)
        out->px[i] = synth_shade_encode(linear[i]);
    mem_free(linear);
    return rc;
}

double synth_draw_hit(const struct synth_draw *d, const struct camera *cam, double u_px,
                      double v_px, struct synth_hit *hit)
{
    double eye[3], rot[9], dir[3];
    draw_pose(d->city, cam, eye, rot);
    double cosine = draw_ray(d, rot, u_px, v_px, dir);
    synth_trace_ray(d->city, NULL, eye, dir, hit);
    return isfinite(hit->t_m) ? hit->t_m * cosine : 0;
}

void synth_draw_depth(const struct synth_draw *d, const struct camera *cam, float *depth)
{
    struct synth_hit hit;
    size_t w = cam->width_px, h = cam->height_px;
    for (size_t i = 0; i < w * h; i++)
        depth[i] =
            (float)synth_draw_hit(d, cam, (double)(i % w) + 0.5, (double)(i / w) + 0.5, &hit);
}
