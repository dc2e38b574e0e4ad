/* Changes between two stores: see change.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/change.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "survey/changed.h"

enum { CHANGE_BINS = 200001 /* of a centimetre, -1000 to 1000 m */ };
/* Of alignment: it has converged within 0.02 px and 2 mm; each round explains about two thirds of
 * what is left, for edges are steeper than the limit of slopes. Rounds draw at most so many pieces,
 * spread over the map. */
enum { CHANGE_ROUNDS_MAX = 12, CHANGE_ROUND_PIECES = 256, CHANGE_UNKNOWNS = 5 };
static const double bin_m = 0.01, shift_most_m = 2, settled_px = 0.02, settled_m = 0.002,
                    tilt_unit_m = 100;

struct change_job {
    struct nadir *nadir[2]; /* earlier, later */
    const struct crs *crs;
    struct map_grid grid;
    struct geotiff *out;     /* NULL: a round, nothing is written */
    struct change_pose pose; /* the later is drawn as if it did not lie so */
    uint64_t stride;         /* every which piece is drawn */
    struct surface_maps maps[2];
    float *room[2];
    float *pair; /* difference and its standard deviation */
    uint8_t *in[2];
    struct changed *changed;
    uint64_t *histogram; /* [CHANGE_BINS] */
    double least_m, off_px, sum_m, color2, px_m2;
    double normal[CHANGE_UNKNOWNS][CHANGE_UNKNOWNS + 1]; /* of the pose */
    struct change_report r;
};

static void change_count(struct change_job *j, double d)
{
    double bin = floor(d / bin_m + 0.5) + CHANGE_BINS / 2;
    j->histogram[(size_t)fmin(fmax(bin, 0), CHANGE_BINS - 1)]++;
    j->r.pixels++;
    j->sum_m += d;
    j->r.differs_share += fabs(d) > j->least_m; /* a share once all are counted */
}

/* d = up - slope_e east - slope_n north + tilt_e x + tilt_n y; x, y from the middle of the map. */
static void change_shift(struct change_job *j, double d, double slope_e, double slope_n, double x,
                         double y)
{
    const double row[CHANGE_UNKNOWNS] = {1, x / tilt_unit_m, y / tilt_unit_m, -slope_e, -slope_n};
    if (!isfinite(slope_e + slope_n) || !(fabs(d) < shift_most_m) || hypot(slope_e, slope_n) > 2)
        return;
    for (size_t r = 0; r < CHANGE_UNKNOWNS; r++) {
        for (size_t c = 0; c < CHANGE_UNKNOWNS; c++)
            j->normal[r][c] += row[r] * row[c];
        j->normal[r][CHANGE_UNKNOWNS] += row[r] * d;
    }
}

/* Metres of the projection from the middle of the map to that of pixel (u, v) of a piece. */
static void change_middle(const struct map_grid *g, double u, double v, double at[2])
{
    at[0] = (u + 0.5 - 0.5 * g->width) * g->pixel_m;
    at[1] = (0.5 * g->height - v - 0.5) * g->pixel_m;
}

static void change_pixels(struct change_job *j, const struct nadir_piece *p, uint32_t left,
                          uint32_t top)
{
    size_t w = p->width;
    double dx = 2 / p->px_per_m_x, dy = 2 / p->px_per_m_y;
    j->px_m2 = 1 / (p->px_per_m_x * p->px_per_m_y);
    for (size_t y = 0; y < p->height; y++)
        for (size_t x = 0; x < w; x++) {
            size_t i = y * w + x;
            const float *a = j->maps[0].height_m + i;
            double at[2], d = (double)j->maps[1].height_m[i] - (double)*a;
            float *noise = j->maps[1].noise_m + i; /* in place, as what only this pixel reads */
            j->pair[2 * i] = j->pair[2 * i + 1] = GEOTIFF_NODATA;
            if (!j->in[0][i] || !j->in[1][i] || !isfinite(d))
                continue;
            change_middle(&j->grid, (double)(left + x), (double)(top + y), at);
            d -= j->pose.up_m + j->pose.tilt_east * at[0] + j->pose.tilt_north * at[1];
            j->pair[2 * i] = (float)d;
            j->pair[2 * i + 1] = hypotf(j->maps[0].repeat_m[i], j->maps[1].repeat_m[i]);
            *noise = hypotf(j->maps[0].noise_m[i], *noise);
            change_count(j, d);
            for (size_t k = 0; k < 3; k++) {
                double c = (double)j->maps[1].rgb[3 * i + k] - (double)j->maps[0].rgb[3 * i + k];
                j->color2 += c * c / 3;
            }
            if (x > 0 && y > 0 && x + 1 < w && y + 1 < p->height) /* right is east, nearly */
                change_shift(j, d, ((double)a[1] - (double)a[-1]) / dx,
                             ((double)*(a - w) - (double)a[w]) / dy, at[0], at[1]);
        }
}

