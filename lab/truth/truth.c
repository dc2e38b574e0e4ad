/* citysplat-lab truth: an orthophoto or a surface model against the procedural city that it shows.
 * An orthophoto is compared with the city's own picture, drawn on its pixels.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>

#include "cli/base/output.h"
#include "codec/image/image.h"
#include "core/geo/geo.h"
#include "lab/lab.h"
#include "lab/truth/synth_map.h"
#include "lab/truth/truth_config.h"
#include "lab/truth/truth_heights.h"
#include "survey/sheet.h"

enum { TRUTH_SUPERSAMPLE = 3 /* rays per pixel and axis at least, as map views have them */ };

struct truth_score {
    /* pixels of the orthophoto with a value; those of them in the built-up square */
    uint64_t pixels, inside;
    double psnr_db, inside_psnr_db; /* NAN: no pixels */
};
struct truth_job {
    const struct truth_request *q;
    struct synth_config cfg; /* of the city */
    struct synth_city city;
    struct geo_origin origin;
    struct sheet *map;
    struct geotiff *out; /* NULL: none */
    uint8_t *rgba;       /* of a piece of the orthophoto, then of the truth */
    double error[2];     /* sums of squares: of all, of what is inside */
    uint64_t pixels[2];
};

static enum err_code truth_corners(const struct truth_job *j, uint32_t x, uint32_t y,
                                   const uint32_t size[2], double at[4][2], struct err *e)
{
    const struct map_grid *g = sheet_grid(j->map);
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < 4; i++) {
        double lon = g->west_m + (double)(x + (i & 1) * size[0]) * g->pixel_m,
               lat = g->north_m - (double)(y + (i >> 1) * size[1]) * g->pixel_m, enu[3];
        rc = crs_unproject(sheet_crs(j->map), 1, &lon, &lat, e);
        if (!rc)
            rc = geo_to_enu(&j->origin, lon, lat, j->origin.h_m, enu, e);
        at[i][0] = enu[0];
        at[i][1] = enu[1];
    }
    return rc;
}

/* Compare, and leave the truth with the orthophoto's alpha in rgba. */
static void truth_compare(struct truth_job *j, const struct image *truth, const double at[4][2])
{
    double cs = cos(j->city.yaw_rad), sn = sin(j->city.yaw_rad), half = j->city.half_m;
    size_t w = truth->width_px, h = truth->height_px;
    for (size_t i = 0; i < w * h; i++) {
        uint8_t *px = j->rgba + 4 * i;
        double s = ((double)(i % w) + 0.5) / (double)w, t = ((double)(i / w) + 0.5) / (double)h,
               p[2], sum = 0;
        for (size_t k = 0; k < 2; k++)
            p[k] = (1 - t) * ((1 - s) * at[0][k] + s * at[1][k]) +
                   t * ((1 - s) * at[2][k] + s * at[3][k]);
        bool inside = fabs(cs * p[0] + sn * p[1]) <= half && fabs(-sn * p[0] + cs * p[1]) <= half;
        for (size_t k = 0; k < 3; k++) {
            double d = (double)px[k] - (double)truth->px[3 * i + k];
            sum += d * d;
            px[k] = px[3] ? truth->px[3 * i + k] : 0;
        }
        for (size_t k = 0; px[3] && k < 1 + (size_t)inside; k++) {
            j->error[k] += sum;
            j->pixels[k]++;
        }
    }
}

static enum err_code truth_piece(struct truth_job *j, uint32_t x, uint32_t y, struct err *e)
{
    const struct map_grid *g = sheet_grid(j->map);
    const uint32_t size[2] = {g->width - x < MAP_PIECE_PX ? g->width - x : MAP_PIECE_PX,
                              g->height - y < MAP_PIECE_PX ? g->height - y : MAP_PIECE_PX};
    struct image truth = {0};
    double at[4][2];
    bool any = false;
    int rays = j->cfg.supersample > TRUTH_SUPERSAMPLE ? (int)j->cfg.supersample : TRUTH_SUPERSAMPLE;
    enum err_code rc = sheet_read(j->map, x, y, size[0], size[1], j->rgba, e);
    for (size_t i = 0; !rc && !any && i < (size_t)size[0] * size[1]; i++)
        any = j->rgba[4 * i + 3];
    if (rc || !any)
        return rc;
    rc = truth_corners(j, x, y, size, at, e);
    if (!rc)
        rc = synth_map_draw(&j->city, (const double(*)[2])at, size, rays, j->cfg.lens_blur_px,
                            &truth, e);
    if (!rc)
        truth_compare(j, &truth, (const double(*)[2])at);
    if (!rc && j->out)
        rc = geotiff_write(j->out, x, y, size[0], size[1], j->rgba, e);
    image_free(&truth);
    return rc;
}

