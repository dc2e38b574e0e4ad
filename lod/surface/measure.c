/* Measuring the surface of a store: see measure.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/surface/measure.h"

#include <math.h>
#include <string.h>

#include "core/geo/outline.h"
#include "core/splat/camera.h"
#include "lod/surface/surface.h"

#define MEASURE_SIGMAS 3.0

enum {
    MEASURE_PIECE_PX = 512,
    MEASURE_PIECE_MIN_PX = 16,
    MEASURE_RIM_MAX = 400,
    MEASURE_REACH_PX = 64
};

enum err_code measure_plan(const struct nadir *n, const double (*lonlat)[2], size_t count,
                           struct geo_origin *frame, double (*at)[2], struct err *e)
{
    *frame =
        (struct geo_origin){lonlat[0][0], lonlat[0][1], store_info(nadir_store(n))->origin.h_m};
    for (size_t i = 0; i < count; i++) {
        double enu[3];
        enum err_code rc = geo_to_enu(frame, lonlat[i][0], lonlat[i][1], frame->h_m, enu, e);
        if (rc)
            return rc;
        if (!(hypot(hypot(enu[0], enu[1]), enu[2]) < MEASURE_REACH_M))
            return err_set(e, ERR_DATA, "place %zu is more than 100 km from the first", i + 1);
        memcpy(at[i], enu, sizeof at[i]);
    }
    return ERR_OK;
}

static enum err_code measure_unplan(const struct geo_origin *frame, const double at[2],
                                    double lonlat[2], struct err *e)
{
    const double enu[3] = {at[0], at[1], 0};
    double h;
    return geo_from_enu(frame, enu, &lonlat[0], &lonlat[1], &h, e);
}

/* ---- along a line ---- */

static enum err_code measure_samples(const struct geo_origin *frame, const double (*at)[2],
                                     size_t count, double step_m, struct measure_sample *out,
                                     size_t *n_out, double (*lonlat)[2], struct err *e)
{
    double before = 0;
    size_t n = 0;
    for (size_t i = 0; i + 1 < count; i++) {
        double length = hypot(at[i + 1][0] - at[i][0], at[i + 1][1] - at[i][1]);
        size_t parts = (size_t)fmax(ceil(length / step_m), 1);
        for (size_t k = 0; k < parts + (i + 2 == count); k++) {
            double t = (double)k / (double)parts;
            const double p[2] = {at[i][0] + t * (at[i + 1][0] - at[i][0]),
                                 at[i][1] + t * (at[i + 1][1] - at[i][1])};
            enum err_code rc = measure_unplan(frame, p, lonlat[n], e);
            if (rc)
                return rc;
            out[n] = (struct measure_sample){before + t * length, lonlat[n][0], lonlat[n][1], {0}};
            n++;
        }
        before += length;
    }
    *n_out = n;
    return ERR_OK;
}

enum err_code measure_profile(struct nadir *n, const double (*lonlat)[2], size_t count,
                              double step_m, double gsd_m, struct measure_sample **out,
                              size_t *n_out, double *length_m, struct err *e)
{
    struct geo_origin frame;
    double at[MEASURE_CORNERS_MAX][2], length = 0;
    *out = NULL;
    if (count < 2 || count > MEASURE_CORNERS_MAX)
        return err_set(e, ERR_DATA, "a line of %zu places: 2 to %d", count, MEASURE_CORNERS_MAX);
    enum err_code rc = measure_plan(n, lonlat, count, &frame, at, e);
    if (rc)
        return rc;
    for (size_t i = 0; i + 1 < count; i++)
        length += hypot(at[i + 1][0] - at[i][0], at[i + 1][1] - at[i][1]);
    double room = MEASURE_SAMPLES_MAX - MEASURE_CORNERS_MAX - 1, least = length / room,
           usual = nadir_area(n)->sigma_m, fine = step_m > 0 ? fmin(step_m, usual) : usual,
           pixel = gsd_m > 0 ? gsd_m : fmax(fine, usual / 4),
           step = step_m > 0 ? step_m : fmax(pixel, least);
    if (!(length > 0) || !(step >= least))
        return err_set(e, ERR_DATA,
                       length > 0 ? "a line of %.0f m in steps of %g m: at most %d samples, so "
                                    "steps of at least %.3g m"
                                  : "a line of %.0f m has no length",
                       length, step, MEASURE_SAMPLES_MAX, ceil(1000 * least) / 1000);
    struct measure_sample *samples = mem_array(MEASURE_SAMPLES_MAX, sizeof *samples);
    double(*places)[2] = mem_array(MEASURE_SAMPLES_MAX, sizeof *places);
    struct probe *probes = mem_array(MEASURE_SAMPLES_MAX, sizeof *probes);
    if (!samples || !places || !probes)
        rc = err_set(e, ERR_MEM, "out of memory for a profile");
    if (!rc)
        rc =
            measure_samples(&frame, (const double(*)[2])at, count, step, samples, n_out, places, e);
    if (!rc)
        rc = probe_many(n, (const double(*)[2])places, *n_out, pixel, probes, e);
    for (size_t i = 0; !rc && i < *n_out; i++)
        samples[i].probe = probes[i];
    mem_free(places);
    mem_free(probes);
    if (rc)
        mem_free(samples);
    *out = rc ? NULL : samples;
    *length_m = length;
    return rc;
}

