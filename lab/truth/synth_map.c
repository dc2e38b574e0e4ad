/* The procedural city from straight above, orthographically: see synth.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>

#include "codec/image/image.h"
#include "core/pool.h"
#include "lab/truth/synth_map.h"

static const double map_eye_m = 1e4; /* above everything */

struct map_draw {
    const struct synth_city *city;
    struct synth_light light;
    const double (*corner)[2];
    size_t w, h, margin; /* of the picture, around which rays are drawn for the blur */
    int supersample;
    double pixel_m;
    float *linear; /* [h + 2 margin][w + 2 margin][3] */
};

/* The colour of what is below (u, v) pixels from the top left corner. */
static void map_ray(const struct map_draw *d, double u, double v, float rgb[3])
{
    const struct synth_city *c = d->city;
    double s = u / (double)d->w, t = v / (double)d->h, at[2], cs = cos(c->yaw_rad),
           sn = sin(c->yaw_rad);
    for (size_t k = 0; k < 2; k++)
        at[k] = (1 - t) * ((1 - s) * d->corner[0][k] + s * d->corner[1][k]) +
                t * ((1 - s) * d->corner[2][k] + s * d->corner[3][k]);
    const double eye[3] = {cs * at[0] + sn * at[1], -sn * at[0] + cs * at[1], map_eye_m},
                 down[3] = {0, 0, -1};
    struct synth_hit hit;
    synth_trace_ray(c, NULL, eye, down, &hit);
    synth_shade_hit(c, NULL, &d->light, down, &hit, d->pixel_m, rgb);
}

static enum err_code map_row(void *user, size_t y, struct err *e)
{
    const struct map_draw *d = user;
    size_t wide = d->w + 2 * d->margin;
    int n = d->supersample;
    if (signals_stopping())
        return err_set(e, ERR_CANCEL, "stopped");
    for (size_t x = 0; x < wide; x++) {
        float *sum = d->linear + 3 * (y * wide + x);
        for (int s = 0; s < n * n; s++) { /* a rotated grid, as photographs have it */
            double du = ((s % n) + (0.5 + s / n) / n) / n,
                   dv = ((s / n) + 1 - (0.5 + s % n) / n) / n;
            float rgb[3];
            map_ray(d, (double)x - (double)d->margin + du, (double)y - (double)d->margin + dv, rgb);
            for (size_t k = 0; k < 3; k++)
                sum[k] += fminf(rgb[k], 1) / (float)(n * n);
        }
    }
    return ERR_OK;
}

enum err_code synth_map_draw(const struct synth_city *c, const double corner_enu_m[4][2],
                             const uint32_t size_px[2], int supersample, double blur_px,
                             struct image *out, struct err *e)
{
    const double(*at)[2] = corner_enu_m;
    struct map_draw d = {.city = c,
                         .light = synth_shade_light(),
                         .corner = corner_enu_m,
                         .w = size_px[0],
                         .h = size_px[1],
                         .margin = (size_t)ceil(3 * blur_px),
                         .supersample = supersample,
                         .pixel_m = hypot(at[1][0] - at[0][0], at[1][1] - at[0][1]) / size_px[0]};
    size_t wide = d.w + 2 * d.margin, high = d.h + 2 * d.margin;
    enum err_code rc = image_alloc(size_px[0], size_px[1], 3, out, e);
    if (rc)
        return rc;
    d.linear = mem_array(wide * high, 3 * sizeof *d.linear);
    rc = d.linear ? pool_for(high, 0, map_row, &d, e)
                  : err_set(e, ERR_MEM, "synth: out of memory for a map of %zu x %zu px", d.w, d.h);
    if (!rc)
        rc = synth_draw_blur(d.linear, wide, high, blur_px, e);
    for (size_t y = 0; !rc && y < d.h; y++)
        for (size_t i = 0; i < 3 * d.w; i++)
            out->px[3 * y * d.w + i] =
                synth_shade_encode(d.linear[3 * ((y + d.margin) * wide + d.margin) + i]);
    mem_free(d.linear);
    return rc;
}
