/* citysplat report: one HTML file about the quality of a survey: what was photographed, at which
 * resolution and how often, where it lies, how far positions disagree, what was dropped, and how
 * training went.
 *
 * It contains no scripts and needs no other files, so it can be mailed, and any browser prints it
 * to PDF.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <dirent.h>
#include <jansson.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "cli/base/cli.h"
#include "cli/base/output.h"
#include "cli/base/results.h"
#include "cli/maps/report_map.h"
#include "codec/scene/scene.h"
#include "scene/cells/footprint.h"
#include "survey/sheet.h"

struct report_options {
#define OPT OPTIONS_MEMBER
#include "cli/maps/report.def"
};

static const struct options_def report_defs[] = {
#define OPT(...) OPTIONS_ROW(struct report_options, __VA_ARGS__)
#include "cli/maps/report.def"
};

static const struct options_spec report_spec = {
    .command = "report",
    .usage = "citysplat report SCENE -o REPORT.html [options]",
    .about = "Writes a survey report of an ingested scene as one HTML file that prints to PDF. "
             "It shows coverage, ground sampling distance, errors of GPS and ground control "
             "points, reprojection errors, dropped photographs, and the accuracy of trained "
             "levels. With --tiles it also shows orthophoto and surface model.",
    .example = "citysplat report scene -o report.html --tiles city.tiles",
    .defs = report_defs,
    .n_defs = sizeof report_defs / sizeof *report_defs,
    .min_args = 1,
    .max_args = 1};

enum { REPORT_DROPPED_MAX = 200, REPORT_BARS = 12 };
#define REPORT_PICTURE_PX 1000.0 /* longest side of orthophoto and surface model */

struct report {
    const struct report_options *o;
    const char *dir;
    struct scene scene;
    struct footprint footprint;
    struct report_ground ground;
    json_t *told; /* report.json of ingest; NULL: none */
    struct buf out;
};

static const json_t *report_get(const json_t *o, const char *a, const char *b)
{
    const json_t *v = json_object_get(o, a);
    return b ? json_object_get(v, b) : v;
}

/* A number of report.json; NAN when it is not there. */
static double report_num(const json_t *o, const char *a, const char *b)
{
    const json_t *v = report_get(o, a, b);
    return json_is_number(v) ? json_number_value(v) : (double)NAN;
}

/* A row of a table of two columns; none where `known` is NAN. */
static void report_row(struct report *r, const char *name, double known, const char *format, ...)
    __attribute__((format(printf, 4, 5)));
static void report_row(struct report *r, const char *name, double known, const char *format, ...)
{
    char value[128];
    va_list args;
    if (!isfinite(known))
        return;
    va_start(args, format);
    vsnprintf(value, sizeof value, format, args);
    va_end(args);
    buf_printf(&r->out, "<tr><td>%s</td><td>%s</td></tr>\n", name, value);
}

/* ---- sections ---- */

static const char report_style[] =
    "body{font:14px/1.45 system-ui,'DejaVu Sans',sans-serif;color:#222;max-width:880px;margin:2em "
    "auto;padding:0 1em}h1{font-size:26px;margin-bottom:.1em}h2{font-size:19px;margin-top:1.6em;"
    "border-bottom:2px solid #2a6f97}table{border-collapse:collapse;margin:.6em 0}td,th{border-"
    "bottom:1px solid #ccc;padding:3px 14px 3px 0;text-align:left;vertical-align:top}td+td,th+th{"
    "text-align:right}.wide td,.wide th{text-align:left}svg.map{width:100%;max-width:560px;"
    "border:1px solid #aaa}svg text{font-size:12px}.train{fill:#08306b}.test{fill:#cb181d}.arrow{"
    "stroke:#d7301f;stroke-width:1.2;fill:none}.legend{font-size:12px}.key{margin-right:1em}.key "
    "i{display:inline-block;width:12px;height:12px;border:1px solid #888;margin-right:4px;vertical-"
    "align:-2px}.ramp{display:inline-block;width:160px;height:10px;background:linear-gradient(90deg"
    ",#440154,#3b528b,#21918c,#5ec962,#fde725)}.pictures{display:grid;grid-template-columns:1fr "
    "1fr;gap:12px}.pictures img{width:100%;border:1px solid #aaa}.bar{background:#2a6f97;height:"
    "11px;display:inline-block}@media print{body{margin:0;max-width:none;-webkit-print-color-"
    "adjust:exact;print-color-adjust:exact}h2{break-after:avoid}section,svg,img,tr{break-inside:"
    "avoid}}";

