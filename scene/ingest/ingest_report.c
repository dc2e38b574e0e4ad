/* The report of ingest: a summary on stdout, and everything as report.json.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "codec/scene/colmap.h"
#include "codec/scene/scene.h"
#include "core/math/sort.h"
#include "scene/control/gcp_fit.h"
#include "scene/ingest/ingest.h"
#include "scene/ingest/ingest_internal.h"

enum { NAMES_SHOWN = 20 };

/* Why a photograph was dropped, as a sentence; "" when it was kept. */
static void report_verdict_text(const struct ingest_result *r, const struct ingest_photo *p,
                                char *out, size_t n)
{
    switch (p->verdict) {
    case INGEST_LOOSE:
        if (isfinite(p->pose.picture_px))
            snprintf(out, n, "its %zu points do not fix its pose: what it shows may be %.1f px off",
                     p->pose.n_points, p->pose.picture_px);
        else
            snprintf(out, n, "its %zu points do not fix its pose", p->pose.n_points);
        break;
    case INGEST_POSE:
        snprintf(out, n,
                 "its pose disagrees with the points it sees: median reprojection error %.1f px",
                 p->pose.reprojection_px);
        break;
    case INGEST_GPS:
        snprintf(out, n, "%.1f m from its GPS position, more than %.1f m", p->residual_m,
                 r->georef ? r->georef->tau_m : 0);
        break;
    case INGEST_BROKEN:
        snprintf(out, n, "its file cannot be read: %.*s", (int)(n - 30), p->fault);
        break;
    case INGEST_MISSING:
        snprintf(out, n, "not in the folder of photographs");
        break;
    default:
        out[0] = 0;
    }
}

/* Residuals of the kept photographs with GPS at 50, 90 and 100 %; returns how many there are. */
static size_t report_residual_quantiles(const struct ingest_result *r, double q[3])
{
    double *v = mem_array(r->n_photos, sizeof *v);
    size_t n = 0;
    q[0] = q[1] = q[2] = 0;
    if (!v)
        return 0;
    for (size_t i = 0; i < r->n_photos; i++)
        if (r->photos[i].verdict == INGEST_KEPT && isfinite(r->photos[i].residual_m))
            v[n++] = r->photos[i].residual_m;
    if (n) {
        q[0] = sort_median(v, n); /* sorts */
        q[1] = v[(size_t)(0.9 * (double)(n - 1))];
        q[2] = v[n - 1];
    }
    mem_free(v);
    return n;
}

/* "0.021 m in plan, 0.034 m in height". */
static void report_two(const double m[2], char out[64])
{
    snprintf(out, 64, "%.3f m in plan, %.3f m in height", m[0], m[1]);
}

static void report_print_rmse(const struct gcp_fit *f)
{
    char told[64], expected[64];
    report_two(f->control_m, told);
    if (isfinite(f->control_m[0]))
        printf("GCP      control: RMSE %s; %zu points, %d coordinates more than the frame needs\n",
               told, f->n_control, f->redundancy);
    else
        printf("GCP      control: %zu points fit by themselves: no RMSE; give 3 or more, better "
               "5\n",
               f->n_control);
    report_two(f->check_m, told);
    report_two(f->check_expected_m, expected);
    if (f->n_check)
        printf("         check:   RMSE %s, %zu point%s; expected %s\n", told, f->n_check,
               f->n_check > 1 ? "s" : "", expected);
    else
        printf("         no check points: nothing tells how far off other places are; keep some "
               "out by --check\n");
    report_two(f->frame_m, told);
    if (f->redundancy > 0)
        printf("         the frame is right to about %s at the points\n", told);
}

static void report_print_point(const struct gcp_fit *f, size_t i)
{
    const struct gcp_place *at = &f->at.places[i];
    const struct gcp_point *p = &f->points[i];
    const double *out = p->left.residual_m;
    bool check = f->list->gcps[i].check;
    printf("         %s: ", f->list->gcps[i].name);
    if (check || f->redundancy > 0)
        printf("%+.3f m east, %+.3f north, %+.3f up; ", p->residual_m[0], p->residual_m[1],
               p->residual_m[2]);
    printf("%zu photograph%s%s%s", at->n_photos, at->n_photos > 1 ? "s" : "",
           at->by_points ? ", height by sparse points" : "",
           check           ? ", check"
           : p->weight > 0 ? ""
                           : ", does not count");
    if (!check && isfinite(out[0]))
        printf("; left out %+.3f %+.3f %+.3f, the frame goes %.3f m", out[0], out[1], out[2],
               p->influence_m);
    printf("\n");
}

