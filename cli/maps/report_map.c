/* Maps of a survey report: see report_map.h. Grids are small PNGs that the browser enlarges.
 * Cameras and arrows are SVG on top, so that they are sharp in print.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/maps/report_map.h"

#include <math.h>
#include <string.h>

#include "core/math/sort.h"
#include "core/splat/camera.h"

enum { MAP_WIDTH_PX = 520, MAP_CAMERAS_MAX = 3000, MAP_SAMPLES = 100000 };

static const uint8_t view_colors[REPORT_VIEWS][3] = {
    {255, 255, 255}, {215, 48, 39}, {253, 174, 97}, {255, 240, 150}, {145, 207, 96}, {26, 152, 80}};
static const char *const view_names[REPORT_VIEWS] = {"none",   "1",      "2",
                                                     "3 to 4", "5 to 9", "10 and more"};
/* From fine to coarse; and of heights, from low to high. Light and dark as well, for grey print. */
static const uint8_t ramp[5][3] = {
    {68, 1, 84}, {59, 82, 139}, {33, 145, 140}, {94, 201, 98}, {253, 231, 37}};

static void report_ramp(double t, uint8_t rgb[3])
{
    double at = fmin(fmax(t, 0), 1) * 4;
    size_t i = (size_t)fmin(floor(at), 3);
    for (size_t k = 0; k < 3; k++)
        rgb[k] = (uint8_t)(ramp[i][k] + (at - (double)i) * (ramp[i + 1][k] - ramp[i][k]) + 0.5);
}

/* ---- the ground ---- */

static void report_widen(double box[4], double east_m, double north_m)
{
    box[0] = fmin(box[0], east_m);
    box[1] = fmin(box[1], north_m);
    box[2] = fmax(box[2], east_m);
    box[3] = fmax(box[3], north_m);
}

static size_t report_class(size_t views)
{
    return views < 3 ? views : views < 5 ? 3 : views < 10 ? 4 : 5;
}

/* Metres on the ground a pixel, of the photograph that resolves the place best; NAN: none shows
 * it. */
static double report_gsd_at(const struct scene *s, const double at[3])
{
    double best = HUGE_VAL;
    for (size_t i = 0; i < s->n_images; i++) {
        const struct camera *c = &s->images[i].cam;
        double depth_m;
        if (camera_frames(c, at, 0.0, &depth_m))
            best = fmin(best, depth_m / c->fx_px);
    }
    return isfinite(best) ? best : (double)NAN;
}

enum err_code report_ground_of(const struct scene *s, const struct footprint *f,
                               struct report_ground *out, struct err *e)
{
    size_t n = f->nx * f->ny, inside = 0, known = 0;
    double *sorted = mem_array(n, sizeof *sorted);
    *out = (struct report_ground){.footprint = f,
                                  .gsd_m_low = (double)NAN,
                                  .gsd_m_median = (double)NAN,
                                  .gsd_m_high = (double)NAN,
                                  .box_m = {HUGE_VAL, HUGE_VAL, -HUGE_VAL, -HUGE_VAL}};
    out->gsd_m = mem_array(n, sizeof *out->gsd_m);
    if (!sorted || !out->gsd_m) {
        mem_free(sorted);
        report_ground_free(out);
        return err_set(e, ERR_MEM, "report: out of memory for %zu cells", n);
    }
    for (size_t i = 0; i < n; i++) {
        const double at[3] = {f->corner_m[0] + ((double)(i % f->nx) + 0.5) * f->cell_m,
                              f->corner_m[1] + ((double)(i / f->nx) + 0.5) * f->cell_m,
                              (double)f->ground_m[i]};
        out->gsd_m[i] = f->views[i] ? (float)report_gsd_at(s, at) : NAN;
        if (f->views[i])
            report_widen(out->box_m, at[0], at[1]);
        if (!f->inside[i])
            continue;
        inside++;
        out->share[report_class(f->views[i])] += 1;
        if (isfinite(out->gsd_m[i]))
            sorted[known++] = (double)out->gsd_m[i];
    }
    for (size_t k = 0; inside && k < REPORT_VIEWS; k++)
        out->share[k] /= (double)inside;
    for (size_t i = 0; i < s->n_images; i++) {
        double c[3];
        camera_center(&s->images[i].cam, c);
        report_widen(out->box_m, c[0], c[1]);
    }
    out->area_m2 = (double)inside * f->cell_m * f->cell_m;
    if (known) {
        sort_doubles(sorted, known);
        out->gsd_m_low = sorted[known / 20];
        out->gsd_m_median = sorted[known / 2];
        out->gsd_m_high = sorted[known - 1 - known / 20];
    }
    mem_free(sorted);
    return ERR_OK;
}