static void report_head(struct report *r)
{
    char when[32];
    time_t now = time(NULL);
    struct tm tm;
    const char *slash = strrchr(r->dir, '/'), *own = slash && slash[1] ? slash + 1 : r->dir,
               *title = r->o->title ? r->o->title : own, *first = "", *last = "";
    for (size_t i = 0; i < r->scene.n_images; i++) {
        const char *t = r->scene.images[i].time;
        first = *t && (!*first || strcmp(t, first) < 0) ? t : first;
        last = *t && strcmp(t, last) > 0 ? t : last;
    }
    strftime(when, sizeof when, "%Y-%m-%d", gmtime_r(&now, &tm));
    buf_printf(&r->out, "<!DOCTYPE html><html lang=\"en\"><head><meta charset=\"utf-8\"><title>");
    buf_markup(&r->out, title);
    buf_printf(&r->out,
               "</title><style>%s</style></head><body>\n<h1>Survey report: ", report_style);
    buf_markup(&r->out, title);
    buf_printf(&r->out, "</h1><p>Written %s by citysplat %s", when, CITYSPLAT_VERSION);
    if (*first)
        buf_printf(&r->out, "; photographs of %s to %s", first, last);
    if (r->scene.attribution && *r->scene.attribution) {
        buf_printf(&r->out, "; ");
        buf_markup(&r->out, r->scene.attribution);
    }
    buf_printf(&r->out, ".</p>\n");
}

static void report_summary(struct report *r)
{
    const struct scene *s = &r->scene;
    const struct report_ground *g = &r->ground;
    double none = (double)NAN, all = report_num(r->told, "photographs", NULL), error = 0;
    size_t n = 0;
    for (size_t i = 0; i < s->n_points; i++) {
        error += (double)s->points[i].error_px;
        n += s->points[i].track_length;
    }
    buf_printf(&r->out, "<section><h2>Summary</h2><table>\n");
    report_row(r, "photographs used", (double)s->n_images, "%.0f of %.0f", (double)s->n_images,
               isfinite(all) ? all : (double)s->n_images);
    report_row(r, "ground that two photographs or more support",
               g->footprint ? g->area_m2 / 1e4 : none, "%.2f ha",
               g->footprint ? g->area_m2 / 1e4 : none);
    report_row(r, "ground sampling distance, median", 100 * g->gsd_m_median, "%.2f cm",
               100 * g->gsd_m_median);
    report_row(r, "flight above the ground, median", g->footprint ? r->footprint.height_m : none,
               "%.0f m", g->footprint ? r->footprint.height_m : none);
    report_row(r, "sparse points", (double)s->n_points, "%.0f", (double)s->n_points);
    report_row(r, "photographs a point, mean", s->n_points ? (double)n / (double)s->n_points : none,
               "%.1f", s->n_points ? (double)n / (double)s->n_points : none);
    report_row(r, "reprojection error, mean", s->n_points ? error / (double)s->n_points : none,
               "%.2f px", s->n_points ? error / (double)s->n_points : none);
    report_row(r, "GPS against poses, median",
               report_num(r->told, "georeferencing", "residual_median_m"), "%.2f m",
               report_num(r->told, "georeferencing", "residual_median_m"));
    const json_t *gcp = report_get(r->told, "ground_control", NULL);
    double control = report_num(gcp, "control", "points");
    if (isfinite(report_num(gcp, "control", "rmse_plan_m")))
        report_row(r, "control points, RMSE in plan and height", control, "%.3f m, %.3f m",
                   report_num(gcp, "control", "rmse_plan_m"),
                   report_num(gcp, "control", "rmse_height_m"));
    else
        report_row(r, "control points", control, "%.0f, which fit by themselves: no RMSE", control);
    report_row(r, "check points, RMSE in plan and height", report_num(gcp, "check", "rmse_plan_m"),
               "%.3f m, %.3f m", report_num(gcp, "check", "rmse_plan_m"),
               report_num(gcp, "check", "rmse_height_m"));
    report_row(r, "the same, expected from survey, marks and frame",
               report_num(gcp, "check", "expected_plan_m"), "%.3f m, %.3f m",
               report_num(gcp, "check", "expected_plan_m"),
               report_num(gcp, "check", "expected_height_m"));
    report_row(r, "predicted error of the frame", report_num(gcp, "frame_plan_m", NULL),
               "%.3f m, %.3f m", report_num(gcp, "frame_plan_m", NULL),
               report_num(gcp, "frame_height_m", NULL));
    char words[HEIGHTS_WORDS_MAX];
    heights_words(s->heights, words);
    buf_printf(&r->out,
               "<tr><td>origin: longitude, latitude, height above %s</td><td>"
               "%.7f°, %.7f°, %.2f m</td></tr></table></section>\n",
               words, s->origin.lon_deg, s->origin.lat_deg, s->origin.h_m);
}