/* Suspects first: they are what has to be looked at. */
static void report_print_points_of(const struct gcp_fit *f)
{
    size_t shown = 0;
    for (size_t pass = 0; pass < 2; pass++)
        for (size_t i = 0; i < f->list->n && shown < NAMES_SHOWN; i++) {
            if (f->points[i].suspect != (pass == 0))
                continue;
            if (!f->at.places[i].n_photos)
                printf("         %s: in no photograph that was kept\n", f->list->gcps[i].name);
            else
                report_print_point(f, i);
            shown++;
        }
    if (f->list->n > shown)
        printf("         ... and %zu more, see report.json\n", f->list->n - shown);
}

static const char *report_suspect_use(const struct ingest_result *r, bool counts)
{
    static const char *const words[] = {"counts little or not", "left out", "counts all the same"};
    return counts && r->cfg->suspects == GCP_REWEIGH ? "counts less" : words[r->cfg->suspects];
}

/* A line for each suspect: which, by how much, why, what was done. */
static void report_warn_suspects(const struct ingest_result *r)
{
    const struct gcp_fit *f = r->gcp;
    for (size_t i = 0; i < f->list->n; i++) {
        const struct gcp_point *p = &f->points[i];
        const double *d = p->left.residual_m;
        bool check = f->list->gcps[i].check;
        if (p->suspect && p->far)
            log_warn("ingest", "suspect: ground control point %s (line %zu): %s: left out",
                     f->list->gcps[i].name, f->list->gcps[i].line, p->cause);
        else if (p->suspect)
            log_warn("ingest",
                     "suspect: %s point %s (line %zu) is %.2f m off in plan and %+.2f m in height, "
                     "%.0f times what is expected%s%s: %s",
                     check ? "check" : "control", f->list->gcps[i].name, f->list->gcps[i].line,
                     hypot(d[0], d[1]), d[2], p->left.sigmas, p->cause[0] ? "; likely " : "",
                     p->cause, check ? "look at it" : report_suspect_use(r, p->weight > 0));
    }
    for (size_t k = 0; k < f->at.n_sights; k++) {
        const struct gcp_sight *s = &f->at.sights[k];
        if (s->suspect)
            log_warn("ingest",
                     "suspect: mark of %s in %s (line %zu) is %.1f px from where its other marks "
                     "put it%s",
                     f->list->gcps[s->mark->gcp].name, s->mark->image, s->mark->line, s->out_px,
                     s->used ? "" : ": it does not count");
    }
}

static void report_warn_gcp(const struct ingest_result *r)
{
    const struct gcp_fit *f = r->gcp;
    report_warn_suspects(r);
    if (f->level_by_points)
        log_warn("ingest",
                 "%zu ground control points on a line: what is level about it comes from "
                 "the sparse points; give one beside the line",
                 f->n_control);
    if (f->at.n_lost)
        log_warn("ingest", "%zu marks are in photographs that the model does not hold, '%s' first",
                 f->at.n_lost, f->at.lost);
    if ((f->factor > 2 || f->contradict) && isfinite(f->control_m[0]))
        log_warn("ingest",
                 "control points contradict the poses or each other: plan_m=%.3f height_m=%.3f, "
                 "%.1f times what survey and marks explain%s",
                 f->control_m[0], f->control_m[1], f->factor,
                 f->n_suspects ? "" : "; these points cannot tell which is wrong: give more");
    if (f->gps.cause[0])
        log_warn("ingest",
                 "ground control is %.2f m in plan and %+.2f m in height from GPS (%zu "
                 "photographs; usual are %.1f and %.1f m): likely %s",
                 f->gps.plan_m, -f->gps.height_m, f->gps.n, f->gps.limit_m[0], f->gps.limit_m[1],
                 f->gps.cause);
}

static void report_print_gcp(const struct ingest_result *r)
{
    const struct gcp_fit *f = r->gcp;
    printf("frame    scale %.6g m per COLMAP unit, by %zu ground control points%s\n",
           r->scene->scale, f->n_control,
           f->level_by_points ? " on a line; level by the sparse points" : "");
    report_print_rmse(f);
    report_print_points_of(f);
    if (f->gps.n)
        printf("GPS      %zu photographs: ground control lies %.2f m in plan and %+.2f m in height "
               "from theirs\n",
               f->gps.n, f->gps.plan_m, -f->gps.height_m);
    report_warn_gcp(r);
}

