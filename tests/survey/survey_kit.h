/* A store with known truth, for tests of drawing from straight above. The surface of the procedural
 * city is covered with Gaussians; there is haze above it, and large Gaussians lie far around.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_SURVEY_KIT_H
#define TESTS_SURVEY_KIT_H

#include "tests/kit.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/container/ckpt.h"
#include "lod/make/pyramid.h"
#include "lod/store/store.h"
#include "lod/surface/nadir.h"
#include "scene/synth/synth.h"

#define SPACING_M 0.25 /* distance between the Gaussians */
#define EXTENT_M 64
#define HAZE_M 12 /* height above the surface */
#define SURVEY_PI 3.14159265358979323846

enum { FAR = 60 };

static const struct geo_origin origin = {8.6821, 50.1109, 160};

static struct fixture {
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct synth_config cfg;
    struct synth_city city;
    struct arena arena;
    struct nadir *nadir;
} f;

/* Height of the surface that is seen from above at an ENU place. */
static inline double truth_z(double x, double y)
{
    double c = cos(f.city.yaw_rad), s = sin(f.city.yaw_rad);
    const double eye[3] = {c * x + s * y, -s * x + c * y, 500}, down[3] = {0, 0, -1};
    struct synth_hit hit;
    synth_trace_ray(&f.city, NULL, eye, down, &hit);
    return 500 - hit.t_m;
}

/* Returns whether heights of the truth within 0.6 m differ by less than within_m. */
static inline bool level_at(double x, double y, double within_m)
{
    double lo = HUGE_VAL, hi = -HUGE_VAL;
    for (int k = 0; k < 25; k++) {
        double z = truth_z(x + (k % 5 - 2) * 0.3, y + (k / 5 - 2) * 0.3);
        lo = fmin(lo, z);
        hi = fmax(hi, z);
    }
    return hi - lo < within_m;
}

static inline void put(struct gauss *g, double x, double y, double z, double sigma, double thick,
                       double opacity)
{
    size_t i = g->n++;
    const double at[3] = {x, y, z}, size[3] = {sigma, sigma, thick};
    g->quat_wxyz[4 * i] = 1;
    g->opacity_logit[i] = (float)log(opacity / (1 - opacity));
    for (size_t k = 0; k < 3; k++) {
        g->mean_m[3 * i + k] = (float)at[k];
        g->scale_log[3 * i + k] = (float)log(size[k]);
        g->quat_wxyz[4 * i + 1 + k] = 0;
        /* Red grows to the east, green to the north, up to 1. */
        g->sh[3 * i + k] = (float)(k < 2 ? at[k] / EXTENT_M / 0.28209479 : 0);
    }
}

/* Measures the shift between colours in a picture and in the city, by least squares. Red grows to
 * the east and green to the north, from 0 to 1 over EXTENT_M. The discs do not stop all light, so
 * the slope in the picture is also fitted. */
struct shown {
    double n, at[2], color[2], at_at[2], at_color[2];
};
static inline void shown_add(struct shown *s, double red, double green, const double enu[3])
{
    s->n++;
    for (size_t k = 0; k < 2; k++) {
        double c = k ? green : red;
        s->at[k] += enu[k];
        s->color[k] += c;
        s->at_at[k] += enu[k] * enu[k];
        s->at_color[k] += enu[k] * c;
    }
}
/* The shift in metres to the east (0) or north (1): where the line is 0, compared with the edge of
 * the city. */
static inline double shown_shift(const struct shown *s, size_t k)
{
    double slope = (s->n * s->at_color[k] - s->at[k] * s->color[k]) /
                   (s->n * s->at_at[k] - s->at[k] * s->at[k]);
    return (s->color[k] - slope * s->at[k]) / s->n / slope - 0.5 * EXTENT_M;
}

static inline void cover(struct gauss *g)
{
    struct err e = {0};
    size_t n = (size_t)(EXTENT_M / SPACING_M);
    kit_ok(gauss_alloc(g, n * n + n * n / 16 + FAR, 0, 0, &e), e);
    g->antialiased = true;
    for (size_t r = 0; r < n; r++)
        for (size_t c = 0; c < n; c++) {
            double x = ((double)c + 0.5) * SPACING_M - 0.5 * EXTENT_M,
                   y = ((double)r + 0.5) * SPACING_M - 0.5 * EXTENT_M, z = truth_z(x, y);
            put(g, x, y, z, 0.7 * SPACING_M, 0.02, 0.95);
            /* Haze stops less than half of the light, even where a ray meets two layers. */
            if (r % 4 == 0 && c % 4 == 0)
                put(g, x, y, z + HAZE_M, 2 * SPACING_M, 0.3, 0.15);
        }
    for (size_t i = 0; i < FAR; i++) {
        double a = 2 * SURVEY_PI * (double)i / FAR;
        put(g, 400 * cos(a), 400 * sin(a), 10, 20, 20, 0.9);
    }
}

/* Writes the store at f.path. footprint: GeoJSON to store in it, NULL: none. */
static inline void survey_make(const char *footprint)
{
    struct err e = {0};
    struct gauss g;
    kit_tmpdir(f.dir);
    kit_ok(file_join(f.path, f.dir, "city.tiles", &e), e);
    kit_ok(options_defaults(synth_options(), &f.cfg, &f.arena, &e), e);
    f.cfg.extent_m = EXTENT_M;
    kit_ok(synth_city_make(&f.cfg, &f.city, &e), e);
    cover(&g);
    const struct pyramid_config cfg = {.tile_edge_m = 30, .name = "survey", .attribution = "ours"};
    const struct pyramid_level level = {.g = &g, .level = 3};
    const struct store_blob blob = {STORE_FOOTPRINT, footprint, footprint ? strlen(footprint) : 0};
    kit_ok(pyramid_build(&origin, &level, 1, &cfg, &blob, footprint != NULL, f.path, NULL, &e), e);
    gauss_free(&g);
}

static inline void survey_open(void)
{
    struct err e = {0};
    const struct nadir_options no = {.ceiling_m = (double)NAN};
    kit_ok(nadir_open(f.path, &no, &f.nadir, &e), e);
}

static inline void survey_drop(void)
{
    nadir_close(&f.nadir);
    nadir_close(&f.nadir); /* it is idempotent */
    synth_city_free(&f.city);
    arena_free(&f.arena);
    kit_rmdir(f.dir);
}

/* Setup and teardown for tests that only read the city. */
static inline int survey_setup(void **state)
{
    survey_make(NULL);
    survey_open();
    return 0;
}

static inline int survey_teardown(void **state)
{
    survey_drop();
    return 0;
}

#endif