/* Orthophoto or surface model of the store, from a file beside the report. */
static enum err_code report_picture(struct report *r, struct nadir *n, enum geotiff_kind kind,
                                    struct err *e)
{
    const struct area *a = nadir_area(n);
    double wide = key_edge_m(0.5 * (a->south_deg + a->north_deg), 0) / 360,
           edge = fmax((a->east_deg - a->west_deg) * wide, (a->north_deg - a->south_deg) * 111320),
           range_m[2] = {0};
    const struct map_request request = {.kind = kind, .gsd_m = edge / REPORT_PICTURE_PX};
    char path[FILE_PATH_MAX];
    struct sheet *sheet = NULL;
    struct image img = {0};
    void *px = NULL;
    enum err_code rc = file_begin(r->o->output, path, e);
    if (rc)
        return rc;
    rc = map_write(n, &request, path, NULL, e);
    if (!rc)
        rc = sheet_open(path, kind, &sheet, e);
    const struct map_grid *g = rc ? NULL : sheet_grid(sheet);
    size_t pixels = rc ? 0 : (size_t)g->width * g->height;
    if (!rc && !(px = mem_array(pixels, 4)))
        rc = err_set(e, ERR_MEM, "report: out of memory for a picture");
    if (!rc)
        rc = sheet_read(sheet, 0, 0, g->width, g->height, px, e);
    if (!rc && kind == GEOTIFF_HEIGHT)
        rc = report_map_relief(px, g->width, g->height, g->pixel_m, GEOTIFF_NODATA, &img, range_m,
                               e);
    else if (!rc)
        rc = image_alloc(g->width, g->height, 3, &img, e);
    for (size_t i = 0; !rc && kind == GEOTIFF_COLOR && i < pixels; i++)
        for (size_t k = 0; k < 3; k++)
            img.px[3 * i + k] = ((uint8_t *)px)[4 * i + 3] ? ((uint8_t *)px)[4 * i + k] : 255;
    buf_printf(&r->out, "<div>");
    if (!rc)
        rc = report_map_image(&img, "jpg", "", &r->out, e);
    if (!rc && kind == GEOTIFF_COLOR)
        buf_printf(&r->out, "<p class=\"legend\">Orthophoto, %.2g m a pixel, EPSG:%d</p>",
                   g->pixel_m, g->epsg);
    else if (!rc)
        report_map_relief_legend(range_m[0], range_m[1], &r->out);
    buf_printf(&r->out, "</div>\n");
    image_free(&img);
    mem_free(px);
    sheet_close(&sheet);
    remove(path);
    return rc;
}

