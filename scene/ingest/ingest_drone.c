/* Data of drones about their photographs (codec/image/drone.h): the altitude to use, and the
 * direction up by their gimbals.
 *
 * Which altitudes are believed, flight by flight, the first that holds:
 *
 *   most photographs are by RTK with a fix      XMP's absolute ones, above the ellipsoid
 *   EXIF says that it counts from the ellipsoid EXIF's
 *   EXIF has some                               EXIF's
 *   XMP has absolute ones                       XMP's
 *   anything is above take-off                  that, and the scene's heights say so
 *   all are 0 or absent                         0, and the scene's heights are not known
 *
 * 0 is what cameras write without a fix: it is no altitude, nor is one that no drone reaches.
 * EXIF's do not count if they are XMP's with the other sign (a firmware that says "below the
 * sea"), or above take-off; nor do XMP's absolute ones that equal the relative ones, by RTK or not,
 * and heights above take-off that all are 0. A contradiction is said with both values.
 *
 * RTK comes and goes within a flight: then some altitudes count from the ellipsoid and some from
 * the sea. Those that do not count from where their flight's do are none.
 *
 * Where altitudes are EXIF's or XMP's, the barometer's heights above take-off are used at their
 * level, the median difference, because they do not jump as those of satellites do; unless that
 * difference is not constant (the drone took off elsewhere, or was calibrated on the way), or a
 * photograph has none. If it is constant for XMP's and not for EXIF's, EXIF's jump: XMP's count.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "core/math/sort.h"
#include "scene/ingest/ingest.h"
#include "scene/ingest/ingest_internal.h"

enum { DRONE_LEAST = 5 }; /* photographs that tell which way is up */
/* Metres and share of photographs by which the barometer keeps its distance from EXIF. */
/* Altitudes that are the same but for rounding; and that contradict each other. */
static const double drone_same_m = 0.1, drone_apart_m = 10;
/* What is an altitude, and how low drones are believed to fly. */
static const double drone_least_m = -1000, drone_most_m = 20000, drone_low_m = -10;
static const double drone_keeps_m = 5, drone_keeps_share = 0.9, drone_deg = 57.29577951308232,
                    drone_spread_max_rad = 0.06;

static bool drone_counts(const struct ingest_photo *p, uint32_t flight)
{
    return p->verdict < INGEST_MISSING && p->geo.flight_hint == flight;
}

/* The altitude, or XMP's absolute one, minus the barometer's, of all that have both; their median,
 * and whether nearly all of the flight are near it. Of those apart the barometer is enough. */
static bool drone_level(const struct ingest *g, uint32_t flight, bool absolute, double *scratch,
                        double *level_m)
{
    size_t n = 0, all = 0, near = 0;
    for (size_t i = 0; i < g->n; i++) {
        const struct ingest_photo *p = &g->photos[i];
        if (!drone_counts(p, flight) || (p->apart && p->drone.has_relative))
            continue;
        all++;
        if (p->drone.has_relative && (absolute ? p->drone.has_absolute : p->gps.has_altitude))
            scratch[n++] = (absolute ? p->drone.absolute_m : p->gps.alt_m) - p->drone.relative_m;
    }
    if (!n)
        return false;
    *level_m = sort_median(scratch, n);
    for (size_t i = 0; i < n; i++)
        near += fabs(scratch[i] - *level_m) < drone_keeps_m;
    return n == all && (double)near >= drone_keeps_share * (double)all;
}

struct drone_sources {                                  /* of altitude in a flight */
    size_t n, rtk, ellipsoid, exif, absolute, relative; /* photographs that have it */
    size_t pairs;                                       /* with EXIF's and XMP's absolute */
    size_t below;                                       /* with EXIF's below the sea */
    size_t above;               /* with EXIF's above the ellipsoid, by RTK or EXIF */
    double exif_m, absolute_m;  /* their medians */
    double apart_m, mirrored_m; /* median distance of both, and of one from the other's negative */
    double spread_m[2]; /* of EXIF's minus the barometer's, and of its negative minus those */
    bool exif_flat, absolute_flat; /* they are heights above take-off */
};

static bool drone_same(double a, double b)
{
    return fabs(a - b) < drone_same_m;
}

