/* What lies above the horizon of a photograph: see ingest_internal.h.
 *
 * Gaussians cannot show the sky: it has no distance. In training its pixels would pull what stands
 * at the rim of the survey over the edge of the city, to hide the black behind it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "codec/image/image.h"
#include "codec/scene/mask.h"
#include "codec/scene/scene.h"
#include "scene/ingest/ingest_internal.h"

bool ingest_sky_looks_up(const struct camera *c)
{
    double ray[3], up = -HUGE_VAL;
    for (int k = 0; k < 4; k++) { /* it is a linear function: greatest at a corner */
        camera_ray(c, k % 2 ? c->width_px : 0.0, k / 2 ? c->height_px : 0.0, ray);
        up = fmax(up, ray[2]);
    }
    return up > 0.0;
}

double ingest_sky_slope(const struct scene *s, const struct camera *c)
{
    double eye[3], slope = s->n_points ? 0.0 : HUGE_VAL;
    camera_center(c, eye);
    for (size_t i = 0; i < s->n_points; i++) {
        const double *p = s->points[i].enu_m, up = p[2] - eye[2];
        if (up > 0.0)
            slope = fmax(slope, up / hypot(p[0] - eye[0], p[1] - eye[1]));
    }
    return slope;
}

size_t ingest_sky_mark(const struct camera *c, double slope, uint8_t *mask)
{
    size_t n = 0;
    for (uint32_t y = 0; y < c->height_px; y++)
        for (uint32_t x = 0; x < c->width_px; x++) {
            double ray[3];
            camera_ray(c, x + 0.5, y + 0.5, ray);
            if (!(ray[2] > 0.0 && ray[2] > slope * hypot(ray[0], ray[1])))
                continue;
            mask[(size_t)y * c->width_px + x] = 0;
            n++;
        }
    return n;
}

enum err_code ingest_sky_mask(const struct scene *s, const struct camera *c, const char *path,
                              bool there, bool *seen, struct err *e)
{
    struct image mask = {0};
    *seen = false;
    if (!ingest_sky_looks_up(c))
        return ERR_OK;
    enum err_code rc = there ? mask_read(path, c->width_px, c->height_px, &mask, e)
                             : image_alloc(c->width_px, c->height_px, 1, &mask, e);
    if (!rc && !there)
        memset(mask.px, 255, (size_t)c->width_px * c->height_px);
    *seen = !rc && ingest_sky_mark(c, ingest_sky_slope(s, c), mask.px);
    if (*seen)
        rc = image_write(path, &mask, 0, NULL, e);
    image_free(&mask);
    return rc;
}