static enum err_code truth_draw(struct truth_job *j, struct err *e)
{
    const struct map_grid *g = sheet_grid(j->map);
    struct progress bar;
    uint64_t done = 0;
    enum err_code rc = ERR_OK;
    j->rgba = mem_array((size_t)MAP_PIECE_PX * MAP_PIECE_PX, 4);
    if (!j->rgba)
        return err_set(e, ERR_MEM, "out of memory for a piece of %d px", MAP_PIECE_PX);
    progress_start(&bar, "draw the city from above, rows", g->height);
    for (uint32_t y = 0; !rc && y < g->height; y += MAP_PIECE_PX) {
        for (uint32_t x = 0; !rc && x < g->width; x += MAP_PIECE_PX)
            rc = truth_piece(j, x, y, e);
        done += g->height - y < MAP_PIECE_PX ? g->height - y : MAP_PIECE_PX;
        progress_step(&bar, done, NULL);
    }
    progress_end(&bar, NULL);
    if (!rc && !j->pixels[0])
        rc = err_set(e, ERR_DATA, "%s: nothing is shown in it", j->q->map);
    return rc;
}

static enum err_code truth_create(struct truth_job *j, const char *path, struct err *e)
{
    struct geotiff_info info = sheet_info(j->map);
    info.source = "procedural city";
    return path ? geotiff_create(path, GEOTIFF_COLOR, &info, &j->out, e) : ERR_OK;
}

static double truth_psnr(double sum, uint64_t pixels)
{
    return pixels ? -10 * log10(fmax(sum, 1e-9) / (3.0 * (double)pixels * 255 * 255)) : (double)NAN;
}

static enum err_code truth_map(const struct truth_request *q, struct truth_score *out,
                               struct err *e)
{
    struct truth_job j = {.q = q};
    struct arena arena = {0};
    enum err_code rc = truth_config(q->city, &j.cfg, &arena, e);
    if (!rc)
        rc = synth_city_make(&j.cfg, &j.city, e);
    j.origin = (struct geo_origin){j.cfg.lon_deg, j.cfg.lat_deg, j.cfg.ground_h_m};
    if (!rc)
        rc = sheet_open(q->map, GEOTIFF_COLOR, &j.map, e);
    if (!rc)
        rc = truth_create(&j, q->output, e);
    if (!rc)
        rc = truth_draw(&j, e);
    if (!rc && j.out)
        rc = geotiff_commit(&j.out, e);
    *out = (struct truth_score){j.pixels[0], j.pixels[1], truth_psnr(j.error[0], j.pixels[0]),
                                truth_psnr(j.error[1], j.pixels[1])};
    geotiff_close(&j.out);
    sheet_close(&j.map);
    synth_city_free(&j.city);
    mem_free(j.rgba);
    arena_free(&arena);
    return rc;
}

/* Completeness: what has a surface within so many GSD of the city's. */
static void truth_print_heights(const char *where, const struct surface_figures *f)
{
    printf("%-6s %10zu %9.3f %9.3f %7.3f %7.3f %7.3f %7.3f %9.2f %8.2f %8.2f %8.2f\n", where, f->n,
           f->median_m, f->off_m, f->rmse_m, f->nmad_m, f->le90_m, f->le95_m, 100 * f->above[4],
           100 - 100 * f->above[0], 100 - 100 * f->above[1], 100 - 100 * f->above[2]);
}