/* Is the rise from one sample to the other more than noise? */
static bool measure_differs(const struct measure_sample *a, const struct measure_sample *b)
{
    return fabs(b->probe.height_m - a->probe.height_m) >
           MEASURE_SIGMAS * hypot(a->probe.noise_m, b->probe.noise_m);
}

void measure_climb(const struct measure_sample *s, size_t n, double *climb_m, double *fall_m)
{
    /* turn: the extreme where the last rise or fall that counts began; top, bottom: since then */
    const struct measure_sample *turn = NULL, *top = NULL, *bottom = NULL;
    int way = 0; /* 1 up, -1 down, 0 neither yet */
    *climb_m = *fall_m = 0;
    for (size_t i = 0; i < n; i++) {
        const struct measure_sample *at = &s[i];
        if (!isfinite(at->probe.height_m))
            continue;
        if (!turn)
            turn = top = bottom = at;
        top = at->probe.height_m > top->probe.height_m ? at : top;
        bottom = at->probe.height_m < bottom->probe.height_m ? at : bottom;
        if (way <= 0 && at->probe.height_m > bottom->probe.height_m &&
            measure_differs(bottom, at)) {
            *fall_m += way < 0 ? turn->probe.height_m - bottom->probe.height_m : 0;
            turn = bottom;
            top = at;
            way = 1;
        } else if (way >= 0 && at->probe.height_m < top->probe.height_m &&
                   measure_differs(top, at)) {
            *climb_m += way > 0 ? top->probe.height_m - turn->probe.height_m : 0;
            turn = top;
            bottom = at;
            way = -1;
        }
    }
    if (way > 0)
        *climb_m += top->probe.height_m - turn->probe.height_m;
    if (way < 0)
        *fall_m += turn->probe.height_m - bottom->probe.height_m;
}

/* ---- within a polygon ---- */

struct measure_plane { /* height = c[0] + c[1] x + c[2] y */
    double c[3];
    double error_m; /* of its mean; 0: it was given */
};

/* Least squares, by Gaussian elimination of the normal equations; a rim that does not span a plane
 * gets a level one. */
static struct measure_plane measure_fit(const double (*at)[2], const double *h, size_t n)
{
    double m[3][4] = {{0}}, mean = 0;
    for (size_t i = 0; i < n; i++) {
        const double row[3] = {1, at[i][0], at[i][1]};
        mean += h[i] / (double)n;
        for (size_t r = 0; r < 3; r++) {
            for (size_t c = 0; c < 3; c++)
                m[r][c] += row[r] * row[c];
            m[r][3] += row[r] * h[i];
        }
    }
    for (size_t r = 0; r < 3; r++) {
        if (!(fabs(m[r][r]) > 1e-6))
            return (struct measure_plane){.c = {mean, 0, 0}};
        for (size_t k = 0; k < 3; k++) {
            double f = k == r ? 0 : m[k][r] / m[r][r];
            for (size_t c = r; c < 4; c++)
                m[k][c] -= f * m[r][c];
        }
    }
    return (struct measure_plane){.c = {m[0][3] / m[0][0], m[1][3] / m[1][1], m[2][3] / m[2][2]}};
}

/* Standard error of the plane's mean. Heights along one side err alike, so a side counts once. */
static double measure_fit_error(const struct measure_plane *p, const double (*at)[2],
                                const double *h, size_t n, size_t sides)
{
    double sum = 0;
    for (size_t i = 0; i < n; i++) {
        double over = h[i] - (p->c[0] + p->c[1] * at[i][0] + p->c[2] * at[i][1]);
        sum += over * over;
    }
    return sqrt(sum / (double)n / (double)sides);
}

