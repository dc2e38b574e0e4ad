/* Tiles of a web map: see raster.h.
 *
 * A tile is drawn in a plane that touches the earth in its middle. On low zooms this may differ too
 * much from the map's projection. The tile is then drawn in quarters, and these in quarters, until
 * they fit. Parts that do not touch the survey are skipped.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/surface/raster.h"

#include <math.h>

#include "lod/surface/surface.h"

enum { RASTER_WIDE_PX = 32, RASTER_PIECE_MIN = 16 };

static double raster_lat_deg(const struct area *a)
{
    return 0.5 * (a->south_deg + a->north_deg);
}

uint8_t raster_zoom_max(const struct area *a)
{
    uint8_t z = 0;
    while (z < KEY_ZOOM_MAX && 2 * key_edge_m(raster_lat_deg(a), z) > RASTER_PX * a->sigma_m)
        z++;
    return z;
}

uint8_t raster_zoom_min(const struct area *a)
{
    double nw[2], se[2];
    uint8_t z = 0, most = raster_zoom_max(a);
    key_place(a->west_deg, a->north_deg, nw);
    key_place(a->east_deg, a->south_deg, se);
    double wide = fmax(se[0] - nw[0], se[1] - nw[1]);
    while (z < most && ldexp(wide, z) * RASTER_PX < RASTER_WIDE_PX)
        z++;
    return z;
}

float raster_base_m(const struct area *a)
{
    return (float)(store_info(a->store)->origin.h_m + a->floor_m);
}

/* ---- drawing ---- */

struct raster_job {
    struct nadir *nadir;
    const struct raster_tile *tile;
    uint32_t side;
    float *rgb, *height_m; /* of the whole, either may be NULL */
    uint8_t *in;
    float *piece_rgb, *piece_height; /* of a part, [side][side] */
    uint8_t *piece_in;
    double nw[2], se[2]; /* around what was surveyed, in the Mercator square */
};
struct raster_rect {
    uint32_t x, y, w, h;
};

/* Pixel (x, y) of what is drawn, in the Mercator square. */
static void raster_place(const struct raster_job *j, double x, double y, double uv[2])
{
    const struct raster_tile *t = j->tile;
    double n = ldexp(1, t->key.z);
    uv[0] = (t->key.x + (x - t->margin_px) / t->size_px) / n;
    uv[1] = (t->key.y + (y - t->margin_px) / t->size_px) / n;
}

static enum err_code raster_fit(const struct raster_job *j, const struct raster_rect *r,
                                struct nadir_piece *p, double corner[8], double *off_px,
                                struct err *e)
{
    const double x = r->x, y = r->y, w = r->w, h = r->h;
    const double at[NADIR_PLACES][2] = {{x + 0.5 * w, y + 0.5 * h},
                                        {x + w, y + 0.5 * h},
                                        {x + 0.5 * w, y + h},
                                        {x, y},
                                        {x + w, y},
                                        {x, y + h},
                                        {x + w, y + h}};
    double lon[NADIR_PLACES], lat[NADIR_PLACES];
    for (size_t i = 0; i < NADIR_PLACES; i++) {
        double uv[2];
        raster_place(j, at[i][0], at[i][1], uv);
        key_unplace(uv, &lon[i], &lat[i]);
        for (size_t k = 0; k < 2 && i >= NADIR_CORNER; k++)
            corner[2 * (i - NADIR_CORNER) + k] = uv[k];
    }
    p->width = r->w;
    p->height = r->h;
    return nadir_fit(j->nadir, lon, lat, p, off_px, e);
}

static bool raster_any(const struct raster_job *j, const double corner[8])
{
    return corner[0] < j->se[0] && corner[6] > j->nw[0] && corner[1] < j->se[1] &&
           corner[7] > j->nw[1];
}

/* Put what was drawn of a part into the whole. */
static void raster_copy(const struct raster_job *j, const struct raster_rect *r)
{
    for (size_t y = 0; y < r->h; y++)
        for (size_t x = 0; x < r->w; x++) {
            size_t from = y * r->w + x, to = (r->y + y) * j->side + r->x + x;
            bool in = j->piece_in[from];
            j->in[to] = in;
            if (j->height_m)
                j->height_m[to] = in ? j->piece_height[from] : NAN;
            for (size_t k = 0; k < 3 && j->rgb; k++)
                j->rgb[3 * to + k] = in ? j->piece_rgb[3 * from + k] : NAN;
        }
}

