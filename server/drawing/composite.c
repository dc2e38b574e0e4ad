/* Turns the renderer's output into the bytes of a picture.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/drawing/composite.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/image/image.h"
#include "codec/image/png.h"
#include "codec/image/video.h"

static const double composite_unit_m[] = {
    [DEPTH_NONE] = 0, [DEPTH_MM] = 1e-3, [DEPTH_CM] = 1e-2, [DEPTH_DM] = 0.1, [DEPTH_M] = 1};

bool composite_needs_transmittance(const struct composite *p)
{
    return p->background != BACKGROUND_COLOUR;
}

bool composite_needs_depth(const struct composite *p, enum format f)
{
    return p->depth != DEPTH_NONE || f == FORMAT_NPY;
}

void composite_settle(struct composite *p, enum format f, uint32_t supersample, double px,
                      double most_px)
{
    enum { AUTO_MOST = 2 }; /* that of VIEW_SUPERSAMPLE_AUTO */
    while (supersample > 1 && px * supersample * supersample > most_px)
        supersample--;
    if (composite_needs_depth(p, f))
        p->supersample = 1;
    else if (!p->supersample)
        p->supersample = !supersample && px * AUTO_MOST * AUTO_MOST > most_px ? 1 : supersample;
}

enum err_code composite_check(const struct composite *p, enum format f, struct err *e)
{
    if (p->depth != DEPTH_NONE && f != FORMAT_PNG && f != FORMAT_NPY)
        return err_set(e, ERR_DATA, "depth is for png, or npy");
    if (p->depth != DEPTH_NONE && f == FORMAT_NPY)
        return err_set(e, ERR_DATA, "npy is depth in metres: leave its unit out");
    if (composite_needs_depth(p, f) && p->said_background)
        return err_set(e, ERR_DATA, "depth has no background");
    if (p->background == BACKGROUND_TRANSPARENT && f != FORMAT_PNG && f != FORMAT_WEBP)
        return err_set(e, ERR_DATA, "a transparent background is for png and webp");
    return ERR_OK;
}

static uint8_t composite_byte(double v)
{
    v = v * 255 + 0.5;
    return !(v > 0) ? 0 : v >= 255 ? 255 : (uint8_t)v; /* NaN is 0 */
}

/* What pixel x, y looks at behind the city. */
static void composite_sky(const struct backdrop *sky, const struct camera *c, uint32_t x,
                          uint32_t y, double out[3])
{
    const double d[3] = {(x + 0.5 - c->cx_px) / c->fx_px, (y + 0.5 - c->cy_px) / c->fy_px, 1};
    double eye[3], ray[3] = {0};
    for (size_t a = 0; a < 3; a++)
        for (size_t r = 0; r < 3; r++)
            ray[a] += c->rot[3 * r + a] * d[r];
    camera_center(c, eye);
    backdrop_color(sky, eye, ray, out);
}

/* ---- colours ---- */

static void composite_pixels(const struct composite *p, const struct camera *cam,
                             const struct composite_planes *in, struct image *img)
{
    uint8_t *to = img->px;
    for (uint32_t y = 0; y < img->height_px; y++)
        for (uint32_t x = 0; x < img->width_px; x++, to += img->channels) {
            size_t i = (size_t)y * img->width_px + x;
            const float *rgb = in->rgb + 3 * i;
            double left = in->transmittance ? fmin(fmax((double)in->transmittance[i], 0), 1) : 0;
            double sky[3] = {0}, alpha = 1;
            if (p->background == BACKGROUND_SKY && left > 0)
                composite_sky(in->sky, cam, x, y, sky);
            else if (p->background == BACKGROUND_TRANSPARENT)
                alpha = 1 - left;
            for (int a = 0; a < 3; a++)
                to[a] = alpha > 0 ? composite_byte(((double)rgb[a] + left * sky[a]) / alpha) : 0;
            if (img->channels == 4)
                to[3] = composite_byte(alpha);
        }
}

/* ---- depth ---- */