static enum err_code report_pictures(struct report *r, struct err *e)
{
    const struct nadir_options no = {.device = r->o->device, .ceiling_m = (double)NAN};
    struct nadir *n = NULL;
    if (!r->o->tiles)
        return ERR_OK;
    enum err_code rc = nadir_open(r->o->tiles, &no, &n, e);
    if (!rc)
        rc = results_check_store(&r->scene, r->o->tiles, nadir_area(n), e);
    buf_printf(&r->out, "<section><h2>Orthophoto and surface model</h2><div class=\"pictures\">\n");
    if (!rc)
        rc = report_picture(r, n, GEOTIFF_COLOR, e);
    if (!rc)
        rc = report_picture(r, n, GEOTIFF_HEIGHT, e);
    buf_printf(&r->out, "</div></section>\n");
    nadir_close(&n);
    return rc;
}

static enum err_code report_maps(struct report *r, struct err *e)
{
    if (!r->ground.footprint) {
        buf_printf(&r->out, "<h2>Coverage</h2><p>No ground is supported by two photographs.</p>\n");
        return ERR_OK;
    }
    buf_printf(&r->out, "<section><h2>Coverage</h2>\n");
    enum err_code rc = report_map_coverage(&r->scene, &r->ground, &r->out, e);
    buf_printf(&r->out, "<p class=\"legend\"><span class=\"key\"><i style=\"background:#08306b\">"
                        "</i>camera</span><span class=\"key\"><i style=\"background:#cb181d\"></i>"
                        "camera of a test photograph</span> The line is the border of what two "
                        "photographs support.</p></section>\n"
                        "<section><h2>Ground sampling distance</h2>\n");
    if (!rc)
        rc = report_map_gsd(&r->scene, &r->ground, &r->out, e);
    buf_printf(&r->out, "<table>");
    report_row(r, "5 % of the ground finer than", 100 * r->ground.gsd_m_low, "%.2f cm",
               100 * r->ground.gsd_m_low);
    report_row(r, "median", 100 * r->ground.gsd_m_median, "%.2f cm", 100 * r->ground.gsd_m_median);
    report_row(r, "95 % finer than", 100 * r->ground.gsd_m_high, "%.2f cm",
               100 * r->ground.gsd_m_high);
    buf_printf(&r->out, "</table></section>\n");
    return rc;
}

/* Mean, standard deviation and RMS of GPS minus camera, by axis. */
static size_t report_gps_table(struct report *r)
{
    static const char *const axis[] = {"east", "north", "up"};
    double sum[3] = {0}, square[3] = {0};
    size_t n = 0;
    for (size_t i = 0; i < r->scene.n_images; i++) {
        const struct scene_image *img = &r->scene.images[i];
        double c[3];
        if (!isfinite(img->gps_enu_m[0]))
            continue;
        camera_center(&img->cam, c);
        for (size_t k = 0; k < 3; k++) {
            double d = img->gps_enu_m[k] - c[k];
            sum[k] += d;
            square[k] += d * d;
        }
        n++;
    }
    if (!n)
        return 0;
    buf_printf(&r->out, "<table><tr><th>GPS minus camera</th><th>mean</th><th>standard "
                        "deviation</th><th>RMS</th></tr>\n");
    for (size_t k = 0; k < 3; k++) {
        double mean = sum[k] / (double)n, ms = square[k] / (double)n;
        buf_printf(&r->out, "<tr><td>%s</td><td>%.3f m</td><td>%.3f m</td><td>%.3f m</td></tr>\n",
                   axis[k], mean, sqrt(fmax(ms - mean * mean, 0)), sqrt(ms));
    }
    buf_printf(&r->out, "</table>\n");
    return n;
}