void report_ground_free(struct report_ground *g)
{
    mem_free(g->gsd_m);
    *g = (struct report_ground){0};
}

/* ---- pictures ---- */

static enum err_code report_data(const struct image *img, const char *format, struct buf *out,
                                 struct err *e)
{
    struct buf b = {0};
    enum err_code rc = image_encode(img, format, 85, &b, e);
    if (!rc) {
        buf_printf(out, "data:image/%s;base64,", strcmp(format, "jpg") ? format : "jpeg");
        uint8_t *to = buf_grow(out, base64_room(b.size)); /* its NUL is not kept */
        if (to)
            out->size -=
                base64_room(b.size) - base64_write(b.data, b.size, BASE64_PADDED, (char *)to);
    }
    buf_free(&b);
    return rc;
}

enum err_code report_map_image(const struct image *img, const char *format, const char *style,
                               struct buf *out, struct err *e)
{
    buf_printf(out, "<img style=\"%s\" alt=\"\" src=\"", style);
    enum err_code rc = report_data(img, format, out, e);
    buf_printf(out, "\">\n");
    return rc;
}

/* ---- a map ---- */

struct report_frame { /* metres to pixels of the SVG */
    double corner_m[2], px_per_m, w, h;
};

static double report_x(const struct report_frame *m, double east_m)
{
    return (east_m - m->corner_m[0]) * m->px_per_m;
}

static double report_y(const struct report_frame *m, double north_m)
{
    return m->h - (north_m - m->corner_m[1]) * m->px_per_m;
}

static struct report_frame report_frame_of(const struct report_ground *g)
{
    const double *b = g->box_m;
    double margin = 0.04 * fmax(b[2] - b[0], b[3] - b[1]) + g->footprint->cell_m,
           wide = b[2] - b[0] + 2 * margin, high = b[3] - b[1] + 2 * margin;
    return (struct report_frame){{b[0] - margin, b[1] - margin},
                                 MAP_WIDTH_PX / wide,
                                 MAP_WIDTH_PX,
                                 MAP_WIDTH_PX * high / wide};
}

/* The grid as a picture; paint gives a cell's colour, false leaves it white. */
static enum err_code report_grid(const struct report_ground *g,
                                 bool (*paint)(const struct report_ground *, size_t, uint8_t[3]),
                                 struct buf *out, struct err *e)
{
    const struct footprint *f = g->footprint;
    struct report_frame m = report_frame_of(g);
    struct image img = {0};
    enum err_code rc = image_alloc((uint32_t)f->nx, (uint32_t)f->ny, 3, &img, e);
    for (size_t i = 0; !rc && i < f->nx * f->ny; i++) {
        uint8_t *px = img.px + 3 * ((f->ny - 1 - i / f->nx) * f->nx + i % f->nx);
        if (!paint(g, i, px))
            memset(px, 255, 3);
    }
    buf_printf(out,
               "<svg class=\"map\" viewBox=\"0 0 %.0f %.0f\"><image x=\"%.2f\" y=\"%.2f\" "
               "width=\"%.2f\" height=\"%.2f\" preserveAspectRatio=\"none\" "
               "style=\"image-rendering:pixelated\" href=\"",
               m.w, m.h, report_x(&m, f->corner_m[0]),
               report_y(&m, f->corner_m[1] + (double)f->ny * f->cell_m),
               (double)f->nx * f->cell_m * m.px_per_m, (double)f->ny * f->cell_m * m.px_per_m);
    if (!rc)
        rc = report_data(&img, "png", out, e);
    buf_printf(out, "\"/>\n");
    image_free(&img);
    return rc;
}

