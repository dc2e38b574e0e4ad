/* Which differences are changes: see changed.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/changed.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/base.h"
#include "core/math/sort.h"
#include "survey/gdal_library.h"
#include "survey/layer.h"
#include "survey/region.h"

enum {
    CHANGED_LAGS = 64,    /* px, over which errors may be alike */
    CHANGED_ROWS = 4,     /* every which row is asked about that */
    CHANGED_SAMPLES = 12, /* along a cell, of the uncertainty around */
    CHANGED_FIELDS = 6,
};
/* Cells of so many sizes of the usual Gaussian; 2 x 2 of them are a neighbourhood. */
static const double changed_cell = 15;
static const double changed_alike = 0.05; /* correlation that is none */
static const double changed_95 = 1.96;    /* standard deviations */
static const double changed_pi = 3.14159265358979323846;

struct changed {
    struct changed_request request;
    struct geotiff_info info;
    char path[FILE_PATH_MAX]; /* of what is only for us */
    /* Standard deviation of each pixel as if it were level, and region of each. */
    struct geotiff *noise, *which;
    /* Corners of cells, [tall + 1][wide + 1]: CHANGED_AROUND times the median around. */
    float *around;
    uint32_t cell_px, wide, tall;
    int8_t *kind;  /* of a row */
    float *row[4]; /* difference, standard deviation, level noise, what edges add */
    struct region_map regions;
    /* Of stable ground: pairs so many pixels apart and their products; 0 apart: squares. Sum. */
    double n[CHANGED_LAGS], product[CHANGED_LAGS], sum;
    double patch, pixel_m2; /* pixels whose errors are alike; area of one */
};

static enum err_code changed_work(struct changed *c, const char *name, enum geotiff_kind kind,
                                  struct geotiff **out, struct err *e)
{
    struct geotiff_info info = c->info;
    info.rows = true;
    if (snprintf(c->path, sizeof c->path, "%s.%s", c->request.path, name) >= (int)sizeof c->path)
        return err_set(e, ERR_LIMIT, "%.60s...: the path is too long", c->request.path);
    return geotiff_create(c->path, kind, &info, out, e);
}

enum err_code changed_begin(const struct changed_request *r, const struct geotiff_info *info,
                            struct changed **out, struct err *e)
{
    *out = NULL;
    enum err_code rc = r->polygons ? layer_check(r->polygons, e) : ERR_OK;
    struct changed *c = rc ? NULL : mem_array(1, sizeof *c);
    if (rc)
        return rc;
    if (!c)
        return err_set(e, ERR_MEM, "%s: out of memory", r->path);
    c->request = *r;
    c->info = *info;
    c->kind = mem_array(info->width, sizeof *c->kind);
    bool ok = c->kind != NULL;
    for (size_t k = 0; k < 4; k++)
        ok = (c->row[k] = mem_array(info->width, sizeof *c->row[k])) && ok;
    rc = ok ? changed_work(c, "noise", GEOTIFF_HEIGHT, &c->noise, e)
            : err_set(e, ERR_MEM, "out of memory for a row of %u px", info->width);
    if (rc)
        changed_close(&c);
    *out = c;
    return rc;
}

void changed_close(struct changed **cp)
{
    struct changed *c = *cp;
    if (!c)
        return;
    geotiff_close(&c->noise);
    geotiff_close(&c->which);
    region_free(&c->regions);
    mem_free(c->kind);
    mem_free(c->around);
    for (size_t k = 0; k < 4; k++)
        mem_free(c->row[k]);
    mem_free(c);
    *cp = NULL;
}

/* ---- pixels ---- */

/* A row of stable ground, NAN where it is none: how alike are errors some pixels apart? */
static void changed_alike_row(struct changed *c, const float *d, size_t w)
{
    for (size_t x = 0; x < w; x++)
        for (size_t k = 0; isfinite(d[x]) && k < CHANGED_LAGS && x + k < w; k++)
            if (isfinite(d[x + k])) {
                c->n[k]++;
                c->product[k] += (double)d[x] * (double)d[x + k];
                c->sum += k ? 0 : (double)d[x];
            }
}

enum err_code changed_add(struct changed *c, uint32_t x, uint32_t y, uint32_t w, uint32_t h,
                          const float *pair, const float *noise_m, struct err *e)
{
    for (size_t v = 0; v < h; v += CHANGED_ROWS) {
        for (size_t u = 0; u < w; u++) {
            const float *p = pair + 2 * (v * w + u);
            bool stable = p[1] > 0 && p[1] < 2 * noise_m[v * w + u] && /* no edge */
                          fabsf(p[0]) < (float)CHANGED_SIGMAS * p[1];
            c->row[0][u] = stable ? p[0] : NAN;
        }
        changed_alike_row(c, c->row[0], w);
    }
    return geotiff_write(c->noise, x, y, w, h, noise_m, e);
}

