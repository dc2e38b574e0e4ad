/* Test vectors of level selection: writes tests/vectors/pick.json to standard output.
 *
 * It applies the documented rule by brute force and without lod/choose/pick.c. A tile's parent is
 * its nearest ancestor that exists. A tile is refined if it has children and its error is above the
 * limit. Screen metric: the error is geometricError f / d with d the distance to its core (infinite
 * inside), the limit 16 px times error_px. Distance metric: the error is the threshold of its zoom
 * over the horizontal distance to its core, the limit 1. A tile that was refined before stays
 * refined down to 1 - hysteresis of the limit. The tile with the largest error is refined first. A
 * tile whose children would break a budget is not refined. Tiles that are not refined, below
 * refined ones, and in view, are drawn.
 *
 * Rounding must not decide what is in view. Cameras are used only if every relevant tile has a
 * point well inside the picture or lies metres beyond one of its borders, and if no error is within
 * 1e-6 of its limit. Directions are Pythagorean, so no sine is computed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

enum { ZOOMS = 4, TILES = 1 + 4 + 16 + 64, NONE = -1 };
enum { WIDTH = 1600, HEIGHT = 1200 };
#define EDGE_M 400.0
#define HYSTERESIS 0.2
#define CLEAR_M 6.0 /* beyond a border: more than splats reach out of their boxes here */
#define CORE_M 12.0
static const double focal_px = 500, distances_m[3] = {60, 150, 400};

struct tile {
    unsigned z, x, y, count, bytes;
    double lo[3], hi[3], core_lo[3], core_hi[3], error_m, sigma_m;
    int parent;
    bool leaf;
};
struct scene {
    const char *name;
    struct tile tile[TILES];
    int n;
};
struct camera {
    double eye[3], rot[9]; /* world to camera: x right, y down, z ahead */
};
struct rule {
    bool by_distance;
    double error_px, hysteresis;
    unsigned long max_gaussians, max_bytes; /* 0: none */
};

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

static bool is_below(const struct tile *t, const struct tile *up)
{
    return t->z > up->z && t->x >> (t->z - up->z) == up->x && t->y >> (t->z - up->z) == up->y;
}

/* Every fourth tile but the root may be missing; cores are the boxes or `core_m` smaller. */
static void make_scene(struct scene *s, const char *name, double missing, double core_m)
{
    s->name = name;
    s->n = 0;
    for (unsigned z = 0; z < ZOOMS; z++)
        for (unsigned y = 0; y < 1u << z; y++)
            for (unsigned x = 0; x < 1u << z; x++) {
                double edge = ldexp(EDGE_M, -(int)z);
                struct tile *t = &s->tile[s->n];
                *t = (struct tile){.z = z,
                                   .x = x,
                                   .y = y,
                                   .lo = {x * edge - 200, 200 - (y + 1) * edge, 0},
                                   .hi = {(x + 1) * edge - 200, 200 - y * edge, 24},
                                   .leaf = true,
                                   .parent = NONE};
                for (int k = 0; k < 3; k++) {
                    t->core_lo[k] = t->lo[k] + (k < 2 ? core_m : core_m / 6);
                    t->core_hi[k] = t->hi[k] - (k < 2 ? core_m : core_m);
                }
                t->sigma_m = ldexp(1 + quarter(draw()), -(int)z); /* halves at least a little */
                t->error_m = 16 * t->sigma_m;
                t->count = 100 + (unsigned)(900 * draw());
                t->bytes = t->count * (20 + (unsigned)(10 * draw()));
                s->n += z == 0 || draw() >= missing;
            }
    for (int i = 0; i < s->n; i++)
        for (int j = 0; j < i; j++) /* the last one found is the nearest */
            if (is_below(&s->tile[i], &s->tile[j]))
                s->tile[i].parent = j;
    for (int i = 1; i < s->n; i++)
        s->tile[s->tile[i].parent].leaf = false;
}

/* ---- in view, beyond doubt ---- */

static void to_camera(const struct camera *c, const double p[3], double out[3])
{
    for (int r = 0; r < 3; r++) {
        out[r] = 0;
        for (int k = 0; k < 3; k++)
            out[r] += c->rot[3 * r + k] * (p[k] - c->eye[k]);
    }
}