/* The plane through the surface along the rim. */
static enum err_code measure_rim(struct nadir *n, const struct geo_origin *frame,
                                 const double (*at)[2], size_t count, struct measure_plane *out,
                                 struct err *e)
{
    double places[MEASURE_RIM_MAX][2], lonlat[MEASURE_RIM_MAX][2], h[MEASURE_RIM_MAX];
    struct probe *probes = mem_array(MEASURE_RIM_MAX, sizeof *probes);
    double step = fmax(outline_length(at, count) / (MEASURE_RIM_MAX - MEASURE_CORNERS_MAX - 1),
                       nadir_area(n)->sigma_m);
    size_t k = 0, known = 0;
    enum err_code rc = probes ? ERR_OK : err_set(e, ERR_MEM, "out of memory for a rim");
    for (size_t i = 0; !rc && i < count; i++) {
        const double *p = at[i], *q = at[(i + 1) % count];
        size_t parts = (size_t)fmax(ceil(hypot(q[0] - p[0], q[1] - p[1]) / step), 1);
        for (size_t s = 0; !rc && s < parts; s++, k++) {
            double t = (double)s / (double)parts;
            places[k][0] = p[0] + t * (q[0] - p[0]);
            places[k][1] = p[1] + t * (q[1] - p[1]);
            rc = measure_unplan(frame, places[k], lonlat[k], e);
        }
    }
    if (!rc)
        rc = probe_many(n, (const double(*)[2])lonlat, k, 0, probes, e);
    for (size_t i = 0; !rc && i < k; i++)
        if (probes[i].found) {
            memcpy(places[known], places[i], sizeof *places);
            h[known++] = probes[i].height_m;
        }
    mem_free(probes);
    if (!rc && known < 3)
        return err_set(e, ERR_DATA,
                       "there is no surface along the rim of the polygon: give the "
                       "height of a level base");
    if (rc)
        return rc;
    *out = measure_fit((const double(*)[2])places, h, known);
    out->error_m = measure_fit_error(out, (const double(*)[2])places, h, known, count);
    return ERR_OK;
}

/* Pixels of a polygon where none were asked for: a fourth of the usual Gaussian, for the blur of a
 * pixel moves edges by about half of one; coarser where that makes more than so many. */
static const double measure_usual_px = 250000;
static double measure_fine(const double box[4], double sigma_m)
{
    double fits = sqrt((box[2] - box[0]) * (box[3] - box[1]) / measure_usual_px);
    return fmin(fmax(0.25 * sigma_m, fits), sigma_m);
}

/* A slope from which a surface is a face with edges. */
#define MEASURE_STEEP 1.0
/* Of the usual Gaussian's sigma: by which edges reach out at most. Half of the light is left at 1.1
 * sigma from a Gaussian of opacity 0.9, and those of an edge lie within it. */
#define MEASURE_BLUR 0.75

struct measure_job {
    struct nadir *nadir;
    struct geo_origin frame;
    const double (*at)[2];
    size_t count;
    struct measure_plane base;
    struct measure_area *out;
    double sum_m;
    double faces_m2; /* area of steep faces */
    size_t known;
    uint32_t reach; /* pixels over which slopes are taken: about as far as Gaussians are large */
    float *height;
    uint8_t *in; /* surveyed */
};

/* One pixel; steps to those `reach` to the right and below are slopes of the surface. */
static void measure_pixel(struct measure_job *j, double x, double y, double h, double right,
                          double down)
{
    struct measure_area *o = j->out;
    double px = o->pixel_m, over = h - (j->base.c[0] + j->base.c[1] * x + j->base.c[2] * y),
           far = j->reach * px, dx = isfinite(right) ? (right - h) / far : 0,
           dy = isfinite(down) ? (down - h) / far : 0;
    j->known++;
    j->sum_m += h;
    o->surface_m2 += px * px * sqrt(1 + dx * dx + dy * dy);
    double slope = hypot(dx, dy);
    if (slope > MEASURE_STEEP)
        j->faces_m2 += slope * px * px;
    *(over > 0 ? &o->above_m3 : &o->below_m3) += fabs(over) * px * px;
    o->lowest_m = fmin(o->lowest_m, h);
    o->highest_m = fmax(o->highest_m, h);
}

struct measure_grid { /* of pieces over a box, columns and rows */
    double pieces[2];
    uint32_t px[2]; /* of a piece */
};

