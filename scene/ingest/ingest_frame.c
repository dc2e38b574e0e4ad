/* Where the scene lies: by GPS if enough photographs have it, else by options.
 *
 * The fit uses a frame about the median GPS position. Then the origin moves to the middle of the
 * kept photographs, at the height of the median point, so the ground is near z = 0. EXIF altitudes
 * are used as they are, unless --geoid or --geoid-offset-m makes them ellipsoidal; no height is
 * guessed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/image/image.h"
#include "codec/scene/colmap.h"
#include "core/math/sort.h"
#include "scene/ingest/ingest.h"
#include "scene/ingest/ingest_internal.h"

/* A gimbal knows which way is down to a degree. */
static const double reliable_px = 2, inlier_m = 8, gimbal_sigma = 0.02;
static const double flight_units = 100; /* height of a flight whose metres are not known */
enum { RELIABLE_TRACK = 3, HEIGHT_SAMPLES = 200000, GPS_LEAST = 3 };

static enum err_code frame_no_memory(struct err *e)
{
    return err_set(e, ERR_MEM, "ingest: out of memory");
}

enum err_code ingest_frame_parse(const char *text, struct geo_origin *o, struct err *e)
{
    double v[3] = {0};
    const bool good = number_list(text, 3, v);
    *o = (struct geo_origin){v[0], v[1], v[2]};
    if (!good || !(fabs(o->lon_deg) <= 180) || !(fabs(o->lat_deg) <= 90) || !(fabs(o->h_m) < 1e5))
        return err_set(e, ERR_ARG, "--origin: '%.80s' is not LON,LAT,H in degrees and metres",
                       text);
    return ERR_OK;
}

static bool frame_gps_usable(const struct image_gps *g)
{
    return g->has_position && g->has_altitude && isfinite(g->alt_m) && fabs(g->lat_deg) <= 90 &&
           fabs(g->lon_deg) <= 180 && (g->lat_deg != 0 || g->lon_deg != 0);
}

/* GPS positions in the frame about `o`. */
static enum err_code frame_gps_to_enu(struct ingest *g, const struct geo_origin *o, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < g->n; i++) {
        struct ingest_photo *p = &g->photos[i];
        p->geo.has_gps = p->verdict < INGEST_MISSING && frame_gps_usable(&p->gps);
        if (p->geo.has_gps)
            rc = geo_to_enu(o, p->gps.lon_deg, p->gps.lat_deg, ingest_heights_photo_m(g, p),
                            p->geo.gps_enu_m, e);
    }
    return rc;
}

/* Median longitude (counted from the first, so that the date line does no harm), latitude and
 * height. */
static enum err_code frame_median_place(const struct ingest *g, struct geo_origin *o, struct err *e)
{
    double *v = mem_array(g->n, 3 * sizeof *v), lon0 = 0;
    size_t n = 0;
    if (!v)
        return frame_no_memory(e);
    for (size_t i = 0; i < g->n; i++) {
        const struct image_gps *p = &g->photos[i].gps;
        if (g->photos[i].verdict != INGEST_KEPT || !frame_gps_usable(p))
            continue;
        lon0 = n ? lon0 : p->lon_deg;
        v[n] = remainder(p->lon_deg - lon0, 360);
        v[g->n + n] = p->lat_deg;
        v[2 * g->n + n++] = ingest_heights_photo_m(g, &g->photos[i]);
    }
    *o = (struct geo_origin){remainder(lon0 + sort_median(v, n), 360), sort_median(v + g->n, n),
                             sort_median(v + 2 * g->n, n)};
    mem_free(v);
    return ERR_OK;
}

static bool frame_point_is_reliable(const struct colmap_point *p)
{
    return (p->n_track >= RELIABLE_TRACK || !p->n_track) && p->error_px <= reliable_px;
}

/* Normal of the ground: the direction in which the reliable points, without the farthest, spread
 * least. Left 0 when they are no flat thing. */
