/* Which differences are changes: see changed.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/changed.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include <gdal/gdal.h>
#include <gdal/gdal_alg.h>
#include <gdal/ogr_api.h>

#include "core/base.h"
#include "survey/layer.h"
#include "survey/region.h"

enum {
    CHANGED_LAGS = 64, /* px, over which errors may be alike */
    CHANGED_ROWS = 4,  /* every which row is asked about that */
    CHANGED_FIELDS = 6,
};
static const double changed_alike = 0.05; /* correlation that is none */
static const double changed_95 = 1.96;    /* standard deviations */
static const double changed_pi = 3.14159265358979323846;

/* Of ogrsf_frmts.h, which is C++. */
void RegisterOGRMEM(void);

struct changed {
    struct changed_request request;
    struct geotiff_info info;
    char path[FILE_PATH_MAX]; /* of what is only for us */
    /* Kind of each pixel (region.h) and what edges add to its uncertainty; region of each. */
    struct geotiff *kinds, *which;
    float *pixels; /* of a piece; of a row */
    int8_t *kind;  /* of a row */
    float *row[4];
    size_t room;
    struct region_map regions;
    /* Of stable ground: pairs so many pixels apart, their products, their sums; 0 apart: squares. */
    double n[CHANGED_LAGS], product[CHANGED_LAGS], sum;
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
    rc = ok ? changed_work(c, "kinds", GEOTIFF_SURFACE, &c->kinds, e)
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
    geotiff_close(&c->kinds);
    geotiff_close(&c->which);
    region_free(&c->regions);
    mem_free(c->kind);
    mem_free(c->pixels);
    for (size_t k = 0; k < 4; k++)
        mem_free(c->row[k]);
    mem_free(c);
    *cp = NULL;
}

/* ---- pixels ---- */

static float changed_kind(const struct changed *c, float d, float sigma, float noise)
{
    float sign = d > 0 ? 1.0f : -1.0f, far = fabsf(d);
    if (!(far > (float)c->request.least_m) || !(far > noise))
        return 0;
    return far > (float)CHANGED_SIGMAS * sigma ? 2 * sign : sign;
}

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
    size_t n = (size_t)w * h;
    if (n > c->room) {
        mem_free(c->pixels);
        c->pixels = mem_array(n, 2 * sizeof *c->pixels);
        c->room = c->pixels ? n : 0;
    }
    if (n > c->room)
        return err_set(e, ERR_MEM, "out of memory for a piece of %u x %u px", w, h);
    for (size_t v = 0; v < h; v += CHANGED_ROWS) {
        for (size_t u = 0; u < w; u++) {
            const float *p = pair + 2 * (v * w + u);
            bool stable = p[1] > 0 && p[1] < 2 * noise_m[v * w + u] && /* no edge */
                          fabsf(p[0]) < (float)CHANGED_SIGMAS * p[1];
            c->pixels[u] = stable ? p[0] : NAN;
        }
        changed_alike_row(c, c->pixels, w);
    }
    for (size_t i = 0; i < n; i++) {
        float d = pair[2 * i], sigma = pair[2 * i + 1], noise = noise_m[i];
        bool known = sigma > 0;
        c->pixels[2 * i] = known ? changed_kind(c, d, sigma, noise) : 0;
        c->pixels[2 * i + 1] = known ? sqrtf(fmaxf(sigma * sigma - noise * noise, 0)) : 0;
    }
    return geotiff_write(c->kinds, x, y, w, h, c->pixels, e);
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

/* ---- regions ---- */

static enum err_code changed_kinds(struct changed *c, uint32_t y, struct err *e)
{
    enum err_code rc = geotiff_row(c->kinds, 1, y, c->row[2], e);
    if (!rc)
        rc = geotiff_row(c->kinds, 2, y, c->row[3], e);
    for (size_t x = 0; !rc && x < c->info.width; x++)
        c->kind[x] = c->row[2][x] < GEOTIFF_NODATA + 1 ? 0 : (int8_t)c->row[2][x];
    return rc || !signals_stopping() ? rc : err_set(e, ERR_CANCEL, "stopped");
}

static bool changed_counts(const struct changed *c, const struct region *r, double pixel_m2)
{
    return r->seeds > 0 && r->seeds * pixel_m2 >= c->request.least_m2;
}

/* Variance of a region's volume, (m pixels)^2: noise is alike within a patch, edges of a region err
 * alike all around. The region holds the inner half of the pixels along its edges. */
static double changed_variance(const struct region *r, double patch)
{
    double edge = 2 * r->edge;
    return r->variance * patch + edge * edge;
}

static void changed_sum(const struct changed *c, double pixel_m2, double patch,
                        struct changed_report *out)
{
    double variance[2] = {0};
    for (uint32_t i = 1; i < c->regions.n; i++) {
        const struct region *r = &c->regions.list[i];
        if (r->of != i || !changed_counts(c, r, pixel_m2))
            continue;
        bool lost = r->sum < 0;
        out->pixels += r->pixels;
        out->regions++;
        *(lost ? &out->lost_m3 : &out->gained_m3) += fabs(r->sum) * pixel_m2;
        variance[lost] += changed_variance(r, patch);
    }
    out->gained_95_m3 = changed_95 * pixel_m2 * sqrt(variance[0]);
    out->lost_95_m3 = changed_95 * pixel_m2 * sqrt(variance[1]);
}