static void report_point_row(struct report *r, const json_t *p)
{
    static const char *const keys[] = {"east_m", "north_m", "up_m"};
    bool there = report_num(p, "photographs", NULL) > 0,
         check = json_is_true(json_object_get(p, "check"));
    buf_printf(&r->out, "<tr><td>");
    buf_markup(&r->out, json_string_value(json_object_get(p, "name")));
    buf_printf(&r->out, "</td><td>%s</td><td>%.0f</td>",
               check                                         ? "check"
               : report_num(p, "weight", NULL) > 0 || !there ? "control"
                                                             : "does not count",
               report_num(p, "photographs", NULL));
    for (size_t k = 0; k < 3; k++)
        if (isfinite(report_num(p, keys[k], NULL)))
            buf_printf(&r->out, "<td>%+.3f m</td>", report_num(p, keys[k], NULL));
        else
            buf_printf(&r->out, "<td>%s</td>", there ? "fits by itself" : "not located");
    for (size_t k = 0; k < 3; k++)
        if (isfinite(report_num(p, "left_out", keys[k])))
            buf_printf(&r->out, "<td>%+.3f m</td>", report_num(p, "left_out", keys[k]));
        else
            buf_printf(&r->out, "<td></td>");
    if (isfinite(report_num(p, "influence_m", NULL)))
        buf_printf(&r->out, "<td>%.3f m</td>", report_num(p, "influence_m", NULL));
    else
        buf_printf(&r->out, "<td></td>");
    buf_printf(&r->out, "</tr>\n");
}

/* Points and marks that contradict the others. */
static void report_suspects(struct report *r, const json_t *list)
{
    size_t n = 0;
    for (size_t i = 0; i < json_array_size(list); i++) {
        const json_t *p = json_array_get(list, i), *marks = json_object_get(p, "marks");
        const char *name = json_string_value(json_object_get(p, "name")),
                   *cause = json_string_value(json_object_get(p, "cause"));
        for (size_t k = 0; k <= json_array_size(marks); k++) {
            const json_t *m = k ? json_array_get(marks, k - 1) : p;
            if (!json_is_true(json_object_get(m, "suspect")))
                continue;
            buf_printf(&r->out, n++ ? "<br>" : "<p class=\"suspects\">Suspects: ");
            buf_markup(&r->out, name);
            buf_printf(&r->out, k ? " in " : cause ? ", likely " : "");
            buf_markup(&r->out, k ? json_string_value(json_object_get(m, "photograph")) : cause);
            if (k)
                buf_printf(&r->out, " (%.1f px)", report_num(m, "left_out_px", NULL));
        }
    }
    if (n)
        buf_printf(&r->out, "</p>\n");
}

static void report_gcp_table(struct report *r)
{
    const json_t *gcp = report_get(r->told, "ground_control", NULL),
                 *list = json_object_get(gcp, "points"), *gps = json_object_get(gcp, "gps");
    if (!json_array_size(list))
        return;
    buf_printf(&r->out, "<table><tr><th>ground control point</th><th>use</th><th>photographs</th>"
                        "<th>east</th><th>north</th><th>up</th><th colspan=\"3\">left out: east, "
                        "north, up</th><th>influence</th></tr>\n");
    for (size_t i = 0; i < json_array_size(list); i++)
        report_point_row(r, json_array_get(list, i));
    buf_printf(&r->out, "</table>\n");
    report_suspects(r, list);
    if (!json_is_string(json_object_get(gps, "cause")))
        return;
    buf_printf(&r->out,
               "<p>Ground control is %.2f m in plan and %+.2f m in height from GPS: likely ",
               report_num(gps, "plan_m", NULL), report_num(gps, "height_m", NULL));
    buf_markup(&r->out, json_string_value(json_object_get(gps, "cause")));
    buf_printf(&r->out, ".</p>\n");
}