static enum err_code frame_ground_normal(const struct ingest *g, double out[3], struct err *e)
{
    const struct colmap_model *m = &g->model;
    double *d = mem_array(m->n_points, sizeof *d), mean[3] = {0}, limit = HUGE_VAL, cov[9],
           values[3], vectors[9];
    if (!d)
        return frame_no_memory(e);
    for (int pass = 0; pass < 4; pass++) {
        size_t n = 0;
        double sum[3] = {0};
        memset(cov, 0, sizeof cov);
        for (size_t i = 0; i < m->n_points; i++) {
            const double *x = m->points[i].xyz;
            double r[3] = {x[0] - mean[0], x[1] - mean[1], x[2] - mean[2]};
            double dist = sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2]);
            if (!frame_point_is_reliable(&m->points[i]) || dist > limit)
                continue;
            d[n++] = dist;
            for (int a = 0; a < 3; a++) {
                sum[a] += x[a];
                for (int b = 0; b < 3; b++)
                    cov[3 * a + b] += r[a] * r[b];
            }
        }
        if (n < 50) { /* too few to call anything a ground */
            mem_free(d);
            return ERR_OK;
        }
        for (int a = 0; a < 3; a++)
            mean[a] = sum[a] / (double)n;
        limit = pass ? 3 * sort_median(d, n) : HUGE_VAL;
    }
    sim3_eigen(cov, 3, values, vectors);
    if (values[0] < 0.1 * values[1])
        memcpy(out, vectors, 3 * sizeof *out);
    mem_free(d);
    return ERR_OK;
}

/* The direction that should turn upwards, of either sign, and how far it may be off: by the gimbals
 * where they tell it, else the ground's. */
static enum err_code frame_upwards(const struct ingest *g, double out[3], double *sigma,
                                   struct err *e)
{
    *sigma = g->gimbal.known ? gimbal_sigma : 0;
    if (!g->gimbal.known)
        return frame_ground_normal(g, out, e);
    memcpy(out, g->gimbal.up, sizeof g->gimbal.up);
    return ERR_OK;
}

static double frame_median_height(const struct ingest *g, const struct sim3 *s, double *scratch)
{
    const struct colmap_model *m = &g->model;
    size_t step = m->n_points / HEIGHT_SAMPLES + 1, n = 0;
    for (size_t i = 0; i < m->n_points; i += step) {
        double y[3];
        if (!frame_point_is_reliable(&m->points[i]))
            continue;
        sim3_apply(s, m->points[i].xyz, y);
        scratch[n++] = y[2];
    }
    return sort_median(scratch, n);
}

/* The same similarity told in the frame of another origin: a rotation and a shift by way of ECEF.
 */
static enum err_code frame_move_frame(struct sim3 *s, const struct geo_origin *from,
                                      const struct geo_origin *to, struct err *e)
{
    double a[16], b[16], turn[9], shift[3], rot[9], trans[3];
    enum err_code rc = geo_enu_to_ecef(from, a, e);
    if (!rc)
        rc = geo_enu_to_ecef(to, b, e);
    if (rc)
        return rc;
    for (int i = 0; i < 3; i++) {
        shift[i] = 0;
        for (int k = 0; k < 3; k++)
            shift[i] += b[4 * i + k] * (a[12 + k] - b[12 + k]);
        for (int j = 0; j < 3; j++) {
            turn[3 * i + j] = 0;
            for (int k = 0; k < 3; k++)
                turn[3 * i + j] += b[4 * i + k] * a[4 * j + k];
        }
    }
    for (int i = 0; i < 3; i++) {
        trans[i] = shift[i];
        for (int j = 0; j < 3; j++) {
            trans[i] += turn[3 * i + j] * s->trans[j];
            rot[3 * i + j] = 0;
            for (int k = 0; k < 3; k++)
                rot[3 * i + j] += turn[3 * i + k] * s->rot[3 * k + j];
        }
    }
    memcpy(s->rot, rot, sizeof rot);
    memcpy(s->trans, trans, sizeof trans);
    return ERR_OK;
}

/* The middle of lo to hi in the frame `from`, to 1e-7 degrees; the median point's height, to
 * 1 cm. */
static enum err_code frame_middle(const struct ingest *g, const struct geo_origin *from,
                                  const struct sim3 *s, const double lo[2], const double hi[2],
                                  struct geo_origin *out, struct err *e)
{
    double mid[3] = {0.5 * (lo[0] + hi[0]), 0.5 * (lo[1] + hi[1]), 0}, h;
    double *scratch =
        mem_array(g->model.n_points < HEIGHT_SAMPLES ? g->model.n_points : 2 * HEIGHT_SAMPLES,
                  sizeof *scratch);
    if (!scratch)
        return frame_no_memory(e);
    mid[2] = frame_median_height(g, s, scratch);
    mem_free(scratch);
    enum err_code rc = geo_from_enu(from, mid, &out->lon_deg, &out->lat_deg, &h, e);
    out->lon_deg = round(out->lon_deg * 1e7) / 1e7;
    out->lat_deg = round(out->lat_deg * 1e7) / 1e7;
    out->h_m = round(h * 100) / 100;
    return rc;
}

