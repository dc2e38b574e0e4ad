/* The reference of heights. EXIF's heights are above sea level, by a geoid that is not stated.
 * Those of RTK are above the ellipsoid. Those of ground control points are as the user says. With
 * --geoid, heights above sea level become ellipsoidal, place by place. Without it they stay as they
 * are, and the scene states that. Nothing is called ellipsoidal that is not.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "scene/ingest/ingest.h"
#include "scene/ingest/ingest_internal.h"

enum { HEIGHTS_3D = 4979 };           /* WGS 84 with ellipsoidal heights */
enum { HEIGHTS_GROUND_NONE = -1000 }; /* --ground-h: not given */

/* What heights of ground control points count from, before a geoid is applied. */
static void heights_of_gcps(const struct ingest *g, char out[HEIGHTS_MAX])
{
    const char *said = g->cfg->heights;
    int epsg = said ? heights_epsg(said) : g->gcps->heights_epsg;
    if (epsg == HEIGHTS_3D || (!said && !epsg && g->cfg->geoid_offset_m != 0))
        snprintf(out, HEIGHTS_MAX, "ellipsoid");
    else if (epsg)
        snprintf(out, HEIGHTS_MAX, "EPSG:%d", epsg);
    else
        snprintf(out, HEIGHTS_MAX, "%s", said ? said : "unknown");
}

enum err_code ingest_heights_open(struct ingest *g, struct err *e)
{
    const struct ingest_config *c = g->cfg;
    char of_gcps[HEIGHTS_MAX];
    if (c->heights && strcmp(c->heights, "ellipsoid") && strcmp(c->heights, "sea") &&
        !heights_epsg(c->heights))
        return err_set(e, ERR_ARG, "--heights: '%.40s': expected is ellipsoid, sea or EPSG:CODE",
                       c->heights);
    if (c->heights && !g->gcps && !g->positions)
        return err_set(e, ERR_ARG,
                       "--heights says what ground control points, or positions, count from: it "
                       "belongs to --gcp or --positions");
    if (c->geoid && c->geoid_offset_m != 0)
        return err_set(e, ERR_ARG,
                       "--geoid and --geoid-offset-m both make heights ellipsoidal: give one");
    if (!c->geoid)
        return ERR_OK;
    if (g->gcps) {
        heights_of_gcps(g, of_gcps);
        if (!strcmp(of_gcps, "unknown"))
            return err_set(e, ERR_ARG,
                           "--geoid: say what the heights of the ground control points count from: "
                           "--heights sea, or --heights ellipsoid");
        g->gcps_of_sea = !heights_ellipsoidal(of_gcps);
    }
    return geoid_open(c->geoid, &g->geoid, e);
}

/* Grids end somewhere. */
enum err_code ingest_heights_check(const struct ingest *g, struct err *e)
{
    for (size_t i = 0; g->geoid && i < g->n; i++) {
        const struct image_gps *p = &g->photos[i].gps;
        if (p->has_position && !isfinite(geoid_above(g->geoid, p->lon_deg, p->lat_deg)))
            return err_set(e, ERR_ARG, "--geoid %s: it does not reach %s at %.6f,%.6f",
                           g->cfg->geoid, g->photos[i].image->name, p->lon_deg, p->lat_deg);
    }
    return ERR_OK;
}

/* What heights of the positions' file count from. */
static void heights_of_positions(const struct ingest *g, char out[HEIGHTS_MAX])
{
    const char *said = g->cfg->heights && !g->gcps ? g->cfg->heights : g->positions->heights;
    int epsg = heights_epsg(said);
    if (epsg == HEIGHTS_3D ||
        (!strcmp(said, "unknown") && !g->geoid && g->cfg->geoid_offset_m != 0))
        said = "ellipsoid";
    snprintf(out, HEIGHTS_MAX, "%s", said);
}

/* --ground-h: the height of the place of take-off. */
static bool heights_ground_known(const struct ingest *g)
{
    return g->cfg->ground_h > HEIGHTS_GROUND_NONE;
}

double ingest_heights_photo_m(const struct ingest *g, const struct ingest_photo *p)
{
    char said[HEIGHTS_MAX];
    if (p->altitude == INGEST_ALTITUDE_RTK || p->altitude == INGEST_ALTITUDE_EXIF_ELLIPSOID)
        return p->gps.alt_m;
    if (p->altitude == INGEST_ALTITUDE_TAKEOFF && !heights_ground_known(g))
        return p->gps.alt_m; /* no geoid makes it anything else */
    const double alt_m =
        p->gps.alt_m + (p->altitude == INGEST_ALTITUDE_TAKEOFF ? g->cfg->ground_h : 0);
    if (p->altitude == INGEST_ALTITUDE_FILE) {
        heights_of_positions(g, said);
        if (heights_ellipsoidal(said))
            return p->gps.alt_m;
    }
    return alt_m + (g->geoid ? geoid_above(g->geoid, p->gps.lon_deg, p->gps.lat_deg)
                             : g->cfg->geoid_offset_m);
}

void ingest_heights_name(struct ingest *g)
{
    size_t n[INGEST_ALTITUDES] = {0};
    char *out = g->scene.heights;
    bool moved = g->geoid || g->cfg->geoid_offset_m != 0;
    if (g->gcps) {
        heights_of_gcps(g, out);
        if (g->gcps_of_sea)
            snprintf(out, HEIGHTS_MAX, "ellipsoid");
        return;
    }
    if (g->positions && g->fitted) {
        heights_of_positions(g, out);
        if (g->geoid && !heights_ellipsoidal(out))
            snprintf(out, HEIGHTS_MAX, "ellipsoid");
        return;
    }
    for (size_t i = 0; i < g->n; i++)
        if (g->photos[i].verdict == INGEST_KEPT && g->photos[i].geo.has_gps)
            n[g->photos[i].altitude]++;
    const size_t takeoff = n[INGEST_ALTITUDE_TAKEOFF], none = n[INGEST_ALTITUDE_NONE],
                 sea = n[INGEST_ALTITUDE_EXIF] + n[INGEST_ALTITUDE_BAROMETER] +
                       n[INGEST_ALTITUDE_XMP] + (heights_ground_known(g) ? takeoff : 0),
                 rtk = n[INGEST_ALTITUDE_RTK] + n[INGEST_ALTITUDE_EXIF_ELLIPSOID];
    const bool mixed = sea && rtk && !moved, low = takeoff && !heights_ground_known(g);
    if (mixed && g->fitted)
        log_warn("ingest",
                 "%zu heights count from the ellipsoid and %zu from the sea (EXIF): give "
                 "--geoid NAME",
                 rtk, sea);
    if (low && g->fitted)
        log_warn("ingest",
                 "%zu altitudes are heights above the place of take-off%s: say its height above "
                 "the sea by --ground-h, or give --gcp or --positions",
                 takeoff, sea || rtk ? ", the others are not" : "");
    if (heights_ground_known(g) && !takeoff)
        log_warn("ingest", "--ground-h: no altitude counts from the place of take-off: it changes "
                           "nothing");
    /* --origin without GPS is ellipsoidal, by what it is documented to be. */
    snprintf(out, HEIGHTS_MAX, "%s",
             !g->fitted && !g->scaled                    ? "unscaled"
             : !g->fitted                                ? g->cfg->origin ? "ellipsoid" : "unknown"
             : none || mixed || (low && (sea || rtk))    ? "unknown"
             : low                                       ? "takeoff"
             : moved || !sea                             ? "ellipsoid"
             : heights_ground_known(g) && takeoff == sea ? "sea"
                                                         : "sea-exif");
}
