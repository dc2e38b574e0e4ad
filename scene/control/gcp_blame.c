/* Finds out what is wrong with ground control: it reads the list in other ways, and compares it
 * with the GPS of the photographs or with the other points.
 *
 * A whole list may be wrong in the same way: another zone, east and north exchanged, feet, another
 * datum. A scene that is fitted to such a list is consistent, but in another place. All such
 * readings are tried, and the one that brings the points to their photographs is named. GPS without
 * stated accuracy counts as right to 15 m horizontally, as code measurements are with a margin, and
 * to 25 m in height, as barometers are. The geoid is up to 107 m from the ellipsoid.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/base.h"
#include "core/math/sort.h"
#include "scene/control/gcp_fit.h"

static const double blame_far_m = 1000, blame_extents = 3; /* beyond it no camera sees a point */
static const double blame_plan_m = 15, blame_height_m = 25, blame_sigmas = 5, blame_least_m = 0.3;
static const double blame_geoid_m = 110;
static const double foot_m = 0.3048, us_foot_m = 1200.0 / 3937;
enum { BLAME_TEXT = 200, BLAME_CODES = 3 };

/* Transverse Mercator in zones of six degrees: codes are a number and the zone. */
static const struct {
    int base, first, last;
    const char *name;
} families[] = {
    {32600, 1, 60, "WGS 84 north"}, {32700, 1, 60, "WGS 84 south"}, {25800, 28, 38, "ETRS89"},
    {23000, 28, 38, "ED50"},        {26700, 1, 23, "NAD27"},        {26900, 1, 23, "NAD83"},
    {20200, 48, 58, "AGD66"},       {20300, 48, 58, "AGD84"},       {28300, 46, 59, "GDA94"},
    {7800, 46, 59, "GDA2020"},      {3041, 51, 55, "Tokyo"}};
enum { FAMILIES = sizeof families / sizeof *families };

/* ---- other readings of the list ---- */

enum reading_kind { READ_CODE, READ_SWAPPED, READ_SCALED, READ_WEST, READ_PREFIX };
struct reading {
    enum reading_kind kind;
    int epsg;     /* of READ_CODE, else the list's */
    double scale; /* of READ_SCALED */
    bool near;    /* the same datum: the likelier of readings that do alike */
    char what[BLAME_TEXT];
};

/* Longitude and latitude of a point, read so. False: it is none. */
static bool blame_read(const struct gcp_list *l, const struct reading *r, size_t i, double *lon,
                       double *lat)
{
    struct err e = {0};
    const double *file = l->gcps[i].file;
    double x = file[0], y = file[1];
    if (r->kind == READ_SWAPPED) {
        x = file[1];
        y = file[0];
    }
    if (r->kind == READ_SCALED) {
        x *= r->scale;
        y *= r->scale;
    }
    if (r->kind == READ_WEST)
        x = -x;
    if (r->kind == READ_PREFIX)
        x = fmod(x, 1e6);
    if (r->epsg != GCP_LONLAT && (!l->unproject || l->unproject(r->epsg, &x, &y, &e)))
        return false;
    *lon = x;
    *lat = y;
    return fabs(x) <= 180 && fabs(y) <= 90;
}

/* The k-th other reading of a list whose photographs lie near longitude lon; false: no more. */
static bool blame_reading(const struct gcp_list *l, double lon, size_t k, struct reading *out)
{
    int epsg = l->epsg, zone = (int)floor((lon + 180) / 6) + 1, at = 0;
    size_t family = FAMILIES;
    *out = (struct reading){.kind = READ_CODE, .epsg = epsg, .near = true};
    for (size_t f = 0; f < FAMILIES; f++)
        if (epsg >= families[f].base + families[f].first &&
            epsg <= families[f].base + families[f].last) {
            family = f;
            at = epsg - families[f].base;
        }
    static const struct {
        enum reading_kind kind;
        double scale;
        const char *what;
    } plain[] = {{READ_SWAPPED, 0, "x and y are swapped"},
                 {READ_SCALED, foot_m, "the coordinates are in feet, international or US survey"},
                 {READ_SCALED, us_foot_m, "the coordinates are in US survey feet"},
                 {READ_SCALED, 0.001, "the coordinates are in millimetres, or lost their point"},
                 {READ_SCALED, 0.01, "the coordinates are in centimetres, or lost their point"},
                 {READ_WEST, 0, "western longitudes lost their sign"},
                 {READ_PREFIX, 0, "the eastings begin with the number of the zone"}};
    enum { PLAIN = sizeof plain / sizeof *plain, ZONES = 3 };
    if (k < PLAIN) {
        out->kind = plain[k].kind;
        out->scale = plain[k].scale;
        snprintf(out->what, sizeof out->what, "%s", plain[k].what);
        return true;
    }
    k -= PLAIN;
    if (epsg == GCP_LONLAT || l->degrees || !l->unproject) /* degrees have no zones */
        return false;
    if (k < FAMILIES * ZONES) { /* zones of the photographs' longitude and beside it */
        size_t f = k / ZONES;
        int z = zone + (k % ZONES == 0 ? 0 : k % ZONES == 1 ? -1 : 1);
        bool there = z >= families[f].first && z <= families[f].last && family < FAMILIES;
        out->epsg = there ? families[f].base + z : epsg;
        bool same = f == family, other = f != family && z != at;
        const char *what = same ? "the zone" : other ? "zone and datum" : "the datum";
        if (f != family && f < 2 && family < 2)
            what = "the hemisphere";
        out->near = same || (f < 2 && family < 2);
        snprintf(out->what, sizeof out->what, "%s: EPSG:%d (zone %d, %s) fits, EPSG:%d does not",
                 what, out->epsg, z, families[f].name, epsg);
        return true;
    }
    k -= FAMILIES * ZONES;
    if (k >= 2 * BLAME_CODES)
        return false;
    out->epsg = epsg + (k % 2 ? -1 : 1) * (int)(k / 2 + 1); /* zones of many countries */
    snprintf(out->what, sizeof out->what, "the zone: EPSG:%d fits, EPSG:%d does not", out->epsg,
             epsg);
    return true;
}