/* In the middle of the kept photographs by GPS. */
static enum err_code frame_choose_origin(const struct ingest *g, const struct geo_origin *from,
                                         const struct sim3 *s, struct geo_origin *out,
                                         struct err *e)
{
    double lo[2] = {HUGE_VAL, HUGE_VAL}, hi[2] = {-HUGE_VAL, -HUGE_VAL};
    for (size_t i = 0; i < g->n; i++)
        for (int a = 0; a < 2 && g->photos[i].geo.has_gps && g->photos[i].verdict == INGEST_KEPT;
             a++) {
            lo[a] = fmin(lo[a], g->photos[i].geo.gps_enu_m[a]);
            hi[a] = fmax(hi[a], g->photos[i].geo.gps_enu_m[a]);
        }
    return frame_middle(g, from, s, lo, hi, out, e);
}

/* So far satellites alone can be wrong. A pose that its points fix is no worse for it; a wrong one
 * is mostly farther off. */
static const double frame_jump_m = 20;

/* Run georef_fit on the photographs still kept, write its verdicts back. */
static enum err_code frame_fit_kept(struct ingest *g, struct err *e)
{
    struct georef_config cfg = {.inlier_m = inlier_m, .seed = 1};
    struct georef_photo *list = mem_array(g->n, sizeof *list);
    const struct ingest_photo *far = NULL;
    size_t n = 0, jumps = 0;
    double far_m = 0;
    enum err_code rc =
        list ? frame_upwards(g, cfg.ground_normal, &cfg.normal_sigma, e) : frame_no_memory(e);
    for (size_t i = 0; !rc && i < g->n; i++)
        if (g->photos[i].verdict == INGEST_KEPT) {
            list[n] = g->photos[i].geo;
            memcpy(list[n++].sigma_m, g->photos[i].sigma_m, sizeof list->sigma_m);
        }
    if (!rc)
        rc = georef_fit(list, n, &cfg, &g->georef, e);
    n = 0;
    for (size_t i = 0; !rc && i < g->n; i++) {
        struct ingest_photo *p = &g->photos[i];
        if (p->verdict != INGEST_KEPT)
            continue;
        p->residual_m = g->georef.residual_m[n];
        p->flight = g->georef.flight[n];
        if (!g->georef.dropped[n++])
            continue;
        if (p->residual_m < frame_jump_m && p->pose.n_points) {
            p->gps.has_position = false;
            far = !far || p->residual_m > far_m ? p : far;
            far_m = fmax(far_m, p->residual_m);
            p->residual_m = (double)NAN;
            jumps++;
        } else {
            p->verdict = INGEST_GPS;
        }
    }
    if (jumps)
        log_info("ingest",
                 "the GPS positions of %zu photographs do not count: they are up to %.1f m from "
                 "the poses ('%s'), which stay",
                 jumps, far_m, far->image->name);
    mem_free(list);
    return rc;
}

static enum err_code frame_from_gps(struct ingest *g, struct sim3 *sim, struct err *e)
{
    struct geo_origin first, *origin = &g->scene.origin;
    enum err_code rc = frame_median_place(g, &first, e);
    if (!rc)
        rc = frame_gps_to_enu(g, &first, e);
    if (!rc)
        rc = frame_fit_kept(g, e);
    if (rc)
        return rc;
    g->fitted = true;
    *sim = g->georef.sim;
    rc = g->cfg->origin ? ingest_frame_parse(g->cfg->origin, origin, e)
                        : frame_choose_origin(g, &first, sim, origin, e);
    if (!rc)
        rc = frame_move_frame(sim, &first, origin, e);
    if (!rc)
        rc = frame_gps_to_enu(g, origin, e);
    size_t n = 0;
    double sum = 0;
    for (size_t i = 0; i < g->n; i++)
        if (g->photos[i].verdict == INGEST_KEPT && g->photos[i].geo.has_gps) {
            const struct ingest_photo *p = &g->photos[i];
            sum +=
                g->georef.flight_offset_m[p->flight] + p->gps.alt_m - ingest_heights_photo_m(g, p);
            n++;
        }
    g->scene.vertical_offset_m = n ? sum / (double)n : 0;
    return rc;
}

/* Median height of the kept cameras above the sparse points. */
static double frame_flight_height(const struct ingest *g, const struct sim3 *s, double ground,
                                  double *scratch)
{
    size_t n = 0;
    for (size_t i = 0; i < g->n; i++) {
        double at[3];
        if (g->photos[i].verdict != INGEST_KEPT)
            continue;
        sim3_apply(s, g->photos[i].geo.center, at);
        scratch[n++] = at[2] - ground;
    }
    return sort_median(scratch, n);
}