/* The border of what is supported, cell by cell, and a scale bar. */
static void report_finish(const struct report_ground *g, struct buf *out)
{
    const struct footprint *f = g->footprint;
    struct report_frame m = report_frame_of(g);
    double cell = f->cell_m * m.px_per_m, wide = 0.25 * m.w / m.px_per_m,
           ten = pow(10, floor(log10(wide))),
           bar = ten * (wide / ten >= 5   ? 5
                        : wide / ten >= 2 ? 2
                                          : 1);
    buf_printf(out, "<path fill=\"none\" stroke=\"#222\" stroke-width=\"1\" d=\"");
    for (size_t y = 0; y < f->ny; y++)
        for (size_t x = 0; x < f->nx; x++) {
            size_t i = y * f->nx + x;
            double left = report_x(&m, f->corner_m[0] + (double)x * f->cell_m),
                   top = report_y(&m, f->corner_m[1] + (double)(y + 1) * f->cell_m);
            bool in = f->inside[i];
            if (in != (x > 0 && f->inside[i - 1]))
                buf_printf(out, "M%.1f %.1fv%.1f", left, top, cell);
            if (in != (y > 0 && f->inside[i - f->nx]))
                buf_printf(out, "M%.1f %.1fh%.1f", left, top + cell, cell);
        }
    buf_printf(out,
               "\"/>\n<path stroke=\"#000\" stroke-width=\"3\" d=\"M10 %.1fh%.1f\"/>"
               "<text x=\"10\" y=\"%.1f\">%g m</text></svg>\n",
               m.h - 10, bar * m.px_per_m, m.h - 16, bar);
}

static void report_cameras(const struct scene *s, const struct report_ground *g, struct buf *out)
{
    struct report_frame m = report_frame_of(g);
    size_t step = s->n_images / MAP_CAMERAS_MAX + 1;
    for (size_t i = 0; i < s->n_images; i += step) {
        double c[3];
        camera_center(&s->images[i].cam, c);
        buf_printf(out, "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"2.2\" class=\"%s\"/>",
                   report_x(&m, c[0]), report_y(&m, c[1]),
                   s->images[i].split == SCENE_TEST ? "test" : "train");
    }
}

static void report_swatch(const uint8_t rgb[3], const char *name, struct buf *out)
{
    buf_printf(out, "<span class=\"key\"><i style=\"background:#%02x%02x%02x\"></i>%s</span>\n",
               rgb[0], rgb[1], rgb[2], name);
}

static bool report_paint_views(const struct report_ground *g, size_t i, uint8_t rgb[3])
{
    memcpy(rgb, view_colors[report_class(g->footprint->views[i])], 3);
    return g->footprint->views[i] > 0;
}

enum err_code report_map_coverage(const struct scene *s, const struct report_ground *g,
                                  struct buf *out, struct err *e)
{
    enum err_code rc = report_grid(g, report_paint_views, out, e);
    report_cameras(s, g, out);
    report_finish(g, out);
    buf_printf(out, "<p class=\"legend\">Training photographs that show the ground: ");
    for (size_t k = 1; k < REPORT_VIEWS; k++)
        report_swatch(view_colors[k], view_names[k], out);
    buf_printf(out, "</p>\n<table><tr><th>photographs</th>");
    for (size_t k = 2; k < REPORT_VIEWS; k++)
        buf_printf(out, "<th>%s</th>", view_names[k]);
    buf_printf(out, "</tr><tr><td>share of the supported ground</td>");
    for (size_t k = 2; k < REPORT_VIEWS; k++)
        buf_printf(out, "<td>%.1f %%</td>", 100 * g->share[k]);
    buf_printf(out, "</tr></table>\n");
    return rc;
}

static bool report_paint_gsd(const struct report_ground *g, size_t i, uint8_t rgb[3])
{
    double range = g->gsd_m_high - g->gsd_m_low, v = (double)g->gsd_m[i];
    report_ramp(range > 0 ? (v - g->gsd_m_low) / range : 0, rgb);
    return isfinite(v) && g->footprint->inside[i];
}

static void report_ramp_legend(const char *what, double low, double high, const char *unit,
                               struct buf *out)
{
    buf_printf(out, "<p class=\"legend\">%s: %.3g %s <i class=\"ramp\"></i> %.3g %s</p>\n", what,
               low, unit, high, unit);
}

enum err_code report_map_gsd(const struct scene *s, const struct report_ground *g, struct buf *out,
                             struct err *e)
{
    (void)s;
    enum err_code rc = report_grid(g, report_paint_gsd, out, e);
    report_finish(g, out);
    report_ramp_legend("Ground sampling distance", 100 * g->gsd_m_low, 100 * g->gsd_m_high, "cm",
                       out);
    return rc;
}

static bool report_paint_ground(const struct report_ground *g, size_t i, uint8_t rgb[3])
{
    rgb[0] = rgb[1] = rgb[2] = 236;
    return g->footprint->inside[i];
}