static bool has_point_inside(const struct camera *c, const struct tile *t)
{
    enum { STEPS = 9 };
    for (int i = 0; i < STEPS * STEPS * STEPS; i++) {
        const int at[3] = {i % STEPS, i / STEPS % STEPS, i / STEPS / STEPS};
        double p[3], q[3];
        for (int k = 0; k < 3; k++)
            p[k] = t->lo[k] + (t->hi[k] - t->lo[k]) * at[k] / (STEPS - 1);
        to_camera(c, p, q);
        if (q[2] > 1 && fabs(q[0]) * focal_px < 0.495 * WIDTH * q[2] &&
            fabs(q[1]) * focal_px < 0.495 * HEIGHT * q[2])
            return true;
    }
    return false;
}

static bool is_far_outside(const struct camera *c, const struct tile *t)
{
    const double tan_x = WIDTH / 2.0 / focal_px, tan_y = HEIGHT / 2.0 / focal_px;
    double least[5] = {HUGE_VAL, HUGE_VAL, HUGE_VAL, HUGE_VAL, HUGE_VAL};
    for (int i = 0; i < 8; i++) {
        double p[3], q[3];
        for (int k = 0; k < 3; k++)
            p[k] = i >> k & 1 ? t->hi[k] : t->lo[k];
        to_camera(c, p, q);
        const double out[5] = {(q[0] - tan_x * q[2]) / sqrt(1 + tan_x * tan_x),
                               (-q[0] - tan_x * q[2]) / sqrt(1 + tan_x * tan_x),
                               (q[1] - tan_y * q[2]) / sqrt(1 + tan_y * tan_y),
                               (-q[1] - tan_y * q[2]) / sqrt(1 + tan_y * tan_y), -q[2]};
        for (int j = 0; j < 5; j++)
            least[j] = fmin(least[j], out[j] - 0.02 * fabs(q[2]));
    }
    for (int j = 0; j < 5; j++)
        if (least[j] > CLEAR_M)
            return true;
    return false;
}

/* ---- the rule ---- */

static double error_of(const struct tile *t, const double eye[3], const struct rule *r)
{
    double d2 = 0;
    if (t->leaf)
        return 0;
    for (int k = 0; k < (r->by_distance ? 2 : 3); k++) {
        double d = fmax(fmax(t->core_lo[k] - eye[k], eye[k] - t->core_hi[k]), 0);
        d2 += d * d;
    }
    double far =
        r->by_distance ? distances_m[ZOOMS - 2 - t->z] : t->error_m * focal_px / (16 * r->error_px);
    return d2 > 0 ? far / sqrt(d2) : HUGE_VAL;
}

struct look { /* of a tile, in one selection */
    double error;
    bool seen, refined, candidate, settled;
};

/* Limit of tile i: lower where it was refined in the picture before. */
static double limit_of(const struct scene *s, int i, const struct rule *r, const bool *before)
{
    for (int j = 0; before && j < s->n; j++)
        if (before[j] && is_below(&s->tile[j], &s->tile[i]))
            return 1 - r->hysteresis;
    return 1;
}

/* Refine tile i unless its children break a budget. False: it is in doubt whether one is seen. */
static bool refine(const struct scene *s, int i, const struct camera *c, const struct rule *r,
                   struct look *look, unsigned long total[2])
{
    unsigned long now[2] = {total[0] - s->tile[i].count, total[1] - s->tile[i].bytes};
    const unsigned long most[2] = {r->max_gaussians, r->max_bytes};
    bool fits = true;
    for (int j = 0; j < s->n; j++) {
        if (s->tile[j].parent != i)
            continue;
        look[j].seen = has_point_inside(c, &s->tile[j]);
        if (!look[j].seen && !is_far_outside(c, &s->tile[j]))
            return false;
        now[0] += look[j].seen ? s->tile[j].count : 0;
        now[1] += look[j].seen ? s->tile[j].bytes : 0;
    }
    for (int k = 0; k < 2; k++)
        fits = fits && !(most[k] && now[k] > most[k] && now[k] > total[k]);
    look[i].settled = true;
    look[i].refined = fits;
    for (int j = 0; fits && j < s->n; j++)
        look[j].candidate = look[j].candidate || (s->tile[j].parent == i && look[j].seen);
    for (int k = 0; fits && k < 2; k++)
        total[k] = now[k];
    return true;
}