/* Neither GPS nor control: place and scale as far as options tell, and words on what is missing. A
 * scene without metres is as large as if it were photographed from 100 m. */
static enum err_code frame_by_hand(struct ingest *g, size_t n_gps, size_t n_kept, struct sim3 *sim,
                                   struct err *e)
{
    double normal[3] = {0}, sigma, scale = g->cfg->metres_per_unit;
    g->scaled = scale > 0;
    if (n_gps >= GPS_LEAST && !(g->cfg->origin && g->scaled))
        return err_set(
            e, ERR_DATA,
            "%zu of %zu photographs have a GPS position with altitude: too few to georeference. "
            "Give ground control points (--gcp) or positions of the photographs (--positions), or "
            "place the scene by hand with --origin LON,LAT,H and --metres-per-unit, or accept "
            "fewer with --min-gps-share",
            n_gps, n_kept);
    if (g->scaled && g->cfg->origin)
        log_warn("ingest",
                 "frame by hand: %zu of %zu photographs have GPS; no positions were checked, north "
                 "is arbitrary",
                 n_gps, n_kept);
    else
        log_warn("ingest",
                 "%zu of %zu photographs have GPS, and no ground control points (--gcp) or "
                 "positions (--positions) are given: north is arbitrary%s%s. Later, `citysplat "
                 "export` to .ply and `import --origin FILE` with three places in it and on the "
                 "ground put what was trained in its place",
                 n_gps, n_kept,
                 g->cfg->origin ? ""
                                : ", the place is not known and stands at longitude 0, "
                                  "latitude 0 (--origin)",
                 g->scaled ? ""
                           : ", and metres are not known: distances are those of a flight 100 "
                             "units high (--metres-per-unit)");
    enum err_code rc =
        g->cfg->origin ? ingest_frame_parse(g->cfg->origin, &g->scene.origin, e) : ERR_OK;
    struct georef_photo *list = mem_array(g->n, sizeof *list);
    double *scratch = mem_array(
        (g->model.n_points < HEIGHT_SAMPLES ? g->model.n_points : 2 * HEIGHT_SAMPLES) + g->n,
        sizeof *scratch);
    size_t n = 0;
    if (!rc && (!list || !scratch))
        rc = frame_no_memory(e);
    for (size_t i = 0; !rc && i < g->n; i++)
        if (g->photos[i].verdict == INGEST_KEPT)
            list[n++] = g->photos[i].geo;
    if (!rc)
        rc = frame_upwards(g, normal, &sigma, e);
    if (!rc)
        rc = georef_upright(list, n, normal, sigma, g->scaled ? scale : 1, sim, e);
    if (!rc && !g->scaled) {
        double height = frame_flight_height(g, sim, frame_median_height(g, sim, scratch), scratch);
        rc = georef_upright(list, n, normal, sigma, height > 0 ? flight_units / height : 1, sim, e);
    }
    if (!rc)
        sim->trans[2] -= frame_median_height(g, sim, scratch);
    mem_free(list);
    mem_free(scratch);
    return rc;
}

/* Which way is up in COLMAP's frame: the ground's normal, on the side of the cameras. Each sight of
 * a reliable point from a photograph that was kept is one vote, so that no single pose decides. */
static enum err_code frame_up(const struct ingest *g, double out[3], struct err *e)
{
    const struct colmap_model *m = &g->model;
    size_t above = 0, below = 0;
    enum err_code rc = frame_ground_normal(g, out, e);
    for (size_t i = 0; !rc && i < g->n; i++) {
        const struct colmap_image *im = g->photos[i].image;
        const double *c = g->photos[i].geo.center;
        for (size_t k = 0; g->photos[i].verdict == INGEST_KEPT && k < im->n_obs; k++) {
            const struct colmap_point *p =
                im->obs[k].point < 0 ? NULL : &m->points[im->obs[k].point];
            if (!p || !frame_point_is_reliable(p))
                continue;
            double up = 0; /* in units of COLMAP */
            for (size_t a = 0; a < 3; a++)
                up += out[a] * (c[a] - p->xyz[a]);
            above += up > 0;
            below += up < 0;
        }
    }
    for (size_t k = 0; !rc && below > above && k < 3; k++)
        out[k] = -out[k];
    return rc;
}