/* A round number that makes the arrow of this length about a tenth of the map. */
static double report_times(const struct report_ground *g, double usual_m)
{
    double wish = 0.06 * (g->box_m[2] - g->box_m[0]) / usual_m, ten;
    if (!(usual_m > 1e-6) || !(wish > 1))
        return 1;
    ten = pow(10, floor(log10(wish)));
    return ten * (wish / ten >= 5 ? 5 : wish / ten >= 2 ? 2 : 1);
}

enum err_code report_map_residuals(const struct scene *s, const struct report_ground *g,
                                   struct buf *out, struct err *e)
{
    struct report_frame m = report_frame_of(g);
    double *length = mem_array(s->n_images + 1, sizeof *length);
    size_t n = 0, step = s->n_images / MAP_CAMERAS_MAX + 1;
    enum err_code rc = length ? ERR_OK : err_set(e, ERR_MEM, "report: out of memory");
    for (size_t i = 0; !rc && i < s->n_images; i++)
        if (isfinite(s->images[i].residual_m))
            length[n++] = s->images[i].residual_m;
    double times = n ? report_times(g, sort_median(length, n)) : 1;
    mem_free(length);
    if (!rc)
        rc = report_grid(g, report_paint_ground, out, e);
    for (size_t i = 0; !rc && i < s->n_images; i += step) {
        const struct scene_image *img = &s->images[i];
        double c[3];
        camera_center(&img->cam, c);
        if (!isfinite(img->gps_enu_m[0]))
            continue;
        buf_printf(out,
                   "<path class=\"arrow\" d=\"M%.1f %.1fL%.1f %.1f\"/><circle cx=\"%.1f\" "
                   "cy=\"%.1f\" r=\"2\" class=\"train\"/>",
                   report_x(&m, c[0]), report_y(&m, c[1]),
                   report_x(&m, c[0] + times * (img->gps_enu_m[0] - c[0])),
                   report_y(&m, c[1] + times * (img->gps_enu_m[1] - c[1])), report_x(&m, c[0]),
                   report_y(&m, c[1]));
    }
    report_finish(g, out);
    buf_printf(out,
               "<p class=\"legend\">From each camera to its GPS position in plan, %g times as "
               "long.</p>\n",
               times);
    return rc;
}

/* ---- heights ---- */

static void report_height_range(const float *height_m, size_t n, float none, double *low,
                                double *high, double *sorted)
{
    size_t known = 0, step = n / MAP_SAMPLES + 1;
    for (size_t i = 0; i < n; i += step)
        if (height_m[i] > none)
            sorted[known++] = (double)height_m[i];
    *low = *high = (double)NAN;
    if (!known)
        return;
    sort_doubles(sorted, known);
    *low = sorted[known / 50];
    *high = sorted[known - 1 - known / 50];
}

enum err_code report_map_relief(const float *height_m, uint32_t w, uint32_t h, double pixel_m,
                                float none, struct image *out, double range_m[2], struct err *e)
{
    static const double sun[3] = {-0.5, 0.5, 0.707}; /* from the north-west, as maps have it */
    size_t n = (size_t)w * h;
    double *sorted = mem_array(MAP_SAMPLES + 1, sizeof *sorted);
    enum err_code rc = sorted ? image_alloc(w, h, 3, out, e)
                              : err_set(e, ERR_MEM, "report: out of memory for heights");
    if (!rc)
        report_height_range(height_m, n, none, &range_m[0], &range_m[1], sorted);
    for (size_t i = 0; !rc && i < n; i++) {
        uint8_t *px = out->px + 3 * i;
        size_t x = i % w, left = x ? i - 1 : i, up = i >= w ? i - w : i;
        double here = (double)height_m[i];
        memset(px, 255, 3);
        if (!(height_m[i] > none))
            continue;
        double dx = height_m[left] > none ? (here - (double)height_m[left]) / pixel_m : 0,
               dy = height_m[up] > none ? ((double)height_m[up] - here) / pixel_m : 0,
               shade = (-dx * sun[0] - dy * sun[1] + sun[2]) / sqrt(1 + dx * dx + dy * dy);
        report_ramp((here - range_m[0]) / fmax(range_m[1] - range_m[0], 1e-3), px);
        for (size_t k = 0; k < 3; k++)
            px[k] = (uint8_t)fmin(px[k] * (0.45 + 0.75 * fmax(shade, 0)) + 20, 255);
    }
    mem_free(sorted);
    return rc;
}

void report_map_relief_legend(double low_m, double high_m, struct buf *out)
{
    report_ramp_legend("Height", low_m, high_m, "m", out);
}