/* Where heights come from and what they count from: key of report.json, words for people. */
static const struct {
    const char *key, *text;
} altitude_words[INGEST_ALTITUDES] = {
    [INGEST_ALTITUDE_EXIF] = {"exif", "EXIF's altitudes, as the camera has them"},
    [INGEST_ALTITUDE_BAROMETER] = {"barometer", "the barometer's above take-off, at the level of "
                                                "EXIF's or XMP's"},
    [INGEST_ALTITUDE_XMP] = {"xmp", "XMP's, because EXIF has none or wrong ones"},
    [INGEST_ALTITUDE_TAKEOFF] = {"takeoff", "above the place of take-off"},
    [INGEST_ALTITUDE_NONE] = {"none", "0 in all photographs: not known"},
    [INGEST_ALTITUDE_EXIF_ELLIPSOID] = {"exif_ellipsoid", "EXIF's, above the ellipsoid"},
    [INGEST_ALTITUDE_RTK] = {"rtk", "RTK's, above the ellipsoid"},
    [INGEST_ALTITUDE_FILE] = {"positions", "those of --positions"},
};

static void report_count_altitudes(const struct ingest_result *r, size_t n[INGEST_ALTITUDES])
{
    memset(n, 0, INGEST_ALTITUDES * sizeof *n);
    for (size_t i = 0; i < r->n_photos; i++)
        if (r->photos[i].verdict == INGEST_KEPT && r->photos[i].gps.has_altitude)
            n[r->photos[i].altitude]++;
}

/* Ground that lies so near to the sea is at the shore, or its heights count from take-off. */
static const double report_shore_m = 3;

static void report_print_drone(const struct ingest_result *r)
{
    const struct ingest_gimbal *m = r->gimbal;
    double deg = 57.29577951308232;
    size_t n[INGEST_ALTITUDES];
    char words[HEIGHTS_WORDS_MAX];
    report_count_altitudes(r, n);
    for (size_t k = 0; k < INGEST_ALTITUDES; k++)
        if (n[k] && r->georef)
            printf("heights  %zu photographs: %s%s\n", n[k], altitude_words[k].text,
                   k >= INGEST_ALTITUDE_TAKEOFF  ? ""
                   : r->cfg->geoid               ? ", moved by --geoid"
                   : r->cfg->geoid_offset_m != 0 ? ", moved by --geoid-offset-m"
                                                 : "");
    heights_words(r->scene->heights, words);
    printf("heights  of the scene count from %s%s\n", words,
           !strcmp(r->scene->heights, "sea-exif")
               ? "; --geoid egm96 makes them ellipsoidal, as globes expect"
           : !strcmp(r->scene->heights, "unknown") && r->gcp ? "; say it by --heights"
                                                             : "");
    if (r->georef && !strcmp(r->scene->heights, "sea-exif") &&
        fabs(r->scene->origin.h_m) < report_shore_m)
        log_warn("ingest",
                 "the ground lies at %.1f m above the sea by these altitudes: if it does not, they "
                 "count from the place of take-off: give its height by --positions or --gcp",
                 r->scene->origin.h_m);
    if (!m->known)
        return;
    printf("gimbals  %zu photographs: up is %.2f deg from the frame's (%+.2f to the east, %+.2f to "
           "the north); they agree to %.2f deg\n",
           m->used, deg * m->tilt_rad, deg * m->east_rad, deg * m->north_rad, deg * m->spread_rad);
    if (m->tilt_rad > 0.035)
        log_warn("ingest", "gimbals contradict the frame: tilt_deg=%.1f; is its level right?",
                 deg * m->tilt_rad);
}

