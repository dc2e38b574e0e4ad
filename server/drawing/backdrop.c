/* Sky, horizon and ground: see backdrop.h. Names and numbers are those of the viewer.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/drawing/backdrop.h"

#include <math.h>
#include <string.h>

/* web/src/groundmap.ts */
static const double ground_span = 2.5;  /* half of a side of the picture, in halves of the city */
static const double ground_edge = 0.07; /* of that half: the strip in which the city's edge fades */
static const double ground_rim = 4;     /* of these strips: whose mean colour the ground takes */
static const double ground_covered = 0.4; /* what is covered less from above is not city */
static const double ground_above = 40;    /* halves of the picture: the camera is so high */
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

struct backdrop backdrop_read(const double min_enu_m[3], const double max_enu_m[3],
                              const float *rgb, const float *transmittance)
{
    const double strip = ground_edge * BACKDROP_PX / (2 * ground_span);
    const double size[2] = {max_enu_m[0] - min_enu_m[0], max_enu_m[1] - min_enu_m[1]};
    struct backdrop out = {.level_m = min_enu_m[2],
                           .reach_m = fmax(20, hypot(size[0], size[1]) / 2)};
    float far[BACKDROP_PX * BACKDROP_PX];
    double light[3];
    for (int cell = 0; cell < BACKDROP_PX * BACKDROP_PX; cell++)
        far[cell] = 1; /* all of it counts */
    memcpy(out.ground, day_ground, sizeof out.ground);
    if (backdrop_mean(rgb, transmittance, far, INFINITY, light)) {
        memcpy(out.ground, light, sizeof out.ground);
        backdrop_inside(transmittance, far);
        (void)backdrop_mean(rgb, transmittance, far, ground_rim * strip, out.ground);
    } else
        memcpy(light, day_ground, sizeof light);
    const double bright = 0.2126 * light[0] + 0.7152 * light[1] + 0.0722 * light[2];
    const double day = night + (1 - night) * backdrop_smooth(lit_from, lit_to, bright);
    for (int a = 0; a < 3; a++) {
        out.top[a] = day_top[a] * day;
        out.low[a] =
            fmin(1, day_low[a] * day * (1 + tinge * (fmin(2, light[a] / fmax(0.02, bright)) - 1)));
    }
    return out;
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
    for (int a = 0; a < 3; a++)
        out[a] = b->ground[a] + (b->low[a] - b->ground[a]) * haze;
}