static struct measure_grid measure_grid(const double box[4], double pixel_m)
{
    struct measure_grid g;
    for (size_t k = 0; k < 2; k++) {
        double wide = fmax(ceil((box[2 + k] - box[k]) / pixel_m), MEASURE_PIECE_MIN_PX);
        g.pieces[k] = ceil(wide / MEASURE_PIECE_PX);
        g.px[k] = (uint32_t)ceil(wide / g.pieces[k]);
    }
    return g;
}

/* Pixels that are drawn, a thin box's pieces being wider than it. */
static double measure_drawn(const double box[4], double pixel_m)
{
    struct measure_grid g = measure_grid(box, pixel_m);
    return g.pieces[0] * g.px[0] * g.pieces[1] * g.px[1];
}

static enum err_code measure_check(const double box[4], double pixel_m, struct err *e)
{
    /* A grid may be some pixels larger than its box. */
    double drawn = measure_drawn(box, pixel_m), most = MEASURE_PIXELS_MAX * 1.01, least = pixel_m;
    if (drawn <= most)
        return ERR_OK;
    while (measure_drawn(box, least) > MEASURE_PIXELS_MAX)
        least *= 1.01;
    return err_set(e, ERR_DATA,
                   "%.3g pixels of %g m: at most %.3g; from gsd_m %.3g on the polygon fits", drawn,
                   pixel_m, MEASURE_PIXELS_MAX, least * 1.01);
}

/* A piece whose top left corner lies at (west, north) of the plan. It is drawn larger, so that
 * every pixel has those that its slopes need. */
static enum err_code measure_piece(struct measure_job *j, double west, double north,
                                   const struct measure_grid *g, struct err *e)
{
    uint32_t reach = j->reach, w = g->px[0] + reach, h = g->px[1] + reach;
    double px = j->out->pixel_m, lonlat[2], corner[8];
    const double middle[2] = {west + 0.5 * w * px, north - 0.5 * h * px};
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < 4; i++) {
        const double at[2] = {west + (double)(i & 1) * w * px, north - (double)(i >> 1) * h * px};
        rc = measure_unplan(&j->frame, at, lonlat, e);
        key_place(lonlat[0], lonlat[1], corner + 2 * i);
    }
    if (!rc)
        rc = measure_unplan(&j->frame, middle, lonlat, e);
    if (rc || !area_mask(nadir_area(j->nadir), corner, w, h, j->in))
        return rc;
    const struct nadir_piece p = {.lon_deg = lonlat[0],
                                  .lat_deg = lonlat[1],
                                  .px_per_m_x = 1 / px,
                                  .px_per_m_y = 1 / px,
                                  .width = w,
                                  .height = h};
    rc = surface_draw(j->nadir, &p, &(struct surface_maps){.height_m = j->height}, e);
    for (uint32_t v = 0; !rc && v + reach < h; v++)
        for (uint32_t u = 0; u + reach < w; u++) {
            size_t i = (size_t)v * w + u;
            double x = west + (u + 0.5) * px, y = north - (v + 0.5) * px;
            if (j->in[i] && isfinite(j->height[i]) && outline_holds(j->at, j->count, x, y))
                measure_pixel(j, x, y, (double)j->height[i], (double)j->height[i + reach],
                              (double)j->height[i + (size_t)reach * w]);
        }
    return rc;
}

static enum err_code measure_pieces(struct measure_job *j, const double box[4],
                                    const struct measure_grid *g, struct err *e)
{
    double px = j->out->pixel_m;
    size_t room = (size_t)(g->px[0] + j->reach) * (g->px[1] + j->reach);
    enum err_code rc = ERR_OK;
    j->height = mem_array(room, sizeof *j->height);
    j->in = mem_array(room, 1);
    if (!j->height || !j->in)
        rc = err_set(e, ERR_MEM, "out of memory for a piece of %u x %u px", g->px[0], g->px[1]);
    for (size_t row = 0; !rc && row < (size_t)g->pieces[1]; row++)
        for (size_t column = 0; !rc && column < (size_t)g->pieces[0]; column++)
            rc = measure_piece(j, box[0] + (double)column * g->px[0] * px,
                               box[3] - (double)row * g->px[1] * px, g, e);
    mem_free(j->height);
    mem_free(j->in);
    return rc;
}

