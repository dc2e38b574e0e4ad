/* Compares a surface model with the procedural city that it shows: see truth_heights.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/truth/truth_heights.h"

#include <math.h>
#include <string.h>

#include "core/geo/geo.h"
#include "core/math/sort.h"
#include "lab/truth/truth_config.h"
#include "survey/geotiff.h"
#include "survey/sheet.h"

enum { TRUTH_PIXELS_MAX = 40000000, TRUTH_NEAR_PX = 2 };
static const double truth_eye_m = 1e4, truth_earth_m = 6371000, truth_steep_m = 1;

struct heights_job {
    const struct truth_request *q;
    struct synth_config cfg; /* of the city */
    struct synth_city city;
    struct geo_origin origin;
    struct sheet *map;
    size_t w, h;
    double pixel_m, corner[4][2]; /* ENU: top left, top right, bottom left, bottom right */
    float *model, *truth, *sigma; /* [h][w]; sigma is NULL if the map has none */
    uint8_t *apart; /* [h][w] near an edge, or of bare earth: something stands there */
    struct edge_list edges;
};

/* ENU of a place of the picture, pixels from the top left corner; and whether it is built up. */
static bool truth_heights_place(const struct heights_job *j, double u, double v, double at[2])
{
    double s = u / (double)j->w, t = v / (double)j->h, cs = cos(j->city.yaw_rad),
           sn = sin(j->city.yaw_rad), half = j->city.half_m;
    for (size_t k = 0; k < 2; k++)
        at[k] = (1 - t) * ((1 - s) * j->corner[0][k] + s * j->corner[1][k]) +
                t * ((1 - s) * j->corner[2][k] + s * j->corner[3][k]);
    return fabs(cs * at[0] + sn * at[1]) <= half && fabs(-sn * at[0] + cs * at[1]) <= half;
}

/* Ellipsoidal height of what is seen there from above, or of the ground below it. */
static float truth_heights_at(const struct heights_job *j, double u, double v, bool *covered)
{
    double at[2], cs = cos(j->city.yaw_rad), sn = sin(j->city.yaw_rad);
    (void)truth_heights_place(j, u, v, at);
    const double eye[3] = {cs * at[0] + sn * at[1], -sn * at[0] + cs * at[1], truth_eye_m},
                 down[3] = {0, 0, -1};
    struct synth_hit hit;
    synth_trace_ray(&j->city, NULL, eye, down, &hit);
    *covered = hit.solid;
    return (float)(j->origin.h_m + truth_eye_m - (j->q->ground ? truth_eye_m : hit.t_m) +
                   (at[0] * at[0] + at[1] * at[1]) / (2 * truth_earth_m));
}

static enum err_code truth_heights_read(struct heights_job *j, struct err *e)
{
    const struct map_grid *g = sheet_grid(j->map);
    double n = (double)g->width * g->height;
    j->w = g->width;
    j->h = g->height;
    j->pixel_m = g->pixel_m;
    if (n > TRUTH_PIXELS_MAX)
        return err_set(e, ERR_LIMIT, "%s: %.3g pixels: at most %d are compared with a city",
                       j->q->map, n, TRUTH_PIXELS_MAX);
    j->model = mem_array(j->w * j->h, sizeof *j->model);
    j->truth = mem_array(j->w * j->h, sizeof *j->truth);
    j->apart = mem_array(j->w * j->h, 1);
    if (!j->model || !j->truth || !j->apart)
        return err_set(e, ERR_MEM, "%s: out of memory for %.3g pixels", j->q->map, n);
    enum err_code rc = sheet_read(j->map, 0, 0, g->width, g->height, j->model, e);
    if (!rc && sheet_has_sigma(j->map)) {
        j->sigma = mem_array(j->w * j->h, sizeof *j->sigma);
        rc = j->sigma ? sheet_read_sigma(j->map, 0, 0, g->width, g->height, j->sigma, e)
                      : err_set(e, ERR_MEM, "%s: out of memory for %.3g pixels", j->q->map, n);
    }
    for (size_t i = 0; !rc && i < 4; i++) {
        double x = g->west_m + (double)(i & 1) * g->width * g->pixel_m,
               y = g->north_m - (double)(i >> 1) * g->height * g->pixel_m, enu[3];
        rc = crs_unproject(sheet_crs(j->map), 1, &x, &y, e);
        if (!rc)
            rc = geo_to_enu(&j->origin, x, y, j->origin.h_m, enu, e);
        memcpy(j->corner[i], enu, sizeof j->corner[i]);
    }
    for (size_t i = 0; !rc && i < j->w * j->h; i++) {
        double at[2], u = (double)(i % j->w) + 0.5, v = (double)(i / j->w) + 0.5;
        bool in = truth_heights_place(j, u, v, at), covered = false;
        j->model[i] = !in || j->model[i] < GEOTIFF_NODATA + 1 ? NAN : j->model[i];
        j->truth[i] = in ? truth_heights_at(j, u, v, &covered) : NAN;
        j->apart[i] = covered;
    }
    return rc;
}

