/* The surface at single places: see probe.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/probe.h"

#include <math.h>
#include <string.h>

enum { PROBE_PX = 17, PROBE_MIDDLE = PROBE_PX / 2 }; /* odd: a pixel centre lies in the middle */

/* The deepest tile over a place that is surveyed. */
static void probe_tile(const struct nadir *n, double lon_deg, double lat_deg, struct probe *out)
{
    const struct store *s = nadir_store(n);
    struct key k = key_at(lon_deg, lat_deg, store_info(s)->zoom_max);
    out->surveyed = area_holds(nadir_area(n), lon_deg, lat_deg);
    while (out->surveyed && k.z > store_info(s)->zoom_min && !store_find(s, k))
        k = key_parent(k);
    const struct store_tile *t = out->surveyed ? store_find(s, k) : NULL;
    out->tile = k;
    out->level = t ? t->level : 0;
}

enum err_code probe_at(struct nadir *n, double lon_deg, double lat_deg, double gsd_m,
                       struct probe *out, struct err *e)
{
    float rgb[PROBE_PX * PROBE_PX * 3], height[PROBE_PX * PROBE_PX];
    double gsd = gsd_m > 0 ? gsd_m : nadir_area(n)->sigma_m;
    const struct nadir_piece p = {lon_deg, lat_deg, 0, 1 / gsd, 1 / gsd, PROBE_PX, PROBE_PX};
    memset(out, 0, sizeof *out);
    out->height_m = out->height_min_m = out->height_max_m = (double)NAN;
    out->pixel_m = gsd;
    if (!(fabs(lon_deg) <= 180) || !(fabs(lat_deg) <= 90))
        return err_set(e, ERR_ARG, "%g,%g: longitude -180 to 180 and latitude -90 to 90 wanted",
                       lon_deg, lat_deg);
    probe_tile(n, lon_deg, lat_deg, out);
    if (!out->surveyed)
        return ERR_OK;
    enum err_code rc = nadir_draw(n, &p, rgb, height, e);
    size_t at = PROBE_MIDDLE * PROBE_PX + PROBE_MIDDLE;
    if (rc || !isfinite(height[at]))
        return rc;
    out->found = true;
    out->height_m = (double)height[at];
    memcpy(out->rgb, rgb + 3 * at, sizeof out->rgb);
    for (size_t i = 0; i < 9; i++) { /* fmin and fmax take no notice of NAN */
        double h = (double)height[at + i % 3 - 1 + (i / 3) * PROBE_PX - PROBE_PX];
        out->height_min_m = fmin(out->height_min_m, h);
        out->height_max_m = fmax(out->height_max_m, h);
    }
    return ERR_OK;
}
