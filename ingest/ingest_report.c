/* What ingest tells: a summary for people on stdout, all of it as report.json.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/colmap.h"
#include "codec/scene.h"
#include "core/sort.h"
#include "ingest/gcp_fit.h"
#include "ingest/ingest.h"
#include "ingest/ingest_internal.h"

enum { NAMES_SHOWN = 20 };

/* Why a photograph was dropped, as a sentence; "" when it was kept. */
static void report_verdict_text(const struct ingest_result *r, const struct ingest_photo *p,
                                char *out, size_t n)
{
    switch (p->verdict) {
    case INGEST_FEW_POINTS:
        snprintf(out, n, "sees %zu points, fewer than %lld", p->n_points,
                 (long long)r->cfg->min_points);
        break;
    case INGEST_POSE:
        snprintf(out, n,
                 "its pose disagrees with the points it sees: median reprojection error %.1f px",
                 p->reprojection_px);
        break;
    case INGEST_GPS:
        snprintf(out, n, "%.1f m from its GPS position, more than %.1f m", p->residual_m,
                 r->georef ? r->georef->tau_m : 0);
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

static void report_print_gcp(const struct ingest_result *r)
{
    const struct gcp_fit *f = r->gcp;
    printf("frame    scale %.6g m per COLMAP unit, by %zu ground control points%s\n",
           r->scene->scale, f->n_control,
           f->level_by_points ? " on a line; level by the sparse points" : "");
    printf("GCP      control: RMSE %.3f m in plan, %.3f m in height\n", f->control_plan_m,
           f->control_height_m);
    if (f->n_check)
        printf("         check:   RMSE %.3f m in plan, %.3f m in height, %zu points\n",
               f->check_plan_m, f->check_height_m, f->n_check);
    else
        printf("         no check points: nothing tells how far off other places are; keep some "
               "out by --check\n");
    for (size_t i = 0; i < f->list->n && i < NAMES_SHOWN; i++) {
        const struct gcp_place *p = &f->places[i];
        if (!p->n_photos)
            printf("         %s: in no photograph that was kept\n", f->list->gcps[i].name);
        else
            printf("         %s: %+.3f m east, %+.3f north, %+.3f up; %zu photograph%s%s%s\n",
                   f->list->gcps[i].name, p->residual_m[0], p->residual_m[1], p->residual_m[2],
                   p->n_photos, p->n_photos > 1 ? "s" : "",
                   p->by_points ? ", height by sparse points" : "",
                   f->list->gcps[i].check ? ", check" : "");
    }
    if (f->control_plan_m > 3 || f->control_height_m > 3)
        log_warn("ingest", "ground control points contradict the poses: plan_m=%.2f height_m=%.2f",
                 f->control_plan_m, f->control_height_m);
}

/* Where heights come from and what they count from: key of report.json, words for people. */
static const struct {
    const char *key, *text;
} altitude_words[INGEST_ALTITUDES] = {
    [INGEST_ALTITUDE_EXIF] = {"exif", "EXIF's altitudes, as the camera has them"},
    [INGEST_ALTITUDE_BAROMETER] = {"barometer", "the barometer's above take-off, at the level of "
                                                "EXIF's"},
    [INGEST_ALTITUDE_RTK] = {"rtk", "RTK's, above the ellipsoid"},
};

static void report_count_altitudes(const struct ingest_result *r, size_t n[INGEST_ALTITUDES])
{
    memset(n, 0, INGEST_ALTITUDES * sizeof *n);
    for (size_t i = 0; i < r->n_photos; i++)
        if (r->photos[i].verdict == INGEST_KEPT && r->photos[i].gps.has_altitude)
            n[r->photos[i].altitude]++;
}

static void report_print_drone(const struct ingest_result *r)
{
    const struct ingest_gimbal *m = r->gimbal;
    double deg = 57.29577951308232;
    size_t n[INGEST_ALTITUDES];
    report_count_altitudes(r, n);
    for (size_t k = 0; k < INGEST_ALTITUDES; k++) {
        bool moved = k != INGEST_ALTITUDE_RTK && r->cfg->geoid_offset_m != 0;
        if (n[k] && r->georef && (k != INGEST_ALTITUDE_EXIF || moved))
            printf("heights  %zu photographs: %s%s\n", n[k], altitude_words[k].text,
                   moved ? ", moved by --geoid-offset-m" : "");
    }
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
    if (r->n_unregistered)
        printf("ignored  %zu pictures in the folder that the COLMAP model does not hold\n",
               r->n_unregistered);
}

static json_t *report_real_or_null(double v)
{
    return isfinite(v) ? json_real(v) : json_null();
}

static json_t *report_photos_to_json(const struct ingest_result *r)
{
    json_t *list = json_array();
    for (size_t i = 0; i < r->n_photos; i++) {
        const struct ingest_photo *p = &r->photos[i];
        char why[160];
        report_verdict_text(r, p, why, sizeof why);
        json_array_append_new(list, json_pack("{s:s, s:b, s:s, s:I, s:f, s:o, s:i}", "name",
                                              p->image->name, "kept", p->verdict == INGEST_KEPT,
                                              "why", why, "points", (json_int_t)p->n_points,
                                              "reprojection_px", p->reprojection_px, "residual_m",
                                              report_real_or_null(p->residual_m), "flight",
                                              (int)p->flight + 1));
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

static json_t *report_rmse(size_t n, double plan_m, double height_m)
{
    return json_pack("{s:I, s:o, s:o}", "points", (json_int_t)n, "rmse_plan_m",
                     report_real_or_null(plan_m), "rmse_height_m", report_real_or_null(height_m));
}

static json_t *report_gcp_to_json(const struct gcp_fit *f)
{
    if (!f)
        return json_null();
    json_t *list = json_array();
    for (size_t i = 0; i < f->list->n; i++) {
        const struct gcp_place *p = &f->places[i];
        bool there = p->n_photos > 0;
        json_array_append_new(
            list, json_pack("{s:s, s:b, s:I, s:b, s:o, s:o, s:o}", "name", f->list->gcps[i].name,
                            "check", f->list->gcps[i].check, "photographs", (json_int_t)p->n_photos,
                            "by_sparse_points", there && p->by_points, "east_m",
                            there ? json_real(p->residual_m[0]) : json_null(), "north_m",
                            there ? json_real(p->residual_m[1]) : json_null(), "up_m",
                            there ? json_real(p->residual_m[2]) : json_null()));
    }
    return json_pack("{s:o, s:o, s:o}", "control",
                     report_rmse(f->n_control, f->control_plan_m, f->control_height_m), "check",
                     report_rmse(f->n_check, f->check_plan_m, f->check_height_m), "points", list);
}

enum err_code ingest_report_write(const struct ingest_result *r, const char *path, struct err *e)
{
    json_t *config = NULL;
    enum err_code rc = options_to_json(ingest_options(), r->cfg, &config, e);
    if (rc)
        return rc;
    double median_ev, range_ev = report_exposure(r, &median_ev);
    json_t *root = json_pack(
        "{s:I, s:I, s:I, s:I, s:I, s:I, s:f, s:{s:f, s:f}, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:f}",
        "photographs", (json_int_t)r->n_photos, "kept", (json_int_t)r->n_kept, "train",
        (json_int_t)r->n_train, "test", (json_int_t)r->n_test, "with_gps", (json_int_t)r->n_gps,
        "not_in_model", (json_int_t)r->n_unregistered, "scale_m", r->scene->scale, "exposure",
        "range_ev", range_ev, "median_ev", median_ev, "altitudes", report_altitudes_to_json(r),
        "gimbals", report_gimbal_to_json(r->gimbal), "georeferencing", report_georef_to_json(r),
        "ground_control", report_gcp_to_json(r->gcp), "points", report_points_to_json(r), "photos",
        report_photos_to_json(r), "config", config, "seconds", r->seconds);
    if (!root)
        return err_set(e, ERR_DATA, "%s: cannot be written: a photograph's name is not UTF-8",
                       path);
    rc = jsonc_write(path, root, e);
    json_decref(root);
    return rc;
}