static void report_print_frame(const struct ingest_result *r)
{
    const struct scene *s = r->scene;
    const struct georef_result *g = r->georef;
    printf("origin   lon %.7f lat %.7f h %.2f m\n", s->origin.lon_deg, s->origin.lat_deg,
           s->origin.h_m);
    if (r->gcp) {
        report_print_gcp(r);
        return;
    }
    if (!g && !strcmp(s->heights, "unscaled")) {
        printf("frame    scale and north are not known: units are no metres, nothing checked\n");
        return;
    }
    if (!g) {
        printf("frame    placed by hand: scale %.6g m per COLMAP unit, north arbitrary, nothing "
               "checked\n",
               s->scale);
        return;
    }
    double q[3], deg = 57.29577951308232;
    size_t n = report_residual_quantiles(r, q);
    printf("frame    scale %.6g m per COLMAP unit +- %.2f %%, tilt +- %.2f deg, heading +- %.2f "
           "deg, place +- %.2f m\n",
           s->scale, 100 * g->fit.scale_rel, deg * g->fit.tilt_rad, deg * g->fit.heading_rad,
           g->fit.place_m);
    if (g->collinear)
        printf("         the flight is one straight line: the roll about it comes from the cameras "
               "being level\n");
    printf("GPS      %zu positions, distance from the poses: median %.2f m, 90 %% %.2f m, largest "
           "kept %.2f m (limit %.1f m)\n",
           n, q[0], q[1], q[2], g->tau_m);
    printf("         their errors are about %.2f m a horizontal axis, %.2f m in height%s\n",
           g->fit.sigma_h_m, g->fit.sigma_v_m,
           g->fit.share_h < 0.5 || g->fit.share_v < 0.5 ? ", and drift: neighbours err alike" : "");
    for (size_t k = 1; k < g->n_flights; k++)
        printf("flight   %zu: its GPS heights read %+.2f m against flight 1\n", k + 1,
               g->flight_offset_m[k]);
    if (g->fit.scale_rel > 0.03 || g->fit.tilt_rad > 0.05)
        log_warn("ingest", "GPS fixes the frame only roughly: scale_percent=%.1f tilt_deg=%.1f",
                 100 * g->fit.scale_rel, deg * g->fit.tilt_rad);
}

/* Why a sparse point was dropped: key of report.json, words for people. */
static const struct {
    const char *key, *text;
} point_words[INGEST_POINT_VERDICTS] = {
    [INGEST_POINT_KEPT] = {"kept", ""},
    [INGEST_POINT_ANGLE] = {"angle", "seen at too small an angle"},
    [INGEST_POINT_ERROR] = {"error", "reprojected too far off"},
    [INGEST_POINT_ALONE] = {"alone", "far from all others"},
    [INGEST_POINT_BELOW] = {"below", "below the ground"},
    [INGEST_POINT_ABOVE] = {"above", "above all around"},
};

static void report_print_points(const struct ingest_result *r)
{
    size_t dropped = 0;
    const char *comma = "";
    for (size_t v = INGEST_POINT_KEPT + 1; v < INGEST_POINT_VERDICTS; v++)
        dropped += r->points[v];
    if (!dropped)
        return;
    printf("points   %zu left out:", dropped);
    for (size_t v = INGEST_POINT_KEPT + 1; v < INGEST_POINT_VERDICTS; v++)
        if (r->points[v]) {
            printf("%s %zu %s", comma, r->points[v], point_words[v].text);
            comma = ",";
        }
    printf("\n");
}

/* Stops between the darkest and the brightest photograph, and the median distance from the mean; in
 * green, which is most of what is seen. */
static double report_exposure(const struct ingest_result *r, double *median_ev)
{
    const struct scene *s = r->scene;
    double least = 0.0, most = 0.0, *v = mem_array(s->n_images, sizeof *v);
    *median_ev = 0.0;
    for (size_t i = 0; v && i < s->n_images; i++) {
        double ev = (double)s->images[i].exposure_ev[1];
        least = fmin(least, ev);
        most = fmax(most, ev);
        v[i] = fabs(ev);
    }
    if (v && s->n_images)
        *median_ev = sort_median(v, s->n_images);
    mem_free(v);
    return most - least;
}