/* Median distance of EXIF's altitudes times `sign` minus the barometer's from their median. */
static double drone_spread(const struct ingest *g, uint32_t flight, double sign, double *scratch)
{
    size_t n = 0;
    for (size_t i = 0; i < g->n; i++) {
        const struct ingest_photo *p = &g->photos[i];
        if (drone_counts(p, flight) && p->gps.has_altitude && p->drone.has_relative)
            scratch[n++] = sign * p->gps.alt_m - p->drone.relative_m;
    }
    const double middle = sort_median(scratch, n);
    for (size_t i = 0; i < n; i++)
        scratch[i] = fabs(scratch[i] - middle);
    return sort_median(scratch, n);
}

/* scratch [4 g->n]. */
static void drone_sources_find(const struct ingest *g, uint32_t flight, double *scratch,
                               struct drone_sources *s)
{
    size_t flat[2] = {0}, both[2] = {0};
    double *const v[] = {scratch, scratch + g->n, scratch + 2 * g->n, scratch + 3 * g->n};
    *s = (struct drone_sources){0};
    for (size_t i = 0; i < g->n; i++) {
        const struct ingest_photo *p = &g->photos[i];
        const struct drone_meta *d = &p->drone;
        const bool exif = p->gps.has_altitude;
        if (!drone_counts(p, flight))
            continue;
        s->n++;
        s->rtk += d->ellipsoidal && (d->has_absolute || exif);
        s->ellipsoid += exif && p->gps.ellipsoidal;
        s->exif += exif;
        s->above += exif && (p->gps.ellipsoidal || d->ellipsoidal);
        s->below += exif && p->gps.alt_m < 0;
        s->absolute += d->has_absolute;
        s->relative += d->has_relative;
        both[0] += exif && d->has_relative;
        flat[0] += exif && d->has_relative && drone_same(p->gps.alt_m, d->relative_m);
        both[1] += d->has_absolute && d->has_relative;
        flat[1] += d->has_absolute && d->has_relative && drone_same(d->absolute_m, d->relative_m);
        if (!exif || !d->has_absolute)
            continue;
        v[0][s->pairs] = p->gps.alt_m;
        v[1][s->pairs] = d->absolute_m;
        v[2][s->pairs] = fabs(p->gps.alt_m - d->absolute_m);
        v[3][s->pairs++] = fabs(p->gps.alt_m + d->absolute_m);
    }
    s->exif_m = sort_median(v[0], s->pairs);
    s->absolute_m = sort_median(v[1], s->pairs);
    s->apart_m = sort_median(v[2], s->pairs);
    s->mirrored_m = sort_median(v[3], s->pairs);
    s->spread_m[0] = drone_spread(g, flight, 1, scratch);
    s->spread_m[1] = drone_spread(g, flight, -1, scratch);
    s->exif_flat = both[0] && flat[0] == both[0];
    s->absolute_flat = both[1] && flat[1] == both[1];
}

/* Says both values when they contradict each other. */
static void drone_warn(uint32_t flight, const struct drone_sources *s, const char *counts)
{
    if (s->pairs && s->apart_m > drone_apart_m)
        log_warn("ingest",
                 "flight %u: the altitudes of EXIF and of XMP contradict each other: %.1f m and "
                 "%.1f m (medians): %s",
                 flight + 1, s->exif_m, s->absolute_m, counts);
}

/* By the table above. */
static enum ingest_altitude drone_choose(uint32_t flight, const struct drone_sources *s)
{
    const bool mirrored = s->pairs && s->mirrored_m < drone_apart_m && s->apart_m > drone_apart_m,
               exif = s->exif && !s->exif_flat && !(mirrored && !s->absolute_flat),
               absolute = s->absolute && !s->absolute_flat;
    if (2 * s->rtk > s->n && !s->absolute_flat) {
        drone_warn(flight, s, "XMP's count, by RTK");
        return INGEST_ALTITUDE_RTK;
    }
    if (2 * s->ellipsoid > s->n)
        return INGEST_ALTITUDE_EXIF_ELLIPSOID;
    if (exif && absolute)
        drone_warn(flight, s, "EXIF's count; if they are wrong, give --positions or --gcp");
    if (exif)
        return INGEST_ALTITUDE_EXIF;
    if (absolute)
        drone_warn(flight, s,
                   mirrored ? "XMP's count: EXIF's have the wrong sign"
                            : "XMP's count: EXIF's are above take-off");
    return absolute                                ? INGEST_ALTITUDE_XMP
           : s->exif || s->absolute || s->relative ? INGEST_ALTITUDE_TAKEOFF
                                                   : INGEST_ALTITUDE_NONE;
}