/* No step of the truth within two pixels. */
static bool truth_heights_level(const struct heights_job *j, size_t x, size_t y)
{
    double lo = HUGE_VAL, hi = -HUGE_VAL;
    for (size_t v = y - TRUTH_NEAR_PX; v <= y + TRUTH_NEAR_PX; v++)
        for (size_t u = x - TRUTH_NEAR_PX; u <= x + TRUTH_NEAR_PX; u++) {
            lo = fmin(lo, (double)j->truth[v * j->w + u]);
            hi = fmax(hi, (double)j->truth[v * j->w + u]);
        }
    return hi - lo <= truth_steep_m;
}

static enum err_code truth_heights_rays(struct heights_job *j, struct truth_heights *out,
                                        struct surface_rays *rays, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t y = TRUTH_NEAR_PX; y + TRUTH_NEAR_PX < j->h; y++)
        for (size_t x = TRUTH_NEAR_PX; !rc && x + TRUTH_NEAR_PX < j->w; x++) {
            size_t i = y * j->w + x;
            if (!isfinite(j->truth[i]))
                continue;
            if (!j->q->ground)
                j->apart[i] = !truth_heights_level(j, x, y);
            const struct surface_ray r = {.error_m = j->model[i] - j->truth[i],
                                          .found = isfinite(j->model[i]),
                                          .edge = j->apart[i]};
            out->inside++;
            out->none += !r.found;
            out->volume_m3 += r.found ? (double)r.error_m * j->pixel_m * j->pixel_m : 0;
            rc = surface_rays_add(rays, &r, e);
        }
    return rc;
}

/* Errors against standard deviations; which: 0 apart from edges, 1 near them, 2 all. ratio [h][w]
 * is room. */
static void truth_heights_sigma(const struct heights_job *j, int which, float *ratio,
                                struct truth_sigma *out)
{
    size_t n = 0, within[3] = {0};
    for (size_t i = 0; i < j->w * j->h; i++) {
        float r = fabsf(j->model[i] - j->truth[i]) / j->sigma[i];
        if (!(j->sigma[i] > 0) || !isfinite(r) || (which < 2 && which != j->apart[i]))
            continue;
        for (int k = 0; k < 3; k++)
            within[k] += r <= (float)(k + 1);
        ratio[n++] = r;
    }
    *out = (struct truth_sigma){.n = n};
    if (!n)
        return;
    for (int k = 0; k < 3; k++)
        out->within[k] = (double)within[k] / (double)n;
    out->ratio_middle = (double)sort_select(ratio, n, n / 2);
    n = 0;
    for (size_t i = 0; i < j->w * j->h; i++)
        if (j->sigma[i] > 0 && isfinite(j->model[i] - j->truth[i]) &&
            (which == 2 || which == j->apart[i]))
            ratio[n++] = j->sigma[i];
    out->median_m = (double)sort_select(ratio, n, n / 2);
}

static enum err_code truth_heights_sigmas(const struct heights_job *j, struct truth_heights *out,
                                          struct err *e)
{
    if (!j->sigma)
        return ERR_OK;
    float *room = mem_array(j->w * j->h, sizeof *room);
    if (!room)
        return err_set(e, ERR_MEM, "%s: out of memory", j->q->map);
    for (int k = 0; k < 3; k++)
        truth_heights_sigma(j, k, room, &out->sigma[k]);
    mem_free(room);
    return ERR_OK;
}

static enum err_code truth_heights_score(struct heights_job *j, struct truth_heights *out,
                                         struct err *e)
{
    struct surface_rays rays = {0};
    struct lens lens = synth_flight_lens(&j->cfg);
    double fx, fy, cx, cy;
    lens_focal(&lens, &fx, &fy, &cx, &cy);
    out->gsd_m = synth_flight_height(&j->cfg) / fx;
    enum err_code rc = truth_heights_rays(j, out, &rays, e);
    const struct surface_pick level = {.level = true}, zone = {.edge = true}, all = {0};
    if (!rc)
        rc = surface_rays_tell(&rays, &level, out->gsd_m, &out->level, e);
    if (!rc)
        rc = surface_rays_tell(&rays, &zone, out->gsd_m, &out->zone, e);
    if (!rc)
        rc = surface_rays_tell(&rays, &all, out->gsd_m, &out->all, e);
    if (!rc)
        rc = truth_heights_sigmas(j, out, e);
    if (!rc && out->inside == out->none)
        rc = err_set(e, ERR_DATA, "%s: nothing of the city is in it", j->q->map);
    surface_rays_free(&rays);
    return rc;
}