void ingest_report_print(const struct ingest_result *r)
{
    const struct scene *s = r->scene;
    size_t dropped = r->n_photos - r->n_kept, shown = 0;
    printf("scene    %s: %zu of %zu photographs (%zu to train, %zu to test), %zu points, %zu "
           "observations, %.1f s\n",
           r->cfg->output, r->n_kept, r->n_photos, r->n_train, r->n_test, s->n_points, s->n_tracks,
           r->seconds);
    if (s->n_images)
        printf("pictures %u x %u px, focal length %.1f px\n", s->images[0].cam.width_px,
               s->images[0].cam.height_px, s->images[0].cam.fx_px);
    report_print_frame(r);
    report_print_drone(r);
    report_print_points(r);
    double median_ev, range_ev = report_exposure(r, &median_ev);
    if (range_ev > 0.0)
        printf("exposure %.2f stops from the darkest to the brightest photograph, median %.2f from "
               "the mean\n",
               range_ev, median_ev);
    for (size_t i = 0; i < r->n_photos && shown < NAMES_SHOWN; i++) {
        char why[160];
        report_verdict_text(r, &r->photos[i], why, sizeof why);
        if (why[0]) {
            printf("dropped  %s: %s\n", r->photos[i].image->name, why);
            shown++;
        }
    }
    if (dropped > shown)
        printf("dropped  ... and %zu more, see report.json\n", dropped - shown);
    for (size_t i = 0; i < r->n_unplaced && i < NAMES_SHOWN; i++)
        printf("unplaced %s: in the folder, but not in the model\n", r->unplaced[i]);
    if (r->n_unplaced > NAMES_SHOWN)
        printf("unplaced ... and %zu more, see report.json\n", r->n_unplaced - NAMES_SHOWN);
    if (r->n_models > 1)
        printf("model    %s: the largest of %zu; the second has %zu photographs\n", r->model_dir,
               r->n_models, r->n_second);
}

static json_t *report_photos_to_json(const struct ingest_result *r)
{
    json_t *list = json_array();
    for (size_t i = 0; i < r->n_photos; i++) {
        const struct ingest_photo *p = &r->photos[i];
        char why[160];
        report_verdict_text(r, p, why, sizeof why);
        json_array_append_new(
            list, json_pack("{s:s, s:b, s:s, s:I, s:f, s:o, s:o, s:i}", "name", p->image->name,
                            "kept", p->verdict == INGEST_KEPT, "why", why, "points",
                            (json_int_t)p->pose.n_points, "reprojection_px",
                            p->pose.reprojection_px, "pose_px", jsonc_real(p->pose.picture_px),
                            "residual_m", jsonc_real(p->residual_m), "flight", (int)p->flight + 1));
    }
    return list;
}

static json_t *report_points_to_json(const struct ingest_result *r)
{
    json_t *o = json_object();
    for (size_t v = 0; v < INGEST_POINT_VERDICTS; v++)
        json_object_set_new(o, point_words[v].key, json_integer((json_int_t)r->points[v]));
    return o;
}

static json_t *report_georef_to_json(const struct ingest_result *r)
{
    const struct georef_result *g = r->georef;
    double q[3];
    if (!g)
        return json_null();
    size_t n = report_residual_quantiles(r, q);
    json_t *flights = json_array();
    for (size_t k = 0; k < g->n_flights; k++)
        json_array_append_new(flights, json_real(g->flight_offset_m[k]));
    return json_pack("{s:I, s:I, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:b, s:i, s:o}",
                     "positions", (json_int_t)n, "dropped", (json_int_t)g->n_dropped, "limit_m",
                     g->tau_m, "residual_median_m", q[0], "residual_90_m", q[1], "residual_max_m",
                     q[2], "sigma_horizontal_m", g->fit.sigma_h_m, "sigma_vertical_m",
                     g->fit.sigma_v_m, "scale_error", g->fit.scale_rel, "tilt_error_rad",
                     g->fit.tilt_rad, "heading_error_rad", g->fit.heading_rad, "place_error_m",
                     g->fit.place_m, "collinear", g->collinear, "rounds", g->rounds,
                     "flight_height_offset_m", flights);
}

static json_t *report_altitudes_to_json(const struct ingest_result *r)
{
    size_t n[INGEST_ALTITUDES];
    json_t *o = json_object();
    report_count_altitudes(r, n);
    for (size_t k = 0; k < INGEST_ALTITUDES; k++)
        json_object_set_new(o, altitude_words[k].key, json_integer((json_int_t)n[k]));
    return o;
}

static json_t *report_gimbal_to_json(const struct ingest_gimbal *m)
{
    return m->known
               ? json_pack("{s:I, s:I, s:f, s:f, s:f, s:f}", "photographs", (json_int_t)m->n,
                           "used", (json_int_t)m->used, "spread_rad", m->spread_rad, "tilt_rad",
                           m->tilt_rad, "east_rad", m->east_rad, "north_rad", m->north_rad)
               : json_null();
}