static enum err_code report_positions(struct report *r, struct err *e)
{
    enum err_code rc = ERR_OK;
    bool gcp = json_is_object(report_get(r->told, "ground_control", NULL));
    char words[HEIGHTS_WORDS_MAX];
    heights_words(r->scene.heights, words);
    buf_printf(&r->out,
               "<section><h2>Georeferencing</h2>\n<p>The frame was fitted to %s. Heights "
               "count from %s.</p>\n",
               gcp ? "ground control points"
               : json_is_object(report_get(r->told, "georeferencing", NULL))
                   ? "GPS positions"
                   : "nothing: it was placed by hand",
               words);
    report_gcp_table(r);
    size_t n = report_gps_table(r);
    if (n && r->ground.footprint)
        rc = report_map_residuals(&r->scene, &r->ground, &r->out, e);
    buf_printf(&r->out, "</section>\n");
    return rc;
}

/* Reprojection errors of the sparse points, by a quarter of a pixel. */
static void report_errors(struct report *r)
{
    const struct scene *s = &r->scene;
    size_t count[REPORT_BARS] = {0}, most = 1;
    for (size_t i = 0; i < s->n_points; i++)
        count[(size_t)fmin(fmax((double)s->points[i].error_px * 4, 0), REPORT_BARS - 1)]++;
    for (size_t k = 0; k < REPORT_BARS; k++)
        most = count[k] > most ? count[k] : most;
    buf_printf(&r->out, "<section><h2>Reprojection errors</h2><table class=\"wide\"><tr><th>of a "
                        "sparse point</th><th>points</th></tr>\n");
    for (size_t k = 0; k < REPORT_BARS; k++)
        if (count[k])
            buf_printf(&r->out,
                       "<tr><td>%.2f%s px</td><td><span class=\"bar\" style=\"width:%.0fpx\">"
                       "</span> %zu</td></tr>\n",
                       0.25 * (double)k, k + 1 < REPORT_BARS ? "" : " and more",
                       300.0 * (double)count[k] / (double)most, count[k]);
    buf_printf(&r->out, "</table></section>\n");
}

static void report_dropped(struct report *r)
{
    const json_t *photos = report_get(r->told, "photos", NULL);
    size_t shown = 0;
    for (size_t i = 0; i < json_array_size(photos); i++) {
        const json_t *p = json_array_get(photos, i);
        if (json_is_true(json_object_get(p, "kept")) || ++shown > REPORT_DROPPED_MAX)
            continue;
        if (shown == 1)
            buf_printf(&r->out, "<section><h2>Photographs that were dropped</h2><table "
                                "class=\"wide\"><tr><th>photograph</th><th>why</th></tr>\n");
        buf_printf(&r->out, "<tr><td>");
        buf_markup(&r->out, json_string_value(json_object_get(p, "name")));
        buf_printf(&r->out, "</td><td>");
        buf_markup(&r->out, json_string_value(json_object_get(p, "why")));
        buf_printf(&r->out, "</td></tr>\n");
    }
    if (shown)
        buf_printf(&r->out, "</table>%s</section>\n",
                   shown > REPORT_DROPPED_MAX ? "<p>More are in report.json.</p>" : "");
}

/* Rows of a cell that was trained. Scores of too few photographs, or of none, are a dash. */
static void report_cell(struct report *r, const char *id, const json_t *done, bool *any)
{
    const json_t *levels = report_get(done, "levels", NULL);
    const size_t n = json_array_size(levels);
    if (n && !*any)
        buf_printf(&r->out, "<section><h2>What was trained</h2><table class=\"wide\"><tr><th>cell"
                            "</th><th>level of detail</th><th>Gaussians</th><th>PSNR</th>"
                            "<th>SSIM</th></tr>\n");
    *any |= n > 0;
    for (size_t i = 0; i < n; i++) {
        const json_t *l = json_array_get(levels, i);
        const double psnr_db = report_num(l, "psnr_db", NULL);
        buf_printf(&r->out, "<tr><td>");
        buf_markup(&r->out, id);
        buf_printf(&r->out, "</td><td>%zu of %zu</td><td>%.0f</td>", i + 1, n,
                   report_num(l, "gaussians", NULL));
        if (isfinite(psnr_db))
            buf_printf(&r->out, "<td>%.2f dB</td><td>%.4f</td></tr>\n", psnr_db,
                       report_num(l, "ssim", NULL));
        else
            buf_printf(&r->out, "<td>–</td><td>–</td></tr>\n");
    }
}

