/* Data of drones about their photographs (codec/drone.h): the altitude to use, and the direction up
 * by their gimbals.
 *
 * Altitudes: if most photographs of a flight have positions resolved by RTK, their absolute
 * altitudes are used, which are above the ellipsoid. In other flights the barometer's heights above
 * take-off are used, because they do not jump as those of satellites do. Their level is the median
 * difference to EXIF's altitudes. EXIF's altitudes are used where that difference is not constant
 * (the drone took off elsewhere, or was calibrated on the way), and for photographs without
 * barometer.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "core/sort.h"
#include "ingest/ingest.h"
#include "ingest/ingest_internal.h"

enum { DRONE_LEAST = 5 }; /* photographs that tell which way is up */
/* Metres and share of photographs by which the barometer keeps its distance from EXIF. */
static const double drone_keeps_m = 5, drone_keeps_share = 0.9, drone_deg = 57.29577951308232,
                    drone_spread_max_rad = 0.06;

static bool drone_counts(const struct ingest_photo *p, uint32_t flight)
{
    return p->verdict != INGEST_MISSING && p->geo.flight_hint == flight;
}

/* EXIF's altitude minus the barometer's, of all that have both; their median, and whether nearly
 * all of the flight are near it. */
static bool drone_level(const struct ingest *g, uint32_t flight, double *scratch, double *level_m)
{
    size_t n = 0, all = 0, near = 0;
    for (size_t i = 0; i < g->n; i++) {
        const struct ingest_photo *p = &g->photos[i];
        if (!drone_counts(p, flight))
            continue;
        all++;
        if (p->drone.has_relative && p->gps.has_altitude)
            scratch[n++] = p->gps.alt_m - p->drone.relative_m;
    }
    if (!n)
        return false;
    *level_m = sort_median(scratch, n);
    for (size_t i = 0; i < n; i++)
        near += fabs(scratch[i] - *level_m) < drone_keeps_m;
    if (n == all && (double)near < drone_keeps_share * (double)all)
        log_warn("ingest",
                 "flight %u: heights above take-off and EXIF's altitudes do not keep their "
                 "distance: EXIF's count",
                 flight + 1);
    return n == all && (double)near >= drone_keeps_share * (double)all;
}

static void drone_flight(struct ingest *g, uint32_t flight, double *scratch)
{
    size_t all = 0, rtk = 0;
    double level_m = 0;
    for (size_t i = 0; i < g->n; i++) {
        const struct ingest_photo *p = &g->photos[i];
        if (!drone_counts(p, flight))
            continue;
        all++;
        rtk += p->drone.ellipsoidal && (p->drone.has_absolute || p->gps.has_altitude);
    }
    bool by_rtk = 2 * rtk > all,
         by_barometer = !by_rtk && drone_level(g, flight, scratch, &level_m);
    for (size_t i = 0; i < g->n; i++) {
        struct ingest_photo *p = &g->photos[i];
        if (!drone_counts(p, flight))
            continue;
        if (by_rtk && p->drone.has_absolute) {
            p->gps.alt_m = p->drone.absolute_m;
            p->gps.has_altitude = true;
        }
        if (by_barometer)
            p->gps.alt_m = level_m + p->drone.relative_m;
        p->altitude = by_rtk         ? INGEST_ALTITUDE_RTK
                      : by_barometer ? INGEST_ALTITUDE_BAROMETER
                                     : INGEST_ALTITUDE_EXIF;
    }
}

enum err_code ingest_drone_heights(struct ingest *g, struct err *e)
{
    double *scratch = mem_array(g->n, sizeof *scratch);
    uint32_t last = 0;
    if (!scratch)
        return err_set(e, ERR_MEM, "ingest: out of memory for %zu photographs", g->n);
    for (size_t i = 0; i < g->n; i++)
        last = g->photos[i].geo.flight_hint > last ? g->photos[i].geo.flight_hint : last;
    for (uint32_t flight = 0; g->cfg->altitude == INGEST_AUTO && flight <= last; flight++)
        drone_flight(g, flight, scratch);
    mem_free(scratch);
    return ERR_OK;
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
