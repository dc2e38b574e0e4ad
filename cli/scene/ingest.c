/* citysplat ingest: photographs and COLMAP poses to a scene in metres.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/ingest/ingest.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "cli/base/cli.h"
#include "cli/scene/control.h"
#include "core/geo/heights.h"
#include "scene/control/gcp_read.h"
#include "scene/control/positions.h"
#include "survey/crs.h"

/* Is it a vertical system? */
static enum err_code ingest_check_heights(int epsg, struct err *e)
{
    struct crs *crs = NULL;
    if (epsg == CRS_ELLIPSOIDAL)
        return ERR_OK;
    enum err_code rc = crs_open(32632, &crs, e);
    if (!rc)
        rc = crs_set_vertical(crs, epsg, e);
    crs_close(&crs);
    return rc;
}

static enum err_code ingest_read_gcps(const struct ingest_config *cfg, struct gcp_list *l,
                                      struct err *e)
{
    enum err_code rc = gcp_read(cfg->gcp, l, e);
    if (!rc && cfg->check)
        rc = gcp_keep_out(l, cfg->check, e);
    if (!rc)
        rc = control_unproject(cfg->gcp, (int)cfg->gcp_epsg, l, e);
    if (!rc && l->heights_epsg && !cfg->heights) {
        rc = ingest_check_heights(l->heights_epsg, e);
        if (rc)
            err_add(e, "%s", cfg->gcp);
    }
    return rc;
}

/* Opens the system of positions; *crs is NULL for WGS 84. Heights that it says, in its code or
 * beside it, become those of p. */
static enum err_code ingest_open_system(const struct ingest_config *cfg, struct positions *p,
                                        int epsg, struct crs **crs, struct err *e)
{
    int heights = !strcmp(p->heights, "ellipsoid") ? CRS_ELLIPSOIDAL : heights_epsg(p->heights);
    enum err_code rc = crs_split(&epsg, &heights, e);
    if (!rc && heights && !cfg->heights)
        rc = ingest_check_heights(heights, e);
    if (!rc && heights == CRS_ELLIPSOIDAL)
        snprintf(p->heights, sizeof p->heights, "ellipsoid");
    else if (!rc && heights)
        snprintf(p->heights, sizeof p->heights, "EPSG:%d", heights);
    if (!rc && epsg != POSITIONS_LONLAT)
        rc = crs_open_places(epsg, crs, e);
    if (rc)
        err_add(e, "%s", cfg->positions);
    return rc;
}

/* Positions of photographs in longitude and latitude. */
static enum err_code ingest_read_positions(const struct ingest_config *cfg, struct positions *p,
                                           struct err *e)
{
    struct crs *crs = NULL;
    enum err_code rc = positions_read(cfg->positions, p, e);
    int epsg = cfg->positions_epsg ? (int)cfg->positions_epsg : p->epsg;
    if (!rc && !epsg)
        rc = err_set(e, ERR_ARG,
                     "%s: the columns are not longitude and latitude: give their system with "
                     "--positions-epsg CODE",
                     cfg->positions);
    if (!rc)
        rc = ingest_open_system(cfg, p, epsg, &crs, e);
    for (size_t i = 0; !rc && i < p->n; i++) {
        double *at = p->list[i].at;
        if ((!crs || crs_is_degrees(crs)) && !(fabs(at[0]) <= 180 && fabs(at[1]) <= 90))
            rc = err_set(e, ERR_ARG, "%.9g %.9g is no longitude and latitude", at[0], at[1]);
        else if (crs)
            rc = control_unproject_place(crs, &at[0], &at[1], e);
        if (rc)
            err_add(e, "%s: line %zu", cfg->positions, p->list[i].line);
    }
    crs_close(&crs);
    return rc;
}

enum err_code cli_ingest(int argc, char **argv, struct err *e)
{
    struct arena a = {0};
    struct ingest_config cfg;
    struct options_args args;
    struct gcp_list gcps = {0};
    struct positions positions = {0};
    enum err_code rc = options_parse(ingest_options(), argc, argv, &cfg, &args, &a, e);
    bool run = !rc && !args.done;
    if (run && !cfg.gcp && (cfg.check || cfg.gcp_epsg))
        rc = err_set(e, ERR_ARG, "ingest: --check and --gcp-epsg belong to --gcp FILE");
    if (run && !rc && cfg.heights && heights_epsg(cfg.heights)) {
        rc = ingest_check_heights(heights_epsg(cfg.heights), e);
        if (rc)
            err_add(e, "--heights");
    }
    if (run && !rc && cfg.gcp)
        rc = ingest_read_gcps(&cfg, &gcps, e);
    if (run && !rc && cfg.positions)
        rc = ingest_read_positions(&cfg, &positions, e);
    if (run && !rc) {
        signals_catch();
        rc = ingest_run_with(args.arg[0], args.arg[1], &cfg, cfg.gcp ? &gcps : NULL,
                             cfg.positions ? &positions : NULL, e);
    }
    gcp_free(&gcps);
    positions_free(&positions);
    arena_free(&a);
    return rc;
}