/* ---- far from the photographs ---- */

static double blame_plan(double lon, double lat, const struct gcp_view *v)
{
    const struct geo_origin o = {v->lon_deg, v->lat_deg, 0};
    struct err e = {0};
    double enu[3];
    if (geo_to_enu(&o, lon, lat, 0, enu, &e))
        return HUGE_VAL;
    /* Beyond the horizon the plane says too little; the chord is at least a distance. */
    return sqrt(enu[0] * enu[0] + enu[1] * enu[1] + enu[2] * enu[2]);
}

/* Median distance of a point from the GPS of the photographs that mark it; NAN: these have none. */
static double blame_distance(const struct gcp_fit *f, size_t i, double lon, double lat,
                             double *scratch)
{
    const struct gcp_place *p = &f->at.places[i];
    size_t n = 0;
    for (size_t k = 0; k < p->n; k++)
        if (f->at.sights[p->first + k].view->has_gps)
            scratch[n++] = blame_plan(lon, lat, f->at.sights[p->first + k].view);
    return n ? sort_median(scratch, n) : (double)NAN;
}

/* Of all points, read so: the median distance. */
static double blame_all(const struct gcp_fit *f, const struct reading *r, double *scratch,
                        double *each)
{
    size_t n = 0;
    for (size_t i = 0; i < f->list->n; i++) {
        double lon, lat;
        if (!blame_read(f->list, r, i, &lon, &lat))
            return HUGE_VAL;
        double d = blame_distance(f, i, lon, lat, scratch);
        if (isfinite(d))
            each[n++] = d;
    }
    return n ? sort_median(each, n) : HUGE_VAL;
}

/* How far apart the photographs are, and a longitude of them; 0: fewer than three have GPS. */
static double blame_extent(const struct gcp_view *views, size_t n, double *lon)
{
    double most = 0;
    const struct gcp_view *first = NULL;
    size_t with = 0;
    for (size_t i = 0; i < n; i++) {
        if (!views[i].has_gps)
            continue;
        first = first ? first : &views[i];
        most = fmax(most, blame_plan(views[i].lon_deg, views[i].lat_deg, first));
        with++;
    }
    if (with < 3)
        return 0;
    *lon = first->lon_deg;
    return fmax(most, 1);
}

static enum err_code blame_everything(const struct gcp_fit *f, double lon, double limit_m,
                                      double off_m, double *scratch, double *each, struct err *e)
{
    struct reading r, best = {0};
    double least = limit_m;
    for (size_t pass = 0; pass < 2 && !best.what[0]; pass++)
        for (size_t k = 0; blame_reading(f->list, lon, k, &r); k++) {
            if (r.near != (pass == 0))
                continue;
            double d = blame_all(f, &r, scratch, each);
            if (!(d < 0.9 * least)) /* the first of those that are alike */
                continue;
            least = d;
            best = r;
        }
    return err_set(e, ERR_DATA,
                   "the ground control points lie %.*f km from where GPS has the photographs that "
                   "mark them%s%s. Mend the list or --gcp-epsg; if GPS is wrong, give "
                   "--no-gps-check",
                   off_m < 1e5, 0.001 * off_m,
                   best.what[0] ? ": likely " : ": another coordinate system, or another survey",
                   best.what);
}