/* The same piece of the later, which lies east_m and north_m away. */
static enum err_code change_move(const struct change_job *j, struct nadir_piece *p,
                                 double corner[8], struct err *e)
{
    const struct geo_origin here = {p->lon_deg, p->lat_deg, 0};
    const double by[3] = {j->pose.east_m, j->pose.north_m, 0};
    double from[2], to[2], h_m;
    key_place(p->lon_deg, p->lat_deg, from);
    enum err_code rc = geo_from_enu(&here, by, &p->lon_deg, &p->lat_deg, &h_m, e);
    if (rc)
        return rc;
    key_place(p->lon_deg, p->lat_deg, to);
    for (size_t i = 0; i < 8; i++)
        corner[i] += to[i % 2] - from[i % 2];
    return ERR_OK;
}

static enum err_code change_piece(struct change_job *j, uint32_t x, uint32_t y, struct err *e)
{
    const struct map_grid *g = &j->grid;
    struct nadir_piece p = {.width = g->width - x < MAP_PIECE_PX ? g->width - x : MAP_PIECE_PX,
                            .height = g->height - y < MAP_PIECE_PX ? g->height - y : MAP_PIECE_PX},
                       moved;
    double corner[8];
    enum err_code rc = map_place(j->nadir[0], j->crs, g, x, y, &p, corner, &j->off_px, e);
    if (rc || !area_mask(nadir_area(j->nadir[0]), corner, p.width, p.height, j->in[0]))
        return rc;
    moved = p;
    rc = change_move(j, &moved, corner, e);
    if (rc || !area_mask(nadir_area(j->nadir[1]), corner, p.width, p.height, j->in[1]))
        return rc;
    rc = surface_draw(j->nadir[0], &p, &j->maps[0], e);
    if (!rc)
        rc = surface_draw(j->nadir[1], &moved, &j->maps[1], e);
    if (rc)
        return rc;
    change_pixels(j, &p, x, y);
    if (!j->out)
        return ERR_OK;
    rc = geotiff_write(j->out, x, y, p.width, p.height, j->pair, e);
    return rc ? rc
              : changed_add(j->changed, x, y, p.width, p.height, j->pair, j->maps[1].noise_m, e);
}

/* The centimetre below which a share of all differences lies. */
static double change_quantile(const uint64_t *histogram, uint64_t n, double share)
{
    uint64_t sum = 0;
    size_t i = 0;
    while (i + 1 < CHANGE_BINS && (double)(sum += histogram[i]) < share * (double)n)
        i++;
    return ((double)i - CHANGE_BINS / 2) * bin_m;
}

static double change_spread(const struct change_job *j)
{
    uint64_t sum = 0;
    long mid = lround(j->r.median_m / bin_m) + CHANGE_BINS / 2;
    for (long k = 0; k < CHANGE_BINS; k++) {
        sum += mid + k < CHANGE_BINS ? j->histogram[mid + k] : 0;
        sum += k && mid - k >= 0 ? j->histogram[mid - k] : 0;
        if (2 * sum >= j->r.pixels)
            return 1.4826 * (double)k * bin_m;
    }
    return 0;
}

static struct change_pose change_solve(struct change_job *j)
{
    enum { N = CHANGE_UNKNOWNS };
    double(*m)[N + 1] = j->normal, got[N], whole[N];
    if (fabs(j->r.median_m) > 0.5 * shift_most_m)
        return (struct change_pose){(double)NAN, (double)NAN, j->r.median_m, (double)NAN,
                                    (double)NAN};
    for (size_t r = 0; r < N; r++)
        whole[r] = m[r][r];
    for (size_t r = 0; r < N; r++) {
        /* Nothing left of a row: level ground does not tell the plan, one column no tilt. */
        bool known = m[r][r] > 1e-9 * whole[r] && m[r][r] > 1e-9;
        for (size_t c = 0; !known && c <= N; c++)
            m[r][c] = c == r;
        for (size_t k = 0; k < N; k++) {
            double f = k == r ? 0 : m[k][r] / m[r][r];
            for (size_t c = r; c <= N; c++)
                m[k][c] -= f * m[r][c];
        }
    }
    for (size_t r = 0; r < N; r++)
        got[r] = m[r][N] / m[r][r];
    return (struct change_pose){got[3], got[4], got[0], got[1] / tilt_unit_m, got[2] / tilt_unit_m};
}