static json_t *report_rmse(size_t n, const double m[2])
{
    return json_pack("{s:I, s:o, s:o}", "points", (json_int_t)n, "rmse_plan_m", jsonc_real(m[0]),
                     "rmse_height_m", jsonc_real(m[1]));
}

static json_t *report_marks_to_json(const struct gcp_fit *f, size_t i)
{
    json_t *list = json_array();
    const struct gcp_place *p = &f->at.places[i];
    for (size_t k = p->first; k < p->first + p->n; k++) {
        const struct gcp_sight *s = &f->at.sights[k];
        json_array_append_new(list, json_pack("{s:s, s:I, s:f, s:o, s:o, s:o, s:b, s:b}",
                                              "photograph", s->mark->image, "line",
                                              (json_int_t)s->mark->line, "residual_px",
                                              s->residual_px, "left_out_px", jsonc_real(s->out_px),
                                              "left_out_sigmas", jsonc_real(s->out_sigmas),
                                              "moves_point_m", jsonc_real(s->moves * f->sim.scale),
                                              "suspect", s->suspect, "counts", s->used));
    }
    return list;
}

static json_t *report_point_to_json(const struct gcp_fit *f, size_t i)
{
    const struct gcp *g = &f->list->gcps[i];
    const struct gcp_place *at = &f->at.places[i];
    const struct gcp_point *p = &f->points[i];
    const struct gcp_left *l = &p->left;
    bool there = at->n_photos > 0, known = there && (g->check || f->redundancy > 0);
    json_t *o = json_pack("{s:s, s:b, s:I, s:I, s:b, s:o, s:o, s:o}", "name", g->name, "check",
                          g->check, "line", (json_int_t)g->line, "photographs",
                          (json_int_t)at->n_photos, "by_sparse_points", there && at->by_points,
                          "east_m", known ? json_real(p->residual_m[0]) : json_null(), "north_m",
                          known ? json_real(p->residual_m[1]) : json_null(), "up_m",
                          known ? json_real(p->residual_m[2]) : json_null());
    if (!o || !there)
        return o;
    json_object_set_new(o, "gsd_m", json_real(p->gsd_m));
    json_object_set_new(o, "weight", json_real(p->weight));
    json_object_set_new(o, "influence_m", jsonc_real(p->influence_m));
    json_object_set_new(
        o, g->check ? "as_check" : "left_out",
        json_pack("{s:o, s:o, s:o, s:o, s:o, s:o}", "east_m", jsonc_real(l->residual_m[0]),
                  "north_m", jsonc_real(l->residual_m[1]), "up_m", jsonc_real(l->residual_m[2]),
                  "sigma_axis_m", jsonc_real(l->sigma_m[0]), "sigma_height_m",
                  jsonc_real(l->sigma_m[1]), "sigmas", jsonc_real(l->sigmas)));
    json_object_set_new(o, "suspect", json_boolean(p->suspect));
    json_object_set_new(o, "cause", p->cause[0] ? json_string(p->cause) : json_null());
    json_object_set_new(o, "marks", report_marks_to_json(f, i));
    return o;
}

static json_t *report_gcp_gps_to_json(const struct gcp_gps *g)
{
    return g->n ? json_pack("{s:I, s:f, s:f, s:f, s:f, s:o}", "photographs", (json_int_t)g->n,
                            "plan_m", g->plan_m, "height_m", -g->height_m, "limit_plan_m",
                            g->limit_m[0], "limit_height_m", g->limit_m[1], "cause",
                            g->cause[0] ? json_string(g->cause) : json_null())
                : json_null();
}

static json_t *report_gcp_to_json(const struct gcp_fit *f)
{
    if (!f)
        return json_null();
    json_t *list = json_array(), *control = report_rmse(f->n_control, f->control_m),
           *check = report_rmse(f->n_check, f->check_m);
    for (size_t i = 0; i < f->list->n; i++)
        json_array_append_new(list, report_point_to_json(f, i));
    json_object_set_new(control, "redundancy", json_integer(f->redundancy));
    json_object_set_new(check, "expected_plan_m", jsonc_real(f->check_expected_m[0]));
    json_object_set_new(check, "expected_height_m", jsonc_real(f->check_expected_m[1]));
    return json_pack("{s:o, s:o, s:o, s:o, s:f, s:f, s:I, s:I, s:I, s:o, s:o}", "control", control,
                     "check", check, "frame_plan_m", jsonc_real(f->frame_m[0]), "frame_height_m",
                     jsonc_real(f->frame_m[1]), "contradiction", f->factor, "marks_factor",
                     f->at.factor, "suspects", (json_int_t)f->n_suspects, "mark_suspects",
                     (json_int_t)f->n_mark_suspects, "marks_lost", (json_int_t)f->at.n_lost, "gps",
                     report_gcp_gps_to_json(&f->gps), "points", list);
}