enum err_code gcp_blame_far(struct gcp_fit *f, const struct gcp_view *views, size_t n_views,
                            struct err *e)
{
    size_t n = f->list->n, far = 0, known = 0, most = 0;
    double lon = 0, extent = blame_extent(views, n_views, &lon),
           limit = fmax(blame_far_m, blame_extents * extent);
    for (size_t i = 0; i < n; i++)
        most = f->at.places[i].n > most ? f->at.places[i].n : most;
    double *scratch = mem_array(most, sizeof *scratch), *each = mem_array(n, sizeof *each),
           *off = mem_array(n, sizeof *off);
    enum err_code rc = scratch && each && off
                           ? ERR_OK
                           : err_set(e, ERR_MEM, "out of memory for ground control points");
    for (size_t i = 0; !rc && extent > 0 && i < n; i++) {
        const double *at = f->list->gcps[i].at;
        double d = blame_distance(f, i, at[0], at[1], scratch);
        if (!isfinite(d))
            continue;
        f->points[i].far = d > limit;
        far += d > limit;
        off[known++] = d;
        if (d > limit)
            snprintf(f->points[i].cause, sizeof f->points[i].cause,
                     "it lies %.*f km from the GPS of its photographs", d < 1e5, 0.001 * d);
    }
    if (!rc && 2 * far > known)
        rc = blame_everything(f, lon, limit, sort_median(off, known), scratch, each, e);
    mem_free(scratch);
    mem_free(each);
    mem_free(off);
    return rc;
}

/* ---- single points ---- */

/* Would the point fit at y? In its errors, and about as well as others do. */
static bool blame_fits(const struct gcp_fit *f, size_t i, const double y[3])
{
    const struct gcp_point *p = &f->points[i];
    double at[3];
    sim3_apply(&f->sim, f->at.places[i].x, at);
    double plan = hypot(at[0] - y[0], at[1] - y[1]), up = fabs(at[2] - y[2]);
    return plan < 5 * fmax(p->left.sigma_m[0], p->gsd_m) &&
           up < 5 * fmax(p->left.sigma_m[1], p->gsd_m);
}

static bool blame_swapped(const struct gcp_fit *f, size_t i)
{
    struct reading r = {.kind = READ_SWAPPED, .epsg = f->list->epsg};
    struct err e = {0};
    double lon, lat, y[3], at[3];
    if (!blame_read(f->list, &r, i, &lon, &lat) ||
        geo_to_enu(&f->frame, lon, lat, f->frame.h_m, y, &e))
        return false;
    sim3_apply(&f->sim, f->at.places[i].x, at);
    y[2] = at[2]; /* of places alone */
    return blame_fits(f, i, y);
}

static const char *blame_height(const struct gcp_fit *f, size_t i, const double surveyed[3])
{
    static const struct {
        double scale;
        const char *what;
    } heights[] = {{foot_m, "its height is in feet"},
                   {1 / foot_m, "its height was turned from feet to metres twice"},
                   {0.1, "the point of its height is one digit too far right"},
                   {10, "the point of its height is one digit too far left"},
                   {-1, "the sign of its height"}};
    for (size_t k = 0; k < sizeof heights / sizeof *heights; k++) {
        double h = f->list->gcps[i].file[2],
               y[3] = {surveyed[0], surveyed[1], surveyed[2] + (heights[k].scale - 1) * h};
        if (blame_fits(f, i, y))
            return heights[k].what;
    }
    return NULL;
}

/* The other suspect with which it exchanged names. */
static size_t blame_exchanged(const struct gcp_fit *f, size_t i, const double (*y)[3])
{
    for (size_t j = 0; j < f->list->n; j++)
        if (j != i && f->points[j].suspect && f->at.places[j].n_photos && blame_fits(f, i, y[j]) &&
            blame_fits(f, j, y[i]))
            return j;
    return f->list->n;
}

/* Another point that was surveyed at the same place. */
static size_t blame_copied(const struct gcp_fit *f, size_t i, const double (*y)[3])
{
    for (size_t j = 0; j < f->list->n; j++)
        if (j != i && hypot(hypot(y[i][0] - y[j][0], y[i][1] - y[j][1]), y[i][2] - y[j][2]) <
                          fmax(f->points[i].gsd_m, 0.01))
            return j;
    return f->list->n;
}

enum err_code gcp_blame_suspects(struct gcp_fit *f, const double (*y)[3], struct err *e)
{
    size_t n = f->list->n;
    for (size_t i = 0; i < n; i++) {
        struct gcp_point *p = &f->points[i];
        if (!p->suspect || !f->at.places[i].n_photos)
            continue;
        size_t other = blame_exchanged(f, i, y), copy = blame_copied(f, i, y);
        const char *height = blame_height(f, i, y[i]);
        if (other < n)
            snprintf(p->cause, sizeof p->cause, "it and %s have each other's name",
                     f->list->gcps[other].name);
        else if (copy < n)
            snprintf(p->cause, sizeof p->cause, "it has the coordinates of %s",
                     f->list->gcps[copy].name);
        else if (height)
            snprintf(p->cause, sizeof p->cause, "%s", height);
        else if (blame_swapped(f, i))
            snprintf(p->cause, sizeof p->cause, "its x and y are swapped");
    }
    (void)e;
    return ERR_OK;
}

