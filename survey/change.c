/* What changed between two stores: see change.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/change.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { CHANGE_BINS = 200001 /* of a centimetre, -1000 to 1000 m */ };
static const double bin_m = 0.01, shift_most_m = 2;

struct change_job {
    struct nadir *nadir[2]; /* earlier, later */
    const struct crs *crs;
    struct map_grid grid;
    struct geotiff *out;
    float *height[2], *rgb[2];
    uint8_t *in[2];
    uint64_t *histogram; /* [CHANGE_BINS] */
    double least_m, off_px, sum_m, color2, px_m2;
    double normal[3][4]; /* of the shift */
    struct change_report r;
};

static void change_count(struct change_job *j, double d)
{
    double bin = floor(d / bin_m + 0.5) + CHANGE_BINS / 2;
    j->histogram[(size_t)fmin(fmax(bin, 0), CHANGE_BINS - 1)]++;
    j->r.pixels++;
    j->sum_m += d;
    if (!(fabs(d) > j->least_m))
        return;
    j->r.changed_share += 1; /* a share once all are counted */
    *(d > 0 ? &j->r.gained_m3 : &j->r.lost_m3) += fabs(d) * j->px_m2;
}

/* d = up - slope_e east - slope_n north. */
static void change_shift(struct change_job *j, double d, double slope_e, double slope_n)
{
    const double row[3] = {-slope_e, -slope_n, 1};
    if (!isfinite(slope_e + slope_n) || !(fabs(d) < shift_most_m) || hypot(slope_e, slope_n) > 2)
        return;
    for (size_t r = 0; r < 3; r++) {
        for (size_t c = 0; c < 3; c++)
            j->normal[r][c] += row[r] * row[c];
        j->normal[r][3] += row[r] * d;
    }
}

static void change_pixels(struct change_job *j, const struct nadir_piece *p, float *out)
{
    size_t w = p->width;
    double dx = 2 / p->px_per_m_x, dy = 2 / p->px_per_m_y;
    j->px_m2 = 1 / (p->px_per_m_x * p->px_per_m_y);
    for (size_t y = 0; y < p->height; y++)
        for (size_t x = 0; x < w; x++) {
            size_t i = y * w + x;
            const float *a = j->height[0] + i;
            double d = (double)j->height[1][i] - (double)*a;
            out[i] = GEOTIFF_NODATA;
            if (!j->in[0][i] || !j->in[1][i] || !isfinite(d))
                continue;
            out[i] = (float)d;
            change_count(j, d);
            for (size_t k = 0; k < 3; k++) {
                double c = (double)j->rgb[1][3 * i + k] - (double)j->rgb[0][3 * i + k];
                j->color2 += c * c / 3;
            }
            if (x > 0 && y > 0 && x + 1 < w && y + 1 < p->height) /* right is east, nearly */
                change_shift(j, d, ((double)a[1] - (double)a[-1]) / dx,
                             ((double)*(a - w) - (double)a[w]) / dy);
        }
}