/* The altitude of one photograph by its flight's source; another one only if that is missing. */
static void drone_take(struct ingest_photo *p, enum ingest_altitude from, bool absolute)
{
    const struct drone_meta *d = &p->drone;
    const bool exif = p->gps.has_altitude;
    const double exif_m = p->gps.alt_m;
    p->altitude = from;
    p->gps.has_altitude = exif || (d->has_absolute && absolute) ||
                          (from == INGEST_ALTITUDE_TAKEOFF && d->has_relative);
    if (from == INGEST_ALTITUDE_TAKEOFF)
        p->gps.alt_m = d->has_relative ? d->relative_m : exif ? exif_m : d->absolute_m;
    else if (d->has_absolute && absolute &&
             (!exif || from == INGEST_ALTITUDE_RTK || from == INGEST_ALTITUDE_XMP))
        p->gps.alt_m = d->absolute_m;
    else if (from == INGEST_ALTITUDE_XMP)
        p->gps.has_altitude = false;
}

/* XMP's absolute altitude minus the barometer's height, median of the flight's photographs by RTK;
 * NaN: none has both. */
static double drone_rtk_level(const struct ingest *g, uint32_t flight, double *scratch)
{
    size_t n = 0;
    for (size_t i = 0; i < g->n; i++) {
        const struct drone_meta *d = &g->photos[i].drone;
        if (drone_counts(&g->photos[i], flight) && d->ellipsoidal && d->has_absolute &&
            d->has_relative)
            scratch[n++] = d->absolute_m - d->relative_m;
    }
    return n ? sort_median(scratch, n) : (double)NAN;
}

/* Whether the altitude has another reference than those of the flight. Where most of the flight's
 * are by RTK and EXIF's count all the same, they are alike. EXIF's that is far from RTK's is not by
 * RTK. Without a flag of RTK, what keeps RTK's level above the barometer is alike. */
static bool drone_apart(const struct ingest_photo *p, enum ingest_altitude from,
                        const struct drone_sources *s, double rtk_level_m)
{
    const struct drone_meta *d = &p->drone;
    if (from == INGEST_ALTITUDE_RTK && !d->ellipsoidal && d->has_absolute && d->has_relative &&
        fabs(d->absolute_m - d->relative_m - rtk_level_m) < drone_apart_m)
        return false;
    const bool rtk = d->ellipsoidal, far = p->gps.has_altitude && d->has_absolute &&
                                           fabs(p->gps.alt_m - d->absolute_m) > drone_apart_m;
    return from == INGEST_ALTITUDE_RTK              ? !rtk
           : from == INGEST_ALTITUDE_EXIF_ELLIPSOID ? !rtk && !p->gps.ellipsoidal
           : from == INGEST_ALTITUDE_EXIF
               ? 2 * s->above <= s->exif && (p->gps.ellipsoidal || (rtk && !far))
           : from == INGEST_ALTITUDE_XMP ? 2 * s->rtk <= s->absolute && rtk
                                         : false;
}

/* All photographs of a flight by one source, at whose level the barometer counts if it keeps its
 * distance. Returns whether it does. */
static bool drone_use(struct ingest *g, uint32_t flight, enum ingest_altitude from,
                      const struct drone_sources *s, double *scratch)
{
    double level_m = 0;
    const double rtk_level_m = drone_rtk_level(g, flight, scratch);
    for (size_t i = 0; i < g->n; i++) {
        struct ingest_photo *p = &g->photos[i];
        if (!drone_counts(p, flight))
            continue;
        const bool apart = drone_apart(p, from, s, rtk_level_m);
        drone_take(p, from, !s->absolute_flat || from >= INGEST_ALTITUDE_TAKEOFF);
        p->apart = apart && p->gps.has_altitude;
        p->gps.has_altitude = p->gps.has_altitude && !apart;
    }
    if ((from != INGEST_ALTITUDE_EXIF && from != INGEST_ALTITUDE_XMP) ||
        !drone_level(g, flight, false, scratch, &level_m))
        return false;
    for (size_t i = 0; i < g->n; i++)
        if (drone_counts(&g->photos[i], flight)) {
            g->photos[i].gps.has_altitude = true;
            g->photos[i].apart = false;
            g->photos[i].gps.alt_m = level_m + g->photos[i].drone.relative_m;
            g->photos[i].altitude = INGEST_ALTITUDE_BAROMETER;
        }
    return true;
}