/* ---- all of it against GPS ---- */

/* Would another reading explain this offset in plan? Both in the frame, metres. */
static enum err_code blame_offset(struct gcp_fit *f, double lon, const double off[2], struct err *e)
{
    double least = 0.4 * hypot(off[0], off[1]);
    struct reading r;
    for (size_t k = 0; blame_reading(f->list, lon, k, &r); k++) {
        double moved[2] = {0};
        size_t i = 0;
        for (; i < f->list->n; i++) {
            const double *at = f->list->gcps[i].at;
            double was[3], now[3], x, y;
            if (!blame_read(f->list, &r, i, &x, &y))
                break;
            enum err_code rc = geo_to_enu(&f->frame, at[0], at[1], f->frame.h_m, was, e);
            if (!rc)
                rc = geo_to_enu(&f->frame, x, y, f->frame.h_m, now, e);
            if (rc)
                return rc;
            for (size_t a = 0; a < 2; a++)
                moved[a] += (now[a] - was[a]) / (double)f->list->n;
        }
        double rest = hypot(off[0] - moved[0], off[1] - moved[1]);
        if (i < f->list->n || !(rest < 0.9 * least))
            continue;
        least = rest;
        snprintf(f->gps.cause, sizeof f->gps.cause, "%.190s", r.what);
    }
    if (!f->gps.cause[0])
        snprintf(f->gps.cause, sizeof f->gps.cause,
                 "another datum, or wrong marks; or GPS is that far off");
    return ERR_OK;
}

static void blame_heights(struct gcp_fit *f)
{
    const struct gcp_gps *g = &f->gps;
    double mean = 0, off = g->height_m;
    for (size_t i = 0; i < f->list->n; i++)
        mean += f->list->gcps[i].file[2] / (double)f->list->n;
    const char *what = "what the heights count from; or GPS is that far off";
    if (fabs(off + (1 - foot_m) * mean) < fmax(blame_height_m, 0.1 * fabs(off)))
        what = "the points' heights are in feet";
    else if (fabs(off) < blame_geoid_m)
        what = "the vertical datum: one counts from the sea, the other from the ellipsoid; say "
               "what the points' do by --heights, and give --geoid";
    size_t n = strlen(f->gps.cause);
    snprintf(f->gps.cause + n, sizeof f->gps.cause - n, "%s%s", n ? "; " : "", what);
}

enum err_code gcp_blame_gps(struct gcp_fit *f, const struct gcp_view *views, size_t n_views,
                            struct err *e)
{
    double *v = mem_array(n_views, 5 * sizeof *v), off[3], sigma[2], lon = 0;
    enum err_code rc =
        v ? ERR_OK : err_set(e, ERR_MEM, "out of memory for %zu photographs", n_views);
    size_t n = 0, said = 0;
    for (size_t i = 0; !rc && i < n_views; i++) {
        double at[3], gps[3];
        if (!views[i].has_gps)
            continue;
        lon = views[i].lon_deg;
        sim3_apply(&f->sim, views[i].center, at);
        rc = geo_to_enu(&f->frame, views[i].lon_deg, views[i].lat_deg, views[i].h_m, gps, e);
        for (size_t k = 0; k < 3; k++)
            v[k * n_views + n] = gps[k] - at[k];
        for (size_t k = 0; k < 2; k++)
            v[(3 + k) * n_views + said] = views[i].sigma_m[k];
        said += views[i].sigma_m[0] > 0 && views[i].sigma_m[1] > 0;
        n++;
    }
    if (rc || n < 3) {
        mem_free(v);
        return rc;
    }
    for (size_t k = 0; k < 3; k++)
        off[k] = sort_median(v + k * n_views, n);
    for (size_t k = 0; k < 2; k++)
        sigma[k] = sort_median(v + (3 + k) * n_views, said);
    mem_free(v);
    bool exact = 2 * said > n;
    f->gps = (struct gcp_gps){
        .n = n,
        .plan_m = hypot(off[0], off[1]),
        .height_m = off[2],
        .limit_m = {exact ? fmax(blame_sigmas * sigma[0], blame_least_m) : blame_plan_m,
                    exact ? fmax(blame_sigmas * sigma[1], blame_least_m) : blame_height_m}};
    if (f->gps.plan_m > f->gps.limit_m[0])
        rc = blame_offset(f, lon, off, e);
    if (!rc && fabs(f->gps.height_m) > f->gps.limit_m[1])
        blame_heights(f);
    return rc;
}