/* Line y along x, or along y. */
static void truth_heights_line(const struct heights_job *j, bool down, size_t y, size_t fine,
                               float *truth)
{
    for (size_t i = 0; i < fine; i++) {
        double a = ((double)i + 0.5) / EDGE_FINE, b = (double)y + 0.5, at[2];
        bool covered, in = truth_heights_place(j, down ? b : a, down ? a : b, at);
        truth[i] = in ? truth_heights_at(j, down ? b : a, down ? a : b, &covered) : NAN;
    }
}

/* All lines; the truth of one is the `next` of the one before. */
static enum err_code truth_heights_edges(struct heights_job *j, bool down, struct err *e)
{
    size_t w = down ? j->h : j->w, h = down ? j->w : j->h, fine = w * EDGE_FINE;
    float *line = mem_array(w, sizeof *line), *truth = mem_array(2 * fine, sizeof *truth);
    enum err_code rc = ERR_OK;
    bool room = line && truth;
    for (size_t y = 0; room && !rc && y < h; y++) {
        float *here = truth + y % 2 * fine, *before = truth + (1 - y % 2) * fine;
        truth_heights_line(j, down, y, fine, here);
        for (size_t x = 0; y && x < w; x++)
            line[x] = j->model[down ? x * j->w + y - 1 : (y - 1) * j->w + x];
        if (y)
            rc = edge_line(&j->edges, line, before, here, w, j->pixel_m, e);
        if (!rc && signals_stopping())
            rc = err_set(e, ERR_CANCEL, "stopped");
    }
    mem_free(line);
    mem_free(truth);
    return room ? rc : err_set(e, ERR_MEM, "out of memory for a line of %zu px", w);
}

/* Errors of the heights as a map of the same pixels; it overwrites j->model. */
static enum err_code truth_heights_write(struct heights_job *j, const char *path, struct err *e)
{
    struct geotiff_info info = sheet_info(j->map);
    info.source = "procedural city";
    info.heights = "height of the model less that of the city";
    struct geotiff *t = NULL;
    for (size_t i = 0; i < j->w * j->h; i++) {
        float error_m = j->model[i] - j->truth[i];
        j->model[i] = isfinite(error_m) ? error_m : GEOTIFF_NODATA;
    }
    enum err_code rc = geotiff_create(path, GEOTIFF_HEIGHT, &info, &t, e);
    if (!rc)
        rc = geotiff_write(t, 0, 0, info.width, info.height, j->model, e);
    if (!rc)
        rc = geotiff_commit(&t, e);
    geotiff_close(&t);
    return rc;
}

enum err_code truth_heights(const struct truth_request *q, struct truth_heights *out, struct err *e)
{
    struct heights_job j = {0};
    struct arena arena = {0};
    *out = (struct truth_heights){0};
    j.q = q;
    enum err_code rc = truth_config(q->city, &j.cfg, &arena, e);
    if (!rc)
        rc = synth_city_make(&j.cfg, &j.city, e);
    j.origin = (struct geo_origin){j.cfg.lon_deg, j.cfg.lat_deg, j.cfg.ground_h_m};
    if (!rc)
        rc = sheet_open(q->map, GEOTIFF_HEIGHT, &j.map, e);
    if (!rc)
        rc = truth_heights_read(&j, e);
    if (!rc)
        rc = truth_heights_score(&j, out, e);
    for (int down = 0; !rc && !q->ground && down < 2; down++)
        rc = truth_heights_edges(&j, down, e);
    if (!rc && !q->ground)
        rc = edge_tell(&j.edges, &out->edge, e);
    if (!rc && q->output)
        rc = truth_heights_write(&j, q->output, e);
    out->pixel_m = j.pixel_m;
    out->edges = j.edges.n + j.edges.missing;
    out->missing = j.edges.missing;
    edge_free(&j.edges);
    sheet_close(&j.map);
    synth_city_free(&j.city);
    mem_free(j.model);
    mem_free(j.truth);
    mem_free(j.sigma);
    mem_free(j.apart);
    arena_free(&arena);
    return rc;
}
