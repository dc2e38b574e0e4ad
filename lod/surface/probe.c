/* The surface at single places: see probe.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/surface/probe.h"

#include <math.h>
#include <string.h>

enum { PROBE_PX = 17, PROBE_WIDE_PX = 129 }; /* odd: a pixel centre lies in the middle */

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

struct probe_picture { /* 17 px for one place, 129 for many */
    uint32_t side;
    double gsd_m;
    struct surface_maps maps;
};

static void probe_read(const struct probe_picture *p, uint32_t x, uint32_t y, struct probe *out)
{
    size_t at = (size_t)y * p->side + x;
    if (!isfinite(p->maps.height_m[at]))
        return;
    out->found = true;
    out->height_m = (double)p->maps.height_m[at];
    out->sigma_m = (double)p->maps.sigma_m[at];
    out->noise_m = (double)p->maps.noise_m[at];
    memcpy(out->rgb, p->maps.rgb + 3 * at, sizeof out->rgb);
    for (size_t i = 0; i < 9; i++) { /* fmin and fmax take no notice of NAN */
        double h = (double)p->maps.height_m[at + i % 3 - 1 + (i / 3) * p->side - p->side];
        out->height_min_m = fmin(out->height_min_m, h);
        out->height_max_m = fmax(out->height_max_m, h);
    }
}

/* Where a place lies in a picture around `middle`; false: not in it, with a pixel around. */
static bool probe_pixel(const struct probe_picture *p, const double middle[2], const double at[2],
                        uint32_t *x, uint32_t *y)
{
    const struct geo_origin here = {middle[0], middle[1], 0};
    double enu[3], reach = p->side / 2 - 1;
    if (fabs(at[1] - middle[1]) > 1 || geo_to_enu(&here, at[0], at[1], 0, enu, NULL))
        return false;
    double u = floor(enu[0] / p->gsd_m + 0.5), v = floor(-enu[1] / p->gsd_m + 0.5);
    if (!(fabs(u) <= reach) || !(fabs(v) <= reach))
        return false;
    *x = (uint32_t)(u + p->side / 2);
    *y = (uint32_t)(v + p->side / 2);
    return true;
}

static enum err_code probe_place(struct nadir *n, const double at[2], double gsd, struct probe *out,
                                 struct err *e)
{
    memset(out, 0, sizeof *out);
    out->height_m = out->height_min_m = out->height_max_m = (double)NAN;
    out->sigma_m = out->noise_m = (double)NAN;
    out->pixel_m = gsd;
    if (!(fabs(at[0]) <= 180) || !(fabs(at[1]) <= 90))
        return err_set(e, ERR_ARG, "%g,%g: longitude -180 to 180 and latitude -90 to 90 wanted",
                       at[0], at[1]);
    probe_tile(n, at[0], at[1], out);
    return ERR_OK;
}

/* Draw around place i, and read all places from there on that the picture shows. */
static enum err_code probe_around(struct nadir *n, const double (*lonlat)[2], size_t i,
                                  size_t count, double gsd, bool *done, struct probe *out,
                                  struct err *e)
{
    struct probe_picture p = {.side = PROBE_WIDE_PX, .gsd_m = gsd};
    size_t near = 0;
    uint32_t x, y;
    for (size_t k = i + 1; k < count && !near; k++)
        near += !done[k] && probe_pixel(&p, lonlat[i], lonlat[k], &x, &y);
    if (!near)
        p.side = PROBE_PX;
    const struct nadir_piece piece = {.lon_deg = lonlat[i][0],
                                      .lat_deg = lonlat[i][1],
                                      .px_per_m_x = 1 / gsd,
                                      .px_per_m_y = 1 / gsd,
                                      .width = p.side,
                                      .height = p.side};
    size_t pixels = (size_t)p.side * p.side;
    float *room = mem_array(pixels, 6 * sizeof *room);
    p.maps = (struct surface_maps){.rgb = room,
                                   .height_m = room + 3 * pixels,
                                   .sigma_m = room + 4 * pixels,
                                   .noise_m = room + 5 * pixels};
    enum err_code rc = room ? surface_draw(n, &piece, &p.maps, e)
                            : err_set(e, ERR_MEM, "out of memory for a picture");
    for (size_t k = i; !rc && k < count; k++) {
        if (done[k] || !probe_pixel(&p, lonlat[i], lonlat[k], &x, &y))
            continue;
        done[k] = true;
        probe_read(&p, x, y, &out[k]);
    }
    mem_free(room);
    return rc;
}

enum err_code probe_many(struct nadir *n, const double (*lonlat)[2], size_t count, double gsd_m,
                         struct probe *out, struct err *e)
{
    double gsd = gsd_m > 0 ? gsd_m : nadir_area(n)->sigma_m;
    bool *done = mem_array(count + 1, sizeof *done);
    enum err_code rc = done ? ERR_OK : err_set(e, ERR_MEM, "out of memory for %zu places", count);
    for (size_t i = 0; !rc && i < count; i++) {
        rc = probe_place(n, lonlat[i], gsd, &out[i], e);
        done[i] = !out[i].surveyed;
    }
    for (size_t i = 0; !rc && i < count; i++)
        if (!done[i])
            rc = probe_around(n, lonlat, i, count, gsd, done, out, e);
    mem_free(done);
    return rc;
}