static void drone_say_apart(const struct ingest *g, uint32_t flight, enum ingest_altitude from)
{
    const struct ingest_photo *first = NULL;
    size_t n = 0, all = 0;
    for (size_t i = 0; i < g->n; i++) {
        const struct ingest_photo *p = &g->photos[i];
        if (!drone_counts(p, flight))
            continue;
        first = first || !p->apart ? first : p;
        n += p->apart;
        all++;
    }
    if (n && !g->positions && !g->gcps)
        log_warn("ingest",
                 "flight %u: %zu of %zu photographs %s, '%s' first: their altitudes have another "
                 "reference than the others', so their positions do not count; the photographs "
                 "stay",
                 flight + 1, n, all,
                 from == INGEST_ALTITUDE_RTK              ? "lost RTK"
                 : from == INGEST_ALTITUDE_EXIF_ELLIPSOID ? "do not count from the ellipsoid"
                                                          : "count from the ellipsoid",
                 first->image->name);
}

/* A firmware that says "below the sea": with the other sign EXIF's altitudes follow the barometer.
 */
static void drone_turn(struct ingest *g, uint32_t flight, struct drone_sources *s, double *scratch)
{
    if (s->absolute > 0 && !s->absolute_flat) /* drone_choose sees it */
        return;
    if (s->below < s->exif || !(s->spread_m[0] > 1 && s->spread_m[1] < s->spread_m[0] / 3))
        return;
    log_warn("ingest",
             "flight %u: EXIF's altitudes have the wrong sign: with the other one they keep their "
             "distance from the heights above take-off",
             flight + 1);
    for (size_t i = 0; i < g->n; i++)
        if (drone_counts(&g->photos[i], flight))
            g->photos[i].gps.alt_m = -g->photos[i].gps.alt_m;
    drone_sources_find(g, flight, scratch, s);
}

/* Altitudes that are hardly what they say. */
static void drone_doubt(const struct ingest *g, uint32_t flight, double *scratch)
{
    size_t n = 0;
    for (size_t i = 0; i < g->n; i++) {
        const struct ingest_photo *p = &g->photos[i];
        if (drone_counts(p, flight) && p->gps.has_altitude &&
            (p->altitude == INGEST_ALTITUDE_EXIF || p->altitude == INGEST_ALTITUDE_XMP))
            scratch[n++] = p->gps.alt_m;
    }
    const double middle_m = sort_median(scratch, n);
    size_t same = 0;
    for (size_t i = 0; i < n; i++)
        same += scratch[i] == middle_m;
    if (n && middle_m < drone_low_m)
        log_warn(
            "ingest",
            "flight %u: the altitudes lie below the sea, at %.1f m (median): if the place does "
            "not, their sign is wrong: give --positions or --gcp",
            flight + 1, middle_m);
    if (same >= DRONE_LEAST && same == n)
        log_warn("ingest",
                 "flight %u: all %zu altitudes are %.1f m: if that is no measurement, heights and "
                 "tilt are wrong: give --positions or --gcp",
                 flight + 1, n, middle_m);
}

static void drone_flight(struct ingest *g, uint32_t flight, double *scratch)
{
    struct drone_sources s;
    drone_sources_find(g, flight, scratch, &s);
    if (!s.n)
        return;
    drone_turn(g, flight, &s, scratch);
    const enum ingest_altitude from = drone_choose(flight, &s);
    const bool level = drone_use(g, flight, from, &s, scratch);
    if (level || from != INGEST_ALTITUDE_EXIF || s.relative < s.n) {
        drone_say_apart(g, flight, from);
        return;
    }
    /* EXIF's jump against the barometer. Do XMP's? */
    double level_m;
    const bool keeps =
        s.absolute == s.n && !s.absolute_flat && drone_level(g, flight, true, scratch, &level_m);
    if (keeps)
        (void)drone_use(g, flight, INGEST_ALTITUDE_XMP, &s, scratch);
    drone_say_apart(g, flight, from);
    if (s.exif == s.n)
        log_warn("ingest",
                 "flight %u: heights above take-off and EXIF's altitudes do not keep their "
                 "distance: %s count",
                 flight + 1, keeps ? "XMP's" : "EXIF's");
}