/* Pixels of a patch whose errors are alike: the integral of the correlation over the plane. */
static double changed_patch(const struct changed *c)
{
    double mean = c->sum / c->n[0], variance = c->product[0] / c->n[0] - mean * mean, patch = 1;
    if (!(c->n[0] > CHANGED_LAGS) || !(variance > 0))
        return (double)NAN;
    for (size_t k = 1; k < CHANGED_LAGS && c->n[k] > 0; k++) {
        double alike = (c->product[k] / c->n[k] - mean * mean) / variance;
        if (!(alike > changed_alike))
            break;
        patch += 2 * changed_pi * (double)k * alike;
    }
    return patch;
}

/* ---- the uncertainty around ---- */

/* Samples of two rows of cells, the one before and this one. */
struct changed_cells {
    double *sample[2];  /* [wide][CHANGED_SAMPLES^2] */
    uint32_t *count[2]; /* [wide] */
    double *pool;       /* of four cells */
};

enum { CHANGED_CELL = CHANGED_SAMPLES * CHANGED_SAMPLES };

static enum err_code changed_cells_room(struct changed *c, struct changed_cells *s, struct err *e)
{
    c->cell_px = (uint32_t)fmax(ceil(changed_cell * c->request.sigma_m / c->info.pixel_m), 1);
    c->wide = (c->info.width - 1) / c->cell_px + 1;
    c->tall = (c->info.height - 1) / c->cell_px + 1;
    c->around = mem_array((size_t)c->wide + 1, ((size_t)c->tall + 1) * sizeof *c->around);
    s->pool = mem_array(4 * (size_t)CHANGED_CELL, sizeof *s->pool);
    bool ok = c->around && s->pool;
    for (size_t k = 0; k < 2; k++) {
        s->sample[k] = mem_array(c->wide, CHANGED_CELL * sizeof *s->sample[k]);
        s->count[k] = mem_array(c->wide, sizeof *s->count[k]);
        ok = ok && s->sample[k] && s->count[k];
    }
    return ok ? ERR_OK : err_set(e, ERR_MEM, "out of memory for %u x %u cells", c->wide, c->tall);
}

/* A row of corners, between the cells before and these; then these are those before. */
static void changed_corners(const struct changed *c, struct changed_cells *s, float *out)
{
    for (size_t x = 0; x <= c->wide; x++) {
        size_t n = 0;
        for (size_t k = 0; k < 4; k++) {
            size_t row = k / 2, at = x - 1 + k % 2;
            if (at >= c->wide) /* also where x is 0 */
                continue;
            memcpy(s->pool + n, s->sample[row] + at * CHANGED_CELL,
                   s->count[row][at] * sizeof *s->pool);
            n += s->count[row][at];
        }
        out[x] = (float)(CHANGED_AROUND * sort_median(s->pool, n));
    }
    double *sample = s->sample[0];
    uint32_t *count = s->count[0];
    s->sample[0] = s->sample[1];
    s->count[0] = s->count[1];
    s->sample[1] = sample;
    s->count[1] = count;
    memset(count, 0, c->wide * sizeof *count);
}

static enum err_code changed_look_around(struct changed *c, struct geotiff *map, struct err *e)
{
    struct changed_cells s = {0};
    enum err_code rc = changed_cells_room(c, &s, e);
    uint32_t step = (c->cell_px - 1) / CHANGED_SAMPLES + 1;
    for (uint32_t y = 0; !rc && y < c->info.height; y++) {
        if (y && y % c->cell_px == 0)
            changed_corners(c, &s, c->around + (size_t)(y / c->cell_px - 1) * (c->wide + 1));
        if (y % c->cell_px % step)
            continue;
        rc = geotiff_row(map, 2, y, c->row[1], e);
        for (uint32_t x = 0; !rc && x < c->info.width; x++) {
            uint32_t cell = x / c->cell_px;
            if (x % c->cell_px % step == 0 && c->row[1][x] > 0)
                s.sample[1][(size_t)cell * CHANGED_CELL + s.count[1][cell]++] =
                    (double)c->row[1][x];
        }
        if (!rc && signals_stopping())
            rc = err_set(e, ERR_CANCEL, "stopped");
    }
    for (uint32_t k = 1; !rc && k <= 2; k++) /* of the last row of cells, above and below */
        changed_corners(c, &s, c->around + (size_t)(c->tall - 2 + k) * (c->wide + 1));
    mem_free(s.pool);
    for (size_t k = 0; k < 2; k++) {
        mem_free(s.sample[k]);
        mem_free(s.count[k]);
    }
    return rc;
}

