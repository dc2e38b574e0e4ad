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
#include <string.h>

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

/* ---- bare ground ---- */

#define RASTER_GROUND_M 25.0             /* half of a building's width, from above */
#define RASTER_EQUATOR_M 156543.03392804 /* a pixel of zoom 0, on the equator */
enum { RASTER_GROUND_BLUR_PX = 1, RASTER_GROUND_BLURS = 2 };

static double raster_pixel_m(struct key k, uint32_t size_px)
{
    double lon, lat;
    key_center(k, &lon, &lat);
    return RASTER_EQUATOR_M * cos(lat * 3.14159265358979323846 / 180) / (double)(1u << k.z) *
           RASTER_PX / size_px;
}

uint32_t raster_ground_radius(struct key k, uint32_t size_px)
{
    return (uint32_t)fmin(ceil(RASTER_GROUND_M / raster_pixel_m(k, size_px)), 1e6);
}

uint8_t raster_ground_zoom(const struct area *a)
{
    uint8_t z = raster_zoom_max(a);
    while (z && raster_ground_radius(key_at(a->west_deg, a->south_deg, z), RASTER_PX) >
                    RASTER_GROUND_PX / 2)
        z--;
    return z;
}

/* Along one line of n values that are `step` apart: the least (or largest) within radius; values
 * that are not finite do not count. */
static void raster_extreme_line(const float *in, float *out, uint32_t n, size_t step,
                                uint32_t radius, bool largest)
{
    for (uint32_t i = 0; i < n; i++) {
        const uint32_t from = i > radius ? i - radius : 0, to = i + radius < n ? i + radius : n - 1;
        float best = NAN;
        for (uint32_t k = from; k <= to; k++) {
            const float v = in[k * step];
            if (isfinite(v) && !(largest ? v <= best : v >= best))
                best = v;
        }
        out[i * step] = best;
    }
}

/* Within a square; scratch [side][side]. */
static void raster_extreme(float *h, float *scratch, uint32_t side, uint32_t radius, bool largest)
{
    for (uint32_t y = 0; y < side; y++)
        raster_extreme_line(h + (size_t)y * side, scratch + (size_t)y * side, side, 1, radius,
                            largest);
    for (uint32_t x = 0; x < side; x++)
        raster_extreme_line(scratch + x, h + x, side, side, radius, largest);
}

/* Rows and columns to the nearest height, the larger of the two, at most `most`. */
static void raster_away(const float *height_m, uint32_t side, uint32_t most, float *away)
{
    for (size_t i = 0; i < (size_t)side * side; i++)
        away[i] = isfinite(height_m[i]) ? 0.0f : (float)most;
    for (int pass = 0; pass < 2; pass++)
        for (size_t k = 0; k < (size_t)side * side; k++) {
            const size_t i = pass ? (size_t)side * side - 1 - k : k, x = i % side, y = i / side;
            const size_t back = pass ? 1 : 0;
            const bool row = pass ? y + 1 < side : y > 0, column = pass ? x + 1 < side : x > 0;
            const bool other = pass ? x > 0 : x + 1 < side;
            const size_t up = back ? i + side : i - side, left = back ? i + 1 : i - 1;
            if (row)
                away[i] = fminf(away[i], away[up] + 1);
            if (column)
                away[i] = fminf(away[i], away[left] + 1);
            if (row && column)
                away[i] = fminf(away[i], away[back ? up + 1 : up - 1] + 1);
            if (row && other)
                away[i] = fminf(away[i], away[back ? up - 1 : up + 1] + 1);
        }
}

static void raster_blur(const float *in, float *out, uint32_t side)
{
    const int64_t r = RASTER_GROUND_BLUR_PX, n = side;
    for (int64_t y = 0; y < n; y++)
        for (int64_t x = 0; x < n; x++) {
            float sum = 0;
            for (int64_t v = y - r; v <= y + r; v++)
                for (int64_t u = x - r; u <= x + r; u++)
                    sum += in[(v < 0    ? 0
                               : v >= n ? n - 1
                                        : v) *
                                  n +
                              (u < 0    ? 0
                               : u >= n ? n - 1
                                        : u)];
            out[y * n + x] = sum / (float)((2 * r + 1) * (2 * r + 1));
        }
}

enum err_code raster_ground(const float *height_m, uint32_t side, uint32_t radius_px, float base_m,
                            float *ground, struct err *e)
{
    const size_t n = (size_t)side * side;
    const uint32_t radius = radius_px ? radius_px : 1;
    float *scratch = mem_array(n, sizeof *scratch);
    if (!scratch)
        return err_set(e, ERR_MEM, "out of memory for the ground of %u x %u px", side, side);
    memcpy(ground, height_m, n * sizeof *ground);
    raster_extreme(ground, scratch, side, radius_px, false);
    raster_extreme(ground, scratch, side, radius_px, true);
    raster_away(height_m, side, 2 * radius, scratch);
    for (size_t i = 0; i < n; i++) {
        const float left = fminf(fmaxf(2.0f - scratch[i] / (float)radius, 0), 1);
        ground[i] = isfinite(ground[i]) ? base_m + (ground[i] - base_m) * left : base_m;
    }
    for (int i = 0; i < RASTER_GROUND_BLURS; i++) {
        raster_blur(ground, scratch, side);
        memcpy(ground, scratch, n * sizeof *ground);
    }
    mem_free(scratch);
    return ERR_OK;
}