static enum err_code raster_rect_draw(const struct raster_job *j, const struct raster_rect *r,
                                      struct err *e)
{
    struct nadir_piece p = {0};
    double corner[8], off_px;
    enum err_code rc = raster_fit(j, r, &p, corner, &off_px, e);
    if (rc || !raster_any(j, corner))
        return rc;
    if (off_px > RASTER_OFF_PX && r->w > RASTER_PIECE_MIN && r->h > RASTER_PIECE_MIN) {
        uint32_t w = r->w / 2, h = r->h / 2;
        const struct raster_rect quarters[4] = {{r->x, r->y, w, h},
                                                {r->x + w, r->y, r->w - w, h},
                                                {r->x, r->y + h, w, r->h - h},
                                                {r->x + w, r->y + h, r->w - w, r->h - h}};
        for (size_t i = 0; !rc && i < 4; i++)
            rc = raster_rect_draw(j, &quarters[i], e);
        return rc;
    }
    if (!area_mask(nadir_area(j->nadir), corner, r->w, r->h, j->piece_in))
        return ERR_OK;
    const struct surface_maps maps = {.rgb = j->rgb ? j->piece_rgb : NULL,
                                      .height_m = j->piece_height};
    rc = j->height_m ? surface_draw(j->nadir, &p, &maps, e)
                     : nadir_draw(j->nadir, &p, j->piece_rgb, NULL, e);
    if (!rc)
        raster_copy(j, r);
    return rc;
}

enum err_code raster_draw(struct nadir *n, const struct raster_tile *t, float *rgb, float *height_m,
                          uint8_t *in, struct err *e)
{
    struct raster_job j = {
        .nadir = n, .tile = t, .side = raster_side(t), .rgb = rgb, .height_m = height_m, .in = in};
    if (!t->size_px || t->size_px > RASTER_SIDE_MAX || t->margin_px > RASTER_SIDE_MAX ||
        j.side > RASTER_SIDE_MAX || !key_valid(t->key))
        return err_set(e, ERR_ARG, "raster tile %u/%u/%u of %u + 2 * %u px: at most %d px",
                       t->key.z, t->key.x, t->key.y, t->size_px, t->margin_px, RASTER_SIDE_MAX);
    const struct area *a = nadir_area(n);
    key_place(a->west_deg, a->north_deg, j.nw);
    key_place(a->east_deg, a->south_deg, j.se);
    size_t pixels = (size_t)j.side * j.side;
    for (size_t i = 0; i < pixels; i++) {
        in[i] = 0;
        if (height_m)
            height_m[i] = NAN;
        for (size_t k = 0; k < 3 && rgb; k++)
            rgb[3 * i + k] = NAN;
    }
    j.piece_rgb = mem_array(pixels, 3 * sizeof *j.piece_rgb);
    j.piece_height = mem_array(pixels, sizeof *j.piece_height);
    j.piece_in = mem_array(pixels, 1);
    enum err_code rc = j.piece_rgb && j.piece_height && j.piece_in
                           ? ERR_OK
                           : err_set(e, ERR_MEM, "out of memory for a tile of %u px", j.side);
    const struct raster_rect whole = {0, 0, j.side, j.side};
    if (!rc)
        rc = raster_rect_draw(&j, &whole, e);
    mem_free(j.piece_rgb);
    mem_free(j.piece_height);
    mem_free(j.piece_in);
    return rc;
}

/* ---- holes ---- */

static float raster_fill_one(const float *height_m, uint32_t side, uint32_t x, uint32_t y,
                             uint32_t reach_px, float base_m)
{
    static const int way[8][2] = {{1, 0},  {1, 1},   {0, 1},  {-1, 1},
                                  {-1, 0}, {-1, -1}, {0, -1}, {1, -1}};
    double sum = 0, weight = 0;
    for (size_t k = 0; k < 8; k++) {
        int64_t px = x, py = y;
        double step = way[k][0] && way[k][1] ? 1.4142135623730951 : 1;
        for (uint32_t d = 1; d * step <= reach_px; d++) {
            px += way[k][0];
            py += way[k][1];
            if (px < 0 || py < 0 || px >= side || py >= side)
                break;
            float h = height_m[(size_t)py * side + (size_t)px];
            if (!isfinite(h))
                continue;
            sum += (double)h / (d * step);
            weight += 1 / (d * step);
            break;
        }
    }
    return weight > 0 ? (float)(sum / weight) : base_m;
}

void raster_fill(const float *height_m, uint32_t side, uint32_t reach_px, float base_m,
                 float *filled)
{
    for (uint32_t y = 0; y < side; y++)
        for (uint32_t x = 0; x < side; x++) {
            float h = height_m[(size_t)y * side + x];
            filled[(size_t)y * side + x] =
                isfinite(h) ? h : raster_fill_one(height_m, side, x, y, reach_px, base_m);
        }
}