/* Linear between the corners of a cell. */
static double changed_around_at(const struct changed *c, uint32_t x, uint32_t y)
{
    double u = (x + 0.5) / c->cell_px, v = (y + 0.5) / c->cell_px;
    size_t col = x / c->cell_px, row = y / c->cell_px;
    const float *up = c->around + row * (c->wide + 1) + col, *down = up + c->wide + 1;
    u -= (double)col;
    v -= (double)row;
    return (1 - v) * ((1 - u) * (double)up[0] + u * (double)up[1]) +
           v * ((1 - u) * (double)down[0] + u * (double)down[1]);
}

/* ---- regions ---- */

/* Of a row: its kinds, and standard deviations with those around. */
static enum err_code changed_kinds(struct changed *c, struct geotiff *map, uint32_t y,
                                   struct err *e)
{
    float *d = c->row[0], *sigma = c->row[1], *noise = c->row[2], *edge = c->row[3];
    enum err_code rc = geotiff_row(map, 1, y, d, e);
    if (!rc)
        rc = geotiff_row(map, 2, y, sigma, e);
    if (!rc)
        rc = geotiff_row(c->noise, 1, y, noise, e);
    for (uint32_t x = 0; !rc && x < c->info.width; x++) {
        float far = fabsf(d[x]), around = (float)changed_around_at(c, x, y),
              level = hypotf(noise[x], around);
        int kind = REGION_PIXEL;
        c->kind[x] = 0;
        if (!(sigma[x] > 0))
            continue;
        edge[x] = sqrtf(fmaxf(sigma[x] * sigma[x] - noise[x] * noise[x], 0));
        sigma[x] = hypotf(sigma[x], around);
        if (!(far > (float)c->request.least_m && far > (float)CHANGED_GROW * level))
            continue;
        if (far > (float)CHANGED_SIGMAS * sigma[x])
            kind |= REGION_SEED;
        if (far > (float)CHANGED_FIRM * level)
            kind |= REGION_FIRM;
        c->kind[x] = (int8_t)(d[x] > 0 ? kind : -kind);
    }
    return rc || !signals_stopping() ? rc : err_set(e, ERR_CANCEL, "stopped");
}

/* Variance of a region's volume, (m pixels)^2: noise is alike within a patch, at most within all of
 * the region. Edges of a region err alike all around; it holds the inner half of the pixels along
 * its edges. */
static double changed_variance(const struct region *r, double patch)
{
    double edge = 2 * r->edge;
    return r->variance * fmin(patch, r->pixels) + edge * edge;
}

/* Is enough of it sure, most of it beyond doubt, and its volume more than uncertain? */
static bool changed_counts(const struct changed *c, const struct region *r)
{
    return r->seeds > 0 && r->seeds * c->pixel_m2 >= c->request.least_m2 &&
           r->firm >= CHANGED_MOST * r->pixels &&
           fabs(r->sum) > CHANGED_SIGMAS * sqrt(changed_variance(r, c->patch));
}

static void changed_sum(const struct changed *c, struct changed_report *out)
{
    double variance[2] = {0};
    for (uint32_t i = 1; i < c->regions.n; i++) {
        const struct region *r = &c->regions.list[i];
        if (r->of != i || !changed_counts(c, r))
            continue;
        bool lost = r->sum < 0;
        out->pixels += r->pixels;
        out->regions++;
        *(lost ? &out->lost_m3 : &out->gained_m3) += fabs(r->sum) * c->pixel_m2;
        variance[lost] += changed_variance(r, c->patch);
    }
    out->gained_95_m3 = changed_95 * c->pixel_m2 * sqrt(variance[0]);
    out->lost_95_m3 = changed_95 * c->pixel_m2 * sqrt(variance[1]);
}

/* Rings of a polygon of GDAL's, in pixels, to the projection. */
static enum err_code changed_polygon(const struct changed *c, OGRGeometryH shape, struct layer *l,
                                     const double *value, struct err *e)
{
    size_t rings = (size_t)gdal->OGR_G_GetGeometryCount(shape), n = 0, at = 0;
    for (size_t i = 0; i < rings; i++)
        n += (size_t)gdal->OGR_G_GetPointCount(gdal->OGR_G_GetGeometryRef(shape, (int)i));
    int *count = mem_array(rings + 1, sizeof *count);
    double *x = mem_array(n + 1, 2 * sizeof *x), *y = x + n;
    enum err_code rc = count && x ? ERR_OK : err_set(e, ERR_MEM, "out of memory for an outline");
    for (size_t i = 0; !rc && i < rings; i++) {
        OGRGeometryH ring = gdal->OGR_G_GetGeometryRef(shape, (int)i);
        count[i] = gdal->OGR_G_GetPointCount(ring);
        for (int k = 0; k < count[i]; k++, at++) {
            x[at] = c->info.west_m + gdal->OGR_G_GetX(ring, k) * c->info.pixel_m;
            y[at] = c->info.north_m - gdal->OGR_G_GetY(ring, k) * c->info.pixel_m;
        }
    }
    if (!rc)
        rc = layer_add_polygon(l, rings, count, x, y, value, e);
    mem_free(count);
    mem_free(x);
    return rc;
}