static enum err_code composite_depth_png(double unit_m, const struct camera *cam,
                                         const float *depth_m, struct buf *out, struct err *e)
{
    size_t n = (size_t)cam->width_px * cam->height_px;
    uint16_t *grey = mem_array(n, sizeof *grey);
    char text[160];
    if (!grey)
        return err_set(e, ERR_MEM, "depth: out of memory");
    for (size_t i = 0; i < n; i++) {
        double v = (double)depth_m[i] / unit_m + 0.5;
        grey[i] = !(depth_m[i] > 0) ? 0 : v < 1 ? 1 : v >= 65535 ? 65535 : (uint16_t)v;
    }
    snprintf(text, sizeof text,
             "unit_m=%g; along the optical axis; 0: nothing is seen; 65535: that or farther",
             unit_m);
    enum err_code rc =
        png_encode_grey16(grey, cam->width_px, cam->height_px, "Depth", text, out, e);
    mem_free(grey);
    return rc;
}

/* NumPy's format, version 1.0. */
static enum err_code composite_depth_npy(const struct camera *cam, const float *depth_m,
                                         struct buf *out, struct err *e)
{
    enum { HEAD = 128, FIXED = 10 };
    static const uint8_t magic[8] = {0x93, 'N', 'U', 'M', 'P', 'Y', 1, 0};
    char text[HEAD - FIXED + 1];
    int used =
        snprintf(text, sizeof text, "{'descr': '<f4', 'fortran_order': False, 'shape': (%u, %u), }",
                 cam->height_px, cam->width_px);
    memset(text + used, ' ', sizeof text - 2 - (size_t)used);
    text[sizeof text - 2] = '\n';
    buf_add(out, magic, sizeof magic);
    buf_u16(out, HEAD - FIXED);
    buf_add(out, text, sizeof text - 1);
    size_t n = (size_t)cam->width_px * cam->height_px;
    for (size_t i = 0; i < n; i++)
        buf_f32(out, depth_m[i] > 0 ? depth_m[i] : NAN);
    return buf_check(out, e);
}

enum err_code composite_encode(const struct composite *p, const struct camera *cam, enum format f,
                               int quality, const struct composite_planes *in, struct buf *out,
                               struct err *e)
{
    struct image img = {0};
    if (f == FORMAT_NPY)
        return composite_depth_npy(cam, in->depth_m, out, e);
    if (p->depth != DEPTH_NONE)
        return composite_depth_png(composite_unit_m[p->depth], cam, in->depth_m, out, e);
    enum err_code rc = image_alloc(cam->width_px, cam->height_px,
                                   p->background == BACKGROUND_TRANSPARENT ? 4 : 3, &img, e);
    if (!rc) {
        composite_pixels(p, cam, in, &img);
        rc = image_encode(&img, format_ext(f), quality, out, e);
    }
    image_free(&img);
    return rc;
}

enum err_code composite_frame(const struct composite *p, const struct camera *cam,
                              const struct composite_planes *in, struct buf *out, struct err *e)
{
    struct image img = {0};
    enum err_code rc = image_alloc(cam->width_px, cam->height_px, 3, &img, e);
    uint8_t *to = rc ? NULL : buf_grow(out, video_planes_bytes(cam->width_px, cam->height_px));
    if (to) {
        composite_pixels(p, cam, in, &img);
        video_planes(&img, to);
    }
    image_free(&img);
    return !rc ? buf_check(out, e) : rc;
}

void composite_roll(struct camera *cam, double roll_deg)
{
    double a = roll_deg * (3.14159265358979323846 / 180), c = cos(a), s = sin(a);
    if (!(fabs(roll_deg) > 0))
        return;
    for (size_t k = 0; k < 4; k++) { /* columns of the rotation, then the translation */
        double *x = k < 3 ? &cam->rot[k] : &cam->trans[0],
               *y = k < 3 ? &cam->rot[3 + k] : &cam->trans[1], x0 = *x, y0 = *y;
        *x = c * x0 + s * y0;
        *y = c * y0 - s * x0;
    }
}

bool composite_read_depth(const char *text, size_t n, struct composite *out)
{
    static const char *const units[] = {
        [DEPTH_MM] = "mm", [DEPTH_CM] = "cm", [DEPTH_DM] = "dm", [DEPTH_M] = "m"};
    for (int u = DEPTH_MM; u <= DEPTH_M; u++)
        if (n == strlen(units[u]) && !memcmp(text, units[u], n))
            return out->depth = (enum depth)u, true;
    return false;
}
