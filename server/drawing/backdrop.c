/* Sky, horizon and ground: see backdrop.h. Names and numbers are those of the viewer.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/drawing/backdrop.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

#include "core/base.h"

/* web/src/groundmap.ts */
static const double ground_span = 2.5;  /* half of a side of the picture, in halves of the city */
static const double ground_edge = 0.07; /* of that half: the strip in which the city's edge fades */
static const double ground_rim = 4;     /* of these strips: whose mean colour the ground takes */
static const double ground_covered = 0.4; /* what is covered less from above is not city */
static const double ground_above = 40;    /* halves of the picture: the camera is so high */
static const double ground_flat = 0.6; /* higher, by its narrower side: an object; no edge fades */
/* Halves of the city, between which own colours go over into their mean. */
static const double ground_mean_from = 1.1, ground_mean_to = 2.3;
/* web/src/backdrop.ts */
static const double day_top[3] = {0.36, 0.56, 0.82}, day_low[3] = {0.82, 0.88, 0.93},
                    day_ground[3] = {0.52, 0.53, 0.5};
static const double night = 0.1;                   /* what is left of a day's sky by night */
static const double lit_from = 0.04, lit_to = 0.3; /* brightness of a city by night, and by day */
static const double tinge = 0.35;                  /* of the city's light in the horizon */

static double backdrop_smooth(double from, double to, double v)
{
    const double t = fmin(fmax((v - from) / (to - from), 0), 1);
    return t * t * (3 - 2 * t);
}

/* Half of a side of the picture from above, metres. */
static double backdrop_half(const double min[3], const double max[3])
{
    return ground_span * fmax(fmax(max[0] - min[0], max[1] - min[1]), 1) / 2;
}

struct camera backdrop_camera(const double min_enu_m[3], const double max_enu_m[3])
{
    double at[3], eye[3];
    for (int a = 0; a < 3; a++)
        at[a] = eye[a] = (min_enu_m[a] + max_enu_m[a]) / 2;
    eye[2] += ground_above * backdrop_half(min_enu_m, max_enu_m);
    return camera_look_at(eye, at, 2 * atan(1 / ground_above), BACKDROP_PX, BACKDROP_PX);
}

/* ---- what lies at the city's edge ---- */

/* A cell takes `step` more than its neighbour, where that is less. */
static void backdrop_near(float *far, int cell, int other, float step)
{
    far[cell] = fminf(far[cell], far[other] + step);
}

/* Distance of each cell, in cells, to what lies outside: cells that are not covered and hang
 * together with the border of the picture. */
static void backdrop_inside(const float *transmittance, float *far)
{
    enum { SIDE = BACKDROP_PX, CELLS = SIDE * SIDE, WITHIN = SIDE * (SIDE - 2) - 2 };
    int open[CELLS], n = 0;
    for (int cell = 0; cell < CELLS; cell++) {
        const int x = cell % SIDE, y = cell / SIDE;
        const bool border = !x || !y || x == SIDE - 1 || y == SIDE - 1;
        far[cell] = SIDE;
        if (border && 1 - (double)transmittance[cell] <= ground_covered) {
            far[cell] = 0;
            open[n++] = cell;
        }
    }
    while (n) {
        const int cell = open[--n], x = cell % SIDE, y = cell / SIDE;
        const int beside[4] = {x ? cell - 1 : cell, x < SIDE - 1 ? cell + 1 : cell,
                               y ? cell - SIDE : cell, y < SIDE - 1 ? cell + SIDE : cell};
        for (int i = 0; i < 4; i++)
            if (far[beside[i]] > 0 && 1 - (double)transmittance[beside[i]] <= ground_covered) {
                far[beside[i]] = 0;
                open[n++] = beside[i];
            }
    }
    for (int sign = 1; sign >= -1; sign -= 2) {
        int cell = sign > 0 ? SIDE + 1 : SIDE * (SIDE - 1) - 2;
        for (int k = 0; k < WITHIN; k++, cell += sign) {
            backdrop_near(far, cell, cell - sign, 1);
            backdrop_near(far, cell, cell - sign * SIDE, 1);
            backdrop_near(far, cell, cell - sign * (SIDE - 1), sqrtf(2));
            backdrop_near(far, cell, cell - sign * (SIDE + 1), sqrtf(2));
        }
    }
}

/* Mean colour of the cells that are inside, at most `most` cells from what lies outside. False:
 * there are none. */
static bool backdrop_mean(const float *rgb, const float *transmittance, const float *far,
                          double most, double out[3])
{
    double sum[4] = {0};
    for (int cell = 0; cell < BACKDROP_PX * BACKDROP_PX; cell++)
        if (far[cell] > 0 && (double)far[cell] < most) {
            for (int a = 0; a < 3; a++)
                sum[a] += fmin((double)rgb[3 * cell + a], 1);
            sum[3] += 1 - (double)transmittance[cell];
        }
    for (int a = 0; a < 3 && sum[3] > 0; a++)
        out[a] = fmin(fmax(sum[a] / sum[3], 0), 1);
    return sum[3] > 0;
}

/* ---- the ground's own colours ---- */