/* `to` as seen from the folder `from`, both without links. */
static void report_relative(const char *from, const char *to, char *out, size_t room)
{
    size_t same = 0, n = 0, i = 0;
    for (; from[i] && from[i] == to[i]; i++)
        if (from[i] == '/')
            same = i + 1;
    if (!from[i] && to[i] == '/') /* below it */
        same = i + 1;
    out[0] = '\0';
    for (const char *c = from + (same < i ? same : i); *c && n + 4 < room; c++)
        if (c == from + same || c[-1] == '/')
            n += (size_t)snprintf(out + n, room - n, "../");
    snprintf(out + n, room - n, "%s", to + same);
}

/* A path as seen from the report's folder, so that scene and photographs can be moved together and
 * the report tells nobody where they lie; null: there is none, or JSON cannot hold it. */
static json_t *report_path(const char *path, const char *report)
{
    char full[PATH_MAX], dir[PATH_MAX], seen[2 * PATH_MAX];
    snprintf(seen, sizeof seen, "%s", report);
    char *slash = strrchr(seen, '/');
    if (slash)
        slash[slash == seen] = '\0';
    if (!path || !realpath(path, full) || !realpath(slash ? seen : ".", dir))
        return json_null();
    report_relative(dir, full, seen, sizeof seen);
    json_t *o = json_string(seen);
    return o ? o : json_null();
}

/* What the scene was made of, for commands that need the photographs as they came. */
static json_t *report_source_to_json(const struct ingest_result *r, const char *report)
{
    return json_pack("{s:o, s:o, s:o}", "photographs", report_path(r->images_dir, report), "model",
                     report_path(r->model_dir, report), "ground_control",
                     report_path(r->cfg->gcp, report));
}

enum err_code ingest_report_write(const struct ingest_result *r, const char *path, struct err *e)
{
    json_t *config = NULL;
    enum err_code rc = options_to_json(ingest_options(), r->cfg, &config, e);
    if (rc)
        return rc;
    double median_ev, range_ev = report_exposure(r, &median_ev);
    json_t *root = json_pack(
        "{s:I, s:I, s:I, s:I, s:I, s:I, s:f, s:s, s:{s:f, s:f}, s:o, s:o, s:o, s:o, s:o, s:o, s:o, "
        "s:f}",
        "photographs", (json_int_t)r->n_photos, "kept", (json_int_t)r->n_kept, "train",
        (json_int_t)r->n_train, "test", (json_int_t)r->n_test, "with_gps", (json_int_t)r->n_gps,
        "not_in_model", (json_int_t)r->n_unplaced, "scale_m", r->scene->scale, "heights",
        r->scene->heights, "exposure", "range_ev", range_ev, "median_ev", median_ev, "altitudes",
        report_altitudes_to_json(r), "gimbals", report_gimbal_to_json(r->gimbal), "georeferencing",
        report_georef_to_json(r), "ground_control", report_gcp_to_json(r->gcp), "points",
        report_points_to_json(r), "photos", report_photos_to_json(r), "config", config, "seconds",
        r->seconds);
    json_t *unplaced = json_array();
    for (size_t i = 0; root && i < r->n_unplaced; i++)
        json_array_append_new(unplaced, json_string(r->unplaced[i]));
    if (root)
        json_object_set_new(root, "unplaced", unplaced);
    else
        json_decref(unplaced);
    if (root) {
        json_object_set_new(root, "models", json_integer((json_int_t)r->n_models));
        json_object_set_new(root, "source", report_source_to_json(r, path));
    }
    if (!root)
        return err_set(e, ERR_DATA, "%s: cannot be written: a photograph's name is not UTF-8",
                       path);
    rc = jsonc_write(path, root, e);
    json_decref(root);
    return rc;
}