enum err_code measure_polygon(struct nadir *n, const double (*lonlat)[2], size_t count,
                              double base_m, double gsd_m, struct measure_area *out, struct err *e)
{
    double at[MEASURE_CORNERS_MAX][2], box[4] = {HUGE_VAL, HUGE_VAL, -HUGE_VAL, -HUGE_VAL};
    struct measure_job j = {.nadir = n, .count = count, .out = out};
    *out = (struct measure_area){.lowest_m = HUGE_VAL, .highest_m = -HUGE_VAL};
    if (count < 3 || count > MEASURE_CORNERS_MAX)
        return err_set(e, ERR_DATA, "a polygon of %zu corners: 3 to %d", count,
                       MEASURE_CORNERS_MAX);
    enum err_code rc = measure_plan(n, lonlat, count, &j.frame, at, e);
    j.at = (const double(*)[2])at;
    if (!rc)
        rc = outline_check(j.at, count, e);
    if (rc)
        return rc;
    double mid[2] = {0};
    for (size_t i = 0; i < count; i++)
        for (size_t k = 0; k < 2; k++) {
            box[k] = fmin(box[k], at[i][k]);
            box[2 + k] = fmax(box[2 + k], at[i][k]);
            mid[k] += at[i][k] / (double)count;
        }
    double sigma_m = nadir_area(n)->sigma_m;
    out->pixel_m = gsd_m > 0 ? gsd_m : measure_fine(box, sigma_m);
    j.reach = (uint32_t)fmin(fmax(floor(sigma_m / out->pixel_m + 0.5), 1), MEASURE_REACH_PX);
    rc = measure_check(box, out->pixel_m, e);
    if (rc)
        return rc;
    j.base.c[0] = base_m;
    if (!isfinite(base_m))
        rc = measure_rim(n, &j.frame, j.at, count, &j.base, e);
    if (!rc) {
        const struct measure_grid g = measure_grid(box, out->pixel_m);
        rc = measure_pieces(&j, box, &g, e);
    }
    out->area_m2 = outline_area(j.at, count);
    out->perimeter_m = outline_length(j.at, count);
    out->known_m2 = (double)j.known * out->pixel_m * out->pixel_m;
    out->base_m = j.base.c[0] + j.base.c[1] * mid[0] + j.base.c[2] * mid[1];
    out->mean_m = j.known ? j.sum_m / (double)j.known : (double)NAN;
    out->error_m3 = hypot(j.faces_m2 * (0.5 * out->pixel_m + MEASURE_BLUR * sigma_m),
                          out->known_m2 * j.base.error_m);
    if (!j.known)
        out->lowest_m = out->highest_m = (double)NAN;
    return rc;
}

/* ---- from eye to eye ---- */

enum err_code measure_sight(struct nadir *n, const double from[3], const double to[3],
                            struct measure_sight *out, struct err *e)
{
    const struct geo_origin *origin = &store_info(nadir_store(n))->origin;
    double a[3], b[3], at[3];
    *out = (struct measure_sight){.blocked_m = (double)NAN,
                                  .blocked = {(double)NAN, (double)NAN, (double)NAN}};
    enum err_code rc = geo_to_enu(origin, from[0], from[1], from[2], a, e);
    if (!rc)
        rc = geo_to_enu(origin, to[0], to[1], to[2], b, e);
    if (rc)
        return rc;
    double d = sqrt((b[0] - a[0]) * (b[0] - a[0]) + (b[1] - a[1]) * (b[1] - a[1]) +
                    (b[2] - a[2]) * (b[2] - a[2]));
    if (!(d >= 2) || !(d <= 5e4))
        return err_set(e, ERR_DATA, "the places are %.3g m apart: 2 to 50,000 m", d);
    /* At the far end a pixel is as large as the usual Gaussian. */
    struct camera cam = camera_look_at(a, b, 0.1, 64, 64);
    cam.fx_px = cam.fy_px = fmin(fmax(d / nadir_area(n)->sigma_m, 64), 1e5);
    struct nadir_ray ray;
    rc = nadir_look(n, &cam, cam.cx_px, cam.cy_px, d - MEASURE_CLEAR_M, &ray, e);
    if (rc)
        return rc;
    out->distance_m = d;
    out->light = fmin(fmax(1 - ray.front, 0), 1);
    out->visible = out->light >= 0.5;
    if (out->visible || !ray.found)
        return ERR_OK;
    out->blocked_m = ray.depth_m;
    for (size_t k = 0; k < 3; k++)
        at[k] = a[k] + (b[k] - a[k]) * ray.depth_m / d;
    return geo_from_enu(origin, at, &out->blocked[0], &out->blocked[1], &out->blocked[2], e);
}
