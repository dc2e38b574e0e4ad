/* Positions of photographs by a file instead of EXIF: see positions.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "core/math/sort.h"
#include "scene/ingest/ingest.h"
#include "scene/ingest/ingest_internal.h"

/* Metres beyond which two positions of a photograph are a warning, and an error. Satellites alone
 * are right to ten metres or so; a day's old one of a phone is not. */
static const double position_odd_m = 100, position_wrong_m = 1000, position_odd_height_m = 150;

struct position_pair { /* of one photograph */
    double a[2], b[2]; /* longitude and latitude */
};

static double positions_apart_m(const double a[2], const double b[2])
{
    const double rad = 0.017453292519943295, radius_m = 6371000;
    const double s = sin(0.5 * rad * (b[1] - a[1])), t = sin(0.5 * rad * (b[0] - a[0]));
    const double h = s * s + cos(rad * a[1]) * cos(rad * b[1]) * t * t;
    return 2 * radius_m * asin(fmin(1, sqrt(h)));
}

/* Median distance of the pairs when a's values are read in another way. */
static double positions_median_m(const struct position_pair *pair, size_t n, int reading,
                                 double *scratch)
{
    for (size_t i = 0; i < n; i++) {
        const double *a = pair[i].a;
        const double read[4][2] = {{a[0], a[1]}, {a[1], a[0]}, {-a[0], a[1]}, {a[0], -a[1]}};
        scratch[i] = positions_apart_m(read[reading], pair[i].b);
    }
    return sort_median(scratch, n);
}

/* Holds two sources of positions against each other, which both are named. */
static enum err_code positions_hold(const struct ingest *g, const struct position_pair *pair,
                                    size_t n, const char *one, const char *other, struct err *e)
{
    static const char *const why[] = {"another coordinate system, or other photographs",
                                      "x and y are swapped", "the sign of the longitudes",
                                      "the sign of the latitudes"};
    double *scratch = mem_array(n, sizeof *scratch);
    int reading = 0;
    if (!scratch)
        return err_set(e, ERR_MEM, "ingest: out of memory for %zu photographs", n);
    const double apart_m = positions_median_m(pair, n, 0, scratch);
    for (int k = 1; k < 4 && apart_m > position_odd_m && !reading; k++)
        reading = positions_median_m(pair, n, k, scratch) < 0.1 * apart_m ? k : 0;
    mem_free(scratch);
    if (!(apart_m > position_odd_m))
        return ERR_OK;
    if (apart_m < position_wrong_m || !g->cfg->gps_check) {
        log_warn("ingest",
                 "positions by %s and by %s are %.0f m apart (median of %zu photographs), e.g. "
                 "%.7f %.7f and %.7f %.7f: the former count",
                 one, other, apart_m, n, pair[0].a[0], pair[0].a[1], pair[0].b[0], pair[0].b[1]);
        return ERR_OK;
    }
    return err_set(e, ERR_DATA,
                   "positions by %s are %.1f km from those by %s (median of %zu photographs), e.g. "
                   "%.7f %.7f and %.7f %.7f: likely %s. Mend what is wrong; if the former are "
                   "right, give --no-gps-check",
                   one, 1e-3 * apart_m, other, n, pair[0].a[0], pair[0].a[1], pair[0].b[0],
                   pair[0].b[1], why[reading]);
}

/* Heights that differ by so much are in feet, or count from elsewhere. */
static void positions_hold_heights(const struct ingest *g, const struct position_photo *photos,
                                   double *scratch)
{
    const double foot_m = 0.3048;
    size_t n = 0;
    double feet = 0;
    for (size_t i = 0; i < g->n; i++) {
        const struct ingest_photo *p = &g->photos[i];
        if (photos[i].position == SIZE_MAX || !p->gps.has_altitude ||
            p->altitude == INGEST_ALTITUDE_TAKEOFF || p->altitude == INGEST_ALTITUDE_NONE)
            continue;
        const double h = g->positions->list[photos[i].position].at[2];
        feet += fabs(foot_m * h - p->gps.alt_m) < fmax(60, 0.02 * fabs(p->gps.alt_m));
        scratch[n++] = h - p->gps.alt_m;
    }
    const double off_m = sort_median(scratch, n);
    if (n && fabs(off_m) > position_odd_height_m)
        log_warn("ingest",
                 "heights by --positions are %+.0f m from those of the photographs (median of "
                 "%zu): %s",
                 off_m, n,
                 2 * feet > (double)n ? "likely they are in feet"
                                      : "do they count from elsewhere?");
}

static bool positions_somewhere(bool known, double lon_deg, double lat_deg)
{
    return known && (lon_deg != 0 || lat_deg != 0);
}

/* The two positions of a photograph: of the file and EXIF, or without a file of EXIF and XMP. */
static bool positions_pair(const struct ingest *g, const struct position_photo *photos, size_t i,
                           struct position_pair *out)
{
    const struct image_gps *x = &g->photos[i].gps;
    const struct drone_meta *d = &g->photos[i].drone;
    if (!positions_somewhere(x->has_position, x->lon_deg, x->lat_deg) ||
        (photos ? photos[i].position == SIZE_MAX : !d->has_position))
        return false;
    const double exif[2] = {x->lon_deg, x->lat_deg}, xmp[2] = {d->lon_deg, d->lat_deg};
    memcpy(out->a, photos ? g->positions->list[photos[i].position].at : exif, sizeof out->a);
    memcpy(out->b, photos ? exif : xmp, sizeof out->b);
    return true;
}