/* Origin: --origin, or below the middle of the cameras, at the median point's height. */
static enum err_code frame_gcp_origin(struct ingest *g, const struct sim3 *sim, struct err *e)
{
    struct geo_origin *origin = &g->scene.origin;
    double lo[2] = {HUGE_VAL, HUGE_VAL}, hi[2] = {-HUGE_VAL, -HUGE_VAL};
    if (g->cfg->origin)
        return ingest_frame_parse(g->cfg->origin, origin, e);
    for (size_t i = 0; i < g->n; i++) {
        double at[3];
        if (g->photos[i].verdict != INGEST_KEPT)
            continue;
        sim3_apply(sim, g->photos[i].geo.center, at);
        for (size_t k = 0; k < 2; k++) {
            lo[k] = fmin(lo[k], at[k]);
            hi[k] = fmax(hi[k], at[k]);
        }
    }
    return frame_middle(g, &g->gcp.frame, sim, lo, hi, origin, e);
}

static void frame_view(const struct ingest *g, const struct ingest_photo *p, struct gcp_view *v)
{
    *v = (struct gcp_view){.image = p->image,
                           .lens = &g->model.cameras[p->image->camera].lens,
                           .has_gps = frame_gps_usable(&p->gps)};
    memcpy(v->center, p->geo.center, sizeof v->center);
    memcpy(v->rot, p->geo.rot, sizeof v->rot);
    if (!v->has_gps)
        return;
    v->lon_deg = p->gps.lon_deg;
    v->lat_deg = p->gps.lat_deg;
    v->h_m = ingest_heights_photo_m(g, p);
    memcpy(v->sigma_m, p->sigma_m, sizeof v->sigma_m);
}

static enum err_code frame_from_gcp(struct ingest *g, struct sim3 *sim, struct err *e)
{
    double up[3] = {0};
    size_t n = 0;
    const struct gcp_fit_config cfg = {.px_scale = g->cfg->gcp_scale,
                                       .height_offset_m = g->cfg->geoid_offset_m,
                                       .geoid = g->gcps_of_sea ? g->geoid : NULL,
                                       .sigma_m = g->cfg->gcp_accuracy_m,
                                       .mark_px = g->cfg->mark_accuracy_px,
                                       .suspects = (enum gcp_suspects)g->cfg->suspects,
                                       .gps_check = g->cfg->gps_check};
    struct gcp_view *views = mem_array(g->n, sizeof *views);
    enum err_code rc = views ? frame_up(g, up, e) : frame_no_memory(e);
    for (size_t i = 0; !rc && i < g->n; i++)
        if (g->photos[i].verdict == INGEST_KEPT)
            frame_view(g, &g->photos[i], &views[n++]);
    if (!rc)
        rc = gcp_fit_make(g->gcps, &g->model, views, n, &cfg, up, &g->gcp, e);
    if (rc)
        err_add(e, "%s", g->cfg->gcp);
    for (size_t k = 0; !rc && k < g->gcp.at.n_sights; k++)
        g->gcp.at.sights[k].view = NULL; /* they go now */
    mem_free(views);
    if (rc)
        return rc;
    *sim = g->gcp.sim;
    rc = frame_gcp_origin(g, sim, e);
    if (!rc)
        rc = frame_move_frame(sim, &g->gcp.frame, &g->scene.origin, e);
    if (!rc)
        rc = frame_gps_to_enu(g, &g->scene.origin, e);
    g->scene.vertical_offset_m = -g->cfg->geoid_offset_m;
    return rc;
}

enum err_code ingest_frame_find(struct ingest *g, struct err *e)
{
    struct sim3 sim = {0};
    size_t n_gps = 0, n_kept = 0;
    for (size_t i = 0; i < g->n; i++)
        if (g->photos[i].verdict == INGEST_KEPT) {
            n_kept++;
            n_gps += frame_gps_usable(&g->photos[i].gps);
        }
    bool enough = n_gps >= GPS_LEAST && (double)n_gps >= g->cfg->min_gps_share * (double)n_kept;
    enum err_code rc = ingest_drone_up(g, &g->gimbal, e);
    if (!rc)
        rc = g->gcps  ? frame_from_gcp(g, &sim, e)
             : enough ? frame_from_gps(g, &sim, e)
                      : frame_by_hand(g, n_gps, n_kept, &sim, e);
    if (!rc)
        ingest_heights_name(g);
    if (!rc && g->gimbal.known)
        ingest_drone_check(&sim, &g->gimbal);
    g->scene.scale = sim.scale;
    memcpy(g->scene.rot, sim.rot, sizeof sim.rot);
    memcpy(g->scene.trans, sim.trans, sizeof sim.trans);
    return rc;
}