/* Barometers of which all stand at 0 tell nothing. */
static void drone_forget_barometer(struct ingest *g, uint32_t flight)
{
    for (size_t i = 0; i < g->n; i++)
        if (drone_counts(&g->photos[i], flight) && g->photos[i].drone.has_relative &&
            g->photos[i].drone.relative_m != 0)
            return;
    for (size_t i = 0; i < g->n; i++)
        if (drone_counts(&g->photos[i], flight))
            g->photos[i].drone.has_relative = false;
}

/* Altitudes that no drone reaches are none: -9999, 32767 and their like. */
static void drone_forget_far(struct ingest *g)
{
    const struct ingest_photo *first = NULL;
    size_t n = 0;
    for (size_t i = 0; i < g->n; i++) {
        struct ingest_photo *p = &g->photos[i];
        if (!p->gps.has_altitude || (p->gps.alt_m > drone_least_m && p->gps.alt_m < drone_most_m))
            continue;
        p->gps.has_altitude = false;
        first = first ? first : p;
        n++;
    }
    if (n)
        log_warn("ingest",
                 "%zu photographs have an altitude in EXIF that is none, '%s' first: %.1f m", n,
                 first->image->name, first->gps.alt_m);
}

/* Altitudes of 0 are none; which photographs had one is kept in `zero`. */
static size_t drone_forget_zeros(struct ingest *g, bool *zero)
{
    size_t n = 0;
    for (size_t i = 0; i < g->n; i++) {
        struct ingest_photo *p = &g->photos[i];
        zero[i] = p->verdict < INGEST_MISSING && p->gps.has_altitude && p->gps.alt_m == 0;
        p->gps.has_altitude = p->gps.has_altitude && !zero[i];
        n += zero[i];
    }
    return n;
}

/* n of them. Nothing else may give them an altitude: all of them, or some among others. */
static void drone_settle_zeros(struct ingest *g, const bool *zero, size_t n)
{
    size_t lost = 0, known = 0;
    const char *first = NULL;
    for (size_t i = 0; i < g->n; i++) {
        const bool here = zero[i] && !g->photos[i].gps.has_altitude;
        known += g->photos[i].gps.has_altitude;
        first = first || !here ? first : g->photos[i].image->name;
        lost += here;
    }
    if (known && n > lost)
        log_warn("ingest",
                 "%zu photographs have the altitude 0 in EXIF, which is none: XMP's count",
                 n - lost);
    if (known && lost)
        log_warn("ingest",
                 "%zu photographs have the altitude 0, '%s' first, which is none: their positions "
                 "do not count",
                 lost, first);
    if (known)
        return;
    log_warn("ingest",
             "all altitudes are 0: heights are not known. They are taken as equal, and the scene's "
             "mean nothing: give --positions or --gcp");
    for (size_t i = 0; i < g->n; i++)
        if (zero[i]) {
            g->photos[i].gps.has_altitude = true;
            g->photos[i].altitude = INGEST_ALTITUDE_NONE;
        }
}

/* Positions without an altitude, of some photographs or of all. */
static void drone_settle_absent(struct ingest *g)
{
    size_t known = 0, absent = 0;
    const char *first = NULL;
    for (size_t i = 0; i < g->n; i++) {
        const struct image_gps *x = &g->photos[i].gps;
        known += x->has_altitude;
        const bool here = x->has_position && !x->has_altitude && !g->photos[i].apart;
        absent += here;
        first = first || !here ? first : g->photos[i].image->name;
    }
    if (!absent || g->positions || g->gcps)
        return;
    if (known) {
        log_warn("ingest",
                 "%zu photographs have a position without an altitude, '%s' first: it does not "
                 "count",
                 absent, first);
        return;
    }
    log_warn("ingest",
             "no photograph has an altitude: heights are not known. They are taken as equal, and "
             "the scene's mean nothing: give --positions or --gcp");
    for (size_t i = 0; i < g->n; i++)
        if (g->photos[i].gps.has_position) {
            g->photos[i].gps.has_altitude = true;
            g->photos[i].gps.alt_m = 0;
            g->photos[i].altitude = INGEST_ALTITUDE_NONE;
        }
}