enum { BACKDROP_CHANNELS = 4 }; /* red, green, blue times a weight, and the weight, from 0 to 1 */

static float *backdrop_cell(float *level, int side, int x, int y)
{
    return level + BACKDROP_CHANNELS * ((ptrdiff_t)y * side + x);
}

/* The next coarser level, of half the side. */
static void backdrop_halve(float *fine, int side, float *out)
{
    for (int y = 0; y < side / 2; y++)
        for (int x = 0; x < side / 2; x++) {
            const float *a = backdrop_cell(fine, side, 2 * x, 2 * y);
            const float *b = a + (ptrdiff_t)BACKDROP_CHANNELS * side;
            float *to = backdrop_cell(out, side / 2, x, y), sum[BACKDROP_CHANNELS];
            for (int c = 0; c < BACKDROP_CHANNELS; c++)
                sum[c] = (a[c] + a[BACKDROP_CHANNELS + c]) + (b[c] + b[BACKDROP_CHANNELS + c]);
            for (int c = 0; c < BACKDROP_CHANNELS; c++)
                to[c] = sum[c] / fmaxf(1, sum[BACKDROP_CHANNELS - 1]);
        }
}

static int backdrop_within(int i, int side)
{
    return i < 0 ? 0 : i >= side ? side - 1 : i;
}

/* What a level lacks comes from the coarser one, between its cells. */
static void backdrop_pour(float *coarse, float *fine, int side)
{
    const int half = side / 2;
    for (int y = 0; y < side; y++)
        for (int x = 0; x < side; x++) {
            float *to = backdrop_cell(fine, side, x, y), lack = 1 - to[BACKDROP_CHANNELS - 1];
            if (!(lack > 0))
                continue;
            const int column = (x + 1) / 2 - 1, row = (y + 1) / 2 - 1;
            const float fx = x % 2 ? 0.25f : 0.75f, fy = y % 2 ? 0.25f : 0.75f;
            const int west = backdrop_within(column, half),
                      east = backdrop_within(column + 1, half);
            const int low = backdrop_within(row, half), high = backdrop_within(row + 1, half);
            const float *sw = backdrop_cell(coarse, half, west, low),
                        *se = backdrop_cell(coarse, half, east, low),
                        *nw = backdrop_cell(coarse, half, west, high),
                        *ne = backdrop_cell(coarse, half, east, high);
            for (int c = 0; c < BACKDROP_CHANNELS; c++) {
                const float south = sw[c] * (1 - fx) + se[c] * fx;
                const float north = nw[c] * (1 - fx) + ne[c] * fx;
                to[c] += lack * (south * (1 - fy) + north * fy);
            }
        }
}

/* Fills cells without weight from those around them, near ones first. values: the finest level,
 * with room for all coarser ones behind it; it has some weight. */
static void backdrop_fill(float *values)
{
    float *level[16] = {values};
    int n = 0, side = BACKDROP_PX;
    for (; side > 1; side /= 2, n++) {
        level[n + 1] = level[n] + BACKDROP_CHANNELS * (ptrdiff_t)side * side;
        backdrop_halve(level[n], side, level[n + 1]);
    }
    const float weight = level[n][BACKDROP_CHANNELS - 1];
    for (int c = 0; c < BACKDROP_CHANNELS; c++)
        level[n][c] /= weight;
    for (; n; n--) {
        side *= 2;
        backdrop_pour(level[n], level[n - 1], side);
    }
}

/* How much of the own colours is over at a cell. */
static double backdrop_mean_share(int x, int y)
{
    const double dx = ground_span * fabs((2 * x + 1.0) / BACKDROP_PX - 1);
    const double dy = ground_span * fabs((2 * y + 1.0) / BACKDROP_PX - 1);
    return backdrop_smooth(ground_mean_from, ground_mean_to, hypot(dx, dy));
}

/* The ground's colours, and what is left of the city at its edge. Rows of the picture are from
 * north to south, those of the map from south to north. */
static enum err_code backdrop_ground(const double size[3], const float *rgb,
                                     const float *transmittance, const float *inside,
                                     struct backdrop *out, struct err *e)
{
    enum { SIDE = BACKDROP_PX, CELLS = SIDE * SIDE };
    const double strip = ground_edge * SIDE / (2 * ground_span);
    const bool object = size[2] > ground_flat * fmin(size[0], size[1]);
    float *values = mem_array(2 * CELLS, BACKDROP_CHANNELS * sizeof *values); /* a third is over */
    if (!values)
        return err_set(e, ERR_MEM, "ground: out of memory");
    for (int cell = 0; cell < CELLS; cell++) {
        float *to = backdrop_cell(values, SIDE, cell % SIDE, SIDE - 1 - cell / SIDE);
        for (int a = 0; a < 3; a++)
            to[a] = fminf(rgb[3 * cell + a], 1);
        to[3] = 1 - transmittance[cell];
    }
    backdrop_fill(values);
    for (int y = 0; y < SIDE; y++)
        for (int x = 0; x < SIDE; x++) {
            const float *from = backdrop_cell(values, SIDE, x, y);
            const double own = 1 - backdrop_mean_share(x, y);
            const double far = (double)inside[(SIDE - 1 - y) * SIDE + x];
            for (int a = 0; a < 3; a++) {
                const double color = out->ground[a] + own * ((double)from[a] - out->ground[a]);
                out->near[y][x][a] = (float)fmin(fmax(color, 0), 1);
            }
            out->edge.left[y][x] = object ? 1 : (float)backdrop_smooth(0.5, strip + 0.5, far);
        }
    mem_free(values);
    return ERR_OK;
}