/* Which tiles are drawn; false when rounding would decide. before NULL: no picture before. */
static bool select_tiles(const struct scene *s, const struct camera *c, const struct rule *r,
                         const bool *before, bool *drawn)
{
    struct look look[TILES] = {0};
    unsigned long total[2] = {s->tile[0].count, s->tile[0].bytes};
    memset(drawn, 0, TILES * sizeof *drawn);
    if (!has_point_inside(c, &s->tile[0]))
        return false;
    look[0].candidate = true;
    for (;;) {
        int best = NONE;
        for (int i = 0; i < s->n; i++) {
            if (!look[i].candidate || look[i].settled)
                continue;
            double limit = limit_of(s, i, r, before);
            look[i].error = error_of(&s->tile[i], c->eye, r);
            if (fabs(look[i].error - limit) < 1e-6)
                return false;
            if (look[i].error > limit && (best == NONE || look[i].error > look[best].error))
                best = i;
        }
        if (best == NONE)
            break;
        if (!refine(s, best, c, r, look, total))
            return false;
    }
    for (int i = 0; i < s->n; i++)
        drawn[i] = look[i].candidate && !look[i].refined;
    return true;
}

/* ---- writing ---- */

static void print_numbers(const char *name, const double *v, int n)
{
    printf(", \"%s\": [", name);
    for (int i = 0; i < n; i++)
        printf("%s%.17g", i ? ", " : "", v[i] + 0.0);
    printf("]");
}

static void print_set(const char *name, const struct scene *s, const bool *set)
{
    const char *comma = "";
    printf(", \"%s\": [", name);
    for (int i = 0; i < s->n; i++)
        if (set[i]) {
            printf("%s\"%u/%u/%u\"", comma, s->tile[i].z, s->tile[i].x, s->tile[i].y);
            comma = ", ";
        }
    printf("]");
}

static void print_scene(const struct scene *s, bool last)
{
    printf("\"%s\": [\n", s->name);
    for (int i = 0; i < s->n; i++) {
        const struct tile *t = &s->tile[i];
        printf("[%u, %u, %u", t->z, t->x, t->y);
        for (int k = 0; k < 12; k++) {
            const double *from[4] = {t->lo, t->hi, t->core_lo, t->core_hi};
            printf(", %.17g", from[k / 3][k % 3]);
        }
        printf(", %.17g, %.17g, %u, %u]%s\n", t->error_m, t->sigma_m, t->count, t->bytes,
               i + 1 < s->n ? "," : "");
    }
    printf("]%s\n", last ? "" : ",");
}

/* ---- cameras ---- */

static void set_down(struct camera *c)
{
    static const double down[9] = {1, 0, 0, 0, -1, 0, 0, 0, -1};
    memcpy(c->rot, down, sizeof down);
}

/* Looks by a Pythagorean heading, clockwise from north, and a pitch below the horizon. */
static void set_oblique(struct camera *c)
{
    static const double turn[6][2] = {{0, 1}, {0.6, 0.8},   {0.8, 0.6},
                                      {1, 0}, {0.28, 0.96}, {0.96, 0.28}};
    const double *h = turn[(int)(6 * draw())], *p = turn[1 + (int)(5 * draw())];
    double sign_x = draw() < 0.5 ? -1 : 1, sign_y = draw() < 0.5 ? -1 : 1;
    const double sin_h = sign_x * h[0], cos_h = sign_y * h[1], sin_p = -p[0], cos_p = p[1];
    const double x[3] = {cos_h, -sin_h, 0}, z[3] = {sin_h * cos_p, cos_h * cos_p, sin_p};
    for (int k = 0; k < 3; k++) {
        int a = (k + 1) % 3, b = (k + 2) % 3;
        c->rot[k] = x[k];
        c->rot[3 + k] = z[a] * x[b] - z[b] * x[a];
        c->rot[6 + k] = z[k];
    }
}