/* Of all cells that are complete: `all` without a plan. */
static enum err_code report_training(struct report *r, struct err *e)
{
    struct dirent **list = NULL;
    char cells[FILE_PATH_MAX], path[FILE_PATH_MAX];
    bool any = false;
    enum err_code rc = file_join(cells, r->dir, "cells", e);
    const int n = rc ? -1 : scandir(cells, &list, NULL, alphasort);
    for (int i = 0; i < n; i++) {
        json_t *done = NULL;
        const char *id = list[i]->d_name;
        if (!rc && id[0] != '.' &&
            snprintf(path, sizeof path, "%s/%s/done.json", cells, id) < (int)sizeof path &&
            file_exists(path))
            rc = jsonc_read(path, &done, e);
        if (!rc)
            report_cell(r, id, done, &any);
        json_decref(done);
        free(list[i]); /* scandir's own */
    }
    free(list);
    if (any)
        buf_printf(&r->out,
                   "</table><p>Against photographs that training did not see.</p></section>\n");
    return rc;
}

/* ---- all of it ---- */

/* A JSON file of the scene that may be missing. */
static enum err_code report_read(const struct report *r, const char *name, json_t **out,
                                 struct err *e)
{
    char path[FILE_PATH_MAX];
    enum err_code rc = file_join(path, r->dir, name, e);
    return !rc && file_exists(path) ? jsonc_read(path, out, e) : rc;
}

static enum err_code report_open(struct report *r, struct err *e)
{
    enum err_code rc = scene_read(r->dir, &r->scene, e);
    if (!rc)
        rc = report_read(r, "report.json", &r->told, e);
    if (!rc)
        rc = footprint_of(&r->scene, &r->footprint, e);
    if (!rc && r->footprint.nx)
        rc = report_ground_of(&r->scene, &r->footprint, &r->ground, e);
    return rc;
}

static enum err_code report_write(struct report *r, struct err *e)
{
    report_head(r);
    report_summary(r);
    enum err_code rc = report_pictures(r, e);
    if (!rc)
        rc = report_maps(r, e);
    if (!rc)
        rc = report_positions(r, e);
    report_errors(r);
    if (!rc)
        rc = report_training(r, e);
    report_dropped(r);
    buf_printf(&r->out, "</body></html>\n");
    if (!rc)
        rc = buf_check(&r->out, e);
    if (!rc)
        rc = file_write(r->o->output, r->out.data, r->out.size, e);
    if (!rc)
        printf("%s: %zu kB\n", r->o->output, r->out.size / 1000);
    return rc;
}

enum err_code cli_report(int argc, char **argv, struct err *e)
{
    struct report_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    struct report r = {.o = &o, .ground = {.gsd_m_median = (double)NAN}};
    enum err_code rc = options_parse(&report_spec, argc, argv, &o, &args, &arena, e);
    bool run = !rc && !args.done;
    if (run)
        rc = output_needed(o.output, o.overwrite, e);
    if (run && !rc)
        rc = output_apart(o.output, o.tiles, e);
    if (run && !rc) {
        signals_catch();
        r.dir = args.arg[0];
        rc = report_open(&r, e);
    }
    if (run && !rc)
        rc = report_write(&r, e);
    buf_free(&r.out);
    report_ground_free(&r.ground);
    footprint_free(&r.footprint);
    json_decref(r.told);
    scene_free(&r.scene);
    arena_free(&arena);
    return rc;
}