/* Rings of a polygon of GDAL's, in pixels, to the projection. */
static enum err_code changed_polygon(const struct changed *c, OGRGeometryH shape, struct layer *l,
                                     const double *value, struct err *e)
{
    size_t rings = (size_t)OGR_G_GetGeometryCount(shape), n = 0, at = 0;
    for (size_t i = 0; i < rings; i++)
        n += (size_t)OGR_G_GetPointCount(OGR_G_GetGeometryRef(shape, (int)i));
    int *count = mem_array(rings + 1, sizeof *count);
    double *x = mem_array(n + 1, 2 * sizeof *x), *y = x + n;
    enum err_code rc = count && x ? ERR_OK : err_set(e, ERR_MEM, "out of memory for an outline");
    for (size_t i = 0; !rc && i < rings; i++) {
        OGRGeometryH ring = OGR_G_GetGeometryRef(shape, (int)i);
        count[i] = OGR_G_GetPointCount(ring);
        for (int k = 0; k < count[i]; k++, at++) {
            x[at] = c->info.west_m + OGR_G_GetX(ring, k) * c->info.pixel_m;
            y[at] = c->info.north_m - OGR_G_GetY(ring, k) * c->info.pixel_m;
        }
    }
    if (!rc)
        rc = layer_add_polygon(l, rings, count, x, y, value, e);
    mem_free(count);
    mem_free(x);
    return rc;
}

static enum err_code changed_features(const struct changed *c, OGRLayerH from, struct layer *l,
                                      double pixel_m2, double patch, struct err *e)
{
    enum err_code rc = ERR_OK;
    OGRFeatureH f;
    OGR_L_ResetReading(from);
    while (!rc && (f = OGR_L_GetNextFeature(from))) {
        const struct region *r = &c->regions.list[OGR_F_GetFieldAsInteger(f, 0)];
        const double value[CHANGED_FIELDS] = {
            r->pixels * pixel_m2,
            r->sum * pixel_m2,
            changed_95 * pixel_m2 * sqrt(changed_variance(r, patch)),
            r->sum / r->pixels,
            r->most,
            r->seeds * pixel_m2};
        rc = changed_polygon(c, OGR_F_GetGeometryRef(f), l, value, e);
        OGR_F_Destroy(f);
    }
    return rc;
}

/* Outlines of the regions in c->which, which holds whole numbers. */
static enum err_code changed_outlines(struct changed *c, double pixel_m2, double patch,
                                      struct err *e)
{
    static const char *const field[CHANGED_FIELDS] = {"area_m2", "volume_m3", "volume_95_m3",
                                                      "mean_m",  "most_m",    "sure_m2"};
    const struct layer_info info = {"changes", c->request.about, c->info.crs, true,
                                    field,     CHANGED_FIELDS};
    struct layer *l = NULL;
    enum err_code rc = layer_create(c->request.polygons, &info, &l, e);
    RegisterOGRMEM();
    GDALDriverH driver = GDALGetDriverByName("Memory");
    GDALDatasetH data = rc || !driver ? NULL : GDALCreate(driver, "", 0, 0, 0, GDT_Unknown, NULL);
    OGRLayerH shapes =
        data ? GDALDatasetCreateLayer(data, "regions", NULL, wkbPolygon, NULL) : NULL;
    OGRFieldDefnH id = OGR_Fld_Create("region", OFTInteger);
    if (!rc && (!shapes || OGR_L_CreateField(shapes, id, FALSE) != OGRERR_NONE))
        rc = err_set(e, ERR_MEM, "out of memory for outlines");
    OGR_Fld_Destroy(id);
    if (!rc)
        rc = geotiff_outline(c->which, shapes, e);
    if (!rc)
        rc = changed_features(c, shapes, l, pixel_m2, patch, e);
    if (data)
        GDALClose(data);
    if (!rc)
        rc = layer_commit(&l, e);
    layer_close(&l);
    return rc;
}

/* The second pass: the region of each pixel that changed, into c->which. */
static enum err_code changed_mark(struct changed *c, double pixel_m2, struct err *e)
{
    enum err_code rc = changed_work(c, "regions", GEOTIFF_HEIGHT, &c->which, e);
    if (!rc)
        rc = region_begin(&c->regions, c->info.width, e);
    for (uint32_t y = 0; !rc && y < c->info.height; y++) {
        rc = changed_kinds(c, y, e);
        const uint32_t *label = rc ? NULL : region_tell(&c->regions, c->kind);
        for (size_t x = 0; !rc && x < c->info.width; x++)
            c->row[0][x] = label[x] && changed_counts(c, &c->regions.list[label[x]], pixel_m2)
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
    enum err_code rc = region_begin(&c->regions, c->info.width, e);
    for (uint32_t y = 0; !rc && y < c->info.height; y++) {
        rc = changed_kinds(c, y, e);
        for (int k = 0; !rc && k < 2; k++)
            rc = geotiff_row(map, k + 1, y, c->row[k], e);
        if (!rc)
            rc = region_add(&c->regions, c->kind, c->row[0], c->row[1], c->row[3], e);
    }
    if (rc)
        return rc;
    if (!isfinite(patch))
        patch = 1;
    changed_sum(c, pixel_m2, patch, out);
    if (!c->request.polygons)
        return ERR_OK;
    rc = changed_mark(c, pixel_m2, e);
    return rc ? rc : changed_outlines(c, pixel_m2, patch, e);
}