static enum err_code changed_features(const struct changed *c, OGRLayerH from, struct layer *l,
                                      struct err *e)
{
    enum err_code rc = ERR_OK;
    OGRFeatureH f;
    gdal->OGR_L_ResetReading(from);
    while (!rc && (f = gdal->OGR_L_GetNextFeature(from))) {
        const struct region *r = &c->regions.list[gdal->OGR_F_GetFieldAsInteger(f, 0)];
        const double value[CHANGED_FIELDS] = {r->pixels * c->pixel_m2,
                                              r->sum * c->pixel_m2,
                                              changed_95 * c->pixel_m2 *
                                                  sqrt(changed_variance(r, c->patch)),
                                              r->sum / r->pixels,
                                              r->most,
                                              r->seeds * c->pixel_m2};
        rc = changed_polygon(c, gdal->OGR_F_GetGeometryRef(f), l, value, e);
        gdal->OGR_F_Destroy(f);
    }
    return rc;
}

/* Outlines of the regions in c->which, which holds whole numbers. */
static enum err_code changed_outlines(struct changed *c, struct err *e)
{
    static const char *const field[CHANGED_FIELDS] = {"area_m2", "volume_m3", "volume_95_m3",
                                                      "mean_m",  "most_m",    "sure_m2"};
    const struct layer_info info = {"changes", c->request.about, c->info.crs, true,
                                    field,     CHANGED_FIELDS};
    struct layer *l = NULL;
    enum err_code rc = layer_create(c->request.polygons, &info, &l, e);
    if (rc)
        return rc;
    gdal->RegisterOGRMEM();
    GDALDriverH driver = gdal->GDALGetDriverByName("Memory");
    GDALDatasetH data = !driver ? NULL : gdal->GDALCreate(driver, "", 0, 0, 0, GDT_Unknown, NULL);
    OGRLayerH shapes =
        data ? gdal->GDALDatasetCreateLayer(data, "regions", NULL, wkbPolygon, NULL) : NULL;
    OGRFieldDefnH id = gdal->OGR_Fld_Create("region", OFTInteger);
    if (!shapes || gdal->OGR_L_CreateField(shapes, id, FALSE) != OGRERR_NONE)
        rc = err_set(e, ERR_MEM, "out of memory for outlines");
    gdal->OGR_Fld_Destroy(id);
    if (!rc)
        rc = geotiff_outline(c->which, shapes, e);
    if (!rc)
        rc = changed_features(c, shapes, l, e);
    if (data)
        gdal->GDALClose(data);
    if (!rc)
        rc = layer_commit(&l, e);
    layer_close(&l);
    return rc;
}

/* The second pass: the region of each pixel that changed, into c->which. */
static enum err_code changed_mark(struct changed *c, struct geotiff *map, struct err *e)
{
    enum err_code rc = changed_work(c, "regions", GEOTIFF_HEIGHT, &c->which, e);
    if (!rc)
        rc = region_begin(&c->regions, c->info.width, e);
    for (uint32_t y = 0; !rc && y < c->info.height; y++) {
        rc = changed_kinds(c, map, y, e);
        const uint32_t *label = rc ? NULL : region_tell(&c->regions, c->kind);
        for (size_t x = 0; !rc && x < c->info.width; x++)
            c->row[0][x] = label[x] && changed_counts(c, &c->regions.list[label[x]])
                               ? (float)label[x]
                               : GEOTIFF_NODATA;
        if (!rc)
            rc = geotiff_write(c->which, 0, y, c->info.width, 1, c->row[0], e);
    }
    return rc;
}

enum err_code changed_tell(struct changed *c, struct geotiff *map, double pixel_m2,
                           struct changed_report *out, struct err *e)
{
    double patch = changed_patch(c);
    *out = (struct changed_report){.correlation_m = sqrt(patch * pixel_m2 / changed_pi)};
    c->patch = isfinite(patch) ? patch : 1;
    c->pixel_m2 = pixel_m2;
    enum err_code rc = changed_look_around(c, map, e);
    if (!rc)
        rc = region_begin(&c->regions, c->info.width, e);
    for (uint32_t y = 0; !rc && y < c->info.height; y++) {
        rc = changed_kinds(c, map, y, e);
        if (!rc)
            rc = region_add(&c->regions, c->kind, c->row[0], c->row[1], c->row[3], e);
    }
    if (rc)
        return rc;
    changed_sum(c, out);
    if (!c->request.polygons)
        return ERR_OK;
    rc = changed_mark(c, map, e);
    return rc ? rc : changed_outlines(c, e);
}
