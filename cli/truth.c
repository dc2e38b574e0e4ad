/* Compares an orthophoto with the procedural city that it shows: see truth.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/truth.h"

#include <math.h>

#include "codec/image.h"
#include "core/geo.h"
#include "survey/sheet.h"

enum { TRUTH_SUPERSAMPLE = 3 /* rays per pixel and axis at least, as map views have them */ };

struct truth_job {
    struct synth_config cfg; /* of the city */
    struct synth_city city;
    struct geo_origin origin;
    struct sheet *map;
    struct geotiff *out; /* NULL: none */
    uint8_t *rgba;       /* of a piece of the orthophoto, then of the truth */
    double error[2];     /* sums of squares: of all, of what is inside */
    uint64_t pixels[2];
};

static enum err_code truth_corners(const struct truth_job *j, uint32_t x, uint32_t y,
                                   const uint32_t size[2], double at[4][2], struct err *e)
{
    const struct map_grid *g = sheet_grid(j->map);
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < 4; i++) {
        double lon = g->west_m + (double)(x + (i & 1) * size[0]) * g->pixel_m,
               lat = g->north_m - (double)(y + (i >> 1) * size[1]) * g->pixel_m, enu[3];
        rc = crs_unproject(sheet_crs(j->map), 1, &lon, &lat, e);
        if (!rc)
            rc = geo_to_enu(&j->origin, lon, lat, j->origin.h_m, enu, e);
        at[i][0] = enu[0];
        at[i][1] = enu[1];
    }
    return rc;
}

/* Compare, and leave the truth with the orthophoto's alpha in rgba. */
static void truth_compare(struct truth_job *j, const struct image *truth, const double at[4][2])
{
    double cs = cos(j->city.yaw_rad), sn = sin(j->city.yaw_rad), half = j->city.half_m;
    size_t w = truth->width_px, h = truth->height_px;
    for (size_t i = 0; i < w * h; i++) {
        uint8_t *px = j->rgba + 4 * i;
        double s = ((double)(i % w) + 0.5) / (double)w, t = ((double)(i / w) + 0.5) / (double)h,
               p[2], sum = 0;
        for (size_t k = 0; k < 2; k++)
            p[k] = (1 - t) * ((1 - s) * at[0][k] + s * at[1][k]) +
                   t * ((1 - s) * at[2][k] + s * at[3][k]);
        bool inside = fabs(cs * p[0] + sn * p[1]) <= half && fabs(-sn * p[0] + cs * p[1]) <= half;
        for (size_t k = 0; k < 3; k++) {
            double d = (double)px[k] - (double)truth->px[3 * i + k];
            sum += d * d;
            px[k] = px[3] ? truth->px[3 * i + k] : 0;
        }
        for (size_t k = 0; px[3] && k < 1 + (size_t)inside; k++) {
            j->error[k] += sum;
            j->pixels[k]++;
        }
    }
}

static enum err_code truth_piece(struct truth_job *j, uint32_t x, uint32_t y, struct err *e)
{
    const struct map_grid *g = sheet_grid(j->map);
    const uint32_t size[2] = {g->width - x < MAP_PIECE_PX ? g->width - x : MAP_PIECE_PX,
                              g->height - y < MAP_PIECE_PX ? g->height - y : MAP_PIECE_PX};
    struct image truth = {0};
    double at[4][2];
    bool any = false;
    int rays = j->cfg.supersample > TRUTH_SUPERSAMPLE ? (int)j->cfg.supersample : TRUTH_SUPERSAMPLE;
    enum err_code rc = sheet_read(j->map, x, y, size[0], size[1], j->rgba, e);
    for (size_t i = 0; !rc && !any && i < (size_t)size[0] * size[1]; i++)
        any = j->rgba[4 * i + 3];
    if (rc || !any)
        return rc;
    rc = truth_corners(j, x, y, size, at, e);
    if (!rc)
        rc = synth_map_draw(&j->city, (const double(*)[2])at, size, rays, j->cfg.lens_blur_px,
                            &truth, e);
    if (!rc)
        truth_compare(j, &truth, (const double(*)[2])at);
    if (!rc && j->out)
        rc = geotiff_write(j->out, x, y, size[0], size[1], j->rgba, e);
    image_free(&truth);
    return rc;
}

static enum err_code truth_draw(struct truth_job *j, struct err *e)
{
    const struct map_grid *g = sheet_grid(j->map);
    struct progress bar;
    uint64_t done = 0;
    enum err_code rc = ERR_OK;
    j->rgba = mem_array((size_t)MAP_PIECE_PX * MAP_PIECE_PX, 4);
    if (!j->rgba)
        return err_set(e, ERR_MEM, "out of memory for a piece of %d px", MAP_PIECE_PX);
    progress_start(&bar, "draw the city from above, rows", g->height);
    for (uint32_t y = 0; !rc && y < g->height; y += MAP_PIECE_PX) {
        for (uint32_t x = 0; !rc && x < g->width; x += MAP_PIECE_PX)
            rc = truth_piece(j, x, y, e);
        done += g->height - y < MAP_PIECE_PX ? g->height - y : MAP_PIECE_PX;
        progress_step(&bar, done, NULL);
    }
    progress_end(&bar, NULL);
    if (!rc && !j->pixels[0])
        rc = err_set(e, ERR_DATA, "%s: nothing is shown in it", j->cfg.map);
    return rc;
}

static enum err_code truth_create(struct truth_job *j, const char *path, struct err *e)
{
    struct geotiff_info info = sheet_info(j->map);
    info.source = "procedural city";
    return path ? geotiff_create(path, GEOTIFF_COLOR, &info, &j->out, e) : ERR_OK;
}

static double truth_psnr(double sum, uint64_t pixels)
{
    return pixels ? -10 * log10(fmax(sum, 1e-9) / (3.0 * (double)pixels * 255 * 255)) : (double)NAN;
}

enum err_code truth_map(const struct synth_config *cfg, struct truth_score *out, struct err *e)
{
    struct truth_job j = {0};
    struct arena arena = {0};
    enum err_code rc = synth_views_config(cfg, &j.cfg, &arena, e);
    j.cfg.map = cfg->map;
    if (!rc)
        rc = synth_city_make(&j.cfg, &j.city, e);
    j.origin = (struct geo_origin){j.cfg.lon_deg, j.cfg.lat_deg, j.cfg.ground_h_m};
    if (!rc)
        rc = sheet_open(cfg->map, GEOTIFF_COLOR, &j.map, e);
    if (!rc)
        rc = truth_create(&j, cfg->output, e);
    if (!rc)
        rc = truth_draw(&j, e);
    if (!rc && j.out)
        rc = geotiff_commit(&j.out, e);
    *out = (struct truth_score){j.pixels[0], j.pixels[1], truth_psnr(j.error[0], j.pixels[0]),
                                truth_psnr(j.error[1], j.pixels[1])};
    geotiff_close(&j.out);
    sheet_close(&j.map);
    synth_city_free(&j.city);
    mem_free(j.rgba);
    arena_free(&arena);
    return rc;
}