enum { OVERVIEW, OBLIQUE, GAUSSIANS, BYTES, KINDS };

static void draw_case(int kind, struct camera *c, struct camera *then, struct rule *r)
{
    /* 600 to 2000 m high with a picture of +-58 degrees: all of 400 m is in it. */
    double high = kind == OVERVIEW ? 600 + 1400 * draw() : 40 + 300 * draw();
    for (int k = 0; k < 2; k++)
        c->eye[k] = quarter(300 * draw() - 150);
    c->eye[2] = quarter(high);
    if (kind == OVERVIEW)
        set_down(c);
    else
        set_oblique(c);
    *then = *c;
    then->eye[0] += quarter(high / 15 * draw());
    then->eye[2] = quarter(c->eye[2] * 1.125);
    r->error_px =
        kind == OVERVIEW ? ldexp(1, -(int)(6 * draw())) / 2 : ldexp(1, 2 - (int)(5 * draw()));
    r->hysteresis = HYSTERESIS;
    r->max_gaussians = kind == GAUSSIANS ? 1000 + (unsigned long)(12000 * draw()) : 0;
    r->max_bytes = kind == BYTES ? 20000 + (unsigned long)(250000 * draw()) : 0;
}

static bool make_case(const struct scene *s, int kind, bool by_distance, bool first_case)
{
    struct camera c, then;
    struct rule r = {.by_distance = by_distance};
    bool first[TILES], plain[TILES], held[TILES], free_of_limits[TILES];
    draw_case(kind, &c, &then, &r);
    struct rule no_limits = r;
    no_limits.max_gaussians = no_limits.max_bytes = 0;
    if (!select_tiles(s, &c, &r, NULL, first) || !select_tiles(s, &then, &r, NULL, plain) ||
        !select_tiles(s, &then, &r, first, held) ||
        !select_tiles(s, &c, &no_limits, NULL, free_of_limits))
        return false;
    if (kind >= GAUSSIANS && !memcmp(first, free_of_limits, sizeof first))
        return false; /* a limit that is none */
    printf("%s{\"scene\": \"%s\", \"metric\": \"%s\", \"error_px\": %.17g", first_case ? "" : ",\n",
           s->name, by_distance ? "distance" : "screen", r.error_px);
    if (kind == GAUSSIANS)
        printf(", \"max_gaussians\": %lu", r.max_gaussians);
    if (kind == BYTES)
        printf(", \"max_bytes\": %lu", r.max_bytes);
    print_numbers("eye", c.eye, 3);
    print_numbers("then", then.eye, 3);
    print_numbers("rot", c.rot, 9);
    print_set("picked", s, first);
    print_set("picked_then", s, plain);
    print_set("picked_then_with_hysteresis", s, held);
    printf("}");
    return true;
}

int main(void)
{
    static struct scene scene[3];
    static const int cases[KINDS] = {14, 12, 8, 8};
    bool first = true;
    make_scene(&scene[0], "full", 0, 0);
    make_scene(&scene[1], "sparse", 0.35, 0);
    make_scene(&scene[2], "core", 0, CORE_M);
    printf("{\n\"about\": \"made by pick_vectors.c, which says what the rule is; tile: z x y, "
           "box min e n u, box max, core min, core max, geometricError, sigma_max, count, "
           "bytes\",\n\"focal_px\": %g, \"size_px\": [%d, %d], \"hysteresis\": %g, "
           "\"distance_m\": [%g, %g, %g],\n\"scenes\": {\n",
           focal_px, WIDTH, HEIGHT, HYSTERESIS, distances_m[0], distances_m[1], distances_m[2]);
    for (int i = 0; i < 3; i++)
        print_scene(&scene[i], i == 2);
    printf("},\n\"cases\": [\n");
    for (int i = 0; i < 3; i++)
        for (int kind = 0; kind < KINDS; kind++)
            for (int made = 0; made < cases[kind];) {
                bool done = make_case(&scene[i], kind, made % 3 == 2, first);
                made += done;
                first = first && !done;
            }
    printf("\n]\n}\n");
    return 0;
}
