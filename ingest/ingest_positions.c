/* Positions of photographs by a file instead of EXIF: see positions.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "ingest/ingest.h"
#include "ingest/ingest_internal.h"

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
    if (!g->positions)
        return ERR_OK;
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
