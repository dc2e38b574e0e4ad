/* An orthophoto of a whole city: pixels a second, and proof that memory does not grow. Squares with
 * edges of 1, 2 and 4 km come from one store; the largest has 100 million pixels first and 1.6
 * billion at last.
 *
 * The city is that of bench_frame repeated side by side; the pyramid makes its coarser levels.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/geo/geo.h"
#include "lab/bench/bench.h"
#include "lab/bench/city.h"
#include "lod/make/pyramid.h"
#include "survey/map.h"

#include <math.h>
#include <stdio.h>

enum { MAP_SIDE = 10, /* cities along an edge */ MAP_COPY = 100000 /* Gaussians of one */ };
static const struct {
    double edge_m, gsd_m;
} map_squares[] = {{1000, 0.1}, {4000, 0.4}, {2000, 0.1}, {4000, 0.1}},
  map_quick[] = {{20, 0.1}, {40, 0.1}};

static const struct geo_origin map_origin = {8.6821, 50.1109, 160};

static enum err_code map_store(size_t side, size_t per, const char *path, struct err *e)
{
    const struct pyramid_config cfg = {.name = "bench"};
    struct pyramid_report report;
    struct gauss g = {0};
    enum err_code rc = city_square(&(struct city_size){per * side * side, side}, 0, 0, &g, e);
    const struct pyramid_level level = {.g = &g, .level = 3};
    if (!rc)
        rc = pyramid_build(&map_origin, &level, 1, &cfg, NULL, 0, path, &report, e);
    gauss_free(&g);
    return rc;
}

/* The square of this edge about the origin. */
static enum err_code map_square(struct bench *b, struct nadir *n, double edge_m, double gsd_m,
                                const char *path, struct err *e)
{
    const double lower[3] = {-0.5 * edge_m, -0.5 * edge_m, 0},
                 upper[3] = {0.5 * edge_m, 0.5 * edge_m, 0};
    double bbox[4], h;
    struct map_report r;
    char text[96];
    const struct map_request request = {.kind = GEOTIFF_COLOR, .gsd_m = gsd_m, .bbox_deg = bbox};
    enum err_code rc = geo_from_enu(&map_origin, lower, &bbox[0], &bbox[1], &h, e);
    if (!rc)
        rc = geo_from_enu(&map_origin, upper, &bbox[2], &bbox[3], &h, e);
    bool own_peak = mem_peak_reset();
    if (!rc)
        rc = map_write(n, &request, path, &r, e);
    double pixels = rc ? 0 : (double)r.grid.width * r.grid.height;
    if (!rc && !((double)r.pixels_held > 0.5 * pixels))
        rc = err_set(e, ERR_INTERNAL, "bench_map: check: most of %.0f pixels have no surface",
                     pixels);
    if (rc)
        return rc;
    snprintf(text, sizeof text, "ortho of %.4g km2 at %g m: speed", 1e-6 * edge_m * edge_m, gsd_m);
    bench_report(b, text, 1e-6 * pixels / r.seconds, "Mpx/s", 0, NULL);
    snprintf(text, sizeof text, "ortho of %.4g km2 at %g m: %s", 1e-6 * edge_m * edge_m, gsd_m,
             own_peak ? "peak memory while it ran" : "peak memory of the process so far");
    bench_report(b, text, (double)mem_peak_bytes() / 1048576.0, "MiB", 0, NULL);
    remove(path); /* the next is as large */
    return ERR_OK;
}

enum err_code bench_map(struct bench *b, struct err *e)
{
    char store[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct nadir *n = NULL;
    const struct nadir_options no = {.ceiling_m = (double)NAN};
    size_t n_squares =
        b->quick ? sizeof map_quick / sizeof *map_quick : sizeof map_squares / sizeof *map_squares;
    enum err_code rc = file_join(store, bench_tmpdir(b), "map.tiles", e);
    if (!rc)
        rc = file_join(path, bench_tmpdir(b), "ortho.tif", e);
    if (!rc)
        rc = map_store(b->quick ? 1 : MAP_SIDE, MAP_COPY, store, e);
    if (!rc)
        rc = nadir_open(store, &no, &n, e);
    if (!rc && b->edge_m > 0)
        rc = map_square(b, n, b->edge_m, 0.1, path, e);
    for (size_t i = 0; !rc && i < n_squares && !(b->edge_m > 0); i++)
        rc = map_square(b, n, b->quick ? map_quick[i].edge_m : map_squares[i].edge_m,
                        b->quick ? map_quick[i].gsd_m : map_squares[i].gsd_m, path, e);
    nadir_close(&n);
    return rc;
}