static enum err_code change_piece(struct change_job *j, uint32_t x, uint32_t y, struct err *e)
{
    const struct map_grid *g = &j->grid;
    struct nadir_piece p = {.width = g->width - x < MAP_PIECE_PX ? g->width - x : MAP_PIECE_PX,
                            .height = g->height - y < MAP_PIECE_PX ? g->height - y : MAP_PIECE_PX};
    double corner[8];
    enum err_code rc = map_place(j->nadir[0], j->crs, g, x, y, &p, corner, &j->off_px, e);
    for (size_t k = 0; !rc && k < 2; k++)
        if (!area_mask(nadir_area(j->nadir[k]), corner, p.width, p.height, j->in[k]))
            return ERR_OK;
    for (size_t k = 0; !rc && k < 2; k++)
        rc = nadir_draw(j->nadir[k], &p, j->rgb[k], j->height[k], e);
    if (rc)
        return rc;
    float *out = j->height[1]; /* in place: each pixel is read before it is written */
    change_pixels(j, &p, out);
    return geotiff_write(j->out, x, y, p.width, p.height, out, e);
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

static void change_solve(struct change_job *j)
{
    double(*m)[4] = j->normal;
    for (size_t r = 0; r < 3; r++) {
        if (!(fabs(m[r][r]) > 1e-9)) { /* level ground: the plan is not known */
            m[r][r] = 1;
            m[r][3] = 0;
        }
        for (size_t k = 0; k < 3; k++) {
            double f = k == r ? 0 : m[k][r] / m[r][r];
            for (size_t c = r; c < 4; c++)
                m[k][c] -= f * m[r][c];
        }
    }
    j->r.east_m = m[0][3] / m[0][0];
    j->r.north_m = m[1][3] / m[1][1];
    j->r.up_m = m[2][3] / m[2][2];
}

static enum err_code change_room(struct change_job *j, struct err *e)
{
    size_t n = (size_t)MAP_PIECE_PX * MAP_PIECE_PX;
    bool ok = (j->histogram = mem_array(CHANGE_BINS, sizeof *j->histogram)) != NULL;
    for (size_t k = 0; k < 2; k++) {
        j->height[k] = mem_array(n, sizeof *j->height[k]);
        j->rgb[k] = mem_array(n, 3 * sizeof *j->rgb[k]);
        j->in[k] = mem_array(n, 1);
        ok = ok && j->height[k] && j->rgb[k] && j->in[k];
    }
    return ok ? ERR_OK : err_set(e, ERR_MEM, "out of memory for a piece of %d px", MAP_PIECE_PX);
}

static enum err_code change_draw(struct change_job *j, struct err *e)
{
    struct progress bar;
    uint64_t done = 0, rows = (j->grid.height + MAP_PIECE_PX - 1) / MAP_PIECE_PX;
    enum err_code rc = change_room(j, e);
    progress_start(&bar, "compare, rows", rows);
    for (uint32_t y = 0; !rc && y < j->grid.height; y += MAP_PIECE_PX) {
        for (uint32_t x = 0; !rc && x < j->grid.width; x += MAP_PIECE_PX) {
            rc = change_piece(j, x, y, e);
            if (!rc && signals_stopping())
                rc = err_set(e, ERR_CANCEL, "stopped");
        }
        progress_step(&bar, ++done, NULL);
    }
    progress_end(&bar, NULL);
    if (!rc && !j->r.pixels)
        rc = err_set(e, ERR_ARG, "the two were not surveyed in one place: nothing to compare");
    return rc;
}

static void change_tell(struct change_job *j)
{
    double n = (double)j->r.pixels;
    j->r.grid = j->grid;
    j->r.pixel_m2 = j->px_m2;
    j->r.mean_m = j->sum_m / n;
    j->r.median_m = change_quantile(j->histogram, j->r.pixels, 0.5);
    j->r.spread_m = change_spread(j);
    j->r.changed_share /= n;
    j->r.color = sqrt(j->color2 / n);
    change_solve(j);
}

enum err_code change_write(struct nadir *earlier, struct nadir *later,
                           const struct change_request *r, const char *path,
                           struct change_report *report, struct err *e)
{
    const struct area *a = nadir_area(earlier), *b = nadir_area(later);
    const double both[4] = {fmax(a->west_deg, b->west_deg), fmax(a->south_deg, b->south_deg),
                            fmin(a->east_deg, b->east_deg), fmin(a->north_deg, b->north_deg)};
    double box[4];
    char source[200];
    const struct store_meta *ma = store_info(nadir_store(earlier)),
                            *mb = store_info(nadir_store(later));
    struct change_job j = {.nadir = {earlier, later},
                           .least_m = r->least_m > 0 ? r->least_m : CHANGE_LEAST_M};
    struct crs *crs = NULL;
    for (size_t k = 0; k < 4; k++)
        box[k] = !r->bbox_deg ? both[k]
                 : k < 2      ? fmax(both[k], r->bbox_deg[k])
                              : fmin(both[k], r->bbox_deg[k]);
    if (!(box[0] < box[2]) || !(box[1] < box[3]))
        return err_set(e, ERR_ARG, "the two were not surveyed in one place: nothing to compare");
    /* Pixels of the coarser of the two. */
    const struct map_request m = {
        .kind = GEOTIFF_HEIGHT, .epsg = r->epsg, .gsd_m = r->gsd_m, .bbox_deg = box};
    enum err_code rc = map_plan(a->sigma_m > b->sigma_m ? earlier : later, &m, &crs, &j.grid, e);
    if (rc)
        return rc;
    j.crs = crs;
    snprintf(source, sizeof source, "%s %s minus %s %s", mb->name, mb->revision, ma->name,
             ma->revision);
    const struct geotiff_info info = {crs,          j.grid.west_m, j.grid.north_m,  j.grid.pixel_m,
                                      j.grid.width, j.grid.height, mb->attribution, source};
    rc = geotiff_create(path, GEOTIFF_HEIGHT, &info, &j.out, e);
    if (!rc)
        rc = change_draw(&j, e);
    if (!rc)
        rc = geotiff_commit(&j.out, e);
    if (!rc) {
        change_tell(&j);
        *report = j.r;
    }
    geotiff_close(&j.out);
    crs_close(&crs);
    mem_free(j.histogram);
    for (size_t k = 0; k < 2; k++) {
        mem_free(j.height[k]);
        mem_free(j.rgb[k]);
        mem_free(j.in[k]);
    }
    return rc;
}