static void truth_print_sigma(const char *where, const struct truth_sigma *s)
{
    if (s->n)
        printf("sigma   %s: %zu pixels, median %.3f m; %.1f, %.1f and %.1f %% of the errors within "
               "1, 2 and 3; median of error over sigma %.2f\n",
               where, s->n, s->median_m, 100 * s->within[0], 100 * s->within[1], 100 * s->within[2],
               s->ratio_middle);
}

static enum err_code truth_tell_heights(const struct truth_request *q, struct err *e)
{
    struct truth_heights t;
    enum err_code rc = truth_heights(q, &t, e);
    if (rc)
        return rc;
    printf(
        "%s: %llu pixels of %g m within the built-up square, %llu of them without a surface; GSD "
        "of the photographs %.3f m\n",
        q->map, (unsigned long long)t.inside, t.pixel_m, (unsigned long long)t.none, t.gsd_m);
    printf("%-6s %10s %9s %9s %7s %7s %7s %7s %9s %8s %8s %8s\n", "places", "pixels", "median m",
           "signed m", "RMSE m", "NMAD m", "LE90 m", "LE95 m", "> 1 m %", "1 GSD %", "2 GSD %",
           "5 GSD %");
    truth_print_heights(q->ground ? "seen" : "level", &t.level);
    truth_print_heights(q->ground ? "below" : "edges", &t.zone);
    truth_print_heights("all", &t.all);
    truth_print_sigma(q->ground ? "seen" : "level", &t.sigma[0]);
    truth_print_sigma(q->ground ? "below" : "edges", &t.sigma[1]);
    truth_print_sigma("all", &t.sigma[2]);
    if (q->ground)
        return ERR_OK;
    printf("walls   %zu steps of 3 m and more, %zu of them missing: off by median %.2f px, 95 %% "
           "%.2f px; %.1f %% within 2 px; roofs reach out by %+.2f px (%+.3f m)\n"
           "volume  %+.0f m3 against the city\n",
           t.edges, t.missing, t.edge.median_px, t.edge.most_px, 100 * t.edge.within_2_px,
           t.edge.out_px, t.edge.out_px * t.pixel_m, t.volume_m3);
    return ERR_OK;
}

static enum err_code truth_tell(const struct truth_request *q, struct err *e)
{
    struct truth_score s;
    enum err_code rc = truth_map(q, &s, e);
    if (rc == ERR_FORMAT) { /* no orthophoto: heights, or the first reason counts */
        struct err why = *e;
        enum err_code heights = truth_tell_heights(q, e);
        if (heights != ERR_FORMAT)
            return heights;
        *e = why;
    }
    if (!rc)
        printf("%s: PSNR %.2f dB over %llu pixels; %.2f dB over %llu within the built-up square\n",
               q->map, s.psnr_db, (unsigned long long)s.pixels, s.inside_psnr_db,
               (unsigned long long)s.inside);
    return rc;
}

struct truth_options {
#define OPT OPTIONS_MEMBER
#include "lab/truth/truth.def"
};

static const struct options_def truth_defs[] = {
#define OPT(...) OPTIONS_ROW(struct truth_options, __VA_ARGS__)
#include "lab/truth/truth.def"
};

enum err_code lab_truth(int argc, char **argv, struct err *e)
{
    const struct options_spec spec = {
        .command = "truth",
        .usage = "citysplat-lab truth CITY MAP.tif [options]",
        .about = "Compares a map with the procedural city that `citysplat-lab synth` made in the "
                 "folder CITY. Of an orthophoto (`citysplat ortho`) it prints the PSNR, of a "
                 "surface model (`citysplat dsm`) the errors of heights and edges.",
        .example = "citysplat-lab truth city dsm.tif -o errors.tif",
        .defs = truth_defs,
        .n_defs = sizeof truth_defs / sizeof *truth_defs,
        .min_args = 2,
        .max_args = 2};
    struct arena a = {0};
    struct truth_options o;
    struct options_args args;
    enum err_code rc = options_parse(&spec, argc, argv, &o, &args, &a, e);
    if (rc || args.done)
        goto out;
    signals_catch();
    const struct truth_request q = {args.arg[0], args.arg[1], o.output, o.ground};
    rc = output_apart(o.output, args.arg[1], e);
    if (!rc)
        rc = truth_tell(&q, e);
out:
    arena_free(&a);
    return rc;
}