static enum err_code change_room(struct change_job *j, struct err *e)
{
    size_t n = (size_t)MAP_PIECE_PX * MAP_PIECE_PX;
    bool ok = (j->histogram = mem_array(CHANGE_BINS, sizeof *j->histogram)) != NULL;
    ok = (j->pair = mem_array(n, 2 * sizeof *j->pair)) && ok;
    for (size_t k = 0; k < 2; k++) {
        float *at = j->room[k] = mem_array(n, 6 * sizeof *at);
        j->in[k] = mem_array(n, 1);
        ok = ok && at && j->in[k];
        if (at)
            j->maps[k] = (struct surface_maps){
                .rgb = at, .height_m = at + 3 * n, .repeat_m = at + 4 * n, .noise_m = at + 5 * n};
    }
    return ok ? ERR_OK : err_set(e, ERR_MEM, "out of memory for a piece of %d px", MAP_PIECE_PX);
}

static void change_forget(struct change_job *j)
{
    j->r = (struct change_report){0};
    j->sum_m = j->color2 = 0;
    memset(j->normal, 0, sizeof j->normal);
    memset(j->histogram, 0, CHANGE_BINS * sizeof *j->histogram);
}

/* Draw both, from the start. */
static enum err_code change_draw(struct change_job *j, const char *what, struct err *e)
{
    struct progress bar;
    uint64_t done = 0, k = 0, rows = (j->grid.height + MAP_PIECE_PX - 1) / MAP_PIECE_PX;
    uint64_t stride = j->stride > 1 ? j->stride : 1;
    enum err_code rc = ERR_OK;
    change_forget(j);
    progress_start(&bar, what, rows);
    for (uint32_t y = 0; !rc && y < j->grid.height; y += MAP_PIECE_PX) {
        for (uint32_t x = 0; !rc && x < j->grid.width; x += MAP_PIECE_PX) {
            rc = k++ % stride ? ERR_OK : change_piece(j, x, y, e);
            if (!rc && signals_stopping())
                rc = err_set(e, ERR_CANCEL, "stopped");
        }
        progress_step(&bar, ++done, NULL);
    }
    progress_end(&bar, NULL);
    if (rc || !j->r.pixels)
        return rc;
    double n = (double)j->r.pixels;
    j->r.grid = j->grid;
    j->r.pixel_m2 = j->px_m2;
    j->r.mean_m = j->sum_m / n;
    j->r.median_m = change_quantile(j->histogram, j->r.pixels, 0.5);
    j->r.spread_m = change_spread(j);
    j->r.differs_share /= n;
    j->r.color = sqrt(j->color2 / n);
    j->r.pose = change_solve(j);
    return ERR_OK;
}

/* Add what a round found. Returns whether that was next to nothing. */
static bool change_step(struct change_job *j)
{
    const struct change_pose *by = &j->r.pose;
    struct change_pose *p = &j->pose;
    p->up_m += by->up_m;
    if (!isfinite(by->east_m))
        return false;
    p->east_m += by->east_m;
    p->north_m += by->north_m;
    p->tilt_east += by->tilt_east;
    p->tilt_north += by->tilt_north;
    double half_m = 0.5 * fmax(j->grid.width, j->grid.height) * j->grid.pixel_m;
    return hypot(by->east_m, by->north_m) < settled_px * j->grid.pixel_m &&
           fabs(by->up_m) + half_m * hypot(by->tilt_east, by->tilt_north) < settled_m;
}

static enum err_code change_align(struct change_job *j, uint32_t *rounds, struct err *e)
{
    uint64_t pieces = (uint64_t)((j->grid.width + MAP_PIECE_PX - 1) / MAP_PIECE_PX) *
                      ((j->grid.height + MAP_PIECE_PX - 1) / MAP_PIECE_PX);
    enum err_code rc = ERR_OK;
    bool settled = false;
    j->stride = (pieces - 1) / CHANGE_ROUND_PIECES + 1;
    /* Neighbours in a row and in a column alike. */
    while (j->stride > 1 && ((j->grid.width + MAP_PIECE_PX - 1) / MAP_PIECE_PX) % j->stride == 0)
        j->stride++;
    for (*rounds = 0; !rc && !settled && *rounds < CHANGE_ROUNDS_MAX; ++*rounds) {
        rc = change_draw(j, "align, rows", e);
        settled = !rc && (!j->r.pixels || change_step(j));
    }
    j->stride = 1;
    if (!rc && hypot(j->pose.east_m, j->pose.north_m) > 100 * j->grid.pixel_m)
        rc =
            err_set(e, ERR_DATA,
                    "the later cannot be brought onto the earlier: after %u rounds it is %.1f m "
                    "east, %.1f m north and %.1f m up; compare them without --align, or place them "
                    "with ground control",
                    *rounds, j->pose.east_m, j->pose.north_m, j->pose.up_m);
    return rc;
}

