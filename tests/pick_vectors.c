/* Test vectors of level selection: tests/vectors/pick.json on standard output.
 *
 * The documented rule, by brute force and without lod/: nothing here knows of heaps, node order or
 * lod/pick.c. A tile is drawn when it is not refined and all above it are. It is refined when it
 * has children and its error is above the limit: screen, geometricError f / d with d the distance
 * to its core (infinite within it; these tiles name none, so it is the box), limit 16 px times
 * error_px; distance, the threshold of its level over the horizontal distance to its box, limit 1.
 * What was refined before stays so down to 1 - hysteresis of the limit. Every camera sees every
 * tile, so that frustums play no part. Cameras at which an error is within 1e-6 of its limit are
 * not taken: rounding may decide there.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

enum { ZOOMS = 4, TILES = 1 + 4 + 16 + 64, CAMERAS = 60, WIDTH = 1600, HEIGHT = 1200 };
#define EDGE_M 400.0
#define HYSTERESIS 0.2
static const double focal_px = 500, distances_m[3] = {60, 150, 400};

struct tile {
    unsigned z, x, y;
    double lo[3], hi[3], error_m, sigma_m;
};
static struct tile tiles[TILES];

static double draw(void) /* in [0, 1), the same everywhere */
{
    static uint64_t s = 20240607;
    s = s * 6364136223846793005u + 1442695040888963407u;
    return (double)(s >> 40) / 16777216.0;
}

/* To a quarter: exact in JSON and in binary. */
static double quarter(double v)
{
    return floor(4 * v) / 4;
}

static void make_tiles(void)
{
    size_t n = 0;
    for (unsigned z = 0; z < ZOOMS; z++)
        for (unsigned x = 0; x < 1u << z; x++)
            for (unsigned y = 0; y < 1u << z; y++) {
                double edge = ldexp(EDGE_M, -(int)z);
                struct tile *t = &tiles[n++];
                *t = (struct tile){z,
                                   x,
                                   y,
                                   {x * edge - 200, 200 - (y + 1) * edge, 0},
                                   {(x + 1) * edge - 200, 200 - y * edge, 24},
                                   0,
                                   0};
                t->sigma_m = ldexp(1 + quarter(draw()), -(int)z); /* halves at least a little */
                t->error_m = 16 * t->sigma_m;
            }
}

static bool below(const struct tile *t, const struct tile *up)
{
    return t->z > up->z && t->x >> (t->z - up->z) == up->x && t->y >> (t->z - up->z) == up->y;
}

static double error_of(const struct tile *t, const double eye[3], bool by_distance, double px)
{
    double d2 = 0;
    if (t->z == ZOOMS - 1)
        return 0;
    for (int k = 0; k < (by_distance ? 2 : 3); k++) {
        double d = fmax(fmax(t->lo[k] - eye[k], eye[k] - t->hi[k]), 0);
        d2 += d * d;
    }
    double far = by_distance ? distances_m[ZOOMS - 2 - t->z] : t->error_m * focal_px / (16 * px);
    return d2 > 0 ? far / sqrt(d2) : HUGE_VAL;
}

/* Which tiles are drawn; false when rounding would decide. before NULL: no cut before. */
static bool select_tiles(const double eye[3], bool by_distance, double px, const bool *before,
                         bool *drawn)
{
    bool refined[TILES];
    for (size_t i = 0; i < TILES; i++) {
        double limit = 1, error = error_of(&tiles[i], eye, by_distance, px);
        for (size_t j = 0; before && j < TILES; j++)
            if (before[j] && below(&tiles[j], &tiles[i]))
                limit = 1 - HYSTERESIS;
        if (fabs(error - limit) < 1e-6)
            return false;
        refined[i] = error > limit;
    }
    for (size_t i = 0; i < TILES; i++) {
        drawn[i] = !refined[i];
        for (size_t j = 0; j < TILES; j++)
            drawn[i] = drawn[i] && (!below(&tiles[i], &tiles[j]) || refined[j]);
    }
    return true;
}

static void print_set(const char *name, const bool *set)
{
    const char *comma = "";
    printf(", \"%s\": [", name);
    for (size_t i = 0; i < TILES; i++)
        if (set[i]) {
            printf("%s\"%u/%u/%u\"", comma, tiles[i].z, tiles[i].x, tiles[i].y);
            comma = ", ";
        }
    printf("]");
}

int main(void)
{
    make_tiles();
    printf("{\n\"about\": \"made by tests/pick_vectors.c: tile z x y, box min e n u, box max, "
           "geometricError, sigma; cameras look down on all tiles\",\n"
           "\"focal_px\": %g, \"size_px\": [%d, %d], \"hysteresis\": %g, \"distance_m\": [%g, %g, "
           "%g],\n\"tiles\": [\n",
           focal_px, WIDTH, HEIGHT, HYSTERESIS, distances_m[0], distances_m[1], distances_m[2]);
    for (size_t i = 0; i < TILES; i++) {
        const struct tile *t = &tiles[i];
        printf("[%u, %u, %u, %.17g, %.17g, %.17g, %.17g, %.17g, %.17g, %.17g, %.17g]%s\n", t->z,
               t->x, t->y, t->lo[0], t->lo[1], t->lo[2], t->hi[0], t->hi[1], t->hi[2], t->error_m,
               t->sigma_m, i + 1 < TILES ? "," : "");
    }
    printf("],\n\"cases\": [\n");
    for (size_t made = 0; made < CAMERAS;) {
        /* 600 to 2000 m high with a picture of +-58 degrees: all of 400 m is in it. */
        double eye[3] = {quarter(300 * draw() - 150), quarter(300 * draw() - 150),
                         quarter(600 + 1400 * draw())};
        double moved[3] = {eye[0] + quarter(40 * draw()), eye[1], eye[2] * 1.125};
        bool first[TILES], plain[TILES], held[TILES], by_distance = made % 3 == 2;
        double px = ldexp(1, -(int)(6 * draw())) / 2;
        if (!select_tiles(eye, by_distance, px, NULL, first) ||
            !select_tiles(moved, by_distance, px, NULL, plain) ||
            !select_tiles(moved, by_distance, px, first, held))
            continue;
        printf("%s{\"metric\": \"%s\", \"error_px\": %.17g, \"eye\": [%.17g, %.17g, %.17g], "
               "\"then\": [%.17g, %.17g, %.17g]",
               made ? ",\n" : "", by_distance ? "distance" : "screen", px, eye[0], eye[1], eye[2],
               moved[0], moved[1], moved[2]);
        print_set("picked", first);
        print_set("picked_then", plain);
        print_set("picked_then_with_hysteresis", held);
        printf("}");
        made++;
    }
    printf("\n]\n}\n");
    return 0;
}