/* Where nothing is to be seen: all of one colour, and nothing fades. */
static void backdrop_bare(struct backdrop *out)
{
    for (int y = 0; y < BACKDROP_PX; y++)
        for (int x = 0; x < BACKDROP_PX; x++) {
            out->edge.left[y][x] = 1;
            for (int a = 0; a < 3; a++)
                out->near[y][x][a] = (float)out->ground[a];
        }
}

enum err_code backdrop_read(const double min_enu_m[3], const double max_enu_m[3], const float *rgb,
                            const float *transmittance, struct backdrop *out, struct err *e)
{
    const double strip = ground_edge * BACKDROP_PX / (2 * ground_span);
    float far[BACKDROP_PX * BACKDROP_PX];
    double light[3], size[3];
    enum err_code rc = ERR_OK;
    for (int a = 0; a < 3; a++)
        size[a] = max_enu_m[a] - min_enu_m[a];
    out->level_m = min_enu_m[2];
    out->reach_m = fmax(20, hypot(size[0], size[1]) / 2);
    out->edge.side_m = 2 * backdrop_half(min_enu_m, max_enu_m);
    for (int a = 0; a < 2; a++)
        out->edge.middle_enu_m[a] = (min_enu_m[a] + max_enu_m[a]) / 2;
    for (int cell = 0; cell < BACKDROP_PX * BACKDROP_PX; cell++)
        far[cell] = 1; /* all of it counts */
    memcpy(out->ground, day_ground, sizeof out->ground);
    if (backdrop_mean(rgb, transmittance, far, HUGE_VAL, light)) {
        memcpy(out->ground, light, sizeof out->ground);
        backdrop_inside(transmittance, far);
        (void)backdrop_mean(rgb, transmittance, far, ground_rim * strip, out->ground);
        rc = backdrop_ground(size, rgb, transmittance, far, out, e);
    } else {
        memcpy(light, day_ground, sizeof light);
        backdrop_bare(out);
    }
    const double bright = 0.2126 * light[0] + 0.7152 * light[1] + 0.0722 * light[2];
    const double day = night + (1 - night) * backdrop_smooth(lit_from, lit_to, bright);
    for (int a = 0; a < 3; a++) {
        out->top[a] = day_top[a] * day;
        out->low[a] =
            fmin(1, day_low[a] * day * (1 + tinge * (fmin(2, light[a] / fmax(0.02, bright)) - 1)));
    }
    return rc;
}

/* ---- what is seen ---- */

/* The ground's colour at a place, between the middles of four cells. */
static void backdrop_near_color(const struct backdrop *b, const double at_enu_m[2], double out[3])
{
    double share[2];
    int cell[2];
    for (int a = 0; a < 2; a++) {
        const double corner = b->edge.middle_enu_m[a] - b->edge.side_m / 2;
        const double along = (at_enu_m[a] - corner) * BACKDROP_PX / b->edge.side_m - 0.5;
        share[a] = fmin(fmax(along, 0), BACKDROP_PX - 1.001);
        cell[a] = (int)share[a];
        share[a] -= cell[a];
    }
    for (int c = 0; c < 3; c++) {
        const double sw = (double)b->near[cell[1]][cell[0]][c],
                     se = (double)b->near[cell[1]][cell[0] + 1][c],
                     nw = (double)b->near[cell[1] + 1][cell[0]][c],
                     ne = (double)b->near[cell[1] + 1][cell[0] + 1][c];
        const double south = sw + share[0] * (se - sw), north = nw + share[0] * (ne - nw);
        out[c] = south + share[1] * (north - south);
    }
}

void backdrop_color(const struct backdrop *b, const double eye_enu_m[3], const double ray[3],
                    double out[3])
{
    const double up = ray[2] / sqrt(ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2]);
    const double above = eye_enu_m[2] - b->level_m, t = pow(fmax(up, 0), 0.45);
    for (int a = 0; a < 3; a++)
        out[a] = b->low[a] + (b->top[a] - b->low[a]) * t;
    if (!(up < 0) || !(above > 0))
        return;
    /* How far away the ray meets the ground, along it; and where that is the horizon. */
    const double distance = above / -up * sqrt(1 - up * up), most = 8 * fmax(b->reach_m, above);
    const double haze = backdrop_smooth(0.25, 1, distance / most);
    const double along = above / -ray[2];
    const double at[2] = {eye_enu_m[0] + along * ray[0], eye_enu_m[1] + along * ray[1]};
    double ground[3];
    backdrop_near_color(b, at, ground);
    for (int a = 0; a < 3; a++)
        out[a] = ground[a] + (b->low[a] - ground[a]) * haze;
}