/* What both have surveyed of what was asked for, degrees. */
static bool change_box(const struct area *a, const struct area *b, const double *asked,
                       double box[4])
{
    box[0] = fmax(a->west_deg, b->west_deg);
    box[1] = fmax(a->south_deg, b->south_deg);
    box[2] = fmin(a->east_deg, b->east_deg);
    box[3] = fmin(a->north_deg, b->north_deg);
    for (size_t k = 0; asked && k < 4; k++)
        box[k] = k < 2 ? fmax(box[k], asked[k]) : fmin(box[k], asked[k]);
    return box[0] < box[2] && box[1] < box[3];
}

static enum err_code change_create(struct change_job *j, const char *path,
                                   const struct change_request *r, struct err *e)
{
    const struct store_meta *a = store_info(nadir_store(j->nadir[0])),
                            *b = store_info(nadir_store(j->nadir[1]));
    char source[200];
    snprintf(source, sizeof source, "%s %s minus %s %s", b->name, b->revision, a->name,
             a->revision);
    const struct geotiff_info info = {
        .crs = j->crs,
        .west_m = j->grid.west_m,
        .north_m = j->grid.north_m,
        .pixel_m = j->grid.pixel_m,
        .width = j->grid.width,
        .height = j->grid.height,
        .copyright = b->attribution,
        .source = source,
        .heights = r->align
                       ? "height of the later, moved onto the earlier, minus that of the earlier"
                       : "height of the later minus that of the earlier",
        .rows = true};
    double sigma_m = fmax(nadir_area(j->nadir[0])->sigma_m, nadir_area(j->nadir[1])->sigma_m);
    const struct changed_request request = {.path = path,
                                            .polygons = r->polygons,
                                            .about = source,
                                            .least_m = j->least_m,
                                            .sigma_m = sigma_m,
                                            .least_m2 = CHANGE_LEAST_SIGMA2 * sigma_m * sigma_m};
    enum err_code rc = changed_begin(&request, &info, &j->changed, e);
    return rc ? rc : geotiff_create(path, GEOTIFF_SURFACE, &info, &j->out, e);
}

static void change_close(struct change_job *j)
{
    changed_close(&j->changed);
    geotiff_close(&j->out);
    mem_free(j->histogram);
    mem_free(j->pair);
    for (size_t k = 0; k < 2; k++) {
        mem_free(j->room[k]);
        mem_free(j->in[k]);
    }
}

enum err_code change_write(struct nadir *earlier, struct nadir *later,
                           const struct change_request *r, const char *path,
                           struct change_report *report, struct err *e)
{
    const struct area *a = nadir_area(earlier), *b = nadir_area(later);
    double box[4];
    struct change_job j = {.nadir = {earlier, later},
                           .stride = 1,
                           .least_m = r->least_m > 0 ? r->least_m : CHANGE_LEAST_M};
    uint32_t rounds = 0;
    struct crs *crs = NULL;
    const char *from[2] = {store_info(nadir_store(earlier))->heights,
                           store_info(nadir_store(later))->heights};
    if (!heights_same(from[0], from[1]) && !r->align) {
        char words[2][HEIGHTS_WORDS_MAX];
        heights_words(from[0], words[0]);
        heights_words(from[1], words[1]);
        return err_set(e, ERR_DATA,
                       "the earlier heights count from %s, the later ones from %s: "
                       "their difference is no change. Make both with the same --geoid or "
                       "--heights of `ingest`, or give --align, which takes a constant shift away",
                       words[0], words[1]);
    }
    if (!change_box(a, b, r->bbox_deg, box))
        return err_set(e, ERR_ARG, "the two were not surveyed in one place: nothing to compare");
    /* Pixels of the coarser of the two. */
    const struct map_request m = {.kind = GEOTIFF_HEIGHT,
                                  .epsg = r->epsg,
                                  .gsd_m = r->gsd_m,
                                  .bbox_deg = box,
                                  .coarse = true};
    enum err_code rc = map_plan(a->sigma_m > b->sigma_m ? earlier : later, &m, &crs, &j.grid, e);
    j.crs = crs;
    if (!rc)
        rc = change_room(&j, e);
    if (!rc && r->align)
        rc = change_align(&j, &rounds, e);
    if (!rc)
        rc = change_create(&j, path, r, e);
    if (!rc)
        rc = change_draw(&j, "compare, rows", e);
    if (!rc && !j.r.pixels)
        rc = err_set(e, ERR_ARG, "the two were not surveyed in one place: nothing to compare");
    if (!rc)
        rc = changed_tell(j.changed, j.out, j.px_m2, &j.r.changed, e);
    if (!rc)
        rc = geotiff_commit(&j.out, e);
    if (!rc) {
        *report = j.r;
        report->aligned = r->align;
        report->rounds = rounds;
        report->left = j.r.pose;
        if (r->align)
            report->pose = j.pose;
    }
    change_close(&j);
    crs_close(&crs);
    return rc;
}