/* What EXIF says of its positions beside their numbers, where these count. */
static void positions_doubt(const struct ingest *g)
{
    size_t odd = 0, interrupted = 0, no_letter = 0, far_datum = 0;
    for (size_t i = 0; i < g->n; i++) {
        const struct image_gps *x = &g->photos[i].gps;
        odd += x->odd_sign;
        interrupted += x->has_position && x->interrupted;
        no_letter += x->has_position && x->no_letter && !g->photos[i].drone.has_position;
        far_datum += x->has_position && x->far_datum;
    }
    if (odd)
        log_warn("ingest",
                 "%zu photographs have negative degrees and the letter of the other hemisphere in "
                 "EXIF: the sign counts",
                 odd);
    if (interrupted)
        log_warn("ingest",
                 "%zu photographs say that GPS was interrupted (GPSStatus V): their positions may "
                 "be old ones",
                 interrupted);
    if (no_letter)
        log_warn("ingest",
                 "%zu photographs do not say in EXIF whether they lie north or south, and east or "
                 "west: north and east are taken; if that is wrong, give --positions or --gcp",
                 no_letter);
    if (far_datum)
        log_warn("ingest",
                 "%zu photographs say that their GPS is not of WGS 84 (GPSMapDatum): places may be "
                 "hundreds of metres off; give --positions or --gcp",
                 far_datum);
}

/* The file's positions, EXIF's and XMP's: those of one photograph lie near each other. */
static enum err_code positions_check(const struct ingest *g, const struct position_photo *photos,
                                     struct err *e)
{
    struct position_pair *pair = mem_array(g->n, sizeof *pair);
    double *scratch = mem_array(g->n, sizeof *scratch);
    size_t n = 0;
    enum err_code rc = pair && scratch
                           ? ERR_OK
                           : err_set(e, ERR_MEM, "ingest: out of memory for %zu photographs", g->n);
    for (size_t i = 0; !rc && i < g->n; i++)
        n += positions_pair(g, photos, i, &pair[n]);
    if (!photos)
        positions_doubt(g);
    if (!rc && n)
        rc = photos ? positions_hold(g, pair, n, "--positions", "the photographs' GPS", e)
                    : positions_hold(g, pair, n, "EXIF", "XMP", e);
    if (!rc && photos)
        positions_hold_heights(g, photos, scratch);
    mem_free(pair);
    mem_free(scratch);
    return rc;
}

/* Positions that all are one place fix neither scale nor north: they are those of a last fix. */
static void positions_forget_stuck(struct ingest *g)
{
    const double same_deg = 1e-7; /* a centimetre */
    const struct image_gps *first = NULL;
    size_t n = 0;
    for (size_t i = 0; i < g->n; i++) {
        const struct image_gps *x = &g->photos[i].gps;
        if (!positions_somewhere(x->has_position, x->lon_deg, x->lat_deg))
            continue;
        first = first ? first : x;
        if (fabs(x->lon_deg - first->lon_deg) > same_deg ||
            fabs(x->lat_deg - first->lat_deg) > same_deg)
            return;
        n++;
    }
    if (n < 3)
        return;
    log_warn(
        "ingest",
        "GPS has all %zu photographs at one place, %.7f %.7f: it is that of a last fix and does "
        "not count; give --positions or --gcp, or --origin and --metres-per-unit",
        n, first->lon_deg, first->lat_deg);
    for (size_t i = 0; i < g->n; i++)
        g->photos[i].gps.has_position = false;
}

/* Photographs that the file does not name have no position: EXIF's would lie metres beside. */
static void positions_put(struct ingest *g, const struct position_photo *photos)
{
    for (size_t i = 0; i < g->n; i++) {
        struct ingest_photo *p = &g->photos[i];
        const struct position *at =
            photos[i].position == SIZE_MAX ? NULL : &g->positions->list[photos[i].position];
        p->gps.has_position = p->gps.has_altitude = at != NULL;
        p->altitude = INGEST_ALTITUDE_FILE;
        memset(p->sigma_m, 0, sizeof p->sigma_m);
        if (!at)
            continue;
        p->gps.lon_deg = at->at[0];
        p->gps.lat_deg = at->at[1];
        p->gps.alt_m = at->at[2];
        memcpy(p->sigma_m, at->sigma_m, sizeof p->sigma_m);
        g->n_positioned++;
    }
}

enum err_code ingest_positions_apply(struct ingest *g, struct err *e)
{
    for (size_t i = 0; i < g->n; i++)
        memcpy(g->photos[i].sigma_m, g->photos[i].drone.sigma_m, sizeof g->photos[i].sigma_m);
    if (!g->positions) {
        const enum err_code rc = positions_check(g, NULL, e);
        positions_forget_stuck(g);
        return rc;
    }
    struct position_photo *photos = mem_array(g->n, sizeof *photos);
    if (!photos)
        return err_set(e, ERR_MEM, "ingest: out of memory for %zu photographs", g->n);
    for (size_t i = 0; i < g->n; i++) {
        const struct ingest_photo *p = &g->photos[i];
        photos[i] = (struct position_photo){.name = p->image->name,
                                            .time_s = positions_time(p->gps.time),
                                            .has_gps = p->gps.has_position,
                                            .lon_deg = p->gps.lon_deg,
                                            .lat_deg = p->gps.lat_deg};
    }
    enum err_code rc = positions_match(g->positions, photos, g->n, e);
    if (!rc)
        rc = positions_check(g, photos, e);
    if (!rc)
        positions_put(g, photos);
    mem_free(photos);
    if (!rc && !g->n_positioned)
        rc = err_set(e, ERR_DATA,
                     "--positions %s: none of %zu positions is of one of the %zu photographs; "
                     "the first of these is %s",
                     g->cfg->positions, g->positions->n, g->n, g->photos[0].image->name);
    if (!rc && g->n_positioned < g->n)
        log_warn("ingest", "--positions has none of %zu of %zu photographs: they have no position",
                 g->n - g->n_positioned, g->n);
    return rc;
}
