/* citysplat ingest: photographs and COLMAP poses to a scene in metres.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "ingest/ingest.h"
#include "cli/cli.h"
#include "ingest/gcp.h"
#include "survey/crs.h"

/* One place, by a system that is named only now; its errors are answers. */
static enum err_code ingest_unproject(int epsg, double *x, double *y, struct err *e)
{
    struct crs *crs = NULL;
    enum err_code rc = crs_open(epsg, &crs, e);
    if (!rc)
        rc = crs_unproject(crs, 1, x, y, e);
    crs_close(&crs);
    return rc;
}

/* A system that is used elsewhere on Earth is the wrong one, or x and y are swapped. */
static void ingest_check_area(const struct crs *crs, const struct gcp *g)
{
    double off_deg = crs_outside_deg(crs, g->at[0], g->at[1]);
    if (off_deg > 3)
        log_warn("ingest",
                 "line %zu: ground control point %s lies %.0f degrees outside of where EPSG:%d is "
                 "used: another zone, x and y swapped, or feet?",
                 g->line, g->name, off_deg, crs_epsg(crs));
}

/* Ground control points in longitude and latitude, by PROJ where the file has them projected. */
static enum err_code ingest_read_gcps(const struct ingest_config *cfg, struct gcp_list *l,
                                      struct err *e)
{
    struct crs *crs = NULL;
    enum err_code rc = gcp_read(cfg->gcp, l, e);
    int epsg = cfg->gcp_epsg ? (int)cfg->gcp_epsg : l->epsg;
    if (!rc && cfg->check)
        rc = gcp_keep_out(l, cfg->check, e);
    if (!rc && !epsg)
        rc = err_set(e, ERR_ARG,
                     "%s: does not say its coordinate system in words known here: give it with "
                     "--gcp-epsg CODE, e.g. 32632, or 4326 for longitude and latitude",
                     cfg->gcp);
    if (!rc && epsg != GCP_LONLAT)
        rc = crs_open(epsg, &crs, e);
    for (size_t i = 0; !rc && crs && i < l->n; i++) {
        struct gcp *g = &l->gcps[i];
        rc = crs_unproject(crs, 1, &g->at[0], &g->at[1], e);
        if (rc)
            err_add(e,
                    "%s: line %zu: ground control point %s (x and y swapped, feet, or "
                    "millimetres?)",
                    cfg->gcp, g->line, g->name);
        else
            ingest_check_area(crs, g);
    }
    l->epsg = epsg;
    l->unproject = ingest_unproject;
    crs_close(&crs);
    return rc;
}

enum err_code cli_ingest(int argc, char **argv, struct err *e)
{
    struct arena a = {0};
    struct ingest_config cfg;
    struct options_args args;
    struct gcp_list gcps = {0};
    enum err_code rc = options_parse(ingest_options(), argc, argv, &cfg, &args, &a, e);
    bool run = !rc && !args.done;
    if (run && !cfg.gcp && (cfg.check || cfg.gcp_epsg))
        rc = err_set(e, ERR_ARG, "ingest: --check and --gcp-epsg belong to --gcp FILE");
    if (run && !rc && cfg.gcp)
        rc = ingest_read_gcps(&cfg, &gcps, e);
    if (run && !rc) {
        signals_catch();
        rc = ingest_run_gcp(args.arg[0], args.arg[1], &cfg, cfg.gcp ? &gcps : NULL, e);
    }
    gcp_free(&gcps);
    arena_free(&a);
    return rc;
}