enum err_code ingest_drone_heights(struct ingest *g, struct err *e)
{
    double *scratch = mem_array(g->n, 4 * sizeof *scratch);
    bool *zero = mem_array(g->n, sizeof *zero);
    uint32_t last = 0;
    enum err_code rc = scratch && zero
                           ? ERR_OK
                           : err_set(e, ERR_MEM, "ingest: out of memory for %zu photographs", g->n);
    for (size_t i = 0; i < g->n; i++)
        last = g->photos[i].geo.flight_hint > last ? g->photos[i].geo.flight_hint : last;
    if (!rc)
        drone_forget_far(g);
    const size_t zeros = rc ? 0 : drone_forget_zeros(g, zero);
    for (uint32_t flight = 0; !rc && g->cfg->altitude == INGEST_AUTO && flight <= last; flight++) {
        drone_forget_barometer(g, flight);
        drone_flight(g, flight, scratch);
        drone_doubt(g, flight, scratch);
    }
    if (zeros)
        drone_settle_zeros(g, zero, zeros);
    else if (!rc)
        drone_settle_absent(g);
    mem_free(scratch);
    mem_free(zero);
    return rc;
}

/* ---- which way is up ---- */

static void drone_unit(double v[3])
{
    double len = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    for (size_t k = 0; len > 0 && k < 3; k++)
        v[k] /= len;
}

static double drone_angle(const double a[3], const double b[3])
{
    const double c[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
                         a[0] * b[1] - a[1] * b[0]};
    return atan2(sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]),
                 a[0] * b[0] + a[1] * b[1] + a[2] * b[2]);
}

/* The mean of the directions [n] without those that lie far from it. */
static void drone_mean(const double (*v)[3], size_t n, double *scratch, struct ingest_gimbal *out)
{
    double limit = HUGE_VAL;
    for (int round = 0; round < 5; round++) {
        double sum[3] = {0};
        out->used = 0;
        for (size_t i = 0; i < n; i++) {
            if (round && drone_angle(v[i], out->up) > limit)
                continue;
            for (size_t k = 0; k < 3; k++)
                sum[k] += v[i][k];
            out->used++;
        }
        drone_unit(sum);
        memcpy(out->up, sum, sizeof sum);
        for (size_t i = 0; i < n; i++)
            scratch[i] = drone_angle(v[i], out->up);
        out->spread_rad = sort_median(scratch, n);
        limit = fmax(3 * out->spread_rad, 1 / drone_deg);
    }
}

/* Up by each photograph that is kept, in COLMAP's frame; returns how many tell it. */
static size_t drone_list(const struct ingest *g, double (*v)[3])
{
    size_t n = 0;
    for (size_t i = 0; i < g->n; i++) {
        const struct ingest_photo *p = &g->photos[i];
        if (p->verdict != INGEST_KEPT || !p->drone.has_up)
            continue;
        for (size_t k = 0; k < 3; k++)
            v[n][k] = p->geo.rot[k] * p->drone.up_cam[0] + p->geo.rot[3 + k] * p->drone.up_cam[1] +
                      p->geo.rot[6 + k] * p->drone.up_cam[2];
        n++;
    }
    return n;
}

enum err_code ingest_drone_up(const struct ingest *g, struct ingest_gimbal *out, struct err *e)
{
    *out = (struct ingest_gimbal){0};
    if (!g->cfg->gimbal)
        return ERR_OK;
    double(*v)[3] = mem_array(g->n, sizeof *v), *scratch = mem_array(g->n, sizeof *scratch);
    bool room = v && scratch;
    out->n = room ? drone_list(g, v) : 0;
    if (out->n >= DRONE_LEAST)
        drone_mean((const double(*)[3])v, out->n, scratch, out);
    out->known = out->n >= DRONE_LEAST && out->spread_rad < drone_spread_max_rad;
    if (out->n >= DRONE_LEAST && !out->known)
        log_warn("ingest",
                 "%zu photographs tell the tilt of their gimbals, which differ from the poses by "
                 "%.1f deg among themselves: not used",
                 out->n, drone_deg * out->spread_rad);
    mem_free(v);
    mem_free(scratch);
    return room ? ERR_OK : err_set(e, ERR_MEM, "ingest: out of memory for %zu photographs", g->n);
}

void ingest_drone_check(const struct sim3 *sim, struct ingest_gimbal *io)
{
    static const double z[3] = {0, 0, 1};
    double up[3];
    for (size_t r = 0; r < 3; r++)
        up[r] = sim->rot[3 * r] * io->up[0] + sim->rot[3 * r + 1] * io->up[1] +
                sim->rot[3 * r + 2] * io->up[2];
    io->tilt_rad = drone_angle(up, z);
    io->east_rad = atan2(up[0], up[2]);
    io->north_rad = atan2(up[1], up[2]);
}
